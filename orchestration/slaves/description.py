"""What an FMU says about itself: opened safely, checked, turned into ports. FMPy is used here and in `fmu` only."""

from __future__ import annotations

import hashlib
import math
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.model_description import ValidationError, read_model_description

from robomill.orchestration.errors import SlaveError
from robomill.orchestration.slaves.archive import check_xml, unpack
from robomill.orchestration.slaves.library import problem
from robomill.orchestration.slaves.protocol import Port, PortData, Scalar, base_name, inputs, outputs

FMI_2, FMI_3 = 2, 3
"""Versions of FMI: the number before the point."""
_INTEGERS = tuple(f"{sign}Int{bits}" for bits in (8, 16, 32, 64) for sign in ("", "U"))
# Type of a variable -> type of its port, and the name of the type in the functions that get and set it
_TYPES = {
    FMI_2: {
        "Real": ("real", "Real"),
        "Integer": ("integer", "Integer"),
        "Enumeration": ("integer", "Integer"),
        "Boolean": ("boolean", "Boolean"),
        "String": ("string", "String"),
    },
    FMI_3: {
        "Binary": ("binary", "Binary"),
        "Clock": ("clock", "Clock"),
        "Float64": ("real", "Float64"),
        "Float32": ("real", "Float32"),
        **{name: ("integer", name) for name in _INTEGERS},
        "Enumeration": ("integer", "Int64"),
        "Boolean": ("boolean", "Boolean"),
        "String": ("string", "String"),
    },
}
_WHOLE = {
    **{f"Int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    "Float32": (-(2**24), 2**24),
    "Integer": (-(2**31), 2**31 - 1),
}
"""Least and largest whole number that a type holds, and all between, by its name in the functions that get and set it."""
MAX_ELEMENTS = 1_000_000
"""Elements of all variables of an FMU, at most: a size of an array that was mistyped must not fill the memory."""
_CAUSALITIES = {**{c: c for c in ("input", "output", "parameter")}, "structuralParameter": "structural parameter"}
_SUFFIX = {"linux": ".so", "darwin": ".dylib", "win32": ".dll"}


@dataclass(frozen=True)
class Variable:
    """An input, output or parameter as the FMU knows it: in FMI 3.0 maybe an array, with its elements as ports."""

    kind: str
    """Name of its type in the functions that get and set it: Real, Float64, ..."""
    reference: int
    ports: tuple[Port, ...]


@dataclass(frozen=True)
class FmuDescription:
    """An unpacked co-simulation FMU, FMI 2.0 or 3.0."""

    fmi: int
    """2 or 3."""

    file: Path
    folder: Path
    library: Path
    identifier: str
    guid: str
    """In FMI 3.0 the instantiation token."""
    variables: tuple[Variable, ...] = field(repr=False)
    only_once: bool
    """A process can have one instance of it."""
    can_save_state: bool
    can_serialise_state: bool
    made_by_pythonfmu: bool
    """Its log messages are finished texts, not printf formats."""
    tolerance: float | None
    """Relative tolerance of its solver, where its default experiment names one; what others run it with."""
    carries_tables: bool
    """It is one of this project: built-in rows of its tables stand in its resources (`ssp_tables`)."""
    log_categories: tuple[str, ...]
    warnings: tuple[str, ...]
    """What one should know before it runs."""
    units: dict[str, Any] = field(repr=False)
    """FMPy's unit definitions by name."""

    @cached_property
    def ports(self) -> tuple[Port, ...]:
        """Elements of all variables, in their order."""
        return tuple(p for v in self.variables for p in v.ports)

    @cached_property
    def references(self) -> dict[str, int]:
        """Value reference by port name; the elements of an array share that of the array."""
        return {p.name: v.reference for v in self.variables for p in v.ports}

    @cached_property
    def by_kind(self) -> dict[str, list[tuple[str, list[int], list[Variable]]]]:
        """Each type among inputs ("input") and outputs: its name, the places of its elements in the flat image, its variables."""
        found: dict[str, list[tuple[str, list[int], list[Variable]]]] = {}
        for causality, ports in (("input", inputs(self.ports)), ("output", outputs(self.ports))):
            place = {p.name: i for i, p in enumerate(ports)}
            kinds: dict[str, list[Variable]] = {}
            for v in self.variables:
                if v.ports[0].name in place:
                    kinds.setdefault(v.kind, []).append(v)
            found[causality] = [(kind, [place[p.name] for v in chosen for p in v.ports], chosen) for kind, chosen in kinds.items()]
        return found


def open_fmu(file: Path, folder: Path) -> FmuDescription:
    """Unpack `file` into `folder` and check that it can run here.

    SlaveError, one clear sentence each: not there, not a zip, unsafe archive, and what `describe` refuses.
    """
    return describe(file, folder, unpack(file, folder))


def describe(file: Path, folder: Path, names: Sequence[str]) -> FmuDescription:
    """What the FMU `file`, unpacked into `folder`, says about itself; `names` are those of its files.

    SlaveError, one clear sentence each: no or invalid modelDescription.xml, FMI version other than 2.0 and 3.0 with its
    patches, not co-simulation, no binary for this platform, clocks.
    """
    xml = folder / "modelDescription.xml"
    if not xml.is_file():
        top = sorted({n.split("/")[0] for n in names})
        raise SlaveError(
            f"{file}: no modelDescription.xml in it, so not an FMU; it holds {', '.join(top[:20]) or 'nothing'}; "
            "pack the folder that holds modelDescription.xml, not the folder around it"
        )
    known = _content(file, xml)
    made = replace(
        known,
        folder=folder,
        library=_library(file, folder, known.identifier, names, str(fmpy.platform if known.fmi == FMI_2 else fmpy.platform_tuple)),
        made_by_pythonfmu=(folder / "resources" / "slavemodule.txt").is_file(),
    )
    vars(made).update(ports=known.ports, references=known.references, by_kind=known.by_kind)  # one for all components that are this FMU
    return made


_KNOWN: dict[tuple[Path, bytes], FmuDescription] = {}
_KEPT = 64
"""Model descriptions that are kept, by file and content: to read one takes up to 70 ms per 1000 variables, and runs open the same again."""


def _content(file: Path, xml: Path) -> FmuDescription:
    """What modelDescription.xml says; folder, library and what made it are not known yet. Read once per process and content."""
    key = file, hashlib.sha256(xml.read_bytes()).digest()
    known = _KNOWN.get(key)
    if known is not None:
        return known
    fmi = _version(file, check_xml(xml, file).get("fmiVersion", "unknown"))
    md = _read(file, xml.parent)
    if md.coSimulation is None:
        only = "scheduled execution" if getattr(md, "scheduledExecution", None) is not None else "model exchange"
        raise SlaveError(f"{file}: is an FMU for {only} only; a co-simulation FMU is needed: export it with a solver")
    found = FmuDescription(
        fmi=fmi,
        file=file,
        folder=xml.parent,
        library=xml,
        identifier=md.coSimulation.modelIdentifier,
        guid=md.guid,
        variables=_variables(file, md, fmi),
        only_once=bool(md.coSimulation.canBeInstantiatedOnlyOncePerProcess),
        can_save_state=bool(md.coSimulation.canGetAndSetFMUstate),
        can_serialise_state=bool(md.coSimulation.canSerializeFMUstate),
        made_by_pythonfmu=False,
        tolerance=_bound(md.defaultExperiment.tolerance) if md.defaultExperiment is not None else None,
        carries_tables=(md.generationTool or "").startswith("robomill "),
        log_categories=tuple(c.name for c in md.logCategories),
        warnings=tuple(_warnings(md)),
        units={u.name: u for u in md.unitDefinitions},
    )
    _KNOWN[key] = found
    for oldest in list(_KNOWN)[:-_KEPT]:
        _KNOWN.pop(oldest, None)
    return found


def _warnings(md: Any) -> Iterator[str]:
    """What an FMU may have, and a run with it goes on without."""
    if md.coSimulation.needsExecutionTool:
        tool = md.generationTool or "the tool that it was made with, which it does not name"
        yield f"the FMU does not run by itself (needsExecutionTool): it needs {tool} on this machine"
    for v in md.modelVariables:
        if v.type == "Clock" and v.causality == "input":
            yield f"input clock {v.name[:200]!r} never ticks, as event mode is not supported: what it would start stays as it is"
        elif v.type == "Clock" and v.causality == "output":
            yield f"output clock {v.name[:200]!r} is not listened to, as event mode is not supported"
        low, high = _bounds(v)
        if low is not None and high is not None and low > high:
            yield f"minimum {low:.9g} of variable {v.name[:200]!r} is above its maximum {high:.9g}: neither is checked"


def _bounds(v: Any) -> tuple[float | None, float | None]:
    """Minimum and maximum of a variable, its own or those of its declared type."""
    declared = v.declaredType
    low, high = (
        own if own is not None else other for own, other in ((v.min, declared and declared.min), (v.max, declared and declared.max))
    )
    return _bound(low), _bound(high)


_FMI3 = re.compile(r"3\.0(\.0|\.[1-9]\d*(-.+)?)?")
"""FMI 3.0 and its patch releases, which change nothing but the wording of the standard; a pre-release of a patch is one, too."""


def _version(file: Path, text: str) -> int:
    """2 or 3. SlaveError for every other version; a pre-release of 3.0 itself ("3.0-beta.2") has other functions than 3.0."""
    if text == "2.0":
        return FMI_2
    if _FMI3.fullmatch(text):
        return FMI_3
    raise SlaveError(f"{file}: has FMI version {text[:50]}; only FMI 2.0 and 3.0 can be run: export it as co-simulation of one of these")


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
        raise SlaveError(f"{file}: modelDescription.xml cannot be read: {error}; export the FMU anew") from None


def _library(file: Path, folder: Path, identifier: str, names: Sequence[str], platform: str) -> Path:
    if not re.fullmatch(r"[\w.-]+", identifier):
        raise SlaveError(f"{file}: its modelIdentifier {identifier!r} is not the name of a library; use letters, digits and underscores")
    library = folder / "binaries" / platform / (identifier + _SUFFIX.get(sys.platform, ".so"))
    if not library.is_file():
        place = library.relative_to(folder)
        there = sorted({n.split("/")[1] for n in names if n.startswith("binaries/") and n.count("/") > 1})
        sources = " and C sources, which can be compiled" if any(n.startswith("sources/") for n in names) else ""
        raise SlaveError(
            f"{file}: no binary for this platform ({place}); it has binaries for {', '.join(there) or 'no platform'}{sources}; "
            "export it for this platform"
        )
    wrong = problem(library)
    if wrong:
        raise SlaveError(f"{file}: its binary {library.relative_to(folder)} {wrong}")
    return library


def _variables(file: Path, md: Any, fmi: int) -> tuple[Variable, ...]:
    """Inputs, outputs, parameters and structural parameters of a model description."""
    dependencies = {u.variable.name: _names(u.dependencies) for u in md.outputs}
    found: list[Variable] = []
    taken: set[str] = set()
    for v in md.modelVariables:
        kind, access = _TYPES[fmi].get(v.type, ("", ""))
        if v.causality not in _CAUSALITIES or not kind:
            continue
        if getattr(v, "clocks", None):
            raise SlaveError(
                f"{file}: variable {v.name[:200]!r} belongs to a clock, which only event mode can tick; "
                "event mode is not supported: export the FMU without clocks"
            )
        names = _elements(file, v, MAX_ELEMENTS - len(taken))
        if taken & {v.name, *names}:
            raise SlaveError(f"{file}: variable {v.name[:200]!r} is there twice; export the FMU anew with one variable of that name")
        taken |= {v.name, *names}
        if names:
            starts = _starts(file, v, kind, len(names))
            depends = dependencies.get(v.name) if v.causality == "output" else None
            found.append(Variable(access, int(v.valueReference), tuple(_ports(v, kind, names, starts, depends, _WHOLE.get(access)))))
    return _together(found)


def _together(variables: Sequence[Variable]) -> tuple[Variable, ...]:
    """The elements of an array, variables of their own in FMI 2.0, next to each other in C order: tools list them in any order."""
    first: dict[str, int] = {}

    def place(v: Variable) -> tuple[int, tuple[int, ...]]:
        name = v.ports[0].name
        base = base_name(name)
        indices = name[len(base) + 1 : -1].split(",")
        return first.setdefault(base, len(first)), tuple(int(i) for i in indices) if all(i.isdecimal() for i in indices) else ()

    return tuple(sorted(variables, key=place))


def _elements(file: Path, v: Any, room: int) -> list[str]:
    """Names of the elements of a variable, counted from one, in C order; its own name if it is no array."""
    if math.prod(v.shape or ()) > room:
        raise SlaveError(f"{file}: array {v.name[:200]!r} of size {list(v.shape)}: at most {MAX_ELEMENTS} elements in an FMU are allowed")
    return _element_names(v)


def _element_names(v: Any) -> list[str]:
    return [f"{v.name}[{','.join(str(i + 1) for i in index)}]" for index in np.ndindex(*v.shape)] if v.dimensions else [v.name]


def _starts(file: Path, v: Any, kind: str, count: int) -> list[Scalar | None]:
    """One start value per element: an array may have one for all. FMPy reads none of arrays of texts and of binaries."""
    if kind == "binary" or (kind == "string" and v.dimensions):
        return [None] * count
    texts = [v.start] if v.start is None or not v.dimensions else v.start.split()
    if len(texts) not in (1, count):
        raise SlaveError(f"{file}: array {v.name[:200]!r} has {count} elements and {len(texts)} start values; expected 1 or {count}")
    try:
        starts = [_start(kind, text) for text in texts]
    except ValueError:
        raise SlaveError(f"{file}: variable {v.name[:200]!r}: start value {v.start[:200]!r} is not of type {v.type}") from None
    return starts * count if len(starts) == 1 else starts


def _ports(
    v: Any,
    kind: str,
    names: Sequence[str],
    starts: Sequence[Scalar | None],
    dependencies: tuple[str, ...] | None,
    limits: tuple[int, int] | None,
) -> Iterator[Port]:
    declared = v.declaredType
    unit = v.unit or (declared.unit if declared else None)
    low, high = _bounds(v)
    if low is not None and high is not None and low > high:  # see `_warnings`
        low = high = None
    items = tuple((item.name, int(item.value)) for item in declared.items or ()) if v.type == "Enumeration" and declared else ()
    for name, start in zip(names, starts, strict=True):
        yield PortData(name, _CAUSALITIES[v.causality], kind, unit, start, low, high, v.description or "", dependencies, limits, items)


def _names(dependencies: Sequence[Any] | None) -> tuple[str, ...] | None:
    """The elements of the inputs among these."""
    if dependencies is None:
        return None
    return tuple(name for v in dependencies if v.causality == "input" for name in _element_names(v))


def _bound(text: str | None) -> float | None:
    value = None if text is None else float(text)
    return None if value is None or not math.isfinite(value) else value


def _start(kind: str, text: str | None) -> Scalar | None:
    if text is None or kind == "string":
        return text
    if kind == "boolean":
        return text.strip() in ("true", "1")
    return int(text) if kind == "integer" else float(text)
