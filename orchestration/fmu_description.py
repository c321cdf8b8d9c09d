"""What an FMU says about itself: opened safely, checked, turned into ports. FMPy is used here and in `fmu` only."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import fmpy
from fmpy.model_description import ValidationError, read_model_description

from orchestration.archive import check_xml, unpack
from orchestration.errors import SlaveError
from orchestration.library import problem
from orchestration.slave import Port, PortData

_TYPES = {"Real": "real", "Integer": "integer", "Enumeration": "integer", "Boolean": "boolean", "String": "string"}
_SUFFIX = {"linux": ".so", "darwin": ".dylib", "win32": ".dll"}


@dataclass(frozen=True)
class FmuDescription:
    """An unpacked FMI 2.0 co-simulation FMU."""

    file: Path
    folder: Path
    library: Path
    identifier: str
    guid: str
    ports: tuple[Port, ...]
    references: dict[str, int] = field(repr=False)
    """Value reference by port name."""
    can_save_state: bool
    can_serialise_state: bool
    made_by_pythonfmu: bool
    """Its log messages are finished texts, not printf formats."""
    log_categories: tuple[str, ...]
    units: dict[str, Any] = field(repr=False)
    """FMPy's unit definitions by name."""


def open_fmu(file: Path, folder: Path) -> FmuDescription:
    """Unpack `file` into `folder` and check that it can run here.

    SlaveError, one clear sentence each: not there, not a zip, unsafe archive, no or invalid
    modelDescription.xml, FMI version other than 2.0, not co-simulation, no binary for this platform.
    """
    names = unpack(file, folder)
    xml = folder / "modelDescription.xml"
    if not xml.is_file():
        top = sorted({n.split("/")[0] for n in names})
        raise SlaveError(f"{file}: no modelDescription.xml in it, so not an FMU; it holds {', '.join(top[:20]) or 'nothing'}")
    version = check_xml(xml, file).get("fmiVersion", "unknown")
    if version != "2.0":
        raise SlaveError(f"{file}: has FMI version {version}; only FMI 2.0 can be run: export it as FMI 2.0 co-simulation")
    md = _read(file, folder)
    if md.coSimulation is None:
        raise SlaveError(f"{file}: is an FMU for model exchange only; a co-simulation FMU is needed: export it with a solver")
    ports, references = _ports(file, md)
    return FmuDescription(
        file=file,
        folder=folder,
        library=_library(file, folder, md.coSimulation.modelIdentifier, names),
        identifier=md.coSimulation.modelIdentifier,
        guid=md.guid,
        ports=ports,
        references=references,
        can_save_state=bool(md.coSimulation.canGetAndSetFMUstate),
        can_serialise_state=bool(md.coSimulation.canSerializeFMUstate),
        made_by_pythonfmu=(folder / "resources" / "slavemodule.txt").is_file(),
        log_categories=tuple(c.name for c in md.logCategories),
        units={u.name: u for u in md.unitDefinitions},
    )


_SCHEMA = re.compile(r"\w+ \(line \d+, column \d+\)")  # how FMPy words what the XML schema refuses


def _read(file: Path, folder: Path) -> Any:
    """The model description if it has the structure that the standard's schema demands.

    Other violations (a discrete output declared continuous) do not matter for running: `robomill check` tells them.
    """
    try:
        return read_model_description(str(folder))
    except ValidationError as found:
        structural = [p for p in found.problems if _SCHEMA.match(p)]
        if structural:
            raise SlaveError(f"{file}: modelDescription.xml is not valid:\n  " + "\n  ".join(p[:300] for p in structural[:5])) from None
        return read_model_description(str(folder), validate=False)
    except Exception as error:  # FMPy raises bare Exception and whatever its parsing meets
        raise SlaveError(f"{file}: modelDescription.xml cannot be read: {error}") from None


def _library(file: Path, folder: Path, identifier: str, names: Sequence[str]) -> Path:
    if not re.fullmatch(r"[\w.-]+", identifier):
        raise SlaveError(f"{file}: its modelIdentifier {identifier!r} is not the name of a library")
    library = folder / "binaries" / str(fmpy.platform) / (identifier + _SUFFIX.get(sys.platform, ".so"))
    if not library.is_file():
        place = library.relative_to(folder)
        there = sorted({n.split("/")[1] for n in names if n.startswith("binaries/") and n.count("/") > 1})
        sources = "; it has C sources, which can be compiled" if any(n.startswith("sources/") for n in names) else ""
        raise SlaveError(f"{file}: no binary for this platform ({place}); it has binaries for {', '.join(there) or 'no platform'}{sources}")
    wrong = problem(library)
    if wrong:
        raise SlaveError(f"{file}: its binary {library.relative_to(folder)} {wrong}")
    return library


def _ports(file: Path, md: Any) -> tuple[tuple[Port, ...], dict[str, int]]:
    """Inputs, outputs and parameters of a model description. Inputs and outputs that are texts are left out: no bus carries them."""
    dependencies = {u.variable.name: _names(u.dependencies) for u in md.outputs}
    ports: list[Port] = []
    references: dict[str, int] = {}
    for v in md.modelVariables:
        kind = _TYPES[v.type]
        if v.causality not in ("input", "output", "parameter") or (kind == "string" and v.causality != "parameter"):
            continue
        if v.name in references:
            raise SlaveError(f"{file}: variable {v.name[:200]!r} is there twice")
        declared = v.declaredType
        ports.append(
            PortData(
                name=v.name,
                causality=v.causality,
                type=kind,
                unit=v.unit or (declared.unit if declared else None),
                start=_start(kind, v.start),
                minimum=_bound(v.min if v.min is not None else (declared.min if declared else None)),
                maximum=_bound(v.max if v.max is not None else (declared.max if declared else None)),
                description=v.description or "",
                dependencies=dependencies.get(v.name) if v.causality == "output" else None,
            )
        )
        references[v.name] = int(v.valueReference)
    return tuple(ports), references


def _names(dependencies: Sequence[Any] | None) -> tuple[str, ...] | None:
    return None if dependencies is None else tuple(v.name for v in dependencies if v.causality == "input")


def _bound(text: str | None) -> float | None:
    value = None if text is None else float(text)
    return None if value is None or not math.isfinite(value) else value


def _start(kind: str, text: str | None) -> float | int | bool | str | None:
    if text is None or kind == "string":
        return text
    if kind == "boolean":
        return text.strip() in ("true", "1")
    return int(text) if kind == "integer" else float(text)
