"""ABB RAPID: write a program as a module (.mod), and read back what was written.

Robtargets stand in the MoveL instructions, in mm and with quaternions (scalar first), in the work object `workpiece` of the tool
`spindle_tool`. Spindle and tool changer are routines of the cell, SpindleSpeed rev/min and ToolChange number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from robomill.models.planning.languages.poses import RPM, LanguageError, PoseProgram, comment, frames_as_read, number, pose_program

_LONGEST_NAME = 32
_NUMBER = r"([+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)"
_THREE, _FOUR, _SIX = (r"\[" + ",".join([_NUMBER] * n) + r"\]" for n in (3, 4, 6))
_NO_AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"
_READ = (
    "only the RAPID that robomill writes is read back: tooldata, wobjdata, speeddata, zonedata, MoveAbsJ, MoveL, WaitTime, SpindleSpeed, "
    "ToolChange; program the part in G-code, or as a path of points (TOML)"
)


def write_rapid(program: PoseProgram) -> str:
    """Text of the module: a MoveL with its speeddata and zonedata for each pose.

    Lengths have four decimals of a mm, quaternions eight, speeds four of a mm/s, the spindle three of a rev/min. ValueError for a
    spline, which RAPID does not have, and where the mass of the end effector, which tooldata need, is not known.
    """
    f = program.frames
    if program.motion == "spline":
        raise ValueError(f"{program.name}: RAPID has no splines through poses; write KRL, or a program with motion = 'linear' and blends")
    if f.mass <= 0.0:
        raise ValueError(
            f"{program.name}: tooldata need the mass of the end effector, found {f.mass:g} kg; give Frames its mass and p_FG_F"
        )
    speeds, zones = _names("feed", program.feed, 4), _names("zone", program.blend[program.blend > 0.0], 4)
    out = [f"MODULE {rapid_name(program.name)}"]
    out += [f"  ! {comment(text)}" for text in program.header]
    load = f"[{number(f.mass, 3)},{_millimetres(f.p_FG_F)},[1,0,0,0],0,0,0]"
    out.append(f"  PERS tooldata spindle_tool:=[TRUE,[{_millimetres(f.p_FT_F)},{_quaternion(f.quat_FT)}],{load}];")
    frame = f"[{_millimetres(f.p_BP_B)},{_quaternion(f.quat_BP)}]"
    out.append(f'  PERS wobjdata workpiece:=[FALSE,TRUE,"",{frame},[[0,0,0],[1,0,0,0]]];')
    out += [f"  CONST speeddata {name}:=[{value},500,5000,1000];" for value, name in speeds.items()]
    for value, name in zones.items():
        wide, turned = number(1.5 * float(value), 4), number(0.15 * float(value), 4)
        out.append(f"  CONST zonedata {name}:=[FALSE,{value},{wide},{wide},{turned},{wide},{turned}];")
    out += ["  PROC main()", r"    ConfL\Off;"]
    if f.q_start is not None:
        angles = ",".join(number(math.degrees(q), 5) for q in f.q_start)
        out.append(f"    MoveAbsJ [[{angles}],{_NO_AXES}],v100,fine,spindle_tool;")
    out += [f"    {text}" for text in _motions(program, speeds, zones)]
    return "\n".join([*out, "  ENDPROC", "ENDMODULE", ""])


def rapid_name(name: str) -> str:
    """A name that RAPID takes: letters, digits and underscores, a letter first, at most 32 of them."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name if name[:1].isalpha() else f"P_{name}")[:_LONGEST_NAME]


def _names(word: str, values: np.ndarray, digits: int) -> dict[str, str]:
    """Printed value in mm -> name, in the order of first use."""
    printed = dict.fromkeys(number(1e3 * v, digits) for v in values.tolist())
    return {text: f"{word}{i}" for i, text in enumerate(printed, 1)}


def _millimetres(p: tuple[float, ...]) -> str:
    return "[" + ",".join(number(1e3 * v, 4) for v in p) + "]"


def _quaternion(quat: tuple[float, ...]) -> str:
    return "[" + ",".join(number(v, 8) for v in quat) + "]"


