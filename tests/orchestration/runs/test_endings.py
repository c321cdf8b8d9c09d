"""Runs whose process ends, or is told to: rows, a sentence, a status that is not zero, nothing left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import Interrupted, ResultsError, RunError
from robomill.orchestration.runs.lock import LOCK, FolderLock
from robomill.orchestration.runs.run import Run, read_info
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.definition import Component, Recording, System
from tests import ROOT
from tests.orchestration import c_fmu
from tests.orchestration.mocks import Mock, resolver, source, system

BAD = "if (m->mode != 2)"
H = 0.004
DEATHS = {
    "segfaults": "*(volatile int *)0 = 1;",
    "aborts": "abort();",
    "exits": "exit(0);",
    "leaves": "_exit(0);",
}
ROWS = 31  # t = 0 .. 0.12: the step from 0.12 ends the process
SCRIPT = """
import sys
from robomill.orchestration.assembly import run
from robomill.orchestration.system.definition import Component, Connection, Recording, System
files, folder, loop, every = sys.argv[1:]
good, bad = files.split("|")
parts = Component("good", good), Component("bad", bad, {"gain": 3.0})
s = System("t", 0.004, parts, (Connection("good.twice", "bad.u"),), loop=loop, recording=Recording(every=int(every)))
print("begun", flush=True)
run(s, folder or None, stop=4.0)
print("not reached")
"""


@pytest.fixture(scope="module")
def fmus(tmp_path_factory) -> dict[str, Path]:
    """The Euler FMU, and versions of it that end the process in the step from t = 0.12 s, or when they are instantiated."""
    if c_fmu.compiler() is None:
        pytest.skip("no C compiler here")
    made = {"good": c_fmu.build(tmp_path_factory.mktemp("good"))}
    for name, code in DEATHS.items():
        text = c_fmu.SOURCE.replace(BAD, f"if (t > 0.119) {code} {BAD}", 1)
        assert text != c_fmu.SOURCE
        made[name] = c_fmu.build(tmp_path_factory.mktemp(name), "#include <unistd.h>\n" + text)
    made["loading"] = c_fmu.build(tmp_path_factory.mktemp("loading"), c_fmu.SOURCE.replace("Model *m;\n", "Model *m; exit(0);\n", 1))
    return made


def script(text: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", text, *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False)


class TestEndsTheProcess:
    """A component in process ends it."""

    @pytest.mark.parametrize("loop", ["python", "compiled"])
    @pytest.mark.parametrize("how", list(DEATHS))
    def test_rows_and_a_sentence_stay(self, fmus, tmp_path, how, loop):
        done = script(SCRIPT, f"{fmus['good']}|{fmus[how]}", tmp_path / "r", loop, 1)
        assert done.stdout == "begun\n"
        assert (done.returncode != 0) is (how != "leaves")  # nothing in a process hears of _exit()
        assert "component 'bad'" in done.stderr
        assert "isolate = true in [components.bad] contains that" in done.stderr
        assert "t = 0.12 s" in done.stderr
        r = Run.load(tmp_path / "r")
        assert r.outcome == "failed"
        assert "component 'bad'" in r.info["message"]
        assert list(r.t) == [k * 4 / 1000 for k in range(ROWS)]
        whole = run(System("t", H, (Component("good", str(fmus["good"])),)), stop=0.12)
        assert np.array_equal(r["good.y"], whole["good.y"])
        assert sorted(p.name for p in (tmp_path / "r").iterdir()) == ["run.toml", "signals.parquet"]

    @pytest.mark.parametrize("loop", ["python", "compiled"])
    def test_each_third_row(self, fmus, tmp_path, loop):
        script(SCRIPT, f"{fmus['good']}|{fmus['segfaults']}", tmp_path / "r", loop, 3)
        assert list(Run.load(tmp_path / "r").t) == [3 * k * 4 / 1000 for k in range(11)]

    def test_without_a_folder(self, fmus):
        done = script(SCRIPT, f"{fmus['good']}|{fmus['exits']}", "", "auto", 1)
        assert done.returncode == 70
        assert "component 'bad' called exit() after t = 0.12 s" in done.stderr
        assert "isolate = true in [components.bad]" in done.stderr

    def test_during_initialisation(self, fmus, tmp_path):
        done = script(SCRIPT, f"{fmus['good']}|{fmus['loading']}", tmp_path / "r", "auto", 1)
        assert done.returncode == 70
        assert "component 'bad' called exit()" in done.stderr
        assert Run.load(tmp_path / "r").outcome == "failed"

    def test_isolated_it_is_an_error(self, fmus):
        s = System("t", H, (Component("bad", str(fmus["exits"]), isolate=True),))
        with pytest.raises(RunError, match=r"its process exited with status 0 during the step from t = 0.12 s"):
            run(s, stop=4.0)

    def test_sys_exit(self, tmp_path):
        def function(u, t):
            if t > 0.01:
                sys.exit(0)
            return [t]

        bad = Mock("bad", [PortData("y", "output")], function)
        with pytest.raises(RunError, match=r"component 'bad' called sys.exit\(0\) after t = 0.008 s, which ends the process"):
            run(system([bad]), tmp_path / "r", stop=1.0, resolver=resolver([bad]))
        assert (len(Run.load(tmp_path / "r")), Run.load(tmp_path / "r").outcome) == (3, "failed")

    def test_a_good_run_leaves_nothing(self, fmus, tmp_path):
        run(System("t", H, (Component("good", str(fmus["good"])),)), tmp_path / "r", stop=0.1)
        assert sorted(p.name for p in (tmp_path / "r").iterdir()) == ["run.toml", "signals.parquet"]


SLOW = """
import signal, sys, time
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests run under nohup
from pathlib import Path
from robomill.orchestration.assembly import run
from robomill.orchestration.system.definition import Component, Connection, System
from tests.orchestration.mocks import resolver, source, system
s = source("s", lambda t: (time.sleep(0.01), t)[1])
made = system([s], "s.y -> x.u")
made = System("t", 0.004, (*made.components, Component("x", sys.argv[2], isolate=True)), made.connections)
def progress(done, total):
    if done == 5:
        print("stepping", flush=True)
