"""joint_6dof, the KR 500 of paper 001: springs along the axes of the joints beside those about them, and its calibrated set."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from robomill.models.components.robot_compliance import MODEL
from robomill.models.model.declaration import Model, Record, record
from robomill.models.robot.kinematics import Tool, inverse, load_robot, load_tool, robot_variables
from robomill.models.robot.virtual_joints import (
    DRIVES,
    JOINTS,
    Compliance,
    compliance_matrix,
    compliance_variables,
    displacement,
    joint_frame,
    load_compliance,
    virtual_joints,
)
from tests.models.robot.test_robots import oracle
from tests.tolerances import EXACT, ROUNDOFF, discretisation, physics

KR500 = "kr500_r2830"
TOOL = load_tool("spindle_holder_55")
DOWN = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Orientation of the tool (columns x, y, z of T in B) with the spindle, its x axis, pointing down."""
TCP = np.array([2.3, 0.0, 0.6])
CENTRE = np.deg2rad([0.0, -29.1, 98.8, 0.0, -104.7, 0.0])
"""Axis angles with the TCP there, FACTS10 10.6."""
UM = 1e6
SEEDS = range(10)
HOLDER = 10
"""Row of the holder: frame 13."""


def unused(*_: object) -> int:
    return 0


def arm(tool: Tool = TOOL, compliance: Compliance | None = None) -> Record:
    """Geometry and springs of the KR 500."""
    variables = (*robot_variables(load_robot(KR500), tool), *compliance_variables(compliance or load_compliance(KR500), tool))
    return record(Model("arm", "elastic arm", variables, unused, unused).new())


def matrix(s: Record, q: np.ndarray) -> np.ndarray:
    C = np.zeros((6, 6))
    compliance_matrix(s, q, C)
    return C


def respond(s: Record, q: np.ndarray, load: np.ndarray) -> np.ndarray:
    result = np.zeros(6)
    displacement(s, q, load[:3].copy(), load[3:].copy(), result[:3], result[3:])
    return result


def angles(seed: int) -> np.ndarray:
    robot = load_robot(KR500)
    return np.random.default_rng(seed).uniform(robot.q_min, robot.q_max)


def loads(seed: int, size: float = 400.0) -> np.ndarray:
    return np.random.default_rng(100 + seed).uniform(-size, size, 6) * np.r_[np.ones(3), 0.1 * np.ones(3)]


def soft(tilt: float = 1.0) -> Compliance:
    """The calibrated set with translations that differ in every joint and direction, so that no mix-up goes unseen."""
    base = load_compliance(KR500)
    along = np.zeros((JOINTS, 3))
    for n, j in enumerate(DRIVES):
        along[j] = 1e-8 * (1.0 + np.array([0.0, 0.3, 0.7]) + n)
    about = base.stiffness.copy()
    for j in DRIVES:
        about[j, 0] *= tilt
    along[HOLDER] = base.translation_compliance[HOLDER]
    return Compliance(about, 1.0, 0.5, 0.5, 0.028, 0.15, 0.0, along)


def with_pinocchio(q: np.ndarray, load: np.ndarray, springs: Compliance) -> np.ndarray:
    """Sum over the joints of J_i K_i^-1 J_i^T load with J_i (6, 6) of a free joint at axis i, placed and turned by Pinocchio."""
    model, data = oracle(KR500)
    pin.framesForwardKinematics(model, data, q)
    flange = data.oMf[1]
    tip = flange.act(FLANGE @ TOOL.p_FT_F)
    total = np.zeros(6)
    wrist = data.oMi[5].translation
    for i, j in enumerate(DRIVES):
        oMi = data.oMi[i + 1]
        # z of the spring along the axis; x and y as the DH table has them, seen in the drawing at zero angles
        R = oMi.rotation @ AXES[i]
        place = (oMi.translation + 1.045 * Z, oMi.translation, oMi.translation, wrist, wrist, wrist)[i]
        J = np.zeros((6, 6))  # columns: along x, y, z, then about x, y, z
        J[:3, :3] = R
        J[:3, 3:] = np.cross(R.T, tip - place).T
        J[3:, 3:] = R
        softness = np.r_[springs.translation_compliance[j], 1.0 / springs.stiffness[j]]
        total += J @ (softness * (J.T @ load))
    tool = flange.rotation @ FLANGE @ pin.rpy.rpyToMatrix(0.0, np.deg2rad(35.0), 0.0)
    total[:3] += tool @ (springs.translation_compliance[HOLDER] * (tool.T @ load[:3]))
    return total


