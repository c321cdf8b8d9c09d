"""The Python FMU through FMPy: calls, errors, states, several in one process, its cache, without Numba."""

from __future__ import annotations

import ctypes
import gc
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from robomill.conformance import CallFailed, Fmu, Instance
from robomill.fmus.components import COMPONENTS
from robomill.fmus.in_process import InProcessSlave
from robomill.fmus.python.builder import build
from robomill.models.components.recording import replay_model
from tests import ROOT
from tests.fmus import demo

Built = Callable[[str], Path]


@pytest.fixture
def fmu(built: Built, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fmu:
    monkeypatch.chdir(tmp_path)
    return Fmu(built("demo"))


@pytest.fixture
def instance(fmu: Fmu) -> Iterator[Instance]:
    one = Instance(fmu, "springs")
    yield one
    one.free()


def reference(fmu: Fmu, name: str) -> int:
    return next(int(v.valueReference) for v in fmu.md.modelVariables if v.name == name)


def set_real(instance: Instance, name: str, value: float) -> None:
    instance.call("fmi2SetReal", (ctypes.c_uint * 1)(reference(instance.fmu, name)), 1, (ctypes.c_double * 1)(value))


def test_building_twice_gives_the_same_bytes_and_other_content_another_name(tmp_path: Path) -> None:
    first, second = build(demo.MODEL, tmp_path / "a"), build(demo.MODEL, tmp_path / "b" / "other.fmu")
    assert first.name == "demo.fmu"
    assert first.read_bytes() == second.read_bytes()
    changed = build(demo.MODEL, tmp_path / "c", page="# Another page")
    packages = [next(n for n in zipfile.ZipFile(f).namelist() if n.startswith("resources/python/")).split("/")[2] for f in (first, changed)]
    assert packages[0] != packages[1]


def test_the_archive_holds_what_an_fmu_should(built: Built) -> None:
    with zipfile.ZipFile(built("robot_compliance")) as archive:
        names = set(archive.namelist())
        html = archive.read("documentation/index.html").decode()
    assert {"modelDescription.xml", "model.png", "binaries/linux64/robot_compliance.so", "binaries/win64/robot_compliance.dll"} <= names
    assert {"documentation/licenses/license.txt", "documentation/licenses/pythonfmu.txt", "documentation/reference/out.csv"} <= names
    assert "stiffness[11,3]" in html
    assert not [n for n in names if "__pycache__" in n or "tests/" in n]


def test_nothing_bundled_imports_the_repositorys_packages(built: Built) -> None:
    with zipfile.ZipFile(built("path_interpolator")) as archive:
        for name in archive.namelist():
            if name.endswith(".py"):
                for line in archive.read(name).decode().splitlines():
                    assert not line.lstrip().startswith(("from models", "from fmus", "import models", "import fmus")), f"{name}: {line}"


def test_a_model_that_no_module_holds_cannot_be_bundled(tmp_path: Path) -> None:
    copy = type(demo.MODEL)(**{f: getattr(demo.MODEL, f) for f in demo.MODEL.__dataclass_fields__} | {"name": "copy"})
    with pytest.raises(
        ValueError,
        match=r"model 'copy': not bundled: its step stands in module 'tests\.fmus\.demo', and no module of the package 'tests' holds",
    ):
        build(copy, tmp_path)


def test_a_plain_import_of_a_bundled_module_cannot_be_renamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = (
        Path(demo.__file__)
        .read_text(encoding="utf-8")
        .replace("import numpy as np", "import robomill.models.model.units\nimport numpy as np")
    )
    (tmp_path / "awkward.py").write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    import awkward  # type: ignore[import-not-found]  # written above

    module: ModuleType = awkward
    with pytest.raises(ValueError, match=r"awkward\.py, line \d+: not bundled: write `from package import module`"):
        build(module.MODEL, tmp_path)
    sys.modules.pop("awkward")


def test_outputs_read_during_initialisation_follow_inputs_and_parameters(instance: Instance) -> None:
    instance.call("fmi2SetupExperiment", 0, 0.0, 0.0, 0, 0.0)
    instance.call("fmi2EnterInitializationMode")
    instance.set(instance.fmu.inputs, [0.1, 0.2, 1.0, 0.0, 3.0])
    assert instance.get() == [10.0, 10.0, 0.0, 1.0, 0.0, 7.0]
    set_real(instance, "stiffness[1,1]", 200.0)
    assert instance.get()[0] == 20.0
    instance.call("fmi2ExitInitializationMode")
    assert instance.get()[0] == 20.0


def test_tables_are_named_by_path(instance: Instance, tmp_path: Path) -> None:
    np.save(tmp_path / "my curve.npy", [[0.0, 5.0]])
    curve = [v for v in instance.fmu.parameters if v.name == "curve"]
    instance.set(curve, [tmp_path / "my curve.npy"])
    assert instance.initialise()[5] == 5.0
    buffer = (ctypes.c_char_p * 1)()
    instance.call("fmi2GetString", (ctypes.c_uint * 1)(reference(instance.fmu, "curve")), 1, buffer)
    assert buffer[0] == str(tmp_path / "my curve.npy").encode()


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("x[2]", float("nan"), "springs: input x[2] = nan m is not a finite number"),
        ("stiffness[2,1]", -1.0, "springs: parameter stiffness[2,1] = -1.0 N/m is below its minimum 0 N/m"),
        ("force[1]", 1.0, "springs: force[1] is an output and cannot be set"),
        ("count", 1.0, "is count, a integer; expected a real"),
    ],
)
def test_a_bad_value_is_refused_with_a_text_in_log_and_stderr(
    instance: Instance, capfd: pytest.CaptureFixture[str], name: str, value: float, text: str
) -> None:
    with pytest.raises(CallFailed, match="fmi2SetReal returned fatal"):
        set_real(instance, name, value)
    assert text in instance.log[-1]
    assert text in capfd.readouterr().err


