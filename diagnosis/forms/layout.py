"""The answer about an unknown law: key `form` of diagnosis.json.

::

    "form": {
      "component": "robot",                      # where the form is put in
      "side": "output",                          # "output": added to what comes out of it; "input": to what goes into it
      "step_late": 0.0,                          # [s] delay that putting it in brings: one step at inputs, if it reads outputs
      "ports": [                                 # largest part of the gap first
        {"port": "robot.torque_motor[1]", "unit": "N.m",
         "formula": "11.9 sgn(qd[1]) + 20.4 qd[1]",
         "terms": [{"term": "sgn(qd[1])", "coefficient": 11.9, "interval": [11.1, 12.6], "unit": "N.m",
                    "adds": 0.71}],              # part of the squares of the gap of this port that the term closes, in this order
         "closure": 0.97,                        # of this port, replayed, in blocks that were left out of choice and fit
         "curve": {"variable": "qd[1]", "unit": "rad/s", "x": [...], "left": [...], "form": [...]}}],
                                                 # means in bins of the variable of the first term: what the nominal leaves, the form
      "like": ["like a delay of 3.05 ms (2.98 to 3.12) in robot.q_link[1], robot.q_link[2], robot.q_link[3]"],
      "how_far": [...],                          # as the key `how_far`: the closed loop with the form, on diagnosed and held-out runs
      "ranges": [{"variable": "qd[1]", "unit": "rad/s", "seen": [-2.1, 2.0], "held_out": [-2.3, 2.2]}],
      "worse": [{"channel": "...", "on": "held-out condition", "before": 0.1, "after": 0.2, "unit": "..."}],
      "note": "...",                             # why it was not put into the loop or is refuted, or what to keep in mind; ""
      "specification": {...}                     # the form as data: what adopt.form.json holds; empty where it is not adopted
    }

`ports` is empty, and `component` is "", where no replay could be made; `note` says why. `held_out` in `ranges` is null without held-out
runs. Intervals are 90 %, by a bootstrap over blocks of time. Name and unit of a variable are those of the component's ports: `qd[1]` is
its input or output of that name, `d(q[1])/dt` its rate, `q[1] - q[1] at t = 0` what it changed since the start, `t` the time since then.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from robomill.diagnosis.outcome.closure import HowFar

Side = Literal["output", "input"]


@dataclass(frozen=True)
class TermFound:
    """One term of a form."""

    term: str
    """Formula of the term, in the names of ports and in SI."""
    coefficient: float
    """Its factor [unit]."""
    interval: list[float]
    """90 % interval of the coefficient."""
    unit: str
    """Unit of the coefficient."""
    adds: float
    """Part of the squares of the gap of its port that it closes, when those before it are there, 0..1."""


@dataclass(frozen=True)
class Curve:
    """Means in bins of one variable, [bins] each: what the nominal model leaves [unit of the port], and the form."""

    variable: str
    """Variable of the first term."""
    unit: str
    """Unit of the variable."""
    x: list[float]
    """Middles of the bins."""
    left: list[float]
    """What the nominal model leaves, without what calibrated numbers may do."""
    form: list[float]
    """What the form adds."""


@dataclass(frozen=True)
class PortForm:
    """What is added to one port."""

    port: str
    """Port that something is added to."""
    unit: str
    """Unit of the port."""
    formula: str
    """The sum of the terms in words."""
    terms: tuple[TermFound, ...]
    """Terms in the order in which they were chosen."""
    closure: float
    """1 - squares left / squares of the gap, in blocks that choice and fit have not seen."""
    curve: Curve | None
    """Means over the variable of the first term; null where it has none."""


@dataclass(frozen=True)
class Range:
    """Where a variable of the form was, least and largest [unit]."""

    variable: str
    """Name of the variable."""
    unit: str
    """Unit of the variable."""
    seen: list[float]
    """In the diagnosed runs: beyond, nobody knows whether the form holds."""
    held_out: list[float] | None
    """In the held-out runs; null without any."""


@dataclass(frozen=True)
class Worse:
    """A channel in which the closed loop with the form is farther off than without it; rms [unit]."""

    channel: str
    """Figure, as in `HowFar`."""
    on: str
    """Kind of runs, as in `HowFar`."""
    before: float
    """Root mean square without the form."""
    after: float
    """Root mean square with it."""
    unit: str
    """Unit of both."""


@dataclass(frozen=True)
class Form:
    """The form of an unknown law, at the ports of one component."""

    component: str
    """Component where the form is put in."""
    side: Side
    """Added to what comes out of it, or to what goes into it."""
    step_late: float
    """Delay [s] that putting it in brings: one step at inputs, if it reads outputs of the component."""
    ports: tuple[PortForm, ...]
    """Largest part of the gap first."""
    like: tuple[str, ...] = ()
    """What it is like, in words."""
    how_far: tuple[HowFar, ...] = ()
    """As the key `how_far`: the closed loop with the form, on diagnosed and held-out runs."""
    ranges: tuple[Range, ...] = ()
    """Where its variables were."""
    worse: tuple[Worse, ...] = ()
    """Figures that it makes worse."""
    note: str = ""
    """Why it was not put into the loop, or is refuted by new conditions, or what to keep in mind; empty if nothing."""
    specification: dict[str, Any] = field(default_factory=dict)
    """The form as plain data, which `models.components.correction` makes a model of (an FMU, too)."""

    @property
    def refuted(self) -> bool:
        """Whether the closed loop was tried with it, and is farther off than without it: then it is not adopted."""
        return bool(self.how_far) and not self.specification
