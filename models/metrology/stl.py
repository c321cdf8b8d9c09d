"""Triangles in STL files, binary and ASCII: stock in, machined part out.

STL knows no unit; `unit` says what one is worth in m (1e-3: millimetres).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from robomill.models.model.declaration import FloatArray

_HEAD = 80
_COUNT = 4
_FACET = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_CORNER = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
SMALLEST, LARGEST = 2e-3, 5.0
"""Largest extent [m] that a stock for a milling robot has at least and at most; beyond, its unit is another."""


class StlError(ValueError):
    """A file that is no closed solid, or not in the unit that was said; the text names it and says what is expected."""


def read_stl(file: str | Path, unit: float = 1e-3) -> FloatArray:
    """Triangles (n, 3, 3) [m] of an STL file of a closed solid whose coordinates are in `unit` [m].

    StlError: no STL, ends early, not finite, open (edges that only one triangle has), inside out, or of a size that another unit
    explains. FileNotFoundError if there is none.
    """
    path = Path(file)
    triangles = read_triangles(path) * unit
    extent = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    if not SMALLEST <= extent <= LARGEST:
        others = {"millimetres": 1e-3, "inches": 0.0254, "metres": 1.0, "micrometres": 1e-6}
        fits = [f"{name} ({extent / unit * size:g} m)" for name, size in others.items() if SMALLEST <= extent / unit * size <= LARGEST]
        raise StlError(
            f"{path}: the solid is {extent:g} m long in a unit of {unit:g} m; expected {SMALLEST:g} to {LARGEST:g} m; "
            f"it would fit in {', '.join(fits) or 'no usual unit'}: give its unit"
        )
    loose = open_edges(triangles)
    if loose:
        raise StlError(f"{path}: the surface is not closed: {loose} edges belong to one triangle only; mend the mesh")
    if solid_volume(triangles) <= 0.0:
        raise StlError(f"{path}: the triangles face inwards (volume {solid_volume(triangles):g} m3); turn them round")
    return triangles


def read_triangles(path: Path) -> FloatArray:
    """Triangles (n, 3, 3) of an STL file as they are written, closed or not: in its unit.

    StlError: no STL, ends early, or not finite. FileNotFoundError if there is none.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no STL file {path}")
    triangles = _triangles(path)
    if not np.all(np.isfinite(triangles)):
        raise StlError(f"{path}: has coordinates that are not finite; export the solid anew")
    return triangles


def _triangles(path: Path) -> FloatArray:
    data = path.read_bytes()
    if len(data) >= _HEAD + _COUNT:
        count = int.from_bytes(data[_HEAD : _HEAD + _COUNT], "little")
        if len(data) == _HEAD + _COUNT + count * _FACET.itemsize and count > 0:
            return np.frombuffer(data, _FACET, count, _HEAD + _COUNT)["corners"].astype(np.float64)
    if not data.lstrip().lower().startswith(b"solid"):
        raise StlError(f"{path}: is no STL file, or a binary one that ends early ({len(data)} bytes); export the solid as STL")
    try:
        corners = np.array([tuple(map(float, m)) for m in _CORNER.findall(data)], dtype=np.float64)
    except ValueError as error:
        raise StlError(f"{path}: {error} in a line 'vertex x y z'; export the solid anew") from None
    if len(corners) == 0 or len(corners) % 3:
        raise StlError(f"{path}: ASCII with {len(corners)} lines 'vertex x y z'; expected three for each triangle")
    return corners.reshape(-1, 3, 3)


def write_stl(file: str | Path, triangles: npt.ArrayLike, unit: float = 1e-3) -> None:
    """Write triangles (n, 3, 3) [m] as binary STL with coordinates in `unit` [m]."""
    corners = np.asarray(triangles, dtype=np.float64) / unit
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facets = np.zeros(len(corners), _FACET)
    facets["corners"] = corners
    facets["normal"] = normal / np.where(length > 0.0, length, 1.0)
    head = b"robomill".ljust(_HEAD) + len(corners).to_bytes(_COUNT, "little")
    Path(file).write_bytes(head + facets.tobytes())


def solid_volume(triangles: FloatArray) -> float:
    """Volume [m3] inside of closed triangles (n, 3, 3) [m]; negative if they face inwards."""
    return float(np.einsum("ij,ij->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])) / 6.0)


def open_edges(triangles: FloatArray) -> int:
    """Number of edges that are not run through as often one way as the other: 0 for a closed surface."""
    corner = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3).astype(np.int64)
    begin, end = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    count = int(corner.max()) + 1
    way = np.where(begin < end, 1, -1)[begin != end]
    key = (np.minimum(begin, end) * count + np.maximum(begin, end))[begin != end]
    place = np.unique(key, return_inverse=True)[1]
    return int(np.count_nonzero(np.bincount(place, way)))
