"""FMI 3.0 FMUs as slaves: one in C with every type, not made by robomill; and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest

from robomill.conformance import check_fmu
from robomill.orchestration.assembly import run
from robomill.orchestration.errors import OrchestrationError, RunError, SlaveError, SystemFileError
from robomill.orchestration.loop.acceleration import DEFAULT
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.fmu import FmuSlave
from robomill.orchestration.slaves.protocol import PortData, Slave, arrays, inputs, outputs
from robomill.orchestration.system.definition import Component, Connection, System
from tests.orchestration import c_fmu, c_fmu3
from tests.orchestration.mocks import resolver, source

pytestmark = [pytest.mark.skipif(c_fmu.compiler() is None, reason="no C compiler here"), pytest.mark.usefixtures("temporary")]


@pytest.fixture(scope="module")
def types(tmp_path_factory) -> Path:
    return c_fmu3.build(tmp_path_factory.mktemp("c"))


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Path:
    """Without the types that the compiled loop does not carry."""
    return c_fmu3.build(tmp_path_factory.mktemp("c"), c_fmu3.PLAIN)


def driven(file: Path, value: float, **parameters) -> tuple[System, object]:
    """The FMU with a source at u[1,1], and the resolver of the source."""
    s = source("s", lambda t: value if t > 0.01 else 0.0, unit="N")
    components = (Component("s", "mock"), Component("x", str(file), parameters))
    return System("t", 0.004, components, (Connection("s.y", "x.u[1,1]"),)), resolver([s])


def test_ports(types):
    slave = FmuSlave(types, "x")
    try:
        assert isinstance(slave, Slave)
        ports = {p.name: p for p in slave.ports}
        assert ports["u[2,3]"] == PortData("u[2,3]", "input", "real", "N", 0.5, None, 2e6, "what is integrated")
        assert [p.start for p in slave.ports if p.name.startswith("in_Boolean")] == [True, False, True]
        assert ports["in_Int32[2]"].start == 2
        assert ports["out_Int64"] == PortData("out_Int64", "output", "integer", items=(("a", 1), ("b", 2)))
        assert ports["blob"] == PortData("blob", "input", "binary")
        assert ports["rows"] == PortData("rows", "structural parameter", "integer", start=2)
        assert ports["y[1,1]"].dependencies == ()
        assert ports["out_Boolean[1]"].dependencies[:4] == ("in_Boolean[1]", "in_Boolean[2]", "in_Boolean[3]", "u[1,1]")
        assert {name: len(elements) for name, elements in arrays(inputs(slave.ports)).items()} == {
            "u": 6, "in_Int32": 2, "in_Int64": 1, "in_Boolean": 3, **{f"in_{kind}": 1 for kind in c_fmu3.NARROW},
        }  # fmt: skip
        assert [p.name for p in slave.ports if p.causality == "parameter"] == [
            *(f"gain[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)),
            "limit",
            "label",
        ]
    finally:
        slave.close()
        slave.close()


def test_every_type_is_carried_to_its_ends(types):
    slave = FmuSlave(types, "x")
    names_in, names_out = [p.name for p in inputs(slave.ports)], [p.name for p in outputs(slave.ports)]
    values, out = np.zeros(len(names_in)), np.zeros(len(names_out))
    given = {
        "in_Float32": 0.1, "in_Int8": 126, "in_UInt8": 254, "in_Int16": -32768, "in_UInt16": 65534,
        "in_Int32[1]": -(2**31), "in_Int32[2]": 2**31 - 2,
        "in_UInt32": 2**32 - 2, "in_Int64": -(2**53), "in_UInt64": 2**53 - 2, "in_Boolean[2]": 1,
    }  # fmt: skip
    for name, value in given.items():
        values[names_in.index(name)] = value
    try:
        slave.initialise(0.0, 1.0, 0.004)
        slave.set_inputs(values)
        slave.step(0.0, 0.004)
        slave.get_outputs(out)
        got = dict(zip(names_out, out, strict=True))
        assert got["out_Float32"] == 2 * np.float32(0.1)
        assert [got[f"out_Boolean[{i}]"] for i in (1, 2, 3)] == [1, 0, 1]
        for name, value in given.items():
            if "Int" in name:
                assert got[name.replace("in_", "out_")] == value + 1, name
        for name, value, text in (
            ("in_UInt8", 256, "input in_UInt8 = 256 does not fit uint8: expected 0 to 255"),
            ("in_UInt64", -1, "input in_UInt64 = -1 does not fit uint64: expected 0 to"),
        ):
            values[names_in.index(name)] = value
            with pytest.raises(SlaveError, match=text):
                slave.set_inputs(values)
            values[names_in.index(name)] = 0
    finally:
        slave.close()


def test_parameters_of_an_array_keep_their_starts(plain):
    system, resolve = driven(plain, 1.0, **{"gain[2,3]": 3.0, "gain[1,1]": 0.0, "label": "a"})
    r = run(system, stop=0.04, resolver=resolve)
    assert r["x.y"][-1].tolist()[0] == [0.0, r["x.y[1,2]"][-1], r["x.y[1,3]"][-1]]
    y = 0.0
    for _ in range(10):
        y += 0.004 * 3.0 * 0.5
    assert r["x.y[2,3]"][-1] == y  # the same arithmetic: EXACT


def test_compiled_and_python_loop_give_the_same_bits(plain, tmp_path):
    components = tuple(Component(n, str(plain), {"gain": [[g, 1, 2], [3, 4, 5]]}) for n, g in (("a", 0.1), ("b", 0.2)))
    links = [("a.y", "b.u"), ("a.out_Int32", "b.in_Int32"), ("b.out_Int64", "a.in_Int64"), ("a.out_Boolean", "b.in_Boolean")]
    made = System("two", 0.004, components, tuple(Connection(*ends, delayed=ends[0].startswith("b")) for ends in links), stop=1.0)
    results = [run(made, tmp_path / loop, loop=loop) for loop in ("compiled", "python")]
    for name in results[0].columns:
        assert np.array_equal(results[0][name], results[1][name]), name
    assert results[0]["b.out_Boolean"].tolist()[1] == [1.0, 0.0, 1.0]  # not not: what went in
    assert np.ptp(results[0]["b.y"]) > 0.0
    assert results[0]["b.out_Int32"][-1].tolist() == [3.0, 4.0]


def test_rates_and_iteration(tmp_path):
    """A ring of two that drive each other, y' = u + 1: at two rates in both loops, and iterated, where it is implicit Euler."""
    file = str(c_fmu3.build(tmp_path, c_fmu3.PLAIN, c_fmu3.SOURCE.replace("m->v.gain[i] * m->v.u[i]", "(m->v.gain[i] * m->v.u[i] + 1)")))
    ring = (Connection("a.y", "b.u"), Connection("b.y", "a.u", delayed=True))
    made = System("ring", 0.004, (Component("a", file, rate=2), Component("b", file, every=3)), ring, stop=0.4)
    results = [run(made, loop=loop) for loop in ("compiled", "python")]
    assert np.array_equal(results[0]["b.y"], results[1]["b.y"])
    assert np.ptp(results[0]["b.y[2,3]"]) > 0.1
    iterated = System("ring", 0.004, (Component("a", file), Component("b", file)), (ring[0], replace(ring[1], delayed=False)), stop=0.4)
    r = run(replace(iterated, algorithm="iterated"))
    assert np.all(r["master.iterations"][1:] >= 2.0)
    y = r["a.y[1,1]"]
    assert np.allclose(y[1:], y[:-1] + 0.004 * (y[1:] + 1.0), rtol=0.0, atol=DEFAULT.tolerance)


