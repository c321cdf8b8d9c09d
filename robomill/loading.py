"""Scenarios, systems and runs from their files, or from the names of those that come with robomill."""

from __future__ import annotations

from pathlib import Path

from robomill.cell.equipment import load_system
from robomill.cell.scenario import Scenario, load_scenario
from robomill.files import FILES
from robomill.orchestration.errors import available, unknown
from robomill.orchestration.runs.files import RUN
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.toml_text import parse


def load(what: str | Path) -> Scenario | System | Run:
    """Read a scenario or system file (TOML) or a folder that holds a run; `what` may also be the name of a file that comes with robomill.

    Names are those of `robomill example`, such as "groove" or "robots/kr210_2", and of system files beside them, such as "milling_cell".

        >>> load("groove").variants[1].title
        'Cartesian'

    FileNotFoundError lists the names; ScenarioError, SystemFileError or ResultsError says what is wrong with the file, and where.
    """
    place = Path(what)
    if place.is_dir() and (place / RUN).is_file():
        return Run.load(place)
    file = place if place.is_file() else _shipped(place)
    if file.suffix == ".ssp":
        raise ValueError(f"{file}: an SSP package is unpacked for the time of a run only; run it with: robomill run {file}")
    try:
        is_scenario = "scenario" in parse(file.read_text(encoding="utf-8"))
    except ValueError:  # no TOML, or no text: the system loader names the line
        is_scenario = False
    return load_scenario(file) if is_scenario else load_system(file)


def _shipped(name: Path) -> Path:
    """The file of that name below scenarios/, or the system file of an example."""
    scenarios, examples = FILES / "scenarios", FILES / "examples"
    for file in (scenarios / f"{name}.toml", examples / name / "system.toml"):
        if not name.is_absolute() and file.is_file():
            return file
    if name.is_dir():
        runs = [f.parent.name for f in sorted(name.glob(f"*/{RUN}"))]
        raise FileNotFoundError(
            f"the folder {name} is no run: there is no {RUN} in it; "
            + (f"give the folder of one of its runs: {available(runs)}" if runs else "give one that `robomill run` has written")
        )
    known = [f.relative_to(scenarios).with_suffix("").as_posix() for f in sorted(scenarios.rglob("*.toml"))]
    known += [f.parent.name for f in sorted(examples.glob("*/system.toml"))]
    raise FileNotFoundError(
        f"there is no file {name}, and it is no name of a file that comes with robomill: {unknown('name', str(name), known)}"
    )
