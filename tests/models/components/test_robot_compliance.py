"""robot_compliance: where the tool tip of the loaded robot is. Read as its specification.

The nominal model itself is checked in tests/models/robot/test_virtual_joints.py
and tests/models/calibration/test_validation_loads.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation

from robomill.models.calibration.validation_loads import validation_loads
from robomill.models.components.robot_compliance import ERRORS, MODEL, VARIABLES
from robomill.models.model.declaration import Record, record
from robomill.models.robot.dynamics import counterbalance_torque
from robomill.models.robot.kinematics import KR300, inverse
from robomill.models.robot.virtual_joints import DRIVES
from tests.tolerances import EXACT, ROUNDOFF, discretisation, physics

H = 0.004
DEG = np.pi / 180.0
POSITION_1 = np.array([2.66, -77.64, 77.44, 0.0, 0.20, 0.0]) * DEG
RIGID = 1e30
AXES = range(6)
SEEDS = range(100)
EFFECTS = [v for v in VARIABLES if v.effect]
OUTPUTS = [v.name for v in VARIABLES if v.causality == "output"]
init, step = MODEL.plain()


def instance(**values: Any) -> Record:
    """A fresh record at position 1, with the named fields set."""
    s = record(MODEL.new())
    s.q_link[:] = POSITION_1
    for name, value in values.items():
        field = getattr(s, name)
        if np.ndim(field):
            field[...] = value
        else:
            setattr(s, name, value)
    return s


def started(**values: Any) -> Record:
    """An instance with these values, initialised."""
    s = instance(**values)
    assert init(s) == 0
    return s


def outputs(s: Record) -> np.ndarray:
    return np.concatenate([np.array(getattr(s, name)) for name in OUTPUTS])


def displacement(**values: Any) -> np.ndarray:
    return np.array(started(**values).d_T_B)


def only_drive(axis: int) -> np.ndarray:
    """A stiffness table in which only the drive of axis 0..5 turns."""
    table = np.full((11, 3), RIGID)
    table[DRIVES[axis], 2] = record(MODEL.new()).stiffness[DRIVES[axis], 2]
    return table


def axis_direction(axis: int, q: np.ndarray = POSITION_1) -> np.ndarray:
    """Unit vector in B about which axis 0..5 turns positively, from a small turn of the rigid robot."""
    turned = np.array(q)
    turned[axis] += 1e-3
    one, two = (Rotation.from_quat(np.roll(np.array(started(q_link=x).quat_BT), -1)) for x in (q, turned))
    vector: np.ndarray = (two * one.inv()).as_rotvec()
    return vector / np.linalg.norm(vector)


class Twist:
    """The elastic angle of one axis under a torque about it; everything else is rigid."""

    def __init__(self, axis: int, **values: Any) -> None:
        self.direction = axis_direction(axis)
        self.s = started(stiffness=only_drive(axis), **values)
        self.time = 0.0

    def __call__(self, torque: float, h: float = H) -> float:
        self.s.m_T_B[:] = torque * self.direction
        assert step(self.s, self.time, h) == 0
        self.time += h
        return float(np.array(self.s.theta_T_B) @ self.direction)


class TestPhysics:
    """The nominal robot, all effects off."""

    @pytest.mark.parametrize("seed", range(20))
    def test_without_load_the_tool_is_where_the_axes_put_it(self, seed: int) -> None:
        s = started(q_link=np.random.default_rng(seed).uniform(KR300.q_min, KR300.q_max))
        assert np.abs(s.d_T_B).max() == EXACT
        assert np.abs(s.theta_T_B).max() == EXACT
        assert np.abs(s.p_BT_B - s.link_p[6]).max() == EXACT
        R = Rotation.from_quat(np.roll(np.array(s.quat_BT), -1)).as_matrix()
        assert np.abs(R - s.link_R[6]).max() < ROUNDOFF

    @pytest.mark.paper
    def test_mean_of_the_published_loads(self) -> None:
        """Haehn & Weigold 2020, sec. 3.1: 60 loads of 750 N, 1.72 mm on average (tool calibrated to it), half of the last digit."""
        loads = validation_loads()
        lengths = [np.linalg.norm(displacement(q_link=q, f_T_B=f)) for q, f in zip(loads.q, loads.f_T_B, strict=True)]
        assert abs(np.mean(lengths) - 1.72e-3) < physics(0.0, absolute=5e-6)

    def test_force_on_the_tool_pushes_it_along(self) -> None:
        """Sign: force ACTS ON the tool. 750 N in +x at position 1 moves it by (0.942, 0.082, 0.413) mm, see test_compliance."""
        assert np.abs(displacement(f_T_B=[750.0, 0, 0]) * 1e3 - [0.942, 0.082, 0.413]).max() < physics(0.0, absolute=2e-3)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_actual_pose_is_the_rigid_one_moved_by_d_and_theta(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        s = started(
            q_link=rng.uniform(KR300.q_min, KR300.q_max), f_T_B=rng.uniform(-700, 700, 3), m_T_B=rng.uniform(-70, 70, 3), payload_error=9.0
        )
        assert np.abs(s.p_BT_B - s.link_p[6] - s.d_T_B).max() < ROUNDOFF
        R = Rotation.from_quat(np.roll(np.array(s.quat_BT), -1)).as_matrix()
        assert np.abs(R - Rotation.from_rotvec(np.array(s.theta_T_B)).as_matrix() @ s.link_R[6]).max() < 10 * ROUNDOFF
        assert s.quat_BT[0] >= 0.0
        assert abs(np.linalg.norm(s.quat_BT) - 1.0) < ROUNDOFF

    @pytest.mark.parametrize("moment", [-30.0, 30.0])
    def test_scalar_part_of_the_orientation_stays_positive(self, moment: float) -> None:
        """Orientation 0 turned about the tool by half a turn has w = 0: the deflection decides its sign, the output keeps w >= 0."""
        q, R, p = np.zeros(6), Rotation.from_rotvec([0.0, np.pi, 0.0]).as_matrix(), np.array([1.4, 0.2, 1.5])
        assert inverse(instance(), p, R, POSITION_1, q) == 0
        s = started(q_link=q, m_T_B=[0.0, moment, 0.0])
        assert 0.0 < s.quat_BT[0] < 1e-3
        assert abs(s.theta_T_B[1]) > 1e-4

    def test_answers_without_delay(self) -> None:
        """Direct feedthrough, as `depends_on` declares: the loop with the cutting force is algebraic."""
        s = started()
        s.f_T_B[0] = 500.0
        assert step(s, 0.0, H) == 0
        assert np.abs(outputs(s) - outputs(started(f_T_B=[500.0, 0, 0]))).max() == EXACT
        for name in OUTPUTS:
            assert MODEL.variable(name).depends_on == ("q_link", "f_T_B", "m_T_B", "f_turn_T_B", "m_turn_T_B")

    def test_step_size_does_not_matter(self) -> None:
        """Quasi-static: one long step, many short ones."""
        one, many = started(), started()
        for s, h, n in ((one, 0.1, 1), (many, 0.001, 100)):
            s.f_T_B[:] = [300.0, 100.0, -200.0]
            for k in range(n):
                assert step(s, k * h, h) == 0
        assert np.abs(outputs(one) - outputs(many)).max() == EXACT


class TestStiffnessEffects:
    """Drive stiffness that is not the table's."""

    @pytest.mark.parametrize("axis", AXES)
    def test_stiffness_error_scales_one_drive(self, axis: int) -> None:
        error, table = np.zeros(6), np.array(instance().stiffness)
        error[axis] = -0.2
        table[DRIVES[axis], 2] *= 0.8
        load = {"f_T_B": [300.0, -400.0, 200.0], "m_T_B": [10.0, 20.0, 30.0]}
        with_error = displacement(stiffness_error=error, **load)
        assert np.abs(with_error - displacement(stiffness=table, **load)).max() < ROUNDOFF
        assert np.abs(with_error - displacement(**load)).max() > 1e-9

    @pytest.mark.parametrize("axis", AXES)
    @pytest.mark.parametrize("part", [-1.0, 0.1, 0.5, 1.0])
    def test_hardening_reaches_its_value_at_the_reference_torque(self, axis: int, part: float) -> None:
        hardening = np.zeros(6)
        hardening[axis] = 0.4
        twist = Twist(axis, stiffness_hardening=hardening)
        k, torque = twist.s.stiffness[DRIVES[axis], 2], part * twist.s.reference_torque[axis]
        expected = torque / (k * (1.0 + 0.4 * abs(part)))
        assert abs(twist(torque) - expected) < 1e4 * ROUNDOFF * abs(expected)

    @pytest.mark.parametrize("axis", AXES)
    def test_asymmetry_tells_push_from_pull(self, axis: int) -> None:
        """Stiffer for torques in the positive sense of the axis angle, softer against it."""
        asymmetry = np.zeros(6)
        asymmetry[axis] = 0.25
        twist = Twist(axis, stiffness_asymmetry=asymmetry)
        k = twist.s.stiffness[DRIVES[axis], 2]
        assert abs(twist(100.0) * k - 100.0 / 1.25) < 1e6 * ROUNDOFF
        assert abs(twist(-100.0) * k + 100.0 / 0.75) < 1e6 * ROUNDOFF

    @pytest.mark.parametrize("axis", AXES)
    def test_tilt_compliance_softens_the_table_across_the_axis(self, axis: int) -> None:
        tilt, table = np.zeros(6), np.array(instance().stiffness)
        tilt[axis] = 2e-7
        table[DRIVES[axis], :2] = 1.0 / (1.0 / table[DRIVES[axis], :2] + 2e-7)
        load = {"f_T_B": [300.0, -400.0, 200.0], "m_T_B": [10.0, 20.0, 30.0]}
        with_tilt = displacement(tilt_compliance=tilt, **load)
        assert np.abs(with_tilt - displacement(stiffness=table, **load)).max() < ROUNDOFF
        assert np.abs(with_tilt - displacement(**load)).max() > 1e-9


