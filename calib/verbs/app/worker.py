"""The process of a job: runs its commands as if they were typed, and writes how far they are.

    python -m calib.verbs.app.worker FOLDER

The commands are read from the folder's hidden folder ``.run``, and run in the folder. What they print, the exit status
and the progress are left in ``.run`` too.
"""

from __future__ import annotations

import json
import os
import runpy
import sys
import time
from pathlib import Path
from typing import Any

from calib.basics.files import write_atomically
from calib.basics.progress import Stage, watching
from calib.errors import FileError

#: Hidden folder of a job's run, and its files.
RUN, COMMANDS, PROGRESS = ".run", "commands.json", "progress.json"
STATUS, ERRORS = "status", "errors.txt"

#: Least time between two writings of the progress, unless a stage begins [s].
_PAUSE = 0.15


def output_name(number: int) -> str:
    """Return the name of the file with what a command printed, by its number from 0."""
    return f"output-{number}.txt"


class Report:
    """Writes the progress: the stages so far, each with what is tried and how much is done."""

    def __init__(self, path: Path) -> None:
        """Report to a file."""
        self._path = path
        self._stages: list[dict[str, Any]] = []
        self._command = 0
        self._written = 0.0

    def next_command(self, number: int) -> None:
        """Say that a command begins."""
        self._command = number
        self._begin("" if number else Stage.READING.value)

    def _begin(self, stage: str) -> None:
        """Begin a stage; that before it is over."""
        now = time.time()
        if self._stages:
            self._stages[-1]["ended"] = now
        last = self._stages[-1] if self._stages else {}
        if last.get("stage") == stage and last.get("command") == self._command:
            last.pop("ended")
            return
        self._stages.append(
            {
                "command": self._command,
                "stage": stage,
                "began": now,
                "tried": 0,
                "what": "",
                "done": 0,
                "of": 0,
            }
        )
        self._write(now)

    def __call__(self, stage: Stage | None, what: str, done: int, of: int) -> None:
        """Hear what is said, as a `calib.basics.progress.Watcher`."""
        if stage is not None:
            self._begin(stage.value)
        current = self._stages[-1]
        if what:
            current["what"] = what
            current["tried"] += 1
        if of:
            current["done"], current["of"] = done, of
        now = time.time()
        if now - self._written > _PAUSE:
            self._write(now)

    def _write(self, now: float) -> None:
        """Write the file; a full disk is told by the command itself."""
        self._written = now
        try:
            data = json.dumps({"stages": self._stages}).encode()
            write_atomically(self._path, data, overwrite=True)
        except FileError:
            return


def main() -> None:
    """Run the commands one after the other, until one fails, and leave the exit status of the last."""
    folder = Path(sys.argv[1])
    run = folder / RUN
    commands = json.loads((run / COMMANDS).read_bytes())
    os.chdir(folder)
    report = Report(run / PROGRESS)
    status = 0
    for number, words in enumerate(commands):
        report.next_command(number)
        sys.argv = ["calib", *words]
        with (run / output_name(number)).open("w", encoding="utf-8") as output:
            stdout, sys.stdout = sys.stdout, output
            try:
                with watching(report):
                    runpy.run_module("calib", run_name="__main__")
                status = 0
            except SystemExit as end:
                status = end.code if isinstance(end.code, int) else int(end.code is not None)
            finally:
                sys.stdout = stdout
        if status:
            break
    try:
        with (run / STATUS).open("x") as file:  # a job that was cancelled has one already
            file.write(str(status))
    except FileExistsError:
        return


if __name__ == "__main__":
    main()
