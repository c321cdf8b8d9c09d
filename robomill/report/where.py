"""Section: where is the gap?"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from robomill.diagnosis.outcome.answer import Unknown
from robomill.report.figures import ALWAYS, component_name
from robomill.report.html import bar, code, figure, fold, paragraph, table
from robomill.report.subject import Subject, listed, spoken
from robomill.report.units import number, percent, percent_interval, with_interval

_SHARES = {
    False: "Share of the gap (all signals, each over its noise) that goes when the effects found in a component are switched on in the simulation, with its 90 % interval. Measured on the diagnosed runs.",
    True: "Share of the gap (all signals, each over its noise) that goes when the error of a component is put into the simulation (what is left when it is driven with measured inputs, added to its outputs), with its 90 % interval.",
}
"""Whether the shares come from replay and swaps -> what they are."""
INTERVALS = 4
"""Intervals of time that a sentence names, at most; the figure has them all."""


def section(s: Subject, figures: Mapping[str, str]) -> str:
    """Components, places, times; and what the replay of each component says."""
    parts = []
    if s.answer.unknown:
        parts.append(_unknown(s, s.answer.unknown))
    if s.answer.where:
        parts.append(figure(figures, "shares", _SHARES[bool(s.blamed)]))
    parts.append(
        figure(
            figures, "robot", "The robot in the pose of the run; the thin line is the path of the tool tip. Marked: where the finding acts."
        )
    )
    parts.append(
        figure(
            figures,
            "signals",
            "Measured minus simulated where it shows most. The grey band, where there is one, is what repeats of the same run differ by; shaded are the times when the effect acts.",
        )
    )
    rows = []
    for w in s.answer.where:
        others = f"<small>or {escape(listed(w.alternatives, 'or'))}</small>" if w.alternatives else ""
        depends = [f"{escape(d.variable)} ({percent(d.share)})" for d in (w.dependence or [])[:3]]
        rows.append(
            (
                f"<strong>{escape(component_name(w))}</strong>{others}",
                f"{percent(w.share)}<small>{percent_interval(w.interval)}</small>",
                escape(_direction(w.direction, s)) if w.direction != w.channel else "–",
                f"{escape(s.label(w.channel))}<small>{code(w.channel)}</small>",
                escape(times(s, w.regime)) or "–",
                "<br/>".join(depends) or "–",
            )
        )
    if rows:
        parts.append(table(("Component", "Share", "Direction", "Strongest in", "When", "Depends on"), rows))
    return "\n".join(p for p in [*parts, _replay(s), _swap(s)] if p)


def times(s: Subject, regime: Sequence[Sequence[float]]) -> str:
    """Intervals of time, the first few, to about a hundredth of the longest run."""
    longest = max((float(np.ptp(c["t"])) for c in s.found.curves.values()), default=0.0)
    if longest > 0.0 and sum(end - start for start, end in regime) > ALWAYS * longest:
        return "all the time"
    spacing = 10.0 ** math.floor(math.log10(0.05 * longest)) if longest > 0.0 else 0.1
    shown = ", ".join(f"{number(a, spacing)} to {number(b, spacing)}" for a, b in regime[:INTERVALS])
    return f"{shown}{' …' if len(regime) > INTERVALS else ''} s" if regime else ""


def _replay(s: Subject) -> str:
    """What each measured output says when its component is driven with measured inputs."""
    readings, left_out = s.answer.replay, s.answer.not_replayed
    remark = paragraph(f"{left_out[0].upper()}{left_out[1:]}.") if left_out else ""
    if not readings:
        return f"<h3>Component by component</h3>\n{remark}" if remark else ""
    loud = sorted((r for r in readings if r.significant), key=lambda r: -r.unexplained)
    rows = []
    for r in loud:
        value, interval = with_interval(r.residual, r.interval, r.unit)
        name = f"{escape(s.titles.get(r.output, ''))}<small>{code(r.output)}</small>"
        rows.append((name, escape(listed(r.components, "or")), f"{value}<small>{interval}</small>", number(r.whitened)))
    text = "Each component was driven alone with measured inputs, so that nothing that happens before it can show in its outputs."
    alike = [listed(names, "and") for names in s.answer.structure.alike] if s.answer.structure else []
    if alike:
        text += f" By the connections alone, what was measured cannot tell apart {'; '.join(alike)}: only the form of their effects can."
    text += (
        f" Outputs that differ from the measurement by more than noise and the tolerances of calibrated numbers: {len(loud)} of {len(readings)}"
        + (":" if loud else ".")
    )
    shown = table(("Output", "To blame", "Left, rms", "Times its noise"), rows, (2, 3)) if rows else ""
    return f"<h3>Component by component</h3>\n{paragraph(text)}{shown}{remark}"


def _swap(s: Subject) -> str:
    """How much of each figure's gap goes when a component's outputs have the error that its replay found."""
    if not s.answer.swap:
        return ""
    rows = [
        (escape(s.titles.get(w.figure, w.figure)), escape(w.component), bar(w.share), percent_interval(w.interval)) for w in s.answer.swap
    ]
    text = "The simulation was run again with what is left of a component's replay added to its outputs; the share of the gap that this takes away (Shapley value):"
    return fold("Shares by swapping outputs", paragraph(text) + table(("Gap in", "Component", "Share", "90 %"), rows))


def _direction(direction: str, s: Subject) -> str:
    """`B.y` -> `y of B`; a channel that is no direction by its label."""
    frame, _, axis = direction.partition(".")
    return f"{axis} of {frame}" if axis in ("x", "y", "z") else s.label(direction)


def _unknown(s: Subject, known: Unknown) -> str:
    rows = [(bar(share), escape(s.label(channel)), code(channel)) for channel, share in known.channels.items()]
    text = (
        f"The catalogue's nearest answer is {spoken(known.nearest)}, and it is not good enough. What it leaves is strongest in "
        f"the outputs of {known.component} ({_direction(known.direction, s)})"
        + (f", {'' if times(s, known.regime).startswith('all') else 'at '}{times(s, known.regime)}." if known.regime else ".")
        + (
            " The cause is there or upstream of it."
            if not s.blamed
            else " Driven with measured inputs, component by component, the blame falls as below."
        )
    )
    if known.changes:
        text += (
            f" The gap changes with time: it is like what {spoken(known.changes.candidate.name)} would do if that {known.changes.how}. "
            "That is a description, not a cause."
        )
    for x in known.instead[:1]:
        text += (
            f" In {', '.join(map(s.label, x.ports))}, {x.law} in place of {spoken(x.effect)} would predict what was left out better, by {percent(x.gain)} of the gap there: "
            "that effect stands in for something else, and its outputs and others of its kind are in doubt with it."
        )
    return paragraph(text) + table(("Share of what is left", "Signal", "Channel"), rows)
