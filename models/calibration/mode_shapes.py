"""Mode shapes of an elastic robot as motions of points on its arm, to be drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robomill.models.model.declaration import FloatArray
from robomill.models.robot.elastic_modes import JOINT_NAMES, ElasticMachine, TipModes, elastic_robot
from robomill.models.robot.virtual_joints import joint_frame, virtual_joints

PLACES = ("base", "column", "shoulder", "elbow", "wrist", "flange", "tool tip")
"""Points along the arm, from the base to the tool."""
_CARRIED = (0, 0, 1, 3, 5, 8, 11)
"""Virtual joints before each of these points: all rows below this number turn it."""


@dataclass(frozen=True)
class ModeShapes:
    """Points on the arm and how they move in each mode."""

    points: FloatArray
    """[places, 3] in B, m."""
    motion: FloatArray
    """[modes, places, 3] in B, per modal coordinate: m/sqrt(kg)."""
    turn: FloatArray
    """[modes, places, 3] turn of the arm there in B, per modal coordinate: rad/sqrt(kg)/m."""


def mode_shapes(machine: ElasticMachine, q: FloatArray, modes: TipModes) -> ModeShapes:
    """Motion of `PLACES` in the modes of the machine at the axis angles `q` [6] rad: e x (p - o) summed over the elastic coordinates.

    `modes` are those of `elastic_modes` for the same machine and pose.
    """
    s = elastic_robot(machine)
    virtual_joints(s, np.asarray(q, dtype=np.float64))
    points = np.stack([np.zeros(3), s.frame_p[0], s.frame_p[1], s.frame_p[3], s.frame_p[5], s.link_p[5], s.frame_p[13]])
    motion, turn = (np.zeros((len(modes.frequency), len(points), 3)) for _ in range(2))
    for i, name in enumerate(modes.coordinates):
        row = max((r for r, joint in enumerate(JOINT_NAMES) if name.startswith(joint + " ")), key=lambda r: len(JOINT_NAMES[r]))
        column = 2 if name.endswith("drive") else "xyz".index(name[-1])
        frame = joint_frame(row)
        axis, origin = np.array(s.frame_R[frame, :, column]), np.array(s.frame_p[frame])
        for n, carried in enumerate(_CARRIED):
            if row < carried:
                turn[:, n] += modes.coordinate_shape[i][:, None] * axis
                motion[:, n] += modes.coordinate_shape[i][:, None] * np.cross(axis, points[n] - origin)
    return ModeShapes(points, motion, turn)


def share(modes: TipModes, begins: str) -> FloatArray:
    """[modes] part of the spring energy that is in coordinates whose names begin so, such as "A1 tilt"."""
    chosen = [i for i, name in enumerate(modes.coordinates) if name.startswith(begins)]
    return np.asarray(modes.energy_share[chosen].sum(axis=0))
