"""Effects that no catalogue entry can express, and other formulations of some that the catalogue has.

Each is a set of functions at three places of the signal flow (`Changes`) or on a recorded column. `link` lies between the
drives and the compliance, `cut` behind the cutting force, `sense` before the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

import numpy as np

from robomill.blind.insert import Function
from robomill.models.components.robot_drive import MODEL as DRIVE
from robomill.models.model.declaration import FloatArray

_START = {v.name: v.start_values for v in DRIVE.variables if v.causality == "parameter" and v.kind != "table"}
GEAR = np.asarray(_START["gear_ratio"])

MOVES = 1e-6
"""Angle [rad] in a step beyond which an axis moves in a sense of its own; what is less is noise of an axis that rests."""
CHIPS = 20.0
"""Force [N] on one axis beyond which the tool makes chips: with less the tool is in the air, or only rubs."""

Columns = dict[str, FloatArray]
After = Callable[[Columns, FloatArray, float], None]
"""(recorded columns by element name, true times [s], step [s]): changes the columns in place."""


@dataclass(frozen=True)
class Changes:
    """What is put into the generator's system. `link`: q[6], f[3] -> q[6]; `cut` and `sense`: f[3], m[3] -> f[3], m[3]."""

    link: Callable[[], Function] | None = None
    cut: Callable[[], Function] | None = None
    sense: Callable[[], Function] | None = None
    after: After | None = None


@dataclass(frozen=True)
class Outside:
    """One kind: where it belongs (None: no component of the system) and how it is made from a strength in 0..1 (log scale)."""

    name: str
    component: str | None
    low: float
    high: float
    unit: str
    make: Callable[[float, np.random.Generator], Changes] = field(repr=False)
    text: str = ""

    def draw(self, random: np.random.Generator) -> tuple[float, Changes]:
        """Strength, log-uniform [unit], and the changes."""
        value = float(self.low * (self.high / self.low) ** random.random())
        return value, self.make(value, random)


def joint_torques(q: FloatArray, f_T_B: FloatArray) -> FloatArray:
    """Torques [N m], (6,), in the sense of A1..A6 of a force [N] at the tool tip: J^T f, from the modified DH table (numpy, own code)."""
    alpha, a, d = _START["dh_alpha"], _START["dh_a"], _START["dh_d"]
    theta = _START["axis_sign"] * q + _START["dh_offset"]
    X = np.eye(4)
    axes, origins = np.zeros((6, 3)), np.zeros((6, 3))
    for i in range(6):
        ca, sa, ct, st = math.cos(alpha[i]), math.sin(alpha[i]), math.cos(theta[i]), math.sin(theta[i])
        X = X @ np.array(
            [[ct, -st, 0.0, a[i]], [st * ca, ct * ca, -sa, -sa * d[i]], [st * sa, ct * sa, ca, ca * d[i]], [0.0, 0.0, 0.0, 1.0]]
        )
        axes[i], origins[i] = X[:3, 2], X[:3, 3]
    tip = X[:3, :3] @ _START["p_FT_F"] + X[:3, 3]
    torques: FloatArray = _START["axis_sign"] * np.einsum("ij,ij->i", axes, np.cross(tip - origins, f_T_B))
    return torques


def _joint(random: np.random.Generator) -> int:
    return int(random.integers(0, 6))


def _periodic_stiffness(value: float, random: np.random.Generator) -> Changes:
    i, lobes = int(random.integers(0, 3)), 150.0 + 100.0 * random.random()

    def make() -> Function:
        def link(t: float, h: float, u: FloatArray) -> FloatArray:
            q = u[:6].copy()
            q[i] += value * joint_torques(u[:6], u[6:])[i] * math.sin(lobes * u[i])
            return q

        return link

    return Changes(link=make)


def _coupling(value: float, random: np.random.Generator) -> Changes:
    i, j = (int(k) for k in random.choice(6, 2, replace=False))

    def make() -> Function:
        start: list[float] = []

        def link(t: float, h: float, u: FloatArray) -> FloatArray:
            if h == 0.0 or not start:
                start[:] = [u[j]]
            q = u[:6].copy()
            q[i] += value * (u[j] - start[0])
            return q

        return link

    return Changes(link=make)


