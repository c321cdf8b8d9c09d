"""Where a step of the milling cell goes: the calls of each component and the master, counted in clock ticks; and an hour of it.

    python -m benchmarks.profile [--fmus FOLDER] [--rounds 20] [--out docs/benchmarks]

writes profile.md. FOLDER holds native FMUs; without it they are built.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import types

from benchmarks.answer import clocks, peak_memory
from robomill.cell.binding import convert, resolve, with_fmus
from robomill.cell.milling import prepare
from robomill.cell.scenario import load_scenario
from robomill.orchestration.assembly import assemble
from robomill.orchestration.errors import ResultsError
from robomill.orchestration.loop import loop_code, operations
from robomill.orchestration.loop.compiled import OPTIONS, begin, finish, intrinsic, njit, operate
from robomill.orchestration.loop.master import Master
from robomill.orchestration.loop.operations import DONE, FAILED, LIMIT, TICK
from robomill.orchestration.runs.memory import Memory
from robomill.orchestration.runs.recorder import Recorder
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs" / "benchmarks"
HOUR = 3600.0  # s
PHASES = {operations.STEP: "step", **dict.fromkeys((operations.SET, 3, 4), "inputs"), **dict.fromkeys((operations.GET, 6, 7), "outputs")}


@intrinsic
def _ticks(context: Any) -> Any:
    """The clock of the processor."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(64), [])
        return builder.call(builder.module.declare_intrinsic("llvm.readcyclecounter", (), kind), [])

    return types.int64(), generate


@njit(nogil=True, **OPTIONS)
def _timed(
    steps: int, ticks: Any, rates: bool, ops: Any, clocks: Any, places: Any, bus: Any, low: Any, high: Any, columns: Any, report: Any,
    called: Any, spent: Any,
) -> int:  # fmt: skip
    """As `compiled.advance` for a system without rates; `spent` keeps the least that each operation of each step took [clock ticks]."""
    n, h = len(low), ticks[1] / TICK
    for k in range(steps):
        row = spent[ticks[2] + k]
        before = _ticks()
        now = ticks[0] + (ticks[2] + k) * ticks[1]
        for i in range(n):
            bus[n + i] = bus[i]
        begin(rates, clocks, now)
        for o in range(len(ops)):
            status = operate(ops, o, rates, clocks, bus, n, places, called, now / TICK, h)
            after = _ticks()
            row[o] = min(row[o], after - before)
            before = after
            if status < 0 or status > ops[o, LIMIT]:
                report[0], report[1], report[2] = FAILED, o, status
                return k
        finish(rates, clocks, now + ticks[1], k, bus, low, high, columns)
        row[len(ops)] = min(row[len(ops)], _ticks() - before)
    report[0] = DONE
    return steps


@dataclass
class Profile:
    """Least times over all rounds [us], of every operation in every step that compiled code made."""

    spent: npt.NDArray[np.float64]
    """Steps x (operations and, last, the master's own)."""
    components: list[str]
    """By operation."""
    phases: list[str]
    """By operation: inputs, step or outputs."""
    cutting: npt.NDArray[np.bool_]
    """By step: whether the tool is in the workpiece."""


def profile(system: System, steps: int, rounds: int) -> Profile:
    """Run `system` so often and time every call. The counter itself takes some 10 ns per call."""
    spent = np.full((steps, 64), np.iinfo(np.int64).max)
    tables: list[Any] = []

    def advance(most: int, ticks: Any, rates: bool, delayed: bool, watched: int, ops: Any, *others: Any) -> int:
        tables[:] = [ops]
        return int(_timed(most, ticks, rates, ops, *others, spent))

    began, counted = time.perf_counter(), _now()
    with assemble(system, resolve, convert) as a, patch.object(loop_code, "advance", advance):
        for _ in range(rounds):
            memory = Memory()
            Master(a.slaves, a.wiring, system.step, system.algorithm, [memory], loop="compiled").run(steps * system.step)
        names, order = [], a.wiring.order
    rate = (_now() - counted) / (time.perf_counter() - began) * 1e-6  # ticks per us
    (ops,) = tables
    names = [order[c] for c in ops[:, operations.COMPONENT]]
    phases = _phases(ops)
    force = memory.run()["milling.f_T_B"]
    made = slice(1, steps)  # the first step is made in Python
    return Profile(spent[made, : len(ops) + 1] / rate, names, phases, np.any(force[1:][made] != 0.0, axis=1))


@njit(**OPTIONS)
def _now() -> int:
    return int(_ticks())


def _phases(ops: Any) -> list[str]:
    """A call that reads or writes the bus itself is one for inputs before the step of its component, one for outputs after it."""
    found, stepped = [], set()
    for o in ops:
        component, what = int(o[operations.COMPONENT]), int(o[operations.OPERATION])
        if what == operations.STEP:
            stepped.add(component)
        found.append(PHASES.get(what, "outputs" if component in stepped else "inputs"))
    return found


def whole_run(system: System, steps: int, rounds: int, record: bool) -> float:
    """Microseconds of CPU per step, all threads: the least of so many runs; completing the results is not in it."""
    found = []
    marks: list[tuple[int, float]]
    with assemble(system, resolve, convert) as a:
        for _ in range(rounds):
            with tempfile.TemporaryDirectory() as folder:
                observers = [Recorder(Path(folder) / "run")] if record else []
                marks = []
                master = Master(a.slaves, a.wiring, system.step, system.algorithm, observers, loop="compiled")
                master.run(steps * system.step, progress=lambda k, n: marks.append((k, clocks()[1])))  # noqa: B023 (called in here)
            found.append((marks[-1][1] - marks[0][1]) / (marks[-1][0] - marks[0][0]) * 1e6)
    return min(found)


