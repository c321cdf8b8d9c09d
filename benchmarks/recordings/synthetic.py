"""`python -m benchmarks.recordings.synthetic [NAME ...] [--seeds FIRST-LAST] [--page FILE]`: recordings of which the truth is known.

The motion of a real recording moves a robot that has eight to twenty-four effects at once, and a few that are too small to count. Half of
the robots have another law of friction than the catalogue. What is measured has noise as large, and as coloured, as what least squares
leave of the real recording. The diagnosis gets it as a single recording, with a held-out trajectory.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.signal import lfilter

from benchmarks.recordings.cases import Case, cases, prepare
from benchmarks.recordings.table import row
from benchmarks.recordings.taken_out import RECORDINGS
from benchmarks.recordings.yardstick import View, closures, fit
from robomill.cell.binding import convert, resolve
from robomill.diagnosis.candidates import Address, Candidate, physical
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.inference.intervals import MATERIAL
from robomill.diagnosis.inference.noise import fast
from robomill.diagnosis.outcome.answer import Diagnosis
from robomill.orchestration.assembly import run as simulated
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray

COUNT = (8, 24)
"""Fewest and most effects of a robot; not more than half of the catalogue."""
SIZES = (0.25, 1.5)
"""Sizes over the prior scale of the catalogue, alike on a logarithmic scale."""
BACKGROUND, SMALL = 5, (0.2, 0.9)
"""Effects that are there and too small to count, and their sizes over the `minimum` of the catalogue."""
MEMORY = (0.1, 0.3)
"""Time constant [s] of the coloured part of the noise."""
NAMED = 0.8
"""Probability from which an effect counts as named."""
TWINS = ("friction_coulomb", "friction_stribeck", "friction_load")
"""Effects that are alike in one direction of a joint: one of them may be named for another (DIAGNOSIS2, section 2)."""
CLOSING = 0.5
"""Part of a held-out channel that the truth closes, from which its closure is compared: of the others noise is the most."""


@dataclass(frozen=True)
class Noise:
    """What is added to each channel: white noise and an Ornstein-Uhlenbeck process, their deviations [unit of the channel]."""

    white: Mapping[str, float]
    coloured: Mapping[str, float]

    def drawn(self, channel: str, t: FloatArray, rng: np.random.Generator) -> FloatArray:
        """One sequence at the times `t` [s]."""
        keeps = math.exp(-float(t[1] - t[0]) / rng.uniform(*MEMORY))
        pushes = rng.standard_normal(len(t)) * math.sqrt(1.0 - keeps * keeps)
        pushes[0] /= math.sqrt(1.0 - keeps * keeps)
        slow = lfilter([1.0], [1.0, -keeps], pushes)
        return np.asarray(self.coloured[channel] * slow + self.white[channel] * rng.standard_normal(len(t)))


@dataclass(frozen=True)
class Robot:
    """What is wrong with a robot."""

    values: Mapping[Address, float]
    """Its effects [unit]."""
    small: Mapping[Address, float]
    """Those that are too small to count."""
    otherwise: bool
    """Whether its friction has another law than the catalogue."""
    rounding: float
    """Speed over which its friction turns, over that of the catalogue's law."""
    stribeck: float
    """Speed at which its Stribeck part has fallen, over that of the catalogue's law."""


@dataclass(frozen=True)
class Score:
    """What became of one robot."""

    recording: str
    seed: int
    verdict: str
    otherwise: bool
    wanted: int
    """Effects that close MATERIAL of a channel."""
    found: int
    """How many of them are named."""
    named: int
    wrong: tuple[str, ...]
    """Named, and neither there nor a twin of what is there."""
    twins: int
    """Named for a twin."""
    inside: int
    """Numbers of effects that are there and named, the truth in the interval."""
    numbers: int
    widths: tuple[float, ...]
    """Half of the interval over the truth, of each of them."""
    closure: tuple[float, ...]
    """Closure of each channel of the held-out run."""
    possible: tuple[float, ...]
    """What the truth closes of them: the rest is noise."""
    largest: float
    """Largest closure that the answer itself states."""
    cpu: float
    """s"""


