"""Does an FMU do what FMI 2.0 and its own model description promise? For the FMUs of this project and for those of others.

    for result in check_fmu("component.fmu"):
        print(result.outcome, result.check, result.detail)

Everything that runs the FMU does so in a new process, outside of this repository, which may crash
or hang without harm. This file runs on its own there: standard library, NumPy and FMPy only.

Inputs are the start values, moved a little; or those of the FMU's reference results, if it carries
documentation/reference/in.csv and out.csv (first column t, then one column per variable; row k of
in.csv holds from t_k on, row k of out.csv are the outputs at t_k) and parameters.json (texts in it
are names of files beside it).
"""

from __future__ import annotations

import csv
import ctypes
import json
import math
import os
import subprocess
import sys
import tempfile
import traceback
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

Outcome = Literal["passed", "failed", "finding", "skipped"]
"""A finding is something that the standard allows and that one should know."""

STEPS = 20
STEP = 0.004
"""Communication step where the FMU does not name one [s]."""
TIMEOUT = 300.0
"""Time for one FMU, all checks together [s]."""
_RUNNABLE = "units and descriptions"
"""The first check of an FMU that can be run: of the right kind, with a description that can be read."""
_SHOWN_PROBLEMS = 3
_TYPES = ("Real", "Integer", "Boolean")
_LABELS = ("OK", "warning", "discard", "error", "fatal", "pending")


@dataclass(frozen=True)
class Result:
    """One check of one FMU."""

    check: str
    outcome: Outcome
    detail: str

    @property
    def passed(self) -> bool:
        """False if the FMU breaks a promise; findings and skipped checks do not count against it."""
        return self.outcome != "failed"


class _Skip(Exception):  # noqa: N818  # not an error
    """The check does not apply; the text says why."""


class _Finding(Exception):  # noqa: N818  # not an error
    """Allowed, but worth knowing."""


def check_fmu(file: str | Path, timeout: float = TIMEOUT) -> list[Result]:
    """All checks of one FMU, in order. Never raises for anything that is wrong with the FMU.

    `timeout` [s] is for the whole process that runs it. FileNotFoundError if there is no such file.
    """
    path = Path(file).resolve()
    if not path.is_file():
        raise FileNotFoundError(f"{file}: no such file")
    results = list(_static_checks(path))
    if not any(r.check == _RUNNABLE for r in results):
        return results
    with tempfile.TemporaryDirectory(prefix="robomill_check_", ignore_cleanup_errors=True) as folder:
        return results + _dynamic_checks(path, Path(folder), timeout)


# Checks that only read


def _static_checks(path: Path) -> Iterator[Result]:
    import fmpy
    from fmpy.validation import validate_fmu

    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            bad = archive.testzip()
    except (zipfile.BadZipFile, OSError) as error:
        yield Result("archive", "failed", f"not a readable zip archive: {error}")
        return
    unsafe = [n for n in names if n.startswith("/") or ".." in n.split("/") or "\\" in n or ":" in n]
    if bad or unsafe or "modelDescription.xml" not in names:
        problem = f"damaged entry {bad}" if bad else f"unsafe path {unsafe[0]}" if unsafe else "no modelDescription.xml in it"
        yield Result("archive", "failed", problem)
        return
    yield Result("archive", "passed", f"{len(names)} files, {path.stat().st_size} bytes")
    problems = validate_fmu(str(path))
    try:
        md = fmpy.read_model_description(str(path), validate=False)
    except Exception as error:  # FMPy raises whatever its parsing meets
        yield Result("model description", "failed", f"cannot be read: {error}")
        return
    if md.fmiVersion != "2.0" or md.coSimulation is None:
        kind = "co-simulation" if md.coSimulation is not None else "model exchange only"
        yield Result("model description", "failed", f"FMI {md.fmiVersion}, {kind}; FMI 2.0 co-simulation is needed")
        return
    if problems:
        # what follows does not need a description without fault, and says more about the FMU
        shown = "; ".join(problems[:_SHOWN_PROBLEMS]) + ("; ..." if len(problems) > _SHOWN_PROBLEMS else "")
        yield Result("model description", "failed", f"{len(problems)} problem{'s' * (len(problems) > 1)}: {shown}")
    else:
        yield Result("model description", "passed", f"{len(md.modelVariables)} variables, no problem found by FMPy")
    yield _documented(md)
    parts = {"documentation/index.html": "documentation", "model.png": "icon", "documentation/licenses/": "licence"}
    missing = [what for part, what in parts.items() if not any(n.startswith(part) for n in names)]
    yield Result(
        "contents", "finding" if missing else "passed", f"without {', '.join(missing)}" if missing else "documentation, icon, licence"
    )


