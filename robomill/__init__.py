"""The face of the project: what scripts import, and the command line.

    from robomill import System, run

    result = run(System.load("my_cell.toml"), "results/my_cell")
    result["drive.q_link"]          # float64[n, 6]

`run` and `System` are those of `orchestration`, with this project's components and units put in.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from orchestration.assembly import run as _run
from orchestration.parameters import Convert
from orchestration.results import Run
from orchestration.system import System as _System
from robomill.binding import convert, resolve
from robomill.scenario import Scenario, load_scenario

__all__ = ["Run", "Scenario", "System", "load_scenario", "run"]

run = partial(_run, resolver=resolve, convert=convert)
"""`orchestration.assembly.run`: System, folder (or None), stop [s], ... -> Run."""


class System(_System):
    """`orchestration.system.System`, whose files may give values with units."""

    @staticmethod
    def load(file: str | Path, convert: Convert = convert) -> _System:
        """Read a system file; SystemFileError names file, line, what was found and what is allowed."""
        return _System.load(file, convert)
