"""Wiring: what is checked before a run, and the order of execution."""

from __future__ import annotations

import pytest

from robomill.models.model.units import convert
from robomill.orchestration.errors import WiringError
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.wiring import wire
from tests.orchestration.mocks import Mock, gain, source, system


def component(name, ins=(), outs=(), **dependencies):
    """Ports "x", "x[3]" (an array of 3), "x:mm" (with a unit)."""

    def ports(texts, causality):
        for text in texts:
            base, _, unit = text.partition(":")
            array, _, size = base.partition("[")
            names = [f"{array}[{i + 1}]" for i in range(int(size[:-1]))] if size else [array]
            for n in names:
                d = dependencies.get(array) if causality == "output" else None
                yield PortData(n, causality, unit=unit or "m", start=0.0, dependencies=d)

    return Mock(name, [*ports(ins, "input"), *ports(outs, "output")], lambda u, t: [])


def wired(slaves, *connections, **more):
    return wire(system(slaves, *connections, **more), {s.name: s.ports for s in slaves})


DRIVE = component("drive", ["q[2]", "f"], ["p[2]", "torque"], p=("q[1]", "q[2]"), torque=("f",))
CUT = component("cut", ["p[2]"], ["f"])
FLAG = Mock("flag", [PortData("on", "output", type="boolean"), PortData("n", "output", type="integer", unit="m")], lambda u, t: [])
ODD = Mock(
    "odd",
    [
        PortData("k", "parameter"),
        PortData("x", "input", unit="mm"),
        PortData("free", "input"),
        PortData("i", "input", type="integer"),
    ],
    lambda u, t: [],
)


def test_units_are_compared_by_what_they_mean() -> None:
    a, b, other = component("a", [], ["f:N*m"]), component("b", ["f:N.m"], []), component("a", [], ["f:kN.m"])
    both = {"a": a.ports, "b": b.ports}
    assert wire(system([a, b], "a.f -> b.f"), both, convert).order == ("a", "b")
    with pytest.raises(WiringError, match=r"unit mismatch: a\.f is in 'N\*m', b\.f expects 'N\.m'"):
        wire(system([a, b], "a.f -> b.f"), both)
    with pytest.raises(WiringError, match=r"unit mismatch: a\.f is in 'kN\.m', b\.f expects 'N\.m'"):
        wire(system([other, b], "a.f -> b.f"), {"a": other.ports, "b": b.ports}, convert)


@pytest.mark.parametrize(
    ("connection", "text"),
    [
        (
            "drove.p -> cut.p",
            "connection drove.p -> cut.p: unknown component 'drove'; did you mean 'drive'? available: drive, cut, flag, odd",
        ),
        ("drive.pp -> cut.p", "connection drive.pp -> cut.p: unknown output of 'drive': 'pp'; did you mean 'p'? available: p, torque"),
        ("drive.p -> cut.force", "connection drive.p -> cut.force: unknown input of 'cut': 'force'; available: p"),
        (
            "drive.p[3] -> cut.p[1]",
            "connection drive.p[3] -> cut.p[1]: there is no drive.p[3]: drive.p has 2 elements",
        ),
        ("drive.q -> cut.p", "connection drive.q -> cut.p: drive.q is an input; 'from' takes an output"),
        ("drive.p -> cut.f", "connection drive.p -> cut.f: cut.f is an output; 'to' takes an input (an output is never a destination)"),
        ("cut.f -> odd.k", "connection cut.f -> odd.k: odd.k is a parameter; set it under [components.odd.parameters]"),
        ("cut.f -> odd.x", "connection cut.f -> odd.x: unit mismatch: cut.f is in 'm', odd.x expects 'mm'"),
        ("cut.f -> odd.i", "connection cut.f -> odd.i: type mismatch: cut.f is real, odd.i is integer"),
        ("flag.on -> drive.f", "connection flag.on -> drive.f: type mismatch: flag.on is boolean, drive.f is real"),
        ("cut.f -> drive.q", "connection cut.f -> drive.q: cut.f has 1 element, drive.q has 2 elements"),
        ("drive.p -> drive.f", "connection drive.p -> drive.f: drive.p has 2 elements, drive.f has 1 element"),
    ],
)
def test_errors(connection, text):
    with pytest.raises(WiringError) as caught:
        wired([DRIVE, CUT, FLAG, ODD], connection)
    assert str(caught.value) == text


def test_two_sources():
    with pytest.raises(WiringError) as caught:
        wired([DRIVE, CUT], "drive.p => cut.p", "drive.torque -> cut.p[2]")
    assert str(caught.value) == "input cut.p[2] has two sources: drive.p -> cut.p and drive.torque -> cut.p[2]; remove one of them"


def test_all_problems_are_listed():
    with pytest.raises(WiringError) as caught:
        wired([DRIVE, CUT], "drive.x -> cut.p", "drive.p -> cut.x", "drive.p -> cut.p")
    assert len(caught.value.problems) == 2


