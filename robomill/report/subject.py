"""What a report is about, and how its things are called in sentences."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.localisation.where import Replayed
from robomill.diagnosis.outcome.answer import Answer, Diagnosis, Which
from robomill.diagnosis.outcome.closure import HowFar
from robomill.diagnosis.outcome.verdict import IDENTIFIED
from robomill.orchestration.runs.recorder import frame_of
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray, base_name
from robomill.orchestration.system.definition import System
from robomill.report.units import join, number, percent, quantity, relative, scale

HELD_OUT = " (held out)"
KINDS = ("held-out condition", "held-out repeat", "diagnosed runs")
"""Where the closure is measured, the hardest test first."""
_JOINTS = re.compile(r"(q|torque|correction_q)(_[a-z]+)?")
"""Ports whose elements are joints, not the axes of a frame."""
CAUSES = 4
"""Possible causes that the sentence of an ambiguous verdict names, at most; of the others it says how many there are."""


@dataclass(frozen=True)
class Subject:
    """A diagnosis with all that was given to it."""

    found: Diagnosis
    system: System
    runs: Sequence[Run]
    catalogue: Catalogue

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

    @property
    def sure(self) -> list[Which]:
        """Entries of `which` that are believed."""
        return [w for w in self.answer.which if w.probability >= IDENTIFIED]

    @property
    def blamed(self) -> list[Replayed]:
        """Entries of `where` that come from replay and swaps, because no effect of the catalogue explains the gap."""
        return [w for w in self.answer.where if isinstance(w, Replayed)]

    def far(self, kind: str, channel: str) -> HowFar | None:
        """Entry of `how_far` for an array on one kind of runs."""
        return next((h for h in self.answer.how_far if h.on == kind and h.channel == channel), None)


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
        return "No effect is needed to explain these runs: machine and simulation differ by no more than noise and the tolerances of calibrated numbers."
    if known := s.answer.unknown:
        place = listed([listed([w.component, *(w.alternatives or ())], "or") for w in s.blamed]) or known.component
        where = f"; it shows most in {s.label(next(iter(known.channels)))}" if known.channels else ""
        why = f"leaves {percent(s.left)} of the gap"
        if known.changes:
            why = "does not change with time as the gap does"
        elif (new := s.answer.transfer) is not None and new.worth < 0.0:
            why = "does not hold in new conditions"
        return f"Something real that is not in the catalogue, in {place}: the best model {why}{where}."
    if s.verdict == "ambiguous":
        sure, open_ = s.sure, [w for w in s.answer.which if w.probability < IDENTIFIED]
        first = f"The gap is caused by {listed([sized(w) for w in sure])}, together with one of" if sure else "The gap has one of"
        names = [f"{sized(w)} at {percent(w.probability)}" for w in open_[:CAUSES]]
        rest = f" or one of {len(open_) - CAUSES} others" if len(open_) > CAUSES else ""
        return f"{first} several causes that these runs cannot tell apart: {listed(names, 'or')}{rest}."
    causes = listed([sized(w) for w in s.sure])
    explain = "explains" if len(s.sure) == 1 else "together explain"
    return f"The gap is caused by {causes}, which {explain} {percent(1.0 - s.left)} of what is beyond noise and calibration{_shrinks(s)}."


def reason(finding: Finding) -> str:
    """Channel and text of a finding of the gate, as one clause."""
    return finding.text if finding.text.startswith("the clock") else f"{finding.channel} {finding.text}"


def _shrinks(s: Subject) -> str:
    """What that means for the first figure that has a title."""
    for kind in KINDS:
        for base in s.titles:
            h = s.far(kind, base)
            if h is not None and h.closure is not None:
                factor, symbol = scale(h.unit, h.before)
                before = join(number(h.before * factor), symbol)
                after = join(number(h.after * factor), symbol) if h.after else "less than can be measured"
                where = {"held-out condition": "new conditions", "held-out repeat": "held-out repeats"}.get(kind, "the diagnosed runs")
                return f"; once it is in the model, {s.titles[base]} on {where} falls from {before} to {after} (rms)"
    return ""
