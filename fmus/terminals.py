"""terminalsAndIcons/ of an FMU: ports that belong together as terminals, and the icon of the component.

FMI 3.0, section 2.4.9; FMI 2.0 has taken it over in 2.0.4, with the file as FMI 3.0 defines it. In FMI 2.0 an array is
scalars, so the members of a terminal are the elements: `force[1]` is `f_T_B[1]`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement

from robomill.fmus.interface import Interface
from robomill.fmus.model_description import xml_file

ICONS = Path(__file__).parent / "icons"
_DEFAULT = "robomill"
"""Icon of a component that has none of its own."""


class Terminal(NamedTuple):
    """Variables that belong together, with their roles."""

    name: str
    kind: str
    description: str
    members: tuple[tuple[str, str], ...]
    """(member, variable)."""


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


def terminals_and_icons(interface: Interface, arrays: bool) -> bytes:
    """The file as UTF-8; with `arrays` an array is one variable, else its elements are.

    Terminals of the same name fit each other: members match by name.
    """
    root = Element("fmiTerminalsAndIcons", fmiVersion="3.0")  # of the FMI that defines this file, also in an FMU of FMI 2.0
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
                elements = interface.model.variable(variable).element_names if not arrays else (variable,)
                for name in elements:
                    role = member + name.removeprefix(variable)
                    SubElement(element, "TerminalMemberVariable", variableName=name, memberName=role, variableKind="signal")
    return xml_file(root)


def terminal_files(interface: Interface, arrays: bool) -> dict[str, bytes]:
    """terminalsAndIcons/ of the archive: the description, the icon as PNG and as SVG."""
    name = interface.model.name if (ICONS / f"{interface.model.name}.png").is_file() else _DEFAULT
    return {
        "terminalsAndIcons/terminalsAndIcons.xml": terminals_and_icons(interface, arrays),
        "terminalsAndIcons/icon.png": (ICONS / f"{name}.png").read_bytes(),
        "terminalsAndIcons/icon.svg": (ICONS / f"{name}.svg").read_bytes().replace(b"\r\n", b"\n"),
    }
