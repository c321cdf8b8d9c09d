"""Hashes that show whether cases, truth or predictions were changed.

`benchmark.json` has the hash of every file of the cases and that of `sealed/manifest.json`, which has those of the truth;
`predictions.json` has those of the predictions when the truth was first opened.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from robomill.blind.truth import Truth


class BenchmarkError(ValueError):
    """A benchmark folder that cannot be used; says what is wrong and what to do."""


@dataclass(frozen=True)
class Benchmark:
    """All of benchmark.json."""

    schema: str
    """Name and version of the form."""
    version: int
    """Version of the generator."""
    cases: int
    """Number of cases."""
    seed: int
    """Seed that all cases follow from."""
    tier: str
    """Set of channels that are logged."""
    set: str
    """One of `sets.SETS`."""
    generator: str
    """One of `sets.GENERATORS`."""
    truth: str
    """Hash of the manifest of the truth."""
    files: Mapping[str, str]
    """File below `cases` -> its hash."""


def hashes(folder: Path, exclude: Sequence[str] = ()) -> dict[str, str]:
    """SHA-256 of every file below a folder, by relative path."""
    files = sorted(f for f in folder.rglob("*") if f.is_file() and f.name not in exclude)
    return {f.relative_to(folder).as_posix(): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def freeze_predictions(folder: Path) -> tuple[dict[str, str], bool]:
    """Hash the predictions and note that before the truth is opened; returns the hashes and whether they are those of the first time."""
    current = {k: v for k, v in hashes(folder / "predictions").items() if k.endswith("/diagnosis.json") and not k.startswith(".")}
    file = folder / "predictions.json"
    if file.is_file():
        return current, json.loads(file.read_text(encoding="utf-8")) == current
    file.write_text(json.dumps(current, indent=0, sort_keys=True) + "\n", encoding="utf-8")
    return current, True


def unseal(folder: Path) -> tuple[Benchmark, dict[int, Truth]]:
    """benchmark.json and the truths by case. BenchmarkError if cases or truth are not those that were made."""
    file = folder / "benchmark.json"
    if not file.is_file():
        raise BenchmarkError(
            f"{folder} holds no finished benchmark (no benchmark.json); make one with: robomill blind make {folder} --cases N"
        )
    try:
        head = Benchmark(**json.loads(file.read_text(encoding="utf-8")))
    except TypeError as error:
        raise BenchmarkError(
            f"{file} has other keys than this version writes: {error}; make the benchmark anew with this version"
        ) from error
    sealed = folder / "sealed"
    manifest = sealed / "manifest.json"
    if not manifest.is_file() or hashlib.sha256(manifest.read_bytes()).hexdigest() != head.truth:
        raise BenchmarkError(
            f"{manifest} is not the one whose hash is in benchmark.json: the truth was changed or is not here"
            "; put back the truth that was made with it, or make the benchmark anew"
        )
    listed = json.loads(manifest.read_text(encoding="utf-8"))
    if hashes(sealed, exclude=("manifest.json",)) != listed:
        raise BenchmarkError(
            f"{sealed}: files differ from manifest.json: the truth was changed"
            "; put back the truth that was made with it, or make the benchmark anew"
        )
    changed = sorted(k for k, v in hashes(folder / "cases").items() if head.files.get(k, v) != v)
    if changed:
        raise BenchmarkError(
            f"{folder / 'cases'}: changed since it was made: {', '.join(changed[:5])}; put the files back, or make the benchmark anew"
        )
    files = [sealed / name for name in listed if name.endswith(".json")]
    try:
        return head, {int(f.name[:4]): Truth.read(json.loads(f.read_text(encoding="utf-8"))) for f in files}
    except TypeError as error:
        raise BenchmarkError(
            f"{sealed}: truths with other keys than this version writes: {error}; make the benchmark anew with this version"
        ) from error
