"""Component face_milling_force: force of a face cutter as paper 003 states it, on a workpiece that the deflected tool really cuts.

The paper gives the force of its end milling test by its three components (sec. 5.4.1), not by cutting coefficients. Here they belong to a
reference cut, and follow the cross-section A that the edges meet in the dexels, its depth d and the feed v:

    F = F_ref (A / (w_ref d_ref)) (d / d_ref)^(a - 1) (v / v_ref)^b          for a full width that is F_ref (d / d_ref)^a (v / v_ref)^b,

against the feed, to its left and along the tool axis into the spindle. The tool comes into the cut as its circle meets the block, and a
cutter that is bent into the part cuts deeper and is pushed harder. Ports and frames as `milling_force` (docs/components/milling_force.md).
"""

from __future__ import annotations

import math

from robomill.models.components.milling_force import MODEL as MILLING
from robomill.models.maths.elementary import PI, power, sincos
from robomill.models.maths.frames import mat_t_vec, mat_vec, quat_to_matrix
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.process import dexels as workpiece

BINS = 90
"""Angular bins of 2 degrees over the half turn in front of the cutter."""
LEAST_SPEED = 1e-9
"""Speed [m/s] and spindle speed [rad/s] below which there is none."""

_PORTS = tuple(v for v in MILLING.variables if v.causality in ("input", "output"))
"""f_turn_T_B and m_turn_T_B stay zero: the force is a mean over the teeth."""
_BLOCK = ("p_BP_B", "quat_BP", "block_size", "stock_error")
_BAD_PARAMETER, _BAD_QUATERNION, _TOO_MANY_CELLS, _NOT_FINITE, _REVERSE, _TOO_DEEP, _BAD_STEP = range(1, 8)


@kernel
def _prepare(s: Record) -> int:
    """Check the parameters; lay out cells and bins. Returns a status."""
    if not (s.diameter > 0.0 and s.spacing > 0.0 and s.width_reference > 0.0 and s.depth_reference > 0.0 and s.feed_reference > 0.0):
        return _BAD_PARAMETER
    for i in range(3):
        if not s.block_size[i] > 0.0:
            return _BAD_PARAMETER
    if s.opening_diameter < 0.0 or (s.opening_diameter > 0.0 and not (s.opening_pitch[0] > 0.0 and s.opening_pitch[1] > 0.0)):
        return _BAD_PARAMETER
    length2 = 0.0
    for i in range(4):
        length2 += s.quat_BP[i] * s.quat_BP[i]
    if not abs(length2 - 1.0) < 1e-6:
        return _BAD_QUATERNION
    quat_to_matrix(s.quat_BP, s.R_BP)
    lx, ly = s.block_size[0], s.block_size[1]
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
    s.bottom = -s.block_size[2]
    for b in range(BINS):
        s.bin_sine[b], s.bin_cosine[b] = sincos(PI * (b + 0.5) / BINS)
        first = sincos(PI * b / BINS)[1]
        s.bin_width[b] = 0.5 * s.diameter * (first - sincos(PI * (b + 1) / BINS)[1])
    return 0


@kernel
def _open(s: Record) -> None:
    """Take the openings out of the stock: round ones in rows about the middle of the block, half a pitch from it on either side."""
    radius2 = 0.25 * s.opening_diameter * s.opening_diameter
    for iy in range(s.ny):
        y = (iy + 0.5) * s.dy - 0.5 * s.block_size[1]
        v = y - s.opening_pitch[1] * (math.floor(y / s.opening_pitch[1]) + 0.5)
        for ix in range(s.nx):
            x = (ix + 0.5) * s.dx - 0.5 * s.block_size[0]
            u = x - s.opening_pitch[0] * (math.floor(x / s.opening_pitch[0]) + 0.5)
            if u * u + v * v < radius2:
                s.height[iy * s.nx + ix] = s.bottom
                s.lagging[iy * s.nx + ix] = s.bottom


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
def _place(s: Record) -> int:
    """Set s.p_PT_P [m] from the inputs; status if they are not finite."""
    for i in range(3):
        if not (abs(s.p_BT_B[i]) < 1e6 and abs(s.v_BT_B[i]) < 1e6):
            return _NOT_FINITE
        s.lever[i] = s.p_BT_B[i] - s.p_BP_B[i]
    if not abs(s.spindle_speed) < 1e9:
        return _NOT_FINITE
    mat_t_vec(s.R_BP, s.lever, s.p_PT_P)
    mat_t_vec(s.R_BP, s.v_BT_B, s.v_P)
    return 0


