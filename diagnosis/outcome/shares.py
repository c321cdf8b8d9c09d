"""Which component has how much of the gap, by the effects of the best model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.experiment.repeats import as_share
from robomill.diagnosis.experiment.simulation import setting
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.localisation.replay_attribution import intervals
from robomill.diagnosis.localisation.swap import shapley
from robomill.diagnosis.localisation.where import Where, direction_of
from robomill.orchestration.slaves.protocol import FloatArray


def shares(search: Search, best: Fit) -> list[Where]:
    """Share of each component in the gap, largest first: exact Shapley values of the effects of the best model.

    The worth of a subset of components is 1 - G(their effects) / G(nothing).
    """
    parts = list(dict.fromkeys(c.component for c in best.model))
    before, noise = search.gap(search.nominal(), calibrated=False)

    def closed(members: frozenset[str]) -> FloatArray:
        """Part of the gap that the effects in these components close."""
        values = {a: v for a, v in best.values.items() if a[0] in members}
        signature = search.mean_signature(values) if values else None
        if signature is None or before <= 0.0:
            return np.zeros(())
        trial = Fit((), {}, {}, 0.0, 0.0, signature)
        return np.array(1.0 - search.gap(trial, calibrated=False)[0] / before)

    worth = shapley(parts, closed)
    found = []
    for part in parts:
        value = float(worth[part])
        half = 1.645 * noise / before if before > 0.0 else 1.0
        here = [c for c in best.model if c.component == part]
        interval, location = [as_share(value - half), as_share(value + half)], ", ".join(dict.fromkeys(c.location for c in here))
        strongest, regime = _strongest(search, best, here)
        found.append(Where(part, as_share(value), interval, location, direction_of(strongest), strongest, regime))
    return sorted(found, key=lambda s: -s.share)


def _strongest(search: Search, best: Fit, members: Sequence[Candidate]) -> tuple[str, list[list[float]]]:
    """Channel with the strongest signature, and the times [s] when it is there."""
    values = {a: best.values[a] for c in members for a in c.addresses}
    simulator, laboratory = search.simulator, search.simulator.laboratory
    results = simulator.many([(i, simulator.seeded(setting(values))) for i in range(len(search.groups))], "shares")
    active = search.evidence.active
    names = [c for c, on in zip(laboratory.channels, active, strict=True) if on]
    variance = search.evidence.whitening.deviation**2 + 1e-30
    total, regime = np.zeros(len(names)), []
    for i, r in enumerate(results):
        if r is None:
            continue
        squares = (r[:, active] - search.evidence.nominals[i][0]) ** 2 / (variance + np.median(variance) * 1e-12)
        total += squares.sum(axis=0)
        over = squares.sum(axis=1)
        if i == 0 and over.max() > 0.0:
            regime = intervals(over > 0.1 * over.max(), laboratory.conditions[0].grid, laboratory.decimation)
    return names[int(total.argmax())], regime
