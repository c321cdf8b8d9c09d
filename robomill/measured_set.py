"""Measured sets for identification: rows of axis angles, loads and answers, from TOML files over CSV columns or from run folders.

::

    [robot]
    name = "fanuc_r2000ic"          # models/data/robots; or file = "my_robot.toml"
    springs = "joints"              # stiffness only; or "axes", the default: where the springs of coupled drives are
    [tool]
    name = "spindle_in_line"        # models/data/tools; or p_FT_F = ["6.9 mm", "245.3 mm", "319.3 mm"]
    [q]
    file = "joint_angles.csv"       # beside this file
    columns = ["theta1", "theta2", "theta3", "theta4", "theta5", "theta6"]
    unit = "rad"

and so on for `force`, `moment` and `displacement`. Of a run folder the columns are those of the ports, whatever the component is called.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from robomill.logs.reading import SUFFIXES, read_log
from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import DATA
from robomill.models.model.units import convert
from robomill.models.robot.kinematics import SPINDLE_ACROSS, Robot, Tool, load_robot, load_tool
from robomill.orchestration.errors import OrchestrationError, unknown
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system import keys
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required

COUPLED, APART = "axes", "joints"
_STANDARD = {"robot": "kr300_r2500_ultra", "tool": "spindle_across"}
"""What the components start with: the equipment of simulated runs that name none."""


class MeasuredSetError(OrchestrationError):
    """A measured set cannot be used; the text says what, value, expected, available, remedy."""


@dataclass(frozen=True)
class Quantity:
    """What an identification needs of every pose."""

    name: str
    unit: str
    width: int
    ports: tuple[str, ...]
    """Its names in a run, the preferred one first."""
    needed: bool = True


@dataclass(frozen=True)
class MeasuredSet:
    """Measured rows with the robot and tool that they belong to."""

    robot: Robot
    tool: Tool
    coupled: bool
    """Whether the springs are at the axis angles; False: at the joints, the coupling is one of the display."""
    values: Mapping[str, FloatArray]
    """Quantity -> [n, width] in SI; zeros for one that is not measured and not needed."""


class MeasuredRobotKeys(Keys):
    """The robot, by name or by file."""

    name = optional(keys.text(), "name in models/data/robots")
    file = optional(keys.file(), "a file of that form")
    springs = default(COUPLED, keys.choice((COUPLED, APART)), "where the springs of coupled drives are: at the `axes`, or at the `joints`")


class MeasuredToolKeys(Keys):
    """The tool, by name, by file, or by its tip alone."""

    name = optional(keys.text(), "name in models/data/tools")
    file = optional(keys.file(), "a file of that form")
    p_FT_F = optional(keys.vector("m"), "tool tip from the flange")


class ColumnsKeys(Keys):
    """One quantity of all poses: columns of a table, one row per pose."""

    file = required(keys.file(), "table beside this file, in any format that `robomill import` reads")
    columns = required(keys.texts(), "its columns, one for each element of the quantity")
    unit = required(keys.text(), "their unit")


def read_measured(files: Sequence[Path], quantities: Sequence[Quantity], robot: str | None = None, tool: str | None = None) -> MeasuredSet:
    """Measured sets and runs, one below the other; `robot` and `tool` (names or .toml files) go before what they say themselves.

    MeasuredSetError for what is missing or does not fit, and for sets of different robots, tools or places of the springs.
    """
    sets = [_from_run(f, quantities, robot, tool) if f.is_dir() else _from_toml(f, quantities, robot, tool) for f in files]
    first = sets[0]
    for file, other in zip(files[1:], sets[1:], strict=True):
        same = other.robot.name == first.robot.name and np.array_equal(other.tool.p_FT_F, first.tool.p_FT_F)
        if not same or other.coupled != first.coupled:
            raise MeasuredSetError(
                f"{file} is of {other.robot.name}, tool tip at {_mm(other.tool)} mm, {files[0]} of {first.robot.name}, tool tip at "
                f"{_mm(first.tool)} mm, springs {'alike' if other.coupled == first.coupled else 'elsewhere'}; identify them one by one"
            )
    return replace(first, values={q.name: np.concatenate([s.values[q.name] for s in sets]) for q in quantities})


def read_signals(source: Path, quantities: Sequence[Quantity]) -> dict[str, FloatArray]:
    """Columns of one run folder or TOML file without robot and tool: quantity -> [n, width] in SI, those that are not there left out.

    `time` [n, 1] s is that of the run, of a TOML file the quantity of this name. MeasuredSetError for what is missing or does not fit.
    """
    if source.is_dir():
        run = Run.load(source)
        found = _of_run(run, quantities)
        return {"time": run.t[:, None], **{name: np.reshape(value, (len(run), -1)) for name, value in found.items()}}
    top = _top(source)
    top.keys({q.name for q in quantities if q.needed}, {q.name for q in quantities})
    return _of_tables(top, quantities)


def says(source: Path, name: str) -> bool:
    """Whether a TOML file has the quantity, or a run folder a column `*.name`."""
    if source.is_dir():
        return any(n.partition("[")[0].partition(".")[2] == name for n in Run.load(source).columns)
    return name in _top(source)


def _mm(tool: Tool) -> list[float]:
    return [round(1e3 * float(x), 3) for x in tool.p_FT_F]


def _top(file: Path) -> Entry:
    if not file.is_file():
        raise MeasuredSetError(f"no measured set {file}; expected a TOML file of columns or a run folder, see docs/how_to/identify.md")
    if file.suffix != ".toml":
        raise MeasuredSetError(f"{file} is no measured set: expected a run folder, or a TOML file that says which columns of it are what")
    return Entry.load(file, MeasuredSetError, convert, name=str(file))


def _of_tables(top: Entry, quantities: Sequence[Quantity]) -> dict[str, FloatArray]:
    """The quantities that a TOML file has, all with as many rows."""
    values = {q.name: _columns(top[q.name], q) for q in quantities if q.name in top}
    rows = len(next(iter(values.values())))
    for name, value in values.items():
        if len(value) != rows:
            raise top[name].fail(f"{len(value)} rows, {next(iter(values))} has {rows}; expected one row per pose in each")
    return values


def _from_toml(file: Path, quantities: Sequence[Quantity], robot: str | None, tool: str | None) -> MeasuredSet:
    top = _top(file)
    top.keys({q.name for q in quantities if q.needed}, {"robot", "tool", *(q.name for q in quantities)})
    k = MeasuredRobotKeys
    about = k.of(top.get("robot", {}))
    if robot is None and not about.value.keys() & {"name", "file"}:
        raise top.fail("no robot: expected [robot] with a name of models/data/robots or a file, or the option --robot")
    values = _of_tables(top, quantities)
    rows = len(next(iter(values.values())))
    return MeasuredSet(
        load_robot(robot or k.file.of(about) or about["name"].text()),
        load_tool(tool) if tool else _tool(top.get("tool", {})),
        k.springs.of(about) == COUPLED,
        {q.name: values.get(q.name, np.zeros((rows, q.width))) for q in quantities},
    )


def _tool(entry: Entry) -> Tool:
    k = MeasuredToolKeys
    k.of(entry)
    source, tip = k.file.of(entry) or k.name.of(entry), k.p_FT_F.of(entry)
    tool = SPINDLE_ACROSS if source is None else load_tool(source)
    return tool if tip is None else replace(tool, p_FT_F=np.array(tip))


def _columns(entry: Entry, wanted: Quantity) -> FloatArray:
    """[n, width] in SI of the columns that a table names."""
    k = ColumnsKeys
    k.of(entry)
    file, names = k.file.of(entry), k.columns.of(entry)
    if len(names) != wanted.width:
        raise entry["columns"].expected(f"{wanted.width} names of columns")
    if file.suffix not in SUFFIXES:
        raise entry["file"].fail(f"{unknown('suffix', file.suffix, SUFFIXES)}")
    unit, log = k.unit.of(entry), read_log(file, SUFFIXES[file.suffix])
    with entry["unit"].blamed_for(ValueError):
        factor, offset = convert(1.0, unit, wanted.unit) - convert(0.0, unit, wanted.unit), convert(0.0, unit, wanted.unit)
    return np.stack([log[name] for name in names], axis=1) * factor + offset


def _of_run(run: Run, quantities: Sequence[Quantity]) -> dict[str, FloatArray]:
    """The quantities that a run has."""
    values = {}
    names = dict.fromkeys(n.partition("[")[0] for n in run.columns)
    for q in quantities:
        found = [n for port in q.ports for n in names if n.partition(".")[2] == port]
        if not found and q.needed:
            raise MeasuredSetError(
                f"{run.folder}: no {q.name}: expected a column {' or '.join(f'*.{p}' for p in q.ports)}; it has {', '.join(names)}"
            )
        if found:
            values[q.name] = run[found[0]]
    return values


def _from_run(folder: Path, quantities: Sequence[Quantity], robot: str | None, tool: str | None) -> MeasuredSet:
    run = Run.load(folder)
    values = {q.name: np.zeros((len(run), q.width)) for q in quantities} | _of_run(run, quantities)
    return MeasuredSet(load_robot(robot or labelled(run, "robot")), load_tool(tool or labelled(run, "tool")), True, values)


def labelled(run: Run, role: str) -> str:
    """Name of the file in models/data of the robot or tool that a run is labelled with."""
    label: Any = run.info.get(role, "")
    if not label and run.info.get("kind") == "simulated":
        return _STANDARD[role]
    loader: Callable[[str], Robot | Tool] = load_robot if role == "robot" else load_tool
    known = sorted(f.stem for f in (DATA / f"{role}s").glob("*.toml"))
    for name in known:
        try:
            if label and label in (name, loader(name).name):
                return name
        except ValueError:
            continue  # an end mill is no end effector
    raise MeasuredSetError(
        f"{run.folder} does not say its {role} (label {label!r}): give --{role}, one of {', '.join(known)} or a .toml file"
    )