class TestGearHysteresis:
    """Lost motion that lags behind the torque (play elements, the torque-driven dual of Maxwell slip)."""

    @staticmethod
    def gear(axis: int, width: float = 1e-4) -> Twist:
        hysteresis = np.zeros(6)
        hysteresis[axis] = width
        return Twist(axis, gear_hysteresis=hysteresis)

    @staticmethod
    def beyond_elastic(twist: Twist, axis: int, torque: float) -> float:
        return twist(torque) - torque / twist.s.stiffness[DRIVES[axis], 2]

    @pytest.mark.parametrize("axis", AXES)
    def test_loop_is_as_wide_as_declared(self, axis: int) -> None:
        """After a large torque either way, unloaded, the tool rests half a width aside."""
        twist = self.gear(axis)
        large = 10.0 * twist.s.hysteresis_torque[axis]
        twist(large)
        assert abs(twist(0.0) - 1e-4) < 1e-4 * 1e4 * ROUNDOFF
        twist(-large)
        assert abs(twist(0.0) + 1e-4) < 1e-4 * 1e4 * ROUNDOFF

    def test_small_torques_do_not_enter_the_lost_motion(self) -> None:
        """Below the smallest threshold, a quarter of the mean, a fresh gear is purely elastic."""
        twist = self.gear(1)
        for part in (0.2, -0.2, 0.24):
            assert abs(self.beyond_elastic(twist, 1, part * twist.s.hysteresis_torque[1])) < ROUNDOFF * 1e-4

    def test_does_not_depend_on_the_rate(self) -> None:
        slow, fast = self.gear(2), self.gear(2)
        for end in (300.0, -120.0, 200.0):
            for part in np.linspace(0.05, 1.0, 20):
                slow_result = slow(end * part, 0.1)
            fast_result = fast(end, 1e-4)
            assert abs(slow_result - fast_result) < ROUNDOFF * 1e-3
            slow(0.0)
            fast(0.0)

    def test_eats_the_energy_of_its_loop(self) -> None:
        """A full cycle dissipates 4 h times the mean threshold torque (area of the saturated play loops), and never gives energy."""
        twist = self.gear(1)
        threshold = twist.s.hysteresis_torque[1]
        twist(5.0 * threshold)
        torques = 5.0 * threshold * np.r_[np.linspace(1, -1, 161), np.linspace(-1, 1, 161)[1:]]
        angles = np.array([twist(float(torque)) for torque in torques])
        work = np.sum(0.5 * (torques[1:] + torques[:-1]) * np.diff(angles))
        # all kinks of the loop lie on multiples of the torque step of threshold/16, so the trapezoids are exact
        assert abs(work - 4.0 * 1e-4 * threshold) < 1e5 * ROUNDOFF * work


