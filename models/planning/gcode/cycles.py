"""Canned cycles G73, G81..G86, G88, G89 as the moves they stand for (RS274/NGC section 3.5.16; G73 as LinuxCNC).

Drilling is motion: the tool plunges along the normal of the plane, and the process model mills with the flat end mill that it has.
"""

from __future__ import annotations

from robomill.models.planning.gcode.actions import Vector
from robomill.models.planning.gcode.codes import PLANES
from robomill.models.planning.gcode.motion import feed_to, move, point, rapid
from robomill.models.planning.gcode.state import AXES, Cycle, State
from robomill.models.planning.gcode.words import Block

PECK_CLEARANCE = 0.254e-3
"""Distance [m] over the last depth at which a peck begins anew, and by which G73 lifts: 0.010 inch (LinuxCNC)."""
_LIFTS_AT_FEED = (84, 85, 89)
_DWELLS = (82, 86, 88, 89)
_WHAT = {
    84: "G84 (tapping): a plunge at feed and back at feed, the spindle turning the other way; no thread is cut",
    86: "G86 (boring): the spindle stops before the tool retracts",
    88: "G88 (boring, out by hand): retracts as a rapid",
}


def drill(block: Block, state: State, words: dict[str, float], code: int) -> None:
    """The holes of one block; takes X Y Z R Q P L K out of `words`."""
    first, second, normal = PLANES[state.plane]
    for i, axis in enumerate(AXES):
        if state.position[i] is None:
            if i != normal and axis in words and state.absolute:
                state.position[i] = words[axis] * state.unit + state.offset(i)  # the rapid there is taken as done
            else:
                state.begin(i)
    here = point(state.position)
    if state.cycle is None:
        state.cycle = Cycle(initial=here[normal])
    cycle = state.cycle
    state.notes.say("drilling cycles: the tool plunges as the end mill that it is; no drill is modelled")
    if code in _WHAT:
        state.notes.say(_WHAT[code])
    if "R" in words:
        cycle.retract = words.pop("R") * state.unit + (state.offset(normal) if state.absolute else here[normal])
    elif cycle.retract is None:
        cycle.retract = cycle.initial
    if AXES[normal] in words:
        cycle.depth = words.pop(AXES[normal]) * state.unit
        cycle.depth += state.offset(normal) if state.absolute else cycle.retract
    if "P" in words:
        value = words.pop("P")
        cycle.dwell = state.seconds(value, not value.is_integer())
    if "Q" in words:
        cycle.peck = abs(words.pop("Q")) * state.unit
    repeats = words.pop("L", words.pop("K", 1.0))
    if repeats < 0.0 or not repeats.is_integer():
        raise block.error(f"{repeats:g} repeats of a cycle", "L (or K) is a whole number")
    if cycle.depth is None:
        raise block.error(f"G{code} without {AXES[normal]}", f"the first block of a cycle names {AXES[normal]} (depth) and R")
    if cycle.depth > cycle.retract:
        raise block.error(
            f"a cycle whose depth {1e3 * cycle.depth:g} mm lies over its retract height R {1e3 * cycle.retract:g} mm",
            "R must be over the depth",
        )
    if code in (73, 83) and not cycle.peck:
        raise block.error(f"G{code} without Q", "Q is the depth of a peck, more than 0")
    across = {axis: words.pop(axis) for axis in (AXES[first], AXES[second]) if axis in words}
    for _ in range(int(repeats)):
        _hole(block, state, dict(across), code, cycle)


def _hole(block: Block, state: State, across: dict[str, float], code: int, cycle: Cycle) -> None:
    """One hole: over it, down to R, in, out."""
    normal = PLANES[state.plane][2]
    assert cycle.retract is not None
    assert cycle.depth is not None

    def at(height: float) -> Vector:
        x, y, z = (height if i == normal else c for i, c in enumerate(point(state.position)))
        return x, y, z

    if point(state.position)[normal] < cycle.retract:
        rapid(block, state, at(cycle.retract))
    move(block, state, across, 0)
    rapid(block, state, at(cycle.retract))
    if code in (73, 83):
        assert cycle.peck is not None
        depth = cycle.retract
        while depth > cycle.depth:
            if depth < cycle.retract:
                rapid(block, state, at(min(depth + PECK_CLEARANCE, cycle.retract)))
            depth = max(depth - cycle.peck, cycle.depth)
            feed_to(block, state, {}, at(depth))
            if depth > cycle.depth:
                rapid(block, state, at(cycle.retract if code == 83 else min(depth + PECK_CLEARANCE, cycle.retract)))
    else:
        feed_to(block, state, {}, at(cycle.depth))
    if code in _DWELLS and cycle.dwell > 0.0:
        state.rest(block, cycle.dwell)
    turning = state.direction
    if code == 84:
        state.direction = -turning
    elif code == 86:
        state.direction = 0
    if code in _LIFTS_AT_FEED:
        feed_to(block, state, {}, at(cycle.retract))
    if not state.retract_to_r and cycle.initial > cycle.retract:
        rapid(block, state, at(cycle.initial))
    else:
        rapid(block, state, at(cycle.retract))
    state.direction = turning
