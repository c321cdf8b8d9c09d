"""Plan a trajectory: a program becomes a table of segments that a component can evaluate by lookup.

Steps (Englert 2011, Fig. 4.5): program -> shapes in the base frame -> corners blended -> speed profile along
the path -> rows. A row is a time span of constant jerk on one shape: it holds the time law of the path
coordinate and the geometry over it, so that position, velocity and orientation at any path time follow from one row.
Feed is constant, through blends too; double-S ramps only where the program stops, starts or changes its feed, and where
a curve is too tight for the feed (`Plan.reduced` lists those). Everything in SI and in the robot base B.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from robomill.models.maths.rotation import Rotation
from robomill.models.model.compiled import loaded_on_call
from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import load, quantity
from robomill.models.planning.blend import blend, hermite
from robomill.models.planning.double_s import path_at, phases, time_at
from robomill.models.planning.gcode import Arc, Dwell, Move, Program, Vector
from robomill.models.planning.path_geometry import SAMPLES, Polynomial, Shape, helix, line, point, polynomial_at, shift
from robomill.models.planning.point_path import PathPoint, PointPath
from robomill.models.planning.segment_table import (
    ACCELERATION,
    AXIS_1,
    AXIS_2,
    BLOCK,
    COLUMNS,
    F_1,
    F_2,
    GEOMETRY,
    GEOMETRY_COLUMNS,
    HELIX,
    JERK,
    KIND,
    LINE,
    QUAT,
    SIGMA,
    SPEED,
    SPINDLE,
    TAU,
    TOOL,
)

if TYPE_CHECKING:  # takes a third of a second: see `Plan.rotation`
    from scipy.spatial.transform import Rotation as Rotations

IntArray = npt.NDArray[np.int64]
_STRAIGHT_ON = 1e-6
"""Angle [rad] and curvature step times length below which two shapes continue each other."""
_SAME_ORIENTATION = 1e-9
"""Angle [rad] below which two orientations are one."""
_KINK = math.radians(0.1)
"""Angle up to which a corner is run over without a stop where blending is off (rounding of CAM output)."""
_REVERSAL = math.radians(175.0)
"""Corners sharper than this are reversals: the path stops there."""
LONGEST_BLEND = 10.0
"""A blend reaches at most this many tolerances from its corner, so that flat corners of long moves stay local."""


class PlanError(ValueError):
    """A program that cannot be planned; names program, line and remedy."""


@dataclass(frozen=True)
class PathLimits:
    """Limits of the planner (models/data/planning)."""

    name: str
    rapid_speed: float = field(metadata=quantity("m/s", 1e-6))
    acceleration: float = field(metadata=quantity("m/s2", 1e-6))
    jerk: float = field(metadata=quantity("m/s3", 1e-6))
    lateral_acceleration: float = field(metadata=quantity("m/s2", 1e-6))
    angular_speed: float = field(metadata=quantity("rad/s", 1e-6))
    angular_acceleration: float = field(metadata=quantity("rad/s2", 1e-6))

    @property
    def angular_jerk(self) -> float:
        """rad/s3, so that full angular acceleration takes as long to build up as full path acceleration."""
        return self.angular_acceleration * self.jerk / self.acceleration


LIMITS = load(PathLimits, "planning/robot_path")
"""Default limits."""


@dataclass(frozen=True)
class Placement:
    """Where the workpiece frame P stands in the robot base B, and how the tool is turned about its axis."""

    p_BP_B: Vector
    abc_BP: Vector = (0.0, 0.0, 0.0)
    """A, B, C [rad]: R_BP = Rz(A) Ry(B) Rx(C)."""
    tool_angle: float = 0.0
    """Angle [rad] about the tool axis; at 0 the z axis of T (with the default tool: of the flange) points away from the robot,
    radially at the workpiece origin."""

    @cached_property
    def R_BP(self) -> FloatArray:
        """Orientation of P in B."""
        matrix: FloatArray = Rotation.from_abc(self.abc_BP).as_matrix()
        return matrix

    @property
    def R_BT(self) -> FloatArray:
        """Orientation of the upright tool in B: x along -z of P (FACTS 1.7, orientation 0)."""
        x = -self.R_BP[:, 2]
        azimuth = math.atan2(self.p_BP_B[1], self.p_BP_B[0])
        outward = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        z = outward - (outward @ x) * x
        if np.linalg.norm(z) < 1e-6:
            raise PlanError(
                f"placement: the tool axis (-z of P) points along the radial direction {outward} of the base, so that "
                "'flange away from the robot' means nothing; tilt P or move it sideways"
            )
        z /= np.linalg.norm(z)
        upright = np.column_stack([x, np.cross(z, x), z])
        turned: FloatArray = upright @ Rotation.from_rotvec([self.tool_angle, 0.0, 0.0]).as_matrix()
        return turned

    def to_base(self, p: npt.ArrayLike) -> FloatArray:
        """Point p [m] of P, expressed in B."""
        result: FloatArray = np.asarray(self.p_BP_B) + self.R_BP @ np.asarray(p)
        return result


@dataclass(frozen=True)
class _Turn:
    """Orientation over the path coordinate: R(quat) exp(axis_1 f_1) exp(axis_2 f_2)."""

    R: Rotation
    axis_1: FloatArray = field(default_factory=lambda: np.zeros(3))
    f_1: FloatArray = field(default_factory=lambda: np.zeros(6))
    axis_2: FloatArray = field(default_factory=lambda: np.zeros(3))
    f_2: FloatArray = field(default_factory=lambda: np.zeros(6))

    @cached_property
    def steady(self) -> bool:
        """Whether the orientation does not change."""
        return not (np.any(self.f_1) or np.any(self.f_2))

    @cached_property
    def quat(self) -> FloatArray:
        """R as (w, x, y, z)."""
        return np.roll(self.R.as_quat(), 1)

    def at(self, s: float) -> Rotation:
        """R_BT at the path coordinate s."""
        if self.steady:
            return self.R
        powers = s ** np.arange(6)
        return self.R * Rotation.from_rotvec(self.axis_1 * (self.f_1 @ powers)) * Rotation.from_rotvec(self.axis_2 * (self.f_2 @ powers))

    def part(self, start: float) -> _Turn:
        """The turn from the path coordinate `start` on."""
        return self if self.steady else replace(self, f_1=shift(self.f_1, start), f_2=shift(self.f_2, start))

    def fastest(self, length: float) -> tuple[float, float]:
        """Upper bounds of the angle per path [rad/m] and of its derivative [rad/m2] over [0, length]."""
        return (0.0, 0.0) if self.steady else (_largest(self.f_1, self.f_2, 1, length), _largest(self.f_1, self.f_2, 2, length))


@loaded_on_call
def _largest(f_1: FloatArray, f_2: FloatArray, order: int, length: float) -> float:
    """Sum of the largest sizes of a derivative of two quintics (6,) over [0, length], at even steps."""
    one = two = 0.0
    for n in range(SAMPLES):
        s = length * n / (SAMPLES - 1)
        one, two = max(one, abs(polynomial_at(f_1, s, order))), max(two, abs(polynomial_at(f_2, s, order)))
    return one + two


@dataclass(frozen=True)
class _Stretch:
    """A shape with what the program says about it; before blending a move, after it a piece of the path."""

    shape: Shape
    turn: _Turn
    feed: float
    line: int
    block: int
    spindle: float
    tolerance: float = 0.0
    """Blend tolerance [m] at its end; 0 = none."""
    distance: float = 0.0
    """Blend distance [m] at its end; 0 = none."""
    tool: int = 0
    in_place: bool = False
    rapid: bool = False
    corner: int = 0
    """Number of the corner that a blend piece belongs to; 0 for other shapes."""


@dataclass(frozen=True)
class Reduction:
    """A block whose feed [m/s] is not held: the lowest speed [m/s] there. Its text is what messages say."""

    line: int
    block: int
    feed: float
    speed: float

    def __str__(self) -> str:
        """Where, from what to what."""
        return f"line {self.line} (block {self.block}): {self.feed * 1e3:.4g} mm/s reduced to {self.speed * 1e3:.4g} mm/s"


@dataclass(frozen=True)
class Plan:
    """A planned program: the segment table and its evaluation with numpy (for pictures, checks and tests)."""

    name: str
    table: FloatArray
    """(rows, 50), read-only; the last row is the rest at the end."""
    length: float
    """Path length in m."""
    reduced: tuple[Reduction, ...]
    """Where the feed could not be held (rapids excepted), one for each block."""
    source: tuple[str, ...]
    """Lines of the program."""
    placement: Placement
    within_axes: bool = False
    """Whether lines are slower so that axes keep their limits."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the planner decided, in one text however many blocks it concerns."""
        if not self.reduced:
            return ()
        slowest = min(self.reduced, key=lambda r: r.speed / r.feed)
        others = f"; {len(self.reduced)} blocks are slowed, this one most" if len(self.reduced) > 1 else ""
        axes = ", or an axis would exceed its limits" if self.within_axes else ""
        return (f"{slowest} where the path curves or turns too tightly{axes}{others}",)

    @property
    def duration(self) -> float:
        """Path time [s] at the end."""
        return float(self.table[-1, TAU])

    def rows(self, tau: FloatArray) -> tuple[FloatArray, ...]:
        """For path times tau [s] (n,): their rows (n, 50), and path coordinate [m], speed [m/s], acceleration [m/s2] (n,)."""
        times = np.atleast_1d(np.asarray(tau, dtype=np.float64))
        index = np.clip(np.searchsorted(self.table[:, TAU], times, side="right") - 1, 0, None)
        rows = self.table[index]
        t = times - rows[:, TAU]
        s, v, a, j = (rows[:, c] for c in (SIGMA, SPEED, ACCELERATION, JERK))
        return rows, s + t * (v + t * (a / 2.0 + t * j / 6.0)), v + t * (a + t * j / 2.0), a + t * j

    def _geometry(self, tau: FloatArray) -> tuple[FloatArray, ...]:
        """Position and its first and second derivative over the path coordinate (n, 3), speed and acceleration (n,)."""
        rows, s, v, a = self.rows(tau)
        c = rows[:, GEOMETRY : GEOMETRY + GEOMETRY_COLUMNS].reshape(-1, 3, 6)
        powers = s[:, None] ** np.arange(6)
        k = np.arange(6)
        d1 = np.hstack([np.zeros((len(s), 1)), k[1:] * powers[:, :5]])
        d2 = np.hstack([np.zeros((len(s), 2)), k[2:] * k[1:5] * powers[:, :4]])
        p, d, dd = (np.einsum("nik,nk->ni", c, x) for x in (powers, d1, d2))
        h = rows[:, KIND] == HELIX
        g = rows[h, GEOMETRY:]
        w = g[:, 12:13]
        cos, sin = np.cos(w * s[h, None]), np.sin(w * s[h, None])
        p[h] = g[:, 0:3] + cos * g[:, 3:6] + sin * g[:, 6:9] + s[h, None] * g[:, 9:12]
        d[h] = w * (cos * g[:, 6:9] - sin * g[:, 3:6]) + g[:, 9:12]
        dd[h] = -w * w * (cos * g[:, 3:6] + sin * g[:, 6:9])
        return p, d, dd, v, a

    def position(self, tau: FloatArray) -> FloatArray:
        """p_BT_B [m] (n, 3)."""
        return self._geometry(tau)[0]

    def velocity(self, tau: FloatArray) -> FloatArray:
        """v_BT_B [m/s] (n, 3) at speed ratio 1."""
        _, d, _, v, _ = self._geometry(tau)
        return d * v[:, None]

    def acceleration(self, tau: FloatArray) -> FloatArray:
        """Acceleration of T in B [m/s2] (n, 3) at speed ratio 1."""
        _, d, dd, v, a = self._geometry(tau)
        return dd * (v * v)[:, None] + d * a[:, None]

    def rotation(self, tau: FloatArray) -> Rotations:
        """R_BT as a scipy Rotation of n."""
        from scipy.spatial.transform import Rotation as Rotations

        rows, s, _, _ = self.rows(tau)
        powers = s[:, None] ** np.arange(6)
        result = Rotations.from_quat(np.roll(rows[:, QUAT : QUAT + 4], -1, axis=1))
        for axis, f in ((AXIS_1, F_1), (AXIS_2, F_2)):
            angle = np.sum(rows[:, f : f + 6] * powers, axis=1)
            result = result * Rotations.from_rotvec(rows[:, axis : axis + 3] * angle[:, None])
        return result

    def spindle_speed(self, tau: FloatArray) -> FloatArray:
        """rad/s (n,)."""
        return self.rows(tau)[0][:, SPINDLE]

    def block(self, tau: FloatArray) -> FloatArray:
        """Block (N) numbers (n,)."""
        return self.rows(tau)[0][:, BLOCK]

    def where(self, tau: float) -> str:
        """Line of the program at path time tau [s], for messages."""
        number = int(self.rows(np.array([tau]))[0][0, LINE])
        text = self.source[number - 1].strip() if 0 < number <= len(self.source) else ""
        return f"{self.name} line {number} ({text})"


