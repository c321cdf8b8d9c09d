"""Importers of others, each driven as its documentation shows: an SSP package, unpacked into a folder, run for some steps.

    python -m tests.cell.importers NAME PACKAGE FOLDER STEPS OUT [STEP]

writes the real outputs of all components to OUT (npz: one array [steps + 1] per `component.port`; STEP in s), in a process of its own: some
of these libraries end theirs badly. Tables are named relative to the package, so its folder is the working directory.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.ssp.ssd import get_connections, read_ssd
from lxml import etree

STEP = 0.004
Rows = list[list[float]]


class Package:
    """What the importers need of a package: by the readers of others."""

    def __init__(self, file: Path, folder: Path, step: float = STEP) -> None:
        self.folder, self.step = folder, step
        with zipfile.ZipFile(file) as archive:
            archive.extractall(folder)
        self.system = read_ssd(str(file)).system
        self.sources = {e.name: folder / e.source for e in self.system.elements}
        self.descriptions = {name: fmpy.read_model_description(str(fmu)) for name, fmu in self.sources.items()}
        self.columns = [
            (name, v) for name, md in self.descriptions.items() for v in md.modelVariables if v.causality == "output" and v.type == "Real"
        ]
        self.links = [
            (a.parent.name, a.name, b.parent.name, b.name) if a.kind == "output" else (b.parent.name, b.name, a.parent.name, a.name)
            for a, b in get_connections(self.system)
        ]

    def parameters(self) -> Iterator[tuple[str, str, str, str]]:
        """(component, variable, type, text) of all SSV files."""
        for name in self.sources:
            file = self.folder / "resources" / f"{name}.ssv"
            if file.is_file():
                for parameter in etree.parse(str(file)).iterfind("{*}Parameters/{*}Parameter"):
                    yield name, parameter.get("name"), etree.QName(parameter[0]).localname, parameter[0].get("value")


def fmpy_loop(package: Package, steps: int, time: Callable[[int], tuple[float, float]] | None = None) -> Rows:
    """FMPy's FMU2Slave in a Jacobi loop. `time`: what fmi2DoStep is given in step k."""
    at = time or (lambda k: (k * package.step, package.step))
    slaves: dict[str, Any] = {}
    reference = {name: {v.name: v.valueReference for v in md.modelVariables} for name, md in package.descriptions.items()}
    for name, md in package.descriptions.items():
        folder = fmpy.extract(str(package.sources[name]))
        identifier = md.coSimulation.modelIdentifier
        slaves[name] = FMU2Slave(guid=md.guid, unzipDirectory=folder, modelIdentifier=identifier, instanceName=name)
        slaves[name].instantiate()
    read: dict[str, Callable[[str], Any]] = {"Real": float, "Integer": int, "Boolean": lambda text: text == "true", "String": str}
    for name, variable, kind, text in package.parameters():
        getattr(slaves[name], f"set{kind}")([reference[name][variable]], [read[kind](text)])
    for slave in slaves.values():
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()

    types = {name: {v.name: v.type for v in md.modelVariables} for name, md in package.descriptions.items()}

    def connect() -> None:
        values = [getattr(slaves[a], f"get{types[a][x]}")([reference[a][x]])[0] for a, x, _, _ in package.links]
        for (_, _, b, y), value in zip(package.links, values, strict=True):
            getattr(slaves[b], f"set{types[b][y]}")([reference[b][y]], [value])

    def row() -> list[float]:
        return [slaves[name].getReal([v.valueReference])[0] for name, v in package.columns]

    for _ in slaves:  # what comes out of one goes into the next, as often as there are any
        connect()
    for slave in slaves.values():
        slave.exitInitializationMode()
    rows = [row()]
    for k in range(steps):
        connect()
        for slave in slaves.values():
            slave.doStep(*at(k))
        rows.append(row())
    return rows


def fmpy_with_the_times_of_libcosim(package: Package, steps: int) -> Rows:
    """Libcosim counts nanoseconds; the length of a step is the difference of the two times, each rounded to a double."""
    tick = round(package.step * 1e9)
    return fmpy_loop(package, steps, lambda k: (k * tick / 1e9, (k + 1) * tick / 1e9 - k * tick / 1e9))


