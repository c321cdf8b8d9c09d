"""The equipment of a cell, named once: robot, tool, material and sensor, for all components that need to know them.

A system, scenario or experiment file says::

    [robot]
    name = "kr210_2"                # a file in models/data/robots; or file = "my_robot.toml", of the same form
    compliance = "kr210_2"          # its virtual joints (models/data/compliance), if they go by another name; or a .toml file
    dynamics = "kr500_r2830"        # its rigid bodies (models/data/dynamics); likewise
    [tool]
    name = "spindle_across"         # models/data/tools: where the tool tip is, mass
    [material]
    name = "aw2017"                 # models/data/materials: cutting coefficients
    [sensor]
    name = "ati_omega160_si2500"    # models/data/sensors: range, resolution, noise; or a spindle holder with strain gauges

A component gets from each part the parameters that it has, by name, in SI units, whether it runs in process or is an FMU. What its own
`parameters` say comes on top. Only the geometry of the machine may not differ there: one machine has one.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment_keys import EquipmentKeys, RobotKeys
from robomill.fmus.components import beside, is_component
from robomill.models.components.sensor_chain import GRAVITY, MOUNTING, ForceSensor
from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import DATA, load
from robomill.models.process.cutting import CuttingCoefficients
from robomill.models.robot.dynamics import RobotDynamics, in_robot_frames
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS, Robot, Tool
from robomill.models.robot.virtual_joints import Compliance
from robomill.orchestration.errors import SystemFileError, unknown
from robomill.orchestration.slaves.protocol import Port, Scalar, arrays
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.parameters import prepare
from robomill.orchestration.system.written import merged, place_of

if TYPE_CHECKING:  # what few systems need is imported where they do: a run begins without it
    from robomill.models.components.spindle_holder import SpindleHolder
    from robomill.models.robot.elastic_modes import ElasticMachine

__all__ = ["load_system", "machine_of", "ports_of", "robot_of", "tool_of"]

Values = Mapping[str, "float | FloatArray"]
"""Parameter -> value in SI."""
_GEOMETRY = ("dh_", "axis_", "q_min", "q_max", "p_FT_F", "quat_FT", "tool_length", "sensor_position", "holder_position", "p_FG_F")
"""How the names of parameters begin that are the same piece of the machine wherever they stand (docs/nomenclature.md)."""
_AXIS_ANGLES = ("q_ref", "q_link", "q_motor", "q")
"""Inputs that are axis angles A1..A6 (docs/nomenclature.md)."""
_SAME = 1e-9
"""Part of the largest element by which geometry may differ: what a conversion of units rounds."""


class _Piece(NamedTuple):
    """One piece of the equipment, looked up."""

    title: str
    """What it is called in the labels of a run."""
    entry: Entry
    """How it was named."""
    values: Values
    lacks: Mapping[str, str]
    """Parameter -> why this part has no value for it, where a component that has the parameter cannot do without."""
    warning: str = ""

    @property
    def said(self) -> str:
        """`[robot] name = "kr210_2"`."""
        return f'{self.entry.name} = "{self.entry.value}"'


def load_system(file: str | Path, named: Mapping[str, Entry] | None = None, sources: Mapping[str, str] | None = None) -> System:
    """Read a system file and give its components the equipment; `named` are tables of the scenario, which go before those of the system.

    `sources`: component -> what stands there instead of the source that the file names, relative to its folder if it is a file.

    SystemFileError, or the error of the file that names the part, with file and line: an unknown part, a part without the data that a
    component needs, a component that has other geometry than the part. A part that no component has parameters of (a recording stands
    for the sensor) is a warning of the system.
    """
    system = System.load(file, convert)
    for component, source in (sources or {}).items():
        system = system.with_source(component, source)
    here = (
        replace(c, source=beside(c.source, system.folder), correction=c.correction and str((system.folder / c.correction).resolve()))
        for c in system.components
    )
    system = replace(system, components=tuple(here))
    equipment = {**system.equipment, **(named or {})}
    return _equipped(replace(system, equipment=equipment)) if equipment else system


def robot_of(system: System) -> Robot:
    """The robot that a system names; the KR 300 R2500 ultra, which the components start with, if it names none."""
    return _load(Robot, _named(system, "robot"), "robots") if "robot" in system.equipment else KR300


def tool_of(system: System) -> Tool:
    """The tool that a system names; the one that the components start with if it names none."""
    return _load(Tool, _named(system, "tool"), "tools") if "tool" in system.equipment else SPINDLE_ACROSS


def machine_of(system: System) -> ElasticMachine | None:
    """Robot, springs, bodies and tool that a system names; None if it names no robot, or one without springs or bodies."""
    if "robot" not in system.equipment:
        return None
    entry = system.equipment["robot"]
    compliance, dynamics = _beside(Compliance, entry, "compliance"), _beside(RobotDynamics, entry, "dynamics")
    if compliance is None or dynamics is None:
        return None
    from robomill.models.robot.elastic_modes import ElasticMachine

    return ElasticMachine(robot=robot_of(system), compliance=compliance, dynamics=dynamics, tool=tool_of(system))


def _equipped(system: System) -> System:
    parts = {role: _PIECES[role](system) for role in system.equipment}
    used = dict.fromkeys(parts, False)
    for c in system.components:
        slave_ports = ports_of(system, c.name)
        ports = [p for p in slave_ports if p.causality == "parameter"]
        own = prepare(c.name, ports, _known(c.parameters, ports), convert, system.folder)
        starts = {p.name: p.start for p in ports}
        given: dict[str, Any] = {}
        variables = arrays(ports)
        for role, part in parts.items():
            for name, members in variables.items():
                if name in part.lacks:
                    raise part.entry.fail(f"component {c.name!r} needs {name}; choose another {role}: {part.lacks[name]}")
                if name not in part.values or not _fits(members, part.values[name]):
                    continue
                used[role] = True
                value = np.asarray(part.values[name], dtype=np.float64).ravel()
                _check_geometry(system, c.name, name, members, own, part, value)
                if any(v != starts[p.name] for v, p in zip(value, members, strict=True)):
                    given[name] = part.values[name] if isinstance(part.values[name], float) else value.tolist()
        equipped = replace(c, parameters=merged(given, c.parameters), inputs=merged(_standing(parts, slave_ports), c.inputs))
        system = replace(system, components=tuple(equipped if d.name == c.name else d for d in system.components))
    labels = {**{role: part.title for role, part in parts.items()}, **system.labels}
    sources = ", ".join(f"{c.name} ({c.source})" for c in system.components)
    idle = [
        f"{part.entry.place}: {part.said}, but no component has parameters of a {role}; components: {sources}"
        for role, part in parts.items()
        if not used[role]
    ]
    warnings = [part.warning for part in parts.values() if part.warning]
    return replace(system, equipped=True, labels=labels, warnings=(*system.warnings, *warnings, *idle))


def ports_of(system: System, component: str) -> Sequence[Port]:
    """Ports of a component; none of a recording, and of what cannot be opened: the assembly says why."""
    source = system.component(component).source
    if is_component(source):
        return resolve(source, component).ports
    if source.endswith(".fmu") and (system.folder / source).is_file():
        import tempfile

        from robomill.orchestration.slaves.description import open_fmu  # only systems with FMUs need FMPy

        with tempfile.TemporaryDirectory(prefix="robomill_") as folder:
            return open_fmu(system.folder / source, Path(folder)).ports
    return ()


def _standing(parts: Mapping[str, _Piece], ports: Sequence[Port]) -> dict[str, Any]:
    """Start values of inputs that are axis angles: those in which the robot waits, as others may lie beyond its limits."""
    if "robot" not in parts:
        return {}
    home = np.asarray(parts["robot"].values["q_start"]).tolist()
    inputs = arrays([p for p in ports if p.causality == "input"])
    return {name: home for name, members in inputs.items() if name in _AXIS_ANGLES and len(members) == len(home)}


def _known(parameters: Mapping[str, Any], ports: Sequence[Port]) -> Mapping[str, Any]:
    """Those that are geometry; the others are looked at when the system is assembled."""
    names = {p.name.partition("[")[0] for p in ports}
    return {k: v for k, v in parameters.items() if k.partition("[")[0] in names and k.startswith(_GEOMETRY)}


def _fits(members: Sequence[Port], value: float | FloatArray) -> bool:
    """Whether a parameter of that name is the same quantity: as many elements."""
    return len(members) == np.size(value) and members[0].type == "real"


def _check_geometry(
    system: System, component: str, name: str, members: Sequence[Port], own: Mapping[str, Scalar], part: _Piece, value: FloatArray
) -> None:
    if not name.startswith(_GEOMETRY):
        return
    most = float(np.abs(value).max(initial=0.0)) or 1.0
    for port, right in zip(members, value, strict=True):
        mine = own.get(port.name)
        if mine is not None and abs(float(mine) - right) > _SAME * most:
            c = system.component(component)
            place = place_of(c.parameters, port.name) or place_of(c.parameters, name) or system.where(c.line).removesuffix(": ")
            unit = f" {port.unit}" if port.unit and port.unit != "1" else ""
            raise SystemFileError(
                f"{place}: component {component!r}: {port.name} is {float(mine):.9g}{unit}, but {part.said} ({part.title}) has {right:.9g}"
                f"{unit}: one machine has one. Take it out here, or name another part for all components"
            )


# Looking up


def _named(system: System, role: str) -> Entry:
    """The entry that says which one."""
    table = (RobotKeys if role == "robot" else EquipmentKeys).of(system.equipment[role])
    for _, entry in table.items():
        entry.text()
    if ("name" in table) == ("file" in table):
        raise table.fail(f'expected either name = "..." or file = "..."; found {", ".join(table.value) or "nothing"}')
    return table["name" if "name" in table else "file"]


def _file(entry: Entry, folder: str) -> Path:
    """The file that an entry names, below models/data or relative to its own."""
    in_data = entry.key[-1] != "file" and not entry.value.endswith(".toml")
    return DATA / folder / f"{entry.value}.toml" if in_data else entry.content.folder / entry.value


def _load(cls: type[Any], entry: Entry, folder: str, also: Callable[[], type[Any]] | None = None) -> Any:
    """The data that an entry names; its error with the names that there are, those of the class that `also` returns with them."""
    try:
        with entry.blamed_for(ValueError):
            return load(cls, _file(entry, folder))
    except FileNotFoundError:
        names = sorted(f.stem for f in (DATA / folder).glob("*.toml") if _is(cls, f) or (also is not None and _is(also(), f)))
        raise entry.fail(unknown(str(entry.key[0]), entry.value, names)) from None


def _is(cls: type[Any], file: Path) -> bool:
    try:
        load(cls, file)
    except ValueError:
        return False
    return True


def _robot(system: System) -> _Piece:
    entry = _named(system, "robot")
    robot: Robot = _load(Robot, entry, "robots")
    values: dict[str, float | FloatArray] = {
        name: getattr(robot, name) for name in ("dh_alpha", "dh_a", "dh_d", "dh_offset", "axis_sign", "axis_coupling", "q_min", "q_max")
    }
    values["q_start"] = robot.q_home
    lacks: dict[str, str] = {}
    if robot.no_closed_form:
        lacks["q_start"] = f"robot {robot.name!r} has no inverse kinematics in closed form: {robot.no_closed_form}"
    compliance = _beside(Compliance, system.equipment["robot"], "compliance")
    if compliance is None:
        there = ", ".join(sorted(f.stem for f in (DATA / "compliance").glob("*.toml")))
        lacks["stiffness"] = (
            f'robot {robot.name!r} has no virtual joints; there are those of {there}; or give [robot] compliance = "my_springs.toml"'
        )
    else:
        values |= {f.name: getattr(compliance, f.name) for f in fields(Compliance)}
        values["damping_time"] = np.broadcast_to(compliance.damping_time, np.shape(compliance.stiffness))
    dynamics = _beside(RobotDynamics, system.equipment["robot"], "dynamics")
    values |= _bodies(dynamics, robot)
    warning = (
        ""
        if dynamics
        else f"robot {robot.name!r} has no rigid bodies in models/data/dynamics: motor torques are those of tool and process alone"
    )
    return _Piece(robot.name, entry, values, lacks, warning)


def _beside(cls: type[Any], table: Entry, key: str) -> Any:
    """Compliance or dynamics of the robot: the one that is named, or the one that goes by the robot's own name; None if there is none."""
    if key in table:
        return _load(cls, table[key], key)
    name = table.get("name", "").value
    return load(cls, f"{key}/{name}") if name and (DATA / key / f"{name}.toml").is_file() else None


