"""Simulations on disk, so that an interrupted diagnosis goes on where it was. A simulation is found by a hash of all that it depends on."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robomill.orchestration.assembly import MEASURED
from robomill.orchestration.slaves.protocol import FloatArray
from robomill.orchestration.system.definition import System


@dataclass
class Store:
    """A folder of simulations. `sources` stands for the models' program code: with other sources nothing that is there is used."""

    folder: Path
    sources: str = ""

    def get(self, key: str) -> tuple[bool, FloatArray | None]:
        """Whether the simulation is there, and its channels (None: the system could not run)."""
        try:
            kept = np.load(self._file(key), allow_pickle=False)
        except (OSError, ValueError, EOFError):
            return False, None
        return True, kept if kept.size else None

    def put(self, key: str, channels: FloatArray | None) -> None:
        """Keep a simulation [n, channels] (None: the system cannot run); its file appears in one move."""
        self.folder.mkdir(parents=True, exist_ok=True)
        part = self._file(key).with_suffix(f".part-{os.getpid()}")
        with part.open("wb") as file:
            np.save(file, np.zeros(0) if channels is None else channels)
        part.replace(self._file(key))

    def remove(self) -> None:
        """Delete the folder with all simulations: after a finished diagnosis."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def __len__(self) -> int:
        return sum(1 for _ in self.folder.glob("*.npy"))

    def _file(self, key: str) -> Path:
        return self.folder / f"{key}.npy"

    def key(self, *parts: Any) -> str:
        """Hash of the sources and of `parts`: numbers, texts, arrays, tables; a text that names a file counts as what is in it."""
        digest = hashlib.sha256(self.sources.encode())
        for part in parts:
            digest.update(json.dumps(_plain(part, Path()), sort_keys=True).encode())
        return digest.hexdigest()[:32]


def _plain(value: Any, folder: Path) -> Any:
    if isinstance(value, System):
        parts = [[c.name, _source(c.source), c.parameters, c.inputs, c.isolate, c.rate, c.every, c.correction] for c in value.components]
        wires = [str(c) + " delayed" * c.delayed for c in value.connections]
        how = [value.step, value.algorithm, value.stop_when, value.check_ranges, str(value.iteration)]
        return _plain([parts, wires, how], value.folder)
    if isinstance(value, Mapping):
        return {str(k): _plain(v, folder) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v, folder) for v in value]
    if isinstance(value, np.ndarray):
        return hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    if isinstance(value, str) and value and _is_file(folder / value):
        return hashlib.sha256((folder / value).read_bytes()).hexdigest()
    return value if isinstance(value, bool | int | float | str | None) else str(value)


def _source(source: str) -> list[str]:
    """Where a component comes from; of one that plays what was measured, what is in the files of signals, too."""
    if not source.startswith(f"{MEASURED}:"):
        return [source]
    files = sorted(Path(source.partition(":")[2]).glob("signals.*"))
    return [source, *(hashlib.sha256(f.read_bytes()).hexdigest() for f in files)]


def _is_file(path: Path) -> bool:
    """Whether there is such a file; a text that is longer than the system lets a path be names none."""
    try:
        return path.is_file()
    except OSError:
        return False
