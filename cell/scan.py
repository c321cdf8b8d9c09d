"""Scan of a faced block, as paper 003 measures its parts (sec. 5.4): how much too deep the surface is, and from where to where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robomill.cell.evaluation import Figures, Result
from robomill.cell.palette import CYCLE, STYLES
from robomill.cell.scenario import Scenario
from robomill.models.metrology.faced_surface import FacedSurface, beside_openings, faced_surface
from robomill.orchestration.runs.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPACING = 1e-3
"""Distance [m] of the scanned points."""
SHIM = 0.1
"""Steps [mm] by which the paper brings the tool closer to the painted surface; the colours of the map change with them."""
FIGURES = {"mean": "surface_error_mean_m", "touch": "surface_touch_m", "clean": "surface_clean_m", "total": "surface_total_m"}
"""Property of the surface -> figure in summary.json; positive: too deep."""


@dataclass(frozen=True)
class ScanFigures(Figures):
    """Figures of a variant with those of the scan [m]; None where nothing was faced."""

    surface_error_mean_m: float | None = None
    surface_touch_m: float | None = None
    surface_clean_m: float | None = None
    surface_total_m: float | None = None


def scanned(scenario: Scenario, result: Result) -> Result:
    """The result with the figures of the scan; None where nothing was faced."""
    found = surface(scenario, result) if result.cuts else None
    figures = {key: None if found is None else getattr(found, name) for name, key in FIGURES.items()}
    return replace(result, figures=ScanFigures(**vars(result.figures), **figures))


def surface(scenario: Scenario, result: Result) -> FacedSurface:
    """What the scan of a milled variant gives. ValueError if nothing was faced."""
    assert scenario.scan is not None
    assert scenario.workpiece is not None
    length, width, _ = scenario.workpiece.size
    found = faced_surface(result.actual, (length - 2.0 * scenario.scan.margin, width), -scenario.scan.depth, SPACING)
    diameter, pitch = _openings(result.run)
    return found.where(beside_openings(found.x, found.y, diameter, pitch)) if diameter > 0.0 else found


def _openings(run: Run) -> tuple[float, tuple[float, float]]:
    """Diameter and pitch [m] of the openings of the stock; 0 if it has none."""
    given = run.info.get("parameters", {}).get("milling", {})
    return float(given.get("opening_diameter", 0.0)), (float(given.get("opening_pitch[1]", 1.0)), float(given.get("opening_pitch[2]", 1.0)))


def text(result: Result, paper: Mapping[str, float]) -> str:
    """The figures of the scan in words, published ones in brackets."""
    ours = {key: getattr(result.figures, key) for key in FIGURES.values()}
    if ours[FIGURES["mean"]] is None:
        return "surface: nothing faced"
    parts = []
    for name, key in FIGURES.items():
        published = f" ({1e3 * paper[key]:+.1f})" if key in paper else ""
        parts.append(f"{name} {1e3 * ours[key]:+.2f}{published}")
    return f"surface error in mm, + too deep: {', '.join(parts)}"


def draw(scenario: Scenario, results: Sequence[Result], folder: Path) -> list[Path]:
    """Draw the scans of all variants (Fig. 17) and their profiles (Figs. 18-20) into `folder`; returns the files."""
    there = [r for r in results if r.cuts]
    if not there:
        return []
    found = [surface(scenario, r) for r in there]
    files = [folder / "scan_profile.png", folder / "scan_map.png"]
    profiles(there, found).savefig(files[0], dpi=130)
    maps(there, found).savefig(files[1], dpi=130)
    return files


def profiles(results: Sequence[Result], found: Sequence[FacedSurface]) -> Figure:
    """Error along the middle line of the block, as a laser sensor scans it (Figs. 18-20)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    ax = figure.subplots()
    for i, (result, each) in enumerate(zip(results, found, strict=True)):
        style: dict[str, Any] = {"color": CYCLE[i % len(CYCLE)], "ls": STYLES[i % len(STYLES)]}
        row = each.along(_lane(each))
        ax.plot(
            1e3 * each.x, -1e3 * row, lw=max(3.0 - 0.5 * i, 1.0), label=f"{result.title}: mean {1e3 * np.nanmean(row):+.2f} mm", **style
        )
    ax.axhline(0.0, color="k", lw=0.5)
    ax.set(xlabel="x in mm", ylabel="surface above programmed plane in mm", title="Laser scan of the finished surface")
    ax.legend(fontsize=8)
    return figure


def _lane(each: FacedSurface) -> float:
    """Place y [m] of the row with the most material that is nearest to the middle of the block."""
    there = np.sum(~np.isnan(each.error), axis=1)
    full = np.flatnonzero(there == there.max())
    return float(each.y[full[np.argmin(np.abs(each.y[full]))]])


def maps(results: Sequence[Result], found: Sequence[FacedSurface]) -> Figure:
    """Error of the whole surface in steps of the shim (Fig. 17): where the tool touches first, and where the paint goes last."""
    from matplotlib.figure import Figure

    low = min(f.touch for f in found)
    high = max(f.clean for f in found)
    levels = SHIM * np.arange(np.floor(1e3 * low / SHIM), np.ceil(1e3 * high / SHIM) + 1.0)
    figure = Figure(figsize=(9, 0.6 + 2.6 * len(found)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(found), 1, sharex=True))
    for ax, result, each in zip(axes, results, found, strict=True):
        drawn = ax.contourf(1e3 * each.x, 1e3 * each.y, 1e3 * each.error, levels=levels, cmap="cividis")
        ax.set(aspect="equal", ylabel="y in mm")
        ax.set_title(f"{result.title}: touches at {1e3 * each.touch:+.2f}, clean at {1e3 * each.clean:+.2f} mm", fontsize=10)
    axes[-1].set_xlabel("x in mm")
    figure.colorbar(drawn, ax=list(axes), shrink=0.8).set_label("surface error in mm, + too deep (white: nothing scanned)")
    return figure
