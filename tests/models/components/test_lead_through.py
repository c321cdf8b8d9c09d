"""lead_through: hand and joystick move the robot; the admittance falls on contact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robomill.models.components.lead_through import MODEL
from robomill.models.components.path_interpolator import Q_START
from robomill.models.model.declaration import record
from tests.tolerances import EXACT, ROUNDOFF, chance, discretisation, of_variance

H = 0.004
SLIP = 0.3
"""m: radius of curvature of the axes' motion, for the error of Euler's steps, (v h)^2 / (2 r) each."""


class Led:
    """One instance without noise of the hand, unless it is asked for."""

    def __init__(self, operator: Any = None, compiled: bool = False, **parameters: Any) -> None:
        self.data = MODEL.new()
        if operator is not None:
            MODEL.load_table(self.data, "operator", np.asarray(operator, dtype=float))
        self.s = record(self.data)
        for name, value in {"hand_noise": 0.0, **parameters}.items():
            self.data[name] = value
        self.init, self.step = MODEL.compiled() if compiled else MODEL.plain()
        self.k = 0
        self.status = self.init(self.s)
        self.start = np.array(self.s.p_BT_B)

    def run(self, steps: int, **inputs: Any) -> Led:
        """Cycles with these inputs, until one fails."""
        for name, value in inputs.items():
            self.data[name] = value
        for _ in range(steps):
            self.status = self.step(self.s, self.k * H, H)
            self.k += 1
            if self.status:
                break
        return self

    @property
    def way(self) -> np.ndarray:
        return np.array(self.s.p_BT_B) - self.start

    @property
    def message(self) -> str:
        return MODEL.message(self.status, self.s, self.k * H)


def slip(steps: int, speed: float) -> float:
    """Bound of what Euler's steps leave of a straight line [m]."""
    return discretisation(steps * speed**2 / (2.0 * SLIP), H, 2)


def test_the_tool_goes_where_the_hand_pushes_it() -> None:
    led = Led().run(100, f_hand_B=[4.0, -8.0, 8.0])
    assert led.s.speed == pytest.approx(12.0 / 200.0, rel=ROUNDOFF)
    assert led.way == pytest.approx(100 * H * np.array([4.0, -8.0, 8.0]) / 200.0, abs=slip(100, 0.06))
    turn = Rotation.from_matrix(led.s.R_BT) * Rotation.from_matrix(Led().s.R_BT).inv()
    assert turn.magnitude() == pytest.approx(0.0, abs=slip(100, 0.06) / SLIP)


def test_held_directions_stay() -> None:
    led = Led(released=[1, 0, 0, 0, 0, 1]).run(100, f_hand_B=[4.0, -8.0, 8.0], joystick_B=[0.1, 0.1, 0.0])
    assert led.way[1:] == pytest.approx(np.zeros(2), abs=slip(100, 0.06))
    assert led.way[0] > 5e-3


def test_the_joystick_turns_the_tool_about_its_tip() -> None:
    led = Led().run(250, joystick_B=[0.0, 0.0, 0.2])
    turn = Rotation.from_matrix(led.s.R_BT) * Rotation.from_matrix(Led().s.R_BT).inv()
    assert turn.as_rotvec() == pytest.approx([0.0, 0.0, 0.2], abs=slip(250, 0.2) / SLIP)
    assert led.way == pytest.approx(np.zeros(3), abs=slip(250, 0.2))


def test_the_speed_is_limited() -> None:
    assert Led().run(5, f_hand_B=[0.0, 300.0, 400.0]).s.speed == pytest.approx(0.1, rel=ROUNDOFF)


class TestContact:
    def test_the_admittance_falls_and_comes_back(self) -> None:
        led = Led().run(1, f_hand_B=[0.0, 20.0, 0.0], f_T_B=[0.0, -11.0, 0.0])
        assert (led.s.contact, led.s.speed) == (1, pytest.approx(9.0 / 66000.0, rel=ROUNDOFF))
        assert led.run(1, f_T_B=[0.0, -6.0, 0.0]).s.contact == 1
        led.run(1, f_T_B=[0.0, -4.0, 0.0])
        assert (led.s.contact, led.s.speed) == (0, pytest.approx(16.0 / 200.0, rel=ROUNDOFF))

    def test_the_force_settles_at_that_of_the_hand(self) -> None:
        """Against a spring of 500 N/mm: x' = (F_h - k x)/D has the time constant D/k = 0.132 s; after 15 of them it has settled."""
        led, stiffness = Led(), 5e5
        led.data["f_hand_B"] = 0.0, 15.0, 0.0
        led.data["contact_force"] = 0.0
        for _ in range(500):
            led.run(1, f_T_B=[0.0, -stiffness * max(0.0, led.way[1]), 0.0])
        assert stiffness * led.way[1] == pytest.approx(15.0, abs=15.0 * discretisation(1.0, np.exp(-15.0), 1) + stiffness * slip(500, 1e-4))


class TestOperator:
    ROWS = ((0.1, 10, 0, 0, 0, 0, 0, 0), (0.3, 0, 0, 0, 0, 0, 0.1, 1), (0.5, 0, 0, 0, 0, 0, 0, 1))

    def test_rows_hold_until_the_next(self) -> None:
        led = Led(self.ROWS).run(150)
        assert led.way == pytest.approx([0.05 * 0.2, 0.0, 0.0], abs=slip(150, 0.1))
        assert led.s.taught == 2

    def test_points_are_taught_when_their_rows_come(self) -> None:
        led, taught = Led(self.ROWS), []
        for _ in range(150):
            taught.append(int(led.run(1).s.taught))
        assert [taught.index(n) for n in (1, 2)] == [74, 124]

    def test_noise_is_that_of_the_hand(self) -> None:
        led, n = Led(hand_noise=3.0), 2000
        forces = np.array([led.run(1).s.force.copy() for _ in range(n)])
        assert forces.std() == pytest.approx(3.0, abs=3.0 * 0.5 * chance(of_variance(3 * n)))
        assert Led().run(1).s.force.max() == EXACT

    def test_times_that_do_not_increase_are_refused(self) -> None:
        rows = np.array(self.ROWS)[[0, 2, 1]]
        assert "the times of the table 'operator' do not increase from row 1 (counted from zero) to the next" in Led(rows).message


def test_a_motion_out_of_the_axis_limits_is_not_made() -> None:
    limits = np.array(Q_START) + 1e-3
    led = Led(q_max=limits).run(200, f_hand_B=[10.0, 10.0, 10.0])
    assert led.status == 0
    assert np.all(led.s.q <= limits)


def test_a_singular_posture_ends_the_run() -> None:
    q = np.array(Q_START)
    q[4] = 1e-7
    led = Led(q_start=q).run(5, joystick_B=[0.0, 0.0, 0.2])
    assert (
        "s: the robot stands in a singular posture, A5 = 0.0000 rad, and cannot be led in every direction: start elsewhere" in led.message
    )


def test_compiled_is_plain_bit_by_bit() -> None:
    plain, fast = (Led(TestOperator.ROWS, compiled=c, hand_noise=1.0) for c in (False, True))
    for _ in range(100):
        assert np.array_equal(plain.run(1, f_hand_B=[3.0, 2.0, 1.0]).s.q, fast.run(1, f_hand_B=[3.0, 2.0, 1.0]).s.q)
