"""The catalogue of candidate effects: which parameters of which component switch an effect on, how large it may be, how likely.

Keys of the file are declared below (`CatalogueKeys`), with an example in docs/reference/formats/catalogue.md.

Parameters of "logging" are `lag PATTERN` [s], `smooth PATTERN` (time constant of a first-order filter [s]), `gain PATTERN` [1],
`offset PATTERN` [unit of the channel], `rotate_1 PATTERN` (`_2`, `_3`: a triple about that axis [rad]), and, with any value but zero,
`swap PATTERN` (two channels), `sign PATTERN`, and `unit PATTERN` (by that factor), with a pattern on `component.port[element]` as in the
recording section of a system file.
"""

from __future__ import annotations

import cmath
import itertools
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from robomill.orchestration.system import keys
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required
from robomill.orchestration.system.parameters import Convert, same_unit, same_unit_only
from robomill.orchestration.system.written import Written, merged

LOGGING = "logging"
"""Component that stands for the log itself."""
OBSERVATIONS = ("lag", "smooth", "gain", "offset", "swap", "sign", "unit", "rotate_1", "rotate_2", "rotate_3")
"""What can be wrong with a logged channel."""

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

    def with_phases(self, count: int) -> Candidate:
        """The amplitude alone, of a candidate that has a phase; a variant for each of `count` phases over a turn but the nominal one."""
        amplitude, phase = self.named
        step = 2.0 * math.pi / count
        turned = tuple(step * k for k in range(1 - count // 2, count // 2 + 1) if k)
        plain = replace(self, parameters=(amplitude,), both_signs=False, phase_per_run=False)
        return _with_variants(plain, (Shape("phase", phase, "rad", turned, step),))

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
        return (-largest if self.both_signs else 0.0), largest


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


@dataclass(frozen=True)
class Refinement:
    """How the system is run at a smaller communication step."""

    divide: int
    sampled: tuple[str, ...] = ()
    """Components that keep the cycle that they have."""


@dataclass(frozen=True)
class Catalogue:
    """All candidates, nuisance numbers, and what is switched off in simulations."""

    file: Path
    candidates: tuple[Candidate, ...]
    tolerances: tuple[Tolerance, ...] = ()
    quiet: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    seeds: tuple[Address, ...] = ()
    """Parameters that make a simulation another repeat of itself."""
    drawn: frozenset[str] = frozenset()
    """Effects that a seed draws: what they do is another matter in each repeat."""
    descriptions: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """effect -> (description, source)."""
    refinement: Refinement | None = None
    titles: Mapping[str, str] = field(default_factory=dict)
    """array or column -> what people call the difference between machine and simulation there."""

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects, each once."""
        return tuple(dict.fromkeys(c.effect for c in self.candidates))

    @staticmethod
    def load(path: str | Path) -> Catalogue:
        """Read a catalogue file; CatalogueError or FileNotFoundError says what is wrong."""
        file = Path(path)
        if not file.is_file():
            raise FileNotFoundError(f"no catalogue {file}")
        return _read(Entry.load(file, CatalogueError), file)

    def calibrated(self, path: str | Path) -> Catalogue:
        """The catalogue with the standard deviations of a calibration file (`CalibrationKeys`) in place of its own for the same numbers.

        CatalogueError or FileNotFoundError says what is wrong with the file.
        """
        file = Path(path)
        if not file.is_file():
            raise FileNotFoundError(f"no calibration {file}; expected a file with [[nuisance]] tables, as in a catalogue")
        given = _nuisances(CalibrationKeys.nuisance.of(CalibrationKeys.of(Entry.load(file, CatalogueError))))
        usual = {t.address: t for t in self.tolerances}
        others = {a: t for a, t in usual.items() if a not in {g.address for g in given}}
        return replace(self, tolerances=(*others.values(), *(replace(g, usual=usual.get(g.address)) for g in given)))

    def within(self, system: Mapping[str, Collection[str]]) -> tuple[Catalogue, tuple[str, ...]]:
        """What of it a system has, and what is left out, in words; `system`: component -> its parameter elements.

        Entries about the log stay.
        """
        left_out: dict[str, dict[str, dict[str, None]]] = {}
        used: dict[str, set[str]] = {}  # what another effect names is not what this one meant
        for c in self.candidates:
            used.setdefault(c.component, set()).update(c.named)

        def there(kind: str, entry: str, component: str, *names: str) -> bool:
            if component == LOGGING:
                return True
            elements = system.get(component)
            known = {*elements, *(e.partition("[")[0] for e in elements)} if elements is not None else set()
            fits = elements is not None and known.issuperset(names)
            if not fits:
                lack = (
                    f"component {component!r} has no parameters for" if elements is not None else f"there is no component {component!r} for"
                )
                missed = [n for n in names if n not in known] if elements is not None else []
                near = [match for n in missed for match in get_close_matches(n, sorted(known - used.get(component, set())), n=1)]
                meant = f" (no {missed[0]!r}; did you mean {near[0]!r}?)" if near else ""
                left_out.setdefault(lack, {}).setdefault(kind, {})[entry + meant] = None
            return fits

        candidates = tuple(c for c in self.candidates if there("effects", c.effect, c.component, *c.named))
        candidates = tuple(
            c if there("shapes of", c.effect, c.component, *(s.parameter for s in c.shapes)) else replace(c, variants=(), shapes=())
            for c in candidates
        )
        candidates = tuple(
            c if not c.start or there("starts of", c.effect, c.component, c.start) else replace(c, start="") for c in candidates
        )
        tolerances = tuple(t for t in self.tolerances if there("tolerances of", t.address[1], *t.address))
        quiet = {c: {k: v for k, v in values.items() if there("quiet", k, c, k)} for c, values in self.quiet.items()}
        kept = {c: Written(values, getattr(self.quiet[c], "places", {})) for c, values in quiet.items() if values}
        seeds = tuple(a for a in self.seeds if there("seeds", a[1], *a))
        refinement = self.refinement
        if refinement is not None:
            refinement = replace(refinement, sampled=tuple(c for c in refinement.sampled if there("refinement", c, c)))
        fitting = replace(self, candidates=candidates, tolerances=tolerances, quiet=kept, seeds=seeds, refinement=refinement)
        notes = []
        for lack, kinds in left_out.items():
            listed = "; ".join(f"{kind} {', '.join(entries)}" for kind, entries in kinds.items())
            notes.append(f"{self.file.name}: {lack} {listed}: skipped")
        return fitting, tuple(notes)

    def joined(self, other: Catalogue) -> Catalogue:
        """Both catalogues as one; CatalogueError for an effect that both have."""
        double = sorted(set(self.effects) & set(other.effects))
        if double:
            raise CatalogueError(f"{other.file}: effect {double[0]!r} is in {self.file}, too; give one of them another name")
        quiet = dict(self.quiet)
        for component, values in other.quiet.items():
            quiet[component] = merged(quiet.get(component, {}), values)
        refinement = self.refinement or other.refinement
        if self.refinement and other.refinement:
            refinement = replace(self.refinement, sampled=(*self.refinement.sampled, *other.refinement.sampled))
        return replace(
            self,
            candidates=(*self.candidates, *other.candidates),
            tolerances=(*self.tolerances, *other.tolerances),
            quiet=quiet,
            seeds=tuple(dict.fromkeys((*self.seeds, *other.seeds))),
            drawn=self.drawn | other.drawn,
            descriptions={**self.descriptions, **other.descriptions},
            refinement=refinement,
            titles={**self.titles, **other.titles},
        )

    def about(self, component: str, system_name: str) -> Catalogue:
        """What it says about `component`, said about `system_name`: a package does not know what its component is called in a system."""

        def named(name: str) -> str:
            return system_name if name == component else name

        refinement = self.refinement and replace(self.refinement, sampled=tuple(map(named, self.refinement.sampled)))
        return replace(
            self,
            candidates=tuple(_with_variants(replace(c, component=named(c.component), variants=()), c.shapes) for c in self.candidates),
            tolerances=tuple(replace(t, address=(named(t.address[0]), t.address[1])) for t in self.tolerances),
            quiet={named(c): values for c, values in self.quiet.items()},
            seeds=tuple((named(c), name) for c, name in self.seeds),
            refinement=refinement,
        )

    def check_phases(self, given: Mapping[Address, float]) -> None:
        """CatalogueError for an effect with a phase whose amplitude is not zero in the system: what comes on top has no phase of its own.

        `given`: value of each parameter there [its unit].
        """
        for c in self.candidates:
            if c.has_phase and (value := given.get((c.component, c.named[0]))):
                raise CatalogueError(
                    f"{c.place}: effect {c.effect!r}: {c.component}.{c.named[0]} is {value:.4g} {c.unit} in the system; expected 0"
                    " for an effect with a phase: take it out of the catalogue, or out of the system"
                )

    def check_units(self, units: Mapping[Address, str], convert: Convert = same_unit_only) -> None:
        """CatalogueError for an effect or a tolerance whose unit is not that of its parameter; `units` by component and element."""
        stated = [(c.place, f"effect {c.effect!r}", a, c.unit) for c in self.candidates for a in c.addresses]
        stated += [
            (c.place, f"effect {c.effect!r}: shape {s.name!r}", (c.component, s.parameter), s.unit)
            for c in self.candidates
            for s in c.shapes
        ]
        stated += [(t.place, "nuisance", t.address, t.unit) for t in self.tolerances if not t.relative]
        for place, what, (component, name), unit in stated:
            wanted = (
                "s" if component == LOGGING and what == "nuisance" else units.get((component, name), units.get((component, f"{name}[1]")))
            )
            if wanted is not None and not same_unit(unit, wanted, convert):
                raise CatalogueError(
                    f"{place}: {what}: its unit is {unit!r}, that of {component}.{name} is {wanted!r}: give the sizes in that unit"
                )


def _with_variants(candidate: Candidate, shapes: tuple[Shape, ...]) -> Candidate:
    """The candidate, and one variant for each combination of the values of its shape parameters."""
    shaped = replace(candidate, shapes=shapes)
    grid = itertools.product(*(s.values for s in shapes)) if shapes else ()
    return replace(shaped, variants=tuple(shaped.with_shapes(values) for values in grid))


class PriorKeys(Keys):
    """How large the effect is expected to be before the data are seen."""

    kind = required(keys.choice(("normal", "log-normal")), "`normal`: about zero; `log-normal`: about `scale`, never negative")
    scale = required(keys.positive(), "standard deviation (`normal`) or median (`log-normal`), in the unit of the effect")
    spread = default(0.8, keys.positive(), "standard deviation of the logarithm, `log-normal` only")


class LocationKeys(Keys):
    """One place where the effect may be."""

    name = required(keys.text(), "name of the place, such as `joint 1`")
    parameters = required(keys.texts(), "parameters of the component that switch the effect on there, elements as `backlash[1]`")
    phase = optional(keys.text(), "parameter that is the phase of the one parameter above, where it differs from machine to machine")
    per = optional(keys.choice(("run",)), "the phase differs from run to run; needs `phase`")
    start = optional(
        keys.text(), "parameter with the angle [rad] at which a run begins, where that differs from run to run, too; needs `per`"
    )


class ShapeKeys(Keys):
    """A further parameter that differs between machines, such as the frequency of a vibration; the values of a grid are tried."""

    name = required(keys.text(), "what it is called in the answer")
    parameter = required(keys.text(), "parameter of the component; `name[*]` is the element that the effect has at its place")
    values = required(keys.anything("list of numbers"), "two values or more to try, growing")
    unit = default("1", keys.text(), "unit of the values, that of the parameter")
    per = optional(keys.choice(("machine",)), "says that the value is one of the machine")


class EffectKeys(Keys):
    """One effect that a real machine may have and the nominal simulation has not."""

    name = required(keys.text(), "name of the effect, used once")
    component = required(
        keys.text(), f"component of the system that owns the parameters; `{LOGGING}` for what is wrong with the log itself"
    )
    description = required(keys.text(), "what the effect is, for the report")
    source = required(keys.text(), "where its size and form come from")
    unit = required(keys.text(), "unit of the sizes, that of the parameters")
    minimum = required(keys.positive(), "magnitude below which the effect is no finding, in its unit")
    maximum = required(keys.positive(), "largest magnitude that is fitted, in its unit")
    sign = required(keys.choice(("positive", "both")), "whether it may be negative, too")
    prior = required(keys.table(PriorKeys), "how large it is expected to be")
    locations = required(keys.each(LocationKeys), "where it may be")
    shape = default([], keys.each(ShapeKeys), "further parameters that differ between machines")
    family = optional(keys.text(), "what effects are called together that no run can tell apart; `{location}` stands for the place")


class NuisanceKeys(Keys):
    """Calibrated numbers that are known to a standard deviation only. Give either `relative` or `absolute`."""

    component = required(keys.text(), f"component of the system, or `{LOGGING}`")
    parameters = required(keys.texts(), "its parameters: elements or whole arrays")
    source = required(keys.text(), "where the standard deviation comes from")
    relative = optional(keys.positive(), "standard deviation as part of the nominal value")
    absolute = optional(keys.positive(), "standard deviation in `unit`")
    unit = default("1", keys.text(), "unit of `absolute`, that of the parameter")


class CalibrationKeys(Keys):
    """How well the numbers of one system are calibrated, in place of what the catalogue says."""

    nuisance = required(keys.each(NuisanceKeys), "calibrated numbers and their standard deviations")


class QuietKeys(Keys):
    """Parameters that are set in every simulation of the diagnosis, such as the noise of a sensor."""

    component = required(keys.text(), "component of the system")
    parameters = required(keys.values(), "its parameters")


class SeedKeys(Keys):
    """A parameter that seeds the noise of the simulation: another value is another repeat."""

    component = required(keys.text(), "component of the system")
    parameter = required(keys.text(), "its parameter")
    effects = default([], keys.texts(), "effects that it draws: what they do differs from run to run")


class RefinementKeys(Keys):
    """A simulation with a smaller step, which shows what the communication step itself does to a replay."""

    divide = required(keys.count(2), "parts of the communication step")
    sampled = default([], keys.texts(), "components that keep their cycle")


class CatalogueKeys(Keys):
    """The effects that a diagnosis looks for, and what is known of the simulation beside them."""

    effect = required(keys.each(EffectKeys), "the effects")
    nuisance = default([], keys.each(NuisanceKeys), "calibrated numbers and their standard deviations")
    quiet = default([], keys.each(QuietKeys), "parameters of every simulation of the diagnosis")
    seed = default([], keys.each(SeedKeys), "parameters that seed noise")
    refinement = optional(keys.table(RefinementKeys), "a simulation with a smaller step")
    titles = default(
        {},
        keys.named(keys.text(), '"component.array"'),
        "what the difference in an array is called; these arrays are the figures of the answer",
    )


def _read(top: Entry, file: Path) -> Catalogue:
    k = CatalogueKeys
    k.of(top)
    descriptions: dict[str, tuple[str, str]] = {}
    candidates: list[Candidate] = []
    for entry in k.effect.entry(top).each():
        candidates += _effect(entry)
        if candidates[-1].effect in descriptions:
            raise entry["name"].fail("is there twice; give every one a name of its own")
        descriptions[candidates[-1].effect] = (EffectKeys.description.of(entry), EffectKeys.source.of(entry))
    quiet: dict[str, Mapping[str, Any]] = {}
    for entry in k.quiet.of(top):
        component = QuietKeys.component.of(entry)
        quiet[component] = merged(quiet.get(component, {}), QuietKeys.parameters.of(entry))
    return Catalogue(
        file,
        tuple(candidates),
        _nuisances(k.nuisance.of(top)),
        quiet,
        tuple((SeedKeys.component.of(entry), SeedKeys.parameter.of(entry)) for entry in k.seed.of(top)),
        _drawn(k.seed.of(top), descriptions),
        descriptions,
        _refinement(top["refinement"]) if "refinement" in top else None,
        dict(k.titles.of(top)),
    )


def _drawn(seeds: Sequence[Entry], effects: Collection[str]) -> frozenset[str]:
    """The effects that seeds draw."""
    found: set[str] = set()
    for entry in seeds:
        names = SeedKeys.effects.of(entry)
        if missing := sorted(set(names) - set(effects)):
            raise entry["effects"].fail(f"there is no effect {missing[0]!r}; available: {', '.join(effects)}")
        found.update(names)
    return frozenset(found)


def _effect(entry: Entry) -> list[Candidate]:
    k = EffectKeys
    k.of(entry)
    name, component, unit = k.name.of(entry), k.component.of(entry), k.unit.of(entry)
    low, high = k.minimum.of(entry), k.maximum.of(entry)
    if low >= high:
        raise entry["minimum"].fail(f"{low} is not below maximum = {high} (both are magnitudes); give a smaller minimum")
    both = k.sign.of(entry) == "both"
    of = k.prior.of(entry)
    prior = Prior(PriorKeys.kind.of(of), PriorKeys.scale.of(of), PriorKeys.spread.of(of))
    locations = k.locations.of(entry)
    if not locations:
        raise entry["locations"].expected("at least one location")
    family = k.family.of(entry) or name
    made: dict[str, Candidate] = {}
    for spot in locations:
        called, phase = LocationKeys.name.of(spot), LocationKeys.phase.of(spot)
        per_run = LocationKeys.per.of(spot) == "run"
        if called in made:
            raise spot["name"].fail(f"location {called!r} is there twice; give every one a name of its own")
        parameters, size = _names(spot["parameters"], component), prior
        if phase is not None:
            if len(parameters) != 1 or component == LOGGING:
                raise spot["phase"].fail(
                    f"{phase!r} needs one parameter of a component beside it, its amplitude; write parameters = [AMPLITUDE]"
                )
            parameters, size = (parameters[0] + COS + phase, parameters[0] + SIN + phase), Prior("normal", prior.scale)
        if per_run and phase is None:
            raise spot["per"].fail("'run' is for a phase, which is not there; add phase = PARAMETER")
        start = LocationKeys.start.of(spot)
        if start is not None and not per_run:
            raise spot["start"].fail(f"{start!r} is for a phase that differs from run to run; add per = 'run'")
        signs, place = both or phase is not None, entry["unit"].place
        plain = Candidate(name, component, called, parameters, low, high, size, unit, signs, len(locations), place, per_run, start or "")
        plain = replace(plain, family=family.replace("{location}", called))
        made[called] = _with_variants(plain, tuple(_shape(one, plain) for one in k.shape.of(entry)))
    return list(made.values())


def _shape(entry: Entry, candidate: Candidate) -> Shape:
    """A shape parameter; `[*]` in it is the element that the effect has at the candidate's location."""
    k = ShapeKeys
    if candidate.component == LOGGING:
        raise entry.fail("is for parameters of a component; the log has none; leave it out")
    k.per.of(entry)
    values = tuple(v.number() for v in k.values.of(entry).each())
    if not values[1:] or any(a >= b for a, b in itertools.pairwise(values)):
        raise entry["values"].expected("two numbers or more, growing")
    parameter, element = k.parameter.of(entry), candidate.named[0].partition("[")[2]
    if parameter.endswith("[*]"):
        if not element:
            raise entry["parameter"].fail(f"{parameter!r}: {candidate.named[0]!r} has no element; expected an element, such as [1]")
        parameter = parameter.removesuffix("*]") + element
    a, b = (math.log(v) if values[0] > 0.0 else v for v in (values[0], values[-1]))
    return Shape(k.name.of(entry), parameter, k.unit.of(entry), values, (b - a) / (len(values) - 1))


def _nuisances(entries: Iterable[Entry]) -> tuple[Tolerance, ...]:
    return tuple(t for entry in entries for t in _tolerances(entry))


def _tolerances(entry: Entry) -> list[Tolerance]:
    k = NuisanceKeys
    k.source.of(entry)
    given = [(key.entry(entry), size) for key in (k.relative, k.absolute) if (size := key.of(entry)) is not None]
    if len(given) != 1:
        raise entry.fail(f"expected either relative or absolute; found {'both' if given else 'neither'}")
    component, (written, size) = k.component.of(entry), given[0]
    names = _names(entry["parameters"], component)
    return [Tolerance((component, name), size, "relative" in entry, k.unit.of(entry), written.place) for name in names]


def _names(entry: Entry, component: str) -> tuple[str, ...]:
    names = entry.texts()
    if not names:
        raise entry.expected("a list of names, such as ['backlash[2]']")
    for i, name in enumerate(names):
        kind, _, pattern = name.partition(" ")
        if component == LOGGING and (kind not in OBSERVATIONS or not pattern):
            raise entry[i].expected(f"'KIND PATTERN' of the log, with KIND one of {', '.join(OBSERVATIONS)}")
    return names


def _refinement(entry: Entry) -> Refinement:
    return Refinement(RefinementKeys.divide.of(entry), RefinementKeys.sampled.of(RefinementKeys.of(entry)))
