"""The scorer on predictions written by hand, whose scores can be counted."""

from __future__ import annotations

import hashlib
import json
import math

import pytest
from scipy import stats

from blind.generate import hashes
from blind.score import (
    BenchmarkError,
    Case,
    Named,
    Prediction,
    Scorer,
    calibration,
    freeze_predictions,
    load_cases,
    median,
    proportion,
    unseal,
    wilson,
)
from tests.tolerances import ROUNDOFF


def truth(kind, *effects, detectability=20.0, **more):
    listed = [
        {"component": c, "effect": p.partition("[")[0], "parameter": p, "index": Named.of(c, p).index, "value": v, "unit": "1"}
        for c, p, v in effects
    ]
    return {"kind": kind, "effects": listed, "detectability": detectability, **more}


def entry(component, parameter, probability, value=1.0, interval=(0.0, 2.0), confusable=()):
    parameters = {parameter: {"value": value, "interval": list(interval), "unit": "1"}}
    name = parameter.partition("[")[0]
    return {"effect": name, "component": component, "probability": probability, "parameters": parameters, "confusable_with": confusable}


def said(verdict, *which, **more):
    return Prediction.read({"verdict": verdict, "which": list(which), **more})


def cases(*pairs):
    return [Case(i, t["kind"], t, p) for i, (t, p) in enumerate(pairs, 1)]


STIFF = ("compliance", "stiffness_error[2]", 0.2)
GAIN = ("sensor", "sensor_gain_error", 0.1)


def test_wilson_is_the_interval_whose_ends_the_score_test_just_rejects():
    # by definition (Wilson 1927) |p_hat - p| = z sqrt(p (1 - p)/n) at both ends
    for hits, n in ((3, 10), (17, 20), (1, 200)):
        for p in wilson(hits, n):
            assert abs(hits / n - p) == pytest.approx(1.959963984540054 * math.sqrt(p * (1 - p) / n), rel=1e3 * ROUNDOFF)
    assert wilson(0, 10)[0] == 0.0
    assert wilson(10, 10)[1] == 1.0
    assert wilson(0, 0) == (0.0, 1.0)


def test_a_proportion_without_cases_has_no_value():
    assert proportion([]) == {"value": None, "count": 0, "interval": None}


def test_the_interval_of_a_median_is_that_of_the_order_statistics():
    values = list(range(1, 101))
    found = median(values)
    assert found["value"] == 50.5
    low, high = found["interval"]
    # the ranks of the binomial distribution, from scipy
    assert (low, high) == (stats.binom.ppf(0.025, 100, 0.5), stats.binom.ppf(0.975, 100, 0.5) + 1)
    assert median([3.0])["interval"] is None


def test_calibration_error_of_an_answer_that_is_right_as_often_as_it_says_is_zero():
    assert calibration([0.75] * 4, [True, True, True, False])["value"] == 0.0
    assert calibration([0.95] * 10 + [0.55] * 10, [True] * 5 + [False] * 5 + [True] * 10)["value"] == pytest.approx(0.45)


def test_nulls_bad_logs_and_unknowns_are_counted_by_verdict():
    scores = Scorer(
        cases(
            (truth("null", detectability=0.0), said("none")),
            (truth("null", detectability=0.0), said("identified", entry("drive", "backlash[1]", 0.9))),
            (truth("null", detectability=0.0), said("missing")),
            (truth("bad_log", bad_log={"kind": "lag"}), said("bad_log")),
            (truth("bad_log", bad_log={"kind": "sign"}), said("unknown")),
            (truth("outside", outside={"name": "creep"}), said("unknown")),
            (truth("outside", outside={"name": "creep"}), said("identified", entry("drive", "backlash[1]", 0.9))),
            (truth("outside", outside={"name": "creep"}, detectability=0.1), said("none")),
            (truth("single", GAIN), said("unknown")),
            (truth("single", GAIN), said("identified", entry("sensor", "sensor_gain_error", 0.9))),
        )
    ).scores()
    assert (scores["null_false_alarm"]["value"], scores["null_false_alarm"]["count"]) == (2 / 3, 3)
    assert (scores["bad_log_stopped"]["value"], scores["bad_log_stopped"]["count"]) == (0.5, 2)
    assert (scores["unknown_recall"]["value"], scores["unknown_recall"]["count"]) == (0.5, 2)
    assert scores["confident_wrong_on_unknown"]["value"] == 0.5
    assert (scores["false_unknown"]["value"], scores["false_unknown"]["count"]) == (0.5, 2)
    assert (scores["detection"]["value"], scores["detection"]["count"]) == (1.0, 4)


