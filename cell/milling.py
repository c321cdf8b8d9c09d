"""A milling scenario: plan the program, estimate the force offline, mill every variant, measure the result.

Results of a scenario are a folder: `plan/` (tables that the path component reads), `offline/` (the run that the
pilot force comes from), one run per variant, pictures, and `summary.json`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.combination import check_combination
from robomill.cell.equipment import load_system
from robomill.cell.plan_checks import Findings, check_plan
from robomill.cell.plausibility import unusual_values
from robomill.cell.points import read_points
from robomill.cell.robot_programs import is_robot_program, read_robot_program
from robomill.cell.scenario import ComponentParameters, Scenario, ScenarioError, Variant, Workpiece
from robomill.collector import put_off
from robomill.models.maths.rotation import Rotation
from robomill.models.model.declaration import FloatArray
from robomill.models.planning import gcode
from robomill.models.planning.point_path import Interpolation, PointPath
from robomill.models.planning.segment_table import TOOL
from robomill.models.planning.trajectory import Plan, pilot_table, plan
from robomill.models.process import tool_table
from robomill.models.process.cutting import EndMill
from robomill.orchestration.assembly import Assembly, assemble, computed, run
from robomill.orchestration.errors import SlaveError
from robomill.orchestration.runs.behind import Behind
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import Connection, System
from robomill.orchestration.system.wiring import Wiring

PARTS = ("path", "drive", "compliance", "milling", "sensor", "controller")
"""Names that the components of a milling cell go by in its system file, whatever their sources are."""

PILOT_WINDOW = 5
"""Steps over which the offline force is averaged, centred: the pilot force is quasi-static, without the ripple of the teeth."""

_SAME_PLACE = 1e-9
"""Most by which place and size of the block, where it is cut, differ from those of the path [m, 1]: what is rounded."""
_WARM = 3
"""Looks at the clock until all is compiled: after initialisation, the first step, and the first chunk of steps."""

Progress = Callable[[str, int, int], object]
"""Called with (what is being done, steps done, steps in all)."""


@dataclass(frozen=True)
class Job:
    """A milling scenario made ready: its plan and the system that every variant is a version of."""

    scenario: Scenario
    workpiece: Workpiece
    plan: Plan
    system: System
    folder: Path
    fmus: Path | None = None
    """Folder of the FMUs that run instead of the in-process components."""
    resume: bool = False
    """Whether runs that are in the folder already are kept or continued."""
    overwrite: bool = False
    """Whether they are replaced; with neither, a variant that is there already is refused."""
    notes: tuple[str, ...] = ()
    """What the reader of the program skipped or decided, and where the planner did not hold the feed."""
    warnings: tuple[str, ...] = ()
    """What the plan shows to be wrong (`cell/plan_checks.py`)."""

    @property
    def steps(self) -> int:
        """Communication steps of one run."""
        return int(np.ceil(self.plan.duration / self.system.step)) + 1


def prepare(
    scenario: Scenario,
    folder: str | Path,
    fmus: Path | None = None,
    progress: Progress | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    checkpoint_every: int | None = None,
) -> Job:
    """Plan the program and estimate the cutting force along it: `lay_out` and `with_pilot`; their arguments, what they raise."""
    job = lay_out(scenario, folder, fmus, resume=resume, overwrite=overwrite, checkpoint_every=checkpoint_every)
    return with_pilot(job, progress)


@put_off()
def lay_out(
    scenario: Scenario,
    folder: str | Path,
    fmus: Path | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    checkpoint_every: int | None = None,
) -> Job:
    """Plan the program, check the plan and configure the system: all that can be said before anything is run.

    `fmus`: folder of FMUs to run instead of the in-process components; `resume` keeps finished runs in the folder and goes on with
    interrupted ones, `overwrite` replaces them (the tables and the offline run are made anew in any case); `checkpoint_every` [steps]
    instead of what the system file says. Raises what the reader of the program, the planner and the master raise; nothing is left
    half done in `folder` that a second call would trip over.
    """
    assert scenario.program is not None
    assert scenario.workpiece is not None  # load_scenario checks both for this kind
    workpiece = scenario.workpiece
    placement = workpiece.placement
    program = read_program(scenario.program, scenario.reading, scenario.orientation)
    system = load_system(scenario.system, scenario.equipment)
    _require(system)
    findings = check(scenario, program, system)
    if not findings.cuts:
        raise ScenarioError(f"{scenario.file}: {scenario.program.name}: {findings.texts[0]}")
    planned = plan(program, placement)
    folder = Path(folder)
    (folder / "plan").mkdir(parents=True, exist_ok=True)
    segments = (folder / "plan" / "segments.npy").resolve()  # also found from elsewhere
    np.save(segments, planned.table)

    if not _is_recording(system, "path"):
        system = system.with_parameters("path", {"segments": str(segments)})
    quaternion = np.roll(Rotation.from_matrix(placement.R_BP).as_quat(canonical=True), 1)
    if not _is_recording(system, "milling"):
        system = system.with_parameters(
            "milling", {"p_BP_B": list(workpiece.position), "quat_BP": quaternion.tolist(), "block_size": list(workpiece.size)}
        )
        if workpiece.stock is not None:
            system = system.with_parameters(
                "milling", {"stock": _table(folder, "stock", workpiece.stock.reshape(len(workpiece.stock), -1))}
            )
        if scenario.tools:
            if not _names_tool(system):
                raise ScenarioError(
                    f"{scenario.file}: has [tools], but {system.file} does not connect path.tool to milling.tool"
                    "; add that connection, or leave out [tools]"
                )
            system = system.with_parameters("milling", {"tools": _table(folder, "tools", tool_table.rows(scenario.tools))})
            if scenario.tool_corners:
                corners = np.array(sorted(scenario.tool_corners.items()), dtype=np.float64)
                system = system.with_parameters("milling", {"corners": _table(folder, "corners", corners)})
    system = with_parameters(system, scenario.parameters)
    if fmus is not None:
        system = with_fmus(system, fmus)
    if checkpoint_every is not None:
        system = replace(system, recording=replace(system.recording, checkpoint_every=checkpoint_every))
    notes = (*notes_of(program), *planned.notes)
    return Job(scenario, workpiece, planned, system, folder, fmus, resume, overwrite, notes, findings.texts)


def _table(folder: Path, name: str, rows: FloatArray) -> str:
    """Write a table into the plan of a scenario; its file, also found from elsewhere."""
    file = (folder / "plan" / f"{name}.npy").resolve()
    np.save(file, rows)
    return str(file)


def with_pilot(job: Job, progress: Progress | None = None) -> Job:
    """Estimate the cutting force by a run of path and milling alone, and give its table to the path. Raises what the master raises."""
    pilot = (job.folder / "plan" / "pilot.npy").resolve()
    np.save(pilot, pilot_table(*offline_force(job, progress)))
    return job if _is_recording(job.system, "path") else replace(job, system=job.system.with_parameters("path", {"pilot": str(pilot)}))


def read_program(file: Path, reading: gcode.Setup, orientation: Interpolation | None = None) -> gcode.Program | PointPath:
    """The program of a file: a path of points (TOML), KRL (.src) and RAPID (.mod) as robomill writes it, else G-code.

    `orientation` takes the place of what a path of points says. Raises what the readers raise, and ValueError where an
    `orientation` is given and the program has none.
    """
    if is_robot_program(file):
        from robomill.models.planning.languages.convert import path_of  # with SciPy, which takes a third of a second

        path = path_of(read_robot_program(file))
        note = f"{file.name}: the frames of the file are not used; workpiece and tool stand as said here"
        read: gcode.Program | PointPath = replace(path, name=file.name, notes=(note,))
    else:
        read = read_points(file) if file.suffix == ".toml" else gcode.read(file, reading)
    if orientation is None:
        return read
    if isinstance(read, gcode.Program):
        raise ValueError(
            f"{read.name}: orientation = {orientation!r} is given, and G-code has no orientation; leave it out, or give a path of points "
            "(TOML)"
        )
    return replace(read, interpolation=orientation)


def notes_of(program: gcode.Program | PointPath) -> tuple[str, ...]:
    """What the reader skipped or decided."""
    return program.notes


def check(scenario: Scenario, program: gcode.Program | PointPath, system: System) -> Findings:
    """What the plan shows, for every variant with its own tool; ScenarioError where a tool is not described.

    `system`: that of the scenario, without its parameters. `cuts` is False if a variant cuts nothing; its text is then the first.
    """
    assert scenario.workpiece is not None
    if isinstance(program, gcode.Program):
        named = [t for t in program.tools if t]
        missing = [t for t in named if t not in scenario.tools]
        if missing and (scenario.tools or len(named) > 1):
            there = ", ".join(f"T{t}" for t in scenario.tools) or "none"
            raise ScenarioError(
                f"{scenario.file}: {program.name} mills with {', '.join(f'T{t}' for t in named)}; described are: {there}; "
                f"add [tools.{missing[0]}] with diameter, teeth, helix and cutting_length"
            )
    found: dict[EndMill | None, Findings] = {}
    texts: dict[str, list[str]] = {}
    common = with_parameters(system, scenario.parameters)
    shared = own_tool(common)
    for variant in scenario.variants:
        own = own_tool(with_parameters(common, variant.parameters)) if "milling" in variant.parameters else shared
        if own is None and not scenario.tools:  # another's component, which does not say what its tool is
            continue
        if own not in found:
            found[own] = check_plan(program, scenario.workpiece.size, {**({0: own} if own else {}), **scenario.tools})
        of_variant = found[own]
        for text in of_variant.texts:
            texts.setdefault(text, []).append(variant.name)
        if not of_variant.cuts:
            return Findings((_whose(of_variant.texts[0], [variant.name], len(found)),), cuts=False)
    return Findings(tuple(_whose(text, names, len(found)) for text, names in texts.items()))


def _whose(text: str, variants: Sequence[str], tools: int) -> str:
    """A finding, with the variants that it concerns where they have several tools."""
    return text if tools == 1 else f"{text} ({'variant' if len(variants) == 1 else 'variants'} {', '.join(variants)})"


def mill(job: Job, variant: Variant, progress: Progress | None = None, csv: bool = False) -> tuple[Run, float]:
    """Run one variant into its folder; returns the run and how many times faster than real time it was (recording included, compiling not).

    The factor is NaN for a run that was finished before. It lasts as long as the plan; longer, where the system has a later stop of its own
    (a feed that is controlled takes more time than planned).
    """
    complete, factor = _milled(job, variant, progress, csv)
    return complete(), factor


def mill_all(
    job: Job, variants: Sequence[Variant], progress: Progress | None = None, csv: bool = False
) -> Iterator[tuple[Variant, Behind, float]]:
    """Mill one variant after the other; each with its run and its factor (see `mill`). A run is completed on disk behind the next.

    A variant is handed out when the next is computed, also if that fails.
    """
    before = None
    for variant in variants:
        try:
            complete, factor = _milled(job, variant, progress, csv)
        except BaseException:
            if before is not None:
                yield before
            raise
        now = variant, Behind(complete), factor
        if before is not None:
            yield before
        before = now
    if before is not None:
        yield before


def _milled(job: Job, variant: Variant, progress: Progress | None, csv: bool) -> tuple[Callable[[], Run], float]:
    """See `mill`; the run is still to be completed."""
    system = replace(of_variant(job, variant), name=f"{job.scenario.name}/{variant.name}")
    system = replace(system, recording=replace(system.recording, csv=csv))
    block = " x ".join(f"{1e3 * length:g}" for length in job.workpiece.size)
    labels = {
        "program": job.plan.name,
        "tool": _label(job, system),
        "workpiece": f"block {block} mm",
        "condition": variant.name,
    }
    watch = _Stopwatch()
    complete = computed(
        system,
        job.folder / variant.name,
        stop=max(job.steps * system.step, system.stop or 0.0),
        resolver=resolve,
        convert=convert,
        progress=_reporting(progress, variant.title, job.steps),
        labels=labels,
        overwrite=job.overwrite,
        observers=[watch],
        resume=job.resume,
    )
    return complete, watch.factor


_OF_JOB = {"path": ("segments", "pilot"), "milling": ("p_BP_B", "quat_BP", "block_size", "tools")}
"""Parameters that `lay_out` and `with_pilot` give a component, whatever its source."""


def of_variant(job: Job, variant: Variant) -> System:
    """The system of a job with the sources and the parameters of a variant; an exchanged component gets its equipment anew.

    Raises what `load_system` raises; SystemFileError for a component that the system does not have, and for components that cannot
    work together (`check_combination`).
    """
    system = _exchanged(job, variant)
    check_combination(system)
    return system


def _exchanged(job: Job, variant: Variant) -> System:
    if not variant.sources:
        return with_parameters(job.system, variant.parameters)
    other = load_system(job.scenario.system, job.scenario.equipment, variant.sources)
    for name in variant.sources:
        before = job.system.component(name).parameters
        planned = {p: before[p] for p in _OF_JOB.get(name, ()) if p in before}
        if planned and not _is_recording(other, name):
            other = other.with_parameters(name, planned)
    other = with_parameters(other, {c: v for c, v in job.scenario.parameters.items() if c in variant.sources})
    if job.fmus is not None:
        other = with_fmus(other, job.fmus)
    components = tuple(other.component(c.name) if c.name in variant.sources else c for c in job.system.components)
    return with_parameters(replace(job.system, components=components), variant.parameters)


def own_tool(system: System) -> EndMill | None:
    """The cutter as the milling component has it; None where that does not say."""
    alone = replace(system, components=(system.component("milling"),), connections=(), require_connected=False)
    with assemble(alone, resolve, convert) as assembly:
        starts = {p.name: p.start for p in assembly.slaves["milling"].ports if p.causality == "parameter"}
        given = {**starts, **assembly.parameters.get("milling", {})}
    diameter, teeth, helix = given.get("diameter"), given.get("teeth"), given.get("helix")
    if not isinstance(diameter, float) or not isinstance(teeth, int | float) or not isinstance(helix, float):
        return None
    length = given.get("cutting_length")
    return EndMill(diameter, teeth, helix, length if isinstance(length, float) else math.inf)


def _label(job: Job, system: System) -> str:
    """The cutters that a run uses; empty where nothing says what they are."""
    if job.scenario.tools:
        used = sorted({int(number) for number in job.plan.table[:, TOOL]} & set(job.scenario.tools))
        return ", ".join(f"T{number} {_titled(job.scenario, number)}" for number in used)
    own = own_tool(system)
    return _end_mill(own) if own else ""


def _titled(scenario: Scenario, number: int) -> str:
    title, mill = scenario.tool_titles.get(number), _end_mill(scenario.tools[number])
    return mill if title is None else f"{title} ({mill})"


def _end_mill(mill: EndMill) -> str:
    return f"end mill D{1e3 * mill.diameter:g} z{mill.teeth:g}"


@put_off()
def check_variants(job: Job, variants: Sequence[Variant]) -> list[str]:
    """Assemble every variant once, so that what cannot run is refused before a recording is replaced; returns what is unusual."""
    found: list[str] = []
    for variant in variants:
        with assemble(of_variant(job, variant), resolve, convert) as assembly:
            _check_place(job, assembly)
            found += unusual_values(assembly)
    return [text for text in dict.fromkeys(found) if text not in job.warnings]


def _check_place(job: Job, assembly: Assembly) -> None:
    """ScenarioError where the block does not lie where the path was planned."""
    quaternion = np.roll(Rotation.from_matrix(job.workpiece.placement.R_BP).as_quat(canonical=True), 1)
    given = assembly.parameters["milling"]
    for name, key, planned in (
        ("p_BP_B", "position", job.workpiece.position),
        ("quat_BP", "abc", quaternion),
        ("block_size", "size", job.workpiece.size),
    ):
        cut = [given.get(f"{name}[{i + 1}]") for i in range(len(planned))]
        if None not in cut and not np.all(np.abs(np.array(cut, dtype=np.float64) - planned) <= _SAME_PLACE):
            raise ScenarioError(
                f"{job.scenario.file}: milling.{name} is {cut} where the block is cut, but the path is planned for {list(planned)}; "
                f"give it as [workpiece] {key}, which both have"
            )


class _Stopwatch:
    """Observer that compares the clock on the wall with that of the run, once all is compiled.

    The components are after the first step, which Python makes, the loop after the first chunk of steps that it hands over.
    """

    def __init__(self) -> None:
        self._looks = 0
        self._first = (math.nan, math.nan)
        self._last = math.nan
        self.factor = math.nan

    def begin(self, wiring: Wiring, step: float) -> None:
        """Nothing to do."""

    def observe(self, t: float, outputs: FloatArray) -> None:
        """Look at the clock: after initialisation, and after each step or chunk of steps."""
        self._looks += 1
        if self._looks == _WARM:
            self._first = (t, time.perf_counter())
        self._last = t

    def observe_columns(self, columns: FloatArray, count: int) -> None:
        """Observe `count` steps after a chunk: the columns of the results in it."""
        if count > 0:
            self.observe(float(columns[0, count - 1]), columns[1:, count - 1])

    def end(self, outcome: str, message: str) -> None:
        """Work out the factor."""
        t, clock = self._first
        if self._last > t:
            self.factor = (self._last - t) / (time.perf_counter() - clock)


def offline_force(job: Job, progress: Progress | None = None) -> tuple[FloatArray, FloatArray]:
    """Path times [s] (n,) and the cutting force [N] (n, 3) in B of a rigid robot along the path, without ripple (sec. 2.3 of paper 000).

    Raises what the master raises.
    """
    ports = ("p_BT_B", "quat_BT", "v_BT_B", "spindle_speed", *(["tool"] * _names_tool(job.system)))
    rigid = tuple(Connection(f"path.{port}", f"milling.{port}") for port in ports)
    components = tuple(c for c in job.system.components if c.name in ("path", "milling"))
    offline = replace(job.system, name=f"{job.scenario.name}/offline", components=components, connections=rigid)
    result = run(
        offline,
        job.folder / "offline",
        stop=job.steps * offline.step,
        resolver=resolve,
        convert=convert,
        progress=_reporting(progress, "offline force", job.steps),
        overwrite=True,
        resume=job.resume,
    )
    # the force is a mean over the step that ends at t: it belongs to the middle of that step
    from scipy.ndimage import uniform_filter1d  # takes a third of a second to load

    tau = result["path.path_time"][1:] - 0.5 * offline.step
    smooth = uniform_filter1d(result["milling.f_T_B"][1:], PILOT_WINDOW, axis=0, mode="nearest")
    return tau, smooth


def _require(system: System) -> None:
    """Refuse a system whose components do not play the parts of a milling cell."""
    names = [c.name for c in system.components]
    missing = [part for part in PARTS if part not in names]
    if missing:
        raise ScenarioError(
            f"{system.file}: a milling scenario needs components named {', '.join(PARTS)}; missing: {', '.join(missing)}; "
            "add them, or rename those that play these parts"
        )


def _names_tool(system: System) -> bool:
    """Whether the milling component is told which tool is in the spindle; a foreign one may have no such port."""
    return any(c.source == "path.tool" and c.target == "milling.tool" for c in system.connections)


def _is_recording(system: System, name: str) -> bool:
    """Whether a component is a replay FMU (`robomill build --replay`), which has neither program nor workpiece as parameters."""
    source = system.component(name).source
    if not source.endswith(".fmu"):
        return False
    from tempfile import TemporaryDirectory

    from robomill.orchestration.slaves.description import open_fmu  # with FMPy

    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        try:
            ports = open_fmu(system.folder / source, Path(folder)).ports
        except SlaveError:  # the run says so, and where the FMU is named
            return False
    return any(p.name == "recording" and p.causality == "parameter" for p in ports)


def with_parameters(system: System, parameters: ComponentParameters) -> System:
    """The system with parameters set: component -> parameter -> value as written."""
    for component, values in parameters.items():
        system = system.with_parameters(component, values)
    return system


def _reporting(progress: Progress | None, what: str, steps: int) -> Callable[[int, int], object] | None:
    if progress is None:
        return None
    report = progress
    return lambda done, _: report(what, done, steps) if done % 25 == 0 else None
