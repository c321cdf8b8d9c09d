"""Reads logs of other programs into named columns: CSV, npz, MAT, MDF4 and recordings of KUKA RSI packets.

A reader returns the numbers as they are in the file; units and meaning come from the mapping.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from robomill.orchestration.errors import OrchestrationError, available, unknown

FloatArray = npt.NDArray[np.float64]


class LogError(OrchestrationError):
    """A log or its mapping cannot be used; the text says what, value, expected, available, remedy."""


@dataclass(frozen=True)
class Log:
    """Columns of a log by name."""

    file: Path
    names: tuple[str, ...]
    """Every column that there is."""
    fetch: Callable[[str], FloatArray] = field(repr=False)
    """Numbers [n] of a column; nan where a record lacks the value. LogError if they are no numbers."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units that the log itself states, in our spelling, where we know it."""
    clocks: Mapping[str, str] = field(default_factory=dict)
    """Formats where channels have clocks of their own: the column with the time [s] of each column."""

    def __getitem__(self, name: str) -> FloatArray:
        if name not in self.names:
            raise LogError(f"{self.file}: {unknown('column', name, self.names)}")
        return self.fetch(name)

    def elements(self, name: str) -> list[str]:
        """The column of that name, or all columns `name[1]`, `name[2]`, ... in order. LogError if there is none."""
        if name in self.names:
            return [name]
        found = [n for n in self.names if n.rpartition("[")[0] == name]
        if not found:
            groups = dict.fromkeys(n.rpartition("[")[0] if n.endswith("]") else n for n in self.names)
            raise LogError(f"{self.file}: {unknown('column', name, groups)}")
        return found


def read_log(file: Path, kind: str, delimiter: str = ",", decimal: str = ".", skip_rows: int = 0) -> Log:
    """Open `file` as `kind` (one of `READERS`). LogError if it is not that or is damaged; `delimiter` and others are for CSV."""
    if not file.is_file():
        raise LogError(f"no log file {file}")
    if kind == "csv":
        return _csv(file, delimiter, decimal, skip_rows)
    return READERS[kind](file)


def _csv(file: Path, delimiter: str = ",", decimal: str = ".", skip_rows: int = 0) -> Log:
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.reader(stream, delimiter=delimiter))[skip_rows:]
    except (csv.Error, UnicodeDecodeError) as error:
        raise LogError(f"{file}: not a CSV file in UTF-8: {error}") from None
    rows = [r for r in rows if r]
    if len(rows) <= 1:
        raise LogError(f"{file}: expected a row of names and rows of numbers after {skip_rows} skipped rows; found {len(rows)} rows")
    names = tuple(n.strip() for n in rows[0])
    _no_doubles(file, names)
    for number, row in enumerate(rows[1:], skip_rows + 2):
        if len(row) != len(names):
            raise LogError(
                f"{file}: row {number} has {len(row)} fields, the row of names has {len(names)}; is the delimiter {delimiter!r}?"
            )

    def fetch(name: str) -> FloatArray:
        column = names.index(name)
        values = np.empty(len(rows) - 1)
        for k, row in enumerate(rows[1:]):
            text = row[column].strip()
            try:
                values[k] = float(text.replace(decimal, ".") if decimal != "." else text) if text else np.nan
            except ValueError:
                place = f"row {k + skip_rows + 2}, column {name!r}"
                raise LogError(
                    f"{file}: {place}: {text!r} is no number; is the decimal sign {decimal!r}, or is there a row of units?"
                ) from None
        return values

    return Log(file, names, fetch)


def _npz(file: Path) -> Log:
    try:
        with np.load(file, allow_pickle=False) as archive:
            arrays = {n: archive[n] for n in archive.files}
    except (ValueError, OSError, KeyError, EOFError) as error:
        raise LogError(f"{file}: not an npz file without pickled objects: {error}") from None
    return _arrays(file, arrays)


def _mat(file: Path) -> Log:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        arrays = loadmat(file, squeeze_me=True)
    except NotImplementedError:
        raise LogError(f"{file}: a MAT file of version 7.3 (HDF5); save it with -v7") from None
    except (MatReadError, ValueError, TypeError, LookupError, OSError) as error:
        raise LogError(f"{file}: not a MAT file: {error}") from None
    return _arrays(file, {n: np.asarray(a) for n, a in arrays.items() if not n.startswith("__")})


def _arrays(file: Path, arrays: Mapping[str, npt.NDArray[Any]]) -> Log:
    """Vectors are columns; of a matrix, its longer side is time: `x[1]`, `x[2]`, ... along the shorter one."""
    columns: dict[str, FloatArray] = {}
    for name, array in arrays.items():
        if array.dtype.kind not in "fiub" or array.ndim not in (1, 2):
            continue
        if array.ndim == 1:
            columns[name] = array.astype(np.float64)
            continue
        rows = array if array.shape[0] < array.shape[1] else array.T
        columns |= {f"{name}[{i}]": row.astype(np.float64) for i, row in enumerate(rows, 1)}
    return Log(file, tuple(columns), columns.__getitem__)


_SPELLINGS = {"Nm": "N.m", "N*m": "N.m", "°": "deg", "deg/sec": "deg/s", "°/s": "deg/s", "µm": "um", "min-1": "rpm", "1/min": "rpm"}


