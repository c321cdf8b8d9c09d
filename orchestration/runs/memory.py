"""A run kept in memory instead of on disk: for studies of many short runs, and for tests."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray, plain
from robomill.orchestration.system.wiring import Wiring


@dataclass
class Memory:
    """Observer that keeps every row; `run()` gives them as a `Run` at any time.

    `columns`: outputs (`component.port`) that are kept, as far as they are there; None: all.
    """

    about: Mapping[str, Any] = field(default_factory=dict)
    columns: Collection[str] | None = None

    @property
    def keeps_columns(self) -> bool:
        """Whether arrays that it is shown become its own: of some columns it copies what it keeps."""
        return self.columns is None

    def begin(self, wiring: Wiring, step: float) -> None:
        """Forget what was there before."""
        kept = [i for i, name in enumerate(wiring.column_names()) if self.columns is None or name in self.columns]
        self._ports = {f"{c}.{p.name}": p for c, p in (wiring.outputs[i] for i in kept)}
        self._kept: Any = slice(None) if self.columns is None else kept
        self._blocks: list[FloatArray] = []  # t and the outputs, a row each
        self._t: list[float] = []  # rows that came one by one since the last block
        self._rows: list[FloatArray] = []
        self._outcome, self._message = "running", ""

    def observe(self, t: float, outputs: FloatArray) -> None:
        """Keep a copy of the outputs."""
        self._t.append(t)
        self._rows.append(outputs[self._kept].copy())

    def observe_columns(self, columns: FloatArray, count: int) -> None:
        """Keep many steps at once, as they stand: the first `count` of t [s] and the outputs."""
        self._gather()
        self._blocks.append(columns[:, :count] if self.columns is None else columns[[0, *(1 + i for i in self._kept)], :count])

    def _gather(self) -> None:
        if self._t:
            rows = np.array(self._rows).reshape(len(self._rows), len(self._ports))
            self._blocks.append(np.vstack([self._t, rows.T]))
            self._t, self._rows = [], []

    def end(self, outcome: str, message: str) -> None:
        """Remember how it ended."""
        self._outcome, self._message = outcome, message

    def run(self) -> Run:
        """What has been observed so far."""
        self._gather()
        t, *data = np.concatenate([np.empty((1 + len(self._ports), 0)), *self._blocks], axis=1)
        columns = dict(zip(self._ports, data, strict=True))
        ports = {name: plain(p) for name, p in self._ports.items()}
        info = {**self.about, "outcome": self._outcome, "message": self._message}
        return Run(Path(), t, columns, ports, info)
