"""Scenario files: what is simulated, in which variants, and which published figures stand beside the result.

A scenario is TOML. Physical values carry their unit (``"0.2 mm"``) or are plain SI numbers::

    [scenario]
    name = "groove"
    kind = "milling"                    # or "static_loads"
    system = "milling_cell.toml"        # components and connections, beside the scenario
    program = "groove.ngc"              # G-code, or a path of points in TOML

    [workpiece]
    position = ["1595 mm", "-18 mm", "1099 mm"]   # centre of its top surface, in the robot base
    size = ["100 mm", "60 mm", "30 mm"]
    work_offsets = { G55 = ["10 mm", 0, 0] }      # if the program needs others than G54, which is that centre

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
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from models.gcode import Vector
from orchestration.parameters import quantity
from orchestration.toml_text import parse
from robomill.binding import convert

ComponentParameters = Mapping[str, Mapping[str, Any]]
"""component -> parameter -> value as written; checked and converted against the component's ports when the system is assembled."""

KINDS = ("milling", "static_loads")
PLAIN_OFFSETS: Mapping[float, Vector] = {54: (0.0, 0.0, 0.0)}
"""Work offsets where a scenario names none."""
_SECTIONS = {"scenario", "parameters", "workpiece", "variants", "paper"}
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
    """Origins of G54 (54) .. G59 (59) in P [m]; G54 is the origin of P unless it is named."""


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
    head = _keys(file, "[scenario]", table["scenario"], required={"name", "kind", "system"}, optional={"title", "program"})
    if head["kind"] not in KINDS:
        raise ScenarioError(f"{file}: [scenario] kind is {head['kind']!r}; known kinds: {', '.join(KINDS)}, experiment")
    milling = head["kind"] == "milling"
    for key, there in (("program", "program" in head), ("workpiece", "workpiece" in table), ("variants", bool(table.get("variants")))):
        if milling and not there:
            raise ScenarioError(f"{file}: a milling scenario needs a {key}; see robomill/scenario.py or scenarios/groove.toml")
    return Scenario(
        file=file.resolve(),
        name=head["name"],
        kind=head["kind"],
        title=head.get("title", head["name"]),
        system=_beside(file, head["system"], "system"),
        program=_beside(file, head["program"], "program") if "program" in head else None,
        workpiece=_workpiece(file, table["workpiece"]) if "workpiece" in table else None,
        parameters=_parameters(file, "[parameters]", table.get("parameters", {})),
        variants=tuple(_variant(file, name, entry) for name, entry in table.get("variants", {}).items()),
        paper={name: _figures(file, f"[paper.{name}]", entry) for name, entry in table.get("paper", {}).items()},
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
    _keys(file, "[workpiece]", table, required={"position", "size"}, optional={"abc", "work_offsets"})
    size = _vector(file, "[workpiece] size", table["size"], "m")
    if min(size) <= 0.0:
        raise ScenarioError(f"{file}: [workpiece] size = {table['size']!r}; expected three positive lengths")
    return Workpiece(
        _vector(file, "[workpiece] position", table["position"], "m"),
        size,
        _vector(file, "[workpiece] abc", table.get("abc", [0.0, 0.0, 0.0]), "rad"),
        _work_offsets(file, table.get("work_offsets", {})),
    )


def _work_offsets(file: Path, table: Any) -> dict[float, Vector]:
    """`{G55 = ["10 mm", 0, 0]}` as the reader of programs takes it."""
    known = {f"G{n}": float(n) for n in range(54, 60)}
    _keys(file, "[workpiece] work_offsets", table, required=set(), optional=set(known))
    given = {known[name]: _vector(file, f"[workpiece] work_offsets.{name}", value, "m") for name, value in table.items()}
    return {**PLAIN_OFFSETS, **given}


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
