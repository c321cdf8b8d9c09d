"""What the edges meet along a planned program: engagement by angle of immersion, from dexels that the plan itself cuts. No forces."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robomill.models.components.milling_force import BINS
from robomill.models.model.compiled import loaded
from robomill.models.model.declaration import FloatArray
from robomill.models.planning.gcode import Vector
from robomill.models.planning.segment_table import LINE, TAU, TOOL
from robomill.models.planning.trajectory import Plan
from robomill.models.process import dexels as workpiece

BOUNDS = np.linspace(0.0, math.pi, BINS + 1)
"""Bounds of the angular bins [rad]."""
STEP = 1e-3
"""Longest way [m] between two looks at the engagement."""
CELLS = 1_000_000
"""Cells that the block is divided into at most."""
CELLS_PER_RADIUS = 24.0
"""Cells that the radius of the smallest tool is resolved by, where `CELLS` allows."""
LEAST_REMOVED = 1e-3
"""Share of diameter times depth that a cut takes away at least: at the walls of a finished slot edges see parts of cells."""
MOST_SAMPLES = 200_000
"""Looks at a program at most; a longer one is looked at less often."""


@dataclass(frozen=True)
class PlannedCut:
    """Where a line of a program cuts most."""

    line: int
    """Line of the program."""
    time: float
    """Path time [s]."""
    position: FloatArray
    """Tool tip in P [m] (3,)."""
    direction: FloatArray
    """Unit vector of the feed in P, in the plane of the cut (2,)."""
    feed: float
    """Feed in that plane [m/s]."""
    spindle_speed: float
    """rad/s."""
    tool: int
    """T number, 0 where none is named."""
    depth: FloatArray
    """Height of the material that the edges meet in each bin of `BOUNDS` [m] (BINS,)."""

    @property
    def axial(self) -> float:
        """Largest axial depth [m]."""
        return float(self.depth.max())

    @property
    def engaged(self) -> tuple[float, float]:
        """First and last immersion [rad] with half the axial depth."""
        at = np.flatnonzero(self.depth > 0.5 * self.axial)
        return float(BOUNDS[at[0]]), float(BOUNDS[at[-1] + 1])


def planned_cuts(plan: Plan, size: Vector, radii: Mapping[int, float]) -> tuple[PlannedCut, ...]:
    """Take a plan through a fresh block of `size` [m], top at z = 0 of P; of each line the place with most material in the edges.

    `radii`: T number -> radius [m]; 0 stands for numbers that are not there. Lines that cut nothing are left out.
    KeyError if neither a tool nor 0 has a radius.
    """
    times = _samples(plan)
    R = plan.placement.R_BP
    points = (plan.position(times) - np.asarray(plan.placement.p_BP_B)) @ R
    middle = 0.5 * (times[1:] + times[:-1])
    rows = plan.rows(middle)[0]
    tools = rows[:, TOOL].astype(int)
    radius = np.array([radii[t] if t in radii else radii[0] for t in tools])
    lx, ly, lz = size
    spacing = max(float(radius.min()) / CELLS_PER_RADIUS, workpiece.finest_spacing(lx, ly, CELLS))
    nx, ny = workpiece.cells(lx, spacing), workpiece.cells(ly, spacing)
    angle = 0.5 * (BOUNDS[1:] + BOUNDS[:-1])
    depth = np.zeros((len(middle), BINS))
    removed = np.zeros(len(middle))
    block = (np.zeros(nx * ny), np.zeros(nx * ny), np.zeros((workpiece.TRAIL, 3)), nx, ny, lx / nx, ly / ny, -lz)
    loaded(_walk)(*block, points, radius, np.sin(angle), np.cos(angle), depth, removed)
    ways = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    area = np.where(removed > LEAST_REMOVED * 2.0 * radius * depth.max(axis=1) * ways, depth.sum(axis=1), 0.0)
    lines, speeds = rows[:, LINE].astype(int), plan.spindle_speed(middle)
    found = []
    for line in dict.fromkeys(lines[area > 0.0].tolist()):
        own = np.flatnonzero((lines == line) & (area > 0.0))
        i = int(own[np.argmax(area[own])])
        way = points[i + 1] - points[i]
        length = math.hypot(way[0], way[1])
        place, direction = 0.5 * (points[i] + points[i + 1]), way[:2] / length
        feed = length / float(times[i + 1] - times[i])
        found.append(PlannedCut(line, float(middle[i]), place, direction, feed, float(speeds[i]), int(tools[i]), depth[i].copy()))
    return tuple(found)


def _samples(plan: Plan) -> FloatArray:
    """Path times [s] at most `STEP` of way apart, but for rapids of long programs."""
    edges = np.unique(plan.table[:, TAU])
    fine = np.unique(np.concatenate([edges, np.linspace(0.0, plan.duration, 2001)]))
    way = np.linalg.norm(np.diff(plan.position(fine), axis=0), axis=1)
    step = max(STEP, float(way.sum()) / MOST_SAMPLES)
    counts = np.maximum(np.ceil(way / step).astype(int), 1)
    parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(fine[:-1], fine[1:], counts, strict=True)]
    return np.concatenate([*parts, fine[-1:]])


def _walk(
    height: FloatArray,
    lagging: FloatArray,
    trail: FloatArray,
    nx: int,
    ny: int,
    dx: float,
    dy: float,
    bottom: float,
    p: FloatArray,
    radius: FloatArray,
    sines: FloatArray,
    cosines: FloatArray,
    depth: FloatArray,
    removed: FloatArray,
) -> None:
    places = 0
    for k in range(1, len(p)):
        xa, ya, za = p[k - 1, 0], p[k - 1, 1], p[k - 1, 2]
        xb, yb, zb = p[k, 0], p[k, 1], p[k, 2]
        r = radius[k - 1]
        if places > 0 and (za >= 0.0 or r != radius[k - 2]):
            workpiece.settle(lagging, nx, ny, dx, dy, 0.0, bottom, trail, places, xa, ya, za, radius[k - 2])
            places = 0
        length = math.sqrt((xb - xa) ** 2 + (yb - ya) ** 2)
        x, y, z = 0.5 * (xa + xb), 0.5 * (ya + yb), 0.5 * (za + zb)
        if length > 0.0 and z < 0.0 and abs(x) <= 0.5 * nx * dx + r and abs(y) <= 0.5 * ny * dy + r:
            ux, uy = (xb - xa) / length, (yb - ya) / length
            low = bottom - z if bottom > z else 0.0
            workpiece.engagement(
                lagging, nx, ny, dx, dy, trail, places, x, y, z, r, ux, uy, 0.0, low, len(sines), sines, cosines, depth[k - 1]
            )
        removed[k - 1] = workpiece.cut(height, nx, ny, dx, dy, 0.0, bottom, xa, ya, za, xb, yb, zb, r, False)
        if zb < 0.0:
            places = workpiece.follow(lagging, nx, ny, dx, dy, 0.0, bottom, trail, places, xb, yb, zb, r)
