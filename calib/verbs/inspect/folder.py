"""What is in a folder: robots, tables, cells, boards, results, pictures; what belongs together, and what comes next.

Everything is told by its content, and what belongs together by trying it: a table fits a robot if it is read with the
robot's joints; a result is of the URDF and of the table whose hashes it states; a corrected URDF is of the result whose
run it carries.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import count
from pathlib import Path

from calib.basics.files import read_bytes
from calib.basics.tables import Table
from calib.basics.units import split_header
from calib.boards.board_file import read_board
from calib.boards.detection.picture import ENDINGS as PICTURES
from calib.camera.camera_file import read_camera
from calib.data.cell import Cell
from calib.data.cell_chains import robot_of_cell, sights_of
from calib.data.columns import POINT, column_names
from calib.data.measurements import Measurements
from calib.data.points_file import read_points
from calib.errors import CalibError
from calib.result.calibration import Calibration
from calib.robot.dh_columns import is_dh_table
from calib.robot.urdf import Urdf, read_urdf
from calib.verbs.compensate.programs.dialects import DIALECTS

#: Folders of folders are looked into so far.
_DEEPEST = 2

#: More files than these, besides pictures, are not looked at.
_MOST = 300

#: Beginnings of names of files that are hidden, and of folders that no one keeps measurements in.
_SKIPPED = (".", "_", "node_modules", "site-packages")

#: Endings of files by what they may be; pictures and recordings are told by these alone.
_TABLES = (".csv", ".tsv", ".xlsx", ".xlsm")
_TEXTS = (".txt", ".dat", ".asc")
_RECORDINGS = (".bag", ".mcap", ".db3")
_PAGES = (".html", ".htm", ".pdf")

#: The columns that tell a manifest of a fleet, and that of sweeps of single joints.
_MANIFEST = {"robot", "data"}
_SWEEP = "sweep"


class What(Enum):
    """Kind of an entry of a folder."""

    ROBOT = "robot"
    TABLE = "table"
    POINTS = "points"
    SWEEPS = "sweeps"
    MANIFEST = "manifest"
    CELL = "cell"
    BOARD = "board"
    CAMERA = "camera"
    FACTORY = "factory"
    RESULT = "result"
    OUTPUT = "output"  # another file of calib's own
    PICTURES = "pictures"
    RECORDING = "recording"
    PROGRAM = "program"
    PAGE = "page"
    FAULTY = "faulty"


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """One file of a folder, or the pictures of one folder."""

    #: Its path, below the folder as it was given
    path: Path
    #: What it is
    what: What
    #: Its content, of a robot, a table, a cell, a result
    content: Urdf | Table | Cell | Calibration | None = None
    #: Number of rows, points or pictures
    count: int = 0
    #: What is wrong with it, of a faulty one; what it is, of another output of calib
    said: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A table that is read with the joints of a robot."""

    #: The robot
    robot: Entry
    #: The table
    table: Entry
    #: The cell with which it is read; None: without one
    cell: Entry | None
    #: The list with its points; None: it has them
    points: Entry | None
    #: Number of its measured rows
    rows: int


@dataclass(frozen=True, slots=True, eq=False)
class Folder:
    """Content of a folder."""

    #: The folder, as it was given
    path: Path
    #: Its entries, in the order of their paths
    entries: tuple[Entry, ...]
    #: The tables that fit robots
    fits: tuple[Fit, ...]
    #: Tables that fit no robot, with why the first robot does not take them
    misfits: tuple[tuple[Entry, str], ...]
    #: Of each result the robots and tables that it was made of, or that it made
    of_result: tuple[tuple[Entry, tuple[Entry, ...]], ...]
    #: What comes next, to be pasted; the most likely first
    commands: tuple[str, ...]
    #: Number of files that were not looked at
    left_out: int = 0


