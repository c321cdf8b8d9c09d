"""Keys of the tables in files that people write, each declared once.

A reader checks and reads a table by its declaration, and docs/reference/formats is written from it::

    class ScanKeys(Keys):               # with a docstring that says what the table is
        depth = required(quantity("m"), "how far the programmed plane lies below the top")
        margin = default(0, quantity("m"), "what is left out at both ends in x")
        title = optional(text(), "name beside the figures")

    ScanKeys.of(entry)                   # refuses unknown keys, and a table without `depth`
    depth = ScanKeys.depth.of(entry)    # float, m
    title = ScanKeys.title.of(entry)    # str, or None where the table has no such key

A nested table is a key of the kind `table`, `tables` or `each`, so that one declaration at the top leads to all others.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from robomill.orchestration.system.entries import Choice, Entry, Made
from robomill.orchestration.system.written import Written

T = TypeVar("T")
_NOTHING = object()
"""Stands for the default of a key that has none."""


@dataclass(frozen=True)
class Kind(Generic[T]):
    """What a value is: how it is read, and what the reference says of it."""

    read: Callable[[Entry], T]
    what: str
    """What is written, in words: `text`, `length or 0`."""
    unit: str = ""
    """SI unit that a quantity is read in; any unit of the same dimension may be written."""
    allowed: Collection[str] = ()
    """The texts that may be written, where only some may."""
    nested: type[Any] | None = None
    """`Keys`, or dataclass, of the table below."""
    path: str = ""
    """How the table below is written from its key on: `` for `[key]`, `.NAME` for `[key.NAME]`, `[]` for `[[key]]`."""


class Key(Generic[T]):
    """A key of a table; `of` reads its value."""

    def __init__(self, kind: Kind[T], meaning: str, start: Any, needed: bool, name: str) -> None:
        self.kind = kind
        self.meaning = meaning
        self.start = start
        """What it counts as where it is not written, as it would be written."""
        self.needed = needed
        self.name = name

    def __set_name__(self, owner: type[Any], name: str) -> None:
        self.name = self.name or name

    @property
    def has_default(self) -> bool:
        """Whether `start` is a value."""
        return self.start is not _NOTHING

    def of(self, table: Entry) -> T:
        """The value in the table, its default, or None. Raises the error of the file for a value that is not of the kind."""
        if self.name not in table and not self.has_default:
            return None  # type: ignore[return-value]  # T has None in it: see `optional`
        return self.kind.read(self.entry(table))

    def entry(self, table: Entry) -> Entry:
        """The entry as written, or one with the default in its place."""
        return table.get(self.name, self.start if self.has_default else None)


def required(kind: Kind[T], meaning: str, name: str = "") -> Key[T]:
    """A key that the table must have; `name` where it is no Python name, as `from`."""
    return Key(kind, meaning, _NOTHING, True, name)


def default(start: Any, kind: Kind[T], meaning: str, name: str = "") -> Key[T]:
    """A key that counts as `start`, as it would be written, where it is missing."""
    return Key(kind, meaning, start, False, name)


def optional(kind: Kind[T], meaning: str, name: str = "") -> Key[T | None]:
    """A key that reads as None where it is missing; the meaning says what that does."""
    return Key(kind, meaning, _NOTHING, False, name)  # type: ignore[arg-type]  # None is added


class Keys:
    """A table, declared as the class attributes of a subclass; its docstring says what the table is."""

    @classmethod
    def all(cls) -> dict[str, Key[Any]]:
        """The keys by name, in the order of declaration, those of base classes last."""
        return {key.name: key for base in cls.__mro__ for key in vars(base).values() if isinstance(key, Key)}

    @classmethod
    def of(cls, entry: Entry) -> Entry:
        """The entry, if it is a table with all needed keys and no unknown ones; else raises the error of the file."""
        keys = cls.all()
        return entry.keys({name for name, key in keys.items() if key.needed}, keys)


# Kinds


def text(blank: bool = False) -> Kind[str]:
    """A text; an empty one only if `blank`."""
    return Kind(lambda e: e.text(blank=blank), "text")


def texts() -> Kind[tuple[str, ...]]:
    """A list of texts."""
    return Kind(Entry.texts, "list of texts")


def choice(names: Collection[Choice]) -> Kind[Choice]:
    """One of these texts."""
    return Kind(lambda e: e.choice(names), "text", allowed=names)


def folder_name() -> Kind[str]:
    """A text that a folder of results is called by."""
    return Kind(Entry.folder_name, "text, the name of a folder")


def flag() -> Kind[bool]:
    """True or false."""
    return Kind(Entry.flag, "true or false")


def count(least: int | None = None) -> Kind[int]:
    """A whole number."""
    return Kind(lambda e: e.count(least), "whole number" + ("" if least is None else f" from {least}"))


def number() -> Kind[float]:
    """A finite number without a unit."""
    return Kind(Entry.number, "number")


def positive() -> Kind[float]:
    """A finite number above zero, without a unit."""
    return Kind(Entry.positive, "positive number")


def quantity(unit: str) -> Kind[float]:
    """A number with a unit."""
    return Kind(lambda e: e.si(unit), "quantity", unit)


def vector(unit: str) -> Kind[tuple[float, float, float]]:
    """Three numbers with units."""
    return Kind(lambda e: e.vector(unit), "three quantities", unit)


def file() -> Kind[Path]:
    """An existing file, relative to the folder of the file that names it."""
    return Kind(Entry.file, "file, relative to this one")


def values() -> Kind[Written]:
    """A table `name = value` whose names are known to somebody else, such as the ports of a component."""
    return Kind(Entry.written, "table of `name = value`")


def parameters() -> Kind[dict[str, Written]]:
    """`component.parameter = value`."""
    return Kind(Entry.parameters, "table of `component.parameter = value`")


def anything(what: str, unit: str = "", allowed: Collection[str] = ()) -> Kind[Entry]:
    """An entry that the reader looks at itself; `what` says in words what it takes."""
    return Kind(lambda e: e, what, unit, allowed)


def table(keys: type[Keys]) -> Kind[Entry]:
    """A table with these keys."""
    return Kind(keys.of, "table", nested=keys)


def tables(keys: type[Keys], name: str = "NAME") -> Kind[dict[str, Entry]]:
    """A table of tables with these keys, by a `name` that the writer of the file gives."""
    return Kind(lambda e: {called: keys.of(entry) for called, entry in e.items()}, "tables", nested=keys, path=f".{name}")


def each(keys: type[Keys]) -> Kind[list[Entry]]:
    """A list of tables with these keys."""
    return Kind(lambda e: [keys.of(entry) for entry in e.each()], "list of tables", nested=keys, path="[]")


def made(cls: type[Made]) -> Kind[Made]:
    """A table with the fields of a dataclass."""
    return Kind(lambda e: e.made(cls), "table", nested=cls)


def named(kind: Kind[T], name: str = "NAME") -> Kind[Mapping[str, T]]:
    """A table `name = value` with values of one kind, by a `name` that the writer of the file gives."""
    return Kind(lambda e: {key: kind.read(value) for key, value in e.items()}, f"table of `{name} = {kind.what}`", kind.unit, kind.allowed)
