"""Component robot_compliance: where the tool tip of the loaded robot really is.

Haehn & Weigold 2020, Eqs. (1)-(9), on virtual joints (`models.robot.virtual_joints`), plus effects that the
paper's model lacks; each is a parameter that is zero by default. See docs/components/robot_compliance.md.
"""

from __future__ import annotations

import math

from robomill.models.maths.elementary import TWO_PI, exp, sincos
from robomill.models.maths.frames import matrix_to_quat, quat_multiply
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.robot.dynamics import DYNAMICS_VARIABLES, counterbalance_fits, counterbalance_torque
from robomill.models.robot.geometric_stiffness import GEOMETRIC_VARIABLES, follow_levers
from robomill.models.robot.kinematics import ROBOT_VARIABLES, SPINDLE_ACROSS
from robomill.models.robot.virtual_joints import (
    COMPLIANCE_VARIABLES,
    DRIVES,
    JOINTS,
    SENSOR,
    couple_drives,
    deflect,
    drive_moment,
    joint_angles,
    joint_frame,
    joint_moments,
    joint_stiffness,
    virtual_joints,
)

GRAVITY = 9.81
"""Acceleration of free fall [m/s2]."""
ANGLE_LIMIT = 0.05
"""Largest elastic angle [rad] of a virtual joint; ten times what the largest milling loads cause."""
ELEMENTS = 4
"""Play elements per drive in the hysteresis; thresholds 1/4, 3/4, 5/4, 7/4 of `hysteresis_torque`. As many friction elements."""
STUCK = 1.0 + 2.0 / 3.0 + 2.0 / 4.0 + 2.0 / 5.0
"""Stiffness of all friction elements while none slips, in that of the first; they slip at angles as 2 : 3 : 4 : 5."""
FAR = 1e300
"""An elastic angle that is not reached: no friction element is left to slip."""

# Three per cent of the rated torque of the gear, the zone in which lost motion is measured: 94 N.m for a cycloidal
# gear of the size of A1..A3 (3136 N.m rated, data sheet from memory); wrist scaled with its drive stiffness.
_HYSTERESIS_TORQUE = (94.0, 94.0, 94.0, 20.0, 18.0, 11.0)
# Largest torques of the 60 validation loads of Haehn & Weigold 2020 (750 N) on A1..A6, rounded.
_REFERENCE_TORQUE = (1560.0, 1300.0, 1140.0, 390.0, 410.0, 180.0)

_INPUTS = ("q_link", "f_T_B", "m_T_B", "f_turn_T_B", "m_turn_T_B")

