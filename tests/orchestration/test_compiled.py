"""The compiled loop: the same bits as the loop in Python, the same errors, guards, ends and interruptions."""

from __future__ import annotations

import math
import os
import signal
from dataclasses import replace

import numpy as np
import pytest

from orchestration.assembly import run
from orchestration.errors import Interrupted, OrchestrationError, RunError, SystemFileError
from orchestration.results import Run
from orchestration.system import Component, Connection, Recording, System
from tests.orchestration import c_fmu
from tests.orchestration.mocks import gain, resolver, system

pytestmark = pytest.mark.skipif(c_fmu.compiler() is None, reason="no C compiler on this machine")


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return c_fmu.build(tmp_path_factory.mktemp("fmu"))


CONNECTIONS = (
    Connection("a.twice", "b.u"),
    Connection("b.twice", "c.u"),
    Connection("c.n", "a.offset"),
    Connection("c.on", "b.invert"),
    Connection("a.n", "b.offset", True),
)


def ring(fmu, algorithm="gauss-seidel", gains=(0.5, 1.0, 0.3), **more):
    """Three FMUs with reals, integers and booleans that hand them round."""
    components = tuple(Component(name, str(fmu), {"gain": g}) for name, g in zip("abc", gains, strict=True))
    return System("ring", 0.004, components, CONNECTIONS, algorithm, check_ranges=False, **more)


def rates(s, **by_name):
    return replace(s, components=tuple(replace(c, **by_name.get(c.name, {})) for c in s.components))


def both(s, tmp_path=None, stop=4.0, **options):
    """The same run by both loops."""
    folders = [tmp_path / kind if tmp_path else None for kind in ("python", "compiled")]
    return [run(s, folder, stop=stop, loop=kind, **options) for folder, kind in zip(folders, ("python", "compiled"), strict=True)]


def assert_equal(a, b):
    assert list(a.columns) == list(b.columns)
    assert a.t.tobytes() == b.t.tobytes()
    for name in a.columns:
        assert a[name].tobytes() == b[name].tobytes(), name


class TestParity:
    """EXACT."""

    @pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
    @pytest.mark.parametrize("change", [{}, {"b": {"rate": 4}}, {"b": {"every": 3}, "c": {"rate": 2}}, {"a": {"every": 7}}])
    def test_all_columns(self, fmu, algorithm, change):
        a, b = both(rates(ring(fmu, algorithm), **change))
        assert_equal(a, b)
        assert np.ptp(a["c.y"]) > 0.0
        assert len(np.unique(a["c.n"])) > 10

    def test_start_time_and_a_stop_that_is_no_multiple(self, fmu):
        assert_equal(*both(replace(ring(fmu), step=0.003), start=1.0, stop=2.0))

    @pytest.mark.parametrize(
        "recording",
        [
            Recording(),
            Recording(("a.y", "c.n", "b.on"), chunk=20),
            Recording(("a.y", "c.n", "b.on"), every=7, chunk=50),
            Recording(every=3, chunk=10_000),
        ],
    )
    def test_recorded_runs(self, fmu, tmp_path, recording):
        a, b = both(ring(fmu, recording=recording), tmp_path)
        assert_equal(a, b)
        assert len(a.t) == 1 + 1000 // recording.every
        assert b.outcome == "finished"

    def test_end_by_an_output(self, fmu):
        a, b = both(ring(fmu, stop_when="c.on", stop=None), stop=math.inf)
        assert_equal(a, b)
        assert b["c.on"][-1] == 1.0

    def test_observers_without_rows_see_every_step(self, fmu):
        class Keeper:
            def begin(self, wiring, step):
                self.seen = []

            def observe(self, t, outputs):
                self.seen.append((t, outputs.tolist()))

            def end(self, outcome, message):
                self.seen.append(outcome)

        keepers = Keeper(), Keeper()
        run(ring(fmu), stop=1.0, loop="python", observers=[keepers[0]])
        run(ring(fmu), stop=1.0, loop="compiled", observers=[keepers[1]])
        assert keepers[0].seen == keepers[1].seen
        assert len(keepers[0].seen) == 252

    def test_resumed_run(self, fmu, tmp_path):
        s = rates(ring(fmu, recording=Recording(checkpoint_every=100)), b={"every": 3})

        def stop(done, total):
            if done >= 333:
                os.kill(os.getpid(), signal.SIGINT)

        whole = run(s, tmp_path / "whole", stop=4.0, loop="python")
        with pytest.raises(Interrupted):
            run(s, tmp_path / "parts", stop=4.0, loop="compiled", progress=stop)
        assert_equal(whole, run(s, tmp_path / "parts", stop=4.0, loop="compiled", resume=True))


