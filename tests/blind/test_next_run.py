"""Recommended runs, made in the generator's world."""

from __future__ import annotations

import pytest

from robomill.blind.next_run import separates
from robomill.blind.truth import TrueEffect, Truth

FRICTION = Truth("single", (TrueEffect("drive", "friction_coulomb", "friction_coulomb[4]", 4, 130.0, "N.m"),), machine={})
STRIBECK = {"drive": {"friction_stribeck[4]": 130.0}}


@pytest.mark.slow
def test_kinds_of_friction_are_told_apart_by_motion_and_not_by_a_push_on_a_robot_that_stands():
    assert separates(FRICTION, "reversals", [STRIBECK], "T1", 3.0)
    assert not separates(FRICTION, "static push along y", [STRIBECK], "T1", 3.0)


@pytest.mark.slow
def test_nothing_is_told_from_itself_and_a_late_clock_from_what_is_on_time():
    assert not separates(FRICTION, "reversals", [{"drive": {"friction_coulomb[4]": 130.0}}], "T1", 3.0)
    assert separates(FRICTION, "reversals", [{"logging": {"lag drive.*": 0.05}}], "T1", 3.0)


def test_a_run_that_is_not_on_the_menu_is_named():
    with pytest.raises(LookupError, match="no run 'rest' on the menu; there are"):
        separates(FRICTION, "rest", [STRIBECK], "T1", 3.0)
