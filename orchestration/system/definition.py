"""A system as data: components, connections, parameters, what to record; loaded from `system.toml`.

::

    name = "groove"
    step = "4 ms"
    algorithm = "gauss-seidel"          # or "jacobi", or "iterated" (settings in [iteration])

    [components.drive]
    source = "robot_drive"              # in process, or "dist/robot_drive.fmu", or "replay:runs/42"
    parameters = {backlash = "20 urad", "stiffness_scale[2]" = 0.9}
    inputs = {m_T_B = ["2 N.m", 0, 0]}  # start values of inputs, which open inputs keep
    isolate = false                     # true: an FMU in its own process (orchestration/slaves/isolation.py)
    time_limit = "60 s"                 # of wall clock for one call, if isolated
    rate = 1                            # steps in each step of the system; or every = n: one step in n (orchestration/slaves/multirate.py)

    [[connections]]
    from = "drive.q_link"
    to = "compliance.q_link"
    delayed = false

    [recording]
    columns = ["drive", "compliance.p_BT_B", "sensor.f_T_T[1]"]
    checkpoint_every = 1000             # steps; 0 = never (orchestration/runs/checkpoint.py)
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from robomill.orchestration.errors import SystemFileError, unknown
from robomill.orchestration.loop.acceleration import DEFAULT, Iteration
from robomill.orchestration.system.parameters import Convert, quantity, same_unit_only
from robomill.orchestration.system.toml_file import TomlFile
from robomill.orchestration.system.written import merged, place_of

ALGORITHMS = ("jacobi", "gauss-seidel", "iterated")
LOOPS = ("auto", "compiled", "python")
TICK = 1_000_000_000
"""Ticks per second: time is counted in whole nanoseconds."""

_TOP = {
    "name": str,
    "description": str,
    "step": (int, float, str),
    "stop": (int, float, str),
    "stop_when": str,
    "algorithm": str,
    "require_connected": bool,
    "check_ranges": bool,
    "labels": dict,
    "components": dict,
    "connections": list,
    "recording": dict,
    "iteration": dict,
    "loop": str,
}
_COMPONENT = {
    "source": str,
    "parameters": dict,
    "inputs": dict,
    "isolate": bool,
    "time_limit": (int, float, str),
    "rate": int,
    "every": int,
}
_CONNECTION = {"from": str, "to": str, "delayed": bool}
_RECORDING = {"columns": list, "every": int, "csv": bool, "chunk": int, "checkpoint_every": int}
_ITERATION = {
    "method": str,
    "tolerance": (int, float),
    "max_iterations": int,
    "relaxation": (int, float),
    "depth": int,
    "hold": str,
    "unconverged": str,
}
MAX_CHUNK = 100_000
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True)
class Component:
    """One component: where it comes from and its parameters as written (not yet checked against its ports)."""

    name: str
    source: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    line: int | None = None
    isolate: bool = False
    """Whether it (an FMU) runs in its own process."""
    time_limit: float = 60.0
    """Wall clock that one call may take if it is isolated [s]."""
    rate: int = 1
    """Steps that it makes in each step of the system (see `orchestration.slaves.multirate`)."""
    every: int = 1
    """Steps of the system for each of which it makes one, over all of them."""
    inputs: Mapping[str, Any] = field(default_factory=dict)
    """Start values of inputs, as written: what open ones keep, and delayed ones have until the first step."""


@dataclass(frozen=True)
class Connection:
    """From an output to an input, `component.port` each: whole arrays, elements or scalars.

    `delayed` says that the input sees the output of the last step, which breaks a loop.
    """

    source: str
    target: str
    delayed: bool = False
    line: int | None = None

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


@dataclass(frozen=True)
class Recording:
    """What is written: `columns` are patterns on `component.port` (`*` = anything; a component or array stands for all its elements)."""

    columns: tuple[str, ...] = ("*",)
    every: int = 1
    """Each how many steps a row is written."""
    csv: bool = False
    chunk: int = 250
    """Rows that are kept in memory before they go to disk."""
    checkpoint_every: int = 0
    """Each how many steps everything is saved from which the run can go on; 0 = never."""


@dataclass(frozen=True)
class System:
    """Everything that a run is made of, except where its results go."""

    name: str
    step: float
    """Communication step [s], a whole number of nanoseconds."""
    components: tuple[Component, ...]
    connections: tuple[Connection, ...] = ()
    algorithm: str = "gauss-seidel"
    stop: float | None = None
    """End of the run [s]."""
    stop_when: str | None = None
    """An output (`path.finished`) that ends the run when it is not zero."""
    recording: Recording = Recording()
    labels: Mapping[str, Any] = field(default_factory=dict)
    """Program, robot, tool, workpiece, condition, repeat, held_out ...: copied to run.toml."""
    description: str = ""
    require_connected: bool = False
    """Whether an open input is an error."""
    check_ranges: bool = True
    """Whether an output outside its declared minimum and maximum ends the run."""
    iteration: Iteration = DEFAULT
    """How loops are iterated, with algorithm "iterated"."""
    loop: str = "auto"
    """How the master runs: `compiled`, `python`, or `auto`, compiled where that is possible; the numbers are the same."""
    file: Path | None = None

    def __post_init__(self) -> None:
        """Check what does not need the components' ports. SystemFileError says what is wrong."""
        ticks(self.step, "step")
        if self.algorithm not in ALGORITHMS:
            raise SystemFileError(unknown("algorithm", self.algorithm, ALGORITHMS))
        if self.loop not in LOOPS:
            raise SystemFileError(f"loop {self.loop!r} is unknown; available: {', '.join(LOOPS)}")
        if self.recording.every < 1 or self.recording.chunk < 1:
            raise SystemFileError(f"recording: every and chunk are at least 1; found {self.recording.every} and {self.recording.chunk}")
        if self.recording.chunk > MAX_CHUNK:
            raise SystemFileError(f"recording: chunk is at most {MAX_CHUNK} rows, which are kept in memory; found {self.recording.chunk}")
        if self.stop is not None and math.isnan(self.stop):
            raise SystemFileError("stop is not a number (NaN)")
        if self.recording.checkpoint_every < 0:
            raise SystemFileError(f"recording: checkpoint_every counts steps, 0 = never; found {self.recording.checkpoint_every}")
        for c in self.components:
            if not 0.0 < c.time_limit < math.inf:
                raise SystemFileError(f"component {c.name!r}: time_limit is a positive time; found {c.time_limit!r} s")
            self._check_rate(c)
        if not self.components:
            raise SystemFileError("the system has no components")

    def _check_rate(self, c: Component) -> None:
        if c.rate < 1 or c.every < 1 or c.rate > 1 < c.every:
            raise SystemFileError(
                f"component {c.name!r}: rate and every are whole numbers from 1, and only one of them is more; found {c.rate} and {c.every}"
            )
        if ticks(self.step, "step") % c.rate:
            raise SystemFileError(f"component {c.name!r}: rate = {c.rate} divides the step of {self.step!r} s into no whole nanoseconds")

    @property
    def folder(self) -> Path:
        """What relative paths in the system are relative to."""
        return self.file.parent if self.file else Path()

    def component(self, name: str) -> Component:
        """The component of that name; SystemFileError lists what there is."""
        for c in self.components:
            if c.name == name:
                return c
        raise SystemFileError(unknown("component", name, [c.name for c in self.components]))

    def where(self, line: int | None) -> str:
        """Prefix of error texts: file and line as far as they are known."""
        if self.file is None:
            return ""
        return f"{self.file.name}:{line}: " if line else f"{self.file.name}: "

    def with_source(self, component: str, source: str) -> System:
        """The same system with another source for one component (another FMU, or a replay)."""
        old = self.component(component)
        return replace(self, components=tuple(replace(c, source=source) if c is old else c for c in self.components))

    def with_parameters(self, component: str, parameters: Mapping[str, Any]) -> System:
        """The same system with some parameters of one component set anew: numbers in the unit of the port, or as a file has them."""
        try:
            old = self.component(component)
        except SystemFileError as error:
            place = next(filter(None, (place_of(parameters, name) for name in parameters)), None)
            raise SystemFileError(f"{place}: {error}" if place else str(error)) from None
        both = merged(old.parameters, parameters)
        return replace(self, components=tuple(replace(c, parameters=both) if c is old else c for c in self.components))

    @staticmethod
    def load(file: str | Path, convert: Convert = same_unit_only) -> System:
        """Read `system.toml`. `convert` turns texts like "4 ms" into s.

        SystemFileError names file, line, what was found and what is allowed.
        """
        return load(Path(file), convert)


