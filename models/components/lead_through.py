"""Component lead_through: the robot is led by hand, and what it goes through are the guiding points of a program.

Pan et al. 2008 (paper 003), section 3.1: the released directions are force controlled, the orientation follows a joystick::

    v = (F_hand + F_contact) / D        in the released directions, not faster than `speed_limit`
    w = rate of the joystick
    q' = J(q)^-1 [v; w]

Against a part of stiffness k the loop through transport and drive is stable with its margin only for D >= k / 7.6 1/s (FACTS10 10.4).
So D changes from `damping` to `contact_damping` once the contact force passes `contact_force`, and back below half of it. The hand is
measured apart from the contact (a handle with a sensor of its own). Motion that would leave the axis limits is not made.

Hand and joystick come from the table `operator` (held from row to row) or from the inputs; noise is added to the hand. A row
with teach = 1 teaches the pose at its time as a guiding point: `taught` counts them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from robomill.models.components.path_interpolator import Q_START
from robomill.models.maths.frames import matrix_to_quat, norm, solve
from robomill.models.maths.noise import normal_pair
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity
from robomill.models.model.table_access import cell, row_at
from robomill.models.robot.kinematics import ROBOT_VARIABLES, jacobian, tool_pose

COLUMNS = 8
"""Time, force of the hand, rate of the joystick, teach."""
_TEACH = 7
UNORDERED, SINGULAR = 1, 2
_FASTEST = 3.0
"""Rate [rad/s] of an axis that no motion by hand asks for away from singular postures: the limit of the quickest robots' main axes."""


@dataclass(frozen=True)
class LeadThrough:
    """Constants of the hand guiding, from a file in models/data/control."""

    damping: float = field(metadata=quantity("N.s/m", 1.0))
    contact_damping: float = field(metadata=quantity("N.s/m", 1.0))
    contact_force: float = field(metadata=quantity("N", 0.0))
    speed_limit: float = field(metadata=quantity("m/s", 0.0))
    hand_noise: float = field(metadata=quantity("N", 0.0))


LEAD = load(LeadThrough, "control/lead_through")


@kernel
def _operator(s: Record, row: int, column: int) -> float:
    """A number of the table."""
    return cell(s.operator_at, s.operator_rows, COLUMNS, row, column)


@kernel
def _hand(s: Record, t: float) -> None:
    """Set s.force [N] and s.rate [rad/s] of hand and joystick at time t, and count the points taught by then."""
    for i in range(3):
        s.force[i] = s.f_hand_B[i]
        s.rate[i] = s.joystick_B[i]
    if s.operator_rows > 0 and t >= _operator(s, 0, 0):
        row = row_at(s.operator_at, s.operator_rows, COLUMNS, t, int(s.row))
        while s.row < row or (s.row == row and s.begun == 0):
            if s.begun != 0:
                s.row += 1
            s.begun = 1
            if _operator(s, int(s.row), _TEACH) != 0.0:
                s.taught += 1
        for i in range(3):
            s.force[i] += _operator(s, row, 1 + i)
            s.rate[i] += _operator(s, row, 4 + i)
    if s.hand_noise > 0.0:
        x, y = normal_pair(int(s.seed), int(s.counter), 0)
        z, _ = normal_pair(int(s.seed), int(s.counter), 1)
        s.force[0] += s.hand_noise * x
        s.force[1] += s.hand_noise * y
        s.force[2] += s.hand_noise * z


@kernel
def _pose(s: Record) -> None:
    """Pose that is commanded."""
    tool_pose(s, s.q, s.p_BT_B, s.R_BT)
    matrix_to_quat(s.R_BT, s.quat_BT)


