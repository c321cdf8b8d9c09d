"""`robomill identify stations`: stiffness of the whole robot at stations of its work space, measured against springs."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from robomill.cell.palette import BLUE
from robomill.identify_report import columns, finite, keep
from robomill.measured_set import MeasuredSet, MeasuredSetError, Quantity, read_measured
from robomill.models.calibration.stations import Stations, stations
from robomill.models.calibration.stiffness import Loads
from robomill.models.model.parameters import load
from robomill.models.robot.virtual_joints import Compliance, load_compliance
from robomill.option_types import add_machine

PUSHES = (
    Quantity("q", "rad", 6, ("q_link", "q", "q_motor")),
    Quantity("force", "N", 3, ("f_T_B",)),
    Quantity("moment", "N.m", 3, ("m_T_B",), needed=False),
    Quantity("displacement", "m", 3, ("d_T_B",)),
)
DONE = 0


def add_arguments(kinds: Any) -> None:
    """`stations` below `robomill identify`."""
    kind = kinds.add_parser(
        "stations",
        help="stiffness at stations of the work space against springs, with and without tilt",
        description="Compare the stiffness that pushes along x, y, z show at stations with that of springs, with and without tilt axes.",
        epilog="Example: robomill identify stations results/stations/*-1 --compliance scenarios/kr210/table_3_1.toml",
    )
    kind.add_argument(
        "measured", type=Path, nargs="+", metavar="RUN", help="run folders, or TOML files over columns (docs/how_to/identify.md)"
    )
    kind.add_argument("--compliance", required=True, metavar="NAME", help="springs: name of models/data/compliance or a .toml file")
    add_machine(kind)
    kind.add_argument("--out", type=Path, metavar="DIR", help="write report.json, report.txt and stations.png")


def run(options: Namespace) -> int:
    """`robomill identify stations`: a table of stiffness by station and direction."""
    measured = read_measured(options.measured, PUSHES, options.robot, options.tool)
    name = str(options.compliance)
    springs = load(Compliance, name) if name.endswith(".toml") else load_compliance(name)
    try:
        found = stations(measured.robot, measured.tool, springs, Loads(*(measured.values[q.name] for q in PUSHES)))
    except ValueError as error:
        raise MeasuredSetError(f"{', '.join(map(str, options.measured))}: {error}") from error
    result = {
        "robot": measured.robot.name,
        "tool": measured.tool.name,
        "compliance": name,
        "stations": [
            {
                "q_rad": found.q[n].tolist(),
                "measured_n_per_m": [finite(v) for v in found.measured[n]],
                "with_tilt_n_per_m": found.with_tilt[n].tolist(),
                "drives_only_n_per_m": found.drives_only[n].tolist(),
            }
            for n in range(len(found.q))
        ],
        "mean_share_with_tilt": found.share.mean(axis=0).tolist(),
        "rms_error": [finite(v) for v in _rms(found.error)],
    }
    lines = say(measured, found)
    if options.out is not None:
        keep(options.out, result, lines, {"stations": draw(measured, found)})
    if getattr(options, "json", False):
        print(json.dumps(result))
        return DONE
    print("\n".join(lines))
    if options.out is not None:
        print(f"{options.out}: report.json, report.txt, stations.png")
    return DONE


def _rms(values: Any) -> Any:
    with np.errstate(invalid="ignore"):
        return np.sqrt(np.nanmean(np.square(values), axis=0)) if np.isfinite(values).any() else np.full(3, np.nan)


def say(measured: MeasuredSet, found: Stations) -> list[str]:
    """Lines of the report, stiffness in N/um."""
    rows = [["station", *(f"{k}_{a}" for a in "xyz" for k in ("measured", "springs", "drives"))]]
    for n in range(len(found.q)):
        values = np.stack([found.measured[n], found.with_tilt[n], found.drives_only[n]], axis=1).ravel()
        rows.append([str(n + 1), *("-" if np.isnan(v) else f"{1e-6 * v:.3f}" for v in values)])
    share, error = found.share.mean(axis=0), _rms(found.error)
    return [
        f"{measured.robot.name}, {measured.tool.name}: stiffness in N/um at {len(found.q)} stations",
        *columns(rows),
        f"with tilt axes / drives alone, mean: x {share[0]:.2f}, y {share[1]:.2f}, z {share[2]:.2f}",
        "springs against measured, rms: "
        + ", ".join(f"{a} {100 * e:.1f} %" if np.isfinite(e) else f"{a} -" for a, e in zip("xyz", error, strict=True)),
    ]


def draw(measured: MeasuredSet, found: Stations) -> Figure:
    """Bars per station as Figs. 3.5 and 3.6: measured, springs, and what the drives alone would have on top in white."""
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    axes = figure.subplots(1, 3)
    at = np.arange(1, len(found.q) + 1)
    for axis, ax in enumerate(axes):
        ax.bar(at + 0.2, 1e-6 * found.drives_only[:, axis], 0.38, color="white", ec="0.4", lw=0.8, label="drives alone")
        ax.bar(at + 0.2, 1e-6 * found.with_tilt[:, axis], 0.38, color=BLUE, label="with tilt axes")
        ax.bar(at - 0.2, 1e-6 * found.measured[:, axis], 0.38, color="0.45", label="measured")
        share = float(found.share[:, axis].mean())
        ax.set(xlabel="station", title=f"{'xyz'[axis]}: tilt axes leave {share:.2f}", xticks=at)
    axes[0].set_ylabel("stiffness in N/um")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], fontsize=8, loc="outside lower center", ncols=3)
    return figure
