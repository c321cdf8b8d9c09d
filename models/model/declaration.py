"""How a model is declared, and how the one source of it runs plain or compiled.

A model is a tuple of `Variable` plus two plain functions::

    def init(s: Record) -> int: ...                        # states and outputs from parameters and inputs
    def step(s: Record, t: float, h: float) -> int: ...    # from t to t + h, inputs held

All data of an instance live in ONE aligned numpy record `s` (a C struct), so the complete state
of a component is its bytes; only tables stand beside it, which are never changed. The two functions
return a status: 0, or the index of a message in `Model.errors`. They allocate nothing: scalar loops
over record fields, scratch kept in the record.
The same two functions run in plain Python, compiled in process, and inside an FMU.
"""

from __future__ import annotations

import string
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from robomill.models.model.kernels import COMPILER_OPTIONS, tell_numba
from robomill.models.model.kernels import kernel as kernel  # noqa: PLC0414  # who declares a model takes it from here
from robomill.models.model.table import Table, from_rows
from robomill.models.model.units import EXPECTED, unit_of

Causality = Literal["input", "output", "parameter", "state"]
Kind = Literal["real", "integer", "boolean", "table"]
Record = Any
"""A `numpy.record` (plain Python) or a Numba record (compiled); its fields are the declared variables."""

FloatArray = npt.NDArray[np.float64]

RESERVED_NAMES = frozenset(dir(np.record)) | frozenset(dir(np.recarray))


@dataclass(frozen=True)
class Variable:
    """One declared variable of a model.

    Arrays have a `shape`; their elements are called `name[1]`, `name[2]` or `name[1,2]` outside
    (counted from one, as the axes of a robot are). A `table` is a parameter of `shape` (columns,) with any
    number of rows, loaded from a ``.npy`` file. The record holds `<name>_rows`, their number, and `<name>_at`, their
    address: see `models.model.table_access`.
    """

    name: str
    causality: Causality
    description: str
    unit: str = "1"
    shape: tuple[int, ...] = ()
    start: float | Sequence[Any] | FloatArray = 0.0
    minimum: float | None = None
    maximum: float | None = None
    kind: Kind = "real"
    display_unit: str | None = None
    depends_on: tuple[str, ...] | None = None
    """Outputs only: the inputs that this output is an instantaneous function of. None = all inputs."""
    effect: bool = False
    """Parameters only: an effect of the diagnosis catalogue, off at its start value of zero."""
    tunable: bool = False
    """Parameters only: `step` reads it afresh each time, so it may change during a run. Otherwise it is fixed."""

    def __post_init__(self) -> None:
        """Refuse what would only fail later: bad names, unknown units, starts out of shape or bounds."""
        if not self.name.isidentifier() or self.name in RESERVED_NAMES:
            raise ValueError(f"variable {self.name!r}: not usable as a record field; choose an identifier that numpy.record does not own")
        for unit in filter(None, (self.unit, self.display_unit)):
            try:
                unit_of(unit)
            except ValueError as error:
                raise ValueError(f"variable {self.name!r}: {error}; {EXPECTED}") from None
        if unit_of(self.unit).factor != 1.0 or unit_of(self.unit).offset != 0.0:
            raise ValueError(f"variable {self.name!r}: unit {self.unit!r} is not SI; use it as display_unit")
        if self.kind == "table" and (self.causality != "parameter" or len(self.shape) != 1):
            raise ValueError(f"variable {self.name!r}: a table is a parameter of shape (columns,); found {self.causality} of {self.shape}")
        if not self.description:
            raise ValueError(f"variable {self.name!r}: a description is missing")
        if self.kind != "table":
            start = self.start_values
            for bound, outside in ((self.minimum, np.less), (self.maximum, np.greater)):
                if bound is not None and bool(np.any(outside(start, bound))):
                    raise ValueError(f"variable {self.name!r}: start {self.start} violates the bound {bound} {self.unit}")
            if self.effect and bool(np.any(start != 0.0)):
                raise ValueError(f"variable {self.name!r}: an effect is off, that is zero, by default")

    @cached_property
    def start_values(self) -> FloatArray:
        """Start values as a read-only array of `shape` [unit]; a scalar start fills the array."""
        given = np.asarray(self.start, dtype=np.float64)
        if given.ndim and given.shape != self.shape:
            raise ValueError(f"variable {self.name!r}: start has shape {given.shape}, declared is {self.shape}")
        values = np.full(self.shape, given)
        values.flags.writeable = False
        return values

    @property
    def dtype(self) -> type[np.float64] | type[np.int64]:
        """Storage type in the record: float64 for reals and tables, int64 for integers and booleans."""
        return np.float64 if self.kind in ("real", "table") else np.int64

    @cached_property
    def element_names(self) -> tuple[str, ...]:
        """Names of the scalar elements in C order: `x`, or `x[1]`, `x[2]`, or `x[1,1]`, `x[1,2]`."""
        if not self.shape:
            return (self.name,)
        return tuple(f"{self.name}[{','.join(str(i + 1) for i in index)}]" for index in np.ndindex(*self.shape))


