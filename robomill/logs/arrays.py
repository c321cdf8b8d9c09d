"""Logs as arrays by name: npz, MATLAB files of all versions, HDF5."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.logs.log import FloatArray, Log, LogError, missing_package

Array = npt.NDArray[Any]


def read_npz(file: Path) -> Log:
    """Arrays of a numpy archive without pickled objects."""
    try:
        with np.load(file, allow_pickle=False) as archive:
            arrays = {n: archive[n] for n in archive.files}
    except (ValueError, OSError, KeyError, EOFError) as error:
        raise LogError(f"{file}: not an npz file without pickled objects: {error}; save the arrays with numpy.savez") from None
    return _columns(file, arrays)


def read_mat(file: Path) -> Log:
    """Arrays of a MATLAB file: of structs `data.axis.pos`, of struct and cell arrays `data.axis[2].pos`."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        variables = loadmat(file, simplify_cells=True)
    except NotImplementedError:
        return read_hdf5(file)
    except (MatReadError, ValueError, TypeError, LookupError, OSError) as error:
        raise LogError(f"{file}: not a MAT file: {error}; save the data anew, such as with save('log.mat', '-v7')") from None
    found = dict(_leaves("", {n: v for n, v in variables.items() if not n.startswith("__")}))
    objects = "__function_workspace__" in variables
    return _columns(file, found, "timeseries, tables and other objects of MATLAB cannot be read: save their numbers" if objects else "")


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Array]]:
    """Numeric arrays within structs (dicts), struct arrays and cells (lists, arrays of objects), each with the way to it."""
    if isinstance(value, Mapping):
        for key, member in value.items():
            yield from _leaves(f"{name}.{key}" if name else str(key), member)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype.kind == "O"):
        for index, member in np.ndenumerate(np.asarray(value, dtype=object) if isinstance(value, np.ndarray) else _row(value)):
            yield from _leaves(f"{name}[{','.join(str(i + 1) for i in index)}]", member)
    elif isinstance(value, np.ndarray):
        yield name, value


def _row(values: list[Any]) -> Array:
    row = np.empty(len(values), dtype=object)
    row[:] = values
    return row


def read_hdf5(file: Path) -> Log:
    """Arrays of an HDF5 file, or of a MATLAB file of version 7.3, which is one: groups are structs, references are cells."""
    try:
        import h5py
    except ImportError:
        raise missing_package(file, "HDF5 and MAT files of version 7.3", "h5py", "hdf5", "save the file with -v7") from None
    found: dict[str, Array] = {}

    def walk(name: str, item: Any) -> None:
        if isinstance(item, h5py.Group):
            for key, member in item.items():
                if not key.startswith("#"):
                    walk(f"{name}.{key}" if name else key, member)
            return
        kind = item.attrs.get("MATLAB_class", b"")
        if h5py.check_ref_dtype(item.dtype):
            struct, _, field = name.rpartition(".")
            for i, reference in enumerate(item[()].ravel(), 1):  # a cell has a class, a field of a struct array has none
                walk(f"{name}[{i}]" if kind else f"{struct}[{i}].{field}", item.file[reference])
        elif kind != b"char" and "MATLAB_empty" not in item.attrs:
            found[name] = np.squeeze(item[()].T if kind else item[()])  # MATLAB stores by columns

    try:
        with h5py.File(file) as opened:
            walk("", opened)
    except (OSError, RuntimeError, KeyError) as error:
        raise LogError(f"{file}: not an HDF5 file, or damaged: {error}; save or copy it anew") from None
    return _columns(file, found)


def _columns(file: Path, arrays: Mapping[str, Array], remark: str = "") -> Log:
    """Vectors are columns; of larger arrays the longest side is time (the first of two such): `x[1]`, `T[1,1]` along the others."""
    columns: dict[str, Array] = {}
    for name, array in arrays.items():
        if array.dtype.kind not in "fiub" or array.ndim == 0:
            continue
        rows = np.moveaxis(array, int(np.argmax(array.shape)), -1)
        for index in np.ndindex(*rows.shape[:-1]):
            columns[f"{name}[{','.join(str(i + 1) for i in index)}]" if index else name] = rows[index]

    def fetch(name: str) -> FloatArray:
        return columns[name].astype(np.float64)

    return Log(file, tuple(columns), fetch, remark=remark)
