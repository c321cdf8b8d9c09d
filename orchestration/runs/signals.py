"""The signals of a run on disk: an Arrow stream (`signals.arrow`) while it runs, a Parquet file (`signals.parquet`) afterwards.

Whoever needs Arrow imports this module when there is something to read or to write: a run begins without it, which saves 30 ms.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from robomill.orchestration.errors import ResultsError
from robomill.orchestration.runs import flight
from robomill.orchestration.runs.files import ASIDE, CSV, LIVE, SIGNALS
from robomill.orchestration.runs.lock import is_locked
from robomill.orchestration.slaves.protocol import FloatArray

_ROWS_PER_GROUP = 50_000
_TYPES = {"real": pa.float64(), "integer": pa.int64(), "boolean": pa.bool_()}


def read_table(folder: Path) -> pa.Table:
    """The signals of a run as far as they are there. ResultsError if there are none, or they cannot be read."""
    try:
        if (folder / SIGNALS).is_file():
            return _parquet().read_table(folder / SIGNALS)
        if (columns := _schema(folder)) is not None:
            return pa.Table.from_batches(list(_all_rows(folder, columns, late=not is_locked(folder))), columns)
        if (folder / CSV).is_file():
            from pyarrow import csv

            return csv.read_csv(folder / CSV)
    except (pa.ArrowInvalid, OSError) as error:
        raise ResultsError(f"{folder}: the signals cannot be read: {error}; run or import it anew") from None
    raise ResultsError(f"{folder}: there is no {SIGNALS}, {LIVE} or {CSV} in it; run or import it anew")


def count(file: Path) -> float:
    """Rows of a file of signals that is complete; infinite where it cannot be read."""
    try:
        return int(_parquet().read_metadata(file).num_rows)
    except (pa.ArrowInvalid, OSError):
        return math.inf


def schema(fields: Sequence[flight.Field], about: str = "") -> pa.Schema:
    """The columns of a run; `about`: run.toml without how the run ended."""
    found = [pa.field("t", pa.float64(), metadata={"unit": "s", "description": "time"})]
    found += [pa.field(f.name, _TYPES[f.type], metadata=f.about) for f in fields]
    return pa.schema(found, metadata={"robomill": about})


def _parquet() -> Any:
    """Imported when a run ends or is read: one begins without what else that loads."""
    return importlib.import_module("pyarrow.parquet")


def _schema(folder: Path) -> pa.Schema | None:
    """The columns of a run that has not been completed: those of its stream, or what it would begin with; None if neither is there."""
    if (folder / LIVE).is_file():
        with pa.OSFile(str(folder / LIVE)) as source:
            return pa.ipc.open_stream(source).schema
    fields = flight.fields(folder)
    return None if fields is None else schema(fields)


def _batches(source: Any) -> Iterator[pa.RecordBatch]:
    """The complete chunks of a stream; what comes after them was not finished."""
    reader = pa.ipc.open_stream(source)
    while True:
        try:
            yield reader.read_next_batch()
        except (StopIteration, pa.ArrowInvalid, OSError):
            return


def _all_rows(folder: Path, columns: pa.Schema, late: bool) -> Iterator[pa.RecordBatch]:
    """The rows of a stream, if there is one; the `late` ones, too, which were in memory when the writing of it ended."""
    first, last = math.nan, math.nan
    if (folder / LIVE).is_file():
        with pa.OSFile(str(folder / LIVE)) as source:
            for batch in _batches(source):
                if len(batch):
                    first = batch.column("t")[0].as_py() if math.isnan(first) else first
                    last = batch.column("t")[-1].as_py()
                yield batch
    rows = flight.late_rows(folder, first, last) if late else None
    if rows is not None and rows.shape[1] == len(columns):
        yield pa.record_batch([arrow(cast(c, f.type)) for c, f in zip(rows.T, columns, strict=True)], schema=columns)


def cast(column: FloatArray, kind: pa.DataType) -> Any:
    """Values as they stand in memory in the type of a column."""
    if kind == pa.float64():
        return np.ascontiguousarray(column)
    return column != 0.0 if kind == pa.bool_() else np.rint(column).astype(np.int64)


def arrow(values: npt.NDArray[Any]) -> pa.Array:
    """Numbers as Arrow sees them, nothing copied (booleans are packed). `pa.array` loads pandas first where that is installed: 0.3 s."""
    kind = pa.from_numpy_dtype(values.dtype)
    held = np.packbits(values, bitorder="little") if values.dtype == np.bool_ else np.ascontiguousarray(values)
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(held)])


def values_of(table: pa.Table, name: str, folder: Path) -> FloatArray:
    """A column as float64[n]. ResultsError, which names `folder`, where it holds no numbers."""
    column = table.column(name)
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type) or pa.types.is_boolean(column.type)):
        raise ResultsError(
            f"{folder}: column {name!r} holds no numbers but {column.type}; leave the column out, or import it anew as numbers"
        )
    values = column.to_numpy(zero_copy_only=False)
    return np.ascontiguousarray(values, dtype=np.float64)


def finalise(folder: Path) -> None:
    """Turn the stream of a run that is over (or was killed) into `signals.parquet`. The stream goes only when that is complete."""
    live, part = folder / LIVE, folder / (SIGNALS + ".part")
    columns = _schema(folder)
    if columns is None:
        return
    # Dictionaries of real numbers, which hardly ever repeat, took eight times as long and made the file half as large again.
    reals = [f.name for f in columns if pa.types.is_floating(f.type)]
    others = [f.name for f in columns if not pa.types.is_floating(f.type)]
    options: dict[str, Any] = {"compression": "zstd", "use_dictionary": others or False, "use_byte_stream_split": reals or False}
    with _parquet().ParquetWriter(part, columns, **options) as writer:
        rows: list[pa.RecordBatch] = []
        for batch in _all_rows(folder, columns, late=True):
            rows.append(batch)
            if sum(len(r) for r in rows) >= _ROWS_PER_GROUP:
                writer.write_table(pa.Table.from_batches(rows, columns))
                rows.clear()
        writer.write_table(pa.Table.from_batches(rows, columns))
    part.replace(folder / SIGNALS)
    live.unlink(missing_ok=True)
    flight.remove(folder)


def set_aside(folder: Path, rows: int) -> Path:
    """Rename the signals of a run that is to go on after `rows` rows; returns the file, which `rows_of` reads.

    If that was done before and came to nothing, the renamed file is still the one. ResultsError if it has fewer rows.
    """
    aside = next((folder / (ASIDE + n) for n in (SIGNALS, LIVE) if (folder / (ASIDE + n)).is_file()), None)
    file = aside or next((folder / n for n in (SIGNALS, LIVE) if (folder / n).is_file()), None)
    if file is None:
        raise ResultsError(f"{folder}: there is no {SIGNALS} or {LIVE} in it; run it anew without resuming")
    held = sum(len(b) for b in rows_of(file))
    if held < rows:
        raise ResultsError(f"{folder}: {file.name} holds {held} rows, the checkpoint was made after {rows}: run it anew without resuming")
    if aside is None:
        aside = file.replace(folder / (ASIDE + file.name))
    for name in (SIGNALS, LIVE):
        (folder / name).unlink(missing_ok=True)
    return aside


def rows_of(file: Path) -> Iterator[pa.RecordBatch]:
    """The complete chunks of a file of signals."""
    try:
        if file.suffix == Path(SIGNALS).suffix:
            with _parquet().ParquetFile(file) as table:
                yield from table.iter_batches()
        else:
            with pa.OSFile(str(file)) as source:
                yield from _batches(source)
    except (pa.ArrowInvalid, OSError) as error:
        raise ResultsError(f"{file}: the signals cannot be read: {error}; run or import it anew") from None


def write_csv(folder: Path) -> Path:
    """Write `signals.csv` (all digits) beside the signals of a run, and return its path."""
    from pyarrow import csv

    csv.write_csv(read_table(folder), folder / CSV)
    return folder / CSV
