"""Cutting force, tooth by tooth: edges cut into discs, the turn of the spindle into slices. SI units, forces on the tool.

Force law of Altintas (FACTS 3.2). The workpiece is a height map; a cell that the tool
covers in part is lowered in part. The edges must not read cells that the tool itself is lowering, so the map lags by a
few millimetres of travel; what was cut since then is known exactly, as the places of the tool (the trail).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robomill.blind.second.kernel import ZERO3, FloatArray, compiled

CELL = 0.0005
"""Width of a cell of the workpiece [m]."""
RADIUS, TEETH, TWIST = 0.008, 3, 2.0 * math.tan(math.radians(30.0)) / 0.016
"""Cutter D16 z3, helix 30 deg: lag of the edge per height [rad/m]."""
BINS, SLICES, DISCS = 180, 8, 8
"""Directions over the front half turn, instants in a fine step, discs over the height of the edge."""
ONSET = 5e-6
"""Feed per tooth [m] below which the edge forces fade."""
ZONE, CONTACT = 1e-4, 0.06
"""Depth [m] and time [s] over which the end face comes into contact (docs/components/milling_force.md)."""
LEAST_CHIP = 1e-6
BETWEEN = 0.25 * CELL
"""Travel [m] between two places of the trail; the scallops between their discs are BETWEEN^2/(8 R) = 0.2 um high."""
OWN = 2.0 * CELL
"""Travel [m] of the trail that the edges do not look at: a tool that springs back by less stays in its cut."""
LAG = math.sqrt((RADIUS + 2.0 * CELL) ** 2 - RADIUS**2)
"""Travel [m] by which the map lags: even the edges at the sides are then two cells ahead of what has been taken from it.

Half a cell of partial cover and 1.41 cells of interpolation need 1.91 cells.
"""
TRAIL, OWN_TRAIL = math.ceil(LAG / BETWEEN) + 1, math.ceil(OWN / BETWEEN)


class Cut(NamedTuple):
    """Tool, material and clamping."""

    p_BP: FloatArray
    R_BP: FloatArray
    size: FloatArray
    """[3] m, with what the block is larger than it should be."""
    chip: FloatArray
    """[3] Pa, tangential, radial, axial."""
    edge: FloatArray
    """[3] N/m."""
    size_effect: float = 0.0
    size_reference: float = 25e-6
    size_shift: float = 1e-6
    """m, added to the chip under the power: the law has no pole."""
    runout: float = 0.0
    runout_angle: float = 0.0
    runout_tilt: float = 0.0
    """1/m, relative growth of the runout with the height."""
    yielding: FloatArray = ZERO3
    """[3] m/N along B, the block under its load."""
    yielding_time: float = 0.01
    droop: float = 0.0
    """s/(N m), outside: the spindle slows down under torque."""
    grain: float = 0.0
    grain_angle: float = 0.0
    """Outside: force that depends on the direction of the feed in the material."""
    packing: float = 0.0
    """1/s, outside: force that grows with the time in the cut."""
    start_angle: float = 0.0


class CutState(NamedTuple):
    """The workpiece and what cutting remembers: `memory` is angle, contact, time in the cut, spindle torque, shift of the block [3]."""

    top: FloatArray
    """Heights of the map [m], without what was cut along the trail."""
    trail: FloatArray
    """[TRAIL,3] m, where the tool has cut lately, oldest first; infinitely far before it has."""
    memory: FloatArray


def fresh(size: FloatArray) -> CutState:
    """An uncut block of that size [3] m, heights over its nominal top."""
    top = np.zeros((math.ceil(size[0] / CELL), math.ceil(size[1] / CELL)))
    return CutState(top, np.full((TRAIL, 3), np.inf), np.zeros(7))


@compiled
def height(top: FloatArray, size: FloatArray, x: float, y: float) -> float:
    """Height [m] of the material at a place of the block, bilinear between the middles of cells; -1 beside the block."""
    if abs(x) > 0.5 * size[0] or abs(y) > 0.5 * size[1]:
        return -1.0
    nx, ny = top.shape
    u = min(max((x / size[0] + 0.5) * nx - 0.5, 0.0), nx - 1.0)
    v = min(max((y / size[1] + 0.5) * ny - 0.5, 0.0), ny - 1.0)
    i, j = min(int(u), nx - 2), min(int(v), ny - 2)
    u -= i
    v -= j
    low = top[i, j] * (1.0 - v) + top[i, j + 1] * v
    high = top[i + 1, j] * (1.0 - v) + top[i + 1, j + 1] * v
    between: float = low * (1.0 - u) + high * u
    return between


@compiled
def remove(top: FloatArray, size: FloatArray, x: float, y: float, z: float, raw: float) -> None:
    """Take away what a disc of the tool's radius at (x, y), end face at z [m], covers; `raw` is the height of the uncut block."""
    nx, ny = top.shape
    dx, dy = size[0] / nx, size[1] / ny
    low_i, high_i = max(int((x - RADIUS + 0.5 * size[0]) / dx) - 1, 0), min(int((x + RADIUS + 0.5 * size[0]) / dx) + 2, nx)
    low_j, high_j = max(int((y - RADIUS + 0.5 * size[1]) / dy) - 1, 0), min(int((y + RADIUS + 0.5 * size[1]) / dy) + 2, ny)
    for i in range(low_i, high_i):
        for j in range(low_j, high_j):
            way = math.hypot((i + 0.5) * dx - 0.5 * size[0] - x, (j + 0.5) * dy - 0.5 * size[1] - y)
            share = (RADIUS - way) / dx + 0.5
            if share <= 0.0:
                continue
            to = z if share >= 1.0 else z + (1.0 - share) * (raw - z)
            top[i, j] = min(top[i, j], to)