def _motions(program: PoseProgram, speeds: dict[str, str], zones: dict[str, str]) -> Iterator[str]:
    """The instructions for all poses; what changes on the way to a pose stands before it."""
    spindle, tool = "0.000", 0
    sign = np.where(program.quat[:, :1] < 0.0, -1.0, 1.0)
    for i, (p, quat) in enumerate(zip(program.p.tolist(), (sign * program.quat).tolist(), strict=True)):
        turning = number(program.spindle_speed[i] / RPM, 3)
        if int(program.tool[i]) != tool:
            tool = int(program.tool[i])
            yield f"ToolChange {tool};"
        if turning != spindle:
            spindle = turning
            yield f"SpindleSpeed {spindle};"
        if i in program.comments:
            yield f"! {comment(program.comments[i])}"
        speed = speeds[number(1e3 * program.feed[i], 4)]
        zone = zones[number(1e3 * program.blend[i], 4)] if program.blend[i] > 0.0 else "fine"
        target = f"[{_millimetres(p)},{_quaternion(quat)},[0,0,0,0],{_NO_AXES}]"
        yield rf"MoveL {target},{speed},{zone},spindle_tool\WObj:=workpiece;" + (" ! rapid" if program.rapid[i] else "")
        if program.dwell[i] > 0.0:
            yield f"WaitTime {number(program.dwell[i], 3)};"
    if spindle != "0.000":
        yield "SpindleSpeed 0.000;"


@dataclass
class _Reading:
    """What has been read so far, and what holds from here on."""

    name: str
    tool_frame: list[float] | None = None
    """Position 3 [mm], quaternion 4, mass, centre of gravity 3 [mm]."""
    workpiece: list[float] | None = None
    axes: list[float] | None = None
    speeds: dict[str, float] = field(default_factory=dict)
    zones: dict[str, float] = field(default_factory=lambda: {"fine": 0.0})
    spindle: float = 0.0
    tool: int = 0
    rows: list[tuple[float, ...]] = field(default_factory=list)
    """x, y, z [mm], quaternion, feed [mm/s], blend [mm], spindle [rev/min], tool, rapid, line."""
    dwells: dict[int, float] = field(default_factory=dict)
    header: list[str] = field(default_factory=list)
    comments: dict[int, str] = field(default_factory=dict)
    place: int = 0
    """0 before MODULE, 1 in it, 2 in PROC, 3 behind ENDPROC, 4 at the end."""


_BORDERS = (re.compile(r"^MODULE (\w+)$"), re.compile(r"^PROC main\(\)$"), re.compile(r"^ENDPROC$"), re.compile(r"^ENDMODULE$"))
_TOOL = re.compile(rf"^PERS tooldata spindle_tool:=\[TRUE,\[{_THREE},{_FOUR}\],\[{_NUMBER},{_THREE},\[1,0,0,0\],0,0,0\]\];$")
_WORKPIECE = re.compile(rf'^PERS wobjdata workpiece:=\[FALSE,TRUE,"",\[{_THREE},{_FOUR}\],\[\[0,0,0\],\[1,0,0,0\]\]\];$')
_SPEED = re.compile(rf"^CONST speeddata (\w+):=\[{_NUMBER},500,5000,1000\];$")
_ZONE = re.compile(rf"^CONST zonedata (\w+):=\[FALSE,{_NUMBER}(?:,{_NUMBER}){{5}}\];$")
_ABSOLUTE = re.compile(rf"^MoveAbsJ \[{_SIX},{re.escape(_NO_AXES)}\],v100,fine,spindle_tool;$")
_MOVE = re.compile(rf"^MoveL \[{_THREE},{_FOUR},\[0,0,0,0\],{re.escape(_NO_AXES)}\],(\w+),(\w+),spindle_tool\\WObj:=workpiece;( ! rapid)?$")
_SETTING = re.compile(rf"^(WaitTime|SpindleSpeed|ToolChange) {_NUMBER};$")


def read_rapid(text: str, name: str = "program.mod") -> PoseProgram:
    """Read a program that `write_rapid` wrote. Written again it is the same text.

    LanguageError names the line of the first statement that `write_rapid` does not write, and the remedy.
    """
    lines = tuple(text.splitlines())
    r = _Reading(name.rsplit(".", 1)[0])
    for i, line in enumerate(lines, 1):
        found = _statement(r, line.strip(), i)
        if found:
            raise LanguageError(name, i, found, line, _READ)
    last, end = len(lines), lines[-1] if lines else ""
    if r.place < len(_BORDERS):
        raise LanguageError(name, last, "the end of the file without ENDMODULE", end, "the file is cut off; write it anew")
    if r.tool_frame is None or r.workpiece is None:
        missing = "tooldata spindle_tool" if r.tool_frame is None else "wobjdata workpiece"
        raise LanguageError(name, last, f"no {missing}", end, "they stand before PROC main(); write the file anew")
    if len(r.rows) < 2:
        raise LanguageError(name, last, f"{len(r.rows)} moves", end, "a path needs at least two poses")
    return _program(r, lines)


