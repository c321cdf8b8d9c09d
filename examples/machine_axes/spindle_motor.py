"""A spindle motor as its power shows it: friction of the turning spindle, the cut, and what a worn tool adds to it.

    P = P_i n / n_r + (P_c + w P_w) e,   e = 1 where the spindle turns and the programmed feed is below that of a rapid move, else 0

P_i: power of the idle spindle at its rated speed n_r; P_c: power of the cut; P_w: what a worn tool (w = 1) adds. All three are effects,
off by default: the nominal spindle turns for nothing.
"""

from __future__ import annotations

import math

from robomill.models.model.declaration import Model, Record, Variable, kernel

TURNING = 0.5
"""Share of the rated speed from which the spindle counts as turning: it is switched on and off, and nothing lies between for long."""


@kernel
def _power(s: Record) -> int:
    """Power [W] at the inputs; status 1 where they are not finite."""
    if not abs(s.speed) + abs(s.feed) < math.inf:
        return 1
    s.power = s.idle_power * abs(s.speed) / s.rated_speed
    if abs(s.speed) > TURNING * s.rated_speed and s.feed < s.rapid_feed:
        s.power += s.cutting_power
        if s.tool_worn:
            s.power += s.wear_power
    return 0


def init(s: Record) -> int:
    """Power at t = 0."""
    return int(_power(s))


def step(s: Record, t: float, h: float) -> int:
    """Power for speed and feed at the inputs, which are those at t + h."""
    return int(_power(s))


def _effect(name: str, description: str) -> Variable:
    return Variable(name, "parameter", f"Effect: {description}", "W", (), 0.0, -1e4, 1e4, effect=True)


MODEL = Model(
    name="spindle_motor",
    description="Power of a spindle motor: idle, cut and worn tool",
    variables=(
        Variable("speed", "input", "Speed of the spindle", "rad/s"),
        Variable("feed", "input", "Programmed feed of the block", "m/s"),
        Variable("power", "output", "Power of the motor", "W"),
        Variable("tool_worn", "parameter", "Whether the tool is worn", "1", kind="boolean"),
        Variable("rated_speed", "parameter", "Speed that idle_power belongs to", "rad/s", (), 335.1, 1e-3),
        Variable("rapid_feed", "parameter", "Programmed feed from which a block is no cut", "m/s", (), 0.05, 1e-6),
        _effect("idle_power", "friction of the turning spindle at its rated speed"),
        _effect("cutting_power", "power of the cut"),
        _effect("wear_power", "what a worn tool adds to it"),
    ),
    init=init,
    step=step,
    errors=("", "an input is not finite at {t} s: speed {speed} rad/s, feed {feed} m/s; check the component that feeds it"),
)
