"""Carry out the blocks of a program in the order of RS274/NGC: settings first, then the move, then stops and the end."""

from __future__ import annotations

import re
from pathlib import Path

from robomill.models.planning.gcode import codes
from robomill.models.planning.gcode.actions import GCodeError, Move, Program
from robomill.models.planning.gcode.arcs import AbsoluteCentreError
from robomill.models.planning.gcode.cycles import drill
from robomill.models.planning.gcode.motion import go_home, move
from robomill.models.planning.gcode.notes import Notes
from robomill.models.planning.gcode.state import AXES, RPM, Setup, State
from robomill.models.planning.gcode.words import Block, blocks, lines, named_diameters, read_text, without_comments

_TOOL_CHANGE = re.compile(r"M\s*0*6(?![\d.])", re.IGNORECASE)
_ROTARY = {"A": "rotary axis A", "B": "rotary axis B", "C": "rotary axis C"}
_SECONDARY = {"U": "secondary axis U", "V": "secondary axis V", "W": "secondary axis W"}
_TAKE_AXES = (22, 43.1, 50)
"""Skipped G codes that take the axis words of their block with them."""
_OFFSETS = (54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3)
"""P1..P9 of G10."""


def parse(text: str, name: str = "program", setup: Setup | None = None) -> Program:
    """Read the program `text`; `setup` says what the program does not.

    Raises GCodeError (a ValueError) at the first thing that is malformed, or that would change the path and is not built; what has
    no effect on the path is skipped and counted in `Program.notes`.
    """
    source = lines(text)
    try:
        return _carry_out(source, name, setup or Setup(), absolute_centre=False)
    except AbsoluteCentreError as error:
        try:
            return _carry_out(source, name, setup or Setup(), absolute_centre=True)
        except GCodeError:
            raise error from None


def _carry_out(source: tuple[str, ...], name: str, setup: Setup, absolute_centre: bool) -> Program:
    """All blocks. `absolute_centre`: how I J K are taken until the program says."""
    notes = Notes()
    state = State(setup, notes, [None, None, None], dict(setup.work_offsets), list(setup.home), tolerance=setup.tolerance)
    state.origins.setdefault(54, (0.0, 0.0, 0.0))
    state.feed, state.absolute_centre = setup.feed, absolute_centre
    if absolute_centre:
        notes.say("arc centres I J K are taken as absolute (G90.1): only so do the radii of the arcs fit")
    if setup.start is not None:
        state.position = list(setup.start)
    if setup.spindle_speed is not None:
        state.speed, state.direction = setup.spindle_speed, 1
    changes_tools = any(_changes_tool(line) for line in source)
    last = Block(name, len(source), source[-1], 0)
    for block in blocks(name, source, notes, setup.block_delete):
        last = block
        _execute(block, state, changes_tools)
        if state.ended:
            break
    if not any(isinstance(action, Move) for action in state.actions):
        raise last.error("no move", "a program needs at least one move between two known points")
    return Program(name, tuple(state.actions), source, state.tool, state.spindle_speed, notes.texts, named_diameters(source, state.unit))


def read(path: str | Path, setup: Setup | None = None) -> Program:
    """Read the program file `path`; else as `parse`. FileNotFoundError if there is none."""
    text, name = read_text(path)
    return parse(text, name, setup)


def _changes_tool(line: str) -> bool:
    """Whether M6 stands in a line, outside of comments."""
    return _TOOL_CHANGE.search(line) is not None and _TOOL_CHANGE.search(without_comments(line) or "") is not None


def _execute(block: Block, state: State, changes_tools: bool) -> None:
    """Carry out one block."""
    words = block.words
    g = _g_codes(block, state, words)
    stops = _m_codes(block, state, words)
    if "O" in words:
        words.pop("O")  # the number of the program
    if "units" in g:
        state.unit = 0.0254 if g["units"] in (20, 70) else 1e-3
    _other_letters(block, state, words, g)
    _feed_and_speed(block, state, words, g)
    _tool(block, state, words, changes_tools)
    _modes(block, state, words, g)
    _action_or_motion(block, state, words, g)
    if words:
        left = ", ".join(f"{letter}{value:g}" for letter, value in sorted(words.items()))
        raise block.error(f"{left} without a code that uses it", "I J K R belong to G2/G3 and cycles, P Q L to G4, G10, G64 and cycles")
    if stops:
        state.rest(block)
    if any(code in codes.ENDS for code in block.m):
        state.ended = True
        state.direction = 0


