"""The elastic robot in a cell: exchanged by one line, equipped with the masses of its robot, its effects in the catalogue."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robomill.cell import milling
from robomill.cell.scenario import load_scenario
from robomill.diagnosis.catalogue import Catalogue
from robomill.fmus.components import component
from robomill.models.robot.dynamics import load_dynamics
from tests import SCENARIOS
from tests.cell.conftest import Runs
from tests.tolerances import physics

FOLDER = SCENARIOS / "kr210"
OURS = {"damping_error", "mode_frequency_error", "tilt_stiffness_error"}


def test_the_effects_are_in_the_catalogue() -> None:
    candidates = {c.effect: c for c in Catalogue.load(FOLDER / "catalogue.toml").candidates if c.effect in OURS}
    assert set(candidates) == OURS
    for v in component("robot_compliance_dynamic").variables:
        if v.name in OURS:
            found = candidates[v.name]
            assert found.unit == v.unit
            assert v.minimum is not None
            assert v.maximum is not None
            assert found.maximum <= v.maximum


@pytest.mark.slow
def test_one_line_puts_inertia_into_the_cell(tmp_path: Path) -> None:
    """The slot of the KR 210 with and without: the same deflection in the full cut, and a vibration on the way there."""
    job = milling.lay_out(load_scenario(FOLDER / "elastic_slot.toml"), tmp_path)
    variants = {v.name: v for v in job.scenario.variants}
    dynamic = milling.of_variant(job, variants["dynamic"]).component("compliance")
    assert dynamic.source == "robot_compliance_dynamic"
    np.testing.assert_array_equal(dynamic.parameters["body_mass"], load_dynamics("kr210_2").body_mass)
    (still, _), (moving, _) = (milling.mill(job, variants[name]) for name in ("static", "dynamic"))
    forces = [np.linalg.norm(r["milling.f_T_B"], axis=1) for r in (still, moving)]
    d = [r["compliance.d_T_B"] for r in (still, moving)]
    cut = np.flatnonzero(forces[0] > 0.9 * forces[0].max())
    middle = slice(cut[len(cut) // 2], cut[-1])
    assert np.abs(d[1][middle].mean(axis=0) - d[0][middle].mean(axis=0)).max() < SAME_MEAN * np.abs(d[0][middle]).max()
    air = slice(0, np.flatnonzero(forces[0] > 0.0)[0])
    assert not np.any(d[0][air])
    assert np.abs(d[1][air]).max() > SHAKEN  # the moving axes shake the robot before it cuts


SAME_MEAN = 0.05
"""The rest of the vibration of the entry, over some periods of the lowest mode."""

SHAKEN = 1e-5
"""m: 60 kg and links that accelerate by some tenths of m/s2, at 1 to 3 um/N."""


def test_the_groove_on_a_robot_with_inertia_does_not_chatter(runs: Runs) -> None:
    """A cut that takes up every sideways motion without damping it swings by 1.8 mm at 31 Hz here (docs/decisions/0086)."""
    still, moving = (runs.results(name) for name in ("groove", "groove_dynamic"))
    for name, largest in GROOVE_WITH_INERTIA.items():
        assert moving[name].figures.max_deviation_m == pytest.approx(largest, abs=physics(largest, relative=0.02))
        # where the cut is steady the robot swings on from entry and rapid motion, about the deflection that it has without inertia
        cut = still[name].cuts[0]
        steady = (still[name].run.t > cut.start + SETTLED) & (still[name].run.t < cut.end - SETTLED)
        d = [r[name].run["compliance.d_T_B"][steady] for r in (still, moving)]
        assert np.abs(d[1].mean(axis=0) - d[0].mean(axis=0)).max() < SAME_MEAN * SWING
        assert np.std(d[1], axis=0).max() < SWING


GROOVE_WITH_INERTIA = {"uncompensated": 1.49e-3, "cartesian": 0.89e-3, "axis": 0.80e-3, "cartesian_pilot": 0.34e-3}
"""Largest deviation [m], docs/explanation/elastic_robot.md."""

SETTLED = 0.8
"""Time [s] from entry and exit on in which the cut is steady."""

SWING = 0.1e-3
"""Most of what is left of the vibration of the entry, rms [m]: vertically 0.04 mm. Chatter has more than a millimetre."""
