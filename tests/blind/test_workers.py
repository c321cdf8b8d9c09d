"""Jobs on several processes and on a Dask cluster."""

from __future__ import annotations

import os

import pytest

from robomill.blind.workers import cores, work


def double(x):
    return 2 * x


def threads(_):
    return os.environ["OPENBLAS_NUM_THREADS"], os.getpid()


def fail(x):
    raise RuntimeError(f"job {x}")


def fail_at_3(x):
    return fail(x) if x == 3 else x


def test_in_this_process_jobs_come_in_their_order():
    assert list(work(double, [(1,), (2,), (3,)], 1)) == [(0, 2), (1, 4), (2, 6)]
    assert list(work(double, [], 2)) == []


def test_processes_have_one_thread_each_and_the_environment_is_as_before():
    before = dict(os.environ)
    results = dict(work(threads, [(i,) for i in range(4)], 2))
    assert {t for t, _ in results.values()} == {"1"}
    assert os.getpid() not in {pid for _, pid in results.values()}
    assert dict(os.environ) == before


def test_an_error_ends_it_and_is_that_of_the_job():
    with pytest.raises(RuntimeError, match="job 3"):
        list(work(fail_at_3, [(1,), (2,), (3,), (4,)], 2))


def test_a_number_of_processes_below_one_is_refused():
    with pytest.raises(ValueError, match="--jobs 0: expected at least 1"):
        list(work(double, [(1,)], 0))
    assert cores() >= 1


@pytest.mark.slow
def test_the_workers_of_a_dask_cluster_do_the_jobs():
    distributed = pytest.importorskip("distributed", reason="Dask is not installed (robomill[cluster])")
    with distributed.LocalCluster(1, processes=False, threads_per_worker=1, protocol="tcp://", dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tcp://")
        assert dict(work(double, [(1,), (2,), (3,)], scheduler=address)) == {0: 2, 1: 4, 2: 6}
        with pytest.raises(RuntimeError, match="job 5"):
            list(work(fail, [(5,)], scheduler=address))


@pytest.mark.slow
def test_no_scheduler_there_says_what_an_address_looks_like():
    pytest.importorskip("distributed", reason="Dask is not installed (robomill[cluster])")
    with pytest.raises(ValueError, match=r"no Dask scheduler there .* expected an address such as tcp://host:8786"):
        list(work(double, [(1,)], scheduler="tcp://127.0.0.1:9"))
