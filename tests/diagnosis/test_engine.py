"""The engine on a small system: right answers, and none where there is none."""

from __future__ import annotations

import itertools
import random
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis import engine
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.measured import DataError, sort_by_condition
from robomill.diagnosis.gate import checks as gate
from robomill.diagnosis.gate.log_faults import ICE
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.outcome import conclusion
from robomill.diagnosis.outcome.answer import Diagnosis
from robomill.orchestration.runs.run import Run
from tests.diagnosis.demo import NOISE, NOISE_PART, PARTS, RANGE, SYSTEM, WELL, Masses, Sensors, catalogue, changed, measure, resolve
from tests.tolerances import ROUNDOFF

REPEAT = itertools.count()
"""Numbers the repeats: a logger fails elsewhere in each."""
STIFF = {"masses": {"stiffness_error[2]": -0.08}}


def answer(folder: Path, runs: list[Run], **more: Any) -> Diagnosis:
    return diagnose(SYSTEM, runs, catalogue(folder), resolver=resolve, **more)


def two_conditions(truth: Any = None) -> list[Run]:
    return measure(truth) + measure(truth, amplitude=0.6, seed=2)


class TestVerdict:
    @pytest.mark.parametrize("seed", range(3))
    def test_runs_that_are_as_simulated_give_none_and_what_would_have_been_seen(self, tmp_path: Path, seed: int) -> None:
        result = answer(tmp_path, measure(seed=100 + seed)).result
        assert result["verdict"] == "none"
        assert result["which"] == [] or result["which"][0]["probability"] < 0.5
        seen = {(s["effect"], s["location"]): s["value"] for s in result["smallest_visible"]}
        assert 0.0 < seen["gain", "sensor 1"] < 0.01

    def test_an_effect_that_its_parameter_does_not_allow_is_no_answer(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """The catalogue would have it as small as -0.6; the model has no spring that is softer by more than 5 %."""

        class Short(Masses):
            def __init__(self, name: str) -> None:
                super().__init__(name)
                self.ports = tuple(replace(p, minimum=-0.05) if p.name == "stiffness_error[2]" else p for p in self.ports)

        runs = measure(STIFF)
        monkeypatch.setitem(PARTS, "masses", Short)
        result = answer(tmp_path, runs).result
        spring = [w["parameters"]["stiffness_error[2]"] for w in result["which"] if w["location"] == "spring 2"]
        assert result["verdict"] == "unknown"
        assert spring[0]["value"] >= -0.05 - ROUNDOFF
        assert min(s["interval"][0] for s in spring) >= -0.05 - ROUNDOFF
        assert "bound" in result["unknown"]["why"]

    def test_how_a_run_begins_is_no_gap(self, tmp_path: Path) -> None:
        """A simulation begins with its initial values, and settles."""

        def settling(t: Any, y: Any) -> Any:
            return y + 200.0 * NOISE * np.exp(-t / 0.02) * (t < 0.09)

        result = answer(tmp_path, changed(measure(seed=100), "sensors.y[1]", settling)).result
        assert result["verdict"] == "none"
        later = answer(tmp_path, changed(measure(seed=100), "sensors.y[1]", lambda t, y: settling(np.abs(t - 4.0), y))).result
        assert later["verdict"] != "none"

    @pytest.mark.parametrize(
        ("component", "parameter", "value", "effect", "location"),
        [
            ("masses", "stiffness_error[1]", 0.05, "stiffness", "spring 1"),
            ("masses", "stiffness_error[2]", -0.08, "stiffness", "spring 2"),
            ("masses", "friction[1]", 0.08, "friction", "mass 1"),
            ("masses", "friction[2]", 0.04, "friction", "mass 2"),
            ("sensors", "gain_error[2]", 0.03, "gain", "sensor 2"),
        ],
    )
    def test_one_effect_is_named_with_its_place_and_size(
        self, tmp_path: Path, component: str, parameter: str, value: float, effect: str, location: str
    ) -> None:
        found = answer(tmp_path, two_conditions({component: {parameter: value}}))
        result = found.result
        first = result["which"][0]
        assert result["verdict"] == "identified"
        assert (first["effect"], first["component"], first["location"]) == (effect, component, location)
        low, high = first["parameters"][parameter]["interval"]
        # intervals are of 90 %: half of one more on either side
        assert low - 0.5 * (high - low) < value < high + 0.5 * (high - low)
        assert result["where"][0]["component"] == component
        assert result["where"][0]["share"] > 0.95
        assert set(found.adopted) == {(component, parameter)}

    def test_two_effects_are_both_named(self, tmp_path: Path) -> None:
        result = answer(tmp_path, two_conditions({**STIFF, "sensors": {"gain_error[1]": 0.04}})).result
        assert result["verdict"] == "identified"
        assert {w["effect"] for w in result["which"] if w["probability"] > 0.9} == {"stiffness", "gain"}
        assert sum(w["share"] for w in result["where"]) == pytest.approx(1.0, abs=NOISE_PART)

    def test_what_no_candidate_can_do_is_unknown_and_described(self, tmp_path: Path) -> None:
        def disturbed(t: Any, y: Any) -> Any:
            return y + 2e-3 * np.sin(9.0 * t) * (t > 5.0)

        runs = changed(measure(), "sensors.y[1]", disturbed)
        found = answer(tmp_path, runs)
        assert found.result["verdict"] == "unknown"
        assert found.result["unknown"]["channels"][0]["channel"] == "sensors.y[1]"
        assert min(a for a, _ in found.result["unknown"]["regime"]) > 4.0

    def test_what_can_not_be_told_apart_is_a_set(self, tmp_path: Path) -> None:
        text = tmp_path / "twin.toml"
        catalogue(tmp_path)
        entry = (tmp_path / "catalogue.toml").read_text()
        twin = entry.split("[[effect]]")[3].replace('"gain"', '"scale"')
        text.write_text(f"{entry}\n[[effect]]{twin}")
        runs = two_conditions({"sensors": {"gain_error[1]": 0.04}})
        result = diagnose(SYSTEM, runs, Catalogue.load(text), resolver=resolve).result
        assert result["verdict"] == "ambiguous"
        assert {w["effect"] for w in result["which"][:2]} == {"gain", "scale"}
        one, other = (w["probability"] for w in result["which"][:2])
        assert one == pytest.approx(other, rel=ROUNDOFF)
        assert one + other > 0.99 * result["tests"]["p_fit"]
        assert result["which"][0]["confusable_with"]
        assert result["isolability"][0] == {"pair": ["gain @ sensor 1", "scale @ sensor 1"], "distance": 0.0, "confusable": True}
        assert result["next_run"] is None  # there is no menu


class TestOnTop:
    """A system that has an effect already: what is found comes on top of it. 0.08 N of friction are measured."""

    FRICTION: Any = ("masses", "friction[1]")

    def found(self, folder: Path, given: float) -> Any:
        system = SYSTEM.with_parameters("masses", {"friction[1]": given})
        return diagnose(system, measure({"masses": {"friction[1]": 0.08}}), catalogue(folder), resolver=resolve)

    def test_what_is_missing_is_named_and_the_whole_is_adopted(self, tmp_path: Path) -> None:
        found = self.found(tmp_path, 0.03)
        assert found.answer.verdict == "identified"
        (friction,) = found.answer.which[0].parameters.values()
        assert friction.value == pytest.approx(0.05, rel=WELL)
        assert friction.given == 0.03
        assert friction.text.endswith("] N on top of 0.03")
        assert found.adopted[self.FRICTION] == pytest.approx(0.08, rel=WELL)

    def test_where_it_is_all_there_nothing_is_wrong(self, tmp_path: Path) -> None:
        assert self.found(tmp_path, 0.08).answer.verdict == "none"


class TestInvariance:
    def test_order_of_candidates_and_runs_does_not_matter(self, tmp_path: Path) -> None:
        runs = two_conditions(STIFF)
        first = answer(tmp_path, runs).result
        random.Random(1).shuffle(runs)
        shuffled = catalogue(tmp_path)
        candidates = list(shuffled.candidates)
        random.Random(2).shuffle(candidates)
        second = diagnose(SYSTEM, runs, replace(shuffled, candidates=tuple(candidates)), resolver=resolve).result
        assert second["verdict"] == first["verdict"]
        assert second["which"][0]["effect"] == first["which"][0]["effect"]
        a, b = (r["which"][0]["parameters"]["stiffness_error[2]"]["value"] for r in (first, second))
        assert a == pytest.approx(b, rel=1e3 * ROUNDOFF)  # sums in another order, and what a fit makes of them

    def test_processes_change_nothing(self, tmp_path: Path) -> None:
        runs = measure(STIFF)
        one, two = (answer(tmp_path, runs, workers=n).result for n in (1, 2))
        for r in (one, two):
            r["effort"] = None
        assert one == two


class TestHowFar:
    def test_closure_is_measured_on_runs_that_were_held_out(self, tmp_path: Path) -> None:
        held = measure(STIFF, repeats=2, seed=8) + measure(STIFF, amplitude=1.5, repeats=2, seed=9)
        far = answer(tmp_path, two_conditions(STIFF), held_out=held).result["how_far"]
        for kind in ("held-out repeat", "held-out condition"):
            (whole,) = (h for h in far if h["on"] == kind and h["channel"] == "sensors.y")
            assert whole["closure"] > 0.99
            assert whole["interval"][0] < whole["closure"] <= whole["interval"][1] + 1e-9
            assert whole["unit"] == "m"
            assert whole["after"] < 0.1 * whole["before"]
        (repeat,) = (h for h in far if h["on"] == "held-out repeat" and h["channel"] == "sensors.y")
        assert repeat["ceiling"] == pytest.approx(1.0, abs=NOISE_PART)
        (new,) = (h for h in far if h["on"] == "held-out condition" and h["channel"] == "sensors.y")
        assert new["ceiling"] == pytest.approx(1.0, abs=NOISE_PART)
        assert new["ratio"] == new["closure"] / new["ceiling"]
        assert (new["ceiling_by"], new["why_no_ceiling"]) == ("repeats", None)

    def test_the_ceiling_of_a_condition_measured_once_is_a_regression_and_without_a_gap_there_is_none(self, tmp_path: Path) -> None:
        def on(held: list[Run]) -> dict[str, Any]:
            far = answer(tmp_path, measure(STIFF), held_out=held).result["how_far"]
            return next(h for h in far if h["on"] == "held-out condition" and h["channel"] == "sensors.y")

        single = on(measure(STIFF, amplitude=1.5, repeats=1, seed=9))
        small = on(measure(STIFF, amplitude=0.0, repeats=3, seed=10))
        assert single["closure"] > 0.99
        assert single["closure"] <= single["ceiling"] <= 1.0
        assert (single["ceiling_by"], single["why_no_ceiling"]) == ("regression", None)
        assert not small["measurable"]
        assert (small["closure"], small["ceiling"]) == (None, None)
        assert small["why_no_ceiling"] == "the gap before is not measurable: its interval includes 0"

    def test_runs_labelled_held_out_are_not_fitted(self, tmp_path: Path) -> None:
        held = measure({"sensors": {"gain_error[1]": 0.2}}, amplitude=1.5, repeats=2, held_out=True)
        assert answer(tmp_path, measure() + held).result["verdict"] == "none"


class TestGate:
    @pytest.mark.parametrize(
        ("kind", "function"),
        [
            ("unit", lambda t, y: 1e3 * y),
            ("unit", lambda t, y: y / 1e3),
            ("sign", lambda t, y: -y),
            ("constant", lambda t, y: np.full_like(y, 0.01)),
            ("constant", lambda t, y: np.where((t > 4.0) & (t < 6.0), y[400], y)),
            ("constant", lambda t, y: np.where(t > t[y[:400].argmax()], y[:400].max(), y)),  # at an extreme, but the simulation moves on
            ("missing", lambda t, y: np.where((t > 4.0) & (t < 5.0), np.nan, y)),
            ("range", lambda t, y: np.where(t > 7.9, 9.0, y)),
            ("spikes", lambda t, y: y + 1.0 * (np.arange(len(t)) % 150 == 7 + 40 * (next(REPEAT) % 4))),
        ],
    )
    def test_a_bad_channel_is_stopped_with_the_reason(self, tmp_path: Path, kind: str, function: Any) -> None:
        result = answer(tmp_path, changed(measure(STIFF), "sensors.y[2]", function)).result
        assert result["verdict"] == "bad_log"
        assert not result["gate"]["usable"]
        assert (kind, "sensors.y[2]") in {(f["kind"], f["channel"]) for f in result["gate"]["findings"]}

    def test_a_channel_that_stands_still_where_its_simulation_moves_is_stopped_though_that_rests_for_long_before(self) -> None:
        (run,) = measure(repeats=1)
        random = np.random.default_rng(1)
        simulated = np.maximum(run.t - 0.7 * run.t[-1], 0.0)[:, None]
        noisy = simulated[:, 0] + 1e-3 * random.standard_normal(len(run.t))
        stuck = np.where(np.arange(len(noisy)) < 0.4 * len(noisy), noisy, noisy[int(0.4 * len(noisy))])

        def kinds(measured: Any) -> list[str]:
            told = replace(run, columns={**run.columns, "sensors.y[2]": measured})
            return [f.kind for f in gate.standstill(told, measured[:, None], simulated, ["sensors.y[2]"], 0.01, np.array([1e-3]))]

        assert kinds(noisy) == []
        assert kinds(stuck) == ["constant"]

    def wide(self, folder: Path) -> Path:
        """A catalogue with gains of any size."""
        catalogue(folder)
        text = (folder / "catalogue.toml").read_text().replace("maximum = 0.5", "maximum = 3.0").replace("scale = 0.05}", "scale = 1.0}")
        (folder / "wide.toml").write_text(text)
        return folder / "wide.toml"

    def test_a_sign_that_an_effect_turns_is_no_fault_of_the_log(self, tmp_path: Path) -> None:
        """A moment that is small beside what a wrong gain takes off changes its sign; so does a channel with a gain of -1."""
        runs = measure({"sensors": {"gain_error[2]": -2.0}})
        result = diagnose(SYSTEM, runs, Catalogue.load(self.wide(tmp_path)), resolver=resolve).result
        assert result["gate"]["findings"] == []
        assert (result["verdict"], result["which"][0]["location"]) == ("identified", "sensor 2")

    def test_a_wrong_sign_is_seen_where_an_effect_is_larger_than_the_signal(self, tmp_path: Path) -> None:
        """Neither the sign alone nor a gain above one alone says what was measured: three times as much, the other way round."""
        wide = self.wide(tmp_path).read_text()
        before, gain, after = wide.partition('name = "gain"')
        after = after.replace('sign = "both"', 'sign = "positive"', 1).replace('kind = "normal"', 'kind = "log-normal", spread = 0.8', 1)
        (tmp_path / "larger.toml").write_text(before + gain + after)
        runs = changed(measure({"sensors": {"gain_error[2]": 2.0}}), "sensors.y[2]", lambda t, y: -y)
        result = diagnose(SYSTEM, runs, Catalogue.load(tmp_path / "larger.toml"), resolver=resolve).result
        assert result["verdict"] == "bad_log"
        (finding,) = result["gate"]["findings"]
        assert (finding["kind"], finding["channel"]) == ("sign", "sensors.y[2]")
        assert finding["text"] == "has the wrong sign: with the other one, gain @ sensor 2 explains the log"

    def test_what_looks_like_a_fault_and_explains_nothing_is_kept(self, tmp_path: Path) -> None:
        """25.4 times as much, and a third of that more whatever the sign: in no catalogue, and no inches."""
        result = answer(tmp_path, changed(measure(), "sensors.y[2]", lambda t, y: 25.4 * y + 8.0 * np.abs(y))).result
        assert result["verdict"] == "unknown"
        (finding,) = (f for f in result["gate"]["findings"] if f["kind"] == "unit")
        assert not finding["fatal"]
        assert "millimetres for inches" in finding["text"]
        assert finding["text"].endswith("; with that put right, the log is not explained, or no better: it is kept as it is")

    @pytest.mark.parametrize(("part", "verdict"), [(0.03, "bad_log"), (0.1, "unknown")])
    def test_a_unit_stops_the_log_where_it_is_nearly_explained_without_it_and_not_at_all_with_it(
        self, tmp_path: Path, part: float, verdict: str
    ) -> None:
        """Thousandths, of a signal that is a part larger whatever its sign: in no catalogue. More than LITTLE of the gap is left."""
        result = answer(tmp_path, changed(measure(STIFF), "sensors.y[2]", lambda t, y: 1e-3 * (y + part * np.abs(y)))).result
        assert result["verdict"] == verdict
        (finding,) = (f for f in result["gate"]["findings"] if f["kind"] == "unit")
        assert finding["fatal"] is (verdict == "bad_log")

    @pytest.mark.parametrize(("moves", "shows"), [(5e-4, True), (5e-3, False)])
    def test_a_model_that_leaves_more_than_there_is_shows_nothing_of_a_log(self, moves: float, shows: bool) -> None:
        """It may explain nearly all of a gap that is a thousand times as large as the log is."""
        log, model = 1e-3 * np.ones((100, 2)), moves * np.ones((100, 2))
        simulator = SimpleNamespace(laboratory=SimpleNamespace(channels=["a.x", "a.y"]), repeated=lambda *_: [[model], None])
        search: Any = SimpleNamespace(simulator=simulator, groups=[[log], [log]])
        assert engine._shows(search, Fit((), {}, {}, 0.0, 0.0), {"a.y"}) is shows

    def test_a_way_is_not_in_kilogram_force(self, tmp_path: Path) -> None:
        """The channel is in metres, and 9.8 is the factor of a force."""
        result = answer(tmp_path, changed(measure(), "sensors.y[2]", lambda t, y: 9.8 * y + 3.0 * np.abs(y))).result
        assert result["verdict"] == "unknown"
        assert "unit" not in {f["kind"] for f in result["gate"]["findings"]}

    def test_a_wrong_sign_stops_the_log_though_something_else_is_in_no_catalogue(self, tmp_path: Path) -> None:
        """What is left of the log with the sign put right is a part in four hundred of the gap with the wrong one."""
        result = answer(tmp_path, changed(measure(), "sensors.y[2]", lambda t, y: -(y + 0.1 * np.abs(y)))).result
        assert result["verdict"] == "bad_log"
        assert [(f["kind"], f["channel"]) for f in result["gate"]["findings"] if f["fatal"]] == [("sign", "sensors.y[2]")]

    def test_a_scale_with_another_zero_stops_the_log_though_something_else_is_in_no_catalogue(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        class Thermometers(Sensors):
            def __init__(self, name: str) -> None:
                super().__init__(name)
                self.ports = tuple(replace(p, unit="K", minimum=None, maximum=None) if p.name.startswith("y[") else p for p in self.ports)

        monkeypatch.setitem(PARTS, "sensors", Thermometers)
        result = answer(tmp_path, changed(measure(), "sensors.y[2]", lambda t, y: y + 0.1 * np.abs(y) - ICE)).result
        assert result["verdict"] == "bad_log"
        assert [(f["kind"], f["channel"]) for f in result["gate"]["findings"] if f["fatal"]] == [("unit", "sensors.y[2]")]

    def test_a_channel_that_rests_at_an_extreme_and_has_all_of_a_gap_that_nothing_explains_is_stopped(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """By itself, rest where the simulation goes as far may be a limit (case 0086 of seed 2035); here the simulation may go anywhere."""
        monkeypatch.setattr(gate, "LIMIT", 1.5)
        runs = changed(measure(), "sensors.y[2]", lambda t, y: np.where(t > t[y[:400].argmax()], y[:400].max(), y))
        result = answer(tmp_path, runs).result
        assert result["verdict"] == "bad_log"
        (finding,) = result["gate"]["findings"]
        assert (finding["kind"], finding["channel"]) == ("constant", "sensors.y[2]")
        assert finding["text"].startswith("stands still for ")
        assert finding["text"].endswith(" s, which nothing explains")

    def test_a_channel_has_stopped_only_where_its_simulation_moves(self) -> None:
        t = np.arange(800) * 0.01
        simulated = np.minimum(t, 4.0)
        assert gate.stopped(np.minimum(t, 2.0), simulated, 0.01, 1e-3) == pytest.approx(6.0, rel=1e2 * ROUNDOFF)
        assert gate.stopped(np.minimum(t, 3.999), simulated, 0.01, 1e-3) == 0.0  # as the simulation, but for noise
        assert gate.stopped(t % 0.4, simulated, 0.01, 1e-3) == 0.0

    @pytest.mark.parametrize("lost", [0.8, 0.98])
    def test_a_range_that_is_too_small_is_an_effect_and_no_standstill(self, tmp_path: Path, lost: float) -> None:
        def clipped(_: Any, y: Any) -> Any:
            return np.clip(y, -0.5 * (1.0 - lost), 0.5 * (1.0 - lost))

        runs = changed(changed(measure(), "sensors.y[1]", clipped), "sensors.y[2]", clipped)
        result = diagnose(SYSTEM, runs, catalogue(tmp_path, RANGE), resolver=resolve).result
        assert result["gate"]["findings"] == []
        assert (result["verdict"], result["which"][0]["effect"]) == ("identified", "range")
        assert result["which"][0]["parameters"]["range_lost"]["value"] == pytest.approx(lost, rel=WELL)

    def test_a_range_that_is_too_small_and_in_no_catalogue_is_unknown(self, tmp_path: Path) -> None:
        """The channel has all of a gap that nothing explains, and stands still; but it comes back to where it stood."""
        result = answer(tmp_path, changed(measure(), "sensors.y[2]", lambda t, y: np.clip(y, -0.1 * y.max(), 0.1 * y.max()))).result
        assert result["verdict"] == "unknown"
        assert result["gate"]["usable"]

    def test_a_lost_range_is_found_beside_another_effect_though_the_most_of_it_looks_like_a_tolerance(self, tmp_path: Path) -> None:
        """A sensor without any range differs from a sound one as a wrong scale does; one with a tenth of it does not."""
        scale = '[[nuisance]]\ncomponent = "sensors"\nparameters = ["scale_error"]\nabsolute = 0.05\nsource = "made up"\n'
        truth = {"sensors": {"range_lost": 0.9}, "masses": {"stiffness_error[1]": 0.3}}
        result = diagnose(SYSTEM, measure(truth), catalogue(tmp_path, RANGE + scale), resolver=resolve).result
        assert result["verdict"] == "identified"
        values = {w["effect"]: next(iter(w["parameters"].values()))["value"] for w in result["which"] if w["probability"] > 0.9}
        assert values == {"range": pytest.approx(0.9, rel=WELL), "stiffness": pytest.approx(0.3, rel=WELL)}

    def test_what_jumps_at_the_same_time_in_every_repeat_is_the_machine(self) -> None:
        def jerk(t: Any, y: Any) -> Any:
            return y + 1.0 * (np.arange(len(t)) % 150 == 7)

        runs = changed(measure(repeats=4), "sensors.y[2]", jerk)
        (condition,) = sort_by_condition(runs, SYSTEM)
        assert not gate.spikes(condition, ["sensors.y[2]"])
        once = replace(runs[0], columns={**runs[0].columns, "sensors.y[2]": np.roll(runs[0].columns["sensors.y[2]"], 40)})
        (condition,) = sort_by_condition([once, *runs[1:]], SYSTEM)
        (finding,) = gate.spikes(condition, ["sensors.y[2]"])
        assert (finding.value, finding.fatal) == (6, True)
        assert finding.text == "6 samples jump away by more than 30 times what is usual"
        (alone,) = sort_by_condition(runs[:1], SYSTEM)
        assert gate.spikes(alone, ["sensors.y[2]"])[0].fatal  # nothing says that it would come again

    def test_interchanged_channels_are_stopped(self, tmp_path: Path) -> None:
        runs = [
            replace(r, columns={"sensors.y[1]": r.columns["sensors.y[2]"], "sensors.y[2]": r.columns["sensors.y[1]"]}) for r in measure()
        ]
        result = answer(tmp_path, runs).result
        assert "axes" in {f["kind"] for f in result["gate"]["findings"]}

    @pytest.mark.parametrize("lag", [0.01, 0.03, -0.02])
    def test_a_late_clock_is_a_clock_and_no_physics(self, tmp_path: Path, lag: float) -> None:
        def late(t: Any, y: Any) -> Any:
            return np.interp(t - lag, t, y)

        result = answer(tmp_path, changed(changed(measure(), "sensors.y[1]", late), "sensors.y[2]", late)).result
        assert result["verdict"] == "bad_log"
        assert result["which"][0]["component"] == "logging"
        (finding,) = (f for f in result["gate"]["findings"] if f["kind"] == "lag")
        assert finding["value"] == pytest.approx(lag, rel=WELL)
        assert finding["text"] == f"the clock of the logger is {'late' if lag > 0.0 else 'early'} by {1e3 * abs(finding['value']):.1f} ms"

    def test_the_size_of_a_fault_of_the_log_is_said_with_its_unit(self) -> None:
        sizes = [(-0.1893, "s"), (39.97, "s"), (0.05, "1"), (-2.0, "N")]
        assert [conclusion._size(*size) for size in sizes] == ["189.3 ms", "39.97 s", "0.05", "-2 N"]

    @pytest.mark.parametrize("lag", [0.002, 0.05])
    def test_a_late_clock_beside_an_effect_of_the_machine_is_corrected_and_named_first(self, tmp_path: Path, lag: float) -> None:
        def late(t: Any, y: Any) -> Any:
            return np.interp(t - lag, t, y)

        result = answer(tmp_path, changed(changed(measure(STIFF), "sensors.y[1]", late), "sensors.y[2]", late)).result
        assert result["verdict"] == "identified"
        (finding,) = result["gate"]["findings"]
        assert finding["value"] == pytest.approx(lag, rel=WELL)
        assert (finding["kind"], finding["fatal"], finding["repaired"]) == ("lag", False, True)
        assert [w["effect"] for w in result["which"] if w["probability"] > 0.8] == ["clock", "stiffness"]

    def test_a_clock_of_several_sensors_is_said_once(self, tmp_path: Path) -> None:
        entries = catalogue(tmp_path)
        both = ("lag sensors.y[1]", "lag sensors.y[2]")
        clocks = [replace(c, parameters=both) for c in entries.candidates if c.effect == "clock" and c.location == "logger"]
        entries = replace(entries, candidates=(*(c for c in entries.candidates if c.effect != "clock"), *clocks))

        def late(t: Any, y: Any) -> Any:
            return np.interp(t - 0.02, t, y)

        runs = changed(changed(measure(), "sensors.y[1]", late), "sensors.y[2]", late)
        found = diagnose(SYSTEM, runs, entries, resolver=resolve).answer
        assert found.verdict == "bad_log"
        assert [f.text for f in found.findings] == ["the clock of the logger is late by 20.0 ms"]

    def test_repair_goes_on_with_the_clock_corrected(self, tmp_path: Path) -> None:
        def late(t: Any, y: Any) -> Any:
            return np.interp(t - 0.02, t, y)

        result = answer(tmp_path, changed(two_conditions(STIFF), "sensors.y[2]", late), repair=True).result
        assert result["verdict"] == "identified"
        assert {"stiffness", "clock"} <= {w["effect"] for w in result["which"] if w["probability"] > 0.9}
        assert [f["repaired"] for f in result["gate"]["findings"] if f["kind"] == "lag"] == [True]


class TestErrors:
    def test_nothing_measured_that_the_system_has(self, tmp_path: Path) -> None:
        (run, *_) = measure(repeats=1)
        other = replace(run, columns={"a.b": run.columns["sensors.y[1]"]}, ports={"a.b": run.ports["sensors.y[1]"]})
        with pytest.raises(DataError, match=r"no measured column is an output of the system; measured: a\.b; outputs: force\.f"):
            answer(tmp_path, [other])

    def test_nothing_to_diagnose(self, tmp_path: Path) -> None:
        with pytest.raises(DataError, match="all of them are held out"):
            answer(tmp_path, measure(held_out=True))

    def test_too_short(self, tmp_path: Path) -> None:
        with pytest.raises(DataError, match=r"10 steps of 0.01 s in common; expected at least 20: record longer runs"):
            answer(tmp_path, measure(seconds=0.1))
