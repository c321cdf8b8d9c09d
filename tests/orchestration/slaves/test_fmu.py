"""FMUs as slaves: one in C and one from pythonfmu, neither made by robomill; and what is refused."""

from __future__ import annotations

import math
import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from pythonfmu.builder import FmuBuilder

from robomill.conformance import check_fmu
from robomill.orchestration.assembly import assemble, run
from robomill.orchestration.errors import RunError, SlaveError, SystemFileError
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves import description
from robomill.orchestration.slaves.fmu import FmuSlave
from robomill.orchestration.slaves.protocol import PortData, Slave, inputs, outputs
from robomill.orchestration.system.definition import Component, System
from tests.orchestration import c_fmu
from tests.orchestration.mocks import gain, resolver, source, system

pytestmark = pytest.mark.usefixtures("temporary")

SCRIPT = """
import traceback
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String
from pythonfmu.enums import Fmi2Status


class Amplifier(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u = [0.0, 0.0]
        self.factor = 2.0
        self.label = "x"
        self.count = 0
        for i in (0, 1):
            get, put = lambda i=i: self.u[i], lambda v, i=i: self.u.__setitem__(i, v)
            self.register_variable(Real(f"u[{i + 1}]", causality=Fmi2Causality.input, getter=get, setter=put))
            self.register_variable(Real(f"y[{i + 1}]", causality=Fmi2Causality.output, getter=lambda i=i: self.factor * self.u[i]))
        self.register_variable(Integer("count", causality=Fmi2Causality.output))
        self.register_variable(Real("factor", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        self.register_variable(String("label", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))

    def do_step(self, t, h):
        self.count += 1
        if self.u[0] < -1.0 and self.label == "logs":
            try:
                raise ValueError("u is %s, below -1" % self.u[0])
            except ValueError:
                self.log(traceback.format_exc(), Fmi2Status.error)
                return False
        if self.u[0] < -1.0:
            raise ValueError("unlogged")
        return True
"""


@pytest.fixture(scope="module")
def euler(tmp_path_factory) -> Path:
    if c_fmu.compiler() is None:
        pytest.skip("no C compiler here")
    return c_fmu.build(tmp_path_factory.mktemp("c"))


