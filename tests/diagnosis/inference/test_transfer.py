"""An answer must hold in conditions that it was not fitted to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from robomill.diagnosis.candidates import Address, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.diagnosis.inference.adequacy import EXACT, HOLDS, MISFIT, kept, left_by
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.evidence import DEPENDENCE, DISCREPANCY, FORM, Evidence, gather
from robomill.diagnosis.inference.transfer import KEEPS, Transfer, transfer
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis import axis
from tests.diagnosis.demo import CATALOGUE, SYSTEM, WELL, catalogue, measure, resolve
from tests.diagnosis.formula import Calculated, candidate
from tests.tolerances import ROUNDOFF, chance

RUBBING = {"masses": {"friction[1]": 0.03}}


def scatter(transfer: dict[str, Any]) -> float:
    """Standard error of a right model's gain over its promise: noise and fitted value have the same part in it.

    Noise alone leaves the root of twice the promise, and as much comes from the value, if that was found where as much could be seen.
    These samples are independent, each of them is worth what the diagnosis gives DEPENDENCE of them.
    """
    return 2.0 / math.sqrt(transfer["expected_gain"] * DEPENDENCE)


def answer(folder: Path, held_out: list[Run]) -> dict[str, Any]:
    return diagnose(SYSTEM, measure(RUBBING), catalogue(folder), held_out=held_out, resolver=resolve).result


def test_what_is_right_has_its_expected_gain_in_a_new_condition(tmp_path: Path) -> None:
    result = answer(tmp_path, measure(RUBBING, amplitude=0.6, repeats=2, seed=2))
    assert result["verdict"] == "identified"
    assert result["transfer"]["expected_gain"] > 400.0
    assert result["transfer"]["amplitude"] == pytest.approx(1.0, abs=chance(result["transfer"]["deviation"] + result["transfer"]["doubt"]))
    assert result["transfer"]["promise"] > 0.0
    assert result["transfer"]["worth"] == pytest.approx(-math.log(HOLDS), rel=LITTLE)
    assert result["transfer"]["gain"] == pytest.approx(result["transfer"]["expected_gain"], rel=chance(scatter(result["transfer"])))


def test_what_is_not_there_in_a_new_condition_is_unknown(tmp_path: Path) -> None:
    result = answer(tmp_path, measure(amplitude=0.6, repeats=2, seed=2))
    assert result["verdict"] == "unknown"
    assert result["transfer"]["gain"] < 0.0 < result["transfer"]["expected_gain"]
    assert result["transfer"]["after"] > result["transfer"]["before"]
    assert result["unknown"]["nearest"] == "friction @ mass 1"
    assert result["transfer"]["promise"] < 0.0
    assert result["tests"]["p_fit"] < 0.5


def test_without_tolerances_the_nominal_numbers_count(tmp_path: Path) -> None:
    (tmp_path / "catalogue.toml").write_text(CATALOGUE.partition("[[nuisance]]")[0])
    held = measure(RUBBING, amplitude=0.6, repeats=2, seed=2)
    found = Catalogue.load(tmp_path / "catalogue.toml")
    result = diagnose(SYSTEM, measure(RUBBING), found, held_out=held, resolver=resolve).result
    assert result["verdict"] == "identified"
    assert result["transfer"]["gain"] == pytest.approx(result["transfer"]["expected_gain"], rel=chance(scatter(result["transfer"])))


@pytest.mark.parametrize("repeats", [0, 2])
def test_more_of_the_same_is_no_new_condition(tmp_path: Path, repeats: int) -> None:
    result = answer(tmp_path, measure(RUBBING, repeats=repeats, seed=2))
    assert result["verdict"] == "identified"
    assert "transfer" not in result


class TestPromise:
    """Against densities of normal distributions."""

    @pytest.mark.parametrize("amplitude", [1.0, 0.9, 0.5, 0.0, -1.0, 1.4, 2.0])
    @pytest.mark.parametrize(("deviation", "doubt"), [(0.02, 0.0), (0.05, 0.05), (0.3, 0.1), (5.0, 0.0)])
    def test_it_is_the_ratio_of_the_densities_of_the_amplitude(self, amplitude: float, deviation: float, doubt: float) -> None:
        found = Transfer(2.0, 1.1, 10.0, 10.0, doubt, amplitude, deviation)
        right = math.hypot(deviation, doubt)
        other = math.hypot(right, KEEPS)
        assert found.promise == pytest.approx(norm.logpdf(amplitude, 1.0, right) - norm.logpdf(amplitude, 1.0, other), rel=1e2 * ROUNDOFF)
        assert found.worth == kept(found.promise + left_by(2.0, 1.1))  # little is left: a stand-in that holds leaves as little
        assert replace(found, worse=-3.0).worth == found.worth - 3.0

    def test_an_amplitude_that_is_hardly_seen_says_nothing(self) -> None:
        for amplitude in (-3.0, 1.0, 5.0):
            assert abs(Transfer(1.1, 1.1, 0.0, 0.1, 0.0, amplitude, 20.0).promise) < 0.02

    def test_what_is_off_by_more_than_noise_and_doubt_speaks_against_a_model_and_more_so_the_further_it_is(self) -> None:
        found = [Transfer(5.0, 2.0, 10.0, 10.0, 0.05, amplitude, 0.05).promise for amplitude in (1.0, 0.95, 0.8, 0.5, 0.0)]
        assert found == sorted(found, reverse=True)
        assert found[0] > 1.5
        assert found[3] < -5.0

    def test_a_promise_is_no_surer_than_the_fitted_values(self) -> None:
        """A size effect of 0.083 that was found as 0.112 has 0.74 of its promise."""
        assert Transfer(1.06, 1.03, 43.4, 114.1, 0.16, 0.74, 0.05).promise > 0.0
        assert Transfer(1.06, 1.03, 43.4, 114.1, 0.04, 0.74, 0.05).promise < 0.0
        assert Transfer(1.06, 1.03, -43.4, 114.1, 0.16, 0.1, 0.05).promise < 0.0

    def test_a_fault_of_the_log_leaves_nothing_there_either(self) -> None:
        exact, effect = (Transfer(20.0, 4.0, 10.0, 10.0, 0.05, 1.0, 0.05, share) for share in (EXACT, MISFIT))
        assert exact.promise == effect.promise
        assert exact.worth < effect.worth


LITTLE = 0.05
"""Part of what a model may gain that one which holds lacks: exp(-3) of it, for odds of 3 nats against stand-ins that do not hold."""
TOLERATED = '[[nuisance]]\ncomponent = "drive"\nparameters = ["inertia_error"]\nabsolute = 0.002\nunit = "kg.m2"\nsource = "made up"\n'
HEAVY = {"inertia_error": 0.06}


def tolerated(folder: Path, held: list[Run]) -> dict[str, Any]:
    """The axis with 30 times as much of an effect as the tolerance of the calibrated number that it is."""
    found = axis.catalogue(folder)
    (folder / "axis.toml").write_text((folder / "axis.toml").read_text() + TOLERATED)
    found = Catalogue.load(folder / "axis.toml")
    return diagnose(axis.system(), axis.measure(HEAVY, repeats=3), found, held_out=held, resolver=axis.resolve).result


def test_who_moves_a_calibrated_number_in_a_new_condition_pays_for_it(tmp_path: Path) -> None:
    """30 deviations that had to be moved in the diagnosed runs are not moved for nothing in the next."""
    result = tolerated(tmp_path, axis.measure(HEAVY, repeats=2, size=0.6, seed=2))
    assert result["verdict"] == "identified"
    moved = result["transfer"]
    # of 30 deviations the 30 have s / (1 + s), where a single one has the chi2 s: that of 2.6 deviations of noise, as the force is sudden
    assert moved["expected_gain"] == pytest.approx(0.5 * 30.0**2 * 6.8 / 7.8, rel=WELL)
    assert moved["gain"] == pytest.approx(moved["expected_gain"], rel=chance(scatter(moved)))
    assert moved["after"] < 1.4 < moved["before"]


def test_a_calibrated_number_that_is_right_in_a_new_condition_was_not_the_cause(tmp_path: Path) -> None:
    result = tolerated(tmp_path, axis.measure(repeats=2, size=0.6, seed=2))
    assert result["verdict"] == "unknown"
    assert result["transfer"]["gain"] < 0.0 < result["transfer"]["expected_gain"]


class TestGain:
    """Two conditions, in the second of which everything is twice as large; one effect and one calibrated number."""

    ROWS = 300
    T = np.arange(ROWS) * 0.01
    EFFECT, NUISANCE = ("a", "p"), Nuisance(("a", "calibrated"), 0.05)

    def simulated(self, condition: int, values: Mapping[Address, float]) -> FloatArray | None:
        if values.get(self.EFFECT, 0.0) > 10.0:
            return None
        change = values.get(self.EFFECT, 0.0) * np.sin(3.0 * self.T) + values.get(self.NUISANCE.address, 0.0) * np.sin(3.0 * self.T + 0.5)
        return ((1.0 + condition) * (np.cos(2.0 * self.T) + change))[:, None]

    def made(self, conditions: int = 2) -> tuple[Any, list[list[FloatArray]], Calculated]:
        """As after a search, in which the first condition was diagnosed; measured repeats; the laboratory."""
        laboratory = Calculated(self.simulated, self.ROWS, conditions=conditions)
        rng = np.random.default_rng(1)
        truth = [self.simulated(i, {self.EFFECT: 0.5, self.NUISANCE.address: 0.04}) for i in range(conditions)]
        groups = [[x + 0.05 * rng.normal(size=x.shape) for _ in range(3)] for x in truth if x is not None]
        search = SimpleNamespace(simulator=Simulator(laboratory), groups=groups[:1], nuisances=[self.NUISANCE])
        search.evidence = self.gathered(laboratory, groups, 0)
        return search, groups, laboratory

    def gathered(self, laboratory: Calculated, groups: Sequence[Sequence[FloatArray]], i: int, like: Evidence | None = None) -> Evidence:
        nominal = self.simulated(i, {})
        changes = {a: [y - nominal] for a in (self.EFFECT, self.NUISANCE.address) if (y := self.simulated(i, {a: 1.0})) is not None}
        assert nominal is not None
        if like is not None:
            del changes[self.EFFECT]
        scales = {self.EFFECT: 1.0} if like is None else {}
        tolerances = {self.NUISANCE.address: self.NUISANCE.scale}
        sizes = dict.fromkeys(changes, 1.0)
        return gather(laboratory, [f"condition {i}"], [groups[i]], [[nominal]], changes, sizes, scales, tolerances, like=like)

    def fit(self, value: float) -> Fit:
        return Fit((candidate("p"),), {self.EFFECT: value}, {self.EFFECT: 0.01}, 0.0, 0.0)

    @pytest.mark.parametrize("doubt", [0.0, 0.2])
    def test_gain_and_promise_are_those_of_the_covariance_of_noise_tolerances_and_doubt(self, doubt: float) -> None:
        search, groups, laboratory = self.made()
        found = transfer(search, groups, self.fit(0.5), doubt)
        assert found is not None
        there = self.gathered(laboratory, groups, 1, search.evidence)
        alike = self.simulated(1, {self.EFFECT: 0.5})
        assert alike is not None
        s = there.signature([alike])
        assert s is not None
        nuisances = there.space.nuisances.toarray()
        covariance = np.eye(self.ROWS) + nuisances @ nuisances.T
        y, unsure = there.space.y, covariance + doubt**2 * np.outer(s, s)
        before, after = y @ np.linalg.solve(covariance, y), (y - s) @ np.linalg.solve(unsure, y - s)
        # one array, twice as large here; three repeats that are all off by the same
        off = math.sqrt(3.0) * DISCREPANCY * 2.0 * self.NUISANCE.scale * math.sqrt(float((np.sin(3.0 * self.T + 0.5) ** 2).mean()))
        part = off / np.hypot(there.sudden[0], there.whitening.factor[0, 0])
        allowed = float(there.expected.sum() + (part**2).sum() / DEPENDENCE)
        part = doubt * s * (doubt * s @ np.linalg.solve(covariance, y - s)) / (1.0 + doubt**2 * s @ np.linalg.solve(covariance, s))
        left = y - s - part  # what it costs to doubt the fitted values is in the gain alone
        expected = (
            (before + 1.0) / (allowed + 1.0),
            (left @ np.linalg.solve(covariance, left) + 1.0) / (allowed + 1.0),
            0.5 * (before - after),
            0.5 * (s @ np.linalg.solve(covariance, s)),
            doubt,
        )
        assert (found.before, found.after, found.gain, found.expected_gain, found.doubt) == pytest.approx(expected, rel=1e4 * ROUNDOFF)
        # one condition and one array: what the law may miss there is one column
        wide = np.linalg.inv(covariance + FORM**2 * np.outer(s, s))
        assert found.amplitude == pytest.approx(s @ wide @ y / (s @ wide @ s), rel=1e4 * ROUNDOFF)
        assert found.deviation == pytest.approx((s @ wide @ s) ** -0.5, rel=1e4 * ROUNDOFF)
        assert found.misfit == MISFIT
        assert found.promise > 0.0

    @pytest.mark.parametrize(("value", "amplitude"), [(1.0, 0.5), (0.25, 2.0)])
    def test_the_amplitude_is_what_is_there_over_what_the_model_says(self, value: float, amplitude: float) -> None:
        search, groups, _ = self.made()
        found = transfer(search, groups, self.fit(value), 0.05)
        assert found is not None
        assert found.amplitude == pytest.approx(amplitude, abs=chance(found.deviation))
        assert found.promise < 0.0

    def test_there_is_none_without_a_new_condition_or_where_the_model_cannot_run(self) -> None:
        search, groups, _ = self.made(conditions=1)
        assert transfer(search, groups, self.fit(0.5), 0.0) is None
        search, groups, _ = self.made()
        assert transfer(search, groups, self.fit(11.0), 0.0) is None
