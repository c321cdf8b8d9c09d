"""The search for the effects that explain the gap: linear fits of all, refinement on real simulations, pairs and triples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from robomill.diagnosis.catalogue import LOGGING, Address, Candidate, Catalogue, Nuisance
from robomill.diagnosis.experiment.simulation import Simulator, setting
from robomill.diagnosis.inference.adequacy import COHERENT, FALSE_ALARM, LEVEL, MISFIT, UNKNOWN, beyond, unexplained
from robomill.diagnosis.inference.estimation import Fit, Gram, Model, Space, leave_one_out, quadratic_fit, scaled_bounds, solved
from robomill.diagnosis.inference.evidence import dependence
from robomill.diagnosis.inference.sensitivities import LARGE, NOMINAL, WORTH, Sensitivities, per_scale
from robomill.orchestration.slaves.protocol import FloatArray

POLISH, POLISHED = 6, 8
"""Simulations with different noise at the best values of a model, and how many models of each size get them."""
SHARPENED, ROUGH = 2, 1.15
"""How many models of each size are fitted with slopes of their own place, if they leave more than this times noise."""
SHARPER, BETTER = 5, 0.99
"""How often slopes are taken anew at most, and the part of chi2 that must not be left for it to go on."""
GROWTH_GAIN = 12.0
"""Gain in evidence [nats], as sensitivities and noise have it, from which models with a further effect are simulated."""
SUBSTANTIAL = 0.05
"""Part of what is left beyond noise that another effect must explain."""
FAULT = 0.67
"""Part of what is left beyond noise that a fault of the log must explain. It can be modelled exactly: what is left of something else is no
reason to reject a log."""
FAR, NEARBY = 50.0, 0.4
"""Log of the odds against a model, beside the best of its size, from which it is not looked at more closely; or that part of the gain."""
SINGLES, BASES, EXTENSIONS = 10, 3, 4
"""How many single candidates are refined, how many of them grow, and by how many partners each."""
HIDDEN = 0.1
"""Part of a gap without the tolerances like it that a candidate leaves, which is looked at though with them it seems to be of no use."""
GUESSES = 4
"""How often noise is guessed anew from what the best model leaves: once more than a model has effects, at most."""

Values = Mapping[Address, float]
"""What numbers are changed by [unit]."""


class Search:
    """Fits on the first `len(groups)` conditions of the simulator's laboratory; `groups` are their measured repeats [samples, channels].

    `evidence`: whitened residuals, sensitivities and nuisances; `candidates`: those that change anything; `starts`: where fits begin that
    do not begin at zero.
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
        """`left`: what a model leaves of each run, from which noise is guessed where nothing was repeated; `dispersion`: see `Evidence`."""
        self.nuisances = nuisances
        self.catalogue, self.simulator, self.groups = catalogue, simulator, groups
        sensitivities = Sensitivities(catalogue, simulator, groups, nuisances, left, dispersion)
        self.evidence, self.candidates, self.starts = sensitivities.evidence, sensitivities.candidates, sensitivities.starts
        self.bent = sensitivities.bent

    @cached_property
    def together(self) -> tuple[FloatArray, Gram]:
        """What each parameter of the candidates does per prior scale, [n, parameters], and the products of that.

        To be asked for when the search is over: its candidates and their sensitivities are what they are then.
        """
        columns = np.stack([per_scale(self.evidence, self.starts, a) for a in addresses_of(self.candidates)], axis=1)
        return columns, self.evidence.space.gram(columns)

    @property
    def growth(self) -> float:
        """Gain in evidence [nats] from which models with a further effect are simulated: GROWTH_GAIN of noise alone."""
        return GROWTH_GAIN / self.evidence.dispersion

    def nominal(self) -> Fit:
        """The fit of the nominal model, which has no effect: log evidence 0, signature 0."""
        s = self.evidence.space
        return Fit((), {}, {}, 0.0, s.chi2, np.zeros_like(s.y), np.zeros((s.y.size, 0)))

    def explainable(self, left: FloatArray) -> float:
        """chi2 that all candidates together explain of a residual [n], over what they explain of noise: the trace of the smoother.

        Beyond 1, COHERENT of it counts. Each has a normal prior of its own scale. After a right model nothing is left that others could
        explain; after the nearest thing in a catalogue to something else there is.
        """
        columns, known = self.together
        space, k = self.evidence.space, columns.shape[1]
        gram = space.within(space.beside(known, columns, left[:, None]), range(k + 1))
        inverse = np.linalg.inv(gram[:-1, :-1] + np.eye(k))
        freedom = float(np.trace(inverse @ gram[:-1, :-1]))
        noise = max(freedom, 1.0) * self.evidence.guess / self.evidence.dispersion
        return 1.0 + COHERENT * (float(gram[:-1, -1] @ inverse @ gram[:-1, -1]) / noise - 1.0)

    def linear_fits(self, bases: Sequence[Fit]) -> list[Fit]:
        """Every model that is one of `bases` plus a candidate, as if signatures added up in proportion: s + (ds/dx) (x - best) + v x'.

        v is the sensitivity of the candidate, x' its size; no simulation is made. The parameters of the base are fitted again, too. Of the
        variants of a candidate the best one; all of them where they are not proportional to their size: sensitivities say too little.
        """
        space = self.evidence.space
        place = {a: i for i, a in enumerate(addresses_of(self.candidates))}
        stacked = np.stack([self.evidence.sensitivities[a] for a in place], axis=1)
        known, count = space.gram(stacked), len(place)
        found: dict[frozenset[Candidate], Fit] = {}
        for base in bases:
            assert base.signature is not None
            assert base.sensitivities is not None
            scales, _, _ = scaled_bounds(base.model)
            best = np.array([base.values[a] for c in base.model for a in c.addresses]) / (scales if len(scales) else 1.0)
            target = space.y - base.signature + base.sensitivities @ best
            wide = space.widened(base.form)
            gram = wide.beside(known, stacked, np.column_stack([base.sensitivities, target]))
            own_columns = range(count, count + len(best))
            for c in self.candidates:
                model = (*base.model, c)
                key = frozenset(model)
                if key in found or any(c.excludes(m) for m in base.model):
                    continue
                there = self.starts.get(c.addresses[0])
                if there is not None:
                    sensitivities = np.concatenate([base.sensitivities, there.sensitivity[:, None]], axis=1)
                    start = np.append(best, there.x)
                    fit = quadratic_fit(model, base.signature + there.signature, sensitivities, start, space, base.form)
                else:
                    own = wide.without([a for m in model for a in m.addresses])
                    products = own.within(gram, [*own_columns, *(place[a] for a in c.addresses), count + len(best)])
                    fit = solved(model, products, space, own)
                found[key] = fit
        kept: dict[frozenset[tuple[str, object]], Fit] = {}
        for fit in sorted(found.values(), key=_evidence):
            kept[frozenset((m.name, m.fixed if m.name in self.bent else ()) for m in fit.model)] = fit
        return list(kept.values())

    def refine(self, fits: Sequence[Fit], rounds: int = 5) -> list[Fit]:
        """Gauss-Newton on real simulations, all models together (one simulation of each per round): the best of each that was simulated.

        Sensitivities S follow by Broyden's rule from the step dx and what it did: S + (ds - S dx) dx' / dx'dx.
        """
        space = self.evidence.space
        states = []
        for f in fits:
            addresses = [a for c in f.model for a in c.addresses]
            there = [self.starts.get(a) for a in addresses]
            sensitivities = np.stack(
                [self.evidence.sensitivities[a] if t is None else t.sensitivity for a, t in zip(addresses, there, strict=True)], axis=1
            )
            beginning: FloatArray = sum((t.signature for t in there if t is not None), np.zeros_like(space.y))
            states.append(_State(f, sensitivities, np.array([0.0 if t is None else t.x for t in there]), beginning))
        for _ in range(rounds):
            active = [s for s in states if not s.settled]
            if not active:
                break
            for s, signature in zip(active, self._single([s.fit.values for s in active]), strict=True):
                s.update(signature, space)
        return [s.best for s in states]

    def _single(self, values: Sequence[Values], calibrated: Values = MappingProxyType({})) -> list[FloatArray | None]:
        """As `mean_signature`, of one simulation each."""
        n, slopes = len(self.groups), self._by_slopes(calibrated)
        settings = [self.simulator.seeded(setting({**v, **calibrated})) for v in values]
        results = self.simulator.many([(i, changes) for changes in settings for i in range(n)], "fits")
        whole = [self.evidence.signature(results[k * n : (k + 1) * n]) for k in range(len(settings))]
        return [None if s is None else s - slopes for s in whole]

    def mean_signature(self, values: Values, calibrated: Values = MappingProxyType({})) -> FloatArray | None:
        """Whitened change that these values [unit] make, [n], as a mean over POLISH simulations; None where the system cannot run.

        What `calibrated` numbers [unit] do by their slopes is no part of it: nuisances have that.
        """
        changes = setting({**values, **calibrated})
        whole = self.evidence.mean_signature(self.simulator.repeated(range(len(self.groups)), changes, POLISH, "fits"))
        return None if whole is None else whole - self._by_slopes(calibrated)

    def _by_slopes(self, calibrated: Values) -> FloatArray:
        """What calibrated numbers [unit] do by their slopes, whitened, [n]."""
        space = self.evidence.space
        deviations = {n.address: calibrated[n.address] / n.scale for n in self.nuisances if n.address in calibrated}
        return np.asarray(space.nuisances @ np.array([deviations.get(name, 0.0) for name in space.names]))

    def calibrated(self, fit: Fit) -> tuple[list[Nuisance], FloatArray, FloatArray]:
        """The calibrated numbers that a model leaves to the nuisances, and where it has them: their means and variances, [k] each.

        These are of the posterior, in standard deviations of the tolerances.
        """
        assert fit.signature is not None
        space = self.evidence.space.without(list(fit.values))
        places = {a: i for i, a in enumerate(space.names) if a not in space.gone}
        numbers = [n for n in self.nuisances if n.address in places]
        here = [places[n.address] for n in numbers]
        return numbers, space.moved(space.y - fit.signature)[here], space.variances[here]

    def calibrate(self, fit: Fit) -> Fit:
        """The fit again with its calibrated numbers as far off as the data have them, simulated, while that explains more.

        Slopes say what a small change does. A loop that is at a limit does something else with a larger one, and an effect that is the same
        as a tolerance would be named for the rest. It ends where a number is farther off than one of so many is with FALSE_ALARM.
        """
        own = self.evidence.space.without(list(fit.values))
        for _ in range(SHARPER):
            assert fit.sensitivities is not None
            numbers, means, _ = self.calibrated(fit)
            if np.max(np.abs(means), initial=0.0) > beyond(len(numbers), FALSE_ALARM):
                break
            calibrated = {n.address: float(z) * n.scale for n, z in zip(numbers, means, strict=True)}
            there = self.mean_signature(fit.values, calibrated)
            if there is None or own.chi2_of((own.y - there)[:, None])[0] > BETTER * fit.chi2:
                break
            fit = replace(self.about(fit, there, fit.sensitivities), calibrated=calibrated)
        return fit

    def polish(self, fits: Sequence[Fit], linear: Sequence[Fit]) -> list[Fit]:
        """The best of `fits` again, with simulations that are means over noise; a single one scatters as a measured run does.

        `linear`: the linear fits of the same models. Where an effect takes the noise out, a single simulation looks worse than it is, so
        the better of both evidences counts for which ones are the best.
        """
        if not self.simulator.laboratory.seeds:  # there is no noise to take out, and what has been simulated holds
            ran = [(f, f.signature, f.sensitivities) for f in fits]
            return [self._kept(f, self.about(f, s, d)) for f, s, d in ran if s is not None and d is not None]  # the others never ran
        polished = []
        best = max((f.log_evidence for f in fits), default=0.0)
        expected = {f.model: max(f.log_evidence, p.log_evidence) for f, p in zip(fits, linear, strict=True)}
        near = [f for f in fits if expected[f.model] > best - max(FAR, NEARBY * best)]
        for f in sorted(near, key=lambda f: -expected[f.model])[:POLISHED]:
            signature = self.mean_signature(f.values, f.calibrated)
            if signature is None:
                continue
            assert f.sensitivities is not None
            polished.append(self.about(f, signature, f.sensitivities))
        return polished

    def about(self, fit: Fit, signature: FloatArray, sensitivities: FloatArray) -> Fit:
        """The best fit near the values of another one, where the signature and its slopes are these."""
        scales, _, _ = scaled_bounds(fit.model)
        addresses = [a for c in fit.model for a in c.addresses]
        x = np.array([fit.values[a] for a in addresses]) / scales
        form = self.evidence.form(fit.model, signature, sensitivities, x)
        better = quadratic_fit(fit.model, signature, sensitivities, x, self.evidence.space, form)
        if form is not None:  # what the form may do otherwise counts in the evidence; it is no part of what the model explains
            plain = quadratic_fit(fit.model, signature, sensitivities, x, self.evidence.space)
            better.values, better.deviations, better.chi2 = plain.values, plain.deviations, plain.chi2
        move = np.array([better.values[a] for a in addresses]) / scales - x
        better.sensitivities, better.signature = sensitivities, signature + sensitivities @ move
        better.calibrated = fit.calibrated
        return better

    def _kept(self, ran: Fit, better: Fit) -> Fit:
        """`better`, which slopes say of a fit that was simulated; the simulated one, where they would have it move on.

        Slopes reach so far only: where a machine rests, those of the way there go on.
        """
        if all(_settled(better.values[a] - v, better.deviations[a], v) for a, v in ran.values.items()):
            return better
        chi2 = self._chi2(ran)
        evidence = better.log_evidence - 0.5 * max(chi2 - better.chi2, 0.0)
        return replace(better, values=ran.values, signature=ran.signature, chi2=chi2, log_evidence=evidence)

    def sharpen(self, fit: Fit) -> Fit:
        """The fit again with the slopes of the signature where it is: those of the way there miss an effect that turns with its size."""
        space = self.evidence.space
        own = space.without([a for c in fit.model for a in c.addresses])

        def chi2(signature: FloatArray) -> float:
            return float(own.dot(space.y - signature, space.y - signature))

        here = self.mean_signature(fit.values, fit.calibrated)
        for _ in range(SHARPER):
            slopes = self.slopes(fit) if here is not None else None
            if here is None or slopes is None:
                break
            trial = self.about(fit, here, slopes)
            there = self.mean_signature(trial.values, trial.calibrated)
            if there is None or chi2(there) > BETTER * chi2(here):
                break
            assert trial.sensitivities is not None
            fit, here = self.about(trial, there, trial.sensitivities), there
        return fit

    def fitted(self, model: Model, values: Mapping[Address, float], deviations: Mapping[Address, float]) -> Fit | None:
        """The best fit of a model near these values [unit], by slopes of its own place; None where the system cannot run.

        `deviations` [unit]: steps of the slopes.
        """
        start = Fit(model, dict(values), dict(deviations), -np.inf, np.inf)
        here, slopes = self.mean_signature(values), self.slopes(start)
        if here is None or slopes is None:
            return None
        best = self.sharpen(self.about(start, here, slopes))
        there = self.mean_signature(best.values, best.calibrated)
        assert best.sensitivities is not None
        return None if there is None else self.about(best, there, best.sensitivities)

    def slopes(self, fit: Fit) -> FloatArray | None:
        """ds/dx of a model at its values, per prior scale [n, parameters], by one difference each; None where the system cannot run."""
        addresses = [a for c in fit.model for a in c.addresses]
        scales, _, high = scaled_bounds(fit.model)
        moved = []
        for a, scale, bound in zip(addresses, scales, high, strict=True):
            step = max(fit.deviations[a], 0.05 * abs(fit.values[a]))
            moved.append((a, step if fit.values[a] + step < bound * scale else -step))
        trials = [fit.values, *({**fit.values, a: fit.values[a] + step} for a, step in moved)]
        signatures = self._single(trials, fit.calibrated)
        known = [x for x in signatures if x is not None]
        if len(known) < len(signatures):
            return None
        return np.stack([(x - known[0]) * (scale / step) for x, scale, (_, step) in zip(known[1:], scales, moved, strict=True)], axis=1)

    def _sharpened(self, fits: Sequence[Fit]) -> list[Fit]:
        """These fits, best first; the SHARPENED best `sharpen`ed, and `calibrate`d, where they leave more than ROUGH times noise."""
        found = sorted(fits, key=_evidence, reverse=True)
        for finer in (self.sharpen, self.calibrate):
            found = [finer(f) if k < SHARPENED and self._rough(f) else f for k, f in enumerate(found)]
        return found

    def _rough(self, fit: Fit) -> bool:
        return fit.chi2 > ROUGH * float(self.evidence.expected.sum())

    def run(self) -> list[Fit]:
        """All models that were fitted on real simulations, the nominal one first."""
        space = self.evidence.space
        nominal = self.nominal()
        singles = sorted(self.linear_fits([nominal]), key=_evidence, reverse=True)
        fits = [self.calibrate(nominal) if self._rough(nominal) else nominal]
        gain = space.chi2 - min((f.chi2 for f in singles), default=space.chi2)
        chosen = _first([f for f in singles if space.chi2 - f.chi2 > WORTH * gain], SINGLES) or _first(singles, SINGLES)
        chosen += [f for f in singles if f not in chosen and self._hidden(f)]
        level = self._sharpened(self.polish(self.refine(chosen), chosen))
        fits += level
        fits = self._grown(fits, self._best(level, BASES))
        while (others := self._exchanged(max(fits, key=_evidence), fits)) and max(others, key=_evidence).log_evidence > _most(fits):
            fits = self._grown(fits + others, self._best(others, 1))
        fits = _distinct([f for f in fits + others if f.large_enough()])
        for f in sorted(fits[1:], key=_evidence, reverse=True)[:3]:
            f.predictive = {name: part.predicted for name, part in leave_one_out(f, space).items()}
        return fits

    def _grown(self, fits: list[Fit], bases: Sequence[Fit]) -> list[Fit]:
        """`fits`, and models with one effect more than `bases`, one more than these, and so on while that is worth it."""
        while bases:
            best = _most(fits)
            grown = sorted(self.linear_fits(bases), key=_evidence, reverse=True)
            # a fault of the log does what its signature says: one that explains too little takes no place from others
            exact = [f for f in grown if not any(c.component == LOGGING for c in f.model) or self._worth(f, fits)]
            chosen = _first([f for f in exact if f.log_evidence > best + self.growth], EXTENSIONS * len(bases))
            hidden = {frozenset(f.model) for f in grown if f not in chosen and self._hidden(f)}
            chosen += [f for f in grown if frozenset(f.model) in hidden]
            level = [f for f in self._sharpened(self.polish(self.refine(chosen), chosen)) if self._worth(f, fits)]
            level = [f for f in level if frozenset(f.model) not in hidden or f.log_evidence > best + self.growth]
            smaller = self._smaller(level, fits)
            again = {frozenset(f.model) for f in smaller}
            fits = [f for f in fits if frozenset(f.model) not in again] + level + smaller
            bases = self._best(smaller, 1) if any(f is max(fits, key=_evidence) for f in smaller) else self._best(level, 1)
            if bases and bases[0].log_evidence <= best:
                break
        return fits

    def _exchanged(self, best: Fit, known: Sequence[Fit]) -> list[Fit]:
        """Models that have another effect, or none, in place of one of `best`: the likeliest by sensitivities, fitted on simulations.

        What came first, when little else was known, may stand for two that came later.
        """
        if len(best.model) <= 1:
            return []
        fewer = [_without(best, c) for c in best.model]
        seen = {frozenset(f.model) for f in known}
        swapped = [f for f in sorted(self.linear_fits(fewer), key=_evidence, reverse=True) if frozenset(f.model) not in seen]
        trials = [f for f in swapped if f.log_evidence > best.log_evidence - self.growth][:EXTENSIONS]
        trials += [f for f in fewer if frozenset(f.model) not in seen]
        level = self._sharpened(self.polish(self.refine(trials), trials))
        return level + self._replaced(best, fewer, [f for f in swapped if f not in trials])

    def _replaced(self, best: Fit, fewer: Sequence[Fit], swapped: Sequence[Fit]) -> list[Fit]:
        """Models that have another effect in place of one of `best`: those of `swapped` that make up for most of what it explains.

        They are fitted with slopes of their own place, however unlikely they are by sensitivities: the others' were taken beside what is
        out. Where one is as likely as `best`, so are those with one effect less: what was needed beside a stand-in may not be any more.
        `fewer`: `best` without each of its effects.
        """
        places: list[float] = []
        trials: list[Fit] = []
        for c, without in zip(best.model, fewer, strict=True):
            there = [f for f in swapped if c.name not in _names(f) and set(without.model) < set(f.model)]
            trials += _first(there, SHARPENED)
            places += [self._chi2(without)] * (len(trials) - len(places))
        ran = [(f, lost) for f, lost in zip(self.refine(trials), places, strict=True) if f.signature is not None and lost > best.chi2]
        ranked = sorted(ran, key=lambda pair: (pair[0].chi2 - best.chi2) / (pair[1] - best.chi2))
        likeliest = [self.sharpen(f) for f, _ in ranked[:EXTENSIONS]]
        equal = [f for f in likeliest if f.log_evidence > best.log_evidence - self.growth]
        less = [_without(f, c) for f in equal for c in f.model]
        return likeliest + self._sharpened(self.polish(self.refine(less), less)) + self._smaller(equal, ())

    def _chi2(self, fit: Fit) -> float:
        """What a fit leaves by its signature."""
        assert fit.signature is not None
        left = self.evidence.space.y - fit.signature
        return float(self.evidence.space.without(list(fit.values)).dot(left, left))

    def _hidden(self, fit: Fit) -> bool:
        """Whether the last effect of a model explains nearly all of a large gap that tolerances explain better, by its linear fit.

        Against a gap that is hundreds of times the noise no sensitivity is exact enough; a simulation is.
        """
        space = self.evidence.space
        own, before = space.without(list(fit.values)), space.without([a for c in fit.model[:-1] for a in c.addresses])
        return own is not before and own.chi2 > LARGE * float(self.evidence.expected.sum()) and fit.chi2 < HIDDEN * own.chi2

    def _best(self, level: Sequence[Fit], count: int) -> list[Fit]:
        best = {_names(f): f for f in sorted(level, key=_evidence)}  # variants do not grow beside each other
        return sorted(best.values(), key=_evidence, reverse=True)[:count]

    def _smaller(self, level: Sequence[Fit], known: Sequence[Fit]) -> list[Fit]:
        """Models that are left of others when effects too small to count are out, where they beat all that is known of them.

        A strong effect that its own sensitivity misses may come as the partner of what stood in for it.
        """
        found: list[Fit] = []
        left = [f for f in level if not f.large_enough()]
        while left:
            fit = left.pop()
            model = tuple(c for c in fit.model if c.large_enough(fit.values))
            if not model:
                continue
            assert fit.sensitivities is not None
            addresses = [a for c in fit.model for a in c.addresses]
            kept = [i for i, a in enumerate(addresses) if any(a in c.addresses for c in model)]
            values = {addresses[i]: fit.values[addresses[i]] for i in kept}
            signature = self.mean_signature(values, fit.calibrated)
            if signature is None:
                continue
            trial = Fit(model, values, {a: fit.deviations[a] for a in values}, 0.0, 0.0, calibrated=fit.calibrated)
            better = self.sharpen(self.about(trial, signature, fit.sensitivities[:, kept]))
            same = [f for f in (*known, *found) if set(f.model) == set(model)]
            if all(better.log_evidence > f.log_evidence for f in same):
                found = [f for f in found if f not in same] + [better]
                left += [better] if not better.large_enough() else []
        return found

    def _worth(self, fit: Fit, fits: Sequence[Fit]) -> bool:
        """Whether the effects of a model explain enough of what is left without one of them.

        What is left of a strong effect that is modelled a little otherwise would else be given to one small effect after the other.
        """
        noise = float(self.evidence.expected.sum())

        def part(known: Fit) -> float:
            return FAULT if any(c.component == LOGGING for c in fit.model if c not in known.model) else SUBSTANTIAL

        without = [f for f in fits if set(f.model) < set(fit.model)]
        return all(f.chi2 > noise and fit.chi2 - noise < (1.0 - part(f)) * (f.chi2 - noise) for f in without)

    def gap(self, fit: Fit, *, calibrated: bool = True) -> tuple[float, float]:
        """G: mean over pairs of repeats of r_a' W r_b with the model taken out, and its deviation by noise.

        `calibrated`: the nuisances are taken out too. Without repeats: chi2 less its expectation. In single-run units,
        summed over the conditions.
        """
        space = self.evidence.space
        assert fit.signature is not None
        explained = fit.signature
        if calibrated:
            explained = explained + space.without(list(fit.values)).explained(space.y - fit.signature)
        total, variance = 0.0, 0.0
        e = self.evidence
        for block, residuals, weight, (one, other), apart in zip(
            space.blocks.values(), e.residuals, e.repeats, e.halves, e.independent, strict=True
        ):
            left = np.stack(residuals) - explained[block] / np.sqrt(weight)
            n, size = len(left), int(np.count_nonzero(e.expected[block]))  # of channels that are not measured there, nothing is expected
            a, b = left - one, left - other  # independent simulations on both sides: their scatter does not count as a gap
            products, same = float(a.sum(axis=0) @ b.sum(axis=0)), float((a * b).sum())
            total += (products - same) / (n * (n - 1)) if n > 1 else same - size
            variance += 2.0 * size / (weight * dependence(apart) * e.dispersion) ** 2 if n > 1 else 2.0 * size
        return total, float(np.sqrt(variance)) * 1.5


