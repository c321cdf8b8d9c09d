"""`robomill diagnose` on systems that have nothing to do with milling: every output comes, and every number in it can be true."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import re
import shutil
import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill import diagnose_command
from robomill.cli import main
from robomill.diagnose_command import lines, write
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.repeats import as_share, bootstrapped
from robomill.diagnosis.inference.evidence import BEGINNING
from robomill.diagnosis.outcome import closure
from robomill.diagnosis.outcome.answer import as_json, titles_of
from robomill.logs.importing import import_log
from robomill.orchestration.runs.lock import FolderLock
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.definition import System
from robomill.report import units
from tests import ROOT
from tests.diagnosis import axis, demo
from tests.tolerances import ROUNDOFF

STIFF = {"masses": {"stiffness_error[2]": -0.08}}
FAST: dict[str, Any] = {"step": 1e-4, "pace": 50.0, "seconds": 0.08}
SLOW: dict[str, Any] = {"step": 10.0, "pace": 4e-4, "seconds": 10000.0}
DATA = ROOT / "data" / "kuka_kr300_recordings"
RUBBING = {"coulomb": 1.0}


@dataclass(frozen=True)
class Trial:
    """A system with what was measured of it."""

    system: System
    runs: Sequence[Run]
    catalogue: Callable[[Path], Catalogue]
    resolve: Any
    verdict: str
    held_out: Sequence[Run] = ()


def _axis(verdict: str, runs: Sequence[Run], step: float = 0.004, pace: float = 1.0, held_out: Sequence[Run] = ()) -> Trial:
    return Trial(axis.system(step, pace), runs, functools.partial(axis.catalogue, pace=pace), axis.resolve, verdict, held_out)


def _springs(verdict: str, runs: Sequence[Run], held_out: Sequence[Run] = ()) -> Trial:
    return Trial(demo.SYSTEM, runs, demo.catalogue, demo.resolve, verdict, held_out)


def _disturbed(t: Any, y: Any) -> Any:
    return y + 2e-3 * np.sin(9.0 * t) * (t > 5.0)


TRIALS: dict[str, Callable[[], Trial]] = {
    "two masses": lambda: _springs("identified", demo.measure(STIFF)),
    "two masses, one run": lambda: _springs("identified", demo.measure(STIFF, repeats=1)),
    "nothing found, one run": lambda: _springs("none", demo.measure(repeats=1)),
    "something unknown, one run": lambda: _springs("unknown", demo.changed(demo.measure(repeats=1), "sensors.y[1]", _disturbed)),
    "a bad log, one run": lambda: _springs("bad_log", demo.changed(demo.measure(repeats=1), "sensors.y[1]", lambda t, y: -y)),
    "one axis": lambda: _axis("identified", axis.measure(RUBBING, repeats=4)),
    "one scalar output": lambda: _axis("identified", axis.measure(RUBBING, repeats=3, columns=("drive.torque",))),
    "one scalar output, one run": lambda: _axis(
        "identified",
        axis.measure(RUBBING, columns=("drive.torque",)),
        held_out=axis.measure(RUBBING, size=0.6, columns=("drive.torque",), seed=5),
    ),
    "runs of 0.08 s": lambda: _axis("identified", axis.measure({"inertia_error": 0.1}, repeats=3, **FAST), 1e-4, 50.0),
    "one run of 0.08 s": lambda: _axis("identified", axis.measure({"inertia_error": 0.1}, **FAST), 1e-4, 50.0),
    "nothing in 0.08 s": lambda: _axis("none", axis.measure(repeats=2, **FAST), 1e-4, 50.0),
    "runs of three hours": lambda: _axis("identified", axis.measure(RUBBING, repeats=3, **SLOW), 10.0, 4e-4),
    "late": lambda: _axis("bad_log", axis.measure(late=0.00305, repeats=1)),
}


def _numbers_can_be_true(result: Mapping[str, Any]) -> None:
    for w in result["where"]:
        assert 0.0 <= w["share"] <= 1.0
        assert w["interval"] is None or 0.0 <= w["interval"][0] <= w["interval"][1] <= 1.0
    for w in result.get("swap", []):
        assert 0.0 <= w["share"] <= 1.0
        assert w["interval"] is None or 0.0 <= w["interval"][0] <= w["interval"][1] <= 1.0
    for r in result.get("replay", []):
        assert r["interval"] is None or 0.0 <= r["interval"][0] <= r["interval"][1]
    for h in result["how_far"]:
        assert h["closure"] is None or (h["closure"] <= 1.0 and h["interval"][0] <= h["interval"][1] <= 1.0)
        assert h["ceiling"] is None or h["ceiling"] <= 1.0
    for w in result["which"]:
        assert 0.0 <= w["probability"] <= 1.0
    if "gap" in result:
        assert 0.0 <= result["gap"]["unexplained"] <= 1.0


def _all_outputs(trial: Trial, folder: Path) -> tuple[dict[str, Any], str]:
    """diagnosis.json and the text of the page."""
    found_in = trial.catalogue(folder)
    found = diagnose(trial.system, trial.runs, found_in, held_out=trial.held_out, resolver=trial.resolve)
    page = write(found, trial.system, [*trial.runs, *trial.held_out], found_in, folder / "answer")
    result = json.loads((folder / "answer" / "diagnosis.json").read_text(), parse_constant=_no_number)
    assert lines(found.answer)[0].startswith(f"verdict: {result['verdict']}")
    _numbers_can_be_true(result)
    text = re.sub(r"<[^>]*>", " ", page.read_text(encoding="utf-8").split("</style>", 1)[1]).replace("\u00a0", " ")
    assert not re.search(r"\bnan\b|\bNone\b(?! of| is)", text)
    for percentage in map(float, re.findall(r"(\d+(?:\.\d+)?) %", text)):
        assert percentage <= 100.0
    return result, text


def _no_number(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


@pytest.mark.parametrize("name", TRIALS)
def test_every_output_comes_for_any_system(name: str, tmp_path: Path) -> None:
    trial = TRIALS[name]()
    result, _ = _all_outputs(trial, tmp_path)
    assert result["verdict"] == trial.verdict


def test_figures_are_called_as_their_ports_are(tmp_path: Path) -> None:
    result, text = _all_outputs(TRIALS["one axis"](), tmp_path)
    assert {h["metric"] for h in result["how_far"]} == {
        "all channels, whitened rms",
        "torque of the motor (drive.torque) rms",
        "drive.angle rms",
    }
    assert {h["unit"] for h in result["how_far"]} == {"1", "N.m", "rad"}
    assert "torque of the motor (drive.torque)" in text


def test_the_catalogue_may_call_them_otherwise_and_says_which_are_figures() -> None:
    ports = {c: PortData(c.partition(".")[2], "output", description=d) for c, d in (("a.x[1]", "one"), ("a.x[2]", "two"), ("b.y", "force"))}
    assert titles_of({}, ports) == {"a.x": "a.x", "b.y": "force (b.y)"}
    assert titles_of({"b.y": "force error", "c.z": "elsewhere"}, ports) == {"b.y": "force error"}


def test_a_log_without_units_has_those_of_the_system(tmp_path: Path) -> None:
    bare = [replace(r, ports={c: replace(p, unit=None) for c, p in r.ports.items()}) for r in axis.measure(RUBBING, repeats=3)]
    result, text = _all_outputs(_axis("identified", bare), tmp_path)
    assert {h["unit"] for h in result["how_far"]} == {"1", "N.m", "rad"}
    assert "(no unit)" not in text


def test_a_number_that_nothing_determines_is_null() -> None:
    text = as_json({"a": float("nan"), "b": [float("inf"), (1.0, -float("inf"))], "c": {"d": True, "e": "NaN"}})
    assert json.loads(text, parse_constant=_no_number) == {"a": None, "b": [None, [1.0, None]], "c": {"d": True, "e": "NaN"}}


def test_a_share_is_neither_below_nothing_nor_above_all() -> None:
    assert [as_share(x) for x in (-0.1, 0.4, 1.002)] == [0.0, 0.4, 1.0]


def test_one_repeat_has_no_interval() -> None:
    values = np.linspace(0.0, 1.0, 101)
    assert bootstrapped(values, 1) is None
    assert bootstrapped(np.append(values, np.nan), 2) == pytest.approx([0.05, 0.95], rel=ROUNDOFF)
    assert units.percent_interval(None) == ""


def test_no_more_is_closed_than_there_was() -> None:
    """Where noise is taken for more than it is, what is left seems to be less than nothing."""
    gap = np.random.default_rng(0).normal(size=(200, 1))
    part = closure.products([gap], (0.0 * gap, 0.0 * gap), (gap, gap), np.array([0.3]), (), 0.0 * gap)
    found = closure.figures([part])
    assert (found.closure, found.after) == (1.0, 0.0)
    assert found.interval == [1.0, 1.0]


def test_what_a_run_begins_with_is_a_number_of_steps_and_never_much_of_it(tmp_path: Path) -> None:
    """In 30 steps, 25 would be nearly all of the run."""
    short = axis.measure({"inertia_error": 0.3}, repeats=3, step=0.02, seconds=0.6, pace=2.0)
    assert len(short[0].t) < 1.3 * BEGINNING
    result, _ = _all_outputs(_axis("identified", short, 0.02, 2.0), tmp_path)
    assert result["verdict"] == "identified"


RECORDED = """
name = "recorded robot"
step = "4 ms"

