"""What is missing from a log is no gap between machine and simulation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.bridging import bridged, missing
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray, PortData
from tests.diagnosis.axis import catalogue, measure, resolve, system
from tests.diagnosis.formula import STEP, Calculated
from tests.tolerances import ROUNDOFF

ROWS = 200


def logged(kept: FloatArray | np.ndarray, x: FloatArray) -> Run:
    """A run of one channel at those of the times that are kept."""
    t = STEP * np.arange(ROWS)
    return Run(Path("run"), t[kept], {"a.x": x[kept]}, {"a.x": PortData("x", "output", unit="m")}, {})


def cut(run: Run, first: int, last: int) -> Run:
    """A run without the samples from `first` to before `last`."""
    kept = np.delete(np.arange(len(run.t)), np.arange(first, last))
    return replace(run, t=run.t[kept], columns={c: x[kept] for c, x in run.columns.items()})


def test_what_no_sample_is_near_is_missing_and_what_is_sampled_seldom_is_not() -> None:
    grid, x = STEP * np.arange(ROWS), np.zeros(ROWS)
    whole = np.arange(ROWS)
    condition = Condition("c", {}, (), grid)
    gone = missing(condition, logged(np.delete(whole, np.arange(50, 60)), x), ["a.x"])
    assert list(np.flatnonzero(gone[:, 0])) == list(range(50, 60))
    assert not missing(condition, logged(whole, x), ["a.x"]).any()
    assert not missing(condition, logged(whole[::4], x), ["a.x"]).any()
    holes = np.where(whole == 7, np.nan, x)
    assert list(np.flatnonzero(missing(condition, logged(whole, holes), ["a.x"]))) == [7]


@pytest.mark.parametrize("decimation", [1, 2])
def test_the_deviation_is_drawn_across_and_not_the_signal(decimation: int) -> None:
    fine = STEP * np.arange(ROWS)
    peak = np.exp(-(((fine - 1.0) / 0.1) ** 2))
    means = peak.reshape(-1, decimation).mean(axis=1)[:, None]
    laboratory = Calculated(lambda *_: means, len(means), decimation=decimation)
    run = logged(np.delete(np.arange(ROWS), np.arange(90, 110)), peak + 0.5 + 0.1 * fine)
    laboratory.conditions = [replace(c, runs=(run,)) for c in laboratory.conditions]
    with Simulator(laboratory) as simulator:
        ((found,),) = bridged(simulator, laboratory.measured())
    expected = (peak + 0.5 + 0.1 * fine).reshape(-1, decimation).mean(axis=1)
    np.testing.assert_allclose(found[:, 0], expected, rtol=0.0, atol=1e3 * ROUNDOFF)


def test_a_good_machine_is_good_where_samples_are_missing(tmp_path: Path) -> None:
    """A fifth of a second where the axis turns round, in each of three repeats at another time."""
    runs = [cut(r, 150 + 60 * k, 190 + 60 * k) for k, r in enumerate(measure(repeats=3))]
    found = diagnose(system(), runs, catalogue(tmp_path), resolver=resolve).result
    assert found["verdict"] == "none"
    assert {f["kind"] for f in found["gate"]["findings"]} == {"time"}
