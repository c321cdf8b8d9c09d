"""What a run comes to: figures where something was cut, none where nothing was, and a limit of the measure said everywhere."""

from __future__ import annotations

import contextlib
import io
import json
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from robomill.cell import milling, pictures
from robomill.cell.evaluation import Result, evaluate
from robomill.cell.milled import Runs
from robomill.cell.reaction import reaction_time
from robomill.cell.scenario import Scenario, Workpiece
from robomill.models.process import tool_table
from robomill.models.process.cutting import EndMill
from robomill.orchestration.runs.run import Run
from robomill.run_command import _show_milled
from tests.tolerances import EXACT, ROUNDOFF, discretisation

BLOCK = Workpiece((1.3, 0.0, 1.2), (0.10, 0.06, 0.03))
UPRIGHT = (2**-0.5, 0.0, 2**-0.5, 0.0)
"""Quaternion of T with its x axis down."""
FIGURES = ("max_deviation_m", "rms_deviation_m", "p95_deviation_m", "floor_rms_deviation_m", "peak_force_n", "reaction_t50_s")


class Recorded(dict[str, Any]):
    """A run whose tip goes along `way` [m] in P, displaced by `off` [m]."""

    def __init__(self, way: np.ndarray, off: tuple[float, float, float], depth: float, **more: np.ndarray) -> None:
        n = len(way)
        self.t = 0.004 * np.arange(n)
        self.info: dict[str, Any] = {}
        zero, q = np.zeros((n, 3)), np.tile(UPRIGHT, (n, 1))
        planned = way + BLOCK.position
        super().__init__(
            {
                "path.p_BT_B": planned,
                "path.quat_BT": q,
                "path.v_BT_B": np.gradient(way, 0.004, axis=0),
                "compliance.p_BT_B": planned + off,
                "compliance.quat_BT": q,
                "compliance.d_T_B": zero + np.multiply(off, np.linspace(1.0, 0.0, n)[:, None]),
                "milling.depth": np.full(n, depth),
                "milling.removal_rate": np.full(n, 1e-6 * (depth > 0.0)),
                "milling.f_T_B": zero + 1.0,
                "milling.f_peak": np.ones(n),
                "sensor.f_T_T": zero + 1.0,
                **more,
            }
        )

    def __len__(self) -> int:
        return len(self.t)

    @property
    def columns(self) -> dict[str, Any]:
        return self


def along(y: float, z: float, n: int = 1401) -> np.ndarray:
    """Through the block along x."""
    return np.column_stack([np.linspace(-0.07, 0.07, n), np.full(n, y), np.full(n, z)])


def result(run: Recorded) -> Result:
    return evaluate("v", "a variant", cast(Run, run), BLOCK, 1.0)


def table(one: Result) -> str:
    scenario = cast(Scenario, SimpleNamespace(title="a scenario", paper={}))
    with contextlib.redirect_stdout(io.StringIO()) as shown:
        _show_milled(Runs(scenario, Path(), (one,)))
    return shown.getvalue()


@pytest.mark.parametrize(
    ("z", "depth", "why"),
    [
        (0.0, 1e-5, "nominal path makes no surface in the block"),  # facing at the top of the block, the robot sags into it
        (0.05, 0.0, "the tool never met the block"),
        (-0.01, 0.0, "the tool never met the block"),  # the path goes through it, the tool went somewhere else
    ],
)
def test_no_figures_where_nothing_is_cut(z: float, depth: float, why: str, tmp_path: Path) -> None:
    nothing = result(Recorded(along(0.0, z), (0.0, 1e-3, -4e-4), depth))
    assert nothing.surface is None
    assert [getattr(nothing.figures, key) for key in FIGURES] == [None] * len(FIGURES)
    assert why in str(nothing.figures.note)
    json.dumps(asdict(nothing.figures), allow_nan=False)
    row = next(text for text in table(nothing).splitlines() if "a variant" in text)
    assert row.split()[2:] == ["-"] * 5 + ["1"]
    assert f"a variant: {nothing.figures.note}" in table(nothing)
    assert np.isnan(reaction_time(cast(Run, Recorded(along(0.0, z), (0.0, 1e-3, 0.0), 0.0))))
    figure = pictures.surfaces([nothing], BLOCK)
    assert "nothing is cut" in [text.get_text() for text in figure.axes[0].texts]
    assert "no figures" in figure.axes[0].get_title()


def test_drilling_is_cutting() -> None:
    """A plunge straight down has no edge that stands sideways in material: depth 0, and yet a hole to measure."""
    down = np.column_stack([np.zeros((400, 2)), np.concatenate([np.linspace(0.005, -0.008, 200), np.linspace(-0.008, 0.005, 200)])])
    drilled = result(Recorded(down, (2e-4, 0.0, 0.0), 0.0, **{"milling.removal_rate": 1e-7 * (np.gradient(down[:, 2]) < 0.0)}))
    assert drilled.figures.note is None
    assert drilled.figures.max_deviation_m == pytest.approx(
        2e-4, abs=discretisation(1e-4, 5e-4 / 8e-3, 2)
    )  # points lie 0.5 mm apart around it
    assert len(drilled.cuts) == 1


