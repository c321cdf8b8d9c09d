"""Figures of the sets on predictions written by hand."""

from __future__ import annotations

import pytest

from robomill.blind.figures import figures
from robomill.blind.set_figures import claims
from tests.blind.by_hand import GAIN, STIFF, cases, entry, said, truth
from tests.tolerances import ROUNDOFF

ALIKE = ("compliance.payload_error", "logging.lag sensor")


def test_a_withheld_effect_is_unknown_or_in_a_set_with_an_equivalent():
    payload, gain = entry("compliance", "payload_error", 0.6), entry("sensor", "sensor_gain_error", 0.4)
    clock = entry("logging", "lag sensor.*", 0.9)
    answers = (
        said("unknown"),
        said("identified", payload),
        said("ambiguous", gain, payload),
        said("identified", clock),
        said("ambiguous", gain),
        said("identified", gain),
        said("none"),
        said("bad_log"),
    )
    listed = cases(
        *((truth("withheld", STIFF), p) for p in answers), (truth("withheld", STIFF, detectability=1.0), said("identified", gain))
    )
    found = figures(listed, equivalents=lambda number: ALIKE)
    assert (found["withheld_unknown_or_equivalent"].value, found["withheld_unknown_or_equivalent"].count) == (0.5, 8)
    assert found["withheld_unknown"].value == 1 / 8
    assert found["withheld_confident_wrong"].value == 1 / 8
    assert found["withheld_with_equivalents"].value == 1.0
    whole = figures(listed, equivalents=lambda number: ALIKE, same=lambda c: c.prediction.which[-1].component == "sensor")
    assert whole["withheld_unknown_or_equivalent"].value == 6 / 8  # an answer that names nothing does nothing
    assert whole["withheld_confident_wrong"].value == 0.0
    assert whole["withheld_same_together"].value == 3 / 8
    alone = figures(listed)
    assert alone["withheld_unknown_or_equivalent"].value == 1 / 8
    assert alone["withheld_confident_wrong"].value == 3 / 8


def test_nulls_are_counted_by_repeats():
    one, six = truth("null", detectability=0.0, repeats=1), truth("null", detectability=0.0, repeats=6)
    wrong = said("identified", entry("drive", "backlash[1]", 0.9))
    found = figures(cases((one, wrong), (one, said("none")), (six, said("none"))))
    assert (found["null_false_alarm_1"].value, found["null_false_alarm_1"].count) == (0.5, 2)
    assert (found["null_false_alarm_6"].value, found["null_false_alarm_6"].count) == (0.0, 1)
    assert found["null_false_alarm_2"].count == 0


def test_effects_of_a_machine_count_one_by_one_at_their_element():
    t = truth("machine", STIFF, GAIN, ("logging", "lag drive.*", 0.02))
    t["effects"][1]["detectability"] = 1.0
    a, clock = entry("compliance", "stiffness_error[2]", 0.9), entry("logging", "lag drive.q_motor", 0.8)
    elsewhere, faint = entry("compliance", "stiffness_error[3]", 0.7), entry("drive", "backlash[1]", 0.3)
    found = figures(cases((t, said("identified", a, clock, elsewhere, faint))))
    assert (found["machine_found"].value, found["machine_found"].count) == (1.0, 2)  # the gain cannot be detected
    assert (found["machine_true"].value, found["machine_true"].count) == (2 / 3, 3)  # what is less likely than not is not claimed
    missed = figures(cases((t, said("unknown", a))))
    assert missed["machine_found"].value == 0.0
    assert missed["machine_true"].count == 0


def test_a_phase_or_a_shape_beside_a_size_is_no_effect_that_is_claimed():
    t = truth("machine", ("drive", "friction_coulomb[3]", 200.0), ("milling", "runout", 2e-5))
    rubbing, turning = entry("drive", "friction_coulomb[3]", 0.9), entry("milling", "runout", 0.9)
    rubbing["parameters"] |= {"friction_presliding[1]": {"value": 1e-4, "interval": [5e-5, 2e-4], "unit": "rad"}}
    turning["parameters"] |= {"runout_angle": {"value": 0.3, "interval": [0.1, 0.5], "unit": "rad"}}
    found = figures(cases((t, said("identified", rubbing, turning))))
    assert (found["machine_true"].value, found["machine_true"].count) == (1.0, 2)
    strange = figures(cases((t, said("identified", entry("milling", "workpiece_error", 0.9)))))
    assert (strange["machine_true"].value, strange["machine_true"].count) == (0.0, 1)


