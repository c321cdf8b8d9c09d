"""What the diagnosis answers on a recording, what it takes, and how that compares with what is known."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.recordings.cases import Case
from benchmarks.recordings.yardstick import Fitted, View, closures, fit, left_one_out
from robomill.cell.binding import convert, resolve
from robomill.diagnosis.candidates import LOGGING, Address, Candidate
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.outcome.answer import Diagnosis


@dataclass(frozen=True)
class Value:
    """A number of an effect beside the same number by least squares."""

    effect: str
    parameter: str
    unit: str
    probability: float
    """What the answer gives it; 0 where it does not name it."""
    value: float | None
    interval: tuple[float, float] | None
    by_least_squares: float | None
    its_interval: tuple[float, float] | None
    status: str
    """"expected", "absent" (known not to be there) or "more" (of which nothing is known)."""


@dataclass(frozen=True)
class Closure:
    """How far a channel of the held-out runs closes: by the answer, and by least squares with the effects that are expected."""

    channel: str
    unit: str
    before: float
    after: float
    closure: float
    by_least_squares: float


@dataclass
class Outcome:
    """All that was measured on one recording."""

    name: str
    verdict: str
    guessed: bool
    tests: Mapping[str, Any]
    values: list[Value] = field(default_factory=list)
    closures: list[Closure] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)
    cpu: float = 0.0
    """s, of the diagnosis alone."""
    simulations: int = 0
    samples: int = 0
    """That were diagnosed."""
    left_one_out: tuple[float, float, float] | None = None
    """Where samples are independent: rms of the gap by least squares, see `yardstick.left_one_out`."""
    error: str = ""

    def json(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def measured(case: Case, folder: Path, prepared: Path, engine: Callable[..., Diagnosis] = diagnose) -> Outcome:
    """Import, diagnose, compare. What the engine raises is part of the outcome."""
    system, catalogue = case.system(), case.catalogue()
    given, held = case.runs(folder, prepared)
    views, others = ([View(case, r, system) for r in part] for part in (given, held))
    named = [c for c in catalogue.candidates if c.name in case.expected]
    yardstick = fit(views, named)
    began = time.process_time()
    try:
        found = engine(system, given, catalogue, held_out=held, resolver=resolve, convert=convert)
    except Exception as error:  # a crash is a result of the benchmark
        return Outcome(case.name, "crash", False, {}, cpu=time.process_time() - began, error=f"{type(error).__name__}: {error}")
    answer = found.answer
    outcome = Outcome(case.name, answer.verdict, answer.guessed, dict(found.result.get("tests") or {}), cpu=time.process_time() - began)
    outcome.simulations = answer.effort.simulations if answer.effort else 0
    outcome.samples = sum(len(r) for r in given)
    outcome.findings = [f"{f.channel} {f.text}" for f in answer.findings]
    outcome.values = _values(case, catalogue, found.result.get("which", []), yardstick)
    best = {a: v for a, v in found.adopted.items() if a[0] != LOGGING}
    before_after, ceiling = closures(others, best), closures(others, yardstick.values)
    outcome.closures = [
        Closure(name, others[0].run.ports[name].unit or "", b, a, c, ceiling[name][2]) for name, (b, a, c) in before_after.items()
    ]
    outcome.left_one_out = left_one_out([*views, *others], named) if case.independent else None
    return outcome


def _values(case: Case, catalogue: Catalogue, which: list[dict[str, Any]], yardstick: Fitted) -> list[Value]:
    """What the answer names, the likeliest first, and after it what is expected and not named."""
    by_name = {c.name: c for c in catalogue.candidates}
    rows = []
    for w in which:
        candidate = by_name[f"{w['effect']} @ {w['location']}"]
        numbers = w["parameters"]
        for p in candidate.parameters:
            given = numbers.get(p)
            row = (float(given["value"]), (float(given["interval"][0]), float(given["interval"][1]))) if given else (None, None)
            rows.append(_value(case, candidate, (candidate.component, p), float(w["probability"]), row[0], row[1], yardstick))
    said = {r.effect for r in rows}
    for name in (*case.expected, *case.absent):
        if name not in said:
            c = by_name[name]
            rows += [_value(case, c, a, 0.0, None, None, yardstick) for a in c.addresses]
    return rows


def _value(
    case: Case,
    c: Candidate,
    address: Address,
    probability: float,
    value: float | None,
    interval: tuple[float, float] | None,
    by: Fitted,
) -> Value:
    status = "expected" if c.name in case.expected else "absent" if c.name in case.absent else "more"
    return Value(c.name, address[1], c.unit, probability, value, interval, by.values.get(address), by.intervals.get(address), status)
