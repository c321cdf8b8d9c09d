"""Points of the surface that a planned path leaves in a block: the walls and floors of the nominal part.

From stations along the path: walls at the cutter's radius to the left and right, and around corners and ends; floors under the
cutter. What another pass takes away again is left out, and each patch of the surface counts once however often the path passes.
Everything in frame P (origin at the centre of the block's top surface, z up), lengths in m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from robomill.models.metrology.swept_volume import SweptVolume
from robomill.models.metrology.tool_path import ToolPath
from robomill.models.model.declaration import FloatArray

COVER_TOLERANCE = 2e-6
"""A wall point that another pass covers by less than this [m] still counts as wall: a circle made of chords has such."""

LEAST_DEPTH = 1e-6
"""A floor less deep than this [m] is no cut: the roundoff of a path that runs on the top of the block."""

_SAME_PLACE = 1e-6
"""Positions nearer than this [m] to their predecessor say nothing about direction."""

_ACROSS = 2.0
"""How many times further apart points are up a wall and across a floor than along the path: there the deviation changes less."""

_ROWS = 16
"""Largest number of points up a wall and across a floor."""

_STEEPEST = 1.0
"""Floors steeper than this (45 deg) are steps between passes, not ramps; their normal is taken as vertical."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points [m] (n, 3) on a surface in P, outward normals (n, 3), whether on a wall (n,); time [s] and way [m] (n,) of the tool there."""

    points: FloatArray
    normal: FloatArray
    wall: npt.NDArray[np.bool_]
    time: FloatArray
    length: FloatArray

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)

    def select(self, chosen: npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> SurfacePoints:
        """The chosen points."""
        return SurfacePoints(self.points[chosen], self.normal[chosen], self.wall[chosen], self.time[chosen], self.length[chosen])

    @classmethod
    def joined(cls, *parts: SurfacePoints) -> SurfacePoints:
        """All points of `parts`."""
        columns = (np.concatenate([getattr(part, name) for part in parts]) for name in ("points", "normal", "wall", "time", "length"))
        return cls(*columns)


@dataclass(frozen=True)
class _Stations:
    """Places on a path from which its surface is seen; `start` and `turn` [rad] are the arc of wall directions around a corner."""

    position: FloatArray
    tilt: FloatArray
    radius: FloatArray
    direction: FloatArray
    time: FloatArray
    length: FloatArray
    start: FloatArray
    turn: FloatArray

    def select(self, chosen: npt.NDArray[np.bool_]) -> _Stations:
        return _Stations(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def surface_points(path: ToolPath, volume: SweptVolume, size: FloatArray, spacing: float) -> SurfacePoints:
    """Points of the walls and floors that `path`, which sweeps `volume`, leaves in a block of `size` [m] (3,), every `spacing` [m]."""
    along, around = _stations(path, size, spacing)
    walls = SurfacePoints.joined(_side_walls(along, size, spacing), _corner_walls(around, size, spacing))
    walls = _inside(walls, size)
    walls = walls.select(volume.covers(walls.points, COVER_TOLERANCE) == 0.0)
    # passes a whole diameter apart touch: what is between them is no wall
    walls = walls.select(volume.covers(walls.points - 2.0 * COVER_TOLERANCE * walls.normal, 0.0) == 0.0)
    return _once(SurfacePoints.joined(walls, _floors(along, around, volume, size, spacing)), size, spacing)


def floor_points(path: ToolPath, volume: SweptVolume, size: FloatArray, spacing: float, beside: SweptVolume) -> SurfacePoints:
    """The points of the floors alone, and of these only what lies `beside` another volume, not under it or in it."""
    along, around = _stations(path, size, spacing)
    # a recorded path trembles: it has corners everywhere, whose floors are those along it
    return _floors(along, around.select(np.zeros(len(around.time), dtype=np.bool_)), volume, size, spacing, beside)


def _floors(
    along: _Stations, around: _Stations, volume: SweptVolume, size: FloatArray, spacing: float, beside: SweptVolume | None = None
) -> SurfacePoints:
    """Points under the cutter, across the whole of it and around corners and ends; where it cuts through, at the bottom of the block."""
    across, share = _spread(np.minimum(_ROWS, np.ceil(2.0 * along.radius / (_ACROSS * spacing))).astype(int))
    left = np.column_stack([-along.direction[:, 1], along.direction[:, 0]])
    straight = along.position[across, :2] + ((2.0 * share - 1.0) * along.radius[across])[:, None] * left[across]
    sector, turned = _spread(np.ceil(np.abs(around.turn) * around.radius / (_ACROSS * spacing)).astype(int))
    ray, out = _spread(np.minimum(_ROWS, np.ceil(around.radius[sector] / (_ACROSS * spacing))).astype(int))
    sector, turned = sector[ray], turned[ray]
    angle = around.start[sector] + turned * around.turn[sector]
    round_ = around.position[sector, :2] + (out * around.radius[sector])[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    xy = np.vstack([straight, round_])
    xyz = np.column_stack([xy, np.full(len(xy), -LEAST_DEPTH)])
    time, length = (np.concatenate([getattr(along, name)[across], getattr(around, name)[sector]]) for name in ("time", "length"))
    points = SurfacePoints(xyz, np.zeros((len(xy), 3)), np.zeros(len(xy), dtype=np.bool_), time, length)
    points = _once(_inside(points, size), size, spacing)
    if beside is not None:
        points = points.select(beside.covers(points.points, 0.0) == 0.0)
    height, slope = volume.bottom(points.points[:, :2])
    slope[np.hypot(*slope.T) > _STEEPEST] = 0.0
    slope[height < -size[2]] = 0.0
    normal = np.column_stack([-slope, np.ones(len(slope))]) / np.hypot(1.0, np.hypot(*slope.T))[:, None]
    xyz = np.column_stack([points.points[:, :2], np.maximum(height, -size[2])])
    found = SurfacePoints(xyz, normal, points.wall, points.time, points.length)
    return found.select(height < -LEAST_DEPTH)


def _stations(path: ToolPath, size: FloatArray, spacing: float) -> tuple[_Stations, _Stations]:
    """Stations every `spacing` of horizontal way, and those at corners, ends and plunges; only where the tool is in the block."""
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.position, axis=0), axis=1))])
    keep = np.flatnonzero(np.diff(np.floor(gone / _SAME_PLACE), prepend=-1.0) > 0.0)
    p, tilt, radius, time = path.position[keep], path.tilt[keep], path.radius[keep], path.time[keep]
    step = np.diff(p, axis=0)
    way = np.hypot(step[:, 0], step[:, 1])
    level = way > 0.1 * np.abs(step[:, 2])  # steeper than this is a plunge: no side walls, only those around it
    direction = np.zeros((len(step), 2))
    direction[level] = step[level, :2] / way[level, None]
    length = np.concatenate([[0.0], np.cumsum(way)])

    s = spacing * np.arange(0.5, float(int(length[-1] / spacing)), dtype=np.float64)
    k = np.clip(np.searchsorted(length, s, side="right") - 1, 0, max(0, len(step) - 1))
    s, k = (s[level[k]], k[level[k]]) if len(step) else (s[:0], k[:0])
    u = (s - length[k]) / way[k]
    none = np.zeros(len(s))
    along = _Stations(
        p[k] + u[:, None] * step[k],
        tilt[k] + u[:, None] * np.diff(tilt, axis=0)[k],
        radius[k],
        direction[k],
        time[k] + u * np.diff(time)[k],
        s,
        none,
        none,
    )

    before, after = np.vstack([[0.0, 0.0], direction]), np.vstack([direction, [0.0, 0.0]])
    comes, goes = np.any(before != 0.0, axis=1), np.any(after != 0.0, axis=1)
    heading = np.arctan2(after[:, 1], after[:, 0]), np.arctan2(before[:, 1], before[:, 0])
    turn = (heading[0] - heading[1] + np.pi) % (2 * np.pi) - np.pi
    start = heading[1] - np.copysign(0.5 * np.pi, turn)  # the outer side of the corner
    only_goes, only_comes = goes & ~comes, comes & ~goes
    start[only_goes], turn[only_goes] = heading[0][only_goes] + 0.5 * np.pi, np.pi
    start[only_comes], turn[only_comes] = heading[1][only_comes] - 0.5 * np.pi, np.pi
    fall = np.concatenate([[-1.0], step[:, 2]]) < 0.0
    rise = np.concatenate([step[:, 2], [1.0]]) > 0.0
    plunge = ~comes & ~goes & fall & rise  # at its bottom only
    start[plunge], turn[plunge] = 0.0, 2 * np.pi
    vertex = plunge | ((comes | goes) & (np.abs(turn) * radius > spacing))
    around = _Stations(p, tilt, radius, after, time, length, start, turn).select(vertex)
    return _in_block(along, size), _in_block(around, size)


