"""Check before a run that the robot can follow a plan: reach, axis limits, axis speeds, accelerations and jerks, singular poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.models.components.path_interpolator import MODEL, Q_START, evaluate
from robomill.models.model.compiled import compiled_on_call
from robomill.models.model.declaration import FloatArray, record
from robomill.models.model.model_code import model_code
from robomill.models.model.parameters import load, quantity
from robomill.models.planning.gcode import Program
from robomill.models.planning.point_path import PointPath
from robomill.models.planning.quantities import QUANTITIES, Quantity
from robomill.models.planning.segment_table import AXIS_1, LINE
from robomill.models.planning.trajectory import LIMITS, PathLimits, Placement, Plan, PlanError, plan
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS, Robot, Tool, jacobian, robot_variables

CLOCK = 0.004
"""Interpolation clock T_IPO [s] of the robot controller: the axis angles are what it is sent, so they are looked at in this step."""
SINGULAR = ("wrist", "elbow", "shoulder")
_CHUNK = 8192
"""Clock ticks that are looked at together."""
_ROUNDS, _BELOW = 20, 0.99
"""Plans that are made at most until all limits are kept, and the share of a limit that the next one aims at."""
_SLOWEST = 1e-3
"""Share of the feed below which a line counts as one that cannot be moved along."""
_ALIGNED = 1e-6
"""Nearness to a singular pose below which Eq. (4.5) is solved by least squares."""


@dataclass(frozen=True)
class AxisLimits:
    """How fast axes may change their speed, for any robot (models/data/planning)."""

    name: str
    time_to_speed: float = field(metadata=quantity("s", 1e-6))
    time_to_acceleration: float = field(metadata=quantity("s", 1e-6))

    def of(self, robot: Robot) -> FloatArray:
        """Limits (3, 6): speed [rad/s], acceleration [rad/s2], jerk [rad/s3]."""
        acceleration: FloatArray = robot.speed_max / self.time_to_speed
        return np.array([robot.speed_max, acceleration, acceleration / self.time_to_acceleration])


AXIS_LIMITS = load(AxisLimits, "planning/axis_limits")
"""Default limits."""


@dataclass(frozen=True)
class Worst:
    """The worst place of something along a plan."""

    value: float
    tau: float
    """Path time [s]."""
    line: int
    """Line of the program."""


@dataclass(frozen=True)
class Reach:
    """What following a plan asks of the axes, at every tick of the clock."""

    margin: FloatArray
    """Smallest distance of each axis from its limits [rad] (6,)."""
    margin_where: tuple[Worst, ...]
    """Where that is."""
    peaks: FloatArray
    """Largest speed [rad/s], acceleration [rad/s2] and jerk [rad/s3] of each axis (3, 6) at speed ratio 1."""
    limits: FloatArray
    """Their limits (3, 6)."""
    where: tuple[tuple[Worst, ...], ...]
    """For each quantity and axis the place of the peak; its `value` is the share of the limit."""
    singular: tuple[Worst, ...]
    """Nearest to a singular pose: |sin A5| (wrist), |sin| of the angle between upper arm and forearm (elbow), distance of the
    wrist centre from axis 1 over the length of both arms (shoulder). Zero is singular; each is a factor of det J."""
    line_shares: FloatArray
    """Largest share of any axis's limit (lines + 1, 3) on each line of the program, for each quantity."""

    @property
    def speed(self) -> FloatArray:
        """Largest speed of each axis [rad/s] (6,)."""
        speeds: FloatArray = self.peaks[0]
        return speeds

    @property
    def share(self) -> FloatArray:
        """Peaks over limits (3, 6)."""
        shares: FloatArray = self.peaks / self.limits
        return shares

    def too_fast(self, plan: Plan) -> tuple[str, ...]:
        """One text for each axis that would have to be faster than it can."""
        return tuple(
            f"{plan.where(worst.tau)}: path time {worst.tau:.3f} s: axis A{i + 1} would turn at "
            f"{math.degrees(self.peaks[0, i]):.1f} deg/s, it can do {math.degrees(self.limits[0, i]):.1f} deg/s{self._because(worst)}; "
            "reduce the feed there, or turn the tool about its axis"
            for i, worst in enumerate(self.where[0])
            if worst.value > 1.0
        )

    def _because(self, worst: Worst) -> str:
        """The singular pose that is nearest on that line, if one is near."""
        near = [(s.value, name) for s, name in zip(self.singular, SINGULAR, strict=True) if s.line == worst.line and s.value < _NEAR]
        return f", near a singular pose ({min(near)[1]})" if near else ""


