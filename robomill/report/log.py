"""Section: is the log usable?"""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from robomill.diagnosis.candidates import LOGGING
from robomill.report.html import code, figure, paragraph, table
from robomill.report.subject import Subject
from robomill.report.units import number, quantity


def section(s: Subject, figures: Mapping[str, str]) -> str:
    """What was found in the log, and what to do about it."""
    findings = s.answer.findings
    if not findings:
        clocks = any(c.component == LOGGING for c in s.catalogue.candidates)
        rest = "" if clocks else " Clocks that are late were not looked for: the catalogue has no effect of one."
        return paragraph(
            f"Yes. Time base, missing and constant samples, ranges, signs, units{', axes and clocks' if clocks else ' and axes'} were looked at; "
            f"nothing was found.{rest}"
        )
    rows = []
    for f in findings:
        if f.repaired:
            status = "corrected"
        elif f.fatal and s.verdict == "bad_log":
            status = '<span class="bad">stops the diagnosis</span>'
        else:
            status = "noted"
        size = quantity(f.value, f.unit) if f.unit not in ("", "1") else number(f.value)
        rows.append((code(f.channel), escape(f.kind), escape(f.text), size, status))
    text = "No, for these reasons:" if s.verdict == "bad_log" else "Yes. This was noticed:"
    remedy = ""
    if s.verdict == "bad_log":
        clocks = any(f.kind == "lag" and f.fatal for f in findings)
        remedy = paragraph(
            "A clock that is late looks like an effect of the machine, so nothing is diagnosed until it is right. Correct it in the import "
            "(shift = … in the mapping), or let robomill diagnose --repair correct it and diagnose the rest."
            if clocks
            else "Correct the log (signs, units, columns and frames are set in the mapping of robomill import), or leave out the runs concerned."
        )
    shown = table(("Channel", "Kind", "What", "Size", "Consequence"), rows, (3,))
    return paragraph(text) + shown + figure(figures, "log", "The channels in question, beside what the simulation says.") + remedy
