"""Whether a model holds in conditions that it was not fitted to: a wrong one that fits a run does not fit the next.

A model with fitted values promises a gain in log score in new conditions: that of its signature there. What it gains is how much
better it predicts the measured runs than the nominal system does. If the model is right the two are equal but for noise; of what only
looks like it in the diagnosed runs, the gain is a part of what was promised, or a loss.

Calibrated numbers may be off there as in the diagnosed runs: within their tolerances, and whoever moves them pays for it. If they were
given as the diagnosed runs have them, the nominal system would bring along for nothing what it has to move there in place of the effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robomill.diagnosis.catalogue import Address
from robomill.diagnosis.experiment.simulation import setting
from robomill.diagnosis.inference.estimation import Space
from robomill.diagnosis.inference.evidence import gather
from robomill.diagnosis.inference.search import POLISH, Search
from robomill.diagnosis.inference.sensitivities import NOMINAL, TOLERANCES, changed
from robomill.orchestration.slaves.protocol import FloatArray

TELLING = 20.0
"""Promised gain [nats] from which having it says that a model is right: it scatters by the root of twice the promise."""
HOLDS = 0.6
"""Part of the promised gain that a model must have, if that is not chance."""
CHANCE = 3.0
"""Deviations by which the gain of a right model may be short of the promise."""
SURPLUS, BY_FAR = 2.0, 8.0
"""The promise is exceeded by something else that grows there, not by another effect beside: as a factor and in deviations."""


@dataclass(frozen=True)
class Transfer:
    """What a model is worth in new conditions."""

    before: float
    after: float
    """Energy that the nominal system, and that the model leaves there, over that of noise."""
    gain: float
    promised: float
    """What the model gains against the nominal system, and what it would if it were right [nats]."""
    doubt: float = 0.0
    """Deviation of the fitted values, relative to them."""

    @property
    def tells(self) -> bool:
        """Whether a model that holds is right there: not if the effect would hardly show."""
        return self.promised > TELLING

    @property
    def holds(self) -> bool:
        """Whether the model is worth there what it promised, or may be but for chance."""
        # of noise, and of the fitted values: the promise goes with their square
        deviation = math.hypot(math.sqrt(2.0 * max(self.promised, 0.0)), 2.0 * self.doubt * self.promised)
        short = self.gain < HOLDS * self.promised and self.promised - self.gain > CHANCE * deviation
        beyond = self.gain > SURPLUS * self.promised and self.gain - self.promised > BY_FAR * deviation
        return not short and not beyond


def transfer(search: Search, groups: Sequence[Sequence[FloatArray]], values: Mapping[Address, float], doubt: float) -> Transfer | None:
    """Of the model with these values; None where there is no new condition, or the system cannot run there.

    `groups`: measured repeats of every condition of the laboratory, those that were diagnosed first; repeats of these that were
    held out are not used. `doubt`: part by which what the model does may be too large or too small.
    """
    simulator = search.simulator
    conditions = simulator.laboratory.conditions
    diagnosed = len(search.groups)
    names = [c.name for c in conditions]
    every = [i for i, name in enumerate(names) if i >= diagnosed and name not in names[:diagnosed]]
    if not every:
        return None
    nominals = simulator.repeated(every, (), NOMINAL, "new conditions")
    there = simulator.repeated(every, setting(values), POLISH, "new conditions")
    sizes = {n.address: TOLERANCES * n.scale for n in search.nuisances}
    plain = [n for n in nominals if n is not None]
    if len(plain) < len(every) or any(t is None for t in there):
        return None
    changes = changed(simulator, every, sizes, plain, "new conditions")
    scales = {n.address: n.scale for n in search.nuisances}
    measured = [groups[i] for i in every]
    e = gather(simulator.laboratory, [names[i] for i in every], measured, plain, changes, sizes, {}, scales, like=search.evidence)
    signature = e.mean_signature(there)
    assert signature is not None
    space = e.space
    before, after = _energy(space, space.y, None), _energy(space, space.y - signature, doubt * signature)
    noise = float(e.expected.sum())
    return Transfer(before / noise, after / noise, 0.5 * (before - after), 0.5 * _energy(space, signature, None), doubt)


def _energy(space: Space, left: FloatArray, unsure: FloatArray | None) -> float:
    """Of a residual, with one more nuisance."""
    energy = float(space.dot(left, left))
    if unsure is None:
        return energy
    product = float(space.dot(left, unsure))
    return energy - product * product / (1.0 + float(space.dot(unsure, unsure)))
