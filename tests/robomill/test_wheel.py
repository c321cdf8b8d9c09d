"""Installed, it stands alone: the wheel in an empty folder, beside packages of the user that are called as our folders are."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from robomill import __version__
from robomill.example_command import copy, examples
from robomill.fmus.components import NAMES
from tests.tolerances import physics

ROOT = Path(__file__).parents[2]
OURS = ("models", "fmus", "orchestration", "cell", "conformance", "diagnosis", "blind")


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel from this checkout, an sdist, and a wheel from that."""
    folder = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "hatchling", "build", "-d"]
    for target, place in (("wheel", folder / "direct"), ("sdist", folder / "source")):
        subprocess.run([*build, str(place), "-t", target], cwd=ROOT, check=True, capture_output=True)
    sdist = next((folder / "source").glob("*.tar.gz"))
    subprocess.run(["tar", "xf", str(sdist), "-C", str(folder)], check=True)
    subprocess.run(
        [*build, str(folder / "again"), "-t", "wheel"], cwd=folder / sdist.name.removesuffix(".tar.gz"), check=True, capture_output=True
    )
    return folder


@pytest.fixture(scope="module")
def installed(archives: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """The folder that the wheel from the sdist is installed in, and an environment in which only that is found."""
    site = tmp_path_factory.mktemp("site")
    wheel = next((archives / "again").glob("*.whl"))
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(site), str(wheel)]
    subprocess.run(pip, check=True, capture_output=True)
    return site, {**os.environ, "PYTHONPATH": str(site), "ROBOMILL_CACHE_DIR": str(site.parent / "cache")}


@pytest.fixture
def work(tmp_path: Path) -> Path:
    """A user's folder with packages of the same names, which do something else."""
    for name in OURS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('the wrong package')\n")
    return tmp_path


def robomill(installed: tuple[Path, dict[str, str]], work: Path, *arguments: str, status: Sequence[int] = (0,)) -> str:
    """Standard output of a command, started as the script of the wheel does."""
    start = "import sys; from robomill.cli import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", start, *arguments], cwd=work, env=installed[1], capture_output=True, text=True, check=False
    )
    assert done.returncode in status, done.stderr
    return done.stdout if done.returncode == 0 else done.stderr


@pytest.mark.slow
def test_archives_hold_each_file_once_and_no_link(archives: Path) -> None:
    direct, again = (zipfile.ZipFile(next((archives / n).glob("*.whl"))) for n in ("direct", "again"))
    names = direct.namelist()
    assert len(names) == len(set(names))
    assert {n.partition("/")[0] for n in names if ".dist-info" not in n} == {"robomill"}
    assert all((i.external_attr >> 28) != 0xA for i in direct.infolist())
    assert {n: direct.read(n) for n in names} == {n: again.read(n) for n in again.namelist()}


@pytest.mark.slow
def test_it_runs_beside_foreign_packages_of_the_same_names(installed: tuple[Path, dict[str, str]], work: Path) -> None:
    assert "groove" in robomill(installed, work, "example")
    told = robomill(installed, work, "run", "scenarios/groove.toml", status=(2,))
    assert "no scenario scenarios/groove.toml; `robomill example groove` copies it here" in told
    robomill(installed, work, "example", "robots/kr210_2")
    where = "import robomill, robomill.models as m; print(robomill.__file__, m.__file__)"
    files = subprocess.run([sys.executable, "-c", where], cwd=work, env=installed[1], capture_output=True, text=True, check=True).stdout
    assert all(Path(f).is_relative_to(installed[0]) for f in files.split())
    robomill(installed, work, "example", "groove")
    arguments = ("run", "scenarios/groove.toml", "--variant", "uncompensated", "--no-pictures", "--json")
    summary = json.loads(robomill(installed, work, *arguments))
    deviation = summary["variants"]["uncompensated"]["max_deviation_m"]
    assert deviation == pytest.approx(1.4e-3, abs=physics(1.4e-3, relative=0.1))  # sec. 3.2 of paper 000, as tests/cell/test_groove.py
    assert robomill(installed, work, "--version") == f"robomill {__version__}\n"


