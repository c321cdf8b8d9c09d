"""Parameter sets (SSV): the one writer, and the one reader of their values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from robomill.orchestration.ssp.files import Files, child, literal, xml_text

NAMESPACE = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
COMMON = "http://ssp-standard.org/SSP1/SystemStructureCommon"
ROOT = "ParameterSet"
TYPES = {"real": "Real", "integer": "Integer", "boolean": "Boolean", "string": "String"}
"""Type of a parameter set by type of a port."""
INTEGERS = tuple(f"{sign}Int{bits}" for bits in (8, 16, 32, 64) for sign in ("", "U"))
REALS = ("Real", "Float64", "Float32")


@dataclass(frozen=True)
class Given:
    """A value of a parameter set."""

    kind: str
    """Its type: Real, Integer, Boolean, String, Enumeration, Float64, ..."""
    value: Any
    """Or a list of them."""
    unit: str | None = None
    factor: float = 1.0
    offset: float = 0.0
    """Offset of a linear transformation, added after the value was turned into the unit of its target."""


def parameter_set(name: str, values: Mapping[str, tuple[str, Any]]) -> bytes:
    """The file of a parameter set: type of the port and value, by name of the parameter.

    It is of SSP 1.0, or, where a value is an array, of SSP 2.0, which has arrays.
    """
    arrays = any(isinstance(value, np.ndarray) for _, value in values.values())
    attributes = {"xmlns:ssv": NAMESPACE, "version": "2.0" if arrays else "1.0", "name": name}
    root = Element("ssv:ParameterSet", attributes | ({"xmlns:ssc": COMMON} if arrays else {}))
    parameters = SubElement(root, "ssv:Parameters")
    for key, (kind, value) in values.items():
        parameter = SubElement(parameters, "ssv:Parameter", name=key)
        array = value if isinstance(value, np.ndarray) else np.array([value], dtype=object)
        SubElement(parameter, f"ssv:{TYPES[kind]}", value=" ".join(literal(v) for v in array.ravel().tolist()))
        for size in array.shape if array is value else ():
            SubElement(parameter, "ssc:Dimension", size=str(size))
    return xml_text(root)


def given_by(files: Files, parameter: Element, what: str) -> Given:
    """The value of a Parameter element; SystemFileError where it has none of its type."""
    typed = next((e for e in parameter if e.tag not in ("Annotations", "Dimension")), None)
    kind = "nothing" if typed is None else typed.tag
    texts = [] if typed is None else [v.get("value", v.text or "") for v in typed.iterfind("Value")]
    text = None if typed is None else typed.get("value")
    if typed is None or kind not in VALUES or (text is None and not texts):
        raise files.fail(f"{what} is of type {kind}; expected a value of type {', '.join(VALUES)}")
    is_array = child(parameter, "Dimension") is not None
    if text is not None:
        texts = text.split() if is_array and kind != "String" else [text]
    try:
        values = [VALUES[kind](t) for t in texts]
    except ValueError:
        raise files.fail(f"{what} = {text or texts!r} is not of type {kind}; correct the value, or its type") from None
    return Given(kind, values if is_array else values[0], typed.get("unit"))


def _real(text: str) -> float:
    """A finite number as XML Schema writes it: without the underscores that Python allows."""
    if "_" in text or not math.isfinite(float(text)):
        raise ValueError(text)
    return float(text)


def truth(text: str) -> bool:
    """A boolean of XML Schema."""
    if text.strip() not in ("true", "false", "1", "0"):
        raise ValueError(text)
    return text.strip() in ("true", "1")


VALUES: dict[str, Any] = {
    **dict.fromkeys(REALS, _real),
    "Integer": int,
    **dict.fromkeys(INTEGERS, int),
    "Boolean": truth,
    "String": str,
    "Enumeration": str,
}
"""How the text of a value is read, by its type."""
