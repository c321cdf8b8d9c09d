"""Random numbers from (seed, counter, channel): statistics, independence, the same bits compiled."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from robomill.models.maths.noise import mix, normal_pair, uniform
from robomill.models.model.kernels import COMPILER_OPTIONS

N = 20_000
SIGMAS = 4.0
"""Confidence of the statistical tests: 4 standard errors, false alarm 6e-5 (and the numbers are seeded)."""


def normals(seed: int, channel: int = 0) -> np.ndarray:
    return np.array([normal_pair(seed, k, channel) for k in range(N)])


def test_mix_is_a_bijection_on_a_sample_and_spreads_every_bit() -> None:
    rng = np.random.default_rng(1)
    inputs = rng.integers(0, 2**32, 500)
    assert len({mix(int(x)) for x in inputs}) == len(set(inputs.tolist()))
    flips = np.array([[(mix(int(x)) ^ mix(int(x) ^ (1 << bit))).bit_count() for bit in range(32)] for x in inputs])
    # binomial(32 * 500, 1/2) flipped bits for each input bit
    assert np.abs(flips.mean(axis=0) - 16.0).max() < SIGMAS * np.sqrt(8.0 / len(inputs))


def test_uniform_has_the_moments_of_the_uniform_distribution_and_never_reaches_the_ends() -> None:
    u = np.array([uniform(7, k, 3) for k in range(N)])
    assert 0.0 < u.min() < u.max() < 1.0
    assert abs(u.mean() - 0.5) < SIGMAS * np.sqrt(1.0 / 12.0 / N)
    assert abs(u.var() - 1.0 / 12.0) < SIGMAS * np.sqrt(1.0 / 180.0 / N)


def test_normal_numbers_are_standard_normal_and_white() -> None:
    x = normals(2)
    assert np.abs(x.mean(axis=0)).max() < SIGMAS / np.sqrt(N)
    assert np.abs(x.var(axis=0) - 1.0).max() < SIGMAS * np.sqrt(2.0 / N)
    assert abs(np.mean(x[:, 0] ** 4) - 3.0) < SIGMAS * np.sqrt(96.0 / N)  # kurtosis of a normal distribution
    for lag in (1, 2, 15):
        assert abs(np.mean(x[lag:, 0] * x[:-lag, 0])) < SIGMAS / np.sqrt(N)
    assert abs(np.mean(x[:, 0] * x[:, 1])) < SIGMAS / np.sqrt(N)


@pytest.mark.parametrize(("other_seed", "other_channel"), [(3, 0), (2, 1)])
def test_seeds_and_channels_are_independent(other_seed: int, other_channel: int) -> None:
    a, b = normals(2)[:, 0], normals(other_seed, other_channel)[:, 0]
    assert abs(np.mean(a * b)) < SIGMAS / np.sqrt(N)


def test_compiled_numbers_are_the_same_bits() -> None:
    options = {**COMPILER_OPTIONS, "nogil": True}

    @njit(**options)
    def draw(seed: int, counter: int, channel: int) -> tuple[float, float]:
        return normal_pair(seed, counter, channel)

    for seed in (0, 1, 2**31 - 1):
        for counter in (0, 1, 2, 10**6, 2**40):
            assert draw(seed, counter, 5) == normal_pair(seed, counter, 5)
