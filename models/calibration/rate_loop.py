"""Design of the rate control with python-control: the loop of force and feed, continuous and as it is sampled.

Paper 003, sec. 4.3. Once the force is linearised (Eqs. 8, 9) the loop is linear: PI, speed dynamics G(s) of the robot (Eq. 1, from command
to actual feed) and the process gain k V_r, all gains together K = V_r k K_i (1/s; Eq. 13 sets 28.84). Eq. (1) itself is lost; FACTS 2.2
gives the candidates that agree with every number of the text. Transfer functions here are those of python-control.
"""

from __future__ import annotations

import math
from typing import Any

import control
import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

ComplexArray = npt.NDArray[np.complex128]

LOOP_GAIN = 28.84
"""1/s, Eq. (13)."""
ZERO_TIME = 0.015
"""Seconds, Eq. (11): K_p over K_i; cancels the slow pole, nearly."""
SLOW_POLE = 66.5
"""1/s, sec. 4.3.2."""
ORDER_OF_DEPTH = 1.8
"""Eqs. (6) and (9): k = 529 d^1.8."""
CYCLE = 0.004
SEARCHED = (1.0, 400.0)
"""Loop gains [1/s] between which the critical one is looked for."""

TransferFunction = Any
"""control.TransferFunction; python-control has no types."""


def _lag(*poles: float) -> TransferFunction:
    """Product of first order lags with unit gain and these poles [1/s]."""
    result = control.tf([1.0], [1.0])
    for pole in poles:
        result = result * control.tf([1.0], [1.0 / pole, 1.0])
    return result


def pade(dead_time: float) -> TransferFunction:
    """First order Pade approximation of a dead time [s]."""
    return control.tf([-0.5 * dead_time, 1.0], [0.5 * dead_time, 1.0])


DEAD_TIME_B = 0.00983
"""Seconds: what the ABB loop takes in candidate B; in the twin it is two delayed connections and the hold of the cycle."""
A = control.tf([-1.0 / 126.0, 1.0], [1.0]) * _lag(SLOW_POLE, 95.06)
B_UNDELAYED = _lag(SLOW_POLE, 127.8)
B = pade(DEAD_TIME_B) * B_UNDELAYED
C = control.tf([-1.0 / 221.4, 1.0], [1.0 / 150.0**2, 2.0 * 0.975 / 150.0, 1.0]) * _lag(SLOW_POLE)
CANDIDATES = {"A": A, "B": B, "C": C}


def loop_gain(depth: float) -> float:
    """K [1/s] at a depth of cut [mm] with gains that are right at 1 mm."""
    return float(LOOP_GAIN * depth**ORDER_OF_DEPTH)


def pi(gain: float) -> TransferFunction:
    """K (0.015 s + 1)/s: Eqs. (10), (11) with the process gain in it."""
    return control.tf([gain * ZERO_TIME, gain], [1.0, 0.0])


def sampled_pi(gain: float, cycle: float = CYCLE) -> TransferFunction:
    """The PI as rate_controller computes it, K (0.015 + h z/(z - 1)): backward differences."""
    return control.c2d(pi(gain), cycle, method="backward_diff")


def continuous_loop(dynamics: TransferFunction, gain: float) -> TransferFunction:
    """Open loop L(s) = K (0.015 s + 1)/s G(s)."""
    return pi(gain) * dynamics


def sampled_loop(dynamics: TransferFunction, gain: float, delays: int, cycle: float = CYCLE) -> TransferFunction:
    """Open loop L(z): sampled PI, `delays` delayed steps, G(s) behind a zero-order hold."""
    late = control.tf([1.0], [1.0] + [0.0] * delays, cycle)
    return sampled_pi(gain, cycle) * late * control.c2d(dynamics, cycle, "zoh")


def closed_poles(loop: TransferFunction) -> ComplexArray:
    """Poles [1/s] of the closed loop; those of a sampled one as ln(z)/h, without those at z = 0, which are pure delays."""
    poles: ComplexArray = np.asarray(control.feedback(loop, 1).poles(), dtype=np.complex128)
    if not loop.isctime():
        poles = np.log(poles[np.abs(poles) > 1e-9]) / loop.dt
    return poles


def oscillation(loop: TransferFunction) -> tuple[float, float]:
    """Damping ratio and natural frequency [Hz] of the oscillation that dies out last.

    The damping is negative if it grows; (1, 0) if nothing oscillates. A sampled pole on the negative real axis is a change
    of sign per cycle and not counted.
    """
    poles = closed_poles(loop)
    highest = math.inf if loop.isctime() else 0.999 * math.pi / loop.dt
    poles = poles[(np.abs(poles.imag) > 1e-6) & (np.abs(poles.imag) < highest)]
    if not len(poles):
        return 1.0, 0.0
    slowest = poles[np.argmax(poles.real)]
    return float(-slowest.real / abs(slowest)), float(abs(slowest) / (2.0 * math.pi))


def damping(loop: TransferFunction) -> float:
    """Damping ratio of that oscillation."""
    return oscillation(loop)[0]


def critical_gain(dynamics: TransferFunction, delays: int | None = None, cycle: float = CYCLE) -> float:
    """K [1/s] at which the closed loop is marginally stable; continuous if `delays` is None, else sampled with so many delayed steps."""

    def growth(gain: float) -> float:
        loop = continuous_loop(dynamics, gain) if delays is None else sampled_loop(dynamics, gain, delays, cycle)
        return float(closed_poles(loop).real.max())

    return float(brentq(growth, *SEARCHED))
