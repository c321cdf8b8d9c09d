"""What the diagnosis is told about robots: how small turns of the joints move the tool tip."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robomill.diagnosis.localisation.localise import Projection
from robomill.models.components.robot_drive import MODEL
from robomill.models.model.declaration import FloatArray, Record, record
from robomill.models.robot.kinematics import jacobian

TOOL_TIP = "compliance.p_BT_B"
KNOTS = 150
"""Samples that it is calculated at."""
ANGLES = tuple(f"drive.q_motor[{i}]" for i in range(1, 7))


def tool_tip_jacobian(columns: Mapping[str, FloatArray]) -> FloatArray:
    """Change of p_BT_B by the axis angles [m/rad], float64[n, 3, 6], in the nominal cell at the measured angles [rad].

    KeyError if one is not measured.
    """
    q = np.stack([columns[name] for name in ANGLES], axis=1)
    s: Record = record(MODEL.new())
    # it turns slowly: linear in between
    knots = np.unique(np.linspace(0, len(q) - 1, min(KNOTS, len(q))).astype(int))
    J = np.zeros((len(knots), 6, 6))
    for k, row in enumerate(knots):
        jacobian(s, q[row], J[k])
    every, flat = np.arange(len(q)), J[:, :3].reshape(len(knots), -1)
    return np.stack([np.interp(every, knots, column) for column in flat.T], axis=1).reshape(-1, 3, 6)


PROJECTIONS = {TOOL_TIP: Projection(tuple(f"joint {i}" for i in range(1, 7)), tool_tip_jacobian)}
