"""Section: what these runs could not have shown."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from robomill.diagnosis.outcome.verdict import believed
from robomill.report.figures import smallest
from robomill.report.html import figure, fold, paragraph, table
from robomill.report.subject import Subject, listed, together
from robomill.report.units import number, quantity, relative

HIDDEN = 8
"""Effects that the sentence names, at most; the table has all of them."""


def section(s: Subject, figures: Mapping[str, str]) -> str:
    """From which size each effect shows; which ones would have been missed at their usual size, and why that may be."""
    effects = smallest(s)
    if s.verdict == "bad_log" or not effects:
        return ""
    scales = {(c.effect, c.location): c.prior.scale for c in s.catalogue.candidates}
    rows, hidden = [], {}
    for effect, places in effects:
        best, worst = places[0][1], places[-1][1]
        unit = relative(best.parameter, best.unit)
        where = f"{escape(best.location)}: {quantity(abs(best.value), unit)}"
        least = f"{escape(worst.location)}: {quantity(abs(worst.value), unit)}" if len(places) > 1 else "–"
        usual = quantity(scales[effect, best.location], unit)
        rows.append((escape(effect.replace("_", " ")), where, least, usual, number(places[0][0])))
        if missed := [v.location for size, v in places if size > 1.0]:
            hidden[effect.replace("_", " ")] = (missed, len(places))
    shown_at = {(effect, v.location) for effect, places in effects for _, v in places}
    never = {(v.effect, v.location) for v in s.answer.smallest_visible or ()} - shown_at
    total, missed_in_all = sum(len(p) for _, p in effects) + len(never), sum(len(m) for m, _ in hidden.values()) + len(never)
    slow = s.answer.suspected and s.answer.tests and believed(s.answer.tests)
    known = "would have been named if the noise were not a guess" if slow else "would have been seen"
    text = (
        f"“Not found” says as much as these runs can show: an effect above the sizes below {known} (five standard deviations of "
        f"noise and tolerances), a smaller one may be there. Of {total} effects and places, {missed_in_all} would have been missed at their usual size"
    )
    names = [effect if len(m) == n else f"{effect} ({together(sorted(m))})" for effect, (m, n) in list(hidden.items())[-HIDDEN:]]
    more = f"; the {HIDDEN} that show least" if len(hidden) > HIDDEN else ""
    text += f"{more}: {listed(names)}." if names else "."
    advice = (
        "What would help, repeats, channels or another kind of run, is listed effect by effect by the same command with --check."
        if missed_in_all
        else ""
    )
    caption = "From which size each effect would have been seen, in units of its usual size. Right of the line, an effect of usual size would have been missed."
    shown = table(("Effect", "Shows best", "Shows worst", "Usual size", "Smallest visible / usual"), rows, (3, 4))
    picture = figure(figures, "visible", caption)
    if s.verdict == "none":
        return paragraph(text) + picture + fold("All sizes", shown) + paragraph(advice)
    return paragraph(text) + fold("All sizes", picture + shown) + paragraph(advice)