def test_a_limit_of_the_measure_is_said_in_table_json_and_picture() -> None:
    """1 mm of the block is left beside the slot; the tool is 2.5 mm off and takes it."""
    limited = result(Recorded(along(0.021, -0.01), (0.0, 2.5e-3, 0.0), 0.01))
    assert limited.figures.max_deviation_limited is True
    assert ">= 2.50" in table(limited)
    assert ">= 2.50 mm (limit of the measure)" in table(limited)
    figure = pictures.surfaces([limited], BLOCK)
    assert "max >= 2.50 mm" in figure.axes[0].get_title()
    plain = result(Recorded(along(0.0, -0.01), (0.0, 2.5e-3, 0.0), 0.01))
    assert plain.figures.max_deviation_limited is False
    assert ">=" not in table(plain) + pictures.surfaces([plain], BLOCK).axes[0].get_title()


def test_edges_have_a_figure_of_their_own() -> None:
    """A strip of floor as wide as the error stands under material beside the displaced wall, 2 of 16 strips of it."""
    figures = result(Recorded(along(0.0, -0.02), (0.0, 2.5e-3, 0.0), 0.02)).figures
    assert figures.max_deviation_m == pytest.approx(2.5e-3, rel=1e3 * ROUNDOFF)
    assert figures.floor_max_deviation_m == pytest.approx(0.0, abs=ROUNDOFF)
    assert 0.0 < figures.edge_max_deviation_m <= 2.5e-3
    assert 0.0 < figures.edge_share < 0.1


def test_each_sample_is_cut_by_the_tool_in_the_spindle(tmp_path: Path) -> None:
    way = np.vstack([along(-0.015, -0.005), along(-0.015, 0.02)[::-1], along(0.015, 0.02), along(0.015, -0.005)[::-1]])
    number = np.repeat([1, 2], len(way) // 2)
    np.save(tmp_path / "tools.npy", tool_table.rows({1: EndMill(0.02, 3, 0.5, 0.03), 2: EndMill(0.006, 2, 0.5, 0.02)}))
    run = Recorded(way, (0.0, 1e-4, 0.0), 0.005, **{"path.tool": number})
    run.info = {"parameters": {"milling": {"tools": str(tmp_path / "tools.npy")}}}
    surface = result(run).surface
    assert surface is not None
    assert set(np.round(surface.walls.points[:, 1], 9)) == {-0.025, -0.005, 0.012, 0.018}
    assert np.abs(surface.walls.deviation) == pytest.approx(1e-4, rel=1e4 * ROUNDOFF)


def test_without_a_table_of_tools_the_diameter_of_the_component_counts() -> None:
    run = Recorded(along(0.0, -0.005), (0.0, 1e-4, 0.0), 0.005, **{"path.tool": np.ones(1401)})
    run.info = {"parameters": {"milling": {"diameter": 0.001}}}
    one = result(run)
    assert np.all(one.nominal.radius - 0.0005 == EXACT)
    assert one.figures.max_deviation_m == pytest.approx(1e-4, rel=1e4 * ROUNDOFF)


def released(engaged: np.ndarray, late: float, since: float = 0.0) -> Recorded:
    """The deflection is there `since` a time [s], falls within 40 ms from 1.5 s on; the correction `late` [s]; `engaged` is the depth."""
    run = Recorded(along(0.0, -0.01, len(engaged)), (0.0, 1e-3, 0.0), 0.01)
    fall = np.clip(1.0 - (run.t - 1.5) / 0.04, 0.0, 1.0), np.clip(1.0 - (run.t - 1.5 - late) / 0.04, 0.0, 1.0)
    there = (run.t >= since), (run.t >= since + late)
    d, c = (1e-3 * (f * on)[:, None] * [0.0, 1.0, 0.0] for f, on in zip(fall, there, strict=True))
    run |= {"milling.depth": engaged, "compliance.d_T_B": d, "compliance.p_BT_B": run["path.p_BT_B"] + d - c}
    return run


def test_a_reaction_time_is_read_where_the_cutter_leaves_and_stays_out() -> None:
    """Where it is soon in the material again, the levels before and after are no step (a boss crossed by its own groove: -730 ms)."""
    t = 0.004 * np.arange(1000)
    assert reaction_time(cast(Run, released(np.where(t < 1.53, 0.01, 0.0), 0.1))) == pytest.approx(0.1, rel=1e3 * ROUNDOFF)
    assert np.isnan(reaction_time(cast(Run, released(np.where((t < 1.53) | (t > 1.6), 0.01, 0.0), 0.1))))
    assert np.isnan(reaction_time(cast(Run, released(np.full(1000, 0.01), 0.1))))


def test_a_rim_in_passing_has_no_reaction_time() -> None:
    """Scraping along its own groove before, the tool is in the material all the time but deflected for 0.15 s: -13 ms on a boss."""
    t = 0.004 * np.arange(1000)
    scraped = released(np.where(t < 1.53, 0.01, 0.0), 0.1, since=1.35)
    scraped["compliance.d_T_B"][:, 1] += np.where(t < 1.35, 6e-6, 0.0)
    assert np.isnan(reaction_time(cast(Run, scraped)))


def test_compiling_is_no_part_of_the_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Components are compiled until the first step is over, the loop until the first chunk is."""
    now = 0.0
    monkeypatch.setattr(milling.time, "perf_counter", lambda: now)
    watch = milling._Stopwatch()
    watch.observe(0.0, np.zeros(1))
    now = 10.0
    watch.observe(0.004, np.zeros(1))
    now = 12.0
    for end in (0.036, 10.036):
        watch.observe_columns(np.array([[0.0, end, 99.0], [0.0, 0.0, 0.0]]), 2)
        now = 13.0
    watch.end("finished", "")
    assert watch.factor == pytest.approx(10.0, rel=ROUNDOFF)
