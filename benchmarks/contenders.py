"""Who is measured, on what: the ring of generic FMUs and the milling cell, each as a list of masters to be started."""

from __future__ import annotations

import copyreg
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

from benchmarks import ring, ring_model
from benchmarks.network import Network, calls
from benchmarks.peers import build_container
from benchmarks.runners import Program, Runner, Worker
from benchmarks.system_loop import SystemLoop
from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.milling import prepare
from robomill.cell.scenario import load_scenario
from robomill.fmus.python.builder import build as build_python
from robomill.orchestration.assembly import Assembly, assemble
from robomill.orchestration.system.definition import Component, System

ROOT = Path(__file__).parent.parent
C_LOOP = "plain C loop"
C_LOOP_FILLING = f"{C_LOOP}, memory as it fills"
OURS = "robomill, compiled loop"
Environment = Mapping[str, str] | None


def _as_dict(proxy: Any) -> Any:
    return dict, (dict(proxy),)


copyreg.pickle(MappingProxyType, _as_dict)  # systems hold some


@contextmanager
def side_by_side(commands: Iterable[Sequence[str]]) -> Iterator[None]:
    """Programs run while something else is done; in the end all have ended. CalledProcessError if one failed."""
    started = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) for command in commands]
    try:
        yield
    finally:
        said = [process.communicate() for process in started]
    for process, (output, errors) in zip(started, said, strict=True):
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, process.args, output, errors)


@dataclass(frozen=True)
class Contender:
    """A master, how its process is started, and where it can put results."""

    name: str
    start: Callable[[Environment], Runner]
    results: tuple[str, ...]
    """none, memory, disk."""
    note: str = ""


@dataclass
class Bench:
    """A system that all contenders run."""

    folder: Path
    kept: list[Assembly] = field(default_factory=list)

    def worker(self, kind: str, what: System | Network, name: str) -> Callable[[Environment], Runner]:
        """A process with that kind of master; what it runs is in a file."""
        file = self.folder / f"{name}.pickle"
        file.write_bytes(pickle.dumps(what))
        return lambda environment: Worker(kind, file, environment)

    def open(self, system: System) -> Assembly:
        """An assembly whose FMUs stay unpacked until `close`."""
        self.kept.append(assemble(system, resolve, convert))
        return self.kept[-1]

    def close(self) -> None:
        """Remove what was unpacked."""
        while self.kept:
            self.kept.pop().close()

    def program(self, system: System, name: str, prefault: bool = True) -> Callable[[Environment], Runner]:
        """A generated C loop for a system of FMUs, compiled when it is started; `prefault`: see `system_loop.generate`."""

        def start(environment: Environment) -> Runner:
            folder = self.folder / name
            folder.mkdir(exist_ok=True)
            assembly = self.open(system)
            made = {record: SystemLoop(assembly, folder, record, prefault).program for record in (False, True)}
            return Program(lambda steps, record: [str(made[record]), str(steps)])

        return start

    def container(self, network: Network, name: str) -> Callable[[Environment], Runner]:
        """The FMU container of fmu-manipulation-toolbox, stepped by a generated C loop: one doStep and one get per type."""

        def start(environment: Environment) -> Runner:
            folder = self.folder / name
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            fmu = build_container(network, folder, "container")
            alone = System(name, network.step, (Component("container", str(fmu)),), algorithm="jacobi")
            return self.program(alone, f"{name}_loop", prefault=False)(environment)

        return start