class TestGearFriction:
    """Friction beside the drive spring (Maxwell slip): the other law of hysteresis."""

    @staticmethod
    def gear(axis: int, friction: float = 40.0) -> Twist:
        values = np.zeros(6)
        values[axis] = friction
        return Twist(axis, gear_friction=values)

    @pytest.mark.parametrize("axis", AXES)
    def test_slips_before_the_spring_and_sticks_after_a_reversal(self, axis: int) -> None:
        """All slipping M = k gamma + M_f; from there the torque falls with k (1 + rho)."""
        twist = self.gear(axis)
        k, large = twist.s.stiffness[DRIVES[axis], 2], 2000.0
        assert abs(twist(large) - (large - 40.0) / k) < 1e4 * ROUNDOFF * large / k
        fallen = twist(large) - twist(large - 10.0)
        assert abs(fallen - 10.0 / (k * (1.0 + twist.s.friction_stiffness))) < 1e6 * ROUNDOFF * fallen

    @pytest.mark.parametrize("axis", AXES)
    def test_loop_is_as_wide_as_the_friction_bends_the_spring(self, axis: int) -> None:
        """After a large torque either way, unloaded, the spring holds the whole friction: 2 M_f/k wide."""
        twist = self.gear(axis)
        twist(2000.0)
        above = twist(0.0)
        twist(-2000.0)
        wide = above - twist(0.0)
        assert abs(wide - 2.0 * 40.0 / twist.s.stiffness[DRIVES[axis], 2]) < 1e5 * ROUNDOFF * wide

    def test_does_not_depend_on_the_rate(self) -> None:
        slow, fast = self.gear(2), self.gear(2)
        for end in (300.0, -120.0, 200.0, -50.0):
            start = 0.0
            for part in np.linspace(0.05, 1.0, 20):
                slow_result = slow(start + (end - start) * part, 0.1)
            assert abs(slow_result - fast(end, 1e-4)) < ROUNDOFF * 1e-3
            slow(0.0)
            fast(0.0)

    def test_follows_elements_that_are_written_out(self) -> None:
        """Against the definition, driven by the angle in steps of a nanoradian's order, over a path with inner loops."""
        twist = self.gear(3, 60.0)
        k = float(twist.s.stiffness[DRIVES[3], 2])
        stick = twist.s.friction_stiffness * k * np.array([1 / 2, 1 / 3, 1 / 4, 1 / 5]) / (77 / 60)
        element, angle = np.zeros(4), 0.0
        for end in (8e-4, -2e-4, 5e-4, -9e-4, 1e-4):
            for new in np.linspace(angle, end, 200)[1:]:
                element = np.clip(element + stick * (new - angle), -15.0, 15.0)
                angle = float(new)
                found = twist(k * angle + float(element.sum()))
                assert abs(found - angle) < 1e-3 * ROUNDOFF

    def test_eats_the_energy_of_its_loop(self) -> None:
        """Each element eats 4 f (gamma_max - f/k_e) in a cycle in which it slips both ways; no cycle gives energy."""
        twist = self.gear(1, 80.0)
        k, large = float(twist.s.stiffness[DRIVES[1], 2]), 2400.0
        stick = twist.s.friction_stiffness * k * np.array([1 / 2, 1 / 3, 1 / 4, 1 / 5]) / (77 / 60)
        twist(large)
        torques = large * np.r_[np.linspace(1, -1, 2001), np.linspace(-1, 1, 2001)[1:]]
        angles = np.array([twist(float(torque)) for torque in torques])
        work = np.sum(0.5 * (torques[1:] + torques[:-1]) * np.diff(angles))
        expected = np.sum(4.0 * 20.0 * ((large - 80.0) / k - 20.0 / stick))
        assert abs(work - expected) < discretisation(1.0, 2.0 / 2000.0, 2) * expected * 10.0
        assert np.sum(0.5 * (torques[1:21] + torques[:20]) * np.diff(angles[:21])) < 0.0


