"""Iterated coupling: loops solved at the end of each step, checked against closed forms; rollback proved or refused."""

from __future__ import annotations

import math
import zipfile

import fmpy
import numpy as np
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import RunError, SystemFileError, WiringError
from robomill.orchestration.loop.acceleration import DEFAULT, METHODS, Iteration, Work, compare, improve
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.definition import Component, Connection, System
from robomill.orchestration.system.wiring import wire
from tests.orchestration import c_fmu
from tests.orchestration.mocks import Integrator, Mock, gain, resolver, source, system
from tests.tolerances import EXACT, ROUNDOFF, discretisation


def simulate(slaves, *connections, stop=0.04, **more):
    settings = {k: more.pop(k) for k in tuple(more) if k in Iteration.__dataclass_fields__}
    s = system(slaves, *connections, algorithm="iterated", iteration=Iteration(**settings), **more)
    return run(s, stop=stop, resolver=resolver(slaves))


def amplifier(name, matrix, driven=True):
    """An amplifier y = A u + w with an array of each: direct feedthrough."""
    A = np.atleast_2d(matrix)
    n = len(A)
    ports = [PortData(f"u[{i + 1}]", "input", start=0.0) for i in range(n)]
    ports += [PortData("w", "input", start=0.0)] if driven else []
    ports += [PortData(f"y[{i + 1}]", "output") for i in range(n)]
    return Mock(name, ports, lambda u, t: A @ u[:n] + (u[n] if driven else 0.0))


def loop(factor, load=lambda t: 1.0 + t, **settings):
    """The loop y = factor y + load: one signal, through two components. The solution is load / (1 - factor)."""
    slaves = [amplifier("a", [[factor]]), gain("b"), source("s", load)]
    return simulate(slaves, "a.y[1] -> b.u", "b.y -> a.u[1]", "s.y -> a.w", **settings)


class State(Integrator):
    """An integrator whose state is complete."""

    def get_state(self):
        return super().get_state(), self.value

    def set_state(self, state):
        before, self.value = state
        super().set_state(before)


def oscillator(h, stop=1.0, w=2.0, kinds=State, **settings):
    """The ring x' = w v, v' = -w x: x + i v turns by exp(-i w t)."""
    return simulate([kinds("x", w, 1.0), kinds("v", -w, 0.0)], "x.y -> v.u", "v.y -> x.u", step=h, stop=stop, **settings)


