"""Every robot that is shipped: geometry, inverse, Jacobian and couplings against Pinocchio, which knows no DH table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from robomill.models.model.declaration import Record
from robomill.models.model.parameters import DATA
from robomill.models.robot.dynamics import in_robot_frames, inverse_dynamics, load_dynamics
from robomill.models.robot.kinematics import SPINDLE_ACROSS, Robot, inverse, jacobian, load_robot, tool_pose
from robomill.models.robot.numeric_inverse import kinematics, solve
from tests.tolerances import ROUNDOFF, physics

ROBOTS = sorted(f.stem for f in (DATA / "robots").glob("*.toml"))
SPHERICAL = [name for name in ROBOTS if not load_robot(name).no_closed_form]
SEEDS = range(20)
KUKA = {  # d1, a1, a2, a3, d4, d6 of FACTS 1.2 [mm]; ABB and FANUC below
    "kr300_r2500_ultra": (675, 350, 1150, -41, 1000, 240),
    "kr210_2": (750, 350, 1250, -55, 1100, 230),
    "kr210_r2700_extra": (675, 350, 1150, -41, 1200, 215),
    "kr500_r2830": (1045, 500, 1300, -55, 1025, 290),
}
X, Y, Z = np.eye(3)


def chain(name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Axes and points on them with all joints at zero, as drawings show an arm: place [m] and direction in B; the last is the flange.

    KUKA: stretched forward, A2 and A3 turn about +y (down), A1, A4, A6 about -z and -x. ABB: upper arm vertical, forearm level,
    all senses positive about z, y, y, x, y, x. FANUC (as ABB), its forearm and wrist turn the other way.
    """
    if name in KUKA:
        d1, a1, a2, a3, d4, d6 = (1e-3 * v for v in KUKA[name])
        wrist = np.array([a1 + a2 + d4, 0.0, d1 + a3])
        places = [np.zeros(3), np.array([a1, 0, d1]), np.array([a1 + a2, 0, d1]), wrist, wrist, wrist, wrist + d6 * X]
        return list(zip(places, [-Z, Y, Y, -X, Y, -X, X], strict=True))
    d1, a1, a2, a3, d4, d6 = {
        "irb6400r_25_150": (0.8, 0.24, 1.05, 0.225, 1.175, 0.2),
        "fanuc_r2000ic": (0.67, 0.312, 1.075, 0.225, 1.28, 0.215),
    }[name]
    wrist = np.array([a1 + d4, 0.0, d1 + a2 + a3])
    places = [np.zeros(3), np.array([a1, 0, d1]), np.array([a1, 0, d1 + a2]), wrist, wrist, wrist, wrist + d6 * X]
    senses = [Z, Y, Y, X, Y, X, X] if name == "irb6400r_25_150" else [Z, Y, -Y, -X, -Y, -X, X]
    return list(zip(places, senses, strict=True))


def ur10() -> list[tuple[np.ndarray, np.ndarray]]:
    """The maker's description: all angles zero, arm stretched along -x, shoulder and elbow about -y."""
    d1, a2, a3, d4, d5, d6 = 0.1273, 0.612, 0.5723, 0.163941, 0.1157, 0.0922
    elbow, wrist = np.array([-a2, 0, d1]), np.array([-a2 - a3, -d4, d1])
    places = [np.zeros(3), np.array([0, 0, d1]), elbow, wrist, wrist, wrist - d5 * Z, wrist - d5 * Z - d6 * Y]
    return list(zip(places, [Z, -Y, -Y, -Y, -Z, -Y, -Y], strict=True))


def oracle(name: str) -> tuple[pin.Model, pin.Data]:
    """The arm as Pinocchio has it: revolute joints about axes through points, with all frames parallel to B at zero."""
    places = ur10() if name == "ur10" else chain(name)
    model, parent, before = pin.Model(), 0, np.zeros(3)
    for k, (place, axis) in enumerate(places[:6]):
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(axis), pin.SE3(np.eye(3), place - before), f"A{k + 1}")
        before = place
    model.addFrame(pin.Frame("flange", parent, pin.SE3(np.eye(3), places[6][0] - before), pin.FrameType.OP_FRAME))
    return model, model.createData()


def joints(name: str, q: np.ndarray) -> np.ndarray:
    """Joint angles of the chain above: an ABB axis 3 turns the forearm against the horizontal, so does the angle FANUC shows."""
    turned = q.copy()
    if name == "irb6400r_25_150":
        turned[2] = q[2] - q[1]
    if name == "fanuc_r2000ic":
        turned[2] = q[2] + q[1]
    return turned


def axes(robot: Robot, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(robot.q_min, robot.q_max)


def flange(name: str) -> Record:
    s = kinematics(load_robot(name), SPINDLE_ACROSS)
    s.p_FT_F[:] = 0.0
    s.quat_FT[:] = [1.0, 0.0, 0.0, 0.0]
    return s


@pytest.mark.parametrize("name", ROBOTS)
def test_flange_and_jacobian_are_those_of_pinocchio(name: str) -> None:
    """Rotation: that of the flange at zero angles is its convention, so only turns from there are compared."""
    (model, data), robot, s = oracle(name), load_robot(name), flange(name)
    home, p, R, J = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)), np.zeros((6, 6))
    tool_pose(s, np.zeros(6), p, home)
    step = np.array([joints(name, e) - joints(name, np.zeros(6)) for e in np.eye(6)]).T
    for seed in SEEDS:
        q = axes(robot, seed)
        tool_pose(s, q, p, R)
        pin.framesForwardKinematics(model, data, joints(name, q))
        assert np.abs(data.oMf[1].translation - p).max() < 10.0 * ROUNDOFF, seed
        assert np.abs(data.oMf[1].rotation - R @ home.T).max() < 10.0 * ROUNDOFF, seed
        jacobian(s, q, J)
        theirs = pin.computeFrameJacobian(model, data, joints(name, q), 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED) @ step
        assert np.abs(J - theirs).max() < 10.0 * ROUNDOFF, seed


