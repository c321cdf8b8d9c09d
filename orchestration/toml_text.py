"""TOML beyond the standard library: files of strangers read safely, where a key stands in a file, and writing."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

_HEADER = re.compile(r"\s*(\[\[?)\s*([^\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"""\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*=""")
_BARE = re.compile(r"[A-Za-z0-9_-]+")


MAX_DEPTH = 50
"""Levels of tables and arrays within each other."""


def parse(text: str) -> dict[str, Any]:
    """The table that a TOML text is; `tomllib.TOMLDecodeError` if it is not valid, or nested more than `MAX_DEPTH` deep."""
    try:
        table = tomllib.loads(text)
    except RecursionError:  # the reader follows arrays and inline tables by recursion; headers and dotted keys it does not
        raise _too_deep() from None
    level: list[Any] = [table]
    for _ in range(MAX_DEPTH):
        level = [v for x in level for v in (x.values() if isinstance(x, dict) else x) if isinstance(v, dict | list)]
        if not level:
            return table
    raise _too_deep()


def _too_deep() -> tomllib.TOMLDecodeError:
    return tomllib.TOMLDecodeError(f"tables and arrays are nested more than {MAX_DEPTH} deep")


def find_line(text: str, *path: str | int) -> int | None:
    """Line (from 1) of a key in a TOML text, or of the nearest table above it; None if there is neither.

    `path` is ("components", "drive", "source") or, in arrays of tables, ("connections", 2, "from").
    Tables, dotted keys and arrays of tables are understood; inside inline tables it is the line of the table.
    """
    best: tuple[int, int] | None = None
    table: tuple[str | int, ...] = ()
    counts: dict[str, int] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            table = _parts(header[2])
            if header[1] == "[[":
                name = header[2]
                counts[name] = counts.get(name, -1) + 1
                table = (*table, counts[name])
            found = table
        elif key := _KEY.match(line):
            found = (*table, *_parts(key[1]))
        else:
            continue
        if found == path[: len(found)] and (best is None or len(found) > best[0]):
            best = len(found), number
    return best[1] if best else None


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(p.strip().strip("\"'") for p in re.findall(r"""[\w-]+|"[^"]*"|'[^']*'""", dotted))


def dump(table: Mapping[str, Any]) -> str:
    """A nested mapping as TOML text; None is left out. Texts, numbers, booleans, lists and mappings."""
    lines: list[str] = []
    _dump(table, (), lines)
    return "\n".join(lines).lstrip("\n") + "\n"


def _dump(table: Mapping[str, Any], path: tuple[str, ...], lines: list[str]) -> None:
    plain = {k: v for k, v in table.items() if v is not None and not isinstance(v, Mapping)}
    tables = {k: v for k, v in table.items() if isinstance(v, Mapping)}
    if path and (plain or not tables):
        lines.append("\n[" + ".".join(_key(k) for k in path) + "]")
    lines.extend(f"{_key(k)} = {_value(v)}" for k, v in plain.items())
    for key, value in tables.items():
        _dump(value, (*path, key), lines)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _text(key)


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            return "nan" if math.isnan(value) else ("inf" if value > 0 else "-inf")
        return repr(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    raise TypeError(f"{type(value).__name__} cannot be written as TOML")
