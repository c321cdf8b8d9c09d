"""A right model against a stand-in, by what it leaves: against integrals."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.stats import beta, cauchy, gamma, multivariate_normal, norm

from robomill.diagnosis.candidates import LOGGING
from robomill.diagnosis.inference.adequacy import (
    CONDITIONS,
    EXACT,
    HOLDS,
    KEEPS,
    LEVEL,
    MISFIT,
    MISJUDGED,
    SPREAD,
    agreement,
    beyond,
    by_chance,
    kept,
    left_by,
    misfit,
    most_left,
    together,
    unexplained,
    unless,
    within_tolerances,
    worsened,
)
from robomill.diagnosis.inference.estimation import Fit, Model, Space
from robomill.diagnosis.inference.evidence import TRUST
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.inference.test_estimation import candidate
from tests.tolerances import ROUNDOFF

QUADRATURE = 0.05
"""nats: a factor 1.05 on odds, of which none that decides is known so well."""
GAPS = (LEVEL + SPREAD, 2.0, 5.0, 50.0, 5000.0)


def fitted(model: Model) -> Fit:
    """A model whose effects are as large as is usual; what they do is not known."""
    return Fit(model, {a: c.prior.scale for c in model for a in c.addresses}, {}, 0.0, 0.0)


def right_density(u: FloatArray, share: float) -> FloatArray:
    """Density of what a right model leaves: of Beta(1, 1 / m - 1), integrated over log m between TRUST^2 and `share`."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    m = TRUST**2 * (share / TRUST**2) ** (0.5 * (nodes + 1.0))
    return np.asarray(0.5 * weights @ beta.pdf(np.minimum(u, 1.0 - 1e-15), 1.0, 1.0 / m[:, None] - 1.0))


def integrated(before: float, after: float, share: float, kinds: int = 1, levels: float = 1.0) -> float:
    """Log of the ratio of the integrals over the share that is left, with the density of a right model and with Beta(1, 2 kinds - 1).

    What is left is the largest of so many `levels`.
    """
    gap = before - LEVEL
    centre, width = (after - LEVEL) / gap, SPREAD / gap
    finely = np.concatenate([np.linspace(0.0, 1.0, 4001), np.geomspace(1e-8, 1.0, 4001), centre + width * np.linspace(-9, 9, 4001)])
    u = np.unique(np.clip(finely, 0.0, 1.0))
    likelihood = norm.logpdf(u, centre, width) + (levels - 1.0) * norm.logcdf(centre, u, width)
    likelihood = np.exp(likelihood - likelihood.max())
    return math.log(trapezoid(likelihood * right_density(u, share), u)) - math.log(
        trapezoid(likelihood * beta.pdf(u, 1.0, 2 * kinds - 1), u)
    )


@pytest.mark.parametrize("share", [MISFIT, EXACT])
@pytest.mark.parametrize("before", GAPS)
@pytest.mark.parametrize("part", [0.0, 0.01, 0.05, 0.2, 0.5, 0.9])
def test_it_is_the_ratio_of_the_integrals_over_what_may_be_left(share: float, before: float, part: float) -> None:
    after = LEVEL + part * (before - LEVEL)
    assert left_by(before, after, share) == pytest.approx(integrated(before, after, share), abs=QUADRATURE, rel=QUADRATURE)


@pytest.mark.parametrize("kinds", [2, 9])
@pytest.mark.parametrize("before", GAPS)
@pytest.mark.parametrize("part", [0.0, 0.05, 0.2, 0.9])
def test_several_stand_ins_together_leave_the_least_of_twice_as_many_shares_less_one(kinds: int, before: float, part: float) -> None:
    after = LEVEL + part * (before - LEVEL)
    assert left_by(before, after, MISFIT, kinds) == pytest.approx(integrated(before, after, MISFIT, kinds), abs=QUADRATURE)


@pytest.mark.parametrize("conditions", [1, 2, 7, 20])
@pytest.mark.parametrize("before", GAPS)
@pytest.mark.parametrize("part", [0.0, 0.2, 0.9])
def test_the_worst_of_more_conditions_is_the_largest_of_as_many_levels(conditions: int, before: float, part: float) -> None:
    after = LEVEL + part * (before - LEVEL)
    expected = integrated(before, after, MISFIT, levels=max(conditions / CONDITIONS, 1.0))
    assert left_by(before, after, MISFIT, conditions=conditions) == pytest.approx(expected, abs=QUADRATURE)