def look_into(path: Path) -> Folder:
    """Look into a folder.

    Args:
        path: The folder.

    Returns:
        What is there, what of it belongs together, and the next commands.
    """
    every = list(_files(path))
    files = [file for file in every if file.suffix.lower() not in PICTURES]
    entries = [entry for file in files[:_MOST] for entry in _entries(file)]
    entries += _pictures(every)
    entries.sort(key=lambda entry: entry.path)
    robots = [entry for entry in entries if entry.what is What.ROBOT]
    tables = [entry for entry in entries if entry.what is What.TABLE]
    cells = [entry for entry in entries if entry.what is What.CELL]
    points = [entry for entry in entries if entry.what is What.POINTS]
    results = [entry for entry in entries if entry.what is What.RESULT]

    fits: list[Fit] = []
    misfits: list[tuple[Entry, str]] = []
    # A corrected URDF takes the same tables as the one that it was made from.
    nominal = [robot for robot in robots if not _run(robot)] or robots
    for table in tables:
        if names_images(table):
            continue  # of pictures, which are to be searched first
        why = ""
        for robot in nominal:
            fit = _fit(robot, table, cells, points)
            if isinstance(fit, Fit):
                fits.append(fit)
            why = why or (fit if isinstance(fit, str) else "")
        if why and not any(fit.table is table for fit in fits):
            misfits.append((table, why))
    of_result = tuple((result, _parts(result, robots, tables)) for result in results)
    folder = Folder(path, tuple(entries), tuple(fits), tuple(misfits), of_result, ())
    return replace(folder, commands=tuple(_commands(folder)), left_out=max(0, len(files) - _MOST))


def _files(folder: Path, depth: int = 0) -> Iterator[Path]:
    """Yield the files of a folder and of those in it, in order, without what begins as a name of `_SKIPPED`."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith(_SKIPPED):
            continue
        if path.is_dir() and depth < _DEEPEST:
            yield from _files(path, depth + 1)
        elif path.is_file():
            yield path


def _pictures(files: Sequence[Path]) -> Iterator[Entry]:
    """Yield an entry for each folder with pictures."""
    counts: dict[Path, int] = {}
    for file in files:
        if file.suffix.lower() in PICTURES:
            counts[file.parent] = counts.get(file.parent, 0) + 1
    for folder, number in counts.items():
        yield Entry(folder, What.PICTURES, count=number)


def _entries(path: Path) -> Iterator[Entry]:
    """Yield what a file is; nothing for one that calib does not read."""
    suffix = path.suffix.lower()
    try:
        if suffix in (".urdf", ".xacro") or (suffix == ".xml" and _is_robot(path)):
            yield Entry(path, What.ROBOT, read_urdf(path))
        elif suffix in _TABLES:
            yield _table(path)
        elif suffix in _TEXTS:
            yield from _text(path)
        elif suffix == ".toml":
            yield _toml(path)
        elif suffix in (".yaml", ".yml"):
            yield from _board_or_camera(path)
        elif suffix == ".json":
            yield from _json(path)
        elif suffix in _RECORDINGS:
            yield Entry(path, What.RECORDING)
        elif suffix == ".conf" and b"delta_theta" in path.read_bytes():
            yield Entry(path, What.FACTORY)
        elif suffix in DIALECTS:
            yield Entry(path, What.PROGRAM)
        elif suffix in _PAGES:
            yield Entry(path, What.PAGE)
    except CalibError as error:
        yield Entry(path, What.FAULTY, said=str(error))


def _is_robot(path: Path) -> bool:
    """Return True if an XML file begins as a robot does."""
    head = read_bytes(path, "robot")[:4096]
    return b"<robot" in head or b"<mujoco" in head


def _table(path: Path) -> Entry:
    """Return what a table is: measurements or poses, DH rows of a robot, sweeps, or a manifest."""
    table = Table.read(path)
    names = {split_header(label)[0] for label in table.header}
    if is_dh_table(table):
        return Entry(path, What.ROBOT, read_urdf(path))
    if names >= _MANIFEST:
        return Entry(path, What.MANIFEST, count=len(table.cells))
    what = What.SWEEPS if _SWEEP in {name.casefold() for name in names} else What.TABLE
    return Entry(path, what, table, len(table.cells))


def _text(path: Path) -> Iterator[Entry]:
    """Yield the table or the list of points that a text holds; nothing if it holds neither, such as a note."""
    try:
        table = Table.read(path)
    except CalibError:
        table = None
    if table is not None and len(table.cells) and any(split_header(h)[1] for h in table.header):
        yield _table(path)
        return
    try:
        yield Entry(path, What.POINTS, count=len(read_points(path).points))
    except CalibError:
        return


def _toml(path: Path) -> Entry:
    """Return what a TOML file describes: a cell, a board or a camera; what the cell lacks is said if it is none."""
    try:
        return Entry(path, What.CELL, Cell.read(path))
    except CalibError as fault:
        described = next(_board_or_camera(path), None)
        if described is None:
            raise fault from None
        return described


def _board_or_camera(path: Path) -> Iterator[Entry]:
    """Yield the board or the camera that a file describes; nothing if it describes neither."""
    for read, what in ((read_board, What.BOARD), (read_camera, What.CAMERA)):
        try:
            read(path)
        except CalibError:
            continue
        yield Entry(path, what)
        return


def _json(path: Path) -> Iterator[Entry]:
    """Yield the file of calib that JSON is; nothing for that of another program."""
    try:
        value = json.loads(read_bytes(path, "file"))
    except ValueError:
        return
    schema = value.get("schema") if isinstance(value, dict) else None
    if isinstance(schema, int):
        yield Entry(path, What.RESULT, Calibration.read_json(path))
    elif isinstance(schema, str) and schema.startswith("dh "):
        yield Entry(path, What.ROBOT, read_urdf(path))
    elif isinstance(schema, str):
        yield Entry(path, What.OUTPUT, said=schema.rpartition(" ")[0])


# What belongs together


def _run(robot: Entry) -> str:
    """Return the run of calib that a robot's URDF carries; empty for a nominal one."""
    return robot.content.run if isinstance(robot.content, Urdf) else ""


