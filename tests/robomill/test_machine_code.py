"""robomill.machine_code: compiled functions are kept as object code and loaded without Numba."""

from __future__ import annotations

import ctypes
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robomill.machine_code import c_types, flat, kind_of, machine_code, numba_types, object_code

OPTIONS = {"error_model": "numpy", "_nrt": False, "boundscheck": True}
LOADS = """
import ctypes, sys
from pathlib import Path
from robomill.machine_code import machine_code
def refuse():
    raise AssertionError("nothing was kept")
half = machine_code(Path(sys.argv[1]), refuse).function("half", ctypes.c_double)
assert half(3.0) == 1.5
assert "numba" not in sys.modules
"""


def half(x):
    return 0.5 * x


def put(values, at):
    values[at] = 2.0
    return at


def test_what_is_kept_is_loaded_by_another_process_without_numba(tmp_path: Path) -> None:
    file = tmp_path / "half"
    code = machine_code(file, lambda: object_code({"half": (half, numba_types(["float64"]))}, OPTIONS))
    assert code.function("half", ctypes.c_double)(3.0) == half(3.0)
    assert code.address("other") == 0
    subprocess.run([sys.executable, "-c", LOADS, str(file)], check=True)


def test_arrays_and_exceptions_come_through() -> None:
    values = np.zeros((3, 2))[:, 1]
    kinds = [kind_of(a) for a in (values, 1)]
    assert kinds == ["array(float64, 1d, A)", "int64"]
    fill = machine_code(None, lambda: object_code({"put": (put, numba_types(kinds))}, OPTIONS)).function("put", *c_types(kinds))
    assert fill(*flat([values, 1])) == 1
    assert values.tolist() == [0.0, 2.0, 0.0]
    with pytest.raises(IndexError, match="out of bounds"):
        fill(*flat([values, 7]))


def test_a_broken_file_is_made_anew(tmp_path: Path) -> None:
    made = []

    def make() -> tuple[bytes, bool]:
        made.append(1)
        return object_code({"half": (half, numba_types(["float64"]))}, OPTIONS)

    machine_code(tmp_path / "half", make)
    (file,) = tmp_path.iterdir()
    file.write_bytes(b"broken")
    assert machine_code(tmp_path / "half", make).function("half", ctypes.c_double)(1.0) == 0.5
    assert len(made) == 2


def tangent(x):
    return math.tan(x)


SINE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(("sin", ctypes.CDLL(None))) if sys.platform != "win32" else None


def sine_at_an_address(x):
    return SINE(x)


def said(x):
    print(x)
    return x


@pytest.mark.parametrize("function", [tangent, *([sine_at_an_address] if SINE else [])])
def test_code_that_needs_something_of_its_process_is_not_kept(function: Any, tmp_path: Path) -> None:
    code = machine_code(tmp_path / "code", lambda: object_code({"code": (function, numba_types(["float64"]))}, OPTIONS))
    assert code.function("code", ctypes.c_double)(0.5) == function(0.5)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_to_is_done_without(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    code = machine_code(tmp_path / "file" / "half", lambda: object_code({"half": (half, numba_types(["float64"]))}, OPTIONS))
    assert code.function("half", ctypes.c_double)(3.0) == 1.5


def test_code_of_another_compiler_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def make() -> tuple[bytes, bool]:
        return object_code({"half": (half, numba_types(["float64"]))}, OPTIONS)

    machine_code(tmp_path / "half", make)
    monkeypatch.setattr("robomill.machine_code._target", lambda: "another")
    machine_code(tmp_path / "half", make)
    assert len(list(tmp_path.iterdir())) == 2


def test_code_that_calls_python_is_refused() -> None:
    with pytest.raises(ValueError, match=r"code: compiled code calls Python \(print\?\); take that out, or run the model with Model.plain"):
        object_code({"code": (said, numba_types(["float64"]))}, OPTIONS)
