"""tridexel_milling_force: tilted flat, bull nose and ball nose end mills on a workpiece of tri-dexels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from robomill.models.components.milling_force import MODEL as MILLING
from robomill.models.components.tridexel_milling_force import MODEL
from robomill.models.metrology.tridexel_part import Part
from robomill.models.model.declaration import Model, record
from robomill.models.model.parameters import load
from robomill.models.process.cutting import CuttingCoefficients
from tests.tolerances import EXACT, ROUNDOFF

H = 0.004
K = load(CuttingCoefficients, "materials/aw2017")
RADIUS = 0.008
TEETH = 3
UPRIGHT = Rotation.identity()
DOWN = Rotation.from_matrix([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
"""Tool axis (x of T) straight down."""
REV_250 = 250 * 2 * math.pi
"""rad/s: one revolution per 4 ms step, so every step is a whole number of tooth periods."""
FEED = 0.025
CHIP = FEED / (TEETH * 250)
SLOT = 2.5e-3
"""Relative: the height of material is known to a hundredth of a cell (2.5 um of 2 mm), and 3 degrees are added up by their middles."""
TILTED = 4e-3
"""Relative: as SLOT, with elements of 1 mm in height against lines that lie across them."""
ENTRY = 0.75
"""Cells that the tool may still be away from the material it meets (GATE)."""
BALL = 0.01
"""Relative: twelve elements of 7.5 degrees along the nose, the last of which ends in air."""
OUTPUTS = ("f_T_B", "m_T_B", "f_peak", "spindle_torque", "spindle_power", "removal_rate", "depth")
BLOCK = {"block_size": [0.05, 0.04, 0.02]}
EFFECTS = {
    "cutting_coefficient_error": 0.2,
    "tool_wear": 0.4,
    "size_effect_exponent": 0.2,
    "runout": 2e-5,
    "stock_error": 5e-4,
    "engagement_error": 1e-3,
    "workpiece_compliance": 2e-7,
}


class Mill:
    """One instance; positions, velocities and the turn of the tool are given in P, the results read in P too."""

    def __init__(
        self,
        start: Any,
        tool: Rotation = UPRIGHT,
        model: Model = MODEL,
        compiled: bool = True,
        velocity: Any = (0.0, 0.0, 0.0),
        tables: dict[str, Any] | None = None,
        **parameters: Any,
    ) -> None:
        self.model = model
        self.data = model.new()
        self.s = record(self.data)
        self.init, self.step = model.compiled() if compiled else model.plain()
        for name, rows in (tables or {}).items():
            model.load_table(self.data, name, np.asarray(rows, dtype=float))
        for name, value in {**BLOCK, **parameters}.items():
            self.data[name] = value
        self.R_BP = Rotation.from_quat(self.data["quat_BP"][0], scalar_first=True)
        self.data["spindle_speed"] = REV_250
        self.place(start, velocity, tool)
        self.status = self.init(self.s)

    def place(self, position: Any, velocity: Any = (0.0, 0.0, 0.0), tool: Rotation = UPRIGHT) -> None:
        """Set tool tip [m] and commanded feed [m/s] in P, and the turn of the tool from upright."""
        self.data["p_BT_B"] = self.data["p_BP_B"][0] + self.R_BP.apply(np.asarray(position, dtype=float))
        self.data["v_BT_B"] = self.R_BP.apply(np.asarray(velocity, dtype=float))
        self.data["quat_BT"] = (self.R_BP * tool * DOWN).as_quat(scalar_first=True)

    def go(self, position: Any, velocity: Any, tool: Rotation = UPRIGHT) -> np.ndarray:
        """One step; f and m in P (6), then the scalar outputs (5)."""
        self.place(position, velocity, tool)
        status = self.step(self.s, 0.0, H)
        assert status == 0, self.message(status)
        vectors = [self.R_BP.inv().apply(self.data[name][0]) for name in ("f_T_B", "m_T_B")]
        return np.concatenate([*vectors, [float(self.data[name][0]) for name in OUTPUTS[2:]]])

    def line(self, start: Any, velocity: Any, steps: int, tool: Rotation = UPRIGHT) -> np.ndarray:
        """`steps` steps from `start` on with constant velocity; results (steps, 11)."""
        start, velocity = np.asarray(start, dtype=float), np.asarray(velocity, dtype=float)
        return np.array([self.go(start + (k + 1) * H * velocity, velocity, tool) for k in range(steps)])

    def message(self, status: int) -> str:
        return self.model.message(status, self.s, 0.0)

    @property
    def volume(self) -> float:
        """What is left [m3]: the mean of the three fields."""
        fields = (self.data[name][0] for name in ("pool", "cells", "origin", "pitch", "tick", "segments"))
        return float(np.mean(Part(*fields).volumes()))


def slot(model: Model, ap: float, angle: float = 0.0, steps: int = 12, **parameters: Any) -> np.ndarray:
    """Steps in the middle of a slot; forces along feed, left of it, up."""
    turn = Rotation.from_euler("z", angle, degrees=True)
    velocity = turn.apply([FEED, 0.0, 0.0])
    mill = Mill([0.0, 0.0, -ap], model=model, velocity=velocity, **parameters)
    result = mill.line([0.0, 0.0, -ap], velocity, steps)[4:]
    result[:, :3], result[:, 3:6] = turn.inv().apply(result[:, :3]), turn.inv().apply(result[:, 3:6])
    return result


# ---------------------------------------------------------------- against milling_force
@pytest.mark.parametrize("angle", [0.0, 17.0, 45.0])
def test_an_upright_flat_end_mill_feels_what_milling_force_says(angle: float) -> None:
    ours, theirs = slot(MODEL, 0.00203, angle), slot(MILLING, 0.00203, angle)
    scale = np.linalg.norm(theirs[0, :3]), np.linalg.norm(theirs[0, 3:6])
    assert np.abs(ours[:, :3] - theirs[:, :3]).max() < SLOT * scale[0]
    assert np.abs(ours[:, 3:6] - theirs[:, 3:6]).max() < SLOT * scale[1]
    assert ours[:, 9] == pytest.approx(0.016 * 0.00203 * FEED, rel=SLOT)
    assert ours[:, 10] == pytest.approx(0.00203, rel=ENTRY * 0.1)


def test_the_side_of_the_cut_is_told_from_the_other() -> None:
    """A wall of 4 mm beside the path, climb and conventional, as milling_force feels it."""
    for side in (-1.0, 1.0):
        results = []
        for model in (MODEL, MILLING):
            mill = Mill([-0.034, side * 0.012, -0.003], model=model, block_size=[0.05, 0.016, 0.01])
            results.append(mill.line([-0.034, side * 0.012, -0.003], [0.1, 0, 0], 70)[50:].mean(axis=0)[:3])
        assert results[0] == pytest.approx(results[1], abs=SIDE * np.linalg.norm(results[1]))


SIDE = 0.02
"""Relative: a wall is known to a few hundredths of a cell (0.25 mm), of a cut that is 4 mm wide."""


def test_a_ramp_pushes_the_tool_up_as_in_milling_force() -> None:
    velocity = [FEED, 0.0, -0.0025]
    results = []
    for model in (MODEL, MILLING):
        mill = Mill([-0.01, 0.0, -0.002], model=model, velocity=velocity)
        results.append(mill.line([-0.01, 0.0, -0.002], velocity, 40)[30:].mean(axis=0)[:3])
    assert results[0] == pytest.approx(results[1], abs=RAMP * np.linalg.norm(results[1]))


RAMP = 0.02
"""Relative: the floor under the end is found at 61 places, each from the lines about it."""


# ---------------------------------------------------------------- closed forms
def ball_slot(depth: float) -> tuple[float, float, float]:
    """Mean force (feed, left, up) [N] of an upright ball nose in a slot of `depth` [m]: Altintas' edge forces summed over nose and turn."""
    end = math.acos(1.0 - depth / RADIUS)
    one, sine, cosine = RADIUS * end, RADIUS * (1 - math.cos(end)), RADIUS * math.sin(end)
    sine2, both = 0.5 * RADIUS * (end - math.sin(end) * math.cos(end)), 0.5 * RADIUS * math.sin(end) ** 2
    k, c, n, half = K, CHIP, TEETH / (2 * math.pi), math.pi / 2
    feed = -n * (k.Krc * c * half * sine2 + 2 * k.Kre * sine + k.Kac * c * half * both + 2 * k.Kae * cosine)
    left = n * (k.Ktc * c * half * sine + 2 * k.Kte * one)
    up = n * (2 * k.Krc * c * both + math.pi * k.Kre * cosine - 2 * k.Kac * c * sine2 - math.pi * k.Kae * sine)
    return feed, left, up


