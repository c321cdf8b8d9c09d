"""The run that tells apart what the given ones cannot, designed: kinds of runs with parameters, simulated with each of the rival models.

The whitened distance d between two models in a run is that of their simulations, in the noise of the given repeats. Calibrated
numbers and fitted values are not exactly known; what they do along the difference u = d / |d| counts as noise too, so the variance
along u is mean (u . r)^2 + mean (u . n)^2 + (relative deviation of the values)^2 (u . s)^2 with r the deviations of the given repeats,
n the change that random draws of the nuisances make, and s the signature itself. This is the variance of a matched filter, so the
distance is a lower bound of what is possible.

A run is worth the expected Chernoff information of the pairs, mean d^2 / 8 [nats] over the posterior (Chernoff 1959, sequential design:
the log of the probability of a wrong decision falls by that much with each run), per minute.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations, repeat

import numpy as np

from robomill.diagnosis.candidates import physical
from robomill.diagnosis.experiment.design import SEARCHED, Design, Kind, Offer, searched
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import DRAWS, Laboratory, Setting, Simulator, setting
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.isolability import CONFUSABLE, distance
from robomill.diagnosis.inference.search import Search
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.slaves.protocol import FloatArray

ENOUGH = 2.0 * CONFUSABLE
"""Distance [deviations of noise] from which more does not count: both are clear of the decision, which is half way between them. The pair
is told apart, wrongly in 0.13 % of all cases."""
LIKELY, RIVALS = 0.05, 3
"""Probability from which a model is a rival, and how many there are at most."""


@dataclass(frozen=True)
class Value:
    """What the experimenter sets."""

    value: float
    """Value to set, in `unit`."""
    unit: str
    """Unit of the value."""


@dataclass(frozen=True)
class Alternative:
    """The best run of another kind."""

    kind: str
    """Kind of run (docs/reference/formats/next_runs.md)."""
    distance: float
    """Whitened distance of the two models that are closest in it [deviations of noise]; of those that were not looked at with the
    nuisances, without them."""
    minutes: float
    """What its repeats cost on the machine."""
    separation: float
    """Expected information [nats]."""
    per_minute: float
    """That per minute."""
    parameters: dict[str, Value]
    """What the experimenter sets, by name."""


@dataclass(frozen=True)
class NextRun:
    """The run that tells the likely models apart best; `kind` to `parameters` as in `Alternative`."""

    kind: str
    """As in `Alternative`, like all that has no meaning here."""
    separates: tuple[str, ...]
    """Names of these models."""
    separated: bool
    """Whether it tells them apart: `distance` is not below CONFUSABLE."""
    distance: float
    """Whitened distance of the two models that are closest in it [deviations of noise]."""
    now: float
    """That distance in the given runs [deviations of noise]."""
    minutes: float
    """What its repeats cost on the machine."""
    separation: float
    """Expected information [nats]."""
    per_minute: float
    """Expected information per minute."""
    repeats: int
    """Repeats to make."""
    parameters: dict[str, Value]
    """What the experimenter sets, by name."""
    models: dict[str, dict[str, dict[str, float]]]
    """Model -> component -> parameter -> value."""
    alternatives: tuple[Alternative, ...]
    """The best of the other kinds that were looked at, best first."""
    text: str
    """All that in a sentence."""


class _Trial:
    """Simulations of designs, and distances between the models in them."""

    def __init__(self, fits: Sequence[Fit], shares: Mapping[tuple[int, int], float], search: Search, simulator: Simulator) -> None:
        self.fits, self.shares, self.search, self.simulator = fits, shares, search, simulator
        self.simulated: dict[Design, list[FloatArray]] = {}
        """Channels with each of the fits, and of the nominal system."""
        self.drawn: dict[Design, list[FloatArray]] = {}
        """Channels with draws of the nuisances."""
        self.count = 0
        """Simulations that were asked for."""
        groups = search.evidence.residuals
        # n repeats about their own mean scatter by (n - 1) / n of what they do
        self.repeats = [(r - np.mean(g, axis=0)) * math.sqrt(len(g) / (len(g) - 1)) for g in groups if len(g) > 1 for r in g]
        """Whitened deviations of the given repeats, flat."""

    def worth(self, designs: Sequence[Design]) -> list[float]:
        """Expected information per minute [nats/min] of each design; -inf where it cannot be simulated."""
        self.simulated |= self._many(designs, [*(setting(f.values) for f in self.fits), ()])
        return [self.rate(d) if d in self.simulated else -math.inf for d in designs]

    def look_closer(self, design: Design) -> None:
        """Let the tolerances count in a design, too."""
        self.drawn |= self._many([design], _draws(self.search))

    def _many(self, designs: Sequence[Design], settings: Sequence[Setting]) -> dict[Design, list[FloatArray]]:
        """Channels of each design with each of these settings, without designs that cannot be made."""
        offers: dict[Design, Offer] = {}
        for d in designs:
            with suppress(ValueError, OrchestrationError):  # a pose out of reach: the planner says so
                offers[d] = d.offer()
        if not offers:
            return {}
        self.count += len(offers) * len(settings)
        results: Iterator[FloatArray | None] = repeat(None)
        with self.simulator.beside(laboratory(self.simulator.laboratory, list(offers.values()))) as simulator, suppress(OrchestrationError):
            results = iter(simulator.many([(i, simulator.seeded(s)) for i in range(len(offers)) for s in settings], "next run"))
        groups = {d: [next(results) for _ in settings] for d in offers}
        return {d: [x for x in group if x is not None] for d, group in groups.items() if all(x is not None for x in group)}

    def white(self, change: FloatArray, design: Design) -> FloatArray:
        return self.search.evidence.whitening.apply(change[:, self.search.evidence.active], design.kind.repeats)

    def distance(self, design: Design, i: int, j: int) -> float:
        """Between two of the fits; nuisances count once their simulations are there."""
        a, b = self.simulated[design][i], self.simulated[design][j]
        difference = self.white(a - b, design)
        length = float(np.linalg.norm(difference))
        if length == 0.0:
            return 0.0
        along = difference / length
        # the repeats say what noise does along it, slow noise too, for which whitening is not made
        rest = [float(along @ np.resize(r, along.size)) ** 2 for r in self.repeats]
        variance = max(1.0, float(np.mean(rest)) if rest else 1.0)
        nominal = self.simulated[design][-1]
        for k, x in ((i, a), (j, b)):
            variance += (_uncertainty(self.fits[k]) * float(along @ self.white(x - nominal, design))) ** 2
        variance += sum(float(along @ self.white(x - nominal, design)) ** 2 for x in self.drawn.get(design, ())) / DRAWS
        return length / math.sqrt(variance)

    def distances(self, design: Design) -> dict[tuple[int, int], float]:
        """Separation of all pairs of fits."""
        return {p: self.distance(design, *p) for p in self.shares}

    def separation(self, design: Design) -> float:
        """Expected information [nats]."""
        return sum(self.shares[p] * _information(d) for p, d in self.distances(design).items())

    def least(self, design: Design) -> float:
        """Distance of the closest pair."""
        return min(self.distances(design).values())

    def rate(self, design: Design) -> float:
        """Expected information per minute [nats/min]."""
        return self.separation(design) / design.kind.minutes

    def key(self, design: Design) -> tuple[bool, float]:
        """The better, the larger: what separates all pairs before what does not, then by information per minute."""
        return self.least(design) >= CONFUSABLE, self.rate(design)


def _information(distance: float) -> float:
    """Chernoff information [nats] of two normal distributions so many deviations apart, up to ENOUGH."""
    return min(distance, ENOUGH) ** 2 / 8.0


def _draws(search: Search) -> list[Setting]:
    """Random machines within the tolerances of the calibrated numbers."""
    random = np.random.default_rng(0)
    return [setting({n.address: n.scale * float(random.standard_normal()) for n in search.nuisances}) for _ in range(DRAWS)]


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


def recommend(fits: Sequence[Fit], weights: Sequence[float], kinds: Sequence[Kind], search: Search, simulator: Simulator) -> NextRun | None:
    """The run that tells models of these weights apart best, of SEARCHED simulations; None where no kind can be simulated."""
    space = search.evidence.space
    now = {(i, j): distance(fits[i], fits[j], space) for i, j in combinations(range(len(fits)), 2)}
    together = {(i, j): weights[i] * weights[j] for i, j in now}
    shares = {p: w / sum(together.values()) for p, w in together.items()}
    trial = _Trial(fits, shares, search, simulator)
    # two designs are looked at with the nuisances, too
    searched(kinds, trial.worth, lambda k: _information(ENOUGH) / k.minutes, (SEARCHED - 2 * DRAWS) // (len(fits) + 1))
    if not trial.simulated:
        return None
    while trial.simulated and trial.count + DRAWS <= SEARCHED:
        best = max(trial.simulated, key=trial.key)
        if best in trial.drawn:
            break
        trial.look_closer(best)
        if best not in trial.drawn:
            del trial.simulated[best]
    if not trial.simulated:
        return None
    best = max(trial.drawn or trial.simulated, key=trial.key)
    others: dict[str, Design] = {}
    for d in sorted(trial.simulated, key=trial.key, reverse=True):
        if d.kind.name != best.kind.name:
            others.setdefault(d.kind.name, d)
    names = tuple(_name(f) for f in fits)
    least, settings = trial.least(best), _set(best)
    return NextRun(
        best.kind.name,
        names,
        least >= CONFUSABLE,
        least,
        min(now.values()),
        best.kind.minutes,
        trial.separation(best),
        trial.rate(best),
        best.kind.repeats,
        settings,
        {_name(f): _table(f) for f in fits},
        tuple(
            Alternative(d.kind.name, trial.least(d), d.kind.minutes, trial.separation(d), trial.rate(d), _set(d)) for d in others.values()
        ),
        _said(best, settings, names, least, min(now.values())),
    )


def _set(design: Design) -> dict[str, Value]:
    return {q.name: Value(v, q.unit) for q, v in zip(design.kind.quantities, design.values, strict=True)}


def _said(design: Design, settings: Mapping[str, Value], names: Sequence[str], least: float, now: float) -> str:
    """The run in a sentence."""
    values = ", ".join(f"{n} {v.value:.4g}{'' if v.unit == '1' else f' {v.unit}'}" for n, v in settings.items())
    run = f"{design.kind.name}{f' ({values})' if values else ''}"
    apart = f"{least:.1f} deviations apart instead of {now:.1f}"
    if least < CONFUSABLE:
        return f"none that was looked at separates {', '.join(names)}; the nearest is {run}: {apart}"
    return f"{run}, {design.kind.minutes:g} min, to separate {', '.join(names)}: {apart}"


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


def laboratory(given: Laboratory, offers: Sequence[Offer]) -> Laboratory:
    """The laboratory that simulates these runs as `given` simulates its own, a condition for each."""
    conditions = []
    for i, o in enumerate(offers):
        grid = np.asarray(np.arange(math.ceil(o.seconds / o.system.step) + 1) * o.system.step, dtype=np.float64)
        conditions.append(Condition(f"next {i + 1}", o.parameters, (), grid, system=o.system))
    return replace(given, conditions=conditions)
