"""A sensor at the flange, for the identification of what it carries: where it points, and how the hose pack pulls there."""

from __future__ import annotations

import numpy as np

from robomill.models.calibration.identification import orientation_features
from robomill.models.components.sensor_chain import HosePack, Mounting
from robomill.models.maths.frames import matrix_to_quat, quat_to_matrix
from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import load
from robomill.models.robot.kinematics import Robot, Tool, forward
from robomill.models.robot.numeric_inverse import kinematics


def load_hose(name: str) -> HosePack:
    """The hose pack of a file in models/data/sensors by its name (`hose_gallows`), or of any TOML file. Errors as of `load`."""
    return load(HosePack, name if name.endswith(".toml") else f"sensors/{name}")


def sensor_orientations(robot: Robot, tool: Tool, q: FloatArray, mounting: Mounting) -> FloatArray:
    """Orientations R_BS [n, 3, 3] of the mounted sensor at axis angles `q` [n, 6] rad."""
    s, R_FS, R_BS = kinematics(robot, tool), np.zeros((3, 3)), np.zeros((len(q), 3, 3))
    quat_to_matrix(mounting.quat_FS, R_FS)
    for k, angles in enumerate(q):
        forward(s, angles)
        R_BS[k] = s.link_R[5] @ R_FS
    return R_BS


def hose_wrench(hose: HosePack, mounting: Mounting, R_BS: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Force [n, 3] N and moment [n, 3] N.m of Eq. (17) about S, in S, at the orientations `R_BS`: what sensor_chain subtracts for it."""
    quat, R_FS = np.zeros((len(R_BS), 4)), np.zeros((3, 3))
    for k, R in enumerate(R_BS):
        matrix_to_quat(R, quat[k])
    quat_to_matrix(mounting.quat_FS, R_FS)
    force = orientation_features(quat) @ hose.coefficients
    return force, np.cross(R_FS.T @ (hose.p_FH_F - mounting.p_FS_F), force)
