"""The other side of `isolation`: runs one FMU and answers requests until the pipe closes."""

from __future__ import annotations

import mmap
import os
import pickle
import sys
import tempfile
import threading
from multiprocessing import connection
from pathlib import Path
from typing import Any

import numpy as np

from robomill.orchestration.errors import SlaveError, describe
from robomill.orchestration.slaves.isolation import CALL, FAILED, OK, STEP, TIMES
from robomill.orchestration.slaves.protocol import FloatArray, PortData, Slave, leave_initialisation, plain


class _Kept:
    """Stands in the other process for a state that cannot leave this one."""

    def __init__(self, number: int) -> None:
        self.number = number


class Server:
    """One FMU, its part of the shared memory, and the states that are kept here."""

    def __init__(self) -> None:
        self.slave: Slave | None = None
        self.inputs: FloatArray = np.empty(0)
        self.outputs: FloatArray = np.empty(0)
        self.states: list[Any] = []

    @property
    def fmu(self) -> Slave:
        """The FMU, once it is open."""
        if self.slave is None:
            raise SlaveError("no FMU is open in this process; load it first")
        return self.slave

    def open(self, file: str, name: str, folder: str, goes_back: bool) -> tuple[list[PortData], tuple[str, ...]]:
        """Load the FMU; its ports and warnings. Its temporary files go into `folder`, which the other side removes."""
        tempfile.tempdir = folder
        from robomill.orchestration.slaves.fmu import FmuSlave

        self.slave = slave = FmuSlave(file, name, goes_back)
        return [plain(p) for p in slave.ports], slave.warnings

    def share(self, file: str, n_in: int, n_out: int) -> None:
        """Map the signals."""
        with Path(file).open("r+b") as stream:
            image = np.frombuffer(mmap.mmap(stream.fileno(), 0), dtype=np.float64)
        self.inputs, self.outputs = image[:n_in], image[n_in : n_in + n_out]

    def step(self, t: float, h: float) -> None:
        """A whole step."""
        if len(self.inputs):
            self.fmu.set_inputs(self.inputs)
        self.fmu.step(t, h)
        self.fmu.get_outputs(self.outputs)

    def refresh(self) -> None:
        """Outputs during initialisation."""
        if len(self.inputs):
            self.fmu.set_inputs(self.inputs)
        self.fmu.get_outputs(self.outputs)

    def leave_initialisation(self) -> None:
        """With the inputs set so far; then the outputs at the start."""
        if len(self.inputs):
            self.fmu.set_inputs(self.inputs)
        leave_initialisation(self.fmu)
        self.fmu.get_outputs(self.outputs)

    def get_state(self) -> Any:
        """The state if it can be sent, else a stand-in."""
        state = self.fmu.get_state()
        try:
            pickle.dumps(state)
        except (ValueError, TypeError, pickle.PicklingError):  # a pointer
            self.states.append(state)
            return _Kept(len(self.states) - 1)
        return state

    def set_state(self, state: Any) -> None:
        """Back to a state, or to the one that the stand-in stands for."""
        self.fmu.set_state(self.states[state.number] if isinstance(state, _Kept) else state)

    def call(self, method: str, arguments: tuple[Any, ...]) -> Any:
        """A method of this object, else one of the FMU."""
        return getattr(self if hasattr(self, method) else self.fmu, method)(*arguments)


def serve(handle: int) -> None:
    """Answer requests on the pipe `handle`, one after the other, until it closes or `close` is asked for."""
    threading.Thread(target=_end_with_the_other_process, daemon=True).start()
    kind = getattr(connection, "PipeConnection" if sys.platform == "win32" else "Connection")
    pipe: Any = kind(handle)
    server = Server()
    while True:
        try:
            message = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        try:
            if message[:1] == STEP:
                server.step(*TIMES.unpack(message[1:]))
                pipe.send_bytes(OK)
                continue
            assert message[:1] == CALL
            method, arguments = pickle.loads(message[1:])
            answer = server.call(method, arguments)
            pipe.send_bytes(OK + (b"" if answer is None else pickle.dumps(answer)))
            if method == "close":
                return
        except Exception as error:
            pipe.send_bytes(FAILED + describe(error).encode("utf-8", "replace"))


def _end_with_the_other_process() -> None:
    """Its end of our standard input closes when it ends, also by force; an FMU that hangs would otherwise stay for ever."""
    os.read(0, 1)
    os._exit(1)
