"""Specification of the rigid-body inverse dynamics, the counterbalance and the friction laws."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import eigh

from robomill.models.model.declaration import FloatArray, record
from robomill.models.robot.dynamics import (
    KR300_DYNAMICS,
    RIGID_BODY,
    _instance,
    _over_time,
    counterbalance_torque,
    friction_torque,
    inertia_matrix,
    inverse_dynamics,
    mass_matrix,
    presliding,
)
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS, forward, jacobian
from tests.tolerances import EXACT, ROUNDOFF, discretisation, physics

G = 9.81
BARE = {"counterbalance_lever": 0.0, "rotor_inertia": 0.0}
"""Rigid bodies alone."""


def states(count: int, seed: int = 5) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Seeded positions inside the limits [rad], speeds up to 2 rad/s, accelerations up to 8 rad/s2."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(KR300.q_min, KR300.q_max, (count, 6))
    return q, rng.uniform(-2.0, 2.0, (count, 6)), rng.uniform(-8.0, 8.0, (count, 6))


def pinocchio_robot() -> tuple[Any, Any, int]:
    """The robot in Pinocchio: WEI's own standard DH chain, inertias in his frames; model, data, frame id of T."""
    d, payload = KR300_DYNAMICS, SPINDLE_ACROSS
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])

    def turn(axis: int, angle: float) -> Any:
        return pin.SE3(pin.utils.rotate("xyz"[axis], angle), np.zeros(3))

    def shift(x: float, z: float) -> Any:
        return pin.SE3(np.eye(3), np.array([x, 0.0, z]))

    parent, placement = 0, turn(0, math.pi)
    for i in range(6):
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"A{i + 1}")
        placement = turn(2, d.dh_offset[i]) * shift(0.0, d.dh_d[i]) * shift(d.dh_a[i], 0.0) * turn(0, d.dh_alpha[i])
        body = pin.Inertia(d.body_mass[i], d.body_com[i], inertia_matrix(d.body_inertia[i]))
        model.appendBodyToJoint(parent, body, placement)
    # the last link frame of the source is the flange frame F
    spindle = pin.Inertia(payload.mass, np.asarray(payload.p_FG_F), inertia_matrix(d.payload_inertia))
    model.appendBodyToJoint(parent, spindle, placement)
    tip = model.addFrame(pin.Frame("T", parent, placement * pin.SE3(np.eye(3), np.asarray(payload.p_FT_F)), pin.FrameType.OP_FRAME))
    return model, model.createData(), tip


def potential_energy(q: FloatArray) -> float:
    """Energy of weight and gas [J] at q [6] rad, written out from the source's own chain."""
    d = KR300_DYNAMICS
    X = np.diag([1.0, -1.0, -1.0, 1.0])
    energy = 0.0
    for i in range(6):
        c, s, ca, sa = math.cos(q[i] + d.dh_offset[i]), math.sin(q[i] + d.dh_offset[i]), math.cos(d.dh_alpha[i]), math.sin(d.dh_alpha[i])
        X = X @ np.array(
            [[c, -s * ca, s * sa, d.dh_a[i] * c], [s, c * ca, -c * sa, d.dh_a[i] * s], [0.0, sa, ca, d.dh_d[i]], [0.0, 0.0, 0.0, 1.0]]
        )
        energy += d.body_mass[i] * G * (X @ [*d.body_com[i], 1.0])[2]
    energy += SPINDLE_ACROSS.mass * G * (X @ [*SPINDLE_ACROSS.p_FG_F, 1.0])[2]
    D, k = d.counterbalance_frame_distance, d.counterbalance_lever
    length = math.sqrt(D * D + k * k - 2.0 * D * k * math.cos(q[1] + math.radians(95.0)))
    return energy - d.counterbalance_gas * math.log(d.counterbalance_volume - (length - (D - k)) * d.counterbalance_area)


# ---------------------------------------------------------------------------------------- physics


def test_nothing_moves_and_nothing_weighs_without_gravity() -> None:
    q, _, _ = states(10)
    assert np.all(inverse_dynamics(q, 0.0, 0.0, gravity_B=0.0, counterbalance_lever=0.0) == EXACT)