def test_among_more_conditions_a_little_more_is_no_sign_of_a_stand_in() -> None:
    assert left_by(4.0, LEVEL + 2.0 * SPREAD, conditions=10 * CONDITIONS) > left_by(4.0, LEVEL + 2.0 * SPREAD) + 1.0


@pytest.mark.parametrize("share", [MISFIT, EXACT])
@pytest.mark.parametrize("after", [0.9, LEVEL, 1.3])
def test_where_there_is_no_gap_it_says_nothing(share: float, after: float) -> None:
    assert left_by(LEVEL, after, share) == pytest.approx(0.0, abs=QUADRATURE)
    assert left_by(0.9, after, share) == pytest.approx(0.0, abs=QUADRATURE)


@pytest.mark.parametrize("share", [MISFIT, EXACT])
@pytest.mark.parametrize("before", GAPS)
def test_the_more_is_left_the_less_it_speaks_for_the_model(share: float, before: float) -> None:
    found = [left_by(before, after, share) for after in np.linspace(0.9, before, 40)]
    assert all(b <= a for a, b in itertools.pairwise(found))
    assert found[0] > 0.0 > found[-1]


@pytest.mark.parametrize("share", [MISFIT, EXACT])
@pytest.mark.parametrize("kinds", [1, 4])
def test_a_model_that_leaves_nothing_of_a_large_gap_gains_at_most_the_odds_of_the_densities_there(share: float, kinds: int) -> None:
    """Beta(1, b) has the density b at 0: a right model has the mean of 1 / m - 1 there, where a stand-in has 2 `kinds` - 1."""
    mean = (TRUST**-2 - 1.0 / share) / math.log(share / TRUST**2) - 1.0
    assert left_by(1e7, LEVEL, share, kinds) == pytest.approx(math.log(mean / (2 * kinds - 1)), abs=QUADRATURE)


@pytest.mark.parametrize("kinds", [1, 3])
def test_the_less_room_a_model_leaves_the_likelier_a_stand_in_leaves_nothing_by_chance(kinds: int) -> None:
    """A random direction in r + k dimensions leaves k of them the share Beta(r / 2, k / 2); k / 2 is what `left_by` has measured."""
    found = [by_chance(room, kinds) for room in (-1.0, 0.0, 0.5, 1.0, 1.9, 2.0, 50.0)]
    assert found == sorted(found, reverse=True)
    usual = beta.cdf(MISFIT, 1.0, 2 * kinds - 1)
    assert found[0] == found[1] == pytest.approx(1.0 - usual, rel=1e2 * ROUNDOFF)
    assert found[3] == pytest.approx(beta.cdf(MISFIT, 0.5, 2 * kinds - 1) - usual, rel=1e4 * ROUNDOFF)
    assert found[-2:] == [0.0, 0.0]


@pytest.mark.parametrize("odds", [-3.0, 0.0, 2.0, 30.0])
@pytest.mark.parametrize("chance", [0.0, 0.1, 0.5])
def test_what_may_be_so_by_chance_is_worth_no_more_than_that(odds: float, chance: float) -> None:
    likelihood = chance + (1.0 - chance) * math.exp(-odds)
    assert unless(odds, chance) == pytest.approx(-math.log(likelihood), rel=1e4 * ROUNDOFF, abs=1e2 * ROUNDOFF)
    assert kept(odds) == unless(odds, HOLDS)


def test_of_several_looks_the_sharpest_says_how_much_and_the_one_that_sees_most_left_what_it_is_worth() -> None:
    """A catalogue that explains nothing of what is left sees no gap there; the channels do."""

    def seen(before: float, after: float) -> tuple[float, float]:
        return left_by(before, after), left_by(before, LEVEL)

    sharp, blunt = seen(26000.0, LEVEL), seen(3.0, LEVEL)
    assert most_left([sharp, blunt]) == pytest.approx(sharp[0], abs=QUADRATURE)
    left = LEVEL + 0.08 * 7000.0
    assert most_left([sharp, seen(7000.0, left)]) == pytest.approx(
        left_by(7000.0, left) + sharp[1] - left_by(7000.0, LEVEL), abs=QUADRATURE
    )
    assert most_left([sharp, seen(7000.0, left)]) < 0.0 < most_left([sharp, seen(0.5, 0.5)])


