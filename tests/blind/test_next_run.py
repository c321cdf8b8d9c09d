"""Recommended runs, made in the generator's world."""

from __future__ import annotations

import pytest

from robomill.blind.next_run import separates
from robomill.blind.truth import TrueEffect, Truth

FRICTION = Truth("single", (TrueEffect("drive", "friction_coulomb", "friction_coulomb[4]", 4, 130.0, "N.m"),), machine={})
STRIBECK = {"drive": {"friction_stribeck[4]": 130.0}}


@pytest.mark.slow
def test_kinds_of_friction_are_told_apart_by_motion_and_not_by_a_push_on_a_robot_that_stands():
    assert separates(FRICTION, {"kind": "reversals"}, [STRIBECK], "T1", 3.0)
    assert not separates(FRICTION, {"kind": "static push", "parameters": {"load": {"value": 300.0, "unit": "N"}}}, [STRIBECK], "T1", 3.0)


@pytest.mark.slow
def test_nothing_is_told_from_itself_and_a_late_clock_from_what_is_on_time():
    assert not separates(FRICTION, {"kind": "reversals"}, [{"drive": {"friction_coulomb[4]": 130.0}}], "T1", 3.0)
    assert separates(FRICTION, {"kind": "reversals"}, [{"logging": {"lag drive.*": 0.05}}], "T1", 3.0)


def test_a_run_that_cannot_be_made_is_named():
    with pytest.raises(LookupError, match="no kind of run 'rest'; there are"):
        separates(FRICTION, {"kind": "rest"}, [STRIBECK], "T1", 3.0)
    with pytest.raises(LookupError, match=r"load = 9000 N is out of its range, 100 \.\. 400 N"):
        separates(FRICTION, {"kind": "static push", "parameters": {"load": {"value": 9000.0, "unit": "N"}}}, [STRIBECK], "T1", 3.0)
