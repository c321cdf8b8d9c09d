"""The master: integer time, one flat bus, Jacobi or Gauss-Seidel. It knows slaves and nothing else.

What is observed (recording) and what is manipulated (an input overridden while it runs) is given
from outside, as in libcosim.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from robomill.orchestration.errors import Interrupted, IterationError, OrchestrationError, RunError, WiringError, describe, unknown
from robomill.orchestration.loop.acceleration import DEFAULT, Iteration
from robomill.orchestration.loop.guard import Guard
from robomill.orchestration.runs.checkpoint import Snapshot, alike
from robomill.orchestration.runs.disk import zeros_on_lines
from robomill.orchestration.runs.flight import Flight, contained
from robomill.orchestration.runs.watch import leaving
from robomill.orchestration.slaves import native
from robomill.orchestration.slaves.protocol import FloatArray, Slave, leave_initialisation, whole_range
from robomill.orchestration.system.definition import ALGORITHMS, LOOPS, TICK, ticks
from robomill.orchestration.system.wiring import Wiring

Progress = Callable[[int, int], object]
"""Called after each step with (steps done, steps in all)."""


if TYPE_CHECKING:
    from robomill.orchestration.loop.compiled_master import CompiledLoop
    from robomill.orchestration.loop.iteration import Iterated

STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end a run in order."""
_WORTH_LOADING = 20_000  # steps that repay loading compiled code, where nobody has loaded any
_MAX_TICKS = 2**53  # whole numbers that float64 holds exactly


class Observer(Protocol):
    """Sees every set of outputs; `end` is called exactly once after `begin`, however the run ends."""

    def begin(self, wiring: Wiring, step: float) -> None:
        """The run is about to be initialised."""
        ...

    def observe(self, t: float, outputs: FloatArray) -> None:
        """All outputs at time `t` [s], in the order of the bus. The array is reused: copy what is kept.

        An observer may also have `observe_columns(columns, count)`, called instead for many steps at once: the first `count`
        steps of float64[1 + n_outputs, capacity], t [s] and all outputs. That array, too, is reused, unless `keeps_columns` is set:
        then each is the observer's own. One with results on disk may have a `flight` (`orchestration.runs.flight`) once it has begun.
        """
        ...

    def end(self, outcome: str, message: str) -> None:
        """The run is over: `finished`, `interrupted` or `failed`, with the text of the error."""
        ...


Manipulator = Callable[["Master", float], object]
"""Called before each step with the master and the time [s]; may call `Master.override` and `Master.release`."""


Saver = Callable[["Master"], object]
"""Called between two steps, each so many steps; may call `Master.snapshot`."""