VARIABLES = (
    Variable("q_link", "input", "Axis angles A1..A6 on the link side of the gears", "rad", (6,), display_unit="deg"),
    Variable("f_T_B", "input", "Force on the tool at T, in B", "N", (3,)),
    Variable("m_T_B", "input", "Moment on the tool about T, in B", "N.m", (3,)),
    Variable("f_turn_T_B", "input", "Part of f_T_B that changes within a turn of the spindle: too fast for the robot to follow", "N", (3,)),
    Variable("m_turn_T_B", "input", "Part of m_T_B that changes within a turn of the spindle", "N.m", (3,)),
    Variable("d_T_B", "output", "Displacement of T, actual minus rigid, in B", "m", (3,), display_unit="mm", depends_on=_INPUTS),
    Variable("theta_T_B", "output", "Rotation vector of T, actual against rigid, in B", "rad", (3,), depends_on=_INPUTS),
    Variable("p_BT_B", "output", "Actual position of T", "m", (3,), display_unit="mm", depends_on=_INPUTS),
    Variable("quat_BT", "output", "Actual orientation of T, unit quaternion (w, x, y, z), w >= 0", "1", (4,), depends_on=_INPUTS),
    *ROBOT_VARIABLES,
    *COMPLIANCE_VARIABLES,
    *(v for v in DYNAMICS_VARIABLES if v.name.startswith("counterbalance_")),
    Variable(
        "stiffness_error",
        "parameter",
        "Relative error of the drive stiffness k_A of A1..A6: the actual stiffness is (1 + this) times the table",
        "1",
        (6,),
        minimum=-0.8,
        maximum=2.0,
        effect=True,
    ),
    Variable(
        "stiffness_hardening",
        "parameter",
        "Relative growth of the drive stiffness of A1..A6 from no load to reference_torque, linear in |torque|",
        "1",
        (6,),
        minimum=0.0,
        maximum=2.0,
        effect=True,
    ),
    Variable(
        "stiffness_asymmetry",
        "parameter",
        "Tension/compression asymmetry of the drives of A1..A6: stiffness (1 + this) for positive and (1 - this) for negative torque",
        "1",
        (6,),
        minimum=-0.8,
        maximum=0.8,
        effect=True,
    ),
    Variable(
        "gear_hysteresis",
        "parameter",
        "Half width of the hysteresis loop (lost motion) of the gears of A1..A6 at zero torque",
        "rad",
        (6,),
        minimum=0.0,
        maximum=2e-3,
        effect=True,
    ),
    Variable(
        "gear_friction",
        "parameter",
        "Friction beside the drive springs of A1..A6 (Maxwell slip), all elements slipping: hysteresis by another law than gear_hysteresis",
        "N.m",
        (6,),
        minimum=0.0,
        maximum=500.0,
        effect=True,
    ),
    Variable(
        "tilt_compliance",
        "parameter",
        "Additional tilt compliance of links and bearings at A1..A6, about x and y of the axis frame",
        "rad/(N.m)",
        (6,),
        minimum=0.0,
        maximum=1e-5,
        effect=True,
    ),
    Variable(
        "base_compliance",
        "parameter",
        "Compliance of base and foundation along x, y, z of B",
        "m/N",
        (3,),
        minimum=0.0,
        maximum=2e-6,
        display_unit="um/N",
        effect=True,
    ),
    Variable(
        "tool_compliance",
        "parameter",
        "Additional compliance of tool and holder across the tool axis",
        "m/N",
        (),
        minimum=0.0,
        maximum=5e-6,
        display_unit="um/N",
        effect=True,
    ),
    Variable(
        "payload_error",
        "parameter",
        "Mass of the end effector beyond the one that the robot is set up for; its weight acts at p_FG_F",
        "kg",
        (),
        minimum=-100.0,
        maximum=200.0,
        effect=True,
    ),
    Variable(
        "counterbalance_error",
        "parameter",
        "Relative error of the torque of the counterbalance of A2: actual torque (1 + this) times the model",
        "1",
        (),
        minimum=-1.0,
        maximum=1.0,
        effect=True,
    ),
    Variable(
        "thermal_growth",
        "parameter",
        "Thermal growth of the distance from base to tool tip after full warm-up",
        "m",
        (),
        minimum=-2e-3,
        maximum=2e-3,
        display_unit="um",
        effect=True,
    ),
    Variable(
        "mode_compliance",
        "parameter",
        "Static compliance of a structural mode that the table lacks, along mode_direction",
        "m/N",
        (),
        minimum=0.0,
        maximum=1e-5,
        display_unit="um/N",
        effect=True,
    ),
    Variable("reference_torque", "parameter", "Torque that stiffness_hardening refers to, A1..A6", "N.m", (6,), _REFERENCE_TORQUE, 1.0),
    Variable("hysteresis_torque", "parameter", "Mean torque to cross the hysteresis loop, A1..A6", "N.m", (6,), _HYSTERESIS_TORQUE, 0.1),
    Variable(
        "friction_stiffness",
        "parameter",
        "Stiffness of the friction elements of gear_friction while none slips, relative to the drive spring k_A",
        "1",
        (),
        0.56,
        1e-3,
        100.0,
    ),
    Variable(
        "p_FG_F", "parameter", "Centre of gravity of the end effector from F, in F", "m", (3,), SPINDLE_ACROSS.p_FG_F, display_unit="mm"
    ),
    Variable("thermal_time_constant", "parameter", "Time constant of the warm-up", "s", (), 5400.0, 1.0, display_unit="min"),
    Variable("warm_up_time", "parameter", "Warm-up before t = 0, from the state of calibration", "s", (), 0.0, 0.0, display_unit="min"),
    Variable("mode_frequency", "parameter", "Undamped natural frequency of the structural mode", "Hz", (), 9.0, 0.1, 500.0),
    Variable("mode_damping", "parameter", "Damping ratio of the structural mode", "1", (), 0.02, 0.0, 0.999),
    Variable("mode_direction", "parameter", "Direction of the structural mode in B, normalised", "1", (3,), (0.0, 1.0, 0.0)),
    *GEOMETRIC_VARIABLES,
    Variable("f_slow", "state", "Force on the tool that the robot follows, in B", "N", (3,)),
    Variable("m_slow", "state", "Moment on the tool that the robot follows, in B", "N.m", (3,)),
    Variable("hysteresis_play", "state", "Torques that the play elements of the gears of A1..A6 hold", "N.m", (6, ELEMENTS)),
    Variable("friction_torque", "state", "Torques of the friction elements of A1..A6", "N.m", (6, ELEMENTS)),
    Variable("friction_angle", "state", "Elastic angles of the drives of A1..A6 that these belong to", "rad", (6,)),
    Variable("mode_deflection", "state", "Deflection of the structural mode", "m"),
    Variable("mode_velocity", "state", "Velocity of the structural mode", "m/s"),
    Variable("fault_frame", "state", "Frame (Fig. 1 of the paper) or axis that an error message names", "1", kind="integer"),
    Variable("fault_value", "state", "Value that an error message names"),
)

