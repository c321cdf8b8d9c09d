"""Correct a planned path by offsets and make it a program of few poses (Englert 2011, section 2.1, steps 5 and 6).

The planned path is sampled at nodes, with the way along it as coordinate. What is added to the nodes is an offset per node. The sum becomes
straight moves between points on it; each node lies at its own share of the way within the tolerance of them. So positions of the corrected
program and of the planned path belong together by the move and the share of it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d
from scipy.spatial.transform import Rotation, Slerp

from robomill.models.model.declaration import FloatArray
from robomill.models.planning.gcode import Move, Program
from robomill.models.planning.languages.poses import Frames, PoseProgram, pose_program
from robomill.models.planning.point_path import PointPath
from robomill.models.planning.segment_table import ACCELERATION, JERK, LINE, SPEED, SPINDLE, TAU, TOOL
from robomill.models.planning.trajectory import LIMITS, Plan

NODE_TIME = 4e-3
"""Path time [s] between nodes: the cycle of the robot controller."""
LONGEST, SHORTEST = 0.02, 1e-4
"""Length of a move at most and at least [m]."""
_GRADED = 0.3
"""Change of the length of moves over the way: neighbours differ by a third at most, as a blend reaches to half of the shorter one only."""
_GRID = 1e-4
"""m; where curvature and length of moves are worked out."""
_ROUNDS = 8
"""Times that moves which miss a node are made shorter."""
_WHOLE = 1.0 - 1e-9
"""What a number of moves is multiplied by before it is rounded up, as rounding may have lifted it over a whole one."""
_LEAST_WAY = 1e-6
"""Way [m] that nodes are apart at least: closer ones are left out."""
_LEAST_MOVE = 1e-7
"""m; what the last digit of a written program is worth: shorter moves are none."""
_SPLINE = 4
"""Nodes that a cubic spline needs."""
_AT_REST = 1e-12
"""Speed [m/s] of a path that rests."""


@dataclass(frozen=True)
class Said:
    """What a program says of the way to a point."""

    line: int
    feed: float
    """m/s; of a rapid, that of the planner."""
    rapid: bool
    spindle_speed: float
    tool: int


@dataclass(frozen=True)
class PlannedPath:
    """A planned path at n nodes, in P."""

    name: str
    along: FloatArray
    """(n,) way along the path [m], increasing."""
    time: FloatArray
    """(n,) path time [s] of the plan."""
    position: FloatArray
    """(n, 3) planned position of the tool tip [m]."""
    rotation: Rotation
    """(n,) planned orientation of the tool."""
    said: tuple[Said, ...]
    """(n,) what the program says there."""
    rests: Mapping[int, float]
    """Node -> how long [s] the path rests there; 0 where it only comes to rest."""

    def __len__(self) -> int:
        """Number of nodes."""
        return len(self.along)

    @property
    def lines(self) -> npt.NDArray[np.int64]:
        """(n,) line of the program."""
        return np.array([s.line for s in self.said], dtype=np.int64)


def planned_path(plan: Plan, program: Program | PointPath) -> PlannedPath:
    """The nodes of a plan: each `NODE_TIME` of path time, and where the path rests. Turns in place are rests."""
    rests = _rests(plan)
    times = np.union1d(np.arange(0.0, plan.duration, NODE_TIME), [*rests, plan.duration])
    R_BP = plan.placement.R_BP
    position = (plan.position(times) - np.asarray(plan.placement.p_BP_B)) @ R_BP
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
    kept, must = [0], np.isin(times, [*rests, plan.duration])
    for i in range(1, len(times)):
        if along[i] - along[kept[-1]] >= _LEAST_WAY:
            kept.append(i)
        elif must[i] and len(kept) > 1 and not must[kept[-1]]:
            kept[-1] = i  # a rest takes the place of a node just before it
    at = np.array(kept)
    nodes = np.searchsorted(times[at], list(rests), side="right") - 1
    waits: dict[int, float] = {}
    for node, wait in zip(nodes.tolist(), rests.values(), strict=True):
        waits[node] = waits.get(node, 0.0) + wait
    rows = plan.rows(np.minimum(times[at] + 0.5 * NODE_TIME, plan.duration))[0]
    said = _said_of_moves(program, rows, position[at]) if isinstance(program, Program) else _said_of_points(program, rows)
    rotation = Rotation.from_matrix(R_BP.T) * plan.rotation(times[at])
    return PlannedPath(program.name, along[at], times[at], position[at], rotation, said, waits)


def _rests(plan: Plan) -> dict[float, float]:
    """Path time [s] -> how long [s] the path rests there."""
    table = plan.table
    found: dict[float, float] = {}
    for row in np.flatnonzero(np.abs(table[:-1, SPEED]) < _AT_REST).tolist():
        stands = table[row, ACCELERATION] == 0.0 and table[row, JERK] == 0.0
        found[float(table[row, TAU])] = float(table[row + 1, TAU] - table[row, TAU]) if stands else 0.0
    return found


def _said_of_moves(program: Program, rows: FloatArray, position: FloatArray) -> tuple[Said, ...]:
    by_line: dict[int, list[Move]] = {}
    for action in program.actions:
        if isinstance(action, Move):
            by_line.setdefault(action.line, []).append(action)
    last = next(iter(by_line.values()))
    found = []
    for row, p in zip(rows, position, strict=True):
        last = by_line.get(int(row[LINE]), last)
        m = _owner(last, p, row)
        found.append(Said(m.line, LIMITS.rapid_speed if m.feed is None else m.feed, m.feed is None, m.spindle_speed, m.tool))
    return tuple(found)


def _owner(moves: Sequence[Move], p: FloatArray, row: FloatArray) -> Move:
    """The move of a line that a point is on: the nearest, where a cycle has several of other feeds."""
    if len(moves) == 1:
        return moves[0]

    def away(move: Move) -> float:
        start, way = np.asarray(move.start), np.asarray(move.end) - np.asarray(move.start)
        share = float(np.clip((p - start) @ way / max(float(way @ way), _LEAST_MOVE**2), 0.0, 1.0))
        return float(np.linalg.norm(p - start - share * way))

    alike = [m for m in moves if m.tool == int(row[TOOL]) and m.spindle_speed == row[SPINDLE]]
    return min(alike or moves, key=away)


def _said_of_points(program: PointPath, rows: FloatArray) -> tuple[Said, ...]:
    by_line = {p.line or i: p for i, p in enumerate(program.points, start=1)}
    points = [(int(row[LINE]), by_line[int(row[LINE])]) for row in rows]
    return tuple(Said(line, p.feed, p.rapid, p.spindle_speed, p.tool) for line, p in points)


@dataclass(frozen=True)
class CorrectedProgram:
    """A planned path with offsets as a program."""

    poses: PoseProgram
    """`lines` are those of the planned program."""
    along: FloatArray
    """(n,) way along the planned path [m] to which each pose belongs."""


def corrected(path: PlannedPath, offset: FloatArray, tolerance: float, frames: Frames, header: Sequence[str] = ()) -> CorrectedProgram:
    """The path with `offset` (n, 3) [m] in P added, as straight moves; every node comes within `tolerance` [m] of its place.

    A move ends where the path rests and where feed, spindle or tool change, and between in as few points as the tolerance allows with
    lengths that change evenly (`points_along`). Corners are blended over half of the shorter move, so that a curve is run through at its
    feed. ValueError if the shapes do not fit or the tolerance is not positive.
    """
    if offset.shape != path.position.shape:
        raise ValueError(f"offsets have the shape {offset.shape}, expected {path.position.shape}: one per node of {path.name}")
    if not tolerance > 0.0:
        raise ValueError(f"tolerance {tolerance:g} m; expected more than 0: a curve has no finite number of points on it")
    target = path.position + offset
    said = [(s.feed, s.rapid, s.spindle_speed, s.tool) for s in path.said]
    ends = sorted({0, len(path) - 1, *path.rests, *(i for i in range(1, len(path)) if said[i] != said[i - 1])})
    rows: list[tuple[float, ...]] = []
    for first, last in itertools.pairwise(ends):
        way, points = points_along(path.along[first : last + 1], target[first : last + 1], tolerance)
        s = path.said[first]
        if not rows:
            rows.append((way[0], *points[0], LIMITS.rapid_speed, s.spindle_speed, s.tool, path.rests.get(0, 0.0), True, s.line, True))
        for i, (end, point) in enumerate(zip(way[1:].tolist(), points[1:], strict=True), start=1):
            if math.dist(rows[-1][1:4], point) < _LEAST_MOVE:
                continue
            line = path.said[min(int(np.searchsorted(path.along, end, side="left")), last) - 1].line
            rest = i == len(way) - 1 and last in path.rests
            rows.append((end, *point, s.feed, s.spindle_speed, s.tool, path.rests[last] if rest else 0.0, s.rapid, line, rest))
    table = np.array(rows, dtype=np.float64)
    lengths = np.linalg.norm(np.diff(table[:, 1:4], axis=0), axis=1)
    blend = np.zeros(len(table))
    blend[1:-1] = 0.5 * np.minimum(lengths[:-1], lengths[1:])
    blend[table[:, 10] > 0.0] = 0.0
    turning = Slerp(path.along, path.rotation)
    quat = np.roll(turning(table[:, 0]).as_quat(canonical=True), 1, axis=1)
    poses = pose_program(
        path.name.rsplit(".", 1)[0], frames, table[:, 1:4], quat, table[:, 4], blend, table[:, 5], table[:, 6].astype(np.int64),
        table[:, 7], table[:, 8] > 0.0, header=header, lines=table[:, 9].astype(np.int64),
    )  # fmt: skip
    return CorrectedProgram(poses, table[:, 0])


def points_along(along: FloatArray, values: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Ways (k,) and points (k, d) so that straight lines, even in the way, pass n `values` (n, d) at ways `along` (n,) within `tolerance`.

    The lengths follow from the curvature, L = sqrt(8 tolerance / |x''|), x(s) the cubic spline through the values, and change by
    `_GRADED` of the way at most. So a curve becomes chords of nearly one length, whose blends are hardly tighter than it. Where a value is
    missed, as at a kink, they are made shorter.
    """
    if len(along) < _SPLINE:
        return along, values
    spline = CubicSpline(along, values)
    begin, end = float(along[0]), float(along[-1])
    grid = np.linspace(begin, end, max(3, math.ceil((end - begin) / _GRID) + 1))
    curvature = maximum_filter1d(np.linalg.norm(spline(grid, 2), axis=1), 5)
    with np.errstate(divide="ignore"):
        length = np.sqrt(8.0 * tolerance / curvature)
    for _ in range(_ROUNDS):
        length = _graded(grid, np.clip(length, SHORTEST, LONGEST))
        count = np.concatenate([[0.0], np.cumsum(np.diff(grid) * 0.5 * (1.0 / length[1:] + 1.0 / length[:-1]))])
        way = np.interp(np.linspace(0.0, count[-1], math.ceil(count[-1] * _WHOLE) + 1), count, grid)
        way[-1] = end
        points = spline(way)
        missed = np.linalg.norm(np.column_stack([np.interp(along, way, p) for p in points.T]) - values, axis=1) > tolerance
        if not np.any(missed):
            break
        near = np.interp(grid, along, maximum_filter1d(missed.astype(np.float64), 3)) > 0.0
        length = np.where(near, 0.7 * length, length)
    return way, points


