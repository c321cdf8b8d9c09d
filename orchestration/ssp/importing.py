"""SSP packages, version 1.0 and 2.0, as systems, also those that others wrote.

What is read: `SystemStructure.ssd` with FMUs as components, nested systems (flattened: `ssp_structure`), parameter sets and
mappings (`ssp_values`), connections in either direction, the start and end of the experiment; the step and the algorithm from our
own annotation, or the step where libcosim, Ecos and OMSimulator keep it. Connectors of the outermost system are the outside:
nothing comes from there, nothing goes there. Anything else that would change numbers (packages within packages,
transformations of connections, signal dictionaries) is refused, with its name.
"""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree.ElementTree import Element

from robomill.orchestration.errors import SystemFileError, available, unknown
from robomill.orchestration.loop.acceleration import Iteration
from robomill.orchestration.slaves.archive import unpack
from robomill.orchestration.slaves.protocol import base_name
from robomill.orchestration.ssp.export import ANNOTATION, SSD
from robomill.orchestration.ssp.files import Files, child
from robomill.orchestration.ssp.parameter_set import truth
from robomill.orchestration.ssp.structure import End, Net, Structure
from robomill.orchestration.ssp.values import resolved
from robomill.orchestration.system.definition import Component, Connection, Recording, System

DEFAULT_ALGORITHM = "jacobi"
"""Where the package does not say: what other importers do, and needs no order of components."""


@dataclass(frozen=True)
class Package:
    """A system from a package; its files are there as long as `open_ssp` is."""

    system: System
    start: float
    """Start of the experiment [s]."""
    ignored: tuple[str, ...] = ()
    """One text per value for a variable that its FMU does not have: the standard wants such values ignored."""


@contextmanager
def open_ssp(file: str | Path, step: float | None = None) -> Iterator[Package]:
    """The system in the package `file`, unpacked into a temporary folder for the time of the context.

    `step` [s] replaces that of the package. SlaveError (the archive) or SystemFileError (its content) with one clear text.
    """
    file = Path(file)
    with tempfile.TemporaryDirectory(prefix="robomill_ssp_", ignore_cleanup_errors=True) as name:
        folder = Path(name).resolve()
        names = unpack(file, folder, kind="SSP")
        if SSD not in names:
            raise SystemFileError(
                f"{file}: no {SSD} in it, so not an SSP; it holds {available(sorted(names), 20)}; "
                f"pack the folder that holds {SSD}, not the folder around it"
            )
        yield _Reader(Files(file, folder, set(names)), step).package()


