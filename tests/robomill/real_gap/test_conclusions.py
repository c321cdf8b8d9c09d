"""The sentences about the recordings: other figures, other sentences."""

from __future__ import annotations

import inspect
import re
from types import SimpleNamespace
from typing import Any

import pytest

from robomill.real_gap import conclusions, page
from robomill.real_gap.study import Ripple


def hypotheses(**evidence: float) -> dict[str, Any]:
    return {name.replace("_", " + "): SimpleNamespace(log_evidence=value) for name, value in evidence.items()}


@pytest.mark.parametrize(
    ("gain", "said"),
    [
        (9.0, "backlash is favoured (ln evidence +9)"),
        (-1.5, "for or against backlash these data say little (-1.5)"),
        (-9.0, "backlash is disfavoured (-9)"),
    ],
)
def test_what_is_said_of_backlash_follows_the_evidence(gain: float, said: str) -> None:
    found = hypotheses(offset=0.0, offset_lag=100.0, offset_lag_backlash=100.0 + gain)
    text = conclusions.link(found)
    assert said in text
    assert "a clock is favoured (ln evidence" in text
    assert "offset" not in text  # every hypothesis has it


def test_the_verdict_follows_closure_and_transfer() -> None:
    good, bad = SimpleNamespace(transfer=0.1), SimpleNamespace(transfer=-0.1)
    assert conclusions.verdict((0.7, 0.9), [good, good]) == "identified"  # type: ignore[list-item]  # stands for a Use
    assert conclusions.verdict((0.7, 0.9), [good, bad]) == "ambiguous"  # type: ignore[list-item]  # the same
    assert conclusions.verdict((-0.1, 0.9), [good]) == "unknown"  # type: ignore[list-item]  # the same


def test_a_stated_payload_may_be_outside() -> None:
    found = {"A": (154.0, 148.0, 160.0), "B": (165.0, 156.0, 173.0)}
    assert conclusions.payload(150.0, found) == "within the interval of A, outside the interval of B"


def test_ripple_counts_the_axes_on_which_it_helps() -> None:
    waves = [Ripple((1.0, 1.0), (0.0, 0.0), 0.6, -0.3, 0.4), Ripple((1.0, 1.0), (0.0, 0.0), 0.6, 0.1, 0.5)]
    assert conclusions.ripple(waves).endswith("(more than nothing on 2 of 2 axes); with the phase of A -30 % to 10 % (on 1 of 2)")


def test_the_orders_of_both_recordings_are_compared() -> None:
    assert (
        conclusions.orders([[(3.94, 0.0), (3.08, 0.0)], [(3.94, 0.0), (2.58, 0.0)]])
        == "The orders of the two recordings differ by 0.50 at most"
    )


def test_the_page_has_no_conclusion_of_its_own() -> None:
    """A sentence that says what something is, or is not, must have come from figures."""
    assert not re.findall(r"\bIt is (?:not )?(?:a |an |elastic )?\w+", inspect.getsource(page.page))
