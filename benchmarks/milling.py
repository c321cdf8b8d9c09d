"""The milling cell on the groove of `scenarios/groove.toml`: whole runs with our master and with a C loop generated for it."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.peers import between, clocks
from benchmarks.system_loop import SystemLoop
from orchestration.assembly import Assembly, assemble
from orchestration.master import Master
from orchestration.recorder import Recorder
from orchestration.system import System
from robomill.binding import convert, resolve, with_fmus
from robomill.milling import prepare
from robomill.scenario import load_scenario

ROOT = Path(__file__).parent.parent


class Cell:
    """The planned groove, with in-process components and with native FMUs built for this machine."""

    def __init__(self, folder: Path) -> None:
        build = [str(Path(sys.executable).parent / "robomill"), "build", "--backend", "native", "--out", str(folder / "fmus")]
        subprocess.run(build, check=True, capture_output=True)
        job = prepare(load_scenario(ROOT / "scenarios" / "groove.toml"), folder / "groove")
        self.folder, self.steps = folder, job.steps
        self.kept: list[Assembly] = []
        self.in_process: System = job.system
        self.native: System = with_fmus(job.system, folder / "fmus")

    def c_loop(self, record: bool) -> SystemLoop:
        """The plain C loop on the native FMUs; its FMUs stay unpacked until the end of the process."""
        self.kept.append(assemble(self.native, resolve, convert))
        return SystemLoop(self.kept[-1], self.folder, record)


class Milling:
    """Our master on a version of the cell; every measurement is a run from t = 0."""

    def __init__(self, system: System, record: bool, loop: str) -> None:
        self.assembly, self.record, self.loop = assemble(system, resolve, convert), record, loop
        self.final: Any = None

    def run(self, steps: int) -> tuple[float, float]:
        """Wall clock and CPU [s] of the steps after the first (which loads compiled code), scaled to all; writing included, closing not."""
        a, s = self.assembly, self.assembly.system
        with tempfile.TemporaryDirectory() as folder:
            observers = [Recorder(Path(folder) / "run")] if self.record else []
            master = Master(a.slaves, a.wiring, s.step, s.algorithm, observers, loop=self.loop)
            marks: list[tuple[int, tuple[float, float]]] = []
            master.run(steps * s.step, progress=lambda k, n: marks.append((k, clocks())))
        self.final = master.outputs.copy()
        return between(marks[0], marks[-1], steps)
