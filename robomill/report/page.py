"""The page: one HTML file without scripts, that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from importlib.resources import files

from robomill.diagnosis.localisation.where import WHOLE
from robomill.report import far, form, log, rests, seen, where, which
from robomill.report.html import count
from robomill.report.subject import HELD_OUT, KINDS, Subject, closed, verdict_sentence
from robomill.report.units import percent
from robomill.report.words import rank

BADGES = {
    "none": "No effect found",
    "identified": "Identified",
    "ambiguous": "Ambiguous",
    "unknown": "Not in the catalogue",
    "bad_log": "Log not usable",
}
VIEWER = "view.html"
"""Page that shows the runs in space; it is linked where it lies beside."""


def page(s: Subject, figures: Mapping[str, str], *, viewer: bool = False) -> str:
    """The HTML of a diagnosis; `figures` name -> HTML. `viewer`: VIEWER lies beside the page."""
    style = files("robomill.report").joinpath("style.css").read_text(encoding="utf-8")
    sections = [
        ("log", "Is the log usable?", log.section(s, figures)),
        ("which", "Which effect causes it?", which.section(s)),
        ("far", "How far does it shrink?", far.section(s, figures)),
        ("form", "What the unknown is like", form.section(s, figures)),
        ("where", "Where is the gap?", where.section(s, figures)),
        ("sure", "How sure is that?", rests.sure(s)),
        ("seen", "What these runs could not have shown", seen.section(s, figures)),
        ("next", "What to measure next", rests.next_run(s)),
        ("about", "What this rests on", rests.about(s)),
    ]
    shown = [(key, title, body) for key, title, body in sections if body]
    links = "".join(f'<a href="#{key}">{title}</a>' for key, title, _ in shown)
    links += f'<a href="{VIEWER}">See it in space</a>' if viewer else ""
    blocks = "\n".join(f'<section id="{key}">\n<h2>{title}</h2>\n{body}\n</section>' for key, title, body in shown)
    title = f"{BADGES[s.verdict]}: {s.system.name}"
    over = " · ".join(filter(None, ["Machine against simulation", s.system.name, s.made]))
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
<p class="over">{escape(over)}</p>
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


def _tiles(s: Subject) -> str:
    tiles: list[tuple[str, str, str]] = []
    whole = s.far(s.hardest, WHOLE)
    if s.hardest is not None and whole is not None:
        value, interval = closed(whole)
        nevertheless = "Closed nevertheless" if s.verdict == "unknown" and s.answer.number is None else "Gap closed"
        tiles.append((f"{nevertheless}, in {KINDS[s.hardest]}", value, ", ".join(filter(None, [interval, far.ceiling(whole, "at best ")]))))
    if s.verdict == "identified":
        least = min((w.probability for w in s.sure), default=0.0)
        about = f"{'with a probability of' if len(s.sure) == 1 else 'the least certain one:'} {percent(least)}"
        tiles.append(("Effects named", str(len(s.sure)), about))
    if (x := s.answer.number) is not None:
        tiles.append(("Number of the model", x.name, f"with a probability of {percent(x.probability)}"))
    if s.verdict == "ambiguous":
        tiles.append(("Possible causes", str(len(s.answer.which)), f"{len(s.sure)} of them certain"))
    if (tests := s.answer.tests) is not None:
        why = rests.no_effect(tests) if s.verdict == "none" else "p_none"
        about_tests = {
            "p_none": ("Machines without effects where one seems as likely", rank(tests.p_none), "of simulated ones"),
            "nothing": ("Probability that nothing is wrong", percent(tests.nothing), "new conditions included"),
            "p_fit": (
                "Probability that the nearest candidate is right",
                percent(tests.p_fit),
                "and the gap is no larger than noise may be",
            ),
        }
        tiles.append(about_tests[why])
    if s.verdict != "bad_log":
        guess = "guessed" if s.answer.guessed else "known from repeats"
        tiles.append(("Noise", guess, "nothing was repeated" if s.answer.guessed else "repeats of the same run"))
    used = [c for c in s.conditions if not c.endswith(HELD_OUT)]
    held = len(s.conditions) - len(used)
    about = f"{count(len(used), 'condition')} diagnosed{f', {held} held out' if held else ''}, {len(s.found.channels)} channels"
    tiles.append(("Runs", str(len(s.runs)), about))
    return '<dl class="tiles">' + "".join(f"<div><dt>{a}</dt><dd>{b}<small>{escape(c)}</small></dd></div>" for a, b, c in tiles) + "</dl>"
