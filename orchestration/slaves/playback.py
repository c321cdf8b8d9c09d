"""A component played back from a recorded run: the same outputs, whatever its inputs are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from robomill.orchestration.errors import SlaveError, unknown
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, Port, PortData

_SAME_TIME = 0.5e-9  # s: half a tick


class ReplaySlave:
    """Plays back the columns of `component` in `run` (default: the component called like the instance).

    At recorded times the numbers are the recorded ones, exactly; between them reals are interpolated
    linearly, integers and booleans hold the last value. `ignored` are the input ports it is to have.
    SlaveError if the run has no such component, or is asked for a time that it does not cover.
    """

    def __init__(self, name: str, run: Run, component: str | None = None, ignored: Sequence[Port] = ()) -> None:
        self._name, self._run = name, run
        self._component = component or name
        columns = [c for c in run.columns if c.partition(".")[0] == self._component]
        if not columns:
            raise SlaveError(f"component {name!r}: run {run.folder}: {unknown('component', self._component, run.components)}")
        if not len(run.t):
            raise SlaveError(f"component {name!r}: run {run.folder} holds no samples (outcome: {run.outcome})")
        self._t = run.t
        self._data = np.stack([run.columns[c] for c in columns], axis=1)
        self._held = np.array([run.ports[c].type != "real" for c in columns])
        recorded = [run.ports[c] for c in columns]
        self._ports: tuple[Port, ...] = (
            *(PortData(p.name, "input", p.type, None, p.start, description="ignored: the outputs are recorded") for p in ignored),
            # with the dependencies that it had, the order of execution stays as it was
            *(replace(p, start=float(v)) for p, v in zip(recorded, self._data[0], strict=True)),
        )
        self._index = 0
        self._row = self._data[0]

    def with_inputs(self, ignored: Sequence[Port]) -> ReplaySlave:
        """The same playback with other input ports."""
        return ReplaySlave(self._name, self._run, self._component, ignored)

    @property
    def name(self) -> str:
        """Name of the instance."""
        return self._name

    @property
    def ports(self) -> Sequence[Port]:
        """The ignored inputs and the recorded outputs."""
        return self._ports

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Parameters change nothing: what they did is in the recording."""

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Go to the row of time `start` [s]."""
        self._index = 0
        self._seek(start)

    def set_inputs(self, values: FloatArray) -> None:
        """Inputs are ignored."""

    def step(self, t: float, h: float) -> None:
        """Go to the row of time `t + h` [s]."""
        self._seek(t + h)

    def get_outputs(self, out: FloatArray) -> None:
        """The recorded outputs of the time reached."""
        out[:] = self._row

    def get_state(self) -> Any:
        """The place in the recording."""
        return self._index, self._row.copy()

    def set_state(self, state: Any) -> None:
        """Go back to a place in the recording."""
        self._index, self._row = state

    def close(self) -> None:
        """Nothing to free."""

    def _seek(self, t: float) -> None:
        following = self._index + 1
        if following < len(self._t) and abs(self._t[following] - t) <= _SAME_TIME:
            self._index, self._row = following, self._data[following]
            return
        i = int(np.searchsorted(self._t, t + _SAME_TIME, side="right")) - 1
        if i < 0:
            raise SlaveError(self._outside(f"begins at t = {self._t[0]:.9g} s", t))
        self._index = i
        if abs(self._t[i] - t) <= _SAME_TIME:
            self._row = self._data[i]
            return
        if i + 1 == len(self._t):
            raise SlaveError(self._outside(f"ends at t = {self._t[-1]:.9g} s", t))
        a, b = self._data[i], self._data[i + 1]
        share = (t - self._t[i]) / (self._t[i + 1] - self._t[i])
        self._row = np.where(self._held, a, a + share * (b - a))

    def _outside(self, fact: str, t: float) -> str:
        return f"the recording of {self._component!r} in {self._run.folder} {fact}; t = {t:.9g} s is needed: run a time that it covers"
