"""The master with fakes: delays, order, convergence, errors, interruption, determinism."""

from __future__ import annotations

import math
import os
import signal

import numpy as np
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import Interrupted, OrchestrationError, RunError, SystemFileError, WiringError
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData, Slave
from tests.orchestration.mocks import Integrator, Mock, gain, resolver, source, system
from tests.tolerances import EXACT, ROUNDOFF, discretisation


def simulate(slaves, *connections, stop=0.04, folder=None, **more):
    run_options = {k: more.pop(k) for k in ("progress", "observers", "manipulators", "start") if k in more}
    s = system(slaves, *connections, **more)
    return run(s, folder, stop=stop, resolver=resolver(slaves), **run_options)


def chain():
    return [source("s", lambda t: t), gain("a", 1.0), gain("b", 1.0), gain("c", 1.0)]


CHAIN = ("s.y -> a.u", "a.y -> b.u", "b.y -> c.u")


class TestDelays:
    """What each algorithm delays, step for step."""

    def test_mocks_are_slaves(self):
        assert isinstance(gain("a"), Slave)

    def test_jacobi_delays_by_one_step_per_hop(self):
        r = simulate(chain(), *CHAIN, algorithm="jacobi")
        for hops, name in enumerate("sabc"):
            expected = np.concatenate([np.zeros(hops), r.t[: len(r.t) - hops]])
            assert np.array_equal(r[f"{name}.y"], expected), name

    def test_gauss_seidel_does_not_delay(self):
        r = simulate(chain(), *CHAIN)
        for name in "sabc":
            assert np.array_equal(r[f"{name}.y"], r.t), name

    def test_gauss_seidel_delays_where_it_is_told_to(self):
        r = simulate(chain(), "s.y -> a.u", "a.y => b.u", "b.y -> c.u")
        late = np.concatenate([[0.0], r.t[:-1]])
        assert np.array_equal(r["a.y"], r.t)
        assert np.array_equal(r["b.y"], late)
        assert np.array_equal(r["c.y"], late)

    def test_delayed_changes_nothing_with_jacobi(self):
        a = simulate(chain(), *CHAIN, algorithm="jacobi")
        b = simulate(chain(), *(c.replace("->", "=>") for c in CHAIN), algorithm="jacobi")
        assert np.array_equal(a["c.y"][1:], b["c.y"][1:])

    def test_order_of_the_file_does_not_matter_to_gauss_seidel(self):
        r = simulate(chain()[::-1], *CHAIN)
        assert np.array_equal(r["c.y"], r.t)

    def test_order_of_calls(self):
        log: list[str] = []
        slaves = chain()[::-1]
        for s in slaves:
            s.calls = log
        simulate(slaves, *CHAIN, stop=0.008)
        assert log == ["s(0)", "a(0)", "b(0)", "c(0)", "s(0.004)", "a(0.004)", "b(0.004)", "c(0.004)"]

    def test_outputs_at_the_start_follow_the_inputs_through_the_whole_chain(self):
        slaves = [gain("b", 2.0), gain("a", 2.0, offset=1.0), source("s", lambda t: 5.0)]
        for algorithm in ("jacobi", "gauss-seidel"):
            r = simulate(slaves, "s.y -> a.u", "a.y -> b.u", stop=0.0, algorithm=algorithm)
            assert (r["s.y"][0], r["a.y"][0], r["b.y"][0]) == (5.0, 11.0, 22.0)

    def test_delayed_input_has_its_start_value_at_the_start_and_the_first_output_in_the_first_step(self):
        slaves = [source("s", lambda t: 7.0 + t), gain("a")]
        r = simulate(slaves, "s.y => a.u", stop=0.004)
        assert list(r["a.y"]) == [0.0, 7.0]


class TestTime:
    """Integer time, the end of a run, progress."""

    def test_time_is_counted_in_whole_nanoseconds(self):
        r = simulate([source("s", lambda t: t)], step=0.1, stop=100.0)
        assert list(r.t) == [k / 10 for k in range(1001)]  # no drift: each is the double nearest to k/10

    def test_a_run_that_is_no_multiple_of_the_step_covers_the_stop_time(self):
        r = simulate([source("s", lambda t: t)], step=0.003, stop=0.01)
        assert r.t[-1] == 0.012

    def test_start_time(self):
        r = simulate([source("s", lambda t: t)], start=2.0, stop=2.008)
        assert list(r.t) == [2.0, 2.004, 2.008]

    def test_progress(self):
        seen = []
        simulate([source("s", lambda t: t)], stop=0.012, progress=lambda k, n: seen.append((k, n)))
        assert seen == [(1, 3), (2, 3), (3, 3)]

    def test_ends_when_an_output_says_so(self):
        finished = Mock("s", [PortData("done", "output", type="boolean")], lambda u, t: [t >= 0.02])
        r = simulate([finished], stop_when="s.done", stop=None)
        assert r.t[-1] == 0.02

    def test_a_run_without_an_end_is_refused(self):
        with pytest.raises(OrchestrationError, match="has no end: give stop, or set stop or stop_when"):
            simulate([source("s", lambda t: t)], stop=None)

    def test_stop_before_start_is_refused(self):
        with pytest.raises(OrchestrationError, match="stops at 1 s, before it starts at 2 s"):
            simulate([source("s", lambda t: t)], start=2.0, stop=1.0)

    def test_step_must_be_whole_nanoseconds(self):
        with pytest.raises(SystemFileError, match=r"step = 1e-10 s is not a positive whole number of nanoseconds"):
            simulate([source("s", lambda t: t)], step=1e-10)

    def test_unknown_stop_when(self):
        with pytest.raises(WiringError, match=r"stop_when: unknown output 's.z'; did you mean 's.y'\? available: s.y"):
            simulate([source("s", lambda t: t)], stop_when="s.z")


