"""An effect of the catalogue that changes with time is in no catalogue, however little it leaves beside one that does not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.outcome.answer import Diagnosis
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import STEP, SYSTEM, catalogue, changed, measure, resolve

SECONDS = 8.0


def growing(t: FloatArray, y: FloatArray) -> FloatArray:
    """A sensor whose gain is 0.1 % too large and grows by 0.8 %."""
    return y * (1.001 + 0.008 * t / SECONDS)


def late(t: FloatArray, y: FloatArray) -> FloatArray:
    """A sensor that shows 2 % more, but only after a second."""
    step = -np.expm1(-STEP / 1.0)
    return np.asarray(y + 0.02 * lfilter([step], [1.0, step - 1.0], y))


def answer(folder: Path, wrong: Callable[[FloatArray, FloatArray], FloatArray]) -> Diagnosis:
    return diagnose(SYSTEM, changed(measure(seconds=SECONDS), "sensors.y[1]", wrong), catalogue(folder), resolver=resolve)


@pytest.mark.parametrize(
    ("wrong", "how"), [(growing, "grows steadily during a run"), (late, "comes late, by a time constant of 1/8 of a run")]
)
def test_what_changes_with_time_is_unknown_and_says_what_it_is_like(
    tmp_path: Path, wrong: Callable[[FloatArray, FloatArray], FloatArray], how: str
) -> None:
    result = answer(tmp_path, wrong).result
    assert result["verdict"] == "unknown"
    known = result["unknown"]["changes"]
    assert (known["like"], known["how"]) == ("gain @ sensor 1", how)
    assert known["gain"] > 20.0
    blamed = {c for w in result["where"] for c in (w["component"], *w["alternatives"])}
    assert "sensors" in blamed  # of a gain that grows, the replay, which knows no change, blames the masses alone


def test_without_that_a_gain_that_grows_would_be_named_as_a_gain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robomill.diagnosis.outcome.verdict.CHANGES", np.inf)
    result = answer(tmp_path, growing).result
    assert result["verdict"] == "identified"
    assert result["which"][0]["effect"] == "gain"


def test_what_is_the_same_all_the_time_is_named(tmp_path: Path) -> None:
    found = diagnose(SYSTEM, measure({"sensors": {"gain_error[1]": 0.004}}), catalogue(tmp_path), resolver=resolve)
    assert found.result["verdict"] == "identified"
    assert found.result["which"][0]["location"] == "sensor 1"