@pytest.mark.slow
@pytest.mark.parametrize(("name", "column"), [("servo_axis", "axis."), ("heated_rod", "rod.")])
def test_an_example_that_stands_alone_runs_from_the_wheel(
    installed: tuple[Path, dict[str, str]], work: Path, name: str, column: str
) -> None:
    robomill(installed, work, "example", name, name)
    assert {"README.md", "machine.py", "catalogue.toml"} <= {f.name for f in (work / name).iterdir()}
    told = json.loads(robomill(installed, work, "run", f"{name}/system.toml", "--json"))
    assert any(c.startswith(column) for c in told["columns"])
    script = "import robomill as rm; run = rm.load('results/" + told["system"] + "'); print(len(run), run.plot().axes[0].get_ylabel())"
    said = subprocess.run([sys.executable, "-c", script], cwd=work, env=installed[1], capture_output=True, text=True, check=True).stdout
    assert int(said.split()[0]) == told["rows"]


def _made_of(fmu: Path) -> dict[str, bytes]:
    """Files of an FMU; not what names the commit, which only a checkout knows."""
    with zipfile.ZipFile(fmu) as archive:
        return {n: archive.read(n) for n in archive.namelist() if not n.startswith("extra/com.github.robomill/")}


@pytest.mark.slow
def test_fmus_from_the_wheel_are_those_of_the_checkout(installed: tuple[Path, dict[str, str]], work: Path) -> None:
    for backend in ("python", "native"):
        robomill(installed, work, "build", "--backend", backend, "--component", "spindle_current", "--out", f"out_{backend}")
        here = [
            sys.executable,
            "-m",
            "robomill",
            "build",
            "--backend",
            backend,
            "--component",
            "spindle_current",
            "--out",
            str(work / f"here_{backend}"),
        ]
        subprocess.run(here, cwd=ROOT, check=True, capture_output=True)
        file = "spindle_current.fmu"
        one, other = (_made_of(work / f"{place}_{backend}" / file) for place in ("out", "here"))
        assert one == other, backend
    assert "spindle_current" in NAMES
    robomill(installed, work, "check", "out_native/spindle_current.fmu")


def test_every_example_is_copied_with_what_it_refers_to(tmp_path: Path) -> None:
    for name in examples():
        written = copy(name, tmp_path / name)
        assert written[0].is_file()
        assert len(written) == len(set(written)) > 1, name
    assert {f.name for f in copy("groove", tmp_path / "g")} == {"groove.toml", "groove.ngc", "milling_cell.toml", "catalogue.toml"}


def test_the_tutorial_of_the_log_brings_system_catalogue_and_program(tmp_path: Path) -> None:
    written = {f.relative_to(tmp_path).as_posix() for f in copy("tutorial", tmp_path)}
    own = {f"tutorial/{name}" for name in ("logs.py", "machine.toml", "map.toml")}
    assert written == own | {"milling_cell.toml", "catalogue.toml", "experiments/programs/slots.ngc"}


def test_a_component_of_your_own_is_copied_with_its_package(tmp_path: Path) -> None:
    written = {f.relative_to(tmp_path).as_posix() for f in copy("kalman_sensor", tmp_path)}
    assert {"README.md", "cell.toml", "pyproject.toml", "kalman_sensor/model.py", "kalman_sensor/catalogue.toml"} <= written


def test_what_is_there_is_not_replaced(tmp_path: Path) -> None:
    copy("groove", tmp_path)
    copy("groove", tmp_path)  # equal files stay
    (tmp_path / "groove.ngc").write_text("G0 X0\n")
    with pytest.raises(
        FileExistsError, match=r"groove\.ngc: there already, with another content; name another folder: robomill example groove DIR"
    ):
        copy("groove", tmp_path)
    assert (tmp_path / "groove.ngc").read_text() == "G0 X0\n"
    with pytest.raises(ValueError, match=r"unknown example 'grove'; did you mean 'groove'\? available: .*`robomill example` says"):
        copy("grove", tmp_path)
