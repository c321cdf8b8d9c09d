"""Ask the generator's world about a sealed case: what its data cannot tell apart, what a claim closes, whether a run would decide."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from robomill.blind.case import DETECTABLE, Case, Confusable
from robomill.blind.figures import FormGaps, Separates, SquaredGaps
from robomill.blind.generate import QUANTITIES, difference
from robomill.blind.next_run import separates
from robomill.blind.prediction import LOGGING, ComponentValues
from robomill.blind.set_figures import Equivalents, Same
from robomill.blind.signatures import Change, apart, clocks, confusable, features, library, make_library
from robomill.blind.situation import Situation, nominal_run, situations
from robomill.blind.truth import Truth
from robomill.blind.workers import Progress, work
from robomill.models.components.file_names import FORM
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.runs.run import Run

Truths = Mapping[int, Truth]
"""By number of the case."""


def situations_of(folder: Path, number: int, *, held_out: bool) -> list[Situation]:
    """How a case was measured; `held_out`: with its held-out conditions."""
    return [s for s in situations(folder / "cases" / f"{number:04d}") if held_out or not s.held_out]


def prepare(folder: Path, cases: Sequence[Case], workers: int | None = None, progress: Progress | None = None) -> None:
    """Make the signatures that the isolability of the effects of these cases needs, those that are not there yet, on many processes."""
    asked = [c for c in cases if c.kind != "bad_log" and any(e.physical for e in c.truth.effects)]
    wanted = dict.fromkeys(s for c in asked for s in situations_of(folder, c.number, held_out=c.kind == "withheld"))
    for done, _ in enumerate(work(make_library, [(s, folder / "oracle") for s in wanted], workers), 1):
        if progress is not None:
            progress("signatures", done, len(wanted))


def oracle_confusable(folder: Path, truths: Truths, tier: str, *, held_out: bool = False) -> Confusable:
    """What cannot be told from an effect on the diagnosed conditions, and on the held-out ones if asked for.

    From signatures, which are kept in the folder `oracle`.
    """

    def found(number: int, i: int) -> list[str]:
        truth = truths[number]
        if not truth.effects[i].physical:
            return []
        true = truth.effects[i].instance
        component, changes = true.effect.component, []
        for s in situations_of(folder, number, held_out=held_out):
            lib, reference = library(s, folder / "oracle").for_tier(tier), nominal_run(s)
            with_it = s.simulate({**truth.hidden, component: {**truth.hidden.get(component, {}), true.parameter: true.value}}).columns
            rows = lib.matrix.shape[1] // len(lib.columns)
            changes.append(Change(lib, reference, features(with_it, reference.columns, lib.columns, rows)))
        return confusable(changes, true, DETECTABLE) + clocks(changes, DETECTABLE)

    return found


def oracle_gaps(folder: Path) -> SquaredGaps:
    """Gaps by running the nominal cell with the claimed parameters against the sealed noise-free gap. Unchanged where it cannot run."""
    known: dict[int, dict[str, dict[str, tuple[float, float]]]] = {}

    def found(number: int, adopted: ComponentValues) -> dict[str, dict[str, tuple[float, float]]]:
        if number not in known:
            known[number] = _squares(folder, number, lambda s: s.simulate(adopted))
        return known[number]

    return found


def oracle_form_gaps(folder: Path) -> FormGaps:
    """Gaps by running the nominal cell with a form in the loop. Unchanged where it cannot run."""

    def found(number: int, form: Mapping[str, Any]) -> dict[str, dict[str, tuple[float, float]]]:
        with TemporaryDirectory() as place:
            file = Path(place) / f"law{FORM}"
            file.write_text(json.dumps(dict(form)), encoding="utf-8")
            return _squares(folder, number, lambda s: s.simulate({}, (str(form["stands_for"]), str(file))))

    return found


def _squares(folder: Path, number: int, simulate: Callable[[Situation], Run]) -> dict[str, dict[str, tuple[float, float]]]:
    """Squares of the gap in each held-out condition and quantity: against the nominal cell, and against what is simulated."""
    result = {}
    for s in situations_of(folder, number, held_out=True):
        if not s.held_out:
            continue
        before = sealed_gap(folder, number, s.name)
        try:
            step = difference(simulate(s).columns, nominal_run(s).columns)
        except OrchestrationError:
            step = np.zeros_like(before)
        n = min(len(before), len(step))
        squares = np.sum(before[:n] ** 2, axis=0), np.sum((before[:n] - step[:n]) ** 2, axis=0)
        result[s.name] = {q: (float(squares[0][part].sum()), float(squares[1][part].sum())) for q, part in QUANTITIES.items()}
    return result


def oracle_equivalents(folder: Path, truths: Truths, tier: str) -> Equivalents:
    """What no test on the runs of a case, held-out ones too, tells from its first effect; looked up once."""
    alike = oracle_confusable(folder, truths, tier, held_out=True)
    return cache(lambda number: alike(number, 0))


def oracle_same(folder: Path, truths: Truths, tier: str) -> Same:
    """Whether all that a prediction claims does, at its values, what the withheld effect does.

    Then no test on the runs of the case, held-out ones too, tells them apart. A clock does nothing to the cell.
    """

    @cache
    def found(number: int, text: str) -> bool:
        truth = truths[number]
        if len(truth.effects) != 1 or not truth.effects[0].physical:
            return False
        true, claimed = truth.effects[0].instance, json.loads(text)
        component = true.effect.component
        there = {**truth.hidden, component: {**truth.hidden.get(component, {}), true.parameter: true.value}}
        try:
            return all(apart(s, tier, there, claimed) < DETECTABLE for s in situations_of(folder, number, held_out=True))
        except OrchestrationError:  # what is claimed cannot run
            return False

    def same(c: Case) -> bool:
        claimed = c.prediction.claimed_values
        return LOGGING not in claimed and found(c.number, json.dumps(claimed))

    return same


def sealed_gap(folder: Path, number: int, condition: str) -> FloatArray:
    """Noise-free gap of a held-out condition as sealed, (n, 12): see `generate.difference`."""
    values: FloatArray = np.load(folder / "sealed" / f"{number:04d}" / f"{condition.replace(' ', '-')}.npy").astype(np.float64)
    return values


def oracle_separates(truths: Truths, tier: str) -> Separates:
    """Whether recommended runs separate, by making them: with the sealed machine and its true effects, and with what else was said."""

    def found(number: int, recommended: Mapping[str, Any], wrong: Sequence[ComponentValues]) -> bool:
        try:
            return separates(truths[number], recommended, wrong, tier, DETECTABLE)
        except (OrchestrationError, LookupError, ValueError):  # no such run, or one that cannot be made
            return False

    return found
