"""FMUs in packages carry the tables of the run: what stands in `resources/tables` is what an empty text means, or an error."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from robomill.conformance import check_fmu
from robomill.fmus.interface import Interface
from robomill.fmus.python.builder import _npy
from robomill.orchestration.errors import SlaveError
from robomill.orchestration.slaves.fmu import FmuSlave
from robomill.orchestration.ssp.tables import carrying
from tests.fmus.demo import MODEL

OUTPUTS = Interface(MODEL).outputs
needs_linux = pytest.mark.skipif(sys.platform != "linux", reason="runs the linux64 library")


def curve_value(file: Path, parameters: dict[str, Any]) -> float:
    """The output that shows the first value of the table, read twice: a reset, too, puts the carried rows back."""
    slave = FmuSlave(file, "spring 1")
    try:
        slave.configure(parameters)
        out = np.zeros((2, len(OUTPUTS)))
        for row in out:
            slave.initialise(0.0, 1.0, 0.004)
            slave.get_outputs(row)
        assert out[0].tobytes() == out[1].tobytes()
        return float(out[0][[p.name for p in OUTPUTS].index("curve_value")])
    finally:
        slave.close()


@pytest.fixture(params=["python", pytest.param(2, marks=needs_linux), pytest.param(3, marks=needs_linux)])
def fmu(request: pytest.FixtureRequest, built: Callable[[str], Path], built_native: Callable[..., Path]) -> Path:
    return built("demo") if request.param == "python" else built_native("demo", request.param)


def carried(fmu: Path, folder: Path, rows: Any) -> Path:
    made = folder / "carrying.fmu"
    made.write_bytes(carrying(fmu.read_bytes(), {"curve": _npy(np.array(rows))}))
    return made


def test_what_is_carried_is_used_unless_another_file_is_named(fmu: Path, tmp_path: Path) -> None:
    made = carried(fmu, tmp_path, [[0.0, 42.5], [1.0, 2.0], [2.0, 3.0]])
    assert curve_value(fmu, {}) == 7.0
    assert curve_value(made, {}) == curve_value(made, {"curve": ""}) == 42.5
    np.save(tmp_path / "other.npy", np.array([[0.0, -1.5]]))
    assert curve_value(made, {"curve": str(tmp_path / "other.npy")}) == -1.5


def test_a_folder_of_any_name(fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The place reaches FMI 2.0 as a URI with escapes."""
    strange = tmp_path / ("ä ö #1" if fmu.parent.name.startswith("fmus") else "ä 100%20 #1 ö")  # pythonfmu takes %20 for a blank
    strange.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(strange))
    assert curve_value(carried(fmu, tmp_path, [[0.0, 42.5]]), {}) == 42.5


def test_a_folder_that_the_library_of_pythonfmu_would_not_find(
    built: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would crash the process."""
    strange = tmp_path / "100%20"
    strange.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(strange))
    with pytest.raises(SlaveError, match=r"the library of pythonfmu takes %20 in a name for a blank: set TMPDIR to another folder"):
        curve_value(built("demo"), {})


def test_the_battery_in_a_folder_of_any_name(built: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    strange = tmp_path / "ä ö"
    strange.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(strange))
    assert [r for r in check_fmu(built("demo")) if not r.passed] == []


def test_it_has_another_name_and_the_same_tables_give_the_same_bytes(fmu: Path, tmp_path: Path) -> None:
    first, again = (carried(fmu, tmp_path, [[0.0, 1.0]]).read_bytes() for _ in range(2))
    assert first == again
    guids = [fmpy.read_model_description(str(f)).guid for f in (fmu, tmp_path / "carrying.fmu")]
    assert guids[1] == guids[0] + "+curve"


@needs_linux
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_table_that_is_not_there_or_does_not_fit_is_no_built_in_one(fmi: int, built_native: Callable[..., Path], tmp_path: Path) -> None:
    """The library knows by its GUID that there is one: without, the built-in rows would run and nobody be told."""
    file = carried(built_native("demo", fmi), tmp_path, [[0.0, 1.0]])
    slave = FmuSlave(file, "spring 1")
    table = slave.description.folder / "resources/tables/curve.npy"
    table.unlink()
    with pytest.raises(SlaveError, match=re.escape(f"spring 1: table curve from '{table}': the file does not exist or cannot be read")):
        slave.initialise(0.0, 1.0, 0.004)
    slave.close()
    with pytest.raises(SlaveError, match=r"tables/curve.npy': has shape \(1, 3\), expected rows of 2 columns"):
        curve_value(carried(built_native("demo", fmi), tmp_path, [[0.0, 1.0, 2.0]]), {})


def test_a_python_fmu_whose_table_is_lost_does_not_run_another(built: Callable[[str], Path], tmp_path: Path) -> None:
    slave = FmuSlave(carried(built("demo"), tmp_path, [[0.0, 1.0]]), "spring 1")
    table = slave.description.folder / "resources/tables/curve.npy"
    table.unlink()
    with pytest.raises(SlaveError, match=re.escape(f"spring 1: table curve: [Errno 2] No such file or directory: '{table}'")):
        slave.initialise(0.0, 1.0, 0.004)
    slave.close()


def test_a_python_fmu_refuses_a_table_that_does_not_fit(built: Callable[[str], Path], tmp_path: Path) -> None:
    with pytest.raises(SlaveError, match="spring 1: table curve: "):
        curve_value(carried(built("demo"), tmp_path, [[0.0, 1.0, 2.0]]), {})
