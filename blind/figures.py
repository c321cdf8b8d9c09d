"""The figures of score.json, by what they measure (docs/maintainers/blind.md says what each means)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from robomill.blind.baselines import Guess
from robomill.blind.case import CATALOGUE, REAL, Case, Cases
from robomill.blind.criteria import (
    answer_right,
    component_right,
    effect_in_top,
    estimate,
    fault_said,
    location_right,
    named_exactly,
    set_holds_truth,
)
from robomill.blind.prediction import ComponentValues
from robomill.blind.set_figures import (
    Equivalents,
    Same,
    campaign,
    claims,
    coverage_of_the_catalogue,
    few,
    intervals,
    machine,
    nulls,
    withheld,
)
from robomill.blind.statistics import Claim, Figure, expected_calibration_error, proportion, quantile

SquaredGaps = Callable[[int, ComponentValues], Mapping[str, Mapping[str, tuple[float, float]]]]
"""(number of the case, claimed values) -> sum of squares of the true gap by held-out condition and quantity, before and after."""
FormGaps = Callable[[int, Mapping[str, Any]], Mapping[str, Mapping[str, tuple[float, float]]]]
"""(number of the case, form) -> the same, with a form in the loop."""
Separates = Callable[[int, Mapping[str, Any], Sequence[ComponentValues]], bool]
"""(number of the case, recommended run, values of the wrong candidates) -> whether the run tells all of them from the truth."""
TIP = "tool tip"
"""The quantity that needs the tracker."""
GAP_ARRAY = {"T1": ("compliance.p_BT_B", TIP), "T0": ("sensor.f_T_T", "force")}
"""Tier -> the array whose gap counts, and its name in the ceiling of a truth."""
CLOSABLE = 0.5
"""Closure by the truth itself from which a held-out condition counts."""


def figures(
    cases: Cases,
    tier: str = "T1",
    squared_gaps: SquaredGaps | None = None,
    separates: Separates | None = None,
    equivalents: Equivalents = lambda _: (),
    form_gaps: FormGaps | None = None,
    same: Same = lambda _: False,
) -> dict[str, Figure]:
    """All of them. The callables may be left out: what needs them is then without cases, and withheld effects have no equivalents."""
    return {
        **withheld(cases, equivalents, same),
        **alarms(cases),
        **nulls(cases),
        "right_answer": proportion([answer_right(c) for c in answerable(cases)]),
        **naming(cases),
        **ambiguity(cases, separates),
        **open_set(cases),
        **doubles(cases),
        **parameters(cases),
        **intervals(cases),
        **few(cases),
        **closures(cases, tier, squared_gaps),
        **coverage_of_the_catalogue(cases),
        **machine(cases),
        **machine_closure(cases, tier, squared_gaps),
        **form_closure(cases, tier, form_gaps),
        **campaign(cases),
        "ece": calibration(claims(cases, equivalents, same)),
        **cpu_time(cases),
    }


def alarms(cases: Cases) -> dict[str, Figure]:
    """Whether there is anything, and whether the log is at fault."""
    return {
        "null_false_alarm": proportion([c.prediction.verdict != "none" for c in cases.of("null")]),
        "bad_log_stopped": proportion([fault_said(c) for c in cases.detectable("bad_log")]),
        "bad_log_stopped_of_all": proportion([fault_said(c) for c in cases.of("bad_log")]),
        "detection": proportion([c.prediction.found for c in cases.detectable(*REAL)]),
        "good_log_stopped": proportion([c.prediction.stopped for c in cases.of("null", *REAL)]),
    }


def answerable(cases: Cases) -> list[Case]:
    """Cases of good logs with nothing or one thing in them that the data can decide: nulls, clear singles, clear unknowns."""
    return [*cases.of("null"), *cases.singles, *cases.detectable("outside")]


def naming(cases: Cases) -> dict[str, Figure]:
    """Component, place and effect of singles that the data can decide."""
    singles = cases.singles
    return {
        "component_top1": proportion([component_right(c) for c in singles]),
        "location_top1": proportion([location_right(c) for c in singles if c.effects[0].index]),
        "effect_top1": proportion([effect_in_top(c, 1) for c in singles]),
        "effect_top3": proportion([effect_in_top(c, 3) for c in singles]),
        "effect_top1_of_detectable": proportion([effect_in_top(c, 1) for c in cases.detectable("single")]),
    }


def ambiguity(cases: Cases, separates: Separates | None = None) -> dict[str, Figure]:
    """The sets of ambiguous answers to singles, and the runs recommended to decide them."""
    ambiguous = [c for c in cases.detectable("single") if c.prediction.verdict == "ambiguous"]
    return {
        "ambiguity_holds_truth": proportion([set_holds_truth(c) for c in ambiguous]),
        "ambiguity_median_size": quantile([float(len(c.prediction.listed)) for c in ambiguous]),
        "next_run_separates": proportion(_separated(ambiguous, separates) if separates else []),
    }


def _separated(cases: Sequence[Case], separates: Separates) -> list[bool]:
    """Whether the recommended run tells the truth from the likeliest wrong candidate, for each case; no run: no."""
    found = []
    for c in cases:
        wrong = [e.values for e in c.prediction.listed if not e.is_exactly(c.effects[0])][:1]
        recommended = c.prediction.next_run
        if wrong and c.truth.machine is not None:
            found.append(recommended is not None and separates(c.number, recommended, wrong))
    return found


def open_set(cases: Cases) -> dict[str, Figure]:
    """Whether what is outside of the catalogue is told from what is in it."""
    unknowns = cases.detectable("outside")
    return {
        "unknown_recall": proportion([c.prediction.verdict == "unknown" for c in unknowns]),
        "false_unknown": proportion([c.prediction.verdict == "unknown" for c in cases.detectable(*CATALOGUE)]),
        "confident_wrong_on_unknown": proportion([c.prediction.verdict == "identified" for c in unknowns]),
    }


def doubles(cases: Cases) -> dict[str, Figure]:
    """What is claimed of two effects at once; each effect is looked at by itself."""
    detectable = cases.detectable("double")
    both = [c for c in detectable if len(cases.decidable(c)) == len(c.effects)]
    some = [c for c in detectable if cases.decidable(c)]
    told = [c for c in detectable if all(cases.isolable(c, i) for i in range(len(c.effects)) if c.effect_detectable(i))]
    return {
        "doubles_exact": proportion([c.prediction.claimed_keys == c.keys for c in both]),
        "doubles_one_right": proportion([bool(c.prediction.claimed_keys & c.keys) for c in some]),
        "doubles_nothing_invented": proportion([c.prediction.claimed_keys <= c.keys for c in told]),
    }


def parameters(cases: Cases) -> dict[str, Figure]:
    """Relative errors of the parameters and coverage of their intervals, of singles that are named exactly."""
    estimates = [e for c in cases.singles if named_exactly(c) and (e := estimate(c, c.prediction.claimed[0])) is not None]
    errors = [error for error, _ in estimates]
    return {
        "parameter_error_median": quantile(errors),
        "parameter_error_p90": quantile(errors, 0.9),
        "interval_coverage": proportion([covered for _, covered in estimates if covered is not None]),
    }


def closures(cases: Cases, tier: str, squared_gaps: SquaredGaps | None = None) -> dict[str, Figure]:
    """How far what is claimed closes the gap on held-out conditions, of singles that are named exactly."""
    named = [c for c in cases.singles if named_exactly(c)]
    found = [v for c in named if (v := _closure(c, tier, squared_gaps)) is not None] if squared_gaps else []
    ratios = [ratio for ratio, _ in found]
    return {
        "closure_over_ceiling_median": quantile(ratios),
        "closure_over_ceiling_p10": quantile(ratios, 0.1),
        "claimed_closure_error_median": quantile([error for _, error in found if error is not None]),
    }


def _closure(c: Case, tier: str, squared_gaps: SquaredGaps) -> tuple[float, float | None] | None:
    """True closure over ceiling, and |claimed - true| where there is a claim; None where even the truth closes no condition.

    The former is a mean over the conditions that the truth closes (`CLOSABLE`), the latter is of all held-out conditions together,
    as it is claimed.
    """
    array, quantity = GAP_ARRAY[tier]
    ceilings = {name: v[quantity] for name, v in c.truth.ceiling.items() if v[quantity] >= CLOSABLE}
    if not ceilings:
        return None
    gaps = {name: g[quantity] for name, g in squared_gaps(c.number, c.prediction.claimed_values).items()}
    ratio = float(np.mean([_closed(*gaps[name]) / ceiling for name, ceiling in ceilings.items()]))
    claims_of_it = [
        float(h["closure"])
        for h in c.prediction.how_far
        if h.get("on") == "held-out condition" and h.get("closure") is not None and h.get("channel", array) == array
    ]
    together = _closed(sum(before for before, _ in gaps.values()), sum(after for _, after in gaps.values()))
    return ratio, abs(claims_of_it[0] - together) if claims_of_it else None


def machine_closure(cases: Cases, tier: str, squared_gaps: SquaredGaps | None = None) -> dict[str, Figure]:
    """Closure over ceiling in new conditions of machines with many effects, named or not: mean over conditions and quantities.

    Those count that the truth closes (`CLOSABLE`), of the quantities that are measured at the tier.
    """
    ratios = []
    for c in cases.of("machine") if squared_gaps else ():
        wanted = _closable(c, tier)
        if wanted and squared_gaps:
            gaps = squared_gaps(c.number, c.prediction.claimed_values)
            ratios.append(float(np.mean([_closed(*gaps[k][q]) / ceiling for (k, q), ceiling in wanted.items()])))
    return {"machine_closure_over_ceiling_median": quantile(ratios)}


def form_closure(cases: Cases, tier: str, form_gaps: FormGaps | None = None) -> dict[str, Figure]:
    """Closure by the form over that by the true effect, in new conditions, of what is detectable; 0 where no form is given.

    Conditions and quantities count as in `machine_closure`.
    """
    ratios = []
    for c in cases.detectable("formed") if form_gaps else ():
        wanted = _closable(c, tier)
        if not wanted or form_gaps is None:
            continue
        gaps = form_gaps(c.number, c.prediction.form) if c.prediction.form else {}
        ratios.append(float(np.mean([_closed(*gaps[k][q]) / ceiling if k in gaps else 0.0 for (k, q), ceiling in wanted.items()])))
    return {"form_closure_over_ceiling_median": quantile(ratios)}


def _closable(c: Case, tier: str) -> dict[tuple[str, str], float]:
    """(held-out condition, quantity that is measured) -> closure by the truth, where that is CLOSABLE."""
    every = {(k, q): v for k, of in c.truth.ceiling.items() for q, v in of.items() if tier == "T1" or q != TIP}
    return {place: v for place, v in every.items() if v >= CLOSABLE}


def _closed(before: float, after: float) -> float:
    return 0.0 if before == 0.0 else 1.0 - after / before


def calibration(said: Sequence[Claim]) -> Figure:
    """Expected calibration error of what is claimed."""
    return expected_calibration_error([c.probability for c in said], [c.right for c in said])


def cpu_time(cases: Cases) -> dict[str, Figure]:
    """CPU time of a diagnosis [s]: median and nine tenths."""
    times = [c.prediction.cpu for c in cases.all if c.prediction.cpu is not None]
    return {"cpu_time_median": quantile(times), "cpu_time_p90": quantile(times, 0.9)}


def baseline_figures(cases: Cases, guesses: Mapping[int, Guess]) -> dict[str, Figure]:
    """Those that a method has which only names one effect or none, and knows no unknowns; guesses by number of the case."""
    singles = [(guesses[c.number], c.effects[0]) for c in cases.singles]
    return {
        "null_false_alarm": proportion([guesses[c.number].key is not None for c in cases.of("null")]),
        "detection": proportion([guesses[c.number].key is not None for c in cases.detectable(*REAL)]),
        "right_answer": proportion([_guessed(c, guesses[c.number]) for c in answerable(cases)]),
        "component_top1": proportion([g.component == true.component for g, true in singles]),
        "location_top1": proportion([(g.component, g.index) == (true.component, true.index) for g, true in singles if true.index]),
        "effect_top1": proportion([g.key == true.key for g, true in singles]),
        "confident_wrong_on_unknown": proportion([guesses[c.number].key is not None for c in cases.detectable("outside")]),
    }


def _guessed(c: Case, guess: Guess) -> bool:
    return c.kind != "outside" and guess.key == (c.effects[0].key if c.effects else None)
