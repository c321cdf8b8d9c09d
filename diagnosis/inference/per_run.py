"""Amplitude of an effect whose phase is another one in every run, from the runs themselves: in their mean it cancels.

Run k is r_k = A (cos p_k v_1 + sin p_k v_2) + noise, with v the whitened sensitivities of the two parts of the amplitude. Each phase is
integrated out, uniform on the circle: the evidence of A is the product over the runs of the mean over p of exp(-|r_k - ...|^2 / 2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from robomill.orchestration.slaves.protocol import FloatArray


@dataclass(frozen=True)
class Turning:
    """An amplitude that all runs share, and the phase of each."""

    amplitude: float
    """[prior scales]"""
    deviation: float
    """Its standard deviation, from the curvature of the evidence [prior scales]; infinite where that has none."""
    phases: FloatArray
    """[rad, runs]"""
    gain: float
    """Log of the evidence over that of no effect [nats]."""


def turning(residuals: Sequence[FloatArray], columns: Sequence[FloatArray]) -> Turning:
    """The amplitude, from whitened residuals of runs and the whitened sensitivities of their condition: [n] and [n, 2] each.

    ValueError where the two parts of the amplitude do the same.
    """
    grams = [v.T @ v for v in columns]
    if any(np.linalg.matrix_rank(g) < len(g) for g in grams):
        raise ValueError("per-run columns of an amplitude: in phase and a quarter of a turn ahead do the same; expected two directions")
    parts = [np.linalg.solve(g, v.T @ r) for g, v, r in zip(grams, columns, residuals, strict=True)]
    largest = 2.0 * max(float(np.linalg.norm(p)) for p in parts)
    # the phase is known to 1 / sqrt(gain of the run): a quarter of that between points of the circle
    strong = max(float(p @ g @ p) for p, g in zip(parts, grams, strict=True))
    circle = 2.0 * math.pi * np.arange(points := 64 + math.ceil(8.0 * math.pi * math.sqrt(strong))) / points
    way = np.stack([np.cos(circle), np.sin(circle)])

    def evidence(amplitude: float) -> float:
        total = 0.0
        for part, gram in zip(parts, grams, strict=True):
            terms = amplitude * (way.T @ gram @ part) - 0.5 * amplitude**2 * np.einsum("pk,pq,qk->k", way, gram, way)
            total += float(logsumexp(terms)) - math.log(points)
        return total

    coarse = np.linspace(0.0, largest, points)
    i = int(np.argmax([evidence(a) for a in coarse]))
    low, high = coarse[max(i - 1, 0)], coarse[min(i + 1, points - 1)]
    between = float(minimize_scalar(lambda a: -evidence(a), bounds=(low, high), method="bounded").x) if high > low else 0.0
    best = max(between, float(coarse[i]), key=evidence)  # the search never ends at a bound, such as no amplitude
    step = 1.0 / math.sqrt(sum(float(np.trace(g)) for g in grams))
    bend = -(evidence(best + step) - 2.0 * evidence(best) + evidence(best - step)) / step**2
    phases = np.array([math.atan2(p[1], p[0]) for p in parts])
    return Turning(best, 1.0 / math.sqrt(bend) if bend > 0.0 else math.inf, phases, evidence(best))
