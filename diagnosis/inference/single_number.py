"""The number of the model that does most by itself, of those that the catalogue lacks (`numbers.lacking`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.experiment.simulation import setting
from robomill.diagnosis.inference.estimation import SAME_SIGNATURE, Fit
from robomill.diagnosis.inference.fitting import evidence_of
from robomill.diagnosis.inference.search import SINGLES, Search
from robomill.diagnosis.inference.sensitivities import gain
from robomill.orchestration.slaves.protocol import FloatArray


def single(search: Search, numbers: Sequence[Candidate]) -> Fit | None:
    """The model of one of the `numbers` that has the largest evidence, in the terms of the search; None where none is large enough.

    All are simulated once in each condition, and fitted are those SINGLES that take most away as they are slopes. A number that does the
    same as an effect of its component is none: that has been asked.
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

    columns: dict[Candidate, FloatArray] = {}
    addresses, known, _ = search.alone
    for c in sorted(numbers, key=takes, reverse=True):
        if len(columns) == SINGLES:
            break
        column = does(c)
        own = known[:, [component == c.component for component, _ in addresses]]
        size = np.linalg.norm(own, axis=0)
        if column is not None and not np.any(np.abs(column @ own) > SAME_SIGNATURE * size * np.linalg.norm(column)):
            columns[c] = column
    if not columns:
        return None
    one = search.of(columns)
    chosen = one.linear_fits([one.nominal()])
    fits = [f for f in one.sharpened(one.polish(one.refine(chosen), chosen)) if f.large_enough()]
    return max(fits, key=evidence_of, default=None)
