"""A component from outside: the example package is installed, built, run and diagnosed as its user would do it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """A copy of the example, and an environment in which its package is installed."""
    work, site = tmp_path_factory.mktemp("work") / "kalman_sensor", tmp_path_factory.mktemp("site")
    shutil.copytree(ROOT / "examples" / "kalman_sensor", work, ignore=shutil.ignore_patterns("__pycache__"))
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--target", str(site), "."]
    subprocess.run(pip, cwd=work, check=True, capture_output=True)
    shutil.rmtree(work / "kalman_sensor")  # so that it is the installed one that is tested
    return work, {**os.environ, "PYTHONPATH": str(site)}


def run(installed: tuple[Path, dict[str, str]], *command: str) -> str:
    """Output of a command in the folder of the example."""
    done = subprocess.run([sys.executable, *command], cwd=installed[0], env=installed[1], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_its_own_tests_pass(installed: tuple[Path, dict[str, str]]) -> None:
    assert " passed" in run(installed, "-m", "pytest", "-p", "no:cacheprovider", "-W", "error")


@pytest.mark.slow
def test_it_is_built_by_name_and_passes_the_battery(installed: tuple[Path, dict[str, str]]) -> None:
    work = installed[0]
    for backend in ("python", "native"):
        run(installed, "-m", "robomill", "build", "--component", "kalman_sensor", "--backend", backend, "--out", f"{backend}")
    fmus = [str(work / backend / "kalman_sensor.fmu") for backend in ("python", "native")]
    assert "no check failed" in run(installed, "-m", "robomill", "check", *fmus)


@pytest.mark.slow
def test_its_python_fmu_starts_where_the_package_is_not_installed(installed: tuple[Path, dict[str, str]], tmp_path: Path) -> None:

    run(installed, "-m", "robomill", "build", "--component", "kalman_sensor.model:MODEL", "--out", str(tmp_path))
    script = (
        "import fmpy, importlib.util, sys; assert importlib.util.find_spec('kalman_sensor') is None; "
        "r = fmpy.simulate_fmu(sys.argv[1], stop_time=0.02, output_interval=0.004, start_values={'f_T_B[1]': 10.0}); print(len(r), 'rows')"
    )
    away = {k: v for k, v in installed[1].items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "kalman_sensor.fmu")],
        cwd=tmp_path,
        env=away,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "6 rows" in done.stdout, done.stderr
