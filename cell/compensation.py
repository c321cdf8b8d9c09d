"""Offline compensation: mill a program on the nominal twin, mirror how far the tool tip leaves the path, mill again, write the program.

Englert 2011 (the thesis), section 2.1, steps 4 to 6. With x = u + g(x) for the tool tip x of a path u that a machine bends by g, the path
is corrected by what is left: u <- u - factor (x - p), p the planned path, all at equal ways along p. Where the force pushes
the tool away, rho = -dg/dx > 0 and an iteration leaves rho/(1 + rho) of what there was; where it pulls the tool in, rho < 0, the factor
is DAMPING from DAMPED on, and from DIVERGES on (1 + rho) / |rho| < 1 and nothing converges (FACTS10 10.5).
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d, label

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import robot_of, tool_of
from robomill.cell.evaluation import Result, cutting, evaluate
from robomill.cell.milling import Job, Progress, lay_out, mill, notes_of, of_variant, offline_force, read_program
from robomill.cell.scenario import Scenario, ScenarioError, Variant
from robomill.models.model.declaration import FloatArray
from robomill.models.planning.languages.convert import path_of
from robomill.models.planning.languages.poses import Frames
from robomill.models.planning.path_correction import (
    CorrectedProgram,
    PlannedPath,
    at_nodes,
    corrected,
    planned_path,
    way_along,
)
from robomill.models.planning.reachability import check_reachable
from robomill.models.planning.segment_table import LINE
from robomill.models.planning.trajectory import Placement, Plan, PlanError, pilot_table, plan
from robomill.orchestration.assembly import assemble
from robomill.orchestration.runs.run import Run, check_vacant
from robomill.orchestration.slaves.protocol import arrays
from robomill.orchestration.system.definition import System

DAMPED, DAMPING = -0.3, 0.7
"""rho of a line of the program below which the correction is damped, and by which factor (FACTS10 10.5)."""
DIVERGES = -0.5
"""rho below which a plain iteration grows (FACTS10 10.5)."""
SMOOTHING = 3.0
"""Standard deviation, in nodes (12 ms), of the Gaussian that smooths the deviation before it is mirrored: without the beat of teeth and
cycle, and a step of 1 mm then asks for 1.7 m/s2 across the path, which the planner does not have to slow down for."""
_SPEAKS = 0.25
"""Deviation of a line, rms, over that of the whole program, from which on its contraction says something."""
_LEAST_NODES = 10
"""Nodes in the cut that a line needs for that."""
SETTLED = 0.9
"""Ratio of a residual to the least before it above which more iterations are of no use."""
_HAS_SIDE = 0.01
"""Level part of a way from which on it has a side: straight down it has none."""
_CUTS = 0.5
"""Share of the samples at a node that cut from which on it counts as cut."""
_COEFFICIENTS = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")


PLUNGE, LEVEL = 0.5, 0.03
"""Descent over way: a stretch that descends by more than LEVEL all along and by more than PLUNGE somewhere is a plunge. Its thrust ends
with it, faster than any path can follow: mirrored, it would drive the tool into the floor. So a plunge gets no correction of its own,
but goes evenly to that of the cut after it, and counts in no figure of the path: the cut after it goes over what it left."""
Ending = Literal["converged", "settled", "iterations"]
"""How an iteration ends: below the residual that was asked for, no longer falling by a tenth, or after all its corrections."""


@dataclass(frozen=True)
class Perturbation:
    """Another machine than the nominal twin: what a user has."""

    stiffness: float
    """Relative error of all springs of the robot."""
    force: float
    """Relative error of the cutting coefficients."""
    informed: bool = False
    """Whether the online controller has the springs of that machine, as one that was identified on it."""


PERTURBED = tuple(Perturbation(-0.15, force) for force in (0.2, 0.0, -0.2))
"""Machines that a compensated program is tried on (FACTS10 10.5)."""


class CompensationError(ValueError):
    """A program that cannot be compensated: what is wrong, where, what to do. What was computed stays in the folder."""


@dataclass(frozen=True)
class Settings:
    """How a program is compensated."""

    tolerance: float = 1e-5
    """m, of the corrected path against its nodes."""
    converged: float = 0.005
    """Residual (rms, smoothed) over the uncompensated deviation at which the iteration ends."""
    iterations: int = 8
    """Corrections at most."""
    limit: float = 5e-3
    """Largest correction, m."""

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        for name, least in (("tolerance", 0.0), ("converged", 0.0), ("limit", 0.0), ("iterations", 0)):
            if not getattr(self, name) > least:
                raise CompensationError(f"{name} is {getattr(self, name):g}; expected more than {least:g}")


@dataclass(frozen=True)
class Iteration:
    """What an iteration came to."""

    number: int
    """0: the program as it is."""
    rms_m: float
    """Deviation of the tool tip from the planned path in the cut, rms."""
    max_m: float
    left_m: float
    """Its smoothed part, rms: what the next correction is made of."""
    contraction: float | None
    """Part of the last deviation that this one still has: <e, e_before>/<e_before, e_before>; FACTS10: rho/(1 + rho)."""
    rho: float | None
    """What follows from it with the factor of the correction."""
    factor: float
    """What the correction that led here was multiplied by; 0 for none."""
    points: int
    duration_s: float
    largest_correction_m: float


@dataclass(frozen=True)
class PathFigures:
    """How far the tool tip is off the planned path in the cut."""

    rms_m: float
    p95_m: float
    max_m: float
    across_rms_m: float
    """The part level and normal to the path."""
    along_rms_m: float
    axial_rms_m: float
    """Along z of the workpiece."""


@dataclass(frozen=True)
class Pass:
    """A program milled on a machine: its run and the deviation at the nodes of the planned path."""

    plan: Plan
    run: Run
    deviation: FloatArray
    """(n, 3) tool tip minus planned path, m in P."""
    cut: npt.NDArray[np.bool_]
    """(n,) whether material was cut there, without plunges."""
    figures: PathFigures
    """Where the uncompensated program cuts."""


@dataclass(frozen=True)
class Trial:
    """What a compensated program leaves on another machine than the one that it was made for."""

    machine: Perturbation
    before: Pass
    """The program as it is."""
    after: Pass
    """The compensated one."""
    left: float
    """Part of the deviation that is left, with its sign: <after, before>/<before, before>; negative: corrected too far."""
    uncompensated_surface_rms_m: float | None
    compensated_surface_rms_m: float | None

    @property
    def figures(self) -> dict[str, float | None]:
        """What compensation.json has of it; lengths in m, of the path in the cut and of the surface."""
        return {
            "stiffness_error": self.machine.stiffness,
            "force_error": self.machine.force,
            "uncompensated_rms_m": self.before.figures.rms_m,
            "compensated_rms_m": self.after.figures.rms_m,
            "left": self.left,
            "uncompensated_surface_rms_m": self.uncompensated_surface_rms_m,
            "compensated_surface_rms_m": self.compensated_surface_rms_m,
        }


@dataclass(frozen=True)
class Compensation:
    """A compensated program, and how it came about."""

    scenario: Scenario
    variant: Variant
    settings: Settings
    path: PlannedPath
    offset: FloatArray
    """(n, 3) what is added to the planned path at its nodes, m in P."""
    program: CorrectedProgram
    before: Pass
    after: Pass
    iterations: tuple[Iteration, ...]
    ending: Ending
    results: tuple[Result, Result]
    """Surfaces of the uncompensated and the compensated part."""
    trials: tuple[Trial, ...]
    notes: tuple[str, ...]
    """What the reader of the program skipped or decided."""
    labels: Mapping[str, str]
    """What robot, tool and so on are called."""

    @property
    def remarks(self) -> list[str]:
        """Notes of the program as it is, and what the planner decided of the compensated one, whose poses are its lines."""
        return [*self.notes, *(f"compensated program, poses as lines: {note}" for note in self.after.plan.notes)]

    @property
    def placement(self) -> Placement:
        """Where the workpiece stands."""
        return self.before.plan.placement

    @property
    def lines(self) -> list[dict[str, float | int | str]]:
        """Deviation before and after, line by line of the program, where it cuts."""
        rows: list[dict[str, float | int | str]] = []
        of = self.path.lines
        for number in np.unique(of).tolist():
            here = (of == number) & self.before.cut
            if np.any(here):
                rows.append(
                    {
                        "line": number,
                        "uncompensated_rms_m": _rms(self.before.deviation[here]),
                        "compensated_rms_m": _rms(self.after.deviation[here]),
                        "largest_correction_m": float(np.linalg.norm(self.offset[here], axis=1).max()),
                    }
                )
        return rows


Along = Callable[[FloatArray], FloatArray]
"""Ways [m] (k,) along the planned path to path times [s] (k,) of a program."""


class Machine:
    """Mills versions of one program on a cell, each into a folder of its own."""

    def __init__(self, job: Job, variant: Variant, path: PlannedPath, progress: Progress | None = None) -> None:
        """`job`: the program as it is, laid out; `variant`: of its scenario; `path`: the nodes of its plan."""
        self.job, self.path, self.system = job, path, of_variant(job, variant)
        self._title, self._progress = variant.title, progress
        self._robot, self._tool = robot_of(self.system), tool_of(self.system)
        self._needs_pilot = any(c.source == "path.f_pilot_B" for c in self.system.connections)
        self.frames = Frames.at(job.plan.placement, self._tool, self._robot.q_home)
        self._force: FloatArray | None = None
        self._cut: npt.NDArray[np.bool_] | None = None

    def plan(self, program: CorrectedProgram) -> Plan:
        """The plan of a corrected program; its lines are its poses, from 1."""
        return plan(path_of(replace(program.poses, lines=np.arange(1, len(program.poses.p) + 1))), self.job.plan.placement)

    def mill(self, name: str, planned: Plan, along: Along, system: System | None = None) -> Pass:
        """Mill a plan into the folder `name`; `along` gives the ways along the planned path. `system`: of another machine."""
        system = system or self.system
        system = system.with_parameters("path", {"segments": self._saved(name, planned.table)})
        if self._needs_pilot:
            system = system.with_parameters("path", {"pilot": self._saved(f"{name}_pilot", self._pilot(planned, along))})
        job = replace(self.job, plan=planned, system=system)
        run, _ = mill(job, Variant(name, f"{self._title}: {name.replace('_', ' ')}", {}), self._progress)
        position = to_workpiece(planned, run["compliance.p_BT_B"])
        reached = at_nodes(self.path, along(run["path.path_time"]), np.column_stack([position, cutting(run)]))
        deviation, cut = reached[:, :3] - self.path.position, (reached[:, 3] > _CUTS) & ~plunges(self.path)
        if self._cut is None:
            self._cut = cut
        return Pass(planned, run, deviation, cut, path_figures(self.path, deviation, self._cut))

    def check(self, planned: Plan) -> None:
        """PlanError where a pose is out of reach, an axis out of its limits or too fast."""
        check_reachable(planned, self._robot, self._tool, self._robot.q_home)

    def _saved(self, name: str, table: FloatArray) -> str:
        file = (self.job.folder / "plan" / f"{name}.npy").resolve()
        np.save(file, table)
        return str(file)

    def _pilot(self, planned: Plan, along: Along) -> FloatArray:
        """The pilot force of the program as it is, at the times at which this one gets to the same places."""
        if self._force is None:
            tau, force = offline_force(replace(self.job, system=self.system), self._progress)
            self._force = np.column_stack([np.interp(self.path.time, tau, f) for f in force.T])
        times = np.arange(0.0, planned.duration, self.system.step)
        way = along(times)
        return pilot_table(times, np.column_stack([np.interp(way, self.path.along, f) for f in self._force.T]))


def plunges(path: PlannedPath) -> npt.NDArray[np.bool_]:
    """Which nodes (n,) belong to a plunge."""
    descent = -np.gradient(path.position[:, 2], path.along)
    stretch, count = label(descent > LEVEL)
    steep = np.zeros(count + 1, dtype=np.bool_)
    steep[np.unique(stretch[descent > PLUNGE])] = True
    steep[0] = False
    result: npt.NDArray[np.bool_] = steep[stretch]
    return result


def path_figures(path: PlannedPath, deviation: FloatArray, cut: npt.NDArray[np.bool_]) -> PathFigures:
    """Figures of a deviation (n, 3) [m] at the nodes that cut; zeros if none does."""
    if not np.any(cut):
        return PathFigures(*[0.0] * 6)
    way = np.gradient(path.position, axis=0)
    level = way * [1.0, 1.0, 0.0]
    length = np.linalg.norm(level, axis=1)
    ahead = level / np.where(length > _HAS_SIDE * np.linalg.norm(way, axis=1), length, np.inf)[:, None]
    left = np.column_stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(path))])
    size = np.linalg.norm(deviation[cut], axis=1)
    parts = (deviation * left, deviation * ahead, deviation * [0.0, 0.0, 1.0])
    across, along, axial = (_rms(np.sum(p, axis=1, keepdims=True)[cut]) for p in parts)
    return PathFigures(_rms(deviation[cut]), float(np.percentile(size, 95.0)), float(size.max()), across, along, axial)


def to_workpiece(planned: Plan, position: FloatArray) -> FloatArray:
    """Positions (k, 3) [m] of B in P."""
    result: FloatArray = (position - np.asarray(planned.placement.p_BP_B)) @ planned.placement.R_BP
    return result


def compensate(
    scenario: Scenario,
    variant: str | None,
    folder: Path,
    settings: Settings | None = None,
    progress: Progress | None = None,
    *,
    perturbed: Sequence[Perturbation] = PERTURBED,
    overwrite: bool = False,
) -> Compensation:
    """Compensate the program of a milling scenario on its cell, in one of its variants (default: the first).

    `folder` gets the runs (`iteration_0` ...), `iterations.json` and `correction.csv`. `perturbed`: machines that the
    result is tried on. CompensationError where it diverges or the correction is too large or out of reach; else what `lay_out` raises.
    What was computed until then stays.
    """
    settings = settings or Settings()
    chosen = _variant(scenario, variant)
    assert scenario.workpiece is not None  # load_scenario checks both for this kind
    assert scenario.program is not None
    folder = Path(folder)
    if not overwrite:
        check_vacant(folder / f"iteration_{k}" for k in range(settings.iterations + 1))
    program = read_program(scenario.program, scenario.reading, scenario.orientation)
    job = lay_out(replace(scenario, variants=(chosen,)), folder, overwrite=overwrite)
    path = planned_path(job.plan, program)
    machine = Machine(job, chosen, path, progress)
    machine.check(job.plan)
    loop = Loop(machine, settings, program.source, folder)
    ending = loop.run()
    trials = [_try(loop, p) for p in perturbed]
    results = tuple(
        evaluate(name, title, p.run, scenario.workpiece, math.nan, planned=loop.first.run)
        for name, title, p in (("uncompensated", "uncompensated", loop.first), ("compensated", "compensated offline", loop.last))
    )
    return Compensation(
        scenario,
        chosen,
        settings,
        path,
        loop.offset,
        loop.program,
        loop.first,
        loop.last,
        tuple(loop.iterations),
        ending,
        (results[0], results[1]),
        tuple(trials),
        notes_of(program),
        machine.system.labels,
    )


def _variant(scenario: Scenario, name: str | None) -> Variant:
    if scenario.kind != "milling":
        raise CompensationError(
            f"{scenario.file}: a scenario of kind {scenario.kind!r}; only milling scenarios have a program to compensate"
            "; choose one with kind = 'milling'"
        )
    for variant in scenario.variants:
        if name in (None, variant.name):
            return variant
    raise ScenarioError(f"{scenario.file}: no variant {name}; variants: {', '.join(v.name for v in scenario.variants)}")


class Loop:
    """The iteration: what it has so far."""

    def __init__(self, machine: Machine, settings: Settings, source: Sequence[str], folder: Path) -> None:
        self.machine, self.settings, self.folder, self._source = machine, settings, folder, source
        self.path = machine.path
        self.offset = np.zeros_like(self.path.position)
        self.iterations: list[Iteration] = []
        self.first = machine.mill("iteration_0", machine.job.plan, self.as_planned)
        self.last = self.first
        self.plan = machine.job.plan
        self.program = corrected(self.path, self.offset, settings.tolerance, machine.frames)
        self.along: Along = self.as_planned

    def as_planned(self, tau: FloatArray) -> FloatArray:
        """Ways along the planned path of its own times."""
        return np.interp(tau, self.path.time, self.path.along)

    def run(self) -> Ending:
        """Correct until the residual is small, no longer falls, or the iterations are used up; the best one is kept."""
        factor = 1.0
        left = self._mirrored(self.first)
        start = _rms(left[self.first.cut]) if np.any(self.first.cut) else 0.0
        if start == 0.0:
            raise CompensationError(
                f"{self.path.name}: the tool never meets the block; nothing to compensate"
                "; correct the place of the block or the zero of the program"
            )
        self._note(self.first, None, 0.0, left)
        least, best = start, (self.offset, self.program, self.plan, self.along, self.last)
        for number in range(1, self.settings.iterations + 1):
            before = left
            self.offset = self.offset - factor * before
            self._correct(number)
            left = self._mirrored(self.last)
            self._note(self.last, before, factor, left)
            now, was = self.iterations[-1].left_m, least
            if number == 1:
                factor = self._stable(before, left, factor)
                if now >= start:
                    worst = int(np.argmax(np.where(self.first.cut, np.linalg.norm(left, axis=1), 0.0)))
                    raise CompensationError(
                        f"the correction makes it worse: corrected once, {1e3 * now:.3f} mm rms are left of {1e3 * start:.3f} mm, most at "
                        f"{self._where(worst)}: the machine swings, or is pulled in; compensate on a twin without inertia "
                        f"(robot_compliance), or cut less deep{self._kept}"
                    )
            if now < least:
                least, best = now, (self.offset, self.program, self.plan, self.along, self.last)
            if now <= self.settings.converged * start:
                return "converged"
            if now > SETTLED * was:
                self.offset, self.program, self.plan, self.along, self.last = best
                return "settled"
        return "iterations"

    def _mirrored(self, done: Pass) -> FloatArray:
        """The part (n, 3) of a deviation that a correction mirrors: not that of plunges, and smooth."""
        path, keep = self.path, ~plunges(self.path)
        bridged = np.column_stack([np.interp(path.along, path.along[keep], d[keep]) for d in done.deviation.T])
        return _smooth(bridged)

    def _correct(self, number: int) -> None:
        """Write the program with the present offsets, check it, mill it."""
        size = np.linalg.norm(self.offset, axis=1)
        if size.max() > self.settings.limit:
            worst = int(np.argmax(np.where(self.first.cut, size, 0.0)))
            raise CompensationError(
                f"iteration {number}: the correction at {self._where(worst)} is {1e3 * size[worst]:.2f} mm, more than the limit of "
                f"{1e3 * self.settings.limit:g} mm; cut less deep, or raise the limit{self._kept}"
            )
        self.program = corrected(self.path, self.offset, self.settings.tolerance, self.machine.frames)
        self.plan = self.machine.plan(self.program)
        planned, program = self.plan, self.program

        def along(tau: FloatArray) -> FloatArray:
            pose = planned.rows(tau)[0][:, LINE].astype(np.int64) - 1
            return way_along(program, pose, to_workpiece(planned, planned.position(tau)))

        self.along = along
        try:
            self.machine.check(self.plan)
        except PlanError as error:
            raise CompensationError(
                f"iteration {number}: the corrected path leaves the limits of the robot: {error}; that line belongs to "
                f"{self._of_point(error)}; move the workpiece (robomill place), or cut less deep there{self._kept}"
            ) from None
        self.last = self.machine.mill(f"iteration_{number}", self.plan, along)

    def _of_point(self, error: PlanError) -> str:
        """The line of the user's program behind a planning error, which names a pose as a line, from 1."""
        words = str(error).partition(" line ")[2].split()
        pose = int(words[0]) - 1 if words and words[0].isdecimal() else 0
        return self._where(int(np.searchsorted(self.path.along, self.program.along[pose], side="right")) - 1)

    def _where(self, node: int) -> str:
        line = self.path.said[node].line
        return f"{self.path.name} line {line} ({self._source[line - 1].strip()})"

    @property
    def _kept(self) -> str:
        return f"; what was computed is in {self.folder}"

    def _note(self, done: Pass, before: FloatArray | None, factor: float, left: FloatArray) -> None:
        cut, size = self.first.cut, done.figures
        contraction = None if before is None else share(left[cut], before[cut])
        gain = None if contraction is None else (1.0 - contraction) / factor
        self.iterations.append(
            Iteration(
                len(self.iterations),
                size.rms_m,
                size.max_m,
                _rms(left[cut]),
                contraction,
                None if gain is None or gain <= 0.0 else 1.0 / gain - 1.0,
                factor,
                len(self.program.poses.p) if before is not None else 0,
                done.plan.duration,
                float(np.linalg.norm(self.offset, axis=1).max()),
            )
        )
        write_json(self.folder / "iterations.json", [asdict(i) for i in self.iterations])
        self._table()

    def _table(self) -> None:
        """correction.csv: the correction and what is left at each node."""
        with (self.folder / "correction.csv").open("w", newline="", encoding="utf-8") as file:
            out = csv.writer(file)
            out.writerow(["line", "along_mm", *(f"{w}_{a}_mm" for w in ("planned", "correction", "before", "after") for a in "xyz"), "cut"])
            values = np.hstack([self.path.along[:, None], self.path.position, self.offset, self.first.deviation, self.last.deviation])
            for line, row, cut in zip(self.path.lines.tolist(), (1e3 * values).tolist(), self.first.cut.tolist(), strict=True):
                out.writerow([line, *(f"{v:.5f}" for v in row), int(cut)])

    def _rhos(self, before: FloatArray, left: FloatArray, factor: float) -> list[tuple[float, int]]:
        """Value of rho of each line of the program that speaks, with a node of it, the least first; -inf where the deviation grew."""
        fed = np.array([not s.rapid for s in self.path.said])  # a rapid out of the cut only swings
        lines, cut = self.path.lines, self.first.cut & fed
        whole = _rms(before[cut])
        found: list[tuple[float, int]] = []
        for line in np.unique(lines[cut]).tolist():
            here = np.flatnonzero((lines == line) & cut)
            if len(here) < _LEAST_NODES or _rms(before[here]) < _SPEAKS * whole:
                continue
            gain = (1.0 - share(left[here], before[here])) / factor
            found.append((1.0 / gain - 1.0 if gain > 0.0 else -math.inf, int(here[0])))
        return sorted(found)

    def _stable(self, before: FloatArray, left: FloatArray, factor: float) -> float:
        """The factor to go on with after the first correction. CompensationError where none helps."""
        rhos = self._rhos(before, left, factor)
        if rhos and rhos[0][0] < DIVERGES:
            rho, node = rhos[0]
            here = (self.path.lines == self.path.lines[node]) & self.first.cut
            raise CompensationError(
                f"the correction diverges at {self._where(node)}: rho = {rho:.2f}, less than {DIVERGES:g}: corrected once, "
                f"{1e3 * _rms(left[here]):.3f} mm rms are left of {1e3 * _rms(before[here]):.3f} mm: the force there pulls the tool the "
                f"further in the further it comes; cut less deep, feed in another direction, or place the part elsewhere (robomill place)"
                f"{self._kept}"
            )
        return DAMPING if rhos and rhos[0][0] < DAMPED else factor