def test_a_ball_nose_in_a_slot_has_the_force_of_its_closed_form() -> None:
    depth = RADIUS * (1 - math.cos(math.radians(60.0)))  # eight elements
    found = slot(MODEL, depth, corner_radius=RADIUS)
    expected = ball_slot(depth)
    assert found[:, :3].mean(axis=0) == pytest.approx(expected, abs=BALL * np.linalg.norm(expected))
    area = RADIUS**2 * (math.pi / 3 - math.sin(math.pi / 3) * math.cos(math.pi / 3))
    assert found[:, 9].mean() == pytest.approx(area * FEED, rel=BALL)


@pytest.mark.parametrize("corner", [0.0, 0.003, RADIUS])
def test_what_is_removed_is_what_the_lines_lose(corner: float) -> None:
    """Two separate calculations: the way of the engaged envelope, and the lengths of all lines before and after."""
    tool = Rotation.from_euler("xy", [15.0, 20.0], degrees=True)
    velocity = np.array([0.05, 0.02, 0.0])
    mill = Mill([-0.005, 0.0, -0.004], tool, velocity=velocity, corner_radius=corner)
    before = mill.volume
    removed = mill.line([-0.005, 0.0, -0.004], velocity, 50, tool)[:, 9].sum() * H
    assert removed == pytest.approx(before - mill.volume, rel=LINES)


