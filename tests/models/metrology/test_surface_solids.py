"""The scanner against solids of others: block minus swept hulls as meshes (manifold3d), distances between meshes (trimesh).

The oracle knows neither stations nor rays. It samples the meshes of the nominal and of the machined part by area and finds the
nearest triangle that faces the same way. Points that have another feature nearer, within their own deviation, lie beside an edge.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold, OpType

from robomill.models.metrology.surface import FEATURE, measure
from robomill.models.metrology.tool_path import ToolPath
from tests.tolerances import discretisation

MM = 1e-3
FACETS = 128
"""Sides of the prisms that stand for the cutter."""
SAMPLES = 400
"""Points that are compared on each surface of each part."""


@dataclass(frozen=True)
class Part:
    """Vertices of the tip's way [mm], radius [mm], block [mm], largest error of the tool [mm]."""

    way: list[tuple[float, float, float]]
    radius: float = 8.0
    size: tuple[float, float, float] = (120.0, 100.0, 30.0)
    error: float = 0.3


def around(x: float, y: float, z: float) -> list[tuple[float, float, float]]:
    """Around a rectangle of half sides x, y at the depth z, from outside the block and out again."""
    return [(-90, -y, 5), (-90, -y, z), (x, -y, z), (x, y, z), (-x, y, z), (-x, -80, z)]


def ring(corners: int, radius: float, z: float, turn: float = 0.0) -> list[tuple[float, float, float]]:
    """Down into and around a regular polygon."""
    angle = turn + 2 * math.pi * np.arange(corners + 1) / corners
    loop = [(radius * math.cos(a), radius * math.sin(a), z) for a in angle]
    return [(*loop[0][:2], 5.0), *loop, (*loop[-1][:2], 5.0)]


PARTS = {
    "slot through the block": Part([(-80, 0, -10), (80, 0, -10)]),
    "boss of 40 mm": Part(around(28, 28, -10)),
    "boss, 1.3 mm off": Part(around(28, 28, -10), error=1.3),
    "acute boss": Part([(-90, -30, -6), (40, -30, -6), (-20, 35, -6), (-32, -80, -6)]),
    "pocket with inside corners": Part(
        [(-20, -15, 5), (-20, -15, -8), (20, -15, -8), (20, 15, -8), (-20, 15, -8), (-20, 0, -8), (20, 0, -8)]
    ),
    "deep pocket": Part([(-20, -8, 5), (-20, -8, -20), (20, -8, -20), (20, 8, -20), (-20, 8, -20), (-20, -8, -20)], error=2.0),
    "island in a pocket": Part(ring(6, 28, -7)),
    "round pocket": Part(ring(48, 14, -9) + ring(24, 5, -9)),
    "ramps down and up": Part([(-70, 10, 2), (0, 10, -9), (20, 10, -9), (75, 10, 2)]),
    "ramp at an angle": Part([(-70, -30, 1), (30, 40, -12), (30, 40, 5)]),
    "thin wall of 1.5 mm": Part([(-80, -8.75, -10), (80, -8.75, -10), (80, -8.75, 5), (-80, 8.75, 5), (-80, 8.75, -10), (80, 8.75, -10)]),
    "steps": Part([(-80, 0, -4), (80, 0, -4), (80, 12, 5), (-80, 12, 5), (-80, 12, -12), (80, 12, -12)]),
    "holes": Part([(-30, 0, 5), (-30, 0, -15), (-30, 0, 5), (10, 20, 5), (10, 20, -6), (10, 20, 5)]),
    "1 mm tool": Part([(-2, -3, 1), (-2, -3, -0.6), (3, -3, -0.6), (3, 2, -0.6), (-2, 1, -0.6)], 0.5, (10, 10, 3), 0.04),
    "3 mm tool, zigzag": Part([(-12, -8, -2), (12, -6.8, -2), (-12, -5.6, -2), (12, -4.4, -2), (12, 6, -2)], 1.5, (20, 20, 6), 0.1),
    "63 mm tool, shoulder": Part([(-120, 40, -3), (120, 40, -3)], 31.5, (140, 120, 25)),
}
"""Sixteen parts; none was made for the scanner."""


@pytest.fixture(params=PARTS, ids=lambda name: name.replace(" ", "-"))
def part(request: pytest.FixtureRequest) -> Part:
    return PARTS[request.param]


def ways(part: Part) -> tuple[np.ndarray, np.ndarray]:
    """Nominal vertices [m], and those of a tool with an error at each vertex that is `part.error` at most."""
    nominal = MM * np.array(part.way, dtype=float)
    rng = np.random.default_rng(len(part.way))
    off = rng.normal(size=nominal.shape) * [1.0, 1.0, 0.3]
    return nominal, nominal + MM * part.error * off / np.linalg.norm(off, axis=1).max()


