"""How far the gap shrinks: the closed loop simulated again with the adopted effects, against held-out runs.

G = mean over pairs of repeats a != b of r_a' W r_b: noise cancels. With a single run: r' W r less what noise is expected to give.
Closure = 1 - G_after / G_before. Intervals: bootstrap over blocks of time. Ceiling: the closure of what is the same in every repeat
(path-locked mean), cross-fitted: the mean that a repeat is compared with does not hold that repeat. Of a condition that was measured
once: what a regression closes (`ceiling`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robomill.orchestration.slaves.protocol import FloatArray

BLOCKS, RESAMPLES = 24, 1000


@dataclass(frozen=True)
class Products:
    """Per block of time: G before, G after, and what is left when the mean of other repeats is taken away."""

    before: FloatArray
    after: FloatArray
    noise: FloatArray
    floor: FloatArray
    regressed: bool
    """Whether the floor is that of a regression."""
    samples: FloatArray


Halves = tuple[FloatArray, FloatArray]
"""Two independent simulations (or means of them) of the same thing, [samples, channels]."""


def products(
    measured: Sequence[FloatArray],
    before: Halves,
    after: Halves,
    variance: FloatArray,
    others: Sequence[FloatArray] = (),
    predicted: FloatArray | None = None,
) -> Products:
    """Sums over blocks; `measured` repeats [samples, channels], simulated `before` and `after`, `variance` of noise per channel.

    `others`: repeats of the same condition that were diagnosed; their mean is what a perfect model would know. Without them each repeat is
    compared with the mean of the rest of `measured`: what is left beyond noise does not come again, and no model can have it.
    A single repeat is compared with what is `predicted` of its gap, [samples, channels].
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
    return Products(pairs(*before, 0.0), pairs(*after, 0.0), lengths * float(variance.sum()), floor, regressed, lengths)


def figures(parts: Sequence[Products], seed: int = 0) -> dict[str, Any]:
    """Root mean squares before and after, closure, its interval, ceiling and closure / ceiling (`ratio`), over several conditions.

    `why_no_ceiling` is the reason where there is none.
    """
    before, after = np.concatenate([p.before for p in parts]), np.concatenate([p.after for p in parts])
    samples, noise = np.concatenate([p.samples for p in parts]), np.concatenate([p.noise for p in parts])
    rng = np.random.default_rng(seed)
    choice = rng.integers(0, len(before), (RESAMPLES, len(before)))
    b, a = before[choice].sum(axis=1), after[choice].sum(axis=1)
    measurable = bool(np.quantile(b, 0.05) > 0.0 and before.sum() > 0.05 * noise.sum() / max(np.sqrt(len(before)), 1.0))
    result: dict[str, Any] = {
        "before": float(np.sqrt(max(before.sum(), 0.0) / samples.sum())),
        "after": float(np.sqrt(max(after.sum(), 0.0) / samples.sum())),
        "floor": float(np.sqrt(noise.sum() / samples.sum())),
        "closure": None,
        "interval": None,
        "ceiling": None,
        "ceiling_by": None,
        "ratio": None,
        "measurable": measurable,
        "why_no_ceiling": None if measurable else "the gap before is not measurable: its interval includes 0",
    }
    if measurable:
        ratio = 1.0 - a / np.maximum(b, 1e-300)
        result["closure"] = min(float(1.0 - after.sum() / before.sum()), 1.0)  # no more than what there was
        result["interval"] = [min(float(np.quantile(ratio, q)), 1.0) for q in (0.05, 0.95)]
        ceiling = min(1.0, 1.0 - sum(float(p.floor.sum()) for p in parts) / float(before.sum()))
        result["ceiling"] = max(ceiling, result["closure"])  # what is closed can be closed
        result["ceiling_by"] = "regression" if any(p.regressed for p in parts) else "repeats"
        result["ratio"] = result["closure"] / result["ceiling"] if result["ceiling"] > 0.0 else None
    return result
