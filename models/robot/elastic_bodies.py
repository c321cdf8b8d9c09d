"""Rigid bodies on the virtual joints of a robot: elastic coordinates, mass matrix, inertia and weight forces.

Paper 004 (Englert 2011), Eqs. (2.1), (2.2) with the drives moved along q(t):

    M(q) x.. + C(q, q., x.) + M_xq(q) q.. + G(q) = -K x - D x. + S(F, q)

x are the elastic angles: every virtual joint of `virtual_joints` whose spring is not rigid, and all six drives. Seven bodies are
carried: links 1..6 and the payload in front of the springs of sensor, holder and tool. Elastic angles are small (a few mrad), so the
geometry is that of the rigid robot, x = 0; speeds are not neglected. Rotors stand still in this picture: they are on the other
side of the drive springs and move with q.

Everything is in B about its origin: a turn is the screw [p x e; e] of an axis e through p, and what a set of bodies weighs is its
mass, first moment and inertia, summed from the tool to the base (composite rigid bodies, Featherstone 2008, ch. 6).
"""

from __future__ import annotations

from robomill.models.model.declaration import FloatArray, Record, Variable, kernel
from robomill.models.robot.virtual_joints import DRIVES, JOINTS, joint_frame, joint_stiffness

COORDINATES = 3 * JOINTS
"""Most elastic coordinates that a robot can have."""
RIGID = 1e12
"""Stiffness [N.m/rad] from which a virtual joint is rigid: the load of a mill turns it by less than 1e-8 rad."""
BODIES = 7
"""Links 1..6 and the payload."""
FIRST_BODY = (0, 1, 1, 2, 2, 3, 4, 5, 6, 6, 6)
"""First body behind each virtual joint; it moves that one and all after it."""
LAST_JOINT = (0, 2, 4, 5, 6, 7, 10)
"""Last virtual joint in front of each body."""
DAMPING_TIME = 4e-4
"""Start of `damping_time` [s], as in the files of models/data/compliance."""

ELASTIC_VARIABLES: tuple[Variable, ...] = (
    Variable(
        "damping_time",
        "parameter",
        "Damping over stiffness of the virtual joints, rows and columns of stiffness: D = this times K",
        "s",
        (JOINTS, 3),
        DAMPING_TIME,
        0.0,
        1.0,
        display_unit="ms",
    ),
    Variable("elastic_count", "state", "Number of elastic coordinates", "1", kind="integer"),
    Variable("elastic_payload", "state", "Mass of the payload that is moved", "kg"),
    Variable("elastic_joint", "state", "Virtual joint of each elastic coordinate, from 0", "1", (COORDINATES,), kind="integer"),
    Variable("elastic_axis", "state", "Its axis: 0, 1, 2 = x, y, z of the frame", "1", (COORDINATES,), kind="integer"),
    Variable("elastic_drive", "state", "Coordinate of the drive of axes 1..6, from 0", "1", (6,), kind="integer"),
    Variable("elastic_stiffness", "state", "Stiffness K of the elastic coordinates", "N.m/rad", (COORDINATES,)),
    Variable("elastic_damping", "state", "Damping D of the elastic coordinates", "N.m.s/rad", (COORDINATES,)),
    Variable("elastic_M", "state", "Mass matrix of the elastic coordinates", "kg.m2", (COORDINATES, COORDINATES)),
    Variable("elastic_force", "state", "Inertia and weight that act against the elastic coordinates", "N.m", (COORDINATES,)),
    Variable("screw", "state", "Scratch: screws [p x e; e] of the elastic coordinates", "1", (COORDINATES, 6)),
    Variable("carried_mass", "state", "Scratch: mass of each body and those in front of it", "kg", (BODIES,)),
    Variable("carried_moment", "state", "Scratch: their first moment about the origin of B", "kg.m", (BODIES, 3)),
    Variable("carried_inertia", "state", "Scratch: their inertia about the origin of B: xx, yy, zz, xy, yz, xz", "kg.m2", (BODIES, 6)),
    Variable("joint_rate", "state", "Scratch: rates of the joints at the elastic coordinates", "rad/s", (COORDINATES,)),
    Variable("joint_push", "state", "Scratch: accelerations of the joints at the elastic coordinates", "rad/s2", (COORDINATES,)),
    Variable("body_motion", "state", "Scratch: velocity and acceleration of a body", "1", (2, 6)),
    Variable("carried_force", "state", "Scratch: force and moment about the origin of B of each body and those in front", "1", (BODIES, 6)),
)
"""Parameters and scratch of the kernels below, after `ROBOT_VARIABLES`, `COMPLIANCE_VARIABLES` and `DYNAMICS_VARIABLES`."""


