"""Writes a run while it runs: what is on disk is readable at any moment, also after a crash.

Rows go in chunks to `signals.arrow` (an Arrow stream: its complete chunks can be read while it grows
and after the process was killed). At the end, however the run ended, that becomes `signals.parquet`.
`run.toml` beside it says what the columns are; it is there from the beginning.
"""

from __future__ import annotations

import datetime
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robomill.orchestration.errors import ResultsError, unknown
from robomill.orchestration.runs.files import ASIDE, CHECKPOINT, LIVE, RUN, SIGNALS
from robomill.orchestration.runs.flight import Field, Flight
from robomill.orchestration.runs.lock import FolderLock
from robomill.orchestration.runs.run import check_vacant, read_info
from robomill.orchestration.slaves.protocol import FloatArray, Port, base_name
from robomill.orchestration.system.toml_text import dump
from robomill.orchestration.system.wiring import Wiring

if TYPE_CHECKING:
    from robomill.orchestration.runs.stream import Stream

SCHEMA = "robomill-run/1"
_FRAME = re.compile(r"_([A-Z])(?![a-z0-9A-Z])|_([A-Z])([A-Z])(?![a-z0-9A-Z])")
_PROMOTED = ("program", "robot", "tool", "workpiece")
_MAX_AGE = 2.0  # s of wall clock that rows may wait in memory
_MUCH = 2**20  # bytes that are not copied to be kept for later


