"""Component spindle_holder: force at the tool from six strain-gauge bridges on the spindle holder (paper 001, secs. 3 and 4).

It takes the place of `sensor_chain` by one line of the system file: same inputs, same outputs and more. First the holder: the force
at the tool strains six measuring places; full bridges turn strain into mV/V, terminals add noise and steps. Then the signal
processing: the measurement matrix, Eq. (8), the weight of the spindle, low-pass and moving average of `sensor_chain`.
Truth and compensation have parameters of their own, equal by default. Forces act ON the tool.
Frames: T tool tip, B robot base, H holder: z_H = x_T out of the spindle, y_H = y_T, x_H = -z_T; it is the S of the outputs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from robomill.models.components.sensor_chain import (
    CONFERENCE_MATRIX,
    FILTER_STATES,
    WRONG_CUTOFF,
    WRONG_STEP,
    WRONG_WINDOW,
    filter_sample,
    prepare_filters,
    settle_filters,
)
from robomill.models.components.sensor_chain import GRAVITY as FREE_FALL
from robomill.models.components.sensor_chain import MODEL as SENSOR_CHAIN
from robomill.models.maths.elementary import exp
from robomill.models.maths.frames import cross, mat_t_vec
from robomill.models.maths.noise import normal_pair
from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.model.parameters import load, quantity
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS, forward, robot_variables

BRIDGES = 6
WATCH, SAFE, STOP = 0, 1, 2
SINGULAR, DEAD, NOT_FINITE, WRONG_RESPONSE, NO_LEVER = 4, 5, 6, 7, 8
_LARGEST = 1e7
"""Force [N], moment [N.m] or angle [rad] beyond which an input is none."""
_FLAT = 1e-12
"""Determinant of M M^T over that of three perpendicular rows of the same lengths, below which M does not tell three forces apart."""
_SILENT = 1e-9
"""Share of a channel that the other five cannot tell: below it a channel is needed and cannot be found out."""


@dataclass(frozen=True)
class SpindleHolder:
    """A spindle holder with strain gauges, from a file in models/data/sensors; x, y, z of H, bridges 1..6."""

    name: str
    """Name for people."""
    strain_force: FloatArray = field(metadata=quantity("1/N"))
    """Strain of each measuring place by a force along x, y, z at the calibrated attack point."""
    lever: float = field(metadata=quantity("m", 1e-6))
    """From the holder to that point."""
    gauge_factor: float = field(metadata=quantity("1", 0.0))
    """Relative change of resistance over strain."""
    poisson: float = field(metadata=quantity("1", 0.0, 0.5))
    """Poisson's ratio of the holder."""
    supply: float = field(metadata=quantity("V", 1e-3))
    """Supply voltage of the bridges."""
    amplifier_noise: float = field(metadata=quantity("V", 0.0))
    """Standard deviation of a sample."""
    resolution: float = field(metadata=quantity("mV/V", 0.0))
    """Step of a bridge."""
    bridge_range: float = field(metadata=quantity("mV/V", 0.0))
    """Largest signal of a bridge."""
    force_range: FloatArray = field(metadata=quantity("N", 0.0))
    """Largest force that is measured."""
    measurement_matrix: FloatArray = field(metadata=quantity("N"))
    """Force along x, y, z from the signals of bridges 1 to 6; marks the file as one of a spindle holder."""
    bridge_zero: FloatArray = field(metadata=quantity("mV/V"))
    """Signal of each bridge without load."""
    spindle_mass: float = field(metadata=quantity("kg", 0.0))
    """Mass of the spindle."""
    spindle_cog: FloatArray = field(metadata=quantity("m"))
    """Its centre of gravity in H."""

    def __post_init__(self) -> None:
        """Refuse arrays of another shape."""
        shapes = {
            "strain_force": (BRIDGES, 3),
            "force_range": (3,),
            "measurement_matrix": (3, BRIDGES),
            "bridge_zero": (BRIDGES,),
            "spindle_cog": (3,),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"spindle holder {self.name!r}: {name} has shape {np.shape(getattr(self, name))}, expected {shape}")

    @property
    def bridge_force(self) -> FloatArray:
        """Bridge reading [V/V] per force [N] along x, y, z of H at the calibrated attack point, (6, 3): U/U_A = k/4 (2 + 2 nu) strain."""
        return 0.25 * self.gauge_factor * (2.0 + 2.0 * self.poisson) * self.strain_force


