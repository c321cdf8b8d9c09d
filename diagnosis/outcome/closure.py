"""How far the gap shrinks: the closed loop simulated again with the adopted effects, against held-out runs.

G = mean over pairs of repeats a != b of r_a' W r_b: noise cancels. With a single run: r' W r less what noise is expected to give; where
that is a guess it is not taken off, because nothing may be closed that was not measured.
Closure = 1 - G_after / G_before. Intervals: bootstrap over blocks of time. Ceiling: the closure of what is the same in every repeat
(path-locked mean), cross-fitted: the mean that a repeat is compared with does not hold that repeat. Of a condition that was measured
once: what a regression closes (`ceiling`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robomill.diagnosis.experiment.repeats import RESAMPLES
from robomill.orchestration.slaves.protocol import FloatArray

BLOCKS = 24
"""Blocks of time that a condition is divided into."""


@dataclass(frozen=True)
class Products:
    """Sums over each block of time, [blocks], in the square of the unit of the figure."""

    before: FloatArray
    """G of the nominal simulation."""
    after: FloatArray
    """G with the adopted effects."""
    noise: FloatArray
    """What noise is expected to give for a single run."""
    floor: FloatArray
    """What is left when the mean of other repeats (or what a regression makes of the gap) is taken away, noise taken off."""
    regressed: bool
    """Whether the floor is that of a regression."""
    kept: FloatArray
    """Noise that is a guess: it was taken off `before`, `after` and `floor`, and stays in what is said of them."""
    samples: FloatArray
    """Samples in the block."""
    roundoff: FloatArray
    """What the arithmetic of the simulations may make of the measured values: half of their digits are trusted."""


@dataclass(frozen=True)
class HowFar:
    """How far the gap of one figure shrinks on one kind of runs."""

    metric: str
    """What people call the figure."""
    channel: str
    """Measured array that it is of; `all channels, whitened` is the whole gap."""
    unit: str
    """Unit of the figure."""
    on: str
    """"diagnosed runs", "held-out repeat" or "held-out condition"."""
    before: float
    """Root mean square of the gap with the nominal system [unit]; noise is taken off unless it is a guess."""
    after: float
    """Root mean square with the adopted effects [unit]; noise is taken off unless it is a guess."""
    floor: float
    """Root mean square of noise [unit]."""
    closure: float | None = None
    """1 - G_after / G_before, G the square of the gap; null where the gap is not `measurable`."""
    interval: list[float] | None = None
    """90 % interval of the closure."""
    ceiling: float | None = None
    """Closure that any model could have."""
    ceiling_by: str | None = None
    """What says so: "repeats" or "regression"."""
    ratio: float | None = None
    """`closure` / `ceiling`, if that is more than 0."""
    measurable: bool = True
    """Whether the gap is large enough beside the noise."""
    within_noise: bool = False
    """Whether what is left with the adopted effects is not measurable, and no more than the noise: `after` may be nothing."""
    why_no_ceiling: str | None = None
    """Why there is no ceiling, in words."""


Halves = tuple[FloatArray, FloatArray]
"""Two independent simulations (or means of them) of the same thing, [samples, channels]."""


def products(
    measured: Sequence[FloatArray],
    before: Halves,
    after: Halves,
    variance: FloatArray,
    others: Sequence[FloatArray] = (),
    predicted: FloatArray | None = None,
    *,
    guessed: bool = False,
) -> Products:
    """Sums over blocks; `measured` repeats [samples, channels], simulated `before` and `after`, `variance` of noise per channel.

    `others`: repeats of the same condition that were diagnosed; their mean is what a perfect model would know. Without them each repeat is
    compared with the mean of the rest of `measured`: what is left beyond noise does not come again, and no model can have it.
    A single repeat is compared with what is `predicted` of its gap, [samples, channels]. `guessed`: `variance` is no more than a guess.
    """
    rows = min(len(x) for x in (*measured, *before, *after, *others))
    edges = np.linspace(0, rows, min(BLOCKS, max(2, rows // 4)) + 1).astype(int)
    stack = np.stack([m[:rows] for m in measured])
    n = len(stack)

    def pairs(one: FloatArray, other: FloatArray, known: float) -> FloatArray:
        a, b = stack - one[:rows], stack - other[:rows]
        same = (a * b).sum(axis=(0, 2))
        per_sample = ((a.sum(axis=0) * b.sum(axis=0)).sum(axis=1) - same) / (n * (n - 1)) if n > 1 else same - variance.sum()
        return np.array([per_sample[i:j].sum() - known * (j - i) for i, j in itertools.pairwise(edges)])

    if others:
        mean = np.mean([o[:rows] for o in others], axis=0)
        floor = pairs(mean, mean, float(variance.sum()) / len(others))
    elif n > 1:
        rest = (stack.sum(axis=0) - stack) / (n - 1)
        unlike = ((stack - rest) ** 2).mean(axis=0).sum(axis=1)
        known = float(variance.sum()) * n / (n - 1)
        floor = np.array([(unlike[i:j] - known).sum() for i, j in itertools.pairwise(edges)])
    else:
        assert predicted is not None, "a single repeat has no ceiling but what is predicted"
        simulated = 0.5 * (before[0][:rows] + before[1][:rows]) + predicted[:rows]
        floor = pairs(simulated, simulated, 0.0)
    regressed = not others and n == 1
    lengths = np.diff(edges).astype(np.float64)
    noise = lengths * float(variance.sum())
    kept = noise if guessed and n == 1 else np.zeros_like(noise)
    squares = np.finfo(np.float64).eps * (stack**2).mean(axis=0).sum(axis=1)
    roundoff = np.array([squares[i:j].sum() for i, j in itertools.pairwise(edges)])
    return Products(pairs(*before, 0.0), pairs(*after, 0.0), noise, floor, regressed, kept, lengths, roundoff)


def figures(parts: Sequence[Products], metric: str = "", channel: str = "", unit: str = "1", on: str = "") -> HowFar:
    """How far the gap shrinks over several conditions; `metric`, `channel`, `unit` and `on` say of which figure, and where.

    closure = 1 - sum of `after` / sum of `before`, ceiling = 1 - sum of `floor` / sum of `before`, over all blocks; the interval (90 %)
    is that of blocks drawn anew.
    """
    before, after, floor, samples, noise, kept, roundoff = (
        np.concatenate([getattr(p, name) for p in parts]) for name in ("before", "after", "floor", "samples", "noise", "kept", "roundoff")
    )
    rng = np.random.default_rng(0)
    choice = rng.integers(0, len(before), (RESAMPLES, len(before)))
    least = [float(np.quantile(x[choice].sum(axis=1), 0.05)) for x in (before, after)]
    over = max(0.05 * noise.sum() / max(np.sqrt(len(before)), 1.0), roundoff.sum())
    measurable = bool(least[0] > 0.0 and before.sum() > over)
    within = bool(least[1] <= 0.0 and after.sum() <= noise.sum())  # a short part that is far off is in few of the blocks
    before, after, floor = before + kept, after + kept, floor + kept
    rms, left, size = (float(np.sqrt(max(x.sum(), 0.0) / samples.sum())) for x in (before, after, noise))
    common = (metric, channel, unit, on, rms, left, size)
    if not measurable:
        why = "the gap before is not measurable: its interval includes 0"
        return HowFar(*common, measurable=False, within_noise=within, why_no_ceiling=why)
    closed = 1.0 - after[choice].sum(axis=1) / np.maximum(before[choice].sum(axis=1), 1e-300)
    closure = min(float(1.0 - after.sum() / before.sum()), 1.0)  # no more than what there was
    interval = [min(float(np.quantile(closed, q)), 1.0) for q in (0.05, 0.95)]
    ceiling = min(1.0, 1.0 - float(floor.sum()) / float(before.sum()))
    ceiling = max(ceiling, closure)  # what is closed can be closed
    by = "regression" if any(p.regressed for p in parts) else "repeats"
    ratio = closure / ceiling if ceiling > 0.0 else None
    return HowFar(*common, closure, interval, ceiling, by, ratio, within_noise=within)
