from __future__ import annotations

import threading

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from calib.model.kernel import one_blas_thread, over_blocks


def threads() -> set[int]:
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def several():
    """Whoever runs the tests may have said one thread."""
    with threadpool_limits(limits=2, user_api="blas"):
        if threads() != {2}:
            pytest.fail("the linear algebra of this machine cannot have two threads")
        yield


def test_one_thread_within_and_as_before_after():
    with one_blas_thread():
        assert threads() == {1}
        with one_blas_thread():
            assert threads() == {1}
        assert threads() == {1}
    assert threads() == {2}


def test_what_was_before_comes_back_after_an_error():
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        _ = 1 / 0
    assert threads() == {2}


def test_blocks_of_several_threads_end_in_any_order():
    inside, leave = threading.Event(), threading.Event()

    def first() -> None:
        with one_blas_thread():
            inside.set()
            leave.wait(10.0)

    other = threading.Thread(target=first)
    other.start()
    inside.wait(10.0)
    with one_blas_thread():
        leave.set()
        other.join()
    assert threads() == {2}


@pytest.mark.parametrize("count", [0, 1, 20, 21, 95])
def test_blocks_come_back_in_their_order(monkeypatch, count):
    monkeypatch.setattr("calib.model.kernel.BLOCK", 20)
    found = over_blocks(lambda own: (own.start, own.stop), count)
    assert [a for a, _ in found] == list(range(0, count, 20))
    assert [b for _, b in found] == [min(a + 20, count) for a, _ in found]
