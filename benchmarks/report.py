"""Tables, plots and the page: `docs/benchmarks/`. Every figure in the text comes from the measurement."""

from __future__ import annotations

import math
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks.contenders import C_LOOP, C_LOOP_FILLING, OURS
from benchmarks.measure import Duel, Point, Row, Start

PAGE = Path(__file__).with_name("page.md")
RESULTS = {"none": "no", "memory": "in memory", "disk": "on disk"}
COLOURS = {"none": "#b9c9d6", "memory": "#5b8db8", "disk": "#1f4e79"}
MARKERS = "os^Dvx*"
LINES = ("#222222", "#1f4e79", "#c05a1c", "#3c8d40", "#8b3a8f", "#b8860b", "#888888")
SAME, READ_BACK = 1e-9, 1e-5  # differences that are no rounding: of the times that libcosim hands out; of numbers as CSV text
PACKAGES = ("fmpy", "libcosimpy", "ecospy", "fmu-manipulation-toolbox")


@dataclass
class Measured:
    """Everything that is shown."""

    ring: Duel
    ring_calls: int
    gauss_seidel: Duel
    jacobi: Duel
    milling_calls: int
    milling_steps: int
    fmus: list[Point]
    signals: list[Point]
    durations: list[Point]
    starts: list[Start]
    rounds: int
    slice: float
    took: float
    load: tuple[float, float]


