"""Processes of this machine, or a Dask cluster, that share the jobs of a call."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from calib.basics.jobs import core_count
from calib.errors import CalibError

if TYPE_CHECKING:
    from concurrent.futures import Executor


@contextmanager
def executor_of(
    workers: int | None,
    dask: str | None,
    count: int | None,
    *,
    default: int | None = None,
) -> Iterator[Executor | None]:
    """Provide an executor for the jobs of the block.

    Args:
        workers: ``--workers``; None: not given.
        dask: ``--dask``, the address of a scheduler; None: not given.
        count: Number of jobs; None: there are none.
        default: Number of processes without ``--workers``; None: one a core.

    Yields:
        The executor; None if the jobs are to run in this process, one after the other.

    Raises:
        CalibError: Both options, no Dask, or no scheduler at the address.
    """
    if count is None:
        yield None
        return
    if dask is not None and workers is not None:
        raise CalibError("--workers are processes of this machine: give either them or --dask.")
    if dask is not None:
        with _dask_executor(dask) as cluster:
            yield cluster
        return
    processes = min(workers or default or core_count(), count)
    if processes < 2:
        yield None
        return
    with _process_pool(processes) as pool:
        yield pool


@contextmanager
def _dask_executor(address: str) -> Iterator[Executor]:
    """Provide the executor of a Dask cluster by the address of its scheduler; CalibError without Dask or an answer."""
    try:
        from distributed import Client

        client = Client(address, timeout="10s", set_as_default=False)  # type: ignore[no-untyped-call]
    except ImportError as error:
        raise CalibError("Dask is not installed: pip install 'robot-calib[dask]'") from error
    except (OSError, ValueError) as error:
        raise CalibError(
            f'--dask "{address}": no Dask scheduler answers there: {error}.'
        ) from error
    with client, client.get_executor() as executor:  # type: ignore[no-untyped-call]
        yield executor


@contextmanager
def _process_pool(processes: int) -> Iterator[Executor]:
    """Provide a pool of fresh processes, which are terminated if the block fails."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    # A fresh process each: the threads of a parent's linear algebra do not survive a fork.
    methods = multiprocessing.get_all_start_methods()
    method = "forkserver" if "forkserver" in methods else "spawn"
    context = multiprocessing.get_context(method)
    with ProcessPoolExecutor(processes, context, _leave_ctrl_c_to_the_parent) as pool:
        try:
            yield pool
        except BaseException:
            # A terminated job leaves no half written file, and a job may last long.
            for worker in multiprocessing.active_children():
                worker.terminate()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _leave_ctrl_c_to_the_parent() -> None:
    """Ignore Ctrl-C, which a terminal sends to all processes, in a worker: each would print where it was."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
