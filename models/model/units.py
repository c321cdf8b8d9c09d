"""Units: the table (factor to SI and SI base exponents; FMI 2.0, 2.2.2), how people spell them, and conversion.

A quantity that is written carries its unit. Only zero needs none: it is the same in all units of a quantity, except for
temperatures, where 0 K is not 0 degC.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Unit:
    """`value_SI = factor * value + offset`; `exponents` are those of the SI base units (and rad)."""

    factor: float
    exponents: dict[str, int] = field(default_factory=dict)
    offset: float = 0.0


_N = {"kg": 1, "m": 1, "s": -2}
_NM = {"kg": 1, "m": 2, "s": -2}
_PA = {"kg": 1, "m": -1, "s": -2}
_V = {"kg": 1, "m": 2, "s": -3, "A": -1}
_DEG = math.pi / 180.0

UNITS: dict[str, Unit] = {
    "1": Unit(1.0),
    "%": Unit(0.01),
    "permille": Unit(1e-3),
    "ppm": Unit(1e-6),
    "s": Unit(1.0, {"s": 1}),
    "ms": Unit(1e-3, {"s": 1}),
    "us": Unit(1e-6, {"s": 1}),
    "ns": Unit(1e-9, {"s": 1}),
    "min": Unit(60.0, {"s": 1}),
    "h": Unit(3600.0, {"s": 1}),
    "Hz": Unit(1.0, {"s": -1}),
    "kHz": Unit(1e3, {"s": -1}),
    "1/s": Unit(1.0, {"s": -1}),
    "1/min": Unit(1.0 / 60.0, {"s": -1}),
    "m": Unit(1.0, {"m": 1}),
    "cm": Unit(1e-2, {"m": 1}),
    "mm": Unit(1e-3, {"m": 1}),
    "um": Unit(1e-6, {"m": 1}),
    "nm": Unit(1e-9, {"m": 1}),
    "m2": Unit(1.0, {"m": 2}),
    "mm2": Unit(1e-6, {"m": 2}),
    "m3": Unit(1.0, {"m": 3}),
    "mm3": Unit(1e-9, {"m": 3}),
    "m/s": Unit(1.0, {"m": 1, "s": -1}),
    "mm/s": Unit(1e-3, {"m": 1, "s": -1}),
    "m/min": Unit(1.0 / 60.0, {"m": 1, "s": -1}),
    "mm/min": Unit(1e-3 / 60.0, {"m": 1, "s": -1}),
    "m/s2": Unit(1.0, {"m": 1, "s": -2}),
    "mm/s2": Unit(1e-3, {"m": 1, "s": -2}),
    "m/s3": Unit(1.0, {"m": 1, "s": -3}),
    "mm/s3": Unit(1e-3, {"m": 1, "s": -3}),
    "m3/s": Unit(1.0, {"m": 3, "s": -1}),
    "cm3/min": Unit(1e-6 / 60.0, {"m": 3, "s": -1}),
    "rad": Unit(1.0, {"rad": 1}),
    "mrad": Unit(1e-3, {"rad": 1}),
    "urad": Unit(1e-6, {"rad": 1}),
    "deg": Unit(_DEG, {"rad": 1}),
    "rad/s": Unit(1.0, {"rad": 1, "s": -1}),
    "deg/s": Unit(_DEG, {"rad": 1, "s": -1}),
    "rpm": Unit(math.pi / 30.0, {"rad": 1, "s": -1}),
    "rad/s2": Unit(1.0, {"rad": 1, "s": -2}),
    "deg/s2": Unit(_DEG, {"rad": 1, "s": -2}),
    "s/rad": Unit(1.0, {"rad": -1, "s": 1}),
    "kg": Unit(1.0, {"kg": 1}),
    "g": Unit(1e-3, {"kg": 1}),
    "kg.m": Unit(1.0, {"kg": 1, "m": 1}),
    "kg.m2": Unit(1.0, {"kg": 1, "m": 2}),
    "N": Unit(1.0, _N),
    "mN": Unit(1e-3, _N),
    "kN": Unit(1e3, _N),
    "N/s": Unit(1.0, {**_N, "s": -3}),
    "N/m": Unit(1.0, {"kg": 1, "s": -2}),
    "N/mm": Unit(1e3, {"kg": 1, "s": -2}),
    "kN/mm": Unit(1e6, {"kg": 1, "s": -2}),
    "N/um": Unit(1e6, {"kg": 1, "s": -2}),
    "N.s/m": Unit(1.0, {"kg": 1, "s": -1}),
    "m/(N.s)": Unit(1.0, {"kg": -1, "s": 1}),
    "m/N": Unit(1.0, {"kg": -1, "s": 2}),
    "mm/N": Unit(1e-3, {"kg": -1, "s": 2}),
    "um/N": Unit(1e-6, {"kg": -1, "s": 2}),
    "Pa": Unit(1.0, _PA),
    "kPa": Unit(1e3, _PA),
    "MPa": Unit(1e6, _PA),
    "GPa": Unit(1e9, _PA),
    "bar": Unit(1e5, _PA),
    "N/m2": Unit(1.0, _PA),
    "N/mm2": Unit(1e6, _PA),
    "kN/mm2": Unit(1e9, _PA),
    "N.m": Unit(1.0, _NM),
    "N.mm": Unit(1e-3, _NM),
    "kN.m": Unit(1e3, _NM),
    "N.m/s": Unit(1.0, {"kg": 1, "m": 2, "s": -3}),
    "N.m/rad": Unit(1.0, {**_NM, "rad": -1}),
    "N.m/deg": Unit(1.0 / _DEG, {**_NM, "rad": -1}),
    "N.mm/rad": Unit(1e-3, {**_NM, "rad": -1}),
    "kN.m/rad": Unit(1e3, {**_NM, "rad": -1}),
    "rad/(N.m)": Unit(1.0, {"kg": -1, "m": -2, "s": 2, "rad": 1}),
    "N.m.s/rad": Unit(1.0, {"kg": 1, "m": 2, "s": -1, "rad": -1}),
    "N.m/A": Unit(1.0, {**_NM, "A": -1}),
    "W": Unit(1.0, {"kg": 1, "m": 2, "s": -3}),
    "kW": Unit(1e3, {"kg": 1, "m": 2, "s": -3}),
    "K": Unit(1.0, {"K": 1}),
    "degC": Unit(1.0, {"K": 1}, 273.15),
    "m/K": Unit(1.0, {"m": 1, "K": -1}),
    "um/K": Unit(1e-6, {"m": 1, "K": -1}),
    "N/K": Unit(1.0, {**_N, "K": -1}),
    "A": Unit(1.0, {"A": 1}),
    "mA": Unit(1e-3, {"A": 1}),
    "V": Unit(1.0, _V),
    "mV": Unit(1e-3, _V),
    "uV": Unit(1e-6, _V),
    "mV/V": Unit(1e-3),
    "uV/V": Unit(1e-6),
    "um/m": Unit(1e-6),
    "N.V/mV": Unit(1e3, _N),
    "um/(N.m)": Unit(1e-6, {"kg": -1, "m": -1, "s": 2}),
    "1/N": Unit(1.0, {"kg": -1, "m": -1, "s": 2}),
    "1/K": Unit(1.0, {"K": -1}),
}
"""Names of the table are those of ports and in the metadata of runs; where people write, `canonical` spellings do as well."""

_TURNS = ("Hz", "kHz", "1/min")
"""Units that count cycles: of an angular speed or frequency, where a cycle is a turn (ISO 80000-3, 3-18: angular frequency = 2 pi f).
Not 1/s, which people also write for rad/s."""
_EVERYDAY = ("mm", "deg", "rpm", "mm/min", "um/N", "N/mm2", "N/mm")
"""What an error suggests first, because it is what people write."""
_SPELLINGS = (
    ("\u00b5", "u"),  # micro sign
    ("\u03bc", "u"),  # Greek letter
    ("\u00b0C", "degC"),
    ("\u00b0", "deg"),
    ("\u2030", "permille"),
    ("\u00b2", "2"),
    ("\u00b3", "3"),
    ("^", ""),
    ("*", "."),
    ("\u00b7", "."),
    ("rev/min", "rpm"),
)
_NEWTON_METRE = re.compile(r"(?<![A-Za-z])([mk]?)N(mm?)(?![A-Za-z0-9])")


def canonical(unit: str) -> str:
    """A spelling that people use (N/mm^2, Nm/rad, \u00b5m, rev/min) as it stands in the table; what is not known stays as it is."""
    for spelling, name in _SPELLINGS:
        unit = unit.replace(spelling, name)
    return _NEWTON_METRE.sub(r"\1N.\2", unit)


def fitting(unit: str) -> list[str]:
    """Units that measure what `unit` measures, the usual ones first."""
    if unit not in UNITS:
        return [unit]
    same = [u for u in UNITS if compatible(u, unit)]
    same += [u for u in _TURNS if compatible("rad/s", unit)]
    return sorted(same, key=lambda u: (u not in _EVERYDAY, u != unit))


def convert(value: float, unit: str, wanted: str) -> float:
    """`value` in `unit` (as people spell it; empty: none is stated), expressed in `wanted`.

    Zero needs no unit where it is the same in all that fit. Hz and 1/min of an angular speed or frequency are turns.
    ValueError says why it cannot be, and which units fit.
    """
    if not unit:
        if compatible(wanted, "1"):
            return value
        if value == 0.0 and not any(UNITS[u].offset for u in fitting(wanted) if u in UNITS):
            return 0.0
        fit = fitting(wanted)
        examples = " or ".join(f'"{value:.15g} {u}"' for u in dict.fromkeys((fit[0], wanted)))
        raise ValueError(f"{value:.15g} has no unit; expected a text with one, such as {examples}; units that fit: {', '.join(fit)}")
    name = canonical(unit)
    if name == wanted:
        return value
    if name not in UNITS:
        raise ValueError(f"unknown unit {unit!r}; units that fit: {', '.join(fitting(wanted))}")
    if name in _TURNS and compatible("rad/s", wanted):
        return from_si(2.0 * math.pi * to_si(value, name), wanted)
    if not compatible(name, wanted):
        raise ValueError(
            f"{value:.15g} {unit} cannot be expressed in {wanted}: it measures something else; units that fit: {', '.join(fitting(wanted))}"
        )
    return from_si(to_si(value, name), wanted)


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


def rate_of(unit: str, times: int = 1) -> str | None:
    """The SI unit of the `times`-th derivative with respect to time of what is in `unit`; None where the table has none."""
    exponents = dict(UNITS[unit].exponents)
    exponents["s"] = exponents.get("s", 0) - times
    wanted = {base: n for base, n in exponents.items() if n}
    return next((u for u, v in UNITS.items() if v.factor == 1.0 and v.offset == 0.0 and v.exponents == wanted), None)


def compatible(a: str, b: str) -> bool:
    """Whether two units measure the same quantity (equal SI exponents)."""
    return a in UNITS and b in UNITS and UNITS[a].exponents == UNITS[b].exponents