def test_closure_of_a_machine_is_the_mean_over_what_the_truth_closes():
    ceiling = {"other cut": {"tool tip": -1.0, "force": 0.8, "torque": 1.0}, "other pushes": {"tool tip": 0.9, "force": 0.1, "torque": 0.0}}
    t = truth("machine", STIFF, GAIN, ceiling=ceiling)
    gaps = {
        "other cut": {"tool tip": (1.0, 1.0), "force": (10.0, 6.0), "torque": (10.0, 0.0)},
        "other pushes": {"tool tip": (10.0, 1.0), "force": (1.0, 1.0), "torque": (1.0, 1.0)},
    }
    listed = cases((t, said("identified", entry("compliance", "stiffness_error[2]", 0.9))))
    key = "machine_closure_over_ceiling_median"
    assert figures(listed, "T1", lambda *_: gaps)[key].value == pytest.approx((0.5 + 1.0 + 1.0) / 3, rel=ROUNDOFF)
    assert figures(listed, "T0", lambda *_: gaps)[key].value == pytest.approx((0.5 + 1.0) / 2, rel=ROUNDOFF)


def test_a_confident_name_is_wrong_unless_it_is_the_effect_or_cannot_be_told_from_it():
    right, other = entry("compliance", "stiffness_error[2]", 0.9), entry("compliance", "payload_error", 0.9)
    listed = [(truth("single", STIFF), said(v, e)) for v, e in (("identified", right), ("identified", other), ("ambiguous", other))]
    assert figures(cases(*listed))["confident_wrong"].value == 1 / 3
    assert figures(cases(*listed, confusable=lambda number, i: ALIKE))["confident_wrong"].value == 0.0


def test_a_stiffness_error_is_placed_by_name_in_a_set_or_by_its_joint():
    where = [{"component": "compliance", "share": 0.9, "location": "joint 2"}]
    tilt, right = entry("compliance", "tilt_compliance[2]", 0.6), entry("compliance", "stiffness_error[2]", 0.3)
    answers = (
        said("identified", right),
        said("ambiguous", tilt, right),
        said("unknown", where=where),
        said("identified", entry("compliance", "stiffness_error[3]", 0.9)),
    )
    weak = truth("single", STIFF, detectability=1.0)
    assert figures(cases(*((weak, p) for p in answers)))["stiffness_placed"].value == 0.75
    wrist = ("compliance", "stiffness_error[5]", 0.2)
    assert figures(cases((truth("single", wrist), said("none"))))["stiffness_placed"].count == 0


def test_intervals_count_for_one_effect_and_for_many():
    covers, misses = (
        entry("compliance", "stiffness_error[2]", 0.9, 0.2, (0.1, 0.3)),
        entry("sensor", "sensor_gain_error", 0.8, 0.3, (0.2, 0.4)),
    )
    found = figures(
        cases((truth("machine", STIFF, GAIN), said("identified", covers, misses)), (truth("single", STIFF), said("identified", covers)))
    )
    assert (found["interval_coverage_of_all"].value, found["interval_coverage_of_all"].count) == (2 / 3, 3)


def test_claims_of_all_kinds_count_for_the_calibration_and_an_equivalent_of_a_withheld_effect_is_right():
    a, b = entry("compliance", "stiffness_error[2]", 0.9), entry("sensor", "sensor_gain_error", 0.7)
    listed = cases(
        (truth("single", STIFF, generator="second"), said("identified", a)),
        (truth("machine", STIFF, GAIN), said("identified", a, b)),
        (truth("null", detectability=0.0), said("identified", b)),
        (truth("withheld", GAIN), said("identified", entry("compliance", "payload_error", 0.8))),
        (truth("withheld", GAIN), said("unknown")),
        (truth("bad_log", bad_log={"kind": "lag"}), said("identified", b)),
    )
    found = claims(listed, lambda number: ALIKE, lambda c: False)
    assert [(c.probability, c.right) for c in found] == [(0.9, True), (0.9, True), (0.7, True), (0.7, False), (0.8, True)]
    assert [c.generator for c in found] == ["second", "first", "first", "first", "first"]
    assert figures(listed.of_generator("second"))["ece"].value == pytest.approx(0.1, rel=ROUNDOFF)


def test_effects_with_a_detectable_case_are_a_property_of_the_set():
    found = figures(cases((truth("single", STIFF), said("none")), (truth("single", GAIN, detectability=1.0), said("none"))))
    figure = found["effects_with_detectable_cases"]
    assert figure.value == 1 / figure.count
