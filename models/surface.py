"""The scanner: how far the machined surface lies from the nominal one.

Nominal part and machined part are both what a flat end mill sweeps: the first along the planned path, the second along
the path that the deflected tool really took. At every point of the nominal walls a ray along the surface normal finds
where the really swept volume ends (discs along the recorded path, exact between the samples), at every point of the
nominal floors its height is compared. Nothing is read off the dexels, so walls are not rounded to a cell. The same
comparison was made in the paper with a structured-light scan (Haehn & Weigold 2020, Figs. 10-13).

Deviation: along the outward normal of the nominal surface, positive where material is left, negative where it is gouged;
material left on a wall is the distance to the nearest real surface (floor and top included) across the path.
Everything in frame P (origin at the centre of the block's top surface, z up), lengths in m. Plain numpy at the surface;
the loops over points and path segments are compiled when Numba is there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from models import workpiece
from models.declaration import FloatArray, Record, kernel
from models.frames import quat_to_matrix

COVER_TOLERANCE = 2e-6
"""A nominal wall point that another pass covers by less than this [m] still counts as wall: a circle made of chords has such."""

CORNER = math.radians(3.0)
"""From this change of direction [rad] on, walls are also measured all around a vertex of the nominal path."""

_FAN = 72
"""Directions in which walls are measured around a vertex or end of the nominal path."""

_SAME_PLACE = 1e-6
"""Positions nearer than this [m] to their predecessor say nothing about direction."""

_ON_THE_WAY = 2e-4
"""Less material than this [m] is not looked at for a nearer surface than the one along the normal."""

_STEEPEST = 1.0
"""Nominal floors steeper than this (45 deg) are steps between passes, not ramps; their normal is taken as vertical."""


@dataclass(frozen=True)
class ToolPath:
    """Where the tool was: time [s] (n,), tip in P [m] (n, 3), tilt (n, 2) = x and y of the unit vector from tip to spindle in P."""

    time: FloatArray
    position: FloatArray
    tilt: FloatArray

    def __post_init__(self) -> None:
        """Refuse paths that do not fit together."""
        n = len(self.time)
        if self.time.shape != (n,) or self.position.shape != (n, 3) or self.tilt.shape != (n, 2):
            raise ValueError(
                f"tool path: time {self.time.shape}, position {self.position.shape}, tilt {self.tilt.shape}; expected (n,), (n, 3), (n, 2)"
            )
        if n < 2:
            raise ValueError(f"tool path: {n} positions; at least 2 are needed")
        for name in ("time", "position", "tilt"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise ValueError(f"tool path: {name} holds values that are not finite")

    @classmethod
    def upright(cls, time: npt.ArrayLike, position: npt.ArrayLike) -> ToolPath:
        """A path with the tool axis along z of P."""
        p = np.ascontiguousarray(position, dtype=np.float64)
        return cls(np.ascontiguousarray(time, dtype=np.float64), p, np.zeros((len(p), 2)))

    @classmethod
    def from_poses(
        cls, time: npt.ArrayLike, p_BT_B: npt.ArrayLike, quat_BT: npt.ArrayLike, p_BP_B: npt.ArrayLike, quat_BP: npt.ArrayLike
    ) -> ToolPath:
        """From tool poses in B (n, 3), (n, 4) and the pose of the workpiece in B; x of T points out of the spindle."""
        R_BP = np.empty((3, 3))
        quat_to_matrix(np.asarray(quat_BP, dtype=np.float64), R_BP)
        position = (np.asarray(p_BT_B, dtype=np.float64) - np.asarray(p_BP_B, dtype=np.float64)) @ R_BP
        w, x, y, z = np.asarray(quat_BT, dtype=np.float64).T
        axis = np.column_stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]) @ R_BP
        tilt = np.ascontiguousarray(-axis[:, :2])
        return cls(np.ascontiguousarray(time, dtype=np.float64), np.ascontiguousarray(position), tilt)


@dataclass(frozen=True)
class SurfaceDeviation:
    """Deviations of a machined surface, n measured points.

    points [m] (n, 3) on the nominal surface in P; normal (n, 3) outward from the material; deviation [m] (n,);
    wall (n,) True for walls, False for floors; path_time [s] (n,) and path_length [m] (n,) of the nominal tool position
    that made the point.
    """

    points: FloatArray
    normal: FloatArray
    deviation: FloatArray
    wall: npt.NDArray[np.bool_]
    path_time: FloatArray
    path_length: FloatArray

    @property
    def kind(self) -> npt.NDArray[np.str_]:
        """What each point lies on, "wall" or "floor"."""
        return np.where(self.wall, "wall", "floor")

    @property
    def max(self) -> float:
        """Largest magnitude [m]."""
        return float(np.max(np.abs(self.deviation)))

    @property
    def rms(self) -> float:
        """Root mean square [m]."""
        return float(np.sqrt(np.mean(self.deviation**2)))

    @property
    def p95(self) -> float:
        """Magnitude [m] that 95 % of the points do not exceed."""
        return float(np.percentile(np.abs(self.deviation), 95.0))

    @property
    def worst(self) -> int:
        """Index of the point with the largest magnitude."""
        return int(np.argmax(np.abs(self.deviation)))

    @property
    def walls(self) -> SurfaceDeviation:
        """The wall points alone."""
        return self.select(self.wall)

    @property
    def floors(self) -> SurfaceDeviation:
        """The floor points alone."""
        return self.select(~self.wall)

    def select(self, chosen: npt.NDArray[np.bool_]) -> SurfaceDeviation:
        """The points where `chosen` (n,) is True. ValueError if there are none."""
        if not np.any(chosen):
            raise ValueError(f"surface: none of the {len(self.deviation)} measured points is selected")
        return SurfaceDeviation(
            self.points[chosen],
            self.normal[chosen],
            self.deviation[chosen],
            self.wall[chosen],
            self.path_time[chosen],
            self.path_length[chosen],
        )


@dataclass(frozen=True)
class HeightMap:
    """Top heights of a workpiece: x [m] (nx,), y [m] (ny,) of the cell centres, height [m] (ny, nx), all in P."""

    x: FloatArray
    y: FloatArray
    height: FloatArray

    def minus(self, nominal: HeightMap) -> FloatArray:
        """Height above the nominal one [m] (ny, nx), positive where material is left. ValueError if the cells differ."""
        if self.height.shape != nominal.height.shape or not (np.allclose(self.x, nominal.x) and np.allclose(self.y, nominal.y)):
            raise ValueError(
                f"height maps of {self.height.shape} and {nominal.height.shape} cells do not lie on each other; use one block and spacing"
            )
        difference: FloatArray = self.height - nominal.height
        return difference


# ---------------------------------------------------------------- height maps
def cut_height_map(path: ToolPath, radius: float, block_size: npt.ArrayLike, spacing: float) -> HeightMap:
    """The block after a cutter of `radius` [m] has gone along `path`: the same dexels as in milling_force, any number of them."""
    lx, ly, lz = (float(v) for v in np.asarray(block_size, dtype=np.float64))
    nx, ny = workpiece.cells(lx, spacing), workpiece.cells(ly, spacing)
    height = np.zeros(nx * ny)
    _compiled(_cut_all)(height, nx, ny, lx / nx, ly / ny, -lz, path.position, radius)
    return _map(height, nx, ny, lx / nx, ly / ny)


def height_map_of(s: Record) -> HeightMap:
    """The workpiece as it stands in the record of a milling_force instance."""
    nx, ny = int(s.nx), int(s.ny)
    return _map(np.array(s.height[: nx * ny]), nx, ny, float(s.dx), float(s.dy))


def _map(height: FloatArray, nx: int, ny: int, dx: float, dy: float) -> HeightMap:
    x = np.asarray((np.arange(nx) + 0.5 - 0.5 * nx) * dx, dtype=np.float64)
    y = np.asarray((np.arange(ny) + 0.5 - 0.5 * ny) * dy, dtype=np.float64)
    return HeightMap(x, y, height.reshape(ny, nx))


def _cut_all(height: FloatArray, nx: int, ny: int, dx: float, dy: float, bottom: float, p: FloatArray, radius: float) -> None:
    for i in range(len(p)):
        j = i - 1 if i > 0 else 0
        workpiece.cut(height, nx, ny, dx, dy, 0.0, bottom, p[j, 0], p[j, 1], p[j, 2], p[i, 0], p[i, 1], p[i, 2], radius, i > 0)


# ---------------------------------------------------------------- scan
def measure(
    nominal: ToolPath,
    actual: ToolPath,
    radius: float,
    block_size: npt.ArrayLike,
    spacing: float = 5e-4,
    levels: tuple[float, ...] = (0.25, 0.75),
    floor_offsets: tuple[float, ...] = (-0.5, 0.0, 0.5),
    reach: float = 4e-3,
    actual_radius: float | None = None,
) -> SurfaceDeviation:
    """Compare what the tool really cut with what the nominal path would have cut.

    `spacing` [m] along the nominal path; walls at `levels` of their height (0 = floor, 1 = top of the block); floors at
    `floor_offsets` of the radius beside the path; deviations beyond +-`reach` [m] are cut off there (below the radius).
    The two paths need not share their time base. ValueError if the nominal path makes no surface in the block.
    """
    size = np.asarray(block_size, dtype=np.float64)
    if size.shape != (3,) or np.any(size <= 0.0):
        raise ValueError(f"block_size {size}: expected three positive lengths in m")
    if not 0.0 < reach < radius:
        raise ValueError(f"reach {reach} m: expected more than 0 and less than the radius of the cutter, {radius} m")
    if not spacing > 0.0:
        raise ValueError(f"spacing {spacing} m: expected more than 0")
    own = radius if actual_radius is None else actual_radius
    planned, cut = _segments(nominal, radius, size), _segments(actual, own, size)
    stations = _stations(nominal, radius, size, spacing)
    parts = [
        _walls(stations, planned, cut, radius, own, size, levels, reach),
        _floors(stations, planned, cut, radius, own, size, floor_offsets),
    ]
    columns = [np.concatenate([part[i] for part in parts]) for i in range(6)]
    if len(columns[2]) == 0:
        low, high = nominal.position.min(axis=0), nominal.position.max(axis=0)
        raise ValueError(f"surface: the nominal path makes no surface in the block of {size} m; it spans {low} to {high} m in P")
    return SurfaceDeviation(*columns)


@dataclass(frozen=True)
class _Stations:
    """Places on the nominal path from which the surface is measured."""

    position: FloatArray
    direction: FloatArray
    slope: FloatArray
    time: FloatArray
    length: FloatArray
    fan: npt.NDArray[np.bool_]


def _segments(path: ToolPath, radius: float, size: FloatArray) -> FloatArray:
    """Path segments that can meet the block, (n, 10): both ends as x, y, z, tilt x, tilt y."""
    rows = np.hstack([path.position[:-1], path.tilt[:-1], path.position[1:], path.tilt[1:]])
    low = np.minimum(rows[:, :3], rows[:, 5:8])
    high = np.maximum(rows[:, :3], rows[:, 5:8])
    reach = radius + 0.1 * size[2]  # a tool tilted by up to 0.1 rad
    near = (low[:, 2] < 0.0) & np.all(low[:, :2] < 0.5 * size[:2] + reach, axis=1) & np.all(high[:, :2] > -0.5 * size[:2] - reach, axis=1)
    return np.ascontiguousarray(rows[near])


def _stations(path: ToolPath, radius: float, size: FloatArray, spacing: float) -> _Stations:
    """Stations every `spacing` of horizontal way, and one at each corner and end of a horizontal stretch or plunge."""
    p, time = path.position, path.time
    keep = [0]
    for i in range(1, len(p)):
        if np.abs(p[i] - p[keep[-1]]).max() >= _SAME_PLACE:
            keep.append(i)
    p, time = p[keep], time[keep]
    if len(p) < 2:
        return _Stations(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, bool))
    step = np.diff(p, axis=0)
    way = np.hypot(step[:, 0], step[:, 1])
    level = way > 0.1 * np.abs(step[:, 2])  # steeper than this is a plunge: no side walls, only its fan
    direction = np.zeros((len(step), 2))
    direction[level] = step[level, :2] / way[level, None]
    length = np.concatenate([[0.0], np.cumsum(way)])
    # along the stretches
    s = (np.arange(int(length[-1] / spacing)) + 0.5) * spacing
    k = np.clip(np.searchsorted(length, s, side="right") - 1, 0, len(step) - 1)
    s, k = s[level[k]], k[level[k]]
    u = ((s - length[k]) / way[k])[:, None]
    along = p[k] + u * step[k]
    # at vertices
    before, after = np.vstack([[0.0, 0.0], direction]), np.vstack([direction, [0.0, 0.0]])
    turns = np.einsum("ij,ij->i", before, after) < math.cos(CORNER)
    moves = np.any(before != 0.0, axis=1) | np.any(after != 0.0, axis=1)
    fall = np.concatenate([[-1.0], step[:, 2]]) < 0.0
    rise = np.concatenate([step[:, 2], [1.0]]) > 0.0
    vertex = turns & (moves | (fall & rise))  # a plunge has one at its bottom only
    position = np.vstack([along, p[vertex]])
    at = time[k] + u[:, 0] * np.diff(time)[k]
    result = _Stations(
        position,
        np.vstack([direction[k], after[vertex]]),
        np.concatenate([step[k, 2] / way[k], np.zeros(vertex.sum())]),
        np.concatenate([at, time[vertex]]),
        np.concatenate([s, length[vertex]]),
        np.concatenate([np.zeros(len(along), bool), np.ones(vertex.sum(), bool)]),
    )
    inside = (position[:, 2] < 0.0) & np.all(np.abs(position[:, :2]) < 0.5 * size[:2] + radius, axis=1)
    return _Stations(
        result.position[inside],
        result.direction[inside],
        result.slope[inside],
        result.time[inside],
        result.length[inside],
        result.fan[inside],
    )


_Part = tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_], FloatArray, FloatArray]


def _walls(
    at: _Stations,
    planned: FloatArray,
    cut: FloatArray,
    radius: float,
    own_radius: float,
    size: FloatArray,
    levels: tuple[float, ...],
    reach: float,
) -> _Part:
    """Wall points: left and right of the way, and all around vertices; those that the nominal path removes again are dropped."""
    angles = np.arange(_FAN) * 2 * np.pi / _FAN
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    left = np.column_stack([-at.direction[:, 1], at.direction[:, 0]])
    way, fan = np.flatnonzero(~at.fan), np.flatnonzero(at.fan)
    index = np.concatenate([way, way, np.repeat(fan, _FAN)])
    outward = np.vstack([left[way], -left[way], np.tile(circle, (len(fan), 1))])
    index, outward = np.tile(index, len(levels)), np.tile(outward, (len(levels), 1))
    level = np.repeat(np.asarray(levels, dtype=np.float64), len(index) // len(levels) if levels else 0)
    bottom = np.maximum(at.position[index, 2], -size[2])
    points = np.column_stack([at.position[index, :2] + radius * outward, bottom * (1.0 - level)])
    inside = np.all(np.abs(points[:, :2]) < 0.5 * size[:2], axis=1)
    index, outward, points = index[inside], outward[inside], points[inside]
    stays = np.zeros(len(points), dtype=np.bool_)
    _compiled(_uncovered)(points, planned, radius - COVER_TOLERANCE, stays)
    index, outward, points = index[stays], outward[stays], np.ascontiguousarray(points[stays])
    end = np.zeros(len(points))
    _compiled(_ray_ends)(points, np.ascontiguousarray(outward), cut, own_radius, reach, np.zeros((max(len(cut), 1), 2)), end)
    normal = np.column_stack([-outward, np.zeros(len(points))])
    deviation = _nearest(points, outward, -end, cut, own_radius, reach)
    return points, normal, deviation, np.ones(len(points), dtype=np.bool_), at.time[index], at.length[index]


def _nearest(points: FloatArray, outward: FloatArray, left: FloatArray, cut: FloatArray, radius: float, reach: float) -> FloatArray:
    """Material left on walls as the distance to the nearest real surface, which may be a floor or the top above the point.

    `left` [m] is what stands along the normal. Where the tool did not come down to a point (a ramp that it was lifted
    off), the next wall at that height can be far away though the floor is near.
    """
    result = left.copy()
    for inward in np.linspace(0.0, reach, 17):
        near = np.flatnonzero(result > max(inward, _ON_THE_WAY))
        if len(near) == 0:
            break
        floor = np.zeros(len(near))
        _compiled(_lowest)(np.ascontiguousarray(points[near, :2] - inward * outward[near]), cut, radius, floor)
        above = np.maximum(np.minimum(floor, 0.0) - points[near, 2], 0.0)
        result[near] = np.minimum(result[near], np.hypot(inward, above))
    return result


def _floors(
    at: _Stations, planned: FloatArray, cut: FloatArray, radius: float, own_radius: float, size: FloatArray, offsets: tuple[float, ...]
) -> _Part:
    """Floor points under the way: height really cut against nominal height, along the normal of the nominal floor."""
    way = np.flatnonzero(~at.fan)
    left = np.column_stack([-at.direction[way, 1], at.direction[way, 0]])
    index = np.tile(way, len(offsets))
    shift = np.vstack([np.zeros((0, 2)), *(offset * radius * left for offset in offsets)])
    points = np.column_stack([at.position[index, :2] + shift, np.zeros(len(index))])
    inside = np.all(np.abs(points[:, :2]) < 0.5 * size[:2], axis=1)
    index, points = index[inside], points[inside]
    lowest = _compiled(_lowest)
    ahead = 5e-5 * at.direction[index]
    around = []
    for side in (0.0, 1.0, -1.0):
        height = np.zeros(len(points))
        lowest(np.ascontiguousarray(points[:, :2] + side * ahead), planned, radius, height)
        around.append(np.minimum(height, 0.0))
    points[:, 2] = around[0]
    real = (points[:, 2] < 0.0) & (points[:, 2] > -size[2])
    slope = (around[1] - around[2]) / 1e-4
    slope[np.abs(slope) > _STEEPEST] = 0.0
    vertical = 1.0 / np.hypot(1.0, slope)
    height = np.zeros(len(points))
    lowest(np.ascontiguousarray(points[:, :2]), cut, own_radius, height)
    height = np.clip(height, -size[2], 0.0)
    normal = np.column_stack([-(slope * vertical)[:, None] * at.direction[index], vertical])
    deviation = (height - points[:, 2]) * vertical
    return (
        points[real],
        normal[real],
        deviation[real],
        np.zeros(int(real.sum()), dtype=np.bool_),
        at.time[index][real],
        at.length[index][real],
    )


# ---------------------------------------------------------------- loops over points and segments
@cache
def _compiled(function: Callable[..., None]) -> Callable[..., None]:
    """The function compiled by Numba, or as it is without Numba."""
    try:
        from numba import njit
    except ImportError:
        return function
    from models.cache import compiled_code

    with compiled_code(function):
        fast: Any = njit(cache=True, nogil=True, error_model="numpy")(function)
    result: Callable[..., None] = fast
    return result


@kernel
def _ends_at(row: FloatArray, z: float) -> tuple[float, float, float, float, bool]:
    """Both ends (x, y) of the axis at height z of the part of a segment whose tip is below z; False if there is none."""
    za, zb = row[2], row[7]
    xa = row[0] + row[3] * (z - za)
    ya = row[1] + row[4] * (z - za)
    xb = row[5] + row[8] * (z - zb)
    yb = row[6] + row[9] * (z - zb)
    if za > z and zb > z:
        return xa, ya, xb, yb, False
    if za > z:
        t = (za - z) / (za - zb)
        xa += t * (xb - xa)
        ya += t * (yb - ya)
    elif zb > z:
        t = (zb - z) / (zb - za)
        xb += t * (xa - xb)
        yb += t * (ya - yb)
    return xa, ya, xb, yb, True


def _uncovered(points: FloatArray, rows: FloatArray, radius: float, stays: npt.NDArray[np.bool_]) -> None:
    """Set stays[i] where no segment sweeps the point within `radius` of its axis."""
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        stays[i] = True
        for k in range(len(rows)):
            xa, ya, xb, yb, cuts = _ends_at(rows[k], z)
            if not cuts or min(xa, xb) - x > radius or x - max(xa, xb) > radius or min(ya, yb) - y > radius or y - max(ya, yb) > radius:
                continue
            ux, uy = xb - xa, yb - ya
            length2 = ux * ux + uy * uy
            t = 0.0
            if length2 > 0.0:
                t = min(max(((x - xa) * ux + (y - ya) * uy) / length2, 0.0), 1.0)
            dx, dy = x - xa - t * ux, y - ya - t * uy
            if dx * dx + dy * dy < radius * radius:
                stays[i] = False
                break


def _ray_ends(
    points: FloatArray, outward: FloatArray, rows: FloatArray, radius: float, reach: float, spans: FloatArray, end: FloatArray
) -> None:
    """Set end[i] [m] to where the swept volume, followed from -reach outward along the ray through point i, ends (at most +reach).

    Each segment sweeps an interval of the ray (`spans` is scratch, (segments, 2)); the intervals that hang together count.
    """
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        ex, ey = outward[i, 0], outward[i, 1]
        count = 0
        for k in range(len(rows)):
            xa, ya, xb, yb, cuts = _ends_at(rows[k], z)
            far = radius + reach
            if not cuts or min(xa, xb) - x > far or x - max(xa, xb) > far or min(ya, yb) - y > far or y - max(ya, yb) > far:
                continue
            low, high = _span(xa - x, ya - y, xb - x, yb - y, ex, ey, radius)
            if low <= high and high > -reach and low < reach:
                spans[count, 0] = low
                spans[count, 1] = high
                count += 1
        s = -reach
        grows = True
        while grows and s < reach:
            grows = False
            for k in range(count):
                if spans[k, 0] <= s + 1e-12 and spans[k, 1] > s:
                    s = spans[k, 1]
                    grows = True
        end[i] = min(s, reach)


@kernel
def _span(xa: float, ya: float, xb: float, yb: float, ex: float, ey: float, radius: float) -> tuple[float, float]:
    """Interval of s in which the ray s (ex, ey) is inside the stadium of `radius` around a-b; low > high if it misses.

    The stadium is convex: the extremes of its two discs and of the rectangle between them.
    """
    low, high = 1e30, -1e30
    for px, py in ((xa, ya), (xb, yb)):
        middle = px * ex + py * ey
        across = px * ey - py * ex
        half2 = radius * radius - across * across
        if half2 >= 0.0:
            half = math.sqrt(half2)
            low = min(low, middle - half)
            high = max(high, middle + half)
    ux, uy = xb - xa, yb - ya
    length = math.sqrt(ux * ux + uy * uy)
    if length > 1e-15:
        ux /= length
        uy /= length
        start, stop = -1e30, 1e30
        # coordinates of the ray along the segment (0..length) and across it (-radius..radius): origin + s * rate
        for origin, rate, least, most in (
            (-(xa * ux + ya * uy), ex * ux + ey * uy, 0.0, length),
            (xa * uy - ya * ux, ey * ux - ex * uy, -radius, radius),
        ):
            if abs(rate) > 1e-15:
                s0, s1 = (least - origin) / rate, (most - origin) / rate
                start = max(start, min(s0, s1))
                stop = min(stop, max(s0, s1))
            elif origin < least or origin > most:
                stop = start - 1.0
        if start <= stop:
            low = min(low, start)
            high = max(high, stop)
    return low, high


def _lowest(points: FloatArray, rows: FloatArray, radius: float, height: FloatArray) -> None:
    """Set height[i] [m] to the lowest the tip was while the cutter covered point i; +inf where it never did."""
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        lowest = math.inf
        for k in range(len(rows)):
            xa, ya, xb, yb = rows[k, 0], rows[k, 1], rows[k, 5], rows[k, 6]
            if min(xa, xb) - x > radius or x - max(xa, xb) > radius or min(ya, yb) - y > radius or y - max(ya, yb) > radius:
                continue
            if min(rows[k, 2], rows[k, 7]) >= lowest:
                continue
            ux, uy = xb - xa, yb - ya
            wx, wy = x - xa, y - ya
            a = ux * ux + uy * uy
            rest = wx * wx + wy * wy - radius * radius
            t0, t1 = 0.0, 1.0
            if a > 1e-30:
                b = wx * ux + wy * uy
                root = b * b - a * rest
                if root < 0.0:
                    continue
                root = math.sqrt(root)
                t0, t1 = max((b - root) / a, 0.0), min((b + root) / a, 1.0)
                if t0 > t1:
                    continue
            elif rest > 0.0:
                continue
            dz = rows[k, 7] - rows[k, 2]
            lowest = min(lowest, rows[k, 2] + min(t0 * dz, t1 * dz))
        height[i] = lowest
