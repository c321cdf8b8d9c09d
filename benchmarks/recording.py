"""What recording costs on the ring of generic FMUs, like compared with like.

python -m benchmarks.recording [--rounds 15] [--out docs/benchmarks]
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.answer import Answer
from benchmarks.contenders import Ring
from benchmarks.runners import Runner

DOCS = Path(__file__).parent.parent / "docs" / "benchmarks"
STEPS = 300_000
KINDS = {"none": 0, "memory": 1, "memory as it fills": 3, "disk": 2}
"""Kinds of recording of the C loop, and the number that it is told."""
OURS = {"none": "none", "memory": "memory as it fills", "disk": "disk"}
"""Kinds of recording of ours, and which C loop does the same."""


def ratio(answers: Sequence[Answer], others: Sequence[Answer]) -> str:
    """CPU time relative to the others': of the medians, and in brackets of the least."""
    median, least = (f(a.cpu for a in answers) / f(b.cpu for b in others) for f in (statistics.median, min))
    return f"{median:.2f} ({least:.2f})"


def main() -> None:
    """Measure in turns and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recording", description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--out", type=Path, default=DOCS)
    options = parser.parse_args()
    found: dict[tuple[str, str], list[Answer]] = {}
    with tempfile.TemporaryDirectory() as name:
        bench = Ring(Path(name) / "ring")
        os.chdir(name)  # the C loop writes there
        ours = bench.worker("compiled", bench.system, "system")(None)
        # which of its ways the C loop takes is in its command
        masters: list[tuple[str, str, Runner, str]] = [("plain C loop", kind, bench.loop(kept), "memory") for kind, kept in KINDS.items()]
        masters += [("robomill, compiled loop", kind, ours, kind) for kind in OURS]
        for master, kind, runner, results in masters:
            runner.run(STEPS // 10, results)
            found[master, kind] = []
        for _ in range(options.rounds):
            for master, kind, runner, results in masters:
                found[master, kind].append(runner.run(STEPS, results))
        ours.close()
        bench.close()
    lines = [
        "| | results | CPU per step, median | least .. most | wall clock, median | x C loop doing the same | x C loop, rows in memory |",
        "|---|---|---|---|---|---|---|",
    ]
    for (master, kind), answers in found.items():
        cpu, wall = ([getattr(answer, clock) / STEPS * 1e9 for answer in answers] for clock in ("cpu", "wall"))
        alike = kind if master == "plain C loop" else OURS[kind]
        same, memory = (ratio(answers, found["plain C loop", k]) for k in (alike, "memory"))
        spread = f"{statistics.median(cpu):.0f} | {min(cpu):.0f} .. {max(cpu):.0f} | {statistics.median(wall):.0f}"
        lines.append(f"| {master} | {kind} | {spread} | {same} | {memory} |")
    page = PAGE.format(table="\n".join(lines), rounds=options.rounds, steps=STEPS, load=os.getloadavg()[0], date=time.strftime("%Y-%m-%d"))
    (options.out / "recording.md").write_text(page)
    print(page)


PAGE = """# What recording costs

Written by `python -m benchmarks.recording`. {date}; load of the machine {load:.1f} at the end. The ring of four generic FMUs
with 12 inputs and 12 outputs each (48 columns and t: 392 bytes per step), {steps} steps per run, {rounds} rounds in turns;
nanoseconds. CPU is that of all threads; ratios are of its medians, in brackets of the least.

{table}

The C loop keeps rows in memory whose pages are there before its clock starts, or in memory that it takes as it fills, as
ours does, or writes them as plain numbers in pieces of 4096 rows. Ours writes an Arrow stream of columns that others can read
meanwhile, between two chunks of steps, and checks every output in every step. Full chunks of real numbers go to the file as
they stand, disk space is reserved ahead (Linux), and numbers begin with a line of the cache in memory and in the file:
otherwise the kernel takes up to three times as long to copy them. The pages of a new file, and of new memory, cost both the same.
"""

if __name__ == "__main__":
    main()
