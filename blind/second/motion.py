"""From the planned axes to where motors and links really are: sensor corrections, backlash, gears. SI units."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from robomill.blind.second.arm import A, D, jacobian, links
from robomill.blind.second.kernel import ZERO6, FloatArray, compiled

GEAR = np.array([1798.0 / 7.0, 1872.0 / 7.0, 757.0 / 3.0, 221.0, 5032.0 / 21.0, 206793.0 / 1340.0])
"""FACTS 1.4."""
SINGULAR = 0.05
"""|sin A5| below which the tool may turn a little so that its tip goes where it should (2.5 times the damping of 0.02)."""
DAMPING = 0.02
AXIS_LIMIT = math.radians(5.0)
AT_SPEED = 1e-12
"""Motion in a fine step [rad] that counts as one."""


class Drive(NamedTuple):
    """Drives and gears."""

    p_FT: FloatArray
    omega: float
    damping: float
    half_gap: FloatArray
    """[6] rad, known to the controller."""
    limit: float
    """m, of each component of a correction."""
    backlash: FloatArray = ZERO6
    """[6] rad, half gap that nobody knows of."""
    backlash_spread: float = 0.3
    """The contact closes gradually, between (1 - spread) and (1 + spread) of it."""
    gear_error: FloatArray = ZERO6
    """[6] rad."""
    gear_order: FloatArray = np.ones(6)
    gear_phase: FloatArray = ZERO6
    offset: FloatArray = ZERO6
    """[6] rad."""
    geometry: FloatArray = np.zeros(2)
    """[2] m, excess of link arm and forearm."""
    reversal: FloatArray = ZERO6
    """[6] rad."""
    reversal_time: float = 0.02
    reversal_power: float = 1.0
    coupling: FloatArray = np.zeros((6, 6))
    """[6,6], outside: link i moves with motor j."""
    windup: FloatArray = ZERO6
    """[6] rad (s/rad)^(1/2), outside: behind with the root of the speed."""
    ringing: FloatArray = ZERO6
    """[6] rad, outside: a decaying oscillation after a reversal."""
    ringing_omega: float = 60.0
    ringing_time: float = 0.2
    lag: float = 0.0
    """s, of the planned path, in all; `lag_order` 0 is a dead time."""
    lag_order: int = 1


class DriveState(NamedTuple):
    """What drives and gears remember."""

    correction: FloatArray
    """[2,9] correction (x, q) and its rate."""
    commanded: FloatArray
    sense: FloatArray
    motor: FloatArray
    motor_sense: FloatArray
    reversed_at: FloatArray
    gap: FloatArray
    """[4,6]: motor less link in the known gap and in three elements of the unknown one."""
    start: FloatArray


def standing(q: FloatArray, half_gap: FloatArray) -> DriveState:
    """Drives at rest at the axis angles q [6], which were last moved upwards: the known gap [6] is closed on that side."""
    gap = np.zeros((4, 6))
    gap[0] = half_gap
    return DriveState(np.zeros((2, 9)), q.copy(), np.ones(6), q + half_gap, np.zeros(6), np.full(6, -1e3), gap, q.copy())


@compiled
def joint_correction(q: FloatArray, p_FT: FloatArray, x: FloatArray) -> FloatArray:
    """Axis angles [6] that move the tip by x [3] m; next to the wrist singularity the tool turns rather than the wrist spins."""
    J = jacobian(q, p_FT)
    right = np.zeros(6)
    right[:3] = x
    if abs(math.sin(q[4])) >= SINGULAR:
        straight: FloatArray = np.linalg.solve(J, right).astype(np.float64)
        return straight
    turning = J[3:].copy()
    K = np.zeros((9, 9))
    K[:6, :6] = turning.T.copy() @ turning + DAMPING**2 * np.eye(6)
    K[:6, 6:] = J[:3].T
    K[6:, :6] = J[:3]
    side = np.zeros(9)
    side[6:] = x
    turning_too: FloatArray = np.linalg.solve(K, side)[:6].astype(np.float64)
    return turning_too


@compiled
def pulled(gap: float, moved: float, half: float) -> float:
    """Motor less link after the motor has moved, within a gap of half width `half`."""
    return min(max(gap + moved, -half), half)


@compiled
def behind_gear(c: Drive, s: DriveState, t: float, h: float, q_motor: FloatArray, moved: FloatArray) -> FloatArray:
    """Link angles [6] behind the gears."""
    link = q_motor.copy()
    for i in range(6):
        s.gap[0, i] = pulled(s.gap[0, i], moved[i], c.half_gap[i])
        link[i] -= s.gap[0, i]
        if c.backlash[i] != 0.0:
            for n in range(3):
                s.gap[n + 1, i] = pulled(s.gap[n + 1, i], moved[i], c.backlash[i] * (1.0 + (n - 1) * c.backlash_spread))
                link[i] -= s.gap[n + 1, i] / 3.0
        sense = np.sign(moved[i]) if abs(moved[i]) > AT_SPEED else s.motor_sense[i]
        if sense != s.motor_sense[i]:
            if s.motor_sense[i] != 0.0:
                s.reversed_at[i] = t
            s.motor_sense[i] = sense
        age = t - s.reversed_at[i]
        if c.reversal[i] != 0.0 and age < 20.0 * c.reversal_time:
            x = age / c.reversal_time
            link[i] -= sense * c.reversal[i] * (x * math.exp(1.0 - x)) ** c.reversal_power
        if c.ringing[i] != 0.0:
            link[i] += sense * c.ringing[i] * math.exp(-age / c.ringing_time) * math.sin(c.ringing_omega * age)
        if c.windup[i] != 0.0:
            link[i] -= c.windup[i] * sense * math.sqrt(abs(moved[i]) / h)
        link[i] += c.gear_error[i] * math.sin(c.gear_order[i] * GEAR[i] * q_motor[i] + c.gear_phase[i]) + c.offset[i]
        for j in range(6):
            if c.coupling[i, j] != 0.0:
                link[i] += c.coupling[i, j] * (q_motor[j] - s.start[j])
    return link


@compiled
def driven(
    c: Drive, s: DriveState, t: float, h: float, q_plan: FloatArray, wanted: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One fine step to t: angles of motors and links [6], and the commanded ones without the jumps of the backlash compensation.

    `wanted` [9] is the correction that has arrived: m along B, and rad of the axes.
    """
    for i in range(9):
        bound = c.limit if i < 3 else AXIS_LIMIT
        u = min(max(wanted[i], -bound), bound)
        # half a step with the old rate, half with the new one: second order in h
        force = c.omega**2 * (u - s.correction[0, i]) - 2.0 * c.damping * c.omega * s.correction[1, i]
        middle = s.correction[1, i] + 0.5 * h * force
        s.correction[0, i] += h * middle
        force = c.omega**2 * (u - s.correction[0, i]) - 2.0 * c.damping * c.omega * middle
        s.correction[1, i] = middle + 0.5 * h * force
    planned = q_plan + joint_correction(q_plan, c.p_FT, s.correction[0, :3].copy())
    q = planned + s.correction[0, 3:]
    q_motor = np.zeros(6)
    for i in range(6):
        moved = planned[i] - s.commanded[i]
        if abs(moved) > AT_SPEED:
            s.sense[i] = np.sign(moved)
        s.commanded[i] = planned[i]
        q_motor[i] = q[i] + c.half_gap[i] * s.sense[i]
    moved_motor = q_motor - s.motor
    s.motor[:] = q_motor
    return q_motor, behind_gear(c, s, t, h, q_motor, moved_motor), q


@compiled
def longer(q: FloatArray, p_FT: FloatArray, geometry: FloatArray) -> FloatArray:
    """Displacement [m] of the tip by a link arm and a forearm that are longer than they should be."""
    a, d = A.copy(), D.copy()
    a[2] += geometry[0]
    d[3] += geometry[1]
    right, nominal = links(q, a, d), links(q, A, D)
    further: FloatArray = right[1][5] - nominal[1][5]
    return further


def followed(c: Drive, q: FloatArray, h: float) -> FloatArray:
    """Planned axes [n,6] as late as the drives follow them: a dead time, or equal first-order lags one behind the other."""
    if c.lag == 0.0:
        return q
    if c.lag_order == 0:
        t = h * np.arange(len(q))
        return np.stack([np.interp(t - c.lag, t, q[:, i]) for i in range(6)], axis=1)
    decay = math.exp(-h * c.lag_order / c.lag)
    late = q - q[0]
    for _ in range(c.lag_order):
        late = lfilter([1.0 - decay], [1.0, -decay], late, axis=0)
    found: FloatArray = late + q[0]
    return found
