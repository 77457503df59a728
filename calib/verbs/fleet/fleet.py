"""Calibrate many robots, each from its own data into its own folder, and compare them with each other.

Robots are read when their turn has come and calibrated in any executor; the process that reads the inputs writes the
files too, so that workers on other machines need no shared disk. A robot that fails has a row with the reason, and the
others are finished. Robots whose folder is finished and whose inputs have not changed are kept, see
`calib.verbs.fleet.robot_folder`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

from calib.basics.arguments import check_callable, check_executor, check_type, wrong_type
from calib.basics.files import make_folder, write_atomically
from calib.basics.jobs import Progress, run
from calib.basics.json_files import json_bytes, plain
from calib.basics.values import one_line
from calib.data.cell import Cell
from calib.data.inputs import CELL, ROBOT, TABLE, CellInput, RobotInput, TableInput
from calib.data.measurements import Measurements
from calib.errors import ArgumentError, CalibError, choices, did_you_mean
from calib.numerics import solvers
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.show.plotting import require_matplotlib
from calib.verbs.fleet.fleet_row import ACCEPTED, FAILED, ROW_LAYOUT, WITHHELD, FleetRow, fleet_csv
from calib.verbs.fleet.job import (
    FleetJob,
    FleetOptions,
    FleetRobot,
    calibrate_job,
    check_names,
    failed_row,
)
from calib.verbs.fleet.outliers import FleetOutlier, fleet_outliers
from calib.verbs.fleet.robot_folder import RobotFolder

#: The table of a fleet for a spreadsheet; see docs/fleet.md.
CSV = "fleet.csv"

#: The table of a fleet for a program; see docs/fleet.md.
JSON = "fleet.json"

#: Schema of ``fleet.json``.
SCHEMA = "fleet 4"

#: URDFs kept in memory while the robots are read: those of a fleet have few, and use them one after the other.
_KEPT_URDFS = 8

#: One robot for all tables, one for each table by its name, or one for each in their order.
RobotsInput: TypeAlias = RobotInput | Mapping[str, RobotInput] | Sequence[RobotInput]

#: One cell for all robots, or one for each by its name.
CellsInput: TypeAlias = CellInput | Mapping[str, CellInput]

#: Options that `fleet` takes by name; the command is that of the command line.
_OPTIONS = tuple(field.name for field in fields(FleetOptions) if field.name != "command")


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
        robots = [ROW_LAYOUT.table(row) for row in self.rows]
        outliers = [asdict(outlier) for outlier in self.outliers]
        return {
            "schema": SCHEMA,
            "robots": plain(robots),
            "outliers": plain(outliers),
            "notes": [*self.notes],
        }


def fleet(
    robots: RobotsInput,
    tables: Mapping[str, TableInput],
    folder: str | Path,
    *,
    cell: CellsInput = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    force: bool = False,
    **options: Any,  # noqa: ANN401  as of FleetOptions
) -> Fleet:
    """Calibrate many robots into a folder: one of its own for each, and the tables ``fleet.csv`` and ``fleet.json``.

    A robot whose folder an earlier run has made of the same inputs, options and version is kept as it is. Of one that
    fails the folder stays as it was, and the others are finished. One whose verdict is ``do not use`` gets no corrected
    URDF, unless ``accept`` is set, and an earlier one is removed.

    Args:
        robots: The nominal robot of all tables: a `Robot`, the path of a URDF or xacro, or a name such as ``"ur3"``; or
            one for each table, by its name or in their order.
        tables: The measurements of each robot, or the path of their table, by the robot's name, which is that of its
            folder.
        folder: Folder of the results; it is made if missing.
        cell: The cell of all robots, or the path of a cell file; or one for each, by the robot's name; None: the
            default `Cell`.
        executor: Where the robots are calibrated; None: in this process, one after the other. Any of
            `concurrent.futures`, or Dask's ``Client.get_executor()``.
        progress: Called after each robot with the numbers of robots done and of all robots.
        force: Whether finished robots are calibrated again.
        **options: ``solver``, ``robust`` and ``validate`` as of `calib.calibrate`; ``reports``, whether each robot gets
            a report (True), which takes longer than its fit; ``target_link``, whether corrected URDFs get a link at the
            target (False); ``accept``, whether they are also written if the verdict is ``do not use`` (False).

    Returns:
        A row for each robot, and the outliers among them.

    Raises:
        ArgumentError: An argument of another type, or an unknown option.
        CalibError: Names that cannot be those of folders, robots or cells that are not those of the tables, no such
            solver, a worker was killed, or reports are asked for and matplotlib is missing.
        FileError: The folder cannot be written.

    Example:
        fleet = calib.fleet("ur3", {"SN-1": "1.csv", "SN-2": "2.csv"}, "results", reports=False)
    """
    defaults = FleetOptions()
    for name, value in options.items():
        if name not in _OPTIONS:
            raise ArgumentError(
                f"There is no option '{name}' of a fleet{did_you_mean(name, _OPTIONS)}; there are {choices(_OPTIONS)}."
            )
        kind = type(getattr(defaults, name))
        check_type(name, value, kind, "True or False" if kind is bool else "the name of a solver")
        if name == "solver":
            solvers.check_name(value)
    check_type("tables", tables, Mapping, f"a mapping from names of robots to {TABLE}")
    check_type("folder", folder, (str, Path), "the path of a folder")
    check_executor(executor)
    check_callable("progress", progress)
    robots_by_name = _robots_by_name(robots, tables)
    if isinstance(cell, Mapping):
        _check_all_given("cell", cell, tables)
        cells = cell
        for name, one in cells.items():
            check_type(f"cell[{name!r}]", one, (Cell, str, Path, type(None)), CELL)
    else:
        check_type("cell", cell, (Cell, str, Path, type(None)), f"{CELL}; or a mapping of these")
        cells = dict.fromkeys(tables, cell)

    members = []
    for name, table in tables.items():
        check_type("tables", name, str, "a mapping from names of robots, which are texts")
        check_type(f"tables[{name!r}]", table, (Measurements, str, Path), TABLE)
        members.append(FleetRobot.of_values(name, robots_by_name[name], table, cells[name]))
    chosen = FleetOptions(**options)
    return run_fleet(members, folder, chosen, executor=executor, progress=progress, force=force)


def _robots_by_name(
    robots: RobotsInput, tables: Mapping[str, TableInput]
) -> Mapping[str, RobotInput]:
    """Return the robot of each table by the table's name, whichever way the robots were given.

    Raises `ArgumentError` for another type, and `CalibError` if they are not one for all or one for each table.
    """
    if isinstance(robots, (Robot, str, Path)):
        return dict.fromkeys(tables, robots)
    if isinstance(robots, Mapping):
        _check_all_given("robots", robots, tables)
        by_name = dict(robots)
    elif isinstance(robots, Sequence):
        if len(robots) != len(tables):
            raise CalibError(
                f"The numbers of robots ({len(robots)}) and of tables ({len(tables)}) differ: give one robot for all, "
                "or one for each."
            )
        by_name = dict(zip(tables, robots, strict=True))
    else:
        raise wrong_type("robots", robots, f"{ROBOT}; or a mapping or sequence of these")
    for name, robot in by_name.items():
        check_type(f"robots[{name!r}]", robot, (Robot, str, Path), ROBOT)
    return by_name


def _check_all_given(
    argument: str, given: Mapping[str, Any], tables: Mapping[str, TableInput]
) -> None:
    """Refuse by a `CalibError` a mapping that lacks one of the tables' names, or has another one."""
    missing = [name for name in tables if name not in given]
    others = [str(name) for name in given if name not in tables]
    if missing or others:
        faults = [f"lacks {choices(missing)}"] * bool(missing)
        faults += [f"has {choices(others)}, without a table"] * bool(others)
        raise CalibError(
            f"The argument '{argument}' {' and '.join(faults)}; its names must be those of 'tables'."
        )