@pytest.mark.parametrize("left", [0.005, 0.01, 0.02])
def test_how_far_a_law_is_off_is_known_to_no_better_than_its_order(left: float) -> None:
    """Half as much left is twice as likely, as long as it lies between the ends."""
    gap = 1e6
    halved = left_by(gap, LEVEL + 0.5 * left * gap) - left_by(gap, LEVEL + left * gap)
    assert 0.5 * math.log(2.0) < halved < 2.0 * math.log(2.0)


def test_a_fault_of_the_log_is_exact_and_an_effect_is_not() -> None:
    effect, clock = candidate("p"), replace(candidate("lag a.*"), component=LOGGING)
    nothing, one, other, half = (fitted(m) for m in ((), (effect,), (clock,), (effect, clock)))
    assert [misfit(f) for f in (nothing, one, other, half)] == [MISFIT, MISFIT, EXACT, 0.5 * (EXACT + MISFIT)]
    assert left_by(50.0, 4.0, misfit(other)) < left_by(50.0, 4.0, misfit(one))


def test_a_fault_of_the_log_makes_exact_what_it_does_and_no_more() -> None:
    """The effect does nine times what the clock does, in squares."""
    effect, clock = candidate("p"), replace(candidate("lag a.*"), component=LOGGING)
    sensitivities = np.stack([np.full(4, 3.0), np.array([1.0, -1.0, 1.0, 1.0])], axis=1)
    values = {c.addresses[0]: c.prior.scale for c in (effect, clock)}
    both = replace(fitted((effect, clock)), values=values, sensitivities=sensitivities)
    assert misfit(both) == pytest.approx(0.1 * EXACT + 0.9 * MISFIT, rel=ROUNDOFF)


@pytest.mark.parametrize(
    ("before", "after", "share"),
    [(LEVEL + 10.0, LEVEL + 1.0, 0.1), (11.1, 11.1, 1.0), (11.1, LEVEL, 0.0), (11.1, 0.9, 0.0), (LEVEL + 1.0, LEVEL + 2.0, 2.0)],
)
def test_the_share_that_is_left_is_that_beyond_a_machine_without_effects(before: float, after: float, share: float) -> None:
    assert unexplained(before, after) == pytest.approx(share, rel=1e1 * ROUNDOFF)


@pytest.mark.parametrize("odds", [-80.0, -2.0, 0.0, 1.5, 700.0])
def test_a_stand_in_may_hold_in_all_conditions(odds: float) -> None:
    right, other = math.exp(min(odds, 0.0)), math.exp(min(-odds, 0.0))  # likelihoods; one that holds has that of a right model
    assert kept(odds) == pytest.approx(math.log(right / (HOLDS * right + (1.0 - HOLDS) * other)), abs=ROUNDOFF, rel=ROUNDOFF)


def test_however_well_a_model_holds_it_is_no_surer_than_that_stand_ins_do() -> None:
    assert kept(50.0) == pytest.approx(-math.log(HOLDS), rel=ROUNDOFF)
    assert kept(0.0) == pytest.approx(0.0, abs=ROUNDOFF)
    assert kept(-50.0) < -49.0


def seen(nominal: FloatArray, left: FloatArray, does: FloatArray) -> float:
    """What `worsened` says of these levels [conditions, channels]."""
    of = {1.0: nominal, 2.0: left}
    space = Space(np.ones(1), {str(i): slice(0, 1) for i in range(len(nominal))}, np.zeros((1, 0)))
    evidence: Any = SimpleNamespace(space=space, levels=lambda x: of[float(x[0])], does=lambda _: does)
    return worsened(evidence, np.ones(1), np.full(1, 2.0), np.ones(1))


def test_what_is_made_worse_is_a_share_of_what_the_model_does_in_that_channel() -> None:
    nominal, does = np.array([[200.0, 1.0], [0.5, -6.0]]), np.array([[180.0, 5.0], [20.0, 138.0]])
    left = np.array([[9.0, 1.4], [2.0, 37.5]])
    assert seen(nominal, left, does) == left_by(138.0, 37.5)
    assert seen(nominal, left, does) < 0.0 < left_by(2000.0, 37.5)


