"""Rotations, quaternions and small linear algebra on scratch arrays of the caller.

Everything here is a kernel: it allocates nothing and runs the same bits plain and compiled. Vectors
have shape (3,), rotation matrices (3, 3), quaternions (4,) with the scalar first. `R_AB` takes
components in B to components in A; quaternions follow suit. An output must not be one of the inputs
unless said so.
"""

from __future__ import annotations

import math

from robomill.models.maths.elementary import acos, atan2, sincos
from robomill.models.model.declaration import FloatArray, kernel

SMALL_ANGLE = 1e-8
"""Half angle [rad] below which sin(x)/x is 1 to the last bit (its error is x**2/6)."""


@kernel
def mat_mul(A: FloatArray, B: FloatArray, C: FloatArray) -> None:
    """Set C = A B, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            C[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def mat_vec(A: FloatArray, x: FloatArray, y: FloatArray) -> None:
    """Set y = A x; y may be x."""
    x0, x1, x2 = x[0], x[1], x[2]
    for i in range(3):
        y[i] = A[i, 0] * x0 + A[i, 1] * x1 + A[i, 2] * x2


@kernel
def mat_t_vec(A: FloatArray, x: FloatArray, y: FloatArray) -> None:
    """Set y = A^T x; y may be x."""
    x0, x1, x2 = x[0], x[1], x[2]
    for i in range(3):
        y[i] = A[0, i] * x0 + A[1, i] * x1 + A[2, i] * x2


@kernel
def cross(a: FloatArray, b: FloatArray, c: FloatArray) -> None:
    """Set c = a x b; c may be a or b."""
    c0 = a[1] * b[2] - a[2] * b[1]
    c1 = a[2] * b[0] - a[0] * b[2]
    c2 = a[0] * b[1] - a[1] * b[0]
    c[0] = c0
    c[1] = c1
    c[2] = c2


@kernel
def dot(a: FloatArray, b: FloatArray) -> float:
    """Scalar product of vectors of three."""
    result: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return result


@kernel
def norm(a: FloatArray) -> float:
    """Length of a vector of three."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@kernel
def normalise(a: FloatArray) -> None:
    """Divide a vector by its length, unless that is 0."""
    length = math.sqrt(dot(a, a))
    if length > 0.0:
        for i in range(3):
            a[i] /= length


@kernel
def quat_to_matrix(quat: FloatArray, R: FloatArray) -> None:
    """Set R from a quaternion of unit length."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    R[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    R[0, 1] = 2.0 * (x * y - w * z)
    R[0, 2] = 2.0 * (x * z + w * y)
    R[1, 0] = 2.0 * (x * y + w * z)
    R[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    R[1, 2] = 2.0 * (y * z - w * x)
    R[2, 0] = 2.0 * (x * z - w * y)
    R[2, 1] = 2.0 * (y * z + w * x)
    R[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@kernel
def matrix_to_quat(R: FloatArray, quat: FloatArray) -> None:
    """Quaternion of R with w >= 0, from the largest of the four components (Shepperd 1978), normalised."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace >= R[0, 0] and trace >= R[1, 1] and trace >= R[2, 2]:
        w = 1.0 + trace
        x = R[2, 1] - R[1, 2]
        y = R[0, 2] - R[2, 0]
        z = R[1, 0] - R[0, 1]
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        w = R[2, 1] - R[1, 2]
        x = 1.0 + R[0, 0] - R[1, 1] - R[2, 2]
        y = R[1, 0] + R[0, 1]
        z = R[2, 0] + R[0, 2]
    elif R[1, 1] >= R[2, 2]:
        w = R[0, 2] - R[2, 0]
        x = R[1, 0] + R[0, 1]
        y = 1.0 + R[1, 1] - R[0, 0] - R[2, 2]
        z = R[2, 1] + R[1, 2]
    else:
        w = R[1, 0] - R[0, 1]
        x = R[2, 0] + R[0, 2]
        y = R[2, 1] + R[1, 2]
        z = 1.0 + R[2, 2] - R[0, 0] - R[1, 1]
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    if w < 0.0:
        scale = -scale
    quat[0] = w * scale
    quat[1] = x * scale
    quat[2] = y * scale
    quat[3] = z * scale