def test_a_value_reference_that_does_not_exist_is_refused(instance: Instance) -> None:
    with pytest.raises(CallFailed, match="springs: value reference 999 does not exist; expected a real"):
        instance.call("fmi2GetReal", (ctypes.c_uint * 1)(999), 1, (ctypes.c_double * 1)())


def test_a_failed_step_gives_the_models_message_and_the_instance_goes_on_from_a_state(instance: Instance) -> None:
    instance.initialise()
    saved = instance.state()
    expected = instance.step(0)
    set_real(instance, "x[1]", 1.5)
    with pytest.raises(
        CallFailed, match=r"fmi2DoStep returned fatal: .* springs \(demo\): x\[1\] = 1.5 m is too far at t = 0.004 s; at most 1 m"
    ):
        instance.call("fmi2DoStep", ctypes.c_double(0.004), ctypes.c_double(0.004), 1)
    with pytest.raises(CallFailed, match=r"cannot go on after an error; reset it or restore a state\. The error was: "):
        instance.call("fmi2DoStep", ctypes.c_double(0.004), ctypes.c_double(0.004), 1)
    instance.restore(saved)
    assert instance.step(0) == expected


def test_a_failed_initialisation_is_reported_where_it_happens(instance: Instance) -> None:
    set_real(instance, "stiffness[1,1]", 13.0)
    with pytest.raises(CallFailed, match=r"fmi2(GetReal|ExitInitializationMode) returned fatal: .*brings bad luck"):
        instance.initialise()
    instance.call("fmi2Reset")
    assert instance.initialise()[1] != 0.0


def test_a_step_before_the_end_of_initialisation_is_refused(instance: Instance) -> None:
    with pytest.raises(CallFailed, match="springs: a step before the end of initialisation"):
        instance.call("fmi2DoStep", ctypes.c_double(0.0), ctypes.c_double(0.004), 1)


def test_fixed_parameters_stay_and_tunable_ones_may_change_after_initialisation(instance: Instance) -> None:
    instance.initialise()
    with pytest.raises(CallFailed, match=r"parameter stiffness\[1,1\] is fixed"):
        set_real(instance, "stiffness[1,1]", 5.0)
    set_real(instance, "drift", 1.0)


def test_a_per_cent_sign_survives_a_logger_that_formats(instance: Instance) -> None:
    """The logger of FMI is printf-like: the text must not be a format with something to fill in."""
    curve = [v for v in instance.fmu.parameters if v.name == "curve"]
    with pytest.raises(CallFailed):
        instance.set(curve, ["/no/%s/such%n"])
    assert "/no/%%s/such%%n" in instance.log[-1]


def test_bytes_that_are_no_state_are_refused(instance: Instance) -> None:
    instance.initialise()
    pointer = ctypes.c_void_p()
    instance.call("fmi2DeSerializeFMUstate", ctypes.create_string_buffer(b"abc", 3), 3, ctypes.byref(pointer))
    with pytest.raises(CallFailed, match="springs: not a state of this FMU"):
        instance.restore(pointer)


