"""The page: one HTML file without scripts, that needs nothing but itself."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files

import numpy as np

from robomill.diagnosis.inference.isolability import CONFUSABLE
from robomill.diagnosis.outcome.answer import Unknown, Which
from robomill.diagnosis.outcome.closure import HowFar
from robomill.diagnosis.outcome.next_run import Alternative, NextRun
from robomill.orchestration.slaves.protocol import base_name
from robomill.report.figures import component_name, smallest
from robomill.report.subject import GUESS, HELD_OUT, KINDS, Subject, effect_name, listed, verdict_sentence
from robomill.report.units import join, number, percent, percent_interval, quantity, relative, scale, with_interval

BADGES = {
    "none": "No effect found",
    "identified": "Identified",
    "ambiguous": "Ambiguous",
    "unknown": "Not in the catalogue",
    "bad_log": "Log not usable",
}
WHITENED = "all channels, whitened"
_SHARES = {
    False: "Share of the whitened gap that goes when the effects found in a component are switched on in the closed loop, with its 90 % interval.",
    True: "Share of the whitened gap that goes when the error of a component is put into the closed loop (what is left of its replay, added to its outputs), with its 90 % interval.",
}
"""Whether the shares come from replay and swaps -> what they are."""
PAIRS = 12
"""Pairs of candidates that are listed, at most."""
INTERVALS = 4
"""Intervals of time that a sentence names, at most; the figure has them all."""


def page(s: Subject, figures: Mapping[str, str]) -> str:
    """The HTML of a diagnosis; `figures` name -> SVG."""
    style = files("robomill.report").joinpath("style.css").read_text(encoding="utf-8")
    sections = [
        ("log", "Is the log usable?", _log(s, figures)),
        ("where", "Where is the gap?", _where(s, figures)),
        ("which", "Which effect causes it?", _which(s)),
        ("seen", "What would have been seen?", _visible(s, figures)),
        ("far", "How far does it shrink?", _far(s, figures)),
        ("next", "What to measure next", _next(s)),
        ("about", "What this rests on", _about(s)),
    ]
    shown = [(key, title, body) for key, title, body in sections if body]
    links = "".join(f'<a href="#{key}">{title}</a>' for key, title, _ in shown)
    blocks = "\n".join(f'<section id="{key}">\n<h2>{title}</h2>\n{body}\n</section>' for key, title, body in shown)
    title = f"{BADGES[s.verdict]}: {s.system.name}"
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8"/>
<meta name="viewport" content="width=device-width, initial-scale=1"/>
<title>{escape(title)}</title>
<style>
{style}</style>
</head>
<body>
<main>
<header>
<p class="over">Machine against simulation · {escape(s.system.name)}</p>
<h1><span class="badge {s.verdict}">{BADGES[s.verdict]}</span>{escape(verdict_sentence(s))}</h1>
</header>
{_tiles(s)}
<nav aria-label="Sections">{links}</nav>
{blocks}
<footer>Written by robomill diagnose; the same as data: diagnosis.json; the figures as files: figures/.</footer>
</main>
</body>
</html>
"""


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], numeric: Sequence[int] = ()) -> str:
    """Cells are HTML already; columns in `numeric` are set flush right."""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(f'<{tag} class="n">{c}</{tag}>' if i in numeric else f"<{tag}>{c}</{tag}>" for i, c in enumerate(row))

    body = "\n".join(
        f"<tr>{cells('td', r)}</tr>" if len(r) > 1 else f'<tr class="group"><th colspan="{len(head)}">{r[0]}</th></tr>' for r in rows
    )
    return f'<div class="scroll"><table>\n<thead><tr>{cells("th", head)}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'


def _figure(figures: Mapping[str, str], name: str, caption: str) -> str:
    return f"<figure>\n{figures[name]}\n<figcaption>{escape(caption)}</figcaption>\n</figure>" if name in figures else ""


def _bar(share: float) -> str:
    """A share as a bar and a number."""
    width = 100.0 * min(max(share, 0.0), 1.0)
    return (
        f'<span class="share"><span class="bar" aria-hidden="true"><span style="width: {width:.1f}%"></span></span>{percent(share)}</span>'
    )


def _paragraph(text: str, kind: str = "") -> str:
    return f"<p{f' class={chr(34)}{kind}{chr(34)}' if kind else ''}>{escape(text)}</p>"


def _code(text: str) -> str:
    """A name, that may be broken where its parts meet."""
    return "<code>" + escape(text).replace(".", ".<wbr/>") + "</code>"


