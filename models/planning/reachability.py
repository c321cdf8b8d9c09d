"""Check before a run that the robot can follow a plan: reach, axis limits, axis speeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.models.components.path_interpolator import MODEL, Q_START
from robomill.models.model.compiled import compiled_on_call
from robomill.models.model.declaration import FloatArray, record
from robomill.models.planning.segment_table import AXIS_1, TAU
from robomill.models.planning.trajectory import Plan, PlanError
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS, Robot, Tool, jacobian, robot_variables

_MOST_PATH, _MOST_ANGLE = 10e-3, math.radians(5.0)
"""Samples are at most this many m and rad apart: an axis angle bends by less than 1e-5 rad over 10 mm."""
_LEAST_PATH, _LEAST_ANGLE = 2e-3, math.radians(1.0)
"""Samples at the ends of rows are left out if they are closer than this."""

_CHUNK = 4096
"""Rows that are looked at together."""


@dataclass(frozen=True)
class Reach:
    """Axis angles and speeds along a plan, sampled at most 10 mm and 5 deg apart."""

    tau: FloatArray
    """Path time [s] (n,)."""
    q: FloatArray
    """Axis angles [rad] (n, 6)."""
    margin: FloatArray
    """Smallest distance of each axis from its limits [rad] (6,)."""
    speed: FloatArray
    """Largest speed of each axis [rad/s] (6,) at speed ratio 1."""


def check_reachable(
    plan: Plan, robot: Robot = KR300, tool: Tool = SPINDLE_ACROSS, q_start: Sequence[float] | FloatArray = Q_START
) -> Reach:
    """Follow the whole plan with the inverse kinematics of the path interpolator.

    `q_start` [rad] chooses the branch. PlanError names the line of the program, the axis, its value and its limits if a
    pose is out of reach, an axis leaves its limits, or an axis would have to be faster than it can.
    """
    data = MODEL.new()
    for variable in robot_variables(robot, tool):
        if variable.causality == "parameter":
            data[variable.name] = variable.start_values
    data["q_start"] = q_start
    MODEL.load_table(data, "segments", plan.table)
    times = _samples(plan)
    angles = _follow(plan, data, times)
    twists = np.column_stack([plan.velocity(times), _angular_velocity(plan, times)])
    J = np.zeros((len(times), 6, 6))
    _jacobians(data, angles, J)
    # Englert (2011), Eq. (4.5); least squares where the wrist is aligned
    speeds = np.abs(np.einsum("nij,nj->ni", np.linalg.pinv(J, rcond=1e-9), twists))
    excess = speeds / robot.speed_max
    if np.max(excess) > 1.0:
        moment, axis = divmod(int(np.argmax(excess)), 6)
        raise PlanError(
            f"{plan.where(float(times[moment]))}: path time {times[moment]:.3f} s: "
            f"axis A{axis + 1} would turn at {np.rad2deg(speeds[moment, axis]):.1f} deg/s, "
            f"it can do {np.rad2deg(robot.speed_max[axis]):.1f} deg/s; reduce the feed there, or turn the tool about its axis"
        )
    margin = np.min(np.minimum(angles - robot.q_min, robot.q_max - angles), axis=0)
    return Reach(times, angles, margin, np.max(speeds, axis=0))


def _follow(plan: Plan, data: npt.NDArray[np.void], times: FloatArray) -> FloatArray:
    """Axis angles [rad] (n, 6) of the path interpolator at path times [s]."""
    argument: Any
    try:
        (init, step), argument = MODEL.compiled_for_data(), data
    except ImportError:
        (init, step), argument = MODEL.plain(), record(data)
    data["speed_ratio"] = 0.0  # the path time stands still: a step evaluates it
    angles = np.zeros((len(times), 6))
    for i, tau in enumerate(times.tolist()):
        data["path_time"] = tau
        status = init(argument) if i == 0 else step(argument, tau, 1.0)
        if status:
            raise PlanError(f"{plan.where(tau)}: {MODEL.message(status, record(data), tau).split(': ', 1)[1]}")
        angles[i] = data["q_ref"][0]
    return angles


@compiled_on_call
def _jacobians(data: npt.NDArray[np.void], angles: FloatArray, J: FloatArray) -> None:
    """The Jacobian (n, 6, 6) at axis angles (n, 6)."""
    for i in range(len(angles)):
        jacobian(data[0], angles[i], J[i])


def _angular_velocity(plan: Plan, times: FloatArray) -> FloatArray:
    """Angular velocity of T in B [rad/s] (n, 3), by central differences over 20 us."""
    before, after = (np.clip(times + x, 0.0, plan.duration) for x in (-1e-5, 1e-5))
    vector: FloatArray = (plan.rotation(after) * plan.rotation(before).inv()).as_rotvec() / (after - before)[:, None]
    return vector


def _samples(plan: Plan) -> FloatArray:
    """Path times [s] to look at: the ends of rows, and between them so that no step is longer than allowed."""
    edges = plan.table[:, TAU]
    kept = [0.0]
    path = angle = 0.0
    for start, end, far, wide in zip(*(x.tolist() for x in (edges[:-1], edges[1:], *_extents(plan))), strict=True):
        n = max(1, math.ceil(far / _MOST_PATH), math.ceil(wide / _MOST_ANGLE))
        path, angle = path + far, angle + wide
        if n > 1 or path >= _LEAST_PATH or angle >= _LEAST_ANGLE:
            kept += [float(x) for x in np.linspace(start, end, n + 1)[1:]]
            path = angle = 0.0
    if kept[-1] < edges[-1]:
        kept.append(float(edges[-1]))
    return np.array(kept)


def _extents(plan: Plan) -> tuple[FloatArray, FloatArray]:
    """Path [m] and turn [rad] of every row but the last, (n,) each, from nine points of it."""
    edges = plan.table[:, TAU]
    far, wide = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
    turning = np.any(plan.table[:-1, AXIS_1:], axis=1)
    for first in range(0, len(far), _CHUNK):
        rows = np.arange(first, min(first + _CHUNK, len(far)))
        start, end = edges[rows, None], edges[rows + 1, None]
        tau = start + (np.nextafter(end, start) - start) * np.linspace(0.0, 1.0, 9)
        moved = np.diff(plan.position(tau.ravel()).reshape(len(rows), 9, 3), axis=1)
        far[rows] = np.sum(np.linalg.norm(moved, axis=2), axis=1)
        if np.any(turning[rows]):
            turned = tau[turning[rows]]
            before, after = plan.rotation(turned[:, :-1].ravel()), plan.rotation(turned[:, 1:].ravel())
            wide[rows[turning[rows]]] = np.sum((before.inv() * after).magnitude().reshape(-1, 8), axis=1)
    return far, wide
