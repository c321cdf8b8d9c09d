"""A system that is opened once and run many times: the same bits as one that is opened anew for each run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.files import FILES
from robomill.orchestration.assembly import run
from robomill.orchestration.errors import OrchestrationError, RunError, SystemFileError
from robomill.orchestration.loop.acceleration import Iteration
from robomill.orchestration.rig import Rig
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.playback import Playback
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.written import Written
from tests.orchestration.mocks import Mock, gain, resolver, source, system

CELL = load_system(FILES / "scenarios" / "milling_cell.toml")
STOP = 0.2
"""End of the short runs [s]."""


def anew(cell: System, changes: Mapping[str, Mapping[str, Any]], stop: float = STOP) -> Run:
    for component, values in changes.items():
        cell = cell.with_parameters(component, values)
    return run(cell, None, stop=stop, resolver=resolve, convert=convert)


def bits(found: Run) -> dict[str, bytes]:
    return {"t": found.t.tobytes(), **{name: column.tobytes() for name, column in found.columns.items()}}


def numbers() -> list[tuple[str, str, float]]:
    """A real parameter of each array of every component of the cell, and another value for it."""
    found = {}
    for c in CELL.components:
        for p in resolve(c.source, c.name).ports:
            if p.causality == "parameter" and p.type == "real":
                value = c.parameters.get(p.name, p.start)
                value = 1.01 * (value if isinstance(value, float) else float(p.start)) or 1e-3
                low, high = (-np.inf if p.minimum is None else p.minimum), (np.inf if p.maximum is None else p.maximum)
                found.setdefault((c.name, p.name.partition("[")[0]), (c.name, p.name, float(np.clip(value, low, high))))
    return list(found.values())


def outcome(of: Any, *arguments: Any) -> Any:
    """The bits of a run, or what it says when it fails."""
    try:
        return bits(of(*arguments))
    except OrchestrationError as error:
        return str(error)


@pytest.mark.slow
def test_every_parameter_of_every_component_has_the_same_effect_as_in_a_system_that_is_opened_anew() -> None:
    rig, nominal, different, failed = Rig(CELL, resolve, convert), outcome(anew, CELL, {}), 0, 0
    for component, parameter, value in numbers():
        changes = {component: {parameter: value}}
        expected = outcome(anew, CELL, changes)
        assert outcome(rig.run, changes, STOP) == expected, (component, parameter)
        different += expected != nominal
        failed += isinstance(expected, str)
    assert different > len(numbers()) // 4, "most of the changes must change something"
    assert failed > 0, "some of them must fail, and spoil no later run"
    assert outcome(rig.run, {}, STOP) == nominal


def test_seeds_and_several_components_at_once_and_what_the_run_tells_of_its_parameters() -> None:
    changes = {"sensor": {"seed": 3.0}, "drive": {"backlash[2]": 1e-4, "tracking_lag": 0.01}, "milling": {"tool_wear": 0.5}}
    rig = Rig(CELL, resolve, convert)
    found, expected = rig.run(changes, STOP), anew(CELL, changes)
    assert bits(found) == bits(expected)
    assert found.info == expected.info
    assert rig.run({}, STOP).info == anew(CELL, {}).info


def test_a_run_that_fails_spoils_no_later_one() -> None:
    rig = Rig(CELL, resolve, convert)
    expected = bits(anew(CELL, {}))
    with pytest.raises(SystemFileError, match=r"component 'drive': parameter 'backlash\[1\]'.*above its maximum"):
        rig.run({"drive": {"backlash[1]": 1e9}}, STOP)
    with pytest.raises(SystemFileError, match="unknown parameter 'backlas'"):
        rig.run({"milling": {"tool_wear": 0.5}, "drive": {"backlas": 0.0}}, STOP)
    assert bits(rig.run({}, STOP)) == expected
    with pytest.raises(RunError, match="component 'drive'"):
        rig.run({"drive": {"q_max[2]": -3.0}}, STOP)
    assert bits(rig.run({}, STOP)) == expected


def test_another_length_other_columns_and_a_longer_run_after_a_shorter_one() -> None:
    kept = ["milling.f_T_B[1]", "compliance.p_BT_B[3]", "no.such"]
    rig = Rig(CELL, resolve, convert, kept)
    for stop in (0.05, 6.0, 0.1):
        found, expected = rig.run({}, stop), anew(CELL, {}, stop)
        assert list(found.columns) == [name for name in expected.columns if name in kept]
        assert bits(found) == {name: column for name, column in bits(expected).items() if name in ("t", *kept)}
        assert list(found.ports) == list(found.columns)


def test_values_that_a_person_wrote_need_their_unit_here_too() -> None:
    rig = Rig(CELL, resolve, convert)
    written = {"drive": Written({"tracking_lag": "10 ms"}, {("tracking_lag",): "cell.toml:3"})}
    assert bits(rig.run(written, STOP)) == bits(anew(CELL, written))
    with pytest.raises(SystemFileError, match=r"cell\.toml:3"):
        rig.run({"drive": Written({"tracking_lag": 0.01}, {("tracking_lag",): "cell.toml:3"})}, STOP)


def test_components_that_step_at_another_rate_and_an_iterated_loop() -> None:
    components = tuple(replace(c, every=2) if c.name == "controller" else c for c in CELL.components)
    changes = {"compliance": {"tool_compliance": 1e-7}}
    for cell in (
        replace(CELL, components=components),
        replace(CELL, algorithm="jacobi"),
        replace(CELL, algorithm="iterated", iteration=Iteration(max_iterations=50, unconverged="accept")),
    ):
        rig = Rig(cell, resolve, convert)
        for some in (changes, {}, changes):
            assert outcome(rig.run, some, 0.1) == outcome(anew, cell, some, 0.1)


def test_a_component_that_cannot_go_back_is_opened_for_each_run() -> None:
    opened: list[str] = []

    def open_anew(of: str, name: str) -> Mock:
        opened.append(name)
        return gain(name, 2.0) if name == "b" else source(name, lambda t: t)

    parts = [source("a", float), gain("b")]
    rig = Rig(system(parts, "a.y -> b.u"), open_anew)
    first = bits(rig.run({}, STOP))
    assert bits(rig.run({}, STOP)) == first
    assert opened == ["a", "b"] * 3  # once to see that they cannot
    with pytest.raises(SystemFileError, match="unknown parameter 'x'"):
        rig.run({"b": {"x": 1.0}}, STOP)


def test_a_recording_is_played_back_from_its_beginning() -> None:
    t = np.linspace(0.0, 1.0, 11)
    played = Playback.of_series("p", [PortData("y", "output")], {"y": t**2}, t, adds=True)
    rig = Rig(system([played]), resolver([played]))
    first = bits(rig.run({}, 0.8))
    assert bits(rig.run({}, 0.3)).keys() == first.keys()
    assert bits(rig.run({}, 0.8)) == first


def test_other_series_are_played_as_if_they_had_been_there_from_the_start() -> None:
    t = np.linspace(0.0, 1.0, 11)
    ports = [PortData("y", "output"), PortData("n", "output", "integer")]

    def played(power: int) -> dict[str, np.ndarray]:
        return {"y": t**power, "n": np.arange(11.0) * power}

    changed, other = (Playback.of_series("p", ports, played(power), t) for power in (2, 3))
    rig = Rig(system([changed]), resolver([changed]))
    before = bits(rig.run({}, 0.8))
    changed.play(played(3))
    found, expected = rig.run({}, 0.8), Rig(system([other]), resolver([other])).run({}, 0.8)
    assert bits(found) == bits(expected) != before
