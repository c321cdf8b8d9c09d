"""Whether a model holds in conditions that it was not fitted to: a wrong one that fits a run does not fit the next.

A model with fitted values has an expected gain in log score in new conditions: <s, s> / 2 of its signature s there. Its gain is how much
better it predicts the measured runs than the nominal system does: (<y, y> - <y - s, y - s>) / 2. If the model is right the two are equal
but for noise; of what only looks like it in the diagnosed runs, the gain is a part of the expected one, or a loss.

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
"""Expected gain [nats] from which having it says that a model is right: the gain scatters by the root of twice that."""
HOLDS = 0.6
"""Part of the expected gain that a model must have, if less is not chance."""
CHANCE = 3.0
"""Deviations by which the gain of a right model may be short of the expected one."""
SURPLUS, BY_FAR = 2.0, 8.0
"""The expected gain is exceeded by something else that grows there, not by another effect beside: as a factor and in deviations."""


@dataclass(frozen=True)
class Transfer:
    """What a model is worth in new conditions, with y the whitened residual there and s the signature of the model."""

    before: float
    after: float
    """chi2 that the nominal system, and that the model leaves there, over that of noise."""
    gain: float
    """What the model gains there against the nominal system [nats], (<y, y> - <y - s, y - s>) / 2, with `doubt` s one more nuisance."""
    expected_gain: float
    """What it would gain if it were right [nats], <s, s> / 2."""
    doubt: float = 0.0
    """Standard deviation of the fitted values, relative to them."""

    @property
    def tells(self) -> bool:
        """Whether a model that holds is right there: not if the effect would hardly show (expected gain up to TELLING)."""
        return self.expected_gain > TELLING

    @property
    def holds(self) -> bool:
        """Whether the model has its expected gain g there, or may have it but for chance: deviation sqrt(2 g + (2 doubt g)^2)."""
        # of noise, and of the fitted values: the expected gain goes with their square
        deviation = math.hypot(math.sqrt(2.0 * max(self.expected_gain, 0.0)), 2.0 * self.doubt * self.expected_gain)
        short = self.gain < HOLDS * self.expected_gain and self.expected_gain - self.gain > CHANCE * deviation
        beyond = self.gain > SURPLUS * self.expected_gain and self.gain - self.expected_gain > BY_FAR * deviation
        return not short and not beyond


def transfer(search: Search, groups: Sequence[Sequence[FloatArray]], values: Mapping[Address, float], doubt: float) -> Transfer | None:
    """What the model with these values [unit] is worth in new conditions; None where there are none, or the system cannot run there.

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
    before, after = _chi2(space, space.y, None), _chi2(space, space.y - signature, doubt * signature)
    noise = float(e.expected.sum())
    return Transfer(before / noise, after / noise, 0.5 * (before - after), 0.5 * _chi2(space, signature, None), doubt)


def _chi2(space: Space, left: FloatArray, unsure: FloatArray | None) -> float:
    """<u, u> of the residual u = `left` [n], with one more nuisance of standard deviation 1, `unsure` [n]."""
    chi2 = float(space.dot(left, left))
    if unsure is None:
        return chi2
    product = float(space.dot(left, unsure))
    return chi2 - product * product / (1.0 + float(space.dot(unsure, unsure)))
