"""Placement: the criterion against the component, the search against a grid, and against milling."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.cell.placement import (
    AXIS_MARGIN,
    OUT_OF_REACH,
    SAMPLES,
    PlacementError,
    Placing,
    grid_map,
    milled,
    place,
    placed,
    prepare,
    toml_lines,
)
from robomill.cell.scenario import ScenarioError, load_scenario
from robomill.cli import main
from robomill.models.components.robot_compliance import MODEL
from robomill.models.model.declaration import record
from tests import SCENARIOS
from tests.tolerances import ROUNDOFF

SLOT = SCENARIOS / "robots" / "kr210_2.toml"
GRID = 0.06
"""Relative: what a grid of 21 x 21 misses of the minimum, as the limits of the axes lie between its points."""
SECOND_ORDER = 2e-3
"""Relative: the criterion is of first order; the displacement of a robot that bends by 1 mrad is not."""
FEEDBACK = 0.06
"""Relative: a tool that gives way cuts less than the rigid one that the criterion has its force from; |rho| < 0.05 in a slot."""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Placing:
    """The slot with the KR 210-2, free in x and in the angle of the spindle."""
    return place(load_scenario(SLOT), tmp_path_factory.mktemp("place"), free=("x", "spindle"))


def test_criterion_is_the_displacement_of_the_component(tmp_path: Path) -> None:
    """At points of the program, the component robot_compliance with the same force."""
    scenario = load_scenario(SLOT)
    assert scenario.workpiece is not None
    task, system = prepare(scenario, tmp_path)
    placement = scenario.workpiece.placement
    bent, q = task.bending(placement)
    data = MODEL.new()
    for variable in MODEL.variables:
        if variable.name in (task.record.dtype.names or ()) and variable.causality == "parameter":
            data[variable.name] = task.record[variable.name]
    init, step = MODEL.plain()
    s = record(data)
    chosen = np.flatnonzero(task.cut)[::8]
    expected = []
    for angles, f in zip(q[chosen], task.force[chosen] @ placement.R_BP.T, strict=True):
        data["q_link"], data["f_T_B"] = angles, f
        assert (step(s, 0.0, 0.004) if expected else init(s)) == 0
        expected.append(data["d_T_B"][0].copy())
    given = np.array(expected)
    assert np.abs(bent[chosen] @ placement.R_BP.T - given).max() < SECOND_ORDER * np.abs(given).max()
    assert system.component("compliance").source.endswith("robot_compliance")


def test_best_is_no_worse_than_any_point_of_a_grid(found: Placing) -> None:
    across, up, value = grid_map(found, ("x", "spindle"), 21)
    assert found.best_m <= np.nanmin(value) * (1.0 + ROUNDOFF)
    assert np.nanmin(value) < (1.0 + GRID) * found.best_m
    assert len(across) == len(up) == 21
    assert found.best_m < 0.95 * found.present_m
    assert np.array_equal(found.best[[1, 2, 3]], found.present[[1, 2, 3]])
    assert np.all(found.margin > 0.5 * AXIS_MARGIN)


@pytest.mark.slow
def test_milling_at_both_places_agrees(found: Placing, tmp_path: Path) -> None:
    before = milled(found.scenario, tmp_path / "present")
    after = milled(placed(found.scenario, found.best), tmp_path / "best")
    assert abs(after / before - found.best_m / found.present_m) < FEEDBACK
    assert abs(after - found.best_m) < FEEDBACK * found.best_m


def test_twice_as_many_points_say_the_same(found: Placing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robomill.cell.placement.SAMPLES", 2 * SAMPLES)
    finer, _ = prepare(found.scenario, tmp_path)
    assert abs(finer.criterion(found.placement(found.best)) - found.best_m) < 0.02 * found.best_m  # as SAMPLES says


def test_lines_for_the_scenario_are_read_back(found: Placing, tmp_path: Path) -> None:
    text = SLOT.read_text()
    start, end = text.index("[workpiece]"), text.index('size = ["40 mm"')
    changed = text[:start] + toml_lines(found) + text[end:]
    changed = changed.replace('"../milling_cell.toml"', f'"{SCENARIOS / "milling_cell.toml"}"').replace(
        '"slot.ngc"', f'"{SLOT.parent / "slot.ngc"}"'
    )
    file = tmp_path / "placed.toml"
    file.write_text(changed)
    workpiece = load_scenario(file).workpiece
    assert workpiece is not None
    meant = found.placement(found.best)
    assert math.dist(workpiece.position, meant.p_BP_B) < 1e-5  # printed with two decimals of a mm
    turned = Rotation.from_matrix(workpiece.placement.R_BT.T @ meant.R_BT).magnitude()
    assert turned < 1e-4  # and three of a degree


def test_command_writes_map_json_and_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["place", str(SLOT), "--free", "y", "--range", "50", "50", "50", "--no-mill", "--out", str(tmp_path)]
    assert main([*arguments, "--no-pictures"]) == 0
    assert "for the scenario (also in " in capsys.readouterr().out
    figures = json.loads((tmp_path / "place.json").read_text())
    assert figures["best"]["criterion_m"] <= figures["present"]["criterion_m"]
    assert (tmp_path / "place.toml").read_text().startswith("[workpiece]\nposition = [")


def test_what_cannot_be_is_said(found: Placing, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["place", str(SLOT), "--free", "w", "--out", str(tmp_path)]) == 2
    assert "'w' cannot be free; available: x, y, z, turn, spindle" in capsys.readouterr().err
    far = found.present.copy()
    far[0] = 9.0
    assert found.task.criterion(found.placement(far)) == OUT_OF_REACH
    with pytest.raises(PlacementError, match=r"the point 30.0, 0.0, \S+ mm of the program is out of reach"):
        found.task.bending(found.placement(far))
    with pytest.raises(PlacementError, match="a scenario of kind 'static_loads' has no program to place; give a milling scenario"):
        prepare(load_scenario(SCENARIOS / "static_loads.toml"), tmp_path)


def test_nothing_in_reach_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robomill.cell.placement.WRIST", 2.0)  # |sin A5| is never that large
    with pytest.raises(PlacementError, match=r"kr210_2.toml: no placement in x 1250 .. 1350, y -50 .. 50, .* can be reached with y free"):
        place(load_scenario(SLOT), tmp_path, (0.05, 0.05, 0.05), ("y",))


def test_angle_of_the_tool_turns_it_about_its_axis(tmp_path: Path) -> None:
    text = SLOT.read_text().replace('abc = ["180 deg", "0 deg", "0 deg"]', 'abc = ["180 deg", "0 deg", "0 deg"]\ntool_angle = "30 deg"')
    text = text.replace('"../milling_cell.toml"', f'"{SCENARIOS / "milling_cell.toml"}"').replace(
        '"slot.ngc"', f'"{SLOT.parent / "slot.ngc"}"'
    )
    file = tmp_path / "turned.toml"
    file.write_text(text)
    turned, upright = load_scenario(file).workpiece, load_scenario(SLOT).workpiece
    assert turned is not None
    assert upright is not None
    between = Rotation.from_matrix(upright.placement.R_BT.T @ turned.placement.R_BT).as_rotvec()
    assert np.abs(between - [math.radians(30.0), 0.0, 0.0]).max() < ROUNDOFF
    assert replace(turned, tool_angle=0.0) == upright
    file.write_text(text.replace('tool_angle = "30 deg"', 'tool_angle = "30 mm"'))
    with pytest.raises(ScenarioError, match="tool_angle"):
        load_scenario(file)
