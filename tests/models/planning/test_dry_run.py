"""What a program does to its block, against volumes and depths worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robomill.models.planning.dry_run import CELLS_PER_RADIUS, DryRun, dry_run
from robomill.models.planning.gcode import Move, parse
from tests.tolerances import EXACT, ROUNDOFF

SIZE = (0.10, 0.06, 0.03)
RADIUS = 0.008
CELL = RADIUS / CELLS_PER_RADIUS
"""m: at the edge of what a tool covers a cell counts wholly or not at all."""


def run(text: str, **radii: float) -> DryRun:
    program = parse("G21 G90 G17 F600 S1000 M3\nG0 X-70 Y0 Z10\n" + text)
    return dry_run([a for a in program.actions if isinstance(a, Move)], SIZE, {0: RADIUS, **{int(k[1:]): v for k, v in radii.items()}})


def test_a_slot_takes_its_volume() -> None:
    result = run("G1 Z-5\nX70")
    assert result.removed[-1] == pytest.approx(0.1 * 2 * RADIUS * 0.005, rel=1e3 * ROUNDOFF)
    assert result.depth.tolist() == pytest.approx([0.0, 0.005], abs=ROUNDOFF)


def test_what_is_cut_is_gone() -> None:
    """The second time through the same slot, and a rapid back through it, meet nothing; one a millimetre lower meets 1 mm."""
    result = run("G1 Z-5\nX70\nG0 X-70\nG1 X70\nG0 Z-6\nX-70")
    assert result.depth.tolist() == pytest.approx([0.0, 0.005, 0.0, 0.0, 0.0, 0.001], abs=ROUNDOFF)


def test_a_full_circle_takes_its_ring() -> None:
    result = run("G0 X0 Y-10\nG1 Z-4\nG2 J10")
    ring = math.pi * ((0.010 + RADIUS) ** 2 - (0.010 - RADIUS) ** 2) * 0.004
    plunged = math.pi * RADIUS**2 * 0.004
    assert float(np.sum(result.removed)) == pytest.approx(ring, rel=CELL / RADIUS)
    assert result.removed[1] == pytest.approx(plunged, rel=CELL / RADIUS)


def test_passing_by_a_wall_is_no_collision() -> None:
    """A rapid along the wall of a slot touches it without standing in it."""
    assert run("G1 Z-5\nX70\nY0.5\nX-70\nG0 X70").depth[-1] == EXACT


def test_every_tool_has_its_radius() -> None:
    result = run("T1 M6\nG1 Z-5\nX70\nG0 Z10\nX-70 Y25\nT2 M6\nG1 Z-5\nX70", _1=0.008, _2=0.002)
    assert result.removed[1] / result.removed[-1] == pytest.approx(4.0, rel=CELL / RADIUS)


def test_how_much_of_the_path_runs_beside_the_block() -> None:
    """The plunge and the way back stay outside; the slot runs in and out."""
    result = run("G1 Z-5\nX70\nY45\nX-70")
    assert result.below == pytest.approx(0.005 + 0.140 + 0.045 + 0.140, abs=2 * CELL)
    assert result.beside == pytest.approx(0.005 + 0.045 + 0.140, abs=2 * CELL)
