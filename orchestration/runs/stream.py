"""The Arrow stream that a run is written to: `signals.arrow`, whose complete chunks can be read while it grows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from robomill.orchestration.runs.disk import LINE, reserve
from robomill.orchestration.runs.flight import Field
from robomill.orchestration.runs.signals import arrow, cast, rows_of, schema
from robomill.orchestration.slaves.protocol import FloatArray

_PIECE = 2**21  # bytes written at once
_AHEAD = 2**26  # bytes that disk space is reserved ahead, at most


class Stream:
    """An open stream of t [s] and the columns `fields`.

    `about` is run.toml without how the run ended; `taken` are the places of t and the columns among t and all outputs of a system.
    """

    def __init__(self, file: Path, fields: Sequence[Field], about: str, taken: npt.NDArray[np.intp]) -> None:
        self._schema = schema(fields, about)
        self._taken = taken
        self._kinds = list(self._schema.types)
        self._other = [i for i, kind in enumerate(self._kinds) if kind != pa.float64()]  # asked for each chunk, that took 0.1 ms
        # Arrow's own file is written without Python; in large pieces, because the pages cost more than what is copied into them
        self._file = pa.OSFile(str(file), "wb")
        self._reserved = 0
        self._stream = pa.BufferedOutputStream(self._file, _PIECE)
        self._writer = pa.ipc.new_stream(self._stream, self._schema)
        self._wrapped: tuple[FloatArray, pa.RecordBatch] | None = None
        self._heads: dict[int, bytes] = {}  # of the messages that are written without Arrow, by their number of rows
        try:
            # without a batch there is no schema in the file
            self._writer.write_batch(pa.record_batch([pa.nulls(0, kind) for kind in self._kinds], schema=self._schema))
            self._stream.flush()
        except BaseException:
            self._stream.close()
            raise

    def close(self) -> None:
        """No more rows."""
        self._writer.close()
        self._stream.close()

    def put_first(self, file: Path, rows: int) -> None:
        """Copy the first `rows` rows of a file of signals with the same columns."""
        for batch in rows_of(file):
            kept = batch.slice(0, min(rows, len(batch)))
            rows -= len(kept)
            if len(kept):
                self._writer.write_batch(pa.record_batch(kept.columns, schema=self._schema))
        self._stream.flush()

    def put(self, columns: FloatArray) -> None:
        """Write rows: float64[columns, rows], t and the columns."""
        whole, n = arrow(columns.reshape(-1)), columns.shape[1]  # parts of it are made in a third of the time
        arrays = [whole.slice(i * n, n) if kind == pa.float64() else arrow(cast(columns[i], kind)) for i, kind in enumerate(self._kinds)]
        self._put_batch(pa.RecordBatch.from_arrays(arrays, schema=self._schema))

    def put_part(self, columns: FloatArray, first: int, stop: int) -> None:
        """Write the rows from `first` to before `stop` of float64[1 + n_outputs, capacity], t and all outputs."""
        batch = self._wrap(columns).slice(first, stop - first)
        for i in self._other:
            values = arrow(cast(columns[self._taken[i], first:stop], self._kinds[i]))
            batch = batch.set_column(i, self._schema.field(i), values)
        self._put_batch(batch)

    def put_whole(self, columns: FloatArray) -> None:
        """Write all of an array of real numbers: its bytes are the body of the message as they stand, and are copied once less."""
        rows = columns.shape[1]
        if rows not in self._heads:
            self._heads[rows] = self._wrap(columns).serialize().to_pybytes()[: -columns.nbytes]
        self._reserve(rows)
        self._file.write(_padded(self._heads[rows], self._file.tell()))
        self._file.write(columns)

    def _put_batch(self, batch: pa.RecordBatch) -> None:
        self._reserve(len(batch))
        self._writer.write_batch(batch)
        self._stream.flush()

    def _reserve(self, rows: int) -> None:
        """Disk space for what comes next, and for as much again as there is, so that a short run does not take much."""
        end = self._file.tell() + 8 * rows * len(self._kinds)
        if end > self._reserved:
            start, self._reserved = self._reserved, end + min(end, _AHEAD)
            reserve(self._file.fileno(), start, self._reserved - start)

    def _wrap(self, columns: FloatArray) -> pa.RecordBatch:
        """The array as Arrow sees it, nothing copied. Wrapping takes as long as writing, and the same array comes again and again."""
        if self._wrapped is None or self._wrapped[0] is not columns:
            whole, n = arrow(columns.reshape(-1)), columns.shape[1]
            arrays = [
                whole.slice(i * n, n) if kind == pa.float64() else pa.nulls(n, kind)
                for i, kind in zip(self._taken, self._kinds, strict=True)
            ]
            self._wrapped = columns, pa.RecordBatch.from_arrays(arrays, schema=self._schema)
        return self._wrapped[1]


def _padded(head: bytes, position: int) -> bytes:
    """The head of a message that begins at that place of the file, so long that its body begins at a multiple of 64 bytes.

    Numbers that stand otherwise in the file than in memory take the kernel up to three times as long to copy.
    The second four bytes are the length of what follows, padding included.
    """
    length = len(head) + -(position + len(head)) % LINE
    return head[:4] + (length - 8).to_bytes(4, "little") + head[8:].ljust(length - 8, b"\0")
