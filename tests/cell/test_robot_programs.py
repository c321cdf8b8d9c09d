"""`robomill plan` on programs of controllers, and what it says of the axes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from robomill.cell.milling import notes_of, read_program
from robomill.cell.scenario import ScenarioError, load_scenario
from robomill.cli import main
from robomill.models.planning.gcode import Setup
from robomill.models.planning.point_path import PointPath
from tests import SCENARIOS

PART = "G21 G90 G64 P1 G0 X0 Y0 Z5\nS13000 M3\nG1 X40 F1500\nY40\nX0\nM30\n"
PRINTED = 1e-4
"""Relative: four decimals of a mm over 40 mm, and the deviation of blends, which the planner measures to 1e-3."""
PLACED = 1e-6
"""m: four decimals of a mm, sampled at 2001 times."""
SINGULAR = "G21 G90 G0 X0 Y1 Z300\nS13000 M3\nG64 P0.1\nG1 X10 F3000\nZ-300\nX50\nM30\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "part.nc").write_text(PART)
    (tmp_path / "singular.nc").write_text(SINGULAR)
    return tmp_path


def plan(capsys: pytest.CaptureFixture[str], *options: str, status: int = 0) -> dict[str, object]:
    assert main(["plan", *options, "--json"]) == status
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.parametrize("name", ["part.src", "part.mod", "part.ngc"])
def test_what_is_written_is_planned_as_the_program(folder: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    nominal = plan(capsys, "part.nc", "--at", "1400", "0", "1100", "--write", name)
    assert f"{name}: 4 poses" in nominal["notes"]  # type: ignore[operator]
    assert "from part.nc by robomill plan, not compensated" in (folder / name).read_text()
    again = plan(capsys, name, *(() if name != "part.ngc" else ("--at", "1400", "0", "1100")))
    for key in ("duration_s", "length_m"):
        assert again[key] == pytest.approx(nominal[key], rel=PRINTED)
    for key in ("lowest_m", "highest_m"):
        assert again[key] == pytest.approx(nominal[key], abs=PLACED)


def test_splines(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan(capsys, "part.nc", "--write", "curve.src", "--spline")
    assert "SPLINE WITH $VEL.CP=0.025000" in (folder / "curve.src").read_text()
    assert "goes with --write FILE.src" in str(plan(capsys, "part.nc", "--spline", status=2)["error"])


def test_axes_in_text_and_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The line that passes a singular pose is named, with status 1; --within keeps the limits."""
    singular = ("singular.nc", "--robot", "kr210_2", "--at", "1500", "0", "1400")
    found = plan(capsys, *singular, status=1)
    axes = found["axes"]
    assert axes[3]["speed"]["line"] == 5  # type: ignore[index]
    assert axes[3]["speed"]["share"] > 1.0  # type: ignore[index]
    assert found["singular"]["wrist"]["line"] == 5  # type: ignore[index]
    assert "singular.nc line 5 (Z-300)" in found["warnings"][0]  # type: ignore[index]
    assert main(["plan", *singular]) == 1
    text = capsys.readouterr().out
    assert "axis A4 " in text
    assert "nearest to singular (0): wrist 0.00 at line 5, elbow " in text
    kept = plan(capsys, *singular, "--within", "speed")
    assert max(axis["speed"]["share"] for axis in kept["axes"]) <= 1.0  # type: ignore[attr-defined]


def test_robot_program_in_a_scenario_stands_where_the_scenario_says(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan(capsys, "part.nc", "--write", "part.src")
    program = read_program(folder / "part.src", Setup())
    assert isinstance(program, PointPath)
    assert notes_of(program) == ("part.src: the frames of the file are not used; workpiece and tool stand as said here",)
    assert len(program.points) == 4


def test_orientation_is_chosen_on_the_command_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A turn in place at the last point comes with `corner` (exact stop there), and takes time."""
    square, there = str(SCENARIOS / "parts/tilted_square.toml"), ("--at", "1595", "-18", "1099")
    assert read_program(Path(square), Setup(), "corner").interpolation == "corner"  # type: ignore[union-attr]
    durations = [plan(capsys, square, *there, "--orientation", how)["duration_s"] for how in ("path", "corner")]
    assert durations[1] > durations[0]  # type: ignore[operator]
    assert plan(capsys, square, *there)["duration_s"] == durations[0]


def test_orientation_is_a_key_of_the_scenario(folder: Path) -> None:
    head = '[scenario]\nname = "part"\nkind = "static_loads"\nsystem = "part.nc"\n'
    for text, found in (("", None), ('orientation = "corner"\n', "corner")):
        (folder / "part.toml").write_text(head + text)
        assert load_scenario(folder / "part.toml").orientation == found
    (folder / "part.toml").write_text(head + 'orientation = "slerp"\n')
    with pytest.raises(
        ScenarioError, match=r"part\.toml:5: \[scenario\] orientation: unknown orientation 'slerp'; available: corner, path"
    ):
        load_scenario(folder / "part.toml")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("part.nc", "--write", "part.txt"), "--write part.txt: expected a name that ends in .src, .mod, .ngc"),
        (("part.nc", "--orientation", "corner"), "part.nc: orientation = 'corner' is given, and G-code has no orientation"),
        (("part.src", "--turn", "90"), "--turn: part.src has its own frames; give --at X Y Z as well"),
        (("other.src",), "other.src line 2: a statement that is not read back in 'PTP HOME'"),
        (("absent.mod",), "absent.mod"),
    ],
)
def test_refused(folder: Path, options: tuple[str, ...], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    plan(capsys, "part.nc", "--write", "part.src")
    (folder / "other.src").write_text("DEF OTHER ( )\nPTP HOME\nEND\n")
    assert text in str(plan(capsys, *options, status=2)["error"])
