"""Models fitted on simulations: by Gauss-Newton, with slopes of their own place, with calibrated numbers as the data have them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from robomill.diagnosis.candidates import Address, Candidate, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.simulation import Simulator, setting
from robomill.diagnosis.inference.adequacy import FALSE_ALARM, beyond
from robomill.diagnosis.inference.estimation import Fit, Gram, Model, Space, quadratic_fit, scaled_bounds, solved
from robomill.diagnosis.inference.sensitivities import BENT, Sensitivities, cosine, per_scale
from robomill.orchestration.slaves.protocol import FloatArray

POLISH, POLISHED = 6, 8
"""Simulations with different noise at the best values of a model, and how many models of each size get them."""
SHARPENED, ROUGH = 2, 1.15
"""How many models of each size are fitted with slopes of their own place, if they leave more than this times noise."""
SHARPER, BETTER = 5, 0.99
"""How often slopes are taken anew at most, and the part of chi2 that must not be left for it to go on."""
FAR, NEARBY = 50.0, 0.4
"""Log of the odds against a model, beside the best of its size, from which it is not looked at more closely; or that part of the gain."""

Values = Mapping[Address, float]
"""What numbers are changed by [unit]."""


class Fitting:
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
        self.bent, self.sizes, self.scales = sensitivities.bent, sensitivities.sizes, sensitivities.scales
        self._anew = False

    def nominal(self) -> Fit:
        """The fit of the nominal model, which has no effect: log evidence 0, signature 0."""
        s = self.evidence.space
        return Fit((), {}, {}, 0.0, s.chi2, np.zeros_like(s.y), np.zeros((s.y.size, 0)))

    @cached_property
    def alone(self) -> tuple[list[Address], FloatArray, Gram]:
        """Parameters of the candidates, their sensitivities [n, parameters] and products of these, as the search begins with them."""
        addresses = addresses_of(self.candidates)
        stacked = np.stack([self.evidence.sensitivities[a] for a in addresses]).T
        return addresses, stacked, self.evidence.space.gram(stacked)

    def turned(self, fit: Fit) -> bool:
        """Whether the slopes of a model point elsewhere at its values than at the nominal system (cosine below BENT), where it is `rough`.

        Then those of all others may, too: a loop with another gain answers otherwise to everything. It is asked of one model of a search.
        """
        if self._anew or not fit.model or fit.sensitivities is None or not self.rough(fit):
            return False
        before = [per_scale(self.evidence, self.starts, a) for c in fit.model for a in c.addresses]
        return any(cosine(v, own) < BENT for v, own in zip(before, fit.sensitivities.T, strict=True))

    def beside(self, fit: Fit) -> tuple[list[Address], FloatArray, Gram]:
        """As `alone`, with the slopes that the candidates have beside a model, by one simulation each.

        Those that cannot run beside it keep the slope that they have alone.
        """
        addresses, stacked, _ = self.alone
        assert fit.sensitivities is not None
        own = dict(zip((a for c in fit.model for a in c.addresses), fit.sensitivities.T, strict=True))
        sizes = {a: s.x if (s := self.starts.get(a)) is not None else self.sizes[a] for a in addresses if a not in own}
        trials = [fit.values, *({**fit.values, a: x * self.scales[a]} for a, x in sizes.items())]
        here, *there = self._single(trials, fit.calibrated)
        columns = {a: (s - here) / sizes[a] for a, s in zip(sizes, there, strict=True) if s is not None and here is not None} | own
        stacked = np.stack([columns.get(a, stacked[:, i]) for i, a in enumerate(addresses)]).T
        self._anew = True
        return addresses, stacked, self.evidence.space.gram(stacked)

    def linear_fits(self, bases: Sequence[Fit], at: Fit | None = None) -> list[Fit]:
        """Every model that is one of `bases` plus a candidate, as if signatures added up in proportion: s + (ds/dx) (x - best) + v x'.

        v is the sensitivity of the candidate, x' its size. It is that of the nominal system, without another simulation, or the one that it
        has beside the model `at`. The parameters of the base are fitted again, too. Of the variants of a candidate the best one; all of
        them where they are not proportional to their size: sensitivities say too little.
        """
        space = self.evidence.space
        addresses, stacked, known = self.alone if at is None else self.beside(at)
        place, count = {a: i for i, a in enumerate(addresses)}, len(addresses)
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
                there = self.starts.get(c.addresses[0]) if at is None else None
                if there is not None:
                    sensitivities = np.concatenate([base.sensitivities, there.sensitivity[:, None]], axis=1)
                    start = np.append(best, there.x)
                    fit = quadratic_fit(model, base.signature + there.signature, sensitivities, start, space, base.form)
                else:
                    own = wide.without([a for m in model for a in m.addresses])
                    products = own.within(gram, [*own_columns, *(place[a] for a in c.addresses), count + len(best)])
                    fit = solved(model, products, space, own)
                    if at is not None:
                        fit.sensitivities = np.column_stack([base.sensitivities, stacked[:, [place[a] for a in c.addresses]]])
                        x = np.array([fit.values[a] / m.prior.scale for m in model for a in m.addresses])
                        fit.signature = base.signature - base.sensitivities @ best + fit.sensitivities @ x
                found[key] = fit
        kept: dict[frozenset[tuple[str, object]], Fit] = {}
        for fit in sorted(found.values(), key=evidence_of):
            kept[frozenset((m.name, m.fixed if m.name in self.bent else ()) for m in fit.model)] = fit
        return list(kept.values())

    def refine(self, fits: Sequence[Fit], rounds: int = 5) -> list[Fit]:
        """Gauss-Newton on real simulations, all models together (one simulation of each per round): the best of each that was simulated.

        They begin with the slopes that they have at their values, or with those of each effect alone. Sensitivities S follow by Broyden's
        rule from the step dx and what it did: S + (ds - S dx) dx' / dx'dx.
        """
        space = self.evidence.space
        states = []
        for f in fits:
            addresses = [a for c in f.model for a in c.addresses]
            if f.sensitivities is not None and f.signature is not None:
                values = np.array([f.values[a] / c.prior.scale for c in f.model for a in c.addresses])
                states.append(_State(f, f.sensitivities, values, f.signature))
                continue
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
        n, slopes = len(self.groups), by_slopes(self.nuisances, calibrated, self.evidence.space)
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
        return None if whole is None else whole - by_slopes(self.nuisances, calibrated, self.evidence.space)

    def numbers(self, fit: Fit) -> tuple[list[Nuisance], FloatArray, FloatArray]:
        """The calibrated numbers that a model leaves to the nuisances, and where it has them: their means [k] and covariance [k, k].

        These are of the posterior, in standard deviations of the tolerances.
        """
        assert fit.signature is not None
        space = self.evidence.space.without(list(fit.values))
        places = {a: i for i, a in enumerate(space.names) if a not in space.gone}
        numbers = [n for n in self.nuisances if n.address in places]
        here = [places[n.address] for n in numbers]
        return numbers, space.moved(space.y - fit.signature)[here], space.covariance(here)

    def calibrated(self, fit: Fit) -> dict[Address, float]:
        """What a model has the calibrated numbers off by [unit]."""
        numbers, means, _ = self.numbers(fit)
        return {n.address: float(z) * n.scale for n, z in zip(numbers, means, strict=True)}

    def far_off(self, fit: Fit) -> frozenset[Address]:
        """The calibrated numbers that a model needs farther off than one of so many is with FALSE_ALARM."""
        numbers, means, _ = self.numbers(fit)
        return frozenset(n.address for n, z in zip(numbers, means, strict=True) if abs(z) > beyond(len(numbers), FALSE_ALARM))

    def calibrate(self, fit: Fit) -> Fit:
        """The fit again with its calibrated numbers as far off as the data have them, simulated, while that explains more.

        Slopes say what a small change does. A loop that is at a limit does something else with a larger one, and an effect that is the same
        as a tolerance would be named for the rest. It ends where a number is farther off than one of so many is with FALSE_ALARM.
        """
        own = self.evidence.space.without(list(fit.values))
        for _ in range(SHARPER):
            assert fit.sensitivities is not None
            if self.far_off(fit):
                break
            calibrated = self.calibrated(fit)
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

    def about(self, fit: Fit, signature: FloatArray, sensitivities: FloatArray, form: FloatArray | None = None) -> Fit:
        """The best fit near the values of another one, where the signature and its slopes are these.

        `form`: what its effects may do otherwise than their laws say; None: as `Evidence.form` has it.
        """
        scales, _, _ = scaled_bounds(fit.model)
        addresses = [a for c in fit.model for a in c.addresses]
        x = np.array([fit.values[a] for a in addresses]) / scales
        form = self.evidence.form(fit.model, signature, sensitivities, x) if form is None else form
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
        chi2 = self.chi2(ran)
        evidence = better.log_evidence - 0.5 * max(chi2 - better.chi2, 0.0)
        return replace(better, values=ran.values, signature=ran.signature, chi2=chi2, log_evidence=evidence)

    def sharpen(self, fit: Fit) -> Fit:
        """The fit again with the slopes of the signature where it is: those of the way there miss an effect that turns with its size."""
        space = self.evidence.space
        own = space.without([a for c in fit.model for a in c.addresses])

        def chi2(signature: FloatArray) -> float:
            return own.square(space.y - signature)

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
        return np.stack([(x - known[0]) * (scale / step) for x, scale, (_, step) in zip(known[1:], scales, moved, strict=True)]).T

    def sharpened(self, fits: Sequence[Fit]) -> list[Fit]:
        """These fits, best first; the SHARPENED best `sharpen`ed, and `calibrate`d, where they leave more than ROUGH times noise."""
        found = sorted(fits, key=evidence_of, reverse=True)
        for finer in (self.sharpen, self.calibrate):
            found = [finer(f) if k < SHARPENED and self.rough(f) else f for k, f in enumerate(found)]
        return found

    def rough(self, fit: Fit) -> bool:
        """Whether a fit leaves so much that slopes of its own place may tell more."""
        return fit.chi2 > ROUGH * float(self.evidence.expected.sum())

    def chi2(self, fit: Fit) -> float:
        """What a fit leaves by its signature."""
        assert fit.signature is not None
        left = self.evidence.space.y - fit.signature
        return self.evidence.space.without(list(fit.values)).square(left)


def by_slopes(nuisances: Sequence[Nuisance], calibrated: Values, space: Space) -> FloatArray:
    """What calibrated numbers [unit] do by their slopes in the conditions of a space, whitened, [n]."""
    deviations = {n.address: calibrated[n.address] / n.scale for n in nuisances if n.address in calibrated}
    return space.nuisances.along(np.array([deviations.get(name, 0.0) for name in space.names]))


def addresses_of(candidates: Sequence[Candidate]) -> list[Address]:
    """The parameters of all these candidates, each once."""
    return list(dict.fromkeys(a for c in candidates for a in c.addresses))


def evidence_of(fit: Fit) -> float:
    """Log evidence of a fit [nats], to sort by."""
    return fit.log_evidence


def _settled(step: float, width: float, value: float) -> bool:
    """Whether a step of a fit matters little beside the deviation of the value, or the value."""
    return abs(step) < max(0.3 * width, 0.002 * abs(value))


class _State:
    """One model under refinement."""

    def __init__(self, fit: Fit, sensitivities: FloatArray, x: FloatArray, signature: FloatArray) -> None:
        self.fit, self.sensitivities, self.x, self.signature = fit, sensitivities, x, signature
        self.scales, _, _ = scaled_bounds(fit.model)
        self.best, self.settled = replace(fit, signature=None, sensitivities=None), False  # nothing has run yet
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
        chi2 = space.without(addresses).square(left)
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
