"""Faults of the log as models: what they do to a channel is a linear operator, and it is weighed like any other explanation.

Faults of a size (late, filtered, amplified, offset, turned) are weighed by the search, where the catalogue has them. A wrong sign, a usual
mistake in units, interchanged axes and another frame have no size that is fitted. They are judged before the search by a Bayes factor
(Kass & Raftery 1995, J. Am. Stat. Assoc. 90, 773): a channel is its simulation under the operator, plus a deviation

    e ~ N(0, noise^2 + max(TOLERANCE^2 var, left)),

coherent over the record, so that a channel counts as one observation. `var` is the variance of the simulated signal under the operator.
A mistake in units is tried where the measured signal is as many times the simulated one, within TOLERANCE: its factor is exact. It is one
that can be made in the unit of the channel: no speed is logged in pound-force.
`left` is the mean square that the fault leaves: an effect may be there besides, and one of that size (in the unit of the simulation) is
allowed for without the fault, too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.experiment.segments import by_array
from robomill.diagnosis.gate.checks import SINGLE, Finding
from robomill.models.model.units import Unit, unit_of
from robomill.orchestration.slaves.protocol import FloatArray, base_name

ANGLES, SPEEDS, LENGTHS, FORCES, PRESSURES, RATES = ("rad",), ("rad/s",), ("m",), ("N", "N.m"), ("Pa",), ("m/s", "m3/s", "kg/s", "1/s")
"""SI units in which some mistakes are made, and in their rates: `m` stands for `m/s` and `m/s2`, too."""
FACTORS: Sequence[tuple[float, str, tuple[str, ...]]] = (
    (1e3, "milli- for units", ()),
    (1e-3, "units for milli-", ()),
    (1e6, "micro- for units", ()),
    (1e-6, "units for micro-", ()),
    (180.0 / np.pi, "degrees for radians", ANGLES),
    (np.pi / 180.0, "radians for degrees", ANGLES),
    (9.80665, "newtons (m/s2) for kilogram-force (g)", (*FORCES, "m/s2")),
    (1 / 9.80665, "kilogram-force (g) for newtons (m/s2)", (*FORCES, "m/s2")),
    (14.5037738, "pounds per square inch for bar", PRESSURES),
    (1 / 14.5037738, "bar for pounds per square inch", PRESSURES),
    (60 / (2 * np.pi), "rpm for rad/s", SPEEDS),
    (2 * np.pi / 60, "rad/s for rpm", SPEEDS),
    (100.0, "centimetres for metres", LENGTHS),
    (100.0, "per cent for parts of one", ("1",)),
    (0.01, "metres for centimetres", LENGTHS),
    (0.01, "parts of one for per cent", ("1",)),
    (60.0, "per minute for per second", RATES),
    (1 / 60.0, "per second for per minute", RATES),
    (6e4, "litres per minute for m3/s", ("m3/s",)),
    (1 / 6e4, "m3/s for litres per minute", ("m3/s",)),
    (25.4, "millimetres for inches", LENGTHS),
    (1 / 25.4, "inches for millimetres", LENGTHS),
    (4.4482216, "newtons for pound-force", FORCES),
    (1 / 4.4482216, "pound-force for newtons", FORCES),
)
"""Usual mistakes in units: measured over simulated, what it is called, and the units in which it is made (none: in any)."""
ICE = unit_of("degC").offset
"""K. Zero of the scale that temperatures are logged in: a sign or a prefix is wrong about it."""
FAHRENHEIT = 1.0 / unit_of("degF").factor
"""Degrees Fahrenheit in a kelvin; degrees Fahrenheit and Celsius are the same number at -40."""
KELVIN_IS_FAHRENHEIT = unit_of("degF").offset / (1.0 - unit_of("degF").factor)
"""K. Where degrees Fahrenheit and kelvin are the same number."""
_ORTHOGONAL = ("sign", "axes", "rotation")
KINDS = (*_ORTHOGONAL, "unit")
"""Kinds of findings that are faults of this sort."""
XYZ = "xyz"
"""An array with an element for each may be a vector in another frame."""
TOLERANCE = 0.15
"""Part of a signal by which a machine that is logged well may be off: the largest gain error of a sensor in the catalogue."""
_UNIT = "give the unit that it is logged in"
DECISIVE = 150.0
"""Bayes factor, times the number of operators that are tried, from which a fault is believed: Kass & Raftery's "very strong"."""


