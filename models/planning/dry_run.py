"""What a program does to its block by geometry alone: how deep each move stands in material. No forces, no robot, no process."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robomill.models.model.compiled import loaded
from robomill.models.model.declaration import FloatArray, kernel
from robomill.models.planning.gcode import Arc, Move, Vector
from robomill.models.process import dexels as workpiece

CELLS = 1_000_000
"""Cells that the block is divided into at most."""
CELLS_PER_RADIUS = 6.0
"""Cells that the radius of the smallest tool is resolved by, where `CELLS` allows."""
_CHORD = 0.05
"""Largest distance of a chord from its arc, as a share of a cell."""


@dataclass(frozen=True)
class DryRun:
    """What each move does to the block."""

    moves: tuple[Move, ...]
    depth: FloatArray
    """(n,) height of the material over the tip of the tool [m], the largest along the move; 0 in air.

    Under a tool that is smaller by the diagonal of a cell: the cells at the edge of a cut are cut in part.
    """
    removed: FloatArray
    """(n,) volume [m3]."""
    below: float
    """Length [m] of the feed moves whose tip is below the top of the block."""
    beside: float
    """Length [m] of those of them that are clear of the block's sides from end to end: runs in and out are not."""


def dry_run(moves: Sequence[Move], size: Vector, radii: Mapping[int, float]) -> DryRun:
    """Take `moves` through a fresh block of `size` [m], top at z = 0 of P; `radii`: T number -> radius [m].

    KeyError if a move has a tool without a radius.
    """
    lx, ly, lz = size
    smallest = min(radii[tool] for tool in {m.tool for m in moves})
    spacing = max(smallest / CELLS_PER_RADIUS, workpiece.finest_spacing(lx, ly, CELLS))
    nx, ny = workpiece.cells(lx, spacing), workpiece.cells(ly, spacing)
    points, owner = _points(moves, spacing)
    radius = np.array([radii[m.tool] for m in moves])
    feeds = np.array([m.feed is not None for m in moves])
    depth, removed, below, near = np.zeros(len(moves)), np.zeros(len(moves)), np.zeros(len(moves)), np.zeros(len(moves))
    loaded(_mill)(np.zeros(nx * ny), nx, ny, lx / nx, ly / ny, -lz, points, owner, radius, feeds, depth, removed, below, near)
    return DryRun(tuple(moves), depth, removed, float(np.sum(below)), float(np.sum(below[near == 0.0])))


def _points(moves: Sequence[Move], spacing: float) -> tuple[FloatArray, FloatArray]:
    """Corners of the path [m] (k, 3), and the move that leads to each (k,); each move begins with its start."""
    points: list[Vector] = []
    owner: list[int] = []
    for i, move in enumerate(moves):
        points.append(move.start)
        if isinstance(move, Arc):
            points += _chords(move, spacing)
        points.append(move.end)
        owner += [i] * (len(points) - len(owner))
    return np.array(points), np.array(owner)


def _chords(arc: Arc, spacing: float) -> list[Vector]:
    """Points on an arc between its ends."""
    start, centre, axis = np.array(arc.start), np.array(arc.centre), np.array(arc.axis)
    out = start - centre
    climb = float((np.array(arc.end) - start) @ axis)
    radius = float(np.linalg.norm(out))
    step = 2.0 * math.acos(max(1.0 - _CHORD * spacing / radius, 0.0)) if radius > 0.0 else math.pi
    count = math.ceil(abs(arc.angle) / min(step, 0.5 * math.pi))
    share = np.arange(1, count)[:, None] / count
    turned = np.cos(share * arc.angle) * out + np.sin(share * arc.angle) * np.cross(axis, out)
    return [(float(x), float(y), float(z)) for x, y, z in centre + turned + share * climb * axis]


def _mill(
    height: FloatArray,
    nx: int,
    ny: int,
    dx: float,
    dy: float,
    bottom: float,
    p: FloatArray,
    owner: FloatArray,
    radius: FloatArray,
    feeds: FloatArray,
    depth: FloatArray,
    removed: FloatArray,
    below: FloatArray,
    near: FloatArray,
) -> None:
    cell = dx if dx < dy else dy
    margin = math.sqrt(dx * dx + dy * dy)
    for k in range(1, len(p)):
        i = owner[k]
        if owner[k - 1] != i:
            continue
        xa, ya, za = p[k - 1, 0], p[k - 1, 1], p[k - 1, 2]
        xb, yb, zb = p[k, 0], p[k, 1], p[k, 2]
        length = math.sqrt((xb - xa) ** 2 + (yb - ya) ** 2 + (zb - za) ** 2)
        pieces = math.floor(length / cell) + 1
        r = radius[i]
        for n in range(pieces + 1):
            t = n / pieces
            x, y, z = xa + t * (xb - xa), ya + t * (yb - ya), za + t * (zb - za)
            deep = _deepest(height, nx, ny, dx, dy, bottom, x, y, z, r - margin)
            depth[i] = max(depth[i], deep)
            if feeds[i] and z < 0.0:
                if n > 0:
                    below[i] += length / pieces
                if abs(x) <= 0.5 * nx * dx + r and abs(y) <= 0.5 * ny * dy + r:
                    near[i] = 1.0
        removed[i] += workpiece.cut(height, nx, ny, dx, dy, 0.0, bottom, xa, ya, za, xb, yb, zb, r, False)


@kernel
def _deepest(
    height: FloatArray, nx: int, ny: int, dx: float, dy: float, bottom: float, x: float, y: float, z: float, radius: float
) -> float:
    """Largest height [m] of material over the tip of a tool at a point."""
    deepest = 0.0
    tip = z if z > bottom else bottom
    if tip >= 0.0:
        return deepest
    first_x = max(math.ceil((x - radius) / dx + 0.5 * nx - 0.5), 0)
    last_x = min(math.floor((x + radius) / dx + 0.5 * nx - 0.5), nx - 1)
    first_y = max(math.ceil((y - radius) / dy + 0.5 * ny - 0.5), 0)
    last_y = min(math.floor((y + radius) / dy + 0.5 * ny - 0.5), ny - 1)
    for iy in range(first_y, last_y + 1):
        v = (iy + 0.5 - 0.5 * ny) * dy - y
        for ix in range(first_x, last_x + 1):
            u = (ix + 0.5 - 0.5 * nx) * dx - x
            over = height[iy * nx + ix] - tip
            if over > deepest and u * u + v * v <= radius * radius:
                deepest = over
    return deepest if deepest > workpiece.LEAST_DEPTH else 0.0