def test_an_unexpected_exception_comes_with_its_traceback(fmu: Fmu) -> None:
    from robomill.fmus.python.slave import slave_class

    slave = slave_class(demo.MODEL, "x")(instance_name="springs")
    slave._instance.data = None  # type: ignore[assignment]  # what must not happen
    slave._instance._functions = None
    with pytest.raises(Exception) as error:  # noqa: PT011  # its repr is looked at
        slave.exit_initialization_mode()
    assert "Traceback (most recent call last)" in repr(error.value)
    assert "springs: " in repr(error.value)


def test_many_instances_one_after_the_other(fmu: Fmu) -> None:
    """The library gives up a reference to the module's globals with each: a dozen used to end in 'module has no attribute'."""
    expected = None
    for _ in range(40):
        one = Instance(fmu)
        trajectory = [one.initialise(), one.step(0)]
        one.free()
        assert expected in (None, trajectory)
        expected = trajectory


def test_errors_do_not_upset_the_memory_of_the_process(fmu: Fmu) -> None:
    """The library drops references it does not have after an exception; the garbage collector would crash on that."""
    for _ in range(10):
        one = Instance(fmu)
        for _ in range(5):
            with pytest.raises(CallFailed):
                set_real(one, "x[1]", float("nan"))
        gc.collect()
        assert len(one.initialise()) == 6
        one.free()
        gc.collect()


def test_nothing_of_the_fmu_stays_on_the_path_of_the_process(fmu: Fmu) -> None:
    before = list(sys.path)
    instance = Instance(fmu)
    instance.initialise()
    assert not [p for p in sys.path if "resources" in p and p not in before]
    instance.free()


