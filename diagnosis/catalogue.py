"""The catalogue of candidate effects: which parameters of which component switch an effect on, how large it may be, how likely.

Keys of the file are declared below (`CatalogueKeys`), with an example in docs/reference/formats/catalogue.md.

Parameters of "logging" are `lag PATTERN` [s], `smooth PATTERN` (time constant of a first-order filter [s]), `gain PATTERN` [1],
`offset PATTERN` [unit of the channel], `rotate_1 PATTERN` (`_2`, `_3`: a triple about that axis [rad]), and, with any value but zero,
`swap PATTERN` (two channels), `sign PATTERN`, and `unit PATTERN` (by that factor), with a pattern on `component.port[element]` as in the
recording section of a system file.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from robomill.diagnosis.candidates import COS, LOGGING, SIN, Address, Candidate, CatalogueError, Prior, Shape, Tolerance, selects
from robomill.orchestration.slaves.protocol import base_name
from robomill.orchestration.system import keys
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required
from robomill.orchestration.system.parameters import Convert, same_unit, same_unit_only
from robomill.orchestration.system.written import Written, merged

OBSERVATIONS = ("lag", "smooth", "gain", "offset", "swap", "sign", "unit", "rotate_1", "rotate_2", "rotate_3")
"""What can be wrong with a logged channel."""


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

    def within(self, system: Mapping[str, Collection[str]], outputs: Collection[str]) -> tuple[Catalogue, tuple[str, ...]]:
        """What of it a system has, and what is left out, in words.

        `system`: component -> its parameter elements; `outputs`: its outputs, `component.port[1]`, which entries about the log are of.
        """
        left_out: dict[str, dict[str, dict[str, None]]] = {}
        used: dict[str, set[str]] = {}  # what another effect names is not what this one meant
        for c in self.candidates:
            used.setdefault(c.component, set()).update(c.named)
        arrays = {base_name(o) for o in outputs}

        def missing(kind: str, entry: str, lack: str, name: str, among: set[str]) -> bool:
            near = get_close_matches(name, sorted(among), n=1)
            meant = f" (no {name!r}; did you mean {near[0]!r}?)" if near else ""
            left_out.setdefault(lack, {}).setdefault(kind, {})[entry + meant] = None
            return False

        def there(kind: str, entry: str, component: str, *names: str) -> bool:
            if component == LOGGING:
                idle = [p for p in (n.partition(" ")[2] for n in names) if not any(selects(p, o) for o in outputs)]
                return not idle or missing(kind, entry, "there is no output for", idle[0], arrays)
            if component not in system:
                return missing(kind, entry, f"there is no component {component!r} for", component, set(system) - set(used))
            known = {*system[component], *(e.partition("[")[0] for e in system[component])}
            missed = [n for n in names if n not in known]
            lack = f"component {component!r} has no parameters for"
            return not missed or missing(kind, entry, lack, missed[0], known - used.get(component, set()))

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
            candidates=tuple(replace(c, component=named(c.component), variants=()).with_variants(c.shapes) for c in self.candidates),
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

    def limited(self, ranges: Mapping[Address, tuple[float, float]]) -> Catalogue:
        """The catalogue where no effect is larger than its parameters can be.

        `ranges`: component and element -> least and largest value less what it has in the system [unit].
        """

        def of(c: Candidate) -> Candidate:
            here = [ranges[a] for a in c.addresses if a in ranges]  # of an amplitude with a phase its parts are fitted: they have none
            return c.limited(max(low for low, _ in here), min(high for _, high in here)) if here else c

        return replace(self, candidates=tuple(of(c) for c in self.candidates))

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
    maximum = required(
        keys.positive(), "largest magnitude that is fitted, in its unit; what the parameter of the component can be is a bound, too"
    )
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
        made[called] = plain.with_variants(tuple(_shape(one, plain) for one in k.shape.of(entry)))
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