@kernel
def elastic_coordinates(s: Record) -> None:
    """Choose the elastic coordinates, and set their K and D: all springs below `RIGID`, and the drives; call it from `init`.

    They stand in the order of the chain: from the base, in each joint about z, then y, then x, as `deflect` turns them.
    """
    n = 0
    for j in range(JOINTS):
        for turn in range(3):
            c = 2 - turn
            drive = False
            if c == 2:
                for i in range(6):
                    if DRIVES[i] == j:
                        drive = True
                        s.elastic_drive[i] = n
            if drive or joint_stiffness(s, j, c) < RIGID:
                s.elastic_joint[n] = j
                s.elastic_axis[n] = c
                s.elastic_stiffness[n] = joint_stiffness(s, j, c)
                s.elastic_damping[n] = s.damping_time[j, c] * s.elastic_stiffness[n]
                n += 1
    s.elastic_count = n
    s.elastic_payload = s.payload_mass


@kernel
def _set_screws(s: Record) -> None:
    """Fill s.screw from the frames that `virtual_joints` left: each coordinate alone, without what it turns in coupled axes."""
    for k in range(s.elastic_count):
        i = joint_frame(s.elastic_joint[k])
        c = s.elastic_axis[k]
        e0, e1, e2 = s.frame_R[i, 0, c], s.frame_R[i, 1, c], s.frame_R[i, 2, c]
        p0, p1, p2 = s.frame_p[i, 0], s.frame_p[i, 1], s.frame_p[i, 2]
        s.screw[k, 0] = p1 * e2 - p2 * e1
        s.screw[k, 1] = p2 * e0 - p0 * e2
        s.screw[k, 2] = p0 * e1 - p1 * e0
        s.screw[k, 3] = e0
        s.screw[k, 4] = e1
        s.screw[k, 5] = e2


@kernel
def _weigh(s: Record, b: int, r: int, mass: float, com: FloatArray, inertia: FloatArray) -> None:
    """Put body b into s.carried_*: its centre of gravity [m] and inertia [kg.m2] are given in link frame r."""
    r00, r01, r02 = s.link_R[r, 0, 0], s.link_R[r, 0, 1], s.link_R[r, 0, 2]
    r10, r11, r12 = s.link_R[r, 1, 0], s.link_R[r, 1, 1], s.link_R[r, 1, 2]
    r20, r21, r22 = s.link_R[r, 2, 0], s.link_R[r, 2, 1], s.link_R[r, 2, 2]
    x = s.link_p[r, 0] + r00 * com[0] + r01 * com[1] + r02 * com[2]
    y = s.link_p[r, 1] + r10 * com[0] + r11 * com[1] + r12 * com[2]
    z = s.link_p[r, 2] + r20 * com[0] + r21 * com[1] + r22 * com[2]
    xx, yy, zz, xy, yz, xz = inertia[0], inertia[1], inertia[2], inertia[3], inertia[4], inertia[5]
    # R I, then R I R^T
    a00, a01, a02 = r00 * xx + r01 * xy + r02 * xz, r00 * xy + r01 * yy + r02 * yz, r00 * xz + r01 * yz + r02 * zz
    a10, a11, a12 = r10 * xx + r11 * xy + r12 * xz, r10 * xy + r11 * yy + r12 * yz, r10 * xz + r11 * yz + r12 * zz
    a20, a21, a22 = r20 * xx + r21 * xy + r22 * xz, r20 * xy + r21 * yy + r22 * yz, r20 * xz + r21 * yz + r22 * zz
    s.carried_mass[b] = mass
    s.carried_moment[b, 0] = mass * x
    s.carried_moment[b, 1] = mass * y
    s.carried_moment[b, 2] = mass * z
    s.carried_inertia[b, 0] = a00 * r00 + a01 * r01 + a02 * r02 + mass * (y * y + z * z)
    s.carried_inertia[b, 1] = a10 * r10 + a11 * r11 + a12 * r12 + mass * (z * z + x * x)
    s.carried_inertia[b, 2] = a20 * r20 + a21 * r21 + a22 * r22 + mass * (x * x + y * y)
    s.carried_inertia[b, 3] = a00 * r10 + a01 * r11 + a02 * r12 - mass * x * y
    s.carried_inertia[b, 4] = a10 * r20 + a11 * r21 + a12 * r22 - mass * y * z
    s.carried_inertia[b, 5] = a00 * r20 + a01 * r21 + a02 * r22 - mass * x * z


