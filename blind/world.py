"""The generator's world: the same components, but neither the integration nor the numbers that the diagnosis has.

Against the inverse crime: the communication step is 2 ms (drive, sensor and controller keep their 4 ms cycle and see the mean force of
it), all calibrated parameters are off by a little, hidden constants (phases, frequencies, damping) are the machine's own, noise is
coloured and inside the loop, timestamps jitter, and some effects have another formulation than the catalogue's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.signal import lfilter

from robomill.blind.conditions import Condition, known, load_table, planned
from robomill.blind.effects import Instance
from robomill.blind.force_averaging import FINE, felt
from robomill.blind.insert import Function, Insert, insert, resolver
from robomill.blind.outside import Changes, Columns
from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.cell.milling import with_parameters
from robomill.cell.next_runs import prepare
from robomill.files import FILES
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData, Slave
from robomill.orchestration.system.definition import Connection, System

STEP = 0.004
SYSTEM = FILES / "scenarios" / "milling_cell.toml"
LOADED = FILES / "scenarios" / "experiments" / "loaded_cell.toml"
"""That cell with an applied load in place of the cut."""
MEASURED = (
    "path.p_BT_B",
    "path.quat_BT",
    "path.q_ref",
    "path.v_BT_B",
    "path.spindle_speed",
    "path.block",
    "path.path_time",
    "drive.q_motor",
    "drive.torque_motor",
    "sensor.f_S_raw",
    "sensor.m_S_raw",
    "sensor.f_T_T",
    "sensor.m_T_T",
    "controller.correction_B",
    "controller.correction_q",
    "milling.spindle_torque",
)
"""Columns of both tiers."""
TRACKER = "compliance.p_BT_B"
"""Only at tier T1."""
NOISE: Mapping[str, tuple[float, float, float]] = {
    TRACKER: (6e-6, 4e-6, 3e-6),
    "drive.q_motor": (1e-6, 0.5e-6, 0.0),
    "drive.torque_motor": (0.05, 0.05, 0.02),
    "milling.spindle_torque": (0.03, 0.03, 0.01),
}
"""White part, coloured part (AR(1), 0.2 s) and offset of the run: standard deviations in the unit of the column."""
QUIET: Mapping[str, Mapping[str, Any]] = {"sensor": {"noise_f": 0.0, "noise_m": 0.0, "walk_f": 0.0, "walk_m": 0.0}}
"""No noise in the sensor."""
_NOISE_STEPS = 10_000
"""Steps (2 ms) for which noise is made: longer than any run of the benchmark."""
SENSOR_COLOURED = (0.4, 0.04)
"""AR(1) noise, 0.1 s, in force [N] and moment [N m] before the sensor: inside the loop."""

_RELATIVE = {
    "compliance": {"stiffness": 0.01},
    "drive": {"loop_frequency": 0.01, "loop_damping": 0.01, "body_mass": 0.003, "rotor_inertia": 0.005, "counterbalance_gas": 0.002},
    "milling": {"Ktc": 0.01, "Krc": 0.01, "Kac": 0.01, "Kte": 0.01, "Kre": 0.01, "Kae": 0.01},
    "sensor": {"filter_cutoff": 0.005},
}
_ABSOLUTE = {
    "compliance": {"p_FT_F": 5e-6},
    "drive": {"payload_mass": 0.2},
    "sensor": {"load_mass": 0.02, "offset_f": 0.2, "offset_m": 0.03, "load_cog_S": 1e-4},
}
"""Standard deviations of the perturbation of every calibrated parameter: relative, and in the unit of the parameter."""


@dataclass(frozen=True)
class Machine:
    """One machine as it really is; component -> parameter -> values."""

    parameters: Mapping[str, Mapping[str, Any]]
    """Calibrated ones, off by a little."""
    hidden: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Constants of effects that no two machines share; they change nothing where the effect is off."""


@cache
def nominal_system(file: Path = SYSTEM) -> System:
    """The cell as everybody knows it."""
    return load_system(file)


def system_file(c: Condition) -> Path:
    """The file of the system that makes a condition."""
    return SYSTEM if c.cuts else LOADED


@cache
def _nominal_value(component: str, parameter: str) -> FloatArray:
    """What the nominal cell has: the value of its system file, else the start of the component."""
    system = nominal_system()
    c = next(c for c in system.components if c.name == component)
    slave = resolve(c.source, c.name)
    try:
        ports = [p for p in slave.ports if p.causality == "parameter" and p.name.partition("[")[0] == parameter]
        values = np.array([float(p.start or 0.0) for p in ports])
    finally:
        slave.close()
    written = c.parameters.get(parameter)
    if isinstance(written, str):
        number, _, unit = written.partition(" ")
        return np.array([convert(float(number), unit, ports[0].unit or "1")])
    return values if written is None else np.atleast_1d(np.asarray(written, dtype=np.float64))


