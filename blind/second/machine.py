"""The nominal machine as the data say, and real ones: every calibrated number off by a little, every hidden constant drawn."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robomill.blind.second.cell import Cell
from robomill.blind.second.control import Control
from robomill.blind.second.cutting import Cut
from robomill.blind.second.flexure import GRAVITY, Flexure
from robomill.blind.second.kernel import FloatArray
from robomill.blind.second.motion import Drive
from robomill.blind.second.sensing import Sensor
from robomill.blind.second.torque import Dynamics
from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.files import FILES

SYSTEM = FILES / "scenarios" / "milling_cell.toml"


@cache
def nominal_numbers() -> dict[str, dict[str, FloatArray]]:
    """What the nominal cell is meant to have: component -> parameter -> values in SI."""
    found: dict[str, dict[str, FloatArray]] = {}
    for c in load_system(SYSTEM).components:
        slave = resolve(c.source, c.name)
        try:
            values: dict[str, list[float]] = {}
            units: dict[str, str] = {}
            for port in slave.ports:
                if port.causality == "parameter" and not isinstance(port.start, str):
                    name = port.name.partition("[")[0]
                    values.setdefault(name, []).append(float(port.start or 0.0))
                    units[name] = port.unit or "1"
        finally:
            slave.close()
        found[c.name] = {name: np.array(v) for name, v in values.items()}
        for name, written in c.parameters.items():
            if isinstance(written, str):
                number, _, unit = written.partition(" ")
                found[c.name][name] = np.array([convert(float(number), unit, units[name])])
            elif isinstance(written, int | float):
                found[c.name][name] = np.array([float(written)])
    return found


def _one(component: str, name: str) -> float:
    return float(nominal_numbers()[component][name][0])


def _many(component: str, name: str) -> FloatArray:
    return nominal_numbers()[component][name].copy()


def _six(name: str) -> FloatArray:
    """A number of all six channels of the sensor."""
    return np.concatenate([_many("sensor", f"{name}_f"), _many("sensor", f"{name}_m")])


def start_angles() -> FloatArray:
    """Axis angles [6] at which programs begin to look for a branch of the inverse kinematics."""
    return _many("path", "q_start")


RELATIVE = {
    "stiffness": 0.01,
    "omega": 0.01,
    "damping": 0.01,
    "mass": 0.003,
    "rotor": 0.005,
    "gas": 0.002,
    "chip": 0.01,
    "edge": 0.01,
    "cutoff": 0.005,
}
ABSOLUTE = {"p_FT": 5e-6, "payload": 0.2, "load": 0.02, "offset_f": 0.2, "offset_m": 0.03, "cog": 1e-4}
"""Standard deviations of the calibrated numbers (docs/maintainers/blind.md): relative, and in the unit of the number."""


INERTIA_STEPS = (6, 12)
"""Fine steps [1 ms] over which the arm takes the mean of the force, as drawn: one or two turns of the spindle in the benchmark's cuts
(10 000 rev/min, three teeth). Over less than a turn it would follow the teeth, or a runout, as if it had no inertia."""


@dataclass(frozen=True)
class Place:
    """Where the block is and what the experimenter sets."""

    position: tuple[float, float, float]
    turn: float
    """deg"""
    block: tuple[float, float, float]
    mode: int
    warm_up: float


def nominal(place: Place) -> Cell:
    """The cell without tolerances, without effects, hidden constants in the middle of what they are drawn from."""
    p_FT = _many("compliance", "p_FT_F")
    stiffness = _many("compliance", "stiffness").reshape(-1, 3)[:10].copy()
    believed = stiffness.copy()
    stiffness[8] *= _one("compliance", "sensor_stiffness_scale")
    flexure = Flexure(
        p_FT,
        stiffness,
        _many("compliance", "reference_torque"),
        hysteresis_torque=_many("compliance", "hysteresis_torque"),
        payload_at=_many("compliance", "p_FG_F"),
        warm_up=place.warm_up,
    )
    drive = Drive(
        p_FT,
        _one("drive", "loop_frequency"),
        _one("drive", "loop_damping"),
        _many("drive", "half_gap"),
        _one("drive", "poscorr_limit"),
    )
    cut = Cut(
        np.array(place.position),
        Rotation.from_euler("Z", math.radians(place.turn)).as_matrix(),
        np.array(place.block),
        np.array([_one("milling", k) for k in ("Ktc", "Krc", "Kac")]),
        np.array([_one("milling", k) for k in ("Kte", "Kre", "Kae")]),
        size_reference=_one("milling", "size_reference"),
    )
    sensor = Sensor(
        p_FT,
        _six("range"),
        _six("resolution"),
        _six("offset"),
        _six("model_offset"),
        _one("sensor", "load_mass"),
        _many("sensor", "load_cog_S"),
        float(-nominal_numbers()["sensor"]["model_weight_B"][2] / GRAVITY),
        _many("sensor", "model_cog_S"),
        _many("sensor", "hose_coefficients"),
        _many("sensor", "hose_point_S"),
        _one("sensor", "filter_cutoff"),
        extra_cog=_many("sensor", "load_cog_S"),
        hose_anchor=_many("sensor", "hose_anchor_B"),
    )
    control = Control(place.mode, p_FT, believed, _one("controller", "limit_cartesian"))
    dynamics = Dynamics(
        p_FT,
        _many("drive", "body_mass"),
        _many("drive", "body_com").reshape(6, 3),
        _many("drive", "body_inertia").reshape(6, 6),
        _many("drive", "rotor_inertia"),
        1.0,
        _one("drive", "payload_mass"),
        _many("drive", "payload_com_F"),
        _many("drive", "payload_inertia"),
    )
    return Cell(flexure, drive, cut, sensor, control, dynamics, INERTIA_STEPS[0])


def perturbed(c: Cell, draws: np.random.Generator) -> tuple[Cell, dict[str, dict[str, Any]]]:
    """A machine as good as any: the cell with its tolerances, and the numbers that are off, component -> parameter -> values.

    The draws do not depend on the condition, so the same generator state gives the same machine at every place.
    """

    def off(values: Any, sigma: float) -> FloatArray:
        a = np.asarray(values, dtype=np.float64)
        return a * (1.0 + sigma * draws.standard_normal(a.shape))

    p_FT = c.flexure.p_FT + ABSOLUTE["p_FT"] * draws.standard_normal(3)
    flexure = c.flexure._replace(p_FT=p_FT, stiffness=off(c.flexure.stiffness, RELATIVE["stiffness"]))
    drive = c.drive._replace(omega=float(off(c.drive.omega, RELATIVE["omega"])), damping=float(off(c.drive.damping, RELATIVE["damping"])))
    cut = c.cut._replace(
        chip=off(c.cut.chip, RELATIVE["chip"]),
        edge=off(c.cut.edge, RELATIVE["edge"]),
    )
    load = c.sensor.mass + ABSOLUTE["load"] * draws.standard_normal()
    zero = np.repeat([ABSOLUTE["offset_f"], ABSOLUTE["offset_m"]], 3) * draws.standard_normal(6)
    sensor = c.sensor._replace(
        cutoff=float(off(c.sensor.cutoff, RELATIVE["cutoff"])),
        mass=float(load),
        offset=c.sensor.offset + zero,
        cog=c.sensor.cog + ABSOLUTE["cog"] * draws.standard_normal(3),
    )
    dynamics = c.dynamics._replace(
        mass=off(c.dynamics.mass, RELATIVE["mass"]),
        rotor=off(c.dynamics.rotor, RELATIVE["rotor"]),
        gas=float(off(c.dynamics.gas, RELATIVE["gas"])),
        payload=float(c.dynamics.payload + ABSOLUTE["payload"] * draws.standard_normal()),
    )
    steps = int(draws.choice(INERTIA_STEPS))
    numbers: dict[str, dict[str, Any]] = {
        "compliance": {"stiffness": flexure.stiffness.ravel().tolist(), "p_FT_F": p_FT.tolist()},
        "drive": {
            "loop_frequency": drive.omega,
            "loop_damping": drive.damping,
            "body_mass": dynamics.mass.tolist(),
            "rotor_inertia": dynamics.rotor.tolist(),
            "counterbalance_gas": dynamics.gas * _one("drive", "counterbalance_gas"),
            "payload_mass": dynamics.payload,
        },
        "milling": {
            **dict(zip(("Ktc", "Krc", "Kac"), cut.chip.tolist(), strict=True)),
            **dict(zip(("Kte", "Kre", "Kae"), cut.edge.tolist(), strict=True)),
        },
        "sensor": {
            "filter_cutoff": sensor.cutoff,
            "load_mass": sensor.mass,
            "offset_f": sensor.offset[:3].tolist(),
            "offset_m": sensor.offset[3:].tolist(),
            "load_cog_S": sensor.cog.tolist(),
        },
    }
    return Cell(flexure, drive, cut, sensor, c.control, dynamics, steps), numbers
