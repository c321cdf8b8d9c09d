"""What a regression makes of a gap: what depends on the simulated signals, and no noise."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.diagnosis.inference.ceiling import predicted_gap
from robomill.diagnosis.outcome.closure import figures, products
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import chance, of_variance, physics

NOISE = 0.1


def condition(seed: int, amplitude: float = 1.0, rows: int = 1200) -> tuple[FloatArray, FloatArray]:
    """Two signals, and a gap of a part of the first and the direction in which the second moves; and noise."""
    t = np.arange(rows) * 0.02
    position = amplitude * np.stack([np.sin(t), np.cos(0.7 * t)], axis=1)
    gap = np.stack([0.5 * position[:, 0], 0.8 * np.sign(np.gradient(position[:, 1]))], axis=1)
    return position, gap + NOISE * np.random.default_rng(seed).standard_normal(gap.shape)


@pytest.mark.parametrize("conditions", [0, 2])
def test_what_depends_on_the_signals_is_predicted_with_and_without_other_conditions(conditions: int) -> None:
    signals, gap = condition(1)
    left = gap - predicted_gap(signals, gap, [condition(2 + k, 0.6) for k in range(conditions)])
    # the direction is a step, of which the regression has a steep slope: three samples per reversal
    assert left[:, 0].std() == pytest.approx(NOISE, rel=chance(0.5 * of_variance(len(left))))
    assert left[:, 1].std() < 2.5 * NOISE


def test_of_noise_nothing_is_predicted() -> None:
    signals, _ = condition(1)
    noise = np.random.default_rng(5).standard_normal((1200, 2))
    assert predicted_gap(signals, noise, []).std() < 0.1


def test_what_signals_say_nothing_of_is_not_predicted() -> None:
    signals, gap = condition(1)
    strange = gap * 0.0 + np.sin(37.0 * np.arange(1200) ** 0.5)[:, None]
    predicted = predicted_gap(signals, strange, [])
    assert ((strange - predicted) ** 2).sum() > 0.9 * (strange**2).sum()


def test_signals_that_stand_still_are_no_predictors() -> None:
    signals, gap = condition(1)
    still = np.column_stack([signals, np.full(1200, 7.0)])
    assert np.array_equal(predicted_gap(still, gap, []), predicted_gap(signals, gap, []))


@pytest.mark.parametrize(("part", "ceiling"), [(0.3, 0.91), (0.0, 1.0)])
def test_the_ceiling_of_a_single_repeat_is_what_is_predicted_or_closed(part: float, ceiling: float) -> None:
    """A model that closes more than the regression shows that more can be closed."""
    signal = np.sin(np.arange(4000)[:, None] * 0.01)
    made = [signal + NOISE * np.random.default_rng(3).standard_normal(signal.shape)]
    zero, variance = np.zeros_like(signal), np.full(1, NOISE**2)
    half = products(made, (zero, zero), (0.5 * signal, 0.5 * signal), variance, predicted=(1.0 - part) * signal)
    found = figures([half])
    assert found.ceiling_by == "regression"
    assert found.ceiling == pytest.approx(ceiling, abs=physics(1.0, absolute=0.01))
    assert found.ratio == found.closure / found.ceiling
    more = figures([products(made, (zero, zero), (signal, signal), variance, predicted=0.7 * signal)])
    assert more.ceiling == more.closure > 0.99
