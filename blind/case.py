"""Cases: truth beside prediction, and what the data of a case can decide at all.

Detectable: the oracle ratio of the generator (largest over measured arrays and windows of 0.5 s) is at least `DETECTABLE`.
Isolable: no other catalogue candidate and no clock of the log explains the change that the true effect makes but for as much
(`signatures.confusable`). Both are properties of the data, not of the prediction.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from robomill.blind.prediction import Named, Prediction
from robomill.blind.truth import Truth

DETECTABLE = 3.0
"""Oracle ratio from which a case counts as detectable."""
CATALOGUE = ("single", "double", "triple", "machine")
"""Kinds of cases with effects of the catalogue."""
REAL = (*CATALOGUE, "withheld", "outside", "formed")
"""Kinds of cases with something real and a good log."""
CASE_KINDS = ("null", *REAL, "bad_log")

Confusable = Callable[[int, int], Sequence[str]]
"""(number of the case, index of its effect) -> other candidates (`component.parameter`) that the data cannot tell from that effect."""


@dataclass(frozen=True)
class Case:
    """Truth and prediction of one case."""

    number: int
    truth: Truth
    prediction: Prediction

    @property
    def kind(self) -> str:
        """One of `CASE_KINDS`."""
        return self.truth.kind

    @property
    def effects(self) -> tuple[Named, ...]:
        """True catalogue effects."""
        return tuple(e.named for e in self.truth.effects)

    @property
    def keys(self) -> set[str]:
        """True catalogue effects, as `component.effect`."""
        return {e.key for e in self.effects}

    @property
    def ratio(self) -> float:
        """Oracle ratio of all that is in it."""
        return self.truth.detectability

    @property
    def detectable(self) -> bool:
        """By the oracle: something in it; of a bad log its fault (a channel that stands still has no noise, which is always seen)."""
        if (fault := self.truth.bad_log) is not None:
            return fault.kind == "constant" or fault.detectability is None or fault.detectability >= DETECTABLE
        return self.ratio >= DETECTABLE

    def effect_detectable(self, i: int) -> bool:
        """Whether effect `i` is, by itself."""
        own = self.truth.effects[i].detectability
        return (self.ratio if own is None else own) >= DETECTABLE


def load_cases(folder: Path, truths: Mapping[int, Truth]) -> list[Case]:
    """Truths with their predictions; one that is missing or unreadable has the verdict `missing`."""
    cases = []
    for number, truth in sorted(truths.items()):
        file = folder / "predictions" / f"{number:04d}" / "diagnosis.json"
        try:
            prediction = Prediction.read(json.loads(file.read_text(encoding="utf-8")))
        except (OSError, ValueError):
            prediction = Prediction("missing")
        cases.append(Case(number, truth, prediction))
    return cases


@dataclass
class Cases:
    """The cases of a benchmark, to be selected from. Without `confusable` all effects count as isolable."""

    all: Sequence[Case]
    confusable: Confusable | None = None
    _alike: dict[tuple[int, int], Sequence[str]] = field(default_factory=dict)

    def of(self, *kinds: str) -> list[Case]:
        """Cases of those kinds."""
        return [c for c in self.all if c.kind in kinds]

    def detectable(self, *kinds: str) -> list[Case]:
        """Those of these kinds that are detectable."""
        return [c for c in self.of(*kinds) if c.detectable]

    def of_generator(self, name: str) -> Cases:
        """The cases that one generator made."""
        return Cases([c for c in self.all if c.truth.generator == name], self.confusable, self._alike)

    def alike(self, c: Case, i: int) -> Sequence[str]:
        """Candidates that the data cannot tell from effect `i`, the same effect elsewhere included."""
        if self.confusable is None:
            return ()
        key = (c.number, i)
        if key not in self._alike:
            self._alike[key] = tuple(self.confusable(*key))
        return self._alike[key]

    def isolable(self, c: Case, i: int) -> bool:
        """Whether the data can tell effect `i` from every other candidate."""
        return not self.alike(c, i)

    def decidable(self, c: Case) -> list[int]:
        """Effects that are detectable and isolable."""
        return [i for i in range(len(c.effects)) if c.effect_detectable(i) and self.isolable(c, i)]

    @property
    def singles(self) -> list[Case]:
        """Singles whose effect is detectable and isolable."""
        return [c for c in self.detectable("single") if self.decidable(c)]
