"""What one of the hundreds of simulations of a diagnosis costs: a system that is opened anew for each, and one that stays open.

    python -m benchmarks.simulations [--rounds 20] [--out docs/benchmarks]

writes simulations.md.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from benchmarks.answer import clocks
from benchmarks.measure import load
from robomill.cell.binding import convert, resolve
from robomill.cell.milling import prepare
from robomill.cell.scenario import load_scenario
from robomill.orchestration.assembly import run
from robomill.orchestration.rig import Changes, Rig
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs" / "benchmarks"
CHANGES: tuple[Changes, ...] = (
    {"compliance": {"stiffness_error[2]": -0.1}},
    {"drive": {"backlash[1]": 5e-5}, "sensor": {"seed": 2.0}},
    {"milling": {"tool_wear": 0.3}},
)
"""Effects as the diagnosis switches them on: in turn."""
KEPT = ("compliance.d_T_B", "drive.torque_motor", "sensor.f_T_T", "milling.f_T_B")
"""Outputs that count as measured."""


@dataclass(frozen=True)
class Costs:
    """Milliseconds of CPU per simulation, one per round."""

    steps: int
    anew: list[float]
    """Everything is opened for each simulation."""
    open: list[float]
    """The system stays open."""


def measure(system: System, stop: float, rounds: int) -> Costs:
    """Both ways in turn, so that both meet the same machine. ValueError if they do not give the same bits."""
    columns = [name for name in run(system, None, stop=2 * system.step, resolver=resolve, convert=convert).columns if name.startswith(KEPT)]
    rig = Rig(system, resolve, convert, columns)

    def anew(changes: Changes) -> Run:
        changed = system
        for component, values in changes.items():
            changed = changed.with_parameters(component, values)
        return run(changed, None, stop=stop, resolver=resolve, convert=convert)

    found: tuple[list[float], list[float]] = ([], [])
    steps = 0
    for k in range(rounds + 1):
        changes = CHANGES[k % len(CHANGES)]
        (one, first), (other, second) = (_timed(way, changes) for way in (anew, lambda c: rig.run(c, stop)))
        if any(one.columns[name].tobytes() != other.columns[name].tobytes() for name in columns):
            raise ValueError(f"the system that stays open gives other numbers with {dict(changes)}")
        steps = len(one.t) - 1
        if k:  # the first round compiles
            found[0].append(first)
            found[1].append(second)
    return Costs(steps, *found)


def _timed(way: Callable[[Changes], Run], changes: Changes) -> tuple[Run, float]:
    began = clocks()[1]
    result = way(changes)
    return result, 1e3 * (clocks()[1] - began)


def page(costs: Costs, busy: tuple[float, float]) -> str:
    """The page as Markdown."""
    lines = [
        "# What a simulation of a diagnosis costs",
        "",
        f"Written by `python -m benchmarks.simulations`. {date.today()}; load of the machine {busy[0]:.1f} to {busy[1]:.1f}. The groove of",
        f"`scenarios/groove.toml` ({costs.steps} steps of 4 ms) in process and in memory, with effects switched on; both ways in turn, "
        f"{len(costs.anew)} rounds.",
        "Milliseconds of CPU per simulation:",
        "",
        "| | median | least | largest |",
        "|---|---|---|---|",
    ]
    for name, values in (("opened anew for each (`assembly.run`)", costs.anew), ("stays open (`orchestration.rig`)", costs.open)):
        lines.append(f"| {name} | {statistics.median(values):.1f} | {min(values):.1f} | {max(values):.1f} |")
    lines += ["", "Both give the same bits, which the benchmark checks in every round. What is left are the steps: [profile](profile.md)."]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.simulations", description=__doc__)
    parser.add_argument("--rounds", type=int, default=20, help="simulations each way (default: 20)")
    parser.add_argument("--out", type=Path, default=DOCS, help="folder for the page (default: docs/benchmarks)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        job = prepare(load_scenario(ROOT / "scenarios" / "groove.toml"), Path(name) / "groove")
        busy = load()
        costs = measure(job.system, job.steps * job.system.step, options.rounds)
        text = page(costs, (busy, load()))
    (options.out / "simulations.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
