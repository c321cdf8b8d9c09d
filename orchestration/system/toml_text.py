"""TOML beyond the standard library: files of strangers read safely, and writing."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

_BARE = re.compile(r"[A-Za-z0-9_-]+")


MAX_DEPTH = 50
"""Levels of tables and arrays within each other."""


def parse(text: str) -> dict[str, Any]:
    """The table that a TOML text is; `tomllib.TOMLDecodeError` if it is not valid, or nested more than `MAX_DEPTH` deep.

    A byte order mark, with which editors on Windows begin a file, is no part of the text.
    """
    try:
        table = tomllib.loads(text.removeprefix("\ufeff"))
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
