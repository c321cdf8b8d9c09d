"""An answer must hold in conditions that it was not fitted to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.catalogue import Address, Catalogue, Nuisance
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.diagnosis.inference.evidence import DEPENDENCE, Evidence, gather
from robomill.diagnosis.inference.transfer import TELLING, Transfer, transfer
from robomill.diagnosis.outcome.verdict import stands
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis import axis
from tests.diagnosis.demo import CATALOGUE, SYSTEM, WELL, catalogue, measure, resolve
from tests.diagnosis.formula import Calculated
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
    assert result["transfer"]["expected_gain"] > 20.0 * TELLING
    assert result["transfer"]["gain"] == pytest.approx(result["transfer"]["expected_gain"], rel=chance(scatter(result["transfer"])))


def test_what_is_not_there_in_a_new_condition_is_unknown(tmp_path: Path) -> None:
    result = answer(tmp_path, measure(amplitude=0.6, repeats=2, seed=2))
    assert result["verdict"] == "unknown"
    assert result["transfer"]["gain"] < 0.0 < result["transfer"]["expected_gain"]
    assert result["transfer"]["after"] > result["transfer"]["before"]
    assert result["unknown"]["nearest"] == "friction @ mass 1"


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


def test_an_expected_gain_too_small_to_be_told_from_noise_is_no_test() -> None:
    assert not Transfer(2.0, 2.0, -3.0, 0.9 * TELLING).tells
    assert Transfer(2.0, 2.0, -3.0, 1.1 * TELLING).tells


@pytest.mark.parametrize(
    ("expected_gain", "gain", "holds"),
    [
        (1000.0, 601.0, True),
        (1000.0, 599.0, False),
        (25.0, 5.0, True),  # a fifth of it, but that is within chance
        (25.0, 3.0, False),
        (12.0, -2.0, True),
        (12.0, -3.0, False),  # so much is lost of a small expected gain only by what is wrong
        (30.0, 91.0, True),  # other effects add to it
        (30.0, 93.0, False),  # not so much
        (1000.0, 1990.0, True),
    ],
)
def test_a_model_holds_that_has_its_part_of_the_expected_gain_but_for_chance(expected_gain: float, gain: float, holds: bool) -> None:
    assert Transfer(2.0, 1.0, gain, expected_gain).holds is holds


def test_what_hardly_shows_stands_no_test_but_can_fail_it() -> None:
    assert stands(Transfer(1.1, 1.1, 10.0, 0.9 * TELLING)) is None
    assert stands(Transfer(1.1, 1.2, -20.0, 0.9 * TELLING)) is False
    assert stands(Transfer(1.1, 1.0, 20.0, 1.1 * TELLING)) is True
    assert stands(Transfer(3.0, 2.9, 20.0, 1.1 * TELLING)) is False  # has its expected gain and leaves the most


def test_an_expected_gain_is_no_surer_than_the_fitted_values() -> None:
    """A size effect of 0.083, found as 0.112: its expected gain is (0.112 / 0.083)^2 of what it could gain (case 0005 of seed 2038)."""
    assert Transfer(1.06, 1.03, 43.4, 114.1, doubt=0.16).holds
    assert not Transfer(1.06, 1.03, 43.4, 114.1, doubt=0.04).holds
    assert not Transfer(1.06, 1.03, -43.4, 114.1, doubt=0.16).holds


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
    # of 30 deviations the 30 have s / (1 + s), where a single one has the chi2 s: that of 3.8 deviations of noise
    assert moved["expected_gain"] == pytest.approx(0.5 * 30.0**2 * 14.5 / 15.5, rel=WELL)
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

    @pytest.mark.parametrize("doubt", [0.0, 0.2])
    def test_gain_and_promise_are_those_of_the_covariance_of_noise_tolerances_and_doubt(self, doubt: float) -> None:
        search, groups, laboratory = self.made()
        found = transfer(search, groups, {self.EFFECT: 0.5}, doubt)
        assert found is not None
        there = self.gathered(laboratory, groups, 1, search.evidence)
        alike = self.simulated(1, {self.EFFECT: 0.5})
        assert alike is not None
        s = there.signature([alike])
        assert s is not None
        covariance = np.eye(self.ROWS) + there.space.nuisances @ there.space.nuisances.T
        y, noise = there.space.y, float(there.expected.sum())
        before = y @ np.linalg.solve(covariance, y)
        after = (y - s) @ np.linalg.solve(covariance + doubt**2 * np.outer(s, s), y - s)
        expected = (before / noise, after / noise, 0.5 * (before - after), 0.5 * (s @ np.linalg.solve(covariance, s)), doubt)
        assert (found.before, found.after, found.gain, found.expected_gain, found.doubt) == pytest.approx(expected, rel=1e4 * ROUNDOFF)
        assert found.holds
        assert found.tells

    def test_there_is_none_without_a_new_condition_or_where_the_model_cannot_run(self) -> None:
        search, groups, _ = self.made(conditions=1)
        assert transfer(search, groups, {self.EFFECT: 0.5}, 0.0) is None
        search, groups, _ = self.made()
        assert transfer(search, groups, {self.EFFECT: 11.0}, 0.0) is None
