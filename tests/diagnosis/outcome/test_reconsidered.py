"""Where the tests refute the likeliest model, those that are nearly as likely are asked, too."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from robomill.diagnosis.candidates import Candidate, Prior
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.outcome.conclusion import LISTED, Conclusion
from tests.diagnosis.formula import candidate
from tests.tolerances import ROUNDOFF

FIRST, SECOND, THIRD = (candidate(name) for name in ("first", "second", "third"))
CLOCK = Candidate("clock", "logging", "all", ("lag y",), 1e-4, 0.1, Prior("normal", 0.01), "s", True, 1)
FITS = [Fit(model, {}, {}, 0.0, 0.0) for model in ((), (FIRST,), (FIRST, SECOND), (FIRST, THIRD), (CLOCK,))]
WEIGHTS = np.array([0.0, 0.6, 0.3, 0.08, 0.02])
REFUTED = {"first @ place": 0.2, "first @ place + second @ place": 0.8, "first @ place + third @ place": 0.9}


def reconsidered(
    p_fit: Mapping[str, float], weights: Any = WEIGHTS, *, guessed: bool = False, other: bool = False
) -> tuple[float | None, Any]:
    """The probability that one of FITS is right, and the conclusion after it was asked; `p_fit` of each model."""
    best = FITS[int(np.argmax(weights))]
    made = SimpleNamespace(
        fits=FITS,
        weights=np.asarray(weights),
        best=best,
        diagnosed=FITS[0] if other else best,
        search=SimpleNamespace(evidence=SimpleNamespace(whitening=SimpleNamespace(guessed=guessed))),
        elsewhere=lambda fit: None,
        tests=lambda fit, moved: SimpleNamespace(p_fit=p_fit[fit.name]),
    )
    return Conclusion.reconsidered(cast("Conclusion", made)), made


def test_one_of_the_likely_models_is_right_by_the_mean_of_their_odds() -> None:
    """Odds 0.25, 4 and 9, weighed by 0.6, 0.3 and 0.08 of 0.98."""
    found, made = reconsidered(REFUTED)
    odds = (0.6 * 0.25 + 0.3 * 4.0 + 0.08 * 9.0) / 0.98
    assert found == pytest.approx(odds / (1.0 + odds), rel=1e2 * ROUNDOFF)
    assert made.best.name == "first @ place + second @ place"
    assert made.diagnosed is made.best
    assert made.values.best is made.best
    assert made.weights == pytest.approx(np.array([0.0, 0.15, 1.2, 0.72, 0.0]) / 2.07, rel=1e2 * ROUNDOFF)


@pytest.mark.parametrize(
    ("p_fit", "more"),
    [
        (REFUTED | {"first @ place": 0.6}, {}),  # the likeliest is believed
        (REFUTED | {"first @ place + second @ place": 0.5, "first @ place + third @ place": 0.5}, {}),  # none of them is
        (REFUTED, {"weights": [0.0, 1.0 - LISTED, 0.5 * LISTED, 0.5 * LISTED, 0.0]}),  # no other is likely
        (REFUTED | {"clock @ all": 0.2}, {"weights": [0.0, 0.2, 0.1, 0.0, 0.7]}),  # of a log that is late alone nothing is asked
        (REFUTED, {"guessed": True}),
        (REFUTED, {"other": True}),  # new conditions have chosen: the lower of two counts
    ],
)
def test_nothing_changes_where_that_does_not_help(p_fit: Mapping[str, float], more: dict[str, Any]) -> None:
    found, made = reconsidered(p_fit, **more)
    weights = more.get("weights", WEIGHTS)
    assert found is None
    assert made.best is FITS[int(np.argmax(weights))]
    assert np.array_equal(made.weights, weights)
