"""Microseconds per macro step of masters, side by side on the same FMUs: a table and a picture in docs/benchmarks/.

    python -m benchmarks.masters [--rounds 7] [--quick]

Libraries of others are optional (`pip install --target .venv/peers libcosimpy ecospy tbb`); who is not there is left out, with the reason.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import peers, ring
from benchmarks.milling import Cell, Milling
from orchestration.assembly import assemble
from orchestration.master import Master
from orchestration.memory import Memory
from orchestration.recorder import Recorder

ROOT = Path(__file__).parent.parent
PEERS = ROOT / ".venv" / "peers"
DOCS = ROOT / "docs" / "benchmarks"
SLICE = 0.25  # s of wall clock per measurement, about
FMUS, SIGNALS = 4, 12


class Ours:
    """Our master on the ring. Starts once; each measurement is a run of its own from t = 0."""

    def __init__(self, file: Path, count: int, record: bool | str, loop: str) -> None:
        self.assembly = assemble(ring.system(file, count))
        self.loop, self.record = loop, record
        self.closing = 0.0

    def run(self, steps: int) -> tuple[float, float]:
        """Wall clock and CPU [s] from the first step in the loop (after compiled code has been loaded) to the last, writing included.

        What `end` does (turning the stream into Parquet) is measured apart.
        """
        a, s = self.assembly, self.assembly.system
        with tempfile.TemporaryDirectory() as folder:
            observers: list[Any] = [Memory()] if self.record == "memory" else [Recorder(Path(folder) / "run")] if self.record else []
            marks: list[tuple[int, tuple[float, float]]] = []
            master = Master(a.slaves, a.wiring, s.step, s.algorithm, observers, loop=self.loop)
            warm = 100
            # the first steps: entering the loop, growing chunks
            master.run((steps + warm) * s.step, progress=lambda k, n: marks.append((k, peers.clocks())))
            ended = time.perf_counter()
        first = next(m for m in marks if m[0] >= warm)
        self.closing = (ended - marks[-1][1][0]) / steps
        self.final = master.outputs.copy()
        return peers.between(first, marks[-1], steps)

    def outputs(self) -> Any:
        """All outputs after the last run."""
        return self.final


@dataclass
class Row:
    """One line of the table."""

    name: str
    record: bool
    make: Callable[[], Any]
    note: str = ""
    steps: int = 0
    times: list[float] = field(default_factory=list)
    """Microseconds per macro step, one per round."""
    cpu: list[float] = field(default_factory=list)
    """The same, of CPU."""
    master: Any = None

    @property
    def median(self) -> float:
        """Median [us]."""
        return statistics.median(self.times)

    @property
    def cpu_median(self) -> float:
        """Median [us of CPU]."""
        return statistics.median(self.cpu)


def rows(fmu: Path, library: Path, loop: Path, count: int) -> list[Row]:
    """All masters to be measured, with and without results."""
    made: list[Row] = []
    made.append(
        Row("robomill, compiled loop, to memory", True, lambda: Ours(fmu, count, "memory", "compiled"), "guards on, rows to memory")
    )
    for record in (False, True):
        made += [
            Row("plain C loop", record, lambda r=record: peers.CLoop(loop, library, count, r), "rows to memory" if record else ""),
            Row(
                "robomill, compiled loop", record, lambda r=record: Ours(fmu, count, r, "compiled"),
                "guards on" + (", Arrow stream on disk" if record else ""),
            ),
            Row(
                "robomill, Python loop", record, lambda r=record: Ours(fmu, count, r, "python"),
                "guards on" + (", Arrow stream on disk" if record else ""),
            ),
            Row("FMPy, lists", record, lambda r=record: peers.FmpyLoop(fmu, count, r), "rows to memory" if record else ""),
            Row("libcosim (libcosimpy)", record, lambda r=record: peers.Cosim(fmu, count, r), "CSV files" if record else "last values"),
            Row("Ecos (ecospy)", record, lambda r=record: peers.Ecos(fmu, count, r), "CSV file" if record else ""),
        ]  # fmt: skip
    return made


def milling_rows(cell: Cell) -> list[Row]:
    """The milling system: whole runs of the groove."""
    made: list[Row] = []
    for record in (False, True):
        made.append(Row("plain C loop", record, lambda r=record: cell.c_loop(r), "rows to memory" if record else "", cell.steps))
        for kind, system in (("native FMUs", cell.native), ("in process", cell.in_process)):
            for loop in ("compiled", "python"):
                name = f"robomill, {kind}, {loop} loop"
                made.append(Row(name, record, lambda r=record, s=system, x=loop: Milling(s, r, x), "guards on", cell.steps))
    return made


def measure(candidates: list[Row], rounds: int, slice_: float) -> list[str]:
    """Fill the times of all rows, one measurement of each in turn per round; returns why rows were left out."""
    missing = []
    for row in list(candidates):
        try:
            row.master = row.make()
            if row.steps:  # whole runs
                row.master.run(row.steps)
                continue
            row.steps = 200
            while (took := row.master.run(row.steps)[0]) < slice_ / 4:  # also warms up
                row.steps = int(row.steps * min(10.0, 1.5 * slice_ / max(took, 1e-6)))
            row.steps = max(int(row.steps * slice_ / took), 100)
        except Exception as error:
            missing.append(f"{row.name}{' with results' if row.record else ''}: {type(error).__name__}: {str(error).splitlines()[0][:120]}")
            candidates.remove(row)
    for k in range(rounds):
        for row in candidates:
            wall, cpu = row.master.run(row.steps)
            row.times.append(wall / row.steps * 1e6)
            row.cpu.append(cpu / row.steps * 1e6)
        print(f"round {k + 1} of {rounds}", file=sys.stderr)
    return missing


def same_numbers(fmu: Path, library: Path, loop: Path, count: int) -> list[str]:
    """That everybody computes the same: the largest difference of the outputs after 250 steps, as sentences."""
    reference = Ours(fmu, count, False, "python")
    reference.run(250 - 100)
    expected = reference.outputs()
    said = []
    for name, make in (
        ("compiled loop", lambda: Ours(fmu, count, False, "compiled")),
        ("FMPy", lambda: peers.FmpyLoop(fmu, count, False)),
        ("libcosim", lambda: peers.Cosim(fmu, count, False)),
        ("Ecos", lambda: peers.Ecos(fmu, count, False)),
    ):
        try:
            other = make()
            other.run(250 - 100 if isinstance(other, Ours) else 250)
            difference = float(np.max(np.abs(other.outputs() - expected)))
            said.append(f"{name} {difference:.2g}")
        except Exception:  # said elsewhere: it is not installed
            continue
    c = peers.CLoop(loop, library, count, False)
    c.run(250)
    said.append(f"C loop {abs(c.sum - float(np.sum(expected))):.2g} in the sum of all outputs")
    return said


def table(candidates: list[Row]) -> str:
    """The table in Markdown; each is compared with the C loop that does the same about results."""
    base = {r.record: r for r in candidates if r.name == "plain C loop"}
    lines = [
        "| master | results | us per macro step, median | least .. most | x C loop | us of CPU, median | x C loop, CPU | |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in sorted(candidates, key=lambda r: (r.record, r.cpu_median)):
        c = base[r.record]
        lines.append(
            f"| {r.name} | {'yes' if r.record else 'no'} | {r.median:.3g} | {min(r.times):.3g} .. {max(r.times):.3g} "
            f"| {r.median / c.median:.3g} | {r.cpu_median:.3g} | {r.cpu_median / c.cpu_median:.3g} | {r.note} |"
        )
    return "\n".join(lines)


def picture(candidates: list[Row], file: Path) -> None:
    """Bars on a logarithmic axis."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(r.name for r in sorted(candidates, key=lambda r: r.median)))
    figure, axes = plt.subplots(figsize=(8.0, 0.6 * len(names) + 1.2), layout="constrained")
    for record, colour, shift in ((False, "#9db4c8", 0.2), (True, "#1f4e79", -0.2)):
        for r in (r for r in candidates if r.record == record):
            y = len(names) - names.index(r.name) + shift
            spread = [[r.median - min(r.times)], [max(r.times) - r.median]]
            axes.barh(
                y, r.median, 0.36, color=colour, xerr=spread, error_kw={"lw": 1}, label="with results" if record else "without results"
            )
            axes.text(max(r.times) * 1.08, y, f"{r.median:.3g}", va="center", fontsize=8)
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(unique.values(), unique.keys(), loc="upper right", frameon=False)
    axes.set(xscale="log", xlabel="microseconds per macro step (4 FMUs, 12 inputs and 12 outputs each)")
    axes.set_yticks([len(names) - i for i in range(len(names))], names)
    axes.set_xlim(right=max(max(r.times) for r in candidates) * 2)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=130)