def _documented(md: Any) -> Result:
    shown = [v for v in md.modelVariables if v.causality in ("input", "output", "parameter")]
    bare = [v.name for v in shown if not v.description]
    unitless = [v.name for v in shown if v.type == "Real" and not (v.unit or (v.declaredType and v.declaredType.unit))]
    lacks = [f"no {what} for {_some(names)}" for what, names in (("description", bare), ("unit", unitless)) if names]
    return Result(
        "units and descriptions", "finding" if lacks else "passed", "; ".join(lacks) or f"all {len(shown)} inputs, outputs, parameters"
    )


def _some(names: Sequence[str], limit: int = 4) -> str:
    return ", ".join(names[:limit]) + (f", ... ({len(names)} in all)" if len(names) > limit else "")


# Checks that run it: this side


def _dynamic_checks(path: Path, folder: Path, timeout: float) -> list[Result]:
    """Run `_child` in a process of its own and collect what it wrote, also if it did not come to its end."""
    report = folder / "report.jsonl"
    report.touch()
    work = folder / "work"
    work.mkdir()
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    output = folder / "output.txt"
    with output.open("wb") as stream:
        command = [sys.executable, "-P", str(Path(__file__).resolve()), str(path), str(report)]
        process = subprocess.Popen(command, cwd=work, env=environment, stdout=stream, stderr=subprocess.STDOUT)
        try:
            code = process.wait(timeout)
            end = f"the process ended with {code}" if code >= 0 else f"the process was killed by signal {-code}"
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            code, end = 1, f"no answer within {timeout:.0f} s"
    results: list[Result] = []
    begun = "start of the process"
    for line in report.read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        if "begun" in entry:
            begun = entry["begun"]
        else:
            results.append(Result(**entry))
    if code != 0:
        last = output.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-3:]
        results.append(Result(begun, "failed", "; ".join([end, *last])))
    return results


# The other side: the process that runs the FMU


