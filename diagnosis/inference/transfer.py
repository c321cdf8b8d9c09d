"""Whether a model holds in conditions that it was not fitted to: a wrong one that fits a run does not fit the next.

A model with fitted values has an expected gain in log score in new conditions: <s, s> / 2 of its signature s there. Its gain is how much
better it predicts the measured runs than the nominal system does: (<y, y> - <y - s, y - s>) / 2. If the model is right the two are equal
but for noise; of what only looks like it in the diagnosed runs, the gain is a part of the expected one, or a loss.

Calibrated numbers may be off there as in the diagnosed runs: within their tolerances, and whoever moves them pays for it. If they were
given as the diagnosed runs have them, the nominal system would bring along for nothing what it has to move there in place of the effect.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.experiment.simulation import setting
from robomill.diagnosis.inference.adequacy import CONDITIONS, KEEPS, LEVEL, MISFIT, kept, left_by, misfit, worsened
from robomill.diagnosis.inference.estimation import Fit, Space
from robomill.diagnosis.inference.evidence import gather
from robomill.diagnosis.inference.fitting import POLISH, by_slopes
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.inference.sensitivities import NOMINAL, TOLERANCES, changed, interplay
from robomill.orchestration.slaves.protocol import FloatArray


@dataclass(frozen=True)
class Transfer:
    """What a model is worth in new conditions, with y the whitened residual there and s the signature of the model."""

    before: float
    """chi2 of the nominal system there, over that of noise."""
    after: float
    """chi2 that the model leaves there, over that of noise."""
    gain: float
    """What the model gains there against the nominal system [nats], (<y, y> - <y - s, y - s>) / 2, with `doubt` s one more nuisance."""
    expected_gain: float
    """What it would gain if it were right [nats], <s, s> / 2."""
    doubt: float = 0.0
    """Standard deviation of the fitted values, relative to them."""
    amplitude: float = 1.0
    """Factor on s that fits best there."""
    deviation: float = 1.0
    """Standard deviation of the amplitude by noise, tolerances and form."""

    misfit: float = MISFIT
    """Largest mean share that the model leaves where it is right."""
    conditions: int = CONDITIONS
    """How many new conditions there are: `before` and `after` are of the worst one."""
    worse: float = 0.0
    """Log Bayes factor for a right model against a stand-in [nats], from the channel that the model makes worse there (`worsened`)."""

    @property
    def worth(self) -> float:
        """Log Bayes factor for a right model against a stand-in, from new conditions."""
        return kept(self.holds) + self.fails

    @property
    def holds(self) -> float:
        """Log Bayes factor for a right model against a stand-in that does not hold, from the promise and from how little is left."""
        return self.promise + max(self._left, 0.0)

    @property
    def fails(self) -> float:
        """Log Bayes factor for a right model against any stand-in, where too much is left: a right one, and one that holds, leave less."""
        return min(self._left, self.worse, 0.0)

    @property
    def loses(self) -> float:
        """What the log Bayes factor for a right model against any stand-in loses, where more is left or made worse than by a right one.

        It is 0 or less, and that of one more look at the share that the model leaves (`most_left`): what it closes in the diagnosed
        conditions is no merit, where it leaves more in new ones.
        """
        most = left_by(self.before, min(self.after, LEVEL), self.misfit, conditions=self.conditions)
        return min(self._left - most, self.worse, 0.0)

    @property
    def _left(self) -> float:
        return left_by(self.before, self.after, self.misfit, conditions=self.conditions)

    @property
    def promise(self) -> float:
        """Log Bayes factor for a right model against a stand-in that does not hold, from the amplitude a that is found there.

        Right: a ~ N(1, deviation^2 + doubt^2). A stand-in keeps more or less of its promise: a ~ N(1, deviation^2 + doubt^2 + KEEPS^2).
        """
        right = math.hypot(self.deviation, self.doubt)
        other = math.hypot(right, KEEPS)
        return 0.5 * (self.amplitude - 1.0) ** 2 * (other**-2 - right**-2) + math.log(other / right)


def transfer(search: Search, groups: Sequence[Sequence[FloatArray]], fit: Fit, doubt: float) -> Transfer | None:
    """What a model is worth in new conditions; None where there are none, or the system cannot run there.

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
    there = simulator.repeated(every, setting({**fit.values, **fit.calibrated}), POLISH, "new conditions")
    sizes = {n.address: TOLERANCES * n.scale for n in search.nuisances}
    plain = [n for n in nominals if n is not None]
    if len(plain) < len(every) or any(t is None for t in there):
        return None
    changes = changed(simulator, every, sizes, plain, "new conditions")
    scales, doubts = {n.address: n.scale for n in search.nuisances}, {n.address: n.doubt for n in search.nuisances}
    measured = [groups[i] for i in every]
    e = gather(
        simulator.laboratory,
        [names[i] for i in every],
        measured,
        plain,
        changes,
        sizes,
        {},
        scales,
        like=search.evidence,
        doubts=doubts,
        beyond=interplay(simulator, every, scales, sizes, changes, plain, "new conditions"),
    )
    if not e.judged.any():  # without tolerances nothing is known of discrepancies: there is the noise to compare with
        e = replace(e, judged=np.ones_like(e.judged))
    whole, space = e.mean_signature(there), e.space
    assert whole is not None
    signature = whole - by_slopes(search.nuisances, fit.calibrated, space)
    before, after = _chi2(space, space.y, None), _chi2(space, space.y - signature, doubt * signature)
    size = space.square(signature)
    unsure, left = doubt * signature, space.y - signature
    rest = left - unsure * float(space.dot(left, unsure)) / (1.0 + space.square(unsure))
    wide = space.widened(e.form(fit.model[:1], signature, np.zeros((0, 0)), np.zeros(0)))
    seen = wide.square(signature) + 1e-300
    amplitude = float(wide.dot(signature, space.y)) / seen
    levels, gain = (e.level(space.y), e.level(rest)), 0.5 * (before - after)
    worse = worsened(e, space.y, rest, signature)
    return Transfer(*levels, gain, 0.5 * size, doubt, amplitude, seen**-0.5, misfit(fit), len(every), worse)


def _chi2(space: Space, left: FloatArray, unsure: FloatArray | None) -> float:
    """<u, u> of the residual u = `left` [n], with one more nuisance of standard deviation 1, `unsure` [n]."""
    chi2 = space.square(left)
    if unsure is None:
        return chi2
    product = float(space.dot(left, unsure))
    return chi2 - product * product / (1.0 + space.square(unsure))
