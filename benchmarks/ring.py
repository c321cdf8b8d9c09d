"""The generic ring: C FMUs with equally many inputs and outputs, each fed by its neighbour; compiled on the spot."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from pathlib import Path

import fmpy

from robomill.orchestration.system.definition import Component, Connection, Recording, System

STEP = 0.004
HERE = Path(__file__).parent
HEADERS = Path(fmpy.__file__).parent / "c-code"


def compiler() -> str:
    """The C compiler of this machine; RuntimeError if there is none."""
    found = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if found is None:
        raise RuntimeError("the benchmarks compile C on the spot: install a C compiler (cc)")
    return found


def description(signals: int) -> str:
    """The modelDescription.xml of the FMU with `signals` inputs and outputs."""
    variables = [
        f'<ScalarVariable name="{name}[{i + 1}]" valueReference="{first + i}" causality="{causality}"'
        + (' initial="exact"' if causality == "output" else "")
        + f'><Real start="{0.0 if causality == "input" else i + 1.0}"/></ScalarVariable>'
        for name, causality, first in (("u", "input", 0), ("y", "output", signals))
        for i in range(signals)
    ]
    unknowns = "".join(f'<Unknown index="{signals + i + 1}" dependencies=""/>' for i in range(signals))
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<fmiModelDescription fmiVersion="2.0" modelName="Ring" guid="ring">'
        '<CoSimulation modelIdentifier="ring" canHandleVariableCommunicationStepSize="true"/>'
        f"<ModelVariables>{''.join(variables)}</ModelVariables>"
        f"<ModelStructure><Outputs>{unknowns}</Outputs></ModelStructure></fmiModelDescription>"
    )


def build(folder: Path, signals: int = 12) -> Path:
    """Compile and pack `ring.fmu`."""
    library = folder / "ring.so"
    command = [compiler(), "-shared", "-fPIC", "-O2", "-w", f"-DN={signals}", f"-I{HEADERS}", str(HERE / "ring.c"), "-o", str(library)]
    subprocess.run(command, check=True)
    file = folder / "ring.fmu"
    with zipfile.ZipFile(file, "w") as z:
        z.writestr("modelDescription.xml", description(signals))
        z.write(library, f"binaries/{fmpy.platform}/ring.so")
    return file


def build_loop(folder: Path, signals: int = 12) -> Path:
    """Compile the plain C loop."""
    program = folder / "loop"
    command = [compiler(), "-O2", "-w", f"-DN={signals}", f"-I{HEADERS}", str(HERE / "loop.c"), "-o", str(program), "-ldl"]
    subprocess.run(command, check=True)
    return program


def system(fmu: Path, count: int, recording: Recording | None = None) -> System:
    """The ring of `count` FMUs for our master."""
    names = [f"m{k + 1}" for k in range(count)]
    connections = tuple(Connection(f"{names[k - 1]}.y", f"{name}.u") for k, name in enumerate(names))
    return System("ring", STEP, tuple(Component(n, str(fmu)) for n in names), connections, "jacobi", recording=recording or Recording())
