"""Adopted effects as an SSP parameter set (`adopt.ssv`, SSP 1.0), written and read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from diagnosis.catalogue import LOGGING, Address

NAMESPACE = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"


class AdoptError(ValueError):
    """A parameter set that cannot be used; the text says why."""


def write(values: Mapping[Address, float], file: str | Path) -> Path:
    """Write `component.parameter` = value [unit of the parameter] for each; what is wrong with the log is left out."""
    ElementTree.register_namespace("ssv", NAMESPACE)
    root = ElementTree.Element(f"{{{NAMESPACE}}}ParameterSet", {"version": "1.0", "name": "adopt"})
    parameters = ElementTree.SubElement(root, f"{{{NAMESPACE}}}Parameters")
    for (component, name), value in sorted(values.items()):
        if component != LOGGING:
            parameter = ElementTree.SubElement(parameters, f"{{{NAMESPACE}}}Parameter", {"name": f"{component}.{name}"})
            ElementTree.SubElement(parameter, f"{{{NAMESPACE}}}Real", {"value": repr(float(value))})
    ElementTree.indent(root)
    path = Path(file)
    path.write_bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
    return path


def read(file: str | Path) -> dict[str, dict[str, float]]:
    """Component -> parameter -> value. AdoptError or FileNotFoundError says what is wrong."""
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
    found: dict[str, dict[str, float]] = {}
    for parameter in root.iter(f"{{{NAMESPACE}}}Parameter"):
        component, _, name = parameter.get("name", "").partition(".")
        real = parameter.find(f"{{{NAMESPACE}}}Real")
        if not name or real is None:
            raise AdoptError(f"{path}: parameter {parameter.get('name')!r}; expected a Real called component.parameter")
        try:
            found.setdefault(component, {})[name] = float(real.get("value", ""))
        except ValueError:
            raise AdoptError(f"{path}: parameter {parameter.get('name')!r}: {real.get('value')!r} is not a number") from None
    return found
