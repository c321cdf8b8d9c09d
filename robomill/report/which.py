"""Section: which effect causes it?"""

from __future__ import annotations

from html import escape

from robomill.diagnosis.inference.intervals import MATERIAL
from robomill.diagnosis.inference.isolability import CONFUSABLE
from robomill.diagnosis.outcome.answer import Which
from robomill.diagnosis.outcome.verdict import IDENTIFIED
from robomill.report.html import bar, code, fold, paragraph, table
from robomill.report.subject import Subject, effect_name, of_number, spoken
from robomill.report.units import number, percent, quantity, relative, with_interval
from robomill.report.words import likelihood

PAIRS = 12
"""Pairs of candidates that are listed, at most."""
_ALONE = (
    "Every candidate of the catalogue was fitted in the closed loop, alone and together. This one remains, or something without a name:"
)
"""In place of the introduction where an ambiguous answer has one effect."""
_TOGETHER = "Effects of the catalogue do as much together. That several of them are as large as that takes is less likely than one number:"
"""In place of the introduction where one number of the model does as much as several effects."""
_BESIDE = "The effects that the number stands beside are part of the cause."
"""In place of the introduction where a number of the model is not all of it."""
_OTHERS = "The others do together as much as the number, which is less likely than one number:"
_ADOPTED = "<pre><code>robomill run SCENARIO.toml --adopt adopt.ssv</code></pre>"
_INTRO = {
    "none": "None is needed. These came closest:",
    "identified": "Every candidate of the catalogue was fitted in the closed loop, alone and together. These remain:",
    "ambiguous": "Every candidate of the catalogue was fitted in the closed loop, alone and together. These remain, and the runs cannot choose:",
    "unknown": "None of the catalogue alone. These fit best, but leave too much or do not hold; their values should not be believed:",
    "bad_log": "Candidates that fit what the log shows, among them its clocks. They are no findings as long as the log is wrong:",
}


def section(s: Subject) -> str:
    """Candidates with their values, the sets that hold the cause, and how to simulate with the answer."""
    if not s.answer.which:
        return _number(s)
    described = s.catalogue.descriptions
    rows = []
    for w in s.answer.which:
        others = [spoken(c) for c in w.confusable_with]
        names = "".join(f"<small>{code(w.component + '.' + n)}</small>" for n in w.parameters)
        rows.append(
            (
                f"<strong>{escape(effect_name(w))}</strong><small>{escape(described.get(w.effect, ('', ''))[0])}{_small(w)}</small>",
                bar(w.probability),
                _values(w),
                f"{escape(w.component)}{names}",
                escape("; ".join(others)) or "–",
            )
        )
    if s.verdict == "none":  # probabilities of what is not there would only confuse
        closest = [(effect, values, component) for effect, _, values, component, _ in rows]
        return paragraph(_INTRO[s.verdict]) + table(("Effect", "Value (90 % interval)", "Component"), closest) + paragraph(_tried(s))
    shown = table(("Effect", "Probability", "Value (90 % interval)", "Component", "Could be confused with"), rows)
    onset = paragraph(f"{spoken(s.answer.onset.text)}.") if s.answer.onset else ""
    intro = _ALONE if s.verdict == "ambiguous" and len(s.answer.which) == 1 else _INTRO[s.verdict]
    if (x := s.answer.number) is not None and x.beside:
        intro = f"{_BESIDE} {_OTHERS}" if x.instead_of else _BESIDE
    elif x is not None and x.instead_of:
        intro = _TOGETHER
    return _number(s) + paragraph(intro) + shown + onset + _sets(s) + _isolability(s) + paragraph(_tried(s)) + _adopt(s)


def _small(w: Which) -> str:
    return "" if w.material else f"; closes less than {percent(MATERIAL)} of every channel: listed, no cause"


def _tried(s: Subject) -> str:
    return f"{len(s.catalogue.candidates)} candidates ({len(s.catalogue.effects)} effects) were tried."


def _values(w: Which) -> str:
    texts = []
    for name, p in w.parameters.items():
        value, interval = with_interval(p.value, p.interval, relative(name, p.unit))
        on_top = "" if p.given is None else f"<small>on top of {escape(quantity(p.given, relative(name, p.unit)))}</small>"
        texts.append(f"{value}<small>{interval}</small>{on_top}")
    return "".join(texts)


def _sets(s: Subject) -> str:
    """Sets that hold the cause with more certainty than any of their members."""
    if s.verdict == "bad_log":
        return ""
    rows = []
    for f in s.answer.families:
        likeliest = max(f.members.values())
        if likeliest < IDENTIFIED and percent(f.probability) != percent(likeliest):
            members = [f"{spoken(name)} ({percent(p)})" for name, p in f.members.items() if percent(p) != percent(0.0)]
            rows.append((bar(f.probability), escape("; ".join(members))))
    if not rows:
        return ""
    text = "It is one of each of these, with more certainty than which one of them. These runs do not tell the members apart."
    return f"<h3>Sets that hold the cause</h3>\n{paragraph(text)}{table(('One of the set', 'Members'), rows)}"


def _isolability(s: Subject) -> str:
    if not s.answer.isolability or s.verdict == "bad_log":
        return ""
    rows = [
        (
            " against ".join(escape(spoken(n)) for n in p.pair),
            number(p.distance, 1.0),
            "cannot be told apart" if p.confusable else "told apart",
        )
        for p in s.answer.isolability[:PAIRS]
    ]
    text = (
        f"Distance between what two candidates do to these signals, at the values that fit best, in standard deviations of noise; "
        f"below {CONFUSABLE:g} the runs cannot tell them apart."
    )
    return fold("Which candidates these runs can tell apart", paragraph(text) + table(("Pair", "Distance", "So they"), rows, (1,)))


def _number(s: Subject) -> str:
    """The number of the model that explains the gap by itself."""
    if (x := s.answer.number) is None:
        return ""
    text = (
        f"No effect of the catalogue is about {x.name}, and this number of the model explains the gap{'' if x.beside else ' by itself'}: {of_number(x)}. "
        f"That it is right is {likelihood(x.probability)}. If it may be wrong, measure it, or give it an effect in the catalogue. Simulate with it:"
    )
    return paragraph(text) + _ADOPTED


def _adopt(s: Subject) -> str:
    if s.verdict not in ("identified", "ambiguous"):
        return ""
    text = "The most probable answer is in adopt.ssv. Simulate with it:" if s.verdict == "ambiguous" else "Simulate with it:"
    return paragraph(text) + _ADOPTED
