"""The numbers of an effect and their 90 % intervals: by the fit, or of a single recording by least squares."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from robomill.diagnosis.candidates import Address, Candidate, physical
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.evidence import FORM
from robomill.diagnosis.inference.intervals import Known
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.outcome.answer import Estimate

WIDER = 1.25
"""Factor on the deviation of a fit in intervals [1]. Fitted to 59 values of the second set of blind cases: 90 % are within."""


@dataclass(frozen=True)
class Values:
    """Values and intervals of the effects of the best model and of others."""

    search: Search
    best: Fit
    known: Mapping[str, Known] = field(default_factory=dict)
    """What least squares say of the effects of the best model, by name, where noise is a guess (`intervals`)."""

    def parameters(self, c: Candidate, fit: Fit) -> dict[str, Estimate]:
        """Parameter of the component -> its value, 90 % interval and unit.

        Half of the interval: 1.645 sqrt((WIDER deviation)^2 + tolerance^2 + (FORM size)^2); of a single run value and deviation are those
        of least squares (`intervals`), which need no factors. Where these two contradict each other (`contradicted`), or the effect may be
        nothing by least squares and is something by the fit, it is the value of the fit, and the interval reaches to the end of either.
        """
        known, apart = (self.known.get(c.name) if fit is self.best else None), self._apart(c, fit)
        free = known if known and not apart else None
        best = {a: fit.values[a] for a in c.addresses} | dict(free.values if free else {})
        sizes, values = c.sizes(best), physical(best)
        spread = self.spread(c, fit) | dict(free.deviations if free else {})
        # a calibrated number's own tolerance, and what the models are not trusted to, come on top of noise
        half = [1.645 * math.hypot(spread[a], self.tolerance(a)) for a in c.addresses]
        below, above = list(half), list(half)
        for i, a in enumerate(c.addresses):
            if apart and known and a in known.values:
                off, wide = known.values[a] - best[a], 1.645 * math.hypot(known.deviations[a], self.tolerance(a))
                below[i], above[i] = max(half[i], wide - off), max(half[i], wide + off)
        units = [c.unit] * len(half)
        if c.has_phase:  # an error across the amplitude turns it
            most = max(*below, *above)
            below, units = [most, min(most / (sizes[c.addresses[0]] + 1e-300), math.pi)], [c.unit, "rad"]
            above = below
        low, high = (-math.inf, math.inf) if c.has_phase else c.bounds
        listed = {}
        for name, down, up, unit in zip(c.named, below, above, units, strict=True):
            value = values[c.component, name]
            given = self.search.simulator.laboratory.nominal.get((c.component, name))
            listed[name] = Estimate(value, [max(value - down, low), min(value + up, high)], unit, given)
        for (address, value), shape in zip(c.fixed, c.shapes, strict=bool(c.fixed)):
            listed[address[1]] = Estimate(value, [*c.bracket(address)], shape.unit)
        return listed

    def said(self, c: Candidate) -> Mapping[Address, float]:
        """The numbers of an effect of the best model [unit], as `parameters` has them."""
        known = self.known.get(c.name)
        return known.values if known and not self._apart(c, self.best) else self.best.values

    def closes(self, c: Candidate) -> float | None:
        """Part of the gap that an effect closes when all the others are there; None where least squares do not say so."""
        known = self.known.get(c.name)
        return known.closes if known and not self.contradicted(c, self.best) else None

    def spread(self, c: Candidate, fit: Fit) -> dict[Address, float]:
        """Standard deviation [unit] of each number of an effect by the fit, with what its law may be off."""
        sizes = c.sizes(fit.values)
        return {a: math.hypot(WIDER * fit.deviations[a], FORM * sizes[a]) for a in c.addresses}

    def contradicted(self, c: Candidate, fit: Fit) -> bool:
        """Whether least squares, with all of the catalogue free, say something else of an effect than the fit: by 1.645 deviations of both.

        Slopes reach only so far, and in a loop noise comes back as a signal. Then neither the value nor what it closes is known by them.
        """
        wide, spread = self._free(c, fit), self.spread(c, fit)
        return any(abs(self.known[c.name].values[a] - fit.values[a]) > math.hypot(w, 1.645 * spread[a]) for a, w in wide.items())

    def _apart(self, c: Candidate, fit: Fit) -> bool:
        """Whether the value is that of the fit: it is contradicted, or with all of the catalogue free the effect may be nothing."""
        wide, spread = self._free(c, fit), self.spread(c, fit)
        nothing = all(abs(self.known[c.name].values[a]) < w for a, w in wide.items())
        something = any(abs(fit.values[a]) > 1.645 * math.hypot(spread[a], self.tolerance(a)) for a in wide)
        return self.contradicted(c, fit) or (nothing and something)

    def _free(self, c: Candidate, fit: Fit) -> dict[Address, float]:
        """Half of the 90 % intervals [unit] that least squares have of numbers of the best model; of others nothing is known."""
        known = self.known.get(c.name) if fit is self.best else None
        return {a: 1.645 * math.hypot(d, self.tolerance(a)) for a, d in known.deviations.items() if a in c.addresses} if known else {}

    def tolerance(self, address: Address) -> float:
        """Standard deviation to which the nominal value is believed [unit]."""
        return math.hypot(*self.search.evidence.space.alike.get(address, {}).values())