@dataclass
class Recorder:
    """Observer that writes the chosen outputs of a run into `folder`.

    `columns` are patterns on `component.port` (see `system.Recording`); every `every`-th step is
    written, in chunks of `chunk` rows. `about` goes into run.toml as it is: name of the system,
    algorithm, parameters, sources; `labels` too, with program, robot, tool and workpiece at the top.
    ResultsError if the folder already holds a run and `overwrite` is not set, or one is being written there. With `resume_after`,
    that many steps of the run in the folder are kept and it is continued; the first row observed is then that of the next step.
    """

    folder: Path
    columns: Sequence[str] = ("*",)
    every: int = 1
    chunk: int = 250
    csv: bool = False
    about: Mapping[str, Any] = field(default_factory=dict)
    labels: Mapping[str, Any] = field(default_factory=dict)
    overwrite: bool = False
    resume_after: int | None = None
    lock: FolderLock | None = None
    """Lock of the folder, if the caller holds it; else it is taken for as long as the run lasts."""
    later: bool = False
    """A run that finishes is completed by whoever calls `complete`."""

    def begin(self, wiring: Wiring, step: float) -> None:
        """Choose the columns, write run.toml, begin the flight recorder."""
        chosen = select(self.columns, wiring.column_names())
        ports = [wiring.outputs[i] for i in chosen]
        self.folder = Path(self.folder)
        info = self.info(wiring, step)
        fields = [Field(f"{c}.{p.name}", p.type, _metadata(c, p)) for c, p in ports]
        self.folder.mkdir(parents=True, exist_ok=True)
        self._own_lock = FolderLock(self.folder) if self.lock is None else None
        try:
            self._open(wiring, step, chosen, info, fields)
        except BaseException:
            self._release()
            raise

    def _release(self) -> None:
        if self._own_lock is not None:
            self._own_lock.release()

    def _open(self, wiring: Wiring, step: float, chosen: list[int], info: dict[str, Any], fields: list[Field]) -> None:
        self._seen = 0
        self._ended: tuple[str, str] | None = None
        aside = None
        if self.resume_after is None:
            self._clear()
        else:
            old = read_info(self.folder)
            info |= {"created": old.get("created", ""), "resumed": [*old.get("resumed", []), self.resume_after * step]}
            self._seen = self.resume_after + 1
            from robomill.orchestration.runs.signals import set_aside

            aside = set_aside(self.folder, -(-self._seen // self.every))
        self.flight = Flight(self.folder, wiring.order, chosen, fields, self.every, step)
        self._about = dump(info)  # once: of tens of thousands of columns it takes a second
        self._write_info("running", "")
        self._fields = fields
        self._all_real = all(f.type == "real" for f in fields)
        self._taken = np.array([0, *(1 + i for i in chosen)], dtype=np.intp)  # columns of t and all outputs
        self._stream: Stream | None = None
        if aside is not None:
            self._keep(aside)
        self._chosen = None if chosen == list(range(wiring.n_outputs)) else np.array(chosen, dtype=np.intp)
        self._buffer = self.flight.rows(self.chunk, 1 + len(chosen))
        self._rows = [row[1:] for row in self._buffer]
        self._count = 0
        self._flushed = time.monotonic()

    def _clear(self) -> None:
        """Make room for a new run."""
        if not self.overwrite:
            check_vacant([self.folder])
        for file in (*(self.folder / n for n in (RUN, SIGNALS, LIVE, CHECKPOINT)), *self.folder.glob(f"{ASIDE}*")):
            file.unlink(missing_ok=True)

    @property
    def stream(self) -> Stream:
        """The stream on disk, begun when there is something to write: until then rows are in the flight recorder."""
        if self._stream is None:
            from robomill.orchestration.runs.stream import Stream  # with Arrow, without which a run begins sooner

            self._stream = Stream(self.folder / LIVE, self._fields, self._about, self._taken)
        return self._stream

    def _keep(self, aside: Path) -> None:
        """Copy the rows of the steps that are kept, and remove the file that they come from."""
        try:
            self.stream.put_first(aside, -(-self._seen // self.every))
        except BaseException:
            self.stream.close()
            raise
        aside.unlink()

    def observe(self, t: float, outputs: FloatArray) -> None:
        """Keep a row; write the chunk when it is full or old."""
        self._seen += 1
        if (self._seen - 1) % self.every:
            return
        count = self._count
        if self._chosen is None:
            self._rows[count][:] = outputs
        else:
            outputs.take(self._chosen, out=self._rows[count], mode="clip")
        self._buffer[count, 0] = t  # last: with its time it is a row (`flight`)
        self._count = count + 1
        if self._count == self.chunk or time.monotonic() - self._flushed > _MAX_AGE:
            self.flush()

    def observe_columns(self, columns: FloatArray, count: int) -> None:
        """Keep many rows: the first `count` of float64[1 + n_outputs, capacity], t [s] and all outputs.

        As many as make a chunk or more, or are all of the array, or much, are written at once. The array may be filled anew after that.
        """
        kept = range(-self._seen % self.every, count, self.every)
        self._seen += count
        # of many columns there are few rows, and to copy them and write the copy takes a hundred times as long
        much = 8 * len(kept) * len(self._taken) >= _MUCH
        at_once = len(kept) > self.chunk or much or self._is_whole(columns, kept)
        if at_once or self._count + len(kept) > self.chunk:
            self.flush()
        if at_once:
            self._put_columns(columns, kept)
            self._flushed = time.monotonic()
        else:
            self._buffer[self._count : self._count + len(kept)] = columns[self._taken, kept.start : kept.stop : kept.step].T
            self._count += len(kept)
        if self._count == self.chunk or time.monotonic() - self._flushed > _MAX_AGE:
            self.flush()

    def flush(self) -> None:
        """Write the rows kept so far to disk."""
        if self._count:
            self.stream.put(np.ascontiguousarray(self._buffer[: self._count].T))
        self._count = 0
        self._flushed = time.monotonic()

    def _put_columns(self, columns: FloatArray, kept: range) -> None:
        if kept.step > 1:
            self.stream.put(columns[self._taken, kept.start : kept.stop : kept.step])
        elif self._is_whole(columns, kept):
            self.stream.put_whole(columns)
        else:
            self.stream.put_part(columns, kept.start, kept.stop)

    def _is_whole(self, columns: FloatArray, kept: range) -> bool:
        """Whether these rows are the array as it stands, and all of it real numbers."""
        return len(kept) * len(self._taken) == columns.size and self._all_real

    def end(self, outcome: str, message: str) -> None:
        """Complete the run: now, or later."""
        self._ended = (outcome, message)
        if not self.later or outcome != "finished":
            self.complete()

    def complete(self) -> None:
        """Write what is left, turn the stream into signals.parquet, complete run.toml, unless that is done."""
        if self._ended is None:
            return
        (outcome, message), self._ended = self._ended, None
        from robomill.orchestration.runs.signals import finalise, write_csv

        try:
            try:
                self.flush()
            finally:
                self.stream.close()
                finalise(self.folder)
            self._write_info(outcome, message)
            if self.csv:
                write_csv(self.folder)
        finally:
            self._release()

    def info(self, wiring: Wiring, step: float) -> dict[str, Any]:
        """What run.toml says, except how the run ended."""
        ports = [wiring.outputs[i] for i in select(self.columns, wiring.column_names())]
        return {
            "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "kind": "simulated",
            **{k: self.labels.get(k, "") for k in _PROMOTED},
            **self.about,
            "clock": {"column": "t", "unit": "s", "step": step, "every": self.every},
            "labels": {k: v for k, v in self.labels.items() if k not in _PROMOTED},
            "columns": {
                f"{c}.{p.name}": {"port": f"{c}.{p.name}", "unit": p.unit or "", "frame": frame_of(p.name), "type": p.type}
                for c, p in ports
            },
        }

    def _write_info(self, outcome: str, message: str) -> None:
        part = self.folder / (RUN + ".part")
        part.write_text(dump({"schema": SCHEMA, "outcome": outcome, "message": message}) + self._about, encoding="utf-8")
        part.replace(self.folder / RUN)


def _metadata(component: str, p: Port) -> dict[str, str]:
    """What a column says about its port: enough to make the same port again (see `replay`)."""
    found: dict[str, Any] = {
        "component": component,
        "port": p.name,
        "type": p.type,
        "unit": p.unit,
        "minimum": None if p.minimum is None else repr(float(p.minimum)),
        "maximum": None if p.maximum is None else repr(float(p.maximum)),
        "description": p.description,
        "frame": frame_of(p.name),
        "dependencies": "*" if p.dependencies is None else " ".join(p.dependencies),
    }
    return {k: v for k, v in found.items() if v is not None}


def frame_of(port: str) -> str:
    """Frame that a port is expressed in, read from its name: `f_T_B[1]` -> B, `quat_BT` -> B, `q_link` -> "".

    The monogram notation: the last single capital between underscores; of two capitals the first.
    """
    matches = list(_FRAME.finditer(base_name(port)))
    return (matches[-1][1] or matches[-1][2]) if matches else ""


def select(patterns: Sequence[str], names: Sequence[str]) -> list[int]:
    """Indices of the names that a pattern chooses, in the order of the names. ResultsError for a pattern that chooses none.

    A pattern is an element, an array, a component, or any of them with `*`.
    """
    chosen: set[int] = set()
    for pattern in patterns:
        expression = re.compile(re.escape(pattern).replace(r"\*", ".*"))
        found = [i for i, name in enumerate(names) if any(expression.fullmatch(n) for n in (name, base_name(name), name.partition(".")[0]))]
        if not found:
            known = list(dict.fromkeys(base_name(n) for n in names))
            raise ResultsError(f"recording: {unknown('column', pattern, known)}")
        chosen.update(found)
    return sorted(chosen)
