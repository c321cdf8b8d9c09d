"""The runs that are given, as a set: copies, repeats cut short, held-out runs that are diagnosed, other programs."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.measured import DataError, sort_by_condition
from robomill.diagnosis.gate.run_set import check_clock, check_each, complete, latest_clock, other_program
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from robomill.orchestration.system.parameters import same_unit_only
from tests.diagnosis.demo import SYSTEM, catalogue, measure, resolve
from tests.tolerances import ROUNDOFF

ROOT = Path(__file__).parents[3]


def refused(folder: Path, runs: list[Run], held_out: list[Run] | None = None) -> str:
    with pytest.raises(DataError) as caught:
        diagnose(SYSTEM, runs, catalogue(folder), held_out=held_out or [], resolver=resolve)
    return str(caught.value)


def cut(r: Run, n: int) -> Run:
    return replace(r, t=r.t[:n], columns={k: v[:n] for k, v in r.columns.items()})


class TestClock:
    """Stamps in another unit than the program has."""

    @pytest.mark.parametrize(("factor", "unit"), [(1e3, "0.001"), (1e-3, "1000"), (1e6, "1e-06")])
    def test_milliseconds_taken_for_seconds_or_the_reverse_are_said_with_both_durations(self, factor: float, unit: str) -> None:
        ends = replace(SYSTEM, stop=8.0)
        (measured, *_) = measure(repeats=1)
        for every in (1, 5):  # the logger may be slower than the system
            wrong = replace(measured, t=factor * measured.t[::every], columns={k: v[::every] for k, v in measured.columns.items()})
            with pytest.raises(DataError) as caught:
                check_clock(wrong, ends, resolve, same_unit_only)
            lasts, between = f"{wrong.t[-1]:.6g}", f"{0.01 * every * factor:.3g}"
            said = f"run0: the log lasts {lasts} s, with a sample each {between} s; expected about 8 s, as 'springs' takes"
            assert str(caught.value).startswith(said)
            assert f"as if the time were in a unit of {unit} s; give the unit of the time" in str(caught.value)

    def test_a_slow_logger_and_a_system_without_an_end_are_let_pass(self) -> None:
        (measured, *_) = measure(repeats=1, seconds=80.0)
        slow = replace(measured, t=measured.t[::1000], columns={k: v[::1000] for k, v in measured.columns.items()})
        check_clock(slow, replace(SYSTEM, stop=80.0), resolve, same_unit_only)
        check_clock(replace(measured, t=1e3 * measured.t), SYSTEM, resolve, same_unit_only)

    def test_the_diagnosis_says_it(self, tmp_path: Path) -> None:
        wrong = [replace(r, t=1e-3 * r.t) for r in measure()]
        with pytest.raises(DataError, match="expected about 8 s"):
            diagnose(replace(SYSTEM, stop=8.0), wrong, catalogue(tmp_path), resolver=resolve)


class TestEach:
    """Each run once, and whole."""

    def test_a_held_out_run_that_is_diagnosed(self, tmp_path: Path) -> None:
        runs = measure()
        text = refused(tmp_path, runs, [replace(runs[2], folder=Path("other"))])
        assert text == (
            "other is held out, and run2, which is diagnosed, has the same signals but for rounding, as far as both go; "
            "a run cannot confirm what was found in it; leave it out of one of the two"
        )

    def test_a_held_out_run_that_is_diagnosed_by_its_folder(self, tmp_path: Path) -> None:
        (tmp_path / "a").mkdir()
        (tmp_path / "b").symlink_to(tmp_path / "a")
        runs, held = measure(), measure(seed=9)[:1]
        text = refused(tmp_path, [replace(runs[0], folder=tmp_path / "a"), *runs[1:]], [replace(held[0], folder=tmp_path / "b")])
        assert text.startswith(f"{tmp_path / 'b'} is held out, and {tmp_path / 'a'}, which is diagnosed, has the same folder")

    def test_a_repeat_that_is_a_copy(self, tmp_path: Path) -> None:
        runs = measure()
        text = refused(tmp_path, [*runs, replace(runs[1], folder=Path("again"), info={**runs[1].info, "labels": {"repeat": 9}})])
        assert text.startswith("again has the same signals but for rounding, as far as both go as run1: a repeat has noise of its own")
        assert "give one of them" in text

    def test_a_copy_that_is_cut_short_is_a_copy(self, tmp_path: Path) -> None:
        runs = measure()
        assert "but for rounding" in refused(tmp_path, [*runs, replace(cut(runs[1], 790), folder=Path("again"))])

    def test_a_copy_that_was_rounded_and_stamped_anew_is_a_copy(self, tmp_path: Path) -> None:
        runs = measure()
        rounded = {k: v.astype(np.float32).astype(np.float64) for k, v in runs[1].columns.items()}
        again = replace(runs[1], folder=Path("again"), t=runs[1].t + 1e-4, columns=rounded)
        assert "but for rounding" in refused(tmp_path, [*runs, again])

    def test_copies_of_a_simulation_without_noise_are_copies(self, tmp_path: Path) -> None:
        for name in ("a", "b"):
            run(SYSTEM, tmp_path / name, stop=2.0, resolver=resolve)
        with pytest.raises(DataError, match="one of a simulation without noise says nothing new"):
            check_each([Run.load(tmp_path / "a"), Run.load(tmp_path / "b")], [])
        shutil.rmtree(tmp_path / "b")
        check_each([Run.load(tmp_path / "a")], [])

    def test_a_run_that_is_not_finished(self, tmp_path: Path) -> None:
        runs = measure()
        text = refused(tmp_path, [replace(runs[0], info={**runs[0].info, "outcome": "interrupted"}), *runs[1:]])
        assert text.startswith("run0: the run is not finished (outcome: interrupted); leave it out")

    @pytest.mark.parametrize("left", [400, 700])
    def test_a_repeat_that_was_aborted_is_named_and_the_others_are_used_in_full_length(self, left: int) -> None:
        runs = measure()
        (condition,), (finding,) = complete(sort_by_condition([runs[0], cut(runs[1], left), *runs[2:]], SYSTEM))
        assert [r.folder for r in condition.runs] == [runs[0].folder, *(r.folder for r in runs[2:])]
        assert condition.grid[-1] == pytest.approx(8.0, abs=ROUNDOFF)
        assert (finding.kind, finding.fatal, finding.repaired, finding.run) == ("short", False, True, "run1")
        assert finding.text == (
            f"is cut short: run1 has 0.000 to {0.01 * (left - 1):.3f} s; expected 0.000 to 8.000 s, as the repeats of 'amplitude 1.0': "
            "it was left out; record it anew"
        )

    def test_of_two_repeats_the_longer_one_is_whole(self) -> None:
        runs = measure()[:2]
        (condition,), _ = complete(sort_by_condition([cut(runs[0], 400), runs[1]], SYSTEM))
        assert [r.folder for r in condition.runs] == [runs[1].folder]

    def test_one_repeat_that_went_on_for_longer_does_not_make_the_others_short(self) -> None:
        runs = measure()[:3]
        (condition,), found = complete(sort_by_condition([runs[0], cut(runs[1], 400), cut(runs[2], 400)], SYSTEM))
        assert len(condition.runs) == 3
        assert found == []

    def test_the_diagnosis_says_who_was_left_out(self, tmp_path: Path) -> None:
        runs = measure()
        result = diagnose(SYSTEM, [runs[0], cut(runs[1], 400), *runs[2:]], catalogue(tmp_path), resolver=resolve).result
        assert result["verdict"] == "none"
        assert [(f["kind"], f["fatal"]) for f in result["gate"]["findings"]] == [("short", False)]

    def test_a_repeat_that_is_a_little_shorter_is_used_and_named(self) -> None:
        """5 % may be missing: doubled or halved, one of these two would change its answer."""
        runs = measure()
        for left, used in ((765, len(runs)), (755, len(runs) - 1)):
            (condition,), (finding,) = complete(sort_by_condition([cut(runs[0], left), *runs[1:]], SYSTEM))
            assert len(condition.runs) == used
            assert finding.kind == "short"
        assert complete(sort_by_condition([cut(runs[0], 798), *runs[1:]], SYSTEM))[1] == []


class TestProgram:
    """What a component plays that nothing goes into is known: the recording shows whether it was the same."""

    T = 0.01 * np.arange(800)

    def found(self, measured: FloatArray, simulated: FloatArray, latest: float = 0.3, changes: Sequence[FloatArray] = ()) -> list[str]:
        x, s = np.stack([measured, self.T], axis=1), np.stack([simulated, self.T], axis=1)
        r = replace(measure(repeats=1)[0], folder=Path("r1"))
        ports = {"path.x": r.ports["sensors.y[1]"], "drive.y": r.ports["sensors.y[1]"]}
        return [f.text for f in other_program(replace(r, ports=ports), x, s, list(ports), {"path"}, 0.01, latest, changes)]

    def test_the_same_late_and_rounded_is_the_same(self) -> None:
        s = np.sin(self.T)
        assert self.found(s, s) == []
        assert self.found(np.round(np.sin(self.T - 0.25), 3), s) == []
        assert self.found(np.full(800, 1.0001), np.ones(800)) == []

    def test_what_stands_still_but_for_rounding_is_as_large_as_it_is(self) -> None:
        """A spindle's speed: means of simulations differ in the last bit, logs are in single precision."""
        s = np.full(800, 1361.356816555577)
        s[::2] = np.nextafter(s[0], 2000.0)
        assert self.found(s.astype(np.float32).astype(float), s) == []
        assert len(self.found(1.15 * s, s)) == 1
        moving = s + 1e-3 * np.sin(self.T)  # what moves by more than that moves
        assert len(self.found(s, moving)) == 1

    def test_what_calibrated_numbers_may_change_is_the_same(self) -> None:
        """A program that hardly moves, with another tool frame: what is off is larger than the motion."""
        s = 1.0 + 1e-5 * np.sin(self.T)
        tolerance = np.stack([np.full(800, 3e-5), np.zeros(800)], axis=1)
        assert len(self.found(s + 2e-5, s)) == 1
        assert self.found(s + 2e-5, s, changes=[tolerance]) == []
        assert len(self.found(s + 4e-5, s, changes=[tolerance])) == 1

    def test_another_amplitude_place_or_time_is_another(self) -> None:
        s = np.sin(self.T)
        for other in (1.12 * s, s + 0.15, np.sin(self.T - 0.6), np.cos(3.0 * self.T)):
            (text,) = self.found(other, s)
            assert text.startswith("is not what the nominal system plays: r1 is")
            assert "another program, place or feed than [parameters] of its run.toml say?" in text
        assert len(self.found(np.full(800, 1.2), np.ones(800))) == 1

    def test_it_may_be_as_late_as_a_clock_of_the_catalogue(self) -> None:
        known = Catalogue.load(ROOT / "scenarios" / "catalogue.toml").candidates
        assert latest_clock(known) == 0.3
        assert latest_clock([c for c in known if c.effect != "clock_skew"]) == 0.0
        late, s = np.sin(self.T - 0.6), np.sin(self.T)
        assert [len(self.found(late, s, latest)) for latest in (0.0, 0.3, 0.7)] == [1, 1, 0]

    def test_the_diagnosis_stops_there(self, tmp_path: Path) -> None:
        """The force is recorded, but the runs say another amplitude than was played; with it as an effect it is no program."""
        played = run(SYSTEM.with_parameters("force", {"amplitude": 1.3}), None, stop=8.0, resolver=resolve)
        runs = [
            replace(r, columns={**r.columns, "force.f": played["force.f"]}, ports={**r.ports, "force.f": played.ports["force.f"]})
            for r in measure(amplitude=1.3)
        ]
        wrong = [replace(r, info={**r.info, "parameters": {"force": {"amplitude": 1.0}}}) for r in runs]
        result = diagnose(SYSTEM, wrong, catalogue(tmp_path), resolver=resolve).result
        assert result["verdict"] == "bad_log"
        assert ("force.f", "program") in [(f["channel"], f["kind"]) for f in result["gate"]["findings"]]
        right = diagnose(SYSTEM, runs, catalogue(tmp_path), resolver=resolve).result
        assert "program" not in [f["kind"] for f in right["gate"]["findings"]]
