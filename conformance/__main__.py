"""The process that runs an FMU: `python __main__.py FMU REPORT [CHECK ...]`. Of this project it can import this package only."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

_NAME = "robomill_conformance"
"""What the package is called here, where there is no `robomill`."""


def _alone() -> None:
    """Import this package by its place, and take the rest of the project off the path, unless it is installed."""
    folder = Path(__file__).resolve().parent
    home = folder.parent
    sys.path = [p for p in sys.path if p and (Path(p).resolve() != home or home.name.endswith("-packages"))]
    spec = importlib.util.spec_from_file_location(_NAME, folder / "__init__.py")
    assert spec is not None
    assert spec.loader is not None
    sys.modules[_NAME] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[_NAME])


if __name__ == "__main__":
    _alone()
    battery = importlib.import_module(f"{_NAME}.battery")
    battery.run(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
    os._exit(0)  # whatever the libraries of the FMU do at the end is not of interest
