"""Component regenerative_milling: the cut of milling_force with a tool that vibrates (docs/components/regenerative_milling.md).

Workpiece, engagement and chip of the feed are those of `milling_force`. Between the tool tip that the robot carries (p_BT_B) and
the edges stand modes, moved in sub-steps; the chip of an edge is what the passes before it have left:

    y_i'' + 2 zeta_i w_i y_i' + w_i^2 y_i = (w_i^2/k_i) d_i . f(t),    u = sum_i d_i y_i,
    h = min over k = 1..PASSES of  k c sin(phi) + r_j - r_(j-k) + (1 + e) n . (u(t) - u_k),    none where h < 0,

u_k the displacement when the edge k teeth before stood where this one stands, looked up by the angle of the spindle, so that its
speed may change. The mean force over the step goes out.
"""

from __future__ import annotations

import math

from robomill.models.components import milling_force
from robomill.models.components.milling_force import BINS, LEAST_CHIP, LEAST_TURN, PI, TWO_PI
from robomill.models.components.milling_force import MODEL as MILLING
from robomill.models.maths.elementary import atan2, exp, power, sincos, tan
from robomill.models.maths.frames import mat_t_vec, mat_vec, quat_to_matrix
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.process.cutting import LEAST_LAG
from robomill.models.process.stability.modes import load_modes

MAX_MODES = 12
PASSES = 3
"""Passes of edges that a chip is looked up in: a tooth that left the cut leaves the surface to those before it (Tlusty & Ismail 1981)."""
PAST = 8192
"""Sub-steps that the past surface is kept for."""
MOST_SUBSTEPS = 20_000
RESOLUTION = 20
"""Sub-steps per tooth and per period of the fastest mode at least (FACTS10 10.5)."""
MOST_DAMPING = 0.99
_ORDER = 4
"""Points of the interpolation in the past surface (third order)."""

_step_of_milling = kernel(milling_force.step)
_init_of_milling = kernel(milling_force.init)

_DEFAULT = load_modes("spindle_d16")
_COUNT = len(_DEFAULT.frequency)
_LENGTH = [math.sqrt(float(s @ s)) for s in _DEFAULT.shape.T]


def _filled(values: list[float]) -> list[float]:
    return values + [0.0] * (MAX_MODES - len(values))


_STIFFNESS = [float(w / length) ** 2 for w, length in zip(_DEFAULT.circular, _LENGTH, strict=True)]
_DIRECTION = [[float(x) / length for x in s] for s, length in zip(_DEFAULT.shape.T, _LENGTH, strict=True)]
_DEPENDS = ("p_BT_B", "quat_BT", "v_BT_B", "spindle_speed", "tool")


def _scratch(name: str, description: str, unit: str = "1", shape: tuple[int, ...] = ()) -> Variable:
    return Variable(name, "state", description, unit, shape)


