"""A sensor at the flange, for the identification of what it carries: where it points, and how the hose pack pulls there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robomill.models.calibration.identification import (
    PayloadFit,
    fit_orientation_polynomial,
    identify_payload,
    orientation_features,
    three_poses,
)
from robomill.models.components.sensor_chain import HosePack, Mounting
from robomill.models.maths.frames import matrix_to_quat, quat_to_matrix
from robomill.models.model.declaration import FloatArray
from robomill.models.model.parameters import load
from robomill.models.robot.kinematics import Robot, Tool, forward
from robomill.models.robot.numeric_inverse import kinematics

HOSE_TERMS = 10
"""Terms of Eq. (17) without linear ones that differ: 1 is the sum of the squares."""


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


def payload_with_hose(
    R_BS: FloatArray, force: FloatArray, moment: FloatArray, hose: HosePack, mounting: Mounting, three: bool = False
) -> tuple[PayloadFit, HosePack]:
    """The two steps of Haehn & Weigold 2020, section 2.6: the load, then Eq. (17), without linear terms, on the forces that it leaves.

    Then the load once more without the pull of the hose, whose moment is that of its point, `hose.p_FH_F`. Gravity is itself a quadratic
    form of the quaternion: a pull like that of a weight goes to the load, and only the sum of both is known. `three`: the load from O1,
    O2, O3 (`three_poses`). ValueError for less than ten orientations.
    """
    quat = np.zeros((len(R_BS), 4))
    for k, R in enumerate(R_BS):
        matrix_to_quat(R, quat[k])
    # rows of one orientation are one measurement: a polynomial of ten terms needs as many of them
    if len(np.unique(np.round(orientation_features(quat), 2), axis=0)) < HOSE_TERMS:
        raise ValueError(
            f"payload_with_hose: less than {HOSE_TERMS} orientations, too few for the terms of Eq. (17); the paper takes 27 all around"
        )
    identify, found, fit = three_poses if three else identify_payload, replace(hose, coefficients=np.zeros_like(hose.coefficients)), None
    for _ in range(2):
        pull, turn = hose_wrench(found, mounting, R_BS)
        fit = identify(R_BS, force - pull, moment - turn)
        rest = force - fit.load.wrench(R_BS)[0]
        found = replace(hose, coefficients=fit_orientation_polynomial(quat, rest, linear=False))
    assert fit is not None
    return fit, found


def hose_wrench(hose: HosePack, mounting: Mounting, R_BS: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Force [n, 3] N and moment [n, 3] N.m of Eq. (17) about S, in S, at the orientations `R_BS`: what sensor_chain subtracts for it."""
    quat, R_FS = np.zeros((len(R_BS), 4)), np.zeros((3, 3))
    for k, R in enumerate(R_BS):
        matrix_to_quat(R, quat[k])
    quat_to_matrix(mounting.quat_FS, R_FS)
    force = orientation_features(quat) @ hose.coefficients
    return force, np.cross(R_FS.T @ (hose.p_FH_F - mounting.p_FS_F), force)
