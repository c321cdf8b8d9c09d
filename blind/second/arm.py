"""The arm: kinematics from the modified DH table of the data sheets, compliance as springs in the frames of the links.

Sources: FACTS 1.2 and 1.6 (kinematics), Table 1 and Eq. (1) of Haehn & Weigold 2020 (frames and springs). Lengths in m, angles in rad,
forces act on the tool. Every spring is a tensor in base axes: the tool goes by (C_i (r_i x F + M)) x r_i, summed over the stations.
"""

from __future__ import annotations

import math

import numpy as np

from robomill.blind.second.kernel import FloatArray, compiled

SIGN = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
"""Sense of the axis angles against the DH axes."""
ALPHA = np.radians([0.0, -90.0, 0.0, -90.0, 90.0, -90.0])
A = np.array([0.0, 0.350, 1.150, -0.041, 0.0, 0.0])
D = np.array([0.675, 0.0, 0.0, 1.0, 0.0, 0.240])
OFFSET = np.radians([0.0, 0.0, -90.0, 0.0, 0.0, 180.0])
FLANGE = 0.240
"""From the wrist centre to the flange [m]."""
ARM_STATIONS = 8
"""Stations in front of the flange; the last two (sensor, holder) belong to the end effector."""
DRIVES = np.array([0, 1, 3, 5, 6, 7])
"""Stations whose z axis is that of a drive; stations 2 and 4 are the link arm and the forearm at mid length."""


@compiled
def turn_x(R: FloatArray, angle: float) -> FloatArray:
    """R Rx(angle)."""
    c, s = math.cos(angle), math.sin(angle)
    out = R.copy()
    for i in range(3):
        out[i, 1] = R[i, 1] * c + R[i, 2] * s
        out[i, 2] = R[i, 2] * c - R[i, 1] * s
    return out


@compiled
def turn_z(R: FloatArray, angle: float) -> FloatArray:
    """R Rz(angle)."""
    c, s = math.cos(angle), math.sin(angle)
    out = R.copy()
    for i in range(3):
        out[i, 0] = R[i, 0] * c + R[i, 1] * s
        out[i, 1] = R[i, 1] * c - R[i, 0] * s
    return out


@compiled
def rotation(v: FloatArray) -> FloatArray:
    """Matrix of a rotation vector [rad] (Rodrigues)."""
    angle = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    out = np.eye(3)
    if angle < 1e-15:
        return out
    x, y, z = v[0] / angle, v[1] / angle, v[2] / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: FloatArray = out + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)
    return turned


