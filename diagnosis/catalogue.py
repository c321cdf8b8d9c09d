"""The catalogue of candidate effects: which parameters of which component switch an effect on, how large it may be, how likely.

A TOML file::

    [[effect]]
    name = "backlash"
    component = "drive"                 # name in the system; "logging" for what is wrong with the log itself
    description = "..."
    source = "..."
    unit = "rad"
    minimum = 2e-6                      # smaller is no finding [unit]
    maximum = 1e-3                      # bound of the fit [unit]
    sign = "positive"                   # or "both"
    prior = {kind = "log-normal", scale = 6e-5, spread = 0.8}    # or {kind = "normal", scale = ...}
    locations = [{name = "joint 1", parameters = ["backlash[1]"]}, ...]
                                        # an amplitude whose phase is another on every machine: phase = "transmission_phase[1]" beside it;
                                        # and in every run: per = "run", too

    [[nuisance]]                        # calibrated numbers, believed to a standard deviation
    component = "drive"
    parameters = ["loop_frequency"]     # elements, or whole arrays
    relative = 0.01                     # of the nominal value; or: absolute = 0.4 and its unit, that of the parameter
    source = "..."

    [[seed]]                            # where the simulation has noise of its own: another value is another repeat
    component = "sensor"
    parameter = "seed"

    [[quiet]]                           # set in every simulation of the diagnosis
    component = "sensor"
    parameters = {noise_f = 0}

    [refinement]                        # what the communication step itself does to a replay is seen by a simulation with a part of it
    divide = 4
    sampled = ["sensor", "controller"]  # components that keep their cycle

    [titles]                            # what the difference in an array is called; these arrays are the figures of the answer
    "drive.q_motor" = "motor angle error"

Parameters of "logging" are `lag PATTERN` [s], `smooth PATTERN` (time constant of a first-order filter [s]), `gain PATTERN` [1],
`offset PATTERN` [unit of the channel], with a pattern on `component.port[element]` as in the recording section of a system file.
"""

from __future__ import annotations

import cmath
import difflib
import math
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robomill.orchestration.system.toml_file import TomlFile
from robomill.orchestration.system.written import merged

LOGGING = "logging"
"""Component that stands for the log itself."""
OBSERVATIONS = ("lag", "smooth", "gain", "offset")
"""What can be wrong with a logged channel."""

Address = tuple[str, str]
"""(component, parameter element)."""

_EFFECT = {"name", "component", "description", "source", "locations", "minimum", "maximum", "prior", "unit", "sign"}
_LOCATION = {"name", "parameters"}
_PHASE, _PER = "phase", "per"
COS, SIN = " cos ", " sin "
"""Between an amplitude and its phase, in the name of its part that is in phase, and of that a quarter of a turn ahead."""
_NUISANCE = {"component", "parameters", "relative", "absolute", "unit", "source"}
_QUIET = {"component", "parameters"}
_SEED = {"component", "parameter"}
_REFINEMENT = {"divide", "sampled"}


def selects(pattern: str, channel: str) -> bool:
    """Whether the pattern of a parameter of the log is about a channel, or about the array that it is an element of."""
    expression = re.compile(re.escape(pattern).replace(r"\*", ".*"))
    return bool(expression.fullmatch(channel) or expression.fullmatch(channel.partition("[")[0]))


def physical(values: Mapping[Address, float]) -> dict[Address, float]:
    """Amplitude [its unit] and phase [rad] of every pair of such parts; the rest as it is."""
    found: dict[Address, float] = {}
    turned: dict[tuple[str, str, str], complex] = {}
    for (component, name), value in values.items():
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
    locations: int
    """How many locations the effect has: its prior probability is shared among them."""
    place: str = field(default="", compare=False)
    """Where its unit stands: `catalogue.toml:12`."""
    phase_per_run: bool = False
    """Whether its phase is another one in every run."""

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
        return (*self.parameters[0].split(COS),) if self.has_phase else self.parameters

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


