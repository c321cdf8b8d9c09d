"""Component compensation_controller: from the measured force to the correction sent to the robot.

Haehn & Weigold 2020, secs. 2.1-2.4, every cycle: the measured force, turned into B with the nominal
kinematics; the pilot force in its place where the two differ too much (sec. 2.3); the displacement it
causes according to the compliance model (Eqs. 1-9); its negative, projected normal to the feed
(Eqs. 10, 11); a PID per direction (mode 1) or, through the inverse kinematics, per axis (mode 2); limits.
The PID belongs to the robot-sensor interface of the robot (sec. 2.2) and acts on the correction signal:
there is no measured deviation that it could drive to zero. kp = 1, ki = kd = 0 passes the signal on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from robomill.models.maths.filters import delay, delay_rest, first_order
from robomill.models.maths.frames import mat_vec, quat_to_matrix, rotation_vector_to_quat
from robomill.models.maths.noise import uniform
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity
from robomill.models.robot.kinematics import ROBOT_VARIABLES, inverse
from robomill.models.robot.virtual_joints import (
    COMPLIANCE_VARIABLES,
    DRIVES,
    couple_drives,
    deflect,
    joint_angles,
    joint_moments,
    virtual_joints,
)

CHANNELS = 9
"""Corrections: x, y, z in B, then A1..A6."""
DELAY_CAPACITY = 130
"""Places of the line that realises `extra_delay`: 0.5 s at 4 ms, and two for the interpolation."""
OFF, CARTESIAN, AXIS = 0, 1, 2

WRONG_STEP, WRONG_MODE, WRONG_DELAY, OUT_OF_REACH, OUT_OF_LIMITS = 1, 2, 3, 4, 5


@dataclass(frozen=True)
class CompensationData:
    """Constants of the compensation, from a file in models/data/control."""

    sample_time: float = field(metadata=quantity("s", 1e-5, 1.0))
    pilot_threshold: float = field(metadata=quantity("N", 0.0))
    blend_time: float = field(metadata=quantity("s", 0.0))
    least_feed: float = field(metadata=quantity("m/s", 0.0))
    limit_cartesian: float = field(metadata=quantity("m", 0.0))
    limit_axis: float = field(metadata=quantity("rad", 0.0))


COMPENSATION = load(CompensationData, "control/compliance_compensation")


@kernel
def _prepare(s: Record) -> int:
    """Everything that follows from parameters alone. Returns a status."""
    if s.mode < OFF or s.mode > AXIS:
        return WRONG_MODE
    if s.extra_delay > (DELAY_CAPACITY - 2) * s.sample_time:
        return WRONG_DELAY
    s.blend_steps = max(1, math.floor(s.blend_time / s.sample_time + 0.5))
    s.turned = 0
    for i in range(3):
        if s.frame_error[i] != 0.0:
            s.turned = 1
    rotation_vector_to_quat(s.frame_error, s.frame_quat)
    quat_to_matrix(s.frame_quat, s.frame_turn)
    return 0


@kernel
def _measure(s: Record) -> None:
    """Set s.f_measured, s.m_measured: the measured wrench at T turned into B, N and N m; runs `virtual_joints`."""
    virtual_joints(s, s.q_motor)
    mat_vec(s.link_R[6], s.f_T_T, s.f_measured)
    mat_vec(s.link_R[6], s.m_T_T, s.m_measured)


@kernel
def _pilot(s: Record) -> None:
    """Advance the blend by one cycle: towards the pilot force while it differs too much from the measured one (sec. 2.3).

    Counted in whole cycles, so that the transition takes exactly blend_time.
    """
    square = 0.0
    for i in range(3):
        difference = s.f_pilot_B[i] - s.f_measured[i]
        square += difference * difference
    if s.pilot != 0 and square > s.pilot_threshold * s.pilot_threshold:
        if s.blend_count < s.blend_steps:
            s.blend_count += 1
    elif s.blend_count > 0:
        s.blend_count -= 1


@kernel
def _estimate(s: Record) -> None:
    """Outputs f_used_B [N], d_T_B, r_B, r_v_B [m] from the measured wrench and the blend."""
    s.pilot_blend = float(s.blend_count) / float(s.blend_steps)
    for i in range(3):
        s.f_used_B[i] = (1.0 - s.pilot_blend) * s.f_measured[i] + s.pilot_blend * s.f_pilot_B[i]
        # the pilot force acts at T: it has no moment there
        s.m_used[i] = (1.0 - s.pilot_blend) * s.m_measured[i] if s.use_moment != 0 else 0.0
    if s.dead_band > 0.0:
        magnitude = math.sqrt(s.f_used_B[0] * s.f_used_B[0] + s.f_used_B[1] * s.f_used_B[1] + s.f_used_B[2] * s.f_used_B[2])
        share = 0.0
        if magnitude > s.dead_band:
            share = 1.0 - s.dead_band / magnitude
        for i in range(3):
            s.f_used_B[i] *= share
            s.m_used[i] *= share
    joint_moments(s, s.f_used_B, s.m_used)
    joint_angles(s)
    for axis in range(6):
        if s.stiffness_table_error[axis] != 0.0:
            for c in range(3):
                s.joint_angle[DRIVES[axis], c] /= 1.0 + s.stiffness_table_error[axis]
    couple_drives(s)
    deflect(s, s.d_T_B, s.theta)
    speed = math.sqrt(s.v_BT_B[0] * s.v_BT_B[0] + s.v_BT_B[1] * s.v_BT_B[1] + s.v_BT_B[2] * s.v_BT_B[2])
    if speed > 0.0 and speed >= s.least_feed:
        for i in range(3):
            s.feed_direction[i] = s.v_BT_B[i] / speed
    along = 0.0
    if s.projection != 0:
        for i in range(3):
            along -= s.d_T_B[i] * s.feed_direction[i]
    for i in range(3):
        s.r_B[i] = -s.d_T_B[i]
        # Eq. (10); before the first motion the direction is zero and nothing is taken away
        s.r_v_B[i] = s.r_B[i] - along * s.feed_direction[i]


@kernel
def _errors(s: Record) -> int:
    """Set s.signal, what the PIDs act on: the correction in B [m] or in axis angles [rad]. Returns a status."""
    for i in range(CHANNELS):
        s.signal[i] = 0.0
    if s.mode == OFF:
        return 0
    for i in range(3):
        s.target[i] = s.r_v_B[i]
    if s.turned != 0:
        mat_vec(s.frame_turn, s.target, s.target)
    if s.mode == CARTESIAN:
        for i in range(3):
            s.signal[i] = s.target[i]
        return 0
    if s.target[0] == 0.0 and s.target[1] == 0.0 and s.target[2] == 0.0:
        return 0  # the inverse kinematics would return q_motor but for roundoff
    for i in range(3):
        s.target[i] += s.link_p[6, i]
    status = inverse(s, s.target, s.link_R[6], s.q_motor, s.q_target)
    if status == 1:
        return OUT_OF_REACH
    if status == 2:
        return OUT_OF_LIMITS
    for i in range(6):
        s.signal[3 + i] = s.q_target[i] - s.q_motor[i]
    return 0


@kernel
def _limited(value: float, last: float, limit: float, most: float) -> float:
    """`value` within +-limit and within `most` of `last`; most = 0 means any change."""
    value = max(-limit, min(limit, value))
    if most > 0.0:
        value = max(last - most, min(last + most, value))
    return value


@kernel
def _pid(s: Record, channel: int, kp: float, ki: float, kd: float, limit: float, most: float, h: float) -> None:
    """One cycle of the PID of a channel into s.command; the integral stands still while it would push into a limit.

    `limit` of the correction and `most`, its largest change per cycle (0 = any), m or rad; h = 0 at the start: P only.
    """
    error = s.signal[channel]
    fixed = kp * error
    if h > 0.0 and kd != 0.0:
        fixed += kd * (error - s.signal_last[channel]) / h
    integral = s.integral[channel] + ki * error * h
    wanted = fixed + integral
    given = _limited(wanted, s.command[channel], limit, most if h > 0.0 else 0.0)
    if (wanted - given) * ki * error > 0.0:
        integral = s.integral[channel]
        given = _limited(fixed + integral, s.command[channel], limit, most if h > 0.0 else 0.0)
    s.integral[channel] = integral
    s.signal_last[channel] = error
    s.command[channel] = given


@kernel
def _control(s: Record, h: float) -> None:
    """Set s.command [m, rad] from s.signal: PID, limits and rate limit of all channels in use."""
    share = 1.0
    if s.correction_limit != 0.0:
        share = 1.0 - s.correction_limit
    for i in range(3):
        if s.mode == CARTESIAN:
            _pid(s, i, s.kp[i], s.ki[i], s.kd[i], share * s.limit_cartesian[i], s.rate_cartesian * h, h)
    for i in range(6):
        if s.mode == AXIS:
            _pid(s, 3 + i, s.kp_axis[i], s.ki_axis[i], s.kd_axis[i], share * s.limit_axis[i], s.rate_axis * h, h)


@kernel
def _send(s: Record) -> None:
    """Outputs correction_B [m], correction_q [rad] from s.sent."""
    for i in range(3):
        s.correction_B[i] = s.sent[i]
    for i in range(6):
        s.correction_q[i] = s.sent[3 + i]


def init(s: Record) -> int:
    """Steady state at t = 0 for the inputs there: measured force believed, integrators empty, nothing on its way."""
    status = _prepare(s)
    if status != 0:
        return status
    s.counter = 0
    s.line_position = 0
    s.blend_count = 0
    s.step_size = s.sample_time
    for i in range(3):
        s.feed_direction[i] = 0.0
    for i in range(CHANNELS):
        s.integral[i] = 0.0
        s.signal_last[i] = 0.0
        s.command[i] = 0.0
    _measure(s)
    _estimate(s)
    status = _errors(s)
    if status != 0:
        return status
    _control(s, 0.0)
    for i in range(CHANNELS):
        s.sent[i] = s.command[i]
        delay_rest(s.line, DELAY_CAPACITY, i, s.command[i])
        s.delay_input[i] = s.command[i]
        s.delay_output[i] = s.command[i]
    _send(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """One cycle: correction at t + h from the measured force, the pilot force, the axis angles and the feed."""
    s.step_size = h
    if abs(h - s.sample_time) > 1e-9:
        return WRONG_STEP
    s.counter += 1
    _measure(s)
    _pilot(s)
    _estimate(s)
    status = _errors(s)
    if status != 0:
        return status
    _control(s, h)
    s.line_position += 1
    if s.line_position >= DELAY_CAPACITY:
        s.line_position = 0
    lost = s.lost_packets > 0.0 and uniform(int(s.seed), int(s.counter), 0) < s.lost_packets
    smooth = s.extra_delay_first_order * s.extra_delay
    samples = (s.extra_delay - smooth) / s.sample_time
    # 0.1 / 0.004 is 25.000000000000004: whole samples are meant
    if abs(samples - math.floor(samples + 0.5)) < 1e-9:
        samples = float(math.floor(samples + 0.5))
    for i in range(CHANNELS):
        late = s.command[i]
        if s.extra_delay > 0.0:
            late = delay(s.line, DELAY_CAPACITY, int(s.line_position), samples, i, late)
        if smooth > 0.0:
            entered = late
            late = first_order(s.delay_output[i], s.delay_input[i], entered, smooth, h)
            s.delay_input[i] = entered
            s.delay_output[i] = late
        if not lost:
            s.sent[i] = late
    _send(s)
    return 0


_HOME = np.deg2rad([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
_FORCES = ("f_T_T", "f_pilot_B", "q_motor")
_WRENCHES = ("f_T_T", "m_T_T", "f_pilot_B", "q_motor")

VARIABLES = (
    Variable("f_T_T", "input", "Measured force on the tool at T, in T", "N", (3,)),
    Variable("m_T_T", "input", "Measured moment on the tool about T, in T", "N.m", (3,)),
    Variable("f_pilot_B", "input", "Force on the tool estimated offline, in B, by the lead time ahead of the path", "N", (3,)),
    Variable("q_motor", "input", "Axis angles A1..A6 of the motors", "rad", (6,), _HOME, display_unit="deg"),
    Variable("v_BT_B", "input", "Commanded feed velocity of T in B", "m/s", (3,), display_unit="mm/s"),
    Variable("correction_B", "output", "Cartesian correction of T in B, sent to the robot", "m", (3,), display_unit="mm"),
    Variable("correction_q", "output", "Axis-specific correction of A1..A6, sent to the robot", "rad", (6,), display_unit="deg"),
    Variable(
        "d_T_B", "output", "Displacement of T in B that the compliance model gives", "m", (3,), display_unit="mm", depends_on=_WRENCHES
    ),
    Variable("r_B", "output", "Correction of T in B before the projection", "m", (3,), display_unit="mm", depends_on=_WRENCHES),
    Variable("r_v_B", "output", "Correction of T in B after the projection normal to the feed", "m", (3,), display_unit="mm"),
    Variable("f_used_B", "output", "Force on the tool in B on which the correction rests", "N", (3,), depends_on=_FORCES),
    Variable("pilot_blend", "output", "Share of the pilot force in it", "1", (), 0.0, 0.0, 1.0, depends_on=_FORCES),
    Variable("mode", "parameter", "Compensation: 0 off, 1 Cartesian, 2 axis-specific", "1", (), CARTESIAN, 0, 2, "integer"),
    Variable("pilot", "parameter", "Pilot control (sec. 2.3) on", "1", kind="boolean"),
    Variable("projection", "parameter", "Projection normal to the feed (Eq. 10) on", "1", (), 1, kind="boolean"),
    Variable(
        "use_moment", "parameter", "Measured moment enters the compliance model (the paper's Eq. 6 has none)", "1", (), 1, kind="boolean"
    ),
    Variable(
        "sample_time", "parameter", "Cycle; must be the communication step", "s", (), COMPENSATION.sample_time, 1e-5, 1.0, display_unit="ms"
    ),
    Variable(
        "pilot_threshold",
        "parameter",
        "Difference of pilot and measured force beyond which the pilot force is believed",
        "N",
        (),
        COMPENSATION.pilot_threshold,
        0.0,
    ),
    Variable(
        "blend_time",
        "parameter",
        "Duration of the transition to the pilot force and back",
        "s",
        (),
        COMPENSATION.blend_time,
        0.0,
        10.0,
        display_unit="ms",
    ),
    Variable(
        "least_feed",
        "parameter",
        "Feed below which the last feed direction is held",
        "m/s",
        (),
        COMPENSATION.least_feed,
        0.0,
        display_unit="mm/s",
    ),
    Variable("kp", "parameter", "Proportional gain on the correction along x, y, z of B", "1", (3,), 1.0, -100.0, 100.0),
    Variable("ki", "parameter", "Integral gain along x, y, z of B", "1/s", (3,), 0.0),
    Variable("kd", "parameter", "Derivative gain along x, y, z of B", "s", (3,), 0.0),
    Variable("kp_axis", "parameter", "Proportional gain on the correction of A1..A6", "1", (6,), 1.0, -100.0, 100.0),
    Variable("ki_axis", "parameter", "Integral gain on A1..A6", "1/s", (6,), 0.0),
    Variable("kd_axis", "parameter", "Derivative gain on A1..A6", "s", (6,), 0.0),
    Variable(
        "limit_cartesian",
        "parameter",
        "Largest correction along x, y, z of B (POSCORR)",
        "m",
        (3,),
        COMPENSATION.limit_cartesian,
        0.0,
        display_unit="mm",
    ),
    Variable(
        "limit_axis", "parameter", "Largest correction of A1..A6 (AXISCORR)", "rad", (6,), COMPENSATION.limit_axis, 0.0, display_unit="deg"
    ),
    Variable("rate_cartesian", "parameter", "Largest speed of the Cartesian correction; 0 = any", "m/s", (), 0.0, 0.0, display_unit="mm/s"),
    Variable(
        "rate_axis", "parameter", "Largest speed of the axis-specific correction; 0 = any", "rad/s", (), 0.0, 0.0, display_unit="deg/s"
    ),
    Variable("seed", "parameter", "Seed of lost_packets", "1", (), 1, 0, 2147483647, "integer"),
    # effects
    Variable("extra_delay", "parameter", "Additional dead time of the corrections", "s", (), 0.0, 0.0, 0.5, display_unit="ms", effect=True),
    Variable(
        "extra_delay_first_order", "parameter", "Part of extra_delay that is a first-order lag, not a dead time", "1", (), 0.0, 0.0, 1.0
    ),
    Variable("dead_band", "parameter", "Dead zone of the force: its magnitude counts from here on", "N", (), 0.0, 0.0, 1000.0, effect=True),
    Variable(
        "correction_limit",
        "parameter",
        "Part by which the limits of the correction are lower than nominal",
        "1",
        (),
        0.0,
        0.0,
        1.0,
        effect=True,
    ),
    Variable(
        "stiffness_table_error",
        "parameter",
        "Relative error of the rows of axes 1..6 in the controller's stiffness table",
        "1",
        (6,),
        0.0,
        -0.9,
        9.0,
        effect=True,
    ),
    Variable(
        "frame_error",
        "parameter",
        "Rotation vector in B by which the frame of the corrections is turned",
        "rad",
        (3,),
        0.0,
        -1.0,
        1.0,
        display_unit="deg",
        effect=True,
    ),
    Variable(
        "lost_packets", "parameter", "Probability that a correction is lost and the last one held", "1", (), 0.0, 0.0, 1.0, effect=True
    ),
    # states
    *ROBOT_VARIABLES,
    *COMPLIANCE_VARIABLES,
    Variable("counter", "state", "Cycles since the start", "1", kind="integer"),
    Variable("step_size", "state", "Step size of the last call", "s"),
    Variable("blend_steps", "state", "Cycles of the transition to the pilot force", "1", (), 1, kind="integer"),
    Variable("blend_count", "state", "Cycles done of it", "1", kind="integer"),
    Variable("f_measured", "state", "Measured force in B", "N", (3,)),
    Variable("m_measured", "state", "Measured moment about T in B", "N.m", (3,)),
    Variable("m_used", "state", "Moment about T in B on which the correction rests", "N.m", (3,)),
    Variable("theta", "state", "Estimated rotation vector of T in B", "rad", (3,)),
    Variable("feed_direction", "state", "Unit vector of the feed in B; zero before the first motion", "1", (3,)),
    Variable("turned", "state", "Whether frame_error is not zero", "1", kind="boolean"),
    Variable("frame_quat", "state", "Rotation of the frame of the corrections as quaternion", "1", (4,)),
    Variable("frame_turn", "state", "The same as matrix", "1", (3, 3)),
    Variable("target", "state", "Scratch: correction, corrected position", "m", (3,)),
    Variable("q_target", "state", "Axis angles of the corrected pose", "rad", (6,)),
    Variable("signal", "state", "Correction signal of the PIDs, m and rad", "1", (CHANNELS,)),
    Variable("signal_last", "state", "The same one cycle ago", "1", (CHANNELS,)),
    Variable("integral", "state", "Integral parts of the PIDs, m and rad", "1", (CHANNELS,)),
    Variable("command", "state", "Corrections after PID and limits, m and rad", "1", (CHANNELS,)),
    Variable("sent", "state", "Corrections as sent, m and rad", "1", (CHANNELS,)),
    Variable("line", "state", "Delay line of extra_delay", "1", (CHANNELS, DELAY_CAPACITY)),
    Variable("delay_input", "state", "Input of the first-order part of extra_delay", "1", (CHANNELS,)),
    Variable("delay_output", "state", "Output of it", "1", (CHANNELS,)),
    Variable("line_position", "state", "Where the last correction is", "1", kind="integer"),
)

MODEL = Model(
    "compensation_controller",
    "Compliance compensation: pilot blend, compliance model, projection, PID, limits (Haehn & Weigold 2020, secs. 2.1-2.4)",
    VARIABLES,
    init,
    step,
    (
        "",
        "the step size is {step_size:g} s at t = {t:g} s, but the controller runs every sample_time = {sample_time:g} s; "
        "set the parameter sample_time to the communication step",
        "mode is {mode}, expected 0 (off), 1 (Cartesian) or 2 (axis-specific)",
        "extra_delay is {extra_delay:g} s, the delay line holds " + str(DELAY_CAPACITY - 2) + " cycles of sample_time = {sample_time:g} s; "
        "shorten the delay or take a longer cycle",
        "at t = {t:g} s the corrected position ({target[0]:.4g}, {target[1]:.4g}, {target[2]:.4g}) m of the tool tip is out of reach; "
        "move the workpiece nearer to the robot, or use mode 1",
        "at t = {t:g} s the corrected position ({target[0]:.4g}, {target[1]:.4g}, {target[2]:.4g}) m of the tool tip needs axis angles "
        "outside q_min and q_max; keep the path away from the axis limits, or use mode 1",
    ),
)
