"""Effects that are one idea, or that the runs cannot tell apart: their probability first, that of each of them after.

Friction in six joints, or stiffness error and asymmetry under torques of one sign: which of them it is may be open where it is clear that
it is one of them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.inference.estimation import Fit, Space
from robomill.orchestration.slaves.protocol import FloatArray

CORRELATED = 0.95
"""Correlation [1] of two signatures from which effects count as twins. DIAGNOSIS2 section 1; half of the way to 1, a few twins fewer."""


@dataclass(frozen=True)
class Family:
    """Effects that count as one."""

    name: str
    """What the catalogue calls them; `like NAME` of the likeliest one where it does not say that they belong together."""
    probability: float
    """Sum of the probabilities of all models that have one of them."""
    members: Mapping[str, float]
    """Name of an effect and its place -> its probability, largest first."""


def families(fits: Sequence[Fit], weights: Sequence[float] | FloatArray, space: Space, candidates: Sequence[Candidate]) -> list[Family]:
    """Families of two members or more among the effects of these models, the likeliest first; `weights`: probability of each model.

    Declared by `family` of the catalogue; found where signatures correlate by more than CORRELATED with that of the likeliest member, and
    the catalogue has not put them together.
    """
    likely = dict.fromkeys((c.name for c in candidates), 0.0)
    shown: dict[str, tuple[float, Candidate, FloatArray]] = {}
    for f, p in zip(fits, weights, strict=True):
        for c, signature in f.signatures().items():
            likely[c.name] = likely.get(c.name, 0.0) + float(p)
            # alone an effect shows what it is like; beside others, only what is left to it
            rank = float(p) + (1.0 if len(f.model) == 1 else 0.0)
            if c.name not in shown or rank > shown[c.name][0]:
                shown[c.name] = (rank, c, signature)
    order = sorted(shown, key=lambda name: -likely[name])
    declared: dict[str, list[str]] = {}
    for name in order:
        declared.setdefault(shown[name][1].family, []).append(name)
    groups = {family: members for family, members in declared.items() if family and len(members) > 1}
    free = list(order)
    while free:
        first = free.pop(0)
        twins = [n for n in free if _correlation(shown[first], shown[n], space) > CORRELATED]
        free = [n for n in free if n not in twins]
        together = {first, *twins}
        if twins and not any(together <= set(members) for members in groups.values()):
            groups[f"like {first}"] = [first, *twins]
    found = [
        Family(name, _any(fits, weights, set(members)), {n: likely[n] for n in sorted(members, key=lambda n: -likely[n])})
        for name, members in groups.items()
    ]
    return sorted(found, key=lambda family: -family.probability)


def _correlation(one: tuple[float, Candidate, FloatArray], other: tuple[float, Candidate, FloatArray], space: Space) -> float:
    """|<a, b>| / sqrt(<a, a> <b, b>) of two signatures, what is a tolerance of one of them no nuisance; 0 where one does nothing."""
    own = space.without([*one[1].addresses, *other[1].addresses])
    together = own.dot(*2 * [np.stack([one[2], other[2]]).T])
    size = float(together[0, 0] * together[1, 1])
    return abs(float(together[0, 1])) / size**0.5 if size > 0.0 else 0.0


def _any(fits: Sequence[Fit], weights: Sequence[float] | FloatArray, members: Collection[str]) -> float:
    """Probability of the models that have one of these effects."""
    return float(sum(p for f, p in zip(fits, weights, strict=True) if any(c.name in members for c in f.model)))
