"""Is the log usable? What no model explains: gaps in time, missing samples, values out of range, standstill, spikes.

A finding that is `fatal` makes the log a bad one. Faults that are models (signs, units, axes, clocks) are in `log_faults`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from robomill.diagnosis.experiment.measured import Condition
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray

NEAR = 25.5
"""Samples by which what happens at one time may be apart in two repeats: an axis that begins to move has a time of its own."""
LIMIT = 0.1
"""Part of a channel's range by which its simulation may be short of a limit that the channel stands at."""

LIMITED = "limit"
"""Kind of finding of a channel that stays where its simulation goes beyond."""
BREAK, LONG_BREAK = 12.5, 62.5
"""Samples (communication steps, if these are longer) without a stamp that are noted, and those that make a log a bad one."""
PART = 0.05
"""Part of a run that is no exception (judgement): so much of it may not be missing, and a motion that lasts so long is what is usual."""
REST = 0.1
"""Part of a run from which a channel stands still."""
LONGER, LONGER_BY = 3, 10
"""Times as long as the longest standstill of its simulation, and samples more, that a channel must stand still: a simulation rests, too,
and one that passes slowly through rounded values rests for a few samples."""
SINGLE = 2.0 * float(np.finfo(np.float32).eps)
"""Part of a channel's largest value that single precision rounds off: two of its last places."""

MISSING = 0.01
"""Part of a channel's samples that may be missing (judgement): they are interpolated."""
UNMOVED = 1e-9
"""Unit of the channel: a simulation that moves up to this is round-off, and a channel that does not change says nothing."""
MOVED = 20.0
"""Times the noise of a channel from beyond which its simulation moves so far that a channel at rest is no chance."""
SPIKE = 30.0
"""Times the usual change from sample to sample by which a single sample is away from both of its neighbours."""
AGAIN = 0.25
"""Part of a jump that another repeat must have at the same time, for it to be the machine's and not the log's."""
FEW_SPIKES = 3
"""Spikes of a channel in a run that are noted only (judgement); more make the log a bad one."""


@dataclass(frozen=True)
class Finding:
    """One thing about the log."""

    channel: str
    """Channel, array, or `t`."""
    kind: str
    """`time`, `missing`, `range`, `constant`, `spike`, `axes`, `unit`, `sign`, `rotation`, `repeat`, `lag`, `filter`, `scatter`, ..."""
    value: float
    """How much, in `unit`."""
    unit: str
    """Unit of `value`."""
    text: str
    """In words: a verb and what follows it, the channel being the subject."""
    fatal: bool = True
    """Whether it makes the log a bad one."""
    repaired: bool = False
    """Whether it was corrected: a clock by `--repair`, or beside effects of the machine; or because a repeat was left out."""
    run: str = ""
    """Folder of the run that it is about; empty where that is not one alone."""


def raw(run: Run, channels: Sequence[str], ranges: Mapping[str, tuple[float | None, float | None]], step: float) -> list[Finding]:
    """What can be seen without a simulation; `step` [s] is that of the communication."""
    found = []
    gaps = np.diff(run.t)
    usual = max(float(np.median(gaps)), step)
    longest = float(gaps.max())
    if longest > BREAK * usual:
        fatal = longest > min(LONG_BREAK * usual, PART * float(np.ptp(run.t)))
        found.append(
            Finding(
                "t",
                "time",
                longest,
                "s",
                f"no samples for {longest:.3g} s at t = {run.t[int(gaps.argmax())]:.6g} s; expected one in {usual:.3g} s",
                fatal,
            )
        )
    for name in channels:
        values = run.columns[name]
        unit = run.ports[name].unit or ""
        good = np.isfinite(values)
        missing = 1.0 - float(good.mean())
        if missing > 0.0:
            found.append(
                Finding(
                    name,
                    "missing",
                    missing,
                    "1",
                    f"{100 * missing:.2g} % of the samples are missing; expected none, at most {100 * MISSING:.0f} %",
                    missing > MISSING,
                )
            )
        values = values[good]
        low, high = ranges.get(name, (None, None))
        for bound, outside in ((low, -1.0), (high, 1.0)):
            if bound is not None and values.size and np.any(outside * values > outside * bound + SINGLE * abs(bound)):
                extreme = float((outside * values).max() * outside)
                found.append(
                    Finding(name, "range", extreme, unit, f"{extreme:.6g} {unit} is outside what the port can be ({bound:.6g} {unit})")
                )
    return found


def limits_of(runs: Sequence[FloatArray]) -> tuple[float, float]:
    """The least and the largest value of a channel in these runs, [samples] each; NaN where that is no limit.

    A limit is met in several runs, at the same value, and never exceeded. What is broken keeps the value that it had by chance, and what is
    not connected shows the same all the time, or zero.
    """
    found = []
    for extreme in (min(float(x.min()) for x in runs), max(float(x.max()) for x in runs)):
        met = sum(_rests(x, extreme) > 0 for x in runs) > 1
        found.append(extreme if met and extreme != 0.0 and any(np.any(x != extreme) for x in runs) else np.nan)
    return found[0], found[1]


