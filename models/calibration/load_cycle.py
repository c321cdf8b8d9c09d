"""Stiffness, hysteresis and backlash of one axis from load/unload cycles.

Englert 2011 (paper 004), section 3.1: torque about an axis and the angle that it turns by, Figs. 3.1 and 3.3, k = M/dphi (Eq. 3.1).
A loop has no one slope, so four are told apart. All slopes are those of lines of the torque over the angle, in N.m/rad:

    whole              all samples of all complete cycles
    loading end        the last fifth of the torque, of branches that go outwards: friction slips, the spring alone is left
    unloading start    the first fifth after a reversal: friction sticks and adds its stiffness

The gap is the step of the angle where the torque changes its sign; in a small cycle friction does not slip and the loop hides nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from robomill.models.model.declaration import FloatArray

END = 0.2
"""Part of the largest torque that the slopes at the ends of a branch are taken from."""
MIDDLE = (0.04, 0.15)
"""Parts of the largest torque before zero that the width of the loop is taken from: beyond the noise about zero, near it."""
COMPLETE = 0.8
"""Part of the largest torque that a branch reaches on both sides, to be half a cycle."""
REVERSAL = 0.1
"""Part of the range of the torque that it falls back by where a branch ends: more than its noise."""
FEWEST = 5
"""Samples that a line goes through at least."""
TRANSITION = 0.1
"""Part of the largest torque on either side of zero that is left out of the step: flanks touch one after the other."""
CONFIDENCE = 0.95
"""Probability of the interval of the gap."""


@dataclass(frozen=True)
class Slope:
    """A stiffness, N.m/rad, with its standard error over the branches (NaN with one branch)."""

    value: float
    error: float


@dataclass(frozen=True)
class CycleFit:
    """What load/unload cycles say of an axis."""

    whole: Slope
    loading_end: Slope
    unloading_start: Slope
    amplitude: float
    """Largest torque that all branches reach, N.m."""
    twist: float
    """Largest minus smallest angle, rad."""
    width: float
    """Angle between the branches at zero torque, gap included, rad."""
    work: float
    """Loss per cycle, J."""
    half_cycles: tuple[tuple[int, int], ...]
    """First and last sample of each complete branch."""

    @property
    def friction(self) -> float:
        """Half the mean height of the loop, N.m: the friction torque, or less where it does not slip all the way."""
        return 0.5 * self.work / self.twist

    @property
    def hysteresis(self) -> float:
        """Width at zero torque over the twist."""
        return self.width / self.twist


@dataclass(frozen=True)
class GapFit:
    """The gap of an axis from a small cycle."""

    gap: float
    """Between the flanks, rad."""
    interval: tuple[float, float]
    """Interval of the gap, with the probability `CONFIDENCE`, rad."""
    slope: float
    """Stiffness beside the gap, N.m/rad."""
    width: float
    """Angle between the branches at zero torque, gap included, rad."""
    branches: FloatArray
    """The gap of each branch, rad."""

    @property
    def finding(self) -> str:
        """`determined`, or `not determined: why`."""
        if self.interval[0] <= 0.0:
            return "not determined: the interval holds zero"
        if self.width - self.gap > self.gap:
            return (
                f"not determined: without it the loop is still {1e6 * (self.width - self.gap):.0f} urad wide at zero torque, so friction "
                "slips; measure a smaller cycle"
            )
        return "determined"


def half_cycles(torque: FloatArray) -> tuple[tuple[int, int], ...]:
    """First and last sample of each branch that goes from one end of the torque [n] N.m to the other.

    A first loading from zero is none. ValueError says how far the branches reach if no complete cycle is there.
    """
    low, high = float(torque.min()), float(torque.max())
    threshold, amplitude = REVERSAL * (high - low), min(-low, high)
    turns, extreme, direction = [0], 0, 0.0
    for i, value in enumerate(torque):
        if direction == 0.0 and abs(value - torque[0]) > threshold:
            direction, extreme = float(np.sign(value - torque[0])), i
        elif direction * (value - torque[extreme]) > 0.0:
            extreme = i
        elif direction and direction * (torque[extreme] - value) > threshold:
            turns.append(extreme)
            direction, extreme = -direction, i
    if direction:
        turns.append(extreme)
    ends = itertools.pairwise(turns)
    found = tuple((a, b) for a, b in ends if min(-np.sign(torque[b]) * torque[a], abs(torque[b])) >= COMPLETE * amplitude > 0.0)
    if len(found) < 2:
        raise ValueError(
            f"load cycle: {len(found)} complete branches in {len(torque)} samples, torque from {low:.4g} to {high:.4g} N.m; expected at "
            "least two, from one end to the other and back: load the axis both ways, through zero"
        )
    return found


def fit_cycle(torque: FloatArray, angle: FloatArray) -> CycleFit:
    """Slopes, width and loss of the loops that `torque` [n] N.m and `angle` [n] rad go through, in the order of time.

    Errors: ValueError for values that are not finite, for no complete cycle, and for too few samples where a slope is taken.
    """
    _check(torque, angle)
    branches = half_cycles(torque)
    amplitude = min(min(abs(torque[a]), abs(torque[b])) for a, b in branches)
    ends: list[float] = []
    starts: list[float] = []
    works: list[float] = []
    edges: dict[float, list[float]] = {1.0: [], -1.0: []}
    for a, b in branches:
        up, M, phi = float(np.sign(torque[b] - torque[a])), torque[a : b + 1], angle[a : b + 1]
        ends.append(_slope(phi, M, up * M > (1.0 - END) * amplitude, "end of loading"))
        starts.append(_slope(phi, M, up * M < -(1.0 - END) * amplitude, "start of unloading"))
        before = (up * M < -MIDDLE[0] * amplitude) & (up * M > -MIDDLE[1] * amplitude)
        _enough(before, "side of zero")
        edges[up].append(float(np.polynomial.Polynomial.fit(M[before], phi[before], 1)(0.0)))
        works.append(float(np.sum(0.5 * (M[1:] + M[:-1]) * np.diff(phi))))
    used = np.concatenate([np.arange(a, b + 1) for a, b in branches])
    slope = float(np.polyfit(angle[used] - angle[used].mean(), torque[used], 1)[0])
    single = [float(np.polyfit(angle[a : b + 1] - angle[a], torque[a : b + 1], 1)[0]) for a, b in branches]
    return CycleFit(
        Slope(slope, _mean(single).error),
        _mean(ends),
        _mean(starts),
        float(amplitude),
        float(np.ptp(angle[used])),
        float(np.mean(edges[-1.0]) - np.mean(edges[1.0])),
        float(2.0 * np.mean(works)),
        branches,
    )


def fit_gap(torque: FloatArray, angle: FloatArray) -> GapFit:
    """Gap between the flanks from the step of `angle` [n] rad where `torque` [n] N.m changes sign, in a small cycle.

    phi = a + M/k + c M^2 + gap/2 sign(M) on each complete branch, without the tenth of the torque about zero. The interval is that of
    Student's t of the branches; a branch counts as no surer than its own residuals say. Errors as of `fit_cycle`.
    """
    cycle = fit_cycle(torque, angle)
    gaps, errors, slopes = [], [], []
    for a, b in cycle.half_cycles:
        M, phi = torque[a : b + 1], angle[a : b + 1]
        kept = np.abs(M) > TRANSITION * cycle.amplitude
        x = M[kept] / cycle.amplitude
        design = np.stack([np.ones_like(x), x, x**2, 0.5 * np.sign(x)], axis=1)
        if min(int(np.sum(x > 0.0)), int(np.sum(x < 0.0))) < FEWEST:
            raise ValueError(f"load cycle: a branch has {len(x)} samples beside zero, expected {FEWEST} on each side; sample faster")
        found, _, _, _ = np.linalg.lstsq(design, phi[kept], rcond=None)
        scatter = float(np.sum((phi[kept] - design @ found) ** 2)) / (len(x) - design.shape[1])
        gaps.append(float(found[3]))
        errors.append(scatter * float(np.linalg.inv(design.T @ design)[3, 3]))
        slopes.append(cycle.amplitude / float(found[1]))
    n, gap = len(gaps), float(np.mean(gaps))
    spread = max(float(np.var(gaps, ddof=1)), float(np.mean(errors)))
    half = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, n - 1)) * float(np.sqrt(spread / n))
    return GapFit(gap, (gap - half, gap + half), float(np.mean(slopes)), cycle.width, np.array(gaps))


def _check(torque: FloatArray, angle: FloatArray) -> None:
    if torque.shape != angle.shape or torque.ndim != 1:
        raise ValueError(f"load cycle: torque has shape {torque.shape}, angle {angle.shape}; expected two columns of the same length")
    for name, values in (("torque", torque), ("angle", angle)):
        if not np.all(np.isfinite(values)):
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            raise ValueError(f"load cycle: {name} of sample {row + 1} is {values[row]}, expected finite numbers; leave the cycle out")


def _enough(chosen: FloatArray, where: str) -> None:
    if int(chosen.sum()) < FEWEST:
        raise ValueError(
            f"load cycle: {int(chosen.sum())} samples at the {where} of a branch, expected {FEWEST}; sample faster, or load slower"
        )


def _slope(phi: FloatArray, M: FloatArray, chosen: FloatArray, where: str) -> float:
    """Slope N.m/rad of the line of the torque over the angle through the chosen samples."""
    _enough(chosen, where)
    x, y = phi[chosen] - phi[chosen].mean(), M[chosen] - M[chosen].mean()
    together = float(x @ y)
    if together <= 0.0:
        raise ValueError(f"load cycle: the angle does not grow with the torque at the {where} of a branch; check the signs and the sensor")
    return together / float(x @ x)


def _mean(values: Sequence[float]) -> Slope:
    error = float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")
    return Slope(float(np.mean(values)), error)
