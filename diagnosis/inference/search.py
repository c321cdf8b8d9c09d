"""The search for the effects that explain the gap: all alone, what grows from the best, what takes the place of one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.special import entr

from robomill.diagnosis.candidates import LOGGING, Address, Candidate, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.simulation import Simulator, setting
from robomill.diagnosis.inference.adequacy import COHERENT, LEVEL, MISFIT, UNKNOWN, by_chance, unexplained
from robomill.diagnosis.inference.calibrated_instead import calibrated_instead, without_effect
from robomill.diagnosis.inference.estimation import Fit, Gram, leave_one_out
from robomill.diagnosis.inference.evidence import dependence
from robomill.diagnosis.inference.fitting import POLISH, POLISHED, SHARPENED, Fitting, addresses_of, evidence_of
from robomill.diagnosis.inference.sensitivities import LARGE, NOMINAL, WORTH, per_scale
from robomill.orchestration.slaves.protocol import FloatArray

GROWTH_GAIN = 12.0
"""Gain in evidence [nats], as sensitivities and noise have it, from which models with a further effect are simulated."""
SUBSTANTIAL = 0.05
"""Part of what is left beyond noise that another effect must explain."""
FAULT = 0.67
"""Part of what is left beyond noise that a fault of the log must explain. It can be modelled exactly: what is left of something else is no
reason to reject a log."""
SINGLES, BASES, EXTENSIONS = 10, 3, 4
"""How many single candidates are refined, how many of them grow, and by how many partners each."""
GUESSES = 4
"""How often noise is guessed anew from what the best model leaves: once more than a model has effects, at most."""


class Search(Fitting):
    """Which models are fitted, and what they leave."""

    @cached_property
    def together(self) -> tuple[FloatArray, Gram]:
        """What each parameter of the candidates does per prior scale, [n, parameters], and the products of that.

        To be asked for when the search is over: its candidates and their sensitivities are what they are then.
        """
        columns = np.stack([per_scale(self.evidence, self.starts, a) for a in addresses_of(self.candidates)]).T
        return columns, self.evidence.space.gram(columns)

    @cached_property
    def variety(self) -> tuple[float, float]:
        """In how many directions the effects of the catalogue differ, and the part of one that all others can do, in the mean [1].

        The first is the effective rank (Roy & Vetterli, EUSIPCO 2007) of what they do to the residual, each as large as any other: exp of
        the entropy of the eigenvalues of their correlations R. An effect of one number has one; two that do the same have one together.
        The second is the mean coefficient of determination of each on all others, 1 - 1 / (R^-1)_ii. Both as far as these runs show.
        """
        columns, known = self.together
        gram = self.evidence.space.within(known, range(columns.shape[1]))
        shows = np.diag(gram) > 1.0  # a deviation of noise, at its prior scale
        size = np.sqrt(np.diag(gram)[shows])
        alike = gram[np.ix_(shows, shows)] / np.outer(size, size)
        shares = np.linalg.eigvalsh(alike) / max(len(size), 1)
        others = 1.0 - 1.0 / np.diag(np.linalg.inv(alike + 1e-9 * np.eye(len(size))))
        return float(np.exp(entr(np.maximum(shares, 0.0)).sum())), float(others.mean()) if len(size) else 0.0

    def imitates(self, fit: Fit, kinds: int = 1) -> float:
        """Probability [1] that a model of `kinds` of effects leaves next to nothing of an effect that is in no catalogue, by chance.

        Such an effect does what the catalogue can do as far as the effects in it can do what the others do. Then it is a direction at
        random among those of the effects, of which the numbers of the model leave some (`by_chance`). And a number that can have one sign
        only has the right one once in two times.
        """
        directions, others = self.variety
        signs = sum(len(c.addresses) for c in fit.model if not c.both_signs)
        return others * 0.5**signs * by_chance(directions - len(fit.values), kinds)

    def of(self, sensitivities: Mapping[Candidate, FloatArray]) -> Search:
        """A search for other candidates, of one number each, with the evidence of this one; what each does per prior scale, [n]."""
        other = copy(self)
        other.forget()
        columns = {a: column for c, column in sensitivities.items() for a in c.addresses}
        other.candidates, other.starts, other.bent = list(sensitivities), {}, set()
        other.scales = self.scales | {a: c.prior.scale for c in sensitivities for a in c.addresses}
        other.sizes = self.sizes | dict.fromkeys(columns, 1.0)
        other.evidence = replace(self.evidence, sensitivities=self.evidence.sensitivities | columns)
        return other

    def forget(self) -> None:
        """Forget what was computed of the candidates, for they are others now."""
        for name in [n for n in self.__dict__ if isinstance(getattr(Search, n, None), cached_property)]:
            del self.__dict__[name]

    @property
    def growth(self) -> float:
        """Gain in evidence [nats] from which models with a further effect are simulated: GROWTH_GAIN of noise alone."""
        return GROWTH_GAIN / self.evidence.dispersion

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

    def run(self) -> list[Fit]:
        """All models that were fitted on real simulations, the nominal one first."""
        space = self.evidence.space
        nominal = self.nominal()
        singles = sorted(self.linear_fits([nominal]), key=evidence_of, reverse=True)
        fits = [self.calibrate(nominal) if self.rough(nominal) else nominal]
        gain = space.chi2 - min((f.chi2 for f in singles), default=space.chi2)
        chosen = _first([f for f in singles if space.chi2 - f.chi2 > WORTH * gain], SINGLES) or _first(singles, SINGLES)
        chosen += _first([f for f in singles if f not in chosen and self._hidden(f, nominal)], SINGLES)
        level = self.sharpened(self.polish(self.refine(chosen), chosen))
        fits += level
        fits = self._grown(fits, self._best(level, BASES))
        while (others := self._exchanged(max(fits, key=evidence_of), fits)) and max(others, key=evidence_of).log_evidence > _most(fits):
            fits = self._grown(fits + others, self._best(others, 1))
        fits += others
        fits = _distinct([f for f in fits + calibrated_instead(self, max(fits, key=evidence_of)) if f.large_enough()])
        for f in sorted(fits[1:], key=evidence_of, reverse=True)[:3]:
            f.predictive = {name: part.predicted for name, part in leave_one_out(f, space).items()}
        return fits

    def _grown(self, fits: list[Fit], bases: Sequence[Fit]) -> list[Fit]:
        """`fits`, and models with one effect more than `bases`, one more than these, and so on while that is worth it."""
        while bases:
            best = _most(fits)
            grown = sorted(self.linear_fits(bases), key=evidence_of, reverse=True)
            # a fault of the log does what its signature says: one that explains too little takes no place from others
            exact = [f for f in grown if not any(c.component == LOGGING for c in f.model) or self._worth(f, fits, bases[0])]
            chosen = _first([f for f in exact if f.log_evidence > best + self.growth], EXTENSIONS * len(bases))
            of = {frozenset(b.model): (b, self.far_off(b)) for b in bases}
            others = [f for f in grown if f not in chosen and self._hidden(f, *of[frozenset(f.model[:-1])])]
            hidden = {frozenset(f.model) for f in _first(others, EXTENSIONS)}
            chosen += [f for f in grown if frozenset(f.model) in hidden]
            level = [f for f in self.sharpened(self.polish(self.refine(chosen), chosen)) if self._worth(f, fits, bases[0])]
            level = [f for f in level if frozenset(f.model) not in hidden or f.log_evidence > best + self.growth]
            smaller = self._smaller(level, fits)
            again = {frozenset(f.model) for f in smaller}
            fits = [f for f in fits if frozenset(f.model) not in again] + level + smaller
            bases = self._best(smaller, 1) if any(f is max(fits, key=evidence_of) for f in smaller) else self._best(level, 1)
            if bases and bases[0].log_evidence <= best:
                break
        return fits

    def _exchanged(self, best: Fit, known: Sequence[Fit]) -> list[Fit]:
        """Models that have another effect, or none, in place of one of `best`: the likeliest by sensitivities, fitted on simulations.

        What came first, when little else was known, may stand for two that came later. Where slopes have `turned` beside it, those that
        the others have there say so, and also which effect it lacks.
        """
        turned = self.turned(best)
        if len(best.model) <= 1 and not turned:
            return []
        fewer = [without_effect(best, c) for c in best.model] if len(best.model) > 1 else []
        seen = {frozenset(f.model) for f in known}
        beside = self.linear_fits([*fewer, best] if turned else fewer, best if turned else None)
        ranked = [f for f in sorted(beside, key=evidence_of, reverse=True) if frozenset(f.model) not in seen]
        larger = [f for f in ranked if len(f.model) > len(best.model)]
        swapped = [f for f in ranked if len(f.model) <= len(best.model)]
        trials = [f for f in larger if f.log_evidence > best.log_evidence + self.growth][:EXTENSIONS]
        trials += [f for f in swapped if f.log_evidence > best.log_evidence - self.growth][:EXTENSIONS]
        trials += [f for f in fewer if frozenset(f.model) not in seen]
        level = self.sharpened(self.polish(self.refine(trials), trials))
        return level + (self._replaced(best, fewer, [f for f in swapped if f not in trials]) if fewer else [])

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
            places += [self.chi2(without)] * (len(trials) - len(places))
        ran = [(f, lost) for f, lost in zip(self.refine(trials), places, strict=True) if f.signature is not None and lost > best.chi2]
        ranked = sorted(ran, key=lambda pair: (pair[0].chi2 - best.chi2) / (pair[1] - best.chi2))
        likeliest = [self.sharpen(f) for f, _ in ranked[:EXTENSIONS]]
        equal = [f for f in likeliest if f.log_evidence > best.log_evidence - self.growth]
        less = [without_effect(f, c) for f in equal for c in f.model]
        return likeliest + self.sharpened(self.polish(self.refine(less), less)) + self._smaller(equal, ())

    def _hidden(self, fit: Fit, base: Fit, far: frozenset[Address] = frozenset()) -> bool:
        """Whether the last effect of a model, by its linear fit, takes WORTH of what `base` leaves without the tolerances like it, or more.

        Against a gap that is far larger than noise (LARGE) no sensitivity is exact enough; a simulation is. Where an effect changes a
        resonance, its slope explains a part of the gap only, and tolerances of everything else explain the rest, all far off. Whatever the
        gap, an effect is looked at that is like a calibrated number which the base has far off (`far`): so large a change is no slope.
        """
        space = self.evidence.space
        own, before = space.without(list(fit.values)), space.without([a for c in base.model for a in c.addresses])
        if own is before:
            return False
        if not far.isdisjoint(own.gone):
            return True
        assert base.signature is not None
        left = own.square(space.y - base.signature)
        return left > LARGE * float(self.evidence.expected.sum()) and fit.chi2 < (1.0 - WORTH) * left

    def _best(self, level: Sequence[Fit], count: int) -> list[Fit]:
        best = {_names(f): f for f in sorted(level, key=evidence_of)}  # variants do not grow beside each other
        return sorted(best.values(), key=evidence_of, reverse=True)[:count]

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

    def _worth(self, fit: Fit, fits: Sequence[Fit], base: Fit) -> bool:
        """Whether the effects of a model explain enough of what is left without one of them.

        What is left of a strong effect that is modelled a little otherwise would else be given to one small effect after the other. Of a
        fault that the best `base` has already no more is asked than of the others: beside many effects it explains a part of all of them.
        """
        noise = float(self.evidence.expected.sum())
        settled = set(base.model) if set(base.model) < set(fit.model) else set()

        def part(known: Fit) -> float:
            new = [c for c in fit.model if c not in known.model and c not in settled]
            return FAULT if any(c.component == LOGGING for c in new) else SUBSTANTIAL

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
        best = max(fits, key=evidence_of)
        simulated = simulator.repeated(range(len(groups)), setting(best.values), POLISH, "noise")
        if any(s is None for s in simulated):
            break
        left = [[x - np.mean(s, axis=0) for x in g] for g, s in zip(groups, simulated, strict=True) if s is not None]
        search = Search(catalogue, simulator, groups, nuisances, left)
        fits = search.run()
        if set(max(fits, key=evidence_of).model) == set(best.model):
            break
    if not evidence.whitening.guessed and evidence.judged.any():
        before, after = (_over(search, f) for f in (fits[0], max(fits, key=evidence_of)))
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


def _most(fits: Sequence[Fit]) -> float:
    return max(f.log_evidence for f in fits)


def _distinct(fits: Sequence[Fit]) -> list[Fit]:
    """The best fit of each model, in the order in which they came: a model that was fitted twice is no likelier for that."""
    best = {frozenset(f.model): f for f in sorted(fits, key=evidence_of)}
    return [f for f in fits if best[frozenset(f.model)] is f]


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
