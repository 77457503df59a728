"""Processes that share the jobs of a call, or none."""

from __future__ import annotations

import os
import time

import pytest

from calib.cli.executor import executor_of
from calib.errors import CalibError


@pytest.mark.parametrize(
    ("workers", "count", "default"),
    [(None, None, None), (1, 5, None), (4, 1, None), (None, 10, 1)],
)
def test_one_job_or_one_worker_needs_no_processes(workers, count, default):
    with executor_of(workers, None, count, default=default) as executor:
        assert executor is None


def test_jobs_run_in_other_processes():
    with executor_of(2, None, 2) as executor:
        assert executor is not None
        assert executor.submit(os.getpid).result() != os.getpid()


def test_workers_and_dask_exclude_each_other():
    with pytest.raises(CalibError, match="--dask"), executor_of(2, "tcp://127.0.0.1:1", 3):
        pass


def test_a_block_that_fails_does_not_wait_for_its_jobs():
    def fail() -> None:
        with executor_of(2, None, 2) as executor:
            assert executor is not None
            executor.submit(os.getpid).result()  # the workers run
            executor.submit(time.sleep, 60.0)
            raise KeyboardInterrupt

    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        fail()
    assert time.monotonic() - begin < 20.0
