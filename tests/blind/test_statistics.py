"""robomill.blind.statistics: intervals by what defines them."""

from __future__ import annotations

import math

import pytest
from scipy import stats

from robomill.blind.statistics import Figure, expected_calibration_error, proportion, quantile, wilson
from tests.tolerances import ROUNDOFF


def test_wilson_is_the_interval_whose_ends_the_score_test_just_rejects():
    # by definition (Wilson 1927) |p_hat - p| = z sqrt(p (1 - p)/n) at both ends
    for hits, n in ((3, 10), (17, 20), (1, 200)):
        for p in wilson(hits, n):
            assert abs(hits / n - p) == pytest.approx(1.959963984540054 * math.sqrt(p * (1 - p) / n), rel=1e3 * ROUNDOFF)
    assert wilson(0, 10)[0] == 0.0
    assert wilson(10, 10)[1] == 1.0
    assert wilson(0, 0) == (0.0, 1.0)


def test_a_proportion_without_cases_has_no_value():
    assert proportion([]) == Figure(None, 0, None)


def test_the_interval_of_a_median_is_that_of_the_order_statistics():
    values = list(range(1, 101))
    found = quantile(values)
    assert found.value == 50.5
    low, high = found.interval
    # the ranks of the binomial distribution, from scipy
    assert (low, high) == (stats.binom.ppf(0.025, 100, 0.5), stats.binom.ppf(0.975, 100, 0.5) + 1)
    assert quantile([3.0]).interval is None


def test_calibration_error_of_an_answer_that_is_right_as_often_as_it_says_is_zero():
    assert expected_calibration_error([0.75] * 4, [True, True, True, False]).value == 0.0
    assert expected_calibration_error([0.95] * 10 + [0.55] * 10, [True] * 5 + [False] * 5 + [True] * 10).value == pytest.approx(
        0.45, rel=ROUNDOFF
    )
