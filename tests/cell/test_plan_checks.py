"""Told before the run: what the plan shows to be wrong, by `robomill plan` (status 1) and by `robomill run`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from robomill.cell.milling import _label, lay_out, prepare
from robomill.cell.plan_checks import Findings, check_plan
from robomill.cell.scenario import ScenarioError, load_scenario, place_in_block
from robomill.cli import main
from robomill.models.planning import gcode
from robomill.models.process.cutting import EndMill
from robomill.orchestration.runs.run import Run
from tests import SCENARIOS
from tests.tolerances import ROUNDOFF

SIZE = (0.10, 0.06, 0.03)
MILL = EndMill(0.016, 3, 0.5, 0.032)
HEAD = "G21 G90 G17 S9000 M3 F600\nG0 X-70 Y0 Z10\n"


def findings(text: str, mill: EndMill = MILL, size: tuple[float, float, float] = SIZE) -> Findings:
    return check_plan(gcode.parse(HEAD + text), size, {0: mill})


class TestFindings:
    """One text for each thing that is wrong."""

    @pytest.mark.parametrize("name", ["groove", "test_part"])
    def test_none_in_the_programs_of_the_paper(self, name: str) -> None:
        scenario = load_scenario(SCENARIOS / f"{name}.toml")
        assert scenario.program is not None
        assert scenario.workpiece is not None
        assert check_plan(gcode.read(scenario.program), scenario.workpiece.size, {0: MILL}) == Findings()

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("G1 Z0\nX70", "nothing is cut: the feed moves run over X -70.0 .. 70.0, Y 0.0 .. 0.0, Z 0.0 .. 10.0 mm"),
            ("G0 Y90\nG1 Z-5\nX70", "the block fills X -50 .. 50, Y -30 .. 30, Z -30 .. 0; check zero"),
            ("G1 Z-5\nX-10\nG0 X70", "rapid moves through material: 1, first at line 5, deepest by 5.00 mm at line 5"),
            ("G0 Z-2\nX70", "rapid moves through material: 1"),
            ("M5\nG1 Z-5\nX70", "moves that cut while the spindle stands: 1, first at line 5; name the speed"),
            ("G1 Z-5\nX70\nY45\nX-70\nX70", "% of the path below the top of the block runs beside the block"),
            ("(T1 D=6. CR=0. - flat end mill)\nT1 M6\nG1 Z-5\nX70", "tool T1 is 16 mm wide here, 6 mm in a comment of the program"),
        ],
    )
    def test_said(self, text: str, said: str) -> None:
        assert said in "\n".join(findings(text).texts)

    def test_edges_that_are_too_short(self) -> None:
        assert (
            "the tool cuts 25.0 mm deep at line 4, its edges are 20 mm long" in findings("G1 Z-25\nX70", EndMill(0.016, 3, 0.5, 0.02)).texts
        )

    def test_a_comment_in_inches_is_the_same_tool(self) -> None:
        text = "(T1 D=0.63 - flat end mill)\nG20 G1 Z-0.1\nX2"
        assert not findings(text).texts

    def test_nothing_cut_is_its_own_answer(self) -> None:
        assert not findings("G1 Z0\nX70").cuts
        assert findings("G1 Z-1\nX70").cuts


class TestPlaces:
    """Where program zero lies in the block."""

    @pytest.mark.parametrize(
        ("name", "place"),
        [
            ("centre", (0.0, 0.0, 0.0)),
            ("centre-top", (0.0, 0.0, 0.0)),
            ("corner", (-0.05, -0.03, 0.0)),
            ("corner-bottom", (-0.05, -0.03, -0.03)),
            ("front-left-top", (-0.05, -0.03, 0.0)),
            ("back-right-bottom", (0.05, 0.03, -0.03)),
            ("left", (-0.05, 0.0, 0.0)),
        ],
    )
    def test_by_name(self, name: str, place: tuple[float, float, float]) -> None:
        assert place_in_block(name, SIZE) == pytest.approx(place, rel=ROUNDOFF)

    @pytest.mark.parametrize(("name", "said"), [("middle", "'middle' is no place of a block"), ("left-right", "two words for x")])
    def test_refused(self, name: str, said: str) -> None:
        with pytest.raises(ValueError, match=said):
            place_in_block(name, SIZE)


CORNER = "G21 G90 G17 G55 S9000 M3\nG0 X-20 Y30 Z40\nG1 Z25 F1500\nX30\nG0 Z40\nG28 Z60\nG4 P500\nM30\n"
"""Zero in a corner at the bottom of the block, in G55, and a dwell of a Fanuc."""


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "milling_cell.toml").write_text((SCENARIOS / "milling_cell.toml").read_text())
    (tmp_path / "part.nc").write_text(CORNER)
    return tmp_path


def scenario(folder: Path, reading: str = "", workpiece: str = "", tools: str = "") -> Path:
    file = folder / "part.toml"
    file.write_text(
        f'[scenario]\nname = "part"\nkind = "milling"\nsystem = "milling_cell.toml"\nprogram = "part.nc"\n{reading}\n'
        f'[workpiece]\nposition = ["1300 mm", 0, "1200 mm"]\nabc = ["180 deg", 0, 0]\nsize = ["10 mm", "60 mm", "30 mm"]\n{workpiece}\n'
        f"{tools}\n"
        "[variants.cartesian]\nparameters.controller.mode = 1\n"
    )
    return file


def tool(number: int, diameter: str = "16 mm") -> str:
    return f'[tools.{number}]\ndiameter = "{diameter}"\nteeth = 3\nhelix = "30 deg"\ncutting_length = "32 mm"\n'


class TestPlanCommand:
    """`robomill plan`."""

    def test_a_program_with_all_that_it_leaves_open(self, cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
        options = ["--block", "10", "60", "30", "--zero", "corner-bottom", "--start", "0", "0", "80", "--home", "5", "30", "90"]
        assert main(["plan", "part.nc", *options, "--dialect", "fanuc", "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["warnings"] == []
        # home is 90 mm over the bottom, 60 over the top, start 80: z of the base at 1200 + 60 and + 50
        assert told["highest_m"][2] == pytest.approx(1.260, rel=ROUNDOFF)
        assert told["duration_s"] < 20.0  # 500 s were the dwell in seconds
        assert any("G55: no origin given" in note for note in told["notes"])

    def test_what_is_wrong_is_told_and_the_status_says_so(self, cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["plan", "part.nc", "--block", "10", "60", "30"]) == 1
        assert "warning: nothing is cut" in capsys.readouterr().out

    def test_offsets(self, cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["plan", "part.nc", "--block", "10", "60", "30", "--offset", "G55", "-5", "-30", "-30"]) == 0
        assert "no origin given" not in capsys.readouterr().out

    def test_a_scenario(self, cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
        file = scenario(cell, 'dialect = "fanuc"', 'zero = "corner-bottom"')
        assert main(["plan", str(file)]) == 0
        assert "note: G55: no origin given" in capsys.readouterr().out
        assert main(["plan", str(file), "--zero", "corner"]) == 2
        assert "--zero goes with programs" in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("options", "said"),
        [
            (["--zero", "corner"], "needs --block"),
            (["--block", "10", "60", "0"], "three positive lengths"),
            (["--offset", "G53", "0", "0", "0"], "expected one of G54"),
            (["--offset", "G55", "0", "0", "a"], "--offset G55 0 0 a: 'a' is not a number with a unit"),
            (["--tool", "-1"], "more than 0"),
        ],
    )
    def test_refused(self, cell: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str) -> None:
        assert main(["plan", "part.nc", *options]) == 2
        assert said in capsys.readouterr().err


class TestScenario:
    """The keys of a scenario, and what `run` does before it runs."""

    def test_reading(self, cell: Path) -> None:
        reading = (
            'start = [0, 0, "80 mm"]\nhome = [0, 0, "90 mm"]\ndialect = "haas"\nblock_delete = false\nwear = true\n'
            'feed = "25 mm/s"\nspindle_speed = "60 rpm"'
        )
        loaded = load_scenario(
            scenario(cell, reading, 'zero = "corner-bottom"\nwork_offsets = { G55 = "right", "G59.1" = [0, 0, "1 mm"] }', tool(2))
        )
        assert loaded.workpiece is not None
        assert loaded.workpiece.work_offsets == {
            54: pytest.approx((-0.005, -0.03, -0.03), rel=ROUNDOFF),
            55: pytest.approx((0.005, 0.0, 0.0), abs=ROUNDOFF),
            59.1: pytest.approx((0.0, 0.0, 1e-3), abs=ROUNDOFF),
        }
        setup = loaded.reading
        assert setup.start == pytest.approx((-0.005, -0.03, 0.05), rel=ROUNDOFF)
        assert setup.home == pytest.approx((-0.005, -0.03, 0.06), rel=ROUNDOFF)
        assert (setup.dialect, setup.block_delete, setup.feed) == ("haas", False, 0.025)
        assert setup.spindle_speed == pytest.approx(2 * np.pi, rel=ROUNDOFF)
        assert setup.wear
        assert loaded.tools[2].teeth == 3

    @pytest.mark.parametrize(
        ("reading", "workpiece", "tools", "said"),
        [
            ('dialect = "okuma"', "", "", "available: linuxcnc, fanuc, haas, marlin"),
            ("block_delete = 1", "", "", "expected true"),
            ("", 'zero = "middle"', "", "words, joined by '-': left, right"),
            ("", 'zero = "corner"\nwork_offsets = { G54 = [0, 0, 0] }', "", "give one of them"),
            ("", "", tool(0), "1 or more"),
            ("", "", tool(1).replace("teeth = 3", "teeth = 2.5"), "expected a whole number"),
            ("", "", tool(1, "-1 mm"), "expected a positive length"),
        ],
    )
    def test_refused(self, cell: Path, reading: str, workpiece: str, tools: str, said: str) -> None:
        with pytest.raises(ScenarioError, match=r"part\.toml") as caught:
            load_scenario(scenario(cell, reading, workpiece, tools))
        assert said in str(caught.value)

    def test_a_run_that_cuts_nothing_is_refused_at_once(self, cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["run", str(scenario(cell))]) == 2
        assert "part.nc: nothing is cut: the feed moves run over X -20.0 .. 30.0" in capsys.readouterr().err
        assert not (cell / "results" / "part" / "plan").exists()

    @pytest.mark.parametrize(
        ("tools", "said"),
        [("", r"mills with T1, T2; described are: none; add \[tools.1\]"), (tool(1), r"described are: T1; add \[tools.2\]")],
    )
    def test_tools_that_are_not_described(self, cell: Path, tools: str, said: str) -> None:
        (cell / "part.nc").write_text(HEAD + "T1 M6\nG1 Z-1\nX70\nT2 M6\nX-70\n")
        with pytest.raises(ScenarioError, match=said):
            prepare(load_scenario(scenario(cell, tools=tools)), cell / "out")

    def test_a_variant_is_checked_with_its_own_tool(self, cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """Warned of by `plan` and, before anything has run, by `run`."""
        (cell / "part.nc").write_text(HEAD + "(T1 D=16. - flat end mill)\nT1 M6\nG1 Z-1\nX70\n")
        file = scenario(cell)
        file.write_text(file.read_text() + '[variants.thin]\nparameters.milling.diameter = "6 mm"\n')
        assert main(["plan", str(file)]) == 1
        said = "tool T1 is 6 mm wide here, 16 mm in a comment"
        out = capsys.readouterr().out
        assert said in out
        assert "(variant thin)" in out
        loaded = load_scenario(file)
        job = lay_out(loaded, cell / "out")
        assert not (cell / "out" / "offline").exists()
        (warning,) = job.warnings
        assert said in warning

    def test_labels_name_the_tools_that_are_used(self, cell: Path) -> None:
        (cell / "part.nc").write_text(HEAD + "T2 M6\nG1 Z-1\nX70\n")
        job = lay_out(load_scenario(scenario(cell, tools=tool(1) + tool(2, "8 mm") + 'title = "finisher"\n')), cell / "out")
        assert _label(job, job.system) == "T2 finisher (end mill D8 z3)"

    @pytest.mark.slow
    def test_two_tools_in_one_run(self, cell: Path) -> None:
        """A slot with each of two tools: the force that the smaller one meets is that of its own width."""
        (cell / "part.nc").write_text(
            HEAD + "T1 M6\nG0 X-20 Y-15 Z2\nG1 Z-2 F1500\nX20\nG0 Z20\nT2 M6\nG0 X-20 Y15\nZ2\nG1 Z-2\nX20\nG0 Z20\nM30\n"
        )
        job = prepare(load_scenario(scenario(cell, tools=tool(1) + tool(2, "8 mm"))), cell / "out")
        run = Run.load(job.folder / "offline")
        number, rate = run["path.tool"], run["milling.removal_rate"]
        volumes = [float(np.sum(rate[number == n]) * job.system.step) for n in (1, 2)]
        assert volumes[0] == pytest.approx(0.010 * 0.016 * 0.002, rel=1e3 * ROUNDOFF)
        assert volumes[0] / volumes[1] == pytest.approx(2.0, rel=1e3 * ROUNDOFF)