def _bodies(dynamics: RobotDynamics | None, robot: Robot) -> dict[str, float | FloatArray]:
    """Parameters of models/robot/dynamics.py; without data a robot without mass, friction and counterbalance."""
    names = ("rotor_inertia", "gear_ratio", "payload_inertia", "gravity_B")
    gas = ("frame_distance", "lever", "area", "gas", "volume", "angle")
    if dynamics is None:
        zero = {"body_mass": np.zeros(6), "body_com": np.zeros((6, 3)), "body_inertia": np.zeros((6, 6)), "rotor_inertia": np.zeros(6)}
        return {**zero, "gear_ratio": np.ones(6), "counterbalance_lever": 0.0, "half_gap": np.zeros(6)}
    com, inertia = in_robot_frames(dynamics, robot)
    return {
        "body_mass": dynamics.body_mass,
        "body_com": com,
        "body_inertia": inertia,
        **{name: getattr(dynamics, name) for name in names},
        **{f"counterbalance_{name}": getattr(dynamics, f"counterbalance_{name}") for name in gas},
        "half_gap": dynamics.backlash_half_gap,
    }


def _tool(system: System) -> _Piece:
    entry = _named(system, "tool")
    tool: Tool = _load(Tool, entry, "tools")
    from_sensor = tool.p_FG_F - MOUNTING.p_FS_F
    weight = np.array([0.0, 0.0, -tool.mass * GRAVITY])
    values: dict[str, float | FloatArray] = {
        "p_FT_F": tool.p_FT_F,
        "quat_FT": tool.quat_FT,
        "tool_length": tool.length,
        "p_FG_F": tool.p_FG_F,
        "payload_mass": tool.mass,
        "payload_com_F": tool.p_FG_F,
        "load_mass": tool.mass,
        "load_cog_S": from_sensor,
        "model_weight_B": weight,
        "model_cog_S": from_sensor,
    }
    return _Piece(tool.name, entry, values, {})


