"""The page of results: every figure with count, interval, bound and baselines, effect by effect, for any number of benchmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, fields
from typing import Any

from robomill.blind.acceptance import MARGIN, bound, met
from robomill.blind.results import EffectCounts, Score, Withheld
from robomill.blind.sealing import BenchmarkError
from robomill.blind.statistics import Figure


def page(scores: Sequence[Mapping[str, Any]], command: str) -> str:
    """Markdown of some score.json (as a rule one of tier T1 and one of T0), with the command that wrote it.

    Where there is a withheld.json, it is under `withheld` of its score.json.
    """
    lines = [
        "# The blind benchmark: results",
        "",
        f"Written by `{command}`. What the figures mean: [blind.md](../blind.md).",
        "Intervals are 95 %. A figure without cases is neither within its bound nor outside. Baselines get the same runs.",
    ]
    for content in scores:
        try:
            s = Score.read({k: v for k, v in content.items() if k != "withheld"})
            withheld = Withheld.read(content["withheld"]) if "withheld" in content else None
        except TypeError as error:
            raise BenchmarkError(f"score.json or withheld.json has other keys than this version writes: {error}") from error
        lines += ["", *_benchmark(s)]
        if withheld is not None:
            lines += _withheld(withheld, s.tier)
    return "\n".join(lines) + "\n"


def _benchmark(s: Score) -> list[str]:
    kinds = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in s.kinds.items())
    seal = "as they were when the truth was first opened" if s.predictions_as_first_unsealed else "**changed after the truth was opened**"
    lines = [
        f"## Tier {s.tier}",
        "",
        f"{s.cases} cases ({kinds}), seed {s.seed}, generator version {s.version}; {s.predictions} predictions, {seal}. "
        f"Scored {s.date}, commit {s.commit or 'unknown'}.",
    ]
    if not s.isolability:
        lines += ["", "Isolability was not looked at: every detectable effect counts as isolable."]
    judged = {k: met(k, f.value, s.tier) for k, f in s.scores.items()}
    asked = [v for v in judged.values() if v is not None]
    lines += ["", f"Within the bounds: {sum(asked)} of {len(asked)} figures that have cases.", ""]
    names = list(s.baselines)
    rows = []
    for key, figure in s.scores.items():
        limit = bound(key, s.tier)
        verdict = {None: "", True: "yes", False: "**no**"}[judged[key]]
        others = [_value(s.baselines[n].get(key)) for n in names]
        rows.append([key, _value(figure), _interval(figure), figure.count, "" if limit is None else limit, verdict, *others])
    lines += _table(["figure", "value", "95 %", "cases", "bound", "met", *names], rows)
    lines += _margins(s)
    lines += ["", f"### By how far the effects stand out ({s.tier})", ""]
    rows = []
    for name, stratum in s.strata.items():
        rows.append([name, *(f"{_value(f)} ({f.count})" for f in stratum.values())])
    lines += _table(["oracle ratio", *next(iter(s.strata.values()))], rows)
    lines += ["", f"### Single effects ({s.tier})", ""]
    rows = [[key, *astuple(counts)] for key, counts in s.per_effect.items()]
    lines += _table(["effect", *(f.name.replace("_", " ") for f in fields(EffectCounts) if rows)], rows)
    lines += ["", f"### What was said first ({s.tier})", "", "All cases but doubles and triples, detectable or not.", ""]
    rows = [[true, ", ".join(f"{said} {n}" for said, n in row.items())] for true, row in s.confusion.items()]
    return lines + _table(["true", "said, cases"], rows)


def _withheld(w: Withheld, tier: str) -> list[str]:
    """What was said where the true effect was taken out of the catalogue."""
    lines = ["", f"### Without the true effect in the catalogue ({tier})", ""]
    lines.append("Singles that are detectable and isolable, diagnosed again; the right answer is `unknown` (`robomill blind withhold`).")
    rows = [[v, _value(f), _interval(f), f.count] for v, f in w.figures.items()]
    lines += ["", *_table(["verdict", "share", "95 %", "cases"], rows), ""]
    others = [r for r in w.cases if r.verdict != "unknown"]
    named = [[r.effect, r.verdict, r.said or "", "" if r.probability is None else f"{r.probability:.2f}"] for r in others]
    return lines + (_table(["taken out", "verdict", "said first", "probability"], named) if named else ["Each of them came as `unknown`."])


def _margins(s: Score) -> list[str]:
    """By how many points the best of the baselines is beaten, where it gives a figure."""
    found = []
    for key in ("right_answer", "component_top1", "location_top1", "effect_top1"):
        others = [f.value for b in s.baselines.values() if (f := b.get(key)) and f.value is not None]
        own = s.scores.get(key)
        if others and own and own.value is not None:
            found.append(f"{key} {100.0 * (own.value - max(others)):+.0f}")
    return ["", f"Points above the best of the baselines ({MARGIN} are asked for): {', '.join(found)}."] if found else []


def _table(heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    return [_row(heads), _row(["---"] * len(heads)), *(_row(r) for r in rows)]


def _row(cells: Sequence[Any]) -> str:
    return f"| {' | '.join(str(c) for c in cells)} |"


def _value(figure: Figure | None) -> str:
    return "" if figure is None or figure.value is None else f"{figure.value:.3g}"


def _interval(figure: Figure) -> str:
    return "" if not figure.interval else f"{figure.interval[0]:.3g} .. {figure.interval[1]:.3g}"
