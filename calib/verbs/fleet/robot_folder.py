"""The folder of one robot of a fleet: writes its files, and recognises the folder of a finished, unchanged robot.

The last file that is written, ``made.json``, has the fingerprint of the robot's inputs, the names of its files and its
row of the fleet's table. While the others are being written it has no fingerprint.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.basics.files import make_folder, remove, write_atomically
from calib.basics.json_files import json_bytes
from calib.errors import CalibError
from calib.verbs.fleet.fleet_row import ROW_LAYOUT, FleetRow

#: The corrected URDF in a robot's folder.
URDF = "corrected.urdf"

#: The file beside the others that is written last.
MADE = "made.json"

#: Schema of ``made.json``; counted up when the files of a robot change.
SCHEMA = "fleet robot 7"


@dataclass(frozen=True, slots=True)
class RobotFolder:
    """The folder of one robot."""

    #: Path of the folder, which need not exist yet
    path: Path

    def finished_row(self, fingerprint: str) -> FleetRow | None:
        """Return the robot's row of an earlier run if that had the same inputs and all its files are there.

        Args:
            fingerprint: Of the robot's present inputs.

        Returns:
            The row; None if the robot must be calibrated.
        """
        try:
            table = json.loads((self.path / MADE).read_bytes())
            same_schema = table["schema"] == SCHEMA
            same_inputs = table["fingerprint"] == fingerprint
            files = [self.path / name for name in table["files"]]
            complete = all(file.is_file() for file in files)
            row: FleetRow = ROW_LAYOUT.read(FleetRow, table["row"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        if not (same_schema and same_inputs and complete):
            return None
        return row

    def write(self, fingerprint: str, row: FleetRow, files: Mapping[str, bytes]) -> None:
        """Write a robot's files, and remove those of an earlier result that this one does not have.

        A URDF of an earlier result must not pass for one of this result.

        Args:
            fingerprint: Of the robot's inputs.
            row: Its row of the fleet's table.
            files: Content of each file, by name.

        Raises:
            CalibError: A file of this name, or a corrected URDF, is there that no fleet has written.
            FileError: The folder cannot be written.
        """
        make_folder(self.path)
        if not (self.path / MADE).exists():
            # If no URDF is written because of its verdict, another's must not stand beside this result either.
            for name in (*files, URDF):
                file = self.path / name
                if file.exists():
                    raise CalibError(
                        f"{file} exists already, and no fleet has written it. Move it away."
                    )
        earlier = [name for name in self._listed_files() if name not in files]
        begun = _made_table("", row, [*files, *earlier])
        self._write_file(MADE, json_bytes(begun))
        for name in earlier:
            remove(self.path / name)
        for name, content in files.items():
            self._write_file(name, content)
        finished = _made_table(fingerprint, row, [*files])
        self._write_file(MADE, json_bytes(finished))

    def _listed_files(self) -> list[str]:
        """Return the names of the files that an earlier fleet has written, finished or not; none without a list."""
        try:
            names = json.loads((self.path / MADE).read_bytes())["files"]
        except (OSError, ValueError, KeyError, TypeError):
            return []
        # Only plain names, as calib lists them: a list that somebody changed reaches no other folder.
        return [n for n in names if isinstance(n, str) and Path(n).name == n and n != MADE]

    def _write_file(self, name: str, content: bytes) -> None:
        """Write one file of the folder by its name, over an earlier one."""
        write_atomically(self.path / name, content, overwrite=True)


def _made_table(fingerprint: str, row: FleetRow, files: Sequence[str]) -> dict[str, Any]:
    """Return the content of ``made.json``; the fingerprint is ``""`` until all files are written."""
    return {
        "schema": SCHEMA,
        "fingerprint": fingerprint,
        "files": files,
        "row": ROW_LAYOUT.table(row),
    }
