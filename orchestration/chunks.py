"""The compiled master: the same steps, the same order, the same numbers as the loop in Python, without Python's time.

Everything is laid out in one table of operations, in the order in which a step makes them: the address of a set, step or
get function, what it takes, and where its values stand on the bus. `compiled.advance` walks through it for a chunk of
steps, checks the guards after each and writes the rows for the recorder. Between chunks Python looks at Ctrl-C,
progress and checkpoints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from orchestration import compiled
from orchestration.native import Block, Native, native_of
from orchestration.rate import MultiRate
from orchestration.slave import FloatArray, Slave
from orchestration.system import TICK
from orchestration.wiring import Wiring

_FIRST_CHUNK = 8
_CHUNK_TIME = 0.05  # s of wall clock between two looks at Ctrl-C and progress
_MOST_STEPS = 16384  # per chunk
_ROW_BYTES = 1_600_000  # of the rows of a chunk: what stays in the cache
Gather = Mapping[str, npt.NDArray[np.intp]]


@dataclass(frozen=True)
class Chunk:
    """What became of a chunk of steps."""

    made: int
    """Steps."""
    columns: FloatArray
    """t [s] and all outputs after each of them, float64[1 + n_outputs, capacity]; stays as it is until the next chunk but one."""
    failed: tuple[str, Exception] | None = None
    """Component and its error, in the step after those made."""
    in_range: bool = True
    """False: in the step after those made an output is not finite or out of its range."""

    def show(self, observers: Sequence[Any]) -> None:
        """Hand the rows to observers: at once where they take that, else one by one."""
        for o in observers:
            take_all = getattr(o, "observe_columns", None)
            if take_all is not None:
                take_all(self.columns, self.made)
            else:
                for row in self.columns[:, : self.made].T:
                    o.observe(float(row[0]), row[1:])


class CompiledLoop:
    """Steps the slaves of a master on its bus. They have made their first step in Python, which leaves initialisation.

    `bounds` of all outputs; `observed`: whether rows are wanted; at most `capacity` steps per chunk.
    """

    def __init__(
        self,
        slaves: Mapping[str, Slave],
        wiring: Wiring,
        jacobi: bool,
        bus: FloatArray,
        bounds: tuple[FloatArray, FloatArray],
        observed: bool = True,
        capacity: int | None = None,
    ) -> None:
        self._slaves, self._wiring, self._bus, self._bounds = slaves, wiring, bus, bounds
        self._natives = [_native(slave) for slave in slaves.values()]
        capacity = capacity or (min(max(_ROW_BYTES // (8 + 8 * wiring.n_outputs), 16), _MOST_STEPS) if observed else _MOST_STEPS)
        self.capacity, self._steps = capacity, _FIRST_CHUNK
        # One column per signal, as they are written. Two sets: a recorder may still write one while the other is filled.
        # An odd number of cache lines each keeps the columns from falling on the same places of the cache.
        length = 8 * (-(-capacity // 8) | 1)
        self._columns = [np.zeros((1 + wiring.n_outputs if observed else 0, length))[:, :capacity] for _ in range(2)]
        self._report, self._ticks = np.zeros(3, np.int64), np.zeros(3, np.int64)
        phases: list[list[_Call]] = [[], [], []]
        for c, native in enumerate(self._natives):
            sets = [_Call(c, "inputs", b, block) for b, block in enumerate(native.inputs)]
            gets = [_Call(c, "outputs", b, block) for b, block in enumerate(native.outputs)]
            for phase, calls in zip(phases, (sets, [_Call(c, "step", 0, None)], gets), strict=True):
                phase.extend(calls)
        self._wired: npt.NDArray[np.intp] | None = None
        self._calls = [call for phase in phases for call in phase]
        if not jacobi:  # all calls of a component after each other
            self._calls.sort(key=lambda call: call.component)
        self._rated = [(c, s) for c, s in enumerate(slaves.values()) if isinstance(s, MultiRate)]
        self._clocks = np.array([[1, 1, 0, 0, 0]] * len(slaves), dtype=np.int64)
        for c, slave in self._rated:
            self._clocks[c, [compiled.RATE, compiled.EVERY]] = slave.rate, slave.every
        self._operations = np.zeros((len(self._calls), 9), np.int64)
        self._places = np.zeros(sum(len(call.places) for call in self._calls), np.int64)
        first = 0
        for o, call in enumerate(self._calls):
            self._operations[o, compiled.FIRST] = first
            first += len(call.places)

    def advance(self, steps: float, start: int, step: int, done: int, watched: int, gather: Gather) -> Chunk:
        """Make up to `steps` steps, no more than the pace allows: `start`, `step` [ticks] and `done` [steps] as the master counts them.

        The output `watched` (-1 = none) ends the chunk when it is not zero. `gather` says where the inputs of each component stand.
        """
        self._prepare(gather)
        self._ticks[:] = start, step, done
        self._clocks[:, compiled.EACH] = step * self._clocks[:, compiled.EVERY] // self._clocks[:, compiled.RATE]
        for c, slave in self._rated:
            self._clocks[c, [compiled.COUNT, compiled.BEGAN]] = slave.count, round(slave.began * TICK)
        self._columns.reverse()
        columns = self._columns[0]
        made = compiled.advance(
            int(min(steps, self._steps)),
            self._ticks,
            bool(self._rated),
            self._wiring.any_delayed,
            watched,
            self._operations,
            self._clocks,
            self._places,
            self._bus,
            *self._bounds,
            columns,
            self._report,
        )
        names = list(self._slaves)
        for c, slave in self._rated:  # what they keep themselves in Python: a checkpoint asks them for it
            count, began = int(self._clocks[c, compiled.COUNT]), int(self._clocks[c, compiled.BEGAN]) / TICK
            slave.take_over(count, began, self._bus[self._wiring.output_slice[names[c]]])
        outcome, operation, status = (int(x) for x in self._report)
        failed = None
        if outcome == compiled.FAILED:
            call = self._calls[operation]
            t = (start + (done + made) * step) / TICK
            failed = names[call.component], self._natives[call.component].failed(call.phase, call.number, status, t, step / TICK)
        return Chunk(made, columns, failed, outcome != compiled.VIOLATED)

    def pace(self, elapsed: float) -> None:
        """Longer or shorter chunks from now on: the last one, with all that belongs to it, took `elapsed` s of wall clock."""
        if elapsed > 2.0 * _CHUNK_TIME:
            self._steps = max(self._steps // 2, 1)
        elif elapsed < _CHUNK_TIME:
            self._steps = min(2 * self._steps, self.capacity)

    def _prepare(self, gather: Gather) -> None:
        """Write the table of operations, at first and when an override has moved inputs since the last chunk."""
        names = list(self._slaves)
        wired = np.concatenate([gather[name] for name in names])
        if self._wired is not None and np.array_equal(wired, self._wired):
            return
        self._wired = wired
        for o, call in enumerate(self._calls):
            native = self._natives[call.component]
            row = self._operations[o]
            row[[compiled.INSTANCE, compiled.LIMIT, compiled.COMPONENT]] = native.instance, native.limit, call.component
            if call.block is None:
                row[[compiled.OPERATION, compiled.FUNCTION]] = compiled.STEP, native.step
                continue
            block, name, first = call.block, names[call.component], int(row[compiled.FIRST])
            own = np.array(call.places, dtype=np.int64)
            places = gather[name][own] if call.phase == "inputs" else self._wiring.output_slice[name].start + own
            self._places[first : first + len(places)] = places
            # reals that stand on the bus in the order of the block are read from (written to) there
            direct = block.kind == "float64" and block.function != 0 and len(places) > 0 and bool(np.all(np.diff(places) == 1))
            through = (compiled.SET if call.phase == "inputs" else compiled.GET) + compiled.KINDS.index(block.kind)
            row[compiled.OPERATION] = compiled.CALL if direct else through
            row[compiled.BUFFER] = self._bus.ctypes.data + 8 * int(places[0]) if direct else block.buffer
            row[[compiled.FUNCTION, compiled.REFERENCES, compiled.N]] = block.function, block.references, len(places)


@dataclass(frozen=True)
class _Call:
    """One call of one component in each step."""

    component: int
    phase: str
    number: int
    block: Block | None

    @property
    def places(self) -> tuple[int, ...]:
        """Positions of the elements among the inputs or outputs of the component."""
        return tuple(self.block.places) if self.block is not None else ()


def _native(slave: Slave) -> Native:
    found = native_of(slave)
    if found is None:
        raise TypeError(f"component {slave.name!r} can only be called from Python")
    return found
