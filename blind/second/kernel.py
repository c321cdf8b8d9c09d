"""How the loops of the second generator are compiled, and the type of their arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]
_F = TypeVar("_F", bound=Callable[..., Any])
ZERO3, ZERO6 = np.zeros(3), np.zeros(6)
"""Nothing; never changed in place."""
_HERE = Path(__file__).parent


def forget_stale(folder: Path) -> None:
    """Delete what was compiled from other sources than those of a folder: a cached loop does not see a change in what it calls."""
    digest = hashlib.sha256(b"".join(f.read_bytes() for f in sorted(folder.glob("*.py")))).hexdigest()
    stamp = folder / "__pycache__" / "kernels.sha256"
    try:
        if not stamp.is_file() or stamp.read_text(encoding="utf-8") != digest:
            for index in (folder / "__pycache__").glob("*.nbi"):
                index.unlink(missing_ok=True)
            stamp.parent.mkdir(exist_ok=True)
            stamp.write_text(digest, encoding="utf-8")
    except OSError:  # installed where nothing can be written: the sources do not change there
        return


forget_stale(_HERE)


def compiled(function: _F) -> _F:
    """The function, compiled on its first call and kept on disk."""
    make: Callable[..., Any] = njit(cache=True, nogil=True, error_model="numpy")
    fast: _F = make(function)
    return fast
