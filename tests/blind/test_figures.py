"""robomill.blind.figures and robomill.blind.tables on predictions written by hand, whose scores can be counted."""

from __future__ import annotations

import pytest

from robomill.blind.baselines import Guess
from robomill.blind.figures import baseline_figures, figures
from robomill.blind.results import EffectCounts
from robomill.blind.tables import confusion, per_effect, strata
from tests.blind.by_hand import GAIN, STIFF, cases, entry, said, truth
from tests.tolerances import ROUNDOFF


def test_nulls_bad_logs_and_unknowns_are_counted_by_verdict():
    scores = figures(
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
    )
    assert (scores["null_false_alarm"].value, scores["null_false_alarm"].count) == (2 / 3, 3)
    assert (scores["bad_log_stopped"].value, scores["bad_log_stopped"].count) == (0.5, 2)
    assert (scores["unknown_recall"].value, scores["unknown_recall"].count) == (0.5, 2)
    assert scores["confident_wrong_on_unknown"].value == 0.5
    assert (scores["false_unknown"].value, scores["false_unknown"].count) == (0.5, 2)
    assert (scores["detection"].value, scores["detection"].count) == (1.0, 4)


@pytest.mark.parametrize(
    ("kind", "findings", "stopped"),
    [
        ("aborted", [{"kind": "short", "run": "deep-slot-2", "repaired": True}], 1.0),
        ("aborted", [{"kind": "short", "run": "deep-slot-2", "repaired": False}], 0.0),  # it makes the others shorter
        ("aborted", [{"kind": "short", "run": "deep-slot-1", "repaired": True}], 0.0),
        ("aborted", [{"kind": "short", "run": f"deep-slot-{i}", "repaired": True} for i in (1, 2)], 0.0),
        ("aborted", [{"kind": "repeat", "run": "deep-slot-2", "repaired": True}], 0.0),
        ("aborted", [], 0.0),
        ("sign", [{"kind": "short", "run": "deep-slot-2", "repaired": True}], 0.0),
    ],
)
def test_an_aborted_repeat_that_is_named_and_left_out_does_no_harm(kind, findings, stopped):
    told = truth("bad_log", bad_log={"kind": kind}, repeats=2, conditions=[{"name": "deep slot", "position": [0, 0, 0], "turn": 0.0}])
    scores = figures(cases((told, said("none", gate={"findings": findings}))))
    assert scores["bad_log_stopped"].value == scores["bad_log_stopped_of_all"].value == stopped


def test_effects_are_known_by_component_and_parameter_whatever_they_are_called():
    other_names = {**entry("robot_compliance", "stiffness_error[2]", 0.9), "effect": "joint_stiffness_error"}
    scores = figures(cases((truth("single", STIFF), said("identified", other_names))))
    assert scores["effect_top1"].value == scores["component_top1"].value == scores["location_top1"].value == 1.0


def test_ranks_components_and_locations():
    first, second = entry("sensor", "sensor_gain_error", 0.6), entry("compliance", "stiffness_error[2]", 0.3)
    where = [
        {"component": "sensor", "share": 0.2, "location": "all channels"},
        {"component": "compliance", "share": 0.7, "location": "joint 2"},
    ]
    scores = figures(
        cases(
            (truth("single", STIFF), said("ambiguous", first, second, where=where)),
            (truth("single", STIFF), said("ambiguous", first, where=[{"component": "compliance", "share": 1.0, "location": "joint 3"}])),
            (truth("single", STIFF), said("none", second)),
            (truth("single", STIFF, detectability=0.5), said("none")),
        )
    )
    assert (scores["effect_top1"].value, scores["effect_top1"].count) == (0.0, 3)
    assert scores["effect_top3"].value == 1 / 3
    assert scores["component_top1"].value == 2 / 3
    assert scores["location_top1"].value == 1 / 3


def test_a_set_holds_the_truth_as_a_member_or_as_what_cannot_be_told_from_one():
    member = said("ambiguous", entry("sensor", "sensor_gain_error", 0.6), entry("compliance", "stiffness_error[2]", 0.3))
    beside = said("ambiguous", entry("compliance", "tilt_compliance[2]", 0.9, confusable=["stiffness_error at joint 2"]))
    without = said("ambiguous", entry("drive", "backlash[1]", 0.5), entry("compliance", "stiffness_error[2]", 0.001))
    scores = figures(cases(*((truth("single", STIFF), p) for p in (member, beside, without))))
    assert scores["ambiguity_holds_truth"].value == 2 / 3
    assert scores["ambiguity_median_size"].value == 1.0


def test_doubles_are_exact_partly_right_or_invented():
    two = truth("double", STIFF, GAIN)
    a, b = entry("compliance", "stiffness_error[2]", 0.9), entry("sensor", "sensor_gain_error", 0.8)
    invented = entry("milling", "tool_wear", 0.7)
    scores = figures(
        cases((two, said("identified", a, b)), (two, said("identified", a)), (two, said("identified", a, b, invented)), (two, said("none")))
    )
    assert scores["doubles_exact"].value == 0.25
    assert scores["doubles_one_right"].value == 0.75
    assert scores["doubles_nothing_invented"].value == 0.75


