"""The part of a log that is imported, and its cutting into repeats: by period, at given times, or at a column of the log."""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from robomill.logs.log import FloatArray, Log, LogError
from robomill.orchestration.errors import available

Instant = float | datetime.datetime
"""Time of the run [s], or a date and time of day; without a time zone it is UTC."""
Span = tuple[float, float]
"""Begin and end [s]: what is at the begin belongs to it, what is at the end does not."""
TICK = 1e-9
"""s. The resolution of time in a run (docs/nomenclature.md): stamps that are nearer than that are the same."""
_EDGES = {"rises": np.greater, "falls": np.less, "changes": np.not_equal}
EDGES = tuple(_EDGES)


@dataclass(frozen=True)
class Marker:
    """A column of the log that says where repeats begin."""

    column: str
    when: str
    """One of `EDGES`; `changes` makes a piece of each stretch of one value."""
    level: float | None
    """Rises and falls are those through this value, in the numbers of the log."""
    value: float | str | None
    """Instead of edges: pieces are the stretches in which the column has this value."""


@dataclass(frozen=True)
class Cut:
    """The table [cut] of a mapping."""

    place: str = ""
    """Where it stands: `map.toml:8: [cut]`."""
    begin: Instant | None = None
    end: Instant | None = None
    period: float | None = None
    at: tuple[Instant, ...] = ()
    marker: Marker | None = None
    length: float | None = None
    """Pieces end after this time [s]; those that are shorter are left out."""

    @property
    def repeats(self) -> bool:
        """Whether it makes pieces, and not only a window."""
        return self.period is not None or bool(self.at) or self.marker is not None


def spans(
    cut: Cut, log: Log, covered: Span, seconds: Callable[[Instant], float], time_of: Callable[[Sequence[str], int], FloatArray]
) -> tuple[list[Span], str]:
    """Spans [s] of the time `covered` by the log that become runs, and a sentence about what is left out ("" if nothing is).

    `seconds(instant)` is the time of the run at an instant, `time_of(columns, rows)` the times [rows] of columns. LogError where nothing
    is left, with the times or values that there are.
    """
    low, high = covered
    begin = low if cut.begin is None else max(low, seconds(cut.begin))
    end = high if cut.end is None else min(high, seconds(cut.end))
    if not begin < end - TICK:
        asked = " to ".join("..." if i is None else f"{seconds(i):.9g} s" for i in (cut.begin, cut.end))
        raise LogError(
            f"{cut.place}: nothing is in the window {asked}; the log covers {low:.9g} s to {high:.9g} s; choose from and to within that"
        )
    if not cut.repeats:
        return [(begin, end)], ""
    if cut.period is not None:
        count = math.floor((end - begin) / cut.period + TICK)
        pieces = [(begin + k * cut.period, begin + (k + 1) * cut.period) for k in range(count)]
        if not pieces:
            raise LogError(
                f"{cut.place}: the period of {cut.period:g} s is longer than the {end - begin:.9g} s that there are"
                "; choose a shorter period"
            )
        rest = end - pieces[-1][1]
        left = f"the last {rest:.6g} s, which are no whole period" if rest > TICK else ""
    elif cut.at:
        times = [seconds(i) for i in cut.at]
        if outside := [t for t in times if not begin - TICK <= t < end - TICK]:
            raise LogError(
                f"{cut.place}: at: {outside[0]:.9g} s is outside of the time that is imported, {begin:.9g} s to {end:.9g} s"
                "; choose times within that"
            )
        if sorted(set(times)) != times:
            raise LogError(f"{cut.place}: at: the times must increase; found {', '.join(f'{t:.9g} s' for t in times)}")
        pieces, left = list(zip(times, [*times[1:], end], strict=True)), ""
    else:
        assert cut.marker is not None
        states = log.states(cut.marker.column)
        t = time_of([cut.marker.column], len(states))
        inside = (t >= begin - TICK) & (t < end - TICK)
        pieces, left = _marked(cut, cut.marker, states[inside], t[inside], end), ""
    return _of_length(cut, pieces, left)


def _of_length(cut: Cut, pieces: list[Span], left: str) -> tuple[list[Span], str]:
    """The pieces, all of cut.length where that is given."""
    if cut.length is None:
        return pieces, left
    long = [(b, b + cut.length) for b, e in pieces if e - b > cut.length - TICK]
    if not long:
        longest = max(e - b for b, e in pieces)
        raise LogError(
            f"{cut.place}: no piece is as long as the length of {cut.length:g} s; the longest has {longest:.6g} s; choose a shorter length"
        )
    short = len(pieces) - len(long)
    return long, "; ".join(filter(None, (left, f"{short} pieces shorter than {cut.length:g} s" if short else "")))


def _marked(cut: Cut, marker: Marker, states: npt.NDArray[np.generic], t: FloatArray, end: float) -> list[Span]:
    """Pieces at the edges of a column, or while it has a value."""
    numbers = states.dtype.kind == "f"
    what = f"{cut.place}: the marker {marker.column!r}"
    if numbers and not np.all(np.isfinite(states.astype(np.float64))):
        raise LogError(f"{what} has values that are no numbers; fill them, or choose another column")
    if marker.value is not None:
        on = states == marker.value if isinstance(marker.value, str) != numbers else np.zeros(len(states), dtype=bool)
        if not on.any():
            raise LogError(f"{what} never is {marker.value!r}; {_values(states)}; choose a value that it has")
        edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(np.int8)))
        times = np.append(t, end)[edges]
        return [(float(b), float(e)) for b, e in times.reshape(-1, 2)]
    if not numbers and marker.when != "changes":
        raise LogError(f"{what} holds texts, which do not rise or fall; set when = 'changes', or while to one of them; {_values(states)}")
    x = states if marker.level is None else states > marker.level  # type: ignore[operator]  # these are numbers
    edge = np.asarray(_EDGES[marker.when](x[1:], x[:-1]), dtype=bool)
    begins = t[1:][edge]
    if not len(begins):
        through = "" if marker.level is None else f" through {marker.level:g}"
        raise LogError(
            f"{what} never {marker.when}{through} in the time that is imported; {_values(states)}; choose another level or marker"
        )
    if marker.when == "changes":
        begins = np.append(t[:1], begins)
    return [(float(b), float(e)) for b, e in zip(begins, np.append(begins[1:], end), strict=True)]


def _values(states: npt.NDArray[np.generic]) -> str:
    found = np.unique(states)
    if states.dtype.kind == "f" and len(found) > 10:  # noqa: PLR2004  # as many as one reads at a glance
        return f"its values lie between {found[0]:g} and {found[-1]:g}"
    return f"its values: {available(f'{v:g}' if states.dtype.kind == 'f' else repr(str(v)) for v in found)}"
