"""Which candidates the given runs cannot tell apart: whitened distances between signatures at their best values.

Distances are in deviations: 3 means that the same data would prefer the wrong one of two about once in fifteen times
(half the distance is where the decision falls). The nuisances are marginalised: a difference that lies within the
tolerances of calibrated numbers is none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.inference.estimation import Fit, Space
from robomill.orchestration.slaves.protocol import FloatArray

CONFUSABLE = 3.0
"""Distance below which two candidates count as the same thing to these data."""


@dataclass(frozen=True)
class Pair:
    """Two candidates that can stand for each other, and how far apart they are."""

    pair: tuple[str, str]
    """Their names, in alphabetical order."""
    distance: float
    """Whitened distance of their signatures [deviations of noise]."""
    confusable: bool
    """Whether the data cannot tell them apart: closer than CONFUSABLE."""


def distance(one: Fit, other: Fit, space: Space) -> float:
    """Distance of the signatures of two fitted models in deviations of noise: sqrt(<s1 - s2, s1 - s2>)."""
    assert one.signature is not None
    assert other.signature is not None
    difference: FloatArray = one.signature - other.signature
    return math.sqrt(max(space.square(difference), 0.0))


def pairs(fits: Sequence[Fit], surviving: Sequence[Candidate], space: Space) -> list[Pair]:
    """Candidates that stand for each other, closest first: models that differ in one candidate, at least one of the two surviving."""
    closest: dict[frozenset[Candidate], Pair] = {}
    for f, g in combinations([f for f in fits if f.model and f.signature is not None], 2):
        only_f, only_g = set(f.model) - set(g.model), set(g.model) - set(f.model)
        if len(only_f) != 1 or len(only_g) != 1:
            continue
        (a,), (b,) = only_f, only_g
        if a.name == b.name or (a not in surviving and b not in surviving):
            continue
        far = distance(f, g, space)
        key = frozenset((a, b))
        if key not in closest or far < closest[key].distance:
            names = (a.name, b.name) if a.name < b.name else (b.name, a.name)
            closest[key] = Pair(names, far, far < CONFUSABLE)
    return sorted(closest.values(), key=lambda p: (p.distance, p.pair))
