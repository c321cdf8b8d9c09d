"""modelDescription.xml of an FMI 2.0 co-simulation FMU, written from the interface of a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from fmus.interface import Interface, Port
from models.units import UNITS

LOG_CATEGORIES = {
    "logStatusWarning": "Things worth knowing, such as that the model runs uncompiled",
    "logStatusError": "What went wrong, with variable or time, value and what is expected",
    "logStatusFatal": "The same, where the backend knows no other status",
    "logAll": "Everything else",
}
_TAGS = {"real": "Real", "integer": "Integer", "boolean": "Boolean", "string": "String"}


@dataclass(frozen=True)
class Options:
    """What depends on the backend and on what was found out about the model."""

    identifier: str
    guid: str
    tool: str
    version: str
    variable_step: bool
    initial_dependencies: Mapping[str, tuple[str, ...]]
    step: float = 0.004
    """Default communication step [s]."""
    no_memory_functions: bool = True
    """canNotUseMemoryManagementFunctions."""


def model_description(interface: Interface, options: Options) -> bytes:
    """The file as UTF-8: no dates, nothing of this machine, so equal models give equal files."""
    model = interface.model
    root = Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name,
        guid=options.guid,
        description=model.description,
        author="robomill",
        version=options.version,
        license="MIT; see documentation/licenses",
        generationTool=options.tool,
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    SubElement(
        root,
        "CoSimulation",
        modelIdentifier=options.identifier,
        needsExecutionTool="false",
        canHandleVariableCommunicationStepSize=boolean(options.variable_step),
        canInterpolateInputs="false",
        maxOutputDerivativeOrder="0",
        canRunAsynchronuously="false",
        canBeInstantiatedOnlyOncePerProcess="false",
        canNotUseMemoryManagementFunctions=boolean(options.no_memory_functions),
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative="false",
    )
    unit_definitions(root, interface)
    categories = SubElement(root, "LogCategories")
    for name, description in LOG_CATEGORIES.items():
        SubElement(categories, "Category", name=name, description=description)
    SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(options.step))
    variables = SubElement(root, "ModelVariables")
    for port in interface.ports:
        _variable(variables, port)
    _structure(root, interface, options.initial_dependencies)
    indent(root, "  ")
    text: str = tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def unit_definitions(root: Element, interface: Interface, others: tuple[str, ...] = ()) -> None:
    """Add the units in use and `others`, in SI, each with the display units in use (the same in FMI 2.0 and 3.0)."""
    used = {p.unit for p in interface.ports if p.unit}.union(others)
    if not used:
        return
    definitions = SubElement(root, "UnitDefinitions")
    for name in sorted(used):
        unit = SubElement(definitions, "Unit", name=name)
        SubElement(unit, "BaseUnit", {base: str(exponent) for base, exponent in UNITS[name].exponents.items()})
        for display in sorted({p.display_unit for p in interface.ports if p.unit == name and p.display_unit}):
            shown = UNITS[display]  # SI = factor * shown + offset; FMI wants shown = factor * SI + offset
            attributes = {"name": display, "factor": repr(1.0 / shown.factor)}
            if shown.offset:
                attributes["offset"] = repr(-shown.offset / shown.factor)
            SubElement(unit, "DisplayUnit", attributes)


def _variable(parent: Element, port: Port) -> None:
    attributes = {"name": port.name, "valueReference": str(port.reference), "description": port.description, "causality": port.causality}
    attributes["variability"] = port.variability
    if port.initial is not None:
        attributes["initial"] = port.initial
    variable = SubElement(parent, "ScalarVariable", attributes)
    typed: dict[str, str] = {}
    if port.unit is not None:
        typed["unit"] = port.unit
    if port.display_unit is not None:
        typed["displayUnit"] = port.display_unit
    if port.type in ("real", "integer"):
        for name, bound in (("min", port.minimum), ("max", port.maximum)):
            if bound is not None:
                typed[name] = repr(float(bound)) if port.type == "real" else str(int(bound))
    if port.initial != "calculated":
        typed["start"] = boolean(port.start) if port.type == "boolean" else port.start if isinstance(port.start, str) else repr(port.start)
    SubElement(variable, _TAGS[port.type], typed)


def _structure(root: Element, interface: Interface, initial: Mapping[str, tuple[str, ...]]) -> None:
    index = {p.name: str(i) for i, p in enumerate(interface.ports, start=1)}
    structure = SubElement(root, "ModelStructure")
    if not interface.outputs:
        return
    outputs = SubElement(structure, "Outputs")
    for port in interface.outputs:
        _unknown(outputs, index, port.name, port.dependencies)
    unknowns = SubElement(structure, "InitialUnknowns")
    parameters = tuple(p.name for p in interface.parameters)
    for port in interface.outputs:
        _unknown(unknowns, index, port.name, (*initial[port.name], *parameters))


def _unknown(parent: Element, index: Mapping[str, str], name: str, dependencies: tuple[str, ...] | None) -> None:
    """An entry without `dependencies` depends on everything; with an empty list on nothing."""
    attributes = {"index": index[name]}
    if dependencies is not None:
        attributes["dependencies"] = " ".join(index[d] for d in dependencies)
    SubElement(parent, "Unknown", attributes)


def boolean(value: object) -> str:
    """As XML writes it."""
    return "true" if value else "false"