@compiled
def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product of two vectors [3]."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@compiled
def links(q: FloatArray, a: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotations [6,3,3] and origins [6,3] of the six link frames in B, axis angles q [6]; `a`, `d` [6] the lengths of the links."""
    R, p = np.eye(3), np.zeros(3)
    rotations, origins = np.zeros((6, 3, 3)), np.zeros((6, 3))
    for i in range(6):
        R = turn_x(R, ALPHA[i])
        # R is rebuilt by columns: its x axis carries a, its z axis d
        p = p + R[:, 0].copy() * a[i] + R[:, 2].copy() * d[i]
        R = turn_z(R, SIGN[i] * q[i] + OFFSET[i])
        rotations[i], origins[i] = R, p
    return rotations, origins


@compiled
def tip(q: FloatArray, p_FT: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Position [3] and rotation [3,3] of the tool; its axes are those of the flange."""
    rotations, origins = links(q, A, D)
    R = rotations[5].copy()
    return origins[5] + R @ p_FT, R


@compiled
def jacobian(q: FloatArray, p_FT: FloatArray) -> FloatArray:
    """Geometric Jacobian of the tool tip in B, [6,6]: linear above angular, columns in the sense of A1..A6."""
    rotations, origins = links(q, A, D)
    p = origins[5] + rotations[5].copy() @ p_FT
    J = np.zeros((6, 6))
    for i in range(6):
        axis = SIGN[i] * rotations[i, :, 2].copy()
        J[:3, i] = cross(axis, p - origins[i])
        J[3:, i] = axis
    return J


@compiled
def near(angle: float, to: float) -> float:
    """The angle plus whole turns that lies nearest to another."""
    return angle - 2.0 * math.pi * round((angle - to) / (2.0 * math.pi))


@compiled
def inverse(p: FloatArray, R: FloatArray, p_FT: FloatArray, last: FloatArray) -> FloatArray:
    """Axis angles [6] of a tool pose, robot in front, elbow up, wrist as near to `last` as it can be; NaN where out of reach."""
    W = p - R @ p_FT - FLANGE * R[:, 2].copy()
    q = np.zeros(6)
    q[0] = near(-math.atan2(W[1], W[0]), last[0])
    r, h = math.hypot(W[0], W[1]) - A[1], W[2] - D[0]
    forearm, bend = math.hypot(D[3], A[3]), math.atan2(-A[3], D[3])
    cosine = (r * r + h * h - A[2] ** 2 - forearm**2) / (2.0 * A[2] * forearm)
    kink = math.acos(cosine) if abs(cosine) <= 1.0 else math.nan
    q[1] = -math.atan2(h, r) - math.atan2(forearm * math.sin(kink), A[2] + forearm * math.cos(kink))
    q[2] = kink - bend
    rotations, _ = links(q, A, D)
    w = rotations[2].T.copy() @ R
    s5 = math.hypot(w[1, 0], w[1, 1])
    if s5 < 1e-9:
        q[3], q[4], q[5] = last[3], 0.0, last[5]
        return q
    best = 1e9
    for sign in (1.0, -1.0):
        a4 = near(-math.atan2(sign * w[2, 2], -sign * w[0, 2]), last[3])
        a5 = sign * math.atan2(s5, w[1, 2])
        a6 = near(math.pi - math.atan2(-sign * w[1, 1], sign * w[1, 0]), last[5])
        way = abs(a4 - last[3]) + abs(a5 - last[4]) + abs(a6 - last[5])
        if way < best:
            best = way
            q[3], q[4], q[5] = a4, a5, a6
    return q


@compiled
def stations(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotations [10,3,3] and origins [10,3] of the ten places where something turns elastically."""
    rotations, origins = links(q, A, D)
    R, p = np.zeros((10, 3, 3)), np.zeros((10, 3))
    for i, joint in ((0, 0), (1, 1), (3, 2), (5, 3), (6, 4), (7, 5)):
        R[i], p[i] = rotations[joint], origins[joint]
    R[2], p[2] = rotations[1], origins[1] + 0.5 * A[2] * rotations[1, :, 0].copy()
    before = turn_x(rotations[2].copy(), ALPHA[3])  # the forearm in front of the turn of axis 4
    elbow = origins[2] + before[:, 0].copy() * 0.5 * A[3]
    R[4], p[4] = before, elbow + 0.5 * D[3] * before[:, 2].copy()
    wrist = origins[3]
    p[5], p[6], p[7] = wrist, wrist, wrist
    z = rotations[5, :, 2].copy()
    R[8], p[8] = rotations[5], wrist + (FLANGE + 0.028) * z
    R[9], p[9] = rotations[5], wrist + (FLANGE + 0.100) * z
    return R, p


@compiled
def deflection(q: FloatArray, p_FT: FloatArray, stiffness: FloatArray, f: FloatArray, m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Displacement [m] and rotation vector [rad] of the tool under force and moment at its tip, springs [10,3] in N m/rad."""
    R, p = stations(q)
    at = p[9] + R[9].copy() @ (p_FT - np.array([0.0, 0.0, 0.100]))
    d, theta = np.zeros(3), np.zeros(3)
    for i in range(10):
        r = at - p[i]
        M = R[i].T.copy() @ (cross(r, f) + m)
        t = R[i].copy() @ (M / stiffness[i])
        theta += t
        d += cross(t, r)
    return d, theta