ERRORS = (
    "",
    "input {fault_frame} of (1: q_link, 2: f_T_B, 3: m_T_B, 4: f_turn_T_B, 5: m_turn_T_B) at t = {t} s is {fault_value}, "
    "expected a finite number of usual size (below 1e4 rad, 1e7 N, 1e7 N.m); check the component that feeds it",
    "stiffness in row {fault_frame} is {fault_value} N.m/rad, expected a positive number; set stiffness and sensor_stiffness_scale",
    "the stiffness effects of axis {fault_frame} make the drive stiffness {fault_value} times the table, expected a positive factor; "
    "choose stiffness_error > -1, stiffness_hardening >= 0, |stiffness_asymmetry| < 1",
    "the length of quat_FT is {fault_value}, expected 1 (unit quaternion w, x, y, z); normalise it",
    "mode_damping is {mode_damping} and mode_frequency {mode_frequency} Hz, mode_direction {mode_direction}; expected a damping ratio in "
    "[0, 1), a positive frequency and a direction that is not zero",
    "reference_torque {reference_torque} N.m, hysteresis_torque {hysteresis_torque} N.m, friction_stiffness {friction_stiffness} and "
    "thermal_time_constant {thermal_time_constant} s must all be positive",
    "the counterbalance cannot move: lever {counterbalance_lever} m, frame {counterbalance_frame_distance} m, "
    "area {counterbalance_area} m2, gas volume {counterbalance_volume} m3; "
    "expected a lever shorter than the frame and a volume above twice lever times area",
    "the step size is {fault_value} s, expected a positive one",
    "the virtual joint in frame {fault_frame} turns elastically by {fault_value} rad at t = {t} s, the model holds up to 0.05 rad; "
    "the load on the tool is f_T_B = {f_T_B} N, m_T_B = {m_T_B} N.m: check its size and whether the loop of force and deflection is stable",
    "the stiffness matrix K_q - K_g of the axes is indefinite at t = {t} s: with axis {fault_frame} a pivot is {fault_value} N.m/rad, "
    "expected a positive one; the load on the tool f_T_B = {f_T_B} N, m_T_B = {m_T_B} N.m folds the robot: check its size and the "
    "stiffness, or set geometric_stiffness = 0",
    "translation_compliance in row {fault_frame} is {fault_value} m/N, expected zero or a positive number; 0 = rigid",
)
_INPUT, _STIFFNESS, _EFFECTS, _QUATERNION, _MODE, _POSITIVE, _COUNTERBALANCE, STEP_STATUS, _ANGLE, _INDEFINITE, _TRANSLATION = range(1, 12)


@kernel
def check_inputs(s: Record) -> int:
    """Refuse what is not finite before the trigonometry sees it; put the load that the robot follows into s.f_slow, s.m_slow."""
    for i in range(6):
        if not abs(s.q_link[i]) < 1e4:
            s.fault_frame = 1
            s.fault_value = s.q_link[i]
            return _INPUT
    for i in range(3):
        if not abs(s.f_T_B[i]) < 1e7:
            s.fault_frame = 2
            s.fault_value = s.f_T_B[i]
            return _INPUT
        if not abs(s.m_T_B[i]) < 1e7:
            s.fault_frame = 3
            s.fault_value = s.m_T_B[i]
            return _INPUT
        if not abs(s.f_turn_T_B[i]) < 1e7:
            s.fault_frame = 4
            s.fault_value = s.f_turn_T_B[i]
            return _INPUT
        if not abs(s.m_turn_T_B[i]) < 1e7:
            s.fault_frame = 5
            s.fault_value = s.m_turn_T_B[i]
            return _INPUT
        s.f_slow[i] = s.f_T_B[i] - s.f_turn_T_B[i]
        s.m_slow[i] = s.m_T_B[i] - s.m_turn_T_B[i]
    return 0


