"""Centre, axis and angle of G2 and G3."""

from __future__ import annotations

import math

from robomill.models.planning.gcode.actions import GCodeError, Vector
from robomill.models.planning.gcode.codes import PLANES
from robomill.models.planning.gcode.state import State
from robomill.models.planning.gcode.words import Block


class AbsoluteCentreError(GCodeError):
    """An arc whose I J K fit as absolute coordinates only, in a program that names neither G90.1 nor G91.1."""


_SAME_POINT = 1e-9
"""End points of an arc closer than this [m] are one point: a full circle."""
_SLACK_MM, _SLACK_INCH = 2e-5 * math.sqrt(2.0), 2e-3 * 0.0254 * math.sqrt(2.0)
"""Start and end radius [m] of an arc may differ by so much: both end and centre rounded to 0.01 mm, or 0.001 inch (LinuxCNC)."""
_SLACK_RELATIVE = 1e-3
"""Or by so much of the radius (LinuxCNC), up to `_MOST` times the absolute slack."""
_MOST = 100.0
_HALF_CHORD = 5e-6
"""R may be so much [m] smaller than half the chord."""


def _agree(state: State, r0: float, r1: float) -> bool:
    """Whether two radii [m] are one but for rounding."""
    slack = _SLACK_INCH if state.unit > 1e-3 else _SLACK_MM
    difference = abs(r1 - r0)
    return r0 > 0.0 and difference <= _MOST * slack and (difference <= slack or difference <= _SLACK_RELATIVE * max(r0, r1))


def arc(block: Block, state: State, words: dict[str, float], code: int, p0: Vector, p1: Vector) -> tuple[Vector, Vector, float]:
    """Centre, axis and angle; the centre is moved so that both end points lie on the circle exactly. Takes I J K R P out of `words`."""
    first, second, normal = PLANES[state.plane]
    letters = "IJK"
    if letters[normal] in words:
        if words[letters[normal]] != 0.0:
            raise block.error(
                f"{letters[normal]}{words[letters[normal]]:g} with G{state.plane}",
                f"in this plane the centre is given by {letters[first]} and {letters[second]}",
            )
        words.pop(letters[normal])
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
        a, b = _centre(block, state, words, (first, second), (a0, b0, a1, b1))
    else:
        a, b = _from_radius(block, state, words.pop("R") * state.unit, code, (a0, b0, a1, b1), chord)
    if chord > 0.0:
        na, nb = -(b1 - b0) / chord, (a1 - a0) / chord
        side = (a - 0.5 * (a0 + a1)) * na + (b - 0.5 * (b0 + b1)) * nb
        a, b = 0.5 * (a0 + a1) + side * na, 0.5 * (b0 + b1) + side * nb
        angle = math.atan2(b1 - b, a1 - a) - math.atan2(b0 - b, a0 - a)
        angle = angle % (2.0 * math.pi) if code == 3 else -((-angle) % (2.0 * math.pi))
    else:
        angle = 2.0 * math.pi if code == 3 else -2.0 * math.pi
    turns = words.pop("P", 1.0)
    if turns < 1.0 or not turns.is_integer():
        raise block.error(f"P{turns:g} with G{code}", "P is the number of turns of a helix, 1 or more")
    angle += math.copysign(2.0 * math.pi * (turns - 1.0), angle)
    centre, axis = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    centre[first], centre[second], centre[normal] = a, b, p0[normal]
    axis[normal] = 1.0
    return (centre[0], centre[1], centre[2]), (axis[0], axis[1], axis[2]), angle


def _centre(
    block: Block, state: State, words: dict[str, float], plane: tuple[int, int], ends: tuple[float, float, float, float]
) -> tuple[float, float]:
    """The centre that I J K give, if both end points are equally far from it."""
    a0, b0, a1, b1 = ends
    ca, cb = (words.pop("IJK"[i], None) for i in plane)
    if state.absolute_centre:
        a = (ca * state.unit + state.offset(plane[0])) if ca is not None else a0
        b = (cb * state.unit + state.offset(plane[1])) if cb is not None else b0
    else:
        a, b = a0 + (ca or 0.0) * state.unit, b0 + (cb or 0.0) * state.unit
    r0, r1 = math.hypot(a0 - a, b0 - b), math.hypot(a1 - a, b1 - b)
    slack = abs(r1 - r0)
    if not _agree(state, r0, r1):
        found = f"an arc with radius {r0 * 1e3:.4f} mm at its start and {r1 * 1e3:.4f} mm at its end, {slack * 1e3:.4f} mm apart (a spiral)"
        expected = (
            "both must be equal (within 0.028 mm, 0.0028 inch or 0.1 %) and not zero; check I J K, G90.1/G91.1 and the number of decimals"
        )
        if not state.centre_named and _fits_absolute(state, ca, cb, plane, ends):
            raise AbsoluteCentreError(block.name, block.line, block.text, found, expected)
        raise block.error(found, expected)
    state.notes.slack = max(state.notes.slack, slack)
    return a, b


def _fits_absolute(
    state: State, ca: float | None, cb: float | None, plane: tuple[int, int], ends: tuple[float, float, float, float]
) -> bool:
    """Whether I J K would be a good centre in absolute coordinates."""
    if state.absolute_centre or ca is None or cb is None:
        return False
    a, b = ca * state.unit + state.offset(plane[0]), cb * state.unit + state.offset(plane[1])
    r0, r1 = math.hypot(ends[0] - a, ends[1] - b), math.hypot(ends[2] - a, ends[3] - b)
    return _agree(state, r0, r1)


def _from_radius(
    block: Block, state: State, radius: float, code: int, ends: tuple[float, float, float, float], chord: float
) -> tuple[float, float]:
    """The centre that R gives."""
    a0, b0, a1, b1 = ends
    if chord == 0.0:
        raise block.error("a full circle given by R", "give a full circle by its centre (I J K)")
    half = 0.5 * chord
    if abs(radius) < half - _HALF_CHORD:
        raise block.error(
            f"R{radius / state.unit:g}, smaller than half the distance of the end points", f"at least {half / state.unit:g} is needed"
        )
    height = math.sqrt(max(radius * radius - half * half, 0.0))
    # the centre of a short G3 arc lies left of the chord; a negative R means the long arc
    side = height if (code == 3) == (radius > 0.0) else -height
    return 0.5 * (a0 + a1) - side * (b1 - b0) / chord, 0.5 * (b0 + b1) + side * (a1 - a0) / chord
