"""The runs that are given, as a set: each once, whole, and of the program that the nominal system plays.

A diagnosis of runs that are copies of each other is sure of itself for no reason: copies have no noise between them, and a held-out run
that was diagnosed confirms any answer.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from robomill.diagnosis.candidates import LOGGING, Candidate
from robomill.diagnosis.experiment.measured import Condition, DataError, common_grid, known_parameters
from robomill.diagnosis.experiment.segments import by_array
from robomill.diagnosis.gate.checks import BREAK, PART, SINGLE, Finding
from robomill.orchestration.assembly import MEASURED, Resolver
from robomill.orchestration.assembly import run as simulate
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.parameters import Convert

OTHER = 0.01
"""Squares of what a recorded program differs from the one that is played, over those of its motion: a tenth in amplitude, where the same
program recorded late differs by the rounding of the log."""


def check_clock(run: Run, system: System, resolver: Resolver | None, convert: Convert) -> None:
    """DataError for stamps in another unit than seconds: milliseconds taken for seconds, or the reverse.

    The system is simulated to its own end if the log has a sample each thousand, or each thousandth, of its communication steps, or about
    that: a logger may be slow or fast. Beside that end the log must be about as many times too long or too short. A system without an
    end, or one that plays what was measured, says nothing of how long a log should be.
    """
    lasts, between = float(np.ptp(run.t)), float(np.median(np.diff(run.t))) if len(run) > 1 else 0.0
    power = _thousands(between / system.step) if between > 0.0 else 0
    if not power or (system.stop is None and system.stop_when is None) or any(c.source == MEASURED for c in system.components):
        return
    factor = 1e3**power
    for component, values in known_parameters(run, system).items():
        system = system.with_parameters(component, values)
    longest = system.step * round(lasts / factor * math.sqrt(1e3) / system.step)  # beyond that it is no matter of this unit
    ends = float(simulate(system, stop=min(system.stop or longest, longest), resolver=resolver, convert=convert).t[-1])
    if ends > longest - system.step or _thousands(lasts / ends) != power:
        return
    raise DataError(
        f"{run.folder}: the log lasts {lasts:.6g} s, with a sample each {between:.3g} s; expected about {ends:.6g} s, as {system.name!r} "
        f"takes with these parameters, in steps of {system.step:g} s: as if the time were in a unit of {1.0 / factor:g} s; "
        'give the unit of the time when the log is imported (unit = "ms" or another in its table [clock]), and import it anew'
    )


def _thousands(ratio: float) -> int:
    """The nearest power of a thousand: from s to ms, or to us."""
    return round(math.log10(ratio) / 3.0)


def check_each(runs: Sequence[Run], held_out: Sequence[Run]) -> None:
    """DataError for a run that is there twice, is not finished, or is held out and diagnosed."""
    for run in (*runs, *held_out):
        if run.outcome != "finished":
            raise DataError(
                f"{run.folder}: the run is not finished (outcome: {run.outcome}); leave it out, or record it anew (robomill run --resume)"
            )
    for a, b in itertools.combinations((*runs, *held_out), 2):
        same_folder = a.folder.is_dir() and b.folder.is_dir() and a.folder.samefile(b.folder)
        if not same_folder and not _copies(a, b):
            continue
        mixed = any(a is r for r in runs) and any(b is h for h in held_out)
        how = "the same folder" if same_folder else "the same signals but for rounding, as far as both go"
        if mixed:
            raise DataError(
                f"{b.folder} is held out, and {a.folder}, which is diagnosed, has {how}; a run cannot confirm what was found in it"
                "; leave it out of one of the two"
            )
        raise DataError(
            f"{b.folder} has {how} as {a.folder}: a repeat has noise of its own (one of a simulation without noise says nothing new); "
            "give one of them"
        )


def _copies(a: Run, b: Run) -> bool:
    """Whether all columns that both have are the same in all rows that both have, but for rounding and whatever the stamps are."""
    names = a.columns.keys() & b.columns.keys()
    n = min(len(a), len(b))
    return bool(names) and n > 0 and all(_same(a.columns[c][:n], b.columns[c][:n]) for c in names)


def _same(a: FloatArray, b: FloatArray) -> bool:
    """Whether two columns differ by no more than single precision rounds off."""
    known = np.isfinite(a) & np.isfinite(b)
    if not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return False
    return not known.any() or bool(np.abs(a - b)[known].max() <= SINGLE * np.abs(a[known]).max())


def complete(conditions: Sequence[Condition]) -> tuple[list[Condition], list[Finding]]:
    """The conditions without repeats that were cut short, so that the others are looked at for all the time that they have.

    What counts as whole is what at least half of the repeats cover: a single one that went on for longer does not make the others short.
    Each repeat that is left out, and each that makes the others a little shorter, is named.
    """
    made, found = [], []
    for c in conditions:
        last = (len(c.runs) + 1) // 2 - 1
        begin, end = sorted(float(r.t[0]) for r in c.runs)[last], sorted((float(r.t[-1]) for r in c.runs), reverse=True)[last]
        step = float(c.grid[1] - c.grid[0])
        kept = []
        for r in c.runs:
            lost = max(float(r.t[0]) - begin, end - float(r.t[-1]))
            out = lost > PART * (end - begin)
            if not out:
                kept.append(r)
            if lost > (PART * (end - begin) if out else BREAK * step):
                whole = f"{begin:.3f} to {end:.3f} s, as the repeats of {c.name!r}"
                has = f"{r.folder.name} has {r.t[0]:.3f} to {r.t[-1]:.3f} s; expected {whole}"
                then = "it was left out; record it anew" if out else "only what all have is looked at; leave it out to use the rest"
                found.append(Finding("t", "short", lost, "s", f"is cut short: {has}: {then}", fatal=False, repaired=out, run=r.folder.name))
        made.append(replace(c, runs=tuple(kept), grid=common_grid(kept, step)) if len(kept) < len(c.runs) else c)
    return made, found


def other_program(
    run: Run,
    x: FloatArray,
    s: FloatArray,
    channels: Sequence[str],
    played: Collection[str],
    step: float,
    latest: float,
    changes: Sequence[FloatArray] = (),
) -> list[Finding]:
    """Channels of components that nothing goes into (`played`) which are not what they play; measured `x` and simulated `s`, [n, channels].

    A program that is recorded late by up to `latest` [s] (and a sample) is the same; `step` [s] is between the samples. So is one that is
    off by no more than its calibrated numbers may be: `changes` are what three standard deviations of each do, [n, channels].
    """
    found = []
    for name, members in by_array(channels).items():
        if name.partition(".")[0] not in played:
            continue
        a, b = x[:, members], s[:, members]
        motion, size = float(((b - b.mean(axis=0)) ** 2).sum()), float((b**2).sum())
        if motion < SINGLE**2 * size:  # what does not move: its size
            motion = size
        reach = min(int(latest / step) + 1, len(a) // 2)
        off = min(_apart(a, b, k) for k in range(-reach, reach + 1))
        if off > OTHER * motion + sum(float((c[:, members] ** 2).sum()) for c in changes):
            unit = run.ports[channels[members[0]]].unit or ""
            largest = float(np.abs(a - b).max())
            text = (
                f"is not what the nominal system plays: {run.folder.name} is {largest:.4g} {unit} off, "
                f"at any delay up to {latest:g} s; another program, place or feed than [parameters] of its run.toml say?"
            )
            found.append(Finding(name, "program", largest, unit, text))
    return found


def latest_clock(candidates: Sequence[Candidate]) -> float:
    """How late [s] a clock of the log may be, by the catalogue; 0 where it has none."""
    return max((c.maximum for c in candidates if c.component == LOGGING and c.parameters[0].startswith("lag ")), default=0.0)


def _apart(a: FloatArray, b: FloatArray, shift: int) -> float:
    """Sum of squares of the difference with `a` taken `shift` samples later."""
    n = len(a) - abs(shift)
    first, second = (a[shift:], b[:n]) if shift >= 0 else (a[:n], b[-shift:])
    return float(((first - second) ** 2).sum()) * len(a) / n
