"""What a run shows: where its tool was and should have been, the robot that held it, the force; thinned out for a page."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from robomill.cell.scenario import Workpiece
from robomill.joints import ROBOTS, geometry
from robomill.models.model.declaration import FloatArray, Record
from robomill.models.robot.kinematics import inverse, tool_pose
from robomill.orchestration.errors import ResultsError, unknown
from robomill.orchestration.runs.files import RUN
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import Component

SIDE_BY_SIDE = 4
"""Runs that are shown where none are named: more are too small to be seen."""
FRAMES = 1500
"""Samples of a run that are kept, at most, evenly in time: 20 a second of a minute's run."""
PLANNED = ("path_interpolator", "lead_through")
"""Components whose tool pose is the one that was asked for."""
STANDING = 1e-4
"""Speed [m/s] of the planned tool up to which it stands: a deviation then has no direction along the feed."""
SOLVED = 1e-6
"""Distance [m] up to which angles hold the tool where it is: far below what is seen, far above roundoff."""
_STARTS = ("q_ref", "q_link", "q", "q_motor")
"""Inputs whose start values are axis angles."""
_OFFLINE = "offline"
"""Folder of the run that the pilot force comes from; it mills nothing."""


@dataclass(frozen=True)
class Recorded:
    """A run, which of its components say what, and the samples that are kept."""

    name: str
    run: Run
    tool: str
    """Component whose p_BT_B, quat_BT is the real tool."""
    planned: str | None
    """Component whose p_BT_B is the planned tool; None if there is none."""
    force: str | None
    """Component whose f_T_B is the force on the tool."""
    angles: str | None
    """Column of the axis angles A1..A6."""
    kept: npt.NDArray[np.int64]
    """Numbers of the samples that are shown."""

    @property
    def p(self) -> FloatArray:
        """Tool tip in B [n, 3] m at the kept samples."""
        return self.run[f"{self.tool}.p_BT_B"][self.kept]

    @property
    def quat(self) -> FloatArray:
        """Orientation of the tool in B [n, 4] at the kept samples, without jumps of sign."""
        q = self.run[f"{self.tool}.quat_BT"][self.kept].copy()
        turns = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
        q[1:] *= turns[:, None]
        return q

    @property
    def target(self) -> FloatArray | None:
        """Planned tool tip in B [n, 3] m."""
        return None if self.planned is None else self.run[f"{self.planned}.p_BT_B"][self.kept]

    @property
    def across(self) -> FloatArray | None:
        """Deviation of the tip from the planned path, across the feed, [n, 3] m: what is late along it is left out."""
        if self.planned is None:
            return None
        target = self.run[f"{self.planned}.p_BT_B"]
        velocity = np.gradient(target, self.run.t, axis=0)[self.kept] if len(self.run) > 1 else np.zeros((1, 3))
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        feed = np.where(speed > STANDING, velocity / np.maximum(speed, STANDING), 0.0)
        gap = self.p - target[self.kept]
        result: FloatArray = gap - np.sum(gap * feed, axis=1, keepdims=True) * feed
        return result

    @property
    def f(self) -> FloatArray | None:
        """Force on the tool in B [n, 3] N."""
        return None if self.force is None else self.run[f"{self.force}.f_T_B"][self.kept]

    @property
    def q(self) -> FloatArray | None:
        """Axis angles [n, 6] rad."""
        return None if self.angles is None else self.run[self.angles][self.kept]

    @property
    def lost(self) -> float:
        """Distance [m] of the recorded tips from the straight lines between the kept ones, the largest."""
        tips, t = self.run[f"{self.tool}.p_BT_B"], self.run.t
        between = np.stack([np.interp(t, t[self.kept], tips[self.kept, i]) for i in range(3)], axis=1)
        return float(np.max(np.linalg.norm(tips - between, axis=1)))

    def solved(self, s: Record) -> FloatArray | None:
        """Axis angles [n, 6] rad of the robot `s` that hold the recorded tool rigidly, for runs without recorded ones.

        By the inverse kinematics in closed form, each nearest to the one before, the first to the start values of the run. None where
        the run has no start values, and where the robot has no closed form or does not reach a pose.
        """
        starts = self.run.info.get("inputs", {}).values()
        near = next(([float(v[f"{p}[{i}]"]) for i in range(1, 7)] for v in starts for p in _STARTS if f"{p}[6]" in v), None)
        if near is None:
            return None
        R = Rotation.from_quat(self.quat, scalar_first=True).as_matrix()
        q, last, found_p, found_R = np.empty((len(R), 6)), np.array(near), np.zeros(3), np.zeros((3, 3))
        for k, p in enumerate(self.p):
            if inverse(s, p, R[k], last, q[k]) != 0:
                return None
            tool_pose(s, q[k], found_p, found_R)
            if not np.allclose(found_p, p, rtol=0.0, atol=SOLVED):
                return None
            last = q[k]
        return q

    def robot(self) -> Record | None:
        """Geometry of the robot that moved the tool; None where the run names none."""
        sources, parameters = self.run.info.get("sources", {}), self.run.info.get("parameters", {})
        by_source = {Path(str(source)).stem: name for name, source in reversed(sources.items())}
        stem = next((s for s in ROBOTS if s in by_source), None)
        if stem is None:
            return None
        return geometry(Component(by_source[stem], stem, parameters.get(by_source[stem], {})))

    def workpiece(self) -> Workpiece | None:
        """The block that was milled, where the run has one."""
        given = self.run.info.get("parameters", {}).get("milling", {})
        position, quat, size = (tuple(float(given[f"{k}[{i + 1}]"]) for i in range(n) if f"{k}[{i + 1}]" in given) for k, n in _PLACE)
        if len(size) != _PLACE[2][1] or len(position) != _PLACE[0][1] or len(quat) != _PLACE[1][1]:
            return None
        abc = Rotation.from_quat(quat, scalar_first=True).as_euler("ZYX")
        stock = given.get("stock")
        return Workpiece(position, size, tuple(abc), stock=None if not stock else self._table(str(stock)).reshape(-1, 3, 3))  # type: ignore[arg-type]

    def _table(self, name: str) -> FloatArray:
        """A table of the run: where it was, or in the plan beside the run, if the folder has been moved."""
        there = next((f for f in (Path(name), self.run.folder.parent / "plan" / Path(name).name) if f.is_file()), None)
        if there is None:
            raise ResultsError(f"{self.run.folder}: the table {name} is gone, and plan/{Path(name).name} beside the run as well; run again")
        return np.asarray(np.load(there), dtype=np.float64)