def _spoken(name: str) -> str:
    """Name of a candidate or model in the words of the page: `backlash @ joint 3 + runout @ cutter` -> `backlash, joint 3 with runout, cutter`."""
    return name.replace("_", " ").replace(" @ ", ", ").replace(" + ", " with ")


def _times(s: Subject, regime: Sequence[Sequence[float]]) -> str:
    """Intervals of time, the first few, to about a hundredth of the longest run."""
    longest = max((float(np.ptp(c["t"])) for c in s.found.curves.values()), default=0.0)
    spacing = 10.0 ** math.floor(math.log10(0.05 * longest)) if longest > 0.0 else 0.1
    shown = ", ".join(f"{number(a, spacing)} to {number(b, spacing)}" for a, b in regime[:INTERVALS])
    return f"{shown}{' …' if len(regime) > INTERVALS else ''} s" if regime else ""


def _tiles(s: Subject) -> str:
    tiles: list[tuple[str, str, str]] = []
    if s.answer.probability_none is not None:
        tiles.append(("Probability of no effect", percent(s.answer.probability_none), "of all answers considered"))
    elif s.verdict != "bad_log":
        tiles.append(("Gap explained", percent(1.0 - s.left), "beyond noise and calibration, on the diagnosed runs"))
        if s.verdict != "unknown" and s.answer.which:
            first = s.answer.which[0]
            tiles.append(("Probability", percent(first.probability), effect_name(first)))
    for kind in KINDS:
        h = s.far(kind, WHITENED)
        if h is not None and h.closure is not None:
            ceiling = f", ceiling {_ceiling(h)}" if h.ceiling is not None else ""
            tiles.append((f"Gap closed, {kind}", percent(h.closure), f"{percent_interval(h.interval)}{ceiling}"))
            break
    used = [c for c in s.conditions if not c.endswith(HELD_OUT)]
    held = len(s.conditions) - len(used)
    about = f"{_count(len(used), 'condition')} diagnosed{f', {held} held out' if held else ''}, {len(s.found.channels)} channels"
    tiles.append(("Runs", str(len(s.runs)), about))
    return '<dl class="tiles">' + "".join(f"<div><dt>{a}</dt><dd>{b}<small>{escape(c)}</small></dd></div>" for a, b, c in tiles) + "</dl>"


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def _log(s: Subject, figures: Mapping[str, str]) -> str:
    findings = s.answer.findings
    if not findings:
        return _paragraph(
            "Yes. Time base, missing and constant samples, ranges, signs, units, axes and clocks were looked at; nothing was found."
        )
    rows = []
    for f in findings:
        if f.repaired:
            status = "corrected"
        elif f.fatal and s.verdict == "bad_log":
            status = '<span class="bad">stops the diagnosis</span>'
        else:
            status = "noted"
        size = quantity(f.value, f.unit) if f.unit not in ("", "1") else f"{f.value:.3g}"
        rows.append((_code(f.channel), escape(f.kind), escape(f.text), size, status))
    text = "No, for these reasons:" if s.verdict == "bad_log" else "Yes. This was noticed:"
    remedy = ""
    if s.verdict == "bad_log":
        clocks = any(f.kind == "lag" and f.fatal for f in findings)
        remedy = _paragraph(
            "A clock that is late looks like an effect of the machine, so nothing is diagnosed until it is right. Correct it in the import "
            "(shift = … in the mapping), or let robomill diagnose --repair correct it and diagnose the rest."
            if clocks
            else "Correct the log (signs, units, columns and frames are set in the mapping of robomill import), or leave out the runs concerned."
        )
    table = _table(("Channel", "Kind", "What", "Size", ""), rows, (3,))
    return _paragraph(text) + table + _figure(figures, "log", "The channels in question, beside what the simulation says.") + remedy


def _where(s: Subject, figures: Mapping[str, str]) -> str:
    parts = []
    if s.answer.unknown:
        parts.append(_unknown(s, s.answer.unknown))
    if s.answer.where:
        parts.append(_figure(figures, "shares", _SHARES[bool(s.blamed)]))
    parts.append(
        _figure(
            figures, "robot", "The robot in the pose of the run; the thin line is the path of the tool tip. Marked: where the finding acts."
        )
    )
    parts.append(
        _figure(
            figures,
            "signals",
            "Measured minus simulated where it shows most. The grey band is what repeats of the same run differ by; shaded are the times when the effect acts.",
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
                f"{escape(s.label(w.channel))}<small>{_code(w.channel)}</small>",
                escape(_times(s, w.regime)),
                "<br/>".join(depends) or "–",
            )
        )
    if rows:
        parts.append(_table(("Component", "Share", "Direction", "Strongest in", "When", "Depends on"), rows))
    return "\n".join(p for p in [*parts, _replay(s), _swap(s)] if p)


