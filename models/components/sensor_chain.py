"""Component sensor_chain: force-torque sensor between flange and end effector, and what is made of its signal.

Haehn & Weigold 2020, secs. 2.2 and 2.6. First the sensor: the wrench at the tool tip moved to the
sensor, with the weight of the end effector and the pull of the hose pack; offsets, drift, noise,
resolution and range of the sensor. Then the signal processing: Eq. (18) with Eq. (17), low-pass and
moving average, Eqs. (19) and (20) back to the tool tip. Truth and compensation have parameters of their
own (`load_*`, `hose_*`, `offset_*` against `model_*`), equal by default: nominally all is removed.
Forces act ON the tool. Frames: S sensor, T tool tip, F flange, B robot base.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from robomill.models.calibration.features import FEATURES
from robomill.models.maths.elementary import exp
from robomill.models.maths.filters import average, average_rest, biquad, biquad_rest, butterworth, delay, delay_rest, first_order
from robomill.models.maths.frames import (
    cross,
    mat_mul,
    mat_t_vec,
    mat_vec,
    matrix_to_quat,
    quat_from_abc,
    quat_to_matrix,
    rotation_vector_to_quat,
)
from robomill.models.maths.noise import normal_pair
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS, forward, robot_variables

CHANNELS = 6
WINDOW_CAPACITY = 250
"""Longest moving average, samples: one second at 4 ms."""
LAG_CAPACITY = 130
"""Places of the line that realises `extra_lag`: 0.5 s at 4 ms, and two for the interpolation."""
GRAVITY = 9.81

WRONG_STEP, WRONG_CUTOFF, WRONG_WINDOW, WRONG_LAG, WRONG_QUATERNION = 1, 2, 3, 4, 5

CONFERENCE_MATRIX = np.array(
    [
        [0, 1, 1, 1, 1, 1],
        [1, 0, 1, -1, -1, 1],
        [1, 1, 0, 1, -1, -1],
        [1, -1, 1, 0, 1, -1],
        [1, -1, -1, 1, 0, 1],
        [1, 1, -1, -1, 1, 0],
    ],
    dtype=np.float64,
)
"""Cross-talk pattern: Paley's conference matrix of order 6 (C C^T = 5 I). Every channel takes the same share from
every other one, and no direction of the wrench is preferred."""


@dataclass(frozen=True)
class ForceSensor:
    """A six-axis force-torque sensor, from a file in models/data/sensors; arrays are x, y, z of S."""

    name: str
    """Name for people."""
    range_f: FloatArray = field(metadata=quantity("N", 0.0))
    """Largest force that is measured."""
    range_m: FloatArray = field(metadata=quantity("N.m", 0.0))
    """Largest moment that is measured."""
    resolution_f: FloatArray = field(metadata=quantity("N", 0.0))
    """Step of the force."""
    resolution_m: FloatArray = field(metadata=quantity("N.m", 0.0))
    """Step of the moment."""
    noise_f: float = field(metadata=quantity("N", 0.0))
    """Standard deviation of a force sample."""
    noise_m: float = field(metadata=quantity("N.m", 0.0))
    """Standard deviation of a moment sample."""
    walk_f: float = field(metadata=quantity("N", 0.0))
    """Standard deviation of the drift of the force in one minute."""
    walk_m: float = field(metadata=quantity("N.m", 0.0))
    """Standard deviation of the drift of the moment in one minute."""


@dataclass(frozen=True)
class Mounting:
    """Where the sensor sits, and what it shows without load."""

    p_FS_F: FloatArray = field(metadata=quantity("m"))
    abc_FS: FloatArray = field(metadata=quantity("rad"))
    offset_f: FloatArray = field(metadata=quantity("N"))
    offset_m: FloatArray = field(metadata=quantity("N.m"))

    @property
    def quat_FS(self) -> FloatArray:
        """Orientation of S in F as a quaternion (w, x, y, z)."""
        quat = np.zeros(4)
        quat_from_abc(float(self.abc_FS[0]), float(self.abc_FS[1]), float(self.abc_FS[2]), quat)
        return quat


@dataclass(frozen=True)
class HosePack:
    """Pull of the hose pack: the elastic hose that it stands for, and the polynomial of Eq. (17) fitted to it."""

    name: str
    p_FH_F: FloatArray = field(metadata=quantity("m"))
    anchor_B: FloatArray = field(metadata=quantity("m"))
    pull: float = field(metadata=quantity("N", 0.0))
    rate: float = field(metadata=quantity("N/m", 0.0))
    free_length: float = field(metadata=quantity("m", 0.0))
    coefficients: FloatArray = field(metadata=quantity("N"))


@dataclass(frozen=True)
class ForceFilter:
    """Low-pass and moving average of the measured wrench."""

    sample_time: float = field(metadata=quantity("s", 1e-5, 1.0))
    cutoff: float = field(metadata=quantity("Hz", 0.0))
    window: float = field(metadata=quantity("1", 1.0, WINDOW_CAPACITY))


OMEGA160 = load(ForceSensor, "sensors/ati_omega160_si2500")
MOUNTING = load(Mounting, "sensors/mounting")
HOSE = load(HosePack, "sensors/hose_gallows")
FILTER = load(ForceFilter, "control/force_filter")


@kernel
def orientation_terms(quat: FloatArray, terms: FloatArray) -> None:
    """The 15 terms of Eq. (17) for a unit quaternion with q1 >= 0, in the order of the paper."""
    q1, q2, q3, q4 = quat[0], quat[1], quat[2], quat[3]
    terms[0] = 1.0
    terms[1] = q1
    terms[2] = q2
    terms[3] = q3
    terms[4] = q4
    terms[5] = q1 * q1
    terms[6] = q2 * q2
    terms[7] = q3 * q3
    terms[8] = q4 * q4
    terms[9] = q1 * q2
    terms[10] = q1 * q3
    terms[11] = q1 * q4
    terms[12] = q2 * q3
    terms[13] = q2 * q4
    terms[14] = q3 * q4


@kernel
def orientation_polynomial(terms: FloatArray, coefficients: FloatArray, force: FloatArray) -> None:
    """Set force [N, 3] = coefficients^T terms, Eq. (17); `coefficients` (15, 3) N."""
    for i in range(3):
        total = 0.0
        for k in range(FEATURES):
            total += coefficients[k, i] * terms[k]
        force[i] = total


@kernel
def prepare_filters(s: Record, cutoff: float) -> int:
    """Coefficients of the low-pass of `cutoff` [Hz]; returns a status. The filters of s.clean (`FILTER_STATES`) are three kernels."""
    s.cutoff_used = cutoff
    if s.cutoff_used * s.sample_time >= 0.5:
        return WRONG_CUTOFF
    if s.filter_window < 1 or s.filter_window > WINDOW_CAPACITY:
        return WRONG_WINDOW
    butterworth(s.cutoff_used, s.sample_time, s.filter_b, s.filter_a)
    return 0


@kernel
def settle_filters(s: Record) -> None:
    """Low-pass and moving average as if s.clean [CHANNELS] had stood for long."""
    s.window_position = 0
    for i in range(CHANNELS):
        biquad_rest(s.filter_b, s.filter_a, s.filter_z, i, s.clean[i])
        average_rest(s.window_ring, int(s.filter_window), i, s.clean[i])


@kernel
def filter_sample(s: Record) -> None:
    """One sample of s.clean [CHANNELS] through low-pass and moving average, in place."""
    for i in range(CHANNELS):
        s.clean[i] = average(
            s.window_ring,
            int(s.filter_window),
            int(s.window_position),
            i,
            biquad(s.filter_b, s.filter_a, s.filter_z, i, s.clean[i]),
        )
    s.window_position += 1
    if s.window_position >= s.filter_window:
        s.window_position = 0


@kernel
def _prepare(s: Record) -> int:
    """Everything that follows from parameters alone: filter coefficients, mounting matrices. Returns a status."""
    norm = 0.0
    for i in range(4):
        norm += s.quat_FS[i] * s.quat_FS[i]
    if abs(norm - 1.0) > 1e-6:
        return WRONG_QUATERNION
    cutoff = s.filter_cutoff
    if s.cutoff_error != 0.0:
        cutoff = s.filter_cutoff * (1.0 + s.cutoff_error)
    status: int = prepare_filters(s, cutoff)
    if status != 0:
        return status
    if s.extra_lag > (LAG_CAPACITY - 2) * s.sample_time:
        return WRONG_LAG
    quat_to_matrix(s.quat_FS, s.R_FS)
    quat_to_matrix(s.quat_FT, s.R_FT)
    for i in range(3):
        s.lever[i] = s.p_FT_F[i] - s.p_FS_F[i]
        for j in range(3):
            s.R_TS[i, j] = s.R_FT[0, i] * s.R_FS[0, j] + s.R_FT[1, i] * s.R_FS[1, j] + s.R_FT[2, i] * s.R_FS[2, j]
    mat_t_vec(s.R_FS, s.lever, s.p_ST_S)
    s.misaligned = 0
    for i in range(3):
        if s.misalignment[i] != 0.0:
            s.misaligned = 1
    rotation_vector_to_quat(s.misalignment, s.quat_mis)
    quat_to_matrix(s.quat_mis, s.R_mis)
    return 0


@kernel
def _add_at(s: Record, p: FloatArray, force: FloatArray) -> None:
    """Add `force` [N] in S acting at `p` [m] in S to s.wrench (force, moment about S)."""
    cross(p, force, s.work_m)
    for i in range(3):
        s.wrench[i] += force[i]
        s.wrench[3 + i] += s.work_m[i]


@kernel
def _place(s: Record) -> None:
    """Pose of the sensor at s.q: s.R_BS, s.p_BS_B [m], the terms of Eq. (17), and s.p_BG_B [m] of the centre of gravity."""
    forward(s, s.q)
    R_BF = s.link_R[5]
    mat_mul(R_BF, s.R_FS, s.R_BS)
    matrix_to_quat(s.R_BS, s.quat_BS)
    orientation_terms(s.quat_BS, s.terms)
    mat_vec(R_BF, s.p_FS_F, s.work)
    mat_vec(s.R_BS, s.load_cog_S, s.lever)
    for i in range(3):
        s.p_BS_B[i] = s.link_p[5, i] + s.work[i]
        s.p_BG_B[i] = s.p_BS_B[i] + s.lever[i]


@kernel
def _load(s: Record) -> None:
    """Set s.wrench: what really acts on the sensor at S, in the axes of the (misaligned) sensor, N and N m."""
    # process: force and moment at T, moved to S
    for i in range(6):
        s.wrench[i] = 0.0
    mat_t_vec(s.R_BS, s.f_T_B, s.work)
    _add_at(s, s.p_ST_S, s.work)
    mat_t_vec(s.R_BS, s.m_T_B, s.work)
    for i in range(3):
        s.wrench[3 + i] += s.work[i]
    # weight, and with the effect `inertia` the inertial force, at the centre of gravity
    mass = s.load_mass + s.weight_error
    for i in range(3):
        s.work[i] = mass * s.gravity_B[i]
        if s.inertia != 0.0:
            acceleration = (s.p_BG_B[i] - 2.0 * s.p_last[i] + s.p_before[i]) / (s.sample_time * s.sample_time)
            s.work[i] -= s.inertia * mass * acceleration
    mat_t_vec(s.R_BS, s.work, s.work)
    _add_at(s, s.load_cog_S, s.work)
    # hose pack, at its fixing point
    orientation_polynomial(s.terms, s.hose_coefficients, s.work)
    _add_at(s, s.hose_point_S, s.work)
    if s.hose_force != 0.0:
        mat_vec(s.R_BS, s.hose_point_S, s.work)
        length = 0.0
        for i in range(3):
            s.work[i] = s.hose_anchor_B[i] - s.p_BS_B[i] - s.work[i]
            length += s.work[i] * s.work[i]
        scale = s.hose_force / max(math.sqrt(length), 1e-6)
        for i in range(3):
            s.work[i] *= scale
        mat_t_vec(s.R_BS, s.work, s.work)
        _add_at(s, s.hose_point_S, s.work)
    if s.misaligned != 0:
        for half in range(2):
            for i in range(3):
                s.work[i] = s.wrench[3 * half + i]
            mat_t_vec(s.R_mis, s.work, s.work)
            for i in range(3):
                s.wrench[3 * half + i] = s.work[i]


@kernel
def _range(s: Record, i: int) -> float:
    """Full scale of channel i = 0..5, N or N m."""
    full: float = s.range_f[i] if i < 3 else s.range_m[i - 3]
    return full


@kernel
def _sense(s: Record, time: float, ideal: bool) -> None:
    """Set s.reading from s.wrench: gain, cross-talk, offset, drift, bias, noise, resolution, range. `time` in s.

    `ideal` leaves noise and resolution out: the value about which the reading scatters.
    """
    drift = 0.0
    if s.zero_drift[0] != 0.0 or s.zero_drift[1] != 0.0 or s.zero_drift[2] != 0.0:
        drift = 1.0 - exp(-(time + s.zero_age) / s.zero_drift_time)
    for i in range(CHANNELS):
        value = s.wrench[i]
        if s.sensor_gain_error != 0.0 or s.sensor_gain_error_axis[i] != 0.0:
            value *= 1.0 + s.sensor_gain_error + s.sensor_gain_error_axis[i]
        if s.cross_talk != 0.0:
            share = 0.0
            for j in range(CHANNELS):
                if j != i:
                    share += s.cross_talk_pattern[i, j] * s.wrench[j] / max(_range(s, j), 1e-9)
            value += s.cross_talk * share * _range(s, i)
        value += s.offset_f[i] if i < 3 else s.offset_m[i - 3]
        if i < 3 and drift != 0.0:
            value += s.zero_drift[i] * drift
        value += s.bias[i]
        s.reading[i] = value
    if not ideal:
        for pair in range(3):
            sigma = s.noise_f if 2 * pair < 3 else s.noise_m
            sigma_next = s.noise_f if 2 * pair + 1 < 3 else s.noise_m
            if sigma > 0.0 or sigma_next > 0.0:
                first, second = normal_pair(int(s.seed), int(s.counter), pair)
                s.reading[2 * pair] += sigma * first
                s.reading[2 * pair + 1] += sigma_next * second
    for i in range(CHANNELS):
        value = s.reading[i]
        step = s.resolution_f[i] if i < 3 else s.resolution_m[i - 3]
        if step > 0.0 and not ideal:
            value = step * math.floor(value / step + 0.5)
        full = _range(s, i)
        if s.clipping != 0.0:
            full *= 1.0 - s.clipping
        s.reading[i] = max(-full, min(full, value))


@kernel
def _compensate(s: Record) -> None:
    """Set s.clean from s.reading: minus weight, offset and hose polynomial, in S; Eq. (18) and its like for the moment."""
    mat_t_vec(s.R_BS, s.model_weight_B, s.work)
    cross(s.model_cog_S, s.work, s.work_m)
    for i in range(3):
        s.clean[i] = s.reading[i] - s.work[i] - s.model_offset_f[i]
        s.clean[3 + i] = s.reading[3 + i] - s.work_m[i] - s.model_offset_m[i]
    orientation_polynomial(s.terms, s.model_hose, s.work)
    cross(s.hose_point_S, s.work, s.work_m)
    for i in range(3):
        s.clean[i] -= s.work[i]
        s.clean[3 + i] -= s.work_m[i]


@kernel
def _to_tool(s: Record) -> None:
    """Outputs from s.reading and the filtered s.clean; Eqs. (19), (20), moment moved from S to T."""
    for i in range(3):
        s.f_S_raw[i] = s.reading[i]
        s.m_S_raw[i] = s.reading[3 + i]
        s.work[i] = s.clean[i]
    cross(s.p_ST_S, s.work, s.work_m)
    for i in range(3):
        s.work_m[i] = s.clean[3 + i] - s.work_m[i]
    mat_vec(s.R_TS, s.work, s.f_T_T)
    mat_vec(s.R_TS, s.work_m, s.m_T_T)


def init(s: Record) -> int:
    """State at t = 0: sensor at rest for long, filters settled on what it shows there without noise."""
    status = _prepare(s)
    if status != 0:
        return status
    s.counter = 0
    s.line_position = 0
    s.step_size = s.sample_time
    for i in range(CHANNELS):
        s.bias[i] = 0.0
    _place(s)
    for i in range(3):
        s.p_last[i] = s.p_BG_B[i]
        s.p_before[i] = s.p_BG_B[i]
    _load(s)
    _sense(s, 0.0, True)
    _compensate(s)
    for i in range(CHANNELS):
        delay_rest(s.line, LAG_CAPACITY, i, s.wrench[i])
        s.lag_input[i] = s.wrench[i]
        s.lag_output[i] = s.wrench[i]
    settle_filters(s)
    _sense(s, 0.0, False)
    _to_tool(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """One sample: reading and compensated force at t + h for the wrench and the axis angles given."""
    s.step_size = h
    if abs(h - s.sample_time) > 1e-9:
        return WRONG_STEP
    s.counter += 1
    for i in range(3):
        s.p_before[i] = s.p_last[i]
        s.p_last[i] = s.p_BG_B[i]
    _place(s)
    _load(s)
    if s.extra_lag > 0.0:
        s.line_position += 1
        if s.line_position >= LAG_CAPACITY:
            s.line_position = 0
        smooth = s.extra_lag_first_order * s.extra_lag
        samples = (s.extra_lag - smooth) / s.sample_time
        # 0.1 / 0.004 is 25.000000000000004: whole samples are meant
        if abs(samples - math.floor(samples + 0.5)) < 1e-9:
            samples = float(math.floor(samples + 0.5))
        for i in range(CHANNELS):
            s.wrench[i] = delay(s.line, LAG_CAPACITY, int(s.line_position), samples, i, s.wrench[i])
            if smooth > 0.0:
                late = s.wrench[i]
                s.wrench[i] = first_order(s.lag_output[i], s.lag_input[i], late, smooth, h)
                s.lag_input[i] = late
                s.lag_output[i] = s.wrench[i]
    if s.walk_f > 0.0 or s.walk_m > 0.0:
        root = math.sqrt(h / 60.0)
        for pair in range(3):
            first, second = normal_pair(int(s.seed), int(s.counter), 3 + pair)
            s.bias[2 * pair] += root * (s.walk_f if 2 * pair < 3 else s.walk_m) * first
            s.bias[2 * pair + 1] += root * (s.walk_f if 2 * pair + 1 < 3 else s.walk_m) * second
    _sense(s, t + h, False)
    _compensate(s)
    filter_sample(s)
    _to_tool(s)
    return 0


FILTER_STATES = (
    Variable("cutoff_used", "state", "Cut-off frequency in use", "Hz"),
    Variable("clean", "state", "Force (N) and moment (N m) after compensation, then after the filters, in S", "1", (CHANNELS,)),
    Variable("filter_b", "state", "Numerator of the low-pass", "1", (3,)),
    Variable("filter_a", "state", "Denominator of the low-pass", "1", (2,)),
    Variable("filter_z", "state", "State of the low-pass", "1", (CHANNELS, 2)),
    Variable("window_ring", "state", "Samples in the moving average", "1", (CHANNELS, WINDOW_CAPACITY)),
    Variable("window_position", "state", "Where the next sample goes", "1", kind="integer"),
)
"""What `prepare_filters`, `settle_filters` and `filter_sample` work on; a model that appends them has those filters."""

_COG_S = SPINDLE_ACROSS.p_FG_F - MOUNTING.p_FS_F
_HOSE_S = HOSE.p_FH_F - MOUNTING.p_FS_F
_WEIGHT_B = np.array([0.0, 0.0, -SPINDLE_ACROSS.mass * GRAVITY])

VARIABLES = (
    Variable("f_T_B", "input", "Cutting force on the tool at T, in B", "N", (3,)),
    Variable("m_T_B", "input", "Cutting moment on the tool about T, in B", "N.m", (3,)),
    Variable(
        "q", "input", "Axis angles A1..A6 of the motors", "rad", (6,), np.deg2rad([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]), display_unit="deg"
    ),
    Variable("f_S_raw", "output", "Force as the sensor reports it, in S", "N", (3,)),
    Variable("m_S_raw", "output", "Moment about S as the sensor reports it, in S", "N.m", (3,)),
    Variable("f_T_T", "output", "Force on the tool at T, compensated and filtered, in T", "N", (3,)),
    Variable("m_T_T", "output", "Moment on the tool about T, compensated and filtered, in T", "N.m", (3,)),
    # the sensor
    Variable("range_f", "parameter", "Largest force shown, x y z of S", "N", (3,), OMEGA160.range_f, 0.0),
    Variable("range_m", "parameter", "Largest moment shown, x y z of S", "N.m", (3,), OMEGA160.range_m, 0.0),
    Variable("resolution_f", "parameter", "Step of the force reading, x y z of S; 0 = continuous", "N", (3,), OMEGA160.resolution_f, 0.0),
    Variable(
        "resolution_m", "parameter", "Step of the moment reading, x y z of S; 0 = continuous", "N.m", (3,), OMEGA160.resolution_m, 0.0
    ),
    Variable("noise_f", "parameter", "Standard deviation of the white noise of each force sample", "N", (), OMEGA160.noise_f, 0.0),
    Variable("noise_m", "parameter", "Standard deviation of the white noise of each moment sample", "N.m", (), OMEGA160.noise_m, 0.0),
    Variable(
        "walk_f", "parameter", "Random walk of the force zero: standard deviation gained in one minute", "N", (), OMEGA160.walk_f, 0.0
    ),
    Variable(
        "walk_m", "parameter", "Random walk of the moment zero: standard deviation gained in one minute", "N.m", (), OMEGA160.walk_m, 0.0
    ),
    Variable(
        "seed", "parameter", "Seed of noise and random walk: another seed is another repeat of a run", "1", (), 1, 0, 2147483647, "integer"
    ),
    Variable("p_FS_F", "parameter", "Sensor origin from the flange, in F", "m", (3,), MOUNTING.p_FS_F, display_unit="mm"),
    Variable("quat_FS", "parameter", "Orientation of S in F, unit quaternion (w, x, y, z)", "1", (4,), MOUNTING.quat_FS, -1.0, 1.0),
    Variable("offset_f", "parameter", "Sensor-internal force offset F_SI, in S", "N", (3,), MOUNTING.offset_f),
    Variable("offset_m", "parameter", "Sensor-internal moment offset M_SI, in S", "N.m", (3,), MOUNTING.offset_m),
    Variable(
        "cross_talk_pattern",
        "parameter",
        "Channel i takes cross_talk * pattern[i,j] of channel j, both relative to full scale (Fx Fy Fz Mx My Mz)",
        "1",
        (6, 6),
        CONFERENCE_MATRIX,
        -10.0,
        10.0,
    ),
    # what hangs on it
    Variable("load_mass", "parameter", "Mass of the end effector on the sensor", "kg", (), SPINDLE_ACROSS.mass, 0.0, 1000.0),
    Variable(
        "load_cog_S", "parameter", "Centre of gravity of the end effector from the sensor, in S", "m", (3,), _COG_S, display_unit="mm"
    ),
    Variable("gravity_B", "parameter", "Acceleration of gravity in B; tilted for a tilted base", "m/s2", (3,), [0.0, 0.0, -GRAVITY]),
    Variable(
        "hose_coefficients",
        "parameter",
        "Pull of the hose pack in S: coefficients of Eq. (17), rows 1 q1 q2 q3 q4 q1q1 .. q3q4 of the orientation of S in B",
        "N",
        (FEATURES, 3),
        HOSE.coefficients,
    ),
    Variable(
        "hose_point_S", "parameter", "Point of the end effector at which the hose pack pulls, in S", "m", (3,), _HOSE_S, display_unit="mm"
    ),
    Variable(
        "hose_anchor_B", "parameter", "Point towards which the effect hose_force pulls, in B", "m", (3,), HOSE.anchor_B, display_unit="mm"
    ),
    # the compensation
    Variable("model_weight_B", "parameter", "Identified weight vector, in B", "N", (3,), _WEIGHT_B),
    Variable("model_cog_S", "parameter", "Identified centre of gravity from the sensor, in S", "m", (3,), _COG_S, display_unit="mm"),
    Variable("model_offset_f", "parameter", "Identified force offset, in S", "N", (3,), MOUNTING.offset_f),
    Variable("model_offset_m", "parameter", "Identified moment offset, in S", "N.m", (3,), MOUNTING.offset_m),
    Variable("model_hose", "parameter", "Identified coefficients of Eq. (17), in S", "N", (FEATURES, 3), HOSE.coefficients),
    Variable(
        "sample_time",
        "parameter",
        "Sampling time; the communication step must equal it",
        "s",
        (),
        FILTER.sample_time,
        1e-5,
        1.0,
        display_unit="ms",
    ),
    Variable("filter_cutoff", "parameter", "Cut-off frequency of the Butterworth low-pass; 0 = none", "Hz", (), FILTER.cutoff, 0.0),
    Variable(
        "filter_window",
        "parameter",
        "Length of the moving average in samples; 1 = none",
        "1",
        (),
        int(FILTER.window),
        1,
        WINDOW_CAPACITY,
        "integer",
    ),
    # effects
    Variable("sensor_gain_error", "parameter", "Relative gain error, the same in all six channels", "1", (), 0.0, -0.5, 0.5, effect=True),
    Variable("sensor_gain_error_axis", "parameter", "Relative gain error of Fx Fy Fz Mx My Mz", "1", (6,), 0.0, -0.5, 0.5, effect=True),
    Variable(
        "cross_talk", "parameter", "Cross-talk as a fraction of full scale, times cross_talk_pattern", "1", (), 0.0, -0.2, 0.2, effect=True
    ),
    Variable(
        "zero_drift", "parameter", "Drift of the force zero that is reached in the end, in S", "N", (3,), 0.0, -200.0, 200.0, effect=True
    ),
    Variable("zero_drift_time", "parameter", "Time constant of zero_drift", "s", (), 600.0, 0.1, 1e5),
    Variable("zero_age", "parameter", "Time since the zero was set when the run begins", "s", (), 3600.0, 0.0, 1e7),
    Variable(
        "misalignment",
        "parameter",
        "Rotation vector in S by which the sensor is turned against its nominal mounting",
        "rad",
        (3,),
        0.0,
        -0.5,
        0.5,
        display_unit="deg",
        effect=True,
    ),
    Variable(
        "extra_lag", "parameter", "Additional dead time of the sensor's electronics", "s", (), 0.0, 0.0, 0.5, display_unit="ms", effect=True
    ),
    Variable("extra_lag_first_order", "parameter", "Part of extra_lag that is a first-order lag, not a dead time", "1", (), 0.0, 0.0, 1.0),
    Variable(
        "weight_error",
        "parameter",
        "Mass of the end effector that the identification does not know of",
        "kg",
        (),
        0.0,
        -50.0,
        50.0,
        effect=True,
    ),
    Variable(
        "inertia",
        "parameter",
        "Share of the inertial force of the end effector that the sensor feels (a real one: 1)",
        "1",
        (),
        0.0,
        0.0,
        1.0,
        effect=True,
    ),
    Variable(
        "hose_force",
        "parameter",
        "Pull of the hose pack towards hose_anchor_B that the identification does not know of",
        "N",
        (),
        0.0,
        -200.0,
        200.0,
        effect=True,
    ),
    Variable("clipping", "parameter", "Part of the measuring range that is lost", "1", (), 0.0, 0.0, 0.99, effect=True),
    Variable(
        "cutoff_error", "parameter", "Relative error of the cut-off frequency (mismatched filter)", "1", (), 0.0, -0.9, 2.0, effect=True
    ),
    # states
    *robot_variables(KR300, SPINDLE_ACROSS),
    *FILTER_STATES,
    Variable("counter", "state", "Samples since the start", "1", kind="integer"),
    Variable("step_size", "state", "Step size of the last call", "s"),
    Variable("misaligned", "state", "Whether misalignment is not zero", "1", kind="boolean"),
    Variable("R_FS", "state", "Orientation of S in F", "1", (3, 3)),
    Variable("R_TS", "state", "Orientation of S in T", "1", (3, 3)),
    Variable("R_BS", "state", "Orientation of S in B", "1", (3, 3)),
    Variable("R_mis", "state", "Rotation of the misaligned sensor", "1", (3, 3)),
    Variable("quat_mis", "state", "The same as quaternion", "1", (4,)),
    Variable("quat_BS", "state", "Orientation of S in B, unit quaternion (w, x, y, z), w >= 0", "1", (4,)),
    Variable("terms", "state", "Terms of Eq. (17)", "1", (FEATURES,)),
    Variable("p_ST_S", "state", "Tool tip from the sensor, in S", "m", (3,)),
    Variable("p_BS_B", "state", "Sensor origin in B", "m", (3,)),
    Variable("p_BG_B", "state", "Centre of gravity of the end effector in B", "m", (3,)),
    Variable("p_last", "state", "The same one sample ago", "m", (3,)),
    Variable("p_before", "state", "The same two samples ago", "m", (3,)),
    Variable("wrench", "state", "Force (N) and moment (N m) that act on the sensor", "1", (CHANNELS,)),
    Variable("reading", "state", "Force (N) and moment (N m) that the sensor shows", "1", (CHANNELS,)),
    Variable("bias", "state", "Random walk of the zero, N and N m", "1", (CHANNELS,)),
    Variable("line", "state", "Delay line of extra_lag", "1", (CHANNELS, LAG_CAPACITY)),
    Variable("line_position", "state", "Where the last sample is", "1", kind="integer"),
    Variable("lag_input", "state", "Input of the first-order part of extra_lag", "1", (CHANNELS,)),
    Variable("lag_output", "state", "Output of it", "1", (CHANNELS,)),
    Variable("work", "state", "Scratch", "1", (3,)),
    Variable("work_m", "state", "Scratch", "1", (3,)),
    Variable("lever", "state", "Scratch", "m", (3,)),
)

MODEL = Model(
    "sensor_chain",
    "Force-torque sensor with weight, hose pack and offsets; compensation, filters, force at the tool tip (Haehn & Weigold 2020, sec. 2.6)",
    VARIABLES,
    init,
    step,
    (
        "",
        "the step size is {step_size:g} s at t = {t:g} s, but the filters are designed for sample_time = {sample_time:g} s; "
        "set the parameter sample_time to the communication step",
        "the low-pass cannot have its cut-off at {cutoff_used:g} Hz when sampled every {sample_time:g} s; "
        "filter_cutoff must stay below 0.5/sample_time (0 switches it off)",
        "filter_window is {filter_window}, expected 1 to " + str(WINDOW_CAPACITY) + " samples",
        "extra_lag is {extra_lag:g} s, the delay line holds " + str(LAG_CAPACITY - 2) + " samples of sample_time = {sample_time:g} s; "
        "shorten the lag or sample more slowly",
        "quat_FS ({quat_FS[0]:g}, {quat_FS[1]:g}, {quat_FS[2]:g}, {quat_FS[3]:g}) has not the length 1; give the orientation of S in F as "
        "a unit quaternion (w, x, y, z)",
    ),
)
