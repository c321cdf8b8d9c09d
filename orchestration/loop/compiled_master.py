"""The compiled master: the same steps, the same order, the same numbers as the loop in Python, without Python's time.

Everything is laid out in one table of operations, in the order in which a step makes them: the address of a set, step or
get function, what it takes, and where its values stand on the bus. `compiled.advance` walks through it for a chunk of
steps, checks the guards after each and writes the rows for the recorder. Between chunks Python looks at Ctrl-C,
progress and checkpoints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.orchestration.errors import SlaveError
from robomill.orchestration.loop import loop_code, operations
from robomill.orchestration.loop.acceleration import Iteration, Work
from robomill.orchestration.loop.iteration import unconverged, unsaved
from robomill.orchestration.runs.disk import zeros_on_lines
from robomill.orchestration.slaves.callbacks import face_of, rollback_of
from robomill.orchestration.slaves.multirate import MultiRate
from robomill.orchestration.slaves.native import Block, native_of
from robomill.orchestration.slaves.protocol import FloatArray, Slave
from robomill.orchestration.system.definition import TICK
from robomill.orchestration.system.wiring import Wiring

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
    """t [s] and all outputs after each of them, float64[1 + n_outputs, capacity], until the next chunk, unless it is kept."""
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

    `bounds` of all outputs; `observed`: whether rows are wanted; `kept`: whether an observer keeps the array that it is shown, so that
    each chunk needs one of its own; about `capacity` steps per chunk at most. The number of the component that is being called stands
    in `called`, int64[1]; `columns` makes the array of the rows.
    """

    def __init__(
        self,
        slaves: Mapping[str, Slave],
        wiring: Wiring,
        jacobi: bool,
        bus: FloatArray,
        bounds: tuple[FloatArray, FloatArray],
        observed: bool = True,
        kept: bool = False,
        capacity: int | None = None,
        iteration: Iteration | None = None,
        called: npt.NDArray[np.int64] | None = None,
        columns: Callable[[int, int], FloatArray] = zeros_on_lines,
    ) -> None:
        self._called = np.zeros(1, np.int64) if called is None else called
        self._new_columns = zeros_on_lines if kept else columns
        self._slaves, self._wiring, self._bus, self._bounds = slaves, wiring, bus, bounds
        self._natives = [face_of(slave) for slave in slaves.values()]
        capacity = capacity or (min(max(_ROW_BYTES // (8 + 8 * wiring.n_outputs), 16), _MOST_STEPS) if observed else _MOST_STEPS)
        # a full chunk is all of the array, which the recorder writes as it stands
        self.capacity, self._steps, self._slow = _length(capacity) if observed else capacity, _FIRST_CHUNK, False
        self._width, self._kept = 1 + wiring.n_outputs if observed else 0, kept
        self._columns: FloatArray | None = None
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
        # who is called back in Python counts there, too
        self._rated = [(c, s) for c, s in enumerate(slaves.values()) if isinstance(s, MultiRate) and native_of(s) is not None]
        self._clocks = np.array([[1, 1, 0, 0, 0]] * len(slaves), dtype=np.int64)
        for c, slave in self._rated:
            self._clocks[c, [operations.RATE, operations.EVERY]] = slave.rate, slave.every
        self._operations = np.zeros((len(self._calls), 9), np.int64)
        self._places = np.zeros(sum(len(call.places) for call in self._calls), np.int64)
        first = 0
        for o, call in enumerate(self._calls):
            self._operations[o, operations.FIRST] = first
            first += len(call.places)
        self._loops = None if iteration is None else Loops(slaves, wiring, iteration, [call.component for call in self._calls])

    def advance(self, steps: float, start: int, step: int, done: int, watched: int, gather: Gather) -> Chunk:
        """Make up to `steps` steps, no more than the pace allows: `start`, `step` [ticks] and `done` [steps] as the master counts them.

        The output `watched` (-1 = none) ends the chunk when it is not zero. `gather` says where the inputs of each component stand.
        """
        self._prepare(gather)
        self._ticks[:] = start, step, done
        self._clocks[:, operations.EACH] = step * self._clocks[:, operations.EVERY] // self._clocks[:, operations.RATE]
        for c, slave in self._rated:
            self._clocks[c, [operations.COUNT, operations.BEGAN]] = slave.count, round(slave.began * TICK)
        most, rates = int(min(steps, self._steps)), bool(self._rated)
        if self._columns is None or self._kept:
            self._columns = self._new_columns(self._width, _length(most if self._kept else self.capacity))
        tables = self._operations, self._clocks, self._places, self._bus, *self._bounds, self._columns, self._report, self._called
        if self._loops is None:
            made = loop_code.advance(most, self._ticks, rates, self._wiring.any_delayed, watched, *tables)
        else:
            made = self._loops.advance(most, self._ticks, rates, watched, *tables)
        names = list(self._slaves)
        for c, slave in self._rated:  # what they keep themselves in Python: a checkpoint asks them for it
            count, began = int(self._clocks[c, operations.COUNT]), int(self._clocks[c, operations.BEGAN]) / TICK
            slave.take_over(count, began, self._bus[self._wiring.output_slice[names[c]]])
        outcome, operation, status = (int(x) for x in self._report)
        failed = None
        if outcome == operations.FAILED:
            call = self._calls[operation]
            t = (start + (done + made) * step) / TICK
            if status == operations.UNFIT:
                error: Exception = SlaveError(f"a whole number does not fit an input of type {call.block.kind if call.block else ''}")
            else:
                error = self._natives[call.component].failed(call.phase, call.number, status, t, step / TICK)
            failed = names[call.component], error
        elif self._loops is not None:
            failed = self._loops.failed(outcome, operation, status)
        return Chunk(made, self._columns, failed, outcome != operations.VIOLATED)

    def reached(self, t: float) -> float:
        """Time of the last row in the middle of a chunk that began at `t` [s]."""
        times = self._columns[:1] if self._columns is not None else np.zeros(0)
        return float(np.nanmax(times, initial=t))

    def pace(self, elapsed: float) -> None:
        """Longer or shorter chunks from now on: the last one, with all that belongs to it, took `elapsed` s of wall clock.

        Shorter only after two in a row that took too long: one may have loaded compiled code, or waited for the disk.
        """
        again, self._slow = self._slow, elapsed > 2.0 * _CHUNK_TIME
        if self._slow and again:
            self._steps = max(self._steps // 2, 1)
        elif elapsed < 0.5 * _CHUNK_TIME:
            self._steps = min(4 * self._steps, self.capacity)

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
            row[[operations.INSTANCE, operations.LIMIT, operations.COMPONENT]] = native.instance, native.limit, call.component
            if call.block is None:
                row[[operations.OPERATION, operations.FUNCTION, operations.N]] = operations.STEP, native.step, native.final
                continue
            block, name, first = call.block, names[call.component], int(row[operations.FIRST])
            own = np.array(call.places, dtype=np.int64)
            places = gather[name][own] if call.phase == "inputs" else self._wiring.output_slice[name].start + own
            if call.phase == "inputs" and self._loops is not None:
                places = places + operations.MEAN * self._loops.holds_mean(name, gather[name])[own]
            self._places[first : first + len(places)] = places
            # reals that stand on the bus in the order of the block are read from (written to) there
            plain = block.kind == "float64" and block.references != 0 and places.max(initial=-1) < operations.MEAN
            direct = plain and len(places) > 0 and bool(np.all(np.diff(places) == 1))
            through = (operations.SET if call.phase == "inputs" else operations.GET) + operations.KINDS.index(block.kind)
            row[operations.OPERATION] = operations.CALL if direct else through
            row[operations.BUFFER] = self._bus.ctypes.data + 8 * int(places[0]) if direct else block.buffer
            row[[operations.FUNCTION, operations.REFERENCES, operations.N]] = block.function, block.references, len(places)


def _length(steps: int) -> int:
    """Length of the columns of an array for so many steps: an odd number of cache lines keeps them off each other's places in the cache."""
    return 8 * (-(-steps // 8) | 1)


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


class Loops:
    """Iterated coupling for compiled code: the tables of `compiled_iteration`. `components` by operation, in their order."""

    def __init__(self, slaves: Mapping[str, Slave], wiring: Wiring, settings: Iteration, components: Sequence[int]) -> None:
        from robomill.orchestration.loop import compiled_iteration  # compiling it takes seconds where it is not kept yet

        self._kernel, self._settings = compiled_iteration, settings
        self._loop_of = {name: loop for loop in wiring.loops for name in loop.members}
        names = list(slaves)
        stages: list[list[int]] = []
        unknowns: list[tuple[int, int]] = []
        members: list[str] = []
        for name in names:
            loop = self._loop_of.get(name)
            if loop is None or name == loop.members[0]:
                group = loop.members if loop else (name,)
                chosen = [o for o, c in enumerate(components) if names[c] in group]
                first, known = len(members), len(unknowns)
                if loop is not None:
                    members += group
                    unknowns += list(zip(loop.feedback.tolist(), loop.arrays.tolist(), strict=True))
                end = chosen[-1] + 1 if chosen else 0
                stages.append([chosen[0] if chosen else 0, end, first, len(members), known, len(unknowns)])
        self._members = members
        self._rollbacks = [rollback_of(slaves[name]) for name in members]
        states = [[r.instance, r.get, r.set, r.kept, r.size, r.limit] for r in self._rollbacks]
        self._stages = np.array(stages, np.int64).reshape(-1, 6)
        self._states = np.array(states, np.int64).reshape(-1, 6)
        self._unknowns = np.array(unknowns, np.int64).reshape(-1, 2)
        self._work = Work(settings, len(unknowns))
        self._scratch, self._found = np.zeros((5, len(unknowns))), np.zeros(2)

    def holds_mean(self, name: str, gather: npt.NDArray[np.intp]) -> npt.NDArray[np.int64]:
        """By input of a component: 1 where it holds the mean over the step; not one that is overridden just now."""
        found = np.zeros(len(gather), np.int64)
        if self._settings.hold == "mean" and name in self._loop_of:
            at, sources = self._loop_of[name].inner[name]
            found[at] = gather[at] == sources
        return found

    def advance(self, steps: int, ticks: Any, rates: bool, watched: int, *tables: Any) -> int:
        """See `compiled_iteration`; returns the number of steps made."""
        s = self._settings
        numbers = self._work.method, s.max_iterations, s.unconverged == "accept", s.tolerance, s.relaxation
        keeps = self._scratch, self._work.history, self._work.factor, self._found
        return self._kernel.advance(steps, ticks, rates, watched, *tables, self._stages, self._states, self._unknowns, *numbers, *keeps)

    def failed(self, outcome: int, place: int, status: int) -> tuple[str, Exception] | None:
        """Component and its error, if the outcome is one of the iteration."""
        if outcome == operations.UNCONVERGED:
            loop = self._loop_of[self._members[self._stages[place, self._kernel.MEMBERS]]]
            return loop.members[0], unconverged(loop, self._settings, float(self._found[0]), int(self._found[1]))
        if outcome in (operations.UNSAVED, operations.STUCK):
            name, error = self._members[place], self._rollbacks[place].failed("save" if outcome == operations.UNSAVED else "back", status)
            return name, unsaved(name, self._loop_of[name], error) if outcome == operations.UNSAVED else error
        return None
