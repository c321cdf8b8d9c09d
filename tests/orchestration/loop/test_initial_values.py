"""The outputs at the start, of FMUs that compute them only when they leave initialisation: in the first row and in the first inputs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import Component, Connection, Recording, System
from tests.orchestration import c_fmu, c_fmu3
from tests.orchestration.mocks import gain, resolver, system

pytestmark = pytest.mark.usefixtures("temporary")

H, STEPS, OFFSET = 0.004, 5, 29.75
_FMI2 = (
    "fmi2ExitInitializationMode(fmi2Component c) {",
    "fmi2ExitInitializationMode(fmi2Component c) { Model *m = c; m->v.y = 29.75 + m->v.u;",
)
_FMI3 = (
    "fmi3ExitInitializationMode(fmi3Instance c) {",
    "fmi3ExitInitializationMode(fmi3Instance c) { Model *m = c; for (int i = 0; i < 6; i++) m->v.y[i] = 29.75 + m->v.u[i];",
)


@pytest.fixture(scope="module")
def late(tmp_path_factory) -> dict[int, Path]:
    """By FMI version: y = 29.75 + u on leaving initialisation, 0 before; y' = gain u."""
    if c_fmu.compiler() is None:
        pytest.skip("no C compiler here")
    assert _FMI2[0] in c_fmu.SOURCE
    assert _FMI3[0] in c_fmu3.SOURCE
    # that y hangs on u at the start, and in a step not: both are said
    text = c_fmu.DESCRIPTION.replace('unit="m" min="-1e6" max="1e6"', 'unit="1" min="-1e6" max="1e6"')
    return {
        2: c_fmu.build(tmp_path_factory.mktemp("fmi2"), c_fmu.SOURCE.replace(*_FMI2), text),
        3: c_fmu3.build(tmp_path_factory.mktemp("fmi3"), c_fmu3.PLAIN, c_fmu3.SOURCE.replace(*_FMI3)),
    }


def y_of(r: Run, name: str, fmi: int) -> np.ndarray:
    return r[f"{name}.y"] if fmi == 2 else r[f"{name}.y"][:, 0, 0]


def chain(file: Path, algorithm: str, loop: str, **x) -> System:
    """First -> x -> z."""
    parts = tuple(Component(n, str(file), **(x if n == "x" else {})) for n in ("first", "x", "z"))
    return System("t", H, parts, (Connection("x.y", "z.u"), Connection("first.y", "x.u")), algorithm, stop=STEPS * H, loop=loop)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("loop", ["python", "compiled"])
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "iterated"])
@pytest.mark.parametrize("x", [{}, {"isolate": True}, {"rate": 2}, {"every": 2}], ids=["plain", "isolated", "rate", "every"])
def test_first_row_and_first_inputs(late, fmi, loop, algorithm, x):
    s = chain(late[fmi], algorithm, loop, **x)
    r = run(s)
    first, second, third = (y_of(r, name, fmi) for name in ("first", "x", "z"))
    assert first[0] == OFFSET + 0.5
    assert second[0] == OFFSET + first[0]
    assert third[0] == OFFSET + second[0]
    if not x:  # the first step integrates what was there at the start (Jacobi), or is there after the step (the others)
        assert second[1] == second[0] + H * first[0 if algorithm == "jacobi" else 1]


def test_as_fmpy(late):
    """One FMU alone: the same rows as another importer's."""
    expected = fmpy.simulate_fmu(
        str(late[2]), stop_time=STEPS * H, step_size=H, output_interval=H, output=["y", "twice"], start_values={"u": 0.5}
    )
    r = run(System("t", H, (Component("x", str(late[2])),), stop=STEPS * H))
    assert expected["y"][0] == OFFSET + 0.5
    assert np.array_equal(r["x.y"], expected["y"])
    assert np.array_equal(r["x.twice"], expected["twice"])


@pytest.mark.parametrize("loop", ["python", "compiled"])
def test_in_an_iterated_loop(late, loop):
    """X -> a -> x: what is known on leaving only gets to who comes after."""
    a = gain("a", 1e-3)
    s = system([a], "x.y -> a.u", "a.y -> x.u", algorithm="iterated", stop=H, loop=loop)
    r = run(replace(s, components=(Component("x", str(late[2])), *s.components)), resolver=resolver([a]))
    assert r["x.y"][0] == OFFSET
    assert r["a.y"][0] == 1e-3 * OFFSET


@pytest.mark.parametrize("fmi", [2, 3])
def test_delayed_input_of_the_first_step(late, fmi):
    late_connection = (Connection("first.y", "x.u", delayed=True),)
    parts = tuple(Component(n, str(late[fmi])) for n in ("first", "x"))
    r = run(System("t", H, parts, late_connection, stop=H))
    x = y_of(r, "x", fmi)
    assert x[0] == OFFSET + 0.5  # the start value of its input
    assert x[1] == x[0] + H * (OFFSET + 0.5)


def test_checkpoint_and_resume(late, tmp_path):
    s = replace(chain(late[2], "gauss-seidel", "auto"), stop=10 * H, recording=Recording(checkpoint_every=2))
    whole = run(s, tmp_path / "whole")
    run(replace(s, stop=4 * H), tmp_path / "part")
    again = run(s, tmp_path / "part", resume=True)
    assert again["z.y"][0] == 3 * OFFSET + 0.5
    for name in whole.columns:
        assert np.array_equal(whole[name], again[name]), name
