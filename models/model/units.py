"""Units: any product of powers of SI units with prefixes, how people spell them, and conversion.

The grammar is that of unit names in Modelica and FMI, `N.m.s/rad`, `kg.m2`, `J/(kg.K)`, with the signs that people write besides
(`N*s^2/m`, `N m`, `µm`, `m s⁻¹`). What has two readings, such as `J/kg.K`, is refused. rad is a
base unit, as in FMI 2.0, 2.2.2: a torque is no torsional stiffness.

A quantity that is written carries its unit. Only zero needs none: it is the same in all units of a quantity, except for
temperatures, where 0 K is not 0 degC. (docs/decisions/0060-units-are-parsed.md)
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""Base units, named as the attributes of BaseUnit in FMI."""


@dataclass(frozen=True)
class Unit:
    """`value_SI = factor * value + offset`."""

    factor: float
    exponents: Mapping[str, int]
    """Powers of the `BASE` units, in their order; none is zero."""
    offset: float
    si: str
    """The SI unit that measures the same, in the same parts: `N.m/rad` of `kN.mm/deg`."""


_SMALL = {"f": -15, "p": -12, "n": -9, "u": -6, "m": -3}
_LARGE = {"k": 3, "M": 6, "G": 9, "T": 12}
_ALL = _SMALL | _LARGE
_KILO = {"k": 3}
PREFIXED: dict[str, Mapping[str, int]] = {
    "s": _SMALL,
    "m": _SMALL | {"c": -2, "d": -1, "k": 3},
    "g": _SMALL | {"k": 3},
    "rad": _SMALL,
    "K": _SMALL,
    "cd": _SMALL,
    "mol": _SMALL | _KILO,
    "Pa": _ALL | {"h": 2},
    "bar": {"m": -3, "k": 3},
    "l": {"u": -6, "m": -3, "c": -2, "d": -1, "h": 2},
    "L": {"u": -6, "m": -3, "c": -2, "d": -1, "h": 2},
    "t": _KILO,
    **dict.fromkeys(("A", "N", "J", "W", "V", "C", "F", "Ohm", "S", "Wb", "T", "H", "Hz", "lm", "lx", "Bq", "Gy", "Sv", "kat"), _ALL),
    **dict.fromkeys(("eV", "Wh", "Ah", "VA", "Nm", "Nmm", "ohm", "\u03a9"), _ALL),
}
"""Powers of ten by prefix that a symbol takes; no others, because `Mm` is a slip of `mm`, and `min` no inch."""

_SI: dict[str, str] = {
    "Hz": "1/s",
    "N": "kg.m/s2",
    "Pa": "N/m2",
    "J": "N.m",
    "W": "J/s",
    "C": "A.s",
    "V": "W/A",
    "F": "C/V",
    "Ohm": "V/A",
    "S": "A/V",
    "Wb": "V.s",
    "T": "Wb/m2",
    "H": "Wb/A",
    "sr": "rad2",
    "lm": "cd.sr",
    "lx": "lm/m2",
    "Bq": "1/s",
    "Gy": "J/kg",
    "Sv": "J/kg",
    "kat": "mol/s",
}
"""Units of the SI with a name, and what they are."""

