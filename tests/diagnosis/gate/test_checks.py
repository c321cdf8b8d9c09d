"""What the gate finds begins where its constants say: not well below them, but before twice as much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.gate import checks
from robomill.diagnosis.gate.checks import Finding
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import measure

STEP = 0.01
CHANNEL = "sensors.y[1]"
T = STEP * np.arange(1000)
SINE = np.sin(2.0 * np.pi * T)
A_SAMPLE = 1.01 * STEP
"""A standstill may have one sample more or less at its end; round-off beside that."""


def recorded(*columns: FloatArray) -> Run:
    """A run with one array."""
    one = measure(repeats=1, seconds=STEP)[0]
    names = [f"sensors.y[{i + 1}]" for i in range(len(columns))]
    t = STEP * np.arange(len(columns[0]))
    return replace(one, t=t, columns=dict(zip(names, columns, strict=True)), ports=dict.fromkeys(names, one.ports[CHANNEL]))


def beside(measured: list[FloatArray], simulated: list[FloatArray], noise: float = 1e-12) -> list[str]:
    """Kinds of the findings of an array beside its simulation."""
    return [f.kind for f in findings(measured, simulated, noise)]


def findings(measured: list[FloatArray], simulated: list[FloatArray], noise: float = 1e-12) -> list[Finding]:
    """Findings of an array beside its simulation."""
    run, n = recorded(*measured), len(measured)
    x, s = np.stack(measured, axis=1), np.stack(simulated, axis=1)
    return checks.standstill(run, x, s, list(run.columns), STEP, np.full(n, noise))


def spikes(*repeats: FloatArray) -> list[Finding]:
    return checks.spikes(Condition("", {}, tuple(map(recorded, repeats)), T), [CHANNEL])


class TestByItself:
    @pytest.mark.parametrize(("missing", "fatal"), [(8, False), (15, True)])
    def test_a_hundredth_of_the_samples_may_be_missing(self, missing: int, fatal: bool) -> None:
        x = SINE.copy()
        x[100 : 100 + missing] = np.nan
        found = checks.raw(recorded(x), [CHANNEL], {}, STEP)
        assert [(f.kind, f.fatal) for f in found] == [("missing", fatal)]  # MISSING

    @pytest.mark.parametrize(("beyond", "kinds"), [(1.5e-7, []), (3e-7, ["range"])])
    def test_a_value_may_be_beyond_its_bounds_by_the_rounding_of_single_precision(self, beyond: float, kinds: list[str]) -> None:
        for bounds in ((None, 3.0), (-3.0, None)):
            sign = 1.0 if bounds[0] is None else -1.0
            found = checks.raw(recorded(3.0 * sign * (1.0 + beyond) * np.abs(SINE)), [CHANNEL], {CHANNEL: bounds}, STEP)
            assert [f.kind for f in found] == kinds  # SINGLE


class TestLimit:
    """A limit is met again, at a value that is never exceeded; what is broken keeps the value that it had."""

    def test_rest_at_one_extreme_again_and_again_is_a_limit_whatever_the_simulation_does(self) -> None:
        for clipped in (np.minimum(SINE, 0.3), np.maximum(SINE, -0.3), np.clip(SINE, -0.3, 0.3)):
            assert beside([clipped], [0.2 * np.cos(2.0 * np.pi * T)]) == []
            assert checks.stopped(np.where(T > 5.0, clipped, 0.1 * SINE), np.sin(T), STEP, 1e-12) == 0.0

    def test_what_rests_once_or_within_its_range_is_broken(self) -> None:
        once = np.where(T > 6.25, 1.0, SINE)
        within = np.where((T % 4.0 > 1.125) & (T % 4.0 < 3.125), SINE[112], SINE)  # again and again, but other values are larger
        for stuck in (once, within):
            assert beside([stuck], [0.2 * np.cos(2.0 * np.pi * T)]) == ["constant"]
            assert checks.stopped(stuck, np.sin(T), STEP, 1e-12) > 1.9


class TestLimitOfSeveralRuns:
    """A channel that is met at one value in several runs, stays there, and is elsewhere in others."""

    HELD = np.minimum(T, 3.0)
    """As a push that goes on until the end: the limit is met once."""

    def test_one_value_in_several_runs_that_is_never_exceeded_is_a_limit(self) -> None:
        low, high = checks.limits_of([self.HELD, self.HELD, np.full(1000, 3.0), 2.0 * SINE])
        assert (np.isnan(low), high) == (True, 3.0)
        assert checks.limits_of([-self.HELD, -self.HELD, SINE])[0] == -3.0

    @pytest.mark.parametrize(
        "runs",
        [
            [HELD, 1.001 * HELD, SINE],  # each has its own
            [HELD, SINE, SINE],  # one run only
            [HELD, HELD, 4.0 * SINE],  # exceeded
            [np.full(1000, 3.0), np.full(1000, 3.0)],  # it never moves
            [3.0 - HELD, 3.0 - HELD, 1.0 + SINE],  # zero is what is not connected
        ],
    )
    def test_all_else_is_none(self, runs: list[FloatArray]) -> None:
        assert np.all(np.isnan(checks.limits_of(runs)))

    def beside(self, measured: list[FloatArray], limits: tuple[float, float], noise: float = 1e-12) -> list[str]:
        """As `beside` of the module, with limits of the first channel; its simulation moves, and not as far."""
        run, x = recorded(*measured), np.stack(measured, axis=1)
        s = np.stack([0.2 * SINE] * len(measured), axis=1)
        found = checks.standstill(run, x, s, list(run.columns), STEP, np.full(len(measured), noise), {CHANNEL: limits})
        return [f.channel for f in found]

    def test_what_rests_at_its_limit_is_not_broken_nor_what_its_component_makes_of_that(self) -> None:
        made_of_it = 0.5 * self.HELD + 0.25
        none = (np.nan, np.nan)
        assert self.beside([self.HELD, made_of_it], none) == [CHANNEL, "sensors.y[2]"]
        assert self.beside([self.HELD, made_of_it], (np.nan, 3.0)) == []
        assert self.beside([np.full(1000, 3.0), np.full(1000, 2.0)], (np.nan, 3.0)) == []
        assert checks.stopped(self.HELD, T, STEP, 1e-12) == pytest.approx(7.0, abs=A_SAMPLE)
        assert checks.stopped(self.HELD, T, STEP, 1e-12, (np.nan, 3.0)) == 0.0

    @pytest.mark.parametrize(("factor", "noted"), [(1.0, True), (0.3, False)])
    def test_a_limit_beyond_which_the_simulation_goes_is_noted(self, factor: float, noted: bool) -> None:
        run = recorded(self.HELD)
        limits = {CHANNEL: (np.nan, 3.0)}
        found = checks.standstill(run, self.HELD[:, None], factor * T[:, None], [CHANNEL], STEP, np.array([1e-12]), limits)
        assert [(f.kind, f.fatal) for f in found] == ([(checks.LIMITED, False)] if noted else [])
        assert all(f.text.startswith("stays at 3 ") and f.value == pytest.approx(7.0, abs=A_SAMPLE) for f in found)

    def test_what_stands_still_before_the_limit_is_met_is_broken(self) -> None:
        assert self.beside([self.HELD, np.minimum(T, 1.0)], (np.nan, 3.0)) == ["sensors.y[2]"]

    def test_a_channel_that_rests_where_its_simulation_does_says_nothing_of_others(self) -> None:
        """A motor at the end of its way is where it should be, and its encoder does not excuse another one."""
        broken = np.minimum(T, 1.0)
        run, x = recorded(self.HELD, broken), np.stack([self.HELD, broken], axis=1)
        for s in (self.HELD, 0.2 * SINE):
            beside = np.stack([s, 0.2 * SINE], axis=1)
            found = checks.standstill(run, x, beside, list(run.columns), STEP, np.full(2, 1e-3), {CHANNEL: (np.nan, 3.0)})
            still = {f.channel: f.value for f in found}
            assert still == {"sensors.y[2]": pytest.approx(9.0 if s is self.HELD else 2.0, abs=A_SAMPLE)}


class TestSpikes:
    """On a ramp that goes up and down by 1 per sample, so that this is what is usual."""

    RAMP = np.abs(np.arange(1000.0) - 500.0)

    def spiked(self, size: float, *places: int) -> FloatArray:
        x = self.RAMP.copy()
        x[[*places]] += size
        return x

    @pytest.mark.parametrize(("size", "count"), [(25.0, 0), (45.0, 1)])
    def test_a_spike_is_thirty_times_what_is_usual(self, size: float, count: int) -> None:
        assert len(spikes(self.spiked(size, 100))) == count  # SPIKE

    def test_more_than_three_spikes_make_a_bad_log(self) -> None:
        assert [f.fatal for f in spikes(self.spiked(100.0, 100, 200, 300))] == [False]
        assert [f.fatal for f in spikes(self.spiked(100.0, 100, 200, 300, 400))] == [True]  # FEW_SPIKES

    @pytest.mark.parametrize(("size", "count"), [(20.0, 1), (40.0, 0)])
    def test_a_jump_that_others_have_at_a_quarter_of_its_size_is_the_machine(self, size: float, count: int) -> None:
        other = self.spiked(size, 100)
        assert len(spikes(self.spiked(100.0, 100), other, other)) == count  # AGAIN

    @pytest.mark.parametrize(("later", "count"), [(20, 0), (40, 1)])
    def test_what_others_do_a_little_later_is_the_same(self, later: int, count: int) -> None:
        other = self.spiked(100.0, 100 + later)
        assert len(spikes(self.spiked(100.0, 100), other, other)) == count  # NEAR

    def test_usual_is_what_a_channel_does_that_rests_for_most_of_a_run(self) -> None:
        moving = np.where(np.arange(1000) < 80, np.arange(1000.0), 80.0)
        assert spikes(np.where(np.arange(1000) == 40, moving + 20.0, moving)) == []  # PART

    @pytest.mark.parametrize(("size", "count"), [(20e-9, 0), (45e-9, 1)])
    def test_what_a_channel_at_rest_does_is_over_round_off(self, size: float, count: int) -> None:
        assert len(spikes(np.where(np.arange(1000) == 40, size, 0.0))) == count  # UNMOVED

    def test_one_sample_is_no_spike(self) -> None:
        assert spikes(np.ones(1)) == []


class TestBesideTheSimulation:
    @pytest.mark.parametrize(("way", "kinds"), [(0.7e-9, []), (1.5e-9, ["constant"])])
    def test_a_channel_may_rest_where_the_simulation_moves_by_round_off(self, way: float, kinds: list[str]) -> None:
        assert beside([np.zeros(1000)], [0.5 * way * SINE]) == kinds  # UNMOVED

    @pytest.mark.parametrize(("way", "kinds"), [(15.0, []), (30.0, ["constant"])])
    def test_a_channel_may_rest_where_the_simulation_moves_within_noise(self, way: float, kinds: list[str]) -> None:
        simulated = 0.5 * way * SINE
        assert beside([np.zeros(1000)], [simulated], noise=1.0) == kinds  # MOVED
        assert (checks.stopped(np.zeros(1000), simulated, STEP, 1.0) > 0.0) is bool(kinds)

    def creeping(self, rate: float, rest: int, still: int) -> list[str]:
        """The simulation goes from 1 to 2, creeps for 400 samples of which it rests for some, goes to 3; the channel stands still there."""
        speed = np.full(1000, 1.0 / 300.0)
        speed[300:700] = rate
        speed[300 : 300 + rest] = 0.0
        simulated = 1.0 + np.cumsum(speed)
        measured = simulated.copy()
        measured[300 : 300 + still] = simulated[300]
        return beside([measured], [simulated])

    def sticking(self, held: range, *, quantised: bool = True, jump: bool = False) -> FloatArray:
        """An angle that rises and falls, in steps of an encoder; it stands still for a while, and moves on from there, or jumps back."""
        n = np.arange(1000)
        way = np.abs((n + 250) % 1000 - 500.0) / 500.0
        x = way.copy()
        x[held.start :] = np.concatenate([np.full(len(held), way[held.start]), way[held.start : 1000 - len(held)]])
        if jump:
            x = np.where(np.isin(n, held), way[held.start], way)
        return np.round(x * 200.0) / 200.0 if quantised else x

    @pytest.mark.parametrize(("jump", "quantised", "fatal"), [(False, True, False), (True, True, True), (False, False, True)])
    def test_what_sticks_moves_on_from_there_and_stands_elsewhere_too(self, jump: bool, quantised: bool, fatal: bool) -> None:
        measured = self.sticking(range(400, 520), quantised=quantised, jump=jump)
        simulated = self.sticking(range(400, 400), quantised=False)
        (finding,) = findings([measured], [simulated])
        assert finding.fatal is fatal
        assert finding.text.endswith("as its simulation; " + ("record it anew" if fatal else "it moves on from there, as what sticks does"))
        assert (checks.stopped(measured, simulated, STEP, 0.0) > 0.0) is fatal

    def test_what_stands_still_to_the_end_is_not_known_to_move_on(self) -> None:
        (finding,) = findings([self.sticking(range(700, 1000))], [self.sticking(range(400, 400), quantised=False)])
        assert finding.fatal

    @pytest.mark.parametrize(("creeps", "quantised", "fatal"), [(0.05, True, False), (0.15, True, True), (0.05, False, True)])
    def test_what_ends_near_its_simulation_may_stick_there(self, creeps: float, quantised: bool, fatal: bool) -> None:
        """A step that settles: the simulation creeps on by a part of its range, and the log is at rest."""
        n = np.arange(1000)
        simulated = np.interp(n, [0, 450, 600, 1000], [0.0, 1.0, 0.7, 0.7 + creeps])
        measured = np.where(n < 600, simulated, 0.7)
        if quantised:
            measured = np.round(measured * 200.0) / 200.0
        (finding,) = findings([measured], [simulated])
        assert finding.fatal is fatal  # LIMIT
        assert finding.text.endswith("record it anew" if fatal else "it ends there, near its simulation, as what sticks does")

    def test_a_channel_may_stand_still_three_times_as_long_as_its_simulation_and_ten_samples(self) -> None:
        assert self.creeping(1e-4, 99, 308) == []  # with the sample before, the simulation rests for 100
        assert self.creeping(1e-4, 99, 315) == ["constant"]  # LONGER, LONGER_BY

    @pytest.mark.parametrize(("places", "kinds"), [(1.4, []), (3.0, ["constant"])])
    def test_a_simulation_that_creeps_by_less_than_single_precision_tells_rests(self, places: float, kinds: list[str]) -> None:
        assert self.creeping(places * 2.0**-23 * 3.0, 0, 300) == kinds  # SINGLE

    @pytest.mark.parametrize(("back", "kinds"), [(0.07, []), (0.15, ["constant"])])
    def test_a_channel_may_stay_at_its_limit_where_the_simulation_is_a_little_short_of_it(self, back: float, kinds: list[str]) -> None:
        n = np.arange(1000) / 500.0
        simulated = np.where(n < 1.0, n, 1.0 - back * (n - 1.0))
        assert beside([np.minimum(n, 1.0)], [simulated]) == kinds  # LIMIT


def test_a_log_in_single_precision_may_stand_still_where_its_simulation_creeps_by_less_than_that() -> None:
    """An axis at 2.26 rad goes to and fro by 1.3 urad, and then creeps by 0.3 urad, of which single precision shows nothing."""
    s = 2.26 + 1.3e-6 * np.interp(T, [0.0, 1.0, 2.0], [0.0, 1.0, 0.5]) + 3e-7 * np.clip((T - 2.0) / 8.0, 0.0, 1.0)
    x = np.where(T < 2.0, s, s[200])
    assert beside([x], [s]) == []
    far = s + 1e-5 * np.clip(T - 2.0, 0.0, None)  # so far that single precision would show it
    assert beside([x], [far]) == ["constant"]
