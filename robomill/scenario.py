"""Scenario files: what is simulated, in which variants, and which published figures stand beside the result.

A scenario is TOML. Physical values carry their unit (``"0.2 mm"``) or are plain SI numbers::

    [scenario]
    name = "groove"
    kind = "milling"                    # or "static_loads"
    system = "milling_cell.toml"        # components and connections, beside the scenario
    program = "groove.ngc"              # G-code, or a path of points in TOML
    # how the program is read where it does not say itself (docs/gcode.md); places in mm of its own zero (G54):
    start = ["0 mm", "0 mm", "50 mm"]   # where the tool stands before the first block
    home = ["0 mm", "0 mm", "100 mm"]   # where G28, G30 and G53 lead
    dialect = "fanuc"                   # linuxcnc (default), fanuc, haas, marlin: units of dwells
    block_delete = false                # execute lines that begin with /
    feed = "25 mm/s"                    # until the program names one; so does
    spindle_speed = "13000 rpm"

    [workpiece]
    position = ["1595 mm", "-18 mm", "1099 mm"]   # centre of its top surface, in the robot base
    size = ["100 mm", "60 mm", "30 mm"]
    zero = "front-left-top"                       # where G54 lies in the block (default: centre-top); or three lengths from the centre
    work_offsets = { G55 = ["10 mm", 0, 0] }      # if the program needs others than G54: a place as `zero`

    [tools.1]                           # the tools that T names; without, the one of the milling component does all
    diameter = "16 mm"
    teeth = 3
    helix = "30 deg"
    cutting_length = "32 mm"

    [parameters]                        # for every variant: component, parameter, value
    controller.mode = 0

    [variants.cartesian]
    title = "Cartesian"
    parameters.controller.mode = 1

    [paper.cartesian]                   # published figures, printed beside ours
    max_deviation_m = "0.7 mm"
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from models.cutting import MAX_TEETH, EndMill
from models.gcode import DIALECTS, Setup, Vector
from orchestration.parameters import quantity
from orchestration.toml_text import parse
from robomill.binding import convert

ComponentParameters = Mapping[str, Mapping[str, Any]]
"""component -> parameter -> value as written; checked and converted against the component's ports when the system is assembled."""

KINDS = ("milling", "static_loads")
PLAIN_OFFSETS: Mapping[float, Vector] = {54: (0.0, 0.0, 0.0)}
"""Work offsets where a scenario names none."""
OFFSETS = {f"G{n:g}": float(n) for n in (54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3)}
"""Names of the work offsets, and the numbers that the reader of programs knows them by."""
_READING = {"start", "home", "dialect", "block_delete", "feed", "spindle_speed"}
"""Keys of [scenario] that say how the program is read."""
_FACES: Mapping[str, tuple[tuple[int, float], ...]] = {
    "left": ((0, -0.5),),
    "right": ((0, 0.5),),
    "front": ((1, -0.5),),
    "back": ((1, 0.5),),
    "top": ((2, 0.0),),
    "bottom": ((2, -1.0),),
    "corner": ((0, -0.5), (1, -0.5)),
    "centre": (),
}
"""Words of a place in the block: axis and share of the size from the centre of the top."""
_SECTIONS = {"scenario", "parameters", "workpiece", "variants", "paper", "tools"}
_PAPER_UNITS = {"_m": "m", "_n": "N", "_s": "s", "_percent": "%"}


class ScenarioError(ValueError):
    """A scenario file that cannot be used; the text names file, key, what was found and what is expected."""


@dataclass(frozen=True)
class Workpiece:
    """Where the block is and how large: frame P at the centre of its top surface."""

    position: tuple[float, float, float]
    """p_BP_B [m]."""
    size: tuple[float, float, float]
    """Extent along x, y, z of P [m]."""
    abc: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Orientation of P in B: A, B, C [rad]."""
    work_offsets: Mapping[float, Vector] = field(default_factory=lambda: dict(PLAIN_OFFSETS))
    """Origins of G54 (54) .. G59.3 (59.3) in P [m]; G54 is the origin of P unless it is named."""


@dataclass(frozen=True)
class Variant:
    """One way to run a scenario: its parameters come on top of those of the scenario."""

    name: str
    title: str
    parameters: ComponentParameters


@dataclass(frozen=True)
class Scenario:
    """A scenario file, with paths made absolute."""

    file: Path
    name: str
    kind: str
    title: str
    system: Path
    program: Path | None
    workpiece: Workpiece | None
    parameters: ComponentParameters
    variants: tuple[Variant, ...]
    paper: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """variant -> figure -> published value (SI)."""
    reading: Setup = field(default_factory=Setup)
    """How the program is read."""
    tools: Mapping[int, EndMill] = field(default_factory=dict)
    """The tools by T number; empty: the milling component's own does all."""


