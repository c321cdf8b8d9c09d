"""The repeats of a condition beside each other: copies, clocks that were started at other times, and one that is nothing like the rest.

What is usual is what simulated repeats scatter (other seeds of their noise), or what most measured ones do where that is more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robomill.diagnosis.experiment.measured import ON_TIME
from robomill.diagnosis.gate.checks import REST, SINGLE, Finding
from robomill.diagnosis.inference.isolability import CONFUSABLE
from robomill.orchestration.slaves.protocol import FloatArray

COPY = 0.01
"""Distance of two repeats, over that of two which have noise of their own, below which one is a copy of the other, with rounding or a
little noise added (judgement): a sensor that is ten times as good as the simulated one is no copy."""
UNLIKE = 10.0
"""Distance of a repeat from the median of all over what is usual, from beyond which it is nothing like them (judgement)."""


def copies(group: Sequence[FloatArray], simulated: Sequence[FloatArray], names: Sequence[str]) -> list[Finding]:
    """Pairs of repeats [samples, channels] that have no noise between them; `simulated` repeats, `names` of the runs.

    Channels in which neither simulated nor other measured repeats scatter say nothing. A pair is a copy if it is one in all others.
    """
    if len(group) == 1:
        return []
    stack = np.stack(group)
    pairs = [(i, j) for i in range(len(stack)) for j in range(i)]
    apart = np.stack([((stack[i] - stack[j]) ** 2).mean(axis=0) for i, j in pairs])
    usual = np.maximum(apart.max(axis=0), 2.0 * scatter(simulated))
    says = usual > (SINGLE * np.abs(stack).max(axis=(0, 1)) / COPY) ** 2
    found = []
    for (i, j), distance in zip(pairs, apart, strict=True):
        ratio = float(np.sqrt((distance[says] / usual[says]).max())) if says.any() else 1.0
        if ratio < COPY:
            text = (
                f"of {names[i]} are those of {names[j]}: they differ by {ratio:.1g} times what repeats with noise of their own do; "
                f"expected about 1; there are {len(group)} repeats: give one of these two"
            )
            found.append(Finding("all channels", "copy", ratio, "1", text))
    return found


def scatter(group: Sequence[FloatArray]) -> FloatArray:
    """Variance of repeats about their mean [unit^2 per channel]; zero for a single one."""
    stack = np.stack(group)
    return np.asarray(((stack - stack.mean(axis=0)) ** 2).sum(axis=0).mean(axis=0) / max(len(stack) - 1, 1))


def usual_scatter(group: Sequence[FloatArray]) -> FloatArray:
    """The median of `scatter` over parts as long as the shortest standstill that is one (REST): one that is in a part is not in most."""
    parts = np.array_split(np.stack(group), round(1.0 / REST), axis=1)
    return np.asarray(np.median([scatter(list(p)) for p in parts if p.shape[1]], axis=0))


def offsets(group: Sequence[FloatArray], usual: FloatArray, step: float) -> FloatArray:
    """How late [s] each repeat is against the median of all, and the standard error of that, [repeats, 2].

    Least squares of its deviation along the rate of the median, each channel weighted by `usual` [unit^2]. The error is that of the
    deviation that is left, whose samples depend on each other over its correlation time (first order).
    """
    stack = np.stack(group)
    middle = np.median(stack, axis=0)
    weights = np.where(usual > 0.0, 1.0 / np.sqrt(np.where(usual > 0.0, usual, 1.0)), 0.0)
    rate, found = np.gradient(middle, step, axis=0) * weights, []
    energy = float((rate**2).sum())
    for deviation in (stack - middle) * weights:
        if energy == 0.0:
            found.append((0.0, np.inf))
            continue
        late = -float((rate * deviation).sum()) / energy
        left = deviation + late * rate
        squares = float((left**2).sum())
        after = float((left[1:] * left[:-1]).sum()) / squares if squares else 0.0
        memory = (1.0 + max(after, 0.0)) / (1.0 - min(after, 0.999))
        found.append((late, float(np.sqrt(squares / left.size * memory / energy))))
    return np.array(found)


def compared(
    group: Sequence[FloatArray], simulated: Sequence[FloatArray], channels: Sequence[str], names: Sequence[str], step: float
) -> list[Finding]:
    """Repeats that were started at another time (noted), and those that are unlike the others (fatal in more than half of the channels)."""
    if not group[2:]:  # of two, nobody can say which one is unlike the other
        return []
    stack = np.stack(group)
    middle = np.median(stack, axis=0)
    rounding = (SINGLE * np.abs(stack).max(axis=(0, 1))) ** 2
    measured = np.median(((stack - middle) ** 2).mean(axis=1), axis=0)
    rate = np.gradient(middle, step, axis=0)
    stamped = ((ON_TIME * step * rate) ** 2).mean(axis=0)  # a stamp that jitters moves a jump
    usual = np.maximum(np.maximum(scatter(simulated), measured), rounding + stamped)
    found = []
    for name, x, (late, error) in zip(names, stack, offsets(group, usual, step), strict=True):
        if abs(late) > max(CONFUSABLE * error, 0.5 * step):
            text = f"{name} is {1e3 * late:.3g} ms (standard error {1e3 * error:.2g} ms) later than the median of the repeats; expected 0"
            found.append(Finding("t", "offset", late, "s", text, fatal=False, run=name))
        off = ((x - middle) ** 2).mean(axis=0)
        if abs(late) < step:  # a clock that was started between two samples moves a jump
            off = np.minimum(off, ((x - middle + late * rate) ** 2).mean(axis=0))
        ratio = np.sqrt(np.divide(off, usual, out=np.zeros_like(off), where=usual > 0.0))
        worst = int(ratio.argmax())
        if ratio[worst] > UNLIKE:
            far = f"is {ratio[worst]:.0f} times as far from the other repeats as repeats are from each other ({name})"
            # what every start of a spindle does anew is seen in some channels, another program in most: in the middle one, too
            fatal = bool(np.quantile(ratio[usual > 0.0], 0.5, method="lower") > UNLIKE)
            text = f"{far}; expected about 1, at most {UNLIKE:.0f}" + (
                "; leave it out" if fatal else "; not so in most channels: it is kept"
            )
            found.append(Finding(channels[worst], "repeat", float(ratio[worst]), "1", text, fatal, run=name))
    return found
