"""Which of the answers it is: two tests, and the posterior.

`p_none`: part of the simulated machines without effects whose odds for an effect are as large. `p_fit`: probability that the best model
is right rather than the nearest thing in the catalogue to something that is not in it, from what it leaves and from what it is worth
in new conditions.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import expit

from robomill.diagnosis.candidates import LOGGING, Address, Candidate
from robomill.diagnosis.inference.adequacy import (
    CONDITIONS,
    LEVEL,
    MISFIT,
    UNKNOWN,
    agreement,
    in_common,
    kept,
    left_by,
    misfit,
    most_left,
    together,
    unexplained,
    unless,
    within_tolerances,
    worsened,
)
from robomill.diagnosis.inference.estimation import Fit, Model
from robomill.diagnosis.inference.priors import log_priors
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.inference.time_varying import Changing
from robomill.diagnosis.inference.transfer import Transfer
from robomill.orchestration.slaves.protocol import FloatArray

Verdict = Literal["none", "identified", "ambiguous", "unknown", "bad_log"]

UNLISTED = 0.4
"""Probability [1] before the data that what is wrong is in no catalogue (judgement): more than 1 - IDENTIFIED, so that no answer is given
as the only one where the data say nothing of whether it is right, and less than a half, so that it is given as one of several."""
IDENTIFIED = 0.8
"""Probability from which one answer is given."""


@dataclass(frozen=True)
class Odds:
    """Log Bayes factors for the best model against the nearest thing in the catalogue [nats], by what they come from.

    Their sum and the odds before the data (UNLISTED) are log(p_fit / (1 - p_fit)).
    """

    left: float
    """What it leaves of the gap in the diagnosed runs."""
    worse: float
    """What it makes worse there; 0 or less."""
    elsewhere: float
    """What it leaves or makes worse in new conditions; 0 or less."""
    alike: float
    """How alike it acts in all conditions, the new ones included."""
    calibrated: float
    """How far calibrated numbers would have to be off."""
    lag: float
    """That its clocks are late alike, which one lag of the machine would be, too; 0 or less."""


@dataclass(frozen=True)
class Tests:
    """What the verdict rests on."""

    false_alarm: float
    """The false-alarm rate that was asked for."""
    p_none: float
    """Part of the simulated machines without effects whose log odds for an effect are as large as these."""
    p_fit: float
    """Probability that the best model is right, rather than the nearest thing in the catalogue."""
    nothing: float
    """Probability of the nominal model, new conditions included."""
    odds: Odds | None = None
    """What `p_fit` is made of."""


def looks(search: Search, fit: Fit) -> tuple[float, float]:
    """What a model leaves over noise and discrepancy: in the worst channel of a condition, and of what all candidates could explain.

    See `Evidence.level` and `Search.explainable`.
    """
    assert fit.signature is not None
    return looks_at(search, search.evidence.space.y - fit.signature)


def looks_at(search: Search, left: FloatArray) -> tuple[float, float]:
    """How much a residual [n] is over noise and discrepancy, by both looks (`looks`)."""
    return search.evidence.level(left), search.explainable(left)


def over_noise(search: Search, fit: Fit) -> float:
    """How much a model leaves, by the look that sees more of it (`looks`)."""
    return max(looks(search, fit))


def largest(search: Search, nominal: Fit, moved: Transfer | None) -> float:
    """How much the nominal system leaves over noise, in the diagnosed conditions or in new ones."""
    return max(over_noise(search, nominal), moved.before if moved is not None else 0.0)


def share_left(search: Search, nominal: Fit, best: Fit) -> float:
    """Share of the gap of the nominal model that another one leaves (`unexplained`), by the look that sees more of it left."""
    seen = sorted(zip(looks(search, nominal), looks(search, best), strict=True))
    return max(unexplained(before, after) for before, after in seen if before > UNKNOWN or (before, after) == seen[-1])


def tested(
    search: Search,
    nominal: Fit,
    best: Fit,
    nothing: float,
    p_none: float,
    moved: Transfer | None,
    alpha: float,
    scatter: tuple[float, float],
) -> Tests:
    """The tests of an answer; `nothing`: probability of the nominal model by the diagnosed runs, `moved`: new conditions.

    `scatter`: that of repeats over the scatter of the nominal system and of the model, where it has any (`scatter.levels`).
    """
    odds = math.log1p(-nothing) - math.log(nothing) if 0.0 < nothing < 1.0 else math.copysign(math.inf, 0.5 - nothing)
    kinds = max(len({c.effect for c in best.model}), 1)
    evidence, shape = search.evidence, (misfit(best), kinds)
    assert nominal.signature is not None
    assert best.signature is not None
    before, after = (evidence.space.y - x for x in (nominal.signature, best.signature))
    channels, catalogue = zip(looks(search, nominal), looks(search, best), strict=True)
    # the first look is at the worst condition, the others at all together
    ways = ((channels, len(evidence.space.blocks)), (catalogue, CONDITIONS), (scatter, CONDITIONS))
    seen = [(left_by(b, a, *shape, n), left_by(b, min(a, LEVEL), *shape, n)) for (b, a), n in ways]
    known = evidence.guess <= 1.0  # else what is left in new conditions is of a noise that is a guess, and counts by itself
    left = most_left(seen)
    elsewhere = most_left(seen, moved.loses if moved is not None and known else 0.0) - left
    here = unless(left, search.imitates(best, kinds))
    anywhere = here + elsewhere
    overall = together(anywhere, worsened(evidence, before, after, best.signature))
    holds = held_together(search, best)
    if moved is not None:
        odds += moved.gain
        holds += moved.holds
        elsewhere += moved.fails if not known else 0.0
    of = Odds(here, overall - anywhere, elsewhere, kept(holds), within_tolerances(*search.numbers(best)[1:], evidence.guess), 0.0)
    fits = math.log(1.0 - UNLISTED) - math.log(UNLISTED) + sum(astuple(of))
    # a lag of the machine leaves what the clocks leave, and does what they do in new conditions
    lag = -float(np.logaddexp(0.0, fits + common_lag(search, best) + math.log(UNLISTED) - math.log(1.0 - UNLISTED)))
    return Tests(alpha, p_none, float(expit(fits + lag)), float(expit(-odds)), replace(of, lag=lag))


def common_lag(search: Search, fit: Fit) -> float:
    """Log Bayes factor for a lag of the machine, against several sources of the log that are late: how alike these times are (`in_common`).

    A clock belongs to one source. What several of them have in common, and not all, is a property of the machine; what all have is one of
    the log as a whole. -inf where no more than one is late.
    """
    late = {_source(c): c for c in fit.model if _is_late(c)}
    found = [-math.inf]
    for count in range(2, len(late) + 1):
        for members in itertools.combinations(late.values(), count):
            if {_source(c) for c in search.candidates if _is_late(c)} - {_source(c) for c in members}:
                values, deviations = (np.array([of[c.addresses[0]] for c in members]) for of in (fit.values, fit.deviations))
                found.append(in_common(values, deviations, members[0].prior.scale))
    return max(found)


def _is_late(c: Candidate) -> bool:
    return c.component == LOGGING and c.parameters[0].startswith("lag ")


def _source(c: Candidate) -> str:
    """The component whose channels a fault of the log is in."""
    return c.parameters[0].partition(" ")[2].partition(".")[0]


def held_together(search: Search, fit: Fit) -> float:
    """Log Bayes factor for a right model against a stand-in, from how alike its amplitude is in all diagnosed conditions (`agreement`)."""
    if not fit.model or fit.signature is None:
        return 0.0
    space = search.evidence.space.without(list(fit.values))
    parts = np.zeros((space.y.size, len(space.blocks)))
    for i, block in enumerate(space.blocks.values()):
        parts[block, i] = fit.signature[block]
    sizes, left = np.diag(space.dot(parts, parts)), space.dot(parts, (space.y - fit.signature)[:, None])[:, 0]
    return agreement(1.0 + left / np.maximum(sizes, 1e-300), sizes, misfit(fit))


def judged(
    search: Search,
    tests: Tests,
    nominal: Fit,
    best: Fit,
    changing: Callable[[], Changing | None],
    probabilities: Mapping[Candidate, float],
    faulty: bool,
    differs: bool = False,
    moved: Transfer | None = None,
) -> Verdict:
    """The verdict; `probabilities`: of each candidate, `p_fit` included; `changing`: finds an effect that changes with time, if asked.

    `faulty`: a fault of the log is part of the best model. `differs`: something differs from run to run (`scatter`). `moved`: new
    conditions, where a gap is one, too.
    """
    wrong = refuted(tests.p_fit) or at_bound(best.model, best.values)
    gap = largest(search, nominal, moved) > UNKNOWN or not sound(search, nominal)
    guess = search.evidence.guess > 1.0  # of noise: nobody knows how slow it is, and an effect within it may be that
    there = bool(best.model) and believed(tests) and (gap or not guess)
    if not there or wrong or ((other := changing()) is not None and changes(search, best, other)):
        return "unknown" if gap or differs or there else "none"
    if faulty:
        return "bad_log"
    return "identified" if all(probabilities[c] >= IDENTIFIED for c in best.model) else "ambiguous"


def sound(search: Search, nominal: Fit) -> bool:
    """Whether the nominal system is likelier right than a machine with something wrong that is in no catalogue.

    How far its calibrated numbers are off says so, and, where noise is known, what it leaves in the worst channel. What candidates could
    explain is in the odds of these already (decision 123).
    """
    level, _ = looks(search, nominal)
    known = search.evidence.guess <= 1.0
    return right(search, nominal, left_by(level, level, conditions=len(search.evidence.space.blocks)) if known else 0.0)


def right(search: Search, fit: Fit, left: float) -> bool:
    """Whether a model is likelier right than a stand-in or something unlisted: by its calibrated numbers and the odds before the data.

    `left`: log Bayes factor from what it leaves [nats].
    """
    odds = math.log(1.0 - UNLISTED) - math.log(UNLISTED)
    return odds + left + within_tolerances(*search.numbers(fit)[1:], search.evidence.guess) > 0.0


def refuted(p_fit: float) -> bool:
    """Whether a model is likelier wrong than right, by `Tests.p_fit`."""
    return p_fit < 1.0 - p_fit


def at_bound(model: Model, values: Mapping[Address, float]) -> bool:
    """Whether an effect is as large as the catalogue lets it be, by these values [unit]: the data ask for more, or for something else."""
    return any(c.at_bound(values) for c in model)


def believed(tests: Tests) -> bool:
    """Whether there is an effect at all: few machines without effects look like this, and it is improbable that this is one of them."""
    return tests.p_none <= tests.false_alarm and tests.nothing <= tests.false_alarm


def changes(search: Search, best: Fit, other: Changing) -> bool:
    """Whether something that changes with time, which is in no catalogue, is likelier than the best model."""
    odds = best.log_evidence + log_priors([best.model], search.candidates)[0]
    beyond = best.chi2 - search.evidence.noise  # of what a strong effect leaves, something always goes with time
    likelier = other.log_odds + math.log(UNLISTED / (1.0 - UNLISTED)) > odds
    return likelier and other.by_change > 0.5 * MISFIT * max(beyond, 0.0)
