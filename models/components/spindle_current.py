"""Component spindle_current: the current of the spindle motor as force feedback in place of the force sensor (paper 003, secs. 4 and 4.5).

    T_m = T_cut + T_f(w) + J dw/dt,   T_f = T_c + c w,   i = T_m / k_T      the motor
    tau i_f' = i - i_f, then noise, resolution, range                      its analog output
    F = (k_T i_f - T_f(w)) / R                                              the "linear conversion (a gain and an offset)"

F is the tangential force at the edges of a cutter of radius R, which the rate control takes for the force of the process. The torque
says nothing of the force against the feed, nor of that along the axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from robomill.models.maths.elementary import exp
from robomill.models.maths.noise import normal_pair
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity


@dataclass(frozen=True)
class SpindleMotor:
    """Motor and current signal of a spindle, from a file in models/data/sensors."""

    torque_constant: float = field(metadata=quantity("N.m/A", 1e-6))
    coulomb_friction: float = field(metadata=quantity("N.m", 0.0))
    viscous_friction: float = field(metadata=quantity("N.m.s/rad", 0.0))
    rotor_inertia: float = field(metadata=quantity("kg.m2", 0.0))
    filter_time: float = field(metadata=quantity("s", 0.0))
    noise: float = field(metadata=quantity("A", 0.0))
    resolution: float = field(metadata=quantity("A", 0.0))
    range: float = field(metadata=quantity("A", 1e-3))


MOTOR = load(SpindleMotor, "sensors/spindle_current_5hp")
TURNING = 1e-6
"""Speed [rad/s] below which the spindle stands and its friction holds no torque."""
_BAD_PARAMETER, _NOT_FINITE, _BAD_STEP = 1, 2, 3
_LARGEST = 1e7
"""Torque [N.m] or speed [rad/s] beyond which a value is none."""


@kernel
def _friction(s: Record) -> float:
    """Friction torque [N.m] of the turning spindle, as the conversion knows it."""
    if abs(s.spindle_speed) < TURNING:
        return 0.0
    torque: float = math.copysign(s.coulomb_friction, s.spindle_speed) + s.viscous_friction * s.spindle_speed
    return torque


@kernel
def _motor_current(s: Record, acceleration: float) -> float:
    """Torque-forming current [A] at a spindle that gains `acceleration` [rad/s2]."""
    torque = s.spindle_torque + (1.0 + s.friction_error) * _friction(s) + s.rotor_inertia * acceleration
    current: float = torque / s.torque_constant
    return current


@kernel
def _show(s: Record, noise: float) -> None:
    """Outputs from s.smooth [A] and the `noise` [A] of this sample."""
    reading = (1.0 + s.current_gain_error) * s.smooth + s.current_offset + noise
    if s.resolution > 0.0:
        reading = s.resolution * math.floor(reading / s.resolution + 0.5)
    s.current = max(-s.range, min(s.range, reading))
    s.force = (s.torque_constant * s.current - _friction(s)) / s.cutter_radius


@kernel
def _check(s: Record) -> int:
    """Refuse inputs that are not finite."""
    if not (abs(s.spindle_torque) < _LARGEST and abs(s.spindle_speed) < _LARGEST):
        return _NOT_FINITE
    return 0


def init(s: Record) -> int:
    """State at t = 0: spindle at its speed for long, filter settled, no noise yet."""
    if not (s.torque_constant > 0.0 and s.cutter_radius > 0.0 and s.range > 0.0):
        return _BAD_PARAMETER
    status: int = _check(s)
    if status != 0:
        return status
    s.counter = 0
    s.speed_before = s.spindle_speed
    s.smooth = _motor_current(s, 0.0)
    _show(s, 0.0)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Current at t + h from torque and speed over h [s]; low-pass exact for a torque that is held."""
    if not h > 0.0:
        return _BAD_STEP
    status: int = _check(s)
    if status != 0:
        return status
    s.counter += 1
    current = _motor_current(s, (s.spindle_speed - s.speed_before) / h)
    s.speed_before = s.spindle_speed
    kept = 0.0
    if s.filter_time > 0.0:
        kept = exp(-h / s.filter_time)
    s.smooth = current + kept * (s.smooth - current)
    noise = 0.0
    if s.noise > 0.0:
        noise = s.noise * normal_pair(int(s.seed), int(s.counter), 0)[0]
    _show(s, noise)
    return 0


VARIABLES = (
    Variable("spindle_torque", "input", "Torque that the cut takes from the spindle", "N.m"),
    Variable("spindle_speed", "input", "Spindle speed", "rad/s", display_unit="rpm"),
    Variable("current", "output", "Current of the spindle motor as its analog output shows it", "A"),
    Variable("force", "output", "Tangential force at the edges that this current stands for", "N"),
    Variable("torque_constant", "parameter", "Torque per current", "N.m/A", (), MOTOR.torque_constant, 1e-6),
    Variable("coulomb_friction", "parameter", "Friction torque that does not depend on speed", "N.m", (), MOTOR.coulomb_friction, 0.0),
    Variable("viscous_friction", "parameter", "Friction torque per speed", "N.m.s/rad", (), MOTOR.viscous_friction, 0.0),
    Variable("rotor_inertia", "parameter", "Inertia of motor, spindle and cutter", "kg.m2", (), MOTOR.rotor_inertia, 0.0),
    Variable("cutter_radius", "parameter", "Radius at which the edges cut", "m", (), 37.5e-3, 1e-4, display_unit="mm"),
    Variable(
        "filter_time", "parameter", "Time constant of the analog output; 0 = none", "s", (), MOTOR.filter_time, 0.0, 10.0, display_unit="ms"
    ),
    Variable("noise", "parameter", "Standard deviation of the white noise of each sample", "A", (), MOTOR.noise, 0.0),
    Variable("resolution", "parameter", "Step of the reading; 0 = none", "A", (), MOTOR.resolution, 0.0),
    Variable("range", "parameter", "The reading is clipped there", "A", (), MOTOR.range, 1e-3),
    Variable("seed", "parameter", "Seed of the noise: another seed is another repeat", "1", (), 1, 0, 2147483647, "integer"),
    Variable("current_gain_error", "parameter", "Relative error of the gain of the signal", "1", (), 0.0, -0.9, 2.0, effect=True),
    Variable("current_offset", "parameter", "Offset of the signal", "A", (), 0.0, -20.0, 20.0, effect=True),
    Variable(
        "friction_error",
        "parameter",
        "Relative excess of the friction over the one that the conversion knows (cold spindle)",
        "1",
        (),
        0.0,
        -1.0,
        10.0,
        effect=True,
    ),
    Variable("counter", "state", "Samples since the start", "1", kind="integer"),
    Variable("speed_before", "state", "Spindle speed one sample ago", "rad/s"),
    Variable("smooth", "state", "Current behind the filter", "A"),
)

MODEL = Model(
    "spindle_current",
    "Spindle current as force feedback: motor, friction, filter, noise, conversion to a force (Pan & Zhang 2009, sec. 4)",
    VARIABLES,
    init,
    step,
    (
        "",
        "torque_constant {torque_constant} N.m/A, cutter_radius {cutter_radius} m and range {range} A must be positive; "
        "correct the parameter",
        "at t = {t} s spindle_torque is {spindle_torque} N.m and spindle_speed {spindle_speed} rad/s, expected finite numbers below 1e7; "
        "check the component that feeds it",
        "the step size must be positive",
    ),
)
