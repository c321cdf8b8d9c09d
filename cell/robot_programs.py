"""Programs of robot controllers from files: KRL (.src) and RAPID (.mod) that `models.planning.languages` wrote."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from robomill.models.planning.gcode.words import read_text

if TYPE_CHECKING:  # with SciPy, which takes a third of a second
    from robomill.models.planning.languages import PoseProgram

SUFFIXES = (".src", ".mod")
"""Suffixes (lower case) of KRL and RAPID."""


def is_robot_program(file: Path) -> bool:
    """Whether the suffix of a file is one of a robot program."""
    return file.suffix.lower() in SUFFIXES


def read_robot_program(file: Path) -> PoseProgram:
    """The program of a .src or .mod file. FileNotFoundError if there is none; LanguageError as the readers."""
    from robomill.models.planning.languages import read_krl, read_rapid

    text, name = read_text(file)
    return (read_krl if file.suffix.lower() == ".src" else read_rapid)(text, name)
