"""Entries of scenario and experiment files: read with units, and refused with file, line and key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robomill.cell.binding import convert
from robomill.orchestration.errors import unknown
from robomill.orchestration.system.parameters import quantity
from robomill.orchestration.system.toml_file import TomlFile
from robomill.orchestration.system.written import Written

ComponentParameters = Mapping[str, Mapping[str, Any]]
"""component -> parameter -> value as written; checked and converted against the component's ports when the system is assembled."""


class ScenarioError(ValueError):
    """A scenario file that cannot be used; the text names file, line, key, what was found and what is expected."""


@dataclass(frozen=True)
class Entry:
    """A value of a file and the key that leads to it."""

    content: TomlFile
    value: Any
    key: tuple[str | int, ...] = ()

    @staticmethod
    def load(file: Path) -> Entry:
        """The whole of `file`. ScenarioError where it is no TOML."""
        content = TomlFile.load(file, ScenarioError)
        return Entry(content, content.table)

    @property
    def name(self) -> str:
        """`[workpiece] size`, `condition 2: load`."""
        if not self.key:
            return "the file"
        head, *rest = self.key
        if rest and isinstance(rest[0], int):
            return ": ".join([f"{head} {rest[0] + 1}", ".".join(map(str, rest[1:]))]) if rest[1:] else f"{head} {rest[0] + 1}"
        return f"[{head}]" + (f" {'.'.join(map(str, rest))}" if rest else "")

    def fail(self, text: str) -> ScenarioError:
        """The error to raise."""
        return ScenarioError(f"{self.content.place(*self.key)}: {self.name}: {text}")

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

    def table(self) -> Entry:
        """Itself, if it is a table."""
        if not isinstance(self.value, dict):
            raise self.fail(f"expected a table, found {self.value!r}")
        return self

    def keys(self, required: set[str], optional: set[str]) -> Entry:
        """Itself, if it is a table with the required keys and no unknown ones."""
        known = required | optional
        for key in self.table().value:
            if key not in known:
                raise self[key].fail(unknown("key", key, sorted(known)))
        if missing := sorted(required - set(self.value)):
            raise self.fail(f"missing: {', '.join(missing)}; known keys: {', '.join(sorted(known))}")
        return self

    def text(self) -> str:
        """A text that is not empty."""
        if not isinstance(self.value, str) or not self.value.strip():
            raise self.fail(f"expected a text; found {self.value!r}")
        return self.value

    def folder_name(self) -> str:
        """A text that can be the name of a folder."""
        name = self.text()
        if name in (".", "..") or any(c in name for c in "/\\") or not name.isprintable():
            raise self.fail(f"{name!r} cannot be the name of a folder, in which its results stand")
        return name

    def flag(self) -> bool:
        """True or false."""
        if not isinstance(self.value, bool):
            raise self.fail(f"expected true or false; found {self.value!r}")
        return self.value

    def count(self, least: int) -> int:
        """A whole number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int) or self.value < least:
            raise self.fail(f"expected a whole number, at least {least}; found {self.value!r}")
        return self.value

    def si(self, unit: str) -> float:
        """A quantity in `unit`."""
        try:
            return quantity(self.value, unit, convert)
        except ValueError as error:
            raise self.fail(f"{error}; expected a quantity in {unit}") from None

    def vector(self, unit: str) -> tuple[float, float, float]:
        """Three quantities in `unit`: a list, or `{value = [...], unit = "mm"}`."""
        if isinstance(self.value, dict) and set(self.value) == {"value", "unit"}:
            numbers, stated = self["value"].vector("1"), self["unit"].text()
            x, y, z = (Entry(self.content, f"{v!r} {stated}", self.key).si(unit) for v in numbers)
            return x, y, z
        if not isinstance(self.value, list) or len(self.value) != 3:
            raise self.fail(f"{self.value!r}; expected three quantities in {unit}")
        x, y, z = (self[i].si(unit) for i in range(3))
        return x, y, z

    def parameters(self) -> dict[str, Written]:
        """`component.parameter = value`, each with its place."""
        for _, entry in self.items():
            entry.table()
        return {component: self.content.written(entry.value, *entry.key) for component, entry in self.items()}

    def file(self) -> Path:
        """A file relative to this one; FileNotFoundError if there is none."""
        folder = self.content.folder
        found = (folder / self.text()).resolve()
        if not found.is_file():
            there = sorted(f.name for f in folder.iterdir() if f.is_file())
            raise FileNotFoundError(f"{self.fail(repr(self.value))}: no such file; beside the scenario are {', '.join(there)}")
        return found