def test_axis_1_carries_no_weight() -> None:
    # its axis is vertical
    q, _, _ = states(20)
    tau = inverse_dynamics(q, 0.0, 0.0)
    assert np.abs(tau[:, 0]).max() <= ROUNDOFF * np.abs(tau).max()


def test_weight_of_the_stretched_arm() -> None:
    # A = 0: a payload as a point on the flange, 2.74 m in front of axis 1, so 2.39 m in front of axis 2,
    # which turns downwards; everything else equal, it adds -m g 2.39 m
    stretched = np.zeros(6)
    point = {"payload_com_F": 0.0, "payload_inertia": 0.0}
    added = inverse_dynamics(stretched, 0.0, 0.0, payload_mass=100.0, **point) - inverse_dynamics(
        stretched, 0.0, 0.0, payload_mass=0.0, **point
    )
    np.testing.assert_allclose(added[1], -100.0 * G * 2.39, rtol=ROUNDOFF)
    np.testing.assert_allclose(added[2], -100.0 * G * (2.39 - 1.15), rtol=ROUNDOFF)


@pytest.mark.parametrize(("a2", "published"), [(-140, -5235), (-120, -3074), (-95, 0), (-60, 4197), (-40, 6179), (-5, 8652)])
def test_counterbalance_of_the_source(a2: float, published: float) -> None:
    # FACTS 1.4 (WEI), rounded to 1 N m
    s = record(RIGID_BODY.new())
    assert counterbalance_torque(s, math.radians(a2)) == pytest.approx(published, abs=physics(published, absolute=0.5))


def test_counterbalance_works_against_the_weight_of_the_arm() -> None:
    leaning = np.array([[0.0, math.radians(a2), math.radians(90.0), 0.0, 0.0, 0.0] for a2 in (-60.0, -40.0, -20.0)])
    with_it = np.abs(inverse_dynamics(leaning, 0.0, 0.0)[:, 1])
    without = np.abs(inverse_dynamics(leaning, 0.0, 0.0, counterbalance_lever=0.0)[:, 1])
    assert np.all(with_it < without)


@pytest.mark.parametrize(
    ("degrees", "published"),
    [
        ((0.0, -45.0, 90.0, 0.0, -45.0, 0.0), (12.6, 13.7, 28.8)),
        ((0.0, -10.0, 10.0, 0.0, 0.0, 0.0), (10.1, 10.8, 38.0)),
        ((2.66, -77.64, 77.44, 0.0, 0.20, 0.0), (12.2, 17.3, 27.3)),
    ],
)
def test_lowest_modes_on_the_drive_springs(degrees: tuple[float, ...], published: tuple[float, ...]) -> None:
    # FACTS 4.3: masses of WEI, springs k_A of Haehn & Weigold 2020 Table 1, 60 kg end effector, rotors locked
    stiffness = np.diag([7.5e6, 5.4e6, 4.3e6, 9.0e5, 8.0e5, 4.9e5])
    effector = {"payload_mass": 60.0, "payload_com_F": (0.06, 0.0, 0.20), "payload_inertia": (1.5, 1.5, 1.5, 0.0, 0.0, 0.0)}
    matrix = mass_matrix(np.deg2rad(degrees), rotors=False, **effector)
    squares = eigh(stiffness, matrix, eigvals_only=True)
    # printed to 0.1 Hz, the 38 Hz to 1 Hz
    for frequency, value in zip(np.sqrt(squares[:3]) / (2.0 * math.pi), published, strict=True):
        assert frequency == pytest.approx(value, abs=physics(value, absolute=0.5 if value == 38.0 else 0.05))


def test_reflected_rotors_are_those_of_the_source() -> None:
    # FACTS 1.4: J G^2 = 609, 844, 751, 84, 99, 41 kg m2
    q, _, _ = states(1)
    difference = mass_matrix(q[0]) - mass_matrix(q[0], rotors=False)
    np.testing.assert_allclose(np.diag(difference), [609, 844, 751, 84, 99, 41], rtol=0.0, atol=physics(1.0, absolute=0.5))
    assert np.abs(difference - np.diag(np.diag(difference))).max() <= ROUNDOFF * 1e3


