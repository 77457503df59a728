"""fleet: many robots calibrated, each from its own data into a folder of its own, and compared with each other.

Robots are read when their turn has come and calibrated in any executor. One that fails is told with its reason, and the
others are finished. The last file of a robot's folder, ``made.json``, has the SHA-256 of the robot's inputs and its row
of the fleet's table: by it the next run knows what is finished and unchanged.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from calib.errors import CalibError, FileError
from calib.fleets.outliers import Odd, odd_ones
from calib.fleets.record import DONE, FAILED, STALE, FleetRow, csv_bytes, fleet_table
from calib.fleets.robots import (
    FleetInputs,
    FleetOptions,
    FleetRobot,
    Made,
    calibrate_one,
    fault,
    inputs_fingerprint,
    urdf_reader,
)
from calib.identify.jobs import run
from calib.model.files import json_bytes, make_folder, write_atomically

#: The tables of a fleet: for a spreadsheet, and for a program; see docs/fleet.md.
CSV, JSON = "fleet.csv", "fleet.json"

Progress = Callable[[int, int], None]

#: Beside a robot's files, written last.
MADE = "made.json"
SCHEMA = "fleet robot 2"

#: A robot's name is that of its folder, on any system.
_NAME = re.compile(r"[^\W_](?:[\w .+-]{0,98}[\w+-])?")
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?|fleet\.(csv|json)", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """Many robots, calibrated.

    Attributes:
        rows: One for each robot, in their order.
        odd: What is odd about which of them, see `calib.fleets.outliers`.
        notes: What could not be said, and what else a person should know.
        kept: How many of them were taken from an earlier run.
    """

    rows: tuple[FleetRow, ...]
    odd: tuple[Odd, ...]
    notes: tuple[str, ...]
    kept: int

    @property
    def failed(self) -> tuple[FleetRow, ...]:
        """The robots without a result of these inputs."""
        return tuple(row for row in self.rows if row.status != DONE)


def fleet(
    robots: Sequence[FleetRobot],
    folder: str | Path,
    options: FleetOptions | None = None,
    *,
    executor: Executor | None = None,
    progress: Progress | None = None,
    force: bool = False,
) -> Fleet:
    """Calibrate many robots into a folder: one of its own for each, and the tables ``fleet.csv`` and ``fleet.json``.

    A robot whose folder an earlier run has made of the same inputs, options and version is kept as it is. Of one that
    fails the folder stays as it was.

    Args:
        robots: The robots.
        folder: Where to; it is made if missing.
        options: How they are calibrated.
        executor: Where; None: here, one after the other. Any of `concurrent.futures`, or Dask's
            ``Client.get_executor()``.
        progress: Called after each robot.
        force: Whether all are calibrated anew.

    Raises:
        CalibError: No robots, names that cannot be those of folders or belong to two, or a worker was killed.
        FileError: The folder cannot be written.
    """
    if not robots:
        raise CalibError("There are no robots to calibrate; give one or more.")
    check_names((robot.name, f"Robot {i}") for i, robot in enumerate(robots, 1))
    path, options = Path(folder), options or FleetOptions()
    make_folder(path)
    work = _Work(robots, path, options, force, progress or (lambda *_: None))
    for number, result in run(calibrate_one, options, work.jobs(), executor):
        work.finish(number, result)
    rows = tuple(work.rows[robot.name] for robot in robots)
    odd, notes = odd_ones(rows)
    # First the one that says whose the other is.
    write_atomically(path / JSON, json_bytes(fleet_table(rows, odd, notes)), overwrite=True)
    write_atomically(path / CSV, csv_bytes(rows, odd), overwrite=True)
    return Fleet(rows, odd, notes, work.kept)


def check_names(names: Iterable[tuple[str, str]]) -> None:
    """Refuse names that cannot be those of folders, or that two robots have.

    Args:
        names: Each with where it stands, for the message.

    Raises:
        CalibError: One of them.
    """
    seen: dict[str, str] = {}
    for name, where in names:
        if not _NAME.fullmatch(name) or _RESERVED.fullmatch(name):
            raise CalibError(
                f"{where}: the name {name!r} cannot be that of a folder. A name has 1 to 100 letters, digits, and '_', "
                "'-', '+', '.' or blanks between them, and is none that systems keep for themselves."
            )
        if name.casefold() in seen:
            raise CalibError(
                f"{where}: the name '{name}' is that of another robot ({seen[name.casefold()]}), capitals aside. "
                "Give each robot a name of its own."
            )
        seen[name.casefold()] = where


class _Work:
    """The robots of a run: read one by one, and finished in any order."""

    def __init__(
        self,
        robots: Sequence[FleetRobot],
        path: Path,
        options: FleetOptions,
        force: bool,
        progress: Progress,
    ) -> None:
        """Begin."""
        self.robots, self.path, self.options = robots, path, options
        self.force, self.progress = force, progress
        self.rows: dict[str, FleetRow] = {}
        self.kept = 0
        self._sent: list[tuple[str, str]] = []

    def jobs(self) -> Iterator[tuple[str, FleetInputs]]:
        """The robots that are to be calibrated, read when they are asked for."""
        urdf_of = urdf_reader()
        for robot in self.robots:
            try:
                inputs = robot.load(urdf_of)
            except CalibError as error:
                self._fail(robot.name, str(error))
                continue
            except Exception as error:  # noqa: BLE001  a fault with one robot must not cost the others
                self._fail(robot.name, fault(error))
                continue
            told = inputs_fingerprint(robot.name, inputs, self.options)
            row = None if self.force else finished_row(self.path / robot.name, told)
            if row is None:
                self._sent.append((robot.name, told))
                yield robot.name, inputs
            else:
                self.kept += 1
                self._settle(row)

    def finish(self, number: int, result: Made | str) -> None:
        """Write a robot's folder, or note why there is none."""
        name, told = self._sent[number]
        if isinstance(result, str):
            self._fail(name, result)
            return
        try:
            _write_folder(self.path / name, told, result.row, result.files)
        except CalibError as error:
            self._fail(name, str(error))
        else:
            self._settle(result.row)

    def _fail(self, name: str, message: str) -> None:
        """Note a robot without a result; one of earlier inputs stays."""
        status = STALE if (self.path / name / MADE).exists() else FAILED
        self._settle(FleetRow(name, status, message))

    def _settle(self, row: FleetRow) -> None:
        """Keep a robot's row."""
        self.rows[row.name] = row
        self.progress(len(self.rows), len(self.robots))


