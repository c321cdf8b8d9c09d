"""Is the log usable? Looked at before any physics: missing and constant samples, time base, signs, axes, units.

A finding that is `fatal` makes the log a bad one. Clocks are judged later, together with the effects that look like them.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robomill.diagnosis.experiment.measured import Condition
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray, base_name

FACTORS = {
    1e3: "milli- for units",
    1e-3: "units for milli-",
    1e6: "micro- for units",
    1e-6: "units for micro-",
    180.0 / np.pi: "degrees for radians",
    np.pi / 180.0: "radians for degrees",
    9.80665: "newtons for kilogram-force",
    1 / 9.80665: "kilogram-force for newtons",
    60 / (2 * np.pi): "rpm for rad/s",
    2 * np.pi / 60: "rad/s for rpm",
    25.4: "millimetres for inches",
    1 / 25.4: "inches for millimetres",
    4.4482216: "newtons for pound-force",
    1 / 4.4482216: "pound-force for newtons",
}
"""Usual mistakes in units: measured over simulated."""
SAME_FACTOR = 0.25
"""|ln| of measured over simulated over one of these mistakes, up to which it is that one: a third of the way from newtons for pounds-force
to rpm for rad/s, the closest that can be told apart (rpm and kilograms-force cannot: 9.55 and 9.81)."""
MUCH_BETTER = 0.2
"""Sum of squares left over that before, below which another sign, order or unit is believed."""
FAR_OFF = 0.6
"""Sum of squares of the difference over that of the signal, above which another sign, order or unit is looked for."""

NEAR = 25.5
"""Samples by which what happens at one time may be apart in two repeats: an axis that begins to move has a time of its own."""
LIMIT = 0.1
"""Part of a channel's range by which its simulation may be short of a limit that the channel stands at."""

BREAK, LONG_BREAK, PART = 12.5, 62.5, 0.05
"""Samples (communication steps, if these are longer) without a stamp that are noted, and those that make a log a bad one, or that part
of a run."""
REST = 0.1
"""Part of a run from which a channel stands still."""
LONGER, LONGER_BY = 3, 10
"""Times as long as the longest standstill of its simulation, and samples more, that a channel must stand still: a simulation rests, too,
and one that passes slowly through rounded values rests for a few samples."""
SINGLE = 2.0**-22
"""Part of a channel's largest value by which a simulation creeps while a log in single precision stands still: two of its last places."""

MISSING = 0.01
"""Part of a channel's samples that may be missing (judgement): they are interpolated."""
ROUNDED = 1e-9
"""Part of a bound by which a value may be beyond it: it was rounded."""
UNMOVED = 1e-9
"""Unit of the channel: a simulation that moves up to this is round-off, and a channel that does not change says nothing."""
MOVED = 20.0
"""Times the noise of a channel from beyond which its simulation moves so far that a channel at rest is no chance."""
VISIBLE = 25.0
"""Sum of squares of a signal over that of noise from beyond which its sign, unit, place and frame can be told: five times the noise."""

SPIKE = 30.0
"""Times the usual change from sample to sample by which a single sample is away from both of its neighbours."""
USUAL = 95
"""Percentile of the changes from sample to sample that is usual: that of a motion, if it lasts for a twentieth of a run."""
FLAT = 1e-12
"""Unit of the channel: least usual change, so that nothing is divided by zero where a channel rests."""
AGAIN = 0.25
"""Part of a jump that another repeat must have at the same time, for it to be the machine's and not the log's."""
FEW_SPIKES = 3
"""Spikes of a channel in a run that are noted only (judgement); more make the log a bad one."""

ELEMENTS = 6
"""Elements of the largest array whose channels may be interchanged: those of six axes, or of a force and a moment."""
VECTOR = 3
"""Elements of an array that may be a vector in another frame."""
CROSSED = 0.3
"""Sum of squares of the difference over that of the motion of two channels, above which they are looked at the other way round."""
ROTATED, ROTATION = 0.1, np.deg2rad(20.0)
"""Sum of squares of the difference over that of a vector, and angle [rad], above which it is in another frame: a smaller turn is an
inexact pose."""

