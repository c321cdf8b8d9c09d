"""Read a G-code program (RS-274) as CAM systems write it: text in, a tuple of moves in SI out.

Three linear axes, lines, arcs and helices. What is not supported, or malformed, is refused with one
`GCodeError` that says where, what was found and what is supported; nothing is skipped silently.
Meaning of the words: NIST RS274/NGC Interpreter version 3 (NISTIR 6556, 2000), and LinuxCNC for G64 P.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

Vector = tuple[float, float, float]

AXES = "XYZ"
_PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
"""G17..G19: first, second and normal axis of the plane of arcs; right-handed in this order."""
_GROUPS: dict[str, tuple[float, ...]] = {
    "motion": (0, 1, 2, 3, 80),
    "plane": (17, 18, 19),
    "units": (20, 21),
    "cutter compensation": (40,),
    "tool length": (43, 49),
    "work offset": (54, 55, 56, 57, 58, 59),
    "path control": (61, 64),
    "distance": (90, 91),
    "arc centre": (90.1, 91.1),
    "feed mode": (94,),
    "dwell": (4,),
}
_GROUP_OF = {code: group for group, codes in _GROUPS.items() for code in codes}
_M_GROUPS: dict[str, tuple[float, ...]] = {"stop": (2, 30), "spindle": (3, 4, 5), "tool change": (6,), "coolant": (7, 8, 9)}
_M_GROUP_OF = {code: group for group, codes in _M_GROUPS.items() for code in codes}
_LETTERS = "FGHIJKMNOPRSTXYZ"
SUPPORTED_G = " ".join(f"G{code:g}" for code in sorted(_GROUP_OF))
SUPPORTED_M = " ".join(f"M{code:g}" for code in sorted(_M_GROUP_OF))
_WHY_NOT = {
    "G41": "cutter radius compensation (let the CAM system output the centre path)",
    "G42": "cutter radius compensation (let the CAM system output the centre path)",
    "G28": "a move to a machine position, which a robot does not have",
    "G53": "a move in machine coordinates, which a robot does not have",
    "G93": "inverse-time feed",
    "G95": "feed per revolution",
    "#": "a variable",
    "[": "an expression",
    "/": "block delete",
}
_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_RPM = math.pi / 30.0
_SAME_POINT = 1e-9
"""End points of an arc closer than this [m] are one point: a full circle."""
_ARC_ABSOLUTE = 5e-6
_ARC_RELATIVE = 1e-3
"""Start and end radius of an arc may differ by 5 um + 0.1 % (rounding of the CAM system; bounds of LinuxCNC)."""


class GCodeError(ValueError):
    """A program that cannot be read: names file, line, what was found and what is supported."""

    def __init__(self, name: str, line: int, text: str, found: str, supported: str) -> None:
        super().__init__(f"{name} line {line}: {found} in {text.strip()!r}; {supported}")
        self.line = line


@dataclass(frozen=True)
class Move:
    """A straight move in P, from `start` to `end` [m]."""

    line: int
    """Line of the file, from 1."""
    block: int
    """N number; the line where there is none."""
    start: Vector
    end: Vector
    feed: float | None
    """Feed in m/s; None = rapid (G0)."""
    spindle_speed: float
    """rad/s; positive for M3 (clockwise seen from the spindle), negative for M4, 0 for M5."""
    tolerance: float
    """Largest deviation in m when the corner at the end is blended (G64 P); 0 = exact (G61)."""
    tool: int = field(default=0, kw_only=True)
    """Number of the tool in the spindle (T after M6); 0 = none named."""


@dataclass(frozen=True)
class Arc(Move):
    """A circular or helical move in P about the axis through `centre` [m] along the unit vector `axis`."""

    centre: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    angle: float = 0.0
    """Angle travelled in rad, right-handed about `axis`: positive for G3, negative for G2."""


@dataclass(frozen=True)
class Dwell:
    """Standstill for `duration` [s] (G4)."""

    line: int
    block: int
    duration: float
    spindle_speed: float


@dataclass(frozen=True)
class Program:
    """A program that was read: its actions in order, in workpiece coordinates P (the origin of G54), SI."""

    name: str
    actions: tuple[Move | Dwell, ...]
    source: tuple[str, ...]
    """The lines of the file, for messages."""
    tool: int
    """T number, 0 where none is named."""
    final_spindle_speed: float
    """rad/s after the last action (0 after M30)."""


@dataclass
class _State:
    """Modal state of the interpreter; SI, positions in P."""

    position: list[float | None]
    motion: float | None = None
    plane: int = 17
    unit: float = 1e-3
    absolute: bool = True
    absolute_centre: bool = False
    offset: Vector = (0.0, 0.0, 0.0)
    feed: float | None = None
    speed: float | None = None
    direction: int = 0
    tolerance: float = 0.0
    selected_tool: int = 0
    tool: int = 0
    tool_length: bool = False
    ended: bool = False

    @property
    def spindle_speed(self) -> float:
        return self.direction * (self.speed or 0.0)


@dataclass
class _Block:
    """One line: its words, and where it stands, for messages."""

    name: str
    line: int
    text: str
    number: int
    g: dict[str, float] = field(default_factory=dict)
    m: dict[str, float] = field(default_factory=dict)
    words: dict[str, float] = field(default_factory=dict)

    def error(self, found: str, supported: str) -> GCodeError:
        return GCodeError(self.name, self.line, self.text, found, supported)


def parse(
    text: str,
    name: str = "program",
    *,
    tolerance: float = 1e-4,
    work_offsets: Mapping[int, Vector] | None = None,
    start: Vector | None = None,
) -> Program:
    """Read the program `text`.

    `tolerance` [m]: blend tolerance until G61 or G64 P says otherwise, and of a G64 without P.
    `work_offsets` [m]: origins of G54 (54) .. G59 (59) in P; P itself is G54.
    `start` [m]: where the tool stands in P before the first block. Without it the path begins at the first point
    of which all three coordinates are programmed; the rapids that lead there are taken as done.
    Raises GCodeError (a ValueError) at the first thing that is malformed or not supported.
    """
    offsets = {54: (0.0, 0.0, 0.0)} if work_offsets is None else dict(work_offsets)
    source = tuple(text.splitlines())
    state = _State(position=list(start) if start is not None else [None, None, None], tolerance=tolerance)
    state.offset = offsets.get(54, (0.0, 0.0, 0.0))
    actions: list[Move | Dwell] = []
    percent = 0
    for i, line in enumerate(source, start=1):
        stripped = line.strip()
        if stripped == "%":
            percent += 1
            if percent == 2:
                break
            continue
        block = _read_block(name, i, line)
        if block is not None:
            _execute(block, state, actions, tolerance, offsets)
        if state.ended:
            break
    if not actions:
        raise GCodeError(
            name, len(source), source[-1] if source else "", "no move", "a program needs at least one move between two known points"
        )
    return Program(name, tuple(actions), source, state.tool, state.spindle_speed)


def read(path: str | Path, **options: object) -> Program:
    """Read the program file `path`; options as `parse`. FileNotFoundError if there is none."""
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"no program file {file}; expected a G-code file such as scenarios/groove.ngc")
    return parse(file.read_text(encoding="utf-8", errors="replace"), name=file.name, **options)  # type: ignore[arg-type]  # the options of parse, checked there


def _read_block(name: str, line: int, text: str) -> _Block | None:
    """Words of one line; None for an empty one. Comments in ( ) and after ; are dropped, blanks mean nothing."""
    block = _Block(name, line, text, line)
    code, depth = "", 0
    for character in text:
        if character == ";" and depth == 0:
            break
        depth += character == "("
        if depth == 0:
            code += character
        depth -= character == ")"
        if depth not in (0, 1):
            break
    if depth != 0:
        raise block.error("an unclosed or nested comment", "a comment is written (text) on one line, or ; text to the end of the line")
    code = re.sub(r"\s+", "", code).upper()
    if not code:
        return None
    if code[0] == "/":
        raise block.error(f"'/' ({_WHY_NOT['/']}: not supported)", "remove the line or the slash")
    position = 0
    seen_n = False
    while position < len(code):
        match = _WORD.match(code, position)
        if match is None:
            rest = code[position : position + 12]
            why = next((f" ({_WHY_NOT[c]}: not supported)" for c in "#[" if c in rest[:2]), "")
            raise block.error(f"{rest!r}{why}", "expected words of one letter and one number, such as X12.5")
        letter, value = match.group(1), float(match.group(2))
        if letter not in _LETTERS:
            what = "a rotary or secondary axis: orientation changes are read from a TOML path" if letter in "ABCUVW" else "not supported"
            raise block.error(f"{match.group(0)!r} ({what})", f"supported letters: {' '.join(_LETTERS)}")
        if letter == "N":
            if position != 0 or seen_n or not value.is_integer() or value < 0:
                raise block.error(f"{match.group(0)!r}", "the block number is one whole number at the beginning of the line")
            seen_n = True
            block.number = int(value)
        elif letter in "GM":
            _add_code(block, letter, value, match.group(0))
        elif letter in block.words:
            raise block.error(f"two {letter} words", "each letter but G and M may stand once in a line")
        else:
            block.words[letter] = value
        position = match.end()
    return block if (block.g or block.m or block.words) else None


def _add_code(block: _Block, letter: str, value: float, text: str) -> None:
    """Enter a G or M code into its modal group; refuse unknown ones and two of one group."""
    groups, known, names = (_GROUP_OF, block.g, SUPPORTED_G) if letter == "G" else (_M_GROUP_OF, block.m, SUPPORTED_M)
    if value not in groups:
        why = _WHY_NOT.get(f"{letter}{value:g}", "not supported")
        raise block.error(f"{text!r} ({why})", f"supported: {names}")
    group = groups[value]
    if group in known:
        raise block.error(f"{letter}{known[group]:g} and {letter}{value:g}, both of the group '{group}',", "one code of a group per line")
    known[group] = value


def _execute(block: _Block, state: _State, actions: list[Move | Dwell], tolerance: float, offsets: dict[int, Vector]) -> None:
    """Carry out one block in the order of RS274/NGC: settings first, then the move, then the program's end."""
    g, m, words = block.g, block.m, dict(block.words)
    if "O" in words:
        if len(words) > 1 or g or m:
            raise block.error("a program number (O) among other words", "O stands on a line of its own")
        return
    if "units" in g:
        state.unit = 0.0254 if g["units"] == 20 else 1e-3
    _spindle_and_tool(block, state, words)
    if "plane" in g:
        state.plane = int(g["plane"])
    if "tool length" in g:
        state.tool_length = g["tool length"] == 43
    if "H" in words:
        if g.get("tool length") != 43:
            raise block.error(
                "H without G43", "a tool length is selected by G43 H<number>; the tool tip is known, so it has no effect here"
            )
        words.pop("H")
    if "work offset" in g:
        number = int(g["work offset"])
        if number not in offsets:
            given = " ".join(f"G{n}" for n in sorted(offsets))
            raise block.error(
                f"'G{number}', for which no origin is given",
                f"given: {given}; name it in the scenario: [workpiece] work_offsets = {{ G{number} = [x, y, z] }}",
            )
        state.offset = offsets[number]
    if "path control" in g:
        _path_control(block, state, words, tolerance)
    if "distance" in g:
        state.absolute = g["distance"] == 90
    if "arc centre" in g:
        state.absolute_centre = g["arc centre"] == 90.1
    if "dwell" in g:
        _dwell(block, state, words, actions)
    if "motion" in g:
        state.motion = None if g["motion"] == 80 else g["motion"]
    if any(axis in words for axis in AXES) or (state.motion in (2, 3) and any(c in words for c in "IJKR")):
        _move(block, state, words, actions)
    if words:
        left = ", ".join(f"{letter}{value:g}" for letter, value in sorted(words.items()))
        raise block.error(f"{left} without a code that uses it", "I J K R belong to G2/G3, P to G4 and G64, H to G43")
    if "stop" in m:
        state.ended = True
        state.direction = 0


