"""`robomill identify sensor`: run folders and tables of a calibration, the file that comes out, the errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from robomill.cli import main
from robomill.models.components.spindle_holder import HOLDER, SpindleHolder
from robomill.models.model.parameters import load
from robomill.models.robot.kinematics import load_robot, load_tool, tool_pose
from robomill.models.robot.numeric_inverse import kinematics
from tests.models.calibration.test_measurement_matrix import NOISE, readings, staircases
from tests.robomill.test_identify_command import run_folder
from tests.tolerances import physics

CENTRE = np.deg2rad([0.0, -29.1, 98.8, 0.0, -104.7, 0.0])
ROBOT, TOOL = "kr500_r2830", "spindle_holder_55"


def calibration(forces: np.ndarray, noise: float = NOISE) -> dict[str, np.ndarray]:
    """Columns of a run: loads in B, bridges with the weight of the spindle, which hangs straight down."""
    s, place, R = kinematics(load_robot(ROBOT), load_tool(TOOL)), np.zeros(3), np.zeros((3, 3))
    tool_pose(s, CENTRE, place, R)
    R_BH = np.column_stack([-R[:, 2], R[:, 1], R[:, 0]])
    weight = np.array([0.0, 0.0, -HOLDER.spindle_mass * 9.81]) @ R_BH
    weight[:2] *= HOLDER.spindle_cog[2] / HOLDER.lever
    return {
        "robot.q_motor": np.tile(CENTRE, (len(forces), 1)),
        "holder.bridge": readings(forces + weight, noise),
        "dynamometer.f_T_B": forces @ R_BH.T,
    }


def run(folder: Path, forces: np.ndarray, noise: float = NOISE) -> str:
    return str(run_folder(folder, calibration(forces, noise), ROBOT, TOOL))


def test_matrix_zero_and_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without noise the matrix on file comes back, the zeros are those of the bridges without the weight; the file is a sensor."""
    out, plot = tmp_path / "mine.toml", tmp_path / "mine.png"
    forces = staircases(rest=0)[::7]
    assert main(["identify", "sensor", run(tmp_path / "run", forces, 0.0), "--out", str(out), "--plot", str(plot), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert np.abs(np.array(found["matrix_n_per_v_v"]) @ HOLDER.bridge_force - np.eye(3)).max() < physics(1.0, absolute=1e-6)
    zero = 1e-5 * np.array([1.0, -2.0, 0.5, 3.0, -1.0, 2.0])
    assert np.abs(np.array(found["zero_v_v"]) - zero).max() < physics(1e-5, relative=1e-3)  # angles are given to 0.1 deg
    mine = load(SpindleHolder, out)
    assert np.abs(mine.measurement_matrix / np.array(found["matrix_n_per_v_v"]) - 1.0).max() < physics(1.0, relative=1e-9)
    assert np.abs(mine.strain_force / HOLDER.strain_force - 1.0).max() < physics(1.0, relative=1e-9)
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identify", "sensor", run(tmp_path / "run", staircases(rest=0)[::2]), "--way", "forces"]) == 0
    text = capsys.readouterr().out
    assert "KUKA KR 500 R2830, sensing spindle holder, 55 deg: 1250 rows, condition number 4.4" in text
    assert "least squares of the forces" in text
    assert "matrix in N per mV/V" in text


def test_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Columns of a file, in mV/V, give what a run gives."""
    columns = calibration(staircases(rest=0)[::7], 0.0)
    rows = np.column_stack([columns["robot.q_motor"], 1e3 * columns["holder.bridge"], columns["dynamometer.f_T_B"]])
    names = [*(f"a{i}" for i in range(6)), *(f"b{i}" for i in range(6)), *(f"f{i}" for i in range(3))]
    lines = [",".join(map(repr, map(float, [0.002 * k, *row]))) for k, row in enumerate(rows)]
    (tmp_path / "calibration.csv").write_text("\n".join([",".join(["t", *names]), *lines]) + "\n")
    tables = "".join(
        f'[{name}]\nfile = "calibration.csv"\ncolumns = {json.dumps([n for n in names if n[0] == first])}\nunit = "{unit}"\n'
        for name, first, unit in (("q", "a", "rad"), ("bridge", "b", "mV/V"), ("force", "f", "N"))
    )
    (tmp_path / "set.toml").write_text(f'[robot]\nname = "{ROBOT}"\n[tool]\nname = "{TOOL}"\n{tables}')
    assert main(["identify", "sensor", str(tmp_path / "set.toml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert np.abs(np.array(found["matrix_n_per_v_v"]) @ HOLDER.bridge_force - np.eye(3)).max() < physics(1.0, absolute=1e-6)


def test_one_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No axial load: the run is named, and what to do."""
    folder = run(tmp_path / "flat", staircases(axial=False))
    assert main(["identify", "sensor", folder]) == 2
    error = capsys.readouterr().err
    assert f"{folder}: the loads do not span three directions" in error
    assert "load the tool along +-x, +-y and -z as well" in error
    assert "Traceback" not in error


def test_a_run_without_bridges(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = calibration(staircases()[:30])
    del columns["holder.bridge"]
    assert main(["identify", "sensor", str(run_folder(tmp_path / "run", columns, ROBOT, TOOL))]) == 2
    assert "no bridge: expected a column *.bridge; it has robot.q_motor, dynamometer.f_T_B" in capsys.readouterr().err
