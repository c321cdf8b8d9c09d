"""Simulations on processes and on a cluster: the same results, in the order of the tasks."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest

from robomill.diagnosis.engine import diagnose
from robomill.diagnosis.experiment.pool import Cluster, Processes, pool
from robomill.orchestration.errors import RunError
from tests.diagnosis.demo import SYSTEM, catalogue, measure, resolve

STIFF = {"masses": {"stiffness_error[2]": -0.08}}


def late(seconds: float, value: int) -> int:
    """The value doubled, after some time."""
    time.sleep(seconds)
    return 2 * value


def refused(value: int) -> int:
    raise RuntimeError(f"task {value}")


def ended(value: int) -> int:
    """As a model that crashes."""
    os._exit(value)


def diverged(value: int) -> int:
    raise RunError(f"task {value}", "plant", 0.5)


TASKS = [(0.2, 1), (0.0, 2), (0.1, 3)]


def cluster() -> Any:
    """One worker in this process, which is reached over the network."""
    distributed = pytest.importorskip("distributed", reason="Dask is not installed (robomill[cluster])")
    return distributed.LocalCluster(1, processes=False, threads_per_worker=1, protocol="tcp://", dashboard_address=None)


def test_one_process_alone_needs_no_pool() -> None:
    assert pool(late, 1) is None


def test_results_of_processes_come_in_the_order_of_the_tasks() -> None:
    found = pool(late, 2)
    assert isinstance(found, Processes)
    try:
        assert list(found.map(TASKS)) == [2, 4, 6]
        assert list(found.map(TASKS[:1])) == [2]
    finally:
        found.close()


@pytest.mark.parametrize(
    ("work", "expected", "text"),
    [(diverged, RunError, "task 1"), (ended, RuntimeError, "one of 2 processes that simulate ended by itself.*; with --jobs 1")],
)
def test_an_error_is_that_of_the_task_and_a_process_that_ends_is_said(work: Any, expected: type[Exception], text: str) -> None:
    found = Processes(work, 2)
    try:
        with pytest.raises(expected, match=text):
            list(found.map([(1,), (2,), (3,)]))
    finally:
        found.close()


@pytest.mark.slow
def test_so_do_those_of_a_cluster_and_an_error_is_that_of_the_task() -> None:
    with cluster() as there:
        found = pool(late, 2, there.scheduler_address)
        assert isinstance(found, Cluster)
        assert list(found.map(TASKS)) == [2, 4, 6]
        found.close()
        bad = Cluster(refused, there.scheduler_address)
        with pytest.raises(RuntimeError, match="task 5"):
            list(bad.map([(5,)]))
        bad.close()


@pytest.mark.slow
def test_a_cluster_changes_nothing_in_a_diagnosis(tmp_path: Path) -> None:
    runs = measure(STIFF)
    with cluster() as there:
        found = [
            diagnose(SYSTEM, runs, catalogue(tmp_path), resolver=resolve, scheduler=address).result
            for address in (None, there.scheduler_address)
        ]
    one, other = (r["effort"].pop("simulations") for r in found)
    assert one == other > 0
    for r in found:
        r["effort"] = None
    assert found[0] == found[1]


@pytest.mark.slow
def test_no_scheduler_there_says_what_an_address_looks_like(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="Dask is not installed (robomill[cluster])")
    with pytest.raises(ValueError, match=r"--scheduler tcp://127.0.0.1:9: no Dask scheduler there .* such as tcp://host:8786"):
        diagnose(SYSTEM, measure(STIFF), catalogue(tmp_path), resolver=resolve, scheduler="tcp://127.0.0.1:9")
