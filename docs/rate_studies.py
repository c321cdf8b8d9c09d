"""The design of the rate control behind docs/explanation/rate_control.md: `make figures` prints its table and draws its pictures anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import control
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robomill.cell import palette
from robomill.cell.palette import BLUE, GREEN, ORANGE, PURPLE, RED
from robomill.models.calibration.rate_loop import (
    B_UNDELAYED,
    CANDIDATES,
    CYCLE,
    LOOP_GAIN,
    A,
    continuous_loop,
    critical_gain,
    damping,
    loop_gain,
    sampled_loop,
)

PICTURES = Path(__file__).parent / "pictures"
DEPTHS = (1.0, 2.0, 3.0)
"""Millimetres: those of the step-depth experiment."""
COLOURS = (GREEN, ORANGE, RED)
STYLES = ({"color": "k", "ls": "-"}, {"color": BLUE, "ls": "--"}, {"color": PURPLE, "ls": ":", "lw": 2.0})
"""Lines of the candidates A, B, C."""
TWIN = "B, 4 ms, 2 delays"
SAMPLED: dict[str, tuple[Any, int]] = {
    "A, 4 ms, no delay": (A, 0),
    "A, 4 ms, 1 delay": (A, 1),
    "A, 4 ms, 3 delays": (A, 3),
    "A, 4 ms, 5 delays": (A, 5),
    "A, 4 ms, 12 delays": (A, 12),
    "B, 4 ms, 1 delay": (B_UNDELAYED, 1),
    TWIN: (B_UNDELAYED, 2),
    "B, 4 ms, 3 delays": (B_UNDELAYED, 3),
}
"""Sampled loops: dynamics and delayed steps; B without its dead time."""
GAINS = np.geomspace(15.0, 300.0, 150)
"""1/s; below them nothing oscillates for long."""
LOCUS = np.concatenate([np.linspace(0.0, 30.0, 1500), np.linspace(30.0, 300.0, 300)])
"""1/s; densest where the branches part."""
DURATIONS = (0.4, 0.4, 0.12)
"""Seconds of the step responses at each depth."""


def table() -> None:
    """Critical gains and dampings at 1, 2, 3 mm of all loops."""
    print("| loop | critical K | damping at 1 / 2 / 3 mm |\n|---|---|---|")
    for name, dynamics in CANDIDATES.items():
        found = " / ".join(f"{damping(continuous_loop(dynamics, loop_gain(d))):.3f}" for d in DEPTHS)
        print(f"| {name}, continuous | {critical_gain(dynamics):.1f} | {found} |")
    for name, (dynamics, delays) in SAMPLED.items():
        found = " / ".join(f"{damping(sampled_loop(dynamics, loop_gain(d), delays)):.3f}" for d in DEPTHS)
        print(f"| {name} | {critical_gain(dynamics, delays):.1f} | {found} |")


def root_loci() -> None:
    """Closed-loop poles over the gain: the candidates in the s plane, the loop of the twin in the z plane."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for (name, dynamics), style in zip(CANDIDATES.items(), STYLES, strict=True):
        loci = control.root_locus_map(continuous_loop(dynamics, 1.0), gains=LOCUS).loci
        left.plot(loci.real, loci.imag, **style)
        left.plot([], [], label=name, **style)
    for depth, colour in zip(DEPTHS, COLOURS, strict=True):
        poles = control.feedback(continuous_loop(A, loop_gain(depth)), 1).poles()
        left.plot(poles.real, poles.imag, "o", color=colour, label=f"A at {depth:.0f} mm, K = {loop_gain(depth):.1f}")
    radius = np.array([0.0, 200.0])
    left.plot(-0.7 * radius, np.sqrt(1.0 - 0.49) * radius, color="0.7", linewidth=0.8)
    left.plot(-0.7 * radius, -np.sqrt(1.0 - 0.49) * radius, color="0.7", linewidth=0.8, label="damping 0.7")
    left.axvline(0.0, color="0.5", linewidth=0.8)
    left.set(xlim=(-170, 60), ylim=(-170, 170), xlabel="Re s, 1/s", ylabel="Im s, 1/s", title="Root locus, continuous")
    loci = control.root_locus_map(sampled_loop(B_UNDELAYED, 1.0, 2), gains=LOCUS).loci
    right.plot(loci.real, loci.imag, "k-", linewidth=1.0)
    for depth, colour in zip(DEPTHS, COLOURS, strict=True):
        poles = control.feedback(sampled_loop(B_UNDELAYED, loop_gain(depth), 2), 1).poles()
        right.plot(poles.real, poles.imag, "o", color=colour, label=f"{depth:.0f} mm, K = {loop_gain(depth):.1f}")
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    right.plot(np.cos(turn), np.sin(turn), color="0.5", linewidth=0.8)
    right.set(aspect="equal", xlabel="Re z", ylabel="Im z", title=f"{TWIN}: the loop of the twin")
    for axes in (left, right):
        axes.legend(fontsize=8, loc="lower left")
    figure.savefig(PICTURES / "rate_root_locus.png", dpi=110)


