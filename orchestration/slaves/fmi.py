"""What FMI 2.0 and FMI 3.0 have in common for `fmu.FmuSlave`: one loaded library and its one instance.

`fmi2.Fmi2` and `fmi3.Fmi3` say how the calls of their standard look; when they are made is the same for both.
"""

from __future__ import annotations

import ctypes
import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import fmpy
import numpy as np
import numpy.typing as npt

from robomill.orchestration.errors import SlaveError
from robomill.orchestration.slaves.description import FmuDescription, Variable
from robomill.orchestration.slaves.native import BlockData
from robomill.orchestration.slaves.protocol import FloatArray, Scalar

WARNING, FATAL = 1, 4
"""Statuses: the largest that is no error; the one after which no call is allowed."""
STATUS = ("OK", "warning", "discard", "error", "fatal", "pending")
Call = tuple[str, tuple[Any, ...]]
"""A function without the prefix of the standard, and its arguments after the instance."""


class StateFunctions(NamedTuple):
    """Names of the functions for states."""

    get: str
    set: str
    free: str
    size: str
    serialise: str
    deserialise: str


class Group:
    """The inputs, or outputs, of one type: what one call moves."""

    def __init__(self, name: str, function: Any, places: Sequence[int], variables: Sequence[Variable], dtype: Any, counted: bool) -> None:
        """`places` are those of the elements in the flat image; `counted`: the call is told the number of values, too."""
        self.name, self.function, self.places = name, function, tuple(places)
        together = list(places) == list(range(places[0], places[0] + len(places)))
        self.place: Any = slice(places[0], places[0] + len(places)) if together else np.array(places, dtype=np.intp)
        """Index of the elements in the flat image."""
        self.ports = [p for v in variables for p in v.ports]
        self.references = np.array([v.reference for v in variables], dtype=np.uint32)
        self.buffer: npt.NDArray[Any] = np.zeros(len(places), dtype=dtype)
        count = (len(places),) if counted else ()
        self.arguments = (self.references.ctypes.data, len(variables), self.buffer.ctypes.data, *count)
        self._limits = _limits(self.buffer.dtype)

    def load(self, values: FloatArray) -> None:
        """Take the values of these elements from the flat image. SlaveError for one that the type cannot hold."""
        found = values[self.place]
        if self._limits is not None:
            low, high = self._limits
            for port, value in zip(self.ports, found.tolist(), strict=True):  # few: quicker than arrays of truth
                if not low <= value <= high:  # NaN, too
                    raise SlaveError(
                        f"input {port.name} = {value:.17g} does not fit {self.buffer.dtype.name}: expected {low:.17g} to {high:.17g}"
                    )
        self.buffer[:] = found


def _limits(dtype: np.dtype[Any]) -> tuple[float, float] | None:
    """Least and largest float64 that a type holds; None for one that holds all. What float64 cannot carry, the guard knows."""
    if dtype.kind in "iu":
        least, most = np.iinfo(dtype).min, np.iinfo(dtype).max
        return float(least), float(most) if int(float(most)) == most else float(np.nextafter(float(most), 0.0))
    return (float(np.finfo(dtype).min), float(np.finfo(dtype).max)) if dtype == np.float32 else None


