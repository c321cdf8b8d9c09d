"""Values and intervals of effects of a single recording: by least squares, or by the fit where these two contradict each other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.evidence import FORM
from robomill.diagnosis.inference.intervals import Known
from robomill.diagnosis.outcome.conclusion import WIDER, Conclusion
from tests.diagnosis.formula import candidate
from tests.tolerances import ROUNDOFF

EFFECT = candidate("viscous", scale=1.0)
(ADDRESS,) = EFFECT.addresses
NAME = EFFECT.named[0]
DEVIATION = 0.05


def concluded(value: float, free: float, deviation: float) -> Any:
    """The conclusion on an effect that is fitted as `value`, and is `free` by least squares with everything free, with that deviation."""
    made: Any = object.__new__(Conclusion)
    made.best = Fit((EFFECT,), {ADDRESS: value}, {ADDRESS: DEVIATION}, 0.0, 0.0)
    made.known = {EFFECT.name: Known({ADDRESS: free}, {ADDRESS: deviation}, 1e-4)}
    made.laboratory = SimpleNamespace(nominal={})
    made.search = cast("Any", SimpleNamespace(evidence=SimpleNamespace(space=SimpleNamespace(alike={}))))
    return made


def of_fit(value: float) -> float:
    """Half of the interval that the fit alone has."""
    return float(1.645 * ((WIDER * DEVIATION) ** 2 + (FORM * value) ** 2) ** 0.5)


def test_least_squares_have_the_value_and_the_interval() -> None:
    made = concluded(0.5, 0.6, 0.1)
    assert not made.contradicted(EFFECT, made.best)
    found = made.parameters(EFFECT, made.best)[NAME]
    assert found.value == 0.6
    assert found.interval == pytest.approx([0.6 - 0.1645, 0.6 + 0.1645], rel=1e2 * ROUNDOFF)


@pytest.mark.parametrize(("free", "ends"), [(0.1, (0.1 - 0.1645, None)), (0.9, (None, 0.9 + 0.1645))])
def test_where_they_contradict_the_fit_the_fit_has_the_value_and_the_interval_reaches_to_both(
    free: float, ends: tuple[float | None, float | None]
) -> None:
    """What is printed is what adopt.ssv holds, and what closes the gap."""
    made = concluded(0.5, free, 0.1)
    assert made.contradicted(EFFECT, made.best)
    found = made.parameters(EFFECT, made.best)[NAME]
    low, high = (own if end is None else end for own, end in zip((0.5 - of_fit(0.5), 0.5 + of_fit(0.5)), ends, strict=True))
    assert found.value == 0.5
    assert found.interval == pytest.approx([max(low, EFFECT.bounds[0]), high], rel=1e2 * ROUNDOFF)


def test_what_is_known_of_neither_is_no_contradiction() -> None:
    made = concluded(0.5, 0.1, 0.3)
    assert not made.contradicted(EFFECT, made.best)
    made.known = {}
    assert not made.contradicted(EFFECT, made.best)
    assert made.parameters(EFFECT, made.best)[NAME].interval == pytest.approx([0.5 - of_fit(0.5), 0.5 + of_fit(0.5)], rel=1e2 * ROUNDOFF)
