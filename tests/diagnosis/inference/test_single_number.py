"""An effect is tried from where a number of the model that is like it ended."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from robomill.diagnosis.candidates import Address, Candidate
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.single_number import _in_place
from tests.diagnosis.formula import candidate
from tests.tolerances import ROUNDOFF


@pytest.mark.parametrize(("ended", "asked"), [(-0.9, True), (-9.0, False)])
def test_an_effect_begins_where_a_number_that_is_like_it_ended(ended: float, asked: bool) -> None:
    """A prior scale of the number does twice what one of the effect does, the other way round; beyond the bounds nothing is asked."""
    friction, effect = candidate("friction", scale=1.0), candidate("damping", scale=0.2, largest=10.0)
    number = candidate("number", scale=0.25)
    (own,), (of_number,), (beside,) = effect.addresses, number.addresses, friction.addresses
    slope = np.array([1.0, 2.0, -1.0])
    begun: list[tuple[tuple[Candidate, ...], Mapping[Address, float], Mapping[Address, float]]] = []

    def fitted(model: Any, values: Any, deviations: Any) -> None:
        begun.append((model, values, deviations))

    search: Any = SimpleNamespace(evidence=SimpleNamespace(sensitivities={own: slope}), fitted=fitted)
    fit = Fit((friction, number), {beside: 1.4, of_number: ended}, {beside: 0.1, of_number: 0.05}, 0.0, 0.0)
    _in_place(cast("Any", search), fit, effect, -2.0 * slope)
    assert len(begun) == asked
    for model, values, deviations in begun:
        assert model == (friction, effect)
        assert values == pytest.approx({beside: 1.4, own: -2.0 * 0.2 / 0.25 * ended}, rel=ROUNDOFF)
        assert deviations[own] == pytest.approx(2.0 * 0.2 / 0.25 * 0.05, rel=ROUNDOFF)
