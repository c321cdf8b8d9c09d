"""Probabilities of sets of effects: before the data by counting all sets of small catalogues, after them by Bayes."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.special import expit

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.inference.estimation import Fit, Model
from robomill.diagnosis.inference.priors import ANOTHER, NOTHING, log_posteriors, log_priors, probabilities
from tests.diagnosis.inference.test_estimation import candidate
from tests.tolerances import ROUNDOFF

CANDIDATES = tuple(
    candidate(f"{effect}{i}", effect, locations=n) for effect, n in (("play", 2), ("friction", 3), ("gain", 1)) for i in range(n)
)
"""Three kinds of effects at two, three and one places."""
SUMMED = 1e2 * ROUNDOFF
"""Relative: a sum of some hundred numbers."""


def every(candidates: tuple[Candidate, ...]) -> list[Model]:
    """All sets, the empty one too."""
    return [m for k in range(len(candidates) + 1) for m in itertools.combinations(candidates, k)]


def kinds(model: Model) -> int:
    return len({c.effect for c in model})


def counted(m: int, places: tuple[int, ...]) -> float:
    """Probability of m kinds, by the mean over the choices of kinds: of L places 1 - q^L, for no more than L of them can be taken."""
    q = ANOTHER
    of = [math.prod(1.0 - q**n for n in chosen) for chosen in itertools.combinations(places, m)]
    return (1.0 - NOTHING) * (1.0 - q) * q ** (m - 1) * sum(of) / len(of)


def total(models: list[Model], candidates: tuple[Candidate, ...]) -> float:
    return sum(map(math.exp, log_priors(models, candidates)))


class TestBefore:
    def test_all_sets_of_so_many_kinds_have_the_probability_of_that_number_but_for_places_that_there_are_not(self) -> None:
        assert total([()], CANDIDATES) == pytest.approx(NOTHING, rel=ROUNDOFF)
        for m in (1, 2, 3):
            found = total([model for model in every(CANDIDATES) if kinds(model) == m], CANDIDATES)
            assert found == pytest.approx(counted(m, (2, 3, 1)), rel=SUMMED)

    @pytest.mark.parametrize("n", [2, 3, 4])
    def test_all_sets_together_have_one_but_for_the_tails_of_both_geometric_series(self, n: int) -> None:
        """N kinds at n places each: what is missing are more kinds than there are, q^n, and in each kind more places, q^n again."""
        made = tuple(candidate(f"{kind}{i}", f"kind {kind}", locations=n) for kind in range(n) for i in range(n))
        sizes = [(sum(1 for c in m if c.effect == "kind 0"), len(m)) for m in every(made[:n])]
        assert len(sizes) == 2**n
        if n < 4:  # 65536 sets of the largest
            found = total(every(made), made)
            assert found == pytest.approx(NOTHING + sum(counted(m, (n,) * n) for m in range(1, n + 1)), rel=SUMMED)
        q = ANOTHER
        known = NOTHING + sum(counted(m, (n,) * n) for m in range(1, n + 1))
        assert 1.0 - (1.0 - NOTHING) * (q**n + sum((1.0 - q) * q ** (m - 1) * m * q**n for m in range(1, n + 1))) <= known < 1.0

    def test_sets_of_as_many_kinds_and_places_are_equally_likely(self) -> None:
        play, rubbing = CANDIDATES[:2], CANDIDATES[2:5]
        one = log_priors([(p, r) for p in play for r in rubbing], CANDIDATES)
        assert one == pytest.approx([one[0]] * 6, rel=ROUNDOFF)
        pairs = log_priors(list(itertools.combinations(rubbing, 2)), CANDIDATES)
        assert pairs == pytest.approx([pairs[0]] * 3, rel=ROUNDOFF)

    def test_one_kind_in_all_joints_is_likelier_than_as_many_kinds(self) -> None:
        """Friction in six joints is one idea, not six surprises."""
        made = tuple(candidate(f"{kind}{i}", f"kind {kind}", locations=6) for kind in range(6) for i in range(6))
        same, other = log_priors([made[:6], made[::7]], made)
        assert math.exp(same) == pytest.approx((1.0 - NOTHING) * 0.5 / 6 * 0.5 * 0.5**5, rel=SUMMED)
        assert math.exp(other) == pytest.approx((1.0 - NOTHING) * 0.5 * 0.5**5 * (0.5 / 6) ** 6, rel=SUMMED)
        assert same > other + 10.0

    def test_places_that_do_nothing_here_count_too(self) -> None:
        """An effect with three places of which one is looked at is there with a third of its probability."""
        (alone,) = log_priors([(CANDIDATES[2],)], CANDIDATES[2:3])
        assert math.exp(alone) == pytest.approx((1.0 - NOTHING) * (1.0 - ANOTHER) ** 2 / 3.0, rel=SUMMED)


class TestAfter:
    def fits(self) -> list[Fit]:
        rng = np.random.default_rng(2)
        return [Fit(m, {}, {}, 0.0 if not m else float(rng.normal(scale=3.0)), 0.0) for m in every(CANDIDATES)[:30]]

    def test_they_are_evidence_times_prior_over_the_sum_of_that(self) -> None:
        fits = self.fits()
        weights = [math.exp(f.log_evidence + p) for f, p in zip(fits, log_priors([f.model for f in fits], CANDIDATES), strict=True)]
        assert np.exp(log_posteriors(fits, CANDIDATES)) == pytest.approx(np.array(weights), rel=SUMMED)
        found = probabilities(fits, CANDIDATES)
        assert found == pytest.approx(np.array(weights) / sum(weights), rel=SUMMED)
        assert float(found.sum()) == pytest.approx(1.0, rel=SUMMED)

    def test_of_two_models_it_is_the_logistic_function_of_their_log_odds(self) -> None:
        nominal, effect = Fit((), {}, {}, 0.0, 0.0), Fit(CANDIDATES[:1], {}, {}, 4.0, 0.0)
        odds = 4.0 + math.log((1.0 - NOTHING) * (1.0 - ANOTHER) ** 2 / (3 * 2) / NOTHING)
        assert probabilities([nominal, effect], CANDIDATES)[1] == pytest.approx(expit(odds), rel=SUMMED)

    def test_the_order_of_the_models_does_not_matter_and_an_overwhelming_one_has_all(self) -> None:
        fits = [Fit((c,), {}, {}, evidence, 0.0) for c, evidence in zip(CANDIDATES, (3.0, 1e4, 5.0, 2.0, 1.0, 0.0), strict=True)]
        assert probabilities(fits, CANDIDATES).tolist() == pytest.approx([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], abs=ROUNDOFF)
        assert probabilities(fits[::-1], CANDIDATES).tolist() == probabilities(fits, CANDIDATES).tolist()[::-1]