def _in_block(at: _Stations, size: FloatArray) -> _Stations:
    return at.select((at.position[:, 2] < -LEAST_DEPTH) & np.all(np.abs(at.position[:, :2]) < 0.5 * size[:2] + at.radius[:, None], axis=1))


def _side_walls(at: _Stations, size: FloatArray, spacing: float) -> SurfacePoints:
    """Wall points to the left and right of the way."""
    left = np.column_stack([-at.direction[:, 1], at.direction[:, 0]])
    every = np.arange(len(at.time))
    return _up_the_wall(at, np.concatenate([every, every]), np.vstack([left, -left]), size, spacing)


def _corner_walls(at: _Stations, size: FloatArray, spacing: float) -> SurfacePoints:
    """Wall points around corners, ends and plunges."""
    index, share = _spread(np.ceil(np.abs(at.turn) * at.radius / spacing).astype(int))
    angle = at.start[index] + share * at.turn[index]
    return _up_the_wall(at, index, np.column_stack([np.cos(angle), np.sin(angle)]), size, spacing)


def _up_the_wall(at: _Stations, index: npt.NDArray[np.intp], outward: FloatArray, size: FloatArray, spacing: float) -> SurfacePoints:
    """Points from the floor to the top of the block in the directions `outward` (n, 2) from the stations `index` (n,)."""
    bottom = np.maximum(at.position[index, 2], -size[2])
    column, share = _spread(np.minimum(_ROWS, np.ceil(-bottom / (_ACROSS * spacing))).astype(int))
    index, outward, z = index[column], outward[column], bottom[column] * (1.0 - share)
    axis = at.position[index, :2] + at.tilt[index] * (z - at.position[index, 2])[:, None]
    points = np.column_stack([axis + at.radius[index, None] * outward, z])
    normal = np.column_stack([-outward, np.zeros(len(z))])
    return SurfacePoints(points, normal, np.ones(len(z), dtype=np.bool_), at.time[index], at.length[index])


def _spread(counts: npt.NDArray[np.intp]) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """For `counts` (n,) points each: whose they are and at which share, the middles of equal parts of 0..1."""
    index = np.repeat(np.arange(len(counts)), counts)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    return index, (np.arange(len(index)) - first + 0.5) / counts[index]


def _inside(points: SurfacePoints, size: FloatArray) -> SurfacePoints:
    return points.select(np.all(np.abs(points.points[:, :2]) < 0.5 * size[:2], axis=1))


def _once(points: SurfacePoints, size: FloatArray, spacing: float) -> SurfacePoints:
    """One point, the one made last, for each cube of `spacing` and kind of surface facing the same way."""
    cube = np.floor((points.points + size) / spacing).astype(np.int64)
    facing = np.round(2.0 * points.normal[:, :2]).astype(np.int64) + 2  # the two sides of a thin wall are two surfaces
    key = points.wall.astype(np.int64)
    for digit, base in ((facing[:, 0], 5), (facing[:, 1], 5), *((cube[:, i], int(2.0 * size[i] / spacing) + 2) for i in range(3))):
        key = key * base + digit
    _, last = np.unique(key[::-1], return_index=True)
    return points.select(np.sort(len(points) - 1 - last))
