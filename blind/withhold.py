"""Diagnose again with the true effect taken out of the catalogue: does anything else pass for it?

Every effect of the catalogue becomes one that is in no catalogue, and is looked at only where the data tell it from all others
(detectable and isolable singles). The right answer is `unknown`. This needs the truth, so it is for a benchmark that has been scored.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from robomill.blind.case import Cases, load_cases
from robomill.blind.oracle import oracle_confusable
from robomill.blind.prediction import Prediction
from robomill.blind.results import Figures, Withheld, WithheldCase
from robomill.blind.run import complete, diagnose_one
from robomill.blind.sealing import BenchmarkError, unseal
from robomill.blind.statistics import proportion
from robomill.blind.workers import Progress, work

DiagnoseWithout = Callable[..., Any]
"""(folder of the case, folder for the result, without=`component.parameter`) -> anything; writes diagnosis.json. Must be importable."""


def withhold(folder: str | Path, diagnose: DiagnoseWithout, workers: int | None = None, progress: Progress | None = None) -> Withheld:
    """Diagnose the detectable, isolable singles without their effect, those that are not done yet; predictions go to `withheld/`.

    BenchmarkError if the benchmark is still sealed.
    """
    folder = Path(folder).resolve()
    if not (folder / "predictions.json").is_file():
        raise BenchmarkError(
            f"{folder} is sealed (no predictions.json): to withhold an effect it must be known; first: robomill blind score {folder}"
        )
    head, truths = unseal(folder)
    chosen = Cases(load_cases(folder, truths), oracle_confusable(folder, truths, head.tier)).singles
    results = [folder / "withheld" / f"{c.number:04d}" for c in chosen]
    jobs = [
        (partial(diagnose, without=c.effects[0].key), folder / "cases" / result.name, result)
        for c, result in zip(chosen, results, strict=True)
        if not complete(result / "diagnosis.json")
    ]
    failed: dict[str, str] = {}
    for done, (i, error) in enumerate(work(diagnose_one, jobs, workers), 1):
        if error:
            failed[jobs[i][2].name] = error
        if progress is not None:
            progress("withhold", done, len(jobs))
    rows = [
        row(result.name, c.effects[0].key, json.loads((result / "diagnosis.json").read_text(encoding="utf-8")))
        for c, result in zip(chosen, results, strict=True)
        if result.name not in failed
    ]
    return Withheld(head.tier, head.seed, shares(rows), rows, failed)


def row(name: str, effect: str, content: Mapping[str, Any]) -> WithheldCase:
    """What a diagnosis.json says of a case."""
    prediction = Prediction.read(content)
    first = prediction.claimed[0] if prediction.claimed else None
    verdict = "bad_log" if prediction.stopped else prediction.verdict
    return WithheldCase(name, effect, verdict, first.names[0].key if first else None, first.probability if first else None)


def shares(rows: Sequence[WithheldCase]) -> Figures:
    """Share of each verdict, with its interval; `identified` is what passes for the effect."""
    return {v: proportion([r.verdict == v for r in rows]) for v in ("unknown", "none", "ambiguous", "identified", "bad_log")}