@kernel
def _push(s: Record) -> int:
    """Force of the cut in the middle of the step: outputs f_T_B [N], m_T_B [N.m], torque, power and depth. Returns a status."""
    feed = math.sqrt(s.v_P[0] * s.v_P[0] + s.v_P[1] * s.v_P[1])
    if not feed > LEAST_SPEED:
        return 0
    ux, uy = s.v_P[0] / feed, s.v_P[1] / feed
    x = 0.5 * (s.p_last[0] + s.p_PT_P[0])
    y = 0.5 * (s.p_last[1] + s.p_PT_P[1])
    z = 0.5 * (s.p_last[2] + s.p_PT_P[2])
    low = max(0.0, s.bottom - z)
    radius = 0.5 * s.diameter
    largest = workpiece.engagement(
        s.lagging,
        s.nx,
        s.ny,
        s.dx,
        s.dy,
        s.trail,
        s.places,
        x,
        y,
        z,
        radius,
        ux,
        uy,
        0.0,
        low,
        BINS,
        s.bin_sine,
        s.bin_cosine,
        s.bin_depth,
    )
    if not largest > low:
        return 0
    s.depth = largest - low
    if s.depth > s.cutting_length:
        return _TOO_DEEP
    section = 0.0
    for b in range(BINS):
        if s.bin_depth[b] > low:
            section += (s.bin_depth[b] - low) * s.bin_width[b]
    share = section / (s.width_reference * s.depth_reference)
    share *= power(s.depth / s.depth_reference, s.depth_exponent - 1.0) * power(feed / s.feed_reference, s.feed_exponent)
    share *= 1.0 + s.force_error
    against, left, away = share * s.force_reference[0], share * s.force_reference[1], share * s.force_reference[2]
    s.f_P[0] = -against * ux - left * uy
    s.f_P[1] = -against * uy + left * ux
    s.f_P[2] = away
    mat_vec(s.R_BP, s.f_P, s.f_T_B)
    # the force to the left of the feed is that of the edges in front of the tool, so its lever is the radius
    s.spindle_torque = radius * abs(left)
    s.lever[0], s.lever[1], s.lever[2] = 0.0, 0.0, s.spindle_torque
    mat_vec(s.R_BP, s.lever, s.m_T_B)
    s.f_peak = math.sqrt(against * against + left * left + away * away)
    s.spindle_power = s.spindle_torque * s.spindle_speed
    return 0


def init(s: Record) -> int:
    """Fresh block, no force; a tool that stands in the block has cut its place already."""
    status = _prepare(s)
    if status != 0:
        return status
    workpiece.fill(s.height, s.nx * s.ny, s.stock_error)
    workpiece.fill(s.lagging, s.nx * s.ny, s.stock_error)
    s.places = 0
    for k in range(workpiece.TRAIL):
        for i in range(3):
            s.trail[k, i] = 0.0
    if s.opening_diameter > 0.0:
        _open(s)
    _clear(s)
    status = _place(s)
    if status != 0:
        return status
    for b in range(BINS):
        s.bin_depth[b] = 0.0
    for i in range(3):
        s.f_P[i] = 0.0
        s.p_last[i] = s.p_PT_P[i]
    _cut(s, False)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """Force while the tool moves from its last position to the given one within h [s]; then the cut itself."""
    if not h > 0.0:
        return _BAD_STEP
    _clear(s)
    status = _place(s)
    if status != 0:
        return status
    if s.spindle_speed < 0.0:
        return _REVERSE
    if s.spindle_speed > LEAST_SPEED:
        status = _push(s)
        if status != 0:
            return status
        s.removal_rate = _cut(s, True) / h
    else:
        _catch_up(s)
    for i in range(3):
        s.p_last[i] = s.p_PT_P[i]
    return 0


@kernel
def _catch_up(s: Record) -> None:
    """Let the workpiece that the edges read have all that the tool has cut: it does not cut any more."""
    if s.places > 0:
        x, y, z = s.p_last[0], s.p_last[1], s.p_last[2]
        workpiece.settle(s.lagging, s.nx, s.ny, s.dx, s.dy, s.stock_error, s.bottom, s.trail, s.places, x, y, z, 0.5 * s.diameter)
        s.places = 0


@kernel
def _cut(s: Record, done: bool) -> float:
    """Cut the block from p_last to p_PT_P; volume removed [m3]."""
    xa, ya, za = s.p_last[0], s.p_last[1], s.p_last[2]
    x, y, z = s.p_PT_P[0], s.p_PT_P[1], s.p_PT_P[2]
    radius = 0.5 * s.diameter
    near = workpiece.touches(s.nx, s.ny, s.dx, s.dy, s.stock_error, xa, ya, za, x, y, z, radius + max(s.dx, s.dy))
    if near and z < s.stock_error:
        s.places = workpiece.follow(s.lagging, s.nx, s.ny, s.dx, s.dy, s.stock_error, s.bottom, s.trail, s.places, x, y, z, radius)
    else:
        _catch_up(s)
    removed = 0.0
    if near:
        removed = workpiece.cut(s.height, s.nx, s.ny, s.dx, s.dy, s.stock_error, s.bottom, xa, ya, za, x, y, z, radius, done)
    return removed


