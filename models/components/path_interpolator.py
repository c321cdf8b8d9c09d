"""Path interpolator: plays a planned program and gives the pose, axis angles, feed velocity and pilot force.

The planner (`models.planning.trajectory`) has done the work: a row of the segment table holds the time law of the path coordinate
and the shape and orientation over it (Englert 2011, chapter 4). Here the path time runs with the speed ratio, the row of
the moment is looked up and evaluated, and the axis angles follow in closed form (FACTS 1.6).
"""

from __future__ import annotations

import math

import numpy as np

from robomill.models.maths.elementary import sincos
from robomill.models.maths.frames import quat_to_matrix
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.model.table_access import cell, row_at
from robomill.models.planning.double_s import profile
from robomill.models.planning.path_geometry import line
from robomill.models.planning.segment_table import (
    ACCELERATION,
    AXIS_1,
    AXIS_2,
    BLOCK,
    COLUMNS,
    F_1,
    F_2,
    GEOMETRY,
    GEOMETRY_COLUMNS,
    JERK,
    KIND,
    LINE,
    POLYNOMIAL,
    QUAT,
    SIGMA,
    SPEED,
    SPINDLE,
    TAU,
    TOOL,
)
from robomill.models.robot.kinematics import ROBOT_VARIABLES, inverse

PILOT_COLUMNS = 4
"""Columns of the pilot table: path time [s], force [N] in B."""
_DEG = math.pi / 180.0
_ANY_ANGLE = 1e3
"""Limit [rad] that stands for none."""
_LARGE_MOVE = 0.5
"""Axis move [rad] in one step from which on the branch is checked; another shoulder, elbow or wrist is farther away."""


@kernel
def segment(s: Record, row: int, column: int) -> float:
    """A number of the segment table."""
    return cell(s.segments_at, s.segments_rows, COLUMNS, row, column)


@kernel
def pilot(s: Record, row: int, column: int) -> float:
    """A number of the pilot table."""
    return cell(s.pilot_at, s.pilot_rows, PILOT_COLUMNS, row, column)


@kernel
def _unordered(address: int, rows: int, columns: int) -> int:
    """The first row of a table whose number in column 0 is not above that of the row before; 0 if all increase."""
    for row in range(1, rows):
        if not cell(address, rows, columns, row, 0) > cell(address, rows, columns, row - 1, 0):
            return row
    return 0


@kernel
def override(s: Record) -> float:
    """Path time per time: the speed ratio, times what the machine makes of it."""
    ratio: float = s.speed_ratio * (1.0 + s.override_error)
    return ratio


@kernel
def advance(s: Record, h: float) -> None:
    """Let the path time run by `override` times h [s], not beyond the end.

    Compensated summation (Kahan 1965): the path time after n steps has the error of one addition, so that equal times
    mean equal positions whatever the step.
    """
    step = override(s) * h - s.path_time_carry
    total = s.path_time + step
    s.path_time_carry = (total - s.path_time) - step
    end = segment(s, int(s.segments_rows) - 1, TAU)
    if total >= end:
        total = end
        s.path_time_carry = 0.0
    s.path_time = total


@kernel
def locate(s: Record) -> int:
    """Row of the segment table at the path time; looked for from the last one found."""
    s.row = row_at(s.segments_at, s.segments_rows, COLUMNS, s.path_time, int(s.row))
    return int(s.row)


@kernel
def position(s: Record, row: int, sigma: float, speed: float) -> None:
    """Set p_BT_B [m] and v_BT_B [m/s] from the shape of a row at the path coordinate sigma [m] and its rate [m/s]."""
    if int(segment(s, row, KIND)) == POLYNOMIAL:
        for i in range(3):
            c = GEOMETRY + 6 * i
            p = segment(s, row, c + 5)
            d = 0.0
            for k in range(4, -1, -1):
                d = d * sigma + p
                p = p * sigma + segment(s, row, c + k)
            s.p_BT_B[i] = p
            s.v_BT_B[i] = d * speed
        return
    rate = segment(s, row, GEOMETRY + 12)
    sin, cos = sincos(rate * sigma)
    for i in range(3):
        e1 = segment(s, row, GEOMETRY + 3 + i)
        e2 = segment(s, row, GEOMETRY + 6 + i)
        climb = segment(s, row, GEOMETRY + 9 + i)
        s.p_BT_B[i] = segment(s, row, GEOMETRY + i) + cos * e1 + sin * e2 + sigma * climb
        s.v_BT_B[i] = (rate * (cos * e2 - sin * e1) + climb) * speed


