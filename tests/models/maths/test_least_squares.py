"""Recursive least squares against numpy, and what it does without excitation."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.models.maths.least_squares import innovation, update
from tests.tolerances import ROUNDOFF

LARGE = 1e30
"""A bound of the trace that nothing reaches."""
START_LEFT = 3.0 * 0.1 / 500
"""The bound suspends forgetting where there is something to see: the mean of 500 observations of 3, the start counting a tenth of one."""
TRUTH = np.array([3.1, 0.5])


def recursive(
    x: np.ndarray, y: np.ndarray, forgetting: float, bound: float = LARGE, start: float = 10.0
) -> tuple[np.ndarray, np.ndarray, float]:
    """Estimate (n,), covariance (n, n) and the largest trace met, from observations x (m, n), y (m,)."""
    theta, P, scratch = np.zeros(x.shape[1]), start * np.eye(x.shape[1]), np.zeros(x.shape[1])
    traces = [update(theta, P, scratch, row, value, forgetting, bound) for row, value in zip(x, y, strict=True)]
    return theta, P, max(traces)


def observations(n: int = 60) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    x = np.column_stack([np.ones(n), rng.uniform(0.5, 3.5, n)])
    return x, x @ TRUTH + 0.01 * rng.standard_normal(n)


@pytest.mark.parametrize("forgetting", [1.0, 0.98, 0.9])
def test_the_recursion_is_weighted_least_squares_with_the_start_as_an_observation(forgetting: float) -> None:
    """Minimum of sum lambda^(m-i) (y_i - x_i^T theta)^2 + lambda^m theta^T theta / 10, solved at once by numpy."""
    x, y = observations()
    m = len(y)
    theta, P, _ = recursive(x, y, forgetting)
    weights = forgetting ** np.arange(m - 1, -1, -1.0)
    information = x.T @ (weights[:, None] * x) + forgetting**m * np.eye(2) / 10.0
    expected = np.linalg.solve(information, x.T @ (weights * y))
    condition = np.linalg.cond(information)
    assert np.abs(theta - expected).max() < ROUNDOFF * condition
    assert np.abs(P - np.linalg.inv(information)).max() < ROUNDOFF * condition


def test_innovation_is_what_the_model_does_not_foresee() -> None:
    x = np.array([1.0, 2.0])
    assert innovation(TRUTH, x, 4.5) == pytest.approx(4.5 - 3.1 - 1.0, rel=0, abs=ROUNDOFF)


def test_without_excitation_the_covariance_grows_without_bound_and_with_it_stays() -> None:
    """One regressor for ever: the covariance across it is 10/lambda^m, unless the trace is bounded."""
    x = np.tile([1.0, 0.0], (500, 1))
    y = np.full(500, 3.0)
    free = recursive(x, y, 0.98)[1]
    assert free[1, 1] == pytest.approx(10.0 / 0.98**500, rel=500 * ROUNDOFF, abs=0.0)
    held, P, before = recursive(x, y, 0.98, bound=10.0)
    assert np.trace(P) <= 10.0 * (1.0 + ROUNDOFF)
    assert before > 10.0
    assert held[0] == pytest.approx(3.0, rel=0, abs=START_LEFT)
