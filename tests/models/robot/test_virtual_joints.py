"""Compliance on virtual joints: Haehn & Weigold 2020 written out literally, published figures, invariants of elasticity."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numba import njit
from scipy.spatial.transform import Rotation

from robomill.models.model.declaration import Model, Record, record
from robomill.models.model.kernels import COMPILER_OPTIONS
from robomill.models.robot.kinematics import KR300, ROBOT_VARIABLES, SPINDLE_ACROSS, jacobian, load_robot, robot_variables
from robomill.models.robot.virtual_joints import (
    COMPLIANCE_VARIABLES,
    DRIVES,
    JOINTS,
    TABLE_1,
    compliance_matrix,
    compliance_variables,
    displacement,
    load_compliance,
    virtual_joints,
)
from tests.tolerances import EXACT, ROUNDOFF, discretisation, physics

SEEDS = range(100)
DEG = np.pi / 180.0
NO_MOMENT = np.zeros(3)
POSITION_1 = np.array([2.66, -77.64, 77.44, 0.0, 0.20, 0.0]) * DEG
NAMES = ("A1", "A2", "linked arm", "A3", "arm", "A4", "A5", "A6", "sensor", "holder", "tool")
RIGID = 1e30


def no_init(s: Record) -> int:
    return 0


def no_step(s: Record, t: float, h: float) -> int:
    return 0


ELASTIC = Model("elastic_robot", "Robot and compliance", ROBOT_VARIABLES + COMPLIANCE_VARIABLES, no_init, no_step)


def robot() -> Record:
    return record(ELASTIC.new())


def tilted_tool() -> Record:
    """A record whose tool has every component of position and orientation, and whose tool spring is soft."""
    s = robot()
    s.p_FT_F[:] = [0.15, -0.07, 0.31]
    s.quat_FT[:] = np.roll(Rotation.from_euler("ZYX", [0.5, -0.4, 0.9]).as_quat(), 1)
    s.stiffness[10] = [2e5, 3e5, 4e5]
    return s


def joint_angles(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(KR300.q_min, KR300.q_max)


def load(seed: int, size: float = 750.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1000 + seed)
    return rng.uniform(-size, size, 3), rng.uniform(-0.1 * size, 0.1 * size, 3)


def respond(s: Record, q: np.ndarray, f: np.ndarray, m: np.ndarray = NO_MOMENT) -> np.ndarray:
    """[d; theta] of the kernel."""
    result = np.zeros(6)
    displacement(s, np.asarray(q, dtype=float), np.asarray(f, dtype=float), np.asarray(m, dtype=float), result[:3], result[3:])
    return result


def matrix(s: Record, q: np.ndarray) -> np.ndarray:
    C = np.zeros((6, 6))
    compliance_matrix(s, q, C)
    return C


# --- the paper, written out with homogeneous matrices ---------------------------------------------------------


def homogeneous(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, p
    return X


def equation_1(alpha: float, a: float, b: float, d: float, theta: float) -> np.ndarray:
    """T = T_R(alpha) T_T(a) T_T(b) T_T(d) T_R(theta): about x, along x, y, z, about z."""
    about_x = homogeneous(Rotation.from_euler("x", alpha).as_matrix(), np.zeros(3))
    about_z = homogeneous(Rotation.from_euler("z", theta).as_matrix(), np.zeros(3))
    return about_x @ homogeneous(np.eye(3), np.array([a, b, d])) @ about_z


def equation_4(alpha: float, beta: float, gamma: float) -> np.ndarray:
    """R* as printed: Euler z-y'-x''."""
    (sa, sb, sg), (ca, cb, cg) = np.sin([alpha, beta, gamma]), np.cos([alpha, beta, gamma])
    return np.array(
        [
            [cb * cg, sa * sb * cg - ca * sg, ca * sb * cg + sa * sg],
            [cb * sg, sa * sb * sg + ca * cg, ca * sb * sg - sa * cg],
            [-sb, sa * cb, ca * cb],
        ]
    )


