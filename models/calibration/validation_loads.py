"""The 60 validation loads of Haehn & Weigold 2020, sec. 3.1 and Fig. 9, as data and as calculated by the compliance model.

750 N at the tool tip along +x, +y, -z of the base at 4 positions with 5 orientations each. The paper gives
the positions, the load and how the mean and the largest difference to the laser tracker came out; its
single values stand only in a figure that is not available.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robomill.models.maths.frames import matrix_to_quat, rotation_abc
from robomill.models.model.declaration import FloatArray, Model, Record, record
from robomill.models.robot.kinematics import ROBOT_VARIABLES, inverse
from robomill.models.robot.virtual_joints import COMPLIANCE_VARIABLES, displacement

POSITIONS = np.array([[2.084, -0.097, 1.524], [1.091, 0.454, 1.884], [1.337, -0.538, 1.098], [1.595, -0.018, 1.099]])
"""Positions 1..4 of T in B [m], caption of Fig. 9."""
ORIENTATIONS = (("0", 0.0, 0.0), ("B+30", 30.0, 0.0), ("B-30", -30.0, 0.0), ("C+30", 0.0, 30.0), ("C-30", 0.0, -30.0))
"""Label, rotation B about the tool's y axis and C about its x axis [deg] of the five orientations of a position."""
DIRECTIONS = (("+x", (1.0, 0.0, 0.0)), ("+y", (0.0, 1.0, 0.0)), ("-z", (0.0, 0.0, -1.0)))
"""Load directions in B in the order of the paper: measurements 1-20, 21-40, 41-60."""
LOAD = 750.0
"""Test load [N]."""

MEAN_DIFFERENCE = 0.11e-3
"""Mean of measured minus calculated displacement [m], sec. 3.1."""
RELATIVE_MEAN_DIFFERENCE = 0.06
"""Mean of measured minus calculated displacement over the measured mean, sec. 3.1 ("6% or 0.11 mm lower")."""
MEAN_MEASURED = MEAN_DIFFERENCE / RELATIVE_MEAN_DIFFERENCE
"""Mean measured displacement [m] that these imply: 1.83 mm (1.69 .. 2.09 mm for 5.5 % .. 6.5 %)."""
MEAN_CALCULATED = MEAN_MEASURED - MEAN_DIFFERENCE
"""Mean calculated displacement [m] that these imply: 1.72 mm. The default tool is calibrated to it."""

HOME = np.deg2rad([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
"""Axis angles [rad] that the inverse kinematics stays near, apart from A1: shoulder in front, elbow up."""


@dataclass(frozen=True)
class ValidationLoads:
    """The 60 loads in the order of the paper: direction, then position, then orientation."""

    label: tuple[str, ...]
    """For example "position 1, B+30, load +x"."""
    p_BT_B: FloatArray
    """[60, 3] position of T [m]."""
    quat_BT: FloatArray
    """[60, 4] orientation of T, scalar first."""
    q: FloatArray
    """[60, 6] axis angles A1..A6 [rad]."""
    f_T_B: FloatArray
    """[60, 3] force on the tool [N]."""
    d_T_B: FloatArray
    """[60, 3] calculated displacement [m]."""
    theta_T_B: FloatArray
    """[60, 3] calculated rotation vector [rad]."""

    @property
    def magnitude(self) -> FloatArray:
        """[60] calculated displacement |d| [m], the quantity of Fig. 9."""
        lengths: FloatArray = np.linalg.norm(self.d_T_B, axis=1)
        return lengths


def orientation_zero(position: FloatArray) -> FloatArray:
    """R_BT (3, 3) of orientation 0: tool x down, tool z level and away from the robot column (assumption; not given in the paper)."""
    heading = np.arctan2(position[1], position[0])
    outward = np.array([np.cos(heading), np.sin(heading), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    return np.column_stack([down, np.cross(outward, down), outward])


def model_record(**parameters: float | FloatArray) -> Record:
    """A record with the variables of robot and compliance at their starts, except for the named `parameters` (SI)."""
    data = Model("validation_loads", "Robot and compliance", ROBOT_VARIABLES + COMPLIANCE_VARIABLES, _idle, _idle_step).new()
    for name, value in parameters.items():
        data[name] = value
    return record(data)


def validation_loads(load: float = LOAD, **parameters: float | FloatArray) -> ValidationLoads:
    """Calculate the 60 displacements under `load` [N]; `parameters` replace starts, e.g. ``sensor_stiffness_scale=0.1``.

    ValueError names a pose that the robot cannot take (another tool or robot).
    """
    s = model_record(**parameters)
    poses: list[tuple[str, FloatArray, FloatArray, FloatArray]] = []
    for number, position in enumerate(POSITIONS, start=1):
        for label, b, c in ORIENTATIONS:
            turn, quat, q = np.zeros((3, 3)), np.zeros(4), np.zeros(6)
            rotation_abc(0.0, float(np.deg2rad(b)), float(np.deg2rad(c)), turn)
            R_BT = orientation_zero(position) @ turn
            near = HOME.copy()
            near[0] = -np.arctan2(position[1], position[0])
            status = inverse(s, position, R_BT, near, q)
            if status:
                reason = "is out of reach" if status == 1 else "needs axis angles beyond the limits"
                raise ValueError(f"validation load at position {number}, {label}: the pose {reason}; check p_FT_F, quat_FT and the robot")
            matrix_to_quat(R_BT, quat)
            poses.append((f"position {number}, {label}", position, quat, q))
    rows = [(f"{label}, load {name}", p, quat, q, load * np.array(e)) for name, e in DIRECTIONS for label, p, quat, q in poses]
    d, theta = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
    for k, (_, _, _, q, f) in enumerate(rows):
        displacement(s, q, f, np.zeros(3), d[k], theta[k])
    labels, p_BT_B, quat_BT, angles, f_T_B = zip(*rows, strict=True)
    return ValidationLoads(labels, np.array(p_BT_B), np.array(quat_BT), np.array(angles), np.array(f_T_B), d, theta)


def _idle(s: Record) -> int:
    return 0


def _idle_step(s: Record, t: float, h: float) -> int:
    return 0
