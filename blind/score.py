"""Score a folder of predictions against its sealed truth."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from robomill.blind.baselines import baseline_guesses
from robomill.blind.case import CASE_KINDS, Cases, load_cases
from robomill.blind.figures import baseline_figures, figures
from robomill.blind.oracle import (
    oracle_confusable,
    oracle_equivalents,
    oracle_form_gaps,
    oracle_gaps,
    oracle_same,
    oracle_separates,
    prepare,
)
from robomill.blind.results import ALL, Score
from robomill.blind.sealing import freeze_predictions, unseal
from robomill.blind.set_figures import claims
from robomill.blind.tables import by_component, confusion, per_effect, strata
from robomill.blind.workers import Progress
from robomill.files import FILES

WITH_BASELINES = ("single", "mixed")
"""Sets on which the baselines of DIAGNOSIS.md are run: they name one effect or none."""


def score(
    folder: str | Path,
    *,
    isolability: bool = True,
    baselines: bool = True,
    workers: int | None = 1,
    progress: Progress | None = None,
) -> Score:
    """Freeze the predictions, unseal, score.

    `isolability` and `baselines` need signatures: about 5 s for each way to measure, once, on `workers` processes (None: one per core).

    Without `isolability` a withheld effect has no equivalents. BenchmarkError where the folder is not as it was made.
    """
    folder = Path(folder)
    frozen, first = freeze_predictions(folder)
    head, truths = unseal(folder)
    tier = head.tier
    loaded = load_cases(folder, truths)
    if isolability:
        prepare(folder, loaded, workers, progress)
    cases = Cases(loaded, oracle_confusable(folder, truths, tier) if isolability else None)
    equivalents = oracle_equivalents(folder, truths, tier) if isolability else lambda _: ()
    same = oracle_same(folder, truths, tier) if isolability else lambda _: False
    gaps, separates, forms = oracle_gaps(folder), oracle_separates(truths, tier), oracle_form_gaps(folder)
    makers = sorted({c.truth.generator for c in cases.all})
    parts = {ALL: cases, **{name: cases.of_generator(name) for name in makers}}
    guesses = baseline_guesses(folder, cases.all, tier, progress) if baselines and head.set in WITH_BASELINES else {}
    return Score(
        schema="robomill-blind-score/2",
        set=head.set,
        tier=tier,
        generator=head.generator,
        cases=len(cases.all),
        seed=head.seed,
        version=head.version,
        date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        commit=commit(),
        predictions=len(frozen),
        predictions_as_first_unsealed=first,
        kinds={k: len(cases.of(k)) for k in CASE_KINDS},
        isolability=isolability,
        scores={name: figures(part, tier, gaps, separates, equivalents, forms, same) for name, part in parts.items()},
        strata=strata(cases),
        per_effect=per_effect(cases),
        confusion=confusion(cases),
        components=by_component(confusion(cases)),
        claims=claims(cases, equivalents, same),
        wall=_mean([c.prediction.wall for c in cases.all]),
        cpu=_mean([c.prediction.cpu for c in cases.all]),
        baselines={name: baseline_figures(cases, by_case) for name, by_case in guesses.items()},
    )


def _mean(times: Sequence[float | None]) -> float | None:
    """Mean of those that are known."""
    known = [t for t in times if t is not None]
    return float(np.mean(known)) if known else None


def commit() -> str:
    """The version of this code: the commit of its repository, with `+` where files differ from it; empty without one."""
    if not (FILES / ".git").exists():  # installed: the repository around it, if there is one, is another project's
        return ""
    head, changes = ["rev-parse", "--short", "HEAD"], ["status", "--porcelain", "--untracked-files=no"]
    try:
        text = [subprocess.run(["git", *a], cwd=FILES, capture_output=True, text=True, check=True).stdout.strip() for a in (head, changes)]
    except (OSError, subprocess.CalledProcessError):
        return ""
    return text[0] + ("+" if text[1] else "")
