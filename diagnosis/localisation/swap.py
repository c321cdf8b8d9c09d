"""Where: the share that each component has in the gap, from the closed loop run again with components put right.

A component is swapped for the measured one by adding, to its measured outputs, what is left when it is replayed (`component_replay`): so
it does in the loop what the measured one did, and hands on what reaches it. (Its measurement put there as it is would also bring in
all errors from upstream: the last component of a chain would be given half of every error before it.) With all components
swapped the loop is the measured one. The shares are Shapley values over all subsets: they add up to what all together close,
components that are alike get the same, and one that changes nothing gets nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np

from robomill.diagnosis.experiment.component_replay import ComponentReplay
from robomill.diagnosis.experiment.repeats import RESAMPLES, as_share, bootstrapped, over_pairs
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.slaves.protocol import FloatArray

PLAYERS = 6
"""Components that are swapped at most, those with most left: 2^6 runs of each condition."""


def shapley(players: Sequence[str], value: Callable[[frozenset[str]], FloatArray]) -> dict[str, FloatArray]:
    """Exact Shapley values of a game; `value` of a subset is a number or an array of any shape, and so are the shares.

    phi_p = sum over subsets s without p of |s|! (n - |s| - 1)! / n! (value(s + p) - value(s)), n players.
    """
    worth = {frozenset(s): np.asarray(value(frozenset(s))) for k in range(len(players) + 1) for s in combinations(players, k)}
    n = len(players)
    shares: dict[str, FloatArray] = {}
    for p in players:
        total = np.zeros_like(worth[frozenset()], dtype=np.float64)
        for s, v in worth.items():
            if p not in s:
                total += math.factorial(len(s)) * math.factorial(n - len(s) - 1) / math.factorial(n) * (worth[s | {p}] - v)
        shares[p] = total
    return shares


@dataclass(frozen=True)
class Share:
    """Part of a component in the gap of one figure: its Shapley value, 0..1."""

    figure: str
    """Figure whose gap is shared out."""
    component: str
    """Whose outputs are put right; the cause may be anything between them and the cuts before them."""
    share: float
    """Part of the gap, 0..1."""
    interval: list[float] | None
    """90 %, bootstrap over the repeats; None where nothing was repeated."""


def shares(replays: Sequence[ComponentReplay], players: Sequence[str], figures: Mapping[str, FloatArray]) -> list[Share]:
    """Shares of `players` in each figure, with intervals over the repeats; no share where a run with swaps fails, or no gap is there.

    `replays`: one for each condition; `figures`: name -> weight of each channel [1 / unit] (0: not in it). The worth of a subset is
    1 - G(subset) / G(nothing), G the mean over pairs of repeats of the products of what is left, less the simulation's own noise.
    """
    cells: dict[frozenset[str], list[FloatArray]] = {}
    try:
        for k in range(len(players) + 1):
            for s in combinations(players, k):
                cells[frozenset(s)] = [b.swapped(frozenset(s)) for b in replays]
    except OrchestrationError:
        return []
    rng = np.random.default_rng(0)
    counts = [rng.multinomial(len(b.measured), np.full(len(b.measured), 1.0 / len(b.measured)), RESAMPLES) for b in replays]
    found = []
    for figure, weight in figures.items():

        def gap(s: frozenset[str], weight: FloatArray = weight) -> FloatArray:
            """G of the repeats as they are, then of the resampled ones."""
            total = np.zeros(1 + RESAMPLES)
            for b, sim, chosen in zip(replays, cells[s], counts, strict=True):
                left = np.stack([((x - sim) * weight)[:, weight > 0.0].ravel() for x in b.measured])
                noise = float((b.scatter * weight**2).sum()) * len(sim)
                total += over_pairs(left @ left.T, np.concatenate([np.ones((1, len(left))), chosen])) - noise
            return total

        nothing = gap(frozenset())
        if nothing[0] <= 0.0:
            continue
        before = np.where(nothing > 0.0, nothing, np.nan)
        values = shapley(players, partial(_closed, gap, before))
        for p in players:
            interval = bootstrapped(values[p][1:], max(len(b.measured) for b in replays))
            share = as_share(float(values[p][0]))
            found.append(Share(figure, p, share, [as_share(x) for x in interval] if interval else None))
    return found


def _closed(gap: Callable[[frozenset[str]], FloatArray], before: FloatArray, members: frozenset[str]) -> FloatArray:
    """Part of the gap that these close."""
    closed: FloatArray = 1.0 - gap(members) / before
    return closed
