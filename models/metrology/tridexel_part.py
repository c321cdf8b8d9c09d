"""A workpiece of tri-dexels outside of its component: cut along a path, closed surface of triangles, volume, distance from another.

The surface goes through the ends of the dexels. Between eight neighbouring cell centres, each in or out of material, it is
one or more loops over the edges of a cube (marching cubes; where a face is ambiguous, material there is apart), so it
is closed whatever is cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from robomill.models.model.compiled import compiled
from robomill.models.model.declaration import FloatArray
from robomill.models.process import dexels, tridexels

IntArray = npt.NDArray[np.int64]

SEGMENTS = 2
"""Intervals that a line has room for at first."""
GROWTH = 4
"""Room for all lines, over that at first: what is not used takes no memory."""
MORE = 100000
"""And so much more, for small parts of many walls."""
CLEAR = 1e-3
"""The surface stays this part of a cell away from cell centres, so that no two corners of triangles fall together in a file."""


@dataclass(frozen=True)
class Part:
    """Tri-dexels of a stock: see `models.process.tridexels` for the meaning of the fields."""

    pool: IntArray
    cells: IntArray
    origin: FloatArray
    pitch: FloatArray
    tick: float
    segments: int

    @classmethod
    def block(cls, low: npt.ArrayLike, high: npt.ArrayLike, spacing: float, segments: int = SEGMENTS) -> Part:
        """A block from its lower to its upper corner [m] in P, in cells of at most `spacing` [m]."""
        part = cls._empty(np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64), spacing, segments)
        compiled(_fill_box)(part.pool, part.cells, part.pitch, part.tick, part.segments)
        return part

    @classmethod
    def solid(cls, triangles: npt.ArrayLike, spacing: float, segments: int = SEGMENTS) -> Part:
        """The inside of closed triangles (n, 3, 3) [m]. ValueError if they are not closed, or have too many walls."""
        rows = np.ascontiguousarray(triangles, dtype=np.float64).reshape(-1, tridexels.COLUMNS)
        corners = rows.reshape(-1, 3)
        part = cls._empty(corners.min(axis=0), corners.max(axis=0), spacing, segments)
        found = compiled(_fill_solid)(part.pool, part.cells, part.origin, part.pitch, part.tick, part.segments, rows.ctypes.data, len(rows))
        if found:
            what = "it has more walls than there is room for" if found == 1 else "the surface is not closed"
            raise ValueError(f"solid of {len(rows)} triangles: {what}")
        return part

    @classmethod
    def _empty(cls, low: FloatArray, high: FloatArray, spacing: float, segments: int) -> Part:
        extent = high - low
        if low.shape != (3,) or high.shape != (3,) or not np.all(extent > 0.0) or not spacing > 0.0:
            raise ValueError(f"stock from {low} to {high} m in cells of {spacing} m: expected three positive lengths")
        cells = np.array([dexels.cells(float(length), spacing) for length in extent], dtype=np.int64)
        room = int(cells[0] * cells[1] + cells[1] * cells[2] + cells[2] * cells[0]) * segments * GROWTH + MORE
        pitch = np.asarray(extent / cells, dtype=np.float64)
        return cls(np.zeros(room, dtype=np.int64), cells, low.copy(), pitch, float(extent.max()) / tridexels.TICKS, segments)

    def cut(
        self,
        tip: npt.ArrayLike,
        axis: npt.ArrayLike,
        radius: float | FloatArray,
        corner: float | FloatArray,
        reach: float,
        turning: npt.ArrayLike = True,
    ) -> None:
        """Take out what the cutter fills along its path: tip (n, 3) [m], axis (n, 3) from tip to spindle, radii [m] one or (n,).

        Where the radii change the tool is another, which begins where it is. `reach` [m]: length of the cutter along its axis;
        `turning` (n,): where the spindle turns. ValueError where the part has more walls than there is room for.
        """
        p, a = (np.ascontiguousarray(v, dtype=np.float64) for v in (tip, axis))
        r, c = (np.ascontiguousarray(np.broadcast_to(v, len(p)), dtype=np.float64) for v in (radius, corner))
        on = np.ascontiguousarray(np.broadcast_to(np.asarray(turning, dtype=np.uint8), len(p)))
        done = compiled(_cut_all)(self.pool, self.cells, self.origin, self.pitch, self.tick, self.segments, p, a, r, c, on, reach)
        if not done:
            raise ValueError(f"tri-dexels: the part needs more than {len(self.pool)} intervals; give more segments or a larger spacing")

    def volumes(self) -> FloatArray:
        """Volume [m3] by the lines along x, y and z (3,): three estimates of one thing."""
        lengths = np.zeros(3)
        compiled(_lengths)(self.pool, self.cells, self.segments, lengths)
        areas = (self.pitch[1] * self.pitch[2], self.pitch[2] * self.pitch[0], self.pitch[0] * self.pitch[1])
        result: FloatArray = lengths * self.tick * np.array(areas)
        return result

    def tops(self) -> FloatArray:
        """Upper end of the material on each line along z, float64[ny, nx] m in P; NaN where there is none."""
        tops = np.zeros((int(self.cells[1]), int(self.cells[0])))
        compiled(_tops)(self.pool, self.cells, self.segments, tops)
        result: FloatArray = np.where(tops > 0.0, self.origin[2] + self.tick * tops, np.nan)
        return result

    def surface(self) -> FloatArray:
        """The closed surface as triangles (n, 3, 3) [m] in P, facing outwards; empty if there is no material."""
        corners, triangles = self.mesh()
        return corners[triangles]

    def mesh(self) -> tuple[FloatArray, IntArray]:
        """Corners (m, 3) [m] in P and triangles (n, 3) of the closed surface: numbers of their corners."""
        inside = np.zeros(self.cells + 2, dtype=np.uint8)
        compiled(_inside)(self.pool, self.cells, self.pitch, self.tick, self.segments, inside)
        nx, ny, nz = (int(n) + 1 for n in self.cells)
        code = np.zeros((nx, ny, nz), dtype=np.uint8)
        for bit, (a, b, c) in enumerate(_CORNERS):
            code |= inside[a : a + nx, b : b + ny, c : c + nz] << bit
        keys: list[IntArray] = []
        centres: list[IntArray] = []
        base = 0
        shape = self.cells + 2
        for number in np.unique(code):
            places = np.argwhere(code == number)
            for loop in _loops(int(number)):
                # the number of a grid edge: its lower end and its direction
                ends = [places + _CORNERS[_EDGES[e][0]] for e in loop]
                ids = np.stack(
                    [((at[:, 0] * shape[1] + at[:, 1]) * shape[2] + at[:, 2]) * 3 + _EDGES[e][2] for at, e in zip(ends, loop, strict=True)],
                    axis=1,
                )
                if len(loop) <= _WITHOUT_CENTRE:
                    keys.extend(np.stack([ids[:, 0], ids[:, k], ids[:, k + 1]], axis=1) for k in range(1, len(loop) - 1))
                else:
                    centres.append(ids)
                    own = -1 - (base + np.arange(len(ids)))
                    base += len(ids)
                    keys.extend(np.stack([own, ids[:, k], ids[:, (k + 1) % len(loop)]], axis=1) for k in range(len(loop)))
        if not keys:
            return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
        triangles = np.concatenate(keys)
        used = np.unique(np.concatenate([triangles[triangles >= 0], *(c.ravel() for c in centres)]))
        corners = np.empty((len(used), 3))
        compiled(_ends)(self.pool, self.cells, self.origin, self.pitch, self.tick, self.segments, used, corners, CLEAR)
        middles = [corners[np.searchsorted(used, c)].mean(axis=1) for c in centres]
        numbered = np.where(triangles >= 0, np.searchsorted(used, np.maximum(triangles, 0)), len(used) - 1 - triangles)
        return np.concatenate([corners, *middles]), numbered


@dataclass(frozen=True)
class Deviation:
    """How far a machined surface lies from a nominal one: points (n, 3) [m] of it, normals (n, 3), deviation [m] (n,).

    `beside` (n,): on or beside an edge, where the nearest machined surface is another one. Positive: material is left.
    """

    points: FloatArray
    normal: FloatArray
    deviation: FloatArray
    beside: npt.NDArray[np.bool_]


SAME_SURFACE = 0.7
"""Cosine between normals from which on two surfaces are one."""
EVEN = 0.97
"""Length of the sum of the areas about a corner over the sum of their sizes, below which the corner is on an edge (28 degrees)."""
SAME_PLACE = 1e-9
"""Distance [m] within which two corners are one."""
_LOOKED_AT = 4
"""Machined corners about a point, one of which is compared with it."""


def compare(nominal: Part, actual: Part, raw: Part) -> Deviation:
    """Deviation of `actual` at the corners of the triangles of `nominal` that the tool made, along the normal of the machined surface.

    `raw`: the stock, in the same cells; what is still its surface is not compared. ValueError if nothing is left, or nothing cut.
    """
    corners, triangles = nominal.mesh()
    other, others = actual.mesh()
    if len(triangles) == 0 or len(others) == 0:
        raise ValueError("there is no surface to compare: nothing is left of the part")
    cut = cKDTree(raw.mesh()[0]).query(corners, distance_upper_bound=SAME_PLACE)[0] > SAME_PLACE
    if not np.any(cut):
        raise ValueError("there is no surface to compare: nothing of the stock is cut")
    normal, even = corner_normals(corners, triangles)
    their, even_there = corner_normals(other, others)
    corners, normal, even = corners[cut], normal[cut], even[cut]
    nearest = cKDTree(other).query(corners, k=min(_LOOKED_AT, len(other)))[1].reshape(len(corners), -1)
    # of the nearest corners the one whose surface faces as the nominal one does
    alike = np.einsum("nkj,nj->nk", their[nearest], normal)
    chosen = nearest[np.arange(len(corners)), np.argmax(alike, axis=1)]
    way = np.einsum("nj,nj->n", other[chosen] - corners, their[chosen])
    return Deviation(corners, normal, way, (alike.max(axis=1) < SAME_SURFACE) | (even < EVEN) | (even_there[chosen] < EVEN))


def corner_normals(corners: FloatArray, triangles: IntArray) -> tuple[FloatArray, FloatArray]:
    """Unit normals (m, 3) at the corners (m, 3) of triangles (n, 3), weighted by area, and how even the surface is there (m,), 1 = flat."""
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    size = np.linalg.norm(area, axis=1)
    at = triangles.ravel()
    total = np.stack([np.bincount(at, np.repeat(area[:, i], 3), len(corners)) for i in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1)
    sizes = np.bincount(at, np.repeat(size, 3), len(corners))
    there = np.where(length > 0.0, length, 1.0)
    return total / there[:, None], length / np.where(sizes > 0.0, sizes, 1.0)


# ---------------------------------------------------------------- loops over the edges of a cube
_CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1), (1, 1, 1)])
_EDGES = tuple((a, a + (1 << k), k) for k in range(3) for a in range(8) if not a & (1 << k))
"""Lower corner, upper corner and direction of the twelve edges."""
_FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
"""Corners of the faces, counter-clockwise from outside."""
_WITHOUT_CENTRE = 4
"""Loops of so many edges are triangulated from one of them, longer ones from their middle."""


@cache
def _loops(code: int) -> tuple[Sequence[int], ...]:
    """The loops of the surface over the edges of a cube whose corners are inside where a bit is set, counter-clockwise from outside."""
    number = {frozenset(e[:2]): i for i, e in enumerate(_EDGES)}
    follows: dict[int, int] = {}
    for face in _FACES:
        inside = [bool(code >> corner & 1) for corner in face]
        edges = [number[frozenset((face[i], face[(i + 1) % 4]))] for i in range(4)]
        for i in range(4):
            if inside[i] and not inside[(i + 1) % 4]:  # the run of inside corners that ends here begins at edge j
                j = i
                while inside[j]:
                    j = (j - 1) % 4
                follows[edges[j]] = edges[i]
    loops = []
    while follows:
        first = next(iter(follows))
        loop = [first]
        while (edge := follows.pop(loop[-1])) != first:
            loop.append(edge)
        loops.append(tuple(loop))
    return tuple(loops)


# ---------------------------------------------------------------- compiled loops
def _fill_box(pool: IntArray, cells: IntArray, pitch: FloatArray, tick: float, segments: int) -> None:
    tridexels.clear(pool, cells, segments)
    tridexels.fill_box(pool, cells, pitch, tick, segments)


def _fill_solid(
    pool: IntArray, cells: IntArray, origin: FloatArray, pitch: FloatArray, tick: float, segments: int, address: int, rows: int
) -> int:
    tridexels.clear(pool, cells, segments)
    return tridexels.fill_solid(pool, cells, origin, pitch, tick, segments, address, rows, 0.0)


def _cut_all(
    pool: IntArray,
    cells: IntArray,
    origin: FloatArray,
    pitch: FloatArray,
    tick: float,
    segments: int,
    p: FloatArray,
    a: FloatArray,
    r: FloatArray,
    c: FloatArray,
    on: npt.NDArray[np.uint8],
    reach: float,
) -> bool:
    tip = np.zeros(3)
    axis = np.zeros(3)
    point = np.zeros(3)
    found = np.zeros(4)
    for i in range(len(p)):
        if on[i] == 0:
            continue
        same = i > 0 and on[i - 1] != 0 and r[i] == r[i - 1] and c[i] == c[i - 1]
        j = i - 1 if same else i
        if not tridexels.sweep(
            pool, cells, origin, pitch, tick, segments, p[j], a[j], p[i], a[i], same, r[i], c[i], reach, tip, axis, point, found
        ):
            return False
    return True


def _lengths(pool: IntArray, cells: IntArray, segments: int, lengths: FloatArray) -> None:
    for k in range(3):
        first = tridexels.line_of(cells, k, 0, 0, 0)
        for n in range(cells[(k + 1) % 3] * cells[(k + 2) % 3]):
            at, room = tridexels.block(pool, tridexels.word_of(first + n, segments), segments)
            for i in range(room):
                word = pool[at + i]
                lengths[k] += (word & tridexels.LOWER) - (word >> 32)


def _tops(pool: IntArray, cells: IntArray, segments: int, tops: FloatArray) -> None:
    for y in range(cells[1]):
        for x in range(cells[0]):
            at, room = tridexels.block(pool, tridexels.word_of(tridexels.line_of(cells, 2, x, y, 0), segments), segments)
            for i in range(room):
                tops[y, x] = max(tops[y, x], float(pool[at + i] & tridexels.LOWER))


def _inside(pool: IntArray, cells: IntArray, pitch: FloatArray, tick: float, segments: int, inside: npt.NDArray[np.uint8]) -> None:
    for x in range(cells[0]):
        for y in range(cells[1]):
            for z in range(cells[2]):
                if tridexels.centre_distance(pool, cells, pitch, tick, segments, x, y, z) > 0.0:
                    inside[x + 1, y + 1, z + 1] = 1


def _ends(
    pool: IntArray,
    cells: IntArray,
    origin: FloatArray,
    pitch: FloatArray,
    tick: float,
    segments: int,
    keys: IntArray,
    out: FloatArray,
    clear: float,
) -> None:
    for m in range(len(keys)):
        k = keys[m] % 3
        z = keys[m] // 3 % (cells[2] + 2) - 1
        y = keys[m] // 3 // (cells[2] + 2) % (cells[1] + 2) - 1
        x = keys[m] // 3 // (cells[2] + 2) // (cells[1] + 2) - 1
        n = x if k == 0 else (y if k == 1 else z)
        low = (n + 0.5) * pitch[k]
        first = tridexels.word_of(tridexels.line_of(cells, k, x, y, z), segments)
        place = tridexels.surface_between(pool, first, segments, int(low / tick), int((low + pitch[k]) / tick) + 1) * tick
        place = min(max(place, low + clear * pitch[k]), low + (1.0 - clear) * pitch[k])
        out[m, 0] = origin[0] + (x + 0.5) * pitch[0]
        out[m, 1] = origin[1] + (y + 0.5) * pitch[1]
        out[m, 2] = origin[2] + (z + 0.5) * pitch[2]
        out[m, k] = origin[k] + place
