"""`calib.fleet`: robots and tables as users have them, calibrated and compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeAlias

from calib.basics.arguments import check_callable, check_executor, check_type, wrong_type
from calib.basics.jobs import Progress
from calib.data.cell import Cell
from calib.data.inputs import CELL, ROBOT, TABLE, CellInput, RobotInput, TableInput
from calib.data.measurements import Measurements
from calib.errors import ArgumentError, CalibError, choices, did_you_mean
from calib.numerics import solvers
from calib.robot.robot import Robot
from calib.verbs.fleet.fleet import Fleet, run_fleet
from calib.verbs.fleet.fleet_robot import FleetRobot
from calib.verbs.fleet.job import FleetOptions

#: One robot for all tables, one for each table by its name, or one for each in their order.
RobotsInput: TypeAlias = RobotInput | Mapping[str, RobotInput] | Sequence[RobotInput]

#: One cell for all robots, or one for each by its name.
CellsInput: TypeAlias = CellInput | Mapping[str, CellInput]

#: Options that `fleet` takes by name; the command is that of the command line.
_OPTIONS = tuple(field.name for field in fields(FleetOptions) if field.name != "command")


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
        cell: The measurement setup of all robots, or the path of a cell file; or one for each, by the robot's name;
            None: the default `Cell`.
        executor: Where the robots are calibrated; None: in this process, one after the other. Any of
            `concurrent.futures`, or Dask's ``Client.get_executor()``.
        progress: Called after each robot with the numbers of robots done and of all robots.
        force: Whether finished robots are calibrated anew.
        **options: ``solver``, ``robust`` and ``validate`` as of `calib.calibrate`; ``reports``, whether each robot gets
            a report (True), which takes longer than its fit; ``target_link``, whether corrected URDFs get a link at the
            target (False); ``accept``, whether they are written also where the verdict is ``do not use`` (False).

    Returns:
        A row for each robot, and the outliers among them.

    Raises:
        ArgumentError: An argument of another type, or an option that there is not.
        CalibError: Names that cannot be those of folders, robots that are not those of the tables, or a worker was
            killed.
        FileError: The folder cannot be written.

    Example:
        fleet = calib.fleet("ur3", {"SN-1": "1.csv", "SN-2": "2.csv"}, "results", reports=False)
    """
    chosen = _options(options)
    check_type("tables", tables, Mapping, f"a mapping from names of robots to {TABLE}")
    check_type("folder", folder, (str, Path), "the path of a folder")
    check_executor(executor)
    check_callable("progress", progress)
    by_name = _robots_by_name(robots, tables)
    cells = _cells_by_name(cell, tables)
    members = []
    for name, table in tables.items():
        check_type("tables", name, str, "a mapping from names of robots, which are texts")
        check_type(f"tables[{name!r}]", table, (Measurements, str, Path), TABLE)
        members.append(FleetRobot.of_values(name, by_name[name], table, cells[name]))
    return run_fleet(members, folder, chosen, executor=executor, progress=progress, force=force)


def _options(given: Mapping[str, Any]) -> FleetOptions:
    """Return the options of a fleet; ArgumentError for one that there is not, or of another type."""
    defaults = FleetOptions()
    for name, value in given.items():
        if name not in _OPTIONS:
            raise ArgumentError(
                f"There is no option '{name}' of a fleet{did_you_mean(name, _OPTIONS)}; there are {choices(_OPTIONS)}."
            )
        kind = type(getattr(defaults, name))
        check_type(name, value, kind, "True or False" if kind is bool else "the name of a solver")
        if name == "solver":
            solvers.check_name(value)
    return FleetOptions(**given)


def _robots_by_name(
    robots: RobotsInput, tables: Mapping[str, TableInput]
) -> Mapping[str, RobotInput]:
    """Return the robot of each table by the table's name."""
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


def _cells_by_name(cell: CellsInput, tables: Mapping[str, TableInput]) -> Mapping[str, CellInput]:
    """Return the cell of each robot by its name."""
    if not isinstance(cell, Mapping):
        check_type("cell", cell, (Cell, str, Path, type(None)), f"{CELL}; or a mapping of these")
        return dict.fromkeys(tables, cell)
    _check_all_given("cell", cell, tables)
    for name, one in cell.items():
        check_type(f"cell[{name!r}]", one, (Cell, str, Path, type(None)), CELL)
    return cell


def _check_all_given(
    argument: str, given: Mapping[str, Any], tables: Mapping[str, TableInput]
) -> None:
    """Refuse a mapping that lacks one of the tables' names, or has another one."""
    missing = [name for name in tables if name not in given]
    others = [str(name) for name in given if name not in tables]
    if missing or others:
        faults = [f"lacks {choices(missing)}"] * bool(missing)
        faults += [f"has {choices(others)}, of which there is no table"] * bool(others)
        raise CalibError(
            f"The argument '{argument}' {' and '.join(faults)}; its names must be those of 'tables'."
        )