def _spindle_and_tool(block: _Block, state: _State, words: dict[str, float]) -> None:
    """F, S, T, M6, M3..M5; coolant M7..M9 has no effect."""
    m = block.m
    if "F" in words:
        feed = words.pop("F")
        if feed <= 0.0:
            raise block.error(f"feed F{feed:g}", "the feed is a positive number in mm/min (G21) or inch/min (G20)")
        state.feed = feed * state.unit / 60.0
    if "S" in words:
        speed = words.pop("S")
        if speed < 0.0:
            raise block.error(f"spindle speed S{speed:g}", "the spindle speed is a number of rev/min, not negative; M4 turns the other way")
        state.speed = speed * _RPM
    if "T" in words:
        number = words.pop("T")
        if number < 0 or not number.is_integer():
            raise block.error(f"tool T{number:g}", "a tool has a whole number")
        state.selected_tool = int(number)
    if "tool change" in m:
        if state.tool not in (0, state.selected_tool):
            raise block.error(
                f"a change from tool {state.tool} to {state.selected_tool}", "one tool per program; split the program by tool"
            )
        state.tool = state.selected_tool
    if "spindle" in m:
        state.direction = {3: 1, 4: -1, 5: 0}[int(m["spindle"])]
        if state.direction and state.speed is None:
            raise block.error(f"M{m['spindle']:g} without a spindle speed", "name the speed first, such as S13000 M3")


