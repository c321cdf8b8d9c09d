"""What a case of `benchmarks.elsewhere` is worth, and that its cases are what their kind says."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.cells import CELLS, Cell
from benchmarks.elsewhere import SUBJECTS, Example, diagnosed, drawn, score
from tests.tolerances import chance

A, B, CLOCK = "axis.coulomb", "axis.backlash", "logging.lag encoder.*"


@pytest.mark.parametrize(
    ("kind", "verdict", "truth", "named", "listed", "worth"),
    [
        ("null", "none", set(), set(), set(), "right"),
        ("null", "identified", set(), {A}, {A}, "wrong"),
        ("null", "unknown", set(), set(), set(), "unknown"),
        ("single", "identified", {A}, {A}, {A}, "right"),
        ("single", "identified", {A}, {A, B}, {A, B}, "extra"),
        ("single", "identified", {A}, {B}, {A, B}, "wrong"),
        ("single", "ambiguous", {A}, set(), {A, B}, "set"),
        ("single", "none", {A}, set(), set(), "none"),
        ("single", "bad_log", {CLOCK}, set(), set(), "right"),
        ("single", "bad_log", {A}, set(), set(), "wrong"),
        ("double", "identified", {A, B}, {A}, {A}, "part"),
        ("withheld", "unknown", {A}, set(), set(), "right"),
        ("withheld", "identified", {A}, {B}, {B}, "wrong"),
        ("withheld", "bad_log", {CLOCK}, set(), set(), "wrong"),
        ("once", "identified", {A}, {A}, {A}, "right"),
    ],
)
def test_the_worth_of_an_answer(kind: str, verdict: str, truth: set[str], named: set[str], listed: set[str], worth: str) -> None:
    assert score(kind, verdict, truth, named, listed) == worth


def test_what_does_the_same_as_a_withheld_effect_is_a_right_name_for_it() -> None:
    assert score("withheld", "identified", {A}, {B}, {B}, {B}) == "right"
    assert score("withheld", "identified", {A}, {B, CLOCK}, {B, CLOCK}, {B}) == "wrong"
    assert score("single", "identified", {A}, {B}, {B}, {B}) == "wrong"


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda s: s.name)
def test_every_effect_of_a_machine_is_in_the_catalogue_of_its_system(subject: Example | Cell) -> None:
    known = {f"{c.component}.{c.named[0]}": c for c in subject.catalogue().candidates}
    for effect, usual in subject.usual.items():
        candidate = known[subject.parameter(effect)]
        assert candidate.minimum < abs(usual) < candidate.maximum
        assert candidate.both_signs or usual > 0.0


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda s: s.name)
def test_cases_are_drawn_by_their_seed(subject: Example | Cell) -> None:
    assert drawn(subject, "null", 1) == {}
    assert len(drawn(subject, "double", 1)) == 2
    ((name, value),) = drawn(subject, "single", 1).items()
    assert drawn(subject, "single", 1) == {name: value}
    assert math.log(abs(value / subject.usual[name])) != 0.0
    assert len({tuple(drawn(subject, "single", s)) for s in range(20)}) > 5


def test_the_machine_of_a_cell_is_as_its_seed_and_its_effects_say(tmp_path: Path) -> None:
    """Its numbers are off within the tolerances of the catalogue, and the effect comes on top: a bridge of the holder that shows more."""
    (cell,) = (c for c in CELLS if c.name == "kr500")
    (one, _), (other, held) = (cell.runs({}, 1, 2, tmp_path / "one"), cell.runs({}, 2, 1, tmp_path / "two"))
    (changed, _) = cell.runs({"sensor.bridge_gain_error[2]": 0.1}, 1, 1, tmp_path / "changed")
    bridge = [r["sensor.bridge"][:, 1] for r in (one[0], one[1], other[0], changed[0])]
    scatter, machines, effect = (float(np.sqrt(np.mean((x - bridge[0]) ** 2))) for x in bridge[1:])
    size = float(np.sqrt(np.mean(bridge[0] ** 2)))
    assert 0.0 < scatter < machines < effect
    assert abs(effect / size - 0.1) < chance(scatter / size)
    assert [r.folder.name for r in (*other, *held)] == ["slot-1", "elsewhere-1"]


@pytest.mark.slow
@pytest.mark.parametrize("cell", CELLS, ids=lambda c: c.name)
def test_a_cell_without_effects_has_none(cell: Cell, tmp_path: Path) -> None:
    """Noise in every component that has some, a tool frame that is 10 um off, a program that nearly stands still."""
    assert diagnosed(cell, "null", 1, tmp_path).verdict == "none"
