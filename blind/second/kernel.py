"""How the loops of the second generator are compiled and where they are kept, and the type of their arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
import numpy.typing as npt

from robomill.user_cache import prune, user_folder

FloatArray = npt.NDArray[np.float64]
_F = TypeVar("_F", bound=Callable[..., Any])
ZERO3, ZERO6 = np.zeros(3), np.zeros(6)
"""Nothing; never changed in place."""


def folder_of(sources: Path) -> Path:
    """Where code that was compiled from a folder of sources is kept: an edit in any of them makes another folder.

    Numba itself looks only at the file of the outermost function.
    """
    digest = hashlib.sha256(numba.__version__.encode() + b"".join(f.read_bytes() for f in sorted(sources.glob("*.py"))))
    return user_folder() / "numba" / digest.hexdigest()[:24]


@cache
def _kept() -> str | None:
    """The folder of this package, made if need be; None where nothing can be written: Numba's own place then."""
    folder = folder_of(Path(__file__).parent)
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()
        prune(folder.parent, folder.name)
        return str(folder)
    return None


def compiled(function: _F) -> _F:
    """The function, compiled on its first call and kept on disk."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = _kept() or before
    try:
        make: Callable[..., Any] = numba.njit(cache=True, nogil=True, error_model="numpy")
        fast: _F = make(function)
    finally:
        config.CACHE_DIR = before
    return fast
