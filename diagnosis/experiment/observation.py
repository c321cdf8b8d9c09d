"""What a faulty log makes of simulated channels: linear operators, in place."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from robomill.diagnosis.candidates import selects
from robomill.orchestration.slaves.protocol import FloatArray


def observe(full: FloatArray, t: FloatArray, channels: Sequence[str], parameter: str, value: float) -> None:
    """Apply `KIND PATTERN` of size `value` to the channels that the pattern selects; `full` [n, channels], `t` [s].

    ValueError where the pattern of a kind that mixes channels does not select as many as that mixes.
    """
    kind, _, pattern = parameter.partition(" ")
    members = [i for i, c in enumerate(channels) if selects(pattern, c)]
    if not members:
        return
    if kind in ("swap", "rotate_1", "rotate_2", "rotate_3"):
        _mix(full, members, kind, value, parameter)
        return
    for i in members:
        if kind == "lag":
            full[:, i] = np.interp(t - value, t, full[:, i])
        elif kind == "smooth":
            decay = math.exp(-float(t[1] - t[0]) / value) if value > 0.0 else 0.0
            full[:, i] = lfilter([1.0 - decay], [1.0, -decay], full[:, i], zi=[decay * full[0, i]])[0]
        elif kind == "gain":
            full[:, i] *= 1.0 + value
        elif kind == "sign":
            full[:, i] *= -1.0
        elif kind == "unit":
            full[:, i] *= value
        else:
            full[:, i] += value


def _mix(full: FloatArray, members: list[int], kind: str, value: float, parameter: str) -> None:
    """Interchange two channels, or turn three by `value` [rad] about one of their axes."""
    wanted = 2 if kind == "swap" else 3
    if len(members) != wanted:
        raise ValueError(f"{parameter!r} of the log selects {len(members)} channels; expected {wanted}: give a pattern that selects these")
    if kind == "swap":
        full[:, members] = full[:, members[::-1]]
        return
    axis = int(kind[-1]) - 1
    i, j = members[(axis + 1) % 3], members[(axis + 2) % 3]
    c, s = math.cos(value), math.sin(value)
    full[:, [i, j]] = full[:, [i, j]] @ np.array([[c, s], [-s, c]])
