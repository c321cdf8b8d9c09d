"""`robomill plan`: plan a program and say what it does, what was skipped, and what is wrong with it before anything is run."""

from __future__ import annotations

import json
import math
import tomllib
from argparse import ArgumentTypeError, Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from robomill.cell.equipment import load_system, robot_of, tool_of
from robomill.cell.milling import check, notes_of, read_program
from robomill.cell.plan_checks import Findings, check_plan
from robomill.cell.robot_programs import is_robot_program, read_robot_program
from robomill.cell.scenario import OFFSETS, load_scenario, place_in_block
from robomill.files import vacant
from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import load
from robomill.models.planning.gcode import HOME, Program, Setup, Vector
from robomill.models.planning.languages import PoseProgram, write_gcode, write_krl, write_rapid
from robomill.models.planning.languages.convert import path_of, placement_of, poses_of
from robomill.models.planning.point_path import PointPath
from robomill.models.planning.quantities import QUANTITIES
from robomill.models.planning.reachability import SINGULAR, Reach, Worst, plan_within, survey
from robomill.models.planning.trajectory import Placement, Plan
from robomill.models.planning.trajectory import plan as plan_path
from robomill.models.process.cutting import EndMill
from robomill.models.robot.kinematics import SPINDLE_ACROSS, Robot, Tool, load_robot
from robomill.option_types import in_unit
from robomill.orchestration.system.toml_text import parse
from robomill.tables import Heading, notes, say, show

_PLACES = {"at", "turn", "start", "home", "offset", "zero", "block", "tool", "dialect", "no_block_delete", "wear"}
"""Options that a scenario has its own keys for."""
_LANGUAGES: dict[str, Callable[[PoseProgram], str]] = {".src": write_krl, ".mod": write_rapid, ".ngc": write_gcode}
"""Suffix of a file -> what is written there."""


@dataclass(frozen=True)
class _Task:
    """What is planned: program, where it stands, and what is wrong with it."""

    program: Program | PointPath
    placement: Placement
    findings: Findings
    robot: Robot
    tool: Tool
    q_start: Sequence[float] | FloatArray
    """Axis angles [rad] that choose the branch."""


def plan(options: Namespace) -> int:
    """Duration, length, extent, what is asked of the axes, notes and warnings; status 1 with warnings."""
    if not options.overwrite:
        vacant(*([] if options.out is None else [options.out]), *options.write, option="--out, --write")
    task = _task(options)
    if options.within is None:
        planned = plan_path(task.program, task.placement)
        reach = survey(planned, task.robot, task.tool, task.q_start)
    else:
        planned, reach = plan_within(task.program, task.placement, task.robot, task.tool, task.q_start, options.within)
    if options.out is not None:
        np.save(options.out, planned.table)
    found = [*_write(task, options), *_asked_of_axes(reach), *notes_of(task.program), *planned.notes]
    warnings = (*task.findings.texts, *reach.too_fast(planned))
    _show(planned, reach, found, warnings, options.json)
    return 1 if warnings else 0


def _task(options: Namespace) -> _Task:
    """What the file of the program is, decides how it is read."""
    for file in options.write:
        if file.suffix.lower() not in _LANGUAGES:
            raise ValueError(f"--write {file}: expected a name that ends in {', '.join(_LANGUAGES)}: KUKA KRL, ABB RAPID, G-code")
    if options.spline and not any(file.suffix.lower() == ".src" for file in options.write):
        raise ValueError("--spline goes with --write FILE.src: only KRL has splines through points")
    if _is_scenario(options.program):
        return _from_scenario(options)
    if is_robot_program(options.program) and not options.at:
        return _from_frames(options)
    return _from_options(options)


def _write(task: _Task, options: Namespace) -> list[str]:
    """Write the program for controllers; a note for each file."""
    if not options.write:
        return []
    header = [f"from {options.program.name} by robomill plan, not compensated"]
    poses = poses_of(task.program, task.placement, task.tool, task.q_start, header=header)
    texts = {}
    for file in options.write:
        linear = not (options.spline and file.suffix.lower() == ".src")
        said = poses if linear else replace(poses, motion="spline", blend=np.zeros(len(poses.p)))
        texts[file] = _LANGUAGES[file.suffix.lower()](replace(said, name=file.stem))
    for file, text in texts.items():
        file.write_text(text, encoding="ascii")
    return [f"{file}: {len(poses.p)} poses" for file in texts]