@kernel
def place_bodies(s: Record) -> None:
    """Screws and each body by itself, in B, at the frames that `virtual_joints` left: for `inertia_force`, then `mass_matrix`."""
    _set_screws(s)
    for b in range(6):
        _weigh(s, b, b, s.body_mass[b], s.body_com[b], s.body_inertia[b])
    _weigh(s, 6, 5, s.elastic_payload, s.payload_com_F, s.payload_inertia)


@kernel
def _momentum(s: Record, b: int, v: FloatArray) -> tuple[float, float, float, float, float, float]:
    """Momentum and angular momentum about the origin of B of s.carried_* [b] that moves with the screw v = [velocity; turn]."""
    m = s.carried_mass[b]
    c0, c1, c2 = s.carried_moment[b, 0], s.carried_moment[b, 1], s.carried_moment[b, 2]
    xx, yy, zz = s.carried_inertia[b, 0], s.carried_inertia[b, 1], s.carried_inertia[b, 2]
    xy, yz, xz = s.carried_inertia[b, 3], s.carried_inertia[b, 4], s.carried_inertia[b, 5]
    v0, v1, v2, w0, w1, w2 = v[0], v[1], v[2], v[3], v[4], v[5]
    return (
        m * v0 + w1 * c2 - w2 * c1,
        m * v1 + w2 * c0 - w0 * c2,
        m * v2 + w0 * c1 - w1 * c0,
        c1 * v2 - c2 * v1 + xx * w0 + xy * w1 + xz * w2,
        c2 * v0 - c0 * v2 + xy * w0 + yy * w1 + yz * w2,
        c0 * v1 - c1 * v0 + xz * w0 + yz * w1 + zz * w2,
    )


@kernel
def mass_matrix(s: Record) -> None:
    """Fill s.elastic_M [kg.m2], n by n of s.elastic_count; needs `place_bodies`, whose bodies it sums up.

    M_ab = screw_a . (I screw_b), I the bodies in front of the one of both coordinates that is nearer to the tool.
    """
    for k in range(BODIES - 1):
        b = BODIES - 2 - k
        s.carried_mass[b] += s.carried_mass[b + 1]
        for c in range(3):
            s.carried_moment[b, c] += s.carried_moment[b + 1, c]
        for c in range(6):
            s.carried_inertia[b, c] += s.carried_inertia[b + 1, c]
    for k in range(s.elastic_count):
        h = _momentum(s, FIRST_BODY[s.elastic_joint[k]], s.screw[k])
        for a in range(k + 1):
            e = s.screw[a]
            value = e[0] * h[0] + e[1] * h[1] + e[2] * h[2] + e[3] * h[3] + e[4] * h[4] + e[5] * h[5]
            s.elastic_M[k, a] = value
            s.elastic_M[a, k] = value
    _couple_rows(s)


@kernel
def _couple_rows(s: Record) -> None:
    """Change s.elastic_M from turns of joints to turns of drives: a drive also turns the joints that are coupled to its axis."""
    for i in range(5):
        for m in range(i + 1, 6):
            if s.axis_coupling[m, i] != 0.0:
                share = s.axis_sign[i] * s.axis_coupling[m, i]
                a, b = s.elastic_drive[i], s.elastic_drive[m]
                for k in range(s.elastic_count):
                    s.elastic_M[a, k] += share * s.elastic_M[b, k]
                for k in range(s.elastic_count):
                    s.elastic_M[k, a] += share * s.elastic_M[k, b]


@kernel
def _joint_motion(s: Record, qd: FloatArray, qdd: FloatArray, rate: FloatArray) -> None:
    """Fill s.joint_rate and s.joint_push: those of the elastic coordinates, and of the axes on top, coupled ones included."""
    for k in range(s.elastic_count):
        s.joint_rate[k] = rate[k]
        s.joint_push[k] = 0.0
    for i in range(6):
        k = s.elastic_drive[i]
        s.joint_rate[k] += s.axis_sign[i] * qd[i]
        s.joint_push[k] += s.axis_sign[i] * qdd[i]
        for j in range(i):
            if s.axis_coupling[i, j] != 0.0:
                s.joint_rate[k] += s.axis_coupling[i, j] * (qd[j] + s.axis_sign[j] * rate[s.elastic_drive[j]])
                s.joint_push[k] += s.axis_coupling[i, j] * qdd[j]