def searched(
    catalogue: Catalogue, simulator: Simulator, groups: Sequence[Sequence[FloatArray]], nuisances: Sequence[Nuisance]
) -> tuple[Search, list[Fit]]:
    """A search and the models that it has fitted, the nominal one first.

    Where nothing was repeated, noise is what the best model leaves: guessed from what the nominal one leaves, and again from what is left
    of the best one, until that is the same model. What is measured itself says nothing of noise: it moves. What all candidates together
    leave of independent samples does not depend on the best model: it is not guessed again.

    Where noise is known, the best model may explain a large gap as well as laws do, and still leave more than noise and discrepancy are.
    Whatever that is takes part in every difference of two models. So the search is made once more, with all log-likelihoods divided by
    what is left over noise and discrepancy (the dispersion of quasi-likelihood, Wedderburn, Biometrika 61 (1974) 439).
    """
    search = Search(catalogue, simulator, groups, nuisances)
    fits = search.run()
    evidence = search.evidence
    for _ in range(GUESSES if evidence.whitening.guessed and not all(evidence.independent) else 0):
        best = max(fits, key=_evidence)
        simulated = simulator.repeated(range(len(groups)), setting(best.values), POLISH, "noise")
        if any(s is None for s in simulated):
            break
        left = [[x - np.mean(s, axis=0) for x in g] for g, s in zip(groups, simulated, strict=True) if s is not None]
        search = Search(catalogue, simulator, groups, nuisances, left)
        fits = search.run()
        if set(max(fits, key=_evidence).model) == set(best.model):
            break
    if not evidence.whitening.guessed and evidence.judged.any():
        before, after = (_over(search, f) for f in (fits[0], max(fits, key=_evidence)))
        if after > UNKNOWN and unexplained(before, after) < MISFIT:
            search = Search(catalogue, simulator, groups, nuisances, dispersion=after / LEVEL)
            fits = search.run()
    return search, fits