_PAGE = 512
"""Words of a page of memory: 4096 bytes, as most processors have them."""


def _place(v: Variable) -> tuple[bool, int, bool]:
    """Sort key of a variable in the record."""
    return v.kind == "table", ("input", "output", "parameter", "state").index(v.causality), v.dtype is np.int64


@dataclass(frozen=True)
class Model:
    """A component's model: its variables, its two functions and its error messages.

    `errors[i]` is the message of status i; `{field}` and `{field[0]}` in it are replaced from the
    record and `{t}` by the time in s. An array of integers is shown up to its last one that is not
    zero. `errors[0]` is empty.
    """

    name: str
    description: str
    variables: tuple[Variable, ...]
    init: Callable[[Record], int]
    step: Callable[[Record, float, float], int]
    errors: tuple[str, ...] = ("",)
    default_tables: dict[str, FloatArray] = field(default_factory=dict, compare=False)
    """Rows that a table holds until a file is named; a table without an entry starts empty."""

    def __post_init__(self) -> None:
        """Refuse duplicate names and dependencies on inputs that do not exist."""
        names = [v.name for v in self.variables]
        doubles = sorted({n for n in names if names.count(n) > 1})
        if doubles:
            raise ValueError(f"model {self.name!r}: declared twice: {', '.join(doubles)}")
        known = {v.name for v in self.variables if v.causality == "input"}
        for v in self.variables:
            unknown = set(v.depends_on or ()) - known
            if unknown:
                raise ValueError(
                    f"model {self.name!r}: output {v.name!r} depends on {', '.join(sorted(unknown))}; inputs are {', '.join(sorted(known))}"
                )

    def variable(self, name: str) -> Variable:
        """The declared variable of that name; KeyError lists what there is."""
        for v in self.variables:
            if v.name == name:
                return v
        raise KeyError(f"model {self.name!r} has no variable {name!r}; it has {', '.join(v.name for v in self.variables)}")

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """The aligned record type (a C struct) that holds everything an instance knows: words of eight bytes.

        Order: inputs, outputs (reals first in each, so that they are flat float64 images), parameters,
        states, tables (last: number and address of their rows), each in the order of declaration.
        """
        fields: list[tuple[Any, ...]] = []
        for v in sorted(self.variables, key=_place):
            if v.kind == "table":
                fields += [(f"{v.name}_rows", np.int64), (f"{v.name}_at", np.int64)]
            else:
                fields.append((v.name, v.dtype, v.shape))
        return np.dtype(fields, align=True)

    @cached_property
    def built_in(self) -> dict[str, Table]:
        """Every table as it is until rows are loaded."""
        tables = [v for v in self.variables if v.kind == "table"]
        return {v.name: self.table(v.name, self.default_tables.get(v.name, np.zeros((0, *v.shape)))) for v in tables}

    def table(self, name: str, rows: Any) -> Table:
        """`rows` (n, columns) as a table `name` of this model; ValueError says what does not fit."""
        try:
            return from_rows(rows, self.variable(name).shape[0])
        except ValueError as error:
            raise ValueError(f"table {name!r} of {self.name!r}: {error}") from None

    def new(self) -> npt.NDArray[np.void]:
        """A fresh instance: a one-element array of `dtype` with every variable at its start value."""
        data = np.zeros(1, self.dtype)
        words = data.view(np.int64)
        for first, content in self._starts:
            words[first : first + len(content)] = content
        _keep(data, self.built_in)
        return data

    @cached_property
    def _starts(self) -> list[tuple[int, npt.NDArray[np.int64]]]:
        """What `new` copies, as a system makes many instances of few models: first word and words of each page that is not all zero.

        The others stay as the system gives them, and take no time and no memory before they are written to: millions of dexels, say.
        """
        data = np.zeros(1, self.dtype)
        for v in self.variables:
            if v.kind == "table":
                point(data, v.name, self.built_in[v.name])
            else:
                data[v.name] = v.start_values
        words = data.view(np.int64)
        pages = ((i, words[i : i + _PAGE]) for i in range(0, len(words), _PAGE))
        return [(i, page.copy()) for i, page in pages if page.any()]

    def load_table(self, data: npt.NDArray[np.void], name: str, rows: FloatArray) -> None:
        """Let the record of `new` have `rows` (n, columns) as its table `name`; ValueError says what does not fit."""
        table = self.table(name, rows)
        point(data, name, table)
        _keep(data, table)

    def message(self, status: int, s: Record, t: float) -> str:
        """The text of a non-zero status, with the values of the record put in."""
        if not 0 < status < len(self.errors):
            return f"{self.name}: status {status} without a message"
        return f"{self.name}: {_RecordFormatter().vformat(self.errors[status], (), _Fields(s, t))}"

    def plain(self) -> tuple[Callable[..., int], Callable[..., int]]:
        """`init` and `step` as they stand: for debugging, coverage and machines without Numba."""
        return self.init, self.step

    def compiled(self, cache: bool = True) -> tuple[Callable[..., int], Callable[..., int]]:
        """`init` and `step` compiled by Numba for this record type (cached on disk; see `models.model.cache`)."""
        return _compiled(self.init, self.step, cache)