def _replay(s: Subject) -> str:
    """What each measured output says when its component is driven with measured inputs."""
    readings, left_out = s.answer.replay, s.answer.not_replayed
    remark = _paragraph(f"{left_out[0].upper()}{left_out[1:]}.") if left_out else ""
    if not readings:
        return f"<h3>Component by component</h3>\n{remark}" if remark else ""
    loud = sorted((r for r in readings if r.significant), key=lambda r: -r.unexplained)
    rows = []
    for r in loud:
        value, interval = with_interval(r.residual, r.interval, r.unit)
        name = f"{escape(s.titles.get(r.output, ''))}<small>{_code(r.output)}</small>"
        rows.append(
            (
                name,
                escape(listed(r.components, "or")),
                f"{value}<small>{interval}</small>",
                number(r.whitened),
                number(r.unexplained),
            )
        )
    text = "Each component was driven alone with measured inputs, so that nothing that happens before it can show in its outputs."
    alike = [listed(names, "and") for names in s.answer.structure.alike] if s.answer.structure else []
    if alike:
        text += f" By the connections alone, what was measured cannot tell apart {'; '.join(alike)}: only the form of their effects can."
    text += (
        f" Outputs that differ from the measurement by more than noise and the tolerances of calibrated numbers: {len(loud)} of {len(readings)}"
        + (":" if loud else ".")
    )
    table = _table(("Output", "To blame", "Left, rms", "In noise", "Beyond tolerances"), rows, (2, 3, 4)) if rows else ""
    return f"<h3>Component by component</h3>\n{_paragraph(text)}{table}{remark}"


def _swap(s: Subject) -> str:
    """How much of each figure's gap goes when a component's outputs have the error that its replay found."""
    if not s.answer.swap:
        return ""
    rows = [
        (escape(s.titles.get(w.figure, w.figure)), escape(w.component), _bar(w.share), percent_interval(w.interval)) for w in s.answer.swap
    ]
    text = "The closed loop was run again with what is left of a component's replay added to its outputs; the share of the gap that this takes away (Shapley value):"
    return f"<details><summary>Shares by swapping outputs</summary>\n{_paragraph(text)}{_table(('Gap in', 'Component', 'Share', '90 %'), rows)}</details>"


def _direction(direction: str, s: Subject) -> str:
    """`B.y` -> `y of B`; a channel that is no direction by its label."""
    frame, _, axis = direction.partition(".")
    return f"{axis} of {frame}" if axis in ("x", "y", "z") else s.label(direction)


def _unknown(s: Subject, known: Unknown) -> str:
    rows = [(_bar(share), escape(s.label(channel)), _code(channel)) for channel, share in known.channels.items()]
    text = (
        f"The catalogue's nearest answer is {_spoken(known.nearest)}, and it is not good enough. What it leaves is strongest in "
        f"the outputs of {known.component} ({_direction(known.direction, s)})"
        + (f", at {_times(s, known.regime)}." if known.regime else ".")
        + (
            " The cause is there or upstream of it."
            if not s.blamed
            else " Driven with measured inputs, component by component, the blame falls as below."
        )
    )
    if known.changes:
        text += (
            f" The gap changes with time: it is like what {_spoken(known.changes.candidate.name)} would do if that {known.changes.how}. "
            "That is a description, not a cause."
        )
    return _paragraph(text) + _table(("Share of what is left", "Signal", "Channel"), rows)


def _values(w: Which) -> str:
    texts = []
    for name, p in w.parameters.items():
        value, interval = with_interval(p.value, p.interval, relative(name, p.unit))
        texts.append(f"{value}<small>{interval}</small>")
    return "".join(texts)


def _which(s: Subject) -> str:
    if not s.answer.which:
        return ""
    described = s.catalogue.descriptions or {}
    rows = []
    for w in s.answer.which:
        description = described.get(w.effect, ("", ""))[0]
        others = [_spoken(c) for c in w.confusable_with]
        names = "".join(f"<small>{_code(w.component + '.' + n)}</small>" for n in w.parameters)
        rows.append(
            (
                _bar(w.probability),
                f"<strong>{escape(effect_name(w))}</strong><small>{escape(description)}</small>",
                _values(w),
                f"{escape(w.component)}{names}",
                escape("; ".join(others)) or "–",
            )
        )
    intro = {
        "none": "None is needed. These came closest:",
        "identified": "Every candidate of the catalogue was fitted in the closed loop, alone and together. These remain:",
        "ambiguous": "Every candidate of the catalogue was fitted in the closed loop, alone and together. These remain, and the runs cannot choose:",
        "unknown": "None of the catalogue alone. These fit best, but leave too much or do not hold; their values should not be believed:",
        "bad_log": "Candidates that fit what the log shows, among them its clocks. They are no findings as long as the log is wrong:",
    }[s.verdict]
    table = _table(("Probability", "Effect", "Value (90 % interval)", "Component", "Could be confused with"), rows)
    tested = f"{len(s.catalogue.candidates)} candidates ({len(s.catalogue.effects)} effects) were tried."
    return _paragraph(intro) + table + _transfer(s) + _isolability(s) + _paragraph(tested) + _adopt(s)


