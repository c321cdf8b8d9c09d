"""How the calls of a version of FMI look: names, arguments, C types. `fmi2` and `fmi3` say it; when calls are made is the same for both."""

from __future__ import annotations

import ctypes
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

Kind = Literal["real", "integer", "boolean", "string"]
Call = Callable[..., None]
"""`Instance.call`: full name of a function, its arguments after the instance; `CallFailed` unless it returns OK or warning."""

POINTER, COUNT, NUMBER = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double
_SUFFIXES = {"posix": (".so", ".dylib"), "nt": (".dll",)}


class CallFailed(Exception):  # noqa: N818  # its text says what failed
    """An FMI call that did not return OK or warning; after a `fatal` one the instance takes no further call."""

    def __init__(self, text: str, fatal: bool = False) -> None:
        super().__init__(text)
        self.fatal = fatal


class Type(NamedTuple):
    """A type of variables."""

    name: str
    """In the names of the functions that get and set it."""
    c: Any
    kind: Kind


class States(NamedTuple):
    """Names of the functions for states."""

    get: str
    set: str
    free: str
    size: str
    serialise: str
    deserialise: str


class Calls(ABC):
    """The library of one FMU. Only what is called is looked for in it, so that one with gaps can be tried, too."""

    prefix: str
    """What the names of the functions begin with."""
    platform: str
    """Name of the folder with the library for this machine."""
    types: ClassVar[Mapping[str, Type]]
    """By the name in the model description; variables of other types are left alone."""
    signatures: ClassVar[Mapping[str, tuple[Any, ...]]]
    """C types of the arguments after the instance, by full name; the functions that get and set are as `access`."""
    access: tuple[Any, ...]
    states: States
    functions: tuple[str, ...]
    """All that the standard wants a co-simulation FMU to export."""

    def __init__(self, folder: Path, description: Any, log: list[str]) -> None:
        """Load the library of the FMU unpacked in `folder`; its messages go to `log`. `CallFailed` if it cannot be loaded."""
        self.folder, self.description, self._log = folder, description, log
        self.remark = ""
        """What is allowed in the calls made so far, but worth knowing."""
        place = folder / "binaries" / self.platform
        names = [description.coSimulation.modelIdentifier + suffix for suffix in _SUFFIXES[os.name]]
        found = [place / name for name in names if (place / name).is_file()]
        if not found:
            there = sorted(p.name for p in (folder / "binaries").glob("*"))
            raise CallFailed(f"no binary binaries/{self.platform}/{names[0]}; there are binaries for {', '.join(there) or 'no platform'}")
        here = Path.cwd()
        try:
            os.chdir(place)  # some libraries find others that they need by the working directory
            self._library = _with_neighbours(found[0])
        except OSError as error:
            raise CallFailed(f"the library cannot be loaded: {error}") from None
        finally:
            os.chdir(here)

    @property
    def tolerance(self) -> tuple[bool, float]:
        """Whether the default experiment names a tolerance of the solver, and which."""
        default = self.description.defaultExperiment
        named = default is not None and default.tolerance is not None
        return named, float(default.tolerance) if named else 0.0

    def missing(self) -> list[str]:
        """Functions that the library should export and does not."""
        return [name for name in self.functions if not hasattr(self._library, name)]

    def function(self, name: str, result: Any = ctypes.c_int) -> Any:
        """A function by its full name; `CallFailed` if the library does not export it."""
        try:
            found = self._library[name]
        except AttributeError:
            raise CallFailed(f"the library does not export {name}") from None
        found.restype = result
        found.argtypes = (POINTER, *self.signatures.get(name, self.access))
        return found

    def version(self) -> str:
        """Which version of FMI the library says it has."""
        function = self._library[f"{self.prefix}GetVersion"]
        function.restype, function.argtypes = ctypes.c_char_p, ()
        return bytes(function() or b"").decode("utf-8", "replace")

    @abstractmethod
    def instantiate(self, name: str) -> int | None:
        """Address of a new instance, if there is one."""

    @abstractmethod
    def enter(self, call: Call, start: float) -> None:
        """Enter initialisation; `start` in s."""

    @abstractmethod
    def step(self, call: Call, t: float, h: float, final: bool) -> None:
        """From `t` to `t + h` [s]; `final`: no state of before `t` will be set any more."""

    @abstractmethod
    def room(self, values: int) -> tuple[int, ...]:
        """What a call that gets or sets is told about the number of values, after the pointer to them."""

    def free(self, instance: int) -> None:
        """Free an instance; the library stays loaded for the others."""
        self.function(f"{self.prefix}FreeInstance", None)(instance)


def _with_neighbours(library: Path) -> ctypes.CDLL:
    """A library, and before it those beside it that it needs, as a run loads it (`orchestration.slaves.fmi`, which is not at hand here)."""
    kept: dict[Path, ctypes.CDLL] = {}
    wanted = [library]
    while wanted:
        try:
            kept[wanted[-1]] = ctypes.CDLL(str(wanted[-1]))
            wanted.pop()
        except OSError as error:
            beside = library.parent / str(error).partition(":")[0]  # as the loader of Linux words it
            if beside in (*kept, *wanted) or not beside.is_file():
                raise
            wanted.append(beside)
    return kept[library]
