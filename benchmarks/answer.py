"""What every measured master answers, and where it reads time and memory."""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Answer:
    """One run from t = 0."""

    wall: float
    """Seconds that the steps took, setting up and closing not included."""
    cpu: float
    """CPU time of all threads [s] that the steps took."""
    setup: float = 0.0
    """Seconds from nothing (FMUs not unpacked) to the first step."""
    closing: float = 0.0
    """Seconds from the last step until the results are complete."""
    finished: float = 0.0
    """Moment when the last step was done, on the monotonic clock [s]."""
    memory: float = 0.0
    """Peak resident memory of the process so far [MB]."""
    outputs: list[float] = field(default_factory=list)
    """All outputs after the last step, if asked for."""
    recorded: list[float] = field(default_factory=list)
    """The last row of the results, as it was read back from where they were written, if asked for."""


def clocks() -> tuple[float, float]:
    """Wall clock and CPU time of all threads [s]."""
    return time.monotonic(), time.process_time()


def peak_memory() -> float:
    """Largest memory of this process so far [MB]. Linux: not ru_maxrss, which begins with that of the parent."""
    status = Path("/proc/self/status")
    if status.exists():
        return next(float(line.split()[1]) / 1024 for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform != "darwin" else 1024**2)
