"""A system as data: components, connections, parameters, what to record; loaded from `system.toml`.

Keys are declared below (`SystemKeys`), with an example in docs/reference/formats/system.md. What several components share ([robot], [tool],
[material], [sensor]) is looked up by whoever knows robots (`cell.equipment`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from robomill.orchestration import html
from robomill.orchestration.errors import SystemFileError, not_there, unknown
from robomill.orchestration.loop.acceleration import DEFAULT, Iteration
from robomill.orchestration.system import keys
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required
from robomill.orchestration.system.parameters import Convert, same_unit_only
from robomill.orchestration.system.written import merged, place_of

EQUIPMENT = ("robot", "tool", "material", "sensor")
"""Tables that name what several components share."""
ALGORITHMS = ("jacobi", "gauss-seidel", "iterated")
LOOPS = ("auto", "compiled", "python")
MAX_SECONDS = 1e9
"""Seconds below which every time is: their nanoseconds, and sums of them, stay within 64 bits."""
TICK = 1_000_000_000
"""Ticks per second: time is counted in whole nanoseconds."""

_CHOICES = {"algorithm": ALGORITHMS, "loop": LOOPS}
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
    correction: str | None = None
    """Where the component comes from that corrects signals of this one (see `orchestration.slaves.corrected`); None: there is none."""


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
    """What is written to the run folder."""

    columns: tuple[str, ...] = ("*",)
    """Patterns on `component.port`: `*` stands for anything, a component or an array for all its elements."""
    every: int = 1
    """Each how many steps a row is written."""
    csv: bool = False
    """Whether signals.csv is written, too."""
    chunk: int = 250
    """Rows that are kept in memory before they go to disk."""
    checkpoint_every: int = 0
    """Each how many steps everything is saved from which the run can go on; 0 = never."""

    def __post_init__(self) -> None:
        """Check the values. SystemFileError says what is wrong."""
        if self.every < 1 or self.chunk < 1:
            raise SystemFileError(f"the recording's every and chunk: expected 1 or more, found {self.every} and {self.chunk}")
        if self.chunk > MAX_CHUNK:
            raise SystemFileError(f"the recording's chunk: expected at most {MAX_CHUNK} rows, which are kept in memory, found {self.chunk}")
        if self.checkpoint_every < 0:
            raise SystemFileError(
                f"the recording's checkpoint_every counts steps, 0 = never; found {self.checkpoint_every}; give 0 or more"
            )


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
    equipment: Mapping[str, Entry] = field(default_factory=dict)
    """The tables that name what several components share, as written."""
    equipped: bool = False
    """Whether the components have been given what `equipment` names."""
    warnings: tuple[str, ...] = ()
    """What the run is to say about the system."""
    file: Path | None = None

    def __post_init__(self) -> None:
        """Check what does not need the components' ports. SystemFileError says what is wrong."""
        ticks(self.step, "step")
        for key, names in _CHOICES.items():
            if getattr(self, key) not in names:
                raise SystemFileError(unknown(key, getattr(self, key), names))
        if self.stop is not None and math.isnan(self.stop):
            raise SystemFileError("stop is not a number (NaN); give a time such as '10 s'")
        for c in self.components:
            if not 0.0 < c.time_limit < math.inf:
                raise SystemFileError(
                    f"component {c.name!r}: time_limit is a positive time; found {c.time_limit!r} s; give a time such as '60 s'"
                )
            self._check_rate(c)
        if not self.components:
            raise SystemFileError("the system has no components; add at least one table [components.NAME]")

    def _check_rate(self, c: Component) -> None:
        if c.rate < 1 or c.every < 1 or c.rate > 1 < c.every:
            raise SystemFileError(
                f"component {c.name!r}: rate and every are whole numbers from 1, and only one of them is more; found {c.rate} and {c.every}"
            )
        if ticks(self.step, "step") % c.rate:
            raise SystemFileError(
                f"component {c.name!r}: rate = {c.rate} divides the step of {self.step!r} s into no whole nanoseconds"
                "; choose another rate or step"
            )

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
        """System with another source for one component (another FMU, or a replay)."""
        old = self.component(component)
        return replace(self, components=tuple(replace(c, source=source) if c is old else c for c in self.components))

    def with_correction(self, component: str, source: str | None) -> System:
        """System in which the component from `source` corrects signals of one component; None: nothing does."""
        old = self.component(component)
        return replace(self, components=tuple(replace(c, correction=source) if c is old else c for c in self.components))

    def with_parameters(self, component: str, parameters: Mapping[str, Any]) -> System:
        """System with some parameters of one component set anew: numbers in the unit of the port, or as a file has them."""
        try:
            old = self.component(component)
        except SystemFileError as error:
            place = next(filter(None, (place_of(parameters, name) for name in parameters)), None)
            raise SystemFileError(f"{place}: {error}" if place else str(error)) from None
        both = merged(old.parameters, parameters)
        return replace(self, components=tuple(replace(c, parameters=both) if c is old else c for c in self.components))

    def _repr_html_(self) -> str:
        end = "" if self.stop is None else f", to t = {self.stop:g} s"
        caption = f"System {self.name}: step {1e3 * self.step:g} ms{end}, {self.algorithm}, {len(self.connections)} connections"
        rows = ((c.name, c.source, ", ".join(f"{k} = {v}" for k, v in c.parameters.items())) for c in self.components)
        return html.table(caption, ("component", "source", "parameters"), rows)

    @staticmethod
    def load(file: str | Path, convert: Convert = same_unit_only) -> System:
        """Read `system.toml`. `convert` turns texts like "4 ms" into s.

        SystemFileError names file, line, what was found and what is allowed.
        """
        return load(Path(file), convert)


