"""Example components of recorded machines: feed drive, spindle, a robot whose joints give way."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robomill.fmus.components import component
from robomill.models.model.declaration import Model, record
from robomill.models.robot.kinematics import jacobian
from tests import ROOT
from tests.tolerances import EXACT, ROUNDOFF

SPINDLE = {"idle_power": 180.0, "cutting_power": 20.0, "wear_power": 5.0}
POSE = {"q": [0.3, -1.2, 1.4, 0.5, -0.8, 0.2], "f_T_B": [300.0, -200.0, 500.0], "m_T_B": [10.0, 20.0, -5.0]}


def model(file: str) -> Model:
    return component(f"python:{ROOT / 'examples' / file}:MODEL")


def answer(of: Model, output: str, **values: Any) -> Any:
    """An output for these inputs and parameters; the first step answers as the initialisation does."""
    data = of.new()
    for name, value in values.items():
        data[name] = value
    s = record(data)
    assert of.init(s) == 0
    first = np.array(s[output], copy=True)
    assert of.step(s, 0.0, 0.1) == 0
    assert np.all(first - s[output] == EXACT)
    return first


class TestFeedDrive:
    DRIVE = model("machine_axes/feed_drive.py")

    def test_the_nominal_drive_takes_no_current(self) -> None:
        assert answer(self.DRIVE, "current", speed=0.02, acceleration=1.0) == 0.0

    def test_each_effect_adds_its_own_term(self) -> None:
        motion = {"speed": 0.005, "acceleration": -0.3}
        terms = {
            "acceleration_current": 2.0 * -3.0,
            "viscous_friction": 2.0 * 0.25,
            "coulomb_friction": 2.0 * math.tanh(10.0),
            "current_offset": 2.0,
        }
        for name, truth in terms.items():
            assert answer(self.DRIVE, "current", **motion, **{name: 2.0}) == pytest.approx(truth, rel=10.0 * ROUNDOFF)
        together = answer(self.DRIVE, "current", **motion, **dict.fromkeys(terms, 2.0))
        assert together == pytest.approx(sum(terms.values()), rel=10.0 * ROUNDOFF)

    def test_an_input_that_is_not_finite_is_an_error(self) -> None:
        s = record(self.DRIVE.new())
        s.speed = math.nan
        assert "an input is not finite at 0.0 s: speed nan m/s" in self.DRIVE.message(self.DRIVE.init(s), s, 0.0)


class TestSpindle:
    SPINDLE = model("machine_axes/spindle_motor.py")

    @pytest.mark.parametrize(
        ("speed", "feed", "worn", "power"),
        [
            (335.1, 0.006, False, 200.0),
            (335.1, 0.006, True, 205.0),
            (335.1, 0.05, True, 180.0),
            (-335.1, 0.006, False, 200.0),
            (0.0, 0.006, True, 0.0),
        ],
        ids=["cut", "worn tool", "rapid move", "other direction", "standing"],
    )
    def test_cut_and_wear_count_only_where_it_cuts(self, speed: float, feed: float, worn: bool, power: float) -> None:
        found = answer(self.SPINDLE, "power", speed=speed, feed=feed, tool_worn=worn, **SPINDLE)
        assert found == pytest.approx(power, rel=ROUNDOFF)

    def test_the_nominal_spindle_turns_for_nothing(self) -> None:
        assert answer(self.SPINDLE, "power", speed=335.1, feed=0.006, tool_worn=True) == 0.0


class TestJointCompliance:
    ROBOT = model("static_compliance/joint_compliance.py")

    def test_the_nominal_robot_is_rigid(self) -> None:
        assert np.all(answer(self.ROBOT, "d_T_B", **POSE) == 0.0)

    def test_joints_give_way_as_the_jacobian_says(self) -> None:
        c = np.array([1.0, 0.5, 2.0, 3.0, 4.0, 5.0]) * 1e-6
        J, s = np.zeros((6, 6)), record(self.ROBOT.new())
        jacobian(s, np.array(POSE["q"]), J)
        wrench = np.concatenate([POSE["f_T_B"], POSE["m_T_B"]])
        expected = J[:3] @ (c * (J.T @ wrench))
        np.testing.assert_allclose(answer(self.ROBOT, "d_T_B", **POSE, joint_compliance=c), expected, rtol=1e3 * ROUNDOFF)

    def test_across_all_axes_of_a_joint_it_is_a_ball_joint(self) -> None:
        """Equal compliances about three axes at right angles: c (r x F + M) x r, r from the joint to the tool."""
        one, s = np.array([0.0, 0.0, 1e-6, 0.0, 0.0, 0.0]), record(self.ROBOT.new())
        jacobian(s, np.array(POSE["q"]), np.zeros((6, 6)))
        r = s.link_p[6] - s.link_p[2]
        moment = np.cross(r, POSE["f_T_B"]) + POSE["m_T_B"]
        found = answer(self.ROBOT, "d_T_B", **POSE, joint_compliance=one, tilt_compliance=one)
        np.testing.assert_allclose(found, 1e-6 * np.cross(moment, r), rtol=1e3 * ROUNDOFF)

    def test_the_base_gives_way_along_its_axes(self) -> None:
        found = answer(self.ROBOT, "d_T_B", **POSE, base_compliance=[1e-7, 2e-7, 3e-7])
        np.testing.assert_allclose(found, np.array([1e-7, 2e-7, 3e-7]) * POSE["f_T_B"], rtol=ROUNDOFF)

    def test_a_coupling_that_is_taken_twice_or_not_at_all_is_another_pose(self) -> None:
        """A3 shown against the horizontal, theta_3 = -(A2 + A3): without the coupling that pose is one of another A3."""
        coupling = np.zeros((6, 6))
        coupling[2, 1] = -1.0
        geometry = {
            "axis_coupling": coupling,
            "axis_sign": [1.0, 1.0, -1.0, -1.0, -1.0, -1.0],
            "joint_compliance": [0.0, 0.0, 0.0, 0.0, 1e-6, 0.0],
        }
        shown = answer(self.ROBOT, "d_T_B", **POSE, **geometry)
        q = np.array(POSE["q"])
        q[2] += q[1]
        plain = {**POSE, "q": q}
        for share in ({"pendant_coupling": 0.0}, {"coupling_error": -1.0}):
            np.testing.assert_allclose(answer(self.ROBOT, "d_T_B", **plain, **geometry, **share), shown, rtol=1e3 * ROUNDOFF)
            assert np.abs(answer(self.ROBOT, "d_T_B", **POSE, **geometry, **share) - shown).max() > 0.01 * np.abs(shown).max()

    def test_an_input_that_is_not_finite_is_an_error(self) -> None:
        s = record(self.ROBOT.new())
        s.f_T_B[1] = math.inf
        assert "an input is not finite" in self.ROBOT.message(self.ROBOT.init(s), s, 0.0)
