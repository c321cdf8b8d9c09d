"""A program of 100 000 corners: planned with equal work per corner, played in process and in a native FMU."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.fmus.in_process import InProcessSlave
from robomill.models.components.path_interpolator import MODEL
from robomill.models.model.declaration import FloatArray
from robomill.models.planning import gcode, trajectory
from robomill.models.planning.trajectory import Placement, Plan
from robomill.orchestration.slaves.fmu import FmuSlave
from tests.fmus import native_runs as runs
from tests.tolerances import ROUNDOFF, discretisation

HERE = Placement((1.595, -0.018, 1.099))
FEED = 0.025
CORNERS = 100_000


def cloud(corners: int) -> gcode.Program:
    """As a CAM system writes a curved surface: chords of 0.2 to 0.5 mm, kinks of 1 to 4 deg, rows 0.1 m wide."""
    t = np.cumsum(np.random.default_rng(7).uniform(0.2e-3, 0.5e-3, corners + 2)) / 0.01
    points = np.column_stack([0.01 * np.sin(t) + 0.01 * np.sin(t / 97.0), 0.01 * np.cos(t), 1e-3 * np.sin(t / 500.0)]).tolist()
    moves = (
        gcode.Move(i + 1, i + 1, (*points[i],), (*points[i + 1],), FEED, 1300.0, 2e-4)  # type: ignore[arg-type]  # three numbers
        for i in range(corners + 1)
    )
    return gcode.Program("cloud.ngc", tuple(moves), (), 0, 0.0)


def work(corners: int, monkeypatch: pytest.MonkeyPatch) -> tuple[Plan, float, float]:
    """The plan, and per corner: blends made, rows of the table."""
    blends = []
    made = trajectory.blend

    def counted(*arguments: Any) -> Any:
        blends.append(1)
        return made(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(trajectory, "blend", counted)
        plan = trajectory.plan(cloud(corners), HERE)
    return plan, len(blends) / corners, len(plan.table) / corners


@pytest.mark.slow
@pytest.mark.skipif(not runs.ON_LINUX, reason="runs the linux64 library")
def test_a_hundred_thousand_corners(built_native: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each corner costs what it costs in a short program; in process and FMU the same bits, also in another instance from a small state."""
    _, blends, rows = work(1000, monkeypatch)
    plan, many_blends, many_rows = work(CORNERS, monkeypatch)
    assert blends == many_blends == 1.0
    assert many_rows == pytest.approx(rows, rel=discretisation(10.0, 1 / 1000, 1))  # a few more rows at both ends
    assert len(plan.table) > CORNERS
    assert np.all(np.diff(plan.table[:, 0]) > 0.0)
    file = tmp_path / "segments.npy"
    np.save(file, plan.table)
    step = plan.duration / 50.5
    native = built_native("path_interpolator")
    slaves = (InProcessSlave(MODEL), FmuSlave(native, "path"), FmuSlave(native, "again"))
    one, two, again = (played(s, file if s is not slaves[2] else None) for s in slaves)
    for k in range(25):
        assert_same(stepped(one, k, step), stepped(two, k, step))
    state = two.get_state()
    assert sum(len(part) for part in state if isinstance(part, bytes)) < 8192
    again.set_state(state)
    for k in range(25, 52):
        out = stepped(one, k, step)
        assert_same(out, stepped(again, k, step))
        expected = plan.position(np.array([min((k + 1) * step, plan.duration)]))[0]
        np.testing.assert_allclose(out[:3], expected, rtol=0.0, atol=100 * ROUNDOFF)
    for slave in slaves:
        slave.close()


def played(slave: Any, file: Path | None) -> Any:
    slave.configure({} if file is None else {"segments": str(file)})
    slave.initialise(0.0, 1e6, runs.H)
    slave.set_inputs(np.array([1.0]))
    return slave


def stepped(slave: Any, k: int, h: float) -> FloatArray:
    slave.step(k * h, h)
    out = np.zeros(len([p for p in slave.ports if p.causality == "output"]))
    slave.get_outputs(out)
    return out


def assert_same(a: FloatArray, b: FloatArray) -> None:
    assert a.tobytes() == b.tobytes()


def test_a_point_cloud_runs_at_its_feed() -> None:
    """G64 P0.2: kinks of a few degrees are blended, so the feed is held but for the ramps at both ends (0.1 s of 10 s)."""
    plan = trajectory.plan(cloud(800), HERE)
    tau = np.linspace(0.0, plan.duration, 20_001)
    speed = np.linalg.norm(plan.velocity(tau), axis=1)
    inside = (tau > 0.2) & (tau < plan.duration - 0.2)
    assert np.min(speed[inside]) > 0.999 * FEED
    assert math.isclose(plan.length / plan.duration, FEED, rel_tol=0.2 / plan.duration)
