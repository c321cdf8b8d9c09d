"""`robomill identify cycle|backlash|stations|hammer|modes`: from tables and run folders to reports, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robomill.cli import main
from robomill.models.calibration.stiffness import SPRINGS, screws
from robomill.models.robot.kinematics import load_robot, load_tool
from tests import SCENARIOS
from tests.models.calibration.test_load_cycle import GAP, LARGE, SMALL, K, axis_6, spring
from tests.models.calibration.test_stations import DOWN, IN_LINE, poses, pushes
from tests.robomill.test_identify_command import answer, run_folder
from tests.tolerances import ROUNDOFF, physics

TABLE = str(SCENARIOS / "kr210" / "table_3_1.toml")
HOLDS = np.deg2rad([0.0, -60.0, 100.0, 0.0, 50.0, 0.0])


def table(folder: Path, torque: np.ndarray, angle: np.ndarray) -> Path:
    """A measurement as a TOML file over columns."""
    rows = "\n".join(f"{m!r},{1e6 * a!r}" for m, a in zip(torque.tolist(), angle.tolist(), strict=True))
    (folder / "cycle.csv").write_text(f"M,phi\n{rows}\n", encoding="utf-8")
    file = folder / "axis_6.toml"
    file.write_text(
        '[torque]\nfile = "cycle.csv"\ncolumns = ["M"]\nunit = "N.m"\n[angle]\nfile = "cycle.csv"\ncolumns = ["phi"]\nunit = "urad"\n',
        encoding="utf-8",
    )
    return file


def load_run(folder: Path, condition: str = "") -> Path:
    """A run with force at the tip 300 mm beside axis 6, and the displacement that the small loop makes there."""
    robot, tool = load_robot("kr210_2"), load_tool("lever_300")
    torque, angle = spring(5)
    screw = screws(robot, tool, HOLDS[None], SPRINGS[5:])[0, 0]
    force = torque[:, None] * screw[:3] / (screw[:3] @ screw[:3])
    q = np.tile(HOLDS, (len(torque), 1))
    run = run_folder(folder, {"robot.q": q, "load.f_T_B": force, "laser.d_T_B": angle[:, None] * screw[:3]}, robot.name, tool.name)
    if condition:
        file = run / "run.toml"
        file.write_text(file.read_text() + f'[labels]\ncondition = "{condition}"\n', encoding="utf-8")
    return run


def test_cycle_of_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = table(tmp_path, *axis_6(LARGE)), tmp_path / "report"
    assert main(["identify", "cycle", str(file), "--out", str(out), "--json"]) == 0
    (found,) = answer(capsys)["cycles"]
    assert found["name"] == "axis_6"
    assert abs(found["stiffness_nm_per_rad"]["loading_end"]["value"] - K) < physics(K, relative=1e-3)  # the digits of the table
    assert sorted(f.name for f in out.iterdir()) == ["axis_6-axis_6.png", "report.json", "report.txt"]
    said = (out / "report.txt").read_text()
    assert "loading end" in said
    assert "friction slips: the spring of a model with hysteresis" in said


@pytest.mark.parametrize("way", ["option", "label"])
def test_backlash_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str], way: str) -> None:
    """Torque and angle by the lever of the axis that the option or the condition names."""
    run = load_run(tmp_path / "run", "A6" if way == "label" else "")
    assert main(["identify", "backlash", str(run), *(["--spring", "A6"] if way == "option" else [])]) == 0
    said = capsys.readouterr().out
    assert said.startswith("A6: gap ")
    assert said.rstrip().endswith("determined")
    main(["identify", "backlash", str(run), "--spring", "A6", "--json"])
    low, high = answer(capsys)["gaps"][0]["interval_rad"]
    assert low < GAP < high


def test_backlash_of_a_large_cycle_is_not_determined(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identify", "backlash", str(table(tmp_path, *axis_6(LARGE)))]) == 1
    assert "not determined: without it the loop is still" in capsys.readouterr().out
    assert main(["identify", "backlash", str(table(tmp_path, *axis_6(SMALL)))]) == 0


def test_errors_of_cycles(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = load_run(tmp_path / "run")
    for arguments, text in (
        ((str(run),), "unknown spring ''; available: A1, A2"),
        ((str(run), "--spring", "A7"), "unknown spring 'A7'; available: A1, A2"),
        ((str(run), "--spring", "A6", "--tool", "spindle_in_line"), "the tool tip is 0.00 mm from the axis of A6"),
        ((str(run), "--spring", "A6", "--spring", "A5"), "2 --spring for 1 runs; expected one per run"),
        ((str(table(tmp_path, np.linspace(0, 1, 30), np.linspace(0, 1, 30))),), "0 complete branches in 30 samples"),
    ):
        assert main(["identify", "cycle", *arguments]) == 2
        assert text in capsys.readouterr().err
    columns = {
        "robot.q": np.linspace(HOLDS, HOLDS + 0.1 * np.eye(6)[2], 40),
        "load.f_T_B": np.ones((40, 3)),
        "laser.d_T_B": np.ones((40, 3)),
    }
    moving = run_folder(tmp_path / "moving", columns, "KUKA KR 210-2", load_tool("lever_300").name)
    assert main(["identify", "cycle", str(moving), "--spring", "A6"]) == 2
    assert "A3 moves by 100 mrad during the cycle, expected at most 1: let the robot hold its pose" in capsys.readouterr().err


def test_stations_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loads = pushes(poses(IN_LINE, DOWN))
    columns = {"robot.q": loads.q, "load.f_T_B": loads.f_T_B, "laser.d_T_B": loads.d_T_B}
    run, out = run_folder(tmp_path / "run", columns, "KUKA KR 210-2", IN_LINE.name), tmp_path / "report"
    assert main(["identify", "stations", str(run), "--compliance", TABLE, "--out", str(out)]) == 0
    assert "with tilt axes / drives alone, mean: x 0.68, y 0.30, z 0.71" in capsys.readouterr().out
    assert (out / "stations.png").stat().st_size > 10_000
    main(["identify", "stations", str(run), "--compliance", TABLE, "--json"])
    found = answer(capsys)
    assert len(found["stations"]) == 9
    assert max(found["rms_error"]) < 1e3 * ROUNDOFF
    still = run_folder(tmp_path / "still", {**columns, "load.f_T_B": 0.0 * loads.f_T_B}, "KUKA KR 210-2", IN_LINE.name)
    assert main(["identify", "stations", str(still), "--compliance", TABLE]) == 2
    assert f"{still}: stations: all forces are zero" in capsys.readouterr().err


SIMULATED = ("--robot", "kr210_2", "--tool", "spindle_in_line_300", "--compliance", TABLE, "--angles", "0", "-60", "100", "0", "50", "0")


def test_hammer_simulated_and_from_its_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The damping time of the file is found; the runs that were written give the same without the option, by their labels."""
    runs, out = tmp_path / "blows", tmp_path / "report"
    assert main(["identify", "hammer", "--simulate", str(runs), *SIMULATED, "--duration", "4", "--out", str(out), "--json"]) == 0
    first = answer(capsys)
    for group in first["damping"]["groups"]:
        assert abs(group["beta_s"] - 0.4e-3) < 4.0 * group["relative_error"] * 0.4e-3
    assert first["dropped"]
    assert (out / "responses.png").stat().st_size > 10_000
    again = [str(runs / d) for d in "xyz"]
    assert main(["identify", "hammer", *again, "--compliance", TABLE, "--duration", "4"]) == 0
    said = capsys.readouterr().out
    assert f"left out: {first['dropped'][0]}" in said
    assert said.count(", determined") == 3
    assert main(["identify", "modes", *again[:2], "--compliance", TABLE, "--duration", "4", "--out", str(out), "--overwrite"]) == 0
    said = capsys.readouterr().out
    assert "9.44  A1 drive 44 %, A3 tilt x 40 %" in said
    assert (out / "shapes.png").stat().st_size > 10_000


def test_errors_of_hammer_tests(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = {"hammer.f_T_B": np.zeros((100, 3)), "sensor.a_T_B": np.zeros((100, 3))}
    run = str(run_folder(tmp_path / "run", columns, "KUKA KR 210-2", IN_LINE.name))
    for arguments, text in (
        ((run,), f"{run}: hammer: the force is zero in all of the record"),
        ((), "expected either RUN folders of blows, or --simulate DIR"),
        (("--simulate", str(tmp_path / "new"), "--robot", "kr210_2"), "--simulate needs --robot, --tool and --angles"),
        ((str(load_run(tmp_path / "other")),), "no acceleration: expected a column *.a_T_B"),
    ):
        assert main(["identify", "hammer", *arguments]) == 2
        assert text in capsys.readouterr().err