class Fmu:
    """An unpacked FMU and what the checks need to know about it."""

    def __init__(self, path: Path) -> None:
        import fmpy

        self.folder = Path(fmpy.extract(str(path), unzipdir=str(Path("fmu").absolute())))
        self.md: Any = fmpy.read_model_description(str(self.folder), validate=False)
        self.name: str = self.md.modelName
        self.flags: Any = self.md.coSimulation
        self.inputs = [v for v in self.md.modelVariables if v.causality == "input" and v.type in _TYPES]
        self.outputs = [v for v in self.md.modelVariables if v.causality == "output" and v.type in _TYPES]
        self.parameters = [v for v in self.md.modelVariables if v.causality == "parameter"]
        default = self.md.defaultExperiment
        self.h = float(default.stepSize) if default is not None and default.stepSize else STEP
        self.start = float(default.startTime) if default is not None and default.startTime else 0.0
        self.parameter_values: dict[str, Any] = {}
        self.reference_rows: list[list[float]] = []
        self.rows = self._excitation()
        self.log: list[str] = []
        """Messages of all instances since the check began."""
        self.callbacks = self._callbacks()

    def _callbacks(self) -> Any:
        """One logger for all instances: FMPy's formatter of printf messages knows only one."""
        from fmpy import calloc, fmi2, free

        def message(_environment: Any, _instance: bytes, _status: int, _category: bytes, text: bytes) -> None:
            self.log.append((text or b"").decode("utf-8", "replace").strip())

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(message)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        if not (self.folder / "resources" / "slavemodule.txt").is_file():  # pythonfmu hands over finished texts
            fmi2.addLoggerProxy(ctypes.byref(callbacks))
        return callbacks

    def _excitation(self) -> list[list[float]]:
        """Inputs per step, in the order of `inputs`."""
        reference = self.folder / "documentation" / "reference"
        if (reference / "in.csv").is_file() and (reference / "out.csv").is_file():
            if (reference / "parameters.json").is_file():
                values = json.loads((reference / "parameters.json").read_text(encoding="utf-8"))
                self.parameter_values = {n: str(reference / v) if isinstance(v, str) else v for n, v in values.items()}
            self.reference_rows = _columns(reference / "out.csv", [v.name for v in self.outputs])
            return _columns(reference / "in.csv", [v.name for v in self.inputs])
        return [self.moved(k) for k in range(STEPS)]

    def moved(self, k: int, phase: float = 0.0) -> list[float]:
        """Start values of the inputs; reals moved by at most 0.1 % (0.0001 around zero), the others kept."""
        row = []
        for i, v in enumerate(self.inputs):
            value = _start(v)
            if v.type == "Real":
                value += (abs(value) or 0.1) * 1e-3 * math.sin(0.3 * k + i + phase)
                value = min(max(value, float(v.min or -math.inf)), float(v.max or math.inf))
            row.append(value)
        return row


def _start(v: Any) -> float:
    if v.start is None:
        return 0.0
    return {"true": 1.0, "false": 0.0}[v.start] if v.start in ("true", "false") else float(v.start)


def _columns(file: Path, names: Sequence[str]) -> list[list[float]]:
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.reader(stream))
    missing = [n for n in names if n not in rows[0]]
    if missing:
        raise ValueError(f"{file.name}: no column {_some(missing)}")
    positions = [rows[0].index(n) for n in names]
    return [[float(row[i]) for i in positions] for row in rows[1:]]


class CallFailed(Exception):  # noqa: N818  # its text says what failed
    """An FMI call that did not return OK or warning."""


