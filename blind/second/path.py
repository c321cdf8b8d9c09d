"""The planned path, played at the fine step: rows of the program's table evaluated in one go.

A row has its time, block, spindle speed, a cubic in time for the way along the path, three quintics in the way for the place, and an
orientation that is turned about up to two axes of its own by quintics in the way (docs/components/path_interpolator.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from robomill.blind.second.arm import inverse, tip
from robomill.blind.second.kernel import FloatArray, compiled

_POWERS = np.arange(6)


@dataclass(frozen=True)
class Played:
    """A path at equal times."""

    t: FloatArray
    p: FloatArray
    quaternion: FloatArray
    """[n,4] scalar first and positive."""
    q: FloatArray
    v: FloatArray
    spindle: FloatArray
    block: FloatArray
    time: FloatArray


def _poly(coefficients: FloatArray, s: FloatArray) -> FloatArray:
    values: FloatArray = np.einsum("nk,nk->n", coefficients, s[:, None] ** _POWERS)
    return values


def _slope(coefficients: FloatArray, s: FloatArray) -> FloatArray:
    values: FloatArray = np.einsum("nk,nk->n", coefficients[:, 1:] * _POWERS[1:], s[:, None] ** _POWERS[:-1])
    return values


@compiled
def _axes(p: FloatArray, R: FloatArray, p_FT: FloatArray, start: FloatArray) -> FloatArray:
    out = np.zeros((len(p), 6))
    last = start
    for k in range(len(p)):
        out[k] = inverse(p[k], R[k].copy(), p_FT, last)
        last = out[k].copy()
    return out


def play(table: FloatArray, h: float, p_FT: FloatArray, q_start: FloatArray, cycle: float) -> Played:
    """The path of a table [rows,50] every h [s], to the end of the cycle in which it ends. ValueError: not within reach."""
    end = float(table[-1, 0])
    per = round(cycle / h)
    n = int(np.ceil(end / cycle - 1e-9)) * per
    t: FloatArray = h * np.arange(n + 1, dtype=np.float64)
    time = np.minimum(t, end)
    rows = table[np.clip(np.searchsorted(table[:, 0], time, side="right") - 1, 0, len(table) - 1)]
    dt = time - rows[:, 0]
    s = rows[:, 6] + dt * (rows[:, 7] + dt * (rows[:, 8] / 2.0 + dt * rows[:, 9] / 6.0))
    speed = rows[:, 7] + dt * (rows[:, 8] + dt * rows[:, 9] / 2.0)
    places = [rows[:, 10 + 6 * i : 16 + 6 * i] for i in range(3)]
    p = np.stack([_poly(c, s) for c in places], axis=1)
    v = np.stack([_slope(c, s) * speed for c in places], axis=1)
    v[t >= end] = 0.0
    turn = Rotation.from_quat(np.roll(rows[:, 28:32], -1, axis=1))
    for first in (32, 41):
        turn = turn * Rotation.from_rotvec(rows[:, first : first + 3] * _poly(rows[:, first + 3 : first + 9], s)[:, None])
    q = _axes(p, turn.as_matrix(), p_FT, q_start)
    if not np.all(np.isfinite(q)):
        k = int(np.argmin(np.isfinite(q).all(axis=1)))
        raise ValueError(f"path at {t[k]:.3f} s: {p[k]} m is out of reach of the arm; move the workpiece nearer")
    quaternion = np.roll(turn.as_quat(canonical=True), 1, axis=1)
    return Played(t, p, quaternion, q, v, rows[:, 4].copy(), rows[:, 2].copy(), time)


def resting(q: FloatArray, p_FT: FloatArray, duration: float, h: float, cycle: float) -> Played:
    """An arm that stands at axis angles q [6] for a time [s], spindle off."""
    n = int(np.ceil(duration / cycle)) * round(cycle / h) + 1
    p, R = tip(q, p_FT)
    quaternion = np.roll(Rotation.from_matrix(R).as_quat(canonical=True), 1)
    t: FloatArray = h * np.arange(n, dtype=np.float64)
    return Played(t, np.tile(p, (n, 1)), np.tile(quaternion, (n, 1)), np.tile(q, (n, 1)), np.zeros((n, 3)), np.zeros(n), np.zeros(n), t)