OMEGA, T_END = 2.0, 2.0


def oscillator(algorithm: str, h: float) -> Run:
    """The oscillator x' = v, v' = -w^2 x, each half integrated exactly with the other held: x = cos(w t), v = -w sin(w t)."""
    slaves = [Integrator("x", 1.0, 1.0), Integrator("v", -(OMEGA**2), 0.0)]
    return simulate(slaves, "x.y -> v.u", "v.y -> x.u", algorithm=algorithm, step=h, stop=T_END)


def error(r: Run) -> float:
    """Largest error of x + i v / w."""
    z = r["x.y"] - 1j * r["v.y"] / OMEGA
    return float(np.max(np.abs(z - np.exp(1j * OMEGA * r.t))))


class TestConvergence:
    """Coupled oscillator with closed form; held inputs make both algorithms first order."""

    def test_jacobi_is_explicit_euler(self):
        h = 0.01
        r = oscillator("jacobi", h)
        z = (1 + 1j * OMEGA * h) ** np.arange(len(r.t))
        assert np.max(np.abs(r["x.y"] - z.real)) <= ROUNDOFF * np.max(np.abs(z))

    def test_gauss_seidel_is_symplectic_euler(self):
        h = 0.01
        r = oscillator("gauss-seidel", h)
        x, v = r["x.y"], r["v.y"]
        invariant = v**2 + OMEGA**2 * x**2 + h * OMEGA**2 * x * v  # exact invariant of the map x += h v, v -= h w^2 x
        assert np.max(np.abs(invariant / invariant[0] - 1)) <= ROUNDOFF * len(x)

    @pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
    def test_first_order(self, algorithm):
        steps = [0.02, 0.01, 0.005]
        errors = [error(oscillator(algorithm, h)) for h in steps]
        # |(1 + i w h)^n - e^(i w T)| <= (w h)^2/2 per step, grown by at most |1 + i w h|^n <= e^(w^2 h T/2);
        # symplectic Euler is conjugate to leapfrog by half a step: its error is below the same bound
        constant = OMEGA**2 * T_END / 2 * math.exp(OMEGA**2 * steps[0] * T_END / 2)
        for h, e in zip(steps, errors, strict=True):
            assert e <= discretisation(constant, h, 1)
        orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
        assert np.all(np.abs(orders - 1.0) <= discretisation(OMEGA * T_END, steps[0], 1)), orders

    def test_the_two_algorithms_meet_as_the_step_shrinks(self):
        def gap(h):
            a, b = oscillator("jacobi", h), oscillator("gauss-seidel", h)
            return float(np.max(np.abs(a["x.y"] - b["x.y"])))

        gaps = [gap(h) for h in (0.02, 0.01, 0.005)]
        assert gaps[0] > gaps[1] > gaps[2] > 0
        assert gaps[2] <= gaps[0] / 3  # first order: a quarter in the limit


class TestGuards:
    """Outputs that are not numbers or out of range."""

    @pytest.mark.parametrize(
        ("bad", "words"),
        [
            (math.nan, r"component 'a' at t = 0.012 s: output y is not a number \(NaN\)"),
            (math.inf, r"component 'a' at t = 0.012 s: output y is infinite \(inf N\)"),
            (3.0, r"component 'a' at t = 0.012 s: output y = 3 N is above its maximum 2 N"),
            (-1.5, r"component 'a' at t = 0.012 s: output y = -1.5 N is below its minimum -1 N"),
        ],
    )
    @pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
    def test_bad_output_ends_the_run(self, bad, words, algorithm, tmp_path):
        port = PortData("y", "output", unit="N", minimum=-1.0, maximum=2.0)
        a = Mock("a", [port], lambda u, t: [bad if t > 0.01 else 1.0])
        with pytest.raises(RunError, match=words) as caught:
            simulate([a], algorithm=algorithm, folder=tmp_path / "run")
        assert (caught.value.component, caught.value.time) == ("a", 0.008)
        assert "Results up to t = 0.008 s are in" in str(caught.value)
        kept = Run.load(tmp_path / "run")
        assert list(kept.t) == [0.0, 0.004, 0.008]
        assert kept.outcome == "failed"
        assert "output y" in kept.info["message"]

    def test_range_check_can_be_turned_off_but_not_the_one_for_nan(self):
        port = PortData("y", "output", maximum=2.0)
        r = simulate([Mock("a", [port], lambda u, t: [3.0])], check_ranges=False)
        assert r["a.y"][-1] == 3.0
        with pytest.raises(RunError, match="NaN"):
            simulate([Mock("a", [port], lambda u, t: [math.nan])], check_ranges=False)

    def test_bounds_themselves_are_allowed(self):
        port = PortData("y", "output", minimum=2.0, maximum=2.0)
        assert simulate([Mock("a", [port], lambda u, t: [2.0])])["a.y"][0] == 2.0

    def test_slave_that_chokes_on_garbage_is_not_blamed_alone(self):
        def choke(u, t):
            if math.isnan(u[0]):
                raise ArithmeticError("garbage in")
            return [u[0]]

        a = source("a", lambda t: math.nan if t > 0.01 else 0.0)
        b = Mock("b", [PortData("u", "input", start=0.0), PortData("y", "output")], choke)
        with pytest.raises(RunError) as caught:
            simulate([a, b], "a.y -> b.u")
        assert "component 'b' failed in the step from t = 0.008 s" in str(caught.value)
        assert "ArithmeticError: garbage in" in str(caught.value)
        assert "Before that, in the same step, component 'a': output y is not a number (NaN)" in str(caught.value)


