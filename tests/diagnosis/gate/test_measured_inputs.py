"""A measured input with another sign or unit stops the log; a right one does not, whatever the machine has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.gate.measured_inputs import Mistake, _without, mistakes
from robomill.orchestration.runs.importing import write_run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.definition import Component, Connection, System
from tests.diagnosis.axis import catalogue, resolve, system
from tests.diagnosis.demo import Part, real
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
    laboratory: Any = type("Laboratory", (), {"conditions": [condition], "system": SYSTEM, "channels": ["drive.torque", "drive.angle"]})()
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


def test_inputs_may_be_interchanged_with_each_other_and_with_outputs(tmp_path: Path) -> None:
    found = [m for m in possible(logged(tmp_path, lambda _, x: x)) if m.finding.kind == "axes"]
    q, v, a, torque, angle = "program.q", "program.v", "program.a", "drive.torque", "drive.angle"
    assert {m.columns for m in found} == {(q, v), (q, a), (v, a), *((x, y) for x in (q, v, a) for y in (torque, angle))}
    swapped = found[0]
    assert "is interchanged with program.v: with that put right" in swapped.finding.text
    np.testing.assert_array_equal(swapped.operator.true(np.array([[1.0, 2.0]])), [[2.0, 1.0]])


class Box(Part):
    """Air that a switched heater of 40 W warms, and that loses 1 W/K to a room; 100 J/K."""

    def __init__(self, name: str) -> None:
        inputs = [real("heater", "input", "1"), real("room", "input", "K")]
        parameters = [real("start", "parameter", "K", 293.15), real("more_loss", "parameter", "W/K")]
        super().__init__(name, [*inputs, *parameters, real("air", "output", "K", dependencies=())])
        self.air: float | None = None

    def advance(self, t: float, h: float) -> None:
        heater, room = self.u
        self.air = self.p["start"] if self.air is None else self.air
        self.air += h * (40.0 * heater - (1.0 + self.p["more_loss"]) * (self.air - room)) / 100.0
        self.y[0] = self.air


WARM = System(
    "box",
    1.0,
    (Component("lab", "measured"), Component("box", "box")),
    (Connection("lab.heater", "box.heater"), Connection("lab.room", "box.room")),
)
LOSS = """
[[effect]]
name = "loss"
component = "box"
description = "loss through the lid"
source = "made up"
unit = "W/K"
minimum = 0.01
maximum = 5.0
sign = "both"
prior = {kind = "normal", scale = 0.2}
locations = [{name = "box", parameters = ["more_loss"]}]
"""


@pytest.mark.parametrize(
    ("mistaken", "name", "said"),
    [
        ({"lab.room": "box.air", "box.air": "lab.room"}, "lab.room", "is interchanged with box.air"),
        ({"lab.heater": 1.0}, "lab.heater", "is inverted (0 for 1, 1 for 0)"),
        ({"lab.room": 273.15, "box.air": 273.15}, "lab.room", "is 273.15 K too small (degC), as all signals in K are"),
    ],
)
def test_a_mistake_may_be_of_inputs_and_outputs_together(tmp_path: Path, mistaken: dict[str, Any], name: str, said: str) -> None:
    t = np.arange(600.0)
    columns = {"lab.heater": np.where(np.sin(0.02 * t) + np.sin(0.053 * t) > 0.0, 1.0, 0.0), "lab.room": 294.0 + 2.0 * np.sin(0.01 * t)}
    made = Box("box")
    air = []
    for heater, room in zip(*columns.values(), strict=True):
        made.u[:] = heater, room
        made.advance(0.0, 1.0)
        air.append(made.y[0])
    columns["box.air"] = np.array(air) + np.random.default_rng(1).normal(0.0, 0.05, len(t))
    logged = dict(columns)
    for column, how in mistaken.items():
        logged[column] = columns[how] if isinstance(how, str) else how - columns[column] if how == 1.0 else columns[column] - how
    ports = {c: PortData(c.partition(".")[2], "output", unit="1" if c == "lab.heater" else "K") for c in columns}
    (tmp_path / "loss.toml").write_text(LOSS)
    verdicts = []
    for folder, values in (("good", columns), ("bad", logged)):
        write_run(tmp_path / folder, t, values, ports, {"labels": {"condition": folder}})
        run = Run.load(tmp_path / folder)
        verdicts.append(diagnose(WARM, [run], Catalogue.load(tmp_path / "loss.toml"), resolver=lambda _, name: Box(name)).result)
    good, bad = verdicts
    assert good["verdict"] == "none"
    assert [(f["channel"], f["text"].partition(":")[0]) for f in bad["gate"]["findings"] if f["fatal"]] == [(name, said)]


def test_a_condition_that_plays_nothing_stays_as_it_is(tmp_path: Path) -> None:
    """In a campaign another condition may have the same columns, and several repeats."""
    run = logged(tmp_path, lambda _, x: x)
    played = next(m for m in possible(run) if m.finding.kind == "sign")
    condition = type("Condition", (), {"system": system(), "runs": [run, run]})()
    laboratory: Any = type("Laboratory", (), {"conditions": [condition], "system": system()})()
    assert set(played.columns) <= set(run.columns)
    assert _without(laboratory, 0, played) is laboratory