def test_types_that_the_compiled_loop_does_not_carry(types):
    made = System("one", 0.004, (Component("x", str(types)),), stop=0.04)
    assert len(run(made)) == 11
    with pytest.raises(OrchestrationError, match=r"component 'x' \(FmuSlave\) can only be called from Python"):
        run(made, loop="compiled")


STEP = "fmi3DoStep(t = 0.012, h = 0.004) "


@pytest.mark.parametrize("loop", ["compiled", "python"])
@pytest.mark.parametrize(
    ("value", "parameters", "text"),
    [
        (101.0, {}, STEP + "returned 3 (error); it says:\n  overload at t = 0.012"),
        (1001.0, {}, STEP + "returned 4 (fatal); it says:\n  100 % melted"),
        (1.0, {"limit": 0.0}, STEP + "asks for the end of the simulation (terminateSimulation at t = 0.016 s); if that is meant, give"),
        (-1.0, {"limit": 0.0}, STEP + "returned early, at t = 0.012 s, though it was told not to (earlyReturnAllowed = false)"),
    ],
)  # fmt: skip
def test_what_a_step_can_say(plain, tmp_path, loop, value, parameters, text):
    """Both loops say the same: for the compiled one, the value comes from another FMU."""
    clock = c_fmu3.SOURCE.replace("m->v.y[i] += h * m->v.gain[i] * m->v.u[i];", f"m->v.y[i] = t + h > 0.01 ? {value} : 0.0;")
    (tmp_path / "clock").mkdir()
    components = (Component("s", str(c_fmu3.build(tmp_path / "clock", c_fmu3.PLAIN, clock))), Component("x", str(plain), parameters))
    made = System("t", 0.004, components, (Connection("s.y[1,1]", "x.u[1,1]", delayed=True),))
    with pytest.raises(RunError) as caught:
        run(made, tmp_path / "r", stop=0.04, loop=loop)
    assert str(caught.value).startswith("component 'x' failed in the step from t = 0.012 s: component 'x': " + text)
    assert len(Run.load(tmp_path / "r")) == 4


