"""Sweeps: rows in their order with the bits of single runs, whatever makes them; what is finished stays."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.cli import main
from robomill.files import FILES
from robomill.fmus.components import component
from robomill.orchestration.assembly import run
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.runs.run import Run
from robomill.sweep_command import _values
from robomill.sweeping import ROWS, SweepError, SweepTable, sweep

SCENARIO = FILES / "scenarios" / "groove.toml"
CELL = load_system(FILES / "scenarios" / "milling_cell.toml")
STOP = 0.1
"""End of the short runs [s]."""
GRID = {"sensor.seed": [1.0, 2.0], "sensor.zero_drift[1]": [-10.0, 0.0]}
KEPT = ["peak(sensor.f_T_T)", "last(compliance.p_BT_B[3])"]


def short(**options: object) -> SweepTable:
    given = {"parameters": GRID, "summaries": KEPT, "stop": STOP, "jobs": 1, **options}
    return sweep(CELL, given.pop("parameters"), given.pop("summaries"), **given)  # type: ignore[arg-type]


def largest_force(found: Run) -> float:
    """Length of the largest force [N]; a function that other processes import."""
    return float(np.max(np.linalg.norm(found["sensor.f_T_T"], axis=1)))


@pytest.fixture(scope="module")
def table() -> SweepTable:
    return short()


def test_rows_come_in_the_order_of_the_grid_with_the_bits_of_single_runs(table: SweepTable) -> None:
    assert table.columns == (*GRID, *KEPT, "error")
    assert [(r["sensor.seed"], r["sensor.zero_drift[1]"]) for r in table.rows] == [(1.0, -10.0), (1.0, 0.0), (2.0, -10.0), (2.0, 0.0)]
    for r in table.rows:
        changed = CELL.with_parameters("sensor", {"seed": r["sensor.seed"]})
        changed = changed.with_parameters("sensor", {"zero_drift[1]": r["sensor.zero_drift[1]"]})
        alone = run(changed, None, stop=STOP, resolver=resolve, convert=convert)
        assert r[KEPT[0]] == largest_force(alone)
        assert r[KEPT[1]] == alone["compliance.p_BT_B[3]"][-1]
    assert len(set(table[KEPT[0]])) == 4


@pytest.mark.slow
def test_processes_and_a_dask_cluster_give_the_same_bits(table: SweepTable, tmp_path: Path) -> None:
    asked = {KEPT[0]: KEPT[0], KEPT[1]: KEPT[1], "own": largest_force}
    by_two = short(summaries=asked, jobs=2)
    assert [{k: v for k, v in r.items() if k != "own"} for r in by_two.rows] == list(table.rows)
    assert by_two["own"].tolist() == table[KEPT[0]].tolist()
    distributed = pytest.importorskip("distributed", reason="Dask is not installed (robomill[cluster])")
    with distributed.LocalCluster(1, processes=True, threads_per_worker=2, dashboard_address=None) as cluster:
        on_cluster = short(scheduler=cluster.scheduler_address, folder=tmp_path)
    assert on_cluster.rows == table.rows


def test_a_list_of_sets_and_a_table_of_it(table: SweepTable, tmp_path: Path) -> None:
    found = short(parameters=[{"sensor.seed": 2.0}, {"sensor.zero_drift": [-10.0, 0.0, 0.0], "sensor.seed": np.float64(1.0)}])
    assert found[KEPT[0]].tolist() == [table.rows[3][KEPT[0]], table.rows[0][KEPT[0]]]
    assert found["sensor.zero_drift"].dtype == object
    with found.to_csv(tmp_path / "table.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(r[KEPT[0]]) for r in rows] == found[KEPT[0]].tolist()
    assert json.loads(rows[1]["sensor.zero_drift"]) == [-10.0, 0.0, 0.0]
    with pytest.raises(KeyError, match="unknown column 'peak'"):
        found["peak"]
    pandas = pytest.importorskip("pandas")
    assert isinstance(table.to_pandas(), pandas.DataFrame)
    assert table.to_pandas()[KEPT[0]].tolist() == table[KEPT[0]].tolist()


def test_a_run_that_fails_is_a_row_with_its_error(table: SweepTable) -> None:
    nowhere = {"path.segments": "nowhere.npy"}
    found = short(parameters=[{"sensor.seed": 1.0, "sensor.zero_drift[1]": -10.0}, nowhere, {"sensor.seed": 2.0}])
    assert [bool(r["error"]) for r in found.rows] == [False, True, False]
    assert "nowhere.npy" in found.failed[0]["error"]
    assert math.isnan(found.rows[1][KEPT[0]])
    assert [found.rows[i][KEPT[0]] for i in (0, 2)] == [table.rows[i][KEPT[0]] for i in (0, 3)]


def test_what_is_finished_stays_and_only_the_rest_is_made(table: SweepTable, tmp_path: Path) -> None:
    def broken_after_two(what: str, done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        short(folder=tmp_path, progress=broken_after_two)
    rows = tmp_path / ROWS
    assert len(rows.read_text().splitlines()) == 2
    with rows.open("a") as stream:
        stream.write('[{"sensor.seed": 2.0}, {"pe')  # cut off by the end of the machine
    seen: list[int] = []
    assert short(folder=tmp_path, progress=lambda what, done, total: seen.append(done)).rows == table.rows
    assert seen == [2, 3, 4]
    more = {**GRID, "sensor.seed": [1.0, 2.0, 3.0]}
    assert short(parameters=more, folder=tmp_path, progress=lambda what, done, total: seen.append(done)).rows[:4] == table.rows
    assert seen[3:] == [4, 5, 6]
    assert (tmp_path / "table.csv").read_text().count("\n") == 7


def test_a_run_that_failed_is_made_again(tmp_path: Path) -> None:
    file = tmp_path / "segments.npy"
    asked = {"parameters": [{"path.segments": str(file)}], "folder": tmp_path / "sweep"}
    assert short(**asked).failed
    np.save(file, component("path_interpolator").default_tables["segments"])
    assert not short(**asked).failed


def test_a_folder_with_another_sweep_is_refused_unless_it_may_be_replaced(tmp_path: Path) -> None:
    one = {"sensor.seed": [1.0]}
    short(folder=tmp_path, parameters=one)
    with pytest.raises(SweepError, match=r"holds a sweep of another system, .* --overwrite"):
        short(folder=tmp_path, parameters=one, stop=2 * STOP)
    with pytest.raises(SweepError, match="another system"):
        sweep(replace(CELL, step=0.002), one, KEPT, tmp_path, stop=STOP, jobs=1)
    assert len(short(folder=tmp_path, parameters=one, summaries=KEPT[:1], overwrite=True)) == 1
    assert len((tmp_path / ROWS).read_text().splitlines()) == 1


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"parameters": []}, "no runs: give a grid"),
        ({"parameters": {"sensor.seed": 1.0}}, r"parameter 'sensor.seed': 1.0; expected a list of at least one value"),
        ({"parameters": {"sensor.seed": "1"}}, "expected a list of at least one value"),
        ({"parameters": {"seed": [1.0]}}, r"parameter 'seed': expected component.parameter, such as 'controller.mode'"),
        ({"parameters": {"variant": ["axis"]}}, "the parameter 'variant' goes with scenarios"),
        ({"parameters": {"sensor.sed": [1.0]}}, "component 'sensor': unknown parameter 'sed'; did you mean 'seed'"),
        ({"parameters": {"sensor.seed": ["1 mm"]}}, r"component 'sensor': parameter 'seed': .*mm"),
        ({"parameters": {"senser.seed": [1.0]}}, "senser"),
        ({"summaries": None}, "no summaries: say what is kept of a run of this system"),
        ({"summaries": []}, r"summaries \(none\)"),
        ({"summaries": ["peak(sensor.f_T)"]}, r"milling_cell: unknown signal 'sensor.f_T'; did you mean 'sensor.f_T_T'"),
        ({"summaries": [KEPT[0], KEPT[0]]}, "each column needs a name of its own"),
        ({"summaries": {"error": KEPT[0]}}, "each column needs a name of its own"),
        ({"summaries": {"own": lambda found: 1.0}, "jobs": 2}, r"summary 'own' cannot be sent to other processes .* or give jobs = 1"),
        ({"jobs": 0}, "jobs = 0: expected at least 1"),
    ],
)
def test_what_cannot_be_swept_is_refused_before_the_first_run(options: dict[str, object], text: str) -> None:
    with pytest.raises((ValueError, OrchestrationError), match=text):
        short(**options)


def test_a_system_without_end_and_scenarios_of_other_kinds_are_refused() -> None:
    with pytest.raises(SweepError, match="system 'milling_cell' has no end: give stop"):
        sweep(replace(CELL, stop_when=None), GRID, KEPT)
    with pytest.raises(SweepError, match="of kind 'static_loads' cannot be swept; expected kind 'milling', or a system file"):
        sweep(FILES / "scenarios" / "static_loads.toml", GRID)


@pytest.mark.slow
def test_variants_of_a_scenario_have_the_figures_of_their_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["sweep", str(SCENARIO), "--set", "milling.tool_wear=0,0.2", "--variant", "cartesian", "--jobs", "1", "--json"]
    figures = ["--summary", "peak_force_n", "--summary", "max_deviation_m", "--summary", "peak(sensor.f_T_T)"]
    assert main([*arguments, *figures, "--out", str(tmp_path / "sweep")]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [(r["variant"], r["milling.tool_wear"]) for r in rows] == [("cartesian", 0), ("cartesian", 0.2)]
    assert main(["run", str(SCENARIO), "--variant", "cartesian", "--out", str(tmp_path / "run"), "--no-pictures", "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)["variants"]["cartesian"]
    assert [rows[0][name] for name in ("peak_force_n", "max_deviation_m")] == [alone["peak_force_n"], alone["max_deviation_m"]]
    assert rows[0]["peak(sensor.f_T_T)"] == alone["peak_force_n"]
    assert rows[1]["peak_force_n"] > rows[0]["peak_force_n"]


@pytest.mark.parametrize(
    ("text", "name", "values"),
    [
        ("a.b=1,2.5", "a.b", [1, 2.5]),
        ("a.b = 20 urad, 0", "a.b", ["20 urad", 0]),
        ("a.b=[1, 2],[3, 4]", "a.b", [[1, 2], [3, 4]]),
        ("a.b=true,false", "a.b", [True, False]),
    ],
)
def test_values_on_the_command_line(text: str, name: str, values: list[object]) -> None:
    assert _values(text) == (name, values)


@pytest.mark.parametrize("text", ["a.b", "a.b=", "=1"])
def test_values_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"--set .*: expected NAME=V1,V2"):
        _values(text)


def test_the_table_on_the_screen_names_runs_that_failed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    system = str(FILES / "scenarios" / "milling_cell.toml")
    arguments = ["sweep", system, "--set", "sensor.seed=1,2", "--stop", "0.02", "--jobs", "1"]
    assert main([*arguments, "--summary", "max(sensor.f_T_T)", "--out", str(tmp_path / "a")]) == 0
    assert "2 runs: " in capsys.readouterr().out
    assert main([*arguments, "--set", "path.segments=nowhere.npy", "--summary", "max(sensor.f_T_T)", "--out", str(tmp_path / "b")]) == 1
    shown = capsys.readouterr().out
    assert "nowhere.npy" in shown
    assert "2 runs, 2 failed" in shown
