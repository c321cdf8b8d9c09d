"""Whether a recommended run would have told the truth from what else it was taken for: it is made in the generator's world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robomill.blind import outside
from robomill.blind.generate import detectability, switched_on
from robomill.blind.outside import Changes, Columns
from robomill.blind.prediction import LOGGING, ComponentValues
from robomill.blind.truth import Truth
from robomill.blind.world import STEP, Designed, Machine, simulate_designed


def separates(truth: Truth, recommended: Mapping[str, Any], wrong: Sequence[ComponentValues], tier: str, limit: float) -> bool:
    """Whether a recommended run tells the effects of a truth from each of the other answers, on the same machine.

    `recommended`: `next_run` of diagnosis.json, its `kind` and its `parameters`.
    It does where, in some window of 0.5 s, what they do differs by `limit` times what machines without effects leave.
    LookupError: no such kind, or values out of its range; OrchestrationError, ValueError: it cannot be made.
    """
    run = Designed(str(recommended.get("kind")), {name: float(v["value"]) for name, v in recommended.get("parameters", {}).items()})
    machine = Machine(truth.machine or {}, truth.hidden)
    parameters, others = switched_on(truth.effects)
    _, true = simulate_designed(run, machine, parameters, outside.merged(others), {})
    return all(max(detectability(_said(run, machine, values), true, true, tier).values()) >= limit for values in wrong)


def _said(run: Designed, machine: Machine, values: ComponentValues) -> Columns:
    """What would be logged if an answer were true."""
    t, columns = simulate_designed(run, machine, (), Changes(), values)
    for what, lag in values.get(LOGGING, {}).items():
        if (after := outside.late_clock(what.partition(" ")[2], lag).after) is not None:
            after(columns, t, STEP)
    return columns
