"""STL files: closed solids in, triangles out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from robomill.models.metrology.stl import StlError, open_edges, read_stl, solid_volume, write_stl

SINGLE = 1e-6
"""Relative: STL holds numbers of single precision (6e-8), here of coordinates up to ten times the size."""


def solid() -> trimesh.Trimesh:
    """A cylinder of 40 mm across, 15 mm high, in mm, away from the origin."""
    mesh = trimesh.creation.cylinder(20.0, 15.0, sections=24)
    mesh.apply_translation([100.0, -30.0, 7.5])
    return mesh


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_what_another_library_writes_is_read(tmp_path: Path, kind: str) -> None:
    mesh = solid()
    mesh.export(tmp_path / "s.stl", file_type=kind)
    found = read_stl(tmp_path / "s.stl")
    assert np.abs(found - 1e-3 * mesh.triangles).max() < SINGLE
    assert solid_volume(found) == pytest.approx(1e-9 * mesh.volume, rel=SINGLE * 10)
    inches = read_stl(tmp_path / "s.stl", 0.0254)
    assert np.ptp(inches[:, :, 0]) == pytest.approx(40 * 0.0254, rel=SINGLE)


def test_another_library_reads_what_is_written(tmp_path: Path) -> None:
    mesh = solid()
    write_stl(tmp_path / "s.stl", 1e-3 * mesh.triangles)
    found = trimesh.load(tmp_path / "s.stl")
    assert found.is_watertight
    assert found.volume == pytest.approx(mesh.volume, rel=SINGLE * 10)
    assert np.abs(found.face_normals - mesh.face_normals).max() < SINGLE


def test_bad_files_are_refused(tmp_path: Path) -> None:
    file, triangles = tmp_path / "s.stl", np.array(1e-3 * solid().triangles)

    def refused(text: str, unit: float = 1e-3) -> None:
        with pytest.raises(StlError, match=text):
            read_stl(file, unit)

    write_stl(file, triangles[:-1])
    assert open_edges(triangles[:-1]) == 3
    refused("the surface is not closed: 3 edges belong to one triangle only; mend the mesh")
    write_stl(file, triangles[:, ::-1])
    refused("the triangles face inwards")
    write_stl(file, triangles, unit=0.0254)
    refused(r"0.00157\d* m long in a unit of 0.001 m; expected 0.002 to 5 m; it would fit in inches \(0.04")
    write_stl(file, triangles)
    refused("it would fit in millimetres", unit=1.0)
    file.write_bytes(file.read_bytes()[:-1])
    refused("is no STL file, or a binary one that ends early")
    file.write_text("solid x\n vertex 1 2 3\n vertex 1 2 3\nendsolid\n")
    refused("ASCII with 2 lines 'vertex x y z'; expected three for each triangle")
    file.write_text("solid x\n vertex 1 2 a\n vertex 1 2 3\n vertex 1 2 3\nendsolid\n")
    refused("could not convert")
    triangles[0, 0, 0] = np.nan
    write_stl(file, triangles)
    refused("not finite")
    with pytest.raises(FileNotFoundError, match="no STL file"):
        read_stl(tmp_path / "none.stl")
