"""The number of the model that does most, of those that the catalogue lacks (`numbers.lacking`): by itself, or beside effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.experiment.simulation import setting
from robomill.diagnosis.inference.estimation import SAME_SIGNATURE, Fit
from robomill.diagnosis.inference.fitting import evidence_of
from robomill.diagnosis.inference.priors import log_priors
from robomill.diagnosis.inference.search import SINGLES, Search
from robomill.diagnosis.inference.sensitivities import cosine, gain
from robomill.orchestration.slaves.protocol import FloatArray


def single(
    search: Search, numbers: Sequence[Candidate], known: Sequence[Fit], beside: Sequence[Fit] = (), tries: int = SINGLES
) -> Fit | None:
    """The likeliest model of one of the `numbers`, by evidence and prior, in the terms of the search; None where none is large enough.

    All are simulated once in each condition. Fitted are those SINGLES that take most away by themselves as they are slopes; with models
    `beside`, the likeliest in addition to one of these, so many `tries`. A number that does no more than an effect of its component is
    none, where that has the same slope, or does the same in a model that is `known`. The effect is tried from where the number is, too: its
    own fit may have ended elsewhere.
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

    ranked = sorted(numbers, key=takes, reverse=True)
    columns = {c: column for c in (ranked if beside else ranked[:SINGLES]) if (column := does(c)) is not None}
    if not columns:
        return None
    other, bases = search.of(columns), beside or [search.nominal()]
    grown = sorted(other.linear_fits(bases), key=evidence_of, reverse=True)
    fits = _fitted(other, grown[:tries] if beside else grown)
    fits = [f for f in fits if f.large_enough()]
    alike = {f.model[-1]: _alike(search, f.model[-1], columns[f.model[-1]]) for f in fits}
    wanted = {frozenset((*f.model[:-1], x)) for f in fits for x in alike[f.model[-1]]}
    asked = _fitted(search, [g for g in search.linear_fits(bases) if frozenset(g.model) in wanted]) if wanted else []

    def does_more(f: Fit) -> bool:
        *rest, number = f.model
        same = [g for g in asked if any(set(g.model) == {*rest, x} for x in alike[number])]
        if not rest:
            same += [g for g in known if len(g.model) == 1 and g.model[0].component == number.component and not _told(search, f, g)]
        if any(f.log_evidence <= g.log_evidence + search.growth for g in same):
            return False
        near = (_in_place(search, f, x, columns[number]) for x in alike[number] if len(x.addresses) == 1)
        return all(g is None or f.log_evidence > g.log_evidence + search.growth for g in near)

    def likely(f: Fit) -> float:
        return f.log_evidence + log_prior(f, search, numbers)

    return next((f for f in sorted(filter(does_more, fits), key=likely, reverse=True) if not _contradicted(search, f)), None)


def log_prior(fit: Fit, search: Search, numbers: Sequence[Candidate]) -> float:
    """Log of the probability before the data of a model whose last member is one of the `numbers`: the others are as likely without it."""
    *rest, number = fit.model
    own = log_priors([(number,)], numbers)[0]
    return own + log_priors([tuple(rest)], search.candidates)[0] if rest else own


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


def _in_place(search: Search, fit: Fit, effect: Candidate, column: FloatArray) -> Fit | None:
    """The fit with an effect in place of its last member, a number whose slope is `column` [n], near where that is."""
    *rest, number = fit.model
    (of_number,), (address,) = number.addresses, effect.addresses
    own = search.evidence.sensitivities[address]
    per = float(column @ own) / float(own @ own) * effect.prior.scale / number.prior.scale
    value, deviation = per * fit.values[of_number], abs(per) * fit.deviations[of_number]
    if not min(effect.bounds) <= value <= max(effect.bounds):
        return None
    values = {a: v for a, v in fit.values.items() if a != of_number} | {address: value}
    return search.fitted((*rest, effect), values, {**fit.deviations, address: deviation})


def _same(one: FloatArray, other: FloatArray) -> bool:
    """Whether two changes [n] have the same direction."""
    return abs(cosine(one, other)) > SAME_SIGNATURE


def _told(search: Search, one: Fit, other: Fit) -> bool:
    """Whether two models do something else in these runs: by more than a standard deviation of noise."""
    if one.signature is None or other.signature is None:
        return True
    return search.evidence.space.square(one.signature - other.signature) > 1.0


def _fitted(search: Search, chosen: Sequence[Fit]) -> list[Fit]:
    """Models as simulations have them."""
    return search.sharpened(search.polish(search.refine(chosen), chosen)) if chosen else []
