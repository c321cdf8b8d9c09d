"""The diagnosis: runs and a nominal system in, where / which / how far out."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robomill.diagnosis.catalogue import LOGGING, Catalogue, Nuisance
from robomill.diagnosis.experiment.measured import Condition, DataError, in_units, sort_by_condition
from robomill.diagnosis.experiment.simulation import Laboratory, Report, Simulator, decimate, setting
from robomill.diagnosis.experiment.store import Store
from robomill.diagnosis.gate import phases, run_set
from robomill.diagnosis.gate.checks import Finding, stopped
from robomill.diagnosis.gate.gate import Gate
from robomill.diagnosis.inference.estimation import Fit, probabilities
from robomill.diagnosis.inference.search import Search, likely_count, searched
from robomill.diagnosis.inference.sensitivities import NOMINAL
from robomill.diagnosis.outcome.answer import Answer, Diagnosis, Menu, curves_of, effort_of, titles_of
from robomill.diagnosis.outcome.conclusion import Conclusion
from robomill.diagnosis.outcome.how_far import CLOSING
from robomill.diagnosis.outcome.verdict import UNEXPLAINED, UNKNOWN, over_noise, unexplained
from robomill.orchestration.assembly import Resolver, assemble, run
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray, PortData, base_name
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.parameters import Convert, same_unit_only

ROWS = 1500
"""Samples that a diagnosis works on, over all conditions: longer logs are averaged in blocks."""
LITTLE = 0.02
"""Share of what is beyond noise that a model leaves which explains nearly all of a large gap."""
EXPLAINABLE = ("constant", "unit", "sign", "rotation")
"""Kinds of findings that an effect may be the reason of: a clipped channel stands still, a small moment changes its sign with a gain.
They are no fault if the best model does it."""
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
    store: Store | None = None,
) -> Diagnosis:
    """Where, which, how far. DataError where the runs do not fit the system; a bad log is an answer, not an error.

    `held_out` runs are only looked at to see whether the answer holds there, and to measure the closure; runs labelled `held_out`
    count as such. `repair`: a clock that is found to be late is corrected, and the rest is diagnosed. `store` keeps simulations, so
    that a second call after an interruption goes on; the caller removes it when the answer is safe.
    """
    began = time.monotonic()
    held = [*held_out, *(r for r in runs if r.info.get("labels", {}).get("held_out") is True)]
    used = [r for r in runs if not any(r is h for h in held)]
    if not used:
        raise DataError("no run to diagnose: all of them are held out")
    run_set.check_each(used, held)
    conditions = [*sort_by_condition(used, system), *sort_by_condition(held, system, held_out=True)]
    conditions, short = run_set.complete(conditions)
    n = sum(not c.held_out for c in conditions)
    with assemble(Laboratory(system, conditions, ()).configured(0), resolver, convert) as assembly:
        parameters = {name: [p.name for p in slave.ports if p.causality == "parameter"] for name, slave in assembly.slaves.items()}
    catalogue, skipped = catalogue.within(parameters)
    ports = _ports(system, conditions, resolver, convert, catalogue)
    conditions = [replace(c, runs=tuple(in_units(r, ports, convert) for r in c.runs)) for c in conditions]
    channels = list(ports)
    ranges = {c: (p.minimum, p.maximum) for c, p in ports.items()}
    decimation = max(1, math.ceil(sum(len(c.grid) for c in conditions[:n]) / ROWS))
    nuisances = _nuisances(system, conditions, resolver, convert, catalogue)
    nominal = {u.address: u.nominal for u in nuisances if u.nominal}
    laboratory = Laboratory(
        system,
        conditions,
        channels,
        resolver,
        convert,
        catalogue.quiet or {},
        nominal,
        decimation,
        catalogue.seeds,
        catalogue.refinement,
        ports,
    )
    turned = phases.aligned(laboratory, catalogue.candidates, n)
    conditions = list(laboratory.conditions)
    groups = [[decimate(c.matrix(r, channels), decimation) for r in c.runs] for c in conditions]
    with Simulator(laboratory, workers, report, store) as simulator:
        simulator.expected = likely_count(catalogue, nuisances, n) + 2 * CLOSING * len(conditions)
        gate = Gate(laboratory, simulator, groups, n, ranges, {c.component for c in catalogue.candidates}, NOMINAL)
        findings = short + turned + gate.findings()
        fatal = [f for f in findings if f.fatal]
        if all(f.kind in EXPLAINABLE for f in fatal):
            search, fits = searched(catalogue, simulator, groups[:n], nuisances)
            if fatal:  # is it the machine, after all?
                best = _best(search, fits)
                before, after = over_noise(search, fits[0]), over_noise(search, best)
                little = after < UNKNOWN or unexplained(before, after) < LITTLE
                if little and not any(c.component == LOGGING for c in best.model):
                    findings = short + turned + gate.findings(setting(best.values))
                    fatal = [f for f in findings if f.fatal]
            elif (finding := _wrong_channel(catalogue, search, fits, groups[:n], nuisances)) is not None:
                findings.append(finding)
                fatal = [finding]
        if fatal:
            curves = curves_of(laboratory, groups, simulator.repeated(range(n), (), NOMINAL))
            answer = Answer("bad_log", tuple(findings), effort=effort_of(began, simulator), skipped=tuple(skipped))
            return Diagnosis(answer, {}, (), tuple(channels), curves, ports, titles_of(catalogue.titles, ports))
        conclusion = Conclusion(laboratory, simulator, search, fits, groups, n, findings, menu or Menu(), repair)
        answer, adopted = conclusion.answer()
        answer = replace(answer, effort=effort_of(began, simulator), skipped=tuple(skipped))
        return Diagnosis(answer, adopted, tuple(fits), tuple(channels), conclusion.curves(adopted), ports, conclusion.titles)


def _best(search: Search, fits: Sequence[Fit]) -> Fit:
    """The most likely model."""
    return fits[int(probabilities(fits, search.candidates).argmax())]


def _wrong_channel(
    catalogue: Catalogue, search: Search, fits: Sequence[Fit], groups: Sequence[Sequence[FloatArray]], nuisances: Sequence[Nuisance]
) -> Finding | None:
    """The channel that has nearly all of a gap that nothing explains, if it stands still, or a model explains the log with its sign turned.

    The gate lets a channel rest at an extreme, as a limit does, and sees a wrong sign by the nominal signal: where an effect is
    much larger than that, only both together say so.
    """
    best = _best(search, fits)
    if over_noise(search, best) < UNKNOWN:
        return None
    names = [c for c, on in zip(search.simulator.laboratory.channels, search.evidence.active, strict=True) if on]
    gap = search.evidence.space.y
    chi2 = ((gap - search.evidence.space.explained(gap)) ** 2).reshape(-1, len(names)).sum(axis=0)
    if chi2.max() < DOMINANT * chi2.sum():
        return None
    name = names[int(chi2.argmax())]
    if unexplained(over_noise(search, fits[0]), over_noise(search, best)) >= UNEXPLAINED and (rest := _rest(search, best, groups, name)):
        return Finding(name, "constant", rest, "s", f"stands still for {rest:.3g} s, which nothing explains")
    sign = np.where(np.array(search.simulator.laboratory.channels) == name, -1.0, 1.0)
    turned, fits_of_it = searched(catalogue, search.simulator, [[sign * x for x in group] for group in groups], nuisances)
    other = _best(turned, fits_of_it)
    if over_noise(turned, other) >= UNKNOWN and unexplained(over_noise(search, fits[0]), over_noise(turned, other)) >= LITTLE:
        return None
    return Finding(name, "sign", -1.0, "1", f"has the wrong sign: with the other one, {other.name} explains the log")


def _rest(search: Search, best: Fit, groups: Sequence[Sequence[FloatArray]], name: str) -> float:
    """The shortest time [s] for which a channel stands still in any of the runs, while the best model moves."""
    laboratory = search.simulator.laboratory
    i, step = laboratory.channels.index(name), laboratory.system.step * laboratory.decimation
    simulated = search.simulator.repeated(range(len(groups)), setting(best.values), NOMINAL, "the log")
    rests = []
    for group, models in zip(groups, simulated, strict=True):
        if models is None:  # at the edge of what can run
            return 0.0
        noise = float(np.std(np.stack(group)[..., i] - np.mean(group, axis=0)[:, i])) if len(group) > 1 else 0.0
        rests += [stopped(x[:, i], np.mean(models, axis=0)[:, i], step, noise) for x in group]
    return min(rests)


def _ports(
    system: System, conditions: Sequence[Condition], resolver: Resolver | None, convert: Convert, catalogue: Catalogue
) -> dict[str, PortData]:
    """Measured real outputs that the system has too, as the system has them."""
    probe = Laboratory(system, conditions, (), resolver, convert, catalogue.quiet or {})
    step = system.step
    short = Condition("", conditions[0].parameters, conditions[0].runs, np.array([0.0, step]))
    probe.conditions = [short]
    simulated = run(probe.configured(0), None, stop=2 * step, resolver=resolver, convert=convert)
    common = [c for c, p in simulated.ports.items() if p.type == "real" and all(c in r.columns for k in conditions for r in k.runs)]
    if not common:
        has = ", ".join(sorted({base_name(c) for k in conditions for r in k.runs for c in r.columns}))
        outputs = ", ".join(dict.fromkeys(map(base_name, simulated.columns)))
        raise DataError(f"no measured column is an output of the system; measured: {has}; outputs: {outputs}")
    return {c: simulated.ports[c] for c in common}


def _nuisances(
    system: System, conditions: Sequence[Condition], resolver: Resolver | None, convert: Convert, catalogue: Catalogue
) -> list[Nuisance]:
    """The catalogue's tolerances about the values that the parameters have in the first condition; CatalogueError for units that differ."""
    values: dict[str, dict[str, float]] = {}
    configured = Laboratory(system, conditions, (), resolver, convert, catalogue.quiet or {}).configured(0)
    with assemble(configured, resolver, convert) as assembly:
        parameters = [(c, p) for c, slave in assembly.slaves.items() for p in slave.ports if p.causality == "parameter"]
        catalogue.check_units({(c, p.name): p.unit or "1" for c, p in parameters})
        for name, slave in assembly.slaves.items():
            starts = {p.name: p.start for p in slave.ports if p.causality == "parameter" and p.type == "real"}
            given = {**starts, **assembly.parameters.get(name, {})}
            values[name] = {k: float(v) for k, v in given.items() if k in starts and isinstance(v, int | float)}
    clocks = [Nuisance(t.address, t.size) for t in catalogue.tolerances if t.address[0] == LOGGING]
    return clocks + [u for t in catalogue.tolerances if t.address[0] != LOGGING for u in t.nuisances(values[t.address[0]])]