def solid(way: np.ndarray, part: Part) -> trimesh.Trimesh:
    """Mesh, in mm, of the block without what a prism sweeps from vertex to vertex."""
    r, top = part.radius, 30.0
    lx, ly, lz = part.size
    block = Manifold.cube([lx, ly, lz], True).translate([0, 0, -0.5 * lz])

    def cutter(p: np.ndarray) -> Manifold:
        x, y, z = p / MM
        return Manifold.cylinder(top - z, r, r, FACETS).translate([x, y, z])

    swept = [Manifold.batch_hull([cutter(a), cutter(b)]) for a, b in itertools.pairwise(way)]
    mesh = (block - Manifold.batch_boolean(swept, OpType.Add)).to_mesh64()
    return trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts, process=False)


class Oracle:
    """Distances to a part's surface."""

    def __init__(self, mesh: trimesh.Trimesh, size: tuple[float, float, float]) -> None:
        good = mesh.area_faces > 1e-9
        self.triangles, self.normals, self.areas = mesh.triangles[good], mesh.face_normals[good], mesh.area_faces[good]
        middle = self.triangles.mean(axis=1)
        half = 0.5 * np.array(size[:2])
        self.sides = np.any((half - np.abs(middle[:, :2]) < 1e-6) & (np.abs(self.normals[:, :2]) > 0.999), axis=1)
        self.sides |= middle[:, 2] < 1e-6 - size[2]
        self.raw = self.sides | (middle[:, 2] > -1e-6)

    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Points on what was machined, evenly by area, and the normals there."""
        rng = np.random.default_rng(0)
        machined = np.flatnonzero(~self.raw)
        chosen = rng.choice(machined, SAMPLES, p=self.areas[machined] / self.areas[machined].sum())
        u, v = rng.random((2, SAMPLES))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        a, b, c = np.moveaxis(self.triangles[chosen], 1, 0)
        return MM * (a + u[:, None] * (b - a) + v[:, None] * (c - a)), self.normals[chosen]

    def nearest(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance along the normals to the nearest triangle that faces the same way, and whether another one is nearer."""
        triangles, facing = self.triangles[~self.sides], self.normals[~self.sides]
        signed, beside = np.empty(len(points)), np.empty(len(points), bool)
        for i, (p, n) in enumerate(zip(points / MM, normals, strict=True)):
            closest = trimesh.triangles.closest_point(triangles, np.tile(p, (len(triangles), 1)))
            far = np.linalg.norm(closest - p, axis=1)
            same = facing @ n >= FEATURE
            k = np.argmin(np.where(same, far, np.inf))
            signed[i] = math.copysign(far[k], (closest[k] - p) @ n)
            beside[i] = not same.any() or far.min() < far[k] - 1e-6
        return MM * signed, beside


def chord(part: Part) -> float:
    """How far a prism lies within its cylinder [m]; nominal and machined part have it both."""
    return 2.0 * MM * part.radius * (1.0 - math.cos(math.pi / FACETS))


def curvature(part: Part) -> float:
    """How much the distances from one to the other of two circles, `error` apart, depend on the side they are measured from [m]."""
    return discretisation(1.0, MM * part.error, 2) / (MM * part.radius)


def test_every_point_is_as_far_off_as_the_solids_are(part: Part) -> None:
    nominal, actual = ways(part)
    time = np.arange(len(nominal)) * 1.0
    m = measure(*(ToolPath.upright(time, way, MM * part.radius) for way in (nominal, actual)), MM * np.array(part.size))
    chosen = np.random.default_rng(1).permutation(np.flatnonzero(~m.edge & ~m.limited))[:SAMPLES]
    signed, beside = Oracle(solid(actual, part), part.size).nearest(m.points[chosen], m.normal[chosen])
    difference = np.abs(m.deviation[chosen] - signed)
    assert np.mean(beside) < 0.25  # strips as wide as the error: beside edges the part says nothing of one wall or floor
    assert difference[~beside].max() <= chord(part) + curvature(part)
    assert np.abs(m.deviation).max() <= MM * part.error
    assert not m.is_limited


def test_nothing_that_the_solids_show_is_missed(part: Part) -> None:
    nominal, actual = ways(part)
    time = np.arange(len(nominal)) * 1.0
    m = measure(*(ToolPath.upright(time, way, MM * part.radius) for way in (nominal, actual)), MM * np.array(part.size))
    planned, made = (Oracle(solid(way, part), part.size) for way in (nominal, actual))
    largest = 0.0
    looks: tuple[tuple[Oracle, Oracle, Callable[[np.ndarray], np.ndarray]], ...] = (
        (planned, made, np.positive),
        (made, planned, np.negative),
    )
    for one, other, sign in looks:
        signed, beside = other.nearest(*one.samples())
        kept = sign(signed)[~beside]
        # material left is seen from the nominal part, gouges from the machined one
        counted = kept[kept > 0.0] if one is planned else kept[kept < 0.0]
        largest = max(largest, np.abs(counted).max(initial=0.0))
    assert m.max >= largest - chord(part) - curvature(part)
