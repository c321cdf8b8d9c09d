"""Runs that could be made next, by kinds with parameters, and the seeded search for the best one: which kind, and with which values.

A kind is a way to make a run, with quantities that the experimenter sets within bounds and the minutes that it takes. What a run is worth
is for the caller to say, from its simulations; the search is by coordinates from where each kind begins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robomill.orchestration.system.definition import System

SEARCHED = 40
"""Simulations of a search at most (cost: seconds). Where three models are rivals, that is eight runs."""
STEPS = (0.5, 0.25)
"""Parts of a range by which one quantity is moved, one after the other (cost)."""


@dataclass(frozen=True)
class Quantity:
    """Something that the experimenter sets, `low` < `high` [unit]; the search begins at `start`."""

    name: str
    unit: str
    low: float
    high: float
    start: float


@dataclass(frozen=True)
class Offer:
    """A run that could be made: the system that makes it, and what is set in it."""

    system: System
    """Components are called as in the system that is diagnosed, but some may be others."""
    parameters: Mapping[str, Mapping[str, Any]]
    """Component -> parameter -> value."""
    seconds: float
    """Length of one repeat."""


@dataclass(frozen=True)
class Kind:
    """A way to make a run."""

    name: str
    quantities: tuple[Quantity, ...]
    minutes: float
    """What all repeats take, with setting up."""
    repeats: int
    make: Callable[[Mapping[str, float]], Offer]
    """The run with these values, name -> [unit]."""


@dataclass(frozen=True)
class Design:
    """A kind with values [unit]."""

    kind: Kind
    values: tuple[float, ...]

    @property
    def named(self) -> dict[str, float]:
        """Name of the quantity -> its value [unit]."""
        return {q.name: v for q, v in zip(self.kind.quantities, self.values, strict=True)}

    def offer(self) -> Offer:
        """The run."""
        return self.kind.make(self.named)

    def moved(self, index: int, part: float) -> Design:
        """With one quantity moved by a part of its range, within its bounds."""
        q = self.kind.quantities[index]
        value = min(max(self.values[index] + part * (q.high - q.low), q.low), q.high)
        return Design(self.kind, (*self.values[:index], value, *self.values[index + 1 :]))


Worth = Callable[[Sequence[Design]], Sequence[float]]
"""What each design is worth per minute; -inf where it cannot be made."""


def searched(kinds: Sequence[Kind], worth: Worth, most: Callable[[Kind], float], budget: int) -> dict[Design, float]:
    """All designs that were looked at, at most `budget` of them, with what they are worth.

    `most`: what no run of a kind can be worth more than; kinds that cannot win any more are not looked at. The quickest come first. Then
    one quantity after the other is moved, in the order of a seeded shuffle, from the best kind, then from the next; from those that say
    nothing where they begin only if all do so.
    """
    found: dict[Design, float] = {}
    random = np.random.default_rng(0)

    def looked_at(designs: Sequence[Design]) -> None:
        new = [d for d in dict.fromkeys(designs) if d not in found][: budget - len(found)]
        if new:
            found.update(zip(new, worth(new), strict=True))

    for kind in sorted(kinds, key=lambda k: (k.minutes, k.name)):
        if most(kind) > max(found.values(), default=-np.inf):
            looked_at([Design(kind, tuple(q.start for q in kind.quantities))])
    for begun in sorted((d for d, w in found.items() if w > 0.0), key=lambda d: -found[d]) or list(found):
        here = begun
        for part in STEPS:
            for i in random.permutation(len(here.kind.quantities)):
                if most(here.kind) <= max(found.values()) or len(found) >= budget:
                    break
                near = [here.moved(int(i), sign * part) for sign in (1.0, -1.0)]
                looked_at(near)
                here = max([here, *(d for d in near if d in found)], key=lambda d: found[d])
    return found
