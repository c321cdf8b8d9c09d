"""Simulated machines without effects: how large the odds for an effect become by chance."""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from robomill.diagnosis.inference.adequacy import LEVEL, SPREAD
from robomill.diagnosis.inference.fitting import addresses_of
from robomill.diagnosis.inference.priors import log_priors
from robomill.diagnosis.inference.search import Search
from robomill.orchestration.slaves.protocol import FloatArray

MACHINES = 2000
"""Simulated machines [1]: their 2 % quantile rests on forty of them."""


def p_none(search: Search, log_odds: float, seed: int = 0) -> float:
    """Part of simulated machines without effects whose log odds for any single effect are at least `log_odds`.

    Of a machine with whitened residual y, only the products with the sensitivities V count: <V, y>. Where noise and tolerances are what the
    space takes them for these are N(0, <V, V>), whatever the number of samples. The rank is (1 + those above) / (1 + MACHINES).
    """
    columns = {a: i for i, a in enumerate(addresses_of(search.candidates))}
    gram = search.evidence.space.within(search.together[1], range(len(columns)))
    values, vectors = np.linalg.eigh(gram)
    random = np.random.default_rng(seed)
    level = np.maximum(random.normal(LEVEL, SPREAD, (MACHINES, 1)), 0.0)  # of the chi2 that a machine leaves
    draws = np.sqrt(level) * random.standard_normal((MACHINES, len(gram)))
    products = draws @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    odds = []
    nominal = log_priors([()], search.candidates)[0]
    for c, prior in zip(search.candidates, log_priors([(c,) for c in search.candidates], search.candidates), strict=True):
        at = [columns[a] for a in c.addresses]
        odds.append(_log_evidence(products[:, at], gram[np.ix_(at, at)], c.both_signs) + prior - nominal)
    return float((1 + (logsumexp(odds, axis=0) >= log_odds).sum()) / (1 + MACHINES))


def _log_evidence(products: FloatArray, gram: FloatArray, both_signs: bool) -> FloatArray:
    """Log evidence of one effect in each machine, [machines]: normal prior of deviation 1, half of it where there is one sign only."""
    precision = gram + np.eye(len(gram))
    x = np.linalg.solve(precision, products.T).T
    if not both_signs and len(gram) == 1:
        x = np.maximum(x, 0.0)
    return np.asarray(0.5 * ((2.0 * x * products).sum(axis=1) - ((x @ precision) * x).sum(axis=1) - np.linalg.slogdet(precision)[1]))