def _transfer(s: Subject) -> str:
    """What the model is worth in conditions that it was not fitted to."""
    moved = s.answer.transfer
    if moved is None:
        return ""
    return _paragraph(
        f"In new conditions, fitted to none of them, the model gains {number(moved.gain)} nats in log score; if it were right, it should gain about "
        f"{number(moved.expected_gain)}. It leaves {number(moved.after)} times the chi2 (whitened sum of squares) of noise there, the nominal system {number(moved.before)}."
    )


def _isolability(s: Subject) -> str:
    if not s.answer.isolability or s.verdict in ("none", "bad_log"):
        return ""
    rows = [
        (
            " against ".join(escape(_spoken(n)) for n in p.pair),
            number(p.distance, 1.0),
            "cannot be told apart" if p.confusable else "told apart",
        )
        for p in s.answer.isolability[:PAIRS]
    ]
    text = (
        f"Distance between what two candidates do to these signals, at the values that fit best, in deviations of noise; "
        f"below {CONFUSABLE:g} the runs cannot tell them apart."
    )
    body = _paragraph(text) + _table(("Pair", "Distance", ""), rows, (1,))
    return f"<details><summary>Which candidates these runs can tell apart</summary>\n{body}\n</details>"


def _adopt(s: Subject) -> str:
    if s.verdict not in ("identified", "ambiguous"):
        return ""
    text = "The most probable answer is in adopt.ssv. Simulate with it:" if s.verdict == "ambiguous" else "Simulate with it:"
    return _paragraph(text) + "<pre><code>robomill run SCENARIO.toml --adopt adopt.ssv</code></pre>"


def _visible(s: Subject, figures: Mapping[str, str]) -> str:
    effects = smallest(s)
    if s.verdict != "none" or not effects:
        return ""
    scales = {(c.effect, c.location): c.prior.scale for c in s.catalogue.candidates}
    rows = []
    for effect, places in effects:
        best, worst = places[0][1], places[-1][1]
        unit = relative(best.parameter, best.unit)
        where = f"{escape(best.location)}: {quantity(abs(best.value), unit)}"
        least = f"{escape(worst.location)}: {quantity(abs(worst.value), unit)}" if len(places) > 1 else ""
        typical = quantity(scales[effect, best.location], unit)
        rows.append((escape(effect.replace("_", " ")), where, least, typical, number(places[0][0])))
    table = _table(("Effect", "Seen best", "Seen worst", "Typical size", "Best / typical"), rows, (3, 4))
    return (
        _paragraph(
            "“Nothing found” says as much as these runs can show: an effect above the size below would have been seen (five deviations), a smaller one may be there."
        )
        + _figure(
            figures,
            "visible",
            "From which size each effect would have been seen, in units of its typical size. Right of the line, an effect of typical size would have been missed.",
        )
        + f'<details open="open"><summary>All sizes</summary>\n{table}\n</details>'
    )


def _far(s: Subject, figures: Mapping[str, str]) -> str:
    if not s.answer.how_far or s.verdict == "bad_log":
        return ""
    rows: list[Sequence[str]] = []
    for kind in KINDS:
        here = [h for h in s.answer.how_far if h.on == kind]
        here.sort(key=lambda h: list(s.titles).index(h.channel) if h.channel in s.titles else -1)
        if here:
            rows.append((escape(kind[0].upper() + kind[1:]),))
        for h in here:
            factor, symbol = scale(h.unit, max(h.before, h.after, h.floor))
            # what is left may well come out as nothing: it is known to a part of the noise only
            sizes = [join(number(factor * x) if x else "≈ 0", symbol) for x in (h.before, h.after, h.floor)]
            title = "all channels, in deviations of noise" if h.channel == WHITENED else s.titles.get(h.channel, h.channel)
            if h.closure is None:
                closed, ratio = "not measurable", ""
            else:
                closed = f"{percent(h.closure)}<small>{percent_interval(h.interval)}</small>"
                ratio = f"{percent(h.closure / h.ceiling)}" if h.ceiling else ""
            rows.append((escape(title), *sizes, closed, _ceiling(h), ratio or "–"))
    table = _table(("Rms of", "Before", "After", "Noise", "Closed (90 %)", "Ceiling", "Closed / ceiling"), rows, (1, 2, 3, 4, 5, 6))
    claim = "" if s.verdict != "unknown" else " The model is not adequate: this is what it closes nevertheless."
    return (
        _paragraph(
            "After: the closed loop simulated again with the fitted values. Rms is without noise (products of different repeats); closed is the share of the squares. "
            "The ceiling is what repeats share; where a condition was measured once (≥), what a regression on the simulated signals closes. "
            f"Not measurable: no gap is left beside the noise.{claim}"
        )
        + _figure(figures, "overlay", "Measured minus simulated, before and after, on the diagnosed run and on runs that were held out.")
        + _figure(figures, "closure", "Closed share of the gap, with its 90 % interval, against the ceiling where it could be measured.")
        + table
    )


