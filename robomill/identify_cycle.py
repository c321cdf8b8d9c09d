"""`robomill identify cycle|backlash`: stiffness, hysteresis and gap of an axis from load/unload cycles."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from robomill.cell.palette import BLUE, RED
from robomill.identify_report import finite, keep
from robomill.measured_set import MeasuredSetError, Quantity, read_measured, read_signals, says
from robomill.models.calibration.load_cycle import CONFIDENCE, CycleFit, GapFit, Slope, fit_cycle, fit_gap
from robomill.models.calibration.stiffness import SPRINGS, screws, tilts
from robomill.models.model.declaration import FloatArray
from robomill.option_types import add_machine
from robomill.orchestration.errors import unknown
from robomill.orchestration.runs.run import read_info

LOADED = (
    Quantity("q", "rad", 6, ("q_link", "q", "q_motor")),
    Quantity("force", "N", 3, ("f_T_B",)),
    Quantity("moment", "N.m", 3, ("m_T_B",), needed=False),
    Quantity("displacement", "m", 3, ("d_T_B",)),
)
"""Load on the tool, and displacement of its tip against the link before the axis."""
AXIS = (Quantity("torque", "N.m", 1, ("torque",)), Quantity("angle", "rad", 1, ("angle",)))
"""Torque about the axis and the angle that it turns by, where these are measured."""
STILL = 1e-3
"""Motion [rad] of the axes during a cycle from which on the robot does not hold its pose: a tenth of a degree would change no lever."""
LEVER = 1e-3
"""Distance [m] of the tool tip from the axis below which a displacement says nothing of its angle."""
DONE, UNSURE = 0, 1
PLACES = {s.name: s for s in (*SPRINGS, *tilts(range(1, 7)))}


@dataclass(frozen=True)
class Loops:
    """What was measured of one spring."""

    source: Path
    name: str
    torque: FloatArray
    angle: FloatArray


def add_arguments(kinds: Any) -> None:
    """`cycle` and `backlash` below `robomill identify`."""
    cycle = kinds.add_parser(
        "cycle",
        help="stiffness and hysteresis of axes from load/unload cycles",
        description="Identify stiffness and hysteresis of an axis from load/unload cycles: which slope is which is said.",
        epilog="Example: robomill identify cycle results/load_cycle/cycle-1 --spring A6 --out results/cycle",
    )
    backlash = kinds.add_parser(
        "backlash",
        help="gap of an axis from a small load/unload cycle",
        description="Identify the gap of an axis from a load/unload cycle so small that friction does not slip.",
        epilog="Example: robomill identify backlash results/load_cycle/small-cycle-1 --spring A6",
    )
    for kind in (cycle, backlash):
        kind.add_argument("measured", type=Path, nargs="+", metavar="RUN", help="run folders, or TOML files over columns, one per axis")
        kind.add_argument(
            "--spring", action="append", default=[], metavar="NAME", help='"A6", "A3 tilt x": what is loaded, in the order of the runs'
        )
        add_machine(kind)
        kind.add_argument("--out", type=Path, metavar="DIR", help="write report.json, report.txt and the loops as pictures")


def run_cycle(options: Namespace) -> int:
    """`robomill identify cycle`: a table of slopes per axis."""
    pictures, found, lines = {}, [], []
    for loops in _read(options):
        with _blamed(loops):
            fit = fit_cycle(loops.torque, loops.angle)
        found.append({"name": loops.name, "source": str(loops.source), **_cycle(fit)})
        pictures[_file(loops)] = draw_cycle(loops, fit)
        lines += _say_cycle(loops, fit)
    _show(options, {"cycles": found}, lines, pictures)
    return DONE


def run_backlash(options: Namespace) -> int:
    """`robomill identify backlash`: gap with interval; status 1 where it is not determined."""
    pictures, found, lines = {}, [], []
    for loops in _read(options):
        with _blamed(loops):
            fit = fit_gap(loops.torque, loops.angle)
        found.append(
            {
                "name": loops.name,
                "source": str(loops.source),
                "gap_rad": fit.gap,
                "interval_rad": list(fit.interval),
                "probability": CONFIDENCE,
                "stiffness_nm_per_rad": fit.slope,
                "width_rad": fit.width,
                "branches_rad": fit.branches.tolist(),
                "finding": fit.finding,
            }
        )
        pictures[_file(loops)] = draw_gap(loops, fit)
        low, high = (1e6 * x for x in fit.interval)
        lines.append(
            f"{loops.name}: gap {1e6 * fit.gap:.1f} urad, {low:.1f} to {high:.1f} with {100 * CONFIDENCE:.0f} %, of {len(fit.branches)} "
            f"branches; {1e-5 * fit.slope:.3g}e5 N.m/rad beside it, loop {1e6 * fit.width:.1f} urad wide at zero torque: {fit.finding}"
        )
    _show(options, {"gaps": found}, lines, pictures)
    return DONE if all(g["finding"] == "determined" for g in found) else UNSURE


@contextmanager
def _blamed(loops: Loops) -> Iterator[None]:
    """ValueError of a fit becomes one that says which measurement."""
    try:
        yield
    except ValueError as error:
        raise MeasuredSetError(f"{loops.source}, {loops.name}: {error}") from error


def _read(options: Namespace) -> list[Loops]:
    if len(options.spring) > len(options.measured):
        raise MeasuredSetError(f"{len(options.spring)} --spring for {len(options.measured)} runs; expected one per run, in their order")
    return [
        _loops(source, options.spring[i] if i < len(options.spring) else None, options.robot, options.tool)
        for i, source in enumerate(options.measured)
    ]


def _loops(source: Path, spring: str | None, robot: str | None, tool: str | None) -> Loops:
    """Torque and angle of the spring: as measured, or from load and displacement by its lever."""
    if says(source, "torque"):
        signals = read_signals(source, AXIS)
        return Loops(source, spring or source.stem, signals["torque"][:, 0], signals["angle"][:, 0])
    name = spring or (str(read_info(source).get("labels", {}).get("condition", "")) if source.is_dir() else "")
    if name not in PLACES:
        raise MeasuredSetError(f"{source}: {unknown('spring', name, PLACES)}; give --spring, or name the condition after it")
    measured = read_measured([source], LOADED, robot, tool)
    v = measured.values
    moved = np.ptp(v["q"], axis=0)
    if moved.max() > STILL:
        raise MeasuredSetError(
            f"{source}: A{int(np.argmax(moved)) + 1} moves by {1e3 * moved.max():.3g} mrad during the cycle, expected at most "
            f"{1e3 * STILL:g}: let the robot hold its pose"
        )
    screw = screws(measured.robot, measured.tool, v["q"].mean(axis=0)[None], (PLACES[name],), measured.coupled)[0, 0]
    torque = np.concatenate([v["force"], v["moment"]], axis=1) @ screw
    lever = float(np.linalg.norm(screw[:3]))
    if lever < LEVER:
        raise MeasuredSetError(
            f"{source}: the tool tip is {1e3 * lever:.2f} mm from the axis of {name}, so its displacement does not say the angle; "
            f"measure with a lever of {1e3 * LEVER:.0f} mm or more, or give torque and angle"
        )
    return Loops(source, name, torque, v["displacement"] @ screw[:3] / lever**2)


def _cycle(fit: CycleFit) -> dict[str, Any]:
    def slope(s: Slope) -> dict[str, float | None]:
        return {"value": s.value, "error": finite(s.error)}

    return {
        "stiffness_nm_per_rad": {
            "whole_cycle": slope(fit.whole),
            "loading_end": slope(fit.loading_end),
            "unloading_start": slope(fit.unloading_start),
        },
        "amplitude_nm": fit.amplitude,
        "twist_rad": fit.twist,
        "width_rad": fit.width,
        "hysteresis": fit.hysteresis,
        "work_j": fit.work,
        "friction_nm": fit.friction,
        "half_cycles": len(fit.half_cycles),
    }


def _say_cycle(loops: Loops, fit: CycleFit) -> list[str]:
    return [
        f"{loops.name}: {len(fit.half_cycles)} half cycles to {fit.amplitude:.4g} N.m, {1e3 * fit.twist:.3g} mrad in all",
        f"  whole cycle      {1e-5 * fit.whole.value:6.3f}e5 N.m/rad   line through all samples: for a model without hysteresis",
        f"  loading end      {1e-5 * fit.loading_end.value:6.3f}e5 N.m/rad   friction slips: the spring of a model with hysteresis",
        f"  unloading start  {1e-5 * fit.unloading_start.value:6.3f}e5 N.m/rad   friction sticks: what small vibrations see",
        f"  {1e6 * fit.width:.0f} urad wide at zero torque, gap included, {100 * fit.hysteresis:.1f} % of the twist; {fit.work:.3g} J per "
        f"cycle, friction {fit.friction:.3g} N.m or more",
    ]


def _show(options: Namespace, result: dict[str, Any], lines: list[str], pictures: dict[str, Figure]) -> None:
    if options.out is not None:
        keep(options.out, result, lines, pictures)
    if getattr(options, "json", False):
        print(json.dumps(result))
        return
    print("\n".join(lines))
    if options.out is not None:
        print(f"{options.out}: report.json, report.txt, {', '.join(f'{name}.png' for name in pictures)}")


def _file(loops: Loops) -> str:
    return f"{loops.source.stem}-{loops.name}".replace(" ", "_").replace("/", "_")


def draw_cycle(loops: Loops, fit: CycleFit) -> Figure:
    """The loop with its three slopes."""
    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    ax = figure.subplots()
    ax.plot(1e3 * loops.angle, loops.torque, color="0.65", lw=1.0, label="measured")
    middle = float(np.mean([loops.angle[a : b + 1].mean() for a, b in fit.half_cycles]))
    half = 0.5 * fit.twist
    first, last = fit.half_cycles[0]
    top = last if loops.torque[last] > loops.torque[first] else first
    x = np.array([-half, half])
    ax.plot(
        1e3 * (middle + x), fit.whole.value * x, color="k", ls="--", lw=1.0, label=f"whole cycle {1e-5 * fit.whole.value:.2f}e5 N m/rad"
    )
    for slope, colour, name in ((fit.loading_end, BLUE, "loading end"), (fit.unloading_start, RED, "unloading start")):
        reach = min(0.45 * fit.twist, 0.7 * fit.amplitude / slope.value)
        away = np.array([0.0, -reach])
        ax.plot(
            1e3 * (loops.angle[top] + away),
            loops.torque[top] + slope.value * away,
            color=colour,
            lw=1.4,
            label=f"{name} {1e-5 * slope.value:.2f}e5 N m/rad",
        )
    ax.axhline(0.0, color="0.85", lw=0.8, zorder=0)
    ax.set(xlabel="angle in mrad", ylabel="torque in N m", title=f"{loops.name}: {1e6 * fit.width:.0f} urad wide at zero torque")
    ax.legend(fontsize=8, loc="upper left")
    return figure


def draw_gap(loops: Loops, fit: GapFit) -> Figure:
    """The small loop, and what it is without its spring, with the gap."""
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    loop, step = figure.subplots(1, 2)
    loop.plot(1e6 * loops.angle, loops.torque, color="0.5", lw=0.9, label="measured")
    loop.legend(fontsize=8, loc="upper left")
    loop.set(xlabel="angle in urad", ylabel="torque in N m", title=f"{loops.name}: small cycle")
    rest = loops.angle - loops.torque / fit.slope
    rest = rest - 0.5 * (np.median(rest[loops.torque > 0.0]) + np.median(rest[loops.torque < 0.0]))
    step.plot(loops.torque, 1e6 * rest, ".", color="0.4", ms=3.0, label="angle without the spring")
    low, high = (0.5e6 * x for x in fit.interval)
    for sign in (1.0, -1.0):
        step.axhspan(min(sign * low, sign * high), max(sign * low, sign * high), color=RED, alpha=0.25, lw=0.0)
        step.axhline(sign * 0.5e6 * fit.gap, color=RED, lw=1.0, label=f"gap {1e6 * fit.gap:.1f} urad" if sign > 0.0 else None)
    step.set(
        xlabel="torque in N m", ylabel="angle in urad", title=f"{2.0 * low:.1f} to {2.0 * high:.1f} urad with {100 * CONFIDENCE:.0f} %"
    )
    step.legend(fontsize=8, loc="center right")
    return figure
