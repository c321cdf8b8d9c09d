"""Where the edges of a cutter are in material: elements of its profile by height, of its turn by angle.

The record is that of the component `tridexel_milling_force`, whose states these kernels fill.
"""

from __future__ import annotations

import math

from robomill.models.maths.elementary import sincos
from robomill.models.model.declaration import FloatArray, Record, kernel
from robomill.models.process import tridexels

BINS = 120
"""Angular bins of 3 degrees over the whole turn."""
NOSE = 12
"""Elements of a rounded corner from its lowest point to the cylinder: 7.5 degrees each."""
DISCS = 60
"""Elements along the cutter's profile, at most: those of the corner and of the cylinder."""
DISC = 1e-3
"""Height of an element of the cylinder [m], unless the engaged height needs more than there are."""
RING = 1.75
"""Material is looked for this many cells outside of the cutter, ahead along the feed, clear of what it has cut itself."""
GATE = 0.75
"""The edge itself may be this many cells outside of the material that it is about to meet."""
LEAST_SPEED = 1e-12
"""Speed [m/s] below which an element stands still."""

PI = math.pi
TWO_PI = 2.0 * math.pi


@kernel
def profile(s: Record) -> None:
    """Cut the cutter's profile into elements: the rounded corner by equal angles, the cylinder by equal heights up to the box."""
    radius = 0.5 * s.mill_diameter
    core = radius - s.mill_corner
    top = 0.0  # how far up its axis the cutter can meet the box
    for i in range(3):
        edge = s.origin[i] + s.extent[i] if s.axis_mid[i] > 0.0 else s.origin[i]
        top += (edge - s.p_mid[i]) * s.axis_mid[i]
    side = 0.0
    for i in range(3):
        side += radius * abs(s.axis_mid[i]) * math.sqrt(max(1.0 - s.axis_mid[i] * s.axis_mid[i], 0.0))
    top = min(top + side, s.mill_cutting_length)
    n = 0
    if s.mill_corner > 0.0:
        for k in range(NOSE + 1):
            sine, cosine = sincos(0.5 * PI * k / NOSE)
            if k == NOSE:
                sine, cosine = 1.0, 0.0
            _level(s.level, k, s.mill_corner * (1.0 - cosine), core + s.mill_corner * sine, sine, cosine)
        for k in range(NOSE):
            if s.level[k, 0] >= top:
                break
            sine, cosine = sincos(0.5 * PI * (k + 0.5) / NOSE)
            _level(s.middle, k, s.mill_corner * (1.0 - cosine), core + s.mill_corner * sine, sine, cosine)
            s.edge[k] = 0.5 * PI / NOSE * s.mill_corner
            n = k + 1
    else:
        _level(s.level, 0, 0.0, radius, 1.0, 0.0)
    height = top - s.mill_corner
    if height > 0.0:
        count = min(math.floor(height / DISC) + 1, DISCS - n)
        for k in range(count):
            _level(s.level, n + k + 1, s.mill_corner + height * (k + 1) / count, radius, 1.0, 0.0)
            _level(s.middle, n + k, s.mill_corner + height * (k + 0.5) / count, radius, 1.0, 0.0)
            s.edge[n + k] = height / count
        n += count
    s.discs = n


@kernel
def _level(out: FloatArray, k: int, height: float, radius: float, sine: float, cosine: float) -> None:
    out[k, 0] = height
    out[k, 1] = radius
    out[k, 2] = sine
    out[k, 3] = cosine


