"""What recording costs on the ring of generic FMUs, like compared with like.

python -m benchmarks.recording [--rounds 9] [--out docs/benchmarks]
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import tempfile
import time
from pathlib import Path

from benchmarks import ring
from benchmarks.contenders import Ring
from benchmarks.runners import Program, Runner

DOCS = Path(__file__).parent.parent / "docs" / "benchmarks"
STEPS = 300_000
KINDS = {"none": 0, "memory": 1, "disk": 2}


def loops(bench: Ring) -> dict[str, Program]:
    """The plain C loop by what it does with results; on disk it writes rows of plain numbers."""
    program = ring.build_loop(bench.folder, bench.signals)
    libraries = [str(shutil.copy(bench.folder / "ring.so", bench.folder / f"ring{k}.so")) for k in range(bench.count)]

    def loop(number: int) -> Program:
        return Program(lambda steps, _: [str(program), str(steps), str(number), *libraries])

    return {kind: loop(number) for kind, number in KINDS.items()}


def main() -> None:
    """Measure in turns and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recording", description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--out", type=Path, default=DOCS)
    options = parser.parse_args()
    found: dict[tuple[str, str], list[float]] = {}
    with tempfile.TemporaryDirectory() as name:
        bench = Ring(Path(name) / "ring")
        os.chdir(name)  # the C loop writes there
        ours = bench.worker("compiled", bench.system, "system")(None)
        masters: list[tuple[str, str, Runner]] = [("plain C loop", kind, program) for kind, program in loops(bench).items()]
        masters += [("robomill, compiled loop", kind, ours) for kind in KINDS]
        for master, kind, runner in masters:
            runner.run(STEPS // 10, kind)
            found[master, kind] = []
        for _ in range(options.rounds):
            for master, kind, runner in masters:
                found[master, kind].append(runner.run(STEPS, kind).cpu / STEPS * 1e9)
        ours.close()
        bench.close()
    lines = [
        "| | results | ns of CPU per step, least | median | x C loop that does the same | x C loop, rows in memory |",
        "|---|---|---|---|---|---|",
    ]
    for (master, kind), times in found.items():
        least = min(times)
        same, memory = (min(found["plain C loop", k]) for k in (kind, "memory"))
        lines.append(f"| {master} | {kind} | {least:.0f} | {statistics.median(times):.0f} | {least / same:.2f} | {least / memory:.2f} |")
    page = PAGE.format(table="\n".join(lines), rounds=options.rounds, steps=STEPS, load=os.getloadavg()[0], date=time.strftime("%Y-%m-%d"))
    (options.out / "recording.md").write_text(page)
    print(page)


PAGE = """# What recording costs

Written by `python -m benchmarks.recording`. {date}; load of the machine {load:.1f} at the end. The ring of four generic FMUs
with 12 inputs and 12 outputs each (48 columns and t: 392 bytes per step), {steps} steps per run, {rounds} rounds in turns; CPU
of all threads.

{table}

The C loop keeps rows in memory whose pages are there before its clock starts, or writes them as plain numbers in pieces of
4096 rows. Ours writes an Arrow stream of columns that others can read meanwhile, in a thread of its own, and checks every output
in every step. Full chunks of real numbers go to the file as they stand, and disk space is reserved ahead (Linux).
The pages of a new file cost both the same: the difference of the C loop's rows. Busy neighbours cost ours more
than the C loop, because a chunk of columns is larger than the second-level cache.
"""

if __name__ == "__main__":
    main()