def ticks(seconds: float, what: str) -> int:
    """Seconds as a whole number of nanoseconds; SystemFileError if it is not one, or not positive."""
    if not abs(seconds) < 1e9:  # NaN, infinite, or so many that a float does not count nanoseconds
        raise SystemFileError(f"{what} = {seconds!r} s is not a number of seconds below 1e9")
    count = round(seconds * TICK)
    if count <= 0 or abs(seconds * TICK - count) > 1e-6 * max(1.0, count * 1e-6):
        near = f"; the nearest is {f'{count / TICK:.9f}'.rstrip('0')} s" if count > 0 else ""
        raise SystemFileError(f"{what} = {seconds!r} s is not a positive whole number of nanoseconds, in which time is counted{near}")
    return count


def load(file: Path, convert: Convert = same_unit_only) -> System:
    """See `System.load`."""
    if not file.is_file():
        near = sorted(p.name for p in file.parent.glob("*.toml")) if file.parent.is_dir() else []
        raise SystemFileError(f"no system file {file}; TOML files in that folder: {', '.join(near) or 'none'}")
    content = TomlFile.load(file, SystemFileError, file.name)
    return _Loader(file, content, convert).system(content.table)


class _Loader:
    """One system file while it is read: knows where things stand."""

    def __init__(self, file: Path, content: TomlFile, convert: Convert) -> None:
        self.file, self.content, self.convert = file, content, convert

    def fail(self, message: str, *path: str | int) -> SystemFileError:
        return SystemFileError(f"{self.content.place(*path)}: {message}")

    def check(self, table: Any, keys: Mapping[str, Any], required: Sequence[str], what: str, *path: str | int) -> Mapping[str, Any]:
        """The table if it has only known keys of the right type and the required ones."""
        if not isinstance(table, dict):
            raise self.fail(f"{what}: expected a table with {', '.join(keys)}; found {table!r}", *path)
        for key, value in table.items():
            if key not in keys:
                raise self.fail(f"{what}: {unknown('key', key, keys)}", *path, key)
            allowed = keys[key] if isinstance(keys[key], tuple) else (keys[key],)
            if not isinstance(value, allowed) or (isinstance(value, bool) and bool not in allowed):
                expected = " or ".join(_WORDS[a] for a in allowed)
                raise self.fail(f"{what}: {key} is {expected}; found {value!r}", *path, key)
        for key in required:
            if key not in table:
                raise self.fail(f"{what}: {key} is missing", *path)
        return table

    def seconds(self, value: float | str, *path: str | int) -> float:
        try:
            return quantity(value, "s", self.convert)
        except ValueError as error:
            raise self.fail(f"{path[-1]}: {error}", *path) from None

    def system(self, table: Mapping[str, Any]) -> System:
        self.check(table, _TOP, ("name", "step", "components"), "system")
        try:
            return System(
                name=table["name"],
                description=table.get("description", ""),
                step=self.seconds(table["step"], "step"),
                stop=self.seconds(table["stop"], "stop") if "stop" in table else None,
                stop_when=table.get("stop_when"),
                algorithm=table.get("algorithm", "gauss-seidel"),
                components=tuple(self.component(name, c) for name, c in table["components"].items()),
                connections=tuple(self.connection(i, c) for i, c in enumerate(table.get("connections", []))),
                recording=self.recording(table.get("recording", {})),
                labels=MappingProxyType(table.get("labels", {})),
                require_connected=table.get("require_connected", False),
                check_ranges=table.get("check_ranges", True),
                loop=table.get("loop", "auto"),
                iteration=Iteration(**self.check(table.get("iteration", {}), _ITERATION, (), "iteration", "iteration")),
                file=self.file,
            )
        except SystemFileError as error:
            if str(error).startswith(self.file.name):
                raise
            raise self.fail(str(error)) from None

    def recording(self, table: Any) -> Recording:
        self.check(table, _RECORDING, (), "recording", "recording")
        columns = table.get("columns", ["*"])
        if not all(isinstance(c, str) for c in columns):
            raise self.fail(f"recording: columns is a list of texts; found {columns!r}", "recording", "columns")
        known = {key: value for key, value in table.items() if key != "columns"}
        return Recording(tuple(columns), **known)

    def component(self, name: str, table: Any) -> Component:
        path = ("components", name)
        if not _NAME.fullmatch(name):
            raise self.fail(f"component name {name!r}: letters, digits and underscores only, no digit first", *path)
        self.check(table, _COMPONENT, ("source",), f"component {name!r}", *path)
        if "time_limit" in table and not table.get("isolate", False):
            raise self.fail(
                f"component {name!r}: time_limit needs isolate = true: only a process of its own can be ended", *path, "time_limit"
            )
        return Component(
            name,
            table["source"],
            self.content.written(table.get("parameters", {}), *path, "parameters"),
            self.content.line(*path),
            table.get("isolate", False),
            self.seconds(table.get("time_limit", "60 s"), *path, "time_limit"),
            table.get("rate", 1),
            table.get("every", 1),
            self.content.written(table.get("inputs", {}), *path, "inputs"),
        )

    def connection(self, index: int, table: Any) -> Connection:
        path = ("connections", index)
        self.check(table, _CONNECTION, ("from", "to"), f"connection {index + 1}", *path)
        for key in ("from", "to"):
            if "." not in table[key]:
                raise self.fail(f"connection {index + 1}: {key} = {table[key]!r} is not of the form component.port", *path, key)
        return Connection(table["from"], table["to"], table.get("delayed", False), self.content.line(*path))


_WORDS = {str: "a text", int: "a whole number", float: "a number", bool: "true or false", dict: "a table", list: "a list"}
