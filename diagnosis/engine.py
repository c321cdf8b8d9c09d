"""The diagnosis: runs and a nominal system in, where / which / how far out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from diagnosis import closure, gate, isolability, next_run
from diagnosis.catalogue import LOGGING, Address, Candidate, Catalogue, Nuisance
from diagnosis.estimation import Fit, probabilities
from diagnosis.localise import Projection
from diagnosis.measured import Condition, DataError, in_units, sort_by_condition
from diagnosis.replay import intervals
from diagnosis.search import NOMINAL, Search, likely_count
from diagnosis.simulation import Laboratory, Report, Setting, Simulator, decimate, setting
from diagnosis.store import Store
from diagnosis.transfer import Transfer, transfer
from diagnosis.verdict import UNKNOWN, asks_new_conditions, judged, over_noise, unexplained
from diagnosis.where import combined, direction_of, located
from orchestration.assembly import Resolver, assemble, run
from orchestration.parameters import Convert, same_unit_only
from orchestration.results import Run
from orchestration.slave import FloatArray, PortData, base_name
from orchestration.system import System

SCHEMA = "robomill-diagnosis/1"
ROWS = 1500
"""Samples that a diagnosis works on, over all conditions: longer logs are averaged in blocks."""
CLOSING = 4
"""Simulations with different noise that the closure is measured with."""
ELSE = 0.03
"""Probability that an answer is of no model that was looked at: part of the clear answers that are wrong."""
SAID = {
    "lag": "the clock of the {place} is late by {value:.1f} {unit}",
    "smooth": "the {place} was filtered before it was logged, with a time constant of {value:.1f} {unit}",
    "gain": "the {place} is too large by {value:.4g}",
    "offset": "the {place} is off by {value:.4g} {unit}",
}
"""What is wrong with the log, in words."""
EXPLAINABLE = ("constant", "unit", "rotation")
"""Kinds of findings that an effect may be the reason of: a clipped channel stands still. They are no fault if the best model does it."""
FAULTS = {"smooth": "filter", "gain": "unit"}
"""Kinds of findings, where they are called otherwise than what is wrong with the log."""
WIDER, BIAS = 1.25, 0.04
"""Factor on the deviation of a fit, and part of the value that the form of an effect may put it off, in intervals."""
LISTED = 0.01
"""Probability from which a candidate is listed."""


@dataclass(frozen=True)
class Menu:
    """What the engine is told about the domain: names for groups of channels, and runs that could be made next."""

    titles: Mapping[str, str] = field(default_factory=dict)
    """array or column -> what people call it."""
    projections: Mapping[str, Projection] = field(default_factory=dict)
    """output -> the coordinates (joints) that its residual is projected on."""
    offers: Callable[[], Mapping[str, next_run.Offer]] = dict
    """Kinds of runs that could be made next; called when they are needed."""


@dataclass(frozen=True)
class Diagnosis:
    """The result as data, and what the report draws."""

    result: dict[str, Any]
    adopted: dict[Address, float]
    fits: tuple[Fit, ...] = ()
    channels: tuple[str, ...] = ()
    curves: Mapping[str, dict[str, FloatArray]] = field(default_factory=dict)
    """condition -> t [samples]; measured (mean of the repeats), nominal, adopted [samples, channels]; spread (standard
    deviation) of the repeats [channels], 0 for a single one. Without `adopted` where nothing was fitted."""


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
    menu: Menu = Menu(),
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
    conditions = [*sort_by_condition(used, system), *sort_by_condition(held, system, held_out=True)]
    n = sum(not c.held_out for c in conditions)
    ports = _ports(system, conditions, resolver, convert, catalogue)
    conditions = [replace(c, runs=tuple(in_units(r, ports, convert) for r in c.runs)) for c in conditions]
    channels = list(ports)
    ranges = {c: (p.minimum, p.maximum) for c, p in ports.items()}
    decimation = max(1, math.ceil(sum(len(c.grid) for c in conditions[:n]) / ROWS))
    nuisances = _nuisances(system, conditions, resolver, convert, catalogue)
    nominal = {u.address: u.nominal for u in nuisances if u.nominal}
    seeds = [a for a in catalogue.seeds if any(c.name == a[0] for c in system.components)]
    laboratory = Laboratory(
        system, conditions, channels, resolver, convert, catalogue.quiet or {}, nominal, decimation, seeds, catalogue.refinement
    )
    groups = [[decimate(c.matrix(r, channels), decimation) for r in c.runs] for c in conditions]
    with Simulator(laboratory, workers, report, store) as simulator:
        simulator.expected = likely_count(catalogue, nuisances, n) + 2 * CLOSING * len(conditions)
        findings = _gate(laboratory, simulator, groups, n, channels, ranges)
        fatal = [f for f in findings if f.fatal]
        if all(f.kind in EXPLAINABLE for f in fatal):
            search = Search(catalogue, simulator, groups[:n], nuisances)
            fits = search.run()
            if fatal:  # is it the machine, after all?
                best = fits[int(probabilities(fits, search.candidates).argmax())]
                if over_noise(search, best) < UNKNOWN and not any(c.component == LOGGING for c in best.model):
                    findings = _gate(laboratory, simulator, groups, n, channels, ranges, setting(best.values))
                    fatal = [f for f in findings if f.fatal]
        if fatal:
            result = _result("bad_log", findings, began, simulator.count)
            curves = _curves(laboratory, groups, simulator.repeated(range(n), (), NOMINAL))
            return Diagnosis(result, {}, channels=tuple(channels), curves=curves)
        return _Conclusion(laboratory, simulator, search, fits, groups, n, findings, menu, repair, began).diagnosis()


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
    """The catalogue's tolerances about the values that the parameters have in the first condition."""
    if not catalogue.tolerances:
        return []
    values: dict[str, dict[str, float]] = {}
    configured = Laboratory(system, conditions, (), resolver, convert, catalogue.quiet or {}).configured(0)
    with assemble(configured, resolver, convert) as assembly:
        for name, slave in assembly.slaves.items():
            starts = {p.name: p.start for p in slave.ports if p.causality == "parameter" and p.type == "real"}
            given = {**starts, **assembly.parameters.get(name, {})}
            values[name] = {k: float(v) for k, v in given.items() if k in starts and isinstance(v, int | float)}
    clocks = [Nuisance(t.address, t.size) for t in catalogue.tolerances if t.address[0] == LOGGING]
    return clocks + [u for t in catalogue.tolerances if t.address[0] in values for u in t.nuisances(values[t.address[0]])]