def _over(search: Search, fit: Fit) -> float:
    """What a model leaves over what noise and discrepancy do [1]: the mean over judged channels and conditions."""
    assert fit.signature is not None
    return float(np.mean(search.evidence.levels(search.evidence.space.y - fit.signature)))


def likely_count(catalogue: Catalogue, nuisances: Sequence[Nuisance], conditions: int) -> int:
    """About how many simulations a search takes that ends with single effects; more where effects are combined."""
    addresses = {a for c in catalogue.candidates for a in c.addresses} | {n.address for n in nuisances}
    return conditions * (NOMINAL + len(addresses) + 2 * SINGLES + POLISH * POLISHED)


def addresses_of(candidates: Sequence[Candidate]) -> list[Address]:
    """The parameters of all these candidates, each once."""
    return list(dict.fromkeys(a for c in candidates for a in c.addresses))


def _evidence(fit: Fit) -> float:
    return fit.log_evidence


def _most(fits: Sequence[Fit]) -> float:
    return max(f.log_evidence for f in fits)


def _distinct(fits: Sequence[Fit]) -> list[Fit]:
    """The best fit of each model, in the order in which they came: a model that was fitted twice is no likelier for that."""
    best = {frozenset(f.model): f for f in sorted(fits, key=_evidence)}
    return [f for f in fits if best[frozenset(f.model)] is f]


