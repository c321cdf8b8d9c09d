"""joint_1dof, the IRB 6400R of paper 003: six drive springs behind a parallelogram, with and without the geometric term K_g."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import fsolve

from robomill.diagnosis.catalogue import Catalogue
from robomill.models.components.robot_compliance import MODEL
from robomill.models.model.declaration import Model, Record, record
from robomill.models.robot.geometric_stiffness import GEOMETRIC_VARIABLES, cartesian_stiffness, follow_levers, geometric_matrix
from robomill.models.robot.kinematics import inverse, jacobian, load_robot, load_tool, robot_variables
from robomill.models.robot.virtual_joints import DRIVES, compliance_matrix, compliance_variables, load_compliance, virtual_joints
from tests import SCENARIOS
from tests.models.robot.test_robots import joints, oracle
from tests.tolerances import EXACT, ROUNDOFF, discretisation, physics

IRB, KR300 = "irb6400r_25_150", "kr300_r2500_ultra"
TOOL = load_tool("spindle_in_line")
DOWN = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Orientation of the tool (columns x, y, z of T in B) with the spindle, its x axis, pointing down."""
BLOCK = np.deg2rad([0.0, 2.67, 46.58, 0.0, 43.42, 180.0])
"""Axis angles over the aluminium block, FACTS10 10.1."""
PAYLOAD = 150.0 * 9.81
"""Weight [N] for which the paper estimates 3 mm."""
SEEDS = range(10)
DIFFERENCE = 1e-5
"""Turn [rad] of a central difference."""
ROUGH = 1e-16 / DIFFERENCE
"""What roundoff leaves of a central difference of terms of size one; multiplied by their size and number."""


def unused(*_: object) -> int:
    return 0


def arm(name: str = IRB) -> Record:
    """Geometry and springs of a robot with the stiffness of its drives."""
    robot, compliance = load_robot(name), load_compliance(name)
    variables = (*robot_variables(robot, TOOL), *compliance_variables(compliance, TOOL), *GEOMETRIC_VARIABLES)
    s = record(Model("arm", "elastic arm", variables, unused, unused).new())
    s.drive_stiffness[:] = s.stiffness[list(DRIVES), 2]
    return s


def component(**values: Any) -> Record:
    """robot_compliance of the IRB 6400R, with these values set."""
    s = record(MODEL.new())
    variables = (*robot_variables(load_robot(IRB), TOOL), *compliance_variables(load_compliance(IRB), TOOL))
    given = {v.name: v.start for v in variables if v.causality == "parameter"} | values
    for name, value in given.items():
        if np.ndim(getattr(s, name)):
            getattr(s, name)[...] = value
        else:
            setattr(s, name, value)
    return s


def axis_jacobian(s: Record, q: np.ndarray) -> np.ndarray:
    J = np.zeros((6, 6))
    jacobian(s, q, J)
    return J


def compliance(s: Record, q: np.ndarray) -> np.ndarray:
    C = np.zeros((6, 6))
    compliance_matrix(s, q, C)
    return C


