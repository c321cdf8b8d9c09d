"""The flight recorder: what a run has in memory that a crash of its process must not take along.

A folder `flight` beside the signals, of arrays in mapped files: the system keeps what was stored there, however the process ends.
`call.npy` holds the number of the component that is being called (-1: none); `rows.npy` and `columns.npy` are the buffers
that rows wait in before they are written, those of the recorder and of the compiled loop, marked by their times. Whoever finds
them (`signals`) takes the rows that are later than those on disk. `about.json` says what the columns are, as the stream on disk
begins with the first chunk only.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from robomill.orchestration.slaves.protocol import FloatArray

FLIGHT = "flight"
_CALL, _ROWS, _COLUMNS, _ABOUT = "call.npy", "rows.npy", "columns.npy", "about.json"


class Field(NamedTuple):
    """A column of the results beside t."""

    name: str
    type: str
    """`real`, `integer` or `boolean`."""
    about: dict[str, str]
    """What the column says about its port."""


class Flight:
    """The buffers of one run in `folder`. Its rows hold t and the outputs `chosen`, at each `every`-th of steps of `step` [s]."""

    def __init__(
        self, folder: Path, components: Sequence[str], chosen: Sequence[int], fields: Sequence[Field], every: int, step: float
    ) -> None:
        self._folder = folder / FLIGHT
        remove(folder)
        self._folder.mkdir()
        about = {"components": list(components), "chosen": list(chosen), "fields": fields, "every": every, "step": step}
        (self._folder / _ABOUT).write_text(json.dumps(about), encoding="utf-8")
        self.call: npt.NDArray[np.int64] = self._mapped(_CALL, (1,), np.int64)
        """Number of the component that is being called, -1: none."""
        self.call[0] = -1

    def rows(self, count: int, width: int) -> FloatArray:
        """A buffer of rows, float64[count, width], t [s] first; a row without a time is none."""
        made: FloatArray = self._mapped(_ROWS, (count, width), np.float64)
        made[:, 0] = np.nan
        return made

    def columns(self, width: int, length: int) -> FloatArray:
        """A buffer of columns, float64[width, length], t [s] first and then all outputs."""
        made: FloatArray = self._mapped(_COLUMNS, (width, length), np.float64)
        made[0] = np.nan
        return made

    def _mapped(self, name: str, shape: tuple[int, ...], kind: Any) -> Any:
        if 0 in shape:
            return np.zeros(shape, kind)
        try:  # as a plain array: the class that NumPy maps with is slower to index
            return np.asarray(np.lib.format.open_memmap(self._folder / name, mode="w+", dtype=kind, shape=shape))
        except OSError:  # a file system without mapped files; then a crash costs what is in memory
            return np.zeros(shape, kind)


def remove(folder: Path) -> None:
    """Remove the flight recorder of a run whose rows are all written."""
    if (folder / FLIGHT).is_dir():
        import shutil

        shutil.rmtree(folder / FLIGHT, ignore_errors=True)


def _array(folder: Path, name: str) -> npt.NDArray[Any] | None:
    try:
        found: npt.NDArray[Any] = np.load(folder / FLIGHT / name, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return found


def _about(folder: Path) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads((folder / FLIGHT / _ABOUT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found


def fields(folder: Path) -> list[Field] | None:
    """The columns of a run whose stream may not have begun; None if nothing is known."""
    found = _about(folder).get("fields")
    return None if found is None else [Field(*f) for f in found]


def called(folder: Path) -> str | None:
    """Name of the component that was being called when the process ended; None if none was, or it is not known."""
    call, about = _array(folder, _CALL), _about(folder)
    if call is None or not about or call[0] < 0:
        return None
    return str(about["components"][int(call[0])])


def late_rows(folder: Path, first: float, last: float) -> FloatArray | None:
    """Rows later than `last` [s], float64[n, 1 + chosen], of a run whose first row is that of `first` [s] (NaN: none is on disk)."""
    about = _about(folder)
    if not about:
        return None
    found = []
    rows, columns = _array(folder, _ROWS), _array(folder, _COLUMNS)
    if rows is not None:
        found.append(rows)
        if np.isnan(first) and not np.isnan(rows[:, 0]).all():
            first = float(np.nanmin(rows[:, 0]))
    if columns is not None and not np.isnan(first):
        chosen = columns[[0, *(1 + i for i in about["chosen"])]].T
        chosen = chosen[~np.isnan(chosen[:, 0])]
        found.append(chosen[np.rint((chosen[:, 0] - first) / about["step"]) % about["every"] == 0])
    if not found:
        return None
    all_rows: FloatArray = np.concatenate(found)
    all_rows = all_rows[all_rows[:, 0] > (-np.inf if np.isnan(last) else last)]  # NaN compares false
    kept: FloatArray = all_rows[np.unique(all_rows[:, 0], return_index=True)[1]]
    if not np.isnan(last):  # what was written in between may be torn: rows behind a gap would look like the next
        steps = np.rint((kept[:, 0] - last) / (about["step"] * about["every"]))
        kept = kept[: int(np.cumprod(steps == 1 + np.arange(len(kept))).sum())]
    return kept


def ended(component: str | None) -> str:
    """The sentence for a process that ended while `component` was being called (None: none was)."""
    if component is None:
        return "its process ended before the run did, while no component was being called: it was ended from outside, or crashed"
    return (
        f"its process ended while component {component!r} was being called: that crashed or ended the process, unless it was ended from "
        f"outside; {contained(component)}"
    )


def contained(component: str) -> str:
    """The remedy for a component that ends the process."""
    return f"isolate = true in [components.{component}] contains that: an FMU then runs in a process of its own, and only the run fails"
