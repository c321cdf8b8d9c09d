"""Reaction time: how long after the force changed the robot has moved (paper 000, sec. 2.3: 100-150 ms, +-12 ms with pilot control)."""

from __future__ import annotations

import numpy as np

from robomill.models.model.declaration import FloatArray
from robomill.orchestration.runs.run import Run

WINDOW = 0.4
"""Half width [s] of the window around the largest change of the deflection."""


def executed_correction(run: Run) -> FloatArray:
    """What the correction has moved the tool tip by so far [m], [n, 3] in B: actual pose without deflection, minus plan."""
    moved: FloatArray = run["compliance.p_BT_B"] - run["compliance.d_T_B"] - run["path.p_BT_B"]
    return moved


def steepest_release(run: Run, span: float = 0.1) -> int | None:
    """Index of the sample in the middle of the `span` [s] in which the deflection falls most where the cutter leaves the material.

    It leaves where it is engaged WINDOW before and not engaged any more from WINDOW after to twice that: a tool that is soon in
    the material again shows no step that a delay could be read from. Nor does one that takes a rim in passing, where the deflection
    lasts for a moment. As times are read in the middle between the levels WINDOW before and after, the fall must cross it, and half
    of the fall at least must be the step between them. None if it never leaves so.
    """
    step = float(run.t[1] - run.t[0])
    engaged = run["milling.depth"] > 0.0
    deflection = np.linalg.norm(run["compliance.d_T_B"], axis=1)
    n, window = max(1, round(span / step)), round(WINDOW / step)
    middle = np.arange(len(deflection) - n) + n // 2
    before = engaged[np.maximum(middle - window, 0)]
    cuts = np.concatenate([[0], np.cumsum(engaged)])  # steps engaged so far
    end = np.minimum(middle + 2 * window, len(engaged))
    leaves = before & (cuts[end] == cuts[np.minimum(middle + window, len(engaged) - 1)])
    fall = deflection[:-n] - deflection[n:]
    if not np.any(leaves):
        return None
    i = int(np.argmax(np.where(leaves, fall, -np.inf)))
    level_before = float(deflection[max(middle[i] - window, 0)])
    level_after = float(deflection[min(middle[i] + window, len(deflection) - 1)])
    crosses = deflection[i] >= 0.5 * (level_before + level_after) >= deflection[i + n]
    return int(middle[i]) if crosses and level_before - level_after >= 0.5 * fall[i] else None


def half_time(t: FloatArray, signal: FloatArray, before: float, after: float) -> float:
    """Time [s] at which `signal` last crosses the middle between the levels `before` and `after`; nan if it never does."""
    level = (signal - after) / (before - after) - 0.5
    crossings = np.flatnonzero((level[:-1] > 0.0) & (level[1:] <= 0.0))
    if len(crossings) == 0:
        return float("nan")
    i = int(crossings[-1])
    share = level[i] / (level[i] - level[i + 1])
    return float(t[i] + share * (t[i + 1] - t[i]))


def reaction_time(run: Run) -> float:
    """Delay [s] between deflection and executed correction at the cutter exit, each at half of its fall; nan without compensation or exit.

    Both are taken along the direction in which the tool springs back, normal to the feed. Positive: the robot is late.
    """
    middle = steepest_release(run)
    if middle is None:
        return float("nan")
    t, moved, deflection = run.t, executed_correction(run), run["compliance.d_T_B"]
    n = round(WINDOW / float(t[1] - t[0]))
    part = slice(max(0, middle - n), min(len(t), middle + 2 * n))
    first, last = deflection[part][0], deflection[part][-1]
    feed = run["path.v_BT_B"][middle]
    direction = first - last
    speed = float(np.linalg.norm(feed))
    if speed > 0.0:
        direction = direction - (direction @ feed) * feed / speed**2
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        return float("nan")
    direction /= length
    d, c = deflection[part] @ direction, -(moved[part] @ direction)
    if np.ptp(c) < 0.1 * np.ptp(d):
        return float("nan")
    return half_time(t[part], c, float(c[0]), float(c[-1])) - half_time(t[part], d, float(d[0]), float(d[-1]))