class Master:
    """Steps configured slaves in lock step.

    `slaves` by component name; `step` the communication step [s]; `algorithm` as in
    `system.ALGORITHMS` ("iterated" with settings `iteration`); `check_ranges` whether leaving a declared minimum or maximum ends the run
    (NaN and infinite values always do); `folder` is only named in messages.
    """

    def __init__(
        self,
        slaves: Mapping[str, Slave],
        wiring: Wiring,
        step: float,
        algorithm: str = "gauss-seidel",
        observers: Sequence[Observer] = (),
        manipulators: Sequence[Manipulator] = (),
        check_ranges: bool = True,
        folder: Path | None = None,
        iteration: Iteration = DEFAULT,
        loop: str = "auto",
    ) -> None:
        for what, value, allowed in (("algorithm", algorithm, ALGORITHMS), ("loop", loop, LOOPS)):
            if value not in allowed:
                raise ValueError(unknown(what, value, allowed))
        self.wiring, self.algorithm, self.folder = wiring, algorithm, folder
        self._slaves = {name: slaves[name] for name in wiring.order}
        self._observers, self._manipulators = tuple(observers), tuple(manipulators)
        self._step_ticks = ticks(step, "step")
        self._start_ticks = 0
        self._done = 0  # steps
        self._bus = wiring.start_values.copy()
        n = wiring.n_outputs
        self._fresh, self._last = self._bus[:n], self._bus[n : 2 * n]
        self._gather = {name: indices.copy() for name, indices in wiring.gather.items()}
        self._u = {name: np.zeros(len(indices)) for name, indices in wiring.gather.items()}
        self._y = {name: self._fresh[s] for name, s in wiring.output_slice.items()}
        self._guard = Guard(wiring, check_ranges)
        self._stop_signal = 0
        self._names = list(self._slaves)
        self._called = np.full(1, -1, np.int64)  # number of the component that is being called, -1: none
        self._calling = self._called.data  # quicker to write to than the array
        self._advance = self._jacobi if algorithm == "jacobi" else self._gauss_seidel
        self._plan = [(name, s, self._gather[name], self._u[name], self._y[name]) for name, s in self._slaves.items()]
        self._calls = [(i, *entry[1:]) for i, entry in enumerate(self._plan)]
        self._wanted_loop = loop
        self._compiled: CompiledLoop | None = None
        self._flight: Flight | None = None
        self._iterated: Iterated | None = None
        if algorithm == "iterated":
            from robomill.orchestration.loop.iteration import Iterated

            self._iterated = Iterated(wiring, iteration, self._plan, self._bus, self._announce)
            self._advance = self._iterated.advance

    def _announce(self, name: str) -> None:
        """A component is about to be called."""
        self._calling[0] = self._names.index(name)

    @property
    def _current(self) -> str:
        """The component that was called last, for messages; "" if none."""
        return self._names[self._calling[0]] if self._calling[0] >= 0 else ""

    @property
    def time(self) -> float:
        """Time reached [s]: t = start + k h, from whole nanoseconds."""
        return (self._start_ticks + self._done * self._step_ticks) / TICK

    @property
    def start(self) -> float:
        """Time at which the run began [s]."""
        return self._start_ticks / TICK

    @property
    def outputs(self) -> FloatArray:
        """The current outputs of all components, in the order of the bus (a view)."""
        return self._fresh

    def run(
        self,
        stop: float,
        start: float = 0.0,
        progress: Progress | None = None,
        until: str | None = None,
        resume: Snapshot | None = None,
        save: tuple[int, Saver] | None = None,
    ) -> float:
        """Initialise at `start` and step until `stop` [s] is reached or the output `until` is not zero; return the time reached.

        If `stop - start` is no multiple of the step, the last step goes beyond `stop`. `stop` may be
        inf when `until` is given. Raises RunError (component, time) or Interrupted; the observers
        have ended by then, so that all results up to there are on disk. The slaves stay open: closing them is for who opened them.
        With `resume` the run goes on from there, and observers see only what comes after it. `save` is (steps, saver): the saver
        is called after initialisation and whenever the number of steps done is a multiple.
        """
        self._start_ticks = round(start * TICK) if resume is None else resume.start_ticks
        total = self._steps(stop)
        watched = self._watched(until, stop)
        begun: list[Observer] = []
        outcome, message = "failed", ""

        def left() -> None:
            text = str(self._ended_by("exit()"))
            for o in begun:
                o.end("failed", text)
            print(text, file=sys.stderr, flush=True)

        try:
            for o in self._observers:
                o.begin(self.wiring, self._step_ticks / TICK)
                begun.append(o)
            self._follow()
            with self._interruptible(), leaving(left):
                self.initialise(start, stop, resume is None)
                if resume is not None:
                    self.restore(resume)
                self._loop(total, progress, watched, save)
            outcome = "finished"
        except KeyboardInterrupt:
            stopped = Interrupted(self.time, self.folder, self._stop_signal or signal.SIGINT)
            outcome, message = "interrupted", f"interrupted by {stopped.word} at t = {self.time:.9g} s"
            raise stopped from None
        except SystemExit as error:
            if not self._current:
                raise
            failure = self._ended_by(f"sys.exit({error.code!r})")
            message = str(failure)
            raise failure from error
        except BaseException as error:
            message = str(error)
            raise
        finally:
            for o in begun:
                o.end(outcome, message)
        return self.time

    def _follow(self) -> None:
        """Tell the flight recorder of a run, if an observer has one, which component is being called."""
        self._flight = next((o.flight for o in self._observers if hasattr(o, "flight")), None)
        if self._flight is not None:
            self._called = self._flight.call
            self._calling = self._called.data

    def _ended_by(self, call: str) -> RunError:
        """The error of a component that was about to end the process."""
        name, t = self._current, self.time if self._compiled is None else self._compiled.reached(self.time)
        text = f"component {name!r} called {call} after t = {t:.9g} s, which ends the process; {contained(name)}"
        return RunError(text, name, t, self.folder)

    def initialise(self, start: float, stop: float, observed: bool = True) -> None:
        """Initialise all slaves and leave initialisation; observers see the outputs at the start if `observed`.

        In the order of execution: each takes the inputs that are known, leaves initialisation, and only then are its outputs read:
        many FMUs compute them no earlier. So those behind it begin from what it says at the start, too.
        """
        self._done, self._start_ticks = 0, round(start * TICK)
        self._bus[:] = self.wiring.start_values
        try:
            for name, slave in self._slaves.items():
                self._announce(name)
                slave.initialise(start, stop, self._step_ticks / TICK)
            if self._iterated is not None:
                self._iterated.initialise()
            for name, slave, _, u, y in self._plan if self._iterated is None else ():
                self._announce(name)
                if len(u):
                    np.take(self._bus, self.wiring.gather_first[name], out=u, mode="clip")
                    slave.set_inputs(u)
                leave_initialisation(slave)
                slave.get_outputs(y)
        except Exception as error:
            if self._guard.unfit(self._fresh):
                raise self._violation(self.time) from error
            raise self._failure(error, "during initialisation", None) from error
        if not self._guard.ok(self._fresh):
            raise self._violation(self.time)
        for o in self._observers if observed else ():
            o.observe(self.time, self._fresh)

    def snapshot(self) -> Snapshot:
        """Everything that `restore` goes on from, between two steps. Whatever an algorithm keeps from step to step must be in it."""
        states = {}
        for name, slave in self._slaves.items():
            self._announce(name)
            try:
                states[name] = slave.get_state()
            except Exception as error:
                raise self._failure(error, f"saving its state at t = {self.time:.9g} s", None) from error
        gather = {name: indices.copy() for name, indices in self._gather.items()}
        return Snapshot(self._done, self._start_ticks, self._step_ticks, self._bus.copy(), gather, states)

    def restore(self, saved: Snapshot) -> None:
        """Go on from a snapshot of the same system, also of another process; the slaves have just been initialised."""
        if (saved.step_ticks, saved.bus.shape, list(saved.states)) != (self._step_ticks, self._bus.shape, list(self._slaves)):
            raise OrchestrationError(
                "the checkpoint is of another system: another step, or other components or ports; run it anew without resuming"
            )
        for name, slave in self._slaves.items():
            self._announce(name)
            try:
                slave.set_state(alike(slave.get_state(), saved.states[name]))
            except Exception as error:
                raise self._failure(error, f"going back to its state at t = {saved.time:.9g} s", None) from error
            self._gather[name][:] = saved.gather[name]
        self._done, self._start_ticks = saved.done, saved.start_ticks
        self._bus[:] = saved.bus

    def step(self) -> None:
        """One communication step of all slaves; then the guards and the observers."""
        t = self.time
        for manipulate in self._manipulators:
            manipulate(self, t)
        try:
            self._advance(t, self._step_ticks / TICK)
        except Exception as error:
            raise self._failed_step(error, f"in the step from t = {t:.9g} s") from error
        if not self._guard.ok(self._fresh):
            raise self._violation((self._start_ticks + (self._done + 1) * self._step_ticks) / TICK)
        self._calling[0] = -1
        self._done += 1
        t = self.time
        for o in self._observers:
            o.observe(t, self._fresh)

    def _jacobi(self, t: float, h: float) -> None:
        """All inputs from the last outputs; then all step; then all outputs."""
        bus = self._bus
        calling = self._calling
        for i, slave, gather, u, _ in self._calls:
            if len(u):
                calling[0] = i
                bus.take(gather, out=u, mode="clip")
                slave.set_inputs(u)
        for i, slave, _, _, _ in self._calls:
            calling[0] = i
            slave.step(t, h)
        for i, slave, _, _, y in self._calls:
            calling[0] = i
            slave.get_outputs(y)

    def _gauss_seidel(self, t: float, h: float) -> None:
        """In order, each with the fresh outputs of those before it."""
        bus = self._bus
        if self.wiring.any_delayed:
            self._last[:] = self._fresh
        calling = self._calling
        for i, slave, gather, u, y in self._calls:
            calling[0] = i
            if len(u):
                bus.take(gather, out=u, mode="clip")
                slave.set_inputs(u)
            slave.step(t, h)
            slave.get_outputs(y)

    def _loop(self, total: float, progress: Progress | None, watched: int | None, save: tuple[int, Saver] | None = None) -> None:
        in_all = int(total) if math.isfinite(total) else 0
        # each component makes its first step in Python: what it tells of itself is asked for after that
        compiled_from = self._done + max(getattr(s, "every", 1) for s in self._slaves.values()) if self._is_compiled(total) else math.inf
        while self._done < total and not (watched is not None and self._fresh[watched] != 0.0):
            if self._stop_signal:
                raise KeyboardInterrupt
            if save is not None and self._done % save[0] == 0:
                save[1](self)
            if self._done >= compiled_from and (self._iterated is None or self._iterated.proved):
                self._chunk(min(total - self._done, save[0] - self._done % save[0] if save is not None else math.inf), watched)
            else:
                self.step()
            if progress is not None:
                progress(self._done, in_all)

    def _is_compiled(self, total: float) -> bool:
        """Whether the loop is to be the compiled one; OrchestrationError if it must be and cannot."""
        if self._wanted_loop == "python":
            return False
        obstacle = native.obstacle(self._slaves)
        if self._iterated is not None and obstacle is None:
            obstacle = self._iterated.obstacle()
        if self._manipulators:
            obstacle = "manipulators are called before each step"
        elif math.isfinite(total) and self._start_ticks + total * self._step_ticks > _MAX_TICKS:
            obstacle = "its times are too large to be counted exactly"
        if obstacle is not None and self._wanted_loop == "compiled":
            raise OrchestrationError(f"loop = 'compiled' is not possible: {obstacle}; use loop = 'auto' or 'python'")
        worth_it = self._wanted_loop == "compiled" or "llvmlite" in sys.modules or _WORTH_LOADING <= total < math.inf
        return obstacle is None and worth_it

    def _chunk(self, room: float, watched: int | None) -> None:
        """Many steps by compiled code, at most `room`; then the observers."""
        began = time.perf_counter()
        if self._compiled is None:
            from robomill.orchestration.loop.compiled_master import CompiledLoop  # a run of a few steps does without

            jacobi, settings = self.algorithm == "jacobi", None if self._iterated is None else self._iterated.settings
            self._compiled = CompiledLoop(
                self._slaves, self.wiring, jacobi, self._bus, self._guard.bounds, bool(self._observers),
                any(getattr(o, "keeps_columns", False) for o in self._observers), iteration=settings, called=self._called,
                columns=zeros_on_lines if self._flight is None else self._flight.columns,
            )  # fmt: skip
        k = -1 if watched is None else watched
        chunk = self._compiled.advance(room, self._start_ticks, self._step_ticks, self._done, k, self._gather)
        self._calling[0] = -1
        self._done += chunk.made
        chunk.show(self._observers)
        if chunk.failed is not None:
            name, error = chunk.failed
            self._announce(name)
            raise self._failed_step(error, f"in the step from t = {self.time:.9g} s") from error
        if not chunk.in_range:
            raise self._violation((self._start_ticks + (self._done + 1) * self._step_ticks) / TICK)
        self._compiled.pace(time.perf_counter() - began)

    def override(self, name: str, value: float) -> None:
        """Give the input `component.port` a value from now on, instead of what it is connected to.

        WiringError for an input that is not there, or a whole number that it cannot hold.
        """
        component, position, slot = self._input(name)
        port = self.wiring.inputs[slot - 2 * self.wiring.n_outputs][1]
        if port.type == "integer":
            low, high = whole_range(port)
            if not (low <= value <= high and value == int(value)):
                raise WiringError([f"override of {name}: {value!r} is no whole number from {low} to {high}"])
        self._bus[slot] = value
        self._gather[component][position] = slot

    def release(self, name: str) -> None:
        """End an override: connected inputs follow their source again, open ones have their start value."""
        component, position, slot = self._input(name)
        self._bus[slot] = self.wiring.start_values[slot]
        self._gather[component][position] = self.wiring.gather[component][position]

    def _input(self, name: str) -> tuple[str, int, int]:
        names = [f"{c}.{p.name}" for c, p in self.wiring.inputs]
        if name not in names:
            raise WiringError([unknown("input", name, names)])
        index = names.index(name)
        component = self.wiring.inputs[index][0]
        position = index - next(i for i, (c, _) in enumerate(self.wiring.inputs) if c == component)
        return component, position, 2 * self.wiring.n_outputs + index

    def _steps(self, stop: float) -> float:
        if math.isinf(stop) and stop > 0:
            return math.inf
        span = round(stop * TICK) - self._start_ticks
        if not span >= 0:
            raise OrchestrationError(
                f"the run stops at {stop:.9g} s, before it starts at {self._start_ticks / TICK:.9g} s; give a later stop"
            )
        return -(-span // self._step_ticks)

    def _watched(self, until: str | None, stop: float) -> int | None:
        if until is None:
            if math.isinf(stop):
                raise OrchestrationError("the run has no end: give a stop time, or an output that ends it (stop_when)")
            return None
        names = self.wiring.column_names()
        if until not in names:
            raise WiringError([f"stop_when: {unknown('output', until, names)}"])
        return names.index(until)

    def _failed_step(self, error: Exception, when: str) -> RunError:
        """The error of a step: that of the slave, unless it was given a whole number that does not fit."""
        if self._guard.unfit(self._fresh):
            return self._violation((self._start_ticks + (self._done + 1) * self._step_ticks) / TICK)
        return self._failure(error, when, self._guard.problem(self._fresh))

    def _failure(self, error: Exception, when: str, cause: tuple[str, str] | None) -> RunError:
        """The one error that a run ends with when a slave raised `error`; `cause` is the guard's finding in the same step."""
        if isinstance(error, IterationError):
            return RunError(f"{when}: {error}", error.component, self.time, self.folder)
        text = f"component {self._current!r} failed {when}: {describe(error)}"
        if cause is not None:  # garbage in: the slave that failed may not be the one to look at
            text += f"\nBefore that, in the same step, component {cause[0]!r}: {cause[1]}"
        return RunError(text, self._current, self.time, self.folder)

    def _violation(self, t: float) -> RunError:
        found = self._guard.problem(self._fresh)
        name, text = found if found else ("", "")
        return RunError(f"component {name!r} at t = {t:.9g} s: {text}", name, self.time, self.folder)

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """Ctrl-C, and the signals that end a process, end the run between two steps; a second one at once.

        An exception within a step could come up inside an FMU, which would take it for its own failure.
        """
        self._stop_signal = 0
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def request(number: int, _: Any) -> None:
            if self._stop_signal:
                raise KeyboardInterrupt
            self._stop_signal = number

        before = {number: signal.getsignal(number) for number in STOPPING}
        caught = {number: old for number, old in before.items() if old not in (None, signal.SIG_IGN)}
        for number in caught:
            signal.signal(number, request)
        try:
            yield
        finally:
            for number, old in caught.items():
                signal.signal(number, old)
