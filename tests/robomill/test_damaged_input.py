"""Every file that people write, with one value replaced by something else: read, or refused with the file and the line; never a crash."""

from __future__ import annotations

import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from robomill.cell.equipment import load_system
from robomill.cell.experiments import load_experiment
from robomill.cell.next_runs import load_kinds
from robomill.cell.points import PathError, read_points
from robomill.cell.scenario import ScenarioError, load_scenario
from robomill.diagnosis.candidates import CatalogueError
from robomill.diagnosis.catalogue import Catalogue
from robomill.logs.mapping import load_mapping
from robomill.logs.reading import LogError
from robomill.orchestration.errors import OrchestrationError
from tests import ROOT

READERS: list[tuple[str, Callable[[Path], object]]] = [
    ("scenarios/groove.toml", load_scenario),
    ("scenarios/milling_cell.toml", load_system),
    ("scenarios/experiments/tap_test.toml", load_experiment),
    ("scenarios/next_runs/kinds.toml", load_kinds),
    ("scenarios/tutorial/map.toml", load_mapping),
    ("scenarios/catalogue.toml", Catalogue.load),
    ("scenarios/parts/tilted_square.toml", read_points),
]
STRANGE = (
    *(
        "true",
        "nan",
        "inf",
        "-inf",
        '""',
        '" "',
        "[]",
        "{}",
        "[[]]",
        "-1",
        "0",
        "1e400",
        "9" * 400,
        '"16 MM"',
        '"mm"',
        '"-2 1"',
        "1979-05-27",
    ),
    *(
        "{value = 1}",
        "{value = [1], unit = 3}",
        '{value = "1", unit = "mm"}',
        "[1, [2]]",
        "{file = 3}",
        '"../x"',
        "[true]",
        '"NaN mm"',
        "[{a = 1}]",
    ),
)


def damaged(text: str, random_: random.Random) -> str:
    lines = text.splitlines()
    i = random_.choice([k for k, line in enumerate(lines) if re.match(r"^[\w.\"\[\]]+ *= ", line)])
    key = lines[i].split("=")[0]
    lines[i] = f"{key}= {random_.choice(STRANGE)}"
    if random_.random() < 0.1:
        lines.insert(i, lines[i])
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(("name", "read"), READERS, ids=[name for name, _ in READERS])
def test_a_damaged_value_is_read_or_refused_with_its_file(name: str, read: Callable[[Path], object], tmp_path: Path) -> None:
    shutil.copytree(ROOT / "scenarios", tmp_path / "scenarios")  # files name others relative to their own folder
    random_, file = random.Random(2030), tmp_path / name
    text, refused = file.read_text(encoding="utf-8"), []
    for _ in range(80):
        file.write_text(damaged(text, random_), encoding="utf-8")
        try:
            read(file)
        except (OrchestrationError, ScenarioError, LogError, CatalogueError, PathError, FileNotFoundError) as error:
            refused.append(str(error))
    assert len(refused) > 20
    assert all(file.name in said and "Traceback" not in said for said in refused)