def test_a_warning_is_no_error(plain):
    system, resolve = driven(plain, 60.0)
    assert len(run(system, stop=0.04, resolver=resolve)) == 11


@pytest.mark.parametrize(
    ("parameters", "start", "text"),
    [
        ({}, -1.0, "fmi3EnterInitializationMode returned 3 (error); it says:\n  start time is negative"),
        ({"label": "bad"}, 0.0, "fmi3SetString returned 3 (error); it says:\n  the label is bad"),
    ],
)
def test_failed_initialisation(plain, parameters, start, text):
    with pytest.raises(RunError) as caught:
        run(System("one", 0.004, (Component("x", str(plain), parameters),)), start=start, stop=0.04)
    assert text in str(caught.value)


def test_state(plain, tmp_path):
    """Rollback is proved, and a run that is resumed gives the same numbers."""
    slave = FmuSlave(plain, "x")
    try:
        slave.initialise(0.0, 1.0, 0.004)
        slave.set_inputs(np.ones(len(inputs(slave.ports))))
        slave.step(0.0, 0.004)
        state, out, again = slave.get_state(), np.zeros(len(outputs(slave.ports))), np.zeros(len(outputs(slave.ports)))
        assert isinstance(state[1], bytes)
        slave.step(0.004, 0.004)
        slave.get_outputs(out)
        slave.set_state(state)
        slave.step(0.004, 0.004)
        slave.get_outputs(again)
        assert np.array_equal(out, again)
    finally:
        slave.close()
    made = System("one", 0.004, (Component("x", str(plain)),), stop=0.4)
    made = replace(made, recording=replace(made.recording, checkpoint_every=20))
    whole = run(made, tmp_path / "whole")
    run(made, tmp_path / "r", stop=0.2)
    resumed = run(made, tmp_path / "r", resume=True)
    assert np.array_equal(whole["x.y"], resumed["x.y"])


def test_in_a_process_of_its_own(plain, tmp_path):
    made = System("one", 0.004, (Component("x", str(plain), {"gain[1,2]": 7.0}),), stop=0.04)
    isolated = replace(made, components=(replace(made.components[0], isolate=True),))
    assert np.array_equal(run(made)["x.y"], run(isolated)["x.y"])


EXTRA = """
  <Enumeration name="mode" valueReference="11" causality="parameter" variability="fixed" declaredType="Choice" start="1"/>
  <String name="texts" valueReference="30" causality="parameter" variability="fixed"><Dimension start="2"/>
   <Start value="a b"/><Start value="c"/></String>
  <String name="said" valueReference="31" causality="output"/>
  <Binary name="image" valueReference="32" causality="output"/>
  <String name="word" valueReference="33" causality="input"><Start value="x"/></String>
  <Binary name="key" valueReference="34" causality="parameter" variability="fixed"><Start value="00"/></Binary>
 </ModelVariables>"""


