"""What makes writing to a file that grows quick: disk space ahead of it, and numbers that stand in memory as they will in the file."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

import numpy as np

from robomill.orchestration.slaves.protocol import FloatArray

LINE = 64
"""Bytes of a line of the cache: where numbers begin in one, in memory and in the file, the kernel copies them at its best."""
_KEEP_SIZE = 1
"""FALLOC_FL_KEEP_SIZE of linux/falloc.h: the file does not get longer, so readers see nothing of it."""
_LIBRARY: Any = ctypes.CDLL(None) if sys.platform == "linux" else None


def reserve(descriptor: int, start: int, length: int) -> None:
    """Ask for blocks for `length` bytes from `start` of an open file, so that writes need not look for them one page at a time.

    Its size and content stay as they are; what is not written to goes with the file, or when it is truncated. Where that is
    not known (another system, another file system) or there is no room, nothing happens: the write will tell. See fallocate(2).
    """
    if _LIBRARY is not None:
        _LIBRARY.fallocate(descriptor, _KEEP_SIZE, ctypes.c_long(start), ctypes.c_long(length))


def zeros_on_lines(n: int, length: int) -> FloatArray:
    """Zeros, float64[n, length], that begin with a line of the cache."""
    numbers = np.zeros(n * length + LINE // 8)
    first = -numbers.ctypes.data % LINE // 8
    return numbers[first : first + n * length].reshape(n, length)
