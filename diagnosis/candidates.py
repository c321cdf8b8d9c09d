"""What a catalogue is made of: effects that may be there, how large and how likely; numbers that are known to a tolerance only."""

from __future__ import annotations

import cmath
import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

LOGGING = "logging"
"""Component that stands for the log itself."""
Address = tuple[str, str]
"""(component, parameter element)."""

COS, SIN = " cos ", " sin "
"""Between an amplitude and its phase, in the name of its part that is in phase, and of that a quarter of a turn ahead."""
AT, AND = " at ", " and "
"""Between a parameter and the values `PARAMETER=VALUE` of its shape parameters, and between these, in the name of a variant's number."""


def selects(pattern: str, channel: str) -> bool:
    """Whether the pattern of a parameter of the log is about a channel, or about the array that it is an element of."""
    expression = re.compile(re.escape(pattern).replace(r"\*", ".*"))
    return bool(expression.fullmatch(channel) or expression.fullmatch(channel.partition("[")[0]))


def physical(values: Mapping[Address, float]) -> dict[Address, float]:
    """Amplitude [its unit] and phase [rad] of every pair of such parts, the fixed values of variants; the rest as it is."""
    found: dict[Address, float] = {}
    turned: dict[tuple[str, str, str], complex] = {}
    for (component, text), value in values.items():
        name, _, fixed = text.partition(AT)
        for part in fixed.split(AND) if fixed else ():
            parameter, _, number = part.partition("=")
            found[component, parameter] = float(number)
        for between, turn in ((COS, 1.0), (SIN, 1.0j)):
            amplitude, is_part, phase = name.partition(between)
            if is_part:
                turned[component, amplitude, phase] = turned.get((component, amplitude, phase), 0.0) + turn * value
                break
        else:
            found[component, name] = value
    for (component, amplitude, phase), z in turned.items():
        found[component, amplitude], found[component, phase] = abs(z), cmath.phase(z)
    return found


class CatalogueError(ValueError):
    """A catalogue that cannot be used; the text names file, entry, what was found and what is expected."""


@dataclass(frozen=True)
class Prior:
    """Size of an effect before the data: normal about zero, or log-normal about `scale`."""

    kind: str
    scale: float
    spread: float = 0.8
    """Standard deviation of the logarithm (log-normal only)."""

    def log_density(self, value: float) -> float:
        """Log of the density at `value` [per unit]; -inf where it is impossible."""
        if self.kind == "normal":
            return -0.5 * (value / self.scale) ** 2 - math.log(self.scale * math.sqrt(2.0 * math.pi))
        if value <= 0.0:
            return -math.inf
        u = math.log(value / self.scale) / self.spread
        return -0.5 * u * u - math.log(value * self.spread * math.sqrt(2.0 * math.pi))


@dataclass(frozen=True)
class Shape:
    """A number that is another one on every machine, beside the size of an effect: a frequency, a share of dead time, a speed."""

    name: str
    parameter: str
    unit: str
    values: tuple[float, ...]
    """Those that are tried, growing: the first and the last are the bounds."""
    spacing: float
    """From one value to the next: of their logarithms where all are positive, else of themselves."""

    @property
    def logarithmic(self) -> bool:
        """Whether values are compared by their ratios."""
        return self.values[0] > 0.0

    def beside(self, value: float, spacings: float) -> float:
        """The value so many spacings above `value` (below, where negative), within the bounds."""
        far = spacings * self.spacing
        return min(max(value * math.exp(far) if self.logarithmic else value + far, self.values[0]), self.values[-1])