@dataclass(frozen=True)
class Operator:
    """A fault that is tried: what it makes of some channels, and what is said if it is believed."""

    members: tuple[int, ...]
    """Places of the channels."""
    matrix: FloatArray
    """[members, members]: logged = true @ matrix + offset."""
    kind: str
    """One of KINDS."""
    value: float
    unit: str
    """Unit of the value."""
    what: str
    """What is wrong, after the name of the channel."""
    remedy: str
    offset: float = 0.0
    """Where the zero of the scale is not that of the unit [unit of the channel]."""
    spread: float | None = None
    """Mean square that tolerances are a part of [unit^2]: of an array, where that is not the variance of each channel."""
    paid: float = 0.0
    """What its fitted numbers cost [nats] (Schwarz 1978, Ann. Stat. 6, 461)."""

    @property
    def scale(self) -> float:
        """Factor that it has."""
        return float(np.linalg.norm(self.matrix, 2))

    def logged(self, true: FloatArray) -> FloatArray:
        """What is logged of a true signal [samples, members]."""
        return np.asarray(true @ self.matrix + self.offset)

    def true(self, logged: FloatArray) -> FloatArray:
        """The true signal of one that is logged [samples, members]."""
        return np.asarray((logged - self.offset) @ np.linalg.inv(self.matrix))

    def on(self, members: tuple[int, ...]) -> Operator:
        """A fault of one channel, in all of these."""
        return replace(self, members=members, matrix=self.scale * np.eye(len(members)))

    def named(self, channels: Sequence[str]) -> str:
        """Which of these channels has the fault: the first member, or an array that is turned."""
        first = channels[self.members[0]]
        return base_name(first) if self.kind == "rotation" else first

    def finding(self, channels: Sequence[str], why: str = "") -> Finding:
        """What is said of it among these channels; `why` it is believed."""
        return Finding(self.named(channels), self.kind, self.value, self.unit, f"{self.what}{why}; {self.remedy}")


def judged(
    x: FloatArray,
    s: FloatArray,
    channels: Sequence[str],
    units: Sequence[str | None],
    noise: FloatArray,
    suspects: frozenset[int] = frozenset(),
) -> list[Finding]:
    """Faults of sign, unit, place and frame of measured `x` beside simulated `s`, both [samples, channels]; `noise` [unit] per channel.

    `units` of the channels: None where it is not known. `suspects` are channels that are wrong anyway. The clearest fault of a channel
    is named, and one without fitted numbers before a turn: one wrong sign beside an element that is nearly zero is half a turn, too.
    """
    tried = [o for o in _operators(x, s, channels, units) if not suspects & set(o.members)]
    gains = [(o, _log_bayes_factor(o, x, s, noise)) for o in tried]
    clear = [(o, gain) for o, gain in gains if gain > math.log(DECISIVE * len(tried))]
    found: list[Finding] = []
    taken: set[int] = set()
    for o, _ in sorted(clear, key=lambda known: (known[0].paid > 0.0, -known[1])):
        if not taken & set(o.members):
            found.append(o.finding(channels))
            taken |= set(o.members)
    return found


def keeps_size(fault: Finding) -> bool:
    """Whether a fault keeps the size of what a signal does: it is turned or interchanged, or has another zero [K]."""
    return fault.kind in _ORTHOGONAL or (fault.kind, fault.unit) == ("unit", "K")


def together(faults: Sequence[Finding]) -> list[list[Finding]]:
    """Which of these faults a log may have: all of them, or those of one array, beside which the others only look like faults."""
    groups: dict[str, list[Finding]] = {}
    for f in faults:
        groups.setdefault(base_name(f.channel), []).append(f)
    return [list(faults), *groups.values()] if len(groups) > 1 else list(groups.values())