def number(value: float) -> str:
    """Three digits."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(digits, 4)}f}"


def base(duel: Duel, results: str) -> Row | None:
    """The C loop that does the same about results: on disk is compared with in memory, which is all it can do."""
    wanted = "none" if results == "none" else "memory"
    return next((r for r in duel.rows if r.name == C_LOOP and r.results == wanted), None)


def find(duel: Duel, name: str, results: str) -> Row | None:
    """A row."""
    return next((r for r in duel.rows if (r.name, r.results) == (name, results)), None)


def ratio(duel: Duel, row: Row) -> float:
    """CPU time relative to that of the C loop."""
    c = base(duel, row.results)
    return row.cpu.median / c.cpu.median if c else math.nan


def duel_table(duel: Duel, calls: int) -> str:
    """Markdown: with results first, the quickest first."""
    lines = [
        "| master | results | us per step | least .. most | CPU us per step | per FMU call "
        "| x C loop, wall | x C loop, CPU | closing | differs by | |",
        "|---" * 11 + "|",
    ]
    for r in sorted(duel.rows, key=lambda r: (r.results == "none", r.cpu.median)):
        c = base(duel, r.results)
        wall = r.wall.median / c.wall.median if c else math.nan
        off = "0" if r.difference == 0 else f"{r.difference:.0e}"
        wrong = "COMPUTES SOMETHING ELSE " * (r.difference > SAME) + "RECORDS SOMETHING ELSE " * ((r.recorded or 0.0) > READ_BACK)
        lines.append(
            f"| {bold(r)} | {RESULTS[r.results]} | {number(r.wall.median)} | {number(min(r.wall.values))} .. {number(max(r.wall.values))} "
            f"| {number(r.cpu.median)} | {number(r.cpu.median / calls)} | {number(wall)} | {number(ratio(duel, r))} "
            f"| {number(r.closing.median) if r.results != 'none' and r.closing.median > 0 else ''} | {off} | {wrong}{r.note} |"
        )
    lines += [f"| {name} | | | | | | | | | | left out: {why} |" for name, why in duel.missing.items()]
    return "\n".join(lines)


def bold(row: Row | Point | Start) -> str:
    """Our own stand out."""
    return f"**{row.name}**" if row.name.startswith("robomill") else row.name


def series(points: Sequence[Point]) -> list[dict[float, Point]]:
    """The points of each master and place of its results, by what is varied."""
    keys = dict.fromkeys((p.name, p.results) for p in points)
    return [{p.x: p for p in points if (p.name, p.results) == key} for key in keys]


def points_table(points: Sequence[Point], what: str) -> str:
    """Markdown: a row per master, a column per size."""
    sizes = sorted({p.x for p in points})
    lines = [f"| {what} | results | " + " | ".join(f"{x:,.0f}".replace(",", " ") for x in sizes) + " |", "|---" * (len(sizes) + 2) + "|"]
    for mine in series(points):
        cells = [number(mine[x].cpu.median) if x in mine and mine[x].cpu.values else "-" for x in sizes]
        first = next(iter(mine.values()))
        lines.append(f"| {bold(first)} | {RESULTS[first.results]} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def problems(points: Sequence[Point | Start], what: str) -> str:
    """Sentences about what could not be measured; the same reason is said once."""
    said = dict.fromkeys(
        f"{p.name}" + (f" at {p.x:g} {what}" if isinstance(p, Point) and "not installed" not in p.problem else "") + f": {p.problem}."
        for p in points
        if p.problem
    )
    return "".join(f"\n\nLeft out: {text}" for text in said)


def setup_table(points: Sequence[Point], what: str) -> str:
    """Table of the time to set up, by size and contender."""
    sizes = sorted({p.x for p in points})
    lines = [f"| {what} | " + " | ".join(f"{x:,.0f}".replace(",", " ") for x in sizes) + " |", "|---" * (len(sizes) + 1) + "|"]
    for name in dict.fromkeys(p.name for p in points):
        mine = {p.x: p for p in points if p.name == name and p.cpu.values}
        if mine:
            lines.append(f"| {bold(mine[min(mine)])} | " + " | ".join(number(mine[x].setup) if x in mine else "-" for x in sizes) + " |")
    return "\n".join(lines)


def durations_table(points: Sequence[Point]) -> str:
    """Markdown: microseconds and megabytes by length of the run."""
    lengths = sorted({p.x for p in points})
    lines = [
        "| master | results | " + " | ".join(f"{x:,.0f} steps".replace(",", " ") for x in lengths) + " |",
        "|---" * (len(lengths) + 2) + "|",
    ]
    for mine in series(points):
        first = next(iter(mine.values()))
        cells = [f"{number(mine[x].cpu.median)} us, {mine[x].memory:.0f} MB" if x in mine and mine[x].cpu.values else "-" for x in lengths]
        lines.append(f"| {bold(first)} | {RESULTS[first.results]} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def starts_table(starts: Sequence[Start]) -> str:
    """Markdown."""
    lines = ["| master | warm, median | least .. most | cold | memory |", "|---|---|---|---|---|"]
    for s in starts:
        if s.warm.values:
            cold = f"{number(s.cold)} s" if s.cold is not None else "no cache" if not s.name.startswith("robomill") else "not measured"
            spread = f"{number(min(s.warm.values))} .. {number(max(s.warm.values))} s"
            lines.append(f"| {bold(s)} | {number(s.warm.median)} s | {spread} | {cold} | {f'{s.memory:.0f} MB' if s.memory else ''} |")
    return "\n".join(lines)


def summary(m: Measured) -> str:
    """The sentences that people look for."""
    said = []
    r, g = m.ring, m.gauss_seidel
    memory, disk = find(r, OURS, "memory"), find(r, OURS, "disk")
    c, filling = find(r, C_LOOP, "memory"), find(r, C_LOOP_FILLING, "memory")
    if memory and disk and c and filling:
        said.append(
            f"On the ring our compiled loop takes {number(memory.cpu.median)} us of CPU per step with results in memory. That is "
            f"{number(ratio(r, memory))} times the plain C loop whose memory is there before its clock starts ({number(c.cpu.median)} us) "
            f"and {number(memory.cpu.median / filling.cpu.median)} times the one that takes it as it fills, as ours does "
            f"({number(filling.cpu.median)} us). With results on disk {number(disk.cpu.median)} us, {number(ratio(r, disk))} times "
            f"the C loop that keeps them in the memory that is there (aim: 2)."
        )
    ours = [row for row in (find(g, OURS, "memory"), find(g, OURS, "disk")) if row]
    if ours:
        per = ", ".join(f"{number(ratio(g, row))} with results {RESULTS[row.results]}" for row in ours)
        real = 4000.0 / ours[-1].wall.median
        said.append(
            f"On the milling cell the ratio is {per} (aim: 1.3); with results {RESULTS[ours[-1].results]} "
            f"it runs {real:.0f} times as fast as real time."
        )
    for title, duel in (("ring", r), ("milling cell", g), ("milling cell, all components at once", m.jacobi)):
        for results in ("memory", "disk"):
            mine = find(duel, OURS, results)
            others = [row for row in duel.rows if row.results == results and not row.name.startswith(("robomill", C_LOOP))]
            if mine and others:
                best = min(others, key=lambda row: row.cpu.median)
                factor = best.cpu.median / mine.cpu.median
                said.append(
                    f"The quickest of the others with results {RESULTS[results]} ({title}) is {best.name}, {number(best.cpu.median)} us; "
                    f"ours takes {number(mine.cpu.median)} us, {number(max(factor, 1 / factor))} times {'less' if factor > 1 else 'MORE'}."
                )
    return "\n".join(f"- {s}" for s in said)


def agreement(m: Measured) -> str:
    """Whether all computed the same."""
    rows = [row for duel in (m.ring, m.gauss_seidel, m.jacobi) for row in duel.rows]
    worst = max(rows, key=lambda row: row.difference)
    read = [row for row in rows if row.recorded is not None]
    text = max((row for row in read), key=lambda row: row.recorded or 0.0, default=None)
    exact = sum(row.difference == 0 for row in rows)
    said = (
        f"{exact} of {len(rows)} rows have the bits of the C loop in every output; "
        f"the largest difference is {worst.difference:.1e} ({worst.name})."
    )
    if text is not None:
        said += (
            f" The last row of the results of {len(read)} was read back from where it had been written; "
            f"the largest difference from the outputs is {text.recorded:.1e} ({text.name}, {RESULTS[text.results]})."
        )
    return said


def machine() -> str:
    """What it ran on."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"


