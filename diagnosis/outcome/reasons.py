"""Why an answer is `unknown`: what speaks against the best model."""

from __future__ import annotations

from typing import Literal

from robomill.diagnosis.outcome.verdict import Tests, believed

Reason = Literal["left", "worse", "elsewhere", "alike", "calibrated", "lag", "bound", "changes", "instead", "runs", "swing"]

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
    "runs": "does not differ from run to run as the machine does",
    "swing": "does not swing within samples as the machine does",
}
"""What is said of the best model."""
_ODDS: tuple[Reason, ...] = ("left", "worse", "elsewhere", "alike", "calibrated", "lag")
"""The fields of `Odds`."""


def reasons(tests: Tests, effects: bool, seen: dict[Reason, bool]) -> tuple[Reason, ...]:
    """What speaks against the best model of an answer that is `unknown`.

    `effects`: whether that model has any. `seen`: what is seen apart from `p_fit`, and whether it is; that comes first. Where `p_fit`
    refutes the model, all that it is made of and speaks against it follows, the heaviest first.
    """
    assert tests.odds is not None
    odds: dict[Reason, float] = {r: getattr(tests.odds, r) for r in _ODDS}
    found = [r for r, so in seen.items() if so]
    if effects and believed(tests) and tests.p_fit < 1.0 - tests.p_fit:
        found += sorted((r for r in _ODDS if odds[r] < 0.0), key=odds.__getitem__)
    # nothing is believed, or the odds before the data decide: there is a gap, or calibrated numbers are far off
    return tuple(found) or (min(("left", "calibrated"), key=odds.__getitem__),)
