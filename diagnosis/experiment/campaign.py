"""Campaigns: conditions of several systems that share components, diagnosed together.

A TOML file::

    [campaign]
    name = "stiffness"

    [[condition]]
    name = "pushes"
    system = "loaded_cell.toml"             # what makes these runs: the nominal simulation
    runs = ["../runs/pushes/*"]             # folders of runs, or patterns of them; relative to this file
    role = "diagnose"                       # or "held_out": looked at afterwards, never fitted

Parameters are shared by the name of the component: what is stiffer in one system is stiffer in all that have it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from robomill.diagnosis.experiment.measured import Condition, DataError, driven, is_driven, sort_by_condition
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system import keys
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, required

DIAGNOSE, HELD_OUT = "diagnose", "held_out"


@dataclass(frozen=True)
class Part:
    """Runs of one system; those labelled `held_out` are held out whatever the role."""

    name: str
    """Empty for runs that were given without a name: their conditions go by their labels."""
    system: System
    runs: tuple[Run, ...]
    held_out: tuple[Run, ...] = ()


@dataclass(frozen=True)
class Campaign:
    """What is diagnosed together. DataError where there is no run to diagnose."""

    name: str
    parts: tuple[Part, ...]

    def __post_init__(self) -> None:
        if not self.runs:
            raise DataError("no run to diagnose: all of them are held out; give at least one run that is not held out")

    @staticmethod
    def of(system: System, runs: Sequence[Run], held_out: Sequence[Run] = ()) -> Campaign:
        """Runs of one system; those labelled `held_out` are held out, too."""
        return Campaign(system.name, (_part("", system, runs, held_out),))

    @property
    def system(self) -> System:
        """The system of the first part that has a run to diagnose."""
        return next(p.system for p in self.parts if p.runs)

    @property
    def runs(self) -> list[Run]:
        """Runs that are diagnosed."""
        return [r for p in self.parts for r in p.runs]

    @property
    def held_out(self) -> list[Run]:
        """Runs that are held out."""
        return [r for p in self.parts for r in p.held_out]

    def conditions(self) -> list[Condition]:
        """Those that are diagnosed, of `system` first, and those that are held out.

        A part of several conditions gives each the name of the part and its own.
        """
        parts = sorted(self.parts, key=lambda p: p.system is not self.system)
        return _told_apart([c for held in (False, True) for p in parts for c in self._of(p, held)])

    def _of(self, part: Part, held_out: bool) -> list[Condition]:
        runs = part.held_out if held_out else part.runs
        several = len(sort_by_condition([*part.runs, *part.held_out], part.system)) > 1
        made = []
        for c in sort_by_condition(runs, part.system, held_out):
            system = driven(part.system, c.runs[0])
            made.append(replace(c, system=None if system is self.system else system))
        return [replace(c, name=f"{part.name}: {c.name}" if several else part.name) if part.name else c for c in made]


def _told_apart(conditions: Sequence[Condition]) -> list[Condition]:
    """The conditions, numbered where one that is driven by its own measured signals has the name of another: it is no repeat of that."""
    made: list[Condition] = []
    for c in conditions:
        own = c.system is not None and is_driven(c.system)
        made.append(replace(c, name=f"{c.name} ({len(made) + 1})") if own and any(c.name == other.name for other in made) else c)
    return made


class CampaignHeadKeys(Keys):
    """What the campaign is called."""

    name = required(keys.text(), "name of the campaign")


class ConditionKeys(Keys):
    """Runs of one system, made under one condition."""

    name = required(keys.text(), "name of the condition, used once")
    system = required(keys.file(), "system file of the nominal simulation of these runs")
    runs = required(keys.texts(), "run folders, or patterns of them such as `../runs/pushes/*`, relative to this file")
    role = required(
        keys.choice((DIAGNOSE, HELD_OUT)), "`diagnose`: the runs are fitted; `held_out`: the answer is tried on them afterwards"
    )


class CampaignKeys(Keys):
    """Conditions of several systems that share components, diagnosed together."""

    campaign = required(keys.table(CampaignHeadKeys), "the campaign")
    condition = required(keys.each(ConditionKeys), "the conditions; at least one has the role `diagnose`")


def load_campaign(path: str | Path, load_system: Callable[[Path], System]) -> Campaign:
    """Read a campaign file and all its runs; each system is loaded once.

    DataError or FileNotFoundError says what is wrong, where, and what is possible; ResultsError that a folder is no run.
    """
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"no campaign {file}")
    top = CampaignKeys.of(Entry.load(file, DataError))
    name = CampaignHeadKeys.name.of(CampaignKeys.campaign.of(top))
    k = ConditionKeys
    systems: dict[Path, System] = {}
    parts: dict[str, Part] = {}
    for entry in CampaignKeys.condition.of(top):
        called, role = k.name.of(entry), k.role.of(entry)
        if called in parts:
            raise entry["name"].fail(f"{called!r} is there twice; give every condition a name of its own")
        place = k.system.of(entry)
        if place not in systems:
            systems[place] = load_system(place)
        runs = _runs(entry["runs"], systems[place])
        parts[called] = _part(called, systems[place], runs if role == DIAGNOSE else (), runs if role == HELD_OUT else ())
    if not any(p.runs for p in parts.values()):
        raise DataError(f'{file}: no condition to diagnose: all of them are held out; give one of them role = "{DIAGNOSE}"')
    return Campaign(name, tuple(parts.values()))


def _part(name: str, system: System, runs: Sequence[Run], held_out: Sequence[Run]) -> Part:
    labelled = [r for r in runs if r.info.get("labels", {}).get("held_out") is True]
    return Part(name, system, tuple(r for r in runs if not any(r is h for h in labelled)), (*held_out, *labelled))


def _runs(entry: Entry, system: System) -> list[Run]:
    """The runs that the patterns select, each once."""
    folders: dict[Path, None] = {}
    for i, pattern in enumerate(entry.texts()):
        anchor = Path(pattern).anchor
        base = Path(anchor) if anchor else entry.content.folder
        found = sorted(f for f in base.glob(pattern.removeprefix(anchor)) if f.is_dir())
        if not found:
            raise entry[i].fail(f"{pattern!r} matches no folder below {base}; expected folders of runs, or a pattern of them")
        folders |= dict.fromkeys(found)
    runs = [Run.load(folder) for folder in folders]
    for run in runs:
        _check_recorded_by(run, system, entry)
    return runs


def _check_recorded_by(run: Run, system: System, entry: Entry) -> None:
    """A simulated run says which components made it; what a machine recorded says nothing of them."""
    made = run.info.get("sources", {})
    names = [c.name for c in system.components]
    if made and (lacking := [n for n in names if n not in made]):
        raise entry.fail(
            f"{run.folder} was recorded by another system, {run.info.get('system', '')!r} with {', '.join(made)}; "
            f"{system.name!r} has {', '.join(names)}: {', '.join(lacking)} not in the run; name the system that made it"
        )
