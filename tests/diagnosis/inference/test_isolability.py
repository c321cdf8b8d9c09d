"""How far apart fitted models are, and which candidates can stand for each other."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robomill.diagnosis.candidates import Candidate, Prior
from robomill.diagnosis.inference.estimation import Fit, Space
from robomill.diagnosis.inference.isolability import CONFUSABLE, distance, pairs
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import EXACT, ROUNDOFF

N = 40
PLAIN = Space(np.zeros(N), {"one": slice(0, N)}, np.zeros((N, 0)))
A, B, C = (Candidate("effect", "part", name, (name,), 0.01, 1.0, Prior("normal", 0.1), "1", True, 3) for name in "abc")


def fit(model: tuple[Candidate, ...], signature: FloatArray | None) -> Fit:
    return Fit(model, {}, {}, 0.0, 0.0, signature=signature)


def along(i: int, size: float) -> FloatArray:
    return size * np.eye(N)[i]


def test_models_are_apart_by_the_deviations_that_their_signatures_are() -> None:
    assert distance(fit((A,), along(0, 3.0)), fit((B,), along(1, 4.0)), PLAIN) == pytest.approx(5.0, rel=ROUNDOFF)
    assert distance(fit((A,), along(0, 3.0)), fit((B,), along(0, 3.0)), PLAIN) == EXACT


def test_a_difference_that_a_calibrated_number_may_make_is_none() -> None:
    """In the direction of a nuisance of s deviations of noise d / sqrt(1 + s^2) is left of a difference d."""
    tolerant = Space(np.zeros(N), {}, along(0, 3.0)[:, None])
    assert distance(fit((A,), along(0, 5.0)), fit((B,), np.zeros(N)), tolerant) == pytest.approx(5.0 / math.sqrt(10.0), rel=ROUNDOFF)
    assert distance(fit((A,), along(1, 5.0)), fit((B,), np.zeros(N)), tolerant) == pytest.approx(5.0, rel=ROUNDOFF)


def test_pairs_are_models_that_differ_in_one_candidate_closest_first() -> None:
    fits = [
        fit((), np.zeros(N)),
        fit((B,), along(0, 7.0)),
        fit((A,), along(0, 5.0)),
        fit((C,), along(0, 4.0)),
        fit((A, C), along(0, 5.5)),  # B and C beside A: closer than each by itself
        fit((A, B), along(0, 6.0)),
        fit((B, C), None),
    ]
    found = [(*p.pair, p.distance, p.confusable) for p in pairs(fits, [A, B], PLAIN)]
    # A for B beside nothing is 2 apart, A for C 1, B for C beside A 0.5; A and C beside nothing is no smaller beside B
    assert found == [
        (B.name, C.name, pytest.approx(0.5, rel=ROUNDOFF), True),
        (A.name, C.name, pytest.approx(1.0, rel=ROUNDOFF), True),
        (A.name, B.name, pytest.approx(2.0, rel=ROUNDOFF), True),
    ]


def test_pairs_of_which_none_survives_are_not_looked_at() -> None:
    fits = [fit((A,), along(0, 5.0)), fit((B,), along(0, 4.0)), fit((C,), along(0, 5.0 + CONFUSABLE))]
    assert {p.pair for p in pairs(fits, [C], PLAIN)} == {(A.name, C.name), (B.name, C.name)}
    assert pairs(fits, [], PLAIN) == []
    assert [p.confusable for p in pairs(fits, [C], PLAIN)] == [False, False]
