"""What the force-torque sensor shows, and the force at the tool that the signal processing makes of it. SI units, cycle 4 ms."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robomill.blind.second.arm import cross, rotation, tip
from robomill.blind.second.flexure import GRAVITY
from robomill.blind.second.kernel import ZERO3, FloatArray, compiled

CYCLE = 0.004
WINDOW = 15
HISTORY = 64
"""Samples that a lag can reach back to."""
SENSOR = np.array([0.0, 0.0, 0.028])


class Sensor(NamedTuple):
    """Sensor, load, hoses and what the compensation believes of them; `model_*` are the beliefs."""

    p_FT: FloatArray
    span: FloatArray
    """[6] measuring range."""
    resolution: FloatArray
    offset: FloatArray
    model_offset: FloatArray
    mass: float
    cog: FloatArray
    model_mass: float
    model_cog: FloatArray
    hose: FloatArray
    """[45] N, Eq. (17) of the paper, by term and then component."""
    hose_point: FloatArray
    cutoff: float
    """Hz."""
    damping: float = math.sqrt(0.5)
    """Damping of the low-pass; Butterworth has sqrt(1/2)."""
    gain: FloatArray = np.eye(6)
    """[6,6] what the channels show of the wrench, 1 without effects."""
    turned: FloatArray = ZERO3
    """[3] rad."""
    zero: FloatArray = ZERO3
    zero_share: float = 0.0
    zero_time: float = 600.0
    lag: float = 0.0
    """s, in all; of the order that `lag_order` says (0: dead time)."""
    lag_order: int = 0
    extra_mass: float = 0.0
    extra_cog: FloatArray = ZERO3
    inertia: float = 0.0
    inertia_filter: float = 1.0
    hose_force: float = 0.0
    hose_anchor: FloatArray = ZERO3
    hose_rate: float = 0.0
    """1/m, growth of the pull with the way to the anchor."""
    clip: float = 0.0
    warming: float = 0.0
    warming_time: float = 3.0
    bow: float = 0.0
    """1/kN, outside: the reading falls short of large forces."""
    play: float = 0.0
    """N, outside: mechanical hysteresis of the sensor."""


class SensorState(NamedTuple):
    """Filters and history of the sensor."""

    raw: FloatArray
    """[HISTORY,6] wrench felt, newest last."""
    lagged: FloatArray
    """[2,6]."""
    low: FloatArray
    """[4,6]: last two inputs and outputs of the low-pass."""
    window: FloatArray
    place: FloatArray
    """[3,3] last places of the centre of gravity, newest last."""
    stuck: FloatArray
    """[6] where the play of the sensor stands; first sample, acceleration [3]."""
    first: FloatArray


def unread() -> SensorState:
    """A sensor before its first sample."""
    return SensorState(
        np.zeros((HISTORY, 6)), np.zeros((2, 6)), np.zeros((4, 6)), np.zeros((WINDOW, 6)), np.zeros((3, 3)), np.zeros(6), np.ones(4)
    )


@compiled
def hose_pull(coefficients: FloatArray, R: FloatArray) -> FloatArray:
    """Force of the hoses in S [3] N: Eq. (17), a quadratic form in the quaternion of the sensor in B, scalar part first and positive."""
    w = 0.5 * math.sqrt(max(1.0 + R[0, 0] + R[1, 1] + R[2, 2], 0.0))
    x = math.copysign(0.5 * math.sqrt(max(1.0 + R[0, 0] - R[1, 1] - R[2, 2], 0.0)), R[2, 1] - R[1, 2])
    y = math.copysign(0.5 * math.sqrt(max(1.0 - R[0, 0] + R[1, 1] - R[2, 2], 0.0)), R[0, 2] - R[2, 0])
    z = math.copysign(0.5 * math.sqrt(max(1.0 - R[0, 0] - R[1, 1] + R[2, 2], 0.0)), R[1, 0] - R[0, 1])
    terms = np.array([1.0, w, x, y, z, w * w, x * x, y * y, z * z, w * x, w * y, w * z, x * y, x * z, y * z])
    out = np.zeros(3)
    for i in range(3):
        for k in range(15):
            out[i] += coefficients[3 * k + i] * terms[k]
    return out


@compiled
def felt(c: Sensor, s: SensorState, q: FloatArray, f_B: FloatArray, m_B: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Force and moment [6] that act on the sensor, in its axes, and the rotation of the flange in B [3,3]."""
    p_T, R = tip(q, c.p_FT)
    p_S = p_T + R @ (SENSOR - c.p_FT)
    down = np.array([0.0, 0.0, -GRAVITY])
    centre = p_S + R @ c.cog
    if s.first[0] != 0.0:  # it has stood there before
        s.place[1], s.place[2], s.first[1:] = centre, centre, 0.0
    s.place[0], s.place[1], s.place[2] = s.place[1].copy(), s.place[2].copy(), centre
    if s.first[0] == 0.0:
        now = (s.place[2] - 2.0 * s.place[1] + s.place[0]) / CYCLE**2
        s.first[1:] += c.inertia_filter * (now - s.first[1:])
    force = f_B + c.mass * down - c.inertia * c.mass * s.first[1:]
    lever = R @ c.cog
    moment = m_B + cross(R @ (c.p_FT - SENSOR), f_B) + cross(lever, c.mass * down - c.inertia * c.mass * s.first[1:])
    if c.extra_mass != 0.0:
        force = force + c.extra_mass * down
        moment = moment + cross(R @ c.extra_cog, c.extra_mass * down)
    hose = hose_pull(c.hose, R)
    force = R.T.copy() @ force + hose
    moment = R.T.copy() @ moment + cross(c.hose_point, hose)
    if c.hose_force != 0.0:
        way = R.T.copy() @ (c.hose_anchor - p_S) - c.hose_point
        length = math.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
        pull = c.hose_force * (1.0 + c.hose_rate * (length - 1.5)) * way / length
        force = force + pull
        moment = moment + cross(c.hose_point, pull)
    out = np.zeros(6)
    out[:3], out[3:] = force, moment
    return out, R


