"""How far the machined surface lies from the nominal one, as a coordinate measuring machine would say it.

Nominal part and machined part are the block without what a flat end mill sweeps: along the planned path, and along the path that
the deflected tool really took. Both are compared exactly (models/metrology/swept_volume.py); nothing is read off the dexels. The deviation
is the shortest distance between the two surfaces, one way where material is left and the other way where it is gouged:

- left: from a point of the nominal surface (models/metrology/nominal_surface.py) to the nearest point that the tool really reached;
- gouged: from the machined surface behind that point (below a floor, into a wall) to the nearest point of the nominal surface.

So no deviation is larger than the error of the tool that made it. The nearest point must lie on the same feature: in the
direction of the normal within FEATURE. Where it does not, the point is next to an edge or corner, within about the local
deviation of it, and the distance belongs to another wall or floor. Such edge points are marked and count in no figure but
their own.

The measure has one limit: where a thin wall or the rim of the block is gone altogether, no machined surface is left to measure
to. The deviation is then at least half of the wall's thickness, or the whole way to the side of the block; such points are
marked as limited.

Deviation: along the outward normal of the nominal surface, positive where material is left, negative where it is gouged.
Everything in frame P (origin at the centre of the block's top surface, z up), lengths in m. After the comparison with
ISO 1101 (profile of a surface) and the structured-light scan of Haehn & Weigold 2020 (Figs. 10-13).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from robomill.models.metrology.nominal_surface import COVER_TOLERANCE, SurfacePoints, floor_points, surface_points
from robomill.models.metrology.swept_volume import SweptVolume
from robomill.models.metrology.tool_path import ToolPath
from robomill.models.model.declaration import FloatArray

FEATURE = math.cos(math.radians(45.0))
"""Cosine between normal and direction of the nearest point from which on both are one feature: halfway between wall and floor."""

FINEST = 8.0
"""Points per radius of the smallest cutter, so that small tools are not measured too coarsely."""

SPACING = 5e-4
"""Distance [m] between the points of a surface along the path, unless the tool needs them closer: when the cutter leaves the
block, the force falls within a millimetre of way."""


@dataclass(frozen=True)
class SurfaceDeviation:
    """Deviations of a machined surface at n points.

    points [m] (n, 3) on the nominal surface in P; normal (n, 3) outward from the material; deviation [m] (n,);
    wall (n,) True for walls, False for floors; edge (n,) True beside edges and corners; limited (n,) True where the deviation
    is at least what it says; path_time [s] (n,) and path_length [m] (n,) of the nominal tool position that made the point.
    Figures are those of the points that are not beside an edge.
    """

    points: FloatArray
    normal: FloatArray
    deviation: FloatArray
    wall: npt.NDArray[np.bool_]
    edge: npt.NDArray[np.bool_]
    limited: npt.NDArray[np.bool_]
    path_time: FloatArray
    path_length: FloatArray

    @property
    def kind(self) -> npt.NDArray[np.str_]:
        """What each point lies on, "wall" or "floor"."""
        return np.where(self.wall, "wall", "floor")

    @property
    def features(self) -> SurfaceDeviation:
        """The points that are not beside an edge. ValueError if there are none."""
        return self.select(~self.edge)

    @property
    def walls(self) -> SurfaceDeviation:
        """Those of `features` on walls. ValueError if there are none."""
        return self.select(self.wall & ~self.edge)

    @property
    def floors(self) -> SurfaceDeviation:
        """Those of `features` on floors. ValueError if there are none."""
        return self.select(~self.wall & ~self.edge)

    @property
    def max(self) -> float:
        """Largest magnitude [m]; see `is_limited`."""
        return float(abs(self.deviation[self.worst]))

    @property
    def is_limited(self) -> bool:
        """Whether the largest magnitude is only known to be at least `max`: somewhere a limit of the measure was met."""
        return bool(np.any(self.limited & ~self.edge))

    @property
    def rms(self) -> float:
        """Root mean square [m]."""
        return float(np.sqrt(np.mean(self.features.deviation**2)))

    @property
    def p95(self) -> float:
        """Magnitude [m] that 95 % of the points do not exceed."""
        return float(np.percentile(np.abs(self.features.deviation), 95.0))

    @property
    def worst(self) -> int:
        """Index of the point with the largest magnitude that is not beside an edge. ValueError if all are."""
        self._some(~self.edge)
        return int(np.argmax(np.where(self.edge, -1.0, np.abs(self.deviation))))

    def select(self, chosen: npt.NDArray[np.bool_]) -> SurfaceDeviation:
        """The points where `chosen` (n,) is True. ValueError if there are none."""
        self._some(chosen)
        return SurfaceDeviation(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def _some(self, chosen: npt.NDArray[np.bool_]) -> None:
        if not np.any(chosen):
            raise ValueError(f"surface: none of the {len(self.deviation)} measured points is selected")


class NothingCutError(ValueError):
    """There is no surface to measure; the text says whose path makes none, where it is and where the block is."""


def measure(nominal: ToolPath, actual: ToolPath, block_size: npt.ArrayLike, spacing: float | None = None) -> SurfaceDeviation:
    """Compare what the tool really cut from a block of `block_size` [m] (3,) with what the nominal path would have cut.

    Points lie `spacing` [m] apart, by default SPACING or FINEST to the radius of the smallest cutter. The two paths need
    not share their time base. ValueError on bad input, NothingCutError if the nominal path makes no surface in the block.
    """
    size = np.asarray(block_size, dtype=np.float64)
    if size.shape != (3,) or np.any(size <= 0.0):
        raise ValueError(f"block_size {size}: expected three positive lengths in m")
    if spacing is None:
        spacing = min(SPACING, float(nominal.radius.min()) / FINEST)
    if not spacing > 0.0:
        raise ValueError(f"spacing {spacing} m: expected more than 0")
    planned, cut = SweptVolume(nominal), SweptVolume(actual)
    at = surface_points(nominal, planned, size, spacing)
    if len(at) == 0:
        low, high = (1e3 * bound(nominal.position, axis=0) for bound in (np.min, np.max))
        raise NothingCutError(
            f"nothing is cut: the nominal path makes no surface in the block of {_mm(size * 1e3)} mm; the tip spans x, y, z = "
            f"{_mm(low)} to {_mm(high)} mm from the centre of the block's top"
            "; correct the place of the block or the zero of the program"
        )
    bottom = np.full(len(at), -np.inf)
    bottom[~at.wall], _ = cut.bottom(at.points[~at.wall, :2])
    deviation, edge, limited = _left(at, cut, bottom)
    walls, floors = (np.flatnonzero((deviation == 0.0) & kind) for kind in (at.wall, ~at.wall))
    deviation[walls], edge[walls], limited[walls] = _gouged_walls(at.select(walls), planned, cut, size)
    deviation[floors], edge[floors], limited[floors] = _gouged_floors(at.select(floors), planned, bottom[floors], size)
    # the bottom of the block under a through cut is no surface, unless a skin is left
    real = (at.points[:, 2] > -size[2]) | (deviation > 0.0)
    measured = SurfaceDeviation(at.points, at.normal, deviation, at.wall, edge, limited, at.time, at.length).select(real)
    return _joined(measured, _scratches(floor_points(actual, cut, size, spacing, beside=planned), planned))


def _mm(values: FloatArray) -> str:
    return "(" + ", ".join(f"{v:.1f}" for v in values) + ")"


_Found = tuple[FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]
"""Deviation, edge, limited."""


def _left(at: SurfacePoints, cut: SweptVolume, bottom: FloatArray) -> _Found:
    """Material left: from the nominal surface to where the tool came nearest; over a floor not more than stands up to the block's top.

    `bottom` [m] (n,) is the lowest that the tool was over floors.
    """
    most = np.where(at.wall, np.inf, np.maximum(bottom - at.points[:, 2], 0.0))
    far, nearest = cut.distance(at.points, most)
    edge = ~_along(nearest - at.points, at.normal, far)
    return np.where(at.wall, far, np.minimum(far, -at.points[:, 2])), edge, np.zeros(len(far), dtype=np.bool_)


def _gouged_floors(at: SurfacePoints, planned: SweptVolume, bottom: FloatArray, size: FloatArray) -> _Found:
    """From the machined floor, at the height `bottom` [m] (n,), below a nominal one back to the nominal surface."""
    below = at.points.copy()
    below[:, 2] = np.minimum(np.maximum(bottom, -size[2]), at.points[:, 2])
    far, nearest = planned.distance(below, at.points[:, 2] - below[:, 2])
    return -far, ~_along(nearest - below, at.normal, far), bottom < -size[2]


def _gouged_walls(at: SurfacePoints, planned: SweptVolume, cut: SweptVolume, size: FloatArray) -> _Found:
    """From the machined wall behind a nominal one back to the nominal surface; half through a thin wall that is gone."""
    inward = -at.normal[:, :2]
    to_side = _way_out(at.points[:, :2], inward, size)
    way = cut.ends(at.points, inward, to_side)
    behind = at.points.copy()
    behind[:, :2] += way[:, None] * inward
    far, nearest = planned.distance(behind, way + COVER_TOLERANCE)
    edge = ~_along(nearest - behind, at.normal, far)
    limited = way >= to_side
    # where the way back is shorter than the way there, the ray may have gone through a thin wall into the next nominal cut
    odd = np.flatnonzero((edge | (far < 0.5 * way)) & (way > 2.0 * COVER_TOLERANCE))
    if len(odd) > 0:
        thickness = planned.entries(at.points[odd], inward[odd], 2.0 * COVER_TOLERANCE, way[odd])
        through, thickness = odd[thickness < way[odd]], thickness[thickness < way[odd]]
        middle = at.points[through]
        middle[:, :2] += 0.5 * thickness[:, None] * inward[through]
        far[through] = planned.distance(middle)[0]
        edge[through] = far[through] < FEATURE * 0.5 * thickness  # a wedge, not a wall: the tip of an acute corner
        limited[through] = True
    return -far, edge, limited & ~edge


def _scratches(floors: SurfacePoints, planned: SweptVolume) -> SurfaceDeviation:
    """Where the tool went into the raw top of the block: machined floors beside all that is nominal."""
    far, nearest = planned.distance(floors.points)
    up = np.tile([0.0, 0.0, 1.0], (len(floors), 1))
    # else the nearest nominal surface is a wall or floor that has its own points: it is the foot of a gouged wall
    at = floors.select(_along(nearest - floors.points, up, far) & (-floors.points[:, 2] <= far))
    top = at.points * [1.0, 1.0, 0.0]
    no = np.zeros(len(at), dtype=np.bool_)
    return SurfaceDeviation(top, up[: len(at)], at.points[:, 2], no, no, no, at.time, at.length)


def _along(direction: FloatArray, normal: FloatArray, length: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether vectors of `length` [m] point along the normals; what is too short to have a direction does."""
    along: npt.NDArray[np.bool_] = (np.einsum("ij,ij->i", direction, normal) >= FEATURE * length) | (length < COVER_TOLERANCE)
    return along


def _way_out(xy: FloatArray, direction: FloatArray, size: FloatArray) -> FloatArray:
    """Way [m] from points (n, 2) in the block along `direction` (n, 2) to its side."""
    with np.errstate(divide="ignore"):
        way = (np.copysign(0.5 * size[:2], direction) - xy) / direction
    result: FloatArray = np.where(direction == 0.0, np.inf, way).min(axis=1)
    return result


def _joined(*parts: SurfaceDeviation) -> SurfaceDeviation:
    return SurfaceDeviation(*(np.concatenate([getattr(part, name) for part in parts]) for name in SurfaceDeviation.__dataclass_fields__))
