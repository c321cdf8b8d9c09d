"""The checks that run the FMU, in order, and the process that they run in. What they call is the same for every version of FMI."""

from __future__ import annotations

import ctypes
import json
import math
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from .calls import CallFailed
from .instance import Element, Fmu, Instance, OnlyOnce, some

_UNTOUCHED = 0xA5
"""Byte in memory that nobody wrote to."""

Outcome = Literal["passed", "failed", "finding", "skipped"]
"""A finding is something that the standard allows and that one should know."""


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


def _same(fmu: Fmu, what: str, expected: Sequence[Sequence[float]], found: Sequence[Sequence[float]], first: int = 0) -> None:
    """Bitwise equal trajectories, NaN equal to NaN; AssertionError names variable, step and both values."""
    for k, (a, b) in enumerate(zip(expected, found, strict=True)):
        for v, x, y in zip(fmu.outputs, a, b, strict=True):
            if x != y and not (math.isnan(x) and math.isnan(y)):
                raise AssertionError(f"{what}: {v.name} differs first at step {first + k}: {x!r} and {y!r} (difference {y - x:.3g})")


def _exports(fmu: Fmu) -> str:
    missing = fmu.calls.missing()
    if missing:
        raise AssertionError(f"the library does not export {some(missing)}")
    version = fmu.calls.version()
    if _without_patch(version) != _without_patch(fmu.md.fmiVersion):
        raise AssertionError(f"{fmu.calls.prefix}GetVersion says {version!r}, the model description {fmu.md.fmiVersion!r}")
    return f"{len(fmu.calls.functions)} functions of FMI {version}"


def _without_patch(version: str) -> str:
    """3.0.2 -> 3.0: the patch release is of no meaning, and need not be the same in both places."""
    return ".".join(version.split(".")[:2])


def _run(fmu: Fmu) -> str:
    instance = Instance(fmu)
    trajectory = instance.run()
    for k, row in enumerate(trajectory):
        for v, x in zip(fmu.outputs, row, strict=True):
            if not math.isfinite(x):
                raise AssertionError(f"output {v.name} is {x} after step {k}")
    instance.terminate()
    instance.free()
    fmu.trajectory = trajectory
    if fmu.calls.remark:
        raise _Finding(fmu.calls.remark)
    return f"{len(fmu.rows)} steps of {fmu.h} s in {Path.cwd()}"


def _repeat(fmu: Fmu) -> str:
    instance = Instance(fmu)
    _same(fmu, "first and second run", _expected(fmu), instance.run())
    instance.free()
    return "bitwise equal"


def _expected(fmu: Fmu) -> list[list[float]]:
    if fmu.trajectory is None:
        raise _Skip("the first run failed")
    return fmu.trajectory


def _two_instances(fmu: Fmu) -> str:
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
    instance.reset()
    _same(fmu, f"fresh and after {fmu.calls.prefix}Reset", expected, instance.run())
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
    instance.forget(saved)
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
    data = instance.serialise(saved)
    instance.forget(saved)
    instance.free()
    fresh = Instance(fmu, "fresh")
    fresh.initialise(fmu.moved(0, 2.0))
    restored = fresh.deserialise(data)
    fresh.restore(restored)
    found = [fresh.step(k) for k in range(split, len(fmu.rows))]
    _same(fmu, "the same instance and another one from its serialised state", expected[split + 1 :], found, split + 1)
    fresh.forget(restored)
    fresh.free()
    return f"{len(data)} bytes, carried over to another instance, bitwise equal"


def _dependencies(fmu: Fmu) -> str:
    declared = {u.variable.name: u.dependencies for u in fmu.md.outputs}
    if all(declared.get(e.variable.name) is None for e in fmu.outputs):
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
            for e, x, y, z in zip(fmu.outputs, base, without_step, with_step, strict=True):
                names = declared.get(e.variable.name)
                known = names is None or moved.variable.name in {d.name for d in names}
                followed += x != z
                declares = f"it declares {some([d.name for d in names or ()]) or 'none'}"
                if x != y and not known:
                    raise AssertionError(f"output {e.name} follows input {moved.name} at once, without a step; {declares}")
                if x != z and not known:
                    late = late or f"output {e.name} follows input {moved.name} within the step, {declares}"
    instance.restore(saved)
    instance.forget(saved)
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