def test_parameter_errors_and_coverage_are_those_of_the_cases_that_are_named_right():
    right = said("identified", entry("compliance", "stiffness_error[2]", 0.9, 0.22, (0.15, 0.25)))
    off = said("identified", entry("compliance", "stiffness_error[2]", 0.9, 0.30, (0.28, 0.32)))
    elsewhere = said("identified", entry("compliance", "stiffness_error[3]", 0.9, 0.20))
    scores = figures(cases(*((truth("single", STIFF), p) for p in (right, off, elsewhere))))
    assert scores["parameter_error_median"].count == 2
    assert scores["parameter_error_median"].value == pytest.approx(0.5 * (0.1 + 0.5), rel=ROUNDOFF)
    assert scores["interval_coverage"].value == 0.5


def test_closure_is_that_of_the_claimed_parameters_over_that_of_the_true_ones():
    seen = {}

    def closures(number, adopted):
        seen[number] = adopted
        return {"other cut": {"tool tip": (100.0, 28.0)}, "other place": {"tool tip": (100.0, 90.0)}}

    ceiling = {"other cut": {"tool tip": 0.9, "force": 0.1}, "other place": {"tool tip": 0.2, "force": 0.1}}
    claim = [
        {"on": "diagnosed runs", "channel": "compliance.p_BT_B", "closure": 0.99},
        {"on": "held-out condition", "channel": "sensor.f_T_T", "closure": 0.1},
        {"on": "held-out condition", "channel": "compliance.p_BT_B", "closure": 0.45},
    ]
    p = said("identified", entry("compliance", "stiffness_error[2]", 0.9, 0.22), how_far=claim)
    scores = figures(cases((truth("single", STIFF, ceiling=ceiling), p)), "T1", closures)
    assert seen == {1: {"compliance": {"stiffness_error[2]": 0.22}}}
    assert scores["closure_over_ceiling_median"].value == pytest.approx(
        0.8, rel=ROUNDOFF
    )  # the other place cannot be closed even by the truth
    assert scores["claimed_closure_error_median"].value == pytest.approx(0.04, rel=ROUNDOFF)  # of 1 - 118/200


def test_cases_that_the_data_cannot_decide_are_left_out_of_the_naming_scores():
    p = said("identified", entry("sensor", "sensor_gain_error", 0.9))
    pairs = (truth("single", STIFF), p), (truth("single", GAIN), p)
    scores = figures(cases(*pairs, confusable=lambda n, i: ["compliance.x"] if n == 1 else []))
    assert (scores["effect_top1"].value, scores["effect_top1"].count) == (1.0, 1)
    assert scores["detection"].count == 2


def test_the_confusion_matrix_counts_what_was_said_first():
    p = said("identified", entry("sensor", "sensor_gain_error", 0.9))
    found = cases(
        (truth("single", STIFF), p),
        (truth("single", STIFF), said("none")),
        (truth("single", GAIN), p),
        (truth("null"), said("none")),
        (truth("outside", outside={"name": "creep"}), said("unknown")),
    )
    assert confusion(found) == {
        "compliance.stiffness_error": {"sensor.sensor_gain_error": 1, "none": 1},
        "sensor.sensor_gain_error": {"sensor.sensor_gain_error": 1},
        "null": {"none": 1},
        "outside: creep": {"unknown": 1},
    }
    assert per_effect(found)["compliance.stiffness_error"] == EffectCounts(
        cases=2, detectable=2, isolable=2, detected=1, named=0, named_top3=0
    )


def test_strata_follow_the_oracle():
    found = strata(
        cases((truth("single", GAIN, detectability=0.4), said("none")), (truth("single", GAIN, detectability=4.0), said("unknown")))
    )
    assert found["hidden, below 1"]["detection"].value == 0.0
    assert found["clear, 3 to 10"]["detection"].value == 1.0


def test_a_right_answer_is_none_where_nothing_is_the_effect_where_it_is_and_unknown_where_it_is_in_no_catalogue():
    stiff = entry(STIFF[0], STIFF[1], 0.9)
    listed = cases(
        (truth("null", detectability=0.0), said("none")),
        (truth("null", detectability=0.0), said("unknown")),
        (truth("single", STIFF), said("identified", stiff)),
        (truth("single", GAIN), said("identified", stiff)),
        (truth("outside"), said("unknown")),
        (truth("outside"), said("identified", stiff)),
        (truth("single", GAIN, detectability=1.0), said("none")),  # nobody can know
    )
    assert (figures(listed)["right_answer"].value, figures(listed)["right_answer"].count) == (0.5, 6)
    # who always names the stiffness is right once, who always says nothing twice
    always = {c.number: Guess("compliance.stiffness_error", 2) for c in listed.all}
    nothing = {c.number: Guess(None) for c in listed.all}
    assert baseline_figures(listed, always)["right_answer"].value == pytest.approx(1 / 6, rel=ROUNDOFF)
    assert baseline_figures(listed, nothing)["right_answer"].value == pytest.approx(2 / 6, rel=ROUNDOFF)
