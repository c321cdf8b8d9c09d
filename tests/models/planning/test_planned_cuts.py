"""What the edges meet along a planned program, against cuts worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robomill.models.planning.gcode import parse
from robomill.models.planning.planned_cuts import BOUNDS, CELLS_PER_RADIUS, PlannedCut, planned_cuts
from robomill.models.planning.trajectory import Placement, plan
from robomill.models.process.cutting import immersion
from tests.tolerances import ROUNDOFF, physics

SIZE = (0.10, 0.06, 0.03)
RADIUS = 0.008
MM = 1e-3
BIN = float(BOUNDS[1])
PLACE = Placement((1.3, 0.1, 1.2), (math.radians(30), 0.0, 0.0))


def cuts(text: str, **radii: float) -> dict[int, PlannedCut]:
    """By the number of the line below the two that begin every program."""
    program = parse("G21 G90 G17 F1500 S13000 M3\nG0 X-70 Y0 Z10\n" + text)
    found = planned_cuts(plan(program, PLACE), SIZE, {0: RADIUS, **{int(k[1:]): v for k, v in radii.items()}})
    return {c.line - 2: c for c in found}


def test_a_slot_is_engaged_over_half_a_turn() -> None:
    found = cuts("G1 Z-4\nX70\nG0 Z20")
    assert list(found) == [2]
    cut = found[2]
    assert cut.axial == pytest.approx(4 * MM, rel=1e4 * ROUNDOFF)
    assert cut.engaged == pytest.approx((0.0, math.pi), abs=physics(0.0, absolute=2 * BIN))
    assert cut.direction == pytest.approx([1.0, 0.0], abs=1e6 * ROUNDOFF)
    assert cut.feed == pytest.approx(0.025, rel=1e6 * ROUNDOFF)
    assert cut.spindle_speed == pytest.approx(13000 * math.pi / 30, rel=ROUNDOFF)
    assert abs(cut.position[0]) <= 0.05
    assert cut.position[1:] == pytest.approx([0.0, -4 * MM], abs=1e6 * ROUNDOFF)


@pytest.mark.parametrize(("y", "mode"), [(35.0, "down"), (-35.0, "up")])
def test_a_side_cut_has_the_angles_of_its_width(y: float, mode: str) -> None:
    """A wall of 3 mm along +x: right of the path it is milled down, left of it up (FACTS 3.2)."""
    cut = cuts(f"Y{y}\nG1 Z-5\nX70\nG0 Z20")[3]
    expected = immersion(2 * RADIUS, 3 * MM, mode)
    # a wall is known to a fraction of a cell of 1/24 of the radius
    slope = 1.0 / (RADIUS * math.sin(immersion(2 * RADIUS, 3 * MM, "up")[1]))
    assert cut.engaged == pytest.approx(expected, abs=physics(0.0, absolute=BIN + RADIUS / CELLS_PER_RADIUS * slope))


def test_what_is_cut_already_is_not_cut_again_and_tools_have_their_radii() -> None:
    found = cuts("G1 Z-4\nX70\nX-70\nT1 M6\nX70\nG0 Z20", T1=0.010)
    assert list(found) == [2, 5]
    # the larger tool takes the strips beside the slot
    wide = found[5]
    assert wide.tool == 1
    assert np.count_nonzero(wide.depth) < 0.7 * len(wide.depth)


def test_air_cuts_nothing_and_a_radius_must_be_known() -> None:
    assert cuts("G1 Z5\nX70") == {}
    program = parse("G21 G90 G17 F1500 S13000 M3\nG0 X-70 Y0 Z10\nT3 M6\nG1 Z-1\nX70")
    with pytest.raises(KeyError):
        planned_cuts(plan(program, PLACE), SIZE, {1: RADIUS})
