"""What each candidate does by itself: simulated at its prior scale, and at other sizes where that does not say enough.

The sensitivity of a parameter is ds/dx, s the whitened change of all channels and conditions [n], x its value / prior scale: by one
difference, s(x) / x at x = 1, or at another size x where that fits better.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.candidates import LOGGING, Address, Candidate, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.simulation import FINER, Simulator, setting
from robomill.diagnosis.inference.estimation import Space
from robomill.diagnosis.inference.evidence import Evidence, gather
from robomill.diagnosis.inference.isolability import CONFUSABLE
from robomill.orchestration.slaves.protocol import FloatArray

BENT = 0.9
"""Cosine of the sensitivities at two sizes below which an effect is not taken as proportional to its size."""
TURNED = 0.7
"""Cosine below which many sizes are tried."""
SMALLER, NOTED = 0.2, 8.0
"""Part of its prior scale below which an effect that seems to explain this much [nats] is tried at sizes in between, too."""
WORTH = 0.2
"""Part of the best candidate's gain (as sensitivities have it), or of what is left without the tolerances like it, from which a candidate
is looked at on more simulations."""
LARGE, LOST = 10.0, 0.5
"""chi2 over that of noise, and the part of it that the best candidate leaves, from which effects that turn are tried at EVENLY sizes."""
EVENLY = 64
"""Sizes up to the largest one: in a loop that begins to swing, a delay must be right to a part of the period."""
OCTANTS = 8
"""Parts of a turn: phases that are tried of an effect that is no sum of two parts; starts whose mean has no harmonic below the eighth."""
NOMINAL = 8
"""Simulations of the nominal system with different noise, of each condition."""
TOLERANCES = 3.0
"""Standard deviations of a calibrated number that its sensitivity is simulated at."""


@dataclass(frozen=True)
class Start:
    """A size from which an effect is fitted."""

    x: float
    """Value / prior scale."""
    signature: FloatArray
    """s(x), [n]."""
    sensitivity: FloatArray
    """ds/dx there, [n]: by the difference to the better one of the neighbouring sizes."""


class Sensitivities:
    """Evidence with the sensitivity of every parameter, the candidates that change anything, and where their fits start.

    What is not proportional to its size has a sensitivity from another size, or an entry in `starts` (parameter -> Start).
    """

    def __init__(
        self,
        catalogue: Catalogue,
        simulator: Simulator,
        groups: Sequence[Sequence[FloatArray]],
        nuisances: Sequence[Nuisance],
        left: Sequence[Sequence[FloatArray]] = (),
        dispersion: float = 1.0,
    ) -> None:
        """`groups`: measured repeats [samples, channels] of each of the first conditions of the simulator's laboratory.

        `left`: what a model leaves of them, from which noise is guessed where nothing was repeated; `dispersion`: see `Evidence`.
        """
        self.simulator, self.conditions = simulator, range(len(groups))
        self.scales = {a: c.prior.scale for c in catalogue.candidates for a in c.addresses}
        nominals = [b for b in simulator.repeated(self.conditions, (), NOMINAL, "nominal") if b is not None]
        unknown, doubts = {n.address: n.scale for n in nuisances}, {n.address: n.doubt for n in nuisances}
        sizes = {**{a: TOLERANCES * s for a, s in unknown.items()}, **self.scales}
        changes = changed(simulator, self.conditions, sizes, nominals)
        # a limit does nothing until it is reached
        single = {c.addresses[0]: c for c in catalogue.candidates if len(c.parameters) == 1}
        largest = {a: c.maximum for a, c in single.items() if a not in changes}
        changes |= changed(simulator, self.conditions, largest, nominals)
        sizes |= {a: s for a, s in largest.items() if a in changes}
        names = [simulator.laboratory.conditions[i].name for i in self.conditions]
        clocks = [c for c in catalogue.candidates if c.unit == "s" and (c.component != LOGGING or c.parameters[0].startswith("lag "))]
        beyond = interplay(simulator, self.conditions, unknown, sizes, changes, nominals)
        self.evidence = gather(
            simulator.laboratory,
            names,
            groups,
            nominals,
            changes,
            sizes,
            self.scales,
            unknown,
            clocks,
            left,
            doubts=doubts,
            beyond=beyond,
            dispersion=dispersion,
        )
        self.bent: set[str] = set()
        """Candidates that are not proportional to their size, as far as these runs show."""
        candidates = self._amplitudes(catalogue.candidates)
        self.single = {c.addresses[0]: c for c in candidates if len(c.parameters) == 1 and c.addresses[0] in self.evidence.sensitivities}
        self.starts: dict[Address, Start] = {}
        self.sizes = dict.fromkeys(self.evidence.sensitivities, 1.0)
        """parameter -> size that its sensitivity is from [prior scales]."""
        self._try_other_sizes()
        self.candidates = [c for c in candidates if all(a in self.evidence.sensitivities for a in c.addresses)]
        self._try_variants()

    def _amplitudes(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """The candidates; of one that is no sum of its parts the amplitude, and variants for its phase.

        Samples may be means over whole turns. What turns once with the phase is gone from them; the rest goes around three times, or stays.
        A sum is refused where it is worse than nothing for what the effect does at half, three quarters and an eighth of a turn.
        """
        known, space, n = self.evidence.sensitivities, self.evidence.space, len(self.conditions)
        parts = [c for c in candidates if c.has_phase and all(a in known for a in c.addresses)]
        turned = [(-1.0, 0.0), (0.0, -1.0), (math.sqrt(0.5), math.sqrt(0.5))]
        settings = [setting({a: x * self.scales[a] for a, x in zip(c.addresses, xs, strict=True)}) for c in parts for xs in turned]
        results = self.simulator.many([(i, self.simulator.seeded(s)) for s in settings for i in self.conditions], "phases")
        does = [self.evidence.signature(results[k * n : (k + 1) * n]) for k in range(len(settings))]
        amplitudes = {}
        for k, c in enumerate(parts):
            columns = np.stack([known[a] for a in c.addresses])
            done = [(d, np.array(xs) @ columns) for d, xs in zip(does[len(turned) * k :], turned, strict=False) if d is not None]
            if done and sum(space.square(d - s) - space.square(d) for d, s in done) > 0.0:
                amplitude = c.with_phases(OCTANTS)
                (address,) = amplitude.addresses
                known[address], self.scales[address] = columns[0], c.prior.scale
                self.bent.add(c.name)
                amplitudes[c] = amplitude
        return [amplitudes.get(c, c) for c in candidates]

    def _try_variants(self) -> None:
        """Put the variants of candidates that can be seen beside them: those that these runs tell from each other.

        Variants that do the same count as one, so that they take no prior from each other.
        """
        sizes: dict[Address, list[float]] = {}
        for c in self.candidates:
            if c.variants and self._visible(c):
                start = self.starts.get(c.addresses[0])
                for v in c.variants:
                    for known, a in zip(c.addresses, v.addresses, strict=True):
                        self.scales[a] = c.prior.scale
                        # what turns with its size does so in all variants: they are looked at about the size that fits best
                        at = [self.sizes[known]] if start is None else [start.x * math.exp(0.25 * k) for k in (0, -1, 1)]
                        sizes[a] = [at[0], *(x for x in at[1:] if c.minimum <= abs(x) * c.prior.scale <= c.maximum)]
        tried = self._signatures(sizes)
        found: list[Candidate] = []
        for c in self.candidates:
            kept = self._told(c, {v: [(a, sizes[a][0]) for a in v.addresses if a in sizes] for v in c.variants}, tried)
            for a in (a for v in kept for a in v.addresses):
                self._take([(x, tried[a, x]) for x in sizes[a] if (a, x) in tried], a)
            found += [replace(v, locations=c.locations * (1 + len(kept))) for v in (c, *kept)]
        self.candidates = found
        new = {a: per_scale(self.evidence, self.starts, a) for c in found if c.fixed for a in c.addresses}
        self.evidence.space.find_alike(new, self.scales)

    def _visible(self, candidate: Candidate) -> bool:
        """Whether a candidate can explain NOTED nats at its largest; if it has a start, whether that is WORTH a part of the best one's."""
        space, a = self.evidence.space, candidate.addresses[0]
        if a in self.starts:
            return space.chi2 - self._chi2(a, space.chi2) > WORTH * (space.chi2 - self._least())
        largest = candidate.bounds[1] / candidate.prior.scale
        own = space.without(candidate.addresses)
        does = np.stack([per_scale(self.evidence, self.starts, b) for b in candidate.addresses]).T
        return bool(0.5 * largest**2 * own.chi2_of(does).max() > NOTED)

    def _told(
        self, c: Candidate, at: Mapping[Candidate, Sequence[tuple[Address, float]]], tried: Mapping[tuple[Address, float], FloatArray]
    ) -> list[Candidate]:
        """The variants of a candidate that these runs tell from it and from each other; `at`: where each was `tried`, if it was."""
        shown = {v: [tried[key] / key[1] for key in keys] for v, keys in at.items() if keys and all(key in tried for key in keys)}
        if not shown:
            return []
        columns = [per_scale(self.evidence, self.starts, a) for a in c.addresses]
        places = [range(len(columns))]
        kept: list[Candidate] = []
        for does in shown.values():
            places.append(range(len(columns), len(columns) + len(does)))
            columns += does
        own = self.evidence.space.without(c.addresses)
        products = own.within(own.gram(np.stack(columns).T), range(len(columns)))
        told = places[:1]
        for v, here in zip(shown, places[1:], strict=True):
            if all(_apart(products, here, there, at[v][0][1]) > CONFUSABLE for there in told):
                told.append(here)
                kept.append(v)
        return kept

    def _take(self, found: Sequence[tuple[float, FloatArray]], address: Address) -> None:
        """The sensitivity of a variant from its signatures at sizes [prior scales], and its start where there are several."""
        x, signature = found[0]
        self.evidence.sensitivities[address], self.sizes[address] = signature / x, x
        if len(found) > 1:
            self._start(address, sorted(found, key=lambda pair: pair[0]), self.evidence.space.chi2)

    def _try_other_sizes(self) -> None:
        """Sensitivities from a smaller size, where one fits better; starts from the best of many sizes for effects that turn with theirs.

        A delay of 50 ms does not look like one of 25 ms, twice.
        """
        sensitivities, space, single, phases = self.evidence.sensitivities, self.evidence.space, self.single, set(self.bent)
        smaller = {a: _smaller(c) for a, c in single.items()}
        # the first place of an effect tells for the others whether they are to be tried, too; in a log each device has signals of its own
        places: dict[str, list[Address]] = {}
        for a, c in single.items():
            places.setdefault(c.name if c.component == LOGGING else c.effect, []).append(a)
        first = {a: p[0] for p in places.values() for a in p}
        other: dict[Address, FloatArray] = {}
        for some in ([p[0] for p in places.values()], [a for p in places.values() for a in p[1:]]):
            wanted = [a for a in some if _bends(first[a], other, sensitivities)]
            tried = self._signatures({a: [smaller[a]] for a in wanted})
            other |= {a: tried[a, smaller[a]] / smaller[a] for a in wanted if (a, smaller[a]) in tried}
        alike = {a: cosine(sensitivity, sensitivities[a]) for a, sensitivity in other.items()}
        gram = space.gram(np.stack([s for a in other for s in (sensitivities[a], other[a])]).T) if other else None
        for k, (a, same) in enumerate(alike.items()):
            assert gram is not None
            if _apart(space.without([a]).within(gram, [2 * k, 2 * k + 1]), [1], [0], 1.0) > CONFUSABLE:
                self.bent.add(single[a].name)
            if same < BENT:
                self._take_if_better(a, other[a], smaller[a])
        turned = [a for a, same in alike.items() if same < TURNED or single[a].name in phases]
        sizes = {**self._much_smaller(), **{a: _sizes(single[a]) for a in turned}}
        # which nuisances these are like at one size says nothing of another
        space.find_alike({a: np.zeros_like(sensitivities[a]) for a in sizes}, self.scales)
        self._start_from(sizes)
        if space.chi2 > LARGE * float(self.evidence.expected.sum()) and self._least() > LOST * space.chi2:
            self._start_from({a: _evenly(single[a]) for a in turned})
        space.find_alike({a: self.starts[a].sensitivity if a in self.starts else sensitivities[a] for a in {**alike, **sizes}}, self.scales)

    def _start_from(self, sizes: Mapping[Address, Sequence[float]]) -> None:
        """The best of these sizes [prior scales], and between the last that does nothing and the next one."""
        tried = self._signatures(sizes)
        tried |= self._signatures({a: _where_it_begins([(x, tried[a, x]) for x in xs if (a, x) in tried]) for a, xs in sizes.items()})
        for a in sizes:
            found = sorted(((x, signature) for (b, x), signature in tried.items() if b == a), key=lambda pair: pair[0])
            if len(found) > 1:
                self._start(a, found, self._chi2(a, self.evidence.space.chi2))

    def _start(self, address: Address, found: Sequence[tuple[float, FloatArray]], known: float) -> None:
        """Let a fit start from the best of these sizes [prior scales], in order, with their signatures, if chi2 there is below `known`."""
        own = self.evidence.space.without([address])
        chi2 = own.chi2_of(own.y[:, None] - np.stack([f for _, f in found]).T)
        i = int(np.argmin(chi2))
        _, j = min((chi2[k], k) for k in (i - 1, i + 1) if 0 <= k < len(found))
        (x, signature), (near, neighbour) = found[i], found[j]
        if chi2[i] < known:
            self.starts[address] = Start(x, signature, (signature - neighbour) / (x - near))

    def _chi2(self, address: Address, otherwise: float) -> float:
        """chi2 that is left where the fit of an effect starts; `otherwise` where it has no start."""
        start, own = self.starts.get(address), self.evidence.space.without([address])
        return otherwise if start is None else own.square(own.y - start.signature)

    def _least(self) -> float:
        """chi2 that the best candidate leaves, by sensitivities or where its fit starts."""
        left = [self.evidence.space.chi2]
        for a, c in self.single.items():
            own = self.evidence.space.without([a])
            left.append(self._chi2(a, own.chi2 - gain(own, self.evidence.sensitivities[a], c)))
        return min(left)

    def _much_smaller(self) -> dict[Address, list[float]]:
        """Sizes between where an effect fits and where it was simulated, if these are far apart: large, it may hide how it begins."""
        found, gains, space = {}, {}, self.evidence.space
        known = space.gram(np.stack([space.y, *(self.evidence.sensitivities[a] for a in self.single)]).T)
        for k, (a, c) in enumerate(self.single.items(), 1):
            own = space.without([a])
            product, square = own.within(known, [0, k])[1]
            x = product / (square + 1e-300)
            gains[a] = space.chi2 - own.chi2 + _taken(product, square, c)
            if abs(x) < SMALLER and 0.5 * gains[a] > NOTED:
                found[a] = [x * 1.6**k for k in range(math.ceil(math.log(SMALLER / abs(x), 1.6)) + 1)]
        best = max(gains.values(), default=0.0)
        return {a: sizes for a, sizes in found.items() if gains[a] > WORTH * best}

    def _take_if_better(self, address: Address, sensitivity: FloatArray, size: float) -> None:
        """Put another sensitivity, from another size [prior scales], in place of the known one, if it takes away more of chi2."""
        own, known = self.evidence.space.without([address]), self.evidence.sensitivities[address]
        if gain(own, sensitivity, self.single[address]) > gain(own, known, self.single[address]):
            self.evidence.sensitivities[address], self.sizes[address] = sensitivity, size

    def _signatures(self, sizes: Mapping[Address, Sequence[float]]) -> dict[tuple[Address, float], FloatArray]:
        """Signatures at sizes [prior scales]: (address, size) -> whitened change; without those that cannot run."""
        n = len(self.conditions)
        keys = [(a, x) for a, xs in sizes.items() for x in xs]
        tasks = [(i, self.simulator.seeded(setting({a: x * self.scales[a]}))) for a, x in keys for i in self.conditions]
        results = self.simulator.many(tasks, "effects at other sizes")
        found = {key: self.evidence.signature(results[k * n : (k + 1) * n]) for k, key in enumerate(keys)}
        return {key: signature for key, signature in found.items() if signature is not None}


