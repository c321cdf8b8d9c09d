"""Pictures of controlled material removal rate, as Figs. 11-13 of paper 003: force above, feed below, over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robomill.cell.palette import BLUE, CYCLE, RED, STYLES
from robomill.cell.removal_rate import RateResult, RateScenario

DEPTH = "0.87"
"""The area of the depth of cut."""


def draw_all(scenario: RateScenario, results: Sequence[RateResult], folder: Path) -> list[Path]:
    """Draw a picture of each variant, and one of all; returns the files."""
    files = []
    for result in results:
        file = folder / result.variant.name / "force_and_feed.png"
        force_and_feed(scenario, result).savefig(file, dpi=130)
        files.append(file)
    if len(results) > 1:
        file = folder / "force_over_way.png"
        over_way(scenario, results).savefig(file, dpi=130)
        files.insert(0, file)
    return files


def force_and_feed(scenario: RateScenario, result: RateResult) -> Figure:
    """Process force with its reference and limit, and the feed, over time; depth of cut in grey."""
    run = result.run
    figure = Figure(figsize=(9, 5.5), layout="constrained")
    force, feed = figure.subplots(2, 1, sharex=True)
    force.plot(run.t, run["process.force_measured"], color="0.55", lw=0.7, label="as measured")
    force.plot(run.t, run["process.force"], color=BLUE, lw=1.1, label="process force")
    _levels(force, scenario, result.reference)
    depth = force.twinx()
    depth.fill_between(run.t, 1e3 * run["process.depth"], color=DEPTH, lw=0, zorder=0)
    force.fill_between([], [], color=DEPTH, lw=0, label="depth of cut (right axis)")
    depth.set(ylabel="depth of cut in mm", ylim=(0.0, 4e3 * float(run["process.depth"].max()) or 1.0))
    force.set_zorder(depth.get_zorder() + 1)
    force.patch.set_visible(False)
    force.set(ylabel="cutting force in N", title=f"{scenario.title}\n{result.variant.title}", ylim=(0.0, None))
    feed.plot(run.t, 1e3 * run["robot.feed_command"], color="0.55", lw=0.9, label="feed commanded")
    feed.plot(run.t, 1e3 * run["robot.feed"], color=RED, lw=1.1, label="feed actual")
    feed.set(xlabel="time in s", ylabel="feed in mm/s", ylim=(0.0, None))
    handles, labels = (a + b for a, b in zip(force.get_legend_handles_labels(), feed.get_legend_handles_labels(), strict=True))
    figure.legend(handles, labels, fontsize=8, loc="outside lower center", ncols=4)
    return figure


def over_way(scenario: RateScenario, results: Sequence[RateResult]) -> Figure:
    """Force of all variants over the way along the path, above the depth of cut."""
    figure = Figure(figsize=(9, 5.5), layout="constrained")
    force, depth = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    for i, result in enumerate(results):
        run = result.run
        style = {"color": CYCLE[i % len(CYCLE)], "ls": STYLES[i % len(STYLES)]}
        label = f"{result.variant.title}: {result.figures['duration_s']:.2f} s, peak {result.figures['peak_force_n']:.0f} N"
        force.plot(1e3 * run["process.distance"], run["process.force"], lw=1.0, label=label, **style)
    _levels(force, scenario, results[0].reference)
    force.set(ylabel="cutting force in N", title=scenario.title, ylim=(0.0, None))
    figure.legend(fontsize=8, loc="outside lower center", ncols=2)
    way, deep = 1e3 * scenario.profile[:, 0], 1e3 * scenario.profile[:, 1]
    depth.fill_between(way, deep, color="0.8", lw=0)
    depth.set(
        xlabel="way along the path in mm", ylabel="depth of\ncut in mm", xlim=(float(np.min(way)), float(np.max(way))), ylim=(0.0, None)
    )
    return figure


def _levels(ax: Axes, scenario: RateScenario, reference: float | None) -> None:
    """Reference force [N] and limit of the spindle, where there are any."""
    if reference is not None:
        ax.axhline(reference, color="k", ls=":", lw=1.0, label=f"reference {reference:.0f} N")
    if scenario.limit is not None:
        ax.axhline(scenario.limit, color=RED, ls="--", lw=1.0, label=f"limit {scenario.limit:.0f} N")
