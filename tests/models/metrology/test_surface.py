"""The scanner: paths whose surface is known by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.models.metrology.height_map import cut_height_map
from robomill.models.metrology.surface import NothingCutError, SurfaceDeviation, measure
from robomill.models.metrology.tool_path import ToolPath
from tests.tolerances import ROUNDOFF, discretisation

RADIUS, SIZE = 0.008, (0.10, 0.06, 0.03)
STEP = 1e-4
MICRO = ROUNDOFF * 0.1
"""Roundoff of coordinates of the size of the block, m."""


def line(*corners: tuple[float, float, float]) -> np.ndarray:
    """Positions every 0.1 mm along a polyline."""
    pieces = []
    for a, b in zip(np.array(corners[:-1]), np.array(corners[1:]), strict=True):
        n = max(1, round(float(np.linalg.norm(b - a)) / STEP))
        pieces.append(a + np.arange(n)[:, None] / n * (b - a))
    return np.vstack([*pieces, np.array(corners[-1])])


def upright(position: np.ndarray, radius: float = RADIUS) -> ToolPath:
    return ToolPath.upright(np.arange(len(position)) * 0.004, position, radius)


def moved(path: np.ndarray, x: float, y: float, z: float) -> np.ndarray:
    return path + np.array([x, y, z])


def nearest_shifted_circle(angle: np.ndarray, x: float, y: float) -> np.ndarray:
    """Shortest distance between the nominal circle and one shifted by (x, y), exactly.

    Left: from the nominal circle at `angle` to the machined one. Gouged: from where the normal there meets the machined circle
    back to the nominal one.
    """
    along, across = x * np.cos(angle) + y * np.sin(angle), x * np.sin(angle) - y * np.cos(angle)
    left = np.hypot(RADIUS - along, across) - RADIUS
    gouged = RADIUS - along - np.sqrt(RADIUS**2 - across**2)
    return np.where(left > 0.0, left, gouged)


def compare(nominal: np.ndarray, actual: np.ndarray, **options: float) -> SurfaceDeviation:
    return measure(upright(nominal), upright(actual), SIZE, **options)


SLOT = line((-0.07, 0, -0.01), (0.07, 0, -0.01))


def test_the_nominal_path_has_no_deviation() -> None:
    m = compare(SLOT, SLOT)
    assert m.max == pytest.approx(0.0, abs=MICRO)
    assert set(m.kind) == {"wall", "floor"}
    assert np.all(np.abs(m.points) <= np.array([0.05, 0.03, 0.03]))


@pytest.mark.parametrize("d", [3e-4, -1.234567e-3])
def test_lateral_offset_gouges_one_wall_and_leaves_material_on_the_other(d: float) -> None:
    m = compare(SLOT, moved(SLOT, 0.0, d, 0.0))
    left, right = m.select(m.wall & (m.points[:, 1] > 0)), m.select(m.wall & (m.points[:, 1] < 0))
    assert left.deviation == pytest.approx(-d, abs=MICRO)
    assert right.deviation == pytest.approx(d, abs=MICRO)
    assert left.normal == pytest.approx(np.tile([0.0, -1.0, 0.0], (len(left.normal), 1)), abs=MICRO)  # out of the material, into the slot
    assert m.floors.max == pytest.approx(0.0, abs=MICRO)
    assert (m.max, m.walls.rms, m.walls.p95) == pytest.approx((abs(d),) * 3, rel=1e3 * ROUNDOFF)
    assert m.wall[m.worst]


def test_lifted_tool_leaves_the_floor_high_and_the_walls_as_they_are() -> None:
    m = compare(SLOT, moved(SLOT, 0.0, 0.0, 2e-4))
    assert m.floors.deviation == pytest.approx(2e-4, abs=MICRO)
    assert m.walls.max == pytest.approx(0.0, abs=MICRO)


@pytest.mark.parametrize("slope", [-0.1, 0.1])
def test_ramp_is_measured_square_to_its_floor(slope: float) -> None:
    """A flat end mill leaves z = slope x - |slope| sqrt(R^2 - y^2): inclined along the way, and across it towards the sides."""
    path = SLOT.copy()
    path[:, 2] = -0.01 + slope * path[:, 0]
    lift = 1e-4
    m = compare(path, moved(path, 0.0, 0.0, lift)).floors
    m = m.select(np.abs(m.points[:, 0]) < 0.05 - RADIUS)
    x, y, z = m.points.T
    assert z == pytest.approx(-0.01 + slope * x - abs(slope) * np.sqrt(RADIUS**2 - y**2), abs=MICRO)
    tilt = math.atan(slope)
    assert m.normal == pytest.approx(np.tile([-math.sin(tilt), 0.0, math.cos(tilt)], (len(m.normal), 1)), abs=MICRO)
    across = slope * y / np.sqrt(RADIUS**2 - y**2)
    # to first order in lift / R: the curvature of the floor across is |slope| / R and grows towards the sides
    curvature = abs(slope) * RADIUS**2 / (RADIUS**2 - y**2) ** 1.5
    assert np.max(np.abs(m.deviation * np.sqrt(1.0 + slope**2 + across**2) / lift - 1.0) - lift * curvature) <= 0.0


def test_wall_follows_a_wave_sharper_than_a_dexel() -> None:
    """20 um sin(2 pi x / 20 mm): the cutter's envelope leaves the wave itself, but for its curvature (2 um / R) terms."""
    wave = SLOT.copy()
    wave[:, 1] = 2e-5 * np.sin(2 * np.pi * wave[:, 0] / 0.02)
    m = compare(SLOT, wave).walls
    left = m.select(m.points[:, 1] > 0)
    slope = 2e-5 * 2 * np.pi / 0.02
    # envelope of discs: exact to second order in the slope times the radius
    assert left.deviation == pytest.approx(
        -2e-5 * np.sin(2 * np.pi * left.points[:, 0] / 0.02), abs=discretisation(0.51 * RADIUS, slope, 2)
    )


