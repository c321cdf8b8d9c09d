"""Component robot_compliance_dynamic: `robot_compliance` with inertia, damping and the motion of the axes.

Paper 004 (Englert 2011), Eqs. (2.1), (2.2): rigid bodies on the virtual joints of the robot, whose drives follow q_link. Springs bend
under the load on the tool and under the inertia of the bodies; what the moments of the springs then do to the tool tip, and the effects
on top, is `robot_compliance` to the letter. See docs/components/robot_compliance_dynamic.md.
"""

from __future__ import annotations

import math

from robomill.models.components.robot_compliance import ERRORS as STATIC_ERRORS
from robomill.models.components.robot_compliance import (
    STEP_STATUS,
    advance_mode,
    bend,
    check_inputs,
    check_parameters,
    load_moments,
    place_tip,
    rest,
)
from robomill.models.components.robot_compliance import VARIABLES as STATIC_VARIABLES
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.robot.dynamics import DYNAMICS_VARIABLES
from robomill.models.robot.elastic_bodies import (
    COORDINATES,
    ELASTIC_VARIABLES,
    couple_forces,
    elastic_coordinates,
    inertia_force,
    mass_matrix,
    place_bodies,
)
from robomill.models.robot.elastic_motion import MOTION_VARIABLES, advance, factorise
from robomill.models.robot.virtual_joints import DRIVES

_BODIES = ("body_mass", "body_com", "body_inertia", "payload_mass", "payload_com_F", "payload_inertia", "gravity_B")

VARIABLES = (
    *STATIC_VARIABLES,
    *(v for v in DYNAMICS_VARIABLES if v.name in _BODIES),
    Variable(
        "tilt_stiffness_error",
        "parameter",
        "Relative error of the tilt stiffness k_B, k_C of A1..A6: the actual stiffness is (1 + this) times the table",
        "1",
        (6,),
        minimum=-0.8,
        maximum=2.0,
        effect=True,
    ),
    Variable(
        "damping_error",
        "parameter",
        "Relative error of the damping of all virtual joints: the actual damping is (1 + this) times damping_time K",
        "1",
        (),
        minimum=-0.9,
        maximum=5.0,
        effect=True,
    ),
    Variable(
        "mode_frequency_error",
        "parameter",
        "Relative error of the natural frequencies: masses and inertias are 1/(1 + this)^2 times the table, springs as they are",
        "1",
        (),
        minimum=-0.5,
        maximum=1.0,
        effect=True,
    ),
    Variable(
        "motion_excitation",
        "parameter",
        "Share of the inertia of the moving axes that excites the springs: 1 as it is, 0 where q_link jumps from pose to pose",
        "1",
        (),
        1.0,
        0.0,
        1.0,
    ),
    Variable(
        "gravity_sag",
        "parameter",
        "Share of the weight that bends the springs: 0, as in robot_compliance, for a robot that is calibrated under its weight",
        "1",
        (),
        0.0,
        0.0,
        1.0,
    ),
    Variable("substep", "parameter", "Longest substep of the elastic motion", "s", (), 1e-3, 1e-5, 1.0, display_unit="ms"),
    *ELASTIC_VARIABLES,
    *MOTION_VARIABLES,
    Variable("q_before", "state", "Axis angles at the end of the last step", "rad", (6,)),
    Variable("axis_speed", "state", "Mean axis speeds of the last step", "rad/s", (6,)),
    Variable("axis_push", "state", "Accelerations at its beginning", "rad/s2", (6,)),
    Variable("still", "state", "Scratch: zeros", "rad/s", (6,)),
    Variable("own_force", "state", "Scratch: inertia force of the elastic rates alone", "N.m", (COORDINATES,)),
    Variable("push", "state", "Scratch: accelerations in the middle of the step", "rad/s2", (6,)),
)

ERRORS = (
    *STATIC_ERRORS,
    "the bodies of the robot weigh body_mass = {body_mass} kg, payload_mass = {payload_mass} kg with payload_error = {payload_error} kg; "
    "expected links of positive mass and a payload that is not negative: name a robot with a file in models/data/dynamics, or "
    '[robot] dynamics = "...", or take robot_compliance, which needs no masses',
    "M + g t D + (g t)^2 K is not positive definite at elastic coordinate {fault_frame} at t = {t} s; expected inertias of real bodies, "
    "dampings of at least zero: check body_inertia, payload_inertia and damping_time",
)
_MASS, _INDEFINITE = len(STATIC_ERRORS), len(STATIC_ERRORS) + 1


@kernel
def _springs(s: Record) -> None:
    """Elastic coordinates with the stiffness, damping and payload that the effects make of the table."""
    elastic_coordinates(s)
    s.elastic_payload += s.payload_error
    for k in range(s.elastic_count):
        j = s.elastic_joint[k]
        for i in range(6):
            if DRIVES[i] == j:
                if s.elastic_axis[k] == 2:
                    s.elastic_stiffness[k] *= 1.0 + s.stiffness_error[i]
                else:
                    s.elastic_stiffness[k] *= 1.0 + s.tilt_stiffness_error[i]
                    s.elastic_stiffness[k] /= 1.0 + s.tilt_compliance[i] * s.elastic_stiffness[k]
        s.elastic_damping[k] *= 1.0 + s.damping_error


