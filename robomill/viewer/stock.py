"""The part in a page: how high it stands when, cell by cell, and how far its surface is off, point by point."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from robomill.cell import part
from robomill.cell.evaluation import tool_radius
from robomill.cell.scenario import Workpiece
from robomill.models.metrology.surface import NothingCutError, measure
from robomill.models.metrology.tool_path import ToolPath
from robomill.models.model.declaration import FloatArray
from robomill.viewer.recorded import Recorded

CELLS = 30_000
"""Cells of the part, about: so many pixels does it have on a screen side by side with others."""
FINEST = 4e-4
"""Size of a cell [m] below which nobody sees the difference."""
LEVELS = 65_000
"""Heights from the bottom of the block to its top that are told apart; 0 is none."""
STEP = 5e-5
"""Height [m] by which a cell is lower before that is written down; what is left is, at the end."""
PATCHES = 30_000
"""Points of the surface that are coloured, at most."""
_NEIGHBOURS = 4
"""Nearest points, the point itself among them, that the size of a patch is taken from."""


@dataclass(frozen=True)
class Stock:
    """A block of nx x ny cells, and what happens to their heights, in the order of time.

    Height = low + level / LEVELS * (high - low); level 0: nothing is there.
    """

    shape: tuple[int, int]
    """ny, nx."""
    low: FloatArray
    """Lower corner of the box in P [3] m."""
    high: FloatArray
    start: npt.NDArray[np.uint16]
    """Levels before the first cut [ny * nx]."""
    frame: npt.NDArray[np.uint16]
    """Kept sample of each change."""
    cell: npt.NDArray[np.uint32]
    """Cell that changes."""
    level: npt.NDArray[np.uint16]
    """Its level from then on."""
    cutter: float
    """Largest radius [m] of the tools."""


@dataclass(frozen=True)
class Patches:
    """Points of the machined surface in P, in the order in which they were made, and how far off they are."""

    point: FloatArray
    """[n, 3] m, on the machined surface."""
    normal: FloatArray
    deviation: FloatArray
    """[n] m, positive: material is left."""
    time: FloatArray
    """[n] s."""
    size: float
    """Edge [m] of a patch, so that they meet."""


def cut_stock(recorded: Recorded, workpiece: Workpiece) -> Stock:
    """The part as tri-dexels, cut from kept sample to kept sample along every recorded pose; the tops of its lines are the heights."""
    run = recorded.run
    tip, axis = part.tool_motion(run, workpiece, recorded.tool)
    if part.is_tridexel(run):
        radius, corner, reach = part.tools(run)
    else:  # flat end mills, that cut as high as the block is
        radius, corner, reach = tool_radius(run), np.zeros(len(run)), 2.0 * workpiece.size[2]
    on = run["path.spindle_speed"] > 0.0 if "path.spindle_speed" in run else np.ones(len(run), dtype=np.bool_)
    lx, ly, _ = workpiece.size
    block = part.raw_part(run, workpiece, max(math.sqrt(lx * ly / CELLS), FINEST))
    low, high = block.origin, block.origin + block.cells * block.pitch

    def levels() -> npt.NDArray[np.int64]:
        share = (block.tops() - low[2]) / (high[2] - low[2])
        return np.where(np.isnan(share), 0, np.maximum(1, np.rint(LEVELS * share))).astype(np.int64).ravel()

    start = shown = levels()
    least = LEVELS * STEP / (high[2] - low[2])
    changes: list[tuple[int, npt.NDArray[np.int64], npt.NDArray[np.int64]]] = []
    kept = recorded.kept
    for k in range(1, len(kept)):
        piece = slice(kept[k - 1], kept[k] + 1)
        block.cut(tip[piece], axis[piece], radius[piece], corner[piece], reach, on[piece])
        now = levels()
        cells = np.flatnonzero(shown - now > (least if k + 1 < len(kept) else 0))
        if len(cells):
            shown = shown.copy()
            shown[cells] = now[cells]
            changes.append((k, cells, now[cells]))
    none = np.zeros(0, dtype=np.int64)
    return Stock(
        shape=(int(block.cells[1]), int(block.cells[0])),
        low=low,
        high=high,
        start=start.astype(np.uint16),
        frame=np.concatenate([none, *(np.full(len(c), k) for k, c, _ in changes)]).astype(np.uint16),
        cell=np.concatenate([none, *(c for _, c, _ in changes)]).astype(np.uint32),
        level=np.concatenate([none, *(v for _, _, v in changes)]).astype(np.uint16),
        cutter=float(np.max(radius)),
    )


def patches(recorded: Recorded, workpiece: Workpiece) -> Patches | None:
    """Where the machined surface is how far off, as `robomill run` measures it; None where nothing was cut, or no path is planned.

    Points beside edges count in no figure and are left out. Of more than PATCHES points every n-th is kept, and the worst.
    """
    if recorded.planned is None:
        return None
    run = recorded.run
    try:
        if part.is_tridexel(run):
            found = part.scan(run, workpiece)
        else:
            nominal, actual = (_path(recorded, workpiece, poses) for poses in (recorded.planned, recorded.tool))
            found = measure(nominal, actual, workpiece.size)
    except NothingCutError:
        return None
    if np.all(found.edge):
        return None
    found = found.features
    chosen = np.zeros(len(found.points), dtype=np.bool_)
    chosen[:: -(-len(chosen) // PATCHES)] = True
    chosen[found.worst] = True
    shown = found.select(chosen)
    order = np.argsort(shown.path_time, kind="stable")
    point = shown.points + shown.normal * shown.deviation[:, None]
    far = cKDTree(point).query(point, k=min(_NEIGHBOURS, len(point)))[0].reshape(len(point), -1)
    return Patches(point[order], shown.normal[order], shown.deviation[order], shown.path_time[order], float(np.median(far[:, -1])))


def _path(recorded: Recorded, workpiece: Workpiece, poses: str) -> ToolPath:
    tip, axis = part.tool_motion(recorded.run, workpiece, poses)
    return ToolPath(recorded.run.t, np.ascontiguousarray(tip), np.ascontiguousarray(axis[:, :2]), tool_radius(recorded.run))
