"""`robomill identify`: parameters of the cell from measured sets and runs. Stiffness and payload are here, the others beside it."""

from __future__ import annotations

import json
import sys
from argparse import SUPPRESS, Namespace
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from robomill import identify_cubes, identify_cycle, identify_hammer, identify_sensor, identify_stations
from robomill.files import vacant
from robomill.identify_report import REPORT
from robomill.measured_set import MeasuredSet, MeasuredSetError, Quantity, read_measured
from robomill.option_types import add_machine, add_overwrite

_Q = Quantity("q", "rad", 6, ("q_link", "q", "q_motor"))
STIFFNESS = (
    _Q,
    Quantity("force", "N", 3, ("f_T_B",)),
    Quantity("moment", "N.m", 3, ("m_T_B",), needed=False),
    Quantity("displacement", "m", 3, ("d_T_B",)),
)
PAYLOAD = (
    Quantity("q", "rad", 6, ("q", "q_motor", "q_link")),
    Quantity("force", "N", 3, ("f_S_raw",)),
    Quantity("moment", "N.m", 3, ("m_S_raw",)),
)
DONE, UNSURE = 0, 1
UNKNOWN = 5.0
"""Relative standard deviation from which on a proposed pose is not said to make a spring known."""
MOST_ROWS = 2000
"""Rows that springs are found from: of longer runs every second, third ... row, as neighbours are the same pose."""