@dataclass(frozen=True)
class Candidate:
    """An effect at a location: what is fitted and ranked."""

    effect: str
    component: str
    location: str
    parameters: tuple[str, ...]
    minimum: float
    maximum: float
    prior: Prior
    unit: str
    both_signs: bool
    locations: int = field(compare=False)
    """How many locations the effect has, times the variants of each: its prior probability is shared among them."""
    place: str = field(default="", compare=False)
    """Where its unit stands: `catalogue.toml:12`."""
    phase_per_run: bool = False
    """Whether its phase is another one in every run."""
    start: str = ""
    """Parameter of the component with the angle at which a run begins, where that is another one in every run, too."""
    fixed: tuple[tuple[Address, float], ...] = ()
    """Values of its shape parameters, of a variant; empty where they are those of the nominal system."""
    variants: tuple[Candidate, ...] = field(default=(), compare=False)
    """Candidates of this effect and place that have other values of the shape parameters."""
    shapes: tuple[Shape, ...] = field(default=(), compare=False)
    family: str = field(default="", compare=False)
    """What it is called together with its twins."""
    allowed: tuple[float, float] = (-math.inf, math.inf)
    """Least and largest value that the parameters of the component can have, less what they have in the system [unit]."""

    @property
    def name(self) -> str:
        """`backlash @ joint 2`."""
        return f"{self.effect} @ {self.location}"

    @property
    def addresses(self) -> tuple[Address, ...]:
        """Component and parameter of each number that is fitted."""
        return tuple((self.component, p) for p in self.parameters)

    @property
    def has_phase(self) -> bool:
        """Whether its two numbers are the parts of an amplitude whose phase is free."""
        return COS in self.parameters[0]

    @property
    def named(self) -> tuple[str, ...]:
        """Parameters of the component that switch it on."""
        plain = tuple(p.partition(AT)[0] for p in self.parameters)
        return (*plain[0].split(COS),) if self.has_phase else plain

    def with_shapes(self, values: Sequence[float]) -> Candidate:
        """The variant whose shape parameters have these values."""
        fixed = tuple(((self.component, s.parameter), v) for s, v in zip(self.shapes, values, strict=True))
        text = AT + AND.join(f"{parameter}={v!r}" for (_, parameter), v in fixed)
        return replace(self, parameters=tuple(p.partition(AT)[0] + text for p in self.parameters), fixed=fixed, variants=())

    def with_variants(self, shapes: tuple[Shape, ...]) -> Candidate:
        """The candidate, and one variant for each combination of the values of these shape parameters."""
        shaped = replace(self, shapes=shapes)
        grid = itertools.product(*(s.values for s in shapes)) if shapes else ()
        return replace(shaped, variants=tuple(shaped.with_shapes(values) for values in grid))

    def with_phases(self, count: int) -> Candidate:
        """The amplitude alone, of a candidate that has a phase; a variant for each of `count` phases over a turn but the nominal one."""
        amplitude, phase = self.named
        step = 2.0 * math.pi / count
        turned = tuple(step * k for k in range(1 - count // 2, count // 2 + 1) if k)
        plain = replace(self, parameters=(amplitude,), both_signs=False, phase_per_run=False)
        return plain.with_variants((Shape("phase", phase, "rad", turned, step),))

    def excludes(self, other: Candidate) -> bool:
        """Whether the two cannot be in one model: variants of one effect, the same number, or two values of a shape parameter."""
        if self.name == other.name or set(self.addresses) & set(other.addresses):
            return True
        mine, its = self._shaped(), other._shaped()
        return any(mine[a] != its[a] for a in mine.keys() & its.keys())

    def _shaped(self) -> dict[Address, float | None]:
        return {(self.component, s.parameter): None for s in self.shapes} | dict(self.fixed)

    def bracket(self, address: Address) -> tuple[float, float]:
        """Between which values a shape parameter of a variant is taken to be: half way to those that were tried beside it."""
        value = dict(self.fixed)[address]
        shape = next(s for s in self.shapes if (self.component, s.parameter) == address)
        return shape.beside(value, -0.5), shape.beside(value, 0.5)

    def sizes(self, values: Mapping[Address, float]) -> dict[Address, float]:
        """Size [unit] of what each of its numbers belongs to: itself, or the amplitude that it is a part of."""
        if self.has_phase:
            return dict.fromkeys(self.addresses, math.hypot(*(values[a] for a in self.addresses)))
        return {a: abs(values[a]) for a in self.addresses}

    def large_enough(self, values: Mapping[Address, float]) -> bool:
        """Whether one of its numbers [unit] counts as a finding."""
        return any(size >= self.minimum for size in self.sizes(values).values())

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and largest value of the parameters [unit]; both parts of an amplitude at their largest are the largest amplitude."""
        largest = self.maximum / math.sqrt(2.0) if self.has_phase else self.maximum
        least, most = self.allowed
        return max(-largest if self.both_signs else 0.0, least), min(largest, most)

    def at_bound(self, values: Mapping[Address, float]) -> bool:
        """Whether one of its numbers [unit] is as large as it may be."""
        if self.has_phase:
            return any(math.isclose(size, self.maximum) for size in self.sizes(values).values())
        return any(math.isclose(values[a], bound) for a in self.addresses for bound in self.bounds if bound != 0.0)

    def limited(self, least: float, most: float) -> Candidate:
        """The candidate, with its variants, where its parameters can have no more than this [unit] on top of what they have."""
        least, most = max(least, self.allowed[0]), min(most, self.allowed[1])
        far = max(-least, most) if self.both_signs else most
        if far <= 0.0:  # as large as it can be already: no simulation of it can run
            return self
        return replace(
            self,
            maximum=min(self.maximum, far),
            allowed=(least, most),
            variants=tuple(v.limited(least, most) for v in self.variants),
        )


@dataclass(frozen=True)
class Nuisance:
    """A calibrated number that is only known to a standard deviation `scale` [unit]; `nominal` is its value in the model."""

    address: Address
    scale: float
    nominal: float = 0.0
    usual: float | None = None
    """Standard deviation of machines that are calibrated as usual [unit]; None: `scale`."""
    unit: str = "1"
    """Unit of the number, that of the parameter of its component."""
    allowed: tuple[float, float] = (-math.inf, math.inf)
    """Least and largest value that the parameter can have [unit]."""

    @property
    def doubt(self) -> float:
        """Standard deviation that the difference of two formulations of a machine is measured by [unit]: a good calibration mends none."""
        return self.scale if self.usual is None else self.usual


@dataclass(frozen=True)
class Tolerance:
    """Nuisances as the catalogue has them: before it is known which elements an array has, and their nominal values."""

    address: Address
    size: float
    relative: bool
    unit: str = "1"
    """Unit of an absolute size."""
    place: str = ""
    """Where it stands: `catalogue.toml:12`."""
    usual: Tolerance | None = None
    """What the catalogue says of a number that a calibration says another thing of."""

    def nuisances(self, nominal: Mapping[str, float]) -> list[Nuisance]:
        """One for each element; `nominal` parameter element -> value [unit]. CatalogueError if there is no such parameter."""
        component, name = self.address
        elements = [e for e in nominal if e == name or e.partition("[")[0] == name]
        if not elements:
            raise CatalogueError(f"nuisance {component}.{name}: there is no such parameter; available: {', '.join(sorted(nominal))}")
        usual = self.usual or self
        found = [Nuisance((component, e), self._scale(nominal[e]), nominal[e], usual._scale(nominal[e])) for e in elements]
        return [n for n in found if 0.0 < n.scale < math.inf]

    def _scale(self, nominal: float) -> float:
        return self.size * (abs(nominal) if self.relative else 1.0)
