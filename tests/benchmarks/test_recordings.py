"""The benchmark on recordings: its yardstick is least squares, and what it says of the machines stands in their catalogues."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recordings import page, table
from benchmarks.recordings.cases import PREPARED, Case, cases, prepare
from benchmarks.recordings.earlier import earlier
from benchmarks.recordings.measure import Closure, Outcome, Value, measured
from benchmarks.recordings.yardstick import View, closures, fit, left_one_out
from robomill.diagnosis.candidates import Candidate
from robomill.orchestration.runs.run import Run
from tests import ROOT
from tests.tolerances import EXACT, physics

ALL = {c.name: c for c in cases()}
KEPT = 1e-6
"""Relative: the trace of 1e-9 on the diagonal of the normal equations, over the smallest of their eigenvalues (some 1e-3)."""


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("prepared")
    prepare(folder)
    return folder


@pytest.fixture(scope="module")
def fanuc(prepared: Path, tmp_path_factory: pytest.TempPathFactory) -> list[View]:
    case = ALL["fanuc_r2000ic"]
    return [View(case, r, case.system()) for part in case.runs(tmp_path_factory.mktemp("runs"), prepared) for r in part]


def candidates(case: Case, *effects: str) -> list[Candidate]:
    return [c for c in case.catalogue().candidates if c.effect in effects or c.name in effects]


@pytest.mark.parametrize("name", ALL)
def test_what_is_known_of_a_machine_is_in_its_catalogue_and_its_logs_are_there(name: str, prepared: Path) -> None:
    case = ALL[name]
    assert {*case.expected, *case.absent} <= {c.name for c in case.catalogue().candidates}
    for log in case.logs:
        file = str(log["log"])
        assert (prepared / file.removeprefix(PREPARED) if file.startswith(PREPARED) else case.folder / file).is_file()
    assert all(case.places())


def test_the_bag_is_cut_into_halves_that_are_moved_by_their_own_angles(prepared: Path, tmp_path: Path) -> None:
    """3 441 samples at 125 Hz of six joints; speeds are those of the angles, as they were logged, too."""
    case = ALL["ur10"]
    (first,), (second,) = case.runs(tmp_path, prepared)
    assert len(first) == len(second) == 3441 // 2
    for run in (first, second):
        assert run.t[0] == EXACT
        assert np.corrcoef(np.gradient(run["motion.q"][:, 0], run.t), run["motion.qd"][:, 0])[0, 1] > 0.999
    assert np.abs(first["motion.q"][-1] - second["motion.q"][0]).max() < 0.05


@pytest.mark.paper
def test_six_joint_compliances_leave_what_is_published_of_the_fanuc(fanuc: list[View]) -> None:
    """Rms in mm: 1.725 rigid, 0.372 fitted, 0.405 each load predicted from the others (ABOUT.md of the data), printed with three digits."""
    found = left_one_out(fanuc, candidates(ALL["fanuc_r2000ic"], "joint_compliance"))
    assert np.array(found) * 1e3 == pytest.approx([1.725, 0.372, 0.405], abs=physics(0.0, absolute=6e-4))


def test_least_squares_finds_what_the_signals_were_made_with(fanuc: list[View]) -> None:
    case = ALL["fanuc_r2000ic"]
    chosen = candidates(case, "joint_compliance", "tilt_compliance @ joint 3")
    truth = {c.addresses[0]: (k + 1.0) * 1e-7 for k, c in enumerate(chosen)}
    made = []
    for v in fanuc:
        columns = {**v.run.columns, **dict(zip(v.channels, v.model(truth).T, strict=True))}
        made.append(View(case, replace(v.run, columns=columns), v.system))
    # the views are driven by the runs on disk, whose loads are the same
    found = fit(made, chosen)
    assert found.values == pytest.approx(truth, rel=1e3 * KEPT)
    assert all(c == pytest.approx(1.0, abs=KEPT) for _, _, c in closures(made, truth).values())
    assert all(c == EXACT and before == after for before, after, c in closures(made, {}).values())


def test_an_axis_that_stands_does_not_count(prepared: Path, tmp_path: Path) -> None:
    case = ALL["ur10"]
    run = case.runs(tmp_path, prepared)[0][0]
    view = View(case, run, case.system())
    assert case.standing is not None
    for i, name in enumerate(view.channels):
        speed = np.abs(run.columns[name.replace("robot.torque_motor", "motion.qd")])
        assert np.array_equal(view.counts[:, i], speed >= case.standing.below)
    assert 0.9 < view.counts.mean() < 1.0


def outcome() -> Outcome:
    values = [
        Value("friction @ joint 1", "friction[1]", "N.m", 0.98, 3.0, (2.0, 4.0), 3.5, (3.1, 3.9), "expected"),
        Value("gain @ joint 2", "gain[2]", "1", 0.9, 0.1, (0.05, 0.15), None, None, "more"),
        Value("wear @ tool", "wear", "W", 0.0, None, None, None, None, "absent"),
        Value("friction @ joint 2", "friction[2]", "N.m", 0.0, None, None, 1.0, (0.5, 1.5), "expected"),
    ]
    return Outcome("ur10", "identified", True, {"p_none": 0.001}, values, [Closure("robot.torque[1]", "N.m", 10.0, 1.0, 0.99, 0.98)])


def test_page_and_table_say_what_was_found_and_what_was_not() -> None:
    text = page.text(ALL["ur10"], outcome())
    assert "**Verdict**: identified. Nothing was repeated: the noise is a guess." in text
    assert "| friction @ joint 1 | expected | 0.98 | 3 (2 to 4) | 3.5 (3.1 to 3.9) | N.m |" in text
    assert "| wear @ tool | absent | - | - | - | W |" in text
    assert "1 of 1 values by least squares lie in the intervals of the answer." in text
    assert "Expected and not named: friction @ joint 2." in text
    assert "| robot.torque[1] | 10 | 1 | N.m | 99.0 % | 98.0 % |" in text
    assert "| ur10 | identified | 1 of 2 | 1 | 0 | 1 of 1 | 99.0 %, 99.0 % | 98.0 %, 98.0 % | 0.0 | 0 |" in table.summary([outcome()])


def test_the_first_edition_stands_beside_the_answer() -> None:
    first = earlier("kuka_kr300")
    assert first is not None
    case, catalogue = ALL["kuka_kr300"], {c.name for c in ALL["kuka_kr300"].catalogue().candidates}
    assert set(first.effects) <= catalogue
    assert all(low <= value <= high for value, low, high in first.effects.values())
    value = Value("encoder_lag @ log", "encoder_lag", "s", 1.0, 3.1e-3, (3e-3, 3.2e-3), 3.05e-3, (3e-3, 3.1e-3), "expected")
    far = [Closure("robot.torque_motor[1]", "N.m", 1.6, 0.8, 0.75, 0.9), Closure("robot.other", "N.m", 1.0, 0.5, 0.75, 0.9)]
    text = page.text(case, Outcome("kuka_kr300", "identified", True, {}, [value], far))
    assert "| 1.00 | 0.0031 (0.003 to 0.0032) | 0.00305 (0.003 to 0.0031) | 0.003038 (0.002987 to 0.003088) | s |" in text
    assert (
        "1 of 21 expected effects are named; the channels of the held-out runs close by 75.0 % in the mean (least squares 90.0 %)." in text
    )
    assert "named 21 of them, and closed 99.0 % in the mean. It named friction_stribeck @ joint 4," in text
    assert "| robot.torque_motor[1] | 1.6 | 0.8 | N.m | 75.0 % | 90.0 % | 99.0 % |" in text
    assert "| robot.other | 1 | 0.5 | N.m | 75.0 % | 90.0 % | - |" in text
    assert earlier("ur10") is None
    assert "irst edition" not in page.text(ALL["ur10"], outcome())


@pytest.mark.parametrize("name", ALL)
def test_the_commands_of_a_page_name_files_that_are_there(name: str) -> None:
    *imports, diagnosis = page.commands(ALL[name])
    words = [w for line in (*imports, diagnosis) for w in line.split()]
    assert all((ROOT / w).exists() for w in words if w.startswith(("scenarios/", "data/")))
    assert "--held-out" in diagnosis
    assert len([line for line in imports if line.startswith("robomill import")]) == len(ALL[name].logs)


def test_a_diagnosis_that_fails_is_an_outcome(prepared: Path, tmp_path: Path) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ZeroDivisionError("float division by zero")

    found = measured(ALL["fanuc_r2000ic"], tmp_path, prepared, fails)  # type: ignore[arg-type]
    assert (found.verdict, found.error) == ("crash", "ZeroDivisionError: float division by zero")
    assert "crash" in table.of(ALL["fanuc_r2000ic"], found)
    assert "ZeroDivisionError" in page.text(ALL["fanuc_r2000ic"], found)


@pytest.mark.slow
def test_friction_of_the_mill_is_found_and_wear_is_not(prepared: Path, tmp_path: Path) -> None:
    found = measured(ALL["cnc_mill_wax"], tmp_path, prepared)
    assert "coulomb_friction_x @ axis x" in {v.effect for v in table.named(found, "expected")}
    assert table.named(found, "absent") == []
    assert isinstance(Run.load(tmp_path / "01").info["parameters"]["spindle"]["tool_worn"], bool)


@pytest.mark.slow
def test_a_coupling_that_the_catalogue_has_is_named_where_the_model_has_none(prepared: Path, tmp_path: Path) -> None:
    found = measured(ALL["fanuc_uncoupled"], tmp_path, prepared)
    assert (found.verdict, found.error) == ("identified", "")
    assert "coupling_error @ joint 3" in {v.effect for v in table.named(found, "expected")}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kuka_kr300", "ur10", "fanuc_r2000ic"])
def test_a_robot_has_no_name_that_it_cannot_have(name: str, prepared: Path, tmp_path: Path) -> None:
    found = measured(ALL[name], tmp_path, prepared)
    assert (table.named(found, "absent"), found.error) == ([], "")
    assert found.verdict in ("identified", "ambiguous")
    assert len(table.named(found, "expected")) > len(ALL[name].expected) // 2
