"""The dexel workpiece: volumes, heights and engagement against geometry done by hand."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from numba import njit

from robomill.models.model.kernels import COMPILER_OPTIONS
from robomill.models.process import dexels as workpiece
from tests.tolerances import EXACT, ROUNDOFF, discretisation

LX, LY, TOP, BOTTOM, RADIUS = 0.06, 0.05, 0.0, -0.02, 0.008
BINS = 90
PHI = (np.arange(BINS) + 0.5) * math.pi / BINS
SINES, COSINES = np.sin(PHI), np.cos(PHI)


@njit(**COMPILER_OPTIONS)
def _cut(*arguments: Any) -> float:
    return workpiece.cut(*arguments)


@njit(**COMPILER_OPTIONS)
def _engagement(*arguments: Any) -> float:
    return workpiece.engagement(*arguments)


@njit(**COMPILER_OPTIONS)
def _settle(*arguments: Any) -> None:
    workpiece.settle(*arguments)


@njit(**COMPILER_OPTIONS)
def _follow(*arguments: Any) -> int:
    return workpiece.follow(*arguments)


class Block:
    """A block with its cells."""

    def __init__(self, spacing: float = 2e-4) -> None:
        self.nx, self.ny = workpiece.cells(LX, spacing), workpiece.cells(LY, spacing)
        self.grid = (self.nx, self.ny, LX / self.nx, LY / self.ny)
        self.height = np.zeros(self.nx * self.ny)
        self.lagging = np.zeros(self.nx * self.ny)
        self.trail = np.zeros((workpiece.TRAIL, 3))
        self.places = 0
        self.last = (0.0, 0.0, 0.0)

    def cut(self, a: Any, b: Any, done: bool = False) -> float:
        """Cut from a to b; removed volume m3."""
        if not done:
            self.leave()
            self.follow(a)
        self.follow(b)
        return float(_cut(self.height, *self.grid, TOP, BOTTOM, *map(float, a), *map(float, b), RADIUS, done))

    def follow(self, tip: Any) -> None:
        """Note a place of the tool in the field that the edges read."""
        self.last = tuple(map(float, tip))
        self.places = _follow(self.lagging, *self.grid, TOP, BOTTOM, self.trail, self.places, *self.last, RADIUS)

    def leave(self) -> None:
        """The tool leaves the material: that field catches up."""
        if self.places:
            _settle(self.lagging, *self.grid, TOP, BOTTOM, self.trail, self.places, *self.last, RADIUS)
        self.places = 0

    def along(self, points: np.ndarray) -> float:
        """Cut a polyline as the component does, step after step."""
        return sum(self.cut(a, b, i > 0) for i, (a, b) in enumerate(itertools.pairwise(points)))

    def engagement(self, position: Any, direction: Any, loss: float = 0.0) -> np.ndarray:
        """Height of material before the edges in every bin, m."""
        depth = np.zeros(BINS)
        largest = _engagement(
            self.lagging,
            *self.grid,
            self.trail,
            self.places,
            *map(float, position),
            RADIUS,
            *map(float, direction),
            loss,
            0.0,
            BINS,
            SINES,
            COSINES,
            depth,
        )
        assert largest == depth.max()
        return depth

    @property
    def volume_missing(self) -> float:
        return float(-self.height.sum() * self.grid[2] * self.grid[3])


# ---------------------------------------------------------------- cells
@pytest.mark.parametrize(
    ("length", "spacing", "count"), [(0.1, 2e-4, 500), (0.1, 3e-4, 334), (0.1, 0.1, 2), (0.1, 1.0, 2), (0.06, 0.02, 3)]
)
def test_cells_fill_the_edge_and_are_no_wider_than_asked(length: float, spacing: float, count: int) -> None:
    assert workpiece.cells(length, spacing) == count


def test_finest_spacing_fits_and_a_micrometre_less_does_not() -> None:
    finest = workpiece.finest_spacing(0.1, 0.06, workpiece.CAPACITY)
    assert workpiece.cells(0.1, finest) * workpiece.cells(0.06, finest) <= workpiece.CAPACITY
    assert workpiece.cells(0.1, finest - 1e-6) * workpiece.cells(0.06, finest - 1e-6) > workpiece.CAPACITY


# ---------------------------------------------------------------- cutting
def test_nothing_is_cut_above_or_beside_the_block() -> None:
    block = Block()
    assert block.cut((-0.01, 0, 0.0), (0.01, 0, 0.0)) == 0.0
    assert block.cut((-0.01, 0.04, -0.01), (0.01, 0.04, -0.01)) == 0.0
    assert not block.height.any()


def test_plunge_removes_a_cylinder() -> None:
    """Partly covered cells make the disc's area exact to second order; with the cell as unit: (dx/R)^2."""
    block = Block()
    removed = block.cut((0.0013, -0.0007, 0.001), (0.0013, -0.0007, -0.005))
    assert removed == pytest.approx(math.pi * RADIUS**2 * 0.005, rel=discretisation(1.0, 2e-4 / RADIUS, 2))
    assert removed == pytest.approx(block.volume_missing, rel=ROUNDOFF * block.height.size)


