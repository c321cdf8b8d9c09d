"""Kinds of runs that could be made next, from a TOML file: templates with quantities that the experimenter sets within bounds.

Keys of the file are declared below (`KindsKeys`), with an example in docs/reference/formats/next_runs.md. `prepare` makes of a kind, of
values and of any system the system of that run. Within `${...}` a quantity is a number in the unit of its `low`. The kinds of milling cells
are in scenarios/next_runs/kinds.toml; a system brings its own in `next_runs.toml` beside it.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from robomill.cell.binding import convert
from robomill.cell.equipment import load_system
from robomill.cell.experiments import LOAD_ROWS, Experiment, in_folder, read_condition
from robomill.cell.experiments import prepare as prepare_condition
from robomill.cell.milling import PARTS
from robomill.cell.scenario import ScenarioError
from robomill.files import FILES
from robomill.models.components.applied_load import MODEL as APPLIED_LOAD
from robomill.orchestration.errors import unknown
from robomill.orchestration.system import keys
from robomill.orchestration.system.definition import Component, Connection, System
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required

KINDS = FILES / "scenarios" / "next_runs" / "kinds.toml"
OWN = "next_runs.toml"
"""File of kinds beside a system."""
_CUT, _LOAD = "milling", "load"
TEMPLATE = ".template"
"""What ends the name of a table of a program that is no TOML until it is filled in."""
_CONDITION = {"name", "program", "position", "abc", "size", "load", "weight", "minutes", "parameters"}
_FIELD = re.compile(r"\$\{([^}]*)\}")
_UNIT = re.compile(r"\s*[-+]?[\d.]+(?:[eE][-+]?\d+)?\s*(.*?)\s*")


@dataclass(frozen=True)
class Range:
    """A quantity that the experimenter sets [unit]."""

    name: str
    unit: str
    low: float
    high: float
    start: float


@dataclass(frozen=True)
class RunKind:
    """A kind of run as its file has it."""

    name: str
    ranges: tuple[Range, ...]
    minutes: float
    repeats: int
    system: str
    entry: Entry

    @property
    def cuts(self) -> bool:
        """Whether it mills a block."""
        return "size" in self.entry

    def values(self, given: Mapping[str, float]) -> dict[str, float]:
        """All values [unit], the start where none is given; LookupError for what is no quantity of it, or out of bounds."""
        known = {r.name: r for r in self.ranges}
        for name, value in given.items():
            if name not in known:
                raise LookupError(f"run {self.name!r}: {unknown('quantity', name, known)}")
            r = known[name]
            if not r.low <= value <= r.high:
                raise LookupError(f"run {self.name!r}: {name} = {value:g} {r.unit} is out of its range, {r.low:g} .. {r.high:g} {r.unit}")
        return {r.name: given.get(r.name, r.start) for r in self.ranges}


@dataclass(frozen=True)
class NextRun:
    """A run that could be made: SI, and minutes for the people who make it."""

    kind: str
    system: System
    """What makes it; the parameters below are not set in it."""
    parameters: Mapping[str, Mapping[str, Any]]
    """What the experimenter sets, component -> parameter -> value; files by absolute paths."""
    seconds: float
    """Length of one repeat."""
    minutes: float
    """What all repeats cost, with setting up."""
    repeats: int


class RangeKeys(Keys):
    """A quantity that the experimenter sets within bounds; texts of the kind and of its program refer to it as `${NAME}`."""

    low = required(keys.anything("quantity"), "lowest value; its unit is that of the quantity")
    high = required(keys.anything("quantity"), "highest value")
    start = optional(keys.anything("quantity"), "value that the search begins with (default: the middle)")


class KindKeys(Keys):
    """A kind of run that could be made next. Give either `program` or `seconds`.

    `${...}` stands for a number, in any text of the kind and in its program: `+ - * /` of numbers and quantities, sin and cos of degrees.
    """

    name = required(keys.text(), "name of the kind, used once")
    minutes = required(keys.positive(), "what all repeats take, with setting up")
    system = default(
        "diagnosed",
        keys.text(),
        "`diagnosed`: the one that is diagnosed; `loaded`: with an applied load in place of the cut; or a system file",
    )
    repeats = default(3, keys.count(1), "repeats of the run")
    range = default({}, keys.tables(RangeKeys), "quantities that the experimenter sets, by name")
    seconds = optional(keys.positive(), "length of a run of a system without a program [s]")
    program = optional(keys.file(), "G-code, a path of points (TOML), or a template of one of them that ends in .template")
    position = optional(keys.vector("m"), "of the frame that the program is in, in the robot base; needed with a program")
    abc = optional(keys.vector("rad"), "orientation of that frame: Euler angles A about z, B about y', C about x''")
    size = optional(keys.vector("m"), "size of the block, where one is milled")
    load = default([], LOAD_ROWS, "force on the tool in the robot base over time, straight lines between the rows")
    weight = optional(keys.quantity("kg"), "mass that hangs from the tool tip all the time")
    parameters = default({}, keys.parameters(), "parameters that are set in the run, with units")


class KindsKeys(Keys):
    """Kinds of runs that a diagnosis designs the next run from."""

    kind = required(keys.each(KindKeys), "the kinds")


def load_kinds(file: Path = KINDS) -> tuple[RunKind, ...]:
    """Read and check a file of kinds. ScenarioError or FileNotFoundError says what is wrong and what is possible."""
    if not file.is_file():
        raise FileNotFoundError(f"no kinds of runs {file}; without --next-runs they are {OWN} beside the system, or the milling cell's")
    found: dict[str, RunKind] = {}
    for entry in KindsKeys.of(Entry.load(file, ScenarioError, convert))["kind"].each():
        kind = _kind(entry)
        if kind.name in found:
            raise entry["name"].fail(f"{kind.name!r} is there twice; give every kind a name of its own")
        found[kind.name] = kind
    return tuple(found.values())


def _kind(entry: Entry) -> RunKind:
    k = KindKeys
    k.of(entry)
    if ("program" in entry) == ("seconds" in entry):
        raise entry.fail("expected either program or seconds: how long is a run?")
    ranges = tuple(_range(name, r) for name, r in k.range.of(entry).items())
    system = k.system.of(entry)
    if system not in ("diagnosed", "loaded"):
        entry["system"].file()
    kind = RunKind(k.name.of(entry), ranges, k.minutes.of(entry), k.repeats.of(entry), system, entry)
    values = kind.values({})
    filled = _filled(entry, values)
    if "program" in filled:
        _rendered(filled["program"].file().read_text(encoding="utf-8"), values, filled["program"])
        read_condition(_as_condition(filled))
    else:
        filled["seconds"].positive()
    return kind


def _range(name: str, entry: Entry) -> Range:
    stated = _UNIT.fullmatch(entry["low"].value) if isinstance(entry["low"].value, str) else None
    unit = (stated[1] if stated else "") or "1"
    low, high = entry["low"].si(unit), entry["high"].si(unit)
    if low >= high:
        raise entry.fail(f"low = {low:g} {unit} is not below high = {high:g} {unit}; exchange them")
    start = entry["start"].si(unit) if "start" in entry else 0.5 * (low + high)
    if not low <= start <= high:
        raise entry["start"].fail(f"{start:g} {unit} is out of the range, {low:g} .. {high:g} {unit}; choose a start within it")
    if not name.isidentifier():
        raise entry.fail(f"{name!r} is no name for a quantity; expected letters, digits and _, such as 'load'")
    return Range(name, unit, low, high, start)


def kinds_for(system: System, file: Path = KINDS) -> tuple[RunKind, ...]:
    """The kinds that `system` can make. A program and a load need the parts of a milling cell, a block its cut."""
    names = {c.name for c in system.components}
    cell = {*PARTS} - {_CUT} <= names and bool(names & {_CUT, _LOAD})
    return tuple(k for k in load_kinds(file) if "program" not in k.entry or (cell and (not k.cuts or _CUT in names)))


def prepare(system: System, kind: str, folder: Path, values: Mapping[str, float] | None = None, file: Path = KINDS) -> NextRun:
    """The run `kind` with `system` and these values [unit of their range]; its tables are written into `folder`.

    LookupError: no such kind, no such quantity, or one out of bounds. Raises what reader and planner raise.
    """
    known = {k.name: k for k in load_kinds(file)}
    if kind not in known:
        raise LookupError(f"no kind of run {kind!r}; there are: {', '.join(known)}")
    k = known[kind]
    set_to = k.values(values or {})
    entry = _filled(k.entry, set_to)
    made = system if k.system == "diagnosed" else with_load(system) if k.system == "loaded" else load_system(entry["system"].file())
    if "program" not in entry:
        return NextRun(kind, made, KindKeys.parameters.of(entry), entry["seconds"].positive(), k.minutes, k.repeats)
    folder.mkdir(parents=True, exist_ok=True)
    source = entry["program"].file()
    program = folder / source.name.removesuffix(TEMPLATE)
    program.write_text(_rendered(source.read_text(encoding="utf-8"), set_to, entry["program"]), encoding="utf-8")
    c = replace(read_condition(_as_condition(entry)), program=program)
    experiment = Experiment(file, kind, kind, "next run", k.repeats, file, {}, {}, (c,))
    planned, parameters = prepare_condition(experiment, c, made, folder)
    return NextRun(kind, made, in_folder(parameters, folder), planned.duration, k.minutes, k.repeats)


def _as_condition(entry: Entry) -> Entry:
    return Entry(entry.content, {key: v for key, v in entry.value.items() if key in _CONDITION}, entry.key)


def _filled(entry: Entry, values: Mapping[str, float]) -> Entry:
    """The entry with numbers in place of all `${...}`."""
    return Entry(entry.content, _with_numbers(entry.value, values, entry), entry.key)


def _with_numbers(value: Any, values: Mapping[str, float], entry: Entry) -> Any:
    if isinstance(value, str):
        text = _rendered(value, values, entry)
        return float(text) if text != value and _FIELD.fullmatch(value) else text
    if isinstance(value, list):
        return [_with_numbers(v, values, entry) for v in value]
    return {k: _with_numbers(v, values, entry) for k, v in value.items()} if isinstance(value, dict) else value


def _rendered(text: str, values: Mapping[str, float], entry: Entry) -> str:
    """A text with numbers in place of all `${...}`."""

    def number(match: re.Match[str]) -> str:
        try:
            found = _evaluated(ast.parse(match[1].strip(), mode="eval").body, values)
        except (SyntaxError, ZeroDivisionError) as problem:
            raise entry.fail(f"{match[0]}: {problem.args[0]}; expected + - * / of numbers and quantities, sin, cos of degrees") from None
        except LookupError as problem:
            raise entry.fail(f"{match[0]}: {problem.args[0]}") from None
        return f"{found:.9f}".rstrip("0").rstrip(".")

    return _FIELD.sub(number, text)


_OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


def _evaluated(node: ast.expr, values: Mapping[str, float]) -> float:
    """Value of an expression; LookupError for a name that is none, SyntaxError for anything that is no arithmetic."""
    match node:
        case ast.Constant(value=int() | float() as value):
            return float(value)
        case ast.Name(id=name):
            if name not in values:
                raise LookupError(unknown("quantity", name, values))
            return values[name]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_evaluated(operand, values)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_evaluated(left, values), _evaluated(right, values))
        case ast.Call(func=ast.Name(id="sin" | "cos" as function), args=[angle], keywords=[]):
            radians = math.radians(_evaluated(angle, values))
            return math.sin(radians) if function == "sin" else math.cos(radians)
    raise SyntaxError("is no arithmetic")


def with_load(cell: System) -> System:
    """The cell with a load that is applied on purpose (`models/components/applied_load.py`) in place of the cut, if it has one."""
    if not any(c.name == _CUT for c in cell.components):
        return cell
    components = tuple(Component(_LOAD, "applied_load") if c.name == _CUT else c for c in cell.components)
    outputs = {v.name for v in APPLIED_LOAD.variables if v.causality == "output"}
    connections = []
    for c in cell.connections:
        if c.target.partition(".")[0] == _CUT:
            continue
        part, _, port = c.source.partition(".")
        if part != _CUT:
            connections.append(c)
        elif port in outputs:  # a load has no part that turns with a spindle
            connections.append(Connection(f"{_LOAD}.{port}", c.target, c.delayed))
    return replace(cell, components=components, connections=tuple(connections))
