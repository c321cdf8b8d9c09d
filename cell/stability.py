"""How stable a planned program cuts: lobes at its poses, the margin of each line, and a map over the work space.

Spindle and tool modes stand on the modes of the robot in the pose of the line; both are turned into the cutting frame of the line
(x along the feed, y to its left, z out of the work). The engagement is that of the planned path in the dexels of the block.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system, machine_of, robot_of, tool_of
from robomill.cell.milling import own_tool, read_program, with_parameters
from robomill.cell.scenario import Scenario, ScenarioError
from robomill.models.model.declaration import FloatArray
from robomill.models.planning.planned_cuts import BOUNDS, PlannedCut, planned_cuts
from robomill.models.planning.reachability import axis_angles, check_reachable
from robomill.models.planning.trajectory import Plan, plan
from robomill.models.process.cutting import CuttingCoefficients, EndMill, mean_force
from robomill.models.process.stability.coupling import critical_gain
from robomill.models.process.stability.modes import Modes, frequency_grid, from_stiffness, load_modes, receptance
from robomill.models.process.stability.semi_discretisation import enough_intervals, periodic_matrices, spectral_radius
from robomill.models.process.stability.zero_order import Engagement, Lobes, lobes, mean_matrix
from robomill.models.robot.elastic_modes import ElasticMachine, elastic_modes
from robomill.models.robot.kinematics import inverse
from robomill.models.robot.numeric_inverse import kinematics
from robomill.orchestration.assembly import assemble
from robomill.orchestration.system.definition import System

TOOL_MODES = "spindle_d16"
"""Modes of spindle and tool where neither the cell nor the user has any: an assumption (models/data/modes)."""
_COEFFICIENTS = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")
_MOST_GAIN = 20.0
"""Depth, as a factor on the planned one, up to which mode coupling is looked for."""
_MOST_CHECKED = 60
"""Lines whose growth is computed by semi-discretisation: those of the smallest margins."""
_LEAST_PEAK = 1e-3
"""Modes whose peak is less than this share of the largest are left out there."""


@dataclass(frozen=True)
class Cell:
    """What the stability of a scenario depends on."""

    planned: Plan
    cuts: tuple[PlannedCut, ...]
    angles: FloatArray
    """Axis angles [rad] (n, 6) of the n cuts."""
    mills: Mapping[int, EndMill]
    coefficients: CuttingCoefficients
    spindle: Modes | None
    """Modes of spindle and tool in T; None: none."""
    machine: ElasticMachine | None
    """The robot with springs and masses; None: it is taken as rigid."""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class LineStability:
    """One line of the program."""

    line: int
    position: tuple[float, float, float]
    """Tool tip in P [m]."""
    spindle_speed: float
    """rad/s."""
    depth: float
    """Planned axial depth [m]."""
    engaged: tuple[float, float]
    """First and last immersion [rad]."""
    margin: float
    """Limit over planned depth by the zero-order lobes; inf without a limit."""
    chatter: float
    """Frequency of the chatter at that limit [Hz]."""
    growth: float | None
    """Largest eigenvalue per tooth period at the planned depth (semi-discretisation): 1 or more is unstable; None where not computed."""
    coupling: float
    """Factor on the planned force per depth at which the modes of the robot couple; inf for none up to 20."""
    coupling_frequency: float
    """Frequency of that [Hz]."""
    cut: PlannedCut = field(repr=False)
    q: FloatArray = field(repr=False)
    """Axis angles [rad] (6,)."""

    @property
    def stable(self) -> bool:
        """Whether the planned cut is: by growth, by margin where that is not computed, and by mode coupling."""
        regenerative = self.growth < 1.0 if self.growth is not None else self.margin > 1.0
        return regenerative and self.coupling > 1.0


def prepare(scenario: Scenario, modes: str | Path | None = None, rigid: bool = False) -> Cell:
    """Plan the program of a milling scenario and find what cuts in it; `modes` names those of spindle and tool ("none": none).

    Raises what the readers and the planner raise; ScenarioError where nothing is cut, nothing can vibrate, or the tool is not described.
    """
    if scenario.program is None or scenario.workpiece is None:
        raise ScenarioError(
            f"{scenario.file}: a scenario of kind {scenario.kind!r} has no program whose stability could be judged"
            "; choose one with kind = 'milling'"
        )
    program = read_program(scenario.program, scenario.reading, scenario.orientation)
    system = with_parameters(load_system(scenario.system, scenario.equipment), scenario.parameters)
    own = own_tool(system)
    if own is None and not scenario.tools:
        raise ScenarioError(f"{scenario.file}: neither the component 'milling' nor [tools] says what the tool is; add [tools.1]")
    mills: dict[int, EndMill] = {**({0: own} if own else {}), **scenario.tools}
    planned = plan(program, scenario.workpiece.placement)
    robot = robot_of(system)
    check_reachable(planned, robot, tool_of(system), robot.q_home)
    cuts = tuple(
        c for c in planned_cuts(planned, scenario.workpiece.size, {n: 0.5 * m.diameter for n, m in mills.items()}) if c.spindle_speed > 0.0
    )
    if not cuts:
        raise ScenarioError(
            f"{scenario.file}: {scenario.program.name} cuts nothing with the spindle on; `robomill plan` says why; give a program that cuts"
        )
    angles = axis_angles(planned, np.array([c.time for c in cuts]), robot, tool_of(system), robot.q_home)
    coefficients, spindle, notes = _process(system, modes)
    machine = None if rigid else machine_of(system)
    if machine is None and not rigid:
        notes += (f"robot {robot.name!r} has no springs or no bodies in models/data: it is taken as rigid",)
    if machine is None and spindle is None:
        raise ScenarioError(f"{scenario.file}: neither tool nor robot can vibrate; name modes (--modes {TOOL_MODES})")
    return Cell(planned, cuts, angles, mills, coefficients, spindle, machine, notes)


def _process(system: System, modes: str | Path | None) -> tuple[CuttingCoefficients, Modes | None, tuple[str, ...]]:
    """Cutting coefficients and modes of the milling component; notes on what is assumed."""
    with assemble(system, resolve, convert) as assembly:
        starts = {p.name: p.start for p in assembly.slaves["milling"].ports if p.causality == "parameter"}
        given: dict[str, Any] = {**starts, **assembly.parameters.get("milling", {})}
    lacking = [name for name in _COEFFICIENTS if name not in given]
    if lacking:
        raise ScenarioError(
            f"{system.name}: component 'milling' has no {', '.join(lacking)}: its force does not follow from a chip thickness"
            "; use a milling component that has them, such as milling_force"
        )
    coefficients = CuttingCoefficients(*(float(given[name]) for name in _COEFFICIENTS))
    if modes is not None:
        return coefficients, None if str(modes) == "none" else load_modes(modes), ()
    numbers = [i for i in range(1, 1000) if given.get(f"mode_frequency[{i}]")]
    if numbers:
        frequency, damping, stiffness = (
            [float(given[f"mode_{what}[{i}]"]) for i in numbers] for what in ("frequency", "damping", "stiffness")
        )
        direction = [[float(given[f"mode_direction[{i},{k}]"]) for k in (1, 2, 3)] for i in numbers]
        return coefficients, from_stiffness(frequency, damping, stiffness, direction), ("modes of spindle and tool: those of 'milling'",)
    note = f"modes of spindle and tool are assumed ({TOOL_MODES}); name measured ones with --modes"
    return coefficients, load_modes(TOOL_MODES), (note,)


def frame_of(cell: Cell, cut: PlannedCut) -> FloatArray:
    """R_CB (3, 3): from B into the cutting frame (x feed, y left, z out of the work) of a planned cut."""
    ux, uy = cut.direction
    R_CP = np.array([[ux, uy, 0.0], [-uy, ux, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(R_CP @ cell.planned.placement.R_BP.T)


def angles_at(cell: Cell, cut: PlannedCut) -> FloatArray:
    """Axis angles [rad] (6,) of a planned cut."""
    angles: FloatArray = cell.angles[next(i for i, c in enumerate(cell.cuts) if c is cut)]
    return angles


def robot_modes(cell: Cell, q: FloatArray, R: FloatArray) -> Modes | None:
    """Modes of the robot at axis angles q [rad] in the axes of R (3, 3) @ B; None for a rigid robot."""
    if cell.machine is None:
        return None
    tip = elastic_modes(cell.machine, q)
    return Modes(tip.frequency, tip.damping, tip.shape[:3]).turned(R)


def modes_at(cell: Cell, cut: PlannedCut, q: FloatArray, robot_alone: bool = False) -> Modes:
    """Modes of robot, spindle and tool at axis angles q [rad] in the cutting frame of a planned cut; or of the robot alone."""
    R = frame_of(cell, cut)
    robot = robot_modes(cell, q, R)
    if cell.spindle is None or robot_alone:
        assert robot is not None  # `prepare` refuses a cell where nothing vibrates
        return robot
    R_BT = cell.planned.rotation(np.array([cut.time])).as_matrix()[0]
    spindle = cell.spindle.turned(R @ R_BT)
    return spindle if robot is None else robot + spindle


def mill_of(cell: Cell, cut: PlannedCut) -> EndMill:
    """The tool of a planned cut."""
    return cell.mills[cut.tool] if cut.tool in cell.mills else cell.mills[0]


def engagement_of(cut: PlannedCut) -> Engagement:
    """The engagement with depths as shares of the axial depth."""
    return Engagement(BOUNDS, cut.depth / cut.axial)


def lobes_at(cell: Cell, cut: PlannedCut, q: FloatArray, speeds: FloatArray, robot_alone: bool = False, points: int = 160) -> Lobes:
    """Zero-order lobes [m] of a planned cut at axis angles q [rad] over spindle speeds [rad/s]; `points`: frequencies per mode."""
    modes, mill = modes_at(cell, cut, q, robot_alone), mill_of(cell, cut)
    f = frequency_grid(modes, points)
    A = mean_matrix(cell.coefficients, mill.teeth, engagement_of(cut))
    return lobes(f, receptance(modes, f), A, mill.teeth, speeds)


def depth_gain(cell: Cell, cut: PlannedCut) -> FloatArray:
    """dF/du (3, 3) [N/m] in the cutting frame, without past: a tool that goes up by u_z cuts u_z less deep over its engagement.

    The mean force per depth of FACTS 3.2, bin by bin; Altintas' axial force is along the tool, -z of the cutting frame.
    """
    mill = mill_of(cell, cut)
    chip = 2.0 * math.pi * cut.feed / (mill.teeth * cut.spindle_speed)
    force = np.zeros(3)
    for b in np.flatnonzero(cut.depth > 0.0):
        force += mean_force(cell.coefficients, mill.teeth, 1.0, chip, float(BOUNDS[b]), float(BOUNDS[b + 1]))
    G = np.zeros((3, 3))
    G[:, 2] = -force * np.array([1.0, 1.0, -1.0])
    return G


def judge(cell: Cell) -> tuple[LineStability, ...]:
    """Margin, growth and mode coupling of every line that cuts, in the order of the program."""
    found = []
    for cut in cell.cuts:
        q = angles_at(cell, cut)
        lobe = lobes_at(cell, cut, q, np.array([cut.spindle_speed]))
        factor, frequency = math.inf, math.nan
        robot = robot_modes(cell, q, frame_of(cell, cut))
        if robot is not None:
            factor, frequency = critical_gain(_main(robot), depth_gain(cell, cut), _MOST_GAIN)
        found.append((cut, q, float(lobe.depth[0]) / cut.axial, float(lobe.frequency[0]), factor, frequency))
    nearest = sorted(range(len(found)), key=lambda i: found[i][2])[:_MOST_CHECKED]
    growths = {i: _growth(cell, found[i][0], found[i][1]) for i in nearest}
    return tuple(
        LineStability(
            cut.line,
            (float(cut.position[0]), float(cut.position[1]), float(cut.position[2])),
            cut.spindle_speed,
            cut.axial,
            cut.engaged,
            margin,
            chatter,
            growths.get(i),
            factor,
            frequency,
            cut,
            q,
        )
        for i, (cut, q, margin, chatter, factor, frequency) in enumerate(found)
    )


def _main(modes: Modes) -> Modes:
    """The modes without those that never move the tool by a share that counts."""
    peak = (modes.shape**2).sum(axis=0) / modes.circular**2 / (2.0 * np.maximum(modes.damping, 1e-3))
    kept = peak > _LEAST_PEAK * peak.max()
    return Modes(modes.frequency[kept], modes.damping[kept], modes.shape[:, kept])


def _growth(cell: Cell, cut: PlannedCut, q: FloatArray) -> float:
    """Largest eigenvalue of the monodromy matrix at the planned depth."""
    modes, mill = _main(modes_at(cell, cut, q)), mill_of(cell, cut)
    period = 2.0 * math.pi / (mill.teeth * cut.spindle_speed)
    matrices = periodic_matrices(cell.coefficients, int(mill.teeth), engagement_of(cut), enough_intervals(modes, period))
    return spectral_radius(modes, matrices, cut.axial, period)


MAP_POINTS = 60
"""Frequencies per mode of a map: its limits are within 1 % of those of the lobes."""


def map_of(cell: Cell, line: LineStability, x: FloatArray, y: FloatArray) -> FloatArray:
    """Margin (ny, nx) of the cut of a line with the modes of the robot alone, if the tool tip stood at x (nx,), y (ny,) [m] in B.

    Height and orientation as planned. Spindle and tool are left out, as their modes go with the tool. nan where the robot does not get
    there. ScenarioError for a rigid robot.
    """
    if cell.machine is None:
        raise ScenarioError(
            "a map shows how the modes of the robot change over its work space; this one is rigid (no springs, no bodies)"
            "; name a robot that has both, or leave out --map and --rigid"
        )
    s = kinematics(cell.machine.robot, cell.machine.tool)
    height = cell.planned.placement.to_base(line.position)[2]
    R = np.ascontiguousarray(cell.planned.rotation(np.array([line.cut.time])).as_matrix()[0])
    margin = np.full((len(y), len(x)), np.nan)
    speed, q = np.array([line.spindle_speed]), np.zeros(6)
    for row, column in np.ndindex(margin.shape):
        if inverse(s, np.array([x[column], y[row], height]), R, line.q, q) == 0:
            margin[row, column] = lobes_at(cell, line.cut, q, speed, True, MAP_POINTS).depth[0] / line.depth
    return margin
