"""The outcome on a recording as text."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.recordings.cases import Case
from benchmarks.recordings.earlier import Earlier
from benchmarks.recordings.measure import Closure, Outcome, Value

NAMED = 0.5
"""Probability from which an effect counts as named: it is likelier there than not."""


def number(value: float | None, interval: tuple[float, float] | None = None) -> str:
    """Four digits and the interval, or a dash."""
    if value is None:
        return "-"
    return f"{value:.4g}" + (f" ({interval[0]:.4g} to {interval[1]:.4g})" if interval else "")


def values(outcome: Outcome, first: Earlier | None = None) -> list[str]:
    """Rows of a Markdown table of all effects; beside them what the `first` edition said, if it did."""
    heads = ["effect", "", "p", "answer (90 %)", "least squares (90 %)", *(["first edition (90 %)"] if first else []), "unit"]
    rows = [row(heads), row(["---"] * len(heads))]
    for v in outcome.values:
        p = f"{v.probability:.2f}" if v.value is not None else "-"
        cells = [v.effect, v.status, p, number(v.value, v.interval), number(v.by_least_squares, v.its_interval)]
        if first is not None:
            said = first.effects.get(v.effect)
            cells.append(number(said[0], (said[1], said[2])) if said else "-")
        rows.append(row([*cells, v.unit]))
    return rows


def closed(outcome: Outcome, first: Earlier | None = None) -> list[str]:
    """Rows of a Markdown table of the channels of the held-out runs; beside them what the `first` edition left, if it is known."""
    heads = ["channel", "rms before", "after", "unit", "closure", "least squares", *(["first edition"] if first else [])]
    rows = [row(heads), row(["---"] * len(heads))]
    for c in outcome.closures:
        cells = [c.channel, f"{c.before:.3g}", f"{c.after:.3g}", c.unit, share(c.closure), share(c.by_least_squares)]
        rows.append(row([*cells, *([share(by_first(c, first))] if first else [])]))
    return rows


def by_first(c: Closure, first: Earlier) -> float | None:
    """Closure of a channel by the first edition: 1 - the square of what it left over that of the gap; None where it is not known."""
    after = first.after.get(c.channel)
    return None if after is None else 1.0 - (after / c.before) ** 2


def share(closure: float | None) -> str:
    """`93.4 %`, or a dash."""
    return "-" if closure is None else f"{100 * closure:.1f} %"


def row(cells: Sequence[str]) -> str:
    """A row of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def named(outcome: Outcome, status: str) -> list[Value]:
    """Numbers of effects of this status that the answer names."""
    return [v for v in outcome.values if v.status == status and v.value is not None and v.probability >= NAMED]


def inside(outcome: Outcome) -> tuple[int, int]:
    """How many expected values by least squares lie in the interval of the answer, and how many there are."""
    rows = [v for v in named(outcome, "expected") if v.by_least_squares is not None and v.interval is not None]
    return sum(v.interval[0] <= v.by_least_squares <= v.interval[1] for v in rows if v.interval and v.by_least_squares is not None), len(
        rows
    )


def of(case: Case, outcome: Outcome) -> str:
    """All figures of one recording."""
    tests = ", ".join(f"{k} {v:.3g}" for k, v in outcome.tests.items() if isinstance(v, float))
    lines = [f"## {case.name}: {outcome.verdict}{' (noise guessed)' if outcome.guessed else ''}", f"known: {case.known}"]
    lines += [outcome.error] if outcome.error else []
    lines += [f"log: {text}" for text in outcome.findings]
    if outcome.left_one_out:
        before, after, predicted = outcome.left_one_out
        lines.append(
            f"least squares, all runs: rms {before:.3g}, fitted {after:.3g}, each sample predicted from the others {predicted:.3g}"
        )
    lines += [f"{outcome.cpu:.1f} s of CPU, {outcome.simulations} simulations, {outcome.samples} samples; {tests}", ""]
    return "\n".join([*lines, *values(outcome), "", *closed(outcome), ""])


def summary(outcomes: Sequence[Outcome]) -> str:
    """One row for each recording."""
    names = ("recording", "verdict", "expected named", "not known", "wrong", "values inside", "closure: least, mean", "least squares")
    rows = [f"| {' | '.join((*names, 'CPU s', 'simulations'))} |", "|---|---|---|---|---|---|---|---|---|---|"]
    for o in outcomes:
        expected = {v.effect for v in o.values if v.status == "expected"}
        hit, more, wrong = ({v.effect for v in named(o, s)} for s in ("expected", "more", "absent"))
        both = [[c.closure for c in o.closures], [c.by_least_squares for c in o.closures]]
        least, yard = (f"{100 * min(x):.1f} %, {100 * sum(x) / len(x):.1f} %" if x else "-" for x in both)
        right, of_all = inside(o)
        counts = f"{len(hit)} of {len(expected)} | {len(more)} | {len(wrong)} | {right} of {of_all}"
        rows.append(f"| {o.name} | {o.verdict} | {counts} | {least} | {yard} | {o.cpu:.1f} | {o.simulations} |")
    total = f"{sum(o.cpu for o in outcomes):.1f}"
    return "\n".join([*rows, f"{total} s of CPU in the diagnoses."])