def plan(
    program: Program | PointPath, placement: Placement, limits: PathLimits = LIMITS, slower: Mapping[int, float] = MappingProxyType({})
) -> Plan:
    """Plan `program` at `placement`: from rest at its first point to rest at its last.

    `slower`: line of the program -> share of the speed that it would have, for lines on which axes would exceed their limits
    (`reachability.plan_within`). PlanError if there is nothing to move.
    """
    if isinstance(program, Program):
        items, final = _moves(program, placement, limits), program.final_spindle_speed
    else:
        items, final = _points(program, placement), program.points[-1].spindle_speed
    reduced: list[Reduction] = []
    rows: list[FloatArray] = []
    tau, length = 0.0, 0.0
    last: FloatArray | None = None
    for run in _runs(items, limits):
        if isinstance(run, Dwell):
            if last is not None:
                last[:, [TAU, BLOCK, LINE, SPINDLE, TOOL]] = tau, run.block, run.line, run.spindle_speed, run.tool
                rows.append(last.copy())
            tau += run.duration
            continue
        speeds, slowed = _speeds(run, limits, slower)
        reduced += slowed
        profile = _profile(run, speeds, limits)
        elements = _element_rows(run)
        rows.append(_rows(run, elements, profile, tau))
        tau += float(profile[-1, 0] + profile[-1, 1])
        length += sum(stretch.shape.length for stretch in run if not stretch.in_place)
        last = elements[-1:].copy()
        last[:, SIGMA] = run[-1].shape.length
    if last is None:
        raise PlanError(f"{program.name}: nothing to move; the program has no two different points; give a program that moves the tool")
    last[:, [TAU, SPINDLE]] = tau, final
    rows.append(last)
    if rows[0][0, TAU] > 0.0:
        # a dwell before the first move: wait where it begins
        wait = rows[0][:1].copy()
        wait[:, [TAU, SPEED, ACCELERATION, JERK]] = 0.0
        rows.insert(0, wait)
    table = np.concatenate(rows)
    table = table[np.append(np.diff(table[:, TAU]) > 0.0, True)]
    table.flags.writeable = False
    return Plan(program.name, table, length, tuple(reduced), program.source, placement, bool(slower))