ODD_ONE_OUT = 3
"""Repeats from which one can be unlike the others: of two, nobody can say which."""
UNLIKE = 100.0
"""Mean square by which a repeat differs from the median of all, over what is usual, from beyond which it is nothing like them: ten times
as far."""
NOTHING = 1e-30
"""Square of a channel's unit: least usual mean square, so that nothing is divided by zero where all repeats are equal."""

EXACT, TIMING = 1e-5, 0.05
"""Part of a channel's range, and samples in time, by which repeats that are the same may differ: a stamp that jitters moves a jump."""


@dataclass(frozen=True)
class Finding:
    """One thing about the log."""

    channel: str
    """Channel, array, or `t`."""
    kind: str
    """`time`, `missing`, `range`, `constant`, `spike`, `axes`, `unit`, `sign`, `rotation`, `repeat`, `lag`, `filter`, ..."""
    value: float
    """How much, in `unit`."""
    unit: str
    text: str
    """In words: a verb and what follows it, the channel being the subject."""
    fatal: bool = True
    """Whether it makes the log a bad one."""
    repaired: bool = False


def raw(run: Run, channels: Sequence[str], ranges: Mapping[str, tuple[float | None, float | None]], step: float) -> list[Finding]:
    """What can be seen without a simulation; `step` [s] is that of the communication."""
    found = []
    gaps = np.diff(run.t)
    usual = max(float(np.median(gaps)), step)
    longest = float(gaps.max())
    if longest > BREAK * usual:
        fatal = longest > min(LONG_BREAK * usual, PART * float(np.ptp(run.t)))
        found.append(Finding("t", "time", longest, "s", f"no samples for {longest:.3g} s at t = {run.t[int(gaps.argmax())]:.6g} s", fatal))
    for name in channels:
        values = run.columns[name]
        unit = run.ports[name].unit or ""
        good = np.isfinite(values)
        missing = 1.0 - float(good.mean())
        if missing > 0.0:
            found.append(Finding(name, "missing", missing, "1", f"{100 * missing:.2g} % of the samples are missing", missing > MISSING))
        values = values[good]
        low, high = ranges.get(name, (None, None))
        for bound, outside in ((low, -1.0), (high, 1.0)):
            if bound is not None and values.size and np.any(outside * values > outside * bound + ROUNDED * abs(bound)):
                extreme = float((outside * values).max() * outside)
                found.append(
                    Finding(name, "range", extreme, unit, f"{extreme:.6g} {unit} is outside what the port can be ({bound:.6g} {unit})")
                )
    return found


