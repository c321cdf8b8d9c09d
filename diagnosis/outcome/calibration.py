"""Calibrated numbers that an answer needs farther off than their tolerances say."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.stats import norm

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

    A number z is N(0, 1) in standard deviations of its tolerance. Of k numbers one is beyond the quantile of false_alarm / 2k with at most
    that probability (Bonferroni).
    """
    assert fit.signature is not None
    space = search.evidence.space.without(list(fit.values))
    moved = dict(zip(space.names, space.moved(space.y - fit.signature), strict=True))
    numbers = [n for n in search.nuisances if n.address in moved and n.address not in space.gone]
    far = float(norm.isf(0.5 * false_alarm / max(len(numbers), 1)))
    off = [(n, float(moved[n.address])) for n in numbers]
    found = [Pulled(*n.address, n.nominal, n.nominal + z * n.scale, z, n.unit) for n, z in off if abs(z) > far]
    return tuple(sorted(found, key=lambda p: -abs(p.deviations)))
