"""run_fleet: calibrate many robots, each from its own data into its own folder, and compare them with each other.

Robots are read when their turn has come and calibrated in any executor; the process that reads the inputs writes the
files too, so that workers on other machines need no shared disk. A robot that fails has a row with the reason, and the
others are finished. Robots whose folder is finished and whose inputs have not changed are kept, see
`calib.verbs.fleet.robot_folder`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from calib.basics.files import make_folder, write_atomically
from calib.basics.jobs import Progress, run
from calib.basics.json_files import json_bytes, plain
from calib.basics.values import one_line
from calib.errors import CalibError
from calib.robot.urdf import read_urdf
from calib.verbs.fleet.fleet_robot import FleetRobot, check_names
from calib.verbs.fleet.job import (
    FleetJob,
    FleetJobResult,
    FleetOptions,
    calibrate_job,
    failed_row,
)
from calib.verbs.fleet.outliers import FleetOutlier, fleet_outliers
from calib.verbs.fleet.record import (
    ACCEPTED,
    FAILED,
    ROWS,
    WITHHELD,
    FleetRow,
    csv_bytes,
)
from calib.verbs.fleet.robot_folder import RobotFolder

#: The table of a fleet for a spreadsheet; see docs/fleet.md.
CSV = "fleet.csv"

#: The table of a fleet for a program; see docs/fleet.md.
JSON = "fleet.json"

#: Schema of ``fleet.json``.
SCHEMA = "fleet 3"

#: URDFs kept in memory while the robots are read: those of a fleet have few, and use them one after the other.
_KEPT_URDFS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """Many robots, calibrated and compared."""

    #: One for each robot, in their order
    rows: tuple[FleetRow, ...]
    #: Robots unlike the others, a figure each; see `calib.verbs.fleet.outliers`
    outliers: tuple[FleetOutlier, ...]
    #: Comparisons that were not possible
    notes: tuple[str, ...]
    #: Number of robots taken from an earlier run
    kept: int

    def __repr__(self) -> str:
        """Return one line: numbers of robots, of those that failed, are withheld, are unlike the others, were kept."""
        counts = {
            "robots": len(self.rows),
            "failed": len(self.failed),
            "withheld": len(self.withheld),
            "outliers": len({outlier.name for outlier in self.outliers}),
            "kept": self.kept,
        }
        return one_line("Fleet", *(f"{count} {what}" for what, count in counts.items()))

    @property
    def failed(self) -> tuple[FleetRow, ...]:
        """The robots without a result of these inputs."""
        return tuple(row for row in self.rows if row.status == FAILED)

    @property
    def withheld(self) -> tuple[FleetRow, ...]:
        """The robots that have no corrected URDF, because their verdict is ``do not use``."""
        return tuple(row for row in self.rows if row.urdf == WITHHELD)

    @property
    def accepted(self) -> tuple[FleetRow, ...]:
        """The robots whose corrected URDF was written in spite of the verdict ``do not use``."""
        return tuple(row for row in self.rows if row.urdf == ACCEPTED)

    def table(self) -> dict[str, Any]:
        """Return the content of ``fleet.json``: SI units, with the unit in the keys."""
        robots = [ROWS.table(row) for row in self.rows]
        outliers = [asdict(outlier) for outlier in self.outliers]
        return {
            "schema": SCHEMA,
            "robots": plain(robots),
            "outliers": plain(outliers),
            "notes": [*self.notes],
        }


def run_fleet(
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
    fails the folder stays as it was. One whose verdict is ``do not use`` gets no corrected URDF, unless
    ``options.accept`` is set, and an earlier one is removed.

    Args:
        robots: The robots.
        folder: Folder of the results; it is made if missing.
        options: Options for all robots; None: the defaults.
        executor: Where the robots are calibrated; None: in this process, one after the other. Any of
            `concurrent.futures`, or Dask's ``Client.get_executor()``.
        progress: Called after each robot with the numbers of robots done and of all robots.
        force: Whether finished robots are calibrated anew.

    Returns:
        A row for each robot, and the outliers among them.

    Raises:
        CalibError: Names that cannot be those of folders or belong to two, or a worker was killed.
        FileError: The folder cannot be written.
    """
    check_names((robot.name, f"Robot {i}") for i, robot in enumerate(robots, 1))
    path = make_folder(folder)
    options = options or FleetOptions()
    state = _Run(path, options, len(robots), progress)
    jobs = state.jobs(robots, force=force)
    for number, result in run(calibrate_job, options, jobs, executor):
        state.write(number, result)
    calibrated = state.compared(robots)
    _write_tables(calibrated, path)
    return calibrated