@pytest.mark.parametrize("name", SPHERICAL)
def test_closed_form_inverse_finds_the_angles_again(name: str) -> None:
    robot, s = load_robot(name), kinematics(load_robot(name), SPINDLE_ACROSS)
    p, R, found = np.zeros(3), np.zeros((3, 3)), np.zeros(6)
    for seed in SEEDS:
        q = axes(robot, seed)
        tool_pose(s, q, p, R)
        assert inverse(s, p, R, q, found) == 0, seed
        # near a stretched elbow or aligned wrist an angle is the root of a cosine: the pose is what counts
        back, turned = np.zeros(3), np.zeros((3, 3))
        tool_pose(s, found, back, turned)
        assert max(np.abs(back - p).max(), np.abs(turned - R).max()) < 1e3 * ROUNDOFF, seed
        assert np.abs(found - q).max() < 1e6 * ROUNDOFF, seed


@pytest.mark.parametrize("name", ROBOTS)
def test_numeric_inverse_finds_the_pose(name: str) -> None:
    robot, s = load_robot(name), kinematics(load_robot(name), SPINDLE_ACROSS)
    p, R, back, turned = np.zeros(3), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
    for seed in SEEDS:
        near = robot.q_home + np.random.default_rng(seed).uniform(-0.2, 0.2, 6)
        tool_pose(s, near, p, R)
        found = solve(robot, SPINDLE_ACROSS, p, R, robot.q_home)
        tool_pose(s, found, back, turned)
        assert max(np.abs(back - p).max(), np.abs(turned - R).max()) < 1e4 * ROUNDOFF, seed
        assert np.all((found >= robot.q_min) & (found <= robot.q_max))


def test_what_is_out_of_reach_says_how_near_it_came() -> None:
    robot = load_robot("ur10")
    with pytest.raises(
        ValueError, match=r"robot 'UR10': no axis angles near .* deg put the tool tip at \[5\.0, 0\.0, 0\.0\] m; it comes to .* mm"
    ):
        solve(robot, SPINDLE_ACROSS, [5.0, 0.0, 0.0], np.eye(3), robot.q_home)


def test_ur10_says_why_it_has_no_closed_form() -> None:
    assert load_robot("ur10").no_closed_form == (
        "dh_alpha is (0, 90, 0, 0, 90, -90) deg, the closed form is for a spherical wrist with (0, -90, 0, -90, 90, -90) deg"
    )
    assert not load_robot("fanuc_r2000ic").no_closed_form


@pytest.mark.parametrize("name", sorted(f.stem for f in (DATA / "dynamics").glob("*.toml")))
def test_rigid_bodies_stand_in_the_frames_of_the_same_robot(name: str) -> None:
    """Both tables end in the flange: the last body, symmetric about the flange axis, has its centre of gravity on it."""
    com, _ = in_robot_frames(load_dynamics(name), load_robot(name))
    assert np.abs(com[5, :2]).max() < 10.0 * ROUNDOFF
    # behind the flange face, inside the wrist: FACTS 1.4 has 27 and 50 mm
    assert -0.06 < com[5, 2] < 0.0


def test_the_weight_of_the_ur10_stretched_out_is_that_of_its_links_at_their_levers() -> None:
    """At angles zero the arm is level; centres of gravity of the wrist lie on lines through it that are square to the lever."""
    robot, bodies = load_robot("ur10"), load_dynamics("ur10")
    com, inertia = in_robot_frames(bodies, robot)
    shape = {name: getattr(robot, name) for name in ("dh_alpha", "dh_a", "dh_d", "dh_offset", "axis_sign", "axis_coupling")}
    still = {"rotor_inertia": 0.0, "gear_ratio": 1.0, "counterbalance_lever": 0.0, "payload_mass": 0.0, "gravity_B": bodies.gravity_B}
    tau = inverse_dynamics(np.zeros(6), 0.0, 0.0, **shape, **still, body_mass=bodies.body_mass, body_com=com, body_inertia=inertia)
    levers = 12.7 * 0.232 + 4.27 * (0.612 + 0.3323) + (2.0 + 2.0 + 0.365) * (0.612 + 0.5723)
    assert abs(tau[1]) == pytest.approx(9.81 * levers, rel=1e3 * ROUNDOFF)
    assert abs(tau[0]) < 1e3 * ROUNDOFF


def test_unknown_robot_and_broken_coupling(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no parameter file .*kr2100\.toml; available: .*robots/kr210_2"):
        load_robot("kr2100")
    text = (DATA / "robots" / "ur10.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace("value = [[0, 0,", "value = [[0, 1,"))
    with pytest.raises(ValueError, match=r"robot 'UR10': axis_coupling is .*expected six rows of six with zeros on and above the diagonal"):
        load_robot(tmp_path / "mine.toml")


def test_home_and_speeds_of_all_robots_are_plausible() -> None:
    """Industrial arms: 0.9 to 4 rad/s per axis, home within the limits."""
    for name in ROBOTS:
        robot = load_robot(name)
        assert np.all((robot.q_home > robot.q_min) & (robot.q_home < robot.q_max)), name
        assert np.all(np.abs(robot.speed_max - 2.45) < physics(2.45, 0.65)), name
