"""FMUs in their own process: the same numbers; a crash, a hang or an exit there costs one error and no result."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import RunError, SlaveError, SystemFileError
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.isolation import IsolatedSlave
from robomill.orchestration.slaves.protocol import Slave
from robomill.orchestration.system.definition import Component, System
from tests.orchestration import c_fmu
from tests.orchestration.mocks import resolver, source, system

pytestmark = pytest.mark.usefixtures("temporary")

BAD = "if (m->mode != 2)"
DEATHS = {
    "aborts": 'if (t > 0.019) { puts("about to abort"); fflush(stdout); abort(); }',
    "segfaults": "if (t > 0.019) *(volatile int *)0 = 1;",
    "exits": "if (t > 0.019) exit(3);",
    "hangs": "if (t > 0.019) for (;;) {}",
}


@pytest.fixture(scope="module")
def fmus(tmp_path_factory) -> dict[str, Path]:
    """The Euler FMU, and versions of it that die in the step from t = 0.02 s or, "loading", when they are instantiated."""
    if c_fmu.compiler() is None:
        pytest.skip("no C compiler here")
    made = {"good": c_fmu.build(tmp_path_factory.mktemp("good"))}
    sources = {name: c_fmu.SOURCE.replace(BAD, f"{code} {BAD}", 1) for name, code in DEATHS.items()}
    sources["loading"] = c_fmu.SOURCE.replace("Model *m;\n", "Model *m; abort();\n", 1)
    sources["stuck"] = c_fmu.SOURCE.replace("Model *m;\n", "Model *m; for (;;) {}\n", 1)
    for name, text in sources.items():
        assert text != c_fmu.SOURCE
        made[name] = c_fmu.build(tmp_path_factory.mktemp(name), text)
    return made


def driven(file: Path, isolate: bool, limit: float = 60.0) -> tuple[System, object]:
    s = source("s", lambda t: t - 0.01)
    made = system([s], "s.y -> x.u")
    x = Component("x", str(file), {"gain": 3.0, "label": "a"}, isolate=isolate, time_limit=limit)
    return System("t", 0.004, (*made.components, x), made.connections), resolver([s])


class TestSameNumbers:
    """Isolation changes no bit."""

    def test_as_in_this_process(self, fmus):
        results = []
        for isolate in (False, True):
            made, resolve = driven(fmus["good"], isolate)
            results.append(run(made, stop=0.4, resolver=resolve))
        here, there = results
        assert list(here.columns) == list(there.columns)
        for name in here.columns:
            assert np.array_equal(here[name], there[name]), name
        assert np.ptp(here["x.y"]) > 0.0
        assert here.ports == there.ports

    def test_is_another_process(self, fmus):
        slave = IsolatedSlave(fmus["good"], "x")
        try:
            assert isinstance(slave, Slave)
            assert slave.process_id != os.getpid()
            os.kill(slave.process_id, 0)
        finally:
            slave.close()
            slave.close()
        with pytest.raises(ProcessLookupError):
            os.kill(slave.process_id, 0)
        with pytest.raises(SlaveError, match="component 'x' was closed"):
            slave.step(0.0, 0.1)

    @pytest.mark.parametrize("serialises", [True, False])
    def test_states(self, fmus, serialises, tmp_path):
        text = c_fmu.DESCRIPTION.replace('canSerializeFMUstate="true"', f'canSerializeFMUstate="{str(serialises).lower()}"')
        file = c_fmu.build(tmp_path, description=text)
        slave = IsolatedSlave(file, "x")
        try:
            slave.initialise(0.0, 1.0, 0.1)
            out, again = np.zeros(4), np.zeros(4)
            slave.set_inputs(np.array([2.0, 0.0, 0.0]))
            slave.step(0.0, 0.1)
            state = slave.get_state()
            slave.step(0.1, 0.1)
            slave.get_outputs(out)
            slave.set_state(state)
            slave.step(0.1, 0.1)
            slave.get_outputs(again)
            assert np.array_equal(out, again)
            assert out[0] == 0.1 * 2.0 + 0.1 * 2.0
        finally:
            slave.close()

    def test_errors_of_the_fmu_itself(self, fmus):
        """Status and log messages come through; the process stays."""
        slave = IsolatedSlave(fmus["good"], "x")
        try:
            slave.initialise(0.0, 1.0, 0.1)
            slave.set_inputs(np.array([200.0, 0.0, 0.0]))
            with pytest.raises(
                SlaveError, match=r"fmi2DoStep\(t = 0, h = 0.1\) returned 3 \(error\); it says:\n  overload at t = 0.000: u = 200"
            ):
                slave.step(0.0, 0.1)
            slave.set_inputs(np.array([1.0, 0.0, 0.0]))
            slave.step(0.0, 0.1)
        finally:
            slave.close()


class TestDeaths:
    """Whatever the process dies of."""

    @pytest.mark.parametrize(
        ("how", "text"),
        [
            ("aborts", r"crashed with signal 6 \(SIGABRT\) during the step from t = 0.02 s; the last that it printed:\n  about to abort"),
            ("segfaults", r"crashed with signal 11 \(SIGSEGV\) during the step from t = 0.02 s"),
            ("exits", r"exited with status 3 during the step from t = 0.02 s"),
            ("hangs", r"did not answer within 0.5 s during the step from t = 0.02 s and was ended \(time_limit\)"),
        ],
    )
    def test_one_error_and_all_earlier_results(self, fmus, how, text, tmp_path):
        made, resolve = driven(fmus[how], True, 0.5)
        started = time.monotonic()
        with pytest.raises(
            RunError, match=rf"component 'x' failed in the step from t = 0.02 s: component 'x': its process {text}"
        ) as found:
            run(made, tmp_path / "run", stop=1.0, resolver=resolve)
        assert time.monotonic() - started < 20.0
        assert (found.value.component, found.value.time) == ("x", 0.02)
        partial = Run.load(tmp_path / "run")
        assert partial.outcome == "failed"
        assert partial.t.tolist() == [0.0, 0.004, 0.008, 0.012, 0.016, 0.02]
        good, resolve = driven(fmus["good"], False)
        whole = run(good, stop=0.02, resolver=resolve)
        for name in whole.columns:
            assert np.array_equal(partial[name], whole[name]), name

    def test_while_loading(self, fmus):
        made, resolve = driven(fmus["loading"], True)
        with pytest.raises(
            RunError, match=r"component 'x' failed during initialisation: .* crashed with signal 6 \(SIGABRT\) during initialise"
        ):
            run(made, stop=1.0, resolver=resolve)

    def test_stuck_while_loading(self, fmus, monkeypatch):
        """There compilers may run, so the limit is longer; but there is one."""
        monkeypatch.setattr("robomill.orchestration.slaves.isolation.START_LIMIT", 2.0)
        made, resolve = driven(fmus["stuck"], True, 0.5)
        with pytest.raises(RunError, match=r"did not answer within 2 s during initialise and was ended \(time_limit\)"):
            run(made, stop=1.0, resolver=resolve)

    def test_ctrl_c_reaches_the_master_only(self, fmus, tmp_path):
        """The terminal sends it to all processes of the group; the FMU's is in another, and is closed in order."""
        script = (
            "import os, signal\nfrom robomill.orchestration.assembly import run\nfrom robomill.orchestration.errors import Interrupted\n"
            "from robomill.orchestration.system.definition import Component, System\n"
            f"s = System('t', 0.001, (Component('x', {str(fmus['good'])!r}, isolate=True),))\n"
            "def press(done, total):\n    if done == 50: os.killpg(0, signal.SIGINT)\n"
            f"try:\n    run(s, {str(tmp_path / 'run')!r}, stop=1e3, progress=press)\nexcept Interrupted as e:\n    print(e)\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, start_new_session=True, check=False, timeout=60
        )
        assert done.stdout.startswith("interrupted at t = 0.05 s; results up to there are in"), done.stderr
        assert Run.load(tmp_path / "run").outcome == "interrupted"

    def test_a_file_that_is_no_fmu(self, tmp_path):
        (tmp_path / "x.fmu").write_text("hello")
        with pytest.raises(SystemFileError, match=r"component 'x': .*x.fmu: not a zip archive, so not an FMU"):
            run(System("t", 0.1, (Component("x", str(tmp_path / "x.fmu"), isolate=True),)), stop=1.0)

    def test_it_goes_when_this_process_is_killed(self, fmus):
        """Even while it hangs in a step."""
        script = (
            "import sys, numpy as np\nfrom robomill.orchestration.slaves.isolation import IsolatedSlave\n"
            f"s = IsolatedSlave({str(fmus['hangs'])!r}, 'x')\ns.initialise(0.0, 1.0, 0.1)\n"
            "print(s.process_id, flush=True)\ns.step(0.5, 0.1)\n"
        )
        with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as caller:
            assert caller.stdout is not None
            number = int(caller.stdout.readline())
            time.sleep(0.2)
            caller.kill()
        for _ in range(100):
            try:
                os.kill(number, 0)
            except ProcessLookupError:
                break
            time.sleep(0.05)
        else:
            pytest.fail("the process of the FMU is still there")
        for left in Path(tempfile.gettempdir()).glob("robomill_*"):
            shutil.rmtree(left)