def _moves(program: Program, placement: Placement, limits: PathLimits) -> list[_Stretch | Dwell]:
    """The moves of a G-code program in B, with constant orientation; and its dwells."""
    turn = _Turn(Rotation.from_matrix(placement.R_BT))
    items: list[_Stretch | Dwell] = []
    for action in program.actions:
        if isinstance(action, Dwell):
            items.append(action)
        else:
            feed = limits.rapid_speed if action.feed is None else action.feed
            shape, rapid = _shape(action, placement), action.feed is None
            said = (feed, action.line, action.block, action.spindle_speed)
            items.append(_Stretch(shape, turn, *said, tolerance=action.tolerance, tool=action.tool, rapid=rapid))
    return items


def _shape(move: Move, placement: Placement) -> Shape:
    start, end = placement.to_base(move.start), placement.to_base(move.end)
    if not isinstance(move, Arc):
        return line(start, end)
    axis = placement.R_BP @ np.asarray(move.axis)
    return helix(start, placement.to_base(move.centre), axis, move.angle, float((end - start) @ axis))


def _points(path: PointPath, placement: Placement) -> list[_Stretch | Dwell]:
    """The moves of a point list in B: lines with the chosen interpolation of the orientation, and turns between equal positions."""
    points = path.points
    rotations = _orientations(points, placement)
    items: list[_Stretch | Dwell] = []
    reached, turn = rotations[0], _Turn(rotations[0])
    for i in range(1, len(points)):
        p = points[i]
        start, end = placement.to_base(points[i - 1].position), placement.to_base(p.position)
        number = p.line or i + 1
        said = (p.feed, number, number, p.spindle_speed)
        if np.any(end != start):
            shape = line(start, end)
            over = path.interpolation == "path"
            if over and rotations[i] is not rotations[i - 1]:
                turn = _over(rotations[i - 1], rotations[i], shape.length)
            elif turn.R is not rotations[i - 1] or not turn.steady:
                turn = _Turn(rotations[i - 1])
            items.append(_Stretch(shape, turn, *said, distance=p.blend, tool=p.tool, rapid=p.rapid))
            reached = rotations[i] if over else rotations[i - 1]
        if i + 1 == len(points) or np.all(end == start):
            angle = float((reached.inv() * rotations[i]).magnitude())
            if angle > _SAME_ORIENTATION:
                items.append(_Stretch(point(end, angle), _over(reached, rotations[i], angle), *said, tool=p.tool, in_place=True))
            reached = rotations[i]
        if p.dwell > 0.0:
            items.append(Dwell(number, number, p.dwell, p.spindle_speed, p.tool))
    return items


