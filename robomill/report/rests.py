"""Sections: how sure that is, what to measure next, and what it rests on."""

from __future__ import annotations

from dataclasses import asdict
from html import escape

from robomill.diagnosis.inference.isolability import CONFUSABLE
from robomill.diagnosis.inference.machines import MACHINES
from robomill.diagnosis.outcome.next_run import Alternative, NextRun
from robomill.diagnosis.outcome.verdict import Tests
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import base_name
from robomill.report.html import code, count, fold, paragraph, table
from robomill.report.subject import GUESS, HELD_OUT, Subject, because, listed, spoken
from robomill.report.units import number, percent, quantity
from robomill.report.words import likelihood, one_in, rank

UNSET = "1970-01-01"
"""Date of a logger whose clock was never set."""


def sure(s: Subject) -> str:
    """The tests of the answer in words; their numbers behind a fold."""
    tests, moved, gap = s.answer.tests, s.answer.transfer, s.answer.gap
    if tests is None:
        return ""
    lines, numbers = [], []
    if s.answer.guessed:
        lines.append(f"{GUESS}, from the fast part of what the best model leaves. Probabilities and intervals rest on that guess.")
    enough = {
        "p_none": "so no effect is believed",
        "nothing": f"which is kept; but that nothing is wrong has a probability of {percent(tests.nothing)}, more than that limit, so no effect is believed",
        "p_fit": "so something is believed to be there",
    }[no_effect(tests)]
    lines.append(
        f"Is there an effect at all? Of {MACHINES} simulated machines that have none, {rank(tests.p_none)} speak as strongly for one as these runs do. "
        f"The limit that was asked for is {one_in(tests.false_alarm)}, {enough}."
    )
    numbers.append(f"p_none = {number(tests.p_none)}; probability of the nominal model, new conditions included: {number(tests.nothing)}.")
    if s.verdict == "none" and no_effect(tests) == "p_fit":
        lines.append(
            f"Is it an effect of the catalogue? That the nearest one is right is {likelihood(tests.p_fit)}, and what the nominal simulation leaves "
            "is no more than noise may be. So nothing is named."
        )
    if s.answer.which and s.verdict != "none":
        lines.append(
            f"Is it that effect, or the nearest thing in the catalogue? That the best model is right is {likelihood(tests.p_fit)}, "
            "judged by what it leaves, by how far calibrated numbers are off, and by how it holds in new conditions where there are any."
        )
        of = asdict(tests.odds) if tests.odds else {}
        made = f", made of {listed([f'{name} {number(value, 0.1)}' for name, value in of.items()])} nats" if of else ""
        numbers.append(f"p_fit = {number(tests.p_fit)}{made}.")
    if s.answer.unknown:
        lines.append(f"What speaks against it? It {listed(because(s))}.")
    it = "the answer" if s.verdict in ("identified", "ambiguous") else "the nearest candidate"
    if moved is not None:
        lines.append(
            f"Does it hold elsewhere? In new conditions, which were not fitted, {it} acts {number(moved.amplitude, 0.1)} ± "
            f"{number(1.645 * moved.deviation, 0.1)} times as strongly as it should (90 %). The squares of the gap are {number(moved.before)} times "
            f"those of noise there with the nominal simulation, and {number(moved.after)} times with {it}."
        )
        numbers.append(
            f"Gain in log score in new conditions {number(moved.gain)} nats, {number(moved.expected_gain)} nats expected; "
            f"whitened chi2 over that of noise {number(moved.before)} before, {number(moved.after)} after."
        )
    elif s.verdict in ("identified", "ambiguous"):
        lines.append("Does it hold elsewhere? Nobody knows: no new condition was held out.")
    if gap is not None and gap.before > 0.0:
        share = percent(gap.within_calibration / gap.before)
        lines.append(
            f"{share} of the gap in the diagnosed runs lies within the tolerances of calibrated numbers: no effect is needed for that part."
            + (f" Of these numbers the farthest off: {gap.farthest.text}." if gap.farthest is not None else "")
        )
        numbers.append(f"Whitened squares of the gap, noise taken off: {number(gap.before)} before, {number(gap.after)} after.")
    if s.answer.calibrated:
        off = "; ".join(p.text for p in s.answer.calibrated)
        lines.append(
            f"Is all that is calibrated what it is said to be? Not if the best model is right: {off}. Measure these numbers anew. "
            "If they are right, something is wrong that the catalogue does not have."
        )
    body = "".join(paragraph(text, "note" if text.startswith(GUESS) else "") for text in lines)
    return body + fold("The numbers behind that", "".join(paragraph(n) for n in numbers))


