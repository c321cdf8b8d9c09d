"""Where: what is left when each component is driven with measured inputs, and which components could be to blame for it.

What is left of an output is the fault of a component between it and the cuts before it (`component_replay`). Which of them is decided by
the effects that the catalogue has in each, simulated in the component alone. With y the whitened residual of all outputs, D the
sensitivities of what is not known about a machine without a fault (`doubt`) and E_c those of the effects of component c, both at the size
of their priors, the model of a set of blamed components is y = D b + sum_c E_c x_c + noise with b, x_c ~ N(0, 1).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import uniform

from robomill.diagnosis.candidates import LOGGING, Address, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.component_replay import ComponentReplay
from robomill.diagnosis.experiment.measured import DataError
from robomill.diagnosis.experiment.repeats import RESAMPLES, bootstrapped, over_pairs
from robomill.diagnosis.experiment.simulation import Laboratory, decimate
from robomill.diagnosis.inference.evidence import SUDDEN, TRUST
from robomill.diagnosis.inference.isolability import CONFUSABLE
from robomill.diagnosis.inference.marginal import TEMPERATURE, MarginalLikelihood
from robomill.diagnosis.inference.noise import whitening
from robomill.diagnosis.localisation.localise import PRESENT
from robomill.orchestration.slaves.protocol import FloatArray, base_name

REPLAY_LATENESS = float(uniform.std())
"""Steps that the outputs of a component which is driven alone may be late: measured inputs reach it anywhere within a step."""
REACH = 0.05
"""Part of the whitened sum of squares of an effect in an output from which a fault of the component may be looked for there."""
PASSED_ON = 1e-3
"""Part of the squares of an output that a change of it must have behind the next component, to count there."""
SIGNIFICANT = 2.0 * CONFUSABLE
"""Deviations of noise from which something is left: half way to it, nothing and something are still CONFUSABLE deviations away."""
MORE = 1.5
"""Variance, in that of noise, from which the effects do not explain what is there."""


def not_alone(outputs: Sequence[str]) -> str:
    """Why these measured outputs are not replayed."""
    names = f"{', '.join(outputs[:-1])} and {outputs[-1]}" if len(outputs) > 1 else outputs[0]
    return (
        f"not replayed alone: {names}: driven with measured inputs, small errors add up there without end (it integrates, or is unstable)"
    )


BRIDGED = 50
"""Communication steps of a gap that is no interruption."""


def intervals(on: npt.NDArray[np.bool_], grid: FloatArray, decimation: int) -> list[list[float]]:
    """[[from, to], ...] in s where `on` is true; gaps below BRIDGED steps of the grid are bridged."""
    step = float(grid[1] - grid[0]) * decimation
    digits = max(0, 1 - math.floor(math.log10(step)))
    found: list[list[float]] = []
    for i in np.flatnonzero(on):
        t = float(grid[0]) + i * step
        if found and t - found[-1][1] < BRIDGED * step / decimation + step:
            found[-1][1] = t + step
        else:
            found.append([t, t + step])
    return [[round(float(a), digits), round(float(b), digits)] for a, b in found][:40]


@dataclass(frozen=True)
class Reading:
    """What the replay says about one segment."""

    output: str
    """Measured array or scalar, `component.port`."""
    components: tuple[str, ...]
    """Which could be to blame: those in which a fault would show here."""
    residual: float
    """What is left of the mean run [unit of the output]: rms over time, root of the sum over the elements, noise taken off."""
    interval: list[float] | None
    """90 % interval of `residual`, over the repeats; None where nothing was repeated."""
    unit: str
    """Unit of the output."""
    whitened: float
    """Rms of what is left of the mean run, in units of its noise."""
    unexplained: float
    """Rms of what is left, in units of its noise, when the tolerances of calibrated numbers have explained what they can."""
    significant: bool
    """Whether `unexplained` is more than noise."""


class Replay:
    """Replays of all conditions, whitened, with the sensitivities of parameters: who is to blame for what is left.

    `replayed`: one ComponentReplay per condition; `y`: whitened mean residuals, [n]; `sensitivities`: parameter -> whitened change per
    prior scale or standard deviation, [n]; `arrays`: measured outputs, `row`: which of them each element of y belongs to.

    `conditions`: indices of those that the system of the laboratory made. OrchestrationError where a replay fails,
    DataError where no parameter changes anything.
    """

    def __init__(self, laboratory: Laboratory, conditions: Sequence[int], catalogue: Catalogue, nuisances: Sequence[Nuisance]) -> None:
        self.replayed = [ComponentReplay.of(laboratory, i) for i in conditions]
        self.candidates = catalogue.candidates
        self.scales = {n.address: n.scale for n in nuisances if n.address[0] != LOGGING}
        self.nuisances = set(self.scales)
        self.scales |= {a: c.prior.scale for c in catalogue.candidates for a in c.addresses if a[0] != LOGGING}
        names = {c.name for c in laboratory.system.components}
        self.scales = {a: s for a, s in self.scales.items() if a[0] in names and laboratory.effective(conditions[0], ((a, s),))}
        self.components = [c.name for c in laboratory.system.components if any(a[0] == c.name for a in self.scales)]
        direct = {a: m for a in self.scales if (m := self._moved(a)) is not None}
        seen = {a: [b.observed(x) for b, x in zip(self.replayed, m, strict=True)] for a, m in direct.items()}
        if not any(np.any(x) for parts in seen.values() for x in parts):
            raise DataError(
                "no component is replayed alone: nothing that the catalogue has in one changes a measured output of that component"
                "; which effect it is does not depend on that, as effects are fitted in the whole system"
                "; give a channel of what comes out of one to have it looked at alone"
            )
        self.adding = tuple(dict.fromkeys(a for b in self.replayed for a in b.adding))
        """Measured outputs that are not replayed: alone, they add up what goes in."""
        # outputs that no parameter changes say nothing
        says = np.any([np.any(x, axis=0) for parts in seen.values() for x in parts], axis=0)
        self.at = np.flatnonzero([s and base_name(c) not in self.adding for s, c in zip(says, self.replayed[0].channels, strict=True)])
        if not len(self.at):
            raise DataError(not_alone(self.adding))
        self.channels = [self.replayed[0].channels[i] for i in self.at]
        self.arrays = list(dict.fromkeys(base_name(c) for c in self.channels))
        self.of = np.array([self.arrays.index(base_name(c)) for c in self.channels])
        """Array of each channel."""
        seen = {a: [x[:, self.at] for x in parts] for a, parts in seen.items()}
        self.groups = [[self._kept(r) for r in b.residuals] for b in self.replayed]
        self._whiten(seen)
        self.strong = self._strong(direct, seen)
        for a, m in direct.items():
            if any(x == a[0] for x, _ in self.strong):
                for i, b in enumerate(self.replayed):
                    for f in self._followed(b, m[i], a[0], ()):
                        seen[a][i] = seen[a][i] + b.observed(f)[:, self.at]
        self.sensitivities = {a: self._white(x) for a, x in seen.items()}
        self._lay_out()

    def _kept(self, full: FloatArray) -> FloatArray:
        """Block means over the decimation, of all channels those that say something: [samples, kept channels]."""
        return decimate(full[:, self.at], self.replayed[0].laboratory.decimation)

    def _moved(self, a: Address) -> list[dict[str, FloatArray]] | None:
        found = [b.change(a[0], ((a, self.scales[a]),)) for b in self.replayed]
        complete = [f for f in found if f is not None]
        return complete if len(complete) == len(found) and any(np.any(v) for f in complete for v in f.values()) else None

    def _whiten(self, seen: Mapping[Address, list[FloatArray]]) -> None:
        rms = np.array([np.sqrt(np.mean(np.concatenate(x) ** 2, axis=0)) for a, x in seen.items() if a not in self.nuisances])
        means = [self._kept(b.mean) for b in self.replayed]
        size = np.sqrt(np.mean(np.concatenate(means) ** 2, axis=0))
        typical = [TRUST * np.median(r[r > 1e-2 * r.max()]) if r.size and r.max() > 0.0 else 0.0 for r in rms.T]
        joint = whitening(self.groups, np.array(typical) + 1e-6 * size + 1e-12)
        # noise of a measured input is in two residuals, and whitening them together would bring the fault of one into the other
        within = joint.factor @ joint.factor.T * (self.of[:, None] == self.of)
        self.whitening = replace(joint, factor=np.linalg.cholesky(within))
        self._rates = [np.gradient(m, axis=0) / self.replayed[0].laboratory.decimation for m in means]
        counts = [len(g) for g in self.groups]
        # by all that changes, not only suddenly as in the evidence: measured inputs scatter where they change at all
        self._sudden = [np.hypot(1.0, SUDDEN * r * math.sqrt(n) / self.noise) for r, n in zip(self._rates, counts, strict=True)]

    def _white(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Whitened means over the repeats, one [samples, channels] per condition: [n]."""
        return np.concatenate([self.whitening.apply(p / s, len(g)) for p, s, g in zip(parts, self._sudden, self.groups, strict=True)])

    def _strong(
        self, moved: Mapping[Address, list[dict[str, FloatArray]]], seen: Mapping[Address, list[FloatArray]]
    ) -> set[tuple[str, str]]:
        """Pairs of components with connections that are not measured, over which effects of the first show in outputs of the second.

        They do from CONFUSABLE deviations on, and from a part PASSED_ON of the squares that they have in outputs of the first.
        """
        found = set()
        first = self.replayed[0]
        for source, target in dict.fromkeys((o.partition(".")[0], d) for o, d in first.hidden()):
            arrays = [o for o, d in first.hidden() if d == target and o.partition(".")[0] == source]
            probes = set()
            for o in arrays:
                sizes = {
                    a: sum(float(np.sum(v**2)) for k, v in m[0].items() if base_name(k) == o) for a, m in moved.items() if a[0] == source
                }
                if sizes and max(sizes.values()) > 0.0:
                    probes.add(max(sizes, key=lambda a: sizes[a]))
            for a in probes:
                there = first.observed(first.follow(moved[a][0], arrays, target))[:, self.at]
                chi2 = self._chi2(there)
                if chi2 > max(CONFUSABLE**2, PASSED_ON * self._chi2(seen[a][0])):
                    found.add((source, target))
        return found

    def _chi2(self, change: FloatArray) -> float:
        """Whitened sum of squares of a change of the first condition, [samples, channels]."""
        white = self.whitening.apply(change / self._sudden[0], len(self.groups[0]))
        return float(white @ white)

    def _followed(
        self, replay: ComponentReplay, moved: Mapping[str, FloatArray], source: str, passed: tuple[str, ...]
    ) -> list[dict[str, FloatArray]]:
        """Changes of outputs of other components, on all ways over connections that are not measured and strong."""
        found = []
        for target in [d for s, d in self.strong if s == source and d not in passed]:
            arrays = [o for o, d in replay.hidden() if d == target and o.partition(".")[0] == source]
            if any(np.any(v) for k, v in moved.items() if base_name(k) in arrays):
                there = replay.follow(moved, arrays, target)
                found += [there, *self._followed(replay, there, target, (*passed, source))]
        return found

    def _lay_out(self) -> None:
        """Residual, sensitivities and their inner products, output by output."""
        self.y = self._white([np.mean(g, axis=0) for g in self.groups])
        self.row = np.concatenate([np.tile(self.of, len(g[0])) for g in self.groups])
        """Array of each element of y."""
        coarse = [self._kept(b.coarse) for b in self.replayed if b.coarse is not None]
        timing = []
        for k in range(len(self.arrays)):
            timing.append(self._white([REPLAY_LATENESS * r * (self.of == k) for r in self._rates]))
            if coarse:  # each output by itself: how much there is of it depends on the machine's own cycle
                timing.append(self._white([c * (self.of == k) for c in coarse]))
        self.doubt = np.stack([*(v for a, v in self.sensitivities.items() if a in self.nuisances), *timing], axis=1)
        """Sensitivities [n, m] of what is not known about a machine without a fault: calibrated numbers, and what happens within a step."""
        self.effects = {
            c: np.stack([v for a, v in self.sensitivities.items() if a[0] == c and a not in self.nuisances], axis=1)
            for c in self.components
            if any(a[0] == c and a not in self.nuisances for a in self.sensitivities)
        }
        """Sensitivities [n, k] of the effects in each component, at the size of their priors."""
        self.reach = {c: self._reach(c) for c in self.effects}
        self._marginal = MarginalLikelihood(self.y, self.row, self.doubt, self.effects)

    def _reach(self, component: str) -> set[int]:
        """Arrays in which a fault of the component would show: its own, and those where an effect of it shows as well as anywhere."""
        own = {i for i, a in enumerate(self.arrays) if a.partition(".")[0] == component}
        squares = np.array([np.bincount(self.row, c * c, len(self.arrays)) for c in self.effects[component].T])
        share = squares / (squares.sum(axis=1, keepdims=True) + 1e-300)
        return {int(i) for i in np.flatnonzero((share > REACH).any(axis=0))} | own

    # Answers

    def readings(self) -> list[Reading]:
        """One per measured output that anything goes into; what the tolerances leave is y - D (I + D'D)^-1 D'y, D the doubt."""
        left = self.y - self.doubt @ np.linalg.solve(np.eye(self.doubt.shape[1]) + self.doubt.T @ self.doubt, self.doubt.T @ self.y)
        found = []
        for k, array in enumerate(self.arrays):
            members = tuple(c for c in self.effects if k in self.reach[c])
            if not members:
                continue
            here = self.row == k
            n = int(here.sum())
            limit = TEMPERATURE * (1.0 + SIGNIFICANT * math.sqrt(2.0 / n))
            whitened, unexplained = float(np.mean(self.y[here] ** 2)), float(np.mean(left[here] ** 2))
            squares = self._squares(k)
            ends = bootstrapped(squares[1:], max(map(len, self.groups)))
            size = math.sqrt(max(float(squares[0]), 0.0))
            found.append(
                Reading(
                    array,
                    members,
                    size,
                    [math.sqrt(max(x, 0.0)) for x in ends] if ends else None,
                    self.unit(array),
                    math.sqrt(whitened),
                    math.sqrt(unexplained),
                    unexplained > limit,
                )
            )
        return found

    def part(self, component: str, blamed: Sequence[str], output_of: str) -> float:
        """Part of what is left of the outputs of `output_of` that this one of the blamed components explains; these parts add up to 1.

        An output in reach of none of them counts for nobody but its own component.
        """
        rows = np.isin(self.row, [k for k, a in enumerate(self.arrays) if a.partition(".")[0] == output_of])
        able = [c for c in blamed if any(self.arrays[k].partition(".")[0] == output_of for k in self.reach[c])]
        if component not in able:
            return 0.0
        if len(able) == 1:
            return 1.0
        parts = [self.effects[c] for c in able]
        matrix = np.concatenate([self.doubt, *parts], axis=1)
        x = np.linalg.solve(np.eye(matrix.shape[1]) + matrix.T @ matrix, matrix.T @ self.y)
        sizes, start = {}, self.doubt.shape[1]
        for c, p in zip(able, parts, strict=True):
            sizes[c] = float(np.sum((p[rows] @ x[start : start + p.shape[1]]) ** 2))
            start += p.shape[1]
        return sizes[component] / (sum(sizes.values()) + 1e-300)

    @property
    def noise(self) -> FloatArray:
        """Standard deviation of one run, per channel [unit], floor included."""
        return np.asarray(np.sqrt((self.whitening.factor**2).sum(axis=1)))

    @property
    def weights(self) -> FloatArray:
        """Weights of all channels of the laboratory in the whole gap [1 / unit]: 1 / noise, 0 for those that say nothing."""
        weights = np.zeros(len(self.replayed[0].channels))
        weights[self.at] = 1.0 / self.noise
        return weights

    def unit(self, array: str) -> str:
        """Unit of an output."""
        return self.replayed[0].unit(self.channels[int(np.flatnonzero(self.of == self.arrays.index(array))[0])])

    def table(self, white: FloatArray, condition: int) -> FloatArray:
        """The part of a whitened vector that belongs to a condition, [samples, channels]."""
        sizes = [len(g[0]) * len(self.channels) for g in self.groups]
        start = sum(sizes[:condition])
        return white[start : start + sizes[condition]].reshape(-1, len(self.channels))

    def filtered(self, series: FloatArray, channels: npt.NDArray[np.intp]) -> FloatArray:
        """What the whitening makes of a series at the grid in each of these channels, but for its size: [samples, channels]."""
        x = decimate(series[:, None], self.replayed[0].laboratory.decimation)
        out = np.repeat(x, len(channels), axis=1)
        a = self.whitening.coefficients[channels]
        for k in range(a.shape[1]):
            out[k + 1 :] -= a[:, k] * x[: -k - 1]
        return out

    def worst(self, white: FloatArray, outputs: Sequence[str]) -> tuple[tuple[int, int], list[list[float]]]:
        """Condition and channel with most of a whitened residual in these outputs (all if none), and the times when it is there [s]."""
        wanted = np.isin(self.of, [self.arrays.index(o) for o in outputs]) | (not outputs)
        squares = [self.table(white, i) ** 2 * wanted for i in range(len(self.groups))]
        condition = int(np.argmax([e.sum() for e in squares]))
        replay, over = self.replayed[condition], squares[condition].sum(axis=1)
        times = intervals(over > PRESENT * over.max(), replay.grid, replay.laboratory.decimation)
        return (condition, int(squares[condition].sum(axis=0).argmax())), times

    def _squares(self, k: int) -> FloatArray:
        """Mean square residual of an output: of the repeats as they are, then of resampled ones."""
        rng = np.random.default_rng(0)
        total, samples = np.zeros(1 + RESAMPLES), 0
        for g in self.groups:
            flat = np.stack([r[:, self.of == k].ravel() for r in g])
            weights = np.concatenate([np.ones((1, len(g))), rng.multinomial(len(g), np.full(len(g), 1.0 / len(g)), RESAMPLES)])
            total += over_pairs(flat @ flat.T, weights)
            samples += len(g[0])
        return total / samples

    def evidence(self, blamed: Sequence[str]) -> float:
        """Log evidence of faults in these components: any effects of theirs, at the size of their priors, and anything else in reach."""
        return self._explained(blamed)[0]

    def unexplained(self, blamed: Sequence[str], component: str) -> bool:
        """Whether more than the effects of the blamed components is needed in reach of this one."""
        variance = self._explained(blamed)[1]
        return bool(max(variance[k] for k in self.reach[component]) > MORE * TEMPERATURE)

    def _explained(self, blamed: Sequence[str]) -> tuple[float, FloatArray]:
        """Log evidence, and the variance of what is left in each output, where anything is allowed in reach."""
        return self._marginal.log(blamed, sorted(set().union(*(self.reach[c] for c in blamed))))
