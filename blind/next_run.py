"""Whether a recommended run would have told the truth from what else it was taken for: it is made in the generator's world."""

from __future__ import annotations

from collections.abc import Sequence

from robomill.blind import outside
from robomill.blind.generate import detectability, switched_on
from robomill.blind.outside import Changes, Columns
from robomill.blind.prediction import LOGGING, ComponentValues
from robomill.blind.truth import Truth
from robomill.blind.world import STEP, Machine, simulate_menu


def separates(truth: Truth, kind: str, wrong: Sequence[ComponentValues], tier: str, limit: float) -> bool:
    """Whether the run `kind` of the menu tells the effects of a truth from each of the other answers, on the same machine.

    It does where, in some window of 0.5 s, what they do differs by `limit` times what machines without effects leave.
    LookupError: no such run; OrchestrationError: it cannot be made.
    """
    machine = Machine(truth.machine or {}, truth.hidden)
    parameters, others = switched_on(truth.effects)
    _, true = simulate_menu(kind, machine, parameters, outside.merged(others), {})
    return all(max(detectability(_said(kind, machine, values), true, true, tier).values()) >= limit for values in wrong)


def _said(kind: str, machine: Machine, values: ComponentValues) -> Columns:
    """What would be logged if an answer were true."""
    t, columns = simulate_menu(kind, machine, (), Changes(), values)
    for what, lag in values.get(LOGGING, {}).items():
        if (after := outside.late_clock(what.partition(" ")[2], lag).after) is not None:
            after(columns, t, STEP)
    return columns