@compiled
def move(s: CutState, size: FloatArray, at: FloatArray, raw: float) -> None:
    """Note that the tool has cut at `at` [3]; a new place drives the oldest of the trail into the map."""
    last = s.trail[-1]
    if math.hypot(at[0] - last[0], at[1] - last[1]) < BETWEEN:
        last[2] = min(last[2], at[2])
        return
    oldest = s.trail[0]
    if oldest[2] < np.inf:
        remove(s.top, size, oldest[0], oldest[1], oldest[2], raw)
    for k in range(TRAIL - 1):
        s.trail[k] = s.trail[k + 1]
    s.trail[-1] = at


@compiled
def standing(s: CutState, size: FloatArray, x: float, y: float, places: int) -> float:
    """Height [m] of the material at a place: that of the map, less the cut from so many oldest places of the trail; -1 beside the block."""
    z = height(s.top, size, x, y)
    for k in range(places):
        if (x - s.trail[k, 0]) ** 2 + (y - s.trail[k, 1]) ** 2 < RADIUS**2:
            z = min(z, s.trail[k, 2])
    return z


@compiled
def engagement(s: CutState, size: FloatArray, at: FloatArray, feed: FloatArray) -> FloatArray:
    """Axial depth [m] of the material at the edge, by direction [BINS], tip `at` [3] and unit feed [2] in P."""
    depth = np.zeros(BINS)
    for b in range(BINS):
        phi = (b + 0.5) * math.pi / BINS
        ahead, left = RADIUS * math.sin(phi), RADIUS * math.cos(phi)
        x, y = at[0] + ahead * feed[0] - left * feed[1], at[1] + ahead * feed[1] + left * feed[0]
        z = standing(s, size, x, y, TRAIL - OWN_TRAIL)
        if z > -0.5:
            depth[b] = max(z - at[2], 0.0)
    return depth


@compiled
def chip_of(c: Cut, tooth: int, feed: float, sine: float, z: float) -> float:
    """Chip thickness [m] of a tooth at a height: what the teeth before it have left."""
    if c.runout == 0.0:
        return feed * sine
    h = TEETH * feed * sine
    scale = c.runout * (1.0 + c.runout_tilt * z)
    mine = scale * math.cos(c.runout_angle + 2.0 * math.pi * tooth / TEETH)
    for back in range(1, TEETH):
        other = scale * math.cos(c.runout_angle + 2.0 * math.pi * (tooth + back) / TEETH)  # ahead in the turn: it was here before
        h = min(h, back * feed * sine + mine - other)
    return max(h, 0.0)


@compiled
def edges(c: Cut, depth: FloatArray, feed: float, theta0: float, theta1: float) -> FloatArray:
    """Mean force [N] and moment about the tip [N m] in cutting axes (feed, left, up), [6], from theta0 to theta1."""
    out = np.zeros(6)
    most = depth.max()
    if most <= 0.0:
        return out
    dz = most / DISCS
    fade = min(1.0, feed / ONSET)
    for n in range(SLICES):
        theta = theta0 + (n + 0.5) / SLICES * (theta1 - theta0)
        for tooth in range(TEETH):
            for k in range(DISCS):
                z = (k + 0.5) * dz
                phi = (theta + 2.0 * math.pi * tooth / TEETH - TWIST * z) % (2.0 * math.pi)
                if phi >= math.pi:
                    continue
                inside = min(max(depth[int(phi / math.pi * BINS)] - k * dz, 0.0), dz)
                if inside <= 0.0:
                    continue
                s, co = math.sin(phi), math.cos(phi)
                h = chip_of(c, tooth, feed, s, z)
                if h <= 0.0 and c.runout > 0.0:
                    continue
                scale = h
                if c.size_effect != 0.0:
                    scale *= ((max(h, LEAST_CHIP) + c.size_shift) / c.size_reference) ** (-c.size_effect)
                ft = (c.chip[0] * scale + c.edge[0] * fade) * inside
                fr = (c.chip[1] * scale + c.edge[1] * fade) * inside
                fa = (c.chip[2] * scale + c.edge[2] * fade) * inside
                fx, fy = -ft * co - fr * s, ft * s - fr * co
                out[0] += fx
                out[1] += fy
                out[2] -= fa
                # lever: z up the edge, and the place on the circumference (s, co)
                out[3] += -z * fy - RADIUS * co * fa
                out[4] += z * fx + RADIUS * s * fa
                out[5] += RADIUS * (s * fy - co * fx)
    return out / SLICES


