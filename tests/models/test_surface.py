"""The scanner: paths whose surface is known by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from models.height_map import cut_height_map
from models.surface import NothingCutError, SurfaceDeviation, measure
from models.tool_path import ToolPath
from tests.tolerances import EXACT, ROUNDOFF, discretisation

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


def shifted_circle(angle: np.ndarray, x: float, y: float) -> np.ndarray:
    """Deviation seen along rays at `angle` from the nominal circle to one shifted by (x, y), exactly."""
    along, across = x * np.cos(angle) + y * np.sin(angle), x * np.sin(angle) - y * np.cos(angle)
    return RADIUS - along - np.sqrt(RADIUS**2 - across**2)


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
def test_ramp_is_measured_along_its_normal(slope: float) -> None:
    path = SLOT.copy()
    path[:, 2] = -0.01 + slope * path[:, 0]
    m = compare(path, moved(path, 0.0, 0.0, 1e-4)).floors
    tilt = math.atan(slope)
    # heights come from differences over 0.1 mm
    assert m.deviation == pytest.approx(1e-4 * math.cos(tilt), abs=1e4 * MICRO)
    assert m.normal == pytest.approx(np.tile([-math.sin(tilt), 0.0, math.cos(tilt)], (len(m.normal), 1)), abs=1e9 * MICRO)
    # the flat end mill cuts |slope| R deeper than its centre line
    centre = m.select(np.abs(m.points[:, 1]) < MICRO)
    assert centre.points[:, 2] == pytest.approx(-0.01 + slope * centre.points[:, 0] - abs(slope) * RADIUS, abs=1e4 * MICRO)


def test_wall_follows_a_wave_sharper_than_a_dexel() -> None:
    """20 um sin(2 pi x / 20 mm): the cutter's envelope leaves the wave itself, but for its curvature (2 um / R) terms."""
    wave = SLOT.copy()
    wave[:, 1] = 2e-5 * np.sin(2 * np.pi * wave[:, 0] / 0.02)
    m = compare(SLOT, wave).walls
    left = m.select(m.points[:, 1] > 0)
    slope = 2e-5 * 2 * np.pi / 0.02
    # envelope of discs: exact to second order in the slope times the radius
    assert left.deviation == pytest.approx(-2e-5 * np.sin(2 * np.pi * left.points[:, 0] / 0.02), abs=0.51 * RADIUS * slope**2)


def test_circular_pocket_with_too_large_a_radius() -> None:
    """The outer wall is gouged, the island in the middle keeps material."""
    angle = np.linspace(0.0, 2 * np.pi, 1257)
    r, error = 0.012, 1e-4
    circle = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(len(angle), -0.005)])
    m = compare(circle, circle * [1 + error / r, 1 + error / r, 1.0]).walls
    at = np.hypot(m.points[:, 0], m.points[:, 1])
    chord = angle[1] - angle[0]
    sagitta = (r + error) * chord**2 / 8 + RADIUS * chord**2 / 2  # of the path, and of the island that the chords' sides enclose
    outer, inner = m.select(np.abs(at - r - RADIUS) < 1e-6), m.select(np.abs(at - r + RADIUS) < 1e-6)
    assert len(outer.deviation) + len(inner.deviation) == len(m.deviation)
    assert outer.deviation == pytest.approx(-error, abs=sagitta)
    assert inner.deviation == pytest.approx(error, abs=sagitta)


def test_plunge_is_measured_all_around() -> None:
    hole = np.array([[0, 0, 0.005], [0, 0, -0.002], [0, 0, -0.004], [0, 0, 0.005]])
    m = compare(hole, moved(hole, 1e-4, 0, 0)).walls
    assert len(m.deviation) == 2 * 72
    angle = np.arctan2(m.points[:, 1], m.points[:, 0])
    assert m.deviation == pytest.approx(shifted_circle(angle, 1e-4, 0.0), abs=MICRO)
    assert m.deviation.max() == pytest.approx(1e-4, abs=MICRO)


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
    assert round_part.deviation == pytest.approx(shifted_circle(at, shift, shift), abs=MICRO)
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
    assert set(np.round(above, 6)) == {0.0025, 0.0075}
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


def test_a_cut_that_was_never_made_and_one_far_too_wide_end_at_the_reach() -> None:
    air = moved(SLOT, 0.0, 0.0, 0.05)
    m = compare(SLOT, air)
    # the nearest surface above a wall point of a slot that was never cut is the top of the block
    assert m.walls.deviation == pytest.approx(np.minimum(4e-3, -m.walls.points[:, 2]), abs=EXACT)
    assert m.floors.deviation == pytest.approx(0.01, abs=MICRO)
    wide = measure(upright(SLOT), upright(SLOT), RADIUS, SIZE, actual_radius=0.02).walls
    assert wide.deviation == pytest.approx(-4e-3, abs=EXACT)
    worn = measure(upright(SLOT), upright(SLOT), RADIUS, SIZE, actual_radius=0.0079).walls
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
    with pytest.raises(ValueError, match=r"position \(3, 2\).*expected \(n,\), \(n, 3\), \(n, 2\)"):
        ToolPath.upright(np.arange(3.0), np.zeros((3, 2)))
    with pytest.raises(ValueError, match="1 positions; at least 2"):
        ToolPath.upright([0.0], np.zeros((1, 3)))
    with pytest.raises(ValueError, match="position holds values that are not finite"):
        ToolPath.upright([0.0, 1.0], [[0, 0, 0], [0, np.nan, 0]])


def test_bad_questions_are_refused() -> None:
    with pytest.raises(ValueError, match="makes no surface in the block"):
        compare(moved(SLOT, 0, 0, 1.0), SLOT)
    with pytest.raises(ValueError, match=r"reach 0\.01 m: expected more than 0 and less than the radius"):
        compare(SLOT, SLOT, reach=0.01)
    with pytest.raises(ValueError, match=r"spacing 0\.0 m: expected more than 0"):
        compare(SLOT, SLOT, spacing=0.0)
    with pytest.raises(ValueError, match="expected three positive lengths"):
        measure(upright(SLOT), upright(SLOT), RADIUS, (0.1, 0.06))
    with pytest.raises(ValueError, match=r"none of the .* measured points is selected"):
        compare(SLOT, SLOT).select(np.zeros(1, bool))
    a, b = (cut_height_map(upright(SLOT), RADIUS, SIZE, spacing) for spacing in (1e-3, 2e-3))
    with pytest.raises(ValueError, match="do not lie on each other; use one block and spacing"):
        a.minus(b)


def test_a_wall_beside_a_lifted_ramp_is_as_far_off_as_the_lift_not_as_the_next_wall() -> None:
    ramp = SLOT.copy()
    ramp[:, 2] = np.interp(np.arange(len(SLOT)), [0, len(SLOT) - 1], [0.001, -0.008])
    lift = 5e-4
    m = compare(ramp, moved(ramp, 0.0, 0.0, lift))
    # a flat end mill on a ramp leaves a floor that falls by the slope over the chord of the cutter: never more than the lift
    assert m.max <= lift + MICRO
    assert m.max > 0.5 * lift