_NEAR = 0.33
"""Nearness to a singular pose that is worth a word: below |sin A5| = 0.33 lie the poses in which a KR 210-2 with the spindle across its
flange exceeds a speed limit at 50 mm/s (FACTS10 10.5)."""


def check_reachable(
    plan: Plan, robot: Robot = KR300, tool: Tool = SPINDLE_ACROSS, q_start: Sequence[float] | FloatArray = Q_START
) -> Reach:
    """As `survey`; PlanError also where an axis would have to be faster than it can."""
    reach = survey(plan, robot, tool, q_start)
    if np.max(reach.share[0]) > 1.0:
        worst = int(np.argmax(reach.share[0]))
        texts = [text for text in reach.too_fast(plan) if f"axis A{worst + 1} " in text]
        raise PlanError(texts[0])
    return reach


def survey(
    plan: Plan,
    robot: Robot = KR300,
    tool: Tool = SPINDLE_ACROSS,
    q_start: Sequence[float] | FloatArray = Q_START,
    axis_limits: AxisLimits = AXIS_LIMITS,
) -> Reach:
    """Follow the whole plan with the inverse kinematics of the path interpolator.

    Axis speeds by the Jacobian, dq/dt = J^-1 [v; omega] (Englert 2011, Eq. 4.5); accelerations and jerks by the second and third
    differences of the axis angles over the clock, which is what the axes are sent. `q_start` [rad] chooses the branch. PlanError
    names the line of the program, the axis, its value and its limits if a pose is out of reach or an axis leaves its limits.
    """
    data = _at_rest(plan, robot, tool, q_start)
    limits = axis_limits.of(robot)
    found = _Found(limits, int(np.max(plan.table[:, LINE])))
    ticks = math.ceil(plan.duration / CLOCK) + 3  # two ticks of rest show the last differences
    before = np.tile(data["q_ref"], (3, 1))
    for first in range(0, ticks, _CHUNK):
        times = np.minimum(np.arange(first, min(first + _CHUNK, ticks)) * CLOCK, plan.duration)
        angles = np.concatenate([before, np.zeros((len(times), 6))])
        status = _follow(data, times, angles[3:])
        _refuse(plan, data, status)
        _look(plan, robot, data, times, angles, found)
        before = angles[-3:].copy()
    places = tuple(_worst(*rows) for rows in found.places())
    singular = tuple(Worst(*x) for x in found.nearest)
    nearest = _worst(found.margin, found.margin_tau, found.margin_line)
    return Reach(found.margin, nearest, found.share * limits, limits, places, singular, found.line_shares)


def _worst(values: FloatArray, tau: FloatArray, lines: FloatArray) -> tuple[Worst, ...]:
    """Places of six axes."""
    return tuple(Worst(float(v), float(t), int(n)) for v, t, n in zip(values, tau, lines, strict=True))


