"""The surface that a tilted face cutter leaves, and its error against the plane that was programmed: what a laser sensor scans.

Unlike the dexels of the process models, which take the cutter as parallel to z of P, the tilt counts here: at a radius of 37.5 mm a
robot that bends by 1 mrad leaves 0.04 mm more on one side of the cutter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robomill.models.metrology.tool_path import ToolPath
from robomill.models.model.declaration import FloatArray

WAY = 0.5e-3
"""Way of the tool [m] between two imprints of its end face; a flat one errs by WAY^2 / (8 R) at its rim, 1 nm at 37.5 mm."""


@dataclass(frozen=True)
class FacedSurface:
    """Error of a faced surface: x [m] (nx,), y [m] (ny,) of the points in P, error [m] (ny, nx), positive where it is too deep.

    NaN where the cutter has not been, or there is no material.
    """

    x: FloatArray
    y: FloatArray
    error: FloatArray

    @property
    def mean(self) -> float:
        """Mean error [m]."""
        return float(np.nanmean(self.error))

    @property
    def touch(self) -> float:
        """Error of the highest point [m]: where a tool that comes closer touches first."""
        return float(np.nanmin(self.error))

    @property
    def clean(self) -> float:
        """Error of the deepest point [m]: where the last paint is cleaned."""
        return float(np.nanmax(self.error))

    @property
    def total(self) -> float:
        """From touch to clean [m]."""
        return self.clean - self.touch

    def along(self, y: float) -> FloatArray:
        """Error [m] (nx,) in the row of points nearest to y [m]."""
        row: FloatArray = self.error[int(np.argmin(np.abs(self.y - y)))]
        return row

    def where(self, material: FloatArray) -> FacedSurface:
        """The points in which `material` (ny, nx) is not zero."""
        return FacedSurface(self.x, self.y, np.where(material != 0.0, self.error, np.nan))


def beside_openings(x: FloatArray, y: FloatArray, diameter: float, pitch: tuple[float, float]) -> FloatArray:
    """1 where there is material, 0 in the round openings of `face_milling_force`, (ny, nx): `diameter` and `pitch` in m, as there."""
    u = x - pitch[0] * (np.floor(x / pitch[0]) + 0.5)
    v = y - pitch[1] * (np.floor(y / pitch[1]) + 0.5)
    return np.where(u[None, :] ** 2 + v[:, None] ** 2 < 0.25 * diameter**2, 0.0, 1.0)


def faced_surface(path: ToolPath, size: tuple[float, float], plane: float, spacing: float) -> FacedSurface:
    """Error of the surface that the end face of the cutter leaves on its `path`, against the plane z = `plane` [m] of P.

    Height at r: minimum over the path of z_T - t . (r - r_T) / sqrt(1 - t^2) for |r - r_T| <= R, t the tilt.

    Parameters: `size` [m] (2,) of the surface about the origin of P, `spacing` [m] of the points.
    Errors: ValueError if the cutter never comes near the plane: nothing is faced.
    """
    x, y = (np.linspace(-0.5 * length, 0.5 * length, max(2, round(length / spacing) + 1)) for length in size)
    height = np.full((len(y), len(x)), np.inf)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.position[:, :2], axis=0), axis=1))])
    samples = np.searchsorted(way, np.arange(0.0, way[-1], WAY))
    for i in np.unique(samples):
        (px, py, pz), (tx, ty), radius = path.position[i], path.tilt[i], path.radius[i]
        columns, rows = np.flatnonzero(np.abs(x - px) <= radius), np.flatnonzero(np.abs(y - py) <= radius)
        if len(columns) == 0 or len(rows) == 0:
            continue
        part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        dx, dy = x[None, part[1]] - px, y[part[0], None] - py
        face = pz - (tx * dx + ty * dy) / np.sqrt(1.0 - tx * tx - ty * ty)
        height[part] = np.where(dx * dx + dy * dy <= radius * radius, np.minimum(height[part], face), height[part])
    faced = height < 0.5 * plane
    if not np.any(faced):
        raise ValueError(
            f"faced surface: the cutter never comes near the plane z = {plane:g} m within {size[0]:g} x {size[1]:g} m; check the depth"
        )
    return FacedSurface(np.asarray(x), np.asarray(y), np.where(faced, plane - height, np.nan))
