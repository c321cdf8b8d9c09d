"""Statistics over the repeats of a condition, without the noise that each has by itself."""

from __future__ import annotations

import numpy as np

from orchestration.slave import FloatArray

RESAMPLES = 400
"""Of the bootstrap over repeats."""


def over_pairs(products: FloatArray, weights: FloatArray) -> FloatArray:
    """Mean over pairs of different repeats of their products [repeats, repeats], for each row of weights; of a single repeat its square."""
    if len(products) == 1:
        return np.full(len(weights), products[0, 0])
    off = products - np.diag(np.diag(products))
    total = np.einsum("ri,ij,rj->r", weights, off, weights)
    count = weights.sum(axis=1) ** 2 - (weights**2).sum(axis=1)
    out: FloatArray = np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan)
    return out
