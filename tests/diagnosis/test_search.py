"""The search: where fits start, which models are looked at again, which are worth their effects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from diagnosis.catalogue import Address, Candidate
from diagnosis.engine import diagnose
from diagnosis.estimation import Fit
from diagnosis.measured import sort_by_condition
from diagnosis.search import FAULT, SUBSTANTIAL, Search
from diagnosis.simulation import Laboratory, Simulator
from orchestration.results import Run
from orchestration.slave import FloatArray
from tests.diagnosis.demo import SYSTEM, catalogue, measure, resolve

GAIN, RUBBING, CLOCK = ("sensors", "gain_error[1]"), ("masses", "friction[1]"), ("logging", "lag sensors.*")


@contextmanager
def search(folder: Path, runs: Sequence[Run]) -> Iterator[Search]:
    conditions = sort_by_condition(runs, SYSTEM)
    channels = ["sensors.y[1]", "sensors.y[2]"]
    with Simulator(Laboratory(SYSTEM, conditions, channels, resolve), 1) as simulator:
        yield Search(catalogue(folder), simulator, [[c.matrix(r, channels) for r in c.runs] for c in conditions], [])


def model(of: Search, *addresses: Address) -> tuple[Candidate, ...]:
    return tuple(next(c for c in of.candidates if c.addresses == (a,)) for a in addresses)


def fit(of: Search, values: Mapping[Address, float], columns: FloatArray | None = None, left: float = 0.0) -> Fit:
    """At these values; what is left is noise and so many times what noise leaves."""
    energy = (1.0 + left) * float(of.evidence.expected.sum())
    return Fit(model(of, *values), dict(values), {a: 0.1 * abs(v) + 1e-6 for a, v in values.items()}, 0.0, energy, columns=columns)


def test_an_effect_far_below_its_usual_size_is_simulated_at_sizes_in_between(tmp_path: Path) -> None:
    """Dry friction of the usual size holds a mass; a tenth of it slows it down, which is not a tenth of holding."""
    truth = {"masses": {"friction[1]": 0.005}}
    with search(tmp_path, measure(truth)) as tiny:
        assert 0.05 < tiny.starts[RUBBING].x < 0.2  # prior scales, of 0.05 N
    with search(tmp_path, measure({"masses": {"friction[1]": 0.05}})) as usual:
        assert RUBBING not in usual.starts
    result = diagnose(SYSTEM, measure(truth), catalogue(tmp_path), resolver=resolve).result
    assert (result["verdict"], result["which"][0]["location"]) == ("identified", "mass 1")
    assert result["which"][0]["parameters"]["friction[1]"]["value"] == pytest.approx(0.005, rel=0.05)


def test_what_is_left_of_a_model_when_an_effect_has_become_too_small_is_fitted_by_itself(tmp_path: Path) -> None:
    with search(tmp_path, measure({"sensors": {"gain_error[1]": 0.04}})) as s:
        columns = np.stack([s.evidence.columns[RUBBING], s.evidence.columns[GAIN]], axis=1)
        pair = fit(s, {RUBBING: 2e-4, GAIN: 0.03}, columns)
        assert not pair.large_enough()
        (found,) = s._smaller([pair], [])
        assert [c.addresses for c in found.model] == [(GAIN,)]
        assert found.values[GAIN] == pytest.approx(0.04, rel=0.02)
        assert s._smaller([pair], [found]) == []  # nothing that is known already, as good or better
        both = fit(s, {RUBBING: 2e-2, GAIN: 0.03}, columns)
        assert s._smaller([both], []) == []


def test_a_fault_of_the_log_must_explain_most_of_what_is_left_and_an_effect_a_part(tmp_path: Path) -> None:
    with search(tmp_path, measure({"sensors": {"gain_error[1]": 0.04}})) as s:
        alone = fit(s, {GAIN: 0.04}, left=1.0)
        for partner, share in ((CLOCK, FAULT), (RUBBING, SUBSTANTIAL)):
            values = {GAIN: 0.04, partner: 0.02}
            assert s._worth(fit(s, values, left=1.0 - share - 0.01), [alone])
            assert not s._worth(fit(s, values, left=1.0 - share + 0.01), [alone])
        # of two clocks beside each other, each counts
        assert s._worth(fit(s, {GAIN: 0.04, CLOCK: 0.02}, left=0.9), [fit(s, {CLOCK: 0.02}, left=1.0)])