def against_simulation(run: Run, x: FloatArray, s: FloatArray, channels: Sequence[str], step: float, noise: FloatArray) -> list[Finding]:
    """What a measured run [samples, channels] says beside its simulation; `step` [s] between samples, `noise` [unit] per channel."""
    found: list[Finding] = []
    suspects: set[str] = set()
    size = (s * s).sum(axis=0)
    for members in _arrays(channels):
        for i, j in _interchanged(members, x, s, noise):
            found.append(Finding(channels[i], "axes", float(j - i), "1", f"is interchanged with {channels[j]}"))
            suspects |= {channels[i], channels[j]}
    for i, name in enumerate(channels):
        spread = float(np.ptp(s[:, i]))
        if np.ptp(run.columns[name][np.isfinite(run.columns[name])]) == 0.0 and spread > MOVED * noise[i] and spread > UNMOVED:
            found.append(Finding(name, "constant", float(x[0, i]), run.ports[name].unit or "", "does not change, but it should"))
            suspects.add(name)
            continue
        # at rest at zero, or where the simulation goes as far or further, is what a dead band or a limit makes of an output, too
        over, under = s[:, i] >= x[:, i].max() - LIMIT * spread, s[:, i] <= x[:, i].min() + LIMIT * spread
        limited = ((x[:, i] == x[:, i].max()) & over) | ((x[:, i] == x[:, i].min()) & under)
        moving = (x[:, i] != 0.0) & ~limited
        single = SINGLE * float(np.abs(s[:, i]).max())  # a log in single precision stands still where a simulation creeps
        stretch = _still(x[moving, i])
        still, longest = len(stretch), len(_still(s[:, i], single))
        there = s[moving, i][stretch]
        passed = np.ptp(there) > max(LIMIT * spread, MOVED * noise[i]) if still else False
        if still > REST * len(x) and (still > LONGER * longest + LONGER_BY or passed):
            found.append(Finding(name, "constant", still * step, "s", f"stands still for {still * step:.3g} s"))
            suspects.add(name)
            continue
        if name in suspects or not _visible(float(x[:, i] @ x[:, i]), noise[i], len(x)):  # measured over measured: whatever its unit is
            continue
        off = ((x[:, i] - s[:, i]) ** 2).sum()
        if off < FAR_OFF * size[i] or not size[i]:  # zero has no sign and no unit
            continue
        slope = float(x[:, i] @ s[:, i] / size[i])
        left = ((x[:, i] - slope * s[:, i]) ** 2).sum()
        if slope and left < MUCH_BETTER * (x[:, i] ** 2).sum():
            factor = min(FACTORS, key=lambda f: abs(np.log(abs(slope) / f)))
            if abs(np.log(abs(slope) / factor)) < SAME_FACTOR:
                found.append(Finding(name, "unit", slope, "1", f"is {slope:.4g} times what it should be: {FACTORS[factor]}"))
                suspects.add(name)
            elif slope < 0.0 and ((x[:, i] + s[:, i]) ** 2).sum() < MUCH_BETTER * off:
                found.append(Finding(name, "sign", -1.0, "1", "has the wrong sign"))
                suspects.add(name)
    for members in _arrays(channels):
        found += _turned([i for i in members if channels[i] not in suspects], x, s, channels, noise)
    return found


def stopped(x: FloatArray, s: FloatArray, step: float, noise: float) -> float:
    """How long [s] a measured channel stands still, wherever that is, while its simulation moves; 0.0 if it does not."""
    stretch = _still(x)
    return len(stretch) * step if len(stretch) > REST * len(x) and np.ptp(s[stretch]) > MOVED * noise else 0.0


def _visible(squares: float, noise: float, n: int) -> bool:
    return bool(squares > VISIBLE * noise * noise * n and squares > 0.0)


def _still(x: FloatArray, tolerance: float = 0.0) -> range:
    """Longest stretch of samples that are equal to the next one."""
    if not len(x):
        return range(0)
    changes = np.flatnonzero(np.abs(np.diff(x)) > tolerance)
    edges = np.concatenate([[0], changes + 1, [len(x)]])
    longest = int(np.diff(edges).argmax())
    return range(int(edges[longest]), int(edges[longest + 1]))


def spikes(condition: Condition, channels: Sequence[str]) -> list[Finding]:
    """Single samples far from both neighbours. What jumps at one time in most repeats is the machine (masses at a jerk), not the log."""
    found = []
    for name in channels:
        jumps = [_jumps(run.t, run.columns[name]) for run in condition.runs]
        count = max(_alone(jumps[k], jumps[:k] + jumps[k + 1 :]) for k in range(len(jumps)))
        if count:
            who = f"{count} samples jump" if count > 1 else "1 sample jumps"
            text = f"{who} away by more than {SPIKE:.0f} times what is usual"
            found.append(Finding(name, "spikes", count, "1", text, count > FEW_SPIKES))
    return found


def _jumps(t: FloatArray, x: FloatArray) -> FloatArray:
    """Time, and distance from the nearer neighbour where both are on the same side, over what is usual; [2, samples]."""
    t, x = t[np.isfinite(x)], x[np.isfinite(x)]
    if len(x) <= 1:
        return np.zeros((2, 0))
    before, after = x[1:-1] - x[:-2], x[1:-1] - x[2:]
    usual = max(float(np.percentile(np.abs(np.diff(x)), USUAL)), FLAT)
    away = np.where(np.sign(before) == np.sign(after), np.minimum(np.abs(before), np.abs(after)), 0.0)
    return np.stack([t[1:-1], away / usual])


