"""`robomill place`: where workpiece and spindle bend the robot least."""

from __future__ import annotations

import json
import math
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robomill.files import vacant
from robomill.option_types import add_overwrite, in_unit

if TYPE_CHECKING:
    from robomill.cell.placement import Placing

_FREE = "x,y,z,turn,spindle"


def add_arguments(parser: Any) -> None:
    """What is placed, and how far it may go."""
    parser.add_argument("file", type=Path, metavar="SCENARIO", help="milling scenario")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default: results/NAME_placed)")
    parser.add_argument(
        "--range",
        nargs=3,
        type=in_unit("mm"),
        default=(300.0, 300.0, 300.0),
        metavar=("X", "Y", "Z"),
        help="how far the workpiece may go from where it is, both ways, mm (default: 300 300 300)",
    )
    parser.add_argument("--free", default=_FREE, metavar="LIST", help=f"what may change, of {_FREE} (default: all)")
    parser.add_argument("--no-mill", action="store_true", help="do not simulate the program at both places")
    parser.add_argument("--no-pictures", action="store_true", help="skip the map")
    add_overwrite(parser)


def run(options: Namespace) -> int:
    """Search, write the lines of the scenario and the map, and mill both."""
    import numpy as np

    from robomill.cell import placement
    from robomill.cell.scenario import load_scenario
    from robomill.orchestration.runs.lock import FolderLock
    from robomill.progress import progress_bar

    scenario = load_scenario(options.file)
    folder = options.out or Path("results") / f"{scenario.name}_placed"
    if not options.overwrite:
        vacant(folder / "place.json")
    folder.mkdir(parents=True, exist_ok=True)
    span = [1e-3 * v for v in options.range]
    with progress_bar(options.json) as report, FolderLock(folder):
        found = placement.place(scenario, folder, span, [v.strip() for v in options.free.split(",")], report)
        reached = found.present_m < placement.OUT_OF_REACH
        figures: dict[str, Any] = {
            "scenario": scenario.name,
            "criterion": "displacement of the tool tip under the program's forces, in the cut, rms, m",
            "free": list(found.free),
            "evaluations": found.evaluations,
            "present": {**_values(placement.VARIABLES, found.present), "criterion_m": found.present_m if reached else None},
            "best": {**_values(placement.VARIABLES, found.best), "criterion_m": found.best_m},
            "axis_margin_rad": np.round(found.margin, 6).tolist(),
        }
        (folder / "place.toml").write_text(placement.toml_lines(found), encoding="utf-8")
        if not options.no_mill:
            figures["best"]["milled_m"] = placement.milled(placement.placed(scenario, found.best), folder / "best", progress=report)
            figures["present"]["milled_m"] = placement.milled(scenario, folder / "present", progress=report) if reached else None
        (folder / "place.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
        if not options.no_pictures:
            from robomill.cell import placement_pictures

            placement_pictures.draw(found, folder / "place.png")
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        _show(found, figures, folder, placement.toml_lines(found))
    return 0


def _values(names: tuple[str, ...], values: Any) -> dict[str, float]:
    units = {"x": "m", "y": "m", "z": "m", "turn": "rad", "spindle": "rad"}
    return {f"{n}_{units[n]}": float(v) for n, v in zip(names, values, strict=True)}


def _show(found: Placing, figures: dict[str, Any], folder: Path, lines: str) -> None:
    print("displacement of the tool tip in the cut, rms, mm")
    for name in ("present", "best"):
        f = figures[name]
        said = ", ".join(f"{v} {f[f'{v}_m'] * 1e3:.1f} mm" for v in "xyz")
        said += "".join(f", {v} {math.degrees(f[f'{v}_rad']):.1f} deg" for v in ("turn", "spindle"))
        criterion = "out of limits" if f["criterion_m"] is None else f"{1e3 * f['criterion_m']:.4f}"
        milled = f", milled {1e3 * f['milled_m']:.4f}" if f.get("milled_m") is not None else ""
        print(f"  {name}: {criterion}{milled}; {said}")
    least = math.degrees(min(found.margin))
    print(f"{found.evaluations} placements looked at; smallest distance of an axis from its limit {least:.1f} deg")
    print(f"for the scenario (also in {folder / 'place.toml'}):\n{lines}", end="")