def fourteen_transforms(s: Record, q: np.ndarray) -> list[np.ndarray]:
    """The 14 transforms of Fig. 1 for the KR 300, in numbers (mm of the data sheet), not through the DH table of the record."""
    A = np.array(q)
    right = np.pi / 2
    R_FT = Rotation.from_quat(np.roll(s.quat_FT, -1)).as_matrix()
    reference = s.p_FT_F - R_FT @ [0.06, 0.0, 0.0] - [0.0, 0.0, 0.1]
    return [
        equation_1(0, 0, 0, 0.675, -A[0]),
        equation_1(-right, 0.35, 0, 0, A[1]),
        equation_1(0, 0.575, 0, 0, 0),
        equation_1(0, 0.575, 0, 0, A[2] - right),
        equation_1(-right, -0.0205, 0, 0.5, 0),
        equation_1(0, -0.0205, 0, 0.5, -A[3]),
        equation_1(right, 0, 0, 0, A[4]),
        equation_1(-right, 0, 0, 0, np.pi - A[5]),
        equation_1(0, 0, 0, 0.24 + 0.028, 0),
        equation_1(0, 0, 0, 0.1 - 0.028, 0),
        equation_1(0, reference[0], reference[1], reference[2], 0),
        homogeneous(R_FT, np.zeros(3)),
        np.eye(4),
        equation_1(0, 0.06, 0, 0, 0),
    ]


