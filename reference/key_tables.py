"""Tables of keys, from the declarations that the readers check files by (`orchestration.system.keys`)."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from typing import Any

from reference.attributes import attribute_docs
from reference.markdown import literal, prose, sentence, table
from robomill.orchestration.system.keys import Key, Keys

HEADING = ("key", "value", "unit", "default", "meaning")
_NAMES = {"str": "text", "bool": "true or false", "int": "whole number", "float": "number", "tuple[str, ...]": "list of texts"}
"""Types of the fields that `Entry.made` reads."""


def sections(keys: type[Keys], path: str = "") -> Iterator[str]:
    """A section per table: that of `keys`, and then those of the tables below it, each form of table once."""
    found: dict[type[Any], str] = {}
    _find(keys, path, found)
    for cls, place in found.items():
        rows = [_row(key, place, found) for key in cls.all().values()] if issubclass(cls, Keys) else list(_fields(cls))
        said = prose(cls.__doc__) if place else ""
        title = f"## `{place}`" if place else "## At the top of the file"
        yield "\n\n".join(filter(None, [title, said, table(HEADING, rows)]))


def has_units(keys: type[Keys]) -> bool:
    """Whether a key of the table, or of one below it, is a quantity."""
    found: dict[type[Any], str] = {}
    _find(keys, "", found)
    return any(key.kind.unit for cls in found if issubclass(cls, Keys) for key in cls.all().values())


def _find(cls: type[Any], path: str, found: dict[type[Any], str]) -> None:
    """Forms of tables from this one on, and where the first of each form stands."""
    if cls in found:
        return
    found[cls] = path
    if issubclass(cls, Keys):
        for key in cls.all().values():
            if key.kind.nested is not None:
                _find(key.kind.nested, below_of(path, key), found)


def below_of(path: str, key: Key[Any]) -> str:
    """How the table of a key is written: `[scenario]`, `[variants.NAME]`, `[[effect.locations]]`."""
    head = path.strip("[]")
    name = ".".join(filter(None, [head, key.name + (key.kind.path if key.kind.path != "[]" else "")]))
    return f"[[{name}]]" if key.kind.path == "[]" else f"[{name}]"


def _row(key: Key[Any], path: str, found: dict[type[Any], str]) -> tuple[str, ...]:
    value = key.kind.what
    if key.kind.nested is not None:
        anchor = re.sub(r"[^\w\- ]", "", found[key.kind.nested].lower()).replace(" ", "-")
        value = f"{value} [`{below_of(path, key)}`](#{anchor})"
    elif key.kind.allowed:
        value = " or ".join(filter(None, ("" if key.kind.what == "text" else key.kind.what, ", ".join(f"`{a}`" for a in key.kind.allowed))))
    start = "required" if key.needed else literal(key.start) if key.has_default and key.start not in ({}, []) else ""
    return f"`{key.name}`", value, key.kind.unit, start, sentence(key.meaning)


def _fields(cls: type[Any]) -> Iterator[tuple[str, ...]]:
    """Rows of a dataclass that is made of a table (`Entry.made`)."""
    docs = attribute_docs(cls)
    for f in dataclasses.fields(cls):
        start = "required" if f.default is dataclasses.MISSING else literal(f.default)
        yield f"`{f.name}`", _NAMES[str(f.type)], "", start, sentence(docs[f.name])
