"""What comes out of scoring: the record of score.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robomill.blind.statistics import Claim, Figure

Figures = Mapping[str, Figure]
ALL = "all"
"""Key of the figures over the cases of both generators."""


def _figures(content: Mapping[str, Mapping[str, Any]]) -> Figures:
    return {name: Figure(**figure) for name, figure in content.items()}


@dataclass(frozen=True)
class EffectCounts:
    """Cases of a true effect (singles and withheld ones), and of how many this is true."""

    cases: int
    """Cases of the effect."""
    detectable: int
    """Cases in which the effect is large enough to be seen."""
    isolable: int
    """Cases in which nothing else looks alike."""
    detected: int
    """Cases in which something was found."""
    named: int
    """Cases in which the first answer is right."""
    named_top3: int
    """Cases in which one of the first three answers is right."""


@dataclass(frozen=True)
class Score:
    """All of score.json."""

    schema: str
    """Name and version of the form."""
    set: str
    """Set of cases."""
    tier: str
    """Set of channels that are logged."""
    generator: str
    """Generator of the cases."""
    cases: int
    """Number of cases."""
    seed: int
    """Seed of the benchmark."""
    version: int
    """Version of the generator."""
    date: str
    """Date of the scoring."""
    commit: str
    """Commit of the program."""
    predictions: int
    """Predictions that there were."""
    predictions_as_first_unsealed: bool
    """Whether the predictions are those that were there when the truth was first opened."""
    kinds: Mapping[str, int]
    """Cases by kind."""
    isolability: bool
    """Whether it was looked at."""
    scores: Mapping[str, Figures]
    """Over all cases (`all`), and by generator."""
    strata: Mapping[str, Figures]
    """Figures by stratum of the cases."""
    per_effect: Mapping[str, EffectCounts]
    """Counts by effect."""
    confusion: Mapping[str, Mapping[str, int]]
    """True effect -> what was said first -> cases."""
    components: Mapping[str, Mapping[str, int]]
    """By component."""
    claims: Sequence[Claim]
    """Everything that is claimed in good logs: the calibration counts over all sets together."""
    wall: float | None
    """Mean wall time of a diagnosis in one process [s]."""
    cpu: float | None
    """Mean CPU time of it [s]."""
    baselines: Mapping[str, Figures]
    """Figures of simple methods, to compare with."""

    @staticmethod
    def read(content: Mapping[str, Any]) -> Score:
        """From the content of the file."""
        tables: dict[str, Any] = {key: {name: _figures(f) for name, f in content[key].items()} for key in ("scores", "strata", "baselines")}
        counts = {name: EffectCounts(**c) for name, c in content["per_effect"].items()}
        return Score(**{**content, **tables, "per_effect": counts, "claims": [Claim(**c) for c in content["claims"]]})
