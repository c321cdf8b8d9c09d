"""An FMU in its own process: what crashes, hangs or exits there becomes one error here.

Inputs and outputs stand in memory that both processes map (a file in the folder that this side owns);
a pipe carries one request and one answer per step, so `set_inputs` and `get_outputs` only copy. The
process is a fresh interpreter (nothing is forked or imported from the caller's `__main__`); it ends with
this one, and its temporary files are in a folder that is removed here whatever happens to it. This
guards against faults, not against malice: the FMU runs with the rights of the user.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import pickle
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from robomill.orchestration.errors import SlaveError
from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, Port, inputs, outputs

START_LIMIT = 60.0
"""Least wall clock that starting, loading and initialising may take [s], however short the limit of a step is: there compilers run."""
_POLL = 0.2  # s between two looks whether the process is still there
_LINES = 20  # last lines that it printed, for error texts
STEP, CALL = b"s", b"c"
OK, FAILED = b"+", b"-"
TIMES = struct.Struct("<dd")
_BOOT = (
    "import sys, json; sys.path[:] = json.loads(sys.argv[1]); "
    "from robomill.orchestration.slaves.isolated import serve; serve(int(sys.argv[2]))"
)


class IsolatedSlave:
    """The FMU `file` as a slave that lives in another process.

    `time_limit` [s of wall clock] is what one call may take before the process is ended; loading and
    initialising may take at least `START_LIMIT`. SlaveError for whatever the FMU itself reports, and for a crash
    (signal), an exit or the time limit; after one of those three every call repeats it. `goes_back` as in `fmu.FmuSlave`.
    """

    def __init__(self, file: str | Path, name: str | None = None, time_limit: float = 60.0, goes_back: bool = False) -> None:
        self._name = name or Path(file).stem
        self._limit = time_limit
        self._lost = ""  # why the process is gone
        self._closed = False
        self._memory: mmap.mmap | None = None
        self._printed: deque[str] = deque(maxlen=_LINES)
        self._folder = tempfile.TemporaryDirectory(prefix="robomill_isolated_", ignore_cleanup_errors=True)
        try:
            self._start()
            ports, warnings = self._call("open", str(Path(file).absolute()), self._name, self._folder.name, goes_back)
            self._ports: tuple[Port, ...] = tuple(ports)
            self.warnings: tuple[str, ...] = tuple(warnings)
            """Those of the FMU."""
            self._share()
        except BaseException:
            self.close()
            raise

    def _start(self) -> None:
        from multiprocessing import Pipe  # which takes ten milliseconds, and few systems need it

        ours, theirs = Pipe()
        handle = theirs.fileno()
        options: dict[str, Any]
        if sys.platform == "win32":
            os.set_handle_inheritable(handle, True)
            options = {"close_fds": False, "creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        else:
            options = {"pass_fds": (handle,), "start_new_session": True}  # Ctrl-C is for this process: it ends the other in order
        # stdin is a lifeline: it closes when this process ends, however it ends
        self._process = subprocess.Popen(
            [sys.executable, "-c", _BOOT, json.dumps(sys.path), str(handle)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            **options,
        )
        theirs.close()  # so that the other end closes with the process
        self._pipe = ours
        self._reader = threading.Thread(target=self._listen, daemon=True)
        self._reader.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as stream:
            for line in stream:
                self._printed.append(line.decode("utf-8", "replace").rstrip())

    def _share(self) -> None:
        n_in, n_out = len(inputs(self._ports)), len(outputs(self._ports))
        file = Path(self._folder.name) / "signals"
        file.write_bytes(bytes(8 * (n_in + n_out + 1)))  # one more: no empty file can be mapped
        with file.open("r+b") as stream:
            self._memory = mmap.mmap(stream.fileno(), 0)
        image = np.frombuffer(self._memory, dtype=np.float64)
        self._inputs, self._outputs = image[:n_in], image[n_in : n_in + n_out]
        self._inputs[:] = [float(p.start or 0.0) for p in inputs(self._ports)]
        self._stale = False  # whether outputs have to be asked for: during initialisation they follow the inputs
        self._call("share", str(file), n_in, n_out)

    @property
    def name(self) -> str:
        """Name of the instance."""
        return self._name

    @property
    def ports(self) -> tuple[Port, ...]:
        """Those of the FMU."""
        return self._ports

    @property
    def process_id(self) -> int:
        """Number of the process that the FMU runs in."""
        return self._process.pid

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Take parameters for the next `initialise`."""
        self._call("configure", dict(parameters))

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Enter initialisation."""
        self._call("initialise", start, stop, step)
        self._stale = True

    def leave_initialisation(self) -> None:
        """Leave initialisation before the first step does."""
        self._call("leave_initialisation")
        self._stale = False

    def set_inputs(self, values: FloatArray) -> None:
        """Put the inputs where the other process finds them: they reach the FMU with the next step, or when outputs are read before it."""
        self._inputs[:] = values

    def step(self, t: float, h: float) -> None:
        """Set inputs, step from `t` to `t + h` [s], get outputs: one request."""
        self._request(STEP + TIMES.pack(t, h), f"the step from t = {t:.9g} s", self._limit)
        self._stale = False

    def get_outputs(self, out: FloatArray) -> None:
        """Outputs of the last step; before the first, those that follow from the inputs."""
        if self._stale:
            self._call("refresh")
        out[:] = self._outputs

    def get_state(self) -> Any:
        """The FMU's state: bytes that leave the process where it can serialise, else a number under which the other process keeps it."""
        return self._call("get_state"), self._stale

    def set_state(self, state: Any) -> None:
        """Back to a state from `get_state`."""
        saved, self._stale = state
        self._call("set_state", saved)

    def close(self) -> None:
        """End the process, by force where it does not end in time, and remove its files."""
        if self._closed:
            return
        self._closed = True
        if hasattr(self, "_process"):
            if not self._lost:
                with contextlib.suppress(SlaveError):  # closing reports nothing; the process is ended below
                    self._request(CALL + pickle.dumps(("close", ())), "close", self._limit)
            self._end()
            self._pipe.close()
        if self._memory is not None:
            self._inputs = self._outputs = np.empty(0)
            self._memory.close()
        self._folder.cleanup()
        self._lost = self._lost or f"component {self._name!r} was closed"

    def _call(self, method: str, *arguments: Any) -> Any:
        starting = method in ("open", "initialise")
        answer = self._request(CALL + pickle.dumps((method, arguments)), method, max(self._limit, START_LIMIT if starting else 0.0))
        try:
            return pickle.loads(answer) if answer else None
        except Exception as error:  # anything, if memory was overwritten there
            raise self._lose(f"sent what cannot be understood ({error}) during {method} and was ended") from None

    def _request(self, message: bytes, what: str, limit: float) -> bytes:
        """Send a request and wait for its answer; SlaveError with what the FMU says, or with what became of the process."""
        if self._lost:
            raise SlaveError(self._lost)
        try:
            self._pipe.send_bytes(message)
            self._wait(what, limit)
            answer: bytes = self._pipe.recv_bytes()
        except (EOFError, OSError):
            raise self._lose(self._ending(what)) from None
        if answer[:1] == FAILED:
            raise SlaveError(answer[1:].decode("utf-8", "replace"))
        return answer[1:]

    def _wait(self, what: str, limit: float) -> None:
        deadline = time.monotonic() + limit
        while not self._pipe.poll(min(_POLL, max(0.0, deadline - time.monotonic()))):
            if self._process.poll() is not None and not self._pipe.poll():
                raise EOFError  # a process that it started may keep its end of the pipe open
            if time.monotonic() >= deadline:
                raise self._lose(f"did not answer within {limit:g} s during {what} and was ended (time_limit)")

    def _ending(self, what: str) -> str:
        try:
            code = self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            return f"closed its connection during {what} and was ended"
        if code >= 0:
            return f"exited with status {code} during {what}"
        try:
            word = signal.Signals(-code).name
        except ValueError:
            word = "unknown"
        return f"crashed with signal {-code} ({word}) during {what}"

    def _lose(self, text: str) -> SlaveError:
        """End what is left of the process and make the error that says why; all later calls give it, too."""
        self._end()
        self._lost = f"component {self._name!r}: its process {text}"
        if self._printed:
            self._lost += "; the last that it printed:\n" + "\n".join(f"  {line}" for line in self._printed)
        return SlaveError(self._lost)

    def _end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        if self._closed and not self._lost:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(2.0)
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._reader.join(1.0)