LINES = 0.015
"""Relative: lines 0.25 mm apart count a front of some 10 mm to a fraction of one of them."""


def test_power_is_work_on_chips_and_edges() -> None:
    """Without edge forces the spindle's power is Ktc times the volume removed, whatever the tool and its tilt."""
    edges = {"Kte": 0.0, "Kre": 0.0, "Kae": 0.0}
    for corner, tilt in ((0.0, 20.0), (RADIUS, 30.0), (0.002, 0.0)):
        tool = Rotation.from_euler("y", tilt, degrees=True)
        mill = Mill([0.0, 0.0, -0.004], tool, velocity=[FEED, 0, 0], corner_radius=corner, **edges)
        found = mill.line([0.0, 0.0, -0.004], [FEED, 0.0, 0.0], 6, tool)
        assert found[:, 8] == pytest.approx(K.Ktc * found[:, 9], rel=WORK)


WORK = 0.08
"""Relative: of a flat end that is fed along its axis, the share of the end face is another force than the chip's."""


# ---------------------------------------------------------------- invariance
@pytest.mark.parametrize("turn", [(0.0, 90.0, 0.0), (25.0, 0.0, 0.0), (20.0, 30.0, 40.0)])
def test_turning_part_and_tool_together_changes_nothing(turn: tuple[float, float, float]) -> None:
    """The lines stay; part, tool and feed are turned across them."""
    tool = Rotation.from_euler("xyz", turn, degrees=True)
    box = trimesh.creation.box(extents=(0.04, 0.04, 0.01))
    box.apply_translation([0.0, 0.0, -0.005])
    start, velocity = np.array([-0.01, 0.0, -0.004]), np.array([FEED, 0.0, 0.0])
    results = []
    for rotation in (UPRIGHT, tool):
        stock = rotation.apply(np.array(box.triangles).reshape(-1, 3)).reshape(-1, 9)
        mill = Mill(rotation.apply(start), rotation, velocity=rotation.apply(velocity), tables={"stock": stock})
        assert mill.status == 0, mill.message(mill.status)
        found = mill.line(rotation.apply(start), rotation.apply(velocity), 12, rotation)[4:]
        results.append(np.hstack([rotation.inv().apply(found[:, :3]), rotation.inv().apply(found[:, 3:6]), found[:, 7:]]).mean(axis=0))
    for part in (slice(0, 3), slice(3, 6)):
        assert results[1][part] == pytest.approx(results[0][part], abs=TILTED * np.linalg.norm(results[0][part]))
    assert results[1][6:9] == pytest.approx(results[0][6:9], rel=TILTED)