def _apart(products: FloatArray, one: Sequence[int], other: Sequence[int], size: float) -> float:
    """Distance [deviations of noise] of what one variant does at a size [prior scales] from what another one does at its best size.

    `products` of what both do per prior scale; `one`, `other`: places of their parameters there. Of an amplitude with a phase that of the
    part that is farther away.
    """
    cross = products[np.ix_(other, one)]
    left = np.diag(products[np.ix_(one, one)] - cross.T @ np.linalg.pinv(products[np.ix_(other, other)]) @ cross)
    return abs(size) * math.sqrt(max(float(left.max()), 0.0))


def per_scale(evidence: Evidence, starts: Mapping[Address, Start], address: Address) -> FloatArray:
    """What a parameter does per prior scale, [n]: where its fit starts, or by its sensitivity."""
    start = starts.get(address)
    return evidence.sensitivities[address] if start is None else start.signature / start.x


def changed(
    simulator: Simulator,
    conditions: Sequence[int],
    sizes: Mapping[Address, float],
    nominals: Sequence[Sequence[FloatArray]],
    doing: str = "effects",
) -> dict[Address, list[FloatArray]]:
    """What simulations of these conditions with one parameter at its size [unit] differ by from the first of the nominal ones.

    Per condition, [samples, channels]; without parameters that change nothing, or with which a condition cannot run.
    """
    results = iter(simulator.many([(i, simulator.seeded(setting({a: s}))) for a, s in sizes.items() for i in conditions], doing))
    changes = {}
    for a in sizes:
        change = [r - group[0] for r, group in zip([next(results) for _ in conditions], nominals, strict=True) if r is not None]
        if len(change) == len(conditions) and any(np.any(c) for c in change):
            changes[a] = change
    return changes