@kernel
def check_parameters(s: Record) -> int:
    """Refuse parameters that the equations cannot take."""
    for j in range(JOINTS):
        for c in range(3):
            if not joint_stiffness(s, j, c) > 0.0:
                s.fault_frame = j + 1
                s.fault_value = joint_stiffness(s, j, c)
                return _STIFFNESS
            if not s.translation_compliance[j, c] >= 0.0:
                s.fault_frame = j + 1
                s.fault_value = s.translation_compliance[j, c]
                return _TRANSLATION
    for i in range(6):
        worst = (1.0 + s.stiffness_error[i]) * (1.0 - abs(s.stiffness_asymmetry[i]))
        if not (worst > 0.0 and s.stiffness_hardening[i] >= 0.0 and s.stiffness_error[i] > -1.0):
            s.fault_frame = i + 1
            s.fault_value = worst
            return _EFFECTS
        if not (s.reference_torque[i] > 0.0 and s.hysteresis_torque[i] > 0.0):
            return _POSITIVE
    if not (s.thermal_time_constant > 0.0 and s.friction_stiffness > 0.0):
        return _POSITIVE
    if not counterbalance_fits(s):
        return _COUNTERBALANCE
    length = 0.0
    for i in range(4):
        length += s.quat_FT[i] * s.quat_FT[i]
    if not abs(length - 1.0) < 1e-6:
        s.fault_value = math.sqrt(length)
        return _QUATERNION
    direction = 0.0
    for i in range(3):
        direction += s.mode_direction[i] * s.mode_direction[i]
    if not (s.mode_damping >= 0.0 and s.mode_damping < 1.0 and s.mode_frequency > 0.0 and direction > 0.0):
        return _MODE
    return 0


@kernel
def _mode_load(s: Record) -> float:
    """Component of the force along the unit vector of the structural mode [N]."""
    n0, n1, n2 = s.mode_direction[0], s.mode_direction[1], s.mode_direction[2]
    load: float = (n0 * s.f_slow[0] + n1 * s.f_slow[1] + n2 * s.f_slow[2]) / math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    return load


@kernel
def advance_mode(s: Record, h: float) -> None:
    """Structural mode y'' + 2 zeta w y' + w^2 y = w^2 c f over h [s], exact for a force that is constant over the step."""
    omega = TWO_PI * s.mode_frequency
    sigma = s.mode_damping * omega
    damped = omega * math.sqrt(1.0 - s.mode_damping * s.mode_damping)
    decay = exp(-sigma * h)
    sine, cosine = sincos(damped * h)
    rest = s.mode_compliance * _mode_load(s)
    x = s.mode_deflection - rest
    v = s.mode_velocity
    s.mode_deflection = rest + decay * ((cosine + sigma / damped * sine) * x + sine / damped * v)
    s.mode_velocity = decay * ((cosine - sigma / damped * sine) * v - omega * omega / damped * sine * x)


@kernel
def _hysteresis(s: Record, i: int, torque: float) -> float:
    """Lagging share -1..1 of the lost motion of axis i = 0..5 at the torque [N.m]; advances the play elements.

    Mean of saturated play operators, the torque-driven dual of Maxwell slip (Prandtl-Ishlinskii):
    rate-independent, passive, exact for any step over which the torque is monotonic.
    """
    share = 0.0
    for e in range(ELEMENTS):
        half_gap = (0.25 + 0.5 * e) * s.hysteresis_torque[i]
        play = max(torque - half_gap, min(torque + half_gap, s.hysteresis_play[i, e]))
        s.hysteresis_play[i, e] = play
        share += max(-1.0, min(1.0, play / half_gap))
    return share / ELEMENTS


