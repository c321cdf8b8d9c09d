"""Component deformation_compensation: position reference offset by what the process force deforms the robot (paper 003, sec. 5.3, Fig. 15).

Every cycle: the measured wrench F at T, free of weight and noise (`sensor_chain`), is turned into B; the stiffness model of six
drives (Eqs. 16-23) gives the deformation

    tau = J^T F,   delta = K_q^-1 tau,   X = J delta = K_x^-1 F,   K_x = J^-T K_q J^-1,

through a low-pass; its negative is the offset of the reference. X needs no inverse, so a singular pose is no exception. The
geometric term K_g is left out, as in the paper. The ports are those of `compensation_controller`, which it takes the place of by one
line of the system file; the offline force is no part of this method and is not looked at.
"""

from __future__ import annotations

import math

from robomill.models.components.compensation_controller import AXIS, CARTESIAN, OFF
from robomill.models.components.compensation_controller import MODEL as COMPLIANCE_COMPENSATION
from robomill.models.maths.elementary import exp
from robomill.models.maths.frames import mat_vec
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.robot.kinematics import ROBOT_VARIABLES, jacobian
from robomill.models.robot.virtual_joints import COMPLIANCE_VARIABLES, DRIVES

WRONG_MODE, INDEFINITE, WRONG_STEP, NOT_FINITE = 1, 2, 3, 4
_LARGEST = 1e7
"""Force [N] or moment [N.m] beyond which a measured value is none."""

_PORTS = tuple(v for v in COMPLIANCE_COMPENSATION.variables if v.causality in ("input", "output"))
_SHARED = ("mode", "projection", "use_moment", "least_feed", "limit_cartesian", "limit_axis", "stiffness_table_error")
"""Parameters that mean there what they mean here."""


@kernel
def _prepare(s: Record) -> int:
    """Check the parameters; set s.stiffness_used (6,) [N.m/rad]. Returns a status."""
    if s.mode < OFF or s.mode > AXIS:
        return WRONG_MODE
    for i in range(6):
        s.stiffness_used[i] = s.stiffness[DRIVES[i], 2] * (1.0 + s.stiffness_table_error[i])
        if not s.stiffness_used[i] > 0.0:
            s.fault_axis = i + 1
            s.fault_value = s.stiffness_used[i]
            return INDEFINITE
    return 0


@kernel
def _check_inputs(s: Record) -> int:
    """Refuse a wrench that is not finite."""
    for i in range(3):
        if not (abs(s.f_T_T[i]) < _LARGEST and abs(s.m_T_T[i]) < _LARGEST):
            return NOT_FINITE
    return 0


@kernel
def _deform(s: Record) -> None:
    """Set s.deformed (6,) [rad]: delta = K_q^-1 J^T F of the measured wrench; outputs f_used_B [N]."""
    jacobian(s, s.q_motor, s.J)
    mat_vec(s.link_R[6], s.f_T_T, s.f_used_B)
    mat_vec(s.link_R[6], s.m_T_T, s.m_used)
    for i in range(6):
        torque = 0.0
        for k in range(3):
            torque += s.J[k, i] * s.f_used_B[k]
            if s.use_moment != 0:
                torque += s.J[3 + k, i] * s.m_used[k]
        s.deformed[i] = torque / s.stiffness_used[i]


@kernel
def _follow_feed(s: Record) -> None:
    """Hold the direction of the feed in s.feed_direction; below `least_feed` the last one."""
    speed = math.sqrt(s.v_BT_B[0] * s.v_BT_B[0] + s.v_BT_B[1] * s.v_BT_B[1] + s.v_BT_B[2] * s.v_BT_B[2])
    if speed > 0.0 and speed >= s.least_feed:
        for i in range(3):
            s.feed_direction[i] = s.v_BT_B[i] / speed


