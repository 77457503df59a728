"""A real Dask scheduler and its workers, each a process that can be killed."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager


class Cluster:
    """A scheduler and its workers."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{port}"
        self._workers: list[subprocess.Popen[bytes]] = []
        self._scheduler = _start("scheduler", "--host", "127.0.0.1", "--port", str(port))
        end = time.monotonic() + 30.0
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
                return
            assert time.monotonic() < end, "the scheduler does not start"
            time.sleep(0.05)

    def worker(self, before: str = "") -> subprocess.Popen[bytes]:
        """One more, in a process that begins with these lines of Python."""
        words = ("worker", self.address, "--no-nanny", "--nthreads", "1")
        self._workers.append(_start(*words, before=before))
        return self._workers[-1]

    def kill_workers(self) -> None:
        for process in self._workers:
            process.kill()
            process.wait()

    def kill(self) -> None:
        self.kill_workers()
        self._scheduler.kill()
        self._scheduler.wait()


@contextmanager
def scheduler() -> Iterator[Cluster]:
    """A scheduler without workers."""
    cluster = Cluster()
    try:
        yield cluster
    finally:
        cluster.kill()


def _start(kind: str, *words: str, before: str = "") -> subprocess.Popen[bytes]:
    """`dask scheduler` or `dask worker`."""
    program = f"{before}\nfrom distributed.cli.dask_{kind} import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", program, *words, "--no-dashboard"],
        # What a test hands over stands in the tests.
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path or "." for path in sys.path),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
        },
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
