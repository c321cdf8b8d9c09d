"""The examples of the pages are read by the real readers, and real files have the keys that are described."""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path

import pytest

from reference.formats import EXAMPLES, FORMATS, MEASURED, Format
from reference.run_folder import RunKeys
from robomill.api import System, run
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.outcome.answer import Answer, to_json
from robomill.logs.importing import import_log
from robomill.measured_set import read_measured
from robomill.models.model.parameters import load
from robomill.models.planning.gcode import read
from robomill.models.process.cutting import CuttingCoefficients
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.entries import Entry
from tests import SCENARIOS

BESIDE = ("milling_cell.toml", "experiments/loaded_cell.toml", "irb6400/rate_cell.toml", "irb6400/learning_cell.toml", "rsi/ethernet.xml")
"""Files of scenarios/ that examples name as if they stood beside them."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The examples with all that they name."""
    made = tmp_path_factory.mktemp("examples") / "files"
    shutil.copytree(EXAMPLES, made)
    for name in BESIDE:
        shutil.copy(SCENARIOS / name, made)
    for name in ("air_1", "later_1"):
        run(System.load(made / "system.toml"), made / "runs" / name, stop=0.02)
    import_log(made / "mapping.toml", made / "log.csv", made / "runs" / "imported")
    return made


@pytest.mark.parametrize("described", FORMATS, ids=lambda f: f.name)
def test_an_example_is_read(folder: Path, described: Format) -> None:
    described.read(folder / described.example.name)


@pytest.mark.parametrize("described", FORMATS, ids=lambda f: f.name)
def test_a_reader_refuses_a_key_that_is_not_described(folder: Path, described: Format) -> None:
    other = folder / f"with_other_key_{described.name}.toml"
    other.write_text("no_such_key = 1\n" + (folder / described.example.name).read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(Exception, match="unknown key 'no_such_key'"):
        described.read(other)


def test_the_other_examples_are_read(folder: Path) -> None:
    assert load(CuttingCoefficients, folder / "material.toml").Kac == 222e6
    assert len(read_measured([folder / "measured_set.toml"], MEASURED["stiffness"]).values["force"]) == 2
    assert len(read(folder / "slot.ngc").actions) > 0


def test_runs_have_the_keys_that_are_described(folder: Path) -> None:
    tables = [RunKeys.of(Entry.load(folder / "runs" / name / "run.toml", ValueError)) for name in ("air_1", "imported")]
    for top in tables:
        for key in RunKeys.all().values():
            key.of(top)
    assert {k for top in tables for k in top.value} >= RunKeys.all().keys() - {"resumed", "source", "licence"}
    assert len(Run.load(folder / "runs" / "imported")) == 3


def test_a_diagnosis_has_the_keys_that_are_described() -> None:
    found = to_json(Answer("bad_log", (Finding("t", "time", 1.0, "s", "has a gap"),)))
    described = {f.name for f in fields(Answer)} - {"findings"}
    assert found.keys() <= described | {"schema", "gate"}
    assert found["gate"].keys() == {"usable", "findings"}
    assert found["gate"]["findings"][0].keys() == {f.name for f in fields(Finding)}
