"""The elements of an SSP system, nested ones flattened: components by their full names, and who is connected with whom.

A connection says nothing about its direction, and a connector of a nested system is only passed through. So everything that is
joined is one *net*: the output of one component, the inputs (or parameters) of others, and connectors of systems between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from robomill.orchestration.errors import available
from robomill.orchestration.ssp.files import Files, child
from robomill.orchestration.ssp.parameter_set import Given
from robomill.orchestration.ssp.values import bindings

FMU = ("", "application/x-fmu-sharedlibrary")
End = tuple[str, str]
"""Full name of a component or system ("" is the outermost), name of its connector."""


@dataclass
class Net:
    """Connectors that are joined."""

    ends: list[End]


class Structure:
    """The components of a system, its nets, and the values for both."""

    def __init__(self, files: Files, system: Element) -> None:
        self.files = files
        self.sources: dict[str, str] = {}
        """File of the FMU, by component."""
        self.values: dict[str, dict[str, Given]] = {}
        """By component and name of the variable; what stands further out wins."""
        self.nets: dict[End, Net] = {}
        self.connections: list[tuple[End, End]] = []
        """As they are written, ends with full names."""
        self._declared: dict[End, str] = {}
        self._members: dict[str, list[str]] = {}
        self._walk(system, "")

    def kind(self, end: End) -> str:
        """Kind of a component's connector: as declared, else as its FMU says, else empty."""
        declared = self._declared.get(end, "")
        if declared not in ("", "inout", "unspecified"):
            return declared
        found = (self.files.variables(self.sources[end[0]]) or {}).get(end[1])
        return found.causality if found is not None else ""

    def of_components(self, net: Net) -> Iterator[End]:
        """The ends of a net that belong to components."""
        return (end for end in net.ends if end[0] in self.sources)

    def _walk(self, system: Element, path: str) -> None:
        """Take in a system: what is within it first, so that what it says itself wins."""
        what = f"system {path!r}" if path else "the system"
        elements = child(system, "Elements")
        members: list[str] = []
        self._members[path] = members
        for element in elements if elements is not None else ():
            name = element.get("name", "")
            full = f"{path}.{name}" if path else name
            if element.tag not in ("Component", "System"):
                raise self.files.fail(
                    f"{element.tag} {full!r} cannot be read; only components and systems can: connect what it joins directly"
                )
            if not name or full in self.sources or full in self._members:
                raise self.files.fail(
                    f"{element.tag.lower()} {full!r}: its name is {'empty' if not name else 'given twice'}; give each a name of its own"
                )
            members.append(name)
            for connector in element.iterfind("Connectors/Connector"):
                self._declared[full, connector.get("name", "")] = connector.get("kind", "")
            if element.tag == "System":
                self._walk(element, full)
            else:
                self._component(element, full)
        self._connect(system, path, what)
        for name, given in bindings(self.files, system, what):
            self._apply(path, name, given)

    def _component(self, element: Element, name: str) -> None:
        kind = element.get("type", "")
        if kind not in FMU:
            raise self.files.fail(
                f"component {name!r} is of type {kind!r}; only FMUs ({FMU[1]}) can be run; export it as a co-simulation FMU"
            )
        if element.get("implementation", "any") not in ("any", "CoSimulation"):
            raise self.files.fail(
                f"component {name!r} demands {element.get('implementation')}; only co-simulation can be run"
                "; export it as a co-simulation FMU"
            )
        self.sources[name] = self.files.place(element.get("source", ""), f"component {name!r}")
        self.values[name] = {}
        for variable, given in bindings(self.files, element, f"component {name!r}"):
            self.values[name][variable] = given

    def _connect(self, system: Element, path: str, what: str) -> None:
        for element in system.iterfind("Connections/Connection"):
            ends: list[End] = []
            for side in ("start", "end"):
                name, connector = element.get(f"{side}Element", ""), element.get(f"{side}Connector", "")
                if name and name not in self._members[path]:
                    names = available(self._members[path])
                    raise self.files.fail(f"connection {written(element)} in {what}: there is no component {name!r}; available: {names}")
                ends.append((".".join(n for n in (path, name) if n), connector))
            for within in element:
                if within.tag.endswith("Transformation") and not _is_identity(within):
                    text = f"connection {written(element)}: a {within.tag} cannot be carried out; do it within a component"
                    raise self.files.fail(text)
            self.connections.append((ends[0], ends[1]))
            self._join(*ends)

    def _join(self, a: End, b: End) -> None:
        one, other = (self.nets.setdefault(e, Net([e])) for e in (a, b))
        if one is not other:
            one.ends += other.ends
            for end in other.ends:
                self.nets[end] = one

    def _apply(self, path: str, name: str, given: Given) -> None:
        """A value that a system gives: to its own connector of that name and to whatever within has it; else to nobody."""
        own = self.nets.get((path, name))
        ends = list(self.of_components(own)) if own is not None else []
        if all(self.kind(end) != "output" for end in ends):
            for component, variable in ends:
                self.values[component][variable] = given
        for member in self._members[path]:
            if name.startswith(f"{member}."):
                full, rest = f"{path}.{member}" if path else member, name[len(member) + 1 :]
                if full in self.sources:
                    self.values[full][rest] = given
                else:
                    self._apply(full, rest, given)


def written(connection: Element) -> str:
    """A connection as it is written."""
    ends = ((connection.get(f"{s}Element", ""), connection.get(f"{s}Connector", "")) for s in ("start", "end"))
    return " -> ".join(".".join(end) if end[0] else end[1] for end in ends)


def _is_identity(transformation: Element) -> bool:
    try:
        return (
            transformation.tag == "LinearTransformation"
            and float(transformation.get("factor", "1")) == 1.0
            and float(transformation.get("offset", "0")) == 0.0
        )
    except ValueError:
        return False
