"""Effects that do nothing by themselves: they are looked at beside what else is there.

A wrong coupling of two axes moves no rigid robot under a load; it matters once something gives way. Such an effect has no sensitivity at
the nominal system, but one beside the best model. And beside it all other effects do something else than at the nominal system. So the
search is made again with the dormant effect at its best size. It does nothing to the nominal signals, so that models with it and without
it are compared by the same evidence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robomill.diagnosis.candidates import Address, Candidate, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.simulation import Setting, Simulator, setting
from robomill.diagnosis.inference.estimation import Fit, leave_one_out, quadratic_fit
from robomill.diagnosis.inference.fitting import POLISHED, evidence_of
from robomill.diagnosis.inference.search import GUESSES, Search, searched
from robomill.orchestration.slaves.protocol import FloatArray


class Beside(Simulator):
    """Another simulator, in whose simulations some effects are always there."""

    def __init__(self, simulator: Simulator, always: Mapping[Address, float]) -> None:
        """`always`: address -> value [unit], where a setting has no other."""
        self.laboratory, self._simulator, self._always = simulator.laboratory, simulator, dict(always)

    def many(self, tasks: Sequence[tuple[int, Setting]], what: str = "simulations") -> list[FloatArray | None]:
        """As those of the other simulator."""
        return self._simulator.many([(i, tuple(sorted({**self._always, **dict(changes)}.items()))) for i, changes in tasks], what)


def searched_beside(
    catalogue: Catalogue, simulator: Simulator, groups: Sequence[Sequence[FloatArray]], nuisances: Sequence[Nuisance]
) -> tuple[Search, list[Fit]]:
    """As `searched`; and again with a dormant effect of one number, where the best model is likelier with it than without it.

    Then `Search.candidates` has that effect, too, with its sensitivity beside the best model.
    """
    search, fits = searched(catalogue, simulator, groups, nuisances)
    alone = max(fits, key=evidence_of)
    shown = {a for c in search.candidates for a in c.addresses}
    dormant = [c for c in catalogue.candidates if len(c.parameters) == 1 and c.addresses[0] not in shown] if alone.model else []
    trials = [fit for c in dormant if (fit := _woken(search, alone, c)) is not None]
    if not trials or max(trials, key=evidence_of).log_evidence <= alone.log_evidence:
        return search, fits
    best = max(trials, key=evidence_of)
    c = best.model[-1]
    again, models = search, [alone]
    value = best.values[c.addresses[0]]
    for _ in range(GUESSES):
        before = best
        again, others = searched(catalogue, Beside(simulator, {c.addresses[0]: value}), groups, nuisances)
        again.simulator, again.candidates = simulator, [*again.candidates, c]
        ranked = sorted((f for f in others if f.model), key=evidence_of, reverse=True)[:POLISHED]
        starts = [((*f.model, c), {**f.values, **_of(before.values, c)}, {**f.deviations, **_of(before.deviations, c)}) for f in ranked]
        models = [fit for start in starts if (fit := again.fitted(*start)) is not None and fit.large_enough()]
        if not models:
            return search, fits
        best = max(models, key=evidence_of)
        if set(best.model) == set(before.model) and abs(best.values[c.addresses[0]] - value) < best.deviations[c.addresses[0]]:
            break
        value = best.values[c.addresses[0]]
    without = again.fitted(alone.model, alone.values, alone.deviations)
    fits = [again.nominal(), *models, *([without] if without is not None else [])]
    assert best.sensitivities is not None
    again.evidence.sensitivities[c.addresses[0]] = best.sensitivities[:, -1]
    again.evidence.space.find_alike({c.addresses[0]: best.sensitivities[:, -1]}, {c.addresses[0]: c.prior.scale})
    again.forget()
    for f in sorted(fits[1:], key=evidence_of, reverse=True)[:3]:
        f.predictive = {name: part.predicted for name, part in leave_one_out(f, again.evidence.space).items()}
    return again, fits


def _woken(search: Search, alone: Fit, c: Candidate) -> Fit | None:
    """A model with a dormant effect beside it, by what that does at its prior scale; None where it does nothing."""
    a, n = c.addresses[0], len(search.groups)
    assert alone.signature is not None
    assert alone.sensitivities is not None
    found = []
    for size in (1.0, -1.0) if c.both_signs else (1.0,):
        settings = [setting(alone.values), setting({**alone.values, a: size * c.prior.scale})]
        results = search.simulator.many([(i, search.simulator.seeded(s)) for s in settings for i in range(n)], "dormant effects")
        here, there = (search.evidence.signature(results[k * n : (k + 1) * n]) for k in range(2))
        if here is None or there is None or not np.any(there != here):
            continue
        slopes = np.column_stack([alone.sensitivities, (there - here) / size])
        start = np.array([*(alone.values[b] / m.prior.scale for m in alone.model for b in m.addresses), 0.0])
        found.append(quadratic_fit((*alone.model, c), alone.signature, slopes, start, search.evidence.space, alone.form))
    return max(found, key=evidence_of, default=None)


def _of(numbers: Mapping[Address, float], c: Candidate) -> dict[Address, float]:
    return {a: numbers[a] for a in c.addresses}
