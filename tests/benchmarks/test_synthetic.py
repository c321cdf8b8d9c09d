"""Recordings of which the truth is known: what is drawn, what is measured, and how an answer is counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.recordings import synthetic
from benchmarks.recordings.cases import Case, cases, prepare
from benchmarks.recordings.synthetic import BACKGROUND, COUNT, Noise, Score, drawn, measured, wilson
from benchmarks.recordings.yardstick import View
from robomill.orchestration.runs.run import Run

SCORE = Score("ur10", 1, "identified", False, 10, 8, 9, ("torque_lag @ log",), 0, 7, 8, (0.1, 0.3), (0.9, 0.1), (0.95, 0.1), 0.97, 5.0)


@pytest.fixture(scope="module")
def ur10() -> Case:
    return next(c for c in cases() if c.name == "ur10")


@pytest.fixture(scope="module")
def run(ur10: Case, tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("ur10")
    prepare(folder / "prepared")
    return ur10.runs(folder, folder / "prepared")[0][0]


def test_robots_have_eight_effects_or_more_and_a_few_that_are_too_small(ur10: Case) -> None:
    by_address = {a: c for c in ur10.catalogue().candidates for a in c.addresses}
    for seed in range(5):
        robot = drawn(ur10, np.random.default_rng(seed))
        assert COUNT[0] <= len(robot.values) <= COUNT[1]
        assert len(robot.small) == BACKGROUND
        assert not robot.values.keys() & robot.small.keys()
        assert all(abs(v) < by_address[a].minimum for a, v in robot.small.items())
        assert all(c.bounds[0] <= v <= c.bounds[1] for a, v in robot.values.items() for c in [by_address[a]])


def test_the_other_law_of_friction_is_that_of_the_catalogue_at_speed(ur10: Case, run: Run) -> None:
    view = View(ur10, run, ur10.system())
    robot = replace(drawn(ur10, np.random.default_rng(1)), otherwise=False, rounding=1.0)
    kept = {a: v for a, v in robot.values.items() if a[1].startswith("friction_")}
    own = measured(view, replace(robot, values=kept))
    other = measured(view, replace(robot, values=kept, otherwise=True))
    none = measured(view, replace(robot, values={}))
    for i in range(1, 7):
        c, fast = f"robot.torque_motor[{i}]", np.abs(run.columns[f"motion.qd[{i}]"]) > 0.1
        friction = np.abs((own[c] - none[c])[fast]).max()
        assert np.abs((own[c] - other[c])[fast]).max() < 0.02 * friction + 1e-9
        assert friction == 0.0 or np.any(own[c] != other[c])


def test_noise_has_the_size_that_is_asked_for() -> None:
    t = 0.01 * np.arange(200_000)
    x = Noise({"c": 1.0}, {"c": 2.0}).drawn("c", t, np.random.default_rng(1))
    assert abs(float(np.var(x)) - 5.0) < 0.5
    assert 0.9 < float(np.mean(x[1:] * x[:-1])) / 4.0 < 1.05


def test_rates_have_intervals_and_the_page_says_what_is_wrong() -> None:
    assert wilson(8, 10) == "0.80 (0.49 to 0.94), 8 of 10"
    assert wilson(0, 0) == "-"
    page = synthetic.text([SCORE, replace(SCORE, seed=2, wrong=())], "1-2")
    assert "ur10, seed 1: torque_lag @ log." in page
    assert "0.06 (0.01 to 0.26), 1 of 18" in page
    assert "90.0 % (95.0 %)" in page  # the channel of which noise is the most does not count
