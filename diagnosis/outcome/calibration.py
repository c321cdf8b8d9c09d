"""Calibrated numbers that an answer needs farther off than their tolerances say."""

from __future__ import annotations

from dataclasses import dataclass

from robomill.diagnosis.inference.adequacy import beyond
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.search import Search


@dataclass(frozen=True)
class Pulled:
    """A number that is farther off than it is said to be."""

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

    @property
    def text(self) -> str:
        """In words: a number, how far it is off, and where it would be."""
        way = "above" if self.deviations > 0.0 else "below"
        unit = "" if self.unit == "1" else f" {self.unit}"
        return (
            f"{self.component}.{self.parameter} is {abs(self.deviations):.1f} times its tolerance {way} what is given:"
            f" about {self.value:.4g}{unit}, not {self.given:.4g}{unit}"
        )


def pulled(search: Search, fit: Fit, false_alarm: float) -> tuple[Pulled, ...]:
    """The numbers of a model that are farther off than one of so many is with this probability, the farthest first.

    A number is N(0, 1) in standard deviations of its tolerance (`beyond`).
    """
    numbers, means, _ = search.numbers(fit)
    far = beyond(len(numbers), false_alarm)
    found = [
        Pulled(*n.address, n.nominal, n.nominal + z * n.scale, z, n.unit)
        for n, z in zip(numbers, map(float, means), strict=True)
        if abs(z) > far
    ]
    return tuple(sorted(found, key=lambda p: -abs(p.deviations)))
