"""What comes out of scoring, and of diagnosing without the true effect: the records of score.json and withheld.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robomill.blind.statistics import Figure

Figures = Mapping[str, Figure]


def _figures(content: Mapping[str, Mapping[str, Any]]) -> Figures:
    return {name: Figure(**figure) for name, figure in content.items()}


@dataclass(frozen=True)
class EffectCounts:
    """Cases of a true effect (singles), and of how many this is true."""

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
    tier: str
    cases: int
    seed: int
    version: int | None
    date: str
    commit: str
    predictions: int
    predictions_as_first_unsealed: bool
    kinds: Mapping[str, int]
    isolability: bool
    """Whether it was looked at."""
    scores: Figures
    strata: Mapping[str, Figures]
    per_effect: Mapping[str, EffectCounts]
    confusion: Mapping[str, Mapping[str, int]]
    baselines: Mapping[str, Figures]

    @staticmethod
    def read(content: Mapping[str, Any]) -> Score:
        """From the content of the file."""
        tables: dict[str, Any] = {key: {name: _figures(f) for name, f in content[key].items()} for key in ("strata", "baselines")}
        counts = {name: EffectCounts(**c) for name, c in content["per_effect"].items()}
        return Score(**{**content, **tables, "scores": _figures(content["scores"]), "per_effect": counts})


@dataclass(frozen=True)
class WithheldCase:
    """What was said of a case whose effect was not in the catalogue."""

    case: str
    effect: str
    """The one that was taken out, as `component.effect`."""
    verdict: str
    said: str | None
    """The candidate that came first, with its probability, if an effect was claimed."""
    probability: float | None


@dataclass(frozen=True)
class Withheld:
    """All of withheld.json."""

    tier: str
    seed: int
    figures: Figures
    """Share of each verdict."""
    cases: Sequence[WithheldCase]
    failed: Mapping[str, str]
    """Case -> what went wrong."""

    @staticmethod
    def read(content: Mapping[str, Any]) -> Withheld:
        """From the content of the file."""
        return Withheld(**{**content, "figures": _figures(content["figures"]), "cases": [WithheldCase(**c) for c in content["cases"]]})
