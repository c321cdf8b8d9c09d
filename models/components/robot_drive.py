"""Component robot_drive: planned motion, sensor corrections, backlash and motor torque of the robot.

    q_c     = q_plan + J(q_ref)^-1 [x_c; 0]                     motion the controller plans itself
    q       = q_c + x_q                                         with the axis-specific corrections
    q_motor = q + b dir(q_c)                                    backlash compensation
    q_link  = play(q_motor, b)                                  the gear has the gap 2 b

x_c and x_q are the corrections of the sensor interface (RSI) after limits, transport delay and the
closed position loop, a second-order system; the planned path runs on feed-forward without lag.
The controller knows the gap and the direction of the motion *it* plans, path and Cartesian
corrections, and cancels the gap for it. Axis-specific corrections go to the drives unchanged
(Haehn & Weigold 2020, section 3.3): where one reverses its axis, 2 b of it are lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from robomill.models.maths.elementary import PI, exp, sincos, tanh
from robomill.models.maths.filters import delay, delay_rest, second_order_zoh
from robomill.models.maths.frames import solve
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity
from robomill.models.robot.dynamics import (
    DYNAMICS_VARIABLES,
    KR300_DYNAMICS,
    axis_torque,
    counterbalance_fits,
    friction_torque,
    prepare_dynamics,
    presliding,
)
from robomill.models.robot.kinematics import ROBOT_VARIABLES, forward, jacobian

QUEUE = 64
"""Places of the transport queue: one more than the largest number of transport cycles."""
LAG_CAPACITY = 64
"""Places of the line that realises the dead time in `tracking_lag`: 0.2 s at 4 ms, and some for shorter cycles."""
CHANNELS = 9
"""Correction channels: x, y, z in B, then A1..A6."""
DIRECTION_THRESHOLD = 1e-11
"""Axis motion [rad] that counts as a reversal for the backlash compensation; a hundred times the roundoff of the path
(1e-13), far below an encoder count (1e-6). It bounds the error of the compensation. An axis that only calibrated numbers move, from a
pose where the nominal program leaves it at rest, goes by 1e-9 rad a step when it sets off: it is to reverse then, not a second later."""
GLITCH_THRESHOLD = 1e-6
"""Axis motion [rad] that counts as a reversal for the friction spike: about one encoder count."""
EULER = 2.718281828459045


@dataclass(frozen=True)
class RsiDrive:
    """Correction path of the robot controller."""

    rsi_cycle: float = field(metadata=quantity("s", 1e-4, 1.0))
    transport_cycles: float = field(metadata=quantity("1", 1.0, QUEUE - 1))
    loop_frequency: float = field(metadata=quantity("rad/s", 0.1))
    loop_damping: float = field(metadata=quantity("1", 0.05))
    poscorr_limit: float = field(metadata=quantity("m", 0.0))
    axiscorr_limit: float = field(metadata=quantity("rad", 0.0))


RSI_DRIVE = load(RsiDrive, "control/rsi_drive")


@kernel
def turning(q: float, direction: float, turn: float, threshold: float) -> tuple[float, float]:
    """Direction (+1 or -1) of a motion and its last extreme [rad], after the new position `q` [rad].

    The direction changes once the motion is more than `threshold` [rad] back from the extreme.
    """
    if (q - turn) * direction >= 0.0:
        return direction, q
    if abs(q - turn) > threshold:
        return -direction, q
    return direction, turn


@kernel
def map_displacement(s: Record, x_B: FloatArray) -> int:
    """Set s.solution[0..5] [rad] to the axis motion that moves T by `x_B` [3] m without turning it.

    J dq = [x_B; 0] with the Jacobian at the planned position `s.q_ref`. Near the wrist singularity
    (A4 and A6 in line) the orientation gives way, the position never does:
    minimise |J_w dq|^2 + lambda^2 |dq|^2 subject to J_v dq = x_B, with lambda fading in from zero
    where |sin A5| falls below 2.5 `singularity_damping`. Returns 0, or 4 if that has no solution: the arm
    itself is singular, or the wrist is and `singularity_damping` is zero.
    """
    jacobian(s, s.q_ref, s.J)
    cosine = 0.0
    for k in range(3):
        cosine += s.J[3 + k, 3] * s.J[3 + k, 5]
    fade = 1.0
    if s.singularity_damping > 0.0:
        fade = (1.0 - cosine * cosine) / (6.25 * s.singularity_damping * s.singularity_damping)
    unknowns = 6
    if fade >= 1.0:
        for i in range(6):
            for j in range(6):
                s.system[i, j] = s.J[i, j]
            s.right[i] = x_B[i] if i < 3 else 0.0
    else:
        # Lagrange: [J_w^T J_w + lambda^2 I, J_v^T; J_v, 0] [dq; mu] = [0; x_B]
        unknowns = 9
        damping = s.singularity_damping * s.singularity_damping * (1.0 - fade) * (1.0 - fade)
        for i in range(6):
            for j in range(6):
                total = damping if i == j else 0.0
                for k in range(3):
                    total += s.J[3 + k, i] * s.J[3 + k, j]
                s.system[i, j] = total
            s.right[i] = 0.0
        for k in range(3):
            for i in range(6):
                s.system[6 + k, i] = s.J[k, i]
                s.system[i, 6 + k] = s.J[k, i]
            for j in range(3):
                s.system[6 + k, 6 + j] = 0.0
            s.right[6 + k] = x_B[k]
    return 0 if solve(s.system, s.right, s.solution, unknowns) == 0 else 4


@kernel
def link_errors(s: Record) -> int:
    """Add to s.q_link what motor encoders do not see: transmission, offsets, link lengths. Returns 0 or a status."""
    for i in range(6):
        if s.transmission_error[i] != 0.0:
            phase = s.transmission_harmonic[i] * s.gear_ratio[i] * s.q_motor[i] + s.transmission_phase[i]
            s.q_link[i] += s.transmission_error[i] * sincos(phase)[0]
        if s.joint_offset[i] != 0.0:
            s.q_link[i] += s.joint_offset[i]
    if s.geometry_error[0] != 0.0 or s.geometry_error[1] != 0.0:
        # the tool is displaced along the link arm (x of frame 2) and along the forearm (z of frame 4);
        # the nominal kinematics downstream show that if the axes are moved accordingly
        forward(s, s.q_ref)
        for k in range(3):
            s.displacement_B[k] = s.geometry_error[0] * s.link_R[1, k, 0] + s.geometry_error[1] * s.link_R[3, k, 2]
        status = map_displacement(s, s.displacement_B)
        if status != 0:
            return status
        for i in range(6):
            s.q_link[i] += s.solution[i]
    return 0


@kernel
def check_reference(s: Record) -> int:
    """Status of the reference and the correction inputs: 0, 2 (not finite) or 5 (outside the axis limits)."""
    for i in range(6):
        if not abs(s.q_ref[i]) < math.inf or not abs(s.correction_q[i]) < math.inf:
            return 2
        if s.q_ref[i] < s.q_min[i] or s.q_ref[i] > s.q_max[i]:
            s.failed_axis = i + 1
            s.failed_value = s.q_ref[i]
            s.failed_low = s.q_min[i]
            s.failed_high = s.q_max[i]
            return 5
    for i in range(3):
        if not abs(s.correction_B[i]) < math.inf or not abs(s.f_T_B[i]) < math.inf or not abs(s.m_T_B[i]) < math.inf:
            return 2
    return 0


@kernel
def motor_torque(s: Record) -> None:
    """Set s.torque_motor [N m, motor shaft] for the commanded motion s.q, s.qd, s.qdd."""
    axis_torque(s, s.q, s.qd, s.qdd, s.f_T_B, s.m_T_B, s.tau)
    for i in range(6):
        if s.friction_viscous[i] != 0.0 or s.friction_coulomb[i] != 0.0 or s.friction_stribeck[i] != 0.0:
            side = s.friction_side[i] if s.friction_presliding[i] > 0.0 else tanh(s.qd[i] / s.friction_smooth_speed)
            s.tau[i] += friction_torque(
                s.qd[i], s.friction_viscous[i], s.friction_coulomb[i], s.friction_stribeck[i], side, s.stribeck_speed
            )
        s.torque_motor[i] = s.tau[i] / s.gear_ratio[i]


def init(s: Record) -> int:
    """Robot at rest at q_ref, no correction under way, gears engaged in positive direction, extra gaps centred."""
    status = check_reference(s)
    if status != 0:
        return status
    if not counterbalance_fits(s):
        return 6
    if s.transport_cycles < 1 or s.transport_cycles >= QUEUE:
        return 3
    if s.tracking_lag_dead_time * s.tracking_lag > (LAG_CAPACITY - 2) * s.rsi_cycle:
        return 7
    second_order_zoh(s.loop_frequency, s.loop_damping, s.rsi_cycle, s.phi, s.gamma)
    prepare_dynamics(s)
    s.queue_place = 0
    s.late_place = 0
    for c in range(CHANNELS):
        s.limited[c] = 0.0
        s.y[c] = 0.0
        s.yd[c] = 0.0
        for k in range(QUEUE):
            s.queue[k, c] = 0.0
    for i in range(6):
        q = s.q_ref[i]
        s.q_before[i] = q
        s.q_plan[i] = q
        delay_rest(s.late_line, LAG_CAPACITY, i, q)
        s.q_cartesian[i] = 0.0
        s.q[i] = q
        s.qd[i] = 0.0
        s.qdd[i] = 0.0
        s.direction[i] = 1.0
        s.turn[i] = q
        s.gap[i] = -s.half_gap[i]
        s.q_direction[i] = 1.0
        s.q_turn[i] = q
        s.spike[i] = 0.0
        s.spike_drive[i] = 0.0
        s.friction_side[i] = 0.0
        s.q_motor[i] = q + s.half_gap[i]
        s.q_link[i] = q
    status = link_errors(s)
    if status != 0:
        return status
    motor_torque(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """One RSI cycle: take the corrections in, move, take up the gaps, torque of the commanded motion."""
    if abs(h - s.rsi_cycle) > 1e-9 * s.rsi_cycle:
        s.failed_value = h
        return 1
    status = check_reference(s)
    if status != 0:
        return status

    # corrections: limits, transport, closed loop; the oldest place of the queue is read before it is overwritten
    place = int(s.queue_place)
    oldest = (place + QUEUE - int(s.transport_cycles)) % QUEUE
    mapped = False
    for c in range(CHANNELS):
        if c < 3:
            wanted, limit, slope = s.correction_B[c], s.poscorr_limit, s.poscorr_rate
        else:
            wanted, limit, slope = s.correction_q[c - 3], s.axiscorr_limit, s.axiscorr_rate
        wanted = min(max(wanted, -limit), limit)
        if slope > 0.0:
            wanted = min(max(wanted, s.limited[c] - slope * h), s.limited[c] + slope * h)
        s.limited[c] = wanted
        s.queue[place, c] = wanted
        u = s.queue[oldest, c]
        y = s.phi[0] * s.y[c] + s.phi[1] * s.yd[c] + s.gamma[0] * u
        s.yd[c] = s.phi[2] * s.y[c] + s.phi[3] * s.yd[c] + s.gamma[1] * u
        s.y[c] = y
        if c < 3 and y != 0.0:
            mapped = True
    s.queue_place = (place + 1) % QUEUE
    if mapped:
        status = map_displacement(s, s.y)
        if status != 0:
            return status
        for i in range(6):
            s.q_cartesian[i] = s.solution[i]
    else:
        for i in range(6):
            s.q_cartesian[i] = 0.0

    lag = 0.0
    dead = s.tracking_lag_dead_time * s.tracking_lag
    smooth = s.tracking_lag - dead
    if smooth > 0.0:
        lag = exp(-h / smooth)
    if dead > 0.0:
        s.late_place = (int(s.late_place) + 1) % LAG_CAPACITY
    fading = exp(-h / s.reversal_time)
    for i in range(6):
        reference = s.q_ref[i]
        if dead > 0.0:
            reference = delay(s.late_line, LAG_CAPACITY, int(s.late_place), dead / s.rsi_cycle, i, reference)
        if smooth > 0.0:
            # first-order lag, exact for a reference that runs straight between the samples
            behind = smooth * (reference - s.q_before[i]) / h
            s.q_plan[i] = reference - behind + lag * (s.q_plan[i] - s.q_before[i] + behind)
        else:
            s.q_plan[i] = reference
        s.q_before[i] = reference
        commanded = s.q_plan[i] + s.q_cartesian[i]
        q = commanded + s.y[3 + i]

        # torque sees the commanded motion, first differences over one cycle
        speed = (q - s.q[i]) / h
        s.qdd[i] = (speed - s.qd[i]) / h
        s.qd[i] = speed
        moved = q - s.q[i]
        s.q[i] = q
        rubbed = moved

        if s.reversal_friction[i] != 0.0:
            before = s.q_direction[i]
            s.q_direction[i], s.q_turn[i] = turning(q, s.q_direction[i], s.q_turn[i], GLITCH_THRESHOLD)
            spike_before = s.reversal_friction[i] * EULER * s.spike[i]
            s.spike[i] = fading * (s.spike[i] + h / s.reversal_time * s.spike_drive[i])
            s.spike_drive[i] = fading * s.spike_drive[i]
            if s.q_direction[i] != before:
                s.spike_drive[i] -= s.q_direction[i]
            spike = s.reversal_friction[i] * EULER * s.spike[i]
            q += spike
            moved += spike - spike_before

        # play, kept as the position of the link inside the gap, so that an engaged gear adds nothing at all
        before = s.direction[i]
        s.direction[i], s.turn[i] = turning(commanded, s.direction[i], s.turn[i], DIRECTION_THRESHOLD)
        half = s.half_gap[i] + s.backlash[i]
        gap = s.gap[i] - moved - s.half_gap[i] * (s.direction[i] - before)
        s.gap[i] = min(max(gap, -half), half)
        motor = q + s.half_gap[i] * s.direction[i]
        if s.friction_at_motor[i]:
            rubbed = motor - s.q_motor[i]
        if s.friction_presliding[i] > 0.0:
            s.friction_side[i] = presliding(s.friction_side[i], rubbed, s.friction_presliding[i])
        s.q_motor[i] = motor
        s.q_link[i] = q + (s.gap[i] + s.half_gap[i] * s.direction[i])
    status = link_errors(s)
    if status != 0:
        return status
    motor_torque(s)
    return 0


def _axes(name: str, unit: str, maximum: float, description: str) -> Variable:
    """An effect with one value per axis A1..A6, from 0 to `maximum`."""
    return Variable(name, "parameter", description, unit, (6,), 0.0, 0.0, maximum, effect=True)


MODEL = Model(
    name="robot_drive",
    description="Planned motion, RSI correction path, backlash and motor torque of a KUKA robot",
    variables=(
        Variable("q_ref", "input", "Axis angles of the planned path", "rad", (6,), (0.0, -0.5 * PI, 0.5 * PI, 0.0, 0.0, 0.0)),
        Variable("correction_B", "input", "Cartesian correction of T in B, total (POSCORR)", "m", (3,)),
        Variable("correction_q", "input", "Axis-specific correction of A1..A6, total (AXISCORR)", "rad", (6,)),
        Variable("f_T_B", "input", "Process force on the tool at T in B; for the motor torque only", "N", (3,)),
        Variable("m_T_B", "input", "Process moment on the tool at T in B; for the motor torque only", "N.m", (3,)),
        Variable("q_motor", "output", "Motor angles divided by the gear ratios", "rad", (6,), depends_on=("q_ref",)),
        Variable("q_link", "output", "Axis angles behind the gears", "rad", (6,), depends_on=("q_ref",)),
        Variable("torque_motor", "output", "Motor torques for the commanded motion", "N.m", (6,), depends_on=("q_ref", "f_T_B", "m_T_B")),
        Variable(
            "rsi_cycle",
            "parameter",
            "Cycle of the sensor interface = communication step",
            "s",
            (),
            RSI_DRIVE.rsi_cycle,
            1e-4,
            1.0,
            display_unit="ms",
        ),
        Variable(
            "transport_cycles",
            "parameter",
            "Cycles from sensor message to set point",
            "1",
            (),
            RSI_DRIVE.transport_cycles,
            1,
            QUEUE - 1,
            "integer",
        ),
        Variable(
            "loop_frequency",
            "parameter",
            "Natural frequency of the position loop for corrections",
            "rad/s",
            (),
            RSI_DRIVE.loop_frequency,
            0.1,
            1e3,
        ),
        Variable("loop_damping", "parameter", "Damping ratio of the position loop", "1", (), RSI_DRIVE.loop_damping, 0.05, 10.0),
        Variable(
            "poscorr_limit",
            "parameter",
            "Largest Cartesian correction per component",
            "m",
            (),
            RSI_DRIVE.poscorr_limit,
            0.0,
            0.1,
            display_unit="mm",
        ),
        Variable(
            "axiscorr_limit",
            "parameter",
            "Largest axis-specific correction",
            "rad",
            (),
            RSI_DRIVE.axiscorr_limit,
            0.0,
            1.0,
            display_unit="deg",
        ),
        Variable(
            "poscorr_rate",
            "parameter",
            "Largest rate of the Cartesian correction per component; 0: no limit",
            "m/s",
            (),
            0.0,
            0.0,
            display_unit="mm/s",
        ),
        Variable(
            "axiscorr_rate",
            "parameter",
            "Largest rate of the axis-specific correction; 0: no limit",
            "rad/s",
            (),
            0.0,
            0.0,
            display_unit="deg/s",
        ),
        Variable(
            "half_gap",
            "parameter",
            "Half of the backlash, known to the controller",
            "rad",
            (6,),
            KR300_DYNAMICS.backlash_half_gap,
            0.0,
            1e-2,
        ),
        Variable(
            "singularity_damping",
            "parameter",
            "Where |sin A5| < 2.5 times this, a Cartesian correction may turn the tool a little instead of racing A4 and A6; 0: off",
            "1",
            (),
            0.02,
            0.0,
            0.2,
        ),
        Variable("friction_smooth_speed", "parameter", "Axis speed over which friction changes sign", "rad/s", (), 1e-3, 1e-6, 1.0),
        Variable(
            "friction_presliding",
            "parameter",
            "Axis angle over which dry friction turns over after a reversal, and holds at rest; 0: it goes with the speed",
            "rad",
            (6,),
            0.0,
            0.0,
            1e-2,
        ),
        Variable(
            "friction_at_motor",
            "parameter",
            "Dry friction that holds at rest goes with the motor, through the gap of the gear, too; else with the axis",
            shape=(6,),
            kind="boolean",
        ),
        Variable("stribeck_speed", "parameter", "Axis speed at which the Stribeck part has fallen to 1/e", "rad/s", (), 0.02, 1e-6, 10.0),
        Variable(
            "reversal_time",
            "parameter",
            "Time from a reversal to the peak of the friction spike",
            "s",
            (),
            0.02,
            1e-3,
            1.0,
            display_unit="ms",
        ),
        Variable("transmission_harmonic", "parameter", "Periods of the transmission error per motor turn", "1", (6,), 1.0, 0.0, 100.0),
        Variable("transmission_phase", "parameter", "Phase of the transmission error at motor angle zero", "rad", (6,)),
        _axes("backlash", "rad", 1e-3, "Effect: half gap beyond the known one, compensated for no motion"),
        _axes("transmission_error", "rad", 1e-3, "Effect: amplitude of the periodic error of the gear at the link"),
        Variable(
            "joint_offset", "parameter", "Effect: wrong zero of the axis, added at the link", "rad", (6,), 0.0, -1e-2, 1e-2, effect=True
        ),
        Variable(
            "geometry_error",
            "parameter",
            "Effect: excess length of link arm and forearm, as the axis angles that displace T likewise",
            "m",
            (2,),
            0.0,
            -1e-2,
            1e-2,
            effect=True,
            display_unit="mm",
        ),
        Variable(
            "tracking_lag",
            "parameter",
            "Effect: time by which the planned path is followed late",
            "s",
            (),
            0.0,
            0.0,
            0.2,
            effect=True,
            display_unit="ms",
        ),
        Variable("tracking_lag_dead_time", "parameter", "Part of tracking_lag that is a dead time, not a lag", "1", (), 0.0, 0.0, 1.0),
        _axes("reversal_friction", "rad", 1e-3, "Effect: peak of the spike by which an axis stays behind after its reversal"),
        _axes("friction_viscous", "N.m.s/rad", 2e4, "Effect: viscous friction, axis side, in the motor torque"),
        _axes("friction_coulomb", "N.m", 5e3, "Effect: Coulomb friction, axis side, in the motor torque"),
        _axes("friction_stribeck", "N.m", 5e3, "Effect: breakaway torque beyond Coulomb friction, axis side, in the motor torque"),
        *ROBOT_VARIABLES,
        *DYNAMICS_VARIABLES,
        Variable("phi", "state", "Transition matrix of the position loop over one cycle", "1", (4,)),
        Variable("gamma", "state", "Input matrix of the position loop over one cycle", "1", (2,)),
        Variable("queue", "state", "Corrections on their way", "1", (QUEUE, CHANNELS)),
        Variable("queue_place", "state", "Next place of the queue to be written", "1", kind="integer"),
        Variable("limited", "state", "Corrections after the limits", "1", (CHANNELS,)),
        Variable("y", "state", "Corrections carried out", "1", (CHANNELS,)),
        Variable("yd", "state", "Their rates", "1", (CHANNELS,)),
        Variable("q_before", "state", "Reference of the last step", "rad", (6,)),
        Variable("late_line", "state", "References on their way through the dead time", "rad", (6, LAG_CAPACITY)),
        Variable("late_place", "state", "Where the last of them is", "1", kind="integer"),
        Variable("q_plan", "state", "Planned motion with the tracking lag", "rad", (6,)),
        Variable("q_cartesian", "state", "Cartesian correction in axis angles", "rad", (6,)),
        Variable("q", "state", "Commanded motion with all corrections", "rad", (6,)),
        Variable("qd", "state", "Its speed", "rad/s", (6,)),
        Variable("qdd", "state", "Its acceleration", "rad/s2", (6,)),
        Variable("direction", "state", "Direction of the motion the controller plans, for its backlash compensation", "1", (6,)),
        Variable("turn", "state", "Extreme of that motion since its last reversal", "rad", (6,)),
        Variable("gap", "state", "Link against motor inside the gap", "rad", (6,)),
        Variable("q_direction", "state", "Direction of the commanded motion, for the friction spike", "1", (6,)),
        Variable("q_turn", "state", "Extreme of that motion since its last reversal", "rad", (6,)),
        Variable("spike", "state", "Friction spike, 1/e at its peak", "1", (6,)),
        Variable("spike_drive", "state", "What feeds the friction spike", "1", (6,)),
        Variable("friction_side", "state", "Side to which dry friction acts, where it holds at rest", "1", (6,)),
        Variable("tau", "state", "Axis torques", "N.m", (6,)),
        Variable("displacement_B", "state", "Scratch: displacement of T", "m", (3,)),
        Variable("J", "state", "Scratch: Jacobian of T", "1", (6, 6)),
        Variable("system", "state", "Scratch: system of equations", "1", (9, 9)),
        Variable("right", "state", "Scratch: its right-hand side", "1", (9,)),
        Variable("solution", "state", "Scratch: its solution", "1", (9,)),
        Variable("failed_axis", "state", "Number of the axis an error speaks of", "1", kind="integer"),
        Variable("failed_value", "state", "Value an error speaks of", "1"),
        Variable("failed_low", "state", "Lower limit an error speaks of", "1"),
        Variable("failed_high", "state", "Upper limit an error speaks of", "1"),
    ),
    init=init,
    step=step,
    errors=(
        "",
        "step size {failed_value} s at {t} s; expected rsi_cycle = {rsi_cycle} s, because the transport delay is counted in cycles; "
        "set the step of the run or the parameter rsi_cycle",
        "an input is not finite at {t} s: q_ref {q_ref}, correction_B {correction_B}, correction_q {correction_q}, "
        "f_T_B {f_T_B}, m_T_B {m_T_B}; check the component that feeds it",
        "transport_cycles is {transport_cycles}; expected 1 to 63: a correction takes at least one cycle",
        "the arm is singular at q_ref {q_ref} rad ({t} s), a Cartesian displacement of T has no axis motion; "
        "keep away from the stretched arm and from T above axis 1, keep singularity_damping above zero, or use axis-specific corrections",
        "q_ref of A{failed_axis} is {failed_value} rad at {t} s; expected {failed_low} to {failed_high} rad, the limits of the robot; "
        "move the workpiece or change q_min, q_max",
        "the counterbalance cannot move: lever {counterbalance_lever} m, frame {counterbalance_frame_distance} m, "
        "area {counterbalance_area} m2, gas volume {counterbalance_volume} m3; "
        "expected a lever shorter than the frame and a volume above 2 * lever * area",
        "tracking_lag is {tracking_lag:g} s, a part of {tracking_lag_dead_time:g} of it dead time; the delay line holds "
        + str(LAG_CAPACITY - 2)
        + " cycles of rsi_cycle = {rsi_cycle:g} s; shorten the lag or the dead time",
    ),
)
