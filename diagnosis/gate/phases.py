"""Phases that differ from run to run: a cutter is clamped once, but every start of the spindle finds it elsewhere.

In the mean of such repeats a periodic effect cancels, and their scatter is no noise. So each run is looked at by itself: its part along
the two sensitivities of the effect, in phase and a quarter of a turn ahead, is an amplitude and a phase of its own. Where the phases
differ by more than noise lets them, the runs are brought to phase zero with the amplitude that they have in common. What else they differ
by stays. That takes as much evidence as one more effect in a model (GROWTH_GAIN).

With V the sensitivities of the two parts of the amplitude, the parts of run k are (V'WV)^-1 V'W (x_k - mean) plus those of the mean, W
one over the variance of the noise per channel; the evidence that they differ is that of parts ~ N(0, 1) against none, samples
counted by `dependence`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.catalogue import Candidate
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import Laboratory, setting
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.inference.evidence import TRUST, dependence
from robomill.diagnosis.inference.search import GROWTH_GAIN
from robomill.orchestration.slaves.protocol import FloatArray

PHASE_ROUNDS = 3
"""Rounds in which the noise of each channel, and the amplitude that the sensitivities are simulated at, are found."""


@dataclass(frozen=True)
class _Turned:
    """One condition: the part of each run along the two sensitivities, [runs, 2], and what these sensitivities are."""

    parts: FloatArray
    sensitivities: FloatArray
    """[samples, channels, 2], per prior scale."""
    gain: float
    """Evidence [nats] that the parts differ."""

    @property
    def amplitude(self) -> float:
        """Root mean square over the runs [prior scales]."""
        return float(np.sqrt((self.parts**2).sum(axis=1).mean()))


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
        if any(k.amplitude > c.maximum / c.prior.scale for k in known if k is not None):
            continue  # more than there can be of it: the gap is of something else, interchanged axes for instance
        known += [_turned(laboratory, i, c) for i in range(n, len(laboratory.conditions))]
        laboratory.conditions = [
            x if k is None else _brought(x, k, laboratory.channels) for x, k in zip(laboratory.conditions, known, strict=True)
        ]
        text = f"differs from run to run ({c.effect}, {c.location}): the runs were brought to phase zero"
        found.append(Finding(f"{c.component}.{c.named[1]}", "phase", gain, "1", text, fatal=False, repaired=True))
    return found


def _turned(laboratory: Laboratory, i: int, c: Candidate) -> _Turned | None:
    """Parts and sensitivities of effect `c` in condition `i`; None where the effect does nothing, or cannot run."""
    condition = laboratory.conditions[i]
    stack = np.stack([condition.matrix(r, laboratory.channels) for r in condition.runs])
    nominal = laboratory.sampled(i, ())
    assert nominal is not None
    mean = stack.mean(axis=0)
    size, turned = 1.0, None
    for _ in range(PHASE_ROUNDS):
        changes = [laboratory.sampled(i, setting({a: size * c.prior.scale})) for a in c.addresses]
        sensitivities = np.stack([(x - nominal) / size for x in changes if x is not None], axis=-1)
        if sensitivities.shape[-1:] != (2,) or not np.any(sensitivities):
            return None
        parts, gain = _parts(stack - mean, mean - nominal, sensitivities, dependence(condition.independent))
        turned = _Turned(parts, sensitivities, gain)
        if len(stack) > 1 and gain < 0.0:
            break  # nothing differs, whatever its size is
        size = min(max(turned.amplitude, 0.1), c.bounds[1] / c.prior.scale)
    return turned


def _parts(deviations: FloatArray, gap: FloatArray, sensitivities: FloatArray, worth_one: float) -> tuple[FloatArray, float]:
    """Parts of each run along the sensitivities, [runs, 2], and the evidence [nats] that they differ.

    `deviations` from the mean run [runs, samples, channels]; `gap`: mean less nominal [samples, channels]; `sensitivities`
    [samples, channels, 2]; `worth_one`: samples that are worth one.
    """
    floor = (TRUST * np.sqrt((sensitivities**2).mean(axis=0).sum(axis=-1))) ** 2
    moves = floor > 0.0
    a, d = sensitivities[:, moves], deviations[..., moves]
    freedom = max(len(d) - 1, 1)
    variance = (d**2).sum(axis=(0, 1)) / (freedom * d.shape[1]) + floor[moves]
    own, gram = np.zeros((len(d), 2)), np.eye(2)
    for _ in range(PHASE_ROUNDS):  # what the sensitivities do not explain is the noise
        gram = np.einsum("tcp,tcq,c->pq", a, a, 1.0 / variance)
        own = np.linalg.solve(gram, np.einsum("tcp,ktc,c->pk", a, d, 1.0 / variance)).T
        left = d - np.einsum("tcp,kp->ktc", a, own)
        variance = (left**2).sum(axis=(0, 1)) / (freedom * d.shape[1]) + floor[moves]
    common = np.linalg.solve(gram, np.einsum("tcp,tc,c->p", a, gap[:, moves], 1.0 / variance))
    gain = 0.5 * float(np.einsum("kp,pq,kq->", own, gram, own)) / worth_one
    return common + own, gain - 0.5 * (len(d) - 1) * float(np.linalg.slogdet(np.eye(2) + gram / worth_one)[1])


def _brought(condition: Condition, turned: _Turned, channels: Sequence[str]) -> Condition:
    """The condition with its runs as they would be with phase zero and the amplitude that they have in common."""
    target = np.array([turned.amplitude, 0.0])
    runs = []
    for r, part in zip(condition.runs, turned.parts, strict=True):
        x = condition.matrix(r, channels) + turned.sensitivities @ (target - part)
        runs.append(
            replace(
                r,
                t=condition.grid,
                columns={**{c: np.interp(condition.grid, r.t, v) for c, v in r.columns.items()}, **dict(zip(channels, x.T, strict=True))},
            )
        )
    return replace(condition, runs=tuple(runs))
