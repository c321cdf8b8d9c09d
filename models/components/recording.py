"""A component made from a recording: the ports of the component it stands for, its outputs looked up at the time of the run.

It is what makes swap tests possible: put the measured signals of one component into the twin and
see whether the gap goes away. Inputs are there, so that it drops in, and are ignored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, TypeVar

import numpy as np

from robomill.models.model.declaration import FloatArray, Model, Record, Variable, kernel
from robomill.models.model.table_access import cell, row_at

_T = TypeVar("_T")

HOLD, LINEAR = 0, 1
SAME_TIME = 1e-9
"""Times closer than this are the same instant [s]: t = k h in floating point differs from a recorded k h by roundoff."""

ERRORS = (
    "",
    "time {replay_time} s lies outside the recording, which goes from {replay_first} s to {replay_last} s; "
    "shift it with the parameter time_offset or end the run earlier",
    "the recording is empty; name a file in the parameter recording",
    "the times of the recording do not increase from row {replay_row} (counted from zero) to the next",
)


@dataclass(frozen=True)
class ReplayModel(Model):
    """A model made by `replay_model`; `columns` are those of its table `recording`, `specification` remakes it."""

    columns: tuple[str, ...] = ()
    specification: dict[str, Any] = field(default_factory=dict, compare=False)


def replay_model(
    model: Model, times: FloatArray, columns: Mapping[str, FloatArray], interpolation: int = LINEAR, name: str | None = None
) -> ReplayModel:
    """Make the model that stands in for `model` from its recorded outputs.

    `times` [s] (n,), increasing, are those of the run: t = 0 at its start. `columns` has one array
    per output of `model`, (n,) or (n, elements), in the unit of the port. Exact at the recorded
    times; in between held (`HOLD`) or, for real outputs, interpolated (`LINEAR`; a parameter, too).
    ValueError says which column is missing, unknown or of a wrong shape.
    """
    outputs = {v.name: v for v in model.variables if v.causality == "output"}
    for what, names in (("missing", set(outputs) - set(columns)), ("unknown", set(columns) - set(outputs))):
        if names:
            raise ValueError(f"recording of {model.name!r}: {what} columns {', '.join(sorted(names))}; outputs are {', '.join(outputs)}")
    times = np.asarray(times, dtype=np.float64)
    if times.ndim != 1 or len(times) == 0 or not np.all(np.diff(times) > 0.0):
        raise ValueError(
            f"recording of {model.name!r}: times must be one increasing array of at least one instant; found shape {times.shape}"
        )
    blocks = [times[:, None]]
    for v in _in_table_order(list(outputs.values())):
        block = np.asarray(columns[v.name], dtype=np.float64)
        if block.shape not in {(len(times), *v.shape), (len(times), len(v.element_names))}:
            raise ValueError(f"recording of {model.name!r}: {v.name} has shape {block.shape}, expected {(len(times), *v.shape)}")
        blocks.append(block.reshape(len(times), -1))
    specification = {
        "name": name or f"replay_of_{model.name}",
        "stands_for": model.name,
        "interpolation": interpolation,
        "variables": [_as_json(v) for v in model.variables if v.causality in ("input", "output")],
    }
    return from_specification(specification, np.ascontiguousarray(np.hstack(blocks)))


def from_specification(specification: dict[str, Any], rows: FloatArray) -> ReplayModel:
    """Make the model from its specification (plain data, as an FMU carries it) and the rows of its table."""
    ports = tuple(Variable(**{**v, "shape": tuple(v["shape"]), "depends_on": None}) for v in specification["variables"])
    outputs = [v for v in ports if v.causality == "output"]
    for v in outputs:
        if len(v.shape) > 1:
            raise ValueError(f"output {v.name!r} has shape {v.shape}; a recording holds scalars and vectors")
    ordered = _in_table_order(outputs)
    names = ("t", *(element for v in ordered for element in v.element_names))
    init, step = _functions(ordered)
    stands_for = specification["stands_for"]
    variables = (
        *(_replace(v, depends_on=()) if v.causality == "output" else v for v in ports),
        Variable(
            "recording",
            "parameter",
            f"Recorded outputs: columns {', '.join(names[:4])}{', ...' if len(names) > 4 else ''} (all: see the documentation)",
            shape=(len(names),),
            kind="table",
        ),
        Variable(
            "interpolation",
            "parameter",
            "Between recorded times: 0 = hold the last value, 1 = straight line (real outputs)",
            start=specification["interpolation"],
            minimum=0,
            maximum=1,
            kind="integer",
        ),
        Variable("time_offset", "parameter", "Recorded time at the start of the run", "s"),
        Variable("replay_time", "state", "Recorded time looked up last", "s"),
        Variable("replay_first", "state", "First recorded time", "s"),
        Variable("replay_last", "state", "Last recorded time", "s"),
        Variable("replay_row", "state", "Row at or before the time looked up", kind="integer"),
        Variable("replay_weight", "state", "Weight of the row after it"),
    )
    return ReplayModel(
        specification["name"],
        f"Recorded outputs of {stands_for}, in place of it; its inputs are ignored",
        variables,
        init,
        step,
        ERRORS,
        {"recording": rows},
        names,
        specification,
    )


@kernel
def locate(s: Record, columns: int, time: float) -> int:
    """Find row and weight of a recorded time [s], `columns` of the recording given; the status is 0, 1 outside of it, 2 empty."""
    rows = int(s.recording_rows)
    if rows == 0:
        return 2
    s.replay_time = time
    s.replay_first = cell(s.recording_at, rows, columns, 0, 0)
    s.replay_last = cell(s.recording_at, rows, columns, rows - 1, 0)
    if time < s.replay_first - SAME_TIME or time > s.replay_last + SAME_TIME:
        return 1
    row = row_at(s.recording_at, rows, columns, time + SAME_TIME, int(s.replay_row))
    s.replay_row = row
    s.replay_weight = 0.0
    if row < rows - 1:
        before, after = cell(s.recording_at, rows, columns, row, 0), cell(s.recording_at, rows, columns, row + 1, 0)
        if s.interpolation == LINEAR and time > before + SAME_TIME:
            s.replay_weight = (time - before) / (after - before)
    return 0


@kernel
def real_value(s: Record, columns: int, column: int) -> float:
    """Value of a table column at the row and weight found by `locate`."""
    row = int(s.replay_row)
    value = float(cell(s.recording_at, s.recording_rows, columns, row, column))
    if s.replay_weight > 0.0:
        value += s.replay_weight * (float(cell(s.recording_at, s.recording_rows, columns, row + 1, column)) - value)
    return value


@kernel
def held_value(s: Record, columns: int, column: int) -> int:
    """Value of a table column at the row found by `locate`, as a whole number."""
    return int(cell(s.recording_at, s.recording_rows, columns, int(s.replay_row), column))


def _functions(outputs: list[Variable]) -> tuple[Callable[..., int], Callable[..., int]]:
    """`init` and `step` for outputs in table order."""
    columns = 1 + sum(len(v.element_names) for v in outputs)
    column = 1
    writers: list[Callable[[Record], None]] = []
    for (array, whole), make in _WRITERS.items():
        group = [v for v in outputs if (bool(v.shape), v.kind != "real") == (array, whole)]
        writers.append(make(tuple(v.name for v in group), columns, column) if group else _nothing)
        column += sum(len(v.element_names) for v in group)
    write_0, write_1, write_2, write_3 = writers

    def look_up(s: Record, time: float) -> int:
        status = locate(s, columns, time)
        if status == 0:
            write_0(s)
            write_1(s)
            write_2(s)
            write_3(s)
        return status

    look_up = kernel(look_up)

    def init(s: Record) -> int:
        for row in range(int(s.recording_rows) - 1):
            if cell(s.recording_at, s.recording_rows, columns, row + 1, 0) <= cell(s.recording_at, s.recording_rows, columns, row, 0):
                s.replay_row = row
                return 3
        return look_up(s, s.time_offset)

    def step(s: Record, t: float, h: float) -> int:
        return look_up(s, t + h + s.time_offset)

    return init, step


try:
    from numba import literal_unroll as literal_unroll  # noqa: PLC0414  # `correction` imports it from here
except ImportError:

    def literal_unroll(container: _T) -> _T:
        """Numba's way of looping over field names of different types; in plain Python any loop does."""
        return container