def table(p: Profile, without: float, with_results: float) -> str:
    """Means over all steps, component by component; what is left of the CPU time is Python's, once per chunk, and the recorder's."""
    lines = [
        "| | inputs | step | outputs | together | share | step, in the cut | step, in the air | longest step |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    mean = p.spent.mean(axis=0)
    for name in dict.fromkeys(p.components):
        own = {
            phase: [i for i, c in enumerate(p.components) if (c, p.phases[i]) == (name, phase)] for phase in ("inputs", "step", "outputs")
        }
        parts = [mean[places].sum() for places in own.values()]
        (o,) = own["step"]
        each = p.spent[:, o]
        figures = [*parts, sum(parts)]
        lines.append(
            f"| {name} | " + " | ".join(f"{f:.2f}" for f in figures) + f" | {sum(parts) / with_results:.0%} "
            f"| {each[p.cutting].mean():.2f} | {each[~p.cutting].mean():.2f} | {each.max():.1f} |"
        )
    counted = mean.sum()
    for what, value in (
        ("guards, bus, rows", mean[-1]),
        ("Python between chunks", without - counted),
        ("recording to disk", with_results - without),
        ("**all**", with_results),
    ):
        lines.append(f"| {what} | | | | {value:.2f} | {value / with_results:.0%} | | | |")
    return "\n".join(lines)


def hour(system: System, folder: Path) -> str:
    """An hour of simulated time in a process of its own, read by this one while it is written; sentences."""
    began, said = time.monotonic(), []
    command = [sys.executable, "-m", "benchmarks.profile", "--hour", str(folder)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        while process.poll() is None:
            time.sleep(3.0)
            try:
                read = Run.load(folder / "run")
            except ResultsError:
                continue
            if read.outcome == "running" and len(read) > 1:
                said.append(f"after {time.monotonic() - began:.0f} s {len(read)} rows up to t = {read.t[-1]:.0f} s")
        assert process.stdout is not None
        figures = process.stdout.read().split()
    wall, cpu, closing, memory, size = map(float, figures)
    rows = len(Run.load(folder / "run"))
    return (
        f"{rows - 1} steps in {wall:.0f} s of wall clock ({cpu:.0f} s of CPU), and {closing:.0f} s to complete the Parquet file "
        f"({size:.0f} MB). Peak memory of the process: {memory:.0f} MB. Read by another process meanwhile: {'; '.join(said[:4])}."
    )


def run_hour(folder: Path) -> None:
    """The process that makes the hour: seconds of wall clock and CPU, closing [s], peak memory [MB], size of the file [MB]."""
    system = _cell(folder, folder / "fmus")[0]
    with assemble(system, resolve, convert) as a:
        master = Master(a.slaves, a.wiring, system.step, system.algorithm, [Recorder(folder / "run")], loop="compiled")
        marks: list[tuple[float, float]] = []
        master.run(HOUR, progress=lambda k, n: marks.append(clocks()))
    size = (folder / "run" / "signals.parquet").stat().st_size
    print(*(b - a for a, b in zip(marks[0], marks[-1], strict=True)), clocks()[0] - marks[-1][0], peak_memory(), size / 1e6)


def _cell(folder: Path, fmus: Path) -> tuple[System, int]:
    """The groove of `scenarios/groove.toml`: planned, with native FMUs; and its number of steps."""
    job = prepare(load_scenario(ROOT / "scenarios" / "groove.toml"), folder / "groove")
    return replace(with_fmus(job.system, fmus), stop_when=None), job.steps


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.profile", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--fmus", type=Path, help="folder with native FMUs (default: they are built)")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--out", type=Path, default=DOCS)
    parser.add_argument("--hour", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.hour is not None:
        run_hour(options.hour)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.fmus is None:
            build = [str(Path(sys.executable).parent / "robomill"), "build", "--backend", "native", "--out", str(folder / "fmus")]
            subprocess.run(build, check=True, capture_output=True)
        else:
            (folder / "fmus").symlink_to(options.fmus.resolve())
        system, steps = _cell(folder, folder / "fmus")
        found = profile(system, steps, options.rounds)
        without, with_results = (whole_run(system, steps, options.rounds, record) for record in (False, True))
        text = PAGE.format(
            date=time.strftime("%Y-%m-%d"), steps=steps, rounds=options.rounds, load=os.getloadavg()[0],
            table=table(found, without, with_results), factor=system.step * 1e6 / with_results, without=system.step * 1e6 / without,
            cutting=found.cutting.mean(), hour=hour(system, folder),
        )  # fmt: skip
    (options.out / "profile.md").write_text(text)
    print(text)


PAGE = """# Where a step of the milling cell goes

Written by `python -m benchmarks.profile`. {date}; load of the machine {load:.1f}. Six native FMUs, the groove of
`scenarios/groove.toml` from beginning to end ({steps} steps of 4 ms, the tool in the workpiece in {cutting:.0%} of them), the
compiled loop. Microseconds per step.

{table}

Calls are timed by the clock of the processor, in the compiled loop itself: of every call in every step the least of {rounds}
runs, which all compute the same; then the mean over the steps. The whole is CPU time of all threads, the least of {rounds} runs,
without completing the results at the end; what the calls leave of it is Python's, between chunks of steps.

With results on disk that is {factor:.0f} times real time on one core ({without:.0f} without results).

## An hour

The same cell for 3600 s of simulated time (the tool rests where the program ends), all outputs recorded: {hour}
"""

if __name__ == "__main__":
    main()
