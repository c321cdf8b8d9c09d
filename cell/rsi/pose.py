"""Pose of the tool as a robot controller knows it: forward kinematics of axis angles, nothing bends."""

from __future__ import annotations

import math

import numpy as np

from robomill.fmus.in_process import InProcessSlave
from robomill.models.maths.frames import matrix_to_abc
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS, Robot, Tool, robot_variables, tool_pose


@kernel
def _look(s: Record) -> None:
    tool_pose(s, s.q, s.pose[:3], s.R)
    matrix_to_abc(s.R, s.pose[3:])
    for i in range(3):
        s.pose[i] *= 1e3
        s.pose[3 + i] *= 180.0 / math.pi


def init(s: Record) -> int:
    """Pose at the start."""
    _look(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Pose at the axis angles of now."""
    _look(s)
    return 0


MODEL = Model(
    "tool_pose",
    "Forward kinematics: axis angles to X, Y, Z in mm and A, B, C in deg",
    (
        Variable("q", "input", "Axis angles A1..A6", "rad", (6,)),
        Variable("pose", "output", "X, Y, Z in mm, A, B, C in deg of the tool tip in the base", "1", (6,)),
        Variable("R", "state", "Scratch: orientation of the tool tip in the base", "1", (3, 3)),
        *robot_variables(KR300, SPINDLE_ACROSS),
    ),
    init,
    step,
    ("",),
)


class Pose:
    """The pose of a robot with its tool."""

    def __init__(self, robot: Robot, tool: Tool) -> None:
        self._slave = InProcessSlave(MODEL)
        parameters = {v.name: np.asarray(v.start) for v in robot_variables(robot, tool) if v.causality == "parameter"}
        self._slave.configure(parameters)
        self._slave.initialise(0.0, math.inf, 1.0)
        self._pose = np.zeros(6)

    def of(self, q: FloatArray) -> FloatArray:
        """X, Y, Z [mm], A, B, C [deg] at the axis angles q [rad]; the array is used again."""
        self._slave.set_inputs(q)
        self._slave.step(0.0, 1.0)
        self._slave.get_outputs(self._pose)
        return self._pose