def test_what_both_leave_and_what_good_machines_leave_is_not_made_worse() -> None:
    does = np.full((1, 2), 50.0)
    assert seen(np.array([[60.0, 8.0]]), np.array([[1.0, 8.0]]), does) == 0.0
    assert seen(np.array([[60.0, 0.1]]), np.array([[1.0, LEVEL]]), does) == 0.0


def test_a_model_that_makes_a_channel_worse_by_little_of_what_it_does_there_is_not_refuted() -> None:
    """A fifth of the amplitude, as MISFIT says."""
    does = np.full((1, 1), 1e3)
    assert seen(np.zeros((1, 1)), np.array([[LEVEL + MISFIT * 1e3]]), does) > 0.0
    assert seen(np.zeros((1, 1)), np.array([[LEVEL + 0.5 * 1e3]]), does) < -5.0


@pytest.mark.parametrize(
    ("overall", "worse", "both"),
    [(2.9, 0.0, 2.9), (2.9, 1.0, 2.9), (2.9, -3.0, -0.1), (-0.5, -3.0, -3.0), (-3.0, -0.5, -3.0), (0.0, 2.0, 0.0)],
)
def test_what_is_made_worse_may_only_refute_and_counts_once(overall: float, worse: float, both: float) -> None:
    assert together(overall, worse) == pytest.approx(both, rel=ROUNDOFF)


def beside(mean: float, variance: float, off: float) -> float:
    """Likelihood of data that bring a number from N(0, 1) to N(mean, variance), where it is Cauchy with probability `off`."""
    z = np.linspace(-400.0, 400.0, 800_001)
    does = np.exp(norm.logpdf(z, mean, math.sqrt(variance)) - norm.logpdf(z))
    return float(trapezoid(does * ((1.0 - off) * norm.pdf(z) + off * cauchy.pdf(z)), z))


@pytest.mark.parametrize("apart", [0.0, 0.05, 0.2, 1.0])
def test_how_alike_amplitudes_are_is_the_ratio_of_the_integrals_over_how_far_laws_are_off(apart: float) -> None:
    """Three conditions with a mean that may be anything: the density of two differences from the first."""
    a, precisions = 1.0 + apart * np.array([-1.0, 0.2, 0.8]), np.array([400.0, 900.0, 2500.0])
    differences = np.array([[1.0, -1.0, 0.0], [1.0, 0.0, -1.0]])

    def density(share: float) -> float:
        covariance = differences @ np.diag(1.0 / precisions + share) @ differences.T
        return float(multivariate_normal.pdf(differences @ a, cov=covariance))

    shares = np.geomspace(TRUST**2, MISFIT, 4001)
    right = trapezoid([density(u) for u in shares], np.log(shares)) / math.log(MISFIT / TRUST**2)
    assert agreement(a, precisions) == pytest.approx(math.log(right / density(KEEPS**2)), abs=QUADRATURE)
    assert (agreement(a, precisions) > 0.0) is (apart < 0.3)


@pytest.mark.parametrize(("mean", "variance"), [(0.3, 0.02), (1.5, 0.5), (-2.0, 0.1), (0.1, 0.9), (6.0, 0.05)])
def test_a_number_off_its_tolerance_is_the_ratio_of_the_integrals(mean: float, variance: float) -> None:
    right, other = (beside(mean, variance, odds / (1.0 + odds)) for odds in (MISJUDGED, 1.0))
    assert within_tolerances(np.array([mean]), np.array([[variance]])) == pytest.approx(math.log(right / other), abs=QUADRATURE)


def mixed(found: FloatArray, noise: FloatArray, free: tuple[bool, bool]) -> float:
    """Likelihood of two numbers that were found with this noise, [2, 2]; one that is free is Cauchy, the other N(0, 1).

    A Cauchy number is normal with a precision that is Gamma(1/2, 1/2).
    """
    x, weights = np.polynomial.legendre.leggauss(60)
    precisions = np.exp(9.0 * x - 5.0)
    weights = 9.0 * weights * precisions * gamma.pdf(precisions, 0.5, scale=2.0)
    first, other = (zip(1.0 / precisions, weights, strict=True) if f else [(1.0, 1.0)] for f in free)
    covariances = [(noise + np.diag([v, w]), p * q) for (v, p), (w, q) in itertools.product(first, other)]
    return sum(p * math.exp(-0.5 * found @ np.linalg.solve(c, found)) / math.sqrt(np.linalg.det(c)) for c, p in covariances)