@kernel
def _load(s: Record, push: FloatArray) -> None:
    """Fill s.elastic_load [N.m]: the load on the tool less the inertia of the axes, that pushes with `push` [rad/s2], and weight.

    Needs `load_moments`; leaves s.elastic_M as the mass matrix. Both change with the masses, so with mode_frequency_error.
    """
    mass = 1.0 / ((1.0 + s.mode_frequency_error) * (1.0 + s.mode_frequency_error))
    n = s.elastic_count
    place_bodies(s)
    # What the elastic rates do by themselves is of second order, as is the change of M with the elastic angles that goes with it: both
    # are left out, or the frozen M would not keep the energy.
    inertia_force(s, s.still, s.still, s.elastic_rate, 0.0)
    for k in range(n):
        s.elastic_load[k] = s.joint_moment[s.elastic_joint[k], s.elastic_axis[k]]
        s.own_force[k] = s.elastic_force[k]
    inertia_force(s, s.axis_speed, push, s.elastic_rate, s.gravity_sag)
    mass_matrix(s)
    couple_forces(s, s.elastic_load)
    for k in range(n):
        s.elastic_load[k] -= mass * (s.elastic_force[k] - s.own_force[k])
        for i in range(n):
            s.elastic_M[k, i] *= mass


@kernel
def _spring_moments(s: Record) -> None:
    """Put the moments of the bent springs into s.joint_moment [N.m], where `robot_compliance` has those of the load."""
    for k in range(s.elastic_count):
        s.joint_moment[s.elastic_joint[k], s.elastic_axis[k]] = s.elastic_stiffness[k] * s.elastic_angle[k]
    # a drive carries the joints that are coupled to its axis, and `drive_moment` adds them again
    for m in range(1, 6):
        i = 5 - m
        for j in range(i + 1, 6):
            if s.axis_coupling[j, i] != 0.0:
                s.joint_moment[DRIVES[i], 2] -= s.axis_sign[i] * s.axis_coupling[j, i] * s.joint_moment[DRIVES[j], 2]


@kernel
def _respond(s: Record, time: float) -> int:
    """Outputs at `time` [s] from the elastic angles; drives by the law of `robot_compliance`, all other springs as they are bent."""
    _spring_moments(s)
    status: int = bend(s)
    if status != 0:
        return status
    for k in range(s.elastic_count):
        j, c = s.elastic_joint[k], s.elastic_axis[k]
        drive = False
        for i in range(6):
            if DRIVES[i] == j and c == 2:
                drive = True
        if not drive:
            s.joint_angle[j, c] = s.elastic_angle[k]
    return int(place_tip(s, time))


def init(s: Record) -> int:
    """Outputs at t = 0: at rest in q_link, springs in equilibrium with the load."""
    status: int = check_parameters(s)
    if status == 0:
        status = check_inputs(s)
    if status != 0:
        return status
    for i in range(6):
        if not s.body_mass[i] > 0.0 or s.payload_mass + s.payload_error < 0.0:
            return _MASS
        s.q_before[i] = s.q_link[i]
        s.axis_speed[i] = 0.0
        s.axis_push[i] = 0.0
        s.push[i] = 0.0
        s.still[i] = 0.0
    rest(s)
    _springs(s)
    for k in range(s.elastic_count):
        s.elastic_rate[k] = 0.0
    load_moments(s)
    _load(s, s.push)
    for k in range(s.elastic_count):
        s.elastic_angle[k] = s.elastic_load[k] / s.elastic_stiffness[k]
    return _respond(s, 0.0)


@kernel
def _follow(s: Record, h: float) -> None:
    """Fill s.axis_speed and s.push: speed and acceleration of the axes in the middle of the step that ends in s.q_link.

    The second difference belongs to the beginning of the step; half a step of its change on top makes it second order.
    """
    for i in range(6):
        speed = (s.q_link[i] - s.q_before[i]) / h
        push = (speed - s.axis_speed[i]) / h
        s.push[i] = s.motion_excitation * (push + 0.5 * (push - s.axis_push[i]))
        s.q_before[i] = s.q_link[i]
        s.axis_speed[i] = speed
        s.axis_push[i] = push


def step(s: Record, t: float, h: float) -> int:
    """Outputs at t + h [s] for a load that was held over the step and axes that moved to q_link during it; any h > 0."""
    if not h > 0.0:
        s.fault_value = h
        return STEP_STATUS
    status: int = check_inputs(s)
    if status != 0:
        return status
    advance_mode(s, h)
    _follow(s, h)
    load_moments(s)
    _load(s, s.push)
    count = max(1, math.ceil(h / s.substep - 1e-9))
    coordinate = factorise(s, h / count)
    if coordinate != 0:
        s.fault_frame = coordinate
        return _INDEFINITE
    for _ in range(count):
        advance(s, h / count)
    return _respond(s, t + h)


MODEL = Model(
    name="robot_compliance_dynamic",
    description="Actual tool pose of a robot of rigid bodies on elastic virtual joints (Englert 2011, Eqs. 2.1, 2.2)",
    variables=VARIABLES,
    init=init,
    step=step,
    errors=ERRORS,
)
