"""Runs of jobs: processes of their own, so that the server answers meanwhile and a run can be broken off.

Whether a job runs is told by its hidden folder alone. The folder is made once: a second start of the same job does
nothing. While the process lives it holds a lock of the folder, which the system lets go of however the process ends;
at the end there is a file with the exit status.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import IO, Any

from calib.basics.files import write_atomically
from calib.cli.exit_status import ExitStatus
from calib.errors import CalibError, FileError
from calib.verbs.app.job import Command, Job
from calib.verbs.app.worker import COMMANDS, ERRORS, PROGRESS, RUN, STATUS, output_name

#: The lock that a run holds, and the number of its process.
_LOCK, _PROCESS = "lock", "process"

#: Exit status of a run that was broken off on the page.
_CANCELLED = "cancelled"

#: Runs at the same time at most: each takes a core and some memory.
MOST_RUNS = 2

#: Time that a process has to end after it was asked to [s].
_GRACE = 3.0

#: Exit statuses with which a command has done its work.
_DONE = (ExitStatus.DONE, ExitStatus.NOT_ACCEPTED)

#: Most of a printed text that is shown [characters].
_MOST_TEXT = 200_000


class State(Enum):
    """State of a job."""

    DRAFT = "draft"  #: nothing was started
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"  #: on the page
    INTERRUPTED = "interrupted"  #: the process or the computer went down


@dataclass(frozen=True, slots=True)
class StageDone:
    """A stage of a run so far."""

    #: Number of its command, from 0
    command: int
    #: A value of `calib.basics.progress.Stage`; empty before the first
    stage: str
    #: Whether it is over
    is_over: bool
    #: How long it takes so far [s]
    seconds: float
    #: What is tried, and which one
    what: str
    tried: int
    #: Parts that are done, of how many; 0 of 0 if that is not known
    done: int
    of: int


def state_of(job: Job) -> State:
    """Return the state of a job."""
    run = job.folder / RUN
    try:
        status = (run / STATUS).read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        if not run.is_dir():
            return State.DRAFT
        return State.RUNNING if _is_held(run / _LOCK) else State.INTERRUPTED
    if status == _CANCELLED:
        return State.CANCELLED
    return State.DONE if status in [str(int(done)) for done in _DONE] else State.FAILED


def stages_of(job: Job) -> list[StageDone]:
    """Return the stages of a job's run so far; none before the first is written."""
    try:
        table: Any = json.loads((job.folder / RUN / PROGRESS).read_bytes())
        entries = table["stages"]
    except (OSError, ValueError):
        return []
    now = time.time()
    return [
        StageDone(
            entry["command"],
            entry["stage"],
            "ended" in entry,
            max(entry.get("ended", now) - entry["began"], 0.0),
            entry["what"],
            entry["tried"],
            entry["done"],
            entry["of"],
        )
        for entry in entries
    ]


def printed(job: Job, number: int = -1) -> str:
    """Return what a command of a job printed, the last one unless its number is given; empty if it did not run."""
    numbers = range(len(job.commands))
    if not numbers:
        return ""
    return _text(job.folder / RUN / output_name(numbers[number]))


def messages(job: Job) -> str:
    """Return the messages of a job's commands: errors and remarks, as the terminal would show them."""
    return _text(job.folder / RUN / ERRORS)


def _text(path: Path) -> str:
    """Return the text of a file, as much as is shown; empty without it."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")[:_MOST_TEXT].strip()
    except OSError:
        return ""


class Runs:
    """The processes that this server has started."""

    def __init__(self) -> None:
        """Begin without any."""
        self._processes: dict[Path, subprocess.Popen[bytes]] = {}
        self._starting = threading.Lock()

    def start(self, job: Job, commands: tuple[Command, ...]) -> Job:
        """Start the commands of a job, in its folder; nothing happens if it was started before.

        Raises:
            CalibError: As many run as may.
            FileError: The folder cannot be written.
        """
        run = job.folder / RUN
        with self._starting:
            if run.exists():
                return Job.read(job.folder)
            alive = [
                folder for folder, process in self._processes.items() if process.poll() is None
            ]
            if len(alive) >= MOST_RUNS:
                raise CalibError(
                    f"{len(alive)} jobs are running already, as many as run at a time: wait for one, or cancel it."
                )
            prepared = job.folder / f"{RUN}-{secrets.token_hex(4)}"
            try:
                prepared.mkdir()
                words = json.dumps([list(words) for words in commands], ensure_ascii=False)
                (prepared / COMMANDS).write_text(words, encoding="utf-8")
                with (
                    (prepared / _LOCK).open("wb") as lock,
                    (prepared / ERRORS).open("wb") as errors,
                ):
                    _take(lock)
                    prepared.rename(
                        run
                    )  # who sees it, sees it held; a second one cannot take its place
                    self._processes[job.folder] = _process(job.folder, lock, errors)
                pid = self._processes[job.folder].pid
                write_atomically(run / _PROCESS, str(pid).encode(), overwrite=True)
            except OSError as error:
                shutil.rmtree(prepared, ignore_errors=True)
                if run.exists():  # another server was quicker
                    return Job.read(job.folder)
                raise FileError(
                    f"'{job.folder}' cannot be written: {error.strerror or error}."
                ) from error
            return replace(job, commands=commands)

    def cancel(self, job: Job) -> None:
        """Break off the run of a job; files are written whole or not at all, so that none is half written."""
        if state_of(job) is not State.RUNNING:
            return
        run = job.folder / RUN
        with contextlib.suppress(FileExistsError), (run / STATUS).open("x") as file:
            file.write(_CANCELLED)
        process = self._processes.get(job.folder)
        if process is not None:
            _end(process)
            return
        # Of a server before this one: the lock says that the number is still that of the run.
        with contextlib.suppress(OSError, ValueError):
            number = int((run / _PROCESS).read_text(encoding="ascii"))
            if _is_held(run / _LOCK):
                os.kill(number, signal.SIGTERM)

    def close(self) -> None:
        """End all processes."""
        for process in self._processes.values():
            _end(process)


def _take(lock: IO[bytes]) -> None:
    """Take a lock, which whoever inherits the file goes on to hold."""
    if sys.platform != "win32":
        import fcntl

        fcntl.flock(lock, fcntl.LOCK_EX)


def _process(folder: Path, lock: IO[bytes], errors: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start the process of a job, which holds the lock until it ends."""
    command = [sys.executable, "-m", "calib.verbs.app.worker", str(folder)]
    options: dict[str, Any] = {}
    if sys.platform != "win32":
        # Ctrl-C on the terminal is for the server, which ends its processes itself.
        options = {"pass_fds": (lock.fileno(),), "start_new_session": True}
    return subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=errors, stderr=errors, **options
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process and those that it started."""
    if process.poll() is not None:
        return
    if sys.platform == "win32":
        process.terminate()
    else:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
    try:
        process.wait(_GRACE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _is_held(path: Path) -> bool:
    """Return True if a living process holds a lock. Windows has no such locks; there a lock file counts as held."""
    if not path.exists():
        return False
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    return False