def _fit(robot: Entry, table: Entry, cells: Sequence[Entry], points: Sequence[Entry]) -> Fit | str:
    """Return how a table fits a robot, by the first cell and list of points that do; else why it does not."""
    why = ""
    assert isinstance(table.content, Table)
    names = column_names(table.content) or ()
    elsewhere = () if set(POINT) & {*names} else points  # a table with positions needs no list
    for cell in (*cells, None):
        for listed in (None, *elsewhere):
            fit = _fit_with(robot, table, cell, listed)
            if isinstance(fit, Fit):
                return fit
            why = why or fit
    return why


def _fit_with(robot: Entry, table: Entry, cell: Entry | None, points: Entry | None) -> Fit | str:
    """Return how a table fits a robot with a cell and a list of points, or without; else why it does not."""
    try:
        return Fit(robot, table, cell, points, _measured_rows(robot, table, cell, points))
    except CalibError as error:
        return str(error)


def _measured_rows(robot: Entry, table: Entry, cell: Entry | None, points: Entry | None) -> int:
    """Return the number of rows that are measured; CalibError if the table does not fit the robot."""
    assert isinstance(robot.content, Urdf)
    assert isinstance(table.content, Table)
    stated = cell.content if cell is not None and isinstance(cell.content, Cell) else Cell()
    sights = sights_of(table.content, kind=stated.kind)
    arm = robot_of_cell(robot.content, stated, column_names(table.content), sights)
    measured = Measurements.read(
        table.content,
        arm.joint_names,
        arm.joint_types,
        kind=stated.kind,
        points=None if points is None else points.path,
        needs_all_joints=not arm.branches,
    )
    return len(measured)


def _parts(result: Entry, robots: Sequence[Entry], tables: Sequence[Entry]) -> tuple[Entry, ...]:
    """Return the robot and the table that a result was made of, and the robots that it made."""
    made = result.content
    assert isinstance(made, Calibration)
    found = []
    for robot in robots:
        assert isinstance(robot.content, Urdf)
        if robot.content.sha256 == made.nominal.urdf.sha256 or robot.content.run == made.run:
            found.append(robot)
    for table in tables:
        assert isinstance(table.content, Table)
        if table.content.sha256 in made.source.sha256.split(" + "):
            found.append(table)
    return tuple(found)


