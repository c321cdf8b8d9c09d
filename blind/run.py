"""Give every case to a diagnosis that comes in from outside, on several processes, and go on where it was left."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import traceback
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from blind.score import BenchmarkError

Diagnose = Callable[[Path, Path], Any]
"""(folder of the case, folder for the result) -> anything; writes diagnosis.json there. Must be importable: it goes to other processes."""
Progress = Callable[[str, int, int], object]


def run_cases(folder: str | Path, diagnose: Diagnose, workers: int = 2, progress: Progress | None = None) -> dict[str, Any]:
    """Diagnose every case that has no prediction yet; returns how many were done, were there before, and failed (with their errors).

    A diagnosis is told the folder of the case only, never the sealed one. A case whose diagnosis raises gets an
    `error.txt` instead of a prediction and is tried again next time. BenchmarkError if there is no benchmark.
    """
    folder = Path(folder)
    if not (folder / "benchmark.json").is_file():
        raise BenchmarkError(
            f"{folder} holds no finished benchmark (no benchmark.json); make one with: robomill blind make {folder} --cases N"
        )
    if (folder / "predictions.json").is_file():
        raise BenchmarkError(
            f"{folder} has been unsealed (predictions.json); predictions can no longer be added. "
            "Make a fresh benchmark, or remove predictions.json and say so in the report"
        )
    cases = sorted(p for p in (folder / "cases").iterdir() if p.is_dir())
    to_do = [c for c in cases if not _complete(folder / "predictions" / c.name / "diagnosis.json")]
    failed: dict[str, str] = {}
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes take it over: one core each
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        futures = {pool.submit(_diagnose, diagnose, c, folder / "predictions" / c.name): c.name for c in to_do}
        for done, future in enumerate(as_completed(futures), 1):
            error = future.result()
            if error:
                failed[futures[future]] = error
            if progress is not None:
                progress("diagnose", done, len(to_do))
    return {"cases": len(cases), "done": len(to_do) - len(failed), "before": len(cases) - len(to_do), "failed": failed}


def _complete(file: Path) -> bool:
    try:
        return "verdict" in json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False


def _diagnose(diagnose: Diagnose, case: Path, result: Path) -> str:
    """In a worker: the last line of the error, or nothing. The result appears in one move when it is complete."""
    part = result.with_name(f".{result.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        diagnose(case, part)
    except Exception as error:
        (part / "error.txt").write_text(traceback.format_exc(), encoding="utf-8")
        text = f"{type(error).__name__}: {error}"
    else:
        text = "" if _complete(part / "diagnosis.json") else "the diagnosis wrote no diagnosis.json with a verdict"
    shutil.rmtree(result, ignore_errors=True)
    part.rename(result)
    return text
