"""Why an answer is `unknown`."""

from __future__ import annotations

import math
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import get_args

import pytest
from scipy.special import expit

from robomill.diagnosis.inference.adequacy import UNKNOWN
from robomill.diagnosis.inference.transfer import Transfer
from robomill.diagnosis.outcome import reasons, verdict
from robomill.diagnosis.outcome.reasons import WHY, Reason
from robomill.diagnosis.outcome.verdict import UNLISTED, Odds
from tests.diagnosis.demo import catalogue
from tests.diagnosis.outcome.test_verdict import STEADY, fit, search
from tests.tolerances import ROUNDOFF

FAIR = Odds(2.0, 0.0, 0.0, 0.3, 0.1, 0.0)
GAP = 2.0 * UNKNOWN
REFUTED = verdict.Tests(0.02, 0.001, 0.1, 0.001, FAIR)


@pytest.mark.parametrize(("after", "elsewhere"), [(1.3, 1.3), (30.0, 1.3), (1.3, 30.0), (5.0, 40.0)])
@pytest.mark.parametrize("guess", [1.0, 5.0])
def test_what_p_fit_is_made_of_adds_up_to_it(tmp_path: Path, after: float, elsewhere: float, guess: float) -> None:
    effect = catalogue(tmp_path).candidates[:1]
    moved = Transfer(70.0, elsewhere, 100.0, 100.0, 0.02, 0.7, 0.02)
    found = verdict.tested(search(guess=guess), fit(90.0), fit(after, effect), 0.001, 0.001, moved, 0.02, STEADY)
    assert found.odds is not None
    made = math.log((1.0 - UNLISTED) / UNLISTED) + sum(astuple(found.odds))
    assert found.p_fit == pytest.approx(expit(made), rel=1e4 * ROUNDOFF)
    assert found.odds.elsewhere <= 0.0
    assert (found.odds.elsewhere < -1.0) is (elsewhere > after)  # else it loses nothing that the diagnosed runs have not lost already
    assert (found.odds.left < 0.0) is (after > 10.0)


def test_every_reason_has_words_and_every_part_of_p_fit_is_one() -> None:
    assert set(get_args(Reason)) == set(WHY)
    assert tuple(f.name for f in fields(Odds)) == reasons._ODDS


@pytest.mark.parametrize("part", [f.name for f in fields(Odds)])
def test_what_speaks_most_against_the_best_model_comes_first(part: str) -> None:
    tests = replace(REFUTED, odds=replace(FAIR, **{part: -9.0, "calibrated": -9.5 if part == "calibrated" else -1.0}))
    assert reasons.reasons(tests, True, GAP, {}) == ((part, "calibrated") if part != "calibrated" else (part,))


def test_what_is_seen_apart_from_p_fit_comes_before_it() -> None:
    seen: dict[Reason, bool] = {"bound": True, "changes": False, "instead": True}
    assert reasons.reasons(replace(REFUTED, odds=replace(FAIR, left=-3.0)), True, GAP, seen) == ("bound", "instead", "left")
    assert reasons.reasons(replace(REFUTED, p_fit=0.9), True, GAP, seen) == ("bound", "instead")


@pytest.mark.parametrize(("level", "why"), [(GAP, "left"), (0.9 * UNKNOWN, "nominal")])
def test_where_no_effect_is_believed_there_is_a_gap_or_calibrated_numbers_are_far_off(level: float, why: str) -> None:
    tests = replace(REFUTED, odds=replace(FAIR, alike=-9.0))
    assert reasons.reasons(replace(tests, nothing=0.5), True, level, {}) == (why,)
    assert reasons.reasons(tests, False, level, {}) == (why,)
    assert reasons.reasons(tests, False, level, {"swing": True}) == ("swing",)
    assert reasons.reasons(replace(REFUTED, p_fit=0.45), True, level, {}) == ("left",)  # by the odds before the data alone
