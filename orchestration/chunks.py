"""The compiled master: the same steps, the same order, the same numbers as the loop in Python, without Python's time.

Everything is laid out in flat tables: per component an instance and the address of its step function, per block of
variables the address of a set or get function and where its elements stand on the bus. `compiled.advance` walks through
them for a chunk of steps, checks the guards after each and writes the rows for the recorder. Between chunks
Python looks at Ctrl-C, progress and checkpoints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orchestration import compiled
from orchestration.native import Block, Native, native_of
from orchestration.rate import MultiRate
from orchestration.slave import FloatArray, Slave
from orchestration.system import TICK
from orchestration.wiring import Wiring

Gather = Mapping[str, npt.NDArray[np.intp]]
_PHASES = ("inputs", "step", "outputs")


@dataclass(frozen=True)
class Chunk:
    """What became of a chunk of steps."""

    rows: FloatArray
    """t [s] and all outputs after each step made; a view, valid until the next chunk."""
    failed: tuple[str, Exception] | None = None
    """Component and its error, in the step after those made."""
    in_range: bool = True
    """False: in the step after those made an output is not finite or out of its range."""


class CompiledLoop:
    """Steps the slaves of a master on its bus. They have made their first step in Python, which leaves initialisation.

    `bounds` of all outputs; `capacity` rows per chunk.
    """

    def __init__(
        self,
        slaves: Mapping[str, Slave],
        wiring: Wiring,
        jacobi: bool,
        bus: FloatArray,
        bounds: tuple[FloatArray, FloatArray],
        capacity: int,
    ) -> None:
        self._slaves, self._wiring, self._jacobi, self._bus, self._bounds = slaves, wiring, jacobi, bus, bounds
        self._natives = [_native(slave) for slave in slaves.values()]
        self._rows = np.zeros((capacity, 1 + wiring.n_outputs))
        self.capacity = capacity
        self._report, self._ticks = np.zeros(5, np.int64), np.zeros(3, np.int64)
        self._inputs: list[tuple[int, str, Block]] = []
        blocks: list[list[int]] = []
        places: list[int] = []
        parts: list[list[int]] = []
        for (name, slave), native in zip(slaves.items(), self._natives, strict=True):
            rate, every = (slave.rate, slave.every) if isinstance(slave, MultiRate) else (1, 1)
            bounds_of = [len(blocks)]
            for block in native.inputs:
                self._inputs.append((len(blocks), name, block))
                blocks.append(_row(block, len(places)))
                places += [0] * len(block.places)  # known when a chunk begins: overrides move them
            bounds_of += [len(blocks), len(blocks)]
            for block in native.outputs:
                blocks.append(_row(block, len(places)))
                places += [wiring.output_slice[name].start + i for i in block.places]
            parts.append([native.instance, native.step, native.limit, *bounds_of, len(blocks), rate, every, 0, 0, 0])
        self._parts = np.array(parts, dtype=np.int64)
        self._blocks = np.array(blocks, dtype=np.int64).reshape(len(blocks), 7)
        self._places = np.array(places, dtype=np.int64)
        self._buffers = self._blocks[:, compiled.BUFFER].copy()
        for b in range(len(blocks)):
            self._take_direct_path(b)

    def advance(self, steps: int, start: int, step: int, done: int, watched: int, gather: Gather) -> Chunk:
        """Make up to `steps` steps, no more than there is room for: `start`, `step` [ticks] and `done` [steps] as the master counts them.

        The output `watched` (-1 = none) ends the chunk when it is not zero. `gather` says where the inputs of each component stand.
        """
        self._prepare(gather)
        self._ticks[:] = start, step, done
        self._parts[:, compiled.EACH] = step * self._parts[:, compiled.EVERY] // self._parts[:, compiled.RATE]
        made = compiled.advance(
            min(steps, len(self._rows)),
            self._ticks,
            self._jacobi,
            self._wiring.any_delayed,
            watched,
            self._parts,
            self._blocks,
            self._places,
            self._bus,
            *self._bounds,
            self._rows,
            self._report,
        )
        self._hand_back()
        outcome, c, phase, number, status = (int(x) for x in self._report)
        failed = None
        if outcome == compiled.FAILED:
            t = (start + (done + made) * step) / TICK
            failed = list(self._slaves)[c], self._natives[c].failed(_PHASES[phase], number, status, t, step / TICK)
        return Chunk(self._rows[:made], failed, outcome != compiled.VIOLATED)

    def _prepare(self, gather: Gather) -> None:
        for b, name, block in self._inputs:
            first = self._blocks[b, compiled.FIRST]
            self._places[first : first + len(block.places)] = gather[name][list(block.places)]
            self._take_direct_path(b)
        for c, slave in enumerate(self._slaves.values()):
            if isinstance(slave, MultiRate):
                self._parts[c, compiled.COUNT], self._parts[c, compiled.BEGAN] = slave.count, round(slave.began * TICK)

    def _hand_back(self) -> None:
        """What slaves at another rate keep themselves in Python: a checkpoint asks them for it."""
        for c, (name, slave) in enumerate(self._slaves.items()):
            if isinstance(slave, MultiRate):
                count, began = int(self._parts[c, compiled.COUNT]), int(self._parts[c, compiled.BEGAN]) / TICK
                slave.take_over(count, began, self._bus[self._wiring.output_slice[name]])

    def _take_direct_path(self, b: int) -> None:
        """Reals that stand on the bus in the order of the block are read from (written to) there, without a copy."""
        kind, function, _, n, _, first, _ = (int(x) for x in self._blocks[b])
        places = self._places[first : first + n]
        direct = kind == 0 and function != 0 and n > 0 and bool(np.all(np.diff(places) == 1))
        self._blocks[b, compiled.DIRECT] = direct
        self._blocks[b, compiled.BUFFER] = self._bus.ctypes.data + 8 * int(places[0]) if direct else self._buffers[b]


def _row(block: Block, first: int) -> list[int]:
    return [compiled.KINDS.index(block.kind), block.function, block.references, len(block.places), block.buffer, first, 0]


def _native(slave: Slave) -> Native:
    found = native_of(slave)
    if found is None:
        raise TypeError(f"component {slave.name!r} can only be called from Python")
    return found