@kernel
def quat_multiply(a: FloatArray, b: FloatArray, c: FloatArray) -> None:
    """Set c = a b (rotation b first, then a); c may be a or b. The sign is kept as it falls."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    c[0] = w
    c[1] = x
    c[2] = y
    c[3] = z


@kernel
def quat_from_abc(a: float, b: float, c: float, quat: FloatArray) -> None:
    """Quaternion of Rz(a) Ry(b) Rx(c) [rad], w >= 0: Eq. (16) of Haehn & Weigold 2020 with its signs restored."""
    sa, ca = sincos(0.5 * a)
    sb, cb = sincos(0.5 * b)
    sc, cc = sincos(0.5 * c)
    w = cc * cb * ca + sc * sb * sa
    sign = 1.0 if w >= 0.0 else -1.0
    quat[0] = sign * w
    quat[1] = sign * (sc * cb * ca - cc * sb * sa)
    quat[2] = sign * (cc * sb * ca + sc * cb * sa)
    quat[3] = sign * (cc * cb * sa - sc * sb * ca)


@kernel
def rotation_abc(a: float, b: float, c: float, R: FloatArray) -> None:
    """R = Rz(a) Ry(b) Rx(c) [rad]: Euler z-y'-x'', Eq. (4) of Haehn & Weigold 2020 (gamma, beta, alpha)."""
    sa, ca = sincos(a)
    sb, cb = sincos(b)
    sc, cc = sincos(c)
    R[0, 0] = cb * ca
    R[0, 1] = sc * sb * ca - cc * sa
    R[0, 2] = cc * sb * ca + sc * sa
    R[1, 0] = cb * sa
    R[1, 1] = sc * sb * sa + cc * ca
    R[1, 2] = cc * sb * sa - sc * ca
    R[2, 0] = -sb
    R[2, 1] = sc * cb
    R[2, 2] = cc * cb


@kernel
def matrix_to_abc(R: FloatArray, abc: FloatArray) -> None:
    """Euler angles (A, B, C) [rad] of R = Rz(A) Ry(B) Rx(C), B in [-pi/2, pi/2]; at B = +-pi/2, A is set to 0."""
    horizontal = math.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0])
    abc[1] = atan2(-R[2, 0], horizontal)
    if horizontal > 1e-12:
        abc[0] = atan2(R[1, 0], R[0, 0])
        abc[2] = atan2(R[2, 1], R[2, 2])
    else:
        abc[0] = 0.0
        abc[2] = atan2(-R[1, 2], R[1, 1])


@kernel
def rotation_vector_to_quat(theta: FloatArray, quat: FloatArray) -> None:
    """Quaternion (w >= 0) of the rotation vector `theta` [rad]: axis times angle, |theta| <= pi for w >= 0."""
    angle = norm(theta)
    half = 0.5 * angle
    s, c = sincos(half)
    scale = 0.5 if half < SMALL_ANGLE else s / angle
    if c < 0.0:
        c = -c
        scale = -scale
    quat[0] = c
    quat[1] = scale * theta[0]
    quat[2] = scale * theta[1]
    quat[3] = scale * theta[2]


@kernel
def quat_to_rotation_vector(quat: FloatArray, theta: FloatArray) -> None:
    """Rotation vector `theta` [rad], |theta| <= pi, of a unit quaternion of either sign."""
    sign = 1.0 if quat[0] >= 0.0 else -1.0
    sine = math.sqrt(quat[1] * quat[1] + quat[2] * quat[2] + quat[3] * quat[3])
    scale = sign * (2.0 if sine < SMALL_ANGLE else 2.0 * atan2(sine, sign * quat[0]) / sine)
    theta[0] = scale * quat[1]
    theta[1] = scale * quat[2]
    theta[2] = scale * quat[3]


@kernel
def rotation_vector_apply(theta: FloatArray, R: FloatArray, quat: FloatArray, out: FloatArray) -> None:
    """Set out = exp(theta) R: the rotation vector `theta` [rad, in the outer frame] applied to R; `quat` (4,) is scratch.

    `out` may be R.
    """
    rotation_vector_to_quat(theta, quat)
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    for j in range(3):
        # v' = v + 2 w (u x v) + 2 u x (u x v), column by column
        v0, v1, v2 = R[0, j], R[1, j], R[2, j]
        c0 = y * v2 - z * v1
        c1 = z * v0 - x * v2
        c2 = x * v1 - y * v0
        out[0, j] = v0 + 2.0 * (w * c0 + (y * c2 - z * c1))
        out[1, j] = v1 + 2.0 * (w * c1 + (z * c0 - x * c2))
        out[2, j] = v2 + 2.0 * (w * c2 + (x * c1 - y * c0))


@kernel
def angle_between(a: FloatArray, b: FloatArray) -> float:
    """Angle [rad] between two quaternions seen as rotations, in [0, pi]."""
    c = abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3])
    return 2.0 * acos(min(c, 1.0))


@kernel
def solve(A: FloatArray, b: FloatArray, x: FloatArray, n: int) -> int:
    """Solve A x = b by Gaussian elimination with partial pivoting; the leading n x n part of A is used.

    A and b are destroyed. Returns 0, or 1 if A is singular to working precision (x is then left alone).
    """
    largest = 0.0
    for i in range(n):
        for j in range(n):
            largest = max(largest, abs(A[i, j]))
    if not largest > 0.0:
        return 1
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if not abs(A[pivot, k]) > 1e-14 * largest:
            return 1
        if pivot != k:
            for j in range(k, n):
                swap = A[k, j]
                A[k, j] = A[pivot, j]
                A[pivot, j] = swap
            swap = b[k]
            b[k] = b[pivot]
            b[pivot] = swap
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= factor * A[k, j]
            b[i] -= factor * b[k]
    for k in range(n - 1, -1, -1):
        total = b[k]
        for j in range(k + 1, n):
            total -= A[k, j] * x[j]
        x[k] = total / A[k, k]
    return 0
