"""Experiments: runs made to find something out, simulated as they would be measured.

Keys of the file, a scenario of kind "experiment", are declared below (`ExperimentKeys`), with an example in
docs/reference/formats/experiment.md. Each repeat is a run folder with the labels condition, repeat, held_out, kind, tier, and `parameters`:
what the experimenter set. A program is a table in the run's folder, so a run stands alone.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.equipment import load_system, ports_of
from robomill.cell.equipment_keys import EquippedKeys
from robomill.cell.milling import Progress, notes_of, own_tool, read_program, with_parameters
from robomill.cell.plan_checks import check_plan
from robomill.cell.scenario import ComponentParameters, ScenarioError, equipment
from robomill.models.model.declaration import FloatArray
from robomill.models.planning import gcode
from robomill.models.planning.trajectory import Placement, Plan, plan
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.files import RUN
from robomill.orchestration.runs.run import Run, check_vacant, read_info
from robomill.orchestration.system import keys
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, Kind, default, optional, required
from robomill.orchestration.system.toml_text import dump, parse
from robomill.orchestration.system.written import merged

PATH, LOAD = "segments.npy", "profile.npy"
"""Tables in the folder of a run: the planned program, the applied load."""
SEED, APART = "seed", 1_000_000
"""Parameter of a component that has noise, and how far apart those of two components are: more than all repeats of an experiment."""
GRAVITY = 9.81
"""m/s2, as in the models."""
LOAD_ROW = ("s", "N", "N", "N")
"""Units of a row of an applied load as it is written: time, force in B. The table has moments behind them, which are 0."""


@dataclass(frozen=True)
class ExperimentCondition:
    """One way to measure; SI."""

    name: str
    program: Path
    position: tuple[float, ...]
    abc: tuple[float, ...]
    size: tuple[float, ...] | None
    load: FloatArray
    """(n, 7): time [s], force [N], moment [N m] on the tool in B; (0, 7): no applied load."""
    held_out: bool
    parameters: ComponentParameters
    minutes: float = 0.0
    """What all its repeats cost on the machine, with setting up; 0: not said."""


@dataclass(frozen=True)
class RepeatSummary:
    """One run of an experiment, as summary.json has it."""

    folder: str
    condition: str
    repeat: int
    duration_s: float
    max_displacement_m: float | None
    max_force_n: float | None
    """As measured; None where that is not recorded."""


@dataclass(frozen=True)
class Experiment:
    """An experiment file, paths made absolute."""

    file: Path
    name: str
    title: str
    kind: str
    repeats: int
    system: Path
    parameters: ComponentParameters
    machine: ComponentParameters
    conditions: tuple[ExperimentCondition, ...]
    equipment: Mapping[str, Entry] = field(default_factory=dict)
    """Robot, tool, material and sensor, where they are others than those of the system."""
    columns: tuple[str, ...] = ()
    """Patterns of what is recorded; none: what the system records."""


def is_experiment(file: Path) -> bool:
    """Whether a TOML file is a scenario of kind "experiment"."""
    try:
        return bool(parse(file.read_text(encoding="utf-8"))["scenario"]["kind"] == "experiment")
    except (OSError, KeyError, TypeError, tomllib.TOMLDecodeError, UnicodeDecodeError):
        return False


def _minutes(entry: Entry) -> float:
    """The key says the unit; a text may say another."""
    found = entry.si("min" if isinstance(entry.value, str) else "1")
    if found < 0.0:
        raise entry.fail(f"{entry.value!r} is negative; expected 0 or more")
    return found


LOAD_ROWS = keys.anything("rows `[time, fx, fy, fz]`", "s, N")
"""An applied load as it is written."""


class ExperimentHeadKeys(Keys):
    """What the experiment is called, and what is measured."""

    name = required(keys.folder_name(), "name of the experiment; results stand in a folder of that name")
    kind = optional(keys.text(), "`experiment`")
    title = optional(keys.text(), "heading of the results (default: the name)")
    system = required(keys.file(), "system file: components and connections")


class MeasurementKeys(Keys):
    """How often and what is measured."""

    kind = required(keys.text(), "kind of experiment, a label of the runs")
    repeats = default(1, keys.count(1), "repeats of each condition, each with noise of its own")
    columns = optional(keys.texts(), "patterns of what is measured (default: what the system records)")


class ConditionKeys(Keys):
    """One way to measure; all its repeats are run folders."""

    name = required(keys.text(), "name of the condition, used once")
    program = required(keys.file(), "G-code, or a path of points (TOML)")
    position = required(keys.vector("m"), "of the frame that the program is in, in the robot base")
    abc = default([0, 0, 0], keys.vector("rad"), "orientation of that frame: Euler angles A about z, B about y', C about x''")
    size = optional(keys.vector("m"), "size of the block, where one is milled")
    load = default([], LOAD_ROWS, "force on the tool in the robot base over time, straight lines between the rows")
    weight = default(0, keys.quantity("kg"), "mass that hangs from the tool tip all the time, not negative")
    held_out = default(False, keys.flag(), "label of the runs: a diagnosis does not fit them, it tries its answer on them")
    minutes = default(0, Kind(_minutes, "number, or quantity", "min"), "what all repeats cost on the machine, with setting up; 0: not said")
    parameters = default({}, keys.parameters(), "parameters that the experimenter sets in this condition, with units")


class ExperimentKeys(EquippedKeys):
    """Runs made to find something out, simulated as they would be measured. A scenario of kind `experiment`."""

    scenario = required(keys.table(ExperimentHeadKeys), "what the experiment is called, and its system")
    experiment = required(keys.table(MeasurementKeys), "how often and what is measured")
    parameters = default({}, keys.parameters(), "parameters that the experimenter knows, for all conditions")
    machine = default({}, keys.parameters(), "parameters that the machine has and nobody knows; not written to the runs")
    condition = required(keys.each(ConditionKeys), "the ways to measure")


def load_experiment(path: str | Path) -> Experiment:
    """Read and check an experiment file. ScenarioError or FileNotFoundError says what is wrong and what is possible."""
    file = Path(path).resolve()
    top = ExperimentKeys.of(Entry.load(file, ScenarioError, convert))
    head, about = ExperimentKeys.scenario.of(top), ExperimentKeys.experiment.of(top)
    conditions = tuple(read_condition(entry) for entry in top["condition"].each())
    names = [c.name for c in conditions]
    folders = [folder_of(name) for name in names]
    for i, folder in enumerate(folders):
        if folder in folders[:i]:
            other = names[folders.index(folder)]
            raise top["condition"][i]["name"].fail(
                f"{names[i]!r} and {other!r} are the same or have the same folder of results, {folder}; give one of them another name"
            )
    return Experiment(
        file,
        ExperimentHeadKeys.name.of(head),
        ExperimentHeadKeys.title.of(head) or ExperimentHeadKeys.name.of(head),
        MeasurementKeys.kind.of(about),
        MeasurementKeys.repeats.of(about),
        ExperimentHeadKeys.system.of(head),
        ExperimentKeys.parameters.of(top),
        ExperimentKeys.machine.of(top),
        conditions,
        equipment(top),
        MeasurementKeys.columns.of(about) or (),
    )


def folder_of(condition: str) -> str:
    """The name of a condition as that of a folder."""
    return "".join(ch if ch.isalnum() or ch in "+-" else "_" for ch in condition)


def read_condition(entry: Entry) -> ExperimentCondition:
    """A condition of an experiment, or one that is made like it (`next_runs.py`)."""
    k = ConditionKeys
    k.of(entry)
    rows = k.load.of(entry)
    if not isinstance(rows.value, list) or not all(isinstance(r, list) and len(r) == len(LOAD_ROW) for r in rows.value):
        raise rows.fail(f"{rows.value!r}; expected rows of time, fx, fy, fz")
    load = np.zeros((max(len(rows.value), 1), 7))
    for i in range(len(rows.value)):
        load[i, : len(LOAD_ROW)] = [rows[i][k].si(unit) for k, unit in enumerate(LOAD_ROW)]
        if i and load[i, 0] <= load[i - 1, 0]:
            raise rows[i].fail(
                f"the time {load[i, 0]:g} s is not after that of the row before, {load[i - 1, 0]:g} s"
                "; expected times that grow from row to row"
            )
    weight = k.weight.of(entry)
    if weight < 0.0:
        raise entry["weight"].fail(f"{entry['weight'].value!r} is negative; expected 0 or more")
    load[:, 3] -= weight * GRAVITY
    return ExperimentCondition(
        k.name.of(entry),
        k.program.of(entry),
        k.position.of(entry),
        k.abc.of(entry),
        k.size.of(entry),
        load if rows.value or weight else load[:0],
        k.held_out.of(entry),
        k.parameters.of(entry),
        k.minutes.of(entry),
    )


def known_parameters(experiment: Experiment, c: ExperimentCondition, system: System) -> dict[str, Mapping[str, Any]]:
    """What the experimenter sets, without the tables of program and load."""
    known: dict[str, Mapping[str, Any]] = {"path": {}}
    names = {component.name for component in system.components}
    if "milling" in names and c.size is not None:
        quaternion = np.roll(Rotation.from_euler("ZYX", c.abc).as_quat(canonical=True), 1)
        known["milling"] = {"p_BP_B": list(c.position), "quat_BP": [float(v) for v in quaternion], "block_size": list(c.size)}
    for table in (experiment.parameters, c.parameters):
        for component, values in table.items():
            known[component] = merged(known.get(component, {}), values)
    return known


def prepare(experiment: Experiment, c: ExperimentCondition, system: System, folder: Path) -> tuple[Plan, dict[str, Mapping[str, Any]]]:
    """Plan the condition for `system` and write its tables into `folder` (made).

    Returns the plan and all that the experimenter sets, files by their names in the folder. Raises what reader and planner raise.
    """
    folder.mkdir(parents=True, exist_ok=True)
    planned = plan(read_program(c.program, gcode.Setup()), _placement(c))
    np.save(folder / PATH, planned.table)
    known = known_parameters(experiment, c, system)
    known["path"] = merged(known["path"], {"segments": PATH})
    if any(component.name == "load" for component in system.components):
        np.save(folder / LOAD, c.load)
        known["load"] = merged(known.get("load", {}), {"profile": LOAD})
    return planned, known


def remarks(experiment: Experiment, names: Sequence[str] | None = None) -> tuple[list[str], list[str]]:
    """Notes and warnings about the programs of all conditions (or of those in `names`); each once, with its conditions.

    Raises what reader and planner raise, so that what cannot be planned is refused before anything is run.
    """
    system = load_system(experiment.system, experiment.equipment)
    mills = any(component.name == "milling" for component in system.components)
    said: tuple[dict[str, list[str]], dict[str, list[str]]] = {}, {}
    for c in _chosen(experiment, names):
        program = read_program(c.program, gcode.Setup())
        texts = (*notes_of(program), *plan(program, _placement(c)).notes)
        own = own_tool(with_parameters(system, known_parameters(experiment, c, system))) if mills and c.size is not None else None
        x, y, z = c.size or (0.0, 0.0, 0.0)
        findings = check_plan(program, (x, y, z), {0: own}).texts if own is not None else ()
        for found, kind in zip((texts, findings), said, strict=True):
            for text in found:
                kind.setdefault(f"{c.program.name}: {text}", []).append(c.name)
    notes, warnings = ([f"{text} (condition {', '.join(where)})" for text, where in kind.items()] for kind in said)
    return notes, warnings


def _placement(c: ExperimentCondition) -> Placement:
    x, y, z = c.position
    a, b, g = c.abc
    return Placement((x, y, z), (a, b, g))


def in_folder(known: ComponentParameters, folder: Path) -> dict[str, Mapping[str, Any]]:
    """The parameters with the tables of path and load found from everywhere."""
    tables = {k: {n: str((folder / v).resolve()) for n, v in values.items() if v in (PATH, LOAD)} for k, values in known.items()}
    return {k: merged(values, tables[k]) for k, values in known.items()}


def run_condition(
    experiment: Experiment,
    c: ExperimentCondition,
    repeat: int,
    folder: Path,
    fmus: Path | None = None,
    csv: bool = False,
    tier: str = "T1",
    overwrite: bool = False,
) -> Run:
    """One repeat into `folder`; a run that is there is replaced with `overwrite`, else refused.

    Raises what reader, planner and master raise.
    """
    if not overwrite:
        check_vacant([folder])
    system = load_system(experiment.system, experiment.equipment)
    planned, known = prepare(experiment, c, system, folder)
    seeds = _seeds(system, 1000 * (1 + experiment.conditions.index(c)) + repeat)
    configured = with_parameters(with_parameters(with_parameters(system, seeds), experiment.machine), in_folder(known, folder))
    recording = replace(configured.recording, csv=csv, columns=experiment.columns or configured.recording.columns)
    configured = replace(configured, name=experiment.name, recording=recording)
    if fmus is not None:
        configured = with_fmus(configured, fmus)
    labels = {
        "program": planned.name,
        "condition": c.name,
        "repeat": repeat,
        "held_out": c.held_out,
        "kind": experiment.kind,
        "tier": tier,
    }
    run(configured, folder, resolver=resolve, convert=convert, labels=labels, overwrite=overwrite)
    info = read_info(folder)
    info["parameters"] = known
    (folder / RUN).write_text(dump(info), encoding="utf-8")
    return Run.load(folder)


def _seeds(system: System, number: int) -> dict[str, dict[str, int]]:
    """Another noise for each component that has some: `number` seeds that of the sensor."""
    noisy = [c.name for c in system.components if any(p.name == SEED for p in ports_of(system, c.name))]
    return {name: {SEED: number + APART * k} for k, name in enumerate(sorted(noisy, key=lambda name: name != "sensor"))}


def _place(folder: Path, c: ExperimentCondition, repeat: int) -> Path:
    return folder / f"{folder_of(c.name)}-{repeat}"


def _chosen(experiment: Experiment, names: Sequence[str] | None) -> list[ExperimentCondition]:
    """All conditions, or those in `names`; ScenarioError if one is not there."""
    unknown = sorted(set(names or ()) - {c.name for c in experiment.conditions})
    if unknown:
        raise ScenarioError(
            f"{experiment.file}: no condition {', '.join(unknown)}; conditions: {', '.join(c.name for c in experiment.conditions)}"
        )
    return [c for c in experiment.conditions if not names or c.name in names]


def run_experiment(
    experiment: Experiment,
    folder: Path,
    names: Sequence[str] | None = None,
    fmus: Path | None = None,
    csv: bool = False,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> list[RepeatSummary]:
    """All repeats of all conditions (or of those in `names`) below `folder`, in turn.

    Runs that are there are replaced with `overwrite`; else nothing is begun.
    """
    chosen = _chosen(experiment, names)
    repeats = range(1, experiment.repeats + 1)
    if not overwrite:
        check_vacant(_place(folder, c, repeat) for c in chosen for repeat in repeats)
    runs: list[RepeatSummary] = []
    for i, c in enumerate(chosen):
        for repeat in repeats:
            if progress is not None:
                progress(experiment.name, i * experiment.repeats + repeat - 1, len(chosen) * experiment.repeats)
            place = _place(folder, c, repeat)
            result = run_condition(experiment, c, repeat, place, fmus, csv, overwrite=overwrite)
            largest = (_largest(result, name) for name in ("compliance.d_T_B", "sensor.f_T_T"))
            runs.append(RepeatSummary(place.name, c.name, repeat, float(result.t[-1]), *largest))
    return runs


def _largest(result: Run, name: str) -> float | None:
    return float(np.linalg.norm(result[name], axis=1).max()) if name in result else None
