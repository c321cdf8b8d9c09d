"""Where simulations run: on processes of this machine, or on the workers of a Dask cluster. Both give results in the order of the tasks."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Protocol

from robomill.orchestration.cluster import connect

Work = Callable[..., Any]
"""What is called with the arguments of a task. It is handed to each worker once, so it may hold much."""
Task = tuple[Any, ...]


class Pool(Protocol):
    """Workers that know what to do."""

    def map(self, tasks: Sequence[Task]) -> Iterator[Any]:
        """Results in the order of the tasks, as they come; raises what a task raises."""

    def close(self) -> None:
        """Let go of the workers; tasks that have not begun are dropped."""


def pool(work: Work, workers: int, scheduler: str | None = None) -> Pool | None:
    """On `workers` processes, or with a `scheduler` (tcp://host:port) on that cluster; None where this process does it alone.

    ValueError where no scheduler answers.
    """
    if scheduler is not None:
        return Cluster(work, scheduler)
    return Processes(work, workers) if workers > 1 else None


class Processes:
    """Processes of this machine, started at the first call."""

    def __init__(self, work: Work, workers: int) -> None:
        self._work, self._workers = work, workers
        self._executor: ProcessPoolExecutor | None = None

    def map(self, tasks: Sequence[Task]) -> Iterator[Any]:
        """See `Pool`. RuntimeError where a process ends by itself."""
        if len(tasks) == 1:
            yield self._work(*tasks[0])
            return
        if self._executor is None:
            # forked workers have the compiled models already; other platforms compile anew
            method = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
            self._executor = ProcessPoolExecutor(self._workers, multiprocessing.get_context(method), _enter, (self._work,))
        try:
            yield from self._executor.map(_call, tasks, chunksize=max(1, min(4, len(tasks) // (2 * self._workers))))
        except BrokenProcessPool as error:
            raise RuntimeError(
                f"one of {self._workers} processes that simulate ended by itself: a model or an FMU of the system crashes, or memory is out"
                "; with --jobs 1 the crash itself is seen"
            ) from error

    def close(self) -> None:
        """See `Pool`."""
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)


class Cluster:
    """The workers of a Dask cluster, which must see the same files. `work` is sent to each of them once."""

    def __init__(self, work: Work, scheduler: str) -> None:
        self._client = connect(scheduler)
        self._there = self._client.scatter(work, broadcast=True, hash=False)

    def map(self, tasks: Sequence[Task]) -> Iterator[Any]:
        """See `Pool`."""
        futures = [self._client.submit(_one, self._there, task, pure=False) for task in tasks]
        try:
            for future in futures:
                yield future.result()
        finally:
            self._client.cancel([f for f in futures if not f.done()])

    def close(self) -> None:
        """See `Pool`."""
        self._client.close()


def _one(work: Work, task: Task) -> Any:
    """In a worker of a cluster."""
    return work(*task)


_WORK: Work | None = None


def _enter(work: Work) -> None:
    global _WORK  # noqa: PLW0603 - a worker process has one work, given when it starts
    _WORK = work
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends its workers
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)  # forked, it would do what the parent does then


def _call(task: Task) -> Any:
    assert _WORK is not None
    return _WORK(*task)