def _without(fit: Fit, candidate: Candidate) -> Fit:
    """The model without one of its effects, as sensitivities have it: nothing is fitted again."""
    assert fit.signature is not None
    assert fit.sensitivities is not None
    order = [(c, a) for c in fit.model for a in c.addresses]
    here = [i for i, (c, _) in enumerate(order) if c == candidate]
    kept = [i for i, (c, _) in enumerate(order) if c != candidate]
    x = np.array([fit.values[a] / c.prior.scale for c, a in order])
    model = tuple(c for c in fit.model if c != candidate)
    values, deviations = ({a: known[a] for c in model for a in c.addresses} for known in (fit.values, fit.deviations))
    signature = fit.signature - fit.sensitivities[:, here] @ x[here]
    return Fit(model, values, deviations, -np.inf, np.inf, signature, fit.sensitivities[:, kept], form=fit.form)


def _names(fit: Fit) -> frozenset[str]:
    """Which effects a model has, in whatever variant."""
    return frozenset(c.name for c in fit.model)


def _first(fits: Sequence[Fit], count: int) -> list[Fit]:
    """The first `count` of these fits, best first, one for each set of effects; and all variants of the first SHARPENED of these sets."""
    best: dict[frozenset[str], Fit] = {}
    for fit in fits:
        best.setdefault(_names(fit), fit)
    sets = list(best)
    return [f for f in fits if _names(f) in sets[:count] and (f is best[_names(f)] or _names(f) in sets[:SHARPENED])]


