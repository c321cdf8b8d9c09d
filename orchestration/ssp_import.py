"""SSP 1.0 packages as systems, also those that others wrote.

What is read: `SystemStructure.ssd` with FMUs as components, parameter sets (in files or inline, for a component or,
with the component's name in front, for the system), connections in either direction, the start and end of the
experiment; the step and the algorithm from our own annotation, or the step where libcosim, Ecos and OMSimulator
keep it. Connectors of the system are the outside: nothing comes from there, nothing goes there. Anything else that
would change numbers (nested systems, mappings, transformations, signal dictionaries) is refused, with its name. XML
prefixes are not looked at: some tools do not declare them.
"""

from __future__ import annotations

import math
import re
import tempfile
import xml.parsers.expat
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit
from xml.etree.ElementTree import Element, TreeBuilder

from orchestration.acceleration import Iteration
from orchestration.archive import MAX_XML, unpack
from orchestration.errors import SystemFileError, available
from orchestration.ssp_export import ANNOTATION, SSD
from orchestration.system import Component, Connection, Recording, System

DEFAULT_ALGORITHM = "jacobi"
"""Where the package does not say: what other importers do, and needs no order of components."""
MODEL = "modelDescription.xml"
_FMU = ("", "application/x-fmu-sharedlibrary")
_SET = ("", "application/x-ssp-parameter-set")


@dataclass(frozen=True)
class Package:
    """A system from a package; its files are there as long as `open_ssp` is."""

    system: System
    start: float
    """Start of the experiment [s]."""


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
            raise SystemFileError(f"{file}: no {SSD} in it, so not an SSP; it holds {available(sorted(names), 20)}")
        yield _Reader(file, folder, set(names), step).package()


