"""Many independent jobs: on the cores of this machine, or on a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import Any

from robomill.orchestration.cluster import as_they_finish, connect

Job = tuple[Any, ...]
"""Arguments of one call."""
Progress = Callable[[str, int, int], object]
"""(what, done, total)."""
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def work(
    function: Callable[..., Any], jobs: Sequence[Job], workers: int | None = None, scheduler: str | None = None
) -> Iterator[tuple[int, Any]]:
    """Call `function` with the arguments of every job; yields (number of the job, what it returned) as they finish.

    `workers` processes (None: as many as there are cores; 1: in this process), each with one thread for linear algebra; or with a
    `scheduler` (tcp://host:port) the workers of that Dask cluster, which must see the same files. The function must be importable.
    Where the caller stops or a job raises, jobs that have not begun are dropped. ValueError for a bad number or address of a scheduler.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"--jobs {workers}: expected at least 1")
    if scheduler is not None:
        yield from _dask(function, jobs, scheduler)
        return
    count = min(workers or cores(), max(len(jobs), 1))
    if count == 1:
        for i, job in enumerate(jobs):
            yield i, function(*job)
        return
    with _one_thread_each():
        pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"))
        try:
            futures: dict[Future[Any], int] = {pool.submit(function, *job): i for i, job in enumerate(jobs)}
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes that start meanwhile take over one thread for linear algebra."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _dask(function: Callable[..., Any], jobs: Sequence[Job], scheduler: str) -> Iterator[tuple[int, Any]]:
    with connect(scheduler) as client:
        numbers = {client.submit(function, *job, pure=False): i for i, job in enumerate(jobs)}
        try:
            for future in as_they_finish(list(numbers)):
                yield numbers[future], future.result()
        finally:
            client.cancel([f for f in numbers if not f.done()])