def _windup(value: float, random: np.random.Generator) -> Changes:
    i = _joint(random)

    def make() -> Function:
        last: list[float] = []
        rate = [0.0]

        def link(t: float, h: float, u: FloatArray) -> FloatArray:
            if h > 0.0 and last:
                rate[0] += 0.1 * ((u[i] - last[0]) / h - rate[0])  # the drive holds over two fine steps: smoothed
            last[:] = [u[i]]
            q = u[:6].copy()
            q[i] -= value * rate[0] * abs(rate[0])
            return q

        return link

    return Changes(link=make)


def _creep(value: float, random: np.random.Generator) -> Changes:
    i, tau = int(random.integers(0, 3)), 0.5 + random.random()

    def make() -> Function:
        state = [0.0]

        def link(t: float, h: float, u: FloatArray) -> FloatArray:
            state[0] += (1.0 - math.exp(-h / tau)) * (value * joint_torques(u[:6], u[6:])[i] - state[0])
            q = u[:6].copy()
            q[i] += state[0]
            return q

        return link

    return Changes(link=make)


def _ringing(value: float, random: np.random.Generator) -> Changes:
    i, omega, tau = int(random.integers(0, 3)), 2.0 * math.pi * (6.0 + 6.0 * random.random()), 0.25

    def make() -> Function:
        last: list[float] = []
        state = [0.0, 0.0, 0.0]  # sense of the last motion, time and sign of the last reversal

        def link(t: float, h: float, u: FloatArray) -> FloatArray:
            if last and abs(u[i] - last[0]) > MOVES:
                sense = math.copysign(1.0, u[i] - last[0])
                if state[0] not in (0.0, sense):
                    state[1], state[2] = t, sense
                state[0] = sense
            last[:] = [u[i]]
            q = u[:6].copy()
            if state[2] != 0.0:
                age = t - state[1]
                q[i] += state[2] * value * math.exp(-age / tau) * math.sin(omega * age)
            return q

        return link

    return Changes(link=make)


def _floor(value: float, random: np.random.Generator) -> Changes:
    """Vibration of the floor: a sinusoid in the tool-tip position, independent of everything, through the axes 1 and 2."""
    omega, phase, i = 2.0 * math.pi * (3.0 + 6.0 * random.random()), 6.28 * random.random(), int(random.integers(0, 3))

    def make() -> Function:
        def link(t: float, h: float, u: FloatArray) -> FloatArray:
            q = u[:6].copy()
            q[i] += value * math.sin(omega * t + phase)
            return q

        return link

    return Changes(link=make)


def _scaled(gain: Callable[[float, float, FloatArray, list[float]], FloatArray]) -> Callable[[], Function]:
    """An insert on forces and moments that multiplies the force by gain(t, h, f, memory) element-wise and the moment by its mean."""

    def make() -> Function:
        memory = [0.0]

        def function(t: float, h: float, u: FloatArray) -> FloatArray:
            g = gain(t, h, u[:3], memory)
            return np.concatenate([g * u[:3], float(np.mean(g)) * u[3:]])

        return function

    return make


def _warming_sensor(value: float, random: np.random.Generator) -> Changes:
    tau = 2.0 + 3.0 * random.random()
    return Changes(sense=_scaled(lambda t, h, f, memory: np.full(3, 1.0 + value * (1.0 - math.exp(-t / tau)))))


def _quadratic_sensor(value: float, random: np.random.Generator) -> Changes:
    reference = 300.0

    def gain(t: float, h: float, f: FloatArray, memory: list[float]) -> FloatArray:
        scaled: FloatArray = 1.0 + value * (f / reference - 0.5)  # odd and even parts: no single gain expresses it
        return scaled

    return Changes(sense=_scaled(gain))


def _grain(value: float, random: np.random.Generator) -> Changes:
    phase = 3.14 * random.random()

    def gain(t: float, h: float, f: FloatArray, memory: list[float]) -> FloatArray:
        heading = math.atan2(f[1], f[0])
        return np.full(3, 1.0 + value * math.cos(2.0 * (heading - phase)))

    return Changes(cut=_scaled(gain))


