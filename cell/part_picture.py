"""The machined part in space, coloured by its deviation, from a milling run with tri-dexels."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, TwoSlopeNorm
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]  # the toolkit has no types
from scipy.spatial import cKDTree

from robomill.cell.part import WALL, cut_part
from robomill.cell.scenario import Workpiece
from robomill.models.metrology.surface import SurfaceDeviation
from robomill.orchestration.runs.run import Run

DRAWN = 1.2e-3
"""Distance of the lines [m]: finer than can be seen."""
VIEW = (35.0, -60.0)
"""Elevation and azimuth [deg] of the eye."""
ZOOM = 1.15
PLAIN = 0.78
"""Grey of what is not machined."""
DARKEST = 0.55
"""Share of a colour that is left where the light does not fall."""


def draw(run: Run, workpiece: Workpiece, surface: SurfaceDeviation | None, title: str) -> Figure:
    """The machined part in space, coloured by its deviation where it is machined."""
    part = cut_part(run, workpiece, spacing=DRAWN)
    corners, triangles = part.mesh()
    figure = Figure(figsize=(8.5, 5.0), layout="constrained")
    ax: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    faces = corners[triangles]
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.where(size > 0.0, size, 1.0)
    colours = np.full((len(faces), 3), PLAIN)
    limit = 1e3 * surface.max if surface is not None and not np.all(surface.edge) else 0.0
    norm = TwoSlopeNorm(0.0, -(limit or 1.0), limit or 1.0)
    if surface is not None and limit > 0.0:
        chosen = ~surface.edge
        far, nearest = cKDTree(surface.points[chosen]).query(faces.mean(axis=1))
        alike = np.einsum("nj,nj->n", surface.normal[chosen][nearest], normal) > WALL
        machined = (far < 2.0 * DRAWN) & alike
        mapped = ScalarMappable(norm, "RdBu_r")
        colours[machined] = mapped.to_rgba(1e3 * surface.deviation[chosen][nearest[machined]])[:, :3]
        figure.colorbar(mapped, ax=ax, shrink=0.7, pad=0.08).set_label("deviation in mm (red: material left, blue: gouged)")
    light = LightSource(azdeg=300, altdeg=50)
    shade = light.shade_normals(normal, fraction=1.0)
    ax.add_collection3d(
        Poly3DCollection(1e3 * faces, facecolors=colours * (DARKEST + (1.0 - DARKEST) * shade[:, None]), linewidths=0, antialiased=False)
    )
    low, high = 1e3 * corners.min(axis=0), 1e3 * corners.max(axis=0)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]), xlabel="x in mm", ylabel="y in mm", zlabel="z in mm")
    ax.set_box_aspect(high - low, zoom=ZOOM)
    ax.locator_params(axis="z", nbins=3)
    ax.view_init(*VIEW)
    ax.set_title(title, fontsize=10)
    return figure