@kernel
def turn(s: Record, row: int, axis: int, f: int, sigma: float) -> None:
    """Multiply quat_BT from the right by the rotation about the axis in column `axis` by the quintic in column `f` at sigma."""
    if segment(s, row, axis) == 0.0 and segment(s, row, axis + 1) == 0.0 and segment(s, row, axis + 2) == 0.0:
        return
    angle = segment(s, row, f + 5)
    for k in range(4, -1, -1):
        angle = angle * sigma + segment(s, row, f + k)
    sin, c = sincos(0.5 * angle)
    x = sin * segment(s, row, axis)
    y = sin * segment(s, row, axis + 1)
    z = sin * segment(s, row, axis + 2)
    q0, q1, q2, q3 = s.quat_BT[0], s.quat_BT[1], s.quat_BT[2], s.quat_BT[3]
    s.quat_BT[0] = q0 * c - q1 * x - q2 * y - q3 * z
    s.quat_BT[1] = q0 * x + q1 * c + q2 * z - q3 * y
    s.quat_BT[2] = q0 * y - q1 * z + q2 * c + q3 * x
    s.quat_BT[3] = q0 * z + q1 * y - q2 * x + q3 * c


@kernel
def pilot_force(s: Record) -> None:
    """Set f_pilot_B [N]: the pilot table at path time + lead time, linear in between, its end values outside, 0 if it is empty."""
    n = int(s.pilot_rows)
    if n == 0:
        for i in range(3):
            s.f_pilot_B[i] = 0.0
        return
    t = s.path_time + s.lead_time
    row = max(min(row_at(s.pilot_at, n, PILOT_COLUMNS, t, int(s.pilot_row)), n - 2), 0)
    s.pilot_row = row
    share = 0.0
    if n > 1:
        span = pilot(s, row + 1, 0) - pilot(s, row, 0)
        if span > 0.0:
            share = min(max((t - pilot(s, row, 0)) / span, 0.0), 1.0)
    for i in range(3):
        f = pilot(s, row, 1 + i)
        s.f_pilot_B[i] = f if share == 0.0 else f + share * (pilot(s, row + 1, 1 + i) - f)


@kernel
def unlimited(s: Record) -> None:
    """Set q_free: the solution nearest to q_ref if axes had no limits."""
    for i in range(6):
        s.limits_kept[0, i] = s.q_min[i]
        s.limits_kept[1, i] = s.q_max[i]
        s.q_min[i] = -_ANY_ANGLE
        s.q_max[i] = _ANY_ANGLE
    inverse(s, s.p_BT_B, s.R_BT, s.q_ref, s.q_free)
    for i in range(6):
        s.q_min[i] = s.limits_kept[0, i]
        s.q_max[i] = s.limits_kept[1, i]


@kernel
def note_axis(s: Record) -> None:
    """Note for the message the axis of q_free that exceeds its limits most, in degrees."""
    worst = -math.inf
    for i in range(6):
        excess = max(s.q_min[i] - s.q_free[i], s.q_free[i] - s.q_max[i])
        if excess > worst:
            worst = excess
            s.fault_axis = i + 1
            s.fault_deg[0] = s.q_free[i] / _DEG
            s.fault_deg[1] = s.q_min[i] / _DEG
            s.fault_deg[2] = s.q_max[i] / _DEG


@kernel
def follow(s: Record, anywhere: bool) -> int:
    """Set q_ref to the axis angles of p_BT_B and quat_BT; 0, or 2, 3 as in `MODEL.errors`.

    `anywhere`: any branch inside the limits will do, the nearest to q_ref is taken. Else the axes must get there on the branch
    they are on: where that one ends at a limit, another one would be a jump.
    """
    quat_to_matrix(s.quat_BT, s.R_BT)
    status = inverse(s, s.p_BT_B, s.R_BT, s.q_ref, s.q_next)
    if status == 1:
        return 2
    if status == 2:
        unlimited(s)
        note_axis(s)
        return 3
    far = False
    for i in range(6):
        if abs(s.q_next[i] - s.q_ref[i]) > _LARGE_MOVE:
            far = True
    if far and not anywhere:
        unlimited(s)
        for i in range(6):
            if abs(s.q_next[i] - s.q_free[i]) > _LARGE_MOVE:
                note_axis(s)
                return 3
    for i in range(6):
        s.q_ref[i] = s.q_next[i]
    return 0


