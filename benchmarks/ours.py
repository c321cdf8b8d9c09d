"""Our master, as the others see it: a system from a file, whole runs of so many steps."""

from __future__ import annotations

import pickle
import tempfile
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from benchmarks import ring_model
from benchmarks.answer import Answer, clocks, peak_memory
from robomill.cell.binding import convert, resolve
from robomill.fmus.in_process import InProcessSlave
from robomill.orchestration.assembly import assemble
from robomill.orchestration.loop.master import Master
from robomill.orchestration.runs.memory import Memory
from robomill.orchestration.runs.recorder import Recorder
from robomill.orchestration.slaves.protocol import Slave


def resolver(source: str, name: str) -> Slave:
    """Components of this project, and the one of the ring."""
    return InProcessSlave(ring_model.MODEL, name) if source == ring_model.MODEL.name else resolve(source, name)


class Ours:
    """The master with the loop that is asked for; it checks every output in every step."""

    def __init__(self, file: Path, loop: str) -> None:
        self.loop, began = loop, clocks()
        self.assembly = assemble(pickle.loads(file.read_bytes()), resolver, convert)
        self.setup = clocks()[0] - began[0]

    def run(self, steps: int, results: str, check: bool) -> Answer:
        """`results`: none, memory, or disk (an Arrow stream that becomes Parquet at the end)."""
        a, s, began = self.assembly, self.assembly.system, clocks()[0]
        with tempfile.TemporaryDirectory() as folder:
            run = Path(folder) / "run"
            observers: list[Any] = [Memory()] if results == "memory" else [Recorder(run)] if results == "disk" else []
            master = Master(a.slaves, a.wiring, s.step, s.algorithm, observers, check_ranges=s.check_ranges, loop=self.loop)
            marks: list[tuple[int, tuple[float, float]]] = []
            master.run(steps * s.step, progress=lambda k, n: marks.append((k, clocks())))
            ended = clocks()[0]
            # after the first chunk, in which the tables are laid out and compiled code is loaded; no later: the steps of a run differ
            first, last = marks[min(1, len(marks) - 2)], marks[-1]
            scale = steps / max(last[0] - first[0], 1)
            answer = Answer((last[1][0] - first[1][0]) * scale, (last[1][1] - first[1][1]) * scale)
            answer.setup, answer.closing, answer.finished = self.setup + marks[0][1][0] - began, ended - last[1][0], last[1][0]
            answer.memory = peak_memory()
            if check:
                answer.outputs = [float(y) for y in master.outputs]
                answer.recorded = self._recorded(observers[0], run) if observers else []
        return answer

    def _recorded(self, observer: Any, folder: Path) -> list[float]:
        if isinstance(observer, Memory):
            return [float(column[-1]) for column in observer.run().columns.values()]
        table = pq.read_table(folder / "signals.parquet")
        return [float(column[-1].as_py()) for column in table.columns[1:]]
