"""The digital twin of compliance-compensated robot milling.

    import robomill as rm

    runs = rm.run("groove")                      # a scenario that comes with robomill, in all its variants
    runs["cartesian"]["compliance.p_BT_B"]       # float64[n, 3], m

The names are those of `robomill.api`, imported when they are asked for: a part of the package, and an FMU's
process, does not load the rest of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robomill.api import Diagnosed, Run, Runs, Scenario, System, diagnose, load, load_scenario, run

__all__ = ["Diagnosed", "Run", "Runs", "Scenario", "System", "diagnose", "load", "load_scenario", "run"]
__version__ = "0.1.0"

if not (Path(__file__).parent / "models").is_dir():  # a checkout on a system without symbolic links
    __path__.append(str(Path(__file__).parents[1]))


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from robomill import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
