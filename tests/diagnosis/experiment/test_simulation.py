"""Simulations of the conditions: each with its own system and parameters, the same bits in whatever order and process."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.diagnosis.candidates import LOGGING
from robomill.diagnosis.catalogue import Refinement
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import FINER, Laboratory, Setting, Simulator, refined, setting
from robomill.files import FILES
from robomill.orchestration.assembly import run
from tests.tolerances import ROUNDOFF

CELL = load_system(FILES / "scenarios" / "milling_cell.toml")
STIFF = CELL.with_parameters("compliance", {"stiffness_error[2]": 0.1})
CHANNELS = ("compliance.d_T_B[1]", "drive.torque_motor[2]", "sensor.f_T_T[3]")
SETTINGS = (
    (),
    setting({("drive", "tracking_lag"): 0.02, ("compliance", "stiffness_error[2]"): -0.1}),
    setting({("milling", "tool_wear"): 0.4, ("sensor", "seed"): 2.0}),
    setting({("drive", "backlash[1]"): 1e9}),
)
"""The last one cannot run."""


def condition(name: str, steps: int, parameters: Mapping[str, Mapping[str, Any]], **more: Any) -> Condition:
    return Condition(name, parameters, (), CELL.step * np.arange(steps), **more)


@pytest.fixture
def laboratory() -> Laboratory:
    conditions = [
        condition("a", 40, {}),
        condition("b", 30, {"drive": {"tracking_lag": 0.01}}, nominal={("drive", "tracking_lag"): 0.01}),
        condition("c", 40, {}, system=STIFF, channels=frozenset(CHANNELS[:2])),
    ]
    return Laboratory(CELL, conditions, CHANNELS, resolve, convert)


def anew(laboratory: Laboratory, index: int, changes: Setting) -> npt.NDArray[np.float64]:
    """The channels from a system that is opened for this simulation alone."""
    c = laboratory.conditions[index]
    cell = laboratory.configured(index)
    for (component, parameter), value in changes:
        nominal = (c.nominal or {}).get((component, parameter), 0.0)
        cell = cell.with_parameters(component, {parameter: value + nominal})
    found = run(cell, None, stop=float(c.grid[-1]), resolver=resolve, convert=convert)
    columns = [np.interp(c.grid, found.t, found.columns[name]) if c.has(name) else np.zeros(len(c.grid)) for name in CHANNELS]
    return np.stack(columns, axis=1)


def test_simulations_in_any_order_are_those_of_systems_that_are_opened_anew(laboratory: Laboratory) -> None:
    expected = {(i, s): anew(laboratory, i, s) for i in range(3) for s in SETTINGS[:-1]}
    for s in (*SETTINGS, *reversed(SETTINGS)):
        for i in range(3):
            found = laboratory.simulate(i, s)
            assert (found is None) == (s == SETTINGS[-1])
            assert found is None or found.tobytes() == expected[i, s].tobytes()
    shown = [expected[i, ()].tobytes() for i in range(3)]
    assert len(set(shown)) == 3, "each condition has a system or parameters of its own"


def test_what_differs_by_faults_of_the_log_alone_is_simulated_once(laboratory: Laboratory, monkeypatch: pytest.MonkeyPatch) -> None:
    faults = [setting({(LOGGING, "lag drive.*"): late}) for late in (0.01, -0.02, 0.03)]
    tasks = [(i, fault) for fault in faults for i in (0, 1)]
    expected = [laboratory.simulate(*t) for t in tasks]
    made, simulate = [], laboratory._simulate

    def counted(index: int, changes: Setting) -> npt.NDArray[np.float64] | None:
        made.append(index)
        return simulate(index, changes)

    laboratory._logged = None
    monkeypatch.setattr(laboratory, "_simulate", counted)
    with Simulator(laboratory) as simulator:
        found = simulator.many(tasks)
    assert made == [0, 1]
    for one, other in zip(found, expected, strict=True):
        assert one is not None
        assert other is not None
        assert one.tobytes() == other.tobytes()


def test_a_condition_that_is_replaced_gets_a_system_of_its_own(laboratory: Laboratory) -> None:
    before = laboratory.simulate(0, ())
    first, *others = laboratory.conditions
    laboratory.conditions = [replace(first, parameters={"drive": {"tracking_lag": 0.03}}), *others]
    after = laboratory.simulate(0, ())
    assert before is not None
    assert after is not None
    assert before.tobytes() != after.tobytes()
    assert after.tobytes() == anew(laboratory, 0, ()).tobytes()


def test_a_finer_step_is_that_of_the_catalogue_beside_any_other_change(laboratory: Laboratory) -> None:
    fine, c = Refinement(2, ("drive", "sensor", "controller")), laboratory.conditions[1]
    other = SETTINGS[1]
    assert laboratory.effective(1, setting({FINER: 1.0})) == (), "no refinement, no finer step"
    laboratory.refinement = fine
    for changes in (), other, ():
        system = refined(laboratory.configured(1), fine.divide, fine.sampled)
        for (component, parameter), value in changes:
            nominal = (c.nominal or {}).get((component, parameter), 0.0)
            system = system.with_parameters(component, {parameter: value + nominal})
        result = run(system, None, stop=float(c.grid[-1]), resolver=resolve, convert=convert)
        assert result.t[1] == pytest.approx(0.5 * CELL.step, rel=ROUNDOFF)
        expected = np.stack([np.interp(c.grid, result.t, result.columns[name]) for name in CHANNELS], axis=1)
        found, usual = (laboratory.simulate(1, setting({**dict(changes), FINER: on})) for on in (1.0, 0.0))
        assert found is not None
        assert usual is not None
        assert found.tobytes() == expected.tobytes() != usual.tobytes()


def test_another_process_opens_systems_of_its_own(laboratory: Laboratory) -> None:
    here = laboratory.simulate(1, SETTINGS[1])
    sent = pickle.loads(pickle.dumps(replace(laboratory, resolver=resolve)))
    there = sent.simulate(1, SETTINGS[1])
    assert here is not None
    assert there.tobytes() == here.tobytes()
    narrow = replace(laboratory, channels=CHANNELS[:1])  # what it has opened is not that of other channels
    assert narrow.simulate(1, SETTINGS[1]).tobytes() == np.ascontiguousarray(here[:, :1]).tobytes()
