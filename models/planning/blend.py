"""Blends: the surroundings of a corner replaced by a smooth curve.

A blend is a Bezier curve of degree five (Englert 2011, Eqs. 4.7, 4.8) that meets its neighbours with equal position, tangent and
curvature. Its control points follow from those conditions and from equal parametric speed at both ends and in the middle
(Biagiotti & Melchiorri 2008, section 8.10). There, equal steps of the parameter are taken for equal path; here the curve is cut into
pieces that are quintic in the arc length itself, so that the path speed is what it should be to 1e-5 and the path is C2 in the path
coordinate. Lengths in m, curvature in 1/m. A program has a corner per line, so the loops are compiled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from robomill.models.model.compiled import loaded, loaded_on_call
from robomill.models.model.declaration import FloatArray, kernel
from robomill.models.planning.path_geometry import SAMPLES, Polynomial, Shape, polynomial_at
from robomill.models.planning.segment_table import HELIX

_SPEED_ERROR = 1e-5
"""Largest relative deviation of the path speed inside a blend piece."""
_HALVINGS = 7
"""A blend is halved at most so often."""
_SHORTEST = 1e-6
"""Distance [m] from the corner below which there is no blend."""
_CHORDS = 64
"""Chords of the polygon that stands for the curve where its distance from the corner is measured."""
_LOOKS = 17
"""Points on each side of the corner whose distance from the curve is measured."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


def blend(before: Shape, after: Shape, limit: float, tolerance: float | None) -> tuple[float, list[Polynomial]] | None:
    """Blend of two shapes that meet in a corner: its distance from the corner [m] and its pieces.

    The distance is `limit`, or less so that path and blend deviate by at most `tolerance` [m]. None if no blend
    of at least 1 um can be made.
    """
    corner = _corner(before, after)
    distance = limit if tolerance is None else _within(corner, limit, tolerance)
    if distance < _SHORTEST:
        return None
    control = np.zeros((6, 3))
    return (distance, arc_length_pieces(control)) if put_control(corner, distance, control) else None


def bezier_control(before: Shape, after: Shape, distance: float) -> FloatArray:
    """Control points (6, 3) of the blend from `distance` before the end of one shape to `distance` after the start of the next.

    With alpha the parametric speed at both ends (first derivatives alpha t, second alpha^2 kappa), that in the middle is
    |30 D - 7 alpha (t0 + t1) - alpha^2 (k0 - k1)/2| / 16, D the chord; alpha is set so that it equals alpha, too.
    ValueError if there is no such alpha.
    """
    control = np.zeros((6, 3))
    if not put_control(_corner(before, after), distance, control):
        raise ValueError(f"no blend curve with equal speed at its ends and middle for a distance of {distance} m")
    return control


