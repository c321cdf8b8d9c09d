"""What more candidates, more data, fewer repeats and a catalogue without the truth do to an answer; and four effects at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.inference.evidence import FORM
from robomill.orchestration.runs.run import Run
from tests.diagnosis.demo import RANGE, SYSTEM, WELL, catalogue, measure, resolve
from tests.diagnosis.test_masquerade import TRUTHS

STIFF = {"masses": {"stiffness_error[2]": -0.08}}
SMALL = {"sensors": {"gain_error[1]": 0.004}}
"""A gain of which noise and tolerances, not the form of the effect, say how well it is known."""
FLOOR = 0.05
"""Part of an interval: the floor of the noise is TRUST of the median of what all effects do, which six more move by a few per cent."""
INDIFFERENT = 0.01
"""Probability: what is below it is not even listed."""
_ENTRY = """
[[effect]]
name = "{name}"
component = "{component}"
description = "nothing of that kind is there"
source = "made up"
unit = "{unit}"
minimum = {minimum}
maximum = {maximum}
sign = "both"
prior = {{kind = "normal", scale = {scale}}}
locations = [{{name = "there", parameters = ["{parameter}"]}}]
"""
_IRRELEVANT: tuple[dict[str, Any], ...] = (
    {"name": "hardening", "component": "masses", "unit": "N/m3", "minimum": 1.0, "maximum": 1e5, "scale": 500.0, "parameter": "cubic"},
    {"name": "force gain", "component": "force", "unit": "1", "minimum": 2e-3, "maximum": 0.5, "scale": 0.05, "parameter": "gain_error"},
    {
        "name": "filter",
        "component": "logging",
        "unit": "s",
        "minimum": 1e-4,
        "maximum": 0.2,
        "scale": 0.02,
        "parameter": "smooth sensors.*",
    },
    {
        "name": "zero",
        "component": "logging",
        "unit": "m",
        "minimum": 1e-5,
        "maximum": 0.1,
        "scale": 1e-3,
        "parameter": "offset sensors.y[1]",
    },
    {
        "name": "log gain",
        "component": "logging",
        "unit": "1",
        "minimum": 0.01,
        "maximum": 0.5,
        "scale": 0.1,
        "parameter": "gain sensors.y[1]",
    },
)
IRRELEVANT = RANGE + "".join(_ENTRY.format(**entry) for entry in _IRRELEVANT)


def answer(runs: list[Run], found: Catalogue, **more: Any) -> dict[str, Any]:
    return diagnose(SYSTEM, runs, found, resolver=resolve, **more).result


def first(result: Mapping[str, Any]) -> tuple[float, float]:
    """Value and half of the interval of the only parameter of the likeliest effect."""
    (estimate,) = result["which"][0]["parameters"].values()
    return estimate["value"], 0.5 * (estimate["interval"][1] - estimate["interval"][0])


@pytest.mark.parametrize("truth", [STIFF, {"sensors": {"gain_error[2]": 0.03}}, None], ids=["stiffness", "gain", "nothing"])
def test_candidates_that_are_not_there_do_not_change_the_answer(tmp_path: Path, truth: Any) -> None:
    """Six more kinds; they only change of what sizes the floor of the noise is made."""
    runs = measure(truth)
    few, many = (answer(runs, catalogue(tmp_path, more)) for more in ("", IRRELEVANT))
    assert many["verdict"] == few["verdict"] == ("none" if truth is None else "identified")
    assert [(w["effect"], w["location"]) for w in many["which"]] == [(w["effect"], w["location"]) for w in few["which"]]
    for one, other in zip(few["which"], many["which"], strict=True):
        assert other["probability"] == pytest.approx(one["probability"], abs=INDIFFERENT)
    if truth is not None:
        (value, half), (other_value, other_half) = first(few), first(many)
        assert other_value == pytest.approx(value, abs=FLOOR * half)
        assert other_half == pytest.approx(half, rel=2.0 * FLOOR)


def test_the_more_repeats_the_narrower_the_interval_and_one_is_wider_than_three(tmp_path: Path) -> None:
    """Noise by the root of the number; tolerances, the discrepancy that they make, and the form of the effect not at all."""
    known = {n: first(answer(measure(SMALL, repeats=n), catalogue(tmp_path))) for n in (1, 3, 6)}
    for value, half in known.values():
        assert abs(value - 0.004) < half
    assert known[1][1] > known[3][1] > known[6][1] > known[3][1] / 2.0**0.5


def by_noise(value: float, half: float) -> float:
    """Standard deviation that an interval has by noise and tolerances: without that by the form of the effect, FORM of the value."""
    return math.sqrt((half / 1.645) ** 2 - (FORM * value) ** 2)


@pytest.mark.parametrize(("seconds", "least"), [(7.0, 0.75), (8.0, 1.0)], ids=["all samples", "averaged in blocks"])
def test_twice_the_data_narrows_the_interval(tmp_path: Path, seconds: float, least: float) -> None:
    """A second condition that is nearly the first: by the root of two; two of 8 s have more than ROWS samples, and gain less."""
    one = measure(SMALL, seconds=seconds)
    two = [*one, *measure(SMALL, seconds=seconds, amplitude=1.001, seed=2)]
    found, before = first(answer(two, catalogue(tmp_path))), first(answer(one, catalogue(tmp_path)))
    assert found[1] < before[1]
    assert 0.69 < by_noise(*found) / by_noise(*before) < least
    assert abs(found[0] - 0.004) < found[1]


def without_the_truth(folder: Path, true: str, held: float | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """The answers of the whole catalogue and of one without the true effect; `held`: amplitude of a new condition."""
    component, parameter, value = TRUTHS[true]
    truth = {component: {parameter: value}}
    other = [] if held is None else measure(truth, amplitude=held, repeats=2, seed=2)
    full = catalogue(folder)
    less = replace(full, candidates=tuple(c for c in full.candidates if c.name != true))
    assert len(less.candidates) == len(full.candidates) - 1
    whole, rest = (answer(measure(truth), known, held_out=other) for known in (full, less))
    return whole, rest


def never_surer(whole: Mapping[str, Any], rest: Mapping[str, Any]) -> None:
    assert whole["verdict"] == "identified"
    assert rest["tests"]["p_fit"] < whole["tests"]["p_fit"]
    assert max((w["probability"] for w in rest["which"]), default=0.0) < whole["which"][0]["probability"]


def test_a_catalogue_without_the_truth_is_never_surer(tmp_path: Path) -> None:
    """In this small system two clocks, two gains and the other spring do together what a spring does: docs/explanation/limits.md."""
    never_surer(*without_the_truth(tmp_path, "stiffness @ spring 2", None))


@pytest.mark.slow
@pytest.mark.parametrize("held", [None, 0.4], ids=["same", "new"])
@pytest.mark.parametrize("true", TRUTHS)
def test_a_catalogue_without_the_truth_is_never_surer_whatever_that_is(tmp_path: Path, true: str, held: float | None) -> None:
    whole, rest = without_the_truth(tmp_path, true, held)
    never_surer(whole, rest)
    if true.startswith("friction"):  # what nothing else in the catalogue does
        assert rest["verdict"] == "unknown"


FOUR = (
    {"masses": {"stiffness_error[1]": 0.05, "stiffness_error[2]": -0.08, "friction[1]": 0.05}, "sensors": {"gain_error[1]": 0.04}},
    {"masses": {"stiffness_error[1]": 0.05, "friction[1]": 0.03, "friction[2]": 0.05}, "sensors": {"gain_error[2]": -0.04}},
)


@pytest.mark.slow
@pytest.mark.parametrize("truth", FOUR, ids=["two springs", "two frictions"])
def test_four_effects_at_once_are_found_with_their_sizes_and_no_other(tmp_path: Path, truth: Mapping[str, Mapping[str, float]]) -> None:
    runs = measure(truth) + measure(truth, amplitude=0.6, seed=2)
    result = answer(runs, catalogue(tmp_path), held_out=measure(truth, amplitude=1.5, repeats=2, seed=3))
    assert result["verdict"] == "identified"
    found = {(w["component"], name): e for w in result["which"] for name, e in w["parameters"].items()}
    true = {(component, name): value for component, values in truth.items() for name, value in values.items()}
    assert found.keys() == true.keys()
    for address, estimate in found.items():
        assert estimate["value"] == pytest.approx(true[address], rel=WELL)
        assert estimate["interval"][0] < true[address] < estimate["interval"][1]
    (new,) = (h for h in result["how_far"] if h["on"] == "held-out condition" and h["channel"] == "sensors.y")
    assert new["closure"] > 0.99