def _g_codes(block: Block, state: State, words: dict[str, float]) -> dict[str, float]:
    """Group -> code; refuses what is not built, and two codes of a group; notes what has no effect."""
    g: dict[str, float] = {}
    for code in block.g:
        group = codes.GROUP_OF.get(code)
        if group is not None:
            if g.get(group, code) != code:
                raise block.error(f"G{g[group]:g} and G{code:g}, both of the group '{group}',", "one code of a group per line")
            g[group] = code
        elif code in codes.SKIPPED_G:
            state.notes.skip(f"G{code:g}", codes.SKIPPED_G[code])
            for letter in [c for c in words if (c not in AXES and c not in "FST") or code in _TAKE_AXES]:
                words.pop(letter)
        else:
            why = codes.REFUSED_G.get(code)
            raise block.error(f"'G{code:g}' ({why + ': ' if why else ''}not supported)", f"supported: {codes.SUPPORTED_G}")
    return g


def _m_codes(block: Block, state: State, words: dict[str, float]) -> bool:
    """Spindle, and notes on what has no effect; whether the path rests after the block."""
    stops = False
    known = True
    for code in block.m:
        if code in codes.REFUSED_M:
            raise block.error(
                f"'M{code:g}' ({codes.REFUSED_M[code]}: not supported)", "let the CAM system write the program without subprograms"
            )
        if code in codes.STOPS:
            state.notes.skip(f"M{code:g}", codes.STOPS[int(code)])
            stops = True
        elif code in codes.SKIPPED_M:
            state.notes.skip(f"M{code:g}", codes.SKIPPED_M[code])
        elif code == 99:
            state.notes.say("M99: the program would begin again; it is read once")
        elif code not in codes.SPINDLE and code not in codes.ENDS and code != codes.TOOL_CHANGE:
            state.notes.skip(f"M{code:g}", codes.OTHER_M)
            known = False
    if not known:
        for letter in [c for c in words if c not in AXES and c not in "FT" and not (c == "S" and _turns(block))]:
            words.pop(letter)
    if block.m and not block.g and not any(axis in words for axis in AXES):
        words.pop("P", None)  # M3 P0, M0 P..: of other controls
    return stops


def _turns(block: Block) -> bool:
    """Whether the block switches the spindle."""
    return any(code in codes.SPINDLE for code in block.m)


def _other_letters(block: Block, state: State, words: dict[str, float], g: dict[str, float]) -> None:
    """H, D, E and further axes: noted where they have no effect."""
    if g.get("tool length") == 43:
        number = f" H{words.pop('H'):g}" if "H" in words else ""
        state.notes.skip(f"G43{number}", codes.SKIPPED_G[43.1])
    if "H" in words:
        state.notes.skip(f"H{words.pop('H'):g}", codes.SKIPPED_G[43.1])
    if "D" in words and g.get("cutter compensation") not in (41, 42):
        state.notes.skip(f"D{words.pop('D'):g}", "a tool radius without G41 or G42")
    if "E" in words:
        words.pop("E")
        state.notes.skip("E", "an extruder")
    for letter, name in (*_ROTARY.items(), *_SECONDARY.items()):
        if letter in words and not (letter == "U" and g.get("action") == 4):
            if words[letter] != 0.0:
                remedy = "orientation changes are read from a TOML path" if letter in _ROTARY else "X, Y and Z are read"
                raise block.error(f"'{letter}{words[letter]:g}' ({name}: not supported)", f"{remedy}; {letter}0 is read as no movement")
            words.pop(letter)
            state.notes.skip(f"{letter}0", "a further axis at zero")