@kernel
def inertia_force(s: Record, qd: FloatArray, qdd: FloatArray, rate: FloatArray, gravity: float) -> None:
    """Fill s.elastic_force [N.m]: C(q, q., x.) + M_xq q.. + gravity times G(q), by Newton and Euler; after `place_bodies` alone.

    qd [rad/s], qdd [rad/s2] of the axes, rate = x. [rad/s] of the elastic coordinates, gravity 0 or 1. From the base outwards
    V += s x., A += s x.. + V x s x. with V, A velocity and acceleration of the point of a body at the origin of B and its turn; the
    force of a body is I A + V x* I V, and a coordinate carries those in front of it.
    """
    _joint_motion(s, qd, qdd, rate)
    v0, v1, v2, w0, w1, w2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    a0, a1, a2 = -gravity * s.gravity_B[0], -gravity * s.gravity_B[1], -gravity * s.gravity_B[2]
    b0, b1, b2 = 0.0, 0.0, 0.0
    k = 0
    V = s.body_motion[0]
    A = s.body_motion[1]
    for b in range(BODIES):
        while k < s.elastic_count and s.elastic_joint[k] <= LAST_JOINT[b]:
            e = s.screw[k]
            r, push = s.joint_rate[k], s.joint_push[k]
            a0 += e[0] * push + r * (w1 * e[2] - w2 * e[1] + v1 * e[5] - v2 * e[4])
            a1 += e[1] * push + r * (w2 * e[0] - w0 * e[2] + v2 * e[3] - v0 * e[5])
            a2 += e[2] * push + r * (w0 * e[1] - w1 * e[0] + v0 * e[4] - v1 * e[3])
            b0 += e[3] * push + r * (w1 * e[5] - w2 * e[4])
            b1 += e[4] * push + r * (w2 * e[3] - w0 * e[5])
            b2 += e[5] * push + r * (w0 * e[4] - w1 * e[3])
            v0 += r * e[0]
            v1 += r * e[1]
            v2 += r * e[2]
            w0 += r * e[3]
            w1 += r * e[4]
            w2 += r * e[5]
            k += 1
        V[0], V[1], V[2], V[3], V[4], V[5] = v0, v1, v2, w0, w1, w2
        A[0], A[1], A[2], A[3], A[4], A[5] = a0, a1, a2, b0, b1, b2
        p = _momentum(s, b, V)
        f = _momentum(s, b, A)
        s.carried_force[b, 0] = f[0] + w1 * p[2] - w2 * p[1]
        s.carried_force[b, 1] = f[1] + w2 * p[0] - w0 * p[2]
        s.carried_force[b, 2] = f[2] + w0 * p[1] - w1 * p[0]
        s.carried_force[b, 3] = f[3] + w1 * p[5] - w2 * p[4] + v1 * p[2] - v2 * p[1]
        s.carried_force[b, 4] = f[4] + w2 * p[3] - w0 * p[5] + v2 * p[0] - v0 * p[2]
        s.carried_force[b, 5] = f[5] + w0 * p[4] - w1 * p[3] + v0 * p[1] - v1 * p[0]
    for i in range(BODIES - 1):
        b = BODIES - 2 - i
        for c in range(6):
            s.carried_force[b, c] += s.carried_force[b + 1, c]
    for k in range(s.elastic_count):
        g = s.carried_force[FIRST_BODY[s.elastic_joint[k]]]
        e = s.screw[k]
        s.elastic_force[k] = e[0] * g[0] + e[1] * g[1] + e[2] * g[2] + e[3] * g[3] + e[4] * g[4] + e[5] * g[5]
    couple_forces(s, s.elastic_force)


@kernel
def couple_forces(s: Record, force: FloatArray) -> None:
    """Change moments [N.m] on joints into those on drives, by virtual work: a drive also carries the joints coupled to its axis."""
    for i in range(5):
        for m in range(i + 1, 6):
            if s.axis_coupling[m, i] != 0.0:
                force[s.elastic_drive[i]] += s.axis_sign[i] * s.axis_coupling[m, i] * force[s.elastic_drive[m]]
