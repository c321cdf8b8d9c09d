"""What the search works on: whitened residuals, sensitivities of the candidates, and all that is no effect.

The residual of condition i is y_i = sqrt(n_i) W (mean of its repeats - mean of the nominal simulations), with W the whitening, and n_i
the repeats that it is worth; signatures and sensitivities are changes of the simulation, whitened in the same way.

What repeats do is in the whitening (`noise`). What two systems that are the same but not quite leave is in nuisances: calibrated
numbers within their tolerances, channels that are a part of a step late, own noise of single runs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import dct

from robomill.diagnosis.candidates import LOGGING, Address, Candidate, selects
from robomill.diagnosis.experiment.measured import DataError
from robomill.diagnosis.experiment.simulation import Laboratory
from robomill.diagnosis.inference.ceiling import cross_fitted
from robomill.diagnosis.inference.columns import Columns
from robomill.diagnosis.inference.estimation import Model, Space
from robomill.diagnosis.inference.noise import FAST, SPELL, Whitening, fast, own_noise, whitening
from robomill.orchestration.slaves.protocol import FloatArray, base_name

TRUST = 0.02
"""Part of an effect of typical size that the models are not trusted to: the noise floor of each channel."""
DISCREPANCY = 0.1
"""Deviation of what two formulations of one machine leave, over what the tolerances of its numbers do to an array [1]. Fitted to machines
without effects of development seeds; a discrepancy has a memory, which DEPENDENCE counts."""
DEPENDENCE = 10.0
"""Samples that are worth one: what two systems that are not quite the same leave is no noise, it goes in one direction for a while. Where
tolerances do so for longer, a discrepancy may, too (`_spectra`)."""
FORM = 0.04
"""Part of what an effect does, by condition and array, that a right law may miss (standard deviation); its value is off by as much."""
GUESSED = 2.0
"""Variance of what is slow in noise over that of what is white, by communication step [1], where nothing was repeated (judgement: the noise
of trackers and drives is coloured)."""
LATENESS = 0.2
"""Communication steps that the channels of a component may be late: outputs hold for a step, and a step later others see them."""
BEGINNING, SETTLING = 25, 0.1
"""Communication steps at the beginning of a run that do not count, and the part of a run that they are at most: a simulation begins with
its initial values, and settles."""
SUDDEN, AROUND = 1.0, 10
"""Communication steps, at random, that a sudden change may come early or late: signals go from one component to the next with a step, so
that what begins at an instant is seen up to a step later. Sudden is what is no straight line over so many steps before and after."""

INTERPLAY: Address = ("", "interplay")
"""What stands for calibrated numbers together among the names of nuisances."""
FORMULATION: Address = ("", "formulation")
"""What stands there for what another formulation of the machine does."""
ANEW = " of each condition"
"""After the name of a number that conditions give themselves, among the names of nuisances: it is off in each by itself."""
Changes = Mapping[Address, Sequence[FloatArray]]
"""parameter -> change of the channels that it makes in each condition, [samples, channels]."""


@dataclass(frozen=True)
class Repeats:
    """Repeats of a condition that is held out. What they scatter is noise; of a gap, which they have in common, it says nothing."""

    name: str
    """Name of the condition: that of a diagnosed one, if they are repeats of that."""
    runs: Sequence[FloatArray]
    """Measured, [samples, channels] each."""
    there: npt.NDArray[np.bool_]
    """Which channels the condition has, [channels]."""
    independent: bool
    """Whether each sample is a measurement of its own."""

    @property
    def deviations(self) -> list[FloatArray]:
        """What the runs are away from their mean, [samples, channels] each."""
        mean = np.mean(self.runs, axis=0)
        return [x - mean for x in self.runs]


@dataclass
class Evidence:
    """Per condition: lists. Samples are of the channels that an effect changes (`active`)."""

    space: Space
    whitening: Whitening
    active: npt.NDArray[np.bool_]
    """Which of all channels some effect changes, [channels]. The others say nothing; the gate has looked at them."""
    nominals: Sequence[Sequence[FloatArray]]
    """Nominal simulations with different noise, [samples, channels]."""
    sudden: list[FloatArray]
    """Standard deviation that single runs have beyond the noise where a channel changes suddenly, [samples, channels]."""
    residuals: list[list[FloatArray]]
    """Per repeat: whitened measured minus nominal, in single-run units."""
    sensitivities: dict[Address, FloatArray]
    """ds/dx: whitened change per prior scale, [n], for each parameter that changes anything."""
    repeats: list[float]
    """Repeats that the mean residual is worth, the scatter of the simulated mean and the dependence of the samples included."""
    expected: FloatArray
    """chi2 that noise alone leaves in each sample of y, [n]: by channel and condition, from repeats and from simulations."""
    allowed: FloatArray
    """chi2 that noise and discrepancy leave in each sample of y, [n]."""
    scatter: FloatArray
    """Variance of a whitened run that is not repeated, by channel."""
    late: frozenset[Address]
    """Latenesses that are no nuisance here: they would have to be larger than what the catalogue calls a late clock."""
    arrays: npt.NDArray[np.intp]
    """Which array each active channel is an element of, [active channels]."""
    judged: npt.NDArray[np.bool_]
    """Which active channels have a discrepancy to compare with what is left: those of arrays that some tolerance changes."""
    there: list[npt.NDArray[np.bool_]]
    """Which of the active channels a condition has: those that it lacks are zero in all that is whitened, and say nothing."""
    halves: list[tuple[FloatArray, FloatArray]]
    """What two independent means of nominal simulations are away from the mean of all, whitened."""
    independent: list[bool]
    """Whether each sample of a condition is a measurement of its own."""
    decimation: int
    """Communication steps that a sample is the mean over."""
    discrepancy: FloatArray
    """Standard deviation of what two formulations leave, of each active channel [its unit]."""
    waves: list[list[FloatArray]]
    """What two formulations may leave of each condition, as far as it could be seen: slow cosines of one standard deviation each,
    [samples, channels] in units of the channels."""
    dispersion: float
    """What the best model leaves over what noise and discrepancy do [1]: so many samples more are worth one."""

    @property
    def guess(self) -> float:
        """chi2 of noise over that of the part of it that is known: 1, but where that is the fast part of a time series.

        Means over `decimation` steps have so much less white noise, and as much slow noise as before.
        """
        return 1.0 + GUESSED * self.decimation if self.whitening.guessed and not all(self.independent) else 1.0

    @property
    def noise(self) -> float:
        """chi2 that noise alone leaves, `guess` included."""
        return float(self.expected.sum()) * self.guess

    def level(self, left: FloatArray) -> float:
        """chi2 of a residual [n] over what noise and discrepancy leave: that of the worst channel in the worst condition."""
        return float(np.max(self.levels(left), initial=0.0))

    def levels(self, left: FloatArray) -> FloatArray:
        """chi2 of a residual [n] over what noise and discrepancy leave, of each judged channel in each condition: [conditions, judged].

        With b = (I + B'B)^-1 B' u, <u, u> = u'(u - B b) = |u - B b|^2 + |b|^2: the part of a channel in it has what nuisances leave there,
        and what it costs to move them so far. Both have one sample more, as expected: without noise less than that says nothing. The
        `dispersion` makes it dearer to move them, and divides both.
        """
        rest = left * (left - self.space.explained(left))
        return self._over([rest[block].reshape(-1, len(self.arrays)).sum(axis=0) for block in self.space.blocks.values()])

    def does(self, signature: FloatArray) -> FloatArray:
        """What a signature s [n] does to each judged channel in each condition, as `levels`: <s, s> of that part of it alone."""
        chi2, k = [], len(self.arrays)
        for block in self.space.blocks.values():
            parts = np.zeros((signature.size, k))
            parts[block] = (signature[block].reshape(-1, k, 1) * np.eye(k)).reshape(-1, k)
            chi2.append(self.space.chi2_of(parts))
        return self._over(chi2)

    def _over(self, chi2: Sequence[FloatArray]) -> FloatArray:
        """chi2 of each channel, [channels] by condition, over what noise and discrepancy leave: [conditions, judged]."""
        allowed = [self.allowed[block].reshape(-1, len(self.arrays)).sum(axis=0) for block in self.space.blocks.values()]
        over = (np.stack(chi2) * self.dispersion / self.guess + 1.0) / (np.stack(allowed) * self.dispersion + 1.0)
        return np.asarray(over[:, self.judged])

    def signature(self, results: Sequence[FloatArray | None]) -> FloatArray | None:
        """Whitened change [n] of simulations of all conditions, [samples, all channels] each, against the nominal ones.

        None if one of them failed.
        """
        return self._white(results, [n[0] for n in self.nominals])

    def mean_signature(self, groups: Sequence[Sequence[FloatArray] | None]) -> FloatArray | None:
        """Whitened change [n] of means over simulations with different noise against means of as many nominal ones; None if one failed."""
        means = [None if g is None else np.asarray(np.mean(g, axis=0)) for g in groups]
        return self._white(means, [np.asarray(np.mean(n[: len(g or n)], axis=0)) for n, g in zip(self.nominals, groups, strict=True)])

    def residual(self, groups: Sequence[Sequence[FloatArray]]) -> FloatArray:
        """Whitened residual [n] of other measured repeats of the same conditions: their mean against that of all nominal simulations."""
        found = self._white([np.mean(g, axis=0) for g in groups], [np.mean(n, axis=0) for n in self.nominals])
        assert found is not None
        return found

    def form(self, model: Model, signature: FloatArray, sensitivities: FloatArray, x: FloatArray) -> FloatArray | None:
        """What the effects of a model may do otherwise than their laws say: columns [n, k] of standard deviation FORM of what each does.

        One column per effect, condition and array, where that much could be seen at all. `signature` [n] at x [prior scales];
        `sensitivities` [n, parameters]. An effect among several does what its sensitivities at x say.
        """
        columns, first = [], 0
        for c in model:
            k = len(c.parameters)
            does = signature if len(model) == 1 else sensitivities[:, first : first + k] @ x[first : first + k]
            first += k
            for block in self.space.blocks.values():
                part = FORM * does[block].reshape(-1, len(self.arrays))
                for array in np.unique(self.arrays):
                    here = self.arrays == array
                    if float((part[:, here] ** 2).sum()) > 1.0:
                        column = np.zeros(self.space.y.size)
                        column[block] = np.where(here, part, 0.0).ravel()
                        columns.append(column)
        return np.stack(columns).T if columns else None

    def _white(self, results: Sequence[FloatArray | None], base: Sequence[FloatArray]) -> FloatArray | None:
        parts = []
        for r, b, n, s, on, apart in zip(results, base, self.repeats, self.sudden, self.there, self.independent, strict=True):
            if r is None:
                return None
            parts.append(self.whitening.of(apart).apply(r[:, self.active] - b, n, s, on))
        return np.concatenate(parts)


def dependence(independent: bool) -> float:
    """Samples of a condition that are worth one: DEPENDENCE in a time series, 1 where each is a measurement of its own."""
    return 1.0 if independent else DEPENDENCE


def gather(
    laboratory: Laboratory,
    conditions: Sequence[str],
    groups: Sequence[Sequence[FloatArray]],
    nominals: Sequence[Sequence[FloatArray]],
    changes: Changes,
    sizes: Mapping[Address, float],
    scales: Mapping[Address, float],
    tolerances: Mapping[Address, float],
    clocks: Sequence[Candidate] = (),
    left: Sequence[Sequence[FloatArray]] = (),
    like: Evidence | None = None,
    doubts: Mapping[Address, float] | None = None,
    beyond: Sequence[Sequence[FloatArray]] = (),
    dispersion: float = 1.0,
) -> Evidence:
    """Evidence from the repeats and nominal simulations of each of these conditions, [samples, channels].

    `changes` were simulated at `sizes` [unit of the parameter]; `scales` are the prior scales of the candidates' parameters,
    `tolerances` the standard deviations of calibrated ones; `clocks` those among the candidates that are late clocks, or times of a
    component. `left`: what a model leaves of each run, from which the noise is guessed where there are no repeats (else what the nominal
    one leaves). `like`: channels, whitening and what is no nuisance are those of this one, so that chi2 can be compared. `doubts`: the
    standard deviations that a discrepancy goes with (None: `tolerances`). `beyond`: what calibrated numbers do together beyond the sum of
    what they do alone, in each condition; each of these may be there or not, in every condition anew. `dispersion`: see `Evidence`; that of
    `like`, if there is one. DataError if no parameter changes anything.
    """
    active = _moved(changes) if like is None else like.active
    groups = [[x[:, active] for x in g] for g in groups]
    nominals = [[b[:, active] for b in group] for group in nominals]
    changes = {a: [c[:, active] for c in change] for a, change in changes.items()}
    begin = min(math.ceil(BEGINNING / laboratory.decimation), int(SETTLING * min(len(x) for g in groups for x in g)))
    means = [np.asarray(np.mean(group, axis=0)) for group in nominals]
    over = [[x[:, active] for x in g] for g in left] or [[x - m for x in g] for g, m in zip(groups, means, strict=True)]
    there = [laboratory.there(name)[active] for name in conditions]
    independent = [laboratory.independent(name) for name in conditions]
    if like is None:
        over = _left_by_regression(_left_by_all(over, changes, independent), changes, means, independent)
    spare = _spare(laboratory, active) if like is None else []
    w = _whitening(groups, nominals, changes, begin, over, there, independent, spare) if like is None else like.whitening
    ws = [w.of(apart) for apart in independent]
    # the mean of so many simulations scatters too
    counts = [len(g) * len(m) / (len(g) + len(m)) if len(m) > 1 else float(len(g)) for g, m in zip(groups, nominals, strict=True)]
    # change of each channel in a communication step; measurements of their own are neither late nor sudden
    rates = [np.gradient(m, axis=0) / laboratory.decimation * (not apart) for m, apart in zip(means, independent, strict=True)]
    span = max(1, round(AROUND / laboratory.decimation))
    bends = [_bend(m, span) * (not apart) for m, apart in zip(means, independent, strict=True)]
    arrays = np.unique([base_name(c) for c, on in zip(laboratory.channels, active, strict=True) if on], return_inverse=True)[1]
    size = _discrepancy(changes, sizes, tolerances if doubts is None else doubts, arrays)
    spectra = _spectra(
        changes,
        sizes,
        tolerances if doubts is None else doubts,
        arrays,
        [(len(m), apart) for m, apart in zip(means, independent, strict=True)],
    )
    doubt = [np.sqrt(n) * size * np.ones_like(m) for m, n in zip(means, counts, strict=True)]
    sudden = [np.hypot(SUDDEN / laboratory.decimation * bend * np.sqrt(n), d) for bend, n, d in zip(bends, counts, doubt, strict=True)]
    residuals = [[w.apply(x - m, 1.0, s, on) for x in g] for w, g, m, s, on in zip(ws, groups, means, sudden, there, strict=True)]
    halves = [
        (w.apply(np.mean(g[::2], axis=0) - m, 1.0, s, on), w.apply(np.mean(g[1::2] or g, axis=0) - m, 1.0, s, on))
        for w, g, m, s, on in zip(ws, nominals, means, sudden, there, strict=True)
    ]
    dispersion = dispersion if like is None else like.dispersion
    counts = [n / dependence(apart) / dispersion for n, apart in zip(counts, independent, strict=True)]

    def white(change: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([w.apply(c, n, s, on) for w, c, n, s, on in zip(ws, change, counts, sudden, there, strict=True)])

    y = np.concatenate([np.sqrt(n) * np.mean(r, axis=0) for n, r in zip(counts, residuals, strict=True)])
    blocks, start = {}, 0
    for name, mean in zip(conditions, means, strict=True):
        blocks[name] = slice(start, start + mean.size)
        start += mean.size
    raw = {a: white(change) for a, change in changes.items()}
    sensitivities = {a: raw[a] * (scales[a] / sizes[a]) for a in scales if a in raw}
    nuisances = {a: raw[a] * (tolerances[a] / sizes[a]) for a in tolerances if a in raw}
    names = [c for c, on in zip(laboratory.channels, active, strict=True) if on]
    for component in dict.fromkeys(name.partition(".")[0] for name in names):
        here = np.array([name.partition(".")[0] == component for name in names])
        nuisances[LOGGING, f"lag {component}.*"] = white([-LATENESS * rate * here for rate in rates])
    # of a single run, the whitened fast part says how much of the noise is floor, which is not seen
    alone = [
        _variance([w.apply(x if apart else fast(x), 1.0, s, on) for x in g], len(names)) if w.guessed else 1.0 * on
        for w, g, s, on, apart in zip(ws, over, sudden, there, independent, strict=True)
    ]
    scatter = np.sum(alone, axis=0) / np.maximum(np.sum(there, axis=0), 1)
    spell = max(1, round(SPELL / laboratory.decimation))
    together = _apart([white([x[:, active] for x in way]) for way in beyond], blocks)
    differs, different = [], []
    for i, (name, spectrum, mean) in enumerate(zip(blocks, spectra, means, strict=True)):
        seen = counts[i] * there[i] * (1.0 / ((w.factor**2).sum(axis=1) + sudden[i] ** 2)).mean(axis=0)
        waves = list(_waves(spectrum * size**2 * len(mean), seen, len(mean)))
        different.append(waves)
        columns = [ws[i].apply(wave, counts[i], sudden[i], there[i]) for wave in waves]
        differs.append((name, np.reshape(columns, (len(columns), mean.size)).T))
    own, expected, allowed = [], np.zeros(y.size), np.zeros(y.size)
    for i, ((name, block), group) in enumerate(zip(blocks.items(), residuals, strict=True)):
        simulated = [ws[i].apply(x - means[i], 1.0, sudden[i], there[i]) for x in nominals[i]]
        single = alone[i] if like is None else like.scatter * there[i]
        level = counts[i] * (
            (_scatter(group, len(names)) if len(group) > 1 else single) + (_scatter(simulated, len(names)) if len(simulated) > 1 else 0.0)
        )
        seen = (doubt[i] / np.hypot(sudden[i], np.sqrt((w.factor**2).sum(axis=1)))) ** 2  # part of a whitened sample that is discrepancy
        expected[block].reshape(-1, len(names))[:] = level
        allowed[block].reshape(-1, len(names))[:] = level + seen.mean(axis=0) * there[i] / dependence(independent[i]) / dispersion
        if independent[i]:  # neither drifts nor spells
            continue
        held = [_padded(r.deviations, means[i]) for r in spare if r.name == conditions[i] and len(group) == 1]
        others = [[ws[i].apply(x, 1.0, sudden[i], there[i]) for x in runs] for runs in held]
        own.append((name, own_noise([group, simulated, *others], len(names), spell) / np.sqrt(DEPENDENCE * dispersion)))
    anew = {a: _apart([nuisances.pop(a)], blocks) for a in list(nuisances) if laboratory.differs(conditions, a)}
    doubtful = [
        *nuisances,
        *[(component, f"{parameter}{ANEW}") for (component, parameter), columns in anew.items() for _ in columns],
        *[INTERPLAY] * len(together),
        *[FORMULATION] * sum(d.shape[1] for _, d in differs),
        *((LOGGING, f"noise {i + 1}") for i in range(sum(o.shape[1] for _, o in own))),
    ]
    alone_in = [column for columns in anew.values() for column in columns]
    everywhere = [(None, np.stack(list(nuisances.values())).T)]
    space = Space(y, blocks, Columns.joined([*everywhere, *alone_in, *together, *differs, *own], blocks), doubtful)
    late = _late(space, clocks, names, LATENESS * laboratory.system.step) if like is None else like.late
    space = space.less(late)
    space.find_alike(sensitivities, scales)
    judged = size > 0.0
    return Evidence(
        space,
        w,
        active,
        nominals,
        sudden,
        residuals,
        sensitivities,
        counts,
        expected,
        allowed,
        scatter,
        late,
        arrays,
        judged,
        there,
        halves,
        independent,
        laboratory.decimation,
        size,
        different,
        dispersion,
    )


def _spare(laboratory: Laboratory, active: npt.NDArray[np.bool_]) -> list[Repeats]:
    """The held-out conditions that were repeated, with the `active` channels."""
    found = []
    for i, c in enumerate(laboratory.conditions):
        if c.held_out and len(c.runs) > 1:
            there = np.array([c.has(name) for name in laboratory.channels])[active]
            found.append(Repeats(c.name, [x[:, active] for x in laboratory.measured_in(i)], there, c.independent))
    return found


def _padded(runs: Sequence[FloatArray], like: FloatArray) -> list[FloatArray]:
    """The runs with as many samples as this one: zeros where they have fewer."""
    return [np.concatenate([x[: len(like)], np.zeros_like(like[len(x) :])]) for x in runs]


def _apart(columns: Sequence[FloatArray], blocks: Mapping[str, slice]) -> list[tuple[str, FloatArray]]:
    """Each column [n] as one for every condition where it is not zero: the condition, and [its rows, 1]."""
    return [(name, column[rows, None]) for column in columns for name, rows in blocks.items() if np.any(column[rows])]


def _discrepancy(
    changes: Changes, sizes: Mapping[Address, float], doubts: Mapping[Address, float], arrays: npt.NDArray[np.intp]
) -> FloatArray:
    """DISCREPANCY times what all doubts do to an array, root of the mean square over time, elements and conditions, [channels]."""
    square = np.zeros(len(arrays))
    for a in [a for a in doubts if a in changes]:
        change = np.concatenate(list(changes[a]))
        square += (change**2).mean(axis=0) * (doubts[a] / sizes[a]) ** 2
    return np.asarray(DISCREPANCY * np.sqrt((np.bincount(arrays, square) / np.bincount(arrays))[arrays]))


def _spectra(
    changes: Changes,
    sizes: Mapping[Address, float],
    doubts: Mapping[Address, float],
    arrays: npt.NDArray[np.intp],
    conditions: Sequence[tuple[int, bool]],
) -> list[FloatArray]:
    """Share of each slow cosine in the mean square of what all doubts do to an array, by condition: [half waves, channels].

    Slow are those with half waves of DEPENDENCE samples and more. The mean over octaves of half waves (0, 1, 2 and 3, 4 to 7, ...), as
    another formulation goes as slowly as what is doubted, and not with the same waves. Independent samples have none.
    `conditions`: samples of each, and whether these are independent.
    """
    found = []
    for i, (rows, apart) in enumerate(conditions):
        power = np.full((rows, len(arrays)), 1e-300)
        for a in [a for a in doubts if a in changes]:
            power += (dct(changes[a][i], axis=0, norm="ortho") * (doubts[a] / sizes[a])) ** 2
        power = np.stack([np.bincount(arrays, p)[arrays] for p in power])
        edges = [0, *(2**k for k in range(rows.bit_length()) if 2**k < rows), rows]
        for low, high in itertools.pairwise(edges):
            power[low:high] = power[low:high].mean(axis=0)
        slow = 0 if apart else int(rows / DEPENDENCE)
        found.append((power / power.sum(axis=0))[:slow])
    return found


def _waves(variances: FloatArray, seen: FloatArray, rows: int) -> Iterator[FloatArray]:
    """Cosines of these `variances` [unit^2], [half waves, channels], that could be seen at all: [rows, channels] each.

    `seen` [channels]: chi2 of a wave by its variance, 1 / unit^2.
    """
    for k, c in np.argwhere(variances * seen > 1.0):
        wave = np.zeros((rows, variances.shape[1]))
        wave[:, c] = math.sqrt(variances[k, c] * (1.0 if k == 0 else 2.0) / rows) * np.cos(math.pi * k * (np.arange(rows) + 0.5) / rows)
        yield wave


def _left_by_all(left: Sequence[Sequence[FloatArray]], changes: Changes, independent: Sequence[bool]) -> list[list[FloatArray]]:
    """What is left of each run [samples, channels]; of independent samples what least squares leave of that with all parameters together.

    It is scaled to the variance of noise by its degrees of freedom, as the error variance of a linear regression is (Seber & Lee, Linear
    Regression Analysis, 2003, section 3.3). There is no time by which noise could be told from a gap. Where there are as many parameters as
    samples, `left` stays as it is.
    """
    found = [list(runs) for runs in left]
    here = [i for i, apart in enumerate(independent) if apart]
    if not here:
        return found
    gaps = np.concatenate([np.mean(left[i], axis=0) for i in here])
    size = np.sqrt((gaps**2).mean(axis=0)) + 1e-300
    columns = np.stack([(np.concatenate([change[i] for i in here]) / size).ravel() for change in changes.values()], axis=1)
    columns /= np.linalg.norm(columns, axis=0) + 1e-300
    fitted, _, rank, _ = np.linalg.lstsq(columns, (gaps / size).ravel(), rcond=None)
    if rank >= len(columns):
        return found
    explained = (columns @ fitted).reshape(gaps.shape) * size
    start = 0
    for i in here:
        part = explained[start : start + len(left[i][0])]
        start += len(part)
        found[i] = [(x - part) * math.sqrt(len(columns) / (len(columns) - rank)) for x in left[i]]
    return found


def _left_by_regression(
    left: Sequence[Sequence[FloatArray]], changes: Changes, signals: Sequence[FloatArray], independent: Sequence[bool]
) -> list[list[FloatArray]]:
    """What is left of each run [samples, channels]; of one without repeats what a regression leaves of that.

    It is on what all parameters do to the channel, and on the FAST samples of its simulated signal around each one: so a filter or a clock
    may change it. What these do to a part of a run, as they do in the other parts (`cross_fitted`), is no noise, however fast it is. A
    channel of which it leaves more stays as it is.
    """
    found = [list(runs) for runs in left]
    once = [i for i, apart in enumerate(independent) if len(left[i]) == 1 and not apart]
    around = {i: sliding_window_view(np.pad(signals[i], ((FAST // 2, FAST // 2), (0, 0)), "edge"), FAST, axis=0) for i in once}
    for c in range(left[0][0].shape[1]) if once else ():
        columns = {i: np.column_stack([x[:, c], *(change[i][:, c] for change in changes.values())]) for i, x in around.items()}
        size = np.sqrt(np.mean(np.concatenate(list(columns.values())) ** 2, axis=0))
        does = {i: x[:, size > 0.0] / size[size > 0.0] for i, x in columns.items()}
        for i in once:
            gap = left[i][0][:, [c]]
            rest = gap - cross_fitted(does[i], gap, [(does[k], left[k][0][:, [c]]) for k in once if k != i])
            if (rest**2).sum() < (gap**2).sum():
                found[i][0] = np.where(np.arange(found[i][0].shape[1]) == c, rest, found[i][0])
    return found


def _late(space: Space, clocks: Sequence[Candidate], channels: Sequence[str], size: float) -> frozenset[Address]:
    """Components that the nominal system would have to take for late by more than a late clock of the catalogue is: that is no nuisance.

    `size`: one deviation of lateness [s]. Without this a clock that is most of a step late would be explained for nothing, and something
    else be named for the rest. Where there is no clock for a component, the delays that it has itself take its place.
    """
    shown = {name.partition(".")[0] for name in channels}
    smallest: dict[str, float] = {}
    delays: dict[str, float] = {}
    for c in clocks:
        if c.component in shown:
            delays[c.component] = min(delays.get(c.component, np.inf), c.minimum)
        for pattern in (p.partition(" ")[2] for p in c.parameters if c.component == LOGGING):
            for component in {name.partition(".")[0] for name in channels if selects(pattern, name)}:
                smallest[component] = min(smallest.get(component, np.inf), c.minimum)
    smallest = delays | smallest
    moved = dict(zip(space.names, size * np.abs(space.moved(space.y)), strict=True))
    return frozenset(a for component, least in smallest.items() if moved[a := (LOGGING, f"lag {component}.*")] > least)


def _bend(x: FloatArray, span: int) -> FloatArray:
    """How far each sample is, per sample of distance, from the straight line between two that are up to `span` samples before and after it.

    The largest of all distances. What changes steadily is only late, if anything.
    """
    away = np.zeros_like(x)
    for k in range(1, min(span, (len(x) - 1) // 2) + 1):
        away[k:-k] = np.maximum(away[k:-k], np.abs(x[k:-k] - 0.5 * (x[: -2 * k] + x[2 * k :])) / k)
    return away


def _moved(changes: Changes) -> npt.NDArray[np.bool_]:
    """Which channels any parameter changes; DataError if there is none."""
    moved = np.array([np.any([np.any(c, axis=0) for c in change], axis=0) for change in changes.values()])
    if not moved.any():
        raise DataError(
            "no parameter of the catalogue changes any of the measured channels: there is nothing to diagnose with"
            "; give another catalogue, or measure more channels"
        )
    return np.asarray(moved.any(axis=0))


def _whitening(
    groups: Sequence[Sequence[FloatArray]],
    nominals: Sequence[Sequence[FloatArray]],
    changes: Changes,
    begin: int,
    left: Sequence[Sequence[FloatArray]],
    there: Sequence[npt.NDArray[np.bool_]],
    independent: Sequence[bool],
    spare: Sequence[Repeats],
) -> Whitening:
    """From the repeats, above a floor of TRUST of what effects of typical size do to a channel, over the conditions that have it.

    Where noise is a guess, effects that do more than all there is are left out, if there are others: of typical size some make a simulation
    run away.
    Of channels that are repeated in no condition noise is what the `spare` repeats scatter, and a guess where there are none of these.
    """
    samples = np.maximum(np.sum([len(n[0]) * on for n, on in zip(nominals, there, strict=True)], axis=0), 1)
    rms = np.array([np.sqrt(sum((c * c).sum(axis=0) for c in change) / samples) for change in changes.values()])
    known = np.any([on & (len(g) > 1) for g, on in zip(groups, there, strict=True)], axis=0)
    size = np.maximum(*(np.sqrt(sum((x[0] ** 2).sum(axis=0) for x in of) / samples) for of in (groups, nominals)))
    within = known | (rms <= size)
    rms = np.where(within | ~np.any(within & (rms > 0.0), axis=0), rms, 0.0)
    floor = np.array([TRUST * np.median(r[r > 1e-3 * r.max()]) if r.max() > 0.0 else 0.0 for r in rms.T])
    least = 1e-9 + 1e-6 * np.abs(np.concatenate([n[0] for n in nominals])).max(axis=0)  # what numbers are not good for
    spare = [r for r in spare if np.any(r.there & ~known)]
    every, rest = [*groups, *(r.runs for r in spare)], [*left, *(r.runs for r in spare)]
    shown, apart = [*there, *(r.there & ~known for r in spare)], [*independent, *(r.independent for r in spare)]
    return whitening(every, np.maximum(floor, least), begin, rest, shown, apart)


def _scatter(group: Sequence[FloatArray], channels: int) -> FloatArray:
    """Variance of the mean of these whitened repeats, by channel."""
    runs = np.stack(group).reshape(len(group), -1, channels)
    return np.asarray(runs.var(axis=0, ddof=1).mean(axis=0) / len(runs))


def _variance(group: Sequence[FloatArray], channels: int) -> FloatArray:
    """Mean square of whitened runs about zero, by channel."""
    return np.asarray((np.stack(group).reshape(-1, channels) ** 2).mean(axis=0))
