"""Repeats beside each other: copies, clocks that were started at other times, one that is nothing like the rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.gate.repeats import compared, copies, offsets, scatter
from robomill.orchestration.slaves.protocol import FloatArray
from tests.diagnosis.demo import NOISE, SYSTEM, catalogue, measure, resolve

STEP = 0.01
T = STEP * np.arange(1000)
SINE = np.sin(2.0 * np.pi * T)[:, None]
NAMES = [f"r{k}" for k in range(6)]


def noisy(count: int, size: float = 1e-3, seed: int = 1) -> list[FloatArray]:
    """Repeats with noise of their own."""
    return [SINE + size * np.random.default_rng([seed, k]).standard_normal(SINE.shape) for k in range(count)]


class TestCopies:
    @pytest.mark.parametrize("rounding", [0.0, 1e-6])
    @pytest.mark.parametrize("of", [1, 3])
    def test_copies_with_a_little_noise_added_are_copies(self, rounding: float, of: int) -> None:
        """Three of one repeat, or one beside two others; rounding far below the noise of the sensor."""
        measured = noisy(1) * 3 if of == 3 else [*noisy(3), noisy(1)[0]]
        measured = [x + rounding * np.random.default_rng(k).standard_normal(x.shape) for k, x in enumerate(measured)]
        found = copies(measured, noisy(8, seed=2), NAMES)
        assert len(found) == of
        assert {(f.kind, f.fatal) for f in found} == {("copy", True)}
        assert "of r3 are those of r0" in found[0].text if of == 1 else "of r1 are those of r0" in found[0].text
        assert f"there are {len(measured)} repeats: give one of these two" in found[0].text

    def test_repeats_with_noise_of_their_own_are_none(self) -> None:
        for size in (1e-3, 1e-4, 1e-2):  # a sensor that is ten times as good, or as bad, as the simulated one
            assert copies(noisy(3, size), noisy(8, seed=2), NAMES) == []

    @pytest.mark.parametrize(("part", "count"), [(0.007, 1), (0.015, 0)])
    def test_a_copy_is_a_hundredth_as_far(self, part: float, count: int) -> None:
        a, b = noisy(2)
        assert len(copies([a, a + part * (b - a), b], noisy(8, seed=2), NAMES)) == count  # COPY

    def test_a_single_repeat_is_no_copy(self) -> None:
        assert copies(noisy(1), noisy(8, seed=2), NAMES) == []

    def test_channels_that_do_not_scatter_say_nothing(self) -> None:
        """A program is the same in all repeats, and so is everything in a simulation without noise."""
        still = [np.hstack([SINE, x]) for x in noisy(3)]
        assert copies(still, [np.hstack([SINE, x]) for x in noisy(8, seed=2)], NAMES) == []
        assert copies([SINE] * 3, [SINE] * 8, NAMES) == []

    def test_the_diagnosis_stops_there(self, tmp_path: Path) -> None:
        one = measure()[0]
        runs = [
            replace(
                one,
                folder=Path(f"copy{k}"),
                columns={
                    c: x + 1e-3 * NOISE * np.random.default_rng([k, i]).standard_normal(len(x)) if c.startswith("sensors") else x
                    for i, (c, x) in enumerate(one.columns.items())
                },
            )
            for k in range(3)
        ]
        other = measure(seed=5)[1]
        result = diagnose(SYSTEM, [*runs, other], catalogue(tmp_path), resolver=resolve).result
        assert result["verdict"] == "bad_log"
        assert [f["kind"] for f in result["gate"]["findings"]] == ["copy"]


class TestOffsets:
    def test_a_clock_that_was_started_later_is_found_with_its_error(self) -> None:
        """In 100 draws two thirds lie within one standard error, which an error half or twice as large would not give."""
        within = []
        for seed in range(100):
            repeats = [
                np.interp(T - late, T, x[:, 0])[:, None] for late, x in zip((0.0, 0.0, 0.0, 4e-4), noisy(4, 0.02, seed), strict=True)
            ]
            usual = scatter(noisy(8, 0.02, seed=1000 + seed))
            late, error = offsets(repeats, usual, STEP)[3]
            within.append(abs(late - 4e-4) < error)
        assert 0.5 < np.mean(within) < 0.85

    def test_what_does_not_move_has_no_time(self) -> None:
        rest = [np.ones((100, 1))] * 3
        assert [tuple(o) for o in offsets(rest, np.ones(1), STEP)] == [(0.0, np.inf)] * 3


class TestCompared:
    def said(self, *repeats: FloatArray, simulated: list[FloatArray] | None = None) -> list[tuple[str, bool]]:
        found = compared(list(repeats), simulated or noisy(8, seed=2), ["a.y"], NAMES[: len(repeats)], STEP)
        return [(f.kind, f.fatal) for f in found]

    def test_usual_repeats_are_usual(self) -> None:
        assert self.said(*noisy(6)) == []

    @pytest.mark.parametrize(("times", "kinds"), [(7.0, []), (13.0, [("repeat", True)])])
    def test_a_repeat_is_unlike_the_others_ten_times_as_far_as_simulated_ones(self, times: float, kinds: list[tuple[str, bool]]) -> None:
        """Measured ones with hardly any noise: what counts is what simulated ones scatter."""
        other = SINE + times * 0.02 * np.sqrt(2.0) * np.cos(18.0 * np.pi * T)[:, None]
        assert self.said(*noisy(4, 1e-5), other, simulated=noisy(8, 0.02, seed=2)) == kinds  # UNLIKE

    @pytest.mark.parametrize(("unlike", "fatal"), [(1, False), (2, False), (3, True), (5, True)])
    def test_a_repeat_unlike_in_some_of_five_channels_is_kept_and_in_most_of_them_stops_the_log(self, unlike: int, fatal: bool) -> None:
        """What a spindle does anew with each start is seen in some channels, another program in most."""
        channels = [f"a.y[{k + 1}]" for k in range(5)]
        simulated, measured = ([np.hstack(noisy(5, 0.02, seed=10 * k + s)) for k in range(1, n)] for s, n in ((1, 9), (2, 6)))
        measured[-1][:, :unlike] += 0.4 * np.sqrt(2.0) * np.cos(18.0 * np.pi * T)[:, None]  # 20 times the noise
        (found,) = compared(measured, simulated, channels, NAMES[:5], STEP)
        assert (found.kind, found.fatal, found.channel in channels[:unlike]) == ("repeat", fatal, True)
        assert found.text.endswith(
            "expected about 1, at most 10" + ("; leave it out" if fatal else "; not so in most channels: it is kept")
        )

    def test_of_two_repeats_none_is_unlike_the_others(self) -> None:
        assert self.said(SINE, 2.0 * SINE) == []
        assert self.said(SINE, SINE, 2.0 * SINE) == [("repeat", True)]

    def test_a_repeat_whose_clock_was_started_later_is_noted_and_not_stopped(self) -> None:
        late = np.interp(T - 0.8 * STEP, T, SINE[:, 0])[:, None]
        assert self.said(*noisy(3), late) == [("offset", False)]

    @pytest.mark.parametrize("phases", [(0.3, 2.1, -1.6, 3.0), (0.0, 0.1, 3.0), (1.0, 1.0, 1.2, -2.0)])
    def test_a_phase_that_is_another_in_every_run_stops_no_log(self, phases: tuple[float, ...]) -> None:
        """A runout: a hundred times the noise, of which the simulation knows that it differs from run to run."""
        rng = np.random.default_rng(3)
        turned = [x + 0.1 * np.sin(40.0 * np.pi * T + p)[:, None] for x, p in zip(noisy(6), phases, strict=False)]
        known = [x + 0.1 * np.sin(40.0 * np.pi * T + rng.uniform(-np.pi, np.pi))[:, None] for x in noisy(8, seed=2)]
        assert not any(fatal for _, fatal in self.said(*turned, simulated=known))
        if len({round(p) for p in phases}) > 3:  # most repeats differ: nothing is odd, whatever the simulation knows
            assert not any(fatal for _, fatal in self.said(*turned))
