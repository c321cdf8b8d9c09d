"""All measurements in one go: `python -m benchmarks [--rounds 5] [--quick] [--out docs/benchmarks]` (or `make bench`)."""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from pathlib import Path

from benchmarks.contenders import Bench, Contender, Milling, Ring
from benchmarks.measure import Point, Say, duel, durations, load, point, starts, temporary, to_stderr, with_results
from benchmarks.report import Measured, write

DOCS = Path(__file__).parent.parent / "docs" / "benchmarks"
FMUS, SIGNALS = (4, 16, 64, 256), (10, 100, 1000, 10_000)
STEPS = (1000, 10_000, 100_000, 1_000_000)
MORE = 3  # times as many rounds on the milling cell: a run there is short, and masters differ by less than the machine does


def scaling(folder: Path, sizes: list[tuple[int, int]], x: int, slice_: float, repeat: int, say: Say) -> list[Point]:
    """Every library on rings of these (FMUs, signals); `x` is which of the two is shown. Who fails or is too slow is not asked for more."""
    points: list[Point] = []
    out: set[tuple[str, str]] = set()
    for size in sizes:
        ring = Ring(folder / f"ring_{size[0]}_{size[1]}", count=size[0], signals=size[1])
        for c, results in with_results(ring.masters()):
            if (c.name, results) not in out:
                say(f"{size[0]} FMUs, {size[1]} signals: {c.name} ({results})")
                points.append(point(c, results, size[x], size[0] * size[1], slice_, repeat, limit=20.0))
                out |= {(c.name, results)} if points[-1].problem else set()
        finish(ring)
    return points


def finish(bench: Bench) -> None:
    """Give back what a system has on disk."""
    bench.close()
    shutil.rmtree(bench.folder, ignore_errors=True)


def measure(folder: Path, rounds: int, quick: bool, say: Say) -> Measured:
    """Everything."""
    began, busy = time.monotonic(), load()
    slice_ = 0.02 if quick else 0.2
    ring = Ring(folder / "ring")
    on_ring = duel(ring.contenders(), rounds, slice_, len(ring.network.outputs), None, say)
    few: list[Contender] = ring.masters()
    python = next(c for c in ring.contenders() if c.name == "robomill, Python loop")
    started = starts([*few, python], 1 if quick else 3, not quick, say)
    lengths = durations(few, STEPS[: 2 if quick else 4], 5.0, say)
    finish(ring)
    fmus = scaling(folder, [(n, 12) for n in FMUS[: 2 if quick else 4]], 0, 2 * slice_, 1 if quick else 3, say)
    signals = scaling(folder, [(4, n) for n in SIGNALS[: 2 if quick else 4]], 1, 2 * slice_, 1 if quick else 3, say)
    runs = rounds if quick else MORE * rounds
    say("building the milling cell")
    milling = Milling(folder / "milling")
    one_by_one = duel(milling.gauss_seidel(), runs, slice_, len(milling.network.outputs), milling.steps, say)
    at_once = duel(milling.jacobi(), runs, slice_, len(milling.network.outputs), milling.steps, say)
    finish(milling)
    return Measured(
        on_ring, ring.calls, one_by_one, at_once, milling.calls, milling.steps, fmus, signals, lengths, started,
        rounds, slice_, time.monotonic() - began, (busy, load()),
    )  # fmt: skip


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="how often the masters take turns (default: 5)")
    parser.add_argument(
        "--out", type=Path, help="folder for the page and its plots (default: docs/benchmarks; with --quick a temporary one)"
    )
    parser.add_argument("--quick", action="store_true", help="everything in short: does it work?")
    options = parser.parse_args()
    out = options.out or (temporary("docs") if options.quick else DOCS)
    folder = temporary("run")
    try:
        write(measure(folder, 1 if options.quick else options.rounds, options.quick, to_stderr), out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(f"written to {out}/masters.md", file=sys.stderr)


if __name__ == "__main__":
    main()