def _orientations(points: Sequence[PathPoint], placement: Placement) -> list[Rotation]:
    """R_BT at each point; one object where it stays what it was."""
    upright, R_BP = Rotation.from_matrix(placement.R_BT), Rotation.from_matrix(placement.R_BP)
    found: list[Rotation] = []
    for i, p in enumerate(points):
        if i > 0 and p.quat == points[i - 1].quat and p.abc == points[i - 1].abc:
            found.append(found[-1])
        else:
            found.append(upright * Rotation.from_abc(p.abc) if p.quat is None else R_BP * Rotation.from_quat(np.roll(p.quat, -1)))
    return found


def _over(start: Rotation, end: Rotation, length: float) -> _Turn:
    """Turn from `start` to `end` at an even rate over a length, about one axis fixed in space."""
    vector = (start.inv() * end).as_rotvec()
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return _Turn(start)
    f = np.zeros(6)
    f[1] = angle / length
    return _Turn(start, vector / angle, f)


def _runs(items: list[_Stretch | Dwell], limits: PathLimits) -> list[list[_Stretch] | Dwell]:
    """Moves with blends between them, cut into runs where the path must stop; turns in place where the orientation jumps there."""
    runs: list[list[_Stretch] | Dwell] = []
    run: list[_Stretch] = []
    used = 0.0
    for i, move in enumerate(items):
        if isinstance(move, Dwell):
            runs.append(move)
            continue
        following = items[i + 1] if i + 1 < len(items) else None
        joint = _joint(move, following, i + 1) if isinstance(following, _Stretch) else None
        cut = joint[0] if joint else 0.0
        if move.shape.length - cut > used + 1e-12:
            run.append(replace(move, shape=move.shape.part(used, move.shape.length - cut), turn=move.turn.part(used)))
        used = cut
        if joint is not None:
            run += joint[1]
            continue
        if run:
            runs.append(run)
        run = []
        if isinstance(following, _Stretch) and not _goes_on(move.turn, following.turn):
            end, start = move.turn.at(move.shape.length), following.turn.R
            angle = float((end.inv() * start).magnitude())
            if angle > _SAME_ORIENTATION:
                shape = point(move.shape.at(move.shape.length)[0], angle)
                runs.append([replace(move, shape=shape, turn=_over(end, start, angle), in_place=True)])
    return [[replace(s, feed=limits.angular_speed) if s.in_place else s for s in r] if isinstance(r, list) else r for r in runs]


