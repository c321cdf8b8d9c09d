"""Where: replay, swaps and what is said about the inside, on the springs; closed forms where there are any."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.measured import DataError
from robomill.diagnosis.experiment.preparation import prepared
from robomill.diagnosis.experiment.segments import Segment, Structure, segments, sets_alike, structure
from robomill.diagnosis.localisation.localise import alignment, bands, dependences, variables
from robomill.diagnosis.localisation.replay_attribution import Replay
from robomill.diagnosis.localisation.swap import shapley
from robomill.diagnosis.localisation.where import Replayed, Where, blame, combined, locate
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.playback import Playback
from robomill.orchestration.slaves.protocol import FloatArray
from robomill.orchestration.system.definition import Component, Connection, System
from robomill.orchestration.system.parameters import same_unit_only
from tests import tolerances
from tests.diagnosis.demo import NOISE, NOISE_PART, SYSTEM, catalogue, changed, real, resolve

BOTH = ("masses.x", "sensors.y")


def measure(
    truth: Mapping[str, Mapping[str, float]] | None = None, arrays: Sequence[str] = BOTH, repeats: int = 4, seed: int = 1
) -> list[Run]:
    """Noisy runs in which these arrays are measured."""
    system = SYSTEM
    for component, values in (truth or {}).items():
        system = system.with_parameters(component, values)
    clean = run(system, None, stop=8.0, resolver=resolve)
    rng, made = np.random.default_rng(seed), []
    for repeat in range(repeats):
        columns = {f"{a}[{i}]": clean[f"{a}[{i}]"] + NOISE * rng.normal(size=len(clean.t)) for a in arrays for i in (1, 2)}
        made.append(Run(Path(f"run{repeat}"), clean.t, columns, {c: clean.ports[c] for c in columns}, {"labels": {"repeat": repeat}}))
    return made


def replay(folder: Path, runs: Sequence[Run]) -> Replay:
    start = prepared(Campaign.of(SYSTEM, runs), catalogue(folder), resolve, same_unit_only)
    return Replay(start.laboratory, range(start.n), start.catalogue, start.nuisances)


class TestSegments:
    def test_cuts_part_what_is_measured_on_both_sides(self) -> None:
        assert segments(SYSTEM, BOTH) == [Segment("masses.x", ("masses", "force")), Segment("sensors.y", ("sensors",))]

    def test_components_that_cannot_be_told_apart_are_a_set(self) -> None:
        names = [c.name for c in SYSTEM.components]
        assert sets_alike(segments(SYSTEM, ["sensors.y"]), names) == [("force", "masses", "sensors")]
        assert sets_alike(segments(SYSTEM, BOTH), names) == [("force", "masses"), ("sensors",)]

    def test_the_answer_has_the_sets_of_more_than_one(self) -> None:
        both = (Segment("masses.x", ("masses", "force")), Segment("sensors.y", ("sensors",)))
        assert structure(SYSTEM, BOTH) == Structure(both, (("force", "masses"),))

    def test_a_loop_is_one_segment_until_it_is_cut(self) -> None:
        ring = System(
            "ring",
            0.01,
            tuple(Component(n, n) for n in "abc"),
            (Connection("a.y", "b.u"), Connection("b.y", "c.u"), Connection("c.y", "a.u", delayed=True)),
        )
        assert segments(ring, ["c.y"]) == [Segment("c.y", ("c", "b", "a"))]
        assert segments(ring, ["c.y", "a.y"]) == [Segment("c.y", ("c", "b")), Segment("a.y", ("a",))]


class TestPlayback:
    GRID = np.linspace(0.0, 0.04, 5)
    SERIES: ClassVar = {"p[1]": np.array([1.0, 4.0, 9.0, 16.0, 25.0]), "p[2]": -np.arange(5.0)}

    def playback(self, adds: bool) -> Playback:
        return Playback.of_series("playback", [real("p[1]", "output", "m"), real("p[2]", "output", "m")], self.SERIES, self.GRID, adds)

    @pytest.mark.parametrize("loop", ["python", "compiled"])
    def test_every_sample_at_its_time(self, loop: str) -> None:
        system = System("alone", 0.01, (Component("playback", "playback"),), ())
        result = run(system, None, stop=0.06, resolver=lambda source, name: self.playback(adds=False), loop=loop)
        expected = np.stack([*self.SERIES.values()], axis=1)[[0, 1, 2, 3, 4, 4, 4]]
        assert np.abs(result["playback.p"] - expected[-len(result.t) :]).max() == 0.0

    def test_what_passes_through_is_added_to(self) -> None:
        parts = (Component("first", "plays"), Component("second", "adds"))
        system = System("two", 0.01, parts, (Connection("first.p", "second.p_in"),))
        result = run(system, None, stop=0.04, resolver=lambda source, name: self.playback(adds=source == "adds"), loop="compiled")
        assert np.array_equal(result["second.p"], 2.0 * result["first.p"])


class TestShapley:
    def worth(self, players: str) -> dict[frozenset[str], float]:
        rng = np.random.default_rng(3)
        every = [frozenset(p for i, p in enumerate(players) if k >> i & 1) for k in range(2 ** len(players))]
        return {s: float(rng.normal()) if s else 0.0 for s in every}

    def test_is_the_mean_over_all_orders(self) -> None:
        players, worth = "abcd", self.worth("abcd")
        expected = dict.fromkeys(players, 0.0)
        orders = list(permutations(players))
        for order in orders:
            for i, p in enumerate(order):
                expected[p] += (worth[frozenset(order[: i + 1])] - worth[frozenset(order[:i])]) / len(orders)
        found = shapley(players, lambda s: np.array(worth[s]))
        assert found == pytest.approx(expected, rel=tolerances.ROUNDOFF, abs=tolerances.ROUNDOFF)
        assert sum(float(v) for v in found.values()) == pytest.approx(worth[frozenset(players)], rel=tolerances.ROUNDOFF)

    def test_one_that_changes_nothing_gets_nothing_and_equals_get_the_same(self) -> None:
        game = {0: 0.0, 1: 0.3, 2: 1.0}
        found = shapley("abz", lambda s: np.array(game[len(s - {"z"})]))
        assert float(found["z"]) == 0.0
        assert float(found["a"]) == float(found["b"]) == pytest.approx(0.5, rel=tolerances.ROUNDOFF)


class TestInside:
    def test_a_residual_of_one_coordinate_is_all_its_own(self) -> None:
        rng = np.random.default_rng(1)
        jacobian = rng.normal(size=(300, 3, 4))
        share = alignment(jacobian[:, :, 2] * rng.normal(size=(300, 1)), jacobian)
        assert share[2] == pytest.approx(1.0, rel=tolerances.ROUNDOFF)
        assert max(share[[0, 1, 3]]) < 0.6  # a third of a direction by chance

    def test_noise_is_aligned_with_nothing(self) -> None:
        rng = np.random.default_rng(1)
        noise = rng.normal(size=(4000, 3))
        variance = np.ones(3)
        assert alignment(noise, rng.normal(size=(4000, 3, 2)), 1.2 * variance).max() == 0.0

    def inputs(self) -> tuple[dict[str, FloatArray], dict[str, str], FloatArray]:
        t = np.linspace(0.0, 4.99, 500)
        return {"a.q": np.sin(2.0 * t), "b.f": 50.0 * np.cos(5.0 * t) * (t > 2.0)}, {"a.q": "rad", "b.f": "N"}, t

    def test_noise_depends_on_nothing_but_for_the_rate_of_false_discoveries(self) -> None:
        found = 0
        for seed in range(60):
            noise = np.random.default_rng(seed).normal(size=(500, 2))
            found += bool(dependences(noise, variables(*self.inputs()), lambda s: np.stack([s, s], axis=1), 1.0))
        assert found <= 8  # 3 are expected of 60; more than 8 in one of 100

    def test_the_variable_that_it_depends_on_is_first(self) -> None:
        inputs, units, t = self.inputs()
        noise = np.random.default_rng(0).normal(size=(500, 1))
        for name, series in (("load b.f", 0.05 * inputs["b.f"]), ("sense of a.q", 2.0 * np.sign(np.cos(2.0 * t)))):
            found = dependences(noise + series[:, None], variables(inputs, units, t), lambda s: s[:, None], 1.0)
            assert found[0].variable == name

    def test_a_sine_is_in_its_band(self) -> None:
        t = np.arange(400) * 0.01
        shares = dict(bands(np.sin(2.0 * np.pi * 1.0 * t)[:, None], 0.01))
        assert shares[0.4, 2.0] == pytest.approx(1.0, rel=1e3 * tolerances.ROUNDOFF)


class TestReplay:
    @pytest.mark.parametrize("seed", range(4))
    def test_runs_that_are_as_simulated_blame_nobody(self, tmp_path: Path, seed: int) -> None:
        found = replay(tmp_path, measure(seed=100 + seed))
        assert blame(found) == ()
        assert not any(r.significant for r in found.readings())

    def test_what_is_within_the_tolerance_of_a_calibrated_number_is_no_fault(self, tmp_path: Path) -> None:
        assert blame(replay(tmp_path, measure({"masses": {"damping": 2.02}}))) == ()

    @pytest.mark.parametrize(
        ("component", "parameter", "value"),
        [
            ("masses", "stiffness_error[1]", 0.05),
            ("masses", "friction[2]", 0.04),
            ("sensors", "gain_error[2]", 0.03),
            ("masses", "cubic", 3e3),
        ],
    )
    def test_the_component_is_found_even_if_its_fault_is_in_no_catalogue(
        self, tmp_path: Path, component: str, parameter: str, value: float
    ) -> None:
        found = blame(replay(tmp_path, measure({component: {parameter: value}})))
        assert [b.component for b in found] == [component]
        assert found[0].alternatives == ()

    def test_two_faults_in_two_components(self, tmp_path: Path) -> None:
        truth = {"masses": {"stiffness_error[2]": -0.08}, "sensors": {"gain_error[1]": 0.04}}
        assert {b.component for b in blame(replay(tmp_path, measure(truth)))} == {"masses", "sensors"}

    def test_an_error_upstream_does_not_show_and_a_gain_shows_as_it_is(self, tmp_path: Path) -> None:
        runs = measure({"masses": {"stiffness_error[1]": 0.2}, "sensors": {"gain_error[1]": 0.05}})
        readings = {r.output: r for r in replay(tmp_path, runs).readings()}
        expected = 0.05 * float(np.sqrt(np.mean(runs[0].columns["masses.x[1]"] ** 2)))
        assert readings["sensors.y"].residual == pytest.approx(expected, rel=NOISE_PART)
        low, high = readings["sensors.y"].interval
        assert low < expected < high

    def test_without_the_cut_the_other_one_is_an_alternative_or_said_to_be_in_the_segment(self, tmp_path: Path) -> None:
        runs = changed(measure(arrays=["sensors.y"]), "sensors.y[1]", lambda t, y: y + 2e-3 * np.sin(9.0 * t) * (t > 5.0))
        found = replay(tmp_path, runs)
        first = blame(found)[0]
        assert {first.component, *first.alternatives} >= {"sensors"} or "masses" in found.readings()[0].components
        assert set(found.readings()[0].components) == {"masses", "sensors"}

    def test_nothing_to_replay_is_said(self, tmp_path: Path) -> None:
        runs = measure(arrays=["masses.x"])
        only = [Run(r.folder, r.t, {"force.f": np.zeros(len(r.t))}, {"force.f": real("f", "output", "N")}, r.info) for r in runs[:1]]
        text = (
            "no component is replayed alone: nothing that the catalogue has in one changes a measured output of that component"
            "; which effect it is does not depend on that, as effects are fitted in the whole system"
            "; give a channel of what comes out of one to have it looked at alone"
        )
        with pytest.raises(DataError) as error:
            replay(tmp_path, only)
        assert str(error.value) == text


class TestSwap:
    def shares(self, folder: Path, truth: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
        found = replay(folder, measure(truth))
        weights = {"y": np.array([0.0, 0.0, 1.0, 1.0])}
        return {s.component: s.share for s in locate(found, weights, {}).swap if s.figure == "y"}

    def test_all_of_a_fault_is_that_components(self, tmp_path: Path) -> None:
        assert self.shares(tmp_path, {"sensors": {"gain_error[2]": 0.03}}) == pytest.approx({"sensors": 1.0}, abs=NOISE_PART)
        assert self.shares(tmp_path, {"masses": {"stiffness_error[1]": 0.05}}) == pytest.approx({"masses": 1.0}, abs=NOISE_PART)

    def test_the_shares_of_two_add_up_and_are_those_of_the_closed_form(self, tmp_path: Path) -> None:
        # y = (1 + g) x', x' = x + d: shares of the gap g x' + d, each the mean of what it closes first and what it closes last
        truth = {"masses": {"stiffness_error[1]": 0.05}, "sensors": {"gain_error[1]": 0.03, "gain_error[2]": 0.03}}
        found = self.shares(tmp_path, truth)
        x = run(SYSTEM, None, stop=8.0, resolver=resolve)["masses.x"]
        moved = run(SYSTEM.with_parameters("masses", truth["masses"]), None, stop=8.0, resolver=resolve)["masses.x"]

        def left(y: FloatArray) -> float:
            return float(np.sum((1.03 * moved - y) ** 2))

        # a sensor that is put right adds what was left of its replay as a signal in time: 0.03 x'
        nothing, masses, sensors = left(x), left(moved), left(x + 0.03 * moved)
        expected = 0.5 * ((nothing - masses) + sensors) / nothing
        assert found["masses"] == pytest.approx(expected, abs=NOISE_PART)
        assert found["masses"] + found["sensors"] == pytest.approx(1.0, abs=NOISE_PART)


class TestAnswer:
    def test_an_unknown_is_placed_by_replay_not_by_the_channel_that_shows_most(self, tmp_path: Path) -> None:
        runs = measure({"masses": {"cubic": 3e3}})
        result = diagnose(SYSTEM, runs, catalogue(tmp_path), resolver=resolve).result
        assert result["where"][0]["component"] == "masses"
        assert {r["output"] for r in result["replay"] if r["significant"]} == {"masses.x"}

    def test_ambiguous_fits_give_way_to_the_replay_where_that_clears_them(self) -> None:
        fitted = (Where("a", 0.9, None, "", "a.y", "a.y", []),)
        found = (Replayed("b", 0.5, None, "", "b.y", "b.y", [], alternatives=("c",), outputs=("b.y",)),)
        assert combined("ambiguous", fitted, found) == found
        assert combined("unknown", fitted, found) == found
        assert combined("identified", fitted, found) == fitted
        assert combined("unknown", fitted, ()) == fitted
        same = (replace(found[0], component="a"),)
        assert combined("ambiguous", fitted, same) == (replace(fitted[0], alternatives=("c",), outputs=("b.y",)),)
