"""Leave-one-condition-out log scores: what is right predicts the other condition, what only stands in for it does not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.outcome.answer import Diagnosis
from tests.diagnosis.demo import SYSTEM, catalogue, measure, resolve

APART = 0.15
"""Relative: the score is linear about the best values, friction is not; and nuisances are moved in each condition for itself, by the
nominal system, too, which the evidence lets move them once."""


def answer(folder: Path, truth: Any, amplitudes: tuple[float, ...]) -> Diagnosis:
    runs = [r for k, a in enumerate(amplitudes) for r in measure(truth, amplitude=a, seed=3 + k)]
    return diagnose(SYSTEM, runs, catalogue(folder), resolver=resolve)


def test_the_right_effect_gains_on_every_condition_that_it_was_not_fitted_to_and_more_than_others(tmp_path: Path) -> None:
    found = answer(tmp_path, {"masses": {"friction[1]": 0.03}}, (1.0, 0.6))
    gains = found.result["predictive"]
    right = gains.pop("friction @ mass 1")
    assert set(right) == {"amplitude 1.0", "amplitude 0.6"}
    assert min(right.values()) > 100.0
    assert gains
    for other in gains.values():
        assert all(other[c] < right[c] for c in right)
    # what one condition says is what the other confirms: the score is about the evidence, which both have fitted
    (fit,) = (f for f in found.fits if f.name == "friction @ mass 1")
    assert sum(right.values()) == pytest.approx(fit.log_evidence, rel=APART)


def test_an_effect_that_stands_in_for_another_loses_where_it_was_not_fitted(tmp_path: Path) -> None:
    # a spring that hardens looks softer or stiffer, but not equally so for small and for large motions
    found = answer(tmp_path, {"masses": {"cubic": 2000.0}}, (1.0, 0.3))
    assert found.result["verdict"] == "unknown"
    gains = found.result["predictive"]
    assert gains
    assert all(g["amplitude 1.0"] > 100.0 and g["amplitude 0.3"] < -100.0 for g in gains.values())


def test_nothing_is_predicted_where_nothing_is_wrong(tmp_path: Path) -> None:
    found = answer(tmp_path, None, (1.0, 0.6))
    assert found.result["verdict"] == "none"
    assert all(abs(g) < 3.0 for f in found.fits for g in f.predictive.values())


def test_one_condition_has_nothing_to_be_compared_with(tmp_path: Path) -> None:
    assert answer(tmp_path, {"masses": {"friction[1]": 0.03}}, (1.0,)).result["predictive"] == {}
