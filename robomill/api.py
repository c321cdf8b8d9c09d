"""What scripts import: `from robomill import System, run`.

`run` and `System` are those of `orchestration`, with the components and units of milling cells put in.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.cell.scenario import Scenario, load_scenario
from robomill.orchestration.assembly import run as _run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System as _System
from robomill.orchestration.system.parameters import Convert

__all__ = ["Run", "Scenario", "System", "load_scenario", "run"]

run = partial(_run, resolver=resolve, convert=convert)
"""`orchestration.assembly.run`: System, folder (or None), stop [s], ... -> Run."""


class System(_System):
    """`orchestration.system.definition.System`, whose files may give values with units."""

    @staticmethod
    def load(file: str | Path, convert: Convert = convert) -> _System:
        """Read a system file, and give its components the robot, tool, material and sensor that it names (`cell.equipment`).

        SystemFileError names file, line, what was found and what is allowed.
        """
        return load_system(file)
