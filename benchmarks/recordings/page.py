"""A page of docs/recordings from the outcome on a recording; no sentence that other data would not change."""

from __future__ import annotations

from pathlib import Path
from statistics import mean

from benchmarks.recordings import table
from benchmarks.recordings.cases import PREPARED, Case
from benchmarks.recordings.earlier import Earlier, earlier
from benchmarks.recordings.measure import Outcome


def commands(case: Case) -> list[str]:
    """The commands that a user types for the same answer."""
    here = f"scenarios/recordings/{case.folder.name}"
    lines = ["python scenarios/recordings/prepare.py prepared"] if any(e["log"].startswith(PREPARED) for e in case.logs) else []
    for e in case.logs:
        log = e["log"] if e["log"].startswith(PREPARED) else str(e["log"]).removeprefix("../../../")
        labels = "".join(f' --label {k}="{str(v).lower() if isinstance(v, bool) else v}"' for k, v in e.get("labels", {}).items())
        lines.append(f"robomill import {here}/{e['map']} {log} --out {Path('runs') / case.name / e['run']}{labels}")
    paths = [" ".join(f"runs/{case.name}/{r}" for r in part) for part in case.places()]
    return [*lines, f"robomill diagnose {here}/{case.file.name} {paths[0]} --held-out {paths[1]} --out results/{case.name}"]


def alone(case: Case, outcome: Outcome) -> list[str]:
    """A sentence on samples that are predicted from the others, where that was measured."""
    if outcome.left_one_out is None:
        return []
    unit = outcome.closures[0].unit if outcome.closures else ""
    before, after, predicted = outcome.left_one_out
    both = (
        f"{before:.4g} {unit} rms, {after:.4g} {unit} fitted to all of them, {predicted:.4g} {unit} where each is predicted from the others"
    )
    return ["", f"Least squares on all {len(case.logs)} runs: {both}."]


def counted(case: Case, outcome: Outcome, first: Earlier | None) -> list[str]:
    """How many expected effects are named, how far the channels close in the mean: here, by least squares, by the first edition."""
    named = {v.effect for v in table.named(outcome, "expected")}
    means = [mean(c.closure for c in outcome.closures), mean(c.by_least_squares for c in outcome.closures)] if outcome.closures else []
    said = f"{len(named)} of {len(case.expected)} expected effects are named"
    said += (
        f"; the channels of the held-out runs close by {100 * means[0]:.1f} % in the mean (least squares {100 * means[1]:.1f} %)."
        if means
        else "."
    )
    if first is None:
        return ["", said]
    known = [c for c in (table.by_first(c, first) for c in outcome.closures) if c is not None]
    also = sorted(set(first.effects) - set(case.expected))
    closes = f", and closed {100 * mean(known):.1f} % in the mean" if known else ""
    more = f" It named {', '.join(also)} beside them." if also else ""
    right = len(set(first.effects) & set(case.expected))
    return ["", said, f"The first edition ({first.study}; commit {first.commit[:10]}) named {right} of them{closes}.{more}"]


def text(case: Case, outcome: Outcome) -> str:
    """The page."""
    first = earlier(case.name)
    guess = " Nothing was repeated: the noise is a guess." if outcome.guessed else ""
    right, count = table.inside(outcome)
    scope = f"below {case.band:g} Hz" if case.band else "at all frequencies"
    moving = ", standing samples left out" if case.standing else ""
    missing = sorted({v.effect for v in outcome.values if v.status == "expected"} - {v.effect for v in table.named(outcome, "expected")})
    lines = [
        f"# {case.title}",
        "",
        "Written by `make recordings` (benchmarks/recordings); do not edit.",
        "",
        f"**Nominal**: {case.nominal}.",
        "",
        f"**Verdict**: {outcome.verdict}.{guess}",
        "",
        f"**Known beforehand**: {case.known}.",
        *counted(case, outcome, first),
        "",
        *([f"**Error**: {outcome.error}", ""] if outcome.error else []),
        *[f"- log: {text}" for text in outcome.findings],
        "```",
        *commands(case),
        "```",
        "",
        "## Which",
        "",
        *table.values(outcome, first),
        "",
        "expected: known to be there; absent: known not to be there; more: nothing is known of it. Least squares: all expected effects "
        "fitted together to the diagnosed runs, intervals by a bootstrap over blocks of time.",
        f"{right} of {count} values by least squares lie in the intervals of the answer.",
        f"Expected and not named: {', '.join(missing) or 'none'}.",
        "",
        f"## How far: held-out runs, {scope}{moving}",
        "",
        *table.closed(outcome, first),
        "",
        "closure: 1 - squares after / squares before, no noise taken off.",
        "Least squares: with the expected effects, fitted to the diagnosed runs.",
        *(["First edition: 1 - the squares that its page has as left / squares before."] if first else []),
        *alone(case, outcome),
        "",
        f"{outcome.samples} samples diagnosed, {outcome.simulations} simulations, {outcome.cpu:.1f} s of CPU.",
        "",
    ]
    return "\n".join(lines)


def write(case: Case, outcome: Outcome, folder: Path) -> None:
    """The page as `folder/NAME.md`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{case.name}.md").write_text(text(case, outcome), encoding="utf-8")
