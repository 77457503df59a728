"""process_executor: worker processes of this machine that outlive a job that kills one of them.

`concurrent.futures.ProcessPoolExecutor` is broken for good when one of its processes ends, and all jobs under way fail
with it. Here each worker is fed by a thread of its own: when it ends (killed, out of memory) a new one is started, and
the job that it had is begun again; if that one ends too, the job fails with `WorkerDied`, and the others go on.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from multiprocessing.util import get_temp_dir
from queue import SimpleQueue
from types import TracebackType
from typing import Any, TypeVar

from calib.errors import CalibError
from calib.identify.executors import WorkerDied

T = TypeVar("T")

#: A job whose worker ended so often is not tried again.
_DEATHS = 2

#: So many workers in a row that end before they could begin are no accident.
_STARTS = 3

#: What the server that workers are forked from imports, so that it is imported once.
PRELOADED = ("calib.identify.study",)

#: In the place of a call: there are no more.
_GOODBYE = b""

#: How long a worker that has lost its line waits for the end of its parent [s].
_MOURNED = 5.0

#: Whether workers come from a server that forks them.
_SERVER = sys.platform == "linux"

_UNGUARDED = (
    "In a script, what calls calib must stand behind 'if __name__ == \"__main__\":', for each worker imports the "
    "script."
)


@dataclass(frozen=True, slots=True)
class _Job:
    """A call as bytes, and where its result goes."""

    call: bytes
    future: Future[Any]


class ProcessExecutor(Executor):
    """An executor of worker processes; see the module's text. A context manager ends them, at once if interrupted.

    Attributes:
        workers: Their number at most; there are never more than there were jobs.
    """

    def __init__(self, workers: int, preloaded: Sequence[str] = PRELOADED) -> None:
        """Begin; what workers need is imported while the caller does other things, and they start with the jobs.

        Args:
            workers: Their number at most, 1 or more.
            preloaded: Modules that they will need; a hint.

        Raises:
            CalibError: Fewer than one, or a script that its workers cannot import.
        """
        if workers < 1:
            message = f"{workers} worker processes were asked for; it takes 1 or more."
            raise CalibError(message)
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            # A worker that imports the script; it would start workers of its own, and so on.
            raise CalibError(_UNGUARDED)
        self.workers = workers
        self._context = _context(preloaded)
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._closed = self._killed = False
        self._lock = threading.Lock()
        self._processes: set[BaseProcess] = set()
        self._threads: list[threading.Thread] = []
        self._open = 0

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:  # noqa: ANN401
        """A call under way.

        Raises:
            RuntimeError: It was shut down.
        """
        if self._closed:
            message = "this executor was shut down"
            raise RuntimeError(message)
        future: Future[T] = Future()
        with self._lock:
            self._open += 1
            if len(self._threads) < min(self.workers, self._open):
                self._threads.append(threading.Thread(target=self._feed, daemon=True))
                self._threads[-1].start()
        self._jobs.put(_Job(pickle.dumps((fn, args, kwargs), pickle.HIGHEST_PROTOCOL), future))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more jobs; those that were given are done, or with ``cancel_futures`` dropped if not begun."""
        self._closed = True
        if cancel_futures:
            self._drop()
        for _ in self._threads:
            self._jobs.put(None)
        if wait:
            for thread in self._threads:
                thread.join()

    def kill(self) -> None:
        """End all workers at once, whatever they are doing; the jobs are dropped."""
        self._closed = self._killed = True
        self._drop()
        with self._lock:
            for process in self._processes:
                process.kill()
        self.shutdown()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> bool | None:
        """Wait for the jobs; where the block was left by an error or Ctrl-C, end them."""
        if kind is None:
            self.shutdown()
        else:
            self.kill()
        return None

    def _drop(self) -> None:
        """Cancel the jobs that have not begun."""
        with contextlib.suppress(Exception):  # queue.Empty
            while True:
                job = self._jobs.get_nowait()
                if job is not None:
                    job.future.cancel()
                    with self._lock:
                        self._open -= 1

    def _feed(self) -> None:
        """Give jobs to one worker, one after the other; in a thread of its own."""
        worker: _Worker | None = None
        with contextlib.suppress(Exception):  # where it fails again, there is a job to tell
            worker = self._started()
        while (job := self._jobs.get()) is not None:
            if job.future.set_running_or_notify_cancel():
                worker = self._done(job, worker)
            with self._lock:
                self._open -= 1
        if worker is not None:
            with contextlib.suppress(OSError):
                worker.connection.send_bytes(_GOODBYE)
            self._buried(worker)

    def _done(self, job: _Job, worker: _Worker | None) -> _Worker | None:
        """Have a job done by a worker, or by a new one; the worker that is left."""
        deaths: list[str] = []
        while len(deaths) < _DEATHS and not self._killed:
            try:
                worker = self._started() if worker is None else worker
                _settle(job.future, worker.answer(job.call))
            except (EOFError, OSError):  # noqa: PERF203  at most twice
                deaths.append("not started" if worker is None else self._buried(worker))
                worker = None
            except Exception as error:  # noqa: BLE001  whoever waits for the job is told
                job.future.set_exception(error)
                return None
            else:
                return worker
        message = "the workers were ended"
        if not self._killed:
            message = (
                f"The process that worked on it has ended, and so has the next one: {' and '.join(deaths)}. It may "
                "need more memory than there is."
            )
        job.future.set_exception(WorkerDied(message))
        return worker

    def _started(self) -> _Worker:
        """A worker that is ready.

        Raises:
            CalibError: None can be started.
        """
        for _ in range(_STARTS):
            worker = _Worker(self._context)
            with self._lock:
                self._processes.add(worker.process)
            if self._killed:
                worker.process.kill()
            with contextlib.suppress(EOFError, OSError):
                worker.connection.recv_bytes()
                return worker
            how = self._buried(worker)
            if self._killed:
                break
        message = f"No worker process can be started ({how}). {_UNGUARDED}"
        raise CalibError(message)

    def _buried(self, worker: _Worker) -> str:
        """Wait for the end of a worker that has ended; how it did."""
        worker.process.join()
        code = worker.process.exitcode
        with self._lock:
            self._processes.discard(worker.process)
        worker.connection.close()
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"killed by {signal.Signals(-code).name}"
        return f"exit code {code}"


