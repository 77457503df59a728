from __future__ import annotations

import os
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from calib.basics.jobs import batch_size, core_count, one_blas_thread, run
from calib.errors import CalibError


def product(shared: int, item: int) -> int:
    return shared * item


def test_without_an_executor_they_run_in_order():
    assert list(run(product, 3, iter([1, 2, 4]))) == [(0, 3), (1, 6), (2, 12)]


@pytest.mark.parametrize("batch", [1, 3, 100])
def test_an_executor_gives_every_result_with_its_number(batch):
    with ThreadPoolExecutor(2) as executor:
        results = dict(run(product, 2, range(10), executor, batch=batch))
    assert results == {k: 2 * k for k in range(10)}


def test_cores_are_those_that_the_process_is_bound_to(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5}, raising=False)
    assert core_count() == 2
    monkeypatch.delattr(os, "sched_getaffinity")  # as elsewhere than on Linux
    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    assert core_count() == 7
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert core_count() == 1


class Killed(ThreadPoolExecutor):
    """An executor whose workers are killed."""

    def submit(self, *_args, **_kwargs):
        future: Future = Future()
        future.set_exception(BrokenExecutor("terminated abruptly"))
        return future


def test_a_killed_worker_is_an_error_that_says_what_to_try():
    with pytest.raises(CalibError, match=r"terminated abruptly.*fewer --workers"):
        list(run(product, 2, range(3), Killed()))


@pytest.mark.parametrize(("count", "largest", "size"), [(3, 50, 1), (240, 50, 10), (9999, 50, 50)])
def test_batches_are_many_enough_for_all_workers(count, largest, size):
    assert batch_size(count, largest) == size


def blas_threads() -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


def test_linear_algebra_takes_one_thread_within_and_as_many_as_before_after():
    # Whoever runs the tests may have said one thread.
    with threadpool_limits(limits=2, user_api="blas"):
        if blas_threads() != {2}:
            pytest.fail("the linear algebra of this machine cannot have two threads")
        with one_blas_thread():
            assert blas_threads() == {1}
            with one_blas_thread():
                assert blas_threads() == {1}
            assert blas_threads() == {1}
        assert blas_threads() == {2}