@compiled
def end_face(c: Cut, s: CutState, h: float, at: FloatArray, down: float, omega: float, raw: float) -> tuple[float, float]:
    """Thrust [N] and torque [N m] of the end face while it goes down at a commanded speed [m/s]."""
    if down <= 0.0:
        s.memory[1] *= math.exp(-h / CONTACT)
        return 0.0, 0.0
    found, looked = 0.0, 0
    for i in range(12):
        for k in range(3):
            r, a = RADIUS * (0.3 + 0.3 * k), 2.0 * math.pi * i / 12.0
            z = standing(s, c.size, at[0] + r * math.cos(a), at[1] + r * math.sin(a), TRAIL)
            found += float(k + 1) * min(max((z - at[2]) / ZONE + 1.0, 0.0), 1.0) if z > -0.5 else 0.0
            looked += k + 1
    s.memory[1] += (1.0 - math.exp(-h / CONTACT)) * (found / looked - s.memory[1])
    feed = 2.0 * math.pi * down / (TEETH * omega)
    fade = min(1.0, feed / ONSET)
    thrust = TEETH * RADIUS * s.memory[1] * (c.chip[1] * feed + c.edge[1] * fade)
    torque = 0.5 * TEETH * RADIUS**2 * s.memory[1] * (c.chip[0] * feed + c.edge[0] * fade)
    return thrust, torque


@compiled
def outside_factor(c: Cut, s: CutState, h: float, feed: FloatArray, size: float) -> float:
    """What multiplies the force for reasons outside of the catalogue."""
    factor = 1.0
    if c.grain != 0.0:
        factor += c.grain * math.cos(2.0 * (math.atan2(feed[1], feed[0]) - c.grain_angle))
    if c.packing != 0.0:
        s.memory[2] = s.memory[2] + h if size > 20.0 else s.memory[2] * math.exp(-h / 0.05)
        factor += c.packing * s.memory[2]
    return factor


@compiled
def cut(c: Cut, s: CutState, h: float, raw: float, p: FloatArray, v: FloatArray, omega: float) -> tuple[FloatArray, FloatArray, float]:
    """Mean force [N], moment [N m] on the tool in B and spindle torque [N m] of a fine step; `raw` is the height of the uncut block.

    `p` [3] is where the tip is, `v` [3] the commanded velocity, both in B; `omega` the spindle in rad/s.
    """
    at = c.R_BP.T.copy() @ (p - c.p_BP - s.memory[4:7])
    along = c.R_BP.T.copy() @ v
    speed = math.hypot(along[0], along[1])
    turning = omega * (1.0 - min(c.droop * abs(s.memory[3]), 0.5))
    theta0 = s.memory[0]
    s.memory[0] = theta0 + turning * h
    wrench = np.zeros(6)
    if omega <= 0.0 or at[2] > raw:
        s.memory[3] = 0.0
        s.memory[4:7] *= math.exp(-h / max(c.yielding_time, 1e-6))
        return np.zeros(3), np.zeros(3), 0.0
    feed = np.array([1.0, 0.0])
    if speed > 1e-6:
        feed = along[:2] / speed
        depth = engagement(s, c.size, at, feed)
        # clockwise from the left of the feed: where that turns, the spindle does not
        ahead = c.start_angle + math.atan2(feed[1], feed[0])
        wrench = edges(c, depth, 2.0 * math.pi * speed / (TEETH * turning), theta0 + ahead, s.memory[0] + ahead)
    thrust, torque = end_face(c, s, h, at, -along[2], turning, raw)
    wrench[2] += thrust
    wrench[5] += torque
    wrench *= outside_factor(c, s, h, feed, math.sqrt(wrench[0] ** 2 + wrench[1] ** 2))
    move(s, c.size, at, raw)
    f, m = np.zeros(3), np.zeros(3)
    for i in range(3):
        f[i] = c.R_BP[i, 0] * (feed[0] * wrench[0] - feed[1] * wrench[1]) + c.R_BP[i, 1] * (feed[1] * wrench[0] + feed[0] * wrench[1])
        f[i] += c.R_BP[i, 2] * wrench[2]
        m[i] = c.R_BP[i, 0] * (feed[0] * wrench[3] - feed[1] * wrench[4]) + c.R_BP[i, 1] * (feed[1] * wrench[3] + feed[0] * wrench[4])
        m[i] += c.R_BP[i, 2] * wrench[5]
    s.memory[3] = abs(wrench[5])
    share = 1.0 - math.exp(-h / max(c.yielding_time, 1e-6))
    for i in range(3):
        s.memory[4 + i] += share * (-c.yielding[i] * f[i] - s.memory[4 + i])
    return f, m, wrench[5]
