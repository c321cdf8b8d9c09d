"""Motor torque of a motion: Newton's and Euler's equations of every body, projected on the axes (Kane). SI units, axis sense A1..A6."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robomill.blind.second.arm import SIGN, A, D, cross, links
from robomill.blind.second.flexure import GRAVITY, gas_spring
from robomill.blind.second.kernel import ZERO6, FloatArray, compiled
from robomill.blind.second.motion import GEAR


class Dynamics(NamedTuple):
    """Masses, rotors, gas spring, and the friction that the nominal robot does not have."""

    p_FT: FloatArray
    mass: FloatArray
    """[6] kg."""
    com: FloatArray
    """[6,3] m in the link frames."""
    inertia: FloatArray
    """[6,6] kg m2 about the centre of gravity: xx, yy, zz, xy, yz, xz."""
    rotor: FloatArray
    gas: float
    """Relative to FACTS 1.4."""
    payload: float
    payload_com: FloatArray
    payload_inertia: FloatArray
    viscous: FloatArray = ZERO6
    coulomb: FloatArray = ZERO6
    stribeck: FloatArray = ZERO6
    presliding: float = 30e-6
    """rad over which friction builds up after a reversal."""
    stribeck_speed: float = 0.02
    stribeck_power: float = 1.5
    cogging: FloatArray = ZERO6
    """[6] N m at the motor, outside: torque periodic in the rotor angle."""
    cogging_order: float = 8.0
    cogging_phase: float = 0.0
    load_friction: FloatArray = ZERO6
    """[6] 1, outside: friction that grows with the torque of the gear."""


@compiled
def friction(c: Dynamics, i: int, bristle: float, dq: float, h: float) -> tuple[float, float]:
    """New bristle (-1..1) and friction [N m] of axis i after a step dq [rad] in h: LuGre with the bristle solved exactly."""
    if dq != 0.0:
        s = 1.0 if dq > 0.0 else -1.0
        bristle = s + (bristle - s) * math.exp(-abs(dq) / c.presliding)
    v = abs(dq) / h
    level = c.coulomb[i] + c.stribeck[i] * math.exp(-((v / c.stribeck_speed) ** c.stribeck_power))
    return bristle, level * bristle + c.viscous[i] * dq / h


@compiled
def rigid(c: Dynamics, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
    """Torques [6] N m at the axes of bodies and payload, without rotors, gas spring and friction."""
    R, o = links(q, A, D)
    torque, omega, alpha = np.zeros(6), np.zeros(3), np.zeros(3)
    acceleration, last = np.array([0.0, 0.0, GRAVITY]), np.zeros(3)
    axes = np.zeros((6, 3))
    for i in range(6):
        way = o[i] - last
        acceleration = acceleration + cross(alpha, way) + cross(omega, cross(omega, way))
        last = o[i].copy()
        axes[i] = SIGN[i] * R[i, :, 2]
        alpha = alpha + axes[i] * qdd[i] + cross(omega, axes[i] * qd[i])
        omega = omega + axes[i] * qd[i]
        for body in range(2 if i == 5 else 1):
            n = c.inertia[i] if body == 0 else c.payload_inertia
            mass = c.mass[i] if body == 0 else c.payload
            com = c.com[i].copy() if body == 0 else c.payload_com
            turn = R[i].copy()
            tensor = turn @ np.array([[n[0], n[3], n[5]], [n[3], n[1], n[4]], [n[5], n[4], n[2]]]) @ turn.T.copy()
            arm = turn @ com
            force = mass * (acceleration + cross(alpha, arm) + cross(omega, cross(omega, arm)))
            moment = tensor @ alpha + cross(omega, tensor @ omega)
            for j in range(i + 1):
                load = cross(o[i] + arm - o[j], force) + moment
                torque[j] += axes[j, 0] * load[0] + axes[j, 1] * load[1] + axes[j, 2] * load[2]
    return torque


@compiled
def torques(c: Dynamics, q: FloatArray, q_motor: FloatArray, wrench: FloatArray, h: float) -> FloatArray:
    """Torque at the motor shafts [n,6] of sampled commanded axes q [n,6] under the wrench [n,6] on the tool, differences over h [s]."""
    n = len(q)
    out = np.zeros((n, 6))
    bristle = np.zeros(6)
    for k in range(n):
        a, b = max(k - 1, 0), max(k - 2, 0)
        qd = (q[k] - q[a]) / h
        qdd = (q[k] - 2.0 * q[a] + q[b]) / h**2
        gear = rigid(c, q[k], qd, qdd)
        gear[1] += c.gas * gas_spring(q[k, 1])
        R, o = links(q[k], A, D)
        at = o[5] + R[5].copy() @ c.p_FT
        f, m = wrench[k, :3].copy(), wrench[k, 3:].copy()
        for i in range(6):
            load = cross(at - o[i], f) + m
            gear[i] -= SIGN[i] * (R[i, 0, 2] * load[0] + R[i, 1, 2] * load[1] + R[i, 2, 2] * load[2])
            bristle[i], rub = friction(c, i, bristle[i], q[k, i] - q[a, i], h)
            rub += c.load_friction[i] * abs(gear[i]) * bristle[i]
            out[k, i] = (gear[i] + rub) / GEAR[i] + c.rotor[i] * GEAR[i] * qdd[i]
            out[k, i] += c.cogging[i] * math.sin(c.cogging_order * GEAR[i] * q_motor[k, i] + c.cogging_phase)
    return out