def standstill(
    run: Run,
    x: FloatArray,
    s: FloatArray,
    channels: Sequence[str],
    step: float,
    noise: FloatArray,
    limits: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> list[Finding]:
    """Channels of a measured run [samples, channels] that rest beside their simulation; `step` [s] between samples, `noise` [unit].

    At rest at zero is what a dead band makes of an output, too. At rest where the simulation goes as far or further, or at an extreme to
    which the channel comes back after it has left it, is what a limit does. While a channel is at one of its `limits`, what its component
    makes of it may rest, too; that it is there is noted. What sticks, or ends at rest while its simulation moves by less than LIMIT of its
    range, is not fatal.
    """
    found: list[Finding] = []
    held = {name: np.zeros(len(x), dtype=bool) for name in map(_component, channels)}
    for i, name in enumerate(channels):  # a component at a limit to which its simulation does not go
        if name in limits:
            stays = np.isin(x[:, i], limits[name]) & (np.abs(x[:, i] - s[:, i]) > MOVED * noise[i])
            held[_component(name)] |= stays
            least, most = limits[name]
            over, under = s[:, i] > most + MOVED * noise[i], s[:, i] < least - MOVED * noise[i]
            beyond = (over & (x[:, i] == most)) | (under & (x[:, i] == least))
            if beyond.sum() > max(BREAK, 0.5 * np.count_nonzero(over | under)):
                bound, unit = float(x[beyond, i][0]), run.ports[name].unit or ""
                time = float(beyond.sum()) * step
                text = (
                    f"stays at {bound:.6g} {unit} for {time:.3g} s, where its simulation goes beyond: a limit of the machine or the sensor"
                )
                found.append(Finding(name, LIMITED, time, "s", text, fatal=False))
    for i, name in enumerate(channels):
        spread = float(np.ptp(s[:, i]))
        known = run.columns[name][np.isfinite(run.columns[name])]
        beside = held[_component(name)]
        if not known.size or (np.ptp(known) == 0.0 and spread > MOVED * noise[i] and spread > UNMOVED and not beside.all()):
            unit = run.ports[name].unit or ""
            text = f"does not change, but it should by {spread:.3g} {unit}; see whether it was connected"
            found.append(Finding(name, "constant", float(x[0, i]), unit, text))
            continue
        high, low = float(x[:, i].max()), float(x[:, i].min())
        over = (s[:, i] >= high - LIMIT * spread) | _again(x[:, i], high)
        under = (s[:, i] <= low + LIMIT * spread) | _again(x[:, i], low)
        limited = ((x[:, i] == high) & over) | ((x[:, i] == low) & under)
        moving = (x[:, i] != 0.0) & ~limited & ~beside
        single = SINGLE * float(np.abs(s[:, i]).max())  # a log in single precision stands still where a simulation creeps
        stretch = _still(x[moving, i])
        still, longest = len(stretch), len(_still(s[:, i], single))
        there = s[moving, i][stretch]
        passed = np.ptp(there) > max(LIMIT * spread, MOVED * noise[i], single) if still else False
        if still > REST * len(x) and (still > LONGER * longest + LONGER_BY or passed):
            places = np.flatnonzero(moving)[stretch]
            rest = range(int(places[0]), int(places[-1]) + 1)
            near = rest.stop == len(x) and not passed and _stands_elsewhere(x[:, i], rest)
            way = "moves on from there" if _sticks(x[:, i], rest) else "ends there, near its simulation" if near else ""
            remedy = f"it {way}, as what sticks does" if way else "record it anew"
            text = f"stands still for {still * step:.3g} s; expected up to {longest * step:.3g} s, as its simulation; {remedy}"
            found.append(Finding(name, "constant", still * step, "s", text, fatal=not way))
    return found


def stopped(x: FloatArray, s: FloatArray, step: float, noise: float, limits: tuple[float, float] = (np.nan, np.nan)) -> float:
    """How long [s] a measured channel stands still while its simulation moves; 0.0 if it does not, is at a limit, or sticks."""
    stretch = _still(x)
    if stretch and (x[stretch[0]] in limits or (x[stretch[0]] in (x.max(), x.min()) and _again(x, float(x[stretch[0]])))):
        return 0.0
    if stretch and _sticks(x, stretch):
        return 0.0
    return len(stretch) * step if len(stretch) > REST * len(x) and np.ptp(s[stretch]) > MOVED * noise else 0.0


def _sticks(x: FloatArray, stretch: range) -> bool:
    """Whether a channel that stands still for a `stretch` of samples does so as a machine that sticks.

    That moves on from where it is, with no larger step than it makes elsewhere, and stands at other places, too. A log that froze jumps to
    where the machine is by then, and a live signal has noise.
    """
    if stretch.stop >= len(x):
        return False
    steps = np.abs(np.diff(x))
    others = np.concatenate([steps[: stretch.start], steps[stretch.stop :]])
    return bool(_stands_elsewhere(x, stretch) and steps[stretch.stop - 1] <= others.max())


def _stands_elsewhere(x: FloatArray, stretch: range) -> bool:
    """Whether a channel stands at another place than that of a `stretch` of samples, too: two samples there are equal."""
    outside = np.ones(len(x) - 1, dtype=bool)
    outside[stretch.start : stretch.stop] = False
    return bool(np.any(x[:-1][outside & (np.diff(x) == 0.0)] != x[stretch.start]))


def _again(x: FloatArray, extreme: float) -> bool:
    """Whether a channel rests at its own extreme value more than once.

    A limit is left and met again, always at one value that is never exceeded. What is broken keeps the value that it had by chance.
    """
    return _rests(x, extreme) > 1


def _rests(x: FloatArray, value: float) -> int:
    """How often a channel is at a value for several samples."""
    rests = np.append(x == value, False) & np.append(False, x == value)
    return int(np.count_nonzero(np.diff(rests.astype(int), prepend=0) > 0))


def _component(channel: str) -> str:
    return channel.partition(".")[0]


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
    usual = max(float(np.quantile(np.abs(np.diff(x)), 1.0 - PART)), UNMOVED)
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
