"""The run that tells apart what the given ones cannot: each run on the menu is simulated with each of the rival models.

The whitened distance d between two models in a run is that of their simulations, in the noise of the given repeats. Calibrated
numbers and fitted values are not exactly known; what they do along the difference u = d / |d| counts as noise too, so the variance
along u is mean (u . r)^2 + mean (u . n)^2 + (relative deviation of the values)^2 (u . s)^2 with r the deviations of the given repeats,
n the change that random draws of the nuisances make, and s the signature itself. This is the variance of a matched filter, so the
distance is a lower bound of what is possible.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from robomill.diagnosis.catalogue import physical
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import Laboratory, Setting, Simulator, setting
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.isolability import CONFUSABLE, distance
from robomill.diagnosis.inference.search import Search
from robomill.orchestration.slaves.protocol import FloatArray
from robomill.orchestration.system.definition import System

ENOUGH = 6.0
"""Distance [deviations of noise] from which more does not count: the pair is told apart."""
SHORT_LIST = 4
"""Runs that are looked at with the nuisances too."""
DRAWS = 3
"""Draws of the nuisances."""
LIKELY, RIVALS = 0.05, 3
"""Probability from which a model is a rival, and how many there are at most."""
NEARLY = 0.9
"""Runs that separate this part of what the best one does compete by distance per minute."""


@dataclass(frozen=True)
class Offer:
    """A run that could be made next: the system that makes it, and what it takes."""

    system: System
    """What makes it: components are called as in the system that is diagnosed, but some may be others."""
    parameters: Mapping[str, Mapping[str, Any]]
    """What the experimenter sets, component -> parameter -> value."""
    seconds: float
    """Length of one repeat."""
    minutes: float
    """What all repeats take, with setting up."""
    repeats: int
    shown: Mapping[str, Mapping[str, Any]]
    """The part of `parameters` that people want to see."""


@dataclass(frozen=True)
class Alternative:
    """Another run on the menu that was looked at."""

    kind: str
    distance: float
    """Whitened distance of the two models that are closest in it [deviations of noise]."""
    minutes: float
    per_minute: float
    """As in `Offer`, and `distance` over that."""


@dataclass(frozen=True)
class NextRun:
    """The run on the menu that tells the likely models apart best; `kind` to `per_minute` as in `Alternative`."""

    kind: str
    separates: tuple[str, ...]
    """Names of these models."""
    separated: bool
    """Whether it tells them apart: `distance` is not below CONFUSABLE."""
    distance: float
    now: float
    """That distance in the given runs [deviations of noise]."""
    minutes: float
    per_minute: float
    repeats: int
    parameters: dict[str, dict[str, Any]]
    """`Offer.shown`."""
    models: dict[str, dict[str, dict[str, float]]]
    """Model -> component -> parameter -> value."""
    alternatives: tuple[Alternative, ...]
    """The other runs, best first."""


class _Trial:
    """Simulations of the menu, and distances between the models in them."""

    def __init__(self, fits: Sequence[Fit], offers: Mapping[str, Offer], search: Search) -> None:
        self.fits, self.offers, self.search = fits, offers, search
        self.simulated: dict[str, list[FloatArray]] = {}
        """Kind -> channels with each of the fits."""
        self.nominal: dict[str, FloatArray] = {}
        self.drawn: dict[str, list[FloatArray]] = {}
        """Kind -> channels with draws of the nuisances."""
        groups = search.evidence.residuals
        # n repeats about their own mean scatter by (n - 1) / n of what they do
        self.repeats = [(r - np.mean(g, axis=0)) * math.sqrt(len(g) / (len(g) - 1)) for g in groups if len(g) > 1 for r in g]
        """Whitened deviations of the given repeats, flat."""

    def white(self, change: FloatArray, kind: str) -> FloatArray:
        return self.search.evidence.whitening.apply(change[:, self.search.evidence.active], self.offers[kind].repeats)

    def distance(self, kind: str, i: int, j: int) -> float:
        """Between two of the fits; nuisances and uncertain values count once their simulations are there."""
        a, b = self.simulated[kind][i], self.simulated[kind][j]
        difference = self.white(a - b, kind)
        length = float(np.linalg.norm(difference))
        if length == 0.0:
            return 0.0
        along = difference / length
        # the repeats say what noise does along it, slow noise too, for which whitening is not made
        rest = [float(along @ np.resize(r, along.size)) ** 2 for r in self.repeats]
        variance = max(1.0, float(np.mean(rest)) if rest else 1.0)
        if kind in self.nominal:
            nominal = self.nominal[kind]
            variance += sum(float(along @ self.white(x - nominal, kind)) ** 2 for x in self.drawn[kind]) / DRAWS
            for k, x in ((i, a), (j, b)):
                variance += (_uncertainty(self.fits[k]) * float(along @ self.white(x - nominal, kind))) ** 2
        return length / math.sqrt(variance)


def _draws(search: Search) -> list[Setting]:
    """Random machines within the tolerances of the calibrated numbers."""
    random = np.random.default_rng(0)
    return [setting({n.address: n.scale * float(random.standard_normal()) for n in search.nuisances}) for _ in range(DRAWS)]


@dataclass
class _Tried:
    """A run on the menu with what was found."""

    kind: str
    offer: Offer
    distances: dict[tuple[int, int], float]

    def separated(self, weights: Mapping[tuple[int, int], float]) -> float:
        """Weighted part of the pairs that it tells apart, softly."""
        return sum(w * min(self.distances[p] / ENOUGH, 1.0) for p, w in weights.items())

    @property
    def least(self) -> float:
        return min(self.distances.values())

    @property
    def per_minute(self) -> float:
        return self.least / self.offer.minutes


def rivals(fits: Sequence[Fit], weights: FloatArray, search: Search, *, known: bool) -> list[int]:
    """Indices of the models that a next run should tell apart, the best first; one where there is nothing to tell.

    Those that are likely and those that the data cannot tell from the best. Where the answer is not `known`, the best model and none at
    all (the first of `fits`): a run in which the best one shows most says whether it is that.
    """
    order = [int(i) for i in np.argsort(-weights, kind="stable") if fits[i].model]
    if not order:
        return []
    best = fits[order[0]]
    if not known:
        return [order[0], 0]
    close = [i for i in order[1:] if weights[i] > LIKELY or _instead(fits[i], best, search)]
    return [order[0], *close[: RIVALS - 1]]


def _instead(fit: Fit, best: Fit, search: Search) -> bool:
    """Whether a model that differs from the best in one candidate is the same to the data."""
    one = len(fit.model) == len(best.model) and len(set(fit.model) - set(best.model)) == 1
    return one and distance(fit, best, search.evidence.space) < CONFUSABLE


def recommend(
    fits: Sequence[Fit],
    weights: Sequence[float],
    offers: Mapping[str, Offer],
    search: Search,
    simulator: Simulator,
) -> NextRun | None:
    """The run that tells models of these weights apart best; None where no run on the menu can be simulated.

    The laboratory of `simulator` has one condition per offer, in that order (`laboratory`).
    """
    space = search.evidence.space
    now = {(i, j): distance(fits[i], fits[j], space) for i, j in combinations(range(len(fits)), 2)}
    together = {(i, j): weights[i] * weights[j] for i, j in now}
    shares = {p: w / sum(together.values()) for p, w in together.items()}
    places = list(offers)
    trial = _Trial(fits, offers, search)
    settings = [simulator.seeded(setting(f.values)) for f in fits]
    results = iter(simulator.many([(k, s) for k in range(len(places)) for s in settings], "next run"))
    for kind in places:
        group = [next(results) for _ in fits]
        complete = [x for x in group if x is not None]
        if len(complete) == len(group):
            trial.simulated[kind] = complete
    tried = [_Tried(k, offers[k], {p: trial.distance(k, *p) for p in shares}) for k in trial.simulated]
    if not tried:
        return None
    tried = _ranked(tried, shares)[:SHORT_LIST]
    draws = [(), *_draws(search)]
    results = iter(simulator.many([(places.index(t.kind), simulator.seeded(d)) for t in tried for d in draws], "next run"))
    for t in tried:
        nominal, *others = [next(results) for _ in draws]
        if nominal is not None:
            trial.nominal[t.kind], trial.drawn[t.kind] = nominal, [x for x in others if x is not None]
            t.distances = {p: trial.distance(t.kind, *p) for p in shares}
    best, *rest = _ranked(tried, shares)
    return NextRun(
        best.kind,
        tuple(_name(f) for f in fits),
        best.least >= CONFUSABLE,
        best.least,
        min(now.values()),
        best.offer.minutes,
        best.per_minute,
        best.offer.repeats,
        {c: dict(v) for c, v in best.offer.shown.items()},
        {_name(f): _table(f) for f in fits},
        tuple(Alternative(t.kind, t.least, t.offer.minutes, t.per_minute) for t in rest),
    )


def _name(fit: Fit) -> str:
    return fit.name if fit.model else "something else"


def _table(fit: Fit) -> dict[str, dict[str, float]]:
    """Component -> parameter -> value."""
    table: dict[str, dict[str, float]] = {}
    for (component, name), value in physical(fit.values).items():
        table.setdefault(component, {})[name] = value
    return table


def _uncertainty(fit: Fit) -> float:
    """Largest relative deviation of the values."""
    sizes = [(a, size) for c in fit.model for a, size in c.sizes(fit.values).items()]
    return max((fit.deviations[a] / size for a, size in sizes if size), default=0.0)


def _ranked(tried: Sequence[_Tried], weights: Mapping[tuple[int, int], float]) -> list[_Tried]:
    """Best first: runs that separate nearly as much as the best one by distance per minute, then the others by what they separate."""
    most = max(t.separated(weights) for t in tried)

    def key(t: _Tried) -> tuple[bool, float]:
        good = t.separated(weights) >= NEARLY * most
        return good, min(t.least, ENOUGH) / t.offer.minutes if good else t.separated(weights)

    return sorted(tried, key=key, reverse=True)


def laboratory(given: Laboratory, offers: Mapping[str, Offer]) -> Laboratory:
    """The laboratory that simulates the menu as `given` simulates the runs."""
    step = given.system.step
    conditions = [
        Condition(kind, o.parameters, (), np.asarray(np.arange(math.ceil(o.seconds / step) + 1) * step, dtype=np.float64), system=o.system)
        for kind, o in offers.items()
    ]
    return replace(given, conditions=conditions)
