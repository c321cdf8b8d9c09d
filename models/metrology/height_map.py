"""Height maps of a machined block, for pictures and volumes: the same dexels as in milling_force, any number of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from robomill.models.metrology.tool_path import ToolPath
from robomill.models.model.compiled import compiled
from robomill.models.model.declaration import FloatArray
from robomill.models.process import dexels as workpiece


@dataclass(frozen=True)
class HeightMap:
    """Top heights of a workpiece: x [m] (nx,), y [m] (ny,) of the cell centres, height [m] (ny, nx), all in P."""

    x: FloatArray
    y: FloatArray
    height: FloatArray


def cut_height_map(path: ToolPath, block_size: npt.ArrayLike, spacing: float) -> HeightMap:
    """The block of `block_size` [m] (3,) after the cutter has gone along `path`, in cells of at most `spacing` [m]."""
    lx, ly, lz = (float(v) for v in np.asarray(block_size, dtype=np.float64))
    nx, ny = workpiece.cells(lx, spacing), workpiece.cells(ly, spacing)
    dx, dy = lx / nx, ly / ny
    height = np.zeros(nx * ny)
    compiled(_cut_all)(height, nx, ny, dx, dy, -lz, path.position, path.radius)
    x = np.asarray((np.arange(nx) + 0.5 - 0.5 * nx) * dx, dtype=np.float64)
    y = np.asarray((np.arange(ny) + 0.5 - 0.5 * ny) * dy, dtype=np.float64)
    return HeightMap(x, y, height.reshape(ny, nx))


def _cut_all(height: FloatArray, nx: int, ny: int, dx: float, dy: float, bottom: float, p: FloatArray, radius: FloatArray) -> None:
    for i in range(len(p)):
        j = i - 1 if i > 0 else 0
        there = i > 0 and radius[i] == radius[j]
        workpiece.cut(height, nx, ny, dx, dy, 0.0, bottom, p[j, 0], p[j, 1], p[j, 2], p[i, 0], p[i, 1], p[i, 2], radius[i], there)
