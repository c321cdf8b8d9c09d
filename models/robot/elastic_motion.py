"""Motion of the elastic coordinates over a step: M x.. + D x. + K x = f with M, D, K and f frozen, in implicit substeps.

The scheme is the stiffly accurate, L-stable, singly diagonal Runge-Kutta method of order 3 in three stages (Alexander 1977, SIAM
J. Numer. Anal. 14, Theorem 5). A stage solves for the acceleration a with one and the same matrix,

    (M + g t D + (g t)^2 K) a = f - D v - K (x + g t v),      t the substep, g = 0.43587,

which is factorised once per step; M may be singular, as springs in series without mass make it. |R(i w t)| <= 1, and R falls to zero
for w t to infinity: no mode gains energy, and what swings too fast for the substep follows the load without ringing. K and D are
diagonal (paper 004, Eq. 2.2); D need not be proportional to K.
"""

from __future__ import annotations

import math

from robomill.models.model.declaration import Record, Variable, kernel
from robomill.models.robot.elastic_bodies import COORDINATES

G = 0.4358665215084590
"""Root of g^3 - 3 g^2 + 3/2 g - 1/6 between 1/6 and 1/2."""
_A21 = 0.5 * (1.0 - G)
_A31 = -0.25 * (6.0 * G * G - 16.0 * G + 1.0)
_A32 = 0.25 * (6.0 * G * G - 20.0 * G + 5.0)

MOTION_VARIABLES: tuple[Variable, ...] = (
    Variable("elastic_angle", "state", "Angles x of the elastic coordinates", "rad", (COORDINATES,)),
    Variable("elastic_rate", "state", "Their rates", "rad/s", (COORDINATES,)),
    Variable("elastic_load", "state", "Moments f on the elastic coordinates over the step", "N.m", (COORDINATES,)),
    Variable("stage_rate", "state", "Scratch: rates of the three stages", "rad/s", (3, COORDINATES)),
    Variable("stage_push", "state", "Scratch: accelerations of the three stages", "rad/s2", (3, COORDINATES)),
)
"""States and scratch of the kernels below, after `ELASTIC_VARIABLES`."""


@kernel
def factorise(s: Record, substep: float) -> int:
    """Turn s.elastic_M from M into the Cholesky factor of M + g t D + (g t)^2 K: U in the upper half, U^T in the lower; t [s].

    Both halves, so that forward and backward substitution walk along rows. Returns 0, or the number of the coordinate, from 1, at which
    the matrix is not positive definite.
    """
    n = s.elastic_count
    part = G * substep
    U = s.elastic_M
    for i in range(n):
        U[i, i] += part * (s.elastic_damping[i] + part * s.elastic_stiffness[i])
    for k in range(n):
        pivot = U[k, k]
        if not pivot > 0.0:
            return int(k + 1)
        root = math.sqrt(pivot)
        U[k, k] = root
        for j in range(k + 1, n):
            U[k, j] /= root
        for i in range(k + 1, n):
            share = U[k, i]
            for j in range(i, n):
                U[i, j] -= share * U[k, j]
    for k in range(n):
        for j in range(k):
            U[k, j] = U[j, k]
    return 0


@kernel
def _solve(s: Record, stage: int) -> None:
    """Solve U^T U a = b in place of b = s.stage_push[stage]."""
    n = s.elastic_count
    a = s.stage_push[stage]
    for k in range(n):
        value = a[k] / s.elastic_M[k, k]
        a[k] = value
        for i in range(k + 1, n):
            a[i] -= s.elastic_M[k, i] * value
    for i in range(n):
        k = n - 1 - i
        value = a[k] / s.elastic_M[k, k]
        a[k] = value
        for j in range(k):
            a[j] -= s.elastic_M[k, j] * value


@kernel
def _stage(s: Record, stage: int, t: float, first: float, second: float) -> None:
    """One stage over the substep t [s]: `first` and `second` are its weights of the stages before it."""
    for i in range(s.elastic_count):
        v = s.elastic_rate[i] + t * (first * s.stage_push[0, i] + second * s.stage_push[1, i])
        x = s.elastic_angle[i] + t * (first * s.stage_rate[0, i] + second * s.stage_rate[1, i])
        s.stage_rate[stage, i] = v
        s.stage_push[stage, i] = s.elastic_load[i] - s.elastic_damping[i] * v - s.elastic_stiffness[i] * (x + G * t * v)
    _solve(s, stage)
    for i in range(s.elastic_count):
        s.stage_rate[stage, i] += G * t * s.stage_push[stage, i]


@kernel
def advance(s: Record, substep: float) -> None:
    """Take s.elastic_angle and s.elastic_rate on by the substep [s] under s.elastic_load, with the factor of `factorise`."""
    t = substep
    _stage(s, 0, t, 0.0, 0.0)
    _stage(s, 1, t, _A21, 0.0)
    _stage(s, 2, t, _A31, _A32)
    for i in range(s.elastic_count):
        s.elastic_angle[i] += t * (_A31 * s.stage_rate[0, i] + _A32 * s.stage_rate[1, i] + G * s.stage_rate[2, i])
        s.elastic_rate[i] = s.stage_rate[2, i]
