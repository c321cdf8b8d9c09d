"""Component tridexel_milling_force: cutting force of a tilted flat, bull nose or ball nose end mill on a workpiece of tri-dexels.

Per step: place the tool in the workpiece frame P, find in the middle of the step which part of the cutter's envelope has material
before it, cut into elements of height and angle, sum the edge forces over them and over the rotation, then take the cutter's body out
of the tri-dexels. Ports as `milling_force` (docs/components/tridexel_milling_force.md).
"""

from __future__ import annotations

import math
from dataclasses import replace

from robomill.models.components.milling_force import MODEL as MILLING
from robomill.models.maths.elementary import sincos
from robomill.models.maths.frames import cross, dot, mat_t_vec, mat_vec, normalise, quat_to_matrix
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.model.table_access import cell
from robomill.models.process import tool_table, tridexels
from robomill.models.process.cutting import MAX_TEETH, tooth_radii
from robomill.models.process.tridexel_engagement import BINS, DISCS, TWO_PI
from robomill.models.process.tridexel_force import cutting_force
from robomill.models.process.tridexel_stock import box, finest, lay_out

MOST_SUBSTEPS = 96
"""Instants per step at which the peak is looked for, at most."""
LEAST_TURN = 1e-9
"""A spindle that turns less than this in a step [rad] stands."""
SPACING = 2.5e-4
"""Default distance of the lines [m]: 16 MB for 200 x 150 x 30 mm."""
CORNERS = ("number", "corner_radius")
"""T number and corner radius [m]: a row of the table `corners`."""


def _scratch(name: str, description: str, unit: str = "1", shape: tuple[int, ...] = (), start: float = 0.0) -> Variable:
    return Variable(name, "state", description, unit, shape, start)


def _count(name: str, description: str, shape: tuple[int, ...] = ()) -> Variable:
    return Variable(name, "state", description, kind="integer", shape=shape)


_OWN = (
    "spacing",
    "substeps",
    "stock_error",
    "engagement_error",
    "spindle_start_angle",
    "cutting_length",
)
_WITHOUT = ("spring_back_loss",)
"""What belongs to the lagging height field, which the tri-dexels do not have."""
_SHARED = tuple(v for v in MILLING.variables if v.causality != "state" and v.name not in (*_OWN, *_WITHOUT))