@kernel
def _offset(s: Record) -> None:
    """Outputs d_T_B, r_B, r_v_B [m] and the offsets of the reference from s.smooth (6,) [rad]."""
    along = 0.0
    for k in range(3):
        s.d_T_B[k] = 0.0
        for i in range(6):
            s.d_T_B[k] += s.J[k, i] * s.smooth[i]
        s.r_B[k] = -s.d_T_B[k]
        along += s.r_B[k] * s.feed_direction[k]
    for k in range(3):
        # the feed belongs to the rate control; before the first motion its direction is zero and nothing is taken away
        s.r_v_B[k] = s.r_B[k] - (along * s.feed_direction[k] if s.projection != 0 else 0.0)
        limit = s.limit_cartesian[k]
        s.correction_B[k] = max(-limit, min(limit, s.r_v_B[k])) if s.mode == CARTESIAN else 0.0
    for i in range(6):
        limit = s.limit_axis[i]
        s.correction_q[i] = max(-limit, min(limit, -s.smooth[i])) if s.mode == AXIS else 0.0


def init(s: Record) -> int:
    """Steady state at t = 0 for the inputs there."""
    status = _prepare(s)
    if status == 0:
        status = _check_inputs(s)
    if status != 0:
        return status
    s.pilot_blend = 0.0
    for i in range(3):
        s.feed_direction[i] = 0.0
    _deform(s)
    for i in range(6):
        s.smooth[i] = s.deformed[i]
    _follow_feed(s)
    _offset(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Offset at t + h from the wrench, the axis angles and the feed; low-pass exact for a wrench held over h [s]."""
    if not h > 0.0:
        s.fault_value = h
        return WRONG_STEP
    status = _check_inputs(s)
    if status != 0:
        return status
    _deform(s)
    kept = 0.0
    if s.filter_time > 0.0:
        kept = exp(-h / s.filter_time)
    for i in range(6):
        s.smooth[i] = s.deformed[i] + kept * (s.smooth[i] - s.deformed[i])
    _follow_feed(s)
    _offset(s)
    return 0


VARIABLES = (
    *_PORTS,
    *(v for v in COMPLIANCE_COMPENSATION.variables if v.name in _SHARED),
    *(v for v in COMPLIANCE_VARIABLES if v.name == "stiffness"),
    Variable(
        "filter_time",
        "parameter",
        "Time constant of a first-order low-pass of the deformation, beside the filters of the sensor; 0 = none",
        "s",
        (),
        0.0,
        0.0,
        10.0,
        display_unit="ms",
    ),
    *ROBOT_VARIABLES,
    Variable("J", "state", "Scratch: Jacobian of T", "1", (6, 6)),
    Variable("m_used", "state", "Measured moment about T in B", "N.m", (3,)),
    Variable("stiffness_used", "state", "Stiffness of the drives of axes 1..6 as the controller believes it", "N.m/rad", (6,)),
    Variable("deformed", "state", "Elastic angles of the drives under the measured wrench", "rad", (6,)),
    Variable("smooth", "state", "The same after the low-pass", "rad", (6,)),
    Variable("feed_direction", "state", "Unit vector of the feed in B; zero before the first motion", "1", (3,)),
    Variable("fault_axis", "state", "Axis that an error message names", "1", kind="integer"),
    Variable("fault_value", "state", "Value that an error message names"),
)

MODEL = Model(
    "deformation_compensation",
    "Real-time deformation compensation: reference offset by K_x^-1 F (Pan & Zhang 2009, sec. 5.3)",
    VARIABLES,
    init,
    step,
    (
        "",
        "mode is {mode}, expected 0 (off), 1 (Cartesian) or 2 (axis-specific)",
        "the drive of axis {fault_axis} has a stiffness of {fault_value:g} N.m/rad, expected a positive one: K_x = J^-T K_q J^-1 would be "
        "indefinite and the offset would push the wrong way; check stiffness and stiffness_table_error (a negative value of an "
        "identification means that something else is missing in its model)",
        "the step size is {fault_value:g} s, expected a positive one",
        "at t = {t:g} s the measured wrench is f_T_T = {f_T_T} N, m_T_T = {m_T_T} N.m, expected finite numbers below 1e7; check the sensor",
    ),
)