def no_effect(tests: Tests) -> str:
    """Which of the tests an effect fails first: `p_none`, `nothing`, or only `p_fit`."""
    return "p_none" if tests.p_none > tests.false_alarm else "nothing" if tests.nothing > tests.false_alarm else "p_fit"


def next_run(s: Subject) -> str:
    """The run that would tell the rest apart."""
    r = s.answer.next_run
    if r is None:
        return ""
    pair = listed([spoken(x) for x in r.separates])
    if r.separated:
        text = f"{r.kind[0].upper()}{r.kind[1:]}: it separates {pair}."
    else:
        text = f"No run that was looked at would tell apart {pair}. The one that comes nearest: {r.kind}."
    parts = [f"<p><strong>{escape(text)}</strong></p>"]
    parts.append(
        paragraph(
            f"{count(r.repeats, 'repeat')}, about {r.minutes:g} minutes with setting up. They would then be {number(r.distance, 1.0)} "
            f"standard deviations of noise apart instead of {number(r.now, 1.0)} now; {CONFUSABLE:g} are needed."
        )
    )
    settings = [f"{name} = {quantity(v.value, v.unit)}" for name, v in r.parameters.items()]
    if settings:
        parts.append("<pre><code>" + escape("\n".join(settings)) + "</code></pre>")
    if r.alternatives:
        tried: list[NextRun | Alternative] = [r, *r.alternatives]
        rows = [(escape(a.kind), number(a.distance, 1.0), f"{a.minutes:g}", number(a.per_minute)) for a in tried]
        shown = table(("Run", "Deviations apart", "Minutes", "Nats per minute"), rows, (1, 2, 3))
        parts.append(fold("Other runs that were looked at", shown))
    return "\n".join(parts)


def about(s: Subject) -> str:
    """Conditions, runs with their dates, what was not looked for, and how much was simulated."""
    rows = []
    for condition in s.conditions:
        t = s.found.curves[condition]["t"]
        kind = "diagnosed"
        if condition.endswith(HELD_OUT):
            kind = "held out: repeat" if condition.removesuffix(HELD_OUT) in s.found.curves else "held out: new condition"
        rows.append((escape(condition.removesuffix(HELD_OUT)), kind, f"{number(float(t[-1] - t[0]))} s", str(len(t))))
    parts = [table(("Condition", "Used as", "Length", "Samples"), rows, (2, 3))] if rows else []
    runs = [(code(r.folder.name), escape(str(r.info.get("labels", {}).get("condition", "–"))), escape(recorded(r))) for r in s.runs]
    parts.append(fold(f"{count(len(runs), 'run')}", table(("Run", "Condition", "Recorded"), runs)) if runs else "")
    parts += [paragraph(f"Not looked for: {text}.") for text in s.answer.skipped]
    arrays = dict.fromkeys(base_name(c) for c in s.found.channels)
    parts.append(f"<p>Channels: {', '.join(code(a) for a in arrays)}.</p>" if arrays else "")
    effort = s.answer.effort.simulations + s.answer.effort.taken_over
    made = f" {s.made[0].upper()}{s.made[1:]}." if s.made else ""
    parts.append(
        paragraph(
            f"Catalogue: {s.catalogue.file.name}. {count(effort, 'simulation')} of the closed loop.{made} What the method cannot do: docs/explanation/limits.md."
        )
    )
    return "\n".join(p for p in parts if p)


def recorded(run: Run) -> str:
    """When a run was recorded, or simulated, to the minute; a dash where nobody knows."""
    date = str(run.info.get("imported", {}).get("date") or run.info.get("created") or "")
    return date[:16].replace("T", " ") if date and not date.startswith(UNSET) else "–"