class ComponentKeys(Keys):
    """One component: where it comes from and how it is set."""

    source = required(
        keys.text(),
        "a component of this project (`robot_drive`), one of your own (`module:MODEL`), an FMU (`dist/x.fmu`), `replay:RUN`, "
        "or `measured`: its outputs are what was measured of them in the run that is diagnosed",
    )
    parameters = default({}, keys.values(), "parameters of the component, with units, instead of its own values")
    inputs = default({}, keys.values(), "start values of inputs: open inputs keep them, delayed ones have them until the first step")
    isolate = default(False, keys.flag(), "run an FMU in a process of its own, so that its crash is an error and no end of the program")
    time_limit = default("60 s", keys.quantity("s"), "wall-clock time that one call may take; needs `isolate = true`")
    rate = default(1, keys.count(1), "steps of the component in each step of the system")
    every = default(1, keys.count(1), "steps of the system for each step of the component; only one of `rate` and `every` is above 1")
    correction = optional(keys.text(), "what corrects signals of the component on their way: a form (`adopt.form.json`) or an FMU")


class ConnectionKeys(Keys):
    """One connection: from an output to an input, whole arrays or single elements."""

    source = required(keys.text(), "the output: `component.port` or `component.port[2]`", name="from")
    target = required(keys.text(), "the input: `component.port` or `component.port[2]`", name="to")
    delayed = default(False, keys.flag(), "the input sees the output of the step before, which breaks a loop")