class _Run:
    """A run of `run_fleet`: reads the robots, writes their files, and collects their rows in any order."""

    def __init__(
        self,
        folder: Path,
        options: FleetOptions,
        count: int,
        progress: Progress | None,
    ) -> None:
        """Begin a run; ``count`` is the number of all robots, the others are as of `run_fleet`."""
        self._folder = folder
        self._options = options
        self._count = count
        self._progress = progress
        #: Folder and fingerprint of each job, in the order of the jobs
        self._sent: list[tuple[RobotFolder, str]] = []
        #: Rows of the robots that are done, by name
        self._rows: dict[str, FleetRow] = {}
        #: Number of robots taken from an earlier run
        self._kept = 0

    def jobs(self, robots: Sequence[FleetRobot], *, force: bool) -> Iterator[FleetJob]:
        """Read one robot after the other, and yield those that must be calibrated.

        Args:
            robots: All robots.
            force: Whether finished robots are calibrated anew.

        Yields:
            The jobs. Robots that cannot be read and those that are kept get their row here.
        """
        read_robot = lru_cache(maxsize=_KEPT_URDFS)(read_urdf)
        for robot in robots:
            try:
                nominal, measurements, cell = robot.load(read_robot)
            except Exception as error:  # noqa: BLE001  a fault with one robot must not cost the others
                self._add(failed_row(robot.name, error))
                continue
            job = FleetJob(robot.name, nominal, measurements, cell)
            folder = RobotFolder(self._folder / robot.name)
            fingerprint = job.fingerprint(self._options)
            row = None if force else self._kept_row(folder, fingerprint)
            if row is None:
                self._sent.append((folder, fingerprint))
                yield job
            else:
                self._kept += 1
                self._add(row)

    def write(self, number: int, result: FleetJobResult) -> None:
        """Write the files of a calibrated robot, and add its row; if they cannot be written, a failed one.

        Args:
            number: Number of the job, from 0, in the order of `jobs`.
            result: Its result.
        """
        row = result.row
        folder, fingerprint = self._sent[number]
        if row.status != FAILED:
            try:
                folder.write(fingerprint, row, result.files)
            except CalibError as error:
                row = failed_row(row.name, error)
        self._add(row)

    def compared(self, robots: Sequence[FleetRobot]) -> Fleet:
        """Return the fleet when all robots are done, their rows in the order of ``robots``."""
        rows = tuple(self._rows[robot.name] for robot in robots)
        outliers, notes = fleet_outliers(rows)
        return Fleet(rows, outliers, notes, self._kept)

    def _kept_row(self, folder: RobotFolder, fingerprint: str) -> FleetRow | None:
        """Return the row of a finished robot if also its URDF is as ``accept`` has it; None: it must be calibrated."""
        row = folder.finished_row(fingerprint)
        contrary = WITHHELD if self._options.accept else ACCEPTED
        if row is None or row.urdf == contrary:
            return None
        return row

    def _add(self, row: FleetRow) -> None:
        """Add the row of a robot that is done."""
        self._rows[row.name] = row
        if self._progress is not None:
            self._progress(len(self._rows), self._count)


def _write_tables(calibrated: Fleet, folder: Path) -> None:
    """Write ``fleet.json`` and ``fleet.csv``."""
    content = json_bytes(calibrated.table())
    write_atomically(folder / JSON, content, overwrite=True)
    reasons = _reasons(calibrated.outliers)
    content = csv_bytes(calibrated.rows, reasons)
    write_atomically(folder / CSV, content, overwrite=True)


def _reasons(outliers: Sequence[FleetOutlier]) -> Mapping[str, Sequence[str]]:
    """Return the texts of the outliers by the robot's name."""
    texts: dict[str, list[str]] = {}
    for outlier in outliers:
        texts.setdefault(outlier.name, []).append(outlier.text)
    return texts
