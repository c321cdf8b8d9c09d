"""modelDescription.xml and terminalsAndIcons.xml of an FMI 3.0 co-simulation FMU.

A declared variable is one variable here, with dimensions; its value reference is that of its first element.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement

from robomill.fmus.interface import WORD, Interface, Port
from robomill.fmus.model_description import (
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
from robomill.models.model.declaration import Variable

_TAGS = {"real": "Float64", "integer": "Int64", "boolean": "Boolean", "string": "String"}


class Terminal(NamedTuple):
    """Variables that belong together, with their roles."""

    name: str
    kind: str
    description: str
    members: tuple[tuple[str, str], ...]
    """(member, variable)."""


def model_description_3(interface: Interface, options: Options) -> bytes:
    """The file as UTF-8: no dates, nothing of this machine."""
    root = root_element(interface, options, "3.0", "instantiationToken")
    SubElement(
        root,
        "CoSimulation",
        modelIdentifier=options.identifier,
        canHandleVariableCommunicationStepSize=boolean(options.variable_step),
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
    )
    unit_definitions(root, interface, ("s",))
    log_categories(root, ("logStatusError",))
    default_experiment(root, options)
    variables = SubElement(root, "ModelVariables")
    SubElement(
        variables,
        "Float64",
        name=_time_name(interface),
        valueReference=str(interface.model.dtype.itemsize // WORD),
        description="Time",
        causality="independent",
        variability="continuous",
        unit="s",
    )
    first = _first_ports(interface)
    for name, port in first.items():
        _variable(variables, interface.model.variable(name), port, [start_value(p) for p in interface.ports if p.variable == name])
    _structure(root, interface, first, options.initial_dependencies)
    return xml_file(root)


def _first_ports(interface: Interface) -> dict[str, Port]:
    """Declared variable -> its first element, in the order inputs, outputs, parameters."""
    found: dict[str, Port] = {}
    for port in interface.ports:
        found.setdefault(port.variable, port)
    return found


def _time_name(interface: Interface) -> str:
    return "time" if all(p.variable != "time" for p in interface.ports) else "simulation_time"


def _variable(parent: Element, v: Variable, port: Port, starts: list[str]) -> None:
    attributes = variable_attributes(v.name, port) | type_attributes(port)
    if port.initial != "calculated" and port.type != "string":
        attributes["start"] = " ".join(starts)
    variable = SubElement(parent, _TAGS[port.type], attributes)
    if port.type == "string":
        SubElement(variable, "Start", value=starts[0])
    else:
        for length in v.shape:
            SubElement(variable, "Dimension", start=str(length))


def _structure(root: Element, interface: Interface, first: Mapping[str, Port], initial: Mapping[str, tuple[str, ...]]) -> None:
    structure = SubElement(root, "ModelStructure")
    outputs = {name: [p for p in interface.outputs if p.variable == name] for name in dict.fromkeys(p.variable for p in interface.outputs)}
    for name, ports in outputs.items():
        attributes = {"valueReference": str(first[name].reference)}
        if all(p.dependencies is not None for p in ports):
            attributes["dependencies"] = _references(interface, first, {d for p in ports for d in p.dependencies or ()})
        SubElement(structure, "Output", attributes)
    parameters = {p.name for p in interface.parameters}
    for name, ports in outputs.items():
        dependencies = _references(interface, first, {d for p in ports for d in initial[p.name]} | parameters)
        SubElement(structure, "InitialUnknown", valueReference=str(first[name].reference), dependencies=dependencies)


def _references(interface: Interface, first: Mapping[str, Port], names: set[str]) -> str:
    """Value references of the declared variables that have one of these elements."""
    return " ".join(str(first[v].reference) for v in dict.fromkeys(p.variable for p in interface.ports if p.name in names))


def terminals(interface: Interface) -> Iterator[Terminal]:
    """Wrenches, forces, poses and displacements among the inputs and outputs, found by the names of docs/nomenclature.md."""
    for causality in ("input", "output"):
        ports = {v.name: v for v in interface.model.variables if v.causality == causality}
        for name, v in ports.items():
            start, _, rest = name.partition("_")
            if start == "f" and v.shape == (3,) and f"m_{rest}" in ports:
                yield Terminal(f"wrench_{rest}", "wrench", "Force and moment on the tool", (("force", name), ("moment", f"m_{rest}")))
            elif start == "f" and v.shape == (3,):
                yield Terminal(f"force_{rest}", "force", v.description, (("force", name),))
            elif start == "p" and f"quat_{rest.partition('_')[0]}" in ports:
                frames = rest.partition("_")[0]
                members = (("position", name), ("orientation", f"quat_{frames}"))
                yield Terminal(f"pose_{frames}", "pose", f"Pose of {frames[1:]} in {frames[:1]}: position and unit quaternion", members)
            elif start == "d" and f"theta_{rest}" in ports:
                members = (("translation", name), ("rotation", f"theta_{rest}"))
                yield Terminal(f"displacement_{rest}", "displacement", "Small displacement and rotation", members)


def terminals_and_icons(interface: Interface) -> bytes:
    """The file as UTF-8. Terminals of the same name fit each other: members match by name."""
    root = Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    corners = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}
    graphics = SubElement(root, "GraphicalRepresentation")
    SubElement(graphics, "CoordinateSystem", {**corners, "suggestedScalingFactorTo_mm": "0.1"})
    SubElement(graphics, "Icon", corners)
    found = tuple(terminals(interface))
    if found:
        parent = SubElement(root, "Terminals")
        for terminal in found:
            attributes = {"name": terminal.name, "matchingRule": "plug", "terminalKind": f"robomill.{terminal.kind}"}
            element = SubElement(parent, "Terminal", {**attributes, "description": terminal.description})
            for member, variable in terminal.members:
                SubElement(element, "TerminalMemberVariable", variableName=variable, memberName=member, variableKind="signal")
    return xml_file(root)
