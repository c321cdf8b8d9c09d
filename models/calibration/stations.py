"""Stiffness of the whole robot at stations of its work space, measured and from springs, with and without tilt axes.

Englert 2011 (paper 004), section 3.3 and Figs. 3.5, 3.6: force and displacement at the tool tip in the same direction, x, y, z of B in
turn, at nine points. Springs say C = sum_i g_i g_i^T / k_i (`stiffness.displacements`), so k_x = 1/C_xx and so on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robomill.models.calibration.stiffness import JOINT_NAMES, RIGID, Loads, Spring, displacements, screws
from robomill.models.model.declaration import FloatArray
from robomill.models.robot.kinematics import Robot, Tool
from robomill.models.robot.virtual_joints import DRIVES, JOINTS, SENSOR, Compliance

SAME = 1e-3
"""Axis angles [rad] within which rows are of the same station: the robot stands still."""
PURE = 0.05
"""Part of a force across its direction up to which it has that direction."""
LARGE = 0.2
"""Part of the largest force from which on a row counts: those of a ramp belong to its line, those about zero are noise."""
RIGID_FROM = 0.1 * RIGID
"""Stiffness from which on a spring of a file is rigid."""


@dataclass(frozen=True)
class Stations:
    """Stiffness at stations in x, y, z of B, N/m; NaN where no force had that direction."""

    q: FloatArray
    """[n, 6] axis angles, rad."""
    measured: FloatArray
    """[n, 3]."""
    with_tilt: FloatArray
    """[n, 3] with all springs of the file."""
    drives_only: FloatArray
    """[n, 3] with those of the drives alone."""

    @property
    def share(self) -> FloatArray:
        """[n, 3] stiffness with tilt over that of the drives alone: what the tilt axes leave of it."""
        return self.with_tilt / self.drives_only

    @property
    def error(self) -> FloatArray:
        """[n, 3] stiffness of the springs over the measured one, minus 1."""
        return self.with_tilt / self.measured - 1.0


def table_springs(compliance: Compliance) -> tuple[tuple[Spring, ...], FloatArray]:
    """Springs of a compliance file that are not rigid, and their compliances [springs] rad/(N.m)."""
    found, softness = [], []
    for row in range(JOINTS):
        for column in range(3):
            k = float(compliance.stiffness[row, column]) * (compliance.sensor_stiffness_scale if row == SENSOR else 1.0)
            if k < RIGID_FROM:
                found.append(Spring(f"{JOINT_NAMES[row]} {'xyz'[column]}", row, column))
                softness.append(1.0 / k)
    return tuple(found), np.array(softness)


def tip_stiffness(robot: Robot, tool: Tool, compliance: Compliance, q: FloatArray, drives_only: bool = False) -> FloatArray:
    """Stiffness [n, 3] N/m at the tool tip in x, y, z of B at the axis angles `q` [n, 6] rad, displacement read along the force."""
    springs, softness = table_springs(compliance)
    if drives_only:
        chosen = [i for i, s in enumerate(springs) if s.column == 2 and s.row in DRIVES]
        springs, softness = tuple(springs[i] for i in chosen), softness[chosen]
    screw = screws(robot, tool, q, springs)
    found = np.zeros((len(q), 3))
    for axis in range(3):
        force = np.zeros((len(q), 3))
        force[:, axis] = 1.0
        found[:, axis] = 1.0 / (displacements(screw, force, np.zeros_like(force)) @ softness)[:, axis]
    return found


def stations(robot: Robot, tool: Tool, compliance: Compliance, loads: Loads) -> Stations:
    """Measured and calculated stiffness at each place where the robot stood.

    A line through zero of the displacement over the force, of the rows with a force along x, y or z. Errors: ValueError where there is
    no force, and for a displacement against its force, with station and direction.
    """
    size = np.linalg.norm(loads.f_T_B, axis=1)
    if not size.max() > 0.0:
        raise ValueError(
            "stations: all forces are zero, expected pushes along x, y and z of B at each station; check the column and its unit"
        )
    where = np.zeros(len(loads), dtype=int)
    places: list[FloatArray] = []
    for i, q in enumerate(loads.q):
        near = [n for n, p in enumerate(places) if np.abs(q - p).max() < SAME]
        if not near:
            places.append(q)
        where[i] = near[0] if near else len(places) - 1
    measured = np.full((len(places), 3), np.nan)
    for n in range(len(places)):
        for axis in range(3):
            f, d = loads.f_T_B[:, axis], loads.d_T_B[:, axis]
            across = np.linalg.norm(np.delete(loads.f_T_B, axis, axis=1), axis=1)
            rows = (where == n) & (np.abs(f) > LARGE * size.max()) & (across < PURE * np.abs(f))
            if not rows.any():
                continue
            compliance_here = float(f[rows] @ d[rows]) / float(f[rows] @ f[rows])
            if compliance_here <= 0.0:
                raise ValueError(
                    f"stations: at station {n + 1} the tool moves {-1e6 * compliance_here:.3g} um/N against the force along {'xyz'[axis]}; "
                    "expected along it: check signs and frames of force and displacement"
                )
            measured[n, axis] = 1.0 / compliance_here
    kept = np.isfinite(measured).any(axis=1)
    if not kept.any():
        raise ValueError(f"stations: no force of {len(loads)} rows is along x, y or z of B to {100 * PURE:.0f} %; push along the base axes")
    q = np.array(places)[kept]
    return Stations(
        q, measured[kept], tip_stiffness(robot, tool, compliance, q), tip_stiffness(robot, tool, compliance, q, drives_only=True)
    )