def _alone(own: FloatArray, others: Sequence[FloatArray]) -> int:
    """How many samples jump where no sample near them does in half of the other repeats, by a part AGAIN of that."""
    count = 0
    for t, size in own[:, own[1] > SPIKE].T:
        near = NEAR * float(np.median(np.diff(own[0])))
        again = sum(bool(np.any(other[1, np.abs(other[0] - t) < near] > AGAIN * size)) for other in others)
        count += 2 * again <= len(others)
    return count


def _arrays(channels: Sequence[str]) -> list[list[int]]:
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(channels):
        groups.setdefault(base_name(name), []).append(i)
    return [g for g in groups.values() if 1 < len(g) <= ELEMENTS]


def _interchanged(members: list[int], x: FloatArray, s: FloatArray, noise: FloatArray) -> list[tuple[int, int]]:
    """Pairs of channels of an array that stand in each other's place, possibly with another sign."""
    # what is there all the time (a position, a weight) says nothing of how large a difference is usual
    moving, shown = ((s - s.mean(axis=0)) ** 2).sum(axis=0), (x * x).sum(axis=0)
    found = []
    for i, j in itertools.combinations(members, 2):
        if not all(_visible(float(shown[k]), float(noise[k]), len(x)) for k in (i, j)):
            continue
        straight, crossed = _apart(x[:, [i, j]], s[:, [i, j]]), _apart(x[:, [i, j]], s[:, [j, i]])
        clear = _visible(straight, float(noise[[i, j]].max()), 2 * len(x))
        if clear and straight > CROSSED * (moving[i] + moving[j]) and crossed < MUCH_BETTER * straight:
            found.append((i, j))
    return found


def _apart(a: FloatArray, b: FloatArray) -> float:
    """Sum of squares of the differences of channels, whatever their signs are."""
    return float(np.minimum(((a - b) ** 2).sum(axis=0), ((a + b) ** 2).sum(axis=0)).sum())


def _turned(members: list[int], x: FloatArray, s: FloatArray, channels: Sequence[str], noise: FloatArray) -> list[Finding]:
    """A triple in another frame."""
    if len(members) != VECTOR:
        return []
    base = base_name(channels[members[0]])
    a, b = x[:, members], s[:, members]
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    angle = float(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))
    straight, turned = ((a - b) ** 2).sum(), ((a - b @ turn.T) ** 2).sum()
    if (
        angle > ROTATION
        and turned < MUCH_BETTER * straight
        and straight > ROTATED * (b * b).sum()
        and _visible(float((a * a).sum()), float(noise[members].max()), len(x))
    ):
        return [
            Finding(
                base, "rotation", angle, "rad", f"is turned by {np.rad2deg(angle):.0f} degrees: another frame, or a transposed rotation"
            )
        ]
    return []


def repeats(condition: Condition, group: Sequence[FloatArray], channels: Sequence[str]) -> list[Finding]:
    """A repeat that is nothing like the others (ODD_ONE_OUT at least)."""
    if len(group) < ODD_ONE_OUT:
        return []
    stack = np.stack(group)
    off = ((stack - np.median(stack, axis=0)) ** 2).mean(axis=1)
    moved = TIMING * np.gradient(np.median(stack, axis=0), axis=0)
    usual = np.median(off, axis=0) + (EXACT * np.ptp(stack, axis=(0, 1))) ** 2 + (moved**2).mean(axis=0) + NOTHING
    found = []
    for k in range(len(group)):
        ratio = off[k] / usual
        worst = int(ratio.argmax())
        if ratio[worst] > UNLIKE:
            far = f"is {np.sqrt(ratio[worst]):.0f} times as far from the other repeats as they are from each other"
            text = f"{far} ({condition.runs[k].folder.name})"
            found.append(Finding(channels[worst], "repeat", float(np.sqrt(ratio[worst])), "1", text))
    return found