def _packing(value: float, random: np.random.Generator) -> Changes:
    def gain(t: float, h: float, f: FloatArray, memory: list[float]) -> FloatArray:
        if float(np.abs(f).max()) > CHIPS:
            memory[0] += h
        else:
            memory[0] *= math.exp(-h / 0.05)
        return np.full(3, 1.0 + value * memory[0])

    return Changes(cut=_scaled(gain))


def _cogging(value: float, random: np.random.Generator) -> Changes:
    i, poles = _joint(random), 8.0

    def after(columns: Columns, t: FloatArray, step: float) -> None:
        angle = columns[f"drive.q_motor[{i + 1}]"] * GEAR[i]
        columns[f"drive.torque_motor[{i + 1}]"] += value * np.sin(poles * angle)

    return Changes(after=after)


def _cubic_spring(value: float, random: np.random.Generator) -> Changes:
    i = int(random.integers(0, 3))

    def make() -> Function:
        def link(t: float, h: float, u: FloatArray) -> FloatArray:
            q = u[:6].copy()
            q[i] += value * (joint_torques(u[:6], u[6:])[i] / CUBE_TORQUE) ** 3
            return q

        return link

    return Changes(link=make)


def _drive_wave(value: float, random: np.random.Generator) -> Changes:
    i, waves, phase = _joint(random), 60.0 + 240.0 * random.random(), 6.28 * random.random()

    def make() -> Function:
        def link(t: float, h: float, u: FloatArray) -> FloatArray:
            q = u[:6].copy()
            q[i] += value * (math.sin(waves * u[i] + phase) - math.sin(phase))
            return q

        return link

    return Changes(link=make)


def _cross_square(value: float, random: np.random.Generator) -> Changes:
    i, j = (int(k) for k in random.choice(3, 2, replace=False))

    def make() -> Function:
        def function(t: float, h: float, u: FloatArray) -> FloatArray:
            y = u.copy()
            y[i] += value * u[j] * abs(u[j]) / CROSS_FORCE
            return y

        return function

    return Changes(sense=make)


CUBE_TORQUE, CROSS_FORCE = 200.0, 300.0
"""Torque [N m] and force [N] at which the strengths of these two kinds are given."""
OUTSIDE = (
    Outside(
        "periodic_stiffness", "compliance", 2e-7, 1e-6, "rad/(N.m)", _periodic_stiffness, "compliance of a gear that varies with its angle"
    ),
    Outside("axis_coupling", "drive", 2e-4, 2e-3, "1", _coupling, "an axis moves with another one"),
    Outside("quadratic_windup", "drive", 1e-3, 1e-2, "s2/rad", _windup, "deviation with the square of the axis speed"),
    Outside("creep", "compliance", 2e-7, 1e-6, "rad/(N.m)", _creep, "deflection that goes on growing under load"),
    Outside("reversal_ringing", "drive", 50e-6, 300e-6, "rad", _ringing, "decaying oscillation after a reversal"),
    Outside("floor_vibration", None, 20e-6, 150e-6, "rad", _floor, "sinusoid independent of the process"),
    Outside("warming_sensor", "sensor", 0.05, 0.25, "1", _warming_sensor, "gain of the sensor that changes with its temperature"),
    Outside("quadratic_sensor", "sensor", 0.1, 0.5, "1", _quadratic_sensor, "sensor with a quadratic part"),
    Outside("grain_direction", "milling", 0.08, 0.35, "1", _grain, "cutting force that depends on the direction in the material"),
    Outside("chip_packing", "milling", 0.05, 0.3, "1/s", _packing, "force that grows with the time in the cut"),
    Outside("cogging_torque", "drive", 0.2, 1.5, "N.m", _cogging, "motor torque periodic in the rotor angle"),
)
"""Eleven kinds."""


