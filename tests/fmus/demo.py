"""A small model with everything that a component may have: a spring and damper that sums what passes, with a table and an effect."""

from __future__ import annotations

import numpy as np

from robomill.models.maths.elementary import sin
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.model.table_access import cell

GAIN = 2.0


@kernel
def spring(s: Record, i: int) -> float:
    """Force of spring i [N]."""
    return float(s.stiffness[i, 0] * s.x[i])


def outputs(s: Record) -> None:
    """Outputs from states and inputs."""
    for i in range(2):
        s.force[i] = spring(s, i) + s.drift * s.time
    s.count = s.steps
    s.on = 1 if s.enable != 0 and s.number > 0 else 0
    s.delayed = s.total
    s.curve_value = cell(s.curve_at, s.curve_rows, 2, 0, 1) if s.curve_rows > 0 else 0.0


outputs = kernel(outputs)


def init(s: Record) -> int:
    """States and outputs at t = 0."""
    if s.stiffness[0, 0] == 13.0:
        return 1
    s.steps = 0
    s.total = 0.0
    s.time = 0.0
    outputs(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Advance by h."""
    if abs(s.x[0]) > 1.0:
        return 2
    s.steps += 1
    s.time = t + h
    for i in range(2):
        s.total += h * sin(spring(s, i)) * GAIN
    outputs(s)
    return 0


MODEL = Model(
    "demo",
    "Springs <with> a table & an effect",
    (
        Variable("x", "input", "Deflection", "m", (2,), display_unit="mm"),
        Variable("enable", "input", "Switch", kind="boolean", start=1),
        Variable("speed", "input", "Spindle speed", "rad/s", display_unit="rpm"),
        Variable("number", "input", "Whole number", kind="integer", start=3),
        Variable("force", "output", "Force", "N", (2,), depends_on=("x",)),
        Variable("count", "output", "Steps taken", kind="integer", depends_on=()),
        Variable("on", "output", "Switched on", kind="boolean", depends_on=("enable", "number")),
        Variable("delayed", "output", "Sum so far", "1", depends_on=("x",)),
        Variable("curve_value", "output", "First value of the curve", "N", depends_on=()),
        Variable("stiffness", "parameter", "Stiffness", "N/m", (2, 1), [[100.0], [50.0]], minimum=0.0, maximum=1e6),
        Variable("drift", "parameter", "Drift of both forces", "N/s", effect=True, minimum=-10.0, maximum=10.0, tunable=True),
        Variable("curve", "parameter", "A curve", "1", (2,), kind="table"),
        Variable("steps", "state", "Steps taken", kind="integer"),
        Variable("total", "state", "Sum"),
        Variable("time", "state", "Time", "s"),
    ),
    init,
    step,
    ("", "stiffness[1] = {stiffness[0][0]} N/m brings bad luck", "x[1] = {x[0]} m is too far at t = {t} s; at most 1 m"),
    {"curve": np.array([[0.0, 7.0], [1.0, 8.0]])},
)
