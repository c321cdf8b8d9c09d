"""The two functions of a model as machine code: for addresses of records, made once, kept on disk, and loaded without Numba."""

from __future__ import annotations

import ctypes
import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from robomill.machine_code import MachineCode, machine_code, object_code
from robomill.models.model.cache import kept_code
from robomill.models.model.calls import check_fields, check_kernels
from robomill.models.model.declaration import Model
from robomill.models.model.kernels import COMPILER_OPTIONS, tell_numba


class ModelCode(NamedTuple):
    """Compiled functions of a model, in memory as long as this object."""

    init: Callable[[int], int]
    """Takes the address of a record; raises what the model raises."""
    step: Callable[[int, float, float], int]
    """Takes the address of a record, t and h [s]."""
    step_address: int
    """Address of `int f(record *, double t, double h, int)`, which returns -1 for an exception."""
    code: MachineCode
    """Holds the memory at `step_address`."""


_LOADED: dict[Any, ModelCode] = {}


def model_code(model: Model) -> ModelCode:
    """The code of a model, made once per process, model functions and record."""
    key = (model.init, model.step, model.dtype)
    if key not in _LOADED:
        code = machine_code(_file(model), lambda: _make(model))
        record, number = ctypes.c_void_p, ctypes.c_double
        init, step = code.function("model_init", record), code.function("model_step", record, number, number)
        _LOADED[key] = ModelCode(init, step, code.address("model_step_c"), code)
    return _LOADED[key]


def _file(model: Model) -> Path | None:
    """Where the code is kept: named after the record and, of functions that a factory made, after what they hold."""
    digest = hashlib.sha256(repr(model.dtype).encode())
    for function in (model.init, model.step):
        digest.update(f"{function.__module__}.{function.__qualname__}".encode())
        if getattr(sys.modules.get(function.__module__), function.__qualname__, None) is not function:
            from numba.core.serialize import dumps

            pickled: Any = dumps
            held = pickled(tuple(c.cell_contents for c in function.__closure__ or ()))
            digest.update(f"{function.__code__.co_firstlineno}".encode() + function.__code__.co_code + held)
    return kept_code(f"{model.name}.{digest.hexdigest()[:12]}", model.init, model.step)


def _make(model: Model) -> tuple[bytes, bool]:
    import numba

    check_kernels(model.init, model.step)
    check_fields(model.dtype.names or (), model.init, model.step)
    tell_numba()
    record: Any = numba.from_dtype(model.dtype)
    functions: dict[str, Any] = {"model_init": (model.init, (record,)), "model_step": (model.step, (record, numba.float64, numba.float64))}
    return object_code(functions, COMPILER_OPTIONS, c_step="model_step")
