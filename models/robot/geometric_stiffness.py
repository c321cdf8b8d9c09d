"""Stiffness of a robot whose six drives are its only springs, with the geometric term of Chen & Kao 2000.

Wang, Zhang & Fuhlbrigge (paper 003), Eqs. (16)-(23): K_x = J^-T K_q J^-1 with K_q = diag(k_1..k_6) at the axis angles, and with
the conservative congruence transformation K_x = J^-T (K_q - K_g) J^-1, K_g = [dJ^T/dq_1 W .. dJ^T/dq_6 W], W = [f; m] the load on
the tool: a load turns with its lever arms. The robots of this variant, `joint_1dof`, are virtual-joint tables (`virtual_joints`)
whose rows are rigid but for the drives; J holds what the coupled axes turn (`kinematics.jacobian`).

A model that appends `GEOMETRIC_VARIABLES` to those of the virtual joints can call the kernels with its record.
"""

from __future__ import annotations

import numpy as np

from robomill.models.model.declaration import FloatArray, Record, Variable, kernel
from robomill.models.robot.virtual_joints import DRIVES

GEOMETRIC_VARIABLES = (
    Variable(
        "geometric_stiffness",
        "parameter",
        "Share of the geometric stiffness K_g of the loaded drives that the robot has: 0 ignores it (K_x = J^-T K_q J^-1), 1 is Chen & Kao",
        "1",
        (),
        minimum=0.0,
        maximum=1.0,
    ),
    Variable("drive_stiffness", "state", "Scratch: stiffness of the drives under their load", "N.m/rad", (6,)),
    Variable("drive_matrix", "state", "Scratch: geometric stiffness of the drives, then K_q - K_g", "N.m/rad", (6, 6)),
    Variable("drive_angle", "state", "Scratch: elastic angle of the drives", "rad", (6,)),
)


@kernel
def _turned(s: Record, m: int, n: int, f: FloatArray, moment: FloatArray) -> float:
    """Change [N.m/rad] of the moment about the axis of drive m = 0..5 that a turn of the joint of drive n makes under the load.

    f . (z_a x (z_b x r_b)) with a the one of both that is nearer to the base: turning it takes the other and its lever along,
    and, where n stands before m, moment . (z_n x z_m): the axis itself turns.
    """
    a = DRIVES[min(m, n)]
    b = DRIVES[max(m, n)]
    r0 = s.frame_p[13, 0] - s.frame_p[b, 0]
    r1 = s.frame_p[13, 1] - s.frame_p[b, 1]
    r2 = s.frame_p[13, 2] - s.frame_p[b, 2]
    z0, z1, z2 = s.frame_R[b, 0, 2], s.frame_R[b, 1, 2], s.frame_R[b, 2, 2]
    v0 = z1 * r2 - z2 * r1
    v1 = z2 * r0 - z0 * r2
    v2 = z0 * r1 - z1 * r0
    y0, y1, y2 = s.frame_R[a, 0, 2], s.frame_R[a, 1, 2], s.frame_R[a, 2, 2]
    change: float = f[0] * (y1 * v2 - y2 * v1) + f[1] * (y2 * v0 - y0 * v2) + f[2] * (y0 * v1 - y1 * v0)
    if n < m:
        change += moment[0] * (y1 * z2 - y2 * z1) + moment[1] * (y2 * z0 - y0 * z2) + moment[2] * (y0 * z1 - y1 * z0)
    return change


@kernel
def geometric_matrix(s: Record, f_T_B: FloatArray, m_T_B: FloatArray) -> None:
    """Fill s.drive_matrix with K_g (6, 6) [N.m/rad] for the force [N] and moment [N.m] on the tool; needs `virtual_joints`.

    Row and column i belong to the drive of axis i + 1, turned about z of its joint: sign_i A_i; what it turns in the joints
    behind it, that is coupled to it, is counted with it.
    """
    for m in range(6):
        for n in range(6):
            s.drive_matrix[m, n] = _turned(s, m, n, f_T_B, m_T_B)
    for i in range(5):
        for m in range(i + 1, 6):
            if s.axis_coupling[m, i] != 0.0:
                for k in range(6):
                    s.drive_matrix[k, i] += s.axis_coupling[m, i] * s.axis_sign[i] * s.drive_matrix[k, m]
    for i in range(5):
        for m in range(i + 1, 6):
            if s.axis_coupling[m, i] != 0.0:
                for k in range(6):
                    s.drive_matrix[i, k] += s.axis_coupling[m, i] * s.axis_sign[i] * s.drive_matrix[m, k]


@kernel
def follow_levers(s: Record, f_T_B: FloatArray, m_T_B: FloatArray) -> int:
    """Turn s.drive_angle [rad] from the angles at rigid levers into those of the levers that the load has turned.

    (K_q - g K_g) u = K_q u_rigid, K_q = diag(s.drive_stiffness), g = s.geometric_stiffness. Elimination without exchange of rows:
    its pivots are positive as long as the matrix is positive definite (Sylvester).

    Returns 0, or i = 1..6 where the stiffness of the first i axes is not positive definite: under this load the robot would fold.
    """
    geometric_matrix(s, f_T_B, m_T_B)
    for i in range(6):
        for j in range(6):
            s.drive_matrix[i, j] *= -s.geometric_stiffness
        s.drive_matrix[i, i] += s.drive_stiffness[i]
        s.drive_angle[i] *= s.drive_stiffness[i]
    for i in range(6):
        if not s.drive_matrix[i, i] > 0.0:
            return i + 1
        for k in range(i + 1, 6):
            part = s.drive_matrix[k, i] / s.drive_matrix[i, i]
            for j in range(i, 6):
                s.drive_matrix[k, j] -= part * s.drive_matrix[i, j]
            s.drive_angle[k] -= part * s.drive_angle[i]
    for k in range(6):
        i = 5 - k
        for j in range(i + 1, 6):
            s.drive_angle[i] -= s.drive_matrix[i, j] * s.drive_angle[j]
        s.drive_angle[i] /= s.drive_matrix[i, i]
    return 0


def cartesian_stiffness(J: FloatArray, K_q: FloatArray, K_g: FloatArray | None = None) -> FloatArray:
    """K_x = J^-T (K_q - K_g) J^-1 (6, 6): N/m, N/rad, N.m/m, N.m/rad; paper 003, Eqs. (16) and (21).

    Parameters: `J` (6, 6) Jacobian of the axis angles, m and rad per rad; `K_q` (6,) stiffness of the axes, N.m/rad; `K_g` (6, 6)
    geometric term at the axis angles, N.m/rad; None ignores it.
    Errors: ValueError for a singular pose, and for a stiffness that is not positive definite.
    """
    J, K = np.asarray(J, dtype=np.float64), np.diag(np.asarray(K_q, dtype=np.float64))
    if K_g is not None:
        K = K - np.asarray(K_g, dtype=np.float64)
    lowest = float(np.linalg.eigvalsh(0.5 * (K + K.T))[0])
    if not lowest > 0.0:
        raise ValueError(
            f"cartesian_stiffness: the smallest eigenvalue of the joint stiffness matrix is {lowest:.4g} N.m/rad, expected a positive "
            "one: an axis has a stiffness that is not positive, or the load is so large that the robot folds; check K_q and the load"
        )
    if np.linalg.matrix_rank(J) < len(J):
        raise ValueError(
            "cartesian_stiffness: the pose is singular, so its stiffness is infinite in a direction; use the compliance J K_q^-1 J^T"
        )
    inverse = np.linalg.inv(J)
    return np.asarray(inverse.T @ K @ inverse)
