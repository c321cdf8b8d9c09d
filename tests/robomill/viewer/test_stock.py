"""The part of the page: at every time the part that was there then."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robomill.cell.evaluation import evaluate
from robomill.viewer.recorded import Recorded, recordings
from robomill.viewer.stock import FINEST, LEVELS, STEP, Stock, cut_stock, patches
from tests.tolerances import EXACT, ROUNDOFF, discretisation


@pytest.fixture(scope="module")
def shown(results: Path) -> tuple[Recorded, Stock]:
    r = recordings(results, ["uncompensated"])[0][0]
    workpiece = r.workpiece()
    assert workpiece is not None
    return r, cut_stock(r, workpiece)


def heights(stock: Stock, frame: int) -> np.ndarray:
    """Heights [m] (ny, nx) over the bottom at a kept sample."""
    levels = stock.start.astype(float)
    for cell, level in zip(stock.cell[stock.frame <= frame], stock.level[stock.frame <= frame], strict=True):
        levels[cell] = level
    return levels.reshape(stock.shape) / LEVELS * (stock.high[2] - stock.low[2])


def test_the_slot_is_there_at_the_end_and_not_before(shown: tuple[Recorded, Stock]) -> None:
    r, stock = shown
    deep = 0.005
    assert np.all(heights(stock, 0) == 0.01)
    end = heights(stock, len(r.kept))
    x, y = (np.linspace(stock.low[i], stock.high[i], 2 * n + 1)[1::2] for i, n in ((0, stock.shape[1]), (1, stock.shape[0])))
    slot = np.ix_(np.abs(y) < 0.006, x < -0.002)
    assert np.all(np.abs(end[slot] - (0.01 - deep)) < 2e-4)  # the robot bends by less in z
    assert np.all(end[np.abs(y) > 0.011] == 0.01)
    assert np.all(end[:, x > 0.0105] == 0.01) if np.any(x > 0.0105) else True


def test_a_cell_is_cut_when_the_tool_comes(shown: tuple[Recorded, Stock]) -> None:
    r, stock = shown
    assert np.all(np.diff(stock.frame.astype(int)) >= 0)
    radius = 0.008
    tip = r.run["compliance.p_BT_B"] - np.array([1.3, 0.0, 1.2])
    tip[:, :2] *= -1.0  # the workpiece is turned by 180 degrees
    nx = stock.shape[1]
    pitch = (stock.high[0] - stock.low[0]) / nx
    centre = np.stack([stock.low[0] + (stock.cell % nx + 0.5) * pitch, stock.low[1] + (stock.cell // nx + 0.5) * pitch], axis=1)
    here = tip[r.kept][stock.frame, :2]
    before = tip[r.kept][stock.frame - 1, :2]
    far = np.minimum(np.linalg.norm(here - centre, axis=1), np.linalg.norm(before - centre, axis=1))
    step = np.linalg.norm(np.diff(tip[r.kept], axis=0), axis=1).max()
    assert far[stock.frame < len(r.kept) - 1].max() < radius + step + pitch  # at the last sample comes what was too little before


def test_the_volume_is_that_of_the_recorded_removal(shown: tuple[Recorded, Stock]) -> None:
    r, stock = shown
    area = np.prod(stock.high[:2] - stock.low[:2]) / np.prod(stock.shape)
    gone = area * float(np.sum(heights(stock, 0) - heights(stock, len(r.kept))))
    recorded = float(np.sum(r.run["milling.removal_rate"][1:] * np.diff(r.run.t)))
    # both count cells: along the edge of the slot of 20 mm and 5 mm depth, half a cell of either
    assert gone == pytest.approx(recorded, rel=0.0, abs=discretisation(0.5 * 0.05 * 0.005, FINEST + 5e-4, 1))


def test_changes_end_as_if_cut_at_once(shown: tuple[Recorded, Stock]) -> None:
    r, stock = shown
    workpiece = r.workpiece()
    assert workpiece is not None
    coarse = cut_stock(Recorded(r.name, r.run, r.tool, r.planned, r.force, r.angles, np.array([0, len(r.run) - 1])), workpiece)
    last = [stock.start.astype(int), coarse.start.astype(int)]
    for levels, s in zip(last, (stock, coarse), strict=True):
        levels[s.cell] = s.level  # the last change of a cell counts
    assert np.abs(last[0] - last[1]).max() <= EXACT + 1  # a level: rounding
    assert len(coarse.cell) < len(stock.cell)
    falls = np.diff(stock.level[stock.cell == stock.cell[0]].astype(int))
    assert np.all(falls[:-1] < -LEVELS * STEP / 0.01 * 0.5)


def test_the_colours_are_what_the_run_was_measured_at(shown: tuple[Recorded, Stock]) -> None:
    r, _ = shown
    workpiece = r.workpiece()
    assert workpiece is not None
    found, want = patches(r, workpiece), evaluate("", "", r.run, workpiece, 1.0).figures
    assert found is not None
    assert want.max_deviation_m is not None
    assert np.abs(found.deviation).max() == pytest.approx(want.max_deviation_m, rel=ROUNDOFF)
    assert np.all(np.diff(found.time) >= 0.0)
    assert FINEST < found.size < 3e-3
    air = Recorded(r.name, r.run, r.tool, None, r.force, r.angles, r.kept)
    assert patches(air, workpiece) is None
