"""Pictures of docs/explanation/deformation.md: ``python -m docs.deformation_study``. Overcut over the directions of feed, scans of both."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure

from robomill.cell import milling, scan
from robomill.cell.evaluation import Result, evaluate
from robomill.cell.palette import BLUE, ORANGE
from robomill.cell.scenario import Scenario, Variant, load_scenario

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
DIRECTIONS = range(0, 360, 45)
FACTS = {0: 0.28, 45: 0.44, 90: 0.31, 135: -0.02, 180: -0.32, 225: -0.42, 270: -0.30}
"""FACTS10 10.1 [mm]; it has no value for 315 deg."""
PLANE = -3e-3
"""Height [m] of the programmed plane."""
FULL = (-60e-3, 30e-3)
"""Places x [m] of the tool in which all of its front is in the block."""


def run(scenario: Scenario, variant: Variant, folder: Path) -> Result:
    """One variant, milled and evaluated."""
    assert scenario.workpiece is not None
    job = milling.prepare(replace(scenario, variants=(variant,)), folder)
    return evaluate(variant.name, variant.title, milling.mill(job, variant)[0], scenario.workpiece, 1.0)


def overcut(result: Result) -> float:
    """Mean depth of the tip below the programmed plane [mm]."""
    x, _, z = result.actual.position.T
    inside = (x > FULL[0]) & (x < FULL[1]) & (z < 0.5 * PLANE)
    return 1e3 * float(np.mean(PLANE - z[inside]))


def directions(folder: Path) -> tuple[list[float], list[float]]:
    """Overcut [mm] by direction of feed: position control, deformation compensation."""
    scenario = load_scenario(ROOT / "scenarios" / "irb6400" / "end_milling.toml")
    assert scenario.workpiece is not None
    found: dict[str, list[float]] = {"position_control": [], "compensated": []}
    for degrees in DIRECTIONS:
        turned = replace(scenario, workpiece=replace(scenario.workpiece, abc=(np.deg2rad(degrees), 0.0, 0.0)))
        for name, values in found.items():
            chosen = next(v for v in scenario.variants if v.name == name)
            values.append(overcut(run(turned, chosen, folder / f"{degrees}_{name}")))
            sys.stdout.write(f"{degrees} deg, {name}: {values[-1]:+.3f} mm\n")
    return found["position_control"], found["compensated"]


def main() -> None:
    """Entry point."""
    with TemporaryDirectory() as place:
        before, after = directions(Path(place))
        figure = Figure(figsize=(8, 4), layout="constrained")
        ax = figure.subplots()
        ax.plot(DIRECTIONS, before, "o-", color=BLUE, label="position control")
        ax.plot(DIRECTIONS, after, "s-", color=ORANGE, label="deformation compensation")
        ax.plot(list(FACTS), list(FACTS.values()), "kx", label="independent calculation")
        ax.axhline(0.0, color="k", lw=0.5)
        ax.set(xlabel="direction of feed from x of the robot base in deg", ylabel="overcut in mm", xticks=list(DIRECTIONS))
        ax.legend()
        figure.savefig(PICTURES / "deformation_directions.png", dpi=90)
        for name in ("end_milling", "cylinder_head"):
            scenario = load_scenario(ROOT / "scenarios" / "irb6400" / f"{name}.toml")
            results = [run(scenario, v, Path(place) / name / v.name) for v in scenario.variants]
            found = [scan.surface(scenario, r) for r in results]
            for result in results:
                sys.stdout.write(f"{name}, {result.title}: {scan.text(scan.scanned(scenario, result), {})}\n")
            drawn = scan.profiles(results, found) if name == "end_milling" else scan.maps(results, found)
            drawn.savefig(PICTURES / f"deformation_{name}.png", dpi=90)


if __name__ == "__main__":
    main()
