"""A robot whose joints give way: displacement of the tool under a static load, from no stiffness that is known beforehand.

    d = J C J^T w,   C = diag(c_1 .. c_6) about the joints, with tilt t_i about the two axes across joint i beside it

by small angles: each elastic angle turns the tool about the origin of its frame. The nominal robot is rigid; the compliances are effects.
The angle of joint 3 is that of a controller which shows the forearm against the horizontal, where the geometry says so
(`axis_coupling`); the coupling counts by the share `pendant_coupling + coupling_error`, 1 as the geometry has it.
"""

from __future__ import annotations

import math

from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.robot.kinematics import ROBOT_VARIABLES, forward


@kernel
def _turn(s: Record, i: int, column: int, compliance: float) -> None:
    """Add to s.d_T_B what a compliance [rad/(N.m)] about an axis of frame `i` does under the load s.f_T_B, s.m_T_B."""
    x, y, z = s.link_R[i, 0, column], s.link_R[i, 1, column], s.link_R[i, 2, column]
    rx, ry, rz = s.link_p[6, 0] - s.link_p[i, 0], s.link_p[6, 1] - s.link_p[i, 1], s.link_p[6, 2] - s.link_p[i, 2]
    jx, jy, jz = y * rz - z * ry, z * rx - x * rz, x * ry - y * rx
    moment = jx * s.f_T_B[0] + jy * s.f_T_B[1] + jz * s.f_T_B[2] + x * s.m_T_B[0] + y * s.m_T_B[1] + z * s.m_T_B[2]
    s.d_T_B[0] += compliance * moment * jx
    s.d_T_B[1] += compliance * moment * jy
    s.d_T_B[2] += compliance * moment * jz


@kernel
def _displacement(s: Record) -> int:
    """Displacement s.d_T_B [m] at the inputs; status 1 where they are not finite."""
    for i in range(6):
        if not abs(s.q[i]) < math.inf:
            return 1
    for i in range(3):
        if not abs(s.f_T_B[i]) + abs(s.m_T_B[i]) < math.inf:
            return 1
        s.d_T_B[i] = s.base_compliance[i] * s.f_T_B[i]
    for i in range(6):
        s.angle[i] = s.q[i]
        for j in range(i):
            if s.axis_coupling[i, j] != 0.0:  # q -> angles that are coupled by the given share
                s.angle[i] += s.axis_sign[i] * (s.pendant_coupling + s.coupling_error - 1.0) * s.axis_coupling[i, j] * s.q[j]
    forward(s, s.angle)
    for i in range(6):
        if s.joint_compliance[i] != 0.0:
            _turn(s, i, 2, s.joint_compliance[i])
        if s.tilt_compliance[i] != 0.0:
            _turn(s, i, 0, s.tilt_compliance[i])
            _turn(s, i, 1, s.tilt_compliance[i])
    return 0


def init(s: Record) -> int:
    """Displacement at t = 0."""
    return int(_displacement(s))


def step(s: Record, t: float, h: float) -> int:
    """Displacement for pose and load at the inputs, which are those at t + h."""
    return int(_displacement(s))


def _effect(name: str, unit: str, shape: tuple[int, ...], minimum: float, maximum: float, description: str) -> Variable:
    return Variable(name, "parameter", f"Effect: {description}", unit, shape, 0.0, minimum, maximum, effect=True)


MODEL = Model(
    name="joint_compliance",
    description="Displacement of the tool of a robot with compliant joints under static loads",
    variables=(
        Variable("q", "input", "Axis angles as the controller shows them", "rad", (6,)),
        Variable("f_T_B", "input", "Force on the tool at T, in B", "N", (3,)),
        Variable("m_T_B", "input", "Moment on the tool about T, in B", "N.m", (3,)),
        Variable("d_T_B", "output", "Displacement of T, in B", "m", (3,), display_unit="mm"),
        Variable(
            "pendant_coupling", "parameter", "Share of axis_coupling that the shown angles are taken to have", "1", (), 1.0, -2.0, 2.0
        ),
        _effect("coupling_error", "1", (), -2.0, 2.0, "share of axis_coupling that the shown angles have beyond pendant_coupling"),
        _effect("joint_compliance", "rad/(N.m)", (6,), -1e-4, 1e-4, "compliance of joints 1..6 about their axes"),
        _effect("tilt_compliance", "rad/(N.m)", (6,), -1e-4, 1e-4, "compliance of joints 1..6 across their axes"),
        _effect("base_compliance", "m/N", (3,), -1e-4, 1e-4, "compliance of base and foundation along x, y, z of B"),
        *ROBOT_VARIABLES,
        Variable("angle", "state", "Axis angles that the geometry turns into joint angles", "rad", (6,)),
    ),
    init=init,
    step=step,
    errors=("", "an input is not finite at {t} s: q {q}, f_T_B {f_T_B}, m_T_B {m_T_B}; check the component that feeds it"),
)
