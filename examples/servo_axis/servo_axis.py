"""A servo axis in four components: program, controller, axis (motor, coupling, table) and the encoder on the table.

    J_m dw_m/dt = k_t i - tau - D w_m - (F + S exp(-(w_m / w_s)^2)) sgn(w_m)     motor
    J_l dw_l/dt = tau - F_l sgn(w_l)                                             table
    tau = k (q_m - q_l) + d (w_m - w_l)                                          coupling; k acts only beyond half of the play

The controller is a cascade: position P with speed feedforward, speed PI, and a current that is limited.
"""

from robomill.models.maths.elementary import exp, sin
from robomill.models.model.declaration import Model, Record, Variable, kernel

MOVES = 6
SUBSTEPS = 40
"""Parts of a communication step in which the axis is integrated: 25 us at 1 ms."""


@kernel
def _plan(s: Record, t: float) -> None:
    """Angle and speed at t: moves from target to target, each x^3 (10 - 15 x + 6 x^2), with a pause after each."""
    begin, start = 0.0, 0.0
    s.q_ref, s.w_ref = 0.0, 0.0
    for i in range(MOVES):
        duration, way = s.duration[i] / s.pace, s.target[i] * s.stroke - start
        x = min(max((t - begin) / duration, 0.0), 1.0)
        s.q_ref += way * x * x * x * (10.0 + x * (6.0 * x - 15.0))
        s.w_ref += way / duration * 30.0 * x * x * (1.0 - x) * (1.0 - x)
        begin += duration + s.pause
        start += way


def program_init(s: Record) -> int:
    """The plan at t = 0."""
    _plan(s, 0.0)
    return 0


def program_step(s: Record, t: float, h: float) -> int:
    """The plan at t + h."""
    _plan(s, t + h)
    return 0


PROGRAM = Model(
    "axis_program",
    "Planned motion: six moves with pauses",
    (
        Variable("q_ref", "output", "Planned angle", "rad", display_unit="deg", depends_on=()),
        Variable("w_ref", "output", "Planned speed", "rad/s", display_unit="rpm", depends_on=()),
        Variable("target", "parameter", "Where each move ends, in strokes", "1", (MOVES,), (1.0, 0.2, 0.3, 0.28, 0.7, 0.0)),
        Variable("duration", "parameter", "Time of each move at pace 1", "s", (MOVES,), (0.5, 0.6, 0.5, 0.4, 0.3, 0.7), 0.01),
        Variable("pause", "parameter", "Standstill after each move", "s", (), 0.1, 0.0),
        Variable("stroke", "parameter", "Length of the first move", "rad", (), 6.0, display_unit="deg"),
        Variable("pace", "parameter", "How many times as fast as planned", "1", (), 1.0, 0.05),
    ),
    program_init,
    program_step,
)


def controller_init(s: Record) -> int:
    """At rest, without current."""
    s.integral = 0.0
    s.current = 0.0
    return 0


def controller_step(s: Record, t: float, h: float) -> int:
    """The current for the next step, from what is measured at its beginning."""
    error = s.w_ref + s.position_gain * (s.q_ref - s.q_motor) - s.w_motor
    gain = s.speed_gain * (1.0 + s.speed_gain_error)
    wanted = gain * (error + s.integral + error * h / s.reset_time) / s.torque_constant
    s.current = min(max(wanted, -s.current_max), s.current_max)
    if s.current == wanted:  # at the limit the integral stands still
        s.integral += error * h / s.reset_time
    return 0


CONTROLLER = Model(
    "axis_controller",
    "Position P with speed feedforward, speed PI, limited current",
    (
        Variable("q_ref", "input", "Planned angle", "rad"),
        Variable("w_ref", "input", "Planned speed", "rad/s"),
        Variable("q_motor", "input", "Angle of the motor", "rad"),
        Variable("w_motor", "input", "Speed of the motor", "rad/s"),
        Variable("current", "output", "Current that is asked for", "A"),
        Variable("position_gain", "parameter", "Gain of the position loop", "1/s", (), 25.0, 0.0),
        Variable("speed_gain", "parameter", "Gain of the speed loop", "N.m.s/rad", (), 1.3, 0.0),
        Variable("reset_time", "parameter", "Reset time of the speed loop", "s", (), 0.03, 1e-4, display_unit="ms"),
        Variable("torque_constant", "parameter", "Torque constant that the controller reckons with", "N.m/A", (), 0.8, 1e-6),
        Variable("current_max", "parameter", "Limit of the current", "A", (), 12.0, 0.0),
        Variable("speed_gain_error", "parameter", "Effect: relative error of the speed gain", "1", (), 0.0, -0.9, 5.0, effect=True),
        Variable("integral", "state", "Integral part of the speed loop", "rad/s"),
    ),
    controller_init,
    controller_step,
)


@kernel
def _rubbed(w: float, change: float) -> float:
    """Speed that dry friction leaves of w [rad/s], when by itself it changes it by `change` in the same time: it holds what it can stop."""
    if abs(w) <= change:
        return 0.0
    return w - change if w > 0.0 else w + change


@kernel
def _coupling(s: Record) -> float:
    """Torque [N.m] from motor to table."""
    twist = s.q_motor - s.q_table
    half = 0.5 * s.backlash
    pressed = twist - min(max(twist, -half), half)
    damping = s.damping if pressed != 0.0 or half == 0.0 else 0.0
    return s.stiffness * (1.0 + s.stiffness_error) * pressed + damping * (s.w_motor - s.w_table)


