"""A page of docs/recordings from the outcome on a recording; no sentence that other data would not change."""

from __future__ import annotations

from pathlib import Path

from benchmarks.recordings import table
from benchmarks.recordings.cases import PREPARED, Case
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


def text(case: Case, outcome: Outcome) -> str:
    """The page."""
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
        "",
        *([f"**Error**: {outcome.error}", ""] if outcome.error else []),
        *[f"- log: {text}" for text in outcome.findings],
        "```",
        *commands(case),
        "```",
        "",
        "## Which",
        "",
        *table.values(outcome),
        "",
        "expected: known to be there; absent: known not to be there; more: nothing is known of it. Least squares: all expected effects "
        "fitted together to the diagnosed runs, intervals by a bootstrap over blocks of time.",
        f"{right} of {count} values by least squares lie in the intervals of the answer.",
        f"Expected and not named: {', '.join(missing) or 'none'}.",
        "",
        f"## How far: held-out runs, {scope}{moving}",
        "",
        *table.closed(outcome),
        "",
        "closure: 1 - squares after / squares before, no noise taken off.",
        "Least squares: with the expected effects, fitted to the diagnosed runs.",
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
