"""Finding x = G(x) when G is one round through a loop of components: settings and the three ways to the next guess.

All work on the residual r = G(x) - x. Signals of one loop have different units and sizes (N and um),
so lengths are measured in scaled signals: every array divided by its size at the first round of the step.

`compare`, `improve` and its `PARTS` run as they are, and compiled (`compiled_iteration`) with the same bits: scalar loops on arrays that
are given.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

from robomill.orchestration.errors import SystemFileError, unknown

METHODS = ("aitken", "anderson", "fixed-point")
AITKEN, ANDERSON = 0, 1
HOLDS = ("end", "mean")
UNCONVERGED = ("error", "accept")
_MAX = sys.float_info.max
_PARALLEL = 1e-10  # share of a difference that earlier ones do not have, below which it is round-off


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
                raise SystemFileError(unknown(key, value, allowed))
        if not 0.0 <= self.tolerance < 1.0:
            raise SystemFileError(f"the iteration's tolerance is a relative change; expected 0 to below 1, found {self.tolerance}")
        if not 0.0 < self.relaxation <= 1.0:
            raise SystemFileError(f"the iteration's relaxation: expected above 0 and at most 1, found {self.relaxation}")
        if self.max_iterations < 1 or self.depth < 1:
            raise SystemFileError(
                f"the iteration's max_iterations and depth: expected 1 or more, found {self.max_iterations} and {self.depth}"
            )


DEFAULT = Iteration()


class Work:
    """What the search keeps from round to round of a step, for up to `n` unknowns."""

    def __init__(self, settings: Iteration, n: int) -> None:
        self.method = METHODS.index(settings.method)
        self.history = np.zeros((4 * settings.depth + 2, n))
        """Guesses and residuals of the last depth + 1 rounds, scaled; what `anderson` makes of them."""
        self.factor = np.full(1, settings.relaxation)
        """Relaxation; `aitken` changes it."""


def compare(n: int, x: Any, g: Any, arrays: Any, largest: Any, sizes: Any) -> tuple[float, int]:
    """The largest change |g - x| of the unknowns x[:n], relative to the size of its array, and whose it is; (inf, -1): g is not finite.

    The size of an array is its largest element in x or g. `sizes` is told that of each unknown's array; `largest` is scratch.
    """
    for i in range(n):
        largest[arrays[i]] = 0.0
    for i in range(n):
        if not abs(g[i]) <= _MAX:
            return math.inf, -1
        largest[arrays[i]] = max(largest[arrays[i]], abs(x[i]), abs(g[i]))
    residual, worst = 0.0, 0
    for i in range(n):
        sizes[i] = largest[arrays[i]] if largest[arrays[i]] > 0.0 else 1.0
        change = abs(g[i] - x[i]) / sizes[i]
        if not change <= residual:
            residual, worst = change if change <= _MAX else math.inf, i
    return residual, worst


def improve(method: int, relaxation: float, rounds: int, n: int, x: Any, g: Any, scale: Any, history: Any, factor: Any) -> None:
    """Put the next guess in the place of x[:n], after `rounds` rounds of this step, the last of which made g of it.

    `method` is a number in `METHODS`, `history` and `factor` are those of `Work`.

    - `fixed-point`: x + w r with a constant w converges where w G + (1 - w) I contracts.
    - `aitken`: w from the last two residuals (Irons & Tuck 1969; Kuettler & Wall 2008, Eq. 44). One number for all signals:
      the secant method for a loop of one signal, a good guess for loops that one direction dominates. w may become
      negative: loops of a gain above one converge, too.
    - `anderson`: Anderson mixing (Anderson 1965; Walker & Ni 2011, Eq. 2.2), the quasi-Newton method IQN-ILS of
      fluid-structure coupling. The next guess is the best that the differences of the last rounds allow for a linear G:
      in n signals, n + 1 rounds solve a linear loop of any gain. The differences of residuals are made orthonormal,
      the latest first, and those of the guesses are combined alike (Fang & Saad 2009, Sec. 4); one that has become
      parallel to those before it is left out.
    """
    slots = (len(history) + 2) // 4  # rounds kept: depth + 1
    now = (rounds - 1) % slots
    here, rest = history[now], history[slots + now]
    for i in range(n):
        here[i] = x[i] / scale[i]
        rest[i] = (g[i] - x[i]) / scale[i]
    if rounds == 1:
        factor[0] = relaxation
    elif method == AITKEN:
        factor[0] = _secant(n, factor[0], history[slots + (rounds - 2) % slots], rest)
    w = factor[0]
    for i in range(n):
        x[i] = here[i] + w * rest[i]
    if method == ANDERSON and rounds > 1:
        _combine(rounds, slots, n, w, x, here, rest, history)
    for i in range(n):
        x[i] *= scale[i]


def _secant(n: int, w: float, before: Any, rest: Any) -> float:
    """The relaxation of `aitken` that follows w, from the last residual but one and the last."""
    product, length = 0.0, 0.0
    for i in range(n):
        change = rest[i] - before[i]
        product += before[i] * change
        length += change * change
    return -w * product / length if length > 0.0 and product != 0.0 else w  # orthogonal residuals say nothing about w


def _combine(rounds: int, slots: int, n: int, w: float, x: Any, here: Any, rest: Any, history: Any) -> None:
    """Take from the guess x what `anderson` finds in the differences of the last rounds."""
    kept = 0
    for age in range(1, min(rounds, slots)):
        old = (rounds - 1 - age) % slots
        q, p = history[2 * slots + kept], history[3 * slots - 1 + kept]
        whole = 0.0
        for i in range(n):
            q[i], p[i] = rest[i] - history[slots + old, i], here[i] - history[old, i]
            whole += q[i] * q[i]
        left = _orthogonal(kept, slots, n, q, p, history)
        if left > _PARALLEL * _PARALLEL * whole:
            length = math.sqrt(left)
            share = 0.0
            for i in range(n):
                q[i] /= length
                p[i] /= length
                share += q[i] * rest[i]
            for i in range(n):
                x[i] -= share * (w * q[i] + p[i])
            kept += 1


def _orthogonal(kept: int, slots: int, n: int, q: Any, p: Any, history: Any) -> float:
    """Take from a difference q of residuals what the `kept` ones before it have, and from that of guesses p alike; q squared then."""
    for k in range(2 * kept):  # twice: once leaves round-off that stiff loops amplify
        made = k % kept
        share = 0.0
        for i in range(n):
            share += history[2 * slots + made, i] * q[i]
        for i in range(n):
            q[i] -= share * history[2 * slots + made, i]
            p[i] -= share * history[3 * slots - 1 + made, i]
    left = 0.0
    for i in range(n):
        left += q[i] * q[i]
    return left


PARTS = (_secant, _combine, _orthogonal)
"""Functions that `improve` calls: compiled with it."""