def plan_within(
    program: Program | PointPath,
    placement: Placement,
    robot: Robot,
    tool: Tool,
    q_start: Sequence[float] | FloatArray,
    within: Quantity,
    limits: PathLimits = LIMITS,
    axis_limits: AxisLimits = AXIS_LIMITS,
) -> tuple[Plan, Reach]:
    """Plan with the feed lowered on lines on which an axis would exceed its limit of speed; also of acceleration, of jerk, as `within`.

    A line is slowed as a whole, so that its feed stays constant. Speeds go with the feed, accelerations with its square, jerks with
    its cube; ramps and neighbours do not, so that it is repeated. PlanError as of `survey`, and where it does not come to an end.
    """
    used = QUANTITIES.index(within) + 1
    slower: dict[int, float] = {}
    for _ in range(_ROUNDS):
        planned = plan(program, placement, limits, slower)
        reach = survey(planned, robot, tool, q_start, axis_limits)
        shares = reach.line_shares[:, :used] ** (1.0 / np.arange(1, used + 1))
        over = np.max(shares, axis=1)
        if np.max(over) <= 1.0:
            return planned, reach
        for number in np.flatnonzero(over > 1.0).tolist():
            slower[number] = slower.get(number, 1.0) * _BELOW / over[number]
        if min(slower.values()) < _SLOWEST:
            break
    line = min(slower, key=lambda n: slower[n])
    raise PlanError(
        f"{program.name} line {line}: an axis would exceed its {within} limit unless the feed falls to {100.0 * slower[line]:.2g} %; "
        "the line passes a singular pose, or another one holds it up; move the workpiece, or turn the tool about its axis"
    )


