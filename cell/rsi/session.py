"""A session in memory: rows that are there before it begins, and a run folder when it is over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robomill.orchestration.runs.importing import write_run
from robomill.orchestration.slaves.protocol import FloatArray, Port, PortData, plain

STATE, FAILED_SHARE, LOST, INTERVAL, TURNAROUND, DELAY = range(6)
LINK_PORTS = (
    PortData("state", "output", unit="1", description="1 running, 2 the correction goes to zero, 3 it is zero"),
    PortData("share", "output", unit="1", description="share of the correction that is sent"),
    PortData("lost", "output", unit="1", description="cycles so far whose packet never came"),
    PortData("interval", "output", unit="s", description="time since the packet before"),
    PortData("turnaround", "output", unit="s", description="from a packet to its answer; 0 where a lost cycle was made up for"),
    PortData("delay", "output", unit="1", description="late answers that the robot controller counts"),
)
"""What a session says of itself, beside the outputs of the components: columns `link.state`, ..."""


class Session:
    """Rows of t [s], all outputs of a side, `LINK_PORTS` and the values sent, float64[capacity, columns]."""

    def __init__(self, outputs: Sequence[tuple[str, Port]], sent: Sequence[Port], capacity: int) -> None:
        """`outputs`: (component, port) in the order of the bus; `sent`: ports whose corrections are sent, after all limits."""
        renamed = [
            PortData(f"sent_{p.name}", "output", unit=p.unit, description=f"sent to the robot after limits: {p.description}") for p in sent
        ]
        self._ports = [*((c, plain(p)) for c, p in outputs), *(("link", p) for p in (*LINK_PORTS, *renamed))]
        self.rows = np.zeros((capacity, 1 + len(self._ports)))
        self.rows.fill(0.0)  # the pages are there before the session begins
        self.count = 0
        self._outputs = [row[1 : 1 + len(outputs)] for row in self.rows]
        self._link = [row[1 + len(outputs) : 1 + len(outputs) + len(LINK_PORTS)] for row in self.rows]
        self._sent = [row[1 + len(outputs) + len(LINK_PORTS) :] for row in self.rows]

    @property
    def full(self) -> bool:
        """Whether no further row can be kept."""
        return self.count >= len(self.rows)

    def keep(self, t: float, outputs: FloatArray) -> None:
        """A row of outputs at t [s]; what is said of the link is 0 until `say`."""
        self.rows[self.count, 0] = t
        self._outputs[self.count][:] = outputs
        self.count += 1

    def say(self, link: Sequence[float], sent: FloatArray) -> None:
        """What the last row says of the link, and what was sent [units of the ports]."""
        self._link[self.count - 1][:] = link
        self._sent[self.count - 1][:] = sent

    def columns(self) -> dict[str, FloatArray]:
        """Columns by `component.port`, without t."""
        return {f"{c}.{p.name}": self.rows[: self.count, 1 + i] for i, (c, p) in enumerate(self._ports)}

    def write(self, folder: Path, info: Mapping[str, Any], overwrite: bool) -> None:
        """Write a run folder. ResultsError as of `write_run`."""
        ports = {f"{c}.{p.name}": p for c, p in self._ports}
        write_run(folder, self.rows[: self.count, 0].copy(), {k: v.copy() for k, v in self.columns().items()}, ports, info, overwrite)