@kernel
def _spring_and_friction(s: Record, i: int, torque: float, stiffness: float) -> float:
    """Elastic angle [rad] of axis i = 0..5 at the torque [N.m]; advances its friction elements.

    Maxwell slip beside the spring: torque = k gamma + sum_e f_e, |f_e| <= friction/4, each element a stiff spring that slips there.
    The angle goes from slip to slip until the torque is balanced: rate-independent, passive, exact for any step over which the
    torque is monotonic.
    """
    slip = s.gear_friction[i] / ELEMENTS
    first = s.friction_stiffness * joint_stiffness(s, DRIVES[i], 2) / STUCK
    rest = torque - stiffness * s.friction_angle[i]
    for e in range(ELEMENTS):
        rest -= s.friction_torque[i, e]
    direction = 1.0 if rest >= 0.0 else -1.0
    rest = abs(rest)
    balanced = False
    while not balanced:
        slope = stiffness
        way = FAR
        for e in range(ELEMENTS):
            left = slip - direction * s.friction_torque[i, e]
            if left > 0.0:
                slope += first * 2.0 / (2.0 + e)
                way = min(way, left / (first * 2.0 / (2.0 + e)))
        if rest <= slope * way:
            way = rest / slope
            balanced = True
        for e in range(ELEMENTS):
            left = slip - direction * s.friction_torque[i, e]
            if left / (first * 2.0 / (2.0 + e)) <= way:
                s.friction_torque[i, e] = direction * slip
            else:
                s.friction_torque[i, e] += direction * (first * 2.0 / (2.0 + e)) * way
        s.friction_angle[i] += direction * way
        rest -= slope * way
    angle: float = s.friction_angle[i]
    return angle


@kernel
def _gravity_moments(s: Record) -> None:
    """Add to s.joint_moment what wrong payload and wrong counterbalance do beyond the nominal robot [N.m]."""
    weight = s.payload_error * GRAVITY
    for j in range(SENSOR + 1):
        # weight (0, 0, -w) at G: r x f = (-ry w, rx w, 0). The springs in front of the sensor belong to the end effector.
        i = joint_frame(j)
        rx = -s.frame_p[i, 0]
        ry = -s.frame_p[i, 1]
        rx += s.link_p[5, 0] + s.link_R[5, 0, 0] * s.p_FG_F[0] + s.link_R[5, 0, 1] * s.p_FG_F[1] + s.link_R[5, 0, 2] * s.p_FG_F[2]
        ry += s.link_p[5, 1] + s.link_R[5, 1, 0] * s.p_FG_F[0] + s.link_R[5, 1, 1] * s.p_FG_F[1] + s.link_R[5, 1, 2] * s.p_FG_F[2]
        for c in range(3):
            s.joint_moment[j, c] += (s.frame_R[i, 1, c] * rx - s.frame_R[i, 0, c] * ry) * weight
    # the counterbalance pulls axis 2 against +A2
    s.joint_moment[1, 2] -= s.counterbalance_error * counterbalance_torque(s, s.q_link[1]) * s.axis_sign[1]


@kernel
def load_moments(s: Record) -> None:
    """Fill s.joint_moment [N.m] with what the load on the tool and wrong weights do to the virtual joints at s.q_link."""
    virtual_joints(s, s.q_link)
    joint_moments(s, s.f_slow, s.m_slow)
    _gravity_moments(s)


@kernel
def bend(s: Record) -> int:
    """Fill s.joint_angle [rad] from s.joint_moment, coupled axes not yet; advances the hysteresis. Returns a status."""
    joint_angles(s)
    for i in range(6):
        j = DRIVES[i]
        moment = drive_moment(s, i)
        torque = moment * s.axis_sign[i]
        factor = (1.0 + s.stiffness_error[i]) * (1.0 + s.stiffness_hardening[i] * (abs(torque) / s.reference_torque[i]))
        factor *= 1.0 + (s.stiffness_asymmetry[i] if torque >= 0.0 else -s.stiffness_asymmetry[i])
        lost = s.gear_hysteresis[i] * _hysteresis(s, i, torque)
        s.drive_stiffness[i] = joint_stiffness(s, j, 2) * factor
        if s.gear_friction[i] > 0.0:
            lost += _spring_and_friction(s, i, torque, s.drive_stiffness[i])
            s.joint_angle[j, 2] = lost * s.axis_sign[i]
        else:
            s.joint_angle[j, 2] = moment / s.drive_stiffness[i] + lost * s.axis_sign[i]
        s.joint_angle[j, 0] += s.tilt_compliance[i] * s.joint_moment[j, 0]
        s.joint_angle[j, 1] += s.tilt_compliance[i] * s.joint_moment[j, 1]
    if s.geometric_stiffness > 0.0:
        for i in range(6):
            s.drive_angle[i] = s.joint_angle[DRIVES[i], 2]
        indefinite = follow_levers(s, s.f_slow, s.m_slow)
        if indefinite != 0:
            s.fault_frame = indefinite
            s.fault_value = s.drive_matrix[indefinite - 1, indefinite - 1]
            return _INDEFINITE
        for i in range(6):
            s.joint_angle[DRIVES[i], 2] = s.drive_angle[i]
    return 0


