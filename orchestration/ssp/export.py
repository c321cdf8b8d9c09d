"""A system as an SSP 1.0 package, in the form that every importer reads.

Flat: components in one system, no connectors of the system, connections element by element, only connectors that are
connected; one parameter set named `default` per component, in a file of its own beside the FMUs, no mappings; the
prefixes `ssd`, `ssc` and `ssv`, which some importers take literally. Files of parameters that are texts (tables) go into
the FMU if it is one of ours (`ssp_tables`), else to `resources/`; the value is then the path within the package. What SSP has
no words for is in annotations that others may ignore: our own (`ANNOTATION`: algorithm, delayed connections, end of the run,
...) and the step where libcosim, Ecos and OMSimulator look for it.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from robomill.orchestration.assembly import Assembly, assemble
from robomill.orchestration.errors import SystemFileError
from robomill.orchestration.slaves.description import FMI_2, FMI_3
from robomill.orchestration.slaves.protocol import Port, Scalar, arrays, inputs, outputs
from robomill.orchestration.ssp.files import literal, xml_text
from robomill.orchestration.ssp.parameter_set import NAMESPACE, TYPES, parameter_set
from robomill.orchestration.ssp.tables import carrying
from robomill.orchestration.system.definition import Component, Recording, System
from robomill.orchestration.system.parameters import Convert, same_unit_only

ANNOTATION = "com.github.robomill"
NAMESPACES = {
    "xmlns:ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "xmlns:ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "xmlns:ssv": NAMESPACE,
    "xmlns:osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "xmlns:oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
    "xmlns:robomill": "urn:robomill:ssp:1",
}
SSD = "SystemStructure.ssd"
RESOURCES = "resources"
SET = "default"
_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad", "factor", "offset")
_EPOCH = (1980, 1, 1, 0, 0, 0)


def export(system: System, file: str | Path, convert: Convert = same_unit_only) -> Path:
    """Write `system`, whose components are all FMUs, as the package `file`; returns its path.

    All that `assemble` checks is checked, and what it raises is raised. SystemFileError names components that are no FMUs,
    or FMUs of FMI 3.0, whose arrays SSP 1.0 cannot connect.
    """
    others = [f"{c.name} ({c.source})" for c in system.components if not c.source.endswith(".fmu")]
    if others:
        raise SystemFileError(
            f"{system.where(None)}an SSP holds FMUs; not one yet: {', '.join(others)}: build them and name them as sources"
        )
    if corrected := [c.name for c in system.components if c.correction is not None]:
        raise SystemFileError(
            f"{system.where(None)}an SSP has no place for corrections: {', '.join(corrected)}: make each a component on its connection"
        )
    here = replace(system, components=tuple(replace(c, isolate=False) for c in system.components))
    with assemble(here, convert=convert) as assembly:
        new = [name for name, slave in assembly.slaves.items() if getattr(_description(slave), "fmi", FMI_2) == FMI_3]
        if new:
            raise SystemFileError(
                f"{system.where(None)}an SSP 1.0 connects FMUs of FMI 2.0; of FMI 3.0: {', '.join(new)}: build them with --fmi 2"
            )
        content = _Package(assembly, system).content()
    file = Path(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(file.name + ".part")
    with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.create_system, entry.external_attr = 3, 0o100644 << 16
            entry.compress_type = zipfile.ZIP_STORED if name.endswith(".fmu") else zipfile.ZIP_DEFLATED  # FMUs are compressed already
            archive.writestr(entry, data)
    part.replace(file)
    return file


def _description(slave: Any) -> Any:
    """Description of the FMU, also of one that steps at another rate; None for another slave."""
    return getattr(getattr(slave, "inside", slave), "description", None)


class _Package:
    """The files of a package, made from an assembled system."""

    def __init__(self, assembly: Assembly, system: System) -> None:
        self.system, self.assembly = system, assembly
        self.ports = {name: slave.ports for name, slave in assembly.slaves.items()}
        self.files: dict[str, bytes] = {}
        self.pairs = [
            (source, target, c.delayed)
            for c in self.system.connections
            for source, target in zip(self._elements(c.source, outputs), self._elements(c.target, inputs), strict=True)
        ]

    def _elements(self, end: str, select: Any) -> list[tuple[str, str]]:
        name, _, port = end.partition(".")
        ports = select(self.ports[name])
        return [(name, p.name) for p in arrays(ports).get(port) or [p for p in ports if p.name == port]]

    def content(self) -> dict[str, bytes]:
        """File by name: the description first, then resources by name."""
        ssd = self._description()
        return {SSD: ssd, **dict(sorted(self.files.items()))}

    def _description(self) -> bytes:
        s = self.system
        root = Element("ssd:SystemStructureDescription", {**NAMESPACES, "name": s.name, "version": "1.0", "generationTool": "robomill"})
        inner = SubElement(root, "ssd:System", _some(name=_identifier(s.name), description=s.description))
        elements = SubElement(inner, "ssd:Elements")
        sources: dict[bytes, str] = {}
        for c in s.components:
            self._component(elements, c, sources)
        if self.pairs:
            connections = SubElement(inner, "ssd:Connections")
            for (a, x), (b, y), _ in self.pairs:
                SubElement(connections, "ssd:Connection", startElement=a, startConnector=x, endElement=b, endConnector=y)
        annotations = SubElement(inner, "ssd:Annotations")
        self._for_omsimulator(_annotation(annotations, "org.openmodelica"))  # first: version 2 looks at no other
        self._master(_annotation(annotations, ANNOTATION))
        self._units(root)
        experiment = SubElement(root, "ssd:DefaultExperiment", startTime="0.0")
        if s.stop is not None:
            experiment.set("stopTime", repr(float(s.stop)))
        algorithm = SubElement(_annotation(SubElement(experiment, "ssd:Annotations"), "com.opensimulationplatform"), "osp:Algorithm")
        SubElement(algorithm, "osp:FixedStepAlgorithm", baseStepSize=repr(s.step))
        return xml_text(root)

    def _for_omsimulator(self, annotation: Element) -> None:
        """The fixed step, where OMSimulator 3 (attributes; this name is that of its default for co-simulation) and 2 (element) look."""
        step = repr(self.system.step)
        name = {"name": "oms_ma_default", "method": "oms_ma", "fixedStepSize": step}
        simulation = SubElement(SubElement(annotation, "oms:Annotations"), "oms:SimulationInformation", name)
        tolerances = {"absoluteTolerance": "1e-4", "relativeTolerance": "1e-4"}  # must be there, have no effect with a fixed step
        SubElement(simulation, "oms:FixedStepMaster", {"description": "oms-ma", "stepSize": step, **tolerances})

    def _component(self, parent: Element, c: Component, sources: dict[bytes, str]) -> None:
        fmu, values = self._with_tables(c)
        place = sources.setdefault(fmu, self._free(f"{RESOURCES}/{Path(c.source).name}"))
        self.files[place] = fmu
        component = SubElement(parent, "ssd:Component", name=c.name, type="application/x-fmu-sharedlibrary", source=place)
        ends = {e for source, target, _ in self.pairs for e in (source, target)}
        connected = [p for p in self.ports[c.name] if (c.name, p.name) in ends]
        if connected:
            connectors = SubElement(component, "ssd:Connectors")
            for p in connected:
                connector = SubElement(connectors, "ssd:Connector", name=p.name, kind=p.causality)
                SubElement(connector, f"ssc:{TYPES[p.type]}", _some(unit=p.unit if p.type == "real" else None))
        values |= self.assembly.inputs.get(c.name, {})
        if values:
            bindings = SubElement(component, "ssd:ParameterBindings")
            SubElement(bindings, "ssd:ParameterBinding", source=self._parameter_set(c.name, values))

    def _with_tables(self, c: Component) -> tuple[bytes, dict[str, Scalar]]:
        """The FMU of a component and its parameters: files that are named stand in the FMU itself, if it is one of ours."""
        fmu, values = (self.system.folder / c.source).read_bytes(), dict(self.assembly.parameters[c.name])
        if not getattr(_description(self.assembly.slaves[c.name]), "carries_tables", False):
            return fmu, values
        texts = {p.name for p in self.ports[c.name] if p.type == "string"}
        tables = {name: Path(str(values.pop(name))).read_bytes() for name in texts & values.keys() if values[name]}
        return carrying(fmu, tables) if tables else fmu, values

    def _parameter_set(self, name: str, values: Mapping[str, Scalar]) -> str:
        ports: dict[str, Port] = {p.name: p for p in self.ports[name]}
        typed: dict[str, tuple[str, Any]] = {}
        for key, value in values.items():
            is_file = ports[key].type == "string" and Path(str(value)).is_file()
            typed[key] = ports[key].type, self._pack(name, key, Path(str(value))) if is_file else value
        place = self._free(f"{RESOURCES}/{name}.ssv")
        self.files[place] = parameter_set(SET, typed)
        return place

    def _pack(self, name: str, key: str, file: Path) -> str:
        place = self._free(f"{RESOURCES}/{name}_{key}{file.suffix}")
        self.files[place] = file.read_bytes()
        return place

    def _free(self, place: str) -> str:
        """The name, or one like it that is not taken."""
        path, number = Path(place), 1
        while place in self.files:
            number += 1
            place = f"{RESOURCES}/{path.stem}_{number}{path.suffix}"
        return place

    def _units(self, root: Element) -> None:
        """Definitions of the units that connectors have, as the FMUs define them."""
        known: dict[str, Any] = {}
        for slave in self.assembly.slaves.values():
            known |= getattr(_description(slave), "units", {})
        used = sorted({p.unit for ports in self.ports.values() for p in ports if p.unit is not None and p.unit in known})
        if used:
            units = SubElement(root, "ssd:Units")
            for name in used:
                base = known[name].baseUnit
                found = {key: getattr(base, key, None) for key in _BASE} if base is not None else {}
                defaults = {"factor": 1.0, "offset": 0.0}
                exponents = {k: str(v) for k, v in found.items() if v is not None and float(v) != defaults.get(k, 0.0)}
                SubElement(SubElement(units, "ssc:Unit", name=name), "ssc:BaseUnit", exponents)

    def _master(self, parent: Element) -> None:
        """What only our own master knows. `ssp_import` reads it."""
        s = self.system
        settings = _some(
            step=repr(s.step),
            algorithm=s.algorithm,
            stopWhen=s.stop_when,
            requireConnected=literal(s.require_connected),
            checkRanges=literal(s.check_ranges),
        )
        master = SubElement(parent, "robomill:Master", settings)
        for (a, x), (b, y), delayed in self.pairs:
            if delayed:
                SubElement(master, "robomill:Delayed", startElement=a, startConnector=x, endElement=b, endConnector=y)
        for c in s.components:
            default = Component("", "")
            changed = {k: getattr(c, k) for k in ("isolate", "time_limit", "rate", "every") if getattr(c, k) != getattr(default, k)}
            if changed:
                SubElement(master, "robomill:Component", {"name": c.name, **{k: literal(v) for k, v in changed.items()}})
        if s.algorithm == "iterated":
            SubElement(master, "robomill:Iteration", {k: literal(v) for k, v in asdict(s.iteration).items()})
        recording = {f.name: getattr(s.recording, f.name) for f in fields(Recording) if f.name != "columns"}
        record = SubElement(master, "robomill:Recording", {k: literal(v) for k, v in recording.items()})
        for pattern in s.recording.columns:
            SubElement(record, "robomill:Column", name=pattern)
        for key, value in s.labels.items():
            if isinstance(value, bool | int | float | str):
                SubElement(master, "robomill:Label", name=key, type=type(value).__name__, value=literal(value))


def _annotation(annotations: Element, kind: str) -> Element:
    return SubElement(annotations, "ssc:Annotation", type=kind)


def _some(**attributes: str | None) -> dict[str, str]:
    return {k: v for k, v in attributes.items() if v}


def _identifier(name: str) -> str:
    """A name that every importer takes for a system: letters, digits, underscores."""
    return "".join(ch if ch.isascii() and ch.isalnum() else "_" for ch in name) or "system"