@dataclass(frozen=True)
class Tolerance:
    """Nuisances as the catalogue has them: before it is known which elements an array has, and their nominal values."""

    address: Address
    size: float
    relative: bool
    unit: str = "1"
    """Of an absolute size."""
    place: str = ""
    """Where it stands: `catalogue.toml:12`."""

    def nuisances(self, nominal: Mapping[str, float]) -> list[Nuisance]:
        """One for each element; `nominal` parameter element -> value [unit]. CatalogueError if there is no such parameter."""
        component, name = self.address
        elements = [e for e in nominal if e == name or e.partition("[")[0] == name]
        if not elements:
            raise CatalogueError(f"nuisance {component}.{name}: there is no such parameter; there are {', '.join(sorted(nominal))}")
        found = [Nuisance((component, e), self.size * (abs(nominal[e]) if self.relative else 1.0), nominal[e]) for e in elements]
        return [n for n in found if 0.0 < n.scale < math.inf]


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
    quiet: Mapping[str, Mapping[str, Any]] | None = None
    seeds: tuple[Address, ...] = ()
    """Parameters that make a simulation another repeat of itself."""
    descriptions: Mapping[str, tuple[str, str]] | None = None
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
        return _Reader(file, TomlFile.load(file, CatalogueError)).catalogue()

    def check_units(self, units: Mapping[Address, str]) -> None:
        """CatalogueError for an effect or a tolerance whose unit is not that of its parameter; `units` by component and element."""
        stated = [(c.place, f"effect {c.effect!r}", a, c.unit) for c in self.candidates for a in c.addresses]
        stated += [(t.place, "nuisance", t.address, t.unit) for t in self.tolerances if not t.relative]
        for place, what, (component, name), unit in stated:
            wanted = (
                "s" if component == LOGGING and what == "nuisance" else units.get((component, name), units.get((component, f"{name}[1]")))
            )
            if wanted is not None and unit != wanted:
                raise CatalogueError(
                    f"{place}: {what}: its unit is {unit!r}, that of {component}.{name} is {wanted!r}: give the sizes in that unit"
                )