OWN_VARIABLES = (
    Variable(
        "u_T_B",
        "output",
        "displacement of the edges by the modes, in B, mean over the step",
        "m",
        (3,),
        depends_on=_DEPENDS,
        display_unit="um",
    ),
    Variable(
        "vibration",
        "output",
        "root mean square of that displacement about its mean, over the step",
        "m",
        depends_on=_DEPENDS,
        display_unit="um",
    ),
    Variable("chip_peak", "output", "largest chip thickness within the step", "m", depends_on=_DEPENDS, display_unit="um"),
    Variable(
        "mode_frequency",
        "parameter",
        "natural frequencies of the modes between robot and edges; 0: no mode",
        "Hz",
        (MAX_MODES,),
        _filled([float(f) for f in _DEFAULT.frequency]),
        0.0,
        1e5,
    ),
    Variable(
        "mode_damping",
        "parameter",
        "their damping ratios",
        "1",
        (MAX_MODES,),
        _filled([float(z) for z in _DEFAULT.damping]),
        0.0,
        MOST_DAMPING,
    ),
    Variable(
        "mode_stiffness",
        "parameter",
        "their modal stiffnesses along mode_direction",
        "N/m",
        (MAX_MODES,),
        _filled(_STIFFNESS),
        0.0,
        display_unit="N/um",
    ),
    Variable(
        "mode_direction",
        "parameter",
        "their directions in T (x = tool axis out of the spindle), of unit length",
        "1",
        (MAX_MODES, 3),
        [*_DIRECTION, *[[0.0, 0.0, 0.0]] * (MAX_MODES - _COUNT)],
    ),
    Variable(
        "resolution",
        "parameter",
        "sub-steps per tooth, and per period of the fastest mode, at least",
        kind="integer",
        start=RESOLUTION,
        minimum=4,
        maximum=1000,
    ),
    Variable(
        "edge_lifts",
        "parameter",
        "edge forces vanish where vibration takes an edge out of the chip; if not, they follow the feed alone, as in stability theory",
        kind="boolean",
    ),
    Variable(
        "regenerative_gain_error",
        "parameter",
        "relative error of the chip that vibration leaves and meets: -1 is no regeneration",
        "1",
        minimum=-1.0,
        maximum=2.0,
        effect=True,
        tunable=True,
    ),
    _scratch("y", "deflection of the modes", "m", (MAX_MODES,)),
    _scratch("vy", "its velocity", "m/s", (MAX_MODES,)),
    _scratch("direction_P", "directions of the modes in P", shape=(MAX_MODES, 3)),
    _scratch("free", "free motion over a sub-step: position from position, from velocity; velocity from both", shape=(MAX_MODES, 4)),
    _scratch("u_P", "displacement of the edges in P", "m", (3,)),
    _scratch("f_old", "force on the edges in P at the beginning of a sub-step", "N", (3,)),
    _scratch("f_new", "the same at its end", "N", (3,)),
    _scratch("f_sum", "its sum over the step", "N", (3,)),
    _scratch("m_sum", "sum of the moments about the feed, its left and the tool axis", "N.m", (3,)),
    _scratch("m_new", "the same at an instant", "N.m", (3,)),
    _scratch("u_sum", "sum of the displacements", "m", (3,)),
    _scratch("left_u", "what the passes before have left, in P", "m", (PASSES, 3)),
    _scratch("past_angle", "angle of the spindle at past sub-steps, turns added up", "rad", (PAST,)),
    _scratch("past_u", "displacement at past sub-steps, in P", "m", (PAST, 3)),
    _scratch("turned", "angle of the spindle since the start", "rad"),
    _scratch("R_BT", "rotation of T in B", shape=(3, 3)),
    _scratch("fastest", "frequency of the fastest mode", "Hz"),
    Variable("kept", "state", "sub-steps in the past surface so far", kind="integer"),
    Variable("substeps_used", "state", "sub-steps of this step", kind="integer"),
    Variable("fault_mode", "state", "mode that an error message names", kind="integer"),
    _scratch("fault_value", "value that an error message names"),
)

_FIRST = len(MILLING.errors)
ERRORS = (
    *MILLING.errors,
    "mode {fault_mode} is not sound: frequencies {mode_frequency} Hz (0: no mode), dampings {mode_damping} below 0.99, stiffnesses "
    "{mode_stiffness} N/m above zero, directions of unit length (this one: {fault_value:.6f}); correct the mode",
    "at t = {t} s the step needs {substeps_used} sub-steps for {resolution} per tooth and per period of {fastest} Hz; at most 20000 can be "
    "taken: use a shorter communication step or leave out the fastest modes",
    "at t = {t} s a tooth needs {substeps_used} sub-steps; the past surface holds 8192: the spindle ({spindle_speed} rad/s) is too slow "
    "for modes of up to {fastest} Hz, leave out the fastest modes",
    "at t = {t} s the modes have moved the edges by {fault_value:.6f} m, more than the radius of the cutter (diameter {mill_diameter} m): "
    "the cut is unstable (robomill stability says how deep it may be) or the modes are softer than the cut",
)
_BAD_MODE, _TOO_MANY, _TOO_SLOW, _UNSTABLE = range(_FIRST, _FIRST + 4)


def init(s: Record) -> int:
    """Fresh block, no force, tool at rest; no surface has been left yet."""
    for i in range(MAX_MODES):
        s.y[i] = 0.0
        s.vy[i] = 0.0
        for k in range(4):
            s.free[i, k] = 0.0
        for k in range(3):
            s.direction_P[i, k] = 0.0
    for k in range(3):
        s.u_P[k], s.u_T_B[k], s.u_sum[k] = 0.0, 0.0, 0.0
        s.f_old[k], s.f_new[k], s.f_sum[k] = 0.0, 0.0, 0.0
        s.m_sum[k], s.m_new[k] = 0.0, 0.0
    for i in range(PASSES):
        for k in range(3):
            s.left_u[i, k] = 0.0
    for i in range(PAST):
        s.past_angle[i] = 0.0
        for k in range(3):
            s.past_u[i, k] = 0.0
    s.turned, s.vibration, s.chip_peak, s.fault_value = 0.0, 0.0, 0.0, 0.0
    s.kept, s.substeps_used, s.fault_mode = 0, 0, 0
    quat_to_matrix(s.quat_BT, s.R_BT)
    status = _check_modes(s)
    if status != 0:
        return status
    status = _init_of_milling(s)
    return status


