"""The answer: what diagnosis.json holds, and what the report draws."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from robomill.diagnosis.candidates import Address
from robomill.diagnosis.experiment.design import Kind
from robomill.diagnosis.experiment.segments import Structure
from robomill.diagnosis.experiment.simulation import Laboratory, Simulator, decimate
from robomill.diagnosis.forms.instead import Instead
from robomill.diagnosis.forms.layout import Form
from robomill.diagnosis.forms.onset import Onset
from robomill.diagnosis.gate import checks as gate
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.intervals import MATERIAL
from robomill.diagnosis.inference.isolability import Pair
from robomill.diagnosis.inference.time_varying import Changing
from robomill.diagnosis.inference.transfer import Transfer
from robomill.diagnosis.localisation.localise import Projection
from robomill.diagnosis.localisation.replay_attribution import Reading
from robomill.diagnosis.localisation.swap import Share
from robomill.diagnosis.localisation.where import WHOLE, Where
from robomill.diagnosis.outcome.calibration import Pulled
from robomill.diagnosis.outcome.closure import HowFar
from robomill.diagnosis.outcome.families import Family
from robomill.diagnosis.outcome.how_far import HARDEST_FIRST
from robomill.diagnosis.outcome.next_run import NextRun
from robomill.diagnosis.outcome.reasons import Reason
from robomill.diagnosis.outcome.steps import Steps
from robomill.diagnosis.outcome.verdict import Tests, Verdict, believed
from robomill.orchestration.slaves.protocol import FloatArray, PortData, base_name

SCHEMA = "robomill-diagnosis/1"
NULL = ("next_run", "interval", "nearest", "held_out", "p", "closure", "ceiling", "ceiling_by", "ratio", "why_no_ceiling")
"""What is null in diagnosis.json where there is none; the rest is not there."""
REPLAYED = ("component", "share", "interval", "log_odds", "alternatives", "outputs", "location", "nearest")
"""What an entry of `where` that comes from replay and swaps begins with in diagnosis.json."""


@dataclass(frozen=True)
class Menu:
    """What the engine is told about the domain: coordinates to project on, and runs that could be made next."""

    projections: Mapping[str, Projection] = field(default_factory=dict)
    """output -> the coordinates (joints) that its residual is projected on."""
    kinds: Callable[[], Sequence[Kind]] = tuple
    """Kinds of runs that could be made next; called when they are needed."""


@dataclass(frozen=True)
class Estimate:
    """Fitted value of a parameter."""

    value: float
    """Fitted value, in `unit`."""
    interval: list[float]
    """90 %."""
    unit: str
    """Unit of the parameter."""
    given: float | None = None
    """What the parameter is in the system, where that is not zero [unit]: the value comes on top."""

    @property
    def text(self) -> str:
        """In words: value, interval, unit, and what they come on top of."""
        on_top = "" if self.given is None else f" on top of {self.given:.4g}"
        return f"{self.value:.4g} [{self.interval[0]:.4g} .. {self.interval[1]:.4g}] {self.unit}{on_top}"


@dataclass(frozen=True)
class Which:
    """A candidate of the catalogue that may be the cause."""

    effect: str
    """Name in the catalogue."""
    component: str
    """Component that has the effect."""
    location: str
    """Where in the component, by the catalogue."""
    probability: float
    """Probability that the effect is there, 0..1."""
    parameters: dict[str, Estimate]
    """Parameter of the component -> its value in the likeliest model that has the candidate."""
    confusable_with: list[str]
    """Names of candidates that the runs cannot tell from it."""
    closes: float | None = None
    """Part of the squares of the gap that it closes beside all the others, in the channel where that is most; None with repeats."""

    @property
    def material(self) -> bool:
        """Whether it counts as a cause, and is not only listed: it closes MATERIAL of a channel, or nobody knows."""
        return self.closes is None or self.closes >= MATERIAL


@dataclass(frozen=True)
class Number:
    """A number of the model that the catalogue lacks, and that explains the gap by itself, or with some effects."""

    component: str
    """Component that has it."""
    parameter: str
    """Parameter of the component, with its index."""
    estimate: Estimate
    """What comes on top of what it is in the system."""
    probability: float
    """Probability that it is right rather than something else that nobody listed, as `tests.p_fit` of an effect, 0..1."""
    instead_of: tuple[str, ...]
    """Names of the effects that do no more together; empty where no effects were believed."""
    beside: tuple[str, ...] = ()
    """Names of the effects that it explains the gap with."""

    @property
    def name(self) -> str:
        """`spring.k[1]`."""
        return f"{self.component}.{self.parameter}"

    @property
    def becomes(self) -> list[float]:
        """Value of the parameter and its 90 % interval [its unit]."""
        given = self.estimate.given or 0.0
        return [given + x for x in (self.estimate.value, *self.estimate.interval)]

    @property
    def text(self) -> str:
        """In words: the value, its interval, what the system has, the effects beside it, and those that do no more together."""
        value, low, high = self.becomes
        unit = "" if self.estimate.unit == "1" else f" {self.estimate.unit}"
        others = f", which does as much as {' + '.join(self.instead_of)}" if self.instead_of else ""
        beside = f", beside {' + '.join(self.beside)}" if self.beside else ""
        return f"{self.name} is {value:.4g} [{low:.4g} .. {high:.4g}]{unit} instead of {self.estimate.given:.4g}{beside}{others}"


@dataclass(frozen=True)
class Gap:
    """Whitened squares summed over the diagnosed runs, noise taken off (`Search.gap`)."""

    before: float
    """With the nominal system."""
    within_calibration: float
    """Part of `before` that the tolerances of calibrated numbers explain."""
    after: float
    """With the best model and these tolerances."""
    noise: float
    """Standard deviation of `after` by noise."""
    unexplained: float
    """Share of what is beyond noise and calibration that the best model leaves, 0..1."""
    noise_is_a_guess: bool
    """Whether nothing was repeated, of held-out runs either."""
    farthest: Pulled | None = None
    """With `none`: the calibrated number that is farthest off, within its tolerance or not."""


@dataclass(frozen=True)
class Unknown:
    """What is known of an effect that is not in the catalogue: where and when the best model leaves most, or as the replay has it."""

    channels: dict[str, float]
    """Channel -> its share in what the best model leaves, 0..1, largest first."""
    component: str
    """Component that is blamed."""
    direction: str
    """As in `Where`."""
    regime: list[list[float]]
    """As in `Where`."""
    nearest: str
    """Name of the best model."""
    why: tuple[Reason, ...] = ()
    """What speaks against that model (`outcome.reasons`)."""
    changes: Changing | None = None
    """What it is like if it changes with time."""
    instead: tuple[Instead, ...] = ()
    """Laws of no name that do better than an effect of the best model in its place, the largest gain first (`forms.instead`)."""


@dataclass(frozen=True)
class Visible:
    """The smallest value of a parameter that would have been seen."""

    effect: str
    """Name in the catalogue."""
    location: str
    """Where in the component."""
    parameter: str
    """Parameter of the component."""
    value: float
    """SHOWS standard deviations (`visibility`) [unit]; infinite where it does not show."""
    unit: str
    """Unit of the parameter."""


@dataclass(frozen=True)
class Effort:
    """What the diagnosis took."""

    seconds: float = 0.0
    """Wall-clock time [s]."""
    simulations: int = 0
    """Simulations that were run."""
    taken_over: int = 0
    """Simulations that were there already."""


@dataclass(frozen=True)
class Answer:
    """What diagnosis.json holds, in its order; what is None is not part of this answer."""

    verdict: Verdict
    """`identified`: one cause; `ambiguous`: several that the runs cannot tell apart; `unknown`: an effect that is not in the catalogue;
    `none`: no effect; `bad_log`: the log cannot be used."""
    findings: tuple[gate.Finding, ...] = ()
    """What is to be said of the log."""
    where: tuple[Where, ...] = ()
    """Largest share first."""
    which: tuple[Which, ...] = ()
    """Likeliest first."""
    families: tuple[Family, ...] = ()
    """Effects that count as one, or that cannot be told apart; likeliest first."""
    how_far: tuple[HowFar, ...] = ()
    """How far the gap closes with the adopted effects, or with the `number`, if there is one."""
    steps: Steps | None = None
    """The accepted effects one after the other."""
    next_run: NextRun | None = None
    """The run that would tell the likely models apart best; null where none is needed."""
    isolability: tuple[Pair, ...] | None = None
    """Pairs of effects that the runs cannot tell apart."""
    gap: Gap | None = None
    """Size of the gap, before and after."""
    tests: Tests | None = None
    """What the verdict rests on."""
    transfer: Transfer | None = None
    """What the best model is worth in held-out conditions."""
    smallest_visible: tuple[Visible, ...] | None = None
    """Smallest values of effects that would have been seen."""
    probability_none: float | None = None
    """Probability that there is no effect."""
    replay: tuple[Reading, ...] | None = None
    """What replay of single components leaves."""
    swap: tuple[Share, ...] | None = None
    """Share of each component in each figure."""
    structure: Structure | None = None
    """What the connections alone say."""
    not_replayed: str | None = None
    """Why the replay failed, or which outputs it left out."""
    predictive: dict[str, dict[str, float]] | None = None
    """Model -> condition -> gain in log score there [nats] when it is fitted to the others."""
    unknown: Unknown | None = None
    """What is known of an effect that is not in the catalogue."""
    number: Number | None = None
    """The number of the model, in no catalogue, that explains the gap by itself, if one does."""
    form: Form | None = None
    """What the law is like that is in no catalogue (`forms.layout`)."""
    onset: Onset | None = None
    """When an effect began, where something speaks for it that it was not there all the time."""
    calibrated: tuple[Pulled, ...] | None = None
    """Calibrated numbers that the best model needs farther off than their tolerances say."""
    effort: Effort = field(default_factory=Effort)
    """What the diagnosis took."""
    skipped: tuple[str, ...] = ()
    """What of the catalogue the system does not have, in words."""

    @property
    def closer(self) -> HowFar | None:
        """How far the nearest effects close the whole gap, in the hardest test of the form, if that is more than the form does there."""
        formed = {h.on: h.closure for h in (self.form.how_far if self.form else ()) if h.channel == WHOLE and h.closure is not None}
        kind = next((k for k in HARDEST_FIRST if k in formed), None)
        nearest = next((h for h in self.how_far if h.on == kind and h.channel == WHOLE and h.closure is not None), None)
        return nearest if kind and nearest and (nearest.closure or 0.0) > formed[kind] else None

    @property
    def suspected(self) -> tuple[Which, ...]:
        """What may be there though the answer is `none`.

        Where noise is a guess it may be as slow as an effect that is believed. Elsewhere an effect is likelier than none, and not as sure
        as the false-alarm rate asks.
        """
        if self.verdict != "none" or (t := self.tests) is None or t.p_none > t.false_alarm:
            return ()
        if not (self.guessed and believed(t)) and not t.false_alarm < t.nothing < 1.0 - t.nothing:
            return ()
        return tuple(w for w in self.which if w.probability > 1.0 - w.probability)

    @property
    def guessed(self) -> bool:
        """Whether the answer rests on a guess of the noise."""
        return self.gap is not None and self.gap.noise_is_a_guess


@dataclass(frozen=True)
class Diagnosis:
    """The answer, `adopted`: the values [unit] that adopt.ssv holds, and more for the report."""

    answer: Answer
    adopted: dict[Address, float]
    fits: tuple[Fit, ...] = ()
    channels: tuple[str, ...] = ()
    curves: Mapping[str, dict[str, FloatArray]] = field(default_factory=dict)
    """condition -> t [samples]; measured (mean of the repeats), nominal, adopted [samples, channels]; spread (standard
    deviation) of the repeats [channels], 0 for a single one. Without `adopted` where nothing was fitted."""
    ports: Mapping[str, PortData] = field(default_factory=dict)
    """channel -> the port of the system that it was measured at."""
    titles: Mapping[str, str] = field(default_factory=dict)
    """array -> what the difference there is called; those that count as figures of their own."""

    @property
    def result(self) -> dict[str, Any]:
        """What diagnosis.json holds."""
        return to_json(self.answer)


def titles_of(named: Mapping[str, str], ports: Mapping[str, PortData]) -> dict[str, str]:
    """The measured arrays that the catalogue has a name for; all with the description of their port (or its name), if there is none."""
    arrays: dict[str, list[PortData]] = {}
    for channel, port in ports.items():
        arrays.setdefault(base_name(channel), []).append(port)
    known = {array: title for array, title in named.items() if array in arrays}
    return known or {array: _described(array, members) for array, members in arrays.items()}


def _described(array: str, members: Sequence[PortData]) -> str:
    """Elements that are described one by one have no description in common."""
    common = {p.description for p in members}
    text = common.pop() if len(common) == 1 else ""
    return f"{text} ({array})" if text else array


def to_json(answer: Answer) -> dict[str, Any]:
    """The data of diagnosis.json: the fields of the answer, with four differences.

    `schema` is the first key. `findings` stand in `gate`, beside `usable`: whether the log is good enough. Of `shares` only share and
    interval are kept, of `unknown.changes` the effect that it is `like`, `how` and the `gain`. `transfer` has `promise` and `worth`, too.
    """
    data = asdict(answer, dict_factory=_there)
    found = {"usable": answer.verdict != "bad_log", "findings": data.pop("findings")}
    data = {"schema": SCHEMA, "verdict": answer.verdict, "gate": found, **data}
    for w in data["where"]:
        if "shares" in w:
            w["shares"] = {figure: {"share": s["share"], "interval": s["interval"]} for figure, s in w["shares"].items()}
    data["where"] = [{k: w[k] for k in REPLAYED} | w if "nearest" in w else w for w in data["where"]]
    if answer.transfer is not None:
        data["transfer"] |= {"promise": answer.transfer.promise, "worth": answer.transfer.worth}
    if known := answer.unknown:
        data["unknown"]["channels"] = [{"channel": c, "share": share} for c, share in known.channels.items()]
        if other := known.changes:
            data["unknown"]["changes"] = {"like": other.candidate.name, "how": other.how, "gain": other.by_change}
    if answer.onset is not None:
        data["onset"]["text"] = answer.onset.text
    if answer.gap is None:  # a log that the gate refused
        data["effort"] = data.pop("effort")
    return data


def _there(fields: list[tuple[str, Any]]) -> dict[str, Any]:
    """Fields of a record without what is None and not in NULL."""
    return {k: list(v) if isinstance(v, tuple) else v for k, v in fields if v is not None or k in NULL}


def as_json(result: Mapping[str, Any]) -> str:
    """The text of diagnosis.json. Numbers that are none (a value that nothing determines) are null: JSON has no other word for them."""
    return json.dumps(_finite(result), indent=1, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def effort_of(began: float, simulator: Simulator) -> Effort:
    """What it took so far; `began`: when, by the monotonic clock [s]."""
    return Effort(round(time.monotonic() - began, 1), simulator.count, simulator.found)


def curves_of(
    laboratory: Laboratory,
    groups: Sequence[Sequence[FloatArray]],
    nominal: Sequence[Sequence[FloatArray] | None],
    adopted: Sequence[Sequence[FloatArray] | None] = (),
) -> dict[str, dict[str, FloatArray]]:
    """See `Diagnosis.curves`; for as many conditions as were simulated, without those that cannot run."""
    curves = {}
    for i, before in enumerate(nominal):
        after = adopted[i] if adopted else ()
        if before is None or after is None:
            continue
        c, repeats = laboratory.conditions[i], np.stack(groups[i])
        found = curves[f"{c.name}{' (held out)' if c.held_out else ''}"] = {
            "t": decimate(c.grid[:, None], laboratory.factor(i))[:, 0],
            "measured": repeats.mean(axis=0),
            "spread": np.sqrt(repeats.var(axis=0, ddof=min(1, len(repeats) - 1)).mean(axis=0)),
            "nominal": np.mean(before, axis=0),
        }
        if after:
            found["adopted"] = np.mean(after, axis=0)
    return curves