def _material(system: System) -> _Piece:
    entry = _named(system, "material")
    material: CuttingCoefficients = _load(CuttingCoefficients, entry, "materials")
    values = {name: getattr(material, name) for name in ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")}
    return _Piece(entry.value, entry, values, {})


def _sensor(system: System) -> _Piece:
    entry = _named(system, "sensor")
    if _is_holder(entry):
        return _holder(_load(_holder_class(), entry, "sensors"), entry)
    sensor: ForceSensor = _load(ForceSensor, entry, "sensors", also=_holder_class)
    names = ("range_f", "range_m", "resolution_f", "resolution_m", "noise_f", "noise_m", "walk_f", "walk_m")
    return _Piece(sensor.name, entry, {n: getattr(sensor, n) for n in names}, {})


def _holder_class() -> type[SpindleHolder]:
    from robomill.models.components.spindle_holder import SpindleHolder

    return SpindleHolder


def _is_holder(entry: Entry) -> bool:
    """Whether the file that the entry names is of a spindle holder with strain gauges, right or wrong in the rest."""
    file = _file(entry, "sensors")
    try:
        return file.is_file() and "measurement_matrix" in tomllib.loads(file.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError:
        return False


def _holder(holder: SpindleHolder, entry: Entry) -> _Piece:
    """Parameters of spindle_holder: what is identified is taken for true, as long as nothing else is said."""
    weight = np.array([0.0, 0.0, -holder.spindle_mass * GRAVITY])
    values: dict[str, float | FloatArray] = {f.name: getattr(holder, f.name) for f in fields(holder) if f.name != "name"}
    values |= {"zero": holder.bridge_zero, "spindle_weight_B": weight, "spindle_weight_cog": holder.spindle_cog}
    return _Piece(holder.name, entry, values, {})


_PIECES: Mapping[str, Callable[[System], _Piece]] = {"robot": _robot, "tool": _tool, "material": _material, "sensor": _sensor}
