"""Pictures of an offline compensation: maps of the milled surface before and after, and the way of the tool tip with the iteration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robomill.cell.compensation import Compensation
from robomill.cell.palette import BLUE, GREEN, GREY
from robomill.cell.pictures import surfaces

_BEFORE, _AFTER = GREY, GREEN


def draw_all(result: Compensation, folder: Path) -> list[Path]:
    """Draw maps.png and path.png into `folder`; returns the files."""
    files = [folder / "maps.png", folder / "path.png"]
    for figure, file in zip((maps(result), path(result)), files, strict=True):
        figure.savefig(file, dpi=95)
    return files


def maps(result: Compensation) -> Figure:
    """The nominal part, and the deviation of its surface uncompensated and compensated, from above."""
    assert result.scenario.workpiece is not None
    return surfaces(result.results, result.scenario.workpiece, nominal=True)


def path(result: Compensation) -> Figure:
    """Deviation of the tool tip along the path before and after, what each iteration left, and what is left on other machines."""
    figure = Figure(figsize=(12, 8.5), layout="constrained")
    grid = figure.add_gridspec(4, 2, height_ratios=[1, 1, 1, 1.1])
    axes = [figure.add_subplot(grid[0, :])]
    axes += [figure.add_subplot(grid[i, :], sharex=axes[0]) for i in (1, 2)]
    for ax in axes[:2]:
        ax.tick_params(labelbottom=False)
    way = result.path.along
    air = ~result.before.cut
    for ax, i, name in zip(axes, range(3), "xyz", strict=True):
        ax.axhline(0.0, color="k", lw=0.5)
        for deviation, colour, label in (
            (result.before.deviation, _BEFORE, "uncompensated"),
            (result.after.deviation, _AFTER, "compensated"),
        ):
            ax.plot(way, np.where(air, np.nan, 1e3 * deviation[:, i]), color=colour, lw=0.9, label=label)
        ax.set_ylabel(f"{name} in mm")
    axes[0].set_title("Tool tip minus planned path in the cut, workpiece frame")
    axes[0].legend(fontsize=8, ncols=2, loc="upper right")
    axes[-1].set_xlabel("way along the path in m")
    _iterations(figure.add_subplot(grid[3, 0]), result)
    _trials(figure.add_subplot(grid[3, 1]), result)
    return figure


def _iterations(ax: Axes, result: Compensation) -> None:
    numbers = [i.number for i in result.iterations]
    ax.semilogy(numbers, [1e3 * i.rms_m for i in result.iterations], "o-", color=_AFTER, label="tool tip, rms")
    ax.semilogy(numbers, [1e3 * i.left_m for i in result.iterations], "s--", color=BLUE, label="its smoothed part")
    ax.set(xlabel="iteration", ylabel="rms in mm", xticks=numbers, title="What each iteration leaves, with its contraction")
    low, high = ax.get_ylim()
    ax.set_ylim(low / 1.5, high)
    for i in result.iterations:
        if i.contraction is not None:
            ax.annotate(f"{i.contraction:+.2f}", (i.number, 1e3 * i.left_m), (0, -13), textcoords="offset points", ha="center", fontsize=8)
    ax.legend(fontsize=8)


def _trials(ax: Axes, result: Compensation) -> None:
    nominal = (result.before.figures.rms_m, result.after.figures.rms_m)
    rows = [("nominal", *nominal)]
    for t in result.trials:
        said = f"springs {100 * t.machine.stiffness:+.0f} %\nforce {100 * t.machine.force:+.0f} %"
        rows.append((said, t.before.figures.rms_m, t.after.figures.rms_m))
    at = np.arange(len(rows))
    for shift, column, colour, label in ((-0.2, 1, _BEFORE, "uncompensated"), (0.2, 2, _AFTER, "compensated")):
        bars = ax.bar(at + shift, [1e3 * float(r[column]) for r in rows], 0.38, color=colour, label=label)
        ax.bar_label(bars, fmt="%.2f", fontsize=8)
    ax.set_xticks(at, [str(r[0]) for r in rows], fontsize=8)
    ax.set(ylabel="rms in mm", title="The same program on other machines")
    ax.margins(y=0.25)
    ax.legend(fontsize=8, ncols=2, loc="upper right")
