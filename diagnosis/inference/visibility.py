"""What runs can show before anything is fitted: the smallest visible size of each candidate, and what cannot be told from it.

All from whitened sensitivities v at the nominal system and the inner product <u, v> in which tolerances are marginalised
(`estimation`): a size x, in prior scales, lies sqrt(x' <V, V> x) standard deviations from the nominal system, and the best size of
another candidate leaves a part of that. What was measured counts by its noise, and, where an
effect bends, by which of its sensitivities the diagnosis begins with (`sensitivities`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robomill.diagnosis.candidates import LOGGING, Candidate
from robomill.diagnosis.experiment.simulation import Simulator, setting
from robomill.diagnosis.inference.evidence import Evidence
from robomill.diagnosis.inference.isolability import CONFUSABLE
from robomill.orchestration.slaves.protocol import FloatArray

SHOWS = 5.0
"""Standard deviations [1] from which a size is visible. They are 12.5 nats: less log 140 for the places of a catalogue and 3 nats for a
size that is not known before, odds of 100 to 1, where a false-alarm rate of 2 % asks for 50 to 1. Twice as much doubles every size."""

ROUNDS, EXACT_TO = 8, 0.1
"""Simulations of a candidate until its smallest visible size is known to this part [1] (cost; a size is wanted to one digit)."""


@dataclass(frozen=True)
class Sight:
    """How a candidate shows."""

    candidate: Candidate
    smallest: dict[str, float]
    """Parameter -> smallest visible value [unit]; infinite where it does not show at all."""
    by_tolerance: float
    """Part of its variance that more repeats do not take away, 0..1: what tolerances of calibrated numbers can do, too."""
    looked_at: float
    """Size [prior scales] at which others are compared with it: the usual one, or the smallest visible one if that is larger."""
    alike: dict[Candidate, tuple[float, FloatArray]]
    """Candidates that can stand for it then -> distance that they leave [deviations of noise], their best size [prior scales]."""

    @property
    def visible(self) -> bool:
        """Whether any size that the catalogue allows shows."""
        return min(self.smallest.values()) <= self.candidate.maximum


class Seen:
    """Sensitivities of candidates and all their inner products."""

    def __init__(self, evidence: Evidence, candidates: Sequence[Candidate]) -> None:
        self.candidates = list(candidates)
        places = [(c, k) for c in self.candidates for k in range(len(c.parameters))]
        self._index = {c: [i for i, (d, _) in enumerate(places) if d == c] for c in self.candidates}
        matrix = np.stack([evidence.sensitivities[c.addresses[k]] for c, k in places]).T
        space = evidence.space
        noise = space.lacking([n for n in space.names if not (n[0] == LOGGING and n[1].startswith("noise "))])
        known, all_of_them = space.gram(matrix), range(matrix.shape[1])
        self.products, self._noise = (s.within(known, all_of_them) for s in (space, noise))

    def smallest(self, c: Candidate) -> dict[str, float]:
        """Smallest visible value [unit] by parameter: SHOWS standard deviations, of an amplitude at its least favourable phase."""
        return self._smallest(c, self.products)

    def _smallest(self, c: Candidate, products: FloatArray) -> dict[str, float]:
        own = products[np.ix_(self._index[c], self._index[c])]
        if np.linalg.eigvalsh(own).min() <= 0.0:
            return dict.fromkeys(c.named[:1] if c.has_phase else c.parameters, math.inf)
        inverse = np.linalg.inv(own)
        if c.has_phase:
            return {c.named[0]: SHOWS * c.prior.scale * math.sqrt(float(np.linalg.eigvalsh(inverse).max()))}
        return {name: SHOWS * c.prior.scale * math.sqrt(v) for name, v in zip(c.parameters, np.diag(inverse), strict=True)}

    def sight(self, c: Candidate, found: float | None = None) -> Sight:
        """How a candidate shows, and what can stand for it; `found`: its smallest visible value [unit], if simulations have found it."""
        smallest, noise = self.smallest(c), self._smallest(c, self._noise)
        least = min(smallest.values())
        share = 1.0 - (min(noise.values()) / least) ** 2 if math.isfinite(least) else 0.0
        if found is not None:
            smallest, least = dict.fromkeys(smallest, found), found
        size = min(max(least, c.prior.scale), c.maximum) / c.prior.scale
        others = [d for d in self.candidates if d != c and not set(d.addresses) & set(c.addresses)]
        near = sorted(((d, f) for d in others if (f := self._instead(c, size, d))[0] < CONFUSABLE), key=lambda item: item[1][0])
        return Sight(c, smallest, min(max(share, 0.0), 1.0), size, dict(near) if least <= c.maximum else {})

    def _instead(self, c: Candidate, size: float, other: Candidate) -> tuple[float, FloatArray]:
        """Distance that the best size of `other` leaves of `c` at a size, and that size [prior scales]: least over signs and phases."""
        low, high = (b / other.prior.scale for b in other.bounds)
        best = (math.inf, np.zeros(0))
        for i in self._index[c]:
            for x in (size, -size) if c.both_signs else (size,):
                own, cross = self.products[np.ix_(self._index[other], self._index[other])], x * self.products[self._index[other], i]
                fitted = np.clip(np.linalg.lstsq(own, cross, rcond=None)[0], low, high)
                left = float(x * x * self.products[i, i] - 2.0 * fitted @ cross + fitted @ own @ fitted)
                if math.sqrt(max(left, 0.0)) < best[0]:
                    best = math.sqrt(max(left, 0.0)), np.sign(x) * fitted
        return best


def settled(evidence: Evidence, simulator: Simulator, seen: Seen) -> dict[Candidate, float]:
    """Smallest visible values [unit] of candidates of one parameter, by simulations from the linear value up; infinite where none shows.

    A limit does nothing until it is reached, and a delay turns. Below the linear value nothing is looked for: a single simulation
    scatters, in a loop with noise, and that is no signature.
    """
    low = {c: min(seen.smallest(c).values()) for c in seen.candidates if len(c.parameters) == 1}
    high: dict[Candidate, float] = {}
    tried = {c: min(x, c.maximum) for c, x in low.items()}
    n = len(evidence.repeats)
    for _ in range(ROUNDS):
        tasks = [(i, simulator.seeded(setting({c.addresses[0]: x}))) for c, x in tried.items() for i in range(n)]
        results, following = simulator.many(tasks, "smallest sizes"), {}
        for k, (c, x) in enumerate(tried.items()):
            signature = evidence.signature(results[k * n : (k + 1) * n])
            # a system that cannot run is seen
            square = SHOWS**2 if signature is None else evidence.space.square(signature)
            far = math.sqrt(max(square, 0.0)) / SHOWS
            if far * (1.0 + EXACT_TO) >= 1.0:
                high[c] = x
                if x <= low[c]:  # as large as the linear value, or at the bound below it
                    continue
            else:
                low[c] = x
            top = high.get(c, c.maximum)
            if low[c] * (1.0 + EXACT_TO) < top:
                half = math.sqrt(low[c] * top) if far > 0.0 else 0.5 * (low[c] + top)  # by proportion, where the effect has begun
                following[c] = half if c in high else top
        tried = following
    return {c: high.get(c, math.inf) for c in low}