def step(s: Record, t: float, h: float) -> int:
    """The step of milling_force, then the modes and the chip that they leave in sub-steps; the force is that of the latter."""
    theta = s.spindle_angle
    status = _step_of_milling(s, t, h)
    if status != 0:
        return status
    turn = s.spindle_speed * h
    status = _count_substeps(s, turn, h)
    if status != 0:
        return status
    _turn_directions(s)
    _free_motion(s, h / s.substeps_used)
    # what milling_force found beside the edges: the end face of a tool that goes down
    thrust, torque = 0.0, 0.0
    if s.f_peak > 0.0:
        thrust = s.f_P[2] + s.total[3]
        torque = s.spindle_torque - 0.5 * s.mill_diameter * s.total[2]
    if turn <= LEAST_TURN:
        s.kept = 0
    return _vibrate(s, theta, turn, h, thrust, torque)


@kernel
def _check_modes(s: Record) -> int:
    """Refuse modes without stiffness or direction; set s.fastest [Hz]."""
    s.fastest = 0.0
    for i in range(MAX_MODES):
        f = s.mode_frequency[i]
        if f == 0.0:
            continue
        d = s.mode_direction[i]
        length2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        sound = f > 0.0 and s.mode_stiffness[i] > 0.0 and s.mode_damping[i] >= 0.0 and s.mode_damping[i] <= MOST_DAMPING
        if not (sound and length2 > 0.999 and length2 < 1.001):
            s.fault_mode = i + 1
            s.fault_value = math.sqrt(length2)
            return _BAD_MODE
        s.fastest = max(s.fastest, f)
    return 0


@kernel
def _count_substeps(s: Record, turn: float, h: float) -> int:
    """Sub-steps of this step: `resolution` per tooth and per period of the fastest mode, one at least."""
    teeth = turn / TWO_PI * s.mill_teeth
    wanted = s.resolution * max(teeth, s.fastest * h)
    s.substeps_used = MOST_SUBSTEPS + 1 if wanted > MOST_SUBSTEPS else max(math.ceil(wanted), 1)
    if s.substeps_used > MOST_SUBSTEPS:
        return _TOO_MANY
    if turn > LEAST_TURN and s.depth > 0.0 and s.substeps_used > (PAST - _ORDER) * teeth:
        s.substeps_used = int(s.substeps_used / teeth) if s.substeps_used < 1e9 * teeth else PAST + 1
        return _TOO_SLOW
    return 0


@kernel
def _turn_directions(s: Record) -> None:
    """Directions of the modes from T over B to P."""
    quat_to_matrix(s.quat_BT, s.R_BT)
    for i in range(MAX_MODES):
        if s.mode_frequency[i] > 0.0:
            mat_vec(s.R_BT, s.mode_direction[i], s.direction_P[i])
            mat_t_vec(s.R_BP, s.direction_P[i], s.direction_P[i])


@kernel
def _free_motion(s: Record, dt: float) -> None:
    """Transition of each mode over a sub-step [s] without force: exact."""
    for i in range(MAX_MODES):
        w = TWO_PI * s.mode_frequency[i]
        if w > 0.0:
            zeta = s.mode_damping[i]
            wd = w * math.sqrt(1.0 - zeta * zeta)
            sine, cosine = sincos(wd * dt)
            decay = exp(-zeta * w * dt)
            a = zeta * w / wd
            s.free[i, 0] = decay * (cosine + a * sine)
            s.free[i, 1] = decay * sine / wd
            s.free[i, 2] = -decay * sine * w * w / wd
            s.free[i, 3] = decay * (cosine - a * sine)


@kernel
def _move(s: Record, dt: float, keep: bool) -> None:
    """Move the modes by a sub-step under a force that goes from f_old to f_new linearly: exact; sets u_P. Not kept: u_P only.

    A ramp g + g' t of force over stiffness is followed at the distance 2 zeta g'/w: y = g - 2 zeta g'/w + g' t.
    """
    for k in range(3):
        s.u_P[k] = 0.0
    for i in range(MAX_MODES):
        w = TWO_PI * s.mode_frequency[i]
        if w > 0.0:
            d = s.direction_P[i]
            old = (d[0] * s.f_old[0] + d[1] * s.f_old[1] + d[2] * s.f_old[2]) / s.mode_stiffness[i]
            new = (d[0] * s.f_new[0] + d[1] * s.f_new[1] + d[2] * s.f_new[2]) / s.mode_stiffness[i]
            slope = (new - old) / dt
            behind = 2.0 * s.mode_damping[i] / w * slope
            a, b = s.y[i] - (old - behind), s.vy[i] - slope
            y = s.free[i, 0] * a + s.free[i, 1] * b + new - behind
            if keep:
                s.vy[i] = s.free[i, 2] * a + s.free[i, 3] * b + slope
                s.y[i] = y
            for k in range(3):
                s.u_P[k] += d[k] * y


