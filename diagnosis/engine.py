"""The diagnosis: runs and a nominal system in, where / which / how far out."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from robomill.diagnosis.candidates import LOGGING, Address, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.bridging import bridged
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.preparation import prepared
from robomill.diagnosis.experiment.simulation import Report, Simulator, setting
from robomill.diagnosis.experiment.store import Store
from robomill.diagnosis.forms.discovery import discovered, left_in, suspects
from robomill.diagnosis.forms.instead import LITTLE
from robomill.diagnosis.forms.onset import onset_of, stands
from robomill.diagnosis.gate import log_faults, phases
from robomill.diagnosis.gate.checks import Finding, stopped
from robomill.diagnosis.gate.gate import Gate
from robomill.diagnosis.gate.measured_inputs import mistakes, undone
from robomill.diagnosis.inference.adequacy import FALSE_ALARM, LEVEL, MISFIT, UNKNOWN, left_by, unexplained
from robomill.diagnosis.inference.dormant import searched_beside
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.priors import probabilities
from robomill.diagnosis.inference.scatter import with_chance
from robomill.diagnosis.inference.search import Search, likely_count, searched
from robomill.diagnosis.inference.sensitivities import NOMINAL
from robomill.diagnosis.outcome.answer import Answer, Diagnosis, Menu, curves_of, effort_of, titles_of
from robomill.diagnosis.outcome.conclusion import Conclusion
from robomill.diagnosis.outcome.how_far import CLOSING
from robomill.diagnosis.outcome.verdict import at_bound, looks_at, over_noise, right, share_left
from robomill.orchestration.assembly import Resolver
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.parameters import Convert, same_unit_only

EXPLAINABLE = ("constant", *log_faults.KINDS)
"""Kinds of findings that an effect may be the reason of: a clipped channel stands still, a small moment changes its sign with a gain.
They are no fault if the best model does it, and the others but `constant` none if the log is not explained without them."""
DOMINANT = 0.8
"""Share of one channel in a gap that nothing explains from which its other sign is tried."""


def diagnose(
    system: System,
    runs: Sequence[Run],
    catalogue: Catalogue,
    *,
    held_out: Sequence[Run] = (),
    resolver: Resolver | None = None,
    convert: Convert = same_unit_only,
    workers: int = 1,
    report: Report | None = None,
    menu: Menu | None = None,
    repair: bool = False,
    false_alarm: float = FALSE_ALARM,
    store: Store | None = None,
    scheduler: str | None = None,
    form: bool = False,
) -> Diagnosis:
    """Where, which, how far. DataError where the runs do not fit the system; a bad log is an answer, not an error.

    Nothing is fitted to `held_out` runs. They say whether the answer and each of its effects hold there, and the closure is measured on
    them; runs labelled `held_out` count as such. `repair`: a clock that is found to be late is corrected, and the rest is diagnosed.
    `false_alarm`: probability of an effect on a machine that has none. `store` keeps simulations, so
    that a second call after an interruption goes on; the caller removes it when the answer is safe. `scheduler` (tcp://host:port): the
    simulations run on the workers of that Dask cluster instead of `workers` processes. `form`: the form of what is left of the nominal
    system is looked for whatever the verdict, and not only if it is `unknown`.
    """
    return diagnose_campaign(
        Campaign.of(system, runs, held_out),
        catalogue,
        resolver=resolver,
        convert=convert,
        workers=workers,
        report=report,
        menu=menu,
        repair=repair,
        false_alarm=false_alarm,
        store=store,
        scheduler=scheduler,
        form=form,
    )


def diagnose_campaign(
    campaign: Campaign,
    catalogue: Catalogue,
    *,
    resolver: Resolver | None = None,
    convert: Convert = same_unit_only,
    workers: int = 1,
    report: Report | None = None,
    menu: Menu | None = None,
    repair: bool = False,
    false_alarm: float = FALSE_ALARM,
    store: Store | None = None,
    scheduler: str | None = None,
    form: bool = False,
) -> Diagnosis:
    """As `diagnose`, for conditions of several systems that share components by name.

    A component that a system lacks has no effect there; a channel that a condition lacks says nothing there.
    """
    began = time.monotonic()
    start = prepared(campaign, catalogue, resolver, convert)
    laboratory, n, catalogue, nuisances, skipped = start.laboratory, start.n, start.catalogue, start.nuisances, start.skipped
    ports, channels = laboratory.ports, laboratory.channels
    told = [*start.findings, *phases.aligned(laboratory, catalogue.candidates, n)]
    conditions = laboratory.conditions
    with Simulator(laboratory, workers, report, store, scheduler) as simulator:
        simulator.expected = likely_count(catalogue, nuisances, n) + 2 * CLOSING * len(conditions)
        groups = bridged(simulator, laboratory.measured())
        gate = Gate(laboratory, simulator, groups, n, catalogue.candidates, nuisances)
        findings = told + gate.findings()
        fatal = [f for f in findings if f.fatal]
        if all(f.kind in EXPLAINABLE for f in fatal):
            search, fits = searched_beside(catalogue, simulator, groups[:n], nuisances)
            suspected = bool(fatal)
            if suspected:  # is it the machine, after all?
                best = _simulated(search, _best(search, fits))
                machine = _little(search, fits, best) and not any(c.component == LOGGING for c in best.model)
                machine = machine and not at_bound(best.model, best.values)  # it would be larger if it could
                turned = [f for f in fatal if log_faults.keeps_size(f)]
                if machine and turned:
                    machine = not _nominal(search, gate.without(turned), best)
                if machine and _shows(search, best, {f.channel for f in fatal}):
                    findings = told + gate.findings(setting(best.values))
                faults = [f for f in findings if f.fatal and f.kind in log_faults.KINDS]
                tried = log_faults.together(faults)
                mended = next((some for some in tried if _explained(catalogue, search, fits, gate.without(some), nuisances, some)), ())
                kept = "; with that put right, the log is not explained, or no better: it is kept as it is"
                findings = [replace(f, text=f.text + kept, fatal=False) if f in faults and f not in mended else f for f in findings]
                fatal = [f for f in findings if f.fatal]
            if not fatal:
                wrong = _wrong_input(search, fits)
                if wrong is None and not suspected:
                    wrong = _wrong_channel(catalogue, search, fits, groups[:n], nuisances, gate.limits)
                fatal = [wrong] if wrong is not None else []
                findings += fatal
        if fatal:
            curves = curves_of(laboratory, groups, simulator.repeated(range(n), (), NOMINAL))
            answer = Answer("bad_log", tuple(findings), effort=effort_of(began, simulator), skipped=tuple(skipped))
            return Diagnosis(answer, {}, (), tuple(channels), curves, ports, titles_of(catalogue.titles, ports))
        fits = with_chance(search, fits)
        conclusion = Conclusion(
            laboratory, simulator, search, fits, groups, n, findings, menu or Menu(), repair, false_alarm, start.numbers
        )
        answer, adopted = conclusion.answer()
        if answer.verdict in ("identified", "ambiguous", "unknown") and answer.number is None:
            named = answer.verdict != "unknown"
            onset = onset_of(search, conclusion.best if named else None)
            answer = replace(answer, onset=replace(onset, named=named) if onset is not None else None)
        if (answer.verdict == "unknown" and answer.number is None) or form:
            answer = replace(answer, form=discovered(search, groups, suspects(answer, laboratory), conclusion.titles, left_in(answer)))
            if answer.onset is not None and not stands(answer.onset, answer.form):
                answer = replace(answer, onset=None)
        answer = replace(answer, effort=effort_of(began, simulator), skipped=tuple(skipped))
        return Diagnosis(
            answer, _on_top(adopted, laboratory.nominal), tuple(fits), tuple(channels), conclusion.curves(adopted), ports, conclusion.titles
        )


def _on_top(changes: Mapping[Address, float], given: Mapping[Address, float]) -> dict[Address, float]:
    """What parameters are with these changes [unit]; `given`: what they are in the system, where that is not zero."""
    return {a: value + given.get(a, 0.0) for a, value in changes.items()}


def _best(search: Search, fits: Sequence[Fit]) -> Fit:
    """The most likely model."""
    return fits[int(probabilities(fits, search.candidates).argmax())]


def _little(search: Search, fits: Sequence[Fit], best: Fit) -> bool:
    """Whether the best of these models leaves no gap, or LITTLE of that of the nominal one."""
    return over_noise(search, best) < UNKNOWN or share_left(search, fits[0], best) < LITTLE


def _nominal(search: Search, groups: Sequence[Sequence[FloatArray]], best: Fit) -> bool:
    """Whether the nominal system leaves no more of repeats with a fault undone than the `best` model leaves of the log as it is.

    Then the fault alone explains the log, without a number that is fitted. Of several effects that do all of it together, each would have
    to be as large by chance; so no more is asked than a right model leaves (LEVEL). A single effect that does it is one of the catalogue.
    """
    least = LEVEL if len(best.model) > 1 else 0.0
    return max(looks_at(search, search.evidence.residual(groups))) <= max(over_noise(search, best), least)


def _wrong_input(search: Search, fits: Sequence[Fit]) -> Finding | None:
    """The mistake in a measured input without which the nominal system explains most; None where it does not explain enough.

    It does if it leaves LITTLE of the gap: nothing is fitted, and no effect is as large as a wrong sign or unit is. It does, too, if it
    leaves no more than the best model, and no more of the gap than a right model does (MISFIT). Tolerances explain much of a gap that goes
    with a wrong input. So no more than MISFIT is left of its squares without them, and of several mistakes that leaves least. Most of what
    varies in what was measured has to be explained, too: beside an input that is much too large, one that does nothing leaves little.
    """
    gap = over_noise(search, fits[0])
    if gap < UNKNOWN:
        return None
    tried = mistakes(search.simulator.laboratory, len(search.groups))
    ran = [(m, *found) for m in tried if (found := undone(search.simulator, search.groups, m)) is not None]
    if not ran:
        return None
    squares = [float((search.evidence.residual(groups) ** 2).sum()) for _, groups, _ in ran]
    mistake, groups, varies = ran[int(np.argmin(squares))]
    whole, there = (float((y**2).sum()) for y in (search.evidence.space.y, search.evidence.residual(varies)))
    if min(squares) > MISFIT * whole or 2.0 * min(squares) > there:
        return None
    left = max(looks_at(search, search.evidence.residual(groups)))
    explained = left < LITTLE * gap or (left < MISFIT * gap and _nominal(search, groups, _simulated(search, _best(search, fits))))
    return mistake.finding if explained else None


def _wrong_channel(
    catalogue: Catalogue,
    search: Search,
    fits: Sequence[Fit],
    groups: Sequence[Sequence[FloatArray]],
    nuisances: Sequence[Nuisance],
    limits: Mapping[str, tuple[float, float]],
) -> Finding | None:
    """The channel that has nearly all of a gap that nothing explains, if it stands still, or a model explains the log with its sign turned.

    The gate lets a channel rest at an extreme, as a limit does, and sees a wrong sign by the nominal signal: where an effect is
    much larger than that, only both together say so. Twice as little of all that a signal consists of does what a wrong sign does. So
    a gap that effects explain is looked at, too, where the nominal system explains as much with the sign turned.
    """
    best = _best(search, fits)
    explained = over_noise(search, best) < UNKNOWN
    if explained and over_noise(search, fits[0]) < UNKNOWN:  # there is no gap
        return None
    names = [c for c, on in zip(search.simulator.laboratory.channels, search.evidence.active, strict=True) if on]
    gap = search.evidence.space.y
    chi2 = ((gap - search.evidence.space.explained(gap)) ** 2).reshape(-1, len(names)).sum(axis=0)
    if chi2.max() < DOMINANT * chi2.sum():
        return None
    name = names[int(chi2.argmax())]
    sign = np.where(np.array(search.simulator.laboratory.channels) == name, -1.0, 1.0)
    turned = [[sign * x for x in group] for group in groups]
    if explained and not _nominal(search, turned, best):
        return None
    if left_by(over_noise(search, fits[0]), over_noise(search, best)) < 0.0 and (rest := _rest(search, best, groups, name, limits)):
        return Finding(name, "constant", rest, "s", f"stands still for {rest:.3g} s, which nothing explains")
    other = _explained(catalogue, search, fits, turned, nuisances)
    if other is None:
        return None
    return Finding(name, "sign", -1.0, "1", f"has the wrong sign: with the other one, {other.name} explains the log")


def _explained(
    catalogue: Catalogue,
    search: Search,
    fits: Sequence[Fit],
    groups: Sequence[Sequence[FloatArray]],
    nuisances: Sequence[Nuisance],
    faults: Sequence[Finding] = (),
) -> Fit | None:
    """The best model of the log without `faults` (`groups`), if it explains that, and better than the best of the log as it is (`search`).

    It does where it leaves no gap, or LITTLE of one. Faults that keep the size of a signal (`keeps_size`) have a gap of their own, that of
    the log as it is: LITTLE of that may be left, too. Where the log as it is has no model that is likelier right than a stand-in
    (`_right`), as much may be left as a law may be off (MISFIT). A unit that is undone divides whatever is left, so that it has none. A
    fault is believed, too, where the best model of the log without it is likelier right than a stand-in, by what it leaves and by its
    calibrated numbers, and that of the log as it is is not, or shows nothing of it. What a model leaves is what simulations leave. Where
    the noise is a guess, that of a gap is as large as the gap is fast; so what is left has to be less in the noise of the log as it is.
    """
    other, found = searched(catalogue, search.simulator, groups, nuisances)
    best, as_it_is = _simulated(other, _best(other, found)), _simulated(search, _best(search, fits))
    if search.evidence.whitening.guessed and all(map(log_faults.keeps_size, faults)):
        shown = search.mean_signature(best.values)
        if shown is None or max(looks_at(search, search.evidence.residual(groups) - shown)) > over_noise(search, as_it_is):
            return None
    believed = bool(faults) and _right(search, fits, as_it_is) and _shows(search, as_it_is, {f.channel for f in faults})
    if faults and not believed and _right(other, found, best):
        return best
    left, left_with = over_noise(other, best), over_noise(search, as_it_is)
    little = _little(other, found, best)
    if faults and all(map(log_faults.keeps_size, faults)):
        little = little or unexplained(over_noise(search, fits[0]), left) < (LITTLE if believed else MISFIT)
    return best if little and (left < left_with or not best.model) else None


def _right(search: Search, fits: Sequence[Fit], best: Fit) -> bool:
    """Whether the best of these models is likelier right than not, by what it leaves and by its calibrated numbers."""
    return right(search, best, left_by(over_noise(search, fits[0]), over_noise(search, best)))


def _shows(search: Search, best: Fit, channels: Collection[str]) -> bool:
    """Whether a model shows any of what was measured in these channels: it leaves less of them than there is.

    Where a log is much too small, one that does next to nothing explains nearly all of the gap, and nothing of the log.
    """
    names = search.simulator.laboratory.channels
    here = [i for i, name in enumerate(names) if name in channels]
    left, there = np.zeros(len(here)), np.zeros(len(here))
    simulated = search.simulator.repeated(range(len(search.groups)), setting(best.values), NOMINAL, "the log")
    for group, models in zip(search.groups, simulated, strict=True):
        if models is not None:
            mean = np.mean(models, axis=0)
            left += sum((((x - mean)[:, here]) ** 2).sum(axis=0) for x in group)
            there += sum((x[:, here] ** 2).sum(axis=0) for x in group)
    return bool(np.all(left < there))


def _simulated(search: Search, fit: Fit) -> Fit:
    """The fit with the signature [n] that simulations at its values have; as it is where the system cannot run there.

    The last step of a fit goes along slopes. What comes to rest does not turn round there, but its slope does.
    """
    signature = search.mean_signature(fit.values, fit.calibrated)
    return fit if signature is None else replace(fit, signature=signature)


def _rest(search: Search, best: Fit, groups: Sequence[Sequence[FloatArray]], name: str, limits: Mapping[str, tuple[float, float]]) -> float:
    """The shortest time [s] for which a channel stands still in any of the runs, while the best model moves."""
    laboratory = search.simulator.laboratory
    i = laboratory.channels.index(name)
    simulated = search.simulator.repeated(range(len(groups)), setting(best.values), NOMINAL, "the log")
    rests, known = [], [limits[name]] if name in limits else []
    for k, (group, models) in enumerate(zip(groups, simulated, strict=True)):
        if not laboratory.conditions[k].has(name):
            continue
        if models is None:  # at the edge of what can run
            return 0.0
        step = laboratory.conditions[k].step * laboratory.factor(k)
        noise = float(np.std(np.stack(group)[..., i] - np.mean(group, axis=0)[:, i])) if len(group) > 1 else 0.0
        rests += [stopped(x[:, i], np.mean(models, axis=0)[:, i], step, noise, *known) for x in group]
    return min(rests)
