"""The files of the project that tests read as text."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
CODE = (
    "benchmarks",
    "blind",
    "cell",
    "conformance",
    "diagnosis",
    "docs",
    "examples",
    "fmus",
    "models",
    "orchestration",
    "reference",
    "robomill",
    "tests",
)
"""Folders with Python code."""


def sources(folder: Path, *suffixes: str) -> Iterator[Path]:
    """Files below a folder with one of these suffixes, but for what is linked to: robomill/ has links to the folders beside it."""
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink():
            yield from sources(path, *suffixes)
        elif path.suffix in suffixes:
            yield path