def interplay(
    simulator: Simulator,
    conditions: Sequence[int],
    tolerances: Mapping[Address, float],
    sizes: Mapping[Address, float],
    changes: Mapping[Address, Sequence[FloatArray]],
    nominals: Sequence[Sequence[FloatArray]],
    doing: str = "effects",
) -> list[list[FloatArray]]:
    """What no calibrated number does alone: what all do together beyond the sum, a deviation up and a deviation down, and a smaller step.

    Each per condition, [samples, channels]; without what cannot run. An axis that the nominal program leaves at rest moves a little up or
    down on a real machine, and stands on this or that side of its known gap, however little it is that moves it. A real machine has no
    communication step: what the `refinement` of the catalogue changes is error of the simulation.
    """
    seen = {a: s for a, s in tolerances.items() if a in changes}
    ways = [{a: sign * s for a, s in seen.items()} for sign in (1.0, -1.0)] if seen else []
    if simulator.laboratory.refinement is not None:
        ways.append({FINER: 1.0})
    results = iter(simulator.many([(i, simulator.seeded(setting(way))) for way in ways for i in conditions], doing))
    found = []
    for way in ways:
        there = [next(results) for _ in conditions]
        alone = [sum((s / sizes[a] * changes[a][k] for a, s in way.items() if a in seen), np.zeros(())) for k in range(len(conditions))]
        ran = [r - group[0] - each for r, group, each in zip(there, nominals, alone, strict=True) if r is not None]
        if len(ran) == len(conditions):
            found.append(ran)
    return found


