"""power_law_force: Eqs. (2)-(6) of paper 003 in closed form, and where depth and width come from."""

from __future__ import annotations

import math
from typing import Any

import control
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.models.components import milling_force
from robomill.models.components.power_law_force import MODEL, POWER_LAW
from robomill.models.model.declaration import record
from tests.tolerances import EXACT, ROUNDOFF, chance, discretisation, of_variance, physics

H = 0.004
NO_LAG = {"lag_share": 0.0}
STEPS = np.array([[0.0, 1e-3, 0.05], [0.1, 1e-3, 0.05], [0.100001, 2e-3, 0.05], [0.2, 2e-3, 0.05], [0.200001, 3e-3, 0.05]])
"""Depths of 1, 2, 3 mm over the way."""
AIR = np.array([[0.0, 0.0, 0.0]])


class Process:
    """One instance, initialised with its parameters and inputs."""

    def __init__(self, compiled: bool = False, profile: np.ndarray | None = None, **values: Any) -> None:
        self.data = MODEL.new()
        self.s = record(self.data)
        self.init, self.step = MODEL.compiled() if compiled else MODEL.plain()
        if profile is not None:
            MODEL.load_table(self.data, "profile", profile)
        for name, value in values.items():
            self.data[name] = value
        self.k = 0
        assert self.init(self.s) == 0

    def run(self, steps: int, **inputs: Any) -> np.ndarray:
        """Force, depth, width, way [steps, 4]."""
        rows = np.zeros((steps, 4))
        for name, value in inputs.items():
            self.data[name] = value
        for row in rows:
            assert self.step(self.s, self.k * H, H) == 0
            self.k += 1
            row[:] = self.s.force, self.s.depth, self.s.width, self.s.distance
        return rows


# ------------------------------------------------------------------------------------------- the law


@pytest.mark.paper
@pytest.mark.parametrize(("depth", "expected"), [(1, 126.0), (2, 235.0), (3, 339.0)])
def test_force_at_full_feed(depth: float, expected: float) -> None:
    """Eq. (6) at 30 mm/s: 1 mm saturates below 250 N, as the paper says, and so does 2 mm (FACTS 2.1, whole newtons)."""
    force = Process(profile=np.array([[0.0, 1e-3 * depth, 0.05]]), **NO_LAG).s.force
    assert abs(force - expected) <= physics(expected, absolute=0.6)
    assert abs(force - 23.0 * depth**0.9 * 30.0**0.5) < 100 * ROUNDOFF * force


@pytest.mark.paper
def test_depth_from_which_250_newton_can_be_held() -> None:
    """FACTS10 10.0: only above 2.14 mm at 30 mm/s, to three digits."""
    depth = (250.0 / (23.0 * math.sqrt(30.0))) ** (1.0 / 0.9)
    assert abs(Process(profile=np.array([[0.0, 1e-3 * depth, 0.0]]), **NO_LAG).s.force - 250.0) < 1000 * ROUNDOFF * 250.0
    assert abs(depth - 2.14) <= physics(2.14, absolute=0.005)


def test_general_law_has_width_gain_and_exponents_of_its_own() -> None:
    profile = np.array([[0.0, 1.5e-3, 0.04]])
    law = {"gain": 7.0, "process_gain": 1.1, "depth_exponent": 0.8, "feed_exponent": 0.6, "width_exponent": 0.3}
    force = Process(profile=profile, feed=0.012, **law, **NO_LAG).s.force
    assert abs(force - 1.1 * 7.0 * 1.5**0.8 * 12.0**0.6 * 40.0**0.3) < 100 * ROUNDOFF * force
    assert Process(profile=np.array([[0.0, 1e-3, 0.0]]), width_exponent=0.3).s.force == EXACT


def test_lag_is_the_first_order_system_of_python_control() -> None:
    """tau_m = 0.63 of a revolution, exact for a static force that each step holds."""
    speed = 3000 * 2 * math.pi / 60
    process = Process(compiled=True, feed=0.0, spindle_speed=speed)
    rng = np.random.default_rng(3)
    feeds = rng.uniform(0.005, 0.03, 100)
    ours = np.array([process.run(1, feed=f)[0, 0] for f in feeds])
    static = 23.0 * np.sqrt(1e3 * feeds)
    lag = control.sample_system(control.ss(control.tf([1], [0.63 * 60 / 3000, 1])), H, "zoh")
    theirs = control.forced_response(lag, H * np.arange(101), np.append(static, 0.0)).outputs[1:]
    assert np.abs(ours - theirs).max() < 1000 * ROUNDOFF * 126.0


