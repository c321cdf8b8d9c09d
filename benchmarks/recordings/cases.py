"""The recordings as data: scenarios/recordings/recordings.toml, and their runs."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robomill.cell.binding import convert
from robomill.cell.equipment import load_system
from robomill.diagnosis.catalogue import Catalogue
from robomill.logs.importing import import_log
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System

FOLDER = Path(__file__).parents[2] / "scenarios" / "recordings"
PREPARED = "prepared/"


@dataclass(frozen=True)
class Standing:
    """Which samples do not count: those of `channels`, an array, where the element of `speed` is below `below` [its unit]."""

    channels: str
    speed: str
    below: float


@dataclass(frozen=True)
class Case:
    """A recording and what is known of it."""

    name: str
    title: str
    nominal: str
    """What the nominal system is, in words."""
    folder: Path
    logs: Sequence[Mapping[str, Any]]
    expected: tuple[str, ...]
    """Candidates, `effect @ location`, that the machine is known to have."""
    absent: tuple[str, ...]
    """Candidates that it is known not to have."""
    known: str
    band: float
    """Corner [Hz] below which figures are compared; 0: all of it."""
    standing: Standing | None
    independent: bool
    """Whether the samples do not depend on each other: loads, not times."""
    file: Path
    """That of the nominal system."""

    def system(self) -> System:
        """The nominal system."""
        return load_system(self.file)

    def catalogue(self) -> Catalogue:
        """What may be wrong with it."""
        return Catalogue.load(self.folder / "catalogue.toml")

    def runs(self, folder: Path, prepared: Path) -> tuple[list[Run], list[Run]]:
        """Its logs, imported into `folder`: the runs that are diagnosed, and those that are held out.

        Logs that need it were written to `prepared` by `prepare`.
        """
        for log in self.logs:
            name = log["log"]
            file = prepared / name.removeprefix(PREPARED) if name.startswith(PREPARED) else self.folder / name
            import_log(self.folder / log["map"], file, folder / log["run"], True, log.get("labels"))
        given, held = ([Run.load(folder / place) for place in places] for places in self.places())
        return given, held

    def places(self) -> tuple[list[str], list[str]]:
        """Folders of the runs that are diagnosed, and of those that are held out, within that of the recording."""
        given: list[str] = []
        held: list[str] = []
        for log in self.logs:
            if "cut" in log:  # one log, several runs
                given += [str(Path(log["run"]) / piece) for piece in log["cut"]]
                held += [str(Path(log["run"]) / piece) for piece in log["held_out"]]
            else:
                (held if log.get("labels", {}).get("held_out") else given).append(log["run"])
        return given, held


def cases() -> list[Case]:
    """All recordings."""
    with (FOLDER / "recordings.toml").open("rb") as file:
        entries = tomllib.load(file)["recording"]
    return [
        Case(
            e["name"],
            e["title"],
            e["nominal"],
            FOLDER / e["folder"],
            e["logs"],
            tuple(e["expected"]),
            tuple(e.get("absent", ())),
            e["known"],
            _si(e.get("band", "0 Hz"), "Hz"),
            Standing(e["standing"]["channels"], e["standing"]["speed"], _si(e["standing"]["below"], "rad/s")) if "standing" in e else None,
            e.get("independent", False),
            FOLDER / e["folder"] / e.get("system", "system.toml"),
        )
        for e in entries
    ]


def _si(text: str, unit: str) -> float:
    value, _, given = text.partition(" ")
    return convert(float(value), given, unit)


def prepare(folder: Path) -> None:
    """Write what `robomill import` cannot read as it is published."""
    subprocess.run([sys.executable, str(FOLDER / "prepare.py"), str(folder)], check=True)
