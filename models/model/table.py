"""Tables: rows of numbers beside the record of an instance, as many as there is memory for.

The record holds the number of rows and their address only, so that it stays small however long a program is. The rows are
never changed: whoever loads a table keeps it as long as the record points to it.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Table:
    """Rows that do not change any more."""

    rows: FloatArray
    """(n, columns), read-only, in C order."""
    path: str = ""
    """The file that they came from; "" = built in, or given as rows."""

    @cached_property
    def digest(self) -> str:
        """SHA-256 of shape and numbers: what a saved state knows the rows by."""
        digest = hashlib.sha256(f"{self.rows.shape}".encode())
        digest.update(self.rows.data)
        return digest.hexdigest()


def from_rows(rows: Any, columns: int) -> Table:
    """The table of `rows` (n, columns), copied unless they cannot be changed. ValueError says what does not fit."""
    found = np.asarray(rows)
    if found.ndim != 2 or found.shape[1] != columns:
        raise ValueError(f"has shape {found.shape}, expected rows of {columns} columns")
    kept = _unchanging(found) and found.dtype == np.float64 and found.flags.c_contiguous
    return _finite(found if kept else np.array(found, dtype=np.float64, order="C"))


def from_file(path: str | Path, columns: int) -> Table:
    """The table in a ``.npy`` file: float64 (n, columns) in C order. OSError or ValueError say what is wrong with it."""
    with Path(path).open("rb") as stream:
        shape, fortran_order, dtype = _header(stream)
        if dtype != np.dtype("<f8") or fortran_order:
            raise ValueError(
                "expected float64 numbers in C order (descr '<f8', fortran_order False), found "
                f"{{'descr': {dtype.str!r}, 'fortran_order': {fortran_order}, 'shape': {shape}, }}"
            )
        if len(shape) != 2 or shape[1] != columns:
            raise ValueError(f"has shape {shape}, expected rows of {columns} columns")
        count = shape[0] * columns
        if os.fstat(stream.fileno()).st_size - stream.tell() < count * dtype.itemsize:
            raise ValueError("ends before its last row")
        rows = np.fromfile(stream, np.float64, count).reshape(shape)
    return _finite(rows, str(path))


def _header(stream: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether in Fortran order, and type of the numbers that follow."""
    try:
        version = np.lib.format.read_magic(stream)
    except ValueError:
        raise ValueError("is not a .npy file") from None
    try:
        return (np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0)(stream)
    except ValueError:
        raise ValueError("has a header that is too long or incomplete") from None


def _finite(rows: FloatArray, path: str = "") -> Table:
    if not np.all(np.isfinite(rows)):
        raise ValueError("holds values that are not finite")
    rows.flags.writeable = False
    return Table(rows, path)


def _unchanging(rows: Any) -> bool:
    """Whether nobody can write into these rows: neither the array nor one that it is a view of."""
    while isinstance(rows, np.ndarray):
        if rows.flags.writeable:
            return False
        rows = rows.base
    return rows is None