class _Reader:
    """One package while it is read."""

    def __init__(self, file: Path, folder: Path, names: set[str], step: float | None) -> None:
        self.file, self.folder, self.names, self.step = file, folder, names, step
        self.components: dict[str, Component] = {}  # by name in the package
        self.kinds: dict[tuple[str, str], str] = {}
        self.parameters: dict[str, dict[str, Any]] = {}

    def fail(self, text: str) -> SystemFileError:
        return SystemFileError(f"{self.file.name}: {text if len(text) <= 1500 else text[:1500] + '...'}")

    def package(self) -> Package:
        root = self.xml(SSD, "SystemStructureDescription")
        if not root.get("version", "").startswith("1."):
            raise self.fail(f"is of SSP version {root.get('version', 'unknown')!r}; only 1.0 can be read")
        inner = _child(root, "System")
        if inner is None:
            raise self.fail(f"{SSD} holds no System")
        elements = _child(inner, "Elements")
        for element in elements if elements is not None else ():
            self.component(element)
        if not self.components:
            raise self.fail("the system has no components")
        for name, element in ((e.get("name", ""), e) for e in elements if e.tag == "Component"):  # type: ignore[union-attr]  # has components
            self.bindings(name, element)
        self.bindings("", inner)
        master = _annotation(root, ANNOTATION)
        master = _child(master, "Master") if master is not None else None
        experiment = _child(root, "DefaultExperiment")
        system = System(
            name=root.get("name") or self.file.stem,
            description=inner.get("description", ""),
            step=self.communication_step(root, inner, experiment, master),
            components=tuple(self.configured(name, c, master) for name, c in self.components.items()),
            connections=self.connections(inner, master),
            stop=self.number(experiment, "stopTime"),
            file=self.folder / SSD,
            **self.settings(master),
        )
        start = self.number(experiment, "startTime") or 0.0
        return Package(system, start)

    # Elements

    def component(self, element: Element) -> None:
        name = element.get("name", "")
        if element.tag != "Component":
            raise self.fail(
                f"{element.tag} {name!r} within the system: only a flat system of FMUs can be read; flatten it where it was made"
            )
        if not name or name in self.components:
            raise self.fail(f"component {name!r}: its name is {'empty' if not name else 'given twice'}")
        kind = element.get("type", "")
        if kind not in _FMU:
            raise self.fail(f"component {name!r} is of type {kind!r}; only FMUs ({_FMU[1]}) can be run")
        if element.get("implementation", "any") not in ("any", "CoSimulation"):
            raise self.fail(f"component {name!r} demands {element.get('implementation')}; only co-simulation can be run")
        source = self.place(element.get("source", ""), f"component {name!r}")
        safe = re.sub(r"\W", "_", name, flags=re.ASCII)
        while safe in {c.name for c in self.components.values()}:
            safe += "_"
        self.components[name] = Component(safe, source)
        for connector in element.iterfind("Connectors/Connector"):
            self.kinds[name, connector.get("name", "")] = connector.get("kind", "")

    def place(self, uri: str, what: str) -> str:
        """Name in the package that a relative URI means; refused if it is not one, or there is no such file."""
        parts = urlsplit(uri)
        path = PurePosixPath(unquote(parts.path))
        if not uri or parts.scheme or parts.netloc or parts.fragment or path.is_absolute() or ".." in path.parts:
            raise self.fail(f"{what}: source {uri!r} is not a file within the package")
        if str(path) not in self.names:
            raise self.fail(f"{what}: there is no {path} in the package; it holds {available(sorted(self.names), 20)}")
        return str(path)

    # Parameters

    def bindings(self, name: str, element: Element) -> None:
        """Parameter sets of a component, or of the system (`name` is empty): later ones win."""
        what = f"component {name!r}" if name else "the system"
        for binding in element.iterfind("ParameterBindings/ParameterBinding"):
            if binding.get("type", "") not in _SET:
                raise self.fail(f"{what}: parameters of type {binding.get('type')!r} cannot be read; only parameter sets ({_SET[1]})")
            if _child(binding, "ParameterMapping") is not None:
                raise self.fail(f"{what}: a parameter mapping (SSM) cannot be read; export without one")
            if binding.get("sourceBase", "SSD") != "SSD":
                raise self.fail(f"{what}: parameters inside an FMU (sourceBase = {binding.get('sourceBase')!r}) cannot be read")
            values = _child(binding, "ParameterValues")
            inline = _child(values, "ParameterSet") if values is not None else None
            if inline is None:
                if not binding.get("source"):
                    raise self.fail(f"{what}: a parameter binding has neither a source nor values")
                inline = self.xml(self.place(binding.get("source", ""), f"parameters of {what}"), "ParameterSet")
            for parameter in inline.iterfind("Parameters/Parameter"):
                self.parameter(name, binding.get("prefix", "") + parameter.get("name", ""), parameter)

    def parameter(self, component: str, key: str, parameter: Element) -> None:
        if not component:  # NAME.parameter; what belongs to no component is a connector of the system
            owner = max((c for c in self.components if key.startswith(f"{c}.")), key=len, default="")
            if not owner:
                return
            component, key = owner, key[len(owner) + 1 :]
        typed = next((e for e in parameter if e.tag != "Annotations"), None)
        text = None if typed is None else typed.get("value")
        if typed is None or text is None or typed.tag not in _VALUES:
            tag = "nothing" if typed is None else typed.tag
            raise self.fail(f"component {component!r}: parameter {key!r} is of type {tag}; expected a value of type {', '.join(_VALUES)}")
        try:
            value: Any = _VALUES[typed.tag](text)
        except ValueError:
            raise self.fail(f"component {component!r}: parameter {key!r} = {text!r} is not of type {typed.tag}") from None
        if typed.get("unit"):
            value = {"value": value, "unit": typed.get("unit")}
        if typed.tag == "String" and str(PurePosixPath(text)) in self.names:
            value = {"file": text}  # relative to the package, wherever it is unpacked
        self.parameters.setdefault(component, {})[key] = value

    def configured(self, name: str, c: Component, master: Element | None) -> Component:
        """The component with its values: those of inputs are start values."""
        values = self.parameters.get(name, {})
        found = self.fmu_inputs(c.source) if values else set()
        starts = {k: v for k, v in values.items() if k in found}
        rest = {k: v for k, v in values.items() if k not in starts}
        told = next((e for e in master.iterfind("Component") if e.get("name") == name), None) if master is not None else None
        known = self.read(told, {f.name: f.type for f in fields(Component) if f.name in ("isolate", "time_limit", "rate", "every")})
        return replace(c, parameters=rest, inputs=starts, **known)

    def fmu_inputs(self, source: str) -> set[str]:
        """Names of the inputs of an FMU. None if it cannot be read: opening it for the run says why."""
        try:
            with zipfile.ZipFile(self.folder / source) as archive:
                if archive.getinfo(MODEL).file_size > MAX_XML:
                    return set()
                root = self.parse(archive.read(MODEL), f"{source}/{MODEL}")
        except (SystemFileError, OSError, zipfile.BadZipFile, KeyError, NotImplementedError, RuntimeError, zlib.error, EOFError):
            return set()
        return {v.get("name", "") for v in root.iterfind("ModelVariables/*") if v.get("causality") == "input"}

    # Connections

    def connections(self, inner: Element, master: Element | None) -> tuple[Connection, ...]:
        delayed = {_ends(e) for e in master.iterfind("Delayed")} if master is not None else set()
        found = []
        for element in inner.iterfind("Connections/Connection"):
            ends = _ends(element)
            for child in element:
                if child.tag.endswith("Transformation") and not _is_identity(child):
                    raise self.fail(f"connection {_shown(ends)}: a {child.tag} cannot be carried out; do it within a component")
            (a, x), (b, y) = ends
            if not a or not b:  # to or from the outside
                continue
            for name in (a, b):
                if name not in self.components:
                    raise self.fail(f"connection {_shown(ends)}: there is no component {name!r}; available: {available(self.components)}")
            kinds = self.kinds.get((a, x), "output"), self.kinds.get((b, y), "input")
            if "arameter" in "".join(kinds):
                raise self.fail(f"connection {_shown(ends)}: parameters cannot be connected; give both their value")
            if kinds == ("input", "output"):  # start and end do not say which way
                (a, x), (b, y) = (b, y), (a, x)
            c = Connection(f"{self.components[a].name}.{x}", f"{self.components[b].name}.{y}", ends in delayed)
            found.append(c)
        return tuple(found)

    # Settings

    def communication_step(self, root: Element, inner: Element, experiment: Element | None, master: Element | None) -> float:
        if self.step is not None:
            return self.step
        places = (
            (master, "step"),
            (_annotation(experiment, "com.opensimulationplatform", "Algorithm/FixedStepAlgorithm"), "baseStepSize"),
            (_annotation(inner, "org.openmodelica", "Annotations/SimulationInformation/FixedStepMaster"), "stepSize"),
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
        iteration = _child(master, "Iteration")
        if iteration is not None:
            found["iteration"] = Iteration(**self.read(iteration, {f.name: f.type for f in fields(Iteration)}))
        record = _child(master, "Recording")
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
            raise self.fail(f"{element.tag}: {attribute} = {text!r} is not a value of type {kind}") from None

    def number(self, element: Element | None, attribute: str) -> float | None:
        return None if element is None else self.value(element, attribute, "float")

    # XML

    def xml(self, name: str, root: str) -> Element:
        """The root of an XML file of the package; refused if it is another than `root`."""
        found = self.parse((self.folder / name).read_bytes(), name)
        if found.tag != root:
            raise self.fail(f"{name} is a {found.tag}; expected a {root}")
        return found

    def parse(self, data: bytes, name: str) -> Element:
        """The root of XML, tags without their prefixes; refused: a document type, entities."""
        if len(data) > MAX_XML:
            raise self.fail(f"refused: {name} has {len(data)} bytes, at most {MAX_XML} are allowed")

        def refuse(*_: object) -> None:
            raise self.fail(f"refused: {name} has a document type declaration or entities (line {parser.CurrentLineNumber})")

        builder = TreeBuilder()
        depth = 0

        def start(tag: str, attributes: dict[str, str]) -> None:
            nonlocal depth
            depth += 1
            if depth > 100:
                raise self.fail(f"refused: {name} is nested more than 100 deep (line {parser.CurrentLineNumber})")
            builder.start(tag.rpartition(":")[2], attributes)

        def end(tag: str) -> None:
            nonlocal depth
            depth -= 1
            builder.end(tag.rpartition(":")[2])

        parser = xml.parsers.expat.ParserCreate()
        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
        try:
            parser.Parse(data, True)
        except (xml.parsers.expat.ExpatError, ValueError, LookupError) as error:  # the last two: its encoding
            raise self.fail(f"{name} is not valid XML: {error}") from None
        found: Element = builder.close()
        return found


def _truth(text: str) -> bool:
    if text.strip() not in ("true", "false", "1", "0"):
        raise ValueError(text)
    return text.strip() in ("true", "1")


def _finite(text: str) -> float:
    if not math.isfinite(float(text)):
        raise ValueError(text)
    return float(text)


_VALUES: dict[str, Any] = {"Real": float, "Integer": int, "Boolean": _truth, "String": str, "Enumeration": int}
_KINDS: dict[str, Any] = {"float": _finite, "int": int, "bool": _truth, "str": str}


def _child(element: Element, tag: str) -> Element | None:
    return next((e for e in element if e.tag == tag), None)


def _annotation(element: Element | None, kind: str, path: str = "") -> Element | None:
    """Our part of an annotation, or what stands at `path` in it."""
    if element is None:
        return None
    for annotation in element.iterfind("Annotations/Annotation"):
        if annotation.get("type") == kind:
            return annotation.find(path) if path else annotation
    return None


def _ends(e: Element) -> tuple[tuple[str, str], tuple[str, str]]:
    return (e.get("startElement", ""), e.get("startConnector", "")), (e.get("endElement", ""), e.get("endConnector", ""))


def _shown(ends: tuple[tuple[str, str], tuple[str, str]]) -> str:
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
