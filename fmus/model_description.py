"""What a modelDescription.xml of FMI 2.0 (`fmus.fmi2`) and one of FMI 3.0 (`fmus.native.fmi3`) have in common."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from robomill.fmus.instance import DEFAULT_STEP
from robomill.fmus.interface import Interface, Port
from robomill.models.model.units import unit_of

LOG_CATEGORIES = {
    "logStatusWarning": "Things worth knowing, such as that the model runs uncompiled",
    "logStatusError": "What went wrong, with variable or time, value and what is expected",
    "logStatusFatal": "The same, where the backend knows no other status",
    "logAll": "Everything else",
}


@dataclass(frozen=True)
class Options:
    """What depends on the backend and on what was found out about the model."""

    identifier: str
    guid: str
    tool: str
    version: str
    variable_step: bool
    initial_dependencies: Mapping[str, tuple[str, ...]]
    step: float = DEFAULT_STEP
    """Default communication step [s]."""
    no_memory_functions: bool = True
    """canNotUseMemoryManagementFunctions."""


def root_element(interface: Interface, options: Options, fmi: str, token: str) -> Element:
    """The root; `fmi` is the version of the standard, `token` the attribute in which it wants the GUID."""
    attributes = {
        "fmiVersion": fmi,
        "modelName": interface.model.name,
        token: options.guid,
        "description": interface.model.description,
        "author": "robomill",
        "version": options.version,
        "license": "MIT; see documentation/licenses",
        "generationTool": options.tool,
        "variableNamingConvention": "structured",
    }
    return Element("fmiModelDescription", attributes)


def unit_definitions(root: Element, interface: Interface, others: tuple[str, ...] = ()) -> None:
    """Add the units in use and `others`, in SI, each with the display units in use."""
    used = {p.unit for p in interface.ports if p.unit}.union(others)
    if not used:
        return
    definitions = SubElement(root, "UnitDefinitions")
    for name in sorted(used):
        unit = SubElement(definitions, "Unit", name=name)
        SubElement(unit, "BaseUnit", {base: str(exponent) for base, exponent in unit_of(name).exponents.items()})
        for display in sorted({p.display_unit for p in interface.ports if p.unit == name and p.display_unit}):
            shown = unit_of(display)  # SI = factor * shown + offset; FMI wants shown = factor * SI + offset
            attributes = {"name": display, "factor": repr(1.0 / shown.factor)}
            if shown.offset:
                attributes["offset"] = repr(-shown.offset / shown.factor)
            SubElement(unit, "DisplayUnit", attributes)


def log_categories(root: Element, names: Iterable[str]) -> None:
    """Add these of `LOG_CATEGORIES`."""
    categories = SubElement(root, "LogCategories")
    for name in names:
        SubElement(categories, "Category", name=name, description=LOG_CATEGORIES[name])


def default_experiment(root: Element, options: Options) -> None:
    """Add start time and communication step."""
    SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(options.step))


def variable_attributes(name: str, port: Port) -> dict[str, str]:
    """XML attributes of a variable of any type: name, value reference, description, causality, variability, initial."""
    attributes = {"name": name, "valueReference": str(port.reference), "description": port.description}
    attributes |= {"causality": port.causality, "variability": port.variability}
    if port.initial is not None:
        attributes["initial"] = port.initial
    return attributes


def type_attributes(port: Port) -> dict[str, str]:
    """Units and bounds, as far as it has any."""
    attributes = {}
    if port.unit is not None:
        attributes["unit"] = port.unit
    if port.display_unit is not None:
        attributes["displayUnit"] = port.display_unit
    if port.type in ("real", "integer"):
        for name, bound in (("min", port.minimum), ("max", port.maximum)):
            if bound is not None:
                attributes[name] = repr(float(bound)) if port.type == "real" else str(int(bound))
    return attributes


def start_value(port: Port) -> str:
    """As XML writes it."""
    if isinstance(port.start, str):
        return port.start
    return boolean(port.start) if port.type == "boolean" else repr(port.start)


def boolean(value: object) -> str:
    """As XML writes it."""
    return "true" if value else "false"


def xml_file(root: Element) -> bytes:
    """The file as UTF-8, indented."""
    indent(root, "  ")
    text: str = tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()