def machine() -> str:
    """What it ran on."""
    info = Path("/proc/cpuinfo")
    names = (
        [line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")] if info.exists() else []
    )
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    cpu = names[0] if names else platform.processor()
    return f"{cpu}, {os.cpu_count()} cores, load {load:.1f} at the end, Python {platform.python_version()}"


def main() -> None:
    """Measure, write masters.md and masters.png."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="short measurements, written to a temporary folder: does it all work?")
    options = parser.parse_args()
    sys.path.insert(0, str(PEERS))
    docs = Path(tempfile.mkdtemp()) if options.quick else DOCS
    docs.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp())
    try:
        fmu, loop = ring.build(folder, SIGNALS), ring.build_loop(folder, SIGNALS)
        library = folder / "ring.so"
        agreement = same_numbers(fmu, library, loop, FMUS)
        candidates = rows(fmu, library, loop, FMUS)
        rounds = 2 if options.quick else options.rounds
        missing = measure(candidates, rounds, 0.02 if options.quick else SLICE)
        cell = Cell(folder)
        milling = milling_rows(cell)
        missing += measure(milling, rounds, SLICE)
        equal = all(np.array_equal(r.master.final, milling[0].master.final) for r in milling)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    closing = next(r.master.closing * 1e6 for r in candidates if r.record and r.name == "robomill, compiled loop")
    picture(candidates, docs / "masters.png")
    left_out = "".join(f"\nLeft out: {m}." for m in missing)
    page = PAGE.format(
        table=table(candidates),
        milling=table(milling),
        steps=cell.steps,
        equal="the same bits" if equal else "NOT the same bits",
        rounds=rounds,
        slice=SLICE,
        machine=machine(),
        closing=closing,
        agreement="; ".join(agreement),
        missing=left_out,
        date=time.strftime("%Y-%m-%d"),
    )
    (docs / "masters.md").write_text(page)
    print(table(candidates), table(milling), *missing, f"written to {docs}", sep="\n")


PAGE = """# Masters, side by side

A ring of four generic FMI 2.0 FMUs (C, `benchmarks/ring.c`), 12 real inputs and 12 real outputs each, every one fed by
its neighbour, Jacobi, steps of 4 ms. The FMUs compute next to nothing: what is measured is the master. Written by
`python -m benchmarks.masters`.

{table}

![microseconds per macro step](masters.png)

Measured in {rounds} rounds, in each of them one measurement of about {slice} s of every master in turn, on
{machine}; {date}.

- CPU is that of all threads; where other work was on the machine it says more than the wall clock, and where less than the
  wall clock was measured, the difference is waiting. Our recorder writes in a thread of its own.
- The C loop (`benchmarks/loop.c`) is compiled on the spot with -O2; it checks statuses and nothing else. With results
  it keeps the rows in memory.
- Ours checks every output in every step (NaN, infinity, range), looks at Ctrl-C, and with results streams all 48 outputs
  to disk (Arrow), readable while it runs. Turning the stream into `signals.parquet` at the end is not in the table:
  {closing:.2g} us per step in the compiled run.
- libcosim and Ecos write CSV text, FMPy users collect lists: the rows with results compare what users get, not the same work.
- Same numbers: largest difference of any output from our Python loop after 250 steps: {agreement}.
  (A master whose first step sees the initial outputs one exchange earlier or later differs by about a step's change.)
{missing}

## The milling cell

Six components in Gauss-Seidel order with delayed connections, the groove of `scenarios/groove.toml` from beginning to end
({steps} steps of 4 ms; real time is 4000 us per step). The C loop is generated from the wiring of the same system
(`benchmarks/system_loop.py`) and makes the same calls. At the end all of them have {equal} in all outputs.

{milling}
"""

if __name__ == "__main__":
    main()