def _smaller(candidate: Candidate) -> float:
    """A size to compare with the prior scale [prior scales]: half way down to where the effect begins to count, on a logarithmic scale.

    A path that is 3 ms late looks nothing like one that is 50 ms late, and a little like one that is 7 ms late.
    """
    if candidate.prior.kind == "normal":
        return -0.5
    return min(math.exp(-candidate.prior.spread), math.sqrt(candidate.minimum / candidate.prior.scale))


def _sizes(candidate: Candidate) -> list[float]:
    """Sizes to start from [prior scales], in order: a quarter apart from each other, closer to a bound that is near."""
    scale, largest = candidate.prior.scale, candidate.maximum
    sizes = [scale * math.exp(0.25 * k) for k in range(-10, 7)]
    if largest < sizes[-1]:
        sizes = [x for x in sizes if x <= scale] + [largest - (largest - scale) * math.exp(-0.35 * k) for k in range(1, 9)]
    found = [x / scale for x in sizes if candidate.minimum <= x <= largest]
    return [-x for x in reversed(found)] + found if candidate.both_signs else found


def _evenly(candidate: Candidate) -> list[float]:
    """Sizes up to the largest one [prior scales]."""
    low = -candidate.maximum if candidate.both_signs else 0.0
    return [float(x) / candidate.prior.scale for x in np.linspace(low, candidate.maximum, EVENLY + 1)[1:-1] if abs(x) >= candidate.minimum]


