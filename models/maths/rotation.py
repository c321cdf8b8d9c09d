"""One rotation, with the arithmetic of SciPy's `Rotation`, bit for bit, and without the third of a second that its import takes.

For arrays of rotations take SciPy's own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robomill.models.model.declaration import FloatArray

_SMALL = 1e-3
"""Angle [rad] up to which a series stands for the quotient of angle and sine, as in SciPy."""
_UNITY = 1e-12
"""Deviation from orthogonality above which a matrix is replaced by the nearest rotation, as in SciPy."""


@dataclass(frozen=True, eq=False)
class Rotation:
    """A rotation in space by its unit quaternion."""

    x: float
    y: float
    z: float
    w: float

    @classmethod
    def from_quat(cls, quat: Sequence[float] | FloatArray) -> Rotation:
        """That of a quaternion (x, y, z, w) of any length but 0; ValueError for 0."""
        x, y, z, w = map(float, quat)
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if norm == 0.0:
            raise ValueError("quaternion (0, 0, 0, 0) is no orientation; expected one of length 1")
        return cls(x / norm, y / norm, z / norm, w / norm)

    @classmethod
    def from_matrix(cls, matrix: FloatArray) -> Rotation:
        """That of a matrix (3, 3): the nearest rotation if it is not quite orthogonal."""
        m = np.asarray(matrix, dtype=np.float64)
        if not np.allclose(m @ m.T, np.eye(3), rtol=0.0, atol=_UNITY):
            u, _, vt = np.linalg.svd(m)
            m = u @ vt
        rows = m.tolist()
        trace = rows[0][0] + rows[1][1] + rows[2][2]
        weights = [rows[0][0], rows[1][1], rows[2][2], trace]
        i = weights.index(max(weights))
        if i == 3:
            quat = [rows[2][1] - rows[1][2], rows[0][2] - rows[2][0], rows[1][0] - rows[0][1], 1.0 + trace]
        else:
            j, k = (i + 1) % 3, (i + 2) % 3
            quat = [0.0] * 4
            quat[i] = 1.0 - trace + 2.0 * rows[i][i]
            quat[j], quat[k] = rows[j][i] + rows[i][j], rows[k][i] + rows[i][k]
            quat[3] = rows[k][j] - rows[j][k]
        return cls.from_quat(quat)

    @classmethod
    def from_abc(cls, abc: Sequence[float]) -> Rotation:
        """Rz(A) Ry(B) Rx(C) of A, B, C [rad]."""
        a, b, c = (0.5 * float(angle) for angle in abc)
        turned = cls(0.0, 0.0, math.sin(a), math.cos(a))._times(cls(0.0, math.sin(b), 0.0, math.cos(b)))
        return turned._times(cls(math.sin(c), 0.0, 0.0, math.cos(c)))

    @classmethod
    def from_rotvec(cls, vector: Sequence[float] | FloatArray) -> Rotation:
        """That about an axis, given times its angle [rad]."""
        x, y, z = map(float, vector)
        angle = math.sqrt(x * x + y * y + z * z)
        square = angle * angle
        scale = 0.5 - square / 48.0 + square * square / 3840.0 if angle <= _SMALL else math.sin(0.5 * angle) / angle
        return cls(scale * x, scale * y, scale * z, math.cos(0.5 * angle))

    def __mul__(self, other: Rotation) -> Rotation:
        """First `other`, then this one."""
        return Rotation.from_quat(self._times(other).as_quat())

    def inv(self) -> Rotation:
        """The way back."""
        return Rotation(-self.x, -self.y, -self.z, self.w)

    def as_quat(self, canonical: bool = False) -> FloatArray:
        """(x, y, z, w); `canonical`: of the two that mean the same, the one with w > 0."""
        quat = np.array([self.x, self.y, self.z, self.w])
        return -quat if canonical and self._turned_round else quat

    def as_matrix(self) -> FloatArray:
        """Matrix (3, 3)."""
        x, y, z, w = self.x, self.y, self.z, self.w
        x2, y2, z2, w2, xy, zw, xz, yw, yz, xw = x * x, y * y, z * z, w * w, x * y, z * w, x * z, y * w, y * z, x * w
        return np.array(
            [
                [x2 - y2 - z2 + w2, 2.0 * (xy - zw), 2.0 * (xz + yw)],
                [2.0 * (xy + zw), -x2 + y2 - z2 + w2, 2.0 * (yz - xw)],
                [2.0 * (xz - yw), 2.0 * (yz + xw), -x2 - y2 + z2 + w2],
            ]
        )

    def as_rotvec(self) -> FloatArray:
        """Axis times angle [rad], at most pi."""
        x, y, z, w = self.as_quat(canonical=True).tolist()
        angle = 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), w)
        square = angle * angle
        scale = 2.0 + square / 12.0 + 7.0 * square * square / 2880.0 if angle <= _SMALL else angle / math.sin(0.5 * angle)
        return np.array([scale * x, scale * y, scale * z])

    def magnitude(self) -> float:
        """Angle [rad], at most pi."""
        return 2.0 * math.atan2(math.sqrt(self.x * self.x + self.y * self.y + self.z * self.z), abs(self.w))

    @property
    def _turned_round(self) -> bool:
        """Whether w < 0, or, where it is 0, the first of x, y, z that is not 0."""
        return next((v < 0.0 for v in (self.w, self.x, self.y, self.z) if v != 0.0), False)

    def _times(self, q: Rotation) -> Rotation:
        """Product of the quaternions as it is rounded."""
        p = self
        return Rotation(
            p.w * q.x + q.w * p.x + (p.y * q.z - p.z * q.y),
            p.w * q.y + q.w * p.y + (p.z * q.x - p.x * q.z),
            p.w * q.z + q.w * p.z + (p.x * q.y - p.y * q.x),
            p.w * q.w - p.x * q.x - p.y * q.y - p.z * q.z,
        )
