"""Marginal likelihoods against the densities of multivariate normal distributions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from robomill.diagnosis.inference.marginal import TEMPERATURE, VARIANCE_ROUNDS, MarginalLikelihood
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import ROUNDOFF

SAMPLES = 60
INVERTED = 1e3 * ROUNDOFF
"""Relative: two ways to invert matrices whose condition is below a thousand."""


def density(y: FloatArray, variance: FloatArray, columns: FloatArray) -> float:
    """Log of that of independent noise and of columns at the size of their priors, without the constant that all models share."""
    n = len(y)
    log = multivariate_normal(np.zeros(n), np.diag(variance) + columns @ columns.T).logpdf(y)
    return float(log) + 0.5 * n * math.log(2.0 * math.pi)


class Data:
    """Two outputs, mixed; one doubtful number, effects of two components, one of them with two."""

    def __init__(self, noise: Sequence[float] = (1.0, 1.0)) -> None:
        rng = np.random.default_rng(1)
        self.row = np.arange(SAMPLES) % 3 // 2  # two samples of output 0, one of 1
        self.doubt = rng.normal(size=(SAMPLES, 1))
        self.effects = {"drive": rng.normal(size=(SAMPLES, 1)), "sensor": 0.5 * rng.normal(size=(SAMPLES, 2))}
        self.y = np.asarray(noise)[self.row] * rng.normal(size=SAMPLES) + 2.0 * self.effects["drive"][:, 0]
        self.likelihood = MarginalLikelihood(self.y, self.row, self.doubt, self.effects)

    def columns(self, components: Sequence[str]) -> FloatArray:
        return np.concatenate([self.doubt, *(self.effects[c] for c in components)], axis=1)


@pytest.mark.parametrize("components", [(), ("drive",), ("sensor",), ("sensor", "drive")])
def test_noise_that_is_as_wide_as_it_is_taken_for_gives_the_density_of_a_normal_distribution(components: tuple[str, ...]) -> None:
    data = Data()
    found, variance = data.likelihood.log(components, ())
    assert variance.tolist() == [TEMPERATURE] * 2
    assert found == pytest.approx(density(data.y, np.full(SAMPLES, TEMPERATURE), data.columns(components)), rel=INVERTED)


def test_what_is_there_is_likelier_than_what_is_not() -> None:
    data = Data()
    logs = {c: data.likelihood.log((c,), ())[0] for c in ("drive", "sensor")}
    assert logs["drive"] > data.likelihood.log((), ())[0] + 5.0
    assert logs["sensor"] < logs["drive"] - 5.0


def test_without_columns_the_width_of_an_output_that_is_free_is_its_mean_square_and_is_paid_for() -> None:
    """Half the log of the number of samples, which is what is known of one number from them."""
    row, none = np.arange(SAMPLES) % 2, np.zeros((SAMPLES, 0))
    y = np.where(row == 0, 1.0, 5.0) * np.random.default_rng(2).normal(size=SAMPLES)
    found, variance = MarginalLikelihood(y, row, none, {}).log((), (1,))
    wide = float(np.mean(y[row == 1] ** 2))
    assert variance == pytest.approx([TEMPERATURE, wide], rel=ROUNDOFF)
    expected = density(y, np.where(row == 0, TEMPERATURE, wide), none) - 0.5 * math.log(SAMPLES / 2)
    assert found == pytest.approx(expected, rel=INVERTED)


def test_an_output_that_scatters_less_than_it_may_is_not_taken_for_less() -> None:
    row, none = np.zeros(SAMPLES, dtype=np.intp), np.zeros((SAMPLES, 0))
    y = 0.3 * np.random.default_rng(3).normal(size=SAMPLES)
    likelihood = MarginalLikelihood(y, row, none, {})
    assert likelihood.log((), (0,)) == likelihood.log((), ())
    assert likelihood.log((), (0,))[0] == pytest.approx(density(y, np.full(SAMPLES, TEMPERATURE), none), rel=INVERTED)


def test_with_columns_the_width_is_what_they_leave_and_the_best_round_counts() -> None:
    data = Data(noise=(1.0, 6.0))
    columns = data.columns(("drive",))
    variance, logs = np.full(2, TEMPERATURE), []
    for _ in range(VARIANCE_ROUNDS):
        each = variance[data.row]
        paid = 0.5 * math.log(SAMPLES / 3) if variance[1] > TEMPERATURE else 0.0
        logs.append(density(data.y, each, columns) - paid)
        left = data.y - columns @ (columns.T @ np.linalg.solve(np.diag(each) + columns @ columns.T, data.y))
        variance[1] = max(TEMPERATURE, float(np.mean(left[data.row == 1] ** 2)))
    found, width = data.likelihood.log(("drive",), (1,))
    assert variance[1] > 10.0 * TEMPERATURE
    assert width == pytest.approx(variance, rel=INVERTED)
    assert found == pytest.approx(max(logs), rel=INVERTED)
    assert found > data.likelihood.log(("drive",), ())[0] + 100.0
