"""Write a program as G-code of three axes. `gcode.read` reads it; what it means to a blend is at `write_gcode`."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from robomill.models.model.declaration import FloatArray
from robomill.models.planning.languages.poses import RPM, PoseProgram, comment, number, stops_at
from robomill.models.planning.trajectory import LONGEST_BLEND

_LEAST_TOLERANCE = 1e-6
"""Tolerance [m] that a blend is written with at least: ten times what the fourth decimal of a mm, the last one printed, can say."""
_UPRIGHT = math.radians(1e-3)
"""Angle [rad] by which the tool may lean: 10 nm over a tool of 500 mm, times 1000."""


def write_gcode(program: PoseProgram, tolerance: float | None = None) -> str:
    """Text of an RS-274 program: G0, G1, G4, G61, G64 P, T, M3 to M6; lengths with four decimals of a mm.

    `tolerance` [m] is that of every blend (G64 P). Without it each blend has the tolerance at which the planner makes the same blend of
    it again: its deviation from the corner, but at least a tenth of its distance. Between lines that meet at an angle w that deviation
    is d (1 - 25 a/16) sin(w/2) with a = 12 cos(w/2)/(16 + 14 cos(w/2)), d the blend (control points as in `blend.bezier_control`).
    ValueError where the tool leans or the program is a spline: three axes cannot say that.
    """
    if program.motion == "spline":
        raise ValueError(f"{program.name}: G-code has no splines through poses; write KRL, or a program with motion = 'linear' and blends")
    axis = Rotation.from_quat(np.roll(program.quat, -1, axis=1)).apply([1.0, 0.0, 0.0])
    lean = np.arctan2(np.hypot(axis[:, 0], axis[:, 1]), -axis[:, 2])
    worst = int(np.argmax(lean))
    if lean[worst] > _UPRIGHT:
        raise ValueError(
            f"{program.name}: at pose {worst} the tool leans by {math.degrees(lean[worst]):.3g} deg; G-code of three axes has no "
            "orientation; write KRL or RAPID"
        )
    out = ["%"] + [_bracketed(text) for text in program.header] + ["G21 G90 G17 G40 G49 G80 G94", "G54"]
    return "\n".join([*out, *_motions(program, tolerance), "M30", "%", ""])


def deviations(p: FloatArray, blend: FloatArray) -> FloatArray:
    """Distance [m] (n,) of each pose p (n, 3) from the blend of `blend` [m] that replaces its corner: see `write_gcode`."""
    result = np.zeros(len(p))
    steps = np.diff(p, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    inner = np.flatnonzero((lengths[:-1] > 0.0) & (lengths[1:] > 0.0))
    t = steps / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    across = np.linalg.norm(t[inner + 1] - t[inner], axis=1)  # 2 sin(w/2)
    along = np.linalg.norm(t[inner + 1] + t[inner], axis=1)  # 2 cos(w/2)
    handle = 6.0 * along / (16.0 + 7.0 * along)
    d = np.minimum(blend[inner + 1], 0.5 * np.minimum(lengths[inner], lengths[inner + 1]))
    result[inner + 1] = d * (1.0 - 25.0 / 16.0 * handle) * 0.5 * across
    return result


def _bracketed(text: str) -> str:
    """A comment of G-code; brackets inside it would end it."""
    return f"({comment(text).replace('(', '[').replace(')', ']')})"


def _motions(program: PoseProgram, given: float | None) -> Iterator[str]:
    """The blocks for all poses; what changes on the way to a pose stands before it."""
    least = np.maximum(program.blend / LONGEST_BLEND, _LEAST_TOLERANCE)
    wide = np.maximum(deviations(program.p, program.blend), least) if given is None else given
    tolerance = np.where(program.blend > 0.0, wide, 0.0)
    stops = stops_at(program.dwell, program.spindle_speed, program.tool)
    control, feed, spindle, tool = "", "", "0.000", 0
    for i, p in enumerate((1e3 * program.p).tolist()):
        turning = number(program.spindle_speed[i] / RPM, 3)
        if int(program.tool[i]) != tool:
            tool = int(program.tool[i])
            yield f"T{tool} M6"
        if turning != spindle:
            spindle = turning
            yield "M5" if turning == "0.000" else f"S{turning.lstrip('-')} {'M4' if turning.startswith('-') else 'M3'}"
        if i in program.comments:
            yield _bracketed(program.comments[i])
        wanted = f"G64 P{number(1e3 * tolerance[i], 4)}" if tolerance[i] > 0.0 else "G61"
        # a corner is blended where the moves on both sides are: behind one, a move stays blended, and a rest ends it
        follows = i > 0 and tolerance[i] == 0.0 and tolerance[i - 1] > 0.0
        if wanted != control and not follows:
            control = wanted
            yield wanted
        said = number(6e4 * program.feed[i], 3)
        motion = "G0" if program.rapid[i] else "G1"
        words = "" if program.rapid[i] or said == feed else f" F{said}"
        feed = feed if program.rapid[i] else said
        yield f"{motion} X{number(p[0], 4)} Y{number(p[1], 4)} Z{number(p[2], 4)}{words}"
        if program.dwell[i] > 0.0 or (follows and not stops[i]):
            yield f"G4 P{number(program.dwell[i], 3)}"
    if spindle != "0.000":
        yield "M5"