def add_arguments(parser: Any) -> None:
    """What can be identified, and the options."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    stiffness = kinds.add_parser(
        "stiffness",
        help="springs of the robot from loads and displacements at many poses",
        description="Identify the springs of the robot from loads on the tool and displacements at many poses.",
        epilog="Example: robomill identify stiffness data/fanuc_r2000ic/loads.toml --tilt 3",
    )
    stiffness.add_argument(
        "--tilt",
        type=int,
        action="append",
        default=[],
        metavar="AXIS",
        help="also tilt springs about x and y at this axis, 1..6; may be repeated",
    )
    stiffness.add_argument(
        "--springs",
        choices=("axes", "joints"),
        help="springs of coupled drives at the axis angles, or at the joints (default: what the set says, else axes)",
    )
    stiffness.add_argument("--poses", type=int, default=3, metavar="N", help="how many further poses to propose (default: 3)")
    stiffness.add_argument("--out", type=Path, metavar="FILE.toml", help='write the springs for `[robot] compliance = "FILE.toml"`')
    payload = kinds.add_parser(
        "payload",
        help="weight, centre of gravity and offsets of the force sensor from many orientations without a process",
        description="Identify what the force sensor shows without a process, from many orientations.",
        epilog="Example: robomill identify payload runs/orientations --out payload.ssv",
    )
    payload.add_argument(
        "--hose", metavar="NAME", help="hose pack that is subtracted first, of models/data/sensors (hose_gallows) or a .toml file"
    )
    payload.add_argument(
        "--three", action="store_true", help="weight, centre of gravity and offsets from O1, O2, O3 alone (paper 000, Eqs. 12-15)"
    )
    payload.add_argument(
        "--polynomial",
        action="store_true",
        help="then fit Eq. (17) of paper 000 to the forces left over all orientations; --hose only says where the hose pulls",
    )
    payload.add_argument("--component", default="sensor", metavar="NAME", help="the sensor_chain that the result is for (default: sensor)")
    payload.add_argument("--out", type=Path, metavar="FILE.ssv", help="write its parameters for `robomill run --adopt FILE.ssv`")
    identify_cycle.add_arguments(kinds)
    identify_stations.add_arguments(kinds)
    identify_sensor.add_arguments(kinds)
    identify_cubes.add_arguments(kinds)
    identify_hammer.add_arguments(kinds)
    for kind in kinds.choices.values():
        add_overwrite(kind, "results, and readings that --simulate writes,")
        kind.add_argument("--json", action="store_true", default=SUPPRESS, help="print the result as JSON and nothing else")
    for kind in (stiffness, payload):
        kind.add_argument(
            "measured", type=Path, nargs="+", metavar="RUN", help="run folders, or TOML files over columns (docs/how_to/identify.md)"
        )
        add_machine(kind)


def run(options: Namespace) -> int:
    """Identify and say what was found; status 1 where something is not determined or negative."""
    if not options.overwrite:
        files = [] if options.out is None else [options.out if options.out.suffix in (".toml", ".ssv") else options.out / REPORT]
        drawn = getattr(options, "plot", None)
        vacant(*files, *([] if drawn is None else [drawn]), option="--out" if drawn is None else "--out, --plot")
    return {
        "stiffness": _stiffness,
        "payload": _payload,
        "cycle": identify_cycle.run_cycle,
        "backlash": identify_cycle.run_backlash,
        "stations": identify_stations.run,
        "sensor": identify_sensor.run,
        "cubes": identify_cubes.run,
        "hammer": identify_hammer.run_hammer,
        "modes": identify_hammer.run_modes,
    }[options.kind](options)


def _stiffness(options: Namespace) -> int:
    from robomill.models.calibration import stiffness as model

    measured = read_measured(options.measured, STIFFNESS, options.robot, options.tool)
    coupled = measured.coupled if options.springs is None else options.springs == "axes"
    every = model.Loads(*(measured.values[q.name] for q in STIFFNESS))
    loads = every.only(slice(None, None, -(-len(every) // MOST_ROWS)))
    springs = (*model.SPRINGS, *model.tilts(options.tilt))
    fit = model.identify_stiffness(measured.robot, measured.tool, loads, springs, coupled)
    poses = model.helpful_poses(measured.robot, measured.tool, loads, fit, options.poses, coupled)
    written = None
    if options.out is not None:
        written = model.identify_stiffness(measured.robot, measured.tool, loads, fit.usable, coupled)
        options.out.write_text(model.compliance_file(measured.robot, fit, written), encoding="utf-8")
    found = [
        {
            "name": s.name,
            "stiffness_nm_per_rad": _finite(fit.stiffness[i]),
            "compliance_rad_per_nm": float(fit.compliance[i]),
            "relative_deviation": _finite(fit.relative_deviation[i]),
            "finding": fit.finding(i),
        }
        for i, s in enumerate(springs)
    ]
    result = {
        "robot": measured.robot.name,
        "poses": len(loads),
        "rigid_m": fit.rigid,
        "residual_m": fit.residual,
        "left_out_m": fit.left_out,
        "scatter_m": fit.scatter,
        "condition": _finite(fit.condition),
        "worst": {"pose": fit.worst[0] + 1, "residual_m": fit.worst[1]},
        "springs": found,
        "covariance": [[_finite(v) for v in row] for row in fit.covariance],
        "helpful_poses": [
            {"q_rad": p.q.tolist(), "f_T_B_n": p.f_T_B.tolist(), "relative_deviation": p.relative_deviation.tolist()} for p in poses
        ],
    }
    if options.json:
        print(json.dumps(result))
    else:
        _show_stiffness(measured, result, coupled)
        if written is not None:
            left = ", ".join(s.name for s in springs if s not in fit.usable) or "none"
            print(f"{options.out}: {', '.join(s.name for s in fit.usable)}; rigid: {left}; they leave {1e3 * written.residual:.3f} mm rms")
    if written is not None and not coupled and np.any(measured.robot.axis_coupling):
        print(
            f"{options.out}: the springs are at the joints; robot_compliance puts them at the axis angles of {measured.robot.name}, "
            "whose axes are coupled: take a robot file without axis_coupling, with q as joint angles",
            file=sys.stderr,
        )
    return DONE if len(fit.usable) == len(springs) else UNSURE


def _show_stiffness(measured: MeasuredSet, result: dict[str, Any], coupled: bool) -> None:
    console = Console(highlight=False)
    where, condition = "axis angles" if coupled else "joints", result["condition"] or float("inf")
    print(f"{measured.robot.name}: {result['poses']} poses, springs at the {where}, condition number {condition:.3g}")
    table = Table(box=SIMPLE)
    for title in ("spring", "stiffness 1e6 N.m/rad", "+-", "finding"):
        table.add_column(title, justify="left" if title in ("spring", "finding") else "right")
    for s in result["springs"]:
        k, sd = s["stiffness_nm_per_rad"], s["relative_deviation"]
        table.add_row(s["name"], "-" if k is None else f"{1e-6 * k:.3g}", "-" if sd is None else f"{100 * sd:.0f} %", s["finding"])
    console.print(table)
    print(
        f"displacement {1e3 * result['rigid_m']:.3g} mm rms; left {1e3 * result['residual_m']:.3g} mm rms, of poses left out "
        f"{1e3 * result['left_out_m']:.3g} mm; most at pose {result['worst']['pose']}, {1e3 * result['worst']['residual_m']:.3g} mm"
    )
    if any("negative" in s["finding"] for s in result["springs"]):
        print(
            "A negative stiffness is no property of a robot: something else is missing, such as tilt of links and bearings (--tilt AXIS), "
            "another place of the springs (--springs), geometry or the coupling of axes. Within its uncertainty it is noise."
        )
    for n, p in enumerate(result["helpful_poses"], start=1):
        q, f = np.rad2deg(p["q_rad"]), p["f_T_B_n"]
        worst = int(np.argmax(p["relative_deviation"]))
        name, left = result["springs"][worst]["name"], p["relative_deviation"][worst]
        print(
            f"would help, {n}: A1..A6 {', '.join(f'{a:.0f}' for a in q)} deg, force {', '.join(f'{x:.0f}' for x in f)} N; then "
            + (f"{name} is least known, to {100 * left:.0f} %" if left < UNKNOWN else f"{name} is still unknown")
        )


def _payload(options: Namespace) -> int:
    from robomill.diagnosis.outcome import adopt
    from robomill.models.calibration.features import FEATURES
    from robomill.models.calibration.identification import identify_payload, three_poses
    from robomill.models.calibration.sensor_poses import hose_wrench, load_hose, payload_with_hose, sensor_orientations
    from robomill.models.components.sensor_chain import HOSE, MOUNTING

    measured = read_measured(options.measured, PAYLOAD, options.robot, options.tool)
    v, hose = measured.values, load_hose(options.hose) if options.hose else None
    R_BS = sensor_orientations(measured.robot, measured.tool, v["q"], MOUNTING)
    try:
        if options.polynomial:
            fit, hose = payload_with_hose(R_BS, v["force"], v["moment"], hose or HOSE, MOUNTING, options.three)
        else:
            force, moment = hose_wrench(hose, MOUNTING, R_BS) if hose else (0.0, 0.0)
            fit = (three_poses if options.three else identify_payload)(R_BS, v["force"] - force, v["moment"] - moment)
    except ValueError as error:
        raise MeasuredSetError(f"{', '.join(map(str, options.measured))}: {error}") from error
    load = fit.load
    at_rest, turned = load.wrench(R_BS)
    pull, twist = hose_wrench(hose, MOUNTING, R_BS) if hose else (0.0, 0.0)
    rest = (v["force"] - at_rest - pull, v["moment"] - turned - twist)
    parameters = {
        "model_weight_B": (load.weight_B, fit.deviation_weight_B, "N"),
        "model_cog_S": (load.cog_S, fit.deviation_cog_S, "m"),
        "model_offset_f": (load.offset_f, fit.deviation_offset_f, "N"),
        "model_offset_m": (load.offset_m, fit.deviation_offset_m, "N.m"),
    }
    if options.out is not None:
        values = {
            (options.component, f"{name}[{i + 1}]"): float(x) for name, (value, _, _) in parameters.items() for i, x in enumerate(value)
        }
        # the hose that was subtracted here, or none, is what sensor_chain has to subtract
        coefficients = hose.coefficients if hose else np.zeros((FEATURES, 3))
        values |= {(options.component, f"model_hose[{i + 1},{j + 1}]"): float(x) for (i, j), x in np.ndenumerate(coefficients)}
        adopt.write(values, options.out)
    result = {
        "robot": measured.robot.name,
        "poses": len(v["q"]),
        "weight_n": load.weight,
        "weight_deviation_n": fit.deviation_weight,
        "tilt_rad": fit.tilt.tolist(),
        "tilt_deviation_rad": fit.deviation_tilt.tolist(),
        "residual_force_n": fit.residual_f,
        "residual_moment_nm": fit.residual_m,
        "left_force_n": float(np.sqrt(np.mean(rest[0] ** 2))),
        "left_moment_nm": float(np.sqrt(np.mean(rest[1] ** 2))),
        "condition": [fit.condition_f, fit.condition_m],
        "parameters": {
            name: {"value": value.tolist(), "deviation": deviation.tolist(), "unit": unit}
            for name, (value, deviation, unit) in parameters.items()
        },
    }
    if options.json:
        print(json.dumps(result))
        return DONE
    print(
        f"{measured.robot.name}: {len(v['q'])} orientations, condition numbers {fit.condition_f:.3g}, {fit.condition_m:.3g} (force, moment)"
    )
    tilt, off = np.rad2deg(fit.tilt), np.rad2deg(fit.deviation_tilt)
    print(f"weight {load.weight:.2f} +- {fit.deviation_weight:.2f} N")
    print(f"base tilted by {tilt[0]:.3f} +- {off[0]:.3f} deg about x, {tilt[1]:.3f} +- {off[1]:.3f} deg about y")
    for name, (value, deviation, unit) in parameters.items():
        shown, factor = ("mm", 1e3) if unit == "m" else (unit, 1.0)
        print(f"  {name}: {', '.join(f'{factor * a:.3f} +- {factor * s:.3f}' for a, s in zip(value, deviation, strict=True))} {shown}")
    print(f"left: {fit.residual_f:.3g} N, {fit.residual_m:.3g} N.m rms per component")
    if options.polynomial or options.three:
        pulls = f"hose pulls with up to {np.linalg.norm(pull, axis=-1).max():.1f} N; " if options.polynomial else ""
        print(f"{pulls}over all rows {result['left_force_n']:.3g} N, {result['left_moment_nm']:.3g} N.m rms are left")
    if options.out is not None:
        print(f"{options.out}: parameters of {options.component}; robomill run SCENARIO --adopt {options.out}")
    return DONE


def _finite(value: float) -> float | None:
    """A number that JSON has, or None."""
    return float(value) if np.isfinite(value) else None