def _gate(
    laboratory: Laboratory,
    simulator: Simulator,
    groups: Sequence[Sequence[FloatArray]],
    n: int,
    channels: Sequence[str],
    ranges: Mapping[str, tuple[float | None, float | None]],
    changes: Setting = (),
) -> list[gate.Finding]:
    """What is wrong with the log where the system has these changes."""
    found: list[gate.Finding] = []
    step = laboratory.system.step * laboratory.decimation
    base = simulator.repeated(range(n), changes, NOMINAL, "the log")
    for i in range(n):
        condition, group = laboratory.conditions[i], base[i]
        assert group is not None
        simulated = np.mean(group, axis=0)
        noise = np.std(np.stack(groups[i]) - np.mean(groups[i], axis=0), axis=(0, 1)) if len(groups[i]) > 1 else np.zeros(len(channels))
        noise = noise + 1e-9 * np.abs(simulated).max(axis=0)
        for r, x in zip(condition.runs, groups[i], strict=True):
            found += gate.raw(r, channels, ranges)
            found += gate.against_simulation(r, x, simulated, channels, step, noise)
        found += gate.spikes(condition, channels)
        found += gate.repeats(condition, groups[i], channels)
    unique: dict[tuple[str, str], gate.Finding] = {}
    for f in found:
        old = unique.get((f.channel, f.kind))
        if old is None or (f.fatal and not old.fatal):
            unique[f.channel, f.kind] = f
    return list(unique.values())