def _where_it_begins(found: Sequence[tuple[float, FloatArray]]) -> list[float]:
    """Sizes between the last one that does nothing and the first one that does something: a limit may cut off everything from there."""
    for (x, signature), (after, following) in itertools.pairwise(found):
        if not np.any(signature) and np.any(following):
            return [x + (after - x) * k / 8 for k in range(1, 8)]
    return []


def _bends(first: Address, other: Mapping[Address, FloatArray], sensitivities: Mapping[Address, FloatArray]) -> bool:
    """Whether the sensitivity at another size points elsewhere (cosine below BENT), or is not known yet."""
    return first not in other or cosine(other[first], sensitivities[first]) < BENT


def cosine(a: FloatArray, b: FloatArray) -> float:
    """Cosine of the angle between two changes [n]; 0 where one of them is nothing."""
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b) + 1e-300))


def gain(space: Space, sensitivity: FloatArray, candidate: Candidate) -> float:
    """chi2 that the sensitivity v takes away at its best size: <v, y>^2 / <v, v>; 0 where that size has a sign it cannot have."""
    return _taken(*space.against(sensitivity), candidate)


def _taken(product: float, square: float, candidate: Candidate) -> float:
    """chi2 that a sensitivity v takes away, from its products <v, y> and <v, v>; see `gain`."""
    return product * product / (square + 1e-300) if product > 0.0 or candidate.both_signs else 0.0
