"""What is installed beside robomill, read from the names of folders.

`importlib.metadata` answers the same questions; it takes 12 ms to load, with Python's e-mail parser, and is asked where this cannot tell.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

_FOLDER = re.compile(r"(?P<name>.+?)-(?P<version>[^-]+)\.dist-info")


@cache
def version(package: str) -> str:
    """Version of an installed package. PackageNotFoundError if it is not installed."""
    wanted = _normal(package)
    for folder in _places():
        found = _FOLDER.fullmatch(folder.name)
        if found is not None and _normal(found["name"]) == wanted:
            return found["version"]
    from importlib import metadata

    return metadata.version(package)


def may_offer(group: str) -> bool:
    """Whether an installed package may have entry points of this group: its name occurs, or a part of the search path is no folder."""
    if any(Path(place).is_file() for place in sys.path):  # an archive
        return True
    for folder in _places():
        with suppress(OSError):
            if group in (folder / "entry_points.txt").read_text(encoding="utf-8"):
                return True
    return False


def _places() -> Iterator[Path]:
    """Folders with what is known of an installed package, in the order of the search path."""
    for place in sys.path:
        with suppress(OSError), os.scandir(place or ".") as found:  # hundreds of names, of which few become paths
            yield from [Path(f.path) for f in found if f.name.endswith((".dist-info", ".egg-info"))]


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
