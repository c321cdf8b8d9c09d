"""Curves that a tool path consists of, each as a function of its arc length: lines, arcs, helices, pieces of blends.

Lengths in m, curvature in 1/m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from robomill.models.model.compiled import loaded_on_call
from robomill.models.model.declaration import FloatArray, kernel
from robomill.models.planning.segment_table import GEOMETRY_COLUMNS, HELIX, POLYNOMIAL

SAMPLES = 33
"""Even steps over a piece, ends included, at which derivatives are looked at for their largest and smallest size."""


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

    @cached_property
    def curvature(self) -> float:
        """As `Shape.curvature`."""
        return largest_curvature(self.coefficients, self.length)


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
    result = coefficients.copy()
    shift_rows(result.reshape(-1, 6), start)
    return result


@loaded_on_call
def shift_rows(rows: FloatArray, start: float) -> None:
    """`shift` in place, for (n, 6): repeated synthetic division."""
    for i in range(len(rows)):
        for first in range(5):
            for k in range(4, first - 1, -1):
                rows[i, k] += start * rows[i, k + 1]


@kernel
def polynomial_at(c: FloatArray, s: float, order: int) -> float:
    """The derivative of an order 0, 1 or 2 of the polynomial with coefficients (6,) at s."""
    value = 0.0
    for k in range(5, order - 1, -1):
        factor = 1.0
        for i in range(order):
            factor *= k - i
        value = value * s + factor * c[k]
    return value


@loaded_on_call
def largest_curvature(coefficients: FloatArray, length: float) -> float:
    """Largest length of the second derivative [1/m] of a polynomial curve (3, 6), at `SAMPLES` even steps."""
    largest = 0.0
    for n in range(SAMPLES):
        square = 0.0
        for i in range(3):
            k = polynomial_at(coefficients[i], length * n / (SAMPLES - 1), 2)
            square += k * k
        largest = max(largest, square)
    return math.sqrt(largest)