@kernel
def _remember(s: Record) -> None:
    """Keep u_P at the angle s.turned."""
    at = s.kept % PAST
    s.past_angle[at] = s.turned
    for k in range(3):
        s.past_u[at, k] = s.u_P[k]
    s.kept += 1


@kernel
def _recall(s: Record, angle: float, out: FloatArray) -> None:
    """Displacement [m] when the spindle stood at `angle` [rad]: third-order interpolation; zero before anything is kept."""
    for k in range(3):
        out[k] = 0.0
    oldest = s.kept - PAST if s.kept > PAST else 0
    if s.kept - oldest < _ORDER or angle < s.past_angle[oldest % PAST]:
        return
    low, high = oldest, s.kept - 1
    while high - low > 1:
        middle = (low + high) // 2
        if s.past_angle[middle % PAST] <= angle:
            low = middle
        else:
            high = middle
    first = min(max(low - 1, oldest), s.kept - _ORDER)
    for i in range(_ORDER):
        weight = 1.0
        own = s.past_angle[(first + i) % PAST]
        for j in range(_ORDER):
            if j != i:
                other = s.past_angle[(first + j) % PAST]
                weight *= (angle - other) / (own - other)
        for k in range(3):
            out[k] += weight * s.past_u[(first + i) % PAST, k]


@kernel
def _vibrate(s: Record, theta: float, turn: float, h: float, thrust: float, torque: float) -> int:
    """Modes, chip and force over the step, tooth 1 turning from `theta` by `turn` [rad]; outputs from what they sum up to."""
    n = s.substeps_used
    dt = h / n
    vx, vy = s.v_P[0], s.v_P[1]
    feed = math.sqrt(vx * vx + vy * vy)
    ux, uy = 1.0, 0.0
    if feed > 0.0:
        ux, uy = vx / feed, vy / feed
    start = theta + atan2(uy, ux)
    # means by the trapezoidal rule: the ends of the step count half
    for k in range(3):
        s.f_sum[k], s.m_sum[k], s.u_sum[k] = 0.5 * s.f_old[k], 0.5 * s.m_new[k], 0.0
    squares, peak2 = 0.0, 0.0
    s.chip_peak = 0.0
    # force at the end of each sub-step: found with the displacement that the last force leads to, then the motion is made with it
    for i in range(n):
        for k in range(3):
            s.f_new[k] = s.f_old[k]
        _move(s, dt, False)
        turned = turn * (i + 1) / n
        s.turned += turn / n
        for k in range(3):
            s.m_new[k] = 0.0
            s.f_new[k] = 0.0
        s.f_new[2] = thrust
        s.m_new[2] = torque
        if s.depth > 0.0:
            for k in range(PASSES):
                _recall(s, s.turned - (k + 1) * TWO_PI / s.mill_teeth, s.left_u[k])
            _edges(s, start + turned, ux, uy)
        _move(s, dt, True)
        if turn > LEAST_TURN:
            _remember(s)
        magnitude2 = 0.0
        weight = 1.0 if i < n - 1 else 0.5
        for k in range(3):
            s.f_sum[k] += weight * s.f_new[k]
            s.m_sum[k] += weight * s.m_new[k]
            s.u_sum[k] += s.u_P[k]
            squares += s.u_P[k] * s.u_P[k]
            magnitude2 += s.f_new[k] * s.f_new[k]
            s.f_old[k] = s.f_new[k]
        peak2 = max(peak2, magnitude2)
        away2 = s.u_P[0] * s.u_P[0] + s.u_P[1] * s.u_P[1] + s.u_P[2] * s.u_P[2]
        if not away2 <= 0.25 * s.mill_diameter * s.mill_diameter:
            s.fault_value = math.sqrt(away2)
            return _UNSTABLE
    for k in range(3):
        s.f_P[k] = s.f_sum[k] / n
        s.u_sum[k] = s.u_sum[k] / n
        squares -= n * s.u_sum[k] * s.u_sum[k]
        s.m_sum[k] = s.m_sum[k] / n
    s.m_P[0] = s.m_sum[0] * ux - s.m_sum[1] * uy
    s.m_P[1] = s.m_sum[0] * uy + s.m_sum[1] * ux
    s.m_P[2] = s.m_sum[2]
    mat_vec(s.R_BP, s.f_P, s.f_T_B)
    mat_vec(s.R_BP, s.m_P, s.m_T_B)
    mat_vec(s.R_BP, s.u_sum, s.u_T_B)
    s.vibration = math.sqrt(squares / n) if squares > 0.0 else 0.0
    s.f_peak = math.sqrt(peak2)
    s.spindle_torque = s.m_sum[2]
    s.spindle_power = s.spindle_torque * turn / h
    return 0


