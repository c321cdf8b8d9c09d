"""Section: how far does it shrink?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from robomill.diagnosis.localisation.where import WHOLE
from robomill.diagnosis.outcome.closure import HowFar
from robomill.report.html import figure, fold, paragraph, table
from robomill.report.subject import ALL, KINDS, Subject, closed, left, size, spoken, there_was
from robomill.report.units import percent


def section(s: Subject, figures: Mapping[str, str]) -> str:
    """The gap effect by effect, before and after, and the closure beside what could be closed."""
    if not s.answer.how_far or s.verdict == "bad_log":
        return ""
    claim = "" if s.verdict != "unknown" else " The model is not adequate: this is what it closes nevertheless."
    if s.answer.number is not None:
        with_it = " with the effects beside it" if s.answer.number.beside else " alone"
        claim = f" It is the number {s.answer.number.name}{with_it} that closes this."
    noise = (
        "The noise is a guess, so it is not taken off: it is part of what was there before and of what remains."
        if s.answer.guessed
        else "Noise is taken off."
    )
    return (
        paragraph(
            f"The closed loop was simulated again with the fitted values, in runs that nothing was fitted to as far as there are any. {noise}{claim}"
        )
        + _steps(s, figures)
        + figure(figures, "overlay", "Measured minus simulated, before and after, on the diagnosed run and on runs that were held out.")
        + figure(figures, "closure", "Closed share of the gap, with its 90 % interval, against the best that any model could do.")
        + _table(s)
        + paragraph(
            "Rms: root mean square; of an array, of the length of its vector. Closed: the share of the squares that is gone, so 90 % closed means that the rms is a third. "
            "At best: what the runs themselves have in common; where a condition was measured once (≥), what a regression on the simulated signals closes. "
            "Not measurable: there is no gap beside the noise."
        )
    )


def _steps(s: Subject, figures: Mapping[str, str]) -> str:
    steps = s.answer.steps
    if steps is None or "steps" not in figures:
        return ""
    columns = [h for h in (*s.figures(steps.on), s.far(steps.on, WHOLE)) if h is not None and h.closure is not None]
    rows: list[Sequence[str]] = [("before", *("0 %" if h.channel == WHOLE else there_was(h) for h in columns))]
    for step in steps.added:
        cells = []
        for h in columns:
            now = step.left[h.channel]
            share = percent(min(max(now.closure, 0.0), 1.0)) if now.closure is not None else "–"
            cells.append(share if h.channel == WHOLE else f"{size(h, now.after)}<small>{share}</small>")
        rows.append((escape(spoken(step.effect)), *cells))
    rows.append(("what remains", *(closed(h)[0] if h.channel == WHOLE else left(h) for h in columns)))
    rows.append(("noise", *("–" if h.channel == WHOLE else size(h, h.floor) for h in columns)))
    heads = [
        "With the effect and all above it",
        *(f"{s.titles.get(h.channel, h.channel)}" if h.channel != WHOLE else "closed in all" for h in columns),
    ]
    caption = (
        f"Each effect added to those above it, and how far the gap shrinks, in {KINDS[steps.on]}. The order is by what an effect explains of "
        "what is left in all signals, each over its noise: in one of them a small step may come before a large one."
    )
    return figure(figures, "steps", caption) + fold("Effect by effect, all figures", table(heads, rows, range(1, len(heads))))


def _table(s: Subject) -> str:
    rows: list[Sequence[str]] = []
    for kind, name in KINDS.items():
        here = [h for h in (s.far(kind, WHOLE), *s.figures(kind)) if h is not None]
        if here:
            rows.append((escape(name[0].upper() + name[1:]),))
        for h in here:
            title = ALL if h.channel == WHOLE else s.titles.get(h.channel, h.channel)
            sizes = (
                ("–",) * 3
                if h.channel == WHOLE
                else (
                    size(h, h.before) if h.measurable else "within the noise",
                    "within the noise" if h.within_noise else size(h, h.after),
                    size(h, h.floor),
                )
            )
            value, interval = closed(h)
            rows.append((escape(title), *sizes, f"{value}<small>{interval}</small>", ceiling(h) or "–"))
    return table(("Rms of", "Before", "After", "Noise", "Closed (90 %)", "At best"), rows, (1, 2, 3, 4, 5))


def ceiling(h: HowFar, before: str = "") -> str:
    """What any model could close; a regression shows what can be closed at least. Nothing where it is not known, or nothing is left."""
    if h.ceiling is None or h.within_noise:
        return ""
    return f"{before}{'≥ ' if h.ceiling_by == 'regression' else ''}{percent(h.ceiling)}"