def _graded(grid: FloatArray, length: FloatArray) -> FloatArray:
    """The lengths, made shorter where they would change by more than `_GRADED` of the way."""
    rising = np.minimum.accumulate(length - _GRADED * grid) + _GRADED * grid
    falling: FloatArray = np.minimum.accumulate((rising + _GRADED * grid)[::-1])[::-1] - _GRADED * grid
    return falling


def way_along(program: CorrectedProgram, pose: npt.NDArray[np.int64], position: FloatArray) -> FloatArray:
    """Way [m] (k,) along the planned path to which positions (k, 3) [m] in P belong that are on their way to `pose` (k,)."""
    points = program.poses.p
    pose = np.clip(pose, 1, len(points) - 1)
    share = _share(points, pose, position)
    # a blend belongs to one of its two moves, whole: before its corner the position is on the other one
    for there, neighbour in ((share < 0.0, np.maximum(pose - 1, 1)), (share > 1.0, np.minimum(pose + 1, len(points) - 1))):
        other = _share(points, neighbour, position)
        moved = there & (other > 0.0) & (other < 1.0)
        pose, share = np.where(moved, neighbour, pose), np.where(moved, other, share)
    begin, end = program.along[pose - 1], program.along[pose]
    result: FloatArray = np.maximum.accumulate(begin + np.clip(share, 0.0, 1.0) * (end - begin))
    return result


def _share(points: FloatArray, pose: npt.NDArray[np.int64], position: FloatArray) -> FloatArray:
    """Where positions (k, 3) stand beside the moves to `pose` (k,): 0 at the start, 1 at the end."""
    start = points[pose - 1]
    way = points[pose] - start
    share: FloatArray = np.einsum("ij,ij->i", position - start, way) / np.maximum(np.einsum("ij,ij->i", way, way), _LEAST_MOVE**2)
    return share


def at_nodes(path: PlannedPath, along: FloatArray, values: FloatArray) -> FloatArray:
    """Values (n, d) at the nodes of samples (k, d) at ways `along` (k,) [m], which do not decrease: means where the way stands still."""
    places, index = np.unique(along, return_inverse=True)
    count = np.bincount(index)
    columns = [np.bincount(index, weights=v) / count for v in values.T]
    return np.column_stack([np.interp(path.along, places, c) for c in columns])
