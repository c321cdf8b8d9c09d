"""Geometry of six-axis robots with a spherical wrist: forward, inverse and differential kinematics.

Modified (Craig) Denavit-Hartenberg transforms T_i = Rx(alpha) Tx(a) Rz(theta) Tz(d) with
theta_i = sign_i A_i + sum_(j<i) coupling_ij A_j + offset_i, A_i the axis angles as the controller shows them: Eq. (1) of
Haehn & Weigold 2020 with b = 0. The coupling is that of parallelograms, coupled wrists and of controllers that show the angle
of the arm against the horizontal. A model that appends `ROBOT_VARIABLES` can call the kernels with its record.
Frames: B base, F flange, T tool tip (x axis = tool axis, pointing out of the spindle).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from robomill.models.maths.elementary import PI, TWO_PI, acos, atan2, sincos
from robomill.models.maths.frames import quat_from_abc, quat_to_matrix
from robomill.models.model.declaration import FloatArray, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity

SPHERICAL = tuple(math.radians(a) for a in (0.0, -90.0, 0.0, -90.0, 90.0, -90.0))
"""Twists of a six-axis arm with a spherical wrist [rad], in modified DH."""
WRIST_SINGULAR = 1e-7
"""|sin A5| below which axes 4 and 6 are taken as aligned: there, roundoff alone turns A4 by 1e-9 rad."""


@dataclass(frozen=True)
class Robot:
    """Nominal geometry and limits of a robot, from a file in models/data/robots; arrays have six elements, SI units."""

    name: str
    """Name for people."""
    dh_alpha: FloatArray = field(metadata=quantity("rad"))
    """Denavit-Hartenberg twist of each link."""
    dh_a: FloatArray = field(metadata=quantity("m"))
    """Denavit-Hartenberg length of each link."""
    dh_d: FloatArray = field(metadata=quantity("m"))
    """Denavit-Hartenberg offset of each link."""
    dh_offset: FloatArray = field(metadata=quantity("rad"))
    """Joint angle where the axis angle is zero."""
    axis_sign: FloatArray = field(metadata=quantity("1", -1.0, 1.0))
    """1 or -1: sense of each axis angle against its joint."""
    axis_coupling: FloatArray = field(metadata=quantity("1"))
    """Element [i, j], j < i: what axis j+1 adds to the angle of joint i+1 [rad/rad]; zeros elsewhere."""
    q_home: FloatArray = field(metadata=quantity("rad"))
    """Axis angles from which a program is approached: they choose the branch of the inverse kinematics."""
    q_min: FloatArray = field(metadata=quantity("rad"))
    """Lowest axis angles."""
    q_max: FloatArray = field(metadata=quantity("rad"))
    """Highest axis angles."""
    speed_max: FloatArray = field(metadata=quantity("rad/s", 0.0))
    """Highest speed of each axis."""
    payload: float = field(metadata=quantity("kg", 0.0))
    """Rated payload."""
    repeatability: float = field(metadata=quantity("m", 0.0))
    """Pose repeatability (ISO 9283)."""

    def __post_init__(self) -> None:
        """Refuse tables that are no robot."""
        for name in ("dh_alpha", "dh_a", "dh_d", "dh_offset", "axis_sign", "q_min", "q_max", "q_home", "speed_max"):
            if np.shape(getattr(self, name)) != (6,):
                raise ValueError(f"robot {self.name!r}: {name} has shape {np.shape(getattr(self, name))}, expected (6,)")
        if np.shape(self.axis_coupling) != (6, 6) or np.any(np.triu(self.axis_coupling) != 0.0):
            raise ValueError(
                f"robot {self.name!r}: axis_coupling is {np.asarray(self.axis_coupling).tolist()}, expected six rows of six with zeros "
                "on and above the diagonal: an axis turns its own joint and joints behind it"
            )
        if np.any(np.abs(self.axis_sign) != 1.0):
            raise ValueError(f"robot {self.name!r}: axis_sign is {self.axis_sign}, expected +1 or -1")
        if np.any(self.q_min >= self.q_max):
            raise ValueError(f"robot {self.name!r}: q_min {self.q_min} rad is not below q_max {self.q_max} rad")

    @property
    def no_closed_form(self) -> str:
        """Why `inverse` cannot solve this robot; empty if it can."""
        right = np.array(SPHERICAL)
        if not np.all(np.abs(self.dh_alpha - right) <= 1e-9):
            shown = ", ".join(f"{a:g}" for a in np.rad2deg(self.dh_alpha))
            expected = ", ".join(f"{a:g}" for a in np.rad2deg(right))
            return f"dh_alpha is ({shown}) deg, the closed form is for a spherical wrist with ({expected}) deg"
        zero = np.r_[self.dh_a[[0, 4, 5]], self.dh_d[[1, 2, 4]]]
        if np.any(zero != 0.0):
            shown = ", ".join(f"{1e3 * z:g}" for z in zero)
            return f"a1, a5, a6, d2, d3, d5 are ({shown}) mm, the closed form is for a spherical wrist, where they are zero"
        return ""


@dataclass(frozen=True)
class Tool:
    """An end effector, from a file in models/data/tools; SI units, components in the flange frame F."""

    name: str
    """Name for people."""
    p_FT_F: FloatArray = field(metadata=quantity("m"))
    """Tool tip from the flange."""
    abc_FT: FloatArray = field(metadata=quantity("rad"))
    """Orientation of the tool frame in the flange frame: Euler angles A, B, C."""
    length: float = field(metadata=quantity("m", 0.0))
    """Distance from the virtual joint of the tool to the tool tip."""
    mass: float = field(metadata=quantity("kg", 0.0))
    """Mass of the end effector."""
    p_FG_F: FloatArray = field(metadata=quantity("m"))
    """Centre of gravity of the end effector from the flange."""

    @property
    def quat_FT(self) -> FloatArray:
        """Orientation of T in F as a quaternion (w, x, y, z)."""
        quat = np.zeros(4)
        quat_from_abc(float(self.abc_FT[0]), float(self.abc_FT[1]), float(self.abc_FT[2]), quat)
        return quat


def load_robot(name: str | Path) -> Robot:
    """The robot of a file in models/data/robots by its name (`kr210_2`), or of any TOML file (its path ends in .toml).

    FileNotFoundError lists the robots there are; ValueError names file, field, what was found, what is expected.
    """
    return load(Robot, name if str(name).endswith(".toml") else f"robots/{name}")


def load_tool(name: str | Path) -> Tool:
    """The end effector of a file in models/data/tools by its name, or of any TOML file. Errors as of `load_robot`."""
    return load(Tool, name if str(name).endswith(".toml") else f"tools/{name}")


KR300 = load_robot("kr300_r2500_ultra")
"""KUKA KR 300 R2500 ultra, the robot of Haehn & Weigold 2020."""
SPINDLE_ACROSS = load_tool("spindle_across")
"""Default tool; its offset is calibrated (see its file)."""


def robot_variables(robot: Robot, tool: Tool) -> tuple[Variable, ...]:
    """Parameters and scratch states that the kernels of this module need, with `robot` and `tool` as starts."""
    return (
        Variable("dh_alpha", "parameter", "Modified DH twist of axes 1..6", "rad", (6,), robot.dh_alpha, display_unit="deg"),
        Variable("dh_a", "parameter", "Modified DH length of axes 1..6", "m", (6,), robot.dh_a, display_unit="mm"),
        Variable("dh_d", "parameter", "Modified DH offset along axes 1..6; d6 up to the flange", "m", (6,), robot.dh_d, display_unit="mm"),
        Variable(
            "dh_offset", "parameter", "Modified DH angle of axes 1..6 at axis angle zero", "rad", (6,), robot.dh_offset, display_unit="deg"
        ),
        Variable(
            "axis_sign",
            "parameter",
            "Sense of axis angles A1..A6 against the z axes of the DH frames: +1 or -1",
            "1",
            (6,),
            robot.axis_sign,
        ),
        Variable(
            "axis_coupling",
            "parameter",
            "What axis j (column) adds to the angle of joint i (row) behind it: parallelograms, coupled wrists",
            "1",
            (6, 6),
            robot.axis_coupling,
        ),
        Variable("q_min", "parameter", "Lower limits of A1..A6", "rad", (6,), robot.q_min, display_unit="deg"),
        Variable("q_max", "parameter", "Upper limits of A1..A6", "rad", (6,), robot.q_max, display_unit="deg"),
        Variable("p_FT_F", "parameter", "Tool tip T from flange F, in F", "m", (3,), tool.p_FT_F, display_unit="mm"),
        Variable("quat_FT", "parameter", "Orientation of T in F, unit quaternion (w, x, y, z)", "1", (4,), tool.quat_FT, -1.0, 1.0),
        Variable("link_R", "state", "Scratch: orientation in B of DH frames 1..6 and of T", "1", (7, 3, 3)),
        Variable("link_p", "state", "Scratch: origin in B of DH frames 1..6 (the sixth is the flange) and of T", "m", (7, 3)),
        Variable("R_FT", "state", "Scratch: orientation of T in F", "1", (3, 3)),
        Variable("wrist_R", "state", "Scratch: orientations while the inverse kinematics runs", "1", (3, 3, 3)),
        Variable("q_branch", "state", "Scratch: one solution of the inverse kinematics", "rad", (6,)),
    )


ROBOT_VARIABLES = robot_variables(KR300, SPINDLE_ACROSS)


@kernel
def joint_angle(s: Record, i: int, q: FloatArray) -> float:
    """DH angle theta [rad] of joint i = 0..5 at the axis angles q [rad]."""
    theta: float = s.axis_sign[i] * q[i] + s.dh_offset[i]
    for j in range(i):
        if s.axis_coupling[i, j] != 0.0:
            theta += s.axis_coupling[i, j] * q[j]
    return theta


@kernel
def forward(s: Record, q: FloatArray) -> None:
    """Fill s.link_R[i], s.link_p[i] [m] from the axis angles q [rad]: i = 0..5 DH frames 1..6, i = 6 the tool tip."""
    for i in range(6):
        sin_t, cos_t = sincos(joint_angle(s, i, q))
        sin_a, cos_a = sincos(s.dh_alpha[i])
        a = s.dh_a[i]
        d = s.dh_d[i]
        for r in range(3):
            if i == 0:
                x = 1.0 if r == 0 else 0.0
                y = 1.0 if r == 1 else 0.0
                z = 1.0 if r == 2 else 0.0
                p = 0.0
            else:
                x = s.link_R[i - 1, r, 0]
                y = s.link_R[i - 1, r, 1]
                z = s.link_R[i - 1, r, 2]
                p = s.link_p[i - 1, r]
            # the row of R_(i-1) Rx(alpha), then of R_(i-1) Rx(alpha) Rz(theta)
            u = cos_a * y + sin_a * z
            w = cos_a * z - sin_a * y
            s.link_R[i, r, 0] = cos_t * x + sin_t * u
            s.link_R[i, r, 1] = cos_t * u - sin_t * x
            s.link_R[i, r, 2] = w
            s.link_p[i, r] = p + a * x + d * w
    quat_to_matrix(s.quat_FT, s.R_FT)
    for r in range(3):
        x = s.link_R[5, r, 0]
        y = s.link_R[5, r, 1]
        z = s.link_R[5, r, 2]
        for c in range(3):
            s.link_R[6, r, c] = x * s.R_FT[0, c] + y * s.R_FT[1, c] + z * s.R_FT[2, c]
        s.link_p[6, r] = s.link_p[5, r] + x * s.p_FT_F[0] + y * s.p_FT_F[1] + z * s.p_FT_F[2]


@kernel
def tool_pose(s: Record, q: FloatArray, p: FloatArray, R: FloatArray) -> None:
    """Position p = p_BT_B [m] and orientation R = R_BT of the rigid tool tip at the axis angles q [rad]."""
    forward(s, q)
    for r in range(3):
        p[r] = s.link_p[6, r]
        for c in range(3):
            R[r, c] = s.link_R[6, r, c]


@kernel
def jacobian(s: Record, q: FloatArray, J: FloatArray) -> None:
    """Geometric Jacobian J (6, 6) of T in B: [v; omega] [m/s; rad/s] = J dq/dt, q the axis angles [rad]; runs `forward`."""
    forward(s, q)
    for i in range(6):
        sign = s.axis_sign[i]
        z0 = sign * s.link_R[i, 0, 2]
        z1 = sign * s.link_R[i, 1, 2]
        z2 = sign * s.link_R[i, 2, 2]
        r0 = s.link_p[6, 0] - s.link_p[i, 0]
        r1 = s.link_p[6, 1] - s.link_p[i, 1]
        r2 = s.link_p[6, 2] - s.link_p[i, 2]
        J[0, i] = z1 * r2 - z2 * r1
        J[1, i] = z2 * r0 - z0 * r2
        J[2, i] = z0 * r1 - z1 * r0
        J[3, i] = z0
        J[4, i] = z1
        J[5, i] = z2
    # an axis also turns the joints that are coupled to it: their columns, still their own, come on top of its own
    for j in range(5):
        for i in range(j + 1, 6):
            if s.axis_coupling[i, j] != 0.0:
                for k in range(6):
                    J[k, j] += s.axis_coupling[i, j] * s.axis_sign[i] * J[k, i]


@kernel
def _nearest_turn(s: Record, i: int, theta: float, near: float) -> float:
    """Axis angle of DH angle `theta` [rad], by whole turns inside the limits and nearest to `near`; beyond them if it must.

    What the axes before it, in s.q_branch, add to the joint is taken off.
    """
    for j in range(i):
        if s.axis_coupling[i, j] != 0.0:
            theta -= s.axis_coupling[i, j] * s.q_branch[j]
    q: float = s.axis_sign[i] * (theta - s.dh_offset[i])
    q += TWO_PI * math.floor((near - q) / TWO_PI + 0.5)
    if q > s.q_max[i] and q - TWO_PI >= s.q_min[i]:
        q -= TWO_PI
    elif q < s.q_min[i] and q + TWO_PI <= s.q_max[i]:
        q += TWO_PI
    return q


@kernel
def inverse(s: Record, p: FloatArray, R: FloatArray, q_near: FloatArray, q: FloatArray) -> int:
    """Axis angles q [rad] that put the tool tip at p = p_BT_B [m], R = R_BT, in closed form.

    Of all branches (shoulder, elbow, wrist) and turns inside the limits, the one nearest to `q_near`
    [rad, least sum of squared differences]. Where axes 4 and 6 align, A4 of `q_near` is kept.
    Returns 0, 1 if the point is out of reach, 2 if only solutions outside the limits exist;
    q is then left alone. Needs the DH pattern that `Robot` checks.
    """
    quat_to_matrix(s.quat_FT, s.R_FT)
    R_BF = s.wrist_R[0]
    for i in range(3):
        for j in range(3):
            R_BF[i, j] = R[i, 0] * s.R_FT[j, 0] + R[i, 1] * s.R_FT[j, 1] + R[i, 2] * s.R_FT[j, 2]
    # wrist centre W: back from T to the flange, then by d6 along the flange axis
    along = s.p_FT_F[2] + s.dh_d[5]
    wx = p[0] - R_BF[0, 0] * s.p_FT_F[0] - R_BF[0, 1] * s.p_FT_F[1] - R_BF[0, 2] * along
    wy = p[1] - R_BF[1, 0] * s.p_FT_F[0] - R_BF[1, 1] * s.p_FT_F[1] - R_BF[1, 2] * along
    wz = p[2] - R_BF[2, 0] * s.p_FT_F[0] - R_BF[2, 1] * s.p_FT_F[1] - R_BF[2, 2] * along
    radius = math.sqrt(wx * wx + wy * wy)
    height = wz - s.dh_d[0]
    upper = s.dh_a[2]
    lower = math.sqrt(s.dh_a[3] * s.dh_a[3] + s.dh_d[3] * s.dh_d[3])
    bend = atan2(s.dh_d[3], s.dh_a[3])
    if radius > 1e-9:
        heading = atan2(wy, wx)
    else:
        heading = s.axis_sign[0] * q_near[0] + s.dh_offset[0]
    reachable = False
    best = math.inf
    for shoulder in range(2):
        t1 = heading + PI * shoulder
        reach = (radius if shoulder == 0 else -radius) - s.dh_a[1]
        cosine = (reach * reach + height * height - upper * upper - lower * lower) / (2.0 * upper * lower)
        if abs(cosine) > 1.0 + 1e-12:
            continue
        reachable = True
        inner = acos(max(-1.0, min(1.0, cosine)))
        for elbow in range(2):
            v = inner if elbow == 0 else -inner
            sin_v, cos_v = sincos(v)
            t2 = atan2(lower * sin_v, upper + lower * cos_v) - atan2(height, reach)
            t3 = -v - bend
            # R_36 = R_03^T R_06 with R_03 = Rz(t1) Rx(-90 deg) Rz(t2 + t3); M = R_36
            s1, c1 = sincos(t1)
            s23, c23 = sincos(t2 + t3)
            M = s.wrist_R[1]
            for j in range(3):
                ahead = c1 * R_BF[0, j] + s1 * R_BF[1, j]
                M[0, j] = c23 * ahead - s23 * R_BF[2, j]
                M[1, j] = -s23 * ahead - c23 * R_BF[2, j]
                M[2, j] = c1 * R_BF[1, j] - s1 * R_BF[0, j]
            # M Rx(90 deg) = Ry(t4) Rz(t5) Ry(t6)
            sine = math.sqrt(M[1, 0] * M[1, 0] + M[1, 1] * M[1, 1])
            for flip in range(2):
                if sine > WRIST_SINGULAR:
                    if flip == 0:
                        t4 = atan2(M[2, 2], -M[0, 2])
                        t6 = atan2(-M[1, 1], M[1, 0])
                        t5 = atan2(sine, M[1, 2])
                    else:
                        t4 = atan2(-M[2, 2], M[0, 2])
                        t6 = atan2(M[1, 1], -M[1, 0])
                        t5 = atan2(-sine, M[1, 2])
                else:
                    if flip == 1:
                        continue
                    # only t4 + t6 (or t4 - t6 if folded back) is determined
                    t4 = joint_angle(s, 3, q_near)
                    if M[1, 2] > 0.0:
                        t5 = 0.0
                        t6 = atan2(-M[0, 1], M[0, 0]) - t4
                    else:
                        t5 = PI
                        t6 = t4 - atan2(-M[0, 1], -M[0, 0])
                s.q_branch[0] = _nearest_turn(s, 0, t1, q_near[0])
                s.q_branch[1] = _nearest_turn(s, 1, t2, q_near[1])
                s.q_branch[2] = _nearest_turn(s, 2, t3, q_near[2])
                s.q_branch[3] = _nearest_turn(s, 3, t4, q_near[3])
                s.q_branch[4] = _nearest_turn(s, 4, t5, q_near[4])
                s.q_branch[5] = _nearest_turn(s, 5, t6, q_near[5])
                distance = 0.0
                inside = True
                for i in range(6):
                    difference = s.q_branch[i] - q_near[i]
                    distance += difference * difference
                    if s.q_branch[i] < s.q_min[i] or s.q_branch[i] > s.q_max[i]:
                        inside = False
                if inside and distance < best:
                    best = distance
                    for i in range(6):
                        q[i] = s.q_branch[i]
    if best < math.inf:
        return 0
    return 2 if reachable else 1
