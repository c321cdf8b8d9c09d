"""modelDescription.xml of an FMI 3.0 co-simulation FMU.

A declared variable is one variable here, with dimensions; its value reference is that of its first element. For importers
without arrays each element can be a variable instead, with a value reference of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
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

_TAGS = {"real": "Float64", "integer": "Int64", "boolean": "Boolean", "string": "String"}
ELEMENT = 0x40000000
"""Added to the word of an element to make the value reference of a variable that is this element alone (`ELEMENT` in shim/fmu.c)."""


def model_description_3(interface: Interface, options: Options, arrays: bool = True) -> bytes:
    """The file as UTF-8: no dates, nothing of this machine. Without `arrays`, each element of one is a variable, as in FMI 2.0."""
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
    shown = _shown(interface, arrays)
    for one in shown.values():
        _variable(variables, one)
    _structure(root, interface, shown, options.initial_dependencies)
    return xml_file(root)


class _Shown(NamedTuple):
    """A variable of the description: a declared one, or an element of it."""

    name: str
    reference: int
    ports: tuple[Port, ...]
    shape: tuple[int, ...]


def _shown(interface: Interface, arrays: bool) -> dict[str, _Shown]:
    """The variables by name, in the order inputs, outputs, parameters."""
    groups: dict[str, list[Port]] = {}
    for port in interface.ports:
        groups.setdefault(port.variable if arrays else port.name, []).append(port)
    found = {}
    for name, ports in groups.items():
        first = ports[0]
        shape = interface.model.variable(first.variable).shape if name == first.variable and first.type != "string" else ()
        reference = first.reference | (0 if name == first.variable else ELEMENT)
        found[name] = _Shown(name, reference, tuple(ports), shape)
    return found


def _time_name(interface: Interface) -> str:
    return "time" if all(p.variable != "time" for p in interface.ports) else "simulation_time"


def _variable(parent: Element, one: _Shown) -> None:
    port = one.ports[0]
    attributes = variable_attributes(one.name, port) | type_attributes(port) | {"valueReference": str(one.reference)}
    if port.initial != "calculated" and port.type != "string":
        attributes["start"] = " ".join(start_value(p) for p in one.ports)
    variable = SubElement(parent, _TAGS[port.type], attributes)
    if port.type == "string":
        SubElement(variable, "Start", value=start_value(port))
    for length in one.shape:
        SubElement(variable, "Dimension", start=str(length))


def _structure(root: Element, interface: Interface, shown: Mapping[str, _Shown], initial: Mapping[str, tuple[str, ...]]) -> None:
    structure = SubElement(root, "ModelStructure")
    outputs = [one for one in shown.values() if one.ports[0].causality == "output"]
    for one in outputs:
        attributes = {"valueReference": str(one.reference)}
        if all(p.dependencies is not None for p in one.ports):
            attributes["dependencies"] = _references(shown, {d for p in one.ports for d in p.dependencies or ()})
        SubElement(structure, "Output", attributes)
    parameters = {p.name for p in interface.parameters}
    for one in outputs:
        dependencies = _references(shown, {d for p in one.ports for d in initial[p.name]} | parameters)
        SubElement(structure, "InitialUnknown", valueReference=str(one.reference), dependencies=dependencies)


def _references(shown: Mapping[str, _Shown], names: set[str]) -> str:
    """Value references of the variables that have one of these elements."""
    return " ".join(str(one.reference) for one in shown.values() if any(p.name in names for p in one.ports))