def axis_init(s: Record) -> int:
    """At rest at angle 0."""
    s.q_motor = 0.0
    s.w_motor = 0.0
    s.q_table = 0.0
    s.w_table = 0.0
    s.flowing = 0.0
    return 0


def axis_step(s: Record, t: float, h: float) -> int:
    """From t to t + h, with the current held."""
    d = h / SUBSTEPS
    share = 1.0 - exp(-d / s.current_lag)
    inertia = s.table_inertia * (1.0 + s.inertia_error) + s.load_inertia
    for _ in range(SUBSTEPS):
        s.flowing += share * (s.current - s.flowing)
        drive = s.torque_constant * (1.0 + s.torque_constant_error) * s.flowing
        if s.cogging > 0.0:
            drive += s.cogging * sin(s.pole_pairs * s.q_motor + s.cogging_phase)
        between = _coupling(s)
        dry = s.coulomb
        if s.stribeck > 0.0:
            dry += s.stribeck * exp(-(s.w_motor / s.stribeck_speed) * (s.w_motor / s.stribeck_speed))
        s.w_motor += d / s.motor_inertia * (drive - between - s.viscous * s.w_motor)
        s.w_motor = _rubbed(s.w_motor, d / s.motor_inertia * dry)
        s.w_table = _rubbed(s.w_table + d / inertia * between, d / inertia * s.table_friction)
        s.q_motor += d * s.w_motor
        s.q_table += d * s.w_table
    return 0


def _effect(name: str, description: str, unit: str = "1", lowest: float = 0.0, highest: float = 10.0) -> Variable:
    return Variable(name, "parameter", f"Effect: {description}", unit, (), 0.0, lowest, highest, effect=True)


AXIS = Model(
    "axis_mechanics",
    "Motor, elastic coupling and table",
    (
        Variable("current", "input", "Current that is asked for", "A"),
        Variable("q_motor", "output", "Angle of the motor", "rad", display_unit="deg", depends_on=()),
        Variable("w_motor", "output", "Speed of the motor", "rad/s", display_unit="rpm", depends_on=()),
        Variable("q_table", "output", "Angle of the table", "rad", display_unit="deg", depends_on=()),
        Variable("motor_inertia", "parameter", "Inertia of the motor", "kg.m2", (), 5e-3, 1e-6),
        Variable("table_inertia", "parameter", "Inertia of the table", "kg.m2", (), 8e-3, 1e-6),
        Variable("load_inertia", "parameter", "Inertia of what is clamped on the table", "kg.m2", (), 0.0, 0.0),
        Variable("stiffness", "parameter", "Stiffness of the coupling", "N.m/rad", (), 600.0, 1e-3),
        Variable("damping", "parameter", "Damping of the coupling", "N.m.s/rad", (), 0.15, 0.0),
        Variable("torque_constant", "parameter", "Torque constant of the motor", "N.m/A", (), 0.8, 1e-6),
        Variable("current_lag", "parameter", "Time constant of the current loop", "s", (), 2e-4, 1e-6, display_unit="ms"),
        Variable("pole_pairs", "parameter", "Periods of the cogging in a turn", "1", (), 12.0, 1.0),
        Variable("stribeck_speed", "parameter", "Speed at which the Stribeck peak has fallen to 1/e", "rad/s", (), 0.5, 1e-3),
        Variable("cogging_phase", "parameter", "Phase of the cogging at angle 0", "rad", (), 0.0),
        _effect("coulomb", "dry friction of the motor's bearings", "N.m"),
        _effect("viscous", "viscous friction of the motor's bearings", "N.m.s/rad"),
        _effect("stribeck", "peak of the dry friction at low speed, above the dry friction", "N.m"),
        _effect("table_friction", "dry friction of the table's bearing", "N.m"),
        _effect("inertia_error", "relative error of the inertia of the table", lowest=-0.9),
        _effect("stiffness_error", "relative error of the stiffness of the coupling", lowest=-0.9),
        _effect("torque_constant_error", "relative error of the torque constant", lowest=-0.9),
        _effect("backlash", "play of the coupling", "rad"),
        _effect("cogging", "amplitude of the cogging torque", "N.m"),
        Variable("w_table", "state", "Speed of the table", "rad/s"),
        Variable("flowing", "state", "Current that flows", "A"),
    ),
    axis_init,
    axis_step,
)


@kernel
def _read(s: Record) -> None:
    s.shown = s.q_table * (1.0 + s.scale_error) + s.offset + s.eccentricity * sin(s.q_table + s.eccentricity_phase)


def encoder_init(s: Record) -> int:
    """What is shown at rest."""
    _read(s)
    return 0


def encoder_step(s: Record, t: float, h: float) -> int:
    """What is shown at t + h."""
    _read(s)
    return 0


ENCODER = Model(
    "table_encoder",
    "Encoder on the table",
    (
        Variable("q_table", "input", "Angle of the table", "rad"),
        Variable("shown", "output", "Angle of the table, as it is shown", "rad", display_unit="deg"),
        Variable("eccentricity_phase", "parameter", "Phase of the eccentricity at angle 0", "rad", (), 0.0),
        _effect("scale_error", "relative error of the scale", lowest=-0.5, highest=0.5),
        _effect("offset", "shown at angle 0", "rad", -3.2, 3.2),
        _effect("eccentricity", "amplitude of the error that comes once in a turn", "rad"),
    ),
    encoder_init,
    encoder_step,
)
