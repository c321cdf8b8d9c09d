"""Calibrated numbers as an answer has them, and which of them it needs farther off than their tolerances say."""

from __future__ import annotations

from dataclasses import dataclass

from robomill.diagnosis.inference.adequacy import beyond
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.search import Search


@dataclass(frozen=True)
class Pulled:
    """A calibrated number, and how far off it is."""

    component: str
    """Component of the number."""
    parameter: str
    """The number."""
    given: float
    """Its value in the model [unit]."""
    value: float
    """Its value by the best model [unit]."""
    deviations: float
    """How far that is off, in standard deviations of its tolerance [1]."""
    unit: str
    """Unit of the number."""
    bound: float | None = None
    """What its parameter can be at most or at least, where the value is beyond that [unit]; null: it is not."""

    @property
    def text(self) -> str:
        """In words: a number, how far it is off, where it would be, and whether it can be there."""
        way = "above" if self.deviations > 0.0 else "below"
        unit = "" if self.unit == "1" else f" {self.unit}"
        value, given = _told_apart(self.value, self.given)
        return (
            f"{self.component}.{self.parameter} is {abs(self.deviations):.1f} times its tolerance {way} what is given:"
            f" about {value}{unit}, not {given}{unit}"
            + ("" if self.bound is None else f"; it cannot be {way} {self.bound:.4g}{unit}, so something else is wrong")
        )


def _told_apart(*numbers: float) -> list[str]:
    """Numbers to four digits, or to as many as tell them apart."""
    rounded = ([f"{x:.{digits}g}" for x in numbers] for digits in range(4, 17))
    return next((texts for texts in rounded if len(set(texts)) == len(numbers)), [f"{x:.17g}" for x in numbers])


def pulled(search: Search, fit: Fit, false_alarm: float) -> tuple[Pulled, ...]:
    """The numbers of a model that are farther off than one of so many is with this probability, the farthest first.

    A number is N(0, 1) in standard deviations of its tolerance (`beyond`).
    """
    found = _numbers(search, fit)
    far = beyond(len(found), false_alarm)
    return tuple(p for p in found if abs(p.deviations) > far)


def farthest(search: Search, fit: Fit) -> Pulled | None:
    """The number that a model has farthest off, however far that is; None where there are no calibrated numbers."""
    return next(iter(_numbers(search, fit)), None)


def _numbers(search: Search, fit: Fit) -> list[Pulled]:
    """All calibrated numbers as a model has them, the farthest off first; one that is in the model itself is no tolerance."""
    numbers, means, _ = search.numbers(fit)
    found = []
    for n, z in zip(numbers, map(float, means), strict=True):
        if n.address in fit.values:
            continue
        value, bound = n.nominal + z * n.scale, n.allowed[z > 0.0]
        beyond_it = value > bound if z > 0.0 else value < bound
        found.append(Pulled(*n.address, n.nominal, value, z, n.unit, bound if beyond_it else None))
    return sorted(found, key=lambda p: -abs(p.deviations))
