"""Figures of single sets (docs/maintainers/blind.md says what each means): effects, nulls by repeats, machines, few repeats, campaigns."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robomill.blind.case import Case, Cases
from robomill.blind.criteria import estimate, location_right, named_exactly, set_holds_truth
from robomill.blind.effects import BY_KEY
from robomill.blind.prediction import LOGGING, Candidate, Named
from robomill.blind.sets import NULL_REPEATS, STIFF_JOINTS
from robomill.blind.statistics import Claim, Figure, proportion

Equivalents = Callable[[int], Sequence[str]]
"""Number of the case -> candidates (`component.parameter`, of a clock `logging.lag DEVICE`) that no test on its runs, held-out ones too,
tells from its withheld effect."""
Same = Callable[[Case], bool]
"""Whether all that a prediction claims, together and at its values, does in all runs what the withheld effect does."""


def is_equivalent(said: Candidate, equivalents: Sequence[str]) -> bool:
    """Whether a candidate names one of the equivalents, at its element; a clock is known by `logging.lag` alone."""
    known = {Named.of(*text.split(".", 1)) for text in equivalents}
    return any(name in known for name in said.names)


def withheld_right(c: Case, equivalents: Sequence[str], same: Same) -> bool:
    """Whether a withheld effect is `unknown`, or what is named has an equivalent in it, or does the same as a whole."""
    p = c.prediction
    if p.verdict == "unknown":
        return True
    said = {"identified": p.claimed, "ambiguous": p.listed}.get(p.verdict, ())
    return any(is_equivalent(e, equivalents) for e in said) or (bool(said) and same(c))


def withheld(cases: Cases, equivalents: Equivalents, same: Same) -> dict[str, Figure]:
    """Clear effects that are not in the catalogue."""
    clear = [(c, equivalents(c.number)) for c in cases.detectable("withheld")]
    return {
        "withheld_unknown_or_equivalent": proportion([withheld_right(c, e, same) for c, e in clear]),
        "withheld_unknown": proportion([c.prediction.verdict == "unknown" for c, _ in clear]),
        "withheld_confident_wrong": proportion([c.prediction.verdict == "identified" and not withheld_right(c, e, same) for c, e in clear]),
        "withheld_with_equivalents": proportion([bool(e) for _, e in clear]),
        "withheld_same_together": proportion([bool(c.prediction.claimed) and same(c) for c, _ in clear]),
    }


def nulls(cases: Cases) -> dict[str, Figure]:
    """False alarms by the number of repeats."""
    found = {}
    for repeats in NULL_REPEATS:
        of = [c for c in cases.of("null") if c.truth.repeats == repeats]
        found[f"null_false_alarm_{repeats}"] = proportion([c.prediction.verdict != "none" for c in of])
    return found


def coverage_of_the_catalogue(cases: Cases) -> dict[str, Figure]:
    """Effects of the catalogue that have a case in which they can be detected at all: a property of the set, not of a diagnosis."""
    seen = {e.key for c in cases.detectable("single") for e in c.effects}
    return {"effects_with_detectable_cases": proportion([key in seen for key in BY_KEY])}


def machine(cases: Cases) -> dict[str, Figure]:
    """Four to eight effects at once: which are found, which of those named are there. An effect counts at its element, a clock at any."""
    of = cases.of("machine")
    found = [e in _claimed(c) for c in of for i, e in enumerate(c.effects) if c.effect_detectable(i)]
    return {
        "machine_found": proportion(found),
        "machine_true": proportion([e in c.effects for c in of for e in _claimed(c)]),
    }


def _claimed(c: Case) -> list[Named]:
    """Effects that are claimed, each once. A phase or a shape beside a size is no effect."""
    claimed: list[Named] = []
    for e in c.prediction.claimed:
        claimed += [n for n in e.names if n.key in BY_KEY or n.component == LOGGING] or e.names[:1]
    return list(dict.fromkeys(claimed))


def few(cases: Cases) -> dict[str, Figure]:
    """Names that are wrong though they are said with confidence; what the data cannot tell from the effect is not wrong."""
    singles = cases.of("single")
    return {"confident_wrong": proportion([c.prediction.verdict == "identified" and not _named_or_alike(cases, c) for c in singles])}


def _named_or_alike(cases: Cases, c: Case) -> bool:
    return named_exactly(c) or (bool(c.prediction.claimed) and is_equivalent(c.prediction.claimed[0], cases.alike(c, 0)))


def campaign(cases: Cases) -> dict[str, Figure]:
    """Stiffness errors of the joints that carry the arm, detectable or not: named at the joint, or in the set that is named."""
    stiff = [c for c in cases.of("single") if c.effects[0].effect == "stiffness_error" and c.effects[0].index in STIFF_JOINTS]
    placed = [named_exactly(c) or (c.prediction.verdict == "ambiguous" and set_holds_truth(c)) or location_right(c) for c in stiff]
    return {"stiffness_placed": proportion(placed)}


def intervals(cases: Cases) -> dict[str, Figure]:
    """Coverage of the intervals, of everything that is named exactly, one effect or many."""
    covered = []
    for c in cases.of("single", "double", "triple", "machine"):
        for i in range(len(c.effects)):
            said = next((e for e in c.prediction.claimed if e.is_exactly(c.effects[i])), None)
            found = None if said is None else estimate(c, said, i)
            if found is not None and found[1] is not None:
                covered.append(found[1])
    return {"interval_coverage_of_all": proportion(covered)}


def claims(cases: Cases, equivalents: Equivalents, same: Same) -> list[Claim]:
    """Every candidate that is claimed in a good log, with its probability and whether it is right: for the calibration over all sets."""
    found = []
    for c in cases.all:
        if c.kind == "bad_log":
            continue
        alike = equivalents(c.number) if c.kind == "withheld" and c.prediction.claimed else ()
        whole = c.kind == "withheld" and bool(c.prediction.claimed) and same(c)
        for e in c.prediction.claimed:
            right = whole or is_equivalent(e, alike) if c.kind == "withheld" else any(e.is_exactly(true) for true in c.effects)
            found.append(Claim(e.probability, right, c.truth.generator))
    return found
