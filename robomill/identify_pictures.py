"""Pictures of an impact test: frequency responses with coherence, and mode shapes on the robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from robomill.cell.palette import BLUE, RED
from robomill.models.calibration.hammer import Response
from robomill.models.calibration.modal_fit import ModalFit
from robomill.models.calibration.mode_shapes import ModeShapes
from robomill.models.model.declaration import FloatArray

SHOWN = 50.0
"""Hz: peaks from 0 to 50 Hz are what the thesis shows and fits."""
LARGEST = 0.3
"""Largest motion in a picture of a mode [m]."""
BAR = 0.4
"""Half of the bar across the arm in a view from the front [m]."""
X, Y, Z = range(3)
PHASES = np.cos(np.linspace(0.0, np.pi, 5))
COLUMNS = 3
_PARTS = (("k", 1.0, "still"), (BLUE, 1.8, "ends of the vibration"), ("0.7", 1.0, "between them"))
"""Colour, width and name of the lines of a mode."""


def draw_responses(responses: Sequence[Response], fit: ModalFit) -> Figure:
    """Inertance along each blow, measured and fitted, with the modes; coherence below (Fig. 3.4)."""
    figure = Figure(figsize=(3.4 * len(responses) + 0.6, 4.8), layout="constrained")
    axes = np.reshape(figure.subplots(2, len(responses), sharex=True, height_ratios=[3, 1], squeeze=False), (2, -1))
    for n, (r, fitted) in enumerate(zip(responses, fit.fitted, strict=True)):
        d, (above, below) = r.direction, axes[:, n]
        above.semilogy(r.frequency, np.abs(r.inertance[:, d]), color="0.6", lw=2.4, label="measured")
        above.semilogy(r.frequency, np.abs(fitted[:, d]), color=BLUE, lw=1.0, label="rational fit")
        for m in fit.modes:
            if m.frequency < SHOWN:
                above.axvline(m.frequency, color=RED, lw=1.0, ls=":", label="modes" if m is fit.modes[0] else None)
        name = "xyz"[d]
        above.set(title=f"H_{name}{name}, {r.blows} blows of {r.peak:.0f} N", xlim=(0.0, SHOWN))
        below.plot(r.frequency, r.coherence[:, d], color="0.3", lw=0.8)
        below.set(xlabel="frequency in Hz", ylim=(0.0, 1.05))
    axes[0, 0].set_ylabel("inertance in m/s2/N")
    axes[1, 0].set_ylabel("coherence")
    axes[0, 0].legend(fontsize=8, loc="lower right")
    return figure


def draw_shapes(shapes: ModeShapes, chosen: Sequence[int], titles: Sequence[str]) -> Figure:
    """The arm in the chosen modes of the model at five phases of the vibration, each seen so that it moves most.

    From the side, from above or, where it rolls about x, from the front, with a bar across each place of the arm.
    """
    rows = max(-(-len(chosen) // COLUMNS), 1)
    figure = Figure(figsize=(3.6 * COLUMNS, 2.6 * rows + 0.2), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for ax in panels[len(chosen) :]:
        ax.axis("off")
    for ax, mode, title in zip(panels, chosen, titles, strict=False):
        _shape(ax, shapes.points, shapes.motion[mode], shapes.turn[mode])
        ax.set_title(title, fontsize=9)
    lines = [Line2D([], [], color=c, lw=w, label=text) for c, w, text in _PARTS]
    figure.legend(handles=lines, fontsize=8, loc="outside lower center", ncols=len(lines))
    return figure


def _shape(ax: Axes, points: FloatArray, motion: FloatArray, turn: FloatArray) -> None:
    """One mode: still in black, its ends in blue, between them in grey."""
    roll = BAR * float(np.abs(turn[:, 0]).max())
    flat = np.abs(motion).max(axis=0)
    front = roll > flat.max()
    scale = LARGEST / max(roll if front else float(np.linalg.norm(motion, axis=1).max()), 1e-12)
    (across, up), seen = ((Y, Z), "front") if front else ((X, Z), "side") if flat[Z] > flat[Y] else ((X, Y), "above")

    def draw(part: float, colour: str, width: float) -> None:
        moved = points + part * scale * motion
        ax.plot(moved[:, across], moved[:, up], color=colour, lw=width, marker="o", ms=2.5)
        if front:
            bar = np.array([0.0, BAR, 0.0]) + part * scale * np.cross(turn, [0.0, BAR, 0.0])
            for place, half in zip(moved, bar, strict=True):
                ends = np.stack([place - half, place + half])
                ax.plot(ends[:, across], ends[:, up], color=colour, lw=width)

    for part in PHASES:
        between, ends = _PARTS[2][:2], _PARTS[1][:2]
        draw(part, *(between if abs(part) < 1.0 - 1e-9 else ends))
    draw(0.0, *_PARTS[0][:2])
    reach = 0.5 * float(np.ptp(points[:, [X, Y]], axis=0).max()) + LARGEST + 0.1
    middle = [0.5 * float(points[:, k].min() + points[:, k].max()) for k in (across, up)]
    ax.set(xlim=(middle[0] - reach, middle[0] + reach), ylim=(middle[1] - 0.55 * reach, middle[1] + 0.55 * reach), aspect="equal")
    ax.set(xlabel=f"{'xyz'[across]} in m", ylabel=f"{'xyz'[up]} in m ({seen})")