@pytest.mark.parametrize("angle", [0.0, 13.0, 45.0, 90.0, 200.0])
def test_slot_removes_a_stadium_in_any_direction(angle: float) -> None:
    block = Block()
    a = math.radians(angle)
    way = 0.012 * np.array([math.cos(a), math.sin(a)])
    start = np.array([0.0003, 0.0005])
    points = np.column_stack([start + np.linspace(-1, 1, 241)[:, None] * way, np.full(241, -0.004)])
    removed = block.along(points)
    assert removed == pytest.approx((math.pi * RADIUS**2 + 2 * RADIUS * 0.024) * 0.004, rel=discretisation(1.0, 2e-4 / RADIUS, 2))
    single = Block()
    assert single.cut(points[0], points[-1]) == pytest.approx(removed, rel=1e3 * ROUNDOFF)  # a few hundred steps, each with its roundoff
    assert block.height == pytest.approx(single.height, abs=1e3 * ROUNDOFF * 0.004)


def test_a_cut_repeated_removes_nothing() -> None:
    block = Block()
    block.cut((-0.01, 0.001, -0.003), (0.01, -0.002, -0.003))
    assert block.cut((-0.01, 0.001, -0.003), (0.01, -0.002, -0.003)) == EXACT


def test_shortcut_of_the_covered_disc_changes_nothing() -> None:
    """With and without the knowledge that the tool has already cut at a, on a wandering and heaving path."""
    rng = np.random.default_rng(1)
    points = np.column_stack(
        [np.linspace(-0.04, 0.04, 400), 0.001 * np.cumsum(rng.normal(0, 0.1, 400)), -0.005 + 1e-4 * rng.normal(0, 1, 400)]
    )
    quick, slow = Block(), Block()
    quick.along(points)
    for a, b in itertools.pairwise(points):
        slow.cut(a, b, False)
    assert quick.height == pytest.approx(slow.height, abs=1e3 * ROUNDOFF * 0.005)


