"""Scenarios of controlled material removal rate: the feed follows the force along a profile of depths, Pan & Zhang (paper 003) section 4.

Keys of the file are declared below (`RateKeys`), with an example in docs/reference/formats/removal_rate.md. Figures of a section are called
`force_`, `std_`, `line_`, `feed_` and its name.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.equipment import load_system
from robomill.cell.equipment_keys import EquippedKeys
from robomill.cell.milling import Progress, with_parameters
from robomill.cell.scenario import (
    ComponentParameters,
    ScenarioError,
    ScenarioKeys,
    Variant,
    VariantKeys,
    equipment,
    published_figures,
    variant,
)
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run, check_vacant
from robomill.orchestration.system import keys
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required
from robomill.orchestration.system.parameters import quantity
from robomill.orchestration.system.toml_text import parse

KIND = "removal_rate"
PROFILE = "profile.npy"
"""Table of depths in the folder of the results."""
FINE = 2.5e-4
"""Way [m] between rows of the table on the flanks of a bur."""
STEADY = 0.5
"""Scatter [N] of the force below which no line is looked for in it."""


@dataclass(frozen=True)
class Bur:
    """Material on top of the profile; SI."""

    at: float
    height: float
    flank: float
    top: float

    def above(self, way: FloatArray) -> FloatArray:
        """Height [m] at places along the path [m]: 0.5 h (1 + cos(pi g/flank)) at a distance g from its flat top."""
        gap = np.clip((np.abs(way - self.at) - 0.5 * self.top) / self.flank, 0.0, 1.0)
        height: FloatArray = 0.5 * self.height * (1.0 + np.cos(np.pi * gap))
        return height

    @property
    def ends(self) -> tuple[float, float]:
        """Where it begins and ends [m]."""
        half = 0.5 * self.top + self.flank
        return self.at - half, self.at + half


@dataclass(frozen=True)
class Section:
    """A piece of the path that figures are told of [m]."""

    name: str
    start: float
    end: float


@dataclass(frozen=True)
class RateScenario:
    """A scenario file, paths made absolute."""

    file: Path
    name: str
    title: str
    system: Path
    profile: FloatArray
    """(n, 3): way along the path, depth, width [m]."""
    burs: tuple[Bur, ...]
    sections: tuple[Section, ...]
    limit: float | None
    """Force that must not be exceeded [N]."""
    against: float | None
    """Constant feed [m/s] that the time is compared with."""
    parameters: ComponentParameters
    variants: tuple[Variant, ...]
    paper: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    equipment: Mapping[str, Entry] = field(default_factory=dict)


@dataclass(frozen=True)
class RateResult:
    """A variant that was run."""

    variant: Variant
    run: Run
    figures: dict[str, float]
    remarks: tuple[str, ...]
    """What exceeds the limit, or did not get to the end."""
    reference: float | None
    """Reference force of the controller [N], where a file names one."""


def is_removal_rate(file: Path) -> bool:
    """Whether a TOML file is a scenario of this kind."""
    try:
        return bool(parse(file.read_text(encoding="utf-8"))["scenario"]["kind"] == KIND)
    except (OSError, KeyError, TypeError, tomllib.TOMLDecodeError, UnicodeDecodeError):
        return False


class RateHeadKeys(Keys):
    """What the scenario is called, and its system."""

    name = required(keys.folder_name(), "name of the scenario; results stand in a folder of that name")
    kind = optional(keys.text(), "`removal_rate`")
    title = optional(keys.text(), "heading of the results (default: the name)")
    system = required(keys.file(), "system file with the components `robot`, `process` and `controller`")


class BurKeys(Keys):
    """A bur on top of the profile: raised-cosine flanks beside a flat top."""

    at = required(keys.quantity("m"), "way along the path to its middle")
    height = required(keys.quantity("m"), "height, above 0")
    flank = required(keys.quantity("m"), "length of each flank, above 0")
    top = required(keys.quantity("m"), "length of the flat top")


class CutKeys(Keys):
    """What is cut."""

    rows = required(
        keys.anything("rows `[way, depth]`", "m"), "way along the path and depth of cut, growing, straight lines between the rows"
    )
    width = default("1 mm", keys.quantity("m"), "width of cut")
    bur = default([], keys.each(BurKeys), "burs on top")


class SectionKeys(Keys):
    """A piece of the path whose figures are told by its name: mean, scatter and strongest spectral line of the force, mean feed."""

    begin = required(keys.quantity("m"), "where it begins along the path", name="from")
    end = required(keys.quantity("m"), "where it ends", name="to")


class LimitKeys(Keys):
    """What the spindle bears."""

    force = required(keys.quantity("N"), "force above 0; what exceeds it is said")


class AgainstKeys(Keys):
    """A cut at constant feed that the time is compared with."""

    feed = required(keys.quantity("m/s"), "its feed, above 0")


class RateKeys(EquippedKeys):
    """Controlled material removal rate: the feed follows the force along a profile of depths. A scenario of kind `removal_rate`."""

    scenario = required(keys.table(RateHeadKeys), "what the scenario is called, and its system")
    cut = required(keys.table(CutKeys), "what is cut")
    section = default({}, keys.tables(SectionKeys), "pieces of the path, by name")
    limit = optional(keys.table(LimitKeys), "what the spindle bears")
    against = optional(keys.table(AgainstKeys), "a cut at constant feed to compare with")
    parameters = default({}, keys.parameters(), "parameters of all variants, with units")
    variants = required(keys.tables(VariantKeys), "ways to run the scenario, by name")
    paper = ScenarioKeys.paper


def load_removal_rate(path: str | Path) -> RateScenario:
    """Read and check a scenario file. ScenarioError or FileNotFoundError says what is wrong and what is possible."""
    file = Path(path).resolve()
    top, k = RateKeys.of(Entry.load(file, ScenarioError, convert)), RateHeadKeys
    head, cut = RateKeys.scenario.of(top), RateKeys.cut.of(top)
    burs = tuple(_bur(entry) for entry in CutKeys.bur.of(cut))
    profile = _profile(cut, burs)
    sections = tuple(_section(name, entry, profile[-1, 0]) for name, entry in RateKeys.section.of(top).items())
    return RateScenario(
        file,
        k.name.of(head),
        k.title.of(head) or k.name.of(head),
        k.system.of(head),
        profile,
        burs,
        sections,
        _positive(LimitKeys.of(top["limit"])["force"], "N") if "limit" in top else None,
        _positive(AgainstKeys.of(top["against"])["feed"], "m/s") if "against" in top else None,
        RateKeys.parameters.of(top),
        tuple(variant(name, entry) for name, entry in top["variants"].items()),
        {name: published_figures(entry) for name, entry in RateKeys.paper.of(top).items()},
        equipment(top),
    )


def _positive(entry: Entry, unit: str) -> float:
    value = entry.si(unit)
    if value <= 0.0:
        raise entry.fail(f"{entry.value!r}; expected more than 0")
    return value


def _bur(entry: Entry) -> Bur:
    return Bur(BurKeys.at.of(entry), _positive(entry["height"], "m"), _positive(entry["flank"], "m"), BurKeys.top.of(entry))


def _section(name: str, entry: Entry, end: float) -> Section:
    start, stop = SectionKeys.begin.of(entry), SectionKeys.end.of(entry)
    if not 0.0 <= start < stop <= end:
        raise entry.fail(f"from {start:g} m to {stop:g} m; expected a piece of the path, which goes from 0 to {end:g} m")
    return Section(name, start, stop)


def _profile(cut: Entry, burs: Sequence[Bur]) -> FloatArray:
    """The rows and the burs on top of them as a table of way, depth, width [m]."""
    rows = cut["rows"].each()
    pair = ("m", "m")
    for row in rows:
        if len(row.each()) != len(pair):
            raise row.expected("way along the path and depth of cut")
    table = np.array([[row[k].si(unit) for k, unit in enumerate(pair)] for row in rows]).reshape(-1, len(pair))
    if len(table) < len(pair):
        raise cut["rows"].fail("expected two rows at least: where the path begins and where it ends")
    for i in np.flatnonzero(np.diff(table[:, 0]) <= 0.0):
        raise rows[i + 1].fail(
            f"the way {table[i + 1, 0]:g} m is not behind that of the row before, {table[i, 0]:g} m; "
            "write a step of the depth as two rows a little apart"
        )
    if (table[:, 1] < 0.0).any():
        raise cut["rows"].fail("a depth of cut is negative; air is 0; expected 0 or more")
    fine = [np.arange(start, end + FINE, FINE) for start, end in (bur.ends for bur in burs)]
    way = np.unique(np.concatenate([table[:, 0], *fine]))
    way = way[(way >= table[0, 0]) & (way <= table[-1, 0])]
    depth = np.interp(way, *table.T) + sum((bur.above(way) for bur in burs), np.zeros_like(way))
    return np.column_stack([way, depth, np.full_like(way, CutKeys.width.of(cut))])


def run_variant(
    scenario: RateScenario, chosen: Variant, folder: Path, fmus: Path | None = None, csv: bool = False, overwrite: bool = False
) -> RateResult:
    """Run a variant into `folder`/its name and work out its figures. Raises what the master raises."""
    place = folder / chosen.name
    place.mkdir(parents=True, exist_ok=True)
    table = (place / PROFILE).resolve()
    np.save(table, scenario.profile)
    system = load_system(scenario.system, scenario.equipment)
    for parameters in ({"process": {"profile": str(table)}}, scenario.parameters, chosen.parameters):
        system = with_parameters(system, parameters)
    system = replace(system, name=scenario.name, recording=replace(system.recording, csv=csv))
    labels = {"condition": chosen.name, "kind": KIND}
    recorded = run(
        with_fmus(system, fmus) if fmus else system, place, resolver=resolve, convert=convert, labels=labels, overwrite=overwrite
    )
    return evaluate(scenario, chosen, system, recorded)


def evaluate(scenario: RateScenario, chosen: Variant, system: System, recorded: Run) -> RateResult:
    """Figures of a run, SI, percent as such; remarks on what exceeds the limit."""
    force, feed, way = recorded["process.force"], recorded["robot.feed"], recorded["process.distance"]
    figures = {"duration_s": float(recorded.t[-1]), "peak_force_n": float(force.max())}
    figures["switches"] = float(np.count_nonzero(np.diff(recorded["controller.speed_ratio"])))
    if scenario.against is not None:
        figures["saved_percent"] = 100.0 * (
            1.0 - figures["duration_s"] * scenario.against / (scenario.profile[-1, 0] - scenario.profile[0, 0])
        )
    for section in scenario.sections:
        inside = (way >= section.start) & (way <= section.end)
        figures |= _of_section(section.name, force[inside], feed[inside], system.step)
    written = system.component("controller").parameters.get("F_r")
    reference = None if written is None else quantity(written, "N", convert)
    return RateResult(chosen, recorded, figures, tuple(_remarks(scenario, recorded, system.step)), reference)


def _of_section(name: str, force: FloatArray, feed: FloatArray, step: float) -> dict[str, float]:
    """Mean and scatter of the force [N], its strongest line [Hz] (0 if it is steady), mean feed [m/s]."""
    if len(force) == 0:
        return dict.fromkeys((f"force_{name}_n", f"std_{name}_n", f"line_{name}_hz", f"feed_{name}_m_s"), float("nan"))
    spectrum = np.abs(np.fft.rfft((force - force.mean()) * np.hanning(len(force))))
    line = float(np.fft.rfftfreq(len(force), step)[spectrum.argmax()]) if force.std() > STEADY else 0.0
    return {
        f"force_{name}_n": float(force.mean()),
        f"std_{name}_n": float(force.std()),
        f"line_{name}_hz": line,
        f"feed_{name}_m_s": float(feed.mean()),
    }


def _remarks(scenario: RateScenario, recorded: Run, step: float) -> list[str]:
    """Burs that could not be held, other places above the limit, a path that did not end."""
    said = []
    force, way = recorded["process.force"], recorded["process.distance"]
    if scenario.limit is not None:
        above = force > scenario.limit
        for i, bur in enumerate(scenario.burs, 1):
            inside = above & (way >= bur.ends[0]) & (way <= bur.ends[1])
            if inside.any():
                said.append(
                    f"bur {i} at {1e3 * bur.at:.0f} mm cannot be held: {force[inside].max():.0f} N, above {scenario.limit:.0f} N for "
                    f"{1e3 * step * np.count_nonzero(inside):.0f} ms; lower the nominal feed or take it off in two cuts"
                )
            above &= ~inside
        if above.any():
            said.append(f"above {scenario.limit:.0f} N beside the burs: {force[above].max():.0f} N at {1e3 * way[above][0]:.0f} mm")
    if not recorded["process.finished"][-1]:
        said.append(f"stopped at {1e3 * way[-1]:.0f} mm of {1e3 * scenario.profile[-1, 0]:.0f} mm: the end of the path was not reached")
    return said


def run_removal_rate(
    scenario: RateScenario,
    folder: Path,
    fmus: Path | None = None,
    csv: bool = False,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> list[RateResult]:
    """Run every variant below `folder`. Runs that are there are replaced with `overwrite`; else nothing is begun."""
    if not overwrite:
        check_vacant(folder / v.name for v in scenario.variants)
    results = []
    for i, chosen in enumerate(scenario.variants):
        if progress is not None:
            progress(scenario.name, i, len(scenario.variants))
        results.append(run_variant(scenario, chosen, folder, fmus, csv, overwrite))
    return results


def summary(scenario: RateScenario, results: Sequence[RateResult]) -> dict[str, Any]:
    """What summary.json holds; figures of a section that was not reached are null."""
    variants = {
        r.variant.name: {**{k: None if math.isnan(v) else v for k, v in r.figures.items()}, "remarks": list(r.remarks)} for r in results
    }
    return {"scenario": scenario.name, "kind": KIND, "variants": variants}