def test_two_versions_of_a_component_in_one_process_do_not_share_code(
    built: Built, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = Path(demo.__file__).read_text(encoding="utf-8").replace("GAIN = 2.0", "GAIN = 4.0")
    (tmp_path / "newer.py").write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    import newer  # type: ignore[import-not-found]  # written above

    old = Instance(Fmu(built("demo")))
    (tmp_path / "2").mkdir()
    monkeypatch.chdir(tmp_path / "2")
    new = Instance(Fmu(build(newer.MODEL, tmp_path / "newer.fmu")))
    row = [0.001, 0.001, 1.0, 0.0, 3.0]
    old.initialise(row)
    new.initialise(row)
    before, after = old.step(0, row)[4], new.step(0, row)[4]
    old.free()
    new.free()
    sys.modules.pop("newer")
    assert before > 0.0
    assert after == 2.0 * before


def in_a_fresh_process(file: Path, folder: Path, before: str = "", environment: dict[str, str] | None = None) -> dict[str, Any]:
    """Simulate an FMU with fmpy.simulate_fmu where nothing of this repository can be found."""
    script = folder / "run.py"
    script.write_text(
        f"""
import json, sys
sys.path = [p for p in sys.path if p != {str(ROOT)!r}]
{before}
import fmpy
folder = fmpy.extract(sys.argv[1])
result = fmpy.simulate_fmu(folder, stop_time=0.04, fmi_call_logger=None, debug_logging=True)
import importlib.util
assert not any(importlib.util.find_spec(n) for n in ("models", "fmus", "robomill"))
print("RESULT" + json.dumps({{"rows": result.tolist()}}))
""",
        encoding="utf-8",
    )
    command = [sys.executable, "-P", str(script), str(file)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env={**os.environ, **(environment or {})})
    assert done.returncode == 0, done.stderr
    line = next(x for x in done.stdout.splitlines() if "RESULT" in x)
    return {**json.loads(line.partition("RESULT")[2]), "log": done.stdout}


@pytest.mark.slow
def test_it_runs_outside_of_the_repository_and_compiles_the_first_time_only(built: Built, tmp_path: Path) -> None:
    cache = {"ROBOMILL_CACHE_DIR": str(tmp_path / "cache")}
    first = in_a_fresh_process(built("robot_compliance"), tmp_path, environment=cache)
    compiled = {f: f.stat().st_mtime_ns for f in (tmp_path / "cache").rglob("*.o")}
    second = in_a_fresh_process(built("robot_compliance"), tmp_path, environment=cache)
    assert first["rows"] == second["rows"]
    assert compiled
    assert {f: f.stat().st_mtime_ns for f in (tmp_path / "cache").rglob("*.o")} == compiled


@pytest.mark.slow
def test_without_numba_it_runs_and_says_so(built: Built, tmp_path: Path) -> None:
    with_numba = in_a_fresh_process(built("demo"), tmp_path)
    cache = {"ROBOMILL_CACHE_DIR": str(tmp_path / "cache")}  # with nothing in it
    without = in_a_fresh_process(built("demo"), tmp_path, before='sys.modules["numba"] = None', environment=cache)
    assert without["rows"] == with_numba["rows"]
    assert "Numba is not installed here; the model runs in plain Python" in without["log"]
    assert "Numba" not in with_numba["log"]


@pytest.mark.slow
def test_a_cache_that_cannot_be_used_is_a_warning(built: Built, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder", encoding="utf-8")
    expected = in_a_fresh_process(built("demo"), tmp_path)
    found = in_a_fresh_process(built("demo"), tmp_path, environment={"ROBOMILL_CACHE_DIR": str(tmp_path / "file")})
    assert found["rows"] == expected["rows"]
    assert "the cache folder cannot be used" in found["log"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the library's destructor is that of Linux")
def test_the_library_lets_go_of_the_interpreter_before_the_process_ends(built: Built, tmp_path: Path) -> None:
    watch = """
import atexit, ctypes, os
released = []
class Watched(ctypes.CDLL):
    def finalizePythonInterpreter(self):
        self["finalizePythonInterpreter"]()
        released.append(os.path.relpath(self._name, folder))
ctypes.CDLL = Watched
atexit.register(lambda: print("released:", released))
"""
    found = in_a_fresh_process(built("demo"), tmp_path, before=watch)
    assert "released: ['binaries/linux64/demo.so']" in found["log"]


@pytest.mark.slow
def test_an_edited_fmu_runs_its_own_code_not_the_cached_one(built: Built, tmp_path: Path) -> None:
    with zipfile.ZipFile(built("demo")) as old, zipfile.ZipFile(tmp_path / "edited.fmu", "w") as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, data.replace(b"s.curve_value = cell(", b"s.curve_value = 2.0 + cell(") if name.endswith("demo.py") else data)
    assert in_a_fresh_process(built("demo"), tmp_path)["rows"][0][4] == 7.0
    found = in_a_fresh_process(tmp_path / "edited.fmu", tmp_path)
    assert "holds other files than this FMU: tests/fmus/demo.py" in found["log"]
    assert found["rows"][0][4] == 9.0


def test_a_replay_fmu_gives_the_recorded_outputs_of_the_component_it_stands_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    model = COMPONENTS["path_interpolator"]
    slave = InProcessSlave(model)
    slave.initialise(0.0, 1.0, 0.004)
    rows = np.zeros((21, len(slave.interface.outputs)))
    slave.get_outputs(rows[0])
    for k in range(20):
        slave.step(k * 0.004, 0.004)
        slave.get_outputs(rows[k + 1])
    columns = {
        v: rows[:, s]
        for v, s in slave.interface.arrays.items()
        if slave.interface.outputs[s] and slave.interface.outputs[s][0].variable == v
    }
    columns = {n: c[:, 0] if c.shape[1] == 1 else c for n, c in columns.items()}
    fmu = Fmu(build(replay_model(model, 0.004 * np.arange(21), columns), tmp_path / "replay.fmu"))
    assert [v.name for v in fmu.outputs] == [p.name for p in slave.interface.outputs]
    assert [v.name for v in fmu.inputs] == [p.name for p in slave.interface.inputs]
    replay = Instance(fmu)
    found = [replay.initialise(), *(replay.step(k) for k in range(20))]
    assert found == rows.tolist()
    with pytest.raises(CallFailed, match=r"time 0\.084 s lies outside the recording, which goes from 0\.0 s to 0\.08 s"):
        replay.step(20, fmu.rows[0])
    replay.free()


def test_a_failed_run_is_no_short_run_for_fmpy(built: Built, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With fmi2Discard, fmpy.simulate_fmu would return the rows up to the error and say nothing."""
    monkeypatch.chdir(tmp_path)
    inputs = np.array([(0.0, 0.0), (0.02, 2.0), (0.04, 2.0)], dtype=[("time", float), ("x[1]", float)])
    assert len(fmpy.simulate_fmu(str(built("demo")), stop_time=0.04)) == 11
    with pytest.raises(FMICallException, match="fmi2DoStep failed with status 4"):
        fmpy.simulate_fmu(str(built("demo")), stop_time=0.04, input=inputs)
