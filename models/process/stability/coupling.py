"""Mode coupling, and what an explicit coupling of robot and force adds to it.

Mode coupling needs no past surface: a force that follows the displacement, f = G u, couples two modes that it is not aligned with.

    q'' + 2 Z W q' + (W^2 - S^T G S) q = 0        (Pan, Zhang, Zhu & Wang 2006, for any number of modes)

Two simulations that exchange force and displacement once per step h make the force late. A late force feeds energy into a mode:
beyond a gain that has nothing to do with the machine, the simulation chatters.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from robomill.models.model.declaration import FloatArray
from robomill.models.process.stability.modes import TWO_PI, ComplexArray, Modes

SCAN = 200
"""Gains between zero and the largest at which growth is looked for, before bisection."""
GROWTH = 1e-9
"""A real part above this share of the lowest circular frequency is growth, not roundoff."""


def coupled_eigenvalues(modes: Modes, G: FloatArray) -> ComplexArray:
    """Eigenvalues (2 n,) [1/s] of modes under a force G u, G (3, 3) [N/m] in the axes of the shapes; a positive real part grows."""
    n, w = len(modes.frequency), modes.circular
    zero = np.zeros((n, n))
    stiffness = np.diag(w**2) - modes.shape.T @ G @ modes.shape
    A = np.block([[zero, np.eye(n)], [-stiffness, -2.0 * np.diag(modes.damping * w)]])
    return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)


def critical_gain(modes: Modes, G: FloatArray, largest: float) -> tuple[float, float]:
    """Least factor on G (3, 3) [N/m] up to `largest` at which the modes grow, and their frequency there [Hz].

    (inf, nan) if they do not; a frequency of zero is divergence: the process pulls harder than the springs hold.
    """
    bound = GROWTH * float(modes.circular.min())

    def growth(factor: float) -> float:
        return float(coupled_eigenvalues(modes, factor * G).real.max()) - bound

    gains = np.linspace(0.0, largest, SCAN + 1)
    for low, high in pairwise(gains):
        if growth(high) > 0.0:
            factor = brentq(growth, low, high) if growth(low) < 0.0 else low
            roots = coupled_eigenvalues(modes, factor * G)
            return float(factor), float(abs(roots[np.argmax(roots.real)].imag) / TWO_PI)
    return math.inf, math.nan


def undamped_flutter_gain(k1: float, k2: float, alpha: float, gamma: float) -> float:
    """Process gain [N/m] at which two undamped modes of equal mass flutter: the least root of

        (k1 - k2 + Kp cos(gamma + alpha))^2 = -Kp^2 sin(2 gamma) sin(2 alpha).

    k1, k2 [N/m]: stiffness along x and z; the depth grows along (cos alpha, sin alpha), the force acts along
    -(cos gamma, sin gamma) (FACTS 4.2, after Pan et al. 2006). inf if sin(2 gamma) sin(2 alpha) is not negative.
    """
    product = -math.sin(2.0 * gamma) * math.sin(2.0 * alpha)
    if product <= 0.0:
        return math.inf
    gains = [(k2 - k1) / (math.cos(gamma + alpha) + sign * math.sqrt(product)) for sign in (1.0, -1.0)]
    return min((g for g in gains if g > 0.0), default=math.inf)


def exchange_matrix(frequency: float, damping: float, ratio: float, step: float, extra: int = 0) -> FloatArray:
    """Transition over one communication step [s] of one mode and an explicit process force.

    The force is -ratio k u of the last exchange, `extra` exchanges older if asked for, and held over the step; the mode moves exactly.
    """
    w = TWO_PI * frequency
    A = np.array([[0.0, 1.0, 0.0], [-w * w, -2.0 * damping * w, w * w], [0.0, 0.0, 0.0]])
    moved = expm(A * step)
    Z = np.zeros((2 + extra, 2 + extra))
    Z[:2, :2] = moved[:2, :2]
    Z[:2, -1 if extra else 0] -= ratio * moved[:2, 2]
    for i in range(extra):
        Z[2 + i, 0 if i == 0 else 1 + i] = 1.0
    return Z


def explicit_limit(frequency: float, damping: float, step: float, extra: int = 0) -> float:
    """Ratio of process to modal stiffness beyond which an explicit coupling chatters although the machine does not.

    First order in step: 4 zeta/(w h (1 + 2 extra)). Here by eigenvalues, to the ratio at which one leaves the unit circle.
    """

    def excess(ratio: float) -> float:
        return float(np.abs(np.linalg.eigvals(exchange_matrix(frequency, damping, ratio, step, extra))).max()) - 1.0

    high = 4.0 * damping / (TWO_PI * frequency * step * (1 + 2 * extra))
    while excess(high) <= 0.0:
        high *= 2.0
    return float(brentq(excess, 0.0, high))


EXPLICIT, END, MIDDLE = "explicit", "end", "middle"
"""Which force acts over a step: that of the last exchange, or iterated that of the end or of the middle of this step."""


def exchange_transition(modes: Modes, G: FloatArray, step: float, scheme: str) -> FloatArray:
    """Transition (2 n, 2 n) of modes and a force G u, G (3, 3) [N/m], that is exchanged once per `step` [s]; the modes move exactly.

    EXPLICIT: the force of the last exchange is held over the step. END, MIDDLE: that of the displacement at the end, or of the mean of
    the displacements at both ends, which is what `milling_force` and `robot_compliance_dynamic` do when they are iterated.
    ValueError for another scheme.
    """
    n, w = len(modes.frequency), modes.circular
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n], A[n:, n:] = -np.diag(w**2), -2.0 * np.diag(modes.damping * w)
    B = np.vstack([np.zeros((n, 3)), modes.shape.T])
    whole = np.zeros((2 * n + 3, 2 * n + 3))
    whole[: 2 * n, : 2 * n], whole[: 2 * n, 2 * n :] = A, B
    moved = expm(whole * step)
    P, force = moved[: 2 * n, : 2 * n], moved[: 2 * n, 2 * n :] @ G @ np.hstack([modes.shape, np.zeros((3, n))])
    now = {EXPLICIT: 0.0, END: 1.0, MIDDLE: 0.5}
    if scheme not in now:
        raise ValueError(f"unknown scheme {scheme!r}; there are {EXPLICIT!r}, {END!r}, {MIDDLE!r}")
    return np.asarray(np.linalg.solve(np.eye(2 * n) - now[scheme] * force, P + (1.0 - now[scheme]) * force))


def simulated_gain(modes: Modes, G: FloatArray, step: float, scheme: str, largest: float) -> float:
    """Least factor on G (3, 3) [N/m] up to `largest` at which a simulation with that exchange grows; inf if it does not."""

    def excess(factor: float) -> float:
        return float(np.abs(np.linalg.eigvals(exchange_transition(modes, factor * G, step, scheme))).max()) - 1.0 - GROWTH

    for low, high in pairwise(np.linspace(0.0, largest, SCAN + 1)):
        if excess(high) > 0.0:
            return float(brentq(excess, low, high)) if excess(low) < 0.0 else float(low)
    return math.inf