def test_turning_the_frame_p_turns_the_force() -> None:
    turned = Rotation.from_euler("xyz", [30, -50, 70], degrees=True).as_quat(scalar_first=True)
    tool = Rotation.from_euler("y", 15.0, degrees=True)
    results = []
    for quaternion in ([1, 0, 0, 0], turned):
        mill = Mill([0, 0, -0.004], tool, velocity=[FEED, 0, 0], quat_BP=quaternion, corner_radius=RADIUS)
        results.append(mill.line([0, 0, -0.004], [FEED, 0, 0], 4, tool))
    assert results[1] == pytest.approx(results[0], abs=NANOMETRES * np.abs(results[0]).max())


NANOMETRES = 1e-5
"""Relative: rounding of a pose moves the ends of dexels by a tick (0.05 nm)."""


# ---------------------------------------------------------------- limits
def test_in_air_and_with_the_spindle_off_everything_is_zero() -> None:
    mill = Mill([0.0, 0.0, 0.001])
    assert not mill.line([0.0, 0.0, 0.001], [FEED, 0.0, 0.0], 5).any()
    mill = Mill([0.0, 0.0, -0.002])
    before = mill.data["pool"].copy()
    mill.data["spindle_speed"] = 0.0
    assert not mill.line([0.0, 0.0, -0.002], [FEED, 0.0, 0.0], 5).any()
    assert np.array_equal(mill.data["pool"], before)


def test_a_slot_gone_through_again_gives_no_force_and_removes_nothing() -> None:
    mill = Mill([-0.01, 0.0, -0.004])
    first = mill.line([-0.01, 0.0, -0.004], [FEED, 0, 0], 60)
    again = mill.line([-0.01, 0.0, -0.004], [FEED, 0, 0], 40)
    assert np.abs(again[:, :3]).max() < AGAIN * np.abs(first[:, :3]).max()
    assert again[:, 9].max() < AGAIN * first[20, 9]


AGAIN = 0.02
"""Relative: the wall just cut is where the side of the tool is, to a hundredth of a cell."""


def test_the_force_begins_less_than_a_cell_before_the_block() -> None:
    mill = Mill([-0.035, 0.0, -0.004])
    found = mill.line([-0.035, 0.0, -0.004], [FEED, 0, 0], 40)
    tip = -0.035 + (np.flatnonzero(found[:, 10] > 0.0)[0] + 0.5) * H * FEED
    assert abs(tip + RADIUS + 0.025) < ENTRY * 2.5e-4 + H * FEED


def test_the_actual_feed_is_the_commanded_one_on_a_straight_way() -> None:
    found = [slot(MODEL, 0.002, actual_feed=choice) for choice in (0, 1)]
    assert found[1] == pytest.approx(found[0], rel=NANOMETRES)
    # and counts where nothing is commanded
    mill = Mill([0.0, 0.0, -0.002], actual_feed=1)
    moved = [mill.go([(k + 1) * H * FEED, 0.0, -0.002], [0.0, 0.0, 0.0]) for k in range(6)]
    assert moved[-1][1] == pytest.approx(found[0][0, 1], rel=SLOT)


def test_a_tool_that_swings_cuts_with_its_upper_part() -> None:
    """About its tip the tool turns into the wall: the tip stands, the feed is omega times the height."""
    angles = np.linspace(-1.0, 1.0, 21)  # upright in the middle, so that the height of the block over the edges is 6 mm in the mean
    mill = Mill([0.0, 0.0, -0.006], Rotation.from_euler("y", angles[0], degrees=True), actual_feed=1)
    found = np.array([mill.go([0, 0, -0.006], [0, 0, 0], Rotation.from_euler("y", a, degrees=True)) for a in angles[1:]])
    rate = np.radians(0.1) / H
    assert found[:, 9].mean() == pytest.approx(0.016 * 0.5 * 0.006**2 * rate, rel=SWING)
    assert np.all(found[:, 0] < 0.0)