X, Y, Z = np.eye(3)
FLANGE = np.column_stack([-Z, Y, X])
"""Axes of F in the frame of the flange of the chain, arm stretched forward."""
AXES = [
    np.column_stack([X, Y, Z]),
    np.column_stack([X, -Z, Y]),
    np.column_stack([Z, X, Y]),
    np.column_stack([Z, -Y, X]),
    np.column_stack([Z, X, Y]),
    np.column_stack([-Z, Y, X]),
]
"""x, y, z of the DH frames with all axis angles zero, up to the signs of x, y and z, which springs do not feel: drawn, not calculated."""


class TestSixDegreesOfFreedom:
    @pytest.mark.parametrize("seed", SEEDS)
    def test_sum_over_jacobians_of_pinocchio(self, seed: int) -> None:
        springs = soft(tilt=1.7)
        q, load = angles(seed), loads(seed)
        expected = with_pinocchio(q, load, springs)
        got = matrix(arm(compliance=springs), q) @ load
        # geometry in metres to 1e-11 at deflections of 1e-3: as tests/models/robot/test_robots.py
        assert np.abs(got - expected).max() < 100 * ROUNDOFF

    @pytest.mark.parametrize("seed", SEEDS)
    def test_rigid_translations_leave_the_virtual_joints(self, seed: int) -> None:

        base = load_compliance(KR500)
        rigid = Compliance(base.stiffness, 1.0, 0.5, 0.5, 0.028, 0.15, 0.0)
        q, load = angles(seed), loads(seed)
        got = respond(arm(compliance=rigid), q, load)
        s = arm(compliance=rigid)
        s.joint_shift[...] = 1.0  # what an earlier load left behind
        assert np.abs(respond(s, q, load) - got).max() == EXACT
        s.translation_compliance[...] = 1e-30
        assert np.abs(respond(s, q, load) - got).max() < ROUNDOFF * np.abs(got).max()

    @pytest.mark.parametrize("seed", SEEDS)
    def test_full_chain_and_matrix_agree(self, seed: int) -> None:
        s, q, h = arm(compliance=soft()), angles(seed), 50.0
        C = matrix(s, q)
        assert np.abs(C - C.T).max() <= ROUNDOFF * np.abs(C).max()
        for i in range(6):
            w = h * np.eye(6)[i]
            column = (respond(s, q, w) - respond(s, q, -w)) / (2 * h)
            assert np.abs(column - C[:, i]).max() < discretisation((2e-5) ** 3, h, 2) + 1e3 * ROUNDOFF * np.abs(C).max()

    def test_translations_of_one_size_are_a_spring_in_series(self) -> None:
        """One compliance along x, y, z of n joints adds n times it to every direction, whatever the pose: joints stand in series."""
        base = load_compliance(KR500)
        for c in (1e-9, 2e-9):
            along = np.zeros((JOINTS, 3))
            along[list(DRIVES)] = c
            for seed in SEEDS:
                q = angles(seed)
                without = matrix(arm(compliance=Compliance(base.stiffness, 1.0, 0.5, 0.5, 0.028, 0.15, 0.0)), q)
                with_them = matrix(arm(compliance=Compliance(base.stiffness, 1.0, 0.5, 0.5, 0.028, 0.15, 0.0, along)), q)
                added = with_them - without
                assert np.abs(added[:3, :3] - 6 * c * np.eye(3)).max() < ROUNDOFF
                assert np.abs(added[3:]).max() == EXACT

    def test_a_sum_of_stiffnesses_would_be_too_stiff(self) -> None:
        """Eqs. (4) and (5) of paper 001 as printed, sum of J_i^-T K_i J_i^-1, against compliances in series: 4 to 20 times."""
        s = arm(compliance=soft())
        virtual_joints(s, CENTRE)
        stiffness = np.zeros((6, 6))
        for j in DRIVES:
            R, r = s.frame_R[joint_frame(j)], s.frame_p[13] - s.frame_p[joint_frame(j)]
            J = np.block([[R, np.cross(R.T, r).T], [np.zeros((3, 3)), R]])
            stiffness += np.linalg.inv(J @ np.diag(np.r_[s.translation_compliance[j], 1.0 / s.stiffness[j]]) @ J.T)
        printed = np.diag(np.linalg.inv(stiffness))[:3]
        assert np.all(np.diag(matrix(s, CENTRE))[:3] > 4.0 * printed)

    def test_a_table_of_another_shape_is_refused(self) -> None:
        with pytest.raises(ValueError, match=r"translation_compliance has shape \(6, 3\), expected \(11, 3\).*along x, y, z"):
            Compliance(load_compliance(KR500).stiffness, 1.0, 0.5, 0.5, 0.028, 0.15, 0.0, np.zeros((6, 3)))

    def test_negative_compliance_is_refused(self) -> None:
        s = record(MODEL.new())
        s.translation_compliance[3, 1] = -1e-9
        status = MODEL.init(s)
        assert (
            MODEL.message(status, s, 0.0)
            == "robot_compliance: translation_compliance in row 4 is -1e-09 m/N, expected zero or a positive number; 0 = rigid"
        )


