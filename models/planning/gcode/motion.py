"""Moves: G0..G3, and the ways home of G28, G30 and G53."""

from __future__ import annotations

import math

from robomill.models.planning.gcode.actions import Arc, Move, Vector
from robomill.models.planning.gcode.arcs import arc
from robomill.models.planning.gcode.state import AXES, State
from robomill.models.planning.gcode.words import Block


def move(block: Block, state: State, words: dict[str, float], code: int) -> None:
    """A G0..G3 move to the programmed point; takes the words it uses out of `words`."""
    end = state.target(block, words)
    if code != 0:
        for i in range(3):
            if state.position[i] is None:
                first = state.begin(i, end[i] if code == 1 else None)
                if end[i] is None:
                    end[i] = first
    if any(c is None for c in state.position):
        state.position = end  # a rapid on the way to the first point that is known: taken as done
        return
    p0, p1 = point(state.position), point(end)
    if code == 0:
        rapid(block, state, p1)
        return
    if code == 1:
        if p0 != p1:
            state.actions.append(_move(block, state, p0, p1, _feed(block, state, words, code, math.dist(p0, p1))))
        else:
            words.pop("F", None)
    else:
        centre, axis, angle = arc(block, state, words, code, p0, p1)
        climb = sum((b - a) * n for a, b, n in zip(p0, p1, axis, strict=True))
        feed = _feed(block, state, words, code, math.hypot(math.dist(p0, centre) * angle, climb))
        said = (block.line, block.number, p0, p1, feed, state.spindle_speed, state.tolerance)
        state.actions.append(Arc(*said, centre, axis, angle, tool=state.tool))
    state.position = list(p1)


def point(position: list[float | None]) -> Vector:
    """A position whose coordinates the caller has checked."""
    x, y, z = position
    assert x is not None
    assert y is not None
    assert z is not None
    return x, y, z


def rapid(block: Block, state: State, end: Vector) -> None:
    """A rapid move from where the tool stands; nothing if it is there."""
    start = point(state.position)
    if start != end:
        state.actions.append(_move(block, state, start, end, None))
        state.position = list(end)


def feed_to(block: Block, state: State, words: dict[str, float], end: Vector) -> None:
    """A feed move from where the tool stands, for cycles; nothing if it is there."""
    start = point(state.position)
    if start != end:
        state.actions.append(_move(block, state, start, end, _feed(block, state, words, 1, math.dist(start, end))))
        state.position = list(end)


def _move(block: Block, state: State, start: Vector, end: Vector, feed: float | None) -> Move:
    return Move(block.line, block.number, start, end, feed, state.spindle_speed, state.tolerance, tool=state.tool)


def _feed(block: Block, state: State, words: dict[str, float], code: int, length: float) -> float:
    """The feed [m/s] of a move of a length [m], in the feed mode that holds."""
    if state.feed_mode == 93:
        rate = words.pop("F", None)
        if not rate or rate < 0.0:
            raise block.error(f"G{code} in inverse time without F", "with G93 every feed move names F, the moves of its kind per minute")
        return length * rate / 60.0
    if not state.feed:
        raise block.error(
            f"G{code} without a feed", 'name the feed first, such as F1500 (mm/min), or give feed = "25 mm/s" beside the program'
        )
    if state.feed_mode == 95:
        if state.spindle_speed == 0.0:
            raise block.error(
                f"G{code} in feed per revolution while the spindle stands", "name speed and direction first, such as S13000 M3"
            )
        return state.feed * abs(state.spindle_speed) / (2.0 * math.pi)
    return state.feed


def go_home(block: Block, state: State, words: dict[str, float], code: float) -> None:
    """G28, G30: over the programmed point home; G53: home. In the axes that are named; in all where G28 names none. Up first."""
    axes = [i for i, axis in enumerate(AXES) if axis in words] or list(range(3))
    if code == 53:
        for axis in AXES:
            words.pop(axis, None)
    elif any(axis in words for axis in AXES):
        if not state.absolute:
            for i, axis in enumerate(AXES):
                if state.position[i] is None:
                    words.pop(axis, None)  # an increment from nowhere, as in G91 G28 Z0 at the beginning: home is what counts
        by_way = state.target(block, words)
        if all(c is not None for c in state.position):
            rapid(block, state, point(by_way))
        state.position = by_way
    words.pop("P", None)  # G30 P2: which of several places
    for group in ((2,), (0, 1)):
        end = list(state.position)
        for i in group:
            if i in axes:
                end[i] = state.home[i]
        if all(c is not None for c in state.position):
            rapid(block, state, point(end))
        state.position = end
    x, y, z = (1e3 * c for c in state.home)
    state.notes.say(
        f"G28, G30 and G53 lead to the home place X{x:g} Y{y:g} Z{z:g} mm of the workpiece frame, in the axes they name, up first: "
        "a robot has no machine zero; give the place with --home X Y Z or home = [..]"
    )
