"""Runs that are completed on disk behind the next one."""

from __future__ import annotations

import subprocess
import sys
import tomllib

import numpy as np
import pytest

from robomill.orchestration.assembly import computed, run
from robomill.orchestration.errors import ResultsError, RunError
from robomill.orchestration.runs.behind import Behind
from robomill.orchestration.runs.files import LIVE, RUN, SIGNALS
from robomill.orchestration.runs.recorder import Recorder
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData
from tests import ROOT
from tests.orchestration.mocks import Mock, resolver, system


def compute(folder, fails_at=9.0):
    def y(_, t):
        if t > fails_at:
            raise ValueError("no oil")
        return [np.sin(t)]

    slaves = [Mock("c", [PortData("y", "output")], y)]
    return computed(system(slaves), folder, stop=0.1, resolver=resolver(slaves))


def test_behind_the_next_is_what_is_complete_at_once(tmp_path):
    first = compute(tmp_path / "1")
    before = {f.name for f in (tmp_path / "1").iterdir()}
    with pytest.raises(ResultsError, match="another run is being written there"):
        compute(tmp_path / "1")
    behind = Behind(first)
    second = compute(tmp_path / "2")()
    found = behind.run()
    assert SIGNALS not in before
    assert tomllib.loads((tmp_path / "1" / RUN).read_text(encoding="utf-8"))["outcome"] == found.outcome == "finished"
    assert {f.name for f in (tmp_path / "1").iterdir()} == {f.name for f in (tmp_path / "2").iterdir()} == {RUN, SIGNALS}
    assert np.array_equal(found["c.y"], second["c.y"])
    assert np.array_equal(found["c.y"], Run.load(tmp_path / "1")["c.y"])


def test_what_completing_raises_is_raised_where_the_run_is_asked_for(tmp_path, monkeypatch):
    def full(_):
        raise OSError("no space left on device")

    complete = compute(tmp_path / "1")
    with monkeypatch.context() as patch:
        patch.setattr(Recorder, "complete", full)
        behind = Behind(complete)
        with pytest.raises(OSError, match="no space left on device"):
            behind.run()
    assert len(Run.load(tmp_path / "1").t) == len(compute(tmp_path / "2")().t), "what was computed can be read"


def test_a_run_that_fails_is_complete_when_that_is_raised(tmp_path):
    with pytest.raises(RunError, match="no oil"):
        compute(tmp_path / "1", fails_at=0.05)
    assert Run.load(tmp_path / "1").outcome == "failed"
    assert not (tmp_path / "1" / LIVE).exists()


def test_a_process_that_is_killed_before_leaves_all_rows(tmp_path):
    script = (
        "import os, pathlib\n"
        "from tests.orchestration.runs.test_behind import compute\n"
        f"compute(pathlib.Path({str(tmp_path / 'killed')!r}))\n"
        "os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=False).returncode != 0
    assert np.array_equal(Run.load(tmp_path / "killed")["c.y"], compute(tmp_path / "whole")()["c.y"])


def test_a_process_does_not_end_before_the_run_is_complete(tmp_path):
    script = (
        "import pathlib\n"
        "from robomill.orchestration.runs.behind import Behind\n"
        "from tests.orchestration.runs.test_behind import compute\n"
        f"Behind(compute(pathlib.Path({str(tmp_path / 'r')!r})))\n"
        "raise SystemExit(0)"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=False).returncode == 0
    assert Run.load(tmp_path / "r").outcome == "finished"


def test_run_returns_what_is_complete(tmp_path):
    slaves = [Mock("c", [PortData("y", "output")], lambda _, t: [t])]
    run(system(slaves), tmp_path / "r", stop=0.1, resolver=resolver(slaves))
    assert {f.name for f in (tmp_path / "r").iterdir()} == {RUN, SIGNALS}
