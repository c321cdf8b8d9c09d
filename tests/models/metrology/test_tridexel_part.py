"""Parts of tri-dexels: volume, closed surface and deviation, against solids of other libraries and closed forms."""

from __future__ import annotations

import math
from pathlib import Path

import manifold3d
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from robomill.models.metrology.stl import open_edges, solid_volume, write_stl
from robomill.models.metrology.tridexel_part import Part, compare
from tests.tolerances import discretisation

LOW, HIGH = (-0.02, -0.015, -0.012), (0.02, 0.015, 0.0)
RADIUS, REACH = 0.006, 0.05
SPACING = 5e-4
SHELL = discretisation(0.5, SPACING, 1)
"""Distance [m] of a surface from the true one, at most: edges are bevelled by half a cell."""
BEVEL = 0.02
"""Relative to what is cut: the bevels of its edges (half a cell high and wide), facets of the solids that it is compared with."""
EVEN = discretisation(1.0, SPACING, 2) / RADIUS + 2e-6
"""Distance [m] of the surface from the true one where it is smooth: chords over a cell, and the ridges of two scallops (1 um)."""
CUTTERS = [
    (0.0, (0.0, 0.0)),
    (0.002, (0.0, 0.0)),
    (RADIUS, (0.0, 0.0)),
    (0.0, (20.0, 15.0)),
    (0.002, (-25.0, 30.0)),
    (RADIUS, (20.0, 45.0)),
]


def body(corner: float, turn: tuple[float, float], tip: np.ndarray) -> manifold3d.Manifold:
    """The cutter at a place as a solid: hull of two discs, or a profile turned about the axis."""
    angle = np.linspace(0.0, 0.5 * math.pi, 13)
    profile = [
        (0.0, 0.0),
        *zip(RADIUS - corner + corner * np.sin(angle), corner * (1 - np.cos(angle)), strict=True),
        (RADIUS, REACH),
        (0.0, REACH),
    ]
    if corner <= 0.0:
        profile = [(0.0, 0.0), (RADIUS, 0.0), (RADIUS, REACH), (0.0, REACH)]
    if corner >= RADIUS:
        profile = profile[1:]
    solid = manifold3d.CrossSection([np.array(profile)]).revolve(90)
    matrix = np.hstack([Rotation.from_euler("xy", turn, degrees=True).as_matrix(), tip[:, None]])
    return solid.transform(matrix)


def cut(corner: float, turn: tuple[float, float], tips: np.ndarray, spacing: float = SPACING) -> Part:
    part = Part.block(LOW, HIGH, spacing)
    axis = Rotation.from_euler("xy", turn, degrees=True).apply([0.0, 0.0, 1.0])
    part.cut(tips, np.tile(axis, (len(tips), 1)), RADIUS, corner, REACH)
    return part


@pytest.mark.parametrize(("corner", "turn"), CUTTERS)
def test_a_straight_cut_is_that_of_solids(tmp_path: Path, corner: float, turn: tuple[float, float]) -> None:
    """The way of a convex body along a line is the hull of its two ends."""
    ends = np.array([[-0.005, -0.004, -0.0041], [0.009, 0.003, -0.0053]])
    part = cut(corner, turn, ends)
    swept = manifold3d.Manifold.batch_hull([body(corner, turn, tip) for tip in ends])
    centre = 0.5 * (np.array(LOW) + HIGH)
    block = manifold3d.Manifold.cube(np.array(HIGH) - LOW, True).translate(centre)
    left = block - swept
    removed = block.volume() - left.volume()
    assert block.volume() - part.volumes().mean() == pytest.approx(removed, rel=BEVEL)
    surface = part.surface()
    assert open_edges(surface) == 0
    assert block.volume() - solid_volume(surface) == pytest.approx(removed, rel=2 * BEVEL)
    write_stl(tmp_path / "part.stl", surface)
    mesh = trimesh.load(tmp_path / "part.stl")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    solid = left.to_mesh()
    faces = np.asarray(solid.vert_properties, dtype=np.float64)[:, :3][solid.tri_verts]
    points = 1e-3 * mesh.vertices[np.random.default_rng(1).choice(len(mesh.vertices), 200)]
    pairs = np.repeat(points, len(faces), axis=0)
    nearest = trimesh.triangles.closest_point(np.tile(faces, (len(points), 1, 1)), pairs)
    far = np.linalg.norm(nearest - pairs, axis=1).reshape(len(points), -1).min(axis=1)
    assert far.max() < SHELL
    assert np.quantile(far, 0.9) < EVEN


