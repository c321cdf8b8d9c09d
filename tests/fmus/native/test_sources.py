"""Source-code FMUs: compiled by others they give the bits of the libraries that are built here."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Literal

import fmpy
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from robomill.conformance import check_fmu
from robomill.fmus.components import COMPONENTS, NAMES
from robomill.fmus.native.builder import build
from robomill.fmus.native.c_code import model_c
from robomill.fmus.native.lower import NativeBuildError
from robomill.fmus.reference import reference_files

pytestmark = pytest.mark.skipif(sys.platform != "linux" or not shutil.which("gcc"), reason="needs Linux with gcc")
OVERRIDE = "-DFMI3_OVERRIDE_FUNCTION_PREFIX"
ALL = [pytest.param(name, marks=() if name in ("spindle_current", "surface_contact") else pytest.mark.slow) for name in NAMES]


def unpacked(name: str, fmi: Literal[2, 3], folder: Path) -> Path:
    """The source-code FMU of a component without its libraries."""
    file = build(COMPONENTS[name], folder / "sources.fmu", fmi=fmi, sources=True, reference=reference_files(name))
    assert validate_fmu(str(file)) == []
    fmpy.extract(str(file), unzipdir=str(folder / "fmu"))
    shutil.rmtree(folder / "fmu/binaries")
    return folder / "fmu"


def compile_sources(folder: Path, *options: str) -> Path:
    """The library that gcc makes of the files that the description names."""
    (configuration,) = fmpy.read_model_description(str(folder)).buildConfigurations
    library = folder / f"{configuration.modelIdentifier}.so"
    files = configuration.sourceFileSets[0].sourceFiles
    warnings = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-variable", "-Wno-unused-but-set-variable", "-Wno-unused-function"]
    warnings += ["-Wno-unused-parameter", "-Wno-maybe-uninitialized"]
    command = ["gcc", "-std=c11", "-O1", "-shared", "-fPIC", *warnings, *options, "-o", str(library), *files, "-lm"]
    subprocess.run(command, cwd=folder / "sources", check=True)
    return library


def passes(folder: Path) -> bool:
    """Whether the FMU in a folder meets its reference results bit by bit."""
    file = folder.with_suffix(".fmu")
    with zipfile.ZipFile(file, "w") as archive:
        for part in sorted(folder.rglob("*")):
            if part.is_file():
                archive.write(part, part.relative_to(folder))
    return {r.check: r.outcome for r in check_fmu(file)}["reference results"] == "passed"


@pytest.mark.parametrize("name", ALL)
def test_the_same_bits_when_gcc_compiles_it(name: str, tmp_path: Path) -> None:
    folder = unpacked(name, 2, tmp_path)
    library = compile_sources(folder, OVERRIDE)
    (folder / "binaries/linux64").mkdir(parents=True)
    library.rename(folder / f"binaries/linux64/{name}.so")
    assert passes(folder)


@pytest.mark.skipif(not shutil.which("cmake"), reason="FMPy compiles with CMake")
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_same_bits_when_fmpy_compiles_it(tmp_path: Path) -> None:
    from fmpy.build import build_platform_binary

    folder = unpacked("spindle_current", 3, tmp_path)
    schema = etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema/fmi3/fmi3BuildDescription.xsd"))
    schema.assertValid(etree.parse(str(folder / "sources/buildDescription.xml")))
    build_platform_binary(folder)
    assert passes(folder)


def test_names_begin_with_the_model_identifier_unless_a_shared_library_is_made(tmp_path: Path) -> None:
    """So that several FMUs can be linked into one program."""
    library = compile_sources(unpacked("spindle_current", 3, tmp_path))
    defined = subprocess.run(["nm", "-D", "--defined-only", str(library)], capture_output=True, text=True, check=True).stdout
    names = {line.split()[-1] for line in defined.splitlines()}
    assert {"spindle_current_fmi3DoStep", "spindle_current_fmi2GetReal", "spindle_current_TOKEN"} <= names
    assert all(n.startswith("spindle_current_") for n in names)


def test_what_cannot_be_written_as_c_is_named() -> None:
    code = "define hidden i32 @model_init(ptr %0, ptr %1, ptr %2) #0 {\n  %4 = load atomic i64, ptr %2 seq_cst, align 8\n  ret i32 0\n}\n"
    with pytest.raises(NativeBuildError, match=r"no C code for the instruction '%4 = load atomic"):
        model_c(code)
    with pytest.raises(NativeBuildError, match=r"no C code for the instruction '%4 = cmpxchg"):
        model_c(code.replace("load atomic i64, ptr %2 seq_cst, align 8", "cmpxchg ptr %2, i64 0, i64 1"))
    with pytest.raises(NativeBuildError, match=r"no C code for call double @llvm\.sin\.f64"):
        model_c(code.replace("load atomic i64, ptr %2 seq_cst, align 8", "call double @llvm.sin.f64(double 1.000000e+00)"))
