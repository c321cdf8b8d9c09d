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
    """A section per table: that of `keys`, and then those of the tables below it."""
    title = f"## `{path}`" if path else "## At the top of the file"
    yield "\n\n".join([title, prose(keys.__doc__), table(HEADING, (row(key, path) for key in keys.all().values()))])
    for key in keys.all().values():
        if key.kind.nested is None:
            continue
        below = below_of(path, key)
        if issubclass(key.kind.nested, Keys):
            yield from sections(key.kind.nested, below)
        else:
            yield "\n\n".join([f"## `{below}`", prose(key.kind.nested.__doc__), table(HEADING, fields_of(key.kind.nested))])


def below_of(path: str, key: Key[Any]) -> str:
    """How the table of a key is written: `[scenario]`, `[variants.NAME]`, `[[effect.locations]]`."""
    head = path.strip("[]")
    name = ".".join(filter(None, [head, key.name + (key.kind.path if key.kind.path != "[]" else "")]))
    return f"[[{name}]]" if key.kind.path == "[]" else f"[{name}]"


def row(key: Key[Any], path: str) -> tuple[str, ...]:
    """The row of a key."""
    value = key.kind.type
    if key.kind.nested is not None:
        below = below_of(path, key)
        anchor = re.sub(r"[^\w\- ]", "", below.lower()).replace(" ", "-")
        value = f"{value} [`{below}`](#{anchor})"
    elif key.kind.allowed:
        value = " or ".join(filter(None, ("" if key.kind.type == "text" else key.kind.type, ", ".join(f"`{a}`" for a in key.kind.allowed))))
    start = "required" if key.needed else literal(key.start) if key.has_default and key.start not in ({}, []) else ""
    return f"`{key.name}`", value, key.kind.unit, start, sentence(key.meaning)


def fields_of(cls: type[Any]) -> Iterator[tuple[str, ...]]:
    """Rows of the fields of a dataclass that is read from a table."""
    docs = attribute_docs(cls)
    for f in dataclasses.fields(cls):
        start = "required" if f.default is dataclasses.MISSING else literal(f.default)
        yield f"`{f.name}`", _NAMES[str(f.type)], "", start, sentence(docs[f.name])
