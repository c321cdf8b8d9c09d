"""Late clocks, dead times and stamps beside the grid: what is a fault of the log, and what is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.candidates import selects
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.measured import sort_by_condition
from robomill.orchestration.runs.run import Run
from tests.diagnosis.axis import DEAD_TIME, NOISE, OFFSET, catalogue, measure, resolve, system
from tests.diagnosis.demo import WELL
from tests.tolerances import EXACT


def answer(folder: Path, runs: list[Run], **more: Any) -> dict[str, Any]:
    return diagnose(system(), runs, catalogue(folder, **more), resolver=resolve).result


def late(runs: list[Run], lag: float) -> list[Run]:
    """All channels late by the same time [s]."""
    return [replace(r, columns={c: np.interp(r.t - lag, r.t, x) for c, x in r.columns.items()}) for r in runs]


@pytest.mark.parametrize("repeats", [1, 4])
@pytest.mark.parametrize("lag", [0.0008, 0.00305])
def test_a_clock_that_is_a_part_of_a_step_late_is_found(tmp_path: Path, lag: float, repeats: int) -> None:
    """A lateness that is allowed for in every component would explain 0.2 steps of it for nothing, and make 0.76 of them uncertain."""
    result = answer(tmp_path, late(measure(repeats=repeats), lag), lag="drive.*", more=OFFSET)
    assert result["verdict"] == "bad_log"
    (finding,) = result["gate"]["findings"]
    assert (finding["kind"], finding["channel"]) == ("lag", "drive.*")
    assert finding["value"] == pytest.approx(lag, rel=WELL)
    low, high = result["which"][0]["parameters"]["lag drive.*"]["interval"]
    assert low < lag < high
    assert high - low < 0.3 * lag


def test_a_lateness_that_is_no_finding_stays_a_tolerance(tmp_path: Path) -> None:
    found = catalogue(tmp_path, lag="drive.*")
    coarse = tuple(replace(c, minimum=2e-3) if c.effect == "clock" else c for c in found.candidates)
    result = diagnose(system(), late(measure(repeats=3), 8e-4), replace(found, candidates=coarse), resolver=resolve).result
    assert result["verdict"] == "none"


def test_a_pattern_selects_channels_and_the_arrays_that_they_are_in() -> None:
    assert [selects(p, "drive.q[2]") for p in ("drive.*", "drive.q", "drive.q[2]", "*", "drive.q[1]", "drive.qd", "rive.*")] == [
        *[True] * 4,
        *[False] * 3,
    ]


def test_a_dead_time_of_a_part_of_a_step_is_found_where_no_clock_is_in_the_catalogue(tmp_path: Path) -> None:
    """To be late by 0.2 steps at random would have it for nothing, and something else be named for the rest."""
    found = catalogue(tmp_path, more=DEAD_TIME)
    own = replace(found, candidates=tuple(c for c in found.candidates if c.effect != "clock"))
    result = diagnose(system(), measure({"dead_time": 0.00305, "coulomb": 1.0}), own, resolver=resolve).result
    assert result["verdict"] == "identified"
    values = {name: p for w in result["which"] if w["probability"] > 0.8 for name, p in w["parameters"].items()}
    assert values.keys() == {"dead_time", "coulomb"}
    low, high = values["dead_time"]["interval"]
    assert low < 0.00305 < high
    assert high - low < 0.3 * 0.00305


def test_a_dead_time_is_no_bad_log(tmp_path: Path) -> None:
    """It does what a late clock does. That the clock is the likelier one by its prior does not make the log a bad one."""
    runs = measure({"dead_time": 0.012}, repeats=3)
    more = DEAD_TIME.replace("scale = 1e-3", "scale = 0.025")
    result = answer(tmp_path, runs, more=more)
    chances = {w["effect"]: w["probability"] for w in result["which"]}
    assert chances["clock"] > 0.5
    assert chances["dead_time"] > 0.2
    assert result["verdict"] == "ambiguous"
    assert result["gate"]["usable"]


@pytest.mark.parametrize("off", [2e-4, -3e-4, 8e-4])
def test_a_log_that_was_started_beside_the_grid_is_a_good_one(tmp_path: Path, off: float) -> None:
    shifted = [replace(r, t=r.t + off) for r in measure(repeats=3)]
    assert answer(tmp_path, shifted)["verdict"] == "none"


def test_stamps_that_are_off_together_are_taken_as_on_the_grid() -> None:
    (run,) = measure()
    for off in (2e-4, -3e-4):
        shifted = replace(run, t=run.t + off)
        (condition,) = sort_by_condition([shifted], system())
        at = np.rint(condition.grid / 0.004).astype(int)
        assert np.allclose(condition.matrix(shifted, ["drive.angle"])[:, 0], run.columns["drive.angle"][at], rtol=EXACT, atol=0.0)
    far = replace(run, t=run.t + 1.5e-3)  # a third of a step is between the points
    (condition,) = sort_by_condition([far], system())
    assert not np.allclose(
        condition.matrix(far, ["drive.angle"])[:-2, 0],
        run.columns["drive.angle"][: len(condition.grid) - 2],
        rtol=0.0,
        atol=10.0 * NOISE["drive.angle"],
    )
