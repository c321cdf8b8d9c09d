"""A TOML file that people write: its content, and where in it each value stands."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robomill.orchestration.system.toml_lines import Key, key_lines
from robomill.orchestration.system.toml_text import parse
from robomill.orchestration.system.written import Written


@dataclass(frozen=True)
class TomlFile:
    """Content and lines."""

    name: str
    """The file as error texts call it."""
    table: Mapping[str, Any]
    lines: Mapping[Key, int]
    folder: Path
    """What paths in it are relative to."""

    @staticmethod
    def load(file: Path, error: type[Exception], name: str | None = None) -> TomlFile:
        """Read `file`; `error` with file, line and what is wrong where it is no TOML (a key that is there twice, too)."""
        shown = name or str(file)
        try:
            text = file.read_text(encoding="utf-8").replace("\r\n", "\n")
            return TomlFile(shown, parse(text), key_lines(text), file.parent)
        except tomllib.TOMLDecodeError as problem:
            raise error(f"{shown}: not valid TOML: {problem}") from None
        except UnicodeDecodeError as problem:
            raise error(f"{shown}: not valid TOML: not UTF-8: {problem}") from None

    def line(self, *key: str | int) -> int | None:
        """Line of a key, or of the nearest table above it."""
        return next((self.lines[key[:n]] for n in range(len(key), 0, -1) if key[:n] in self.lines), None)

    def place(self, *key: str | int) -> str:
        """`file.toml:12`, or the file alone where no part of the key is in it."""
        line = self.line(*key)
        return f"{self.name}:{line}" if line else self.name

    def written(self, table: Any, *key: str | int) -> Written:
        """A table of this file that stands at `key`, with the place of each of its values."""
        depth = len(key)
        places = {k[depth:]: f"{self.name}:{line}" for k, line in self.lines.items() if k[:depth] == key and len(k) > depth}
        return Written(table, places)
