"""Loops over arrays that are compiled when Numba is there and run as they are when it is not."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])


@cache
def compiled(function: Function) -> Function:
    """The function compiled by Numba (kept on disk, see models/model/cache.py), or as it is without Numba."""
    try:
        from numba import njit
    except ImportError:
        return function
    from robomill.models.model.cache import compiled_code

    with compiled_code(function):
        fast: Any = njit(cache=True, nogil=True, error_model="numpy")(function)
    result: Function = fast
    return result


def compiled_on_call(function: Function) -> Function:
    """As a decorator: `compiled` when it is first called, so that an import compiles nothing."""

    @wraps(function)
    def call(*arguments: Any) -> Any:
        return compiled(function)(*arguments)

    return call  # type: ignore[return-value]  # same arguments and result
