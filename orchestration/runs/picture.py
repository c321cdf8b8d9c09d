"""Signals, drawn over time."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from robomill.orchestration.slaves.protocol import FloatArray

PANEL = (8.0, 1.8)
"""Width and height of a panel [inches]."""


class Picture(Figure):
    """A figure that a notebook shows by itself."""

    def _repr_png_(self) -> bytes:
        data = io.BytesIO()
        self.savefig(data, format="png", dpi=100)
        return data.getvalue()


@dataclass(frozen=True)
class Panel:
    """An array over time."""

    name: str
    unit: str
    values: FloatArray
    """float64[n, elements]."""
    elements: Sequence[str]


def draw(t: FloatArray, panels: Sequence[Panel], title: str) -> Picture:
    """A panel for each array over t [s]; the lines of its elements are narrower from one to the next, so that none hides another."""
    width, height = PANEL
    figure = Picture(figsize=(width, height * max(len(panels), 1) + 0.6), layout="constrained")
    figure.suptitle(title, fontsize="medium")
    axes = figure.subplots(max(len(panels), 1), 1, sharex=True, squeeze=False)[:, 0]
    for ax, panel in zip(axes, panels, strict=False):
        lines = ax.plot(t, panel.values)
        for k, line in enumerate(reversed(lines)):
            line.set_linewidth(1.0 + 0.5 * k)
        ax.set_title(panel.name, loc="left", fontsize="small")
        ax.set_ylabel(panel.unit or "1")
        if len(panel.elements) > 1:
            ax.legend(lines, panel.elements, fontsize="x-small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes[-1].set_xlabel("t, s")
    figure.align_ylabels()
    return figure
