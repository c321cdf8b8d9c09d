"""Stability of milling by semi-discretisation: the periodic cutting matrix in full.

Insperger & Stepan, Int. J. Numer. Meth. Engng 61 (2004). A tooth period tau is divided into m intervals. In each, the cutting
matrix is its mean, the delayed displacement is the mean of the two stored ones around t - tau, and the motion of the modes is
exact. The product of the m transitions is the monodromy matrix of x = (q, q', past displacements); the cut is stable if all its
eigenvalues are less than 1 in magnitude.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from robomill.models.model.declaration import FloatArray
from robomill.models.process.cutting import CuttingCoefficients
from robomill.models.process.stability.modes import TWO_PI, Modes
from robomill.models.process.stability.zero_order import Engagement, cutting_matrix

INTERVALS = 40
"""Intervals per tooth period, at least; the reference examples of the source use 40."""
PER_VIBRATION = 30
"""Intervals per period of the fastest mode. With 7, as the example of the source has at 5000 rpm, the limit is 16 % too high."""
INNER = 20
"""Angles at which the cutting matrix is looked up within an interval."""
_RANK = 1e-9
"""Singular values of the shapes below this share of the largest are no direction of motion."""


def enough_intervals(modes: Modes, tooth_period: float) -> int:
    """Intervals for a tooth period [s] that find the limit to about 1 %: `INTERVALS`, or `PER_VIBRATION` for the fastest mode."""
    return max(INTERVALS, math.ceil(PER_VIBRATION * tooth_period * float(modes.frequency.max())))


def periodic_matrices(k: CuttingCoefficients, teeth: int, engagement: Engagement, intervals: int = INTERVALS) -> FloatArray:
    """Mean of the cutting matrix over each interval of a tooth period, (m, 3, 3) [Pa], straight edges: sum over the teeth."""
    pitch = TWO_PI / teeth
    phi = pitch * (np.arange(intervals * INNER) + 1.0) / (intervals * INNER)
    total = np.zeros((intervals * INNER, 3, 3))
    for j in range(teeth):
        at = phi + j * pitch
        bin_ = np.searchsorted(engagement.bounds, at, side="right") - 1
        inside = (bin_ >= 0) & (bin_ < len(engagement.share))
        share = np.where(inside, engagement.share[np.clip(bin_, 0, len(engagement.share) - 1)], 0.0)
        total += share[:, None, None] * cutting_matrix(k, at)
    return np.asarray(total.reshape(intervals, INNER, 3, 3).mean(axis=1))


def monodromy(modes: Modes, matrices: FloatArray, depth: float, tooth_period: float) -> FloatArray:
    """Monodromy matrix over a tooth period [s] at an axial depth [m]; `matrices` as `periodic_matrices`, modes in the cutting frame."""
    # only the plane in which the tip moves and the chip varies is stored: one or two directions
    plane, size, _ = np.linalg.svd(modes.shape[:2])
    plane = plane[:, : int(np.sum(size > _RANK * size[0]))]
    seen = plane.T @ modes.shape[:2]
    r, n = seen.shape
    m = len(matrices)
    w = modes.circular
    force = depth * np.einsum("in,mij,jr->mnr", modes.shape, matrices[:, :, :2], plane)
    system = np.zeros((m, 2 * n + r, 2 * n + r))
    system[:, :n, n : 2 * n] = np.eye(n)
    system[:, n : 2 * n, :n] = force @ seen - np.diag(w**2)
    system[:, n : 2 * n, n : 2 * n] = -2.0 * np.diag(modes.damping * w)
    system[:, n : 2 * n, 2 * n :] = -force
    steps = expm(system * (tooth_period / m))
    states = 2 * n + r * m
    # rows: what each quantity is as a function of the state at the beginning; the newest displacement is part of the modes
    x = np.eye(2 * n, states)
    past = [np.zeros((r, states)) for _ in range(m)]
    for i in range(m):
        past[m - 1 - i][:, 2 * n + i * r : 2 * n + (i + 1) * r] = np.eye(r)
    past.append(seen @ x[:n])
    for i in range(m):
        x = steps[i, : 2 * n, : 2 * n] @ x + steps[i, : 2 * n, 2 * n :] @ (0.5 * (past[i] + past[i + 1]))
        past.append(seen @ x[:n])
    return np.vstack([x, *reversed(past[m : 2 * m])])


def spectral_radius(modes: Modes, matrices: FloatArray, depth: float, tooth_period: float) -> float:
    """Largest magnitude of an eigenvalue of the monodromy matrix: the cut is stable below 1."""
    return float(np.abs(np.linalg.eigvals(monodromy(modes, matrices, depth, tooth_period))).max())


def depth_limit(modes: Modes, matrices: FloatArray, tooth_period: float, largest: float, scan: int = 60, rounds: int = 12) -> float:
    """Least unstable axial depth [m] up to `largest`, in `scan` equal steps and then by bisection; inf if there is none."""
    below = 0.0
    for depth in np.linspace(largest / scan, largest, scan):
        if spectral_radius(modes, matrices, float(depth), tooth_period) > 1.0:
            above = float(depth)
            break
        below = float(depth)
    else:
        return np.inf
    for _ in range(rounds):
        middle = 0.5 * (below + above)
        below, above = (below, middle) if spectral_radius(modes, matrices, middle, tooth_period) > 1.0 else (middle, above)
    return 0.5 * (below + above)