@pytest.fixture(scope="module")
def extra(tmp_path_factory):
    description = c_fmu3.PLAIN.replace(" </ModelVariables>", EXTRA).replace(
        " </ModelStructure>", '<Output valueReference="31"/><Output valueReference="32"/> </ModelStructure>'
    )
    return c_fmu3.build(tmp_path_factory.mktemp("extra"), description)


class TestOfOtherTypes:
    """Texts, binaries, structural parameters, enumerations: an FMU that has them runs; what is done with them is said by name."""

    def system(self, file, *connections, **parameters):
        components = (Component("x", str(file), parameters), Component("y", str(file)))
        return System("two", 0.004, components, tuple(Connection(*c) for c in connections), stop=0.02)

    def test_it_runs_with_them_unconnected(self, extra, plain):
        found, expected = run(self.system(extra)), run(self.system(plain))
        assert found.columns.keys() == expected.columns.keys()
        assert all(np.array_equal(found.columns[c], expected.columns[c]) for c in expected.columns)

    @pytest.mark.parametrize(
        ("connection", "text"),
        [
            (("x.said", "y.word"), "x.said is of type string, which cannot be connected: only numbers and booleans can"),
            (("x.image", "y.blob"), "x.image is of type binary, which cannot be connected: only numbers and booleans can"),
            (("x.rows", "y.in_Int64"), "x.rows is a structural parameter, which decides sizes of arrays and keeps its start value"),
        ],
    )
    def test_connected(self, extra, connection, text):
        with pytest.raises(OrchestrationError, match=f"connection {' -> '.join(connection)}: {text}"):
            run(self.system(extra, connection))

    @pytest.mark.parametrize(
        ("name", "value", "text"),
        [
            ("rows", 3, "'rows' is a structural parameter: it decides sizes of arrays and keeps its value 2"),
            ("key", "00ff", "parameter 'key': is of type binary, which cannot be set here; it keeps its start value"),
            ("mode", "c", r"parameter 'mode': expected an item of the enumeration: a \(1\), b \(2\); found 'c'"),
            ("mode", 3, r"parameter 'mode': expected an item of the enumeration: a \(1\), b \(2\); found 3"),
            ("said", "x", "'said' is an output, not a parameter"),
        ],
    )
    def test_set(self, extra, name, value, text):
        with pytest.raises(SystemFileError, match=f"component 'x': {text}"):
            run(self.system(extra, **{name: value}))

    def test_an_item_by_its_name(self, extra):
        slave = FmuSlave(extra, "x")
        slave.configure({"mode": "b"})
        assert slave._parameters == {"mode": 2}
        slave.close()

    def test_check_names_them(self, extra):
        documented = {r.check: r.detail for r in check_fmu(extra)}["units and descriptions"]
        assert "cannot be connected here: binary input blob, string output said, binary output image, string input word" in documented


LIBRARY = {f"binaries/{fmpy.platform_tuple}/types{c_fmu.SUFFIX}": b"not a library"}


@pytest.mark.parametrize("version", ["3.0.0", "3.0.1", "3.0.2", "3.0.14", "3.0.3-rc.1"])
def test_patch_releases_are_the_same_fmi(tmp_path, plain, version):
    """They change the wording of the standard only; what is run and checked is FMI 3.0."""
    file = c_fmu3.build(tmp_path, c_fmu3.PLAIN.replace('fmiVersion="3.0"', f'fmiVersion="{version}"'))
    found, expected = (run(System("one", 0.004, (Component("x", str(f)),), stop=0.04)) for f in (file, plain))
    assert np.array_equal(found["x.y"], expected["x.y"])
    checked = {r.check: r for r in check_fmu(file)}
    assert checked["runs in a fresh process"].outcome == "passed"
    assert f"FMI {version}" in checked["model description"].detail or checked["model description"].outcome == "failed"
    assert "model description" not in checked["exports"].detail  # the library says 3.0


