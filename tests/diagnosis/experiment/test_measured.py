"""Measured runs on the time grid of the simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robomill.diagnosis.experiment.measured import DataError, sort_by_condition
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.gate.repeats import compared
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import STEP, SYSTEM, measure
from tests.tolerances import ROUNDOFF

CHANNEL = "sensors.y[1]"


def stamped(run: Run, t: FloatArray) -> Run:
    """The run with an alternating signal, which interpolation would take a part of, and these stamps."""
    return replace(run, t=t, columns={**run.columns, CHANNEL: np.where(np.arange(len(t)) % 2, 1.0, -1.0)})


def on_grid(run: Run) -> FloatArray:
    (condition,) = sort_by_condition([run], SYSTEM)
    return condition.matrix(run, [CHANNEL])[:, 0]


def test_samples_at_communication_points_stay_what_they_are_though_their_stamps_jitter() -> None:
    (run,) = measure(repeats=1)
    rng = np.random.default_rng(1)
    jitter = np.clip(0.015 * STEP * rng.normal(size=len(run.t)), -0.1 * STEP, 0.1 * STEP)
    drift = 1.0 + 5e-6
    signal = on_grid(stamped(run, run.t * drift + jitter))
    assert np.all(np.abs(signal) == 1.0)
    assert np.all(np.diff(signal[:50]) != 0.0)


def test_a_first_stamp_that_is_late_does_not_move_the_others() -> None:
    (run,) = measure(repeats=1)
    jitter = np.clip(5e-5 * np.random.default_rng(2).normal(size=len(run.t)), -1.5e-4, 1.5e-4)
    jitter[0] = 0.6 * STEP
    signal = on_grid(stamped(run, run.t + jitter))
    assert np.all(np.abs(signal) == 1.0)
    assert np.all(np.diff(signal[:50]) != 0.0)


@pytest.mark.parametrize("late", [0.3, 0.5])
def test_samples_between_communication_points_are_interpolated(late: float) -> None:
    (run,) = measure(repeats=1)
    signal = on_grid(stamped(run, run.t + late * STEP))
    assert np.abs(signal[2:-2]) == pytest.approx(1.0 - 2.0 * late, abs=1e3 * ROUNDOFF)  # of times of some seconds over a step


def test_a_stamp_that_is_missing_is_no_jitter() -> None:
    (run,) = measure(repeats=1)
    kept = np.delete(np.arange(len(run.t)), 100)
    short = replace(run, t=run.t[kept], columns={c: v[kept] for c, v in run.columns.items()})
    (condition,) = sort_by_condition([short], SYSTEM)
    there = condition.matrix(short, [CHANNEL])[:, 0]
    assert there[100] == pytest.approx(0.5 * (run.columns[CHANNEL][99] + run.columns[CHANNEL][101]), rel=ROUNDOFF)
    assert np.delete(there, 100) == pytest.approx(np.delete(run.columns[CHANNEL], 100)[: len(there) - 1], rel=ROUNDOFF)


def test_runs_of_twenty_steps_are_long_enough() -> None:
    """LEAST_STEPS"""
    (condition,) = sort_by_condition(measure(repeats=2, seconds=20 * STEP), SYSTEM)
    assert len(condition.grid) == 21
    with pytest.raises(DataError, match="19 steps"):
        sort_by_condition(measure(repeats=2, seconds=19 * STEP), SYSTEM)


def beside(group: list[FloatArray]) -> list[Finding]:
    """What is said of four repeats beside a simulation without noise."""
    return compared(group, [group[0]], [CHANNEL], ["a", "b", "c", "d"], SYSTEM.step)


def test_repeats_that_are_equal_do_not_make_one_an_outlier_that_differs_by_rounding() -> None:
    runs = measure(repeats=4)
    exact = [replace(r, columns={CHANNEL: r.t + (1e-9 if k == 2 else 0.0)}) for k, r in enumerate(runs)]
    (condition,) = sort_by_condition(exact, SYSTEM)
    assert beside([condition.matrix(r, [CHANNEL]) for r in exact]) == []
    off = [replace(r, columns={CHANNEL: r.t + (0.02 if k == 2 else 0.0)}) for k, r in enumerate(runs)]  # or two samples late
    (condition,) = sort_by_condition(off, SYSTEM)
    (finding,) = [f for f in beside([condition.matrix(r, [CHANNEL]) for r in off]) if f.fatal]
    assert finding.kind == "repeat"


def test_a_jump_that_one_repeat_has_a_part_of_a_sample_later_is_jitter() -> None:
    runs = measure(repeats=4)
    jumped = (runs[0].t > 4.0).astype(float)
    late = jumped.copy()
    late[int(np.argmax(jumped))] = 0.97
    assert beside([x[:, None] for x in (jumped, jumped, late, jumped)]) == []
    much = np.roll(jumped, 2)
    (finding,) = [f for f in beside([x[:, None] for x in (jumped, jumped, much, jumped)]) if f.fatal]
    assert (finding.kind, finding.channel) == ("repeat", CHANNEL)


def labelled(run: Run, **labels: object) -> Run:
    return replace(run, info={**run.info, "labels": {**run.info.get("labels", {}), **labels}})


class TestSamplesThatAreMeasurementsOfTheirOwn:
    def test_the_label_of_all_runs_says_so(self) -> None:
        runs = measure(repeats=2)
        (series,) = sort_by_condition(runs, SYSTEM)
        (apart,) = sort_by_condition([labelled(r, samples="independent") for r in runs], SYSTEM)
        assert (series.independent, apart.independent) == (False, True)

    def test_runs_of_a_condition_that_do_not_agree_are_refused(self) -> None:
        one, other = measure(repeats=2)
        with pytest.raises(DataError) as error:
            sort_by_condition([one, labelled(other, samples="independent")], SYSTEM)
        name = sort_by_condition([one], SYSTEM)[0].name
        assert str(error.value) == (
            f'condition {name!r}: {other.folder} has the label samples = "independent", and {one.folder} has no label samples; '
            "give it to all runs of the condition or to none, or name two conditions"
        )

    def test_another_value_is_refused(self) -> None:
        (run,) = measure(repeats=1)
        with pytest.raises(DataError) as error:
            sort_by_condition([labelled(run, samples="series")], SYSTEM)
        assert str(error.value) == (
            f"{run.folder}: label samples is 'series'; expected \"independent\", where each sample is a measurement of its own; "
            "leave the label out for a time series"
        )
