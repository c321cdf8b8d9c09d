"""Filters: closed forms, scipy as the independent design, the delay budget of FACTS section 7."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numba import njit
from scipy import signal

from robomill.models.maths.filters import (
    aliased_frequency,
    average,
    average_rest,
    biquad,
    biquad_rest,
    butterworth,
    delay,
    delay_rest,
    moving_average_window,
)
from robomill.models.model.kernels import COMPILER_OPTIONS
from tests.tolerances import EXACT, ROUNDOFF, physics

SAMPLE = 0.004
CUTOFF = 10.0
WINDOW = 15
CAPACITY = 40


def coefficients(cutoff: float = CUTOFF, sample: float = SAMPLE) -> tuple[np.ndarray, np.ndarray]:
    b, a = np.zeros(3), np.zeros(2)
    butterworth(cutoff, sample, b, a)
    return b, a


def low_pass(u: np.ndarray, cutoff: float = CUTOFF) -> np.ndarray:
    b, a = coefficients(cutoff)
    z = np.zeros((1, 2))
    return np.array([biquad(b, a, z, 0, float(x)) for x in u])


def moving_average(u: np.ndarray, window: int = WINDOW) -> np.ndarray:
    ring = np.zeros((1, CAPACITY))
    return np.array([average(ring, window, k % window, 0, float(x)) for k, x in enumerate(u)])


def delayed(u: np.ndarray, samples: float, capacity: int = CAPACITY) -> np.ndarray:
    ring = np.zeros((1, capacity))
    return np.array([delay(ring, capacity, k % capacity, samples, 0, float(x)) for k, x in enumerate(u)])


def chain(u: np.ndarray) -> np.ndarray:
    return moving_average(low_pass(u))


# ------------------------------------------------------------------------------------------- physics


def test_step_response_reaches_half_after_50_ms_and_nine_tenths_after_77_ms() -> None:
    """FACTS section 7: filter alone t50 = 50 ms, t90 = 77 ms (check_facts.py, section filt, with scipy)."""
    y = chain(np.ones(200))
    t = np.arange(200) * SAMPLE
    for level, published in ((0.5, 0.050), (0.9, 0.077)):
        reached = np.interp(level, y[:60], t[:60])
        assert abs(reached - published) <= physics(published, absolute=0.0005)  # printed to 1 ms


@pytest.mark.parametrize(("frequency", "decibel"), [(5.0, -1.6), (10.0, -8.9)])
def test_attenuation_of_the_chain(frequency: float, decibel: float) -> None:
    """FACTS section 7: -1.6 dB at 5 Hz, -8.9 dB at 10 Hz. Amplitude from a synchronous detector over whole periods."""
    n = np.arange(1500)
    y = chain(np.sin(2 * np.pi * frequency * n * SAMPLE))[500:]  # 1000 samples = 4 s: whole periods, start-up gone
    amplitude = 2 * abs(np.mean(y * np.exp(-2j * np.pi * frequency * n[500:] * SAMPLE)))
    assert abs(20 * math.log10(amplitude) - decibel) <= physics(decibel, absolute=0.05)  # printed to 0.1 dB


def test_the_aliased_spindle_line_of_13000_rpm_vanishes() -> None:
    """Window 15 at 250 Hz has a zero at 33.33 Hz; the low-pass alone leaves 6 %, the chain less than -100 dB (FACTS 7)."""
    n = np.arange(600)
    spindle = np.sin(2 * np.pi * 13000 / 60 * n * SAMPLE)
    assert np.abs(low_pass(spindle)[300:]).max() > 0.05
    assert np.abs(chain(spindle)[300:]).max() < 1e-5


def test_group_delay_of_the_chain_is_22_plus_28_ms() -> None:
    """A ramp leaves a filter of DC gain 1 late by its group delay at frequency zero.

    Butterworth: sqrt(2)/w_a with the pre-warped w_a = 2/T tan(pi f_c T); 22.5 ms in FACTS is the analogue sqrt(2)/(2 pi f_c).
    """
    ramp = np.arange(600.0) * SAMPLE
    low_pass_delay = math.sqrt(2.0) * SAMPLE / (2.0 * math.tan(math.pi * CUTOFF * SAMPLE))
    assert abs((ramp - low_pass(ramp))[-1] - low_pass_delay) < ROUNDOFF
    assert abs(low_pass_delay - 0.0225) <= physics(0.0225, relative=0.01)
    total = low_pass_delay + 7 * SAMPLE
    assert abs((ramp - chain(ramp))[-1] - total) < ROUNDOFF
    assert abs(total - 0.0505) <= physics(0.0505, relative=0.01)


def test_moving_average_delays_by_whole_samples() -> None:
    """Symmetric window of 15: a straight line comes out seven samples late."""
    line = 3.0 + 0.25 * np.arange(100.0)
    assert np.abs(moving_average(line)[15:] - line[8:-7]).max() < ROUNDOFF * line.max()


def test_delay_line_delays_by_whole_samples_and_interpolates_between_them() -> None:
    u = np.random.default_rng(0).normal(size=100)
    for whole in (0, 1, 7, 38):
        y = delayed(u, float(whole))
        assert np.abs(y[whole:] - u[: len(u) - whole]).max() == EXACT
        assert np.abs(y[:whole]).sum() == EXACT
    assert np.abs(delayed(u, 2.25)[5:] - (0.75 * u[3:-2] + 0.25 * u[2:-3])).max() < ROUNDOFF * np.abs(u).max()


def test_rest_is_the_steady_state_of_a_constant_input() -> None:
    """Every filter has DC gain 1 and starts without a transient."""
    b, a = coefficients()
    z, ring, line = np.zeros((2, 2)), np.zeros((2, CAPACITY)), np.zeros((2, CAPACITY))
    for channel, u in enumerate((750.0, -1e-3)):
        biquad_rest(b, a, z, channel, u)
        average_rest(ring, WINDOW, channel, u)
        delay_rest(line, CAPACITY, channel, u)
        for k in range(100):
            assert abs(biquad(b, a, z, channel, u) - u) <= ROUNDOFF * abs(u)
            assert abs(average(ring, WINDOW, k % WINDOW, channel, u) - u) <= ROUNDOFF * abs(u)
            assert delay(line, CAPACITY, k % CAPACITY, 12.5, channel, u) == u


def test_cutoff_zero_is_no_filter() -> None:
    u = np.random.default_rng(1).normal(size=20)
    assert np.abs(low_pass(u, cutoff=0.0) - u).max() == EXACT


def test_channels_do_not_mix() -> None:
    b, a = coefficients()
    z, ring = np.zeros((2, 2)), np.zeros((2, CAPACITY))
    for k in range(30):
        biquad(b, a, z, 1, 1.0)
        average(ring, WINDOW, k % WINDOW, 1, 1.0)
    assert not np.any(z[0])
    assert not np.any(ring[0])


# ------------------------------------------------------------------------------------------ numerics


@pytest.mark.parametrize("cutoff", [0.5, 10.0, 40.0, 124.0])
def test_coefficients_are_those_of_scipy(cutoff: float) -> None:
    b, a = coefficients(cutoff)
    b_scipy, a_scipy = signal.butter(2, cutoff, fs=1.0 / SAMPLE)
    assert np.abs(b - b_scipy).max() < ROUNDOFF
    assert np.abs(a - a_scipy[1:]).max() < ROUNDOFF


def test_chain_is_that_of_scipy_on_noise() -> None:
    u = np.random.default_rng(2).normal(size=400)
    b, a = signal.butter(2, CUTOFF, fs=1.0 / SAMPLE)
    expected = signal.lfilter(np.full(WINDOW, 1.0 / WINDOW), [1.0], signal.lfilter(b, a, u))
    assert np.abs(chain(u) - expected).max() < ROUNDOFF


def test_moving_average_forgets_completely() -> None:
    """No running sum: after a burst of 1e12 the average of small numbers has no rounding error left."""
    u = np.concatenate([np.full(10, 1e12), np.full(40, 0.1)])
    assert abs(moving_average(u)[-1] - 0.1) < ROUNDOFF


# -------------------------------------------------------------------------------------------- window


@pytest.mark.parametrize(
    ("rpm", "sample_hz", "alias", "window"),
    [
        (13000, 250.0, 33.3333, 15),  # Haehn & Weigold: FACTS 7
        (12000, 250.0, 50.0, 5),
        (12000, 500.0, 200.0, 5),  # 2 ms task of the KR 500 paper: 500/200 = 2.5, two periods
        (3600, 250.0, 60.0, 25),  # 250/60 = 4.17: six periods in 25 samples fit exactly
        (15600, 250.0, 10.0, 25),
    ],
)
def test_window_for_a_spindle_speed(rpm: float, sample_hz: float, alias: float, window: int) -> None:
    assert abs(aliased_frequency(rpm / 60.0, sample_hz) - alias) <= physics(alias, absolute=1e-4)
    assert moving_average_window(rpm / 60.0, sample_hz) == window


def test_window_is_the_best_of_all_that_are_allowed() -> None:
    """Against a search over all windows that are a rounded whole number of alias periods."""
    for rpm in np.random.default_rng(3).uniform(2000, 24000, 60):
        line = aliased_frequency(rpm / 60.0, 250.0)
        if line * 25.5 <= 250.0:
            continue
        allowed = sorted({math.floor(m * 250.0 / line + 0.5) for m in range(1, 60)})
        left = {n: abs(np.exp(-2j * np.pi * line / 250.0 * np.arange(n)).mean()) for n in allowed if n <= 25}
        assert left[moving_average_window(rpm / 60.0, 250.0)] <= min(left.values()) + 1e-8


def test_window_errors_say_what_to_do() -> None:
    with pytest.raises(ValueError, match=r"250 Hz appears at 0 Hz when sampled at 250 Hz; .*Change the spindle speed"):
        moving_average_window(250.0, 250.0)
    with pytest.raises(ValueError, match="must both be positive"):
        moving_average_window(0.0, 250.0)


# -------------------------------------------------------------------------------------------- parity


def test_compiled_filters_are_the_same_bits() -> None:
    @njit(**{**COMPILER_OPTIONS, "nogil": True})
    def run(u, y, b, a, z, ring, line):  # type: ignore[no-untyped-def]  # compiled
        butterworth(CUTOFF, SAMPLE, b, a)
        for k in range(len(u)):
            late = delay(line, CAPACITY, k % CAPACITY, 2.25, 0, u[k])
            y[k] = average(ring, WINDOW, k % WINDOW, 0, biquad(b, a, z, 0, late))

    u = np.random.default_rng(4).normal(size=300)
    y = np.zeros(300)
    run(u, y, np.zeros(3), np.zeros(2), np.zeros((1, 2)), np.zeros((1, CAPACITY)), np.zeros((1, CAPACITY)))
    assert np.abs(y - chain(delayed(u, 2.25))).max() == EXACT