run(made, Path(sys.argv[1]), stop=100.0, resolver=resolver([s]), progress=progress)
"""


@pytest.fixture
def running(fmus, tmp_path):
    """A process in the middle of a run into tmp_path / "r", with an FMU in a process of its own."""
    place = tmp_path / "temporary"
    place.mkdir()
    command = [sys.executable, "-c", SLOW, str(tmp_path / "r"), str(fmus["good"])]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(place)}
    process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "stepping\n"
    yield process
    process.kill()
    process.communicate()


def children(process: int) -> list[str]:
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process)], capture_output=True, text=True, check=False)
    return found.stdout.split()


class TestSignals:
    """SIGTERM and SIGHUP end a run as Ctrl-C does."""

    @pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
    def test_in_order(self, running, tmp_path, name):
        workers = children(running.pid)
        assert workers
        running.send_signal(getattr(signal, name))
        _, said = running.communicate(timeout=20)
        assert running.returncode != 0
        word = "the user" if name == "SIGINT" else f"{name} ({getattr(signal, name).value})"
        r = Run.load(tmp_path / "r")
        assert r.outcome == "interrupted"
        assert r.info["message"].startswith(f"interrupted by {word} at t = ")
        assert len(r) >= 6
        assert "Interrupted: interrupted" in said
        assert not any(Path(f"/proc/{w}").exists() for w in workers)
        assert list((tmp_path / "temporary").iterdir()) == []
        assert not (tmp_path / "r" / LOCK).exists()

    def test_the_error_names_the_signal(self):
        def press(done, total):
            if done == 5:
                os.kill(os.getpid(), signal.SIGTERM)

        before = signal.getsignal(signal.SIGTERM)
        s = source("s", lambda t: t)
        with pytest.raises(Interrupted, match=r"interrupted by SIGTERM \(15\) at t = 0.02 s") as caught:
            run(system([s]), stop=1.0, resolver=resolver([s]), progress=press)
        assert caught.value.signal == signal.SIGTERM
        assert signal.getsignal(signal.SIGTERM) is before


class TestOneFolder:
    """Two runs into one folder; a run that is there already."""

    def test_the_second_gets_an_error_at_once(self, running, tmp_path):
        s = source("s", lambda t: t)
        for options in ({"overwrite": True}, {"resume": True}):
            began = time.monotonic()
            with pytest.raises(ResultsError, match=rf"another run is being written there, by process {running.pid} on .* since 2"):
                run(system([s]), tmp_path / "r", stop=1.0, resolver=resolver([s]), **options)
            assert time.monotonic() - began < 5.0
        assert Run.load(tmp_path / "r").outcome == "running"
        assert Run.load(tmp_path / "r").info["message"] == ""

    def test_a_killed_process_leaves_no_lock(self, running, tmp_path):
        running.kill()
        running.wait()
        assert (tmp_path / "r" / LOCK).exists()
        s = source("s", lambda t: t)
        with pytest.raises(ResultsError, match="already holds a run"):
            run(system([s]), tmp_path / "r", stop=0.1, resolver=resolver([s]))
        left = Run.load(tmp_path / "r")
        assert len(left) >= 6
        assert left.info["message"].startswith("its process ended")
        assert len(run(system([s]), tmp_path / "r", stop=0.1, resolver=resolver([s]), overwrite=True)) == 26
        assert not (tmp_path / "r" / LOCK).exists()

    def test_also_within_one_process(self, tmp_path):
        s = source("s", lambda t: t)
        with FolderLock(tmp_path), pytest.raises(ResultsError, match=f"by process {os.getpid()} on"):
            run(system([s]), tmp_path, stop=0.1, resolver=resolver([s]))
        run(system([s]), tmp_path, stop=0.1, resolver=resolver([s]))

    def test_refused_before_anything_is_opened(self, tmp_path):
        s = source("s", lambda t: t)
        run(system([s]), tmp_path / "r", stop=0.1, resolver=resolver([s]))
        with pytest.raises(ResultsError, match=r"already holds a run .*--overwrite.*--resume"):
            run(System("t", H, (Component("x", "no.fmu"),)), tmp_path / "r", stop=0.1)

    def test_failed_run_gives_the_folder_back(self, tmp_path):
        bad = Mock("bad", [PortData("y", "output")], lambda u, t: [1 / 0])
        for _ in range(2):  # nothing has been computed: the second may do it again
            with pytest.raises(RunError, match="ZeroDivisionError"):
                run(system([bad]), tmp_path / "r", stop=0.1, resolver=resolver([bad]))
        assert read_info(tmp_path / "r")["outcome"] == "failed"

    def test_resumed_run(self, tmp_path):
        s = source("s", lambda t: t)
        made = system([s], recording=Recording(checkpoint_every=5))

        def stop(done, total):
            if done == 12:
                raise KeyboardInterrupt

        with pytest.raises(Interrupted):
            run(made, tmp_path / "r", stop=0.1, resolver=resolver([s]), progress=stop)
        again = run(made, tmp_path / "r", stop=0.1, resolver=resolver([s]), resume=True)
        assert list(again.t) == [k * 4 / 1000 for k in range(26)]
