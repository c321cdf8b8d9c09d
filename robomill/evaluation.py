"""What a milled variant comes to: deviation of the machined surface, force, reaction time. Everything from its recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fmus.components import component
from models.surface import SurfaceDeviation, ToolPath, measure
from orchestration.results import Run
from robomill.reaction import reaction_time
from robomill.scenario import Workpiece

WALL_LEVELS = tuple((i + 0.5) / 16 for i in range(16))
"""Heights at which walls are scanned, as shares of the wall."""
FLOOR_OFFSETS = tuple((i - 6) / 8.0 for i in range(13))
"""Where floors are scanned beside the path, as shares of the radius; nearer to a wall the deflected tool may not have been."""
PAUSE = 0.1
"""Engagements closer together than this [s] are one cut."""


@dataclass(frozen=True)
class Cut:
    """One uninterrupted engagement of the cutter; times in s."""

    start: float
    end: float


@dataclass(frozen=True)
class Result:
    """A variant: its run, the scan of its surface and the figures of summary.json."""

    name: str
    title: str
    run: Run
    nominal: ToolPath
    actual: ToolPath
    radius: float
    """Of the cutter [m]."""
    surface: SurfaceDeviation
    cuts: tuple[Cut, ...]
    figures: dict[str, Any]


def evaluate(name: str, title: str, run: Run, workpiece: Workpiece, real_time_factor: float) -> Result:
    """Scan the machined surface of a milling run and work out its figures."""
    diameter = run.info.get("parameters", {}).get("milling", {}).get("diameter", component("milling_force").variable("diameter").start)
    radius = 0.5 * float(diameter)
    quaternion = np.roll(Rotation.from_euler("ZYX", workpiece.abc).as_quat(canonical=True), 1)
    nominal, actual = (
        ToolPath.from_poses(run.t, run[f"{part}.p_BT_B"], run[f"{part}.quat_BT"], workpiece.position, quaternion)
        for part in ("path", "compliance")
    )
    surface = measure(nominal, actual, radius, workpiece.size, levels=WALL_LEVELS, floor_offsets=FLOOR_OFFSETS)
    cuts = engagements(run)
    worst = surface.worst
    reaction = reaction_time(run)
    figures = {
        "max_deviation_m": surface.max,
        "max_deviation_location": describe(surface, worst, cuts, run, radius),
        "max_deviation_point_m": surface.points[worst].tolist(),
        "rms_deviation_m": surface.rms,
        "p95_deviation_m": surface.p95,
        "floor_rms_deviation_m": surface.floors.rms,
        "floor_max_deviation_m": surface.floors.max,
        "peak_force_n": float(np.max(np.linalg.norm(run["sensor.f_T_T"], axis=1))),
        "peak_cutting_force_n": float(np.max(np.linalg.norm(run["milling.f_T_B"], axis=1))),
        "peak_substep_force_n": float(np.max(run["milling.f_peak"])),
        "reaction_t50_s": None if math.isnan(reaction) else reaction,
        "real_time_factor": None if math.isnan(real_time_factor) else real_time_factor,
    }
    return Result(name, title, run, nominal, actual, radius, surface, cuts, figures)


def engagements(run: Run) -> tuple[Cut, ...]:
    """The times in which material stood before the cutter."""
    cutting = run["milling.depth"] > 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], cutting, [False]]).astype(int)))
    cuts: list[Cut] = []
    for start, end in zip(run.t[edges[::2]], run.t[edges[1::2] - 1], strict=True):
        if cuts and start - cuts[-1].end < PAUSE:
            cuts[-1] = Cut(cuts[-1].start, float(end))
        else:
            cuts.append(Cut(float(start), float(end)))
    return tuple(cuts)


def place(time: float, cuts: tuple[Cut, ...], run: Run, radius: float) -> str:
    """Which part of a cut the tool was in at `time` [s]: entry and exit reach until the cutter is in, or out, by its diameter."""
    speed = float(np.median(np.linalg.norm(run["path.v_BT_B"], axis=1)[run["milling.depth"] > 0.0])) if cuts else 0.0
    span = 2.0 * radius / speed if speed > 0.0 else 0.0
    for cut in cuts:
        if cut.start - span <= time <= cut.end + span:
            if time < cut.start + span:
                return "cutter entry"
            if time > cut.end - span:
                return "cutter exit"
            return "within the cut"
    return "outside the cuts"


def describe(surface: SurfaceDeviation, index: int, cuts: tuple[Cut, ...], run: Run, radius: float) -> str:
    """Where a measured point is, in words and workpiece coordinates."""
    x, y, z = 1e3 * surface.points[index]
    where = place(float(surface.path_time[index]), cuts, run, radius)
    return f"{where}: {surface.kind[index]} at x = {x:.1f} mm, y = {y:.1f} mm, z = {z:.1f} mm"