def failing(name="bad", at=0.01, error=None):
    def function(u, t):
        if t > at:
            raise error or ZeroDivisionError("by zero")
        return [t]

    return Mock(name, [PortData("y", "output")], function)


class TestFailures:
    """A slave raises."""

    def test_raising_slave_shows_component_time_and_traceback(self, tmp_path):
        with pytest.raises(RunError) as caught:
            simulate([failing()], folder=tmp_path / "run")
        text = str(caught.value)
        assert text.startswith("component 'bad' failed in the step from t = 0.008 s: \nTraceback")
        assert "mocks.py" in text
        assert "ZeroDivisionError: by zero" in text
        assert len(Run.load(tmp_path / "run").t) == 3

    def test_worded_error_is_shown_without_traceback(self):
        class ComponentError(Exception):
            pass

        with pytest.raises(RunError) as caught:
            simulate([failing(error=ComponentError("the cutter is 2 mm inside the table"))])
        assert str(caught.value) == "component 'bad' failed in the step from t = 0.008 s: the cutter is 2 mm inside the table"

    def test_failure_during_initialisation(self, tmp_path):
        with pytest.raises(RunError, match="component 'bad' failed during initialisation"):
            simulate([failing(at=-1.0)], folder=tmp_path / "run")
        assert len(Run.load(tmp_path / "run").t) == 0

    def test_slaves_are_closed_after_a_failure(self):
        slaves = [failing(), gain("a")]
        with pytest.raises(RunError):
            simulate(slaves)
        assert [s.closed for s in slaves] == [1, 1]


class TestInterruption:
    """Ctrl-C."""

    def test_keyboard_interrupt_from_inside(self, tmp_path):
        with pytest.raises(Interrupted, match=r"interrupted at t = 0.008 s; results up to there are in") as caught:
            simulate([failing(error=KeyboardInterrupt())], folder=tmp_path / "run")
        assert caught.value.time == 0.008
        kept = Run.load(tmp_path / "run")
        assert (kept.outcome, len(kept.t)) == ("interrupted", 3)

    def test_ctrl_c_ends_between_two_steps(self, tmp_path):
        def press(done, total):
            if done == 5:
                os.kill(os.getpid(), signal.SIGINT)

        before = signal.getsignal(signal.SIGINT)
        with pytest.raises(Interrupted) as caught:
            simulate(chain(), *CHAIN, stop=1.0, progress=press, folder=tmp_path / "run")
        assert caught.value.time == 0.02
        assert np.array_equal(Run.load(tmp_path / "run")["c.y"], [0.0, 0.004, 0.008, 0.012, 0.016, 0.02])
        assert signal.getsignal(signal.SIGINT) is before


class TestManipulation:
    """Inputs overridden from outside while it runs."""

    def test_override_and_release(self):
        def manipulate(master, t):
            if t == 0.008:
                master.override("a.u", 100.0)
            if t == 0.016:
                master.release("a.u")

        r = simulate([source("s", lambda t: t), gain("a")], "s.y -> a.u", stop=0.024, manipulators=[manipulate])
        assert list(r["a.y"]) == [0.0, 0.004, 0.008, 100.0, 100.0, 0.02, 0.024]

    def test_unknown_input(self):
        with pytest.raises(WiringError, match=r"unknown input 'a.v'; did you mean 'a.u'"):
            simulate([gain("a")], manipulators=[lambda master, t: master.override("a.v", 1.0)])


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
def test_repeated_runs_are_bitwise_equal(algorithm):
    a, b = oscillator(algorithm, 0.01), oscillator(algorithm, 0.01)
    for name in a.columns:
        assert np.max(np.abs(a[name] - b[name])) <= EXACT


def test_unknown_algorithm():
    with pytest.raises(SystemFileError, match="unknown algorithm 'newton'; available: jacobi, gauss-seidel"):
        simulate([gain("a")], algorithm="newton")
