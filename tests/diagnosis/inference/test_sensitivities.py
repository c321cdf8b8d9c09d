"""What candidates do by themselves, for effects of which the signature and its derivative are known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.diagnosis.candidates import LOGGING, Address, Candidate, Nuisance
from robomill.diagnosis.catalogue import Catalogue, Refinement
from robomill.diagnosis.experiment.simulation import FINER, Simulator, setting
from robomill.diagnosis.inference import sensitivities
from robomill.diagnosis.inference.adequacy import LEVEL, SPREAD
from robomill.diagnosis.inference.evidence import DEPENDENCE, INTERPLAY
from robomill.diagnosis.inference.sensitivities import EVENLY, NOMINAL, TOLERANCES, changed, interplay
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import STEP
from tests.diagnosis.formula import Calculated, Formula, candidate
from tests.tolerances import EXACT, ROUNDOFF

ROWS = 800
T = STEP * np.arange(ROWS)
P = ("a", "p")
NOISE = 0.01
SAME = 1e3 * ROUNDOFF
"""Relative: differences of simulations, whitened, against the formula, whitened."""
ONE, OTHER = math.sqrt(2.0) * np.sin(3.0 * T), math.sqrt(2.0) * np.sin(7.0 * T + 1.0)
"""Signals of rms 1 that have nothing to do with each other."""


class Screened:
    """Four noisy measurements, and what comes out of screening them."""

    def __init__(
        self, effect: Mapping[Address, Formula] | Formula, truth: float, *entries: Candidate, nuisances: tuple[Nuisance, ...] = ()
    ):
        self.laboratory = Calculated(effect, ROWS)  # type: ignore[arg-type]
        measured = self.laboratory.formula(0, {P: truth})
        assert measured is not None
        rng = np.random.default_rng(1)
        groups = [[measured + NOISE * rng.normal(size=(ROWS, 1)) for _ in range(4)]]
        catalogue = Catalogue(Path("made up"), entries)
        self.found = sensitivities.Sensitivities(catalogue, Simulator(self.laboratory), groups, nuisances)
        self.evidence, self.starts = self.found.evidence, self.found.starts
        self.slopes: Mapping[Address, FloatArray] = self.evidence.sensitivities

    def white(self, change: FloatArray) -> FloatArray:
        return self.evidence.whitening.apply(change[:, None], 4.0 / DEPENDENCE, self.evidence.sudden[0])


def linear(_: int, values: Mapping[Address, float]) -> FloatArray:
    """P adds to one signal, `q` to another, `calibrated` to the first, too, a tenth of it; `nothing` does nothing."""
    one = values.get(P, 0.0) + 0.1 * values.get(("a", "calibrated"), 0.0)
    return (np.cos(T) + one * ONE + values.get(("a", "q"), 0.0) * OTHER)[:, None]


class TestLinear:
    @pytest.mark.parametrize(("kind", "scale"), [("normal", 1.0), ("normal", 0.02), ("log-normal", 0.3)])
    def test_the_sensitivity_is_the_derivative_times_the_prior_scale(self, kind: str, scale: float) -> None:
        found = Screened(linear, 0.5, candidate("p", kind, scale), candidate("q", scale=5.0))
        assert found.slopes[P] == pytest.approx(found.white(scale * ONE), rel=SAME, abs=SAME)
        assert found.slopes["a", "q"] == pytest.approx(found.white(5.0 * OTHER), rel=SAME, abs=SAME)

    def test_what_is_proportional_is_not_simulated_at_more_than_a_second_size_to_see_that(self) -> None:
        found = Screened(linear, 0.5, candidate("p"))
        assert not found.starts
        assert sorted(values[0][1] for values in found.laboratory.asked if values) == [-0.5, 1.0]

    def test_a_calibrated_number_is_a_nuisance_of_one_deviation_and_the_same_as_the_parameter_that_it_is_like(self) -> None:
        calibrated = Nuisance(("a", "calibrated"), 0.2)
        found = Screened(linear, 0.5, candidate("p"), nuisances=(calibrated,))
        assert setting({calibrated.address: TOLERANCES * 0.2}) in found.laboratory.asked
        space = found.evidence.space
        column = space.nuisances.toarray()[:, space.names.index(calibrated.address)]
        assert column == pytest.approx(found.white(0.1 * 0.2 * ONE), rel=SAME, abs=SAME)
        assert space.alike[P][calibrated.address] == pytest.approx(0.1 * 0.2, rel=SAME)

    def test_what_changes_nothing_is_no_candidate(self) -> None:
        found = Screened(linear, 0.5, candidate("p"), candidate("nothing"))
        assert [c.name for c in found.found.candidates] == [candidate("p").name]


def bent(part: float, power: int = 2) -> Formula:
    """The value of one signal and a part of its square, or a higher power, of another."""

    def effect(_: int, values: Mapping[Address, float]) -> FloatArray:
        x = values.get(P, 0.0)
        return (np.cos(T) + x * ONE + part * x**power * OTHER)[:, None]

    return effect


class TestBent:
    """Per prior scale x = 1 does ONE + part OTHER; x = -1/2 does ONE - part / 2 OTHER, which is at an angle to that."""

    def test_the_other_size_is_used_where_it_fits_better(self) -> None:
        found = Screened(bent(0.5), -0.5, candidate("p"))
        assert found.slopes[P] == pytest.approx(found.white(ONE - 0.25 * OTHER), rel=SAME, abs=SAME)

    def test_and_is_not_where_it_fits_worse(self) -> None:
        found = Screened(bent(0.5), 1.0, candidate("p"))
        assert found.slopes[P] == pytest.approx(found.white(ONE + 0.5 * OTHER), rel=SAME, abs=SAME)

    @pytest.mark.parametrize(("least", "smaller"), [(0.5, math.exp(-0.8)), (0.01, 0.1)])
    def test_of_a_size_that_is_known_to_a_factor_the_other_one_is_that_smaller_or_half_way_to_none(
        self, least: float, smaller: float
    ) -> None:
        """The spread of the prior is 0.8; the root of the part of the prior scale that an effect begins to count at."""
        entry = replace(candidate("p", "log-normal", spread=0.8), minimum=least)
        found = Screened(bent(0.9, power=3), 0.3, entry)
        assert found.slopes[P] == pytest.approx(found.white(ONE + 0.9 * smaller**2 * OTHER), rel=SAME, abs=SAME)
        assert not found.starts

    def test_a_bend_that_is_small_is_none(self) -> None:
        """The cosine of ONE + 0.1 OTHER and ONE - 0.05 OTHER is 0.99: whatever fits better, the size of the prior is as good."""
        found = Screened(bent(0.1), -0.5, candidate("p"))
        assert found.slopes[P] == pytest.approx(found.white(ONE + 0.1 * OTHER), rel=SAME, abs=SAME)


def turning(_: int, values: Mapping[Address, float]) -> FloatArray:
    """Late by P."""
    return (np.cos(T) + late(values.get(P, 0.0)))[:, None]


def late(x: float) -> FloatArray:
    """The change: of two tones, so that no other lateness does the same."""
    return np.asarray(sum(np.sin(w * (T - x)) - np.sin(w * T) for w in (20.0, 7.0)))


class TestTurned:
    @pytest.mark.parametrize("truth", [0.04, 0.3])
    def test_the_fit_of_an_effect_that_turns_begins_at_the_nearest_of_many_sizes_with_its_slope_there(self, truth: float) -> None:
        """A quarter apart from each other, or even parts of the largest one; the slope is that to a neighbour."""
        scale, largest = 0.15, 1.0
        found = Screened(turning, truth, candidate("p", "log-normal", scale, largest))
        start = found.starts[P]
        size = start.x * scale
        # the sizes, a quarter apart in their logarithm
        assert abs(math.log(size / truth)) <= 0.5 * 0.25
        assert start.signature == pytest.approx(found.white(late(size)), rel=SAME, abs=SAME)
        neighbours = (size * math.exp(-0.25), size * math.exp(0.25), size - largest / EVENLY, size + largest / EVENLY)
        slopes = [found.white(late(near) - late(size)) / (near - size) * scale for near in neighbours]
        assert any(start.sensitivity == pytest.approx(slope, rel=SAME, abs=SAME) for slope in slopes)


def clocks(_: int, values: Mapping[Address, float]) -> FloatArray:
    """What is slow is late by one clock, two tones by another; by P, too."""
    slow = values.get((LOGGING, "lag slow.*"), 0.0)
    return (np.cos(0.1 * (T - slow)) + late(values.get(P, 0.0) + values.get((LOGGING, "lag fast.*"), 0.0)))[:, None]


def test_that_one_clock_is_proportional_to_its_size_says_nothing_of_another() -> None:
    """The signals of a device are its own: what moves slowly is late in proportion for long."""
    slow, fast = (
        replace(candidate(f"lag {device}.*", scale=0.1, largest=0.5), effect="clock", component=LOGGING, location=device)
        for device in ("slow", "fast")
    )
    found = Screened(clocks, 0.25, slow, fast)
    assert set(found.starts) == {(LOGGING, "lag fast.*")}
    size = found.starts[LOGGING, "lag fast.*"].x * 0.1
    assert abs(math.log(size / 0.25)) <= 0.5 * 0.25  # the sizes, a quarter apart in their logarithm


def limited(_: int, values: Mapping[Address, float]) -> FloatArray:
    """Nothing up to 3, what is beyond after that."""
    return (np.cos(T) + max(values.get(P, 0.0) - 3.0, 0.0) * ONE)[:, None]


def test_a_limit_that_its_usual_size_does_not_reach_is_simulated_at_the_largest() -> None:
    found = Screened(limited, 6.0, candidate("p", "log-normal", scale=2.0, largest=8.0))
    assert found.slopes[P] == pytest.approx(found.white((8.0 - 3.0) * 2.0 / 8.0 * ONE), rel=SAME, abs=SAME)


def on_one_side(_: int, values: Mapping[Address, float]) -> FloatArray:
    """P adds to one signal; `up` and `down` together move an axis, which stands on the lower side of its gap where it goes down."""
    way = values.get(("a", "up"), 0.0) + 0.5 * values.get(("a", "down"), 0.0)
    return (np.cos(T) + values.get(P, 0.0) * ONE + way * OTHER - 0.3 * float(way < 0.0))[:, None]


class TestInterplay:
    """What calibrated numbers do together beyond the sum of what they do alone."""

    NUMBERS = (Nuisance(("a", "up"), 0.2), Nuisance(("a", "down"), 0.1))

    def test_it_is_a_nuisance_of_each_condition_and_of_each_way_in_which_there_is_any(self) -> None:
        """All of them down, the axis goes down; alone, and up, none takes it there."""
        found = Screened(on_one_side, 0.5, candidate("p"), nuisances=self.NUMBERS)
        space = found.evidence.space
        here = [i for i, name in enumerate(space.names) if name == INTERPLAY]
        columns = space.nuisances.toarray()[:, here].T
        (gap,) = [c for c in columns if np.linalg.norm(c) > SAME * np.linalg.norm(found.slopes[P])]
        assert gap == pytest.approx(found.white(np.full(ROWS, -0.3)), rel=SAME, abs=SAME)

    def test_a_machine_on_the_other_side_of_its_gap_has_no_gap_to_explain(self) -> None:
        """Without it, the level of a machine that is within its tolerances would be that of one with an effect."""
        numbers = {("a", "up"): -0.1, ("a", "down"): -0.05}
        levels = []
        for formula in (on_one_side, lambda i, values: on_one_side(i, values) + 0.3 * float(values.get(("a", "up"), 0.0) < -0.11)):
            laboratory = Calculated(formula, ROWS)
            measured = on_one_side(0, numbers)
            rng = np.random.default_rng(1)
            groups = [[measured + NOISE * rng.normal(size=(ROWS, 1)) for _ in range(4)]]
            catalogue = Catalogue(Path("made up"), (candidate("p"),))
            found = sensitivities.Sensitivities(catalogue, Simulator(laboratory), groups, self.NUMBERS)
            levels.append(found.evidence.level(found.evidence.space.y))
        assert levels[0] < LEVEL + SPREAD
        assert levels[1] > 2.0 * LEVEL

    @pytest.mark.parametrize("fails", [-1.0, 1.0])
    def test_where_the_system_cannot_run_with_all_of_them_the_other_way_counts(self, fails: float) -> None:
        def formula(i: int, values: Mapping[Address, float]) -> FloatArray | None:
            both = fails * values.get(("a", "up"), 0.0) > 0.0 and fails * values.get(("a", "down"), 0.0) > 0.0
            return None if both else on_one_side(i, values)

        sizes = {n.address: TOLERANCES * n.scale for n in self.NUMBERS}
        simulator = Simulator(Calculated(formula, ROWS))
        nominals = [[on_one_side(0, {})]]
        changes = changed(simulator, [0], sizes, nominals)
        (left,) = interplay(simulator, [0], {n.address: n.scale for n in self.NUMBERS}, sizes, changes, nominals)
        assert left[0] == pytest.approx(np.full((ROWS, 1), -0.3 if fails > 0.0 else 0.0), abs=SAME)

    def test_what_a_finer_step_changes_is_a_nuisance_too(self) -> None:
        """Only where the catalogue says how the system is run at one; calibrated numbers are not in it."""

        def formula(_: int, values: Mapping[Address, float]) -> FloatArray:
            return (np.cos(T) + values.get(("a", "up"), 0.0) * ONE + 0.3 * values.get(FINER, 0.0) * OTHER)[:, None]

        laboratory = Calculated(formula, ROWS)
        numbers, nominals = {("a", "up"): 0.2}, [[formula(0, {})]]
        sizes = {a: TOLERANCES * s for a, s in numbers.items()}
        for refinement, finer in ((None, []), (Refinement(2), [0.3 * OTHER[:, None]])):
            laboratory.refinement = refinement
            simulator = Simulator(laboratory)
            changes = changed(simulator, [0], sizes, nominals)
            found = [way for (way,) in interplay(simulator, [0], numbers, sizes, changes, nominals)]
            assert len(found) == 2 + len(finer)
            assert np.stack(found[2:] or [np.zeros((ROWS, 1))]) == pytest.approx(np.stack(finer or [np.zeros((ROWS, 1))]), abs=SAME)
            assert np.abs(found[:2]).max() < SAME

    def test_without_calibrated_numbers_there_is_none(self) -> None:
        simulator = Simulator(Calculated(on_one_side, ROWS))
        assert interplay(simulator, [0], {}, {}, {}, [[on_one_side(0, {})]]) == []
        assert simulator.count == 0


class TestChanged:
    def formula(self, condition: int, values: Mapping[Address, float]) -> FloatArray | None:
        if values.get(("a", "impossible")) and condition == 1:
            return None
        noise = values.get(("a", "seed"), 0.0)
        return np.full((3, 1), 10.0 * condition + 2.0 * values.get(P, 0.0) * (condition == 1) + 100.0 * noise)

    def test_changes_are_against_the_first_nominal_simulation_with_the_same_noise(self) -> None:
        laboratory = Calculated(self.formula, 3, conditions=2, seeds=[("a", "seed")])
        simulator = Simulator(laboratory)
        nominals = simulator.repeated([0, 1], (), NOMINAL)
        assert [len(n or ()) for n in nominals] == [NOMINAL, NOMINAL]
        sizes = {P: 3.0, ("a", "nothing"): 1.0, ("a", "impossible"): 1.0}
        found = changed(simulator, [0, 1], sizes, [n for n in nominals if n is not None])
        assert found.keys() == {P}  # what changes nothing and what cannot run are left out
        assert [c[0, 0] for c in found[P]] == [EXACT, 6.0]
