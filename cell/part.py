"""The part that a milling run with tri-dexels leaves: cut again from the recorded poses, measured against the nominal one, written as STL.

The run holds poses, not dexels: cutting again gives the same part, whatever ran the component (in process, FMU, earlier session).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from robomill.cell.scenario import Workpiece
from robomill.fmus.components import component
from robomill.models.metrology.surface import NothingCutError, SurfaceDeviation
from robomill.models.metrology.tridexel_part import Part, compare
from robomill.models.model.declaration import FloatArray
from robomill.models.process import tool_table
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System

TRIDEXEL = "tridexel_milling_force"
SPACING = 5e-4
"""Largest distance of the lines [m] that the part is cut with here; their ends are exact at any."""
WALL = np.cos(np.radians(45.0))
"""A surface whose normal is further than this from z of P is a wall."""


def is_tridexel(run: Run) -> bool:
    """Whether the milling component of a run is that of tri-dexels, in process or as an FMU."""
    return Path(str(run.info.get("sources", {}).get("milling", ""))).stem == TRIDEXEL


def require(system: System) -> None:
    """ValueError if the milling component of a system is not that of tri-dexels: there is no part to write then."""
    source = system.component("milling").source
    if Path(source).stem != TRIDEXEL:
        raise ValueError(
            f"--stl: the part is written of cells with tri-dexels; in {system.file} milling is {source!r}, expected {TRIDEXEL!r}"
        )


def _parameter(run: Run, name: str) -> Any:
    parameters: Mapping[str, Any] = run.info.get("parameters", {}).get("milling", {})
    return parameters.get(name, component(TRIDEXEL).variable(name).start)


def raw_part(run: Run, workpiece: Workpiece, spacing: float = SPACING) -> Part:
    """The nominal stock of a run."""
    if workpiece.stock is not None:
        return Part.solid(workpiece.stock, spacing)
    lx, ly, lz = workpiece.size
    return Part.block((-0.5 * lx, -0.5 * ly, -lz), (0.5 * lx, 0.5 * ly, 0.0), spacing)


def cut_part(run: Run, workpiece: Workpiece, poses: str = "compliance", spacing: float = SPACING) -> Part:
    """The part after the tool has gone where the component `poses` of the run says: "compliance" as it was, "path" as planned.

    ValueError where a line of dexels has more walls than there is room for.
    """
    part = raw_part(run, workpiece, spacing)
    radius, corner, reach = tools(run)
    part.cut(*tool_motion(run, workpiece, poses), radius, corner, reach, run["path.spindle_speed"] > 0.0)
    return part


def tool_motion(run: Run, workpiece: Workpiece, poses: str) -> tuple[FloatArray, FloatArray]:
    """Tip (n, 3) [m] and axis from tip to spindle (n, 3) in P, as the component `poses` of the run says."""
    R_BP = Rotation.from_euler("ZYX", workpiece.abc)
    tip = R_BP.inv().apply(run[f"{poses}.p_BT_B"] - np.asarray(workpiece.position))
    turn = Rotation.from_quat(run[f"{poses}.quat_BT"], scalar_first=True)
    return tip, -(R_BP.inv() * turn).as_matrix()[:, :, 0]


def tools(run: Run) -> tuple[FloatArray, FloatArray, float]:
    """Radius and corner radius [m] of the cutter at each sample (n,), and the longest cutting edge [m]."""
    n = len(run)
    radius = np.full(n, 0.5 * float(_parameter(run, "diameter")))
    corner = np.full(n, float(_parameter(run, "corner_radius")))
    reach = float(_parameter(run, "cutting_length"))
    parameters = run.info.get("parameters", {}).get("milling", {})
    if parameters.get("tools") and "path.tool" in run.columns:
        corners = dict(np.load(parameters["corners"]).tolist()) if parameters.get("corners") else {}
        for row in np.load(parameters["tools"]):
            used = run["path.tool"] == row[tool_table.NUMBER]
            radius[used] = 0.5 * row[tool_table.DIAMETER]
            corner[used] = corners.get(row[tool_table.NUMBER], 0.0)
            reach = max(reach, float(row[tool_table.CUTTING_LENGTH]))
    return radius, corner, reach


def scan(run: Run, workpiece: Workpiece) -> SurfaceDeviation:
    """Deviation of the machined part from the one that the planned path would have left. NothingCutError if that cuts nothing."""
    raw = raw_part(run, workpiece)
    nominal, actual = (cut_part(run, workpiece, poses) for poses in ("path", "compliance"))
    try:
        found = compare(nominal, actual, raw)
    except ValueError as why:
        raise NothingCutError(str(why)) from None
    tip = Rotation.from_euler("ZYX", workpiece.abc).inv().apply(run["path.p_BT_B"] - np.asarray(workpiece.position))
    when = cKDTree(tip).query(found.points)[1]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
    return SurfaceDeviation(
        points=found.points,
        normal=found.normal,
        deviation=found.deviation,
        wall=np.abs(found.normal[:, 2]) < WALL,
        edge=found.beside,
        limited=np.zeros(len(found.points), dtype=np.bool_),
        path_time=run.t[when],
        path_length=way[when],
    )
