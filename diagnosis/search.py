"""The search for the effects that explain the gap: screening, refinement on real simulations, pairs and triples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from diagnosis.catalogue import LOGGING, REFINED, Address, Candidate, Catalogue, Nuisance
from diagnosis.estimation import Fit, Model, Space, leave_one_out, quadratic_fit, scaled_bounds, solve
from diagnosis.measured import DataError
from diagnosis.noise import SPELL, Whitening, own_noise, whitening
from diagnosis.simulation import Setting, Simulator, setting
from orchestration.slave import FloatArray

TRUST = 0.02
"""Part of an effect of typical size that the models are not trusted to: the noise floor of each channel."""
DEPENDENCE = 10.0
"""Samples that are worth one: what is left of two systems that are not quite the same is no noise, and comes in one direction for a while."""
LATENESS = 12.0**-0.5
"""Communication steps that the channels of a component may be late: outputs hold for a step, so a uniform part of one."""
SUDDEN = 0.25
"""Communication steps, at random, that a change may come early or late: what happens within a step is not modelled."""
NOMINAL = 8
"""Simulations of the nominal system with different noise, of each condition."""
POLISH, POLISHED = 6, 8
"""Simulations with different noise at the best values of a model, and how many models of each size get them."""
SINGLES, BASES, EXTENSIONS = 10, 3, 4
"""How many single candidates are refined, how many of them grow, and by how many partners each."""


@dataclass
class Evidence:
    """What the search works on."""

    space: Space
    whitening: Whitening
    residuals: list[list[FloatArray]]
    """Per condition and repeat: whitened measured minus nominal, in single-run units."""
    columns: dict[Address, FloatArray]
    """Whitened change per prior scale, for each parameter that changes anything."""
    repeats: list[float]
    """Per condition: repeats that the mean residual is worth, the scatter of the simulated mean and DEPENDENCE included."""
    halves: list[tuple[FloatArray, FloatArray]]
    """Per condition: what two independent means of nominal simulations are away from the mean of all, whitened."""


class Search:
    """Fits on the first `len(groups)` conditions of the simulator's laboratory; `groups` are their measured repeats."""

    def __init__(
        self, catalogue: Catalogue, simulator: Simulator, groups: Sequence[Sequence[FloatArray]], nuisances: Sequence[Nuisance]
    ) -> None:
        self.nuisances = nuisances
        self.catalogue, self.simulator, self.groups = catalogue, simulator, groups
        nominal = simulator.repeated(range(len(groups)), (), NOMINAL, "nominal")
        self.nominals = [b for b in nominal if b is not None]
        self.base = [b[0] for b in self.nominals]
        self.candidates = self._screened()

    def _screened(self) -> list[Candidate]:
        """Simulate every parameter at its prior scale; whiten; keep the candidates that change something."""
        scales = {a: c.prior.scale for c in self.catalogue.candidates for a in c.addresses}
        unknown = {n.address: n.scale for n in self.nuisances}
        sizes = {**{a: 3.0 * s for a, s in unknown.items()}, **scales}
        if self.catalogue.refinement is not None:
            sizes[REFINED] = float(self.catalogue.refinement.divide)
        tasks = [(i, self.simulator.seeded(setting({a: s}))) for a, s in sizes.items() for i in range(len(self.groups))]
        results = iter(self.simulator.many(tasks, "effects"))
        changes: dict[Address, list[FloatArray]] = {}
        for a in sizes:
            change = [r - b if r is not None else None for r, b in zip((next(results) for _ in self.groups), self.base, strict=True)]
            if all(c is not None for c in change) and any(np.any(c) for c in change):
                changes[a] = [c for c in change if c is not None]
        self.evidence = self._whitened(changes, sizes, scales, unknown)
        return [c for c in self.catalogue.candidates if all(a in self.evidence.columns for a in c.addresses)]

    def _whitened(
        self,
        changes: dict[Address, list[FloatArray]],
        sizes: dict[Address, float],
        scales: dict[Address, float],
        unknown: dict[Address, float],
    ) -> Evidence:
        moved = np.array([np.any([np.any(c, axis=0) for c in change], axis=0) for a, change in changes.items() if a != REFINED])
        if not moved.any():
            raise DataError("no parameter of the catalogue changes any of the measured channels: there is nothing to diagnose with")
        self.active: npt.NDArray[np.bool_] = np.asarray(
            moved.any(axis=0)
        )  # what no effect can change says nothing; the gate has looked at it
        self.groups = [[x[:, self.active] for x in g] for g in self.groups]
        self.base = [b[:, self.active] for b in self.base]
        self.nominals = [[b[:, self.active] for b in group] for group in self.nominals]
        changes = {a: [c[:, self.active] for c in change] for a, change in changes.items()}
        channels = int(self.active.sum())
        rms = np.array([np.sqrt(np.mean(np.concatenate([c * c for c in change]), axis=0)) for change in changes.values()]).reshape(
            -1, channels
        )
        floor = np.array([TRUST * np.median(r[r > 1e-3 * r.max()]) if r.size and r.max() > 0.0 else 0.0 for r in rms.T])
        w = whitening(self.groups, floor)
        floor_of_noise = np.where(floor > 0.0, 0.0, 1e-9 + 1e-6 * np.abs(np.concatenate(self.base)).max(axis=0))
        if floor_of_noise.any():
            w = whitening(self.groups, floor + floor_of_noise)
        means = [np.asarray(np.mean(group, axis=0)) for group in self.nominals]
        # the mean of so many simulations scatters too
        counts = [
            len(g) * len(m) / (len(g) + len(m)) if len(m) > 1 else float(len(g)) for g, m in zip(self.groups, self.nominals, strict=True)
        ]
        laboratory = self.simulator.laboratory
        # change of each channel in a communication step
        rates = [np.gradient(m, axis=0) / laboratory.decimation for m in means]
        self.sudden = [SUDDEN * rate * np.sqrt(n) for rate, n in zip(rates, counts, strict=True)]
        residuals = [[w.apply(x - m, 1.0, s) for x in g] for g, m, s in zip(self.groups, means, self.sudden, strict=True)]
        halves = [
            (w.apply(np.mean(g[::2], axis=0) - m, 1.0, s), w.apply(np.mean(g[1::2] or g, axis=0) - m, 1.0, s))
            for g, m, s in zip(self.nominals, means, self.sudden, strict=True)
        ]
        counts = [n / DEPENDENCE for n in counts]
        y = np.concatenate([np.sqrt(n) * np.mean(r, axis=0) for n, r in zip(counts, residuals, strict=True)])
        blocks, start = {}, 0
        for i, n in enumerate([b.size for b in self.base]):
            blocks[self.simulator.laboratory.conditions[i].name] = slice(start, start + n)
            start += n
        raw = {
            a: np.concatenate([w.apply(c, n, s) for c, n, s in zip(change, counts, self.sudden, strict=True)])
            for a, change in changes.items()
        }
        columns = {a: raw[a] * (scales[a] / sizes[a]) for a in scales if a in raw}
        doubtful = [a for a in unknown if a in raw]
        nuisances = [raw[a] * (unknown[a] / sizes[a]) for a in doubtful]
        if REFINED in raw:
            doubtful.append(REFINED)
            nuisances.append(raw[REFINED])
        names = [c for c, on in zip(laboratory.channels, self.active, strict=True) if on]
        for component in dict.fromkeys(name.partition(".")[0] for name in names):
            here = np.array([name.partition(".")[0] == component for name in names])
            late = [w.apply(-LATENESS * rate * here, n, s) for rate, n, s in zip(rates, counts, self.sudden, strict=True)]
            doubtful.append((LOGGING, f"lag {component}.*"))
            nuisances.append(np.concatenate(late))
        spell = max(1, round(SPELL / (laboratory.system.step * laboratory.decimation)))
        own = []
        for i, (block, group) in enumerate(zip(blocks.values(), residuals, strict=True)):
            simulated = [w.apply(x - means[i], 1.0, self.sudden[i]) for x in self.nominals[i]]
            column = own_noise([group, simulated], channels, spell)
            own.append(np.zeros((y.size, column.shape[1])))
            own[-1][block] = column / np.sqrt(DEPENDENCE)
        doubtful += [(LOGGING, f"noise {i + 1}") for i in range(sum(o.shape[1] for o in own))]
        unknowns = np.concatenate([np.stack(nuisances, axis=1), *own], axis=1)
        space = Space(y, blocks, unknowns, doubtful)
        space.find_alike(columns, scales)
        return Evidence(space, w, residuals, columns, counts, halves)

    def signature(self, results: Sequence[FloatArray | None]) -> FloatArray | None:
        """Whitened change of simulations of all conditions against the nominal ones; None if one of them failed."""
        parts = []
        for r, b, n, s in zip(results, self.base, self.evidence.repeats, self.sudden, strict=True):
            if r is None:
                return None
            parts.append(self.evidence.whitening.apply(r[:, self.active] - b, n, s))
        return np.concatenate(parts)

    def nominal(self) -> Fit:
        """No effect."""
        s = self.evidence.space
        return Fit((), {}, {}, 0.0, s.energy, True, np.zeros_like(s.y), np.zeros((s.y.size, 0)))

    def screen(self, bases: Sequence[Fit]) -> list[Fit]:
        """Every model that is one of `bases` plus a candidate, as if signatures added up in proportion."""
        space = self.evidence.space
        stacked = np.stack([self.evidence.columns[a] for a in self._order()], axis=1)
        place = {a: i for i, a in enumerate(self._order())}
        gram = self._gram(stacked)
        found: dict[frozenset[str], Fit] = {}
        for base in bases:
            assert base.signature is not None
            assert base.columns is not None
            scales, _, _ = scaled_bounds(base.model)
            best = np.array([base.values[a] for c in base.model for a in c.addresses]) / (scales if len(scales) else 1.0)
            target = space.y - base.signature + base.columns @ best
            own, cross, on_target = space.dot(base.columns, base.columns), space.dot(base.columns, stacked), space.dot(stacked, target)
            base_target, constant = space.dot(base.columns, target), float(space.dot(target, target))
            for c in self.candidates:
                model = (*base.model, c)
                key = frozenset(m.name for m in model)
                if c in base.model or key in found or any(set(c.addresses) & set(m.addresses) for m in base.model):
                    continue
                at = [place[a] for a in c.addresses]
                if space.without([a for m in model for a in m.addresses]) is not space:
                    columns = np.concatenate([base.columns, stacked[:, at]], axis=1)
                    start = np.concatenate([best, np.zeros(len(at))])
                    found[key] = quadratic_fit(model, space.y, base.signature, columns, start, space)
                    continue
                hessian = np.block([[own, cross[:, at]], [cross[:, at].T, gram[np.ix_(at, at)]]])
                gradient = np.concatenate([base_target, on_target[at]])
                found[key] = solve(model, hessian, gradient, constant, space.energy, *scaled_bounds(model))
        return list(found.values())

    def _order(self) -> list[Address]:
        return list(dict.fromkeys(a for c in self.candidates for a in c.addresses))

    def _gram(self, stacked: FloatArray) -> FloatArray:
        if not hasattr(self, "_kept"):
            self._kept = self.evidence.space.dot(stacked, stacked)
        return self._kept

    def refine(self, fits: Sequence[Fit], bases: dict[Model, Fit] | None = None, rounds: int = 3) -> list[Fit]:
        """Gauss-Newton on real simulations, all models together (one simulation of each per round)."""
        space = self.evidence.space
        states = []
        for f in fits:
            columns = np.stack([self.evidence.columns[a] for c in f.model for a in c.addresses], axis=1)
            states.append(_State(f, columns, np.zeros(columns.shape[1]), np.zeros_like(space.y)))
        for _ in range(rounds):
            active = [s for s in states if not s.settled]
            if not active:
                break
            n = len(self.groups)
            results = self.simulator.many([(i, self.simulator.seeded(setting(s.fit.values))) for s in active for i in range(n)], "fits")
            for k, s in enumerate(active):
                signature = self.signature(results[k * n : (k + 1) * n])
                s.update(signature, space)
        return [s.best for s in states]

    def mean_signature(self, changes: Setting) -> FloatArray | None:
        """Whitened change that these settings make, as a mean over noise; None where the system cannot run."""
        groups = self.simulator.repeated(range(len(self.groups)), changes, POLISH, "fits")
        parts = []
        for g, b, weight, s in zip(groups, self.nominals, self.evidence.repeats, self.sudden, strict=True):
            if g is None:
                return None
            change = np.mean([x[:, self.active] for x in g], axis=0) - np.mean(b[: len(g)], axis=0)
            parts.append(self.evidence.whitening.apply(change, weight, s))
        return np.concatenate(parts)

    def polish(self, fits: Sequence[Fit]) -> list[Fit]:
        """The best of `fits` again, with simulations that are means over noise; a single one scatters as a measured run does."""
        if not self.simulator.laboratory.seeds:
            return list(fits)
        space = self.evidence.space
        polished = []
        for f in sorted(fits, key=lambda f: -f.log_evidence)[:POLISHED]:
            signature = self.mean_signature(setting(f.values))
            if signature is None:
                continue
            scales, _, _ = scaled_bounds(f.model)
            addresses = [a for c in f.model for a in c.addresses]
            x = np.array([f.values[a] for a in addresses]) / scales
            assert f.columns is not None
            better = quadratic_fit(f.model, space.y, signature, f.columns, x, space)
            move = np.array([better.values[a] for a in addresses]) / scales - x
            better.exact, better.columns, better.signature = True, f.columns, signature + f.columns @ move
            polished.append(better)
        return polished

    def run(self) -> list[Fit]:
        """All models looked at on real simulations, the nominal one first."""
        space = self.evidence.space
        fits = [self.nominal()]
        screened = sorted(self.screen(fits), key=lambda f: -f.log_evidence)
        self.screened = screened
        gain = space.energy - min((f.energy for f in screened), default=space.energy)
        chosen = [f for f in screened if space.energy - f.energy > 0.5 * gain][:SINGLES] or screened[:SINGLES]
        level = self.polish(self.refine(chosen))
        fits += level
        for size in (2, 3):
            bases = sorted(level, key=lambda f: -f.log_evidence)[: BASES if size == 2 else 1]
            best = max(f.log_evidence for f in fits)
            if not bases or self.adequate(max(bases, key=lambda f: f.log_evidence)):
                break
            grown = sorted(self.screen(bases), key=lambda f: -f.log_evidence)
            promising = [f for f in grown if f.log_evidence > best + 3.0][: EXTENSIONS * (BASES if size == 2 else 1)]
            level = self.polish(self.refine(promising))
            fits += level
        for f in sorted(fits[1:], key=lambda f: -f.log_evidence)[:3]:
            f.predictive = leave_one_out(f, space)
        return fits

    def adequate(self, fit: Fit) -> bool:
        """Whether what remains is small or noise."""
        after, deviation = self.gap(fit)
        before, _ = self.gap(self.nominal(), calibrated=False)
        return after < 4.0 * deviation or after < 0.02 * before

    def gap(self, fit: Fit, *, calibrated: bool = True) -> tuple[float, float]:
        """G: mean over pairs of repeats of r_a' W r_b with the model taken out, and its deviation by noise.

        `calibrated`: the nuisances are taken out too. Without repeats: energy less its expectation. In single-run units,
        summed over the conditions.
        """
        space = self.evidence.space
        assert fit.signature is not None
        explained = fit.signature
        if calibrated:
            explained = explained + space.without(list(fit.values)).explained(space.y - fit.signature)
        total, variance = 0.0, 0.0
        e = self.evidence
        for (_, block), residuals, weight, (one, other) in zip(space.blocks.items(), e.residuals, e.repeats, e.halves, strict=True):
            left = np.stack(residuals) - explained[block] / np.sqrt(weight)
            n, size = left.shape
            a, b = left - one, left - other  # independent simulations on both sides: their scatter does not count as a gap
            products, same = float(a.sum(axis=0) @ b.sum(axis=0)), float((a * b).sum())
            total += (products - same) / (n * (n - 1)) if n > 1 else same - size
            variance += 2.0 * size / (weight * DEPENDENCE) ** 2 if n > 1 else 2.0 * size
        return total, float(np.sqrt(variance)) * 1.5