def test_circular_pocket_with_too_large_a_radius() -> None:
    """The outer wall is gouged, the island in the middle keeps material."""
    angle = np.linspace(0.0, 2 * np.pi, 1257)
    r, error = 0.012, 1e-4
    circle = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(len(angle), -0.005)])
    m = compare(circle, circle * [1 + error / r, 1 + error / r, 1.0]).walls
    at = np.hypot(m.points[:, 0], m.points[:, 1])
    chord = angle[1] - angle[0]
    sagitta = (r + error) * chord**2 / 8 + RADIUS * chord**2 / 2  # of the path, and of the island that the chords' sides enclose
    inner = m.select(np.abs(at - r + RADIUS) < 1e-5)  # chords: points that others cover by up to COVER_TOLERANCE
    outer = m.select(np.abs(at - r - RADIUS) < 1e-5)
    assert len(outer.deviation) + len(inner.deviation) == len(m.deviation)
    assert outer.deviation == pytest.approx(-error, abs=sagitta)
    assert inner.deviation == pytest.approx(error, abs=sagitta)


def test_plunge_is_measured_all_around() -> None:
    hole = np.array([[0, 0, 0.005], [0, 0, -0.002], [0, 0, -0.004], [0, 0, 0.005]])
    bottom = compare(hole, moved(hole, 0.0, 0.0, 1e-4)).floors
    assert bottom.deviation == pytest.approx(1e-4, abs=MICRO)
    assert np.hypot(*bottom.points[:, :2].T).max() > 0.9 * RADIUS
    m = compare(hole, moved(hole, 1e-4, 0, 0)).walls
    angle = np.arctan2(m.points[:, 1], m.points[:, 0])
    assert (
        np.diff(np.unique(np.round(angle, 9))).max() <= 1.001e-3 / RADIUS
    )  # one in each cube of half a millimetre that the wall goes through
    assert m.deviation == pytest.approx(nearest_shifted_circle(angle, 1e-4, 0.0), abs=MICRO)
    assert m.deviation.max() == pytest.approx(1e-4, rel=discretisation(1.0, 0.25e-3 / RADIUS, 2))


