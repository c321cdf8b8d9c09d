"""Other masters on the same ring of FMUs, each driven the way its documentation shows.

Each class prepares a ring of `count` FMUs and has `run(steps)`, which makes that many steps of 4 ms and returns the
seconds of wall clock and of CPU (all threads) that took. `outputs()` gives all outputs, for the check that everybody computes the same.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2

from benchmarks.ring import STEP

FloatArray = np.ndarray[Any, np.dtype[np.float64]]


def clocks() -> tuple[float, float]:
    """Wall clock and CPU time of all threads [s]."""
    return time.perf_counter(), time.process_time()


def since(began: tuple[float, float]) -> tuple[float, float]:
    """What has passed on both clocks [s]."""
    wall, cpu = clocks()
    return wall - began[0], cpu - began[1]


def between(first: tuple[int, tuple[float, float]], last: tuple[int, tuple[float, float]], steps: int) -> tuple[float, float]:
    """Time [s] between two marks (steps done, clocks), scaled to `steps`."""
    scale = steps / (last[0] - first[0])
    return (last[1][0] - first[1][0]) * scale, (last[1][1] - first[1][1]) * scale


class CLoop:
    """The plain C loop: a process of its own per run, which times itself."""

    def __init__(self, program: Path, library: Path, count: int, record: bool) -> None:
        self.program, self.record = program, record
        self.folder = tempfile.TemporaryDirectory()
        self.libraries = [shutil.copy(library, Path(self.folder.name) / f"ring{k}.so") for k in range(count)]
        self.sum = 0.0

    def run(self, steps: int) -> tuple[float, float]:
        """See the module."""
        command = [str(self.program), str(steps), str(int(self.record)), *map(str, self.libraries)]
        wall, cpu, total = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
        self.sum = float(total)
        return float(wall) * 1e-9 * steps, float(cpu) * 1e-9 * steps


class FmpyLoop:
    """FMPy's FMU2Slave, one setReal and one getReal with lists per FMU and step: what its users write."""

    def __init__(self, file: Path, count: int, record: bool) -> None:
        description = fmpy.read_model_description(str(file))
        self.inputs = [v.valueReference for v in description.modelVariables if v.causality == "input"]
        self.outs = [v.valueReference for v in description.modelVariables if v.causality == "output"]
        self.slaves, self.done, self.record = [], 0, record
        for k in range(count):
            folder = fmpy.extract(str(file))
            identifier = description.coSimulation.modelIdentifier
            slave = fmi2.FMU2Slave(guid=description.guid, modelIdentifier=identifier, unzipDirectory=folder, instanceName=f"m{k}")
            slave.instantiate()
            slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            self.slaves.append(slave)
        self.y = [s.getReal(self.outs) for s in self.slaves]
        self.rows: list[list[float]] = []

    def run(self, steps: int) -> tuple[float, float]:
        """See the module."""
        began = clocks()
        for k in range(self.done, self.done + steps):
            for i, slave in enumerate(self.slaves):
                slave.setReal(self.inputs, self.y[i - 1])
            for slave in self.slaves:
                slave.doStep(k * STEP, STEP)
            self.y = [slave.getReal(self.outs) for slave in self.slaves]
            if self.record:
                self.rows.append([(k + 1) * STEP, *(value for y in self.y for value in y)])
        took = since(began)
        self.done += steps
        self.rows.clear()
        return took

    def outputs(self) -> FloatArray:
        """All outputs."""
        return np.concatenate(self.y)


class Cosim:
    """libcosim through libcosimpy: a fixed-step algorithm, results to CSV files by its file observer."""

    def __init__(self, file: Path, count: int, record: bool) -> None:
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
        from libcosimpy.CosimObserver import CosimObserver
        from libcosimpy.CosimSlave import CosimLocalSlave

        log_output_level(CosimLogLevel.ERROR)
        self.execution = CosimExecution.from_step_size(round(STEP * 1e9))
        self.slaves = [CosimLocalSlave(fmu_path=str(file), instance_name=f"m{k}") for k in range(count)]
        self.numbers = [self.execution.add_local_slave(s) for s in self.slaves]
        description = fmpy.read_model_description(str(file))
        ins = [v.valueReference for v in description.modelVariables if v.causality == "input"]
        self.outs = [v.valueReference for v in description.modelVariables if v.causality == "output"]
        for k in range(count):
            for a, b in zip(self.outs, ins, strict=True):
                self.execution.connect_real_variables(self.numbers[k - 1], a, self.numbers[k], b)
        self.last: Any = None
        if record:
            self.folder = tempfile.TemporaryDirectory()
            self.observer = CosimObserver.create_to_dir(self.folder.name)
            self.execution.add_observer(self.observer)
        else:
            self.last = CosimObserver.create_last_value()
            self.execution.add_observer(self.last)

    def run(self, steps: int) -> tuple[float, float]:
        """See the module."""
        began = clocks()
        if not self.execution.step(steps):
            raise RuntimeError("libcosim could not step")
        return since(began)

    def outputs(self) -> FloatArray:
        """All outputs."""
        return np.concatenate([self.last.last_real_values(n, self.outs) for n in self.numbers])


class Ecos:
    """Ecos through ecospy: fixed steps, results to a CSV file by its writer."""

    def __init__(self, file: Path, count: int, record: bool) -> None:
        _load_tbb()
        from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure

        EcosLib.set_log_level("warn")
        structure = EcosSimulationStructure()
        description = fmpy.read_model_description(str(file))
        self.ins = [v.name for v in description.modelVariables if v.causality == "input"]
        self.outs = [v.name for v in description.modelVariables if v.causality == "output"]
        for k in range(count):
            structure.add_model(f"m{k}", str(file))
        for k in range(count):
            for a, b in zip(self.outs, self.ins, strict=True):
                structure.make_real_connection(f"m{(k - 1) % count}::{a}", f"m{k}::{b}")
        self.count = count
        self.simulation = EcosSimulation(structure=structure, step_size=STEP)
        if record:
            self.folder = tempfile.TemporaryDirectory()
            self.simulation.add_csv_writer(str(Path(self.folder.name) / "results.csv"))
        self.simulation.init()

    def run(self, steps: int) -> tuple[float, float]:
        """See the module."""
        began = clocks()
        self.simulation.step(steps)
        return since(began)

    def outputs(self) -> FloatArray:
        """All outputs."""
        return np.array([self.simulation.get_real(f"m{k}::{name}") for k in range(self.count) for name in self.outs])


def _load_tbb() -> None:
    """Ecos needs libtbb.so.12; the wheel `tbb` brings one, in a place where nobody looks."""
    for place in (Path(p) for p in sys.path):
        for found in sorted(place.glob("**/libtbb.so.12")) if place.name == "peers" else ():
            ctypes.CDLL(str(found), mode=ctypes.RTLD_GLOBAL)
            return
