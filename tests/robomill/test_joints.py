"""The diagnosis is told the right directions of the joints, and places effects of the cell in their components."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.blind.conditions import POSITIONS, Condition, known, planned
from robomill.blind.effects import BY_KEY, Instance
from robomill.blind.world import MEASURED, NOISE, TRACKER, nominal_system, simulate_nominal
from robomill.cell.binding import convert, resolve
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.preparation import prepared
from robomill.diagnosis.localisation.localise import alignment
from robomill.diagnosis.localisation.replay_attribution import Replay
from robomill.diagnosis.localisation.where import locate
from robomill.joints import ANGLES, KNOTS, TOOL_TIP, arm, projections, tool_tip_jacobian
from robomill.models.components.robot_drive import MODEL
from robomill.models.model.declaration import FloatArray, record
from robomill.models.robot.kinematics import tool_pose
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import base_name
from tests import ROOT
from tests.tolerances import ROUNDOFF, discretisation

CATALOGUE = ROOT / "scenarios" / "catalogue.toml"
CUT = Condition("cut", POSITIONS[0], 180.0, 4e-3, 0.06, reversals=True)


ROBOT = arm(nominal_system())
assert ROBOT is not None


def tool_tip(q: FloatArray) -> FloatArray:
    p, R = np.zeros(3), np.zeros((3, 3))
    tool_pose(record(MODEL.new()), q, p, R)
    return p


class TestJacobian:
    Q = np.radians([[10.0, -80.0, 100.0, 20.0, 50.0, -30.0], [-20.0, -95.0, 110.0, 5.0, 40.0, 60.0]])

    def test_it_is_what_the_tool_tip_does(self) -> None:
        J = tool_tip_jacobian(ROBOT, {name: self.Q[:, i] for i, name in enumerate(ANGLES)})
        h = 1e-6
        for n, q in enumerate(self.Q):
            for i, step in enumerate(h * np.eye(6)):
                difference = (tool_tip(q + step) - tool_tip(q - step)) / (2.0 * h)
                assert J[n, :, i] == pytest.approx(difference, abs=discretisation(1.0, h, 2) + 1e-3 * ROUNDOFF / h)

    def test_between_the_knots_a_joint_is_still_recognised(self) -> None:
        share = np.linspace(0.0, 1.0, 3 * KNOTS)[:, None]
        q = (1.0 - share) * self.Q[0] + share * self.Q[1]
        J = tool_tip_jacobian(ROBOT, {name: q[:, i] for i, name in enumerate(ANGLES)})
        turned = np.array([tool_tip(row + 1e-6 * np.eye(6)[2]) - tool_tip(row) for row in q])
        assert alignment(turned, J)[2] > 0.9999

    def test_an_angle_that_is_not_measured_is_named(self) -> None:
        with pytest.raises(KeyError, match="q_motor"):
            tool_tip_jacobian(ROBOT, {})


def measure(folder: Path, effects: Sequence[Instance]) -> list[Run]:
    """Three noisy runs of the cell with these effects."""
    np.save(folder / "segments.npy", planned(CUT).table)
    clean = simulate_nominal(CUT, effects)
    rng, made = np.random.default_rng(5), []
    names = [c for c in clean.columns if base_name(c) in (*MEASURED, TRACKER) and clean.ports[c].type == "real"]
    sensor = {"sensor.f_S_raw": 0.5, "sensor.m_S_raw": 0.05, "sensor.f_T_T": 0.3, "sensor.m_T_T": 0.03}
    for k in range(3):
        size = {c: NOISE[base_name(c)][0] if base_name(c) in NOISE else sensor.get(base_name(c), 0.0) for c in names}
        columns = {c: clean.columns[c] + size[c] * rng.normal(size=len(clean.t)) for c in names}
        made.append(Run(folder / f"run{k}", clean.t, columns, clean.ports, {"parameters": known(CUT, str(folder / "segments.npy"))}))
    return made


def located(folder: Path, effects: Sequence[Instance], hidden: Sequence[str] = ()) -> list[list[str]]:
    """Components named by replay and swaps, each with its alternatives; the effects `hidden` are in no catalogue."""
    runs, catalogue = measure(folder, effects), Catalogue.load(CATALOGUE)
    kept = [c for c in catalogue.candidates if c.effect not in hidden and c.location not in ("joint 4", "joint 5", "joint 6")]
    start = prepared(Campaign.of(nominal_system(), runs), replace(catalogue, candidates=tuple(kept)), resolve, convert)
    laboratory = replace(start.laboratory, decimation=4)
    replay = Replay(laboratory, [0], start.catalogue, start.nuisances)
    tip = np.array([float(base_name(c) == TOOL_TIP) for c in laboratory.channels])
    entries = locate(replay, {TOOL_TIP: tip}, projections(nominal_system())).where
    return [[w.component, *(w.alternatives or ())] for w in entries]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "index", "value"),
    [
        ("compliance.gear_hysteresis", 2, 120e-6),
        ("drive.backlash", 3, 100e-6),
        ("sensor.sensor_gain_error", 0, 0.1),
        ("controller.extra_delay", 0, 0.05),
        ("milling.runout", 0, 30e-6),
    ],
)
def test_an_effect_is_placed_in_its_component(tmp_path: Path, key: str, index: int, value: float) -> None:
    assert located(tmp_path, [Instance(BY_KEY[key], index, value)])[0][0] == key.partition(".")[0]


@pytest.mark.slow
def test_of_an_effect_in_no_catalogue_the_set_that_it_is_in_is_named(tmp_path: Path) -> None:
    # play in a gear, and no hysteresis of either law: drive and compliance do the same to the only signal behind them
    found = located(tmp_path, [Instance(BY_KEY["compliance.gear_hysteresis"], 2, 120e-6)], hidden=("gear_hysteresis", "gear_friction"))
    assert set(found[0]) == {"compliance", "drive"}
