"""Section: what the unknown is like, where the answer has a form for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from robomill.diagnosis.forms.layout import Form, PortForm
from robomill.diagnosis.localisation.where import WHOLE
from robomill.models.components.file_names import FORM
from robomill.report.html import code, figure, paragraph, table
from robomill.report.sheet import Sheet
from robomill.report.style import AFTER, BEFORE, MUTED
from robomill.report.subject import ALL, KINDS, Subject, closed, hardest, left, listed, there_was
from robomill.report.units import join, number, percent, quantity, scale, with_interval

CURVES = 6
"""Ports whose curve is drawn, at most: those with the largest parts of the gap come first."""


def section(s: Subject, figures: Mapping[str, str]) -> str:
    """Formula, terms and curve of each port; how far the gap shrinks with it; where it was seen, and where it is worse.

    Of a form that the closed loop refutes only the formula, and why it is of no use.
    """
    f = s.answer.form
    if f is None or not f.ports:
        return ""
    what = "added to what comes out of" if f.side == "output" else "added to what goes into"
    fitted = f"a sum of terms, {what} {f.component}, chosen and fitted on the diagnosed runs"
    text = (
        f"No entry of the catalogue says it, and no form was found for it that is of use. This one is {fitted}."
        if f.refuted
        else f"No entry of the catalogue says it, but it has a form: {fitted}. It describes the gap; it does not name the cause."
    )
    parts = [paragraph(text), *("<pre><code>" + escape(f"{p.port} += {p.formula}   [{p.unit}]") + "</code></pre>" for p in f.ports)]
    if f.refuted:  # what it closes outside of the loop is no merit
        return "\n".join([*parts, paragraph(f.note)])
    parts += [paragraph(f"It is {listed(f.like, 'or')}.")] if f.like else []
    caption = "What the nominal simulation leaves, and the form, over the variable of its first term (means of samples with like values)."
    parts += [figure(figures, "form", caption), _terms(f.ports), _closes(s, f), _ranges(f), paragraph(f.note) if f.note else ""]
    if f.specification:
        parts.append(paragraph("Simulate with it:") + f"<pre><code>robomill run SCENARIO.toml --adopt adopt{FORM}</code></pre>")
    return "\n".join(p for p in parts if p)


def _terms(ports: Sequence[PortForm]) -> str:
    rows: list[Sequence[str]] = []
    for p in ports:
        rows.append((f"{code(p.port)}: {percent(p.closure)} of its gap in blocks of time that it was not fitted to",))
        for t in p.terms:
            value, interval = with_interval(t.coefficient, t.interval, t.unit)
            rows.append((code(t.term), f"{value}<small>{interval}</small>", percent(t.adds)))
    return table(("Term", "Coefficient (90 %)", "Closes"), rows, (1, 2))


def _closes(s: Subject, f: Form) -> str:
    """The closed loop with the form, in the hardest test."""
    kind = hardest(f.how_far)
    if kind is None:
        return ""
    rows = []
    for h in (h for h in f.how_far if h.on == kind):
        value, interval = closed(h)
        sizes = ("–", "–") if h.channel == WHOLE else (there_was(h), left(h))
        rows.append(
            (escape(ALL if h.channel == WHOLE else s.titles.get(h.channel, h.channel)), *sizes, f"{value}<small>{interval}</small>")
        )
    worse = [
        f"{w.channel} ({KINDS[w.on]}: from {quantity(w.before, w.unit)} to {quantity(w.after, w.unit)})"
        for w in f.worse
        if not w.channel.startswith(WHOLE)
    ]
    remark = f" It makes worse: {listed(worse)}." if worse else ""
    text = f"The closed loop with the form in it, in {KINDS[kind]}.{remark}"
    return f"<h3>How far it closes the gap</h3>\n{paragraph(text)}{table(('Rms of', 'Before', 'After', 'Closed (90 %)'), rows, (1, 2, 3))}"


def _ranges(f: Form) -> str:
    if not f.ranges:
        return ""

    def span(ends: Sequence[float] | None, unit: str) -> str:
        if ends is None:
            return "–"
        factor, symbol = scale(unit, max(map(abs, ends)))
        return join(f"{number(factor * ends[0])} to {number(factor * ends[1])}", symbol)

    rows = [(code(r.variable), span(r.seen, r.unit), span(r.held_out, r.unit)) for r in f.ranges]
    text = "Beyond what its variables were in the diagnosed runs, nobody knows whether it holds."
    return paragraph(text) + table(("Variable", "Diagnosed runs", "Held-out runs"), rows)


def draw(s: Subject, sheet: Sheet) -> Figure | None:
    """For each port the mean gap and the form over a variable."""
    f = s.answer.form
    shown = [(p, p.curve) for p in f.ports if p.curve is not None][:CURVES] if f is not None and not f.refuted else []
    if not shown:
        return None
    columns = 1 if sheet.narrow else min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure = sheet.figure(0.4 + 1.9 * rows, 2)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, (p, c) in zip(axes, shown, strict=False):
        factor, symbol = scale(p.unit, float(np.abs([*c.left, *c.form]).max()) or 1.0)
        x = np.asarray(c.x)  # in the unit that the formula has
        ax.axhline(0.0, color=MUTED, lw=0.5)
        ax.plot(x, factor * np.asarray(c.left), "o", color=BEFORE, ms=3.0)
        ax.plot(x, factor * np.asarray(c.form), color=AFTER, lw=1.4)
        ax.set_title(Sheet(sheet.width / columns).title(p.port))
        ax.set_ylabel(symbol or "(no unit)")
        ax.set_xlabel(f"{c.variable}{f' in {c.unit}' if c.unit != '1' else ''}")
    for ax in axes[len(shown) :]:
        ax.axis("off")
    handles = [Line2D([], [], color=BEFORE, marker="o", ms=3.0, lw=0, label="left by the nominal simulation")]
    sheet.legend(figure, [*handles, Line2D([], [], color=AFTER, lw=1.4, label="form")])
    return figure