def friction(speed: float) -> float:
    """100 N m s/rad, 200 N m, and 50 N m more at breakaway, with a sign that is smooth over 1e-3 rad/s."""
    return friction_torque(speed, 100.0, 200.0, 50.0, math.tanh(speed / 1e-3), 0.02)


def test_friction_curve_has_its_three_parts() -> None:
    assert friction(0.0) == EXACT
    # breakaway: well above the smoothing, well below the Stribeck speed; exp(-(0.005/0.02)^2) = 0.9394
    assert friction(0.005) == pytest.approx(0.5 + (200.0 + 50.0 * math.exp(-0.0625)) * math.tanh(5.0), rel=ROUNDOFF)
    # fast: the Stribeck part is gone
    assert friction(2.0) == pytest.approx(400.0, rel=ROUNDOFF)
    assert friction(-0.3) == -friction(0.3)


def test_friction_only_takes_power() -> None:
    speeds = np.random.default_rng(1).uniform(-2.0, 2.0, 100)
    assert all(v * friction(v) > 0.0 for v in speeds)


def test_dry_friction_turns_over_within_a_distance_and_holds_at_rest() -> None:
    """Dahl: dF/dx = (1 - F sgn dx) / d. From 0 forward 1 - exp(-x / d); back from 1 it is 2 exp(-x / d) - 1, whatever the steps."""
    d = 3e-5
    for steps in (1, 7):
        side = 0.0
        for _ in range(steps):
            side = presliding(side, 2.0 * d / steps, d)
        assert side == pytest.approx(1.0 - math.exp(-2.0), rel=ROUNDOFF)
        assert presliding(side, 0.0, d) == side
        for _ in range(steps):
            side = presliding(side, -50.0 * d / steps, d)
        assert side == pytest.approx(-1.0, rel=ROUNDOFF)
    assert presliding(1.0, -d, d) == pytest.approx(2.0 * math.exp(-1.0) - 1.0, rel=ROUNDOFF)
    assert presliding(-0.3, 0.5 * d, d) == -presliding(0.3, -0.5 * d, d)


def test_friction_data_are_those_of_the_source() -> None:
    # FACTS 1.4: Tc G = 188, 490, 470, 99, 99, 57 N m
    d = KR300_DYNAMICS
    np.testing.assert_allclose(
        d.motor_coulomb_friction * d.gear_ratio, [188, 490, 470, 99, 99, 57], rtol=0.0, atol=physics(1.0, absolute=0.5)
    )
    # second set, A1 at 25 deg/s (the speed of the recordings) by hand: 4 + 1940 * 0.43633 + 32 * 0.41058 + 319 = 1182.6 N m
    speed = math.radians(25.0)
    by_law = (
        d.link_asymmetric_friction[0]
        + d.link_viscous_friction[0] * speed
        + d.link_coulomb_friction[0] * math.tanh(speed)
        + d.link_step_friction[0] * math.tanh(d.link_step_slope[0] * speed)
    )
    assert by_law == pytest.approx(1182.6, abs=physics(1.0, absolute=0.05))


def test_motor_friction_is_absent_from_the_nominal_model() -> None:
    q, qd, qdd = states(20)
    reversed_speed = inverse_dynamics(q, -qd, qdd)
    np.testing.assert_allclose(inverse_dynamics(q, qd, qdd), reversed_speed, rtol=0.0, atol=ROUNDOFF * np.abs(reversed_speed).max())


# ---------------------------------------------------------------------------------------- numerics


