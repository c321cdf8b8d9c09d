"""Ask the generator's world about a sealed case: what its data cannot tell apart, what a claim closes, whether a run would decide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robomill.blind.case import DETECTABLE, Confusable
from robomill.blind.figures import Separates, SquaredGaps
from robomill.blind.generate import difference
from robomill.blind.next_run import separates
from robomill.blind.prediction import ComponentValues
from robomill.blind.signatures import clocks, confusable, features, library
from robomill.blind.truth import Truth
from robomill.blind.world import nominal, simulate_adopted, simulate_nominal
from robomill.models.model.declaration import FloatArray
from robomill.orchestration.errors import OrchestrationError

Truths = Mapping[int, Truth]
"""By number of the case."""
COLUMNS = {"T1": slice(0, 3), "T0": slice(3, 6)}
"""Tier -> columns of a sealed gap that count."""


def oracle_confusable(folder: Path, truths: Truths, tier: str) -> Confusable:
    """What cannot be told from an effect, from signatures (kept in the folder `oracle`)."""

    def found(number: int, i: int) -> list[str]:
        truth = truths[number]
        condition, true = truth.conditions[0], truth.effects[i].instance
        lib = library(condition, folder / "oracle").for_tier(tier)
        rows, reference = lib.matrix.shape[1] // len(lib.columns), nominal(condition)
        change = features(simulate_nominal(condition, [true]).columns, reference.columns, lib.columns, rows)
        return confusable(lib, true, change, DETECTABLE) + clocks(lib, reference, change, DETECTABLE)

    return found


def oracle_gaps(folder: Path, truths: Truths, tier: str) -> SquaredGaps:
    """Gaps by running the nominal cell with the claimed parameters against the sealed noise-free gap. Unchanged where it cannot run."""
    columns = COLUMNS[tier]

    def found(number: int, adopted: ComponentValues) -> dict[str, tuple[float, float]]:
        result = {}
        for c in truths[number].conditions[1:]:
            before = sealed_gap(folder, number, c.name)[:, columns]
            try:
                step = difference(simulate_adopted(c, adopted).columns, nominal(c).columns)[:, columns]
            except OrchestrationError:
                step = np.zeros_like(before)
            n = min(len(before), len(step))
            result[c.name] = float(np.sum(before[:n] ** 2)), float(np.sum((before[:n] - step[:n]) ** 2))
        return result

    return found


def sealed_gap(folder: Path, number: int, condition: str) -> FloatArray:
    """Noise-free gap of a held-out condition as sealed, (n, 6): tool tip [m], force [N]."""
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
