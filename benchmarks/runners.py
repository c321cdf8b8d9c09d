"""Processes that masters run in, as the measurement sees them: asked for a run, they answer or fail with one sentence."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

from benchmarks.answer import Answer

ROOT = Path(__file__).parent.parent
_LAUNCHER = (  # a small process of its own: peak memory of a child begins with that of its parent
    "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True);"
    "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024, file=sys.stderr)"
)


class MasterError(Exception):
    """A master could not do what was asked; the text says why."""


class Runner(Protocol):
    """A master that is ready to be asked."""

    def run(self, steps: int, results: str, check: bool = False, limit: float = 60.0) -> Answer:
        """That many steps from t = 0; MasterError if it cannot, or takes longer than `limit` [s]."""
        ...

    def close(self) -> None:
        """End its process."""
        ...


class Worker:
    """A Python process with a master (`benchmarks.worker`)."""

    def __init__(self, kind: str, file: Path, environment: Mapping[str, str] | None = None) -> None:
        self.began = time.monotonic()
        self.log = tempfile.TemporaryFile("w+")  # noqa: SIM115 (until close)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.worker", kind, str(file)],
            cwd=ROOT,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", **(environment or {})},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.log,
            text=True,
        )

    def run(self, steps: int, results: str, check: bool = False, limit: float = 60.0) -> Answer:
        """See `Runner`."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            print(json.dumps({"steps": steps, "results": results, "check": check}), file=self.process.stdin, flush=True)
        except BrokenPipeError:
            raise MasterError(self._last_words()) from None
        if not select.select([self.process.stdout], [], [], limit)[0]:
            self.close()
            raise MasterError(f"took more than {limit:.0f} s")
        line = self.process.stdout.readline()
        if not line:
            raise MasterError(self._last_words())
        answer = json.loads(line)
        if "error" in answer:
            raise MasterError(answer["error"].splitlines()[0][:200])
        return Answer(**answer)

    def _last_words(self) -> str:
        status = self.process.wait()
        self.log.seek(0)
        lines = self.log.read().splitlines() or [""]
        return f"its process ended with status {status}: {lines[-1][:200]}"

    def close(self) -> None:
        """See `Runner`."""
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout, self.log):
            if stream is not None:
                stream.close()


class Program:
    """A compiled loop: a process per run, which times itself. `command(steps, record)` is what to call."""

    def __init__(self, command: Callable[[int, bool], list[str]]) -> None:
        self.command = command

    def run(self, steps: int, results: str, check: bool = False, limit: float = 60.0) -> Answer:
        """See `Runner`."""
        began = time.monotonic()
        try:
            launcher = [sys.executable, "-I", "-S", "-c", _LAUNCHER] if check else []
            done = subprocess.run(
                [*launcher, *self.command(steps, results == "memory")], check=True, capture_output=True, text=True, timeout=limit
            )
        except subprocess.TimeoutExpired:
            raise MasterError(f"took more than {limit:.0f} s") from None
        except subprocess.CalledProcessError as error:
            raise MasterError(f"status {error.returncode}: {error.stderr.strip()[-200:]}") from None
        wall, cpu, *outputs = done.stdout.split()
        answer = Answer(float(wall) * 1e-9 * steps, float(cpu) * 1e-9 * steps, finished=time.monotonic())
        answer.setup = max(answer.finished - began - answer.wall, 0.0)
        if check:
            answer.outputs = [float.fromhex(y) for y in outputs]
            answer.memory = float(done.stderr.split()[-1])
        return answer

    def close(self) -> None:
        """Nothing runs between two runs."""
