"""Component inverse_dynamics: motor torques and link-side angles of a given motion of the robot.

    tau_gear  = M_b(q) qdd + C(q, qd) qd + g(q) + (1 + e_cb) tau_cb(q) - J^T w + share f      (axis side, through the gear)
    tau_axis  = tau_gear + (1 + e_J) J G^2 qdd + (1 - share) f                                (axis side, at the motor)
    tau_motor = (1 + e_k) (tau_axis / G + a cos(n G q) + b sin(n G q))                        (motor shaft, as measured)
    q_link    = q - C_g tau_gear - b_g sgn(tau_gear) + offset                                 (encoder behind the gear)
    f         = viscous qd + (coulomb + stribeck exp(-(qd/v_s)^2) + load |tau_b|) tanh(qd/v_0) + asymmetry tanh^2(qd/v_0)

Everything after the rigid bodies, the rotors and the counterbalance is an effect, off by default: the
nominal model is that of `models.robot.dynamics`. The motion is that of the motor encoders divided by the
gear ratios; speed and acceleration are inputs, or come from a filter on the angles alone.
Torque and link encoder can each lag behind the motor encoder (another clock, or a filter in the logger).
"""

from __future__ import annotations

import math

from robomill.models.maths.elementary import PI, sincos, tanh
from robomill.models.maths.filters import second_order_zoh
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.robot.dynamics import (
    DYNAMICS_VARIABLES,
    counterbalance_fits,
    counterbalance_torque,
    friction_torque,
    newton_euler,
    prepare_dynamics,
)
from robomill.models.robot.kinematics import ROBOT_VARIABLES, forward

PLACES = 64
"""Places of the delay line: a lag may be up to PLACES - 2 steps."""


@kernel
def prepare_with_errors(s: Record) -> int:
    """`prepare_dynamics` with the payload that the effects make of the nominal one. Returns 0, or 4 for a negative mass."""
    mass = s.payload_mass
    x, y, z = s.payload_com_F[0], s.payload_com_F[1], s.payload_com_F[2]
    if mass + s.payload_mass_error < 0.0:
        return 4
    if s.payload_mass_error != 0.0:
        s.payload_mass = mass + s.payload_mass_error
    for k in range(3):
        if s.payload_com_error[k] != 0.0:
            s.payload_com_F[k] += s.payload_com_error[k]
    xx, yy, zz = s.payload_inertia[0], s.payload_inertia[1], s.payload_inertia[2]
    for k in range(3):
        if s.payload_inertia_error[k] != 0.0:
            s.payload_inertia[k] += s.payload_inertia_error[k]
    prepare_dynamics(s)
    # the parameters are those that were set, also after a second call
    s.payload_mass = mass
    s.payload_com_F[0], s.payload_com_F[1], s.payload_com_F[2] = x, y, z
    s.payload_inertia[0], s.payload_inertia[1], s.payload_inertia[2] = xx, yy, zz
    return 0


@kernel
def torques(s: Record) -> None:
    """Set s.prompt [12]: motor torques [N m] and link angles [rad] without their lags; and s.torque_gear [N m, axis side].

    For the motion s.angle [rad], s.rate [rad/s], s.push [rad/s2].
    """
    forward(s, s.angle)
    newton_euler(s, s.rate, s.push, s.f_T_B, s.m_T_B, s.tau)
    balance = counterbalance_torque(s, s.angle[1])
    s.tau[1] += balance
    if s.counterbalance_error != 0.0:
        s.tau[1] += s.counterbalance_error * balance
    for i in range(6):
        rotor = s.rotor_inertia[i] * s.gear_ratio[i] * s.gear_ratio[i] * s.push[i]
        gear = s.tau[i]
        axis = gear + rotor
        if s.rotor_inertia_error[i] != 0.0:
            axis += s.rotor_inertia_error[i] * rotor
        friction = 0.0
        if s.friction_viscous[i] != 0.0 or s.friction_coulomb[i] != 0.0 or s.friction_stribeck[i] != 0.0 or s.friction_load[i] != 0.0:
            friction = friction_torque(
                s.rate[i],
                s.friction_viscous[i],
                s.friction_coulomb[i] + s.friction_load[i] * abs(gear),
                s.friction_stribeck[i],
                tanh(s.rate[i] / s.friction_smooth_speed[i]),
                s.stribeck_speed[i],
            )
        if s.friction_asymmetry[i] != 0.0:
            moving = tanh(s.rate[i] / s.friction_smooth_speed[i])
            friction += s.friction_asymmetry[i] * moving * moving
        if friction != 0.0:
            gear += s.friction_link_share * friction
            axis += friction
        motor = axis / s.gear_ratio[i]
        if s.torque_ripple_cos[i] != 0.0 or s.torque_ripple_sin[i] != 0.0:
            sine, cosine = sincos(s.torque_ripple_order[i] * s.gear_ratio[i] * s.angle[i])
            motor += s.torque_ripple_cos[i] * cosine + s.torque_ripple_sin[i] * sine
        if s.torque_constant_error[i] != 0.0:
            motor += s.torque_constant_error[i] * motor
        link = s.angle[i]
        if s.joint_compliance[i] != 0.0:
            link -= s.joint_compliance[i] * gear
        if s.backlash[i] != 0.0:
            link -= s.backlash[i] * tanh(gear / s.backlash_torque)
        if s.encoder_offset[i] != 0.0:
            link += s.encoder_offset[i]
        s.torque_gear[i] = gear
        s.prompt[i] = motor
        s.prompt[6 + i] = link


