"""`robomill identify sensor`: the measurement matrix of a sensing spindle holder from a calibration against a dynamometer."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from robomill.cell.palette import BLUE, ORANGE
from robomill.measured_set import MeasuredSet, MeasuredSetError, Quantity, read_measured
from robomill.option_types import add_machine

if TYPE_CHECKING:
    from robomill.models.calibration.measurement_matrix import MatrixFit
    from robomill.models.components.spindle_holder import SpindleHolder
    from robomill.models.model.declaration import FloatArray

QUANTITIES = (
    Quantity("q", "rad", 6, ("q", "q_motor", "q_link")),
    Quantity("bridge", "1", 6, ("bridge",)),
    Quantity("force", "N", 3, ("f_T_B",)),
)
SHOWN = 300.0
"""Force [N] whose uncertainty is reported, the largest load of paper 001, sec. 4."""
MV = 1e-3
"""V/V of one mV/V."""


def add_arguments(kinds: Any) -> None:
    """The options of this kind."""
    sensor = kinds.add_parser(
        "sensor",
        help="measurement matrix of a sensing spindle holder from a calibration against a dynamometer",
        description="Identify the measurement matrix of a sensing spindle holder: forces of a dynamometer, readings of its six bridges.",
        epilog="Example: robomill identify sensor results/calibration/*-1 --out my_holder.toml --plot my_holder.png",
    )
    sensor.add_argument(
        "--holder", default="spindle_holder", metavar="NAME", help="holder of models/data/sensors or a .toml file that the matrix is for"
    )
    sensor.add_argument(
        "--way",
        choices=("strains", "forces"),
        default="strains",
        help="least squares of the strains, then inverted (default), or of the forces as in Eq. (8) of paper 001",
    )
    sensor.add_argument("--out", type=Path, metavar="FILE.toml", help='write the holder with its matrix for `[sensor] file = "FILE.toml"`')
    sensor.add_argument("--plot", type=Path, metavar="FILE.png", help="draw measured against applied force")
    sensor.add_argument(
        "measured", type=Path, nargs="+", metavar="RUN", help="run folders, or TOML files over columns (docs/how_to/identify.md)"
    )
    add_machine(sensor)


def run(options: Namespace) -> int:
    """Identify, say what was found, write what was asked for."""
    from robomill.models.calibration.measurement_matrix import CalibrationError, identify_matrix
    from robomill.models.components.spindle_holder import SpindleHolder
    from robomill.models.model.parameters import load

    holder = load(SpindleHolder, options.holder if options.holder.endswith(".toml") else f"sensors/{options.holder}")
    measured = read_measured(options.measured, QUANTITIES, options.robot, options.tool)
    forces, weight = in_holder(measured, holder)
    try:
        fit = identify_matrix(measured.values["bridge"], forces + weight, options.way)
    except CalibrationError as error:
        raise MeasuredSetError(f"{', '.join(map(str, options.measured))}: {error}") from None
    result = _result(measured, fit)
    if options.out is not None:
        options.out.write_text(sensor_file(holder, fit, [f.name for f in options.measured]), encoding="utf-8")
    if options.plot is not None:
        _plot(options.plot, forces, (measured.values["bridge"] - fit.zero) @ fit.matrix.T - weight)
    if options.json:
        print(json.dumps(result))
        return 0
    _show(measured, fit, result)
    if options.out is not None:
        print(f'{options.out}: {holder.name} with this matrix; [sensor] file = "{options.out.name}" in a system or scenario')
    if options.plot is not None:
        print(f"{options.plot}: measured against applied force")
    return 0


def in_holder(measured: MeasuredSet, holder: SpindleHolder) -> tuple[FloatArray, FloatArray]:
    """Forces on the tool [n, 3], and what is felt of the weight of the spindle [n, 3]: N, axes of the holder.

    z of these axes points out of the spindle, y is that of the tool; from forces in B and the axis angles.
    """
    from robomill.models.calibration.measurement_matrix import felt
    from robomill.models.components.sensor_chain import GRAVITY
    from robomill.models.robot.kinematics import tool_pose
    from robomill.models.robot.numeric_inverse import kinematics

    s, place, R = kinematics(measured.robot, measured.tool), np.zeros(3), np.zeros((3, 3))
    forces, weights = np.zeros_like(measured.values["force"]), np.zeros_like(measured.values["force"])
    for k, (q, force) in enumerate(zip(measured.values["q"], measured.values["force"], strict=True)):
        tool_pose(s, q, place, R)
        R_BH = np.column_stack([-R[:, 2], R[:, 1], R[:, 0]])
        forces[k] = R_BH.T @ force
        weights[k] = -holder.spindle_mass * GRAVITY * R_BH[2]
    return forces, felt(weights, holder.spindle_cog, holder.lever)


def _result(measured: MeasuredSet, fit: MatrixFit) -> dict[str, Any]:
    return {
        "robot": measured.robot.name,
        "tool": measured.tool.name,
        "way": fit.way,
        "rows": fit.rows,
        "matrix_n_per_v_v": fit.matrix.tolist(),
        "zero_v_v": fit.zero.tolist(),
        "sensitivity_v_v_per_n": fit.sensitivity.tolist(),
        "condition": fit.condition,
        "noise_v_v": fit.noise.tolist(),
        "residual_n": fit.residual.tolist(),
        "scale": fit.scale.tolist(),
        "force_noise_n": fit.force_noise.tolist(),
        "deviation": [{"force_n": (SHOWN * e).tolist(), "deviation_n": fit.deviation(SHOWN * e).tolist()} for e in np.eye(3)],
        "calibration_deviation": [
            {"force_n": (SHOWN * e).tolist(), "deviation_n": fit.deviation(SHOWN * e, np.inf).tolist()} for e in np.eye(3)
        ],
    }


def _show(measured: MeasuredSet, fit: MatrixFit, result: dict[str, Any]) -> None:
    machine = f"{measured.robot.name}, {measured.tool.name}"
    print(f"{machine}: {fit.rows} rows, condition number {fit.condition:.3g}, least squares of the {fit.way}")
    table = Table(box=SIMPLE)
    for title in ("force", *(f"bridge {b + 1}" for b in range(6)), "left N", f"+- at {SHOWN:.0f} N, one sample", "mean of many", "scale"):
        table.add_column(title, justify="left" if title == "force" else "right")
    for i, name in enumerate("xyz"):
        one, many = result["deviation"][i]["deviation_n"][i], result["calibration_deviation"][i]["deviation_n"][i]
        row = [f"{MV * v:.1f}" for v in fit.matrix[i]]
        table.add_row(name, *row, f"{fit.residual[i]:.2g}", f"{one:.2g}", f"{many:.2g}", f"{fit.scale[i]:.4f}")
    Console(highlight=False, width=160).print(table)
    print("matrix in N per mV/V, axes of the holder: z out of the spindle, y of the tool; +-: one standard deviation")
    zero, noise = ", ".join(f"{v / MV:.5f}" for v in fit.zero), ", ".join(f"{1e6 * v:.2g}" for v in fit.noise)
    print(f"zero {zero} mV/V; left of the readings {noise} uV/V")


def sensor_file(holder: SpindleHolder, fit: MatrixFit, runs: list[str]) -> str:
    """A file of models/data/sensors: the holder with the matrix and the zero of the fit."""
    left = ", ".join(f"{v:.2g}" for v in fit.residual)
    said = (
        f"least squares of the {fit.way} on {fit.rows} rows of {', '.join(runs)}: {left} N rms left, condition number {fit.condition:.3g}"
    )
    identified = replace(holder, measurement_matrix=fit.matrix, bridge_zero=fit.zero)
    units = {
        "strain_force": (1e6, "um/(N.m)"),
        "lever": (1e3, "mm"),
        "gauge_factor": (1.0, "1"),
        "poisson": (1.0, "1"),
        "supply": (1.0, "V"),
        "amplifier_noise": (1e6, "uV"),
        "resolution": (1e3, "mV/V"),
        "bridge_range": (1e3, "mV/V"),
        "force_range": (1.0, "N"),
        "measurement_matrix": (1e-3, "N.V/mV"),
        "bridge_zero": (1e3, "mV/V"),
        "spindle_mass": (1.0, "kg"),
        "spindle_cog": (1e3, "mm"),
    }
    text = f'# {holder.name}, written by robomill identify sensor.\n\n[name]\nvalue = "{holder.name}"\nunit = "1"\n'
    text += 'source = "this file"\nvalidity = "tool length and orientation of its calibration"\n'
    for name, (factor, unit) in units.items():
        new = name in ("measurement_matrix", "bridge_zero")
        value = _rounded((factor * np.asarray(getattr(identified, name))).tolist())
        source = said if new else f"as {holder.name} before the calibration"
        validity = "tool length and orientation of the calibration" if new else "not identified"
        text += f'\n[{name}]\nvalue = {value}\nunit = "{unit}"\nsource = "{source}"\nvalidity = "{validity}"\n'
    return text


def _plot(file: Path, forces: FloatArray, shown: FloatArray) -> None:
    """Measured against applied force, and the difference, for x, y, z."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), layout="constrained")
    above, below = figure.subplots(2, 3, sharex="col")
    for i, name in enumerate(("x", "y", "z (axial)")):
        above[i].plot(forces[:, i], shown[:, i], ".", markersize=2, color=BLUE, rasterized=True)
        above[i].set_title(f"force along {name}")
        below[i].plot(forces[:, i], shown[:, i] - forces[:, i], ".", markersize=2, color=ORANGE, rasterized=True)
        below[i].axhline(0.0, color="0.5", linewidth=0.8)
        below[i].set_xlabel("dynamometer in N")
    above[0].set_ylabel("spindle holder in N")
    below[0].set_ylabel("difference in N")
    figure.savefig(file, dpi=110)


def _rounded(value: Any) -> Any:
    """Numbers to twelve digits, lists of them as well."""
    return [_rounded(v) for v in value] if isinstance(value, list) else float(f"{value:.12g}")
