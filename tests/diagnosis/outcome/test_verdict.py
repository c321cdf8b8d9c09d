"""Two tests and the posterior: which of the answers it is."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.special import expit

from robomill.diagnosis.candidates import LOGGING, Candidate
from robomill.diagnosis.inference.adequacy import EXACT, FALSE_ALARM, LEVEL, MISFIT, UNKNOWN, kept, left_by, together, unless
from robomill.diagnosis.inference.estimation import Fit, Space
from robomill.diagnosis.inference.time_varying import Changing
from robomill.diagnosis.inference.transfer import Transfer
from robomill.diagnosis.outcome import verdict
from robomill.diagnosis.outcome.verdict import IDENTIFIED, UNLISTED, believed, changes, judged
from tests.diagnosis.demo import catalogue
from tests.diagnosis.formula import candidate
from tests.diagnosis.inference.test_adequacy import QUADRATURE
from tests.tolerances import ROUNDOFF

EXPECTED = 1000.0
SURE = verdict.Tests(0.02, 0.001, 0.98, 0.001)
STEADY = (0.0, 0.0)
"""Scatter of repeats, over what the nominal system and the model scatter: of models of which it is not asked."""


def search(candidates: tuple[Candidate, ...] = (), explainable: float = 0.0, guess: float = 1.0, chance: float = 0.0) -> Any:
    """A residual of one number, which is its level; all candidates together can explain so much of any."""
    evidence = SimpleNamespace(
        noise=EXPECTED,
        space=Space(np.zeros(1), {"all": slice(0, 1)}, np.zeros((1, 0))),
        level=lambda left: float(left[0]),
        levels=lambda left: np.array([[left[0]]]),
        guess=guess,
    )
    none = [], np.zeros(0), np.zeros((0, 0))
    made = SimpleNamespace(
        candidates=candidates, evidence=evidence, explainable=lambda _: explainable, numbers=lambda _: none, imitates=lambda *_: chance
    )
    return cast(Any, made)


def fit(left: float, model: tuple[Candidate, ...] = ()) -> Fit:
    """A model with effects of their usual size that leaves so many times what noise does."""
    values = {a: c.prior.scale for c in model for a in c.addresses}
    return Fit(model, values, {}, 0.0, EXPECTED * left, np.array([-left]))


class TestTested:
    def test_the_scatter_of_repeats_speaks_for_a_model_that_explains_it_and_refutes_one_that_does_not(self) -> None:
        """The mean has no gap: what it leaves says nothing."""
        effect = (candidate("drawn"),)
        right, wrong, unasked = (
            verdict.tested(search(), fit(1.0), fit(1.0, effect), 0.001, 0.001, None, 0.02, scatter).p_fit
            for scatter in ((20.0, 1.1), (20.0, 12.0), STEADY)
        )
        assert wrong < 0.1 < unasked < 0.9 < right

    @pytest.mark.parametrize("nothing", [0.5, 0.02, 1e-9])
    @pytest.mark.parametrize(("before", "after"), [(9.0, 1.2), (1.3, 1.1), (9.0, 5.0)])
    def test_without_new_conditions_they_are_those_of_the_diagnosed_runs(
        self, tmp_path: Path, nothing: float, before: float, after: float
    ) -> None:
        effect = catalogue(tmp_path).candidates[:1]
        found = verdict.tested(search(), fit(before), fit(after, effect), nothing, 0.3, None, 0.05, STEADY)
        assert (found.false_alarm, found.p_none) == (0.05, 0.3)
        assert found.p_fit == pytest.approx(expit(math.log((1.0 - UNLISTED) / UNLISTED) + left_by(before, after)), rel=1e4 * ROUNDOFF)
        assert found.nothing == pytest.approx(nothing, rel=1e3 * ROUNDOFF)

    def test_new_conditions_add_their_gain_to_the_odds_and_their_worth_to_the_fit(self, tmp_path: Path) -> None:
        effect = catalogue(tmp_path).candidates[:1]
        moved = Transfer(4.0, 1.5, -3.0, 20.0, 0.1, 0.6, 0.1)
        found = verdict.tested(search(), fit(9.0), fit(1.3, effect), 0.02, 0.01, moved, 0.02, STEADY)
        assert found.nothing == pytest.approx(expit(-(math.log(0.98 / 0.02) - 3.0)), rel=1e2 * ROUNDOFF)
        odds = math.log((1.0 - UNLISTED) / UNLISTED) + left_by(9.0, 1.3) + kept(moved.holds) + moved.loses
        assert found.p_fit == pytest.approx(expit(odds), rel=1e2 * ROUNDOFF)

    def test_what_is_closed_here_is_no_merit_where_more_is_left_elsewhere(self, tmp_path: Path) -> None:
        """Nothing is left of a gap of 90 here, and a seventh of one of 70 in new conditions: as if a seventh was left here."""
        effect = catalogue(tmp_path).candidates[:1]
        little, much = (Transfer(70.0, after, 100.0, 100.0, 0.02, 1.0, 0.02) for after in (1.3, 11.0))
        found = [verdict.tested(search(), fit(90.0), fit(1.3, effect), 0.001, 0.001, m, 0.02, STEADY).p_fit for m in (little, much)]
        assert found[0] > 0.9
        assert found[1] < 0.3
        odds = math.log((1.0 - UNLISTED) / UNLISTED) + left_by(90.0, 1.3) + kept(much.promise) + left_by(70.0, 11.0) - left_by(70.0, 1.3)
        assert found[1] == pytest.approx(expit(odds), rel=1e2 * ROUNDOFF)
        guessed = search()  # where noise is a guess, what is left there counts by itself
        guessed.evidence.guess = 5.0
        apart = verdict.tested(guessed, fit(90.0), fit(1.3, effect), 0.001, 0.001, much, 0.02, STEADY).p_fit
        assert apart == pytest.approx(expit(odds + left_by(70.0, 1.3)), rel=1e2 * ROUNDOFF)

    def test_what_is_left_of_several_conditions_is_that_of_the_worst_one(self, tmp_path: Path) -> None:
        effect = catalogue(tmp_path).candidates[:1]
        several = search()
        several.evidence.space = Space(np.zeros(7), {str(i): slice(i, i + 1) for i in range(7)}, np.zeros((7, 0)))
        before, after = (replace(fit(left, m), signature=np.full(7, -left)) for left, m in ((9.0, ()), (2.0, effect)))
        found = verdict.tested(several, before, after, 0.001, 0.001, None, 0.02, STEADY)
        odds = math.log((1.0 - UNLISTED) / UNLISTED) + left_by(9.0, 2.0, conditions=7)
        assert found.p_fit == pytest.approx(expit(odds + kept(verdict.held_together(several, after))), rel=1e2 * ROUNDOFF)

    @pytest.mark.parametrize("made", [0.0, 1.0, 9.0])
    def test_what_a_model_makes_worse_elsewhere_speaks_against_it(self, tmp_path: Path, made: float) -> None:
        """Two channels: the gap of one is closed, in the other there was none, and the model does 30 times there what noise does."""
        effect = catalogue(tmp_path).candidates[:1]
        two = search()
        two.evidence.space = Space(np.zeros(2), {"all": slice(0, 2)}, np.zeros((2, 0)))
        two.evidence.level = lambda left: float(left.max())
        two.evidence.levels = lambda left: left[None]
        two.evidence.does = lambda signature: np.full((1, 2), 30.0)
        before, after = (replace(fit(0.0, m), signature=-np.array(left)) for m, left in (((), (60.0, 1.0)), (effect, (1.0, LEVEL + made))))
        found = verdict.tested(two, before, after, 0.001, 0.001, None, 0.02, STEADY)
        odds = math.log((1.0 - UNLISTED) / UNLISTED)
        odds += together(left_by(60.0, LEVEL + made, conditions=1), left_by(30.0, LEVEL + made, conditions=1))
        assert found.p_fit == pytest.approx(expit(odds), rel=1e2 * ROUNDOFF)
        assert (found.p_fit > IDENTIFIED) is (made < 9.0)

    def test_a_fault_of_the_log_must_leave_less(self, tmp_path: Path) -> None:
        clock = tuple(c for c in catalogue(tmp_path).candidates if c.component == LOGGING)[:1]
        effect = catalogue(tmp_path).candidates[:1]
        exact, other = (
            verdict.tested(search(), fit(50.0), fit(3.0, model), 0.0, 0.001, None, 0.02, STEADY).p_fit for model in (clock, effect)
        )
        assert exact == pytest.approx(expit(math.log((1.0 - UNLISTED) / UNLISTED) + left_by(50.0, 3.0, EXACT)), rel=1e2 * ROUNDOFF)
        assert exact < other

    @pytest.mark.parametrize(("nothing", "says"), [(0.0, 0.0), (1.0, 1.0)])
    def test_a_probability_that_is_none_or_all_stays_that(self, nothing: float, says: float) -> None:
        for moved in (None, Transfer(1.0, 1.0, 5.0, 5.0)):
            assert verdict.tested(search(), fit(1.0), fit(1.0), nothing, 1.0, moved, 0.02, STEADY).nothing == says


@pytest.mark.parametrize(
    ("p_none", "nothing", "there"),
    [(0.001, 0.001, True), (0.02, 0.02, True), (0.021, 0.001, False), (0.001, 0.021, False), (1.0, 1.0, False)],
)
def test_an_effect_is_believed_where_both_are_at_most_the_false_alarm_rate(p_none: float, nothing: float, there: bool) -> None:
    assert believed(verdict.Tests(0.02, p_none, 0.9, nothing)) is there


def test_the_false_alarm_rate_is_the_users() -> None:
    faint = verdict.Tests(0.02, 0.04, 0.9, 0.04)
    assert not believed(faint)
    assert believed(replace(faint, false_alarm=0.05))
    assert not believed(replace(SURE, false_alarm=1e-4))


@pytest.mark.parametrize(("level", "explainable", "says"), [(1.2, 0.8, 1.2), (1.2, 5.0, 5.0)])
def test_a_model_is_looked_at_by_its_worst_array_and_by_what_the_catalogue_could_still_explain(
    level: float, explainable: float, says: float
) -> None:
    assert verdict.over_noise(search(explainable=explainable), fit(level)) == says


@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_of_several_kinds_of_effects_that_were_fitted_together_less_must_be_left(tmp_path: Path, count: int) -> None:
    first = catalogue(tmp_path).candidates[0]
    model = tuple(replace(first, effect=f"kind {k}") for k in range(count))
    for left in (1.0, 2.0):
        found = verdict.tested(search(), fit(9.0), fit(left, model), 0.001, 0.001, None, 0.02, STEADY)
        odds = math.log((1.0 - UNLISTED) / UNLISTED) + left_by(9.0, left, MISFIT, count)
        assert found.p_fit == pytest.approx(expit(odds), rel=1e2 * ROUNDOFF)
    alone = verdict.tested(search(), fit(1.0), fit(1.0, model), 0.001, 0.001, None, 0.02, STEADY)
    assert alone.p_fit == pytest.approx(1.0 - UNLISTED, rel=QUADRATURE)  # where there is no gap, nothing is left of one


@pytest.mark.parametrize("chance", [0.2, 0.9])
def test_what_a_model_leaves_is_worth_no_more_than_the_chance_that_a_stand_in_leaves_as_little(tmp_path: Path, chance: float) -> None:
    model = catalogue(tmp_path).candidates[:1]
    found = verdict.tested(search(chance=chance), fit(90.0), fit(1.0, model), 0.001, 0.001, None, 0.02, STEADY)
    odds = math.log((1.0 - UNLISTED) / UNLISTED) + unless(left_by(90.0, 1.0), chance)
    assert found.p_fit == pytest.approx(expit(odds), rel=1e2 * ROUNDOFF)
    assert 1.0 - UNLISTED < found.p_fit < expit(math.log((1.0 - UNLISTED) / UNLISTED / chance))


def steady() -> None:
    """Nothing changes with time."""


class TestJudged:
    def test_what_changes_with_time_is_looked_for_only_beside_a_model_that_is_believed(self, tmp_path: Path) -> None:
        (effect, *_) = catalogue(tmp_path).candidates
        asked = []
        for tests in (SURE, replace(SURE, p_fit=0.1), replace(SURE, p_none=0.5)):
            judged(search(), tests, fit(9.0), fit(1.1, (effect,)), lambda tests=tests: asked.append(tests), {effect: 0.95}, False)
        assert asked == [SURE]

    def judged(self, tests: verdict.Tests = SURE, before: float = 9.0, *, p: float = 0.95, faulty: bool = False, folder: Path) -> str:
        model = catalogue(folder).candidates[:2]
        return judged(search(), tests, fit(before), fit(1.1, model), steady, {model[0]: 0.95, model[1]: p}, faulty)

    def test_an_effect_that_is_not_believed_is_none_or_a_gap_that_no_candidate_explains(self, tmp_path: Path) -> None:
        for tests in (replace(SURE, p_none=0.5), replace(SURE, nothing=0.5)):  # judged by the nominal system's level
            assert self.judged(tests, LEVEL, folder=tmp_path) == "none"
            assert self.judged(tests, 1.01 * UNKNOWN, folder=tmp_path) == "unknown"
        assert judged(search(), SURE, fit(1.0), fit(1.0), steady, {}, False) == "none"
        assert judged(search(), SURE, fit(1.1 * UNKNOWN), fit(1.1 * UNKNOWN), steady, {}, False) == "unknown"

    def test_a_nominal_system_that_is_no_likelier_right_than_something_unlisted_is_not_none(self) -> None:
        """By what it leaves where noise is known, and by its calibrated numbers: one is 8 deviations off, or half of one."""
        prior = math.log((1.0 - UNLISTED) / UNLISTED)
        for level in (1.5, 1.8):  # below UNKNOWN
            says = "none" if prior + left_by(level, level) > 0.0 else "unknown"
            assert judged(search(), SURE, fit(level), fit(level), steady, {}, False) == says
            assert judged(search(guess=3.0), SURE, fit(level), fit(level), steady, {}, False) == "none"
        assert prior + left_by(1.5, 1.5) > 0.0 > prior + left_by(1.8, 1.8)
        for off, says in ((0.5, "none"), (8.0, "unknown")):
            made = search()
            made.numbers = lambda fit, off=off: ([], np.array([off]), np.array([[0.1]]))
            assert judged(made, SURE, fit(1.0), fit(1.0), steady, {}, False) == says

    def test_a_gap_in_new_conditions_is_one(self, tmp_path: Path) -> None:
        model = catalogue(tmp_path).candidates[:1]
        unsure = replace(SURE, p_none=0.5)
        for before, says in ((0.99 * UNKNOWN, "none"), (1.01 * UNKNOWN, "unknown")):
            moved = Transfer(before, 1.0, 0.0, 0.0)
            assert judged(search(), unsure, fit(1.0), fit(1.0, model), steady, {model[0]: 0.95}, False, moved=moved) == says

    @pytest.mark.parametrize("level", [0.5 * UNKNOWN, 2.0 * UNKNOWN])
    def test_an_effect_that_is_believed_and_refuted_is_unknown_however_little_it_does(self, level: float, tmp_path: Path) -> None:
        """Few machines without effects look like this one: something is there, and it is not what is listed."""
        assert self.judged(replace(SURE, p_fit=0.3), level, folder=tmp_path) == "unknown"
        unsure = replace(SURE, p_fit=0.3, p_none=0.5)
        assert self.judged(unsure, level, folder=tmp_path) == ("none" if level < UNKNOWN else "unknown")

    def test_where_something_differs_from_run_to_run_it_is_not_none(self, tmp_path: Path) -> None:
        model = catalogue(tmp_path).candidates[:1]
        for differs, says in ((False, "none"), (True, "unknown")):
            assert judged(search(), SURE, fit(1.0), fit(1.0), steady, {}, False, differs) == says
            assert judged(search(), SURE, fit(9.0), fit(1.1, model), steady, {model[0]: 0.95}, False, differs) == "identified"

    def test_where_noise_is_a_guess_an_effect_within_it_is_none(self, tmp_path: Path) -> None:
        model = catalogue(tmp_path).candidates[:2]
        for guess, p_fit, says in ((1.0, 0.99, "identified"), (3.0, 0.99, "none"), (3.0, 0.3, "none")):
            tests, probable = replace(SURE, p_fit=p_fit), dict.fromkeys(model, 0.95)
            assert judged(search(guess=guess), tests, fit(0.99 * UNKNOWN), fit(1.1, model), steady, probable, False) == says
        assert (
            judged(search(guess=3.0), SURE, fit(1.01 * UNKNOWN), fit(1.1, model), steady, dict.fromkeys(model, 0.95), False) == "identified"
        )

    def test_calibrated_numbers_that_are_far_off_are_a_gap_where_noise_is_a_guess(self, tmp_path: Path) -> None:
        """What they take of it is no noise: an effect that is believed beside them is named."""
        model = catalogue(tmp_path).candidates[:1]
        for off, says in ((0.5, "none"), (8.0, "identified")):
            made = search(guess=3.0)
            made.numbers = lambda fit, off=off: ([], np.array([0.0 if fit.model else off]), np.array([[0.1]]))
            assert judged(made, SURE, fit(1.0), fit(1.0, model), steady, {model[0]: 0.95}, False) == says

    def test_a_model_that_is_rather_a_stand_in_is_unknown_be_it_as_likely_as_it_may(self, tmp_path: Path) -> None:
        assert self.judged(replace(SURE, p_fit=0.49), folder=tmp_path) == "unknown"
        assert self.judged(replace(SURE, p_fit=0.49), faulty=True, folder=tmp_path) == "unknown"
        assert self.judged(replace(SURE, p_fit=0.51), folder=tmp_path) == "identified"

    def test_an_effect_at_its_bound_is_unknown(self, tmp_path: Path) -> None:
        effect = catalogue(tmp_path).candidates[0]
        for size, said in ((effect.maximum, "unknown"), (0.99 * effect.maximum, "identified")):
            best = replace(fit(1.1, (effect,)), values=dict.fromkeys(effect.addresses, size))
            assert judged(search(), SURE, fit(9.0), best, steady, {effect: 0.95}, False) == said

    def test_one_answer_is_given_where_each_of_its_effects_is_likely(self, tmp_path: Path) -> None:
        assert self.judged(p=0.81, folder=tmp_path) == "identified"
        assert self.judged(p=0.79, folder=tmp_path) == "ambiguous"
        assert self.judged(faulty=True, folder=tmp_path) == "bad_log"


@pytest.mark.parametrize(
    ("by_change", "odds", "left", "there"),
    [
        (20.0, 1.3, LEVEL, True),  # creep that looks like hysteresis
        (20.0, 0.3, LEVEL, False),  # what is in no catalogue has the odds UNLISTED before the data, which is -0.4 nats
        (62.0, 40.0, 20.0, False),  # a runout leaves much at this step, and a part of it goes with time
        (600.0, 40.0, 20.0, True),
    ],
)
def test_what_changes_with_time_must_be_likelier_and_a_good_part_of_what_is_left(
    tmp_path: Path, by_change: float, odds: float, left: float, there: bool
) -> None:
    """MISFIT of 19 times the noise, which is what is beyond it, is 950, of which half: 475 nats."""
    of = search(catalogue(tmp_path).candidates)
    prior = math.log(0.3)  # of no effect
    other = Changing(of.candidates[0], "grows", odds + prior, by_change)
    assert changes(of, fit(left), other) is there
    assert 62.0 < 0.5 * MISFIT * (20.0 - 1.0) * EXPECTED < 600.0


def test_the_rate_that_is_used_unless_the_user_says_otherwise() -> None:
    assert FALSE_ALARM == 0.02


def late(source: str, scale: float = 0.03) -> Candidate:
    """A clock of the log."""
    clock = candidate("lag", scale=scale)
    return replace(clock, effect="clock", component=LOGGING, location=source, parameters=(f"lag {source}.*",))


@pytest.mark.parametrize(
    ("lags", "sources", "says"),
    [
        ((2.40e-3, 2.39e-3), 3, True),  # what the drive does is in all that is behind it
        ((2.4e-3, 8.0e-3), 3, False),  # two clocks
        ((2.4e-3,), 3, False),
        ((2.4e-3, 8.0e-3, 2.39e-3), 4, True),
        ((2.40e-3, 2.39e-3), 2, False),  # all that was measured: the log as a whole
    ],
)
def test_a_lag_that_several_sources_have_in_common_is_the_machine_s(lags: tuple[float, ...], sources: int, says: bool) -> None:
    clocks = [late(f"source {k}") for k in range(sources)]
    model = tuple(clocks[: len(lags)])
    values = {c.addresses[0]: lag for c, lag in zip(model, lags, strict=True)}
    best = replace(fit(1.0, model), values=values, deviations=dict.fromkeys(values, 3e-5))
    looked = search()
    looked.candidates = clocks
    assert (verdict.common_lag(looked, best) > 4.0) == says
    assert verdict.common_lag(looked, best) > 4.0 or verdict.common_lag(looked, best) < -4.0
    found = verdict.tested(looked, fit(9.0), best, 0.001, 0.001, None, 0.02, STEADY)
    alone = verdict.tested(looked, fit(9.0), replace(best, model=model[:1]), 0.001, 0.001, None, 0.02, STEADY)
    assert alone.p_fit > 0.9
    assert (found.p_fit < 0.02) == says
    assert says or found.p_fit > 0.9