SWING = 0.05
"""Relative: the end face, which a swing lifts on one side and presses down on the other, is not counted."""


# ---------------------------------------------------------------- stock of triangles
def test_a_block_of_triangles_is_the_block() -> None:
    box = trimesh.creation.box(extents=(0.05, 0.04, 0.02))
    box.apply_translation([0.0, 0.0, -0.01])
    results = []
    for tables in ({}, {"stock": np.array(box.triangles).reshape(-1, 9)}):
        mill = Mill([0.0, 0.0, -0.003], velocity=[FEED, 0, 0], tables=tables)
        results.append((mill.line([0.0, 0.0, -0.003], [FEED, 0, 0], 3), mill.data["pool"][0].copy()))
    assert np.array_equal(results[0][1], results[1][1])
    assert np.abs(results[0][0] - results[1][0]).max() <= EXACT


def test_a_torus_has_its_volume() -> None:
    torus = trimesh.creation.torus(0.02, 0.006, major_sections=90, minor_sections=45)
    mill = Mill([0, 0, 0.1], tables={"stock": np.array(torus.triangles).reshape(-1, 9)})
    assert mill.status == 0
    assert mill.volume == pytest.approx(torus.volume, rel=STOCK)


STOCK = 1e-3
"""Relative: lines 0.25 mm apart count circles of 12 mm, and the tori that the fields see are three."""


# ---------------------------------------------------------------- errors
@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"diameter": 0.0}, "must be positive"),
        ({"quat_BP": [1, 1, 0, 0]}, "not of unit length"),
        ({"block_size": [0.5, 0.4, 0.1]}, "2097152 intervals available at a spacing of 0.00025 m and 2 segments; use a spacing of 0.000"),
        ({"corner_radius": 0.009}, "corner radius 0.009 m is more than half of the diameter 0.016 m"),
    ],
)
def test_bad_parameters_are_refused(parameters: dict[str, Any], text: str) -> None:
    mill = Mill([0, 0, 0.1], **parameters)
    assert text in mill.message(mill.status)


def test_an_open_surface_is_refused() -> None:
    box = trimesh.creation.box(extents=(0.05, 0.04, 0.02))
    mill = Mill([0, 0, 0.1], tables={"stock": np.array(box.triangles).reshape(-1, 9)[:-1]})
    assert "goes into it and not out again" in mill.message(mill.status)
    mill = Mill([0, 0, 0.1], tables={"stock": np.array(box.triangles).reshape(-1, 9)}, engagement_error=1e-3)
    assert "engagement_error 0.001 m cannot be given to a stock of triangles" in mill.message(mill.status)


def test_a_line_with_many_walls_moves_to_more_room() -> None:
    """A comb: eleven slots of 2 mm across the block, through which lines along x have twelve intervals."""
    mill = Mill([-0.02, -0.04, -0.004], diameter=0.002, segments=1)
    before = mill.volume
    for x in np.linspace(-0.02, 0.02, 11):
        mill.place([x, -0.04, 0.05])
        assert mill.step(mill.s, 0.0, H) == 0
        for y in np.linspace(-0.04, 0.04, 41):
            mill.place([x, y, -0.004])
            assert mill.step(mill.s, 0.0, H) == 0
        assert mill.step(mill.s, 0.0, H) == 0
        mill.place([x, 0.04, 0.05])
        assert mill.step(mill.s, 0.0, H) == 0
    assert before - mill.volume == pytest.approx(11 * 0.002 * 0.04 * 0.004, rel=COMB)
    pool = mill.data["pool"][0]
    assert -pool.min() % 65536 == 16  # room for twelve


COMB = 0.03
"""Relative: slots of 2 mm, counted by lines 0.25 mm apart."""


