"""Pictures of an impact test: frequency responses with coherence, and mode shapes on the robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from robomill.models.calibration.hammer import Response
from robomill.models.calibration.modal_fit import ModalFit
from robomill.models.calibration.mode_shapes import ModeShapes

SHOWN = 50.0
"""Hz: peaks from 0 to 50 Hz are what the thesis shows and fits."""
LARGEST = 0.3
"""Largest motion in a picture of a mode [m]."""
PHASES = np.cos(np.linspace(0.0, np.pi, 5))
COLUMNS = 3


def draw_responses(responses: Sequence[Response], fit: ModalFit) -> Figure:
    """Inertance along each blow, measured and fitted, with the modes; coherence below (Fig. 3.4)."""
    figure = Figure(figsize=(3.4 * len(responses) + 0.6, 4.8), layout="constrained")
    axes = np.reshape(figure.subplots(2, len(responses), sharex=True, height_ratios=[3, 1], squeeze=False), (2, -1))
    for n, (r, fitted) in enumerate(zip(responses, fit.fitted, strict=True)):
        d, (above, below) = r.direction, axes[:, n]
        above.semilogy(r.frequency, np.abs(r.inertance[:, d]), color="0.6", lw=1.6, label="measured")
        above.semilogy(r.frequency, np.abs(fitted[:, d]), color="tab:blue", lw=1.0, label="rational fit")
        for m in fit.modes:
            if m.frequency < SHOWN:
                above.axvline(m.frequency, color="tab:red", lw=0.6, ls=":", label="modes" if m is fit.modes[0] else None)
        name = "xyz"[d]
        above.set(title=f"H_{name}{name}, {r.blows} blows of {r.peak:.0f} N", xlim=(0.0, SHOWN))
        below.plot(r.frequency, r.coherence[:, d], color="0.3", lw=0.8)
        below.set(xlabel="frequency in Hz", ylim=(0.0, 1.05))
    axes[0, 0].set_ylabel("inertance in m/s2/N")
    axes[1, 0].set_ylabel("coherence")
    axes[0, 0].legend(fontsize=8, loc="lower right")
    return figure


def draw_shapes(shapes: ModeShapes, chosen: Sequence[int], titles: Sequence[str]) -> Figure:
    """The arm in the chosen modes of the model at five phases of the vibration, each seen so that it moves most: from the side or above."""
    rows = max(-(-len(chosen) // COLUMNS), 1)
    figure = Figure(figsize=(3.6 * COLUMNS, 2.6 * rows + 0.2), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    reach = 0.5 * float(np.ptp(shapes.points[:, :2], axis=0).max()) + LARGEST + 0.1
    for ax in panels[len(chosen) :]:
        ax.axis("off")
    for ax, mode, title in zip(panels, chosen, titles, strict=False):
        motion = shapes.motion[mode]
        motion = motion * LARGEST / max(float(np.linalg.norm(motion, axis=1).max()), 1e-12)
        across = 2 if np.abs(motion[:, 2]).max() > np.abs(motion[:, 1]).max() else 1
        for phase in PHASES:
            moved = shapes.points + phase * motion
            between = abs(phase) < 1.0 - 1e-9
            ax.plot(moved[:, 0], moved[:, across], color="0.8" if between else "tab:blue", lw=1.0 if between else 1.8, marker="o", ms=2.5)
        ax.plot(shapes.points[:, 0], shapes.points[:, across], color="k", lw=1.0, marker="o", ms=2.5)
        middle = [0.5 * float(shapes.points[:, k].min() + shapes.points[:, k].max()) for k in (0, across)]
        half = 0.55 * reach
        ax.set(xlim=(middle[0] - reach, middle[0] + reach), ylim=(middle[1] - half, middle[1] + half), aspect="equal", xlabel="x in m")
        ax.set_ylabel("z in m (side)" if across == 2 else "y in m (above)")
        ax.set_title(title, fontsize=9)
    return figure