def test_effects_are_known_by_component_and_parameter_whatever_they_are_called():
    other_names = {**entry("robot_compliance", "stiffness_error[2]", 0.9), "effect": "joint_stiffness_error"}
    scores = Scorer(cases((truth("single", STIFF), said("identified", other_names)))).scores()
    assert scores["effect_top1"]["value"] == scores["component_top1"]["value"] == scores["location_top1"]["value"] == 1.0


def test_ranks_components_and_locations():
    first, second = entry("sensor", "sensor_gain_error", 0.6), entry("compliance", "stiffness_error[2]", 0.3)
    where = [
        {"component": "sensor", "share": 0.2, "location": "all channels"},
        {"component": "compliance", "share": 0.7, "location": "joint 2"},
    ]
    scores = Scorer(
        cases(
            (truth("single", STIFF), said("ambiguous", first, second, where=where)),
            (truth("single", STIFF), said("ambiguous", first, where=[{"component": "compliance", "share": 1.0, "location": "joint 3"}])),
            (truth("single", STIFF), said("none", second)),
            (truth("single", STIFF, detectability=0.5), said("none")),
        )
    ).scores()
    assert (scores["effect_top1"]["value"], scores["effect_top1"]["count"]) == (0.0, 3)
    assert scores["effect_top3"]["value"] == 1 / 3
    assert scores["component_top1"]["value"] == 2 / 3
    assert scores["location_top1"]["value"] == 1 / 3


def test_a_set_holds_the_truth_as_a_member_or_as_what_cannot_be_told_from_one():
    member = said("ambiguous", entry("sensor", "sensor_gain_error", 0.6), entry("compliance", "stiffness_error[2]", 0.3))
    beside = said("ambiguous", entry("compliance", "tilt_compliance[2]", 0.9, confusable=["stiffness_error at joint 2"]))
    without = said("ambiguous", entry("drive", "backlash[1]", 0.5), entry("compliance", "stiffness_error[2]", 0.001))
    scores = Scorer(cases(*((truth("single", STIFF), p) for p in (member, beside, without)))).scores()
    assert scores["ambiguity_holds_truth"]["value"] == 2 / 3
    assert scores["ambiguity_median_size"]["value"] == 1.0


def test_doubles_are_exact_partly_right_or_invented():
    two = truth("double", STIFF, GAIN)
    a, b = entry("compliance", "stiffness_error[2]", 0.9), entry("sensor", "sensor_gain_error", 0.8)
    invented = entry("milling", "tool_wear", 0.7)
    scores = Scorer(
        cases((two, said("identified", a, b)), (two, said("identified", a)), (two, said("identified", a, b, invented)), (two, said("none")))
    ).scores()
    assert scores["doubles_exact"]["value"] == 0.25
    assert scores["doubles_one_right"]["value"] == 0.75
    assert scores["doubles_nothing_invented"]["value"] == 0.75


def test_parameter_errors_and_coverage_are_those_of_the_cases_that_are_named_right():
    right = said("identified", entry("compliance", "stiffness_error[2]", 0.9, 0.22, (0.15, 0.25)))
    off = said("identified", entry("compliance", "stiffness_error[2]", 0.9, 0.30, (0.28, 0.32)))
    elsewhere = said("identified", entry("compliance", "stiffness_error[3]", 0.9, 0.20))
    scores = Scorer(cases(*((truth("single", STIFF), p) for p in (right, off, elsewhere)))).scores()
    assert scores["parameter_error_median"]["count"] == 2
    assert scores["parameter_error_median"]["value"] == pytest.approx(0.5 * (0.1 + 0.5))
    assert scores["interval_coverage"]["value"] == 0.5


def test_closure_is_that_of_the_claimed_parameters_over_that_of_the_true_ones():
    seen = {}

    def closures(number, adopted):
        seen[number] = adopted
        return {"other cut": (100.0, 28.0), "other place": (100.0, 90.0)}

    ceiling = {"other cut": {"tool tip": 0.9, "force": 0.1}, "other place": {"tool tip": 0.2, "force": 0.1}}
    claim = [
        {"on": "diagnosed runs", "channel": "compliance.p_BT_B", "closure": 0.99},
        {"on": "held-out condition", "channel": "sensor.f_T_T", "closure": 0.1},
        {"on": "held-out condition", "channel": "compliance.p_BT_B", "closure": 0.45},
    ]
    p = said("identified", entry("compliance", "stiffness_error[2]", 0.9, 0.22), how_far=claim)
    scores = Scorer(cases((truth("single", STIFF, ceiling=ceiling), p)), "T1", closures).scores()
    assert seen == {1: {"compliance": {"stiffness_error[2]": 0.22}}}
    assert scores["closure_over_ceiling_median"]["value"] == pytest.approx(0.8)  # the other place cannot be closed even by the truth
    assert scores["claimed_closure_error_median"]["value"] == pytest.approx(0.04)  # of 1 - 118/200


