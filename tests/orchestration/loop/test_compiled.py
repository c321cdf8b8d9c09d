"""The compiled loop: the same bits as the loop in Python, the same errors, guards, ends and interruptions."""

from __future__ import annotations

import math
import os
import signal
from dataclasses import replace

import numpy as np
import pytest

from robomill.orchestration.assembly import assemble, run
from robomill.orchestration.errors import Interrupted, OrchestrationError, RunError, SystemFileError
from robomill.orchestration.loop import compiled_iteration, loop_code
from robomill.orchestration.loop import compiled_master as chunks
from robomill.orchestration.loop.acceleration import HOLDS, METHODS, Iteration
from robomill.orchestration.loop.master import Master
from robomill.orchestration.runs.memory import Memory
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.definition import Component, Connection, Recording, System
from tests.orchestration import c_fmu
from tests.orchestration.mocks import Mock, gain, resolver, source, system

pytestmark = pytest.mark.skipif(c_fmu.compiler() is None, reason="no C compiler on this machine")


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return c_fmu.build(tmp_path_factory.mktemp("fmu"))


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    """Without units, with gains below zero, and y = 1 at the start."""
    text = (
        c_fmu.DESCRIPTION.replace(' declaredType="Length"', "")
        .replace(' unit="1"/>', "/>")
        .replace('<Real start="1" min="0"/>', '<Real start="1"/>')
    )
    source = c_fmu.SOURCE.replace("m->v.gain = 1.0;", "m->v.gain = m->v.y = 1.0;")
    return c_fmu.build(tmp_path_factory.mktemp("fmu"), source, text)


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
    """One run by both loops."""
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


def oscillator(fmu, **settings):
    """Two integrators in a ring, x' = 2 v, v' = -2 x, and one that looks on."""
    components = (Component("a", str(fmu), {"gain": 2.0}), Component("b", str(fmu), {"gain": -2.0}), Component("on", str(fmu)))
    wires = (Connection("a.y", "b.u"), Connection("b.y", "a.u"), Connection("a.y", "on.u"))
    return System(
        "oscillator", 0.02, components, wires, "iterated", check_ranges=False, iteration=Iteration(**settings)
    )  # fmt: skip


@pytest.fixture
def compiled_steps(monkeypatch):
    """How many steps compiled code has made, by kernel."""
    made = {}
    for module in (loop_code, compiled_iteration):

        def count(*arguments, kernel=module.advance, module=module):
            done = kernel(*arguments)
            made[module] = made.get(module, 0) + done
            return done

        monkeypatch.setattr(module, "advance", count)
    return made