@kernel
def _reach(s: Record, sine: float, cosine: float, height: float, radius: float, up: float, down: float) -> float:
    """How far [m] material reaches before the envelope at an angle about the axis (its sine, cosine) and a place of the profile.

    Positive where an edge is in it; far negative where the envelope does not advance, up to a bin's width of it.
    """
    far: float = -tridexels.FAR * max(s.pitch[0], s.pitch[1], s.pitch[2])
    ax, ay, az = s.axis_mid[0], s.axis_mid[1], s.axis_mid[2]
    ox = sine * s.ahead[0] + cosine * s.left[0]
    oy = sine * s.ahead[1] + cosine * s.left[1]
    oz = sine * s.ahead[2] + cosine * s.left[2]
    rx, ry, rz = radius * ox + height * ax, radius * oy + height * ay, radius * oz + height * az
    vx = s.v_P[0] + s.swing[1] * rz - s.swing[2] * ry
    vy = s.v_P[1] + s.swing[2] * rx - s.swing[0] * rz
    vz = s.v_P[2] + s.swing[0] * ry - s.swing[1] * rx
    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    if speed < LEAST_SPEED:
        return far
    facing = (up * (vx * ox + vy * oy + vz * oz) - down * (vx * ax + vy * ay + vz * az)) / speed
    if facing < -TWO_PI / BINS:
        return far
    px, py, pz = s.p_mid[0] + rx, s.p_mid[1] + ry, s.p_mid[2] + rz
    spacing = max(s.pitch[0], s.pitch[1], s.pitch[2])
    bend = 0.5 * s.mill_diameter
    q = RING * spacing / bend
    way = bend * (math.sqrt(facing * facing + 2.0 * q + q * q) - facing) / speed
    before = tridexels.distance(s.pool, s.cells, s.origin, s.pitch, s.tick, s.segments, px + way * vx, py + way * vy, pz + way * vz)
    if before <= 0.0:
        return before
    here: float = tridexels.distance(s.pool, s.cells, s.origin, s.pitch, s.tick, s.segments, px, py, pz) + GATE * spacing
    return min(before, here)


@kernel
def reach_at(s: Record, n: int, out: FloatArray) -> None:
    """`_reach` at level n of the profile, at all bounds of bins."""
    for b in range(BINS):
        out[b] = _reach(s, s.bound_sine[b], s.bound_cosine[b], s.level[n, 0], s.level[n, 1], s.level[n, 2], s.level[n, 3])
    out[BINS] = out[0]


@kernel
def shares(s: Record, n: int) -> bool:
    """Share of element n that is in material: along the profile at the bounds of the bins, then in the bins; whether any is."""
    found = False
    for b in range(BINS):
        f0, f1 = s.lower[b], s.upper[b]
        share = 0.0
        if f0 > 0.0 and f1 > 0.0:
            share = 1.0
        elif f0 > 0.0 or f1 > 0.0:
            place = _crossing(s, n, b, f0, f1)
            share = place if f0 > 0.0 else 1.0 - place
        s.engaged[b] = share
        if share > 0.0:
            found = True
    s.engaged[BINS] = s.engaged[0]
    for b in range(BINS):
        e0, e1 = s.engaged[b], s.engaged[b + 1]
        if (e0 > 0.0) == (e1 > 0.0):
            s.share[b] = 0.5 * (e0 + e1)
        else:
            # the material ends within the bin: halve it to where, then go straight, so that the force follows the pose smoothly
            inside, outside = (0.0, 1.0) if e0 > 0.0 else (1.0, 0.0)
            f_inside, f_outside = 0.0, 0.0
            m = s.middle[n]
            for _ in range(4):
                place = 0.5 * (inside + outside)
                sine, cosine = sincos(TWO_PI * (b + place) / BINS)
                f = _reach(s, sine, cosine, m[0], m[1], m[2], m[3])
                if f > 0.0:
                    inside, f_inside = place, f
                else:
                    outside, f_outside = place, f
            place = 0.5 * (inside + outside)
            if f_inside > f_outside:
                place = inside + (outside - inside) * f_inside / (f_inside - f_outside)
            s.share[b] = e0 * place if e0 > 0.0 else e1 * (1.0 - place)
    return found


@kernel
def _crossing(s: Record, n: int, b: int, f0: float, f1: float) -> float:
    """Part of element n below the place at which the material ends along its profile, by false position (Illinois)."""
    t0, t1 = 0.0, 1.0
    t = 0.5
    for _ in range(4):
        t = t0 + (t1 - t0) * f0 / (f0 - f1)
        u = 1.0 - t
        f = _reach(
            s,
            s.bound_sine[b],
            s.bound_cosine[b],
            u * s.level[n, 0] + t * s.level[n + 1, 0],
            u * s.level[n, 1] + t * s.level[n + 1, 1],
            u * s.level[n, 2] + t * s.level[n + 1, 2],
            u * s.level[n, 3] + t * s.level[n + 1, 3],
        )
        if (f > 0.0) == (f0 > 0.0):
            t0, f0 = t, f
            f1 *= 0.5
        else:
            t1, f1 = t, f
            f0 *= 0.5
    return t
