"""Where the gap lies: replay finds who is to blame, swaps say how much of the gap that is; then the place inside."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.candidates import Candidate, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.measured import DataError
from robomill.diagnosis.experiment.repeats import as_share
from robomill.diagnosis.experiment.segments import Structure, structure
from robomill.diagnosis.experiment.simulation import Laboratory
from robomill.diagnosis.inference.marginal import TEMPERATURE
from robomill.diagnosis.inference.search import GROWTH_GAIN
from robomill.diagnosis.localisation import localise
from robomill.diagnosis.localisation.localise import Dependence, Projection
from robomill.diagnosis.localisation.replay_attribution import Reading, Replay, not_alone
from robomill.diagnosis.localisation.swap import PLAYERS, Share, shares
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.runs.recorder import frame_of
from robomill.orchestration.slaves.protocol import FloatArray, base_name

MINOR, INSIDE = 2e-3, 0.1
"""Part of what is explained already that one more component must add; the same where those before could have done all that it does."""
BLAMED = 3
"""Components that are blamed at most."""
CLOSE = 0.6
"""Part of the evidence that makes another component one that could be to blame as well, where no effect of the catalogue explains the
residual: then what else the components can do says little about which of them did it."""
WHOLE = "all channels, whitened"
"""The figure of the whole gap."""
EXTRA = ("log_odds", "alternatives", "outputs", "alignment", "shares", "dependence")
"""What replay and swaps add to a component that was fitted."""
ALIGNED = 0.9
"""Alignment of the residual with one coordinate from which that is named."""


@dataclass(frozen=True)
class Blame:
    """A component whose replay leaves more than noise and the tolerances of calibrated numbers."""

    component: str
    log_odds: float
    """That it is one of them against that it is not; tempered."""
    alternatives: tuple[str, ...]
    """Components that the replay cannot tell from it."""


@dataclass(frozen=True)
class Where:
    """What is said of a component that has a share in the gap; what replay and swaps add (EXTRA) is None where they do not blame it."""

    component: str
    """Component that is blamed."""
    share: float
    """Part of the whole gap, whitened, 0..1."""
    interval: list[float] | None
    """90 % interval of the share; None where nothing was repeated."""
    location: str
    """Place in the component; "" where nobody knows."""
    direction: str
    """Axis of a frame (`B.y`) in which it shows most; the channel again where there is none."""
    channel: str
    """Channel in which it shows most."""
    regime: list[list[float]]
    """Times when it is there, [from, to] [s]."""
    log_odds: float | None = None
    """Log of the odds that the component is to blame."""
    alternatives: tuple[str, ...] | None = None
    """Components that the replay cannot tell from it."""
    outputs: tuple[str, ...] | None = None
    """Measured outputs in its reach whose replay leaves more than noise."""
    alignment: dict[str, float] | None = None
    """Coordinate -> alignment of the residual with it, 0..1; None where an output has no coordinates too."""
    shares: dict[str, Share] | None = None
    """Figure -> its share in the gap there."""
    dependence: list[Dependence] | None = None
    """What the residual depends on, strongest first; then the bands of frequency that it is in."""


@dataclass(frozen=True)
class Replayed(Where):
    """A component as replay and swaps alone blame it."""

    nearest: str | None = None
    """Candidate of the catalogue that explains most of what is left there; None where none explains any of it."""


@dataclass(frozen=True)
class Located:
    """Components to blame by replay, and what that rests on."""

    where: tuple[Replayed, ...] = ()
    replay: tuple[Reading, ...] = ()
    swap: tuple[Share, ...] = ()
    structure: Structure | None = None
    not_replayed: str | None = None
    """Why the replay failed, if it did, or which outputs it left out."""


def blame(replay: Replay) -> tuple[Blame, ...]:
    """The components to blame, highest log of the odds first: added one by one as long as the evidence grows clearly.

    Log of the odds of c: evidence of all the blamed ones less that of them without c [nats, tempered]. One more has GROWTH_GAIN of it,
    like an effect in a model; another that is less than half as much behind could be to blame as well.
    """
    known: dict[frozenset[str], float] = {}

    def evidence(members: frozenset[str]) -> float:
        if members not in known:
            known[members] = replay.evidence(sorted(members))
        return known[members]

    nothing = evidence(frozenset())
    members: frozenset[str] = frozenset()
    order: list[str] = []
    while len(order) < min(BLAMED, len(replay.effects)):
        best = max((c for c in replay.effects if c not in members), key=lambda c: evidence(members | {c}))
        gain, before = evidence(members | {best}) - evidence(members), evidence(members) - nothing
        reached = set().union(*(replay.reach[c] for c in members))
        if gain < max(GROWTH_GAIN, (INSIDE if replay.reach[best] <= reached else MINOR) * before):
            break
        members |= {best}
        order.append(best)
    while len(order) > 1:  # one that others have made needless
        weakest = min(order, key=lambda c: -evidence(members - {c}))
        if evidence(members) - evidence(members - {weakest}) >= GROWTH_GAIN:
            break
        members -= {weakest}
        order.remove(weakest)
    found = []
    for c in order:
        without = evidence(members - {c})
        least = evidence(members) - 0.5 * GROWTH_GAIN
        if replay.unexplained(sorted(members), c):
            least = min(least, without + CLOSE * (evidence(members) - without))
        others = [o for o in replay.effects if o not in members and evidence(members - {c} | {o}) > least]
        found.append(Blame(c, evidence(members) - evidence(members - {c}), tuple(others)))
    return tuple(sorted(found, key=lambda b: -b.log_odds))


def locate(replay: Replay, figures: Mapping[str, FloatArray], projections: Mapping[str, Projection]) -> Located:
    """Who is to blame by replay, and how much of the gap that is by swaps.

    `figures`: name -> weight of each channel; the whole gap, whitened, is added to them. `projections`: output array -> projection.
    """
    readings = replay.readings()
    blamed = blame(replay)
    left = [r for r in sorted(readings, key=lambda r: -r.unexplained) if r.significant]
    for b in blamed:  # seen only in all its outputs together
        mine = [r for r in readings if b.component in r.components]
        if mine and not any(r in left for r in mine):
            left.append(max(mine, key=lambda r: r.unexplained))
    players = list(dict.fromkeys(r.output.partition(".")[0] for r in left))[:PLAYERS] if blamed else []
    all_figures = {WHOLE: replay.weights, **figures}
    swapped = shares(replay.replayed, players, all_figures) if players else []
    where = (_entry(replay, b, blamed, swapped, [r.output for r in left], projections) for b in blamed)
    left_out = not_alone(replay.adding) if replay.adding else None
    return Located(tuple(where), tuple(readings), tuple(swapped), not_replayed=left_out)


def _entry(
    replay: Replay,
    b: Blame,
    blamed: Sequence[Blame],
    swapped: Sequence[Share],
    significant: Sequence[str],
    projections: Mapping[str, Projection],
) -> Replayed:
    """What is said of one component."""
    parts: dict[str, list[FloatArray]] = {}
    for s in swapped:
        part = replay.part(b.component, [x.component for x in blamed], s.component)
        parts.setdefault(s.figure, []).append(part * np.array([s.share, *(s.interval or ())]))
    totals = {}
    for figure, p in parts.items():
        share, *interval = (as_share(float(x)) for x in np.sum(p, axis=0))
        totals[figure] = Share(figure, b.component, share, interval or None)
    whole = totals.pop(WHOLE, Share(WHOLE, b.component, 0.0, None))
    inside = Inside(replay, b.component, [x.component for x in blamed if x is not b])
    outputs = [o for o in significant if replay.arrays.index(o) in replay.reach[b.component]]
    (condition, strongest), regime = replay.worst(inside.left, outputs)
    channel, nearest = replay.channels[strongest], inside.candidate()
    alignment = next((inside.aligned(array, projections[array], condition) for array in outputs if array in projections), {})
    location = nearest.location if nearest is not None else ""
    if alignment and max(alignment.values()) >= ALIGNED and inside.unexplained:
        location = max(alignment, key=lambda k: alignment[k])
    return Replayed(
        b.component,
        whole.share,
        whole.interval,
        location,
        direction_of(channel),
        channel,
        regime,
        b.log_odds,
        b.alternatives,
        tuple(outputs),
        alignment or None,
        totals,
        inside.dependence(outputs),
        nearest.name if nearest is not None else None,
    )


def direction_of(channel: str) -> str:
    """`compliance.p_BT_B[2]` -> B.y; the channel itself where it is not one of three axes."""
    port = channel.partition(".")[2]
    match = re.fullmatch(r"(\w+)\[([123])\]", port)
    if not match:
        return channel
    frame = frame_of(match[1])
    return f"{frame}.{'xyz'[int(match[2]) - 1]}" if frame else channel


class Inside:
    """One component that is to blame: which part, when, depending on what. What the others to blame can do is taken off."""

    def __init__(self, replay: Replay, component: str, others: Sequence[str]) -> None:
        self.replay, self.component = replay, component
        self.unexplained = replay.unexplained(sorted({component, *others}), component)
        known = np.concatenate([replay.doubt, *(replay.effects[o] for o in others)], axis=1)
        self._inner = np.linalg.inv(np.eye(known.shape[1]) + known.T @ known)
        self._known = known
        self.left = self._without(replay.y)

    def _without(self, v: FloatArray) -> FloatArray:
        out: FloatArray = v - self._known @ (self._inner @ (self._known.T @ v))
        return out

    def candidate(self) -> Candidate | None:
        """The place in the catalogue that explains most of the residual r of the replay by itself; None where none explains any of it.

        Explained: g' (V' r(V) + I)^-1 g with g = V'r, V the sensitivities of its parameters and r(V) what the others leave of them.
        """
        replay, best, most = self.replay, None, 0.0
        for c in replay.candidates:
            if c.component != self.component or not all(a in replay.sensitivities for a in c.addresses):
                continue
            v = np.stack([replay.sensitivities[a] for a in c.addresses], axis=1)
            gain = v.T @ self.left
            explained = float(gain @ np.linalg.solve(v.T @ self._without(v) + np.eye(v.shape[1]), gain))
            if explained > most:
                best, most = c, explained
        return best

    def aligned(self, array: str, projection: Projection, condition: int) -> dict[str, float]:
        """Alignment of the residual of an output with each coordinate, name -> 0..1; empty where what it needs is not measured."""
        replay = self.replay
        replayed, here = replay.replayed[condition], replay.at[replay.of == replay.arrays.index(array)]
        try:
            jacobian = projection.jacobian(replayed.signals())
        except KeyError:
            return {}
        noise = np.var(np.stack(replayed.residuals), axis=0, ddof=min(1, len(replayed.residuals) - 1)).mean(axis=0)[here] / len(
            replayed.residuals
        )
        values = localise.alignment(np.mean(replayed.residuals, axis=0)[:, here], jacobian, noise)
        return {name: float(v) for name, v in zip(projection.names, values, strict=True)}

    def dependence(self, outputs: Sequence[str]) -> list[Dependence]:
        """Variables that the residual depends on, and the bands of frequency that it is in."""
        replay = self.replay
        if not outputs:
            return []
        (condition, _), _ = replay.worst(self.left, outputs)
        replayed = replay.replayed[condition]
        channels = np.flatnonzero(np.isin(replay.of, [replay.arrays.index(o) for o in outputs]))
        residual = replay.table(self.left, condition)[:, channels]
        inputs = replayed.inputs[self.component]
        found = localise.dependences(
            residual,
            localise.variables(inputs, {c: replayed.unit(c) for c in inputs}, replayed.grid),
            lambda s: replay.filtered(s, channels),
            TEMPERATURE,
        )
        return found + [
            Dependence(f"frequency {a:g} .. {b:g} Hz", s, None)
            for (a, b), s in localise.bands(
                np.mean(replayed.residuals, axis=0)[:, replay.at[channels]] / replay.noise[channels], replayed.step
            )
        ]


def located(
    laboratory: Laboratory,
    n: int,
    catalogue: Catalogue,
    nuisances: Sequence[Nuisance],
    figures: Mapping[str, FloatArray],
    projections: Mapping[str, Projection],
) -> Located:
    """`locate` on those of the first `n` conditions that the system itself made. Nothing is said where it cannot be replayed."""
    own = [i for i in range(n) if laboratory.conditions[i].system is None]
    cuts = structure(laboratory.system, list(dict.fromkeys(map(base_name, laboratory.channels))))
    if not own:
        return Located(structure=cuts)
    every, laboratory = laboratory.channels, laboratory.shown_in(own)
    kept = [every.index(c) for c in laboratory.channels]
    figures = {name: weights[kept] for name, weights in figures.items()}
    try:
        return replace(locate(Replay(laboratory, own, catalogue, nuisances), figures, projections), structure=cuts)
    except (DataError, OrchestrationError) as error:
        return Located(structure=cuts, not_replayed=str(error))


def combined(verdict: str, fitted: Sequence[Where], found: Sequence[Replayed]) -> tuple[Where, ...]:
    """`where` of the fitted effects and that of replay and swaps as one list, largest share first.

    What is fitted says more about a component, but only of effects in the catalogue. So with `unknown`, and where the fits are
    ambiguous and the replay clears the component that they blame first, the replay decides.
    """
    possible = {c for w in found for c in (w.component, *(w.alternatives or ()))}
    cleared = bool(found) and bool(fitted) and fitted[0].component not in possible
    if found and (verdict == "unknown" or (verdict == "ambiguous" and cleared)):
        return tuple(sorted(found, key=lambda w: -w.share))
    extra = {w.component: {k: getattr(w, k) for k in EXTRA} for w in found}
    return tuple(replace(w, **extra.get(w.component, {})) for w in fitted)
