"""The table of docs/explanation/mixing.md is what runs: robots x sensors x controllers x programming; the rest has a reason."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from docs import mixing_study
from docs.mixing_study import PAGE, ROBOTS, SENSORS, WAYS, Matrix, Outcome
from robomill.cell.combination import check_combination
from robomill.cell.equipment import load_system
from robomill.orchestration.errors import SystemFileError
from robomill.orchestration.system.definition import System
from tests import SCENARIOS
from tests.tolerances import physics

PRINTED = 0.006e-3
"""Half of the last digit that the table prints, and a little for other libraries of optimisation and geometry."""
QUICK = [
    ("KR 300", "none", "uncompensated"),
    ("KR 300", "ATI", "Cartesian"),
    ("KR 300", "current", "Cartesian"),
    ("KR 300", "none", "axis"),
    ("KR 300", "none", "rate"),
]


def printed() -> dict[tuple[str, str, str], str]:
    """Cells of the table in the page, by robot, sensor and way."""
    head, _, *lines = PAGE.read_text(encoding="utf-8").split("<!-- table -->\n")[1].splitlines()
    names = [c.strip() for c in head.strip("|").split("|")]
    found = {}
    for line in lines:
        robot, sensor, *cells = (c.strip() for c in line.strip("|").split("|"))
        found |= {(robot, sensor, way): cell for way, cell in zip(names[2:], cells, strict=True)}
    return found


def check(outcome: Outcome, cell: str) -> None:
    if outcome.deviation is None:
        assert outcome.text == cell, outcome.refusal
    else:
        assert abs(outcome.deviation - 1e-3 * float(cell)) < physics(0.0, absolute=PRINTED)


@pytest.fixture(scope="module")
def matrix(tmp_path_factory: pytest.TempPathFactory) -> Matrix:
    return Matrix(tmp_path_factory.mktemp("mixing"))


def test_the_table_has_every_combination_once() -> None:
    assert set(printed()) == {(r, s, w) for r in ROBOTS for s in SENSORS for w in WAYS}


@pytest.mark.parametrize("key", QUICK, ids=" ".join)
def test_some_of_it(key: tuple[str, str, str], matrix: Matrix) -> None:
    check(matrix.outcome(*key), printed()[key])


def test_the_texts_of_the_page_are_those_of_the_program(matrix: Matrix) -> None:
    page = PAGE.read_text(encoding="utf-8")
    for key in QUICK[2:]:
        refusal = matrix.outcome(*key).refusal.partition(": ")[2].replace("mode = 2", "mode = 1")
        assert f"`{refusal}`" in page


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_all_of_it(robot: str, matrix: Matrix) -> None:
    cells = printed()
    for key in mixing_study.asked():
        if key[0] == robot:
            check(matrix.outcome(*key), cells[key])


def test_the_table_is_written_as_it_is_read() -> None:
    outcomes = {key: Outcome(deviation=0.0012) for key in mixing_study.asked()}
    lines = mixing_study.rows(outcomes)
    assert len(lines) == 2 + len(ROBOTS) * len(SENSORS)
    assert set(lines[2].split("|")[3:-1]) == {" 1.20 "}


class TestRefusals:
    """The cell as it is, with one thing wrong."""

    @pytest.fixture
    def cell(self) -> System:
        return load_system(SCENARIOS / "mixing_cell.toml")

    def without(self, system: System, target: str) -> System:
        return replace(system, connections=tuple(c for c in system.connections if c.target != target))

    def test_the_cell_itself_is_right(self, cell: System) -> None:
        check_combination(cell.with_parameters("rate", {"variant": 2}).with_parameters("controller", {"mode": 1, "pilot": True}))

    @pytest.mark.parametrize("target", ["rate.feed", "path.speed_ratio"])
    def test_rate_control_needs_the_speed_of_the_path(self, cell: System, target: str) -> None:
        broken = self.without(cell, target)
        check_combination(broken)  # rate control is off
        with pytest.raises(SystemFileError, match=rf"variant = 1\), but nothing is connected to {target}: .*a speed_loop between"):
            check_combination(broken.with_parameters("rate", {"variant": 1}))

    def test_pilot_control_needs_the_estimated_force(self, cell: System) -> None:
        broken = self.without(cell, "controller.f_pilot_B").with_parameters("controller", {"mode": 1, "pilot": True})
        with pytest.raises(
            SystemFileError, match=r"pilot = true, but nothing is connected to controller.f_pilot_B: connect path.f_pilot_B"
        ):
            check_combination(broken)

    def test_the_compensation_of_paper_003_needs_a_force_by_default(self) -> None:
        cell = self.without(load_system(SCENARIOS / "irb6400" / "cell.toml"), "controller.f_T_T")
        with pytest.raises(SystemFileError, match=r"cell.toml:\d+: component 'controller' compensates \(mode = \d\), but nothing"):
            check_combination(cell)

    def test_what_others_made_is_left_to_the_wiring(self, cell: System, tmp_path: Path) -> None:
        check_combination(cell.with_source("sensor", str(tmp_path / "theirs.fmu")))