class TestAdditionsAtTheTip:
    """Compliances and displacements that act on the tool tip directly."""

    def test_base_compliance_adds_along_the_axes_of_b(self) -> None:
        load = np.array([300.0, -400.0, 200.0])
        c = np.array([0.05e-6, 0.1e-6, 0.02e-6])
        added = displacement(f_T_B=load, base_compliance=c) - displacement(f_T_B=load)
        assert np.abs(added - c * load).max() < ROUNDOFF

    def test_tool_compliance_adds_across_the_tool_axis_only(self) -> None:
        s = started()
        axis, across = np.array(s.link_R[6, :, 0]), np.array(s.link_R[6, :, 1])
        for direction, expected in ((axis, np.zeros(3)), (across, 0.3e-6 * 500.0 * across)):
            added = displacement(f_T_B=500.0 * direction, tool_compliance=0.3e-6) - displacement(f_T_B=500.0 * direction)
            assert np.abs(added - expected).max() < ROUNDOFF

    def test_thermal_growth_moves_the_tip_away_from_the_base(self) -> None:
        """Growth 200 um: nothing at the start, 1 - 1/e after a time constant, all in the end."""
        s = started(thermal_growth=200e-6, thermal_time_constant=100.0)
        outward = np.array(s.link_p[6]) / np.linalg.norm(s.link_p[6])
        assert np.abs(s.d_T_B).max() == EXACT
        for t, part in ((100.0 - H, 1.0 - np.exp(-1.0)), (1e4, 1.0)):
            assert step(s, t, H) == 0
            assert np.abs(s.d_T_B - 200e-6 * part * outward).max() < ROUNDOFF

    def test_warm_up_before_the_start_counts(self) -> None:
        growth = np.linalg.norm(displacement(thermal_growth=200e-6, thermal_time_constant=100.0, warm_up_time=100.0))
        assert abs(growth - 200e-6 * (1.0 - np.exp(-1.0))) < ROUNDOFF