@kernel
def lagged(s: Record, channel: int, lag: float, h: float) -> float:
    """Value of `channel` (0..11) `lag` [s] ago, linear between the samples of step `h` [s]; the newest is at s.place."""
    if lag <= 0.0:
        return float(s.prompt[channel])
    whole = math.floor(lag / h)
    part = lag / h - whole
    newer = (int(s.place) + PLACES - whole) % PLACES
    older = (newer + PLACES - 1) % PLACES
    return float(s.line[newer, channel] + part * (s.line[older, channel] - s.line[newer, channel]))


@kernel
def finite(s: Record) -> bool:
    """Whether all inputs are finite numbers."""
    for i in range(6):
        if not abs(s.q[i]) < math.inf or not abs(s.qd[i]) < math.inf or not abs(s.qdd[i]) < math.inf:
            return False
        if i < 3 and not abs(s.f_T_B[i]) + abs(s.m_T_B[i]) < math.inf:
            return False
    return True


def init(s: Record) -> int:
    """Outputs of the motion at the inputs; before it, everything was as it is now."""
    if not finite(s):
        return 1
    if not counterbalance_fits(s):
        return 2
    status = prepare_with_errors(s)
    if status != 0:
        return status
    s.filter_step = 0.0
    s.place = 0
    for i in range(6):
        s.angle[i] = s.q[i]
        s.rate[i] = 0.0 if s.differentiate else s.qd[i]
        s.push[i] = 0.0 if s.differentiate else s.qdd[i]
    torques(s)
    for c in range(12):
        for k in range(PLACES):
            s.line[k, c] = s.prompt[c]
    for i in range(6):
        s.torque_motor[i] = s.prompt[i]
        s.q_link[i] = s.prompt[6 + i]
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Outputs for the motion at the inputs, which are those at t + h."""
    if not finite(s):
        return 1
    if max(s.torque_lag, s.encoder_lag) > (PLACES - 2) * h:
        s.failed_value = h
        return 3
    if s.differentiate:
        if h != s.filter_step:
            second_order_zoh(s.filter_frequency, s.filter_damping, h, s.phi, s.gamma)
            s.filter_step = h
        for i in range(6):
            # the state is the distance to the input, so that a robot at rest stays exactly at rest
            offset = s.angle[i] - s.q[i]
            rate = s.phi[2] * offset + s.phi[3] * s.rate[i]
            s.angle[i] = s.q[i] + (s.phi[0] * offset + s.phi[1] * s.rate[i])
            s.push[i] = (rate - s.rate[i]) / h
            s.rate[i] = rate
    else:
        for i in range(6):
            s.angle[i] = s.q[i]
            s.rate[i] = s.qd[i]
            s.push[i] = s.qdd[i]
    torques(s)
    s.place = (int(s.place) + 1) % PLACES
    for c in range(12):
        s.line[int(s.place), c] = s.prompt[c]
    for i in range(6):
        s.torque_motor[i] = lagged(s, i, s.torque_lag, h)
        s.q_link[i] = lagged(s, 6 + i, s.encoder_lag, h)
    return 0


def _effect(name: str, unit: str, minimum: float, maximum: float, description: str, shape: tuple[int, ...] = (6,)) -> Variable:
    """An effect, off at zero; one value per axis A1..A6 unless a shape is given."""
    return Variable(name, "parameter", f"Effect: {description}", unit, shape, 0.0, minimum, maximum, effect=True)


MODEL = Model(
    name="inverse_dynamics",
    description="Motor torques and link-side angles of a given motion",
    variables=(
        Variable("q", "input", "Axis angles, motor side", "rad", (6,), (0.0, -0.5 * PI, 0.5 * PI, 0.0, 0.0, 0.0)),
        Variable("qd", "input", "Axis speeds; not used with differentiate", "rad/s", (6,)),
        Variable("qdd", "input", "Axis accelerations; not used with differentiate", "rad/s2", (6,)),
        Variable("f_T_B", "input", "Process force on the tool at T in B", "N", (3,)),
        Variable("m_T_B", "input", "Process moment on the tool at T in B", "N.m", (3,)),
        Variable("torque_motor", "output", "Motor torques", "N.m", (6,)),
        Variable("torque_gear", "output", "Torques through the gears, axis side", "N.m", (6,)),
        Variable("q_link", "output", "Axis angles behind the gears", "rad", (6,)),
        Variable("differentiate", "parameter", "Speed and acceleration from q by the filter below", "1", kind="boolean"),
        Variable(
            "filter_frequency", "parameter", "Natural frequency of the differentiating filter", "rad/s", (), 2.0 * PI * 12.0, 1.0, 1e4
        ),
        Variable("filter_damping", "parameter", "Its damping ratio", "1", (), 0.7, 0.05, 10.0),
        Variable("friction_smooth_speed", "parameter", "Axis speed over which friction changes sign", "rad/s", (6,), 1e-3, 1e-6, 1.0),
        Variable("stribeck_speed", "parameter", "Axis speed at which the Stribeck part has fallen to 1/e", "rad/s", (6,), 0.02, 1e-6, 10.0),
        Variable("friction_link_share", "parameter", "Share of the friction behind the spring of the gear", "1", (), 0.0, 0.0, 1.0),
        Variable("torque_ripple_order", "parameter", "Periods of the torque ripple per motor turn", "1", (6,), 8.0, 0.0, 200.0),
        Variable("backlash_torque", "parameter", "Gear torque over which the gap is crossed", "N.m", (), 20.0, 1e-3, 1e4),
        _effect("payload_mass_error", "kg", -1000.0, 1000.0, "payload heavier than payload_mass", ()),
        _effect("payload_com_error", "m", -1.0, 1.0, "centre of gravity of the payload beside payload_com_F, in F", (3,)),
        _effect("payload_inertia_error", "kg.m2", -500.0, 500.0, "inertia of the payload beside payload_inertia: xx, yy, zz, in F", (3,)),
        _effect("counterbalance_error", "1", -1.0, 1.0, "relative error of the counterbalance torque", ()),
        _effect("rotor_inertia_error", "1", -1.0, 10.0, "relative error of the rotor inertia"),
        _effect("torque_constant_error", "1", -0.9, 2.0, "relative error of the measured motor torque"),
        _effect("friction_viscous", "N.m.s/rad", 0.0, 2e4, "viscous friction, axis side"),
        _effect("friction_coulomb", "N.m", 0.0, 5e3, "Coulomb friction, axis side"),
        _effect("friction_stribeck", "N.m", -5e3, 5e3, "breakaway torque beyond Coulomb friction, axis side"),
        _effect("friction_asymmetry", "N.m", -5e3, 5e3, "Coulomb friction more in positive, less in negative direction, axis side"),
        _effect("friction_load", "1", 0.0, 1.0, "Coulomb friction per torque through the gear"),
        _effect("torque_ripple_cos", "N.m", -50.0, 50.0, "cosine part of the motor torque ripple over the motor angle"),
        _effect("torque_ripple_sin", "N.m", -50.0, 50.0, "sine part of it"),
        _effect("joint_compliance", "rad/(N.m)", 0.0, 1e-4, "twist of the gear per torque through it, seen by q_link"),
        _effect("backlash", "rad", 0.0, 1e-2, "half gap of the gear, seen by q_link"),
        _effect("encoder_offset", "rad", -0.1, 0.1, "wrong zero of the encoder behind the gear"),
        _effect("torque_lag", "s", 0.0, 0.2, "time by which torque_motor is late (clock or filter of the log)", ()),
        _effect("encoder_lag", "s", 0.0, 0.2, "time by which q_link is late (clock or filter of the log)", ()),
        *ROBOT_VARIABLES,
        *DYNAMICS_VARIABLES,
        Variable("angle", "state", "Axis angles of the motion", "rad", (6,)),
        Variable("rate", "state", "Its speeds", "rad/s", (6,)),
        Variable("push", "state", "Its accelerations", "rad/s2", (6,)),
        Variable("tau", "state", "Scratch: torques of the rigid bodies", "N.m", (6,)),
        Variable("prompt", "state", "Motor torques and link angles without lag", "1", (12,)),
        Variable("line", "state", "The same of the last steps", "1", (PLACES, 12)),
        Variable("place", "state", "Newest place in it", "1", kind="integer"),
        Variable("phi", "state", "Transition matrix of the differentiating filter over one step", "1", (4,)),
        Variable("gamma", "state", "Its input matrix", "1", (2,)),
        Variable("filter_step", "state", "Step that they are for", "s"),
        Variable("failed_value", "state", "Value an error speaks of", "1"),
    ),
    init=init,
    step=step,
    errors=(
        "",
        "an input is not finite at {t} s: q {q}, qd {qd}, qdd {qdd}, f_T_B {f_T_B}, m_T_B {m_T_B}; check the component that feeds it",
        "the counterbalance cannot move: lever {counterbalance_lever} m, frame {counterbalance_frame_distance} m, "
        "area {counterbalance_area} m2, gas volume {counterbalance_volume} m3; "
        "expected a lever shorter than the frame and a volume above 2 * lever * area",
        "torque_lag {torque_lag} s or encoder_lag {encoder_lag} s is more than 62 steps of {failed_value} s; "
        "take a longer step or a shorter lag",
        "payload_mass {payload_mass} kg with payload_mass_error {payload_mass_error} kg is negative; expected a sum of at least 0",
    ),
)
