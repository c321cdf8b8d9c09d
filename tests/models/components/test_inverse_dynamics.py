"""Specification of the component inverse_dynamics."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from robomill.models.components.inverse_dynamics import MODEL
from robomill.models.model.declaration import FloatArray, record
from robomill.models.robot.dynamics import KR300_DYNAMICS, friction_torque, inverse_dynamics
from robomill.models.robot.kinematics import KR300
from tests.models.robot.test_dynamics import pinocchio_robot
from tests.tolerances import EXACT, ROUNDOFF, discretisation

H = 0.004
STEPS = 300
T = H * np.arange(STEPS + 1)[:, None]
MIDDLE = np.array([0.1, -1.4, 1.7, 0.2, -0.5, 0.3])
WAVE = 2.0 * math.pi * np.array([0.7, 0.9, 1.1, 1.3, 0.8, 1.0])
SWING = np.array([0.3, 0.2, 0.25, 0.4, 0.35, 0.5])
"""A motion of all axes, with its derivatives in closed form."""
Q, QD, QDD = MIDDLE + SWING * np.sin(WAVE * T), SWING * WAVE * np.cos(WAVE * T), -SWING * WAVE * WAVE * np.sin(WAVE * T)
G = KR300_DYNAMICS.gear_ratio
EFFECTS = tuple(v.name for v in MODEL.variables if v.effect)


def run(plain: bool = True, steps: int = STEPS, **parameters: Any) -> dict[str, FloatArray]:
    """Outputs [steps + 1, 6] over the motion above."""
    init, step = MODEL.plain() if plain else MODEL.compiled()
    data = MODEL.new()
    for name, value in parameters.items():
        data[name] = value
    s = record(data)
    found: dict[str, list[FloatArray]] = {"torque_motor": [], "torque_gear": [], "q_link": []}
    for k in range(steps + 1):
        data["q"], data["qd"], data["qdd"] = Q[k], QD[k], QDD[k]
        status = init(s) if k == 0 else step(s, T[k - 1, 0], H)
        assert status == 0, MODEL.message(status, s, 0.0)
        for name, rows in found.items():
            rows.append(data[name][0].copy())
    return {name: np.array(rows) for name, rows in found.items()}


NOMINAL = run(plain=False)


def change(plain: bool = False, **parameters: Any) -> dict[str, FloatArray]:
    """Outputs with the parameters minus the nominal ones."""
    other = run(plain, **parameters)
    return {name: other[name] - NOMINAL[name] for name in NOMINAL}


def unchanged(*arrays: FloatArray) -> bool:
    return all(bool(np.all(a == EXACT)) for a in arrays)


# ---------------------------------------------------------------------------------------- physics


def test_nominal_torque_is_that_of_pinocchio() -> None:
    # rigid bodies by Pinocchio in the frames of the source; counterbalance and rotors as FACTS 1.4 writes them
    model, data, _ = pinocchio_robot()
    d = KR300_DYNAMICS
    rng = np.random.default_rng(11)
    init, _ = MODEL.plain()
    for _ in range(100):
        q = rng.uniform(KR300.q_min, KR300.q_max)
        qd, qdd = rng.uniform(-2.0, 2.0, 6), rng.uniform(-8.0, 8.0, 6)
        expected = pin.rnea(model, data, q, qd, qdd)
        delta = q[1] + math.radians(95.0)
        length = math.sqrt(0.8**2 + 0.2**2 - 2.0 * 0.8 * 0.2 * math.cos(delta))
        pressure = d.counterbalance_gas / (960e-6 - (length - 0.6) * d.counterbalance_area)
        expected[1] += 0.8 * 0.2 * math.sin(delta) / length * pressure * d.counterbalance_area
        expected += d.rotor_inertia * G**2 * qdd
        instance = MODEL.new()
        instance["q"], instance["qd"], instance["qdd"] = q, qd, qdd
        assert init(record(instance)) == 0
        np.testing.assert_allclose(instance["torque_motor"][0] * G, expected, rtol=0.0, atol=ROUNDOFF * np.abs(expected).max() * 10.0)


def test_nominal_link_is_rigid() -> None:
    assert unchanged(NOMINAL["q_link"] - Q)


def test_gear_torque_is_the_axis_torque_without_rotors() -> None:
    expected = inverse_dynamics(Q, QD, QDD, rotor_inertia=0.0)
    np.testing.assert_allclose(NOMINAL["torque_gear"], expected, atol=ROUNDOFF * np.abs(expected).max(), rtol=0.0)


def test_differentiating_filter_follows_a_slow_motion() -> None:
    # its only error is its lag 2 D / w: 18.6 ms at 12 Hz and 0.7; so the torque is that of the motion 18.6 ms ago
    found = run(plain=False, differentiate=True)["torque_motor"]
    then = T - 2.0 * 0.7 / (2.0 * math.pi * 12.0)
    q, qd, qdd = MIDDLE + SWING * np.sin(WAVE * then), SWING * WAVE * np.cos(WAVE * then), -SWING * WAVE * WAVE * np.sin(WAVE * then)
    late = inverse_dynamics(q, qd, qdd) / G
    settled = slice(75, None)
    # the rest is of second order in frequency over bandwidth: (1.3 / 12)^2 of the amplitude
    assert np.abs(found - late)[settled].max() <= (1.3 / 12.0) ** 2 * np.ptp(late, axis=0).max()


def test_differentiating_filter_is_exact_at_rest() -> None:
    init, step = MODEL.plain()
    data = MODEL.new()
    data["differentiate"], data["q"] = True, MIDDLE
    s = record(data)
    assert init(s) == 0
    first = data["torque_motor"].copy()
    for k in range(20):
        assert step(s, k * H, H) == 0
    assert unchanged(data["torque_motor"] - first)


# ---------------------------------------------------------------------------------------- effects


@pytest.mark.parametrize("axis", range(6))
def test_friction_adds_its_curve_to_the_motor_torque_of_its_axis(axis: int) -> None:
    values = {"friction_viscous": 1500.0, "friction_coulomb": 400.0, "friction_stribeck": 120.0}
    got = change(**{n: np.eye(6)[axis] * v for n, v in values.items()})
    expected = [friction_torque(v, 1500.0, 400.0, 120.0, math.tanh(v / 1e-3), 0.02) / G[axis] for v in QD[:, axis]]
    np.testing.assert_allclose(got["torque_motor"][:, axis], expected, rtol=0.0, atol=ROUNDOFF * 100.0)
    assert unchanged(np.delete(got["torque_motor"], axis, axis=1), got["torque_gear"], got["q_link"])


def test_asymmetric_friction_is_the_same_in_both_directions() -> None:
    got = change(friction_asymmetry=np.eye(6)[1] * 50.0)["torque_motor"]
    moving = np.abs(QD[:, 1]) > 0.02
    np.testing.assert_allclose(got[moving, 1], 50.0 / G[1], rtol=1e3 * ROUNDOFF)
    assert unchanged(np.delete(got, 1, axis=1))


def test_load_friction_is_proportional_to_the_torque_through_the_gear() -> None:
    got = change(friction_load=np.eye(6)[2] * 0.05)["torque_motor"]
    expected = 0.05 * np.abs(NOMINAL["torque_gear"][:, 2]) * np.tanh(QD[:, 2] / 1e-3) / G[2]
    np.testing.assert_allclose(got[:, 2], expected, rtol=0.0, atol=ROUNDOFF * 100.0)
    assert unchanged(np.delete(got, 2, axis=1))


def test_payload_errors_are_those_of_another_payload() -> None:
    got = run(plain=False, payload_mass_error=40.0, payload_com_error=(0.05, -0.02, 0.1), payload_inertia_error=(3.0, 2.0, 1.0))[
        "torque_motor"
    ]
    v = MODEL.variable("payload_com_F").start_values
    inertia = MODEL.variable("payload_inertia").start_values + np.array([3.0, 2.0, 1.0, 0.0, 0.0, 0.0])
    mass = float(MODEL.variable("payload_mass").start_values) + 40.0
    same = inverse_dynamics(Q, QD, QDD, payload_mass=mass, payload_com_F=v + np.array([0.05, -0.02, 0.1]), payload_inertia=inertia)
    np.testing.assert_allclose(got, same / G, rtol=0.0, atol=ROUNDOFF * 100.0)


def test_payload_errors_leave_the_parameters_as_they_were() -> None:
    init, _ = MODEL.plain()
    data = MODEL.new()
    data["payload_mass_error"], data["payload_com_error"], data["payload_inertia_error"] = 40.0, (0.05, -0.02, 0.1), (3.0, 2.0, 1.0)
    before = data[["payload_mass", "payload_com_F", "payload_inertia"]].copy()
    assert init(record(data)) == 0
    once = data["torque_motor"].copy()
    assert init(record(data)) == 0
    assert np.all(data[["payload_mass", "payload_com_F", "payload_inertia"]] == before)
    assert unchanged(data["torque_motor"] - once)


def test_counterbalance_error_acts_on_axis_2_only() -> None:
    got = change(counterbalance_error=0.1)
    whole = inverse_dynamics(Q, QD, QDD) - inverse_dynamics(Q, QD, QDD, counterbalance_lever=0.0)
    np.testing.assert_allclose(got["torque_motor"][:, 1], 0.1 * whole[:, 1] / G[1], rtol=0.0, atol=ROUNDOFF * 100.0)
    np.testing.assert_allclose(got["torque_gear"][:, 1], 0.1 * whole[:, 1], rtol=0.0, atol=ROUNDOFF * 1e5)
    assert unchanged(np.delete(got["torque_motor"], 1, axis=1), got["q_link"])


def test_rotor_inertia_error_does_not_go_through_the_gear() -> None:
    got = change(rotor_inertia_error=np.eye(6)[4] * 0.5)
    expected = 0.5 * KR300_DYNAMICS.rotor_inertia[4] * G[4] * QDD[:, 4]
    np.testing.assert_allclose(got["torque_motor"][:, 4], expected, rtol=0.0, atol=ROUNDOFF * 100.0)
    assert unchanged(got["torque_gear"], np.delete(got["torque_motor"], 4, axis=1))


def test_torque_constant_error_scales_what_is_measured() -> None:
    got = change(torque_constant_error=np.eye(6)[0] * 0.1)
    np.testing.assert_allclose(got["torque_motor"][:, 0], 0.1 * NOMINAL["torque_motor"][:, 0], rtol=0.0, atol=ROUNDOFF * 100.0)
    assert unchanged(got["torque_gear"], np.delete(got["torque_motor"], 0, axis=1))


def test_torque_ripple_goes_with_the_motor_angle() -> None:
    got = change(torque_ripple_cos=np.eye(6)[0] * 0.6, torque_ripple_sin=np.eye(6)[0] * -0.2)["torque_motor"]
    phase = 8.0 * G[0] * Q[:, 0]
    # the phase is some thousand radians
    np.testing.assert_allclose(got[:, 0], 0.6 * np.cos(phase) - 0.2 * np.sin(phase), rtol=0.0, atol=ROUNDOFF * 1e4)
    assert unchanged(np.delete(got, 0, axis=1))


def test_compliance_twists_the_link_back_under_its_load() -> None:
    got = change(joint_compliance=np.eye(6)[1] / 7.5e6)
    np.testing.assert_allclose(got["q_link"][:, 1], -NOMINAL["torque_gear"][:, 1] / 7.5e6, rtol=0.0, atol=ROUNDOFF * 10.0)
    assert unchanged(got["torque_motor"], np.delete(got["q_link"], 1, axis=1))


def test_friction_behind_the_spring_twists_it() -> None:
    friction = {"friction_viscous": np.eye(6)[0] * 2000.0, "joint_compliance": np.eye(6)[0] / 5e6}
    motor, link = run(plain=False, **friction), run(plain=False, **friction, friction_link_share=1.0)
    np.testing.assert_allclose((motor["q_link"] - link["q_link"])[:, 0], 2000.0 * QD[:, 0] / 5e6, rtol=0.0, atol=ROUNDOFF)
    assert unchanged(motor["torque_motor"] - link["torque_motor"])


def test_backlash_puts_the_link_on_the_side_of_its_load() -> None:
    got = change(backlash=3e-5)["q_link"]
    loaded = np.abs(NOMINAL["torque_gear"]) > 400.0
    np.testing.assert_allclose(got[loaded], -3e-5 * np.sign(NOMINAL["torque_gear"][loaded]), rtol=0.0, atol=ROUNDOFF)
    assert np.abs(got).max() <= 3e-5 * (1.0 + 1e-6)


def test_encoder_offset_shifts_the_link_only() -> None:
    got = change(encoder_offset=np.eye(6)[2] * 1e-3)
    np.testing.assert_allclose(got["q_link"][:, 2], 1e-3, rtol=1e3 * ROUNDOFF)
    assert unchanged(got["torque_motor"], got["torque_gear"], np.delete(got["q_link"], 2, axis=1))


@pytest.mark.parametrize("lag", [0.003, 0.004, 0.0101])
def test_lags_delay_their_output_and_no_other(lag: float) -> None:
    torque, encoder = change(torque_lag=lag), change(encoder_lag=lag)
    settled = slice(10, None)
    for got, name, kept in ((torque, "torque_motor", "q_link"), (encoder, "q_link", "torque_motor")):
        for i in range(6):
            expected = np.interp(T[:, 0] - lag, T[:, 0], NOMINAL[name][:, i])
            np.testing.assert_allclose((got[name] + NOMINAL[name])[settled, i], expected[settled], rtol=0.0, atol=ROUNDOFF * 1e3)
        assert unchanged(got[kept], got["torque_gear"])


def test_a_lag_looks_like_viscous_wind_up() -> None:
    # the trap of the real recordings: lag * speed against torque / stiffness; equal to second order in the lag
    late = change(encoder_lag=0.003)["q_link"]
    bound = 0.5 * 0.003**2 * np.abs(QDD).max() + discretisation(np.abs(QDD).max() / 8.0, H, 2)
    assert np.abs(late[10:] + 0.003 * QD[10:]).max() <= bound


# ------------------------------------------------------------------------------- numerics and parity


def test_plain_and_compiled_give_the_same_bits() -> None:
    everything = {n: 0.01 for n in EFFECTS if n not in ("joint_compliance", "backlash")} | {"joint_compliance": 2e-7, "backlash": 3e-5}
    for parameters in ({}, everything, everything | {"differentiate": True}):
        one, other = run(True, 120, **parameters), run(False, 120, **parameters)
        assert all(unchanged(one[n] - other[n]) for n in one)


# ------------------------------------------------------------------------------------------ errors


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"q": np.nan}, "an input is not finite"),
        ({"f_T_B": np.inf}, "an input is not finite"),
        ({"counterbalance_lever": 0.9}, "expected a lever shorter than the frame"),
        ({"payload_mass_error": -500.0}, "payload_mass_error -500.0 kg is negative; expected a sum of at least 0"),
        ({"torque_lag": 0.2, "h": 0.001}, "more than 62 steps of 0.001 s"),
    ],
)
def test_errors_say_what_is_wrong(changes: dict[str, float], text: str) -> None:
    init, step = MODEL.plain()
    data = MODEL.new()
    h = changes.pop("h", H)
    for name, value in changes.items():
        data[name] = value
    s = record(data)
    status = init(s) or step(s, 0.0, h)
    assert text in MODEL.message(status, s, 0.0)
