"""The page of the Python API: what `import robomill` offers, from signatures and docstrings."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
import types
from collections.abc import Iterator
from typing import Any

import robomill
from reference.attributes import attribute_docs
from reference.markdown import code, page, prose, sentence, table

WIDTH = 90
"""Characters from which on a signature has a line for each argument."""
FIRST = ("load", "run", "sweep", "diagnose")
"""What a reader looks for first."""


def names() -> list[str]:
    """The public names, those of FIRST before the others."""
    public = list(robomill.__all__)
    return [n for n in FIRST if n in public] + sorted(n for n in public if n not in FIRST)


def python_page() -> str:
    """All public names with signature, docstring, fields, properties and methods."""
    listed = table(("name", "what it is"), ((f"[`{n}`](#{_anchor(n)})", _first_line(getattr(robomill, n))) for n in names()))
    lead = prose(robomill.__doc__)
    units = "Arrays are float64. Values are in SI units unless the name or the text says otherwise."
    return page("Python API", lead, units, listed, *(_entry(n, getattr(robomill, n)) for n in names()))


def _heading(name: str, value: Any) -> str:
    """A class and a function may differ in the capital alone, which anchors do not have."""
    return f"## class {name}" if inspect.isclass(value) else f"## {name}"


def _anchor(name: str) -> str:
    return _heading(name, getattr(robomill, name)).removeprefix("## ").lower().replace(" ", "-")


def _first_line(value: Any) -> str:
    return sentence(_doc(value).split("\n\n")[0])


def _doc(value: Any) -> str:
    """Its docstring; of a function with some arguments given, that of the function."""
    return inspect.getdoc(value.func if isinstance(value, functools.partial) else value) or ""


def _entry(name: str, value: Any) -> str:
    parts = [_heading(name, value)]
    if inspect.isclass(value):
        parts += [prose(_doc(value)), *_fields(value), *_members(value)]
    elif callable(value):
        parts += [code(f"{name}{signature(value)}", "python"), prose(_doc(value))]
    else:
        parts += [code(f"{name} = {value!r}", "python")]
    return "\n\n".join(filter(None, parts))


def _fields(cls: type[Any]) -> Iterator[str]:
    if dataclasses.is_dataclass(cls):
        docs = attribute_docs(cls)
        rows = [(f"`{f.name}`", f"`{f.type}`", sentence(docs.get(f.name, ""))) for f in dataclasses.fields(cls) if f.name[0] != "_"]
        yield table(("attribute", "type", "meaning"), rows)


def _members(cls: type[Any]) -> Iterator[str]:
    """Properties and methods of the class and of its bases in this project."""
    found: dict[str, Any] = {}
    for base in reversed(cls.__mro__):
        if base.__module__.startswith("robomill"):
            found |= {n: v for n, v in vars(base).items() if not n.startswith("_") or n in ("__getitem__", "__len__", "__contains__")}
    properties = [(n, v) for n, v in found.items() if isinstance(v, property | functools.cached_property)]
    rows = [(f"`{n}`", f"`{_returned(v)}`", sentence(inspect.getdoc(v) or "")) for n, v in properties]
    yield table(("property", "type", "meaning"), rows)
    for n, v in found.items():
        function = v.__func__ if isinstance(v, staticmethod | classmethod) else v
        if isinstance(function, types.FunctionType) and (documented := inspect.getdoc(function)):
            called = f"{cls.__name__}.{n}" if isinstance(v, staticmethod | classmethod) else n
            yield f"### {cls.__name__}.{n.strip('_')}\n\n{code(called + signature(function), 'python')}\n\n{prose(documented)}"


def _returned(value: Any) -> str:
    getter = value.fget if isinstance(value, property) else value.func
    return str(getter.__annotations__.get("return", "")).strip("'")


class _Bare:
    """An annotation or a default that is shown as a text."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def signature(function: Any) -> str:
    """Arguments with their types as they stand in the source; a long one has a line for each argument."""
    found = inspect.signature(function)
    shown = []
    for p in found.parameters.values():
        if p.name == "self":
            continue
        kept = p.default if p.default is p.empty else _Bare(_default(p.default))
        shown.append(p.replace(annotation=p.empty if p.annotation is p.empty else _Bare(_type(p.annotation)), default=kept))
    returned = found.return_annotation if found.return_annotation is inspect.Signature.empty else _Bare(_type(found.return_annotation))
    text = str(found.replace(parameters=shown, return_annotation=returned))
    if len(text) < WIDTH:
        return text
    head = [f"    {p}," for p in shown]
    stars = next((i for i, p in enumerate(shown) if p.kind is p.KEYWORD_ONLY), None)
    if stars is not None and not any(p.kind is p.VAR_POSITIONAL for p in shown):
        head.insert(stars, "    *,")
    arrow = "" if returned is inspect.Signature.empty else f" -> {returned}"
    return "\n".join(["(", *head, f"){arrow}"])


def _type(annotation: Any) -> str:
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    return re.sub(r"\b_([A-Z])", r"\1", text)  # the class behind `robomill.System` is imported as `_System`


def _default(value: Any) -> str:
    """A default; three dots for what has no short form in the source."""
    plain = value is None or isinstance(value, str | int | float | tuple | list | dict)
    return repr(value) if plain else getattr(value, "__name__", "...")
