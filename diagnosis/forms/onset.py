"""When an effect began: one that switches on, or begins to grow, during the runs; or that is there from one run on.

With v the whitened sensitivity of an effect of the catalogue, and t_0 its onset in a condition, the effect does v H(t - t_0) if it switches
on, and v (t - t_0)+ / T if it grows, in all runs of the condition alike. Between the runs: its size a_r in run r is 0 before run k.
The onset is believed if the Bayes factor against the same effect all the time, and against any other one all the time, exceeds the odds
that things are as they were (UNLISTED), the tries counted, and if it explains more of the gap than a law that is not quite right may leave
(MISFIT). Squares are counted in units
of what is left at the end: no more is sure than the model is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from robomill.diagnosis.candidates import LOGGING, Candidate
from robomill.diagnosis.forms.layout import Form
from robomill.diagnosis.inference.adequacy import LEVEL, MISFIT
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.search import SINGLES, Search
from robomill.diagnosis.localisation.where import WHOLE
from robomill.diagnosis.outcome.closure import BLOCKS
from robomill.diagnosis.outcome.how_far import DIAGNOSED
from robomill.diagnosis.outcome.verdict import UNLISTED
from robomill.models.components.correction import TIME
from robomill.orchestration.slaves.protocol import FloatArray

How = Literal["switches on", "grows"]


@dataclass(frozen=True)
class Onset:
    """An effect that was not there from the beginning."""

    effect: str
    """Name in the catalogue."""
    component: str
    """Component that has the effect."""
    location: str
    """Where in the component."""
    how: How
    """Whether it switches on or grows."""
    condition: str
    """Label of the runs in which it begins."""
    time: float | None
    """Onset in the runs of the condition [s]; None where it begins between two runs."""
    interval: list[float] | None
    """Its 90 % interval [s]; None where it begins between two runs."""
    run: int | None
    """Run of the condition, from 1, from which on it is there; None where it begins within them."""
    value: float
    """Size once it is there, or at the end of the run where it grows [unit]."""
    unit: str
    """Unit of the value."""
    rate: float | None
    """Growth per second [unit/s], where it grows."""
    gain: float
    """Log Bayes factor [nats] against the same effect, or a better one, all the time; of an onset between runs, against the same."""
    closes: float = 0.0
    """Part of the squares of the gap, each over its noise, that goes with it, 0..1."""
    named: bool = False
    """Whether the answer has the effect; else it is what the gap looks like."""

    @property
    def text(self) -> str:
        """In words."""
        what = f"{'' if self.named else 'something like '}{self.effect} at {self.location}"
        if self.run is not None:
            return f"{what} is there from run {self.run} of {self.condition} on, with {self.value:.4g} {self.unit}"
        low, high = self.interval or [math.nan, math.nan]
        when = f"t = {self.time:.3g} s ({low:.3g} to {high:.3g}) in {self.condition}"
        if self.how == "switches on":
            return f"{what} switches on at {when}, with {self.value:.4g} {self.unit}"
        return f"{what} grows from {when} on, by {self.rate:.4g} {self.unit}/s"


def onset_of(search: Search, right: Fit | None = None) -> Onset | None:
    """The onset of the effect that explains most with one, of a size that it may have; None where nothing speaks for an onset.

    `right`: the model that is believed. Then it is one of its effects, and what all its others do is no part of the gap.
    """
    best: tuple[float, Onset] | None = None
    does = right.signatures() if right is not None else {}
    of = [c for c in does if len(c.parameters) == 1 and c.component != LOGGING] if right is not None else _looked_at(search)
    other = {c: sum((s for d, s in does.items() if d != c), np.zeros_like(search.evidence.space.y)) for c in of}
    usual = min((_always(search, c, other[c]) for c in of), default=math.inf)
    if right is not None:  # slopes say less of a large effect than its simulation
        usual = min(usual, search.chi2(right))
    for c in of:
        for found in (_within(search, c, usual, other[c]), _between(search, c, other[c])):
            if found is not None and _may_be(c, found[1].value) and (best is None or found[0] < best[0]):
                best = found
    if best is None:
        return None
    space = search.evidence.space
    return replace(best[1], closes=1.0 - best[0] / space.square(space.y))


def stands(onset: Onset, form: Form | None) -> bool:
    """Whether an onset is still what the gap looks like, beside a form that was found for it.

    A law that is there all the time, and closes as much of the diagnosed runs in the loop, is in its place. An effect that the answer has
    begins all the same.
    """
    if onset.named or form is None or not form.specification:
        return True
    of_time = any(f["variable"] == TIME for term in form.specification["terms"] for f in term["factors"])
    closed = [h.closure for h in form.how_far if h.channel == WHOLE and h.on == DIAGNOSED and h.closure is not None]
    return of_time or max(closed, default=0.0) < onset.closes


def _may_be(c: Candidate, value: float) -> bool:
    """Whether an effect may have this size [unit], by its sign, its largest one and its smallest that counts in the catalogue."""
    low, high = c.bounds
    return low <= value <= high and abs(value) >= c.minimum


def _sensitivity(search: Search, c: Candidate) -> FloatArray:
    """Whitened change [n] per prior scale."""
    start = search.starts.get(c.addresses[0])
    return search.evidence.sensitivities[c.addresses[0]] if start is None else start.signature / start.x


def _looked_at(search: Search) -> list[Candidate]:
    """Candidates of one parameter that explain most of the residual, in the whole of the runs or in one half of each."""
    space = search.evidence.space
    halves = np.concatenate([2 * np.arange(b.stop - b.start) < b.stop - b.start for b in space.blocks.values()])

    def explained(c: Candidate) -> float:
        v = _sensitivity(search, c)
        return max(float(space.y @ (v * part)) ** 2 / (float(v @ (v * part)) + 1e-300) for part in (1.0, halves, ~halves))

    fit = [c for c in search.candidates if len(c.parameters) == 1 and c.component != LOGGING]
    return sorted(fit, key=lambda c: -explained(c))[:SINGLES]


def _always(search: Search, c: Candidate, other: FloatArray) -> float:
    """Squares that an effect leaves which is there all the time, with a size of its own in each condition; `other` [n]: what others do."""
    space, v = search.evidence.space, _sensitivity(search, c)
    together = [*(_only(v, b) for b in space.blocks.values()), space.y - other]
    products = space.without(c.addresses).within(space.gram(np.stack(together).T), range(len(together)))
    size, along = np.diag(products)[:-1], products[-1, :-1]
    return float(products[-1, -1] - np.where(size > 0.0, along**2 / np.where(size > 0.0, size, 1.0), 0.0).sum())


def _within(search: Search, c: Candidate, usual_left: float, other: FloatArray) -> tuple[float, Onset] | None:
    """(squares left, onset) of an effect that begins within the runs of a condition.

    `usual_left`: squares that the best effect leaves which is there all the time; `other` [n]: what others do.
    """
    space, channels = search.evidence.space, int(search.evidence.active.sum())
    v = _sensitivity(search, c)
    blocks = list(space.blocks.items())
    constant = [_only(v, b) for _, b in blocks]
    own = space.without(c.addresses)
    columns: list[FloatArray] = []
    for _, b in blocks:
        rows = (b.stop - b.start) // channels
        at = np.arange(rows)
        for begin in np.linspace(0.0, rows, BLOCKS + 1)[1:-1]:
            for shape in (at >= begin, np.maximum(at - begin, 0.0) / rows):
                columns.append(_only(v, b, np.repeat(shape.astype(np.float64), channels)))
    together = [*constant, *columns, space.y - other]
    products = own.within(space.gram(np.stack(together).T), range(len(together)))
    n = len(blocks)
    square, along, size = products[-1, -1], products[:-1, -1], np.diag(products)[:-1]
    gains = np.where(size > 0.0, along**2 / np.where(size > 0.0, size, 1.0), 0.0)
    usual = gains[:n]
    per = 2 * (BLOCKS - 1)
    profile = gains[n:].reshape(n, BLOCKS - 1, 2)
    tops = profile.reshape(n, per).max(axis=1)
    i = int((tops - usual).argmax())
    left = float(square - usual.sum() + usual[i] - tops[i])
    unit = max(left / search.evidence.noise, 1.0)
    always = float(square - usual.sum())
    gain = min(always, usual_left) - left
    if not _believed(search, gain, always, unit, per * n):
        return None
    k, way = np.unravel_index(int(profile[i].argmax()), profile[i].shape)
    condition = search.simulator.laboratory.conditions[i]
    grid = condition.grid
    times = grid[0] + np.linspace(0.0, 1.0, BLOCKS + 1)[1:-1] * (grid[-1] - grid[0])
    near = np.flatnonzero(profile[i, :, way] >= profile[i, k, way] - 1.645 * 1.645 * unit)
    step = float(times[1] - times[0])
    j = n + i * per + int(k) * 2 + int(way)
    value = float(along[j] / size[j]) * c.prior.scale
    length = float(grid[-1] - grid[0])
    grows = bool(way)
    end = value * (float(grid[-1]) - float(times[k])) / length if grows else value
    onset = Onset(
        c.effect,
        c.component,
        c.location,
        "grows" if grows else "switches on",
        condition.name,
        float(times[k]),
        [float(times[near[0]]) - step, float(times[near[-1]]) + step],
        None,
        end,
        c.unit,
        value / length if grows else None,
        0.5 * gain / unit,
    )
    return left, onset


def _between(search: Search, c: Candidate, other: FloatArray) -> tuple[float, Onset] | None:
    """(squares left, onset) of an effect that is there from one run of a condition on; runs in the order in which they were given.

    `other` [n]: what others do.
    """
    evidence = search.evidence
    v = _sensitivity(search, c)
    best: tuple[float, Onset] | None = None
    for i, (block, residuals) in enumerate(zip(evidence.space.blocks.values(), evidence.residuals, strict=True)):
        if len(residuals) <= 2:  # noqa: PLR2004  # of two runs, one with and one without are as much noise as onset
            continue
        w = v[block] / math.sqrt(evidence.repeats[i])
        size = float(w @ w)
        if size <= 0.0:
            continue
        rest = other[block] / math.sqrt(evidence.repeats[i])
        sizes = np.array([float(w @ (r.ravel() - rest)) for r in residuals]) / size
        mean = float(sizes.mean())
        usual = size * float(((sizes - mean) ** 2).sum())
        lefts = {k: size * float((sizes[:k] ** 2).sum() + ((sizes[k:] - sizes[k:].mean()) ** 2).sum()) for k in range(1, len(sizes))}
        k = min(lefts, key=lambda n: lefts[n])
        unit = max(lefts[k] / (len(sizes) - 1), 1.0)
        if not _believed(search, usual - lefts[k], usual + size * len(sizes) * mean**2, unit, len(lefts)):
            continue
        value, name = float(sizes[k:].mean()) * c.prior.scale, search.simulator.laboratory.conditions[i].name
        gain = 0.5 * (usual - lefts[k]) / unit
        onset = Onset(c.effect, c.component, c.location, "switches on", name, None, None, k + 1, value, c.unit, None, gain)
        gap = evidence.space.y - other
        left = evidence.space.square(gap) - size * float((sizes[k:] ** 2).sum())
        if best is None or left < best[0]:
            best = left, onset
    return best


def _believed(search: Search, gain: float, gap: float, unit: float, tries: int) -> bool:
    """Whether squares that an onset explains beyond the constant effect speak for it; `unit`: squares left per expected one."""
    beyond = max(gap - LEVEL * search.evidence.noise, 0.0)
    return 0.5 * gain / unit - math.log(tries) > math.log((1.0 - UNLISTED) / UNLISTED) and gain > MISFIT * beyond


def _only(v: FloatArray, block: slice, shape: FloatArray | float = 1.0) -> FloatArray:
    """A sensitivity in one condition, with a shape in time [rows of it]."""
    out = np.zeros_like(v)
    out[block] = v[block] * shape
    return out
