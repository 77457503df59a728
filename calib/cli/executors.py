"""--workers and --dask: where the jobs of a study, a bootstrap or a fleet run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from calib.errors import CalibError

if TYPE_CHECKING:
    from concurrent.futures import Executor

Workers = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="Processes that share the work, one for each core if nothing is said.",
    ),
]
SampleWorkers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        min=1,
        metavar="N",
        help="Processes that share the samples of --bootstrap, one if nothing is said.",
    ),
]
Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Dask scheduler whose workers do it, such as tcp://192.168.0.10:8786, in place of --workers.",
    ),
]


@contextmanager
def executor_of(
    workers: int | None,
    dask: str | None,
    count: int | None,
    *,
    default: int | None = None,
    preloaded: tuple[str, ...] = (),
) -> Iterator[Executor | None]:
    """Where jobs run; None: in this process, one after the other.

    Args:
        workers: As many processes; None: ``default``.
        dask: Or the address of a scheduler.
        count: Number of jobs; None: there are none.
        default: As many if nothing is said; None: as many as there are cores.
        preloaded: Modules that the jobs need beside those of a fit.

    Raises:
        CalibError: Both were given, or there is no such scheduler.
    """
    if count is None:
        yield None
        return
    if dask is not None:
        if workers is not None:
            message = "--workers are processes of this machine, and --dask has its own workers; leave one of them out."
            raise CalibError(message)
        from calib.identify.dask_executor import dask_executor

        with dask_executor(dask) as executor:
            yield executor
        return
    wanted = min(workers or default or cores(), count)
    if wanted < 2:
        yield None
        return
    from calib.identify.processes import PRELOADED, process_executor

    with process_executor(wanted, (*PRELOADED, *preloaded)) as processes:
        yield processes


def cores() -> int:
    """Cores that this process may use."""
    count: Callable[[int], set[int]] | None = getattr(os, "sched_getaffinity", None)
    return len(count(0)) if count is not None else os.cpu_count() or 1
