"""Parameter values as people write them -> one checked value per element, in the unit of its port.

A value is a number in the unit of the port (SI for the components of this project), a boolean, a
text with a unit ("0.2 mm") that the converter given from outside turns into the port's unit, a
nested list for a whole array, `{value = [...], unit = "mm"}`, or `{file = "..."}`, a path relative
to the system file for parameters that are texts.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orchestration.errors import SlaveError, unknown
from orchestration.slave import EXACT, Port, Scalar, arrays, whole_range

Convert = Callable[[float, str, str], float]
"""(value, unit, wanted unit) -> value in the wanted unit; ValueError with a text where that is impossible."""

_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")


def same_unit_only(value: float, unit: str, wanted: str) -> float:
    """The converter where none is given: it knows no units, so they must be equal."""
    if unit != wanted:
        raise ValueError(f"unit {unit!r} cannot be converted to {wanted!r}: no unit table was given")
    return value


def quantity(text: str, wanted: str, convert: Convert) -> float:
    """Number of a text like "0.2 mm" in the unit `wanted`; ValueError says what is wrong."""
    match = _NUMBER_AND_UNIT.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a number with a unit, such as {'4 ' + wanted!r}")
    value, unit = float(match[1]), match[2] or wanted
    return value if unit == wanted else convert(value, unit, wanted)


def expand(ports: Sequence[Port], values: Mapping[str, Any], causality: str = "parameter") -> dict[str, Any]:
    """One entry per element from a mapping of element, scalar and whole-array names; values are not looked at.

    `causality` is what may be set. Raises ValueError for unknown names, ports of another causality, shapes
    that do not fit, an element given twice.
    """
    parameters = [p for p in ports if p.causality == causality]
    elements, whole = {p.name for p in parameters}, arrays(parameters)
    result: dict[str, Any] = {}
    for name, value in values.items():
        if name in elements:
            found = {name: value}
        elif name in whole:
            found = _elements(name, whole[name], value)
        else:
            other = [p for p in ports if name in (p.name, p.name.partition("[")[0])]
            if other:
                raise ValueError(f"{name!r} is {_a(other[0].causality)}, not {_a(causality)}")
            raise ValueError(unknown(causality, name, whole))
        for element, v in found.items():
            if element in result:
                raise ValueError(f"{causality} {element!r} is given twice: by element and within its array")
            result[element] = v
    return result


def _a(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _elements(name: str, members: Sequence[Port], value: Any) -> dict[str, Any]:
    unit = None
    if isinstance(value, Mapping) and set(value) == {"value", "unit"}:
        value, unit = value["value"], value["unit"]
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
        raise ValueError(f"parameter {name!r} is an array of {len(members)} elements; found the single value {value!r}")
    flat = np.asarray(value, dtype=object)
    shape = tuple(int(i) for i in members[-1].name[len(name) + 1 : -1].split(","))
    if flat.shape not in (shape, (len(members),)):
        raise ValueError(f"parameter {name!r} has shape {list(shape)}; found values of shape {list(flat.shape)}")
    return {p.name: v if unit is None else {"value": v, "unit": unit} for p, v in zip(members, flat.ravel(), strict=True)}


def prepare(
    component: str,
    ports: Sequence[Port],
    values: Mapping[str, Any],
    convert: Convert = same_unit_only,
    folder: Path | None = None,
    causality: str = "parameter",
) -> dict[str, Scalar]:
    """Checked value per element, in the unit of the port, ready for `Slave.configure`.

    `folder` is the one that `{file = ...}` is relative to; `causality` is what is set (parameters, or start
    values of inputs). SlaveError names component, parameter,
    value, what is expected (unit, type, bounds) and, for unknown names, what there is.
    """
    try:
        elements = expand(ports, values, causality)
    except ValueError as error:
        raise SlaveError(f"component {component!r}: {error}") from None
    by_name = {p.name: p for p in ports}
    result: dict[str, Scalar] = {}
    for name, value in elements.items():
        try:
            result[name] = _scalar(by_name[name], value, convert, folder)
        except ValueError as error:
            raise SlaveError(f"component {component!r}: {causality} {name!r}: {error}") from None
    return result


def _scalar(port: Port, value: Any, convert: Convert, folder: Path | None) -> Scalar:
    if port.type == "string":
        return _text(value, folder)
    if isinstance(value, Mapping):
        if set(value) != {"value", "unit"}:
            raise ValueError(f"expected a value or {{value = ..., unit = ...}}; found a table with {', '.join(value)}")
        value = f"{value['value']} {value['unit']}"
    if isinstance(value, np.generic):
        value = value.item()
    wanted = port.unit or "1"
    if port.type == "boolean":
        if value in (True, False):
            return bool(value)
        raise ValueError(f"expected true or false; found {value!r}")
    if isinstance(value, bool):
        raise ValueError(f"expected a number in {wanted!r}; found {value}")
    if isinstance(value, str):
        value = quantity(value, wanted, convert)
    if not isinstance(value, int | float):
        raise ValueError(f"expected a number in {wanted!r}; found {value!r}")
    if not math.isfinite(value):
        raise ValueError(f"expected a finite number in {wanted!r}; found {value}")
    if port.type == "integer" and value != int(value):
        raise ValueError(f"expected a whole number; found {value!r}")
    if port.type == "integer":
        low, high = whole_range(port)
        if not low <= value <= high:
            raise ValueError(f"{int(value)} does not fit its type: expected {low} to {high}")
        if isinstance(value, float) and abs(value) > EXACT:
            raise ValueError(
                f"{value!r} may stand for several whole numbers; above {EXACT} write it without decimal point, exponent and unit"
            )
    number = int(value) if port.type == "integer" else float(value)
    for bound, outside, word in (
        (port.minimum, port.minimum is not None and number < port.minimum, "below its minimum"),
        (port.maximum, port.maximum is not None and number > port.maximum, "above its maximum"),
    ):
        if outside:
            raise ValueError(f"{number:.9g} {wanted} is {word} {bound:.9g} {wanted}")
    return number


def _text(value: Any, folder: Path | None) -> str:
    if isinstance(value, Mapping):
        if set(value) != {"file"} or not isinstance(value["file"], str):
            raise ValueError(f"expected a text or {{file = ...}}; found a table with {', '.join(value)}")
        path = ((folder or Path()) / value["file"]).resolve()
        if not path.is_file():
            raise ValueError(f"no such file {path}")
        return str(path)
    if not isinstance(value, str):
        raise ValueError(f"expected a text; found {value!r}")
    return value
