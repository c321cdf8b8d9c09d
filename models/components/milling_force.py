"""Component milling_force: cutting force from a workpiece that the deflected tool really cuts (docs/components/milling_force.md).

Per step: place the tool in the workpiece frame P, read from the dexels how deep material stands before the edges in the middle of
the step, integrate the edge forces over its rotation (closed form, no sub-steps in the mean), then cut the swept volume.
"""

from __future__ import annotations

import math

from robomill.models.maths.elementary import atan2, exp, power, sincos, tan
from robomill.models.maths.frames import mat_t_vec, mat_vec, quat_to_matrix
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.model.parameters import load
from robomill.models.process import dexels as workpiece
from robomill.models.process import tool_table
from robomill.models.process.cutting import (
    LEAST_LAG,
    MAX_TEETH,
    CutResolution,
    CuttingCoefficients,
    EndMill,
    at_angle,
    chip_law,
    edge_density,
    mean_over_rotation,
    tooth_radii,
)

BINS = 90
"""Angular bins of 2 degrees over the half turn in which chips can form."""

PI = math.pi
TWO_PI = 2.0 * math.pi
LEAST_TURN = 1e-9
"""A spindle that turns less than this in a step [rad] stands."""
LEAST_CHIP = 1e-6
"""Chip thickness [m] below which the size effect grows no further."""
LEAST_TILT_COSINE = 0.984807753012208
"""cos(10 deg): the cutter is taken as parallel to z of P; beyond this the model refuses."""

_K = load(CuttingCoefficients, "materials/aw2017")
_MILL = load(EndMill, "tools/endmill_d16_z3")
_CUT = load(CutResolution, "process/milling")


def _parameter(
    name: str, description: str, unit: str, start: float, minimum: float | None = None, maximum: float | None = None, tunable: bool = False
) -> Variable:
    return Variable(name, "parameter", description, unit, start=start, minimum=minimum, maximum=maximum, tunable=tunable)


def _effect(name: str, description: str, unit: str, minimum: float, maximum: float, tunable: bool = False) -> Variable:
    return Variable(name, "parameter", description, unit, minimum=minimum, maximum=maximum, effect=True, tunable=tunable)


def _scratch(name: str, description: str, unit: str = "1", shape: tuple[int, ...] = (), start: float = 0.0) -> Variable:
    return Variable(name, "state", description, unit, shape, start)


def _count(name: str, description: str) -> Variable:
    return Variable(name, "state", description, kind="integer")


_DEPENDS = ("p_BT_B", "quat_BT", "v_BT_B", "spindle_speed", "tool")
_P_BP_B = (1.595, -0.018, 1.099)

