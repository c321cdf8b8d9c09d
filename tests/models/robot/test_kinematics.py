"""Kinematics of the KR 300 R2500 ultra: published poses, two independent chains, finite differences, all inverse branches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numba import njit
from scipy.spatial.transform import Rotation

from robomill.models.model.declaration import Model, Record, record
from robomill.models.model.kernels import COMPILER_OPTIONS
from robomill.models.model.parameters import load
from robomill.models.robot.kinematics import (
    KR300,
    ROBOT_VARIABLES,
    SPINDLE_ACROSS,
    Robot,
    Tool,
    inverse,
    jacobian,
    robot_variables,
    tool_pose,
)
from tests.tolerances import EXACT, ROUNDOFF, discretisation, physics

SEEDS = range(100)
DEG = np.pi / 180.0


def no_init(s: Record) -> int:
    return 0


def no_step(s: Record, t: float, h: float) -> int:
    return 0


KINEMATICS = Model("kinematics", "Robot geometry only", ROBOT_VARIABLES, no_init, no_step)


def robot(flange: bool = False) -> Record:
    """A record of the KR 300 with the default tool, or with T in the flange."""
    s = record(KINEMATICS.new())
    if flange:
        s.p_FT_F[:] = 0.0
        s.quat_FT[:] = [1.0, 0.0, 0.0, 0.0]
    return s


def tilted_tool() -> Record:
    """A record whose tool has every component of position and orientation."""
    s = robot()
    s.p_FT_F[:] = [0.1, -0.07, 0.31]
    s.quat_FT[:] = np.roll(Rotation.from_euler("ZYX", [0.5, -0.4, 0.9]).as_quat(), 1)
    return s


def pose(s: Record, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p, R = np.zeros(3), np.zeros((3, 3))
    tool_pose(s, np.asarray(q, dtype=float), p, R)
    return p, R


def joint_angles(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(KR300.q_min, KR300.q_max)


def urdf_chain(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flange pose from the CAD-based URDF of the robot (raccoon-ncku/kuka_kr300_support): origins and axes, no DH table."""
    p, R = np.zeros(3), np.eye(3)
    chain = (
        ((0.0, 0.0, 0.675), (0.0, 0.0, -1.0)),
        ((0.35, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((1.15, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((1.0, 0.0, -0.041), (-1.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0)),
    )
    for angle, (origin, axis) in zip(q, chain, strict=True):
        p = p + R @ np.array(origin)
        R = R @ Rotation.from_rotvec(angle * np.array(axis)).as_matrix()
    return p + R @ np.array([0.24, 0.0, 0.0]), R @ Rotation.from_euler("y", 90, degrees=True).as_matrix()


class TestForward:
    """Poses of the flange and the tool tip."""

    @pytest.mark.parametrize(
        ("q", "position", "z_axis"),
        [
            ((0, 0, 0, 0, 0, 0), (2740, 0, 634), (1, 0, 0)),
            ((0, -90, 90, 0, 0, 0), (1590, 0, 1784), (1, 0, 0)),
            ((0, -90, 90, 0, 90, 0), (1350, 0, 1544), (0, 0, -1)),
            ((0, -90, 0, 0, 0, 0), (391, 0, 3065), (0, 0, 1)),
        ],
    )
    def test_poses_that_add_up_by_hand(self, q: tuple[float, ...], position: tuple[float, ...], z_axis: tuple[float, ...]) -> None:
        """Sums of link lengths, e.g. stretched: 350 + 1150 + 1000 + 240 = 2740 mm out, 675 - 41 = 634 mm up."""
        p, R = pose(robot(flange=True), np.array(q) * DEG)
        assert np.abs(p * 1e3 - position).max() < 1e4 * ROUNDOFF
        assert np.abs(R[:, 2] - z_axis).max() < ROUNDOFF

    def test_published_pose_with_every_axis_at_ten_degrees(self) -> None:
        """Public test vector for a KR300R2500 (Cognibotics, C test of its inverse kinematics), printed to 9 digits."""
        p, R = pose(robot(flange=True), np.full(6, 10.0 * DEG))
        assert np.abs(p * 1e3 - [2575.2578, -461.435958, -24.647983]).max() < physics(0.0, absolute=1e-5)
        expected = [
            [-0.528743883, 0.0210251906, 0.848520976],
            [-0.251426437, 0.950946755, -0.180236001],
            [-0.810687765, -0.308639289, -0.497520991],
        ]
        assert np.abs(R - expected).max() < physics(0.0, absolute=1e-8)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_agrees_with_the_chain_of_the_urdf(self, seed: int) -> None:
        q = joint_angles(seed)
        p, R = pose(robot(flange=True), q)
        expected_p, expected_R = urdf_chain(q)
        assert np.abs(p - expected_p).max() < 10 * ROUNDOFF
        assert np.abs(R - expected_R).max() < 10 * ROUNDOFF

    def test_the_tool_stands_on_the_flange(self) -> None:
        """T = F displaced and turned by p_FT_F and quat_FT, both in the flange frame."""
        s = tilted_tool()
        for seed in range(20):
            q = joint_angles(seed)
            p_BF, R_BF = urdf_chain(q)
            p, R = pose(s, q)
            assert np.abs(p - (p_BF + R_BF @ s.p_FT_F)).max() < 10 * ROUNDOFF
            assert np.abs(R - R_BF @ Rotation.from_euler("ZYX", [0.5, -0.4, 0.9]).as_matrix()).max() < 10 * ROUNDOFF

    def test_reach_of_the_wrist_names_the_robot(self) -> None:
        """1150 mm + hypot(1000, 41) mm = 2150.8 mm from axis 2, with the 350 mm to axis 1: the 2500 of R2500."""
        s = robot()
        stretched = [0.0, 0.0, float(np.arctan2(-0.041, 1.0)), 0.0, 0.0, 0.0]
        tool_pose(s, np.array(stretched), np.zeros(3), np.zeros((3, 3)))
        assert abs(np.linalg.norm(s.link_p[3] - s.link_p[1]) * 1e3 - 2150.8) < physics(0.0, absolute=0.05)


class TestJacobian:
    """Velocities of the tool tip."""

    @pytest.mark.parametrize("seed", SEEDS)
    def test_equals_central_differences(self, seed: int) -> None:
        """Error of the central difference: h^2/6 of the third derivative, itself at most the reach of 3 m."""
        s, q, J, h = tilted_tool(), joint_angles(seed), np.zeros((6, 6)), 1e-4
        jacobian(s, q, J)
        for i in range(6):
            dq = np.zeros(6)
            dq[i] = h
            (p1, R1), (p0, R0) = pose(s, q + dq), pose(s, q - dq)
            omega = Rotation.from_matrix(R1 @ R0.T).as_rotvec()
            difference = np.r_[p1 - p0, omega] / (2 * h)
            assert np.abs(J[:, i] - difference).max() < discretisation(0.5, h, 2), i

    @pytest.mark.parametrize("seed", SEEDS)
    def test_agrees_with_pinocchio(self, seed: int) -> None:
        """Pinocchio on a model built from the URDF's origins and axes: another library, another parametrisation."""
        model = pin.Model()
        parent = 0
        origins = ((0, 0, 0.675), (0.35, 0, 0), (1.15, 0, 0), (1.0, 0, -0.041), (0, 0, 0), (0, 0, 0))
        axes = ((0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0))
        for i, (origin, axis) in enumerate(zip(origins, axes, strict=True)):
            placement = pin.SE3(np.eye(3), np.array(origin, dtype=float))
            parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(np.array(axis, dtype=float)), placement, f"A{i + 1}")
        flange = pin.SE3(Rotation.from_euler("y", 90, degrees=True).as_matrix(), np.array([0.24, 0.0, 0.0]))
        tool = pin.SE3(np.eye(3), np.array([0.237, 0.0, 0.25]))
        frame = model.addFrame(pin.Frame("T", parent, 0, flange * tool, pin.FrameType.OP_FRAME))
        data, q = model.createData(), joint_angles(seed)
        pin.framesForwardKinematics(model, data, q)
        expected = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        s, J = robot(), np.zeros((6, 6))
        jacobian(s, q, J)
        assert np.abs(J - expected).max() < 10 * ROUNDOFF
        assert np.abs(s.link_p[6] - data.oMf[frame].translation).max() < 10 * ROUNDOFF
        assert np.abs(s.link_R[6] - data.oMf[frame].rotation).max() < 10 * ROUNDOFF


def all_solutions(s: Record, p: np.ndarray, R: np.ndarray) -> list[np.ndarray]:
    """Solutions in (-180, 180] deg met from 300 random starting points, limits opened: a search, not the branches' formulas."""
    rng = np.random.default_rng(5)
    found: list[np.ndarray] = []
    for _ in range(300):
        q = np.zeros(6)
        assert inverse(s, p, R, rng.uniform(-np.pi, np.pi, 6), q) == 0
        wrapped = (q + np.pi) % (2 * np.pi) - np.pi
        if all(np.abs((wrapped - other + np.pi) % (2 * np.pi) - np.pi).max() > 1e-6 for other in found):
            found.append(wrapped)
    return found


class TestInverse:
    """Axis angles for a pose."""

    @pytest.mark.parametrize("seed", SEEDS)
    def test_leads_back_to_the_pose(self, seed: int) -> None:
        s, q_near, q = tilted_tool(), joint_angles(seed), np.zeros(6)
        p, R = pose(s, q_near)
        assert inverse(s, p, R, q_near, q) == 0
        again_p, again_R = pose(s, q)
        assert np.abs(again_p - p).max() < 100 * ROUNDOFF
        assert np.abs(again_R - R).max() < 100 * ROUNDOFF

    @pytest.mark.parametrize("seed", SEEDS)
    def test_finds_the_angles_it_started_from(self, seed: int) -> None:
        """Roundoff grows as 1/sin A5 and 1/sin(elbow) near the singular poses, which the seeds avoid by 0.05 rad."""
        s, q = tilted_tool(), np.zeros(6)
        q_near = joint_angles(seed)
        if abs(np.sin(q_near[4])) < 0.05 or abs(q_near[2] - np.arctan2(-0.041, 1.0)) < 0.05:
            q_near[4], q_near[2] = 0.6, 1.0
        p, R = pose(s, q_near)
        assert inverse(s, p, R, q_near, q) == 0
        assert np.abs(q - q_near).max() < 1e3 * ROUNDOFF

    def test_knows_eight_branches_and_returns_the_nearest(self) -> None:
        """Shoulder x elbow x wrist, with the limits opened; the poses of all eight must be the wanted one."""
        s = robot()
        s.q_min[:], s.q_max[:] = -2 * np.pi, 2 * np.pi
        p, R = pose(s, np.array([20.0, -120.0, 110.0, 30.0, 40.0, 50.0]) * DEG)
        solutions = all_solutions(s, p, R)
        assert len(solutions) == 8
        for solution in solutions:
            q = np.zeros(6)
            assert np.abs(pose(s, solution)[0] - p).max() < 100 * ROUNDOFF
            assert inverse(s, p, R, solution, q) == 0
            assert np.abs(q - solution).max() < 1e3 * ROUNDOFF
        rng = np.random.default_rng(6)
        for _ in range(50):
            near, q = rng.uniform(-np.pi, np.pi, 6), np.zeros(6)
            assert inverse(s, p, R, near, q) == 0
            distance = min(np.sum(((one - near + np.pi) % (2 * np.pi) - np.pi) ** 2) for one in solutions)
            assert abs(np.sum((q - near) ** 2) - distance) < 1e3 * ROUNDOFF

    def test_stays_within_the_limits_where_a_branch_does(self) -> None:
        """With the axis limits of the robot only some of the eight are left, and every answer keeps them."""
        s, rng, count = robot(), np.random.default_rng(7), 0
        p, R = pose(s, np.array([20.0, -70.0, 80.0, 30.0, 40.0, 50.0]) * DEG)
        for _ in range(50):
            q = np.zeros(6)
            assert inverse(s, p, R, rng.uniform(-np.pi, np.pi, 6), q) == 0
            assert np.all((q >= KR300.q_min) & (q <= KR300.q_max))
            count += 1
        assert count == 50

    @pytest.mark.parametrize("a4", [300.0, -60.0])
    def test_keeps_the_turn_of_axes_with_more_than_one(self, a4: float) -> None:
        """A4 = 300 and -60 deg are the same pose; axes 4 and 6 reach +-350 deg."""
        s, q_near, q = robot(), np.array([10.0, -80.0, 90.0, a4, 40.0, -310.0]) * DEG, np.zeros(6)
        p, R = pose(s, q_near)
        assert inverse(s, p, R, q_near, q) == 0
        assert np.abs(q - q_near).max() < 1e3 * ROUNDOFF

    def test_takes_another_turn_rather_than_leave_the_limits(self) -> None:
        s, q = robot(), np.zeros(6)
        inside = np.array([10.0, -80.0, 90.0, -20.0, 40.0, 20.0]) * DEG
        near = inside.copy()
        near[3] = 345.0 * DEG  # the nearest turn of -20 deg is 340 deg, which is allowed
        near[5] = 375.0 * DEG  # the nearest turn of 20 deg is 380 deg, beyond 350 deg
        s.q_min[4] = 0.0  # leaves one wrist branch
        p, R = pose(s, inside)
        assert inverse(s, p, R, near, q) == 0
        assert np.abs(q / DEG - [10.0, -80.0, 90.0, 340.0, 40.0, 20.0]).max() < 1e4 * ROUNDOFF

    def test_singular_wrist_keeps_axis_four(self) -> None:
        """At A5 = 0 only A4 + A6 is determined."""
        s, q = robot(), np.zeros(6)
        p, R = pose(s, np.array([0.0, -90.0, 90.0, 10.0, 0.0, 20.0]) * DEG)
        near = np.array([0.0, -90.0, 90.0, 70.0, 0.0, 0.0]) * DEG
        assert inverse(s, p, R, near, q) == 0
        assert np.abs(q / DEG - [0.0, -90.0, 90.0, 70.0, 0.0, -40.0]).max() < 1e5 * ROUNDOFF

    def test_singular_wrist_folded_back(self) -> None:
        """At A5 = 180 deg, A4 - A6 is determined; out of the robot's limits, so they are opened."""
        s, q = robot(), np.zeros(6)
        s.q_min[:], s.q_max[:] = -2 * np.pi, 2 * np.pi
        wanted = np.array([0.0, -90.0, 90.0, 10.0, 180.0, 20.0]) * DEG
        p, R = pose(s, wanted)
        assert inverse(s, p, R, wanted, q) == 0
        again_p, again_R = pose(s, q)
        assert np.abs(again_p - p).max() < 1e3 * ROUNDOFF
        assert np.abs(again_R - R).max() < 1e3 * ROUNDOFF
        assert abs(q[3] - wanted[3]) < ROUNDOFF

    def test_wrist_above_axis_one_keeps_axis_one(self) -> None:
        """With the wrist centre on axis 1 any A1 will do: that of q_near is kept."""
        s, q = robot(flange=True), np.zeros(6)
        R = np.eye(3)
        p = np.array([0.0, 0.0, 2.6 + 0.24])
        near = np.array([33.0, -120.0, 60.0, 0.0, 30.0, 0.0]) * DEG
        assert inverse(s, p, R, near, q) == 0
        assert abs(q[0] - near[0]) < ROUNDOFF
        assert np.abs(pose(s, q)[0] - p).max() < 100 * ROUNDOFF

    def test_a_point_out_of_reach(self) -> None:
        q = np.full(6, 7.0)
        assert inverse(robot(), np.array([4.0, 0.0, 1.0]), np.eye(3), np.zeros(6), q) == 1
        assert q.tolist() == [7.0] * 6, "q is left alone"

    def test_a_point_that_the_limits_exclude(self) -> None:
        s, q = robot(), np.full(6, 7.0)
        p, R = pose(s, np.array([0.0, -90.0, 90.0, 0.0, 30.0, 0.0]) * DEG)
        s.q_min[0], s.q_max[0] = 1.0, 1.1
        assert inverse(s, p, R, np.zeros(6), q) == 2
        assert q.tolist() == [7.0] * 6, "q is left alone"

    @pytest.mark.parametrize("seed", range(50))
    def test_stretched_arm_is_reachable(self, seed: int) -> None:
        """Both elbow branches meet where the arm is straight; roundoff must not call it out of reach."""
        s, q, straight = robot(), np.zeros(6), joint_angles(seed)
        straight[2] = np.arctan2(-0.041, 1.0)
        p, R = pose(s, straight)
        assert inverse(s, p, R, straight, q) == 0
        # the elbow angle is resolved to sqrt(eps) there, the position to eps
        assert np.abs(pose(s, q)[0] - p).max() < 1e3 * ROUNDOFF


def test_compiled_gives_the_same_bits_as_plain_python() -> None:
    def everything(s: Record, q: np.ndarray, near: np.ndarray, p: np.ndarray, R: np.ndarray, J: np.ndarray, back: np.ndarray) -> int:
        tool_pose(s, q, p, R)
        jacobian(s, q, J)
        status: int = inverse(s, p, R, near, back)
        return status

    compiled = njit(**COMPILER_OPTIONS)(everything)
    plain_s, compiled_s = tilted_tool(), tilted_tool()
    for seed in SEEDS:
        q = joint_angles(seed)
        near = q + np.random.default_rng(seed).normal(0.0, 0.3, 6)
        plain, fast = ([np.zeros(3), np.zeros((3, 3)), np.zeros((6, 6)), np.zeros(6)] for _ in range(2))
        assert everything(plain_s, q, near, *plain) == compiled(compiled_s, q, near, *fast)
        for a, b in zip(plain, fast, strict=True):
            assert np.abs(a - b).max() == EXACT, seed


class TestData:
    """The parameter files and what they refuse."""

    def test_starts_are_those_of_the_file(self) -> None:
        s = robot()
        assert np.abs(np.rad2deg(s.q_max) - [185, -5, 155, 350, 122.5, 350]).max() < 1e3 * ROUNDOFF
        assert np.abs(np.rad2deg(KR300.speed_max) - [105, 101, 107, 140, 113, 180]).max() < 1e3 * ROUNDOFF
        assert np.abs(s.p_FT_F - [0.237, 0.0, 0.25]).max() < ROUNDOFF
        assert s.quat_FT.tolist() == [1.0, 0.0, 0.0, 0.0]
        assert load(Tool, "tools/spindle_across").mass == SPINDLE_ACROSS.mass == 60.0

    def test_another_robot_brings_its_own_starts(self) -> None:
        longer = replace(KR300, name="KR 270 R2700 ultra", dh_d=np.array([0.675, 0.0, 0.0, 1.2, 0.0, 0.24]))
        s = record(Model("longer", "d4 = 1200 mm", robot_variables(longer, SPINDLE_ACROSS), no_init, no_step).new())
        s.p_FT_F[:] = 0.0
        assert abs(pose(s, np.zeros(6))[0][0] - 2.94) < ROUNDOFF

    def test_a_geometry_that_the_closed_form_cannot_solve_says_why(self) -> None:
        assert KR300.no_closed_form == ""
        assert replace(KR300, dh_alpha=np.zeros(6)).no_closed_form.startswith("dh_alpha is (0, 0, 0, 0, 0, 0) deg, the closed form is for")
        shifted = replace(KR300, dh_d=np.array([0.7, 0.1, 0, 1, 0, 0.2]))
        assert shifted.no_closed_form.startswith("a1, a5, a6, d2, d3, d5 are (0, 0, 0, 100, 0, 0) mm")

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            ({"dh_a": np.zeros(5)}, r"dh_a has shape \(5,\), expected \(6,\)"),
            ({"axis_coupling": np.eye(6)}, r"axis_coupling is .* expected six rows of six with zeros on and above the diagonal"),
            ({"axis_sign": np.array([1, 1, 0.5, 1, 1, 1])}, r"axis_sign is .*0\.5.*, expected \+1 or -1"),
            ({"q_min": KR300.q_max}, r"q_min .* rad is not below q_max"),
        ],
    )
    def test_a_table_that_is_no_robot_is_refused(self, change: dict[str, np.ndarray], text: str) -> None:
        with pytest.raises(ValueError, match=rf"robot 'KUKA KR 300 R2500 ultra': {text}"):
            replace(KR300, **change)

    def test_a_missing_file_lists_what_there_is(self) -> None:
        with pytest.raises(FileNotFoundError, match=r"no parameter file .*kr1.*available: .*robots/kr300_r2500_ultra"):
            load(Robot, "robots/kr1")
