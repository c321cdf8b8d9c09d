"""Errors of native FMUs: what the C code says, and that it says what the model in this process says."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fmpy.fmi3
import numpy as np
import pytest

from robomill.fmus.components import COMPONENTS
from robomill.fmus.in_process import InProcessSlave
from robomill.fmus.instance import ComponentError
from robomill.fmus.interface import Interface
from robomill.orchestration.errors import SlaveError
from robomill.orchestration.slaves.fmu import FmuSlave
from tests.fmus import native_runs as runs
from tests.fmus.demo import MODEL

pytestmark = pytest.mark.skipif(not runs.ON_LINUX, reason="runs the linux64 library")
INTERFACE = Interface(MODEL)
CALM = np.array([0.1, -0.1, 1.0, 0.0, 3.0])


@pytest.fixture
def fmu(built_native: Callable[..., Path]) -> Iterator[FmuSlave]:
    slave = FmuSlave(built_native("demo"), "spring 1")
    yield slave
    slave.close()


@pytest.fixture
def three(built_native: Callable[..., Path], tmp_path: Path) -> Iterator[runs.Fmi3Slave]:
    slave = runs.Fmi3Slave(built_native("demo", 3), tmp_path, INTERFACE)
    yield slave
    slave.close()


def both(fmu: FmuSlave, parameters: dict[str, Any], inputs: Any = CALM, t: float = 0.0, h: float = runs.H) -> tuple[str, str]:
    """Texts of the error of a step: in this process, and what the FMU logs."""
    here, there = InProcessSlave(MODEL, fmu.name), fmu
    with pytest.raises(ComponentError) as in_process:
        one_step(here, parameters, inputs, t, h)
    with pytest.raises(SlaveError) as in_fmu:
        one_step(there, parameters, inputs, t, h)
    return str(in_process.value), str(in_fmu.value)


def one_step(slave: runs.Slave, parameters: dict[str, Any], inputs: Any, t: float, h: float) -> None:
    """All that can go wrong."""
    slave.configure(parameters)
    slave.initialise(0.0, 1.0, runs.H)
    slave.set_inputs(np.array(inputs))
    slave.step(t, h)


@pytest.mark.parametrize(
    ("parameters", "inputs", "t", "h", "expected"),
    [
        ({"stiffness[1,1]": 13.0}, CALM, 0.0, 0.004, "spring 1 (demo): stiffness[1] = 13.0 N/m brings bad luck (during initialisation)"),
        ({}, [1.25, 0, 1, 0, 3], 0.1, 0.004, "x[1] = 1.25 m is too far at t = 0.1 s; at most 1 m (step from t = 0.1 s, h = 0.004 s)"),
        ({}, [1 + 2**-52, 0, 1, 0, 3], 1e-7, 0.004, "x[1] = 1.0000000000000002 m is too far at t = 1e-07 s; at most 1 m"),
        ({}, [-1e16, 0, 1, 0, 3], 123456.0, 0.004, "x[1] = -1e+16 m is too far at t = 123456.0 s; at most 1 m"),
        ({}, [-123456789.0, 0, 1, 0, 3], 0.0, 0.004, "x[1] = -123456789.0 m is too far at t = 0.0 s; at most 1 m"),
        ({}, CALM, 0.0, 0.0, "spring 1: step from t = 0.0 s of h = 0.0 s: expected a finite time and a positive step"),
        ({}, CALM, float("nan"), 0.004, "spring 1: step from t = nan s of h = 0.004 s: expected a finite time and a positive step"),
    ],
)  # fmt: skip
def test_the_message_is_that_of_the_model_in_process(
    parameters: dict[str, Any], inputs: Any, t: float, h: float, expected: str, fmu: FmuSlave
) -> None:
    in_process, in_fmu = both(fmu, parameters, inputs, t, h)
    assert expected in in_process
    assert in_process in in_fmu


def test_a_list_of_numbers_is_shown_as_in_process(built_native: Callable[..., Path], tmp_path: Path) -> None:
    """A tool that is not in the table of milling_force."""
    np.save(tmp_path / "tools.npy", [[1.0, 0.016, 3.0, 0.5, 0.032], [20.0, 0.01, 2.0, 0.5, 0.02]])
    model = COMPONENTS["milling_force"]
    rows = np.array([float(p.start) for p in Interface(model).inputs])
    rows[Interface(model).arrays["tool"]] = 3
    texts = []
    for slave in (InProcessSlave(model, "mill"), FmuSlave(built_native("milling_force"), "mill")):
        with pytest.raises((ComponentError, SlaveError)) as error:
            one_step(slave, {"tools": str(tmp_path / "tools.npy")}, rows, 0.0, runs.H)
        texts.append(str(error.value))
        slave.close()
    assert "tool T3 is not in the table 'tools', which has [1 20]; add it there" in texts[0]
    assert texts[0].partition(" (")[0] in texts[1]


def set_now(fmu: FmuSlave, values: dict[str, Any]) -> None:
    """Set parameters past the checks of the master."""
    fmu._parameters = values
    fmu._set_parameters()


def test_a_parameter_out_of_bounds(fmu: FmuSlave) -> None:
    fmu.initialise(0.0, 1.0, runs.H)
    with pytest.raises(SlaveError, match=r"spring 1: parameter drift = 11\.0 N/s is above its maximum 10 N/s"):
        set_now(fmu, {"drift": 11.0})
    with pytest.raises(SlaveError, match=r"spring 1: parameter stiffness\[2,1\] = -1e-09 N/m is below its minimum 0 N/m"):
        set_now(fmu, {"stiffness[2,1]": -1e-9})


@pytest.mark.parametrize(("value", "shown"), [(np.nan, "nan"), (np.inf, "inf"), (-np.inf, "-inf")])
def test_an_input_that_is_not_finite(value: float, shown: str, fmu: FmuSlave) -> None:
    fmu.initialise(0.0, 1.0, runs.H)
    with pytest.raises(SlaveError, match=rf"spring 1: input x\[2\] = {shown} m is not a finite number"):
        fmu.set_inputs(np.array([0.1, value, 1.0, 0.0, 3.0]))


def test_a_fixed_parameter_while_running(fmu: FmuSlave) -> None:
    fmu.initialise(0.0, 1.0, runs.H)
    fmu.set_inputs(CALM)
    fmu.step(0.0, runs.H)
    with pytest.raises(SlaveError, match=r"spring 1: parameter stiffness\[1,1\] is fixed: it can be set before the first step only"):
        set_now(fmu, {"stiffness[1,1]": 5.0})
    with pytest.raises(SlaveError, match="spring 1: table curve is fixed: it can be set before the first step only"):
        set_now(fmu, {"curve": ""})
    set_now(fmu, {"drift": 5.0})  # may be tuned


def test_after_an_error_only_a_state_or_a_reset_helps(fmu: FmuSlave) -> None:
    fmu.initialise(0.0, 1.0, runs.H)
    fmu.set_inputs(CALM)
    fmu.step(0.0, runs.H)
    saved = fmu.get_state()
    fmu.set_inputs(np.array([2.0, 0.0, 1.0, 0.0, 3.0]))
    with pytest.raises(SlaveError, match="too far"):
        fmu.step(runs.H, runs.H)
    fmu.set_inputs(CALM)
    with pytest.raises(SlaveError, match=r"cannot go on after an error; reset it or restore a state\. The error was: spring 1 \(demo\): x"):
        fmu.step(runs.H, runs.H)
    fmu.set_state(saved)
    fmu.set_inputs(CALM)
    fmu.step(runs.H, runs.H)


def test_damaged_states_are_refused(fmu: FmuSlave) -> None:
    fmu.initialise(0.0, 1.0, runs.H)
    phase, saved = fmu.get_state()
    short = saved[:64] + (80).to_bytes(8, "little") + saved[72:]  # says that it is shorter than a state can be
    for bad in (saved[:-1], saved + b"\0", saved + saved, saved[:100], b"", b"x" + saved[1:], saved[:-1] + b"y", short):
        with pytest.raises(SlaveError, match=rf"spring 1: the {len(bad)} bytes are not a state of this FMU"):
            fmu.set_state((phase, bad))
    fmu.set_state((phase, saved))


def curve(fmu: FmuSlave, file: Path | str) -> float:
    """The output that shows the first value of the table."""
    fmu.configure({"curve": str(file)})
    fmu.initialise(0.0, 1.0, runs.H)
    out = np.zeros(len(INTERFACE.outputs))
    fmu.get_outputs(out)
    return float(out[INTERFACE.outputs.index(INTERFACE.by_name["curve_value"])])


def test_a_table_from_a_file(fmu: FmuSlave, tmp_path: Path) -> None:
    file = tmp_path / "Kürve.npy"
    for rows in (np.array([[0.0, 5.5], [1.0, 6.0]]), np.full((10, 2), 4.25)):
        np.save(file, rows)
        assert curve(fmu, file) == rows[0, 1]
    assert curve(fmu, "") == 7.0, "an empty name puts the built-in rows back"


def test_a_table_that_is_missing(fmu: FmuSlave, tmp_path: Path) -> None:
    with pytest.raises(SlaveError, match="the file does not exist or cannot be read"):
        curve(fmu, tmp_path / "none.npy")


def test_a_per_cent_sign_is_no_format(built_native: Callable[..., Path]) -> None:
    slave = FmuSlave(built_native("demo"), "100 %s %n")
    try:
        slave.initialise(0.0, 1.0, runs.H)
        with pytest.raises(SlaveError, match=r"100 %s %n: input x\[1\] = nan m"):
            slave.set_inputs(np.full(5, np.nan))
    finally:
        slave.close()


def test_a_wrong_guid(built_native: Callable[..., Path], tmp_path: Path) -> None:
    fmpy.extract(str(built_native("demo", 3)), str(tmp_path))
    messages: list[str] = []
    log = fmpy.fmi3.fmi3LogMessageCallback(lambda _e, _s, _c, text: messages.append(text.decode()))
    fmu = fmpy.fmi3.FMU3Slave(instanceName="a", guid="{no}", unzipDirectory=str(tmp_path), modelIdentifier="demo")
    with pytest.raises(Exception, match="instantiate"):
        fmu.instantiate(logMessage=log)
    assert messages[0].startswith("a: the instantiation token (GUID) is '{no}', expected '{")


def test_fmi3_value_references_and_counts(three: runs.Fmi3Slave) -> None:
    fmu, x = three.fmu, INTERFACE.by_name["x[1]"].reference
    for call, expected in (
        (lambda: fmu.getFloat64([99999]), "value reference 99999 does not exist; expected a real"),
        (lambda: fmu.getFloat64([x + 1]), f"value reference {x + 1} does not exist; expected a real"),
        (lambda: fmu.getFloat64([x]), "expected room for 2 values or more, found 1"),
        (lambda: fmu.getFloat64([x], nValues=3), "expected room for 2 values or more, found 3"),
        (lambda: fmu.setFloat64([x], [1.0, 2.0, 3.0]), "expected room for 2 values or more, found 3"),
        (lambda: fmu.getInt64([x], nValues=2), f"value reference {x} is x, a real; expected an integer"),
        (lambda: fmu.getString([x]), f"value reference {x} is x, a real; expected a string"),
        (lambda: fmu.setFloat64([INTERFACE.by_name["delayed"].reference], [1.0]), "delayed is an output and cannot be set"),
        (lambda: fmu.getFloat32([x]), "fmi3GetFloat32 is not provided: no derivatives, events, clocks or asynchronous steps"),
    ):
        three.messages.clear()
        with pytest.raises(Exception, match="failed with status 3"):
            call()
        assert three.messages == [f"demo: {expected}"]


def test_fmi3_knows_the_time(three: runs.Fmi3Slave) -> None:
    reference = three.variables["time"].valueReference
    three.initialise(2.0, 3.0, runs.H)
    assert three.fmu.getFloat64([reference]) == [2.0]
    three.step(2.0, 0.5)
    assert three.fmu.getFloat64([reference]) == [2.5]


def test_outputs_follow_the_inputs_during_initialisation(three: runs.Fmi3Slave, fmu: FmuSlave) -> None:
    for slave in (three, fmu):
        slave.initialise(0.0, 1.0, runs.H)
        for x in (0.1, 0.2):
            slave.set_inputs(np.array([x, 0.0, 1.0, 0.0, 3.0]))
            out = np.zeros(len(INTERFACE.outputs))
            slave.get_outputs(out)
            assert out[0] == 100.0 * x