# What comes next


def _commands(folder: Folder) -> Iterator[str]:
    """Yield the next commands, the most likely first; each works as it stands."""
    fitted = {part for _, parts in folder.of_result for part in parts}
    open_fits = [fit for fit in folder.fits if fit.table not in fitted]
    of_kind = {what: [entry for entry in folder.entries if entry.what is what] for what in What}
    for entry in of_kind[What.RECORDING]:
        if not open_fits:
            yield _command("bag", entry.path)
    for fit in open_fits:
        for result, parts in folder.of_result:
            if fit.robot in parts:
                robot = next((part for part in parts if _run(part)), fit.robot)
                yield _command(
                    "evaluate",
                    robot.path,
                    fit.table.path,
                    *_points(fit),
                    "--calibration",
                    result.path,
                )
    for fit in open_fits:
        if not any(fit.robot in parts for _, parts in folder.of_result):
            yield _command(
                "calibrate", fit.robot.path, fit.table.path, *_cell(fit), *_points(fit),
                "-o", _free(folder, "corrected.urdf"), "--json", _free(folder, "result.json"),
            )  # fmt: skip
    for robot in sorted(of_kind[What.ROBOT], key=_run)[:1]:  # a nominal one
        for entry in of_kind[What.SWEEPS]:
            frame = _free(folder, "frame.toml")
            yield _command("base-frame", entry.path, "--robot", robot.path, "--cell-out", frame)
    for entry in of_kind[What.MANIFEST]:
        yield _command("fleet", entry.path, "--out", _free(folder, "results"))
    if not open_fits:
        for pictures in of_kind[What.PICTURES]:
            joints = [e for e in folder.entries if e.what is What.TABLE and names_images(e)]
            boards = [part for board in of_kind[What.BOARD] for part in ("--board", board.path)]
            if joints and boards:
                yield _command(
                    "detect", pictures.path, *boards, "--joints", joints[0].path,
                    "-o", _free(folder, "corners.csv"),
                )  # fmt: skip
    for result, parts in folder.of_result:
        robots = [part for part in parts if part.what is What.ROBOT and not _run(part)]
        for robot in robots[:1]:
            page = _free(folder, "robots.html")
            yield _command("view", robot.path, "--calibration", result.path, "-o", page)
            for program in of_kind[What.PROGRAM]:
                corrected = _free(folder, f"corrected{program.path.suffix}")
                yield _command(
                    "compensate", robot.path, program.path, "--calibration", result.path,
                    "-o", corrected,
                )  # fmt: skip
    if len(folder.of_result) > 1:
        yield _command("history", folder.path)
    if not folder.fits and not folder.of_result:
        for robot in of_kind[What.ROBOT][:1]:
            yield _command("inspect", robot.path)
            yield _command("plan", robot.path, "-o", _free(folder, "plan.csv"))
    if not of_kind[What.ROBOT] and not folder.of_result:
        yield "calib demo"


def _command(verb: str, *words: str | Path) -> str:
    """Return a command as it is typed."""
    return shlex.join(["calib", verb, *map(str, words)])


def _cell(fit: Fit) -> tuple[str | Path, ...]:
    """Return the option that names the cell of a table."""
    return () if fit.cell is None else ("--cell", fit.cell.path)


def _points(fit: Fit) -> tuple[str | Path, ...]:
    """Return the option that names the list of points of a table."""
    return () if fit.points is None else ("--points", fit.points.path)


def names_images(entry: Entry) -> bool:
    """Return True if a table names a picture in each row, and measures nothing."""
    assert isinstance(entry.content, Table)
    names = {split_header(label)[0] for label in entry.content.header}
    return "image" in names and names.isdisjoint({*POINT, "u", "v"})


def _free(folder: Folder, name: str) -> Path:
    """Return the path of a new file in a folder: of this name, or with the first number that no file has."""
    wanted = folder.path / name
    for number in count(2):
        if not wanted.exists():
            break
        wanted = folder.path / f"{Path(name).stem}-{number}{Path(name).suffix}"
    return wanted