VARIABLES = (
    *_SHARED,
    Variable(
        "stock",
        "parameter",
        "triangles of the closed surface of the stock: three corners in P, in m; empty: a block of block_size",
        shape=(tridexels.COLUMNS,),
        kind="table",
    ),
    Variable(
        "corners", "parameter", "corner radii of the tools that are not flat: T number, radius in m", shape=(len(CORNERS),), kind="table"
    ),
    Variable(
        "spacing", "parameter", "largest distance of lines of dexels; the cells fill the stock exactly", "m", start=SPACING, minimum=1e-5
    ),
    Variable(
        "segments", "parameter", "intervals that a line of dexels has room for at first", kind="integer", start=2, minimum=1, maximum=64
    ),
    Variable(
        "corner_radius",
        "parameter",
        "radius of the rounded corner of the cutter: 0 flat, half of the diameter ball nose",
        "m",
        minimum=0.0,
        display_unit="mm",
    ),
    replace(MILLING.variable("cutting_length"), description="length of the cutting edges along the axis; a deeper engagement is an error"),
    Variable(
        "substeps",
        "parameter",
        "instants per step at which f_peak is looked for (the mean does not depend on it)",
        kind="integer",
        start=24,
        minimum=1,
        maximum=MOST_SUBSTEPS,
    ),
    Variable("spindle_start_angle", "parameter", "angle of tooth 1 at the start, clockwise from +y of T", "rad", display_unit="deg"),
    replace(
        MILLING.variable("stock_error"), description="extra height of the stock above its nominal top; a stock from triangles is raised"
    ),
    replace(
        MILLING.variable("engagement_error"), description="extra stock on each of the four side faces of the block; not with triangles"
    ),
    _scratch("R_BP", "rotation of P in B", shape=(3, 3)),
    _scratch("R_BT", "rotation of T in B", shape=(3, 3)),
    _scratch("p_PT_P", "tool tip relative to the (yielding) workpiece, in P, at the end of the step", "m", (3,)),
    _scratch("p_last", "the same at its beginning", "m", (3,)),
    _scratch("p_mid", "the same in its middle", "m", (3,)),
    _scratch("axis", "unit vector from tip to spindle in P at the end of the step", shape=(3,)),
    _scratch("axis_last", "the same at its beginning", shape=(3,)),
    _scratch("axis_mid", "the same in its middle", shape=(3,)),
    _scratch("side", "y axis of T in P at the end of the step", shape=(3,)),
    _scratch("side_last", "the same at its beginning", shape=(3,)),
    _scratch("side_mid", "the same in its middle, normal to axis_mid", shape=(3,)),
    _scratch("ahead", "unit vector of the feed across the tool axis in P", shape=(3,)),
    _scratch("left", "unit vector to its left", shape=(3,)),
    _scratch("swing", "angular velocity of the tool axis in P", "rad/s", (3,)),
    _scratch("v_P", "feed velocity in P, mean over the step", "m/s", (3,)),
    _scratch("v_way", "way of the tool relative to the workpiece in P over the duration of the step", "m/s", (3,)),
    _scratch("v_now", "commanded feed velocity in P at the end of the step", "m/s", (3,)),
    _scratch("v_last", "the same at its beginning", "m/s", (3,)),
    _scratch("f_P", "mean force of the last step in P", "N", (3,)),
    _scratch("m_P", "mean moment of the last step in P", "N.m", (3,)),
    _scratch("spindle_angle", "angle of tooth 1, clockwise from +y of T", "rad"),
    _scratch("contact_share", "share of the end face that bites", "1"),
    _count("imprinted", "1 when the stock has been cut with the tool at p_last"),
    _count("tool_now", "T number of the tool that the following fields describe"),
    _scratch("mill_diameter", "its diameter", "m"),
    _scratch("mill_corner", "its corner radius", "m"),
    _count("mill_teeth", "its number of teeth"),
    _scratch("mill_helix", "its helix angle", "rad"),
    _scratch("mill_cutting_length", "length of its cutting edges", "m"),
    Variable("tool_numbers", "state", "T numbers of the tool table, 0 behind the last", shape=(tool_table.SHOWN,), kind="integer"),
    Variable("tool_row", "state", "values of a row of the tool table, for the message", shape=(len(tool_table.COLUMNS),)),
    _count("cells", "cells along x, y, z of P", (3,)),
    _scratch("origin", "lower corner of the box of the stock in P", "m", (3,)),
    _scratch("pitch", "size of a cell", "m", (3,)),
    _scratch("extent", "size of the box", "m", (3,)),
    _scratch("tick", "unit of the ends of intervals", "m"),
    _scratch("finest_spacing", "finest spacing that fits the capacity", "m"),
    _scratch("chip", "feed per tooth", "m"),
    _scratch("removed", "height of material met by the last cut above the tip, and volume that the lines along x, y, z lost", "1", (4,)),
    _scratch("point", "a point of a line", "m", (3,)),
    _scratch("radii", "deviation of the radius of each tooth", "m", (MAX_TEETH,)),
    _scratch("bound_sine", "sine of the bounds of the bins", shape=(BINS + 1,)),
    _scratch("bound_cosine", "cosine of the bounds", shape=(BINS + 1,)),
    _scratch("bin_sine", "sine of the middle of the bins", shape=(BINS,)),
    _scratch("bin_cosine", "cosine of the middle of the bins", shape=(BINS,)),
    _scratch("bin_depth", "height of material before the edges, per bin", "m", (BINS,)),
    _count("discs", "elements along the profile"),
    _scratch("level", "bounds of the elements: height, radius, sine and cosine of the normal against the axis", shape=(DISCS + 1, 4)),
    _scratch("middle", "the same in the middle of the elements", shape=(DISCS, 4)),
    _scratch("edge", "length of the edge in an element along the profile", "m", (DISCS,)),
    _scratch(
        "lower", "how far the material reaches beyond the edge at the lower bound of an element, per bound of a bin", "m", (BINS + 1,)
    ),
    _scratch("upper", "the same at its upper bound", "m", (BINS + 1,)),
    _scratch("engaged", "share of the element that is in material, per bound of a bin", shape=(BINS + 1,)),
    _scratch("share", "share of the element that is in material, per bin", shape=(BINS,)),
    _scratch("density", "force and moment in P of an edge, per bin of an element", shape=(BINS, 6)),
    _scratch("sums", "their sums up to the bounds of the bins", shape=(BINS + 1, 6)),
    _scratch("instant", "force at the sub-steps", "N", (MOST_SUBSTEPS, 3)),
    _count("pool", "the workpiece: intervals of the lines of dexels", (tridexels.CAPACITY,)),
)

