"""Virtual-joint compliance model of a milling robot: Haehn & Weigold 2020, sec. 2.1, Eqs. (1)-(9).

The 14 frames of their Fig. 1, counted from the robot base, and what turns elastically in them::

    1 axis 1        4 axis 3        7 axis 5      10 spindle and holder    13 tool
    2 axis 2        5 arm           8 axis 6      11 tool reference        14 tool tip T
    3 linked arm    6 axis 4        9 sensor      12 tool orientation (Euler rotation of 11)

Eleven of them (all but 11, 12, 14) carry a virtual joint: a rotation spring about x, y and z with the
stiffness k_C, k_B, k_A of Table 1. A load at T turns every one of them, and the chain with the extra
rotations gives the displaced tool tip. The load acts ON the tool.

With `translation_compliance` each of them yields along x, y and z as well: the six degrees of freedom per joint of paper 001,
Eqs. (3)-(7), variant `joint_6dof`. Joints stand in series, so compliances add up, C = sum J_i K_i^-1 J_i^T; Eqs. (4) and (5) of
that paper are printed as a sum of stiffnesses. Without translations the bits are those of the paper above.

A model that appends `ROBOT_VARIABLES` and `COMPLIANCE_VARIABLES` can call the kernels with its record:
`displacement` does everything; `virtual_joints`, `joint_moments`, `joint_angles`, `couple_drives`, `deflect` are its
five steps, for models that change one of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from robomill.models.maths.elementary import sincos
from robomill.models.maths.frames import quat_to_rotation_vector
from robomill.models.model.declaration import FloatArray, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity
from robomill.models.robot.kinematics import SPINDLE_ACROSS, Tool, forward

JOINTS = 11
SENSOR = 8
"""Row of the force-torque sensor among the virtual joints."""
DRIVES = (0, 1, 3, 5, 6, 7)
"""Rows of axes 1..6 among the virtual joints."""


@dataclass(frozen=True)
class Compliance:
    """Stiffness of the virtual joints and where they sit, from a file in models/data/compliance."""

    stiffness: FloatArray = field(metadata=quantity("N.m/rad", 1.0))
    """Springs about x, y, z of each virtual joint, one row per joint."""
    sensor_stiffness_scale: float = field(metadata=quantity("1", 1e-3))
    """Factor on the row of the sensor."""
    link_arm_position: float = field(metadata=quantity("1", 0.0, 1.0))
    """Where the virtual joint of the linked arm sits, as a share of its length."""
    arm_position: float = field(metadata=quantity("1", 0.0, 1.0))
    """Where the virtual joint of the arm sits, as a share of its length."""
    sensor_position: float = field(metadata=quantity("m"))
    """Where the sensor sits, in front of the flange."""
    holder_position: float = field(metadata=quantity("m"))
    """Where the spindle holder sits, in front of the flange."""
    damping_time: float | FloatArray = field(metadata=quantity("s", 0.0, 1.0))
    """Damping of the virtual joints over their stiffness, D = damping_time K: one value, or a table like that of the stiffness."""
    translation_compliance: FloatArray = field(default_factory=lambda: np.zeros((JOINTS, 3)), metadata=quantity("m/N", 0.0))
    """Springs along x, y, z of the frames (variant `joint_6dof`); without them the joints only turn."""

    def __post_init__(self) -> None:
        """Refuse a table that does not have a row per virtual joint."""
        for name, sense in (("stiffness", "about"), ("translation_compliance", "along")):
            if np.shape(getattr(self, name)) != (JOINTS, 3):
                raise ValueError(
                    f"compliance: {name} has shape {np.shape(getattr(self, name))}, expected ({JOINTS}, 3): frames 1..10 and 13, "
                    f"{sense} x, y, z"
                )
        if np.shape(self.damping_time) not in ((), (JOINTS, 3)):
            raise ValueError(
                f"compliance: damping_time has shape {np.shape(self.damping_time)}, expected one value or ({JOINTS}, 3) like stiffness"
            )


def load_compliance(name: str) -> Compliance:
    """The virtual joints of a robot by its name, from models/data/compliance. FileNotFoundError lists what there is."""
    return load(Compliance, f"compliance/{name}")


TABLE_1 = load_compliance("kr300_r2500_ultra")
"""Table 1 of Haehn & Weigold 2020."""


def compliance_variables(compliance: Compliance, tool: Tool) -> tuple[Variable, ...]:
    """Parameters and scratch states that the kernels of this module need beyond `ROBOT_VARIABLES`."""
    c = compliance
    return (
        Variable(
            "stiffness",
            "parameter",
            "Rotational stiffness of the virtual joints in frames 1..10 and 13 (rows) about x, y, z (columns k_C, k_B, k_A)",
            "N.m/rad",
            (JOINTS, 3),
            c.stiffness,
            minimum=1.0,
        ),
        Variable(
            "translation_compliance",
            "parameter",
            "Compliance of the virtual joints in frames 1..10 and 13 (rows) along x, y, z of the frame; 0 = rigid",
            "m/N",
            (JOINTS, 3),
            c.translation_compliance,
            minimum=0.0,
            display_unit="um/N",
        ),
        Variable(
            "sensor_stiffness_scale",
            "parameter",
            "Factor on the sensor row (frame 9): 1 = as printed in Table 1, 0.1 = as in the sensor's data sheet",
            "1",
            (),
            c.sensor_stiffness_scale,
            minimum=1e-3,
        ),
        Variable("link_arm_position", "parameter", "Frame 3 between axis 2 (0) and axis 3 (1)", "1", (), c.link_arm_position, 0.0, 1.0),
        Variable("arm_position", "parameter", "Frame 5 between axis 3 (0) and the wrist centre (1)", "1", (), c.arm_position, 0.0, 1.0),
        Variable("sensor_position", "parameter", "Frame 9 in front of the flange", "m", (), c.sensor_position, display_unit="mm"),
        Variable("holder_position", "parameter", "Frame 10 in front of the flange", "m", (), c.holder_position, display_unit="mm"),
        Variable("tool_length", "parameter", "Frame 13 behind the tool tip, along the tool axis", "m", (), tool.length, display_unit="mm"),
        Variable("frame_R", "state", "Scratch: orientation in B of frames 1..14", "1", (14, 3, 3)),
        Variable("frame_p", "state", "Scratch: origin in B of frames 1..14", "m", (14, 3)),
        Variable("joint_moment", "state", "Moment on the virtual joints about x, y, z of their frames", "N.m", (JOINTS, 3)),
        Variable("joint_angle", "state", "Elastic angle of the virtual joints about x, y, z of their frames", "rad", (JOINTS, 3)),
        Variable("joint_shift", "state", "Elastic shift of the virtual joints, in B", "m", (JOINTS, 3)),
        Variable("deflection_quat", "state", "Elastic rotation of T in B, unit quaternion (w, x, y, z)", "1", (4,)),
    )


COMPLIANCE_VARIABLES = compliance_variables(TABLE_1, SPINDLE_ACROSS)


@kernel
def joint_frame(j: int) -> int:
    """Index in s.frame_R of virtual joint j = 0..10: frames 1..10 and 13."""
    return j if j < 10 else 12


@kernel
def virtual_joints(s: Record, q: FloatArray) -> None:
    """Fill s.frame_R, s.frame_p [m] with the 14 rigid frames at the axis angles q [rad]; runs `forward`.

    Eq. (1) in closed form: frames 1, 2, 4, 7 are DH frames 1, 2, 3, 5. Frames 6 and 8 are DH frames 4 and 6
    with their origin in the wrist centre (8 loses d6). Frame 3 lies on the line from 2 to 4, frame 5 on the
    line from 4 to 6, before the rotation of axis 4, with z along the arm. 9 and 10 stand on the flange axis.
    """
    forward(s, q)
    for r in range(3):
        for c in range(3):
            s.frame_R[0, r, c] = s.link_R[0, r, c]
            s.frame_R[1, r, c] = s.link_R[1, r, c]
            s.frame_R[2, r, c] = s.link_R[1, r, c]
            s.frame_R[3, r, c] = s.link_R[2, r, c]
            s.frame_R[5, r, c] = s.link_R[3, r, c]
            s.frame_R[6, r, c] = s.link_R[4, r, c]
            for i in range(7, 11):
                s.frame_R[i, r, c] = s.link_R[5, r, c]
            for i in range(11, 14):
                s.frame_R[i, r, c] = s.link_R[6, r, c]
        # R_3 Rx(-90 deg)
        s.frame_R[4, r, 0] = s.link_R[2, r, 0]
        s.frame_R[4, r, 1] = -s.link_R[2, r, 2]
        s.frame_R[4, r, 2] = s.link_R[2, r, 1]
        shoulder = s.link_p[1, r]
        elbow = s.link_p[2, r]
        wrist = s.link_p[3, r]
        flange = s.link_p[5, r]
        tip = s.link_p[6, r]
        s.frame_p[0, r] = s.link_p[0, r]
        s.frame_p[1, r] = shoulder
        s.frame_p[2, r] = shoulder + s.link_arm_position * (elbow - shoulder)
        s.frame_p[3, r] = elbow
        s.frame_p[4, r] = elbow + s.arm_position * (wrist - elbow)
        s.frame_p[5, r] = wrist
        s.frame_p[6, r] = wrist
        s.frame_p[7, r] = wrist
        s.frame_p[8, r] = flange + s.sensor_position * s.link_R[5, r, 2]
        s.frame_p[9, r] = flange + s.holder_position * s.link_R[5, r, 2]
        for i in range(10, 13):
            s.frame_p[i, r] = tip - s.tool_length * s.link_R[6, r, 0]
        s.frame_p[13, r] = tip


@kernel
def joint_moments(s: Record, f_T_B: FloatArray, m_T_B: FloatArray) -> None:
    """Fill s.joint_moment [N.m] from the load on the tool: force f_T_B [N], moment m_T_B [N.m] at T; Eqs. (5), (6).

    Fills s.joint_shift [m] as well, what the joints yield along their axes. Needs `virtual_joints`. The lever arms are those of
    the rigid robot (Eq. (2)).
    """
    for j in range(JOINTS):
        i = joint_frame(j)
        for r in range(3):
            s.joint_shift[j, r] = 0.0
        for c in range(3):
            if s.translation_compliance[j, c] != 0.0:
                along = s.frame_R[i, 0, c] * f_T_B[0] + s.frame_R[i, 1, c] * f_T_B[1] + s.frame_R[i, 2, c] * f_T_B[2]
                for r in range(3):
                    s.joint_shift[j, r] += s.frame_R[i, r, c] * s.translation_compliance[j, c] * along
        r0 = s.frame_p[13, 0] - s.frame_p[i, 0]
        r1 = s.frame_p[13, 1] - s.frame_p[i, 1]
        r2 = s.frame_p[13, 2] - s.frame_p[i, 2]
        m0 = r1 * f_T_B[2] - r2 * f_T_B[1] + m_T_B[0]
        m1 = r2 * f_T_B[0] - r0 * f_T_B[2] + m_T_B[1]
        m2 = r0 * f_T_B[1] - r1 * f_T_B[0] + m_T_B[2]
        for c in range(3):
            s.joint_moment[j, c] = s.frame_R[i, 0, c] * m0 + s.frame_R[i, 1, c] * m1 + s.frame_R[i, 2, c] * m2


@kernel
def joint_stiffness(s: Record, j: int, c: int) -> float:
    """Stiffness [N.m/rad] of virtual joint j = 0..10 about its axis c = 0, 1, 2 (k_C, k_B, k_A)."""
    stiffness: float = s.stiffness[j, c]
    if j == SENSOR:
        stiffness *= s.sensor_stiffness_scale
    return stiffness


@kernel
def drive_moment(s: Record, i: int) -> float:
    """Moment [N.m] on the drive of axis i = 0..5 about z of its joint: that on its joint, and of those that are coupled to it."""
    moment: float = s.joint_moment[DRIVES[i], 2]
    for m in range(i + 1, 6):
        if s.axis_coupling[m, i] != 0.0:
            moment += s.axis_sign[i] * s.axis_coupling[m, i] * s.joint_moment[DRIVES[m], 2]
    return moment


@kernel
def joint_angles(s: Record) -> None:
    """Fill s.joint_angle [rad] from s.joint_moment; Eq. (7). The drives do not yet turn the joints coupled to them: `couple_drives`."""
    for j in range(JOINTS):
        for c in range(3):
            s.joint_angle[j, c] = s.joint_moment[j, c] / joint_stiffness(s, j, c)
    for i in range(5):
        j = DRIVES[i]
        s.joint_angle[j, 2] = drive_moment(s, i) / joint_stiffness(s, j, 2)


@kernel
def couple_drives(s: Record) -> None:
    """Add to s.joint_angle what the elastic drives turn in the joints that are coupled to their axes."""
    for k in range(5):
        m = 5 - k  # from the last, as only drives before it are read, whose angles are still their own
        for i in range(m):
            if s.axis_coupling[m, i] != 0.0:
                s.joint_angle[DRIVES[m], 2] += s.axis_coupling[m, i] * s.axis_sign[i] * s.joint_angle[DRIVES[i], 2]


@kernel
def deflect(s: Record, d: FloatArray, theta: FloatArray) -> None:
    """Displacement d [m], rotation vector theta [rad] of T in B for s.joint_angle and s.joint_shift; Eqs. (3), (4), (8), (9).

    The product of Eq. (8) is taken from the tool to the base: joint by joint, the part of the chain in
    front of it turns about its origin by R* = Rz(gamma) Ry(beta) Rx(alpha). R* is carried as a quaternion
    and only the displacement is summed, so nothing cancels and no load gives exactly zero.
    """
    u0, u1, u2 = 0.0, 0.0, 0.0
    qw, qx, qy, qz = 1.0, 0.0, 0.0, 0.0
    for k in range(JOINTS):
        j = JOINTS - 1 - k
        i = joint_frame(j)
        sa, ca = sincos(0.5 * s.joint_angle[j, 0])
        sb, cb = sincos(0.5 * s.joint_angle[j, 1])
        sc, cc = sincos(0.5 * s.joint_angle[j, 2])
        w = ca * cb * cc + sa * sb * sc
        x = sa * cb * cc - ca * sb * sc
        y = ca * sb * cc + sa * cb * sc
        z = ca * cb * sc - sa * sb * cc
        # axis of the rotation in B, lever to the displaced tip
        v0 = s.frame_R[i, 0, 0] * x + s.frame_R[i, 0, 1] * y + s.frame_R[i, 0, 2] * z
        v1 = s.frame_R[i, 1, 0] * x + s.frame_R[i, 1, 1] * y + s.frame_R[i, 1, 2] * z
        v2 = s.frame_R[i, 2, 0] * x + s.frame_R[i, 2, 1] * y + s.frame_R[i, 2, 2] * z
        r0 = s.frame_p[13, 0] - s.frame_p[i, 0] + u0
        r1 = s.frame_p[13, 1] - s.frame_p[i, 1] + u1
        r2 = s.frame_p[13, 2] - s.frame_p[i, 2] + u2
        # R* r - r = 2 w (v x r) + 2 v x (v x r)
        c0 = v1 * r2 - v2 * r1
        c1 = v2 * r0 - v0 * r2
        c2 = v0 * r1 - v1 * r0
        u0 += 2.0 * (w * c0 + (v1 * c2 - v2 * c1))
        u1 += 2.0 * (w * c1 + (v2 * c0 - v0 * c2))
        u2 += 2.0 * (w * c2 + (v0 * c1 - v1 * c0))
        if s.joint_shift[j, 0] != 0.0 or s.joint_shift[j, 1] != 0.0 or s.joint_shift[j, 2] != 0.0:
            u0 += s.joint_shift[j, 0]
            u1 += s.joint_shift[j, 1]
            u2 += s.joint_shift[j, 2]
        nw = w * qw - v0 * qx - v1 * qy - v2 * qz
        nx = w * qx + v0 * qw + v1 * qz - v2 * qy
        ny = w * qy - v0 * qz + v1 * qw + v2 * qx
        nz = w * qz + v0 * qy - v1 * qx + v2 * qw
        qw, qx, qy, qz = nw, nx, ny, nz
    d[0] = u0
    d[1] = u1
    d[2] = u2
    s.deflection_quat[0] = qw
    s.deflection_quat[1] = qx
    s.deflection_quat[2] = qy
    s.deflection_quat[3] = qz
    quat_to_rotation_vector(s.deflection_quat, theta)


@kernel
def displacement(s: Record, q: FloatArray, f_T_B: FloatArray, m_T_B: FloatArray, d: FloatArray, theta: FloatArray) -> None:
    """Displacement d [m] and rotation vector theta [rad] of the tool tip in B under a load on the tool; Eqs. (1)-(9).

    q [rad] axis angles, f_T_B [N], m_T_B [N.m] force and moment at T in B. The rigid pose is left in
    s.link_p[6], s.link_R[6].
    """
    virtual_joints(s, q)
    joint_moments(s, f_T_B, m_T_B)
    joint_angles(s)
    couple_drives(s)
    deflect(s, d, theta)


@kernel
def _screw(s: Record, j: int, c: int) -> tuple[float, float, float, float, float, float]:
    """Velocity and turn of the tool tip in B for a turn of virtual joint j about its axis c: [e x r; e]."""
    i = joint_frame(j)
    r0 = s.frame_p[13, 0] - s.frame_p[i, 0]
    r1 = s.frame_p[13, 1] - s.frame_p[i, 1]
    r2 = s.frame_p[13, 2] - s.frame_p[i, 2]
    e0, e1, e2 = s.frame_R[i, 0, c], s.frame_R[i, 1, c], s.frame_R[i, 2, c]
    return e1 * r2 - e2 * r1, e2 * r0 - e0 * r2, e0 * r1 - e1 * r0, e0, e1, e2


@kernel
def tip_screws(s: Record, J: FloatArray) -> None:
    """Fill J (JOINTS, 3, 6): velocity and turn of the tool tip in B per turn of each virtual joint about x, y, z; m/rad, rad/rad.

    Needs `virtual_joints`. The z of a drive has that of the joints coupled to its axis on top.
    """
    for j in range(JOINTS):
        for c in range(3):
            g = _screw(s, j, c)
            for a in range(6):
                J[j, c, a] = g[a]
    for i in range(5):
        for m in range(i + 1, 6):
            if s.axis_coupling[m, i] != 0.0:
                share = s.axis_sign[i] * s.axis_coupling[m, i]
                g = _screw(s, DRIVES[m], 2)
                for a in range(6):
                    J[DRIVES[i], 2, a] += share * g[a]


@kernel
def compliance_matrix(s: Record, q: FloatArray, C: FloatArray) -> None:
    """Cartesian compliance C (6, 6) at T in B, to first order: [d; theta] = C [f; m], in m, rad, N, N.m.

    Sum over the virtual joints of g g^T / k with g = [e x r; e], e the axis of the joint, r its lever to T; the g of a
    drive has that of the joints coupled to its axis on top. A translation along e adds its compliance times e e^T.
    """
    virtual_joints(s, q)
    for a in range(6):
        for b in range(6):
            C[a, b] = 0.0
    for j in range(JOINTS):
        for c in range(3):
            g = _screw(s, j, c)
            for i in range(6):
                if c == 2 and DRIVES[i] == j:
                    for m in range(i + 1, 6):
                        if s.axis_coupling[m, i] != 0.0:
                            share = s.axis_sign[i] * s.axis_coupling[m, i]
                            v = _screw(s, DRIVES[m], 2)
                            g = (
                                g[0] + share * v[0],
                                g[1] + share * v[1],
                                g[2] + share * v[2],
                                g[3] + share * v[3],
                                g[4] + share * v[4],
                                g[5] + share * v[5],
                            )
            softness = 1.0 / joint_stiffness(s, j, c)
            for a in range(6):
                for b in range(6):
                    C[a, b] += g[a] * g[b] * softness
            if s.translation_compliance[j, c] != 0.0:
                i = joint_frame(j)
                for a in range(3):
                    for b in range(3):
                        C[a, b] += s.frame_R[i, a, c] * s.frame_R[i, b, c] * s.translation_compliance[j, c]
