"""How likely each set of effects is before the data: a machine has few kinds of effects, but one kind may be in all of its joints."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.inference.estimation import Fit, Model
from robomill.orchestration.slaves.protocol import FloatArray

NOTHING = 0.3
"""Probability [1] that a machine has no effect (DIAGNOSIS: a fifth to a third of the machines are as good as any)."""
ANOTHER = 0.5
"""Probability [1] of a further kind of effect where there is one, and of a further place where an effect is in one: geometric in both."""


def log_priors(models: Sequence[Model], candidates: Sequence[Candidate]) -> list[float]:
    """Log of the probability of each model before the data.

    Of m kinds out of K, kind j in n_j of its L_j places: P = (1 - NOTHING) (1 - q) q^(m - 1) / C(K, m) times the product over the kinds of
    (1 - q) q^(n_j - 1) / C(L_j, n_j), with q = ANOTHER. The nominal model has NOTHING.
    """
    kinds = len({c.effect for c in candidates})
    q = ANOTHER

    def geometric(n: int, of: int) -> float:
        return math.log(1.0 - q) + (n - 1) * math.log(q) - math.log(math.comb(max(of, n), n))

    found = []
    for model in models:
        places = Counter(c.effect for c in model)
        of = {c.effect: c.locations for c in model}
        log = math.log(1.0 - NOTHING) + geometric(len(places), kinds) if model else math.log(NOTHING)
        found.append(log + sum(geometric(n, of[effect]) for effect, n in places.items()))
    return found


def log_posteriors(fits: Sequence[Fit], candidates: Sequence[Candidate]) -> FloatArray:
    """Log of evidence times prior of each fit [nats], float64[fits]; not normalised."""
    priors = log_priors([f.model for f in fits], candidates)
    return np.array([f.log_evidence + p for f, p in zip(fits, priors, strict=True)])


def probabilities(fits: Sequence[Fit], candidates: Sequence[Candidate]) -> FloatArray:
    """Probabilities of the models in `fits` after the data, float64[fits]: evidence times prior, over the sum of that of all fits."""
    scores = log_posteriors(fits, candidates)
    return np.asarray(np.exp(scores - logsumexp(scores)))
