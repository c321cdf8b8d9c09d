"""The signals of a run, drawn over time."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from robomill.orchestration.runs.export import arrays_of
from robomill.orchestration.slaves.protocol import base_name

if TYPE_CHECKING:
    from robomill.orchestration.runs.run import Run

MOST_PANELS = 8
"""Arrays that are drawn where none is named: as many as can be read on one page."""
PANEL = (8.0, 1.8)
"""Width and height of a panel [inches]."""


class Picture(Figure):
    """A figure that a notebook shows by itself."""

    def _repr_png_(self) -> bytes:
        data = io.BytesIO()
        self.savefig(data, format="png", dpi=100)
        return data.getvalue()


def plot(run: Run, names: Sequence[str] = ()) -> Picture:
    """See `Run.plot`."""
    found = arrays_of(run, names)
    title = run.info.get("system") or run.folder.name
    shown = found if names else [n for n in found if np.ptp(run[n], axis=0).max(initial=0.0) > 0.0][:MOST_PANELS]
    if not names and len(shown) < len(found):
        title = f"{title}: {len(shown)} of {len(found)} arrays; plot(name, ...) draws others"
    width, height = PANEL
    figure = Picture(figsize=(width, height * max(len(shown), 1) + 0.6), layout="constrained")
    figure.suptitle(str(title), fontsize="medium")
    axes = figure.subplots(max(len(shown), 1), 1, sharex=True, squeeze=False)[:, 0]
    for ax, name in zip(axes, shown, strict=False):
        values = run[name].reshape(len(run), -1)
        lines = ax.plot(run.t, values)
        for k, line in enumerate(reversed(lines)):
            line.set_linewidth(1.0 + 0.5 * k)  # what lies below another line is wider, and is seen
        ax.set_title(name, loc="left", fontsize="small")
        ax.set_ylabel(run.unit(name) or "1")
        if values.shape[1] > 1:
            ax.legend(lines, _elements(run, name), fontsize="x-small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes[-1].set_xlabel("t, s")
    figure.align_ylabels()
    return figure


def _elements(run: Run, name: str) -> list[str]:
    found = [n[len(name) :] for n in run.columns if base_name(n) == name]
    return found if len(found) == math.prod(run[name].shape[1:]) else [name]
