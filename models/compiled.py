"""Loops over arrays that are compiled when Numba is there and run as they are when it is not."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any


@cache
def compiled(function: Callable[..., None]) -> Callable[..., None]:
    """The function compiled by Numba (kept on disk, see models/cache.py), or as it is without Numba."""
    try:
        from numba import njit
    except ImportError:
        return function
    from models.cache import compiled_code

    with compiled_code(function):
        fast: Any = njit(cache=True, nogil=True, error_model="numpy")(function)
    result: Callable[..., None] = fast
    return result
