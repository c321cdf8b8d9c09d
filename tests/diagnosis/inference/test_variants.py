"""Variants: what is another one on every machine beside the size of an effect, a frequency or a law of a lag, on formulas."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from robomill.diagnosis.candidates import COS, SIN, Address, Candidate, Prior, Shape, physical
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.search import Search
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import STEP
from tests.diagnosis.formula import Calculated, Formula, candidate
from tests.tolerances import physics

ROWS = 800
T = STEP * np.arange(ROWS)
NOISE = 0.002
FORCE = np.random.default_rng(7).normal(size=ROWS)
OTHER = np.sin(7.0 * T + 1.0)
WELL = 0.03
"""Relative: what is asked of a size that 800 samples of a signal-to-noise ratio of 100 show; laws that are a little off miss by more."""
EIGHTH = 2.0 * math.sin(math.pi / 16.0)
"""Largest error of the cosine of three times a phase: the nearest of eight phases is off by a sixteenth of a turn there."""
TURN = 11.0
"""Rate of a gear's error [rad/s]."""


def shaped(plain: Candidate, *shapes: tuple[str, Sequence[float]]) -> Candidate:
    """The candidate with a variant for each value, or each pair of values, of these parameters."""
    made = tuple(Shape(name, name, "1", tuple(values), math.log(values[-1] / values[0]) / (len(values) - 1)) for name, values in shapes)
    base = replace(plain, shapes=made)
    grid = np.stack(np.meshgrid(*(s.values for s in made), indexing="ij"), axis=-1).reshape(-1, len(made))
    return replace(base, variants=tuple(base.with_shapes([float(v) for v in row]) for row in grid))


class Found:
    """What is found in four noisy measurements of what `formula` does with `truth`."""

    def __init__(self, formula: Formula, truth: Mapping[Address, float], *entries: Candidate) -> None:
        self.laboratory = Calculated(lambda i, changes: formula(i, physical(changes)), ROWS)
        clean = formula(0, truth)
        assert clean is not None
        rng = np.random.default_rng(1)
        groups = [[clean + NOISE * rng.normal(size=clean.shape) for _ in range(4)]]
        self.search = Search(Catalogue(Path("made up"), entries), Simulator(self.laboratory), groups, ())
        self.fits = self.search.run()

    @property
    def best(self) -> Fit:
        return max(self.fits, key=lambda f: f.log_evidence)


def mode(_: int, values: Mapping[Address, float]) -> FloatArray:
    """A mode of 9 Hz and 2 % under a random force, if nothing else is said, and another signal."""
    omega = 2.0 * math.pi * values.get(("a", "frequency"), 9.0)
    zeta = values.get(("a", "damping"), 0.02)
    decay, damped = math.exp(-zeta * omega * STEP), omega * math.sqrt(1.0 - zeta * zeta)
    swing = lfilter([0.0, decay * math.sin(damped * STEP)], [1.0, -2.0 * decay * math.cos(damped * STEP), decay * decay], FORCE)
    return (np.cos(T) + values.get(("a", "mode"), 0.0) * swing + values.get(("a", "other"), 0.0) * OTHER)[:, None]


MODE = shaped(candidate("mode", "log-normal", 0.1), ("frequency", (5.0, 7.8, 12.2, 19.2, 30.0)), ("damping", (0.02, 0.08)))
MADE_OTHERWISE = {("a", "mode"): 0.15, ("a", "frequency"): 13.0, ("a", "damping"): 0.05}


def test_a_mode_of_another_frequency_and_damping_is_found_by_the_grid() -> None:
    found = Found(mode, MADE_OTHERWISE, MODE, candidate("other"))
    assert [c.name for c in found.best.model][:1] == ["mode @ place"]
    assert dict(found.best.model[0].fixed)["a", "frequency"] == 12.2
    plain = Found(mode, MADE_OTHERWISE, replace(MODE, variants=(), shapes=()), candidate("other"))
    closed = [1.0 - f.best.chi2 / f.search.evidence.space.chi2 for f in (plain, found)]
    assert closed[1] > 2.0 * closed[0]


def test_the_mode_of_the_nominal_system_needs_no_variant() -> None:
    found = Found(mode, {("a", "mode"): 0.15}, MODE, candidate("other"))
    assert [(c.name, c.fixed) for c in found.best.model] == [("mode @ place", ())]
    assert found.best.values["a", "mode"] == pytest.approx(0.15, abs=physics(0.15, WELL))


def late(_: int, values: Mapping[Address, float]) -> FloatArray:
    """A signal that a part of a lag makes late by its dead time, the rest of it by a first-order filter."""
    lag, first = values.get(("a", "lag"), 0.0), values.get(("a", "first"), 0.0)
    signal = np.sin(3.0 * T + 0.8 * T * T)
    signal = np.interp(T - lag * (1.0 - first), T, signal)
    decay = math.exp(-STEP / (lag * first)) if lag * first > 0.0 else 0.0
    return np.asarray(lfilter([1.0 - decay], [1.0, -decay], signal))[:, None]


LAG = shaped(candidate("lag", "log-normal", 0.05, 0.4), ("first", (0.5, 1.0)))


