"""What a regression can make of the gap: the ceiling of a condition that was measured once.

The gap of each channel as a ridge regression on the simulated signals, their rates, their squares and the directions of the rates.
It is cross-fitted: each part of the condition is predicted from the other parts and from the diagnosed conditions, so that noise and
what does not come again are no part of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from robomill.orchestration.slaves.protocol import FloatArray

FOLDS = 6
"""Parts of the condition that are predicted from the others; and of what is known, to choose the strength of the ridge."""
RIDGES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
"""Strengths of the ridge that are tried, per sample; the best for each channel is taken."""


def predicted_gap(signals: FloatArray, gap: FloatArray, known: Sequence[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """The gap [samples, channels] that is predicted in a condition; `signals` [samples, m] are simulated there.

    `known`: signals and gaps of other conditions.
    """
    every = np.concatenate([signals, *(s for s, _ in known)])
    centre, spread = every.mean(axis=0), every.std(axis=0)
    moving = spread > 1e-12 * (np.abs(centre) + 1e-300)
    scaled = [(s[:, moving] - centre[moving]) / spread[moving] for s in (signals, *(s for s, _ in known))]
    pace = np.sqrt(np.mean(np.concatenate([np.gradient(z, axis=0) for z in scaled]) ** 2, axis=0)) + 1e-300
    here, *others = [_features(z, pace) for z in scaled]
    return cross_fitted(here, gap, [(x, g) for x, (_, g) in zip(others, known, strict=True)])


def cross_fitted(features: FloatArray, gap: FloatArray, known: Sequence[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """The gap [samples, channels] as a ridge regression on features [samples, m], each part by the others.

    `known`: features and gaps of other conditions.
    """
    predicted = np.empty_like(gap)
    edges = np.linspace(0, len(gap), FOLDS + 1).astype(int)
    for low, high in itertools.pairwise(edges):
        rest = np.r_[0:low, high : len(gap)]
        x, y = np.concatenate([features[rest], *(f for f, _ in known)]), np.concatenate([gap[rest], *(g for _, g in known)])
        predicted[low:high] = features[low:high] @ _ridge(x, y)
    return predicted


def _features(z: FloatArray, pace: FloatArray) -> FloatArray:
    rate = np.gradient(z, axis=0) / pace
    return np.concatenate([np.ones((len(z), 1)), z, z * z, rate, np.tanh(3.0 * rate)], axis=1)


def _ridge(x: FloatArray, y: FloatArray) -> FloatArray:
    """Coefficients [features, channels] with the ridge that predicts parts of the rows best from the others."""
    gram, products = x.T @ x, x.T @ y
    edges = np.linspace(0, len(x), FOLDS + 1).astype(int)
    error = np.zeros((len(RIDGES), y.shape[1]))
    for low, high in itertools.pairwise(edges):
        a, b = x[low:high], y[low:high]
        for k, c in enumerate(_solutions(gram - a.T @ a, products - a.T @ b, len(x) - (high - low))):
            error[k] += ((b - a @ c) ** 2).sum(axis=0)
    found = np.stack(_solutions(gram, products, len(x)))
    return np.asarray(found[error.argmin(axis=0), :, np.arange(y.shape[1])].T)


def _solutions(gram: FloatArray, products: FloatArray, rows: int) -> list[FloatArray]:
    return [np.asarray(np.linalg.solve(gram + strength * rows * np.eye(len(gram)), products)) for strength in RIDGES]
