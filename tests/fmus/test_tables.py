"""Tables of any length in every backend: what is refused, and that a saved state knows its tables without holding them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.fmus.in_process import InProcessSlave
from robomill.fmus.instance import ComponentError
from robomill.fmus.interface import Interface
from robomill.orchestration.errors import SlaveError
from robomill.orchestration.runs import checkpoint
from robomill.orchestration.slaves.fmu import FmuSlave
from tests.fmus import demo
from tests.fmus import native_runs as runs

BACKENDS = ("plain", "compiled", "python", "native 2", "native 3")
INTERFACE = Interface(demo.MODEL)
CALM = np.array([0.1, -0.1, 1.0, 0.0, 3.0])
LONG = 200_000
SMALL = 4096
"""Bytes: a state of the demo model without its rows is below that."""


@pytest.fixture(params=BACKENDS)
def make(request: pytest.FixtureRequest, built: Callable[..., Path], built_native: Callable[..., Path]) -> Iterator[Callable[[], Any]]:
    """A factory of slaves of the demo model in one of the backends."""
    backend = str(request.param)
    if backend.startswith("native") and not runs.ON_LINUX:
        pytest.skip("runs the linux64 library")
    made: list[Any] = []

    def slave() -> Any:
        if backend in ("plain", "compiled"):
            made.append(InProcessSlave(demo.MODEL, "springs", plain=backend == "plain"))
        else:
            made.append(FmuSlave(built("demo") if backend == "python" else built_native("demo", int(backend[-1])), "springs"))
        return made[-1]

    yield slave
    for one in made:
        one.close()


def outputs(slave: Any) -> list[float]:
    out = np.zeros(len(INTERFACE.outputs))
    slave.get_outputs(out)
    return list(out)


def ready(slave: Any, **parameters: Any) -> Any:
    slave.configure(parameters)
    slave.initialise(0.0, 1.0, runs.H)
    slave.set_inputs(CALM)
    return slave


def stepped(slave: Any, first: int, last: int) -> list[list[float]]:
    found = []
    for k in range(first, last):
        slave.set_inputs(CALM + np.array([0.01 * k, 0.0, 0.0, 0.0, 0.0]))
        slave.step(k * runs.H, runs.H)
        found.append(outputs(slave))
    return found


def long_file(folder: Path, value: float = 5.25) -> Path:
    rows = np.arange(2.0 * LONG).reshape(LONG, 2)
    rows[0, 1] = value
    np.save(folder / "long.npy", rows)
    return folder / "long.npy"


def claiming(rows: int) -> Callable[[bytes], bytes]:
    """Says that a file of five rows holds so many."""
    claim = f"({rows}, 2), }}".encode()
    return lambda whole: whole.replace(b"(5, 2), }".ljust(len(claim)), claim)


@pytest.mark.parametrize(
    ("rows", "spoil", "text"),
    [
        (np.zeros((3, 3)), bytes, r"has shape \(3, 3\), expected rows of 2 columns"),
        (np.zeros(4), bytes, r"has shape \(4,\), expected rows of 2 columns"),
        (np.zeros((2, 2, 2)), bytes, r"has shape \(2, 2, 2\), expected rows of 2 columns"),
        (np.zeros((3, 2), np.float32), bytes, r"expected float64 numbers in C order \(.*\), found \{'descr': '<f4'"),
        (np.zeros((3, 2), np.int64), bytes, r"expected float64 numbers in C order \(.*\), found \{'descr': '<i8'"),
        (np.asfortranarray(np.zeros((3, 2))), bytes, r"expected float64 numbers in C order \(.*\), found .*'fortran_order': True"),
        (np.array([[0.0, np.nan]]), bytes, "holds values that are not finite"),
        (np.zeros((5, 2)), lambda whole: whole[:-1], "ends before its last row"),
        (np.zeros((5, 2)), lambda whole: whole[:40], "has a header that is too long or incomplete"),
        (np.zeros((5, 2)), lambda _: b"PK\3\4 something else", "is not a .npy file"),
        (np.zeros((5, 2)), lambda _: b"", "is not a .npy file"),
        (np.zeros((5, 2)), claiming(6), "ends before its last row"),
        (np.zeros((5, 2)), claiming(2**59), "ends before its last row|needs more memory than there is"),
        (np.zeros((5, 2)), claiming(2**60 + 1), "ends before its last row|needs more memory than there is"),  # in 64 bits 16 bytes
    ],
)
def test_a_file_that_does_not_fit_is_refused(
    make: Callable[[], Any], rows: Any, spoil: Callable[[bytes], bytes], text: str, tmp_path: Path
) -> None:
    file = tmp_path / "curve.npy"
    np.save(file, rows)
    file.write_bytes(spoil(file.read_bytes()))
    with pytest.raises((ComponentError, SlaveError), match=f"springs: table curve from '{file}': ({text})"):
        ready(make(), curve=str(file))


def test_a_table_has_as_many_rows_as_its_file(make: Callable[[], Any], tmp_path: Path) -> None:
    slave = ready(make(), curve=str(long_file(tmp_path)))
    assert outputs(slave)[5] == 5.25
    slave.close()


def test_a_state_is_small_and_brings_its_table_to_another_instance(make: Callable[[], Any], tmp_path: Path) -> None:
    """The demo model shows the first row only; a state of the other instance says by its hash that all came with it."""
    one = ready(make(), curve=str(long_file(tmp_path)))
    stepped(one, 0, 5)
    state = one.get_state()
    parts: list[bytes] = []
    text = json.dumps(checkpoint._encode(state, parts))
    assert len(text) + sum(map(len, parts)) < SMALL
    expected = stepped(one, 5, 10)
    one.set_state(state)
    assert stepped(one, 5, 10) == expected
    other = ready(make())
    other.set_state(checkpoint.alike(other.get_state(), state))
    assert stepped(other, 5, 10) == expected
    other.set_state(state)
    assert checkpoint._encode(other.get_state(), []) == json.loads(text)


def test_a_state_whose_file_has_changed_is_refused_where_its_rows_are_needed(make: Callable[[], Any], tmp_path: Path) -> None:
    file = long_file(tmp_path)
    one = ready(make(), curve=str(file))
    stepped(one, 0, 5)
    state = one.get_state()
    expected = stepped(one, 5, 10)
    long_file(tmp_path, 6.0)
    one.set_state(state)  # it has the rows
    assert stepped(one, 5, 10) == expected
    text = f"table curve: in '{file}' there are other rows than when the state was saved; put those back"
    other = ready(make())
    before = outputs(other)
    with pytest.raises((ComponentError, SlaveError), match=text):
        other.set_state(state)
    file.unlink()
    third = ready(make())
    with pytest.raises((ComponentError, SlaveError), match=f"table curve from '{file}'"):
        third.set_state(state)
    long_file(tmp_path)
    fourth = ready(make())
    fourth.set_state(state)
    assert stepped(fourth, 5, 10) == expected
    assert before[5] == 7.0