def test_force_points_against_the_feed_to_its_left_and_up() -> None:
    """FACTS10 10.1: 300 N against the feed, 300 N to its left, 50 N up; feed at 45 deg to x: the resultant is along -x."""
    x_T = np.array([0.0, 0.0, -1.0])  # spindle down
    quat = np.roll(Rotation.from_matrix(np.column_stack([x_T, [0, 1, 0], np.cross(x_T, [0, 1, 0])])).as_quat(), 1)
    feed = 0.02 * np.array([1.0, 1.0, 0.0]) / math.sqrt(2)
    force = Process(v_BT_B=feed, quat_BT=quat, shares=[1.0, 1.0, 1.0 / 6.0], torque_arm=0.0375)
    expected = float(force.s.force) * np.array([-math.sqrt(2), 0.0, 1.0 / 6.0])
    assert np.abs(np.array(force.s.f_T_B) - expected).max() < 10 * ROUNDOFF * 126.0
    assert np.abs(np.array(force.s.m_T_B) - [0.0, 0.0, 0.0375 * force.s.force]).max() < 10 * ROUNDOFF * 126.0
    force.run(1, v_BT_B=[0.0, 0.0, 0.0])  # a tool that stops keeps the direction
    assert abs(np.array(force.s.f_T_B)[0] / force.s.force + math.sqrt(2)) < 10 * ROUNDOFF


# --------------------------------------------------------------------------------- where it is cut


def test_depth_follows_the_way_and_the_end_is_told() -> None:
    rows = Process(compiled=True, profile=STEPS, **NO_LAG).run(2000)
    way = 0.03 * H * np.arange(1, 2001)
    assert np.abs(rows[:, 3] - way).max() < 1000 * ROUNDOFF
    clear = np.abs(way[:, None] - [0.1, 0.2]).min(axis=1) > 1e-5
    expected = 1e-3 * (1 + (way > 0.1) + (way > 0.2))
    assert np.abs(rows[:, 1] - expected)[clear].max() < ROUNDOFF
    process = Process(profile=STEPS)
    process.run(1660)
    assert not process.s.finished
    process.run(10)
    assert process.s.finished


def test_profile_over_time_and_lines_between_rows() -> None:
    ramp = np.array([[0.0, 0.0, 0.02], [1.0, 2e-3, 0.06]])
    rows = Process(profile=ramp, over_time=1, **NO_LAG).run(100)
    t = H * np.arange(1, 101)
    assert np.abs(rows[:, 1] - 2e-3 * t).max() < ROUNDOFF
    assert np.abs(rows[:, 2] - 0.02 - 0.04 * t).max() < ROUNDOFF


def test_way_is_the_integral_of_the_feed() -> None:
    """The trapezoidal rule on a sine: error below h^2 w^2 / 12 of the way."""
    process = Process(compiled=True, profile=AIR, feed=0.01)
    for k in range(250):
        process.run(1, feed=0.01 + 0.005 * math.sin(2 * math.pi * (k + 1) * H))
    assert abs(process.s.distance - 0.01) < 0.01 * discretisation((2 * math.pi) ** 2 / 12, H, 2)


def test_dexels_give_depth_and_width() -> None:
    """A full slot of 2 mm with the end mill of 16 mm: the workpiece of milling_force says how deep and how wide it is cut.

    Depth is exact; the width is that of the removed volume, cells of dexels (0.5 mm) on 16 mm and the moon in front of the cutter.
    """
    data = milling_force.MODEL.new()
    mill = record(data)
    init, step = milling_force.MODEL.compiled()
    data["spindle_speed"] = 13000 * 2 * math.pi / 60
    x, y, z = mill.p_BP_B
    data["p_BT_B"] = x - 0.060, y, z - 0.002
    assert init(mill) == 0
    process = Process(profile=AIR, width_exponent=0.4, **NO_LAG)
    rows = []
    for k in range(600):
        data["p_BT_B"] = x - 0.060 + 0.03 * H * (k + 1), y, z - 0.002
        data["v_BT_B"] = 0.03, 0.0, 0.0
        assert step(mill, k * H, H) == 0
        rows.append(process.run(1, dexel_depth=mill.depth, dexel_removal_rate=mill.removal_rate)[0])
    cut = np.array(rows)[400:]
    assert np.abs(cut[:, 1] - 0.002).max() < ROUNDOFF
    assert abs(cut[:, 2].mean() - 0.016) <= physics(0.016, relative=0.05)
    assert np.abs(cut[:, 0] / (23.0 * 2**0.9 * 30**0.5 * (1e3 * cut[:, 2]) ** 0.4) - 1.0).max() < 1000 * ROUNDOFF
    assert Process(profile=AIR).s.force == EXACT


