"""What diagnosis and report are told about the robot of a system: its geometry, and how small turns of the joints move the tool tip."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from robomill.cell.binding import convert, resolve
from robomill.diagnosis.localisation.localise import Projection
from robomill.models.model.declaration import FloatArray, Record
from robomill.models.robot.kinematics import KR300, ROBOT_VARIABLES, SPINDLE_ACROSS, jacobian
from robomill.models.robot.numeric_inverse import kinematics
from robomill.orchestration.system.definition import Component, System
from robomill.orchestration.system.parameters import prepare

TOOL_TIP = "compliance.p_BT_B"
KNOTS = 150
"""Samples that it is calculated at."""
ANGLES = tuple(f"drive.q_motor[{i}]" for i in range(1, 7))
ROBOTS = ("robot_compliance", "robot_drive", "inverse_dynamics")
"""Components that stand for the arm of models/robot/kinematics.py, in process or as an FMU of that name."""
_GEOMETRY = {v.name for v in ROBOT_VARIABLES if v.causality == "parameter"}


def arm(system: System) -> Component | None:
    """The component that is a six-axis robot, if there is one."""
    by_source = {Path(c.source).stem: c for c in reversed(system.components)}
    return next((by_source[name] for name in ROBOTS if name in by_source), None)


def geometry(component: Component) -> Record:
    """The record that the kernels of models/robot/kinematics.py work on, with the geometry that the system gives this component."""
    s = kinematics(KR300, SPINDLE_ACROSS)
    ports = resolve(Path(component.source).stem, component.name).ports
    given = {k: v for k, v in component.parameters.items() if k.partition("[")[0] in _GEOMETRY}
    for element, value in prepare(component.name, ports, given, convert).items():
        name, _, index = element.removesuffix("]").partition("[")
        getattr(s, name)[tuple(int(i) - 1 for i in index.split(","))] = value
    return s


def tool_tip_jacobian(component: Component, columns: Mapping[str, FloatArray]) -> FloatArray:
    """Change of p_BT_B by the axis angles [m/rad], float64[n, 3, 6], of the robot `component` at the measured angles [rad].

    KeyError if one is not measured.
    """
    q = np.stack([columns[name] for name in ANGLES], axis=1)
    s = geometry(component)
    # it turns slowly: linear in between
    knots = np.unique(np.linspace(0, len(q) - 1, min(KNOTS, len(q))).astype(int))
    J = np.zeros((len(knots), 6, 6))
    for k, row in enumerate(knots):
        jacobian(s, q[row], J[k])
    every, flat = np.arange(len(q)), J[:, :3].reshape(len(knots), -1)
    return np.stack([np.interp(every, knots, column) for column in flat.T], axis=1).reshape(-1, 3, 6)


def projections(system: System) -> dict[str, Projection]:
    """The tool tip on the joints of the robot of a system; nothing where there is none."""
    component = arm(system)
    if component is None:
        return {}
    return {TOOL_TIP: Projection(tuple(f"joint {i}" for i in range(1, 7)), partial(tool_tip_jacobian, component))}