class _Found:
    """The worst places so far."""

    def __init__(self, limits: FloatArray, lines: int) -> None:
        self.limits = limits
        self.margin = np.full(6, math.inf)
        self.margin_tau, self.margin_line = np.zeros(6), np.zeros(6)
        self.share = np.zeros((3, 6))
        self.tau, self.line = np.zeros((3, 6)), np.zeros((3, 6))
        self.nearest: list[tuple[float, float, int]] = [(math.inf, 0.0, 0)] * 3
        self.line_shares = np.zeros((lines + 1, 3))

    def places(self) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Shares, path times and lines of the six axes, for each quantity."""
        return [(self.share[k], self.tau[k], self.line[k]) for k in range(3)]


def axis_angles(plan: Plan, times: FloatArray, robot: Robot, tool: Tool, q_start: Sequence[float] | FloatArray) -> FloatArray:
    """Axis angles [rad] (n, 6) at path times [s] (n,); `q_start` [rad] chooses the branch. PlanError as `survey`."""
    data = _at_rest(plan, robot, tool, q_start)
    ticks = np.union1d(np.arange(0.0, plan.duration, CLOCK), times)
    angles = np.zeros((len(ticks), 6))
    _refuse(plan, data, _follow(data, ticks, angles))
    found: FloatArray = angles[np.searchsorted(ticks, times)]
    return found


def _at_rest(plan: Plan, robot: Robot, tool: Tool, q_start: Sequence[float] | FloatArray) -> npt.NDArray[np.void]:
    """Data of a path interpolator at the beginning of the plan."""
    data = MODEL.new()
    for variable in robot_variables(robot, tool):
        if variable.causality == "parameter":
            data[variable.name] = variable.start_values
    data["q_start"] = q_start
    data["speed_ratio"] = 0.0  # the path time is set, not run
    MODEL.load_table(data, "segments", plan.table)
    _refuse(plan, data, model_code(MODEL).init(data.ctypes.data))
    return data


def _refuse(plan: Plan, data: npt.NDArray[np.void], status: int) -> None:
    """PlanError in the words of the path interpolator."""
    if status:
        tau = float(data["path_time"][0])
        raise PlanError(f"{plan.where(tau)}: {MODEL.message(status, record(data), tau).split(': ', 1)[1]}")


def _look(plan: Plan, robot: Robot, data: npt.NDArray[np.void], times: FloatArray, angles: FloatArray, found: _Found) -> None:
    """Take a chunk of ticks into `found`: `times` (n,) and `angles` (n + 3, 6), three ticks before them included."""
    q = angles[3:]
    J, wrist = np.zeros((len(times), 6, 6)), np.zeros(len(times))
    _jacobians(data, q, J, wrist)
    lines = plan.rows(times)[0][:, LINE].astype(np.int64)
    nearness = _nearness(robot, q, wrist)
    for k, row in enumerate(nearness):
        i = int(np.argmin(row))
        if row[i] < found.nearest[k][0]:
            found.nearest[k] = (float(row[i]), float(times[i]), int(lines[i]))
    twists = np.column_stack([plan.velocity(times), _angular_velocity(plan, times)])
    speeds = _solved(J, twists, np.min(nearness, axis=0) < _ALIGNED)
    second = (angles[3:] - 2.0 * angles[2:-1] + angles[1:-2]) / CLOCK**2
    third = (angles[3:] - 3.0 * angles[2:-1] + 3.0 * angles[1:-2] - angles[:-3]) / CLOCK**3
    for k, values in enumerate((speeds, second, third)):
        shares = np.abs(values) / found.limits[k]
        np.maximum.at(found.line_shares[:, k], lines, np.max(shares, axis=1))
        worst = np.argmax(shares, axis=0)
        top = shares[worst, range(6)]
        more = top > found.share[k]
        found.share[k, more], found.tau[k, more], found.line[k, more] = top[more], times[worst][more], lines[worst][more]
    margins = np.minimum(q - robot.q_min, robot.q_max - q)
    worst = np.argmin(margins, axis=0)
    least = margins[worst, range(6)]
    less = least < found.margin
    found.margin[less], found.margin_tau[less], found.margin_line[less] = least[less], times[worst][less], lines[worst][less]


def _solved(J: FloatArray, twists: FloatArray, aligned: npt.NDArray[np.bool_]) -> FloatArray:
    """Axis speeds [rad/s] (n, 6): Eq. (4.5), least squares where the pose is singular (`aligned`)."""
    speeds = np.empty_like(twists)
    speeds[~aligned] = np.linalg.solve(J[~aligned], twists[~aligned, :, None])[:, :, 0]
    if np.any(aligned):
        speeds[aligned] = np.einsum("nij,nj->ni", np.linalg.pinv(J[aligned], rcond=1e-9), twists[aligned])
    return speeds


def _nearness(robot: Robot, q: FloatArray, wrist: FloatArray) -> FloatArray:
    """As `Reach.singular` (3, n), for axis angles (n, 6) and the distance of the wrist centre from axis 1 [m] (n,)."""
    theta = q * robot.axis_sign + robot.dh_offset + q @ robot.axis_coupling.T
    bend = math.atan2(robot.dh_d[3], robot.dh_a[3])
    arms = robot.dh_a[2] + math.hypot(robot.dh_a[3], robot.dh_d[3])
    return np.array([np.abs(np.sin(theta[:, 4])), np.abs(np.sin(theta[:, 2] + bend)), wrist / arms])


@compiled_on_call
def _follow(data: npt.NDArray[Any], times: FloatArray, angles: FloatArray) -> int:
    """Fill the axis angles [rad] (n, 6) at path times (n,); a status as in `MODEL.errors` at the first pose that cannot be reached."""
    for i in range(len(times)):
        s = data[0]
        s.path_time = times[i]
        status = evaluate(s, False)
        if status != 0:
            return status
        for k in range(6):
            angles[i, k] = s.q_ref[k]
    return 0


@compiled_on_call
def _jacobians(data: npt.NDArray[np.void], angles: FloatArray, J: FloatArray, wrist: FloatArray) -> None:
    """The Jacobian (n, 6, 6) and the distance of the wrist centre from axis 1 [m] (n,) at axis angles (n, 6)."""
    for i in range(len(angles)):
        s = data[0]
        jacobian(s, angles[i], J[i])
        wrist[i] = math.sqrt(s.link_p[3, 0] * s.link_p[3, 0] + s.link_p[3, 1] * s.link_p[3, 1])


def _angular_velocity(plan: Plan, times: FloatArray) -> FloatArray:
    """Angular velocity of T in B [rad/s] (n, 3), by central differences over 20 us."""
    if not np.any(plan.rows(times)[0][:, AXIS_1:]):
        return np.zeros((len(times), 3))
    before, after = (np.clip(times + x, 0.0, plan.duration) for x in (-1e-5, 1e-5))
    vector: FloatArray = (plan.rotation(after) * plan.rotation(before).inv()).as_rotvec() / (after - before)[:, None]
    return vector
