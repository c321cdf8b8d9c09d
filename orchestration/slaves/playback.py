"""A component that plays back what was recorded: the same outputs, whatever its inputs are; or added to what passes through it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from robomill.orchestration.errors import SlaveError, unknown
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.native import BlockData
from robomill.orchestration.slaves.playback_kernel import AFTER, BEFORE, HEAD, look_up
from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, Port, PortData, plain


class Playback:
    """Outputs y(t) = s(t) for series s; y(t) = s(t) + u(t) with inputs u if it `adds`.

    At the times of the series the numbers are those of the series, exactly; between them reals are interpolated linearly, integers and
    booleans hold the last value. Asked for a time that the series do not cover, it raises SlaveError, or `clamps`: it holds the first or
    the last row. In a compiled loop it is compiled.
    """

    restarts = True

    def __init__(
        self,
        name: str,
        ports: Sequence[Port],
        t: FloatArray,
        rows: FloatArray,
        *,
        ignored: Sequence[Port] = (),
        adds: bool = False,
        clamps: bool = False,
        source: str = "the series",
    ) -> None:
        """`rows` [n, m] are the values of the m output `ports` [their units] at the times `t` [n] [s]; `source` names them in errors.

        `ignored` are inputs that change nothing. The inputs of one that adds are called like the outputs (`passing`).
        """
        n, m = rows.shape
        self.name, self._source = name, source
        self._given = (ports, t, rows)
        self._data = np.zeros(HEAD + 3 * m + n + n * m)
        self._data[:HEAD] = n, m, adds, clamps, 0
        held, self._u, self._y, times, table = np.split(self._data[HEAD:], np.cumsum([m, m, m, n]))
        held[:], times[:], table[:] = [p.type != "real" for p in ports], t, rows.ravel()
        self._time = 0.0
        self._unused = np.zeros(len(ignored))
        """Where a compiled loop puts the inputs that change nothing."""
        into = [PortData(passing(p.name), "input", p.type, p.unit, 0.0) for p in ports] if adds else []
        into += [PortData(p.name, "input", p.type, None, p.start, description="ignored: the outputs are recorded") for p in ignored]
        # with the dependencies that it had, the order of execution stays as it was
        through: list[tuple[str, ...] | None] = [(passing(p.name),) if adds else p.dependencies for p in ports]
        out = [replace(plain(p), start=float(v), dependencies=d) for p, v, d in zip(ports, rows[0], through, strict=True)]
        self.ports: tuple[Port, ...] = (*into, *out)

    @staticmethod
    def of_run(name: str, run: Run, component: str | None = None, clamps: bool = False) -> Playback:
        """The columns of `component` in `run` (default: the component called like the instance). SlaveError if the run has none."""
        component = component or name
        columns = [c for c in run.columns if c.partition(".")[0] == component]
        if not columns:
            raise SlaveError(f"component {name!r}: run {run.folder}: {unknown('component', component, run.components)}")
        if not len(run.t):
            raise SlaveError(f"component {name!r}: run {run.folder} holds no samples (outcome: {run.outcome})")
        rows = np.stack([run.columns[c] for c in columns], axis=1)
        source = f"the recording of {component!r} in {run.folder}"
        return Playback(name, [run.ports[c] for c in columns], run.t, rows, clamps=clamps, source=source)

    @staticmethod
    def of_series(name: str, ports: Sequence[Port], series: Mapping[str, FloatArray], t: FloatArray, adds: bool = False) -> Playback:
        """Series [n] by name of the port, which stand still before the first and after the last of the times `t` [n] [s]."""
        independent = [PortData(p.name, "output", p.type, p.unit, dependencies=()) for p in ports]
        return Playback(name, independent, t, np.stack([series[p.name] for p in ports], axis=1), adds=adds, clamps=True)

    def with_inputs(self, ignored: Sequence[Port]) -> Playback:
        """One that plays back what this one does, and has other inputs that change nothing; itself, if there are none or it adds them."""
        if self._data[2] or not ignored:
            return self
        ports, t, rows = self._given
        return Playback(self.name, ports, t, rows, ignored=ignored, clamps=bool(self._data[3]), source=self._source)

    def play(self, series: Mapping[str, FloatArray]) -> None:
        """From now on play other series [n] at the same times, by name of the port."""
        ports, t, rows = self._given
        rows = np.stack([series[p.name] for p in ports], axis=1)
        self._given = ports, t, rows
        self._data[len(self._data) - rows.size :] = rows.ravel()

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Parameters change nothing: what they did is in the recording."""

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Go to the row of time `start` [s]."""
        self._seek(start)

    def set_inputs(self, values: FloatArray) -> None:
        """Keep what is to be added."""
        if self._data[2]:
            self._u[:] = values

    def step(self, t: float, h: float) -> None:
        """Go to the row of time `t + h` [s]."""
        self._seek(t + h)

    def get_outputs(self, out: FloatArray) -> None:
        """The outputs at the time reached, with the inputs of now."""
        self._seek(self._time)
        out[:] = self._y

    def get_state(self) -> Any:
        """Time and inputs."""
        return self._time, self._u.copy()

    def set_state(self, state: Any) -> None:
        """Back to a state."""
        self._time, self._u[:] = state

    def native(self) -> _Native:
        """Addresses for the compiled loop."""
        return _Native(self)

    def close(self) -> None:
        """Nothing to free."""

    def _seek(self, t: float) -> None:
        self._time = t
        status = look_up(self._data, t)
        if status:
            raise self.outside(status, t)

    def outside(self, status: int, t: float) -> SlaveError:
        """The error for a time [s] that `look_up` says this of."""
        _, times, _ = self._given
        fact = {BEFORE: f"begins at t = {times[0]:.9g} s", AFTER: f"ends at t = {times[-1]:.9g} s"}[status]
        return SlaveError(f"{self._source} {fact}; t = {t:.9g} s is needed: run a time that it covers")


class _Native:
    """What `orchestration.slaves.native` asks for."""

    limit, final = 0, 1

    def __init__(self, playback: Playback) -> None:
        from robomill.orchestration.slaves.playback_compiled import step  # only compiled loops need Numba

        self._playback = playback
        data, m = playback._data, len(playback._y)
        self.instance: int = data.ctypes.data
        self.step: int = step.address
        inputs = [p for p in playback.ports if p.causality == "input"]
        into = playback._u if data[2] else playback._unused
        self.inputs = [BlockData("float64", 0, 0, into.ctypes.data, tuple(range(len(inputs))))] if inputs else []
        self.outputs = [BlockData("float64", 0, 0, playback._y.ctypes.data, tuple(range(m)))]

    def failed(self, what: str, block: int, status: int, t: float, h: float) -> Exception:
        """The time at the end of the step is not covered."""
        return self._playback.outside(status, t + h)


def passing(port: str) -> str:
    """Input that passes through to an output: `p[2]` -> `p_in[2]`."""
    base, bracket, index = port.partition("[")
    return f"{base}_in{bracket}{index}"
