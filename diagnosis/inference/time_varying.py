"""What effects of the catalogue would do if they changed with time: the mark of something that is in no catalogue.

A catalogue says what is wrong, not that it comes late (creep) or grows (wear of the tool, warming). What does so leaves little beside
an entry that resembles it, and may hold in new conditions as well as that. So the sensitivities of the search are also looked at as they
would be if an effect came late, or grew during the run. It takes no simulations and names no cause; it tells what the cause is like.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from robomill.diagnosis.candidates import LOGGING, Candidate
from robomill.diagnosis.inference.priors import log_priors
from robomill.diagnosis.inference.search import Search
from robomill.orchestration.slaves.protocol import FloatArray

COMING_LATE = (1 / 32, 1 / 16, 1 / 8, 1 / 4)
"""Time constants with which an effect may come late, as parts of a run."""
GROWING = 1 / 4
"""Time constant with which an effect may grow from the beginning of a run to its end, as a part of it; or it grows steadily."""


@dataclass(frozen=True)
class Changing:
    """An effect of the catalogue that changes with time, as the catalogue does not have it."""

    candidate: Candidate
    """Effect of the catalogue that is meant."""
    how: str
    """What it does with time, in words."""
    log_odds: float
    """Log of evidence times prior; the prior of the candidate is shared by all the ways to change."""
    by_change: float
    """Gain [nats] against the best candidate that is the same all the time."""


def changing(search: Search) -> Changing | None:
    """The likeliest effect that changes with time; None where there is no candidate with one parameter.

    Of a whitened sensitivity v that changes, chi2 = <y, y> - e with e = <v, y>^2 / <v, v>, and the log of the odds is
    (e - log max(e, 1)) / 2 + log of the prior of the candidate - log of the number of ways to change. Effects count as proportional to
    their size, by the sensitivity of the search or the signature where its fit starts. A size is not believed to be near that of the prior:
    an unknown cause has another one. Its prior is as wide as the value itself.
    """
    space, channels = search.evidence.space, int(search.evidence.active.sum())
    candidates = [c for c in search.candidates if len(c.parameters) == 1 and c.component != LOGGING]
    best: tuple[float, float, Candidate, str] | None = None
    least = space.chi2
    priors = dict(zip(candidates, log_priors([(c,) for c in candidates], search.candidates), strict=True))
    for _, group in itertools.groupby(candidates, lambda c: c.effect):  # so many that their products are worth making together
        places = list(group)
        ways = [_ways(search, c, channels) for c in places]
        known = space.gram(np.stack([space.y, *(v for w in ways for v in w.values())]).T)
        first = 1
        for c, made in zip(places, ways, strict=True):
            own = space.without(c.addresses)
            products = own.within(known, [0, *range(first, first + len(made))])
            first += len(made)
            size, along = np.diag(products)[1:], products[0, 1:]
            explained = along**2 / np.where(size > 0.0, size, np.inf)
            left = products[0, 0] - explained
            least = min(least, float(left[0]))
            i = 1 + int(left[1:].argmin())
            evidence = 0.5 * (space.chi2 - left[i] + space.log_determinant - own.log_determinant - math.log(max(explained[i], 1.0)))
            log_odds = float(evidence) + priors[c] - math.log(len(made) - 1)
            if best is None or log_odds > best[0]:
                best = (log_odds, float(left[i]), c, list(made)[i])
    if best is None:
        return None
    log_odds, chi2, candidate, how = best
    return Changing(candidate, how, log_odds, 0.5 * (least - chi2))


def _ways(search: Search, c: Candidate, channels: int) -> dict[str, FloatArray]:
    """The sensitivity of a candidate, [n]: as it is, and with every way to change."""
    start = search.starts.get(c.addresses[0])
    sensitivity = search.evidence.sensitivities[c.addresses[0]] if start is None else start.signature
    return {"": sensitivity, **_changed(sensitivity, search.evidence.space.blocks, channels)}


def _changed(sensitivity: FloatArray, blocks: Mapping[str, slice], channels: int) -> dict[str, FloatArray]:
    """The sensitivity [n] as it would be with every way to change, in every run anew: way in words -> [n]."""
    found: dict[str, FloatArray] = {}
    for block in blocks.values():
        x = sensitivity[block].reshape(-1, channels)
        n = len(x)
        t = (np.arange(n) / n)[:, None]
        made = {}
        for part in COMING_LATE:
            step = -math.expm1(-1.0 / (part * n))
            made[f"comes late, by a time constant of 1/{round(1 / part)} of a run"] = lfilter([step], [1.0, step - 1.0], x, axis=0)
        made["grows steadily during a run"] = x * t
        made["grows quickly at first, slowly later in a run"] = -np.expm1(-t / GROWING) * x
        for how, y in made.items():
            found.setdefault(how, np.zeros_like(sensitivity))[block] = y.ravel()
    return found
