"""Adopted effects as an SSP parameter set (`adopt.ssv`, SSP 1.0), written and read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from robomill.diagnosis.catalogue import LOGGING, Address
from robomill.orchestration.errors import unknown
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.written import Written

NAMESPACE = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
VERSION = "1.0"
_DOUBLE = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*")


class AdoptError(ValueError):
    """A parameter set that cannot be used; the text says why."""


def write(values: Mapping[Address, float], file: str | Path) -> Path:
    """Write `component.parameter` = value [unit of the parameter] for each; what is wrong with the log is left out."""
    ElementTree.register_namespace("ssv", NAMESPACE)
    root = ElementTree.Element(f"{{{NAMESPACE}}}ParameterSet", {"version": VERSION, "name": "adopt"})
    parameters = ElementTree.SubElement(root, f"{{{NAMESPACE}}}Parameters")
    for (component, name), value in sorted(values.items()):
        if component != LOGGING:
            parameter = ElementTree.SubElement(parameters, f"{{{NAMESPACE}}}Parameter", {"name": f"{component}.{name}"})
            ElementTree.SubElement(parameter, f"{{{NAMESPACE}}}Real", {"value": repr(float(value))})
    ElementTree.indent(root)
    path = Path(file)
    path.write_bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
    return path


def read(file: str | Path) -> dict[str, Written]:
    """Component -> parameter -> {value, unit}, each with the file as its place; a unit of None is that of the parameter (SSP 1.0).

    AdoptError or FileNotFoundError says what is wrong.
    """
    path = Path(file)
    if not path.is_file():
        raise FileNotFoundError(f"no parameter set {path}")
    text = path.read_text(encoding="utf-8")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise AdoptError(f"{path}: document types and entities are not read")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise AdoptError(f"{path}: not valid XML: {error}") from None
    if root.tag != f"{{{NAMESPACE}}}ParameterSet":
        raise AdoptError(f"{path}: expected an SSP 1.0 ParameterSet, found {root.tag}")
    if root.get("version") != VERSION:
        raise AdoptError(f"{path}: a parameter set of version {root.get('version')!r}; only {VERSION!r} is read")
    found: dict[str, dict[str, Any]] = {}
    for parameter in root.iter(f"{{{NAMESPACE}}}Parameter"):
        what = f"{path}: parameter {parameter.get('name')!r}"
        component, _, name = parameter.get("name", "").partition(".")
        real = parameter.find(f"{{{NAMESPACE}}}Real")
        if not name or real is None:
            raise AdoptError(f"{what}; expected a Real called component.parameter")
        if name in found.setdefault(component, {}):
            raise AdoptError(f"{what} is there twice")
        if not _DOUBLE.fullmatch(real.get("value", "")):
            raise AdoptError(f"{what}: {real.get('value')!r} is not a number")
        found[component][name] = {"value": float(real.get("value", "")), "unit": real.get("unit")}
    return {c: Written(values, {(name,): str(path) for name in values}) for c, values in found.items()}


def adopted(system: System, file: str | Path) -> System:
    """The system with the values of a parameter set in place of its own. AdoptError names components that it has not."""
    known = [c.name for c in system.components]
    for component, values in read(file).items():
        if component not in known:
            raise AdoptError(f"{file}: parameter '{component}.{next(iter(values))}': {unknown('component', component, known)}")
        system = system.with_parameters(component, values)
    return system
