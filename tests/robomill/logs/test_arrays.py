"""Specification of logs as arrays: nested structs, arrays of any size, MATLAB 7.3 and HDF5."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from robomill.logs.arrays import read_hdf5, read_mat, read_npz
from robomill.logs.log import LogError
from tests.tolerances import EXACT

h5py = pytest.importorskip("h5py")
N = 7
T = 0.1 * np.arange(N)
POSE = np.arange(N * 6.0).reshape(N, 2, 3)


def same(a: object, b: object) -> bool:
    return bool(np.all(np.asarray(a) - np.asarray(b) == EXACT))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_longest_side_of_an_array_is_time(tmp_path: Path, axis: int) -> None:
    np.savez(tmp_path / "log.npz", T=np.moveaxis(POSE, 0, axis), t=T, note=np.array("text"), one=np.array(3.0))
    log = read_npz(tmp_path / "log.npz")
    assert log.names == ("T[1,1]", "T[1,2]", "T[1,3]", "T[2,1]", "T[2,2]", "T[2,3]", "t")
    assert log.elements("T") == list(log.names[:6])
    for i, j in np.ndindex(2, 3):
        assert same(log[f"T[{i + 1},{j + 1}]"], POSE[:, i, j])


def test_of_sides_that_are_equally_long_the_first_is_time(tmp_path: Path) -> None:
    square = np.arange(9.0).reshape(3, 3)
    np.savez(tmp_path / "log.npz", x=square)
    assert same(read_npz(tmp_path / "log.npz")["x[2]"], square[:, 1])


def test_structs_struct_arrays_and_cells_of_mat_files_are_ways_to_columns(tmp_path: Path) -> None:
    cells = np.empty(2, dtype=object)
    cells[:] = [T, 3.0 * T]
    axis = np.array([(T, POSE), (2.0 * T, POSE)], dtype=[("q", object), ("pose", object)])
    savemat(tmp_path / "log.mat", {"data": {"t": T, "axis": axis, "cells": cells, "robot": "a text"}})
    log = read_mat(tmp_path / "log.mat")
    assert same(log["data.t"], T)
    assert same(log["data.axis[2].q"], 2.0 * T)
    assert same(log["data.axis[1].pose[2,3]"], POSE[:, 1, 2])
    assert same(log["data.cells[2]"], 3.0 * T)
    assert "data.robot" not in log.names
    with pytest.raises(LogError, match=r"unknown column 'data\.axis\[2\]\.v'; did you mean"):
        log["data.axis[2].v"]


def matlab_73(file: Path) -> None:
    """A file as MATLAB 7.3 writes it: a header before HDF5, arrays by columns, struct arrays and cells by reference."""
    with h5py.File(file, "w", userblock_size=512) as f:
        refs = f.create_group("#refs#")

        def put(group: h5py.Group, name: str, value: np.ndarray, kind: bytes = b"double") -> h5py.Dataset:
            made = group.create_dataset(name, data=np.atleast_2d(value).T)
            made.attrs["MATLAB_class"] = np.bytes_(kind)
            return made

        data = f.create_group("data")
        data.attrs["MATLAB_class"] = np.bytes_(b"struct")
        put(data, "t", T)
        put(data, "pose", POSE)
        put(data, "robot", np.frombuffer(b"a text", dtype=np.uint8).astype(np.uint16), b"char")
        cells = [put(refs, "c0", T).ref, put(refs, "c1", 5.0 * T).ref]
        data.create_dataset("cells", data=np.array(cells, dtype=h5py.ref_dtype), dtype=h5py.ref_dtype).attrs["MATLAB_class"] = np.bytes_(
            b"cell"
        )
        axis = data.create_group("axis")
        for field, values in (("q", (T, 2.0 * T)), ("v", (3.0 * T, 4.0 * T))):
            held = [put(refs, f"{field}{i}", v).ref for i, v in enumerate(values)]
            axis.create_dataset(field, data=np.array(held, dtype=h5py.ref_dtype).reshape(2, 1), dtype=h5py.ref_dtype)
    content = bytearray(file.read_bytes())
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64"
    content[: len(header)] = header
    content[124:128] = b"\x00\x02IM"
    file.write_bytes(bytes(content))


def test_mat_files_of_version_7_3_are_read_alike(tmp_path: Path) -> None:
    matlab_73(tmp_path / "log.mat")
    log = read_mat(tmp_path / "log.mat")
    assert same(log["data.t"], T)
    assert same(log["data.pose[2,3]"], POSE[:, 1, 2])
    assert same(log["data.axis[2].q"], 2.0 * T)
    assert same(log["data.axis[1].v"], 3.0 * T)
    assert same(log["data.cells[2]"], 5.0 * T)
    assert all("robot" not in n and "#" not in n for n in log.names)


def test_groups_of_hdf5_files_are_structs(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as f:
        f.create_dataset("run/pose", data=POSE)
        f.create_dataset("run/t", data=T)
        f.create_dataset("run/note", data="a text")
    log = read_hdf5(tmp_path / "log.h5")
    assert log.names == (*(f"run.pose[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)), "run.t")
    assert same(log["run.pose[2,3]"], POSE[:, 1, 2])


def test_hdf5_without_its_package_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    matlab_73(tmp_path / "log.mat")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(
        LogError, match=r"needs the package 'h5py', which is not installed; install it with `pip install h5py` \(or robomill\[hdf5\]\)"
    ):
        read_mat(tmp_path / "log.mat")


def test_a_file_that_is_no_hdf5_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.h5").write_bytes(b"something else")
    with pytest.raises(LogError, match="not an HDF5 file, or damaged"):
        read_hdf5(tmp_path / "log.h5")