VARIABLES = (
    Variable("p_BT_B", "input", "actual position of the tool tip T from B, in B", "m", (3,), (1.595, -0.018, 1.149)),
    Variable(
        "quat_BT",
        "input",
        "actual orientation of T in B (x of T = tool axis out of the spindle), scalar first",
        "1",
        (4,),
        (math.sqrt(0.5), 0, math.sqrt(0.5), 0),
    ),
    Variable("v_BT_B", "input", "commanded feed velocity of T, in B: gives chip thickness and feed direction", "m/s", (3,)),
    Variable("spindle_speed", "input", "spindle speed, clockwise seen from the spindle (M3)", "rad/s", minimum=0.0, display_unit="rpm"),
    Variable("tool", "input", "T number of the tool in the spindle; 0: the one that the parameters describe", kind="integer", minimum=0),
    Variable("f_T_B", "output", "cutting force on the tool at T in B, mean over the step", "N", (3,), depends_on=_DEPENDS),
    Variable("m_T_B", "output", "cutting moment on the tool about T in B, mean over the step", "N.m", (3,), depends_on=_DEPENDS),
    Variable("f_peak", "output", "largest magnitude of the cutting force at a sub-step within the step", "N", depends_on=_DEPENDS),
    Variable("spindle_torque", "output", "torque the spindle delivers, mean over the step", "N.m", depends_on=_DEPENDS),
    Variable("spindle_power", "output", "cutting power of the spindle, mean over the step", "W", display_unit="kW", depends_on=_DEPENDS),
    Variable(
        "removal_rate",
        "output",
        "volume removed from the workpiece per time in the step",
        "m3/s",
        display_unit="cm3/min",
        depends_on=_DEPENDS,
    ),
    Variable("depth", "output", "largest axial engagement of an edge", "m", display_unit="mm", depends_on=_DEPENDS),
    Variable(
        "f_turn_T_B",
        "output",
        "part of f_T_B that changes within a turn of the spindle: f_T_B less the mean over the teeth, zero without runout",
        "N",
        (3,),
        depends_on=_DEPENDS,
    ),
    Variable("m_turn_T_B", "output", "part of m_T_B that changes within a turn of the spindle", "N.m", (3,), depends_on=_DEPENDS),
    Variable("p_BP_B", "parameter", "centre of the nominal top surface of the block (origin of P) from B, in B", "m", (3,), _P_BP_B),
    Variable(
        "quat_BP", "parameter", "orientation of P in B (z of P = up, out of the block), scalar first, unit length", "1", (4,), (1, 0, 0, 0)
    ),
    Variable(
        "block_size", "parameter", "size of the block along x, y, z of P", "m", (3,), (0.100, 0.060, 0.030), minimum=0.0, display_unit="mm"
    ),
    _parameter("spacing", "largest distance of dexels; the cells fill the block exactly", "m", _CUT.spacing, 1e-5),
    _parameter("diameter", "diameter of the cutter", "m", _MILL.diameter, 1e-4),
    Variable("teeth", "parameter", "number of teeth", kind="integer", start=_MILL.teeth, minimum=1, maximum=MAX_TEETH),
    _parameter("helix", "helix angle; right-hand, pulls the tool into the work", "rad", _MILL.helix, 0.0, 1.2),
    _parameter("cutting_length", "length of the cutting edges; a deeper engagement is an error", "m", _MILL.cutting_length, 0.0),
    Variable(
        "tools",
        "parameter",
        "tools by T number: number, diameter in m, teeth, helix in rad, cutting length in m; may be empty",
        shape=(len(tool_table.COLUMNS),),
        kind="table",
    ),
    _parameter("Ktc", "tangential cutting coefficient", "Pa", _K.Ktc, 0.0, tunable=True),
    _parameter("Krc", "radial cutting coefficient", "Pa", _K.Krc, 0.0, tunable=True),
    _parameter("Kac", "axial cutting coefficient", "Pa", _K.Kac, 0.0, tunable=True),
    _parameter("Kte", "tangential edge coefficient", "N/m", _K.Kte, 0.0, tunable=True),
    _parameter("Kre", "radial edge coefficient", "N/m", _K.Kre, 0.0, tunable=True),
    _parameter("Kae", "axial edge coefficient", "N/m", _K.Kae, 0.0, tunable=True),
    _parameter(
        "edge_onset",
        "feed per tooth at which the edge forces are fully there; they grow linearly from a standstill",
        "m",
        _CUT.edge_onset,
        0.0,
    ),
    _parameter("bottom_edge", "share of the radius, from outside, that the edges of the end face span", "1", _CUT.bottom_edge, 0.0, 1.0),
    _parameter("contact_zone", "gap under the end face over which its contact fades out", "m", _CUT.contact_zone, 1e-6),
    _parameter("contact_time", "time constant with which the end face bites", "s", _CUT.contact_time, 0.0),
    Variable(
        "substeps",
        "parameter",
        "instants per step at which f_peak is looked for (the mean does not depend on it)",
        kind="integer",
        start=_CUT.substeps,
        minimum=1,
        maximum=10000,
    ),
    _parameter(
        "spring_back_loss",
        "how much of its chips an edge loses that moves back from what the tool has just cut: "
        "0 none within two cells of the workpiece, 1 all of them",
        "1",
        0.0,
        -1.0,
        1.0,
    ),
    _parameter("size_reference", "chip thickness at which the size effect changes nothing", "m", _CUT.size_reference, 1e-7),
    Variable(
        "actual_feed",
        "parameter",
        "feed from the actual motion of the tool relative to the workpiece, not v_BT_B (needs iterated coupling or a stiff machine)",
        kind="boolean",
    ),
    Variable(
        "spindle_start_angle",
        "parameter",
        "angle of tooth 1 at the start, clockwise from +y of P",
        "rad",
        display_unit="deg",
    ),
    _parameter("runout_angle", "direction of the runout, clockwise from tooth 1", "rad", 0.0),
    _effect("cutting_coefficient_error", "relative error of Ktc, Krc, Kac", "1", -0.9, 2.0, tunable=True),
    _effect("tool_wear", "relative growth of the edge coefficients Kte, Kre, Kae by wear", "1", -0.9, 10.0, tunable=True),
    _effect(
        "size_effect_exponent",
        "exponent m of the size effect: cutting coefficients times (h/size_reference)^-m",
        "1",
        0.0,
        0.6,
        tunable=True,
    ),
    _effect("runout", "offset of the cutter's axis from the spindle's axis", "m", 0.0, 2e-4),
    _effect("stock_error", "extra height of the stock above the nominal top surface", "m", -2e-3, 5e-3),
    _effect("engagement_error", "extra stock on each of the four side faces of the block", "m", -5e-3, 5e-3),
    _effect(
        "workpiece_compliance",
        "compliance of workpiece and fixture, equal in all directions: the block yields to the force of the last step",
        "m/N",
        0.0,
        1e-6,
        tunable=True,
    ),
    _scratch("R_BP", "rotation of P in B", shape=(3, 3)),
    _scratch("p_PT_P", "tool tip relative to the (yielding) workpiece, in P, at the end of the step", "m", (3,)),
    _scratch("p_last", "the same at its beginning", "m", (3,)),
    _scratch("p_mid", "the same in its middle", "m", (3,)),
    _scratch("v_P", "feed velocity in P, mean over the step", "m/s", (3,)),
    _scratch("v_now", "commanded feed velocity in P at the end of the step", "m/s", (3,)),
    _scratch("v_last", "the same at its beginning", "m/s", (3,)),
    _scratch("f_P", "mean force of the last step in P", "N", (3,)),
    _scratch("m_P", "mean moment of the last step in P", "N.m", (3,)),
    _scratch("f_turn_P", "part of f_P that changes within a turn of the spindle", "N", (3,)),
    _scratch("m_turn_P", "part of m_P that changes within a turn of the spindle", "N.m", (3,)),
    _scratch("spindle_angle", "angle of tooth 1, clockwise from +y of P", "rad"),
    _scratch("contact_share", "share of the end face that bites", "1"),
    _count("imprinted", "1 when the block has been cut with the tool at p_last"),
    _count("tool_now", "T number of the tool that the following fields describe"),
    _scratch("mill_diameter", "its diameter", "m"),
    _count("mill_teeth", "its number of teeth"),
    _scratch("mill_helix", "its helix angle", "rad"),
    _scratch("mill_cutting_length", "length of its cutting edges", "m"),
    Variable("tool_numbers", "state", "T numbers of the tool table, 0 behind the last", shape=(tool_table.SHOWN,), kind="integer"),
    Variable("tool_row", "state", "values of a row of the tool table, for the message", shape=(len(tool_table.COLUMNS),)),
    _count("nx", "cells along x of P"),
    _count("ny", "cells along y of P"),
    _scratch("dx", "cell size along x", "m"),
    _scratch("dy", "cell size along y", "m"),
    _scratch("stock_top", "height of the stock's top surface in P", "m"),
    _scratch("stock_bottom", "height of the stock's bottom in P", "m"),
    _scratch("finest_spacing", "finest spacing that fits the capacity", "m"),
    _scratch("tilt_cosine", "cosine of the angle between the tool axis and z of P"),
    _scratch("chip", "feed per tooth", "m"),
    _scratch("bounds", "bounds of the angular bins", "rad", (BINS + 1,)),
    _scratch("bound_sine", "sine of the bounds", shape=(BINS + 1,)),
    _scratch("bound_cosine", "cosine of the bounds", shape=(BINS + 1,)),
    _scratch("bin_sine", "sine of the middle of the bins", shape=(BINS,)),
    _scratch("bin_cosine", "cosine of the middle of the bins", shape=(BINS,)),
    _scratch("bin_depth", "height of material before the edges, per bin", "m", (BINS,)),
    _scratch("radii", "deviation of the radius of each tooth", "m", (MAX_TEETH,)),
    _scratch("density", "force per length of edge, per tooth and bin", "N/m", (MAX_TEETH, BINS, 6)),
    _scratch("total", "integrals over the engaged edges", shape=(8,)),
    _scratch("turning", "part of them that changes within a turn of the spindle", shape=(8,)),
    _scratch("now", "force at a sub-step", "N", (3,)),
    _scratch("height", "the workpiece: height of each cell in P", "m", (workpiece.CAPACITY,)),
    _scratch("lagging", "the same without what the tool has cut lately", "m", (workpiece.CAPACITY,)),
    _scratch("trail", "where the tool has cut lately, in P, oldest first", "m", (workpiece.TRAIL, 3)),
    _count("places", "places in it"),
)