@kernel
def _edges(s: Record, theta: float, ux: float, uy: float) -> None:
    """Add force (s.f_new) and moment (s.m_new) of all edges, tooth 1 at `theta` [rad] from the left of the feed (ux, uy)."""
    lag = max(2.0 * tan(s.mill_helix) / s.mill_diameter, LEAST_LAG)
    low = 0.0
    if s.stock_bottom > s.p_mid[2]:
        low = max(s.stock_bottom - s.p_mid[2] - s.u_P[2], 0.0)
    highest = s.depth - s.u_P[2] + (s.stock_bottom - s.p_mid[2] if s.stock_bottom > s.p_mid[2] else 0.0)
    if highest <= low:
        return
    width = PI / BINS
    for j in range(s.mill_teeth):
        tip = theta - TWO_PI * j / s.mill_teeth
        tip -= TWO_PI * math.floor(tip / TWO_PI)
        angle = tip + TWO_PI * math.floor((PI - tip + lag * highest) / TWO_PI)
        while angle - lag * low > 0.0:
            first = max(math.floor((angle - lag * highest) / width) - 1, 0)
            last = min(math.floor((angle - lag * low) / width) + 1, BINS - 1)
            for b in range(first, last + 1):
                top = s.bin_depth[b] - s.u_P[2]
                if s.bin_depth[b] <= 0.0 or top <= low:
                    continue
                # heights between which this edge stands in the bin
                above = min(max((angle - s.bounds[b]) / lag, low), top)
                below = min(max((angle - s.bounds[b + 1]) / lag, low), top)
                if above > below:
                    _edge(s, j, b, above - below, 0.5 * (above + below), ux, uy)
            angle -= TWO_PI


@kernel
def _edge(s: Record, j: int, b: int, length: float, height: float, ux: float, uy: float) -> None:
    """Add what a piece of edge of tooth j in bin b contributes; `length` and `height` of its middle above the tip [m]."""
    sine, cosine = s.bin_sine[b], s.bin_cosine[b]
    nx, ny = sine * ux - cosine * uy, sine * uy + cosine * ux
    gain = 1.0 + s.regenerative_gain_error
    chip = 0.0
    for k in range(PASSES):
        before = (j - k - 1) % s.mill_teeth
        left = s.left_u[k]
        found = (k + 1) * s.chip * sine + s.radii[j] - s.radii[before] + gain * (nx * (s.u_P[0] - left[0]) + ny * (s.u_P[1] - left[1]))
        chip = found if k == 0 else min(chip, found)
    if chip <= 0.0:
        chip = 0.0
        if s.edge_lifts != 0:
            return
    s.chip_peak = max(s.chip_peak, chip)
    cutting = (1.0 + s.cutting_coefficient_error) * chip
    if s.size_effect_exponent > 0.0:
        cutting *= power((chip if chip > LEAST_CHIP else LEAST_CHIP) / s.size_reference, -s.size_effect_exponent)
    edge = (1.0 + s.tool_wear) * (s.chip / s.edge_onset if s.chip < s.edge_onset else 1.0)
    ft = length * (s.Ktc * cutting + s.Kte * edge)
    fr = length * (s.Krc * cutting + s.Kre * edge)
    fa = length * (s.Kac * cutting + s.Kae * edge)
    forward, left_of = -ft * cosine - fr * sine, ft * sine - fr * cosine
    radius = 0.5 * s.mill_diameter
    s.f_new[0] += forward * ux - left_of * uy
    s.f_new[1] += forward * uy + left_of * ux
    s.f_new[2] -= fa
    s.m_new[0] -= height * left_of + radius * fa * cosine
    s.m_new[1] += height * forward + radius * fa * sine
    s.m_new[2] += radius * ft


MODEL = Model(
    name="regenerative_milling",
    description="Milling force with regeneration: modes of spindle and tool, and the surface that they leave, in sub-steps",
    variables=(*MILLING.variables, *OWN_VARIABLES),
    init=init,
    step=step,
    errors=ERRORS,
)
