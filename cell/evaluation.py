"""What a milled variant comes to: deviation of the machined surface, force, reaction time. Everything from its recording."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from robomill.cell import part
from robomill.cell.reaction import reaction_time
from robomill.cell.scenario import Workpiece
from robomill.fmus.components import component
from robomill.models.metrology.surface import NothingCutError, SurfaceDeviation, measure
from robomill.models.metrology.tool_path import ToolPath
from robomill.models.model.declaration import FloatArray
from robomill.models.process import tool_table
from robomill.orchestration.runs.run import Run

PAUSE = 0.1
"""Engagements closer together than this [s] are one cut."""


@dataclass(frozen=True)
class Cut:
    """One uninterrupted engagement of the cutter; times in s."""

    start: float
    end: float


@dataclass(frozen=True)
class Figures:
    """What summary.json has of a variant, key by key; what cannot be told is None, and `note` says why nothing can."""

    max_deviation_m: float | None = None
    """Largest deviation of the machined surface."""
    max_deviation_limited: bool | None = None
    """Whether the largest deviation is as far as the measure reaches: it may be more."""
    max_deviation_location: str | None = None
    """Wall or floor where it is."""
    max_deviation_point_m: tuple[float, ...] | None = None
    """x, y, z in P."""
    rms_deviation_m: float | None = None
    """Root mean square of the deviation."""
    p95_deviation_m: float | None = None
    """Magnitude that 95 % of the deviations do not exceed."""
    floor_rms_deviation_m: float | None = None
    """Root mean square of the deviation of the floors."""
    floor_max_deviation_m: float | None = None
    """Largest deviation of the floors."""
    edge_share: float | None = None
    """Share of the measured points beside edges; they count in `edge_max_deviation_m` and nowhere else."""
    edge_max_deviation_m: float | None = None
    """Largest deviation beside edges."""
    peak_force_n: float | None = None
    """Largest force as measured."""
    peak_cutting_force_n: float | None = None
    """Largest force on the cutter, mean over a step."""
    peak_substep_force_n: float | None = None
    """Largest force on the cutter within a step."""
    reaction_t50_s: float | None = None
    """Time after the entry of the cutter in which half of the deflection is corrected."""
    real_time_factor: float | None = None
    """Simulated time over wall-clock time."""
    note: str | None = None
    """Why there are no figures."""


@dataclass(frozen=True)
class Result:
    """A variant: its run, the scan of its surface and the figures of summary.json."""

    name: str
    title: str
    run: Run
    nominal: ToolPath
    actual: ToolPath
    surface: SurfaceDeviation | None
    """None if nothing was cut."""
    cuts: tuple[Cut, ...]
    figures: Figures


def evaluate(name: str, title: str, run: Run, workpiece: Workpiece, real_time_factor: float, planned: Run | None = None) -> Result:
    """Scan the machined surface of a milling run and work out its figures; where nothing was cut they are None, and `note` says why.

    `planned`: the run whose path is the nominal one, where that of `run` was corrected.
    """
    planned = planned or run
    quaternion = np.roll(Rotation.from_euler("ZYX", workpiece.abc).as_quat(canonical=True), 1)
    nominal, actual = (
        ToolPath.from_poses(r.t, r[f"{part}.p_BT_B"], r[f"{part}.quat_BT"], workpiece.position, quaternion, tool_radius(r))
        for r, part in ((planned, "path"), (run, "compliance"))
    )
    cuts = engagements(run)
    surface, figures = None, Figures()
    try:
        if not cuts:
            raise NothingCutError(
                "nothing is cut: the tool never met the block; correct the place of the block, the zero of the program or the tool"
            )
        surface = part.scan(run, workpiece) if part.is_tridexel(run) else measure(nominal, actual, workpiece.size)
    except NothingCutError as why:
        figures = Figures(note=str(why))
    if surface is not None:
        figures = replace(
            _deviations(surface, engagements(planned), planned, nominal),
            peak_force_n=float(np.max(np.linalg.norm(run["sensor.f_T_T"], axis=1))),
            peak_cutting_force_n=float(np.max(np.linalg.norm(run["milling.f_T_B"], axis=1))),
            peak_substep_force_n=float(np.max(run["milling.f_peak"])),
            reaction_t50_s=_known(reaction_time(run)),
        )
    return Result(name, title, run, nominal, actual, surface, cuts, replace(figures, real_time_factor=_known(real_time_factor)))


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def tool_radius(run: Run) -> FloatArray:
    """Radius [m] (n,) of the cutter at each sample: of the tool `path.tool` in the run's table of tools, else of the only one."""
    parameters = run.info.get("parameters", {}).get("milling", {})
    diameter = parameters.get("diameter", component("milling_force").variable("diameter").start)
    radius = np.full(len(run), 0.5 * float(diameter))
    if parameters.get("tools") and "path.tool" in run.columns:
        number = run["path.tool"]
        for row in np.load(parameters["tools"]):
            radius[number == row[tool_table.NUMBER]] = 0.5 * row[tool_table.DIAMETER]
    return radius