def _mdf(file: Path) -> Log:
    try:
        from asammdf import MDF
    except ImportError:
        raise LogError(
            f"{file}: reading MDF files needs the package 'asammdf', which is not installed; "
            "install it with `pip install asammdf` (or robomill[mdf]), or export the log as CSV"
        ) from None
    try:
        mdf = MDF(file)
    except Exception as error:  # asammdf raises many kinds for a damaged file
        raise LogError(f"{file}: not an MDF file: {error}") from None
    places: dict[str, tuple[int, int]] = {}
    masters: dict[str, str] = {}
    clocks: dict[int, str] = {}
    for name, occurrences in mdf.channels_db.items():
        for group, index in occurrences:
            full = name if len(occurrences) == 1 else f"{group}/{name}"
            if index == mdf.masters_db.get(group):
                full = name if len(occurrences) == 1 else f"{group}/{name}"
                clocks[group] = full
            places[full] = (group, index)
    masters = {n: clocks[g] for n, (g, _) in places.items() if g in clocks}
    units = {}
    for name, (group, index) in places.items():
        if text := str(mdf.get_channel_unit(group=group, index=index) or "").strip():
            units[name] = _SPELLINGS.get(text, text)

    def fetch(name: str) -> FloatArray:
        group, index = places[name]
        if clocks.get(group) == name:
            return np.asarray(mdf.get_master(group), dtype=np.float64)
        samples = mdf.get(group=group, index=index, raw=False).samples
        if samples.ndim != 1 or samples.dtype.kind not in "fiub":
            raise LogError(f"{file}: column {name!r} holds no numbers but {samples.dtype} of shape {samples.shape}")
        return np.asarray(samples, dtype=np.float64)

    return Log(file, tuple(places), fetch, units, masters)


_PACKET = re.compile(rb"<(Rob|Sen)\b[^>]*>.*?</\1\s*>", re.DOTALL)
_RSI_UNITS = {
    **dict.fromkeys(("RIst.X", "RIst.Y", "RIst.Z", "RSol.X", "RSol.Y", "RSol.Z"), "mm"),
    **dict.fromkeys(("RIst.A", "RIst.B", "RIst.C", "RSol.A", "RSol.B", "RSol.C"), "deg"),
    **{f"{tag}.A{i}": "deg" for tag in ("AIPos", "ASPos", "Sen.AK", "Sen.AKorr") for i in range(1, 7)},
    **dict.fromkeys(("Sen.RKorr.X", "Sen.RKorr.Y", "Sen.RKorr.Z"), "mm"),
    **dict.fromkeys(("Sen.RKorr.A", "Sen.RKorr.B", "Sen.RKorr.C"), "deg"),
}


def _rsi(file: Path) -> Log:
    """Packets `<Rob ...>` of the robot, one row each, in the order of the file; `<Sen ...>` answers join the row with their IPOC."""
    rows: list[dict[str, float]] = []
    by_ipoc: dict[float, dict[str, float]] = {}
    answers: list[dict[str, float]] = []
    content = file.read_bytes()
    for match in _PACKET.finditer(content):
        try:
            packet = ElementTree.fromstring(match[0])
        except ElementTree.ParseError as error:
            line = content.count(b"\n", 0, match.start()) + 1
            raise LogError(f"{file}: line {line}: a packet is not well-formed XML: {error}") from None
        values = _numbers(packet)
        if packet.tag == "Rob":
            rows.append(values)
            if "IPOC" in values:
                by_ipoc[values["IPOC"]] = values
        else:
            answers.append(values)
    for values in answers:
        row = by_ipoc.get(values.get("IPOC", np.nan))
        if row is not None:
            row.update({f"Sen.{k}": v for k, v in values.items() if k != "IPOC"})
    if not rows:
        raise LogError(f"{file}: there is no packet <Rob ...>...</Rob> in it; expected a recording of RSI messages")
    names = tuple(dict.fromkeys(name for row in rows for name in row))
    units = {n: _RSI_UNITS[n] for n in names if n in _RSI_UNITS}
    return Log(file, names, lambda name: np.array([row.get(name, np.nan) for row in rows]), units)


def _numbers(packet: ElementTree.Element) -> dict[str, float]:
    """`Tag.Attribute` and `Tag` of every number below a packet."""
    found: dict[str, float] = {}
    for child in packet.iter():
        if child is packet:
            continue
        for key, text in (*((f"{child.tag}.{a}", v) for a, v in child.attrib.items()), (child.tag, child.text or "")):
            try:
                found[key] = float(text)
            except ValueError:
                continue  # texts such as TYPE are no signals
    return found


def _no_doubles(file: Path, names: Iterable[str]) -> None:
    listed = list(names)
    doubles = sorted({n for n in listed if listed.count(n) > 1})
    if doubles:
        raise LogError(f"{file}: columns named twice: {available(doubles)}")


READERS: Mapping[str, Callable[[Path], Log]] = {"csv": _csv, "npz": _npz, "mat": _mat, "mdf4": _mdf, "rsi": _rsi}
SUFFIXES = {".csv": "csv", ".txt": "csv", ".npz": "npz", ".mat": "mat", ".mf4": "mdf4", ".mdf": "mdf4", ".dat": "mdf4", ".xml": "rsi"}