class _Reader:
    """The checks; every message begins with the file and the entry."""

    def __init__(self, file: Path, content: TomlFile) -> None:
        self.file, self.content = file, content
        self.at: tuple[str | int, ...] = ()
        """The entry that is read."""

    def fail(self, where: str, text: str) -> CatalogueError:
        return CatalogueError(f"{self.content.place(*self.at)}: {where}: {text}")

    def keys(self, where: str, table: Any, allowed: set[str], required: set[str]) -> dict[str, Any]:
        if not isinstance(table, dict):
            raise self.fail(where, f"expected a table, found {table!r}")
        for key in table:
            if key not in allowed:
                self.at = (*self.at, key)
                near = difflib.get_close_matches(key, allowed, 1)
                raise self.fail(
                    where, f"unknown key {key!r}{f', did you mean {near[0]!r}' if near else ''}; known: {', '.join(sorted(allowed))}"
                )
        missing = sorted(required - set(table))
        if missing:
            raise self.fail(where, f"missing: {', '.join(missing)}")
        return table

    def number(self, where: str, key: str, value: Any, *, positive: bool = True) -> float:
        usable = (
            not isinstance(value, bool) and isinstance(value, int | float) and abs(value) <= sys.float_info.max
        )  # no NaN, inf, huge integer
        if not usable or (positive and value <= 0.0):
            self.at = (*self.at, key)
            raise self.fail(where, f"{key} = {value!r}; expected a {'positive ' if positive else ''}number in the unit that is stated")
        return float(value)

    def text(self, where: str, key: str, value: Any) -> str:
        if not isinstance(value, str) or not value:
            raise self.fail(where, f"{key} = {value!r}; expected a text")
        return value

    def names(self, where: str, component: str, value: Any) -> tuple[str, ...]:
        if not isinstance(value, list) or not value or not all(isinstance(v, str) and v for v in value):
            raise self.fail(where, f"parameters = {value!r}; expected a list of names, such as ['backlash[2]']")
        for name in value:
            kind, _, pattern = name.partition(" ")
            if component == LOGGING and (kind not in OBSERVATIONS or not pattern):
                raise self.fail(where, f"parameter {name!r} of the log; expected 'KIND PATTERN' with KIND one of {', '.join(OBSERVATIONS)}")
        return tuple(value)

    def catalogue(self) -> Catalogue:
        table = dict(self.content.table)
        self.keys("the file", table, {"effect", "nuisance", "quiet", "seed", "refinement", "titles"}, {"effect"})
        candidates: list[Candidate] = []
        descriptions: dict[str, tuple[str, str]] = {}
        for i, entry in enumerate(self.listed("effect", table["effect"])):
            self.at = ("effect", i)
            found = self.effect(f"[[effect]] {i + 1}", entry)
            name = found[0].effect
            if name in descriptions:
                raise self.fail(f"effect {name!r}", "is there twice")
            descriptions[name] = (entry["description"], entry["source"])
            candidates += found
        tolerances: list[Tolerance] = []
        for i, entry in enumerate(self.listed("nuisance", table.get("nuisance", []))):
            where, self.at = f"[[nuisance]] {i + 1}", ("nuisance", i)
            self.keys(where, entry, _NUISANCE, {"component", "parameters", "source"})
            self.text(where, "source", entry["source"])
            given = [k for k in ("relative", "absolute") if k in entry]
            if len(given) != 1:
                raise self.fail(where, f"expected either relative or absolute; found {' and '.join(given) or 'neither'}")
            component, size = self.text(where, "component", entry["component"]), self.number(where, given[0], entry[given[0]])
            unit, place = self.text(where, "unit", entry.get("unit", "1")), self.content.place(*self.at, given[0])
            tolerances += [
                Tolerance((component, p), size, given[0] == "relative", unit, place)
                for p in self.names(where, component, entry["parameters"])
            ]
        quiet: dict[str, Mapping[str, Any]] = {}
        for i, entry in enumerate(self.listed("quiet", table.get("quiet", []))):
            where, self.at = f"[[quiet]] {i + 1}", ("quiet", i)
            self.keys(where, entry, _QUIET, _QUIET)
            component = self.text(where, "component", entry["component"])
            values = self.content.written(self.keys(where, entry["parameters"], set(entry["parameters"]), set()), *self.at, "parameters")
            quiet[component] = merged(quiet.get(component, {}), values)
        seeds = []
        for i, entry in enumerate(self.listed("seed", table.get("seed", []))):
            where, self.at = f"[[seed]] {i + 1}", ("seed", i)
            self.keys(where, entry, _SEED, _SEED)
            seeds.append((self.text(where, "component", entry["component"]), self.text(where, "parameter", entry["parameter"])))
        refinement = self.refinement(table["refinement"]) if "refinement" in table else None
        named = table.get("titles", {})
        titles = {k: self.text("[titles]", k, v) for k, v in self.keys("[titles]", named, set(named), set()).items()}
        return Catalogue(self.file, tuple(candidates), tuple(tolerances), quiet, tuple(seeds), descriptions, refinement, titles)

    def refinement(self, entry: Any) -> Refinement:
        self.keys("[refinement]", entry, _REFINEMENT, {"divide"})
        divide = entry["divide"]
        if isinstance(divide, bool) or not isinstance(divide, int) or divide < 2:
            raise self.fail("[refinement]", f"divide = {divide!r}; expected a whole number from 2")
        sampled = entry.get("sampled", [])
        if not isinstance(sampled, list):
            raise self.fail("[refinement]", f"sampled = {sampled!r}; expected a list of components")
        return Refinement(divide, tuple(self.text("[refinement]", "sampled", name) for name in sampled))

    def listed(self, key: str, value: Any) -> list[Any]:
        if not isinstance(value, list):
            raise self.fail(key, f"expected [[{key}]] entries, found {value!r}")
        return value

    def effect(self, where: str, entry: Any) -> list[Candidate]:
        if isinstance(entry, dict) and isinstance(entry.get("name"), str):
            where = f"effect {entry['name']!r}"
        self.keys(where, entry, _EFFECT, _EFFECT)
        self.text(where, "name", entry["name"])
        component = self.text(where, "component", entry["component"])
        sign = entry["sign"]
        if sign not in ("positive", "both"):
            raise self.fail(where, f"sign = {sign!r}; expected 'positive' or 'both'")
        low, high = (self.number(where, key, entry[key]) for key in ("minimum", "maximum"))
        if low >= high:
            raise self.fail(where, f"minimum = {low} is not below maximum = {high} (both are magnitudes)")
        prior = self.prior(where, entry["prior"])
        for key in ("description", "source", "unit"):
            self.text(where, key, entry[key])
        made, seen = [], set()
        locations = self.listed("locations", entry["locations"])
        if not locations:
            raise self.fail(where, "has no locations")
        for spot in locations:
            self.keys(f"{where}, locations", spot, _LOCATION | {_PHASE, _PER}, _LOCATION)
            name = self.text(where, "name of a location", spot["name"])
            if name in seen:
                raise self.fail(where, f"location {name!r} is there twice")
            seen.add(name)
            parameters = self.names(f"{where}, location {name!r}", component, spot["parameters"])
            size, both = prior, sign == "both"
            if _PHASE in spot:
                phase = self.text(f"{where}, location {name!r}", _PHASE, spot[_PHASE])
                if len(parameters) != 1 or component == LOGGING:
                    raise self.fail(
                        f"{where}, location {name!r}", f"phase = {phase!r}; expected one parameter of a component beside it, its amplitude"
                    )
                parameters = (parameters[0] + COS + phase, parameters[0] + SIN + phase)
                size, both = Prior("normal", prior.scale), True
            if _PER in spot and (spot[_PER] != "run" or _PHASE not in spot):
                raise self.fail(f"{where}, location {name!r}", f"per = {spot[_PER]!r}; expected 'run' beside a phase")
            unit, places, written = entry["unit"], len(locations), self.content.place(*self.at, "unit")
            made.append(Candidate(entry["name"], component, name, parameters, low, high, size, unit, both, places, written, _PER in spot))
        return made

    def prior(self, where: str, value: Any) -> Prior:
        self.keys(f"{where}, prior", value, {"kind", "scale", "spread"}, {"kind", "scale"})
        if value["kind"] not in ("normal", "log-normal"):
            raise self.fail(where, f"prior kind {value['kind']!r}; expected 'normal' or 'log-normal'")
        return Prior(
            value["kind"], self.number(where, "prior scale", value["scale"]), self.number(where, "prior spread", value.get("spread", 0.8))
        )