def _result(verdict: str, findings: Sequence[gate.Finding], began: float, simulations: int) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "verdict": verdict,
        "gate": {"usable": verdict != "bad_log", "findings": [asdict(f) for f in findings]},
        "where": [],
        "which": [],
        "how_far": [],
        "next_run": None,
        "effort": {"seconds": round(time.monotonic() - began, 1), "simulations": simulations},
    }


class _Conclusion:
    """From fits to the answer."""

    def __init__(
        self,
        laboratory: Laboratory,
        simulator: Simulator,
        search: Search,
        fits: list[Fit],
        groups: Sequence[Sequence[FloatArray]],
        n: int,
        findings: list[gate.Finding],
        menu: Menu,
        repair: bool,
        began: float,
    ) -> None:
        self.laboratory, self.simulator, self.search, self.fits, self.groups, self.n = laboratory, simulator, search, fits, groups, n
        self.findings, self.menu, self.repair, self.began = findings, menu, repair, began
        self.weights = probabilities(fits, search.candidates)
        self.best = fits[int(self.weights.argmax())]

    def marginal(self) -> dict[Candidate, float]:
        """Probability of each candidate: of all models that it is in."""
        total: dict[Candidate, float] = {}
        for f, p in zip(self.fits, self.weights, strict=True):
            for c in f.model:
                total[c] = total.get(c, 0.0) + (1.0 - ELSE) * float(p)
        return dict(sorted(total.items(), key=lambda item: -item[1]))

    def diagnosis(self) -> Diagnosis:
        """Verdict, then all that belongs to it."""
        before, noise = self.search.gap(self.fits[0], calibrated=False)
        calibrated, _ = self.search.gap(self.fits[0])
        after, _ = self.search.gap(self.best)
        search, nominal = self.search, self.fits[0]
        marginal = self.marginal()
        clocks = [c for c in self.best.model if c.component == LOGGING and marginal[c] > 0.5]
        moved = self.transfer() if asks_new_conditions(self.best) and not clocks else None
        verdict = judged(search, nominal, self.best, moved, marginal, bool(clocks) and not self.repair)
        for c in clocks:
            value, (kind, _, pattern) = self.best.values[c.addresses[0]], c.parameters[0].partition(" ")
            text = SAID[kind].format(
                place=c.location, value=1e3 * value if c.unit == "s" else value, unit="ms" if c.unit == "s" else c.unit
            )
            self.findings.append(gate.Finding(pattern, FAULTS.get(kind, kind), value, c.unit, text, not self.repair, self.repair))
        result = _result(verdict, self.findings, self.began, 0)
        self.pairs = isolability.pairs(self.fits, [c for c, p in marginal.items() if p >= LISTED], self.search.evidence.space)
        result["isolability"] = [
            {"pair": [p.one.name, p.other.name], "distance": p.distance, "confusable": p.confusable} for p in self.pairs
        ]
        result["gap"] = {
            "before": before,
            "within_calibration": before - calibrated,
            "after": after,
            "noise": noise,
            "unexplained": unexplained(over_noise(search, nominal), over_noise(search, self.best)),
            "noise_is_a_guess": self.search.evidence.whitening.guessed,
        }
        if moved is not None:
            result["transfer"] = asdict(moved)
        adopted = dict(self.best.values) if verdict in ("identified", "ambiguous", "unknown") else {}
        if verdict == "none":
            result["smallest_visible"] = self.smallest()
            result["which"] = self.which(marginal)
            result["probability_none"] = (1.0 - ELSE) * float(self.weights[0])
        else:
            result["which"] = self.which(marginal)
            found = located(self.laboratory, self.n, self.search.catalogue, self.search.nuisances, self.figures(), self.menu.projections)
            result |= found | {"where": combined(verdict, self.where(), found["where"])}
            result["how_far"] = self.how_far(adopted) if adopted else []
            result["next_run"] = self.next_run(verdict) if verdict in ("identified", "ambiguous", "unknown") else None
            result["predictive"] = {f.name: f.predictive for f in self.fits if f.predictive}
        if verdict == "unknown":
            named = {k: result["where"][0][k] for k in ("component", "direction", "regime")} if found["where"] else {}
            result["unknown"] = self.describe() | named
        result["effort"] = {
            "seconds": round(time.monotonic() - self.began, 1),
            "simulations": self.simulator.count,
            "taken_over": self.simulator.found,
        }
        return Diagnosis(result, adopted, tuple(self.fits), tuple(self.laboratory.channels), self.curves(adopted))

    def transfer(self) -> Transfer | None:
        """What the best model is worth in conditions that were held out."""
        fit = self.best
        doubt = max(math.hypot(BIAS, WIDER * fit.deviations[a] / (abs(v) + 1e-300)) for a, v in fit.values.items())
        return transfer(self.search, self.groups, fit.values, min(doubt, 1.0))

    def which(self, marginal: Mapping[Candidate, float]) -> list[dict[str, Any]]:
        """Every candidate above 1 %."""
        listed = []
        sets: dict[str, list[str]] = {}
        for pair in self.pairs:
            if pair.confusable:
                sets.setdefault(pair.one.name, []).append(pair.other.name)
                sets.setdefault(pair.other.name, []).append(pair.one.name)
        for c, p in marginal.items():
            if p < LISTED:
                continue
            fit = max((f for f in self.fits if c in f.model), key=lambda f: float(self.weights[self.fits.index(f)]))
            parameters = {}
            for a, name in zip(c.addresses, c.parameters, strict=True):
                # a calibrated number's own tolerance, and what the models are not trusted to, come on top of noise
                half = 1.645 * math.hypot(WIDER * fit.deviations[a], self.tolerance(a), BIAS * fit.values[a])
                parameters[name] = {"value": fit.values[a], "interval": [fit.values[a] - half, fit.values[a] + half], "unit": c.unit}
            listed.append(
                {
                    "effect": c.effect,
                    "component": c.component,
                    "location": c.location,
                    "probability": p,
                    "parameters": parameters,
                    "confusable_with": sets.get(c.name, []),
                }
            )
        return listed

    def tolerance(self, address: Address) -> float:
        """Standard deviation to which the nominal value is believed [unit]."""
        return math.hypot(*self.search.evidence.space.alike.get(address, {}).values())

    def where(self) -> list[dict[str, Any]]:
        """Share of each component in the gap: exact Shapley values of the effects of the best model, and what remains."""
        parts = list(dict.fromkeys(c.component for c in self.best.model))
        before, noise = self.search.gap(self.fits[0], calibrated=False)
        kept: dict[tuple[str, ...], float] = {(): 0.0}
        for size in range(1, len(parts) + 1):
            for subset in combinations(parts, size):
                values = {a: v for a, v in self.best.values.items() if a[0] in subset}
                signature = self.search.mean_signature(setting(values))
                if signature is None:
                    kept[subset] = 0.0
                    continue
                trial = Fit((), {}, {}, 0.0, 0.0, True, signature, None)
                kept[subset] = 1.0 - self.search.gap(trial, calibrated=False)[0] / before
        shares = []
        for part in parts:
            rest = [p for p in parts if p != part]
            value = 0.0
            for size in range(len(rest) + 1):
                weight = math.factorial(size) * math.factorial(len(parts) - size - 1) / math.factorial(len(parts))
                for subset in combinations(rest, size):
                    joined = tuple(p for p in parts if p in subset or p == part)
                    value += weight * (kept[joined] - kept[subset])
            half = 1.645 * noise / before
            here = [c for c in self.best.model if c.component == part]
            shares.append(
                {
                    "component": part,
                    "share": value,
                    "interval": [value - half, min(value + half, 1.0)],
                    "location": ", ".join(c.location for c in here),
                    **self.local(here),
                }
            )
        return sorted(shares, key=lambda s: -float(str(s["share"])))

    def local(self, members: Sequence[Candidate]) -> dict[str, Any]:
        """Channel with the strongest signature, its direction, and the times when it is there."""
        values = {a: self.best.values[a] for c in members for a in c.addresses}
        results = self.simulator.many([(i, self.simulator.seeded(setting(values))) for i in range(self.n)], "shares")
        active = self.search.evidence.active
        names = [c for c, on in zip(self.laboratory.channels, active, strict=True) if on]
        variance = self.search.evidence.whitening.deviation**2 + 1e-30
        total, regime = np.zeros(len(names)), []
        for i, r in enumerate(results):
            if r is None:
                continue
            energy = (r[:, active] - self.search.evidence.nominals[i][0]) ** 2 / (variance + np.median(variance) * 1e-12)
            total += energy.sum(axis=0)
            over = energy.sum(axis=1)
            if i == 0 and over.max() > 0.0:
                regime = intervals(over > 0.1 * over.max(), self.laboratory.conditions[0].grid, self.laboratory.decimation)
        strongest = names[int(total.argmax())]
        return {"direction": direction_of(strongest), "channel": strongest, "regime": regime}

    def metrics(self) -> dict[str, list[int]]:
        """Arrays of channels that count as one figure."""
        groups: dict[str, list[int]] = {}
        for i, name in enumerate(self.laboratory.channels):
            if self.search.evidence.active[i]:
                groups.setdefault(base_name(name), []).append(i)
        wanted = [g for g in groups if g in self.menu.titles] or list(groups)
        return {g: groups[g] for g in wanted}

    def figures(self) -> dict[str, FloatArray]:
        """Weights of the channels in each figure."""
        every = np.arange(len(self.laboratory.channels))
        return {name: np.isin(every, members).astype(np.float64) for name, members in self.metrics().items()}

    def how_far(self, adopted: Mapping[Address, float]) -> list[dict[str, Any]]:
        """Closure per figure, on the diagnosed runs, held-out repeats and held-out conditions."""
        conditions = self.laboratory.conditions
        changes = setting(adopted)
        after = self.simulator.repeated(range(len(conditions)), changes, CLOSING, "closure")
        before = self.simulator.repeated(range(len(conditions)), (), CLOSING, "closure")
        seen = {c.name: i for i, c in enumerate(conditions[: self.n])}
        kinds: dict[str, list[int]] = {"diagnosed runs": list(range(self.n))}
        for i in range(self.n, len(conditions)):
            kinds.setdefault("held-out repeat" if conditions[i].name in seen else "held-out condition", []).append(i)
        spread = self._spread()
        listed: list[dict[str, Any]] = []
        active = np.flatnonzero(self.search.evidence.active)
        scale = np.zeros(len(self.laboratory.channels))
        floor = np.sqrt(np.diag(self.search.evidence.whitening.factor @ self.search.evidence.whitening.factor.T))
        scale[active] = 1.0 / floor
        for kind, members in kinds.items():
            figures = [("all channels, whitened", "1", active, scale)]
            figures += [(g, self._unit(g), np.array(i), np.ones(len(scale))) for g, i in self.metrics().items()]
            for name, unit, index, weight in figures:
                parts = []
                for i in members:
                    b, a = before[i], after[i]
                    if b is None or a is None:
                        continue
                    others = []
                    if kind == "held-out repeat":
                        k = seen[conditions[i].name]
                        others = [(x * weight)[:, index] for x in self.groups[k]]
                    measured = [(x * weight)[:, index] for x in self.groups[i]]
                    variance = ((spread * weight) ** 2)[index]
                    parts.append(closure.products(measured, _halves(b, weight, index), _halves(a, weight, index), variance, others))
                if parts:
                    title = self.menu.titles.get(name, name)
                    listed.append({"metric": f"{title} rms", "channel": name, "unit": unit, "on": kind, **closure.figures(parts)})
        return listed

    def _unit(self, name: str) -> str:
        return self.laboratory.conditions[0].runs[0].unit(name)

    def _spread(self) -> FloatArray:
        """Standard deviation of a single decimated run about its mean, all channels."""
        spread = np.zeros(len(self.laboratory.channels))
        spread[self.search.evidence.active] = self.search.evidence.whitening.deviation
        return spread

    def smallest(self) -> list[dict[str, Any]]:
        """What would have been seen: 5 deviations of the fit, by candidate."""
        listed = []
        for f in self.search.screened:
            c = f.model[0]
            for a, name in zip(c.addresses, c.parameters, strict=True):
                listed.append(
                    {
                        "effect": c.effect,
                        "location": c.location,
                        "parameter": name,
                        "value": 5.0 * f.deviations[a],
                        "unit": c.unit,
                    }
                )
        return listed

    def next_run(self, verdict: str) -> dict[str, Any] | None:
        """The run on the menu that tells the likely models apart; None where there is only one, or no menu."""
        rivals = next_run.rivals(self.fits, self.weights, self.search, known=verdict != "unknown")
        offers = self.menu.offers() if len(rivals) > 1 else {}
        if not offers:
            return None
        fits, weights = [self.fits[i] for i in rivals], [max(float(self.weights[i]), LISTED) for i in rivals]
        with self.simulator.beside(next_run.laboratory(self.laboratory, offers)) as simulator:
            return next_run.recommend(fits, weights, offers, self.search, simulator)

    def describe(self) -> dict[str, Any]:
        """What is known of an effect that is not in the catalogue: where its energy is."""
        space, search = self.search.evidence.space, self.search
        assert self.best.signature is not None
        names = [c for c, on in zip(self.laboratory.channels, search.evidence.active, strict=True) if on]
        energy = np.zeros(len(names))
        regime: list[list[float]] = []
        for i, (_, block) in enumerate(space.blocks.items()):
            left = (space.y - self.best.signature)[block].reshape(-1, len(names)) ** 2
            energy += left.sum(axis=0)
            if i == 0:
                over = left.sum(axis=1)
                regime = intervals(over > 0.1 * over.max(), self.laboratory.conditions[0].grid, self.laboratory.decimation)
        order = np.argsort(-energy)[:5]
        return {
            "channels": [{"channel": names[k], "share": float(energy[k] / energy.sum())} for k in order],
            "component": names[int(order[0])].partition(".")[0],
            "direction": direction_of(names[int(order[0])]),
            "regime": regime,
            "nearest": self.best.name,
        }

    def curves(self, adopted: Mapping[Address, float]) -> dict[str, dict[str, FloatArray]]:
        """Means over the repeats beside both simulations."""
        everywhere = range(len(self.laboratory.conditions))
        before, after = (self.simulator.repeated(everywhere, changes, CLOSING) for changes in ((), setting(adopted)))
        return _curves(self.laboratory, self.groups, before, after)


