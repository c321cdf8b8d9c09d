"""Values and intervals of single recordings: noise with a memory, bounds, and what is not named beside what is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from robomill.diagnosis.candidates import Address, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.diagnosis.inference.evidence import DISCREPANCY, FORM
from robomill.diagnosis.inference.intervals import MATERIAL, MEMORY, Known, Noise, Problem, by_least_squares
from robomill.diagnosis.inference.search import Search
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.formula import Calculated, candidate
from tests.tolerances import ROUNDOFF

STEP, ROWS = 0.02, 1000
T = STEP * np.arange(ROWS)
RUNS = 40
"""Recordings of the same machine: 90 % of them are 36 +- 2 (one standard deviation)."""
BY_NOISE = 1e-3
"""Relative: noise of a ten thousandth has a hundredth of that beside a law that is off by four hundredths, and tells it from a mean."""
BEGUN = 0.05
"""Relative: a run without its beginning, which has not settled, is no whole number of waves."""


def noise(rng: np.random.Generator, white: float = 0.3, coloured: float = 1.0, memory: float = 0.2) -> FloatArray:
    keeps = math.exp(-STEP / memory)
    slow = lfilter([math.sqrt(1.0 - keeps**2)], [1.0, -keeps], rng.standard_normal(2 * ROWS))[ROWS:]
    return np.asarray(coloured * slow + white * rng.standard_normal(ROWS))


def known(y: FloatArray, columns: FloatArray, *names: str, low: float = -math.inf, waves: int = 0) -> dict[str, Known]:
    """What is known of the effects `names`; column i is what p<i> does. The last `waves` columns are what two formulations differ by."""
    k = columns.shape[1]
    order = [("a", f"p{i}") for i in range(k)]
    named = np.array([p in names for _, p in order])
    ends = np.full(k, low), np.full(k, math.inf)
    made = Problem(order, np.ones(k), *ends, np.zeros(k), named, [y[:, None]], [columns[:, None, :]], STEP, k - waves)
    return made.known(made.solved(), tuple(candidate(n) for n in names))


def columns() -> FloatArray:
    """A motion, and another one that is much like it."""
    return np.stack([np.sign(np.sin(2.0 * T)), np.sin(2.0 * T), np.cos(0.7 * T)], axis=1)


def test_the_covariance_of_the_noise_is_that_of_white_noise_and_an_ornstein_uhlenbeck_process() -> None:
    of = Noise(0.3, 0.8, 0.9)
    matrix = 0.3 * np.eye(50) + 0.8 * toeplitz(0.9 ** np.arange(50))
    x = np.random.default_rng(1).standard_normal((50, 3))
    assert np.allclose(of.times(x), matrix @ x, rtol=ROUNDOFF, atol=ROUNDOFF)


def test_white_noise_has_no_coloured_part_and_samples_without_memory_have_none() -> None:
    rng = np.random.default_rng(2)
    plain = Noise.of([rng.standard_normal(20 * ROWS)], STEP)
    assert plain.coloured < 0.02
    assert Noise.of([noise(rng)], math.inf).coloured == 0.0
    both = Noise.of([noise(rng) for _ in range(20)], STEP)
    assert 0.6 < both.coloured < 1.2
    assert math.exp(-STEP / 0.1) < both.keeps <= math.exp(-STEP / MEMORY)


def test_the_truth_is_in_nine_of_ten_intervals_also_with_an_effect_that_is_not_named() -> None:
    """Coulomb friction is named, viscous friction is there and is not."""
    J, inside, alone = columns(), 0, 0
    for seed in range(RUNS):
        y = J @ [2.0, 0.6, 0.0] + noise(np.random.default_rng([3, seed]))
        for columns_of in (J, J[:, :1]):
            of = known(y, columns_of, "p0")["p0 @ place"]
            value, deviation = (x["a", "p0"] for x in (of.values, of.deviations))
            hit = abs(value - 2.0) < 1.645 * deviation
            inside, alone = inside + (hit and columns_of is J), alone + (hit and columns_of is not J)
    assert inside >= 0.85 * RUNS
    assert alone < 0.5 * RUNS  # it stands for what nobody named


def test_what_the_data_hardly_say_is_left_to_the_priors_however_long_the_noise_remembers() -> None:
    """Two friction terms are named, and a gain of both is not: it is free against them. Noise that remembers would else give it a size."""
    J, far, inside = columns(), 0, 0
    for seed in range(RUNS):
        rng = np.random.default_rng([7, seed])
        scale = J[:, 0] + J[:, 1] + 0.02 * J[:, 2]  # of one more term it does a fiftieth
        y = 2.0 * J[:, 0] + 2.0 * J[:, 1] + noise(rng, 0.05, 1.0, 0.2)
        of = known(y, np.column_stack([J[:, :2], 2.0 * scale]), "p0", "p1")["p0 @ place"]
        value, deviation = (x["a", "p0"] for x in (of.values, of.deviations))
        far += abs(value - 2.0) > 2.0  # a gain of one, which is its prior scale
        inside += abs(value - 2.0) < 1.645 * deviation
    assert far <= 0.1 * RUNS
    assert inside >= 0.85 * RUNS


def test_a_sign_is_hard_and_what_closes_little_is_said_to() -> None:
    J = columns()
    y = J @ [2.0, -0.4, 0.03] + 0.1 * noise(np.random.default_rng(4))
    found = known(y, J, "p0", "p1", "p2", low=0.0)
    assert abs(found["p1 @ place"].values["a", "p1"]) < ROUNDOFF
    assert found["p0 @ place"].closes > 0.5
    assert found["p2 @ place"].closes < MATERIAL


def test_a_number_that_does_nothing_may_be_anything_and_a_bound_is_met() -> None:
    x = columns()
    y = 2.0 * x[:, 0] + noise(np.random.default_rng(5))
    found = known(y, np.column_stack([x[:, :2], np.zeros(ROWS)]), "p0", "p2")
    assert found["p2 @ place"].values["a", "p2"] == 0.0
    assert found["p2 @ place"].deviations["a", "p2"] == math.inf
    assert 0.0 < found["p0 @ place"].deviations["a", "p0"] < 0.2
    assert known(-y, x, "p0", low=-1.0)["p0 @ place"].values["a", "p0"] == -1.0


def test_a_value_may_be_off_by_as_much_as_its_law() -> None:
    """The effect is ten thousand times the noise, so that nothing else is unsure."""
    J = columns()[:, :1]
    of = known(100.0 * J[:, 0] + 0.01 * noise(np.random.default_rng(6)), J, "p0")["p0 @ place"]
    assert of.deviations["a", "p0"] == pytest.approx(FORM * 100.0, rel=BY_NOISE)


def test_what_two_formulations_may_differ_by_is_no_effect() -> None:
    """A half wave in the whole run looks like a drift. Where formulations may differ by one as large, it is none."""
    drift, wave = 2.0 * T / T[-1] - 1.0, np.cos(math.pi * np.arange(ROWS) / ROWS)
    y = -wave + 0.1 * noise(np.random.default_rng(8))
    alone = known(y, drift[:, None], "p0")["p0 @ place"]
    beside = known(y, np.column_stack([drift, wave]), "p0", waves=1)["p0 @ place"]
    assert alone.values["a", "p0"] > 10.0 * alone.deviations["a", "p0"]
    assert abs(beside.values["a", "p0"]) < 2.0 * beside.deviations["a", "p0"]


def test_formulations_differ_as_slowly_as_tolerances_do_and_are_not_simulated() -> None:
    """A tolerance makes two half waves in a run; another formulation may make three. One of that is there, and a drift."""
    t = (np.arange(ROWS) + 0.5) / ROWS
    drift, number = ("a", "drift"), ("a", "number")

    def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
        assert set(values) <= {drift, number}
        return np.asarray(values.get(drift, 0.0) * t + values.get(number, 0.0) * np.cos(2.0 * math.pi * t))[:, None]

    y = 1.5 * t + DISCREPANCY * np.cos(3.0 * math.pi * t) + 1e-3 * np.random.default_rng(9).standard_normal(ROWS)
    catalogue = Catalogue(Path("made up"), (candidate("drift"),))
    search = Search(catalogue, Simulator(Calculated(formula, ROWS)), [[y[:, None]]], [Nuisance(number, 1.0)])
    fit = search.fitted(catalogue.candidates, {drift: 1.5}, {drift: 0.1})
    assert fit is not None
    made = Problem.of(search, fit, fit.values)
    assert made is not None
    assert made.parameters == 2
    size = DISCREPANCY * math.sqrt(0.5)  # root of the mean square of what the tolerance does
    begin = ROWS - len(made.left[0])
    waves = made.slopes[0][:, 0, 2:]
    assert waves == pytest.approx(size * np.cos(math.pi * np.outer(t[begin:], [2.0, 3.0])), rel=BEGUN, abs=BEGUN * size)
    of = by_least_squares(search, fit)["drift @ place"]
    assert abs(of.values[drift] - 1.5) < 1.645 * of.deviations[drift]
    first = {n: getattr(made, n)[:2] for n in ("order", "scales", "low", "high", "at", "named")}
    without = replace(made, slopes=[made.slopes[0][:, :, :2]], **first)
    plain = without.known(without.solved(), catalogue.candidates)["drift @ place"]
    assert abs(plain.values[drift] - 1.5) > abs(of.values[drift] - 1.5)
