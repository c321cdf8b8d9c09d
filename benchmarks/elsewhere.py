"""The diagnosis on systems that are no milling cells: `python -m benchmarks.elsewhere [--seed 1] [--count 2] [--out FILE.json]`.

The examples `servo_axis` and `heated_rod` bring a model, a catalogue, a mapping, and another formulation that plays the machine: each case
goes the way of a user, from the logs to the answer. Beside them are the cells of papers 001, 003 and 004 (`benchmarks.cells`). Cases are
drawn by the seed: nulls, singles, doubles, singles of which the catalogue knows nothing (withheld), and singles that were recorded once.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from benchmarks.cells import CELLS, Cell
from robomill.cell.binding import convert, resolve
from robomill.cell.equipment import load_system
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.engine import diagnose
from robomill.files import FILES
from robomill.logs.importing import import_log
from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System

KINDS = ("null", "single", "double", "withheld", "once")
NAMED = 0.8
"""Probability from which an effect counts as named."""
REPEATS = 3
SPREAD = 0.4
"""Standard deviation of the logarithm of a size about the usual one."""


@dataclass(frozen=True)
class Example:
    """A folder of `examples/` with machine.py, map.toml, map_CONDITION.toml, system.toml and catalogue.toml."""

    name: str
    diagnosed: str
    """Condition that is diagnosed; the other one is held out."""
    held_out: str
    parameters: Mapping[str, str] = field(default_factory=dict)
    """Effect of machine.py -> `component.parameter` of the catalogue, where that is not the only one with its name."""
    same: Mapping[str, str] = field(default_factory=dict)
    """`component.parameter` -> another one that does the same."""

    @property
    def folder(self) -> Path:
        """Where it is."""
        return FILES / "examples" / self.name

    def catalogue(self) -> Catalogue:
        """What may be wrong with it."""
        return Catalogue.load(self.folder / "catalogue.toml")

    def system(self) -> System:
        """The nominal one."""
        return load_system(self.folder / "system.toml")

    @property
    def usual(self) -> Mapping[str, float]:
        """Effect of machine.py -> size that is usual [SI]; a negative one may have either sign."""
        usual: Mapping[str, float] = self.machine().USUAL
        return usual

    def runs(self, effects: Mapping[str, float], seed: int, repeats: int, folder: Path) -> tuple[list[Run], list[Run]]:
        """Diagnosed and held-out runs of a machine with these effects, imported from its logs."""
        machine, found = self.machine(), ([], [])
        for condition, into in zip((self.diagnosed, self.held_out), found, strict=True):
            mapping = self.folder / ("map.toml" if condition == self.diagnosed else f"map_{condition}.toml")
            for repeat in range(1, repeats + 1):
                log, run = folder / f"{condition}-{repeat}.csv", folder / f"{condition}-{repeat}"
                machine.write(log, machine.measure(effects, seed, condition, repeat))
                import_log(mapping, log, run, overwrite=True, labels={"repeat": repeat})
                into.append(Run.load(run))
        return found

    def machine(self) -> ModuleType:
        """Its machine.py."""
        spec = importlib.util.spec_from_file_location(f"{self.name}_machine", self.folder / "machine.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    def parameter(self, effect: str) -> str:
        """`component.parameter` of an effect of machine.py."""
        if effect in self.parameters:
            return self.parameters[effect]
        (found,) = {f"{c.component}.{c.named[0]}" for c in self.catalogue().candidates if c.named[0] == effect}
        return found


EXAMPLES = (
    Example("servo_axis", "work", "heavy", {"lag": "logging.lag encoder.*"}),
    Example(
        "heated_rod",
        "bake",
        "anneal",
        {
            "lag": "logging.lag thermocouples.shown[3]",
            "control_gain_error": "controller.gain_error",
            **{e: f"thermocouples.{e}[3]" for e in ("slower", "gain_error", "offset", "drift")},
        },
    ),
)
SUBJECTS: tuple[Example | Cell, ...] = (*EXAMPLES, *CELLS)
"""All systems that there are cases of."""


@dataclass(frozen=True)
class Result:
    """One case: what was wrong, what was said, and what that is worth."""

    system: str
    kind: str
    seed: int
    truth: dict[str, float]
    """`component.parameter` -> value [SI]."""
    verdict: str
    named: dict[str, list[float]]
    """`component.parameter` with a probability of NAMED and more -> value, lower and upper end of its interval."""
    score: str
    covered: dict[str, bool]
    """Whether the interval of a true effect that was named holds its value."""
    closure: float | None
    """Least closure of a figure in the condition that was held out."""
    seconds: float


def drawn(subject: Example | Cell, kind: str, seed: int) -> dict[str, float]:
    """Effects of a case: sizes are log-normal about the usual ones; the sign is free where the usual one is negative."""
    rng, usual = np.random.default_rng([seed, KINDS.index(kind), len(subject.name)]), subject.usual
    count = {"null": 0, "double": 2}.get(kind, 1)
    names = rng.choice(sorted(usual), count, replace=False)
    sign = {n: rng.choice([-1.0, 1.0]) if usual[n] < 0.0 else 1.0 for n in names}
    return {str(n): float(sign[n] * abs(usual[n]) * np.exp(SPREAD * rng.normal())) for n in names}


def diagnosed(subject: Example | Cell, kind: str, seed: int, folder: Path) -> Result:
    """One case, from the logs to its score."""
    began = time.process_time()
    effects = drawn(subject, kind, seed)
    catalogue = subject.catalogue()
    truth = {subject.parameter(e): value for e, value in effects.items()}
    if kind == "withheld":
        kept = tuple(c for c in catalogue.candidates if f"{c.component}.{c.named[0]}" not in truth)
        catalogue = replace(catalogue, candidates=kept)
    runs, held_out = subject.runs(effects, seed, 1 if kind == "once" else REPEATS, folder)
    answer = diagnose(subject.system(), runs, catalogue, held_out=held_out, resolver=resolve, convert=convert).answer
    named = {
        f"{w.component}.{next(iter(w.parameters))}": [(p := next(iter(w.parameters.values()))).value, *p.interval]
        for w in answer.which
        if w.probability >= NAMED
    }
    listed = {f"{w.component}.{next(iter(w.parameters))}" for w in answer.which}
    closures = [h.closure for h in answer.how_far if h.on == "held-out condition" and h.unit != "1" and h.closure is not None]
    return Result(
        subject.name,
        kind,
        seed,
        truth,
        answer.verdict,
        named,
        score(kind, answer.verdict, set(truth), set(named), listed, {e for t in truth if (e := subject.same.get(t))}),
        {p: named[p][1] <= value <= named[p][2] for p, value in truth.items() if p in named},
        min(closures, default=None),
        round(time.process_time() - began, 1),
    )


def score(kind: str, verdict: str, truth: set[str], named: set[str], listed: set[str], same: Collection[str] = ()) -> str:
    """`right`, `wrong` (a name that is none, or a missing one that was claimed), `extra`, `part`, `set`, or the verdict.

    A late clock is right as `bad_log`, which names it. What does the `same` as a withheld effect is a right name for it.
    """
    if verdict == "bad_log":
        return "right" if any(p.startswith("logging.") for p in truth) and kind != "withheld" else "wrong"
    if verdict == "none":
        return "right" if kind == "null" else "none"
    if verdict == "unknown":
        return "right" if kind == "withheld" else "unknown"
    if kind == "withheld" and named and named <= set(same):
        return "right"
    if kind in ("null", "withheld"):
        return "wrong" if named else "set"
    if verdict == "ambiguous" and truth <= listed and not named - truth:
        return "set"
    if named == truth:
        return "right"
    if named > truth:
        return "extra"
    return "part" if named and named < truth else "wrong"


def cases(kinds: Sequence[str], count: int, seed: int, systems: Sequence[str]) -> Iterator[tuple[Example | Cell, str, int]]:
    """`count` cases of each kind and system."""
    for subject in SUBJECTS:
        if subject.name in systems:
            for kind in kinds:
                for i in range(count):
                    yield subject, kind, 1000 * seed + i


def table(results: Sequence[Result]) -> str:
    """How often each score came, by system and kind; intervals that hold; median closure in new conditions."""
    rows = ["| system | kind | scores | intervals that hold | median closure |", "|---|---|---|---|---|"]
    for system, kind in dict.fromkeys((r.system, r.kind) for r in results):
        those = [r for r in results if (r.system, r.kind) == (system, kind)]
        scores = ", ".join(f"{n} {s}" for s, n in Counter(r.score for r in those).most_common())
        covered = [c for r in those for c in r.covered.values()]
        closures = [r.closure for r in those if r.closure is not None]
        closure = f"{100 * np.median(closures):.0f} %" if closures else "-"
        rows.append(f"| {system} | {kind} | {scores} | {sum(covered)} of {len(covered)} | {closure} |")
    return "\n".join(rows)


def said(result: Result) -> str:
    """A case in a line."""
    values: Mapping[str, Any] = {p: f"{v[0]:.3g} [{v[1]:.3g} .. {v[2]:.3g}]" for p, v in result.named.items()}
    truth = {p: f"{v:.3g}" for p, v in result.truth.items()}
    closure = "" if result.closure is None else f", closure {100 * result.closure:.0f} %"
    head = f"{result.system} {result.kind} {result.seed}: {result.score}: {result.verdict}"
    return f"{head} {dict(values)}; truth {truth}{closure}, {result.seconds} s"


def main(arguments: Sequence[str] | None = None) -> int:
    """Diagnose the cases, print each and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=2, help="cases of each kind and system")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--systems", nargs="+", choices=[s.name for s in SUBJECTS], default=[s.name for s in SUBJECTS])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for case in cases(options.kinds, options.count, options.seed, options.systems):
            results.append(diagnosed(*case, Path(folder)))
            print(said(results[-1]), file=sys.stderr, flush=True)
            if options.out is not None:
                options.out.write_text(json.dumps([asdict(r) for r in results], indent=1) + "\n", encoding="utf-8")
    print(table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
