"""What a report is about, and how its things are called in sentences."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.localisation.where import WHOLE, Replayed
from robomill.diagnosis.outcome.answer import Answer, Diagnosis, Number, Which
from robomill.diagnosis.outcome.closure import HowFar
from robomill.diagnosis.outcome.how_far import CONDITION, DIAGNOSED, REPEAT
from robomill.diagnosis.outcome.reasons import WHY
from robomill.diagnosis.outcome.verdict import IDENTIFIED, believed
from robomill.orchestration.runs.recorder import frame_of
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray, base_name
from robomill.orchestration.system.definition import System
from robomill.report.units import join, number, percent, percent_interval, quantity, relative, scale

HELD_OUT = " (held out)"
KINDS = {CONDITION: "new conditions", REPEAT: "held-out repeats", DIAGNOSED: "the diagnosed runs"}
"""Where the closure is measured, the hardest test first, and what that is called in a sentence."""
ALL = "all signals, each over its noise"
"""What the figure of the whole gap is called."""
_JOINTS = re.compile(r"(q|torque|correction_q)(_[a-z]+)?")
"""Ports whose elements are joints, not the axes of a frame."""
CAUSES = 4
"""Causes that a sentence names one by one, at most; more are put together by kinds, and of possible ones the rest is counted."""


@dataclass(frozen=True)
class Subject:
    """A diagnosis with all that was given to it."""

    found: Diagnosis
    system: System
    runs: Sequence[Run]
    catalogue: Catalogue
    made: str = ""
    """When, and with which version, in words."""

    @property
    def answer(self) -> Answer:
        """What diagnosis.json holds."""
        return self.found.answer

    @property
    def titles(self) -> Mapping[str, str]:
        """Array -> what people call the difference between machine and simulation there."""
        return self.found.titles

    @property
    def verdict(self) -> str:
        """One of none, identified, ambiguous, unknown, bad_log."""
        return self.answer.verdict

    @property
    def left(self) -> float:
        """Share of what is beyond noise and calibration that the best model leaves; 0 where none was fitted."""
        return self.answer.gap.unexplained if self.answer.gap else 0.0

    @cached_property
    def conditions(self) -> list[str]:
        """Conditions that were simulated: diagnosed ones, held-out conditions, held-out repeats."""
        curves = list(self.found.curves)
        return sorted(curves, key=lambda c: (c.endswith(HELD_OUT), c.removesuffix(HELD_OUT) in curves))

    def index(self, channel: str) -> int:
        """Column of the curves that a channel is."""
        return self.found.channels.index(channel)

    def unit(self, channel: str) -> str:
        """Unit of a channel or array; "" where nobody knows."""
        measured = (r.unit(channel) for r in self.runs if channel in r.columns or base_name(channel) in map(base_name, r.columns))
        return next((u for u in measured if u), "") or next(
            (p.unit or "" for c, p in self.found.ports.items() if base_name(c) == base_name(channel)), ""
        )

    def gap(self, condition: str, channel: str, simulated: str = "nominal") -> FloatArray:
        """Measured mean minus simulation, [samples]."""
        curves, i = self.found.curves[condition], self.index(channel)
        difference: FloatArray = curves["measured"][:, i] - curves[simulated][:, i]
        return difference

    def loudness(self, condition: str, simulated: str = "nominal") -> dict[str, float]:
        """Rms of the gap of each channel in deviations of the repeats (in its own rms where there is one run only)."""
        curves = self.found.curves[condition]
        rms = np.sqrt(np.mean((curves["measured"] - curves[simulated]) ** 2, axis=0))
        # what is planned and does not vary has no noise; differences there of rounding size are none
        own = np.sqrt(np.mean(curves["measured"] ** 2, axis=0))
        noise = np.where(curves["spread"] > 1e-9 * own, curves["spread"], np.where(own > 0.0, own, np.inf))
        return dict(zip(self.found.channels, map(float, rms / noise), strict=True))

    def loudest(self, condition: str, simulated: str = "nominal") -> list[str]:
        """The channel with the largest gap of each array that has a title (of all, where none has), largest first."""
        best: dict[str, tuple[float, str]] = {}
        for channel, size in self.loudness(condition, simulated).items():
            if not self.titles or base_name(channel) in self.titles:
                best[base_name(channel)] = max(best.get(base_name(channel), (-1.0, "")), (size, channel))
        return [channel for _, channel in sorted(best.values(), key=lambda b: -b[0])]

    def label(self, channel: str) -> str:
        """`drive.q_motor[3]` -> `motor angle error, joint 3`; `compliance.p_BT_B[2]` -> `tool-tip path error, y`."""
        base = base_name(channel)
        title = self.titles.get(base, base)
        index = channel[len(base) :].strip("[]")
        if not index:
            return title
        port = base.partition(".")[2]
        if _JOINTS.fullmatch(port):
            return f"{title}, joint {index}"
        if frame_of(port) and index in ("1", "2", "3"):
            return f"{title}, {'xyz'[int(index) - 1]}"
        return channel if title == base else f"{title}, element {index}"

    def said(self, array: str) -> str:
        """Within a sentence: `tool-tip path error`; where only the port is described, `the gap in motor torques`."""
        title = self.titles.get(array, array)
        text = title.removesuffix(f" ({array})")
        return title if text == title and title != array else f"the gap in {text[:1].lower() + text[1:] if text != array else array}"

    @property
    def sure(self) -> list[Which]:
        """Entries of `which` that are believed; without those that are too small to be a cause, if others are there."""
        believed = [w for w in self.answer.which if w.probability >= IDENTIFIED]
        return [w for w in believed if w.material] or believed

    @property
    def blamed(self) -> list[Replayed]:
        """Entries of `where` that come from replay and swaps, because no effect of the catalogue explains the gap."""
        return [w for w in self.answer.where if isinstance(w, Replayed)]

    @property
    def hardest(self) -> str | None:
        """The hardest kind of test that the closure was measured in; None where it was not."""
        return hardest(self.answer.how_far)

    def far(self, kind: str | None, channel: str) -> HowFar | None:
        """Entry of `how_far` for an array on one kind of runs."""
        return next((h for h in self.answer.how_far if h.on == kind and h.channel == channel), None)

    def figures(self, kind: str | None) -> list[HowFar]:
        """Entries of `how_far` on one kind of runs in the order of the titles, without the whole gap."""
        order = list(self.titles)
        found = [h for h in self.answer.how_far if h.on == kind and h.channel != WHOLE]
        return sorted(found, key=lambda h: order.index(h.channel) if h.channel in order else len(order))

    def clearest(self, count: int) -> list[HowFar]:
        """So many figures of the hardest test, at most, whose gap is measurable: the first that has a title, and the largest beside their noise."""
        found = [h for h in self.figures(self.hardest) if h.closure is not None]
        others = sorted(found[1:], key=lambda h: -h.before / h.floor if h.floor else 0.0)
        chosen = [*found[:1], *others[: count - 1]]
        return [h for h in found if h in chosen]


def hardest(measured: Iterable[HowFar]) -> str | None:
    """The hardest kind of test among these; None where there is none."""
    return min((h.on for h in measured), key=list(KINDS).index, default=None)


def spoken(name: str) -> str:
    """Name of a candidate or model in the words of the page: `backlash @ joint 3 + runout @ cutter` -> `backlash, joint 3 with runout, cutter`."""
    return name.replace("_", " ").replace(" @ ", ", ").replace(" + ", " with ")


def of_number(x: Number) -> str:
    """A number of the model in the words of the page; parameters keep their names."""
    text = x.text
    for name in (*x.beside, *x.instead_of):
        text = text.replace(name, spoken(name))
    return text.replace(" + ", " with ")


def effect_name(w: Which) -> str:
    """`backlash, joint 3`."""
    return f"{w.effect.replace('_', ' ')}, {w.location}"


def sized(w: Which) -> str:
    """Name of an effect with its fitted values: `backlash, joint 3 (80.2 µrad)`."""
    values = [quantity(p.value, relative(name, p.unit)) for name, p in w.parameters.items()]
    return f"{effect_name(w)} ({', '.join(values)})"


def listed(parts: Sequence[str], last: str = "and") -> str:
    """`a, b and c`; with semicolons where the parts have commas of their own."""
    between = "; " if any("," in p for p in parts) else ", "
    return f" {last} ".join(filter(None, [between.join(parts[:-1]), parts[-1]])) if parts else ""


def together(names: Iterable[str]) -> str:
    """`joint 1, 2, 5, tool` for places whose names differ in their last word."""
    found: list[str] = []
    head = ""
    for name in dict.fromkeys(names):
        start, _, end = name.rpartition(" ")
        found.append(end if start and start == head else name)
        head = start
    return ", ".join(found)


def causes(named: Sequence[Which]) -> str:
    """The effects one by one with their sizes; more than CAUSES by kinds: `friction viscous (joint 1, 2, 4) and backlash (joint 3)`."""
    if len(named) <= CAUSES:
        return listed([sized(w) for w in named])
    kinds: dict[str, list[str]] = {}
    for w in named:
        kinds.setdefault(w.effect.replace("_", " "), []).append(w.location)
    return f"{len(named)} effects: {listed([f'{kind} ({together(sorted(places))})' for kind, places in kinds.items()])}"


def size(h: HowFar, value: float) -> str:
    """A value of a figure, in the unit that suits the figure."""
    factor, symbol = scale(h.unit, max(h.before, h.floor))
    return join(number(factor * value), symbol)


def left(h: HowFar) -> str:
    """What is left of a figure with the adopted effects, or that it is within the noise of so much."""
    return f"within the noise of {size(h, h.floor)}" if h.within_noise else size(h, h.after)


def there_was(h: HowFar) -> str:
    """The gap of a figure with the nominal system, or that it is within the noise of so much."""
    return size(h, h.before) if h.measurable else f"within the noise of {size(h, h.floor)}"


def closed(h: HowFar) -> tuple[str, str]:
    """Closure and its interval; where what is left is within the noise, what is closed at least."""
    if h.closure is None or h.interval is None:
        return "not measurable", ""
    if h.within_noise:
        return "to within the noise", f"at least {percent(max(h.interval[0], 0.0))}"
    return percent(h.closure), percent_interval(h.interval)


GUESS = "Nothing was repeated, so the noise is a guess"
"""What goes before an answer that rests on that."""


def verdict_sentence(s: Subject) -> str:
    """The whole answer in one sentence; it begins with what it rests on, where that is a guess."""
    answer = _answer(s)
    return f"{GUESS}: {answer[0].lower()}{answer[1:]}" if s.answer.guessed else answer


def _answer(s: Subject) -> str:
    if s.verdict == "bad_log":
        fatal = [f for f in s.answer.findings if f.fatal]
        more = f" ({len(fatal) - 1} more findings below)" if len(fatal) > 1 else ""
        return f"This log cannot be diagnosed: {reason(fatal[0])}{more}." if fatal else "This log cannot be diagnosed."
    if s.verdict == "none":
        also = f". It may be {perhaps(s.answer, causes(maybe))}" if (maybe := s.answer.suspected) else ""
        return f"No effect is needed to explain these runs: machine and simulation differ by no more than noise and the tolerances of calibrated numbers{also}."
    if (x := s.answer.number) is not None:
        what = "The gap is" if not x.beside else "In the gap is"
        return f"{what} what one number of the model does that no effect of the catalogue is about: {of_number(x)}{_shrinks(s)}."
    if known := s.answer.unknown:
        place = listed([listed([w.component, *(w.alternatives or ())], "or") for w in s.blamed]) or known.component
        where = f"; it shows most in {s.label(next(iter(known.channels)))}" if known.channels else ""
        return f"Something real that is not in the catalogue, in {place}: the best model {because(s)[0]}{where}{_formed(s)}."
    if s.verdict == "ambiguous":
        return _open(s.sure, [w for w in s.answer.which if w.probability < IDENTIFIED])
    return f"The gap is caused by {causes(s.sure)}{_shrinks(s)}."


def perhaps(answer: Answer, cause: str) -> str:
    """What is said of what is suspected: `cause`, and why it is not the answer."""
    assert answer.tests is not None
    if believed(answer.tests):
        return f"noise that is slow, or {cause}; repeats say which"
    nothing, limit = percent(answer.tests.nothing), percent(answer.tests.false_alarm)
    return f"{cause}; but that nothing is wrong has a probability of {nothing}, and the limit is {limit}"


def _open(sure: Sequence[Which], doubtful: Sequence[Which]) -> str:
    """The answer of which a part is doubtful: members of a set of which one is there, or effects each of which may be there."""
    names = [f"{sized(w)} at {percent(w.probability)}" for w in doubtful[:CAUSES]]
    more = len(doubtful) - len(names)
    if len(doubtful) > 1 and sum(w.probability for w in doubtful) <= 1.0:  # else more than one of them must be there
        first = f"The gap is caused by {causes(sure)}, together with one of" if sure else "The gap has one of"
        rest = f" or one of {more} others" if more else ""
        return f"{first} several causes that these runs cannot tell apart: {listed(names, 'or')}{rest}."
    each = listed([*names, *([f"{more} others"] if more else [])])
    if sure:
        return f"The gap is caused by {causes(sure)}. What is beside {'it' if len(sure) == 1 else 'them'} is not sure: {each}."
    return f"The likeliest answer is not sure: {each}."


def because(s: Subject) -> list[str]:
    """What is said against the best model of an answer that is `unknown` (`outcome.reasons`)."""
    known = s.answer.unknown
    assert known is not None
    return [
        f"leaves {percent(s.left)} of the gap, in that signal of the diagnosed runs where it explains least" if r == "left" else WHY[r]
        for r in known.why
    ]


def _formed(s: Subject) -> str:
    """How much of the whole gap goes with the form of the unknown in the loop; nothing of one that is of no use there."""
    known = s.answer.form.how_far if s.answer.form and not s.answer.form.refuted else ()
    kind = hardest(known)
    whole = next((h for h in known if h.on == kind and h.channel == WHOLE and h.closure is not None), None)
    if whole is None:
        return ""
    how = "the gap to within the noise" if whole.within_noise else f"{closed(whole)[0]} of the gap"
    more = f", the effects that are nearest {closed(s.answer.closer)[0]}" if s.answer.closer else ""
    return f"; a form that was found for it closes {how} in {KINDS[whole.on]}{more}"


def reason(finding: Finding) -> str:
    """Channel and text of a finding of the gate, as one clause."""
    return finding.text if finding.text.startswith("the clock") else f"{finding.channel} {finding.text}"


def _shrinks(s: Subject) -> str:
    """What that means for the first figure and the one whose gap is clearest."""
    changes = [f"{s.said(h.channel)} from {there_was(h)} to {left(h)}" for h in s.clearest(2)]
    if not changes or s.hardest is None:
        return ""
    return f"; with {'it' if len(s.sure) == 1 or s.answer.number else 'them'} in the model, in {KINDS[s.hardest]}: {listed(changes)} (rms)"