@pytest.mark.parametrize("slope", [-0.1, 0.1])
def test_floor_of_a_ramp(slope: float) -> None:
    """A flat end mill leaves the height it had when its rear edge passed (going down) or its front edge (going up)."""
    block = Block()
    x = np.arange(-0.045, 0.045, 1e-4)
    block.along(np.column_stack([x, 0 * x, -0.006 + slope * x]))
    heights = block.height.reshape(block.ny, block.nx)
    centres = (np.arange(block.nx) + 0.5) * block.grid[2] - LX / 2
    expected = -0.006 + slope * centres - abs(slope) * RADIUS
    # one step and half a cell along the slope
    assert np.abs(heights[block.ny // 2] - expected).max() < abs(slope) * (1e-4 + 1e-4)


def test_a_long_slanted_move_is_cut_in_pieces() -> None:
    block = Block()
    block.cut((-0.04, 0.0, -0.002), (0.04, 0.0, -0.010))
    row = block.height.reshape(block.ny, block.nx)[block.ny // 2]
    assert row[0] > -0.005
    assert row[-1] < -0.008
    assert np.all(np.diff(row) <= 0.0)


def test_cutting_through_leaves_the_bottom() -> None:
    block = Block()
    block.cut((0, 0, 0.01), (0, 0, -0.05))
    assert block.height.min() == BOTTOM


def test_wall_between_cells_is_known_to_a_fraction_of_a_cell() -> None:
    """The area mean across a wall at y = 4.05 mm + R, cell by cell, recovers its place."""
    block = Block()
    for offset in np.linspace(0.0, 2e-4, 7):
        block.height[:] = 0.0
        block.cut((-0.05, 0.004 + offset, -0.004), (0.05, 0.004 + offset, -0.004))
        column = block.height.reshape(block.ny, block.nx)[:, block.nx // 2]
        width = -column.sum() / 0.004 * block.grid[3]
        assert width == pytest.approx(2 * RADIUS, rel=100 * ROUNDOFF)
        upper = (column[block.ny // 2 + 20 :] / -0.004).sum() * block.grid[3] + 20 * block.grid[3]
        assert upper == pytest.approx(0.004 + offset + RADIUS, rel=100 * ROUNDOFF)


# ---------------------------------------------------------------- engagement
def slot_into(block: Block, angle: float, length: float = 0.014, depth: float = 0.01, offset: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Mill a slot of 0.1 mm steps up to the middle of the block; tip position and direction."""
    direction = np.array([math.cos(angle), math.sin(angle)])
    side = offset * np.array([-direction[1], direction[0]])
    points = np.column_stack([side + np.arange(-length, 1e-5, 1e-4)[:, None] * direction, np.full(round(length / 1e-4) + 1, -depth)])
    block.along(points)
    return points[-1] + np.array([*(1e-4 * direction), 0.0]), direction


@pytest.mark.parametrize("angle", [0.0, 17.0, 45.0, 90.0, 163.0, -120.0])
def test_slot_engages_the_whole_front_half(angle: float) -> None:
    """Half a cell of partial cover, one of interpolation and 1.5 cells of ring leave no cell that was not reached wholly."""
    block = Block()
    depth = block.engagement(*slot_into(block, math.radians(angle)))
    assert depth == pytest.approx(0.01, rel=ROUNDOFF)


@pytest.mark.parametrize("width", [0.001, 0.004, 0.008, 0.013])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("angle", [0.0, 30.0])
def test_wall_beside_the_path_bounds_the_engagement(width: float, side: float, angle: float) -> None:
    """Radial width seen = integral of the depth over the lateral coordinate; right to a tenth of a cell and a bin of two degrees."""
    block = Block()
    a = math.radians(angle)
    direction = np.array([math.cos(a), math.sin(a)])
    left = np.array([-direction[1], direction[0]])
    first = np.column_stack([np.outer([-0.1, 0.1], direction) + side * (1.3e-4 - width) * left, [-0.01, -0.01]])
    block.cut(first[0], first[1])  # leaves a wall at `width` inside the next pass
    position, direction = slot_into(block, a, offset=side * 1.3e-4)
    depth = block.engagement(position, direction)
    lateral = RADIUS * np.cos(np.arange(BINS + 1) * math.pi / BINS)
    seen = float((depth * -np.diff(lateral)).sum() / 0.01)
    assert seen == pytest.approx(width, abs=discretisation(0.1, 2e-4, 1) + RADIUS * discretisation(1.0, math.pi / BINS, 2))
    assert (depth[:20].mean() > depth[-20:].mean()) == (side > 0)  # material on the left: small phi


def test_a_wall_across_the_path_is_met_where_the_edge_is() -> None:
    """From a slot, its end wall is met by the edge at phi when x + R sin(phi) passes it, to a cell of partial cover and interpolation."""
    wall = 0.01
    block = Block()
    block.cut((wall - RADIUS, -0.1, -0.01), (wall - RADIUS, 0.1, -0.01))
    block.leave()
    for x in wall - RADIUS + np.arange(1e-4, 4e-3, 3e-4):
        block.follow((x, 0.0, -0.01))
        depth = block.engagement((x, 0.0, -0.01), (1.0, 0.0))
        inside = x + RADIUS * SINES - wall
        assert depth[inside > 2e-4] == pytest.approx(0.01, rel=ROUNDOFF)
        assert not depth[inside < -2e-4].any()


@pytest.mark.parametrize("turn", [20.0, 60.0, 90.0, -90.0, 130.0, 180.0])
def test_after_a_corner_edges_meet_what_is_outside_of_the_way(turn: float) -> None:
    """Edges outside of the way meet material, those CLEAR cells within and more meet none: right behind the corner and later."""
    block = Block()
    corner = np.array([1e-3, -2e-3])
    a = math.radians(turn)
    direction = np.array([math.cos(a), math.sin(a)])
    points = np.vstack(
        [corner + np.outer(np.arange(-0.02, 0.0, 1e-4), [1.0, 0.0]), corner + np.outer(np.arange(0.0, 0.012, 1e-4), direction)]
    )
    tips = np.column_stack([points, np.full(len(points), -0.005)])
    block.cut(tips[0], tips[0])
    for i in range(1, len(tips)):
        block.cut(tips[i - 1], tips[i], True)
        if i < 200 or i % 7:
            continue
        depth = block.engagement(tips[i], direction)
        edge = points[i] + RADIUS * (np.outer(SINES, direction) + np.outer(COSINES, [-direction[1], direction[0]]))
        way = points[: i + 1 - round(workpiece.OWN / 1e-4)]
        outside = np.min(np.hypot(*(edge[:, None, :] - way).T), axis=0) - RADIUS
        assert depth[outside > 3e-4] == pytest.approx(0.005, rel=ROUNDOFF)
        assert not depth[outside < -workpiece.CLEAR * 2e-4 - 3e-4].any()


def test_a_tool_that_springs_back_stays_at_the_front_of_its_cut() -> None:
    """By half of OWN, there and back, all edges stay engaged; by a good millimetre the one in front is free."""
    block = Block()
    tip, direction = slot_into(block, 0.3)
    back = np.array([*direction, 0.0])
    assert block.engagement(tip - 0.5 * workpiece.OWN * back, direction) == pytest.approx(0.01, rel=ROUNDOFF)
    assert not block.engagement(tip - 1.05e-3 * back, direction)[44:46].any()


@pytest.mark.parametrize(("swing", "whole"), [(0.9, True), (4.0, False)])
def test_a_tool_that_swings_sideways_by_less_than_the_clear_cells_has_the_whole_arc(swing: float, whole: bool) -> None:
    block = Block()
    x = np.arange(-0.02, 1e-5, 1e-4)
    y = swing * workpiece.CLEAR * 2e-4 * np.sin(2.0 * math.pi * x / 1.6e-3) / 2.0  # from one side to the other within the trail
    tips = np.column_stack([x, y, np.full(len(x), -0.01)])
    block.along(tips)
    for side in (-1.0, 1.0):
        depth = block.engagement(tips[-1] + [1e-4, side * swing * workpiece.CLEAR * 1e-4, 0.0], (1.0, 0.0))
        assert bool(np.all(depth > 0.009)) is whole  # the outermost edge may read a cell that is partly cut


@pytest.mark.parametrize("loss", [0.0, 0.5, 1.0])
def test_an_edge_that_has_moved_back_loses_its_chips_by_the_loss(loss: float) -> None:
    """The tool moves to its left: the outermost edge at its right is free once it has left its last cut by its share of the clear cells."""
    block = Block()
    x = np.arange(-0.02, 1e-5, 1e-4)
    block.along(np.column_stack([x, 0.0 * x, np.full(len(x), -0.01)]))
    kept = (1.0 - loss) * workpiece.CLEAR * 2e-4
    for shift, free in ((kept, False), (kept + 3e-4, True)):  # 0.2 mm: the nearest cut is 1.5 mm behind
        assert bool(block.engagement((5e-4, shift, -0.01), (1.0, 0.0), loss)[-1] == 0.0) is free


def test_what_was_noted_is_cut_when_the_tool_leaves() -> None:
    """The field that the edges read is then the workpiece, but for scallops between places and what is lowered within a place."""
    block = Block()
    x = np.arange(-0.045, 0.0, 1e-4)
    block.along(np.column_stack([x, 0.004 * np.sin(x / 0.01), 0 * x - 0.006]))
    assert np.abs(block.lagging - block.height).max() > 0.005
    block.leave()
    scallop = 4e-4**2 / (8 * RADIUS)  # places lie between one cell and two from each other
    assert np.abs(block.lagging - block.height).max() < 0.006 * scallop / 2e-4 + ROUNDOFF


def test_existing_slot_of_the_same_width_is_almost_free() -> None:
    block = Block()
    block.cut((-0.1, 0.0, -0.01), (0.1, 0.0, -0.01))
    block.leave()
    depth = block.engagement((0.0, 0.0, -0.01), (1.0, 0.0))
    assert not depth[10:-10].any()
    # half of the edges within a cell of either side
    assert depth.sum() / 0.01 / BINS < math.acos(1 - 2e-4 / RADIUS) / math.pi


def test_air_in_front_of_the_block_and_above_it() -> None:
    block = Block()
    assert not block.engagement((-LX / 2 - RADIUS - 2e-4, 0, -0.01), (1.0, 0.0)).any()
    assert not block.engagement((0.0, 0.0, 0.0), (1.0, 0.0)).any()


def test_entry_grows_with_the_segment_that_is_inside() -> None:
    """The front of the cutter is 2 mm inside: cos(phi) between +-sqrt(R^2 - 6^2)/R."""
    block = Block()
    depth = block.engagement((-LX / 2 - 0.006, 0.0, -0.01), (1.0, 0.0))
    lateral = RADIUS * np.cos(np.arange(BINS + 1) * math.pi / BINS)
    seen = float((depth * -np.diff(lateral)).sum() / 0.01)
    assert seen == pytest.approx(2 * math.sqrt(RADIUS**2 - 0.006**2), abs=discretisation(0.5, 2e-4, 1))  # half a cell


def test_contact_of_the_end_face_fades_with_the_gap() -> None:
    block = Block()
    grid = block.grid

    def contact(x: float, z: float) -> float:
        return float(workpiece.contact(block.height, *grid, x, 0.0, z, RADIUS, BOTTOM, 1e-4))

    assert contact(0.0, -1e-3) == 1.0
    assert contact(0.0, 0.0) == 1.0
    assert contact(0.0, 4e-5) == pytest.approx(0.6, rel=ROUNDOFF * 100)
    assert contact(0.0, 1e-4) == 0.0
    assert contact(LX / 2, 0.0) == pytest.approx(0.5, abs=discretisation(0.5, 1 / 9, 1))  # half over the edge, nine columns of probes
    block.height[:] = BOTTOM
    assert contact(0.0, BOTTOM - 1e-3) == 0.0  # cut through: nothing to stand on


def test_depth_under_a_tool_counts_cells_that_it_covers_wholly() -> None:
    block = Block()
    block.cut((0.0011, -0.0007, -0.004), (0.0011, -0.0007, -0.004))
    depth = njit(**COMPILER_OPTIONS)(workpiece.covered_depth)

    def covered(x: float, y: float, z: float, radius: float) -> float:
        return float(depth(block.height, *block.grid, BOTTOM, x, y, z, radius))

    assert covered(0.0011, -0.0007, -0.004, RADIUS) == EXACT  # in its own hole
    assert covered(0.0011, -0.0007, -0.004, RADIUS + 3e-4) == pytest.approx(0.004, rel=ROUNDOFF)
    assert covered(0.0011, -0.0007, 0.0, RADIUS + 3e-4) == EXACT
    assert covered(0.0, 0.0, -0.006, 0.001) == pytest.approx(0.002, rel=ROUNDOFF)
    assert covered(0.1, 0.0, -0.006, RADIUS) == EXACT  # beside the block
    assert covered(0.0, 0.0, -0.006, 5e-5) == EXACT  # covers no cell wholly


def test_touches_is_a_bounding_box() -> None:
    grid = Block().grid
    assert workpiece.touches(*grid, 0.0, -0.05, 0.0, -0.01, 0.05, 0.0, -0.01, RADIUS)
    assert not workpiece.touches(*grid, 0.0, -0.05, 0.0, 0.01, 0.05, 0.0, 0.01, RADIUS)
    for sign in (1.0, -1.0):
        assert not workpiece.touches(*grid, 0.0, sign * 0.039, 0.0, -0.01, sign * 0.05, 0.0, -0.01, RADIUS)
        assert not workpiece.touches(*grid, 0.0, 0.0, sign * 0.034, -0.01, 0.0, sign * 0.05, -0.01, RADIUS)


def test_interpolation_is_linear_and_holds_at_the_edges() -> None:
    block = Block(1e-3)
    nx, ny, dx, dy = block.grid
    x = (np.arange(nx) + 0.5) * dx - LX / 2
    y = (np.arange(ny) + 0.5) * dy - LY / 2
    block.height[:] = (0.3 * x[None, :] - 0.2 * y[:, None]).ravel()
    rng = np.random.default_rng(2)
    for px, py in rng.uniform([x[0], y[0]], [x[-1], y[-1]], (100, 2)):
        value = workpiece.height_at(block.height, *block.grid, px, py)
        assert value == pytest.approx(0.3 * px - 0.2 * py, abs=ROUNDOFF)
    assert workpiece.height_at(block.height, *block.grid, 1.0, 1.0) == pytest.approx(0.3 * x[-1] - 0.2 * y[-1], abs=ROUNDOFF)