def _feed_and_speed(block: Block, state: State, words: dict[str, float], g: dict[str, float]) -> None:
    """G93..G95, F, S, M3..M5."""
    if "feed mode" in g and int(g["feed mode"]) != state.feed_mode:
        state.feed_mode, state.feed = int(g["feed mode"]), None
    if "F" in words and state.feed_mode != 93:
        feed = words.pop("F")
        if feed < 0.0:
            raise block.error(f"feed F{feed:g}", "the feed is a positive number in mm/min (G21) or inch/min (G20)")
        state.feed = feed * state.unit / (60.0 if state.feed_mode == 94 else 1.0)
    dwells = g.get("action") == 4 and not _turns(block) and not words.keys() & set("PXU")
    if "S" in words and not dwells:
        speed = words.pop("S")
        if speed < 0.0:
            raise block.error(f"spindle speed S{speed:g}", "the spindle speed is a number of rev/min, not negative; M4 turns the other way")
        state.speed = speed * RPM
    turns = {codes.SPINDLE[int(code)] for code in block.m if code in codes.SPINDLE}
    if len(turns) > 1:
        names = " and ".join(f"M{code:g}" for code in block.m if code in codes.SPINDLE)
        raise block.error(f"{names}, both of the group 'spindle',", "one code of a group per line")
    for direction in turns:
        state.direction = direction


def _tool(block: Block, state: State, words: dict[str, float], changes_tools: bool) -> None:
    """T and M6; without any M6 in the program, T alone changes the tool."""
    if "T" in words:
        number = words.pop("T")
        if number < 0 or not number.is_integer():
            raise block.error(f"tool T{number:g}", "a tool has a whole number")
        state.selected_tool = int(number)
    if (codes.TOOL_CHANGE in block.m or not changes_tools) and state.tool != state.selected_tool:
        state.tool = state.selected_tool
        state.rest(block)
    if not changes_tools and state.tool:
        state.notes.say("no M6 in the program: T alone changes the tool")


def _modes(block: Block, state: State, words: dict[str, float], g: dict[str, float]) -> None:
    """Plane, compensation, work offset, path control, distance, centres, retract height, cycles off."""
    if "plane" in g:
        state.plane = int(g["plane"])
    if g.get("cutter compensation") in (41, 42):
        code = f"G{g['cutter compensation']:g}"
        if not state.setup.wear:
            raise block.error(
                f"'{code}' (cutter radius compensation: not supported)",
                "let the CAM system output the centre path; if it has, and D corrects wear only, say so with --wear or wear = true",
            )
        words.pop("D", None)
        state.notes.skip(code, "correction of wear; the program has the centre path")
    if "work offset" in g:
        _work_offset(block, state, g["work offset"])
    if "path control" in g:
        _path_control(block, state, words, g)
    if "distance" in g:
        state.absolute = g["distance"] == 90
    if "arc centre" in g:
        state.absolute_centre, state.centre_named = g["arc centre"] == 90.1, True
    if "retract" in g:
        state.retract_to_r = g["retract"] == 99
    if "cancel" in g:
        state.cancel_cycle()
    if "motion" in g:
        state.begin_motion(int(g["motion"]))


def _work_offset(block: Block, state: State, system: float) -> None:
    """G54..G59.3. The only one of a program is the zero of the workpiece, whatever its number."""
    if system not in state.origins or (system != 54 and system not in state.setup.work_offsets and not state.used):
        if state.used - {system}:
            given = ", ".join(f"G{n:g}" for n in sorted(state.origins))
            raise block.error(
                f"'G{system:g}', for which no origin is given",
                f"given: {given}; name it with --offset G{system:g} X Y Z, or in the scenario: [workpiece] "
                f'work_offsets = {{ "G{system:g}" = [x, y, z] }}',
            )
        state.origins[system] = state.origins[54]
        state.notes.say(f"G{system:g}: no origin given; it is the only work offset so far and taken as the zero of the workpiece")
    state.system = system


def _path_control(block: Block, state: State, words: dict[str, float], g: dict[str, float]) -> None:
    """G61, G61.1: exact; G64 [P tolerance]: blended."""
    if g["path control"] != 64:
        state.tolerance = 0.0
        return
    state.tolerance = state.setup.tolerance
    if g.get("action") != 4:
        value = words.pop("P", 0.0)
        if value < 0.0:
            raise block.error(f"blend tolerance G64 P{value:g}", "P is a length, not negative; G61 switches blending off")
        if value > 0.0:
            state.tolerance = value * state.unit
    if "Q" in words:
        state.notes.skip(f"G64 Q{words.pop('Q'):g}", "merging of short lines")