@kernel
def _nothing(s: Record) -> None:
    """No outputs of that kind."""


def _real_scalars(names: tuple[str, ...], columns: int, first: int) -> Callable[[Record], None]:
    def write(s: Record) -> None:
        column = first
        for name in literal_unroll(names):
            s[name] = real_value(s, columns, column)
            column += 1

    return kernel(write)


def _real_vectors(names: tuple[str, ...], columns: int, first: int) -> Callable[[Record], None]:
    def write(s: Record) -> None:
        column = first
        for name in literal_unroll(names):
            vector = s[name]
            for i in range(len(vector)):
                vector[i] = real_value(s, columns, column)
                column += 1

    return kernel(write)


def _whole_scalars(names: tuple[str, ...], columns: int, first: int) -> Callable[[Record], None]:
    def write(s: Record) -> None:
        column = first
        for name in literal_unroll(names):
            s[name] = held_value(s, columns, column)
            column += 1

    return kernel(write)


def _whole_vectors(names: tuple[str, ...], columns: int, first: int) -> Callable[[Record], None]:
    def write(s: Record) -> None:
        column = first
        for name in literal_unroll(names):
            vector = s[name]
            for i in range(len(vector)):
                vector[i] = held_value(s, columns, column)
                column += 1

    return kernel(write)


_WRITERS = {(False, False): _real_scalars, (True, False): _real_vectors, (False, True): _whole_scalars, (True, True): _whole_vectors}
"""(is a vector, is whole) -> maker of the kernel that writes such outputs; also the order of the columns."""


def _in_table_order(outputs: list[Variable]) -> list[Variable]:
    order = list(_WRITERS)
    return sorted(outputs, key=lambda v: order.index((bool(v.shape), v.kind != "real")))


def _as_json(v: Variable) -> dict[str, Any]:
    return {**asdict(v), "start": v.start_values.tolist(), "shape": list(v.shape), "depends_on": None}


def _replace(v: Variable, **changes: Any) -> Variable:
    return Variable(**{**{name: getattr(v, name) for name in v.__dataclass_fields__}, **changes})
