"""Milling scenarios with tri-dexels: one line of the cell changed, stock from STL, a tilted ball nose, the part as STL."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from robomill.cell.evaluation import evaluate
from robomill.cell.milling import mill, prepare
from robomill.cell.part import cut_part, raw_part
from robomill.cell.scenario import ScenarioError, load_scenario
from robomill.cli import main
from tests import ROOT

KR210 = ROOT / "scenarios" / "kr210"
FORCES = 0.02
"""Relative: what the two workpieces differ by at entry and exit, where one has cells of 0.2 mm and the other lines 0.25 mm apart."""
SURFACES = 1e-5
"""The two ways to measure a surface [m]: swept volumes, and corners of triangles 0.5 mm apart on walls of 8 mm radius."""

ROW = """
[[point]]
position = [-40, 0, -1.5]
orientation = [0, 0, -15]
feed = 60
speed = 13000
[[point]]
position = [40, 0, -1.5]
orientation = [0, 10, -15]
"""
SCENARIO = """
[scenario]
name = "row"
kind = "milling"
system = "SYSTEM"
program = "row.toml"
[workpiece]
position = ["1300 mm", "0 mm", "1200 mm"]
abc = ["180 deg", "0 deg", "0 deg"]
stock = "STOCK"
[parameters]
milling = { diameter = "12 mm", corner_radius = "6 mm", teeth = 2 }
[variants.uncompensated]
parameters.controller.mode = 0
"""


def row(folder: Path, **replaced: str) -> Path:
    """A scenario of one row with a tilted ball nose over the blank."""
    (folder / "row.toml").write_text(ROW)
    text = SCENARIO.replace("SYSTEM", str(KR210 / "tridexel_cell.toml")).replace("STOCK", str(KR210 / "blank.stl"))
    for old, new in replaced.items():
        text = text.replace(old, new)
    file = folder / "scenario.toml"
    file.write_text(text)
    return file


@pytest.mark.slow
def test_one_line_of_the_cell_changes_the_workpiece(tmp_path: Path) -> None:
    """The short slot of the KR 210: force and surface are those of milling_force."""
    own = (ROOT / "scenarios" / "milling_cell.toml").read_text()
    (tmp_path / "cell.toml").write_text(own.replace('source = "milling_force"', 'source = "tridexel_milling_force"'))
    text = (ROOT / "scenarios" / "robots" / "kr210_2.toml").read_text()
    (tmp_path / "slot.ngc").write_text((ROOT / "scenarios" / "robots" / "slot.ngc").read_text())
    found = []
    for name, cell in (("dexels", str(ROOT / "scenarios" / "milling_cell.toml")), ("tridexels", "cell.toml")):
        file = tmp_path / f"{name}.toml"
        file.write_text(text.replace("../milling_cell.toml", cell))
        scenario = load_scenario(file)
        job = prepare(scenario, tmp_path / name)
        run, factor = mill(job, scenario.variants[0])
        assert scenario.workpiece is not None
        found.append(evaluate(name, name, run, scenario.workpiece, factor))
    ours, theirs = found[1].figures, found[0].figures
    assert ours.peak_cutting_force_n == pytest.approx(theirs.peak_cutting_force_n, rel=FORCES)
    # the rms of all depends on how many points walls and floors have
    assert ours.max_deviation_m == pytest.approx(theirs.max_deviation_m, abs=SURFACES)
    assert ours.floor_rms_deviation_m == pytest.approx(theirs.floor_rms_deviation_m, abs=SURFACES)
    assert ours.floor_max_deviation_m == pytest.approx(theirs.floor_max_deviation_m, abs=SURFACES)


@pytest.mark.slow
def test_a_tilted_ball_nose_mills_a_solid_from_stl(tmp_path: Path) -> None:
    """By the command, with pictures; the part that is written is closed and has the volume that was not removed."""
    file = row(tmp_path)
    assert main(["run", str(file), "--out", str(tmp_path / "out"), "--stl", "--json"]) == 0
    part = trimesh.load(tmp_path / "out" / "uncompensated" / "part.stl")
    assert part.is_watertight
    assert (tmp_path / "out" / "uncompensated" / "part.png").stat().st_size > 10000
    scenario = load_scenario(file)
    job = prepare(scenario, tmp_path / "again", overwrite=True)
    run, _ = mill(job, scenario.variants[0])
    assert scenario.workpiece is not None
    removed = float(np.sum(run["milling.removal_rate"]) * 0.004)
    lost = raw_part(run, scenario.workpiece, FINE).volumes() - cut_part(run, scenario.workpiece, spacing=FINE).volumes()
    assert removed == pytest.approx(lost.mean(), rel=VOLUME)
    assert part.volume * 1e-9 == pytest.approx(cut_part(run, scenario.workpiece).volumes().mean(), rel=BEVELS)
    assert run["milling.f_T_B"].any()


FINE = 2.5e-4
VOLUME = 0.03
"""Relative: a shallow cut of 1.5 mm by lines 0.25 mm apart, against the way of the envelope."""
BEVELS = 3e-3
"""Relative: edges of the surface are bevelled by half of 0.5 mm."""


def test_a_stock_that_cannot_be_used_is_refused(tmp_path: Path) -> None:
    triangles = trimesh.load(KR210 / "blank.stl")
    for text, replaced in (
        ("give either size, of a block, or stock", {"stock =": 'size = ["1 mm", "1 mm", "1 mm"]\nstock ='}),
        ("it would fit in millimetres", {"stock =": 'stock_unit = "1 m"\nstock ='}),
        ("expected a positive length", {"stock =": "stock_unit = 0\nstock ="}),
    ):
        with pytest.raises(ScenarioError, match=text):
            load_scenario(row(tmp_path, **replaced))
    triangles.update_faces(np.arange(len(triangles.faces)) > 0)
    triangles.export(tmp_path / "open.stl")
    with pytest.raises(ScenarioError, match="the surface is not closed: 3 edges"):
        load_scenario(row(tmp_path, **{str(KR210 / "blank.stl"): "open.stl"}))


def test_a_corner_larger_than_the_tool_is_refused(tmp_path: Path) -> None:
    tools = '[tools.1]\ndiameter = "10 mm"\nteeth = 2\nhelix = 0\ncutting_length = "20 mm"\ncorner_radius = "CORNER"\n[parameters]'
    scenario = load_scenario(row(tmp_path, **{"[parameters]": tools.replace("CORNER", "5 mm")}))
    assert scenario.tool_corners == {1: 0.005}
    with pytest.raises(ScenarioError, match="'6 mm'; expected 0 \\(flat\\) to half of the diameter"):
        load_scenario(row(tmp_path, **{"[parameters]": tools.replace("CORNER", "6 mm")}))


def test_the_stock_lies_with_the_middle_of_its_top_in_p(tmp_path: Path) -> None:
    workpiece = load_scenario(row(tmp_path)).workpiece
    assert workpiece is not None
    assert workpiece.stock is not None
    assert workpiece.size == pytest.approx((0.060, 0.040, 0.025), rel=SINGLE)
    assert workpiece.stock.max(axis=(0, 1)) == pytest.approx([0.030, 0.020, 0.0], abs=SINGLE)


SINGLE = 1e-6
"""Numbers of the STL file have six digits."""


def test_a_part_of_a_height_field_is_not_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(ROOT / "scenarios" / "groove.toml"), "--out", str(tmp_path / "o"), "--stl"]) == 2
    assert "milling is 'milling_force', expected 'tridexel_milling_force'" in capsys.readouterr().err
