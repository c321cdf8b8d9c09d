"""What runs can show, on a system without robots: sizes that a diagnosis does find, twins, channels and repeats that would help."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from robomill.check_table import show
from robomill.diagnosis.check import Checked, Shown, _missing, check
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.store import Store
from robomill.diagnosis.outcome.answer import as_json
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import Component
from tests.diagnosis.demo import NOISE, RANGE, SYSTEM, catalogue, measure, resolve
from tests.diagnosis.outcome.test_next_run import TWINS, kinds


def checked(folder: Path, runs: list[Run], more: str = "", **options: Any) -> Checked:
    return check(Campaign.of(SYSTEM, runs), catalogue(folder, more), resolver=resolve, **options)


def of(found: Checked, effect: str, location: str) -> Shown:
    return next(e for e in found.effects if (e.effect, e.location) == (effect, location))


def noisy(factor: float, repeats: int = 4) -> list[Run]:
    """Runs with so many times the usual noise."""
    rng = np.random.default_rng(7)
    return [
        replace(r, columns={c: x + factor * NOISE * rng.normal(size=len(x)) for c, x in r.columns.items()})
        for r in measure(repeats=repeats)
    ]


FLOOR_LEFT = 0.05
"""Relative: the floor of the noise, 2 % of what effects do, is still a part of 500 times the noise of the instruments."""
FEW = 0.1
"""Relative: the variance of noise known from four repeats of 800 samples, and its correlation in time."""
MOVED_NOISE = 0.05
"""Relative: the autoregressive model of the noise is found anew from the repeats of another machine."""
NOISE_BESIDE = 0.02
"""Relative: beside a tolerance of 1 % the noise of four repeats counts little."""


class TestSmallest:
    def test_twice_the_noise_shows_only_twice_the_size(self, tmp_path: Path) -> None:
        """Where noise, and not the floor of 2 % or a tolerance, limits it."""
        once, twice = (of(checked(tmp_path, noisy(f)), "gain", "sensor 1") for f in (500.0, 1000.0))
        assert once.by_tolerance < 0.05
        assert twice.smallest / once.smallest == pytest.approx(2.0, rel=FLOOR_LEFT)

    def test_four_times_the_repeats_show_a_smaller_size(self, tmp_path: Path) -> None:
        """Half of it if there were noise alone; what is sudden is alike in all repeats."""
        few, many = (of(checked(tmp_path, noisy(50.0, n)), "gain", "sensor 1") for n in (4, 16))
        assert 1.4 < few.smallest / many.smallest < 2.0 * (1.0 + FEW)

    def test_a_diagnosis_sees_what_is_twice_as_large_and_not_what_is_a_fifth(self, tmp_path: Path) -> None:
        size = of(checked(tmp_path, measure(repeats=4)), "stiffness", "spring 1").smallest
        verdicts = []
        for factor in (0.2, 2.0):
            runs = measure({"masses": {"stiffness_error[1]": factor * size}}, repeats=4)
            verdicts.append(diagnose(SYSTEM, runs, catalogue(tmp_path, ""), resolver=resolve).result["verdict"] == "none")
        assert verdicts == [True, False]

    def test_it_does_not_depend_on_what_is_wrong_with_the_machine(self, tmp_path: Path) -> None:
        """Only the noise of the runs counts: nothing is fitted."""
        well, stiff = (checked(tmp_path, measure(truth, repeats=4)) for truth in (None, {"masses": {"stiffness_error[2]": 0.02}}))
        sizes = [of(c, "gain", "sensor 2").smallest for c in (well, stiff)]
        assert sizes[1] == pytest.approx(sizes[0], rel=MOVED_NOISE)

    def test_a_tolerance_of_the_same_number_is_not_seen_through(self, tmp_path: Path) -> None:
        tolerance = '[[nuisance]]\ncomponent = "sensors"\nparameters = ["gain_error[1]"]\nabsolute = 0.01\nunit = "1"\nsource = "made up"\n'
        found = of(checked(tmp_path, measure(repeats=4), tolerance), "gain", "sensor 1")
        assert found.smallest == pytest.approx(0.05, rel=NOISE_BESIDE)  # 5 x 0.01
        assert found.by_tolerance > 0.95
        assert found.repeats is None  # usual is 0.05, too: no number of repeats shows it
        assert found.state == "if large"

    def test_a_limit_shows_from_where_it_is_reached(self, tmp_path: Path) -> None:
        """By proportion to what it does at its largest it would show at a hundredth of that.

        What is cut off must be more than the discrepancy, too: not from the first tenth of the range that is cut, but from the first fifth.
        """
        runs = measure(repeats=3)
        reached = 1.0 - max(float(np.abs(x).max()) for x in runs[0].columns.values()) / 0.5
        found = of(checked(tmp_path, runs, RANGE), "range", "sensors")
        assert reached < found.smallest < reached + 0.2 * (1.0 - reached)


class TestSets:
    def test_twins_do_not_split_and_the_force_between_them_would_split_them(self, tmp_path: Path) -> None:
        found = checked(tmp_path, measure(repeats=3), TWINS)
        assert found.sets == (("actuator @ actuator", "scale @ sensors"),)
        twin = of(found, "actuator", "actuator")
        assert twin.confusable_with == ["scale @ sensors"]
        assert [h.name for h in twin.channels] == ["force.f", "masses.x"]
        assert of(found, "stiffness", "spring 1").confusable_with == []
        assert found.missing == ("channels: force.f would show or split 2",)

    def test_a_run_with_another_force_would_split_them_and_a_stronger_one_would_not(self, tmp_path: Path) -> None:
        heavy = [
            replace(k, quantities=tuple(replace(q, start=0.5 if q.name == "weight" else q.start) for q in k.quantities)) for k in kinds()
        ]
        twin = of(checked(tmp_path, measure(repeats=3), TWINS, kinds=heavy), "actuator", "actuator")
        assert [h.name for h in twin.runs] == ["hung", "hung, long"]  # the same, in fewer minutes
        assert twin.runs[0].distance == twin.runs[1].distance >= 3.0

    def test_where_the_force_is_measured_they_split(self, tmp_path: Path) -> None:
        rng, runs = np.random.default_rng(3), []
        clean = run(SYSTEM, None, stop=8.0, resolver=resolve)
        for r in measure(repeats=3):
            force = clean["force.f"] + 1e-3 * rng.normal(size=len(clean.t))
            runs.append(replace(r, columns={**r.columns, "force.f": force}, ports={**r.ports, "force.f": clean.ports["force.f"]}))
        assert checked(tmp_path, runs, TWINS).sets == ()


class TestMissing:
    def test_a_single_run_says_that_the_noise_is_a_guess(self, tmp_path: Path) -> None:
        found = checked(tmp_path, measure(repeats=1))
        assert found.noise_is_a_guess
        assert found.missing[0] == (
            "repeats: nothing was repeated, so the noise is a guess, and so is every size; make each run at least three times"
        )

    def test_what_is_driven_by_what_was_measured_cannot_be_repeated(self) -> None:
        driven = replace(SYSTEM, components=(*SYSTEM.components, Component("motion", "measured:run")))
        laboratory = cast(Any, SimpleNamespace(conditions=[SimpleNamespace(system=driven)], system=SYSTEM))
        guessed = cast(Any, SimpleNamespace(whitening=SimpleNamespace(guessed=True)))
        assert _missing(laboratory, {"one": 1}, guessed, ()) == [
            "repeats: each run is driven by what was measured in it and has none, so the noise is a guess, and so is every size"
        ]

    def test_what_repeats_would_show_is_said(self) -> None:
        known = cast(Any, SimpleNamespace(whitening=SimpleNamespace(guessed=False)))
        laboratory = cast(Any, SimpleNamespace(conditions=[], system=SYSTEM))
        one = Shown("gain", "a", "here", "g", "1", 2.0, 1.0, 9.0, 0.1, "if large", [], 8, [], [])
        said = [
            _missing(laboratory, {"one": 3}, known, effects)
            for effects in ((one,), (one, replace(one, location="there", repeats=12), replace(one, location="far", repeats=None)))
        ]
        assert said == [
            ["excitation: 1 of 1 do not show at their usual size; 1 of them would show with 8 repeats of each condition"],
            ["excitation: 3 of 3 do not show at their usual size; 2 of them would show with up to 12 repeats of each condition"],
        ]

    def test_repeats_that_are_asked_for_are_enough(self, tmp_path: Path) -> None:
        hidden = of(checked(tmp_path, noisy(800.0, 3)), "gain", "sensor 1")
        assert hidden.state == "if large"
        assert hidden.repeats is not None
        shown = of(checked(tmp_path, noisy(800.0, hidden.repeats + hidden.repeats // 5)), "gain", "sensor 1")
        assert shown.state == "shows"

    def test_what_changes_nothing_that_is_measured_is_named(self, tmp_path: Path) -> None:
        runs = [
            replace(r, columns={"sensors.y[1]": r.columns["sensors.y[1]"]}, ports={"sensors.y[1]": r.ports["sensors.y[1]"]})
            for r in measure(repeats=3)
        ]
        assert checked(tmp_path, runs).nothing == ("gain @ sensor 2", "clock @ second channel")


def test_the_simulations_serve_the_next_call(tmp_path: Path) -> None:
    store = Store(tmp_path / "simulations", "1")
    first, second = (checked(tmp_path, measure(repeats=3), TWINS, store=store) for _ in range(2))
    assert first.effort.simulations > 0
    assert (second.effort.simulations, second.effort.taken_over) == (0, first.effort.simulations)
    assert second.effects == first.effects


def test_screen_and_json_say_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = checked(tmp_path, measure(repeats=3), TWINS)
    capsys.readouterr()
    show(found)
    text = capsys.readouterr().out
    data = json.loads(as_json(found.result))
    assert data["schema"] == "robomill-check/1"
    assert len({e["effect"] for e in data["effects"]}) == 6
    for e in data["effects"]:
        assert e["effect"] in text
    assert "amplitude 1.0 (3 repeats)" in text
    assert "will not split: actuator @ actuator, scale @ sensors" in text
    assert "missing: channels: force.f would show or split 2" in text
