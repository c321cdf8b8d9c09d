"""Phases that differ from run to run: a cutter is clamped once, but every start of the spindle finds it elsewhere.

In the mean of such repeats a periodic effect cancels, and their scatter is no noise. So each run is looked at by itself: its part along
what the effect does in phase and a quarter of a turn ahead. Where the catalogue names the parameter at which a run begins, that is
another one in every run, too, and the effect is looked at from several starts. Where the runs differ by more than noise lets them, they
are brought to phase zero and to the nominal start, with the amplitude that they have in common. What else they differ by stays. That
takes as much evidence as one more effect in a model (GROWTH_GAIN).

What the effect does is half the difference between both signs of its amplitude: what it does to the mean is no part of it. With V these
columns, the parts of run k are (V'WV)^-1 V'W (x_k - mean) plus those of the mean, W one over the variance of the noise per channel; the
evidence that they differ is that of parts ~ N(0, 1) against none, samples counted by `dependence`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import Laboratory, decimate, setting
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.inference.evidence import TRUST, dependence
from robomill.diagnosis.inference.noise import fast
from robomill.diagnosis.inference.search import GROWTH_GAIN, GUESSES
from robomill.diagnosis.inference.sensitivities import OCTANTS
from robomill.orchestration.slaves.protocol import FloatArray, base_name


@dataclass(frozen=True)
class _Turned:
    """One condition: the part of each run along what the effect does, and what that is."""

    parts: FloatArray
    """[runs, 2 starts, channels]; those of an array have the same."""
    columns: FloatArray
    """What the effect does per prior scale, in phase and a quarter of a turn ahead, from each start: [samples, channels, 2 starts]."""
    shown: FloatArray
    """Amplitude in each channel, root mean square over the runs [prior scales]; 0 where runs do not differ."""
    amplitude: float
    """The median of that over the arrays, each as often as its precision."""
    gain: float
    """Evidence [nats] that the parts differ."""


def aligned(laboratory: Laboratory, candidates: Sequence[Candidate], n: int) -> list[Finding]:
    """Bring the runs of all conditions to one phase, effect by effect, where those of the first `n` conditions differ.

    The conditions of the laboratory are replaced; one finding, not fatal, for each effect whose phases differed.
    """
    found = []
    for c in candidates:
        if not c.phase_per_run:
            continue
        known = [_turned(laboratory, i, c) for i in range(n)]
        gain = sum(k.gain for k in known if k is not None)
        if gain < GROWTH_GAIN:
            continue
        sizes = [k.amplitude * c.prior.scale for k in known if k is not None and k.gain > 0.0]
        if min(sizes) > c.maximum or max(sizes) < c.minimum:
            continue  # more than there can be of it, or too little to count: the runs differ by something else
        known += [_turned(laboratory, i, c) for i in range(n, len(laboratory.conditions))]
        laboratory.decimation = _whole_turns(laboratory, [(i, k) for i, k in enumerate(known[:n]) if k is not None])
        laboratory.conditions = [
            x if k is None else _brought(x, k, laboratory.channels) for x, k in zip(laboratory.conditions, known, strict=True)
        ]
        text = f"differs from run to run ({c.effect}, {c.location}): the runs were brought to phase zero"
        found.append(Finding(f"{c.component}.{c.named[1]}", "phase", gain, "1", text, fatal=False, repaired=True))
    return found


def _whole_turns(laboratory: Laboratory, known: Sequence[tuple[int, _Turned]]) -> int:
    """Steps that a sample is the mean over: at most twice as many as so far, the fewest in which what turns is gone but for TRUST.

    Of samples that are no means nothing is gone. Where a part of a turn is left in a mean, what the effect does with its phase and what
    it does to the mean are in one sample, and only the former was brought.
    """
    first = laboratory.decimation
    if first == 1:
        return first

    def left(decimation: int) -> float:
        shares = []
        for i, k in known:
            factor = max(1, round(decimation / first * laboratory.factor(i)))
            means = decimate(k.columns.reshape(len(k.columns), -1), factor).reshape(-1, *k.columns.shape[1:])
            shares.append((means**2).mean(axis=(0, 2)) / ((k.columns**2).mean(axis=(0, 2)) + 1e-300))
        return float(np.median(np.concatenate(shares)))

    tried = {d: left(d) for d in range(first, 2 * first + 1)}
    return next((d for d, share in tried.items() if share <= TRUST**2), min(tried, key=lambda d: tried[d]))


def _turned(laboratory: Laboratory, i: int, c: Candidate) -> _Turned | None:
    """Parts and columns of effect `c` in condition `i`; None where the effect does nothing, or cannot run."""
    condition = laboratory.conditions[i]
    stack = np.stack([condition.matrix(r, laboratory.channels) for r in condition.runs])
    nominal = laboratory.sampled(i, ())
    assert nominal is not None
    arrays = np.unique([base_name(name) for name in laboratory.channels], return_inverse=True)[1]
    mean = stack.mean(axis=0)
    size, turned = 1.0, None
    for _ in range(GUESSES):
        columns = _columns(laboratory, i, c, size)
        if columns is None:
            return None
        turned = _parts(stack - mean, mean - nominal, columns, arrays, dependence(condition.independent))
        if len(stack) > 1 and turned.gain == 0.0:
            break  # nothing differs, whatever its size is
        before, size = size, min(max(turned.amplitude, 0.1), c.bounds[1] / c.prior.scale)
        if abs(size - before) <= TRUST * before:
            break
    return turned


def _columns(laboratory: Laboratory, i: int, c: Candidate, size: float) -> FloatArray | None:
    """What an effect of a size [prior scales] does in condition `i`, as in `_Turned`; None where that is nothing, or it cannot run.

    From three starts it does what it does from any, if that is three harmonics of a turn: of a cutter that runs out, once a turn, and once
    more and once less than the teeth. The mean over starts evenly around a turn is no part of it: it does not turn.
    """
    starts = [2.0 * math.pi * k / OCTANTS for k in range(OCTANTS)] if c.start else [0.0]
    columns = []
    for start in starts:
        begin = {(c.component, c.start): start} if c.start else {}
        for a in c.addresses:
            up, down = (laboratory.sampled(i, setting({**begin, a: sign * size * c.prior.scale})) for sign in (1.0, -1.0))
            if up is None or down is None:
                return None
            columns.append(0.5 * (up - down) / size)
        if not np.any(columns):
            return None
    found = np.stack(columns, axis=-1).reshape(*columns[0].shape, len(starts), len(c.addresses))
    if c.start:
        found = (found - found.mean(axis=-2, keepdims=True))[..., :3, :]
    return found.reshape(*columns[0].shape, -1)


def _parts(deviations: FloatArray, gap: FloatArray, columns: FloatArray, arrays: npt.NDArray[np.intp], worth_one: float) -> _Turned:
    """Parts of each run along the columns, their amplitude, and the evidence [nats] that they differ, array by array.

    `deviations` from the mean run [runs, samples, channels]; `gap`: mean less nominal [samples, channels]; `columns` as in `_Turned`;
    `arrays` [channels]: which array a channel is an element of; `worth_one`: samples that are worth one.
    """
    parts, shown, gain = np.zeros((len(deviations), columns.shape[-1], len(arrays))), np.zeros(len(arrays)), 0.0
    sizes = []
    for array in np.unique(arrays):
        here = arrays == array
        floor = (TRUST * np.sqrt(2.0 * (columns[:, here] ** 2).mean(axis=(0, 2)))) ** 2
        here[here] = floor > 0.0
        if not np.any(here):
            continue
        own, size, precision, more = _of_array(deviations[..., here], gap[:, here], columns[:, here], floor[floor > 0.0], worth_one)
        sizes.append((size, precision))
        if more > 0.0 or len(deviations) == 1:
            parts[..., here], shown[here] = own[..., None], size
            gain += more
    size, precision = np.array(sorted(sizes)).T
    middle = int(np.searchsorted(np.cumsum(precision), 0.5 * precision.sum()))  # what differs in few arrays is something else
    return _Turned(parts, columns, shown, float(size[middle]), gain)


def _of_array(d: FloatArray, gap: FloatArray, a: FloatArray, floor: FloatArray, worth_one: float) -> tuple[FloatArray, float, float, float]:
    """Parts of each run in one array [runs, columns], amplitude [prior scales], its precision, and the evidence that runs differ."""
    runs, one = len(d), np.eye(a.shape[-1])
    freedom = max(runs - 1, 1)

    def products(a: FloatArray, x: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
        weight = 1.0 / ((variance + floor) * worth_one)
        return np.einsum("tcp,tcq,c->pq", a, a, weight), np.einsum("tcp,ktc,c->kp", a, x, weight)

    left, gram = d, one
    own: FloatArray = np.zeros((runs, len(one)))
    for _ in range(GUESSES):  # what the effect does not explain is the noise
        gram, product = products(a, d, (left**2).sum(axis=(0, 1)) / (freedom * d.shape[1]))
        own = np.linalg.solve(gram + one, product.T).T.astype(np.float64)
        left = d - np.einsum("tcp,kp->ktc", a, own)
    gain = 0.5 * float(np.einsum("kp,pq,kq->", own, gram + one, own)) - 0.5 * (runs - 1) * float(np.linalg.slogdet(gram + one)[1])
    precision = float(np.diag(gram).mean())

    def size(of: FloatArray, count: int) -> float:
        """Mean square amplitude; noise has a part along each column, too."""
        return max((float(np.einsum("kp,pq,kq->", of, gram, of)) / count - len(one) / worth_one) / precision, 0.0)

    # phases that are drawn cancel but for one over the root of the runs. Most of what the mean is away from the nominal simulation is of
    # other effects, and most of that is slow: what is fast is noise here
    expected = size(own, freedom) / runs if runs > 1 else 1.0
    if expected > 0.0:
        quick, columns = fast(gap), fast(a.reshape(len(a), -1)).reshape(a.shape)
        around, product = products(columns, quick[None], (quick**2).mean(axis=0))
        own = own + np.linalg.solve(around + one / expected, product[0])
    return own, math.sqrt(size(own, runs)), precision, gain


def _brought(condition: Condition, turned: _Turned, channels: Sequence[str]) -> Condition:
    """The condition with its runs as they would be with phase zero, the nominal start and the amplitude that they have in common."""
    runs = []
    for r, part in zip(condition.runs, turned.parts, strict=True):
        away = turned.columns[..., 0] * turned.shown - np.einsum("tcp,pc->tc", turned.columns, part)
        x = condition.matrix(r, channels) + away
        runs.append(
            replace(
                r,
                t=condition.grid,
                columns={**{c: np.interp(condition.grid, r.t, v) for c, v in r.columns.items()}, **dict(zip(channels, x.T, strict=True))},
            )
        )
    return replace(condition, runs=tuple(runs))