class TestCalibratedSet:
    """Figures of paper 001 that the set was calibrated to, so a check of the file and of the model, no prediction."""

    def test_pose(self) -> None:
        q = np.zeros(6)
        assert inverse(arm(), TCP, DOWN, CENTRE, q) == 0
        assert np.abs(np.rad2deg(q - CENTRE)).max() < physics(0.0, absolute=0.05)  # angles are given to 0.1 deg

    @pytest.mark.paper
    def test_compliance_at_the_tcp(self) -> None:
        """Paper 001, sec. 4: 0.5 radial, 1.8 tangential, 1.1 axial um/N, two digits. FACTS10 10.6: 0.500, 1.802, 1.101 without
        translations in the joints, which add 0.006.
        """
        C = matrix(arm(), CENTRE)[:3, :3] * UM
        assert np.abs(np.diag(C) - [0.5, 1.8, 1.1]).max() < physics(0.0, absolute=0.05)
        assert np.abs(np.diag(C) - [0.506, 1.808, 1.107]).max() < physics(0.0, absolute=1e-3)

    @pytest.mark.parametrize(("stiffness", "added"), [(1e9, 0.006), (5e8, 0.012)])
    def test_translations_cannot_be_seen(self, stiffness: float, added: float) -> None:
        """FACTS10 10.6: 1e9 N/m in every joint and direction adds 0.006 um/N, 5e8 N/m 0.012 to 0.014."""
        base = load_compliance(KR500)
        along = base.translation_compliance.copy()
        along[list(DRIVES)] = 0.0
        without = matrix(arm(compliance=Compliance(base.stiffness, 1.0, 0.5, 0.5, 0.028, 0.15, 0.0, along)), CENTRE)
        with_them = along.copy()
        with_them[list(DRIVES)] = 1.0 / stiffness
        got = matrix(arm(compliance=Compliance(base.stiffness, 1.0, 0.5, 0.5, 0.028, 0.15, 0.0, with_them)), CENTRE)
        assert np.abs(np.diag(got - without)[:3] * UM - added).max() < physics(0.0, absolute=5e-4)

    @pytest.mark.paper
    def test_holder_in_its_own_axes(self) -> None:
        """Paper 001, Table 1, with strain gauges: 0.137, 0.168, 0.048 um/N in x, y, z: radial, tangential, axial if it is vertical."""
        base = load_compliance(KR500)
        only = np.zeros((JOINTS, 3))
        only[HOLDER] = base.translation_compliance[HOLDER]
        C = matrix(arm(compliance=Compliance(np.full((JOINTS, 3), 1e30), 1.0, 0.5, 0.5, 0.028, 0.15, 0.0, only)), CENTRE)[:3, :3] * UM
        # the pose is given to 0.1 deg
        assert np.abs(C - np.diag([0.137, 0.168, 0.048])).max() < physics(0.0, absolute=2e-4)