ERRORS = (
    "",
    "a parameter is out of bounds: diameter {diameter} m, spacing {spacing} m, block_size {block_size} m, contact_zone {contact_zone} m "
    "and size_reference {size_reference} m must be positive, substeps {substeps} at least 1, teeth {teeth} from 1 to 12; "
    "correct the parameter",
    "quat_BP {quat_BP} is not of unit length; give w, x, y, z of a rotation, for instance 1, 0, 0, 0",
    "the block of {block_size} m needs more cells than the 262144 available at a spacing of {spacing} m; "
    "use a spacing of {finest_spacing:.6f} m or more, or a smaller block",
    "at t = {t} s an input is not finite: p_BT_B {p_BT_B} m, quat_BT {quat_BT}, v_BT_B {v_BT_B} m/s, spindle_speed {spindle_speed} rad/s; "
    "check the component that feeds it",
    "at t = {t} s spindle_speed is {spindle_speed} rad/s; expected 0 or more: "
    "the cutter is right-hand and turns clockwise (M3); check the program",
    "at t = {t} s the tool is in the workpiece with its axis tilted against z of the block: cosine of the angle {tilt_cosine:.6f}, "
    "expected 0.9848 or more (10 deg), the model knows cutters parallel to z only; turn the block (quat_BP) or the tool",
    "at t = {t} s the feed per tooth is {chip:.6f} m, more than the radius of the cutter (diameter {mill_diameter} m); "
    "the spindle ({spindle_speed} rad/s) is too slow for the feed",
    "at t = {t} s material reaches {depth:.6f} m above the tool tip, more than the cutting edges ({mill_cutting_length} m); "
    "the shank would hit: cut less deep or use a longer tool",
    "the step size must be positive",
    "the table 'tools' has a row with number {tool_row[0]:g}, diameter {tool_row[1]:g} m, {tool_row[2]:g} teeth, "
    "helix {tool_row[3]:g} rad, cutting length {tool_row[4]:g} m; expected a whole number of 1 or more that no row before has, "
    "1 to 12 teeth, a helix from 0 to 1.2 rad and lengths above zero; correct that row",
    "at t = {t} s tool T{tool} is not in the table 'tools', which has {tool_numbers}; add it there or correct the program",
    "at t = {t} s tool T{tool} (diameter {mill_diameter} m) stands {depth:.6f} m deep in material when it comes into the spindle; "
    "change it clear of the workpiece",
)
_BAD_PARAMETER, _BAD_QUATERNION, _TOO_MANY_CELLS, _NOT_FINITE, _REVERSE, _TILTED, _CHIP_TOO_THICK, _TOO_DEEP, _BAD_STEP = range(1, 10)
_BAD_TOOL, _NO_TOOL, _TOOL_IN_MATERIAL = range(10, 13)