@pytest.mark.parametrize(
    ("found", "noise"),
    [
        ([5.0, 5.0], [[0.05, 0.0], [0.0, 0.05]]),
        ([4.0, 4.0], [[30.0, -29.9], [-29.9, 30.0]]),
        ([6.0, 0.2], [[0.5, 0.4], [0.4, 0.5]]),
        ([2.0, -1.0], [[1.0, 0.5], [0.5, 2.0]]),
    ],
    ids=["each is off", "their sum is", "one is", "none is"],
)
def test_numbers_that_the_data_know_together_are_the_ratio_of_the_sums_over_which_are_off(
    found: list[float], noise: list[list[float]]
) -> None:
    y, n = np.array(found), np.array(noise)
    covariance = np.linalg.inv(np.eye(2) + np.linalg.inv(n))
    likelihood = {free: mixed(y, n, free) for free in itertools.product((False, True), repeat=2)}
    right, other = (
        sum((odds / 2.0) ** sum(free) * x for free, x in likelihood.items()) / (1.0 + odds / 2.0) ** 2 for odds in (MISJUDGED, 1.0)
    )
    assert within_tolerances(covariance @ np.linalg.solve(n, y), covariance) == pytest.approx(math.log(right / other), abs=QUADRATURE)


AS_ONE = 1.0
"""Log of the ratio [nats] by which forty numbers that do the same may differ from one: a second one that is off would cost log 10."""


def test_what_one_number_explains_counts_once() -> None:
    """Forty numbers that do the same in the data; one of them that is off makes each of them look as far off."""
    k, noise, far = 40, 0.1, 40.0
    does = np.ones((1, k)) / noise
    covariance = np.linalg.inv(np.eye(k) + does.T @ does)
    found = within_tolerances(covariance @ does.T[:, 0] * far / noise, covariance)
    others = k - 1 + noise**2  # variance of what the data say of one, as the others are what they are
    alone = within_tolerances(np.array([far / (1.0 + others)]), np.array([[others / (1.0 + others)]]))
    assert math.log(MISJUDGED) < found < 0.0
    assert found == pytest.approx(alone, abs=AS_ONE)


@pytest.mark.parametrize("far", [0, 1, 2])
def test_each_number_that_is_far_off_makes_a_right_model_less_likely_by_how_many_it_has(far: int) -> None:
    """Twenty numbers that the data know well; what is not far off gains less than the ratio of the densities at zero."""
    means = np.zeros(20)
    means[:far] = (15.0, -40.0)[:far]
    found = within_tolerances(means, 0.01 * np.eye(20)) - far * math.log(MISJUDGED)
    assert 0.0 <= found <= math.log(norm.pdf(0.0) / cauchy.pdf(0.0)) + QUADRATURE


def test_where_noise_is_a_guess_the_data_say_less_of_where_a_number_is() -> None:
    """As if the data alone had that variance; with ten thousand times as much they say next to nothing."""
    m, v, guess = 5.0, 0.1, 4.0
    alone = guess * v / (1.0 - v)
    wider = alone / (1.0 + alone)
    same = within_tolerances(np.array([m / (1.0 - v) * (1.0 - wider)]), np.array([[wider]]))
    found = [within_tolerances(np.array([m]), np.array([[v]]), g) for g in (1.0, guess, 1e4)]
    assert found[1] == pytest.approx(same, rel=1e2 * ROUNDOFF)
    assert found[0] < found[1] < found[2]
    assert abs(found[2]) < QUADRATURE


def test_numbers_of_which_the_data_say_nothing_say_nothing() -> None:
    assert within_tolerances(np.zeros(3), np.eye(3)) == 0.0
    assert within_tolerances(np.zeros(0), np.zeros((0, 0))) == 0.0
    some = within_tolerances(np.array([5.0]), np.array([[0.1]]))
    assert within_tolerances(np.array([5.0, 0.0, 0.0]), np.diag([0.1, 1.0, 1.0])) == some


@pytest.mark.parametrize(("count", "probability"), [(1, 0.02), (60, 0.02), (60, 0.1)])
def test_beyond_that_one_of_so_many_numbers_is_as_rarely_as_asked(count: int, probability: float) -> None:
    assert 1.0 - (1.0 - 2.0 * norm.sf(beyond(count, probability))) ** count == pytest.approx(probability, rel=0.5 * probability)
