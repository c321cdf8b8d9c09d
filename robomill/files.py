"""Where scenarios, pages and data stand that come with robomill."""

from __future__ import annotations

from importlib.metadata import distribution
from pathlib import Path

from robomill import models

FILES = Path(str(models.__file__)).resolve().parents[1]
"""The checkout, or the folder of the installed package: `scenarios`, `docs/components`, `tests/golden`, `data` stand in it."""


def licence() -> bytes:
    """Text of the licence: in a checkout beside the folders, of an installed package in its metadata."""
    file = FILES / "LICENSE"
    return file.read_bytes() if file.is_file() else (distribution("robomill").read_text("licenses/LICENSE") or "").encode()
