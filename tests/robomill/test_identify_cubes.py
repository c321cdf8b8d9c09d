"""`robomill identify cubes`: the shipped set, a table that a user fills, what is said of damaged ones."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from robomill.cli import main
from tests import SCENARIOS
from tests.tolerances import chance

SET = SCENARIOS / "cubes" / "kr300.toml"
READINGS = "kr300_readings.csv"


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """The shipped set in a folder of its own."""
    for name in (SET.name, READINGS):
        shutil.copy(SET.parent / name, tmp_path / name)
    return tmp_path / SET.name


def answer(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.paper
def test_shipped_set_gives_table_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Table 1 of paper 000 within four of the stated standard deviations, by the chain as well; two springs only roughly."""
    assert main(["identify", "cubes", str(SET), "--compare", "kr300_r2500_ultra", "--out", str(tmp_path), "--json"]) == 1
    found = answer(capsys)
    for spring in found["springs"]:
        printed, deviations = spring["compared_nm_per_rad"], spring["relative_deviations"]
        assert abs(printed / spring["stiffness_nm_per_rad"] - 1.0) < chance(spring["relative_deviation"])
        assert abs(printed / spring["chain_nm_per_rad"] - 1.0) < chance(deviations["chain"])
    assert {s["name"] for s in found["springs"] if s["finding"] != "determined"} == {"arm y", "linked arm x"}
    assert {p.name for p in tmp_path.iterdir()} == {"report.json", "report.txt", "cubes.png"}
    text = (tmp_path / "report.txt").read_text(encoding="utf-8")
    assert "a change of a reading: 0.67 um from the sensors, 0.66 um scatter about the chain" in text
    assert "not well known: linked arm x (no better than 20 %), arm y (no better than 20 %)" in text


def test_readings_are_simulated_once_and_the_same(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = copied.parent / READINGS
    assert main(["identify", "cubes", str(copied), "--simulate", "kr300_r2500_ultra"]) == 2
    assert "is there already, maybe measured; give --overwrite" in capsys.readouterr().err
    before = table.read_bytes()
    table.unlink()
    main(["identify", "cubes", str(copied), "--simulate", "kr300_r2500_ultra"])
    assert table.read_bytes() == before


def test_a_slipped_cube_is_told(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """20 um on all spots of a face."""
    table = copied.parent / READINGS
    rows = [line.split(",") for line in table.read_text(encoding="utf-8").splitlines()]
    for column in range(rows[0].index("carousel_1"), rows[0].index("carousel_1") + 3):
        rows[4][column] = f"{float(rows[4][column]) + 20.0:.3f}"
    table.write_text("\n".join(",".join(r) for r in rows) + "\n", encoding="utf-8")
    main(["identify", "cubes", str(copied)])
    text = capsys.readouterr().out
    assert "most at load 4, carousel" in text
    assert "the readings scatter more than the sensors do: a cube has slipped" in text


@pytest.mark.parametrize(
    ("file", "old", "new", "text"),
    [
        (READINGS, "carousel_2", "carousel_two", "carousel_2"),
        (SET.name, READINGS, "none.csv", "--simulate NAME writes what a robot with the springs NAME would give"),
        (SET.name, 'unit = "um"', 'unit = "mm"', "check the unit, and that readings are differences"),
        (SET.name, 'name = "wrist 4"', 'name = "wrist 5"', "two cubes are called 'wrist 5'"),
        (SET.name, 'behind = "axis 4"', 'behind = "axis 7"', "'axis 7'"),
        (SET.name, 'behind = "axis 4"', 'behind = "axis 5"', "between arm front and wrist 4 there are axis 4, axis 5; expected one joint"),
        (SET.name, 'compliance = "kr300_r2500_ultra"', "", "joints without compliance"),
        (SET.name, '["0 deg", "-60 deg",', '["-60 deg",', "expected six axis angles"),
        (SET.name, '[[load]]\nforce = ["750 N", "0 N", "0 N"]\n', "", "6 rows, 5 loads; expected one row per [[load]]"),
    ],
)
def test_damaged_sets(copied: Path, file: str, old: str, new: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    damaged = copied.parent / file
    damaged.write_text(damaged.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    assert main(["identify", "cubes", str(copied)]) == 2
    assert text in capsys.readouterr().err


def test_an_occluded_cube_is_named(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = copied.parent / READINGS
    lines = table.read_text(encoding="utf-8").splitlines()
    fields = lines[3].split(",")
    fields[lines[0].split(",").index("arm front_6")] = ""
    lines[3] = ",".join(fields)
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert main(["identify", "cubes", str(copied)]) == 2
    assert "load 3: cube arm front has 5 of 6 readings, which tell 5 of its six motions: occluded?" in capsys.readouterr().err
