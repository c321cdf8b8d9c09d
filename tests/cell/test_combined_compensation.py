"""Offline and online compensation of the groove of paper 000 together, on a machine that is not the nominal twin."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomill.cell.compensation import Compensation, Perturbation, Settings, compensate
from robomill.cell.scenario import load_scenario
from tests import SCENARIOS

SOFT = Perturbation(-0.15, 0.2)
KNOWN = Perturbation(-0.15, 0.2, informed=True)
"""SOFT with its springs in the controller, as identified on it."""


def compensated(folder: Path, variant: str, *machines: Perturbation) -> Compensation:
    return compensate(load_scenario(SCENARIOS / "groove.toml"), variant, folder / variant, Settings(iterations=2), perturbed=machines)


@pytest.mark.slow
@pytest.mark.paper
def test_both_are_better_than_either_on_a_softer_machine(tmp_path: Path) -> None:
    """Paper 000 claims that the combination is better; it gives no figure. Surface, rms: a quarter less; half where springs are known.

    Bounds are ours (27 % and 58 % in docs/explanation/validation.md), with room for another processor's rounding. On the nominal twin the
    surface gains nothing, and the largest deviation, at the rim of the exit, is worse than with pilot control alone: that is said.
    """
    offline = compensated(tmp_path, "uncompensated", SOFT)
    both = compensated(tmp_path, "cartesian_pilot", SOFT, KNOWN)
    alone = offline.trials[0].compensated_surface_rms_m
    assert alone is not None
    for trial, part in zip(both.trials, (0.8, 0.5), strict=True):
        online, together = trial.uncompensated_surface_rms_m, trial.compensated_surface_rms_m
        assert online is not None
        assert together is not None
        assert together < part * min(online, alone)
        assert trial.after.figures.rms_m < 0.7 * min(trial.before.figures.rms_m, offline.trials[0].after.figures.rms_m)
    assert both.after.figures.rms_m < 0.8 * min(both.before.figures.rms_m, offline.after.figures.rms_m)
    assert both.results[1].figures.max_deviation_m > both.results[0].figures.max_deviation_m
