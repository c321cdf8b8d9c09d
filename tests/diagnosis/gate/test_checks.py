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


def recorded(*columns: FloatArray) -> Run:
    """A run with one array."""
    one = measure(repeats=1, seconds=STEP)[0]
    names = [f"sensors.y[{i + 1}]" for i in range(len(columns))]
    t = STEP * np.arange(len(columns[0]))
    return replace(one, t=t, columns=dict(zip(names, columns, strict=True)), ports=dict.fromkeys(names, one.ports[CHANNEL]))


def beside(measured: list[FloatArray], simulated: list[FloatArray], noise: float = 1e-12) -> list[str]:
    """Kinds of the findings of an array beside its simulation."""
    run, n = recorded(*measured), len(measured)
    x, s = np.stack(measured, axis=1), np.stack(simulated, axis=1)
    return [f.kind for f in checks.standstill(run, x, s, list(run.columns), STEP, np.full(n, noise))]


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