def _joint(before: _Stretch, after: _Stretch, corner: int) -> tuple[float, list[_Stretch]] | None:
    """How two moves are joined: None = stop; else blend distance and blend pieces (0 and none: run straight through)."""
    if before.in_place or after.in_place or before.spindle != after.spindle or before.tool != after.tool:
        return None
    _, t0, k0 = before.shape.at(before.shape.length)
    _, t1, k1 = after.shape.at(0.0)
    angle = math.atan2(float(np.linalg.norm(np.cross(t0, t1))), float(t0 @ t1))
    shorter = min(before.shape.length, after.shape.length)
    even = _turns_on(before.turn, after.turn, before.shape.length, shorter)
    if angle < _STRAIGHT_ON and float(np.linalg.norm(k1 - k0)) * shorter < _STRAIGHT_ON and even:
        return 0.0, []
    by_tolerance = before.tolerance > 0.0 and after.tolerance > 0.0
    if before.distance > 0.0 or by_tolerance:
        if angle > _REVERSAL:
            return None
        limit = min(0.5 * shorter, before.distance if before.distance > 0.0 else LONGEST_BLEND * before.tolerance)
        found = blend(before.shape, after.shape, limit, None if before.distance > 0.0 else before.tolerance)
        if found is None:
            return None
        return found[0], _blend_pieces(before, after, corner, *found)
    return (0.0, []) if angle < _KINK and even else None