def _ceiling(h: HowFar) -> str:
    """A regression shows what can be closed at least."""
    return "–" if h.ceiling is None else f"{'≥ ' if h.ceiling_by == 'regression' else ''}{percent(h.ceiling)}"


def _next(s: Subject) -> str:
    r = s.answer.next_run
    if r is None:
        return ""
    pair = listed([_spoken(x) for x in r.separates])
    if r.separated:
        text = f"{r.kind[0].upper()}{r.kind[1:]}: it separates {pair}."
    else:
        text = f"No run that was looked at would tell apart {pair}. The one that comes nearest: {r.kind}."
    parts = [f"<p><strong>{escape(text)}</strong></p>"]
    parts.append(
        _paragraph(
            f"{_count(r.repeats, 'repeat')}, about {r.minutes:g} minutes with setting up. They would then be {number(r.distance, 1.0)} "
            f"deviations of noise apart instead of {number(r.now, 1.0)} now; {CONFUSABLE:g} are needed."
        )
    )
    settings = [f"{name} = {quantity(v.value, v.unit)}" for name, v in r.parameters.items()]
    if settings:
        parts.append("<pre><code>" + escape("\n".join(settings)) + "</code></pre>")
    if r.alternatives:
        tried: list[NextRun | Alternative] = [r, *r.alternatives]
        rows = [(escape(a.kind), number(a.distance, 1.0), f"{a.minutes:g}", number(a.per_minute)) for a in tried]
        parts.append(_table(("Run", "Deviations apart", "Minutes", "Nats per minute"), rows, (1, 2, 3)))
    return "\n".join(parts)


def _about(s: Subject) -> str:
    rows = []
    for condition in s.conditions:
        curves = s.found.curves[condition]
        t = curves["t"]
        kind = "diagnosed"
        if condition.endswith(HELD_OUT):
            kind = KINDS[1] if condition.removesuffix(HELD_OUT) in s.found.curves else KINDS[0]
        rows.append((escape(condition.removesuffix(HELD_OUT)), kind, f"{number(float(t[-1] - t[0]))} s", str(len(t))))
    parts = [_table(("Condition", "Used as", "Length", "Samples"), rows, (2, 3))] if rows else []
    gap, lines = s.answer.gap, []
    if s.answer.guessed:
        lines.append(f"{GUESS}, from the fast part of what the best model leaves. Probabilities and intervals rest on that guess.")
    if gap is not None and gap.before > 0.0:
        lines.append(f"{percent(gap.within_calibration / gap.before)} of the gap lies within the tolerances of calibrated numbers.")
    if (tests := s.answer.tests) is not None:
        lines.append(
            f"Of simulated machines without effects, {percent(tests.p_none)} speak as much for an effect as these runs do; "
            f"an effect is believed below {percent(tests.false_alarm)}, the false-alarm rate that was asked for."
        )
        if s.answer.which:
            lines.append(
                f"The best model is right, and not only the nearest in the catalogue, with a probability of {percent(tests.p_fit)}."
            )
    arrays = dict.fromkeys(base_name(c) for c in s.found.channels)
    lines += [f"Not looked for: {text}." for text in s.answer.skipped]
    parts += [_paragraph(text, "note" if "guess" in text else "") for text in lines]
    parts.append(f"<p>Channels: {', '.join(_code(a) for a in arrays)}.</p>" if arrays else "")
    effort = s.answer.effort.simulations
    parts.append(
        _paragraph(
            f"Catalogue: {s.catalogue.file.name}. {_count(effort, 'simulation')} of the closed loop. What the method cannot do: docs/explanation/limits.md."
        )
    )
    return "\n".join(p for p in parts if p)