class Instance:
    """One instance of the FMU; raw calls, every status looked at, its log kept."""

    def __init__(self, fmu: Fmu, name: str = "instance") -> None:
        from fmpy import fmi2

        self.fmu, self.log = fmu, fmu.log
        self.slave = fmi2.FMU2Slave(
            guid=fmu.md.guid, unzipDirectory=str(fmu.folder), modelIdentifier=fmu.flags.modelIdentifier, instanceName=name
        )
        try:
            self.slave.instantiate(callbacks=fmu.callbacks, loggingOn=True)
        except Exception as error:
            raise CallFailed(f"fmi2Instantiate: {error} {self.logged()}") from None

    def logged(self) -> str:
        """What it logged, in one line."""
        return " | ".join(" ".join(text.split()) for text in self.log[-3:]) or "(nothing logged)"

    def call(self, function: str, *arguments: Any) -> None:
        """An FMI function of this instance. `CallFailed` unless it returns OK or warning."""
        status = self.slave._functions[function](self.slave.component, *arguments)
        if status > 1:
            label = _LABELS[status] if 0 <= status < len(_LABELS) else str(status)
            raise CallFailed(f"{function} returned {label}: {self.logged()}")

    def set(self, variables: Sequence[Any], values: Sequence[Any]) -> None:
        """Set variables, one call per type."""
        for kind, c_type in (("Real", ctypes.c_double), ("Integer", ctypes.c_int), ("Boolean", ctypes.c_int), ("String", ctypes.c_char_p)):
            chosen = [
                (v.valueReference, x) for v, x in zip(variables, values, strict=True) if (v.type if v.type in _TYPES else "String") == kind
            ]
            if chosen:
                as_c: Callable[[Any], Any] = float if kind == "Real" else _encoded if kind == "String" else int
                references = (ctypes.c_uint * len(chosen))(*(r for r, _ in chosen))
                self.call(f"fmi2Set{kind}", references, len(chosen), (c_type * len(chosen))(*(as_c(x) for _, x in chosen)))

    def get(self) -> list[float]:
        """All outputs, in the order of the model description."""
        values: dict[str, float] = {}
        for kind, c_type in (("Real", ctypes.c_double), ("Integer", ctypes.c_int), ("Boolean", ctypes.c_int)):
            chosen = [v for v in self.fmu.outputs if v.type == kind]
            if chosen:
                references = (ctypes.c_uint * len(chosen))(*(v.valueReference for v in chosen))
                buffer: Any = (c_type * len(chosen))()
                self.call(f"fmi2Get{kind}", references, len(chosen), buffer)
                values |= {v.name: float(x) for v, x in zip(chosen, buffer, strict=True)}
        return [values[v.name] for v in self.fmu.outputs]

    def configure(self) -> None:
        """Set the parameters of the reference results."""
        known = {v.name: v for v in self.fmu.parameters}
        for name, value in self.fmu.parameter_values.items():
            self.set([known[name]], [value])

    def initialise(self, row: Sequence[float] | None = None) -> list[float]:
        """From instantiated to stepping; outputs at the start."""
        self.configure()
        self.call("fmi2SetupExperiment", 0, 0.0, self.fmu.start, 0, 0.0)
        self.call("fmi2EnterInitializationMode")
        self.set(self.fmu.inputs, self.fmu.rows[0] if row is None else row)
        outputs = self.get()
        self.call("fmi2ExitInitializationMode")
        return outputs

    def step(self, k: int, row: Sequence[float] | None = None) -> list[float]:
        """Step number k; outputs after it."""
        self.set(self.fmu.inputs, self.fmu.rows[k] if row is None else row)
        self.call("fmi2DoStep", ctypes.c_double(self.fmu.start + k * self.fmu.h), ctypes.c_double(self.fmu.h), 1)
        return self.get()

    def run(self) -> list[list[float]]:
        """Initialise and take all steps; outputs at all times."""
        return [self.initialise(), *(self.step(k) for k in range(len(self.fmu.rows)))]

    def state(self) -> Any:
        """A copy of its state."""
        pointer = ctypes.c_void_p()
        self.call("fmi2GetFMUstate", ctypes.byref(pointer))
        return pointer

    def restore(self, pointer: Any) -> None:
        """Back to that state."""
        self.call("fmi2SetFMUstate", pointer)

    def free(self) -> None:
        """Free it; its library stays loaded (FMPy would unload it under other instances)."""
        self.slave.fmi2FreeInstance(self.slave.component)


def _encoded(text: Any) -> bytes:
    return str(text).encode()


def _same(fmu: Fmu, what: str, expected: Sequence[Sequence[float]], found: Sequence[Sequence[float]], first: int = 0) -> None:
    """Bitwise equal trajectories, NaN equal to NaN; AssertionError names variable, step and both values."""
    for k, (a, b) in enumerate(zip(expected, found, strict=True)):
        for v, x, y in zip(fmu.outputs, a, b, strict=True):
            if x != y and not (math.isnan(x) and math.isnan(y)):
                raise AssertionError(f"{what}: {v.name} differs first at step {first + k}: {x!r} and {y!r} (difference {y - x:.3g})")


