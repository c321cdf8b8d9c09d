"""Values and intervals of effects of a single recording: by least squares, or by the fit where these two contradict each other."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.evidence import FORM
from robomill.diagnosis.inference.intervals import Known
from robomill.diagnosis.outcome.values import WIDER, Values
from tests.diagnosis.formula import candidate
from tests.tolerances import ROUNDOFF

EFFECT = candidate("viscous", scale=1.0)
(ADDRESS,) = EFFECT.addresses
NAME = EFFECT.named[0]
DEVIATION = 0.05


def made(value: float, *free: float) -> Values:
    """Values of an effect that is fitted as `value`; `free`: what least squares with everything free say, and its deviation."""
    search = SimpleNamespace(
        evidence=SimpleNamespace(space=SimpleNamespace(alike={})), simulator=SimpleNamespace(laboratory=SimpleNamespace(nominal={}))
    )
    known = {EFFECT.name: Known({ADDRESS: free[0]}, {ADDRESS: free[1]}, 1e-4)} if free else {}
    return Values(cast("Any", search), Fit((EFFECT,), {ADDRESS: value}, {ADDRESS: DEVIATION}, 0.0, 0.0), known)


def of_fit(value: float) -> float:
    """Half of the interval that the fit alone has."""
    return float(1.645 * ((WIDER * DEVIATION) ** 2 + (FORM * value) ** 2) ** 0.5)


def test_least_squares_have_the_value_and_the_interval() -> None:
    of = made(0.5, 0.6, 0.1)
    assert not of.contradicted(EFFECT, of.best)
    assert (of.said(EFFECT)[ADDRESS], of.closes(EFFECT)) == (0.6, 1e-4)
    found = of.parameters(EFFECT, of.best)[NAME]
    assert found.value == 0.6
    assert found.interval == pytest.approx([0.6 - 0.1645, 0.6 + 0.1645], rel=1e2 * ROUNDOFF)


@pytest.mark.parametrize(("free", "ends"), [(0.1, (0.1 - 0.1645, None)), (0.9, (None, 0.9 + 0.1645))])
def test_where_they_contradict_the_fit_the_fit_has_the_value_and_the_interval_reaches_to_both(
    free: float, ends: tuple[float | None, float | None]
) -> None:
    """What is printed is what adopt.ssv holds, and what closes the gap."""
    of = made(0.5, free, 0.1)
    assert of.contradicted(EFFECT, of.best)
    assert (of.said(EFFECT)[ADDRESS], of.closes(EFFECT)) == (0.5, None)
    found = of.parameters(EFFECT, of.best)[NAME]
    low, high = (own if end is None else end for own, end in zip((0.5 - of_fit(0.5), 0.5 + of_fit(0.5)), ends, strict=True))
    assert found.value == 0.5
    assert found.interval == pytest.approx([max(low, EFFECT.bounds[0]), high], rel=1e2 * ROUNDOFF)


def test_what_is_known_of_neither_is_no_contradiction() -> None:
    of, alone = made(0.5, 0.1, 0.3), made(0.5)
    assert not of.contradicted(EFFECT, of.best)
    assert not alone.contradicted(EFFECT, alone.best)
    found = alone.parameters(EFFECT, alone.best)[NAME]
    assert found.interval == pytest.approx([0.5 - of_fit(0.5), 0.5 + of_fit(0.5)], rel=1e2 * ROUNDOFF)


def test_what_may_be_nothing_with_all_else_free_has_the_value_that_is_adopted() -> None:
    """A loss of a box, in a catalogue that has its power, too: named at 0.95, fitted at -0.22, and at -0.05 beside the power."""
    of = made(0.5, 0.1, 0.3)
    assert of.said(EFFECT)[ADDRESS] == 0.5
    assert of.closes(EFFECT) == 1e-4
    found = of.parameters(EFFECT, of.best)[NAME]
    assert found.value == 0.5
    assert found.interval == pytest.approx([0.1 - 1.645 * 0.3, 0.5 + of_fit(0.5)], rel=1e2 * ROUNDOFF)


def test_an_interval_ends_where_the_catalogue_does() -> None:
    """By the fit, too: dry friction is not less than none."""
    alone = made(0.5)
    wide = replace(alone.best, deviations={ADDRESS: 1e3})
    found = alone.parameters(EFFECT, wide)[NAME]
    assert found.interval == [*EFFECT.bounds]
