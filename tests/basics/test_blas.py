from __future__ import annotations

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from calib.basics.blas import one_blas_thread


def threads() -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


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
