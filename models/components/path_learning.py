"""Component path_learning: hybrid position and force control, normal to a guiding path, and the record of where the tool really was.

Pan et al. 2008 (paper 003), section 3.2. Path frame: x_p along the planned feed, y_p normal to it and to the tool axis, towards the part.
In every other direction the robot stays under position control. In y_p the correction of the planned path integrates::

    F' = 2 pi f_c (F_y - F)         force filter, first order, on the contact force F_y against y_p
    x' = g (F_d - F)                admittance; x is a vector in B, so that it goes on where the guiding path turns

The measured pose is that of the encoders, the nominal kinematics at `q_motor`: what a robot controller records every 4 ms.

Protective actions: until the part is touched for the first time (with `wait_for_contact` whenever contact is lost) the feed creeps;
above `force_limit` the feed stands until the force is back at F_d, and where that takes longer than `limit_time` the run ends
with an error, as it does where the correction has searched for the part over `search_limit` without contact.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from robomill.models.maths.elementary import PI, exp
from robomill.models.maths.frames import cross, dot, mat_vec, matrix_to_quat, norm
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity
from robomill.models.robot.kinematics import ROBOT_VARIABLES, tool_pose

SEARCHING, FOLLOWING, HOLDING = 0, 1, 2
LOST, TOO_STRONG = 1, 2
_STANDING = 1e-9
"""Feed [m/s] below which the path has no direction; the frame stays as it was."""


@dataclass(frozen=True)
class ForceControl:
    """Constants of the force control, from a file in models/data/control."""

    gain: float = field(metadata=quantity("m/(N.s)", 0.0))
    desired_force: float = field(metadata=quantity("N", 0.0))
    filter_frequency: float = field(metadata=quantity("Hz", 0.0))
    contact_force: float = field(metadata=quantity("N", 0.0))
    force_limit: float = field(metadata=quantity("N", 0.0))
    limit_time: float = field(metadata=quantity("s", 0.0))
    search_limit: float = field(metadata=quantity("m", 0.0))
    creep: float = field(metadata=quantity("1", 0.0, 1.0))


CONTROL = load(ForceControl, "control/path_learning")


@kernel
def _measure(s: Record) -> None:
    """Measured pose, force in B, path frame and the force against the approach, from the inputs."""
    tool_pose(s, s.q_motor, s.p_BT_B, s.R_BT)
    matrix_to_quat(s.R_BT, s.quat_BT)
    mat_vec(s.R_BT, s.f_T_T, s.f_T_B)
    speed = norm(s.v_BT_B)
    if speed > _STANDING:
        for i in range(3):
            s.work[i] = -s.side * s.R_BT[i, 0]  # away from the tool's tip: with side = 1, y_p is on the left of the feed
        cross(s.work, s.v_BT_B, s.direction)
        length = norm(s.direction)
        if length > _STANDING * speed:
            for i in range(3):
                s.approach_B[i] = s.direction[i] / length
    s.normal_force = -dot(s.f_T_B, s.approach_B)


@kernel
def _decide(s: Record, h: float) -> int:
    """Set s.phase and the speed ratio from the filtered force; a status where no protective action helps."""
    touching = s.filtered_force > s.contact_force
    s.contact = 1 if touching else 0
    if s.filtered_force > s.force_limit:
        s.phase = HOLDING
    elif (s.phase == HOLDING and s.filtered_force <= s.desired_force) or (s.phase == SEARCHING and touching):
        s.phase = FOLLOWING
    elif s.phase == FOLLOWING and not touching and s.wait_for_contact != 0:
        s.phase = SEARCHING
    s.held_time = s.held_time + h if s.phase == HOLDING else 0.0
    s.speed_ratio = s.creep if s.phase == SEARCHING else (0.0 if s.phase == HOLDING else 1.0)
    if s.held_time > s.limit_time:
        return TOO_STRONG
    if touching:
        s.searched = 0.0
    if s.searched > s.search_limit:
        return LOST
    return 0


def init(s: Record) -> int:
    """No correction; the feed creeps until the part is found."""
    for i in range(3):
        s.correction_B[i] = 0.0
        s.approach_B[i] = 0.0
    s.filtered_force = 0.0
    s.held_time = 0.0
    s.searched = 0.0
    s.phase = SEARCHING
    _measure(s)
    return _decide(s, 0.0)


def step(s: Record, t: float, h: float) -> int:
    """One cycle: measure, filter, integrate the correction, decide about the feed."""
    _measure(s)
    s.filtered_force += (1.0 - exp(-2.0 * PI * s.filter_frequency * h)) * (s.normal_force - s.filtered_force)
    way = s.gain * (s.desired_force - s.filtered_force) * h
    for i in range(3):
        s.correction_B[i] += way * s.approach_B[i]
    s.searched += abs(way) * norm(s.approach_B)
    return _decide(s, h)


MODEL = Model(
    name="path_learning",
    description="Hybrid position and force control along a guiding path, and its record (Pan et al. 2008, section 3.2)",
    variables=(
        Variable("f_T_T", "input", "Measured force on the tool at T, in T", "N", (3,)),
        Variable("q_motor", "input", "Axis angles A1..A6 that the encoders show", "rad", (6,), display_unit="deg"),
        Variable("v_BT_B", "input", "Commanded feed velocity of the tool tip", "m/s", (3,), display_unit="mm/s"),
        Variable("correction_B", "output", "Correction of the planned position", "m", (3,), display_unit="mm"),
        Variable("p_BT_B", "output", "Measured position of the tool tip", "m", (3,), depends_on=("q_motor",), display_unit="mm"),
        Variable("quat_BT", "output", "Measured orientation of the tool", "1", (4,), (1, 0, 0, 0), -1.0, 1.0, depends_on=("q_motor",)),
        Variable("f_T_B", "output", "Measured force on the tool, in B", "N", (3,), depends_on=("f_T_T", "q_motor")),
        Variable("normal_force", "output", "Measured contact force normal to the path", "N"),
        Variable("filtered_force", "output", "Contact force that the control sees", "N"),
        Variable("speed_ratio", "output", "Feed override", "1", (), 0.0, 0.0, 1.0),
        Variable("contact", "output", "The part is touched", kind="boolean"),
        Variable("phase", "output", "0 searching, 1 following, 2 feed held above the force limit", minimum=0, maximum=2, kind="integer"),
        Variable("gain", "parameter", "Speed of the correction per force, g", "m/(N.s)", (), CONTROL.gain, 0.0),
        Variable("desired_force", "parameter", "Contact force F_d", "N", (), CONTROL.desired_force, 0.0),
        Variable("filter_frequency", "parameter", "Cut-off of the force filter", "Hz", (), CONTROL.filter_frequency, 0.01),
        Variable(
            "side",
            "parameter",
            "+1: the part is on the left of the feed, seen against the tool axis; -1: on the right",
            "1",
            (),
            1.0,
            -1.0,
            1.0,
        ),
        Variable(
            "contact_force", "parameter", "Filtered force above which the part counts as touched", "N", (), CONTROL.contact_force, 0.0
        ),
        Variable("wait_for_contact", "parameter", "Let the feed creep whenever contact is lost, not only at the start", kind="boolean"),
        Variable("creep", "parameter", "Speed ratio while the part is searched", "1", (), CONTROL.creep, 0.0, 1.0),
        Variable("force_limit", "parameter", "Filtered force above which the feed stands", "N", (), CONTROL.force_limit, 0.0),
        Variable("limit_time", "parameter", "Time for which the feed may stand", "s", (), CONTROL.limit_time, 0.0),
        Variable(
            "search_limit",
            "parameter",
            "Longest way of the correction without contact",
            "m",
            (),
            CONTROL.search_limit,
            0.0,
            display_unit="mm",
        ),
        Variable("approach_B", "state", "Unit vector y_p towards the part", "1", (3,)),
        Variable("direction", "state", "Scratch: its direction", "m/s", (3,)),
        Variable("held_time", "state", "Time for which the feed has stood", "s"),
        Variable("searched", "state", "Way of the correction since the last contact", "m"),
        Variable("work", "state", "Scratch", "1", (3,)),
        Variable("R_BT", "state", "Scratch: measured orientation", "1", (3, 3)),
        *ROBOT_VARIABLES,
    ),
    init=init,
    step=step,
    errors=(
        "",
        "contact lost: at t = {t:.3f} s the search has gone {searched:.4f} m without contact (search_limit {search_limit} m), the force is "
        "{filtered_force:.2f} N, expected more than {contact_force} N: check side = {side:.0f}, teach guiding points nearer to the part, "
        "or raise search_limit",
        "force limit exceeded: at t = {t:.3f} s the force is {filtered_force:.1f} N, more than {desired_force} N for {held_time:.3f} s "
        "after it passed force_limit = {force_limit} N, and the feed stands: teach guiding points further from the part, "
        "or check gain = {gain:.3g} m/(N s) against the stiffness of the contact (docs/explanation/path_learning.md)",
    ),
)
