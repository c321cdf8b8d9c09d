"""What a series of pulses at an input does, by the responses to a few of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from robomill.diagnosis.experiment.simulation import decimate
from robomill.diagnosis.forms.responses import Response
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import ROUNDOFF

SAMPLES, FACTOR = 600, 5
T = np.arange(SAMPLES)


def steps(seed: int) -> FloatArray:
    """A series that is the same within each block."""
    return np.repeat(np.random.default_rng(seed).normal(size=SAMPLES // FACTOR), FACTOR)


def slow(x: FloatArray) -> FloatArray:
    """Two channels: a memory of half the run, and a tenth of the input."""
    return np.stack([lfilter([0.1], [1.0, -(1.0 - 1.0 / 300.0)], x), 0.1 * x], axis=1)


def told(does: Callable[[FloatArray], FloatArray], x: FloatArray, width: int = 1) -> FloatArray:
    return Response.of(does, SAMPLES, FACTOR, width, 1e-3).to(decimate(x[:, None], FACTOR))[:, :, 0]


def test_a_filter_answers_to_any_series_as_it_is_simulated() -> None:
    x = steps(1)
    assert told(slow, x) == pytest.approx(decimate(slow(x), FACTOR), abs=ROUNDOFF)


def test_a_gain_that_grows_along_the_run_is_drawn_between_pulses() -> None:
    """It grows in a line, from 1 to 2 at the last pulse, and stays there."""
    last = SAMPLES * 5 // 6
    gain = 1.0 + np.minimum(T // FACTOR * FACTOR / last, 1.0)
    x = steps(2)
    assert told(lambda u: (gain * u)[:, None], x) == pytest.approx(decimate((gain * x)[:, None], FACTOR), abs=ROUNDOFF)


def test_a_component_that_samples_every_second_block_sees_pulses_that_last_two() -> None:
    """Pulses of one block it may miss, or take for two."""

    def sampled(u: FloatArray) -> FloatArray:
        return np.repeat(u[:: 2 * FACTOR], 2 * FACTOR)[:, None]

    x = np.sin(2.0 * np.pi * T / 200.0)
    exact = decimate(sampled(x), FACTOR)
    assert np.std(told(sampled, x, 2) - exact) < 0.2 * np.std(exact) < np.std(told(sampled, x) - exact)


def test_several_series_are_answered_as_each_alone() -> None:
    both = np.stack([steps(3), steps(4)], axis=1)
    found = Response.of(slow, SAMPLES, FACTOR, 1, 1e-3).to(decimate(both, FACTOR))
    for k in range(2):
        assert found[:, :, k] == pytest.approx(told(slow, both[:, k]), abs=ROUNDOFF)
