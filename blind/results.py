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
    detectable: int
    isolable: int
    detected: int
    named: int
    named_top3: int


@dataclass(frozen=True)
class Score:
    """All of score.json."""

    schema: str
    set: str
    tier: str
    generator: str
    cases: int
    seed: int
    version: int
    date: str
    commit: str
    predictions: int
    predictions_as_first_unsealed: bool
    kinds: Mapping[str, int]
    isolability: bool
    """Whether it was looked at."""
    scores: Mapping[str, Figures]
    """Over all cases (`all`), and by generator."""
    strata: Mapping[str, Figures]
    per_effect: Mapping[str, EffectCounts]
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

    @staticmethod
    def read(content: Mapping[str, Any]) -> Score:
        """From the content of the file."""
        tables: dict[str, Any] = {key: {name: _figures(f) for name, f in content[key].items()} for key in ("scores", "strata", "baselines")}
        counts = {name: EffectCounts(**c) for name, c in content["per_effect"].items()}
        return Score(**{**content, **tables, "per_effect": counts, "claims": [Claim(**c) for c in content["claims"]]})
