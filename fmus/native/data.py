"""data.c of a component: what shim/component.h declares, written from the interface of its model."""

from __future__ import annotations

import math
import re
import string
from collections.abc import Iterable
from typing import Any

import numpy as np

from robomill.fmus.instance import DEFAULT_STEP
from robomill.fmus.interface import WORD, Interface
from robomill.fmus.native.lower import NativeBuildError
from robomill.models.model.declaration import Model, Variable

_CAUSALITIES = ("input", "output", "parameter")
_PRINTF = set("efgEFG")
_AS_IT_IS = {" ", *string.ascii_letters, *string.digits, *string.punctuation} - set('"\\?')
"""Characters that stand for themselves in a C string literal; ?? would begin a trigraph."""
_DIMENSIONS = 4
"""Dimensions of a variable, at most: the places of `shape` in shim/component.h."""


def data_c(interface: Interface, token: str) -> str:
    """The C source. NativeBuildError if an error message has a placeholder that C cannot show."""
    model = interface.model
    fields: Any = model.dtype.fields
    record = model.new()
    words = model.dtype.itemsize // WORD
    tables_at = interface.tables_at // WORD
    shown = sorted((v for v in model.variables if v.causality in _CAUSALITIES and v.kind != "table"), key=lambda v: int(fields[v.name][1]))
    owner: list[int] = [i for i, v in enumerate(shown) for _ in v.element_names]
    outputs = [p.reference for p in interface.outputs if p.type == "real"]
    image = record.view(np.uint64)[:tables_at]
    start = image[: int(np.flatnonzero(image)[-1]) + 1 if image.any() else 0]
    tables = [v for v in model.variables if v.kind == "table"]
    parts = [
        "/* Generated from the declaration of the model. */",
        '#include "component.h"',
        "#include <math.h>",
        f"const char MODEL_NAME[] = {_text(model.name)}, TOKEN[] = {_text(token)};",
        f"const double DEFAULT_STEP = {DEFAULT_STEP.hex()};",
        f"const uint32_t WORDS = {words}, TABLES_AT = {tables_at}, START_WORDS = {len(start)}, OWNED = {len(owner)};",
        f"const uint32_t FIRST_REAL_OUTPUT = {min(outputs, default=0)}, REAL_OUTPUTS = {len(outputs)}, TABLE_COUNT = {len(tables)};",
        f"const int64_t MESSAGE_COUNT = {len(model.errors)};",
        _array("const uint64_t START[]", (f"0x{int(w):x}" for w in start)),
        _array("const uint16_t OWNER[]", map(str, owner)),
        _array("const Variable VARIABLES[]", (_variable(v, fields[v.name][1] // WORD) for v in shown), 1),
    ]
    for i, v in enumerate(tables):
        parts.append(_array(f"static const double ROWS_{i}[]", (float(x).hex() for x in model.built_in[v.name].rows.ravel()), 6))
    parts.append(_array("const Table TABLES[]", (_table(model, v, i, fields) for i, v in enumerate(tables)), 1))
    for i, message in enumerate(model.errors):
        parts.append(_array(f"static const Part MESSAGE_{i}[]", [*_message(model, message), "{0}"], 1))
    parts.append(_array("const Part *const MESSAGES[]", (f"MESSAGE_{i}" for i in range(len(model.errors)))))
    return "\n".join(parts) + "\n"


def _array(declaration: str, items: Iterable[str], columns: int = 16) -> str:
    """A C array of at least one element, since C has no empty ones."""
    found = list(items) or ["{0}" if "Table" in declaration or "Variable" in declaration else "0"]
    lines = (", ".join(found[i : i + columns]) for i in range(0, len(found), columns))
    return f"{declaration} = {{\n    " + ",\n    ".join(lines) + "\n};"


def _text(text: str) -> str:
    """A C string literal: UTF-8, everything unusual as an octal escape."""
    return '"' + "".join(chr(b) if chr(b) in _AS_IT_IS else f"\\{b:03o}" for b in text.encode()) + '"'


def _number(value: float | None, default: str) -> str:
    return default if value is None or math.isinf(value) else float(value).hex()


def _variable(v: Variable, first: int) -> str:
    unit = f" {v.unit}" if v.kind == "real" and v.unit != "1" else ""
    shape = ", ".join(map(str, v.shape)) or "0"
    if len(v.shape) > _DIMENSIONS:
        raise NativeBuildError(f"variable {v.name!r} has {len(v.shape)} dimensions; at most {_DIMENSIONS} are possible")
    bounded = v.causality == "parameter" and v.kind != "boolean"  # bounds of inputs are for information: loops may overshoot
    low, high = (_number(v.minimum, "-INFINITY"), _number(v.maximum, "INFINITY")) if bounded else ("-INFINITY", "INFINITY")
    fixed = int(v.causality == "parameter" and not v.tunable)
    return (
        f"{{{_text(v.name)}, {_text(unit)}, {first}, {len(v.element_names)}, {{{shape}}}, "
        f"{v.kind.upper()}, {v.causality.upper()}, {fixed}, {low}, {high}}}"
    )


def _table(model: Model, v: Variable, index: int, fields: Any) -> str:
    reference, address = (fields[f"{v.name}_{what}"][1] // WORD for what in ("rows", "at"))
    return f"{{{_text(v.name)}, {reference}, {address}, {v.shape[0]}, ROWS_{index}, {len(model.built_in[v.name].rows)}}}"


def _message(model: Model, message: str) -> list[str]:
    """The parts of an error message; `{name}`, `{name[0]}`, `{name[0]:.3f}`, `{t}` as in `str.format`."""
    parts = []
    for text, field, spec, conversion in string.Formatter().parse(message):
        if field is None:
            parts.append(f"{{{_text(text)}, 0, 0, 0, 0}}")
            continue
        if conversion or not _allowed(spec or ""):
            where = f"model {model.name!r}: error message {message!r}"
            raise NativeBuildError(f"{where}: {field!r} has a format that C does not know: {spec!r}; use a format such as %g, %d or %s")
        style = f"%{spec}" if spec else ""
        if field == "t":
            parts.append(f"{{{_text(text)}, 't', {_text(style)}, 0, 0}}")
            continue
        kind, first, count = _place(model, message, field)
        if kind == "i" and spec not in ("", "d"):
            kind = "n"
        parts.append(f"{{{_text(text)}, '{kind}', {_text(style)}, {first}, {count}}}")
    return parts


def _allowed(spec: str) -> bool:
    return spec in ("", "d") or (spec[-1] in _PRINTF and all(c.isdigit() or c == "." for c in spec[:-1]))


def _place(model: Model, message: str, field: str) -> tuple[str, int, int]:
    """Kind, first word and number of elements (0 = a single value) of what a placeholder names."""
    name = field.partition("[")[0]
    index = tuple(int(i) for i in re.findall(r"\[(\d+)\]", field))
    fields: Any = model.dtype.fields
    dtype = fields[name][0] if name in fields and re.fullmatch(r"\w+(\[\d+\])*", field) else None
    if dtype is None or len(index) > len(dtype.shape):
        raise NativeBuildError(
            f"model {model.name!r}: error message {message!r}: no such field: {field!r}; correct the message of the model"
        )
    if any(not 0 <= i < n for i, n in zip(index, dtype.shape, strict=False)):
        raise NativeBuildError(
            f"model {model.name!r}: error message {message!r}: {field!r} is out of range; correct the message of the model"
        )
    count = math.prod(dtype.shape[len(index) :])
    at = 0
    for i, n in zip(index, dtype.shape, strict=False):
        at = at * n + i
    kind = "i" if dtype.base.kind == "i" else "r"
    return kind, int(fields[name][1]) // WORD + at * count, count if len(index) < len(dtype.shape) else 0
