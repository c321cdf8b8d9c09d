"""Tables of records: dataclasses that are written to JSON, or read from files of data with sources."""

from __future__ import annotations

import dataclasses
import sys
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from reference.attributes import attribute_docs
from reference.markdown import prose, sentence, table

JSON_NAMES = {float: "number", int: "whole number", str: "text", bool: "true or false", type(None): "null", typing.Any: "anything"}


def json_sections(cls: type[Any], title: str, flat: Mapping[type[Any], str] = MappingProxyType({})) -> Iterator[str]:
    """A section for the record, and one for each record within it, as JSON has them; `flat`: how those are written that are not."""
    done: dict[type[Any], None] = {}
    queue = [cls]
    while queue:
        record = queue.pop(0)
        if record in done:
            continue
        done[record] = None
        hints = hints_of(record)
        docs = attribute_docs(record)
        rows = [(f"`{f.name}`", json_type(hints[f.name], flat), sentence(docs[f.name])) for f in dataclasses.fields(record)]
        heading = title if record is cls else record.__name__
        yield "\n\n".join([f"## {heading}", prose(record.__doc__), table(("key", "value", "meaning"), rows)])
        queue += [r for f in dataclasses.fields(record) for r in records_in(hints[f.name]) if r not in flat]


def hints_of(cls: type[Any]) -> dict[str, Any]:
    """The types of the fields; those that are imported for the type checker alone are anything."""
    names = {"Any": Any, **vars(sys.modules[cls.__module__])}
    return typing.get_type_hints(cls, globalns=names)


def json_type(hint: Any, flat: Mapping[type[Any], str] = MappingProxyType({})) -> str:
    """A type as JSON has it, with a link where it is a record."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint in flat:
        return flat[hint]
    if dataclasses.is_dataclass(hint):
        name = typing.cast("type[Any]", hint).__name__
        return f"[{name}](#{name.lower()})"
    if origin is typing.Literal:
        return " or ".join(f"`{a}`" for a in arguments)
    if origin in (types.UnionType, typing.Union):
        return " or ".join(dict.fromkeys(json_type(a, flat) for a in arguments))
    if origin is not None and issubclass(origin, Mapping):
        return f"by name: {json_type(arguments[1], flat)}"
    if origin is not None and issubclass(origin, Sequence):
        kinds = dict.fromkeys(json_type(a, flat) for a in arguments if a is not Ellipsis)
        return f"list of {' and '.join(kinds)}"
    return JSON_NAMES.get(hint, getattr(hint, "__name__", str(hint)))


def records_in(hint: Any) -> Iterator[type[Any]]:
    """The dataclasses within a type."""
    if dataclasses.is_dataclass(hint):
        yield typing.cast("type[Any]", hint)
    for argument in typing.get_args(hint):
        yield from records_in(argument)


def data_section(cls: type[Any], where: str) -> str:
    """The fields of a class of data files (`models.model.parameters`): unit, bounds, default."""
    docs = attribute_docs(cls)
    rows = []
    for f in dataclasses.fields(cls):
        unit = f.metadata.get("unit", "")
        bounds = f"{_bound(f.metadata.get('minimum'))} .. {_bound(f.metadata.get('maximum'))}" if unit else ""
        needed = f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
        value = "text" if not unit else "number" if "FloatArray" not in str(f.type) else "list of numbers"
        rows.append((f"`{f.name}`", value, unit, "" if bounds == " .. " else bounds, "required" if needed else "", sentence(docs[f.name])))
    heading = f"## {cls.__name__}\n\nFiles in `{where}`. {prose(cls.__doc__)}"
    return "\n\n".join([heading, table(("key", "value", "unit", "allowed", "", "meaning"), rows)])


def _bound(value: float | None) -> str:
    return "" if value is None else f"{value:g}"
