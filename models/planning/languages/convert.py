"""From a program that was read to poses, and from poses to a path that is planned."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from robomill.models.model.declaration import FloatArray
from robomill.models.planning.blend import blend
from robomill.models.planning.gcode import Arc, Dwell, Move, Program
from robomill.models.planning.languages.poses import Frames, PoseProgram, pose_program
from robomill.models.planning.path_geometry import Shape, helix, line
from robomill.models.planning.point_path import PathPoint, PointPath
from robomill.models.planning.trajectory import LIMITS, LONGEST_BLEND, PathLimits, Placement
from robomill.models.robot.kinematics import Tool

CHORD = 2e-6
"""Distance [m] of a chord from its arc, at most."""
_WIDEST = math.radians(15.0)
"""Angle [rad] of a chord, at most."""


def poses_of(
    program: Program | PointPath,
    placement: Placement,
    tool: Tool,
    q_start: Sequence[float] | FloatArray | None = None,
    limits: PathLimits = LIMITS,
    header: Sequence[str] = (),
) -> PoseProgram:
    """The poses of a program that was read, as the planner takes it: `placement`, tolerances of G64 as the blend distances they come to.

    Arcs become chords, 2 um off at most, blended over half their length. ValueError for a path of points whose orientation
    changes in the corners only: controllers turn on the way from pose to pose.
    """
    frames = Frames.at(placement, tool, q_start)
    upright = Rotation.from_matrix(placement.R_BP.T @ placement.R_BT)
    if isinstance(program, PointPath):
        return _of_points(program, frames, upright, limits, header)
    return _of_moves(program, frames, upright, limits, header)


def path_of(program: PoseProgram) -> PointPath:
    """The path that the planner takes: orientation evenly from pose to pose, splines as chords with the longest blends there are."""
    through = program.motion == "spline"
    reach = np.where(program.standing, 0.0, math.inf) if through else program.blend
    numbers = program.lines.tolist() if len(program.lines) else list(range(1, len(program.p) + 1))
    columns = (program.p, program.quat, reach, program.feed, program.spindle_speed, program.tool, program.dwell, program.rapid)
    points = tuple(
        PathPoint((*p,), (0.0, 0.0, 0.0), b, f, w, quat=(*q,), line=number, tool=t, dwell=d, rapid=r)
        for p, q, b, f, w, t, d, r, number in zip(*(c.tolist() for c in columns), numbers, strict=True)
    )
    return PointPath(program.name, points, "path", program.source)


def placement_of(frames: Frames) -> Placement:
    """Where the workpiece frame stands."""
    abc = Rotation.from_quat(np.roll(frames.quat_BP, -1)).as_euler("ZYX")
    return Placement(frames.p_BP_B, (float(abc[0]), float(abc[1]), float(abc[2])))


def _of_points(path: PointPath, frames: Frames, upright: Rotation, limits: PathLimits, header: Sequence[str]) -> PoseProgram:
    points = path.points
    turned = [upright * Rotation.from_euler("ZYX", p.abc) if p.quat is None else Rotation.from_quat(np.roll(p.quat, -1)) for p in points]
    if path.interpolation == "corner" and any((a.inv() * b).magnitude() > 0.0 for a, b in itertools.pairwise(turned)):
        raise ValueError(
            f"{path.name}: orientation = 'corner' turns the tool in the corners only; a controller turns it on the way from pose to pose; "
            "choose orientation = 'path'"
        )
    quat = np.array([np.roll(r.as_quat(canonical=True), 1) for r in turned])
    said = ((p.feed, p.blend, p.spindle_speed, p.tool, p.dwell, p.rapid) for p in points)
    feed, distance, spindle, tool, dwell, rapid = (list(c) for c in zip(*said, strict=True))
    feed[0], rapid[0] = limits.rapid_speed, True  # the way to where the path begins
    lines = [p.line or i for i, p in enumerate(points, 1)]
    return pose_program(
        _stem(path.name), frames, [p.position for p in points], quat, feed, distance, spindle, tool, dwell, rapid,
        header=header, lines=lines, source=path.source,
    )  # fmt: skip


def _of_moves(program: Program, frames: Frames, upright: Rotation, limits: PathLimits, header: Sequence[str]) -> PoseProgram:
    """Rows: position, feed, blend, spindle, tool, dwell, rapid, line."""
    rows: list[list[float]] = []
    following: Sequence[Move | Dwell | None] = [*program.actions[1:], None]
    for action, after in zip(program.actions, following, strict=True):
        if isinstance(action, Dwell):
            if rows:
                rows[-1][7] += action.duration
                rows[-1][4] = 0.0
            continue
        feed = limits.rapid_speed if action.feed is None else action.feed
        said = [action.spindle_speed, float(action.tool), 0.0, float(action.feed is None), float(action.line)]
        if not rows:
            rows.append([*action.start, limits.rapid_speed, 0.0, *said])
            rows[0][8] = 1.0  # the way to where the program begins
        for p in _chords(action):
            rows.append([*p, feed, 0.0, *said])
        if isinstance(action, Arc):
            step = math.dist(rows[-1][:3], rows[-2][:3])
            for row in rows[len(rows) - _count(action) : -1]:
                row[4] = 0.5 * step
        if isinstance(after, Move):
            rows[-1][4] = _distance(action, after)
    table = np.array(rows)
    quat = np.roll(upright.as_quat(canonical=True), 1)
    return pose_program(
        _stem(program.name), frames, table[:, :3], quat, table[:, 3], table[:, 4], table[:, 5], table[:, 6].astype(np.int64), table[:, 7],
        table[:, 8] > 0.0, header=header, lines=table[:, 9].astype(np.int64), source=program.source,
    )  # fmt: skip


def _stem(name: str) -> str:
    return name.rsplit(".", 1)[0]


def _shape(move: Move) -> Shape:
    start, end = np.array(move.start), np.array(move.end)
    if not isinstance(move, Arc):
        return line(start, end)
    axis = np.array(move.axis)
    return helix(start, np.array(move.centre), axis, move.angle, float((end - start) @ axis))


def _count(arc: Arc) -> int:
    """Chords that an arc is divided into."""
    out = np.array(arc.start) - np.array(arc.centre)
    radius = float(np.linalg.norm(out - (out @ np.array(arc.axis)) * np.array(arc.axis)))
    step = min(2.0 * math.acos(max(1.0 - CHORD / radius, 0.0)), _WIDEST)
    return max(math.ceil(abs(arc.angle) / step), 1)


def _chords(move: Move) -> list[list[float]]:
    """The points that a move leads to."""
    if not isinstance(move, Arc):
        return [list(move.end)]
    shape, count = _shape(move), _count(move)
    return [shape.at(shape.length * k / count)[0].tolist() for k in range(1, count)] + [list(move.end)]


def _distance(before: Move, after: Move) -> float:
    """Blend distance [m] that the tolerance at the end of a move comes to; 0 where the path stops."""
    if before.tolerance <= 0.0 or after.tolerance <= 0.0 or before.start == before.end or after.start == after.end:
        return 0.0
    one, two = _shape(before), _shape(after)
    limit = min(0.5 * one.length, 0.5 * two.length, LONGEST_BLEND * before.tolerance)
    if isinstance(before, Arc):
        limit = min(limit, 0.5 * one.length / _count(before))
    if isinstance(after, Arc):
        limit = min(limit, 0.5 * two.length / _count(after))
    found = blend(one, two, limit, before.tolerance)
    return 0.0 if found is None else found[0]