@dataclass
class Ring(Bench):
    """`count` generic FMUs with `signals` inputs and outputs, each fed by its neighbour, Jacobi."""

    count: int = 4
    signals: int = 12

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True)
        self.fmu = ring.build(self.folder, self.signals)
        self.system = ring.system(self.fmu, self.count)
        with assemble(self.system) as assembly:
            self.network = Network.of(assembly)
        self.calls = calls(self.network)

    @cached_property
    def _loop(self) -> tuple[str, list[str]]:
        """The compiled C loop, and a library for each FMU."""
        program = ring.build_loop(self.folder, self.signals)
        return str(program), [str(shutil.copy(self.folder / "ring.so", self.folder / f"ring{k}.so")) for k in range(self.count)]

    def loop(self, kept: int) -> Program:
        """The plain C loop; `kept`: how it keeps results if they are wanted, RECORD of `loop.c`."""
        program, libraries = self._loop
        return Program(lambda steps, record: [program, str(steps), str(kept * record), *libraries])

    def masters(self) -> list[Contender]:
        """One of each library, at its best: for scaling, memory, cold start."""
        network = self.network
        return [
            Contender(C_LOOP, lambda _: self.loop(1), ("none", "memory"), "statuses checked, nothing else"),
            Contender(OURS, self.worker("compiled", self.system, "system"), ("none", "memory", "disk")),
            Contender("FMPy, lists", self.worker("fmpy", network, "network"), ("none", "memory")),
            Contender("libcosim (libcosimpy)", self.worker("libcosim", network, "network"), ("none", "memory", "disk")),
            Contender("Ecos (ecospy)", self.worker("ecos", network, "network"), ("none", "disk")),
            Contender("FMU container, C loop", self.container(network, "container"), ("none", "memory")),
        ]

    def contenders(self) -> list[Contender]:
        """All of them: also in process, pythonfmu, and loops in Python."""
        in_process = replace(self.system, components=tuple(replace(c, source="ring") for c in self.system.components))
        python = build_python(ring_model.MODEL, self.folder / "python.fmu", page="", reference={})
        pythonfmu = replace(self.system, components=tuple(replace(c, source=str(python)) for c in self.system.components))
        return [
            *self.masters(),
            Contender(C_LOOP_FILLING, lambda _: self.loop(3), ("memory",), "takes it while the clock runs, as all the others do"),
            Contender("robomill, Python loop", self.worker("python", self.system, "system"), ("none", "disk")),
            Contender("robomill, compiled loop, in process", self.worker("compiled", in_process, "in_process"), ("none", "disk")),
            Contender("robomill, compiled loop, pythonfmu", self.worker("compiled", pythonfmu, "pythonfmu"), ("none", "disk")),
            Contender("FMPy, buffers", self.worker("fmpy-buffers", self.network, "network"), ("none", "memory")),
        ]


@dataclass
class Milling(Bench):
    """The groove of `scenarios/groove.toml` with pilot control off, from beginning to end: six components."""

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True)
        job = prepare(load_scenario(ROOT / "scenarios" / "groove.toml"), self.folder / "groove")
        robomill = str(Path(sys.executable).parent / "robomill")
        chosen = [word for c in job.system.components for word in ("--component", c.source)]
        self.in_process = replace(job.system, stop_when=None, labels={})
        builds = ([robomill, "build", "--backend", b, "--out", str(self.folder / b), *chosen] for b in ("native", "python"))
        with side_by_side(builds):
            compiling = self.worker("compiled", self.in_process, "in_process")(None)
            try:
                compiling.run(2, "none", limit=240.0)  # what Numba compiles stays on disk
            finally:
                compiling.close()
        self.steps = job.steps
        self.native = with_fmus(self.in_process, self.folder / "native")
        self.python = with_fmus(self.in_process, self.folder / "python")
        with assemble(self.native, resolve, convert) as assembly:
            self.network = Network.of(assembly)
        with assemble(replace(self.native, algorithm="jacobi"), resolve, convert) as assembly:
            self.parallel = Network.of(assembly)
        self.calls = calls(self.network)

    def gauss_seidel(self) -> list[Contender]:
        """The cell as its system file says: one after the other, with delays where they are marked."""
        return [
            Contender(C_LOOP, self.program(self.native, "native_loop"), ("none", "memory")),
            Contender(OURS, self.worker("compiled", self.native, "native"), ("none", "memory", "disk"), "native FMUs"),
            Contender(f"{OURS}, in process", self.worker("compiled", self.in_process, "in_process"), ("none", "disk")),
            Contender(f"{OURS}, pythonfmu", self.worker("compiled", self.python, "pythonfmu"), ("none", "disk")),
            Contender("robomill, Python loop", self.worker("python", self.native, "native"), ("none", "disk"), "native FMUs"),
            Contender("FMPy, lists", self.worker("fmpy", self.network, "network"), ("none", "memory")),
            Contender("FMPy, buffers", self.worker("fmpy-buffers", self.network, "network"), ("none", "memory")),
            Contender("FMU container, C loop", self.container(self.network, "sequential"), ("none", "memory"), "sequential"),
        ]

    def jacobi(self) -> list[Contender]:
        """All components at once, which is what libcosim and Ecos can do."""
        native = replace(self.native, algorithm="jacobi")
        return [
            Contender(C_LOOP, self.program(native, "jacobi_loop"), ("none", "memory")),
            Contender(OURS, self.worker("compiled", native, "jacobi"), ("none", "memory", "disk"), "native FMUs"),
            Contender("FMPy, lists", self.worker("fmpy", self.parallel, "parallel"), ("none", "memory")),
            Contender("libcosim (libcosimpy)", self.worker("libcosim", self.parallel, "parallel"), ("none", "memory", "disk")),
            Contender("Ecos (ecospy)", self.worker("ecos", self.parallel, "parallel"), ("none", "disk")),
            Contender("FMU container, C loop", self.container(self.parallel, "parallel_container"), ("none", "memory"), "parallel"),
        ]