def test_shapes_must_agree_not_only_sizes():
    a = Mock("a", [PortData(f"K[{i},{j}]", "output") for i in (1, 2) for j in (1, 2)], lambda u, t: [])
    b = Mock("b", [PortData(f"K[{i}]", "input") for i in (1, 2, 3, 4)], lambda u, t: [])
    with pytest.raises(WiringError, match=r"a.K has 4 elements \[2,2\], b.K has 4 elements$"):
        wired([a, b], "a.K -> b.K")


@pytest.mark.parametrize("connection", ["flag.n -> drive.f", "cut.f -> odd.free", "drive.p[2] -> drive.f", "cut.f -> drive.q[1]"])
def test_allowed(connection):
    """Integer to real, undeclared unit, element to scalar, scalar to element."""
    wired([DRIVE, CUT, FLAG, ODD], connection)


def test_open_inputs_are_reported():
    w = wired([DRIVE, CUT], "cut.f -> drive.q[1]")
    assert w.warnings[:2] == (
        "input drive.q[2] is not connected: it keeps its start value 0 m",
        "input drive.f is not connected: it keeps its start value 0 m",
    )
    with pytest.raises(WiringError, match=r"input cut.p is not .* 0 m; connect it, or set require_connected = false"):
        wired([DRIVE, CUT], "cut.f -> drive.q[1]", require_connected=True)


class TestLoops:
    """Algebraic loops: found element by element, named, broken by a delay."""

    def test_a_loop_is_refused_by_name_with_a_remedy(self):
        with pytest.raises(WiringError) as caught:
            wired([DRIVE, CUT], "drive.p -> cut.p", "cut.f -> drive.q[1]")
        assert str(caught.value) == (
            "algebraic loop: drive.q -> drive.p -> cut.p -> cut.f -> drive.q; Gauss-Seidel cannot resolve it: mark the connection "
            "cut.f -> drive.q[1] with delayed = true (or one of drive.p -> cut.p), or use algorithm = 'iterated' or 'jacobi'"
        )

    def test_a_delayed_connection_breaks_it(self):
        assert wired([DRIVE, CUT], "drive.p -> cut.p", "cut.f => drive.q[1]").order == ("drive", "cut")
        assert wired([DRIVE, CUT], "drive.p => cut.p", "cut.f -> drive.q[1]").order == ("cut", "drive")

    def test_jacobi_takes_it(self):
        wired([DRIVE, CUT], "drive.p -> cut.p", "cut.f -> drive.q[1]", algorithm="jacobi")

    def test_an_output_that_does_not_depend_on_the_force_closes_no_loop(self):
        w = wired([CUT, DRIVE], "drive.p -> cut.p", "cut.f -> drive.f")
        assert w.order == ("drive", "cut")
        assert w.warnings[-1] == (
            "connection cut.f -> drive.f goes backwards in the order of execution, though not in an algebraic loop: "
            "its input sees the last step (mark it delayed = true to say so)"
        )

    def test_unknown_dependencies_count_as_all(self):
        vague = component("drive", ["q[2]", "f"], ["p[2]", "torque"])
        with pytest.raises(
            WiringError, match=r"algebraic loop: cut.p -> cut.f -> drive.f -> drive.p -> cut.p;.* mark the connection cut.f -> drive.f with"
        ):
            wired([vague, CUT], "drive.p -> cut.p", "cut.f -> drive.f")

    def test_a_component_connected_to_itself(self):
        with pytest.raises(WiringError, match=r"algebraic loop: a.u -> a.y -> a.u"):
            wired([gain("a")], "a.y -> a.u")
        assert wired([gain("a")], "a.y => a.u").order == ("a",)

    def test_crossed_elements_are_no_loop(self):
        """x[1] feeds x[2] only, and that is all that the connection closes."""
        ports = [PortData("u[1]", "input"), PortData("u[2]", "input")]
        ports += [PortData("y[1]", "output", dependencies=("u[1]",)), PortData("y[2]", "output", dependencies=("u[2]",))]
        a = Mock("a", ports, lambda u, t: [])
        wired([a], "a.y[1] -> a.u[2]")


class TestOrder:
    """The order of execution."""

    def test_follows_the_connections(self):
        slaves = [gain("c"), gain("b"), gain("a"), source("s", lambda t: t)]
        assert wired(slaves, "s.y -> a.u", "a.y -> b.u", "b.y -> c.u").order == ("s", "a", "b", "c")

    def test_ties_keep_the_order_of_the_system(self):
        assert wired([gain("b"), gain("a"), gain("c")]).order == ("b", "a", "c")

    def test_fresh_values_go_first_to_where_they_feed_through(self):
        """The output of b needs a fresh input and is used, that of a is a state: the cycle is cut before a."""
        a = component("a", ["u"], ["y"], y=())
        b = component("b", ["u"], ["y"], y=("u",))
        assert wired([b, a], "a.y -> b.u", "b.y -> a.u").order == ("a", "b")