def _path_control(block: _Block, state: _State, words: dict[str, float], tolerance: float) -> None:
    """G61: exact; G64 [P tolerance]: blended."""
    if block.g["path control"] == 61:
        state.tolerance = 0.0
        return
    state.tolerance = tolerance
    if "P" in words and "dwell" not in block.g:
        value = words.pop("P")
        if value <= 0.0:
            raise block.error(f"blend tolerance G64 P{value:g}", "P is a positive length; G61 switches blending off")
        state.tolerance = value * state.unit


def _dwell(block: _Block, state: _State, words: dict[str, float], actions: list[Move | Dwell]) -> None:
    """G4 P<seconds>."""
    seconds = words.pop("P", None)
    if seconds is None or seconds < 0.0 or any(axis in words for axis in AXES) or "motion" in block.g:
        raise block.error(
            "a G4 that is not G4 P<seconds> alone", "a dwell is written G4 P0.5 (seconds, not negative), without a move in the line"
        )
    if actions or all(c is not None for c in state.position):
        actions.append(Dwell(block.line, block.number, seconds, state.spindle_speed))


def _move(block: _Block, state: _State, words: dict[str, float], actions: list[Move | Dwell]) -> None:
    """A G0..G3 move to the programmed point; consumes the words it uses."""
    if state.motion is None:
        axes = ", ".join(f"{a}{words[a]:g}" for a in AXES if a in words)
        raise block.error(f"{axes} without a motion code", "name G0, G1, G2 or G3 first (G80 cancels it)")
    code = int(state.motion)
    start = list(state.position)
    end = list(start)
    for i, axis in enumerate(AXES):
        if axis in words:
            value = words.pop(axis) * state.unit
            known = start[i]
            if state.absolute:
                end[i] = value + state.offset[i]
            elif known is None:
                raise block.error(
                    f"an incremental {axis} before any absolute one", f"program {axis} once with G90, or give the start point"
                )
            else:
                end[i] = known + value
    state.position = end
    unknown = [axis for axis, value in zip(AXES, start, strict=True) if value is None]
    if unknown:
        if code != 0:
            raise block.error(
                f"G{code} while {', '.join(unknown)} is not known",
                "approach with G0 to a point with X, Y and Z first, or give the start point",
            )
        return
    if code != 0 and state.feed is None:
        raise block.error(f"G{code} without a feed", "name the feed first, such as F1500 (mm/min)")
    p0 = (_known(start[0]), _known(start[1]), _known(start[2]))
    p1 = (_known(end[0]), _known(end[1]), _known(end[2]))
    feed = None if code == 0 else state.feed
    common = (block.line, block.number, p0, p1, feed, state.spindle_speed, state.tolerance)
    if code in (2, 3):
        actions.append(Arc(*common, *_arc(block, state, words, code, p0, p1)))
    elif p0 != p1:
        actions.append(Move(*common))