def load_scenario(path: str | Path) -> Scenario:
    """Read and check a scenario file. ScenarioError or FileNotFoundError says what is wrong and what is possible."""
    file = Path(path)
    if not file.is_file():
        beside = sorted(str(f) for f in file.parent.glob("*.toml")) if file.parent.is_dir() else []
        raise FileNotFoundError(f"no scenario {file}; TOML files in that folder: {', '.join(beside) or 'none'}")
    try:
        table = parse(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{file}: not valid TOML: {error}") from None
    _keys(file, "the file", table, required={"scenario"}, optional=_SECTIONS - {"scenario"})
    head = _keys(file, "[scenario]", table["scenario"], required={"name", "kind", "system"}, optional={"title", "program", *_READING})
    if head["kind"] not in KINDS:
        raise ScenarioError(f"{file}: [scenario] kind is {head['kind']!r}; known kinds: {', '.join(KINDS)}, experiment")
    milling = head["kind"] == "milling"
    for key, there in (("program", "program" in head), ("workpiece", "workpiece" in table), ("variants", bool(table.get("variants")))):
        if milling and not there:
            raise ScenarioError(f"{file}: a milling scenario needs a {key}; see robomill/scenario.py or scenarios/groove.toml")
    workpiece = _workpiece(file, table["workpiece"]) if "workpiece" in table else None
    tools = dict(_tool(file, name, entry) for name, entry in table.get("tools", {}).items())
    return Scenario(
        file=file.resolve(),
        name=head["name"],
        kind=head["kind"],
        title=head.get("title", head["name"]),
        system=_beside(file, head["system"], "system"),
        program=_beside(file, head["program"], "program") if "program" in head else None,
        workpiece=workpiece,
        parameters=_parameters(file, "[parameters]", table.get("parameters", {})),
        variants=tuple(_variant(file, name, entry) for name, entry in table.get("variants", {}).items()),
        paper={name: _figures(file, f"[paper.{name}]", entry) for name, entry in table.get("paper", {}).items()},
        reading=_reading(file, head, workpiece.work_offsets if workpiece else PLAIN_OFFSETS, tools),
        tools=tools,
    )


def _keys(file: Path, where: str, table: Any, required: set[str], optional: set[str]) -> dict[str, Any]:
    """The table, if it has the required keys and no unknown ones."""
    if not isinstance(table, dict):
        raise ScenarioError(f"{file}: {where} must be a table, found {table!r}")
    unknown, missing = sorted(set(table) - required - optional), sorted(required - set(table))
    if unknown or missing:
        problems = [f"unknown: {', '.join(unknown)}"] * bool(unknown) + [f"missing: {', '.join(missing)}"] * bool(missing)
        raise ScenarioError(f"{file}: {where}: {'; '.join(problems)}; known keys: {', '.join(sorted(required | optional))}")
    return table


def _beside(file: Path, name: Any, key: str) -> Path:
    """A file named in the scenario, relative to its folder; it must exist."""
    found = (file.parent / str(name)).resolve()
    if not found.is_file():
        there = sorted(f.name for f in file.parent.iterdir() if f.is_file())
        raise FileNotFoundError(f"{file}: [scenario] {key} = {str(name)!r}: no such file; beside the scenario are {', '.join(there)}")
    return found


def _si(file: Path, where: str, value: Any, unit: str) -> float:
    """A number in `unit` from a number or a text such as "0.2 mm"."""
    try:
        if isinstance(value, str):
            return quantity(value, unit, convert)
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        raise ValueError(f"{value!r} is neither a number nor a text with a unit")
    except ValueError as error:
        raise ScenarioError(f"{file}: {where}: {error}; expected a quantity in {unit}") from None


def _vector(file: Path, where: str, values: Any, unit: str) -> tuple[float, float, float]:
    if not isinstance(values, list) or len(values) != 3:
        raise ScenarioError(f"{file}: {where} = {values!r}; expected three quantities in {unit}")
    x, y, z = (_si(file, where, v, unit) for v in values)
    return x, y, z


def _workpiece(file: Path, table: Any) -> Workpiece:
    _keys(file, "[workpiece]", table, required={"position", "size"}, optional={"abc", "work_offsets", "zero"})
    size = _vector(file, "[workpiece] size", table["size"], "m")
    if min(size) <= 0.0:
        raise ScenarioError(f"{file}: [workpiece] size = {table['size']!r}; expected three positive lengths")
    return Workpiece(
        _vector(file, "[workpiece] position", table["position"], "m"),
        size,
        _vector(file, "[workpiece] abc", table.get("abc", [0.0, 0.0, 0.0]), "rad"),
        _work_offsets(file, table, size),
    )


def _work_offsets(file: Path, table: Any, size: Vector) -> dict[float, Vector]:
    """`zero` and `work_offsets` as the reader of programs takes them."""
    given = table.get("work_offsets", {})
    _keys(file, "[workpiece] work_offsets", given, required=set(), optional=set(OFFSETS))
    if "zero" in table and "G54" in given:
        raise ScenarioError(f"{file}: [workpiece] names zero and work_offsets.G54, which are the same; give one of them")
    origins = {OFFSETS[name]: _place(file, f"[workpiece] work_offsets.{name}", value, size) for name, value in given.items()}
    if "zero" in table:
        origins[54.0] = _place(file, "[workpiece] zero", table["zero"], size)
    return {**PLAIN_OFFSETS, **origins}


def _place(file: Path, where: str, value: Any, size: Vector) -> Vector:
    """A point of P [m]: three lengths, or a place of the block by name."""
    if isinstance(value, str):
        try:
            return place_in_block(value, size)
        except ValueError as error:
            raise ScenarioError(f"{file}: {where} = {value!r}: {error}; or three lengths from the centre of the top") from None
    return _vector(file, where, value, "m")


def place_in_block(name: str, size: Vector) -> Vector:
    """A place such as "front-left-top" in P [m], for a block of `size` [m]; front is -y, left -x, "corner" front-left-top.

    ValueError lists the words.
    """
    point: list[float | None] = [None, None, None]
    for word in name.split("-"):
        if word not in _FACES:
            raise ValueError(f"{word!r} is no place of a block; words, joined by '-': {', '.join(_FACES)}")
        for axis, share in _FACES[word]:
            if point[axis] is not None:
                raise ValueError(f"two words for {'xyz'[axis]}; one of left, right, one of front, back, one of top, bottom")
            point[axis] = share * size[axis]
    x, y, z = (0.0 if c is None else c for c in point)
    return x, y, z


def _reading(file: Path, head: Mapping[str, Any], offsets: Mapping[float, Vector], tools: Mapping[int, EndMill]) -> Setup:
    """The keys of [scenario] that say how the program is read."""
    setup = Setup(work_offsets=offsets, radii={number: 0.5 * mill.diameter for number, mill in tools.items()})
    zero = offsets[54]
    for key in ("start", "home"):
        if key in head:
            x, y, z = (c + o for c, o in zip(_vector(file, f"[scenario] {key}", head[key], "m"), zero, strict=True))
            setup = replace(setup, start=(x, y, z)) if key == "start" else replace(setup, home=(x, y, z))
    dialect = head.get("dialect", setup.dialect)
    if dialect not in DIALECTS:
        raise ScenarioError(f"{file}: [scenario] dialect = {dialect!r}; known: {', '.join(DIALECTS)}")
    block_delete = head.get("block_delete", True)
    if not isinstance(block_delete, bool):
        raise ScenarioError(f"{file}: [scenario] block_delete = {block_delete!r}; expected true (skip lines with /) or false")
    feed, speed = (
        _si(file, f"[scenario] {k}", head[k], u) if k in head else None for k, u in (("feed", "m/s"), ("spindle_speed", "rad/s"))
    )
    return replace(setup, dialect=dialect, block_delete=block_delete, feed=feed, spindle_speed=speed)


def _tool(file: Path, name: str, entry: Any) -> tuple[int, EndMill]:
    """`[tools.1]`: T number and end mill."""
    where = f"[tools.{name}]"
    if not name.isdecimal() or int(name) < 1:
        raise ScenarioError(f"{file}: {where}: a tool is called by its T number, 1 or more, such as [tools.1]")
    _keys(file, where, entry, required={"diameter", "teeth", "helix", "cutting_length"}, optional={"title"})
    diameter, length = (_si(file, f"{where} {key}", entry[key], "m") for key in ("diameter", "cutting_length"))
    teeth = entry["teeth"]
    if not isinstance(teeth, int) or isinstance(teeth, bool) or not 1 <= teeth <= MAX_TEETH:
        raise ScenarioError(f"{file}: {where} teeth = {teeth!r}; expected a whole number from 1 to {MAX_TEETH}")
    if min(diameter, length) <= 0.0:
        raise ScenarioError(
            f"{file}: {where} diameter = {entry['diameter']!r}, cutting_length = {entry['cutting_length']!r}; expected positive lengths"
        )
    return int(name), EndMill(diameter, teeth, _si(file, f"{where} helix", entry["helix"], "rad"), length)


def _parameters(file: Path, where: str, table: Any) -> ComponentParameters:
    if not isinstance(table, dict) or not all(isinstance(v, dict) for v in table.values()):
        raise ScenarioError(f"{file}: {where} holds component.parameter = value, found {table!r}")
    return table


def _variant(file: Path, name: str, entry: Any) -> Variant:
    where = f"[variants.{name}]"
    _keys(file, where, entry, required=set(), optional={"title", "parameters"})
    return Variant(name, str(entry.get("title", name)), _parameters(file, f"{where} parameters", entry.get("parameters", {})))


def _figures(file: Path, where: str, table: Any) -> dict[str, float]:
    """Published figures; the name ends in the unit they are kept in, as in summary.json."""
    if not isinstance(table, dict):
        raise ScenarioError(f"{file}: {where} must be a table, found {table!r}")
    units = {key: next((u for suffix, u in _PAPER_UNITS.items() if key.endswith(suffix)), "1") for key in table}
    return {key: _si(file, f"{where} {key}", value, units[key]) for key, value in table.items()}
