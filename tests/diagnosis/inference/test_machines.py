"""The rank of the odds for an effect among machines that have none."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import kstest

from robomill.diagnosis.candidates import COS, SIN, Candidate
from robomill.diagnosis.inference import machines
from robomill.diagnosis.inference.estimation import Space, quadratic_fit
from robomill.diagnosis.inference.machines import MACHINES, p_none
from robomill.diagnosis.inference.priors import log_posteriors, log_priors
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.inference.sensitivities import Start
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.inference.test_estimation import candidate, log_density
from tests.tolerances import chance

N = 60


@pytest.fixture(autouse=True)
def _alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """Machines that all leave what noise and discrepancy do."""
    monkeypatch.setattr(machines, "LEVEL", 1.0)
    monkeypatch.setattr(machines, "SPREAD", 0.0)


RANKS = 60
GRID = 1e-3
"""Largest log odds differ by far more between two of 2000 machines in the middle of them."""


def drawn(nuisances: FloatArray, seed: int, count: int = 1) -> FloatArray:
    """Whitened residuals of machines without effects, [n, machines]: noise of 1, and nuisances within their deviations."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(N, count)) + nuisances @ rng.normal(size=(nuisances.shape[1], count))


class Known(Search):
    """A search that is over."""

    def __init__(self, candidates: Sequence[Candidate], evidence: Any, starts: dict[Any, Start]) -> None:
        self.candidates, self.evidence, self.starts = list(candidates), evidence, starts


def search(candidates: tuple[Candidate, ...], columns: FloatArray, nuisances: FloatArray, starts: dict[Any, Start] | None = None) -> Any:
    """All that is asked of one: the space of these machines, and what each parameter does."""
    addresses = dict.fromkeys(a for c in candidates for a in c.addresses)
    sensitivities = dict(zip(addresses, columns.T, strict=True))
    evidence = SimpleNamespace(space=Space(drawn(nuisances, 0)[:, 0], {"all": slice(0, N)}, nuisances), sensitivities=sensitivities)
    return Known(candidates, evidence, starts or {})


def best_odds(of: Any, y: FloatArray) -> float:
    """Log odds for any single effect: the density of normal distributions, and priors."""
    nuisances = of.evidence.space.nuisances.toarray()
    nominal = log_density(y, nuisances) + log_priors([()], of.candidates)[0]
    odds = []
    for c, prior in zip(of.candidates, log_priors([(c,) for c in of.candidates], of.candidates), strict=True):
        own = np.stack([of.evidence.sensitivities[a] for a in c.addresses], axis=1)
        odds.append(log_density(y, nuisances, own) + prior - nominal)
    return float(logsumexp(odds))


PHASED = replace(candidate("p", "runout"), parameters=(f"p{COS}phase", f"p{SIN}phase"))


@pytest.mark.parametrize("size", [0.1, 1.0])
def test_it_is_uniform_for_machines_drawn_from_the_space_itself(size: float) -> None:
    """Effects of either sign, one of them with a phase; closed form on one side, 2000 machines on the other."""
    rng = np.random.default_rng(3)
    candidates = (candidate("a", "play"), candidate("b", "gain", locations=2), candidate("c", "gain", locations=2), PHASED)
    columns = size * rng.normal(size=(N, 5))
    columns[:, 1] += columns[:, 0]  # two that look alike
    nuisances = rng.normal(size=(N, 3)) * [0.3, 1.0, 3.0]
    of = search(candidates, columns, nuisances)
    ranks = [p_none(of, best_odds(of, y)) for y in drawn(nuisances, 5, RANKS).T]
    # both samples scatter: that of the machines beside that of the ranks
    assert kstest(ranks, "uniform").statistic < chance(0.5 * math.sqrt(1.0 / RANKS + 1.0 / MACHINES))


