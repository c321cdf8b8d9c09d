"""Score a folder of predictions against its sealed truth."""

from __future__ import annotations

import subprocess
from datetime import UTC, datetime
from pathlib import Path

from robomill.blind.baselines import baseline_guesses
from robomill.blind.case import CASE_KINDS, Cases, load_cases
from robomill.blind.figures import baseline_figures, figures
from robomill.blind.oracle import oracle_confusable, oracle_gaps, oracle_separates
from robomill.blind.results import Score
from robomill.blind.sealing import freeze_predictions, unseal
from robomill.blind.tables import confusion, per_effect, strata
from robomill.blind.workers import Progress
from robomill.files import FILES


def score(folder: str | Path, *, isolability: bool = True, baselines: bool = True, progress: Progress | None = None) -> Score:
    """Freeze the predictions, unseal, score. `isolability` and `baselines` need signatures: about 15 s for each of six conditions, once.

    BenchmarkError where the folder is not as it was made.
    """
    folder = Path(folder)
    frozen, first = freeze_predictions(folder)
    head, truths = unseal(folder)
    tier = head.tier
    cases = Cases(load_cases(folder, truths), oracle_confusable(folder, truths, tier) if isolability else None)
    guesses = baseline_guesses(folder, cases.all, tier, progress) if baselines else {}
    return Score(
        schema="robomill-blind-score/1",
        tier=tier,
        cases=len(cases.all),
        seed=head.seed,
        version=head.version,
        date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        commit=commit(),
        predictions=len(frozen),
        predictions_as_first_unsealed=first,
        kinds={k: len(cases.of(k)) for k in CASE_KINDS},
        isolability=isolability,
        scores=figures(cases, tier, oracle_gaps(folder, truths, tier), oracle_separates(truths, tier)),
        strata=strata(cases),
        per_effect=per_effect(cases),
        confusion=confusion(cases),
        baselines={name: baseline_figures(cases, by_case) for name, by_case in guesses.items()},
    )


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