def libcosim(package: Package, steps: int) -> Rows:
    """libcosimpy: reads the package itself."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.ERROR)
    execution = CosimExecution.from_ssp_file(ssp_path=str(package.folder))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    numbers = {name: execution.slave_index_from_instance_name(name) for name in package.sources}
    wanted = {name: [v.valueReference for n, v in package.columns if n == name] for name in package.sources}

    def row() -> list[float]:
        return [value for name in package.sources for value in observer.last_real_values(numbers[name], wanted[name])]

    rows = []
    for k in range(steps + 1):
        if k > 0 and not execution.step(1):
            raise RuntimeError("libcosim could not step")
        rows.append(row() if k > 0 else [np.nan] * len(package.columns))  # it shows nothing before the first step
    return rows


def ecos(package: Package, steps: int) -> Rows:
    """ecospy: reads the package itself. It needs libtbb.so.12, which the wheel `tbb` puts where nobody looks."""
    ctypes.CDLL(str(Path(sys.prefix) / "lib/libtbb.so.12"), mode=ctypes.RTLD_GLOBAL)
    from ecospy import EcosLib, EcosSimulation

    EcosLib.set_log_level("warn")
    simulation = EcosSimulation(ssp_path=str(package.folder), step_size=package.step)
    simulation.init(parameter_set="default")
    names = [f"{name}::{v.name}" for name, v in package.columns]
    rows = [[simulation.get_real(n) for n in names]]
    for _ in range(steps):
        simulation.step(1)
        rows.append([simulation.get_real(n) for n in names])
    return rows


def container(package: Package, steps: int) -> Rows:
    """The FMU container of fmu-manipulation-toolbox: one FMU of all, which FMPy steps."""
    names = {name: f"{name}.fmu" for name in package.sources}
    place = package.folder / "container"
    place.mkdir(exist_ok=True)
    for name, source in package.sources.items():
        (place / names[name]).write_bytes(source.read_bytes())
    description = {
        "name": "cell.fmu",
        "step_size": package.step,
        "auto_link": False,
        "auto_input": False,
        "auto_output": False,
        "fmu": list(names.values()),
        "link": [[names[a], x, names[b], y] for a, x, b, y in package.links],
        "output": [[names[name], v.name, f"{name}.{v.name}"] for name, v in package.columns],
        "start": [[names[name], variable, text] for name, variable, _, text in package.parameters()],
    }
    (place / "cell.json").write_text(json.dumps(description))
    make = [sys.executable, "-m", "fmu_manipulation_toolbox.cli.fmucontainer", "-fmu-directory", str(place), "-container", "cell.json"]
    done = subprocess.run(make, capture_output=True, text=True, check=False)
    if not (place / "cell.fmu").is_file():
        raise RuntimeError(f"fmucontainer: {done.stdout}{done.stderr}")
    md = fmpy.read_model_description(str(place / "cell.fmu"), validate=False)
    reference = {v.name: v.valueReference for v in md.modelVariables}
    identifier = md.coSimulation.modelIdentifier
    cell = FMU2Slave(guid=md.guid, unzipDirectory=fmpy.extract(str(place / "cell.fmu")), modelIdentifier=identifier, instanceName="cell")
    cell.instantiate()
    cell.setupExperiment(startTime=0.0)
    cell.enterInitializationMode()
    cell.exitInitializationMode()
    wanted = [reference[f"{name}.{v.name}"] for name, v in package.columns]
    rows = [cell.getReal(wanted)]
    for k in range(steps):
        cell.doStep(k * package.step, package.step)
        rows.append(cell.getReal(wanted))
    return rows


IMPORTERS: dict[str, Callable[[Package, int], Rows]] = {
    "FMPy": fmpy_loop,
    "FMPy with the times of libcosim": fmpy_with_the_times_of_libcosim,
    "libcosim": libcosim,
    "Ecos": ecos,
    "FMU container": container,
}


def main(name: str, file: str, folder: str, steps: str, out: str, step: str = str(STEP)) -> None:
    """Run one importer and write what it gives."""
    package = Package(Path(file), Path(folder), float(step))
    os.chdir(folder)
    rows = np.array(IMPORTERS[name](package, int(steps)))
    np.savez(out, **{f"{n}.{v.name}": rows[:, i] for i, (n, v) in enumerate(package.columns)})
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
