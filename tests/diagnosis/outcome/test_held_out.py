"""A model of fewer effects is asked in new conditions, too: they are data as the diagnosed runs are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.priors import log_posteriors, probabilities
from robomill.diagnosis.outcome import conclusion
from robomill.diagnosis.outcome.conclusion import Conclusion
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import SYSTEM, catalogue, measure, resolve
from tests.diagnosis.formula import candidate
from tests.tolerances import ROUNDOFF

STRONG, SECOND, THIRD, OTHER = (candidate(name) for name in ("strong", "second", "third", "other"))
FITS = [
    Fit(model, {}, {}, evidence, 0.0)
    for model, evidence in (((), 0.0), ((STRONG,), 900.0), ((STRONG, SECOND), 1000.0), ((STRONG, SECOND, THIRD), 990.0), ((OTHER,), 700.0))
]
NAMES = [f.name for f in FITS]
BEST, FEWER = (frozenset(FITS[i].model) for i in (2, 1))


def weighed(gains: Mapping[frozenset[Any], float | None]) -> tuple[FloatArray, list[frozenset[Any]]]:
    """Probability of each of FITS where models have these gains in new conditions, and of which models that was asked."""
    asked = []

    def transfer(fit: Fit) -> SimpleNamespace | None:
        asked.append(frozenset(fit.model))
        gain = gains.get(frozenset(fit.model))
        return None if gain is None else SimpleNamespace(gain=gain)

    weights = probabilities(FITS, [STRONG, SECOND, THIRD, OTHER])
    search = SimpleNamespace(candidates=[STRONG, SECOND, THIRD, OTHER])
    made = SimpleNamespace(fits=FITS, weights=weights, best=FITS[int(weights.argmax())], search=search, transfer=transfer)
    return Conclusion.held_out(cast("Conclusion", made)), asked


@pytest.mark.parametrize("loss", [95.0, 105.0])
def test_an_effect_is_out_that_costs_more_in_new_conditions_than_it_gains_in_the_diagnosed_runs(loss: float) -> None:
    weights, asked = weighed({BEST: 300.0, FEWER: 300.0 + loss})
    scores = log_posteriors(FITS, [STRONG, SECOND, THIRD, OTHER])
    gained = float(scores[2] - scores[1])
    assert 95.0 < gained < 105.0
    assert NAMES[int(weights.argmax())] == ("strong @ place" if loss > gained else "strong @ place + second @ place")
    assert math.log(weights[1] / weights[2]) == pytest.approx(loss - gained, rel=1e4 * ROUNDOFF)
    assert asked == [BEST, FEWER]  # nothing is simulated for others


def test_an_effect_that_holds_in_new_conditions_is_as_sure_as_both_say() -> None:
    before, _ = weighed({})
    after, _ = weighed({BEST: 300.0, FEWER: 100.0})
    assert math.log(after[2] / after[1]) == pytest.approx(math.log(before[2] / before[1]) + 200.0, rel=1e4 * ROUNDOFF)
    assert after[3] == pytest.approx(before[3], rel=1e4 * ROUNDOFF)  # one with another effect does there as the best


@pytest.mark.parametrize("gains", [{}, {BEST: 300.0}, {FEWER: 900.0}])
def test_nothing_changes_where_one_of_them_cannot_be_asked(gains: Mapping[frozenset[Any], float | None]) -> None:
    assert weighed(gains)[0] == pytest.approx(weighed({})[0], rel=1e4 * ROUNDOFF)


@pytest.mark.parametrize(("elsewhere", "named"), [(0.0, ["stiffness"]), (0.012, ["stiffness", "friction"])])
def test_what_is_only_in_the_diagnosed_runs_is_not_named_beside_a_strong_effect(tmp_path: Path, elsewhere: float, named: list[str]) -> None:
    """Without it the whole model leaves half a percent of the gap in new conditions, as a right law may; both were named with 0.998."""
    soft = {"stiffness_error[1]": 0.08}
    new = {"masses": {**soft, "friction[1]": elsewhere}}
    held_out = measure(new, amplitude=0.6, repeats=2, seed=2) + measure(new, amplitude=0.8, repeats=2, seed=3)
    result = diagnose(
        SYSTEM, measure({"masses": {**soft, "friction[1]": 0.012}}), catalogue(tmp_path), held_out=held_out, resolver=resolve
    ).result
    assert result["verdict"] == "identified"
    assert [w["effect"] for w in result["which"]] == named
    assert result["transfer"]["gain"] > 0.0


@pytest.mark.parametrize(("one", "two"), [(0.95, 0.7), (0.7, 0.95)])
def test_what_takes_an_effect_out_makes_no_surer_of_the_others(
    one: float, two: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """New conditions chose the model: that it holds there is no test of it. The one by the diagnosed runs is asked, too."""
    says = {"stiffness @ spring 1": one, "stiffness @ spring 1 + friction @ mass 1": two}
    judged_by = conclusion.tested

    def tested(search: Any, nominal: Fit, best: Fit, *others: Any) -> Any:
        return replace(
            judged_by(search, nominal, best, *others), p_fit=says.get(best.name, 0.0)
        )  # of a number of the model nothing is believed

    monkeypatch.setattr(conclusion, "tested", tested)
    new = {"masses": {"stiffness_error[1]": 0.08}}
    held_out = measure(new, amplitude=0.6, repeats=2, seed=2) + measure(new, amplitude=0.8, repeats=2, seed=3)
    both = {"masses": {"stiffness_error[1]": 0.08, "friction[1]": 0.012}}
    result = diagnose(SYSTEM, measure(both), catalogue(tmp_path), held_out=held_out, resolver=resolve).result
    assert [w["effect"] for w in result["which"]] == ["stiffness"]
    assert result["tests"]["p_fit"] == 0.7
    assert result["which"][0]["probability"] <= 0.7
