"""What is missing from a log: the deviation from the nominal simulation is drawn across it, not the signal.

A line across a peak is not what a machine did there. Its deviation from the simulation is as smooth as anything that is known of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.experiment.measured import ALL_APART, Condition
from robomill.diagnosis.experiment.simulation import Simulator
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray


def bridged(simulator: Simulator, groups: Sequence[Sequence[FloatArray]]) -> list[list[FloatArray]]:
    """Measured repeats of every condition, [samples, channels], with the nominal simulation in what is `missing` from them.

    On top of it comes the deviation, linearly between what is there before and after. Where the nominal system cannot run, a repeat stays.
    """
    laboratory, changes = simulator.laboratory, simulator.seeded(())
    found = []
    for i, (condition, group) in enumerate(zip(laboratory.conditions, groups, strict=True)):
        factor, there = laboratory.factor(i), list(group)
        for k, run in enumerate(condition.runs):
            gone = _blocks(missing(condition, run, laboratory.channels), factor)
            if gone.any():
                (nominal,) = simulator.many([(i, changes)], "nominal")
                there[k] = there[k] if nominal is None else _across(there[k], nominal, gone)
        found.append(there)
    return found


def missing(condition: Condition, run: Run, channels: Sequence[str]) -> npt.NDArray[np.bool_]:
    """Which points of the grid lie in a gap of a channel, [n, channels]: no sample is near, and one or more of the log are missing.

    Near is ALL_APART steps, as for stamps that all are off.
    """
    usual = max(float(np.median(np.diff(run.t))), condition.step)
    gone = np.zeros((len(condition.grid), len(channels)), dtype=bool)
    for c, name in enumerate(channels):
        t = run.t[np.isfinite(run.columns[name])] if condition.has(name) else run.t[:0]
        if not len(t):
            continue
        after = np.clip(np.searchsorted(t, condition.grid), min(1, len(t) - 1), len(t) - 1)
        apart = np.minimum(np.abs(condition.grid - t[after - 1]), np.abs(t[after] - condition.grid))
        # half way between samples that follow each other and a single one that is missing
        gone[:, c] = (t[after] - t[after - 1] > 1.5 * usual) & (apart > ALL_APART * condition.step)
    return gone


def _blocks(gone: npt.NDArray[np.bool_], factor: int) -> npt.NDArray[np.bool_]:
    """Which blocks of `factor` points have one that is missing, [blocks, channels]."""
    n = len(gone) // factor
    return np.asarray(gone[: n * factor].reshape(n, factor, -1).any(axis=1))


def _across(x: FloatArray, nominal: FloatArray, gone: npt.NDArray[np.bool_]) -> FloatArray:
    """Measured `x` with the nominal simulation, and the deviation around it, where it is gone; all [samples, channels]."""
    made, rows = x.copy(), np.arange(len(x))
    for c in np.flatnonzero(gone.any(axis=0) & ~gone.all(axis=0)):
        here = gone[:, c]
        deviation = np.interp(rows[here], rows[~here], (x - nominal)[~here, c])
        made[here, c] = nominal[here, c] + deviation
    return made