def _curves(
    laboratory: Laboratory,
    groups: Sequence[Sequence[FloatArray]],
    nominal: Sequence[Sequence[FloatArray] | None],
    adopted: Sequence[Sequence[FloatArray] | None] = (),
) -> dict[str, dict[str, FloatArray]]:
    """See `Diagnosis.curves`; for as many conditions as were simulated, without those that cannot run."""
    curves = {}
    for i, before in enumerate(nominal):
        after = adopted[i] if adopted else ()
        if before is None or after is None:
            continue
        c, repeats = laboratory.conditions[i], np.stack(groups[i])
        found = curves[f"{c.name}{' (held out)' if c.held_out else ''}"] = {
            "t": decimate(c.grid[:, None], laboratory.decimation)[:, 0],
            "measured": repeats.mean(axis=0),
            "spread": np.sqrt(repeats.var(axis=0, ddof=min(1, len(repeats) - 1)).mean(axis=0)),
            "nominal": np.mean(before, axis=0),
        }
        if after:
            found["adopted"] = np.mean(after, axis=0)
    return curves


def _halves(group: Sequence[FloatArray], weight: FloatArray, index: Any) -> tuple[FloatArray, FloatArray]:
    """Two independent means of simulations (the same one twice where there is only one)."""
    return (np.mean(group[::2], axis=0) * weight)[:, index], (np.mean(group[1::2] or group, axis=0) * weight)[:, index]
