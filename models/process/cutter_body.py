"""The volume that a turning end mill fills, flat, bull nose or ball nose, and where a line parallel to an axis of P passes through it.

The body of a cutter of radius R with corner radius r (0: flat, R: ball) is everything within r of a core: the solid
cylinder of radius c = R - r about the tool axis that begins at height r above the tip and has no upper end. It is
convex, so a line meets it in one interval. Heights w are along the tool axis, a unit vector from tip to spindle.

All functions are kernels; lengths in m.
"""

from __future__ import annotations

import math

from robomill.models.model.declaration import FloatArray, kernel

PARALLEL = 1e-14
"""Square of the sine of the angle between a line and the tool axis below which they count as parallel."""

NEWTON_STEPS = 30
"""Newton steps to the rounded corner of a bull nose, at most; about five are needed, more where the line just touches it."""

NEWTON_END = 1e-10
"""Distance [m] from the surface at which Newton's method ends."""


@kernel
def chord(
    k: int,
    point: FloatArray,
    length: float,
    tip: FloatArray,
    axis: FloatArray,
    radius: float,
    corner: float,
) -> tuple[float, float]:
    """Interval t0..t1 [m] of the line point + t e_k, 0 <= t <= length, inside the cutter; t0 >= t1 if it misses.

    `k`: direction of the line (0, 1, 2); point, tip (3,) [m] and axis (3,) in P.
    """
    x, y, z = point[0] - tip[0], point[1] - tip[1], point[2] - tip[2]
    slope = axis[k]
    w = x * axis[0] + y * axis[1] + z * axis[2]
    along = x if k == 0 else (y if k == 1 else z)
    square = x * x + y * y + z * z
    # the cylinder: a t^2 + 2 b t + c <= 0
    a = 1.0 - slope * slope
    b = along - w * slope
    c = square - w * w - radius * radius
    low, high = 0.0, length
    if a < PARALLEL:
        if c > 0.0:
            return 0.0, 0.0
    else:
        d = b * b - a * c
        if d <= 0.0:
            return 0.0, 0.0
        d = math.sqrt(d)
        low = max(low, (-b - d) / a)
        high = min(high, (-b + d) / a)
    if corner >= radius:
        return _ball(w, slope, along, square, radius, length, low, high)
    # the half space above the tip
    if slope > 0.0:
        low = max(low, -w / slope)
    elif slope < 0.0:
        high = min(high, -w / slope)
    elif w < 0.0:
        return 0.0, 0.0
    if low >= high or corner <= 0.0:
        return low, high
    core = radius - corner
    low = _approach(low, high, 1.0, w, slope, a, b, c + radius * radius, core, corner)
    if low >= high:
        return 0.0, 0.0
    return low, _approach(high, low, -1.0, w, slope, a, b, c + radius * radius, core, corner)


@kernel
def _ball(
    w: float, slope: float, along: float, square: float, radius: float, length: float, low: float, high: float
) -> tuple[float, float]:
    """The interval of sphere and upper cylinder (low..high) together."""
    if slope > 0.0:
        low = max(low, (radius - w) / slope)
    elif slope < 0.0:
        high = min(high, (radius - w) / slope)
    elif w < radius:
        high = low
    # the sphere about the point R above the tip
    b = along - radius * slope
    d = b * b - (square - 2.0 * radius * w)
    if d > 0.0:
        d = math.sqrt(d)
        first, last = max(-b - d, 0.0), min(-b + d, length)
        if first < last:
            if low >= high:
                return first, last
            return min(low, first), max(high, last)
    return low, high


@kernel
def _approach(
    start: float, end: float, way: float, w: float, slope: float, a: float, b: float, c: float, core: float, corner: float
) -> float:
    """From `start` outside or on the body towards `end`, the first point inside; `end` if there is none.

    Newton's method on the distance from the core, which is convex: it never steps over the surface.
    """
    t = start
    for _ in range(NEWTON_STEPS):
        height = w + t * slope
        below = corner - height
        rho = math.sqrt(max(a * t * t + 2.0 * b * t + c, 0.0))
        aside = rho - core
        if below <= 0.0 or aside <= 0.0:
            return t  # on the cylinder or on the flat of the end, where the interval begins as it is
        distance = math.sqrt(aside * aside + below * below)
        if distance - corner <= NEWTON_END:
            return t
        change = aside * (b + a * t) / rho - below * slope if rho > 0.0 else -below * slope
        change /= distance
        if change * way >= 0.0:
            return end
        t -= (distance - corner) / change
        if (t - end) * way >= 0.0:
            return end
    return t
