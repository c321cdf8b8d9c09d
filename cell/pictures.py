"""The pictures that a reader of paper 000 expects, from the results of a milling scenario."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from robomill.cell import part_picture
from robomill.cell.evaluation import Cut, Result, cutting
from robomill.cell.milling import Progress
from robomill.cell.palette import BLUE, CYCLE, GREEN, GREY, ORANGE, RED, SHADE, SKY, STYLES
from robomill.cell.part import is_tridexel
from robomill.cell.scenario import Scenario, Workpiece
from robomill.models.metrology.height_map import cut_height_map
from robomill.models.metrology.surface import SurfaceDeviation
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.runs.picture import Picture
from robomill.orchestration.runs.run import Run

MAP = "RdBu_r"
RELIEF = 4e-4
"""Cell size [m] of the height maps in the pictures."""
LEAST_HEIGHT = 5.2
"""Height [inches] of the maps, at least: what is beside the colour bar needs it."""
DOT = 1.1e-3
"""Size [m] at which a scanned point is drawn."""
EDGE = "gold"
"""Points beside an edge: no colour of MAP, so that nobody reads a deviation from it."""
NO_WAY = 1e-9
"""Way [m] of the tool between two samples up to which it stands, and has no side."""
FEEDING = 1e-3
"""Speed [m/s] from beyond which the tool is fed, and correction and feed are drawn as arrows: slower, it stops at a corner."""
STRIP = 2.0
"""Length over width of a path from above from which on it is drawn below the curves, not beside them."""
DARKEST = 1.6
"""Depth at which a nominal part would be black, over its largest: a part of one depth is grey, not black."""
NOTE: dict[str, Any] = {"boxstyle": "round", "fc": "white", "alpha": 0.8}
COLOURS = {"uncompensated": GREY, "cartesian": BLUE, "axis": ORANGE, "cartesian_pilot": GREEN}


def draw_all(scenario: Scenario, results: Sequence[Result], folder: Path, progress: Progress | None = None) -> list[Path]:
    """Draw every picture of a milling scenario into `folder`; returns the files. Those of all variants need all variants.

    `progress` is told how many variants have theirs.
    """
    assert scenario.workpiece is not None
    files = []
    if len(results) == len(scenario.variants):
        files.append(_save(surfaces(results, scenario.workpiece), folder / "surfaces.png"))
        files.append(_save(deviations(results, scenario.workpiece), folder / "deviation.png"))
    for done, result in enumerate(results):
        if progress is not None:
            progress("pictures", done, len(results))
        files.append(_save(surfaces([result], scenario.workpiece), folder / result.name / "surface.png"))
        files.append(_save(forces(result), folder / result.name / "force.png"))
        files.append(_save(projection(result), folder / result.name / "projection.png"))
        if is_tridexel(result.run):
            title = f"{result.title}: {_headline(result)}"
            files.append(_save(part_picture.draw(result.run, scenario.workpiece, result.surface, title), folder / result.name / "part.png"))
    return files


def _save(figure: Figure, file: Path) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=130)
    return file


def surfaces(results: Sequence[Result], workpiece: Workpiece, nominal: bool = False) -> Figure:
    """Colour maps nominal minus actual workpiece (Figs. 10-13), from above; `nominal`: before them the heights of the nominal part.

    Walls are folded outwards about their top edge: a wall 10 mm high is a band 10 mm wide beside the groove.
    """
    shown = len(results) + nominal
    alone = shown == 1
    columns = 1 if alone else 3 if nominal else 2
    rows = -(-shown // columns)
    size = np.array(workpiece.size[:2]) * 1e3
    width = 8.0 if alone else 4.6 if nominal else 6.4
    figure = Picture(
        figsize=(width * columns + 1.2, max((0.72 * width * size[1] / size[0] + 0.9) * rows, LEAST_HEIGHT)), layout="constrained"
    )
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    limit = 1e3 * max((r.figures.max_deviation_m or 0.0 for r in results), default=0.0) or 1.0
    norm = TwoSlopeNorm(0.0, -limit, limit)
    if nominal:
        _heights(axes[0], results[0], workpiece)
    for ax, result in zip(axes[int(nominal) :], results, strict=False):
        _surface(ax, result, workpiece, norm, DOT * 72.0 * 0.8 * width / workpiece.size[0])
    for ax in axes[shown:]:
        ax.remove()
    bar = figure.colorbar(ScalarMappable(norm, MAP), ax=list(axes[:shown]), shrink=0.8)
    key = "red: material left, blue: gouged; walls folded outwards;\nyellow: beside an edge, not counted; crosses: at least so much"
    if nominal:
        key = "red: material left, blue: gouged; walls folded\noutwards; yellow: beside an edge, not counted;\ncrosses: at least so much"
    bar.set_label("deviation along the surface normal in mm\n(" + key + ")", fontsize=8 if nominal else None)
    return figure


def _surface(ax: Axes, result: Result, workpiece: Workpiece, norm: TwoSlopeNorm, dot: float) -> None:
    nominal = cut_height_map(result.nominal, workpiece.size, RELIEF)
    ax.pcolormesh(1e3 * nominal.x, 1e3 * nominal.y, nominal.height, cmap="Greys_r", alpha=0.35, shading="nearest", rasterized=True)
    if result.surface is None:
        ax.text(0.0, 0.0, "nothing is cut", ha="center", va="center", bbox=NOTE)
    else:
        _deviation(ax, result.surface, norm, dot)
    half = 0.5e3 * np.array(workpiece.size[:2])
    ax.set(aspect="equal", xlim=(-half[0], half[0]), ylim=(-half[1], half[1]), xlabel="x in mm", ylabel="y in mm")
    ax.set_title(f"{result.title}\n{_headline(result)}", fontsize=10)


def _heights(ax: Axes, result: Result, workpiece: Workpiece) -> None:
    """The nominal part, with its depths."""
    cut = cut_height_map(result.nominal, workpiece.size, RELIEF)
    image = ax.pcolormesh(
        1e3 * cut.x,
        1e3 * cut.y,
        1e3 * cut.height,
        cmap="Greys_r",
        vmin=DARKEST * 1e3 * cut.height.min(),
        shading="nearest",
        rasterized=True,
    )
    half = 0.5e3 * np.array(workpiece.size[:2])
    ax.set(aspect="equal", xlim=(-half[0], half[0]), ylim=(-half[1], half[1]), xlabel="x in mm", ylabel="y in mm")
    ax.set_title("nominal part\n(grey: z in mm)", fontsize=10)
    inset = ax.inset_axes((0.04, 0.9, 0.25, 0.04))
    ax.figure.colorbar(image, cax=inset, orientation="horizontal").ax.tick_params(labelsize=7)


def _headline(result: Result) -> str:
    f = result.figures
    if f.max_deviation_m is None or f.rms_deviation_m is None:
        return "no figures"
    at_least = ">= " if f.max_deviation_limited else ""
    return f"max {at_least}{1e3 * f.max_deviation_m:.2f} mm, rms {1e3 * f.rms_deviation_m:.2f} mm"


def _deviation(ax: Axes, s: SurfaceDeviation, norm: TwoSlopeNorm, dot: float) -> None:
    """The measured points in colour, those beside edges in one of their own, limited ones with a cross; the largest with its size."""
    folded = 1e3 * (s.points[:, :2] - np.where(s.wall[:, None], s.normal[:, :2] * (-s.points[:, 2:3]), 0.0))
    style: dict[str, Any] = {"s": dot**2, "marker": "s", "linewidths": 0, "rasterized": True}
    ax.scatter(folded[s.edge, 0], folded[s.edge, 1], color=EDGE, **style)
    order = np.argsort(np.where(s.edge, -1.0, np.abs(s.deviation)))[np.count_nonzero(s.edge) :]
    ax.scatter(folded[order, 0], folded[order, 1], c=1e3 * s.deviation[order], cmap=MAP, norm=norm, **style)
    ended = folded[s.limited & ~s.edge]
    ax.scatter(ended[:, 0], ended[:, 1], c="k", s=dot**2, marker="x", linewidths=0.5, rasterized=True)
    if len(order) == 0:
        return
    worst = folded[s.worst]
    ax.annotate(
        f"{1e3 * s.deviation[s.worst]:+.2f} mm" + (" or more" if s.limited[s.worst] else ""),
        worst,
        xytext=(-18 if worst[0] > 0.0 else 18, 18),  # towards the middle, so that it covers nothing beside the picture
        textcoords="offset points",
        ha="right" if worst[0] > 0.0 else "left",
        arrowprops={"arrowstyle": "->"},
        bbox=NOTE,
    )


def _shade(ax: Axes, cuts: Sequence[Cut], span: float = 0.0) -> None:
    """Grey where the cutter is engaged; darker where it enters and leaves."""
    for i, cut in enumerate(cuts):
        ax.axvspan(cut.start, cut.end, color=SHADE, zorder=0, label="engaged" if i == 0 else None)
        if span > 0.0 and cut.end - cut.start > 2 * span:
            ax.axvspan(cut.start, cut.start + span, color=SKY, alpha=0.35, zorder=0, label="entry" if i == 0 else None)
            ax.axvspan(cut.end - span, cut.end, color=ORANGE, alpha=0.3, zorder=0, label="exit" if i == 0 else None)


def deviations(results: Sequence[Result], workpiece: Workpiece) -> Figure:
    """Deviation of the tool tip along the path, normal to the feed, with entry and exit marked."""
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    sideways, upwards = figure.subplots(2, 1, sharex=True)
    first = results[0]
    span = (
        2.0 * float(first.nominal.radius.max()) / max(1e-9, float(np.median(_speed(first.run)[cutting(first.run)]))) if first.cuts else 0.0
    )
    for ax in (sideways, upwards):
        _shade(ax, first.cuts, 0.5 * span)
    for i, r in enumerate(results):
        side, up = _across(r)
        style: dict[str, Any] = {"color": COLOURS.get(r.name, CYCLE[i % len(CYCLE)]), "ls": STYLES[i % len(STYLES)]}
        # outside the cuts the tool is in the air and its deviation leaves no trace
        in_cut = np.any([(r.run.t >= c.start) & (r.run.t <= c.end) for c in r.cuts], axis=0) if r.cuts else np.zeros(len(r.run), bool)
        for ax, values in ((sideways, side), (upwards, up)):
            ax.plot(r.run.t, np.where(in_cut, 1e3 * values, np.nan), label=r.title, lw=1.4, **style)
            ax.plot(r.run.t, 1e3 * values, lw=0.6, alpha=0.3, **style)
    sideways.set(ylabel="to the left of the feed in mm", title="Deviation of the tool tip from the planned path")
    upwards.set(ylabel="along the tool axis (up) in mm", xlabel="time in s")
    figure.legend(*sideways.get_legend_handles_labels(), fontsize=8, ncols=4, loc="outside lower center")
    if first.cuts:
        upwards.set_xlim(first.cuts[0].start - 0.5, first.cuts[-1].end + 0.5)
    for ax in (sideways, upwards):
        ax.axhline(0.0, color="k", lw=0.5)
    return figure


def _speed(run: Run) -> FloatArray:
    speed: FloatArray = np.linalg.norm(run["path.v_BT_B"], axis=1)
    return speed


def _across(result: Result) -> tuple[FloatArray, FloatArray]:
    """Deviation of the tool tip to the left of the horizontal feed, and upwards, in P [m]."""
    deviation = result.actual.position - result.nominal.position
    step = np.gradient(result.nominal.position[:, :2], axis=0)
    length = np.linalg.norm(step, axis=1)
    left = np.column_stack([-step[:, 1], step[:, 0]]) / np.where(length > NO_WAY, length, np.inf)[:, None]
    return np.sum(deviation[:, :2] * left, axis=1), deviation[:, 2]


def forces(result: Result) -> Figure:
    """Force measured, filtered, pilot, and what the controller used (Fig. 3)."""
    run = result.run
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    ax = figure.subplots()
    _shade(ax, result.cuts)
    size = {
        "cutting force (mean of the step)": (run["milling.f_T_B"], "0.6", 2.2, "-"),
        "measured, compensated and filtered": (run["sensor.f_T_T"], BLUE, 1.4, "-"),
        "pilot (offline, ahead by the lead time)": (run["path.f_pilot_B"], ORANGE, 1.2, "-"),
        "used by the controller": (run["controller.f_used_B"], RED, 1.2, "--"),
    }
    for label, (force, colour, width, style) in size.items():
        ax.plot(run.t, np.linalg.norm(force, axis=1), color=colour, lw=width, ls=style, label=label)
    if np.any(run["controller.pilot_blend"] > 0.0):
        blend = ax.twinx()
        blend.fill_between(run.t, run["controller.pilot_blend"], color=RED, alpha=0.12, lw=0)
        ax.fill_between([], [], color=RED, alpha=0.12, lw=0, label="pilot blend (right axis)")
        blend.set(ylim=(0, 1), ylabel="pilot blend, 0 to 1")
    ax.set(xlabel="time in s", ylabel="force magnitude in N", title=f"Force signals: {result.title}")
    if result.cuts:
        ax.set_xlim(result.cuts[0].start - 0.5, result.cuts[-1].end + 0.5)
    figure.legend(fontsize=8, loc="outside lower center", ncols=3)  # entry and exit, to be seen, fill the corners of the axes
    return figure


def projection(result: Result) -> Figure:
    """Correction before and after the projection normal to the feed (Fig. 4), in base coordinates and as arrows from above."""
    run = result.run
    p, v = run["path.p_BT_B"], run["path.v_BT_B"]
    r, r_v = run["controller.r_B"], run["controller.r_v_B"]
    feeding = np.flatnonzero(cutting(run) & (_speed(run) > FEEDING))
    chosen = feeding[:: max(1, len(feeding) // 60)]
    tips = np.vstack([p[chosen, :2], p[chosen, :2] + 0.25 * v[chosen, :2], p[chosen, :2] + 10.0 * r[chosen, :2]])
    (left, right), (low, high) = (_range(tips[:, i]) if len(chosen) > 0 else (-1.0, 1.0) for i in range(2))
    figure = Figure(figsize=(11, 6), layout="constrained")
    grid: Any
    if right - left > STRIP * (high - low):
        grid = figure.subplot_mosaic([["x"], ["y"], ["z"], ["top"], ["key"]], height_ratios=[1, 1, 1, 1.3, 0.15])
    else:
        grid = figure.subplot_mosaic([["x", "top"], ["y", "top"], ["z", "key"]], width_ratios=[6, 5])
    for i, axis in enumerate("xyz"):
        ax = grid[axis]
        _shade(ax, result.cuts)
        ax.plot(run.t, 1e3 * r[:, i], color=GREEN, lw=2.2, label="before")
        ax.plot(run.t, 1e3 * r_v[:, i], color=RED, lw=1.2, ls="--", label="after")
        ax.set_ylabel(f"{axis} in mm")
        if result.cuts:
            ax.set_xlim(result.cuts[0].start - 0.5, result.cuts[-1].end + 0.5)
    grid["x"].set_title(f"Correction before and after the projection: {result.title}", fontsize=10)
    grid["z"].set_xlabel("time in s")
    ax = grid["top"]
    ax.plot(1e3 * p[feeding, 0], 1e3 * p[feeding, 1], ".", color="0.8", ms=1)
    for vectors, colour, label, scale in (
        (v, BLUE, "feed", 0.25),
        (r, GREEN, "correction x 10", 10),
        (r_v, RED, "projected x 10", 10),
    ):
        ax.quiver(
            *(1e3 * p[chosen, :2].T),
            *(1e3 * scale * vectors[chosen, :2].T),
            color=colour,
            angles="xy",
            scale_units="xy",
            scale=1,
            width=0.004,
            label=label,
        )
    ax.set(xlabel="x of the base in mm", ylabel="y of the base in mm", title="from above")
    ax.set(xlim=(1e3 * left, 1e3 * right), ylim=(1e3 * low, 1e3 * high))
    ax.set_aspect("equal")
    handles, labels = (a + b for a, b in zip(grid["x"].get_legend_handles_labels(), ax.get_legend_handles_labels(), strict=True))
    grid["key"].axis("off")
    grid["key"].legend(handles, labels, fontsize=8, loc="center", ncols=6 if right - left > STRIP * (high - low) else 2)
    return figure


def _range(values: FloatArray, least: float = 0.02) -> tuple[float, float]:
    """Bounds [m] that hold the values with room around them; a path straight along an axis gets `least` of width."""
    middle, half = 0.5 * (values.min() + values.max()), 0.5 * (values.max() - values.min())
    half = max(1.15 * half, 0.5 * least)
    return middle - half, middle + half


def load_cases(magnitudes: dict[str, FloatArray], titles: dict[str, str], paper: dict[str, float]) -> Figure:
    """Displacement in the 60 load cases as bars, in the order of Fig. 9; dashed: means that the paper's text gives."""
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    ax = figure.subplots()
    n = len(magnitudes)
    width = 0.8 / n
    for i, (name, size) in enumerate(magnitudes.items()):
        cases = np.arange(1, len(size) + 1)
        ax.bar(
            cases + (i - 0.5 * (n - 1)) * width,
            1e3 * size,
            width,
            color=CYCLE[i % len(CYCLE)],
            label=f"{titles[name]} (mean {1e3 * size.mean():.2f} mm)",
        )
        if name in paper:
            ax.axhline(
                1e3 * paper[name], color=CYCLE[i % len(CYCLE)], ls="--", lw=1.0, label=f"mean in the paper: {1e3 * paper[name]:.2f} mm"
            )
    for start, text in ((1, "load in +x"), (21, "load in +y"), (41, "load in -z")):
        ax.axvline(start - 0.5, color="k", lw=0.6)
        ax.text(start, 0.99, text, va="top", fontsize=9, transform=ax.get_xaxis_transform())
    ax.set(xlabel="measurement (4 positions x 5 orientations per direction)", ylabel="displacement of the tool tip in mm", xlim=(0, 61))
    ax.set_title("Static load of 750 N")
    ax.set_ylim(0.0, 1.12e3 * max(size.max() for size in magnitudes.values()))
    figure.legend(fontsize=8, loc="outside lower center", ncols=4)
    return figure