_PLACE = (("p_BP_B", 3), ("quat_BP", 4), ("block_size", 3))


def recordings(folder: Path, names: Sequence[str] | None) -> tuple[list[Recorded], list[str]]:
    """The runs in a folder that `robomill run` wrote, and notes. `names`: only these; without, the first SIDE_BY_SIDE.

    ResultsError if there are none, or none that says where a tool was; it names what is missing.
    """
    found = _folders(folder)
    chosen = found
    notes: list[str] = []
    if names:
        for name in names:
            if name not in found:
                raise ResultsError(f"{folder}: {unknown('run', name, found)}")
        chosen = {name: found[name] for name in names}
    elif len(found) > SIDE_BY_SIDE:
        chosen = dict(list(found.items())[:SIDE_BY_SIDE])
        notes.append(f"{len(found)} runs are in {folder}; shown are {', '.join(chosen)}; choose others with --variant")
    return [_recorded(name, Run.load(place)) for name, place in chosen.items()], notes


def _folders(folder: Path) -> dict[str, Path]:
    """Name of a run -> its folder, in the order of summary.json."""
    if not folder.is_dir():
        raise ResultsError(f"no folder {folder}; expected one that `robomill run` wrote")
    if (folder / RUN).is_file():
        return {folder.resolve().name: folder}
    found = {f.parent.relative_to(folder).as_posix(): f.parent for f in sorted(folder.rglob(RUN))}
    found.pop(_OFFLINE, None)
    if not found:
        raise ResultsError(f"{folder}: neither in it nor in its folders is a {RUN}; expected a folder that `robomill run` wrote")
    order = list(_order(folder / "summary.json"))
    return {name: found[name] for name in sorted(found, key=lambda n: (order.index(n) if n in order else len(order), n))}


def _order(summary: Path) -> Iterator[str]:
    try:
        variants = json.loads(summary.read_text(encoding="utf-8"))["variants"]
    except (OSError, ValueError, KeyError, TypeError):
        return
    yield from variants


def _recorded(name: str, run: Run) -> Recorded:
    if len(run) == 0:
        raise ResultsError(f"{run.folder}: the run has no samples; run it again")
    sources = run.info.get("sources", {})
    posed = [c for c in run.components if f"{c}.p_BT_B" in run and f"{c}.quat_BT" in run]
    if not posed:
        raise ResultsError(
            f"{run.folder}: no component has a tool pose: expected columns NAME.p_BT_B[1..3] (m) and NAME.quat_BT[1..4], as "
            f"robot_compliance and path_interpolator give them; there are columns of "
            f"{', '.join(run.components) or 'nothing'}; record these ports, or view the run of a cell with a robot"
        )
    planned = next((c for c in run.components if Path(str(sources.get(c, ""))).stem in PLANNED and f"{c}.p_BT_B" in run), None)
    real = [c for c in posed if c != planned]
    tool = "compliance" if "compliance" in real else real[0] if real else posed[0]
    forces = [c for c in run.components if f"{c}.f_T_B" in run]
    force = "milling" if "milling" in forces else forces[0] if forces else None
    angles = next((f"{c}.{port}" for port in ("q_motor", "q_link", "q_ref") for c in run.components if f"{c}.{port}" in run), None)
    for column in (f"{tool}.p_BT_B", f"{tool}.quat_BT"):
        bad = np.flatnonzero(~np.isfinite(run[column]).all(axis=1))
        if len(bad):
            raise ResultsError(
                f"{run.folder}: {column} is not finite at t = {run.t[bad[0]]:g} s and at {len(bad)} samples in all; run it again"
            )
    kept = np.unique(np.linspace(0, len(run) - 1, min(FRAMES, len(run))).astype(np.int64))
    return Recorded(name, run, tool, planned if planned != tool else None, force, angles, kept)