def test_cases_that_the_data_cannot_decide_are_left_out_of_the_naming_scores():
    p = said("identified", entry("sensor", "sensor_gain_error", 0.9))
    scorer = Scorer(
        cases((truth("single", STIFF), p), (truth("single", GAIN), p)), confusable=lambda n, i: ["compliance.x"] if n == 1 else []
    )
    scores = scorer.scores()
    assert (scores["effect_top1"]["value"], scores["effect_top1"]["count"]) == (1.0, 1)
    assert scores["detection"]["count"] == 2


def test_the_confusion_matrix_counts_what_was_said_first():
    p = said("identified", entry("sensor", "sensor_gain_error", 0.9))
    scorer = Scorer(
        cases(
            (truth("single", STIFF), p),
            (truth("single", STIFF), said("none")),
            (truth("single", GAIN), p),
            (truth("null"), said("none")),
            (truth("outside", outside={"name": "creep"}), said("unknown")),
        )
    )
    assert scorer.confusion() == {
        "compliance.stiffness_error": {"sensor.sensor_gain_error": 1, "none": 1},
        "sensor.sensor_gain_error": {"sensor.sensor_gain_error": 1},
        "null": {"none": 1},
        "outside: creep": {"unknown": 1},
    }
    assert scorer.per_effect()["compliance.stiffness_error"] == {
        "cases": 2,
        "detectable": 2,
        "isolable": 2,
        "detected": 1,
        "named": 0,
        "named_top3": 0,
    }


def test_strata_follow_the_oracle():
    strata = Scorer(
        cases((truth("single", GAIN, detectability=0.4), said("none")), (truth("single", GAIN, detectability=4.0), said("unknown")))
    ).strata()
    assert strata["hidden, below 1"]["detection"]["value"] == 0.0
    assert strata["clear, 3 to 10"]["detection"]["value"] == 1.0


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "cases" / "0001").mkdir(parents=True)
    (tmp_path / "cases" / "0001" / "system.toml").write_text("x = 1\n")
    (tmp_path / "sealed").mkdir()
    (tmp_path / "sealed" / "0001.json").write_text(json.dumps(truth("null", detectability=0.0)))
    manifest = json.dumps(hashes(tmp_path / "sealed"))
    (tmp_path / "sealed" / "manifest.json").write_text(manifest)
    head = {"tier": "T1", "truth": hashlib.sha256(manifest.encode()).hexdigest(), "files": hashes(tmp_path / "cases")}
    (tmp_path / "benchmark.json").write_text(json.dumps(head))
    (tmp_path / "predictions" / "0001").mkdir(parents=True)
    (tmp_path / "predictions" / "0001" / "diagnosis.json").write_text(json.dumps({"verdict": "none"}))
    return tmp_path


def test_predictions_are_hashed_before_the_truth_is_opened_and_later_changes_show(folder):
    frozen, first = freeze_predictions(folder)
    assert first
    assert frozen["0001/diagnosis.json"] == hashlib.sha256(b'{"verdict": "none"}').hexdigest()
    (folder / "predictions" / "0001" / "diagnosis.json").write_text(json.dumps({"verdict": "unknown"}))
    assert not freeze_predictions(folder)[1]


def test_what_an_interrupted_diagnosis_left_is_no_prediction(folder):
    (folder / "predictions" / ".0002.part").mkdir()
    (folder / "predictions" / ".0002.part" / "diagnosis.json").write_text("{}")
    assert list(freeze_predictions(folder)[0]) == ["0001/diagnosis.json"]


def test_a_truth_that_was_changed_is_refused(folder):
    assert load_cases(folder, unseal(folder)[1])[0].prediction.verdict == "none"
    (folder / "sealed" / "0001.json").write_text(json.dumps(truth("single", GAIN)))
    with pytest.raises(BenchmarkError, match=r"files differ from manifest\.json: the truth was changed"):
        unseal(folder)


def test_cases_that_were_changed_are_refused(folder):
    (folder / "cases" / "0001" / "system.toml").write_text("x = 2\n")
    with pytest.raises(BenchmarkError, match=r"changed since it was made: 0001/system\.toml"):
        unseal(folder)


def test_an_unreadable_prediction_is_missing(folder):
    (folder / "predictions" / "0001" / "diagnosis.json").write_text("{")
    assert load_cases(folder, unseal(folder)[1])[0].prediction.verdict == "missing"


def test_no_benchmark_says_how_to_make_one(tmp_path):
    with pytest.raises(BenchmarkError, match="robomill blind make"):
        unseal(tmp_path)


def test_scores_are_plain_json(folder):
    scores = json.loads(json.dumps(Scorer(load_cases(folder, unseal(folder)[1])).scores(), allow_nan=False))
    assert scores["null_false_alarm"] == {"value": 0.0, "count": 1, "interval": list(wilson(0, 1))}
