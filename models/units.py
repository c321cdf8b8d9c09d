"""The units that ports and parameter files may use: factor to SI and SI base exponents (FMI 2.0, 2.2.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Unit:
    """`value_SI = factor * value + offset`; `exponents` are those of the SI base units (and rad)."""

    factor: float
    exponents: dict[str, int] = field(default_factory=dict)
    offset: float = 0.0


_N = {"kg": 1, "m": 1, "s": -2}
_NM = {"kg": 1, "m": 2, "s": -2}
_DEG = math.pi / 180.0

UNITS: dict[str, Unit] = {
    "1": Unit(1.0),
    "%": Unit(0.01),
    "s": Unit(1.0, {"s": 1}),
    "ms": Unit(1e-3, {"s": 1}),
    "min": Unit(60.0, {"s": 1}),
    "h": Unit(3600.0, {"s": 1}),
    "Hz": Unit(1.0, {"s": -1}),
    "1/s": Unit(1.0, {"s": -1}),
    "m": Unit(1.0, {"m": 1}),
    "mm": Unit(1e-3, {"m": 1}),
    "um": Unit(1e-6, {"m": 1}),
    "m2": Unit(1.0, {"m": 2}),
    "m3": Unit(1.0, {"m": 3}),
    "m/s": Unit(1.0, {"m": 1, "s": -1}),
    "mm/s": Unit(1e-3, {"m": 1, "s": -1}),
    "m/s2": Unit(1.0, {"m": 1, "s": -2}),
    "m/s3": Unit(1.0, {"m": 1, "s": -3}),
    "m3/s": Unit(1.0, {"m": 3, "s": -1}),
    "cm3/min": Unit(1e-6 / 60.0, {"m": 3, "s": -1}),
    "rad": Unit(1.0, {"rad": 1}),
    "deg": Unit(_DEG, {"rad": 1}),
    "rad/s": Unit(1.0, {"rad": 1, "s": -1}),
    "deg/s": Unit(_DEG, {"rad": 1, "s": -1}),
    "rad/s2": Unit(1.0, {"rad": 1, "s": -2}),
    "s/rad": Unit(1.0, {"rad": -1, "s": 1}),
    "rpm": Unit(math.pi / 30.0, {"rad": 1, "s": -1}),
    "kg": Unit(1.0, {"kg": 1}),
    "kg.m2": Unit(1.0, {"kg": 1, "m": 2}),
    "N": Unit(1.0, _N),
    "kN": Unit(1e3, _N),
    "N/s": Unit(1.0, {**_N, "s": -3}),
    "N/m": Unit(1.0, {"kg": 1, "s": -2}),
    "N/mm": Unit(1e3, {"kg": 1, "s": -2}),
    "m/N": Unit(1.0, {"kg": -1, "s": 2}),
    "um/N": Unit(1e-6, {"kg": -1, "s": 2}),
    "Pa": Unit(1.0, {"kg": 1, "m": -1, "s": -2}),
    "MPa": Unit(1e6, {"kg": 1, "m": -1, "s": -2}),
    "N/mm2": Unit(1e6, {"kg": 1, "m": -1, "s": -2}),
    "N.m": Unit(1.0, _NM),
    "N.mm": Unit(1e-3, _NM),
    "N.m/rad": Unit(1.0, {**_NM, "rad": -1}),
    "N.mm/rad": Unit(1e-3, {**_NM, "rad": -1}),
    "rad/(N.m)": Unit(1.0, {"kg": -1, "m": -2, "s": 2, "rad": 1}),
    "N.m.s/rad": Unit(1.0, {"kg": 1, "m": 2, "s": -1, "rad": -1}),
    "N.m/A": Unit(1.0, {**_NM, "A": -1}),
    "W": Unit(1.0, {"kg": 1, "m": 2, "s": -3}),
    "kW": Unit(1e3, {"kg": 1, "m": 2, "s": -3}),
    "K": Unit(1.0, {"K": 1}),
    "degC": Unit(1.0, {"K": 1}, 273.15),
    "m/K": Unit(1.0, {"m": 1, "K": -1}),
    "N/K": Unit(1.0, {**_N, "K": -1}),
    "A": Unit(1.0, {"A": 1}),
}


def to_si(value: float, unit: str) -> float:
    """Convert `value` in `unit` to SI. ValueError lists the known units."""
    if unit not in UNITS:
        raise ValueError(f"unknown unit {unit!r}; known units: {', '.join(sorted(UNITS))}")
    return UNITS[unit].factor * value + UNITS[unit].offset


def from_si(value: float, unit: str) -> float:
    """Convert an SI `value` to `unit`. ValueError lists the known units."""
    if unit not in UNITS:
        raise ValueError(f"unknown unit {unit!r}; known units: {', '.join(sorted(UNITS))}")
    return (value - UNITS[unit].offset) / UNITS[unit].factor


def compatible(a: str, b: str) -> bool:
    """Whether two units measure the same quantity (equal SI exponents)."""
    return a in UNITS and b in UNITS and UNITS[a].exponents == UNITS[b].exponents