class TestGravityEffects:
    """Loads that the robot is not set up for."""

    @pytest.mark.parametrize("seed", range(20))
    def test_payload_error_is_a_weight_at_the_centre_of_gravity(self, seed: int) -> None:
        """Same as a force and moment at T that are equivalent to m g at G, with the springs in front of the sensor rigid."""
        q = np.random.default_rng(seed).uniform(KR300.q_min, KR300.q_max)
        table = np.array(instance().stiffness)
        table[9:] = RIGID
        s = started(q_link=q, stiffness=table, payload_error=20.0)
        weight = np.array([0.0, 0.0, -20.0 * 9.81])
        p_BG_B = s.link_p[5] + s.link_R[5] @ s.p_FG_F
        moment = np.cross(p_BG_B - s.link_p[6], weight)
        expected = displacement(q_link=q, stiffness=table, f_T_B=weight, m_T_B=moment)
        assert np.abs(s.d_T_B - expected).max() < ROUNDOFF

    def test_payload_beyond_the_setting_lowers_the_tool(self) -> None:
        """20 kg more weigh on the tool nearly as 196 N at T would: G is within a tenth of T's distance from the axes; less mass lifts."""
        table = np.array(instance().stiffness)
        table[9:] = RIGID
        lowered = displacement(stiffness=table, f_T_B=[0.0, 0.0, -196.2])[2]
        assert lowered < 0.0
        assert abs(displacement(payload_error=20.0)[2] - lowered) < physics(lowered, relative=0.1)
        assert displacement(payload_error=-20.0)[2] > 0.0

    def test_payload_does_not_bend_the_holder(self) -> None:
        """The springs in front of the sensor carry the end effector's own mass in part; they are left out."""
        soft = np.array(instance().stiffness)
        soft[9] /= 10.0
        assert np.abs(displacement(payload_error=20.0) - displacement(payload_error=20.0, stiffness=soft)).max() == EXACT

    @pytest.mark.parametrize("a2", [-130.0, -95.0, -60.0, -20.0])
    def test_counterbalance_error_turns_axis_two(self, a2: float) -> None:
        """A tenth more pull against +A2: the elastic angle of axis 2 alone, and the arm in front is lifted."""
        q = POSITION_1.copy()
        q[1] = a2 * DEG
        s = started(q_link=q, counterbalance_error=0.1)
        angle = -0.1 * counterbalance_torque(s, a2 * DEG) / s.stiffness[1, 2]
        assert np.abs(s.theta_T_B - angle * axis_direction(1, q)).max() < 1e-3 * abs(angle) + ROUNDOFF
        assert np.sign(round(float(s.d_T_B[2]) * 1e9)) == np.sign(a2 + 95.0)