def _moved(e: Element, value: float, change: float) -> float:
    if e.variable.type.kind == "real":
        return value + change * (abs(value) or 1.0)
    return 1.0 - value if e.variable.type.kind == "boolean" else value + 1


def _arrays(fmu: Fmu) -> str:
    """An array is one variable: it starts as described, in C order, and can be moved alone or together with others."""
    expected = _expected(fmu)
    arrays = list(dict.fromkeys(e.variable for e in (*fmu.inputs, *fmu.outputs, *fmu.parameters) if e.variable.is_array))
    if not arrays:
        raise _Skip("it has no arrays")
    one = Instance(fmu)
    described = [e for e in (*fmu.inputs, *fmu.parameters) if e.variable.is_array]
    for e, x in zip(described, one.read(described), strict=True):
        if x != e.start:
            raise AssertionError(f"{e.name} is {x!r} in a new instance, its start value is {e.start!r}")
    one.enter()
    _set_singly(one, fmu.rows[0])
    one.leave()
    found = [_read_singly(one)]
    for k, row in enumerate(fmu.rows):
        _set_singly(one, row)
        one.advance(k)
        found.append(_read_singly(one))
    one.free()
    _same(fmu, "all variables of a type in one call and each in a call of its own", expected, found)
    return f"{len(arrays)} arrays: start values in order; bitwise the same alone and together"


def _set_singly(instance: Instance, row: Sequence[float]) -> None:
    """All inputs, a call for each variable, the last one first."""
    values = dict(zip(instance.fmu.inputs, row, strict=True))
    for v in reversed(dict.fromkeys(e.variable for e in values)):
        instance.set(v.elements, [values[e] for e in v.elements])


def _read_singly(instance: Instance) -> list[float]:
    """All outputs in their order, a call for each variable, the last one first."""
    values: dict[Element, float] = {}
    for v in reversed(dict.fromkeys(e.variable for e in instance.fmu.outputs)):
        values |= zip(v.elements, instance.read(v.elements), strict=True)
    return [values[e] for e in instance.fmu.outputs]


def _step_too_early(instance: Instance) -> None:
    instance.enter()
    instance.advance(0)


def _unknown_reference(instance: Instance) -> None:
    instance.initialise()
    of_type = instance.fmu.outputs[0].variable.type
    unknown = max(int(v.valueReference) for v in instance.fmu.md.modelVariables) + 1_000_000
    instance.access("Get", of_type, [unknown], (of_type.c * 1)())


def _too_little_room(instance: Instance) -> None:
    """Read an array into room for one value less. AssertionError if the value after that is written."""
    instance.initialise()
    v = next(e.variable for e in instance.fmu.outputs if e.variable.is_array)
    buffer = (v.type.c * len(v.elements))()
    ctypes.memset(buffer, _UNTOUCHED, ctypes.sizeof(buffer))
    untouched = bytes(buffer)[-ctypes.sizeof(v.type.c) :]
    try:
        instance.access("Get", v.type, [v.reference], buffer, room=len(buffer) - 1)
    finally:
        if bytes(buffer)[-len(untouched) :] != untouched:
            raise AssertionError(f"{len(buffer)} values of {v.name} are written where there is room for {len(buffer) - 1}")


def _wrong_calls(fmu: Fmu) -> str:
    """An importer's mistakes: they give an error with a text, a reset helps, and neither the process nor other instances suffer."""
    expected = _expected(fmu)
    mistakes: dict[str, Callable[[Instance], None]] = {"a step before the end of initialisation": _step_too_early}
    if fmu.outputs:
        mistakes["a value reference that does not exist"] = _unknown_reference
    if any(e.variable.is_array for e in fmu.outputs):
        mistakes["too little room for an array"] = _too_little_room
    passing: list[str] = []
    silent: list[str] = []
    for what, mistake in mistakes.items():
        instance = Instance(fmu)
        instance.log.clear()
        try:
            mistake(instance)
            passing.append(what)
        except CallFailed as error:
            if not any(instance.log):
                silent.append(what)
            if not error.fatal:
                instance.reset()
                _same(fmu, f"fresh and after {what}, an error and a reset", expected[:2], [instance.initialise(), instance.step(0)])
        instance.free()
    after = Instance(fmu, "after")
    _same(fmu, "before and after wrong calls in other instances", expected[:2], [after.initialise(), after.step(0)])
    after.free()
    lacks = [f"{text}: {', '.join(found)}" for text, found in (("no error", passing), ("an error without a text", silent)) if found]
    if lacks:
        raise _Finding("; ".join(lacks))
    return f"refused with a text: {', '.join(mistakes)}"


