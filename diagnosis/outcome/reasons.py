"""Why an answer is `unknown`: what speaks against the best model."""

from __future__ import annotations

from typing import Literal

from robomill.diagnosis.inference.adequacy import UNKNOWN
from robomill.diagnosis.outcome.verdict import Tests, believed, refuted

Reason = Literal[
    "left", "worse", "elsewhere", "alike", "calibrated", "lag", "bound", "changes", "instead", "number", "runs", "swing", "nominal"
]

WHY: dict[Reason, str] = {
    "left": "leaves too much of the gap in the diagnosed runs",
    "worse": "makes a signal worse that the nominal simulation has right",
    "elsewhere": "leaves too much of the gap in new conditions",
    "alike": "does not act equally strongly in all conditions",
    "calibrated": "needs calibrated numbers farther off than their tolerances say",
    "lag": "needs several clocks that are late alike, as one lag of the machine would be",
    "bound": "needs an effect as large as the catalogue lets it be",
    "changes": "does not change with time as the gap does",
    "instead": "has an effect that a law of no name does better than",
    "number": "is less likely than one with a number of the model that no effect is about",
    "runs": "does not differ from run to run as the machine does",
    "swing": "does not swing within samples as the machine does",
    "nominal": "is not believed, and without its effects calibrated numbers are farther off than their tolerances say",
}
"""What is said of the best model."""
_ODDS: tuple[Reason, ...] = ("left", "worse", "elsewhere", "alike", "calibrated", "lag")
"""The fields of `Odds`."""


def reasons(tests: Tests, effects: bool, level: float, seen: dict[Reason, bool]) -> tuple[Reason, ...]:
    """What speaks against the best model of an answer that is `unknown`.

    `effects`: whether that model has any; `level`: what the nominal system leaves, over noise (`verdict.largest`). `seen`: what is seen
    apart from `p_fit`, and whether it is; that comes first. Where `p_fit` refutes the model, all that it is made of and speaks against it
    follows, the heaviest first.
    """
    assert tests.odds is not None
    found = [r for r, so in seen.items() if so]
    there = effects and believed(tests)
    if there and refuted(tests.p_fit):
        odds: dict[Reason, float] = {r: getattr(tests.odds, r) for r in _ODDS}
        found += sorted((r for r in _ODDS if odds[r] < 0.0), key=odds.__getitem__)
    return tuple(found) or (("left",) if there or level > UNKNOWN else ("nominal",))