def init(s: Record) -> int:
    """Fresh block, spindle at angle 0, no force; a tool that stands in the block has cut its place already."""
    status = _prepare(s)
    if status != 0:
        return status
    workpiece.fill(s.height, s.nx * s.ny, s.stock_top)
    workpiece.fill(s.lagging, s.nx * s.ny, s.stock_top)
    _forget(s)
    _clear(s)
    if not _finite(s):
        return _NOT_FINITE
    status = _take_tool(s)
    if status != 0:
        return status
    _place(s)
    x, y, z = s.p_PT_P[0], s.p_PT_P[1], s.p_PT_P[2]
    if _near(s, x, y, z, x, y, z) and s.tilt_cosine >= LEAST_TILT_COSINE:
        _cut(s, x, y, z, x, y, z, False)
        _lag(s, z < s.stock_top)
    s.imprinted = 1
    mat_t_vec(s.R_BP, s.v_BT_B, s.v_now)
    _carry(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Force while the tool moves from its last position to the given one within h [s]; then the cut itself."""
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
    xa, ya, za = s.p_last[0], s.p_last[1], s.p_last[2]
    x, y, z = s.p_PT_P[0], s.p_PT_P[1], s.p_PT_P[2]
    turn = s.spindle_speed * h
    near = _near(s, xa, ya, za, x, y, z)
    for i in range(3):
        s.f_P[i] = 0.0
        s.m_P[i] = 0.0
        s.f_turn_P[i] = 0.0
        s.m_turn_P[i] = 0.0
    if near and turn > LEAST_TURN:
        if s.tilt_cosine < LEAST_TILT_COSINE:
            return _TILTED
        status = _force(s, turn, h)
        if status != 0:
            return status
        s.removal_rate = _cut(s, xa, ya, za, x, y, z, s.imprinted == 1) / h
    else:
        s.contact_share = 0.0
    _lag(s, near and turn > LEAST_TURN and z < s.stock_top)
    # with the spindle off nothing is cut, so the next cut cannot rely on what the tool has passed
    s.imprinted = 1 if turn > LEAST_TURN or not near else 0
    mat_vec(s.R_BP, s.f_P, s.f_T_B)
    mat_vec(s.R_BP, s.m_P, s.m_T_B)
    mat_vec(s.R_BP, s.f_turn_P, s.f_turn_T_B)
    mat_vec(s.R_BP, s.m_turn_P, s.m_turn_T_B)
    angle = s.spindle_angle + turn
    s.spindle_angle = angle - TWO_PI * math.floor(angle / TWO_PI)
    _carry(s)
    return 0


@kernel
def _carry(s: Record) -> None:
    """The end of this step is the beginning of the next."""
    for i in range(3):
        s.p_last[i] = s.p_PT_P[i]
        s.v_last[i] = s.v_now[i]


@kernel
def _means(s: Record, h: float) -> None:
    """Position in the middle of the step and mean feed velocity over it, both from their values at its ends: of second order."""
    mat_t_vec(s.R_BP, s.v_BT_B, s.v_now)
    for i in range(3):
        s.p_mid[i] = 0.5 * (s.p_last[i] + s.p_PT_P[i])
        s.v_P[i] = (s.p_PT_P[i] - s.p_last[i]) / h if s.actual_feed != 0 else 0.5 * (s.v_last[i] + s.v_now[i])


@kernel
def _force(s: Record, turn: float, h: float) -> int:
    """Mean force and moment in P, peak, torque and depth while the spindle turns by `turn` [rad] in the middle of the step."""
    vx, vy, vz = s.v_P[0], s.v_P[1], s.v_P[2]
    feed = math.sqrt(vx * vx + vy * vy)
    ux, uy = 1.0, 0.0
    if feed > 0.0:
        ux, uy = vx / feed, vy / feed
    per_tooth = TWO_PI * h / (s.mill_teeth * turn)
    s.chip = feed * per_tooth
    thrust, torque = _end_face(s, -vz * per_tooth, h)
    peak = abs(thrust)
    radius = 0.5 * s.mill_diameter
    low = 0.0
    if s.stock_bottom > s.p_mid[2]:
        low = s.stock_bottom - s.p_mid[2]
    for i in range(8):
        s.total[i] = 0.0
        s.turning[i] = 0.0
    largest = 0.0
    if s.chip > 0.0:
        largest = workpiece.engagement(
            s.lagging,
            s.nx,
            s.ny,
            s.dx,
            s.dy,
            s.trail,
            s.places,
            s.p_mid[0],
            s.p_mid[1],
            s.p_mid[2],
            radius,
            ux,
            uy,
            s.spring_back_loss,
            low,
            BINS,
            s.bin_sine,
            s.bin_cosine,
            s.bin_depth,
        )
    if largest > low:
        s.depth = largest - low
        if s.chip > radius:
            return _CHIP_TOO_THICK
        if largest > s.mill_cutting_length:
            s.depth = largest
            return _TOO_DEEP
        peak = _edges(s, s.spindle_angle + atan2(uy, ux), turn, low, largest, thrust)
    _to_axes(s.total, ux, uy, radius, s.f_P, s.m_P)
    _to_axes(s.turning, ux, uy, radius, s.f_turn_P, s.m_turn_P)
    torque += s.m_P[2]
    s.f_P[2] += thrust
    s.m_P[2] = torque
    s.f_peak = peak
    s.spindle_torque = torque
    s.spindle_power = torque * turn / h
    return 0


@kernel
def _to_axes(total: FloatArray, ux: float, uy: float, radius: float, f: FloatArray, m: FloatArray) -> None:
    """Force [N] and moment [N.m] in P from integrals over the edges, which are along feed, left and up; (ux, uy) is the feed's direction.

    The axial force acts off centre (total[4], [5]).
    """
    f_feed, f_left = total[0], total[1]
    m_feed = -total[7] - radius * total[5]
    m_left = total[6] + radius * total[4]
    f[0] = f_feed * ux - f_left * uy
    f[1] = f_feed * uy + f_left * ux
    f[2] = -total[3]
    m[0] = m_feed * ux - m_left * uy
    m[1] = m_feed * uy + m_left * ux
    m[2] = radius * total[2]


@kernel
def _end_face(s: Record, plunge: float, h: float) -> tuple[float, float]:
    """Thrust [N] and torque [N.m] of the end face going down by `plunge` [m] per tooth; its contact builds up over contact_time."""
    target = 0.0
    if plunge > 0.0:
        target = workpiece.contact(
            s.height,
            s.nx,
            s.ny,
            s.dx,
            s.dy,
            s.p_mid[0],
            s.p_mid[1],
            s.p_mid[2],
            0.5 * s.mill_diameter,
            s.stock_bottom,
            s.contact_zone,
        )
    # contact_time w' = target - w, solved exactly over the step; the force takes its mean
    share, mean = target, target
    if s.contact_time > 0.0:
        periods = h / s.contact_time
        decay = exp(-periods)
        share = target + (s.contact_share - target) * decay
        mean = target + (s.contact_share - target) * (1.0 - decay) / periods
    s.contact_share = 0.0 if target == 0.0 and share < 1e-3 else share
    if not (plunge > 0.0 and mean > 0.0):
        return 0.0, 0.0
    cutting = (1.0 + s.cutting_coefficient_error) * plunge
    edge = (1.0 + s.tool_wear) * (plunge / s.edge_onset if plunge < s.edge_onset else 1.0)
    length = s.mill_teeth * mean * s.bottom_edge * 0.5 * s.mill_diameter
    arm = (1.0 - 0.5 * s.bottom_edge) * 0.5 * s.mill_diameter
    return length * (s.Krc * cutting + s.Kre * edge), length * arm * (s.Ktc * cutting + s.Kte * edge)


@kernel
def _edges(s: Record, theta: float, turn: float, low: float, highest: float, thrust: float) -> float:
    """Integrals over the helical edges (s.total) while tooth 1 turns from `theta` on by `turn` [rad]; the peak force [N].

    s.turning: less those of teeth that are all alike, each the mean of all, as a structure has it that does not follow a single tooth.
    """
    tables = s.mill_teeth if s.runout > 0.0 else 1
    _densities(s, tables)
    lag = 2.0 * tan(s.mill_helix) / s.mill_diameter
    lag = max(lag, LEAST_LAG)
    mean_over_rotation(theta, theta + turn, s.mill_teeth, tables, s.bounds, BINS, lag, low, highest, s.bin_depth, s.density, s.total)
    peak2 = 0.0
    for k in range(s.substeps):
        angle = theta + turn * (k + 0.5) / s.substeps
        at_angle(angle, s.mill_teeth, tables, s.bounds, BINS, lag, low, highest, s.bin_depth, s.density, s.now)
        up = thrust - s.now[2]
        peak2 = max(peak2, s.now[0] * s.now[0] + s.now[1] * s.now[1] + up * up)
    if tables > 1:
        for b in range(BINS):
            for i in range(6):
                total = 0.0
                for j in range(tables):
                    total += s.density[j, b, i]
                s.density[0, b, i] = total / tables
        mean_over_rotation(theta, theta + turn, s.mill_teeth, 1, s.bounds, BINS, lag, low, highest, s.bin_depth, s.density, s.turning)
        for i in range(8):
            s.turning[i] = s.total[i] - s.turning[i]
    return math.sqrt(peak2)


@kernel
def _prepare(s: Record) -> int:
    """Check the parameters; lay out cells, bins and tooth radii."""
    if not (s.diameter > 0.0 and s.spacing > 0.0 and s.contact_zone > 0.0 and s.size_reference > 0.0):
        return _BAD_PARAMETER
    if not (s.block_size[0] > 0.0 and s.block_size[1] > 0.0 and s.block_size[2] > 0.0):
        return _BAD_PARAMETER
    if s.teeth < 1 or s.teeth > MAX_TEETH or s.substeps < 1:
        return _BAD_PARAMETER
    q = s.quat_BP
    length2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if not (length2 > 0.999999 and length2 < 1.000001):
        return _BAD_QUATERNION
    quat_to_matrix(s.quat_BP, s.R_BP)
    lx = s.block_size[0] + 2.0 * s.engagement_error
    ly = s.block_size[1] + 2.0 * s.engagement_error
    s.stock_top = s.stock_error
    s.stock_bottom = -s.block_size[2]
    if not (lx > 0.0 and ly > 0.0 and s.stock_top > s.stock_bottom):
        return _BAD_PARAMETER
    # compare as reals first: the count itself may not fit an integer
    if lx / s.spacing * (ly / s.spacing) > 4.0 * workpiece.CAPACITY or (
        workpiece.cells(lx, s.spacing) * workpiece.cells(ly, s.spacing) > workpiece.CAPACITY
    ):
        s.finest_spacing = workpiece.finest_spacing(lx, ly, workpiece.CAPACITY)
        return _TOO_MANY_CELLS
    s.nx = workpiece.cells(lx, s.spacing)
    s.ny = workpiece.cells(ly, s.spacing)
    s.dx = lx / s.nx
    s.dy = ly / s.ny
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
        s.bounds[b] = PI * b / BINS
        s.bound_sine[b], s.bound_cosine[b] = sincos(s.bounds[b])
    for b in range(BINS):
        s.bin_sine[b], s.bin_cosine[b] = sincos(PI * (b + 0.5) / BINS)
    s.finest_spacing = 0.0
    return 0


@kernel
def _take_tool(s: Record) -> int:
    """Put the tool of the input into the spindle: its dimensions and the radii of its teeth."""
    s.tool_now = s.tool
    s.mill_diameter = s.diameter
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
    for j in range(MAX_TEETH):
        s.radii[j] = 0.0
    tooth_radii(s.mill_teeth, s.runout, s.runout_angle, s.radii)
    return 0


@kernel
def _change_tool(s: Record) -> int:
    """Another tool where the last one stood, the spindle going on at its angle; an error if there is material in its place."""
    _lag(s, False)
    status = _take_tool(s)
    if status != 0:
        return status
    s.contact_share = 0.0
    s.imprinted = 0
    x, y, z = s.p_last[0], s.p_last[1], s.p_last[2]
    s.depth = workpiece.covered_depth(s.height, s.nx, s.ny, s.dx, s.dy, s.stock_bottom, x, y, z, 0.5 * s.mill_diameter)
    return _TOOL_IN_MATERIAL if s.depth > 0.0 else 0


@kernel
def _forget(s: Record) -> None:
    """Set every state that `_prepare` and `_place` leave alone to its start, scratch included: no trace of an earlier run."""
    s.spindle_angle = s.spindle_start_angle - TWO_PI * math.floor(s.spindle_start_angle / TWO_PI)
    s.contact_share = 0.0
    s.chip = 0.0
    s.places = 0
    for k in range(workpiece.TRAIL):
        for i in range(3):
            s.trail[k, i] = 0.0
    for i in range(3):
        s.f_P[i] = 0.0
        s.m_P[i] = 0.0
        s.f_turn_P[i] = 0.0
        s.m_turn_P[i] = 0.0
        s.v_P[i] = 0.0
        s.p_mid[i] = 0.0
        s.now[i] = 0.0
    for i in range(8):
        s.total[i] = 0.0
        s.turning[i] = 0.0
    for b in range(BINS):
        s.bin_depth[b] = 0.0
        for j in range(MAX_TEETH):
            for i in range(6):
                s.density[j, b, i] = 0.0


@kernel
def _clear(s: Record) -> None:
    """Set all outputs to zero."""
    for i in range(3):
        s.f_T_B[i] = 0.0
        s.m_T_B[i] = 0.0
        s.f_turn_T_B[i] = 0.0
        s.m_turn_T_B[i] = 0.0
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


@kernel
def _place(s: Record) -> None:
    """Position and tilt of the tool in P. The workpiece yields to the force on it, -f, so the tool is C f further from it."""
    for i in range(3):
        s.p_PT_P[i] = s.p_BT_B[i] - s.p_BP_B[i]
    mat_t_vec(s.R_BP, s.p_PT_P, s.p_PT_P)
    for i in range(3):
        s.p_PT_P[i] += s.workpiece_compliance * s.f_P[i]
    w, x, y, z = s.quat_BT[0], s.quat_BT[1], s.quat_BT[2], s.quat_BT[3]
    ax = 1.0 - 2.0 * (y * y + z * z)
    ay = 2.0 * (x * y + w * z)
    az = 2.0 * (x * z - w * y)
    s.tilt_cosine = -(ax * s.R_BP[0, 2] + ay * s.R_BP[1, 2] + az * s.R_BP[2, 2])


@kernel
def _near(s: Record, xa: float, ya: float, za: float, xb: float, yb: float, zb: float) -> bool:
    reach = 0.5 * s.mill_diameter + (s.dx if s.dx > s.dy else s.dy)
    return workpiece.touches(s.nx, s.ny, s.dx, s.dy, s.stock_top + s.contact_zone, xa, ya, za, xb, yb, zb, reach)


@kernel
def _cut(s: Record, xa: float, ya: float, za: float, xb: float, yb: float, zb: float, done: bool) -> float:
    """Cut the block; volume removed [m3]."""
    return workpiece.cut(s.height, s.nx, s.ny, s.dx, s.dy, s.stock_top, s.stock_bottom, xa, ya, za, xb, yb, zb, 0.5 * s.mill_diameter, done)


@kernel
def _lag(s: Record, cutting: bool) -> None:
    """Let the workpiece that the edges read follow the tool, or catch up with it where the tool does not cut."""
    radius = 0.5 * s.mill_diameter
    if cutting:
        x, y, z = s.p_PT_P[0], s.p_PT_P[1], s.p_PT_P[2]
        s.places = workpiece.follow(s.lagging, s.nx, s.ny, s.dx, s.dy, s.stock_top, s.stock_bottom, s.trail, s.places, x, y, z, radius)
    elif s.places > 0:
        x, y, z = s.p_last[0], s.p_last[1], s.p_last[2]
        workpiece.settle(s.lagging, s.nx, s.ny, s.dx, s.dy, s.stock_top, s.stock_bottom, s.trail, s.places, x, y, z, radius)
        s.places = 0


@kernel
def _densities(s: Record, tables: int) -> None:
    """Force per length of edge in every engaged bin, for all teeth alike (one table) or for each tooth."""
    onset = 1.0
    if s.chip < s.edge_onset:
        onset = s.chip / s.edge_onset
    edge = (1.0 + s.tool_wear) * onset
    width = PI / BINS
    for j in range(tables):
        for b in range(BINS):
            if s.bin_depth[b] <= 0.0:
                continue
            a, slope = 0.0, s.chip
            if tables > 1:
                a, slope = chip_law(j, tables, s.chip, s.bin_sine[b], s.radii)
            h = a + slope * s.bin_sine[b]
            if h <= 0.0:
                for i in range(6):
                    s.density[j, b, i] = 0.0
                continue
            gain = 1.0 + s.cutting_coefficient_error
            if s.size_effect_exponent > 0.0:
                gain *= power((h if h > LEAST_CHIP else LEAST_CHIP) / s.size_reference, -s.size_effect_exponent)
            edge_density(
                s.bound_sine[b],
                s.bound_cosine[b],
                s.bound_sine[b + 1],
                s.bound_cosine[b + 1],
                width,
                a,
                slope,
                s.Ktc * gain,
                s.Krc * gain,
                s.Kac * gain,
                s.Kte * edge,
                s.Kre * edge,
                s.Kae * edge,
                j,
                b,
                s.density,
            )


MODEL = Model(
    name="milling_force",
    description="Mechanistic milling force on a workpiece that the deflected tool really cuts",
    variables=VARIABLES,
    init=init,
    step=step,
    errors=ERRORS,
)
