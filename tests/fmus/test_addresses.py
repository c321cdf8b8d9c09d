"""In-process components in the compiled master: the same bits and the same errors as in Python."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.fmus.address import Addresses
from robomill.fmus.in_process import InProcessSlave
from robomill.models.components.robot_compliance import MODEL as COMPLIANCE
from robomill.models.components.robot_drive import MODEL as DRIVE
from robomill.orchestration.assembly import run
from robomill.orchestration.errors import OrchestrationError, RunError
from robomill.orchestration.system.definition import Component, Connection, System
from tests.fmus import demo

MODELS = {"demo": demo.MODEL, "drive": DRIVE, "compliance": COMPLIANCE}


def resolve(source, name):
    return InProcessSlave(MODELS[source], name)


def both(system, stop):
    return [run(system, stop=stop, loop=loop, resolver=resolve) for loop in ("python", "compiled")]


def assert_equal(a, b):
    assert list(a.columns) == list(b.columns)
    for name in a.columns:
        assert a[name].tobytes() == b[name].tobytes(), name


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
def test_all_types_between_two_components(algorithm):
    a = Component("a", "demo", {"drift": 0.5}, inputs={"x": [0.002, 0.01]})
    b = Component("b", "demo", rate=2, inputs={"x[1]": 0.003})
    c = Component("c", "demo", every=3, inputs={"x[2]": 0.001})
    connections = (Connection("a.count", "b.number"), Connection("b.on", "c.enable"), Connection("c.count", "a.number", True))
    x, y = both(System("x", 0.004, (a, b, c), connections, algorithm), 2.0)
    assert_equal(x, y)
    assert list(x["b.count"][[0, 1, -1]]) == [0.0, 2.0, 1000.0]
    assert len(np.unique(x["a.delayed"])) > 400


def test_robot_under_a_load():
    load = {"f_T_B": [300.0, -200.0, 100.0]}
    q = [0.1, -1.9, 2.1, 0.2, -0.3, 0.1]
    drive = Component("drive", "drive", inputs={"q_ref": q, "correction_B": [1e-3, 0.0, -1e-3], **load})
    compliance = Component("compliance", "compliance", inputs=load)
    a, b = both(System("x", 0.004, (drive, compliance), (Connection("drive.q_link", "compliance.q_link"),)), 2.0)
    assert_equal(a, b)
    assert np.ptp(a["compliance.p_BT_B[1]"]) > 1e-5


def test_error_of_the_model_in_the_compiled_loop():
    components = (Component("a", "demo", every=100), Component("b", "demo"))
    s = System("x", 0.004, components, (Connection("a.count", "b.x[1]"),))
    texts = []
    for loop in ("python", "compiled"):
        with pytest.raises(RunError) as caught:
            run(s, stop=4.0, loop=loop, resolver=resolve)
        texts.append(str(caught.value))
        assert (caught.value.component, caught.value.time) == ("b", 0.796)
    assert texts[0] == texts[1]
    assert "x[1] = 2.0 m is too far at t = 0.796 s; at most 1 m (step from t = 0.796 s, h = 0.004 s)" in texts[1]


def test_index_out_of_bounds_is_an_error_and_not_a_number():
    def init(s):
        return 0

    def step(s, t, h):
        s.y = s.x[int(1000.0 * t)]
        return 0

    from robomill.models.model.declaration import Model, Variable

    model = Model("bad", "d", (Variable("x", "input", "x", shape=(20,)), Variable("y", "output", "y")), init, step)
    s = System("x", 0.004, (Component("bad", "bad"),))
    with pytest.raises(RunError, match=r"exception in the step from t = 0.02 s: an index out of bounds"):
        run(s, stop=1.0, loop="compiled", resolver=lambda source, name: InProcessSlave(model, name))


def test_runs_of_one_type_are_one_block():
    slave = InProcessSlave(demo.MODEL)
    slave.initialise(0.0, 1.0, 0.1)
    native = slave.native()
    assert isinstance(native, Addresses)
    # the record has the reals of a direction first: x[1], x[2], speed; enable, number
    assert [(b.kind, b.places) for b in native.inputs] == [("float64", (0, 1)), ("int64", (2,)), ("float64", (3,)), ("int64", (4,))]


def test_plain_models_run_in_python():
    s = System("x", 0.004, (Component("a", "demo"),))
    with pytest.raises(OrchestrationError, match=r"component 'a' \(InProcessSlave\) can only be called from Python"):
        run(s, stop=1.0, loop="compiled", resolver=lambda source, name: InProcessSlave(demo.MODEL, name, plain=True))