def _deviations(surface: SurfaceDeviation, cuts: tuple[Cut, ...], run: Run, nominal: ToolPath) -> Figures:
    """The figures of the surface. What lies beside edges has one of its own."""
    edges = np.abs(surface.deviation[surface.edge])
    share, largest = float(np.mean(surface.edge)), float(np.max(edges, initial=0.0))
    if np.all(surface.edge):
        note = "all of the surface lies within its deviation of an edge; only edge_max_deviation_m says how far off it is"
        return Figures(edge_share=share, edge_max_deviation_m=largest, note=note)
    floors = surface.floors if np.any(~surface.wall & ~surface.edge) else None
    return Figures(
        max_deviation_m=surface.max,
        max_deviation_limited=surface.is_limited,
        max_deviation_location=describe(surface, surface.worst, cuts, run, nominal),
        max_deviation_point_m=tuple(surface.points[surface.worst].tolist()),
        rms_deviation_m=surface.rms,
        p95_deviation_m=surface.p95,
        floor_rms_deviation_m=floors.rms if floors else None,
        floor_max_deviation_m=floors.max if floors else None,
        edge_share=share,
        edge_max_deviation_m=largest,
    )


def engagements(run: Run) -> tuple[Cut, ...]:
    """The times in which material was cut, before the edges or under the end face."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], cutting(run), [False]]).astype(int)))
    cuts: list[Cut] = []
    for start, end in zip(run.t[edges[::2]], run.t[edges[1::2] - 1], strict=True):
        if cuts and start - cuts[-1].end < PAUSE:
            cuts[-1] = Cut(cuts[-1].start, float(end))
        else:
            cuts.append(Cut(float(start), float(end)))
    return tuple(cuts)


def cutting(run: Run) -> npt.NDArray[np.bool_]:
    """Whether material is cut, per sample (n,): a plunge straight down removes some though no edge stands in it sideways (depth 0)."""
    result: npt.NDArray[np.bool_] = (run["milling.depth"] > 0.0) | (run["milling.removal_rate"] > 0.0)
    return result


def place(time: float, cuts: tuple[Cut, ...], run: Run, diameter: float) -> str:
    """Which part of a cut the tool was in at `time` [s]: entry and exit reach until the cutter is in, or out, by its `diameter` [m]."""
    speed = float(np.median(np.linalg.norm(run["path.v_BT_B"], axis=1)[cutting(run)])) if cuts else 0.0
    span = diameter / speed if speed > 0.0 else 0.0
    for cut in cuts:
        if cut.start - span <= time <= cut.end + span:
            if time < cut.start + span:
                return "cutter entry"
            if time > cut.end - span:
                return "cutter exit"
            return "within the cut"
    return "outside the cuts"


def describe(surface: SurfaceDeviation, index: int, cuts: tuple[Cut, ...], run: Run, nominal: ToolPath) -> str:
    """Where a measured point is, in words and workpiece coordinates."""
    x, y, z = 1e3 * surface.points[index]
    time = float(surface.path_time[index])
    radius = float(nominal.radius[np.searchsorted(nominal.time, time) - 1])
    where = place(time, cuts, run, 2.0 * radius)
    return f"{where}: {surface.kind[index]} at x = {x:.1f} mm, y = {y:.1f} mm, z = {z:.1f} mm"
