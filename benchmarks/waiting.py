"""How long users wait before anything runs, and for many runs: start of commands, setting up, sweeps.

    python -m benchmarks.waiting [--before COMMIT] [--rounds 5] [--runs 1000] [--jobs 2] [--out docs/benchmarks]

writes waiting.md. With `--before`, a commit of this repository is checked out beside and takes turns with the present state, in the same
run. Each measurement is a process of its own, timed from outside: from its start to its end, libraries and all. Byte code is kept, as it
is after an installation.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from benchmarks import ring
from benchmarks.measure import load, to_stderr

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs" / "benchmarks"
LEAST = "import numpy, pyarrow, llvmlite.binding"
"""What a run with results on disk cannot do without: numbers, the file of its signals, what loads compiled code."""
FIRST_STEP = """
import os, sys
from robomill import cli
loaded = cli._function
def load(name):  # the command loads its modules itself, in its own order
    found = loaded(name)
    if name == "run_command.run":
        from robomill.orchestration.loop.master import Master
        Master._loop = lambda *a, **k: os._exit(0)  # initialised: the first step would be next
    return found
cli._function = load
cli.main(["run", "scenarios/groove.toml", "--out", sys.argv[1], "--overwrite"])
"""
SET_UP = """
import os, sys
from pathlib import Path
from benchmarks import ring
from robomill.orchestration.assembly import assemble
from robomill.orchestration.loop.master import Master
system = ring.system(Path(sys.argv[1]), int(sys.argv[2]))
if int(sys.argv[3]):
    a = assemble(system)
    Master(a.slaves, a.wiring, system.step, system.algorithm).initialise(0.0, 1.0)
    sys.stdout.flush()
os._exit(0)
"""
"""The last argument: 1, or 0 for what all processes need before: that is taken off."""
SWEEP = """
import sys
from robomill.sweeping import sweep
if __name__ == "__main__":
    runs, jobs = int(sys.argv[1]), int(sys.argv[2])
    errors = [-0.2 + 0.4 * i / runs for i in range(runs)]
    table = sweep("scenarios/groove.toml", {"variant": ["cartesian"], "milling.cutting_coefficient_error": errors}, jobs=jobs)
    assert len(table) == runs and not table.failed, table.failed[:1]
"""
CLOSE = """
import json, sys, time
from pathlib import Path
from robomill.cell import milling
from robomill.cell.binding import convert, resolve
from robomill.cell.scenario import load_scenario
from robomill.orchestration.assembly import computed
from robomill.orchestration.runs.behind import Behind
folder, runs, rounds = Path(sys.argv[1]), 10, 11
scenario = load_scenario(Path("scenarios/groove.toml"))
job = milling.prepare(scenario, folder / "job", None, None, overwrite=True)
system = milling.of_variant(job, scenario.variants[0])
def start(k):
    return computed(system, folder / str(k), stop=job.steps * system.step, resolver=resolve, convert=convert, overwrite=True)
def one_after_the_other():
    for k in range(runs):
        start(k)()
def behind_the_next():
    before = Behind(start(0))
    for k in range(1, runs):
        now = Behind(start(k))
        before.run()
        before = now
    before.run()
found = {one_after_the_other: [], behind_the_next: []}
for _ in range(rounds):
    for way, times in found.items():
        wall, cpu = time.perf_counter(), time.process_time()
        way()
        times.append(((time.perf_counter() - wall) / runs, (time.process_time() - cpu) / runs))