def init(s: Record) -> int:
    """Standing at q_start, nothing taught."""
    for row in range(int(s.operator_rows) - 1):
        if _operator(s, row + 1, 0) <= _operator(s, row, 0):
            s.row = row
            return UNORDERED
    s.row = 0
    s.begun = 0
    s.taught = 0
    s.counter = 0
    s.contact = 0
    s.speed = 0.0
    for i in range(6):
        s.q[i] = s.q_start[i]
        s.q_ref[i] = s.q_start[i]
        s.correction_q[i] = 0.0
    _pose(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """One cycle: the hand of now, the contact of now, a step of the axes."""
    s.counter += 1
    _hand(s, t + h)
    touch = norm(s.f_T_B)
    if touch > s.contact_force:
        s.contact = 1
    elif touch < 0.5 * s.contact_force:
        s.contact = 0
    damping = s.contact_damping if s.contact != 0 else s.damping
    for i in range(3):
        s.velocity[i] = s.released[i] * (s.force[i] + s.f_T_B[i]) / damping
        s.velocity[3 + i] = s.released[3 + i] * s.rate[i]
    s.speed = math.sqrt(s.velocity[0] * s.velocity[0] + s.velocity[1] * s.velocity[1] + s.velocity[2] * s.velocity[2])
    if s.speed > s.speed_limit:
        for i in range(3):
            s.velocity[i] *= s.speed_limit / s.speed
        s.speed = s.speed_limit
    jacobian(s, s.q, s.J)
    if solve(s.J, s.velocity, s.dq, 6) != 0:
        return SINGULAR
    inside = True
    for i in range(6):
        if abs(s.dq[i]) > _FASTEST:
            return SINGULAR
        q = s.q[i] + h * s.dq[i]
        if q < s.q_min[i] or q > s.q_max[i]:
            inside = False
    if inside:
        for i in range(6):
            s.q[i] += h * s.dq[i]
            s.correction_q[i] = s.q[i] - s.q_start[i]
    _pose(s)
    return 0


MODEL = Model(
    name="lead_through",
    description="Robot led by hand, joystick for the orientation: guiding points (Pan et al. 2008, section 3.1)",
    variables=(
        Variable("f_hand_B", "input", "Force of the hand on the tool, beside that of the table", "N", (3,)),
        Variable("joystick_B", "input", "Rate of turn that the joystick asks for, beside that of the table", "rad/s", (3,)),
        Variable("f_T_B", "input", "Contact force on the tool at T", "N", (3,)),
        Variable("q_ref", "output", "Axis angles A1..A6 at the start", "rad", (6,), display_unit="deg", depends_on=()),
        Variable("correction_q", "output", "Way of the axes since", "rad", (6,), display_unit="deg"),
        Variable("p_BT_B", "output", "Commanded position of the tool tip", "m", (3,), display_unit="mm"),
        Variable("quat_BT", "output", "Commanded orientation of the tool", "1", (4,), (1, 0, 0, 0), -1.0, 1.0),
        Variable("speed", "output", "Commanded speed of the tool tip", "m/s", display_unit="mm/s"),
        Variable("contact", "output", "In contact: the admittance has fallen", kind="boolean"),
        Variable("taught", "output", "Guiding points taught so far", kind="integer"),
        Variable(
            "operator", "parameter", "Rows: time [s], force [N] in B, rate [rad/s] in B, teach (0 or 1)", "1", (COLUMNS,), kind="table"
        ),
        Variable("released", "parameter", "1: released, 0: held; x, y, z, then turns about them, in B", "1", (6,), 1.0, 0.0, 1.0),
        Variable("damping", "parameter", "Force over speed in the free", "N.s/m", (), LEAD.damping, 1.0),
        Variable("contact_damping", "parameter", "Force over speed in contact: k / 7.6 1/s", "N.s/m", (), LEAD.contact_damping, 1.0),
        Variable("contact_force", "parameter", "Contact force above which the admittance falls", "N", (), LEAD.contact_force, 0.0),
        Variable("speed_limit", "parameter", "Largest speed of the tool tip", "m/s", (), LEAD.speed_limit, 0.0, display_unit="mm/s"),
        Variable("hand_noise", "parameter", "Noise of the hand, one sigma per sample and direction", "N", (), LEAD.hand_noise, 0.0),
        Variable("seed", "parameter", "Seed of that noise", start=1, minimum=0, maximum=2147483647, kind="integer"),
        Variable("q_start", "parameter", "Axis angles A1..A6 at the start", "rad", (6,), Q_START, display_unit="deg"),
        Variable("q", "state", "Commanded axis angles", "rad", (6,)),
        Variable("row", "state", "Row of the table", kind="integer"),
        Variable("begun", "state", "The time has come to the first row", kind="integer"),
        Variable("counter", "state", "Samples since the start", kind="integer"),
        Variable("force", "state", "Force of the hand", "N", (3,)),
        Variable("rate", "state", "Rate of the joystick", "rad/s", (3,)),
        Variable("velocity", "state", "Scratch: velocity and rate of turn", "1", (6,)),
        Variable("dq", "state", "Scratch: rates of the axes", "rad/s", (6,)),
        Variable("J", "state", "Scratch: Jacobian", "1", (6, 6)),
        Variable("R_BT", "state", "Scratch: orientation", "1", (3, 3)),
        *ROBOT_VARIABLES,
    ),
    init=init,
    step=step,
    errors=(
        "",
        "the times of the table 'operator' do not increase from row {row} (counted from zero) to the next",
        "t = {t:.3f} s: the robot stands in a singular posture, A5 = {q[4]:.4f} rad, and cannot be led in every direction: start "
        "elsewhere (q_start), or lead around it",
    ),
)
