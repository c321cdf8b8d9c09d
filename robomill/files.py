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


def vacant(*files: Path, option: str = "--out") -> None:
    """FileExistsError that names all of these files that are there: nobody has asked for overwriting.

    `option`: what names another place.
    """
    if found := [str(file) for file in files if file.exists()]:
        verb = "is" if len(found) == 1 else "are"
        raise FileExistsError(
            f"{', '.join(found)} {verb} there already; choose another place ({option}), "
            "or allow overwriting (--overwrite; overwrite = True)"
        )
