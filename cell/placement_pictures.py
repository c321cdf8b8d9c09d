"""The map of `robomill place`: how much the program bends the robot over pairs of what is free."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robomill.cell.palette import RED
from robomill.cell.placement import OUT_OF_REACH, VARIABLES, Placing, grid_map

PAIRS = (("x", "y"), ("x", "z"), ("turn", "spindle"))
_LABELS = {"x": "x in mm", "y": "y in mm", "z": "z in mm", "turn": "turn of the workpiece in deg", "spindle": "angle of the spindle in deg"}
_SCALE = {"x": 1e3, "y": 1e3, "z": 1e3, "turn": 180.0 / np.pi, "spindle": 180.0 / np.pi}


def draw(placing: Placing, file: Path) -> Path:
    """Draw the maps over PAIRS, the others at the best placement."""
    figure = Figure(figsize=(14, 4.4), layout="constrained")
    maps = [grid_map(placing, pair) for pair in PAIRS]
    low, high = placing.best_m, min(4.0 * placing.best_m, max(float(np.nanmax(m[2])) for m in maps))
    levels = np.linspace(1e3 * low, 1e3 * high, 17)
    for ax, pair, (across, up, value) in zip(np.ravel(figure.subplots(1, len(PAIRS))), PAIRS, maps, strict=True):
        shown = ax.contourf(_SCALE[pair[0]] * across, _SCALE[pair[1]] * up, 1e3 * value, levels, cmap="viridis", extend="both")
        _point(ax, placing.best, pair, "*", "white", "best")
        if placing.present_m < OUT_OF_REACH:
            _point(ax, placing.present, pair, "P", RED, "as it is (what is not on the axes differs)")
        ax.set(xlabel=_LABELS[pair[0]], ylabel=_LABELS[pair[1]], facecolor="0.85")
    figure.colorbar(shown, label="displacement of the tool tip\nin the cut, rms, mm", format="%.2f")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=2, facecolor="0.8")
    figure.suptitle("Criterion of the placement; grey: out of limits", fontsize=10)
    figure.savefig(file, dpi=100)
    return file


def _point(ax: Axes, values: np.ndarray, pair: tuple[str, str], marker: str, colour: str, label: str) -> None:
    x, y = (_SCALE[v] * values[VARIABLES.index(v)] for v in pair)
    ax.plot(x, y, marker, color=colour, mec="black", mew=0.8, ms=13, ls="", clip_on=False, zorder=5, label=label)
