"""What calibrated numbers may do to a gap: no form is about that.

A filter that is 1 % slower than its model, within its tolerance, leaves a gap that is seen as well as any, and a formula says all of it.
So a form is about what is left of a gap when calibrated numbers have taken what they may.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import lsq_linear

from robomill.diagnosis.candidates import LOGGING, Nuisance
from robomill.diagnosis.experiment.component_replay import ComponentReplay
from robomill.diagnosis.experiment.simulation import decimate
from robomill.orchestration.slaves.protocol import FloatArray, base_name


@dataclass
class Doubts:
    """What calibrated numbers do, by their standard deviation, to what was measured in these replays."""

    replays: Sequence[ComponentReplay]
    nuisances: Sequence[Nuisance]
    _alone: list[list[FloatArray]] | None = field(default=None, init=False)
    _looped: list[list[FloatArray]] | None = field(default=None, init=False)

    def alone(self) -> list[list[FloatArray]]:
        """By number and condition, with components alone and what they pass on: block means of all channels, [blocks, channels]."""
        if self._alone is None:
            self._alone = self._shown([[_by_number(r, n) for r in self.replays] for n in self._numbers()])
        return self._alone

    def looped(self) -> list[list[FloatArray]]:
        """By number and condition, in the closed loop: block means of all channels, [blocks, channels]."""
        if self._looped is None:
            self._looped = self._shown([[r.change_in_loop(((n.address, n.scale),)) for r in self.replays] for n in self._numbers()])
        return self._looped

    def _numbers(self) -> list[Nuisance]:
        names = {c.name for c in self.replays[0].laboratory.system.components}
        return [n for n in self.nuisances if n.address[0] in names and n.address[0] != LOGGING]

    def _shown(self, moved: Sequence[Sequence[FloatArray | None]]) -> list[list[FloatArray]]:
        found = []
        for parts in moved:
            complete = [decimate(x, r.laboratory.decimation) for r, x in zip(self.replays, parts, strict=True) if x is not None]
            if len(complete) == len(parts) and any(np.any(x) for x in complete):
                found.append(complete)
        return found


def _by_number(replay: ComponentReplay, number: Nuisance) -> FloatArray | None:
    component = number.address[0]
    moved = replay.change(component, ((number.address, number.scale),))
    return None if moved is None else passed_on(replay, component, moved)


def passed_on(replay: ComponentReplay, component: str, moved: Mapping[str, FloatArray]) -> FloatArray:
    """What a change of a component's outputs, column -> [n], does to all channels, [n, channels].

    That is its own ones, and those of other components behind connections that are not measured.
    """
    out = np.zeros((len(replay.grid), len(replay.channels)))
    waiting, passed = [(component, moved)], set()
    while waiting:
        source, moved = waiting.pop()
        passed.add(source)
        for i, c in enumerate(replay.channels):
            if c in moved:
                out[:, i] += moved[c]
        for target in dict.fromkeys(d for o, d in replay.hidden() if o.partition(".")[0] == source and d not in passed):
            arrays = [o for o, d in replay.hidden() if d == target and o.partition(".")[0] == source]
            if any(np.any(x) for k, x in moved.items() if base_name(k) in arrays):
                waiting.append((target, replay.follow(moved, arrays, target)))
    return out


def likeliest(y: FloatArray, X: FloatArray, doubt: FloatArray) -> FloatArray:
    """Numbers z [m] that leave least of y - X c - D z, with any coefficients c, each in the 90 % interval of its calibration.

    y [n], terms X [n, k] and what numbers do, D [n, m], are in deviations of noise. Least is |y - X c - D z|^2 / s + |z|^2, with s the mean
    square that is left, if that is more than noise: laws that are not quite right leave something, too.
    """
    k, m = X.shape[1], doubt.shape[1]
    size = np.sqrt((X**2).sum(axis=0))
    both = np.column_stack([X / np.where(size > 0.0, size, 1.0), doubt])
    prior = np.column_stack([np.zeros((m, k)), np.eye(m)])
    ends = np.concatenate([np.full(k, np.inf), np.full(m, 1.645)])
    weight = 1.0
    for _ in range(2):  # the second time it is known what is left
        q, r = np.linalg.qr(np.concatenate([weight * both, prior]))
        found = lsq_linear(r, q.T @ np.concatenate([weight * y, np.zeros(m)]), (-ends, ends)).x
        weight = 1.0 / max(float(np.sqrt(np.mean((y - both @ found) ** 2))), 1.0)
    return np.asarray(found[k:])