def _try(loop: Loop, machine: Perturbation) -> Trial:
    """Mill the program as it is and the compensated one on a machine with other springs and cutting coefficients."""
    job, scenario = loop.machine.job, loop.machine.job.scenario
    assert scenario.workpiece is not None
    system = perturbed_system(loop.machine.system, machine)
    name = f"stiffness_{100 * machine.stiffness:+.0f}_force_{100 * machine.force:+.0f}{'_informed' * machine.informed}"
    before = loop.machine.mill(f"{name}_uncompensated", job.plan, loop.as_planned, system)
    after = loop.machine.mill(f"{name}_compensated", loop.plan, loop.along, system)
    cut = loop.first.cut
    surfaces = [
        evaluate(name, name, p.run, scenario.workpiece, math.nan, planned=loop.first.run).figures.rms_deviation_m for p in (before, after)
    ]
    return Trial(
        machine,
        before,
        after,
        share(_smooth(after.deviation)[cut], _smooth(before.deviation)[cut]),
        *surfaces,
    )


def perturbed_system(system: System, machine: Perturbation) -> System:
    """The system with every spring of `compliance` and every cutting coefficient of `milling` changed to those of another machine.

    CompensationError if a component has no such parameters.
    """
    with assemble(system, resolve, convert) as assembly:
        springs, coefficients = (1.0 + machine.stiffness, ("stiffness",)), (1.0 + machine.force, _COEFFICIENTS)
        changes = {"compliance": springs, "milling": coefficients, **({"controller": springs} if machine.informed else {})}
        for component, (factor, names) in changes.items():
            ports = [p for p in assembly.slaves[component].ports if p.causality == "parameter"]
            given: Mapping[str, Any] = assembly.parameters.get(component, {})
            values = {
                name: [factor * float(given.get(p.name, p.start)) for p in members]
                for name, members in arrays(ports).items()
                if name in names
            }
            if not values:
                raise CompensationError(
                    f"component {component!r} ({system.component(component).source}) has none of the parameters {', '.join(names)}; "
                    "compensate without perturbed machines (--no-perturbed)"
                )
            system = system.with_parameters(component, {n: v if len(v) > 1 else v[0] for n, v in values.items()})
    return system


def write_json(file: Path, value: Any) -> None:
    """Write JSON that a person can read."""
    file.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def _smooth(values: FloatArray) -> FloatArray:
    smooth: FloatArray = gaussian_filter1d(values, SMOOTHING, axis=0, mode="nearest")
    return smooth


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=-1))))


def share(after: FloatArray, before: FloatArray) -> float:
    """Part of `before` (n, 3) that is in `after`, by least squares: <after, before>/<before, before>."""
    return float(np.sum(after * before) / np.sum(before * before))
