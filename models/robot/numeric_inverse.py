"""Inverse kinematics of any six-axis robot by iteration, for logs and calibration; no kernel of a component calls it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from robomill.models.model.declaration import FloatArray, Model, Record, record
from robomill.models.robot.kinematics import Robot, Tool, jacobian, robot_variables, tool_pose

_REACHED = 1e-9
"""Residual (m, rad) from which a pose is reached: a thousandth of what the best robot repeats to."""


def kinematics(robot: Robot, tool: Tool) -> Record:
    """A record that the kernels of `models.robot.kinematics` take, of this robot with this tool."""

    def unused(*_: object) -> int:
        return 0

    return record(Model("kinematics", robot.name, robot_variables(robot, tool), unused, unused).new())


def solve(robot: Robot, tool: Tool, p_BT_B: npt.ArrayLike, R_BT: npt.ArrayLike, q_near: npt.ArrayLike) -> FloatArray:
    """Axis angles [6] rad within the limits that put the tool tip at p_BT_B [3] m, R_BT [3,3]; of all, one near `q_near` [6] rad.

    Least squares on position and rotation vector with the geometric Jacobian (trust region, bounds = axis limits).
    ValueError says how near it came if the pose is out of reach, or behind a singularity from `q_near`.
    """
    s = kinematics(robot, tool)
    goal_p, goal_R = np.asarray(p_BT_B, dtype=np.float64), np.asarray(R_BT, dtype=np.float64)
    p, R, J = np.zeros(3), np.zeros((3, 3)), np.zeros((6, 6))

    def residual(q: FloatArray) -> FloatArray:
        tool_pose(s, q, p, R)
        turn: FloatArray = Rotation.from_matrix(R @ goal_R.T).as_rotvec()
        return np.concatenate([p - goal_p, turn])

    def slope(q: FloatArray) -> FloatArray:
        jacobian(s, q, J)
        return J.copy()

    start = np.clip(np.asarray(q_near, dtype=np.float64), robot.q_min, robot.q_max)
    found = least_squares(residual, start, slope, bounds=(robot.q_min, robot.q_max), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    rest = np.abs(found.fun)
    if rest.max() > _REACHED:
        raise ValueError(
            f"robot {robot.name!r}: no axis angles near {np.round(np.rad2deg(start), 1).tolist()} deg put the tool tip at "
            f"{np.round(goal_p, 4).tolist()} m; it comes to {1e3 * np.linalg.norm(found.fun[:3]):.3g} mm and "
            f"{np.rad2deg(np.linalg.norm(found.fun[3:])):.3g} deg of it; start from other angles, or move the pose into reach"
        )
    angles: FloatArray = found.x
    return angles
