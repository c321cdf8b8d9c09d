"""`robomill diagnose --check` on the screen: what the runs show, effect by effect."""

from __future__ import annotations

from robomill import tables
from robomill.diagnosis.check import Checked, Shown
from robomill.report import units
from robomill.report.subject import together
from robomill.tables import Heading

HEADINGS = (
    Heading("effect", "left"),
    Heading("shows at", "left", folds=True),
    Heading("smallest visible"),
    Heading("usual"),
    Heading("tolerances\n%"),
    Heading("does not show at", "left", folds=True),
    Heading("would help", "left", folds=True),
)


def show(checked: Checked) -> None:
    """The table, sets that do not split, and what is missing."""
    made = ", ".join(f"{name} ({n} repeat{'' if n == 1 else 's'})" for name, n in checked.conditions.items())
    guess = "; nothing was repeated, so the noise is a guess" if checked.noise_is_a_guess else ""
    by_effect: dict[str, list[Shown]] = {}
    for e in checked.effects:
        by_effect.setdefault(e.effect, []).append(e)
    tables.show(f"{made}{guess}", HEADINGS, [(effect, *_row(places)) for effect, places in by_effect.items()])
    tables.say(*(f"will not split: {', '.join(names)}" for names in checked.sets))
    remarks = [("changes no measured channel", checked.nothing), ("measured, and no effect changes it", checked.silent)]
    tables.say(*(f"{what}: {', '.join(found)}" for what, found in remarks if found))
    tables.say(*(f"missing: {text}" for text in checked.missing))
    tables.notes(checked.skipped, "what --json prints")
    effort = checked.effort
    tables.say(f"{effort.simulations} simulations, {effort.taken_over} taken over, {effort.seconds:.0f} s")


def _row(places: list[Shown]) -> tuple[str, ...]:
    """What all places of an effect have in common, and the range of the rest; (never): where no size of the catalogue shows."""
    first = places[0]
    unit = units.relative(first.parameter, first.unit)
    sizes = sorted(p.smallest for p in places)
    span = [units.quantity(size, unit) for size in (sizes[:1] if len(sizes) == 1 else (sizes[0], sizes[-1]))]
    shares = sorted({round(100.0 * p.by_tolerance) for p in places})
    helps = dict.fromkeys(h.name for p in places for h in (*p.channels[:1], *p.runs[:1]))
    hidden = [(together([p.location for p in places if p.state == state]), end) for state, end in (("if large", ""), ("not", " (never)"))]
    return (
        together([p.location for p in places if p.state == "shows"]) or "-",
        " .. ".join(dict.fromkeys(span)),
        units.quantity(first.usual, unit),
        " .. ".join(map(str, dict.fromkeys((shares[0], shares[-1])))),
        "; ".join(f"{names}{end}" for names, end in hidden if names) or "-",
        ", ".join(helps) or "-",
    )