class TestIterated:
    """Iterated coupling: EXACT, rounds and residuals too."""

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("hold", HOLDS)
    def test_methods(self, free, method, hold, compiled_steps):
        a, b = both(oscillator(free, method=method, hold=hold, tolerance=1e-13))
        assert_equal(a, b)
        assert compiled_steps[compiled_iteration] > 190
        assert np.ptp(b["a.y"]) > 1.0
        assert b["master.iterations"].min() > 1

    @pytest.mark.parametrize("change", [{"b": {"rate": 4}}, {"on": {"every": 3}}, {"a": {"rate": 2}, "on": {"rate": 5}}])
    def test_rates(self, free, change, compiled_steps):
        assert_equal(*both(rates(oscillator(free, tolerance=1e-12), **change)))
        assert compiled_steps[compiled_iteration] > 190

    def test_two_loops_and_a_delayed_connection(self, free, compiled_steps):
        extra = Component("c", str(free), {"gain": -1.0}), Component("d", str(free), {"gain": 3.0})
        s = System(
            "two", 0.02, (*oscillator(free).components, *extra),
            (*oscillator(free).connections, Connection("c.y", "d.u"), Connection("d.y", "c.u"), Connection("on.n", "a.offset", True)),
            "iterated", check_ranges=False, iteration=Iteration("anderson", tolerance=1e-12, hold="mean"),
        )  # fmt: skip
        assert_equal(*both(s))
        assert compiled_steps[compiled_iteration] > 190

    def test_component_that_is_called_back_in_the_loop(self, free, compiled_steps):
        """Its states go through `get_state` and `set_state`."""
        connections = (Connection("a.y", "m.u"), Connection("m.y", "a.u"))
        for method in METHODS:
            s = System(
                "mixed", 0.02, (Component("a", str(free), {"gain": 3.0}), Component("m", "mock")), connections, "iterated",
                iteration=Iteration(method, tolerance=1e-9),
            )  # fmt: skip
            assert_equal(*both(s, resolver=lambda source, name: gain("m", -1.0, 2.0)))
        assert compiled_steps[compiled_iteration] > 3 * 190

    def test_no_convergence(self, free):
        """From t = 1 s on the loop amplifies."""
        texts = []
        for kind in ("python", "compiled"):
            s = System(
                "mixed", 0.02, (Component("a", str(free), {"gain": 3.0}), Component("m", "mock")),
                (Connection("a.y", "m.u"), Connection("m.y", "a.u")), "iterated",
                iteration=Iteration("fixed-point", max_iterations=14), check_ranges=False,
            )  # fmt: skip
            wild = Mock("m", gain("m").ports, lambda u, t: [-u[0] * (1.0 if t < 1.01 else 20.0)])
            with pytest.raises(RunError) as caught:
                run(s, stop=4.0, loop=kind, resolver=lambda source, name, wild=wild: wild)
            texts.append((str(caught.value), caught.value.component, caught.value.time))
        assert texts[0] == texts[1]
        assert texts[0][0].startswith("in the step from t = 1 s: the loop a -> m -> a did not converge in 14 iterations: m.y still changes")

    def test_override_ends_the_mean(self, free):
        s, kept = oscillator(free, hold="mean", tolerance=1e-12), []
        for kind in ("python", "compiled"):
            with assemble(s) as a:
                memory = Memory()
                master = Master(a.slaves, a.wiring, s.step, "iterated", (memory,), check_ranges=False, iteration=s.iteration, loop=kind)
                master.run(0.2)
                master.override("b.u", 0.25)
                master._loop(100, None, None)
                kept.append(memory.run())
        assert_equal(*kept)

    def test_state_that_cannot_be_put_back_any_more(self, free):
        """After the proof, in the middle of the run."""

        class Forgetful(Mock):
            def set_state(self, state):
                if self.t > 1.0:
                    raise SystemFileError("lost")
                super().set_state(state)

        texts = []
        for kind in ("python", "compiled"):
            s = System(
                "mixed", 0.02, (Component("a", str(free), {"gain": 3.0}), Component("m", "mock")),
                (Connection("a.y", "m.u"), Connection("m.y", "a.u")), "iterated",
            )  # fmt: skip
            with pytest.raises(RunError) as caught:
                run(s, stop=4.0, loop=kind, resolver=lambda source, name: Forgetful("m", gain("m").ports, lambda u, t: [-u[0] + t]))
            texts.append((str(caught.value), caught.value.component, caught.value.time))
        assert texts[0] == texts[1]
        assert "component 'm' failed in the step from t = 1 s: lost" in texts[0][0]

    @pytest.mark.parametrize(
        ("call", "condition"),
        [("fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) {", "((Values *)s)->n"), ("*s = malloc(sizeof(Values));", "n")],
    )
    def test_fmu_that_loses_its_state(self, tmp_path, call, condition):
        """After 70 steps keeping a state, or going back to it, becomes an error."""
        count = "((Model *)c)->v.n" if condition == "n" else condition
        assert call in c_fmu.SOURCE
        source = c_fmu.SOURCE.replace(call, f"{call} if ({count} > 70) return fmi2Error;")
        source = source.replace("m->v.gain = 1.0;", "m->v.gain = m->v.y = 1.0;")
        file = c_fmu.build(tmp_path, source)
        components = (Component("a", str(file), {"gain": 3.0}), Component("m", "mock"))
        s = System("mixed", 0.02, components, (Connection("a.y", "m.u"), Connection("m.y", "a.u")), "iterated")
        texts = []
        for kind in ("python", "compiled"):
            ports = [PortData("u", "input", start=0.0), PortData("y", "output")]
            with pytest.raises(RunError) as caught:
                run(s, stop=4.0, loop=kind, resolver=lambda s, n, ports=ports: Mock("m", ports, lambda u, t: [-u[0]]))
            texts.append((str(caught.value), caught.value.component, caught.value.time))
        assert texts[0] == texts[1]
        assert f"fmi2{'Get' if condition == 'n' else 'Set'}FMUstate returned 3 (error)" in texts[0][0]