class Fmi(ABC):
    """The functions of one FMU. `call` and the others return the status; what is wrong is for the caller to say."""

    prefix: str
    """What the names of the functions begin with."""
    state: StateFunctions
    instantiation: tuple[str, tuple[Any, ...]]
    """Name and argument types (ctypes) of the function that makes an instance."""
    access: tuple[Any, ...]
    """Argument types of the functions that set and get values."""
    arguments: ClassVar[Mapping[str, tuple[Any, ...]]]
    """Argument types of the other functions, after the instance."""
    dtypes: ClassVar[Mapping[str, Any]]
    """Type of a variable -> dtype of its values."""
    counted: bool
    """Whether `access` is told the number of values, too."""

    def __init__(self, description: FmuDescription, name: str, messages: deque[tuple[int, str]], final: bool) -> None:
        """Load the library, in which only what is called is looked for: some FMUs leave out functions that they do not need.

        What the instance logs goes to `messages` (status, text). SlaveError if the library cannot be loaded.

        `final`: no state of before the beginning of a step will be set any more (noSetFMUStatePriorToCurrentPoint).
        """
        self.description, self.name, self.messages, self.final = description, name, messages, int(final)
        self.instance = ctypes.c_void_p()
        make, arguments = self.instantiation
        try:
            self._library = self._opened()
            self.make = self.function(make, ctypes.c_void_p, *arguments)
            self._free = self.function("FreeInstance", None, ctypes.c_void_p)
            self.do_step = self.function("DoStep")
        except (OSError, AttributeError) as error:
            raise SlaveError(
                f"{description.file}: its binary cannot be loaded: {error}; use an FMU for this platform, with all libraries that it needs"
            ) from None

    def _opened(self) -> ctypes.CDLL:
        """The library; OSError if the system cannot load it."""
        here, library = Path.cwd(), self.description.library
        try:
            os.chdir(library.parent)  # some libraries find others that they need by the working directory
            return _with_neighbours(library)
        finally:
            os.chdir(here)

    def function(self, name: str, result: Any = ctypes.c_int, *arguments: Any) -> Any:
        """A function of the library, named without the prefix; AttributeError if it is not there."""
        found = self._library[self.prefix + name]
        found.restype = result
        found.argtypes = arguments or (ctypes.c_void_p, *self.arguments.get(name, self.access))
        return found

    @abstractmethod
    def instantiate(self) -> bool:
        """Make the instance; whether there is one."""

    @abstractmethod
    def enter(self, start: float, stop: float) -> Iterator[Call]:
        """The calls that enter initialisation, after the parameters are set; times in s, `stop` may be infinite."""

    @abstractmethod
    def parameter(self, variable: Variable, values: Sequence[Scalar]) -> Call:
        """The call that sets a parameter: all its elements."""

    @abstractmethod
    def choose_log(self, categories: Sequence[str]) -> None:
        """Ask for messages of these categories only."""

    def call(self, function: str, *arguments: Any) -> int:
        """Call a function, named without the prefix. SlaveError if the library has none."""
        try:
            status: int = self.function(function)(self.instance, *arguments)
        except AttributeError:
            raise SlaveError(
                f"component {self.name!r}: {self.description.file.name} has no function {self.prefix}{function}"
                "; export the FMU anew with all functions of the standard"
            ) from None
        return status

    def address(self, function: str) -> int:
        """Address of a function, named without the prefix."""
        return address(self._library[self.prefix + function])

    @abstractmethod
    def step(self, t: float, h: float) -> int:
        """From `t` to `t + h` [s]."""

    def groups(self, way: str, causality: str) -> list[Group]:
        """Inputs or outputs by type; `way` is Set or Get. SlaveError if the library has no function for one."""
        made = []
        for kind, places, variables in self.description.by_kind[causality]:
            name = f"{way}{kind}"
            try:
                function = self.function(name)
            except AttributeError:
                raise SlaveError(
                    f"{self.description.file}: its binary has no function {self.prefix}{name}"
                    "; export the FMU anew with all functions of the standard"
                ) from None
            made.append(Group(self.prefix + name, function, places, variables, self.dtypes[kind], self.counted))
        return made

    @abstractmethod
    def compiled(self, inputs: Sequence[Group], outputs: Sequence[Group]) -> Addresses | None:
        """What `orchestration.slaves.native` needs; None if this FMU can be called from Python only."""

    def free(self) -> None:
        """Free the instance."""
        self._free(self.instance)

    def unload(self) -> None:
        """Unload the library."""
        fmpy.freeLibrary(self._library._handle)

    def explain(self, function: str, status: int) -> str:
        """What the call of a function, named with the prefix, did that returned this status."""
        return f"returned {status} ({STATUS[status] if 0 <= status < len(STATUS) else 'not a status of FMI'})"

    def ends(self, how: str) -> str:
        """What a step did that asks for the end of the simulation."""
        return (
            f"asks for the end of the simulation ({how}); if that is meant, give the run an end before it: "
            "stop, or an output that says so as stop_when"
        )

    def in_parts(self) -> str:
        """What helps a component for which a step is too long."""
        return f"a smaller step may help, or rate = 2 in [components.{self.name}]"


class Addresses(NamedTuple):
    """Addresses of the functions and buffers of an instance, as `orchestration.slaves.native.Native` wants them."""

    instance: int
    step: int
    inputs: list[BlockData]
    outputs: list[BlockData]
    keep: Any = None
    """What must live as long as the addresses are used."""


def _with_neighbours(library: Path) -> ctypes.CDLL:
    """A library, and before it those beside it that it needs: the system does not look there unless the library says so (RPATH)."""
    kept: list[ctypes.CDLL] = []
    wanted = [library]
    while True:
        try:
            kept.append(ctypes.CDLL(str(wanted[-1])))
        except OSError as error:
            beside = library.parent / str(error).partition(":")[0]  # as the loader of Linux words it
            if any(k._name == str(beside) for k in kept):
                raise OSError(f"{error}; it stands beside it, but does not say its own name (SONAME), so it is not taken for it") from None
            if beside in wanted or not beside.is_file():
                raise
            wanted.append(beside)
            continue
        if wanted.pop() == library:
            break
    *others, found = kept
    for other in others:  # it keeps them from now on: they go with it
        fmpy.freeLibrary(other._handle)
    return found


def address(function: Any) -> int:
    """Address of a C function that ctypes knows."""
    return ctypes.cast(function, ctypes.c_void_p).value or 0