@pytest.mark.parametrize("count", [1, 10])
def test_it_is_uniform_for_the_odds_that_the_verdict_asks_about(count: int) -> None:
    """These are the odds of all models together that were fitted, not those of the best one."""
    rng = np.random.default_rng(4)
    candidates = tuple(candidate(f"a{i}", f"kind {i}") for i in range(count))
    nuisances = rng.normal(size=(N, 3))
    of = search(candidates, 0.5 * rng.normal(size=(N, count)), nuisances)
    ranks = []
    for y in drawn(nuisances, 6, RANKS).T:
        space = Space(y, {"all": slice(0, N)}, nuisances)
        fits = [quadratic_fit((c,), 0.0 * y, of.evidence.sensitivities[c.addresses[0]][:, None], np.zeros(1), space) for c in candidates]
        scores = log_posteriors(fits, candidates)
        ranks.append(p_none(of, float(np.logaddexp.reduce(scores)) - log_priors([()], candidates)[0]))
    assert kstest(ranks, "uniform").statistic < chance(0.5 * math.sqrt(1.0 / RANKS + 1.0 / MACHINES))


def test_the_rank_counts_itself_and_falls_with_the_odds() -> None:
    of = search((candidate("a"),), np.ones((N, 1)), np.zeros((N, 0)))
    assert p_none(of, -math.inf) == 1.0
    assert p_none(of, math.inf) == 1.0 / (1.0 + MACHINES)
    ranks = [p_none(of, odds) for odds in np.linspace(-5.0, 20.0, 50)]
    assert all(b <= a for a, b in itertools.pairwise(ranks))


def test_one_column_has_a_closed_form() -> None:
    """With <v, y>^2 / <v, v> = z^2, log odds are (z^2 g / (1 + g) - log(1 + g)) / 2 and those of the priors, g = <v, v>."""
    v = 0.5 * np.random.default_rng(1).normal(size=(N, 1))
    of = search((candidate("a"),), v, np.zeros((N, 0)))
    g, (prior, nominal) = float(v[:, 0] @ v[:, 0]), log_priors([(candidate("a"),), ()], (candidate("a"),))
    for z, tail in ((0.6745, 0.5), (1.6449, 0.1), (2.5758, 0.01)):
        odds = 0.5 * (z * z * g / (1.0 + g) - math.log1p(g)) + prior - nominal
        assert p_none(of, odds) == pytest.approx(tail, abs=chance(math.sqrt(tail * (1.0 - tail) / MACHINES)))


def test_effects_of_one_sign_have_odds_on_one_side_only() -> None:
    """Half of the machines then have the largest odds at no effect: what is twice as rare with both signs."""
    v = 0.5 * np.random.default_rng(1).normal(size=(N, 1))
    one, both = (search((replace(candidate("a"), both_signs=b),), v, np.zeros((N, 0))) for b in (False, True))
    g, (prior, nominal) = float(v[:, 0] @ v[:, 0]), log_priors([(candidate("a"),), ()], (candidate("a"),))
    odds = 0.5 * (2.0**2 * g / (1.0 + g) - math.log1p(g)) + prior - nominal
    assert p_none(one, odds) == pytest.approx(0.5 * 0.0455, abs=chance(math.sqrt(0.0228 / MACHINES)))
    assert p_none(both, odds) == pytest.approx(0.0455, abs=chance(math.sqrt(0.0455 / MACHINES)))


def test_an_effect_that_turns_counts_by_the_signature_where_its_fit_starts() -> None:
    rng = np.random.default_rng(2)
    v, other = 0.5 * rng.normal(size=(N, 1)), 0.1 * rng.normal(size=N)
    start = Start(0.2, 0.2 * v[:, 0], other)
    plain = search((candidate("a"),), v, np.zeros((N, 0)))
    turned = search((candidate("a"),), 7.0 * other[:, None], np.zeros((N, 0)), {candidate("a").addresses[0]: start})
    for odds in (-1.0, 0.0, 1.0, 3.0):
        assert p_none(turned, odds) == pytest.approx(p_none(plain, odds), abs=GRID)
