"""Measurement matrix of a sensing spindle holder from a calibration against a dynamometer: paper 001, sec. 4, Eqs. (8) and (9).

f = M (s - s_0), f [N] the force in the axes of the holder, s [V/V] the readings of its six bridges. The weight of the spindle is part
of f (`felt`). Two ways of least squares lead to M:

- "strains": S and s_0 of s = S f + s_0 by least squares, then the M that weighs the bridges by their noise,
  M = (S^T V^-1 S)^-1 S^T V^-1, V the covariance of what is left of the readings. M S = 1: no force is read too small.
- "forces": M of Eq. (8) directly, the least squares of f - M (s - s_0). The noise of the readings makes it read forces too small, by
  the variance of the noise over that of the loads: in a direction that is loaded seldom and felt little this is per cents.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robomill.models.model.declaration import FloatArray

BRIDGES = 6
WAYS = ("strains", "forces")
LEAST_ROWS = 20
LEAST_SPREAD = 0.02
"""Spread of the forces in their weakest direction over that in their strongest, below which that direction counts as not loaded."""
LEAST_SHARE = 0.5
"""Share of the variance of a bridge that the force explains, below which the bridge does not follow the load."""
TELLS_APART = 1e3
"""Condition number of S above which the bridges do not tell three forces apart."""


class CalibrationError(ValueError):
    """A calibration that gives no matrix; the text says what, value, expected, remedy."""


@dataclass(frozen=True)
class MatrixFit:
    """What a calibration gives."""

    way: str
    rows: int
    matrix: FloatArray
    """M [N per V/V], (3, 6)."""
    zero: FloatArray
    """s_0 [V/V], (6,)."""
    sensitivity: FloatArray
    """S [V/V per N], (6, 3)."""
    condition: float
    """Largest over smallest singular value of S: how much better the best direction of force is felt than the worst."""
    noise: FloatArray
    """Root mean square of what the force leaves of each reading [V/V], (6,)."""
    residual: FloatArray
    """Root mean square of f - M (s - s_0) [N], (3,): x, y, z."""
    scale: FloatArray
    """Force that is read per force applied, (3,): diagonal of M S. 1 with "strains"."""
    force_noise: FloatArray
    """Standard deviation of the force of one sample [N], (3,), from the covariance of the readings."""
    spread: FloatArray
    """(F^T F)^-1 of the loads F about their mean [1/N2], (3, 3)."""

    def deviation(self, force: FloatArray, samples: float = 1.0) -> FloatArray:
        """Standard deviation [N], (3,), of the mean force over so many independent samples, where `force` [N] acts.

        Noise of the readings, and the calibration's own scatter: sigma^2 (1/samples + 1/rows + f^T (F^T F)^-1 f), sigma the
        noise of a sample. Drift, another attack point and all else that changes after the calibration are not in it.
        """
        share = 1.0 / samples + 1.0 / self.rows + float(force @ self.spread @ force)
        return np.asarray(self.force_noise * np.sqrt(share))


def identify_matrix(bridges: FloatArray, forces: FloatArray, way: str = "strains") -> MatrixFit:
    """Measurement matrix from readings [V/V], (n, 6), and forces [N], (n, 3), in the axes of the holder, row by row.

    CalibrationError: other shapes, too few rows, numbers that are none, a direction without load, a bridge that does not follow the
    load, bridges that do not tell three forces apart.
    """
    if way not in WAYS:
        raise CalibrationError(f"way {way!r} is unknown; available: {', '.join(WAYS)}")
    _check(bridges, forces)
    n = len(forces)
    F, B = forces - forces.mean(axis=0), bridges - bridges.mean(axis=0)
    spread, axes = np.linalg.eigh(F.T @ F)
    if not spread[0] > LEAST_SPREAD**2 * spread[-1]:
        weakest = axes[:, 0]
        raise CalibrationError(
            f"the loads do not span three directions: their spread along ({', '.join(f'{x:.2f}' for x in weakest)}) of the holder is "
            f"{np.sqrt(max(spread[0], 0.0) / n):.2g} N, along the strongest direction {np.sqrt(spread[-1] / n):.3g} N, so the matrix is "
            f"singular; expected more than {100 * LEAST_SPREAD:g} %: load the tool along +-x, +-y and -z as well"
        )
    inverse = np.linalg.inv(F.T @ F)
    S = (inverse @ F.T @ B).T
    left = B - F @ S.T
    _check_bridges(B, left)
    condition = float(np.linalg.cond(S))
    if not condition < TELLS_APART:
        raise CalibrationError(
            f"the bridges do not tell three forces apart: condition number {condition:.3g}, expected below {TELLS_APART:g}; check that "
            "they sit at different places and are wired to different channels"
        )
    zero = bridges.mean(axis=0) - S @ forces.mean(axis=0)
    floor = 1e-6 * np.sqrt(np.mean(B**2))  # readings without noise: weights that can be inverted
    V = left.T @ left / max(n - 4, 1) + floor**2 * np.eye(BRIDGES)
    if way == "strains":
        weighted = np.linalg.solve(V, S)
        M = np.linalg.solve(S.T @ weighted, weighted.T)
    else:
        M = np.linalg.lstsq(B, F, rcond=1e-9)[0].T
    wrong = forces - (bridges - zero) @ M.T
    return MatrixFit(
        way,
        n,
        M,
        zero,
        S,
        condition,
        np.sqrt(np.mean(left**2, axis=0)),
        np.sqrt(np.mean(wrong**2, axis=0)),
        np.diag(M @ S).copy(),
        np.sqrt(np.diag(M @ V @ M.T)),
        inverse,
    )


def felt(force: FloatArray, point: FloatArray, lever: float) -> FloatArray:
    """Force [N], (n, 3), at the calibrated attack point that bends the holder like `force` (n, 3) at `point` [m], (3,), all in its axes.

    (M_y / L, -M_x / L, f_z) with M = p x f and the lever L [m], as `models.components.spindle_holder`.
    """
    bending = np.cross(point, force)
    return np.column_stack([bending[:, 1] / lever, -bending[:, 0] / lever, force[:, 2]])


def _check(bridges: FloatArray, forces: FloatArray) -> None:
    if bridges.ndim != 2 or bridges.shape[1] != BRIDGES or forces.shape != (len(bridges), 3):
        raise CalibrationError(f"readings {bridges.shape} and forces {forces.shape}; expected (n, {BRIDGES}) and (n, 3)")
    if len(forces) < LEAST_ROWS:
        raise CalibrationError(f"{len(forces)} rows; expected at least {LEAST_ROWS}: loads in several directions")
    for what, values in (("reading of a bridge", bridges), ("force", forces)):
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            row, column = bad[0]
            raise CalibrationError(f"row {row + 1}: {what} {column + 1} is {values[row, column]}, expected a finite number; leave it out")


def _check_bridges(B: FloatArray, left: FloatArray) -> None:
    """CalibrationError for bridges that do not follow the load; readings about their mean, and what the force leaves of them."""
    whole, rest = np.mean(B**2, axis=0), np.mean(left**2, axis=0)
    dead = [i for i in range(BRIDGES) if not rest[i] < (1.0 - LEAST_SHARE) * whole[i]]
    if dead:
        shares = ", ".join(f"{100 * (1.0 - rest[i] / whole[i]) if whole[i] > 0.0 else 0.0:.0f} %" for i in dead)
        raise CalibrationError(
            f"bridge {', '.join(str(i + 1) for i in dead)} does not follow the load: the force explains {shares} of its reading, expected "
            f"more than {100 * LEAST_SHARE:.0f} %; check gauges and wiring, and calibrate again"
        )