class TestStructuralMode:
    """A second-order mode that the table lacks."""

    @staticmethod
    def response(h: float, n: int, force: Callable[[int], float], **values: Any) -> np.ndarray:
        """Deflection beyond the nominal one along the mode, from the record's state."""
        s = started(mode_compliance=1e-6, **values)
        result = []
        for k in range(n):
            s.f_T_B[1] = force(k)
            assert step(s, k * h, h) == 0
            result.append(float(s.mode_deflection))
        return np.array(result)

    @pytest.mark.parametrize(("frequency", "damping"), [(9.0, 0.02), (36.0, 0.04), (120.0, 0.3), (5.5, 0.0)])
    def test_equals_the_exact_discretisation(self, frequency: float, damping: float) -> None:
        """Scipy's zero-order hold (matrix exponential) of c w^2/(s^2 + 2 zeta w s + w^2), random force."""
        omega = 2 * np.pi * frequency
        forces = np.random.default_rng(3).uniform(-500, 500, 200)
        forces[0] = 0.0
        A, B = np.array([[0, 1], [-(omega**2), -2 * damping * omega]]), np.array([[0], [1e-6 * omega**2]])
        Ad, Bd, *_ = signal.cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), H)
        x, expected = np.zeros(2), []
        for f in forces:
            x = Ad @ x + Bd[:, 0] * f
            expected.append(x[0])
        ours = self.response(H, 200, lambda k: forces[k], mode_frequency=frequency, mode_damping=damping)
        assert np.abs(ours - expected).max() < 1e3 * ROUNDOFF * np.abs(expected).max()

    def test_halving_the_step_changes_nothing(self) -> None:
        coarse = self.response(H, 100, lambda k: 400.0 if k < 50 else 0.0)
        fine = self.response(H / 2, 200, lambda k: 400.0 if k < 100 else 0.0)
        assert np.abs(coarse - fine[1::2]).max() < 1e3 * ROUNDOFF * 400e-6

    def test_settles_at_its_static_compliance(self) -> None:
        settled = self.response(0.05, 100, lambda k: 400.0, mode_damping=0.2)[-1]
        assert abs(settled - 400e-6) < 1e3 * ROUNDOFF * 400e-6

    def test_starts_at_rest_under_the_load(self) -> None:
        s = started(mode_compliance=1e-6, f_T_B=[0.0, 400.0, 0.0])
        before = outputs(s)
        assert step(s, 0.0, H) == 0
        assert np.abs(outputs(s) - before).max() < ROUNDOFF

    @pytest.mark.parametrize("direction", [(0.0, 3.0, 0.0), (1.0, 1.0, 0.0), (0.2, -0.5, 0.9)])
    def test_moves_along_its_direction_driven_by_the_force_along_it(self, direction: Sequence[float]) -> None:
        load = np.array([100.0, 300.0, -200.0])
        n = np.array(direction) / np.linalg.norm(direction)
        added = displacement(f_T_B=load, mode_compliance=1e-6, mode_direction=direction) - displacement(f_T_B=load)
        assert np.abs(added - 1e-6 * (n @ load) * n).max() < ROUNDOFF


