"""modelDescription.xml of an FMI 2.0 co-simulation FMU, written from the interface of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element, SubElement

from robomill.fmus.interface import Interface, Port
from robomill.fmus.model_description import (
    LOG_CATEGORIES,
    Options,
    boolean,
    default_experiment,
    log_categories,
    root_element,
    start_value,
    type_attributes,
    unit_definitions,
    variable_attributes,
    xml_file,
)

_TAGS = {"real": "Real", "integer": "Integer", "boolean": "Boolean", "string": "String"}


def model_description_2(interface: Interface, options: Options, sources: Sequence[str] = ()) -> bytes:
    """The file as UTF-8: no dates, nothing of this machine, so equal models give equal files. `sources`: C files that make it."""
    root = root_element(interface, options, "2.0", "guid")
    root.set("numberOfEventIndicators", "0")
    simulation = SubElement(
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
    if sources:
        files = SubElement(simulation, "SourceFiles")
        for name in sources:
            SubElement(files, "File", name=name)
    unit_definitions(root, interface)
    log_categories(root, LOG_CATEGORIES)
    default_experiment(root, options)
    variables = SubElement(root, "ModelVariables")
    for port in interface.ports:
        _variable(variables, port)
    _structure(root, interface, options.initial_dependencies)
    return xml_file(root)


def _variable(parent: Element, port: Port) -> None:
    variable = SubElement(parent, "ScalarVariable", variable_attributes(port.name, port))
    typed = type_attributes(port)
    if port.initial != "calculated":
        typed["start"] = start_value(port)
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
