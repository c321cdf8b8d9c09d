"""From fits to the answer: the verdict, and all that belongs to it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import combinations
from typing import Any

import numpy as np

from robomill.diagnosis.catalogue import LOGGING, Address, Candidate, physical
from robomill.diagnosis.experiment.repeats import as_share
from robomill.diagnosis.experiment.simulation import Laboratory, Simulator, setting
from robomill.diagnosis.gate import checks as gate
from robomill.diagnosis.inference import isolability
from robomill.diagnosis.inference.estimation import Fit, probabilities
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.inference.time_varying import changing
from robomill.diagnosis.inference.transfer import Transfer, transfer
from robomill.diagnosis.localisation.replay_attribution import intervals
from robomill.diagnosis.localisation.where import combined, direction_of, located
from robomill.diagnosis.outcome import next_run
from robomill.diagnosis.outcome.answer import Diagnosis, Menu, curves_of, effort_of, result_of, titles_of
from robomill.diagnosis.outcome.how_far import CLOSING, how_far, metrics
from robomill.diagnosis.outcome.verdict import IDENTIFIED, changes, judged, over_noise, stands, unexplained
from robomill.orchestration.slaves.protocol import FloatArray

ELSE = 0.03
"""Probability that an answer is of no model that was looked at: part of the clear answers that are wrong."""
SAID = {
    "lag": "the clock of the {place} is late by {value:.1f} {unit}",
    "smooth": "the {place} was filtered before it was logged, with a time constant of {value:.1f} {unit}",
    "gain": "the {place} is too large by {value:.4g}",
    "offset": "the {place} is off by {value:.4g} {unit}",
}
"""What is wrong with the log, in words."""
FAULTS = {"smooth": "filter", "gain": "unit"}
"""Kinds of findings, where they are called otherwise than what is wrong with the log."""
WIDER, BIAS = 1.25, 0.04
"""Factor on the deviation of a fit, and part of the value that the form of an effect may put it off, in intervals."""
LISTED = 0.01
"""Probability from which a candidate is listed."""


class Conclusion:
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
        self.titles = titles_of(search.catalogue.titles, laboratory.ports)
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
        # what a dead time of the machine explains nearly as well is no reason to refuse the log
        clocks = [c for c in self.best.model if c.component == LOGGING and marginal[c] >= IDENTIFIED]
        moved = self.transfer() if self.best.model and not clocks else None
        other = changing(search)
        faulty = bool(clocks) and not self.repair
        verdict = judged(search, nominal, self.best, float(self.weights[0]), moved, other, marginal, faulty)
        for c in clocks:
            value, (kind, _, pattern) = self.best.values[c.addresses[0]], c.parameters[0].partition(" ")
            text = SAID[kind].format(
                place=c.location, value=1e3 * value if c.unit == "s" else value, unit="ms" if c.unit == "s" else c.unit
            )
            self.findings.append(gate.Finding(pattern, FAULTS.get(kind, kind), value, c.unit, text, not self.repair, self.repair))
        result = result_of(verdict, self.findings)
        self.pairs = isolability.pairs(self.fits, [c for c, p in marginal.items() if p >= LISTED], self.search.evidence.space)
        result["isolability"] = [
            {"pair": [p.one.name, p.other.name], "distance": p.distance, "confusable": p.confusable} for p in self.pairs
        ]
        result["gap"] = {
            "before": before,
            "within_calibration": min(max(before - calibrated, 0.0), max(before, 0.0)),
            "after": after,
            "noise": noise,
            "unexplained": min(unexplained(over_noise(search, nominal), over_noise(search, self.best)), 1.0),
            "noise_is_a_guess": self.search.evidence.whitening.guessed,
        }
        if moved is not None:
            result["transfer"] = {**asdict(moved), "stands": stands(moved)}
        adopted = physical(self.best.values) if verdict in ("identified", "ambiguous", "unknown") else {}
        if verdict == "none":
            result["smallest_visible"] = self.smallest()
            result["which"] = self.which(marginal)
            result["probability_none"] = (1.0 - ELSE) * float(self.weights[0])
        else:
            result["which"] = self.which(marginal)
            found = located(self.laboratory, self.n, self.search.catalogue, self.search.nuisances, self.figures(), self.menu.projections)
            result |= found | {"where": combined(verdict, self.where(), found["where"])}
            result["how_far"] = how_far(self.search, self.groups, adopted, self.titles) if adopted else []
            result["next_run"] = self.next_run(verdict) if verdict in ("identified", "ambiguous", "unknown") else None
            result["predictive"] = {f.name: f.predictive for f in self.fits if f.predictive}
        if verdict == "unknown":
            first = result["where"][0] if found["where"] else {}
            result["unknown"] = self.describe() | {k: first[k] for k in ("component", "direction", "regime") if first}
            if other is not None and changes(search, self.best, other):
                result["unknown"]["changes"] = {"like": other.candidate.name, "how": other.how, "gain": other.by_change}
                # the replay knows only effects that do not change
                if first and all(other.candidate.component not in (w["component"], *w["alternatives"]) for w in found["where"]):
                    first["alternatives"] = [*first["alternatives"], other.candidate.component]
        result["effort"] = effort_of(self.began, self.simulator)
        channels, ports = tuple(self.laboratory.channels), self.laboratory.ports
        return Diagnosis(result, adopted, tuple(self.fits), channels, self.curves(adopted), ports, self.titles)

    def transfer(self) -> Transfer | None:
        """What the best model is worth in conditions that were held out."""
        fit = self.best
        sizes = {a: size for c in fit.model for a, size in c.sizes(fit.values).items()}
        doubt = max(math.hypot(BIAS, WIDER * fit.deviations[a] / (size + 1e-300)) for a, size in sizes.items())
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
            listed.append(
                {
                    "effect": c.effect,
                    "component": c.component,
                    "location": c.location,
                    "probability": p,
                    "parameters": self.parameters(c, fit),
                    "confusable_with": sets.get(c.name, []),
                }
            )
        return listed

    def parameters(self, c: Candidate, fit: Fit) -> dict[str, dict[str, Any]]:
        """Values with their intervals, by the parameters of the component."""
        sizes, values = c.sizes(fit.values), physical({a: fit.values[a] for a in c.addresses})
        # a calibrated number's own tolerance, and what the models are not trusted to, come on top of noise
        half = [1.645 * math.hypot(WIDER * fit.deviations[a], self.tolerance(a), BIAS * sizes[a]) for a in c.addresses]
        units = [c.unit] * len(half)
        if c.has_phase:  # an error across the amplitude turns it
            half, units = [max(half), min(max(half) / (sizes[c.addresses[0]] + 1e-300), math.pi)], [c.unit, "rad"]
        listed = {}
        for name, h, unit in zip(c.named, half, units, strict=True):
            value = values[c.component, name]
            listed[name] = {"value": value, "interval": [value - h, value + h], "unit": unit}
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
                kept[subset] = 1.0 - self.search.gap(trial, calibrated=False)[0] / before if before > 0.0 else 0.0
        shares = []
        for part in parts:
            rest = [p for p in parts if p != part]
            value = 0.0
            for size in range(len(rest) + 1):
                weight = math.factorial(size) * math.factorial(len(parts) - size - 1) / math.factorial(len(parts))
                for subset in combinations(rest, size):
                    joined = tuple(p for p in parts if p in subset or p == part)
                    value += weight * (kept[joined] - kept[subset])
            half = 1.645 * noise / before if before > 0.0 else 1.0
            here = [c for c in self.best.model if c.component == part]
            shares.append(
                {
                    "component": part,
                    "share": as_share(value),
                    "interval": [as_share(value - half), as_share(value + half)],
                    "location": ", ".join(dict.fromkeys(c.location for c in here)),
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

    def figures(self) -> dict[str, FloatArray]:
        """Weights of the channels in each figure."""
        every = np.arange(len(self.laboratory.channels))
        return {name: np.isin(every, members).astype(np.float64) for name, members in metrics(self.search, self.titles).items()}

    def smallest(self) -> list[dict[str, Any]]:
        """What would have been seen: 5 deviations of the fit, by candidate."""
        listed = []
        for f in self.search.screened:
            c = f.model[0]
            deviations = dict(zip(c.parameters, (f.deviations[a] for a in c.addresses), strict=True))
            if c.has_phase:
                deviations = {c.named[0]: max(deviations.values())}
            for name, deviation in deviations.items():
                listed.append({"effect": c.effect, "location": c.location, "parameter": name, "value": 5.0 * deviation, "unit": c.unit})
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
        return curves_of(self.laboratory, self.groups, before, after)
