"""Builds the native FMU of a model, FMI 2.0 or 3.0: lower, generate data, link per platform, describe, pack.

The archive holds modelDescription.xml, binaries/, documentation/, terminalsAndIcons/, extra/ (what the reference
results are, provenance, bill of materials), resources/tables/ (the built-in rows of the tables, to look at and to start from).
The library speaks both versions and needs the C library only.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from uuid import UUID

from robomill.fmus import archive
from robomill.fmus.documentation import index_html, licences
from robomill.fmus.fmi2 import model_description_2
from robomill.fmus.interface import Interface
from robomill.fmus.model_description import Options
from robomill.fmus.native.data import data_c
from robomill.fmus.native.fmi3 import model_description_3
from robomill.fmus.native.lower import Lowered, Lowering, NativeBuildError
from robomill.fmus.native.sources import FILES as COMPILED
from robomill.fmus.native.sources import build_description, source_files
from robomill.fmus.native.targets import PLATFORMS, compiler, fat, libraries, uses_zig
from robomill.fmus.provenance import Material, Origin, material, provenance_files, release
from robomill.fmus.python.builder import _npy
from robomill.fmus.reference import experiment_files, manifest_files
from robomill.fmus.terminals import terminal_files
from robomill.models.model.declaration import Model

SHIM = Path(__file__).parent / "shim"
FMI_3 = 3
NOTES = (
    "Needs nothing but the C library of the system: no Python, no Numba.",
    "After an error (fmi2Error, fmi3Error; the text goes to the log) the instance can be reset, restored to an earlier state or freed.",
    "Names of table files are absolute or relative to the working directory; they hold float64 numbers in C order (numpy.save).",
    "The numbers are those of the Python model, bit for bit, on every platform.",
)


def build(
    model: Model,
    destination: str | Path,
    *,
    fmi: Literal[2, 3] = 2,
    platforms: Sequence[str] = ("linux64",),
    arrays: bool = True,
    sources: bool = False,
    page: str | None = None,
    reference: Mapping[str, bytes] | None = None,
) -> Path:
    """Write the native FMU of `model` and return its path.

    `destination` is a file (`.fmu`) or a folder, where it is named after the model. `platforms` are
    of linux64, win64, darwin64. `page` is the Markdown for its documentation (docs/components/<name>.md
    if not given), `reference` a reference experiment
    (in.csv, out.csv and what belongs to them, as `fmus.reference.reference_files` gives them). Equal sources and
    tools give equal bytes. NativeBuildError names a platform that there is not, a missing tool, or what of the
    model cannot be lowered.
    """
    with Lowering() as lowering:
        form = _Form(fmi, tuple(platforms), arrays, sources)
        return _build(model, Path(destination), form, page, reference or {}, lowering)


@dataclass(frozen=True)
class _Form:
    """What the FMUs of a build have in common."""

    fmi: Literal[2, 3]
    """Version of FMI."""
    platforms: tuple[str, ...]
    arrays: bool
    sources: bool


def _build(
    model: Model,
    target: Path,
    form: _Form,
    page: str | None,
    reference: Mapping[str, bytes],
    lowering: Lowering,
) -> Path:
    fmi, arrays = form.fmi, form.arrays and form.fmi == FMI_3
    if fmi not in (2, 3):
        raise NativeBuildError(f"FMI version {fmi!r}: expected 2 or 3")
    unknown = sorted(set(form.platforms) - set(PLATFORMS))
    if unknown or not form.platforms:
        raise NativeBuildError(f"unknown platform {', '.join(unknown) or '(none)'}; available: {', '.join(PLATFORMS)}")
    platforms = tuple(p for p in PLATFORMS if p in form.platforms)
    linker = compiler(uses_zig(platforms))
    if target.suffix != ".fmu":
        target /= f"{model.name}.fmu"
    interface = Interface(model)
    lowered = lowering.lower(model)
    token, sources = c_sources(interface, lowered)
    with tempfile.TemporaryDirectory(prefix="robomill_native_") as folder:
        linked = libraries(lowered.code, sources, model.name, platforms, Path(folder))

    options = _options(model, lowered, token, f"robomill {release()} (native, {linker})")
    content: dict[str, bytes] = {**licences()}
    content["documentation/index.html"] = index_html(interface, "native backend", NOTES, page, f"{fmi}.0").encode()
    content |= terminal_files(interface, arrays)
    content |= {f"resources/tables/{name}.npy": _npy(rows) for name, rows in model.default_tables.items()}
    match fmi:
        case 2:
            content["model.png"] = content["terminalsAndIcons/icon.png"]  # where FMI 2.0 has its icon
            content["modelDescription.xml"] = model_description_2(interface, options, COMPILED if form.sources else ())
            for platform, slices in linked.items():
                library = fat(slices) if len(slices) > 1 else next(iter(slices.values()))
                content[f"binaries/{platform}/{model.name}{PLATFORMS[platform].suffix}"] = library
        case 3:
            content["modelDescription.xml"] = model_description_3(interface, options, arrays)
            for platform, slices in linked.items():
                for tuple_, library in slices.items():
                    content[f"binaries/{tuple_}/{model.name}{PLATFORMS[platform].suffix}"] = library
    if form.sources:
        content |= source_files(model.name, lowered.code, sources)
        if fmi == FMI_3:
            content["sources/buildDescription.xml"] = build_description(model.name)
    made_of = {"model.ll": lowered.code.encode(), **sources}
    origin = Origin(model.name, "native", f"{fmi}.0", platforms, _materials(linker), made_of)
    experiment, described = experiment_files(interface, arrays, reference)
    provenance, stated = provenance_files(origin, content)
    archive.write(target, {**content, **experiment, **provenance, **manifest_files([*described, *stated])})
    return target


def _materials(linker: str) -> tuple[Material, ...]:
    """What the libraries were made with, and what they need; `linker` is name and version."""
    name, _, its_version = linker.partition(" ")
    made = [material("numba", "BSD-2-Clause", "excluded"), material("llvmlite", "BSD-2-Clause", "excluded")]
    if name == "zig":
        made.append(Material("ziglang", its_version, "MIT", "excluded", "application"))
        made.append(Material("zig compiler runtime", its_version, "MIT", "required", from_pypi=False))
    else:
        made.append(Material(name, its_version, "", "excluded", "application", from_pypi=False))
    return (*made, Material("C library of the system", "", "", "required", from_pypi=False))


def build_all(
    models: Iterable[Model],
    destination: str | Path,
    *,
    fmi: Literal[2, 3] = 2,
    platforms: Sequence[str] = ("linux64",),
    arrays: bool = True,
    sources: bool = False,
    reference: Callable[[Model], Mapping[str, bytes]] = lambda _: {},
    done: Callable[[Path], object] = lambda _: None,
) -> list[Path]:
    """`build` of several models into a folder, as many at a time as there are processors; their paths in the given order.

    `reference` gives the reference experiment of a model; `done` is called with each path. The first
    NativeBuildError is raised after those that were under way are finished.
    """
    form = _Form(fmi, tuple(platforms), arrays, sources)

    def one(model: Model) -> Path:
        path = _build(model, Path(destination) / f"{model.name}.fmu", form, None, reference(model), lowering)
        done(path)
        return path

    with Lowering() as lowering, ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        running = [pool.submit(one, model) for model in models]
        try:
            return [future.result() for future in running]
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _options(model: Model, lowered: Lowered, token: str, tool: str) -> Options:
    return Options(
        identifier=model.name,
        guid=token,
        tool=tool,
        version=release(),
        variable_step=lowered.variable_step,
        initial_dependencies=lowered.initial_dependencies,
    )


def c_sources(interface: Interface, lowered: Lowered) -> tuple[str, dict[str, bytes]]:
    """Token (the GUID, too) and C files of the library, name -> content.

    The token is a hash of all that decides what the library does; it is the same for every platform and FMI version.
    """
    sources = {f.name: f.read_bytes().replace(b"\r\n", b"\n") for f in sorted(SHIM.iterdir()) if f.suffix in (".c", ".h")}
    digest = hashlib.sha256(lowered.code.encode())
    digest.update(model_description_2(interface, _options(interface.model, lowered, "", "")))
    digest.update(data_c(interface, "").encode())
    for content in sources.values():
        digest.update(content)
    token = f"{{{UUID(digest.hexdigest()[:32])}}}"
    return token, {**sources, "data.c": data_c(interface, token).encode()}
