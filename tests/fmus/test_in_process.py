"""robomill.fmus.in_process and robomill.fmus.instance: a model as a slave without an FMU."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.fmus.in_process import InProcessSlave
from robomill.fmus.instance import ComponentError
from robomill.models.model import model_code
from robomill.orchestration.slaves.protocol import Slave
from tests.fmus.demo import MODEL

U = np.array([0.1, 0.2, 1.0, 0.0, 3.0])
H = 0.004


def ready(**parameters: Any) -> InProcessSlave:
    slave = InProcessSlave(MODEL, "springs")
    slave.configure(parameters)
    slave.set_inputs(U)
    slave.initialise(0.0, 1.0, H)
    return slave


def outputs(slave: InProcessSlave) -> list[float]:
    out = np.zeros(6)
    slave.get_outputs(out)
    return out.tolist()


def run(slave: InProcessSlave, first: int, last: int) -> list[list[float]]:
    rows = []
    for k in range(first, last):
        slave.set_inputs(U + np.array([0.001 * k, -0.002 * k, 0.0, 0.0, k]))
        slave.step(k * H, H)
        rows.append(outputs(slave))
    return rows


def test_it_is_a_slave_of_the_master() -> None:
    assert isinstance(ready(), Slave)


def test_outputs_before_the_first_step_follow_inputs_and_parameters() -> None:
    slave = ready(stiffness=[[10.0], [20.0]])
    assert outputs(slave) == [1.0, 4.0, 0.0, 1.0, 0.0, 7.0]
    slave.set_inputs(np.array([0.2, 0.2, 0.0, 0.0, 3.0]))
    assert outputs(slave) == [2.0, 4.0, 0.0, 0.0, 0.0, 7.0]


def test_start_values_of_inputs_are_set_like_parameters() -> None:
    slave = InProcessSlave(MODEL, "springs")
    slave.configure({"x[1]": 0.2, "number": 3})
    slave.initialise(0.0, 1.0, H)
    by_inputs = InProcessSlave(MODEL, "springs")
    by_inputs.set_inputs(np.array([0.2, 0.0, 1.0, 0.0, 3.0]))
    by_inputs.initialise(0.0, 1.0, H)
    assert outputs(slave) == outputs(by_inputs)


def test_compiled_and_plain_agree_bitwise() -> None:
    plain = InProcessSlave(MODEL, plain=True)
    plain.set_inputs(U)
    plain.initialise(0.0, 1.0, H)
    compiled = ready()
    assert compiled.instance.compiled
    assert not plain.instance.compiled
    assert run(compiled, 0, 50) == run(plain, 0, 50)


def test_without_numba_it_runs_in_plain_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = run(ready(), 0, 5)
    original = builtins.__import__

    def no_numba(name: str, *arguments: Any, **keywords: Any) -> Any:
        if name.partition(".")[0] == "numba":
            raise ImportError(name)
        return original(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", no_numba)
    monkeypatch.setattr(model_code, "_LOADED", {})
    monkeypatch.setenv("ROBOMILL_CACHE_DIR", str(tmp_path))  # else there is code that is kept
    slave = ready()
    assert not slave.instance.compiled
    assert run(slave, 0, 5) == expected


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_input_that_is_not_finite_is_refused_by_name(bad: float) -> None:
    slave = ready()
    values = U.copy()
    values[1] = bad
    with pytest.raises(ComponentError, match=rf"springs: input x\[2\] = {bad} is not a finite number"):
        slave.set_inputs(values)


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"stiffness[2,1]": -5.0}, "springs: parameter stiffness[2,1] = -5.0 N/m is below its minimum 0 N/m"),
        ({"stiffness": [[1.0], [2e6]]}, "springs: parameter stiffness[2,1] = 2000000.0 N/m is above its maximum 1000000 N/m"),
        (
            {"stiffness": [1.0, 2.0, 3.0]},
            "springs: parameter stiffness has shape [2, 1]; found a value of shape [3]; give a value of that shape",
        ),
        ({"drift": float("nan")}, "springs: parameter drift = nan N/s is not a finite number"),
        ({"drift": "fast"}, "springs: parameter drift = 'fast' N/s: expected a number"),
        ({"drfit": 1.0}, "springs: unknown parameter 'drfit'; available: stiffness, drift, curve"),
        ({"force": [1.0, 2.0]}, "springs: force is an output; set parameters and inputs only"),
        (
            {"curve": np.zeros((11, 3))},
            "springs: table curve: has shape (11, 3), expected rows of 2 columns",
        ),
        ({"curve": [[0.0, np.nan]]}, "springs: table curve: holds values that are not finite"),
        ({"curve": "/no/such.npy"}, "springs: table curve from '/no/such.npy': [Errno 2] No such file or directory: '/no/such.npy'"),
    ],
)
def test_a_bad_parameter_is_refused(parameters: dict[str, Any], text: str) -> None:
    with pytest.raises(ComponentError) as error:
        ready(**parameters)
    assert str(error.value) == text


def test_whole_numbers_and_switches_are_checked() -> None:
    slave = ready()
    values = U.copy()
    values[4] = 2.5
    with pytest.raises(ComponentError, match=r"springs: input number = 2\.5: expected a whole number"):
        slave.set_inputs(values)
    values[2:] = 2.0, 0.0, 3.0
    with pytest.raises(ComponentError, match=r"springs: input enable = 2\.0 is above its maximum 1"):
        slave.set_inputs(values)


def test_a_table_comes_from_rows_or_a_file_and_empty_means_the_built_in_rows(tmp_path: Path) -> None:
    np.save(tmp_path / "curve.npy", [[0.0, 5.0]])
    assert outputs(ready(curve=[[0.0, 6.0]]))[5] == 6.0
    slave = ready(curve=str(tmp_path / "curve.npy"))
    assert outputs(slave)[5] == 5.0
    slave.configure({"curve": ""})
    assert outputs(slave)[5] == 7.0


def test_the_models_messages_name_component_time_and_step() -> None:
    slave = ready()
    slave.set_inputs(np.array([1.5, 0.0, 1.0, 0.0, 3.0]))
    with pytest.raises(ComponentError) as error:
        slave.step(0.004, H)
    assert str(error.value) == "springs (demo): x[1] = 1.5 m is too far at t = 0.004 s; at most 1 m (step from t = 0.004 s, h = 0.004 s)"
    with pytest.raises(ComponentError, match=r"springs \(demo\): stiffness\[1\] = 13.0 N/m brings bad luck \(during initialisation\)"):
        ready(**{"stiffness[1,1]": 13.0})


@pytest.mark.parametrize(("t", "h"), [(0.0, 0.0), (0.0, -H), (np.nan, H), (0.0, np.inf)])
def test_a_step_needs_a_finite_time_and_a_positive_length(t: float, h: float) -> None:
    with pytest.raises(ComponentError, match="expected a finite time and a positive step"):
        ready().step(t, h)


def test_initialise_refuses_an_impossible_horizon() -> None:
    with pytest.raises(ComponentError, match="expected start < stop and a positive step"):
        InProcessSlave(MODEL).initialise(1.0, 1.0, H)


def test_fixed_parameters_stay_and_tunable_ones_may_change_while_it_runs() -> None:
    slave = ready()
    slave.step(0.0, H)
    with pytest.raises(ComponentError, match=r"springs: parameter stiffness\[1,1\] is fixed: it can be set before the first step only"):
        slave.configure({"stiffness[1,1]": 5.0})
    with pytest.raises(ComponentError, match="springs: table curve is fixed"):
        slave.configure({"curve": ""})
    before = outputs(slave)
    slave.configure({"drift": 2.0})
    assert outputs(slave) == before
    slave.step(H, H)
    assert outputs(slave)[0] == before[0] + 2.0 * 2.0 * H


def test_a_state_is_a_copy_of_everything_and_repeats_the_next_steps_bitwise() -> None:
    slave = ready(curve=[[0.0, 6.0]])
    run(slave, 0, 5)
    state = slave.get_state()
    expected = run(slave, 5, 10)
    slave.set_state(state)
    assert run(slave, 5, 10) == expected
    other = ready()
    other.set_state(state)
    assert run(other, 5, 10) == expected
    assert outputs(other)[5] == 6.0


def test_a_state_saved_during_initialisation_returns_there() -> None:
    slave = ready()
    state = slave.get_state()
    expected = run(slave, 0, 3)
    slave.set_state(state)
    slave.configure({"stiffness[1,1]": 100.0})
    assert run(slave, 0, 3) == expected


def test_the_state_of_another_model_is_refused() -> None:
    state = ready().get_state()
    with pytest.raises(ComponentError, match=r"springs: a state of \d+ bytes and 1 tables; one of demo has \d+ and 1"):
        ready().set_state(state._replace(words=state.words[8:]))


def test_reset_equals_a_fresh_instance() -> None:
    slave = ready(curve=[[0.0, 6.0]], **{"stiffness[1,1]": 1.0})
    run(slave, 0, 5)
    slave.reset()
    slave.set_inputs(U)
    slave.initialise(0.0, 1.0, H)
    assert run(slave, 0, 5) == run(ready(), 0, 5)


def test_instances_do_not_share_data() -> None:
    expected = run(ready(), 0, 4)
    one, other = ready(), ready(drift=1.0)
    found = []
    for k in range(4):
        found += run(one, k, k + 1)
        run(other, k, k + 1)
    assert found == expected


def test_after_close_it_says_so_and_close_may_be_repeated() -> None:
    slave = ready()
    slave.close()
    slave.close()
    with pytest.raises(ComponentError, match="springs: was closed"):
        slave.step(0.0, H)
