"""`robomill plan`: plan a program and say what it does, what was skipped, and what is wrong with it before anything is run."""

from __future__ import annotations

import json
import math
import tomllib
from argparse import ArgumentTypeError, Namespace
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robomill.cell.equipment import load_system, robot_of, tool_of
from robomill.cell.milling import check, notes_of, read_program
from robomill.cell.plan_checks import Findings, check_plan
from robomill.cell.scenario import OFFSETS, load_scenario, place_in_block
from robomill.models.model.parameters import load
from robomill.models.planning.gcode import HOME, Program, Setup, Vector
from robomill.models.planning.point_path import PointPath
from robomill.models.planning.reachability import check_reachable
from robomill.models.planning.trajectory import Placement, Plan
from robomill.models.planning.trajectory import plan as plan_path
from robomill.models.process.cutting import EndMill
from robomill.models.robot.kinematics import SPINDLE_ACROSS, Robot, Tool, load_robot
from robomill.option_types import in_unit

_PLACES = {"at", "turn", "start", "home", "offset", "zero", "block", "tool", "dialect", "no_block_delete", "wear"}
"""Options that a scenario has its own keys for."""


@dataclass(frozen=True)
class _Task:
    """What is planned: program, where it stands, and what is wrong with it."""

    program: Program | PointPath
    placement: Placement
    findings: Findings
    robot: Robot
    tool: Tool


def plan(options: Namespace) -> int:
    """Duration, length, extent, reachability, notes and warnings; status 1 with warnings."""
    task = _from_scenario(options) if _is_scenario(options.program) else _from_options(options)
    planned = plan_path(task.program, task.placement)
    check_reachable(planned, task.robot, task.tool, task.robot.q_home)
    if options.out is not None:
        np.save(options.out, planned.table)
    _show(planned, [*notes_of(task.program), *planned.notes], task.findings.texts, options.json)
    return 1 if task.findings.texts else 0


def _is_scenario(file: Path) -> bool:
    if file.suffix != ".toml" or not file.is_file():
        return False
    try:
        return "scenario" in tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        return False  # the reader of point paths names the line


def _from_scenario(options: Namespace) -> _Task:
    given = sorted(f"--{name.replace('_', '-')}" for name in _PLACES if getattr(options, name))
    if given:
        raise ValueError(f"{', '.join(given)} goes with programs; {options.program} is a scenario, which has keys for that (docs/gcode.md)")
    scenario = load_scenario(options.program)
    if scenario.program is None or scenario.workpiece is None:
        raise ValueError(f"{options.program}: a scenario of kind {scenario.kind!r} has no program to plan")
    program = read_program(scenario.program, scenario.reading)
    system = load_system(scenario.system, scenario.equipment)
    placement = scenario.workpiece.placement
    return _Task(program, placement, check(scenario, program, system), robot_of(system), tool_of(system))


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
    mill = load(EndMill, "tools/endmill_d16_z3")  # what milling_force starts with
    if options.tool is not None:
        if options.tool <= 0.0:
            raise ValueError(f"--tool {options.tool:g}: expected a diameter in mm, more than 0")
        mill = EndMill(1e-3 * options.tool, mill.teeth, mill.helix, math.inf)
    program = read_program(options.program, _setup(options, size))
    findings = check_plan(program, size, {0: mill}) if size is not None else Findings()
    return _Task(program, Placement((x, y, z), (math.radians(options.turn or 0.0), 0.0, 0.0)), findings, robot, SPINDLE_ACROSS)


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


def _show(planned: Plan, notes: list[str], warnings: tuple[str, ...], as_json: bool) -> None:
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
            "notes": notes,
            "warnings": list(warnings),
        }
        print(json.dumps(figures, indent=1))
        return
    print(f"{planned.name}: {planned.duration:.2f} s, {planned.length:.3f} m, {len(planned.table)} segments, every pose can be reached")
    print(
        "tool tip in the base, mm: "
        + ", ".join(f"{a} {1e3 * lo:.1f} .. {1e3 * hi:.1f}" for a, lo, hi in zip("xyz", low, high, strict=True))
    )
    for note in notes:
        print(f"note: {note}")
    for text in warnings:
        print(f"warning: {text}")
