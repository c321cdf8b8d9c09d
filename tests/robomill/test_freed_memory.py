"""Freed arrays do not stay in the process."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import os, sys
from pathlib import Path
import numpy as np
from robomill.freed_memory import LARGE, give_back

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

warm = np.ones(4_000_000)  # the library then takes all that is smaller from one heap
del warm
give_back()
before = resident()
blocks = [np.ones(LARGE // 8 + 1) for _ in range(1200)]
held = resident() - before
kept = blocks[::100]
del blocks
print((resident() - before) / held)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="it is about the C library of Linux")
def test_what_lies_between_arrays_in_use_goes_back() -> None:
    """Every hundredth of 1200 arrays stays; the library keeps all of them where it has grown one heap and is left as it is."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert 0.0 < float(done.stdout) < 0.1