def _settled(step: float, width: float, value: float) -> bool:
    """Whether a step of a fit matters little beside the deviation of the value, or the value."""
    return abs(step) < max(0.3 * width, 0.002 * abs(value))


class _State:
    """One model under refinement."""

    def __init__(self, fit: Fit, sensitivities: FloatArray, x: FloatArray, signature: FloatArray) -> None:
        self.fit, self.sensitivities, self.x, self.signature = fit, sensitivities, x, signature
        self.scales, _, _ = scaled_bounds(fit.model)
        self.best, self.settled = fit, False
        self.chi2 = np.inf

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
            self.sensitivities = self.sensitivities + np.outer(signature - self.signature - self.sensitivities @ move, move) / length
        left = space.y - signature
        chi2 = float(space.without(addresses).dot(left, left))
        fit = quadratic_fit(self.fit.model, signature, self.sensitivities, new, space)
        if chi2 < self.chi2:
            # its evidence is that of the quadratic about these values, at their real chi2
            self.chi2 = chi2
            spread = fit.deviations
            values = dict(self.fit.values)
            evidence = fit.log_evidence - 0.5 * max(chi2 - fit.chi2, 0.0)
            self.best = Fit(self.fit.model, values, spread, evidence, chi2, signature, self.sensitivities)
        self.settled = all(_settled(fit.values[a] - self.fit.values[a], fit.deviations[a], self.fit.values[a]) for a in addresses)
        self.x, self.signature, self.fit = new, signature, fit
