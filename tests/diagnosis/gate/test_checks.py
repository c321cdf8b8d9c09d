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
SINE, COSINE, OTHER = np.sin(2.0 * np.pi * T), np.cos(2.0 * np.pi * T), np.sin(6.0 * np.pi * T)
"""Over ten whole periods: orthogonal, mean square 1/2."""


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
    return [f.kind for f in checks.against_simulation(run, x, s, list(run.columns), STEP, np.full(n, noise))]


def spikes(*repeats: FloatArray) -> list[Finding]:
    return checks.spikes(Condition("", {}, tuple(map(recorded, repeats)), T), [CHANNEL])


def turned(angle: float, u: FloatArray, v: FloatArray, w: FloatArray) -> list[FloatArray]:
    """A vector in a frame that is turned about its third axis."""
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    return [c * u - s * v, s * u + c * v, w]


class TestByItself:
    @pytest.mark.parametrize(("missing", "fatal"), [(8, False), (15, True)])
    def test_a_hundredth_of_the_samples_may_be_missing(self, missing: int, fatal: bool) -> None:
        x = SINE.copy()
        x[100 : 100 + missing] = np.nan
        found = checks.raw(recorded(x), [CHANNEL], {}, STEP)
        assert [(f.kind, f.fatal) for f in found] == [("missing", fatal)]  # MISSING

    @pytest.mark.parametrize(("beyond", "kinds"), [(0.7e-9, []), (1.5e-9, ["range"])])
    def test_a_value_may_be_beyond_its_bounds_by_rounding(self, beyond: float, kinds: list[str]) -> None:
        for bounds in ((None, 3.0), (-3.0, None)):
            sign = 1.0 if bounds[0] is None else -1.0
            found = checks.raw(recorded(3.0 * sign * (1.0 + beyond) * np.abs(SINE)), [CHANNEL], {CHANNEL: bounds}, STEP)
            assert [f.kind for f in found] == kinds  # ROUNDED


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
        assert spikes(np.where(np.arange(1000) == 40, moving + 20.0, moving)) == []  # USUAL

    @pytest.mark.parametrize(("size", "count"), [(20e-12, 0), (45e-12, 1)])
    def test_what_a_channel_at_rest_does_is_over_round_off(self, size: float, count: int) -> None:
        assert len(spikes(np.where(np.arange(1000) == 40, size, 0.0))) == count  # FLAT

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

    @pytest.mark.parametrize(("amplitude", "kinds"), [(6.0, []), (8.5, ["sign"])])
    def test_a_sign_can_be_told_of_five_times_the_noise(self, amplitude: float, kinds: list[str]) -> None:
        assert beside([-amplitude * SINE], [amplitude * SINE], noise=1.0) == kinds  # VISIBLE

    @pytest.mark.parametrize(("off", "kinds"), [(0.2, ["unit"]), (0.35, [])])
    def test_a_factor_is_a_usual_mistake_or_another(self, off: float, kinds: list[str]) -> None:
        for sign in (1.0, -1.0):
            assert beside([1e3 * np.exp(sign * off) * SINE], [SINE]) == kinds  # SAME_FACTOR

    def test_what_is_far_too_small_has_another_unit(self) -> None:
        """The difference from the simulation is as large as that itself, not larger."""
        assert beside([1e-3 * SINE], [SINE]) == ["unit"]  # FAR_OFF

    @pytest.mark.parametrize(("back", "kinds"), [(0.07, []), (0.15, ["constant"])])
    def test_a_channel_may_stay_at_its_limit_where_the_simulation_is_a_little_short_of_it(self, back: float, kinds: list[str]) -> None:
        n = np.arange(1000) / 500.0
        simulated = np.where(n < 1.0, n, 1.0 - back * (n - 1.0))
        assert beside([np.minimum(n, 1.0)], [simulated]) == kinds  # LIMIT

    @pytest.mark.parametrize(("share", "kinds"), [(0.2, []), (0.45, ["axes"])])
    def test_channels_that_are_nearly_alike_are_not_interchanged(self, share: float, kinds: list[str]) -> None:
        """In each other's place two waves of which each is apart from their mean by b differ by 4 b^2 over 1 + b^2 of their motion."""
        b = np.sqrt(share / (4.0 - share))
        one, two = SINE + b * COSINE, SINE - b * COSINE
        assert beside([two, one], [one, two]) == kinds  # CROSSED

    @pytest.mark.parametrize(("elements", "kinds"), [(6, ["axes"]), (8, [])])
    def test_channels_of_up_to_six_axes_can_be_interchanged(self, elements: int, kinds: list[str]) -> None:
        waves = [np.sin(2.0 * np.pi * (i + 1) * T) for i in range(elements)]
        assert beside([waves[1], waves[0], *waves[2:]], waves) == kinds  # ELEMENTS

    @pytest.mark.parametrize(("angle", "kinds"), [(19.0, []), (30.0, ["rotation"])])
    def test_a_vector_in_another_frame_is_turned_by_twenty_degrees(self, angle: float, kinds: list[str]) -> None:
        vector = (SINE, COSINE, 0.01 * OTHER)
        assert beside(turned(angle, *vector), list(vector)) == kinds  # ROTATION, AXES

    @pytest.mark.parametrize(("share", "kinds"), [(0.07, []), (0.15, ["rotation"])])
    def test_a_vector_in_another_frame_is_another_vector(self, share: float, kinds: list[str]) -> None:
        """Turned by 60 degrees, what lies across the axis is as far from itself as it is long."""
        along = np.sqrt(2.0 * (1.0 - share) / share)
        vector = (SINE, COSINE, along * OTHER)
        assert beside(turned(60.0, *vector), list(vector)) == kinds  # ROTATED


class TestRepeats:
    def unlike(self, *repeats: FloatArray) -> int:
        group = [x[:, None] for x in repeats]
        return len(checks.repeats(Condition("", {}, tuple(map(recorded, repeats)), T), group, [CHANNEL]))

    def test_of_two_repeats_none_is_unlike_the_others(self) -> None:
        assert self.unlike(SINE, 2.0 * SINE) == 0
        assert self.unlike(SINE, SINE, 2.0 * SINE) == 1  # ODD_ONE_OUT

    @pytest.mark.parametrize(("off", "count"), [(0.8e-14, 0), (1.2e-14, 1)])
    def test_repeats_that_rest_may_differ_by_round_off(self, off: float, count: int) -> None:
        rest = np.zeros(1000)
        assert self.unlike(rest, rest, rest + off) == count  # NOTHING

    @pytest.mark.parametrize(("times", "count"), [(9.0, 0), (12.0, 1)])
    def test_a_repeat_is_unlike_the_others_ten_times_as_far_as_they_are(self, times: float, count: int) -> None:
        around = [0.1 * np.cos(2.0 * np.pi * k * T) for k in (5, 6, 7, 8)]
        assert self.unlike(*around, times * 0.1 * np.cos(18.0 * np.pi * T)) == count  # UNLIKE
