"""The digital twin of compliance-compensated robot milling.

    from robomill import System, run

    result = run(System.load("my_cell.toml"), "results/my_cell")
    result["drive.q_link"]          # float64[n, 6]

These names are those of `robomill.api`, imported when they are asked for: a part of the package, and an FMU's
process, does not load the rest of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robomill.api import Run, Scenario, System, load_scenario, run

__all__ = ["Run", "Scenario", "System", "load_scenario", "run"]

if not (Path(__file__).parent / "models").is_dir():  # a checkout on a system without symbolic links
    __path__.append(str(Path(__file__).parents[1]))


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from robomill import api

    return getattr(api, name)