class TestEffectsInGeneral:
    """What DIAGNOSIS expects of every effect."""

    @pytest.mark.parametrize("effect", EFFECTS, ids=lambda v: v.name)
    def test_is_off_by_default_and_bounded(self, effect: Any) -> None:
        assert np.all(effect.start_values == 0.0)
        assert effect.minimum is not None
        assert effect.maximum is not None
        assert effect.minimum <= 0.0 < effect.maximum

    @pytest.mark.parametrize("effect", EFFECTS, ids=lambda v: v.name)
    def test_changes_the_pose_when_on(self, effect: Any) -> None:
        load = {"f_T_B": [300.0, -400.0, 200.0], "m_T_B": [5.0, -8.0, 12.0]}
        nominal, changed = started(**load), started(**load, **{effect.name: 0.2 * effect.maximum})
        for s in (nominal, changed):
            assert step(s, 10.0, H) == 0
        assert np.abs(outputs(nominal) - outputs(changed)).max() > 1e-9
        assert np.abs(changed.link_p - nominal.link_p).max() == EXACT, "the rigid robot is what it was"

    def test_their_companions_do_nothing_while_they_are_off(self) -> None:
        """Bitwise: time constants, thresholds and directions of effects that are off have no say."""
        companions = {
            "reference_torque": 10.0,
            "hysteresis_torque": 3.0,
            "friction_stiffness": 2.0,
            "p_FG_F": 1.0,
            "thermal_time_constant": 1.0,
            "warm_up_time": 900.0,
            "mode_frequency": 50.0,
            "mode_damping": 0.5,
            "mode_direction": (1.0, 2.0, 3.0),
            "counterbalance_lever": 0.1,
        }
        nominal, other = started(), started(**companions)
        rng = np.random.default_rng(4)
        for k in range(50):
            load = rng.uniform(-500, 500, 3)
            for s in (nominal, other):
                s.f_T_B[:] = load
                assert step(s, k * H, H) == 0
            assert np.abs(outputs(nominal) - outputs(other)).max() == EXACT


class TestStates:
    """Initialisation and memory."""

    def test_init_may_be_repeated(self) -> None:
        """Any number of times, after any inputs: the same as once with the last ones."""
        values = {"gear_hysteresis": 1e-4, "gear_friction": 40.0, "mode_compliance": 1e-6, "thermal_growth": 1e-4}
        again = started(f_T_B=[500.0, -300.0, 100.0], **values)
        for k in range(5):
            assert step(again, k * H, H) == 0
        again.f_T_B[:] = [-50.0, 20.0, 30.0]
        assert init(again) == 0
        assert init(again) == 0
        once = started(f_T_B=[-50.0, 20.0, 30.0], **values)
        assert np.abs(outputs(again) - outputs(once)).max() == EXACT
        assert np.abs(again.hysteresis_play - once.hysteresis_play).max() == EXACT
        assert np.abs(again.friction_torque - once.friction_torque).max() == EXACT


def test_the_robot_does_not_follow_what_changes_within_a_turn_of_the_spindle() -> None:
    force, moment, turning = np.array([100.0, -400.0, 200.0]), np.array([3.0, -8.0, 5.0]), np.array([20.0, -30.0, 50.0])
    effects = {"base_compliance": 1e-7, "tool_compliance": 1e-7, "mode_compliance": 1e-7, "geometric_stiffness": 1.0}
    alone = started(f_T_B=force - turning, m_T_B=moment - 0.1 * turning, **effects)
    beside = started(f_T_B=force, m_T_B=moment, f_turn_T_B=turning, m_turn_T_B=0.1 * turning, **effects)
    assert np.array_equal(outputs(alone), outputs(beside))
    assert np.abs(outputs(beside) - outputs(started(f_T_B=force, m_T_B=moment, **effects))).max() > 1e-6
    assert init(instance(f_turn_T_B=[np.nan, 0.0, 0.0])) != 0
    assert init(instance(m_turn_T_B=[0.0, np.inf, 0.0])) != 0


def test_compiled_gives_the_same_bits_as_plain_python() -> None:
    """All effects on, 300 steps of random inputs, every byte of the record."""
    compiled_init, compiled_step = MODEL.compiled()
    rng = np.random.default_rng(8)
    plain_data = MODEL.new()
    for effect in EFFECTS:
        plain_data[effect.name] = rng.uniform(0.0, 0.1, effect.shape) * effect.maximum
    compiled_data = plain_data.copy()
    plain_s, compiled_s = record(plain_data), record(compiled_data)
    assert init(plain_s) == compiled_init(compiled_s) == 0
    for k in range(300):
        q, f, m = POSITION_1 + rng.uniform(-0.3, 0.3, 6), rng.uniform(-500, 500, 3), rng.uniform(-30, 30, 3)
        for s in (plain_s, compiled_s):
            s.q_link[:], s.f_T_B[:], s.m_T_B[:] = q, f, m
        assert step(plain_s, k * H, H) == compiled_step(compiled_s, k * H, H) == 0
        assert plain_data.tobytes() == compiled_data.tobytes(), f"step {k}"


