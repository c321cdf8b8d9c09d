"""Estimates from a finite number of cases: each with its count and a 95 % interval, as score.json has it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Z = 1.959963984540054
"""Quantile of the normal distribution at 0.975."""
CASE_RESAMPLES = 1000
"""How often the bootstrap draws cases anew."""


@dataclass(frozen=True)
class Figure:
    """An estimate; value and 95 % interval are None where there are too few cases."""

    value: float | None
    """The estimate."""
    count: int
    """Cases that it rests on."""
    interval: Sequence[float] | None
    """95 % interval."""


@dataclass(frozen=True)
class Claim:
    """What was claimed, how sure, and whether it was right."""

    probability: float
    """How sure the diagnosis was, 0..1."""
    right: bool
    """Whether it was right."""
    generator: str
    """Generator of the case."""


def wilson(hits: int, count: int, z: float = Z) -> tuple[float, float]:
    """95 % interval of a proportion (Wilson 1927); (0, 1) without cases."""
    if count == 0:
        return 0.0, 1.0
    p, n = hits / count, float(count)
    centre, half = p + z * z / (2.0 * n), z * math.sqrt(p * (1.0 - p) / n + z * z / (4.0 * n * n))
    low, high = (centre - half) / (1.0 + z * z / n), (centre + half) / (1.0 + z * z / n)
    return (0.0 if hits == 0 else low), (1.0 if hits == count else high)


def proportion(outcomes: Sequence[bool]) -> Figure:
    """Share of hits with its Wilson interval."""
    hits, n = sum(outcomes), len(outcomes)
    return Figure(hits / n, n, wilson(hits, n)) if n else Figure(None, 0, None)


def quantile(values: Sequence[float], q: float = 0.5) -> Figure:
    """Quantile (the median, unless told) with the distribution-free interval from order statistics."""
    n = len(values)
    if n == 0:
        return Figure(None, 0, None)
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    below = np.cumsum([math.comb(n, k) * q**k * (1.0 - q) ** (n - k) for k in range(n + 1)])  # P(at most k values below the quantile)
    low, high = int(np.searchsorted(below, 0.025)), int(np.searchsorted(below, 0.975))
    interval = float(ordered[low - 1]) if low >= 1 else -math.inf, float(ordered[high]) if high < n else math.inf
    known = all(math.isfinite(v) for v in interval)
    return Figure(float(np.quantile(ordered, q)), n, interval if known else None)


def expected_calibration_error(probabilities: Sequence[float], right: Sequence[bool], bins: int = 10) -> Figure:
    """|mean probability - share of right answers|, averaged over equal bins of probability; bootstrap interval with a fixed seed."""
    p, y = np.asarray(probabilities, dtype=np.float64), np.asarray(right, dtype=np.float64)
    if len(p) == 0:
        return Figure(None, 0, None)
    place = np.minimum((p * bins).astype(int), bins - 1)

    def error(rows: npt.NDArray[np.int64]) -> float:
        total = 0.0
        for b in range(bins):
            inside = rows[place[rows] == b]
            if len(inside):
                total += abs(float(np.mean(p[inside]) - np.mean(y[inside]))) * len(inside) / len(rows)
        return total

    random = np.random.default_rng(0)
    resampled = [error(random.integers(0, len(p), len(p))) for _ in range(CASE_RESAMPLES)]
    return Figure(error(np.arange(len(p))), len(p), [float(v) for v in np.quantile(resampled, (0.025, 0.975))])