@kernel
def evaluate(s: Record, anywhere: bool) -> int:
    """All outputs at the path time; status as in `MODEL.errors`. `anywhere`: see `follow`."""
    row = locate(s)
    t = s.path_time - segment(s, row, TAU)
    v0 = segment(s, row, SPEED)
    a0 = segment(s, row, ACCELERATION)
    jerk = segment(s, row, JERK)
    sigma = segment(s, row, SIGMA) + t * (v0 + t * (0.5 * a0 + t * jerk / 6.0))
    speed = v0 + t * (a0 + t * jerk * 0.5)
    position(s, row, sigma, speed * override(s))
    for i in range(4):
        s.quat_BT[i] = segment(s, row, QUAT + i)
    turn(s, row, AXIS_1, F_1, sigma)
    turn(s, row, AXIS_2, F_2, sigma)
    if s.quat_BT[0] < 0.0:
        for i in range(4):
            s.quat_BT[i] = -s.quat_BT[i]
    s.spindle_speed = segment(s, row, SPINDLE)
    s.block = int(segment(s, row, BLOCK))
    s.tool = int(segment(s, row, TOOL))
    s.finished = 1 if row == int(s.segments_rows) - 1 else 0
    pilot_force(s)
    s.fault_line = int(segment(s, row, LINE))
    return follow(s, anywhere)


def init(s: Record) -> int:
    """Stand at the beginning of the path; the axis angles are the solution nearest to q_start."""
    s.path_time = 0.0
    s.path_time_carry = 0.0
    s.row = 0
    s.pilot_row = 0
    s.fault_axis = 0
    s.fault_line = 0
    for i in range(3):
        s.fault_deg[i] = 0.0
    for i in range(6):
        s.q_ref[i] = s.q_start[i]
    if s.segments_rows == 0:
        return 1
    if not 0.0 <= s.speed_ratio <= 1.5:
        return 4
    s.row = _unordered(s.segments_at, int(s.segments_rows), COLUMNS)
    if s.row > 0:
        s.path_time = segment(s, int(s.row), TAU)
        return 5
    s.pilot_row = _unordered(s.pilot_at, int(s.pilot_rows), PILOT_COLUMNS)
    if s.pilot_row > 0:
        s.path_time = pilot(s, int(s.pilot_row), 0)
        return 6
    return evaluate(s, True)


def step(s: Record, t: float, h: float) -> int:
    """Path time on by `override` times h [s]; the outputs are those at t + h."""
    if s.segments_rows == 0:
        return 1
    if not 0.0 <= s.speed_ratio <= 1.5:
        return 4
    advance(s, h)
    return evaluate(s, False)


def default_segments() -> FloatArray:
    """Table of the built-in program: a 100 mm line along x at 25 mm/s near validation position 4 of FACTS 1.7, 13 000 rev/min."""
    shape = line(np.array([1.545, -0.018, 1.099]), np.array([1.645, -0.018, 1.099]))
    row = np.zeros(COLUMNS)
    row[[KIND, BLOCK, LINE, SPINDLE]] = POLYNOMIAL, 10, 1, 13000.0 * math.pi / 30.0
    row[GEOMETRY : GEOMETRY + GEOMETRY_COLUMNS] = shape.row()[1]
    # tool (x of T) down, z of T along x of B
    row[QUAT : QUAT + 4] = math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0
    rows = []
    for phase in profile([(shape.length, 0.025)], 1.0, 10.0):
        row[[TAU, SIGMA, SPEED, ACCELERATION, JERK]] = phase.time, phase.path, phase.speed, phase.acceleration, phase.jerk
        rows.append(row.copy())
    row[[TAU, SIGMA, SPEED, ACCELERATION, JERK]] = phase.time + phase.duration, shape.length, 0.0, 0.0, 0.0
    return np.array([*rows, row])


Q_START = tuple(_DEG * angle for angle in (0.65, -96.07, 122.56, 0.0, -26.49, 0.0))
"""Axis angles [rad] of position 4 of FACTS 1.7."""

_RATIO = ("speed_ratio",)

