"""A measured input with another sign or unit stops the log; a right one does not, whatever the machine has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.gate.measured_inputs import Mistake, mistakes
from robomill.orchestration.runs.importing import write_run
from robomill.orchestration.runs.run import Run
from tests.diagnosis.axis import catalogue, resolve
from tests.diagnosis.experiment.test_driven import SYSTEM, recorded
from tests.tolerances import ROUNDOFF


def logged(folder: Path, change: Callable[[str, Any], Any], **how: float) -> Run:
    """A run of the axis with its motion logged otherwise."""
    run = recorded(folder, **how)
    columns = {name: change(name, x) for name, x in run.columns.items()}
    write_run(folder / "logged", run.t, columns, run.ports, run.info)
    return Run.load(folder / "logged")


def findings(folder: Path, change: Callable[[str, Any], Any]) -> tuple[str, list[tuple[str, str]]]:
    found = diagnose(SYSTEM, [logged(folder, change)], catalogue(folder), resolver=resolve).result
    return found["verdict"], [(f["channel"], f["text"].partition(":")[0]) for f in found["gate"]["findings"] if f["fatal"]]


@pytest.mark.parametrize(
    ("name", "factor", "said"),
    [
        ("program.a", -1.0, "has the wrong sign"),
        ("program.a", 1e3, "is 1000 times what it should be (milli- for units)"),
        ("program.a", 180.0 / np.pi, "is 57.3 times what it should be (degrees for radians)"),
    ],
)
def test_a_mistake_in_what_drives_the_system_stops_the_log(tmp_path: Path, name: str, factor: float, said: str) -> None:
    verdict, found = findings(tmp_path, lambda column, x: factor * x if column == name else x)
    assert (verdict, found) == ("bad_log", [(name, said)])


def test_effects_of_the_machine_are_no_mistake(tmp_path: Path) -> None:
    verdict, found = findings(tmp_path, lambda _, x: x)
    assert (verdict, found) == ("identified", [])


def test_an_input_that_is_a_tenth_too_large_has_no_mistake(tmp_path: Path) -> None:
    verdict, found = findings(tmp_path, lambda column, x: 1.1 * x if column == "program.a" else x)
    assert verdict != "bad_log"
    assert found == []


def possible(run: Run) -> list[Mistake]:
    """Mistakes that a run with a played program may have."""
    condition = type("Condition", (), {"system": SYSTEM.with_source("program", "measured:made up"), "runs": [run]})()
    laboratory: Any = type("Laboratory", (), {"conditions": [condition], "system": SYSTEM})()
    return mistakes(laboratory, 1)


def test_what_may_be_wrong_goes_with_the_unit_and_only_with_what_is_played(tmp_path: Path) -> None:
    run = logged(tmp_path, lambda _, x: x)
    warm = replace(run.ports["program.q"], unit="K")
    found = possible(replace(run, ports={**run.ports, "program.q": warm}))
    texts: dict[str, list[str]] = {}
    for m in found:
        texts.setdefault(m.finding.channel, []).append(m.finding.text)
    assert set(texts) == {"program.q", "program.v", "program.a"}
    assert any("273.15 K too small (degC)" in text for text in texts["program.q"])
    assert not any("273.15" in text for text in texts["program.v"])
    assert any("rpm for rad/s" in text for text in texts["program.v"])
    (celsius,) = (m for m in found if "too small (degC)" in m.finding.text)
    assert celsius.operator.true(np.array([[20.0]]))[0, 0] == pytest.approx(293.15, rel=ROUNDOFF)


def test_inputs_of_one_unit_may_be_interchanged(tmp_path: Path) -> None:
    run = logged(tmp_path, lambda _, x: x)
    assert not [m for m in possible(run) if m.finding.kind == "axes"]
    alike = replace(run.ports["program.v"], unit="rad")
    (swapped,) = (m for m in possible(replace(run, ports={**run.ports, "program.v": alike})) if m.finding.kind == "axes")
    assert swapped.columns == ("program.q", "program.v")
    assert "is interchanged with program.v: with that put right" in swapped.finding.text
    np.testing.assert_array_equal(swapped.operator.true(np.array([[1.0, 2.0]])), [[2.0, 1.0]])
