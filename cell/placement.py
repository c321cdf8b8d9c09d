"""Where the workpiece should stand and how the spindle should be turned about the tool, so that a program bends the robot least.

Criterion: the rms over the cut of |C(q) f|, the displacement of the tool tip to first order: C the compliance of the robot at the axis
angles of the pose, f the cutting force that the program has on a rigid robot, fixed in the workpiece. Free are the position of the
workpiece, its turn about z of the base and the angle of the spindle about the tool axis, which milling leaves free; limits are the reach,
those of the axes and the distance from the wrist singularity. Axis speeds are checked where the search ends.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import differential_evolution, minimize
from scipy.spatial.transform import Rotation

from robomill.cell.binding import convert, resolve
from robomill.cell.compensation import Machine
from robomill.cell.equipment import robot_of, tool_of
from robomill.cell.milling import Progress, lay_out, offline_force, read_program
from robomill.cell.scenario import Scenario, Variant, Workpiece
from robomill.models.model.compiled import compiled_on_call
from robomill.models.model.declaration import FloatArray, Model
from robomill.models.planning.path_correction import planned_path
from robomill.models.planning.reachability import check_reachable
from robomill.models.planning.trajectory import Placement, PlanError, plan
from robomill.models.robot.kinematics import Robot, Tool, inverse, robot_variables
from robomill.models.robot.virtual_joints import TABLE_1, compliance_matrix, compliance_variables
from robomill.orchestration.assembly import assemble
from robomill.orchestration.slaves.protocol import arrays
from robomill.orchestration.system.definition import System

VARIABLES = ("x", "y", "z", "turn", "spindle")
"""What may be free: position [m], turn of the workpiece about z of B and of the spindle about the tool axis [rad]."""
SAMPLES = 80
"""Points of the program that the criterion is worked out at: with twice as many it changes by less than 1 %."""
WRIST = 0.1
"""Least |sin A5|: nearer to the wrist singularity the axes 4 and 6 have to turn ten times as fast as the tool."""
AXIS_MARGIN = math.radians(3.0)
"""Least distance of an axis from its limits at the points that are looked at: between them the path goes a little further."""
OUT_OF_REACH = 1.0
"""m; what the search takes for a placement that is out of limits."""
_SEED = 1
_POPULATION, _GENERATIONS, _TOLERANCE = 8, 40, 1e-3


class PlacementError(ValueError):
    """A search that has no result: what is wrong and what to do."""


@dataclass(frozen=True)
class Task:
    """What a placement is judged by."""

    robot: Robot
    position: FloatArray
    """(n, 3) points of the program in P [m]."""
    rotation: Rotation
    """(n,) orientation of the tool against the upright one."""
    force: FloatArray
    """(n, 3) on the tool, in P [N]; zero in the air."""
    record: npt.NDArray[np.void]
    """Robot, tool and springs, as the kernels take them."""

    @property
    def cut(self) -> npt.NDArray[np.bool_]:
        """(n,) whether there is a force."""
        pressed: npt.NDArray[np.bool_] = np.any(self.force != 0.0, axis=1)
        return pressed

    def bending(self, placement: Placement) -> tuple[FloatArray, FloatArray]:
        """Displacement [m] (n, 3) in P and axis angles [rad] (n, 6). PlacementError names the first point that is out of limits."""
        p = np.asarray(placement.p_BP_B) + self.position @ placement.R_BP.T
        R = (Rotation.from_matrix(placement.R_BT) * self.rotation).as_matrix()
        bent, q = np.zeros_like(p), np.zeros((len(p), 6))
        found = _bending(self.record, p, np.ascontiguousarray(R), self.force @ placement.R_BP.T, self.robot.q_home, WRIST, bent, q)
        if found:
            x, y, z = 1e3 * self.position[found // 4]
            why = {1: "out of reach", 2: "beyond the limits of an axis", 3: "too near to the wrist singularity"}[found % 4]
            raise PlacementError(
                f"the point {x:.1f}, {y:.1f}, {z:.1f} mm of the program is {why}; place the part where the robot reaches it"
            )
        return bent @ placement.R_BP, q

    def criterion(self, placement: Placement) -> float:
        """Displacement of the tool tip in the cut, rms [m]; OUT_OF_REACH where the robot cannot follow."""
        try:
            bent, _ = self.bending(placement)
        except (PlacementError, PlanError):
            return OUT_OF_REACH
        return float(np.sqrt(np.mean(np.sum(bent[self.cut] ** 2, axis=1))))


@compiled_on_call
def _bending(
    data: npt.NDArray[np.void], p: FloatArray, R: FloatArray, f: FloatArray, q_start: FloatArray, wrist: float, d: FloatArray, q: FloatArray
) -> int:
    """Fill displacements d (n, 3) [m] and axis angles q (n, 6) [rad]; returns 0, or 4 i + 1, 2, 3 for the point i that cannot be."""
    s = data[0]
    near = q_start.copy()
    C = np.zeros((6, 6))
    for i in range(len(p)):
        status = inverse(s, p[i], R[i], near, q[i])
        if status != 0:
            return 4 * i + status
        if abs(math.sin(q[i, 4])) < wrist:
            return 4 * i + 3
        for k in range(6):
            near[k] = q[i, k]
        compliance_matrix(s, q[i], C)
        for a in range(3):
            d[i, a] = C[a, 0] * f[i, 0] + C[a, 1] * f[i, 1] + C[a, 2] * f[i, 2]
    return 0


def task(
    robot: Robot, tool: Tool, springs: Mapping[str, npt.ArrayLike], position: FloatArray, rotation: Rotation, force: FloatArray
) -> Task:
    """A task of a robot; `springs`: parameters of `compliance_variables` by name."""

    def unused(*_: object) -> int:
        return 0

    model = Model("placement", robot.name, (*robot_variables(robot, tool), *compliance_variables(TABLE_1, tool)), unused, unused)
    data = model.new()
    for variable in model.variables:
        if variable.causality == "parameter":
            data[variable.name] = variable.start_values
    for name, value in springs.items():
        data[name] = np.reshape(np.asarray(value, dtype=np.float64), data[name].shape[1:])
    data["q_min"] += AXIS_MARGIN
    data["q_max"] -= AXIS_MARGIN
    return Task(robot, position, rotation, force, data)


@dataclass(frozen=True)
class Placing:
    """The placement as it is and the best one."""

    scenario: Scenario
    task: Task
    free: tuple[str, ...]
    bounds: FloatArray
    """(5, 2) of VARIABLES."""
    present: FloatArray
    """(5,) VARIABLES of the scenario."""
    best: FloatArray
    present_m: float
    """Criterion as it is; OUT_OF_REACH where the program cannot be run there."""
    best_m: float
    evaluations: int
    margin: FloatArray
    """(6,) distance of the axes from their limits [rad] at the best placement, along the whole program."""

    def placement(self, values: FloatArray) -> Placement:
        """Where the workpiece stands for values (5,) of VARIABLES."""
        return _placement(self.scenario, values)


def prepare(scenario: Scenario, folder: Path, progress: Progress | None = None) -> tuple[Task, System]:
    """The forces of a milling scenario's program on a rigid robot, and the springs of its robot: what placements are judged by.

    Raises what `lay_out` raises; PlacementError for a robot whose compliance has no virtual joints.
    """
    if scenario.program is None or scenario.workpiece is None:
        raise PlacementError(f"{scenario.file}: a scenario of kind {scenario.kind!r} has no program to place; give a milling scenario")
    job = lay_out(scenario, folder, overwrite=True)
    tau, force = offline_force(job, progress)
    path = planned_path(job.plan, read_program(scenario.program, scenario.reading, scenario.orientation))
    chosen = np.unique(np.linspace(0, len(path) - 1, SAMPLES).astype(np.int64))
    times = path.time[chosen]
    placement = job.plan.placement
    pressed = np.column_stack([np.interp(times, tau, c) for c in force.T]) @ placement.R_BP
    pressed[np.linalg.norm(pressed, axis=1) < _NO_FORCE] = 0.0
    if not np.any(pressed):
        raise PlacementError(
            f"{scenario.program.name}: no cutting force anywhere along the program; nothing bends the robot; give a program that cuts"
        )
    rotation = Rotation.from_matrix(placement.R_BT.T) * job.plan.rotation(times)
    springs = _springs(job.system)
    return task(robot_of(job.system), tool_of(job.system), springs, path.position[chosen], rotation, pressed), job.system


_NO_FORCE = 1.0
"""N; below this a point counts as air."""


def _springs(system: System) -> dict[str, FloatArray]:
    wanted = {v.name for v in compliance_variables(TABLE_1, tool_of(system)) if v.causality == "parameter"}
    with assemble(system, resolve, convert) as assembly:
        ports = [p for p in assembly.slaves["compliance"].ports if p.causality == "parameter"]
        given: Mapping[str, Any] = assembly.parameters.get("compliance", {})
        found = {n: np.array([float(given.get(p.name, p.start)) for p in m]) for n, m in arrays(ports).items() if n in wanted}
    if "stiffness" not in found:
        raise PlacementError(
            f"component 'compliance' ({system.component('compliance').source}) has no parameter stiffness, the table of virtual joints; "
            "search with robot_compliance in its place"
        )
    return found


def place(
    scenario: Scenario,
    folder: Path,
    span: Sequence[float] = (0.3, 0.3, 0.3),
    free: Sequence[str] = VARIABLES,
    progress: Progress | None = None,
) -> Placing:
    """Search the placement with the least criterion: differential evolution, then Nelder-Mead; seeded.

    `span` [m]: how far x, y, z may go from where they are, both ways; `free`: which of VARIABLES are. PlacementError if nothing in
    the range can be reached.
    """
    if unknown := [v for v in free if v not in VARIABLES]:
        raise PlacementError(f"{unknown[0]!r} cannot be free; available: {', '.join(VARIABLES)}")
    judged, _ = prepare(scenario, folder, progress)
    assert scenario.workpiece is not None
    w = scenario.workpiece
    present = np.array([*w.position, w.abc[0], w.tool_angle])
    reach = np.array([*span, math.pi, math.pi])
    bounds = np.column_stack([present - reach, present + reach])
    index = [VARIABLES.index(v) for v in VARIABLES if v in free]

    def full(x: FloatArray) -> FloatArray:
        values = present.copy()
        values[index] = x
        return values

    def cost(x: FloatArray) -> float:
        return judged.criterion(_placement(scenario, full(x)))

    count = 0

    def counted(x: FloatArray) -> float:
        nonlocal count
        count += 1
        return cost(x)

    coarse = differential_evolution(
        counted,
        bounds[index],
        seed=_SEED,
        popsize=_POPULATION,
        maxiter=_GENERATIONS,
        tol=_TOLERANCE,
        polish=False,
        x0=present[index],
        callback=None if progress is None else _reporter(progress),
    )
    fine = minimize(counted, coarse.x, method="Nelder-Mead", bounds=bounds[index], options={"xatol": 1e-4, "fatol": 1e-9})
    best = full(fine.x if fine.fun < coarse.fun else coarse.x)
    beyond = np.abs(best) > math.pi
    beyond[:3] = False
    best[beyond] = (best[beyond] + math.pi) % (2.0 * math.pi) - math.pi
    value = judged.criterion(_placement(scenario, best))
    if value >= OUT_OF_REACH:
        low, high = 1e3 * bounds[:3].T
        raise PlacementError(
            f"{scenario.file.name}: no placement in x {low[0]:.0f} .. {high[0]:.0f}, y {low[1]:.0f} .. {high[1]:.0f}, z {low[2]:.0f} .. "
            f"{high[2]:.0f} mm can be reached with {', '.join(v for v in VARIABLES if v in free)} free; widen --range, or free more"
        )
    return Placing(
        scenario,
        judged,
        tuple(VARIABLES[i] for i in index),
        bounds,
        present,
        best,
        judged.criterion(_placement(scenario, present)),
        value,
        count,
        _check(scenario, judged, best),
    )


def _reporter(progress: Progress):  # type: ignore[no-untyped-def]  # scipy calls it with its own arguments
    generation = 0

    def report(*_: object, **__: object) -> None:
        nonlocal generation
        generation += 1
        progress("placement", generation, _GENERATIONS)

    return report


def _placement(scenario: Scenario, values: FloatArray) -> Placement:
    assert scenario.workpiece is not None
    x, y, z, turn, spindle = (float(v) for v in values)
    return Placement((x, y, z), (turn, *scenario.workpiece.abc[1:]), spindle)


def _check(scenario: Scenario, judged: Task, values: FloatArray) -> FloatArray:
    """Distance of the axes from their limits [rad] (6,) along the whole program at a placement. PlacementError where it cannot run."""
    from robomill.cell.equipment import load_system

    assert scenario.program is not None
    planned = plan(read_program(scenario.program, scenario.reading, scenario.orientation), _placement(scenario, values))
    tool = tool_of(load_system(scenario.system, scenario.equipment))
    try:
        return check_reachable(planned, judged.robot, tool, judged.robot.q_home).margin
    except PlanError as error:
        raise PlacementError(f"the best placement for the points looked at cannot be run: {error}; free less, or narrow --range") from None


def placed(scenario: Scenario, values: FloatArray) -> Scenario:
    """The scenario with its workpiece at values (5,) of VARIABLES."""
    assert scenario.workpiece is not None
    x, y, z, turn, spindle = (float(v) for v in values)
    w: Workpiece = scenario.workpiece
    return replace(scenario, workpiece=replace(w, position=(x, y, z), abc=(turn, *w.abc[1:]), tool_angle=spindle))


def milled(scenario: Scenario, folder: Path, variant: Variant | None = None, progress: Progress | None = None) -> float:
    """Deviation of the tool tip from the path in the cut, rms [m], simulated with all feedback."""
    assert scenario.program is not None
    chosen = variant or scenario.variants[0]
    job = lay_out(replace(scenario, variants=(chosen,)), folder, overwrite=True)
    path = planned_path(job.plan, read_program(scenario.program, scenario.reading, scenario.orientation))
    return Machine(job, chosen, path, progress).mill("milled", job.plan, lambda tau: np.interp(tau, path.time, path.along)).figures.rms_m


def grid_map(placing: Placing, pair: tuple[str, str], count: int = 25) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Criterion [m] (count, count) over two of VARIABLES, the others at the best placement; NaN where it is out of limits.

    Returns the values of the first (columns), of the second (rows), and the criterion.
    """
    i, j = (VARIABLES.index(v) for v in pair)
    across, up = (np.linspace(placing.bounds[k, 0], placing.bounds[k, 1], count) for k in (i, j))
    found = np.full((count, count), np.nan)
    for row, v in enumerate(up):
        for column, u in enumerate(across):
            values = placing.best.copy()
            values[i], values[j] = u, v
            c = placing.task.criterion(placing.placement(values))
            found[row, column] = c if c < OUT_OF_REACH else np.nan
    return across, up, found


def toml_lines(placing: Placing) -> str:
    """The lines of [workpiece] that change."""
    assert placing.scenario.workpiece is not None
    x, y, z = 1e3 * placing.best[:3]
    turn, spindle = np.rad2deg(placing.best[3:])
    b, c = np.rad2deg(placing.scenario.workpiece.abc[1:])
    return (
        "[workpiece]\n"
        f'position = ["{x:.2f} mm", "{y:.2f} mm", "{z:.2f} mm"]\n'
        f'abc = ["{turn:.3f} deg", "{b:g} deg", "{c:g} deg"]\n'
        f'tool_angle = "{spindle:.3f} deg"\n'
    )