def _goes_on(before: _Turn, after: _Turn) -> bool:
    """Whether two moves share one orientation that does not change: those of a G-code program do, and rotations take time."""
    return before is after and before.steady


def _turns_on(before: _Turn, after: _Turn, length: float, shorter: float) -> bool:
    """Whether the orientation goes on from one move, of this length [m], to the next without a step in angle or rate."""
    if _goes_on(before, after):
        return True
    twist = float((before.at(length).inv() * after.R).magnitude())
    rates = before.axis_1 * before.f_1[1] - after.axis_1 * after.f_1[1]
    return twist < _SAME_ORIENTATION and float(np.linalg.norm(rates)) * shorter < 1e-9


def _blend_pieces(before: _Stretch, after: _Stretch, corner: int, distance: float, pieces: list[Polynomial]) -> list[_Stretch]:
    """Pieces of a blend with feed, block and orientation: C2 over the path, as the position."""
    length = sum(p.length for p in pieces)
    turn = _blend_turn(before.turn, after.turn, before.shape.length, distance, length)
    feed = min(before.feed, after.feed)
    result: list[_Stretch] = []
    s = 0.0
    for piece in pieces:
        owner = before if s + 0.5 * piece.length < 0.5 * length else after
        said = (feed, owner.line, owner.block, owner.spindle)
        result.append(_Stretch(piece, turn.part(s), *said, owner.tolerance, owner.distance, owner.tool, rapid=owner.rapid, corner=corner))
        s += piece.length
    return result