def versions() -> str:
    """Versions of the peers that are there."""
    found = []
    for package in PACKAGES:
        try:
            found.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            found.append(f"{package} not installed")
    return ", ".join(found)


def write(m: Measured, folder: Path) -> None:
    """The page and its plots."""
    folder.mkdir(parents=True, exist_ok=True)
    bars(m, folder / "masters.png")
    lines(m, folder / "scaling.png")
    (folder / "masters.md").write_text(
        PAGE.read_text().format(
            summary=summary(m),
            ring=duel_table(m.ring, m.ring_calls),
            ring_calls=m.ring_calls,
            gauss_seidel=duel_table(m.gauss_seidel, m.milling_calls),
            jacobi=duel_table(m.jacobi, m.milling_calls),
            milling_calls=m.milling_calls,
            milling_steps=m.milling_steps,
            fmus=points_table(m.fmus, "FMUs"),
            fmus_problems=problems(m.fmus, "FMUs"),
            signals=points_table(m.signals, "signals"),
            signals_problems=problems(m.signals, "signals"),
            fmus_setup=setup_table(m.fmus, "FMUs"),
            signals_setup=setup_table(m.signals, "signals"),
            durations=durations_table(m.durations),
            durations_problems=problems(m.durations, "steps"),
            starts=starts_table(m.starts),
            starts_problems=problems(m.starts, ""),
            agreement=agreement(m),
            rounds=m.rounds,
            slice=m.slice,
            checked=m.ring.steps_checked,
            machine=machine(),
            versions=versions(),
            date=time.strftime("%Y-%m-%d"),
            before=m.load[0],
            after=m.load[1],
            took=m.took / 60,
        )
    )


def _figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    return plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)


