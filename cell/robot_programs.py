"""Programs of robot controllers from files: KRL (.src) and RAPID (.mod) that `models.planning.languages` wrote."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from robomill.models.planning.gcode.words import read_text
from robomill.models.planning.languages import PoseProgram, read_krl, read_rapid

READERS: dict[str, Callable[[str, str], PoseProgram]] = {".src": read_krl, ".mod": read_rapid}
"""Suffix (lower case) -> reader."""


def is_robot_program(file: Path) -> bool:
    """Whether the suffix of a file is one of a robot program."""
    return file.suffix.lower() in READERS


def read_robot_program(file: Path) -> PoseProgram:
    """The program of a .src or .mod file. FileNotFoundError if there is none; LanguageError as the readers."""
    text, name = read_text(file)
    return READERS[file.suffix.lower()](text, name)