def finished_row(folder: Path, told: str) -> FleetRow | None:
    """The row of a robot whose folder was made of these inputs, and is finished; None of any other.

    Args:
        folder: The robot's.
        told: The fingerprint of its inputs.
    """
    try:
        table = json.loads((folder / MADE).read_bytes())
        if table["schema"] != SCHEMA or table["fingerprint"] != told:
            return None
        if not all((folder / name).is_file() for name in table["files"]):
            return None
        return FleetRow.read(table["row"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write_folder(folder: Path, told: str, row: FleetRow, files: Mapping[str, bytes]) -> None:
    """Write a robot's files: first that they are a fleet's and not finished, at last that they are.

    Raises:
        FileError: One cannot be written, or something else than a fleet has written it.
    """
    make_folder(folder)
    strange = [name for name in files if (folder / name).exists()]
    if strange and not (folder / MADE).exists():
        raise FileError(
            f"{folder / strange[0]} exists already, and no fleet has written it. Move it away."
        )
    table = {"schema": SCHEMA, "fingerprint": "", "files": [*files], "row": row.table()}
    write_atomically(folder / MADE, json_bytes(table), overwrite=True)
    for name, data in files.items():
        write_atomically(folder / name, data, overwrite=True)
    write_atomically(folder / MADE, json_bytes({**table, "fingerprint": told}), overwrite=True)