class TestSystemFile:
    """`isolate` and `time_limit`."""

    def load(self, tmp_path, lines):
        (tmp_path / "s.toml").write_text(f'name = "s"\nstep = "0.1 s"\n[components.x]\n{lines}\n')
        return System.load(tmp_path / "s.toml", lambda v, u, w: v / 1000 if (u, w) == ("ms", "s") else v)

    def test_keys(self, tmp_path):
        c = self.load(tmp_path, 'source = "x.fmu"\nisolate = true\ntime_limit = "500 ms"').component("x")
        assert (c.isolate, c.time_limit) == (True, 0.5)

    @pytest.mark.parametrize(
        ("lines", "text"),
        [
            ('source = "x.fmu"\ntime_limit = 3', r"s.toml:5: \[components\] x.time_limit: needs isolate = true"),
            ('source = "x.fmu"\nisolate = true\ntime_limit = 0', r"component 'x': time_limit is a positive time; found 0.0 s"),
            ('source = "x.fmu"\nisolate = 1', r"s.toml:5: \[components\] x.isolate: expected true or false; found 1"),
        ],
    )
    def test_refused(self, tmp_path, lines, text):
        with pytest.raises(SystemFileError, match=text):
            self.load(tmp_path, lines)

    def test_only_fmus(self):
        with pytest.raises(SystemFileError, match=r"component 'x': isolate = true is for FMUs; source 'mock' runs in this process"):
            run(System("t", 0.1, (Component("x", "mock", isolate=True),)), stop=1.0)
