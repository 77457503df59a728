"""The folder of the app: its jobs, each in a folder of its own, and the token by which browsers are known."""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

from calib.basics.files import make_folder, write_atomically
from calib.errors import CalibError, FileError
from calib.verbs.app.job import OUTPUTS, PICTURES, RECORD, Job, Kind
from calib.verbs.app.uploads import Received, free_name, is_picture

#: Hidden file with the token.
_TOKEN = ".token"

#: Digits of the number with which a job's folder begins.
_DIGITS = 4

#: Letters of a job's name at most, after its number.
_LONGEST = 40

#: What stands in the place of other characters in the name of a folder.
_OTHERS = re.compile(r"[^A-Za-z0-9]+")

#: A number with which a job's folder begins.
_NUMBER = re.compile(r"(\d+)-")

#: Beginning of the name of an input that is called like an output.
_INPUT = "input-"


class Desk:
    """The jobs of a folder. Everything is read from the disk, so that all browsers and servers see the same."""

    def __init__(self, folder: Path) -> None:
        """Take a folder, which is made if it does not exist; FileError if it cannot be."""
        self.folder = make_folder(folder).resolve()
        self._making = threading.Lock()

    def token(self) -> str:
        """Return the token of the folder, a new one if it has none: after a restart open pages go on."""
        path = self.folder / _TOKEN
        try:
            token = path.read_text(encoding="ascii").strip()
        except (OSError, UnicodeDecodeError):
            token = ""
        if len(token) < 20:
            token = secrets.token_urlsafe(24)
            write_atomically(path, token.encode(), overwrite=True)
            path.chmod(0o600)
        return token

    def jobs(self) -> list[Job]:
        """Return the jobs, the latest first, without those whose file is damaged."""
        jobs = []
        for record in self.folder.glob(f"*/{RECORD}"):
            with contextlib.suppress(FileError):
                jobs.append(Job.read(record.parent))
        return sorted(jobs, key=lambda job: job.name, reverse=True)

    def job(self, name: str) -> Job:
        """Return the job of a name, which is compared with those that there are; CalibError if there is none."""
        for record in self.folder.glob(f"*/{RECORD}"):
            if record.parent.name == name:
                return Job.read(record.parent)
        raise CalibError(
            "There is no such job in the folder of this app; it may have been removed."
        )

    def make(
        self,
        kind: Kind,
        title: str,
        key: str,
        received: Received | None = None,
        choices: Mapping[str, str] | None = None,
        places: Mapping[str, str] | None = None,
    ) -> Job:
        """Make a job, or return the one that a page has made already.

        Args:
            kind: What it does.
            title: Begins its name, such as that of the robot.
            key: The key that the page sent, the same if it was sent twice.
            received: Files of which it gets those; None: none.
            choices: What is chosen already.
            places: Paths in the folder for files that have a place of their own, by their names.

        Raises:
            FileError: The folder cannot be written.
        """
        with self._making:
            if key:
                for job in self.jobs():
                    if job.key == key:
                        return job
            folder = self._new_folder(title)
            now = datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
            job = Job(folder=folder, kind=kind, created=now, key=key, choices=choices or {}).write()
        return job if received is None else self.add(job, received, places)

    def _new_folder(self, title: str) -> Path:
        """Make a folder with the next number."""
        slug = _OTHERS.sub("-", title).strip("-").lower()[:_LONGEST] or "job"
        found = (_NUMBER.match(path.name) for path in self.folder.iterdir())
        number = max((int(match[1]) for match in found if match), default=0) + 1
        while True:
            folder = self.folder / f"{number:0{_DIGITS}}-{slug}"
            try:
                folder.mkdir()
            except FileExistsError:  # another server's
                number += 1
            except OSError as error:
                raise FileError(
                    f"'{folder}' cannot be made: {error.strerror or error}. Start calib app with another folder."
                ) from error
            else:
                return folder

    def add(self, job: Job, received: Received, places: Mapping[str, str] | None = None) -> Job:
        """Move files that were sent into a job's folder; one of the same name replaces the one before.

        Args:
            job: The job.
            received: The files.
            places: As of `make`.
        """
        taken = set(OUTPUTS)
        inputs = list(job.inputs)
        for name in received.files:
            kept = (places or {}).get(name) or (f"{PICTURES}/{name}" if is_picture(name) else name)
            if kept.casefold() in {output.casefold() for output in OUTPUTS}:
                kept = free_name(f"{_INPUT}{name}", taken)
            target = job.folder / kept
            target.parent.mkdir(exist_ok=True)
            (received.folder / name).replace(target)
            if kept not in inputs:
                inputs.append(kept)
        return replace(job, inputs=tuple(inputs)).write()

    def drop(self, job: Job, name: str) -> Job:
        """Remove an input of a job."""
        if name not in job.inputs:
            return job
        (job.folder / name).unlink(missing_ok=True)
        return replace(job, inputs=tuple(kept for kept in job.inputs if kept != name)).write()

    def again(self, job: Job, key: str) -> Job:
        """Make a job with the inputs and choices of another one."""
        title = job.name.partition("-")[2]
        new = self.make(job.kind, title, key, choices=job.choices)
        if new.inputs or new.commands:  # made before, by the same key
            return new
        for name in job.inputs:
            target = new.folder / name
            target.parent.mkdir(exist_ok=True)
            _copy(job.folder / name, target)
        return replace(new, inputs=job.inputs).write()

    def remove(self, job: Job) -> None:
        """Remove a job with its folder."""
        gone = self.folder / f".removed-{secrets.token_hex(6)}"
        try:
            job.folder.replace(gone)  # at once for all who look
        except OSError as error:
            raise FileError(
                f"'{job.folder}' cannot be removed: {error.strerror or error}; remove it by hand."
            ) from error
        shutil.rmtree(gone, ignore_errors=True)


def _copy(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where that cannot be; inputs are never written to."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def title_of(names: Sequence[str], robot: str) -> str:
    """Return what a job is called after: its robot by name, or the first of its files."""
    if robot:
        return robot
    plain = [name for name in names if not is_picture(name)] or list(names)
    robots = [name for name in plain if Path(name).suffix.lower() in (".urdf", ".xacro", ".xml")]
    return Path((robots or plain or ["job"])[0]).name.split(".")[0]