def undone(faults: Sequence[Finding], x: FloatArray, s: FloatArray, channels: Sequence[str], units: Sequence[str | None]) -> FloatArray:
    """Measured `x` [samples, channels] as it was before these `faults` (of KINDS); `s` is its simulation, `units` those of the channels.

    A fault is one of a channel and a kind; where several operators are, the one that leaves least. What none of them fits stays. A unit is
    that of a device: where more than half of an array has it, so have the others, which move too little to say so.
    """
    x = x.copy()
    tried = list(_operators(x, s, channels, units))
    scaled: dict[str, dict[int, Operator]] = {}
    for fault in faults:
        same = [o for o in tried if (o.named(channels), o.kind) == (fault.channel, fault.kind)]
        if same:
            o = min(same, key=lambda o: float(((x[:, list(o.members)] - o.logged(s[:, list(o.members)])) ** 2).sum()))
            x[:, list(o.members)] = o.true(x[:, list(o.members)])
            if fault.kind == "unit":
                scaled.setdefault(base_name(fault.channel), {})[o.members[0]] = o
    for name, members in by_array(channels).items():
        known = scaled.get(name, {})
        if 2 * len(known) > len(members) and len({(o.scale, o.offset) for o in known.values()}) == 1:
            o = next(iter(known.values()))
            for i in members:
                if i not in known:
                    x[:, [i]] = o.true(x[:, [i]])
    return x


def made_in(unit: str | None, these: Sequence[str]) -> bool:
    """Whether a mistake that is made in `these` units (none: in any) is made in `unit`: one of them, or a rate of one.

    In a unit that is not known any mistake is.
    """
    if not these or unit is None:
        return True
    try:
        known = unit_of(unit)
    except ValueError:
        return True
    return any(_is_rate(known, unit_of(u)) for u in these)


def exact(channels: Sequence[str], units: Sequence[str | None]) -> Iterator[Operator]:
    """Faults without a fitted number that channels in these SI units (None: not known) may have: signs, units, zeros, interchanged signals.

    Signals may be interchanged within an array, and any two scalars: two columns were given each other's name.
    """
    for i, unit in enumerate(units):
        zeros = (0.0, ICE) if unit == "K" else (0.0,)
        for zero in zeros:
            yield Operator((i,), -np.eye(1), "sign", -1.0, "1", "has the wrong sign", "turn it", 2.0 * zero)
        if unit == "1":
            yield Operator((i,), -np.eye(1), "sign", -1.0, "1", "is inverted (0 for 1, 1 for 0)", "take it from 1", 1.0)
        scales = [(zero, f, mistake) for zero in zeros for f, mistake, where in FACTORS if made_in(unit, where)]
        if unit == "K":
            scales += [(ICE - 40.0, FAHRENHEIT, "degF for degC"), (ICE - 40.0, 1.0 / FAHRENHEIT, "degC for degF")]
            scales += [(KELVIN_IS_FAHRENHEIT, FAHRENHEIT, "degF for K"), (KELVIN_IS_FAHRENHEIT, 1.0 / FAHRENHEIT, "K for degF")]
        for zero, factor, mistake in scales:
            what = f"is {factor:.4g} times what it should be ({mistake})"
            yield Operator((i,), factor * np.eye(1), "unit", factor, "1", what, _UNIT, zero * (1.0 - factor))
        for offset, mistake in ((-ICE, "small (degC)"), (ICE, "large (kelvin for degC)")) if unit == "K" else ():
            yield Operator((i,), np.eye(1), "unit", offset, "K", f"is {ICE:g} K too {mistake}", _UNIT, offset)
    groups = by_array(channels)
    for members in groups.values():
        for i, j in itertools.combinations(members, 2):
            for signs in itertools.product((1.0, -1.0), repeat=2):
                yield _interchanged(i, j, channels, signs)
    for i, j in itertools.combinations([members[0] for members in groups.values() if len(members) == 1], 2):
        yield _interchanged(i, j, channels)


