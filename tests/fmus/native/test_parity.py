"""Native FMU = model in this process, bit by bit, for every component, in several variants, in FMI 2.0 and 3.0."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from robomill.fmus.components import NAMES
from robomill.fmus.in_process import InProcessSlave
from robomill.fmus.interface import Interface
from robomill.orchestration.slaves.fmu import FmuSlave
from tests.fmus import native_runs as runs

pytestmark = pytest.mark.skipif(not runs.ON_LINUX, reason="runs the linux64 library")
ALL = ("demo", *NAMES)


@pytest.mark.parametrize("variant", runs.VARIANTS)
@pytest.mark.parametrize("name", ALL)
def test_fmi2_gives_the_numbers_of_the_model_bit_by_bit(name: str, variant: str, built_native: Callable[..., Path]) -> None:
    model = runs.model(name)
    interface = Interface(model)
    rows, values = runs.inputs(name, interface), runs.parameters(name, variant, model)
    expected = runs.drive(InProcessSlave(model), len(interface.outputs), rows, values)
    file = built_native(name)
    found = runs.drive(FmuSlave(file, name), len(interface.outputs), rows, values)
    assert not runs.difference(file, interface.outputs, expected, found)
    assert np.ptp(found, axis=0).any(), "nothing moved: the comparison shows nothing"


@pytest.mark.parametrize("variant", runs.VARIANTS)
@pytest.mark.parametrize("name", ALL)
def test_fmi3_gives_the_numbers_of_the_model_bit_by_bit(name: str, variant: str, built_native: Callable[..., Path]) -> None:
    model = runs.model(name)
    interface = Interface(model)
    rows, values = runs.inputs(name, interface), runs.parameters(name, variant, model)
    expected = runs.drive(InProcessSlave(model), len(interface.outputs), rows, values)
    file = built_native(name, 3)
    slave = FmuSlave(file, name)
    assert [(p.name, p.causality, p.type, p.unit, p.start) for p in slave.ports] == [
        (p.name, p.causality, p.type, p.unit, p.start if p.initial != "calculated" else None) for p in interface.ports
    ]
    found = runs.drive(slave, len(interface.outputs), rows, values)
    assert not runs.difference(file, interface.outputs, expected, found)


@pytest.mark.parametrize("name", ALL)
def test_fmi3_through_fmpy(name: str, built_native: Callable[..., Path], tmp_path: Path) -> None:
    """An FMI 3.0 FMU in an importer of others has the bits of the model, array by array."""
    model = runs.model(name)
    interface = Interface(model)
    rows, values = runs.inputs(name, interface), runs.parameters(name, "golden", model)
    expected = runs.drive(InProcessSlave(model), len(interface.outputs), rows, values)
    file = built_native(name, 3)
    found = runs.drive(runs.Fmi3Slave(file, tmp_path, interface), len(interface.outputs), rows, values)
    assert not runs.difference(file, interface.outputs, expected, found)


@pytest.mark.parametrize("name", ALL)
def test_effects_change_the_numbers(name: str, built_native: Callable[..., Path]) -> None:
    """The variant `effects` would be worth nothing if the FMU ignored them."""
    model = runs.model(name)
    interface = Interface(model)
    rows = runs.inputs(name, interface)
    found = [
        runs.drive(FmuSlave(built_native(name), name), len(interface.outputs), rows, runs.parameters(name, variant, model))
        for variant in ("golden", "effects")
    ]
    has_effects = any(v.effect for v in model.variables)
    assert (found[0] != found[1]).any() == has_effects


@pytest.mark.parametrize("name", ALL)
def test_going_back_to_a_state_repeats_the_steps_bit_by_bit(name: str, built_native: Callable[..., Path]) -> None:
    model = runs.model(name)
    interface = Interface(model)
    rows, values = runs.inputs(name, interface), runs.parameters(name, "golden", model)
    slave = FmuSlave(built_native(name), name)
    try:
        slave.configure(values)
        slave.initialise(0.0, 10.0, runs.H)
        out = np.zeros((2, 20, len(interface.outputs)))
        for k in range(40):
            slave.set_inputs(rows[k])
            slave.step(k * runs.H, runs.H)
        saved = slave.get_state()
        for attempt in range(2):
            for i in range(20):
                slave.set_inputs(rows[40 + i])
                slave.step((40 + i) * runs.H, runs.H)
                slave.get_outputs(out[attempt, i])
            slave.set_state(saved)
    finally:
        slave.close()
    assert not runs.difference(built_native(name), interface.outputs, out[0], out[1])


def test_a_difference_is_reported_with_variable_step_and_file() -> None:
    ports = Interface(runs.model("demo")).outputs
    expected = np.zeros((4, len(ports)))
    found = expected.copy()
    found[2:, 1] = 1e-300
    assert runs.difference(Path("demo.fmu"), ports, expected, found) == (
        "demo.fmu: force[2] differs first in step 2: np.float64(0.0) in process, np.float64(1e-300) in the FMU"
    )
