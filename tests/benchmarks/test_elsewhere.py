"""What a case of `benchmarks.elsewhere` is worth, and that its cases are what their kind says."""

from __future__ import annotations

import math

import pytest

from benchmarks.elsewhere import EXAMPLES, drawn, score
from robomill.diagnosis.catalogue import Catalogue

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


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.name)
def test_every_effect_of_a_machine_is_in_the_catalogue_of_its_example(example) -> None:
    machine, catalogue = example.machine(), Catalogue.load(example.folder / "catalogue.toml")
    known = {f"{c.component}.{c.named[0]}": c for c in catalogue.candidates}
    for effect, usual in machine.USUAL.items():
        candidate = known[example.parameter(effect, catalogue)]
        assert candidate.minimum < abs(usual) < candidate.maximum
        assert candidate.both_signs or usual > 0.0


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.name)
def test_cases_are_drawn_by_their_seed(example) -> None:
    machine = example.machine()
    assert drawn(example, machine, "null", 1) == {}
    assert len(drawn(example, machine, "double", 1)) == 2
    ((name, value),) = drawn(example, machine, "single", 1).items()
    assert drawn(example, machine, "single", 1) == {name: value}
    assert math.log(abs(value / machine.USUAL[name])) != 0.0
    assert len({tuple(drawn(example, machine, "single", s)) for s in range(20)}) > 5