def literal_model(s: Record, q: np.ndarray, f_B: np.ndarray, m_B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rigid and displaced pose of the tool tip by Eqs. (2)-(8), one matrix per line."""
    T = fourteen_transforms(s, q)
    tip = np.linalg.multi_dot(T)
    f_T, m_T = tip[:3, :3].T @ f_B, tip[:3, :3].T @ m_B
    stiffness = dict(zip([*range(1, 11), 13], s.stiffness, strict=True))
    displaced = np.eye(4)
    for i in range(1, 15):
        displaced = displaced @ T[i - 1]
        if i in stiffness:
            rest = np.linalg.multi_dot([np.eye(4), np.eye(4), *T[i:]])  # Eq. (2): from frame i to the tip
            R_i, r_i = rest[:3, :3], rest[:3, 3]
            F_i = R_i @ f_T  # Eq. (5)
            M_i = np.cross(r_i, F_i) + R_i @ m_T  # Eq. (6), with a moment at the tip
            displaced = displaced @ homogeneous(equation_4(*(M_i / stiffness[i])), np.zeros(3))  # Eqs. (7), (3)
    return tip, displaced


class TestAgainstThePaper:
    """The kernel against the equations as printed, and against figures worked out from them."""

    @pytest.mark.parametrize("seed", SEEDS)
    def test_equals_the_equations_written_out(self, seed: int) -> None:
        """Loads of up to 7.5 kN, ten times the paper's: elastic angles of some 0.05 rad show the order of the rotations."""
        s, q, (f, m) = tilted_tool(), joint_angles(seed), load(seed, 7500.0)
        rigid, displaced = literal_model(s, q, f, m)
        result = respond(s, q, f, m)
        assert np.abs(result[:3] - (displaced - rigid)[:3, 3]).max() < 10 * ROUNDOFF
        theta = Rotation.from_matrix(displaced[:3, :3] @ rigid[:3, :3].T).as_rotvec()
        assert np.abs(result[3:] - theta).max() < 10 * ROUNDOFF

    @pytest.mark.parametrize("seed", range(20))
    def test_the_fourteen_frames_are_those_of_equation_1(self, seed: int) -> None:
        s, q, X = tilted_tool(), joint_angles(seed), np.eye(4)
        virtual_joints(s, q)
        for i, T in enumerate(fourteen_transforms(s, q)):
            X = X @ T
            assert np.abs(s.frame_R[i] - X[:3, :3]).max() < 10 * ROUNDOFF, f"frame {i + 1}"
            assert np.abs(s.frame_p[i] - X[:3, 3]).max() < 10 * ROUNDOFF, f"frame {i + 1}"

    def test_stiffness_is_table_1(self) -> None:
        """Some cells, in N mm/rad as printed; rows in the order of the frames, so linked arm and arm stand third and fifth."""
        table = robot().stiffness * 1e3
        for row, column, value in (
            (0, 2, 7.5e9),
            (2, 1, 3.8e9),
            (4, 2, 3.0e9),
            (7, 0, 6.7e8),
            (8, 2, 5.2e9),
            (9, 1, 6.7e7),
            (10, 0, 9.9e99),
        ):
            assert abs(table[row, column] - value) <= ROUNDOFF * value, NAMES[row]
        assert all(table[i, 0] == table[i, 1] for i in DRIVES), "k_C = k_B on all six axes"

    @pytest.mark.parametrize(
        ("angles", "displacement_mm"),
        [
            ((2.66, -77.64, 77.44, 0, 0.20, 0), (0.942, 0.082, 0.413)),
            ((-22.59, -118.99, 90.57, 0, 28.42, 0), (1.267, -0.380, 0.315)),
            ((21.92, -104.68, 129.22, 0, -24.54, 0), (1.059, 0.387, 0.723)),
            ((0.65, -96.07, 122.56, 0, -26.49, 0), (0.912, 0.014, 0.773)),
        ],
    )
    def test_deflection_under_750_n_at_the_validation_positions(
        self, angles: tuple[float, ...], displacement_mm: tuple[float, ...]
    ) -> None:
        """First-order sums of an independent calculation with Table 1, printed to 1 um for angles printed to 0.01 deg; load +x.

        Its tool offset was 236.87 mm, which the default tool rounds to 237 mm.
        """
        s = robot()
        s.p_FT_F[0] = 0.23687
        d = matrix(s, np.array(angles) * DEG)[:3, 0] * 750.0
        assert np.abs(d * 1e3 - displacement_mm).max() < physics(0.0, absolute=1e-3)

    def test_shares_of_the_joints_at_position_1(self) -> None:
        """Load 750 N in +y: shares of the y deflection in mm, same calculation; more than half comes from tilting and the holder."""
        printed = {"A1": 0.479, "A2": 0.458, "linked arm": 0.220, "A3": 0.277, "arm": 0.137, "A4": 0.107, "A5": 0.089, "A6": 0.354}
        printed |= {"sensor": 0.019, "holder": 0.551, "tool": 0.0}
        total = 0.0
        for row, name in enumerate(NAMES):
            s = robot()
            s.stiffness[[i for i in range(JOINTS) if i != row]] = RIGID
            share = respond(s, POSITION_1, [0.0, 750.0, 0.0])[1] * 1e3
            assert abs(share - printed[name]) < physics(0.0, absolute=1e-3), name
            total += share
        assert abs(total - 2.69) < physics(0.0, absolute=5e-3)

    def test_first_order_sum_differs_by_less_than_2_um_at_2_mm(self) -> None:
        """Same calculation, at another pose: the full chain of Eqs. (3), (8) against the sum of the joints; 2 um of 2 mm."""
        s, q, f = robot(), np.array([5.0, -50.0, 95.0, 10.0, -40.0, 5.0]) * DEG, np.array([300.0, -200.0, 400.0])
        s.p_FT_F[0] = 0.28
        full, first_order = respond(s, q, f)[:3], matrix(s, q)[:3, :3] @ f
        assert abs(np.linalg.norm(full) * 1e3 - 2.04) < physics(0.0, absolute=0.01)
        assert 0.0 < np.abs(full - first_order).max() < physics(0.0, absolute=2e-6)


class TestInvariants:
    """What any linear elastic structure obeys, to first order."""

    @pytest.mark.parametrize("seed", SEEDS)
    def test_compliance_is_symmetric_and_positive_definite(self, seed: int) -> None:
        C = matrix(tilted_tool(), joint_angles(seed))
        assert np.abs(C - C.T).max() <= ROUNDOFF * np.abs(C).max()
        assert np.linalg.eigvalsh(C).min() > 0.0

    @pytest.mark.parametrize("seed", SEEDS)
    def test_matrix_is_the_derivative_of_the_response(self, seed: int) -> None:
        """Central differences over 50 N and 50 N.m; the remainder is of third order, (C h)^2 C h with C <= 2e-5 rad/(N.m)."""
        s, q, h = tilted_tool(), joint_angles(seed), 50.0
        C = matrix(s, q)
        for i in range(6):
            w = np.zeros(6)
            w[i] = h
            column = (respond(s, q, w[:3], w[3:]) - respond(s, q, -w[:3], -w[3:])) / (2 * h)
            assert np.abs(column - C[:, i]).max() < discretisation((2e-5) ** 3, h, 2) + 1e3 * ROUNDOFF * np.abs(C).max()

    @pytest.mark.parametrize("seed", SEEDS)
    def test_reciprocity_of_maxwell_and_betti(self, seed: int) -> None:
        """Work of load 1 on the displacement by load 2 = work of load 2 on that by load 1, to the second order of the chain."""
        s, q = tilted_tool(), joint_angles(seed)
        one, two = np.concatenate(load(seed, 1.0)), np.concatenate(load(seed + 500, 1.0))
        by_one, by_two = respond(s, q, one[:3], one[3:]), respond(s, q, two[:3], two[3:])
        scale = np.abs(one) @ np.abs(by_two) + np.abs(two) @ np.abs(by_one)
        # relative remainder: the elastic angles, below 1e-5 rad per newton
        assert abs(one @ by_two - two @ by_one) < discretisation(1e-5, 1.0, 1) * scale

    @pytest.mark.parametrize("seed", SEEDS)
    def test_a_load_does_positive_work(self, seed: int) -> None:
        f, m = load(seed)
        result = respond(robot(), joint_angles(seed), f, m)
        assert np.r_[f, m] @ result > 0.0

    def test_no_energy_comes_out_of_a_closed_cycle_of_loads(self) -> None:
        """Work around a triangle of loads of 300 N, midpoint rule: nil against the energy stored at its corners."""
        s = robot()
        corners = [np.zeros(3), np.array([300.0, 0.0, 0.0]), np.array([0.0, 200.0, -250.0]), np.zeros(3)]
        work, stored = 0.0, 0.0
        for start, end in pairwise(corners):
            path = [start + (end - start) * k / 20 for k in range(21)]
            for a, b in pairwise(path):
                work += 0.5 * (a + b) @ (respond(s, POSITION_1, b) - respond(s, POSITION_1, a))[:3]
            stored = max(stored, 0.5 * end @ respond(s, POSITION_1, end)[:3])
        assert abs(work) < discretisation(3e-3, 1.0, 1) * stored  # 3e-3 rad: the largest elastic angle here

    @pytest.mark.parametrize("seed", range(20))
    def test_superposition_holds_to_first_order(self, seed: int) -> None:
        """The remainder is quadratic: half the loads leave a quarter of it."""
        s, q = robot(), joint_angles(seed)
        (f1, m1), (f2, m2) = load(seed), load(seed + 300)

        def remainder(scale: float) -> float:
            both = respond(s, q, scale * (f1 + f2), scale * (m1 + m2))
            apart = respond(s, q, scale * f1, scale * m1) + respond(s, q, scale * f2, scale * m2)
            return float(np.linalg.norm(both - apart))

        order = np.log2(remainder(1.0) / remainder(0.5))
        assert abs(order - 2.0) < physics(0.0, absolute=0.05)

    @pytest.mark.parametrize("seed", range(20))
    def test_no_load_no_displacement(self, seed: int) -> None:
        assert np.abs(respond(robot(), joint_angles(seed), NO_MOMENT)).max() == EXACT

    def test_a_force_along_the_line_to_a_joint_does_not_turn_it(self) -> None:
        """Axis 1 alone elastic, force towards axis 1: no lever, no displacement."""
        s = robot()
        s.stiffness[1:] = RIGID
        s.stiffness[0, :2] = RIGID
        virtual_joints(s, POSITION_1)
        towards = np.array([s.frame_p[13, 0], s.frame_p[13, 1], 0.0])
        assert np.abs(respond(s, POSITION_1, 300.0 * towards)).max() < ROUNDOFF
        across = respond(s, POSITION_1, [0.0, 750.0, 0.0])[1]
        # by hand: F r^2 / k about the vertical axis
        lever = s.frame_p[13, 0]
        assert abs(across - 750.0 * lever**2 / 7.5e6) < physics(across, relative=2e-3)  # rotation is finite: 0.2 mrad

    def test_a_pure_moment_turns_the_tool(self) -> None:
        """All but the holder rigid: theta = M/k_A about the flange axis, and the tip moves by theta x r."""
        s = robot()
        s.stiffness[[i for i in range(JOINTS) if i != 9]] = RIGID
        q = np.array([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]) * DEG
        result = respond(s, q, NO_MOMENT, [30.0, 0.0, 0.0])  # flange z = base x
        theta = 30.0 / 9.1e4
        assert np.abs(result[3:] - [theta, 0.0, 0.0]).max() < 10 * ROUNDOFF
        # T is 237 mm below the axis: sideways by sin, upwards by 1 - cos
        assert np.abs(result[:3] - 0.237 * np.array([0.0, np.sin(theta), 1.0 - np.cos(theta)])).max() < 10 * ROUNDOFF


class TestParameters:
    """What the parameters beyond Table 1 do."""

    def test_sensor_scale_acts_on_the_sensor_row_only(self) -> None:
        scaled, by_hand = robot(), robot()
        scaled.sensor_stiffness_scale = 0.1
        by_hand.stiffness[8] *= 0.1
        f = [300.0, -200.0, 100.0]
        assert np.abs(respond(scaled, POSITION_1, f) - respond(by_hand, POSITION_1, f)).max() < ROUNDOFF
        assert np.linalg.norm(respond(scaled, POSITION_1, f)) > np.linalg.norm(respond(robot(), POSITION_1, f))

    @pytest.mark.parametrize(("name", "frame", "at_0", "at_1"), [("link_arm_position", 2, 1, 3), ("arm_position", 4, 3, 5)])
    def test_link_springs_move_along_their_links(self, name: str, frame: int, at_0: int, at_1: int) -> None:
        s = robot()
        for value, neighbour in ((0.0, at_0), (1.0, at_1)):
            setattr(s, name, value)
            virtual_joints(s, POSITION_1)
            assert np.abs(s.frame_p[frame] - s.frame_p[neighbour]).max() < ROUNDOFF

    def test_place_of_a_rigid_tool_spring_does_not_matter(self) -> None:
        near, far = robot(), robot()
        far.tool_length = 0.5
        f = [300.0, -200.0, 100.0]
        assert np.abs(respond(near, POSITION_1, f) - respond(far, POSITION_1, f)).max() == EXACT

    def test_a_table_of_another_shape_is_refused(self) -> None:
        with pytest.raises(ValueError, match=r"stiffness has shape \(10, 3\), expected \(11, 3\): frames 1\.\.10 and 13"):
            replace(TABLE_1, stiffness=np.ones((10, 3)))


def test_compiled_gives_the_same_bits_as_plain_python() -> None:
    def everything(s: Record, q: np.ndarray, f: np.ndarray, m: np.ndarray, d: np.ndarray, theta: np.ndarray, C: np.ndarray) -> None:
        displacement(s, q, f, m, d, theta)
        compliance_matrix(s, q, C)

    compiled = njit(**COMPILER_OPTIONS)(everything)
    data_plain, data_compiled = ELASTIC.new(), ELASTIC.new()
    for seed in SEEDS:
        q, (f, m) = joint_angles(seed), load(seed)
        plain, fast = ([np.zeros(3), np.zeros(3), np.zeros((6, 6))] for _ in range(2))
        everything(record(data_plain), q, f, m, *plain)
        compiled(record(data_compiled), q, f, m, *fast)
        for a, b in zip(plain, fast, strict=True):
            assert np.abs(a - b).max() == EXACT, seed
        assert data_plain.tobytes() == data_compiled.tobytes(), seed


class TestCoupledAxes:
    """A parallelogram: the drive of axis 2 also turns the forearm, and feels its moment."""

    @staticmethod
    def irb() -> Record:
        robot, compliance = load_robot("irb6400r_25_150"), load_compliance("irb6400r_25_150")
        # paper 003: spindle in line with the flange, 450 mm
        tool = replace(SPINDLE_ACROSS, p_FT_F=np.array([0.0, 0.0, 0.45]))
        variables = (*robot_variables(robot, tool), *compliance_variables(compliance, tool))
        return record(Model("irb", "coupled axes", variables, no_init, no_step).new())

    def test_compliance_is_that_of_the_axis_jacobian(self) -> None:
        """C = J K^-1 J^T with the springs at the axes; tilts and links of that file are rigid (9.9e99 N.mm/rad)."""
        s = self.irb()
        C, J = np.zeros((6, 6)), np.zeros((6, 6))
        stiffness = s.stiffness[list(DRIVES), 2]
        for seed in range(20):
            q = np.random.default_rng(seed).uniform(s.q_min, s.q_max)
            compliance_matrix(s, q, C)
            jacobian(s, q, J)
            expected = J @ np.diag(1.0 / stiffness) @ J.T
            assert np.abs(C - expected).max() < ROUNDOFF * np.abs(expected).max()

    def test_figures_of_the_pose_of_the_aluminium_block(self) -> None:
        """FACTS10 10.1, printed with three digits, as its springs: C_xx, C_yy, C_zz = 3.36, 1.38, 0.75 and C_xz = +1.02 um/N."""
        s, C = self.irb(), np.zeros((6, 6))
        compliance_matrix(s, np.deg2rad([0.0, 2.67, 46.58, 0.0, 43.42, 180.0]), C)
        for (i, j), published in {(0, 0): 3.36, (1, 1): 1.38, (2, 2): 0.75, (0, 2): 1.02}.items():
            assert abs(1e6 * C[i, j] - published) < physics(published, relative=0.003, absolute=0.005)

    def test_displacement_is_the_matrix_times_the_load(self) -> None:
        """To first order: 1 N leaves about 1e-6 rad, squared 1e-12."""
        s, C, d, theta = self.irb(), np.zeros((6, 6)), np.zeros(3), np.zeros(3)
        for seed in range(5):
            rng = np.random.default_rng(seed)
            q, f, m = rng.uniform(s.q_min, s.q_max), rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)
            compliance_matrix(s, q, C)
            displacement(s, q, f, m, d, theta)
            expected = C @ np.r_[f, m]
            assert np.abs(np.r_[d, theta] - expected).max() < 1e1 * ROUNDOFF + np.abs(expected).max() ** 2 * 10
