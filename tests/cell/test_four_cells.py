"""The cells of the four papers as SSP packages (`robomill build --ssp`) in importers of others, for 100 steps; `importers.py` drives them.

`test_importers.py` has the cell of paper 000 at length.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from robomill.cell import package as ssp
from robomill.cell.binding import convert
from robomill.fmus.components import COMPONENTS
from robomill.fmus.native.builder import build_all
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.ssp.importing import open_ssp
from tests import ROOT, SCENARIOS
from tests.cell.importers import STEP
from tests.cell.test_importers import NEEDED, Outputs, largest_difference
from tests.tolerances import EXACT

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="runs linux64 libraries")]

CELLS = {
    "000": ("robots/kr300_r2500_ultra.toml", "cartesian", "milling_cell.toml", 100),
    "001": ("kr500/slot.toml", "cartesian", "kr500/cell.toml", 100),
    "003": ("irb6400/rate_and_compensation.toml", "both", "irb6400/cell.toml", 100),
    "004": ("kr210/offline.toml", "online", "kr210/cell.toml", 100),
}
"""Paper -> scenario, variant, its system, communication steps."""


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("packages")
    made = {}
    for paper, (scenario, variant, cell, steps) in CELLS.items():
        (system,) = ssp.systems(SCENARIOS / scenario, folder / f"plan_{paper}", [variant])
        assert system.file == (SCENARIOS / cell).resolve()
        made[paper] = replace(system, name=f"cell_{paper}", stop=steps * system.step, stop_when=None)
    build_all([COMPONENTS[name] for name in ssp.used(list(made.values()))], folder / "fmus")
    return dict(zip(made, ssp.write(list(made.values()), folder / "fmus", folder, lambda *_: None), strict=True))


@pytest.fixture(scope="module")
def ours(packages: dict[str, Path]) -> Callable[[str], Run]:
    @cache
    def result(paper: str) -> Run:
        with open_ssp(packages[paper]) as opened:
            return run(replace(opened.system, algorithm="jacobi"), convert=convert)

    return result


@dataclass(frozen=True)
class Theirs:
    """What an importer gives; no outputs if it ended without."""

    outputs: Outputs
    text: str


@pytest.fixture(scope="module")
def theirs(packages: dict[str, Path], ours: Callable[[str], Run], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Theirs]:
    """What an importer gives, by its name and the paper; skipped where it is not installed."""

    @cache
    def found(name: str, paper: str) -> Theirs:
        if name in NEEDED and importlib.util.find_spec(NEEDED[name]) is None:
            pytest.skip(f"{NEEDED[name]} is not installed")
        folder = tmp_path_factory.mktemp("importer")
        out, here = folder / "out.npz", ours(paper)
        step = round(here.t[1] - here.t[0], 9)
        command = [sys.executable, "-m", "tests.cell.importers", name, packages[paper], folder / "package", len(here) - 1, out, step]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run([*map(str, command)], env=environment, capture_output=True, text=True, timeout=300, check=False)
        text = f"{name}: status {done.returncode}\n{done.stdout}{done.stderr}"
        if not out.is_file():
            return Theirs({}, text)
        with np.load(out) as data:
            return Theirs(dict(data), text)

    return found


@pytest.mark.parametrize("paper", CELLS)
@pytest.mark.parametrize("name", ["FMPy", "Ecos", "FMU container"])
def test_a_cell_runs_there_as_here(paper: str, name: str, theirs: Callable[[str, str], Theirs], ours: Callable[[str], Run]) -> None:
    found, here = theirs(name, paper), ours(paper)
    assert len(here) == CELLS[paper][-1] + 1
    assert found.outputs, found.text
    difference, column = largest_difference(found.outputs, {c: here.columns[c] for c in found.outputs})
    assert difference <= EXACT, column


@pytest.mark.parametrize("paper", [p for p in CELLS if p != "003"])
def test_libcosim_differs_by_its_lengths_of_steps(paper: str, theirs: Callable[[str, str], Theirs]) -> None:
    """As `test_importers.py` has it."""
    found = theirs("libcosim", paper)
    assert found.outputs, found.text
    difference, column = largest_difference(found.outputs, theirs("FMPy with the times of libcosim", paper).outputs)
    assert difference <= EXACT, column


def test_libcosim_does_not_start_the_cell_of_the_irb_6400(theirs: Callable[[str, str], Theirs]) -> None:
    """The drive sees -90 deg for A2 while libcosim initialises, where the KR 300 of the defaults waits and the IRB 6400 cannot be."""
    found = theirs("libcosim", "003")
    assert not found.outputs
    assert "drive (robot_drive): q_ref of A2 is -1.5707963267948966 rad at 0.0 s; expected -1.2217304763960306 to" in found.text


def test_one_of_them_has_a_step_of_2_ms(ours: Callable[[str], Run]) -> None:
    steps = {paper: round(ours(paper).t[1], 9) for paper in CELLS}
    assert steps == {"000": STEP, "001": STEP / 2, "003": STEP, "004": STEP}
