"""Parameter values as people write them -> one checked value per element, in the unit of its port.

A value is a text with a unit ("0.2 mm") that the converter given from outside turns into the port's
unit, a number where the port has none, a boolean, the name of an item of an enumeration, a nested list for a whole array,
`{value = [...], unit = "mm"}`, or `{file = "..."}`, a path relative to the system file for parameters
that are texts. A number that code gives is one in the unit of the port (SI for the components of this
project); one that a person wrote (`orchestration.system.written`) is refused where the port has a unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robomill.orchestration.errors import PlacedError, available, unknown
from robomill.orchestration.slaves.protocol import CARRIED, EXACT, Port, Scalar, arrays, items, whole_range
from robomill.orchestration.system.written import place_of

Convert = Callable[[float, str, str], float]
"""(value, unit, wanted unit) -> value in the wanted unit; ValueError with a text where that is impossible.

The unit is empty where none was written: then the converter says whether the value needs one.
"""


_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?:\s*((?:[^\W\d_]|[%\u00b0\u2030]).*?)|\s+(1/\S.*?))?\s*")
"""A number, and a unit that begins with a letter, a degree or a per cent sign, or with `1/`: "-2 1" are two numbers."""


def same_unit_only(value: float, unit: str, wanted: str) -> float:
    """The converter where none is given: it knows no units, so they must be equal; zero needs none."""
    if not unit and value != 0.0 and wanted != "1":
        raise ValueError(f"{value:.15g} has no unit; expected a text with one, such as {f'{value:.15g} {wanted}'!r}")
    if unit and unit != wanted:
        raise ValueError(f"unit {unit!r} cannot be converted to {wanted!r}: no unit table was given")
    return value


def same_unit(a: str, b: str, convert: Convert) -> bool:
    """Whether two spellings mean the same unit, as `N.m` and `N*m` do."""
    if a == b:
        return True
    try:
        return convert(0.0, a, b) == 0.0 and convert(1.0, a, b) == 1.0
    except ValueError:
        return False


def quantity(value: Any, wanted: str, convert: Convert, bare: bool = False) -> float:
    """A value that a person wrote, such as "0.2 mm", in the unit `wanted` ("1": none); finite. ValueError says what is wrong.

    `bare`: code gave it, and a number is in that unit.
    """
    unit = wanted if bare else ""
    if isinstance(value, str):
        match = _NUMBER_AND_UNIT.fullmatch(value)
        if match is None:
            example = "a number, such as '4'" if wanted == "1" else f"a number with a unit, such as {'4 ' + wanted!r}"
            raise ValueError(f"{value!r} is not {example}")
        value, unit = float(match[1]), match[2] or match[3] or ""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{value!r} is neither a number nor a text with a unit")
    try:
        number = float(value)
    except OverflowError:  # an integer of any length is valid TOML
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"expected a finite number in {wanted!r}; found {value if isinstance(value, float) else 'one that is too large'}")
    return number if unit == wanted else convert(number, unit, wanted)


def expand(ports: Sequence[Port], values: Mapping[str, Any], causality: str = "parameter") -> dict[str, tuple[Any, str | None]]:
    """Value and place (None: set by code) per element from a mapping of element, scalar and whole-array names; values are not looked at.

    `causality` is what may be set. Raises PlacedError for unknown names, ports of another causality, shapes
    that do not fit, an element given twice.
    """
    parameters = [p for p in ports if p.causality == causality]
    elements, whole = {p.name for p in parameters}, arrays(parameters)
    result: dict[str, tuple[Any, str | None]] = {}
    for name, value in values.items():
        place = place_of(values, name)
        if name in elements:
            found = {name: (value, place)}
        elif name in whole:
            try:
                found = _elements(name, whole[name], value, lambda *index, of=name: place_of(values, of, *index))
            except ValueError as error:
                raise PlacedError(str(error), place) from None
        else:
            other = [p for p in ports if name in (p.name, p.name.partition("[")[0])]
            if other and other[0].causality == "structural parameter":
                text = f"{name!r} is a structural parameter: it decides sizes of arrays and keeps its value {other[0].start}"
                raise PlacedError(text, place)
            if other:
                raise PlacedError(f"{name!r} is {_a(other[0].causality)}, not {_a(causality)}", place)
            raise PlacedError(unknown(causality, name, whole), place)
        for element, v in found.items():
            if element in result:
                raise PlacedError(f"{causality} {element!r} is given twice: by element and within its array; leave one of them out", place)
            result[element] = v
    return result


def _a(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _elements(name: str, members: Sequence[Port], value: Any, place: Callable[..., str | None]) -> dict[str, tuple[Any, str | None]]:
    """`place(*index)` says where an element was written."""
    unit = None
    if isinstance(value, Mapping) and set(value) == {"value", "unit"}:
        value, unit = value["value"], value["unit"]
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
        raise ValueError(f"parameter {name!r} is an array of {len(members)} elements; found the single value {value!r}")
    flat = np.asarray(value, dtype=object)
    shape = tuple(int(i) for i in members[-1].name[len(name) + 1 : -1].split(","))
    if flat.shape not in (shape, (len(members),)):
        raise ValueError(f"parameter {name!r} has shape {list(shape)}; found values of shape {list(flat.shape)}")
    return {
        p.name: (v if unit is None else {"value": v, "unit": unit}, place(*index))
        for p, index, v in zip(members, np.ndindex(*flat.shape), flat.ravel(), strict=True)
    }


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
    if not values:
        return {}
    by_name = {p.name: p for p in ports}
    result: dict[str, Scalar] = {}
    try:
        for name, (value, place) in expand(ports, values, causality).items():
            try:
                result[name] = _scalar(by_name[name], value, convert, folder, place is not None)
            except ValueError as error:
                raise PlacedError(f"{causality} {name!r}: {error}", place) from None
    except PlacedError as error:
        raise PlacedError(f"component {component!r}: {error}", error.place) from None
    return result


def _scalar(port: Port, value: Any, convert: Convert, folder: Path | None, by_hand: bool) -> Scalar:
    """The value of one element as its port carries it; ValueError says what is wrong."""
    if port.type == "string" and port.causality == "parameter":
        return _text(value, folder)
    if port.type not in CARRIED:
        raise ValueError(f"is of type {port.type}, which cannot be set here; it keeps its start value")
    names = items(port)
    if isinstance(value, str) and value in names:
        return names[value]
    if isinstance(value, np.generic):
        value = value.item()
    if port.type == "boolean":
        if value in (True, False):
            return bool(value)
        raise ValueError(f"expected true or false; found {value!r}")
    if isinstance(value, str) and names:
        raise ValueError(f"expected an item of the enumeration: {_listed(names)}; found {value!r}")
    number = _number(value, port.unit or "1", convert, by_hand)
    if port.type == "integer":
        number = _whole(port, value, number)
    _check_bounds(port, number)
    return int(number) if port.type == "integer" else float(number)


def _number(value: Any, wanted: str, convert: Convert, by_hand: bool) -> float:
    """A finite number in the unit `wanted` from one, a text with a unit, or a table of value and unit."""
    if isinstance(value, Mapping):
        if set(value) != {"value", "unit"}:
            raise ValueError(f"expected a value or {{value = ..., unit = ...}}; found a table with {', '.join(value)}")
        if not isinstance(value["unit"], str | None) or isinstance(value["value"], str | bool):
            raise ValueError(f"expected {{value = <number>, unit = <text>}}; found {dict(value)!r}")
        given = quantity(value["value"], "1", convert)
        number = given if value["unit"] in (wanted, None) else convert(given, value["unit"], wanted)  # None: only from XML
    elif isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError(f"expected a number in {wanted!r}; found {value!r}")
    else:
        number = quantity(value, wanted, convert, bare=not by_hand)
    if not math.isfinite(number):
        raise ValueError(f"expected a finite number in {wanted!r}; found {value}")
    return number


def _whole(port: Port, value: Any, number: float) -> float:
    """The whole number that `value` stands for, `number` as a float, if the type of the port holds it and it is one of its items."""
    names = items(port)
    if number != int(number):
        raise ValueError(f"expected a whole number; found {value!r}")
    if isinstance(value, int):
        number = value  # exact beyond 2^53
    low, high = whole_range(port)
    if not low <= number <= high:
        raise ValueError(f"{int(number)} does not fit its type: expected {low} to {high}")
    if isinstance(number, float) and abs(number) > EXACT:
        raise ValueError(f"{value!r} may stand for several whole numbers; above {EXACT} write it without decimal point, exponent and unit")
    if names and number not in names.values():
        raise ValueError(f"expected an item of the enumeration: {_listed(names)}; found {value!r}")
    return number


def _check_bounds(port: Port, number: float) -> None:
    """ValueError for a number below the minimum of the port or above its maximum."""
    wanted = port.unit or "1"
    for bound, outside, word in (
        (port.minimum, port.minimum is not None and number < port.minimum, "below its minimum"),
        (port.maximum, port.maximum is not None and number > port.maximum, "above its maximum"),
    ):
        if outside:
            raise ValueError(f"{number:.9g} {wanted} is {word} {bound:.9g} {wanted}")


def _listed(names: Mapping[str, int]) -> str:
    return available(f"{name} ({value})" for name, value in names.items())


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
