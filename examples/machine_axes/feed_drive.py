"""A feed drive of a machine tool as its motor current shows it: acceleration and friction of the slide on a given motion.

    i = i_a a / a_r + i_v v / v_r + i_c tanh(v / v_0) + i_0

i_a: current for the rated acceleration a_r, i_v: viscous friction at the rated speed v_r, i_c: Coulomb friction, i_0: gravity or
the zero of the sensor. Friction is an effect, off by default: the nominal drive is the mass alone.
"""

from __future__ import annotations

import math

from robomill.models.maths.elementary import tanh
from robomill.models.model.declaration import Model, Record, Variable, kernel


@kernel
def _current(s: Record) -> int:
    """Current [A] at the motion that the inputs say; status 1 where they are not finite."""
    if not abs(s.speed) + abs(s.acceleration) < math.inf:
        return 1
    s.current = (
        s.acceleration_current * s.acceleration / s.rated_acceleration
        + s.viscous_friction * s.speed / s.rated_speed
        + s.coulomb_friction * tanh(s.speed / s.smooth_speed)
        + s.current_offset
    )
    return 0


def init(s: Record) -> int:
    """Current at t = 0."""
    return int(_current(s))


def step(s: Record, t: float, h: float) -> int:
    """Current for the motion at the inputs, which is that at t + h."""
    return int(_current(s))


def _effect(name: str, description: str, minimum: float = -100.0) -> Variable:
    return Variable(name, "parameter", f"Effect: {description}", "A", (), 0.0, minimum, 100.0, effect=True)


MODEL = Model(
    name="feed_drive",
    description="Motor current of a feed drive on a given motion",
    variables=(
        Variable("speed", "input", "Speed of the slide", "m/s"),
        Variable("acceleration", "input", "Its acceleration", "m/s2"),
        Variable("current", "output", "Motor current", "A"),
        Variable("rated_speed", "parameter", "Speed that viscous_friction belongs to", "m/s", (), 0.02, 1e-6),
        Variable("rated_acceleration", "parameter", "Acceleration that acceleration_current belongs to", "m/s2", (), 0.1, 1e-6),
        Variable("smooth_speed", "parameter", "Speed over which Coulomb friction changes sign", "m/s", (), 5e-4, 1e-9),
        _effect("acceleration_current", "current for the rated acceleration: slide, screw and rotor", 0.0),
        _effect("viscous_friction", "viscous friction at the rated speed", 0.0),
        _effect("coulomb_friction", "Coulomb friction", 0.0),
        _effect("current_offset", "gravity, or the zero of the current sensor"),
    ),
    init=init,
    step=step,
    errors=("", "an input is not finite at {t} s: speed {speed} m/s, acceleration {acceleration} m/s2; check the component that feeds it"),
)
