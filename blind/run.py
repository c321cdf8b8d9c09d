"""Give every case to a diagnosis that comes in from outside, on many processes, and go on where it was left."""

from __future__ import annotations

import json
import shutil
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robomill.blind.sealing import BenchmarkError
from robomill.blind.workers import Progress, work

Diagnose = Callable[[Path, Path], Any]
"""(folder of the case, folder for the result) -> anything; writes diagnosis.json there. Must be importable: it goes to other processes."""


def run_cases(
    folder: str | Path,
    diagnose: Diagnose,
    workers: int | None = None,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> dict[str, Any]:
    """Diagnose every case that has no prediction yet; returns how many were done, were there before, and failed (with their errors).

    On `workers` processes (None: one per core), or on the Dask cluster of a `scheduler` whose workers see the folder by the same path.
    A diagnosis is told the folder of the case only, never the sealed one; what it writes gets the key `time` (wall and CPU, s).
    A case whose diagnosis raises gets an `error.txt` instead of a prediction and is tried again next time.
    BenchmarkError if there is no benchmark.
    """
    folder = Path(folder).resolve()
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
    to_do = [c for c in cases if not complete(folder / "predictions" / c.name / "diagnosis.json")]
    failed: dict[str, str] = {}
    jobs = [(diagnose, c, folder / "predictions" / c.name) for c in to_do]
    for done, (i, error) in enumerate(work(diagnose_one, jobs, workers, scheduler), 1):
        if error:
            failed[to_do[i].name] = error
        if progress is not None:
            progress("diagnose", done, len(to_do))
    return {"cases": len(cases), "done": len(to_do) - len(failed), "before": len(cases) - len(to_do), "failed": failed}


def complete(file: Path) -> bool:
    """Whether there is a diagnosis with a verdict."""
    try:
        return "verdict" in json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False


def diagnose_one(diagnose: Diagnose, case: Path, result: Path) -> str:
    """In a worker: the last line of the error, or nothing. The result appears in one move when it is complete."""
    part = result.with_name(f".{result.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        diagnose(case, part)
    except Exception as error:
        (part / "error.txt").write_text(traceback.format_exc(), encoding="utf-8")
        text = f"{type(error).__name__}: {error}"
    else:
        text = _timed(part / "diagnosis.json", time.perf_counter() - wall, time.process_time() - cpu)
    shutil.rmtree(result, ignore_errors=True)
    part.rename(result)
    return text


def _timed(file: Path, wall: float, cpu: float) -> str:
    """Put the time [s] that it took into a prediction; returns what is wrong with it, or nothing."""
    if not complete(file):
        return "the diagnosis wrote no diagnosis.json with a verdict"
    content = json.loads(file.read_text(encoding="utf-8"))
    content["time"] = {"wall": round(wall, 2), "cpu": round(cpu, 2)}
    file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return ""