def _asked_of_axes(reach: Reach) -> list[str]:
    """What of accelerations and jerks is above the limits that are taken for any robot."""
    texts = []
    for k, quantity in enumerate(QUANTITIES[1:], 1):
        over = [(w.value, f"A{i + 1} most at line {w.line}") for i, w in enumerate(reach.where[k]) if w.value > 1.0]
        if over:
            worst = max(over)
            texts.append(
                f"axis {quantity} up to {worst[0]:.3g} times the limit taken for any robot (models/data/planning/axis_limits.toml), "
                f"{worst[1]}; a controller slows down there; --within {quantity} lowers the feed of such lines"
            )
    return texts


def _is_scenario(file: Path) -> bool:
    if file.suffix != ".toml" or not file.is_file():
        return False
    try:
        return "scenario" in parse(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        return False  # the reader of point paths names the line


def _from_scenario(options: Namespace) -> _Task:
    given = sorted(f"--{name.replace('_', '-')}" for name in _PLACES if getattr(options, name))
    if given:
        raise ValueError(
            f"{', '.join(given)} goes with programs; {options.program} is a scenario, which has keys for that (docs/how_to/gcode.md)"
        )
    scenario = load_scenario(options.program)
    if scenario.program is None or scenario.workpiece is None:
        raise ValueError(f"{options.program}: a scenario of kind {scenario.kind!r} has no program to plan")
    program = read_program(scenario.program, scenario.reading, options.orientation or scenario.orientation)
    system = load_system(scenario.system, scenario.equipment)
    placement = scenario.workpiece.placement
    robot = robot_of(system)
    return _Task(program, placement, check(scenario, program, system), robot, tool_of(system), robot.q_home)


def _from_frames(options: Namespace) -> _Task:
    """A robot program: its own frames say where the workpiece and the tool are."""
    given = sorted(f"--{name.replace('_', '-')}" for name in _PLACES - {"block", "tool"} if getattr(options, name))
    if given:
        raise ValueError(
            f"{', '.join(given)}: {options.program.name} has its own frames; give --at X Y Z as well to place the workpiece anew"
        )
    poses = read_robot_program(options.program)
    path = replace(path_of(poses), name=options.program.name)
    frames, robot = poses.frames, load_robot(options.robot)
    program = path if options.orientation is None else replace(path, interpolation=options.orientation)
    size = _metres(options.block) if options.block else None
    findings = check_plan(program, size, {0: _mill(options)}) if size is not None else Findings()
    tool = Tool("tool of the program", np.array(frames.p_FT_F), frames.abc_FT, 0.0, frames.mass, np.array(frames.p_FG_F))
    start = robot.q_home if frames.q_start is None else frames.q_start
    return _Task(program, placement_of(frames), findings, robot, tool, start)


def _from_options(options: Namespace) -> _Task:
    x, y, z = (1e-3 * v for v in options.at or (1300.0, 0.0, 1200.0))
    robot = load_robot(options.robot)
    if math.hypot(x, y, z) < float(robot.dh_a[1]):
        raise ValueError(
            f"--at {1e3 * x:g} {1e3 * y:g} {1e3 * z:g}: these are mm, nearer to axis 1 than axis 2 is; if metres are meant, write "
            f'them with their unit: --at "{1e3 * x:g} m" "{1e3 * y:g} m" "{1e3 * z:g} m"'
        )
    size = _metres(options.block) if options.block else None
    if size is not None and min(size) <= 0.0:
        raise ValueError(f"--block {' '.join(f'{v:g}' for v in options.block)}: expected three positive lengths in mm")
    mill = _mill(options)
    program = read_program(options.program, _setup(options, size), options.orientation)
    findings = check_plan(program, size, {0: mill}) if size is not None else Findings()
    placement = Placement((x, y, z), (math.radians(options.turn or 0.0), 0.0, 0.0))
    return _Task(program, placement, findings, robot, SPINDLE_ACROSS, robot.q_home)


def _mill(options: Namespace) -> EndMill:
    """The cutter: what milling_force starts with, or of the diameter that is given."""
    mill = load(EndMill, "tools/endmill_d16_z3")
    if options.tool is None:
        return mill
    if options.tool <= 0.0:
        raise ValueError(f"--tool {options.tool:g}: expected a diameter in mm, more than 0")
    return EndMill(1e-3 * options.tool, mill.teeth, mill.helix, math.inf)


def _setup(options: Namespace, size: Vector | None) -> Setup:
    """How the program is read, from the options."""
    origins: dict[float, Vector] = {54: (0.0, 0.0, 0.0)}
    if options.zero:
        if size is None:
            raise ValueError(f"--zero {options.zero} needs --block LX LY LZ, the size of the block in mm")
        origins[54] = place_in_block(options.zero, size)
    for name, *values in options.offset:
        if name.upper() not in OFFSETS:
            raise ValueError(f"--offset {name}: expected one of {', '.join(OFFSETS)} and X Y Z in mm")
        try:
            origins[OFFSETS[name.upper()]] = _metres([in_unit("mm")(v) for v in values])
        except ArgumentTypeError as error:
            raise ValueError(f"--offset {name} {' '.join(values)}: {error}") from None
    zero = origins[54]
    return Setup(
        work_offsets=origins,
        start=_from_zero(options.start, zero) if options.start else None,
        home=_from_zero(options.home, zero) if options.home else HOME,
        dialect=options.dialect or "linuxcnc",
        block_delete=not options.no_block_delete,
        wear=options.wear,
    )


def _metres(values: list[float]) -> Vector:
    x, y, z = (1e-3 * v for v in values)
    return x, y, z


def _from_zero(values: list[float], zero: Vector) -> Vector:
    x, y, z = (1e-3 * v + o for v, o in zip(values, zero, strict=True))
    return x, y, z


def _show(planned: Plan, reach: Reach, found: list[str], warnings: tuple[str, ...], as_json: bool) -> None:
    extent = planned.position(np.linspace(0.0, planned.duration, 2001))
    low, high = extent.min(axis=0), extent.max(axis=0)
    if as_json:
        figures = {
            "program": planned.name,
            "duration_s": planned.duration,
            "length_m": planned.length,
            "segments": len(planned.table),
            "lowest_m": low.tolist(),
            "highest_m": high.tolist(),
            "axes": _axes(reach),
            "singular": {name: {"nearness": w.value, "line": w.line, "path_time_s": w.tau} for name, w in _singular(reach)},
            "notes": found,
            "warnings": list(warnings),
        }
        print(json.dumps(figures, indent=1))
        return
    say(
        f"{planned.name}: {planned.duration:.2f} s, {planned.length:.3f} m, {len(planned.table)} segments, every pose can be reached",
        "tool tip in the base, mm: "
        + ", ".join(f"{a} {1e3 * lo:.1f} .. {1e3 * hi:.1f}" for a, lo, hi in zip("xyz", low, high, strict=True)),
    )
    rows = [
        [
            f"axis A{axis['axis']}",
            *(f"{100.0 * axis[q]['share']:.0f} %, line {axis[q]['line']}" for q in QUANTITIES),
            f"{axis['margin_deg']:.1f} deg, line {axis['margin_line']}",
        ]
        for axis in _axes(reach)
    ]
    show(
        "axes: largest share of the limit, least way to the end of the travel",
        [Heading("axis", "left"), *map(Heading, (*QUANTITIES, "to the end"))],
        rows,
    )
    say("nearest to singular (0): " + ", ".join(f"{name} {w.value:.2f} at line {w.line}" for name, w in _singular(reach)))
    for text in warnings:
        say(f"warning: {text}")
    notes(found, "what --json prints")


def _axes(reach: Reach) -> list[dict[str, Any]]:
    """Peaks of each axis with their places, for --json and the table."""
    units = ("deg_s", "deg_s2", "deg_s3")
    return [
        {
            "axis": i + 1,
            "margin_deg": math.degrees(reach.margin[i]),
            "margin_line": reach.margin_where[i].line,
            **{
                quantity: {
                    "share": reach.where[k][i].value,
                    units[k]: math.degrees(reach.peaks[k, i]),
                    "limit": math.degrees(reach.limits[k, i]),
                    "line": reach.where[k][i].line,
                    "path_time_s": reach.where[k][i].tau,
                }
                for k, quantity in enumerate(QUANTITIES)
            },
        }
        for i in range(6)
    ]


def _singular(reach: Reach) -> list[tuple[str, Worst]]:
    """Kinds of singular poses and where the plan is nearest to them."""
    return list(zip(SINGULAR, reach.singular, strict=True))