def bars(m: Measured, file: Path) -> None:
    """Microseconds per macro step of every master, ring and milling cell."""
    duels = (
        (m.ring, "ring of 4 generic FMUs, 12 inputs and 12 outputs each"),
        (m.gauss_seidel, "milling cell, one after the other (as its system file says)"),
        (m.jacobi, "milling cell, all at once (what libcosim and Ecos can do)"),
    )
    names = [list(dict.fromkeys(r.name for r in sorted(d.rows, key=lambda r: r.cpu.median))) for d, _ in duels]
    figure, axes = _figure(3, 1, (8.5, 0.5 * sum(map(len, names)) + 2.4))
    axes[0][0].get_gridspec().set_height_ratios([max(len(n), 1) + 1 for n in names])
    for (duel, title), order, a in zip(duels, names, axes[:, 0], strict=True):
        for results, shift in (("none", 0.27), ("memory", 0.0), ("disk", -0.27)):
            for r in (r for r in duel.rows if r.results == results):
                y, values = len(order) - order.index(r.name) + shift, r.cpu.values
                spread = [[r.cpu.median - min(values)], [max(values) - r.cpu.median]]
                a.barh(y, r.cpu.median, 0.25, color=COLOURS[results], xerr=spread, error_kw={"lw": 0.8})
                a.text(max(values) * 1.06, y, number(r.cpu.median), va="center", fontsize=7)
        a.set(xscale="log", title=title)
        a.set_yticks([len(order) - i for i in range(len(order))], order)
        if duel.rows:
            a.set_xlim(min(min(r.cpu.values) for r in duel.rows) / 2, max(max(r.cpu.values) for r in duel.rows) * 2)
        a.spines[["top", "right"]].set_visible(False)
        a.title.set_fontsize(10)
    from matplotlib import patches

    labels = {"none": "no results", "memory": "results in memory", "disk": "results on disk"}
    figure.legend(
        [patches.Patch(color=COLOURS[k]) for k in labels], list(labels.values()), loc="outside upper center", ncols=3, frameon=False
    )
    axes[-1][0].set_xlabel("microseconds of CPU per macro step")
    figure.savefig(file, dpi=120)


def lines(m: Measured, file: Path) -> None:
    """Scaling: time by number of FMUs, of signals, of steps; memory by number of steps."""
    figure, axes = _figure(2, 2, (10.0, 7.6))
    panels: list[tuple[Sequence[Point], str, str, Callable[[Point], float]]] = [
        (m.fmus, "FMUs, 12 signals each", "us of CPU per macro step", lambda p: p.cpu.median),
        (m.signals, "signals per FMU, 4 FMUs", "us of CPU per macro step", lambda p: p.cpu.median),
        (m.durations, "steps of the run (4 FMUs, 12 signals)", "us of CPU per macro step", lambda p: p.cpu.median),
        (m.durations, "steps of the run (4 FMUs, 12 signals)", "peak memory of the process, MB", lambda p: p.memory),
    ]
    names = list(dict.fromkeys(p.name for p in (*m.fmus, *m.signals, *m.durations)))
    for (points, x, y, value), a in zip(panels, axes.flat, strict=True):
        for mine in series([p for p in points if p.cpu.values]):
            first = next(iter(mine.values()))
            i = names.index(first.name)
            style = {"marker": MARKERS[i % len(MARKERS)], "color": LINES[i % len(LINES)], "lw": 2.2 if first.name == OURS else 1.2, "ms": 5}
            style["ls"] = "--" if first.results == "disk" else "-"
            a.plot([*mine], [value(p) for p in mine.values()], label=f"{first.name}, {RESULTS[first.results]}", **style)
        a.set(xscale="log", yscale="log", xlabel=x, ylabel=y)
        sizes = sorted({p.x for p in points})
        a.set_xticks(sizes, [f"{size:,.0f}".replace(",", " ") for size in sizes])
        a.minorticks_off()
        a.grid(alpha=0.3)
        a.spines[["top", "right"]].set_visible(False)
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    figure.savefig(file, dpi=120)