_PI = "pi"
_OTHER: dict[str, tuple[str, str]] = {
    "%": ("1/100", "1"),
    "permille": ("1/1000", "1"),
    "ppm": ("1/1000000", "1"),
    "ppb": ("1/1000000000", "1"),
    "g": ("1/1000", "kg"),
    "t": ("1000", "kg"),
    "min": ("60", "s"),
    "h": ("3600", "s"),
    "d": ("86400", "s"),
    "l": ("1/1000", "m3"),
    "L": ("1/1000", "m3"),
    "bar": ("100000", "Pa"),
    "atm": ("101325", "Pa"),
    "eV": ("1.602176634e-19", "J"),
    "Wh": ("3600", "J"),
    "Ah": ("3600", "C"),
    "VA": ("1", "W"),
    "gn": ("9.80665", "m/s2"),
    "kgf": ("9.80665", "N"),
    "kp": ("9.80665", "N"),
    "in": ("0.0254", "m"),
    "inch": ("0.0254", "m"),
    "ft": ("0.3048", "m"),
    "lb": ("0.45359237", "kg"),
    "lbf": ("4.4482216152605", "N"),
    "psi": ("44482216152605/6451600000", "Pa"),
    "deg": ("1/180 pi", "rad"),
    "arcmin": ("1/10800 pi", "rad"),
    "arcsec": ("1/648000 pi", "rad"),
    "rev": ("2 pi", "rad"),
    "rpm": ("1/30 pi", "rad/s"),
    "degC": ("1", "K"),
    "degF": ("5/9", "K"),
    "Nm": ("1", "N.m"),
    "Nmm": ("1", "N.mm"),
    "sec": ("1", "s"),
    "ohm": ("1", "Ohm"),
    "\u03a9": ("1", "Ohm"),
    "degree": ("1/180 pi", "rad"),
    "degrees": ("1/180 pi", "rad"),
    "radian": ("1", "rad"),
    "radians": ("1", "rad"),
}
"""Units beside the SI, and other names: how much of what they are (SI brochure, tables 8 and 9; NIST SP 811, appendix B)."""

_OFFSETS = {"degC": 273.15, "degF": 459.67 * 5.0 / 9.0}
"""Temperatures [K] at the zero of these scales. In a product (`um/degC`) they are differences."""
_SLIPS = {"mPa": "alone, it is mostly a slip of MPa; write 0.001 Pa if it is none"}
"""No units alone; in a product (`mPa.s`) they are."""
_NAMES = (
    "1 % permille ppm s ms us ns min h Hz kHz 1/s 1/min m cm mm um nm m2 mm2 m3 mm3 m/s mm/s m/min mm/min m/s2 mm/s2 gn m/s3 mm/s3 "
    "m3/s cm3/min l/min rad mrad urad deg rad/s deg/s rpm rad/s2 deg/s2 s/rad kg g kg.m kg.m2 N mN kN N/s N/m N/mm kN/mm N/um N.s/m N.s/mm "
    "m/(N.s) m/N mm/N um/N Pa kPa MPa GPa bar N/m2 N/mm2 kN/mm2 N.m N.mm kN.m N.m/s N.m/rad N.m/deg N.mm/rad kN.m/rad rad/(N.m) "
    "N.m.s/rad N.m/A W kW K degC m/K um/K N/K A mA V mV uV mV/V uV/V um/m N.V/mV um/(N.m) 1/N 1/K"
)
_SUGGESTED = tuple(_NAMES.split())
"""What errors suggest, where it fits."""
_EVERYDAY = ("mm", "deg", "rpm", "mm/min", "um/N", "N/mm2", "N/mm")
"""What they suggest first, because it is what people write."""
EXPECTED = "expected a product of powers of SI units, such as N.m.s/rad, mm/s2 or J/(kg.K)"

_SIGNS = (
    ("**", "^"),
    ("\u00b0C", "degC"),
    ("\u00b0F", "degF"),
    ("\u00b0", "deg"),
    ("\u2030", "permille"),
    ("\u03bc", "u"),
    ("\u2212", "-"),
)
"""Signs that remain when Unicode has made compatible ones one (NFKC: superscripts, micro and ohm), and what they stand for."""
_TIMES = re.compile(r"\s*[.*\u00b7\u22c5\u00d7]\s*|(?<=[\w%)])\s+(?=[^\W\d]|[%(])")
_TOKEN = re.compile(r"(?P<name>[^\W\d_]+|%)|\^?(?P<power>[-+]?\d+(?:\.\d+)?)|(?P<sign>[./()])")


