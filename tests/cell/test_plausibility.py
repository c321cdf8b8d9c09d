"""What is unusual is told before a run, and runs."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.cell.plausibility import unusual, unusual_cuts, unusual_values
from robomill.cli import main
from robomill.models.planning.gcode import Move
from robomill.models.process.cutting import EndMill
from robomill.orchestration.assembly import assemble
from robomill.orchestration.system.definition import System
from tests import SCENARIOS

MILLING, CONTROL, SENSOR = '"milling_force"', '"compensation_controller"', '"sensor_chain"\nparameters = {'
RPM = 2.0 * math.pi / 60.0


@pytest.mark.parametrize(
    ("name", "usual", "not_usual"),
    [
        ("diameter", (0.55e-3, 95e-3), (0.45e-3, 105e-3)),
        ("spindle_speed", (110.0 * RPM, 57000.0 * RPM), (90.0 * RPM, 63000.0 * RPM)),
        ("cutting_speed", (11.0 / 60.0, 7300.0 / 60.0), (9.0 / 60.0, 7700.0 / 60.0)),
        ("feed_per_tooth", (2.2e-6, 0.95e-3), (1.8e-6, 1.05e-3)),
        ("depth_over_diameter", (0.0, 2.9), (-0.1, 3.1)),
        ("block_size", (1.1e-3, 4.8), (0.9e-3, 5.2)),
        ("cutting_coefficient", (55e6, 9.5e9), (45e6, 10.5e9)),
        ("stiffness", (1.1e4, 9.5e7), (0.9e4, 1.05e8)),
    ],
)
def test_both_ends_of_every_range(name: str, usual: tuple[float, float], not_usual: tuple[float, float]) -> None:
    """A tenth inside and a tenth outside of each bound: none can be doubled."""
    assert [unusual(name, v, "x") for v in usual] == [None, None]
    assert all(unusual(name, v, "x") for v in not_usual)


def test_the_text_names_value_range_and_source() -> None:
    assert unusual("diameter", 16.0, "milling.diameter") == (
        "milling.diameter is 16000 mm; usual is 0.5 to 100 mm (by judgement: end mills and face mills that a spindle of this size carries; "
        "ISO 1641-1 lists end mills of 2 to 63 mm)"
    )


def test_feed_speed_and_depth_of_cuts() -> None:
    mill = EndMill(16e-3, 3, 0.5, 32e-3)
    good = Move(3, 3, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 25e-3, 13000.0 * RPM, 0.0)
    slow = Move(7, 7, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 25e-3, 130.0 * RPM, 0.0)
    rapid = Move(8, 8, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), None, 13000.0 * RPM, 0.0)
    assert unusual_cuts([good, rapid], [10e-3, 0.0], {0: mill}) == []
    texts = unusual_cuts([good, slow], [10e-3, 60e-3], {0: mill})
    assert [t.partition(";")[0] for t in texts] == [
        "the tool: cutting speed at line 7 is 6.53451 m/min",
        "the tool: feed per tooth at line 7 is 3.84615 mm",
        "the tool: depth over diameter at line 7 is 3.75",
    ]


def system(folder: Path, old: str = "", new: str = "") -> System:
    text = (SCENARIOS / "milling_cell.toml").read_text(encoding="utf-8")
    assert old in text
    text = text.replace('[tool]\nname = "spindle_across"\n', "")  # a tool that is named once cannot differ
    (folder / "cell.toml").write_text(text.replace(old, new, 1))
    return load_system(folder / "cell.toml")


@pytest.mark.parametrize(
    ("old", "new", "texts"),
    [
        ("", "", []),
        (
            MILLING,
            MILLING + '\nparameters = {diameter = "160 mm", Ktc = "0.6 N/mm2"}',
            ["milling.diameter is 160 mm", "milling.Ktc is 0.6 N/mm2"],
        ),
        (CONTROL, CONTROL + '\nparameters = {"stiffness[1,1]" = "3 Nm/rad"}', ["controller.stiffness[1,1] is 3 N.m/rad"]),
        (CONTROL, CONTROL + '\nparameters = {"stiffness[1,1]" = "3e6 Nm/rad"}', []),
        (SENSOR, SENSOR + '"p_FT_F[1]" = "100 mm",', ["p_FT_F is ["]),
    ],
)
def test_parameters_and_geometry_of_a_system(tmp_path: Path, old: str, new: str, texts: list[str]) -> None:
    """Stiffness tables differ on purpose; where the tool is, is the same for all."""
    with assemble(system(tmp_path, old, new), resolve, convert) as assembly:
        found = unusual_values(assembly)
    assert len(found) == len(texts)
    assert all(text.startswith(start) for text, start in zip(found, texts, strict=True))
    if texts and texts[0].startswith("p_FT_F"):
        assert "m in path, drive, compliance, controller and [0.1, " in found[0]
        assert found[0].endswith("m in sensor: one machine has one; give it to all of them, or know why it differs")


def test_a_system_with_something_unusual_says_so_and_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.toml").write_text(
        'name = "s"\nstep = "4 ms"\nstop = "8 ms"\n[components.milling]\nsource = "milling_force"\nparameters = {diameter = "0.3 mm"}\n'
    )
    assert main(["run", str(tmp_path / "s.toml"), "--out", str(tmp_path / "out"), "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["rows"] == 3
    assert "warning: milling.diameter is 0.3 mm; usual is 0.5 to 100 mm (by judgement:" in said.err


def test_a_block_that_does_not_lie_where_the_path_was_planned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (SCENARIOS / "groove.toml").read_text(encoding="utf-8")
    for name in ("milling_cell.toml", "groove.ngc"):
        (tmp_path / name).write_text((SCENARIOS / name).read_text(encoding="utf-8"))
    (tmp_path / "g.toml").write_text(text.replace("[parameters]", '[parameters]\nmilling.p_BP_B = ["1300 mm", "10 mm", "1200 mm"]', 1))
    assert main(["run", str(tmp_path / "g.toml"), "--out", str(tmp_path / "out"), "--no-pictures"]) == 2
    said = capsys.readouterr().err
    assert "g.toml: milling.p_BP_B is [1.3, 0.01, 1.2] where the block is cut, but the path is planned for [1.3, 0.0, 1.2]" in said
    assert "give it as [workpiece] position, which both have" in said


class TestOptions:
    """Numbers on the command line are in the unit that the help names, or carry one."""

    def plan(self, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str, str]:
        try:
            status = main(["plan", str(SCENARIOS / "groove.ngc"), *options])
        except SystemExit as end:
            status = int(end.code or 0)
        said = capsys.readouterr()
        return status, said.out, said.err

    def test_mm_by_default_or_any_length(self, capsys: pytest.CaptureFixture[str]) -> None:
        plain = self.plan(capsys, "--at", "1400", "-50", "1.2e3", "--turn", "90")
        assert plain[0] == 0
        assert self.plan(capsys, "--at", "1.4 m", "-50 mm", "1200", "--turn", "90 deg") == plain

    def test_metres_without_a_unit_are_caught(self, capsys: pytest.CaptureFixture[str]) -> None:
        status, _, error = self.plan(capsys, "--at", "1.3", "0", "1.2")
        assert status == 2
        assert (
            '--at 1.3 0 1.2: these are mm, nearer to axis 1 than axis 2 is; if metres are meant, write them with their unit: --at "1.3 m"'
            in error
        )

    @pytest.mark.parametrize(
        ("value", "text"),
        [
            ("-2 1", "'-2 1' is not a number with a unit, such as '4 mm' (a plain number is in mm)"),
            ("13 N", "13 N cannot be expressed in mm: it measures something else; units that fit: mm, m, cm, um, nm"),
            ("nan", "'nan' is not a number with a unit"),
        ],
    )
    def test_what_is_no_length(self, capsys: pytest.CaptureFixture[str], value: str, text: str) -> None:
        status, out, error = self.plan(capsys, "--at", value, "0", "1200", "--json")
        assert status == 2
        assert text in error
        assert text in json.loads(out)["error"]
