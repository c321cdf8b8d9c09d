"""Pictures of path learning, as Fig. 5 of paper 003: guiding points, the true contour, the learnt passes, and what they miss it by."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from robomill.cell.palette import BLUE, GREEN, ORANGE, PURPLE, RED, SKY
from robomill.cell.path_learning import LearningScenario, Learnt
from robomill.models.components.surface_contact import signed_distances

COLOURS = (ORANGE, SKY, GREEN, PURPLE)
"""One per pass; they begin anew where there are more."""
DETAIL = 15.0
"""Half the width [mm] of the detail of a contour that is drawn as a whole."""
TALLEST = 3.0
"""Height over width of a contour from which axes of equal scale are drawn; below, a flat edge would be a line."""


def draw_all(scenario: LearningScenario, results: Sequence[Learnt], folder: Path) -> list[Path]:
    """Draw learnt.png of every variant into its folder; returns the files."""
    files = []
    for result in results:
        file = folder / result.variant.name / "learnt.png"
        passes(scenario, result).savefig(file, dpi=130)
        files.append(file)
    return files


def passes(scenario: LearningScenario, result: Learnt) -> Figure:
    """Above: guiding points, nominal and true edge, where the tip went, program. Below: distance from the true path of the tip."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(2, 1))
    closed = np.ptp(scenario.real[:, 1]) * TALLEST > np.ptp(scenario.real[:, 0])
    whole = figure.add_subplot(grid[0, 0] if closed else grid[0, :])
    views = [whole, figure.add_subplot(grid[0, 1])] if closed else [whole]
    bottom = figure.add_subplot(grid[1, :])
    radius = result.variant.settings.tip_radius
    for view in views:
        view.plot(*(1e3 * scenario.nominal.T), color="0.8", lw=5.0, label="edge as drawn")  # a band: the true one lies on it
        view.plot(*(1e3 * scenario.real.T), color="black", label="true edge")
        view.plot(*(1e3 * result.guiding.position[:, :2].T), "s--", color=RED, markersize=3, linewidth=0.8, label="guiding points")
        for n, p in enumerate(result.passes):
            text = f"pass {n + 1} as recorded; below, with F/k: {1e3 * p.figures['smoothed_rms_m']:.3f} mm rms"
            view.plot(*(1e3 * p.position[:, :2].T), color=COLOURS[n % len(COLOURS)], linewidth=0.8, label=text)
        view.plot(*(1e3 * result.program.position[:, :2].T), ".", color=BLUE, markersize=5, label=f"program, {len(result.program)} points")
        view.set(xlabel="x in the part frame, mm", ylabel="y, mm")
        if closed:
            view.set_aspect("equal")
    if closed:
        x, y = 1e3 * result.guiding.position[len(result.guiding) // 8, :2]
        views[1].set(xlim=(x - DETAIL, x + DETAIL), ylim=(y - DETAIL, y + DETAIL), title="detail")
    for n, p in enumerate(result.passes):
        colour = COLOURS[n % len(COLOURS)]
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p.learnt.position, axis=0), axis=1))])
        error = signed_distances(scenario.real, p.learnt.position[:, :2]) - radius
        bottom.plot(1e3 * way, 1e3 * error, color=colour, linewidth=0.8)
    figure.suptitle(f"{scenario.title}: {result.variant.title}")
    figure.legend(*whole.get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=3)
    bottom.set(xlabel="way along the learnt path, mm", ylabel="learnt with F/k minus true, mm")
    bottom.grid(alpha=0.3)
    return figure
