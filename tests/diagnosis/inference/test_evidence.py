"""What evidence is made of, on signals of which mean, noise and change are known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.diagnosis.candidates import LOGGING, Address
from robomill.diagnosis.experiment.measured import DataError
from robomill.diagnosis.inference import evidence
from robomill.diagnosis.inference.evidence import (
    ANEW,
    BEGINNING,
    DEPENDENCE,
    DISCREPANCY,
    FORM,
    FORMULATION,
    GUESSED,
    LATENESS,
    SETTLING,
    SUDDEN,
    TRUST,
    Evidence,
    gather,
)
from robomill.diagnosis.inference.noise import SPELL, own_noise
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import STEP
from tests.diagnosis.formula import Calculated, candidate
from tests.tolerances import EXACT, ROUNDOFF, chance, of_variance

P, Q, CALIBRATED = ("a", "p"), ("a", "q"), ("b", "calibrated")
ROWS = 400
RIDGE = 1e-9
"""Relative: what is added to the variances of the channels, so that there is a Cholesky factor."""
CHANNELS = ("a.x", "a.y", "b.z")


def gathered(
    groups: Sequence[Sequence[FloatArray]],
    nominals: Sequence[Sequence[FloatArray]],
    changes: Mapping[Address, Sequence[FloatArray]],
    sizes: Mapping[Address, float],
    scales: Mapping[Address, float],
    tolerances: Mapping[Address, float],
    decimation: int = 1,
    **more: object,
) -> Evidence:
    laboratory = Calculated(lambda *_: None, ROWS, CHANNELS[: groups[0][0].shape[1]], len(groups), decimation)
    names = [c.name for c in laboratory.conditions]
    return gather(laboratory, names, groups, nominals, changes, sizes, scales, tolerances, **more)  # type: ignore[arg-type]


def slopes(evidence: Evidence) -> Mapping[Address, FloatArray]:
    """Whitened change per prior scale."""
    return evidence.sensitivities


def still(value: float = 0.0, channels: int = 1, rows: int = ROWS) -> FloatArray:
    return np.full((rows, channels), value)


class TestRepeats:
    ROWS = 3000

    def noise(self, seed: int, conditions: Sequence[tuple[int, int]]) -> tuple[list[list[FloatArray]], list[list[FloatArray]]]:
        """White measurements and simulations, so many of each condition; a single simulation has no noise."""
        rng = np.random.default_rng(seed)
        groups = [[0.3 * rng.normal(size=(self.ROWS, 2)) for _ in range(n)] for n, _ in conditions]
        nominals = [[0.3 * rng.normal(size=(self.ROWS, 2)) * (m > 1) for _ in range(m)] for _, m in conditions]
        return groups, nominals

    def evidence(self, conditions: Sequence[tuple[int, int]]) -> Evidence:
        groups, nominals = self.noise(1, conditions)
        changes = {P: [still(0.3, 2, self.ROWS) for _ in conditions]}  # the floor is 1/50 of the noise
        return gathered(groups, nominals, changes, {P: 1.0}, {P: 1.0}, {})

    def test_a_mean_is_worth_its_repeats_over_the_samples_that_are_worth_one(self) -> None:
        """A mean of n measured runs against one of m simulations scatters as one of n m / (n + m) runs."""
        found = self.evidence([(2, 1), (5, 1), (5, 8), (3, 3)])
        assert found.repeats == pytest.approx(np.array([2.0, 5.0, 40.0 / 13.0, 1.5]) / DEPENDENCE, rel=ROUNDOFF)

    @pytest.mark.parametrize(("repeats", "simulations"), [(2, 1), (6, 1), (5, 8), (4, 2)])
    def test_what_noise_leaves_is_what_is_expected_of_it(self, repeats: int, simulations: int) -> None:
        """One over DEPENDENCE in each sample that counts, by the mean itself and by the scatter of runs and simulations.

        It is less where simulations scatter: what their mean does from sample to sample is taken for sudden. There the mean has less
        than is expected, by up to a quarter, as it is where it is large that it counts for less.
        """
        found = self.evidence([(repeats, simulations)] * 2)
        y = found.space.y.reshape(2, self.ROWS, 2)
        assert not y[:, :BEGINNING].any()
        assert np.all(y[:, BEGINNING:] != 0.0)
        samples, counted = 4 * self.ROWS, 1.0 - BEGINNING / self.ROWS
        error = chance(math.hypot(of_variance(samples), of_variance(samples * (repeats - 1))))
        left, expected = float(np.sum(found.space.y**2)), float(found.expected.sum())
        if simulations == 1:
            assert left == pytest.approx(expected, rel=error)
        else:
            assert 0.75 * expected < left < (1.0 + error) * expected
        own = np.sqrt((found.whitening.factor**2).sum(axis=1))
        less = float(np.mean([1.0 / (1.0 + (s / own) ** 2) for s in found.sudden]))
        assert (less == 1.0) is (simulations == 1)
        assert expected == pytest.approx(samples * counted * less / DEPENDENCE, rel=error)

    def test_whitened_repeats_are_those_of_single_runs(self) -> None:
        found = self.evidence([(4, 1)])
        (group,) = found.residuals
        assert len(group) == 4
        for run in group:
            assert np.var(run[2 * BEGINNING :]) == pytest.approx(1.0, rel=chance(of_variance(2 * self.ROWS * 3 / 4)))


class TestScales:
    """Without noise: the floor, and the discrepancy of what tolerances change, are all that there is."""

    def evidence(self, repeats: int = 2) -> Evidence:
        """Two conditions; P was simulated at 4 and does 8, in the second condition -8; Q at 1, and does 2; a tolerance of 0.5, at 1.5."""
        changes = {P: [still(8.0), still(-8.0)], Q: [still(2.0), still(2.0)], CALIBRATED: [still(6.0), still(0.0)]}
        groups = [[still()] * repeats] * 2
        return gathered(groups, [[still()]] * 2, changes, {P: 4.0, Q: 1.0, CALIBRATED: 1.5}, {P: 0.1, Q: 1.0}, {CALIBRATED: 0.5})

    FLOOR = TRUST * 6.0 / math.sqrt(2.0)
    """The median of the rms changes 8, 2 and 6 / sqrt(2), the last of which is only in one of two conditions."""

    OFF = DISCREPANCY * 6.0 / math.sqrt(2.0) * 0.5 / 1.5
    """From the rms of a deviation of the tolerance over both conditions. It is the same in all repeats: a mean is no better for them."""

    def counted(self, size: float, other: float, repeats: int, off: float = OFF) -> FloatArray:
        """So large a change in the conditions, whitened."""
        made = np.repeat([size, other], ROWS) / math.hypot(self.FLOOR, math.sqrt(repeats) * off) * math.sqrt(repeats / DEPENDENCE)
        made[np.arange(2 * ROWS) % ROWS < BEGINNING] = 0.0
        return made

    @pytest.mark.parametrize("repeats", [2, 18])
    def test_a_signature_is_the_change_over_the_floor_times_the_root_of_what_the_repeats_are_worth(self, repeats: int) -> None:
        found = self.evidence(repeats)
        assert found.signature([still(5.0), still(-3.0)]) == pytest.approx(self.counted(5.0, -3.0, repeats), rel=RIDGE)
        means = found.mean_signature([[still(4.0), still(6.0)], [still(-3.0), still(-3.0)]])
        assert means == pytest.approx(self.counted(5.0, -3.0, repeats), rel=RIDGE)
        assert found.signature([still(5.0), None]) is None
        assert found.mean_signature([None, [still()]]) is None

    def test_sensitivities_are_per_prior_scale_and_nuisances_per_deviation_whatever_they_were_simulated_at(self) -> None:
        found = self.evidence()
        assert slopes(found)[P] == pytest.approx(self.counted(8.0 * 0.1 / 4.0, -8.0 * 0.1 / 4.0, 2), rel=RIDGE)
        assert slopes(found)[Q] == pytest.approx(self.counted(2.0, 2.0, 2), rel=RIDGE)
        assert slopes(found).keys() == {P, Q}
        column = found.space.nuisances.toarray()[:, found.space.names.index(CALIBRATED)]
        assert column == pytest.approx(self.counted(6.0 * 0.5 / 1.5, 0.0, 2), rel=RIDGE)

    @pytest.mark.parametrize(("given", "apart"), [((4.0, 4.0), False), ((4.0, 5.0), True), ((4.0, None), False)])
    def test_a_number_that_conditions_are_given_anew_is_off_in_each_by_itself(self, given: tuple[float, float | None], apart: bool) -> None:
        """None: that condition has no such number."""
        laboratory = Calculated(lambda *_: None, ROWS, CHANNELS[:1], 2)
        has = [frozenset([P]) if value is None else frozenset([P, CALIBRATED]) for value in given]
        of = [{} if value is None else {CALIBRATED: value} for value in given]
        made = zip(laboratory.conditions, has, of, strict=True)
        laboratory.conditions = [replace(c, settable=names, nominal=values) for c, names, values in made]
        names, groups = [c.name for c in laboratory.conditions], [[still()] * 2] * 2
        changes = {P: [still(8.0), still(8.0)], CALIBRATED: [still(6.0), still(3.0)]}
        found = gather(laboratory, names, groups, [[still()]] * 2, changes, {P: 4.0, CALIBRATED: 1.5}, {P: 0.1}, {CALIBRATED: 0.5}).space
        anew = (CALIBRATED[0], CALIBRATED[1] + ANEW)
        columns = found.nuisances.toarray()[:, [name in (CALIBRATED, anew) for name in found.names]]
        first = np.arange(2 * ROWS) < ROWS
        if not apart:
            assert anew not in found.names
            assert columns.shape[1] == 1
        else:
            assert CALIBRATED not in found.names
            assert columns.shape[1] == 2
            assert not columns[first, 1].any()
            assert not columns[~first, 0].any()
        seen = columns.sum(axis=1)[BEGINNING:ROWS], columns.sum(axis=1)[ROWS + BEGINNING :]
        assert seen[0] == pytest.approx(2.0 * seen[1], rel=RIDGE)
        assert seen[1].all()

    def test_the_residual_is_measured_minus_nominal_and_its_blocks_are_the_conditions(self) -> None:
        changes = {P: [still(6.0 / math.sqrt(2.0))] * 2}
        groups = [[still(3.0), still(5.0)], [still(1.0)] * 2]  # apart by 2: of 1 about their mean in one of two conditions
        found = gathered(groups, [[still(1.0)], [still(2.0)]], changes, {P: 1.0}, {P: 1.0}, {})
        w = found.whitening
        steady = 1.0 - float(w.coefficients.sum())
        expected = np.repeat([3.0, -1.0], ROWS) * steady / float(w.factor[0, 0]) * math.sqrt(2.0 / DEPENDENCE)
        expected[np.arange(2 * ROWS) % ROWS < BEGINNING] = 0.0
        assert found.space.y == pytest.approx(expected, rel=1e3 * ROUNDOFF)
        assert found.space.blocks == {"condition 0": slice(0, ROWS), "condition 1": slice(ROWS, 2 * ROWS)}

    def test_channels_that_nothing_changes_are_left_out_and_without_any_there_is_nothing_to_diagnose(self) -> None:
        change = still(1.0, 3)
        change[:, 1] = 0.0
        groups, nominals = [[still(0.0, 3)] * 2], [[still(0.0, 3)]]
        found = gathered(groups, nominals, {P: [change]}, {P: 1.0}, {P: 1.0}, {})
        assert found.active.tolist() == [True, False, True]
        assert found.space.y.size == 2 * ROWS
        with pytest.raises(DataError, match="nothing to diagnose"):
            gathered(groups, nominals, {P: [0.0 * change]}, {P: 1.0}, {P: 1.0}, {})

    @pytest.mark.parametrize(("decimation", "repeats", "guess"), [(1, 1, 1.0 + GUESSED), (4, 1, 1.0 + 4.0 * GUESSED), (4, 2, 1.0)])
    def test_slow_noise_is_as_large_in_means_over_steps_and_white_noise_is_not(self, decimation: int, repeats: int, guess: float) -> None:
        runs = [[still(float(k)) for k in range(repeats)]]
        found = gathered(runs, [[still()]], {P: [still(1.0)]}, {P: 1.0}, {P: 1.0}, {}, decimation)
        assert (found.guess, found.whitening.guessed) == (guess, repeats == 1)
        assert found.noise == pytest.approx(guess * float(found.expected.sum()), rel=ROUNDOFF)

    def beside(self, runs: FloatArray, **condition: object) -> Evidence:
        """One run of zeros, beside measured runs [runs, samples] of another condition; those have 100 in common."""
        laboratory = Calculated(lambda *_: None, ROWS, CHANNELS[:1], 2)
        first, second = laboratory.conditions
        made = tuple(Run(Path(f"run{k}"), first.grid, {CHANNELS[0]: 100.0 + x}, {}, {}) for k, x in enumerate(runs))
        laboratory.conditions = [first, replace(second, runs=made, **condition)]  # type: ignore[arg-type]
        return gather(laboratory, [first.name], [[still()]], [[still()]], {P: [still(1.0)]}, {P: 1.0}, {P: 1.0}, {})

    @pytest.mark.parametrize("held_out", [True, False])
    def test_held_out_repeats_say_what_noise_is(self, held_out: bool) -> None:
        """Two of a condition that is not diagnosed: their scatter is noise, whatever they have in common."""
        found = self.beside(0.5 * np.random.default_rng(8).normal(size=(2, ROWS)), held_out=held_out)
        assert found.whitening.guessed is not held_out
        assert found.whitening.deviation[0] == pytest.approx(0.5 if held_out else 0.0, rel=chance(0.5 * of_variance(ROWS)))

    def test_a_single_held_out_run_says_nothing_of_noise(self) -> None:
        assert self.beside(np.random.default_rng(8).normal(size=(1, ROWS)), held_out=True).whitening.guessed

    @pytest.mark.parametrize(("name", "own"), [("condition 0", True), ("condition 1", False)])
    def test_held_out_repeats_of_a_single_run_say_what_it_has_of_its_own(self, name: str, own: bool) -> None:
        """A spell in which an axis rests a little off."""
        runs = np.random.default_rng(8).normal(size=(2, ROWS))
        runs[:, SPELL : 2 * SPELL] += np.array([[2.0], [-2.0]])
        found = self.beside(runs, name=name, held_out=True)
        assert any(word.startswith("noise ") for _, word in found.space.names) is own

    def test_the_beginning_is_at_most_a_part_of_a_short_run(self) -> None:
        rows = 50
        found = gathered([[still(1.0, rows=rows)] * 2], [[still(rows=rows)]], {P: [still(1.0, rows=rows)]}, {P: 1.0}, {P: 1.0}, {})
        assert SETTLING * rows < BEGINNING
        assert np.flatnonzero(found.space.y)[0] == int(SETTLING * rows)

    def test_other_conditions_are_counted_in_the_same_units(self) -> None:
        """There no tolerance is told of, and nothing is off by one."""
        first = self.evidence()
        there = gathered([[still(7.0)] * 2], [[still()]], {P: [still(50.0)]}, {P: 1.0}, {P: 1.0}, {}, like=first)
        assert there.whitening is first.whitening
        assert there.space.y == pytest.approx(self.counted(7.0, 0.0, 2, off=0.0)[:ROWS], rel=RIDGE)

    def test_own_noise_of_single_runs_is_a_nuisance_of_its_condition_as_large_as_in_the_mean(self) -> None:
        """Repeats that are apart by an offset; a mean of n runs has 1 / n of its variance, and counts as n over DEPENDENCE."""
        apart, alike = [still(0.7), still(-0.7)], [still(), still()]
        found = gathered([alike, apart], [[still()]] * 2, {P: [still(1.0)] * 2}, {P: 1.0}, {P: 1.0}, {}, like=self.evidence())
        (_, runs) = found.residuals
        single = own_noise([runs], 1, SPELL)
        assert single.shape[1] > 0
        assert [name for _, name in found.space.names[-single.shape[1] :]] == [f"noise {i + 1}" for i in range(single.shape[1])]
        columns = found.space.nuisances.toarray()[:, -single.shape[1] :]
        assert not columns[:ROWS].any()
        assert columns[ROWS:] == pytest.approx(single / math.sqrt(DEPENDENCE), rel=ROUNDOFF)


class TestDiscrepancy:
    """Two conditions without noise, three channels of two arrays; two tolerances, of which the second alone changes the second array."""

    NAMES = ("a.x[1]", "a.x[2]", "b.z")
    FIRST, SECOND = ("a", "first"), ("b", "second")
    FLOOR = TRUST * 10.0
    """An effect of typical size changes each channel by 10: the tolerances, which change them by less, do not move the median."""

    def evidence(self, second: bool = True, repeats: int = 2) -> Evidence:
        """The first number (deviation 0.5, simulated at 1.5) changes the channels by 4, 2 and 0 per deviation, in the first condition only.

        The second one changes the third channel by 3, in the second condition only.
        """
        first = [still() + np.array([12.0, 6.0, 0.0]), still(0.0, 3)]
        changes = {P: [still(10.0, 3)] * 2, Q: [still(10.0, 3)] * 2, ("a", "r"): [still(10.0, 3)] * 2, self.FIRST: first}
        sizes, tolerances = {**dict.fromkeys(changes, 1.0), self.FIRST: 1.5}, {self.FIRST: 0.5}
        if second:
            changes[self.SECOND], sizes[self.SECOND], tolerances[self.SECOND] = (
                [still(0.0, 3), still() + np.array([0.0, 0.0, 3.0])],
                1.0,
                1.0,
            )
        laboratory = Calculated(lambda *_: None, ROWS, self.NAMES, 2)
        names = [c.name for c in laboratory.conditions]
        groups = [[still(0.0, 3)] * repeats] * 2
        scales = {P: 1.0, Q: 1.0, ("a", "r"): 1.0}
        return gather(laboratory, names, groups, [[still(0.0, 3)]] * 2, changes, sizes, scales, tolerances)

    OFF = DISCREPANCY * np.array([math.sqrt((4.0**2 + 2.0**2) / 4.0)] * 2 + [3.0 / math.sqrt(2.0)])
    """The root of the mean square of an array, over its elements and both conditions."""

    def part(self, repeats: int, off: FloatArray) -> FloatArray:
        """Variance of a whitened sample that is discrepancy, by channel."""
        return repeats * off**2 / (self.FLOOR**2 + repeats * off**2)

    @pytest.mark.parametrize("repeats", [2, 18])
    def test_it_is_that_of_the_array_in_each_of_its_elements_and_no_less_for_repeats(self, repeats: int) -> None:
        found = self.evidence(repeats=repeats)
        assert found.judged.tolist() == [True] * 3
        for sudden in found.sudden:
            assert sudden == pytest.approx(np.tile(math.sqrt(repeats) * self.OFF, (ROWS, 1)), rel=ROUNDOFF)
        expected = np.tile(self.part(repeats, self.OFF) / DEPENDENCE, 2 * ROWS)
        assert found.allowed - found.expected == pytest.approx(expected, rel=RIDGE)
        assert not found.expected.any()

    def test_an_array_that_no_tolerance_changes_has_none_and_is_not_judged(self) -> None:
        found = self.evidence(second=False)
        assert found.judged.tolist() == [True, True, False]
        assert not found.sudden[0][:, 2].any()
        assert found.level(self.left(found, (0.0, 0.0, 7.0))) == found.level(np.zeros(found.space.y.size)) < 1.0

    def left(self, found: Evidence, sizes: tuple[float, float, float]) -> FloatArray:
        """So large in a channel, of one sign and the other in turn, where samples count; what is steady takes none of it."""
        made = np.zeros((2, ROWS, 3))
        made[:, BEGINNING + 1 :] = np.where(np.arange(ROWS - BEGINNING - 1) % 2, 1.0, -1.0)[:, None] * np.array(sizes)
        assert (ROWS - BEGINNING - 1) % 2 == 0
        assert found.space.explained(made.ravel()) == pytest.approx(np.zeros(made.size), abs=ROUNDOFF)
        return made.ravel()

    @pytest.mark.parametrize("repeats", [1, 2])
    @pytest.mark.parametrize(("sizes", "worst"), [((3.0, 1.0, 2.0), "a.x[1]"), ((1.0, 1.0, 2.0), "b.z"), ((0.0, 3.0, 1.0), "a.x[2]")])
    def test_the_level_is_that_of_the_worst_channel_in_the_worst_condition(
        self, sizes: tuple[float, float, float], worst: str, repeats: int
    ) -> None:
        """Over that of noise and discrepancy; where nothing was repeated, over that with slow noise."""
        found = self.evidence(repeats=repeats)
        square = (ROWS - BEGINNING - 1) * np.array(sizes) ** 2
        guess = 1.0 + GUESSED if repeats == 1 else 1.0
        allowed = ROWS * self.part(repeats, self.OFF) / DEPENDENCE
        levels = dict(zip(self.NAMES, (square / guess + 1.0) / (allowed + 1.0), strict=True))
        assert max(levels, key=lambda name: levels[name]) == worst
        left = self.left(found, sizes)
        assert found.level(left) == pytest.approx(levels[worst], rel=RIDGE)
        first, second = found.space.blocks.values()
        left[first] *= 0.5
        assert found.level(left) == pytest.approx(levels[worst], rel=RIDGE)  # the other condition is as bad as before
        left[second] *= 0.0
        assert found.level(left) == pytest.approx(((0.25 * square / guess + 1.0) / (allowed + 1.0)).max(), rel=RIDGE)

    def test_what_a_signature_does_to_a_channel_is_that_of_this_part_alone(self) -> None:
        """Alternating in every channel: nuisances take none of it. What is steady a tolerance takes, in each channel by itself."""
        found = self.evidence()
        sizes = np.array([3.0, 1.0, 2.0])
        left = self.left(found, (3.0, 1.0, 2.0))
        allowed = ROWS * self.part(2, self.OFF) / DEPENDENCE
        levels = ((ROWS - BEGINNING - 1) * sizes**2 + 1.0) / (allowed + 1.0)
        assert found.levels(left) == pytest.approx(np.tile(levels, (2, 1)), rel=RIDGE)
        assert found.does(left) == pytest.approx(np.tile(levels, (2, 1)), rel=RIDGE)
        steady = found.space.nuisances.toarray()[:, found.space.names.index(self.FIRST)]
        does, whole = found.does(steady), float(found.space.dot(steady, steady))
        for i, block in enumerate(found.space.blocks.values()):
            for k in range(3):
                alone = np.zeros_like(steady)
                alone[block][k::3] = steady[block][k::3]
                assert does[i, k] == pytest.approx((float(found.space.dot(alone, alone)) + 1.0) / (allowed[k] + 1.0), rel=RIDGE)
        assert whole < 1.0

    def test_what_nuisances_explain_counts_what_it_costs(self) -> None:
        """A deviation of a tolerance, whose own column takes s / (1 + s) of it, s its square: <b, b> = s / (1 + s), below one."""
        found = self.evidence(second=False)
        assert FORMULATION in found.space.names  # what is steady may be the discrepancy, too: not here
        found.space = found.space.less([FORMULATION])
        column = found.space.nuisances.toarray()[:, found.space.names.index(self.FIRST)]
        square, first = float(column @ column), float(column.reshape(2, ROWS, 3)[0, :, 0] @ column.reshape(2, ROWS, 3)[0, :, 0])
        allowed = ROWS * self.part(2, self.OFF)[0] / DEPENDENCE
        assert found.level(column) == pytest.approx((first / (1.0 + square) + 1.0) / (allowed + 1.0), rel=1e2 * RIDGE)

    def test_it_goes_as_slowly_as_what_tolerances_do(self) -> None:
        """One half wave in a run has it all in that cosine, and what is faster has none, nor independent ones."""
        slow, fast = (np.cos(math.pi * k * (np.arange(200) + 0.5) / 200.0)[:, None] for k in (1, 100))
        shares = [
            evidence._spectra({self.FIRST: [x]}, {self.FIRST: 2.0}, {self.FIRST: 1.0}, np.array([0]), [(200, apart)])[0]
            for x, apart in ((slow, False), (fast, False), (slow, True))
        ]
        assert shares[0] == pytest.approx(np.eye(20)[:, 1:2], abs=RIDGE)
        assert shares[1] == pytest.approx(np.zeros((20, 1)), abs=RIDGE)
        assert not shares[2].size
        (wave,) = evidence._waves(9.0 * shares[0], np.array([1.0]), 200)
        assert wave == pytest.approx(slow * 3.0 / math.sqrt(100.0), rel=RIDGE, abs=RIDGE)


class TestLateness:
    @pytest.mark.parametrize("decimation", [1, 4])
    def test_channels_of_a_component_may_be_late_by_a_part_of_a_step(self, decimation: int) -> None:
        """The change that a shift of the signal makes: on a ramp as much everywhere; in the channels of one component at a time."""
        t = STEP * decimation * np.arange(ROWS)
        x = np.stack([3.0 * t, -0.5 * t, 2.0 * t], axis=1)
        floor = np.array([0.1, 0.2, 0.5])
        changes = {P: [np.tile(floor / TRUST, (ROWS, 1))]}
        found = gathered([[x, x]], [[x]], changes, {P: 1.0}, {P: 1.0}, {}, decimation)
        begin = math.ceil(BEGINNING / decimation)
        for component, here in (("a", [True, True, False]), ("b", [False, False, True])):
            column = found.space.nuisances.toarray()[:, found.space.names.index((LOGGING, f"lag {component}.*"))].reshape(ROWS, 3)
            shifted = np.stack([np.interp(t - LATENESS * STEP, t, channel) for channel in x.T], axis=1)
            expected = (shifted - x) * here / floor * math.sqrt(2.0 / DEPENDENCE)
            assert column[begin:] == pytest.approx(expected[begin:], rel=1e3 * RIDGE, abs=RIDGE)
            assert not column[:begin].any()

    def test_of_a_curve_it_is_the_rate_of_change(self) -> None:
        """Where the curve is not sudden; to the third derivative, by central differences over two steps."""
        t = STEP * np.arange(ROWS)
        x = np.sin(2.0 * t)[:, None]
        found = gathered([[x, x]], [[x]], {P: [still(1e3)]}, {P: 1.0}, {P: 1.0}, {})
        column = found.space.nuisances.toarray()[:, 0]
        expected = -LATENESS * STEP * 2.0 * np.cos(2.0 * t) / (TRUST * 1e3) * math.sqrt(2.0 / DEPENDENCE)
        inside = slice(BEGINNING, -1)
        # (w h)^2 / 6 of the rate, which passes zero; SUDDEN of the curvature is far below so high a floor
        assert column[inside] == pytest.approx(expected[inside], abs=(2.0 * STEP) ** 2 / 6.0 * np.abs(expected).max() * 1.01)

    @pytest.mark.parametrize(("least", "stays"), [(0.5, False), (2.0, True)])
    def test_who_is_late_by_more_than_a_late_clock_is_late_by_is_none_of_these(self, least: float, stays: bool) -> None:
        """0.8 steps late, where a clock counts as late from so many steps on; of `b` no clock is known."""
        t = STEP * np.arange(ROWS)
        x = np.stack([np.sin(3.0 * t), np.sin(2.0 * t), np.cos(2.0 * t)], axis=1)
        late = x - 0.8 * STEP * np.stack([3.0 * np.cos(3.0 * t), 2.0 * np.cos(2.0 * t), np.zeros(ROWS)], axis=1)
        clock = replace(candidate("lag a.*"), component=LOGGING, minimum=least * STEP, unit="s")
        found = gathered([[late, late]], [[x]], {P: [still(0.1, 3)]}, {P: 1.0}, {P: 1.0}, {}, clocks=[clock])
        assert ((LOGGING, "lag a.*") in found.space.names) is stays
        assert (LOGGING, "lag b.*") in found.space.names


def test_a_jump_may_come_early_or_late_and_counts_for_less_around() -> None:
    """Half a jump over the distance in samples, that is how far a sample is from a straight line over it: up to ten samples away."""
    jump, at, repeats = 5.0, 200, 3
    x = np.where(np.arange(ROWS) < at, 0.0, jump)[:, None]
    found = gathered([[x] * repeats], [[x]], {P: [still(1.0)]}, {P: 1.0}, {P: 1.0}, {})
    distance = np.abs(np.arange(ROWS) - at + 0.5) + 0.5  # 1 on both sides of the jump
    expected = SUDDEN * np.where(distance <= 10.0, 0.5 * jump / distance, 0.0) * math.sqrt(repeats)
    assert found.sudden[0][:, 0] == pytest.approx(expected, rel=ROUNDOFF, abs=EXACT)
    # a change of 1 is 50 deviations of the floor, and of what is sudden so many less
    white = found.signature([x + 1.0])
    assert white is not None
    plain = 1.0 / TRUST * math.sqrt(repeats / DEPENDENCE)
    assert white[BEGINNING:] == pytest.approx((plain / np.hypot(1.0, expected / TRUST))[BEGINNING:], rel=1e2 * RIDGE)


class TestChannelsThatAConditionLacks:
    """Two conditions, of which the second lacks the second channel."""

    SHAPE = np.sin(0.05 * np.arange(ROWS))

    def evidence(self, repeats: int = 3, noise: float = 0.1) -> Evidence:
        rng = np.random.default_rng(8)
        there = np.array([[True, True], [True, False]])
        shape = self.SHAPE[:, None] * np.array([1.0, 0.5])
        groups = [[(0.2 * shape + noise * rng.normal(size=(ROWS, 2))) * on for _ in range(repeats)] for on in there]
        laboratory = Calculated(lambda *_: None, ROWS, CHANNELS[:2], 2)
        laboratory.conditions = [
            replace(c, channels=frozenset(np.array(CHANNELS[:2])[on])) for c, on in zip(laboratory.conditions, there, strict=True)
        ]
        names = [c.name for c in laboratory.conditions]
        return gather(
            laboratory, names, groups, [[0.0 * shape]] * 2, {P: [shape * on for on in there]}, {P: 1.0}, {P: 1.0}, {}, left=groups
        )

    @pytest.mark.parametrize("repeats", [1, 3])
    def test_it_leaves_nothing_there_and_nothing_is_expected_of_it(self, repeats: int) -> None:
        found = self.evidence(repeats)
        for values in (found.space.y, found.expected, found.sensitivities[P]):
            table = values.reshape(2, ROWS, 2)
            assert np.all(table[1, :, 1] == 0.0)
            assert np.any(table[0, :, 1] != 0.0)
            assert np.any(table[1, :, 0] != 0.0)

    def test_the_floor_of_a_channel_is_that_of_the_conditions_that_have_it(self) -> None:
        """Repeats without noise leave the floor alone. Of zeros in the other condition it would be less by the root of two."""
        found = self.evidence(noise=0.0)
        floor = TRUST * 0.5 * float(np.sqrt((self.SHAPE**2).mean()))
        assert found.whitening.factor[1, 1] == pytest.approx(floor, rel=RIDGE)

    def test_the_noise_of_a_channel_is_that_of_the_conditions_that_have_it(self) -> None:
        """With the zeros of the other condition it would be less by the root of two."""
        found = self.evidence(repeats=6)
        samples = ROWS * 5
        noise = found.whitening.deviation[1]
        assert noise == pytest.approx(0.1, rel=chance(0.5 * of_variance(samples)))


class TestForm:
    """Two conditions, three channels of two arrays; P changes all of them, Q the second array only."""

    NAMES = ("a.x[1]", "a.x[2]", "b.z")
    P_DOES, Q_DOES = np.array([1.0, -2.0, 0.5]), np.array([0.0, 0.0, 3.0])

    def evidence(self, size: float = 100.0) -> Evidence:
        """Noise of 1 in each channel; an effect of one scale is so many times as large."""
        rng = np.random.default_rng(9)
        laboratory = Calculated(lambda *_: None, ROWS, self.NAMES, 2)
        groups = [[rng.normal(size=(ROWS, 3)) for _ in range(4)] for _ in range(2)]
        changes = {P: [size * np.tile(self.P_DOES, (ROWS, 1))] * 2, Q: [size * np.tile(self.Q_DOES, (ROWS, 1)), still(0.0, 3)]}
        names = [c.name for c in laboratory.conditions]
        ones = {P: 1.0, Q: 1.0}
        return gather(laboratory, names, groups, [[still(0.0, 3)]] * 2, changes, ones, ones, {})

    def parts(self, found: Evidence, does: FloatArray) -> list[FloatArray]:
        """Directly: a column of FORM times what an effect does, for each condition and array."""
        columns = []
        for block in (slice(0, 3 * ROWS), slice(3 * ROWS, 6 * ROWS)):
            for channels in ([0, 1], [2]):
                column = np.zeros((2 * ROWS, 3))
                rows = slice(block.start // 3, block.stop // 3)
                column[rows, channels] = FORM * does.reshape(-1, 3)[rows][:, channels]
                columns.append(column.ravel())
        return columns

    def test_one_column_per_condition_and_array_of_a_part_of_what_the_effect_does(self) -> None:
        found = self.evidence()
        x = np.array([0.7])
        does = found.sensitivities[P] * 0.7
        form = found.form((candidate("p"),), does, found.sensitivities[P][:, None], x)
        assert form is not None
        expected = np.stack(self.parts(found, does), axis=1)
        assert form == pytest.approx(expected, rel=RIDGE, abs=EXACT)
        assert form.sum(axis=1) == pytest.approx(FORM * does, rel=RIDGE)

    def test_of_several_effects_each_has_its_own_by_its_slopes(self) -> None:
        found = self.evidence()
        slopes, x = np.stack([found.sensitivities[P], found.sensitivities[Q]], axis=1), np.array([0.7, -2.0])
        form = found.form((candidate("p"), candidate("q")), slopes @ x, slopes, x)
        assert form is not None
        expected = [c for k in (0, 1) for c in self.parts(found, slopes[:, k] * x[k]) if c @ c > 1.0]
        assert len(expected) == 5  # Q does nothing in the second condition, and nothing to the first array
        assert form == pytest.approx(np.stack(expected, axis=1), rel=RIDGE, abs=RIDGE)

    def test_what_is_too_small_to_be_seen_has_none(self) -> None:
        """A column of less than one deviation in all changes nothing; the number of columns would grow with that of the effects."""
        found = self.evidence()
        model, slopes = (candidate("p"),), found.sensitivities[P][:, None]
        norms = [math.sqrt(float(c @ c)) for c in self.parts(found, slopes[:, 0])]
        for x, count in ((1.01 / max(norms), 2), (0.99 / max(norms), 0), (1.01 / min(norms), 4)):
            form = found.form(model, slopes[:, 0] * x, slopes, np.array([x]))
            assert (0 if form is None else form.shape[1]) == count
        assert found.form((), 0.0 * found.space.y, np.zeros((found.space.y.size, 0)), np.zeros(0)) is None


class TestIndependentSamples:
    """One run of samples that are measurements of their own, of a nominal system that jumps from one to the next."""

    NOISE, SIZE = 0.1, 4.0

    def evidence(self, order: Sequence[int] | None = None, repeats: int = 1) -> Evidence:
        rng = np.random.default_rng(5)
        order = np.arange(ROWS) if order is None else order
        shapes = rng.normal(size=(2, ROWS, 1))[:, order]
        nominal = 3.0 * rng.normal(size=(ROWS, 1))[order]
        noise = self.NOISE * rng.normal(size=(repeats, ROWS, 1))[:, order]
        laboratory = Calculated(lambda *_: None, ROWS, CHANNELS[:1])
        laboratory.conditions = [replace(c, independent=True) for c in laboratory.conditions]
        groups = [[nominal + self.SIZE * shapes[0] + x for x in noise]]
        ones = {P: 1.0, Q: 1.0}
        return gather(laboratory, ["condition 0"], groups, [[nominal]], {P: [shapes[0]], Q: [shapes[1]]}, ones, ones, {})

    @pytest.mark.parametrize("repeats", [1, 3])
    def test_n_samples_are_worth_n(self, repeats: int) -> None:
        """Information on a size: squares of its change over the variance of noise, and of the floor, in the mean."""
        found = self.evidence(repeats=repeats)
        assert found.repeats == [repeats]
        shape = np.random.default_rng(5).normal(size=(2, ROWS, 1))[0]
        expected = repeats * float((shape**2).sum()) / (self.NOISE**2 + TRUST**2)
        freedom = ROWS * max(repeats - 1, 1)
        assert float(found.space.dot(found.sensitivities[P], found.sensitivities[P])) == pytest.approx(
            expected, rel=chance(of_variance(freedom))
        )

    def test_their_order_says_nothing(self) -> None:
        order = np.random.default_rng(6).permutation(ROWS)
        one, other = self.evidence(), self.evidence(list(order))
        assert other.space.chi2 == pytest.approx(one.space.chi2, rel=1e3 * ROUNDOFF)
        assert other.space.y == pytest.approx(one.space.y[order], rel=1e3 * ROUNDOFF)

    def test_noise_is_what_all_parameters_together_leave(self) -> None:
        found = self.evidence()
        assert found.whitening.guessed
        assert found.whitening.deviation[0] == pytest.approx(self.NOISE, rel=chance(0.5 * of_variance(ROWS)))
        assert found.guess == 1.0

    def test_without_more_samples_than_parameters_noise_is_all_that_is_left(self) -> None:
        """As many parameters as samples leave nothing that noise could be told by."""
        few = 20
        rng = np.random.default_rng(7)
        laboratory = Calculated(lambda *_: None, few, CHANNELS[:1])
        laboratory.conditions = [replace(c, independent=True) for c in laboratory.conditions]
        x = rng.normal(size=(few, 1))
        changes: dict[Address, list[FloatArray]] = {("a", f"p{k}"): [rng.normal(size=(few, 1))] for k in range(few)}
        ones = dict.fromkeys(changes, 1.0)
        found = gather(laboratory, ["condition 0"], [[x]], [[0.0 * x]], changes, ones, ones, {})
        assert found.whitening.deviation[0] == pytest.approx(math.sqrt(float((x**2).mean())), rel=ROUNDOFF)
