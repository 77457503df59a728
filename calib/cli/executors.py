"""--workers and --dask: where the jobs of a study, a bootstrap or a fleet run."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Annotated

import typer

from calib.errors import CalibError

Workers = Annotated[
    int | None,
    typer.Option(min=1, metavar="N", help="Processes that share the work. Default: one per core."),
]
SampleWorkers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        min=1,
        metavar="N",
        help="Processes that share the samples of --bootstrap. Default: one.",
    ),
]
Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Dask scheduler whose workers do the work, such as tcp://192.168.0.10:8786, in place of --workers.",
    ),
]


@contextmanager
def executor_of(
    workers: int | None, dask: str | None, count: int | None, *, default: int | None = None
) -> Iterator[Executor | None]:
    """Where jobs run; None: in this process, one after the other.

    Args:
        workers: As many processes; None: ``default``.
        dask: Or the address of a scheduler.
        count: Number of jobs; None: there are none.
        default: As many if nothing is said; None: as many as there are cores.

    Raises:
        CalibError: Both were given, or there is no such scheduler.
    """
    if count is None:
        yield None
        return
    if dask is not None:
        if workers is not None:
            raise CalibError(
                "--workers are processes of this machine, and --dask has its own workers; leave one of them out."
            )
        with _dask_executor(dask) as executor:
            yield executor
        return
    wanted = min(workers or default or cores(), count)
    if wanted < 2:
        yield None
        return
    # A fresh process each: the threads of a parent's linear algebra do not survive a fork.
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    with ProcessPoolExecutor(wanted, mp_context=context) as processes:
        try:
            yield processes
        except BaseException:
            processes.shutdown(wait=False, cancel_futures=True)
            raise


@contextmanager
def _dask_executor(address: str) -> Iterator[Executor]:
    """The workers of a Dask scheduler, which need calib in the same version.

    Raises:
        CalibError: Dask is not installed, or there is no scheduler.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise CalibError(
            'Dask is not installed: run pip install ".[dask]" in calib\'s folder, or use --workers.'
        ) from error
    try:
        client = Client(address, timeout="10s", set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise CalibError(
            f'--dask "{address}": no Dask scheduler answers there: {error or "timed out"}.'
        ) from error
    with client, client.get_executor() as executor:  # type: ignore[no-untyped-call]
        yield executor


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
