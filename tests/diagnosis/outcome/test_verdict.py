"""Whether an effect is believed to be there."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.time_varying import Changing
from robomill.diagnosis.inference.transfer import Transfer
from robomill.diagnosis.outcome.verdict import believed, changes
from tests.diagnosis.demo import catalogue


@pytest.mark.parametrize(
    ("nothing", "gain", "there"),
    [
        (0.2, None, False),  # four to one
        (0.04, None, True),  # twenty to one, and no new condition
        (0.0, None, True),
        (0.2, 4.0, True),  # new conditions add what is missing
        (0.2, 1.0, False),
        (0.02, -3.0, False),  # or take it away
        (1e-5, -50.0, True),  # where there is much evidence they cannot say that there is nothing: only that it is something else
    ],
)
def test_by_the_odds_and_by_new_conditions_where_these_are_low(nothing: float, gain: float | None, there: bool) -> None:
    moved = None if gain is None else Transfer(1.0, 1.0, gain, 5.0)
    assert believed(nothing, moved) is there


def test_what_little_evidence_there_is_must_not_fall_short_of_its_expected_gain_either() -> None:
    """A machine without effects (case 0214 of seed 2037): half of an expected gain is as far from it as from none."""
    assert believed(0.04, Transfer(1.0, 1.0, 20.0, 31.0))
    assert not believed(0.04, Transfer(1.0, 1.0, 2.0, 31.0))


@pytest.mark.parametrize(
    ("nothing", "gain", "expected_gain", "there"),
    [
        (0.04, 3.0, 12.0, False),  # machines without effects (cases 0037, 0055 and 0235 of seed 2035) have up to 0.23 of an expected gain
        (0.04, 6.0, 12.0, True),
        (0.04, 2.0, 7.0, True),  # an expected gain that is as small is had or not by chance
        (1e-5, 3.0, 12.0, True),  # an answer that does not need it
    ],
)
def test_a_faint_answer_must_have_a_part_of_its_expected_gain(nothing: float, gain: float, expected_gain: float, there: bool) -> None:
    assert believed(nothing, Transfer(1.0, 1.0, gain, expected_gain)) is there


@pytest.mark.parametrize(
    ("by_change", "odds", "left", "there"),
    [
        (20.0, -2.0, 1.1, True),  # creep that looks like hysteresis
        (9.0, 5.0, 1.1, False),  # too little to be believed
        (20.0, -4.0, 1.1, False),  # the best model is likelier
        (62.0, 40.0, 20.0, False),  # a runout leaves much at this step, and a part of it goes with time (case 0168 of seed 2039)
        (600.0, 40.0, 20.0, True),
    ],
)
def test_what_changes_with_time_must_be_likely_and_a_good_part_of_what_is_left(
    tmp_path: Path, by_change: float, odds: float, left: float, there: bool
) -> None:
    search = cast(Any, SimpleNamespace(candidates=catalogue(tmp_path).candidates, evidence=SimpleNamespace(expected=np.full(1000, 1.0))))
    best = Fit((), {}, {}, 0.0, 1000.0 * left)
    prior = math.log(0.3)  # of no effect
    other = Changing(search.candidates[0], "grows", odds + prior, by_change)
    assert changes(search, best, other) is there