class TestRefused:
    """One clear sentence for each."""

    @pytest.mark.parametrize(
        ("old", "new", "text"),
        [
            ("<CoSimulation", "<ModelExchange", "is an FMU for model exchange only; a co-simulation FMU is needed"),
            ("<CoSimulation", "<ScheduledExecution", "is an FMU for scheduled execution only; a co-simulation FMU is needed"),
            ('fmiVersion="3.0"', 'fmiVersion="3.0-beta.2"', "has FMI version 3.0-beta.2; only FMI 2.0 and 3.0 can be run"),
            ('fmiVersion="3.0"', 'fmiVersion="3.0.01"', "has FMI version 3.0.01; only FMI 2.0 and 3.0 can be run"),
            ('fmiVersion="3.0"', 'fmiVersion="3.1"', "has FMI version 3.1; only FMI 2.0 and 3.0 can be run: export it as co-simulation"),
            (
                '<Int64 name="in_Int64" valueReference="11"',
                '<Clock name="tick" valueReference="30" causality="input" intervalVariability="triggered"/>'
                '<Int64 name="in_Int64" clocks="30" valueReference="11"',
                "variable 'in_Int64' belongs to a clock, which only event mode can tick; event mode is not supported",
            ),
            ('causality="input" start="0"', 'causality="input" start="1 2"', "variable 'in_Int64': start value '1 2' is not of type Int64"),
            ('start="1 1 1 1 1 1"', 'start="1 1 1"', "array 'gain' has 6 elements and 3 start values; expected 1 or 6"),
            (
                '<Dimension start="2"/><Dimension start="3"/>',
                '<Dimension start="20000000"/>',
                "array 'gain' of size [20000000]: at most 1000000",
            ),
            ('name="out_Int32"', 'name="y"', "variable 'y' is there twice"),
            ("", "", f"its binary binaries/{fmpy.platform_tuple}/types{c_fmu.SUFFIX} is no Linux library (13 bytes"),
        ],
    )
    def test_descriptions(self, tmp_path, old, new, text):
        changed = c_fmu3.PLAIN.replace(old, new, 1)
        if new in ("<ModelExchange", "<ScheduledExecution"):
            changed = changed.replace('canHandleVariableCommunicationStepSize="true"', "").replace('hasEventMode="true"', "")
        file = c_fmu.pack(tmp_path / "bad.fmu", changed, LIBRARY)
        with pytest.raises(SlaveError) as caught:
            FmuSlave(file)
        assert str(caught.value).startswith(str(file))
        assert text in str(caught.value)

    def test_a_function_that_is_not_there(self, tmp_path):
        file = c_fmu3.build(
            tmp_path, c_fmu3.PLAIN, c_fmu3.SOURCE.replace("fmi3SetInt64", "fmi3SetInt65").replace("fmi3Set##NAME", "fmi3Sets##NAME")
        )
        with pytest.raises(SlaveError, match=r"types.fmu: its binary has no function fmi3SetFloat64"):
            FmuSlave(file)
        file = c_fmu3.build(tmp_path, c_fmu3.PLAIN, c_fmu3.SOURCE.replace("fmi3DoStep(", "fmi3DoStop("))
        with pytest.raises(SlaveError, match=r"types.fmu: its binary cannot be loaded: .*fmi3DoStep"):
            FmuSlave(file)

    def test_wrong_token(self, plain, tmp_path):
        library = {f"binaries/{fmpy.platform_tuple}/types{c_fmu.SUFFIX}": (plain.parent / f"types{c_fmu.SUFFIX}").read_bytes()}
        file = c_fmu.pack(tmp_path / "wrong.fmu", c_fmu3.PLAIN.replace("c-fmu-3", "other"), library)
        with pytest.raises(RunError, match="fmi3InstantiateCoSimulation failed; it says:\n  wrong token"):
            run(System("one", 0.004, (Component("x", str(file)),)), stop=0.04)

    def test_parameters(self, plain):
        with pytest.raises(SystemFileError, match=r"component 'x': parameter 'gain\[1,2\]': -1 1 is below its minimum 0 1"):
            run(System("one", 0.004, (Component("x", str(plain), {"gain[1,2]": -1.0}),)), stop=0.04)
        with pytest.raises(SystemFileError, match=r"component 'x': unknown parameter 'rose'.*available: gain, limit, label"):
            run(System("one", 0.004, (Component("x", str(plain), {"rose": 3}),)), stop=0.04)
