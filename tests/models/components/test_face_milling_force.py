"""face_milling_force: a stated force that follows the cut of a face cutter."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robomill.fmus.interface import Interface
from robomill.models.components.face_milling_force import MODEL
from robomill.models.components.milling_force import MODEL as MILLING
from robomill.models.model.declaration import FloatArray, record
from tests.tolerances import EXACT, ROUNDOFF, physics

H = 0.004
RADIUS, WIDTH, DEPTH, SPEED = 37.5e-3, 50e-3, 3e-3, 20e-3
SPINDLE = 377.0
REFERENCE = np.array([-300.0, 300.0, 50.0])
"""Force of the paper on the tool: along the feed, to its left, up."""
CELL = 5e-4
BLOCK = {"block_size": [0.15, WIDTH, 0.03], "p_BP_B": [1.0, 0.2, 0.5], "spacing": CELL}
DISCRETE = 0.03
"""Part of the force that dexels of 0.5 mm cost: the rim of the block is known to half a cell on either side of 50 mm; bins of 2 degrees."""


class Process:
    """One instance whose tool moves along x of the block at `depth`."""

    def __init__(self, compiled: bool = False, **parameters: Any) -> None:
        self.data = MODEL.new()
        self.s = record(self.data)
        self.init, self.step = MODEL.compiled() if compiled else MODEL.plain()
        for name, value in {**BLOCK, **parameters}.items():
            self.data[name] = value
        self.origin = np.array(self.s.p_BP_B)
        self.data["spindle_speed"] = SPINDLE
        self.k = 0

    def at(self, x: float, depth: float = DEPTH, speed: float = SPEED) -> None:
        self.data["p_BT_B"] = self.origin + np.array([x, 0.0, -depth])
        self.data["v_BT_B"] = [speed, 0.0, 0.0]

    def start(self, x: float, depth: float = DEPTH) -> int:
        self.at(x, depth)
        return int(self.init(self.s))

    def advance(self) -> int:
        self.k += 1
        return int(self.step(self.s, (self.k - 1) * H, H))


def force_at(x: float, depth: float = DEPTH, speed: float = SPEED, **parameters: Any) -> FloatArray:
    """Force [N] of one step at x [m] from the middle of a block that the tool has cut up to there."""
    process = Process(**parameters)
    assert process.start(x, depth) == 0
    process.at(x + H * speed, depth, speed)
    assert process.advance() == 0
    return np.array(process.s.f_T_B)


def entry(way: float) -> float:
    """Place x [m] of the tool after `way` in the block."""
    return -0.075 - RADIUS + way


def test_the_reference_cut_has_the_stated_force():
    assert force_at(0.0) == pytest.approx(REFERENCE, rel=DISCRETE)


def test_the_force_follows_the_frame_of_the_feed():
    """Fed along y of B with the block turned by 90 deg, all turns with it."""
    turned = Process(quat_BP=[math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
    turned.at(0.0)
    assert turned.init(turned.s) == 0
    turned.data["p_BT_B"] = turned.origin + np.array([0.0, H * SPEED, -DEPTH])
    turned.data["v_BT_B"] = [0.0, SPEED, 0.0]
    assert turned.advance() == 0
    fx, fy, fz = force_at(0.0)
    assert np.array(turned.s.f_T_B) == pytest.approx([-fy, fx, fz], rel=1e3 * ROUNDOFF, abs=1e3 * ROUNDOFF)


@pytest.mark.parametrize("exponent", [0.7, 0.9, 1.0])
def test_power_law_of_depth_and_feed(exponent: float):
    at_reference = force_at(0.0, depth_exponent=exponent)
    deeper = force_at(0.0, depth=2 * DEPTH, depth_exponent=exponent)
    assert deeper == pytest.approx(2.0**exponent * at_reference, rel=1e3 * ROUNDOFF)
    faster = force_at(0.0, speed=4 * SPEED)
    assert faster == pytest.approx(2.0 * force_at(0.0), rel=DISCRETE)


@pytest.mark.parametrize("way", [2e-3, 5e-3, 8e-3])
def test_the_cutter_engages_as_its_circle_meets_the_block(way: float):
    """Closed form: width 2 sqrt(R^2 - (R - way)^2) of the 50 mm. A ring of two cells around the cutter reads the material ahead of it."""
    chord = 2.0 * math.sqrt(RADIUS**2 - (RADIUS - way) ** 2)
    ahead = (way + 2.5 * CELL, way - CELL)
    low, high = sorted(2.0 * math.sqrt(RADIUS**2 - (RADIUS - w) ** 2) / WIDTH for w in ahead)
    share = force_at(entry(way))[1] / REFERENCE[1]
    assert low <= share <= high
    assert share == pytest.approx(chord / WIDTH, abs=physics(1.0, absolute=2.5 * CELL / way))


def test_full_after_nine_and_a_half_millimetres():
    way = RADIUS - math.sqrt(RADIUS**2 - 0.25 * WIDTH**2)
    assert force_at(entry(way + 3 * CELL))[1] == pytest.approx(REFERENCE[1], rel=DISCRETE)
    assert force_at(entry(-3 * CELL))[1] == EXACT


def test_openings_take_their_share_of_the_width():
    """Oracle: the part of the front of the cutter, seen along the feed, that does not stand in an opening."""
    diameter, pitch = 25e-3, 50e-3
    left = np.linspace(-0.5 * WIDTH, 0.5 * WIDTH, 5001)
    x = -5e-3
    front = x + np.sqrt(RADIUS**2 - left**2)
    u, v = (c - pitch * (np.floor(c / pitch) + 0.5) for c in (front, left))
    share = float(np.mean(u**2 + v**2 > 0.25 * diameter**2))
    found = force_at(x, opening_diameter=diameter, opening_pitch=[pitch, pitch])[1] / force_at(x)[1]
    assert share < 0.9
    # the material is read two cells ahead of the front: up to a millimetre of the rims of two openings of 25 mm
    assert found == pytest.approx(share, abs=physics(1.0, absolute=4.0 * CELL / diameter))


def test_torque_and_power_are_those_of_the_force_at_the_edges():
    process = Process()
    assert process.start(0.0) == 0
    process.at(H * SPEED)
    assert process.advance() == 0
    assert float(process.s.spindle_torque) == pytest.approx(RADIUS * float(process.s.f_T_B[1]), rel=ROUNDOFF)
    assert float(process.s.spindle_power) == pytest.approx(SPINDLE * float(process.s.spindle_torque), rel=ROUNDOFF)
    assert float(process.s.m_T_B[2]) == float(process.s.spindle_torque)
    assert float(process.s.f_peak) == pytest.approx(float(np.linalg.norm(process.s.f_T_B)), rel=ROUNDOFF)


def test_what_is_removed_is_width_times_depth_times_feed():
    process = Process()
    assert process.start(-0.03) == 0
    removed = 0.0
    n = 250
    for k in range(n):
        process.at(-0.03 + (k + 1) * H * SPEED)
        assert process.advance() == 0
        removed += H * float(process.s.removal_rate)
    assert removed == pytest.approx(WIDTH * DEPTH * n * H * SPEED, rel=DISCRETE)


def test_no_force_without_feed_without_spindle_and_above_the_block():
    for change in ({"spindle_speed": 0.0}, {"v_BT_B": 0.0}):
        process = Process()
        assert process.start(0.0) == 0
        for name, value in change.items():
            process.data[name] = value
        assert process.advance() == 0
        assert np.all(process.data["f_T_B"] == EXACT)
    assert np.all(force_at(0.0, depth=-1e-3) == EXACT)


def test_force_error_scales_the_force_and_nothing_else():
    assert force_at(0.0, force_error=0.25) == pytest.approx(1.25 * force_at(0.0), rel=ROUNDOFF)


def test_a_cutter_bent_into_the_part_leaves_a_deeper_floor():
    process = Process()
    assert process.start(0.0) == 0
    process.at(H * SPEED, DEPTH + 1e-4)
    assert process.advance() == 0
    floor = float(np.min(np.array(process.s.height)[: int(process.s.nx) * int(process.s.ny)]))
    assert floor == pytest.approx(-DEPTH - 1e-4, rel=ROUNDOFF)
    assert float(process.s.depth) == pytest.approx(DEPTH + 0.5e-4, rel=1e3 * ROUNDOFF)


def test_the_ports_are_those_of_milling_force():
    ours, theirs = Interface(MODEL), Interface(MILLING)
    for group in ("inputs", "outputs"):
        assert [(p.name, p.type, p.unit) for p in getattr(ours, group)] == [(p.name, p.type, p.unit) for p in getattr(theirs, group)]


def test_compiled_and_plain_have_the_same_bits():
    found = []
    for compiled in (False, True):
        process = Process(compiled, spacing=2e-3, opening_diameter=0.02, opening_pitch=[0.05, 0.05])
        assert process.start(entry(-2e-3)) == 0
        out = []
        for k in range(60):
            process.at(entry(-2e-3) + (k + 1) * 5e-4, DEPTH + 1e-5 * math.sin(k))
            assert process.advance() == 0
            out.append([*process.s.f_T_B, process.s.removal_rate, process.s.depth])
        found.append(np.array(out))
    assert np.array_equal(found[0], found[1])


@pytest.mark.parametrize(
    ("parameters", "status", "text"),
    [
        ({"width_reference": 0.0}, 1, "a parameter is out of bounds"),
        ({"opening_diameter": 0.01, "opening_pitch": [0.0, 0.1]}, 1, "a parameter is out of bounds"),
        ({"quat_BP": [1.0, 1.0, 0.0, 0.0]}, 2, "quat_BP"),
        ({"spacing": 1e-4}, 3, "the block of"),
        ({"p_BP_B": [math.nan, 0.0, 0.0]}, 4, "at t = 0.0 s an input is not finite"),
    ],
)
def test_errors_of_parameters(parameters: dict[str, Any], status: int, text: str):
    process = Process(**parameters)
    assert process.start(0.0) == status
    assert MODEL.message(status, process.s, 0.0).startswith(f"{MODEL.name}: {text}")


def test_errors_of_a_step():
    process = Process(cutting_length=2e-3)
    assert process.start(entry(5e-3)) == 0
    assert process.step(process.s, 0.0, 0.0) == 7
    process.at(entry(6e-3))
    assert process.advance() == 6
    assert "more than they are high (0.002 m); cut less deep" in MODEL.message(6, process.s, 0.0)
    process.data["spindle_speed"] = -1.0
    assert process.advance() == 5
    assert "expected 0 or more" in MODEL.message(5, process.s, 0.0)
