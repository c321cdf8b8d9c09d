"""`import robomill as rm`: what scripts and notebooks use."""

from __future__ import annotations

import doctest
import subprocess
import sys
from pathlib import Path

import pytest

import robomill as rm
from robomill import api, diagnose_command, loading
from tests import SCENARIOS
from tests.diagnosis import axis
from tests.robomill.test_cli import PROGRAM

BAR = 'name = "bar"\nstep = "4 ms"\nstop = "0.1 s"\n[components.drive]\nsource = "robot_drive"\n'


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short scenario of two variants."""
    folder = tmp_path_factory.mktemp("part")
    (folder / "milling_cell.toml").write_text((SCENARIOS / "milling_cell.toml").read_text())
    (folder / "part.ngc").write_text(PROGRAM)
    (folder / "part.toml").write_text(
        '[scenario]\nname = "part"\nkind = "milling"\nsystem = "milling_cell.toml"\nprogram = "part.ngc"\n'
        '[workpiece]\nposition = ["1300 mm", 0, "1.2 m"]\nabc = ["180 deg", 0, 0]\nsize = ["10 mm", "60 mm", "30 mm"]\n'
        "[variants.uncompensated]\nparameters.controller.mode = 0\n[variants.cartesian]\nparameters.controller.mode = 1\n"
    )
    return folder / "part.toml"


def test_the_examples_of_the_docstrings_hold() -> None:
    assert all(doctest.testmod(module, raise_on_error=True).attempted > 0 for module in (api, loading))


def test_the_package_itself_loads_nothing_and_offers_the_names_of_its_module() -> None:
    assert set(rm.__all__) == set(api.__all__) <= set(dir(rm))
    script = "import robomill, sys; print([m for m in ('numpy', 'robomill.api', 'matplotlib') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_what_is_loaded_is_what_the_file_is(part: Path, tmp_path: Path) -> None:
    assert isinstance(rm.load(part), rm.Scenario)
    assert rm.load("milling_cell").name == "milling_cell"  # type: ignore[union-attr]
    assert rm.load("servo_axis").component("axis").source  # type: ignore[union-attr]
    (tmp_path / "bar.toml").write_text(BAR)
    made = rm.run(str(tmp_path / "bar.toml"), tmp_path / "run")
    found = rm.load(tmp_path / "run")
    assert isinstance(found, rm.Run)
    assert isinstance(made, rm.Run)
    assert (found["drive.q_link"] == made["drive.q_link"]).all()
    with pytest.raises(FileNotFoundError, match=r"is no run: there is no run\.toml in it; give the folder of one of its runs: run$"):
        rm.load(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match=r"empty is no run: there is no run\.toml in it; give one that `robomill run` has written"):
        rm.load(tmp_path / "empty")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("grove", r"there is no file grove, and it is no name of a file that comes with robomill: .*did you mean 'groove'"),
        ("dist/cell.ssp", r"no file dist/cell\.ssp"),
    ],
)
def test_a_name_that_does_not_exist_is_refused_with_those_that_do(name: str, text: str) -> None:
    with pytest.raises(FileNotFoundError, match=text):
        rm.load(name)


def test_a_package_and_a_file_that_is_no_toml_are_refused(tmp_path: Path) -> None:
    (tmp_path / "cell.ssp").write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"cell\.ssp: an SSP package is unpacked .* run it with: robomill run "):
        rm.load(tmp_path / "cell.ssp")
    (tmp_path / "cell.toml").write_text("name = \n")
    with pytest.raises(Exception, match=r"cell\.toml.*TOML"):
        rm.load(tmp_path / "cell.toml")


def test_a_scenario_gives_a_run_for_each_variant_and_its_figures(part: Path) -> None:
    scenario = rm.load_scenario(part)
    runs = rm.run(scenario)
    assert list(runs) == ["uncompensated", "cartesian"]
    assert runs["cartesian"]["compliance.p_BT_B"].shape == (len(runs["cartesian"]), 3)
    deviations = {name: figures.max_deviation_m for name, figures in runs.figures.items()}
    assert deviations["cartesian"] is not None
    assert deviations["uncompensated"] is not None
    assert deviations["cartesian"] < deviations["uncompensated"]
    assert "uncompensated" in runs._repr_html_()
    assert len(runs.plot().axes) >= len(runs)
    with pytest.raises(KeyError, match="unknown variant 'kartesian'; did you mean 'cartesian'"):
        runs["kartesian"]
    pytest.importorskip("pandas")
    assert list(runs.to_pandas().index) == list(runs)
    folder = runs.folder
    assert folder.is_dir()
    del runs
    assert not folder.exists()


def test_parameters_are_set_in_place_of_those_of_the_variant(part: Path, tmp_path: Path) -> None:
    one = rm.run(part, tmp_path, variant="cartesian", parameters={"controller": {"mode": 0}, "compliance": {"stiffness_error[2]": -0.1}})
    assert one.info["parameters"]["controller"]["mode"] == 0
    assert one.info["parameters"]["compliance"]["stiffness_error[2]"] == -0.1
    assert (one.folder, (tmp_path / "summary.json").is_file()) == (tmp_path / "cartesian", True)
    with pytest.raises(Exception, match=r"already holds a run .*overwrite = True"):
        rm.run(part, tmp_path, variant="cartesian")


def test_options_that_would_be_ignored_are_refused(part: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="stop goes with systems; the scenario 'part' takes its step and its end"):
        rm.run(part, stop=1.0)
    with pytest.raises(ValueError, match="variant = 'a' goes with scenarios; the system 'static_cell' is one run"):
        rm.run("static_cell", variant="a")
    with pytest.raises(ValueError, match=r"'static_loads' is of the kind 'static_loads', expected milling; run it with: robomill run "):
        rm.run("static_loads")
    (tmp_path / "bar.toml").write_text(BAR)
    rm.run(str(tmp_path / "bar.toml"), tmp_path / "run")
    with pytest.raises(ValueError, match="is the folder of a run that has been made; expected a scenario or a system file"):
        rm.run(tmp_path / "run")
    for what in (part, "static_cell"):
        with pytest.raises(TypeError, match="unknown option 'overwite'; did you mean 'overwrite'"):
            rm.run(what, overwite=True)  # type: ignore[call-overload]


def test_a_diagnosis_has_verdict_effects_closure_and_a_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnose_command, "resolve", axis.resolve)  # components that are none of robomill's
    axis.catalogue(tmp_path)
    runs = axis.measure({"coulomb": 1.0}, repeats=3, columns=("drive.torque",))
    answer = rm.diagnose(axis.system(), runs, catalogue=tmp_path / "axis.toml")
    assert answer.verdict == "identified"
    (cause, *_) = answer.effects
    assert (cause.effect, cause.component) == ("coulomb", "drive")
    low, high = cause.parameters["coulomb"].interval
    assert low < 1.0 < high
    assert low < answer.adopted["drive", "coulomb"] < high
    assert set(answer.closure) == {f"{h.metric}, {h.on}" for h in answer.how_far}
    assert "coulomb" in answer._repr_html_()
    assert str(answer).startswith("verdict: identified")
    page = answer.report(tmp_path / "answer")
    assert {"report.html", "diagnosis.json", "adopt.ssv"} <= {f.name for f in page.parent.iterdir()}
    with pytest.raises(FileExistsError, match=r"diagnosis\.json is there already; .*overwrite = True"):
        answer.report(tmp_path / "answer")


def test_a_diagnosis_refuses_what_it_cannot_take() -> None:
    with pytest.raises(ValueError, match="groove is no system file; expected the system that simulates the runs"):
        rm.diagnose("groove", ["runs/a"])
    with pytest.raises(TypeError, match=r"runs = 'runs/a'; expected a list of folders or Runs, such as \['runs/a'\]"):
        rm.diagnose("milling_cell", "runs/a")
    with pytest.raises(ValueError, match="false_alarm = 2; expected a probability between 0 and 1"):
        rm.diagnose("milling_cell", ["runs/a"], false_alarm=2)
