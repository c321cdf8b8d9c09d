"""The tables of score.json: figures by how far the effects stand out, effect by effect, and what was taken for what."""

from __future__ import annotations

import math
from typing import Any

from robomill.blind.case import REAL, Case, Cases
from robomill.blind.criteria import component_right, effect_in_top
from robomill.blind.statistics import Figure, proportion

STRATA = (
    ("hidden, below 1", 0.0, 1.0),
    ("marginal, 1 to 3", 1.0, 3.0),
    ("clear, 3 to 10", 3.0, 10.0),
    ("strong, above 10", 10.0, math.inf),
)
"""(name, from, to) of the oracle ratio."""


def strata(cases: Cases) -> dict[str, dict[str, Figure]]:
    """Detection and naming by oracle ratio, all real cases and all singles."""
    table = {}
    for name, low, high in STRATA:
        inside = [c for c in cases.of(*REAL) if low <= c.ratio < high]
        singles = [c for c in inside if c.kind == "single"]
        table[name] = {
            "detection": proportion([c.prediction.found for c in inside]),
            "component_top1": proportion([component_right(c) for c in singles]),
            "effect_top1": proportion([effect_in_top(c, 1) for c in singles]),
        }
    return table


def confusion(cases: Cases) -> dict[str, dict[str, int]]:
    """True effect (kind of the case where there is none) -> what was said first -> cases. Singles, nulls, unknowns, bad logs."""
    table: dict[str, dict[str, int]] = {}
    for c in cases.of("single", "null", "outside", "bad_log"):
        row = table.setdefault(_true_label(c), {})
        said = c.prediction.claimed[0].names[0].key if c.prediction.claimed else c.prediction.verdict
        row[said] = row.get(said, 0) + 1
    return {name: dict(sorted(row.items(), key=lambda item: -item[1])) for name, row in sorted(table.items())}


def _true_label(c: Case) -> str:
    if c.kind == "single":
        return c.effects[0].key
    if c.kind == "outside":
        return f"outside: {c.truth['outside']['name']}"
    return f"bad log: {c.truth['bad_log']['kind']}" if c.kind == "bad_log" else c.kind


def per_effect(cases: Cases) -> dict[str, dict[str, Any]]:
    """Of each true effect (singles): cases, detectable, isolable, found, named."""
    table: dict[str, dict[str, Any]] = {}
    for c in cases.of("single"):
        row = table.setdefault(c.effects[0].key, dict.fromkeys(("cases", "detectable", "isolable", "detected", "named", "named_top3"), 0))
        row["cases"] += 1
        row["detectable"] += c.detectable
        row["isolable"] += c.detectable and bool(cases.decidable(c))
        row["detected"] += c.prediction.found
        row["named"] += effect_in_top(c, 1)
        row["named_top3"] += effect_in_top(c, 3)
    return dict(sorted(table.items()))
