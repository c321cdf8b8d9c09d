"""Periods of a law in an angle: found where the motion is slow, whatever it is elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from robomill.diagnosis.forms import solving
from robomill.diagnosis.forms.library import Factor, Term
from robomill.diagnosis.forms.periods import grid, with_periods
from robomill.diagnosis.forms.ports import Problem, Seen
from robomill.diagnosis.forms.selection import Chosen, Rows
from robomill.diagnosis.forms.signals import Host, Variable
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import ROUNDOFF

STEP = 0.004
"""s"""
SLOW, FAST = 0.02, 1.0
"""rad/s"""
WAVES = 1917.0
"""1/rad: eight poles on a motor with a gear ratio of about 240."""
ANGLE = Variable("q[1]", False, "rad", 1)


def turned(fast: float = 0.1) -> FloatArray:
    """Angle [n] of an axis that approaches for a part of the time, and goes slowly to and fro for the rest."""
    t = np.arange(0.0, 6.0, STEP)
    speed = np.where(t < fast * t[-1], FAST, SLOW * np.sign(np.sin(2.0 * t)))
    return np.asarray(np.cumsum(speed) * STEP)


def problem(angles: Sequence[FloatArray], waves: float, size: float = 1.0) -> Problem:
    """A port whose gap is a wave of the angle of that size, and noise of a tenth of 1."""
    random = np.random.default_rng(0)
    host = Host("drive", {}, {}, {})
    gap = [(size * np.sin(waves * q + 0.7) + 0.1 * random.normal(size=len(q)))[:, None] for q in angles]
    known = [{ANGLE: q} for q in angles]
    t: list[FloatArray] = [STEP * np.arange(len(q), dtype=np.float64) for q in angles]
    effect = [{"torque[1]": np.ones((len(q), 1))} for q in angles]
    return Problem(Seen(host, "output", known, t), ("drive.torque[1]",), [], gap, np.ones(1), effect, 3, STEP, base=3)


def test_a_wave_that_is_seen_where_the_motion_is_slow_is_found_although_it_goes_by_too_fast_elsewhere() -> None:
    angles = [turned(), turned() + 0.3]
    found = with_periods(problem(angles, WAVES), [], 0.0, [("torque[1]", ANGLE)], Rows.spans)
    (sine, cosine) = (term.factors[0] for _, term in found)
    width = float(np.diff(grid(angles, 3))[0])
    assert (sine.kind, cosine.kind, sine.shape) == ("sine", "cosine", cosine.shape)
    assert abs(sine.shape - WAVES) < width


@pytest.mark.parametrize("size", [1.0, 0.0])
def test_a_port_whose_terms_left_out_parts_refute_has_its_wave_or_no_form(size: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Terms whose closure is below zero in parts that have not seen them are none; a wave is looked for beside nothing then."""
    one = replace(problem([turned(), turned() + 0.3], WAVES, size), terms=[("torque[1]", Term((Factor("value", ANGLE),)))])
    monkeypatch.setattr(solving, "choose", lambda rows, offsets: Chosen([0], -0.1, 0.0, rows, 0, Rows.spans))
    found = solving.solve(one)
    kinds = {term.factors[0].kind for _, term in found.terms}
    left, gap = sum(float(x.sum()) for x in found.left.values()), sum(float(x.sum()) for x in found.gap.values())
    assert left == pytest.approx((1.0 - found.closure) * gap, rel=1e3 * ROUNDOFF)
    if size:
        assert kinds == {"sine", "cosine"}
        assert found.closure > 0.9
    else:
        assert (kinds, found.closure) == (set(), 0.0)


def test_no_wave_is_looked_for_that_is_not_seen_at_the_usual_speed() -> None:
    ks = grid([turned(fast=0.0)], 3)
    assert abs(ks[-1] - np.pi / (SLOW * 3.0 * STEP)) < 2.0 * float(np.diff(ks)[0])


def test_no_more_waves_are_told_apart_than_half_as_many_as_there_are_samples() -> None:
    """A way that is gone in a moment, and a slow swing for the rest."""
    angle = turned(fast=0.3)
    ks = grid([angle], 3)
    samples = len(angle) / 3.0
    assert abs(ks[-1] * np.ptp(angle) / (2.0 * np.pi) - 0.5 * samples) < 1.0


def test_where_nothing_moves_there_is_no_period() -> None:
    assert len(grid([np.full(1000, 0.3)], 3)) == 0
