"""A job: files that were sent, what was chosen, and the commands that are run on them, in a folder of its own.

All of it is on disk: the inputs and outputs in the folder, the rest in the hidden file ``.job.json``. So a job outlives
the server and the browser, and the folder is one in which the commands can be typed by hand.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

from calib.basics.files import read_bytes, write_atomically
from calib.basics.values import ReadOnlyMapping, Value, keep_read_only
from calib.errors import FileError
from calib.verbs.app.worker import COMMANDS, RUN

#: The hidden file of a job.
RECORD = ".job.json"

#: Schema of this file.
_SCHEMA = "app job 1"

#: Folder of a job's pictures.
PICTURES = "pictures"

#: Names of what commands write into a job's folder; inputs get other names.
CELL, CORRECTED, RESULT, REPORT, VIEW = (
    *("cell.toml", "corrected.urdf", "result.json"),
    *("report.html", "view.html"),
)
CORNERS, SHEET, CHECKED, POSES = "corners.csv", "corners.html", "check.json", "poses.csv"
OUTPUTS = (CORRECTED, RESULT, REPORT, VIEW, CELL, CORNERS, SHEET, CHECKED, POSES)


class Kind(Enum):
    """The task of a job."""

    CALIBRATE = "calibrate"
    CHECK = "check"
    POSES = "poses"  #: poses to check at
    MEASURE = "measure"  #: a session


#: The words of a command after ``calib``.
Command = tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Job(Value):
    """A job as its file has it."""

    #: Its folder
    folder: Path
    kind: Kind
    #: Its date and time, UTC, as ISO 8601
    created: str
    #: What the page that made it sent to tell a reload from a second job
    key: str
    #: Paths of its inputs in its folder
    inputs: tuple[str, ...] = ()
    #: What was chosen in place of calib's own guess, by the fields of the page
    choices: Mapping[str, str] = field(default_factory=ReadOnlyMapping)
    #: The commands, once they were started; then they stay as they are
    commands: tuple[Command, ...] = ()

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "choices")

    @property
    def name(self) -> str:
        """Its name, that of its folder."""
        return self.folder.name

    @property
    def files(self) -> dict[str, Path]:
        """The files that may be downloaded, by the names that the server knows them by."""
        names = dict.fromkeys((*OUTPUTS, *self.inputs))
        return {name: self.folder / name for name in names if (self.folder / name).is_file()}

    @property
    def command_lines(self) -> tuple[str, ...]:
        """The commands, as they are typed in the job's folder."""
        return tuple(command_text(words) for words in self.commands)

    @classmethod
    def read(cls, folder: Path) -> Job:
        """Read the job of a folder; FileError if there is none, or its file is damaged."""
        path = folder / RECORD
        data = read_bytes(path, "The file of the job")
        try:
            table: Any = json.loads(data)
            if table["schema"] != _SCHEMA:
                raise FileError(f"'{path}' is of another version of calib app.")
            return cls(
                folder=folder,
                kind=Kind(table["kind"]),
                created=str(table["created"]),
                key=str(table["key"]),
                inputs=tuple(map(str, table["inputs"])),
                choices={str(name): str(value) for name, value in table["choices"].items()},
                commands=_commands(folder),
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FileError(f"'{path}' is damaged; remove the folder of the job.") from error

    def write(self) -> Job:
        """Write the file, and return the job."""
        table = {
            "schema": _SCHEMA,
            "kind": self.kind.value,
            "created": self.created,
            "key": self.key,
            "inputs": list(self.inputs),
            "choices": dict(self.choices),
        }
        data = json.dumps(table, indent=1, ensure_ascii=False).encode()
        write_atomically(self.folder / RECORD, data, overwrite=True)
        return self

    def with_choices(self, choices: Mapping[str, str]) -> Job:
        """Return the job with other choices."""
        return replace(self, choices=dict(choices))


def _commands(folder: Path) -> tuple[Command, ...]:
    """Read the commands of a job's run; none if it was not started."""
    try:
        data = (folder / RUN / COMMANDS).read_bytes()
    except OSError:
        return ()
    return tuple(tuple(map(str, words)) for words in json.loads(data))


def command_text(words: Sequence[str]) -> str:
    """Return a command as it is typed."""
    return shlex.join(["calib", *words])