complete, closing = start("last"), time.process_time()
complete()
closing = time.process_time() - closing
medians = {way.__name__: [sorted(t)[rounds // 2] for t in zip(*times[1:])] for way, times in found.items()}
Path(sys.argv[2]).write_text(json.dumps({**medians, "closing": closing}))
"""
"""Runs of one variant with results on disk, closed one after the other and behind the next: seconds of a run (wall, CPU), medians."""


@dataclass
class Times:
    """Seconds of a process, one per round."""

    wall: list[float]
    cpu: list[float]

    def row(self, base: float = 0.0) -> str:
        """Cells of the table; `base`: CPU that is taken off, and wall with it as a bound from above."""
        cpu = [max(c - base, 0.0) for c in self.cpu]
        return f"{statistics.median(cpu):.3f} | {min(cpu):.3f} .. {max(cpu):.3f} | {statistics.median(self.wall):.3f}"


def timed(command: Sequence[str], checkout: Path, folder: Path) -> tuple[float, float, float]:
    """Wall and CPU time [s] of a process and its children, from its start to its end, and the most memory of one of them [MB].

    Byte code is kept in `folder`. CalledProcessError if it fails.
    """
    kept = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
    environment = {**os.environ, **kept, "PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # as users have it: to compile all sources anew takes a fifth of a second
    with tempfile.TemporaryFile("w+") as said:
        began = time.monotonic()
        process = subprocess.Popen([sys.executable, *command], cwd=checkout, env=environment, stdout=subprocess.DEVNULL, stderr=said)
        _, status, used = os.wait4(process.pid, 0)
        wall = time.monotonic() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            raise subprocess.CalledProcessError(process.returncode, command, stderr=said.read()[-2000:])
    return wall, used.ru_utime + used.ru_stime, used.ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


def measure(checkouts: Mapping[str, Path], rounds: int, folder: Path) -> dict[str, dict[str, Times]]:
    """What -> checkout -> times. All in turn, round by round; the first round fills caches and is not counted."""
    many, wide = folder / "many", folder / "wide"
    for place, signals in ((many, 12), (wide, 10_000)):
        place.mkdir()
        ring.build(place, signals)
    commands: dict[str, list[str]] = {
        "`robomill --help`": ["-m", "robomill", "--help"],
        "Python with NumPy, Arrow and the loader of LLVM alone": ["-c", LEAST],
        "`robomill run scenarios/groove.toml`, to the first step": ["-c", FIRST_STEP, str(folder / "run")],
        "libraries for the next two": ["-c", SET_UP, str(many / "ring.fmu"), "1", "0"],
        "setting up 256 FMUs of 12 signals": ["-c", SET_UP, str(many / "ring.fmu"), "256", "1"],
        "setting up 4 FMUs of 10 000 signals": ["-c", SET_UP, str(wide / "ring.fmu"), "4", "1"],
    }
    found = {what: {name: Times([], []) for name in checkouts} for what in commands}
    for k in range(rounds + 1):
        to_stderr(f"round {k} of {rounds}")
        for what, command in commands.items():
            for name, checkout in checkouts.items():
                wall, cpu, _ = timed(command, checkout, folder)
                if k:
                    found[what][name].wall.append(wall)
                    found[what][name].cpu.append(cpu)
    return found


@contextmanager
def checked_out(commit: str, folder: Path) -> Iterator[Path]:
    """A commit of this repository in a folder of its own; or a folder that is a checkout already."""
    if Path(commit).is_dir():
        yield Path(commit).resolve()
        return
    place = folder / "before"
    subprocess.run(["git", "worktree", "add", "--quiet", "--detach", str(place), commit], cwd=ROOT, check=True)
    try:
        yield place
    finally:
        subprocess.run(["git", "worktree", "remove", "--force", str(place)], cwd=ROOT, check=True)


def page(
    found: Mapping[str, Mapping[str, Times]],
    sweep: tuple[int, int, float, float, float],
    closing: Mapping[str, Any],
    busy: tuple[float, float],
) -> str:
    """The page as Markdown."""
    rounds = len(next(iter(next(iter(found.values())).values())).cpu)
    lines = [
        "# What users wait for",
        "",
        f"Written by `python -m benchmarks.waiting`. {date.today()}; load of the machine {busy[0]:.1f} to {busy[1]:.1f}, so CPU time is",
        f"the figure to trust. Each row is a process of its own, timed from its start to its end, {rounds} rounds in turn. Caches are",
        "warm, byte code is kept.",
        "The time of the libraries is taken off the CPU of setting up, not off its wall time. *Wall* is what passed on this machine.",
        "",
        "| | | CPU s, median | least .. most | wall s |",
        "|---|---|---|---|---|",
    ]
    libraries = found["libraries for the next two"]
    for what, by_checkout in found.items():
        for name, times in by_checkout.items():
            base = statistics.median(libraries[name].cpu) if what.startswith("setting up") else 0.0
            lines.append(f"| {what} | {name} | {times.row(base)} |")
    runs, jobs, wall, cpu, memory = sweep
    ways = {"before the next is begun": "one_after_the_other", "behind the next": "behind_the_next"}
    lines += [
        "",
        "## A sweep",
        "",
        f"{runs} runs of the groove (7.3 s of machining, 1837 steps each) with summaries only, "
        f"{jobs} {'process' if jobs == 1 else 'processes'}, from the command to the table, planning included:",
        f"{cpu:.1f} s of CPU ({1e3 * cpu / runs:.1f} ms per run, {cpu / jobs:.1f} s for each process), {wall:.1f} s of wall clock. "
        f"No process took more than {memory:.0f} MB. See [sweeps](../how_to/sweep.md).",
        "",
        "## The end of a run on disk",
        "",
        "The groove ten times, results on disk. The variants of a scenario are run in the second way.",
        "",
        "| a run is completed | wall ms per run | CPU ms per run |",
        "|---|---|---|",
        *(f"| {way} | {1e3 * closing[key][0]:.1f} | {1e3 * closing[key][1]:.1f} |" for way, key in ways.items()),
        "",
        f"{1e3 * closing['closing']:.1f} ms of CPU turn the stream of its 101 columns into a Parquet file.",
        "",
        "## What stays",
        "",
        "- The first step: no run is without NumPy and the loader of LLVM; Arrow comes with the first rows. What is left are the modules",
        "  of robomill (half of that is the making of dataclasses), the plan, and one system for each variant.",
        "- A run of a sweep: all but about a millisecond of it is spent in the compiled models, whose numbers may not change.",
        "- The end of a run: behind the next it still takes its CPU, so a sweep that keeps all cores busy gains nothing by it.",
        "  Without compression the file takes only a third less: most of it goes by the number of columns.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.waiting", description=__doc__)
    parser.add_argument("--before", metavar="COMMIT", help="also measure this commit (or the checkout in this folder), in turn")
    parser.add_argument("--rounds", type=int, default=5, help="how often all take turns (default: 5)")
    parser.add_argument("--runs", type=int, default=1000, help="runs of the sweep (default: 1000)")
    parser.add_argument("--jobs", type=int, default=2, help="processes of the sweep (default: 2)")
    parser.add_argument("--out", type=Path, default=DOCS, help="folder for the page (default: docs/benchmarks)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="robomill_bench_") as name:
        folder, busy = Path(name), load()
        if options.before:
            with checked_out(options.before, folder) as before:
                found = measure({"before": before, "now": ROOT}, options.rounds, folder)
        else:
            found = measure({"now": ROOT}, options.rounds, folder)
        to_stderr("sweep")
        script = folder / "sweep.py"  # a file: processes of a pool import it
        script.write_text(SWEEP, encoding="utf-8")
        swept = timed([str(script), str(options.runs), str(options.jobs)], ROOT, folder)
        to_stderr("the end of a run")
        timed(["-c", CLOSE, str(folder / "closed"), str(folder / "closed.json")], ROOT, folder)
        closing = json.loads((folder / "closed.json").read_text(encoding="utf-8"))
        text = page(found, (options.runs, options.jobs, *swept), closing, (busy, load()))
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "waiting.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