class SystemKeys(Keys):
    """Components, their connections, and how they are stepped."""

    name = required(keys.text(blank=True), "name of the system; results stand in a folder of that name")
    description = default("", keys.text(blank=True), "what the system is")
    step = required(keys.quantity("s"), "communication step: a whole number of nanoseconds")
    stop = optional(keys.quantity("s"), "end of the run; without it, `stop_when` or the command line says when")
    stop_when = optional(keys.text(blank=True), "an output, `component.port`, that ends the run as soon as it is not zero")
    algorithm = default("gauss-seidel", keys.choice(ALGORITHMS), "how components that wait for each other are stepped")
    loop = default("auto", keys.choice(LOOPS), "how the master runs: `auto` compiles the loop where it can; the numbers are the same")
    require_connected = default(False, keys.flag(), "an open input is an error")
    check_ranges = default(True, keys.flag(), "an output outside its declared minimum and maximum ends the run")
    labels = default(
        {}, keys.anything("table of `name = value`"), "what is known of the run (program, condition, repeat); copied to run.toml"
    )
    components = required(keys.tables(ComponentKeys), "the components by name: letters, digits and underscores")
    connections = default([], keys.each(ConnectionKeys), "what is connected to what")
    recording = default({}, keys.made(Recording), "what is written")
    iteration = default({}, keys.made(Iteration), 'how loops are iterated, with `algorithm = "iterated"`')
    robot = optional(keys.anything("table"), "the robot of all components that need one: see [equipment](equipment.md)")
    tool = optional(keys.anything("table"), "the tool, likewise")
    material = optional(keys.anything("table"), "the material, likewise")
    sensor = optional(keys.anything("table"), "the force sensor, likewise")


def ticks(seconds: float, what: str) -> int:
    """Seconds as a whole number of nanoseconds; SystemFileError if it is not one, or not positive."""
    if not abs(seconds) < MAX_SECONDS:  # NaN, infinite, or so many that a float does not count nanoseconds
        raise SystemFileError(f"{what} = {seconds!r} s is not a number of seconds below {MAX_SECONDS:g}; give a time such as '4 ms'")
    count = round(seconds * TICK)
    if count <= 0 or abs(seconds * TICK - count) > 1e-6 * max(1.0, count * 1e-6):
        near = f"; the nearest is {f'{count / TICK:.9f}'.rstrip('0')} s" if count > 0 else ""
        raise SystemFileError(
            f"{what} = {seconds!r} s is not a positive whole number of nanoseconds, in which time is counted{near}; choose such a number"
        )
    return count


def load(file: Path, convert: Convert = same_unit_only) -> System:
    """See `System.load`."""
    if not file.is_file():
        raise SystemFileError(not_there("system file", file))
    top = Entry.load(file, SystemFileError, convert, file.name)
    if "scenario" in top:
        raise top["scenario"].fail("this file is a scenario; expected a system file, such as the one that its [scenario] names as system")
    k = SystemKeys
    k.of(top)
    plain: dict[str, Any] = {
        key.name: key.of(top) for key in (k.name, k.description, k.stop_when, k.algorithm, k.loop, k.require_connected, k.check_ranges)
    }
    made: dict[str, Any] = {
        "step": k.step.of(top),
        "stop": k.stop.of(top),
        "components": tuple(_component(name, entry) for name, entry in k.components.entry(top).items()),
        "connections": tuple(_connection(entry) for entry in k.connections.of(top)),
        "recording": k.recording.of(top),
        "iteration": k.iteration.of(top),
        "labels": MappingProxyType(k.labels.of(top).table().value),
        "equipment": {key: top[key].table() for key in EQUIPMENT if key in top},
    }
    with top.blamed_for(SystemFileError):
        return System(**plain, **made, file=file)


def _component(name: str, entry: Entry) -> Component:
    if not _NAME.fullmatch(name):
        raise entry.fail("the name of a component: letters, digits and underscores only, no digit first; choose another name")
    k = ComponentKeys
    k.of(entry)
    isolate = k.isolate.of(entry)
    if k.time_limit.name in entry and not isolate:
        raise entry["time_limit"].fail(
            "needs isolate = true: only a process of its own can be ended; add isolate = true, or remove time_limit"
        )
    return Component(
        name,
        k.source.of(entry),
        k.parameters.of(entry),
        entry.line,
        isolate,
        k.time_limit.of(entry),
        k.rate.of(entry),
        k.every.of(entry),
        k.inputs.of(entry),
        k.correction.of(entry),
    )


def _connection(entry: Entry) -> Connection:
    k = ConnectionKeys
    for end in (k.source, k.target):
        if "." not in end.of(entry):
            raise end.entry(entry).expected("component.port")
    return Connection(k.source.of(entry), k.target.of(entry), k.delayed.of(entry), entry.line)