@dataclass(frozen=True)
class _Product:
    """rational * pi^pi times powers of base units; `si` are the powers of named SI units that it was written with."""

    rational: Fraction = Fraction(1)
    pi: int = 0
    exponents: Mapping[str, int] = field(default_factory=dict)
    si: Mapping[str, int] = field(default_factory=dict)

    def times(self, other: _Product, power: int = 1) -> _Product:
        return _Product(
            self.rational * other.rational**power,
            self.pi + other.pi * power,
            _sum(self.exponents, other.exponents, power),
            _sum(self.si, other.si, power),
        )

    @property
    def factor(self) -> float:
        return math.pi**self.pi * self.rational.numerator / self.rational.denominator


def _sum(a: Mapping[str, int], b: Mapping[str, int], power: int) -> dict[str, int]:
    total = {name: a.get(name, 0) + power * b.get(name, 0) for name in (*a, *b)}
    return {name: exponent for name, exponent in total.items() if exponent}


class _Reader:
    """Recursive descent: quotient = factor {"." factor} {"/" factor}, factor = "1" or (name or "(" quotient ")") [power]."""

    def __init__(self, text: str) -> None:
        self.tokens: list[tuple[str, str]] = []
        at = 0
        while at < len(text):
            match = _TOKEN.match(text, at)
            if match is None:
                raise ValueError(f"{text[at]!r} is no part of a unit")
            self.tokens.append((str(match.lastgroup), match[str(match.lastgroup)]))
            at = match.end()

    def whole(self) -> _Product:
        found = self.quotient()
        if self.tokens:
            raise ValueError(f"there is a {self.tokens[0][1]!r} too many")
        return found

    def take(self, kind: str, *texts: str) -> str | None:
        if self.tokens and self.tokens[0][0] == kind and (not texts or self.tokens[0][1] in texts):
            return self.tokens.pop(0)[1]
        return None

    def quotient(self) -> _Product:
        found = self.factor()
        while self.take("sign", "."):
            found = found.times(self.factor())
        while self.take("sign", "/"):
            found = found.times(self.factor(), -1)
            if self.take("sign", "."):
                raise ValueError("what is divided by has two readings; put it into brackets, as in J/(kg.K)")
        return found

    def factor(self) -> _Product:
        if self.take("power", "1"):
            return _Product()
        if self.take("sign", "("):
            found = self.quotient()
            if not self.take("sign", ")"):
                raise ValueError("a ')' is missing")
        else:
            name = self.take("name")
            if name is None:
                raise ValueError(f"expected a unit before {self.tokens[0][1]!r}" if self.tokens else "a unit is missing at its end")
            found = _symbol(name)
        power = self.take("power")
        if power is None:
            return found
        if "." in power:
            raise ValueError(
                f"its power {power} is not whole, as those in FMI are; give the value at a nominal input, such as m3/s at a nominal Pa"
            )
        return _Product().times(found, int(power))


@cache
def _symbol(name: str) -> _Product:
    """A name with or without a prefix."""
    if name in BASE:
        return _Product(exponents={name: 1}, si={name: 1})
    if name in _SI:
        return _Product(exponents=_Reader(_SI[name]).whole().exponents, si={name: 1})
    if name in _OTHER:
        number, definition = _OTHER[name]
        rational, _, pi = number.partition(" ")
        return _Product(Fraction(rational), int(pi == _PI)).times(_Reader(definition).whole())
    prefix, symbol = name[:1], name[1:]
    if prefix in PREFIXED.get(symbol, ()):
        return _Product(Fraction(10) ** PREFIXED[symbol][prefix]).times(_symbol(symbol))
    raise ValueError(f"{name!r} is no unit")


@cache
def unit_of(text: str) -> Unit:
    """What a text means as a unit ("1" and "-": none). ValueError says which part of it is no unit."""
    plain = unicodedata.normalize("NFKC", text.strip())
    for sign, name in _SIGNS:
        plain = plain.replace(sign, name)
    plain = re.sub(r"\s*([/()^])\s*", r"\1", _TIMES.sub(".", plain))
    if plain == "-":
        plain = "1"
    try:
        if plain in _SLIPS:
            raise ValueError(_SLIPS[plain])
        found = _Reader(plain).whole()
    except ValueError as error:
        why = "" if str(error) == f"{text!r} is no unit" else f": {error}"
        raise ValueError(f"unknown unit {text!r}{why}") from None
    exponents = {base: found.exponents[base] for base in BASE if base in found.exponents}
    return Unit(found.factor, exponents, _OFFSETS.get(plain, 0.0), _spelt(found.si))