def bezier_derivatives(control: FloatArray, u: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """b(u), b'(u), b''(u) of the Bezier curve of degree five with control points (6, 3) (Englert 2011, Eqs. 4.7, 4.8)."""
    out = np.zeros((3, 3))
    put_bezier(control, u, out)
    return out[0], out[1], out[2]


def arc_length_pieces(control: FloatArray) -> list[Polynomial]:
    """The Bezier curve as a chain of quintics in the arc length, C2 where they meet, path speed 1 within 1e-5 in between."""
    coefficients, lengths = np.zeros((2**_HALVINGS, 3, 6)), np.zeros(2**_HALVINGS)
    count = put_pieces(control, coefficients, lengths)
    return [Polynomial(c.copy(), length) for c, length in zip(coefficients[:count], lengths[:count].tolist(), strict=True)]


def hermite(length: float, ends: Sequence[npt.ArrayLike]) -> FloatArray:
    """Coefficients (..., 6) of the quintic with value, slope, second derivative `ends[0:3]` at 0 and `ends[3:6]` at `length`."""
    p0, d0, k0, p1, d1, k1 = (np.asarray(e, dtype=np.float64) for e in ends)
    x = length
    p = p1 - (p0 + x * (d0 + 0.5 * x * k0))
    d = x * (d1 - (d0 + x * k0))
    k = x * x * (k1 - k0)
    c3, c4, c5 = 10.0 * p - 4.0 * d + 0.5 * k, -15.0 * p + 7.0 * d - k, 6.0 * p - 3.0 * d + 0.5 * k
    return np.stack([p0, d0, 0.5 * k0, c3 / x**3, c4 / x**4, c5 / x**5], axis=-1)


def _corner(before: Shape, after: Shape) -> FloatArray:
    """Two shapes as the loops below take them: (2, 20), kind, length and geometry."""
    rows = np.empty((2, 20))
    for row, shape in zip(rows, (before, after), strict=True):
        row[0], row[2:] = shape.row()
        row[1] = shape.length
    return rows


@kernel
def put_shape(shape: FloatArray, s: float, out: FloatArray) -> None:
    """Position, tangent and curvature vector (3, 3) of a row of `_corner` at the arc length s."""
    g = shape[2:]
    if int(shape[0]) != HELIX:
        for i in range(3):
            for order in range(3):
                out[order, i] = polynomial_at(g[6 * i : 6 * i + 6], s, order)
        return
    rate = g[12]
    cos, sin = math.cos(rate * s), math.sin(rate * s)
    for i in range(3):
        away, along = cos * g[3 + i] + sin * g[6 + i], cos * g[6 + i] - sin * g[3 + i]
        out[0, i] = g[i] + away + s * g[9 + i]
        out[1, i] = rate * along + g[9 + i]
        out[2, i] = -rate * rate * away


@kernel
def dot(a: FloatArray, b: FloatArray) -> float:
    """Scalar product of two vectors."""
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def put_control(corner: FloatArray, distance: float, control: FloatArray) -> bool:
    """`bezier_control` of a corner into (6, 3); False if there is none."""
    return bool(loaded(control_points)(corner, distance, control, np.zeros((6, 3)), np.zeros((4, 3))))


@kernel
def control_points(corner: FloatArray, distance: float, control: FloatArray, ends: FloatArray, v: FloatArray) -> bool:
    """As `put_control`; `ends` (6, 3) and `v` (4, 3) are scratch."""
    put_shape(corner[0], corner[0, 1] - distance, ends[:3])
    put_shape(corner[1], distance, ends[3:])
    for i in range(3):
        v[0, i] = ends[3, i] - ends[0, i]  # chord
        v[1, i] = ends[1, i] + ends[4, i]  # tangents
        v[2, i] = ends[2, i] - ends[5, i]  # bend
    a, b, c = 256.0 - 49.0 * dot(v[1], v[1]), 420.0 * dot(v[0], v[1]), -900.0 * dot(v[0], v[0])
    alpha = (-b + math.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    for _ in range(50):
        square = slope = 0.0
        for i in range(3):
            middle = 30.0 * v[0, i] - 7.0 * alpha * v[1, i] - 0.5 * alpha * alpha * v[2, i]
            square += middle * middle
            slope += middle * (-7.0 * v[1, i] - alpha * v[2, i])
        step = (square - 256.0 * alpha * alpha) / (2.0 * slope - 512.0 * alpha)
        alpha -= step
        if not 0.0 < alpha < math.inf:
            return False
        if abs(step) < 1e-15 * alpha:
            for i in range(3):
                control[0, i], control[5, i] = ends[0, i], ends[3, i]
                control[1, i] = ends[0, i] + alpha / 5.0 * ends[1, i]
                control[4, i] = ends[3, i] - alpha / 5.0 * ends[4, i]
                control[2, i] = 2.0 * control[1, i] - ends[0, i] + alpha * alpha / 20.0 * ends[2, i]
                control[3, i] = 2.0 * control[4, i] - ends[3, i] + alpha * alpha / 20.0 * ends[5, i]
            return True
    return False


@kernel
def bernstein(degree: int, j: int, u: float) -> float:
    """Bernstein polynomial j of a degree up to 5 at u (Englert 2011, Eq. 4.8)."""
    value = 1.0
    for i in range(j):
        value *= u * (degree - i) / (i + 1)
    for _ in range(degree - j):
        value *= 1.0 - u
    return value


@loaded_on_call
def put_bezier(control: FloatArray, u: float, out: FloatArray) -> None:
    """`bezier_derivatives` into (3, 3)."""
    bezier(control, u, out)


@kernel
def bezier(control: FloatArray, u: float, out: FloatArray) -> None:
    """As `put_bezier`."""
    for i in range(3):
        out[0, i] = out[1, i] = out[2, i] = 0.0
        for j in range(6):
            out[0, i] += bernstein(5, j, u) * control[j, i]
        for j in range(5):
            out[1, i] += bernstein(4, j, u) * 5.0 * (control[j + 1, i] - control[j, i])
        for j in range(4):
            out[2, i] += bernstein(3, j, u) * 20.0 * (control[j + 2, i] - 2.0 * control[j + 1, i] + control[j, i])


@loaded_on_call
def arc_length(control: FloatArray, u0: float, u1: float) -> float:
    """Length [m] of the Bezier curve between two parameters (Gauss-Legendre, 24 nodes)."""
    return length_between(control, u0, u1)


@kernel
def length_between(control: FloatArray, u0: float, u1: float) -> float:
    """As `arc_length`."""
    total = 0.0
    for n in range(len(_NODES)):
        u = 0.5 * (u0 + u1) + 0.5 * (u1 - u0) * _NODES[n]
        square = 0.0
        for i in range(3):
            d = 0.0
            for j in range(5):
                d += bernstein(4, j, u) * 5.0 * (control[j + 1, i] - control[j, i])
            square += d * d
        total += _WEIGHTS[n] * math.sqrt(square)
    return 0.5 * (u1 - u0) * total


@kernel
def put_state(control: FloatArray, u: float, out: FloatArray) -> None:
    """Position, tangent and curvature vector (3, 3) of the Bezier curve at u, over its arc length."""
    bezier(control, u, out)
    speed = math.sqrt(dot(out[1], out[1]))
    for i in range(3):
        out[1, i] /= speed
    along = dot(out[2], out[1])
    for i in range(3):
        out[2, i] = (out[2, i] - along * out[1, i]) / (speed * speed)


def put_pieces(control: FloatArray, coefficients: FloatArray, lengths: FloatArray) -> int:
    """`arc_length_pieces` into (n, 3, 6) and (n,), room for 2^7; returns their number."""
    return _put_pieces(control, coefficients, lengths, np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((_HALVINGS + 2, 3)))


@loaded_on_call
def _put_pieces(
    control: FloatArray, coefficients: FloatArray, lengths: FloatArray, start: FloatArray, end: FloatArray, spans: FloatArray
) -> int:
    """`put_pieces`; `start`, `end` (3, 3) and `spans` (_HALVINGS + 2, 3) are scratch."""
    spans[0, 1] = 1.0
    waiting, count = 1, 0
    while waiting > 0:
        waiting -= 1
        u0, u1, halved = spans[waiting, 0], spans[waiting, 1], spans[waiting, 2]
        length = length_between(control, u0, u1)
        put_state(control, u0, start)
        put_state(control, u1, end)
        piece = coefficients[count]
        for i in range(3):
            quintic(length, start[:, i], end[:, i], piece[i])
        if halved < _HALVINGS and speed_error(piece, length) > _SPEED_ERROR:
            middle = 0.5 * (u0 + u1)
            spans[waiting, 0], spans[waiting, 1], spans[waiting, 2] = middle, u1, halved + 1.0
            spans[waiting + 1, 0], spans[waiting + 1, 1], spans[waiting + 1, 2] = u0, middle, halved + 1.0
            waiting += 2
            continue
        lengths[count] = length
        count += 1
    return count


@kernel
def quintic(x: float, start: FloatArray, end: FloatArray, out: FloatArray) -> None:
    """`hermite` of one coordinate into (6,): value, slope and second derivative (3,) at 0 and at x."""
    p = end[0] - (start[0] + x * (start[1] + 0.5 * x * start[2]))
    d = x * (end[1] - (start[1] + x * start[2]))
    k = x * x * (end[2] - start[2])
    out[0], out[1], out[2] = start[0], start[1], 0.5 * start[2]
    out[3] = (10.0 * p - 4.0 * d + 0.5 * k) / (x * x * x)
    out[4] = (-15.0 * p + 7.0 * d - k) / (x * x * x * x)
    out[5] = (6.0 * p - 3.0 * d + 0.5 * k) / (x * x * x * x * x)


@kernel
def speed_error(piece: FloatArray, length: float) -> float:
    """Largest deviation of the length of the first derivative from 1, at `SAMPLES` even steps."""
    worst = 0.0
    for n in range(SAMPLES):
        square = 0.0
        for i in range(3):
            d = polynomial_at(piece[i], length * n / (SAMPLES - 1), 1)
            square += d * d
        worst = max(worst, abs(math.sqrt(square) - 1.0))
    return worst


def _within(corner: FloatArray, limit: float, tolerance: float) -> float:
    """Largest distance up to `limit` [m] at which path and blend deviate by at most `tolerance` [m]."""
    scratch = np.zeros((6, 3)), np.zeros((6, 3)), np.zeros((4, 3)), np.zeros((_CHORDS + 1, 3)), np.zeros((3, 3))
    return _widest(corner, limit, tolerance, *scratch)


@loaded_on_call
def _widest(
    corner: FloatArray, limit: float, tolerance: float, control: FloatArray, ends: FloatArray, v: FloatArray, curve: FloatArray,
    p: FloatArray,
) -> float:  # fmt: skip
    """`_within`; the last five are scratch."""
    widest = deviation(corner, limit, math.inf, control, ends, v, curve, p)
    if widest <= tolerance:
        return limit
    if straight(corner[0]) and straight(corner[1]):
        return limit * tolerance / widest  # blends of a corner between lines are similar to each other
    low, high = 0.0, limit
    for _ in range(20):
        distance = 0.5 * (low + high)
        if deviation(corner, distance, tolerance, control, ends, v, curve, p) > tolerance:
            high = distance
        else:
            low = distance
    return low


@kernel
def straight(shape: FloatArray) -> bool:
    """Whether a row of `_corner` is a line."""
    if int(shape[0]) == HELIX:
        return False
    for i in range(3):
        for k in range(2, 6):
            if shape[2 + 6 * i + k] != 0.0:
                return False
    return True


@kernel
def deviation(
    corner: FloatArray,
    distance: float,
    enough: float,
    control: FloatArray,
    ends: FloatArray,
    v: FloatArray,
    curve: FloatArray,
    p: FloatArray,
) -> float:
    """Largest distance [m] of the original corner from the blend that starts and ends `distance` from it; inf without one.

    More than `enough` is not measured any further. The arrays are scratch: (6, 3), (6, 3), (4, 3), (65, 3), (3, 3).
    """
    if not control_points(corner, distance, control, ends, v):
        return math.inf
    for n in range(_CHORDS + 1):
        bezier(control, n / _CHORDS, p)
        for i in range(3):
            curve[n, i] = p[0, i]
    worst = 0.0
    for n in range(2 * _LOOKS):
        side, x = n // _LOOKS, distance * (n % _LOOKS) / (_LOOKS - 1)
        put_shape(corner[side], corner[0, 1] - x if side == 0 else x, p)
        worst = max(worst, polygon_distance(curve, p[0]))
        if worst > enough:
            break
    return worst


@kernel
def polygon_distance(curve: FloatArray, p: FloatArray) -> float:
    """Distance [m] of a point from a polygon."""
    nearest = math.inf
    for n in range(len(curve) - 1):
        along = chord = 0.0
        for i in range(3):
            d = curve[n + 1, i] - curve[n, i]
            along += (p[i] - curve[n, i]) * d
            chord += d * d
        share = min(max(along / chord, 0.0), 1.0)
        square = 0.0
        for i in range(3):
            e = curve[n, i] + share * (curve[n + 1, i] - curve[n, i]) - p[i]
            square += e * e
        nearest = min(nearest, square)
    return math.sqrt(nearest)
