"""The controller as paper 000 states it: force -> deflection of the table -> correction normal to the feed. SI units, cycle 4 ms."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robomill.blind.second.arm import DRIVES, deflection, rotation, tip
from robomill.blind.second.kernel import ZERO3, ZERO6, FloatArray, compiled
from robomill.blind.second.sensing import CYCLE

QUEUE = 64
"""Cycles that a correction can be late."""
LEAST_FEED = 1e-3
"""m/s below which the last direction of the feed holds."""


class Control(NamedTuple):
    """Controller and the way of its corrections."""

    mode: int
    """0: nothing is sent, 1: along B. Corrections of axes are not sent in this cell."""
    p_FT: FloatArray
    stiffness: FloatArray
    """[10,3] what the controller believes."""
    limit: float
    """m, of each component."""
    table_error: FloatArray = ZERO6
    late: float = 0.0
    late_order: int = 0
    """0: dead time; 1 or 2: lag of that order with the same delay in all."""
    dead: float = 0.0
    """N; `knee` N wide is the way from nothing to everything."""
    knee: float = 1.0
    frame: FloatArray = ZERO3
    """[3] rad."""
    lost: float = 0.0
    """Probability that a correction is lost; bursts last `burst` cycles in the mean."""
    burst: float = 2.0
    greed: float = 0.0
    """1/m, outside: what is sent grows with its own square."""


class ControlState(NamedTuple):
    """What the controller remembers: direction of the feed [3] and whether there was one, queue of corrections, lags, last one sent."""

    feed: FloatArray
    queue: FloatArray
    lagged: FloatArray
    sent: FloatArray
    lost: FloatArray


def waiting() -> ControlState:
    """A controller before its first cycle."""
    return ControlState(np.zeros(4), np.zeros((QUEUE, 3)), np.zeros((2, 3)), np.zeros(3), np.zeros(1))


@compiled
def alive(c: Control, f: FloatArray, m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Force and moment behind the dead zone, whose edge is a soft one."""
    size = math.sqrt(f[0] ** 2 + f[1] ** 2 + f[2] ** 2)
    if c.dead == 0.0 or size == 0.0:
        return f, m
    x = (size - c.dead) / c.knee
    left = c.knee * (x + math.log1p(math.exp(-x)) if x > 0.0 else math.log1p(math.exp(x)))
    share = min(max(left - c.knee * math.log1p(math.exp(-c.dead / c.knee)), 0.0) / size, 1.0)
    return f * share, m * share


@compiled
def control(c: Control, s: ControlState, q: FloatArray, wrench: FloatArray, v: FloatArray, chance: FloatArray) -> FloatArray:
    """Correction [3] m in B that is sent in this cycle; `wrench` [6] in T, `v` commanded velocity in B, `chance` [2] uniform numbers."""
    _, R = tip(q, c.p_FT)
    f, m = alive(c, R @ wrench[:3], R @ wrench[3:])
    believed = c.stiffness.copy()
    for i in range(6):
        believed[DRIVES[i]] *= 1.0 + c.table_error[i]
    d, _ = deflection(q, c.p_FT, believed, f, m)
    speed = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    if speed >= LEAST_FEED:
        s.feed[:3] = v / speed
        s.feed[3] = 1.0
    r = -d
    r = r - s.feed[3] * (r[0] * s.feed[0] + r[1] * s.feed[1] + r[2] * s.feed[2]) * s.feed[:3]
    r = r * (1.0 + c.greed * math.sqrt(r[0] ** 2 + r[1] ** 2 + r[2] ** 2))
    for i in range(3):
        r[i] = min(max(r[i], -c.limit), c.limit)
    if c.mode == 0:
        r = np.zeros(3)
    for k in range(QUEUE - 1):
        s.queue[k] = s.queue[k + 1]
    s.queue[QUEUE - 1] = rotation(c.frame) @ r
    out = s.queue[QUEUE - 1].copy()
    if c.late > 0.0 and c.late_order == 0:
        back = c.late / CYCLE
        whole = int(back)
        part = back - whole
        out = (1.0 - part) * s.queue[QUEUE - 1 - whole] + part * s.queue[QUEUE - 2 - whole]
    elif c.late > 0.0:
        share = 1.0 - math.exp(-CYCLE * c.late_order / c.late)
        s.lagged[0] += share * (out - s.lagged[0])
        s.lagged[1] += share * (s.lagged[0] - s.lagged[1])
        out = s.lagged[c.late_order - 1].copy()
    if c.lost > 0.0:
        # two states (good, bad); stays bad with 1 - 1/burst, and is bad with probability `lost` in the long run
        if s.lost[0] > 0.0:
            s.lost[0] = 0.0 if chance[0] < 1.0 / c.burst else 1.0
        else:
            s.lost[0] = 1.0 if chance[1] < c.lost / (c.burst * (1.0 - c.lost)) else 0.0
        if s.lost[0] > 0.0:
            out = s.sent.copy()
    s.sent[:] = out
    sent: FloatArray = out
    return sent
