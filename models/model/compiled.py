"""Loops over arrays that are compiled when Numba is there and run as they are when it is not."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache, wraps
from typing import Any, TypeVar

from robomill.machine_code import c_types, flat, kind_of, machine_code, numba_types, object_code

Function = TypeVar("Function", bound=Callable[..., Any])


@cache
def compiled(function: Function) -> Function:
    """The function compiled by Numba (kept on disk, see models/model/cache.py), or as it is without Numba."""
    try:
        from numba import njit
    except ImportError:
        return function
    from robomill.models.model.cache import compiled_code
    from robomill.models.model.kernels import tell_numba

    tell_numba()
    with compiled_code(function):
        fast: Any = njit(cache=True, nogil=True, error_model="numpy")(function)
    result: Function = fast
    return result


@cache
def loaded(function: Function) -> Function:
    """As `compiled`, but kept as machine code that is loaded without Numba. For scalar loops over arrays that allocate nothing.

    Arguments are arrays, integers and floats; it returns an integer, a float, a truth value or nothing. Without Numba it
    runs as it is.
    """
    codes: dict[tuple[str, ...], Callable[..., Any]] = {}

    def call(*arguments: Any) -> Any:
        kinds = tuple(map(kind_of, arguments))
        if kinds not in codes:
            try:
                codes[kinds] = _load(function, kinds)
            except ImportError:
                codes[kinds] = function
        run = codes[kinds]
        return run(*arguments) if run is function else run(*flat(arguments))

    return call  # type: ignore[return-value]  # same arguments and result


def _load(function: Callable[..., Any], kinds: tuple[str, ...]) -> Callable[..., Any]:
    from robomill.models.model.cache import kept_code

    def make() -> tuple[bytes, bool]:
        from robomill.models.model.kernels import COMPILER_OPTIONS, tell_numba

        tell_numba()
        return object_code({"loop": (function, numba_types(kinds))}, {**COMPILER_OPTIONS, "boundscheck": False})

    name = f"{function.__name__}.{hashlib.sha256(repr(kinds).encode()).hexdigest()[:12]}"
    return machine_code(kept_code(name, function), make).function("loop", *c_types(kinds))


def loaded_on_call(function: Function) -> Function:
    """As a decorator: `loaded` when it is first called."""

    @wraps(function)
    def call(*arguments: Any) -> Any:
        return loaded(function)(*arguments)

    return call  # type: ignore[return-value]  # same arguments and result


def compiled_on_call(function: Function) -> Function:
    """As a decorator: `compiled` when it is first called, so that an import compiles nothing."""

    @wraps(function)
    def call(*arguments: Any) -> Any:
        return compiled(function)(*arguments)

    return call  # type: ignore[return-value]  # same arguments and result
