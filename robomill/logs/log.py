"""A log of another program: columns by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.orchestration.errors import OrchestrationError, available, unknown

FloatArray = npt.NDArray[np.float64]


class LogError(OrchestrationError):
    """A log or its mapping cannot be used; the text says what, value, expected, available, remedy."""


@dataclass(frozen=True)
class Log:
    """Columns of a log by name."""

    file: Path
    names: tuple[str, ...]
    """Every column that there is."""
    fetch: Callable[[str], FloatArray] = field(repr=False)
    """Numbers [n] of a column; nan where a record lacks the value. LogError if they are no numbers."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units that the log itself states, as it spells them."""
    clocks: Mapping[str, str] = field(default_factory=dict)
    """Formats where channels have clocks of their own: the column with the time [s] of each column."""
    texts: Callable[[str], npt.NDArray[np.str_]] | None = field(default=None, repr=False)
    """Texts [n] of a column, in formats that have such columns."""
    epoch: int | None = None
    """Time of day at which the clocks of the log are zero [ns since 1970-01-01 UTC]; None: it does not say."""
    remark: str = ""
    """What is in the file and cannot be read, said where a column is missing."""

    def __getitem__(self, name: str) -> FloatArray:
        self._known(name, self.names)
        return self.fetch(name)

    def states(self, name: str) -> npt.NDArray[Any]:
        """Numbers of a column, or its texts where they are no numbers."""
        self._known(name, self.names)
        try:
            return self.fetch(name)
        except LogError:
            if self.texts is None:
                raise
            return self.texts(name)

    def elements(self, name: str) -> list[str]:
        """The column of that name, or all columns `name[1]`, `name[2]`, ... (`name[1,1]`, ...) in order. LogError if there is none."""
        if name in self.names:
            return [name]
        found = [n for n in self.names if n.rpartition("[")[0] == name]
        if not found:
            array = name.rpartition("[")[0]
            members = [n for n in self.names if array and n.rpartition("[")[0] == array]
            self._known(name, members or dict.fromkeys(n.rpartition("[")[0] if n.endswith("]") else n for n in self.names))
        return found

    def _known(self, name: str, names: Iterable[str]) -> None:
        if name not in self.names:
            raise LogError(f"{self.file}: {unknown('column', name, names)}{self.remark and '; '}{self.remark}")


def no_doubles(file: Path, names: Iterable[str]) -> None:
    """LogError for columns that are named twice."""
    listed = list(names)
    doubles = sorted({n for n in listed if listed.count(n) > 1})
    if doubles:
        raise LogError(f"{file}: columns named twice: {available(doubles)}; give each column a name of its own")


def missing_package(file: Path, what: str, package: str, extra: str, instead: str) -> LogError:
    """The error for a format whose package is not installed."""
    return LogError(
        f"{file}: reading {what} needs the package {package!r}, which is not installed; "
        f"install it with `pip install {package}` (or robomill[{extra}]), or {instead}"
    )
