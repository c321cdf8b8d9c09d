"""The menu of runs that could be made next: short experiments in scenarios/next_runs, for any milling cell.

`prepare` turns a cell (the one that is diagnosed, or one with something wrong) into the system that makes such a run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from robomill.cell.experiments import Experiment, ExperimentCondition, in_folder, load_experiment
from robomill.cell.experiments import prepare as prepare_condition
from robomill.cell.milling import PARTS
from robomill.files import FILES
from robomill.orchestration.system.definition import Component, Connection, System

FOLDER = FILES / "scenarios" / "next_runs"
_CUT, _LOAD = "milling", "load"


@dataclass(frozen=True)
class NextRun:
    """A run that could be made: SI, and minutes for the people who make it."""

    kind: str
    system: System
    """What makes it; the parameters below are not set in it."""
    parameters: Mapping[str, Mapping[str, Any]]
    """What the experimenter sets, component -> parameter -> value; files by absolute paths."""
    seconds: float
    """Length of one repeat."""
    minutes: float
    """What all repeats cost, with setting up."""
    repeats: int


@cache
def _entries() -> dict[str, tuple[Experiment, ExperimentCondition]]:
    files = (load_experiment(f) for f in sorted(FOLDER.glob("*.toml")) if "scenario" in f.read_text(encoding="utf-8"))
    return {c.name: (e, c) for e in files for c in e.conditions}


def kinds(system: System | None = None) -> tuple[str, ...]:
    """Names of the runs on the menu; those that `system` can make: a milling cell all, one with an applied load those without a cut."""
    names = {*PARTS, _LOAD} if system is None else {c.name for c in system.components}
    if not {*PARTS} - {_CUT} <= names or not names & {_CUT, _LOAD}:
        return ()
    return tuple(kind for kind, (_, c) in _entries().items() if c.size is None or _CUT in names)


def prepare(system: System, kind: str, folder: Path) -> NextRun:
    """The run `kind` with the cell `system`; its tables are written into `folder`. LookupError lists what is on the menu."""
    if kind not in _entries():
        raise LookupError(f"no run {kind!r} on the menu; there are: {', '.join(kinds())}")
    experiment, c = _entries()[kind]
    made = system if c.size is not None or _CUT not in {part.name for part in system.components} else with_load(system)
    planned, known = prepare_condition(experiment, c, made, folder)
    return NextRun(kind, made, in_folder(known, folder), planned.duration, c.minutes, experiment.repeats)


def with_load(cell: System) -> System:
    """The cell with a load that is applied on purpose (`models/components/applied_load.py`) in place of the cut."""
    components = tuple(Component(_LOAD, "applied_load") if c.name == _CUT else c for c in cell.components)
    connections = []
    for c in cell.connections:
        if c.target.partition(".")[0] == _CUT:
            continue
        part, _, port = c.source.partition(".")
        connections.append(Connection(f"{_LOAD}.{port}", c.target, c.delayed) if part == _CUT else c)
    return replace(cell, components=components, connections=tuple(connections))
