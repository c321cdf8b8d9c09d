"""What predictors that are known to be right, or to guess, score: faults of the scorer would show here."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from robomill.blind.acceptance import ASKED, met
from robomill.blind.case import Case, Cases
from robomill.blind.criteria import location_names
from robomill.blind.effects import BY_KEY
from robomill.blind.figures import figures
from robomill.blind.generate import _subject as subject
from robomill.blind.prediction import Named, Prediction
from robomill.blind.sets import plans
from tests import ROOT
from tests.tolerances import ROUNDOFF

CATALOGUE = ROOT / "scenarios" / "catalogue.toml"
LAG = ("lag sensor.*", "force sensor")
CEILING = {
    "other cut": {"tool tip": 0.9, "force": 0.8, "torque": 0.9},
    "other place": {"tool tip": 0.8, "force": 0.7, "torque": 0.2},
}


def truths(count, seed, name="mixed"):
    """Truths as the generator writes them, without the simulations: all is detectable, closed by the truth as `CEILING` says."""
    found = []
    for plan in plans(name, count, seed):
        truth = subject(plan, "T1", np.random.default_rng([seed, plan.number]))[0]
        ratio = 0.0 if plan.kind == "null" else 20.0
        found.append(replace(truth, case=plan.number, repeats=plan.repeats, machine={}, detectability=ratio, ceiling=CEILING))
    return found


def entry(component, parameter, probability, value, spread=0.0):
    interval = [value - spread, value + spread]
    parameters = {parameter: {"value": value, "interval": interval, "unit": "1"}}
    return {"effect": parameter.partition("[")[0], "component": component, "probability": probability, "parameters": parameters}


def oracle(truth, random, ambiguous=False):
    """The truth as a diagnosis.json, with as much certainty as is right; 90 % of the intervals cover."""
    if truth.kind == "null":
        return {"verdict": "none"}
    if truth.kind == "bad_log":
        if truth.bad_log.kind == "lag" and random.random() < 0.5:  # a clock by its name stops the log too
            return {"verdict": "identified", "which": [entry("logging", LAG[0], 1.0, 0.02)]}
        return {"verdict": "bad_log", "gate": {"usable": False}}
    if truth.kind in ("outside", "withheld"):
        return {"verdict": "unknown"}
    if truth.kind == "formed":
        return {"verdict": "unknown", "form": {"specification": {"stands_for": truth.outside.component, "terms": [truth.outside.name]}}}
    which = []
    for e in truth.effects:
        covers = truth.case % 10 != 0
        which.append(entry(e.component, e.parameter, 1.0, e.value * (1.0 if covers else 1.02), 0.01 * abs(e.value)))
    where = [{"component": e.component, "share": 1.0 / len(which), "location": ""} for e in truth.effects]
    true = truth.effects[0].named
    if true.index:
        where[0]["location"] = location_names(true)[0]
    how_far = [{"on": "held-out condition", "channel": "compliance.p_BT_B", "closure": 0.85}]
    if ambiguous:
        other = entry("sensor", "hose_force", 0.5, 1.0) if true.effect != "hose_force" else entry("sensor", "weight_error", 0.5, 1.0)
        which = [{**which[0], "probability": 0.5}, other]
    verdict = "ambiguous" if ambiguous else "identified"
    return {"verdict": verdict, "which": which, "where": where, "how_far": how_far, "next_run": {"kind": "push"}}


def guess(truth, random):
    """Anything."""
    verdict = str(random.choice(["none", "identified", "ambiguous", "unknown", "bad_log"]))
    keys = random.choice([*BY_KEY], 3, replace=False)
    effects = [BY_KEY[k] for k in keys]
    which = [
        entry(e.component, f"{e.name}[{random.integers(1, e.size + 1)}]" if e.size else e.name, p, e.high, 0.01 * e.high)
        for e, p in zip(effects, (0.9, 0.06, 0.04), strict=True)
    ]
    return {"verdict": verdict, "which": which, "next_run": {"kind": "push"}}


def scores(predict, count=240, seed=7, name="mixed"):
    random = np.random.default_rng(seed)
    cases = [Case(i, t, Prediction.read(predict(t, random))) for i, t in enumerate(truths(count, seed, name), 1)]

    def closures(number, adopted):
        true = cases[number - 1].truth.effects
        right = all(e.parameter in adopted.get(e.component, {}) for e in true)
        return {name: {q: (1.0, 1.0 - v if right else 1.0) for q, v in of.items()} for name, of in CEILING.items()}

    def forms(number, form):
        right = form["terms"] == [cases[number - 1].truth.outside.name]
        return {name: {q: (1.0, 1.0 - v if right else 1.0) for q, v in of.items()} for name, of in CEILING.items()}

    decides = {"squared_gaps": closures, "separates": lambda number, run, wrong: run["kind"] == "push", "form_gaps": forms}
    return figures(Cases(cases, lambda number, i: []), "T1", **decides)


def test_who_knows_the_truth_meets_every_bound():
    found = scores(oracle)
    assert {k: found[k].value for k in ASKED["mixed"] if met(k, found[k].value, "T1") is False} == {}
    for key in ("effect_top1", "location_top1", "component_top1", "detection", "bad_log_stopped", "unknown_recall", "doubles_exact"):
        assert found[key].value == 1.0
        assert found[key].count > 10
    assert found["null_false_alarm"].value == found["good_log_stopped"].value == found["ece"].value == 0.0
    assert found["closure_over_ceiling_p10"].value == pytest.approx(1.0, rel=ROUNDOFF)
    assert found["ambiguity_holds_truth"].count == 0


@pytest.mark.parametrize("name", ASKED)
def test_who_knows_the_truth_meets_every_bound_of_every_set(name):
    found = scores(oracle, name=name)
    assert {k: found[k].value for k in ASKED[name] if met(k, found[k].value, "T1") is False} == {}
    without = [k for k in ASKED[name] if found[k].count == 0]
    assert all(k.startswith(("ambiguity", "next_run")) for k in without)


def test_a_form_closes_as_much_of_what_can_be_closed_as_it_is_right():
    key = "form_closure_over_ceiling_median"
    assert scores(oracle, name="formed")[key].value == pytest.approx(1.0, rel=ROUNDOFF)

    def other(truth, random):
        return {"verdict": "unknown", "form": {"specification": {"stands_for": "drive", "terms": ["another"]}}}

    for wrong in (
        other,
        lambda truth, random: {"verdict": "unknown"},
        lambda truth, random: {"verdict": "unknown", "form": {"specification": {}}},
    ):
        found = scores(wrong, name="formed")[key]
        assert (found.value, found.count > 10) == (0.0, True)


def test_who_guesses_finds_neither_machines_nor_stiffness_nor_what_is_withheld():
    for name, keys in {
        "machine": ("machine_found", "machine_true"),
        "campaign": ("stiffness_placed",),
        "withheld": ("withheld_unknown_or_equivalent", "withheld_confident_wrong"),
        "few": ("confident_wrong",),
        "null": ("null_false_alarm_1", "null_false_alarm_6"),
    }.items():
        found = scores(guess, name=name)
        assert [k for k in keys if met(k, found[k].value, "T1")] == []


def test_who_knows_the_truth_but_hedges_meets_the_bounds_of_sets():
    def hedging(truth, random):
        return oracle(truth, random, ambiguous=truth.kind == "single" and random.random() < 0.5)

    found = scores(hedging)
    for key in ("ambiguity_holds_truth", "ambiguity_median_size", "next_run_separates"):
        assert met(key, found[key].value, "T1")
        assert found[key].count > 20


def test_who_guesses_meets_none_of_the_bounds_that_take_knowledge():
    found = scores(guess)
    no_guess = {"parameter_error_median", "parameter_error_p90", "interval_coverage", "claimed_closure_error_median", "next_run_separates"}
    closures = {"closure_over_ceiling_median", "closure_over_ceiling_p10"}  # of cases that are named right, of which there are hardly any
    for key in set(ASKED["mixed"]) - no_guess - closures:
        assert met(key, found[key].value, "T1") is not True, key
    assert found["effect_top1"].value < 0.1


def test_a_clock_is_neither_physics_nor_nothing():
    clock = {"verdict": "identified", "which": [entry("logging", LAG[0], 1.0, 0.02)]}
    found = scores(lambda truth, random: clock)
    assert found["null_false_alarm"].value == 1.0
    assert found["detection"].value == 0.0
    assert found["good_log_stopped"].value == 1.0
    assert found["bad_log_stopped"].value == 1.0
    assert found["component_top1"].value == found["effect_top1"].value == 0.0


def test_places_are_called_as_in_the_catalogue_of_the_cell():
    listed = tomllib.loads(CATALOGUE.read_text(encoding="utf-8"))["effect"]
    for effect in listed:
        for place in effect["locations"]:
            named = Named.of(effect["component"], place["parameters"][0])
            if named.index:
                assert place["name"] in location_names(named)