def _run(fmu: Fmu) -> str:
    instance = Instance(fmu)
    trajectory = instance.run()
    for k, row in enumerate(trajectory):
        for v, x in zip(fmu.outputs, row, strict=True):
            if not math.isfinite(x):
                raise AssertionError(f"output {v.name} is {x} after step {k}")
    instance.call("fmi2Terminate")
    instance.free()
    fmu.trajectory = trajectory  # type: ignore[attr-defined]  # what the other checks compare with
    return f"{len(fmu.rows)} steps of {fmu.h} s in {Path.cwd()}"


def _repeat(fmu: Fmu) -> str:
    instance = Instance(fmu)
    _same(fmu, "first and second run", _expected(fmu), instance.run())
    instance.free()
    return "bitwise equal"


def _expected(fmu: Fmu) -> list[list[float]]:
    found: list[list[float]] | None = getattr(fmu, "trajectory", None)
    if found is None:
        raise _Skip("the first run failed")
    return found


def _two_instances(fmu: Fmu) -> str:
    if fmu.flags.canBeInstantiatedOnlyOncePerProcess:
        raise _Skip("canBeInstantiatedOnlyOncePerProcess is true")
    expected = _expected(fmu)
    one, other = Instance(fmu, "one"), Instance(fmu, "other")
    found = [one.initialise()]
    other.initialise(fmu.moved(0, 1.0))
    for k in range(len(fmu.rows)):
        found.append(one.step(k))
        if k % 2:
            other.step(k // 2, fmu.moved(k, 1.0))
    other.free()
    one.free()
    _same(fmu, "alone and beside another instance with other inputs", expected, found)
    return "bitwise the same as alone"


def _reset(fmu: Fmu) -> str:
    expected = _expected(fmu)
    instance = Instance(fmu)
    instance.initialise()
    for k in range(min(5, len(fmu.rows))):
        instance.step(k)
    instance.call("fmi2Reset")
    _same(fmu, "fresh and after fmi2Reset", expected, instance.run())
    instance.free()
    return "bitwise as fresh"


def _state(fmu: Fmu) -> str:
    if not fmu.flags.canGetAndSetFMUstate:
        raise _Skip("canGetAndSetFMUstate is false")
    expected = _expected(fmu)
    split = len(fmu.rows) // 3
    instance = Instance(fmu)
    instance.initialise()
    for k in range(split):
        instance.step(k)
    saved = instance.state()
    for times in ("first", "second"):
        found = [instance.step(k) for k in range(split, len(fmu.rows))]
        _same(fmu, f"steps before and after the {times} return to a state", expected[split + 1 :], found, split + 1)
        instance.restore(saved)
    instance.call("fmi2FreeFMUstate", ctypes.byref(saved))
    instance.free()
    return f"returned to the state after step {split} twice, bitwise equal"


def _serialised(fmu: Fmu) -> str:
    if not fmu.flags.canSerializeFMUstate:
        raise _Skip("canSerializeFMUstate is false")
    expected = _expected(fmu)
    split = len(fmu.rows) // 2
    instance = Instance(fmu)
    instance.initialise()
    for k in range(split):
        instance.step(k)
    saved = instance.state()
    size = ctypes.c_size_t()
    instance.call("fmi2SerializedFMUstateSize", saved, ctypes.byref(size))
    data = ctypes.create_string_buffer(size.value)
    instance.call("fmi2SerializeFMUstate", saved, data, size)
    instance.call("fmi2FreeFMUstate", ctypes.byref(saved))
    instance.free()
    fresh = Instance(fmu, "fresh")
    fresh.initialise(fmu.moved(0, 2.0))
    pointer = ctypes.c_void_p()
    fresh.call("fmi2DeSerializeFMUstate", data, size, ctypes.byref(pointer))
    fresh.restore(pointer)
    found = [fresh.step(k) for k in range(split, len(fmu.rows))]
    _same(fmu, "the same instance and another one from its serialised state", expected[split + 1 :], found, split + 1)
    fresh.call("fmi2FreeFMUstate", ctypes.byref(pointer))
    fresh.free()
    return f"{size.value} bytes, carried over to another instance, bitwise equal"


def _dependencies(fmu: Fmu) -> str:
    declared = {u.variable.name: u.dependencies for u in fmu.md.outputs}
    if all(declared.get(v.name) is None for v in fmu.outputs):
        raise _Finding("no output declares its dependencies; importers must assume that it follows every input at once")
    if not fmu.flags.canGetAndSetFMUstate:
        raise _Skip("needs canGetAndSetFMUstate")
    k = 6 * len(fmu.rows) // 10
    instance, saved = _advanced(fmu, k)
    base = instance.step(k)
    followed, late = 0, ""
    for i, moved in enumerate(fmu.inputs):
        for change in (1e-3, -2e-2):
            row = list(fmu.rows[k])
            row[i] = _moved(moved, row[i], change)
            try:
                instance.restore(saved)
                instance.step(k)
                instance.set([moved], [row[i]])
                without_step = instance.get()
                instance.restore(saved)
                with_step = instance.step(k, row)
            except CallFailed:  # an input that cannot be moved alone; after an error nothing more may be asked of the instance
                instance, saved = _advanced(fmu, k)
                continue
            for v, x, y, z in zip(fmu.outputs, base, without_step, with_step, strict=True):
                names = declared.get(v.name)
                known = names is None or moved.name in {d.name for d in names}
                followed += x != z
                declares = f"it declares {_some([d.name for d in names or ()]) or 'none'}"
                if x != y and not known:
                    raise AssertionError(f"output {v.name} follows input {moved.name} at once, without a step; {declares}")
                if x != z and not known:
                    late = late or f"output {v.name} follows input {moved.name} within the step, {declares}"
    instance.restore(saved)
    instance.call("fmi2FreeFMUstate", ctypes.byref(saved))
    instance.free()
    if late:
        raise _Finding(f"{late}: right for an integrator; a master that sorts by dependencies may pass the value one step late")
    if not followed:
        raise _Skip(f"no input that was moved in step {k} changed an output in that step")
    return f"{followed} changes of outputs by moved inputs in step {k}, all declared"


def _advanced(fmu: Fmu, k: int) -> tuple[Instance, Any]:
    """An instance before step k and its state there."""
    instance = Instance(fmu)
    instance.initialise()
    for earlier in range(k):
        instance.step(earlier)
    return instance, instance.state()


def _moved(v: Any, value: float, change: float) -> float:
    if v.type == "Real":
        return value + change * (abs(value) or 1.0)
    return 1.0 - value if v.type == "Boolean" else value + 1


def _nan_input(fmu: Fmu) -> str:
    reals = [v for v in fmu.inputs if v.type == "Real"]
    if not reals:
        raise _Skip("no Real input")
    instance = Instance(fmu)
    instance.initialise()
    instance.step(0)
    instance.log.clear()
    try:
        instance.set(reals[:1], [math.nan])
        instance.call("fmi2DoStep", ctypes.c_double(fmu.start + fmu.h), ctypes.c_double(fmu.h), 1)
    except CallFailed as error:
        text = str(error)
    else:
        raise _Finding(f"NaN for input {reals[0].name} passes without an error")
    return _refused(fmu, instance, text, reals[0].name)


def _refused(fmu: Fmu, instance: Instance, text: str, name: str) -> str:
    """After an error: its text names the variable, the instance can be freed and another one works."""
    if not any(instance.log):
        raise AssertionError(f"an error, but no text: {text}")
    if name not in text:
        raise _Finding(f"refused with a text that does not name {name}: {text}")
    instance.free()
    after = Instance(fmu, "after")
    _same(fmu, "before and after an error in another instance", _expected(fmu)[:2], [after.initialise(), after.step(0)])
    after.free()
    return text


def _bad_parameter(fmu: Fmu) -> str:
    bounded = [v for v in fmu.parameters if v.type in ("Real", "Integer") and (v.min is not None or v.max is not None)]
    if not bounded:
        raise _Skip("no parameter has a min or max")
    chosen = bounded[0]
    value = float(chosen.min) - 1.0 - abs(float(chosen.min)) if chosen.min is not None else float(chosen.max) + 1.0 + abs(float(chosen.max))
    instance = Instance(fmu)
    try:
        instance.set([chosen], [value])
        instance.initialise()
        instance.step(0)
    except CallFailed as error:
        text = str(error)
    else:
        raise _Finding(f"parameter {chosen.name} = {value:g} is outside of [{chosen.min}, {chosen.max}] and passes without an error")
    return _refused(fmu, instance, text, chosen.name)


def _other_step(fmu: Fmu) -> str:
    instance = Instance(fmu)
    instance.initialise()
    h = 0.75 * fmu.h
    declared = "true" if fmu.flags.canHandleVariableCommunicationStepSize else "false"
    rule = f"canHandleVariableCommunicationStepSize is {declared}"
    try:
        instance.set(fmu.inputs, fmu.rows[0])
        instance.call("fmi2DoStep", ctypes.c_double(fmu.start), ctypes.c_double(h), 1)
    except CallFailed as error:
        if fmu.flags.canHandleVariableCommunicationStepSize:
            raise AssertionError(f"{rule}, but a step of {h:g} s fails: {error}") from None
        if not any(instance.log):
            raise AssertionError(f"a step of {h:g} s is refused without a text: {error}") from None
        return f"{rule}; a step of {h:g} s is refused: {error}"
    instance.free()
    if not fmu.flags.canHandleVariableCommunicationStepSize:
        raise _Finding(f"{rule}, but a step of {h:g} s instead of {fmu.h:g} s passes without an error")
    return f"{rule}; a step of {h:g} s is taken"


def _reference(fmu: Fmu) -> str:
    if not fmu.reference_rows:
        raise _Skip("it carries no documentation/reference/in.csv and out.csv")
    _same(fmu, "reference results (documentation/reference/out.csv) and this run", fmu.reference_rows, _expected(fmu))
    return f"{len(fmu.reference_rows)} rows of {len(fmu.outputs)} outputs, bitwise equal"


CHECKS: Mapping[str, Callable[[Fmu], str]] = {
    "runs in a fresh process": _run,
    "repeated run": _repeat,
    "two instances": _two_instances,
    "reset": _reset,
    "state": _state,
    "serialised state": _serialised,
    "dependencies": _dependencies,
    "input that is NaN": _nan_input,
    "parameter out of range": _bad_parameter,
    "other step size": _other_step,
    "reference results": _reference,
}


def _child(path: Path, report: Path) -> None:
    """Run all checks and write a line when one begins and one with its result."""
    with report.open("w", encoding="utf-8", buffering=1) as stream:
        stream.write(json.dumps({"begun": "unpacking"}) + "\n")
        fmu = Fmu(path)
        for name, check in CHECKS.items():
            stream.write(json.dumps({"begun": name}) + "\n")
            outcome: Outcome = "passed"
            fmu.log.clear()
            try:
                detail = check(fmu)
            except _Skip as reason:
                outcome, detail = "skipped", str(reason)
            except _Finding as finding:
                outcome, detail = "finding", str(finding)
            except (CallFailed, AssertionError) as error:
                outcome, detail = "failed", str(error)
            except Exception:
                outcome, detail = "failed", traceback.format_exc()
            stream.write(json.dumps(asdict(Result(name, outcome, detail))) + "\n")


if __name__ == "__main__":
    _home = Path(__file__).resolve().parents[1]  # nothing of this project may be found, unless it is installed
    sys.path = [p for p in sys.path if p and (Path(p).resolve() != _home or _home.name.endswith("-packages"))]
    _child(Path(sys.argv[1]), Path(sys.argv[2]))
    os._exit(0)  # whatever the libraries of the FMU do at the end is not of interest