def _known(value: float | None) -> float:
    """A coordinate that the caller has checked."""
    assert value is not None
    return value


def _arc(block: _Block, state: _State, words: dict[str, float], code: int, p0: Vector, p1: Vector) -> tuple[Vector, Vector, float]:
    """Centre, axis and angle of a G2/G3 arc; the centre is moved so that both end points lie on the circle exactly."""
    first, second, normal = _PLANES[state.plane]
    letters = "IJK"
    wrong = [c for c in letters if c in words and letters.index(c) == normal]
    if wrong:
        raise block.error(
            f"{wrong[0]}{words[wrong[0]]:g} with G{state.plane}",
            f"in this plane the centre is given by {letters[first]} and {letters[second]}",
        )
    given = [c for c in letters if c in words]
    if bool(given) == ("R" in words):
        raise block.error(
            f"G{code} with {'both a centre and R' if given else 'neither a centre nor R'}", "give the centre (I J K) or the radius R"
        )
    a0, b0, a1, b1 = p0[first], p0[second], p1[first], p1[second]
    chord = math.hypot(a1 - a0, b1 - b0)
    if chord < _SAME_POINT:
        a1, b1, chord = a0, b0, 0.0
    if given:
        ca, cb = (words.pop(letters[i], None) for i in (first, second))
        if state.absolute_centre:
            a = (ca * state.unit + state.offset[first]) if ca is not None else a0
            b = (cb * state.unit + state.offset[second]) if cb is not None else b0
        else:
            a, b = a0 + (ca or 0.0) * state.unit, b0 + (cb or 0.0) * state.unit
        r0, r1 = math.hypot(a0 - a, b0 - b), math.hypot(a1 - a, b1 - b)
        if r0 == 0.0 or abs(r1 - r0) > _ARC_ABSOLUTE + _ARC_RELATIVE * r0:
            raise block.error(
                f"an arc with radius {r0 * 1e3:.4f} mm at its start and {r1 * 1e3:.4f} mm at its end",
                "both must be equal (within 0.005 mm + 0.1 %) and not zero; check I J K, G90.1/G91.1 and the number of decimals",
            )
    else:
        radius = words.pop("R") * state.unit
        if chord == 0.0:
            raise block.error("a full circle given by R", "give a full circle by its centre (I J K)")
        half = 0.5 * chord
        if abs(radius) < half - _ARC_ABSOLUTE:
            raise block.error(
                f"R{radius / state.unit:g}, smaller than half the distance of the end points", f"at least {half / state.unit:g} is needed"
            )
        height = math.sqrt(max(radius * radius - half * half, 0.0))
        # the centre of a short G3 arc lies left of the chord; a negative R means the long arc
        side = height if (code == 3) == (radius > 0.0) else -height
        a = 0.5 * (a0 + a1) - side * (b1 - b0) / chord
        b = 0.5 * (b0 + b1) + side * (a1 - a0) / chord
    if chord > 0.0:
        na, nb = -(b1 - b0) / chord, (a1 - a0) / chord
        side = (a - 0.5 * (a0 + a1)) * na + (b - 0.5 * (b0 + b1)) * nb
        a, b = 0.5 * (a0 + a1) + side * na, 0.5 * (b0 + b1) + side * nb
        angle = math.atan2(b1 - b, a1 - a) - math.atan2(b0 - b, a0 - a)
        angle = angle % (2.0 * math.pi) if code == 3 else -((-angle) % (2.0 * math.pi))
    else:
        angle = 2.0 * math.pi if code == 3 else -2.0 * math.pi
    centre, axis = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    centre[first], centre[second], centre[normal] = a, b, p0[normal]
    axis[normal] = 1.0
    return (centre[0], centre[1], centre[2]), (axis[0], axis[1], axis[2]), angle
