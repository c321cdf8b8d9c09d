"""Runs as other tools take them: a table over time, a data set, CSV, a picture, a notebook."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from robomill.orchestration.errors import MissingPackageError, ResultsError
from robomill.orchestration.html import MOST_ROWS, table
from robomill.orchestration.runs.run import MOST_PANELS, Run
from robomill.orchestration.slaves.protocol import PortData

UNITS = {"arm.q": "rad", "arm.J": "m", "arm.on": None}


@pytest.fixture
def run() -> Run:
    """A vector, a matrix and a scalar without a unit."""
    names = [*(f"arm.q[{i}]" for i in (1, 2, 3)), *(f"arm.J[{i},{j}]" for i in (1, 2) for j in (1, 2)), "arm.on"]
    t = np.array([0.0, 0.1, 0.2, 0.3])
    columns = {name: k + t for k, name in enumerate(names)}
    ports = {n: PortData(n.partition(".")[2], "output", "real", unit=UNITS[n.partition("[")[0]], description="<of the arm>") for n in names}
    return Run(Path("results/arm"), t, columns, ports, {"outcome": "finished"})


def test_a_table_over_time_has_every_column_with_its_unit(run: Run) -> None:
    pytest.importorskip("pandas")
    frame = run.to_pandas()
    assert list(frame) == list(run.columns)
    assert (frame.index.name, frame.attrs["units"]["arm.q[2]"], frame.attrs["units"]["t"]) == ("t", "rad", "s")
    assert np.array_equal(frame["arm.J[2,1]"].to_numpy(), run.columns["arm.J[2,1]"])
    assert list(run.to_pandas("arm.on", "arm.q")) == ["arm.on", "arm.q[1]", "arm.q[2]", "arm.q[3]"]


def test_a_data_set_has_an_axis_for_each_index(run: Run) -> None:
    pytest.importorskip("xarray")
    data = run.to_xarray()
    assert {name: data[name].dims for name in data} == {"arm.q": ("t", "i3"), "arm.J": ("t", "i2", "j2"), "arm.on": ("t",)}
    assert np.array_equal(data["arm.J"].values[:, 1, 0], run.columns["arm.J[2,1]"])
    assert data["arm.q"].attrs == {"units": "rad", "description": "<of the arm>"}
    assert list(run.to_xarray("arm.q[2]")) == ["arm.q[2]"]


def test_a_csv_file_has_all_digits_and_is_not_replaced(run: Run, tmp_path: Path) -> None:
    file = run.to_csv(tmp_path / "arm.csv", "arm.q")
    assert file.read_text().splitlines()[0] == '"t","arm.q[1]","arm.q[2]","arm.q[3]"'
    assert np.array_equal(np.loadtxt(file, delimiter=",", skiprows=1)[:, 3], run.columns["arm.q[3]"])
    with pytest.raises(ResultsError, match=r"arm\.csv is there already; .*overwrite = True"):
        run.to_csv(file)
    run.to_csv(file, "arm.on", overwrite=True)
    assert file.read_text().startswith('"t","arm.on"\n')


def test_a_picture_has_a_panel_for_each_array_that_is_named(run: Run) -> None:
    figure = run.plot("arm.J", "arm.on")
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["arm.J", "arm.on"]
    assert [ax.get_ylabel() for ax in figure.axes] == ["m", "1"]
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ["[1,1]", "[1,2]", "[2,1]", "[2,2]"]
    widths = [line.get_linewidth() for line in figure.axes[0].lines]
    assert widths == sorted(widths, reverse=True)  # a line that lies below another is still seen
    assert run.plot()._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_a_picture_of_everything_is_of_what_changes_and_says_how_much_is_left_out(run: Run) -> None:
    many = {f"arm.x{i}": (run.t if i % 2 else 0.0 * run.t) for i in range(3 * MOST_PANELS)}
    ports = {n: PortData(n.partition(".")[2], "output", "real") for n in many}
    figure = Run(run.folder, run.t, many, ports, {}).plot()
    assert [ax.get_title(loc="left") for ax in figure.axes] == [f"arm.x{i}" for i in range(1, 2 * MOST_PANELS, 2)]
    assert figure.get_suptitle() == f"arm: {MOST_PANELS} of {3 * MOST_PANELS} arrays; plot(name, ...) draws others"


def test_a_notebook_shows_the_arrays_with_range_and_unit(run: Run) -> None:
    page = run._repr_html_()
    assert "Run arm: finished, 4 rows, to t = 0.3 s" in page
    assert "<td style='text-align:left'>arm.q</td><td style='text-align:left'>3</td><td style='text-align:left'>rad</td>" in page
    assert "&lt;of the arm&gt;" in page
    assert "2 x 2" in page


def test_a_long_table_is_cut_and_says_so() -> None:
    assert "<td colspan='1'>and 2 more</td>" in table("many", ["name"], [[i] for i in range(MOST_ROWS + 2)])
    assert "more" not in table("many", ["name"], [[i] for i in range(MOST_ROWS)])


@pytest.mark.parametrize("method", ["to_pandas", "to_xarray", "to_csv", "plot"])
def test_an_unknown_name_is_refused_with_what_comes_close(run: Run, method: str, tmp_path: Path) -> None:
    arguments = [tmp_path / "x.csv"] if method == "to_csv" else []
    with pytest.raises(KeyError, match=r"unknown column 'arm\.k'; did you mean .*'arm\.q'.* available: arm\.q, arm\.J, arm\.on"):
        getattr(run, method)(*arguments, "arm.k")


@pytest.mark.parametrize(("method", "package"), [("to_pandas", "pandas"), ("to_xarray", "xarray")])
def test_a_missing_package_is_named_with_the_command_that_installs_it(
    run: Run, method: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingPackageError, match=rf"Run\.{method} needs the package '{package}'.*pip install robomill\[{package}\]"):
        getattr(run, method)()