def test_torque_against_pinocchio() -> None:
    model, data, tip = pinocchio_robot()
    rng = np.random.default_rng(11)
    q, qd, qdd = states(100)
    f, m = rng.uniform(-1000.0, 1000.0, (100, 3)), rng.uniform(-100.0, 100.0, (100, 3))
    expected = np.empty((100, 6))
    for k in range(100):
        J = pin.computeFrameJacobian(model, data, q[k], tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        expected[k] = pin.rnea(model, data, q[k], qd[k], qdd[k]) - J.T @ np.r_[f[k], m[k]]
    tau = inverse_dynamics(q, qd, qdd, f, m, **BARE)
    np.testing.assert_allclose(tau, expected, rtol=0.0, atol=ROUNDOFF * np.abs(expected).max())


def test_coupled_axes_do_the_work_of_their_joints() -> None:
    """Joint angles are q + coupling q: torques at the axes are the transposed map of those at the joints, from Pinocchio."""
    model, data, _ = pinocchio_robot()
    coupling = np.zeros((6, 6))
    coupling[2, 1], coupling[4, 3], coupling[5, 3], coupling[5, 4] = -1.0, 0.02, -0.3, 0.5
    turns = np.eye(6) + coupling * KR300.axis_sign[:, None]  # WEI's joint angles are axis angles, the coupling is on DH angles
    q, qd, qdd = states(20)
    expected = np.array([turns.T @ pin.rnea(model, data, turns @ a, turns @ b, turns @ c) for a, b, c in zip(q, qd, qdd, strict=True)])
    tau = inverse_dynamics(q, qd, qdd, axis_coupling=coupling, **BARE)
    np.testing.assert_allclose(tau, expected, rtol=0.0, atol=ROUNDOFF * np.abs(expected).max())


def test_mass_matrix_against_pinocchio() -> None:
    model, data, _ = pinocchio_robot()
    for q in states(100)[0]:
        expected = pin.crba(model, data, q)
        expected = np.triu(expected) + np.triu(expected, 1).T
        np.testing.assert_allclose(mass_matrix(q, rotors=False), expected, rtol=0.0, atol=ROUNDOFF * np.abs(expected).max())


def test_geometry_of_the_dynamics_is_that_of_the_kinematics() -> None:
    # two sources: WEI's standard DH here, the modified DH table of the data sheets in robomill.models.robot.kinematics
    model, data, tip = pinocchio_robot()
    s = record(RIGID_BODY.new())
    for q in states(100)[0]:
        forward(s, q)
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(s.link_p[6], data.oMf[tip].translation, rtol=0.0, atol=3.0 * ROUNDOFF)
        np.testing.assert_allclose(s.link_R[6], data.oMf[tip].rotation, rtol=0.0, atol=ROUNDOFF)


def test_mass_matrix_is_symmetric_and_positive_definite() -> None:
    for q in states(100)[0]:
        M = mass_matrix(q)
        assert np.abs(M - M.T).max() <= ROUNDOFF * np.abs(M).max()
        assert np.linalg.eigvalsh(M).min() > 0.0


def test_static_torque_is_the_gradient_of_the_potential_energy() -> None:
    step = 1e-4
    for q in states(100)[0]:
        gradient = [(potential_energy(q + step * e) - potential_energy(q - step * e)) / (2.0 * step) for e in np.eye(6)]
        # third derivative of the energy: below 4e3 J, gas and weight together; roundoff of 1e5 J over 2e-4 rad: 1e-7
        np.testing.assert_allclose(
            inverse_dynamics(q, 0.0, 0.0), gradient, rtol=0.0, atol=discretisation(4e3 / 6.0, step, 2) + 40.0 * ROUNDOFF / (2.0 * step)
        )


def test_power_of_the_motors_is_the_change_of_energy() -> None:
    rng = np.random.default_rng(2)
    middle, swing = 0.5 * (KR300.q_min + KR300.q_max), rng.uniform(0.2, 0.8, 6)
    rate, phase = rng.uniform(1.0, 3.0, 6), rng.uniform(0.0, 6.0, 6)
    h = 1e-3

    def motion(t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        angle = rate * t + phase
        return middle + swing * np.sin(angle), swing * rate * np.cos(angle), -swing * rate**2 * np.sin(angle)

    def energy(t: float) -> float:
        q, qd, _ = motion(t)
        return 0.5 * float(qd @ mass_matrix(q) @ qd) + potential_energy(q)

    for t in np.linspace(0.0, 4.0, 25):
        q, qd, qdd = motion(t)
        power = float(inverse_dynamics(q, qd, qdd) @ qd)
        numeric = (8.0 * (energy(t + h) - energy(t - h)) - (energy(t + 2.0 * h) - energy(t - 2.0 * h))) / (12.0 * h)
        # fifth derivative of an energy of 1 kJ swinging with 6 rad/s: 8e6 W/s4; roundoff of 1e5 J over 2 ms: 1e-8
        assert numeric == pytest.approx(power, abs=discretisation(8e6 / 30.0, h, 4) + 1e5 * ROUNDOFF)


def test_process_force_on_the_tool_relieves_the_motors_by_the_transposed_jacobian() -> None:
    rng = np.random.default_rng(3)
    s = record(RIGID_BODY.new())
    J = np.empty((6, 6))
    for q in states(100)[0]:
        wrench = rng.uniform(-1.0, 1.0, 6) * [1000.0, 1000.0, 1000.0, 100.0, 100.0, 100.0]
        jacobian(s, q, J)
        change = inverse_dynamics(q, 0.0, 0.0, wrench[:3], wrench[3:]) - inverse_dynamics(q, 0.0, 0.0)
        np.testing.assert_allclose(change, -J.T @ wrench, rtol=0.0, atol=ROUNDOFF * 1e5)


def test_payload_merges_by_parallel_axes() -> None:
    # a payload split in two halves side by side is the same body
    q, qd, qdd = states(20)
    one = {"payload_mass": 80.0, "payload_com_F": (0.1, -0.05, 0.3), "payload_inertia": (2.0, 3.0, 4.0, 0.1, -0.2, 0.3)}
    alone = inverse_dynamics(q, qd, qdd, **one, **BARE)
    # linear in mass at fixed place and inertia per mass: (0 kg + 160 kg) / 2
    double = {"payload_mass": 160.0, "payload_com_F": one["payload_com_F"], "payload_inertia": 2.0 * np.asarray(one["payload_inertia"])}
    mean = 0.5 * (inverse_dynamics(q, qd, qdd, **double, **BARE) + inverse_dynamics(q, qd, qdd, payload_mass=0.0, **BARE))
    np.testing.assert_allclose(alone, mean, rtol=0.0, atol=ROUNDOFF * np.abs(mean).max())


def test_arrays_over_time_broadcast() -> None:
    q, qd, qdd = states(12)
    whole = inverse_dynamics(q.reshape(3, 4, 6), qd.reshape(3, 4, 6), qdd.reshape(3, 4, 6), (0.0, 0.0, 100.0))
    assert whole.shape == (3, 4, 6)
    assert np.array_equal(whole[2, 1], inverse_dynamics(q[9], qd[9], qdd[9], (0.0, 0.0, 100.0)))


# ---------------------------------------------------------------------------------------- parity


def test_plain_python_and_compiled_agree_exactly() -> None:
    q, qd, qdd = states(40)
    f, m = np.full((40, 3), 300.0), np.full((40, 3), -20.0)
    tau = np.empty((40, 6))
    _over_time(_instance({}), q, qd, qdd, f, m, tau)
    assert np.array_equal(tau, inverse_dynamics(q, qd, qdd, f, m))


# ---------------------------------------------------------------------------------------- errors


def test_an_unknown_parameter_is_named() -> None:
    with pytest.raises(KeyError, match=r"no variable 'payload'; it has .*payload_mass"):
        inverse_dynamics(np.zeros(6), 0.0, 0.0, payload=10.0)


def test_an_input_is_no_parameter() -> None:
    with pytest.raises(KeyError, match=r"'tau' is no parameter of the rigid-body model; it has .*payload_mass"):
        inverse_dynamics(np.zeros(6), 0.0, 0.0, tau=10.0)


def test_a_wrong_shape_is_named() -> None:
    with pytest.raises(ValueError, match=r"qd: has shape \(5,\), expected \[..., 6\]"):
        inverse_dynamics(np.zeros(6), np.zeros(5), 0.0)


def test_an_impossible_counterbalance_is_refused() -> None:
    with pytest.raises(ValueError, match=r"counterbalance cannot move: lever 0\.9 m.*lever shorter than the frame"):
        inverse_dynamics(np.zeros(6), 0.0, 0.0, counterbalance_lever=0.9)
