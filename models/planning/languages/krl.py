"""KUKA KRL: write a program as a .src file, and read back what was written.

Positions stand in the .src file itself, in mm and deg (A, B, C), against $BASE, of the tool $TOOL: a .dat file is not needed. The
spindle and the tool changer are routines of the cell, SPINDLE(rev/min) and TOOL_CHANGE(number).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from robomill.models.planning.gcode import Vector
from robomill.models.planning.languages.poses import (
    RPM,
    LanguageError,
    PoseProgram,
    Quaternion,
    abc_degrees,
    angle,
    comment,
    frames_as_read,
    number,
    pose_program,
    quaternions,
)

_LONGEST_NAME = 24
_NUMBER = r"([+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)"
_FRAME = r"\{" + ",".join(f"{axis} {_NUMBER}" for axis in "XYZABC") + r"\}"
_AXES = r"\{" + ",".join(f"A{i} {_NUMBER}" for i in range(1, 7)) + r"\}"
_READ = (
    "only the KRL that robomill writes is read back: $BASE, $TOOL, $LOAD, $VEL.CP, $APO.CDIS, LIN, SPLINE with SPL, WAIT SEC, SPINDLE, "
    "TOOL_CHANGE; program the part in G-code, or as a path of points (TOML)"
)


def write_krl(program: PoseProgram) -> str:
    """Text of the .src file: LIN with C_DIS where `program.motion` is ``linear``, SPLINE blocks where it is ``spline``.

    Lengths have four decimals of a mm, angles five of a degree, $VEL.CP six of a m/s, the spindle three of a rev/min. The file
    must have the name after DEF.
    """
    f = program.frames
    out = [f"DEF {krl_name(program.name)} ( )"]
    out += [f"; {comment(text)}" for text in program.header]
    out += ["EXT BAS (BAS_COMMAND :IN,REAL :IN )", "EXT SPINDLE (REAL :IN )", "EXT TOOL_CHANGE (INT :IN )"]
    out += ["BAS (#INITMOV,0 )", "BAS (#VEL_PTP,10 )", "$IPO_MODE=#BASE", "$ORI_TYPE=#VAR", "$ADVANCE=3"]
    out += [f"$BASE={_frame(f.p_BP_B, f.quat_BP)}", f"$TOOL={_frame(f.p_FT_F, f.quat_FT)}"]
    if f.mass > 0.0:
        x, y, z = (number(1e3 * v, 4) for v in f.p_FG_F)
        out.append(f"$LOAD={{M {number(f.mass, 3)},CM {{X {x},Y {y},Z {z},A 0.0,B 0.0,C 0.0}},J {{X 0.0,Y 0.0,Z 0.0}}}}")
    if f.q_start is None:
        out.append("PTP $AXIS_ACT")
    else:
        out.append("PTP {" + ",".join(f"A{i} {number(math.degrees(q), 5)}" for i, q in enumerate(f.q_start, 1)) + "}")
    out += _motions(program)
    return "\n".join([*out, "END", ""])


def krl_name(name: str) -> str:
    """A name that KRL takes: letters, digits and underscores, a letter first, at most 24 of them."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name if name[:1].isalpha() else f"P_{name}")[:_LONGEST_NAME]


def _frame(p: Vector, quat: Quaternion) -> str:
    a, b, c = abc_degrees(np.array([quat]))[0]
    x, y, z = (number(1e3 * v, 4) for v in p)
    return f"{{X {x},Y {y},Z {z},A {angle(a)},B {angle(b)},C {angle(c)}}}"


