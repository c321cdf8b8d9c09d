"""Iterated coupling: the components of a loop step from the same state again and again until their signals agree.

Per macro step and loop: save the states; round: all members step in order, each with the fresh outputs of those
before it and the guess for those behind it; compare the outputs that go backwards with the guess; unless they
agree, go back to the saved states and make another round with a better guess (`acceleration`).

That stands on going back exactly. So before a member is set back for the first time, it is proved: save, step,
go back, step must give the same outputs and the same state, bit by bit. Done in the first step, and again in the
first step that needs a second round: there the signals are those of the loop at work. Who fails is refused.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.orchestration.errors import IterationError, describe
from robomill.orchestration.loop.acceleration import Iteration, Work, compare, improve
from robomill.orchestration.slaves.callbacks import rollback_of
from robomill.orchestration.slaves.native import Rollback
from robomill.orchestration.slaves.protocol import FloatArray, Slave, inputs, leave_initialisation
from robomill.orchestration.system.loops import Loop
from robomill.orchestration.system.wiring import Wiring

_AT_WORK = "first return"  # when the second proof is made
Entry = tuple[str, Slave, npt.NDArray[np.intp], FloatArray, FloatArray]
"""What the loop knows of a component: name, slave, positions of its inputs on the bus, its input and its output buffer."""


class Iterated:
    """Steps all components of a master once, those of loops until they agree.

    `plan` and `bus` are the master's own; `announce` is told the component that is about to be called.
    The numbers of rounds and the residual (the largest over the loops) go to the last two outputs of the bus.
    """

    def __init__(
        self, wiring: Wiring, settings: Iteration, plan: Sequence[Entry], bus: FloatArray, announce: Callable[[str], None]
    ) -> None:
        self.settings, self._bus, self._announce = settings, bus, announce
        n = wiring.n_outputs
        self._fresh, self._last = bus[:n], bus[n : 2 * n]
        by_name = {entry[0]: entry for entry in plan}
        started: set[str] = set()
        self._stages: list[tuple[Loop | None, list[Entry]]] = []
        for entry in plan:
            loop = next((x for x in wiring.loops if entry[0] in x.members), None)
            if entry[0] not in started:
                members = loop.members if loop else (entry[0],)
                self._stages.append((loop, [by_name[m] for m in members]))
                started.update(members)
        self._first_gather = wiring.gather_first
        self._rounds = self._residual = 0.0

    def initialise(self) -> None:
        """Outputs at the start that satisfy all connections which are not delayed; the slaves are in initialisation, and leave it.

        Nothing has to be set back here: inputs can be set any number of times. Values at the start are not means.
        """
        self._proved: dict[int, set[tuple[str, tuple[bool, ...]]]] = {}
        self._kept: dict[int, list[Rollback]] = {}
        self._begin()
        for loop, members in self._stages:

            def evaluate(members: list[Entry] = members) -> None:
                for name, slave, _, u, y in members:
                    self._announce(name)
                    if len(u):
                        self._bus.take(self._first_gather[name], out=u, mode="clip")
                        slave.set_inputs(u)
                    slave.get_outputs(y)

            if loop is not None:
                self._fresh[loop.feedback] = loop.starts
                self._solve(loop, evaluate, lambda: None, lambda: None)
            self._leave(members, evaluated=loop is not None)
        self._fresh[-2:] = self._rounds, self._residual

    def _leave(self, members: Sequence[Entry], evaluated: bool) -> None:
        """All leave initialisation in order, and their outputs at the start are read.

        Who has been `evaluated` takes its inputs anew only where leaving has changed what they come from: the others agree as they are.
        """
        before = self._bus.copy()
        for name, slave, _, u, y in members:
            self._announce(name)
            if len(u):
                gather = self._first_gather[name]
                self._bus.take(gather, out=u, mode="clip")
                if not evaluated or u.tobytes() != before[gather].tobytes():
                    slave.set_inputs(u)
            leave_initialisation(slave)
            slave.get_outputs(y)

    @property
    def proved(self) -> bool:
        """Whether the members of all loops have gone back at work, as they will again."""
        shown = {number for number, proofs in self._proved.items() if any(when == _AT_WORK for when, _ in proofs)}
        return all(loop is None or number in shown for number, (loop, _) in enumerate(self._stages))

    def obstacle(self) -> str | None:
        """Why compiled code cannot iterate these components; None if it can."""
        for loop, members in self._stages:
            if loop is None:
                continue
            for name, slave, _, _, _ in members:
                ports, every = inputs(slave.ports), getattr(slave, "every", 1)
                if every > 1:
                    return f"component {name!r} is in the loop {loop} and steps only once in {every} steps"
                for i in loop.inner[name][0]:
                    if ports[i].type != "real":
                        return f"the loop {loop} hands round a whole number: input {name}.{ports[i].name}"
        return None

    def advance(self, t: float, h: float) -> None:
        """One step of all components from `t` [s] to `t + h` [s]."""
        self._last[:] = self._fresh
        self._begin()
        for number, (loop, members) in enumerate(self._stages):
            if loop is None:
                self._round(None, members, t, h)
            else:
                self._iterate(number, loop, members, t, h)
        self._fresh[-2:] = self._rounds, self._residual

    def _begin(self) -> None:
        self._rounds = self._residual = 0.0

    def _iterate(self, number: int, loop: Loop, members: list[Entry], t: float, h: float) -> None:
        proved = self._proved.setdefault(number, set())
        if number not in self._kept:
            self._kept[number] = [rollback_of(slave) for _, slave, _, _, _ in members]
        kept = self._kept[number]
        for (name, _, _, _, _), state in zip(members, kept, strict=True):
            self._save(name, state, loop)
        guess = self._fresh[loop.feedback]
        due = tuple(getattr(slave, "due", True) for _, slave, _, _, _ in members)  # who does not step proves nothing

        def back() -> None:
            for (name, _, _, _, _), state in zip(members, kept, strict=True):
                self._announce(name)
                state.back()

        def prove(when: str) -> None:
            if (when, due) not in proved:
                proved.add((when, due))
                back()
                self._prove(loop, members, kept, t, h)
                back()
                self._fresh[loop.feedback] = guess

        prove("first step")
        self._solve(loop, lambda: self._round(loop, members, t, h), back, lambda: prove(_AT_WORK))

    def _solve(self, loop: Loop, evaluate: Callable[[], None], back: Callable[[], None], first_return: Callable[[], None]) -> None:
        """Make rounds until the unknowns of `loop` stay the same; what stands on the bus before is the first guess."""
        settings, fresh, feedback = self.settings, self._fresh, loop.feedback
        n, x = len(feedback), fresh[feedback]
        work, sizes, largest, scale = Work(settings, n), np.ones(n), np.zeros(n), np.ones(n)
        residual, worst = math.inf, 0
        for rounds in range(1, settings.max_iterations + 1):
            evaluate()
            g = fresh[feedback]
            residual, worst = compare(n, x, g, loop.arrays, largest, sizes)
            if worst < 0 or residual <= settings.tolerance:  # what is not finite the guard will name
                break
            if rounds < settings.max_iterations:
                if rounds == 1:
                    scale[:] = sizes
                    first_return()
                improve(work.method, settings.relaxation, rounds, n, x, g, scale, work.history, work.factor)
                back()
                fresh[feedback] = x
        else:
            if settings.unconverged == "error":
                raise unconverged(loop, settings, residual, worst)
        self._rounds, self._residual = max(self._rounds, float(rounds)), max(self._residual, residual)

    def _round(self, loop: Loop | None, members: Sequence[Entry], t: float, h: float) -> None:
        for entry in members:
            name, slave, _, _, y = entry
            self._announce(name)
            self._set_inputs(loop, entry)
            slave.step(t, h)
            slave.get_outputs(y)

    def _set_inputs(self, loop: Loop | None, entry: Entry) -> None:
        name, slave, gather, u, _ = entry
        if len(u):
            self._bus.take(gather, out=u, mode="clip")
            if loop is not None and self.settings.hold == "mean":
                at, sources = loop.inner[name]
                followed = gather[at] == sources  # an input that is overridden just now is no mean
                at = at[followed]
                u[at] = 0.5 * (u[at] + self._last[sources[followed]])
            slave.set_inputs(u)

    def _save(self, name: str, state: Rollback, loop: Loop) -> None:
        self._announce(name)
        try:
            state.save()
        except Exception as error:
            raise unsaved(name, loop, error) from error

    def _prove(self, loop: Loop, members: Sequence[Entry], kept: Sequence[Rollback], t: float, h: float) -> None:
        """One round in which every member steps twice from its saved state; IterationError names the one that does not repeat itself."""
        for entry, state in zip(members, kept, strict=True):
            name, slave, _, u, y = entry
            self._announce(name)
            self._set_inputs(loop, entry)
            slave.step(t, h)
            slave.get_outputs(y)
            first, reached = y.copy(), slave.get_state()
            state.back()
            slave.set_inputs(u)
            slave.step(t, h)
            slave.get_outputs(y)
            what = None
            if first.tobytes() != y.tobytes():
                what = f"other outputs (largest difference {np.max(np.abs(first - y)):.3g})"
            elif not same(reached, slave.get_state()):
                what = "the same outputs, but another state"
            if what:
                raise IterationError(
                    f"component {name!r} is in the loop {loop} and cannot go back exactly, which iterating needs: "
                    f"its step from t = {t:.9g} s, made again from the saved state, gave {what}: its saved state is incomplete\n{_REMEDY}",
                    name,
                )


_REMEDY = "Mark a connection of the loop with delayed = true, or use algorithm = 'gauss-seidel' or 'jacobi'"


def unsaved(name: str, loop: Loop, error: Exception) -> IterationError:
    """The error of a component of the loop whose state cannot be kept."""
    return IterationError(
        f"component {name!r} is in the loop {loop} and cannot save its state, which iterating needs: {describe(error)}\n{_REMEDY}", name
    )


def unconverged(loop: Loop, settings: Iteration, residual: float, worst: int) -> IterationError:
    """The error of an iteration that ended with the unknown `worst` still changing by `residual`; it says what to try."""
    others = {
        "fixed-point": "method = 'aitken' or 'anderson', or a smaller relaxation",
        "aitken": "method = 'anderson', or a smaller relaxation",
        "anderson": "a smaller relaxation, or a greater depth",
    }
    text = (
        f"the loop {loop} did not converge in {settings.max_iterations} iterations: {loop.names[worst]} still changes by {residual:.3g} "
        f"of the size of its array (tolerance {settings.tolerance:.3g}, method {settings.method!r}). "
        f"Try {others[settings.method]}, more max_iterations, a smaller step, or unconverged = 'accept'"
    )
    return IterationError(text, loop.members[0])


def same(a: Any, b: Any) -> bool:
    """Whether two saved states are equal bit by bit; what cannot be looked into (a pointer of an FMU) counts as equal."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return (
            isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
        )
    if type(a) is not type(b):
        return False
    if isinstance(a, float):
        return np.float64(a).tobytes() == np.float64(b).tobytes()
    if isinstance(a, bytes | bytearray | str | int | None):
        return bool(a == b)
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(x, b[k]) for k, x in a.items())
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    return True
