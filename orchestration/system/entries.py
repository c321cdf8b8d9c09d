"""Entries of TOML files that people write: read with units, and refused with file, line, key, what was found and what is expected."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from robomill.orchestration.errors import unknown
from robomill.orchestration.system.parameters import Convert, quantity, same_unit_only
from robomill.orchestration.system.toml_lines import Key, key_lines
from robomill.orchestration.system.toml_text import parse
from robomill.orchestration.system.written import Written

Made = TypeVar("Made")
Choice = TypeVar("Choice", bound=str)


@dataclass(frozen=True)
class TomlFile:
    """A file: its content, where in it each value stands, and what the reader of its kind needs."""

    name: str
    """The file as error texts call it."""
    table: Mapping[str, Any]
    lines: Mapping[Key, int]
    folder: Path
    """What paths in it are relative to."""
    error: type[Exception]
    """What is raised for something wrong in it."""
    convert: Convert


@dataclass(frozen=True)
class Entry:
    """A value of a file and the key that leads to it. Its methods raise the error of the file where the value is not what they expect."""

    content: TomlFile
    value: Any
    key: Key = ()

    @staticmethod
    def load(file: Path, error: type[Exception], convert: Convert = same_unit_only, name: str | None = None) -> Entry:
        """The whole of `file`; `error` with file, line and what is wrong where it is no TOML (a key that is there twice, too)."""
        try:
            return Entry.read(file.read_text(encoding="utf-8"), name or str(file), file.parent, error, convert)
        except UnicodeDecodeError as problem:
            raise error(f"{name or file}: not valid TOML: not UTF-8: {problem}; save it in the encoding UTF-8") from None

    @staticmethod
    def read(text: str, name: str, folder: Path, error: type[Exception], convert: Convert = same_unit_only) -> Entry:
        """The whole of a text, as `load` does it; paths in it are relative to `folder`."""
        text = text.removeprefix("\ufeff").replace("\r\n", "\n")
        try:
            table = parse(text)
        except ValueError as problem:  # no TOML, or an integer of thousands of digits
            raise error(f"{name}: not valid TOML: {problem}") from None
        return Entry(TomlFile(name, table, key_lines(text), folder, error, convert), table)

    @property
    def name(self) -> str:
        """`[workpiece] size`, `condition 2 'along x': load`; nothing for the whole file."""
        head, *rest = self.key or ("",)
        if rest and isinstance(rest[0], int):
            listed, i = self.content.table.get(str(head)), rest[0]
            item = listed[i] if isinstance(listed, list) and isinstance(listed[i], dict) else {}
            called = item.get("name", item.get("port"))
            head, rest = f"{head} {i + 1}{f' {called!r}' if isinstance(called, str) else ''}{':' if rest[1:] else ''}", rest[1:]
        elif rest or (head and isinstance(self.value, dict)):
            head = f"[{head}]"
        return " ".join([str(head), *([".".join(map(str, rest))] if rest else [])])

    @property
    def line(self) -> int | None:
        """Line of the key, or of the nearest table above it."""
        lines = self.content.lines
        return next((lines[self.key[:n]] for n in range(len(self.key), 0, -1) if self.key[:n] in lines), None)

    @property
    def place(self) -> str:
        """`file.toml:12`, or the file alone where no part of the key is in it."""
        return f"{self.content.name}:{self.line}" if self.line else self.content.name

    def fail(self, text: str) -> Exception:
        """The error to raise."""
        return self.content.error(": ".join(filter(None, (self.place, self.name, text))))

    def expected(self, what: str) -> Exception:
        """The error to raise for a value that is something else."""
        return self.fail(f"expected {what}; found {self.value!r}")

    @contextmanager
    def blamed_for(self, error: type[Exception]) -> Iterator[None]:
        """An error that is raised within is one of this entry."""
        try:
            yield
        except error as problem:
            raise self.fail(str(problem)) from None

    def __contains__(self, key: str) -> bool:
        return key in self.value

    def __getitem__(self, key: str | int) -> Entry:
        return Entry(self.content, self.value[key], (*self.key, key))

    def get(self, key: str, default: Any) -> Entry:
        """The entry, or one with `default` in its place."""
        return Entry(self.content, self.value.get(key, default), (*self.key, key))

    def items(self) -> Iterator[tuple[str, Entry]]:
        """Entries of a table."""
        return ((key, self[key]) for key in self.table().value)

    def each(self) -> list[Entry]:
        """Elements of a list."""
        if not isinstance(self.value, list):
            raise self.expected(f"[[{self.key[0]}]] tables" if len(self.key) == 1 else "a list")
        return [self[i] for i in range(len(self.value))]

    def triple(self, expected: str) -> tuple[Entry, Entry, Entry]:
        """Elements of a list of three; the error says what is `expected`."""
        match self.value:
            case [_, _, _]:
                return self[0], self[1], self[2]
        raise self.expected(expected)

    def table(self) -> Entry:
        """Itself, if it is a table."""
        if not isinstance(self.value, dict):
            raise self.expected("a table")
        return self

    def keys(self, required: Collection[str], optional: Iterable[str] = ()) -> Entry:
        """Itself, if it is a table with the required keys and no unknown ones."""
        known = sorted({*required, *optional})
        for key, entry in self.items():
            if key not in known:
                raise entry.fail(unknown("key", key, known))
        if missing := sorted(set(required) - set(self.value)):
            raise self.fail(f"missing: {', '.join(missing)}; known keys: {', '.join(known)}")
        return self

    def made(self, cls: type[Made]) -> Made:
        """A dataclass of this table: its keys are those of the fields, each of the type of its field."""
        readers: dict[str, Callable[[Entry], Any]] = {
            "str": partial(Entry.text, blank=True),
            "bool": Entry.flag,
            "int": Entry.count,
            "float": Entry.number,
            "tuple[str, ...]": Entry.texts,
        }
        types = {f.name: str(f.type) for f in fields(cls)}  # type: ignore[arg-type]  # cls is a dataclass by contract
        values = {key: readers[types[key]](entry) for key, entry in self.keys((), types).items()}
        with self.blamed_for(self.content.error):
            return cls(**values)

    def text(self, blank: bool = False) -> str:
        """A text; an empty one only if that is allowed."""
        if not isinstance(self.value, str) or not (blank or self.value.strip()):
            raise self.expected("a text")
        return self.value

    def texts(self) -> tuple[str, ...]:
        """A list of such texts."""
        return tuple(entry.text() for entry in self.each())

    def choice(self, names: Collection[Choice]) -> Choice:
        """One of these texts."""
        for name in names:
            if self.text() == name:
                return name
        raise self.fail(unknown(str(self.key[-1]), self.text(), names))

    def folder_name(self) -> str:
        """A text that can be the name of a folder."""
        name = self.text()
        if name in (".", "..") or any(c in name for c in "/\\") or not name.isprintable():
            raise self.fail(f"{name!r} cannot be the name of a folder, in which its results stand; leave out / and \\")
        return name

    def flag(self) -> bool:
        """True or false."""
        if not isinstance(self.value, bool):
            raise self.expected("true or false")
        return self.value

    def count(self, least: int | None = None) -> int:
        """A whole number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int) or (least is not None and self.value < least):
            raise self.expected("a whole number" + ("" if least is None else f", at least {least}"))
        return self.value

    def number(self, what: str = "a finite number") -> float:
        """A finite number without a unit."""
        usable = isinstance(self.value, int | float) and not isinstance(self.value, bool)
        if not usable or not abs(self.value) <= sys.float_info.max:  # NaN, infinite, or an integer that no float holds
            raise self.expected(what)
        return float(self.value)

    def positive(self) -> float:
        """A finite number above zero, without a unit."""
        if self.number("a positive number") <= 0.0:
            raise self.expected("a positive number")
        return float(self.value)

    def si(self, unit: str) -> float:
        """A quantity in `unit`."""
        try:
            return quantity(self.value, unit, self.content.convert)
        except ValueError as error:
            raise self.fail(f"{error}; expected a quantity in {unit}") from None

    def vector(self, unit: str) -> tuple[float, float, float]:
        """Three quantities in `unit`: a list, or `{value = [...], unit = "mm"}`."""
        if isinstance(self.value, dict) and set(self.value) == {"value", "unit"}:
            numbers, stated = self["value"].vector("1"), self["unit"].text()
            x, y, z = (Entry(self.content, f"{v!r} {stated}", self.key).si(unit) for v in numbers)
            return x, y, z
        x, y, z = (element.si(unit) for element in self.triple(f"three quantities in {unit}"))
        return x, y, z

    def written(self) -> Written:
        """The values of a table, each with its place."""
        depth, name = len(self.key), self.content.name
        places = {k[depth:]: f"{name}:{line}" for k, line in self.content.lines.items() if k[:depth] == self.key and len(k) > depth}
        return Written(self.table().value, places)

    def parameters(self) -> dict[str, Written]:
        """`component.parameter = value`, each with its place."""
        return {component: entry.written() for component, entry in self.items()}

    def file(self) -> Path:
        """A file relative to this one; FileNotFoundError if there is none."""
        folder = self.content.folder
        found = (folder / self.text()).resolve()
        if not found.is_file():
            there = sorted(f.name for f in folder.iterdir() if f.is_file())
            raise FileNotFoundError(f"{self.fail(repr(self.value))}: no such file; beside it are {', '.join(there)}")
        return found
