"""From fits to the answer: the verdict, and all that belongs to it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import expit, logsumexp

from robomill.diagnosis.candidates import LOGGING, Address, Candidate, physical
from robomill.diagnosis.experiment.simulation import Laboratory, Simulator, setting
from robomill.diagnosis.forms.instead import Laws, laws
from robomill.diagnosis.gate import checks as gate
from robomill.diagnosis.inference import isolability
from robomill.diagnosis.inference.adequacy import UNKNOWN
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.evidence import FORM
from robomill.diagnosis.inference.intervals import by_least_squares
from robomill.diagnosis.inference.machines import p_none
from robomill.diagnosis.inference.priors import log_posteriors, probabilities
from robomill.diagnosis.inference.scatter import Spell, levels, spell, swing
from robomill.diagnosis.inference.search import EXTENSIONS, SINGLES, Search
from robomill.diagnosis.inference.sets import weighed
from robomill.diagnosis.inference.single_number import log_prior, single
from robomill.diagnosis.inference.time_varying import Changing, changing
from robomill.diagnosis.inference.transfer import Transfer, transfer
from robomill.diagnosis.inference.visibility import Seen
from robomill.diagnosis.localisation.replay_attribution import intervals
from robomill.diagnosis.localisation.where import Located, combined, direction_of, located
from robomill.diagnosis.outcome import next_run
from robomill.diagnosis.outcome.answer import Answer, Gap, Menu, Number, Unknown, Visible, Which, curves_of, titles_of
from robomill.diagnosis.outcome.calibration import farthest, pulled
from robomill.diagnosis.outcome.families import Family, families
from robomill.diagnosis.outcome.how_far import CLOSING, Closing, metrics
from robomill.diagnosis.outcome.reasons import Reason, reasons
from robomill.diagnosis.outcome.shares import shares
from robomill.diagnosis.outcome.steps import steps
from robomill.diagnosis.outcome.values import WIDER, Values
from robomill.diagnosis.outcome.verdict import (
    IDENTIFIED,
    Tests,
    Verdict,
    at_bound,
    changes,
    judged,
    largest,
    over_noise,
    refuted,
    share_left,
    tested,
)
from robomill.orchestration.slaves.protocol import FloatArray

SAID = {
    "lag": "the clock of the {place} is {way} by {size}",
    "smooth": "the {place} was filtered before it was logged, with a time constant of {size}",
    "gain": "the {place} is too large by {size}",
    "offset": "the {place} is off by {size}",
}
"""What is wrong with the log, in words."""
FAULTS = {"smooth": "filter", "gain": "unit"}
"""Kinds of findings, where they are called otherwise than what is wrong with the log."""
LISTED = 0.01
"""Probability from which a candidate is listed."""


@dataclass(frozen=True)
class _Single:
    """The model of one number that no effect of the catalogue is about."""

    fit: Fit
    p_fit: float
    """As `Tests.p_fit`."""
    likelier: float
    """Probability of it rather than the effects that are named otherwise; 1 where none are."""


class Conclusion:
    """The verdict on fitted models, and all that belongs to it; `answer` says it.

    `weights`: probability of each fit; `best`: the likeliest one; `diagnosed`: that by the diagnosed runs alone; `nothing`: probability of
    the nominal model beside those of the search. Where tests refute the likeliest one, they weigh the fits, too (`reconsidered`).
    """

    def __init__(
        self,
        laboratory: Laboratory,
        simulator: Simulator,
        search: Search,
        fits: list[Fit],
        groups: Sequence[Sequence[FloatArray]],
        n: int,
        findings: list[gate.Finding],
        menu: Menu,
        repair: bool,
        false_alarm: float,
        numbers: Sequence[Candidate] = (),
    ) -> None:
        """`numbers`: numbers of the model that the catalogue lacks."""
        self.numbers = numbers
        self.laboratory, self.simulator, self.search, self.groups, self.n = laboratory, simulator, search, groups, n
        self.findings, self.menu, self.repair, self.false_alarm = findings, menu, repair, false_alarm
        self.titles = titles_of(search.catalogue.titles, laboratory.ports)
        self.fits, self.weights = fits, probabilities(fits, search.candidates)
        self.nothing = float(self.weights[0])
        if over_noise(search, fits[0]) > UNKNOWN:  # else, where noise is a guess, the answer is none
            self.fits, self.weights = weighed(search, fits)
        self.best = self.diagnosed = self.fits[int(self.weights.argmax())]
        self._moved: dict[frozenset[Candidate], Transfer | None] = {}
        # of a log that is refused nothing else is asked; evidence of a noise that is a guess says nothing elsewhere
        if not search.evidence.whitening.guessed and any(c.component != LOGGING for c in self.best.model):
            self.weights = self.held_out()
            self.best = self.fits[int(self.weights.argmax())]
        self.values = Values(search, self.best)

    @cached_property
    def other(self) -> Changing | None:
        """The likeliest effect that changes with time."""
        return changing(self.search)

    @cached_property
    def differs(self) -> Spell | None:
        """When something differs from run to run."""
        return spell(self.search)

    @cached_property
    def swings(self) -> Spell | None:
        """When something swings within samples that the nominal system does not have there."""
        return swing(self.search, self.fits[0])

    def marginal(self) -> dict[Candidate, float]:
        """Probability of each candidate, largest first: the sum of those of all models that it is in, if the best model is right.

        Of those that are as probable the faults of the log come first: the rest holds only with them corrected.
        """
        total: dict[Candidate, float] = {}
        shown = {c.name: c for c in self.best.model}  # of all variants of an effect one is named
        for f, p in sorted(zip(self.fits, self.weights, strict=True), key=lambda pair: -pair[1]):
            for c in f.model:
                named = shown.setdefault(c.name, c)
                total[named] = total.get(named, 0.0) + float(p)
        return dict(sorted(total.items(), key=lambda item: (-item[1], item[0].component != LOGGING)))

    def answer(self) -> tuple[Answer, dict[Address, float]]:
        """Verdict, where, which, how far, next run; and the values that are adopted [unit]."""
        together = self.reconsidered()
        before, noise = self.search.gap(self.search.nominal(), calibrated=False)
        calibrated, _ = self.search.gap(self.fits[0])
        after, _ = self.search.gap(self.best)
        search, nominal = self.search, self.fits[0]
        marginal = self.marginal()
        # what a dead time of the machine explains nearly as well is no reason to refuse the log
        clocks = [c for c in self.best.model if c.component == LOGGING and marginal[c] >= IDENTIFIED]
        alone = clocks and all(c.component == LOGGING for c in self.best.model)  # of a log that is refused nothing else is asked
        moved = self.elsewhere(self.best) if not alone else None
        tests = self.tests(self.best, moved)
        if (more := self.diagnosed) is not self.best:  # what takes an effect out does not make surer of the others
            whole = self.tests(more, self.transfer(more))
            if whole.p_fit < tests.p_fit:
                tests = replace(tests, p_fit=whole.p_fit, odds=whole.odds)
        if together is not None:
            tests = replace(tests, p_fit=together)
        believed = {c: p * tests.p_fit for c, p in marginal.items()}
        sure = {c.component == LOGGING for c in self.best.model if believed[c] >= IDENTIFIED}
        faulty = sure == {True} and not self.repair  # beside effects of the machine a fault of the log is corrected, and said
        verdict = judged(search, tests, nominal, self.best, lambda: self.other, believed, faulty, self.differs is not None, moved)
        # where noise is known, what a model leaves says whether it is right
        tried = verdict in ("identified", "ambiguous") and search.evidence.whitening.guessed
        instead = laws(self.laboratory, self.n, self.best, search.calibrated(self.best), self.false_alarm) if tried else Laws()
        bound = at_bound(self.best.model, self.best.values)
        if verdict != "none":
            self.values = Values(search, self.best, by_least_squares(search, self.best))
            free = {a: v for known in self.values.known.values() for a, v in known.values.items()}
            # with all of the catalogue beside it an effect goes as far as it may
            bound = bound or at_bound(self.best.model, self.best.values | free)
        if instead.found or (bound and verdict != "none"):
            verdict = "unknown"
        number = self.number(verdict)
        several = number is not None and verdict != "unknown"
        if several:  # one number is likelier than they are
            verdict = "unknown"
        said = [c for c in clocks if self.repair or (believed[c] >= IDENTIFIED and verdict != "unknown")]
        for c in said if verdict != "none" else []:
            address, (kind, _, pattern) = c.addresses[0], c.parameters[0].partition(" ")
            value = self.values.said(c)[address]
            text = SAID[kind].format(place=c.location, way="late" if value > 0.0 else "early", size=_size(value, c.unit))
            self.findings.append(gate.Finding(pattern, FAULTS.get(kind, kind), value, c.unit, text, faulty, not faulty))
        swings = self.swings if verdict == "none" else None
        if swings is not None:
            verdict = "unknown"
            self.findings.append(_within_samples(swings, self.search))
        if (x := self.differs) is not None:
            text = f"differs from run to run: {x.times:.0f} times what good machines scatter, in another array, too{_when(x)}"
            self.findings.append(gate.Finding(x.channel, "scatter", x.times, "1", text, fatal=False))
        pairs = isolability.pairs(self.fits, [c for c, p in marginal.items() if p >= LISTED], self.search.evidence.space)
        gap = Gap(
            before,
            min(max(before - calibrated, 0.0), max(before, 0.0)),
            after,
            noise,
            min(share_left(search, nominal, self.best), 1.0),
            self.search.evidence.whitening.guessed,
            farthest(search, nominal) if verdict == "none" else None,
        )
        belief = tests.p_fit * (1.0 - number.likelier if several and number else 1.0)
        shown = self.best if number is None else number.fit
        stays = dict.fromkeys(shown.model, number.p_fit) if number is not None else {}
        which = self.which(marginal, pairs, {c: max(belief * instead.belief(c), stays.get(c, 0.0)) for c in marginal}, shown)
        limits = verdict in ("unknown", "none")  # else the answer says why they are there
        answer = Answer(
            verdict,
            tuple(f for f in self.findings if f.kind != gate.LIMITED or limits),
            which=which,
            isolability=tuple(pairs),
            gap=gap,
            transfer=moved,
            tests=tests,
            families=self.families(belief, instead),
            smallest_visible=self.smallest(),
            calibrated=pulled(search, shown, self.false_alarm),
        )
        acts = verdict in ("identified", "ambiguous", "unknown")
        adopted = physical(shown.values) if acts else {}
        if verdict == "none":
            answer = replace(answer, probability_none=tests.nothing)
        else:
            closing = Closing(search, self.groups, self.titles) if adopted else None
            found = located(self.laboratory, self.n, self.search.catalogue, self.search.nuisances, self.figures(), self.menu.projections)
            answer = replace(
                answer,
                where=combined(verdict, shares(search, self.best), found.where),
                how_far=closing.of(adopted, list(closing.kinds)) if closing else (),
                steps=steps(closing, shown) if closing else None,
                next_run=self.next_run(verdict) if acts else None,
                replay=found.replay,
                swap=found.swap,
                structure=found.structure,
                not_replayed=found.not_replayed,
                predictive={f.name: f.predictive for f in self.fits if f.predictive},
            )
        if number is not None:
            answer = replace(answer, number=self.described_number(number, several))
        if verdict == "unknown":
            other = self.other if self.other is not None and changes(search, self.best, self.other) else None
            seen: dict[Reason, bool] = {"bound": bound, "changes": other is not None, "instead": bool(instead.found), "number": several}
            seen |= {"runs": self.differs is not None and not self.best.model, "swing": swings is not None}
            answer = self.described(
                answer, found, instead, other, reasons(tests, bool(self.best.model), largest(search, nominal, moved), seen)
            )
        return answer, adopted

    def number(self, verdict: Verdict) -> _Single | None:
        """The number of the model, in no catalogue, that explains the gap by itself; None if there is none.

        It is asked for where the answer is `unknown` otherwise, or not sure, or has several numbers, or needs calibrated numbers far off.
        Then it has to be likelier than these, each by evidence and prior. Where calibrated numbers are far off, it may stand beside effects
        of the best model, too. It has to pass the tests that an effect has to pass.
        """
        machine = not any(c.component == LOGGING for c in self.best.model)
        named = verdict in ("identified", "ambiguous") and machine
        far = bool(pulled(self.search, self.best, self.false_alarm))
        doubtful = verdict == "ambiguous" or len(self.best.values) > 1 or far
        if not (verdict == "unknown" or (named and doubtful)) or self.differs is not None:
            return None
        beside = [f for f in self.fits if f.model and set(f.model) <= set(self.best.model)] if machine and far else []
        tries = SINGLES if named else EXTENSIONS  # what would be named is worth more of them than what is refused already
        for bases in ([], beside) if beside else ([],):  # what one number does by itself needs no effects
            fit = single(self.search, self.numbers, self.fits, bases, tries)
            if fit is not None and (found := self.believed_number(fit, named)) is not None:
                return found
        return None

    def believed_number(self, fit: Fit, named: bool) -> _Single | None:
        """A model of a number, if it is likelier than what is `named` or what it has in addition, and likelier right than a stand-in."""
        if at_bound(fit.model, fit.values):
            return None
        its = fit.log_evidence + log_prior(fit, self.search, self.numbers)
        others = log_posteriors([self.best], self.search.candidates)[0]
        likelier = float(expit(its - others)) if named or len(fit.model) > 1 else 1.0
        p_fit = self.tests(fit, self.transfer(fit)).p_fit
        return None if refuted(likelier) or refuted(p_fit) else _Single(fit, p_fit, likelier)

    def described_number(self, number: _Single, several: bool) -> Number:
        """What is said of a number of the model; `several`: that it is in place of the effects of the best model."""
        *rest, c = number.fit.model
        (estimate,) = Values(self.search, number.fit).parameters(c, number.fit).values()
        others = tuple(x.name for x in self.best.model if x not in rest) if several else ()
        return Number(c.component, c.parameters[0], estimate, number.p_fit * number.likelier, others, tuple(x.name for x in rest))

    def held_out(self) -> FloatArray:
        """Probability of each fit, float64[fits], where models of fewer of the best one's effects are asked in new conditions, too.

        What a strong effect does otherwise than its law says is far above noise, and a second one that fits it is sure by the diagnosed
        runs. New conditions are data as these are: evidence times prior is multiplied by exp(gain - gain of the best model) there
        (`Transfer.gain`). Models that have other effects are taken to do there as the best one does.
        """
        fewer = [i for i, f in enumerate(self.fits) if f.model and set(f.model) < set(self.best.model)]
        moved = self.transfer(self.best) if fewer else None
        if moved is None:
            return self.weights
        scores = log_posteriors(self.fits, self.search.candidates)
        for i in fewer:
            if (other := self.transfer(self.fits[i])) is not None:
                scores[i] += other.gain - moved.gain
        return np.asarray(np.exp(scores - logsumexp(scores)))

    def tests(self, fit: Fit, moved: Transfer | None) -> Tests:
        """What the verdict on a model rests on; `moved`: new conditions."""
        return tested(self.search, self.fits[0], fit, self.nothing, self.rank, moved, self.false_alarm, levels(self.search, fit))

    @cached_property
    def rank(self) -> float:
        """`p_none` of the odds against the nominal model."""
        return p_none(self.search, float(np.log(max(1.0 - self.nothing, 1e-300)) - np.log(max(self.nothing, 1e-300))))

    def reconsidered(self) -> float | None:
        """Let the tests say which model is best, where they refute the likeliest: the probability that one of the likely models is right.

        A model m of probability w is right by odds o, those of its `p_fit`. Then one of them is by the odds sum w o, of which m has the
        share w o. None, and nothing changes, where that is improbable, too. Only where noise is known, by models of LISTED and more.
        """
        if self.search.evidence.whitening.guessed or self.diagnosed is not self.best:
            return None
        likely = [i for i, w in enumerate(self.weights) if w >= LISTED and any(c.component != LOGGING for c in self.fits[i].model)]
        here = int(self.weights.argmax())
        if len(likely) <= 1 or here not in likely or not refuted(own := self.tests(self.best, self.elsewhere(self.best)).p_fit):
            return None
        right = np.array([own if i == here else self.tests(self.fits[i], self.elsewhere(self.fits[i])).p_fit for i in likely])
        weights = np.zeros_like(self.weights)
        weights[likely] = self.weights[likely] / self.weights[likely].sum() * right / np.maximum(1.0 - right, 1e-300)
        odds = float(weights.sum())
        if refuted(odds / (1.0 + odds)):
            return None
        self.weights = weights / odds
        self.best = self.diagnosed = self.fits[int(self.weights.argmax())]
        self.values = Values(self.search, self.best)
        return odds / (1.0 + odds)

    def elsewhere(self, fit: Fit) -> Transfer | None:
        """What a model is worth in held-out conditions; None where a seed draws all that it does: that says nothing of the next run."""
        return None if all(c.effect in self.search.catalogue.drawn for c in fit.model) else self.transfer(fit)

    def transfer(self, fit: Fit) -> Transfer | None:
        """What a model is worth in held-out conditions.

        Its doubt is FORM and WIDER times the relative deviations of its sizes, each by the share of its effect in the signature s, <s, s_c>
        / <s, s>: what an effect does that is hardly known and does little hardly matters. At most 1.
        """
        doubt, key = FORM, frozenset(fit.model)
        if key in self._moved:
            return self._moved[key]
        parts = fit.signatures()
        total: FloatArray = np.sum(list(parts.values()), axis=0)
        space = self.search.evidence.space
        for c, part in parts.items():
            share = float(space.dot(total, part)) / (space.square(total) + 1e-300) if len(parts) > 1 else 1.0
            sizes = c.sizes(fit.values)
            doubt = math.hypot(doubt, share * WIDER * max(fit.deviations[a] / (sizes[a] + 1e-300) for a in c.addresses))
        self._moved[key] = transfer(self.search, self.groups, fit, min(doubt, 1.0))
        return self._moved[key]

    def families(self, p_fit: float, instead: Laws) -> tuple[Family, ...]:
        """Families with a probability of LISTED or more, `p_fit` included; of a family no more is believed than of its best member."""
        found = families(self.fits, self.weights, self.search.evidence.space, self.search.candidates)
        belief = {c.name: p_fit * instead.belief(c) for c in self.search.candidates}
        scaled = []
        for f in found:
            members = {n: belief[n] * p for n, p in f.members.items()}
            scaled.append(replace(f, probability=f.probability * max(belief[n] for n in members), members=members))
        return tuple(f for f in scaled if f.probability >= LISTED)

    def which(
        self, marginal: Mapping[Candidate, float], pairs: Sequence[isolability.Pair], belief: Mapping[Candidate, float], shown: Fit
    ) -> tuple[Which, ...]:
        """Every candidate with a probability of LISTED or more if the best model is right; said is its product with `belief`.

        Those of the model that is `shown` have its values.
        """
        listed = []
        sets: dict[str, list[str]] = {}
        for one, other in (p.pair for p in pairs if p.confusable):
            sets.setdefault(one, []).append(other)
            sets.setdefault(other, []).append(one)
        for c, p in marginal.items():
            if p < LISTED:
                continue
            fit = shown
            if c not in shown.model:
                fit = max((f for f in self.fits if c in f.model), key=lambda f: float(self.weights[self.fits.index(f)]))
            parameters, closes = self.values.parameters(c, fit), self.values.closes(c)
            listed.append(Which(c.effect, c.component, c.location, p * belief[c], parameters, sets.get(c.name, []), closes))
        return tuple(sorted(listed, key=lambda w: -w.probability))

    def figures(self) -> dict[str, FloatArray]:
        """Weights of the channels in each figure, name -> [channels]: 1 for those in it, 0 for the others."""
        every = np.arange(len(self.laboratory.channels))
        return {name: np.isin(every, members).astype(np.float64) for name, members in metrics(self.search, self.titles).items()}

    def smallest(self) -> tuple[Visible, ...]:
        """What would have been seen, by candidate and parameter (`visibility`)."""
        seen = Seen(self.search.evidence, self.search.candidates)
        return tuple(
            Visible(c.effect, c.location, name, value, c.unit) for c in self.search.candidates for name, value in seen.smallest(c).items()
        )

    def next_run(self, verdict: str) -> next_run.NextRun | None:
        """The designed run that tells the likely models apart; None where there is only one, or no kind of run."""
        rivals = next_run.rivals(self.fits, self.weights, self.search, known=verdict != "unknown")
        kinds = self.menu.kinds() if len(rivals) > 1 else ()
        if not kinds:
            return None
        fits, weights = [self.fits[i] for i in rivals], [max(float(self.weights[i]), LISTED) for i in rivals]
        return next_run.recommend(fits, weights, kinds, self.search, self.simulator)

    def described(self, answer: Answer, found: Located, instead: Laws, other: Changing | None, why: tuple[Reason, ...]) -> Answer:
        """The answer with what is known of an effect that is not in the catalogue; `other`: what it is like if it changes with time.

        Calibrated numbers are judged together: where none is far off by itself, and all are too far, the farthest one is said, unless one
        number explains it all.
        """
        unknown, where = replace(self.unknown(), why=why, instead=instead.found), answer.where
        if found.where:
            first = where[0]
            unknown = replace(unknown, component=first.component, direction=first.direction, regime=first.regime)
        if (x := self.differs or self.swings) is not None and not self.best.model:
            unknown = replace(unknown, component=x.channel.partition(".")[0], direction=direction_of(x.channel), regime=[list(x.span)])
        if other is not None:
            unknown = replace(unknown, changes=other)
            also, named = other.candidate.component, {c for w in found.where for c in (w.component, *(w.alternatives or ()))}
            if found.where and also not in named:  # the replay knows only effects that do not change
                where = (replace(first, alternatives=(*(first.alternatives or ()), also)), *where[1:])
        far = farthest(self.search, self.best) if "calibrated" in why and not answer.calibrated and answer.number is None else None
        return replace(answer, unknown=unknown, where=where, calibrated=(far,) if far is not None else answer.calibrated)

    def unknown(self) -> Unknown:
        """Channels and times that what the best model leaves is in."""
        space, search = self.search.evidence.space, self.search
        assert self.best.signature is not None
        names = [c for c, on in zip(self.laboratory.channels, search.evidence.active, strict=True) if on]
        chi2 = np.zeros(len(names))
        regime: list[list[float]] = []
        for i, (_, block) in enumerate(space.blocks.items()):
            left = (space.y - self.best.signature)[block].reshape(-1, len(names)) ** 2
            chi2 += left.sum(axis=0)
            if i == 0:
                over = left.sum(axis=1)
                regime = intervals(over > 0.1 * over.max(), self.laboratory.conditions[0].grid, self.laboratory.decimation)
        channels = {names[k]: float(chi2[k] / chi2.sum()) for k in np.argsort(-chi2)[:5]}
        first = next(iter(channels))
        return Unknown(channels, first.partition(".")[0], direction_of(first), regime, self.best.name)

    def curves(self, adopted: Mapping[Address, float]) -> dict[str, dict[str, FloatArray]]:
        """Means over the repeats beside both simulations, for each condition; see `Diagnosis.curves`."""
        everywhere = range(len(self.laboratory.conditions))
        before, after = (self.simulator.repeated(everywhere, changes, CLOSING) for changes in ((), setting(adopted)))
        return curves_of(self.laboratory, self.groups, before, after)


def _size(value: float, unit: str) -> str:
    """A size of a fault of the log, in words; times below a second in milliseconds, without a sign."""
    if unit == "s":
        return f"{1e3 * abs(value):.1f} ms" if abs(value) < 1.0 else f"{abs(value):.4g} s"
    return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"


def _when(spell: Spell) -> str:
    """The condition and the while that something was seen in, in brackets."""
    return f" ({spell.condition}, {spell.span[0]:.1f} to {spell.span[1]:.1f} s)"


def _within_samples(x: Spell, search: Search) -> gate.Finding:
    """What is faster than the samples of the diagnosis, and no effect can explain."""
    sample = search.evidence.decimation * search.simulator.laboratory.system.step
    text = f"swings within samples of {_size(sample, 's')}: {x.times:.0f} times what good machines do, in another array, too{_when(x)}"
    return gate.Finding(x.channel, "swing", x.times, "1", text, fatal=False)
