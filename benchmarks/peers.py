"""Masters of others on a `Network`, each driven the way its documentation shows. They record all outputs, as ours does."""

from __future__ import annotations

import csv
import ctypes
import logging
import pickle
import shutil
import sys
import tempfile
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.answer import Answer, clocks, peak_memory
from benchmarks.network import Member, Network, Variable, by_type

WARM = 50  # steps before the clock starts


class Peer(ABC):
    """A master that is set up anew for every run, so that each begins at t = 0."""

    def __init__(self, file: Path) -> None:
        self.network: Network = pickle.loads(file.read_bytes())

    def run(self, steps: int, results: str, check: bool) -> Answer:
        """`results` is one of those of `benchmarks.contenders`."""
        began, warm = clocks()[0], min(WARM, steps // 2)
        with tempfile.TemporaryDirectory() as folder:
            self.check = check
            self.start(results, Path(folder), steps)
            first = clocks()
            self.step(warm)
            second = clocks()
            self.step(steps - warm)
            last = clocks()
            scale = steps / (steps - warm)
            answer = Answer((last[0] - second[0]) * scale, (last[1] - second[1]) * scale)
            answer.setup, answer.finished = first[0] - began, last[0]
            if check:
                answer.outputs = [float(y) for y in self.outputs()]
            self.end()
            answer.closing = clocks()[0] - last[0]
            answer.memory = peak_memory()
            if check and results != "none":
                answer.recorded = [float(y) for y in self.recorded(Path(folder))]
        return answer

    @abstractmethod
    def start(self, results: str, folder: Path, steps: int) -> None:
        """Everything before the first step."""

    @abstractmethod
    def step(self, steps: int) -> None:
        """So many steps from where it stands."""

    @abstractmethod
    def outputs(self) -> Any:
        """All outputs now."""

    @abstractmethod
    def end(self) -> None:
        """Give everything back; results are complete then."""

    @abstractmethod
    def recorded(self, folder: Path) -> Any:
        """The last row of the results."""


class Fmpy(Peer):
    """FMPy's FMU2Slave with lists of values, one set, step, get per FMU: what its users write."""

    def start(self, results: str, folder: Path, steps: int) -> None:
        """See `Peer`."""
        import fmpy
        from fmpy import fmi2

        self.record, self.done = results == "memory", 0
        self.rows: list[list[float]] = []
        self.bus: Any = self.new_bus(len(self.network.outputs))
        self.slaves: list[tuple[Any, list[Any], list[Any]]] = []
        for m in self.network.members:
            description = fmpy.read_model_description(m.fmu, validate=False)
            slave = fmi2.FMU2Slave(
                guid=description.guid,
                modelIdentifier=description.coSimulation.modelIdentifier,
                unzipDirectory=fmpy.extract(m.fmu, str(folder / m.name)),
                instanceName=m.name,
            )
            slave.instantiate()
            for p in m.parameters:
                getattr(slave, f"set{p.type.title()}")([p.reference], [p.value])
            slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
            known = [i for i, now in enumerate(m.known_first) if now]
            sets = self.sets(slave, m, range(len(m.inputs)))
            gets = self.gets(slave, m)
            self.call(self.sets(slave, m, known))
            self.read(gets)
            slave.exitInitializationMode()
            self.slaves.append((slave, sets, gets))

    def new_bus(self, n: int) -> Any:
        """Where all outputs are kept."""
        return [0.0] * n

    def sets(self, slave: Any, m: Member, which: Any) -> list[Any]:
        """(function, references, places) per type of the inputs."""
        chosen = [m.inputs[i] for i in which]
        places = [m.sources[i] for i in which]
        return [
            (getattr(slave, f"set{t.title()}"), [chosen[i].reference for i in positions], [places[i] for i in positions])
            for t, positions in by_type(chosen)
        ]

    def gets(self, slave: Any, m: Member) -> list[Any]:
        """(function, references, places) per type of the outputs."""
        return [
            (getattr(slave, f"get{t.title()}"), [m.outputs[i].reference for i in positions], [m.first + i for i in positions])
            for t, positions in by_type(m.outputs)
        ]

    def call(self, sets: list[Any]) -> None:
        """Set inputs from the bus."""
        bus = self.bus
        for function, references, places in sets:
            function(references, [bus[i] for i in places])

    def read(self, gets: list[Any]) -> None:
        """Get outputs to the bus."""
        bus = self.bus
        for function, references, places in gets:
            for i, value in zip(places, function(references), strict=True):
                bus[i] = value

    def step(self, steps: int) -> None:
        """See `Peer`."""
        h, jacobi = self.network.step, self.network.algorithm == "jacobi"
        for k in range(self.done, self.done + steps):
            t = k * h
            if jacobi:
                for _, sets, _ in self.slaves:
                    self.call(sets)
                for slave, _, _ in self.slaves:
                    slave.doStep(t, h)
                for _, _, gets in self.slaves:
                    self.read(gets)
            else:
                for slave, sets, gets in self.slaves:
                    self.call(sets)
                    slave.doStep(t, h)
                    self.read(gets)
            if self.record:
                self.rows.append([t + h, *self.bus])
        self.done += steps

    def outputs(self) -> Any:
        """See `Peer`."""
        return self.bus

    def end(self) -> None:
        """See `Peer`."""
        for slave, _, _ in self.slaves:
            slave.terminate()
            slave.freeInstance()

    def recorded(self, folder: Path) -> Any:
        """See `Peer`."""
        return self.rows[-1][1:]


class FmpyBuffers(Fmpy):
    """FMPy's C functions with arrays that are made once and a bus in NumPy: what a careful user writes."""

    def new_bus(self, n: int) -> Any:
        """See `Fmpy`."""
        return np.zeros(n)

    def sets(self, slave: Any, m: Member, which: Any) -> list[Any]:
        """(function, arguments, places, buffer) per type."""
        chosen, places = [m.inputs[i] for i in which], np.array([m.sources[i] for i in which], np.intp)
        return [self._prepared(slave, "Set", t, chosen, positions, places) for t, positions in by_type(chosen)]

    def gets(self, slave: Any, m: Member) -> list[Any]:
        """What gets the outputs, as `sets` does for the inputs."""
        places = np.arange(m.first, m.first + len(m.outputs))
        return [self._prepared(slave, "Get", t, m.outputs, positions, places) for t, positions in by_type(m.outputs)]

    def _prepared(self, slave: Any, way: str, kind: str, variables: Any, positions: list[int], places: Any) -> Any:
        references = (ctypes.c_uint * len(positions))(*(variables[i].reference for i in positions))
        values: Any = ((ctypes.c_double if kind == "real" else ctypes.c_int) * len(positions))()
        function = getattr(slave, f"fmi2{way}{kind.title()}")
        return function, (slave.component, references, len(positions), values), places[positions], np.ctypeslib.as_array(values)

    def call(self, sets: list[Any]) -> None:
        """See `Fmpy`."""
        for function, arguments, places, buffer in sets:
            buffer[:] = self.bus[places]
            function(*arguments)

    def read(self, gets: list[Any]) -> None:
        """See `Fmpy`."""
        for function, arguments, places, buffer in gets:
            function(*arguments)
            self.bus[places] = buffer


class Cosim(Peer):
    """libcosim through libcosimpy: fixed steps; results by its time series observer (memory) or file observer (CSV, all variables)."""

    def start(self, results: str, folder: Path, steps: int) -> None:
        """See `Peer`."""
        from libcosimpy.CosimEnums import CosimVariableType
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
        from libcosimpy.CosimObserver import CosimObserver
        from libcosimpy.CosimSlave import CosimLocalSlave

        log_output_level(CosimLogLevel.ERROR)
        self.execution = CosimExecution.from_step_size(round(self.network.step * 1e9))
        members = sorted(self.network.members, key=lambda m: m.first)
        slaves = [CosimLocalSlave(fmu_path=m.fmu, instance_name=m.name) for m in members]
        self.numbers = {m.name: self.execution.add_local_slave(s) for m, s in zip(members, slaves, strict=True)}
        outputs = self.network.outputs
        for m in members:
            number = self.numbers[m.name]
            for p in m.parameters:
                getattr(self.execution, f"{p.type}_initial_value")(number, p.reference, p.value)
            for v, place in zip(m.inputs, m.sources, strict=True):
                source, output = outputs[place]
                connect = getattr(self.execution, f"connect_{v.type}_variables")
                connect(self.numbers[source.name], output.reference, number, v.reference)
        self.values: Any = CosimObserver.create_last_value()
        self.execution.add_observer(self.values)
        self.series: Any = None
        self.files: Any = None
        if results == "memory":
            self.series = CosimObserver.create_time_series(buffer_size=steps + 1)
            self.execution.add_observer(self.series)
            for m, v in outputs:
                if v.type != "boolean":  # it observes real and integer variables only
                    self.series.start_time_series(self.numbers[m.name], v.reference, CosimVariableType[v.type.upper()])
        elif results == "disk":
            self.files = CosimObserver.create_to_dir(str(folder))
            self.execution.add_observer(self.files)
        self.steps = steps

    def step(self, steps: int) -> None:
        """See `Peer`."""
        if steps and not self.execution.step(steps):
            raise RuntimeError("libcosim could not step")

    def outputs(self) -> Any:
        """See `Peer`."""
        return [getattr(self.values, f"last_{v.type}_values")(self.numbers[m.name], [v.reference])[0] for m, v in self.network.outputs]

    def end(self) -> None:
        """See `Peer`."""
        self.kept = [self._sample(m, v) for m, v in self.network.outputs] if self.check and self.series is not None else []
        del self.execution
        self.values = self.series = self.files = None  # files are complete when their observer is gone

    def _sample(self, m: Member, v: Variable) -> float:
        if v.type == "boolean":
            return float(self.values.last_boolean_values(self.numbers[m.name], [v.reference])[0])
        read = getattr(self.series, f"time_series_{v.type}_samples")
        return float(read(self.numbers[m.name], v.reference, from_step=self.steps, sample_count=1)[2][0])

    def recorded(self, folder: Path) -> Any:
        """See `Peer`."""
        if self.kept:
            return self.kept
        last: dict[str, dict[str, str]] = {}
        for m in self.network.members:
            file = max(folder.glob(f"{m.name}_*.csv"))
            with file.open(newline="") as text:
                *_, last[m.name] = csv.DictReader(text)
        rows = {name: {k.partition(" [")[0].strip(): x for k, x in row.items() if k} for name, row in last.items()}
        return [_number(rows[m.name][v.name]) for m, v in self.network.outputs]


class Ecos(Peer):
    """Ecos through ecospy: fixed steps, results to a CSV file by its writer."""

    def start(self, results: str, folder: Path, steps: int) -> None:
        """See `Peer`."""
        _load_tbb()
        from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure

        EcosLib.set_log_level("warn")
        structure, outputs = EcosSimulationStructure(), self.network.outputs
        members = sorted(self.network.members, key=lambda m: m.first)
        for m in members:
            structure.add_model(m.name, m.fmu)
        names = {"real": "real", "integer": "int", "boolean": "bool"}
        for m in members:
            for v, place in zip(m.inputs, m.sources, strict=True):
                source, output = outputs[place]
                getattr(structure, f"make_{names[v.type]}_connection")(f"{source.name}::{output.name}", f"{m.name}::{v.name}")
        given: dict[str, Any] = {f"{m.name}::{p.name}": p.value for m in members for p in m.parameters}
        if given:
            structure.add_parameter_set("given", given)
        self.simulation = EcosSimulation(structure=structure, step_size=self.network.step)
        if results == "disk":
            self.simulation.add_csv_writer(str(folder / "results.csv"), identifiers=[f"{m.name}::{v.name}" for m, v in outputs])
        self.simulation.init(parameter_set="given" if given else None)

    def step(self, steps: int) -> None:
        """See `Peer`."""
        if steps:
            self.simulation.step(steps)

    def outputs(self) -> Any:
        """See `Peer`."""
        return [getattr(self.simulation, f"get_{_ECOS[v.type]}")(f"{m.name}::{v.name}") for m, v in self.network.outputs]

    def end(self) -> None:
        """See `Peer`."""
        self.simulation.terminate()
        self.simulation.free()

    def recorded(self, folder: Path) -> Any:
        """See `Peer`."""
        with (folder / "results.csv").open(newline="") as text:
            *_, last = csv.DictReader(text, skipinitialspace=True)
        row = {k.partition("[REAL]")[0].partition("[INT]")[0].partition("[BOOL]")[0].strip(): x for k, x in last.items() if k}
        return [_number(row[f"{m.name}::{v.name}"]) for m, v in self.network.outputs]


_ECOS = {"real": "real", "integer": "integer", "boolean": "bool"}


def _number(text: str) -> float:
    return float({"true": "1", "false": "0"}.get(text.strip(), text))


def _load_tbb() -> None:
    """Ecos needs libtbb.so.12; the wheel `tbb` brings one, in a place where nobody looks."""
    brought = Path(sys.prefix) / "lib" / "libtbb.so.12"
    if brought.exists():
        ctypes.CDLL(str(brought), mode=ctypes.RTLD_GLOBAL)


def build_container(network: Network, folder: Path, name: str) -> Path:
    """The network as one FMU by fmu-manipulation-toolbox; ImportError if that is not installed."""
    from fmu_manipulation_toolbox.assembly import AssemblyNode

    logging.getLogger("fmu_manipulation_toolbox").setLevel(logging.CRITICAL)  # it warns of loops and of open inputs
    files = {m.name: f"{m.name}.fmu" for m in network.members}
    node = AssemblyNode(
        f"{name}.fmu",
        step_size=network.step,
        sequential=network.algorithm != "jacobi",
        auto_link=False,
        auto_input=False,
        auto_output=False,
    )
    for m in network.members:
        node.add_fmu(files[m.name], str(Path(m.fmu).resolve()))
    outputs = network.outputs
    for m in network.members:
        for p in m.parameters:
            node.add_start_value(files[m.name], p.name, p.value if isinstance(p.value, bool) else str(p.value))
        for v, place in zip(m.inputs, m.sources, strict=True):
            source, output = outputs[place]
            node.add_link(files[source.name], output.name, files[m.name], v.name)
    for m, v in outputs:
        node.add_output(files[m.name], v.name, f"{m.name}.{v.name}")
    shutil.rmtree(folder / name, ignore_errors=True)
    node.make_fmu(folder)
    return folder / f"{name}.fmu"
