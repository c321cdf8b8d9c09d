"""A recorded component stands in for the real one: identical numbers."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.orchestration.assembly import assemble, run
from robomill.orchestration.errors import ResultsError, RunError, SystemFileError
from robomill.orchestration.slaves.protocol import PortData, inputs
from tests.orchestration.mocks import Integrator, Mock, gain, resolver, source, system
from tests.tolerances import ROUNDOFF

CONNECTIONS = ("s.y -> drive.u[1]", "cut.f => drive.u[2]", "drive.p -> cut.p", "drive.state -> cut.block")


def slaves():
    """A loop with an array, an integer and a delay, none of it linear."""

    def drive(u, t):
        return [np.sin(u[0]) + 0.1 * u[1], np.cos(u[0] * u[1]), round(10 * u[0])]

    def cut(u, t):
        return [u[0] * u[1] + u[2] / 3]

    drive_ports = [
        *(PortData(f"u[{i}]", "input", unit="1", start=0.0) for i in (1, 2)),
        *(PortData(f"p[{i}]", "output", unit="m", minimum=-9.0, dependencies=("u[1]", "u[2]")) for i in (1, 2)),
        PortData("state", "output", type="integer", unit="1", dependencies=("u[1]",)),
        PortData("k", "parameter", start=1.0),
    ]
    cut_ports = [
        *(PortData(f"p[{i}]", "input", unit="m", start=0.0) for i in (1, 2)),
        PortData("block", "input", unit="1", start=0.0),
        PortData("f", "output", unit="1"),
    ]
    return [Mock("cut", cut_ports, cut), Mock("drive", drive_ports, drive), source("s", lambda t: np.exp(t) * 3)]


def record(folder, algorithm="gauss-seidel"):
    made = slaves()
    s = system(made, *CONNECTIONS, algorithm=algorithm).with_parameters("drive", {"k": 2.0})
    return s, run(s, folder, stop=0.4, resolver=resolver(made))


@pytest.mark.parametrize("loop", ["python", "compiled"])
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("component", ["drive", "cut", "s"])
def test_identical_numbers(tmp_path, algorithm, component, loop):
    s, original = record(tmp_path / "r", algorithm)
    again = run(s.with_source(component, f"replay:{tmp_path / 'r'}"), stop=0.4, resolver=resolver(slaves()), loop=loop)
    assert list(again.columns) == list(original.columns)
    for name, values in original.columns.items():
        assert np.array_equal(again[name], values), name  # EXACT


@pytest.mark.parametrize("loop", ["python", "compiled"])
def test_everything_replayed_at_once(tmp_path, loop):
    s, original = record(tmp_path / "r")
    for name in ("drive", "cut", "s"):
        s = s.with_source(name, f"replay:{tmp_path / 'r'}")
    again = run(s, stop=0.4, loop=loop)
    assert all(np.array_equal(again[c], v) for c, v in original.columns.items())


@pytest.mark.parametrize("component", ["drive", "cut", "s"])
def test_same_ports_and_order(tmp_path, component):
    s, _ = record(tmp_path / "r")
    with (
        assemble(s, resolver(slaves())) as original,
        assemble(s.with_source(component, f"replay:{tmp_path / 'r'}"), resolver(slaves())) as a,
    ):

        def facts(slave):
            return [(p.name, p.type, p.unit, p.minimum, p.dependencies) for p in slave.ports if p.causality == "output"]

        assert facts(a.slaves[component]) == facts(original.slaves[component])
        assert [p.name for p in inputs(a.slaves[component].ports)] == [p.name for p in inputs(original.slaves[component].ports)]
        assert a.wiring.order == original.wiring.order
        assert a.parameters[component] == {}


def test_another_component_of_the_run_by_name(tmp_path):
    _, original = record(tmp_path / "r")
    g = gain("g", 2.0)
    s = system([g], "x.y -> g.u")
    s = type(s)("t", 0.004, (*s.components, type(s.components[0])("x", f"replay:{tmp_path / 'r'}#s")), s.connections)
    assert np.array_equal(run(s, stop=0.4, resolver=resolver([g]))["g.y"], 2 * original["s.y"])


@pytest.mark.parametrize("loop", ["python", "compiled"])
def test_between_samples_reals_are_interpolated_and_integers_held(tmp_path, loop):
    s, original = record(tmp_path / "r")
    fine = type(s)("t", 0.001, tuple(type(c)(c.name, f"replay:{tmp_path / 'r'}") for c in s.components))
    r = run(fine, stop=0.4, loop=loop)
    assert np.array_equal(r["drive.p"][::4], original["drive.p"])
    assert np.allclose(r["s.y"], np.interp(r.t, original.t, original["s.y"]), rtol=ROUNDOFF, atol=0)
    assert np.array_equal(r["drive.state"][3::4], original["drive.state"][:-1])


def test_state_is_saved_and_restored(tmp_path):
    s, _ = record(tmp_path / "r")
    with assemble(s.with_source("s", f"replay:{tmp_path / 'r'}"), resolver(slaves())) as a:
        slave, out, again = a.slaves["s"], np.zeros(1), np.zeros(1)
        slave.initialise(0.0, 0.4, 0.004)
        state = slave.get_state()
        slave.step(0.0, 0.004)
        slave.get_outputs(out)
        slave.set_state(state)
        slave.step(0.0, 0.004)
        slave.get_outputs(again)
        assert out[0] == again[0]


class TestErrors:
    """What cannot be replayed."""

    @pytest.mark.parametrize("loop", ["python", "compiled"])
    def test_beyond_the_end(self, tmp_path, loop):
        s, _ = record(tmp_path / "r")
        with pytest.raises(RunError, match=r"the recording of 's' in .* ends at t = 0.4 s; t = 0.404 s is needed") as caught:
            run(s.with_source("s", f"replay:{tmp_path / 'r'}"), stop=1.0, resolver=resolver(slaves()), loop=loop)
        assert caught.value.time == 0.4

    def test_before_the_beginning(self, tmp_path):
        made = [Integrator("i", 1.0, 0.0)]
        run(system(made), tmp_path / "r", start=1.0, stop=2.0, resolver=resolver(made))
        with pytest.raises(RunError, match=r"begins at t = 1 s; t = 0 s is needed"):
            run(system(made).with_source("i", f"replay:{tmp_path / 'r'}"), stop=2.0)

    def test_no_samples(self, tmp_path):
        made = [Mock("m", [PortData("y", "output")], lambda u, t: [1 / 0])]
        with pytest.raises(RunError):
            run(system(made), tmp_path / "r", stop=1.0, resolver=resolver(made))
        with pytest.raises(SystemFileError, match=r"component 'm': run .* holds no samples \(outcome: failed\)"):
            run(system(made).with_source("m", f"replay:{tmp_path / 'r'}"), stop=1.0)

    def test_no_such_component(self, tmp_path):
        s, _ = record(tmp_path / "r")
        with pytest.raises(
            SystemFileError, match=r"component 'drive': run .*: unknown component 'drove'; did you mean 'drive'\? available: cut"
        ):
            run(s.with_source("drive", f"replay:{tmp_path / 'r'}#drove"), stop=0.1, resolver=resolver(slaves()))

    def test_no_such_run(self, tmp_path):
        s, _ = record(tmp_path / "r")
        with pytest.raises(SystemFileError, match="component 'drive': no run folder") as caught:
            run(s.with_source("drive", "replay:nowhere"), stop=0.1, resolver=resolver(slaves()))
        assert isinstance(caught.value.__cause__, ResultsError)