[components.motion]
source = "replay:A#robot"

[components.robot]
source = "inverse_dynamics"
parameters = {differentiate = true, payload_mass = "150 kg", payload_com_F = [0.0, 0.0, 0.1]}

[[connections]]
from = "motion.q"
to = "robot.q"
"""


def _recorded_robot(folder: Path) -> None:
    """A system, its recording A and its catalogue."""
    import_log(DATA / "map.toml", DATA / "recording_A.npz", folder / "A")
    (folder / "robot.toml").write_text(RECORDED)
    shutil.copy(ROOT / "scenarios" / "recordings" / "kuka_kr300" / "catalogue.toml", folder)


def test_what_an_interrupted_diagnosis_has_simulated_is_kept_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _recorded_robot(tmp_path)

    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt(signal.SIGTERM)

    monkeypatch.setattr(diagnose_command, "answered", interrupted)
    with contextlib.chdir(tmp_path):
        assert main(["diagnose", "robot.toml", "A", "--catalogue", "catalogue.toml", "--out", "answer"]) == 128 + signal.SIGTERM
    said = capsys.readouterr().err
    assert "robomill diagnose: interrupted by SIGTERM; 0 simulations are kept in answer/simulations/: the same command goes on" in said


def test_two_diagnoses_at_once_in_one_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _recorded_robot(tmp_path)
    (tmp_path / "answer").mkdir()
    with contextlib.chdir(tmp_path), FolderLock(tmp_path / "answer"):
        assert main(["diagnose", "robot.toml", "A", "--catalogue", "catalogue.toml", "--out", "answer"]) == 2
        assert [f.name for f in Path("answer").iterdir()] == ["run.lock"]
    assert f"another run is being written there, by process {os.getpid()}" in capsys.readouterr().err


def test_what_is_refused_before_anything_is_simulated_leaves_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _recorded_robot(tmp_path)
    with contextlib.chdir(tmp_path):
        assert main(["diagnose", "robot.toml", "A", "--catalogue", "other.toml", "--out", "answer"]) == 2
        assert "other.toml" in capsys.readouterr().err
        assert not Path("answer").exists()


@pytest.mark.slow
def test_a_recorded_robot_without_tool_tip_repeats_or_held_out_runs(tmp_path: Path) -> None:
    _recorded_robot(tmp_path)
    command = ["diagnose", "robot.toml", "A", "--catalogue", "catalogue.toml", "--out", "answer", "--jobs", "1"]
    with contextlib.chdir(tmp_path):
        assert main(command) == 0
    result = json.loads((tmp_path / "answer" / "diagnosis.json").read_text(), parse_constant=_no_number)
    _numbers_can_be_true(result)
    # friction in every joint is more than three effects: the engine says so
    assert result["verdict"] == "unknown"
    page = (tmp_path / "answer" / "report.html").read_text(encoding="utf-8")
    assert "Motor torques (robot.torque_motor)" in page.replace(".<wbr/>", ".")
