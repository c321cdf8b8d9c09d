"""The number of the model that does most by itself, of those that the catalogue lacks (`numbers.lacking`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.experiment.simulation import setting
from robomill.diagnosis.inference.estimation import SAME_SIGNATURE, Fit
from robomill.diagnosis.inference.fitting import evidence_of
from robomill.diagnosis.inference.search import SINGLES, Search
from robomill.diagnosis.inference.sensitivities import cosine, gain
from robomill.orchestration.slaves.protocol import FloatArray


def single(search: Search, numbers: Sequence[Candidate], known: Sequence[Fit]) -> Fit | None:
    """The model of one of the `numbers` that has the largest evidence, in the terms of the search; None where none is large enough.

    All are simulated once in each condition, and fitted are those SINGLES that take most away as they are slopes. A number that does no
    more than an effect of its component is none, where that has the same slope, or does the same in a model that is `known`.
    """
    simulator, space, conditions = search.simulator, search.evidence.space, range(len(search.groups))

    def does(c: Candidate) -> FloatArray | None:
        changes = simulator.seeded(setting(dict.fromkeys(c.addresses, c.prior.scale)))
        return search.evidence.signature(simulator.many([(i, changes) for i in conditions], "numbers of the model"))

    def takes(c: Candidate) -> float:
        column = does(c)
        if column is None:
            return 0.0
        (address,) = c.addresses
        space.find_alike({address: column}, {address: c.prior.scale})
        return gain(space.without([address]), column, c)

    ranked = sorted(numbers, key=takes, reverse=True)[:SINGLES]
    columns = {c: column for c in ranked if (column := does(c)) is not None}
    if not columns:
        return None
    fits = [f for f in _fitted(search.of(columns)) if f.large_enough()]
    alike = {c: _alike(search, c, column) for c, column in columns.items()}
    asked = {f.model[0]: f for f in _fitted(search, {effect for f in fits for effect in alike[f.model[0]]})}

    alone = [f for f in known if len(f.model) == 1 and f.signature is not None]

    def does_more(f: Fit) -> bool:
        (number,) = f.model
        same = [asked[x] for x in alike[number] if x in asked]
        same += [g for g in alone if g.model[0].component == number.component and _same(f.signature, g.signature)]
        return all(f.log_evidence > g.log_evidence + search.growth for g in same)

    return next((f for f in sorted(filter(does_more, fits), key=evidence_of, reverse=True) if not _contradicted(search, f)), None)


def _contradicted(search: Search, fit: Fit) -> bool:
    """Whether a measured channel that no effect changes, and that a fit has no part in, is likelier to be as it is without the model.

    Half the squares that the model adds there, over those of what the nominal system leaves, are log odds against it [nats].
    """
    simulator, aside = search.simulator, ~search.evidence.active
    against = 0.0
    for i, group in enumerate(search.groups):
        with_it, nominal = simulator.many([(i, simulator.seeded(setting(values))) for values in (fit.values, {})])
        if with_it is None or nominal is None:
            return True
        on = aside & simulator.laboratory.there(simulator.laboratory.conditions[i].name)
        left, more = (np.mean(group, axis=0) - nominal)[:, on], (with_it - nominal)[:, on]
        usual = (left**2).mean(axis=0) + np.finfo(float).eps * (nominal[:, on] ** 2).mean(axis=0) + np.finfo(float).tiny
        against += 0.5 * float(((more**2 - 2.0 * more * left).sum(axis=0) / usual).sum())
    return against > search.growth


def _alike(search: Search, c: Candidate, column: FloatArray) -> list[Candidate]:
    """Effects of the component of a number that have its slope, [n]."""
    addresses, known, _ = search.alone
    same = {a for a, one in zip(addresses, known.T, strict=True) if a[0] == c.component and _same(one, column)}
    return [x for x in search.candidates if not same.isdisjoint(x.addresses)]


def _same(one: FloatArray | None, other: FloatArray | None) -> bool:
    """Whether two changes [n] have the same direction."""
    return one is not None and other is not None and abs(cosine(one, other)) > SAME_SIGNATURE


def _fitted(search: Search, some: set[Candidate] | None = None) -> list[Fit]:
    """Models of one candidate each, of all or of `some` of them, that simulations confirm."""
    chosen = [f for f in search.linear_fits([search.nominal()]) if some is None or f.model[0] in some]
    return search.sharpened(search.polish(search.refine(chosen), chosen))
