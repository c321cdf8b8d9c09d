"""docs/tutorials/bring_your_own_system.md, word by word in an empty folder; and where the cause is not known, or there is none."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from robomill.cell.equipment import load_system
from robomill.diagnose_command import catalogue_of
from robomill.diagnosis.outcome.verdict import IDENTIFIED
from robomill.logs.importing import import_log
from robomill.orchestration.runs.run import Run

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorials" / "bring_your_own_system.md"
AXIS = ROOT / "examples" / "servo_axis"
BLOCKS: list[tuple[str, str]] = re.findall(r"```sh\n(.*?)```\n(?:```\n(.*?)```)?", PAGE.read_text(encoding="utf-8"), re.DOTALL)
"""Commands of the page, and what it says that they print."""
WELL = 0.9
"""Closure on the held-out condition: what the machine does otherwise than the model is a tenth of a gap at most."""

LATE = """description = "a late clock"
source = "made up"
unit = "s"
minimum = 1e-4
maximum = 0.1
sign = "both"
prior = {kind = "normal", scale = 0.01}
locations = [{name = "motor", parameters = ["lag axis.*"]}]
"""


@dataclass(frozen=True)
class Shell:
    """A folder in which `robomill` and `python` are those of this environment."""

    folder: Path
    path: Path
    printed: list[str] = field(default_factory=list)
    """What the commands of the page printed, line by line."""

    def run(self, commands: str, at: str = ".") -> str:
        """What the commands print; they end in the first one that fails."""
        environment = {
            **os.environ,
            "PATH": f"{self.path}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
            "OPENBLAS_NUM_THREADS": "1",
        }
        shell = ["sh", "-e", "-c", commands]
        done = subprocess.run(shell, cwd=self.folder / at, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def answer(self, folder: str) -> dict[str, Any]:
        """The diagnosis.json in a folder."""
        found: dict[str, Any] = json.loads((self.folder / folder / "diagnosis.json").read_text(encoding="utf-8"))
        return found

    def truth(self, folder: str) -> tuple[str, float]:
        """What was wrong with the machine."""
        ((name, value),) = json.loads((self.folder / folder / "truth.json").read_text(encoding="utf-8")).items()
        return name, value


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Shell:
    """The folder after all commands of the page."""
    path, folder = tmp_path_factory.mktemp("path"), tmp_path_factory.mktemp("empty")
    for name, module in (("robomill", " -m robomill"), ("python", "")):
        (path / name).write_text(f'#!/bin/sh\nexec "{sys.executable}"{module} "$@"\n', encoding="utf-8")
        (path / name).chmod(0o755)
    made = Shell(folder, path)
    made.printed.extend(made.run("\n".join(commands for commands, _ in BLOCKS)).splitlines())
    return made


def closures(answer: dict[str, Any]) -> list[float]:
    """Closures in the condition that was held out."""
    return [h["closure"] for h in answer["how_far"] if h["on"] == "held-out condition" and h["unit"] != "1" and h["closure"] is not None]


@pytest.mark.slow
def test_the_axis_is_found_to_have_the_play_that_the_machine_has(shell: Shell) -> None:
    answer, (name, value) = shell.answer("axis/answer"), shell.truth("axis/logs")
    assert (answer["verdict"], name) == ("identified", "backlash")
    (which,) = (w for w in answer["which"] if w["probability"] > IDENTIFIED)
    low, high = which["parameters"][name]["interval"]
    assert low < value < high
    assert min(closures(answer)) > WELL
    assert (shell.folder / "axis" / "adopted" / "run.toml").is_file()


@pytest.mark.slow
def test_the_page_shows_what_the_commands_print(shell: Shell) -> None:
    """To the last digit, but for times: whoever changes the diagnosis changes the page."""
    printed = {line.rstrip() for line in shell.printed}
    shown = [line.rstrip() for _, block in BLOCKS for line in block.splitlines() if line != "..." and not re.search(r", \d+ s$", line)]
    assert len(shown) > 50
    assert not [line for line in shown if line not in printed]


@pytest.mark.slow
def test_the_rod_is_found_to_lose_the_heat_that_it_loses(shell: Shell) -> None:
    answer, (name, value) = shell.answer("rod/answer"), shell.truth("rod/logs")
    assert (answer["verdict"], name) == ("identified", "loss_error")
    (which,) = (w for w in answer["which"] if w["probability"] > IDENTIFIED)
    low, high = which["parameters"][name]["interval"]
    assert low < value < high
    assert min(closures(answer)) > WELL


@pytest.mark.slow
def test_a_cause_that_is_not_listed_is_unknown_and_what_integrates_is_not_replayed(shell: Shell) -> None:
    """The sentence is that of the page."""
    head, *effects = re.split(r"(?m)^(?=\[\[)", (shell.folder / "axis" / "catalogue.toml").read_text(encoding="utf-8"))
    (shell.folder / "axis" / "without.toml").write_text(
        head + "".join(e for e in effects if 'name = "backlash"' not in e), encoding="utf-8"
    )
    said = shell.run("robomill diagnose system.toml runs/work-* --held-out runs/heavy-* --catalogue without.toml --out unknown", "axis")
    answer = shell.answer("axis/unknown")
    assert answer["verdict"] == "unknown"
    assert not [w for w in answer["which"] if w["probability"] > 0.5]
    sentence = f"where: {answer['not_replayed']}"
    assert sentence in " ".join(said.split())
    assert sentence in " ".join(PAGE.read_text(encoding="utf-8").split())
    assert "Not replayed alone: " in (shell.folder / "axis" / "unknown" / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(("folder", "first", "second"), [("axis", "work", "heavy"), ("rod", "bake", "anneal")])
def test_a_machine_that_is_as_it_should_be_has_nothing(shell: Shell, folder: str, first: str, second: str) -> None:
    shell.run(
        "python machine.py sound --effect none\n"
        "for i in 1 2 3; do\n"
        f"robomill import map.toml sound/{first}-$i.csv --out sound/runs/{first}-$i --label repeat=$i\n"
        f"robomill import map_{second}.toml sound/{second}-$i.csv --out sound/runs/{second}-$i --label repeat=$i\n"
        "done\n"
        f"robomill diagnose system.toml sound/runs/{first}-* --held-out sound/runs/{second}-* --out sound/answer\n",
        folder,
    )
    assert shell.answer(f"{folder}/sound/answer")["verdict"] == "none"


def test_a_mapping_sets_parameters_of_components_that_stand_in_a_file(tmp_path: Path) -> None:
    rows = "".join(f"{k}" + ";0,0" * 6 + "\n" for k in range(30))
    (tmp_path / "log.csv").write_text("logger\ntime_ms;set_deg;set_rpm;motor_deg;motor_rpm;iq_mA;table_deg\n" + rows, encoding="utf-8")
    import_log(AXIS / "map_heavy.toml", tmp_path / "log.csv", tmp_path / "run")
    assert Run.load(tmp_path / "run").info["parameters"] == {"program": {"stroke": 4.0, "pace": 1.3}, "axis": {"load_inertia": 0.004}}


def test_a_catalogue_beside_both_the_system_and_its_models_is_read_once_and_another_one_takes_its_place(tmp_path: Path) -> None:
    system = load_system(AXIS / "system.toml")
    own = catalogue_of(system, file=AXIS / "catalogue.toml")
    assert len(own.effects) == len(set(own.effects)) == 14
    (tmp_path / "other.toml").write_text(
        re.split(r"(?m)^(?=\[\[)", (AXIS / "catalogue.toml").read_text(encoding="utf-8"))[1], encoding="utf-8"
    )
    assert catalogue_of(system, file=tmp_path / "other.toml").effects == ("coulomb",)


def test_one_catalogue_of_a_package_is_about_several_of_its_components(tmp_path: Path) -> None:
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "axis_of_a_package.py").write_bytes((AXIS / "servo_axis.py").read_bytes())
    text = (AXIS / "catalogue.toml").read_text(encoding="utf-8")
    for component, model in (("axis", "axis_mechanics"), ("encoder", "table_encoder"), ("controller", "axis_controller")):
        text = text.replace(f'component = "{component}"', f'component = "{model}"')
    (tmp_path / "package" / "catalogue.toml").write_text(text, encoding="utf-8")
    written = (AXIS / "system.toml").read_text(encoding="utf-8").replace("servo_axis.py", "package/axis_of_a_package.py")
    (tmp_path / "system.toml").write_text(written, encoding="utf-8")
    (tmp_path / "more.toml").write_text('[[effect]]\nname = "late"\ncomponent = "logging"\n' + LATE, encoding="utf-8")
    found = catalogue_of(load_system(tmp_path / "system.toml"), file=tmp_path / "more.toml")
    assert {c.component for c in found.candidates} == {"axis", "encoder", "controller", "logging"}
    assert len(found.effects) == 15