def drawn(case: Case, rng: np.random.Generator) -> Robot:
    """A robot with friction in most of its joints, and other effects of the catalogue of this recording."""
    candidates = list(case.catalogue().candidates)
    count = min(int(rng.integers(COUNT[0], COUNT[1] + 1)), len(candidates) // 2)
    usual = [c for c in candidates if c.effect in ("friction_viscous", "friction_coulomb")]
    others = [c for c in candidates if c not in usual]
    first = [usual[i] for i in rng.permutation(len(usual))[: min(len(usual), max(count * 2 // 3, 1))]]
    rest = [others[i] for i in rng.permutation(len(others))]
    chosen, left = [*first, *rest[: count - len(first)]], rest[count - len(first) :]
    values = {a: v for c in chosen for a, v in _sized(c, c.prior.scale, SIZES, rng)}
    small = {a: v for c in left[:BACKGROUND] for a, v in _sized(c, c.minimum, SMALL, rng)}
    return Robot(values, small, bool(rng.integers(2)), float(rng.uniform(1.0, 3.0)), float(rng.uniform(0.5, 2.0)))


def _sized(c: Candidate, unit: float, bounds: tuple[float, float], rng: np.random.Generator) -> Iterable[tuple[Address, float]]:
    low, high = map(math.log, bounds)
    for a in c.addresses:
        size = unit * math.exp(rng.uniform(low, high))
        yield a, size * (rng.choice([-1.0, 1.0]) if c.both_signs else 1.0)


def noise_of(case: Case, runs: Sequence[Run]) -> Noise:
    """As large as what least squares leave of these runs with the effects that are expected, as white as its fast part."""
    views = [View(replace(case, band=0.0), r, case.system()) for r in runs]
    best = fit(views, [c for c in case.catalogue().candidates if c.name in case.expected]).values
    left = [(v.measured - v.model(best), v.counts) for v in views]
    white, coloured = {}, {}
    for i, channel in enumerate(views[0].channels):
        whole, quick = (
            math.sqrt(np.mean(np.concatenate([x[on[:, i], i] for x, (_, on) in zip(part, left, strict=True)]) ** 2))
            for part in ([x for x, _ in left], [fast(x) for x, _ in left])
        )
        white[channel], coloured[channel] = min(quick, whole), math.sqrt(max(whole**2 - quick**2, 0.0))
    return Noise(white, coloured)


def measured(view: View, robot: Robot, less: Sequence[Address] = ()) -> dict[str, FloatArray]:
    """The channels of a run with this robot, without noise; `less`: effects that it has not."""
    values = {a: v for a, v in {**robot.values, **robot.small}.items() if a not in less}
    friction = {a: v for a, v in values.items() if a[1].startswith("friction_")} if robot.otherwise else {}
    columns = _simulated(view, {a: v for a, v in values.items() if a not in friction})
    if friction:
        name = next(a[0] for a in friction)
        slopes = _simulated(view, {(name, f"friction_viscous[{i}]"): 1.0 for i in range(1, 7)})
        nominal = _simulated(view, {})
        late = values.get((name, "torque_lag"), 0.0)
        for i in range(1, 7):
            channel, v = f"{name}.torque_motor[{i}]", view.run.columns[f"motion.qd[{i}]"]
            per_axis = (slopes[channel] - nominal[channel]) @ v / (v @ v) * (1.0 + values.get((name, f"torque_constant_error[{i}]"), 0.0))
            torque = _friction(view, robot, friction, name, i, v, columns[f"{name}.torque_gear[{i}]"])
            columns[channel] = columns[channel] + per_axis * np.interp(view.run.t - late, view.run.t, torque)
    return {c: columns[c] for c in view.channels}


def _simulated(view: View, values: Mapping[Address, float]) -> dict[str, FloatArray]:
    system = view.driven
    for (component, name), value in physical(dict(values)).items():
        system = system.with_parameters(component, {name: value + float(system.component(component).parameters.get(name, 0.0))})
    result = simulated(system, None, stop=float(view.run.t[-1]), resolver=resolve, convert=convert)
    return {c: np.interp(view.run.t, result.t, x) for c, x in result.columns.items() if c.startswith("robot.")}


def _friction(
    view: View, robot: Robot, values: Mapping[Address, float], name: str, joint: int, v: FloatArray, gear: FloatArray
) -> FloatArray:
    """Friction [N.m, axis side]: v / sqrt(v^2 + w^2) is in place of tanh(v / w), 1 / (1 + (v / v_s)^2) of exp(-(v / v_s)^2)."""

    def of(kind: str) -> float:
        return values.get((name, f"friction_{kind}[{joint}]"), 0.0)

    turns, falls = (PARAMETERS[view.case.name][k] * by for k, by in enumerate((robot.rounding, robot.stribeck)))
    sense = v / np.hypot(v, turns)
    dry = of("coulomb") + of("stribeck") / (1.0 + (v / falls) ** 2) + of("load") * np.abs(gear)
    return np.asarray(of("viscous") * v + dry * sense + of("asymmetry") * sense**2)


PARAMETERS = {"kuka_kr300": (1e-3, 0.02), "ur10": (5e-3, 0.02)}
"""friction_smooth_speed and stribeck_speed [rad/s] of the nominal systems."""


def scored(case: Case, given: Sequence[Run], held: Sequence[Run], noise: Noise, seed: int) -> Score:
    """One robot: made, measured, diagnosed."""
    rng = np.random.default_rng([seed, RECORDINGS.index(case.name)])
    robot = drawn(case, rng)
    logs = []
    for r in (*given, *held):
        clean = measured(View(case, r, case.system()), robot)
        logs.append(replace(r, columns={**r.columns, **{c: x + noise.drawn(c, r.t, rng) for c, x in clean.items()}}))
    runs, others = logs[: len(given)], logs[len(given) :]
    began = time.process_time()
    found = diagnose(case.system(), runs, case.catalogue(), held_out=others, resolver=resolve, convert=convert)
    return judged(case, robot, runs, others, found, seed, time.process_time() - began)


def judged(case: Case, robot: Robot, runs: Sequence[Run], others: Sequence[Run], found: Diagnosis, seed: int, cpu: float) -> Score:
    """The answer beside the truth."""
    by_name = {c.name: c for c in case.catalogue().candidates}
    true = {n for n, c in by_name.items() if c.addresses[0] in robot.values}
    there = true | {n for n, c in by_name.items() if c.addresses[0] in robot.small}
    named = {f"{w.effect} @ {w.location}": w for w in found.answer.which if w.probability >= NAMED and w.material}
    view = View(replace(case, band=0.0), runs[0], case.system())
    gap, whole = {c: runs[0].columns[c] - x for c, x in _simulated(view, {}).items() if c in view.channels}, measured(view, robot)
    wanted = set()
    for n in true:
        without = measured(view, robot, by_name[n].addresses)
        if any(np.mean((whole[c] - without[c]) ** 2) >= MATERIAL * np.mean(gap[c] ** 2) for c in view.channels):
            wanted.add(n)
    false = [n for n in named if n not in there]
    twins = [n for n in false if _twins(n) & true]
    inside, widths = [], []
    for n in named.keys() & true:
        for (component, p), e in ((a, named[n].parameters[a[1]]) for a in by_name[n].addresses if a[1] in named[n].parameters):
            truth = robot.values[component, p]
            inside.append(e.interval[0] <= truth <= e.interval[1])
            widths.append(0.5 * (e.interval[1] - e.interval[0]) / abs(truth))
    shown = View(case, others[0], case.system())
    closed, clean = closures([shown], found.adopted), measured(shown, robot)
    rest = shown.measured - shown.shown(np.stack([clean[c] for c in shown.channels], axis=1))
    noise = [float(np.mean(rest[on, i] ** 2)) for i, on in enumerate(shown.counts.T)]
    possible = [1.0 - square / closed[c][0] ** 2 for c, square in zip(shown.channels, noise, strict=True)]
    stated = max((h.closure for h in found.answer.how_far if h.closure is not None), default=0.0)
    return Score(
        case.name,
        seed,
        found.answer.verdict,
        robot.otherwise,
        len(wanted),
        len(wanted & named.keys()),
        len(named),
        tuple(n for n in false if n not in twins),
        len(twins),
        sum(inside),
        len(inside),
        tuple(widths),
        tuple(c[2] for c in closed.values()),
        tuple(possible),
        stated,
        cpu,
    )


def _twins(name: str) -> set[str]:
    effect, _, place = name.partition(" @ ")
    return {f"{t} @ {place}" for t in TWINS} if effect in TWINS else set()


def wilson(hits: int, count: int) -> str:
    """`0.88 (0.80 to 0.93) 71/81`: a rate with its 95 % interval (Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    if not count:
        return "-"
    z, p = 1.96, hits / count
    middle, half = p + z * z / (2 * count), z * math.sqrt(p * (1 - p) / count + z * z / (4 * count * count))
    low, high = ((middle + s * half) / (1 + z * z / count) for s in (-1, 1))
    return f"{p:.2f} ({max(low, 0.0):.2f} to {min(high, 1.0):.2f}), {hits} of {count}"


def table(scores: Sequence[Score]) -> list[str]:
    """Rows of a Markdown table: one of each recording and law of friction, and of all."""
    heads = (
        "robots",
        "answered",
        "effects named that are there",
        "named that are not there",
        "truth in the 90 % interval",
        "half an interval over the value, median",
        "held-out channel: closed, median (by the truth)",
        "closed over what the truth closes: least, median",
        "largest closure stated",
        "CPU s",
    )
    lines = [row(heads), row(["---"] * len(heads))]
    names = list(dict.fromkeys(s.recording for s in scores))
    groups = [
        (f"{n}, friction {'of another law' if o else 'as in the catalogue'}", [s for s in scores if s.recording == n and s.otherwise == o])
        for n in names
        for o in (False, True)
    ]
    for title, some in [*groups, ("all", list(scores))]:
        if not some:
            continue
        verdicts = [s.verdict for s in some]
        pairs = np.array([p for s in some for p in zip(s.closure, s.possible, strict=True) if p[1] >= CLOSING]).reshape(-1, 2)
        closed, possible = pairs.T
        widths = [w for s in some for w in s.widths]
        lines.append(
            row(
                (
                    title,
                    ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts)),
                    wilson(sum(s.found for s in some), sum(s.wanted for s in some)),
                    wilson(sum(len(s.wrong) for s in some), sum(s.named for s in some)),
                    wilson(sum(s.inside for s in some), sum(s.numbers for s in some)),
                    f"{100 * float(np.median(widths)):.1f} %" if widths else "-",
                    f"{100 * float(np.median(closed)):.1f} % ({100 * float(np.median(possible)):.1f} %)",
                    f"{float((closed / possible).min()):.2f}, {float(np.median(closed / possible)):.2f}",
                    f"{100 * max(s.largest for s in some):.1f} %",
                    f"{sum(s.cpu for s in some) / len(some):.0f}",
                )
            )
        )
    return lines


def text(scores: Sequence[Score], seeds: str) -> str:
    """The page."""
    wrong = [f"{s.recording}, seed {s.seed}: {', '.join(s.wrong)}" for s in scores if s.wrong]
    return "\n".join(
        [
            "# Recordings of which the truth is known",
            "",
            f"Written by `python -m benchmarks.recordings.synthetic --seeds {seeds} --page FILE`; do not edit.",
            "",
            (__doc__ or "").partition("\n\n")[2].strip(),
            "",
            *table(scores),
            "",
            f"Named: a probability of {NAMED:g} or more, and {100 * MATERIAL:g} % of a channel closed. So large are the effects that",
            "should be named, too. Not there: neither in the robot nor the twin of what is (Coulomb, Stribeck and load friction of one",
            "joint). Rates with their 95 % intervals (Wilson). Closure: of the channels of which the truth closes half or more.",
            "",
            f"Named for a twin: {sum(s.twins for s in scores)}. Not there: {'; '.join(wrong) or 'none'}.",
            "",
        ]
    )


def main() -> int:
    """Print the page, and write it."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("names", nargs="*", metavar="NAME", help=f"one or more of {', '.join(RECORDINGS)}; without: all")
    options.add_argument("--seeds", default="1-3", metavar="FIRST-LAST", help="one robot of each recording for each seed; without: 1-3")
    options.add_argument("--page", type=Path, metavar="FILE", help="write the page there")
    given = options.parse_args()
    if wrong := [n for n in given.names if n not in RECORDINGS]:
        options.error(f"unknown recording {wrong[0]!r}; there are {', '.join(RECORDINGS)}")
    first, _, last = given.seeds.partition("-")
    scores = []
    with TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared"
        prepare(prepared)
        for case in cases():
            if case.name in (given.names or RECORDINGS):
                runs, held = case.runs(Path(folder) / case.name, prepared)
                noise = noise_of(case, runs)
                for seed in range(int(first), int(last or first) + 1):
                    scores.append(scored(case, runs, held, noise, seed))
                    print(scores[-1], file=sys.stderr, flush=True)
    page = text(scores, given.seeds)
    print(page)
    if given.page:
        given.page.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
