"""Whether an effect is believed to be there."""

from __future__ import annotations

import pytest

from diagnosis.transfer import Transfer
from diagnosis.verdict import believed


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


def test_what_little_evidence_there_is_must_not_break_its_promise_either() -> None:
    """A machine without effects (case 0214 of seed 2037): half of a promise is as far from it as from none."""
    assert believed(0.04, Transfer(1.0, 1.0, 20.0, 31.0))
    assert not believed(0.04, Transfer(1.0, 1.0, 2.0, 31.0))