@compiled
def shown(c: Sensor, s: SensorState, t: float, felt_now: FloatArray, noise: FloatArray) -> FloatArray:
    """Reading [6] of the sensor for what acts on it."""
    T = rotation(-c.turned)
    w = np.zeros(6)
    w[:3], w[3:] = T @ felt_now[:3], T @ felt_now[3:]
    w = c.gain @ w
    w = w * (1.0 + c.warming * (1.0 - math.exp(-t / max(c.warming_time, 1e-3))))
    size = math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    w = w / (1.0 + c.bow * 1e-3 * size)
    if c.play > 0.0:
        for i in range(3):
            s.stuck[i] = min(max(s.stuck[i], w[i] - c.play), w[i] + c.play) if s.first[0] == 0.0 else w[i]
            w[i] = s.stuck[i]
    if s.first[0] != 0.0:
        for k in range(HISTORY):
            s.raw[k] = w
        s.lagged[0], s.lagged[1] = w, w
    for k in range(HISTORY - 1):
        s.raw[k] = s.raw[k + 1]
    s.raw[HISTORY - 1] = w
    out = w.copy()
    if c.lag > 0.0 and c.lag_order == 0:
        back = c.lag / CYCLE
        whole = int(back)
        part = back - whole
        out = (1.0 - part) * s.raw[HISTORY - 1 - whole] + part * s.raw[HISTORY - 2 - whole]
    elif c.lag > 0.0:
        share = 1.0 - math.exp(-CYCLE * c.lag_order / c.lag)
        s.lagged[0] += share * (w - s.lagged[0])
        s.lagged[1] += share * (s.lagged[0] - s.lagged[1])
        out = s.lagged[c.lag_order - 1].copy()
    moved = 1.0 - c.zero_share * math.exp(-t / c.zero_time)
    for i in range(6):
        bound = c.span[i] * (1.0 - c.clip)
        value = out[i] + c.offset[i] + noise[i] + (c.zero[i] * moved if i < 3 else 0.0)
        out[i] = min(max(round(value / c.resolution[i]) * c.resolution[i], -bound), bound)
    return out


@compiled
def cleaned(c: Sensor, s: SensorState, raw: FloatArray, R: FloatArray) -> FloatArray:
    """Force and moment [6] at the tip of the tool, in its axes: weight, zero and hoses taken away, low-pass, moving mean."""
    down = np.array([0.0, 0.0, -GRAVITY * c.model_mass])
    weight = R.T.copy() @ down
    hose = hose_pull(c.hose, R)
    x = raw - c.model_offset
    x[:3] -= weight + hose
    x[3:] -= cross(c.model_cog, weight) + cross(c.hose_point, hose)
    if s.first[0] != 0.0:
        for k in range(4):
            s.low[k] = x
        for k in range(WINDOW):
            s.window[k] = x
        s.first[0] = 0.0
    # bilinear transform of w^2/(s^2 + 2 d w s + w^2), pre-warped at the cut-off
    w = math.tan(math.pi * c.cutoff * CYCLE)
    a0 = 1.0 + 2.0 * c.damping * w + w * w
    y = (w * w * (x + 2.0 * s.low[0] + s.low[1]) - 2.0 * (w * w - 1.0) * s.low[2] - (1.0 - 2.0 * c.damping * w + w * w) * s.low[3]) / a0
    s.low[1], s.low[0] = s.low[0].copy(), x
    s.low[3], s.low[2] = s.low[2].copy(), y
    for k in range(WINDOW - 1):
        s.window[k] = s.window[k + 1]
    s.window[WINDOW - 1] = y
    out = np.zeros(6)
    for k in range(WINDOW):
        out += s.window[k] / WINDOW
    out[3:] -= cross(c.p_FT - SENSOR, out[:3].copy())
    return out