@pytest.mark.parametrize("spacing", [1e-3, 5e-4])
def test_a_ball_nose_leaves_the_closed_form(spacing: float) -> None:
    """A slot through the block: the segment of a circle times its length."""
    depth = 0.004
    part = cut(RADIUS, (0.0, 0.0), np.array([[-0.04, 0.0, -depth], [0.04, 0.0, -depth]]), spacing)
    angle = math.acos(1.0 - depth / RADIUS)
    expected = (RADIUS**2 * angle - (RADIUS - depth) * RADIUS * math.sin(angle)) * 0.04
    # per cell of the height, quadratic in it
    assert 0.04 * 0.03 * 0.012 - part.volumes().mean() == pytest.approx(expected, rel=discretisation(1.0, spacing / depth, 2))


def test_random_cuts_always_leave_a_closed_surface() -> None:
    rng = np.random.default_rng(7)
    part = Part.block(LOW, HIGH, 1.5e-3)
    for k in range(24):
        axis = Rotation.from_euler("xy", rng.uniform(-60, 60, 2), degrees=True).apply([0.0, 0.0, 1.0])
        radius = rng.uniform(0.0005, 0.004)
        tips = rng.uniform(LOW, HIGH, (2, 3))
        part.cut(tips, np.tile(axis, (2, 1)), radius, rng.uniform(0, radius), REACH)
        if k % 4 == 3:
            surface = part.surface()
            assert open_edges(surface) == 0
    assert 0.0 < solid_volume(surface) < 0.04 * 0.03 * 0.012


def test_nothing_left_has_no_surface_and_an_open_solid_is_refused() -> None:
    part = Part.block(LOW, HIGH, 1e-3)
    part.cut([[0.0, 0.0, -0.1], [0.0, 0.0, -0.1]], [[0, 0, 1.0]] * 2, 0.1, 0.0, 0.2)
    assert len(part.surface()) == 0
    raw = Part.block(LOW, HIGH, 1e-3)
    with pytest.raises(ValueError, match="nothing is left of the part"):
        compare(part, raw, raw)
    with pytest.raises(ValueError, match="nothing of the stock is cut"):
        compare(raw, raw, raw)
    triangles = np.array(trimesh.creation.box(extents=(0.03, 0.02, 0.01)).triangles)
    assert Part.solid(triangles, 1e-3).volumes() == pytest.approx([6e-6] * 3, rel=1e-6 * BEVEL)
    with pytest.raises(ValueError, match="the surface is not closed"):
        Part.solid(triangles[1:], 1e-3)
    with pytest.raises(ValueError, match="expected three positive lengths"):
        Part.block(HIGH, LOW, 1e-3)


@pytest.mark.parametrize(("corner", "turn"), [(0.0, (0.0, 0.0)), (RADIUS, (0.0, 20.0))])
def test_the_deviation_is_how_far_the_tool_is_off(corner: float, turn: tuple[float, float]) -> None:
    """The tool 80 um too low: the floor is gouged by that, walls along the way are as they should be."""
    off = 8e-5
    tips = np.array([[-0.04, 0.0, -0.004], [0.04, 0.0, -0.004]])
    raw = Part.block(LOW, HIGH, SPACING)
    found = compare(cut(corner, turn, tips), cut(corner, turn, tips - [0.0, 0.0, off]), raw)
    chosen = ~found.beside
    expected = -off * found.normal[chosen, 2]
    assert np.abs(found.deviation[chosen] - expected).max() < 4 * EVEN
    assert np.sqrt(np.mean((found.deviation[chosen] - expected) ** 2)) < EVEN
    assert np.mean(found.beside) < 0.2
