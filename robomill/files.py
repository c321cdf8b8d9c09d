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


def vacant(folder: Path, *names: str, where: str = "--out") -> None:
    """FileExistsError that names all of these files that are in the folder: nobody has asked for overwriting."""
    if found := [name for name in names if (folder / name).exists()]:
        raise FileExistsError(
            f"{folder}/ already holds results ({', '.join(found)}); choose another folder ({where}), or replace them with --overwrite"
        )