def test_walls_that_a_later_pass_removes_are_not_measured() -> None:
    """Two passes 10 mm apart make one groove of 26 mm: two walls, not four; and a crossing slot opens a gap in a wall."""
    two = line((-0.07, -0.005, -0.01), (0.07, -0.005, -0.01), (0.07, 0.005, -0.01), (-0.07, 0.005, -0.01))
    m = compare(two, moved(two, 0.0, 1e-4, 0.0)).walls
    assert set(np.round(m.points[:, 1], 6)) == {-0.013, 0.013}
    assert m.deviation == pytest.approx(-1e-4 * np.sign(m.points[:, 1]), abs=MICRO)
    crossing = line((-0.07, 0, -0.01), (0.07, 0, -0.01), (0.07, 0.05, -0.01), (0, 0.05, -0.01), (0, -0.05, -0.01))
    w = compare(crossing, crossing).walls
    along = w.select(np.abs(np.abs(w.points[:, 1]) - RADIUS) < MICRO)
    assert np.abs(along.points[:, 0]).min() >= RADIUS - 1e-5


def test_deeper_pass_counts_at_its_depth_only() -> None:
    """A shallow wide groove with a deep narrow one inside: the wall of the deep one ends at the shallow floor."""
    path = line(
        (-0.07, -0.005, -0.004), (0.07, -0.005, -0.004), (0.07, 0.005, -0.004), (-0.07, 0.005, -0.004), (-0.07, 0, -0.01), (0.07, 0, -0.01)
    )
    m = compare(path, path)
    deep = m.walls.select(np.abs(np.abs(m.walls.points[:, 1]) - RADIUS) < MICRO)
    assert deep.points[:, 2].max() < -0.004
    floors = m.floors
    assert floors.points[np.abs(floors.points[:, 1]) < RADIUS - 1e-4, 2] == pytest.approx(-0.01, abs=MICRO)


def test_corner_inside_and_outside() -> None:
    """A right-angled turn: round outside, sharp inside; a tool that is shifted diagonally gouges the round by its full shift."""
    path = line((-0.06, 0, -0.01), (0, 0, -0.01), (0, -0.04, -0.01))
    shift = 1e-4 / math.sqrt(2)
    m = compare(path, moved(path, shift, shift, 0.0)).walls
    round_part = m.select((m.points[:, 0] > 1e-6) & (m.points[:, 1] > 1e-6))
    at = np.arctan2(round_part.points[:, 1], round_part.points[:, 0])
    assert round_part.deviation == pytest.approx(nearest_shifted_circle(at, shift, shift), abs=MICRO)
    assert not np.any(
        (m.points[:, 0] > -RADIUS)
        & (m.points[:, 0] < RADIUS - 1e-4)
        & (m.points[:, 1] < -RADIUS + 1e-4)
        & (m.points[:, 1] > -RADIUS - 1e-4)
    )


def test_tilted_tool_leans_the_wall() -> None:
    """1 mrad about x: the wall at height h above the tip is displaced by h tan(1 mrad), h being 2.5 and 7.5 mm."""
    tilt = np.tile([0.0, 1e-3], (len(SLOT), 1))
    m = measure(upright(SLOT), ToolPath(np.arange(len(SLOT)) * 0.004, SLOT, tilt, np.full(len(SLOT), RADIUS)), SIZE).walls
    above = m.points[:, 2] + 0.01
    assert (above.min(), above.max()) == pytest.approx((0.0005, 0.0095), abs=MICRO)
    assert m.deviation == pytest.approx(-1e-3 * above * np.sign(m.points[:, 1]), abs=MICRO)