HOLDER = load(SpindleHolder, "sensors/spindle_holder")
"""The holder of paper 001."""


@kernel
def _invert(a: FloatArray, inverse: FloatArray) -> float:
    """Set the inverse (3, 3) of the symmetric a by its cofactors; returns det a / (a00 a11 a22), and leaves it alone where that is 0."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    size = a[0, 0] * a[1, 1] * a[2, 2]
    if not det > 0.0:
        return 0.0
    inverse[0, 0] = c00 / det
    inverse[0, 1] = c01 / det
    inverse[0, 2] = c02 / det
    inverse[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) / det
    inverse[1, 2] = (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]) / det
    inverse[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) / det
    inverse[1, 0] = inverse[0, 1]
    inverse[2, 0] = inverse[0, 2]
    inverse[2, 1] = inverse[1, 2]
    relative: float = det / size
    return relative


@kernel
def _prepare(s: Record) -> int:
    """Everything that follows from parameters alone: filters, what bridges a force would give. Returns a status."""
    status: int = prepare_filters(s, s.filter_cutoff)
    if status != 0:
        return status
    if s.fault_response < WATCH or s.fault_response > STOP:
        return WRONG_RESPONSE
    if not s.lever > 0.0:
        return NO_LEVER
    for i in range(3):
        for j in range(3):
            s.square[i, j] = 0.0
            for b in range(BRIDGES):
                s.square[i, j] += s.measurement_matrix[i, b] * s.measurement_matrix[j, b]
    if not _invert(s.square, s.square_inverse) > _FLAT:
        return SINGULAR
    # M^+ = M^T (M M^T)^-1: the readings that belong to a force, as the matrix has it
    for b in range(BRIDGES):
        s.free[b] = 1.0
        for j in range(3):
            total = 0.0
            for i in range(3):
                total += s.measurement_matrix[i, b] * s.square_inverse[i, j]
            s.expected[b, j] = total
            s.free[b] -= total * s.measurement_matrix[j, b]
    return 0


@kernel
def _check_inputs(s: Record) -> int:
    """Refuse what is not finite."""
    for i in range(3):
        if not (abs(s.f_T_B[i]) < _LARGEST and abs(s.m_T_B[i]) < _LARGEST):
            return NOT_FINITE
    for i in range(6):
        if not abs(s.q[i]) < _LARGEST:
            return NOT_FINITE
    return 0


@kernel
def _place(s: Record) -> None:
    """Orientation s.R_BH of the holder at s.q."""
    forward(s, s.q)
    for r in range(3):
        s.R_BH[r, 0] = -s.link_R[6, r, 2]
        s.R_BH[r, 1] = s.link_R[6, r, 1]
        s.R_BH[r, 2] = s.link_R[6, r, 0]


@kernel
def _felt(s: Record, p: FloatArray, force: FloatArray, moment: FloatArray, felt: FloatArray) -> None:
    """Set felt [N, 3]: the force at the calibrated attack point that strains the holder like `force` at p [m] with `moment`, all in H.

    The gauges feel bending in the measuring section and the axial force: felt = (M_y / L, -M_x / L, f_z), M = p x f + m.
    """
    cross(p, force, s.bending)
    felt[0] = (s.bending[1] + moment[1]) / s.lever
    felt[1] = -(s.bending[0] + moment[0]) / s.lever
    felt[2] = force[2]


@kernel
def _strain(s: Record) -> None:
    """Set s.ratio [V/V]: what the full bridges give without electronics, from force, moment and the weight of the spindle."""
    mat_t_vec(s.R_BH, s.f_T_B, s.work)
    mat_t_vec(s.R_BH, s.m_T_B, s.work_m)
    s.point[0] = -s.attack_point[2]
    s.point[1] = s.attack_point[1]
    s.point[2] = s.lever + s.attack_point[0]
    _felt(s, s.point, s.work, s.work_m, s.load)
    for i in range(3):
        s.work[i] = s.spindle_mass * s.gravity_B[i]
        s.work_m[i] = 0.0
    mat_t_vec(s.R_BH, s.work, s.force)
    _felt(s, s.spindle_cog, s.force, s.work_m, s.weight)
    scale = 0.25 * s.gauge_factor * (2.0 + 2.0 * s.poisson)
    for b in range(BRIDGES):
        strain = 0.0
        for i in range(3):
            strain += s.strain_force[b, i] * (s.load[i] + s.weight[i])
        s.ratio[b] = scale * strain


@kernel
def _read(s: Record, time: float, ideal: bool) -> None:
    """Output bridge [V/V] from s.ratio: gain, cross-talk, zero and temperature, dead channels, noise, steps, range. `time` in s.

    `ideal` leaves noise and steps out: the value about which the reading scatters.
    """
    rise = s.temperature_rise * (1.0 - exp(-(time + s.zero_age) / s.temperature_time))
    for b in range(BRIDGES):
        value = s.ratio[b]
        if s.bridge_gain_error[b] != 0.0:
            value *= 1.0 + s.bridge_gain_error[b]
        if s.cross_talk != 0.0:
            for c in range(BRIDGES):
                value += s.cross_talk * CONFERENCE_MATRIX[b, c] * s.ratio[c]
        value += s.zero[b]
        if s.temperature_zero[b] != 0.0:
            value += s.temperature_zero[b] * rise
        if s.dead_channel[b] != 0.0:
            value *= 1.0 - s.dead_channel[b]
        s.bridge[b] = value
    sigma = s.amplifier_noise / s.supply * (1.0 + s.noise_error)
    if sigma > 0.0 and not ideal:
        for pair in range(3):
            first, second = normal_pair(int(s.seed), int(s.counter), pair)
            s.bridge[2 * pair] += sigma * first
            s.bridge[2 * pair + 1] += sigma * second
    s.overload = 0
    for b in range(BRIDGES):
        value = s.bridge[b]
        if s.resolution > 0.0 and not ideal:
            value = s.resolution * math.floor(value / s.resolution + 0.5)
        if abs(value) > s.bridge_range:
            s.overload = 1
        s.bridge[b] = max(-s.bridge_range, min(s.bridge_range, value))


@kernel
def _measure(s: Record) -> None:
    """Eq. (8), f = M s: s.reading [N, 3] with its overload, outputs parity [V/V] and s.left, s.clean without the weight, all in H."""
    for i in range(3):
        total = 0.0
        for b in range(BRIDGES):
            total += s.measurement_matrix[i, b] * (s.bridge[b] - s.bridge_zero[b])
        s.force[i] = total
    square = 0.0
    for b in range(BRIDGES):
        s.left[b] = s.bridge[b] - s.bridge_zero[b]
        for i in range(3):
            s.left[b] -= s.expected[b, i] * s.force[i]
        square += s.left[b] * s.left[b]
    s.parity = math.sqrt(square)
    for i in range(3):
        s.work[i] = 0.0
    mat_t_vec(s.R_BH, s.spindle_weight_B, s.point)
    _felt(s, s.spindle_weight_cog, s.point, s.work, s.weight)
    for i in range(3):
        # the range is that of the force on the tool: the weight of the spindle is always there
        if abs(s.force[i] - s.weight[i]) > s.force_range[i]:
            s.overload = 1
        s.clean[i] = max(-s.force_range[i], min(s.force_range[i], s.force[i] - s.weight[i]))
        s.clean[3 + i] = 0.0
        s.f_S_raw[i] = s.clean[i] + s.weight[i]
        s.m_S_raw[i] = 0.0


@kernel
def _watch(s: Record, h: float) -> int:
    """Find a dead channel: six readings of three forces must agree. Outputs fault and trust; returns a status."""
    s.doubt = s.doubt + 1 if s.parity > s.parity_limit else 0
    if s.fault == 0 and s.doubt > 0 and s.doubt * h > s.parity_time - 1e-9:
        worst = -1.0
        for b in range(BRIDGES):
            # the share of the square that a fault of bridge b alone explains
            explained = s.left[b] * s.left[b] / s.free[b] if s.free[b] > _SILENT else 0.0
            if explained > worst:
                worst = explained
                s.fault = b + 1
    if s.fault == 0 or s.fault_response == WATCH:
        return 0
    if s.fault_response == STOP:
        return DEAD
    s.trust = max(0.0, s.trust - h / s.fault_ramp) if s.fault_ramp > 0.0 else 0.0
    return 0


@kernel
def _to_tool(s: Record) -> None:
    """Outputs f_T_T [N] and m_T_T: the filtered force in T; the holder knows no moment."""
    s.f_T_T[0] = s.trust * s.clean[2]
    s.f_T_T[1] = s.trust * s.clean[1]
    s.f_T_T[2] = -s.trust * s.clean[0]
    for i in range(3):
        s.m_T_T[i] = 0.0


def init(s: Record) -> int:
    """State at t = 0: holder at rest for long, filters settled on what it shows there without noise."""
    status = _prepare(s)
    if status == 0:
        status = _check_inputs(s)
    if status != 0:
        return status
    s.counter = 0
    s.doubt = 0
    s.fault = 0
    s.trust = 1.0
    s.step_size = s.sample_time
    _place(s)
    _strain(s)
    _read(s, 0.0, True)
    _measure(s)
    settle_filters(s)
    _to_tool(s)
    for i in range(3):
        s.work_m[i] = s.clean[i]
    _read(s, 0.0, False)
    _measure(s)
    for i in range(3):
        s.clean[i] = s.work_m[i]
    return 0


def step(s: Record, t: float, h: float) -> int:
    """One sample: bridges and force at t + h for the load and the axis angles given."""
    s.step_size = h
    if abs(h - s.sample_time) > 1e-9:
        return WRONG_STEP
    status = _check_inputs(s)
    if status != 0:
        return status
    s.counter += 1
    _place(s)
    _strain(s)
    _read(s, t + h, False)
    _measure(s)
    status = _watch(s, h)
    if status != 0:
        return status
    filter_sample(s)
    _to_tool(s)
    return 0


_PORTS = tuple(v for v in SENSOR_CHAIN.variables if v.causality in ("input", "output"))
_SHARED = tuple(SENSOR_CHAIN.variable(name) for name in ("seed", "gravity_B", "sample_time", "filter_cutoff", "filter_window"))
"""Parameters that mean there what they mean here."""
_OUTPUTS = (
    Variable("bridge", "output", "Reading of bridges 1..6", "1", (BRIDGES,), display_unit="mV/V"),
    Variable("parity", "output", "What no force explains of the six readings", "1", display_unit="mV/V"),
    Variable("trust", "output", "Share of the force that is passed on: 1, falls to 0 after a fault with fault_response = 1"),
    Variable("fault", "output", "Bridge 1..6 that was found dead; 0 = none", "1", kind="integer"),
    Variable("overload", "output", "Force or bridge beyond its range", kind="boolean"),
)

VARIABLES = (
    *_PORTS,
    *_OUTPUTS,
    # the holder
    Variable(
        "strain_force",
        "parameter",
        "Strain of measuring places 1..6 (rows) per force along x, y, z of H at the calibrated attack point",
        "1/N",
        (BRIDGES, 3),
        HOLDER.strain_force,
        display_unit="um/(N.m)",
    ),
    Variable("lever", "parameter", "Measuring section to the calibrated attack point", "m", (), HOLDER.lever, display_unit="mm"),
    Variable("gauge_factor", "parameter", "Relative change of resistance per strain", "1", (), HOLDER.gauge_factor, 0.0),
    Variable(
        "poisson", "parameter", "Share of the strain that the crosswise gauges see, with opposite sign", "1", (), HOLDER.poisson, 0.0, 0.5
    ),
    Variable("supply", "parameter", "Supply of the bridges", "V", (), HOLDER.supply, 1e-3),
    Variable(
        "amplifier_noise",
        "parameter",
        "Standard deviation of the white noise of each sample, at the input",
        "V",
        (),
        HOLDER.amplifier_noise,
        0.0,
        display_unit="uV",
    ),
    Variable("resolution", "parameter", "Step of the reading; 0 = continuous", "1", (), HOLDER.resolution, 0.0, display_unit="mV/V"),
    Variable("bridge_range", "parameter", "Largest reading of a bridge", "1", (), HOLDER.bridge_range, 0.0, display_unit="mV/V"),
    Variable("zero", "parameter", "Reading of the bridges without strain", "1", (BRIDGES,), HOLDER.bridge_zero, display_unit="mV/V"),
    Variable("temperature_rise", "parameter", "Temperature that the holder gains since it was tared, in the end", "K", (), 10.0),
    Variable("temperature_time", "parameter", "Time constant of the temperature", "s", (), 1200.0, 0.1, 1e5, display_unit="min"),
    Variable(
        "zero_age", "parameter", "Time since the bridges were tared when the run begins", "s", (), 3600.0, 0.0, 1e7, display_unit="min"
    ),
    Variable("spindle_mass", "parameter", "Mass that hangs on the measuring places", "kg", (), HOLDER.spindle_mass, 0.0, 1000.0),
    Variable(
        "spindle_cog",
        "parameter",
        "Its centre of gravity from the measuring section, in H",
        "m",
        (3,),
        HOLDER.spindle_cog,
        display_unit="mm",
    ),
    # the signal processing
    Variable(
        "measurement_matrix",
        "parameter",
        "M of Eq. (8): force along x, y, z of H (rows) per reading of bridges 1..6",
        "N",
        (3, BRIDGES),
        HOLDER.measurement_matrix,
        display_unit="N.V/mV",
    ),
    Variable(
        "bridge_zero", "parameter", "Tared reading, subtracted before the matrix", "1", (BRIDGES,), HOLDER.bridge_zero, display_unit="mV/V"
    ),
    Variable("force_range", "parameter", "Largest force on the tool shown, x y z of H", "N", (3,), HOLDER.force_range, 0.0),
    Variable(
        "spindle_weight_B", "parameter", "Identified weight of the spindle, in B", "N", (3,), [0.0, 0.0, -HOLDER.spindle_mass * FREE_FALL]
    ),
    Variable(
        "spindle_weight_cog",
        "parameter",
        "Identified centre of gravity from the measuring section, in H",
        "m",
        (3,),
        HOLDER.spindle_cog,
        display_unit="mm",
    ),
    *_SHARED,
    Variable("parity_limit", "parameter", "Parity beyond which the bridges contradict each other", "1", (), 2e-5, 0.0, display_unit="mV/V"),
    Variable(
        "parity_time",
        "parameter",
        "Time for which they must do so until a channel is called dead",
        "s",
        (),
        0.02,
        0.0,
        10.0,
        display_unit="ms",
    ),
    Variable(
        "fault_response",
        "parameter",
        "After a dead channel: 0 = report it, 1 = the force goes to zero, 2 = error",
        "1",
        (),
        SAFE,
        WATCH,
        STOP,
        "integer",
    ),
    Variable("fault_ramp", "parameter", "Time in which the force goes to zero then", "s", (), 0.2, 0.0, 10.0, display_unit="ms"),
    # effects
    Variable("bridge_gain_error", "parameter", "Relative gain error of bridges 1..6", "1", (BRIDGES,), 0.0, -0.5, 0.5, effect=True),
    Variable(
        "temperature_zero",
        "parameter",
        "Drift of the zero of bridges 1..6 with temperature, times temperature_rise",
        "1/K",
        (BRIDGES,),
        0.0,
        -1e-4,
        1e-4,
        effect=True,
    ),
    Variable("noise_error", "parameter", "Noise beyond amplifier_noise, relative to it", "1", (), 0.0, -1.0, 100.0, effect=True),
    Variable(
        "cross_talk", "parameter", "Share that each bridge takes of each other one, signs balanced", "1", (), 0.0, -0.2, 0.2, effect=True
    ),
    Variable(
        "dead_channel",
        "parameter",
        "Part of the signal of bridges 1..6 that is lost; 1 = dead",
        "1",
        (BRIDGES,),
        0.0,
        0.0,
        1.0,
        effect=True,
    ),
    Variable(
        "attack_point",
        "parameter",
        "Where the force acts, from the calibrated attack point, in T: x = a longer tool",
        "m",
        (3,),
        0.0,
        -0.1,
        0.1,
        display_unit="mm",
        effect=True,
    ),
    # states
    *robot_variables(KR300, SPINDLE_ACROSS),
    *FILTER_STATES,
    Variable("counter", "state", "Samples since the start", "1", kind="integer"),
    Variable("doubt", "state", "Samples in a row whose parity is beyond its limit", "1", kind="integer"),
    Variable("step_size", "state", "Step size of the last call", "s"),
    Variable("R_BH", "state", "Orientation of H in B", "1", (3, 3)),
    Variable("ratio", "state", "Bridges without electronics, V/V", "1", (BRIDGES,)),
    Variable("expected", "state", "Readings that belong to a force, 1/N", "1/N", (BRIDGES, 3)),
    Variable("free", "state", "Share of each channel that the others check", "1", (BRIDGES,)),
    Variable("left", "state", "What no force explains of each reading, V/V", "1", (BRIDGES,)),
    Variable("square", "state", "Scratch: M M^T", "1", (3, 3)),
    Variable("square_inverse", "state", "Scratch: its inverse", "1", (3, 3)),
    Variable("load", "state", "Force at the calibrated attack point that strains the holder like the process", "N", (3,)),
    Variable("weight", "state", "The same of the weight of the spindle", "N", (3,)),
    Variable("force", "state", "Force as the matrix has it, in H", "N", (3,)),
    Variable("point", "state", "Scratch", "1", (3,)),
    Variable("bending", "state", "Scratch", "N.m", (3,)),
    Variable("work", "state", "Scratch", "1", (3,)),
    Variable("work_m", "state", "Scratch", "1", (3,)),
)

MODEL = Model(
    "spindle_holder",
    "Sensing spindle holder: six strain-gauge bridges, measurement matrix, filters, force at the tool tip (paper 001, secs. 3 and 4)",
    VARIABLES,
    init,
    step,
    (
        "",
        SENSOR_CHAIN.errors[WRONG_STEP],
        SENSOR_CHAIN.errors[WRONG_CUTOFF],
        SENSOR_CHAIN.errors[WRONG_WINDOW],
        "measurement_matrix is singular: its three rows do not tell three forces apart; expected the result of a calibration "
        "with loads along x, y and z (robomill identify sensor)",
        "bridge {fault} contradicts the others at t = {t:g} s: parity {parity:g} V/V, limit {parity_limit:g} V/V; check its wiring and "
        "gauges, or set fault_response = 1 to go on without force measurement",
        "f_T_B = {f_T_B} N, m_T_B = {m_T_B} N.m, q = {q} rad at t = {t:g} s, expected finite numbers below 1e7; check the "
        "component that feeds it",
        "fault_response is {fault_response}, expected 0 (report), 1 (the force goes to zero) or 2 (error)",
        "lever is {lever} m, expected a positive distance from the measuring section to the attack point",
    ),
)
