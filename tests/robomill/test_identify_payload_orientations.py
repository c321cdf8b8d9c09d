"""Section 2.6 of paper 000 end to end: three orientations and 27 are simulated, identified, adopted and tried at another place."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.cell.experiments import load_experiment, run_condition, run_experiment
from robomill.cli import main
from robomill.diagnosis.outcome import adopt
from robomill.models.calibration.identification import NEAR, THREE_POSES, Load, three_poses
from robomill.models.calibration.sensor_poses import payload_with_hose
from robomill.models.components.sensor_chain import HOSE, MOUNTING
from robomill.orchestration.runs.run import Run
from tests import SCENARIOS
from tests.tolerances import ROUNDOFF

EXPERIMENT = SCENARIOS / "experiments" / "sensor_file.toml"
SETTLED = 1.0
"""s; until then the filter shows what it starts with."""
TRUE = Load(np.array([0.0, 0.0, -600.0]), np.array([0.03, -0.01, 0.26]), np.array([-20.0, 15.0, 5.0]), np.array([1.5, -2.0, 0.7]))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("orientations")
    run_experiment(load_experiment(EXPERIMENT), folder)
    return folder


def shown(run: Run) -> float:
    """Force that the sensor shows without a process, N rms."""
    rows = run["sensor.f_T_T"][run.t > SETTLED]
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))


def identified(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(["identify", "payload", *arguments, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.slow
@pytest.mark.paper
def test_three_orientations_and_the_polynomial(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """FACTS 6: Eq. (17) leaves about 5 N of what the hose does, at the place of the 27 orientations.

    At the other place, where an elastic hose pulls otherwise, five sixths of what the sensor showed before are gone; a quarter may stay.
    """
    three, many, out = str(runs / "three_orientations-1"), str(runs / "27_orientations-1"), tmp_path / "sensor.ssv"
    alone = identified(capsys, three, many, "--three")
    both = identified(capsys, three, many, "--three", "--polynomial", "--out", str(out))
    assert both["left_force_n"] < 0.3 * alone["left_force_n"]
    assert np.sqrt(3.0) * both["left_force_n"] < 5.0
    experiment = load_experiment(EXPERIMENT)
    before = shown(Run.load(runs / "elsewhere-1"))
    adopted = replace(experiment, parameters={**experiment.parameters, **adopt.read(out)})
    after = shown(run_condition(adopted, experiment.conditions[-1], 1, tmp_path / "run"))
    assert before > 30.0
    assert after < 0.25 * before
    assert main(["identify", "payload", many, "--three"]) == 2
    assert f"27_orientations-1: three_poses: no row is within {np.rad2deg(NEAR):g} deg of O1" in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_takes_the_parameters(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The parameters of `sensor_chain` by `robomill run --adopt`: another force is shown than with those that it starts with."""
    out = tmp_path / "sensor.ssv"
    found = identified(capsys, str(runs / "27_orientations-1"), "--polynomial", "--out", str(out))
    system = tmp_path / "sensor.toml"
    system.write_text('name = "s"\nstep = "4 ms"\nstop = "4 ms"\n[components.sensor]\nsource = "sensor_chain"\n', encoding="utf-8")
    assert main(["run", str(system), "--adopt", str(out), "--out", str(tmp_path / "run")]) == 0
    plain = tmp_path / "plain"
    assert main(["run", str(system), "--out", str(plain)]) == 0
    assert not np.array_equal(Run.load(tmp_path / "run")["sensor.f_T_T"], Run.load(plain)["sensor.f_T_T"])
    assert found["parameters"]["model_weight_B"]["value"][2] < -500.0


def orientations() -> np.ndarray:
    """R_BS [3, 3, 3] with the upward vectors of the paper."""
    found = []
    for up in THREE_POSES:
        x = np.cross(up, [0.3, -0.5, 0.8])
        x /= np.linalg.norm(x)
        found.append(np.stack([x, np.cross(up, x), up]))
    return np.array(found)


def test_rows_of_three_orientations_are_averaged() -> None:
    """Exact rows twice, each with an opposite error, and a row elsewhere that is not used."""
    R = orientations()
    force, moment = TRUE.wrench(R)
    elsewhere = np.eye(3)[None]
    load = three_poses(
        np.concatenate([R, R, elsewhere]),
        np.concatenate([force + 1.0, force - 1.0, [[1e3, 0.0, 0.0]]]),
        np.concatenate([moment - 0.1, moment + 0.1, [[0.0, 1e3, 0.0]]]),
    ).load
    for name in ("weight_B", "cog_S", "offset_f", "offset_m"):
        assert np.abs(getattr(load, name) - getattr(TRUE, name)).max() < 1e3 * ROUNDOFF


def test_what_is_missing_is_named() -> None:
    R = orientations()
    force, moment = TRUE.wrench(R)
    with pytest.raises(
        ValueError, match=r"no row is within 1 deg of O2, up = \[0.0, 0.0, -1.0\] in the sensor; the nearest is 90.0 deg away"
    ):
        three_poses(R[[0, 2]], force[[0, 2]], moment[[0, 2]])
    with pytest.raises(ValueError, match=r"less than 10 orientations, too few for the terms of Eq. \(17\)"):
        payload_with_hose(R, force, moment, HOSE, MOUNTING)