def _motions(program: PoseProgram) -> Iterator[str]:
    """The statements for all poses; what changes on the way to a pose stands before it."""
    abc = abc_degrees(program.quat).tolist()
    points = (1e3 * program.p).tolist()
    standing = program.standing.tolist()
    speed = distance = spindle = ""
    tool, open_block, block_feed = 0, False, ""
    for i, ((x, y, z), (a, b, c)) in enumerate(zip(points, abc, strict=True)):
        curved = program.motion == "spline" and i > 0 and not program.rapid[i]
        turning, feed = number(program.spindle_speed[i] / RPM, 3), number(program.feed[i], 6)
        if int(program.tool[i]) != tool:
            tool = int(program.tool[i])
            yield f"TOOL_CHANGE ({tool} )"
        if turning != (spindle or "0.000"):
            spindle = turning
            yield f"SPINDLE ({spindle} )"
        if i in program.comments:
            yield f"; {comment(program.comments[i])}"
        target = f"{{X {number(x, 4)},Y {number(y, 4)},Z {number(z, 4)},A {angle(a)},B {angle(b)},C {angle(c)}}}"
        if curved:
            if not open_block:
                block_feed, open_block = feed, True
                yield f"SPLINE WITH $VEL.CP={feed}"
            yield f"SPL {target}" + (f" WITH $VEL.CP={feed}" if feed != block_feed else "")
            if standing[i]:
                open_block = False
                yield "ENDSPLINE"
        else:
            blend = number(1e3 * program.blend[i], 4)
            through = blend != "0.0000"
            if feed != speed:
                speed = feed
                yield f"$VEL.CP={feed}"
            if through and blend != distance:
                distance = blend
                yield f"$APO.CDIS={blend}"
            yield f"LIN {target}" + (" C_DIS" if through else "") + (" ;rapid" if program.rapid[i] else "")
        if program.dwell[i] > 0.0:
            yield f"WAIT SEC {number(program.dwell[i], 3)}"
    if spindle not in ("", "0.000"):
        yield "SPINDLE (0.000 )"


@dataclass
class _Reading:
    """What has been read so far, and what holds from here on."""

    name: str
    base: list[float] | None = None
    tool_frame: list[float] | None = None
    load: list[float] | None = None
    axes: list[float] | None = None
    feed: float = 0.0
    distance: float = 0.0
    spindle: float = 0.0
    tool: int = 0
    in_block: bool = False
    block_feed: float = 0.0
    splines: bool = False
    rows: list[tuple[float, ...]] = field(default_factory=list)
    """X, Y, Z [mm], A, B, C [deg], feed [m/s], blend [mm], spindle [rev/min], tool, rapid, line."""
    dwells: dict[int, float] = field(default_factory=dict)
    header: list[str] = field(default_factory=list)
    comments: dict[int, str] = field(default_factory=dict)
    began: bool = False
    ended: bool = False


_IGNORED = re.compile(r"^(EXT .*|BAS \(#INITMOV,0 \)|BAS \(#VEL_PTP,10 \)|\$IPO_MODE=#BASE|\$ORI_TYPE=#VAR|\$ADVANCE=3|PTP \$AXIS_ACT)$")
_DEF = re.compile(r"^DEF (\w+) ?\( ?\)$")
_BASE_OR_TOOL = re.compile(rf"^\$(BASE|TOOL)={_FRAME}$")
_LOAD = re.compile(
    rf"^\$LOAD=\{{M {_NUMBER},CM \{{X {_NUMBER},Y {_NUMBER},Z {_NUMBER},A 0\.0,B 0\.0,C 0\.0\}},J \{{X 0\.0,Y 0\.0,Z 0\.0\}}\}}$"
)
_PTP = re.compile(rf"^PTP {_AXES}$")
_LIN = re.compile(rf"^LIN {_FRAME}( C_DIS)?( ?;rapid)?$")
_SPL = re.compile(rf"^SPL {_FRAME}(?: WITH \$VEL\.CP={_NUMBER})?$")
_SPLINE = re.compile(rf"^SPLINE WITH \$VEL\.CP={_NUMBER}$")
_SETTING = re.compile(rf"^(\$VEL\.CP=|\$APO\.CDIS=|WAIT SEC |SPINDLE \(|TOOL_CHANGE \(){_NUMBER}(?: \))?$")


def read_krl(text: str, name: str = "program.src") -> PoseProgram:
    """Read a program that `write_krl` wrote. Written again it is the same text.

    LanguageError names the line of the first statement that `write_krl` does not write, and the remedy.
    """
    lines = tuple(text.splitlines())
    r = _Reading(name.rsplit(".", 1)[0])
    for i, line in enumerate(lines, 1):
        found = _statement(r, line.strip(), i)
        if found:
            raise LanguageError(name, i, found, line, _READ)
        if r.ended:
            break
    last = len(lines)
    if not r.ended:
        raise LanguageError(name, last, "the end of the file without END", lines[-1] if lines else "", "the file is cut off; write it anew")
    if r.base is None or r.tool_frame is None:
        missing = "$BASE" if r.base is None else "$TOOL"
        raise LanguageError(
            name, last, f"no {missing}", lines[last - 1], f"write {missing}={{X ..,Y ..,Z ..,A ..,B ..,C ..}} before the moves"
        )
    if len(r.rows) < 2:
        raise LanguageError(name, last, f"{len(r.rows)} moves", lines[last - 1], "a path needs at least two poses")
    return _program(r, lines)


