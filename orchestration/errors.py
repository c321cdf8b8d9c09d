"""The errors of this package, and the wording that several of them share."""

from __future__ import annotations

import signal
import traceback
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any


class OrchestrationError(Exception):
    """Base of all errors of this package; the text says what, value, expected, available, remedy."""

    def __reduce__(self) -> tuple[Any, ...]:
        """From one process to another with all that it knows: those that are made of more than a text could not be made of it again."""
        return _again, (type(self), self.args), self.__dict__


def _again(kind: type[OrchestrationError], args: tuple[Any, ...]) -> OrchestrationError:
    """An error of this kind with this text."""
    return kind.__new__(kind, *args)


class SystemFileError(OrchestrationError):
    """A system file cannot be read or says something that is not allowed."""


class SlaveError(OrchestrationError):
    """A component could not be loaded, configured, initialised or stepped.

    Remedy: the text of the component says what it cannot do; correct its inputs or parameters, or use another FMU.
    """


class PlacedError(SlaveError, ValueError):
    """A value that is not allowed; `place` (`file.toml:12`) is where a person wrote it, None if code set it."""

    def __init__(self, message: str, place: str | None = None) -> None:
        self.place = place
        super().__init__(message)


class WiringError(OrchestrationError):
    """The system cannot run as it is connected; `problems` holds each one."""

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(problems))


class IterationError(OrchestrationError):
    """A loop of components cannot be iterated or does not converge; `component` is the one to look at first."""

    def __init__(self, message: str, component: str) -> None:
        self.component = component
        super().__init__(message)


class ResultsError(OrchestrationError):
    """A folder with results cannot be read or written."""


class MissingPackageError(OrchestrationError, ImportError):
    """A package that is not installed with robomill itself is needed; the text names the command that installs it."""


class RunError(OrchestrationError):
    """A run ended early because of a component; everything up to then is recorded."""

    def __init__(self, message: str, component: str, time: float, folder: Path | None = None) -> None:
        self.component = component
        self.time = time
        """Time reached [s]: the last for which all outputs are there."""
        self.folder = folder
        super().__init__(message + (f"\nResults up to t = {time:.9g} s are in {folder}" if folder else ""))


class Interrupted(OrchestrationError):  # noqa: N818  # not a failure
    """A run was stopped from outside, by Ctrl-C or another signal; everything up to then is recorded."""

    def __init__(self, time: float, folder: Path | None = None, number: int = signal.SIGINT) -> None:
        self.time = time
        """Time reached [s]: the last for which all outputs are there."""
        self.folder = folder
        self.signal = int(number)
        """Number of the signal."""
        self.word = "the user" if number == signal.SIGINT else f"{signal.Signals(number).name} ({int(number)})"
        by = "" if number == signal.SIGINT else f" by {self.word}"
        super().__init__(f"interrupted{by} at t = {time:.9g} s" + (f"; results up to there are in {folder}" if folder else ""))


MAX_WRONG_NAME = 200
"""Characters of a name that does not exist that are shown, and compared with those that do: a file may hold one of any length."""


def shortened(text: str, most: int) -> str:
    """The first `most` characters, and three dots if there are more."""
    return text if len(text) <= most else text[:most] + "..."


def available(names: Iterable[str], limit: int = 40) -> str:
    """The names as a comma separated list, shortened after `limit`."""
    listed = list(names)
    more = f", ... ({len(listed)} in all)" if len(listed) > limit else ""
    return (", ".join(listed[:limit]) + more) or "none"


def unknown(what: str, name: str, names: Iterable[str]) -> str:
    """Sentence for a name that does not exist: closest matches first, then what is available."""
    import difflib  # a millisecond that only an error needs

    listed = list(names)
    name = shortened(name, MAX_WRONG_NAME)
    close = difflib.get_close_matches(name, listed, n=3, cutoff=0.6)
    hint = f" did you mean {' or '.join(repr(c) for c in close)}?" if close else ""
    return f"unknown {what} {name!r};{hint} available: {available(listed)}"


def not_there(what: str, file: Path) -> str:
    """Sentence for a TOML file that does not exist, or is a folder: which are there."""
    folder = file if file.is_dir() else file.parent
    near = sorted(f.name for f in folder.glob("*.toml")) if folder.is_dir() else []
    said = f"{file} is a folder; expected a {what}" if file.is_dir() else f"no {what} {file}"
    return f"{said}; TOML files in that folder: {', '.join(near) or 'none; correct the path'}"


def describe(error: BaseException) -> str:
    """The text of an error; for one of Python's own types, which nobody worded for users, also where it was raised."""
    if type(error).__module__ != "builtins":
        return str(error)
    return "\n" + "".join(traceback.format_exception(error)).rstrip()