def draw_machine(random: np.random.Generator) -> Machine:
    """A machine: every calibrated parameter off by a little, normally distributed."""
    found: dict[str, dict[str, Any]] = {}
    for table, relative in ((_RELATIVE, True), (_ABSOLUTE, False)):
        for component, entries in table.items():
            for name, sigma in entries.items():
                value = _nominal_value(component, name)
                off = sigma * random.standard_normal(value.shape)
                new = value * (1.0 + off) if relative else value + off
                found.setdefault(component, {})[name] = float(new[0]) if len(new) == 1 else [float(v) for v in new]
    return Machine(found)


def draw_hidden(random: np.random.Generator) -> dict[str, dict[str, Any]]:
    """The hidden constants of a machine, for every effect whose model has a parameter for one."""
    torque = _nominal_value("compliance", "hysteresis_torque")
    direction = random.standard_normal(3)
    return {
        "compliance": {
            "mode_frequency": _log_uniform(random, 5.0, 20.0),
            "mode_damping": _log_uniform(random, 0.01, 0.06),
            "mode_direction": [float(v) for v in direction / np.linalg.norm(direction)],
            "hysteresis_torque": [float(v) * _log_uniform(random, 0.5, 2.0) for v in torque],
            "friction_stiffness": _log_uniform(random, 0.3, 1.1),
        },
        "drive": {
            "transmission_phase": [float(v) for v in random.uniform(-math.pi, math.pi, 6)],
            "transmission_harmonic": [float(v) for v in random.integers(1, 3, 6)],
            "stribeck_speed": _log_uniform(random, 0.01, 0.04),
        },
        "milling": {"runout_angle": float(random.uniform(0.0, 2.0 * math.pi))},
        "sensor": {"zero_drift_time": _log_uniform(random, 300.0, 1200.0)},
    }


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** random.random())


def _tables(c: Condition, folder: Path) -> dict[str, dict[str, Any]]:
    """What the experimenter sets, with the tables of program and load in a folder."""
    segments, profile = folder / "segments.npy", folder / "profile.npy"
    np.save(segments, planned(c).table)
    if not c.cuts:
        np.save(profile, load_table(c))
    return known(c, str(segments), str(profile))


