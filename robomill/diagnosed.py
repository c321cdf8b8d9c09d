"""The answer of a diagnosis, as scripts and notebooks use it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robomill.diagnose_command import ANSWER, lines, write
from robomill.diagnosis.candidates import Address
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.localisation.where import Where
from robomill.diagnosis.outcome.answer import Diagnosis, Which
from robomill.diagnosis.outcome.closure import HowFar
from robomill.diagnosis.outcome.verdict import Verdict
from robomill.files import vacant
from robomill.orchestration import html
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """Where measured runs depart from their simulation, why, and how far that can be mended."""

    diagnosis: Diagnosis
    """The whole answer, with what the report draws."""
    system: System
    """The nominal simulation."""
    runs: tuple[Run, ...]
    """The runs that were diagnosed, then those that were held out."""
    catalogue: Catalogue
    """The effects that were looked for."""

    @property
    def verdict(self) -> Verdict:
        """`none`, `identified`, `ambiguous`, `unknown`, or `bad_log`: the log is not usable."""
        return self.diagnosis.answer.verdict

    @property
    def effects(self) -> tuple[Which, ...]:
        """Effects that may be the cause, likeliest first: component, location, probability (0 to 1), parameters with 90 % intervals."""
        return self.diagnosis.answer.which

    @property
    def where(self) -> tuple[Where, ...]:
        """Components that the gap is in, largest share (0 to 1) first."""
        return self.diagnosis.answer.where

    @property
    def how_far(self) -> tuple[HowFar, ...]:
        """How far the gap of each figure shrinks, on each kind of runs."""
        return self.diagnosis.answer.how_far

    @property
    def closure(self) -> dict[str, float | None]:
        """Figure and kind of runs -> share of the gap (its square) that the adopted effects close, at most 1.

        None where the gap cannot be measured beside the noise.
        """
        return {f"{h.metric}, {h.on}": h.closure for h in self.how_far}

    @property
    def next_run(self) -> str | None:
        """The run that would tell the remaining effects apart, in words; None where none is proposed."""
        proposed = self.diagnosis.answer.next_run
        return None if proposed is None else proposed.text

    @property
    def adopted(self) -> dict[Address, float]:
        """(component, parameter) -> value [unit of the port] that the best model has."""
        return self.diagnosis.adopted

    @property
    def result(self) -> dict[str, Any]:
        """What diagnosis.json holds."""
        return self.diagnosis.result

    def report(self, folder: str | Path, overwrite: bool = False) -> Path:
        """Write report.html, its figures, diagnosis.json and, where there is something to adopt, adopt.ssv; returns the page.

        FileExistsError where the folder holds an answer and `overwrite` is not given.
        """
        place = Path(folder)
        if not overwrite:
            vacant(place / ANSWER, option="folder")
        return write(self.diagnosis, self.system, self.runs, self.catalogue, place)

    def __str__(self) -> str:
        return "\n".join(lines(self.diagnosis.answer))

    def _repr_html_(self) -> str:
        rows = []
        for e in self.effects:
            values = ", ".join(f"{k} = {v.text}" for k, v in e.parameters.items())
            rows.append((e.effect, e.location, f"{e.probability:.2f}", values))
        table = html.table("Effects", ("effect", "location", "probability", "parameters, 90 %"), rows) if rows else ""
        return table + html.paragraphs(text for text in lines(self.diagnosis.answer) if not text.startswith("which: "))