def _interchanged(i: int, j: int, channels: Sequence[str], signs: tuple[float, ...] = (1.0, 1.0)) -> Operator:
    matrix = np.array([[0.0, signs[1]], [signs[0], 0.0]])
    return Operator((i, j), matrix, "axes", float(j - i), "1", f"is interchanged with {channels[j]}", "give each the other's name")


def _is_rate(unit: Unit, of: Unit) -> bool:
    """Whether one unit is another one, or that divided by a power of the time."""
    powers = {b: unit.exponents.get(b, 0) - of.exponents.get(b, 0) for b in (*unit.exponents, *of.exponents)}
    return powers.pop("s", 0) <= 0 and not any(powers.values())


def _operators(x: FloatArray, s: FloatArray, channels: Sequence[str], units: Sequence[str | None]) -> Iterator[Operator]:
    """What measured `x` may have beside simulated `s`, [samples, channels]: exact faults of the size that they are seen in, and turns."""
    groups = by_array(channels)
    pooled = {i: float(s[:, members].var(axis=0).mean()) for members in groups.values() for i in members}
    for o in exact(channels, units):
        (i, *others) = o.members
        if others:
            yield o
        # zero has no sign and no unit; a unit is exact: what is larger by another factor has an effect
        elif s[:, i].any() and (o.kind == "sign" or o.scale == 1.0 or abs(_slope(o, x[:, i], s[:, i]) / o.scale - 1.0) <= TOLERANCE):
            yield replace(o, spread=pooled[i])
    for members in groups.values():
        if len(members) == len(XYZ):
            yield _rotation(tuple(members), x[:, members], s[:, members])


def _slope(o: Operator, x: FloatArray, s: FloatArray) -> float:
    """Measured over simulated [samples] about the zero of a scale."""
    zero = o.offset / (1.0 - o.scale)
    measured, simulated = x - zero, s - zero
    return float(measured @ simulated / (simulated @ simulated)) if simulated.any() else 0.0


def _rotation(members: tuple[int, ...], a: FloatArray, b: FloatArray) -> Operator:
    """The turn that brings simulated vectors `b` nearest to measured ones `a`, [samples, 3] (Kabsch 1976, Acta Cryst. A32, 922)."""
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    angle = float(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))
    what, remedy = f"is turned by {np.rad2deg(angle):.0f} degrees", "expected 0: another frame, or a transposed rotation"
    spread = float((b**2).mean())  # an inexact pose turns what is there all the time, too
    return Operator(members, turn.T, "rotation", angle, "rad", what, remedy, spread=spread, paid=1.5 * math.log(len(a)))


def _log_bayes_factor(o: Operator, x: FloatArray, s: FloatArray, noise: FloatArray) -> float:
    """Log of the odds of the operator against none [nats]."""
    members = list(o.members)
    measured, plain = x[:, members], s[:, members]
    faulted = o.logged(plain)
    left = ((measured - faulted) ** 2).mean(axis=0)
    usual = noise[members] ** 2 + (SINGLE * np.abs(x[:, members]).max(axis=0)) ** 2 + np.finfo(float).tiny
    off = ((measured - plain) ** 2).mean(axis=0)
    if left.sum() > off.sum():  # a fault that leaves more than none is no explanation of anything
        return -math.inf
    own, without = faulted.var(axis=0), plain.var(axis=0)
    if o.spread is not None:  # what an array does is let into its elements by an inexact pose
        own, without = np.full(len(members), o.spread * o.scale**2), np.full(len(members), o.spread)
    faulty = usual + np.maximum(TOLERANCE**2 * own, left)
    good = usual + np.maximum(TOLERANCE**2 * without, np.minimum(left / o.scale**2, off))
    return float(0.5 * (off / good + np.log(good) - left / faulty - np.log(faulty)).sum()) - o.paid
