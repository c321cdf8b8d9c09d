"""The sets of the benchmark: what comes how often, and that numbers say nothing."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from robomill.blind import bad_logs, outside
from robomill.blind.effects import BY_KEY, EFFECTS
from robomill.blind.sets import FEW_REPEATS, NULL_REPEATS, PROPORTIONS, SETS, STIFF_JOINTS, machine_effects, plans


def test_mixed_has_all_kinds_in_their_proportions():
    counts = Counter(p.kind for p in plans("mixed", 240, 1))
    assert counts.total() == 240
    assert all(abs(counts[kind] - share * 240) < 1.0 for kind, share in PROPORTIONS.items())


@pytest.mark.parametrize(
    ("name", "kind", "cards"),
    [
        ("withheld", "withheld", BY_KEY),
        ("single", "single", BY_KEY),
        ("few", "single", BY_KEY),
        ("outside", "outside", outside.OUTSIDE_BY_NAME),
        ("formed", "formed", outside.FORMED_BY_NAME),
        ("bad_log", "bad_log", bad_logs.LOG_FAULTS),
        ("campaign", "single", [f"compliance.stiffness_error[{i}]" for i in STIFF_JOINTS]),
    ],
)
def test_every_subject_comes_as_often_as_any_other(name, kind, cards):
    made = plans(name, 2 * len(cards), 1)
    assert {p.kind for p in made} == {kind}
    assert Counter(p.subject[0] for p in made) == dict.fromkeys(cards, 2)


@pytest.mark.parametrize(("name", "repeats"), [("null", NULL_REPEATS), ("few", FEW_REPEATS), ("campaign", (3,)), ("single", (6,))])
def test_numbers_of_repeats_come_equally_often(name, repeats):
    assert Counter(p.repeats for p in plans(name, 24, 1)) == {n: 24 // len(repeats) for n in repeats}


def test_every_second_case_is_from_the_second_generator_whatever_else_varies():
    made = plans("null", 48, 1, "both")
    assert Counter((p.generator, p.shape, p.repeats) for p in made) == {
        (g, s, n): 3 for g in ("first", "second") for s in ("cuts", "loads") for n in NULL_REPEATS
    }
    assert {p.generator for p in plans("null", 8, 1, "second")} == {"second"}


def test_a_machine_has_four_to_eight_effects_with_two_stiffness_errors_and_friction_in_several_joints():
    random = np.random.default_rng(1)
    sizes = Counter()
    for _ in range(300):
        effects = machine_effects(random)
        sizes[len(effects)] += 1
        assert len(set(effects)) == len(effects)
        assert sum(e.startswith("compliance.stiffness_error") for e in effects) == 2
        joints = [e.partition("[")[2] for e in effects if e.startswith("drive.friction")]
        assert len(set(joints)) == len(joints) >= 2
        assert all(e == "logging.lag" or e.partition("[")[0] in BY_KEY for e in effects)
    assert set(sizes) == {4, 5, 6, 7, 8}


@pytest.mark.parametrize("name", SETS)
def test_the_number_of_a_case_says_nothing_and_the_seed_all(name):
    assert plans(name, 60, 3) == plans(name, 60, 3)
    assert [p.number for p in plans(name, 60, 3)] == list(range(1, 61))
    if name != "null":
        assert [p.subject for p in plans(name, 60, 3)] != [p.subject for p in plans(name, 60, 4)]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("mixed", 0, 1), "--cases 0: expected at least 1"),
        (("best", 2, 1), "--set best: expected one of withheld, null, single, machine, few, campaign, bad_log, outside, mixed"),
        (("null", 2, 1, "third"), "--generator third: expected one of first, second, both"),
    ],
)
def test_what_there_is_not_is_refused(arguments, text):
    with pytest.raises(ValueError, match=text):
        plans(*arguments)


def test_at_least_eight_kinds_lie_outside_of_the_catalogue():
    assert len(outside.OUTSIDE_BY_NAME) >= 8
    assert not set(outside.OUTSIDE_BY_NAME) & {e.name for e in EFFECTS}