def there(system: System, parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """The parameters of components that a system has."""
    names = {c.name for c in system.components}
    return {k: v for k, v in parameters.items() if k in names}


def with_effects(system: System, effects: Sequence[Instance]) -> System:
    """The system with effects switched on by their parameters; what is in components that it does not have has no effect."""
    names = {c.name for c in system.components}
    for e in effects:
        if e.effect.component in names:
            system = system.with_parameters(e.effect.component, {e.parameter: e.value})
    return system


@lru_cache(maxsize=64)
def nominal(c: Condition) -> Run:
    """The nominal simulation of a condition, without noise."""
    return simulate_nominal(c, ())


def simulate_nominal(c: Condition, effects: Sequence[Instance], hidden: Mapping[str, Mapping[str, Any]] | None = None) -> Run:
    """What the nominal cell, coupled as its file says, does with effects switched on and hidden constants set; no noise."""
    with TemporaryDirectory() as folder:
        system = nominal_system(system_file(c))
        return run_nominal(with_effects(with_parameters(system, there(system, hidden or {})), effects), _tables(c, Path(folder)), {})


def run_nominal(system: System, parameters: Mapping[str, Mapping[str, Any]], adopted: Mapping[str, Mapping[str, Any]]) -> Run:
    """A run of a system with what the experimenter sets and with parameters adopted: component -> element -> value; no noise."""
    for table in (parameters, QUIET, adopted):
        system = with_parameters(system, there(system, table))
    return run(system, None, resolver=resolve, convert=convert)


def simulate(
    c: Condition, machine: Machine, effects: Sequence[Instance], changes: Changes, random: np.random.Generator | None
) -> tuple[FloatArray, Columns, Mapping[str, PortData]]:
    """True times [s], columns and their ports every 4 ms. Without `random`: no noise, nothing that varies from run to run."""
    with TemporaryDirectory() as folder:
        system = nominal_system(system_file(c))
        varies: Mapping[str, Mapping[str, Any]] = QUIET
        if random is not None:
            place = [v + 5e-6 * float(random.standard_normal()) for v in c.position]
            varies = {
                "sensor": {"seed": int(random.integers(1, 2**31))},
                "controller": {"seed": int(random.integers(1, 2**31))},
                "milling": {"p_BP_B": place, "spindle_start_angle": float(random.uniform(0.0, 2.0 * math.pi))},
            }
        for table in (_tables(c, Path(folder)), machine.parameters, machine.hidden, varies):
            system = with_parameters(system, there(system, table))
        return _simulate(with_effects(system, effects), changes, random)


def simulate_menu(
    kind: str, machine: Machine, effects: Sequence[Instance], changes: Changes, adopted: Mapping[str, Mapping[str, float]]
) -> tuple[FloatArray, Columns]:
    """Times [s] and columns of the run `kind` of the menu (`cell.next_runs`), no noise; `adopted` is component -> element -> value.

    What is in components that the run does not have has no effect. LookupError: no such run.
    """
    with TemporaryDirectory() as folder:
        made = prepare(with_parameters(with_parameters(nominal_system(), machine.parameters), machine.hidden), kind, Path(folder))
        system = with_effects(with_parameters(with_parameters(made.system, made.parameters), QUIET), effects)
        t, columns, _ = _simulate(with_parameters(system, there(system, adopted)), changes, None)
        return t, columns


def _simulate(system: System, changes: Changes, random: np.random.Generator | None) -> tuple[FloatArray, Columns, Mapping[str, PortData]]:
    """A configured system at the fine step, every 4 ms of it."""
    system, inserts = _fine(system, changes, random)
    result = run(system, None, resolver=resolver(inserts, resolve), convert=convert)
    t = result.t[::FINE].copy()
    columns = {name: values[::FINE].copy() for name, values in result.columns.items()}
    if changes.after is not None:
        changes.after(columns, t, STEP)
    return t, columns, result.ports


_WRENCH = {"f": (3, "N"), "m": (3, "N.m")}


def _fine(system: System, changes: Changes, random: np.random.Generator | None) -> tuple[System, dict[str, Callable[[], Slave]]]:
    """The system at the fine step, with the mean force before the sensor and the inserts of `changes`."""
    slow = ("drive", "sensor", "controller")
    system = replace(
        system,
        step=STEP / FINE,
        components=tuple(replace(c, every=FINE) if c.name in slow else c for c in system.components),
    )
    inserts: dict[str, Callable[[], Slave]] = {}
    cause = "milling" if any(c.name == "milling" for c in system.components) else "load"
    force = {f"{cause}.f_T_B": ("f", "f_out"), f"{cause}.m_T_B": ("m", "m_out")}
    if changes.cut is not None:
        system = insert(system, "cut", force, ("compliance", "drive", "sensor"))
        inserts["cut"] = _slave("cut", _WRENCH, {"f_out": (3, "N"), "m_out": (3, "N.m")}, changes.cut)
        force = {"cut.f_out": ("f", "f_out"), "cut.m_out": ("m", "m_out")}
    if changes.sense is not None:
        system = insert(system, "sense", force, ("sensor",))
        inserts["sense"] = _slave("sense", _WRENCH, {"f_out": (3, "N"), "m_out": (3, "N.m")}, changes.sense)
        force = {"sense.f_out": ("f", "f_out"), "sense.m_out": ("m", "m_out")}
    system = insert(system, "felt", force, ("sensor",))
    inserts["felt"] = felt(None if random is None else _sensor_noise(random))
    if changes.link is not None:
        source = "cut.f_out" if changes.cut is not None else f"{cause}.f_T_B"
        system = insert(system, "link", {"drive.q_link": ("q", "q_out")}, ("compliance",), (Connection(source, "link.f", True),))
        inserts["link"] = _slave("link", {"q": (6, "rad"), "f": (3, "N")}, {"q_out": (6, "rad")}, changes.link)
    return system, inserts


def _slave(name: str, inputs: Any, outputs: Any, make: Callable[[], Function]) -> Callable[[], Slave]:
    return lambda: Insert(name, inputs, outputs, make)


def _sensor_noise(random: np.random.Generator) -> FloatArray:
    """AR(1) noise in force [N] and moment [N m] of each fine step, float64[steps, 6]; it begins at zero."""
    white = np.random.default_rng(int(random.integers(2**31))).standard_normal((_NOISE_STEPS, 6))
    decay = math.exp(-STEP / FINE / 0.1)
    noise: FloatArray = lfilter([math.sqrt(1.0 - decay * decay)], [1.0, -decay], white, axis=0) * np.repeat(SENSOR_COLOURED, 3)
    return noise


def coloured(n: int, tau: float, random: np.random.Generator) -> FloatArray:
    """AR(1) noise of unit variance, (n,), correlation time tau [s] at the recording step."""
    decay = math.exp(-STEP / tau)
    white = random.standard_normal(n)
    noise: FloatArray = lfilter([math.sqrt(1.0 - decay * decay)], [1.0, -decay], white, zi=[decay * float(random.standard_normal())])[0]
    return noise


def measure(columns: Columns, tier: str, random: np.random.Generator) -> Columns:
    """The measured columns with the noise of the instruments. Draws are those of T1 at both tiers, so the cases are the same."""
    result: Columns = {}
    for array in (*MEASURED, TRACKER):
        for name, values in columns.items():
            if name.partition("[")[0] != array:
                continue
            white, colour, offset = NOISE.get(array, (0.0, 0.0, 0.0))
            if white > 0.0:
                n = len(values)
                noise = white * random.standard_normal(n) + colour * coloured(n, 0.2, random) + offset * random.standard_normal()
                result[name] = values + noise
            else:
                result[name] = values.copy()
    if tier == "T0":
        result = {n: v for n, v in result.items() if n.partition("[")[0] != TRACKER}
    return result


def jittered(t: FloatArray, random: np.random.Generator) -> FloatArray:
    """Timestamps as a logger writes them: drift of 5 ppm, jitter of 0.03 ms (white), starting at zero."""
    drift = 5e-6 * float(random.standard_normal())
    jitter = np.clip(3e-5 * random.standard_normal(len(t)), -1e-3, 1e-3)
    stamped: FloatArray = t * (1.0 + drift) + jitter
    stamped -= stamped[0]
    return stamped
