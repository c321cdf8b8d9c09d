"""Measuring: interleaved rounds, agreement, scaling, memory, start. Nothing here knows how results are shown."""

from __future__ import annotations

import contextlib
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.answer import Answer
from benchmarks.contenders import Contender
from benchmarks.runners import MasterError, Runner

MOST = 25_000_000  # numbers that are kept in memory as results: 200 MB
FIRST = 240.0  # s; Python FMUs may have to be compiled
FEWEST = 60  # steps of a run
WARM = 512 * 2**20  # bytes that a run can take and find in the machine
PATIENCE = 12.0  # s that runs of one size may take, after which none is begun
Say = Callable[[str], object]


@dataclass
class Spread:
    """Repeated measurements of one quantity."""

    values: list[float] = field(default_factory=list)

    @property
    def median(self) -> float:
        """Median."""
        return statistics.median(self.values)


@dataclass
class Row:
    """A contender that puts its results in one place (or nowhere)."""

    name: str
    results: str
    note: str
    steps: int = 0
    wall: Spread = field(default_factory=Spread)
    """Microseconds per macro step, one per round."""
    cpu: Spread = field(default_factory=Spread)
    """Microseconds of CPU time per macro step, one per round."""
    closing: Spread = field(default_factory=Spread)
    difference: float = 0.0
    """Largest difference from the reference, of any output after the last step, relative to the largest output."""
    recorded: float | None = None
    """Largest difference of the last row of the results, read back, from the outputs, relative likewise; None: not read back."""


@dataclass
class Duel:
    """All rows of one table, and who is missing why."""

    rows: list[Row]
    missing: dict[str, str]
    steps_checked: int


