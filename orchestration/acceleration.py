"""Finding x = G(x) when G is one round through a loop of components: settings and the three ways to the next guess.

All work on the residual r = G(x) - x. Signals of one loop have different units and sizes (N and um),
so lengths are measured in scaled signals: every array divided by its size at the first round of the step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from orchestration.errors import SystemFileError, unknown
from orchestration.slave import FloatArray

METHODS = ("aitken", "anderson", "fixed-point")
HOLDS = ("end", "mean")
UNCONVERGED = ("error", "accept")


@dataclass(frozen=True)
class Iteration:
    """Settings of iterated coupling: the table `[iteration]` of a system file."""

    method: str = "aitken"
    """`fixed-point` (constant relaxation), `aitken` (dynamic relaxation) or `anderson` (quasi-Newton, IQN-ILS)."""
    tolerance: float = 1e-8
    """Largest change of a signal in the last round, relative to the size of its array."""
    max_iterations: int = 50
    """Rounds per step."""
    relaxation: float = 1.0
    """Factor of the first correction in each step; of all corrections with `fixed-point`; the mixing of `anderson`."""
    depth: int = 10
    """Earlier rounds that `anderson` uses."""
    hold: str = "end"
    """What inputs within the loop hold during a step: `end`, the value at its end, or `mean`, that of its start and its end."""
    unconverged: str = "error"
    """What happens after `max_iterations`: `error` ends the run, `accept` goes on with the last round."""

    def __post_init__(self) -> None:
        """Check the values. SystemFileError says what is wrong."""
        for key, value, allowed in (
            ("method", self.method, METHODS),
            ("hold", self.hold, HOLDS),
            ("unconverged", self.unconverged, UNCONVERGED),
        ):
            if value not in allowed:
                raise SystemFileError(f"iteration: {unknown(key, value, allowed)}")
        if not 0.0 <= self.tolerance < 1.0:
            raise SystemFileError(f"iteration: tolerance is a relative change, from 0 to below 1; found {self.tolerance}")
        if not 0.0 < self.relaxation <= 1.0:
            raise SystemFileError(f"iteration: relaxation is above 0 and at most 1; found {self.relaxation}")
        if self.max_iterations < 1 or self.depth < 1:
            raise SystemFileError(f"iteration: max_iterations and depth are at least 1; found {self.max_iterations} and {self.depth}")


DEFAULT = Iteration()


class Accelerator(Protocol):
    """Gives the next guess; one is made for each step."""

    def next(self, x: FloatArray, r: FloatArray) -> FloatArray:
        """The guess after x with the residual r = G(x) - x, both scaled, float64[n]."""
        ...


class FixedPoint:
    """x + w r with a constant w: converges where w G + (1 - w) I contracts."""

    def __init__(self, relaxation: float) -> None:
        self.w = relaxation

    def next(self, x: FloatArray, r: FloatArray) -> FloatArray:
        """See `Accelerator`."""
        return x + self.w * r


class Aitken:
    """x + w r with w from the last two residuals (Irons & Tuck 1969; Kuettler & Wall 2008, Eq. 44).

    One number for all signals: the secant method for a loop of one signal, a good guess for loops that
    one direction dominates. w may become negative: loops of a gain above one converge, too.
    """

    def __init__(self, relaxation: float) -> None:
        self.w = relaxation
        self.before: FloatArray | None = None

    def next(self, x: FloatArray, r: FloatArray) -> FloatArray:
        """See `Accelerator`."""
        if self.before is not None:
            change = r - self.before
            length = float(change @ change)
            if length > 0.0:
                w = -self.w * float(self.before @ change) / length
                self.w = w if w != 0.0 else self.w  # orthogonal residuals say nothing about w
        self.before = r
        return x + self.w * r


class Anderson:
    """Anderson mixing (Anderson 1965; Walker & Ni 2011, Eq. 2.2), the quasi-Newton method IQN-ILS of fluid-structure coupling.

    The next guess is the best that the differences of the last rounds allow for a linear G: in n
    signals, n + 1 rounds solve a linear loop of any gain.
    """

    def __init__(self, mixing: float, depth: int) -> None:
        self.mixing, self.depth = mixing, depth
        self.xs: list[FloatArray] = []
        self.rs: list[FloatArray] = []

    def next(self, x: FloatArray, r: FloatArray) -> FloatArray:
        """See `Accelerator`."""
        self.xs, self.rs = [*self.xs[-self.depth :], x], [*self.rs[-self.depth :], r]
        if len(self.rs) == 1:
            return x + self.mixing * r
        dx = np.stack([x - old for old in self.xs[:-1]], axis=1)
        dr = np.stack([r - old for old in self.rs[:-1]], axis=1)
        # differences that have become parallel to round-off are left out by the cut-off of the singular values
        sizes = np.maximum(np.sqrt(np.sum(dr * dr, axis=0)), np.finfo(float).tiny)
        c = np.linalg.lstsq(dr / sizes, r, rcond=1e-10)[0] / sizes
        correction: FloatArray = self.mixing * (r - dr @ c) - dx @ c
        return x + correction


def accelerator(settings: Iteration) -> Accelerator:
    """A fresh one of the chosen method."""
    if settings.method == "aitken":
        return Aitken(settings.relaxation)
    if settings.method == "anderson":
        return Anderson(settings.relaxation, settings.depth)
    return FixedPoint(settings.relaxation)
