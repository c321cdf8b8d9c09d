"""Which effects a single recording has: sets of effects, weighed by what least squares see of them.

Where noise is a guess, the search knows the fast part of the noise alone, and takes ten samples for one. That finds strong effects, and
what its best model leaves. From that, the noise is known with its memory (`intervals`), and with it what each set of effects explains of
all that least squares see: each set has an evidence of its own, without another simulation. So an effect is judged by what it adds to
all the others that are there, however many these are and however much more they do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.special import logsumexp

from robomill.diagnosis.candidates import LOGGING, Address, Candidate
from robomill.diagnosis.inference.estimation import Fit, Model, leave_one_out, scaled_bounds, solve
from robomill.diagnosis.inference.intervals import Problem
from robomill.diagnosis.inference.priors import log_priors, probabilities
from robomill.diagnosis.inference.search import GUESSES, Search
from robomill.diagnosis.inference.sensitivities import per_scale
from robomill.orchestration.slaves.protocol import FloatArray


@dataclass
class Sets:
    """Sets of effects and how likely they are, from the precision of all their numbers."""

    candidates: Sequence[Candidate]
    """All that there are, for the probabilities before the data."""
    order: Sequence[Address]
    """The numbers of effects."""
    precision: FloatArray
    """[numbers, numbers], per prior scale."""
    product: FloatArray
    """Precision times the values [numbers]."""
    known: dict[frozenset[str], tuple[float, Fit]] = field(default_factory=dict)
    """Names of the effects -> log of evidence and prior [nats], and the fit; minus infinity where an effect is too small to count."""

    @staticmethod
    def of(problem: Problem, candidates: Sequence[Candidate]) -> Sets:
        """From what least squares see of the numbers of all candidates; tolerances are free within them."""
        precision, product = problem.seen(problem.solved())
        effects = {a for c in candidates for a in c.addresses}
        here = [i for i, a in enumerate(problem.order) if a in effects]
        rest = [i for i, a in enumerate(problem.order) if a not in effects]
        across = precision[np.ix_(here, rest)] @ np.linalg.inv(precision[np.ix_(rest, rest)] + np.eye(len(rest)))
        own = precision[np.ix_(here, here)] - across @ precision[np.ix_(rest, here)]
        return Sets(candidates, [problem.order[i] for i in here], own, product[here] - across @ product[rest])

    def score(self, model: Model) -> float:
        """Log of evidence times prior [nats]."""
        key = frozenset(c.name for c in model)
        if key not in self.known:
            at = [self.order.index(a) for c in model for a in c.addresses]
            fit = Fit((), {}, {}, 0.0, 0.0)
            if model:
                fit = solve(model, self.precision[np.ix_(at, at)], self.product[at], 0.0, 0.0, *scaled_bounds(model))
            log = fit.log_evidence + log_priors([model], self.candidates)[0] if fit.large_enough() else -np.inf
            self.known[key] = (log, fit)
        return self.known[key][0]

    def best(self, start: Model, free: Sequence[Candidate]) -> Fit:
        """The likeliest set: one of the `free` effects is put in, taken out or exchanged, whatever is best, while that is better."""
        model: Model = start
        while True:
            others = [c for c in free if c.name not in {m.name for m in model}]
            beside = [(*model, c) for c in others if not any(c.excludes(m) for m in model)]
            fewer = {m: tuple(x for x in model if x != m) for m in model}
            around = [model, *beside, *fewer.values()]
            found = max(around, key=self.score)
            if found is model:
                swapped = ((*fewer[m], c) for m, c in product(model, others) if not any(c.excludes(x) for x in fewer[m]))
                found = max([model, *swapped], key=self.score)
            if found is model:
                self.score(model)
                return self.known[frozenset(c.name for c in model)][1]
            model = found


def weighed(search: Search, fits: Sequence[Fit]) -> tuple[list[Fit], FloatArray]:
    """Models and the probability of each, float64[models]: those of the search, and where noise is a guess, those of `Sets`, too.

    Sets are those about the best model: where another one is better, that is fitted, and sets are weighed anew, until it stays. A fault
    of the log that the best model of the search does not have is not looked at: there is more to it than evidence.
    """
    weights = probabilities(fits, search.candidates)
    best = fits[int(weights.argmax())]
    if not best.model or not search.evidence.whitening.guessed:
        return list(fits), weights
    for _ in range(GUESSES):
        problem = Problem.of(search, best, best.values)
        if problem is None:
            return list(fits), weights
        free: dict[str, Candidate] = {}  # of all variants of an effect the first one
        for c in (*best.model, *search.candidates):
            if set(c.addresses) <= set(problem.order) and (c.component != LOGGING or c in best.model):
                free.setdefault(c.name, c)
        sets = Sets.of(problem, search.candidates)
        started = [f.model for f in (best, *fits) if set(f.model) <= set(free.values())]
        found = sets.best(max(started, key=sets.score), list(free.values()))
        if set(found.model) == set(best.model):
            break
        fit = search.fitted(found.model, found.values, found.deviations) if found.model else fits[0]
        if fit is None:
            return list(fits), weights
        best = fit
        if not best.model:
            break
    if best.model and len(search.evidence.space.blocks) > 1:
        best.predictive = {name: part.predicted for name, part in leave_one_out(best, search.evidence.space).items()}
    sets.score(best.model)
    scores = {names: log for names, (log, _) in sets.known.items()}
    likely = logsumexp(list(scores.values())) - np.log(len(scores))  # more than the mean
    kept = {frozenset(c.name for c in f.model): f for f in fits if f.model and set(f.values) <= set(sets.order)}
    kept |= {n: _beside(search, best, sets.known[n][1]) for n, log in scores.items() if n and log > likely and n not in kept}
    kept |= {frozenset(): fits[0], frozenset(c.name for c in best.model): best}
    ordered = [fits[0], *(f for n, f in kept.items() if n)]
    logs = np.array([sets.score(f.model) for f in ordered])
    return ordered, np.asarray(np.exp(logs - logsumexp(logs)))


def _beside(search: Search, best: Fit, fit: Fit) -> Fit:
    """A model of `Sets` with its signature, by sensitivities about that of the best model: nothing is simulated."""
    assert best.signature is not None
    assert best.sensitivities is not None
    order = [(c, a) for c in best.model for a in c.addresses]
    columns = {a: best.sensitivities[:, i] for i, (_, a) in enumerate(order)}
    signature = best.signature - best.sensitivities @ np.array([best.values[a] / c.prior.scale for c, a in order])
    own = [(c, a) for c in fit.model for a in c.addresses]
    slopes = np.stack([columns[a] if a in columns else per_scale(search.evidence, search.starts, a) for _, a in own]).T
    signature = signature + slopes @ np.array([fit.values[a] / c.prior.scale for c, a in own])
    left = search.evidence.space.y - signature
    chi2 = search.evidence.space.without([a for _, a in own]).square(left)
    return replace(fit, chi2=chi2, signature=signature, sensitivities=slopes)
