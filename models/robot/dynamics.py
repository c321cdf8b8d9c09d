"""Rigid-body inverse dynamics of a six-axis robot, its counterbalance, rotors and friction.

    tau = M(q) qdd + C(q, qd) qd + g(q) + J_r G^2 qdd + tau_cb(q) - J^T w          (axis side)

by the recursive Newton-Euler method (Luh, Walker, Paul 1980) with all vectors in B. Masses, centres
of gravity and inertias of the KR 300 R2500 ultra, and the geometry of its hydraulic counterbalance,
are those identified by Weigand (FACTS 1.4). `w` is the process wrench acting ON the tool: what the
process does for the motion, the motors need not, hence the minus. Friction is not part of the
nominal model; its laws are here because motor torque shows them.

The kernels take the record of any model that contains `ROBOT_VARIABLES` and `DYNAMICS_VARIABLES`
and allocate nothing; `inverse_dynamics` and `mass_matrix` are the same for plain arrays.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.models.maths.elementary import exp, sincos
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel, record
from robomill.models.model.kernels import COMPILER_OPTIONS, tell_numba
from robomill.models.model.parameters import load, quantity
from robomill.models.robot.kinematics import KR300, ROBOT_VARIABLES, SPINDLE_ACROSS, Robot, forward


def _none() -> FloatArray:
    return np.zeros(6)


def _direct() -> FloatArray:
    return np.ones(6)


@dataclass(frozen=True, kw_only=True)
class RobotDynamics:
    """Inertial data of a robot as published: link frames of the source (standard DH), axis or motor side as named.

    What a source does not give may be left out: rotors, gears (then direct), counterbalance and friction.
    """

    dh_base_roll: float = field(metadata=quantity("rad"))
    """Turn of the first frame of the source about x of the robot base."""
    dh_d: FloatArray = field(metadata=quantity("m"))
    """Denavit-Hartenberg offset of each link, as the source has it."""
    dh_a: FloatArray = field(metadata=quantity("m"))
    """Denavit-Hartenberg length of each link, likewise."""
    dh_alpha: FloatArray = field(metadata=quantity("rad"))
    """Denavit-Hartenberg twist of each link, likewise."""
    dh_offset: FloatArray = field(metadata=quantity("rad"))
    """Joint angle where the axis angle is zero, likewise."""
    body_mass: FloatArray = field(metadata=quantity("kg", 0.0))
    """Mass of each link."""
    body_com: FloatArray = field(metadata=quantity("m"))
    """Centre of gravity of each link, in its frame."""
    body_inertia: FloatArray = field(metadata=quantity("kg.m2"))
    """Inertia of each link about its centre of gravity: xx, yy, zz, xy, yz, xz."""
    rotor_inertia: FloatArray = field(default_factory=_none, metadata=quantity("kg.m2", 0.0))
    """Inertia of each rotor, motor side."""
    gear_ratio: FloatArray = field(default_factory=_direct, metadata=quantity("1", 1.0))
    """Turns of the motor per turn of the joint."""
    counterbalance_frame_distance: float = field(default=0.0, metadata=quantity("m", 0.0))
    """Hydraulic counterbalance of axis 2: from the axis to where the cylinder hangs."""
    counterbalance_lever: float = field(default=0.0, metadata=quantity("m", 0.0))
    """From the axis to where the cylinder pulls; 0: no counterbalance."""
    counterbalance_area: float = field(default=0.0, metadata=quantity("m2", 0.0))
    """Area of the piston."""
    counterbalance_gas: float = field(default=0.0, metadata=quantity("N.m", 0.0))
    """Amount of gas: pressure times volume."""
    counterbalance_volume: float = field(default=1.0, metadata=quantity("m3", 0.0))
    """Volume of the gas where the cylinder is shortest."""
    counterbalance_angle: float = field(default=0.0, metadata=quantity("rad"))
    """Angle of the cylinder's lever where axis angle 2 is zero."""
    backlash_half_gap: FloatArray = field(default_factory=_none, metadata=quantity("rad", 0.0))
    """Half of the backlash of each gear, joint side."""
    motor_viscous_friction: FloatArray = field(default_factory=_none, metadata=quantity("N.m.s/rad", 0.0))
    """Viscous friction of each motor."""
    motor_coulomb_friction: FloatArray = field(default_factory=_none, metadata=quantity("N.m", 0.0))
    """Coulomb friction of each motor."""
    link_asymmetric_friction: FloatArray = field(default_factory=_none, metadata=quantity("N.m"))
    """Friction of each joint that has one sign in both directions."""
    link_viscous_friction: FloatArray = field(default_factory=_none, metadata=quantity("N.m.s/rad", 0.0))
    """Viscous friction of each joint."""
    link_coulomb_friction: FloatArray = field(default_factory=_none, metadata=quantity("N.m", 0.0))
    """Coulomb friction of each joint."""
    link_step_friction: FloatArray = field(default_factory=_none, metadata=quantity("N.m", 0.0))
    """Friction of each joint that saturates with its speed."""
    link_step_slope: FloatArray = field(default_factory=_none, metadata=quantity("s/rad", 0.0))
    """How fast that saturates."""
    payload_inertia: FloatArray = field(metadata=quantity("kg.m2"))
    """Inertia of the end effector about its centre of gravity."""
    gravity_B: FloatArray = field(metadata=quantity("m/s2"))
    """Acceleration of gravity in the robot base."""


