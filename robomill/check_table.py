"""`robomill diagnose --check` on the screen: what the runs show, effect by effect."""

from __future__ import annotations

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from robomill.diagnosis.check import Checked, Shown
from robomill.report import units
from robomill.report.subject import together

HEADINGS = ("effect", "shows at", "smallest visible", "usual", "tolerances\n%", "does not show at", "would help")


def show(checked: Checked, console: Console) -> None:
    """The table, sets that do not split, and what is missing."""
    made = ", ".join(f"{name} ({n} repeat{'' if n == 1 else 's'})" for name, n in checked.conditions.items())
    guess = "; nothing was repeated, so the noise is a guess" if checked.noise_is_a_guess else ""
    table = Table(title=f"{made}{guess}", title_justify="left", box=SIMPLE)
    for heading in HEADINGS:
        table.add_column(heading, justify="right" if heading in HEADINGS[2:5] else "left", no_wrap=heading == HEADINGS[0], overflow="fold")
    by_effect: dict[str, list[Shown]] = {}
    for e in checked.effects:
        by_effect.setdefault(e.effect, []).append(e)
    for effect, places in by_effect.items():
        table.add_row(effect, *_row(places))
    console.print(table)
    for names in checked.sets:
        console.print(f"will not split: {', '.join(names)}", highlight=False, markup=False)
    notes = [("changes no measured channel", checked.nothing), ("measured, and no effect changes it", checked.silent)]
    for what, found in notes:
        if found:
            console.print(f"{what}: {', '.join(found)}", highlight=False, markup=False)
    for text in checked.missing:
        console.print(f"missing: {text}", highlight=False, markup=False)
    for text in checked.skipped:
        console.print(f"note: {text}", highlight=False, markup=False)
    effort = checked.effort
    console.print(f"{effort.simulations} simulations, {effort.taken_over} taken over, {effort.seconds:.0f} s", highlight=False)


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