MODEL = Model(
    name="path_interpolator",
    description="Plays a planned tool path: pose, axis angles, feed velocity, pilot force (Englert 2011, chapter 4)",
    variables=(
        Variable("speed_ratio", "input", "Feed override: path time per time", "1", start=1.0, minimum=0.0, maximum=1.5),
        Variable("p_BT_B", "output", "Planned position of the tool tip", "m", (3,), display_unit="mm", depends_on=_RATIO),
        Variable(
            "quat_BT",
            "output",
            "Planned orientation of the tool, quaternion (w, x, y, z)",
            "1",
            (4,),
            (1, 0, 0, 0),
            -1.0,
            1.0,
            depends_on=_RATIO,
        ),
        Variable("q_ref", "output", "Planned axis angles A1..A6", "rad", (6,), display_unit="deg", depends_on=_RATIO),
        Variable("v_BT_B", "output", "Commanded feed velocity of the tool tip", "m/s", (3,), display_unit="mm/s", depends_on=_RATIO),
        Variable("f_pilot_B", "output", "Offline force on the tool, lead_time ahead on the path", "N", (3,), depends_on=_RATIO),
        Variable("spindle_speed", "output", "Commanded spindle speed", "rad/s", display_unit="rpm", depends_on=_RATIO),
        Variable("block", "output", "Block (N) number of the program, its line where it has none", kind="integer", depends_on=_RATIO),
        Variable("tool", "output", "Number of the tool in the spindle, 0 = none named", kind="integer", depends_on=_RATIO),
        Variable("path_time", "output", "Time along the path at speed ratio 1", "s", depends_on=_RATIO),
        Variable("finished", "output", "The path has come to its end", kind="boolean", depends_on=_RATIO),
        Variable(
            "lead_time",
            "parameter",
            "How far on the path the pilot force is ahead (40 ms: Haehn & Weigold 2020, Fig. 3)",
            "s",
            (),
            0.040,
            0.0,
            1.0,
        ),
        Variable(
            "q_start",
            "parameter",
            "Axis angles near the start of the path: they choose the branch",
            "rad",
            (6,),
            Q_START,
            display_unit="deg",
        ),
        Variable(
            "segments",
            "parameter",
            "Planned path, made by `robomill plan`: see models/planning/segment_table.py",
            "1",
            (COLUMNS,),
            kind="table",
        ),
        Variable(
            "pilot",
            "parameter",
            "Offline force on the tool: path time in s, force in B in N; may be empty",
            "1",
            (PILOT_COLUMNS,),
            kind="table",
        ),
        Variable(
            "override_error",
            "parameter",
            "Effect: relative error of the feed override: the machine runs at 1 + this times the speed ratio",
            "1",
            (),
            0.0,
            -0.5,
            0.5,
            effect=True,
        ),
        Variable("path_time_carry", "state", "Rounding of the path time, carried on", "s"),
        Variable("row", "state", "Row of the segment table", kind="integer"),
        Variable("pilot_row", "state", "Row of the pilot table", kind="integer"),
        Variable("R_BT", "state", "Scratch: planned orientation of the tool", "1", (3, 3)),
        Variable("q_next", "state", "Scratch: new axis angles", "rad", (6,)),
        Variable("q_free", "state", "Scratch: axis angles if there were no limits", "rad", (6,)),
        Variable("limits_kept", "state", "Scratch: axis limits while they are taken away", "rad", (2, 6)),
        Variable("fault_axis", "state", "Axis beyond its limits, for the message", kind="integer"),
        Variable("fault_line", "state", "Line of the program now played, for the message", kind="integer"),
        Variable("fault_deg", "state", "Angle and limits of that axis in degrees, for the message", "1", (3,)),
        *ROBOT_VARIABLES,
    ),
    init=init,
    step=step,
    errors=(
        "",
        "the segment table is empty; expected at least one row; plan a program and name its table as parameter 'segments'",
        "path time {path_time:.3f} s, block {block} (line {fault_line}): the tool tip cannot reach "
        "({p_BT_B[0]:.4f}, {p_BT_B[1]:.4f}, {p_BT_B[2]:.4f}) m in B with quaternion "
        "({quat_BT[0]:.4f}, {quat_BT[1]:.4f}, {quat_BT[2]:.4f}, {quat_BT[3]:.4f}); move the workpiece closer or turn the tool",
        "path time {path_time:.3f} s, block {block} (line {fault_line}): axis A{fault_axis} would be at {fault_deg[0]:.2f} deg, "
        "its limits are {fault_deg[1]:.1f} .. {fault_deg[2]:.1f} deg, "
        "for the tool tip at ({p_BT_B[0]:.4f}, {p_BT_B[1]:.4f}, {p_BT_B[2]:.4f}) m in B; "
        "move the workpiece, turn the tool about its axis, or start in another posture (q_start)",
        "speed_ratio is {speed_ratio}, expected 0 .. 1.5",
        "table 'segments', row {row} (counted from 0): its path time, {path_time:.9g} s, is not after that of the row before; expected "
        "times that increase, as `robomill plan` writes them",
        "table 'pilot', row {pilot_row} (counted from 0): its path time, {path_time:.9g} s, is not after that of the row before; expected "
        "times that increase: sort the record and drop repeated times",
    ),
    default_tables={"segments": default_segments()},
)