class TestMixed:
    """Components that can only be called from Python beside others: EXACT."""

    def system(self, free, algorithm):
        components = (Component("a", str(free), {"gain": 0.5}), Component("m", "mock"), Component("b", str(free)), Component("s", "mock"))
        connections = (Connection("s.y", "a.u"), Connection("a.y", "m.u"), Connection("m.y", "b.u"), Connection("b.n", "a.offset", True))
        return System("mixed", 0.004, components, connections, algorithm, check_ranges=False)

    def slave(self, source_, name):
        return gain("m", 3.0, -1.0) if name == "m" else source("s", np.sin)

    @pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "iterated"])
    @pytest.mark.parametrize("change", [{}, {"m": {"rate": 2}, "a": {"every": 3}}, {"m": {"every": 5}}])
    def test_all_columns(self, free, algorithm, change, compiled_steps):
        a, b = both(rates(self.system(free, algorithm), **change), resolver=self.slave)
        assert_equal(a, b)
        assert sum(compiled_steps.values()) > 900 or (algorithm, "a" in change) == ("iterated", True)

    def test_error_of_the_one_that_is_called_back(self, free, tmp_path):
        class Tired(Mock):
            def step(self, t, h):
                if t > 1.0:
                    raise SystemFileError("tired")
                super().step(t, h)

        texts = []
        for kind in ("python", "compiled"):
            with pytest.raises(RunError) as caught:
                run(
                    self.system(free, "jacobi"), tmp_path / kind, stop=4.0, loop=kind,
                    resolver=lambda s, n: Tired("m", gain("m").ports, lambda u, t: u) if n == "m" else source("s", np.sin),
                )  # fmt: skip
            texts.append(str(caught.value).replace(str(tmp_path / kind), ""))
        assert texts[0] == texts[1]
        assert "component 'm' failed in the step from t = 1.004 s: tired" in texts[0]
        assert_equal(Run.load(tmp_path / "python"), Run.load(tmp_path / "compiled"))

    def test_second_ctrl_c_ends_at_once(self, free):
        class Slow(Mock):
            def step(self, t, h):
                if t >= 1.0:
                    os.kill(os.getpid(), signal.SIGINT)
                super().step(t, h)

        slow = Slow("m", gain("m").ports, lambda u, t: u)
        with pytest.raises(Interrupted):
            run(self.system(free, "jacobi"), stop=1e4, loop="compiled", resolver=lambda s, n: slow if n == "m" else source("s", np.sin))
        assert len(slow.calls) == 251


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

    def test_what_cannot_be_compiled_runs_in_python_or_says_so(self, fmu, free):
        slaves = [gain("a")]
        assert run(system(slaves), stop=0.04, resolver=resolver(slaves), loop="auto").outcome == "finished"
        with pytest.raises(
            OrchestrationError, match=r"loop = 'compiled' is not possible: component 'a' \(Mock\) can only be called from Python"
        ):
            run(system(slaves), stop=0.04, resolver=resolver(slaves), loop="compiled")
        with pytest.raises(OrchestrationError, match=r"the loop a -> b -> c -> a hands round a whole number: input a.offset"):
            run(ring(fmu, "iterated"), stop=0.04, loop="compiled")
        with pytest.raises(OrchestrationError, match="component 'b' is in the loop a -> b -> a and steps only once in 3 steps"):
            run(rates(oscillator(free), b={"every": 3}), stop=0.04, loop="compiled")
        with pytest.raises(OrchestrationError, match="manipulators are called before each step"):
            run(ring(fmu), stop=0.04, loop="compiled", manipulators=[lambda master, t: None])

    def test_unknown_loop(self, fmu, tmp_path):
        with pytest.raises(SystemFileError, match="unknown loop 'fast'; available: auto, compiled, python"):
            run(ring(fmu), loop="fast", stop=1.0)
        (tmp_path / "system.toml").write_text('name = "x"\nstep = "0.004 s"\nloop = "python"\n[components.a]\nsource = "mock"\n')
        assert System.load(tmp_path / "system.toml").loop == "python"

    def test_override_between_chunks_moves_the_input(self, fmu):
        """An observer may hold the master and override; the next chunk gathers from the new place."""
        with assemble(ring(fmu)) as a:
            memory = Memory()
            master = Master(a.slaves, a.wiring, 0.004, observers=(memory,), check_ranges=False, loop="compiled")
            master.run(1.0, progress=lambda k, n: master.override("b.u", 8.0))
            assert np.all(memory.run()["b.twice"][20:] == 16.0)

    def test_one_chunk_that_took_long_does_not_make_the_next_shorter(self, fmu, monkeypatch):
        """It may have loaded compiled code, or waited for the disk; two in a row say that the system is slow."""
        monkeypatch.setattr(chunks, "_CHUNK_TIME", 0.0)  # s; everything takes longer
        counts = []
        with assemble(ring(fmu)) as a:
            master = Master(a.slaves, a.wiring, 0.004, check_ranges=False, loop="compiled")
            master.run(0.084, progress=lambda k, n: counts.append(k))
        assert np.diff(counts).tolist() == [8, 8, 4]