def test_paths_from_poses() -> None:
    """A block turned by 30 degrees about z in B, a tool leaning by 2 mrad towards y of P."""
    turn = Rotation.from_euler("z", 30, degrees=True)
    p_BP_B = np.array([1.6, -0.02, 1.1])
    p_BT_B = p_BP_B + turn.apply(SLOT)
    upside = Rotation.from_matrix([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # x of T down
    quat = (turn * Rotation.from_euler("x", -2e-3) * upside).as_quat(scalar_first=True)
    path = ToolPath.from_poses(
        np.arange(len(SLOT)) * 0.004, p_BT_B, np.tile(quat, (len(SLOT), 1)), p_BP_B, turn.as_quat(scalar_first=True), RADIUS
    )
    assert path.position == pytest.approx(SLOT, abs=100 * MICRO)
    assert path.tilt == pytest.approx(np.tile([0.0, math.sin(2e-3)], (len(SLOT), 1)), abs=100 * MICRO)


def test_a_cut_that_was_never_made_leaves_its_depth() -> None:
    m = compare(SLOT, moved(SLOT, 0.0, 0.0, 0.05))
    assert m.features.deviation == pytest.approx(0.01, abs=MICRO)  # up to the top of the block, not to the tool above it
    assert np.all(m.edge == m.wall)  # over the whole of the walls the nearest that the tool came is straight above
    assert not m.is_limited


def test_a_cutter_of_another_size_is_measured_whatever_the_difference() -> None:
    wide = measure(upright(SLOT), upright(SLOT, 0.02), SIZE)
    assert wide.walls.deviation == pytest.approx(-0.012, abs=MICRO)
    assert not wide.is_limited
    worn = measure(upright(SLOT), upright(SLOT, 0.0079), SIZE).walls
    assert worn.deviation == pytest.approx(1e-4, abs=MICRO)


def test_points_know_when_the_nominal_tool_made_them() -> None:
    m = compare(SLOT, SLOT).walls
    assert m.path_length == pytest.approx(m.points[:, 0] + 0.07, abs=1e3 * MICRO)
    assert m.path_time == pytest.approx(m.path_length / STEP * 0.004, rel=1e3 * ROUNDOFF)


def test_height_maps_show_the_same_difference_as_the_scan() -> None:
    nominal = cut_height_map(upright(SLOT), SIZE, 5e-4)
    high = cut_height_map(upright(moved(SLOT, 0, 0, 2e-4)), SIZE, 5e-4)
    difference = high.height - nominal.height
    inside = np.abs(nominal.y) < RADIUS - 5e-4
    assert difference[inside] == pytest.approx(2e-4, abs=MICRO)
    assert not difference[np.abs(nominal.y) > RADIUS + 5e-4].any()
    sideways = cut_height_map(upright(moved(SLOT, 0, 3e-4, 0)), SIZE, 5e-4).height - nominal.height
    # volume moved from one wall to the other, per length: depth times shift
    per_length = sideways.sum(axis=0) * (nominal.y[1] - nominal.y[0])
    assert per_length == pytest.approx(0.0, abs=1e3 * MICRO * 0.01)
    left = sideways[nominal.y > 0].sum(axis=0) * (nominal.y[1] - nominal.y[0])
    assert left == pytest.approx(-3e-4 * 0.01, rel=discretisation(1.0, 5e-4 / RADIUS, 2))


# ---------------------------------------------------------------- errors
def test_bad_paths_are_refused() -> None:
    with pytest.raises(ValueError, match=r"position \(3, 2\).*radius \(3,\); expected \(n,\), \(n, 3\), \(n, 2\), \(n,\)"):
        ToolPath(np.arange(3.0), np.zeros((3, 2)), np.zeros((3, 2)), np.ones(3))
    with pytest.raises(ValueError, match="1 positions; at least 2"):
        ToolPath.upright([0.0], np.zeros((1, 3)), RADIUS)
    with pytest.raises(ValueError, match="position holds values that are not finite"):
        ToolPath.upright([0.0, 1.0], [[0, 0, 0], [0, np.nan, 0]], RADIUS)
    with pytest.raises(ValueError, match=r"radius 0\.0 m; expected more than 0"):
        ToolPath.upright([0.0, 1.0], np.zeros((2, 3)), 0.0)


def test_bad_questions_are_refused() -> None:
    with pytest.raises(ValueError, match=r"spacing 0\.0 m: expected more than 0"):
        compare(SLOT, SLOT, spacing=0.0)
    with pytest.raises(ValueError, match="expected three positive lengths"):
        measure(upright(SLOT), upright(SLOT), (0.1, 0.06))
    with pytest.raises(ValueError, match=r"none of the .* measured points is selected"):
        compare(SLOT, SLOT).select(np.zeros(1, bool))


@pytest.mark.parametrize("height", [0.0, 1.0, -1e-17])
def test_a_path_that_cuts_nothing_has_no_surface(height: float) -> None:
    """Facing at the top of the block, or far above it: the tool sinks by 0.4 mm all the same."""
    face = line((-0.07, 0, height), (0.07, 0, height))
    with pytest.raises(NothingCutError, match=r"nominal path makes no surface in the block of \(100\.0, 60\.0, 30\.0\) mm; the tip spans"):
        compare(face, moved(face, 0.0, 0.0, -4e-4))


def test_a_wall_beside_a_lifted_ramp_is_as_far_off_as_the_lift_not_as_the_next_wall() -> None:
    ramp = SLOT.copy()
    ramp[:, 2] = np.interp(np.arange(len(SLOT)), [0, len(SLOT) - 1], [0.001, -0.008])
    lift = 5e-4
    m = compare(ramp, moved(ramp, 0.0, 0.0, lift))
    # a flat end mill on a ramp leaves a floor that falls by the slope over the chord of the cutter: never more than the lift
    assert m.max <= lift + MICRO
    assert m.max > 0.5 * lift


# ---------------------------------------------------------------- edges, corners, limits
BOSS = line((-0.07, -0.028, -0.01), (0.028, -0.028, -0.01), (0.028, 0.028, -0.01), (-0.028, 0.028, -0.01), (-0.028, -0.07, -0.01))
PART = (0.12, 0.10, 0.03)


def pushed(path: np.ndarray, outward: float) -> np.ndarray:
    """Every side of the boss displaced along its outward normal."""
    result = path.copy()
    for axis in (0, 1):
        side = np.abs(path[:, axis]) >= 0.028 - 1e-9
        result[side, axis] += outward * np.sign(path[side, axis])
    return result


@pytest.mark.parametrize("outward", [3.5e-4, -3.5e-4, 1.9e-4])
def test_no_ray_runs_along_the_gouge_of_a_neighbour(outward: float) -> None:
    """A boss of 40 mm: an outside corner is no deeper than the walls that meet there (rays ran to their limit of 4 mm)."""
    m = measure(upright(BOSS), upright(pushed(BOSS, outward)), PART)
    assert (
        abs(outward) <= m.max <= math.sqrt(2.0) * abs(outward) + MICRO
    )  # in the corners of the groove around it the tool is off both ways
    boss = m.walls.select((np.abs(m.walls.points[:, :2]) < 0.0201).all(axis=1))
    assert boss.deviation == pytest.approx(outward, abs=MICRO)
    assert not m.is_limited


def test_no_point_is_further_off_than_the_tool_was() -> None:
    """Whatever the part: each point of one surface was made by a tool that stood within its error of the other's."""
    error = np.column_stack(
        [np.sin(0.011 * np.arange(len(BOSS))), np.cos(0.007 * np.arange(len(BOSS))), np.sin(0.005 * np.arange(len(BOSS)))]
    )
    error *= [6e-4, 6e-4, 2e-4]
    m = measure(upright(BOSS), upright(BOSS + error), PART)
    assert np.abs(m.deviation).max() <= np.linalg.norm(error, axis=1).max()
    assert m.max > 6e-4


def test_a_floor_beside_a_displaced_wall_does_not_count_with_the_depth_of_the_pocket() -> None:
    """20 mm deep, the tool 2.5 mm aside: 2.5 mm, on the walls alone."""
    deep = line((-0.07, 0, -0.02), (0.07, 0, -0.02))
    m = compare(deep, moved(deep, 0.0, 2.5e-3, 0.0))
    assert m.walls.deviation == pytest.approx(-2.5e-3 * np.sign(m.walls.points[:, 1]), abs=MICRO)
    assert m.floors.max == pytest.approx(0.0, abs=MICRO)
    strip = m.select(m.edge)
    assert np.all(strip.points[:, 1] < -RADIUS + 2.5e-3)  # what the wall now stands on
    assert strip.deviation.max() <= 2.5e-3


def test_a_wall_lower_than_its_deviation_is_measured_all_the_same() -> None:
    shallow = line((-0.07, 0, -0.0005), (0.07, 0, -0.0005))
    m = compare(shallow, moved(shallow, 0.0, 1.3e-3, 0.0))
    assert m.walls.deviation == pytest.approx(-1.3e-3 * np.sign(m.walls.points[:, 1]), abs=MICRO)


def test_a_thin_wall_that_is_gone_is_off_by_half_of_it_at_least() -> None:
    """Two pockets 1 mm apart, each tool 2 mm too far: nothing is left to measure to."""
    sides = line((-0.07, 0.0085, -0.01), (0.07, 0.0085, -0.01), (0.07, -0.0085, -0.01), (-0.07, -0.0085, -0.01))
    gone = sides * [1.0, 0.0065 / 0.0085, 1.0]
    m = compare(sides, gone)
    fin = np.abs(m.points[:, 1]) < 0.0006
    assert m.deviation[fin & m.wall] == pytest.approx(-5e-4, abs=MICRO)
    assert np.all(m.limited[fin & m.wall])
    assert m.is_limited
    assert m.max == pytest.approx(2e-3, abs=MICRO)  # of the outer walls, which the fin may exceed
    thinner = compare(sides, sides * [1.0, 0.0083 / 0.0085, 1.0])
    assert not thinner.is_limited
    assert thinner.walls.max == pytest.approx(2e-4, abs=MICRO)


def test_passes_a_diameter_apart_leave_no_wall_between_them() -> None:
    touching = line((-0.07, RADIUS, -0.01), (0.07, RADIUS, -0.01), (0.07, -RADIUS, -0.01), (-0.07, -RADIUS, -0.01))
    m = compare(touching, touching)
    assert np.abs(m.walls.points[:, 1]) == pytest.approx(2 * RADIUS, abs=MICRO)


def test_the_rim_of_the_block_that_is_gone_is_a_limit() -> None:
    beside = line((-0.07, 0.021, -0.01), (0.07, 0.021, -0.01))  # leaves 1 mm of the block
    m = compare(beside, moved(beside, 0.0, 2.5e-3, 0.0))
    rim = m.wall & (m.points[:, 1] > 0.028)
    assert m.deviation[rim] == pytest.approx(-1e-3, abs=MICRO)
    assert np.all(m.limited[rim])
    assert m.is_limited


def test_a_scratch_in_the_raw_top_is_seen() -> None:
    """The tool comes down between two cuts, where nothing nominal is: a way back 0.2 mm above the block that is flown 0.3 mm too low."""
    path = line((-0.07, -0.02, -0.01), (0.07, -0.02, -0.01), (0.07, 0.015, 2e-4), (-0.07, 0.015, 2e-4))
    low = path.copy()
    low[path[:, 1] > 0.0149, 2] -= 3e-4
    m = compare(path, low)
    assert m.max == pytest.approx(1e-4, abs=MICRO)
    assert np.all(np.abs(m.points[m.worst, 1:] - [0.015, 0.0]) <= RADIUS)
    assert m.deviation[m.worst] < 0.0


def test_a_hole_in_the_floor_is_as_deep_as_its_bottom() -> None:
    dive = line((-0.07, 0, -0.01), (0, 0, -0.01), (0, 0, -0.025), (0, 0, -0.01), (0.07, 0, -0.01))
    m = compare(SLOT, dive)
    assert m.max == pytest.approx(0.015, abs=MICRO)


def test_a_skin_left_under_a_through_cut_is_seen() -> None:
    through = line((-0.07, 0, -0.031), (0.07, 0, -0.031))
    m = compare(through, moved(through, 0.0, 0.0, 1.4e-3))
    assert m.floors.deviation == pytest.approx(4e-4, abs=MICRO)
    assert compare(through, through).wall.all()


@pytest.mark.parametrize("diameter", [0.001, 0.003, 0.0079, 0.063])
def test_every_tool_from_1_to_63_mm(diameter: float) -> None:
    r = 0.5 * diameter
    path = line((-0.09, 0, -0.002), (0.09, 0, -0.002))
    m = measure(upright(path, r), upright(moved(path, 0.0, 1e-4, -5e-5), r), (0.1, 0.1, 0.02))
    assert m.walls.deviation == pytest.approx(-1e-4 * np.sign(m.walls.points[:, 1]), abs=MICRO)
    assert m.floors.deviation == pytest.approx(-5e-5, abs=MICRO)


def test_each_sample_has_the_radius_of_its_tool() -> None:
    """A slot of 16 mm, then one of 6 mm beside it."""
    two = line(
        (-0.07, -0.015, -0.01),
        (0.07, -0.015, -0.01),
        (0.07, -0.015, 0.01),
        (-0.07, 0.015, 0.01),
        (-0.07, 0.015, -0.01),
        (0.07, 0.015, -0.01),
    )
    radius = np.where(np.arange(len(two)) < np.argmax(two[:, 2] > 0.0099), RADIUS, 0.003)
    path = upright(two, radius)
    m = measure(path, upright(moved(two, 0.0, 1e-4, 0.0), radius), SIZE).walls
    assert set(np.round(m.points[:, 1], 9)) == {-0.023, -0.007, 0.012, 0.018}
    assert np.abs(m.deviation) == pytest.approx(1e-4, abs=MICRO)
    assert cut_height_map(path, SIZE, 5e-4).height.sum() == pytest.approx(
        -0.01 * 0.1 * 0.022 / 2.5e-7, rel=discretisation(1.0, 5e-4 / 0.003, 2)
    )


def test_an_inclined_end_face_leaves_an_inclined_floor() -> None:
    """Leaning by 1 mrad against the feed, the tool cuts with its heel R times 1 mrad deeper than its tip, and to the sides less."""
    tilt = np.tile([1e-3, 0.0], (len(SLOT), 1))
    leaning = ToolPath(np.arange(len(SLOT)) * 0.004, SLOT, tilt, np.full(len(SLOT), RADIUS))
    m = measure(upright(SLOT), leaning, SIZE).floors
    m = m.select(np.abs(m.points[:, 0]) < 0.04)
    assert m.deviation == pytest.approx(-1e-3 * np.sqrt(RADIUS**2 - m.points[:, 1] ** 2), abs=discretisation(RADIUS, 1e-3, 2))


def test_a_patch_counts_once_however_often_the_path_passes() -> None:
    again = np.vstack([SLOT, SLOT[::-1], SLOT])
    once, thrice = (compare(path, moved(path, 0.0, 1e-4, 0.0)) for path in (SLOT, again))
    assert len(thrice.deviation) == len(once.deviation)
    assert thrice.path_time.min() > once.path_time.max()  # the last pass made it
