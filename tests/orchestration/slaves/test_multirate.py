"""Components at another rate than the system: what steps when, from where to where, with which inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import RunError, SystemFileError
from robomill.orchestration.loop.acceleration import Iteration
from robomill.orchestration.slaves.multirate import MultiRate
from robomill.orchestration.slaves.protocol import PortData, Slave
from robomill.orchestration.system.definition import System
from tests.orchestration.mocks import Integrator, Mock, gain, resolver, source, system
from tests.tolerances import EXACT, ROUNDOFF, discretisation


def simulate(slaves, *connections, rates, stop=0.04, **more):
    s = system(slaves, *connections, **more)
    s = replace(s, components=tuple(replace(c, **rates.get(c.name, {})) for c in s.components))
    return run(s, stop=stop, resolver=resolver(slaves))


class State(Integrator):
    """An integrator whose state is complete."""

    def get_state(self):
        return super().get_state(), self.value, self.stepped

    def set_state(self, state):
        before, self.value, self.stepped = state
        super().set_state(before)


class TestRate:
    """k steps in one."""

    def test_steps_of_the_component(self):
        s = source("s", lambda t: t)
        simulate([s], rates={"s": {"rate": 4}}, stop=0.008)
        assert s.calls == [f"s({k / 1000:.9g})" for k in range(8)]

    def test_outputs_are_those_after_the_last_step_and_inputs_are_held(self):
        seen = []
        a = Mock("a", gain("x").ports, lambda u, t: seen.append((round(t * 1e3), u[0])) or [u[0] + t])
        r = simulate([source("s", lambda t: t), a], "s.y -> a.u", rates={"a": {"rate": 2}}, stop=0.008)
        assert list(r["a.y"]) == [0.0, 0.008, 0.016]
        assert [x for x in seen if x[0] > 0] == [(2, 0.004), (4, 0.004), (6, 0.008), (8, 0.008)]

    @pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
    def test_explicit_euler_converges_with_the_rate(self, algorithm):
        """An ODE inside one component: its error is that of the small step."""

        def error(rate):
            class Decay(Mock):
                value = 1.0

                def step(self, t, h):
                    self.value += -2.0 * h * self.value
                    super().step(t, h)

            d = Decay("d", [PortData("y", "output")], lambda u, t: [d.value])
            r = simulate([d], rates={"d": {"rate": rate}}, step=0.04, stop=0.4, algorithm=algorithm)
            assert np.max(np.abs(r["d.y"] - (1.0 - 2.0 * 0.04 / rate) ** (rate * np.arange(11.0)))) <= 10 * ROUNDOFF
            return np.max(np.abs(r["d.y"] - np.exp(-2.0 * r.t)))

        # explicit Euler of y' = -2 y: leading error h t exp(-2 t) * 2, at most h / e
        assert error(8) <= discretisation(1.0 / np.e, 0.04 / 8, 1) * 1.05
        # the next order is about a part h of it
        assert error(2) / error(8) == pytest.approx(4.0, rel=discretisation(1.0, 0.04 / 2, 1))

    def test_rate_one_is_the_slave_itself(self):
        slaves = [source("s", lambda t: t)]
        plain = simulate(slaves, rates={})
        again = simulate([source("s", lambda t: t)], rates={"s": {"rate": 1, "every": 1}})
        assert np.array_equal(plain["s.y"], again["s.y"])
        assert "rates" not in again.info or not again.info["rates"]


class TestEvery:
    """One step in k."""

    def test_steps_over_the_time_since_the_last_one(self):
        steps = []

        class Steps(Mock):
            def step(self, t, h):
                steps.append((round(t * 1e9), round(h * 1e9)))
                self.stepped, self.y[:] = True, self.function(self.u, t + h)

        a = Steps("a", [PortData("y", "output")], lambda u, t: [t])
        r = simulate([a], rates={"a": {"every": 3}}, stop=0.028)
        assert steps == [(0, 12_000_000), (12_000_000, 12_000_000)]
        assert list(np.round(r["a.y"] * 1e3)) == [0, 0, 0, 12, 12, 12, 24, 24]

    def test_samples_its_inputs_when_it_steps_and_holds_its_outputs(self):
        for algorithm, late in (("gauss-seidel", 0), ("jacobi", 1)):
            slaves = [source("s", lambda t: t * 1e3), gain("a"), gain("b")]
            slaves[1] = State("a", 0.0, 0.0)
            slaves[1].function = lambda u, t: [u[0]]
            slaves[1].step = lambda t, h, a=slaves[1]: (setattr(a, "stepped", True), a.y.__setitem__(0, a.u[0]))
            r = simulate(slaves, "s.y -> a.u", "a.y -> b.u", rates={"a": {"every": 2}}, algorithm=algorithm)
            k = np.arange(11)
            held = np.where(k >= 2, 4.0 * ((k // 2) * 2 - late), 0.0)
            assert np.array_equal(np.round(r["a.y"]), held), algorithm

    def test_same_integral_as_with_its_own_step_when_the_input_is_constant(self):
        a = simulate([source("s", lambda t: 2.0), State("i", 1.0, 0.0)], "s.y -> i.u", rates={"i": {"every": 5}}, stop=0.04)
        expected = 2.0 * 0.02 * (np.arange(11) // 5)
        assert np.max(np.abs(a["i.y"] - expected)) <= ROUNDOFF

    def test_run_that_ends_between_two_steps(self):
        r = simulate([source("s", lambda t: t)], rates={"s": {"every": 100}})
        assert np.max(np.abs(r["s.y"])) <= EXACT


class TestState:
    """Saving and iterating."""

    def test_is_a_slave(self):
        assert isinstance(MultiRate(gain("a"), 2), Slave)

    @pytest.mark.parametrize("rates", [{"rate": 3}, {"every": 3}])
    def test_going_back_repeats(self, rates):
        m = MultiRate(State("i", 1.0, 0.0), **rates)
        m.initialise(0.0, 1.0, 0.003)
        out = np.zeros(1)

        def steps(first, last):
            found = []
            for k in range(first, last):
                m.set_inputs(np.array([1.0 + k]))
                m.step(k * 3 / 1000, 0.003)
                m.get_outputs(out)
                found.append(out[0])
            return found

        steps(0, 4)
        saved = m.get_state()
        a = steps(4, 12)
        m.set_state(saved)
        assert steps(4, 12) == a
        assert len(set(a)) == (8 if "rate" in rates else 4)  # held until step 5; steps 5, 8, 11

    def test_in_an_iterated_loop(self):
        """Implicit Euler of one, with the other explicit in two halves: (I - h J) with its own closed form."""
        h, w = 0.1, 2.0
        slaves = [State("x", w, 1.0), State("v", -w, 0.0)]
        settings = Iteration(tolerance=1e-14)
        r = simulate(
            slaves, "x.y -> v.u", "v.y -> x.u", rates={"v": {"rate": 2}}, step=h, stop=1.0, algorithm="iterated", iteration=settings
        )
        z = (1.0 / (1.0 + 1j * w * h)) ** np.arange(11)  # held inputs: two halves of an integrator are one whole
        assert np.max(np.abs(r["x.y"] + 1j * r["v.y"] - z)) <= 100 * ROUNDOFF

    def test_proof_is_made_in_a_step_in_which_the_component_steps(self):
        slaves = [gain("x"), Integrator("v", -2.0, 1.0)]  # the state of v is incomplete
        with pytest.raises(RunError, match=r"in the step from t = 0.008 s: component 'v' .* cannot go back exactly"):
            simulate(slaves, "x.y -> v.u", "v.y -> x.u", rates={"v": {"every": 3}}, algorithm="iterated")


SYSTEM = """
name = "x"
step = "0.004 s"
[components.a]
source = "mock"
rate = 4
[components.b]
source = "mock"
every = 5
"""


class TestSystemFile:
    """The keys rate and every."""

    def load(self, tmp_path, text):
        (tmp_path / "system.toml").write_text(text)
        return System.load(tmp_path / "system.toml")

    def test_keys(self, tmp_path):
        a, b = self.load(tmp_path, SYSTEM).components
        assert (a.rate, a.every, b.rate, b.every) == (4, 1, 1, 5)

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("rate = 4", "rate = 0", "system.toml:6: [components] a.rate: expected a whole number, at least 1; found 0"),
            ("rate = 4", "rate = 2\nevery = 2", "only one of them is more; found 2 and 2"),
            ("rate = 4", "rate = 3", "component 'a': rate = 3 divides the step of 0.004 s into no whole nanoseconds"),
            ("rate = 4", "rate = 2.0", "system.toml:6: [components] a.rate: expected a whole number, at least 1; found 2.0"),
        ],
    )
    def test_strict(self, tmp_path, old, new, words):
        with pytest.raises(SystemFileError) as caught:
            self.load(tmp_path, SYSTEM.replace(old, new))
        assert words in str(caught.value)