def run_fleet(
    robots: Sequence[FleetRobot],
    folder: str | Path,
    options: FleetOptions | None = None,
    *,
    executor: Executor | None = None,
    progress: Progress | None = None,
    force: bool = False,
) -> Fleet:
    """Calibrate many robots into a folder, as `fleet` does.

    Args:
        robots: The robots.
        folder: Folder of the results; it is made if missing.
        options: Options for all robots; None: the defaults.
        executor: Where the robots are calibrated; None: in this process, one after the other. Any of
            `concurrent.futures`, or Dask's ``Client.get_executor()``.
        progress: Called after each robot with the numbers of robots done and of all robots.
        force: Whether finished robots are calibrated again.

    Returns:
        A row for each robot, and the outliers among them.

    Raises:
        CalibError: Names that cannot be those of folders or belong to two, a worker was killed, or reports are asked
            for and matplotlib is missing.
        FileError: The folder cannot be written.
    """
    check_names((robot.name, f"Robot {i}") for i, robot in enumerate(robots, 1))
    chosen = options or FleetOptions()
    if chosen.reports:
        require_matplotlib("A report")
    path = make_folder(folder)
    rows: dict[str, FleetRow] = {}  # of the robots that are done, in any order
    # Folder and fingerprint of each job, in the order of the jobs.
    sent: list[tuple[RobotFolder, str]] = []
    kept = 0

    def finish(row: FleetRow) -> None:
        """Add the row of a robot that is done."""
        rows[row.name] = row
        if progress is not None:
            progress(len(rows), len(robots))

    def jobs() -> Iterator[FleetJob]:
        """Read one robot after the other, and yield those that must be calibrated; finish the others."""
        nonlocal kept
        read_robot = lru_cache(maxsize=_KEPT_URDFS)(read_urdf)
        for robot in robots:
            try:
                job = FleetJob(robot.name, *robot.load(read_robot))
            except Exception as error:  # noqa: BLE001  a fault with one robot must not cost the others
                finish(failed_row(robot.name, error))
                continue
            robot_folder = RobotFolder(path / robot.name)
            fingerprint = job.fingerprint(chosen)
            row = None if force else robot_folder.finished_row(fingerprint)
            # A finished robot is kept if its URDF is there or not as `accept` has it.
            contrary = WITHHELD if chosen.accept else ACCEPTED
            if row is None or row.urdf == contrary:
                sent.append((robot_folder, fingerprint))
                yield job
            else:
                kept += 1
                finish(row)

    for number, (row, files) in run(calibrate_job, chosen, jobs(), executor):
        robot_folder, fingerprint = sent[number]
        if row.status != FAILED:
            try:
                robot_folder.write(fingerprint, row, files)
            except CalibError as error:
                row = failed_row(row.name, error)
        finish(row)

    in_order = tuple(rows[robot.name] for robot in robots)
    outliers, notes = fleet_outliers(in_order)
    calibrated = Fleet(in_order, outliers, notes, kept)
    write_atomically(path / JSON, json_bytes(calibrated.table()), overwrite=True)
    reasons: dict[str, list[str]] = {}
    for outlier in outliers:
        reasons.setdefault(outlier.name, []).append(outlier.text)
    write_atomically(path / CSV, fleet_csv(in_order, reasons), overwrite=True)
    return calibrated
