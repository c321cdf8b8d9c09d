"""path_learning: path frame, force control and protective actions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robomill.models.components.path_learning import FOLLOWING, HOLDING, MODEL, SEARCHING
from robomill.models.model.declaration import record
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS
from robomill.models.robot.numeric_inverse import solve
from tests.tolerances import EXACT, ROUNDOFF

H = 0.004
FEED = np.array([0.005, 0.0, 0.0])
DOWN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""R_BT of a tool that points down: x of T along -z of B."""
PLACE = np.array([1.6, 0.1, 1.0])
Q = solve(KR300, SPINDLE_ACROSS, PLACE, DOWN, KR300.q_home)
FORCE = 10.0
"""N: size of the forces; ROUNDOFF is relative to it."""
POSE = 1e-9
"""m: what the numeric inverse kinematics that made the posture leaves."""


class Control:
    """One instance above the part."""

    def __init__(self, **parameters: Any) -> None:
        self.data = MODEL.new()
        self.s = record(self.data)
        for name, value in parameters.items():
            self.data[name] = value
        self.data["q_motor"] = Q
        self.init, self.step = MODEL.plain()
        self.k, self.status = 0, 0
        assert self.init(self.s) == 0

    def run(self, steps: int, force_B: Any = (0.0, 0.0, 0.0), feed: Any = FEED) -> Control:
        """Cycles with this force on the tool and this feed, until one fails."""
        self.data["f_T_T"] = DOWN.T @ np.asarray(force_B)
        self.data["v_BT_B"] = feed
        for _ in range(steps):
            self.status = self.step(self.s, self.k * H, H)
            self.k += 1
            if self.status:
                break
        return self

    @property
    def message(self) -> str:
        return MODEL.message(self.status, self.s, self.k * H)


@pytest.mark.parametrize(
    ("side", "feed", "towards"), [(1, (1, 0), (0, 1)), (-1, (1, 0), (0, -1)), (1, (0, 1), (-1, 0)), (1, (-3, 4), (-0.8, -0.6))]
)
def test_the_correction_goes_to_the_side_of_the_part(side: int, feed: tuple[int, int], towards: tuple[float, float]) -> None:
    s = Control(side=side).run(5, feed=[0.001 * feed[0], 0.001 * feed[1], 0.0]).s
    assert s.correction_B / np.linalg.norm(s.correction_B) == pytest.approx([*towards, 0.0], abs=POSE)


def test_the_measured_pose_is_that_of_the_encoders() -> None:
    s = Control().run(1).s
    assert s.p_BT_B == pytest.approx(PLACE, abs=POSE)


def test_the_correction_integrates_the_filtered_force() -> None:
    """Force F from rest: F' after n steps is F (1 - a^n), a = exp(-2 pi f h); x = g h sum(F_d - F')."""
    n, g, f = 50, 1e-4, 10.0
    s = Control(gain=g, desired_force=20.0, filter_frequency=f).run(n, (0.0, -FORCE, 0.0)).s
    a = math.exp(-2.0 * math.pi * f * H)
    filtered = FORCE * (1.0 - a ** np.arange(1, n + 1))
    assert s.normal_force == pytest.approx(FORCE, rel=POSE)
    assert s.filtered_force == pytest.approx(filtered[-1], rel=POSE)
    assert s.correction_B[1] == pytest.approx(g * H * np.sum(20.0 - filtered), rel=POSE)


def test_force_along_the_feed_and_the_tool_is_left_to_position_control() -> None:
    pushed, free = (Control().run(20, f).s.correction_B.copy() for f in ((80.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert pushed == pytest.approx(free, abs=POSE * 1e-3)


def test_where_the_path_stands_the_frame_stays() -> None:
    control = Control().run(5)
    before = control.s.correction_B.copy()
    after = control.run(5, feed=(0.0, 0.0, 0.0)).s.correction_B
    assert after == pytest.approx(2.0 * before, rel=ROUNDOFF)


class TestProtection:
    def test_the_feed_creeps_until_the_part_is_found(self) -> None:
        control = Control(creep=0.1).run(10)
        assert (control.s.phase, control.s.speed_ratio, control.s.contact) == (SEARCHING, 0.1, 0)
        control.run(50, (0.0, -FORCE, 0.0))
        assert (control.s.phase, control.s.speed_ratio, control.s.contact) == (FOLLOWING, 1.0, 1)

    @pytest.mark.parametrize(("wait", "phase"), [(0, FOLLOWING), (1, SEARCHING)])
    def test_lost_contact_is_waited_for_if_asked(self, wait: int, phase: int) -> None:
        control = Control(wait_for_contact=wait).run(50, (0.0, -FORCE, 0.0)).run(100)
        assert (control.s.contact, control.s.phase) == (0, phase)

    def test_above_the_force_limit_the_feed_stands_until_the_force_is_back(self) -> None:
        control = Control(force_limit=50.0, desired_force=20.0).run(50, (0.0, -60.0, 0.0))
        assert (control.s.phase, control.s.speed_ratio) == (HOLDING, EXACT)
        assert control.run(20, (0.0, -30.0, 0.0)).s.phase == HOLDING
        assert control.run(50, (0.0, -15.0, 0.0)).s.phase == FOLLOWING

    def test_a_force_that_stays_ends_the_run(self) -> None:
        control = Control(force_limit=50.0, limit_time=0.2).run(500, (0.0, -60.0, 0.0))
        assert control.message.startswith("path_learning: force limit exceeded: at t = ")
        assert (
            "s the force is 60.0 N, more than 10.0 N for 0.200 s after it passed force_limit = 50.0 N, and the feed stands: teach guiding "
            "points further from the part, or check gain = 7.6e-05 m/(N s) against the stiffness of the contact" in control.message
        )

    def test_a_part_that_is_not_there_ends_the_run(self) -> None:
        control = Control(search_limit=2e-3).run(2000)
        assert (
            "s the search has gone 0.0020 m without contact (search_limit 0.002 m), the force is 0.00 N, expected more than 3.0 N: check "
            "side = 1, teach guiding points nearer to the part, or raise search_limit" in control.message
        )


def test_compiled_is_plain_bit_by_bit() -> None:
    plain, fast = Control(), Control()
    fast.init, fast.step = MODEL.compiled()
    for force in ((0.0, 0.0, 0.0), (3.0, -14.0, 1.0), (0.0, -120.0, 0.0)):
        for control in (plain, fast):
            control.run(40, force, (0.004, 0.001, 0.0))
        assert np.array_equal(plain.s.correction_B, fast.s.correction_B)
        assert plain.s.phase == fast.s.phase
