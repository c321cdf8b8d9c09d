"""The native FMUs and the SSP package of a milling run in importers of others, against our master (`importers.py` drives them)."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from robomill.cell import milling
from robomill.cell import package as ssp
from robomill.cell.binding import convert
from robomill.cell.scenario import load_scenario
from robomill.fmus.components import COMPONENTS
from robomill.fmus.native.builder import build_all
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.ssp.importing import open_ssp
from tests import ROOT, SCENARIOS
from tests.cell.importers import STEP
from tests.cell.test_scenarios import short
from tests.tolerances import EXACT, ROUNDOFF, discretisation

NEEDED = {"libcosim": "libcosimpy", "Ecos": "ecospy", "FMU container": "fmu_manipulation_toolbox"}
pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="runs linux64 libraries")]

Outputs = dict[str, FloatArray]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The short groove with pilot control, all that it needs in one file."""
    folder = tmp_path_factory.mktemp("package")
    job = milling.prepare(short(load_scenario(SCENARIOS / "groove.toml"), folder), folder / "tables")
    (variant,) = [v for v in job.scenario.variants if v.name == "cartesian_pilot"]
    system = replace(milling.with_parameters(job.system, variant.parameters), name="cell", stop=job.steps * STEP)
    build_all([COMPONENTS[name] for name in ssp.used([system])], folder / "fmus")
    (file,) = ssp.write([system], folder / "fmus", folder, lambda *_: None)
    return file


@pytest.fixture(scope="module")
def ours(package: Path) -> Run:
    """Our master, stepping all components at once as the others do."""
    with open_ssp(package) as opened:
        result = run(replace(opened.system, algorithm="jacobi"), convert=convert)
    assert len(result) > 500
    assert np.ptp(result["milling.f_T_B"]) > 100.0  # N: it mills
    return result


@pytest.fixture(scope="module")
def theirs(package: Path, ours: Run, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Outputs]:
    """The real outputs that an importer gives, by its name; skipped where it is not installed."""

    @cache
    def outputs(name: str) -> Outputs:
        if name in NEEDED and importlib.util.find_spec(NEEDED[name]) is None:
            pytest.skip(f"{NEEDED[name]} is not installed")
        folder = tmp_path_factory.mktemp("importer")
        out = folder / "out.npz"
        command = [sys.executable, "-m", "tests.cell.importers", name, package, folder / "package", len(ours) - 1, out]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run([*map(str, command)], env=environment, capture_output=True, text=True, timeout=300, check=False)
        assert out.is_file(), f"{name}: status {done.returncode}\n{done.stdout}{done.stderr}"
        with np.load(out) as data:
            return dict(data)

    return outputs


def largest_difference(a: Outputs, b: Outputs) -> tuple[float, str]:
    """Relative to the largest value of the signal, with its name; rows that an importer does not show (NaN) do not count."""
    assert len(a) > 90
    rows = slice(1, None) if np.isnan(next(iter(a.values()))[0]) else slice(None)
    return max((float(np.abs(a[c][rows] - b[c][rows]).max() / max(np.abs(b[c][rows]).max(), np.finfo(float).tiny)), c) for c in a)


@pytest.mark.parametrize("name", ["FMPy", "Ecos", "FMU container"])
def test_the_same_numbers(name: str, theirs: Callable[[str], Outputs], ours: Run) -> None:
    found = theirs(name)
    assert largest_difference(found, {c: ours.columns[c] for c in found})[0] <= EXACT


def test_libcosim_differs_by_its_lengths_of_steps_and_by_nothing_else(theirs: Callable[[str], Outputs], ours: Run) -> None:
    """It hands out double(t + h) - double(t) instead of h: as far from h as doubles at t are apart."""
    found = theirs("libcosim")
    assert largest_difference(found, theirs("FMPy with the times of libcosim"))[0] <= EXACT
    uncertain = np.spacing(ours.t[-1]) / STEP  # relative, of the last step
    difference, column = largest_difference(found, {c: ours.columns[c] for c in found})
    assert 0.0 < difference <= discretisation(100.0, uncertain, 1), column  # 100: errors of some hundred steps, all of first order
    assert discretisation(100.0, uncertain, 1) < 100 * ROUNDOFF