def inertia_matrix(six: npt.ArrayLike) -> FloatArray:
    """The symmetric matrix [3,3] of (xx, yy, zz, xy, yz, xz) [kg m2]."""
    xx, yy, zz, xy, yz, xz = np.asarray(six, dtype=np.float64)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _transform(alpha: float, a: float, theta: float, d: float, modified: bool) -> FloatArray:
    """Homogeneous transform [4,4] of one DH row [rad, m]: Rx(alpha) Tx(a) Rz Tz (modified) or Rz Tz Tx Rx (standard)."""
    ca, sa, ct, st = math.cos(alpha), math.sin(alpha), math.cos(theta), math.sin(theta)
    about_x = np.array([[1, 0, 0, a], [0, ca, -sa, 0], [0, sa, ca, 0], [0, 0, 0, 1.0]])
    about_z = np.array([[ct, -st, 0, 0], [st, ct, 0, 0], [0, 0, 1, d], [0, 0, 0, 1.0]])
    product: FloatArray = about_x @ about_z if modified else about_z @ about_x
    return product


def in_robot_frames(dynamics: RobotDynamics, robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Centres of gravity [6,3] m and inertias [6,6] kg m2 (xx, yy, zz, xy, yz, xz) in the link frames of `models.robot.kinematics`.

    Both kinds of frame i move with link i, so the transform between them is the one at q = 0.
    """
    com, inertia = np.empty((6, 3)), np.empty((6, 6))
    source, own = _transform(dynamics.dh_base_roll, 0.0, 0.0, 0.0, True), np.eye(4)
    for i in range(6):
        source = source @ _transform(dynamics.dh_alpha[i], dynamics.dh_a[i], dynamics.dh_offset[i], dynamics.dh_d[i], False)
        own = own @ _transform(robot.dh_alpha[i], robot.dh_a[i], robot.dh_offset[i], robot.dh_d[i], True)
        X = np.linalg.inv(own) @ source
        com[i] = X[:3, :3] @ dynamics.body_com[i] + X[:3, 3]
        turned = X[:3, :3] @ inertia_matrix(dynamics.body_inertia[i]) @ X[:3, :3].T
        inertia[i] = turned[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    return com, inertia


def load_dynamics(name: str) -> RobotDynamics:
    """The rigid bodies of a robot by its name, from models/data/dynamics. FileNotFoundError lists what there is."""
    return load(RobotDynamics, f"dynamics/{name}")


KR300_DYNAMICS = load_dynamics("kr300_r2500_ultra")
_COM, _INERTIA = in_robot_frames(KR300_DYNAMICS, KR300)

DYNAMICS_VARIABLES: tuple[Variable, ...] = (
    Variable("body_mass", "parameter", "Mass of links 1..6", "kg", (6,), KR300_DYNAMICS.body_mass, 0.0),
    Variable("body_com", "parameter", "Centre of gravity of links 1..6 in their link frames", "m", (6, 3), _COM),
    Variable(
        "body_inertia",
        "parameter",
        "Inertia of links 1..6 about the centre of gravity, axes of the link frame: xx, yy, zz, xy, yz, xz",
        "kg.m2",
        (6, 6),
        _INERTIA,
    ),
    Variable(
        "rotor_inertia",
        "parameter",
        "Inertia of motor, brake and gear input at the motor shaft",
        "kg.m2",
        (6,),
        KR300_DYNAMICS.rotor_inertia,
        0.0,
    ),
    Variable("gear_ratio", "parameter", "Motor angle over axis angle", "1", (6,), KR300_DYNAMICS.gear_ratio, 1.0),
    Variable("payload_mass", "parameter", "Mass of everything on the flange", "kg", (), SPINDLE_ACROSS.mass, 0.0, 1000.0),
    Variable("payload_com_F", "parameter", "Centre of gravity of the payload in F", "m", (3,), SPINDLE_ACROSS.p_FG_F),
    Variable(
        "payload_inertia",
        "parameter",
        "Inertia of the payload about its centre of gravity, axes of F: xx, yy, zz, xy, yz, xz",
        "kg.m2",
        (6,),
        KR300_DYNAMICS.payload_inertia,
    ),
    Variable("gravity_B", "parameter", "Acceleration of free fall in B", "m/s2", (3,), KR300_DYNAMICS.gravity_B),
    Variable(
        "counterbalance_frame_distance",
        "parameter",
        "Axis 2 to the pivot of the counterbalance cylinder on the column",
        "m",
        (),
        KR300_DYNAMICS.counterbalance_frame_distance,
        0.0,
    ),
    Variable(
        "counterbalance_lever",
        "parameter",
        "Axis 2 to the pivot of the piston rod on the link arm; 0: no counterbalance",
        "m",
        (),
        KR300_DYNAMICS.counterbalance_lever,
        0.0,
    ),
    Variable("counterbalance_area", "parameter", "Piston area under gas pressure", "m2", (), KR300_DYNAMICS.counterbalance_area, 0.0),
    Variable(
        "counterbalance_gas", "parameter", "Pressure times volume of the gas, isothermal", "N.m", (), KR300_DYNAMICS.counterbalance_gas, 0.0
    ),
    Variable(
        "counterbalance_volume", "parameter", "Gas volume at the shortest cylinder", "m3", (), KR300_DYNAMICS.counterbalance_volume, 0.0
    ),
    Variable(
        "counterbalance_angle",
        "parameter",
        "Added to A2 gives the angle of the lever against the line from axis 2 to the cylinder",
        "rad",
        (),
        KR300_DYNAMICS.counterbalance_angle,
        display_unit="deg",
    ),
    Variable("rigid_mass", "state", "Mass of the six moving bodies, payload in the last", "kg", (6,)),
    Variable("rigid_com", "state", "Their centres of gravity in the link frames", "m", (6, 3)),
    Variable("rigid_inertia", "state", "Their inertias about the centre of gravity: xx, yy, zz, xy, yz, xz", "kg.m2", (6, 6)),
    Variable("body_force_B", "state", "Scratch: inertial force of each body", "N", (6, 3)),
    Variable("body_moment_B", "state", "Scratch: moment of it about the origin of B", "N.m", (6, 3)),
)
"""Parameters and scratch of the kernels below; a model appends them to its own, after `ROBOT_VARIABLES`."""


@kernel
def prepare_dynamics(s: Record) -> None:
    """Merge the payload into body 6 (parallel axes); call it from `init`. Frame 6 of the robot is F."""
    for i in range(6):
        s.rigid_mass[i] = s.body_mass[i]
        for k in range(3):
            s.rigid_com[i, k] = s.body_com[i, k]
        for k in range(6):
            s.rigid_inertia[i, k] = s.body_inertia[i, k]
    mass = s.body_mass[5] + s.payload_mass
    if s.payload_mass > 0.0 and mass > 0.0:
        reduced = s.body_mass[5] * s.payload_mass / mass
        dx = s.payload_com_F[0] - s.body_com[5, 0]
        dy = s.payload_com_F[1] - s.body_com[5, 1]
        dz = s.payload_com_F[2] - s.body_com[5, 2]
        share = s.payload_mass / mass
        s.rigid_mass[5] = mass
        s.rigid_com[5, 0] = s.body_com[5, 0] + share * dx
        s.rigid_com[5, 1] = s.body_com[5, 1] + share * dy
        s.rigid_com[5, 2] = s.body_com[5, 2] + share * dz
        s.rigid_inertia[5, 0] = s.body_inertia[5, 0] + s.payload_inertia[0] + reduced * (dy * dy + dz * dz)
        s.rigid_inertia[5, 1] = s.body_inertia[5, 1] + s.payload_inertia[1] + reduced * (dz * dz + dx * dx)
        s.rigid_inertia[5, 2] = s.body_inertia[5, 2] + s.payload_inertia[2] + reduced * (dx * dx + dy * dy)
        s.rigid_inertia[5, 3] = s.body_inertia[5, 3] + s.payload_inertia[3] - reduced * dx * dy
        s.rigid_inertia[5, 4] = s.body_inertia[5, 4] + s.payload_inertia[4] - reduced * dy * dz
        s.rigid_inertia[5, 5] = s.body_inertia[5, 5] + s.payload_inertia[5] - reduced * dx * dz


@kernel
def counterbalance_torque(s: Record, q2: float) -> float:
    """Torque on axis 2 that the motor must add because of the counterbalance [N m] at A2 = `q2` [rad] (FACTS 1.4).

    delta = A2 + 95 deg; l = sqrt(D^2 + k^2 - 2 D k cos(delta)); p = Z R T m / (V - (l - (D - k)) A);
    tau = p A dl/dA2 = p A D k sin(delta) / l. It is the gradient of the energy of the gas,
    zero and stable at delta = 0, and opposite to gravity on either side.
    """
    D, k = s.counterbalance_frame_distance, s.counterbalance_lever
    if k == 0.0 or D == 0.0:
        return 0.0
    sine, cosine = sincos(q2 + s.counterbalance_angle)
    length = math.sqrt(D * D + k * k - 2.0 * D * k * cosine)
    volume = s.counterbalance_volume - (length - (D - k)) * s.counterbalance_area
    return float(s.counterbalance_gas / volume * s.counterbalance_area * D * k * sine / length)


@kernel
def counterbalance_fits(s: Record) -> bool:
    """Whether lever and volume are such that `counterbalance_torque` is finite at every angle."""
    if s.counterbalance_lever == 0.0 or s.counterbalance_frame_distance == 0.0:
        return True
    stroke = 2.0 * s.counterbalance_lever
    return bool(s.counterbalance_frame_distance > s.counterbalance_lever and s.counterbalance_volume > stroke * s.counterbalance_area)


@kernel
def newton_euler(s: Record, qd: FloatArray, qdd: FloatArray, f_T_B: FloatArray, m_T_B: FloatArray, tau: FloatArray) -> None:
    """Axis torques `tau` [6] N m of the rigid bodies at the frames that `forward(s, q)` left in the record.

    `qd` [6] rad/s, `qdd` [6] rad/s2; `f_T_B` [3] N and `m_T_B` [3] N m act on the tool at T.
    tau = M qdd + C qd + g - J^T w. Axis i turns positively about axis_sign[i] times z of link frame i.
    Outward: omega, its rate, and the acceleration of the frame origin, all in B, with gravity as
    an upward acceleration of the base. Inward: sums of forces and of moments about the origin of B.
    """
    wx, wy, wz = 0.0, 0.0, 0.0
    bx, by, bz = 0.0, 0.0, 0.0
    ax, ay, az = -s.gravity_B[0], -s.gravity_B[1], -s.gravity_B[2]
    ox, oy, oz = 0.0, 0.0, 0.0
    for i in range(6):
        px, py, pz = s.link_p[i, 0], s.link_p[i, 1], s.link_p[i, 2]
        dx, dy, dz = px - ox, py - oy, pz - oz
        ox, oy, oz = px, py, pz
        # the origin of frame i lies on axis i, so it still moves with link i-1
        cx, cy, cz = wy * dz - wz * dy, wz * dx - wx * dz, wx * dy - wy * dx
        ax += by * dz - bz * dy + wy * cz - wz * cy
        ay += bz * dx - bx * dz + wz * cx - wx * cz
        az += bx * dy - by * dx + wx * cy - wy * cx
        r00, r01, r02 = s.link_R[i, 0, 0], s.link_R[i, 0, 1], s.link_R[i, 0, 2]
        r10, r11, r12 = s.link_R[i, 1, 0], s.link_R[i, 1, 1], s.link_R[i, 1, 2]
        r20, r21, r22 = s.link_R[i, 2, 0], s.link_R[i, 2, 1], s.link_R[i, 2, 2]
        sign = s.axis_sign[i]
        rate, push = sign * qd[i], sign * qdd[i]
        for j in range(i):
            if s.axis_coupling[i, j] != 0.0:
                rate += s.axis_coupling[i, j] * qd[j]
                push += s.axis_coupling[i, j] * qdd[j]
        vx, vy, vz = r02 * rate, r12 * rate, r22 * rate
        bx += r02 * push + wy * vz - wz * vy
        by += r12 * push + wz * vx - wx * vz
        bz += r22 * push + wx * vy - wy * vx
        wx += vx
        wy += vy
        wz += vz
        gx, gy, gz = s.rigid_com[i, 0], s.rigid_com[i, 1], s.rigid_com[i, 2]
        cx = r00 * gx + r01 * gy + r02 * gz
        cy = r10 * gx + r11 * gy + r12 * gz
        cz = r20 * gx + r21 * gy + r22 * gz
        ux, uy, uz = wy * cz - wz * cy, wz * cx - wx * cz, wx * cy - wy * cx
        mass = s.rigid_mass[i]
        fx = mass * (ax + by * cz - bz * cy + wy * uz - wz * uy)
        fy = mass * (ay + bz * cx - bx * cz + wz * ux - wx * uz)
        fz = mass * (az + bx * cy - by * cx + wx * uy - wy * ux)
        # Euler's equation in the axes of the link, where the inertia is constant
        lx, ly, lz = r00 * wx + r10 * wy + r20 * wz, r01 * wx + r11 * wy + r21 * wz, r02 * wx + r12 * wy + r22 * wz
        ex, ey, ez = r00 * bx + r10 * by + r20 * bz, r01 * bx + r11 * by + r21 * bz, r02 * bx + r12 * by + r22 * bz
        xx, yy, zz = s.rigid_inertia[i, 0], s.rigid_inertia[i, 1], s.rigid_inertia[i, 2]
        xy, yz, xz = s.rigid_inertia[i, 3], s.rigid_inertia[i, 4], s.rigid_inertia[i, 5]
        hx, hy, hz = xx * lx + xy * ly + xz * lz, xy * lx + yy * ly + yz * lz, xz * lx + yz * ly + zz * lz
        nx = xx * ex + xy * ey + xz * ez + ly * hz - lz * hy
        ny = xy * ex + yy * ey + yz * ez + lz * hx - lx * hz
        nz = xz * ex + yz * ey + zz * ez + lx * hy - ly * hx
        cx += px
        cy += py
        cz += pz
        s.body_force_B[i, 0], s.body_force_B[i, 1], s.body_force_B[i, 2] = fx, fy, fz
        s.body_moment_B[i, 0] = r00 * nx + r01 * ny + r02 * nz + cy * fz - cz * fy
        s.body_moment_B[i, 1] = r10 * nx + r11 * ny + r12 * nz + cz * fx - cx * fz
        s.body_moment_B[i, 2] = r20 * nx + r21 * ny + r22 * nz + cx * fy - cy * fx
    px, py, pz = s.link_p[6, 0], s.link_p[6, 1], s.link_p[6, 2]
    fx, fy, fz = -f_T_B[0], -f_T_B[1], -f_T_B[2]
    nx = py * fz - pz * fy - m_T_B[0]
    ny = pz * fx - px * fz - m_T_B[1]
    nz = px * fy - py * fx - m_T_B[2]
    for j in range(6):
        i = 5 - j
        fx += s.body_force_B[i, 0]
        fy += s.body_force_B[i, 1]
        fz += s.body_force_B[i, 2]
        nx += s.body_moment_B[i, 0]
        ny += s.body_moment_B[i, 1]
        nz += s.body_moment_B[i, 2]
        px, py, pz = s.link_p[i, 0], s.link_p[i, 1], s.link_p[i, 2]
        tau[i] = s.axis_sign[i] * (
            s.link_R[i, 0, 2] * (nx - py * fz + pz * fy)
            + s.link_R[i, 1, 2] * (ny - pz * fx + px * fz)
            + s.link_R[i, 2, 2] * (nz - px * fy + py * fx)
        )
    # virtual work: an axis also carries the joints that are coupled to it
    for j in range(5):
        for i in range(j + 1, 6):
            if s.axis_coupling[i, j] != 0.0:
                tau[j] += s.axis_coupling[i, j] * s.axis_sign[i] * tau[i]


@kernel
def axis_torque(s: Record, q: FloatArray, qd: FloatArray, qdd: FloatArray, f_T_B: FloatArray, m_T_B: FloatArray, tau: FloatArray) -> None:
    """Axis-side torques `tau` [6] N m without friction: rigid bodies, rotors, counterbalance, process wrench.

    Units and signs as in `newton_euler`; needs `prepare_dynamics`; leaves the frames of `q` in the record.
    The motor-side torque is tau / gear_ratio. Rotors count with J G^2 about their own axis only
    (their gyroscopic moment, of the order of J G qd qd', is left out as in the source).
    """
    forward(s, q)
    newton_euler(s, qd, qdd, f_T_B, m_T_B, tau)
    tau[1] += counterbalance_torque(s, q[1])
    for i in range(6):
        tau[i] += s.rotor_inertia[i] * s.gear_ratio[i] * s.gear_ratio[i] * qdd[i]


@kernel
def friction_torque(qd: float, viscous: float, coulomb: float, stribeck: float, side: float, stribeck_speed: float) -> float:
    """Friction on one axis [N m] that the motor must overcome at the speed `qd` [rad/s].

    viscous qd + (coulomb + stribeck exp(-(qd / stribeck_speed)^2)) side: Stribeck's curve. `side` [1] is the side to which dry friction
    acts, -1..1: tanh(qd / smooth speed), or what `presliding` says. Viscous [N m s/rad], Coulomb and Stribeck (breakaway minus Coulomb)
    [N m], all axis side.
    """
    ratio = qd / stribeck_speed
    return viscous * qd + (coulomb + stribeck * exp(-ratio * ratio)) * side


@kernel
def presliding(side: float, moved: float, distance: float) -> float:
    """The side to which dry friction acts [1] after an axis has `moved` [rad], from what it was before: at rest it holds.

    Dahl's law dF/dq = (F_c - F sgn dq) / distance, exact for a move in one direction (Dahl, A solid friction model, The Aerospace
    Corporation, TOR-0158(3107-18)-1, 1968). After a reversal friction turns over within a few times the distance [rad].
    """
    if moved == 0.0:
        return side
    slides = 1.0 if moved > 0.0 else -1.0
    return slides + (side - slides) * exp(-abs(moved) / distance)


# ------------------------------------------------------------------ for arrays over time


def _rigid_init(s: Record) -> int:
    prepare_dynamics(s)
    return 0 if counterbalance_fits(s) else 1


def _rigid_step(s: Record, t: float, h: float) -> int:
    axis_torque(s, s.q, s.qd, s.qdd, s.f_T_B, s.m_T_B, s.tau)
    return 0


RIGID_BODY = Model(
    name="rigid_body",
    description="Inverse dynamics of the robot: axis torques of a motion",
    variables=(
        Variable("q", "input", "Axis angles", "rad", (6,)),
        Variable("qd", "input", "Axis speeds", "rad/s", (6,)),
        Variable("qdd", "input", "Axis accelerations", "rad/s2", (6,)),
        Variable("f_T_B", "input", "Process force on the tool", "N", (3,)),
        Variable("m_T_B", "input", "Process moment on the tool at T", "N.m", (3,)),
        Variable("tau", "output", "Axis torques without friction, axis side", "N.m", (6,)),
        *ROBOT_VARIABLES,
        *DYNAMICS_VARIABLES,
    ),
    init=_rigid_init,
    step=_rigid_step,
    errors=(
        "",
        "the counterbalance cannot move: lever {counterbalance_lever} m, frame {counterbalance_frame_distance} m, "
        "area {counterbalance_area} m2, gas volume {counterbalance_volume} m3; "
        "expected a lever shorter than the frame and a volume above 2 * lever * area",
    ),
)
"""The kernels above as a model of their own, for plain arrays and tests; not a component."""


def _over_time(s: Record, q: FloatArray, qd: FloatArray, qdd: FloatArray, f_T_B: FloatArray, m_T_B: FloatArray, tau: FloatArray) -> None:
    for k in range(q.shape[0]):
        axis_torque(s, q[k], qd[k], qdd[k], f_T_B[k], m_T_B[k], tau[k])


@functools.cache
def _compiled_over_time() -> Callable[..., None]:
    """`_over_time`, compiled where Numba is installed."""
    try:
        from numba import njit
    except ImportError:
        return _over_time
    tell_numba()
    compiled: Callable[..., None] = njit(**COMPILER_OPTIONS, cache=True)(_over_time)
    return compiled


def _instance(parameters: Mapping[str, npt.ArrayLike]) -> Record:
    """A prepared record of `RIGID_BODY` with some parameters changed; KeyError or ValueError say what does not fit."""
    data = RIGID_BODY.new()
    for name, value in parameters.items():
        variable = RIGID_BODY.variable(name)
        if variable.causality != "parameter":
            names = ", ".join(v.name for v in RIGID_BODY.variables if v.causality == "parameter")
            raise KeyError(f"{name!r} is no parameter of the rigid-body model; it has {names}")
        data[name] = np.broadcast_to(np.asarray(value, dtype=np.float64), variable.shape)
    s = record(data)
    status = _rigid_init(s)
    if status:
        raise ValueError(RIGID_BODY.message(status, s, 0.0))
    return s


def inverse_dynamics(
    q: npt.ArrayLike,
    qd: npt.ArrayLike,
    qdd: npt.ArrayLike,
    f_T_B: npt.ArrayLike = 0.0,
    m_T_B: npt.ArrayLike = 0.0,
    **parameters: Any,
) -> FloatArray:
    """Axis torques [..., 6] N m (axis side, no friction) of a motion given as arrays.

    q, qd, qdd: [..., 6] rad, rad/s, rad/s2, of equal shape or broadcast; `f_T_B`, `m_T_B`: [..., 3] N, N m at T.
    Any parameter of `RIGID_BODY` can be given by name, for instance ``payload_mass=200.0``.
    Divide by ``KR300_DYNAMICS.gear_ratio`` for motor torques.
    """
    arrays = [np.asarray(a, dtype=np.float64) for a in (q, qd, qdd)]
    wrench = [np.asarray(a, dtype=np.float64) for a in (f_T_B, m_T_B)]
    for name, array, width in zip(("q", "qd", "qdd", "f_T_B", "m_T_B"), [*arrays, *wrench], (6, 6, 6, 3, 3), strict=True):
        if array.ndim and array.shape[-1] not in (1, width):
            raise ValueError(f"{name}: has shape {array.shape}, expected [..., {width}]")
    leading = np.broadcast_shapes(
        *(np.broadcast_shapes(a.shape, (6,))[:-1] for a in arrays), *(np.broadcast_shapes(w.shape, (3,))[:-1] for w in wrench)
    )
    flat = [np.ascontiguousarray(np.broadcast_to(a, (*leading, 6)).reshape(-1, 6)) for a in arrays]
    load_ = [np.ascontiguousarray(np.broadcast_to(w, (*leading, 3)).reshape(-1, 3)) for w in wrench]
    tau = np.empty_like(flat[0])
    _compiled_over_time()(_instance(parameters), *flat, *load_, tau)
    return tau.reshape(*leading, 6)


def mass_matrix(q: npt.ArrayLike, rotors: bool = True, **parameters: Any) -> FloatArray:
    """Mass matrix [6,6] kg m2 at `q` [6] rad, axis side; without the rotors if told so.

    Column j is the torque of a unit acceleration of axis j without gravity and at rest.
    """
    off: dict[str, Any] = {"gravity_B": 0.0, "counterbalance_lever": 0.0, **({} if rotors else {"rotor_inertia": 0.0}), **parameters}
    return inverse_dynamics(np.broadcast_to(np.asarray(q, dtype=np.float64), (6, 6)), 0.0, np.eye(6), **off).T