class TestErrors:
    """A status other than 0 comes with what, value, expected and remedy."""

    @staticmethod
    def text(status: int, s: Record, t: float = 0.0) -> str:
        return MODEL.message(status, s, t)

    @pytest.mark.parametrize(
        ("values", "text"),
        [
            ({"stiffness": 0.0}, "stiffness in row 1 is 0.0 N.m/rad, expected a positive number; set stiffness"),
            ({"sensor_stiffness_scale": -1.0}, "stiffness in row 9 is -3300000.0"),
            ({"stiffness_error": [0, 0, -1.0, 0, 0, 0]}, "effects of axis 3 make the drive stiffness 0.0 times the table"),
            ({"stiffness_asymmetry": [0, 1.5, 0, 0, 0, 0]}, "effects of axis 2 make the drive stiffness -0.5 times the table"),
            ({"quat_FT": [2.0, 0, 0, 0]}, "the length of quat_FT is 2.0, expected 1"),
            ({"mode_damping": 1.0}, "mode_damping is 1.0 and mode_frequency 9.0 Hz"),
            ({"mode_direction": 0.0}, "a direction that is not zero"),
            ({"hysteresis_torque": 0.0}, "must all be positive"),
            ({"counterbalance_lever": 0.9}, "the counterbalance cannot move: lever 0.9 m, frame 0.8 m"),
            ({"friction_stiffness": 0.0}, "friction_stiffness 0.0 and"),
            ({"thermal_time_constant": -5.0}, "thermal_time_constant -5.0 s must all be positive"),
        ],
    )
    def test_bad_parameters_are_refused_by_init(self, values: dict[str, Any], text: str) -> None:
        s = instance(**values)
        status = init(s)
        assert status > 0
        assert text in self.text(status, s)

    @pytest.mark.parametrize(
        ("name", "value", "text"),
        [
            (
                "q_link",
                np.nan,
                "input 1 of (1: q_link, 2: f_T_B, 3: m_T_B, 4: f_turn_T_B, 5: m_turn_T_B) at t = 1.5 s is nan, expected a finite number",
            ),
            ("f_T_B", np.inf, "input 2 of (1: q_link, 2: f_T_B, 3: m_T_B, 4: f_turn_T_B, 5: m_turn_T_B) at t = 1.5 s is inf"),
            ("m_T_B", -1e9, "input 3 of (1: q_link, 2: f_T_B, 3: m_T_B, 4: f_turn_T_B, 5: m_turn_T_B) at t = 1.5 s is -1000000000.0"),
        ],
    )
    def test_inputs_that_are_no_numbers(self, name: str, value: float, text: str) -> None:
        s = started()
        getattr(s, name)[1] = value
        assert text in self.text(step(s, 1.5, H), s, 1.5)

    def test_a_load_that_the_model_does_not_hold_for(self) -> None:
        s = started(f_T_B=[0.0, 100.0, 0.0])
        s.f_T_B[1] = 5e4
        message = self.text(step(s, 2.0, H), s, 2.0)
        assert "the virtual joint in frame 10 turns elastically by" in message
        assert "at t = 2.0 s, the model holds up to 0.05 rad; the load on the tool is f_T_B = [    0. 50000.     0.] N" in message
        assert "whether the loop of force and deflection is stable" in message

    @pytest.mark.parametrize("h", [0.0, -0.004, np.nan])
    def test_a_step_that_is_none(self, h: float) -> None:
        s = started()
        assert f"the step size is {h} s, expected a positive one" in self.text(step(s, 0.0, h), s)

    def test_every_message_is_reached(self) -> None:
        assert len(ERRORS) == 12, (
            "nine above, that of the folding robot in test_geometric_stiffness.py, that of translations in test_kr500.py"
        )