ERRORS = (
    "",
    "a parameter is out of bounds: diameter {diameter} m, spacing {spacing} m, block_size {block_size} m, contact_zone {contact_zone} m "
    "and size_reference {size_reference} m must be positive, substeps {substeps} from 1 to 96, segments {segments} at least 1, "
    "teeth {teeth} from 1 to 12; correct the parameter",
    "quat_BP {quat_BP} is not of unit length; give w, x, y, z of a rotation, for instance 1, 0, 0, 0",
    "the stock of {extent} m needs room for more than the 2097152 intervals available at a spacing of {spacing} m and {segments} "
    "segments; use a spacing of {finest_spacing:.6f} m or more, fewer segments, or a smaller stock",
    "at t = {t} s an input is not finite: p_BT_B {p_BT_B} m, quat_BT {quat_BT}, v_BT_B {v_BT_B} m/s, spindle_speed {spindle_speed} rad/s; "
    "check the component that feeds it",
    "at t = {t} s spindle_speed is {spindle_speed} rad/s; expected 0 or more: "
    "the cutter is right-hand and turns clockwise (M3); check the program",
    "the corner radius {mill_corner} m is more than half of the diameter {mill_diameter} m of tool T{tool_now}; "
    "a ball nose has half of the diameter, a flat end mill 0",
    "at t = {t} s the feed per tooth is {chip:.6f} m, more than the radius of the cutter (diameter {mill_diameter} m); "
    "the spindle ({spindle_speed} rad/s) is too slow for the feed",
    "at t = {t} s material reaches {depth:.6f} m above the tool tip along its axis, more than the cutting edges ({mill_cutting_length} m); "
    "the shank would hit: cut less deep, tilt the tool otherwise or use a longer one",
    "the step size must be positive",
    "the table 'tools' has a row with number {tool_row[0]:g}, diameter {tool_row[1]:g} m, {tool_row[2]:g} teeth, "
    "helix {tool_row[3]:g} rad, cutting length {tool_row[4]:g} m; expected a whole number of 1 or more that no row before has, "
    "1 to 12 teeth, a helix from 0 to 1.2 rad and lengths above zero; correct that row",
    "at t = {t} s tool T{tool} is not in the table 'tools', which has {tool_numbers}; add it there or correct the program",
    "at t = {t} s tool T{tool} (diameter {mill_diameter} m) stands {depth:.6f} m deep in material when it comes into the spindle; "
    "change it clear of the workpiece",
    "a line through the stock goes into it and not out again: the surface of the triangles is not closed; mend the mesh",
    "at t = {t} s the workpiece has more walls than the 2097152 intervals available hold at a spacing of {spacing} m; use a larger spacing",
    "engagement_error {engagement_error} m cannot be given to a stock of triangles; it is for blocks",
)
_BAD_PARAMETER, _BAD_QUATERNION, _TOO_MANY_CELLS, _NOT_FINITE, _REVERSE, _BAD_CORNER, _CHIP_TOO_THICK, _TOO_DEEP, _BAD_STEP = range(1, 10)
_BAD_TOOL, _NO_TOOL, _TOOL_IN_MATERIAL, _NOT_CLOSED, _NO_ROOM, _NO_BLOCK = range(10, 16)


