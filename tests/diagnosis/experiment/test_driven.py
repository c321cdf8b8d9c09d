"""Systems that are driven by what was measured: components whose source is `measured`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.measured import DataError, driven
from robomill.diagnosis.experiment.preparation import prepared
from robomill.diagnosis.experiment.store import Store
from robomill.orchestration.assembly import assemble
from robomill.orchestration.errors import SystemFileError
from robomill.orchestration.runs.importing import write_run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.parameters import same_unit_only
from tests.diagnosis.axis import catalogue, measure, resolve, system
from tests.tolerances import EXACT

MOTION = ("program.q", "program.v", "program.a")
SYSTEM = system().with_source("program", "measured")
SYSTEM = replace(SYSTEM, components=tuple(replace(c, parameters={}) for c in SYSTEM.components))


def recorded(folder: Path, *, motion: bool = True, **how: float) -> Run:
    """A run of the axis with the motion that it made, `size` and `pace` times the usual one, on disk."""
    columns = (*(MOTION if motion else ()), "drive.torque", "drive.angle")
    truth = {"coulomb": 2.0, "viscous": 0.5}
    (run,) = measure(truth, columns=("drive.torque", "drive.angle"), **how)
    moved = _motion(run, **how)
    ports = {**run.ports, **{c: replace(run.ports["drive.angle"], name=c.partition(".")[2], unit=u) for c, u in UNITS.items()}}
    write_run(folder, run.t, {c: moved.get(c, run.columns.get(c)) for c in columns}, ports, {"labels": {"condition": folder.name}})
    return Run.load(folder)


UNITS = dict(zip(MOTION, ("rad", "rad/s", "rad/s2"), strict=True))


def _motion(run: Run, size: float = 1.0, pace: float = 1.0, **_: float) -> dict[str, np.ndarray]:
    w = [2.0 * np.pi * f * pace for f in (0.5, 1.3)]
    return {
        "program.q": size * sum(0.3 * np.sin(x * run.t) for x in w),
        "program.v": size * sum(0.3 * x * np.cos(x * run.t) for x in w),
        "program.a": -size * sum(0.3 * x * x * np.sin(x * run.t) for x in w),
    }


def test_each_run_is_simulated_on_its_own_motion_and_the_answer_holds_on_another(tmp_path: Path) -> None:
    here, there = recorded(tmp_path / "a"), recorded(tmp_path / "b", size=1.5, seed=2)
    found = diagnose(SYSTEM, [here], catalogue(tmp_path), held_out=[there], resolver=resolve).result
    assert {w["effect"] for w in found["which"] if w["probability"] > 0.5} == {"coulomb", "viscous"}
    (torque,) = (h for h in found["how_far"] if h["on"] == "held-out condition" and h["channel"] == "drive.torque")
    assert torque["closure"] > 0.99


def test_repeats_are_conditions_of_their_own_and_what_drives_them_is_no_channel(tmp_path: Path) -> None:
    runs = [recorded(tmp_path / name, seed=seed) for name, seed in (("a", 1), ("b", 2))]
    for r in runs:
        r.info["labels"]["condition"] = "same"
    laboratory = prepared(Campaign.of(SYSTEM, runs), catalogue(tmp_path), resolve, same_unit_only).laboratory
    assert [c.name for c in laboratory.conditions] == ["same", "same (2)"]
    assert laboratory.channels == ["drive.torque", "drive.angle"]


def test_a_held_out_run_of_the_same_label_is_no_repeat_of_another_motion(tmp_path: Path) -> None:
    here, there = recorded(tmp_path / "a"), recorded(tmp_path / "b", size=1.5, seed=2)
    there.info["labels"]["condition"] = "a"
    assert [(c.name, c.held_out) for c in Campaign.of(SYSTEM, [here], [there]).conditions()] == [("a", False), ("a (2)", True)]


def test_what_is_played_is_what_was_measured(tmp_path: Path) -> None:
    run = recorded(tmp_path / "a")
    with assemble(driven(SYSTEM, run), resolve) as assembly:
        slave = assembly.slaves["program"]
        out = np.zeros(3)
        slave.initialise(0.0, 1.0, SYSTEM.step)
        slave.step(99 * SYSTEM.step, SYSTEM.step)
        slave.get_outputs(out)
        assert np.all(out - [run.columns[c][100] for c in MOTION] == EXACT)
        slave.step(run.t[-1], SYSTEM.step)  # behind the end: the last row holds
        slave.get_outputs(out)
        assert np.all(out - [run.columns[c][-1] for c in MOTION] == EXACT)


def test_a_run_without_the_motion_is_refused(tmp_path: Path) -> None:
    run = recorded(tmp_path / "a", motion=False)
    with pytest.raises(
        DataError, match=r"component 'program' .* plays what was measured, .*no column program\.\*; it has columns of drive: map"
    ):
        Campaign.of(SYSTEM, [run]).conditions()


def test_without_a_run_the_source_says_what_it_needs() -> None:
    with pytest.raises(SystemFileError, match="which only a diagnosis knows; give replay:FOLDER to run it"):
        assemble(SYSTEM, resolve)


def test_a_log_that_was_imported_anew_is_simulated_anew(tmp_path: Path) -> None:
    store, run = Store(tmp_path / "store"), recorded(tmp_path / "a")
    before = store.key(driven(SYSTEM, run))
    assert store.key(driven(SYSTEM, run)) == before
    (tmp_path / "a" / "run.toml").unlink()
    write_run(tmp_path / "a", run.t, {c: 1.1 * v for c, v in run.columns.items()}, run.ports, run.info, overwrite=True)
    assert store.key(driven(SYSTEM, Run.load(tmp_path / "a"))) != before