def _blend_turn(before: _Turn, after: _Turn, reach: float, distance: float, length: float) -> _Turn:
    """Orientation over a blend of `length` that begins `distance` before the end of a move of length `reach` [m]."""
    if _goes_on(before, after):
        return before
    meeting = before.at(reach)
    vector = (meeting.inv() * after.R).as_rotvec()
    step = float(np.linalg.norm(vector))
    if step > _SAME_ORIENTATION:
        # the orientation changes in the corner: constant before and after, a smooth step from one to the other
        return _Turn(before.R, vector / step, hermite(length, (0.0, 0.0, 0.0, step, 0.0, 0.0)))
    # the rate changes: what is left of the first rotation runs out while the second one sets in
    rate_1, rate_2 = before.f_1[1], after.f_1[1]
    f_1 = hermite(length, (-rate_1 * distance, rate_1, 0.0, 0.0, 0.0, 0.0))
    f_2 = hermite(length, (0.0, 0.0, 0.0, rate_2 * distance, rate_2, 0.0))
    return _Turn(meeting, before.axis_1, f_1, after.axis_1, f_2)


def _speeds(run: list[_Stretch], limits: PathLimits, slower: Mapping[int, float]) -> tuple[list[float], list[Reduction]]:
    """The speed that each element of a run allows, and each block whose feed is not held."""
    speeds: list[float] = []
    lowest: dict[tuple[int, int], tuple[float, float]] = {}
    for element in run:
        speed = element.feed
        if not element.in_place:
            curvature = element.shape.curvature
            if curvature > 0.0:
                speed = min(speed, math.sqrt(limits.lateral_acceleration / curvature))
            rate, bend = element.turn.fastest(element.shape.length)
            if rate > 0.0:
                speed = min(speed, limits.angular_speed / rate)
            if bend > 0.0:
                speed = min(speed, math.sqrt(limits.angular_acceleration / bend))
        speeds.append(speed * slower.get(element.line, 1.0))
    for _, pieces in itertools.groupby(range(len(run)), key=lambda i: run[i].corner or -i):
        blend_pieces = list(pieces)
        speed = min(speeds[i] for i in blend_pieces)  # constant speed through a blend
        for i in blend_pieces:
            speeds[i] = speed
            if speed < run[i].feed and not run[i].rapid:
                key = (run[i].line, run[i].block)
                lowest[key] = min(lowest.get(key, (speed, run[i].feed)), (speed, run[i].feed))
    return speeds, [Reduction(number, block, feed, speed) for (number, block), (speed, feed) in lowest.items()]


def _profile(elements: list[_Stretch], speeds: list[float], limits: PathLimits) -> FloatArray:
    """Speed profile of a run, rows as `Phase`; neighbours with equal speed form one zone."""
    zones: list[tuple[float, float]] = []
    for element, speed in zip(elements, speeds, strict=True):
        if zones and zones[-1][1] == speed:
            zones[-1] = (zones[-1][0] + element.shape.length, speed)
        else:
            zones.append((element.shape.length, speed))
    if elements[0].in_place:
        return phases(zones, limits.angular_acceleration, limits.angular_jerk)
    return phases(zones, limits.acceleration, limits.jerk)


def _element_rows(elements: list[_Stretch]) -> FloatArray:
    """What the rows of each element have in common (n, 50)."""
    rows = np.zeros((len(elements), COLUMNS))
    for row, element in zip(rows, elements, strict=True):
        turn = element.turn
        row[KIND], row[GEOMETRY : GEOMETRY + GEOMETRY_COLUMNS] = element.shape.row()
        row[BLOCK], row[LINE], row[SPINDLE], row[TOOL] = element.block, element.line, element.spindle, element.tool
        row[QUAT : QUAT + 4] = turn.quat
        if not turn.steady:
            row[AXIS_1 : AXIS_1 + 3], row[F_1 : F_1 + 6] = turn.axis_1, turn.f_1
            row[AXIS_2 : AXIS_2 + 3], row[F_2 : F_2 + 6] = turn.axis_2, turn.f_2
    return rows