def bouc_wen(index: int, width: float, torque: float) -> Changes:
    """Gear hysteresis of joint `index` (from 0) with a Bouc-Wen variable instead of the model's play elements.

    z' = M'/M_h (1 - |z|(0.5 sign(M' z) + 0.5)), deflection = width tanh(M/M_h - z)/tanh(1): it lags behind the torque, half its width at
    zero torque after a large reversal is `width` [rad]; `torque` is M_h [N m].
    """

    def make() -> Function:
        state = [0.0, 0.0]

        def link(t: float, h: float, u: FloatArray) -> FloatArray:
            M = float(joint_torques(u[:6], u[6:])[index])
            parts = 8
            dM = (M - state[1]) / parts
            for _ in range(parts):
                z = state[0]
                state[0] += dM / torque * (1.0 - abs(z) * (0.5 * math.copysign(1.0, dM * z) + 0.5))
            state[1] = M
            q = u[:6].copy()
            q[index] += width * math.tanh(M / torque - state[0]) / math.tanh(1.0)
            return q

        return link

    return Changes(link=make)


def dahl(index: int, coulomb: float) -> Changes:
    """Coulomb friction of joint `index` (from 0) as Dahl's model instead of tanh: z' = qd - |qd| z/z0, z0 = 30 urad; coulomb z/z0."""
    z0 = 30e-6

    def after(columns: Columns, t: FloatArray, step: float) -> None:
        dq = np.diff(columns[f"drive.q_motor[{index + 1}]"], prepend=columns[f"drive.q_motor[{index + 1}]"][0])
        z = np.zeros(len(dq))
        for k in range(1, len(dq)):
            s = math.copysign(1.0, dq[k])
            z[k] = s * z0 + (z[k - 1] - s * z0) * math.exp(-abs(dq[k]) / z0)  # exact for constant speed over the step
        columns[f"drive.torque_motor[{index + 1}]"] += coulomb * z / z0 / GEAR[index]

    return Changes(after=after)


def merged(changes: list[Changes]) -> Changes:
    """All changes one after the other, in their order at each place of the signal flow."""
    found: dict[str, Callable[[], Function]] = {}
    for place in ("link", "cut", "sense"):
        makers = [m for c in changes if (m := getattr(c, place)) is not None]
        if makers:
            found[place] = makers[0] if len(makers) == 1 else _in_turn(makers)
    afters = [c.after for c in changes if c.after is not None]

    def after(columns: Columns, t: FloatArray, step: float) -> None:
        for a in afters:
            a(columns, t, step)

    return Changes(**found, after=after if afters else None)


def _in_turn(makers: Sequence[Callable[[], Function]]) -> Callable[[], Function]:
    """Functions one behind the other: each changes the first inputs, and what is behind them (the force at `link`) is for all."""

    def make() -> Function:
        functions = [m() for m in makers]

        def function(t: float, h: float, u: FloatArray) -> FloatArray:
            y = u
            for f in functions:
                y = f(t, h, u)
                u = np.concatenate([y, u[len(y) :]])
            return y

        return function

    return make


def late_clock(pattern: str, delay: float) -> Changes:
    """A clock that is late by `delay` [s], in the log only: columns whose names match the pattern, such as `sensor.*`."""

    def after(columns: Columns, t: FloatArray, step: float) -> None:
        for name in columns:
            if fnmatchcase(name, pattern):
                columns[name] = np.interp(t - delay, t, columns[name])

    return Changes(after=after)


OUTSIDE_BY_NAME: Mapping[str, Outside] = {o.name: o for o in OUTSIDE}
FORMED = (
    *(OUTSIDE_BY_NAME[name] for name in ("axis_coupling", "quadratic_windup", "quadratic_sensor", "cogging_torque")),
    Outside("cubic_spring", "compliance", 1e-3, 4e-3, "rad", _cubic_spring, "deflection with the third power of the torque"),
    Outside("drive_wave", "drive", 30e-6, 150e-6, "rad", _drive_wave, "error of a gear with a period that no gear has"),
    Outside("cross_square", "sensor", 0.05, 0.3, "1", _cross_square, "a force that shows on another axis with its square"),
)
"""Seven kinds that a short formula expresses: those of the set `formed`."""
FORMED_BY_NAME: Mapping[str, Outside] = {o.name: o for o in FORMED}
