"""What compiled models are made of besides `init` and `step`: the helpers that they call, and how Numba is told of them."""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

Function = TypeVar("Function", bound=Callable[..., Any])

COMPILER_OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": False,
    "boundscheck": True,
    "_nrt": False,
}
"""Options of every compiled function. Without the Numba runtime an array temporary is a compile
error; no fast maths and no contraction keep the numbers equal to those of plain Python."""

_UNTOLD: list[Callable[..., Any]] = []
"""Kernels that Numba does not know yet."""
_TELLING = threading.Lock()  # who compiles in another thread waits for the last of them; nothing is imported meanwhile


def kernel(function: Function) -> Function:
    """Mark a helper that `init` or `step` calls: plain Python stays plain, compiled code compiles it.

    Numba is told when it is there, or by `tell_numba` before something is compiled: code that is kept is loaded without Numba.
    """
    function.is_kernel = True  # type: ignore[attr-defined]  # for `models.model.calls`
    _UNTOLD.append(function)
    if "numba.extending" in sys.modules:
        tell_numba()
    return function


def number_at(address: int) -> float:
    """The float64 at an address. Compiled it is a load instruction; in plain Python ctypes does it."""
    return np.float64(ctypes.c_double.from_address(int(address)).value)


number_at.is_kernel = True  # type: ignore[attr-defined]  # compiled code has one of its own
_UNTOLD.append(number_at)


def tell_numba() -> None:
    """Let Numba compile the kernels declared so far where compiled code calls them. ImportError without Numba."""
    from numba.extending import register_jitable

    with _TELLING:
        while _UNTOLD:
            function = _UNTOLD.pop()
            if function is number_at:
                _tell_of_load()
            else:
                register_jitable(**COMPILER_OPTIONS)(function)


def _tell_of_load() -> None:
    """Let `number_at` be a load instruction."""
    from numba import types
    from numba.extending import intrinsic, overload

    @intrinsic
    def load(typing_context: Any, address: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.load(builder.inttoptr(arguments[0], context.get_value_type(signature.return_type).as_pointer()))

        return types.float64(types.int64), code

    options: Any = COMPILER_OPTIONS

    @overload(number_at, jit_options=options)
    def made(address: int) -> Any:
        def compiled(address: int) -> Any:
            return load(address)  # type: ignore[call-arg]  # Numba gives the context

        return compiled
