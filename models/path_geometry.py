"""Curves that a tool path consists of, each as a function of its arc length: lines, helices, quintic blends.

A blend replaces the surroundings of a corner by a Bezier curve of degree five (Englert 2011, Eqs. 4.7, 4.8) that meets
its neighbours with equal position, tangent and curvature. Its control points follow from those conditions and from
equal parametric speed at both ends and in the middle (Biagiotti & Melchiorri 2008, section 8.10). There, equal steps of the parameter
are taken for equal path; here the curve is cut into pieces that are quintic in the arc length itself, so that the path
speed is what it should be to 1e-5 and the path is C2 in the path coordinate. Lengths in m, curvature in 1/m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from models.declaration import FloatArray
from models.segment_table import GEOMETRY_COLUMNS, HELIX, POLYNOMIAL

_SPEED_ERROR = 1e-5
"""Largest relative deviation of the path speed inside a blend piece."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_SAMPLES = np.linspace(0.0, 1.0, 33)


def _bernstein(degree: int, u: npt.ArrayLike) -> FloatArray:
    """Bernstein polynomials of a degree at u (Englert 2011, Eq. 4.8), shape of u + (degree + 1,)."""
    x = np.asarray(u, dtype=np.float64)
    return np.stack([math.comb(degree, j) * x**j * (1.0 - x) ** (degree - j) for j in range(degree + 1)], axis=-1)


_CURVE_SAMPLES = _bernstein(5, np.linspace(0.0, 1.0, 65))