def _rows(run: list[_Stretch], elements: FloatArray, profile: FloatArray, tau: float) -> FloatArray:
    """Table rows of a run that begins at the path time tau [s]: cut wherever an element or a phase ends."""
    edges = np.concatenate([[0.0], np.cumsum([e.shape.length for e in run])])
    owners, laws = np.zeros(len(run) + len(profile), dtype=np.int64), np.zeros((len(run) + len(profile), 5))
    count = _cut(edges, profile, tau, owners, laws)
    rows = elements[owners[:count]]
    rows[:, [TAU, SIGMA, SPEED, ACCELERATION, JERK]] = laws[:count]
    return rows


@loaded_on_call
def _cut(edges: FloatArray, profile: FloatArray, tau: float, owners: IntArray, laws: FloatArray) -> int:
    """Fill the elements and time laws (tau, sigma, speed, acceleration, jerk) of the rows of a run; returns their number.

    `edges` (n + 1,) are the path [m] where elements begin and end, `profile` rows as `Phase`.
    """
    close = 1e-13 + 1e-15 * edges[-1]
    i = count = 0
    for k in range(len(profile)):
        time, duration, path, speed, acceleration, jerk = profile[k]
        t = 0.0
        end = path_at(path, speed, acceleration, jerk, duration)
        while t < duration:
            crossed = i + 2 < len(edges) and edges[i + 1] <= end + close
            until = duration
            if crossed and edges[i + 1] < end - close:
                until = time_at(time, duration, path, speed, acceleration, jerk, edges[i + 1])
            if until > t:
                owners[count] = i
                laws[count, 0] = tau + time + t
                laws[count, 1] = path_at(path, speed, acceleration, jerk, t) - edges[i]
                laws[count, 2] = speed + t * (acceleration + t * jerk / 2.0)
                laws[count, 3] = acceleration + t * jerk
                laws[count, 4] = jerk
                count += 1
            t = until
            if crossed:
                i += 1
    return count


def pilot_table(tau: FloatArray, forces: FloatArray, tolerance_n: float = 10.0) -> FloatArray:
    """Reduce an offline force record to few rows (path time [s], fx, fy, fz [N] in B), linear in between.

    `tau` (n,) increasing, `forces` (n, 3). Ramer-Douglas-Peucker with the force error at equal time as distance (time
    and force have no common measure): nowhere does the result deviate from the record by more than `tolerance_n` [N].
    ValueError if the shapes do not fit, times do not increase or a value is not finite.
    """
    times, values = np.asarray(tau, dtype=np.float64), np.asarray(forces, dtype=np.float64)
    if times.ndim != 1 or values.shape != (len(times), 3) or len(times) < 2:
        raise ValueError(f"pilot table: expected path times (n,) and forces (n, 3) with n >= 2; found {times.shape} and {values.shape}")
    if not np.all(np.isfinite(values)) or not np.all(np.diff(times) > 0.0):
        raise ValueError("pilot table: path times must increase and all forces be finite; sort the record and drop repeated times")
    keep = np.zeros(len(times), dtype=bool)
    keep[[0, -1]] = True
    spans = [(0, len(times) - 1)]
    while spans:
        a, b = spans.pop()
        if b - a < 2:
            continue
        share = (times[a + 1 : b] - times[a]) / (times[b] - times[a])
        error = np.linalg.norm(values[a + 1 : b] - values[a] - share[:, None] * (values[b] - values[a]), axis=1)
        worst = int(np.argmax(error))
        if error[worst] > tolerance_n:
            middle = a + 1 + worst
            keep[middle] = True
            spans += [(a, middle), (middle, b)]
    return np.column_stack([times[keep], values[keep]])
