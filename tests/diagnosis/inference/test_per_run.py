"""An amplitude whose phase is another one in every run."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robomill.diagnosis.inference.per_run import turning
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import ROUNDOFF, chance, physics

N, RUNS = 600, 8
T = 0.01 * np.arange(N)
COLUMNS = np.stack([np.sin(11.0 * T), np.cos(11.0 * T)], axis=1)
PHASES = 2.0 * math.pi * np.arange(RUNS) / RUNS
DEVIATION = math.sqrt(2.0 / (N * RUNS))
"""Standard deviation of the amplitude of a sine in so many samples of white noise of variance 1."""


def runs(amplitude: float, seed: int = 1) -> list[FloatArray]:
    rng = np.random.default_rng(seed)
    return [amplitude * COLUMNS @ [math.cos(p), math.sin(p)] + rng.normal(size=N) for p in PHASES]


def test_the_mean_of_the_runs_has_nothing_and_the_runs_have_it_all() -> None:
    measured = runs(1.0)
    mean = turning([np.sqrt(RUNS) * np.mean(measured, axis=0)], [COLUMNS * np.sqrt(RUNS)])
    assert mean.amplitude < chance(2.0 * DEVIATION)
    found = turning(measured, [COLUMNS] * RUNS)
    assert found.amplitude == pytest.approx(1.0, abs=chance(DEVIATION))
    assert found.deviation == pytest.approx(DEVIATION, abs=physics(DEVIATION, 0.1))
    away = np.angle(np.exp(1j * (found.phases - PHASES)))
    assert np.abs(away).max() < chance(DEVIATION * math.sqrt(RUNS))
    assert found.gain > 1000.0


def test_noise_is_no_amplitude() -> None:
    gains = [turning(runs(0.0, seed), [COLUMNS] * RUNS).gain for seed in range(20)]
    assert max(gains) < 5.0  # a root mean square of the parts would be 0.07 in each of them, whatever the number of runs
    assert min(gains) >= -1e3 * ROUNDOFF


def test_runs_of_several_conditions_have_columns_of_their_own() -> None:
    weaker = 0.2 * COLUMNS[:, ::-1] @ np.diag([1.0, -1.0])
    rng = np.random.default_rng(3)
    there = [3.0 * weaker @ [math.cos(p), math.sin(p)] + rng.normal(size=N) for p in PHASES]
    found = turning([*runs(3.0), *there], [COLUMNS] * RUNS + [weaker] * RUNS)
    assert found.amplitude == pytest.approx(3.0, abs=chance(DEVIATION))


def test_parts_that_do_the_same_are_refused() -> None:
    same = np.stack([COLUMNS[:, 0]] * 2, axis=1)
    with pytest.raises(ValueError, match="in phase and a quarter of a turn ahead do the same; expected two directions"):
        turning(runs(1.0), [same] * RUNS)