class TestErrors:
    """As in Python: what, where, when, and the rows up to there."""

    def failing(self, fmu, gain_):
        """The input of b grows until the FMU refuses it (above 100), or melts (above 1000)."""
        components = (Component("a", str(fmu), {"gain": gain_}), Component("b", str(fmu)))
        return System("x", 0.004, components, (Connection("a.n", "b.u"),), check_ranges=False)

    def test_error_of_an_fmu(self, fmu, tmp_path):
        texts = []
        for kind in ("python", "compiled"):
            with pytest.raises(RunError) as caught:
                run(self.failing(fmu, 1.0), tmp_path / kind, stop=4.0, loop=kind)
            texts.append(str(caught.value).replace(str(tmp_path / kind), ""))
            assert (caught.value.component, caught.value.time) == ("b", 0.4)
        assert texts[0] == texts[1]
        assert "overload at t = 0.400: u = 101" in texts[1]
        assert "high load at 0.396: 100" in texts[1]  # warnings on the way there did not end it
        assert_equal(Run.load(tmp_path / "python"), Run.load(tmp_path / "compiled"))

    def test_guard(self, fmu, tmp_path):
        s = replace(ring(fmu), components=tuple(replace(c, parameters={"gain": 5e8}) for c in ring(fmu).components), check_ranges=True)
        texts = []
        for kind in ("python", "compiled"):
            with pytest.raises(RunError) as caught:
                run(s, tmp_path / kind, stop=4.0, loop=kind)
            texts.append(str(caught.value).replace(str(tmp_path / kind), ""))
        assert texts[0] == texts[1]
        assert "is above its maximum 1000000 m" in texts[1]
        assert_equal(Run.load(tmp_path / "python"), Run.load(tmp_path / "compiled"))

    def test_infinity_without_ranges(self, fmu):
        s = replace(ring(fmu), components=tuple(replace(c, parameters={"gain": 1e308}) for c in ring(fmu).components))
        texts = []
        for kind in ("python", "compiled"):
            with pytest.raises(RunError) as caught:
                run(s, stop=40.0, loop=kind)
            texts.append(str(caught.value))
        assert texts[0] == texts[1]
        assert "is infinite (inf m)" in texts[1]

    def test_ctrl_c_ends_between_two_chunks(self, fmu, tmp_path):
        def press(done, total):
            if done > 200:
                os.kill(os.getpid(), signal.SIGINT)

        with pytest.raises(Interrupted) as caught:
            run(ring(fmu), tmp_path / "run", stop=1e4, loop="compiled", progress=press)
        kept = Run.load(tmp_path / "run")
        assert kept.t[-1] == caught.value.time
        assert kept.outcome == "interrupted"
        assert len(kept.t) > 200


class TestChoice:
    """Which loop runs."""

    def test_what_cannot_be_compiled_runs_in_python_or_says_so(self, fmu):
        slaves = [gain("a")]
        assert run(system(slaves), stop=0.04, resolver=resolver(slaves), loop="auto").outcome == "finished"
        with pytest.raises(
            OrchestrationError, match=r"loop = 'compiled' is not possible: component 'a' \(Mock\) can only be called from Python"
        ):
            run(system(slaves), stop=0.04, resolver=resolver(slaves), loop="compiled")
        with pytest.raises(OrchestrationError, match="algorithm = 'iterated' goes back and forth in Python"):
            run(ring(fmu, "iterated"), stop=0.04, loop="compiled")
        with pytest.raises(OrchestrationError, match="manipulators are called before each step"):
            run(ring(fmu), stop=0.04, loop="compiled", manipulators=[lambda master, t: None])

    def test_unknown_loop(self, fmu, tmp_path):
        with pytest.raises(SystemFileError, match="loop 'fast' is unknown; available: auto, compiled, python"):
            run(ring(fmu), loop="fast", stop=1.0)
        (tmp_path / "system.toml").write_text('name = "x"\nstep = 0.004\nloop = "python"\n[components.a]\nsource = "mock"\n')
        assert System.load(tmp_path / "system.toml").loop == "python"

    def test_override_between_chunks_moves_the_input(self, fmu):
        """An observer may hold the master and override; the next chunk gathers from the new place."""
        from orchestration.assembly import assemble
        from orchestration.master import Master
        from orchestration.memory import Memory

        with assemble(ring(fmu)) as a:
            memory = Memory()
            master = Master(a.slaves, a.wiring, 0.004, observers=(memory,), check_ranges=False, loop="compiled")
            master.run(1.0, progress=lambda k, n: master.override("b.u", 8.0))
            assert np.all(memory.run()["b.twice"][20:] == 16.0)