@pytest.mark.parametrize(("first", "fixed"), [(0.0, ()), (0.5, (0.5,)), (1.0, (1.0,))])
def test_a_dead_time_is_told_from_a_lag_of_first_order(first: float, fixed: tuple[float, ...]) -> None:
    found = Found(late, {("a", "lag"): 0.06, ("a", "first"): first}, LAG)
    assert [c.name for c in found.best.model] == ["lag @ place"]
    assert tuple(v for _, v in found.best.model[0].fixed) == fixed
    assert found.best.values[found.best.model[0].addresses[0]] == pytest.approx(0.06, abs=physics(0.06, WELL))


def wavy(_: int, values: Mapping[Address, float]) -> FloatArray:
    """The error of a gear, in um, and another signal."""
    wave = 1e6 * values.get(("a", "error"), 0.0) * np.sin(TURN * T + values.get(("a", "phase"), 0.0))
    return (np.cos(T) + 0.01 * wave + values.get(("a", "other"), 0.0) * OTHER)[:, None]


@pytest.mark.parametrize("phase", [0.0, 0.7, 2.2, -1.6])
def test_an_error_of_a_gear_is_found_whatever_its_phase(phase: float) -> None:
    parts = (f"error{COS}phase", f"error{SIN}phase")
    error = Candidate("error", "a", "gear", parts, 7.8e-6, 1e-3, Prior("normal", 3.5e-5), "rad", both_signs=True, locations=1)
    found = Found(wavy, {("a", "error"): 40e-6, ("a", "phase"): phase}, error, candidate("other"))
    assert [c.name for c in found.best.model] == ["error @ gear"]
    values = physical(found.best.values)
    assert values["a", "error"] == pytest.approx(40e-6, abs=physics(40e-6, WELL))
    assert values["a", "phase"] == pytest.approx(phase, abs=physics(1.0, WELL))


def blurred(_: int, values: Mapping[Address, float], alike: float = 1.0) -> FloatArray:
    """A cutter that runs out, of three teeth, in means over whole turns: more where teeth miss the chip, which depends on their angle."""
    runout, angle = values.get(("a", "runout"), 0.0), values.get(("a", "angle"), 0.0)
    missed = runout**1.5 * (alike * ONE + 0.5 * math.cos(3.0 * angle) * TWO)
    return (np.cos(T) + missed + values.get(("a", "other"), 0.0) * OTHER)[:, None]


PARTS = (f"runout{COS}angle", f"runout{SIN}angle")
RUNOUT = Candidate("runout", "a", "cutter", PARTS, 1e-3, 10.0, Prior("log-normal", 0.2, 0.7), "m", both_signs=True, locations=1)
ONE, TWO = (T > 2.0) * (T < 5.0) * 1.0, (T > 4.0) * (T < 6.0) * 1.0


@pytest.mark.parametrize("angle", [0.0, 0.26, 1.05, -2.3])
def test_of_what_does_not_turn_with_its_phase_the_amplitude_is_fitted_at_several_phases(angle: float) -> None:
    """The nearest of eight phases within the pitch of three teeth is off by 7.5 degrees at most: 22.5 degrees of the wave."""
    found = Found(blurred, {("a", "runout"): 0.5, ("a", "angle"): angle}, RUNOUT, candidate("other"))
    assert [c.name for c in found.best.model] == ["runout @ cutter"]
    values = physical(found.best.values)
    assert values["a", "runout"] == pytest.approx(0.5, abs=physics(0.5, WELL))
    there = math.cos(3.0 * values.get(("a", "angle"), 0.0))
    assert there == pytest.approx(math.cos(3.0 * angle), abs=physics(1.0, EIGHTH))


def test_what_turns_three_times_as_fast_as_its_phase_is_no_sum_of_two_parts() -> None:
    """Half a turn on it has the other sign, as a sum has; an eighth of a turn on it is no mean of both parts."""
    found = Found(partial(blurred, alike=0.0), {("a", "runout"): 0.5, ("a", "angle"): 0.1}, RUNOUT, candidate("other"))
    assert {len(c.parameters) for c in found.search.candidates if c.effect == "runout"} == {1}


def test_variants_that_do_the_same_change_neither_candidates_nor_odds() -> None:
    plain = candidate("mode", "log-normal", 0.1)
    idle = shaped(plain, ("nothing", (1.0, 2.0, 3.0)))
    without, beside = (Found(mode, {("a", "mode"): 0.15}, c, candidate("other")) for c in (plain, idle))
    assert beside.search.candidates == without.search.candidates
    assert [c.locations for c in beside.search.candidates] == [1, 1]
    assert [(f.name, f.log_evidence) for f in beside.fits] == [(f.name, f.log_evidence) for f in without.fits]


def test_variants_that_differ_share_the_prior_of_their_effect() -> None:
    found = Found(mode, {("a", "mode"): 0.15}, MODE, candidate("other"))
    count = {c.locations for c in found.search.candidates if c.effect == "mode"}
    assert count == {sum(c.effect == "mode" for c in found.search.candidates)}
    assert min(count) > 1


def test_of_what_cannot_be_seen_no_variant_is_simulated() -> None:
    faint = replace(MODE, maximum=1e-4, minimum=1e-5, prior=Prior("log-normal", 5e-5))
    found = Found(mode, {("a", "other"): 0.1}, faint, candidate("other"))
    assert not any("frequency" in p for changes in found.laboratory.asked for (_, p), _ in changes)
    assert [c.name for c in found.best.model] == ["other @ place"]
