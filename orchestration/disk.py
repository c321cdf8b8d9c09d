"""Disk space ahead of a file that grows."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

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
