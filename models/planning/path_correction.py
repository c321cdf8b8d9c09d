"""Correct a planned path by offsets and write it as a program of few lines (Englert 2011, section 2.1, steps 5 and 6).

The planned path is sampled at nodes, with the way along it as coordinate. What is added to the nodes is an offset per node. The sum becomes
straight moves between points on it; each node lies at its own share of the way within the tolerance of them. So positions of the corrected
program and of the planned path belong together by the line of the program and the share of it.
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

from robomill.models.model.declaration import FloatArray
from robomill.models.planning.gcode import Dwell, Move, Program, Vector
from robomill.models.planning.segment_table import ACCELERATION, JERK, LINE, SPEED, SPINDLE, TAU, TOOL
from robomill.models.planning.trajectory import Plan

NODE_TIME = 4e-3
"""Path time [s] between nodes: the cycle of the robot controller."""
BLENDS = 10.0
"""Blend tolerance of the corrected program over its chord tolerance: on a smooth curve the blends then reach from chord to chord (they go
to half of the shorter one at most), so that the feed holds; at a corner they cut off as little."""
LONGEST, SHORTEST = 0.02, 1e-4
"""Length of a move at most and at least [m]."""
_GRADED = 0.3
"""Change of the length of moves over the way: neighbours differ by a third at most, as a blend reaches to half of the shorter one only."""
_GRID = 1e-4
"""m; where curvature and length of moves are worked out."""
_ROUNDS = 8
"""Times that moves which miss a node are made shorter."""
_LEAST_WAY = 1e-6
"""Way [m] that nodes are apart at least: closer ones are left out."""
_NUMBER = 1e-7
"""m: what the last digit of a number of the written program is worth; shorter moves are none."""
_SPLINE = 4
"""Nodes that a cubic spline needs."""
_AT_REST = 1e-12
"""Speed [m/s] of a path that rests."""


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
    move: tuple[Move, ...]
    """(n,) the move of the program that a node belongs to."""
    rests: Mapping[int, float]
    """Node -> how long [s] the path rests there; 0 where it only comes to rest."""
    final_spindle_speed: float

    def __len__(self) -> int:
        """Number of nodes."""
        return len(self.along)

    @property
    def lines(self) -> npt.NDArray[np.int64]:
        """(n,) line of the program."""
        return np.array([m.line for m in self.move], dtype=np.int64)


def planned_path(plan: Plan, program: Program) -> PlannedPath:
    """The nodes of a plan: each `NODE_TIME` of path time, and where the path rests."""
    rests = _rests(plan)
    times = np.union1d(np.arange(0.0, plan.duration, NODE_TIME), [*rests, plan.duration])
    position = (plan.position(times) - np.asarray(plan.placement.p_BP_B)) @ plan.placement.R_BP
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
    kept, must = [0], np.isin(times, [*rests, plan.duration])
    for i in range(1, len(times)):
        if along[i] - along[kept[-1]] < _LEAST_WAY:
            if must[i] and len(kept) > 1 and not must[kept[-1]]:
                kept[-1] = i  # a rest takes the place of a node just before it
            continue
        kept.append(i)
    at = np.array(kept)
    rows = plan.rows(np.minimum(times[at] + 0.5 * NODE_TIME, plan.duration))[0]
    nodes = np.searchsorted(times[at], list(rests), side="right") - 1
    waits: dict[int, float] = {}
    for node, wait in zip(nodes.tolist(), rests.values(), strict=True):
        waits[node] = waits.get(node, 0.0) + wait
    by_line: dict[int, list[Move]] = {}
    for action in program.actions:
        if isinstance(action, Move):
            by_line.setdefault(action.line, []).append(action)
    moves = tuple(
        _owner(by_line[int(row[LINE])], p, row) if int(row[LINE]) in by_line else next(iter(by_line.values()))[0]
        for row, p in zip(rows, position[at], strict=True)
    )
    return PlannedPath(program.name, along[at], times[at], position[at], moves, waits, program.final_spindle_speed)


def _rests(plan: Plan) -> dict[float, float]:
    """Path time [s] -> how long [s] the path rests there."""
    table = plan.table
    still = np.flatnonzero(np.abs(table[:-1, SPEED]) < _AT_REST)
    found: dict[float, float] = {}
    for row in still.tolist():
        wait = 0.0
        if table[row, ACCELERATION] == 0.0 and table[row, JERK] == 0.0:
            wait = float(table[row + 1, TAU] - table[row, TAU])
        found[float(table[row, TAU])] = wait
    return found


def _owner(moves: Sequence[Move], p: FloatArray, row: FloatArray) -> Move:
    """The move of a line that a point is on: the nearest, where a cycle has several of other feeds."""
    if len(moves) == 1:
        return moves[0]

    def away(move: Move) -> float:
        start, way = np.asarray(move.start), np.asarray(move.end) - np.asarray(move.start)
        share = float(np.clip((p - start) @ way / max(float(way @ way), 1e-18), 0.0, 1.0))
        return float(np.linalg.norm(p - start - share * way))

    alike = [m for m in moves if m.tool == int(row[TOOL]) and m.spindle_speed == row[SPINDLE]]
    return min(alike or moves, key=away)


@dataclass(frozen=True)
class CorrectedProgram:
    """A planned path with offsets as a program."""

    actions: tuple[Move | Dwell, ...]
    along: FloatArray
    """(actions, 2) way along the planned path [m] where each begins and ends."""
    final_spindle_speed: float

    @property
    def points(self) -> int:
        """Number of moves."""
        return sum(isinstance(a, Move) for a in self.actions)


def corrected(path: PlannedPath, offset: FloatArray, tolerance: float) -> CorrectedProgram:
    """The path with `offset` (n, 3) [m] in P added, as straight moves; every node comes within `tolerance` [m] of its place.

    A move ends where the path rests and where feed, spindle or tool change, and between in as few points as the tolerance allows with
    lengths that change evenly (`points_along`). Corners are blended by `BLENDS` tolerances, or less where the program asked for less.
    ValueError if the shapes do not fit or the tolerance is not positive.
    """
    if offset.shape != path.position.shape:
        raise ValueError(f"offsets have the shape {offset.shape}, expected {path.position.shape}: one per node of {path.name}")
    if not tolerance > 0.0:
        raise ValueError(f"tolerance {tolerance:g} m; expected more than 0: a curve has no finite number of points on it")
    target = path.position + offset
    said = [(m.feed, m.spindle_speed, m.tool) for m in path.move]
    ends = sorted({0, len(path) - 1, *path.rests, *(i for i in range(1, len(path)) if said[i] != said[i - 1])})
    actions: list[Move | Dwell] = []
    along: list[tuple[float, float]] = []
    here: Vector = _rounded(target[0])

    def rest(node: int) -> None:
        if node in path.rests and (actions or path.rests[node] > 0.0):
            m = path.move[node]
            actions.append(Dwell(len(actions) + 1, len(actions) + 1, path.rests[node], m.spindle_speed, m.tool))
            along.append((float(path.along[node]),) * 2)

    rest(0)
    for first, last in itertools.pairwise(ends):
        way, points = points_along(path.along[first : last + 1], target[first : last + 1], tolerance)
        move = path.move[first]
        blend = BLENDS * tolerance if move.tolerance == 0.0 else min(BLENDS * tolerance, move.tolerance)
        start = float(way[0])
        for end, point in zip(way[1:].tolist(), points[1:], strict=True):
            there = _rounded(point)
            if math.dist(here, there) < _NUMBER:
                continue
            number = len(actions) + 1
            actions.append(Move(number, number, here, there, move.feed, move.spindle_speed, blend, tool=move.tool))
            along.append((start, end))
            here, start = there, end
        if last < len(path) - 1:
            rest(last)
    return CorrectedProgram(tuple(actions), np.array(along), path.final_spindle_speed)


def _rounded(p: FloatArray) -> Vector:
    """To the digits that are written."""
    x, y, z = (round(float(v), 7) for v in p)
    return x, y, z


def points_along(along: FloatArray, values: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Ways (k,) and points (k, d) so that straight lines, even in the way, pass n `values` (n, d) at ways `along` (n,) within `tolerance`.

    The lengths follow from the curvature, L = sqrt(8 tolerance / |x''|), x(s) the cubic spline through the values, and change by `_GRADED` of
    the way at most. So a curve becomes chords of nearly one length, whose blends are hardly tighter than it. Where a value is
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
        way = np.interp(np.linspace(0.0, count[-1], math.ceil(count[-1]) + 1), count, grid)
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


def way_along(program: CorrectedProgram, line_of: Mapping[int, int], line: FloatArray, position: FloatArray) -> FloatArray:
    """Way [m] (n,) along the planned path to which positions on the corrected program belong.

    `line_of`: line of the program text -> action (a line without one belongs to the last before it); `line` (n,) lines in the order of
    travel and `position` (n, 3) [m] in P, commanded.
    """
    ends = [(a.start, a.end) if isinstance(a, Move) else ((0.0, 0.0, 0.0),) * 2 for a in program.actions]
    start, end = (np.array([e[i] for e in ends], dtype=np.float64) for i in (0, 1))
    first, last = program.along.T
    known = np.array(sorted(line_of))
    action = np.array([line_of[int(n)] for n in known])[np.maximum(np.searchsorted(known, line, side="right") - 1, 0)]
    share = _share(start, end, action, position)
    # a blend belongs to one of its two moves, whole: before its corner the position is on the other one
    for there, neighbour in ((share < 0.0, np.maximum(action - 1, 0)), (share > 1.0, np.minimum(action + 1, len(start) - 1))):
        other = _share(start, end, neighbour, position)
        moved = there & (other > 0.0) & (other < 1.0)
        action, share = np.where(moved, neighbour, action), np.where(moved, other, share)
    found = first[action] + np.clip(share, 0.0, 1.0) * (last[action] - first[action])
    result: FloatArray = np.maximum.accumulate(found)
    return result


def _share(start: FloatArray, end: FloatArray, action: npt.NDArray[np.int64], position: FloatArray) -> FloatArray:
    """Where positions (k, 3) stand beside the moves `action` (k,): 0 at the start, 1 at the end."""
    way = end[action] - start[action]
    share: FloatArray = np.einsum("ij,ij->i", position - start[action], way) / np.maximum(np.einsum("ij,ij->i", way, way), _NUMBER**2)
    return share


def at_nodes(path: PlannedPath, along: FloatArray, values: FloatArray) -> FloatArray:
    """Values (n, d) at the nodes of samples (k, d) at ways `along` (k,) [m], which do not decrease: means where the way stands still."""
    places, index = np.unique(along, return_inverse=True)
    count = np.bincount(index)
    columns = [np.bincount(index, weights=v) / count for v in values.T]
    return np.column_stack([np.interp(path.along, places, c) for c in columns])


def gcode_text(program: CorrectedProgram, header: Sequence[str], origin: Vector, dialect: str = "linuxcnc") -> tuple[str, dict[int, int]]:
    """The program as G-code about `origin` [m] of P (G54), and which action each line is (line -> index).

    Lengths in mm with four digits, feed in mm/min. `header`: lines of comments.
    """
    text = ["%", *(f"({line.translate(_NO_COMMENT)})" for line in header), "G21 G90 G17 G40 G49 G80 G94", "G54"]
    line_of: dict[int, int] = {}
    tool, spindle, blend, feed, rapid, placed = 0, 0.0, -1.0, -1.0, False, False
    for index, action in enumerate(program.actions):
        if action.tool != tool:
            tool = action.tool
            text.append(f"T{tool} M6")
        if action.spindle_speed != spindle:
            spindle = action.spindle_speed
            text.append("M5" if spindle == 0.0 else f"S{_number(abs(spindle) * 30.0 / math.pi)} M{3 if spindle > 0.0 else 4}")
        if isinstance(action, Dwell):
            if not placed:
                continue
            seconds = action.duration
            text.append(f"G4 P{_number(seconds if dialect == 'linuxcnc' else 1e3 * seconds)}")
            line_of[len(text)] = index
            continue
        if not placed:
            text.append(f"G0 {_point(action.start, origin)}")
            line_of[len(text)] = index
            placed, rapid = True, True
        if action.tolerance != blend:
            blend = action.tolerance
            text.append(f"G64 P{_number(1e3 * blend)}")
        words = [_point(action.end, origin)]
        if action.feed is None:
            words.insert(0, "G0")
        else:
            if rapid or feed < 0.0:
                words.insert(0, "G1")
            if action.feed != feed:
                feed = action.feed
                words.append(f"F{_number(6e4 * feed)}")
        rapid = action.feed is None
        text.append(" ".join(words))
        line_of[len(text)] = index
    text += ["M5", "M30", "%", ""]
    return "\n".join(text), line_of


_NO_COMMENT = str.maketrans("()", "[]")


def _number(value: float) -> str:
    return f"{value:.10g}"


def _point(p: Vector, origin: Vector) -> str:
    return " ".join(f"{a}{1e3 * (v - o):.4f}" for a, v, o in zip("XYZ", p, origin, strict=True))
