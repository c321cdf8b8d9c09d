"""Effect by effect: the closed loop with one accepted effect more each time, and how far the gap shrinks with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from robomill.diagnosis.candidates import Address, Candidate, physical
from robomill.diagnosis.inference.estimation import Fit, Space
from robomill.diagnosis.outcome.how_far import Closing


@dataclass(frozen=True)
class Left:
    """What is left of the gap of one figure."""

    after: float
    """Root mean square [unit of the figure], as in `HowFar`."""
    closure: float | None
    """Part of the squares that is closed by then; None where the gap is not measurable beside the noise."""


@dataclass(frozen=True)
class Step:
    """An effect that joins those before it."""

    effect: str
    """Its name and place; several, joined by `+`, where the system does not run with fewer of them."""
    left: Mapping[str, Left]
    """Figure (`channel` of `HowFar`) -> what is left with this effect and all before it."""


@dataclass(frozen=True)
class Steps:
    """Accepted effects one after the other."""

    on: str
    """Kind of runs (`HowFar`), the hardest test that there is. What there was before, and the noise, is in `how_far`."""
    added: tuple[Step, ...]
    """In the order in which they join."""


def steps(closing: Closing, fit: Fit) -> Steps:
    """The effects of a model one after the other, each set simulated: (number of effects - 1) simulations more per condition and repeat."""
    values: dict[Address, float] = {}
    kind, added, together = closing.hardest, [], []
    for c in ranked(fit, closing.search.evidence.space.without(list(fit.values))):
        values |= {a: fit.values[a] for a in c.addresses}
        together.append(c.name)
        if found := closing.of(physical(values), (kind,)):
            added.append(Step(" + ".join(together), {h.channel: Left(h.after, h.closure) for h in found}))
            together = []
    return Steps(kind, tuple(added))


def ranked(fit: Fit, space: Space) -> list[Candidate]:
    """The effects of a model, each the one that leaves least of the residual y after those before it.

    What an effect explains is its part of the signature, sensitivity times size: <y - s, y - s> of the sum s is what is left.
    """
    parts = fit.signatures()
    left, rest, order = space.y, list(parts), []
    while rest:
        best = min(rest, key=lambda c: space.square(left - parts[c]))
        rest.remove(best)
        left = left - parts[best]
        order.append(best)
    return order