def _length(name: str, description: str, start: float, minimum: float = 0.0) -> Variable:
    return Variable(name, "parameter", description, "m", (), start, minimum, display_unit="mm")


VARIABLES = (
    *_PORTS,
    *(v for v in MILLING.variables if v.name in _BLOCK),
    _length("spacing", "Largest distance of dexels; the cells fill the block exactly", 5e-4, 1e-5),
    _length("diameter", "Diameter of the face cutter", 75e-3, 1e-4),
    _length("cutting_length", "Height of its edges; a deeper engagement is an error", 10e-3),
    Variable(
        "force_reference",
        "parameter",
        "Force on the tool in the reference cut: against the feed, to the left of the feed, along the tool axis into the spindle",
        "N",
        (3,),
        (300.0, 300.0, 50.0),
    ),
    _length("width_reference", "Width of the reference cut", 50e-3, 1e-6),
    _length("depth_reference", "Depth of the reference cut", 3e-3, 1e-6),
    Variable("feed_reference", "parameter", "Feed of the reference cut", "m/s", (), 20e-3, 1e-6, display_unit="mm/s"),
    Variable("depth_exponent", "parameter", "Exponent a of the depth of cut", "1", (), 0.9, 0.0, 2.0),
    Variable("feed_exponent", "parameter", "Exponent b of the feed", "1", (), 0.5, 0.0, 2.0),
    _length("opening_diameter", "Diameter of round openings in the stock; 0 = none", 0.0),
    Variable(
        "opening_pitch",
        "parameter",
        "Distance of the openings along x and y of P, in rows about the middle of the block",
        "m",
        (2,),
        (0.1, 0.1),
        0.0,
        display_unit="mm",
    ),
    Variable("force_error", "parameter", "Relative error of the force", "1", (), 0.0, -0.9, 5.0, effect=True),
    Variable("R_BP", "state", "Rotation of P in B", "1", (3, 3)),
    Variable("p_PT_P", "state", "Tool tip in P at the end of the step", "m", (3,)),
    Variable("p_last", "state", "The same at its beginning", "m", (3,)),
    Variable("v_P", "state", "Commanded feed velocity in P", "m/s", (3,)),
    Variable("f_P", "state", "Force on the tool in P", "N", (3,)),
    Variable("lever", "state", "Scratch", "1", (3,)),
    Variable("nx", "state", "Cells along x of P", kind="integer"),
    Variable("ny", "state", "Cells along y of P", kind="integer"),
    Variable("dx", "state", "Cell size along x", "m"),
    Variable("dy", "state", "Cell size along y", "m"),
    Variable("bottom", "state", "Height of the bottom of the stock in P", "m"),
    Variable("finest_spacing", "state", "Finest spacing that fits the capacity", "m"),
    Variable("bin_sine", "state", "Sine of the middle of the bins", "1", (BINS,)),
    Variable("bin_cosine", "state", "Cosine of the middle of the bins", "1", (BINS,)),
    Variable("bin_width", "state", "Width of the bins across the feed", "m", (BINS,)),
    Variable("bin_depth", "state", "Height of the material that the edges meet, per bin", "m", (BINS,)),
    Variable("height", "state", "The workpiece: height of each cell in P", "m", (workpiece.CAPACITY,)),
    Variable("lagging", "state", "The same without what the tool has cut lately", "m", (workpiece.CAPACITY,)),
    Variable("trail", "state", "Where the tool has cut lately, in P, oldest first", "m", (workpiece.TRAIL, 3)),
    Variable("places", "state", "Places in it", kind="integer"),
)

MODEL = Model(
    "face_milling_force",
    "Force of a face cutter by its components in a reference cut, on a workpiece that is really cut (Pan & Zhang 2009, sec. 5.4)",
    VARIABLES,
    init,
    step,
    (
        "",
        "a parameter is out of bounds: diameter {diameter} m, spacing {spacing} m, block_size {block_size} m, width_reference "
        "{width_reference} m, depth_reference {depth_reference} m and feed_reference {feed_reference} m/s must be positive, as must "
        "opening_pitch {opening_pitch} m where opening_diameter {opening_diameter} m is; correct the parameter",
        "quat_BP {quat_BP} is not of unit length; give w, x, y, z of a rotation, for instance 1, 0, 0, 0",
        "the block of {block_size} m needs more cells than the 262144 available at a spacing of {spacing} m; "
        "use a spacing of {finest_spacing:.6f} m or more, or a smaller block",
        "at t = {t} s an input is not finite: p_BT_B {p_BT_B} m, v_BT_B {v_BT_B} m/s, spindle_speed {spindle_speed} rad/s; "
        "check the component that feeds it",
        "at t = {t} s spindle_speed is {spindle_speed} rad/s; expected 0 or more: "
        "the cutter is right-hand and turns clockwise (M3); check the program",
        "at t = {t} s the edges meet {depth:.6f} m of material, more than they are high ({cutting_length} m); cut less deep",
        "the step size must be positive",
    ),
)