def steps() -> None:
    """Step responses of the closed loops at 1, 2 and 3 mm, gains tuned at 1 mm."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    for axes, depth, duration in zip(figure.subplots(1, len(DEPTHS)), DEPTHS, DURATIONS, strict=True):
        t = np.arange(0.0, duration, 1e-3)
        for (name, dynamics), style in zip(CANDIDATES.items(), STYLES, strict=True):
            response = control.step_response(control.feedback(continuous_loop(dynamics, loop_gain(depth)), 1), t)
            axes.plot(1e3 * t, response.outputs, label=f"{name}, continuous", **style)
        cycles = np.arange(0.0, duration, CYCLE)
        response = control.step_response(control.feedback(sampled_loop(B_UNDELAYED, loop_gain(depth), 2), 1), cycles)
        axes.step(1e3 * cycles, response.outputs, color=RED, where="post", linewidth=1.0, zorder=1.5, label=TWIN)
        axes.set(xlabel="time in ms", title=f"{depth:.0f} mm, K = {loop_gain(depth):.1f} 1/s")
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("force over its reference")
    for axes in figure.axes[:2]:
        axes.set_ylim(-0.5, 2.2)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=4)
    figure.savefig(PICTURES / "rate_steps.png", dpi=110)


def dampings() -> None:
    """Damping over the loop gain: what each delayed step costs."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes: Axes = figure.subplots()
    axes.semilogx(GAINS, [damping(continuous_loop(A, k)) for k in GAINS], "k-", label="A, continuous")
    for i, (name, (dynamics, delays)) in enumerate(SAMPLED.items()):
        axes.semilogx(
            GAINS,
            [damping(sampled_loop(dynamics, k, delays)) for k in GAINS],
            "-" if name == TWIN else "--" if dynamics is A else ":",
            color=palette.CYCLE[i % len(palette.CYCLE)],
            linewidth=3.0 if name == TWIN else 1.4,
            label=name,
        )
    for depth, colour in zip(DEPTHS, COLOURS, strict=True):
        axes.axvline(loop_gain(depth), color=colour, linewidth=0.8)
        axes.text(loop_gain(depth), 1.02, f"{depth:.0f} mm", ha="center", color=colour)
    axes.axhline(0.0, color="0.5", linewidth=0.8)
    axes.set(ylim=(-0.6, 1.0), xlim=(GAINS[0], GAINS[-1]), xlabel="K, 1/s", ylabel="damping ratio")
    marks = [20, 30, 50, 100, 200, 300]
    axes.set_xticks(marks, [str(k) for k in marks])
    axes.set_xticks([], minor=True)
    figure.legend(*axes.get_legend_handles_labels(), fontsize=8, loc="outside right center")
    figure.savefig(PICTURES / "rate_damping.png", dpi=110)


def main() -> None:
    """Everything; K = 28.84 is what the paper sets at 1 mm."""
    print(f"K = {LOOP_GAIN} 1/s at 1 mm")
    table()
    root_loci()
    steps()
    dampings()


if __name__ == "__main__":
    main()
