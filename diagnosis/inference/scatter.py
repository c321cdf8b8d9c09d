"""What repeats scatter for a while in several arrays, and good machines do not: the mark of something that differs from run to run.

In the mean over repeats it nearly vanishes, and their scatter would be taken for noise. But noise of a device is there all the time, and
what a simulation with other noise scatters is known. A correction that is lost now and then, or a cutter that every start of the spindle
finds at another angle, is seen where something changes, and in all arrays behind it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.inference.noise import SPELL
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.inference.visibility import SHOWS
from robomill.orchestration.slaves.protocol import FloatArray


@dataclass(frozen=True)
class Spell:
    """A while in which repeats scatter more than those of a good machine."""

    channel: str
    """The channel that scatters most."""
    condition: str
    """Its condition."""
    span: tuple[float, float]
    """From when to when [s]."""
    times: float
    """Scatter of the array that scatters second most over what it may, standard deviations."""


def spell(search: Search) -> Spell | None:
    """The while in which two arrays scatter most over what they may, if that is SHOWS times it or more; None where there is none.

    Only of conditions that were measured three times or more, as time series, and simulated with different noise: what two runs differ by
    is one number, which chance makes large in some spell. What is judged is the second array: what one device does alone is its noise.
    """
    e, laboratory = search.evidence, search.simulator.laboratory
    names = [c for c, on in zip(laboratory.channels, e.active, strict=True) if on]
    found: Spell | None = None
    for i, (condition, runs) in enumerate(zip(e.space.blocks, search.groups, strict=True)):
        freedom = min(len(runs), len(e.nominals[i])) - 1
        if e.independent[i] or freedom <= 1:
            continue
        rows = max(1, round(SPELL / e.decimation))
        edges = np.linspace(0, len(runs[0]), max(1, len(runs[0]) // rows) + 1).astype(int)
        over = excess([x[:, e.active] for x in runs], e.nominals[i], e.discrepancy, edges) * (e.judged & e.there[i])
        arrays = np.stack([over[:, e.arrays == a].max(axis=1) for a in np.unique(e.arrays)], axis=1)
        if arrays.shape[1] <= 1:
            continue
        second = np.sort(arrays, axis=1)[:, -2]
        k = int(second.argmax())
        times = float(np.sqrt(second[k]))
        if times >= SHOWS and (found is None or times > found.times):
            begin, end = (float(laboratory.conditions[i].grid[0] + e.decimation * laboratory.system.step * j) for j in edges[k : k + 2])
            found = Spell(names[int(over[k].argmax())], condition, (begin, end), times)
    return found


def excess(runs: Sequence[FloatArray], simulated: Sequence[FloatArray], discrepancy: FloatArray, edges: npt.NDArray[np.int_]) -> FloatArray:
    """Variance of repeats over what it may be, by spell and channel: [spells, channels].

    `runs`, `simulated`: [samples, channels] each; `edges`: first samples of the spells, and the end of the last one. It may be that of the
    usual spell (median), which noise has all the time, with that of the simulated repeats in this spell and the square of the `discrepancy`
    [channels] of two formulations.
    """
    measured, known = (_variance(x, edges) for x in (runs, simulated))
    return np.asarray(measured / (np.median(measured, axis=0) + known + discrepancy**2 + 1e-300))


def _variance(runs: Sequence[FloatArray], edges: npt.NDArray[np.int_]) -> FloatArray:
    """Variance of repeats in each spell, [spells, channels]."""
    variance = np.stack(runs).var(axis=0, ddof=1)
    return np.stack([variance[a:b].mean(axis=0) for a, b in itertools.pairwise(edges)])
