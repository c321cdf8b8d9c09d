"""Closure and ceiling on residuals that are known."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.diagnosis.outcome.closure import figures, products
from tests.tolerances import ROUNDOFF, physics

NOISE, ROWS = 0.1, 4000


def repeats(seed: int, unlike: float, count: int = 4):
    """One signal with noise, and with a slow part of rms `unlike` that is another one in each repeat."""
    random = np.random.default_rng(seed)
    t = np.arange(ROWS)[:, None] * 0.01
    signal = np.hstack([np.sin(t), np.cos(0.7 * t)])
    made = []
    for _ in range(count):
        own = unlike * np.sqrt(2.0) * np.sin(1.3 * t + random.uniform(0.0, 2.0 * np.pi, 2))
        made.append(signal + own + NOISE * random.standard_normal(signal.shape))
    return signal, made


@pytest.mark.parametrize("part", [0.0, 0.3])
def test_closure_of_a_model_that_explains_a_known_part(part: float) -> None:
    signal, made = repeats(1, 0.0)
    zero, model = np.zeros_like(signal), (1.0 - part) * signal
    found = figures([products(made, (zero, zero), (model, model), np.full(2, NOISE**2))])
    assert found.closure == pytest.approx(1.0 - part**2, abs=physics(1.0, absolute=0.01))
    assert found.ceiling == pytest.approx(1.0, abs=physics(1.0, absolute=0.01))


def test_what_does_not_come_again_lowers_the_ceiling() -> None:
    signal, made = repeats(2, 0.4, count=40)
    zero = np.zeros_like(signal)
    found = figures([products(made, (zero, zero), (0.3 * signal, 0.3 * signal), np.full(2, NOISE**2))])
    # per channel 0.5 comes again and 0.16 does not; the mean of the others has 1/39 of the latter
    assert found.ceiling == pytest.approx(1.0 - 0.16 * (1.0 + 1.0 / 39.0) / 0.5, abs=physics(1.0, absolute=0.03))


def test_what_is_closed_can_be_closed() -> None:
    """The ceiling of few repeats scatters: it is not below what a model has shown."""
    signal, made = repeats(2, 0.8, count=2)
    zero = np.zeros_like(signal)
    found = figures([products(made, (zero, zero), (signal, signal), np.full(2, NOISE**2))])
    assert found.ceiling == min(found.closure, 1.0)
    assert found.ratio >= 1.0


def test_noise_alone_is_not_measurable() -> None:
    _, made = repeats(3, 0.0)
    signal, _ = repeats(3, 0.0)
    found = figures([products(made, (signal, signal), (signal, signal), np.full(2, NOISE**2))])
    assert not found.measurable
    assert found.closure is None
    assert found.why_no_ceiling == "the gap before is not measurable: its interval includes 0"


def test_a_guess_of_the_noise_is_not_taken_off() -> None:
    """Too large a guess would close more than there is: what remains of a single run is given with its noise."""
    signal, made = repeats(3, 0.0, count=1)
    zero = np.zeros_like(signal)
    squares = np.sum((made[0] - signal) ** 2) / np.sum(made[0] ** 2)
    for factor in (1.0, 9.0):
        guess = np.full(2, factor * NOISE**2)
        parts = products(made, (zero, zero), (signal, signal), guess, predicted=made[0], guessed=True)
        found = figures([parts])
        assert found.closure == pytest.approx(1.0 - squares, rel=ROUNDOFF)
        assert found.after == pytest.approx(np.sqrt(np.sum((made[0] - signal) ** 2) / ROWS), rel=ROUNDOFF)
        assert found.interval[1] < 1.0
        assert figures([products(made, (zero, zero), (signal, signal), guess, predicted=made[0])]).closure > found.closure


@pytest.mark.parametrize(("left", "within"), [(0.0, True), (0.3, False)])
def test_what_remains_is_measurable_or_not(left: float, within: bool) -> None:
    signal, made = repeats(4, 0.0)
    zero, model = np.zeros_like(signal), (1.0 - left) * signal
    assert figures([products(made, (zero, zero), (model, model), np.full(2, NOISE**2))]).within_noise == within


def test_a_short_part_that_is_far_off_is_not_within_the_noise() -> None:
    """Most draws of the blocks do not have the one that it is in."""
    signal, _ = repeats(3, 0.0)
    measured, zero, model = signal + NOISE, np.zeros_like(signal), signal.copy()
    model[: ROWS // 24] += 5.0
    found = figures([products([measured], (zero, zero), (model, model), np.full(2, 1.1 * NOISE**2), predicted=zero, guessed=True)])
    assert found.after > 5.0 * found.floor
    assert not found.within_noise


def test_what_is_roundoff_of_the_measured_values_is_no_gap() -> None:
    """A program that was logged as it was played: half of the digits are trusted."""
    signal, _ = repeats(1, 0.0)
    for off, measurable in ((1e-9, False), (1e-7, True)):
        made = [signal * (1.0 + off)] * 3
        found = figures([products(made, (signal, signal), (signal, signal), np.zeros(2))])
        assert found.measurable is measurable
        assert (found.closure is None) is not measurable