def _spelt(powers: Mapping[str, int]) -> str:
    """A name in the grammar of FMI: `N.m/(s2.K)`."""
    above, below = (
        [f"{name}{abs(power) if abs(power) > 1 else ''}" for name, power in powers.items() if power * sense > 0] for sense in (1, -1)
    )
    divisor = ".".join(below)
    return (".".join(above) or "1") + (f"/({divisor})" if len(below) > 1 else f"/{divisor}" if below else "")


def _known(text: str) -> Unit | None:
    try:
        return unit_of(text)
    except ValueError:
        return None


def compatible(a: str, b: str) -> bool:
    """Whether two units measure the same quantity (equal SI exponents); False where one of them is none."""
    first, second = _known(a), _known(b)
    return first is not None and second is not None and first.exponents == second.exponents


def are_turns(stated: str, wanted: str) -> bool:
    """Whether Hz, kHz, 1/min or their like is stated for an angular speed or frequency: a cycle is a turn (ISO 80000-3: omega = 2 pi f).

    Not 1/s, which people also write for rad/s.
    """
    u = _known(stated)
    return u is not None and (u.si == "Hz" or u == unit_of("1/min")) and compatible("rad/s", wanted)


def fitting(wanted: str) -> list[str]:
    """Units that measure what `wanted` measures, the usual ones first."""
    same = [u for u in _SUGGESTED if compatible(u, wanted)]
    if wanted not in same:
        same.append(wanted)
    if compatible("rad/s", wanted):
        same += ["Hz", "kHz", "1/min"]
    return sorted(same, key=lambda u: (u not in _EVERYDAY, u != wanted))


def convert(value: float, stated: str, wanted: str) -> float:
    """`value` in the unit `stated` (as people spell it; empty: none is stated), expressed in `wanted`.

    Zero needs no unit where it is the same in all that fit. Hz and 1/min of an angular speed or frequency are turns.
    ValueError says why it cannot be, and which units fit.
    """
    if not stated:
        if compatible(wanted, "1"):
            return value
        if value == 0.0 and not compatible(wanted, "K"):  # only temperatures have scales with another zero
            return 0.0
        fit = fitting(wanted)
        examples = " or ".join(f'"{value:.15g} {u}"' for u in dict.fromkeys((fit[0], wanted)))
        raise ValueError(f"{value:.15g} has no unit; expected a text with one, such as {examples}; units that fit: {', '.join(fit)}")
    if stated == wanted:
        return value
    try:
        given = unit_of(stated)
    except ValueError as error:
        raise ValueError(f"{error}; units that fit: {', '.join(fitting(wanted))}") from None
    target = _known(wanted)
    if target is None:
        raise ValueError(
            f"{value:.15g} {stated} cannot be expressed in {wanted!r}, which is no unit that is known here; write it in that unit"
        )
    if are_turns(stated, wanted):
        return 2.0 * math.pi * to_si(value, stated) / target.factor
    if given.exponents != target.exponents:
        apart = _sum(given.exponents, target.exponents, -1)
        why = "they differ by rad, which is a unit of its own" if set(apart) == {"rad"} else "it measures something else"
        raise ValueError(f"{value:.15g} {stated} cannot be expressed in {wanted}: {why}; units that fit: {', '.join(fitting(wanted))}")
    if (given.factor, given.offset) == (target.factor, target.offset):
        return value
    return (given.factor * value + given.offset - target.offset) / target.factor


def to_si(value: float, stated: str) -> float:
    """`value` in the unit `stated`, in SI. ValueError if that is no unit."""
    u = unit_of(stated)
    return u.factor * value + u.offset


def from_si(value: float, wanted: str) -> float:
    """An SI `value` in the unit `wanted`. ValueError if that is no unit."""
    u = unit_of(wanted)
    return (value - u.offset) / u.factor