class _Reader:
    """One package while it is read."""

    def __init__(self, files: Files, step: float | None) -> None:
        self.files, self.step, self.fail = files, step, files.fail
        self.ignored: list[str] = []

    def package(self) -> Package:
        root = self.files.xml(SSD, "SystemStructureDescription")
        if root.get("version", "") != "2.0" and not root.get("version", "").startswith("1."):
            raise self.fail(
                f"is of SSP version {root.get('version', 'unknown')!r}; only 1.0 and 2.0 can be read; export it as one of these"
            )
        inner = child(root, "System")
        if inner is None:
            raise self.fail(f"{SSD} holds no System; add the element System")
        structure = Structure(self.files, inner)
        if not structure.sources:
            raise self.fail("the system has no components; add at least one")
        names = self.identifiers(structure)
        # packages of earlier versions have it at the root
        master = next((a for a in (_annotation(e, ANNOTATION, "Master") for e in (inner, root)) if a is not None), None)
        experiment = child(root, "DefaultExperiment")
        system = System(
            name=root.get("name") or self.files.file.stem,
            description=inner.get("description", ""),
            step=self.communication_step(root, inner, experiment, master),
            components=tuple(self.component(name, names[name], structure, master) for name in structure.sources),
            connections=tuple(self.connections(structure, names, master)),
            stop=self.number(experiment, "stopTime"),
            file=self.files.folder / SSD,
            **self.settings(master),
        )
        return Package(system, self.number(experiment, "startTime") or 0.0, tuple(self.ignored))

    def identifiers(self, structure: Structure) -> dict[str, str]:
        """Names of components as our own systems have them, by their full names in the package."""
        found: dict[str, str] = {}
        for name in structure.sources:
            safe = re.sub(r"\W", "_", name, flags=re.ASCII)
            while safe in found.values():
                safe += "_"
            found[name] = safe
        return found

    def component(self, name: str, safe: str, structure: Structure, master: Element | None) -> Component:
        """A component with its values: those of inputs are start values."""
        source = structure.sources[name]
        variables = self.files.variables(source) if structure.values[name] else None
        parameters: dict[str, Any] = {}
        inputs: dict[str, Any] = {}
        for key, given in structure.values[name].items():
            variable = None if variables is None else variables.get(key) or variables.get(base_name(key))
            if variable is None and variables is not None:
                self.ignored.append(f"component {name!r}: " + unknown("variable", key, variables))
                continue
            value = resolved(self.files, given, variable, f"component {name!r}: parameter {key!r}")
            if given.kind == "String" and isinstance(value, str) and str(PurePosixPath(value)) in self.files.names:
                value = {"file": value}  # relative to the package, wherever it is unpacked
            (inputs if variable is not None and variable.causality == "input" else parameters)[key] = value
        told = next((e for e in master.iterfind("Component") if e.get("name") == name), None) if master is not None else None
        known = self.read(told, {f.name: f.type for f in fields(Component) if f.name in ("isolate", "time_limit", "rate", "every")})
        return Component(safe, source, parameters=parameters, inputs=inputs, **known)

    def connections(self, structure: Structure, names: Mapping[str, str], master: Element | None) -> Iterator[Connection]:
        """One per input, in the order in which they are first named."""
        delayed = {frozenset(_ends(e)) for e in master.iterfind("Delayed")} if master is not None else set()
        sources: dict[int, End | None] = {}
        done: set[End] = set()
        for ends in structure.connections:
            net = structure.nets[ends[0]]
            if id(net) not in sources:
                sources[id(net)] = self.source(structure, net)
            source = sources[id(net)]
            for end in ends:
                if source is not None and end != source and end[0] in structure.sources and end not in done:
                    done.add(end)
                    a, b = (f"{names[component]}.{connector}" for component, connector in (source, end))
                    yield Connection(a, b, frozenset(ends) in delayed)

    def source(self, structure: Structure, net: Net) -> End | None:
        """The one output of a net; None if it comes from the outside, or if it joins parameters that got their values from there."""
        ends = list(structure.of_components(net))
        kinds = {end: structure.kind(end) for end in ends}
        outputs = [end for end in ends if kinds[end] in ("output", "local", "calculatedParameter")]
        text = " and ".join(f"{component}.{connector}" for component, connector in ends)
        if any("arameter" in kind for kind in kinds.values()) and (outputs or len(ends) == len(net.ends)):
            raise self.fail(f"connection of {text}: parameters cannot be connected; give each its value")
        if len(outputs) > 1:
            raise self.fail(
                f"connection of {text}: {len(outputs)} outputs are joined; an input can have one source only; leave one connection"
            )
        unknown_kinds = [end for end in ends if not kinds[end]]
        if not outputs and unknown_kinds:  # a connector that neither the package nor the FMU describes: the run says what there is
            return unknown_kinds[0]
        return outputs[0] if outputs else None

    # Settings

    def communication_step(self, root: Element, inner: Element, experiment: Element | None, master: Element | None) -> float:
        if self.step is not None:
            return self.step
        places = (
            (master, "step"),
            (_annotation(experiment, "com.opensimulationplatform", "Algorithm/FixedStepAlgorithm"), "baseStepSize"),
            (_annotation(inner, "org.openmodelica", "Annotations/SimulationInformation/FixedStepMaster"), "stepSize"),
            (_annotation(inner, "org.openmodelica", "Annotations/SimulationInformation"), "fixedStepSize"),
        )
        for element, attribute in places:
            value = self.number(element, attribute)
            if value is not None:
                return value
        raise self.fail("does not say how long a communication step is: give one (--step)")

    def settings(self, master: Element | None) -> dict[str, Any]:
        """Keywords for `System` from our own annotation."""
        if master is None:
            return {"algorithm": DEFAULT_ALGORITHM}
        found: dict[str, Any] = {"algorithm": master.get("algorithm", DEFAULT_ALGORITHM), "stop_when": master.get("stopWhen")}
        found |= {
            key: value
            for key, attribute in (("require_connected", "requireConnected"), ("check_ranges", "checkRanges"))
            if (value := self.value(master, attribute, "bool")) is not None
        }
        iteration = child(master, "Iteration")
        if iteration is not None:
            found["iteration"] = Iteration(**self.read(iteration, {f.name: f.type for f in fields(Iteration)}))
        record = child(master, "Recording")
        if record is not None:
            columns = tuple(c.get("name", "") for c in record.iterfind("Column"))
            plain = self.read(record, {f.name: f.type for f in fields(Recording) if f.name != "columns"})
            found["recording"] = replace(Recording(columns=columns) if columns else Recording(), **plain)
        found["labels"] = {e.get("name", ""): self.value(e, "value", e.get("type", "str")) for e in master.iterfind("Label")}
        return found

    def read(self, element: Element | None, types: Mapping[str, Any]) -> dict[str, Any]:
        """The attributes of those names that are there, as those types."""
        if element is None:
            return {}
        return {k: self.value(element, k, str(t)) for k, t in types.items() if element.get(k) is not None}

    def value(self, element: Element, attribute: str, kind: str) -> Any:
        text = element.get(attribute)
        if text is None:
            return None
        try:
            return _KINDS[kind](text)
        except (KeyError, ValueError):
            raise self.fail(f"{element.tag}: {attribute} = {text!r} is not a value of type {kind}; correct the value") from None

    def number(self, element: Element | None, attribute: str) -> float | None:
        return None if element is None else self.value(element, attribute, "float")


def _finite(text: str) -> float:
    if not math.isfinite(float(text)):
        raise ValueError(text)
    return float(text)


_KINDS: dict[str, Any] = {"float": _finite, "int": int, "bool": truth, "str": str}


def _annotation(element: Element | None, kind: str, path: str = "") -> Element | None:
    """Our part of an annotation, or what stands at `path` in it."""
    if element is None:
        return None
    for annotation in element.iterfind("Annotations/Annotation"):
        if annotation.get("type") == kind:
            return annotation.find(path) if path else annotation
    return None


def _ends(e: Element) -> tuple[End, End]:
    return (e.get("startElement", ""), e.get("startConnector", "")), (e.get("endElement", ""), e.get("endConnector", ""))