def _action_or_motion(block: Block, state: State, words: dict[str, float], g: dict[str, float]) -> None:
    """What the axis words of a block are for: one of G4, G10, G28, G30, G52, G53, G92, or the motion."""
    action = g.get("action")
    if action == 4:
        _dwell(block, state, words)
    elif action == 10:
        _set_offsets(block, state, words)
    elif action in (28, 30):
        go_home(block, state, words, action)
    elif action in (28.1, 30.1):
        state.home = [c if c is not None else h for c, h in zip(state.position, state.home, strict=True)]
    elif action is not None:
        _shift(state, words, action)
    elif "machine" in g:
        go_home(block, state, words, 53)
    elif any(c in words for c in "XYZ") or (state.motion in (2, 3) and any(c in words for c in "IJKR")):
        if state.motion is None:
            state.notes.say("axis words before any of G0..G3: taken as G0")
            state.motion = 0
        tolerance = state.tolerance
        if "exact" in g:
            state.tolerance = 0.0
        if state.motion in codes.CYCLES:
            drill(block, state, words, int(state.motion))
        else:
            move(block, state, words, int(state.motion))
        state.tolerance = tolerance
    elif state.motion in codes.CYCLES and "motion" in g:
        drill(block, state, words, int(state.motion))
    elif state.feed_mode == 93:
        words.pop("F", None)


def _dwell(block: Block, state: State, words: dict[str, float]) -> None:
    """G4 P, or G4 X, U or S in seconds."""
    given = [letter for letter in "PXUS" if letter in words]
    value = words.pop(given[0]) if given else -1.0
    if value < 0.0 or len(given) > 1:
        raise block.error(
            "a G4 that is not G4 P<time> alone", "a dwell is written G4 P0.5 (seconds; dialect says otherwise), or G4 X, U or S"
        )
    decimal_point = re.search(r"P\s*\d*\.", block.text, re.IGNORECASE) is not None
    seconds = state.seconds(value, decimal_point) if given == ["P"] else value
    if given == ["P"] and state.setup.dialect == "linuxcnc" and value >= 100.0 and not decimal_point:
        state.notes.say(f"G4 P{value:g} is {value:g} s, as in LinuxCNC; where P counts milliseconds give the dialect fanuc")
    state.rest(block, seconds)


def _set_offsets(block: Block, state: State, words: dict[str, float]) -> None:
    """G10 L2 (origin of a work offset) and L20 (origin so that the tool stands at the given place)."""
    what, number = words.pop("L", -1.0), words.pop("P", 0.0)
    if what in (1, 10, 11, 12, 13):
        state.notes.skip(f"G10 L{what:g}", "the tool table of the control")
        for letter in [c for c in words if c not in "FST"]:
            words.pop(letter)
        return
    if what not in (2, 20) or not (number.is_integer() and 0 <= number <= len(_OFFSETS)):
        raise block.error(f"G10 L{what:g} P{number:g}", "G10 L2 and L20 with P0..P9 set work offsets; L1, L10..L13 have no effect here")
    if words.pop("R", 0.0) != 0.0:
        raise block.error("a turned work offset (G10 R)", "turn the workpiece instead: [workpiece] abc, or plan --turn")
    system = state.system if number == 0 else _OFFSETS[int(number) - 1]
    origin = list(state.origins.get(system, state.origins[54]))
    for i, axis in enumerate(AXES):
        if axis in words:
            value = words.pop(axis) * state.unit
            if what == 2:
                origin[i] = value
            else:
                known = state.position[i]
                if known is None:
                    state.position[i] = origin[i] + value
                else:
                    origin[i] = known - value - state.shift[i] - state.local[i]
    state.origins[system] = (origin[0], origin[1], origin[2])
    if what == 2:
        state.notes.say("G10 L2: origins are set in the workpiece frame (a robot has no machine zero)")


def _shift(state: State, words: dict[str, float], action: float) -> None:
    """G52, G92 and G92.1..G92.3: program zero is shifted."""
    if action == 92.1:
        state.shift, state.shift_kept = [0.0] * 3, [0.0] * 3
    elif action == 92.2:
        state.shift = [0.0] * 3
    elif action == 92.3:
        state.shift = list(state.shift_kept)
    for i, axis in enumerate(AXES):
        if axis in words and action in (52, 92):
            value = words.pop(axis) * state.unit
            origin = state.origins[state.system][i]
            known = state.position[i]
            if action == 52:
                state.local[i] = value
            elif known is None:
                state.position[i] = origin + state.local[i] + value
                state.notes.say("G92 before the first move: the tool is taken to stand where G92 says")
            else:
                state.shift[i] = known - origin - state.local[i] - value
                state.shift_kept = list(state.shift)
