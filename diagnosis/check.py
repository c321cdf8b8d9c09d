"""What runs can show, before they are diagnosed: effect by effect the smallest visible size, what passes for it, and what would help.

The sensitivities are those that a diagnosis begins with; nothing is fitted. What would help is looked for where an effect does not show
at its usual size, or where another can stand for it:

- repeats: noise falls with their number, tolerances do not;
- channels: outputs of the systems that are not measured, taken to be as noisy, for their range, as the measured ones are (median);
- runs: the kinds of runs that the next one is designed from, as they begin, by themselves.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from robomill.diagnosis.candidates import Address, Candidate
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.design import Design, Kind
from robomill.diagnosis.experiment.measured import is_driven
from robomill.diagnosis.experiment.preparation import Prepared, prepared
from robomill.diagnosis.experiment.simulation import Laboratory, Report, Simulator
from robomill.diagnosis.experiment.store import Store
from robomill.diagnosis.gate import phases
from robomill.diagnosis.inference.evidence import DEPENDENCE, Evidence, dependence
from robomill.diagnosis.inference.isolability import CONFUSABLE
from robomill.diagnosis.inference.sensitivities import Sensitivities, changed
from robomill.diagnosis.inference.visibility import SHOWS, Seen, Sight, settled
from robomill.diagnosis.outcome.answer import Effort, effort_of
from robomill.diagnosis.outcome.next_run import laboratory as laboratory_of
from robomill.orchestration.assembly import Resolver, run
from robomill.orchestration.slaves.protocol import FloatArray, base_name
from robomill.orchestration.system.parameters import Convert, same_unit_only

CHECK_SCHEMA = "robomill-check/1"


@dataclass(frozen=True)
class Help:
    """An array that is not measured, or a kind of run as it begins."""

    name: str
    """Array that is not measured, or kind of run."""
    distance: float
    """Deviations of noise between the effect, at the size that is looked at, and what it is nearest to."""
    minutes: float = 0.0
    """What a run takes; 0 for an array."""


@dataclass(frozen=True)
class Shown:
    """What the runs show of a parameter of an effect."""

    effect: str
    """Name in the catalogue."""
    component: str
    """Component that has the effect."""
    location: str
    """Where in the component."""
    parameter: str
    """Parameter of the component."""
    unit: str
    """Unit of the sizes."""
    smallest: float
    """Smallest visible value [unit]; infinite where it does not show."""
    usual: float
    """Prior scale of the catalogue [unit]."""
    largest: float
    """Bound of the catalogue [unit]."""
    by_tolerance: float
    """Part of the variance behind `smallest` that is tolerances, 0..1: what repeats do not take away."""
    state: str
    """`shows` at its usual size, only `if large`, or `not` at any size of the catalogue."""
    confusable_with: list[str]
    """Names of effects that can stand for it at its usual size (its smallest visible one where that is larger), nearest first."""
    repeats: int | None
    """Repeats of each condition with which the usual size shows, if nothing else changes; None: no number of them is enough."""
    channels: list[Help]
    """Arrays that would show it if they were measured, or tell it apart; the best first."""
    runs: list[Help]
    """Kinds of runs that would; the best by the squared distance per minute first."""


@dataclass(frozen=True)
class Checked:
    """What the runs can show."""

    conditions: dict[str, int]
    """Diagnosed condition -> its repeats."""
    noise_is_a_guess: bool
    """Whether nothing was repeated, of held-out runs either."""
    channels: tuple[str, ...]
    """Arrays that some effect changes."""
    silent: tuple[str, ...]
    """Arrays that are measured and that no effect of the catalogue changes."""
    effects: tuple[Shown, ...]
    """In the order of the catalogue."""
    nothing: tuple[str, ...]
    """Effects of the catalogue that change no measured channel at all."""
    sets: tuple[tuple[str, ...], ...]
    """Names of effects that these runs cannot split, largest set first."""
    missing: tuple[str, ...]
    """What is missing, in words."""
    skipped: tuple[str, ...]
    """What of the catalogue the systems do not have, in words."""
    effort: Effort
    """What it took."""

    @property
    def result(self) -> dict[str, Any]:
        """What `--json` prints."""
        return {"schema": CHECK_SCHEMA, **asdict(self)}


def check(
    campaign: Campaign,
    catalogue: Catalogue,
    *,
    resolver: Resolver | None = None,
    convert: Convert = same_unit_only,
    workers: int = 1,
    report: Report | None = None,
    store: Store | None = None,
    kinds: Sequence[Kind] = (),
) -> Checked:
    """What the runs of a campaign can show; DataError where they do not fit their systems. `kinds`: runs that could be made."""
    began = time.monotonic()
    start = prepared(campaign, catalogue, resolver, convert)
    laboratory, n = start.laboratory, start.n
    phases.aligned(laboratory, start.catalogue.candidates, n)
    groups = laboratory.measured()[:n]
    with Simulator(laboratory, workers, report, store) as simulator:
        found = Sensitivities(start.catalogue, simulator, groups, start.nuisances)
        seen = Seen(found.evidence, found.candidates)
        sizes = settled(found.evidence, simulator, seen)
        sights = [seen.sight(c, sizes.get(c)) for c in found.candidates]
        wanting = [s for s in sights if _state(s) != "shows" or s.alike]
        with _wider(laboratory, n, simulator) as wide:
            channels = _channels(start, found.evidence, wide, wanting, groups)
        runs, more = _runs(kinds, found.evidence, simulator, wanting)
        effort = effort_of(began, simulator)
        repeats = {laboratory.conditions[i].name: len(g) for i, g in enumerate(groups)}
        effects = tuple(
            s
            for sight in sights
            for s in _shown(sight, min(repeats.values()), channels.get(sight.candidate, []), runs.get(sight.candidate, []))
        )
        here = {c.name for c in found.candidates}
        active = [c for c, on in zip(laboratory.channels, found.evidence.active, strict=True) if on]
        silent = [c for c, on in zip(laboratory.channels, found.evidence.active, strict=True) if not on]
        return Checked(
            repeats,
            found.evidence.whitening.guessed,
            tuple(dict.fromkeys(map(base_name, active))),
            tuple(dict.fromkeys(b for b in map(base_name, silent) if b not in set(map(base_name, active)))),
            effects,
            tuple(c.name for c in start.catalogue.candidates if c.name not in here),
            _sets(sights),
            tuple(_missing(laboratory, repeats, found.evidence, effects)),
            start.skipped,
            replace(
                effort,
                simulations=effort.simulations + wide.count + more.simulations,
                taken_over=effort.taken_over + wide.found + more.taken_over,
            ),
        )


def _state(sight: Sight) -> str:
    least = min(sight.smallest.values())
    return "shows" if least <= sight.candidate.prior.scale else "if large" if sight.visible else "not"


def _shown(sight: Sight, repeats: int, channels: list[Help], runs: list[Help]) -> list[Shown]:
    c, fixed = sight.candidate, sight.by_tolerance
    listed = []
    for name, smallest in sight.smallest.items():
        variance = smallest**2 if math.isfinite(smallest) else math.inf
        left = c.prior.scale**2 - fixed * variance
        needed = math.ceil(repeats * (1.0 - fixed) * variance / left) if left > 0.0 and math.isfinite(variance) else None
        alike = [d.name for d in sight.alike]
        state = _state(sight)
        listed.append(
            Shown(
                c.effect,
                c.component,
                c.location,
                name,
                c.unit,
                smallest,
                c.prior.scale,
                c.maximum,
                fixed,
                state,
                alike,
                needed,
                channels,
                runs,
            )
        )
    return listed


def _sets(sights: Sequence[Sight]) -> tuple[tuple[str, ...], ...]:
    """Sets all of whose members can stand for each other, one way or the other: grown from the nearest pairs, none within another."""
    near: dict[frozenset[Candidate], float] = {}
    for s in sights:
        for d, (distance, _) in s.alike.items():
            key = frozenset((s.candidate, d))
            near[key] = min(distance, near.get(key, math.inf))
    sets: list[frozenset[Candidate]] = []
    for pair in sorted(near, key=lambda p: (near[p], sorted(c.name for c in p))):
        if any(pair <= s for s in sets):
            continue
        grown = pair
        for c in dict.fromkeys(s.candidate for s in sights):
            if c not in grown and all(frozenset((c, m)) in near for m in grown):
                grown |= {c}
        sets.append(grown)
    return tuple(sorted((tuple(sorted(c.name for c in s)) for s in sets), key=lambda names: (-len(names), names)))


def _missing(laboratory: Laboratory, repeats: Mapping[str, int], evidence: Evidence, effects: Sequence[Shown]) -> list[str]:
    """What is missing, in words."""
    out = []
    if evidence.whitening.guessed and any(is_driven(c.system or laboratory.system) for c in laboratory.conditions):
        out.append("repeats: each run is driven by what was measured in it and has none, so the noise is a guess, and so is every size")
    elif evidence.whitening.guessed:
        out.append("repeats: nothing was repeated, so the noise is a guess, and so is every size; make each run at least three times")
    elif single := [name for name, n in repeats.items() if n == 1]:
        out.append(f"repeats: {', '.join(single)} was made once; its noise is taken from the other conditions")
    hidden = list(dict.fromkeys((e.effect, e.location) for e in effects if e.state != "shows"))
    helped = {(e.effect, e.location) for e in effects if e.state != "shows" and e.repeats is not None}
    if hidden:
        more = max((e.repeats for e in effects if e.state != "shows" and e.repeats is not None), default=0)
        few = f"; {len(helped)} of them would show with {'up to ' * (len(helped) > 1)}{more} repeats of each condition" if helped else ""
        out.append(f"excitation: {len(hidden)} of {len({(e.effect, e.location) for e in effects})} do not show at their usual size{few}")
    for what, first in (("channels", [e.channels[:1] for e in effects]), ("runs", [e.runs[:1] for e in effects])):
        counts = Counter(h.name for helps in first for h in helps)
        if counts:
            best = sorted(counts.items(), key=lambda item: (-item[1], item[0]))[:3]
            out.append(f"{what}: {', '.join(f'{name} would show or split {n}' for name, n in best)}")
    return out


def _wider(laboratory: Laboratory, n: int, simulator: Simulator) -> Simulator:
    """Simulator of the diagnosed conditions with all real outputs of their systems as channels."""
    outputs: dict[str, None] = {}
    conditions = [replace(c, channels=None) for c in laboratory.conditions[:n]]
    for i, c in enumerate(conditions):
        step = (c.system or laboratory.system).step
        simulated = run(laboratory.configured(i), None, stop=2 * step, resolver=laboratory.resolver, convert=laboratory.convert)
        outputs |= {name: None for name, p in simulated.ports.items() if p.type == "real"}
    return simulator.beside(replace(laboratory, conditions=conditions, channels=list(outputs)))


def _channels(
    start: Prepared, evidence: Evidence, wide: Simulator, wanting: Sequence[Sight], groups: Sequence[Sequence[FloatArray]]
) -> dict[Candidate, list[Help]]:
    """Arrays that are not measured and that would show a candidate at the size that is looked at, or tell it from all that are like it."""
    laboratory = wide.laboratory
    others = [k for k, c in enumerate(laboratory.channels) if c not in start.laboratory.channels]
    scales: dict[Address, float] = {}
    for s in wanting:
        for c in (s.candidate, *s.alike):
            scales |= dict.fromkeys(c.addresses, c.prior.scale)
    if not others or not scales:
        return {}
    conditions = range(len(groups))
    nominals = [b for b in wide.repeated(conditions, (), 1, "other channels") if b is not None]
    changes = changed(wide, conditions, scales, nominals, "other channels")
    named = [base_name(laboratory.channels[k]) for k in others]
    arrays = {a: [k for k, b in zip(others, named, strict=True) if b == a] for a in dict.fromkeys(named)}
    noise = _usual_noise(start, evidence, groups)
    found: dict[Candidate, list[Help]] = {}
    for s in wanting:
        helps = []
        for array, members in arrays.items():
            extent = max(float(np.ptp(b[0][:, members], axis=0).max()) for b in nominals)
            if extent > 0.0:
                weights = [
                    math.sqrt(len(g) / dependence(apart)) / (noise * extent) for g, apart in zip(groups, evidence.independent, strict=True)
                ]
                helps.append(Help(array, _apart(s, changes, members, weights)))
        found[s.candidate] = sorted((h for h in helps if h.distance >= _limit(s)), key=lambda h: -h.distance)[:3]
    return found


def _runs(
    kinds: Sequence[Kind], evidence: Evidence, simulator: Simulator, wanting: Sequence[Sight]
) -> tuple[dict[Candidate, list[Help]], Effort]:
    """Kinds of runs that would show a candidate at the size that is looked at, or tell it from all that are like it; and what that took."""
    scales = {a: c.prior.scale for s in wanting for c in (s.candidate, *s.alike) for a in c.addresses}
    if not kinds or not scales:
        return {}, Effort()
    offers = [Design(k, tuple(q.start for q in k.quantities)).offer() for k in kinds]
    with simulator.beside(laboratory_of(simulator.laboratory, offers)) as beside:
        every = range(len(kinds))
        nominals = [b for b in beside.repeated(every, (), 1, "other runs") if b is not None]
        changes = changed(beside, every, scales, nominals, "other runs")
    apply, active = evidence.whitening.apply, evidence.active
    white = {
        a: [apply(c[:, active], k.repeats / DEPENDENCE).reshape(-1, 1) for c, k in zip(change, kinds, strict=True)]
        for a, change in changes.items()
    }
    found: dict[Candidate, list[Help]] = {}
    for s in wanting:
        helps = [Help(k.name, _apart(s, white, [0], [float(i == j) for j in every]), k.minutes) for i, k in enumerate(kinds)]
        found[s.candidate] = sorted((h for h in helps if h.distance >= _limit(s)), key=lambda h: -(h.distance**2) / h.minutes)[:3]
    return found, Effort(0.0, beside.count, beside.found)


def _limit(sight: Sight) -> float:
    """Distance from which it is shown, or told apart."""
    return SHOWS if _state(sight) != "shows" else CONFUSABLE


def _apart(sight: Sight, changes: Mapping[Address, list[FloatArray]], members: Sequence[int], weights: Sequence[float]) -> float:
    """Distance in these channels between a candidate and the nearest of those like it (the nominal system, where it does not show)."""

    def change(c: Candidate, x: Sequence[float]) -> list[FloatArray]:
        zero = [np.zeros((0, 1))] * len(weights)
        parts = [changes.get(a, zero) for a in c.addresses]
        return [
            np.asarray(sum(v * p[i][:, members] for v, p in zip(x, parts, strict=True) if len(p[i])) + np.zeros((1, len(members))))
            for i in range(len(weights))
        ]

    own = change(sight.candidate, [sight.looked_at, *([0.0] * (len(sight.candidate.parameters) - 1))])
    rivals = [change(d, [float(v) for v in x]) for d, (_, x) in sight.alike.items()]
    if _state(sight) != "shows":
        rivals.append([np.zeros((1, len(members)))] * len(weights))
    squares = [sum(w * w * float(((a - b) ** 2).sum()) for w, a, b in zip(weights, own, r, strict=True)) for r in rivals]
    return math.sqrt(min(squares))


def _usual_noise(start: Prepared, evidence: Evidence, groups: Sequence[Sequence[FloatArray]]) -> float:
    """Noise of a measured channel over its range, median [1]."""
    extent = np.max([np.ptp(np.mean(g, axis=0), axis=0) for g in groups], axis=0)[evidence.active]
    own = np.sqrt((evidence.whitening.factor**2).sum(axis=1))
    return float(np.median(own[extent > 0.0] / extent[extent > 0.0]))
