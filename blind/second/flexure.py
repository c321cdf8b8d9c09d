"""How the loaded arm yields: linear springs in the link frames, and what may be wrong with them.

SI units; torques of a drive in the sense of A1..A6. A zero switches an effect off; the other numbers are hidden constants.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robomill.blind.second.arm import ARM_STATIONS, DRIVES, SIGN, cross, stations
from robomill.blind.second.kernel import ZERO3, ZERO6, FloatArray, compiled

GRAVITY = 9.81
HOLDER = np.array([0.0, 0.0, 0.100])
"""From the flange to the spring of the holder [m]."""


class Flexure(NamedTuple):
    """The yielding arm."""

    p_FT: FloatArray
    stiffness: FloatArray
    """[10,3] N m/rad, about x, y, z of each station."""
    reference: FloatArray
    """[6] torque [N m] at which hardening has its nominal size."""
    error: FloatArray = ZERO6
    hardening: FloatArray = ZERO6
    hardening_power: float = 1.0
    asymmetry: FloatArray = ZERO6
    asymmetry_torque: float = 0.04
    """Share of `reference` over which one side of an asymmetric spring goes over into the other."""
    hysteresis: FloatArray = ZERO6
    """[6] rad."""
    hysteresis_torque: FloatArray = np.ones(6)
    hysteresis_power: float = 2.0
    friction: FloatArray = ZERO6
    """[6] N m, beside the spring (Dahl)."""
    friction_stiffness: float = 0.56
    tilt: FloatArray = ZERO6
    """[6] rad/(N m)."""
    tilt_skew: float = 0.0
    """Relative difference of the tilt about x and about y."""
    base: FloatArray = ZERO3
    """[3] m/N."""
    base_time: float = 0.01
    tool: float = 0.0
    """m/N."""
    payload: float = 0.0
    """kg."""
    payload_at: FloatArray = ZERO3
    """[3] m in F."""
    counterbalance: float = 0.0
    gas_power: float = 1.2
    """Polytropic exponent with which the error of the gas spring follows the angle."""
    growth: float = 0.0
    """m."""
    growth_share: float = 0.5
    growth_times: FloatArray = np.array([3600.0, 7200.0])
    """[2] s, of the arm and of the base."""
    warm_up: float = 0.0
    mode: float = 0.0
    """m/N."""
    mode_omega: float = 57.0
    mode_damping: float = 0.02
    mode_direction: FloatArray = np.array([0.0, 1.0, 0.0])
    lobed: FloatArray = ZERO6
    """[6] rad/(N m), outside of the catalogue: compliance periodic in the angle."""
    lobes: float = 200.0
    lobe_phase: float = 0.0
    creep: FloatArray = ZERO6
    """[6] rad/(N m), outside: deflection that grows on, with two time constants."""
    creep_times: FloatArray = np.array([0.3, 2.0])
    floor: float = 0.0
    """m, outside: the floor shakes."""
    floor_omega: float = 30.0
    floor_phase: float = 0.0
    floor_direction: FloatArray = np.array([0.0, 1.0, 0.0])
    stiction: FloatArray = ZERO6
    """[6] N m, outside: the joint gives way only beyond this torque."""


class FlexureState(NamedTuple):
    """What an arm remembers."""

    lag: FloatArray
    """[6] N m: torque less the play of the hysteresis."""
    torque: FloatArray
    twist: FloatArray
    """[6] rad, and [6] N m of friction beside the spring."""
    held: FloatArray
    base: FloatArray
    mode: FloatArray
    creep: FloatArray
    """[2,6]."""


def at_rest() -> FlexureState:
    """An arm that was never loaded."""
    return FlexureState(np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(3), np.zeros(2), np.zeros((2, 6)))


@compiled
def gas_spring(A2: float) -> float:
    """Torque [N m] of the counterbalance on axis 2 (FACTS 1.4: cylinder with nitrogen, isothermal)."""
    frame, lever, angle = 0.8, 0.2, A2 + math.radians(95.0)
    length = math.sqrt(frame**2 + lever**2 - 2.0 * frame * lever * math.cos(angle))
    area = 0.25 * math.pi * (0.055**2 - 0.030**2)
    pressure = 1.01 * 296.8 * 328.0 * 0.159 / (0.00096 - (length - (frame - lever)) * area)
    return frame * lever * math.sin(angle) / length * pressure * area


@compiled
def hysteresis(c: Flexure, s: FlexureState, i: int, M: float) -> float:
    """Smooth play in the torque (a Bouc-Wen rule with drawn power): lost motion [rad] of joint i, `hysteresis` at zero torque."""
    reach = c.hysteresis_torque[i]
    parts = 4
    dM = (M - s.torque[i]) / parts
    for _ in range(parts):
        e = s.lag[i] / reach
        if dM * e > 0.0:
            s.lag[i] += dM * (1.0 - min(abs(e), 1.0) ** c.hysteresis_power)
        else:
            s.lag[i] += dM
        s.lag[i] = min(max(s.lag[i], -reach), reach)
    x = (M - s.lag[i]) / reach
    lost: float = c.hysteresis[i] * 2.0 ** (1.0 / 6.0) * x / (1.0 + abs(x) ** 6) ** (1.0 / 6.0)
    return lost


@compiled
def dahl(c: Flexure, s: FlexureState, i: int, M: float, k: float) -> float:
    """Twist [rad] of a spring k with Dahl friction beside it: M = k twist + F, dF = sigma (1 - sgn F/F_max) dtwist."""
    limit, sigma = c.friction[i], c.friction_stiffness * k
    x0, F0 = float(s.twist[i]), float(s.held[i])
    rest = M - k * x0 - F0
    way = 1.0 if rest >= 0.0 else -1.0
    x, F = x0 + rest / (k + sigma), F0
    for _ in range(12):
        decay = math.exp(-abs(x - x0) * sigma / limit)
        F = way * limit + (F0 - way * limit) * decay
        slope = k + sigma * (1.0 - way * F0 / limit) * decay
        x -= (k * x + F - M) / slope
        if (x - x0) * way < 0.0:
            x = x0
    decay = math.exp(-abs(x - x0) * sigma / limit)
    s.twist[i], s.held[i] = x, way * limit + (F0 - way * limit) * decay
    return x


@compiled
def drive_twist(c: Flexure, s: FlexureState, i: int, M: float, q: float, h: float) -> float:
    """Twist [rad] of the drive i under torque M [N m], both in the sense of the axis."""
    k = c.stiffness[DRIVES[i], 2] * (1.0 + c.error[i])
    if c.hardening[i] != 0.0:
        k *= 1.0 + c.hardening[i] * (abs(M) / c.reference[i]) ** c.hardening_power
    if c.asymmetry[i] != 0.0:
        k *= 1.0 + c.asymmetry[i] * math.tanh(M / (c.asymmetry_torque * c.reference[i]))
    load = M
    if c.stiction[i] != 0.0:
        load = math.copysign(max(abs(M) - c.stiction[i], 0.0), M)
    x: float = load / k
    if c.friction[i] > 0.0:
        x = dahl(c, s, i, load, k)
    if c.hysteresis[i] != 0.0:
        x += hysteresis(c, s, i, M)
    if c.lobed[i] != 0.0:
        x += c.lobed[i] * M * math.sin(c.lobes * q + c.lobe_phase)
    if c.creep[i] != 0.0:
        for n in range(2):
            s.creep[n, i] += (1.0 - math.exp(-h / c.creep_times[n])) * (0.5 * c.creep[i] * M - s.creep[n, i])
            x += s.creep[n, i]
    s.torque[i] = M
    return x


@compiled
def beyond_springs(c: Flexure, s: FlexureState, t: float, h: float, f: FloatArray, axis: FloatArray, p: FloatArray) -> FloatArray:
    """Displacement [m] by base, tool, heat, a missing mode and the floor."""
    d = np.zeros(3)
    share = 1.0 - math.exp(-h / max(c.base_time, 1e-6))
    for i in range(3):
        s.base[i] += share * (c.base[i] * f[i] - s.base[i])
        d[i] += s.base[i]
    along = f[0] * axis[0] + f[1] * axis[1] + f[2] * axis[2]
    d += c.tool * (f - along * axis)
    if c.growth != 0.0:
        age = t + c.warm_up
        grown = 1.0 - c.growth_share * math.exp(-age / c.growth_times[0]) - (1.0 - c.growth_share) * math.exp(-age / c.growth_times[1])
        d += c.growth * grown * p / math.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
    if c.mode != 0.0:
        n, w = c.mode_direction, c.mode_omega
        pull = n[0] * f[0] + n[1] * f[1] + n[2] * f[2]
        s.mode[1] += h * (w * w * (c.mode * pull - s.mode[0]) - 2.0 * c.mode_damping * w * s.mode[1])
        s.mode[0] += h * s.mode[1]
        d += s.mode[0] * n
    if c.floor != 0.0:
        d += c.floor * math.sin(c.floor_omega * t + c.floor_phase) * c.floor_direction
    return d


@compiled
def yielding(
    c: Flexure, s: FlexureState, t: float, h: float, q: FloatArray, f: FloatArray, m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement [m] and turn [rad] of the tool under force [N] and moment [N m] at its tip, and the torques of the drives [6]."""
    R, p = stations(q)
    RF = R[9].copy()
    at = p[9] + RF @ (c.p_FT - HOLDER)
    flange = p[9] - RF @ HOLDER
    weight = np.array([0.0, 0.0, -c.payload * GRAVITY])
    hung = flange + RF @ c.payload_at
    d, theta, torques = np.zeros(3), np.zeros(3), np.zeros(6)
    drive = 0
    for i in range(10):
        r = at - p[i]
        M_B = cross(r, f) + m
        if i <= ARM_STATIONS and c.payload != 0.0:
            M_B = M_B + cross(hung - p[i], weight)
        M = R[i].T.copy() @ M_B
        x = M / c.stiffness[i]
        if drive < 6 and i == DRIVES[drive]:
            j = drive
            torque = SIGN[j] * M[2]
            torques[j] = torque
            if j == 1 and c.counterbalance != 0.0:
                least = gas_spring(math.radians(-100.0))
                now = gas_spring(q[1])
                torque -= c.counterbalance * now * (abs(now / least)) ** (0.1 * (c.gas_power - 1.0))
            x[2] = SIGN[j] * drive_twist(c, s, j, torque, q[j], h)
            x[0] += c.tilt[j] * (1.0 + c.tilt_skew) * M[0]
            x[1] += c.tilt[j] * (1.0 - c.tilt_skew) * M[1]
            drive += 1
        turn = R[i].copy() @ x
        theta += turn
        d += cross(turn, r)
    d += beyond_springs(c, s, t, h, f, RF[:, 0].copy(), at)
    return d, theta, torques
