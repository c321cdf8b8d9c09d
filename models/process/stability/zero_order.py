"""Stability lobes by the zero-order approximation: the cutting matrix is replaced by its mean over a tooth period.

Chip thickness at the immersion phi of the cutting frame (models/process/cutting.py) varies by n . (u(t) - u(t - tau)),
n = (sin phi, cos phi, 0), tau = 2 pi/(N Omega). The mean force of N edges of axial depth a varies by a A (u - u(t - tau)),

    A = N/(2 pi) integral over the engagement of k(phi) n(phi)^T dphi,
    k = (-Ktc cos - Krc sin, Ktc sin - Krc cos, -Kac).

At the limit, det(I - a (1 - exp(-j w tau)) A H(w)) = 0. With an eigenvalue L of A H that gives

    a = 1/(2 Re L),    w tau = pi + 2 arg L  (mod 2 pi),

the result of Budak & Altintas (1995) without its auxiliary quantities (Lambda = -1/L, kappa = Im/Re of it).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robomill.models.model.declaration import FloatArray
from robomill.models.process.cutting import CuttingCoefficients
from robomill.models.process.stability.modes import TWO_PI, ComplexArray


@dataclass(frozen=True)
class Engagement:
    """Where edges cut: bounds (b + 1,) of bins of immersion [rad] and the depth of each bin as a share (b,) of the axial depth."""

    bounds: FloatArray
    share: FloatArray

    @staticmethod
    def between(entry: float, exit_: float) -> Engagement:
        """Full depth from `entry` to `exit_` [rad]; ValueError if that is no interval of 0 to pi."""
        if not 0.0 <= entry < exit_ <= math.pi:
            raise ValueError(f"engagement from {entry:g} to {exit_:g} rad; expected 0 <= entry < exit <= pi")
        return Engagement(np.array([entry, exit_]), np.ones(1))


@dataclass(frozen=True)
class Lobes:
    """Limit of the axial depth (n,) [m] and frequency of the chatter beyond it (n,) [Hz] over spindle speeds (n,) [rad/s].

    inf and nan where nothing limits the depth.
    """

    speed: FloatArray
    depth: FloatArray
    frequency: FloatArray


def cutting_matrix(k: CuttingCoefficients, phi: FloatArray) -> FloatArray:
    """k(phi) n(phi)^T (..., 3, 3) [Pa]: force of an edge per axial length and displacement at immersion phi [rad]."""
    s, c = np.sin(phi), np.cos(phi)
    force = np.stack([-k.Ktc * c - k.Krc * s, k.Ktc * s - k.Krc * c, np.full_like(s, -k.Kac)], axis=-1)
    normal = np.stack([s, c, np.zeros_like(s)], axis=-1)
    return np.asarray(force[..., :, None] * normal[..., None, :])


def _integral(k: CuttingCoefficients, phi: FloatArray) -> FloatArray:
    """Antiderivative of `cutting_matrix` (..., 3, 3) [Pa]."""
    s, c = np.sin(phi), np.cos(phi)
    ss, cc, sc = 0.5 * (phi - s * c), 0.5 * (phi + s * c), 0.5 * s * s
    zero = np.zeros_like(s)
    rows = [
        [-k.Ktc * sc - k.Krc * ss, -k.Ktc * cc - k.Krc * sc, zero],
        [k.Ktc * ss - k.Krc * sc, k.Ktc * sc - k.Krc * cc, zero],
        [k.Kac * c, -k.Kac * s, zero],
    ]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def mean_matrix(k: CuttingCoefficients, teeth: float, engagement: Engagement) -> FloatArray:
    """A (3, 3) [Pa]: mean force on the tool per axial depth and per displacement u(t) - u(t - tau), in the cutting frame."""
    parts = np.diff(_integral(k, engagement.bounds), axis=0)
    return np.asarray(teeth / TWO_PI * np.tensordot(engagement.share, parts, axes=1))


def eigenvalues(H: ComplexArray, A: FloatArray) -> ComplexArray:
    """Eigenvalues L (2, nf) [1/m] of A H that are not zero, each continuous in frequency; H (nf, 3, 3) [m/N], A (3, 3) [Pa].

    The last column of A is zero, so they are those of the leading 2 x 2 of H A.
    """
    M = (H @ A)[:, :2, :2]
    trace, det = M[:, 0, 0] + M[:, 1, 1], M[:, 0, 0] * M[:, 1, 1] - M[:, 0, 1] * M[:, 1, 0]
    root = np.sqrt(trace**2 - 4.0 * det)
    flips = np.where((root[1:] * root[:-1].conj()).real < 0.0, -1.0, 1.0)
    root = root * np.concatenate([[1.0], np.cumprod(flips)])
    return np.asarray(0.5 * np.stack([trace + root, trace - root]), dtype=np.complex128)


def limit_curve(H: ComplexArray, A: FloatArray) -> FloatArray:
    """Axial depth (2, nf) [m] at which chatter of each frequency may begin, whatever the speed: 1/(2 Re L); inf where there is none."""
    real = eigenvalues(H, A).real
    with np.errstate(divide="ignore"):
        return np.where(real > 0.0, 0.5 / real, np.inf)


def lobes(frequencies: FloatArray, H: ComplexArray, A: FloatArray, teeth: float, speeds: FloatArray) -> Lobes:
    """Smallest limiting depth at each spindle speed (n,) [rad/s], from receptances H (nf, 3, 3) at increasing frequencies (nf,) [Hz].

    At a speed the limits are where w tau - pi - 2 arg L crosses a multiple of 2 pi; between two frequencies L is taken as linear.
    """
    w = TWO_PI * frequencies
    best, chatter = np.full(len(speeds), np.inf), np.full(len(speeds), np.nan)
    for L in eigenvalues(H, A):
        turn = np.unwrap(2.0 * np.angle(L)) + math.pi
        for i, speed in enumerate(speeds):
            phase = (w * (TWO_PI / (teeth * speed)) - turn) / TWO_PI
            cell = np.floor(phase)
            at = np.flatnonzero(cell[1:] != cell[:-1])
            if not len(at):
                continue
            crossed = np.maximum(cell[at], cell[at + 1])
            share = (crossed - phase[at]) / (phase[at + 1] - phase[at])
            real = (L[at] + share * (L[at + 1] - L[at])).real
            if real.max() > 0.0 and 0.5 / real.max() < best[i]:
                j = at[np.argmax(real)]
                best[i], chatter[i] = 0.5 / real.max(), frequencies[j]
    return Lobes(np.asarray(speeds, float), best, chatter)


def turning_limit(frequencies: FloatArray, oriented: ComplexArray, Kf: float) -> tuple[float, float]:
    """Least width of cut [m] that chatters in turning, and its frequency [Hz]: a = -1/(2 Kf min Re G) (Tlusty; Altintas, ch. 4).

    `oriented` (nf,) [m/N]: receptance from the cutting force to the chip direction; Kf [Pa]. ValueError if Re G is nowhere negative.
    """
    i = int(np.argmin(oriented.real))
    if oriented.real[i] >= 0.0:
        raise ValueError("the real part of the oriented receptance is nowhere negative: no width of cut chatters")
    return -0.5 / (Kf * float(oriented.real[i])), float(frequencies[i])
