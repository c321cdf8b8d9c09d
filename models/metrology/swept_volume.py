"""What a cutter sweeps along its path, and exact questions about it: how far, how deep, where does it end.

Between two samples the tip goes straight. At each instant the flat end mill is a disc of its radius at every height from its
end face up: the disc lies horizontal, its centre is on the (slightly tilted) axis, the end face is square to the axis. For
tilts of a few mrad that is the tilted cylinder to the square of the tilt.

The segments hang in a tree of hulls over runs of the path: consecutive segments lie side by side, so a question visits
the few that are near, however long the path is. Everything in frame P, lengths in m. The loops are compiled when Numba is there.
"""

from __future__ import annotations

import math

import numpy as np

from robomill.models.metrology.tool_path import ToolPath
from robomill.models.model.compiled import compiled
from robomill.models.model.declaration import FloatArray, kernel

LEAF = 8
"""Segments in a hull that is not divided further; 4 and 16 take longer."""

_TOUCH = 1e-12
"""Intervals of a ray that are this near to each other [m] hang together (roundoff of coordinates of a metre)."""

_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)

_PRECISE = 1e-9
"""Length of a segment [m] that the golden section leaves unknown; it enters a smallest distance squared."""

XA, YA, ZA, TXA, TYA, XB, YB, ZB, TXB, TYB, RADIUS = range(11)
"""Columns of a segment: both ends as tip and tilt, and the radius of the cutter."""

WIDE, LOW = 4, 5
"""Columns of a hull, after both ends of its chord: half width and least height."""


