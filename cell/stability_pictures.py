"""Pictures of the stability of a program: lobes at its poses with the planned cut, and a map over the work space."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from robomill.cell.palette import CYCLE, GREEN, RED
from robomill.cell.stability import Cell, LineStability, lobes_at
from robomill.models.model.declaration import FloatArray

RPM = 60.0 / (2.0 * np.pi)
SHOWN = 4
"""Lines whose lobes are drawn: the nearest to their limit and some of other poses."""
SPEEDS = 300
_HEADROOM = 2.2
"""Highest depth shown over the highest planned one or the lowest limit."""


def chosen(lines: Sequence[LineStability]) -> tuple[LineStability, ...]:
    """The line nearest to its limit, then those whose poses are farthest from the ones chosen already."""
    picked = [min(lines, key=lambda x: x.margin)]
    while len(picked) < min(SHOWN, len(lines)):
        rest = [x for x in lines if x not in picked]
        picked.append(max(rest, key=lambda x: min(float(np.linalg.norm(x.q - p.q)) for p in picked)))
    return tuple(picked)


def draw_lobes(cell: Cell, lines: Sequence[LineStability], speeds: tuple[float, float], file: Path) -> Path:
    """Limiting axial depth over spindle speed from speeds[0] to speeds[1] [rad/s] at some lines; the planned cuts as points."""
    n = np.linspace(*speeds, SPEEDS)
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    lowest = []
    for i, line in enumerate(chosen(lines)):
        found = lobes_at(cell, line.cut, line.q, n)
        depth = np.where(np.isfinite(found.depth), found.depth, np.nan) * 1e3
        lowest.append(np.nanmin(depth) if np.any(np.isfinite(depth)) else 0.0)
        wide = 3.2 - 0.8 * i  # lobes that lie on each other are seen all
        axes.plot(n * RPM, depth, color=CYCLE[i], lw=wide, label=f"limit at line {line.line}")
        if cell.machine is not None and cell.spindle is not None:
            alone = lobes_at(cell, line.cut, line.q, n, True).depth * 1e3
            axes.plot(
                n * RPM, np.where(np.isfinite(alone), alone, np.nan), "--", color=CYCLE[i], lw=wide, label=f"robot alone, line {line.line}"
            )
    for stable, marker, colour in ((True, "o", GREEN), (False, "X", RED)):
        of = [x for x in lines if x.stable == stable]
        if of:
            label = f"planned, {'stable' if stable else 'unstable'} ({len(of)})"
            axes.plot(
                [x.spindle_speed * RPM for x in of],
                [1e3 * x.depth for x in of],
                marker,
                color=colour,
                mec="black",
                ms=8,
                ls="",
                label=label,
            )
    axes.set_ylim(0.0, _HEADROOM * max(*(1e3 * x.depth for x in lines), *lowest, 0.1))
    axes.set_xlim(n[0] * RPM, n[-1] * RPM)
    axes.set_xlabel("spindle speed, rev/min")
    axes.set_ylabel("axial depth, mm")
    axes.set_title(f"{cell.planned.name}: lobes at the poses of the program", loc="left", fontsize=10)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", fontsize=8, framealpha=0.9)
    figure.savefig(file, dpi=110)
    return file


def draw_map(x: FloatArray, y: FloatArray, margin: FloatArray, line: LineStability, place: tuple[float, float], file: Path) -> Path:
    """Margin (ny, nx) of a line over places x (nx,), y (ny,) of its cut in B [m], planned at `place` [m]; nan: out of reach."""
    figure = Figure(figsize=(7.0, 5.2), layout="constrained")
    axes = figure.add_subplot()
    axes.set_facecolor("0.85")
    shown = np.ma.masked_invalid(margin)
    mesh = axes.pcolormesh(x, y, shown, cmap="viridis", shading="nearest")
    if shown.count() and float(shown.min()) < 1.0 < float(shown.max()):
        axes.contour(x, y, np.where(np.isfinite(margin), margin, np.nan), levels=[1.0], colors=RED)
    axes.plot(*place, "o", ms=9, mfc="none", mec="white", mew=2, label=f"planned: line {line.line}")
    axes.set_xlabel("x of the base, m")
    axes.set_ylabel("y of the base, m")
    axes.set_aspect("equal")
    axes.set_title(
        f"robot alone: margin at {1e3 * line.depth:.2f} mm at {line.spindle_speed * RPM:.0f} rev/min; grey: out of reach",
        loc="left",
        fontsize=9,
    )
    legend = axes.legend(loc="upper right", fontsize=8)
    legend.get_frame().set_facecolor("0.35")
    for text in legend.get_texts():
        text.set_color("white")
    figure.colorbar(mesh, ax=axes, label="margin: limit over planned depth")
    figure.savefig(file, dpi=110)
    return file
