"""The tables of score.json: figures by how far the effects stand out, effect by effect, and what was taken for what."""

from __future__ import annotations

import math
from collections.abc import Mapping

from robomill.blind.case import REAL, Case, Cases
from robomill.blind.criteria import component_right, effect_in_top
from robomill.blind.results import EffectCounts
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
    """True effect (kind of the case where there is none) -> what was said first -> cases; each claim of a machine counts by itself."""
    table: dict[str, dict[str, int]] = {}

    def count(true: str, said: str) -> None:
        row = table.setdefault(true, {})
        row[said] = row.get(said, 0) + 1

    for c in cases.of("single", "withheld", "null", "outside", "formed", "bad_log"):
        count(_true_label(c), c.prediction.claimed[0].names[0].key if c.prediction.claimed else c.prediction.verdict)
    for c in cases.of("machine"):
        named = {n for e in c.prediction.claimed for n in e.names}
        for true in c.effects:
            count(true.key, true.key if true in named else "not named")
        for said in sorted(n.key for n in named - set(c.effects)):
            count("not there", said)
    return {name: dict(sorted(row.items(), key=lambda item: -item[1])) for name, row in sorted(table.items())}


def by_component(table: Mapping[str, Mapping[str, int]]) -> dict[str, dict[str, int]]:
    """A confusion matrix of components from one of effects; what is no effect stays as it is."""
    found: dict[str, dict[str, int]] = {}
    for true, row in table.items():
        into = found.setdefault(_component(true), {})
        for said, n in row.items():
            into[_component(said)] = into.get(_component(said), 0) + n
    return found


def _component(label: str) -> str:
    return label.partition(":")[0] if ":" in label else label.partition(".")[0]


def _true_label(c: Case) -> str:
    if c.effects and c.kind != "bad_log":
        return f"withheld: {c.effects[0].key}" if c.kind == "withheld" else c.effects[0].key
    outside, fault = c.truth.outside, c.truth.bad_log
    return f"outside: {outside.name}" if outside else f"bad log: {fault.kind}" if fault else c.kind


def per_effect(cases: Cases) -> dict[str, EffectCounts]:
    """By true effect."""
    table: dict[str, list[Case]] = {}
    for c in cases.of("single", "withheld"):
        table.setdefault(c.effects[0].key, []).append(c)
    return {
        key: EffectCounts(
            cases=len(of),
            detectable=sum(c.detectable for c in of),
            isolable=sum(c.detectable and bool(cases.decidable(c)) for c in of),
            detected=sum(c.prediction.found for c in of),
            named=sum(effect_in_top(c, 1) for c in of),
            named_top3=sum(effect_in_top(c, 3) for c in of),
        )
        for key, of in sorted(table.items())
    }
