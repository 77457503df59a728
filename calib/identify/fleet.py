"""fleet: many robots calibrated, each from its own data into a folder of its own, and compared with each other.

Robots are read when their turn has come and calibrated in any executor; what is kept of each is its row of the fleet's
table. A robot that fails is told with its reason, and the others are finished; what earlier runs have made of it stays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

from calib.errors import CalibError
from calib.identify.executors import Lost, run
from calib.identify.fleet_folder import (
    check_names,
    check_own,
    holds_result,
    kept_row,
    results_folder,
    strangers,
    write_folder,
)
from calib.identify.fleet_odd import Odd, odd_ones
from calib.identify.fleet_robot import (
    FleetInputs,
    FleetOptions,
    FleetRobot,
    Made,
    calibrate_one,
    fault,
    file_names,
    inputs_fingerprint,
    urdf_reader,
)
from calib.identify.fleet_rows import DONE, FAILED, STALE, FleetRow
from calib.identify.fleet_tables import check_tables, write_tables
from calib.model.urdf import Urdf

__all__ = ["Fleet", "FleetOptions", "FleetRobot", "fleet"]

Progress = Callable[[int, int], None]
Job = tuple[str, FleetInputs]


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """Many robots, calibrated.

    Attributes:
        rows: One for each robot, in their order.
        odd: What is odd about which of them, see `calib.identify.fleet_odd`.
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

    A robot whose folder an earlier run has made of the same inputs, options and versions is kept as it is, also if it
    has more than is asked for: a report or a cross-validation. Of one that fails the folder stays as it was. Files are
    the same to the bit in any executor, but for the dates of reports, see `FleetOptions.date`.

    Args:
        robots: The robots.
        folder: Where to; it is made if missing.
        options: How they are calibrated.
        executor: Where; None: here, one after the other. Such as `calib.identify.processes.process_executor` or
            `calib.identify.dask_executor.dask_executor`.
        progress: Called after each robot.
        force: Whether all are calibrated anew.

    Raises:
        CalibError: No robots, names that are no names of folders or those of two, or an executor that has ended.
        FileError: The folder cannot be written, or another run has it.
    """
    if not robots:
        message = "There are no robots to calibrate; give one or more."
        raise CalibError(message)
    check_names((robot.name, f"Robot {i}") for i, robot in enumerate(robots, 1))
    path, options = Path(folder), _dated(options or FleetOptions())
    with results_folder(path):
        check_tables(path)
        work = _Work(robots, path, options, force, progress or (lambda *_: None))
        for number, result in run(calibrate_one, options, work.jobs(), executor):
            work.finish(number, result)
        rows = tuple(work.rows[robot.name] for robot in robots)
        odd, notes = odd_ones(rows)
        if work.gone:
            notes = (
                *notes,
                f"Removed, for the new results have no such file: {', '.join(work.gone)}.",
            )
        others = strangers(path, work.rows)
        if others:
            notes = (*notes, _others(others, path))
        write_tables(path, rows, odd, notes)
    return Fleet(rows, odd, notes, work.kept)


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
        self.gone: list[str] = []
        self._sent: list[tuple[str, str]] = []

    def jobs(self) -> Iterator[Job]:
        """The robots that are to be calibrated, read when they are asked for."""
        urdf_of = urdf_reader()
        for robot in self.robots:
            inputs = self._inputs(robot, urdf_of)
            if inputs is None:
                continue
            told = inputs_fingerprint(robot.name, inputs, self.options)
            row = None if self.force else self._kept(robot.name, inputs, told)
            if row is None:
                self._sent.append((robot.name, told))
                yield robot.name, inputs
            else:
                self.kept += 1
                self._settle(row)

    def finish(self, number: int, result: Made | str | Lost) -> None:
        """Write a robot's folder, or note why there is none."""
        name, told = self._sent[number]
        if not isinstance(result, Made):
            self._fail(name, result.reason if isinstance(result, Lost) else result)
            return
        try:
            gone = write_folder(self.path / name, told, result.row, result.files)
        except CalibError as error:
            self._fail(name, str(error))
        else:
            self.gone += [f"{name}/{file}" for file in gone]
            self._settle(result.row)

    def _kept(self, name: str, inputs: FleetInputs, told: str) -> FleetRow | None:
        """The row of a robot that an earlier run has finished, if there is all that is asked for."""
        wanted = {told}
        if not self.options.validate:
            wanted.add(inputs_fingerprint(name, inputs, replace(self.options, validate=True)))
        return kept_row(self.path / name, wanted, file_names(self.options))

    def _inputs(self, robot: FleetRobot, urdf_of: Callable[[str], Urdf]) -> FleetInputs | None:
        """What was read of a robot; None, and a note, where that fails."""
        try:
            check_own(self.path / robot.name)
            return robot.load(urdf_of)
        except CalibError as error:
            self._fail(robot.name, str(error))
        except Exception as error:  # noqa: BLE001  a fault with one robot must not cost the others
            self._fail(robot.name, fault(error))
        return None

    def _fail(self, name: str, message: str) -> None:
        """Note a robot without a result; one of earlier inputs stays."""
        status = STALE if holds_result(self.path / name) else FAILED
        self._settle(FleetRow(name, status, message))

    def _settle(self, row: FleetRow) -> None:
        """Keep a robot's row."""
        self.rows[row.name] = row
        self.progress(len(self.rows), len(self.robots))


def _dated(options: FleetOptions) -> FleetOptions:
    """The options with the date of now, where reports are to bear one and none was given."""
    if options.date or not options.reports:
        return options
    from calib.show.report import report_date

    return replace(options, date=report_date())


def _others(names: Sequence[str], path: Path) -> str:
    """That results of other robots lie there too."""
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return (
        f"{path} also holds the results of robots that are not in this fleet, and that are no part of what is said of "
        f"it: {', '.join(names[:5])}{more}."
    )
