"""The files of an unpacked SSP package: found safely, parsed safely, and the models in its FMUs as far as a package needs them.

XML prefixes are not looked at: some tools do not declare them.
"""

from __future__ import annotations

import xml.parsers.expat
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit
from xml.etree.ElementTree import Element, TreeBuilder, indent, tostring

from robomill.orchestration.errors import SystemFileError, available, shortened
from robomill.orchestration.slaves.archive import MAX_XML, MAX_XML_DEPTH

MODEL = "modelDescription.xml"
MAX_MESSAGE = 1500
"""Characters of a message about a package, which may quote names and values of any length from it."""


@dataclass(frozen=True)
class FmuVariable:
    """What an FMU says about one of its variables."""

    causality: str
    unit: str | None = None
    items: Mapping[str, int] = field(default_factory=dict)
    """Values of an enumeration by name."""


class Files:
    """The files of one package."""

    def __init__(self, file: Path, folder: Path, names: set[str]) -> None:
        self.file, self.folder, self.names = file, folder, names
        self._models: dict[str, dict[str, FmuVariable] | None] = {}

    def fail(self, text: str) -> SystemFileError:
        """The error that says so of this package."""
        return SystemFileError(f"{self.file.name}: {shortened(text, MAX_MESSAGE)}")

    def place(self, uri: str, what: str) -> str:
        """Name in the package that a relative URI means; refused if it is not one, or there is no such file."""
        try:
            parts = urlsplit(uri)
        except ValueError as error:
            raise self.fail(f"{what}: source {uri!r} is not a URI: {error}; correct the source") from None
        path = PurePosixPath(unquote(parts.path))
        if not uri or parts.scheme or parts.netloc or parts.fragment or path.is_absolute() or ".." in path.parts:
            raise self.fail(f"{what}: source {uri!r} is not a file within the package; pack the file into it, or correct the source")
        if str(path) not in self.names:
            raise self.fail(f"{what}: there is no {path} in the package; available: {available(sorted(self.names), 20)}")
        return str(path)

    def xml(self, name: str, root: str) -> Element:
        """The root of an XML file of the package; refused if it is another than `root`."""
        found = self.parse((self.folder / name).read_bytes(), name)
        if found.tag != root:
            raise self.fail(f"{name} is a {found.tag}; expected a {root}")
        return found

    def variables(self, source: str) -> dict[str, FmuVariable] | None:
        """Variables of an FMU by name. None if it cannot be read: opening it for the run says why."""
        if source not in self._models:
            try:
                with zipfile.ZipFile(self.folder / source) as archive:
                    large = archive.getinfo(MODEL).file_size > MAX_XML
                    root = None if large else self.parse(archive.read(MODEL), f"{source}/{MODEL}")
                self._models[source] = None if root is None else _variables(root)
            except (
                *(
                    SystemFileError,
                    OSError,
                    zipfile.BadZipFile,
                    KeyError,
                    NotImplementedError,
                    RuntimeError,
                    zlib.error,
                    EOFError,
                    ValueError,
                ),
            ):
                self._models[source] = None
        return self._models[source]

    def parse(self, data: bytes, name: str) -> Element:
        """The root of XML, tags without their prefixes; refused: a document type, entities."""
        if len(data) > MAX_XML:
            raise self.fail(f"refused: {name} has {len(data)} bytes, at most {MAX_XML} are allowed")

        def refuse(*_: object) -> None:
            raise self.fail(f"refused: {name} has a document type declaration or entities (line {parser.CurrentLineNumber}); remove it")

        builder = TreeBuilder()
        depth = 0

        def start(tag: str, attributes: dict[str, str]) -> None:
            nonlocal depth
            depth += 1
            if depth > MAX_XML_DEPTH:
                raise self.fail(
                    f"refused: {name} is nested more than {MAX_XML_DEPTH} deep (line {parser.CurrentLineNumber})"
                    "; get the file anew from whoever made it"
                )
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
            raise self.fail(f"{name} is not valid XML: {error}; correct it, or get the file anew") from None
        found: Element = builder.close()
        return found


def _variables(root: Element) -> dict[str, FmuVariable]:
    """FMI 2.0: ScalarVariable with its type within; FMI 3.0: the type itself."""
    items = {
        t.get("name", ""): {i.get("name", ""): int(i.get("value", "")) for i in t.iter("Item")} for t in root.iterfind("TypeDefinitions/*")
    }
    found = {}
    for v in root.iterfind("ModelVariables/*"):
        typed = next((e for e in v if e.tag != "Annotations"), v) if v.tag == "ScalarVariable" else v
        kind = items.get(typed.get("declaredType", ""), {})
        found[v.get("name", "")] = FmuVariable(v.get("causality", "local"), typed.get("unit"), kind)
    return found


def child(element: Element, tag: str) -> Element | None:
    """The first child of that name."""
    return next((e for e in element if e.tag == tag), None)


def literal(value: Any) -> str:
    """As XML Schema writes it: doubles with all digits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def xml_text(root: Element) -> bytes:
    """An XML file, indented."""
    indent(root, "  ")
    text: str = tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()
