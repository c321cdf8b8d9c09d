"""Sets of effects of a single recording: each judged by what it adds to the others, with noise that remembers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import toeplitz
from scipy.special import logsumexp

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.inference.evidence import FORM
from robomill.diagnosis.inference.intervals import Noise, Problem
from robomill.diagnosis.inference.sets import Sets
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis import axis
from tests.diagnosis.formula import candidate
from tests.diagnosis.inference.test_intervals import STEP, T, noise
from tests.tolerances import chance, of_variance

COUNT = 12
CANDIDATES = tuple(replace(candidate(f"p{k}"), effect=f"kind {k % 4}", location=f"place {k}", locations=COUNT // 4) for k in range(COUNT))
SIZES = {0: 3.0, 1: -2.0, 2: 0.3, 5: 1.5, 6: 0.35, 9: 5.0}
"""Sizes of effects that are there: some close a hundredth of what others do."""
MEMORY_OF_CHANCE = 0.1
"""White noise of a thousand samples seems to remember a little: its covariance is known as well as that."""
RIDGE = 1e-3
"""What the ridge of `Problem.seen` (1e-6) makes of values, times the condition of the columns."""


def motion() -> FloatArray:
    """What each effect does, [rows, COUNT]."""
    return np.stack([np.sin((0.3 + 0.41 * k) * T + k) for k in range(COUNT)], axis=1)


def problem(y: FloatArray, columns: FloatArray, at: FloatArray | None = None) -> Problem:
    """One channel, of which column k is what p<k> does, about the values `at` or none; nothing is named."""
    k = columns.shape[1]
    at = np.zeros(k) if at is None else at
    ends = np.full(k, -np.inf), np.full(k, np.inf)
    order = [("a", f"p{i}") for i in range(k)]
    return Problem(order, np.ones(k), *ends, at, np.zeros(k, dtype=np.bool_), [(y - columns @ at)[:, None]], [columns[:, None, :]], STEP, k)


def sets_of(made: Problem, candidates: tuple[Candidate, ...] = CANDIDATES) -> Sets:
    return Sets.of(made, candidates)


def named(sets: Sets, model: tuple[Candidate, ...] = ()) -> set[int]:
    """Effects of a probability of 0.8 or more."""
    sets.best(model, CANDIDATES)
    logs = np.array([log for log, _ in sets.known.values()])
    weights = np.exp(logs - logsumexp(logs))
    likely = {k: sum(w for names, w in zip(sets.known, weights, strict=True) if c.name in names) for k, c in enumerate(CANDIDATES)}
    return {k for k, p in likely.items() if p >= 0.8}


def test_many_effects_are_found_beside_each_other_and_nothing_else() -> None:
    J, false = motion(), 0
    for seed in range(10):
        y = J[:, list(SIZES)] @ list(SIZES.values()) + 0.3 * noise(np.random.default_rng([5, seed]))
        made = problem(y, J)
        found = named(sets_of(made))
        assert found >= set(SIZES)
        assert named(sets_of(made), tuple(CANDIDATES[k] for k in (0, 3, 9))) == found  # one of them is wrong
        false += len(found - set(SIZES))
    assert false <= 1


def test_noise_that_remembers_is_taken_for_no_effect() -> None:
    """What is as large in noise that remembers as in white noise is far less sure there."""
    J, rng = motion(), np.random.default_rng(6)
    false = [named(sets_of(problem(J[:, 0] + noise(rng, 0.1, 1.0, 0.2), J))) - {0} for _ in range(20)]
    assert sum(map(len, false)) <= 2


def test_a_tolerance_explains_what_an_effect_like_it_would() -> None:
    J = motion()
    y = J[:, 0] + 0.05 * noise(np.random.default_rng(7))
    made = problem(y, np.column_stack([J, J[:, 0] + 1e-3 * J[:, 1]]))  # the last number is one of no effect
    assert named(sets_of(problem(y, J))) == {0}
    assert named(sets_of(made)) == set()


def test_least_squares_see_their_own_values_with_the_precision_of_the_noise() -> None:
    """As many samples as numbers have used are gone; in white noise that is the gram matrix, but for the form of each effect."""
    J = motion()
    white = np.random.default_rng(8).standard_normal(len(T))
    truth = np.linspace(0.1, 3.0, COUNT)
    made = problem(J @ truth + white, J, truth)
    solution = made.solved()
    precision, product = made.seen(solution)
    size = float(np.var(solution.rest[0])) * len(T) / (len(T) - COUNT)
    gram = J.T @ J
    expected = np.linalg.inv(np.linalg.inv(gram) * size + np.diag((FORM * solution.x) ** 2))
    assert np.allclose(precision, expected, rtol=MEMORY_OF_CHANCE, atol=MEMORY_OF_CHANCE * np.diag(expected).min())
    assert np.allclose(np.linalg.solve(precision, product), np.linalg.solve(gram, J.T @ solution.gaps[0][:, 0]), rtol=RIDGE, atol=RIDGE)


def test_noise_is_drawn_as_it_is() -> None:
    of = Noise(0.3, 0.8, 0.9)
    drawn = of.drawn(np.random.default_rng(9), 6, 200000)
    covariance, off = 0.3 * np.eye(6) + 0.8 * toeplitz(0.9 ** np.arange(6)), chance(of_variance(drawn.shape[1]))
    assert np.allclose(drawn @ drawn.T / drawn.shape[1], covariance, rtol=off, atol=off)


def test_an_effect_below_its_minimum_is_none() -> None:
    J = motion()
    y = 1e-2 * J[:, 0]
    found = problem(y + 1e-5 * noise(np.random.default_rng(10)), J)
    large = tuple(replace(c, minimum=0.02) for c in CANDIDATES)
    assert sets_of(found, large).score((large[0],)) == -np.inf
    assert sets_of(found).score((CANDIDATES[0],)) > 0.0


def test_the_answer_of_a_single_run_names_small_effects_beside_large_ones(tmp_path: Path) -> None:
    """Viscous friction closes a hundredth of what Coulomb friction does."""
    small = {"coulomb": 5.0, "viscous": 0.02}
    found = diagnose(axis.system(), axis.measure(small), axis.catalogue(tmp_path), resolver=axis.resolve)
    assert {w.effect for w in found.answer.which if w.probability > 0.8} == set(small)
