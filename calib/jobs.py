"""run: many independent jobs, here or in any executor of `concurrent.futures`; Dask has one too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, as_completed
from typing import TypeVar

from calib.errors import CalibError

#: Called with the number of jobs done and of all.
Progress = Callable[[int, int], None]

C = TypeVar("C")
I = TypeVar("I")  # noqa: E741  an item
R = TypeVar("R")


def run(
    function: Callable[[C, I], R],
    shared: C,
    items: Iterable[I],
    executor: Executor | None = None,
    *,
    batch: int = 1,
) -> Iterator[tuple[int, R]]:
    """``function(shared, item)`` of every item with the item's number, in any order; without an executor here.

    The function is a module's; what it is given and gives back can be pickled. ``batch`` items are sent together, with
    ``shared``: many for jobs that take less time than they take to send.

    Raises:
        CalibError: A worker was killed, or ran out of memory.
    """
    every = enumerate(items)
    if executor is None:
        yield from ((number, function(shared, item)) for number, item in every)
        return
    listed = list(every)
    parts = [listed[k : k + batch] for k in range(0, len(listed), batch)]
    pending = [executor.submit(_call, function, shared, part) for part in parts]
    try:
        for future in as_completed(pending):
            yield from future.result()
    except BrokenExecutor as error:
        raise CalibError(
            f"A worker process was killed, or ran out of memory ({error}). Try fewer --workers."
        ) from error
    finally:
        for future in pending:
            future.cancel()


def batch_size(count: int, largest: int = 50) -> int:
    """How many of so many short jobs to send together: few enough for all workers to end at about the same time."""
    return max(1, min(largest, count // 24))


def _call(
    function: Callable[[C, I], R], shared: C, part: list[tuple[int, I]]
) -> list[tuple[int, R]]:
    """One batch, in a worker."""
    return [(number, function(shared, item)) for number, item in part]
