"""Clocks of logs: when the rows of a column were, and which of these times a run has."""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from robomill.logs.cutting import TICK, Instant
from robomill.logs.mapping import ISO, Clock
from robomill.logs.reading import FloatArray, Log, LogError
from robomill.models.model.units import compatible, unit_of

_NS = 1e-9
_EPOCH = datetime.datetime.fromtimestamp(0, datetime.UTC)


@dataclass(frozen=True)
class Timing:
    """The clock of a mapping, as it is in a log. Times are those of the run, the offset of the clock added [s]."""

    clock: Clock
    log: Log
    t: FloatArray | None
    """Times of the rows of its column; None if they are counted."""
    epoch: int | None
    """Date at which the clock, without the offset, is zero [ns since 1970-01-01 UTC]; None: the log does not say."""

    @staticmethod
    def read(clock: Clock, log: Log) -> Timing:
        """LogError for a column that is no clock."""
        if clock.column is None:
            return Timing(clock, log, None, log.epoch)
        stated = log.units.get(clock.column, "")
        if clock.format is None and compatible(stated, "s") and unit_of(stated) != unit_of(clock.unit):
            raise LogError(
                f"{log.file}: clock {clock.column!r}: wrong unit: the mapping says {clock.unit!r}, the log states {stated!r}"
                "; correct the unit in the mapping"
            )
        if clock.format is None:
            t, epoch = unit_of(clock.unit).factor * log[clock.column] + clock.offset, log.epoch
        else:
            stamps = _stamps(log, clock.column, clock.format)
            t, epoch = np.asarray(_NS * (stamps - stamps[0]), dtype=np.float64) + clock.offset, int(stamps[0])
        _increasing(f"{log.file}: clock {clock.column!r}", t)
        return Timing(clock, log, t, epoch)

    def of_rows(self, names: Sequence[str], rows: int) -> FloatArray:
        """Times [rows] of the rows of these columns: those of the clock, or of their own where the log has such clocks (MDF4, ROS)."""
        if self.t is None:
            return np.arange(rows) / self.clock.rate + self.clock.offset
        of = self.log.clocks
        if len(self.t) == rows and all(of.get(n, self.clock.column) == self.clock.column for n in names):
            return self.t
        own = sorted({of[n] for n in names if n in of})
        if len(own) != 1:
            raise LogError(
                f"{self.log.file}: column {names[0]!r} has {rows} rows, the clock {self.clock.column!r} has {len(self.t)}"
                "; give the clock of that group of columns"
            )
        t = self.log[own[0]] + self.clock.offset
        _increasing(f"{self.log.file}: clock {own[0]!r}", t)
        return t

    def seconds(self, instant: Instant) -> float:
        """Time at an instant. LogError for a date if the log has none."""
        if isinstance(instant, float):
            return instant
        if self.epoch is None:
            raise LogError(
                f"{self.log.file}: [cut] {instant.isoformat()} is a date, and the log says none; give the time of the run, such as '2.5 s'"
            )
        return _NS * (_nanoseconds(instant) - self.epoch) + self.clock.offset

    def date(self, t: float) -> str | None:
        """Date and time of day at a time, in UTC, as ISO 8601 writes it; None: the log does not say."""
        if self.epoch is None:
            return None
        return (_EPOCH + datetime.timedelta(microseconds=self.epoch // 1000, seconds=t - self.clock.offset)).isoformat()

    def within(self, base: FloatArray, begin: float, end: float, last: float) -> FloatArray:
        """Times from `begin` to before `end`, and `last` at most: those of `base`, or those of the grid of the clock if it has one."""
        if self.clock.step > 0.0:
            base = np.asarray(begin + self.clock.step * np.arange(math.ceil((end - begin) / self.clock.step - TICK)), dtype=np.float64)
        return np.asarray(base[(base >= begin - TICK) & (base < end - TICK) & (base <= last + TICK)])


def _increasing(what: str, t: FloatArray) -> None:
    if len(t) <= 1:
        raise LogError(f"{what}: has {len(t)} rows; expected at least 2")
    if not np.all(np.isfinite(t)):
        raise LogError(f"{what}: not a number in row {int(np.flatnonzero(~np.isfinite(t))[0]) + 1}; cut the log there, or fill the gap")
    bad = np.flatnonzero(np.diff(t) <= 0.0)
    if len(bad):
        k = int(bad[0])
        raise LogError(
            f"{what}: time does not increase from row {k + 1} ({t[k]:.9g} s) to row {k + 2} ({t[k + 1]:.9g} s), "
            f"{len(bad)} times in all; remove doubled or reordered rows, or count the time with clock.rate"
        )


def _nanoseconds(instant: datetime.datetime) -> int:
    """Since 1970-01-01 UTC; a time without a zone is UTC."""
    since = (instant if instant.tzinfo else instant.replace(tzinfo=datetime.UTC)) - _EPOCH
    return (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000


def _stamps(log: Log, column: str, form: str) -> npt.NDArray[np.int64]:
    """Dates and times of a column [ns since 1970-01-01 UTC]."""
    if log.texts is None or column not in log.names:
        numbers = log[column]  # says what is wrong with the name
        raise LogError(f"{log.file}: clock {column!r} holds numbers, such as {numbers[0]:.9g}; give its unit instead of a format")
    parse = datetime.datetime.fromisoformat if form == ISO else partial(_parsed, form)
    stamps = []
    for row, text in enumerate(log.texts(column), 1):
        try:
            stamps.append(_nanoseconds(parse(str(text))))
        except ValueError:
            raise LogError(
                f"{log.file}: clock {column!r}, row {row}: {str(text)!r} is no date and time of the format {form!r}"
                "; correct format in [clock]"
            ) from None
    return np.array(stamps, dtype=np.int64)


def _parsed(form: str, text: str) -> datetime.datetime:
    return datetime.datetime.strptime(text, form)
