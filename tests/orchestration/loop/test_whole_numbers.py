"""Whole numbers that do not fit are errors, in both loops: nothing is wrapped, rounded or cut."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import RunError, SystemFileError, WiringError
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import PortData
from robomill.orchestration.system.definition import Component, Connection, System
from tests.orchestration import c_fmu, c_fmu3
from tests.orchestration.mocks import Mock, resolver, system

pytestmark = pytest.mark.usefixtures("temporary")

EXACT = 2**53 - 1
LOOPS = ["python", "compiled"]
LATE = 3  # steps after which the source gives the value that is tried


@pytest.fixture(scope="module")
def fmus(tmp_path_factory) -> dict[str, Path]:
    """The FMI 2 FMU, the FMI 3 FMU with the types that compiled code carries, and the one with all types."""
    if c_fmu.compiler() is None:
        pytest.skip("no C compiler here")
    make = tmp_path_factory.mktemp
    return {
        "fmi2": c_fmu.build(make("fmi2")),
        "plain": c_fmu3.build(make("plain"), c_fmu3.PLAIN),
        "all": c_fmu3.build(make("all")),
    }


def counter(value: float) -> Mock:
    """The output n: 1, and `value` from step LATE on."""
    return Mock("s", [PortData("n", "output", "integer", "1", dependencies=())], lambda u, t: [value if t > 0.004 * LATE - 0.002 else 1])


def given(file: Path, port: str, value: float, loop: str, folder: Path | None = None, algorithm: str = "gauss-seidel", **x) -> Run:
    s = counter(value)
    made = system([s])
    components = (*made.components, Component("x", str(file), **x))
    whole = System("t", 0.004, components, (Connection("s.n", f"x.{port}"),), algorithm, loop=loop, stop=0.04)
    return run(whole, folder, resolver=resolver([s]))


INPUTS = [  # the FMUs give the input plus one: one less than the largest is tried
    ("fmi2", "offset", 2**31 - 1, 2**31, -(2**31), 2**31 - 1),
    ("plain", "in_Int32[2]", -(2**31), -(2**31) - 1, -(2**31), 2**31 - 1),
    ("plain", "in_Int32[1]", 2**31 - 2, 2**40, -(2**31), 2**31 - 1),
    ("plain", "in_Int64", EXACT - 1, 2**53, -EXACT, EXACT),
]


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi", "iterated"])
@pytest.mark.parametrize(("fmu", "port", "held", "unfit", "low", "high"), INPUTS)
def test_what_does_not_fit_an_input_ends_the_run(fmus, tmp_path, loop, algorithm, fmu, port, held, unfit, low, high):
    given(fmus[fmu], port, held, loop, algorithm=algorithm)  # the last that fits
    with pytest.raises(RunError) as caught:
        given(fmus[fmu], port, unfit, loop, tmp_path / "run", algorithm)
    text = str(caught.value)
    assert f"component 's' at t = 0.012 s: output n = {unfit} " in text
    assert f"expected a whole number from {low} to {high}" in text
    assert (f"does not fit input x.{port}" if high < EXACT else "cannot be carried exactly (as float64)") in text
    assert len(Run.load(tmp_path / "run")) == LATE  # the rows before


@pytest.mark.parametrize(
    ("port", "held", "unfit"),
    [("in_Int8", 127, -129), ("in_UInt16", 65535, -1), ("in_UInt64", EXACT - 1, -1), ("in_Float32", 2**24, 2**24 + 1)],
)
def test_types_that_only_python_carries(fmus, port, held, unfit):
    given(fmus["all"], port, held, "python")
    with pytest.raises(RunError, match=rf"output n = {unfit} does not fit input x.{port}"):
        given(fmus["all"], port, unfit, "python")


@pytest.mark.parametrize("loop", LOOPS)
def test_output_that_float64_cannot_carry(tmp_path, loop):
    """The counter of an FMU beyond 2^53: n + 1 would read n."""
    if c_fmu.compiler() is None:
        pytest.skip("no C compiler here")
    source = c_fmu3.SOURCE.replace("GIVE(111, &m->v.i64, 1, + 1)", "GIVE(111, &m->v.i64, 1, + (m->v.time > 0.01 ? 9007199254740992 : 0))")
    assert source != c_fmu3.SOURCE
    file = c_fmu3.build(tmp_path, c_fmu3.PLAIN, source)
    one = System("t", 0.004, (Component("x", str(file)),), loop=loop, stop=0.04)
    with pytest.raises(RunError, match=r"'x' at t = 0.012 s: output out_Int64 = 9007199254740992 cannot be carried exactly"):
        run(one)
    with pytest.raises(RunError, match=r"out_Int64 = 9007199254740992"):  # also where declared ranges are not watched
        run(replace(one, check_ranges=False))


def test_real_too_large_for_a_short_real(fmus):
    s = Mock("s", [PortData("y", "output", dependencies=())], lambda u, t: [2.0**130])
    whole = System("t", 0.004, (Component("s", "mock"), Component("x", str(fmus["all"]))), (Connection("s.y", "x.in_Float32"),))
    with pytest.raises(
        RunError, match=r"component 'x' failed during initialisation: .*input in_Float32 = 1.3611294676837539e\+39 does not fit float32"
    ):
        run(whole, stop=0.04, resolver=resolver([s]))


def test_parameters_and_start_values(fmus, tmp_path):
    with pytest.raises(SystemFileError, match=r"input 'offset': 2147483648 does not fit its type: expected -2147483648 to 2147483647"):
        given(fmus["fmi2"], "offset", 1, "python", inputs={"offset": 2**31})
    with pytest.raises(SystemFileError, match=r"input 'in_Int64': 9007199254740993 does not fit its type: expected -9007199254740991"):
        given(fmus["plain"], "in_Int64", 1, "python", inputs={"in_Int64": 2**53 + 1})
    fixed = c_fmu.DESCRIPTION.replace('<ScalarVariable name="label"', '<ScalarVariable name="count" valueReference="0" '
        'causality="parameter" variability="fixed"><Integer start="1"/></ScalarVariable><ScalarVariable name="label"').replace(
        'dependencies="1 7"', 'dependencies="1 7"')  # fmt: skip
    file = c_fmu.build(tmp_path, description=fixed)
    with pytest.raises(SystemFileError, match=r"parameter 'count': 1099511627776 does not fit its type: expected -2147483648 to"):
        given(file, "offset", 1, "python", parameters={"count": 2**40})


def test_parameters_of_64_bits_are_exact_or_refused(fmus, tmp_path):
    """They are no float64 on their way, so that all of Int64 is allowed; a decimal that may stand for several numbers is not."""
    text = c_fmu3.PLAIN.replace(
        '<Int64 name="in_Int64" valueReference="11" causality="input" start="0"/>',
        '<Int64 name="in_Int64" valueReference="11" causality="parameter" variability="fixed" start="0"/>',
    )
    file = c_fmu3.build(tmp_path, text)
    one = System("t", 0.004, (Component("x", str(file), {"in_Int64": 2**53 + 2}),), stop=0.04)
    with pytest.raises(RunError, match="output out_Int64 = 9007199254740996"):  # + 1, rounded to even: it got there, and does not get out
        run(one)
    for value, words in ((2**63, "does not fit its type"), (1e17, "may stand for several whole numbers")):
        with pytest.raises(SystemFileError, match=words):
            run(one.with_parameters("x", {"in_Int64": value}))


def test_start_value_of_a_description_that_cannot_be_carried(tmp_path):
    if c_fmu.compiler() is None:
        pytest.skip("no C compiler here")
    text = c_fmu3.PLAIN.replace('causality="input" start="0"', f'causality="input" start="{2**53 + 1}"')
    file = c_fmu3.build(tmp_path, text)
    with pytest.raises(
        WiringError, match=r"input x.in_Int64: start value 9007199254740993 does not fit: expected a whole number from -900"
    ):
        run(System("t", 0.004, (Component("x", str(file)),), stop=0.04))


def test_override(fmus):
    for value in (2.0**31, 0.5, np.nan):
        with pytest.raises(WiringError, match=r"override of x.offset: .* is no whole number from -2147483648 to 2147483647"):
            run(
                System("t", 0.004, (Component("x", str(fmus["fmi2"])),), stop=0.04),
                manipulators=[lambda master, t, value=value: master.override("x.offset", value)],
            )