class Shape(Protocol):
    """A curve over its arc length s in [0, length]."""

    @property
    def length(self) -> float:
        """Arc length [m]."""

    def at(self, s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position [m], first and second derivative with respect to the arc length (unit tangent, curvature vector [1/m])."""

    def part(self, start: float, end: float) -> Shape:
        """The curve between two arc lengths."""

    def row(self) -> tuple[int, FloatArray]:
        """Kind and the 18 geometry columns of the segment table."""

    @property
    def curvature(self) -> float:
        """Largest curvature [1/m]."""


@dataclass(frozen=True)
class Polynomial:
    """A curve that is polynomial in its arc length, degree up to five: a line or a piece of a blend.

    `coefficients[i, k]` multiplies s^k of coordinate i. A turn in place is a polynomial of degree zero; its `length`
    and s count rad.
    """

    coefficients: FloatArray
    length: float

    def at(self, s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `Shape.at`."""
        c = self.coefficients
        p = c[:, 0] + s * (c[:, 1] + s * (c[:, 2] + s * (c[:, 3] + s * (c[:, 4] + s * c[:, 5]))))
        d = c[:, 1] + s * (2.0 * c[:, 2] + s * (3.0 * c[:, 3] + s * (4.0 * c[:, 4] + s * 5.0 * c[:, 5])))
        k = 2.0 * c[:, 2] + s * (6.0 * c[:, 3] + s * (12.0 * c[:, 4] + s * 20.0 * c[:, 5]))
        return p, d, k

    def part(self, start: float, end: float) -> Polynomial:
        """As `Shape.part`."""
        return Polynomial(shift(self.coefficients, start), end - start)

    def row(self) -> tuple[int, FloatArray]:
        """As `Shape.row`."""
        return POLYNOMIAL, self.coefficients.ravel()

    @property
    def curvature(self) -> float:
        """As `Shape.curvature`."""
        if not np.any(self.coefficients[:, 2:]):
            return 0.0
        return float(np.max(self.norms(2)))

    def norms(self, order: int) -> FloatArray:
        """Lengths of the first or second derivative over the arc length, at 33 even steps."""
        derivative = np.polynomial.polynomial.polyder(self.coefficients.T, order)
        values: FloatArray = np.linalg.norm(np.polynomial.polynomial.polyval(_SAMPLES * self.length, derivative), axis=0)
        return values


@dataclass(frozen=True)
class Helix:
    """A circular arc about `centre`, or a helix: p = centre + radius (cos(rate s) e1 + sin(rate s) e2) + climb s."""

    centre: FloatArray
    e1: FloatArray
    e2: FloatArray
    climb: FloatArray
    radius: float
    rate: float
    """Angle per arc length in rad/m, signed."""
    length: float

    def at(self, s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `Shape.at`."""
        cos, sin = math.cos(self.rate * s), math.sin(self.rate * s)
        out, along = cos * self.e1 + sin * self.e2, cos * self.e2 - sin * self.e1
        r, w = self.radius, self.rate
        return self.centre + r * out + s * self.climb, r * w * along + self.climb, -r * w * w * out

    def part(self, start: float, end: float) -> Helix:
        """As `Shape.part`."""
        cos, sin = math.cos(self.rate * start), math.sin(self.rate * start)
        e1, e2 = cos * self.e1 + sin * self.e2, cos * self.e2 - sin * self.e1
        return Helix(self.centre + start * self.climb, e1, e2, self.climb, self.radius, self.rate, end - start)

    def row(self) -> tuple[int, FloatArray]:
        """As `Shape.row`."""
        values = np.zeros(GEOMETRY_COLUMNS)
        values[0:3], values[3:6], values[6:9] = self.centre, self.radius * self.e1, self.radius * self.e2
        values[9:12], values[12] = self.climb, self.rate
        return HELIX, values

    @property
    def curvature(self) -> float:
        """As `Shape.curvature`."""
        return self.radius * self.rate * self.rate


def line(start: FloatArray, end: FloatArray) -> Polynomial:
    """Straight line between two points [m] (Englert 2011, Eq. 4.6)."""
    length = float(np.linalg.norm(end - start))
    coefficients = np.zeros((3, 6))
    coefficients[:, 0] = start
    coefficients[:, 1] = (end - start) / length
    return Polynomial(coefficients, length)


def point(position: FloatArray, angle: float) -> Polynomial:
    """A turn in place by `angle` [rad], which is its length."""
    coefficients = np.zeros((3, 6))
    coefficients[:, 0] = position
    return Polynomial(coefficients, angle)


def helix(start: FloatArray, centre: FloatArray, axis: FloatArray, angle: float, climb: float) -> Helix:
    """Arc from `start` about `axis` (unit vector) through `centre` by `angle` [rad], climbing by `climb` [m] along the axis."""
    foot = centre + axis * float(np.dot(start - centre, axis))
    radius = float(np.linalg.norm(start - foot))
    e1 = (start - foot) / radius
    length = math.hypot(radius * angle, climb)
    return Helix(foot, e1, np.cross(axis, e1), axis * (climb / length), radius, angle / length, length)


def shift(coefficients: FloatArray, start: float) -> FloatArray:
    """Coefficients of p(start + s) in s, for polynomials of degree five in the last axis."""
    result = np.zeros_like(coefficients)
    for k in range(6):
        for n in range(k, 6):
            result[..., k] += math.comb(n, k) * start ** (n - k) * coefficients[..., n]
    return result


def hermite(length: float, ends: Sequence[npt.ArrayLike]) -> FloatArray:
    """Coefficients (..., 6) of the quintic with value, slope, second derivative `ends[0:3]` at 0 and `ends[3:6]` at `length`."""
    p0, d0, k0, p1, d1, k1 = (np.asarray(e, dtype=np.float64) for e in ends)
    x = length
    p = p1 - (p0 + x * (d0 + 0.5 * x * k0))
    d = x * (d1 - (d0 + x * k0))
    k = x * x * (k1 - k0)
    c3, c4, c5 = 10.0 * p - 4.0 * d + 0.5 * k, -15.0 * p + 7.0 * d - k, 6.0 * p - 3.0 * d + 0.5 * k
    return np.stack([p0, d0, 0.5 * k0, c3 / x**3, c4 / x**4, c5 / x**5], axis=-1)


def bezier_control(before: Shape, after: Shape, distance: float) -> FloatArray:
    """Control points (6, 3) of the blend from `distance` before the end of one shape to `distance` after the start of the next.

    With alpha the parametric speed at both ends (first derivatives alpha t, second alpha^2 kappa), that in the middle is
    |30 D - 7 alpha (t0 + t1) - alpha^2 (k0 - k1)/2| / 16, D the chord; alpha is set so that it equals alpha, too.
    ValueError if there is no such alpha.
    """
    p0, t0, k0 = before.at(before.length - distance)
    p5, t1, k1 = after.at(distance)
    chord, tangents, bend = p5 - p0, t0 + t1, k0 - k1
    a, b, c = 256.0 - 49.0 * tangents @ tangents, 420.0 * chord @ tangents, -900.0 * chord @ chord
    alpha = (-b + math.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    for _ in range(50):
        middle = 30.0 * chord - 7.0 * alpha * tangents - 0.5 * alpha * alpha * bend
        slope = 2.0 * middle @ (-7.0 * tangents - alpha * bend) - 512.0 * alpha
        step = float(middle @ middle - 256.0 * alpha * alpha) / float(slope)
        alpha -= step
        if not 0.0 < alpha < math.inf:
            break
        if abs(step) < 1e-15 * alpha:
            p1, p4 = p0 + alpha / 5.0 * t0, p5 - alpha / 5.0 * t1
            p2, p3 = 2.0 * p1 - p0 + alpha * alpha / 20.0 * k0, 2.0 * p4 - p5 + alpha * alpha / 20.0 * k1
            return np.array([p0, p1, p2, p3, p4, p5])
    raise ValueError(f"no blend curve with equal speed at its ends and middle for a distance of {distance} m")


def bezier_derivatives(control: FloatArray, u: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """b(u), b'(u), b''(u) of the Bezier curve of degree five with control points (6, 3) (Englert 2011, Eqs. 4.7, 4.8)."""
    d1, d2 = 5.0 * np.diff(control, axis=0), 20.0 * np.diff(control, n=2, axis=0)
    return _bernstein(5, u) @ control, _bernstein(4, u) @ d1, _bernstein(3, u) @ d2


def arc_length(control: FloatArray, u0: float, u1: float) -> float:
    """Length [m] of the Bezier curve between two parameters (Gauss-Legendre, 24 nodes)."""
    nodes = 0.5 * (u0 + u1) + 0.5 * (u1 - u0) * _NODES
    speeds = np.linalg.norm(_bernstein(4, nodes) @ (5.0 * np.diff(control, axis=0)), axis=1)
    return float(0.5 * (u1 - u0) * (_WEIGHTS @ speeds))


def arc_length_pieces(control: FloatArray) -> list[Polynomial]:
    """The Bezier curve as a chain of quintics in the arc length, C2 where they meet, path speed 1 within 1e-5 in between."""

    def state(u: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        p, d, dd = bezier_derivatives(control, u)
        speed = float(np.linalg.norm(d))
        tangent = d / speed
        return p, tangent, (dd - (dd @ tangent) * tangent) / speed**2

    def pieces(u0: float, u1: float, depth: int) -> list[Polynomial]:
        length = arc_length(control, u0, u1)
        piece = Polynomial(hermite(length, (*state(u0), *state(u1))), length)
        error = float(np.max(np.abs(piece.norms(1) - 1.0)))
        if error <= _SPEED_ERROR or depth == 0:
            return [piece]
        middle = 0.5 * (u0 + u1)
        return pieces(u0, middle, depth - 1) + pieces(middle, u1, depth - 1)

    return pieces(0.0, 1.0, 7)


def blend(before: Shape, after: Shape, limit: float, tolerance: float | None) -> tuple[float, list[Polynomial]] | None:
    """Blend of two shapes that meet in a corner: its distance from the corner [m] and its pieces.

    The distance is `limit`, or less so that path and blend deviate by at most `tolerance` [m]. None if no blend
    of at least 1 um can be made.
    """
    distance = limit
    if tolerance is not None:
        low, high = 0.0, limit
        widest = _deviation(before, after, limit)
        if widest > tolerance and before.curvature == 0.0 and after.curvature == 0.0:
            distance = limit * tolerance / widest  # blends of a corner between lines are similar to each other
        elif widest > tolerance:
            for _ in range(20):
                distance = 0.5 * (low + high)
                if _deviation(before, after, distance) > tolerance:
                    high = distance
                else:
                    low = distance
            distance = low
    if distance < 1e-6:
        return None
    try:
        return distance, arc_length_pieces(bezier_control(before, after, distance))
    except ValueError:
        return None


def _deviation(before: Shape, after: Shape, distance: float) -> float:
    """Largest distance [m] of the original corner from the blend that starts and ends `distance` from it; inf without one."""
    try:
        control = bezier_control(before, after, distance)
    except ValueError:
        return math.inf
    curve = _CURVE_SAMPLES @ control
    original = [before.at(before.length - distance * x)[0] for x in _SAMPLES[::2]] + [after.at(distance * x)[0] for x in _SAMPLES[::2]]
    start, chord = curve[:-1], np.diff(curve, axis=0)
    worst = 0.0
    for p in original:
        along = np.clip(np.sum((p - start) * chord, axis=1) / np.sum(chord * chord, axis=1), 0.0, 1.0)
        worst = max(worst, float(np.min(np.linalg.norm(start + along[:, None] * chord - p, axis=1))))
    return worst