_COMPILED: dict[tuple[object, object], tuple[Callable[..., int], Callable[..., int]]] = {}


def _compiled(init: Any, step: Any, cache: bool) -> tuple[Callable[..., int], Callable[..., int]]:
    """The dispatchers of both functions, made once per process."""
    key = (init, step)
    if key not in _COMPILED:
        from numba import njit

        from robomill.models.model.cache import compiled_before, compiled_code
        from robomill.models.model.calls import check_kernels

        if not compiled_before(init, step):  # the same sources were checked then
            check_kernels(init, step)
        tell_numba()
        options = {**COMPILER_OPTIONS, "nogil": True, "cache": cache}
        with compiled_code(init, step):
            _COMPILED[key] = njit(**options)(init), njit(**options)(step)
    return _COMPILED[key]


def point(data: npt.NDArray[np.void], name: str, table: Table) -> None:
    """Let a record have a table; the caller keeps the table as long as the record."""
    data[f"{name}_rows"], data[f"{name}_at"] = len(table.rows), table.rows.ctypes.data


def _keep(data: npt.NDArray[np.void], tables: object) -> None:
    """Keep tables as long as a record."""
    weakref.finalize(data, id, tables).atexit = False  # what is called in the end does nothing; until then it has its argument


def record(data: npt.NDArray[np.void]) -> Record:
    """The record `s` of a one-element array, as `init` and `step` take it; it shares memory with `data`."""
    return data.view(np.recarray)[0]


class _Fields(dict[str, Any]):
    """Fields of a record as a mapping for `str.format`."""

    def __init__(self, s: Record, t: float) -> None:
        super().__init__(t=t)
        self._record = s

    def __missing__(self, key: str) -> Any:
        return getattr(self._record, key)


class _RecordFormatter(string.Formatter):
    """`str.format` whose mapping may be lazy."""

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Any) -> Any:
        return kwargs[key]

    def format_field(self, value: Any, format_spec: str) -> Any:
        if isinstance(value, np.ndarray) and value.dtype.kind == "i":
            shown = np.trim_zeros(value.ravel(), "b")
            return f"[{' '.join(str(int(x)) for x in shown)}]"
        return super().format_field(value, format_spec)