def test_a_pool_that_is_full_is_refused() -> None:
    mill = Mill([-0.03, 0.0, -0.004], diameter=0.002, segments=1)
    mill.data["pool"][0, 0] = 2097152
    mill.place([-0.02, 0.0, -0.004])
    assert "more walls than the 2097152 intervals" in mill.message(mill.step(mill.s, 0.0, H))


def test_the_shank_and_a_thick_chip_are_refused() -> None:
    mill = Mill([0.0, 0.0, -0.01], cutting_length=0.008)
    mill.place([0.0001, 0.0, -0.01], [FEED, 0, 0])
    assert "the shank would hit" in mill.message(mill.step(mill.s, 0.0, H))
    mill = Mill([0.0, 0.0, -0.01], velocity=[7.0, 0, 0])
    mill.place([0.0001, 0.0, -0.01], [7.0, 0, 0])
    assert "too slow for the feed" in mill.message(mill.step(mill.s, 0.0, H))
    mill.data["spindle_speed"] = -1.0
    assert "expected 0 or more" in mill.message(mill.step(mill.s, 0.0, H))
    assert "step size must be positive" in mill.message(mill.step(mill.s, 0.0, 0.0))
    mill.data["p_BT_B"] = math.nan
    assert "not finite" in mill.message(mill.step(mill.s, 0.0, H))


def test_tools_are_changed_and_have_corners_of_their_own() -> None:
    tables = {"tools": [[1, 0.016, 3, 0.5, 0.03], [2, 0.01, 2, 0.5, 0.03]], "corners": [[2, 0.005]]}
    mill = Mill([0, 0, 0.01], tables=tables, tool=UPRIGHT)
    mill.data["tool"] = 2
    mill.go([0, 0, 0.01], [0, 0, 0])
    assert (float(mill.data["mill_diameter"][0]), float(mill.data["mill_corner"][0])) == (0.01, 0.005)
    mill.data["tool"] = 1
    mill.go([0, 0, 0.01], [0, 0, 0])
    assert float(mill.data["mill_corner"][0]) <= EXACT
    mill.data["tool"] = 3
    assert "tool T3 is not in the table 'tools', which has [1 2]" in mill.message(mill.step(mill.s, 0.0, H))
    mill = Mill([0, 0, -0.005], tables=tables)
    mill.data["pool"] = Mill([0, 0, 0.1]).data["pool"]
    mill.data["tool"] = 1
    assert "deep in material when it comes into the spindle" in mill.message(mill.step(mill.s, 0.0, H))
    mill = Mill([0, 0, 0.1], tables={"tools": [[1.5, 0.016, 3, 0.5, 0.03]]})
    assert "correct that row" in mill.message(mill.status)


# ---------------------------------------------------------------- effects and parity
@pytest.mark.parametrize("name", EFFECTS)
def test_each_effect_changes_the_force(name: str) -> None:
    start, velocity = ([-0.03, 0.0, -0.0005], [FEED, 0.0, 0.0])
    plain, other = (Mill(start, velocity=velocity, **values).line(start, velocity, 25)[-1] for values in ({}, {name: EFFECTS[name]}))
    assert np.abs(other[:3] - plain[:3]).max() > SEEN * np.abs(plain[:3]).max()


SEEN = 1e-4
"""Relative: more than rounding; the runout leaves the mean, nearly."""


def test_plain_python_is_the_compiled_code_bit_by_bit() -> None:
    """Tilted bull nose with all effects, in a block of coarse cells: plain Python takes its time."""
    parameters = {**EFFECTS, "corner_radius": 0.003, "spacing": 2e-3, "block_size": [0.03, 0.03, 0.01]}
    tool = Rotation.from_euler("xy", [10.0, 15.0], degrees=True)
    mills = [Mill([0.002, 0.0, -0.002], tool, compiled=compiled, velocity=[FEED, 0, 0], **parameters) for compiled in (True, False)]
    for k in range(2):
        for mill in mills:
            mill.go([0.002 + (k + 1) * H * FEED, 0.0, -0.002 - 1e-5 * k], [FEED, 0.0, -0.002], tool)
    assert mills[0].data.tobytes() == mills[1].data.tobytes()
    assert np.abs(mills[0].data["f_T_B"]).max() > ROUNDOFF
