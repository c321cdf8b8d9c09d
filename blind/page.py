"""The page of results: all sets of the benchmark in one table, each set by itself, and what was taken for what."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

from robomill.blind.acceptance import ASKED, MARGIN, bound, met
from robomill.blind.figures import calibration
from robomill.blind.results import ALL, EffectCounts, Score
from robomill.blind.sealing import BenchmarkError
from robomill.blind.sets import GENERATORS, SETS
from robomill.blind.statistics import Figure

Reasons = Mapping[tuple[str, str, str], str]
"""(set, tier, figure) -> why its bound is missed, and what was tried."""
EVERY_SET = "all sets"
"""What stands in place of a set where all of them count."""
_MAKERS = GENERATORS[:2]
_REASON = {"set", "tier", "figure", "reason", "tried"}


def read_reasons(file: Path) -> Reasons:
    """reasons.toml: `[[missed]]` with set, tier, figure, reason, tried; empty without the file. BenchmarkError where it is wrong."""
    if not file.is_file():
        return {}
    try:
        listed = tomllib.loads(file.read_text(encoding="utf-8")).get("missed", [])
    except tomllib.TOMLDecodeError as error:
        raise BenchmarkError(f"{file}: not valid TOML: {error}; correct that line") from None
    found = {}
    for i, entry in enumerate(listed, 1):
        if set(entry) != _REASON:
            raise BenchmarkError(f"{file}: entry {i} has the keys {', '.join(sorted(entry))}; expected {', '.join(sorted(_REASON))}")
        found[entry["set"], entry["tier"], entry["figure"]] = f"{entry['reason']} Tried: {entry['tried']}"
    return found


def page(contents: Sequence[Mapping[str, Any]], command: str, reasons: Reasons | None = None) -> str:
    """Markdown of some score.json, with the command that wrote it. BenchmarkError for one of another version, or of no known set."""
    try:
        scores = [Score.read(content) for content in contents]
    except (KeyError, TypeError, AttributeError) as error:
        raise BenchmarkError(
            f"score.json has other keys than this version writes: {error}; score it again: robomill blind score"
        ) from error
    if unknown := sorted({s.set for s in scores} - set(SETS)):
        raise BenchmarkError(f"score.json of the set {', '.join(unknown)}: expected one of {', '.join(SETS)}")
    scores.sort(key=lambda s: (list(SETS).index(s.set), -int(s.tier[1:])))
    rows = [*(r for s in scores for r in _asked(s)), *_together(scores)]
    judged = [r[-1] for r in rows if r[-1]]
    lines = [
        "# The blind benchmark: results",
        "",
        f"Written by `{command}`. What the sets and figures are: [blind.md](../maintainers/blind.md).",
        "Intervals are 95 %. A figure without cases is neither within its bound nor outside.",
        "",
        *_table(["figure", "set", "tier", "value", "95 %", "cases", *(f"{m} generator" for m in _MAKERS), "bound", "met"], rows),
        "",
        f"Within the bounds: {judged.count('yes')} of {len(judged)} figures that have cases.",
        *_missed(rows, reasons or {}),
        *_rate(scores),
    ]
    for s in scores:
        lines += _set(s)
    return "\n".join([*lines, *_confusion(scores)]) + "\n"


def _asked(s: Score) -> list[list[str]]:
    """The figures of a set that have a bound."""
    makers = [s.scores.get(m, {}) for m in _MAKERS]
    return [_line(key, s.set, s.tier, s.scores[ALL].get(key), [m.get(key) for m in makers]) for key in ASKED[s.set]]


def _together(scores: Sequence[Score]) -> list[list[str]]:
    """The calibration over all sets of a tier."""
    rows = []
    for tier in dict.fromkeys(s.tier for s in scores):
        claims = [c for s in scores if s.tier == tier for c in s.claims]
        makers = [calibration([c for c in claims if c.generator == m]) for m in _MAKERS]
        rows.append(_line("ece", EVERY_SET, tier, calibration(claims), makers))
    return rows


def _line(key: str, name: str, tier: str, figure: Figure | None, makers: Sequence[Figure | None]) -> list[str]:
    verdict = {None: "", True: "yes", False: "**no**"}[met(key, None if figure is None else figure.value, tier)]
    counted = ["" if m is None or m.value is None else f"{_value(m)} ({m.count})" for m in makers]
    count = str(figure.count) if figure else "0"
    return [key, name, tier, _value(figure), _interval(figure), count, *counted, str(bound(key, tier)), verdict]


def _missed(rows: Sequence[Sequence[str]], reasons: Reasons) -> list[str]:
    missed = [(r[1], r[2], r[0], r[3], r[-2]) for r in rows if r[-1] == "**no**"]
    lines = ["", "## Bounds that are missed", ""]
    for name, tier, key, value, asked in missed:
        why = reasons.get((name, tier, key), "No reason is given in reasons.toml.")
        lines.append(f"- **{key}** ({name}, {tier}): {value}, {asked} is asked for. {why}")
    return lines if missed else ["", "No bound is missed."]


def _rate(scores: Sequence[Score]) -> list[str]:
    """How fast the diagnoses were."""
    rows = [[s.set, s.tier, f"{s.wall:.1f}", f"{s.cpu:.1f}", f"{7200.0 / s.wall:.0f}"] for s in scores if s.wall and s.cpu]
    heads = ["set", "tier", "mean time of a diagnosis in one process [s]", "CPU time [s]", "cases an hour in two processes"]
    return ["", "## How long it takes", "", *_table(heads, rows)] if rows else []


def _set(s: Score) -> list[str]:
    """One set: what it was, all figures that have cases, and how they depend on the strength."""
    kinds = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in s.kinds.items() if n)
    seal = "as they were when the truth was first opened" if s.predictions_as_first_unsealed else "**changed after the truth was opened**"
    lines = [
        "",
        f"## {s.set}, tier {s.tier}",
        "",
        f"{s.cases} cases ({kinds}), generator {s.generator}, seed {s.seed}, version {s.version}; {s.predictions} predictions, {seal}. "
        f"Scored {s.date}, commit {s.commit or 'unknown'}.",
    ]
    if not s.isolability:
        lines += ["", "Isolability was not looked at: every detectable effect counts as isolable, and no withheld one has equivalents."]
    names = [ALL, *(m for m in _MAKERS if m in s.scores)]
    rows = [[key, *(c for m in names for c in _cells(s.scores[m][key]))] for key, f in s.scores[ALL].items() if f.count]
    lines += ["", *_table(["figure", *(h for m in names for h in (m, "95 %", "cases"))], rows), *_baselines(s)]
    if any(f.count for stratum in s.strata.values() for f in stratum.values()):
        rows = [[name, *(f"{_value(f)} ({f.count})" for f in stratum.values())] for name, stratum in s.strata.items()]
        lines += ["", *_table(["oracle ratio", *next(iter(s.strata.values()))], rows)]
    if s.per_effect:
        rows = [[key, *map(str, astuple(counts))] for key, counts in s.per_effect.items()]
        lines += ["", *_table(["effect", *(f.name.replace("_", " ") for f in fields(EffectCounts))], rows)]
    return lines


def _baselines(s: Score) -> list[str]:
    """The methods to compare with, and by how many points the best of them is beaten."""
    if not s.baselines:
        return []
    keys = list(dict.fromkeys(key for figures in s.baselines.values() for key in figures))
    rows = [[key, _value(s.scores[ALL].get(key)), *(_value(b.get(key)) for b in s.baselines.values())] for key in keys]
    found = []
    for key in ("right_answer", "component_top1", "location_top1", "effect_top1"):
        others = [f.value for b in s.baselines.values() if (f := b.get(key)) and f.value is not None]
        own = s.scores[ALL].get(key)
        if others and own and own.value is not None:
            found.append(f"{key} {100.0 * (own.value - max(others)):+.0f}")
    points = f"Points above the best of the baselines ({MARGIN} are asked for): {', '.join(found) or 'none to compare'}."
    return ["", *_table(["figure", "diagnosis", *s.baselines], rows), "", points]


def _confusion(scores: Sequence[Score]) -> list[str]:
    """What was said for what is true, over all sets of a tier: by component as a matrix, by effect as lists."""
    lines = []
    for tier in dict.fromkeys(s.tier for s in scores):
        of = [s for s in scores if s.tier == tier]
        matrix, effects = _sum(s.components for s in of), _sum(s.confusion for s in of)
        said = sorted({name for row in matrix.values() for name in row})
        lines += ["", f"## What was said for what is true ({tier})", ""]
        lines += ["All sets, detectable or not; doubles and triples are left out. Each effect of a machine counts by itself.", ""]
        lines += _table(["true component", *said], [[true, *(str(row.get(name, "")) for name in said)] for true, row in matrix.items()])
        rows = [[true, ", ".join(f"{name} {n}" for name, n in row.items())] for true, row in effects.items()]
        lines += ["", *_table(["true effect", "said first, cases"], rows)]
    return lines


def _sum(tables: Iterable[Mapping[str, Mapping[str, int]]]) -> dict[str, dict[str, int]]:
    total: dict[str, dict[str, int]] = {}
    for table in tables:
        for true, row in table.items():
            into = total.setdefault(true, {})
            for said, n in row.items():
                into[said] = into.get(said, 0) + n
    return {true: dict(sorted(row.items(), key=lambda item: -item[1])) for true, row in sorted(total.items())}


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (heads, ["---"] * len(heads), *rows)]


def _value(figure: Figure | None) -> str:
    return "" if figure is None or figure.value is None else f"{figure.value:.3g}"


def _interval(figure: Figure | None) -> str:
    return "" if figure is None or not figure.interval else f"{figure.interval[0]:.3g} .. {figure.interval[1]:.3g}"


def _cells(figure: Figure) -> tuple[str, str, str]:
    return _value(figure), _interval(figure), str(figure.count)
