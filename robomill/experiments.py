"""Experiments: runs made to find something out, simulated as they would be measured.

An experiment file is a scenario of kind "experiment"::

    [scenario]
    name = "static_loads_with_weight"
    kind = "experiment"
    title = "..."
    system = "loaded_cell.toml"

    [experiment]
    kind = "static load"            # label of the runs
    repeats = 3                     # of each condition, each with noise of its own

    [parameters]                    # known to the experimenter, for all conditions
    controller.mode = 0
    [machine]                       # not known: what the machine has; not written to the runs
    compliance.stiffness_error = [0, 0.1, 0, 0, 0, 0]

    [[condition]]
    name = "push +x"
    program = "programs/hold.ngc"   # G-code, or a path of points
    position = ["1300 mm", "0 mm", "1200 mm"]       # of the frame that the program is in; also abc
    size = ["100 mm", "60 mm", "30 mm"]             # of the block, where one is milled
    load = [["1 s", 0, 0, 0], ["1.5 s", 300, 0, 0]] # time, force on the tool in B [N]; lines between
    weight = "25 kg"                # hangs from the tool tip all the time
    held_out = true
    minutes = 5                     # what its repeats cost on the machine, with setting up (scenarios/next_runs)
    parameters.compliance.warm_up_time = "30 min"

Each repeat is a run folder with the labels condition, repeat, held_out, kind, tier, and `parameters`: what the experimenter set. A
program is a table in the run's folder, so a run stands alone.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from models import gcode, point_path
from models.declaration import FloatArray
from models.trajectory import Placement, Plan, plan
from orchestration.assembly import run
from orchestration.parameters import quantity
from orchestration.results import RUN, Run, read_info
from orchestration.system import System
from orchestration.toml_text import dump, parse
from robomill.binding import convert, resolve, with_fmus
from robomill.milling import Progress, with_parameters
from robomill.scenario import ComponentParameters, ScenarioError

PATH, LOAD = "segments.npy", "profile.npy"
"""Tables in the folder of a run: the planned program, the applied load."""
GRAVITY = 9.81
"""m/s2, as in the models."""
_TOP = {"scenario", "experiment", "parameters", "machine", "condition"}
_CONDITION = {"name", "program", "position", "abc", "size", "load", "weight", "held_out", "minutes", "parameters"}


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


def is_experiment(file: Path) -> bool:
    """Whether a TOML file is a scenario of kind "experiment"."""
    try:
        return bool(parse(file.read_text(encoding="utf-8"))["scenario"]["kind"] == "experiment")
    except (OSError, KeyError, TypeError, tomllib.TOMLDecodeError, UnicodeDecodeError):
        return False


def load_experiment(path: str | Path) -> Experiment:
    """Read and check an experiment file. ScenarioError or FileNotFoundError says what is wrong and what is possible."""
    file = Path(path).resolve()
    table = parse(file.read_text(encoding="utf-8"))
    _only(file, "the file", table, _TOP, {"scenario", "experiment", "condition"})
    head = _only(file, "[scenario]", table["scenario"], {"name", "kind", "title", "system"}, {"name", "system"})
    about = _only(file, "[experiment]", table["experiment"], {"kind", "repeats"}, {"kind"})
    repeats = about.get("repeats", 1)
    if not isinstance(repeats, int) or repeats < 1:
        raise ScenarioError(f"{file}: [experiment] repeats = {repeats!r}; expected a whole number, at least 1")
    conditions = tuple(_condition(file, i, entry) for i, entry in enumerate(table["condition"], 1))
    names = [c.name for c in conditions]
    if len(set(names)) < len(names):
        raise ScenarioError(f"{file}: two conditions have the same name; names: {', '.join(names)}")
    return Experiment(
        file,
        str(head["name"]),
        str(head.get("title", head["name"])),
        str(about["kind"]),
        repeats,
        _file(file, head["system"]),
        table.get("parameters", {}),
        table.get("machine", {}),
        conditions,
    )


def _only(file: Path, where: str, table: Any, known: set[str], required: set[str]) -> Mapping[str, Any]:
    if not isinstance(table, dict):
        raise ScenarioError(f"{file}: {where} must be a table, found {table!r}")
    problems = [f"unknown: {', '.join(sorted(set(table) - known))}"] * bool(set(table) - known)
    problems += [f"missing: {', '.join(sorted(required - set(table)))}"] * bool(required - set(table))
    if problems:
        raise ScenarioError(f"{file}: {where}: {'; '.join(problems)}; known keys: {', '.join(sorted(known))}")
    return table


def _file(file: Path, name: Any) -> Path:
    found = (file.parent / str(name)).resolve()
    if not found.is_file():
        raise FileNotFoundError(f"{file}: {name!r}: no such file beside the experiment")
    return found


def _si(file: Path, where: str, value: Any, unit: str) -> float:
    try:
        return quantity(value, unit, convert) if isinstance(value, str) else float(value)
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"{file}: {where}: {error}; expected a quantity in {unit}") from None


def _vector(file: Path, where: str, values: Any, unit: str) -> tuple[float, ...]:
    if not isinstance(values, list) or len(values) != 3:
        raise ScenarioError(f"{file}: {where} = {values!r}; expected three quantities in {unit}")
    return tuple(_si(file, where, v, unit) for v in values)


def _condition(file: Path, number: int, entry: Any) -> ExperimentCondition:
    where = f"condition {number}"
    _only(file, where, entry, _CONDITION, {"name", "program", "position"})
    rows = entry.get("load", [])
    if not all(isinstance(r, list) and len(r) == 4 for r in rows):
        raise ScenarioError(f"{file}: {where}: load = {rows!r}; expected rows of time, fx, fy, fz")
    load = np.zeros((max(len(rows), 1), 7))
    for row, values in zip(load, rows, strict=False):
        row[0] = _si(file, f"{where} load", values[0], "s")
        row[1:4] = [_si(file, f"{where} load", v, "N") for v in values[1:]]
    weight = _si(file, f"{where} weight", entry.get("weight", 0.0), "kg")
    load[:, 3] -= weight * GRAVITY
    return ExperimentCondition(
        str(entry["name"]),
        _file(file, entry["program"]),
        _vector(file, f"{where} position", entry["position"], "m"),
        _vector(file, f"{where} abc", entry.get("abc", [0.0, 0.0, 0.0]), "rad"),
        _vector(file, f"{where} size", entry["size"], "m") if "size" in entry else None,
        load if rows or weight else load[:0],
        bool(entry.get("held_out", False)),
        entry.get("parameters", {}),
        _si(file, f"{where} minutes", entry.get("minutes", 0.0), "min"),
    )


def known_parameters(experiment: Experiment, c: ExperimentCondition, system: System) -> dict[str, dict[str, Any]]:
    """What the experimenter sets, without the tables of program and load."""
    known: dict[str, dict[str, Any]] = {"path": {}}
    names = {component.name for component in system.components}
    if "milling" in names and c.size is not None:
        quaternion = np.roll(Rotation.from_euler("ZYX", c.abc).as_quat(canonical=True), 1)
        known["milling"] = {"p_BP_B": list(c.position), "quat_BP": [float(v) for v in quaternion], "block_size": list(c.size)}
    for table in (experiment.parameters, c.parameters):
        for component, values in table.items():
            known.setdefault(component, {}).update(values)
    return known


def prepare(experiment: Experiment, c: ExperimentCondition, system: System, folder: Path) -> tuple[Plan, dict[str, dict[str, Any]]]:
    """Plan the condition for `system` and write its tables into `folder` (made).

    Returns the plan and all that the experimenter sets, files by their names in the folder. Raises what reader and planner raise.
    """
    folder.mkdir(parents=True, exist_ok=True)
    source = point_path.read_points(c.program) if c.program.suffix == ".toml" else gcode.read(c.program)
    x, y, z = c.position
    a, b, g = c.abc
    planned = plan(source, Placement((x, y, z), (a, b, g)))
    np.save(folder / PATH, planned.table)
    known = known_parameters(experiment, c, system)
    known["path"] = {**known["path"], "segments": PATH}
    if any(component.name == "load" for component in system.components):
        np.save(folder / LOAD, c.load)
        known["load"] = {**known.get("load", {}), "profile": LOAD}
    return planned, known


def in_folder(known: ComponentParameters, folder: Path) -> dict[str, dict[str, Any]]:
    """The same with the tables of path and load found from everywhere."""
    return {k: {n: str((folder / v).resolve()) if v in (PATH, LOAD) else v for n, v in values.items()} for k, values in known.items()}


def run_condition(
    experiment: Experiment, c: ExperimentCondition, repeat: int, folder: Path, fmus: Path | None = None, csv: bool = False, tier: str = "T1"
) -> Run:
    """One repeat into `folder` (overwritten). Raises what reader, planner and master raise."""
    system = System.load(experiment.system, convert)
    planned, known = prepare(experiment, c, system, folder)
    seed = {"sensor": {"seed": 1000 * (1 + experiment.conditions.index(c)) + repeat}}
    configured = with_parameters(with_parameters(with_parameters(system, seed), experiment.machine), in_folder(known, folder))
    configured = replace(configured, name=experiment.name, recording=replace(configured.recording, csv=csv))
    if fmus is not None:
        configured = with_fmus(configured, fmus)
    labels = {
        "program": planned.name,
        "robot": "KUKA KR 300 R2500 ultra",
        "condition": c.name,
        "repeat": repeat,
        "held_out": c.held_out,
        "kind": experiment.kind,
        "tier": tier,
    }
    run(configured, folder, resolver=resolve, convert=convert, labels=labels, overwrite=True)
    info = read_info(folder)
    info["parameters"] = known
    (folder / RUN).write_text(dump(info), encoding="utf-8")
    return Run.load(folder)


def run_experiment(
    experiment: Experiment,
    folder: Path,
    names: Sequence[str] | None = None,
    fmus: Path | None = None,
    csv: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """All repeats of all conditions (or of those in `names`) below `folder`; returns what summary.json holds."""
    chosen = [c for c in experiment.conditions if not names or c.name in names]
    unknown = sorted(set(names or ()) - {c.name for c in experiment.conditions})
    if unknown:
        raise ScenarioError(
            f"{experiment.file}: no condition {', '.join(unknown)}; conditions: {', '.join(c.name for c in experiment.conditions)}"
        )
    runs: list[dict[str, Any]] = []
    for i, c in enumerate(chosen):
        for repeat in range(1, experiment.repeats + 1):
            if progress is not None:
                progress(experiment.name, i * experiment.repeats + repeat - 1, len(chosen) * experiment.repeats)
            place = folder / f"{''.join(ch if ch.isalnum() else '_' for ch in c.name)}-{repeat}"
            result = run_condition(experiment, c, repeat, place, fmus, csv)
            size = np.linalg.norm(result["compliance.d_T_B"], axis=1)
            runs.append(
                {
                    "folder": place.name,
                    "condition": c.name,
                    "repeat": repeat,
                    "duration_s": float(result.t[-1]),
                    "max_displacement_m": float(size.max()),
                    "max_force_n": float(np.linalg.norm(result["sensor.f_T_T"], axis=1).max()),
                }
            )
    return {"scenario": experiment.name, "kind": experiment.kind, "runs": runs}
