"""Check before a run that the robot can follow a plan: reach, axis limits, axis speeds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.declaration import FloatArray, record
from models.path_interpolator import MODEL, Q_START, evaluate, init
from models.robots import KR300, SPINDLE_ACROSS, Robot, Tool, jacobian, robot_variables
from models.segment_table import AXIS_1, TAU
from models.trajectory import Plan, PlanError

_MOST_PATH, _MOST_ANGLE = 10e-3, math.radians(5.0)
"""Samples are at most this many m and rad apart: an axis angle bends by less than 1e-5 rad over 10 mm."""
_LEAST_PATH, _LEAST_ANGLE = 2e-3, math.radians(1.0)
"""Samples at the ends of rows are left out if they are closer than this."""


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


def check_reachable(plan: Plan, robot: Robot = KR300, tool: Tool = SPINDLE_ACROSS, q_start: Sequence[float] = Q_START) -> Reach:
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
    s = record(data)
    times = _samples(plan)
    twists = np.column_stack([plan.velocity(times), _angular_velocity(plan, times)])
    angles, speeds, J = np.zeros((len(times), 6)), np.zeros((len(times), 6)), np.zeros((6, 6))
    status = init(s)
    for i, tau in enumerate(times):
        if i > 0:
            s.path_time = tau
            status = evaluate(s, False)
        if status:
            raise PlanError(f"{plan.where(float(tau))}: {MODEL.message(status, s, float(tau)).split(': ', 1)[1]}")
        angles[i] = s.q_ref
        jacobian(s, angles[i], J)
        # Englert (2011), Eq. (4.5); least squares where the wrist is aligned
        speeds[i] = np.abs(np.linalg.lstsq(J, twists[i], rcond=1e-9)[0])
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


def _angular_velocity(plan: Plan, times: FloatArray) -> FloatArray:
    """Angular velocity of T in B [rad/s] (n, 3), by central differences over 20 us."""
    before, after = (np.clip(times + x, 0.0, plan.duration) for x in (-1e-5, 1e-5))
    vector: FloatArray = (plan.rotation(after) * plan.rotation(before).inv()).as_rotvec() / (after - before)[:, None]
    return vector


def _samples(plan: Plan) -> FloatArray:
    """Path times [s] to look at: the ends of rows, and between them so that no step is longer than allowed."""
    edges = plan.table[:, TAU]
    steps = np.linspace(0.0, 1.0, 9)
    kept = [0.0]
    path = angle = 0.0
    for i, (start, end) in enumerate(itertools.pairwise(edges)):
        tau = start + (np.nextafter(end, start) - start) * steps
        far = float(np.sum(np.linalg.norm(np.diff(plan.position(tau), axis=0), axis=1)))
        wide = 0.0
        if np.any(plan.table[i, AXIS_1:]):
            turned = plan.rotation(tau)
            wide = float(np.sum((turned[:-1].inv() * turned[1:]).magnitude()))
        n = max(1, math.ceil(far / _MOST_PATH), math.ceil(wide / _MOST_ANGLE))
        path, angle = path + far, angle + wide
        if n > 1 or path >= _LEAST_PATH or angle >= _LEAST_ANGLE:
            kept += [float(x) for x in np.linspace(start, end, n + 1)[1:]]
            path = angle = 0.0
    if kept[-1] < edges[-1]:
        kept.append(float(edges[-1]))
    return np.array(kept)