@kernel
def place_tip(s: Record, time: float) -> int:
    """Outputs at `time` [s] from s.joint_angle and what is added at the tip: base, tool, structural mode, growth. Returns a status."""
    couple_drives(s)
    for j in range(JOINTS):
        for c in range(3):
            if not abs(s.joint_angle[j, c]) <= ANGLE_LIMIT:
                s.fault_frame = joint_frame(j) + 1
                s.fault_value = s.joint_angle[j, c]
                return _ANGLE
    deflect(s, s.d_T_B, s.theta_T_B)

    # linear additions at the tip: base, tool across its axis, structural mode, growth along the line from B to T
    along = 0.0
    direction = 0.0
    distance = 0.0
    for r in range(3):
        along += s.f_slow[r] * s.link_R[6, r, 0]
        direction += s.mode_direction[r] * s.mode_direction[r]
        distance += s.link_p[6, r] * s.link_p[6, r]
    mode = s.mode_deflection / math.sqrt(direction)
    growth = s.thermal_growth * (1.0 - exp(-(time + s.warm_up_time) / s.thermal_time_constant))
    growth = growth / math.sqrt(distance) if distance > 0.0 else 0.0
    for r in range(3):
        s.d_T_B[r] += (
            s.base_compliance[r] * s.f_slow[r]
            + s.tool_compliance * (s.f_slow[r] - along * s.link_R[6, r, 0])
            + mode * s.mode_direction[r]
            + growth * s.link_p[6, r]
        )
        s.p_BT_B[r] = s.link_p[6, r] + s.d_T_B[r]
    matrix_to_quat(s.link_R[6], s.quat_BT)
    quat_multiply(s.deflection_quat, s.quat_BT, s.quat_BT)
    if s.quat_BT[0] < 0.0:
        for r in range(4):
            s.quat_BT[r] = -s.quat_BT[r]
    return 0


@kernel
def _respond(s: Record, time: float) -> int:
    """Outputs at `time` [s] from inputs, parameters and states; advances the hysteresis to the present torques."""
    load_moments(s)
    status: int = bend(s)
    if status != 0:
        return status
    return int(place_tip(s, time))


@kernel
def rest(s: Record) -> None:
    """Gears without history, the structural mode at rest under the load."""
    for i in range(6):
        for e in range(ELEMENTS):
            s.hysteresis_play[i, e] = 0.0
            s.friction_torque[i, e] = 0.0
        s.friction_angle[i] = 0.0
    s.mode_deflection = s.mode_compliance * _mode_load(s)
    s.mode_velocity = 0.0


def init(s: Record) -> int:
    """Outputs at t = 0 for the present inputs: gears without history, the structural mode at rest under the load."""
    status: int = check_parameters(s)
    if status == 0:
        status = check_inputs(s)
    if status != 0:
        return status
    rest(s)
    return _respond(s, 0.0)


def step(s: Record, t: float, h: float) -> int:
    """Outputs at t + h [s] for inputs that were held over the step; any h > 0."""
    if not h > 0.0:
        s.fault_value = h
        return STEP_STATUS
    status: int = check_inputs(s)
    if status != 0:
        return status
    advance_mode(s, h)
    return _respond(s, t + h)


MODEL = Model(
    name="robot_compliance",
    description="Actual tool pose of a robot on elastic virtual joints under load (Haehn & Weigold 2020, Eqs. 1-9)",
    variables=VARIABLES,
    init=init,
    step=step,
    errors=ERRORS,
)
