"""The per-user cache folder, and what is removed from it. Needs nothing but Python: an FMU loads this file before its package."""

from __future__ import annotations

import os
import sys
import time
from contextlib import suppress
from pathlib import Path

KEPT = 100
"""Folders that stay however long ago they were used: the components of this project, and some former sources of each."""
IN_USE = 86400.0
"""Time [s] since its last use in which a folder stays however many there are: a process may still run from it."""


def user_folder() -> Path:
    """The per-user cache folder of this project: $ROBOMILL_CACHE_DIR or what the platform has for that purpose."""
    chosen = os.environ.get("ROBOMILL_CACHE_DIR")
    if chosen:
        return Path(chosen)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or str(Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = str(Path.home() / "Library" / "Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "robomill"


def use(folder: Path) -> None:
    """Mark a cache folder as used now; if it is not there yet, make room for it among its neighbours."""
    with suppress(OSError):
        if folder.is_dir():
            os.utime(folder)
        else:
            prune(folder.parent, folder.name)


def prune(folder: Path, current: str, kept: int = KEPT) -> None:
    """Remove the subfolders of `folder` that were used longest ago, all but `kept`, `current` and those used within `IN_USE`."""
    with suppress(OSError):
        used = {f: f.stat().st_mtime for f in folder.iterdir() if f.is_dir() and f.name != current}
        import shutil  # rarely needed here, and two milliseconds to load

        for old in sorted(used, key=used.__getitem__, reverse=True)[kept:]:
            if time.time() - used[old] > IN_USE:
                shutil.rmtree(old, ignore_errors=True)