class SweptVolume:
    """The volume that a cutter sweeps along a path."""

    def __init__(self, path: ToolPath) -> None:
        """Build the tree over the segments of `path`."""
        p, tilt = path.position, path.tilt
        self.rows = np.ascontiguousarray(np.hstack([p[:-1], tilt[:-1], p[1:], tilt[1:], path.radius[:-1, None]]))
        self.hulls = _tree(self.rows)

    def distance(self, points: FloatArray, most: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Distance [m] (n,) of `points` (n, 3) from the volume, 0 inside it, and the nearest points of the volume (n, 3).

        Where the distance is known to be at most `most` [m] (n,), it is found faster.
        """
        far, nearest = np.empty(len(points)), np.empty((len(points), 3))
        bound = np.full(len(points), np.inf) if most is None else (most + _TOUCH) * (1.0 + 1e-9)
        compiled(_distances)(np.ascontiguousarray(points), bound, self.rows, self.hulls, far, nearest)
        return far, nearest

    def covers(self, points: FloatArray, margin: float) -> FloatArray:
        """1.0 where the volume covers the points (n, 3) by more than `margin` [m] across the axis, else 0.0."""
        inside = np.empty(len(points))
        compiled(_covers)(np.ascontiguousarray(points), self.rows, self.hulls, margin, inside)
        return inside

    def ends(self, points: FloatArray, direction: FloatArray, limit: FloatArray) -> FloatArray:
        """Way [m] (n,) from `points` (n, 3) along the horizontal `direction` (n, 2) to where the volume ends, at most `limit` (n,).

        0 for points outside the volume.
        """
        way = np.empty(len(points))
        compiled(_ends)(np.ascontiguousarray(points), np.ascontiguousarray(direction), limit, self.rows, self.hulls, way)
        return way

    def entries(self, points: FloatArray, direction: FloatArray, least: float, limit: FloatArray) -> FloatArray:
        """Way [m] (n,) of more than `least` along the horizontal `direction` (n, 2) to where the volume begins again; `limit` if not."""
        way = np.empty(len(points))
        compiled(_entries)(np.ascontiguousarray(points), np.ascontiguousarray(direction), least, limit, self.rows, self.hulls, way)
        return way

    def bottom(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lowest height [m] (n,) of the volume over the points (n, 2), inf where it has none, and its slope there (n, 2)."""
        height, slope = np.empty(len(xy)), np.zeros((len(xy), 2))
        compiled(_bottoms)(np.ascontiguousarray(xy), self.rows, self.hulls, height, slope)
        return height, slope


@kernel
def _to_chord(x: float, y: float, xa: float, ya: float, xb: float, yb: float) -> float:
    """Distance squared of a point from the segment a-b."""
    ux, uy = xb - xa, yb - ya
    wx, wy = x - xa, y - ya
    length2 = ux * ux + uy * uy
    if length2 > 0.0:
        t = min(max((wx * ux + wy * uy) / length2, 0.0), 1.0)
        wx -= t * ux
        wy -= t * uy
    return wx * wx + wy * wy


def _tree(rows: FloatArray) -> FloatArray:
    """Hulls as a heap (node i has 2 i + 1 and 2 i + 2; the last level are runs of LEAF segments), (nodes, 6).

    A hull is a stadium around the chord of its run, open upwards: x, y of both ends of the chord, half width, least height.
    """
    depth = np.maximum(0.0, -np.minimum(rows[:, ZA], rows[:, ZB]))
    lean = np.maximum(np.hypot(rows[:, TXA], rows[:, TYA]), np.hypot(rows[:, TXB], rows[:, TYB]))
    wide = rows[:, RADIUS] + lean * depth
    low = np.minimum(rows[:, ZA], rows[:, ZB]) - lean * rows[:, RADIUS]
    levels = max(0, math.ceil(math.log2(-(-len(rows) // LEAF))))
    hulls = np.zeros((2 ** (levels + 1) - 1, 6))
    hulls[:, WIDE], hulls[:, LOW] = -np.inf, np.inf
    compiled(_enclose)(rows, wide, low, levels, hulls)
    return hulls


def _enclose(rows: FloatArray, wide: FloatArray, low: FloatArray, levels: int, hulls: FloatArray) -> None:
    for level in range(levels + 1):
        run = LEAF << (levels - level)
        for i in range(-(-len(rows) // run)):
            first, last = i * run, min((i + 1) * run, len(rows)) - 1
            hull = hulls[(1 << level) - 1 + i]
            xa, ya, xb, yb = rows[first, XA], rows[first, YA], rows[last, XB], rows[last, YB]
            hull[0], hull[1], hull[2], hull[3] = xa, ya, xb, yb
            for k in range(first, last + 1):
                off2 = max(_to_chord(rows[k, XA], rows[k, YA], xa, ya, xb, yb), _to_chord(rows[k, XB], rows[k, YB], xa, ya, xb, yb))
                hull[WIDE] = max(hull[WIDE], math.sqrt(off2) + wide[k])
                hull[LOW] = min(hull[LOW], low[k])


# ---------------------------------------------------------------- one cutter, one segment
@kernel
def _cutter(row: FloatArray, t: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The point nearest to (x, y, z) of the cutter at the share t of a segment."""
    tx = row[TXA] + t * (row[TXB] - row[TXA])
    ty = row[TYA] + t * (row[TYB] - row[TYA])
    tip = row[ZA] + t * (row[ZB] - row[ZA])
    above = max(z - tip, 0.0)
    cx = row[XA] + t * (row[XB] - row[XA]) + tx * above
    cy = row[YA] + t * (row[YB] - row[YA]) + ty * above
    rx, ry = x - cx, y - cy
    r = math.sqrt(rx * rx + ry * ry)
    if r > row[RADIUS]:
        rx *= row[RADIUS] / r
        ry *= row[RADIUS] / r
        x, y = cx + rx, cy + ry
    return x, y, max(z, tip - tx * rx - ty * ry)


@kernel
def _squared(row: FloatArray, t: float, x: float, y: float, z: float) -> float:
    """Distance squared of (x, y, z) from the cutter at the share t of a segment."""
    nx, ny, nz = _cutter(row, t, x, y, z)
    result: float = (x - nx) * (x - nx) + (y - ny) * (y - ny) + (z - nz) * (z - nz)
    return result


@kernel
def _abreast(row: FloatArray, x: float, y: float, z: float) -> float:
    """The share of a segment at which its axis, at height z or at the tip, passes (x, y) most closely."""
    ha, hb = max(z - row[ZA], 0.0), max(z - row[ZB], 0.0)
    xa, ya = row[XA] + row[TXA] * ha, row[YA] + row[TYA] * ha
    ux, uy = row[XB] + row[TXB] * hb - xa, row[YB] + row[TYB] * hb - ya
    length2 = ux * ux + uy * uy
    if length2 == 0.0:
        return 0.0
    share: float = min(max(((x - xa) * ux + (y - ya) * uy) / length2, 0.0), 1.0)
    return share


@kernel
def _nearest_share(row: FloatArray, x: float, y: float, z: float, best: float) -> tuple[float, float]:
    """The share of a segment at which the cutter is nearest to (x, y, z), and that distance squared; not sought below `best`.

    The distance is convex in the share (a straight sweep of a convex body). The closest pass is the answer unless the tip
    goes up or down below the point's height.
    """
    t = _abreast(row, x, y, z)
    low, high = min(row[ZA], row[ZB]), max(row[ZA], row[ZB])
    lean = max(abs(row[TXA]) + abs(row[TYA]), abs(row[TXB]) + abs(row[TYB]))
    below = max(low - lean * row[RADIUS] - z, 0.0)
    if below * below >= best:
        return t, best
    nx, ny, nz = _cutter(row, t, x, y, z)
    aside2 = (x - nx) * (x - nx) + (y - ny) * (y - ny)
    found = aside2 + (z - nz) * (z - nz)
    if high <= z or high == low or aside2 >= best:
        return t, found
    # the end face is nowhere lower below the point than at the closest pass less what tip and inclination change on the way
    dx, dy, dz = row[XB] - row[XA], row[YB] - row[YA], row[ZB] - row[ZA]
    length = math.sqrt(dx * dx + dy * dy)
    swing = abs(row[TXB] - row[TXA]) + abs(row[TYB] - row[TYA])
    below = max(nz - (1.0 - t if dz < 0.0 else t) * abs(dz) - lean * length - swing * row[RADIUS] - z, 0.0)
    if aside2 + below * below >= min(best, found):
        return t, found
    unknown = math.sqrt(dx * dx + dy * dy + dz * dz)
    start, stop = 0.0, 1.0
    s0, s1 = 1.0 - _GOLDEN, _GOLDEN
    f0, f1 = _squared(row, s0, x, y, z), _squared(row, s1, x, y, z)
    while unknown > _PRECISE:
        unknown *= _GOLDEN
        if f0 < f1:
            stop, s1, f1 = s1, s0, f0
            s0 = stop - _GOLDEN * (stop - start)
            f0 = _squared(row, s0, x, y, z)
        else:
            start, s0, f0 = s0, s1, f1
            s1 = start + _GOLDEN * (stop - start)
            f1 = _squared(row, s1, x, y, z)
    for s in (s0, s1, 0.0, 1.0):
        f = _squared(row, s, x, y, z)
        if f < found:
            t, found = s, f
    return t, found


@kernel
def _slice(row: FloatArray, z: float) -> tuple[float, float, float, float, bool]:
    """Both ends (x, y) of the axis at height z of the part of a segment whose tip is below z; False if there is none."""
    za, zb = row[ZA], row[ZB]
    xa = row[XA] + row[TXA] * (z - za)
    ya = row[YA] + row[TYA] * (z - za)
    xb = row[XB] + row[TXB] * (z - zb)
    yb = row[YB] + row[TYB] * (z - zb)
    if za > z and zb > z:
        return xa, ya, xb, yb, False
    if za > z:
        t = (za - z) / (za - zb)
        xa += t * (xb - xa)
        ya += t * (yb - ya)
    elif zb > z:
        t = (zb - z) / (zb - za)
        xb += t * (xa - xb)
        yb += t * (ya - yb)
    return xa, ya, xb, yb, True


@kernel
def _span(xa: float, ya: float, xb: float, yb: float, ex: float, ey: float, radius: float) -> tuple[float, float]:
    """Interval of s in which the ray s (ex, ey) is inside the stadium of `radius` around a-b; low > high if it misses.

    The stadium is convex: the extremes of its two discs and of the rectangle between them.
    """
    low, high = 1e30, -1e30
    for px, py in ((xa, ya), (xb, yb)):
        middle = px * ex + py * ey
        across = px * ey - py * ex
        half2 = radius * radius - across * across
        if half2 >= 0.0:
            half = math.sqrt(half2)
            low = min(low, middle - half)
            high = max(high, middle + half)
    ux, uy = xb - xa, yb - ya
    length = math.sqrt(ux * ux + uy * uy)
    if length > 1e-15:
        ux /= length
        uy /= length
        start, stop = -1e30, 1e30
        # coordinates of the ray along the segment (0..length) and across it (-radius..radius): origin + s * rate
        for origin, rate, least, most in (
            (-(xa * ux + ya * uy), ex * ux + ey * uy, 0.0, length),
            (xa * uy - ya * ux, ey * ux - ex * uy, -radius, radius),
        ):
            if abs(rate) > 1e-15:
                s0, s1 = (least - origin) / rate, (most - origin) / rate
                start = max(start, min(s0, s1))
                stop = min(stop, max(s0, s1))
            elif origin < least or origin > most:
                stop = start - 1.0
        if start <= stop:
            low = min(low, start)
            high = max(high, stop)
    return low, high


# ---------------------------------------------------------------- loops over points, down the tree
@kernel
def _to_hull(hull: FloatArray, x: float, y: float, z: float) -> float:
    """Distance squared of a point from a hull, inf from an empty one."""
    aside = math.sqrt(_to_chord(x, y, hull[0], hull[1], hull[2], hull[3])) - hull[WIDE]
    below = hull[LOW] - z
    squared: float = max(aside, 0.0) ** 2 + max(below, 0.0) ** 2
    return squared


def _distances(points: FloatArray, bound: FloatArray, rows: FloatArray, hulls: FloatArray, far: FloatArray, nearest: FloatArray) -> None:
    leaves = (len(hulls) + 1) // 2
    stack = np.empty(128, np.int64)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        best, which, share = bound[i] * bound[i], 0, 0.0
        stack[0] = 0
        n = 1
        while n > 0 and best > 0.0:
            n -= 1
            node = stack[n]
            if _to_hull(hulls[node], x, y, z) >= best:
                continue
            if node >= leaves - 1:
                first = (node - leaves + 1) * LEAF
                for k in range(first, min(first + LEAF, len(rows))):
                    t, found = _nearest_share(rows[k], x, y, z, best)
                    if found < best:
                        best, which, share = found, k, t
                continue
            a, b = 2 * node + 1, 2 * node + 2
            if _to_hull(hulls[a], x, y, z) < _to_hull(hulls[b], x, y, z):
                a, b = b, a
            stack[n] = a
            stack[n + 1] = b  # the nearer one is looked at first
            n += 2
        far[i] = math.sqrt(best)
        nearest[i, 0], nearest[i, 1], nearest[i, 2] = _cutter(rows[which], share, x, y, z)


def _covers(points: FloatArray, rows: FloatArray, hulls: FloatArray, margin: float, inside: FloatArray) -> None:
    leaves = (len(hulls) + 1) // 2
    stack = np.empty(128, np.int64)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        inside[i] = 0.0
        stack[0] = 0
        n = 1
        while n > 0:
            n -= 1
            node = stack[n]
            if _to_hull(hulls[node], x, y, z) > 0.0:
                continue
            if node < leaves - 1:
                stack[n] = 2 * node + 1
                stack[n + 1] = 2 * node + 2
                n += 2
                continue
            first = (node - leaves + 1) * LEAF
            for k in range(first, min(first + LEAF, len(rows))):
                xa, ya, xb, yb, cuts = _slice(rows[k], z)
                if not cuts:
                    continue
                least = rows[k, RADIUS] - margin
                if _to_chord(x, y, xa, ya, xb, yb) < least * least:
                    inside[i] = 1.0
                    n = 0
                    break


def _ends(points: FloatArray, direction: FloatArray, limit: FloatArray, rows: FloatArray, hulls: FloatArray, way: FloatArray) -> None:
    """Each segment sweeps an interval of the ray; the intervals that hang together with the point count."""
    leaves = (len(hulls) + 1) // 2
    stack = np.empty(128, np.int64)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        ex, ey = direction[i, 0], direction[i, 1]
        s, before = 0.0, -1.0
        while s > before and s < limit[i]:
            before = s
            stack[0] = 0
            n = 1
            while n > 0:
                n -= 1
                node = stack[n]
                hull = hulls[node]
                if _to_hull(hull, x + s * ex, y + s * ey, z) > _TOUCH * _TOUCH:
                    continue
                if max((hull[0] - x) * ex + (hull[1] - y) * ey, (hull[2] - x) * ex + (hull[3] - y) * ey) + hull[WIDE] <= s:
                    continue  # nothing in it goes further
                if node < leaves - 1:
                    stack[n] = 2 * node + 1
                    stack[n + 1] = 2 * node + 2
                    n += 2
                    continue
                first = (node - leaves + 1) * LEAF
                for k in range(first, min(first + LEAF, len(rows))):
                    xa, ya, xb, yb, cuts = _slice(rows[k], z)
                    if cuts and max((xa - x) * ex + (ya - y) * ey, (xb - x) * ex + (yb - y) * ey) + rows[k, RADIUS] > s:
                        low, high = _span(xa - x, ya - y, xb - x, yb - y, ex, ey, rows[k, RADIUS])
                        if low <= s + _TOUCH and high > s:
                            s = high
        way[i] = min(s, limit[i])


def _entries(
    points: FloatArray, direction: FloatArray, least: float, limit: FloatArray, rows: FloatArray, hulls: FloatArray, way: FloatArray
) -> None:
    leaves = (len(hulls) + 1) // 2
    stack = np.empty(128, np.int64)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        ex, ey = direction[i, 0], direction[i, 1]
        s = limit[i]
        stack[0] = 0
        n = 1
        while n > 0:
            n -= 1
            node = stack[n]
            hull = hulls[node]
            # the ray from x, y to s, as the circle around it
            aside = math.sqrt(_to_chord(x + 0.5 * s * ex, y + 0.5 * s * ey, hull[0], hull[1], hull[2], hull[3]))
            if hull[LOW] > z or aside > hull[WIDE] + 0.5 * s:
                continue
            if node < leaves - 1:
                stack[n] = 2 * node + 1
                stack[n + 1] = 2 * node + 2
                n += 2
                continue
            first = (node - leaves + 1) * LEAF
            for k in range(first, min(first + LEAF, len(rows))):
                xa, ya, xb, yb, cuts = _slice(rows[k], z)
                if cuts:
                    low, high = _span(xa - x, ya - y, xb - x, yb - y, ex, ey, rows[k, RADIUS])
                    if low <= high and low > least and low < s:
                        s = low
        way[i] = s


def _bottoms(xy: FloatArray, rows: FloatArray, hulls: FloatArray, height: FloatArray, slope: FloatArray) -> None:
    leaves = (len(hulls) + 1) // 2
    stack = np.empty(128, np.int64)
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        lowest = math.inf
        stack[0] = 0
        n = 1
        while n > 0:
            n -= 1
            node = stack[n]
            hull = hulls[node]
            if hull[LOW] >= lowest - _TOUCH or _to_hull(hull, x, y, hull[LOW]) > 0.0:
                continue
            if node < leaves - 1:
                stack[n] = 2 * node + 1
                stack[n + 1] = 2 * node + 2
                n += 2
                continue
            first = (node - leaves + 1) * LEAF
            for k in range(first, min(first + LEAF, len(rows))):
                row = rows[k]
                ux, uy = row[XB] - row[XA], row[YB] - row[YA]
                wx, wy = x - row[XA], y - row[YA]
                a = ux * ux + uy * uy
                rest = wx * wx + wy * wy - row[RADIUS] * row[RADIUS]
                t0, t1 = 0.0, 1.0
                rim0, rim1 = False, False
                if a > 1e-30:
                    b = wx * ux + wy * uy
                    root = b * b - a * rest
                    if root < 0.0:
                        continue
                    root = math.sqrt(root)
                    rim0, rim1 = b - root > 0.0, b + root < a
                    t0, t1 = max((b - root) / a, 0.0), min((b + root) / a, 1.0)
                    if t0 > t1:
                        continue
                elif rest > 0.0:
                    continue
                for t, rim in ((t0, rim0), (t1, rim1)):
                    tx = row[TXA] + t * (row[TXB] - row[TXA])
                    ty = row[TYA] + t * (row[TYB] - row[TYA])
                    here = row[ZA] + t * (row[ZB] - row[ZA]) - tx * (wx - t * ux) - ty * (wy - t * uy)
                    if here < lowest:
                        lowest = here
                        rate = (row[ZB] - row[ZA]) / a if rim else 0.0
                        slope[i, 0], slope[i, 1] = rate * ux - tx, rate * uy - ty
        height[i] = lowest