def _program(r: _Reading, lines: tuple[str, ...]) -> PoseProgram:
    """The program of all that was read."""
    assert r.tool_frame is not None
    assert r.workpiece is not None
    rows, tool = np.array(r.rows), np.array(r.tool_frame)
    dwell = np.zeros(len(rows))
    for i, seconds in r.dwells.items():
        dwell[i] = seconds
    frames = frames_as_read(np.array(r.workpiece), tool[:7], tool[7:].tolist(), r.axes)
    return pose_program(
        r.name, frames, 1e-3 * rows[:, :3], rows[:, 3:7], 1e-3 * rows[:, 7], 1e-3 * rows[:, 8],
        RPM * rows[:, 9], rows[:, 10].astype(np.int64), dwell, rows[:, 11] > 0.0, "linear", r.comments, r.header,
        rows[:, 12].astype(np.int64), lines,
    )  # fmt: skip


def _statement(r: _Reading, line: str, i: int) -> str:
    """Take one line; returns what is wrong with it, empty if nothing is."""
    if not line:
        return ""
    if r.place < len(_BORDERS):
        match = _BORDERS[r.place].match(line)
        if match is not None:
            r.place += 1
            r.name = match[1] if r.place == 1 else r.name
            return ""
    if r.place == 0:
        return "a statement before MODULE name"
    if line.startswith("!"):
        if r.place == 1:
            r.header.append(line[1:].strip())
        else:
            r.comments[len(r.rows)] = line[1:].strip()
        return ""
    return (_data, _instruction)[r.place - 1](r, line, i) if r.place in (1, 2) else "a statement behind ENDPROC"


def _data(r: _Reading, line: str, i: int) -> str:
    """A declaration."""
    match = _SPEED.match(line) or _ZONE.match(line)
    if match is not None:
        (r.speeds if "speeddata" in line else r.zones)[match[1]] = float(match[2])
        return "" if float(match[2]) > 0.0 else "a speed or zone that is not positive"
    for pattern in (_TOOL, _WORKPIECE):
        match = pattern.match(line)
        if match is not None:
            values = [float(v) for v in match.groups()]
            if not _is_unit(values[3:7]):
                return "a quaternion that is not of unit length"
            if pattern is _TOOL:
                r.tool_frame = values
            else:
                r.workpiece = values
            return ""
    return "a declaration that is not read back"


def _instruction(r: _Reading, line: str, i: int) -> str:
    """An instruction of PROC main."""
    match = _MOVE.match(line)
    if match is not None:
        if match[8] not in r.speeds or match[9] not in r.zones:
            return f"{match[9] if match[8] in r.speeds else match[8]}, which is not declared above,"
        numbers = [float(v) for v in match.groups()[:7]]
        if not _is_unit(numbers[3:]):
            return "a quaternion that is not of unit length"
        r.rows.append((*numbers, r.speeds[match[8]], r.zones[match[9]], r.spindle, r.tool, 1.0 if match[10] else 0.0, i))
        return ""
    match = _SETTING.match(line)
    if match is not None:
        value = float(match[2])
        if match[1] == "SpindleSpeed":
            r.spindle = value
        elif match[1] == "ToolChange":
            r.tool = int(value)
            return "" if value.is_integer() and value >= 0.0 else "a tool that is no whole number"
        elif not r.rows:
            return "WaitTime before the first MoveL"
        else:
            r.dwells[len(r.rows) - 1] = value
        return ""
    match = _ABSOLUTE.match(line)
    if match is not None:
        r.axes = [float(v) for v in match.groups()]
        return "MoveAbsJ after the first MoveL" if r.rows else ""
    return "" if line == r"ConfL\Off;" else "an instruction that is not read back"


def _is_unit(quat: list[float]) -> bool:
    return abs(math.hypot(*quat) - 1.0) <= _PRINTED


_PRINTED = 1e-6
"""Quaternions may differ from unit length by so much: eight decimals leave 2e-8."""
