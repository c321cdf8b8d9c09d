"""Modes from frequency responses: a rational function with common poles, and the half-power rule beside it.

    H(w) = -w^2 sum_r (A_r + j w B_r)/(w_r^2 - w^2 + 2 j zeta_r w_r w) + C - w^2 D      inertance, for each response

Poles by nonlinear least squares, weighted by the standard errors of the responses; A, B, C, D are linear and solved at each step
(variable projection). Modes are added where what is left has its largest peak, until Schwarz's criterion says that one more is noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from robomill.models.calibration.hammer import ComplexArray, Response
from robomill.models.model.declaration import FloatArray

DAMPING = (0.002, 0.15)
"""Damping ratios that a fit may give; one that ends there is no mode (FACTS of heavy robots: 0.01 to 0.04)."""
FIRST = 0.02
"""Damping ratio that a fit starts from."""
MOVES = 0.15
"""Part of its start by which a frequency may move in a fit."""
MOST = 10
"""Modes of a fit at most."""
SMALL = 0.03
"""Part of the largest peak below which a mode is lost in the others."""
AT_BOUND = 1e-3
"""Relative distance from a bound at which a fit has ended on it."""
FLOOR = 0.01
"""Error of a response that is assumed at least, in its own size: no instrument is better."""


@dataclass(frozen=True)
class Mode:
    """A mode that the responses show."""

    frequency: float
    """Undamped, Hz."""
    damping: float
    frequency_error: float
    """Standard error, Hz."""
    damping_error: float
    peak: FloatArray
    """[3, 3] height of its peak in the inertance, m/s2/N: answer along x, y, z (rows) to blows along x, y, z; 0 where none was struck."""
    half_power: float
    """Damping ratio of the half-power rule where its peak is largest; NaN where the peak does not fall to it."""


@dataclass(frozen=True)
class ModalFit:
    """Modes, what was left out and why, and the responses as fitted."""

    modes: tuple[Mode, ...]
    dropped: tuple[str, ...]
    """What was found and is no mode, with the reason."""
    fitted: tuple[ComplexArray, ...]
    """[nf, 3] inertance of each response, m/s2/N."""
    residual: float
    """Root mean square of what is left over the standard error of the responses: 1 is noise."""


def _basis(w: FloatArray, frequency: FloatArray, damping: FloatArray) -> ComplexArray:
    """Columns [nf, 2 m + 4] of the model: two per mode, two complex residues of what is outside the band."""
    wr = 2.0 * np.pi * frequency
    share = -(w[:, None] ** 2) / (wr**2 - w[:, None] ** 2 + 2j * damping * wr * w[:, None])
    scale = w / w[-1]
    rest = np.stack([np.ones_like(w), 1j * np.ones_like(w), scale**2, 1j * scale**2], axis=1)
    return np.concatenate([share, 1j * scale[:, None] * share, rest], axis=1)


class _Problem:
    """The responses side by side, weighted."""

    def __init__(self, responses: Sequence[Response]) -> None:
        self.w = 2.0 * np.pi * responses[0].frequency
        self.H = np.concatenate([r.inertance for r in responses], axis=1)
        error = np.concatenate([r.error for r in responses], axis=1)
        # a smooth error: that of single lines is as random as they are
        size = np.abs(self.H)
        self.sigma = np.sqrt(np.median(error, axis=0) ** 2 + (FLOOR * size) ** 2)

    def solve(self, frequency: FloatArray, damping: FloatArray) -> tuple[FloatArray, ComplexArray]:
        """Linear coefficients [columns, responses] and fitted responses."""
        basis = _basis(self.w, frequency, damping)
        real = np.concatenate([basis.real, basis.imag])
        real /= (norm := np.linalg.norm(real, axis=0))
        weight = np.tile(self.sigma**-2.0, (2, 1))
        y = weight * np.concatenate([self.H.real, self.H.imag])
        products = (real[:, :, None] * real[:, None, :]).reshape(len(real), -1)
        normal = (weight.T @ products).reshape(-1, len(norm), len(norm))
        found = np.linalg.solve(normal, (real.T @ y).T[:, :, None])[:, :, 0].T / norm[:, None]
        return found, basis @ found

    def residual(self, x: FloatArray) -> FloatArray:
        """Weighted residuals of poles x = (log frequency, log damping)."""
        m = len(x) // 2
        rest = (self.H - self.solve(np.exp(x[:m]), np.exp(x[m:]))[1]) / self.sigma
        return np.concatenate([rest.real.ravel(), rest.imag.ravel()])

    def fit(self, frequency: FloatArray, damping: FloatArray) -> Any:
        """Poles from a start."""
        x0 = np.concatenate([np.log(frequency), np.log(damping)])
        room = np.full(len(frequency), np.log1p(MOVES))
        low = np.concatenate([np.log(frequency) - room, np.full(len(damping), np.log(DAMPING[0]))])
        high = np.concatenate([np.log(frequency) + room, np.full(len(damping), np.log(DAMPING[1]))])
        return least_squares(self.residual, np.clip(x0, low + 1e-6, high - 1e-6), bounds=(low, high), x_scale=0.1, max_nfev=40)


def fit_modes(responses: Sequence[Response]) -> ModalFit:
    """Modes that all responses share; blows along different axes side by side, over the same lines.

    Errors: ValueError for responses with other lines, for values that are not finite, and where nothing stands out.
    """
    _check(responses)
    problem = _Problem(responses)
    frequency, damping = np.zeros(0), np.zeros(0)
    best: tuple[float, Any] | None = None
    points = 2 * problem.H.size
    for _ in range(MOST):
        rest = problem.H - problem.solve(frequency, damping)[1] if len(frequency) else problem.H
        size = np.sqrt(np.sum(np.abs(rest / problem.sigma) ** 2, axis=1))
        at = float(problem.w[int(np.argmax(size))] / (2.0 * np.pi))
        started = problem.fit(np.r_[frequency, at], np.r_[damping, FIRST])
        m = len(frequency) + 1
        cost = 2.0 * float(started.cost)
        criterion = points * np.log(cost / points) + (2 * m + (2 * m + 4) * problem.H.shape[1]) * np.log(points)
        if best is not None and criterion > best[0]:
            break
        best = (criterion, started)
        frequency, damping = np.exp(started.x[:m]), np.exp(started.x[m:])
    if best is None:
        raise ValueError("modal fit: no line of the responses stands out")
    return _result(responses, problem, best[1])


def _result(responses: Sequence[Response], problem: _Problem, found: Any) -> ModalFit:
    m = len(found.x) // 2
    frequency, damping = np.exp(found.x[:m]), np.exp(found.x[m:])
    linear, fitted = problem.solve(frequency, damping)
    variance = 2.0 * float(found.cost) / (2 * problem.H.size - len(found.x))
    errors = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)) * variance)
    peaks = np.hypot(linear[:m], linear[m : 2 * m] * (2.0 * np.pi * frequency / problem.w[-1])[:, None]) / (2.0 * damping[:, None])
    inside = np.minimum(damping / DAMPING[0], DAMPING[1] / damping) > 1.0 + AT_BOUND
    largest = float(peaks[inside].max()) if inside.any() else float(peaks.max())
    modes, dropped = [], []
    for k in np.argsort(frequency):
        f, zeta = float(frequency[k]), float(damping[k])
        said = f"{f:.2f} Hz, damping {zeta:.3f}"
        if not inside[k]:
            dropped.append(f"{said}: the fit ends on the bound of the damping ratio, {DAMPING[0]} to {DAMPING[1]}")
            continue
        if not problem.w[0] <= 2.0 * np.pi * f <= problem.w[-1]:
            dropped.append(f"{said}: outside the band of the fit")
            continue
        if peaks[k].max() < SMALL * largest:
            dropped.append(f"{said}: its peak is {100 * peaks[k].max() / largest:.1f} % of the largest, less than {100 * SMALL:.0f} %")
            continue
        height = np.zeros((3, 3))
        for n, r in enumerate(responses):
            height[:, r.direction] = peaks[k, 3 * n : 3 * n + 3]
        column = int(np.argmax(peaks[k]))
        rule = half_power(responses[0].frequency, problem.H[:, column], f)
        modes.append(Mode(f, zeta, float(f * errors[k]), float(zeta * errors[m + k]), height, rule))
    parts = tuple(fitted[:, 3 * n : 3 * n + 3] for n in range(len(responses)))
    return ModalFit(tuple(modes), tuple(dropped), parts, float(np.sqrt(variance)))


def half_power(frequency: FloatArray, inertance: ComplexArray, near: float) -> float:
    """Damping ratio of the half-power rule, (f2 - f1)/(2 f), at the peak of the receptance that is nearest to `near` Hz.

    f1, f2 are the first lines on either side that are below 1/sqrt 2 of the peak, as read off a screen: lines as far apart as the peak
    is wide make it too large. NaN where the response does not fall so far.
    """
    size = np.abs(inertance) / frequency**2
    k = int(np.argmin(np.abs(frequency - near)))
    while 0 < k < len(size) - 1 and (size[k - 1] > size[k] or size[k + 1] > size[k]):
        k += 1 if size[k + 1] > size[k - 1] else -1
    below = np.flatnonzero(size < size[k] / np.sqrt(2.0))
    under, over = below[below < k], below[below > k]
    if not len(under) or not len(over):
        return float("nan")
    return float((frequency[over[0]] - frequency[under[-1]]) / (2.0 * frequency[k]))


def _check(responses: Sequence[Response]) -> None:
    if not responses:
        raise ValueError("modal fit: no response; expected blows along at least one axis")
    first = responses[0].frequency
    for r in responses:
        if not np.array_equal(r.frequency, first):
            raise ValueError(
                f"modal fit: blows along {'xyz'[r.direction]} have {len(r.frequency)} lines, along {'xyz'[responses[0].direction]} "
                f"{len(first)}; record all with the same rate and duration"
            )
        bad = np.flatnonzero(~np.isfinite(r.inertance).all(axis=1))
        if len(bad):
            raise ValueError(
                f"modal fit: the response to blows along {'xyz'[r.direction]} has a gap at {first[bad[0]]:.4g} Hz "
                f"({len(bad)} lines are not finite numbers); leave these blows out"
            )
