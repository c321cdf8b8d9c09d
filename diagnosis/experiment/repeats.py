"""Statistics over the repeats of a condition, without the noise that each has by itself."""

from __future__ import annotations

import numpy as np

from robomill.orchestration.slaves.protocol import FloatArray

RESAMPLES = 1000
"""How often a bootstrap draws repeats, or blocks of time, anew (cost)."""


def as_share(value: float) -> float:
    """A part of what was measured, drawn to 0..1: estimates of it scatter, it is neither below nothing nor above all."""
    return min(max(float(value), 0.0), 1.0)


def bootstrapped(values: FloatArray, count: int) -> list[float] | None:
    """90 % interval [low, high] of resampled `values`, of `count` repeats; None of a single one, which says nothing of its scatter."""
    known = values[np.isfinite(values)]
    return [float(q) for q in np.quantile(known, (0.05, 0.95))] if count > 1 and known.size else None


def over_pairs(products: FloatArray, weights: FloatArray) -> FloatArray:
    """Mean over pairs of different repeats of their products P [repeats, repeats], for each row w of weights [rows, repeats].

    sum_{i != j} w_i P_ij w_j / ((sum w)^2 - sum w^2), [rows]; NaN where a row has one repeat only. With a single repeat: its square.
    """
    if len(products) == 1:
        return np.full(len(weights), products[0, 0])
    off = products - np.diag(np.diag(products))
    total = np.einsum("ri,ij,rj->r", weights, off, weights)
    count = weights.sum(axis=1) ** 2 - (weights**2).sum(axis=1)
    out: FloatArray = np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan)
    return out
