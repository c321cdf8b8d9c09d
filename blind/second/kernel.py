"""How the loops of the second generator are compiled, and the type of their arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
_F = TypeVar("_F", bound=Callable[..., Any])


def compiled(function: _F) -> _F:
    """The function, compiled on its first call and kept on disk."""
    fast: _F = njit(cache=True, nogil=True, error_model="numpy")(function)
    return fast