def test_skin_has_its_deviation_everywhere_and_belongs_to_the_place() -> None:
    """Standard deviation of the depth at 4000 independent places; twice over the same place it is the same, other seeds are others."""
    n, deep = 4000, np.array([[0.0, 5e-3, 0.05]])
    # 2.5 grains from place to place, so that no two see the same numbers, at every phase between them
    process = Process(compiled=True, profile=deep, skin_noise=1e-4, feed=0.0049 / H)
    rows = process.run(n)
    deviation = (rows[:, 1] - 5e-3) / 1e-4
    assert abs(deviation.var() - 1.0) < chance(of_variance(n))
    assert np.array_equal(Process(compiled=True, profile=deep, skin_noise=1e-4, feed=0.0049 / H).run(n), rows)
    assert not np.array_equal(Process(compiled=True, profile=deep, skin_noise=1e-4, feed=0.0049 / H, seed=2).run(n), rows)
    assert Process(profile=AIR, skin_noise=1e-4).run(50)[:, 1].max() == EXACT  # no skin where there is no material


def test_measured_force_has_the_noise_of_the_sensor() -> None:
    process = Process(compiled=True, force_noise=3.0)
    measured = np.zeros(4000)
    for k in range(len(measured)):
        process.run(1)
        measured[k] = process.s.force_measured - process.s.force
    assert abs(measured.var() / 9.0 - 1.0) < chance(of_variance(4000))
    assert Process().s.force_measured == Process().s.force


def test_low_pass_of_the_sensor_is_first_order_and_leaves_the_force_alone() -> None:
    process = Process(feed=0.0, force_filter=0.01, **NO_LAG)
    force = process.run(1, feed=0.03)[0, 0]
    assert abs(process.s.force_measured - force * (1 - math.exp(-H / 0.01))) < 10 * ROUNDOFF * force
    process.run(1)
    assert abs(process.s.force_measured - force * (1 - math.exp(-2 * H / 0.01))) < 10 * ROUNDOFF * force


# ------------------------------------------------------------------------------------- effect, parity


def test_wrong_exponent_changes_the_force_by_that_power_of_the_depth() -> None:
    for depth in (0.5, 1.0, 3.0):
        profile = np.array([[0.0, 1e-3 * depth, 0.05]])
        ratio = Process(profile=profile, depth_exponent_error=0.2).s.force / Process(profile=profile).s.force
        assert abs(ratio - depth**0.2) < 100 * ROUNDOFF
    assert {v.name for v in MODEL.variables if v.effect} == {"depth_exponent_error"}


@pytest.mark.parametrize(
    "parameters",
    [{}, {"skin_noise": 2e-4, "force_noise": 3.0, "depth_exponent_error": -0.1, "width_exponent": 0.3, "shares": [1, 0.7, 0.1]}],
)
def test_plain_and_compiled_are_the_same_bits(parameters: dict[str, Any]) -> None:
    pair = [Process(compiled, STEPS, v_BT_B=[0.03, 0.01, 0.0], **parameters) for compiled in (False, True)]
    names = [n for n in MODEL.dtype.names or () if n != "profile_at"]
    for k in range(200):
        for process in pair:
            process.run(10, feed=0.03 + 0.02 * math.sin(0.1 * k))
        for name in names:
            assert np.array_equal(pair[0].data[name], pair[1].data[name]), name


# --------------------------------------------------------------------------------------------- errors


def message(profile: np.ndarray | None = None, h: float = H, **values: Any) -> str:
    data = MODEL.new()
    if profile is not None:
        MODEL.load_table(data, "profile", profile)
    for name, value in values.items():
        data[name] = value
    s = record(data)
    status = MODEL.init(s) or MODEL.step(s, 0.0, h)
    assert status != 0
    return MODEL.message(status, s, 0.0)


def test_errors_say_what_is_wrong() -> None:
    assert "at t = 0.0 s an input is not finite: feed nan m/s" in message(feed=math.nan)
    text = message(profile=np.array([[0.0, 0, 0], [0.1, 1e-3, 0], [0.1, 2e-3, 0]]))
    assert "does not increase from row 1 (counted from zero) to the next; a step of the depth needs two rows a little apart" in text
    text = "is 0.001 m deep in material and fed with 0.03 m/s, but spindle_speed is 0.0 rad/s; expected more than 0: start the spindle"
    assert text in message(spindle_speed=0.0)
    assert "dexel_depth -0.001 m or dexel_removal_rate 0.0 m3/s is negative; expected 0 or more" in message(dexel_depth=-1e-3)
    assert "the step size must be positive" in message(h=0.0)
    assert POWER_LAW.gain == 23.0