def _program(r: _Reading, lines: tuple[str, ...]) -> PoseProgram:
    """The program of all that was read."""
    assert r.base is not None
    assert r.tool_frame is not None
    rows = np.array(r.rows)
    dwell = np.zeros(len(rows))
    for i, seconds in r.dwells.items():
        dwell[i] = seconds
    base, tool = (np.append(f[:3], quaternions(np.array([f[3:]]))[0]) for f in (r.base, r.tool_frame))
    frames = frames_as_read(base, tool, r.load or (0.0, 0.0, 0.0, 0.0), r.axes)
    return pose_program(
        r.name, frames, 1e-3 * rows[:, :3], quaternions(rows[:, 3:6]), rows[:, 6], 1e-3 * rows[:, 7], RPM * rows[:, 8],
        rows[:, 9].astype(np.int64), dwell, rows[:, 10] > 0.0, "spline" if r.splines else "linear",
        r.comments, r.header, rows[:, 11].astype(np.int64), lines,
    )  # fmt: skip


def _statement(r: _Reading, line: str, i: int) -> str:
    """Take one line; returns what is wrong with it, empty if nothing is."""
    if not line or line.startswith("&"):
        return ""
    if not r.began:
        match = _DEF.match(line)
        r.began = match is not None
        if match is None:
            return "a statement before DEF name ( )"
        r.name = match[1]
        return ""
    if line.startswith(";"):
        if r.base is None and r.tool_frame is None and not r.rows:
            r.header.append(line[1:].strip())
        else:
            r.comments[len(r.rows)] = line[1:].strip()
        return ""
    if line == "END":
        r.ended = True
        return "END inside a SPLINE block" if r.in_block else ""
    return _spline(r, line, i) if r.in_block or line.startswith("SPL") else _other(r, line, i)


def _spline(r: _Reading, line: str, i: int) -> str:
    """A statement of a spline block."""
    if line == "ENDSPLINE" and r.in_block:
        r.in_block = False
        return ""
    match = _SPLINE.match(line)
    if match is not None and not r.in_block:
        r.in_block = r.splines = True
        r.block_feed = float(match[1])
        return "" if r.rows else "SPLINE before the first LIN"
    match = _SPL.match(line)
    if match is None or not r.in_block:
        return "a statement that is not read back"
    pose = [float(v) for v in match.groups()[:6]]
    feed = r.block_feed if match[7] is None else float(match[7])
    r.rows.append((*pose, feed, 0.0, r.spindle, r.tool, 0.0, i))
    return ""


def _other(r: _Reading, line: str, i: int) -> str:
    """A statement outside of spline blocks."""
    match = _LIN.match(line)
    if match is not None:
        if r.feed <= 0.0:
            return "LIN before $VEL.CP"
        if match[7] and r.distance <= 0.0:
            return "C_DIS before $APO.CDIS"
        pose = [float(v) for v in match.groups()[:6]]
        r.rows.append((*pose, r.feed, r.distance if match[7] else 0.0, r.spindle, r.tool, 1.0 if match[8] else 0.0, i))
        return ""
    match = _SETTING.match(line)
    if match is not None:
        return _setting(r, match[1], float(match[2]))
    if _IGNORED.match(line):
        return ""
    for pattern in (_BASE_OR_TOOL, _LOAD, _PTP):
        match = pattern.match(line)
        if match is not None:
            if r.rows:
                return "a frame, load or PTP after the first LIN"
            if pattern is _BASE_OR_TOOL:
                values = [float(v) for v in match.groups()[1:]]
                if match[1] == "BASE":
                    r.base = values
                else:
                    r.tool_frame = values
            elif pattern is _LOAD:
                r.load = [float(v) for v in match.groups()]
            else:
                r.axes = [float(v) for v in match.groups()]
            return ""
    return "a statement that is not read back"


def _setting(r: _Reading, what: str, value: float) -> str:
    """A number that holds from here on, or a dwell."""
    if what == "$VEL.CP=":
        r.feed = value
        return "" if value > 0.0 else "a speed that is not positive"
    if what == "$APO.CDIS=":
        r.distance = value
        return "" if value > 0.0 else "a distance that is not positive"
    if what == "WAIT SEC ":
        if not r.rows:
            return "WAIT before the first LIN"
        r.dwells[len(r.rows) - 1] = value
    elif what == "SPINDLE (":
        r.spindle = value
    elif value.is_integer() and value >= 0.0:
        r.tool = int(value)
    else:
        return "a tool that is no whole number"
    return ""