class TestAlgebraicLoop:
    """One signal, closed form."""

    @pytest.mark.parametrize("method", ["aitken", "anderson"])
    @pytest.mark.parametrize("factor", [0.5, -0.5, 0.99, -1.0, -1.5, 2.0, 5.0, -40.0])
    def test_converges_for_any_gain(self, factor, method):
        r = loop(factor, method=method, tolerance=1e-13)
        expected = (1.0 + r.t) / (1.0 - factor)
        assert np.max(np.abs(r["a.y[1]"] / expected - 1.0)) <= 100 * ROUNDOFF  # condition: 1 / (1 - 0.99)
        # a linear loop of one signal is solved by one secant; the third round confirms, a fourth may polish round-off
        assert r["master.iterations"].max() <= 5

    @pytest.mark.parametrize("factor", [0.5, -0.5, 0.8])
    def test_fixed_point_converges_linearly_below_one(self, factor):
        r = loop(factor, load=lambda t: 1.0, method="fixed-point", tolerance=1e-9, max_iterations=200)
        assert np.max(np.abs(r["a.y[1]"] * (1.0 - factor) - 1.0)) <= 1e-8
        # from zero, the residual after k rounds is factor^(k-1), relative to a solution of about one
        rounds = 1 + math.log(1e-9 / (1.0 - factor)) / math.log(abs(factor))
        assert abs(r["master.iterations"][0] - rounds) <= 2
        assert r["master.iterations"][1:].max() == 1  # nothing changes: the old solution is right at once

    @pytest.mark.parametrize("factor", [-1.0, 1.5, -3.0])
    def test_fixed_point_diverges_above_one(self, factor):
        with pytest.raises(RunError, match=r"the loop b -> a -> b did not converge in 50 iterations|the loop a -> b -> a did not converge"):
            loop(factor, method="fixed-point")

    def test_relaxation_makes_a_negative_gain_converge(self):
        # error factor of a round: 1 - w (1 - g) = 1 - 0.25 * 4 = 0
        r = loop(-3.0, method="fixed-point", relaxation=0.25, tolerance=1e-14)
        assert np.max(np.abs(r["a.y[1]"] - (1.0 + r.t) / 4.0)) <= ROUNDOFF
        assert r["master.iterations"].max() <= 3

    def test_outputs_at_the_start_satisfy_the_loop(self):
        assert loop(0.5, stop=0.0)["a.y[1]"][0] == pytest.approx(2.0, rel=DEFAULT.tolerance)

    def test_integer_signals_go_round_too(self):
        ports = [PortData("u", "input", "integer", start=0), PortData("y", "output", "integer")]
        slaves = [Mock("a", ports, lambda u, t: [(u[0] + 6) // 2]), Mock("b", ports, lambda u, t: [u[0]])]
        r = simulate(slaves, "a.y -> b.u", "b.y -> a.u", method="fixed-point")
        assert set(r["a.y"]) <= {5.0, 6.0}  # both satisfy y = (y + 6) // 2


class TestSeveralSignals:
    """Vectors, units of very different size, several loops."""

    MATRIX = np.array([[0.0, -3e6, 0.0], [2e-6, 0.0, 1.0], [0.5, 1e3, -2.0]])  # a stiff one: N and m beside each other

    def test_anderson_solves_n_signals_in_n_plus_few_rounds(self):
        slaves = [amplifier("a", self.MATRIX), amplifier("b", np.eye(3), driven=False), source("s", lambda t: 1.0)]
        connections = ("a.y -> b.u", "b.y -> a.u", "s.y -> a.w")
        r = simulate(slaves, *connections, method="anderson", tolerance=1e-11, stop=0.004)
        expected = np.linalg.solve(np.eye(3) - self.MATRIX, np.ones(3))
        assert np.max(np.abs(r["a.y"][-1] / expected - 1.0)) <= 1e-8
        assert r["master.iterations"].max() <= 3 + 6

    def test_units_do_not_matter(self):
        """A loop with one signal counted in millionths takes as many rounds to the same solution."""

        def rounds(scale):
            D = np.diag([1.0, scale])
            A = D @ np.array([[0.3, -2.0], [1.0, 0.5]]) @ np.linalg.inv(D)
            parts = [Mock("a", [], lambda u, t: [])]
            ports = [PortData(n, "input", start=0.0) for n in ("u", "v")] + [PortData(n, "output") for n in ("x", "y")]
            parts = [Mock("a", ports, lambda u, t: A @ u + D @ [1.0, 1.0]), Mock("b", ports, lambda u, t: u)]
            r = simulate(parts, "a.x -> b.u", "a.y -> b.v", "b.x -> a.u", "b.y -> a.v", method="anderson", stop=0.0)
            return r["master.iterations"][0], r["a.y"][0] / scale

        (n, y), (n_scaled, y_scaled) = rounds(1.0), rounds(2.0**-20)
        assert n == n_scaled
        assert abs(y - y_scaled) <= 10 * ROUNDOFF * abs(y)

    def test_two_loops_and_what_is_between(self):
        slaves = [gain("d"), gain("c", -0.5, 3.0), gain("m", 10.0), gain("b"), gain("a", 0.5, 1.0)]
        ports = [*(PortData(n, "input", start=0.0) for n in "uv"), PortData("y", "output")]
        slaves[1] = Mock("c", ports, lambda u, t: [-0.5 * u[0] + u[1]])
        connections = ("a.y -> b.u", "b.y -> a.u", "b.y -> m.u", "m.y -> c.v", "c.y -> d.u", "d.y -> c.u")
        r = simulate(slaves, *connections, tolerance=1e-12)
        for name, value in (("a", 2.0), ("b", 2.0), ("m", 20.0), ("c", 40.0 / 3), ("d", 40.0 / 3)):
            assert np.max(np.abs(r[f"{name}.y"] - value)) <= 100 * ROUNDOFF, name
        w = wire(system(slaves, *connections, algorithm="iterated"), {s.name: s.ports for s in slaves})
        assert [set(x.members) for x in w.loops] == [{"a", "b"}, {"c", "d"}]
        assert w.order.index("m") == 2

    def test_component_outside_of_loops_steps_once(self):
        slaves = [amplifier("a", [[0.5]]), gain("b"), source("s", lambda t: t), gain("after")]
        simulate(slaves, "a.y[1] -> b.u", "b.y -> a.u[1]", "s.y -> a.w", "b.y -> after.u", stop=0.02)
        assert len(slaves[2].calls) == len(slaves[3].calls) == 5
        assert len(slaves[0].calls) > 10

    def test_loop_of_one_component(self):
        r = simulate([gain("a", -3.0, 2.0)], "a.y -> a.u", tolerance=1e-13)
        assert np.max(np.abs(r["a.y"] - 0.5)) <= ROUNDOFF

    def test_delayed_connection_in_and_beside_a_loop(self):
        slaves = [amplifier("a", [[0.5]]), gain("b"), gain("late")]
        r = simulate(slaves, "a.y[1] -> b.u", "b.y -> a.u[1]", "b.y -> late.u", "late.y => a.w", tolerance=1e-13, stop=0.02)
        # y_k = 0.5 y_k + y_(k-1), from zero: stays zero; with a start it doubles
        assert np.max(np.abs(r["a.y[1]"])) <= EXACT
        slaves = [amplifier("a", [[0.5]]), gain("b"), gain("late", 1.0, 1.0)]
        r = simulate(slaves, "a.y[1] -> b.u", "b.y -> a.u[1]", "b.y -> late.u", "late.y => a.w", tolerance=1e-13, stop=0.02)
        expected = [0.0]
        for _ in range(5):
            expected.append(2.0 * (expected[-1] + 1.0))
        assert np.max(np.abs(r["a.y[1]"] - expected)) <= ROUNDOFF * 100

    def test_without_a_loop_it_is_gauss_seidel(self):
        def slaves():
            return [gain("c"), gain("a", 2.0), source("s", math.exp)]

        a = simulate(slaves(), "s.y -> a.u", "a.y => c.u")
        s = system(slaves(), "s.y -> a.u", "a.y => c.u")
        b = run(s, stop=0.04, resolver=resolver(slaves()))
        assert all(np.array_equal(a[n], b[n]) for n in b.columns)
        assert not a["master.iterations"].any()


class TestOscillator:
    """Two integrators in a ring, the solution is exp(-i w t)."""

    @pytest.mark.parametrize("method", ["aitken", "anderson", "fixed-point"])
    def test_numbers_of_the_implicit_euler_rule(self, method):
        h, w = 0.05, 2.0
        r = oscillator(h, method=method, tolerance=1e-14)
        z = (1.0 / (1.0 + 1j * w * h)) ** np.arange(len(r.t))
        assert np.max(np.abs(r["x.y"] + 1j * r["v.y"] - z)) <= 100 * ROUNDOFF

    @pytest.mark.parametrize("method", ["aitken", "anderson", "fixed-point"])
    def test_numbers_of_the_trapezoidal_rule(self, method):
        h, w = 0.05, 2.0
        r = oscillator(h, method=method, tolerance=1e-14, hold="mean")
        z = ((1.0 - 0.5j * w * h) / (1.0 + 0.5j * w * h)) ** np.arange(len(r.t))
        assert np.max(np.abs(r["x.y"] + 1j * r["v.y"] - z)) <= 100 * ROUNDOFF

    @pytest.mark.parametrize(("hold", "order"), [("end", 1), ("mean", 2)])
    def test_order_of_convergence(self, hold, order):
        def error(h):
            r = oscillator(h, hold=hold, tolerance=1e-12)
            return float(np.max(np.abs(r["x.y"] + 1j * r["v.y"] - np.exp(-2j * r.t))))

        steps = [0.02, 0.01, 0.005]
        errors = [error(h) for h in steps]
        rates = np.log2(np.array(errors[:-1]) / errors[1:])
        assert np.all(np.abs(rates - order) <= 0.05)
        # leading error per unit time: w^2 h / 2, and w^3 h^2 / 12; w = 2, t = 1
        assert errors[-1] <= discretisation({1: 2.0, 2: 8.0 / 12.0}[order], steps[-1], order) * 1.02

    def test_mean_keeps_the_energy(self):
        r = oscillator(0.05, stop=50.0, hold="mean", tolerance=1e-14)
        assert np.max(np.abs(r["x.y"] ** 2 + r["v.y"] ** 2 - 1.0)) <= 1000 * 2 * ROUNDOFF


class TestRollback:
    """Proved before it is used, refused otherwise."""

    def test_incomplete_state_is_refused_by_name(self):
        with pytest.raises(RunError) as caught:
            oscillator(0.01, kinds=Integrator)  # its state leaves out the integral
        text = str(caught.value)
        # x, whose input is zero at first, has nothing to show yet
        assert text.startswith("in the step from t = 0 s: component 'v' is in the loop x -> v -> x and cannot go back exactly")
        assert "gave other outputs (largest difference" in text
        assert "Mark a connection of the loop with delayed = true, or use algorithm = 'gauss-seidel'" in text
        assert caught.value.time == 0.0

    def test_hidden_state_that_outputs_do_not_show_yet_is_refused(self):
        class Counter(Mock):
            n = 0

            def step(self, t, h):
                self.n += 1
                super().step(t, h)

            def get_state(self):
                return super().get_state(), {"n": self.n}

            def set_state(self, state):
                super().set_state(state[0])

        a = Counter("a", gain("x").ports, lambda u, t: [0.5 * u[0]])
        with pytest.raises(RunError, match=r"component 'a' is in the loop .* gave the same outputs, but another state"):
            simulate([a, gain("b")], "a.y -> b.u", "b.y -> a.u")

    def test_component_that_cannot_save_is_refused_with_its_own_words(self):
        class Vendor(Mock):
            def get_state(self):
                raise SystemFileError("vendor.fmu cannot save its state (canGetAndSetFMUstate is false)")

        with pytest.raises(RunError, match=r"component 'a' is in the loop .* cannot save its state, .*: vendor.fmu cannot save"):
            simulate([Vendor("a", gain("x").ports, lambda u, t: u), gain("b")], "a.y -> b.u", "b.y -> a.u")

    def test_what_only_fails_at_work_is_found_at_the_first_return(self):
        """Nothing moves before t = 0.02 s, so that a proof in the first step alone finds nothing."""

        class Wear(Mock):
            worn = 0.0

            def step(self, t, h):
                self.worn += abs(self.u[0])
                super().step(t, h)

        a = Wear("a", [PortData("u", "input", start=0.0), PortData("y", "output")], lambda u, t: [0.5 * u[0] + a.worn])
        b = Mock("b", gain("x").ports, lambda u, t: [u[0] + (1.0 if t > 0.0201 else 0.0)])
        with pytest.raises(RunError, match=r"in the step from t = 0.02 s: component 'a' .* its step from t = 0.02 s, made again"):
            simulate([a, b], "a.y -> b.u", "b.y -> a.u")

    def test_going_back_leaves_no_trace(self):
        """The accepted states are those of the accepted outputs: the run continues as an explicit computation does."""
        h, w = 0.1, 2.0
        r = oscillator(h, stop=0.5, tolerance=1e-15, max_iterations=100, unconverged="accept")
        assert np.max(np.abs(r["x.y"][1:] - r["x.y"][:-1] - h * w * r["v.y"][1:])) <= 10 * ROUNDOFF
        assert np.max(np.abs(r["v.y"][1:] - r["v.y"][:-1] + h * w * r["x.y"][1:])) <= 10 * ROUNDOFF


@pytest.mark.skipif(c_fmu.compiler() is None, reason="no C compiler on this machine")
class TestFmus:
    """An FMU that somebody else made, in a loop."""

    def back(self, value):
        return Mock("b", [PortData("u", "input", start=0.0), PortData("y", "output")], lambda u, t: [-u[0] - value])

    def test_integrator_in_a_loop_is_the_implicit_euler_rule(self, tmp_path):
        file = c_fmu.build(tmp_path)
        h, rate = 0.1, 3.0
        components = (Component("euler", str(file), {"gain": rate}), Component("b", "mock"))
        connections = (Connection("euler.y", "b.u"), Connection("b.y", "euler.u"))
        settings = Iteration(tolerance=1e-14)
        s = System("x", h, components, connections, "iterated", iteration=settings, stop=1.0)
        r = run(s, resolver=lambda source, name: self.back(1.0))
        # y' = -rate (y + 1), y = 0 at first: (y_k + 1) (1 + rate h) = y_(k-1) + 1
        assert np.max(np.abs(r["euler.y"] + 1.0 - (1.0 + rate * h) ** -np.arange(11.0))) <= 10 * ROUNDOFF
        assert r["euler.n"][-1] == 10  # steps that count, not calls
        assert r["master.iterations"].max() > 2

    def test_fmu_without_saved_states_is_refused(self, tmp_path):
        file = c_fmu.build(tmp_path)
        description = c_fmu.DESCRIPTION.replace('canGetAndSetFMUstate="true"', 'canGetAndSetFMUstate="false"')
        library = f"binaries/{fmpy.platform}/euler{c_fmu.SUFFIX}"
        with zipfile.ZipFile(file) as z:
            data = z.read(library)
        other = c_fmu.pack(tmp_path / "other.fmu", description, {library: data})
        components = (Component("euler", str(other)), Component("b", "mock"))
        s = System("x", 0.1, components, (Connection("euler.y", "b.u"), Connection("b.y", "euler.u")), "iterated", stop=1.0)
        with pytest.raises(RunError, match=r"component 'euler' is in the loop .*: other.fmu cannot save its state"):
            run(s, resolver=lambda source, name: self.back(0.0))


class TestRecordAndErrors:
    """Columns of the iteration, texts."""

    def test_rounds_and_residual_are_recorded(self):
        r = loop(0.5, method="fixed-point", tolerance=1e-6)
        assert r.ports["master.iterations"].type == "integer"
        assert np.all(r["master.residual"] <= 1e-6)
        assert np.all(r["master.iterations"] >= 2)

    def test_residual_is_that_of_the_accepted_round(self):
        r = loop(0.5, load=lambda t: 1.0, method="fixed-point", max_iterations=4, unconverged="accept", stop=0.0)
        # guesses 0, 1, 1.5, 1.75; the last round gives 1.875
        assert (r["a.y[1]"][0], r["master.residual"][0], r["master.iterations"][0]) == (1.875, 0.125 / 1.875, 4)

    def test_unconverged_says_what_and_what_to_do(self):
        with pytest.raises(RunError) as caught:
            loop(2.0, method="fixed-point", max_iterations=5)
        text = str(caught.value)
        assert "did not converge in 5 iterations" in text
        assert "still changes by 0.5" in text  # 2^5 / (2^6 - 1), about
        assert "Try method = 'aitken' or 'anderson', or a smaller relaxation" in text

    def test_nan_in_the_loop_is_named_by_the_guard(self):
        bad = Mock("bad", gain("x").ports, lambda u, t: [math.nan if t > 0.01 else 0.5 * u[0] + 1.0])
        with pytest.raises(RunError, match=r"component 'bad' at t = 0.012 s: output y is not a number"):
            simulate([gain("b"), bad], "bad.y -> b.u", "b.y -> bad.u")

    def test_component_called_master(self):
        with pytest.raises(WiringError, match="component name 'master' belongs to the columns of iterated coupling"):
            simulate([gain("master")])

    def test_order_of_the_file_changes_the_solution_only_within_the_tolerance(self):
        def slaves():
            return [amplifier("a", [[0.5]]), gain("b"), source("s", lambda t: 1 + t)]

        connections = ("a.y[1] -> b.u", "b.y -> a.u[1]", "s.y -> a.w")
        a, b = (simulate(s, *connections, tolerance=1e-12) for s in (slaves(), slaves()[::-1]))
        assert np.max(np.abs(a["b.y"] - b["b.y"])) <= 1e-11

    def test_runs_repeat_bitwise(self):
        a, b = oscillator(0.01), oscillator(0.01)
        assert all(np.array_equal(a[n], b[n]) for n in a.columns)


SYSTEM = """
name = "x"
step = "0.004 s"
algorithm = "iterated"
[iteration]
method = "anderson"
tolerance = 1e-7
max_iterations = 12
relaxation = 0.5
depth = 3
hold = "mean"
unconverged = "accept"
[components.a]
source = "mock"
"""


class TestSystemFile:
    """The table [iteration]."""

    def load(self, tmp_path, text):
        (tmp_path / "system.toml").write_text(text)
        return System.load(tmp_path / "system.toml")

    def test_all_keys(self, tmp_path):
        assert self.load(tmp_path, SYSTEM).iteration == Iteration("anderson", 1e-7, 12, 0.5, 3, "mean", "accept")

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ('"anderson"', '"andersen"', "unknown method 'andersen'; did you mean 'anderson'"),
            ('"mean"', '"start"', "unknown hold 'start'; available: end, mean"),
            ('"accept"', '"ignore"', "unknown unconverged 'ignore'"),
            ("1e-7", "-1.0", "tolerance is a relative change; expected 0 to below 1, found -1.0"),
            ("1e-7", '"1e-7"', "[iteration] tolerance: expected a finite number; found '1e-7'"),
            ("= 0.5", "= 1.5", "relaxation: expected above 0 and at most 1, found 1.5"),
            ("= 12", "= 0", "max_iterations and depth: expected 1 or more"),
            ("depth", "dept", "[iteration] dept: unknown key 'dept'; did you mean 'depth'"),
        ],
    )
    def test_strict(self, tmp_path, old, new, words):
        with pytest.raises(SystemFileError) as caught:
            self.load(tmp_path, SYSTEM.replace(old, new, 1))
        assert words in str(caught.value)
        assert str(caught.value).startswith("system.toml")


class Search:
    """The next guess alone, unscaled."""

    def __init__(self, method, relaxation=1.0, depth=10, n=2):
        self.settings = Iteration(method, relaxation=relaxation, depth=depth)
        self.work, self.rounds = Work(self.settings, n), 0

    def next(self, x, r):
        self.rounds += 1
        found, x = np.array(x), np.array(x)
        improve(
            self.work.method, self.settings.relaxation, self.rounds, len(x), found, x + r, np.ones(len(x)),
            self.work.history, self.work.factor,
        )  # fmt: skip
        return found


class TestNextGuess:
    """The next guess alone."""

    @pytest.mark.parametrize("method", METHODS)
    def test_first_correction_is_relaxed(self, method):
        assert list(Search(method, 0.5).next([1.0, 2.0], [4.0, -2.0])) == [3.0, 1.0]

    def test_aitken_is_the_secant_method_for_one_signal(self):
        search, x = Search("aitken", n=1), np.array([0.0])
        for _ in range(2):
            x = search.next(x, 3.0 * x - x + 4.0)  # x = 3 x + 4
        assert x[0] == -2.0

    def test_anderson_forgets_what_is_older_than_its_depth(self):
        """Another first round, three before the last, changes nothing at depth 2 and something at depth 3."""

        def last(first, depth):
            search = Search("anderson", depth=depth, n=4)
            rounds = [first, [0.0, 3.0, 1.0, 1.0], [1.0, 0.0, 2.0, 5.0], [2.0, 2.0, 0.0, 1.0]]
            return [list(search.next(x, np.sin(x) + 1.0)) for x in rounds][-1]

        assert last([1.0, 2.0, 3.0, 4.0], 2) == last([7.0, 1.0, 0.0, 2.0], 2)
        assert last([1.0, 2.0, 3.0, 4.0], 3) != last([7.0, 1.0, 0.0, 2.0], 3)

    def test_anderson_solves_a_linear_system_in_n_plus_two_rounds(self):
        matrix = np.array([[0.0, -3.0, 0.5], [2.0, 0.0, 1.0], [0.5, 1.0, -2.0]])
        search, x = Search("anderson", n=3), np.zeros(3)
        for _ in range(4):
            x = search.next(x, matrix @ x + 1.0 - x)
        assert np.max(np.abs(matrix @ x + 1.0 - x)) <= 100 * ROUNDOFF

    @pytest.mark.parametrize("method", ["aitken", "anderson"])
    def test_equal_residuals_do_no_harm(self, method):
        search = Search(method, n=1)
        search.next([0.0], [1.0])
        assert np.isfinite(search.next([1.0], [1.0])).all()

    def test_change_is_measured_by_the_largest_element_of_the_array(self):
        x, g = np.array([1.0, -8.0, 0.0]), np.array([2.0, -4.0, 0.25])
        sizes = np.zeros(3)
        assert compare(3, x, g, [0, 0, 1], np.zeros(2), sizes) == (1.0, 2)
        assert list(sizes) == [8.0, 8.0, 0.25]
        assert compare(2, x, g, [0, 0, 1], np.zeros(2), sizes) == (0.5, 1)
        assert compare(3, x, np.array([0.0, np.nan, 0.0]), [0, 0, 1], np.zeros(2), sizes) == (math.inf, -1)