@pytest.fixture(scope="module")
def amplifier(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("py")
    (folder / "h7_amplifier.py").write_text(SCRIPT)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        return Path(FmuBuilder.build_FMU(folder / "h7_amplifier.py", dest=folder, needsExecutionTool=False))


def one(file, **options) -> System:
    return System("one", 0.004, (Component("x", str(file), options),))


class TestC:
    """An FMU written in C after the standard."""

    def test_ports(self, euler):
        slave = FmuSlave(euler, "x")
        try:
            assert isinstance(slave, Slave)
            assert inputs(slave.ports) == (
                PortData("u", "input", "real", "1", 0.5, description="what is integrated"),
                PortData("offset", "input", "integer", None, 0, minimum=-5.0),
                PortData("invert", "input", "boolean", None, False),
            )
            assert outputs(slave.ports) == (
                PortData("y", "output", "real", "m", None, -1e6, 1e6, dependencies=()),
                PortData("n", "output", "integer"),
                PortData("on", "output", "boolean", dependencies=("u", "invert")),
                PortData("twice", "output", "real", "1", dependencies=("u",)),
            )
            assert [p.name for p in slave.ports if p.causality == "parameter"] == ["gain", "label"]
        finally:
            slave.close()
            slave.close()  # may be repeated

    def test_runs_with_all_types(self, euler, tmp_path):
        s, flag = source("s", lambda t: t - 0.01), source("flag", lambda t: 1.0)
        made = system([s, flag], "s.y -> x.u", "x.twice -> z.u")
        made = System(
            "t",
            0.004,
            (*made.components, Component("x", str(euler), {"gain": 3.0, "label": "a"}), Component("z", str(euler))),
            made.connections,
        )
        r = run(made, stop=0.04, resolver=resolver([s, flag]))
        assert np.array_equal(r["x.n"], np.arange(11))
        assert np.array_equal(r["x.on"], [0, *(r.t[1:] - 0.01 > 0)])
        y = 0.0
        for k in range(1, 11):
            y += 0.004 * 3.0 * (r.t[k] - 0.01)
            assert r["x.y"][k] == y  # the same arithmetic: EXACT
        assert np.array_equal(r["x.twice"], 2 * r["s.y"])
        assert np.array_equal(r["z.twice"], 4 * r["s.y"])

    def test_start_values_of_open_inputs(self, euler):
        assert run(one(euler), stop=0.04)["x.twice"][0] == 1.0  # u starts at 0.5

    def test_outputs_before_the_first_step_follow_the_inputs(self, euler):
        slave, out = FmuSlave(euler, "x"), np.zeros(4)
        slave.initialise(0.0, 1.0, 0.004)
        for u in (3.0, 4.0):
            slave.set_inputs(np.array([u, 0.0, 0.0]))
            slave.get_outputs(out)
            assert out[3] == 2 * u
        slave.close()

    def test_state(self, euler):
        slave, out, again = FmuSlave(euler, "x"), np.zeros(4), np.zeros(4)
        slave.initialise(0.0, 1.0, 0.004)
        slave.set_inputs(np.array([1.0, 0.0, 0.0]))
        slave.step(0.0, 0.004)
        state = slave.get_state()
        slave.step(0.004, 0.004)
        slave.get_outputs(out)
        slave.step(0.008, 0.004)
        slave.set_state(state)
        slave.step(0.004, 0.004)
        slave.get_outputs(again)
        assert np.array_equal(out, again)
        assert isinstance(state[1], bytes)
        slave.close()

    def test_two_instances_do_not_interfere(self, euler):
        r = run(System("two", 0.004, (Component("a", str(euler), {"gain": 1}), Component("b", str(euler), {"gain": 2}))), stop=0.04)
        assert np.array_equal(2 * r["a.y"], r["b.y"])

    def test_initialising_again_starts_afresh(self, euler):
        slave, out = FmuSlave(euler, "x"), np.zeros(4)
        for _ in range(2):
            slave.initialise(0.0, 1.0, 0.004)
            slave.set_inputs(np.array([1.0, 0.0, 0.0]))
            slave.step(0.0, 0.004)
            slave.get_outputs(out)
            assert list(out) == [0.004, 1.0, 1.0, 2.0]
        slave.close()

    @pytest.mark.parametrize(
        ("u", "text"),
        [
            (101.0, "fmi2DoStep(t = 0.008, h = 0.004) returned 3 (error); it says:\n  overload at t = 0.008: u = 101"),
            (1001.0, "fmi2DoStep(t = 0.008, h = 0.004) returned 4 (fatal); it says:\n  melted at 0.008 with u = 1001"),
        ],
    )
    def test_an_error_shows_what_the_fmu_logged(self, euler, tmp_path, u, text):
        s = source("s", lambda t: u if t > 0.01 else 0.0)
        made = system([s], "s.y -> x.u")
        made = System("t", 0.004, (*made.components, Component("x", str(euler))), made.connections)
        with pytest.raises(RunError) as caught:
            run(made, tmp_path / "r", stop=0.04, resolver=resolver([s]))
        assert str(caught.value).startswith("component 'x' failed in the step from t = 0.008 s: component 'x': " + text)
        assert (caught.value.component, caught.value.time) == ("x", 0.008)
        assert len(Run.load(tmp_path / "r")) == 3

    def test_a_warning_is_no_error(self, euler):
        s = source("s", lambda t: 60.0)
        made = system([s], "s.y -> x.u")
        made = System("t", 0.004, (*made.components, Component("x", str(euler))), made.connections)
        assert run(made, stop=0.04, resolver=resolver([s]))["x.n"][-1] == 10

    def test_failed_initialisation(self, euler):
        with pytest.raises(
            RunError, match=r"failed during initialisation: .*fmi2SetupExperiment returned 3 \(error\); it says:\n  start time -1"
        ):
            run(one(euler), start=-1.0, stop=0.04)

    def test_failed_instantiation(self, euler, tmp_path):
        library = {f"binaries/{fmpy.platform}/euler{c_fmu.SUFFIX}": (euler.parent / f"euler{c_fmu.SUFFIX}").read_bytes()}
        file = c_fmu.pack(tmp_path / "wrong.fmu", c_fmu.DESCRIPTION.replace('guid="c-fmu"', 'guid="other"'), library)
        with pytest.raises(RunError, match="fmi2Instantiate failed; it says:\n  wrong guid other"):
            run(one(file), stop=0.04)

    @pytest.mark.parametrize(
        ("parameters", "text"),
        [
            ({"gian": 1.0}, "component 'x': unknown parameter 'gian'; did you mean 'gain'? available: gain, label"),
            ({"gain": -1.0}, "component 'x': parameter 'gain': -1 1 is below its minimum 0 1"),
            ({"u": 1.0}, "component 'x': 'u' is an input, not a parameter"),
        ],
    )
    def test_wrong_parameters(self, euler, parameters, text):
        with pytest.raises(SystemFileError) as caught:
            assemble(one(euler, **parameters))
        assert str(caught.value) == text

    def test_closed_slaves_refuse(self, euler):
        slave = FmuSlave(euler, "x")
        with pytest.raises(SlaveError, match="component 'x': is not running"):
            slave.step(0.0, 0.004)
        slave.close()
        with pytest.raises(SlaveError, match="component 'x': is not running"):
            slave.set_inputs(np.zeros(3))


class TestPythonfmu:
    """An FMU made by pythonfmu's own builder."""

    def test_runs(self, amplifier):
        s = source("s", lambda t: t, unit="1")
        made = system([s], "s.y -> x.u[2]")
        made = System("t", 0.004, (*made.components, Component("x", str(amplifier), {"factor": 5.0})), made.connections)
        r = run(made, stop=0.04, resolver=resolver([s]))
        assert np.array_equal(r["x.y"][1:], np.stack([0 * r.t, 5 * r["s.y"]], axis=1)[1:])
        assert np.array_equal(r["x.count"], np.arange(11))

    def test_a_traceback_that_the_slave_logs_is_shown(self, amplifier):
        """With its per cent signs: pythonfmu's messages are no formats."""
        s = source("s", lambda t: -2.0 if t > 0.01 else 0.0)
        made = system([s], "s.y -> x.u[1]")
        made = System("t", 0.004, (*made.components, Component("x", str(amplifier), {"label": "logs"})), made.connections)
        with pytest.raises(RunError) as caught:
            run(made, stop=0.04, resolver=resolver([s]))
        text = str(caught.value)
        assert (
            "fmi2DoStep(t = 0.008, h = 0.004) asks for the end of the simulation (fmi2Terminated" in text
        )  # what pythonfmu makes of False
        assert "it says:\n  Traceback (most recent call last):" in text
        assert 'raise ValueError("u is %s, below -1" % self.u[0])' in text
        assert text.endswith("ValueError: u is -2.0, below -1")

    def test_an_exception_that_it_does_not_catch(self, amplifier):
        s = source("s", lambda t: -2.0 if t > 0.01 else 0.0)
        made = system([s], "s.y -> x.u[1]")
        made = System("t", 0.004, (*made.components, Component("x", str(amplifier))), made.connections)
        with pytest.raises(RunError, match=r"returned 4 \(fatal\); it says:\n  Fatal py exception encountered: \[doStep\]"):
            run(made, stop=0.04, resolver=resolver([s]))

    def test_state_that_cannot_be_saved(self, amplifier):
        slave = FmuSlave(amplifier, "x")
        with pytest.raises(SlaveError, match=r"component 'x': Amplifier.fmu cannot save its state \(canGetAndSetFMUstate is false\)"):
            slave.get_state()
        slave.close()


def test_functions_that_are_not_needed_may_be_missing(euler, tmp_path):
    source = c_fmu.SOURCE
    for name in ("GetFMUstate", "DeSerializeFMUstate", "GetDirectionalDerivative", "CancelStep", "GetStringStatus", "SetString", "Reset"):
        assert f"fmi2Status fmi2{name}(" in source
        source = source.replace(f"fmi2Status fmi2{name}(", f"fmi2Status without_{name}(")
    flags = 'canGetAndSetFMUstate="true" canSerializeFMUstate="true"'
    file = c_fmu.build(tmp_path, source, c_fmu.DESCRIPTION.replace(flags, ""))
    found, expected = (run(System("one", 0.004, (Component("x", str(f)),), stop=0.04)) for f in (file, euler))
    assert np.array_equal(found["x.y"], expected["x.y"])
    with pytest.raises(RunError, match=r"component 'x'.*euler.fmu has no function fmi2SetString"):
        run(System("one", 0.004, (Component("x", str(file), {"label": "a"}),), stop=0.04))
    needed = c_fmu.build(tmp_path, c_fmu.SOURCE.replace("fmi2Status fmi2DoStep(", "fmi2Status do_step("))
    with pytest.raises(SystemFileError, match=r"its binary cannot be loaded: .*undefined symbol: fmi2DoStep"):
        run(System("one", 0.004, (Component("x", str(needed)),), stop=0.04))


def test_the_tolerance_of_its_default_experiment(tmp_path):
    """What others run it with: without, some vendors' solvers do not start."""
    setup = "if (t0 < 0) {"
    source = c_fmu.SOURCE.replace(setup, f"((Model *)c)->v.y = td ? tol : -1.0; {setup}")
    for experiment, expected in (('<DefaultExperiment tolerance="1e-5"/>', 1e-5), ("", -1.0)):
        file = c_fmu.build(tmp_path, source, c_fmu.DESCRIPTION.replace("  <ModelVariables>", f"  {experiment}<ModelVariables>"))
        assert run(System("one", 0.004, (Component("x", str(file), inputs={"u": 0.0}),), stop=0.04))["x.y"][-1] == expected
        assert {r.check: r.outcome for r in check_fmu(file)}["runs in a fresh process"] == "passed"


def test_an_fmu_of_which_a_process_can_have_one_instance(tmp_path):
    once = c_fmu.DESCRIPTION.replace("<CoSimulation ", '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" ')
    file = c_fmu.build(tmp_path, description=once)
    two = System("two", 0.004, (Component("x", str(file)), Component("y", str(file))), stop=0.04)
    with pytest.raises(SystemFileError) as caught:
        run(two)
    assert "component 'y': euler.fmu can be instantiated only once per process (canBeInstantiatedOnlyOncePerProcess)" in str(caught.value)
    assert "component 'x' is that instance; set isolate = true for one of them" in str(caught.value)
    remedied = replace(two, components=(two.components[0], replace(two.components[1], isolate=True)))
    first, second = run(remedied), run(remedied)  # and one after the other: the first was closed
    assert np.array_equal(first["x.y"], first["y.y"])
    assert np.array_equal(first["x.y"], second["x.y"])


BAD = c_fmu.DESCRIPTION
LIBRARY = {f"binaries/{fmpy.platform}/euler{c_fmu.SUFFIX}": b"not a library"}


class TestRefused:
    """One clear sentence for each file that is not an FMU which can run here."""

    @pytest.mark.parametrize(
        ("description", "files", "text"),
        [
            (None, {"readme.txt": b""}, "no modelDescription.xml in it, so not an FMU; it holds readme.txt"),
            (BAD.replace('fmiVersion="2.0"', 'fmiVersion="1.0"'), LIBRARY, "has FMI version 1.0; only FMI 2.0 and 3.0 can be run"),
            (
                BAD.replace("CoSimulation", "ModelExchange").replace('canHandleVariableCommunicationStepSize="true"', ""),
                LIBRARY,
                "is an FMU for model exchange only; a co-simulation FMU is needed",
            ),
            (BAD, {}, f"no binary for this platform (binaries/{fmpy.platform}/euler{c_fmu.SUFFIX}); it has binaries for no platform"),
            (
                BAD,
                {"binaries/vax780/euler.exe": b"", "binaries/win32/euler.dll": b"", "sources/a.c": b""},
                "it has binaries for vax780, win32 and C sources, which can be compiled; export it for this platform",
            ),
            (BAD, LIBRARY, f"its binary binaries/{fmpy.platform}/euler{c_fmu.SUFFIX} is no Linux library (13 bytes"),
            (BAD.replace("<ModelVariables>", "<Variables>"), LIBRARY, "modelDescription.xml is not valid XML: mismatched tag"),
            (BAD.replace("<Real/>", "<Reel/>"), LIBRARY, "modelDescription.xml is not valid:"),
            (
                BAD.replace("<fmiModel", "<!DOCTYPE x><fmiModel", 1),
                LIBRARY,
                "modelDescription.xml has a document type declaration or entities",
            ),
        ],
    )
    def test_archives(self, tmp_path, description, files, text):
        file = c_fmu.pack(tmp_path / "bad.fmu", description, files)
        here = Path.cwd()
        with pytest.raises(SlaveError) as caught:
            FmuSlave(file)
        assert str(caught.value).startswith(str(file))
        assert text in str(caught.value)
        assert Path.cwd() == here

    def test_path_is_relative_to_the_system_file_which_is_named_with_the_line(self, tmp_path):
        (tmp_path / "system.toml").write_text('name = "x"\nstep = "1 s"\n\n[components.drive]\nsource = "dist/drive.fmu"\n')
        with pytest.raises(SystemFileError) as caught:
            assemble(System.load(tmp_path / "system.toml"))
        assert str(caught.value).startswith(f"system.toml:4: component 'drive': {tmp_path}/dist/drive.fmu: no such file")

    def test_unknown_in_process_component(self):
        with pytest.raises(SystemFileError, match=r"component 'x': source 'drive': unknown component; available: mock"):
            assemble(one("drive"), resolver([]))
        with pytest.raises(
            SystemFileError, match=r"source 'drive' is neither an .fmu file nor replay:FOLDER, and no in-process components"
        ):
            assemble(one("drive"))

    def test_what_was_opened_before_is_closed(self, euler):
        a = gain("a")
        s = System("t", 0.004, (Component("a", "mock"), Component("x", str(euler)), Component("y", "nothing.fmu")))
        with pytest.raises(SystemFileError):
            assemble(s, resolver([a]))
        assert a.closed == 1


def test_nan_from_an_fmu_is_caught(euler):
    s = source("s", lambda t: math.nan)
    made = system([s], "s.y -> x.u")
    made = System("t", 0.004, (*made.components, Component("x", str(euler))), made.connections)
    with pytest.raises(RunError, match=r"component 's' at t = 0 s: output y is not a number"):
        run(made, stop=0.04, resolver=resolver([s]))


def test_a_description_is_read_once_per_content_and_anew_when_the_file_has_changed(euler, tmp_path, monkeypatch):
    read: list[str] = []
    original = description.read_model_description
    monkeypatch.setattr(description, "_KNOWN", {})
    monkeypatch.setattr(description, "read_model_description", lambda *a, **k: read.append("") or original(*a, **k))
    file = tmp_path / "again.fmu"
    file.write_bytes(euler.read_bytes())
    one, two = FmuSlave(file, "one"), FmuSlave(file, "two")
    assert len(read) == 1
    assert one.ports is two.ports
    assert one.description.library != two.description.library  # each has its own unpacked copy
    one.close()
    two.close()
    with zipfile.ZipFile(euler) as old, zipfile.ZipFile(file, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, content.replace(b"</ModelVariables>", b" </ModelVariables>") if name == "modelDescription.xml" else content)
    FmuSlave(file, "three").close()
    assert len(read) == 2


def test_of_many_descriptions_the_oldest_are_forgotten(euler, tmp_path, monkeypatch):
    monkeypatch.setattr(description, "_KNOWN", {})
    monkeypatch.setattr(description, "_KEPT", 2)
    for name in ("a", "b", "c"):
        file = tmp_path / f"{name}.fmu"
        file.write_bytes(euler.read_bytes())
        FmuSlave(file, name).close()
    assert [file.stem for file, _ in description._KNOWN] == ["b", "c"]