def process_executor(workers: int, preloaded: Sequence[str] = PRELOADED) -> ProcessExecutor:
    """Worker processes, for `calib.study`, `calib.bootstrap` and `calib.fleet`.

    Args:
        workers: Their number at most; each starts when there is a job for it.
        preloaded: Modules that they will need; a hint.

    Raises:
        CalibError: Fewer than one.

    Example:
        >>> with process_executor(2) as executor:
        ...     list(executor.map(abs, [-1, -2]))
        [1, 2]
    """
    return ProcessExecutor(workers, preloaded)


class _Worker:
    """A worker process and the line to it."""

    def __init__(self, context: BaseContext) -> None:
        """Start it; it sends a word when it is ready."""
        self.connection, theirs = context.Pipe()
        litter = get_temp_dir() if _SERVER else None
        self.process: BaseProcess = context.Process(  # type: ignore[attr-defined]
            target=_work, args=(theirs, litter), daemon=True
        )
        self.process.start()
        # With our copy open, its end could not be told.
        theirs.close()

    def answer(self, call: bytes) -> bytes:
        """What it makes of a call.

        Raises:
            EOFError, OSError: It has ended.
        """
        self.connection.send_bytes(call)
        return self.connection.recv_bytes()


def _context(preloaded: Sequence[str]) -> BaseContext:
    """How workers are started: never forked from this process, whose threads may hold locks.

    Where there is a fork they come from a server that has imported all and has no threads, in a few ms each.
    """
    if _SERVER:
        from multiprocessing.forkserver import ensure_running

        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["__main__", *preloaded])
        # Its socket lies in a folder of this process's own: made here once, for threads would make one each.
        get_temp_dir()
        ensure_running()
        return context
    return multiprocessing.get_context("spawn")


def _settle(future: Future[Any], answer: bytes) -> None:
    """Hand a worker's answer on."""
    try:
        done, value, trace = pickle.loads(answer)
    except Exception as error:  # noqa: BLE001  whoever waits for the result is told
        future.set_exception(error)
        return
    if done:
        future.set_result(value)
        return
    if not isinstance(value, CalibError):
        value.__cause__ = RuntimeError(f"\n{trace}")
    future.set_exception(value)


def _work(connection: Connection, litter: str | None) -> None:
    """Do calls as they come, until nobody sends any; the main function of a worker.

    Args:
        connection: Where they come from.
        litter: A folder that a killed parent leaves behind.
    """
    # Ctrl-C reaches all processes of a terminal; the one that started this one ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    watching = end_with_parent(litter)
    with contextlib.suppress(EOFError, OSError):
        connection.send_bytes(b"ready")
        while (call := connection.recv_bytes()) != _GOODBYE:
            connection.send_bytes(_answer(call))
        return
    # Nobody said goodbye: the thread that waits for the parent's end cleans up, and ends this process.
    if watching is not None:
        watching.join(_MOURNED)


def _answer(call: bytes) -> bytes:
    """What a call came to: whether it has a result, that or the error, and the error's trace."""
    try:
        function, args, kwargs = pickle.loads(call)
        return pickle.dumps((True, function(*args, **kwargs), ""), pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # noqa: BLE001  it is raised where the call came from
        trace = traceback.format_exc()
        try:
            pickle.loads(blob := pickle.dumps((False, error, trace)))
        except Exception:  # noqa: BLE001  an error that does not travel is told as text
            return pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}"), trace))
        return blob


def end_with_parent(litter: str | None = None) -> threading.Thread | None:
    """End this process when the one that started it is gone: killed, that one can no longer end its workers.

    Args:
        litter: A temporary folder of that one, which it can then no longer remove either.

    Returns:
        The thread that waits for that; None of a process that no other of Python's started.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return None
    thread = threading.Thread(target=_watch, args=(parent, litter), daemon=True)
    thread.start()
    return thread


def _watch(parent: BaseProcess, litter: str | None) -> None:
    """Wait for the end of a process, then end this one at once, whatever it is doing."""
    parent.join()
    if litter is not None:
        shutil.rmtree(litter, ignore_errors=True)
    os._exit(1)
