"""An effect of the catalogue that changes with time is in no catalogue, however little it leaves beside one that does not."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.gate.log_faults import DECISIVE
from robomill.diagnosis.inference.evidence import BEGINNING, gather
from robomill.diagnosis.inference.priors import ANOTHER, NOTHING
from robomill.diagnosis.inference.time_varying import COMING_LATE, GROWING, changing
from robomill.diagnosis.outcome.answer import Diagnosis
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import STEP, SYSTEM, catalogue, changed, measure, resolve
from tests.diagnosis.formula import Calculated, candidate

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
    assert known["gain"] > math.log(DECISIVE)
    blamed = {c for w in result["where"] for c in (w["component"], *w["alternatives"])}
    assert "sensors" in blamed  # of a gain that grows, the replay, which knows no change, blames the masses alone


def test_a_gain_that_grows_a_little_is_not_named_as_a_gain(tmp_path: Path) -> None:
    """By 0.6 %: the steady part explains so much of it that what is left looks like the law of a gain that is a little off."""

    def slowly(t: FloatArray, y: FloatArray) -> FloatArray:
        return y * (1.002 + 0.006 * t / SECONDS)

    assert answer(tmp_path, slowly).result["verdict"] == "unknown"


def test_what_is_the_same_all_the_time_is_named(tmp_path: Path) -> None:
    found = diagnose(SYSTEM, measure({"sensors": {"gain_error[1]": 0.004}}), catalogue(tmp_path), resolver=resolve)
    assert found.result["verdict"] == "identified"
    assert found.result["which"][0]["location"] == "sensor 1"


ROWS = 800
RAMP = np.arange(ROWS) / ROWS
FILTERED = 1e-6
"""Relative: a change of what is white is not quite a change that is whitened, which looks three samples back."""
AFTER = np.maximum(np.arange(ROWS) + 1 - BEGINNING, 0) / ROWS
"""A change that comes late does so from where a run begins to count."""
WAYS = (
    ("grows steadily during a run", RAMP),
    ("grows quickly at first, slowly later in a run", 1.0 - np.exp(-RAMP / GROWING)),
    *((f"comes late, by a time constant of 1/{round(1 / part)} of a run", -np.expm1(-AFTER / part)) for part in COMING_LATE[:3]),
)
"""What becomes of a steady change. Late by a quarter of a run it is the same as one that grows quickly at first."""


class TestWays:
    """A steady change of 1 per scale, as it would be with every way to change; and another effect that is not there."""

    ENTRIES = (candidate("p"), candidate("q"))

    def search(self, part: FloatArray) -> Any:
        """As after a screening, of runs with half of `p` times this; all that is asked of it."""
        other = np.sin(np.arange(ROWS) / 11.0)
        rng = np.random.default_rng(1)
        groups = [[(0.5 * part + 0.02 * rng.normal(size=ROWS))[:, None] for _ in range(4)]]
        changes = {a: [x[:, None]] for (a,), x in zip((c.addresses for c in self.ENTRIES), (np.ones(ROWS), other), strict=True)}
        laboratory = Calculated(lambda *_: None, ROWS)
        scales = dict.fromkeys(changes, 1.0)
        evidence = gather(laboratory, ["condition 0"], groups, [[np.zeros((ROWS, 1))]], changes, scales, scales, {})
        return SimpleNamespace(evidence=evidence, candidates=self.ENTRIES, starts={})

    @pytest.mark.parametrize(("how", "part"), WAYS)
    def test_each_way_is_told_by_its_own_shape_with_the_evidence_that_it_has(self, how: str, part: FloatArray) -> None:
        search = self.search(part)
        found = changing(search)
        assert found is not None
        assert (found.candidate, found.how) == (self.ENTRIES[0], how)
        # directly: the mean change white, with the covariance of noise and nuisances
        evidence = search.evidence
        space = evidence.space
        nuisances = space.nuisances.toarray()
        inverse = np.linalg.inv(np.eye(ROWS) + nuisances @ nuisances.T)
        steady = evidence.signature([np.ones((ROWS, 1))])
        column = steady * part
        explained = {
            name: (c @ inverse @ space.y) ** 2 / (c @ inverse @ c)
            for name, c in (
                ("steady", steady),
                ("other", evidence.signature([np.sin(np.arange(ROWS) / 11.0)[:, None]])),
                ("changing", column),
            )
        }
        assert found.by_change == pytest.approx(0.5 * (explained["changing"] - max(explained["steady"], explained["other"])), rel=FILTERED)
        # the size is believed to be as large as it is found; the ways share the probability of the effect
        odds = (
            0.5 * explained["changing"]
            - 0.5 * math.log(explained["changing"])
            + math.log((1.0 - NOTHING) * (1.0 - ANOTHER) ** 2 / 2)
            - math.log(len(COMING_LATE) + 2)
        )
        assert found.log_odds == pytest.approx(odds, rel=FILTERED)

    def test_where_nothing_has_one_number_nothing_can_be_said(self) -> None:
        search = self.search(RAMP)
        search.candidates = ()
        assert changing(search) is None
