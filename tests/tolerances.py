"""The five classes of tolerance that tests may use; there are no loose numbers, which `tests/test_tolerances.py` makes sure of."""

import math

EXACT = 0.0
"""Parity and determinism: the same bits."""

ROUNDOFF = 1e-12
"""Relative: two ways of writing the same arithmetic."""


def discretisation(constant: float, h: float, order: int) -> float:
    """Bound C * h**p of a scheme of order p; state where the constant comes from."""
    return constant * h**order


def physics(value: float, relative: float = 0.0, absolute: float = 0.0) -> float:
    """Half-width of the band that a published figure allows; state the source beside the call."""
    return abs(value) * relative + absolute


def chance(standard_error: float, deviations: float = 4.0) -> float:
    """Half-width of what chance does to an estimate: 4 standard errors are exceeded once in 16 000 times; state where they come from."""
    return deviations * standard_error


def of_mean(samples: float) -> float:
    """Standard error of the mean of so many independent samples, over their standard deviation."""
    return math.sqrt(1.0 / samples)


def of_variance(samples: float) -> float:
    """Standard error of the variance of so many independent normal samples, relative; that of their standard deviation is half of it."""
    return math.sqrt(2.0 / samples)
