"""Which of the answers it is: two tests, and the posterior.

`p_none`: part of the simulated machines without effects whose odds for an effect are as large. `p_fit`: probability that the best model
is right rather than the nearest thing in the catalogue to something that is not in it, from what it leaves and from what it is worth
in new conditions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import expit, logsumexp

from robomill.diagnosis.catalogue import Candidate
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.priors import log_priors
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.inference.time_varying import Changing
from robomill.diagnosis.inference.transfer import Transfer

Verdict = Literal["none", "identified", "ambiguous", "unknown", "bad_log"]

FALSE_ALARM = 0.02
"""Probability [1] of an effect on a machine that has none, where the user asks for no other (DIAGNOSIS: at most 2 % of the nulls)."""
OUTSIDE = 0.2
"""Probability [1] before the data that what is wrong is in no catalogue (judgement; DIAGNOSIS: 15 % of the machines of its benchmark)."""
LEVEL, SPREAD = 1.1, 0.1
"""chi2 over that of noise [1] that two systems which are the same but for calibration leave, and its standard deviation."""
MISFIT = 0.05
"""Mean share [1] of a gap that a right model leaves, because its law is not quite that of the machine: a fifth of the amplitude."""
UNKNOWN = 1.4
"""chi2, over that of noise, from which there is a gap even if no candidate explains any of it: LEVEL and three times SPREAD."""
IDENTIFIED = 0.8
"""Probability from which one answer is given."""


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


def over_noise(search: Search, fit: Fit) -> float:
    """chi2 that a model leaves, over that which noise alone is expected to leave."""
    return fit.chi2 / float(search.evidence.expected.sum())


def unexplained(before: float, after: float) -> float:
    """Share of chi2 beyond that of a machine without effects that a model leaves: (after - LEVEL) / (before - LEVEL).

    `before`, `after`: what the nominal system and the model leave, over that of noise (`over_noise`); the share is not below 0.
    """
    return max(after - LEVEL, 0.0) / max(before - LEVEL, 1e-9)


def tested(search: Search, nominal: Fit, best: Fit, nothing: float, p_none: float, moved: Transfer | None, alpha: float) -> Tests:
    """The tests of an answer; `nothing`: probability of the nominal model by the diagnosed runs, `moved`: new conditions."""
    odds = math.log1p(-nothing) - math.log(nothing) if 0.0 < nothing < 1.0 else math.copysign(math.inf, 0.5 - nothing)
    fits = math.log((1.0 - OUTSIDE) / OUTSIDE) + left_by(over_noise(search, nominal), over_noise(search, best))
    if moved is not None:
        odds += moved.gain
        fits += left_by(moved.before, moved.after) + moved.promise
    return Tests(alpha, p_none, float(expit(fits)), float(expit(-odds)))


def left_by(before: float, after: float) -> float:
    """Log Bayes factor for a right model against a stand-in, from what it leaves of a gap; both over noise.

    after ~ N(LEVEL + u (before - LEVEL), SPREAD^2). The share u that is left is Beta(1, 1 / MISFIT - 1) for a right model, and could be
    anything between 0 and 1 for a stand-in.
    """
    gap = max(before - LEVEL, 0.0)
    centre, width = (after - LEVEL) / (gap + 1e-12), SPREAD / (gap + 1e-12)
    u = np.unique(np.clip(np.concatenate([np.linspace(0.0, 1.0, 201), centre + width * np.linspace(-8.0, 8.0, 201)]), 0.0, 1.0))
    log_likelihood = -0.5 * ((u - centre) / width) ** 2
    step = np.log(np.maximum(np.gradient(u), 1e-300)) if len(u) > 1 else np.zeros(1)
    b = 1.0 / MISFIT - 1.0
    right = math.log(b) + (b - 1.0) * np.log(np.maximum(1.0 - u, 1e-300))
    return float(logsumexp(log_likelihood + right + step) - logsumexp(log_likelihood + step))


def judged(
    search: Search, tests: Tests, nominal: Fit, best: Fit, other: Changing | None, probabilities: Mapping[Candidate, float], faulty: bool
) -> Verdict:
    """The verdict; `probabilities`: of each candidate, `p_fit` included; `other`: an effect that changes with time.

    `faulty`: a fault of the log is part of the best model.
    """
    if not best.model or not believed(tests):
        return "unknown" if over_noise(search, nominal) > UNKNOWN else "none"
    if tests.p_fit < 0.5 or (other is not None and changes(search, best, other)):
        return "unknown"
    if faulty:
        return "bad_log"
    return "identified" if all(probabilities[c] >= IDENTIFIED for c in best.model) else "ambiguous"


def believed(tests: Tests) -> bool:
    """Whether there is an effect at all: few machines without effects look like this, and it is improbable that this is one of them."""
    return tests.p_none <= tests.false_alarm and tests.nothing <= tests.false_alarm


def changes(search: Search, best: Fit, other: Changing) -> bool:
    """Whether something that changes with time, which is in no catalogue, is likelier than the best model."""
    odds = best.log_evidence + log_priors([best.model], search.candidates)[0]
    beyond = best.chi2 - LEVEL * float(search.evidence.expected.sum())  # of what a strong effect leaves, something always goes with time
    likelier = other.log_odds + math.log(OUTSIDE / (1.0 - OUTSIDE)) > odds
    return likelier and other.by_change > 0.5 * MISFIT * max(beyond, 0.0)
