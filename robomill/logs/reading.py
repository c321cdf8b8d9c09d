"""Reads logs of other programs into named columns.

A reader returns the numbers as they are in the file; units and meaning come from the mapping.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from robomill.logs.arrays import read_hdf5, read_mat, read_npz
from robomill.logs.bags import read_bag
from robomill.logs.csv_text import CsvForm, read_csv
from robomill.logs.log import FloatArray, Log, LogError
from robomill.logs.mdf import read_mdf
from robomill.logs.rsi import read_rsi

__all__ = ["READERS", "SUFFIXES", "CsvForm", "FloatArray", "Log", "LogError", "format_of", "read_log"]

READERS: Mapping[str, Callable[[Path], Log]] = {
    "csv": read_csv,
    "npz": read_npz,
    "mat": read_mat,
    "hdf5": read_hdf5,
    "mdf4": read_mdf,
    "rosbag": read_bag,
    "rsi": read_rsi,
}
SUFFIXES = {
    **dict.fromkeys((".csv", ".txt", ".tsv"), "csv"),
    ".npz": "npz",
    ".mat": "mat",
    **dict.fromkeys((".h5", ".hdf5"), "hdf5"),
    **dict.fromkeys((".mf4", ".mdf", ".dat"), "mdf4"),
    **dict.fromkeys((".db3", ".mcap", ".bag"), "rosbag"),
    ".xml": "rsi",
}


def format_of(file: Path) -> str | None:
    """Format of a log by its suffix, or because it is the folder of a rosbag2; None where that says nothing."""
    return "rosbag" if (file / "metadata.yaml").is_file() else SUFFIXES.get(file.suffix.lower())


def read_log(file: Path, kind: str, form: CsvForm | None = None, stamps: str = "header") -> Log:
    """Open `file` as `kind` (one of `READERS`). LogError if it is not that or is damaged; `form` is for CSV, `stamps` for ROS bags."""
    if not file.exists() or (file.is_dir() and kind != "rosbag"):
        raise LogError(f"no log file {file}; correct the path")
    if kind == "csv":
        return read_csv(file, form or CsvForm())
    if kind == "rosbag":
        return read_bag(file, stamps)
    return READERS[kind](file)