def duel(contenders: Sequence[Contender], rounds: int, slice_: float, outputs: int, steps: int | None, say: Say) -> Duel:
    """All contenders in turn, round by round, `slice_` [s] each; or whole runs of `steps`. The system has so many `outputs`.

    The first contender is the reference of the check, which is a run apart with everybody's results on.
    """
    checked = steps or 1000
    rows: list[tuple[Row, Runner]] = []
    missing: dict[str, str] = {}
    reference: list[float] = []
    with contextlib.ExitStack() as stack:
        for c in contenders:
            say(f"starting {c.name}")
            try:
                runner = c.start(None)
                stack.callback(runner.close)
                for results in c.results:
                    row = Row(c.name, results, c.note)
                    answer = runner.run(checked, results, check=True, limit=FIRST)
                    reference = reference or answer.outputs
                    row.difference = difference(answer.outputs, reference)
                    if answer.recorded:
                        row.recorded = difference(answer.recorded, answer.outputs)
                    row.steps = steps or calibrate(runner, results, slice_, MOST // outputs)
                    rows.append((row, runner))
            except Exception as error:  # whatever goes wrong with somebody else's library: it is reported
                missing[c.name] = reason(error)
        for k in range(rounds):
            say(f"round {k + 1} of {rounds}")
            for row, runner in list(rows):
                warm_memory()
                try:
                    answer = runner.run(row.steps, row.results)
                except MasterError as error:
                    missing[f"{row.name} ({row.results})"] = str(error)
                    rows.remove((row, runner))
                    continue
                row.wall.values.append(answer.wall / row.steps * 1e6)
                row.cpu.values.append(answer.cpu / row.steps * 1e6)
                row.closing.values.append(answer.closing / row.steps * 1e6)
    return Duel([row for row, _ in rows], missing, checked)


def warm_memory() -> None:
    """Use memory and free it, so that the run that follows gets some that was in use a moment ago.

    A virtual machine gives to its host what has been free for seconds, and has to fetch it back: that took up to 9 us per page of
    4 kB, more than ten steps of the ring take, and differed from run to run; it is no master's time.
    """
    np.zeros(WARM // 8)[:: 4096 // 8] = 1.0


def reason(error: Exception) -> str:
    """An error as one line."""
    text = str(error).strip().splitlines()
    said = text[0][:160] if text else type(error).__name__
    return f"not installed ({said})" if isinstance(error, ImportError) or "ModuleNotFoundError" in said else said


def difference(values: Sequence[float], reference: Sequence[float]) -> float:
    """Largest difference, relative to the largest of the reference's values; infinite if the numbers of values differ."""
    if len(values) != len(reference):
        return float("inf")
    a, b = np.array(values), np.array(reference)
    return float(np.max(np.abs(a - b)) / max(float(np.max(np.abs(b))), 1e-300))


def calibrate(runner: Runner, results: str, slice_: float, most: int, limit: float = 60.0) -> int:
    """How many steps take `slice_` [s], about, at most `most`. The runner is warm: it has made a run before."""
    steps = min(FEWEST, most)
    while (wall := runner.run(steps, results, limit=limit).wall) < slice_ / 3 and steps < most:
        steps = min(int(steps * min(20.0, 1.2 * slice_ / max(wall, 1e-9))), most)
    return min(max(int(steps * slice_ / wall), FEWEST), most)


@dataclass
class Point:
    """A contender in a fresh process."""

    name: str
    results: str
    x: float
    """What is varied."""
    steps: int = 0
    wall: Spread = field(default_factory=Spread)
    """us per macro step."""
    cpu: Spread = field(default_factory=Spread)
    setup: float = 0.0
    """s"""
    memory: float = 0.0
    """MB"""
    problem: str = ""


def with_results(contenders: Sequence[Contender]) -> list[tuple[Contender, str]]:
    """Every contender with every place that it can put results in, so that scaling, memory and duration compare like with like."""
    return [(c, results) for c in contenders for results in c.results if results != "none"]


def point(c: Contender, results: str, x: float, outputs: int, slice_: float, repeat: int, limit: float) -> Point:
    """One contender of a size, in a fresh process; `limit` [s] for setting up and running once.

    The first run also warms up and is not counted, unless it alone has worn out the patience: setting up, or completing the
    results, of tens of thousands of signals takes that long, the steps do not.
    """
    made = Point(c.name, results, x)
    runner: Runner | None = None
    try:
        runner = c.start(None)
        began = time.monotonic()
        made.steps, answer = FEWEST, runner.run(FEWEST, made.results, limit=limit)
        made.setup = answer.setup
        answers = [answer]
        if time.monotonic() - began < PATIENCE:
            made.steps, answers = calibrate(runner, made.results, slice_, MOST // outputs, limit), []
        while len(answers) < repeat and (not answers or time.monotonic() - began < PATIENCE):
            warm_memory()
            answers.append(runner.run(made.steps, made.results, limit=limit))
        made.wall.values = [answer.wall / made.steps * 1e6 for answer in answers]
        made.cpu.values = [answer.cpu / made.steps * 1e6 for answer in answers]
    except Exception as error:
        made.problem = reason(error)
    finally:
        if runner is not None:
            runner.close()
    return made


def durations(contenders: Sequence[Contender], steps: Sequence[int], limit: float, say: Say) -> list[Point]:
    """One run of each length per contender and place of results, each in a fresh process; none that would take longer than `limit` [s]."""
    points = []
    for c, results in with_results(contenders):
        say(f"durations: {c.name} ({results})")
        per_step = 0.0
        for n in steps:
            made = Point(c.name, results, n, n)
            if n * per_step > limit:
                break
            runner: Runner | None = None
            try:
                runner = c.start(None)
                warm_memory()
                answer = runner.run(n, made.results, check=True, limit=10 * limit)
                per_step = answer.wall / n
                made.wall.values.append(per_step * 1e6)
                made.cpu.values.append(answer.cpu / n * 1e6)
                made.memory, made.setup = answer.memory, answer.setup
            except Exception as error:
                made.problem = reason(error)
            finally:
                if runner is not None:
                    runner.close()
            points.append(made)
            if made.problem:
                break
    return points


@dataclass
class Start:
    """From the start of a process until the first steps are done [s]."""

    name: str
    warm: Spread = field(default_factory=Spread)
    cold: float | None = None
    memory: float = 0.0
    """MB after those steps."""
    problem: str = ""


def starts(contenders: Sequence[Contender], repeat: int, cold: bool, say: Say) -> list[Start]:
    """Every contender with warm caches, `repeat` times in turn, and (`cold`) once with an empty cache of ours."""
    made = {c.name: Start(c.name) for c in contenders}
    for k in range(repeat + 1):  # the first fills the caches
        for c in contenders:
            if made[c.name].problem:
                continue
            say(f"start {k} of {repeat}: {c.name}")
            try:
                answer, took = _start(c, {})
                if k:
                    made[c.name].warm.values.append(took)
                    made[c.name].memory = answer.memory
            except Exception as error:
                made[c.name].problem = reason(error)
    for c in contenders if cold else ():
        if not made[c.name].problem and c.name.startswith("robomill"):
            say(f"cold start: {c.name}")
            with tempfile.TemporaryDirectory() as empty:
                made[c.name].cold = _start(c, {"ROBOMILL_CACHE_DIR": empty, "NUMBA_CACHE_DIR": empty}, limit=120.0)[1]
    return list(made.values())


def _start(c: Contender, environment: dict[str, str], limit: float = 60.0) -> tuple[Answer, float]:
    runner = c.start(environment)
    try:
        began = getattr(runner, "began", None) or time.monotonic()
        answer = runner.run(2, "none", limit=limit)
        return answer, answer.finished - began
    finally:
        runner.close()


def load() -> float:
    """Processes that want a core, over the last minute."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")


def to_stderr(text: str) -> None:
    """Progress."""
    print(text, file=sys.stderr, flush=True)


def temporary(name: str) -> Path:
    """A folder for a run of the benchmark."""
    return Path(tempfile.mkdtemp(prefix=f"robomill_bench_{name}_"))