def expected(catalogue: Catalogue, nuisances: Sequence[Nuisance], conditions: int) -> int:
    """About how many simulations a search takes that ends with single effects; more where effects are combined."""
    addresses = {a for c in catalogue.candidates for a in c.addresses} | {n.address for n in nuisances}
    return conditions * (NOMINAL + len(addresses) + 2 * SINGLES + POLISH * POLISHED)


class _State:
    """One model under refinement."""

    def __init__(self, fit: Fit, columns: FloatArray, x: FloatArray, signature: FloatArray) -> None:
        self.fit, self.columns, self.x, self.signature = fit, columns, x, signature
        self.scales, _, _ = scaled_bounds(fit.model)
        self.best, self.settled = fit, False
        self.energy = np.inf

    def update(self, signature: FloatArray | None, space: Space) -> None:
        """Take the simulation at the fit's values into account, fit again."""
        addresses = [a for c in self.fit.model for a in c.addresses]
        new = np.array([self.fit.values[a] for a in addresses]) / self.scales
        if signature is None:  # the system cannot run there: half of the way
            middle = 0.5 * (self.x + new)
            self.fit.values.update({a: float(v * s) for a, v, s in zip(addresses, middle, self.scales, strict=True)})
            return
        move = new - self.x
        length = float(move @ move)
        if length > 0.0:
            self.columns = self.columns + np.outer(signature - self.signature - self.columns @ move, move) / length
        left = space.y - signature
        energy = float(space.without(addresses).dot(left, left))
        fit = quadratic_fit(self.fit.model, space.y, signature, self.columns, new, space)
        if energy < self.energy:
            # its evidence is that of the quadratic about these values, at their real energy
            self.energy = energy
            spread = fit.deviations
            values = dict(self.fit.values)
            evidence = fit.log_evidence - 0.5 * max(energy - fit.energy, 0.0)
            self.best = Fit(self.fit.model, values, spread, evidence, energy, True, signature, self.columns)
        step = np.array([fit.values[a] for a in addresses]) / self.scales - new
        width = np.array([fit.deviations[a] for a in addresses]) / self.scales
        self.settled = bool(np.all(np.abs(step) < np.maximum(0.3 * width, 0.002 * np.abs(new))))
        self.x, self.signature, self.fit = new, signature, fit