def init(s: Record) -> int:
    """Fresh stock, spindle at its start angle, no force; a tool that stands in the stock has cut its place already."""
    status = _prepare(s)
    if status != 0:
        return status
    status = _fill(s)
    if status != 0:
        return status
    _forget(s)
    _clear(s)
    if not _finite(s):
        return _NOT_FINITE
    status = _take_tool(s)
    if status != 0:
        return status
    _place(s)
    mat_t_vec(s.R_BP, s.v_BT_B, s.v_now)
    _carry(s)
    s.imprinted = 1
    for i in range(4):
        s.removed[i] = 0.0
    if not _cut_at(s, s.p_PT_P, s.axis):
        return _NO_ROOM
    for i in range(4):
        s.removed[i] = 0.0
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Force while the tool moves from its last pose to the given one within h [s]; then the cut itself."""
    if not h > 0.0:
        return _BAD_STEP
    if not _finite(s):
        return _NOT_FINITE
    if s.spindle_speed < 0.0:
        return _REVERSE
    _clear(s)
    if s.tool != s.tool_now:
        status = _change_tool(s)
        if status != 0:
            return status
    _place(s)
    _means(s, h)
    turn = s.spindle_speed * h
    near = _near(s)
    for i in range(3):
        s.f_P[i] = 0.0
        s.m_P[i] = 0.0
    if near and turn > LEAST_TURN:
        status = _sweep(s) if cutting_force(s, turn, h) else _CHIP_TOO_THICK
        if status != 0:
            return status
    else:
        s.contact_share = 0.0
    # with the spindle off nothing is cut, so the next cut cannot rely on what the tool has passed
    s.imprinted = 1 if turn > LEAST_TURN or not near else 0
    mat_vec(s.R_BP, s.f_P, s.f_T_B)
    mat_vec(s.R_BP, s.m_P, s.m_T_B)
    angle = s.spindle_angle + turn
    s.spindle_angle = angle - TWO_PI * math.floor(angle / TWO_PI)
    _carry(s)
    return 0


# ---------------------------------------------------------------- where the tool is
@kernel
def _place(s: Record) -> None:
    """Tip and axes of the tool in P. The workpiece yields to the force on it, -f, so the tool is C f further from it."""
    for i in range(3):
        s.p_PT_P[i] = s.p_BT_B[i] - s.p_BP_B[i]
    mat_t_vec(s.R_BP, s.p_PT_P, s.p_PT_P)
    quat_to_matrix(s.quat_BT, s.R_BT)
    for i in range(3):
        s.p_PT_P[i] += s.workpiece_compliance * s.f_P[i]
        s.axis[i] = -s.R_BT[i, 0]
        s.side[i] = s.R_BT[i, 1]
    mat_t_vec(s.R_BP, s.axis, s.axis)
    mat_t_vec(s.R_BP, s.side, s.side)


@kernel
def _carry(s: Record) -> None:
    """The end of this step is the beginning of the next."""
    for i in range(3):
        s.p_last[i] = s.p_PT_P[i]
        s.axis_last[i] = s.axis[i]
        s.side_last[i] = s.side[i]
        s.v_last[i] = s.v_now[i]


@kernel
def _means(s: Record, h: float) -> None:
    """Pose in the middle of the step and mean velocities over it, from their values at its ends: of second order."""
    mat_t_vec(s.R_BP, s.v_BT_B, s.v_now)
    for i in range(3):
        s.p_mid[i] = 0.5 * (s.p_last[i] + s.p_PT_P[i])
        s.v_way[i] = (s.p_PT_P[i] - s.p_last[i]) / h
        s.v_P[i] = s.v_way[i] if s.actual_feed != 0 else 0.5 * (s.v_last[i] + s.v_now[i])
        s.axis_mid[i] = s.axis_last[i] + s.axis[i]
        s.side_mid[i] = s.side_last[i] + s.side[i]
    normalise(s.axis_mid)
    along = dot(s.axis_mid, s.side_mid)
    for i in range(3):
        s.side_mid[i] -= along * s.axis_mid[i]
        s.point[i] = (s.axis[i] - s.axis_last[i]) / h
    normalise(s.side_mid)
    cross(s.axis_mid, s.point, s.swing)


@kernel
def _near(s: Record) -> bool:
    """Whether the cutter can meet the stock in this step: the box of the cutter in the middle of the step, grown by its way."""
    way = 0.0
    for i in range(3):
        way += abs(s.p_PT_P[i] - s.p_last[i]) + s.mill_cutting_length * abs(s.axis[i] - s.axis_last[i])
    grown = 0.5 * s.mill_diameter + 0.5 * way + 2.0 * max(s.pitch[0], s.pitch[1], s.pitch[2]) + s.contact_zone
    for i in range(3):
        s.point[i] = s.p_mid[i] - (grown - 0.5 * s.mill_diameter) * s.axis_mid[i]
    for i in range(3):
        first, last = tridexels.shadow(i, s.cells, s.origin, s.pitch, s.point, s.axis_mid, grown)
        if first > last:
            return False
    return True


# ---------------------------------------------------------------- the cut
@kernel
def _cut_at(s: Record, tip: FloatArray, axis: FloatArray) -> bool:
    """Take the cutter out of the stock; False if the pool is full."""
    return tridexels.cut(
        s.pool, s.cells, s.origin, s.pitch, s.tick, s.segments, tip, axis, 0.5 * s.mill_diameter, s.mill_corner, s.point, s.removed
    )


@kernel
def _sweep(s: Record) -> int:
    """Take out of the stock what the cutter fills in this step. Returns a status."""
    done = tridexels.sweep(
        s.pool,
        s.cells,
        s.origin,
        s.pitch,
        s.tick,
        s.segments,
        s.p_last,
        s.axis_last,
        s.p_PT_P,
        s.axis,
        s.imprinted == 1,
        0.5 * s.mill_diameter,
        s.mill_corner,
        s.mill_cutting_length,
        s.ahead,
        s.left,
        s.point,
        s.removed,
    )
    if not done:
        return _NO_ROOM
    if s.removed[0] > s.mill_cutting_length:
        s.depth = s.removed[0]
        return _TOO_DEEP
    return 0


# ---------------------------------------------------------------- before the first step
@kernel
def _prepare(s: Record) -> int:
    """Check the parameters; lay out box, cells and bins. Returns a status."""
    if not (s.diameter > 0.0 and s.spacing > 0.0 and s.contact_zone > 0.0 and s.size_reference > 0.0):
        return _BAD_PARAMETER
    if not (s.block_size[0] > 0.0 and s.block_size[1] > 0.0 and s.block_size[2] > 0.0):
        return _BAD_PARAMETER
    if s.teeth < 1 or s.teeth > MAX_TEETH or s.substeps < 1 or s.substeps > MOST_SUBSTEPS or s.segments < 1:
        return _BAD_PARAMETER
    q = s.quat_BP
    length2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if not (length2 > 0.999999 and length2 < 1.000001):
        return _BAD_QUATERNION
    quat_to_matrix(s.quat_BP, s.R_BP)
    if s.stock_rows > 0 and s.engagement_error != 0.0:
        return _NO_BLOCK
    box(s)
    longest = 0.0
    for i in range(3):
        if not s.extent[i] > 0.0:
            return _BAD_PARAMETER
        longest = max(longest, s.extent[i])
    s.tick = longest / tridexels.TICKS
    if not lay_out(s, s.spacing):
        s.finest_spacing = finest(s)
        return _TOO_MANY_CELLS
    s.finest_spacing = 0.0
    for i in range(tool_table.SHOWN):
        s.tool_numbers[i] = 0
    for k in range(len(tool_table.COLUMNS)):
        s.tool_row[k] = 0.0
    for i in range(int(s.tools_rows)):
        for k in range(len(tool_table.COLUMNS)):
            s.tool_row[k] = tool_table.number(s.tools_at, s.tools_rows, i, k)
        if not tool_table.sound(s.tools_at, s.tools_rows, i):
            return _BAD_TOOL
        if i < tool_table.SHOWN:
            s.tool_numbers[i] = int(s.tool_row[tool_table.NUMBER])
    for b in range(BINS + 1):
        s.bound_sine[b], s.bound_cosine[b] = sincos(TWO_PI * b / BINS)
    for b in range(BINS):
        s.bin_sine[b], s.bin_cosine[b] = sincos(TWO_PI * (b + 0.5) / BINS)
    return 0


@kernel
def _fill(s: Record) -> int:
    """Fill the lines with the stock. Returns a status."""
    tridexels.clear(s.pool, s.cells, s.segments)
    if s.stock_rows == 0:
        tridexels.fill_box(s.pool, s.cells, s.pitch, s.tick, s.segments)
        return 0
    found = tridexels.fill_solid(s.pool, s.cells, s.origin, s.pitch, s.tick, s.segments, s.stock_at, s.stock_rows, s.stock_error)
    if found != 0:
        tridexels.clear(s.pool, s.cells, s.segments)
    return 0 if found == 0 else (_NO_ROOM if found == 1 else _NOT_CLOSED)


@kernel
def _take_tool(s: Record) -> int:
    """Put the tool of the input into the spindle: its dimensions and the radii of its teeth."""
    s.tool_now = s.tool
    s.mill_diameter = s.diameter
    s.mill_corner = s.corner_radius
    s.mill_teeth = s.teeth
    s.mill_helix = s.helix
    s.mill_cutting_length = s.cutting_length
    if s.tool != 0 and s.tools_rows > 0:
        row = tool_table.find(s.tools_at, s.tools_rows, s.tool)
        if row < 0:
            return _NO_TOOL
        s.mill_diameter = tool_table.number(s.tools_at, s.tools_rows, row, tool_table.DIAMETER)
        s.mill_teeth = int(tool_table.number(s.tools_at, s.tools_rows, row, tool_table.TEETH))
        s.mill_helix = tool_table.number(s.tools_at, s.tools_rows, row, tool_table.HELIX)
        s.mill_cutting_length = tool_table.number(s.tools_at, s.tools_rows, row, tool_table.CUTTING_LENGTH)
        s.mill_corner = 0.0
        for i in range(int(s.corners_rows)):
            if int(cell(s.corners_at, s.corners_rows, len(CORNERS), i, 0)) == s.tool:
                s.mill_corner = cell(s.corners_at, s.corners_rows, len(CORNERS), i, 1)
    if not (s.mill_corner >= 0.0 and s.mill_corner <= 0.5 * s.mill_diameter * (1.0 + 1e-9)):
        return _BAD_CORNER
    s.mill_corner = min(s.mill_corner, 0.5 * s.mill_diameter)
    for j in range(MAX_TEETH):
        s.radii[j] = 0.0
    tooth_radii(s.mill_teeth, s.runout, s.runout_angle, s.radii)
    return 0


@kernel
def _change_tool(s: Record) -> int:
    """Another tool where the last one stood, the spindle going on at its angle; an error if there is material in its place."""
    status = _take_tool(s)
    if status != 0:
        return status
    s.contact_share = 0.0
    s.imprinted = 0
    # along the axis: a tool in a hole of its own diameter is in none
    spacing = max(s.pitch[0], s.pitch[1], s.pitch[2])
    height = s.mill_corner + spacing
    while height < s.mill_cutting_length:
        gap = tridexels.distance(
            s.pool,
            s.cells,
            s.origin,
            s.pitch,
            s.tick,
            s.segments,
            s.p_last[0] + height * s.axis_last[0],
            s.p_last[1] + height * s.axis_last[1],
            s.p_last[2] + height * s.axis_last[2],
        )
        if gap > 0.0:
            s.depth = height
        height += spacing
    return _TOOL_IN_MATERIAL if s.depth > 0.0 else 0


@kernel
def _forget(s: Record) -> None:
    """Set every state that nothing else sets to its start, scratch included: no trace of an earlier run."""
    s.spindle_angle = s.spindle_start_angle - TWO_PI * math.floor(s.spindle_start_angle / TWO_PI)
    s.contact_share = 0.0
    s.chip = 0.0
    s.discs = 0
    for i in range(3):
        s.f_P[i] = 0.0
        s.m_P[i] = 0.0
        s.v_P[i] = 0.0
        s.v_way[i] = 0.0
        s.p_mid[i] = 0.0
        s.axis_mid[i] = 0.0
        s.side_mid[i] = 0.0
        s.ahead[i] = 0.0
        s.left[i] = 0.0
        s.swing[i] = 0.0
        s.point[i] = 0.0
    for b in range(BINS):
        s.bin_depth[b] = 0.0
        s.share[b] = 0.0
        for i in range(6):
            s.density[b, i] = 0.0
    for b in range(BINS + 1):
        s.lower[b] = 0.0
        s.upper[b] = 0.0
        s.engaged[b] = 0.0
        for i in range(6):
            s.sums[b, i] = 0.0
    for n in range(DISCS + 1):
        for i in range(4):
            s.level[n, i] = 0.0
            if n < DISCS:
                s.middle[n, i] = 0.0
        if n < DISCS:
            s.edge[n] = 0.0
    for k in range(MOST_SUBSTEPS):
        for i in range(3):
            s.instant[k, i] = 0.0


@kernel
def _clear(s: Record) -> None:
    """Set all outputs to zero."""
    for i in range(3):
        s.f_T_B[i] = 0.0
        s.m_T_B[i] = 0.0
    s.f_peak = 0.0
    s.spindle_torque = 0.0
    s.spindle_power = 0.0
    s.removal_rate = 0.0
    s.depth = 0.0


@kernel
def _finite(s: Record) -> bool:
    """Whether all inputs are finite."""
    zero = 0.0 * s.spindle_speed
    for i in range(3):
        zero += 0.0 * s.p_BT_B[i] + 0.0 * s.v_BT_B[i]
    for i in range(4):
        zero += 0.0 * s.quat_BT[i]
    finite: bool = zero == 0.0
    return finite


MODEL = Model(
    name="tridexel_milling_force",
    description="Mechanistic force of a tilted flat, bull nose or ball nose end mill on a tri-dexel workpiece that it really cuts",
    variables=VARIABLES,
    init=init,
    step=step,
    errors=ERRORS,
)