def _nan_input(fmu: Fmu) -> str:
    reals = [e for e in fmu.inputs if e.variable.type.kind == "real"]
    if not reals:
        raise _Skip("no real input")
    instance = Instance(fmu)
    instance.initialise()
    instance.step(0)
    instance.log.clear()
    try:
        instance.set(reals[:1], [math.nan])
        instance.advance(1)
    except CallFailed as error:
        text = str(error)
    else:
        raise _Finding(f"NaN for input {reals[0].name} passes without an error")
    return _refused(fmu, instance, text, reals[0].variable.name)


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
    numbers = [e for e in fmu.parameters if e.variable.type.kind in ("real", "integer")]
    bounded = [e for e in numbers if math.isfinite(e.variable.minimum) or math.isfinite(e.variable.maximum)]
    if not bounded:
        raise _Skip("no parameter has a min or max")
    chosen = bounded[0]
    low, high = chosen.variable.minimum, chosen.variable.maximum
    value = low - 1.0 - abs(low) if math.isfinite(low) else high + 1.0 + abs(high)
    instance = Instance(fmu)
    try:
        instance.set([chosen], [value])
        instance.initialise()
        instance.step(0)
    except CallFailed as error:
        text = str(error)
    else:
        raise _Finding(f"parameter {chosen.name} = {value:g} is outside of [{low:g}, {high:g}] and passes without an error")
    return _refused(fmu, instance, text, chosen.variable.name)


def _other_step(fmu: Fmu) -> str:
    instance = Instance(fmu)
    instance.initialise()
    h = 0.75 * fmu.h
    declared = "true" if fmu.flags.canHandleVariableCommunicationStepSize else "false"
    rule = f"canHandleVariableCommunicationStepSize is {declared}"
    try:
        instance.set(fmu.inputs, fmu.rows[0])
        instance.advance(0, h)
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
    "exports": _exports,
    "runs in a fresh process": _run,
    "repeated run": _repeat,
    "two instances": _two_instances,
    "reset": _reset,
    "state": _state,
    "serialised state": _serialised,
    "arrays": _arrays,
    "dependencies": _dependencies,
    "wrong calls": _wrong_calls,
    "input that is NaN": _nan_input,
    "parameter out of range": _bad_parameter,
    "other step size": _other_step,
    "reference results": _reference,
}


def run(path: Path, report: Path, names: Sequence[str] = ()) -> None:
    """Run all checks, or those named, and write a line when one begins and one with its result.

    The trajectory of the first run is kept beside the report, for checks in later processes.
    """
    kept = report.with_name("trajectory.json")
    with report.open("w", encoding="utf-8", buffering=1) as stream:

        def finish(check: str, outcome: Outcome, detail: str) -> None:
            stream.write(json.dumps(asdict(Result(check, outcome, detail))) + "\n")

        stream.write(json.dumps({"begun": "unpacking"}) + "\n")
        try:
            fmu = Fmu(path)
        except CallFailed as error:
            finish("unpacking", "failed", str(error))
            return
        if kept.is_file():
            fmu.trajectory = json.loads(kept.read_text(encoding="utf-8"))
        for name in names or CHECKS:
            stream.write(json.dumps({"begun": name}) + "\n")
            fmu.log.clear()
            try:
                finish(name, "passed", CHECKS[name](fmu))
            except (_Skip, OnlyOnce) as reason:
                finish(name, "skipped", str(reason))
            except _Finding as finding:
                finish(name, "finding", str(finding))
            except (CallFailed, AssertionError) as error:
                finish(name, "failed", str(error))
            except Exception:
                finish(name, "failed", traceback.format_exc())
            if fmu.trajectory is not None and not kept.is_file():
                kept.write_text(json.dumps(fmu.trajectory), encoding="utf-8")