def pinocchio_jacobian(name: str, q: np.ndarray) -> np.ndarray:
    """Jacobian of the tool tip by the axis angles, from Pinocchio's chain, which knows no DH table."""
    model, data = oracle(name)
    pin.framesForwardKinematics(model, data, joints(name, q))
    J = pin.computeFrameJacobian(model, data, joints(name, q), 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    flange_axis = data.oMf[1].rotation[:, 0]  # at zero angles the flange of these chains points along x
    J[:3] -= pin.skew(TOOL.p_FT_F[2] * flange_axis) @ J[3:]
    step = np.array([joints(name, e) - joints(name, np.zeros(6)) for e in np.eye(6)]).T
    return np.asarray(J @ step)


@cache
def poses(count: int, straight: bool = False) -> tuple[np.ndarray, ...]:
    """Axis angles over the work space of FACTS10 10.1: x 1.1..2.2, y +-0.8, z 0.3..1.5 m, spindle within 0.5 rad of down, or `straight`."""
    rng, s, home, found = np.random.default_rng(1), arm(), load_robot(IRB).q_home, []
    while len(found) < count:
        turn = pin.rpy.rpyToMatrix(*(np.zeros(3) if straight else rng.uniform(-0.5, 0.5, 3)))
        p, q = rng.uniform([1.1, -0.8, 0.3], [2.2, 0.8, 1.5]), np.zeros(6)
        if inverse(s, p, turn @ DOWN, home, q) == 0 and abs(q[4]) > 0.1:
            found.append(q)
    return tuple(found)


def displaced(s: Record, q: np.ndarray, f: np.ndarray, share: float) -> np.ndarray:
    """First-order displacement [3] of the tool tip with a share of K_g."""
    virtual_joints(s, q)
    s.geometric_stiffness = share
    J = axis_jacobian(s, q)[:3]
    s.drive_angle[:] = (s.axis_sign * (J.T @ f)) / s.drive_stiffness
    assert follow_levers(s, f, np.zeros(3)) == 0
    return np.asarray(J @ (s.axis_sign * s.drive_angle))


class TestGeometricTerm:
    @pytest.mark.parametrize("name", [IRB, KR300])
    @pytest.mark.parametrize("seed", SEEDS)
    def test_is_the_change_of_the_jacobian_under_the_load(self, name: str, seed: int) -> None:
        """[dJ^T/dq_1 W .. dJ^T/dq_6 W] by central differences of Pinocchio's Jacobian, which has the coupling of axis 3."""
        s, rng = arm(name), np.random.default_rng(seed)
        q, W = rng.uniform(s.q_min, s.q_max), rng.uniform(-1.0, 1.0, 6)
        virtual_joints(s, q)
        geometric_matrix(s, W[:3], W[3:])
        expected = np.zeros((6, 6))
        for i, e in enumerate(DIFFERENCE * np.eye(6)):
            expected[:, i] = (pinocchio_jacobian(name, q + e) - pinocchio_jacobian(name, q - e)).T @ W / (2.0 * DIFFERENCE)
        found = s.axis_sign[:, None] * s.drive_matrix * s.axis_sign
        # third derivatives of the chain: levers of up to 3.5 m, times three components of the load, times two for the coupled axis
        assert np.abs(found - expected).max() < discretisation(21.0 / 6.0, DIFFERENCE, 2) + 100.0 * ROUGH

    @pytest.mark.parametrize("seed", SEEDS)
    def test_of_a_force_is_symmetric(self, seed: int) -> None:
        """A constant force has a potential, f . p(q), so its second derivatives commute; a constant moment has none."""
        s, rng = arm(), np.random.default_rng(seed)
        virtual_joints(s, rng.uniform(s.q_min, s.q_max))
        geometric_matrix(s, rng.uniform(-1.0, 1.0, 3), np.zeros(3))
        assert np.abs(s.drive_matrix - s.drive_matrix.T).max() < 10.0 * ROUNDOFF
        geometric_matrix(s, np.zeros(3), rng.uniform(-1.0, 1.0, 3))
        assert np.abs(s.drive_matrix - s.drive_matrix.T).max() > 0.1

    @pytest.mark.parametrize("seed", SEEDS)
    def test_angles_solve_the_system(self, seed: int) -> None:
        """Solver of numpy, at a load of 20 kN, where the term is no longer small."""
        s, rng = arm(), np.random.default_rng(seed)
        f, m = rng.uniform(-2e4, 2e4, 3), rng.uniform(-2e3, 2e3, 3)
        virtual_joints(s, poses(10)[seed])
        geometric_matrix(s, f, m)
        K, rigid = np.diag(s.drive_stiffness), rng.uniform(-0.01, 0.01, 6)
        expected = np.linalg.solve(K - 0.7 * s.drive_matrix, K @ rigid)
        s.geometric_stiffness, s.drive_angle[:] = 0.7, rigid
        assert follow_levers(s, f, m) == 0
        assert np.abs(s.drive_angle - expected).max() < 1e2 * ROUNDOFF * np.abs(expected).max()
        assert np.abs(expected - rigid).max() > 1e-3 * np.abs(rigid).max()

    @pytest.mark.parametrize("seed", SEEDS)
    def test_component_comes_nearer_to_the_equilibrium(self, seed: int) -> None:
        """Independent: K q_e = J(q + q_e)^T f of the turned robot, solved by scipy. What K_g leaves is of second order in the angles."""
        rng, q = np.random.default_rng(seed), poses(10)[seed]
        f = rng.normal(size=3)
        f *= 5.0 * PAYLOAD / np.linalg.norm(f)
        s, K = arm(), arm().drive_stiffness
        elastic = fsolve(lambda e: K * e - axis_jacobian(s, q + e)[:3].T @ f, np.zeros(6), xtol=ROUNDOFF)
        start = axis_tip(s, q)
        moved = axis_tip(s, q + elastic) - start
        off = []
        for share in (0.0, 1.0):
            c = component(q_link=q, f_T_B=f, geometric_stiffness=share)
            assert MODEL.init(c) == 0
            off.append(float(np.linalg.norm(c.d_T_B - moved)))
        assert off[1] < 0.2 * off[0]


def axis_tip(s: Record, q: np.ndarray) -> np.ndarray:
    """Position of the rigid tool tip at these axis angles."""
    axis_jacobian(s, q)
    return np.array(s.link_p[6])


class TestCartesianStiffness:
    @pytest.mark.parametrize("seed", SEEDS)
    def test_is_the_inverse_of_the_compliance_of_the_drives(self, seed: int) -> None:
        """K_x = J^-T K_q J^-1 against the sum over the virtual joints; what J loses in its inversion bounds the difference."""
        s, q = arm(), poses(10)[seed]
        J = axis_jacobian(s, q)
        K = cartesian_stiffness(J, s.drive_stiffness)
        assert np.abs(K @ compliance(s, q) - np.eye(6)).max() < ROUNDOFF * np.linalg.cond(K)

    def test_with_the_geometric_term(self) -> None:
        s, f = arm(), np.array([3e3, -2e3, 1e4])
        virtual_joints(s, BLOCK)
        geometric_matrix(s, f, np.zeros(3))
        J = axis_jacobian(s, BLOCK)
        K = cartesian_stiffness(J, s.drive_stiffness, s.drive_matrix)
        assert np.abs(np.linalg.solve(K, np.r_[f, 0, 0, 0])[:3] - displaced(s, BLOCK, f, 1.0)).max() < ROUNDOFF * np.linalg.cond(K)

    def test_a_stiffness_that_is_not_positive_is_refused(self) -> None:
        with pytest.raises(ValueError, match=r"smallest eigenvalue of the joint stiffness matrix is -1e\+05 N\.m/rad, expected a positive"):
            cartesian_stiffness(np.eye(6), np.array([1e6, 1e6, 1e6, 1e5, -1e5, 1e5]))

    def test_a_singular_pose_is_refused(self) -> None:
        with pytest.raises(ValueError, match="the pose is singular, so its stiffness is infinite in a direction"):
            cartesian_stiffness(np.diag([1.0, 1, 1, 1, 1, 0]), np.ones(6))


class TestSwitch:
    def test_a_share_of_nothing_leaves_every_bit(self) -> None:
        """Off it is off: what the scratch values of the term hold has no say."""
        load: dict[str, Any] = {"q_link": BLOCK, "f_T_B": [300.0, -400.0, 50.0]}
        one, other = component(**load), component(**load, drive_angle=1.0, drive_matrix=7.0)
        assert MODEL.init(one) == MODEL.init(other) == 0
        assert np.abs(one.d_T_B - other.d_T_B).max() == EXACT

    def test_compiled_gives_the_same_bits_as_plain_python(self) -> None:
        compiled, _ = MODEL.compiled()
        rng = np.random.default_rng(5)
        for q in poses(10):
            load: dict[str, Any] = {"q_link": q, "f_T_B": rng.uniform(-900, 900, 3), "m_T_B": rng.uniform(-90, 90, 3)}
            plain, fast = component(**load, geometric_stiffness=1.0), component(**load, geometric_stiffness=1.0)
            assert MODEL.init(plain) == compiled(fast) == 0
            assert plain.tobytes() == fast.tobytes()

    def test_a_load_that_folds_the_robot_is_an_error(self) -> None:
        """Pushed along the stretched arm towards the base: K_q - K_g loses its definiteness before the elastic angles are large."""
        s = component(q_link=np.zeros(6), f_T_B=[-4e6, 0.0, 0.0], geometric_stiffness=1.0)
        status = MODEL.init(s)
        text = MODEL.message(status, s, 0.5)
        assert "the stiffness matrix K_q - K_g of the axes is indefinite at t = 0.5 s: with axis" in text
        assert "N.m/rad, expected a positive one; the load on the tool f_T_B = [-4000000." in text
        assert text.endswith("folds the robot: check its size and the stiffness, or set geometric_stiffness = 0")


def test_catalogue_of_the_cell_offers_it() -> None:
    candidate = next(c for c in Catalogue.load(SCENARIOS / "irb6400" / "catalogue.toml").candidates if c.effect == "geometric_stiffness")
    variable = MODEL.variable(candidate.named[0])
    assert candidate.unit == variable.unit
    assert variable.minimum == candidate.bounds[0]
    assert candidate.bounds[1] == variable.maximum


class TestPaper003:
    """Section 5.1 with the springs of FACTS10 10.1."""

    def test_the_drive_of_axis_2_moves_upper_arm_only(self) -> None:
        """The parallelogram: column 2 of J is that of a serial arm less that of axis 3, and axis 2 does not turn the tool."""
        s, serial = arm(), arm()
        serial.axis_coupling[...] = 0.0
        for q in poses(10):
            theta = q.copy()
            theta[2] -= q[1]
            J, chain = axis_jacobian(s, q), axis_jacobian(serial, theta)
            assert np.abs(J[:, 1] - (chain[:, 1] - chain[:, 2])).max() < 10.0 * ROUNDOFF
            assert np.abs(J[3:, 1]).max() < 10.0 * ROUNDOFF
            assert np.abs(np.delete(J - chain, 1, axis=1)).max() < 10.0 * ROUNDOFF

    @pytest.mark.paper
    def test_mean_stiffness_of_the_work_space(self) -> None:
        """0.5 N/um: "around", one digit; random points of the work space, spindle down: within 5 % of the calibration."""
        s = arm()
        mean = np.mean([np.trace(compliance(s, q)[:3, :3]) / 3.0 for q in poses(200, straight=True)])
        assert abs(1e-6 / mean - 0.5) < physics(0.5, relative=0.05)

    @pytest.mark.paper
    def test_payload_bends_the_robot_by_about_3_mm(self) -> None:
        """Over the block, 1471 N in all directions: "about 3 mm" (3.15 mm in FACTS10 10.1), mean over directions to 2 %."""
        C = compliance(arm(), BLOCK)[:3, :3]
        rng = np.random.default_rng(0)
        f = rng.normal(size=(4000, 3))
        mean = np.mean(np.linalg.norm(f / np.linalg.norm(f, axis=1, keepdims=True) * PAYLOAD @ C, axis=1))
        assert abs(1e3 * mean - 3.15) < physics(3.15, relative=0.02)

    @pytest.mark.paper
    def test_geometric_term_is_negligible(self) -> None:
        """Negligible, says section 5.1: 0.13 % median, at most 0.33 % of the deflection under 1471 N (FACTS10 10.1)."""
        s, rng, change = arm(), np.random.default_rng(2), []
        for q in poses(120):
            f = rng.normal(size=3)
            f *= PAYLOAD / np.linalg.norm(f)
            without = displaced(s, q, f, 0.0)
            change.append(np.linalg.norm(displaced(s, q, f, 1.0) - without) / np.linalg.norm(without))
        # random poses and directions: the median of 120 is known to a tenth or so, the largest is a bound
        assert abs(np.median(change) - 0.0013) < physics(0.0013, relative=0.2)
        assert max(change) < 0.0033 + physics(0.0033, relative=0.1)
