"""The time that `make test` has: what cannot begin in it is skipped and counted."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(("minutes", "said"), [("0", "not begun within 0 minutes"), ("5", "passed")])
def test_no_test_begins_later(minutes: str, said: str) -> None:
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-rs", "--within", minutes, "tests/models/maths/test_noise.py"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert said in done.stdout
    assert ("passed" in done.stdout) == (said == "passed")
