"""fleet: many robots calibrated, each from its own data into a folder of its own, and compared with each other.

Robots are read when their turn has come and calibrated in any executor; the process that reads the inputs writes the
files too, so that workers on other machines need no shared disk. One that fails is told with its reason, and the others
are finished. The last file of a robot's folder, ``made.json``, has the SHA-256 of the robot's inputs and its row of the
fleet's table: by it the next run knows what is finished and unchanged.
"""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from calib.calibration import calibrate
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.table import Table
from calib.errors import CalibError
from calib.files import make_folder, remove, write_atomically
from calib.fleets.record import (
    ACCEPTED,
    FAILED,
    ROWS,
    WITHHELD,
    FleetOutlier,
    FleetRow,
    csv_bytes,
    fleet_outliers,
)
from calib.jobs import run
from calib.json_files import json_bytes, plain
from calib.report.report import write_report
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf
from calib.version import __version__

#: The tables of a fleet: for a spreadsheet, and for a program; see docs/fleet.md.
CSV, JSON = "fleet.csv", "fleet.json"

#: The corrected URDF in a robot's folder.
_URDF = "corrected.urdf"

#: Beside a robot's files, written last; counted up when the files of a robot change.
MADE, SCHEMA = "made.json", "fleet robot 5"

#: A robot's name is that of its folder.
_NAME = re.compile(r"[^\W_](?:[\w .+-]{0,98}[\w+-])?")

#: What is read of one robot: the nominal robot, its rows, its set-up.
FleetInputs = tuple[Robot, Measurements, Cell]


@dataclass(frozen=True, slots=True, eq=False)
class FleetRobot:
    """One robot of a fleet, not read yet."""

    name: str  #: Unique; the name of its folder
    #: Reads it, when its turn has come. Its argument reads a URDF, a xacro or a robot by its name, and keeps the last
    #: ones, which many robots may share
    load: Callable[[Callable[[str], Urdf]], FleetInputs]

    @classmethod
    def of_files(
        cls,
        name: str,
        robot: str | Path,
        data: str | Path,
        cell: Cell | None = None,
        *,
        columns: Mapping[str, str] | None = None,
        points: str | Path | None = None,
        points_unit: str | None = None,
    ) -> FleetRobot:
        """A robot from its files: a URDF or xacro, or a name such as ``"ur3"``; a table, see `Measurements.read`."""
        cell, renamed = cell or Cell(), dict(columns or {})

        def load(urdf_of: Callable[[str], Urdf]) -> FleetInputs:
            table, urdf = Table.read(data), urdf_of(str(robot))
            names = table.names(renamed)
            arm = Robot.from_urdf(urdf, cell.base, cell.tip, measured=names, held=cell.held)
            own = (arm.joint_names, arm.joint_types, renamed, cell.kind, points, points_unit)
            return arm, Measurements.read(table, *own), cell

        return cls(name, load)


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """How all robots of a fleet are calibrated."""

    solver: str = "lm"  #: As of `calibrate`
    robust: bool = True  #: As of `calibrate`
    validate: bool = True  #: As of `calibrate`
    reports: bool = True  #: Whether each gets a report, which takes longer than the fit
    target_link: bool = False  #: Whether the corrected URDFs get a link at the target
    accept: bool = False  #: Whether URDFs are written also where the verdict is ``do not use``
    command: str = ""  #: For the reports: the command that made them


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """Many robots, calibrated."""

    rows: tuple[FleetRow, ...]  #: One for each robot, in their order
    odd: tuple[FleetOutlier, ...]  #: What is odd about which of them, see `calib.fleets.record`
    notes: tuple[str, ...]  #: What could not be said
    kept: int  #: How many of them were taken from an earlier run

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
        """All of it as in ``fleet.json``, SI units, the unit in the keys."""
        parts = {"robots": map(ROWS.table, self.rows), "odd": map(asdict, self.odd)}
        found = {name: plain([*part]) for name, part in parts.items()}
        return {"schema": "fleet 2", **found, "notes": [*self.notes]}


def fleet(
    robots: Sequence[FleetRobot],
    folder: str | Path,
    options: FleetOptions | None = None,
    *,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
    force: bool = False,
) -> Fleet:
    """Calibrate many robots into a folder: one of its own for each, and the tables ``fleet.csv`` and ``fleet.json``.

    A robot whose folder an earlier run has made of the same inputs, options and version is kept as it is. Of one that
    fails the folder stays as it was. One whose verdict is ``do not use`` gets no corrected URDF, unless
    ``options.accept`` is set, and an earlier one is removed.

    Args:
        robots: The robots.
        folder: Where to; it is made if missing.
        options: How they are calibrated.
        executor: Where; None: here, one after the other. Any of `concurrent.futures`, or Dask's
            ``Client.get_executor()``.
        progress: Called after each robot.
        force: Whether all are calibrated anew.

    Raises:
        CalibError: Names that cannot be those of folders or belong to two, or a worker was killed.
        FileError: The folder cannot be written.
    """
    check_names((robot.name, f"Robot {i}") for i, robot in enumerate(robots, 1))
    path, how = make_folder(folder), options or FleetOptions()
    done: dict[str, FleetRow] = {}
    sent: list[tuple[str, str]] = []
    kept: list[str] = []

    def settle(name: str, result: FleetRow | str) -> None:
        """Keep a robot's row, or why there is none."""
        done[name] = FleetRow(name, FAILED, result) if isinstance(result, str) else result
        if progress is not None:
            progress(len(done), len(robots))

    def jobs() -> Iterator[tuple[str, FleetInputs]]:
        """The robots that are to be calibrated, read when they are asked for."""
        urdf_of = lru_cache(maxsize=8)(read_urdf)
        for robot in robots:
            try:
                arm, rows, cell = robot.load(urdf_of)
            except Exception as error:  # noqa: BLE001  a fault with one robot must not cost the others
                settle(robot.name, _told(error))
                continue
            # By all that the files hang on, the sources' names too, which no comparison counts.
            table = {f: getattr(rows, f) for f in Measurements.__dataclass_fields__}
            own = (robot.name, arm, arm.urdf.source, table, cell)
            # What is accepted changes only the robots that there is something to accept of.
            alike = replace(how, command="", accept=False)
            told = fingerprint(*own, alike, __version__, SCHEMA)
            row = None if force else _finished(path / robot.name, told)
            if row is not None and row.urdf == (WITHHELD if how.accept else ACCEPTED):
                row = None
            if row is None:
                sent.append((robot.name, told))
                yield robot.name, (arm, rows, cell)
            else:
                kept.append(robot.name)
                settle(robot.name, row)

    for number, made in run(_calibrated, how, jobs(), executor):
        name, told = sent[number]
        try:
            settle(name, made if isinstance(made, str) else _written(path / name, told, *made))
        except CalibError as error:
            settle(name, str(error))
    every = tuple(done[robot.name] for robot in robots)
    result = Fleet(every, *fleet_outliers(every), len(kept))
    write_atomically(path / JSON, json_bytes(result.table()), overwrite=True)
    write_atomically(
        path / CSV, csv_bytes(every, [(odd.name, odd.text) for odd in result.odd]), overwrite=True
    )
    return result


def check_names(names: Iterable[tuple[str, str]]) -> None:
    """Refuse names, each with where it stands, that cannot be those of folders, or that two robots have."""
    seen = set()
    for name, where in names:
        if not _NAME.fullmatch(name) or name.casefold() in seen:
            raise CalibError(
                f"{where}: {name!r} cannot be the name of a robot's folder. A name has 1 to 100 letters, digits, and "
                "'_', '-', '+', '.' or blanks between them, and is no other robot's, capitals aside."
            )
        seen.add(name.casefold())


def _calibrated(
    options: FleetOptions, job: tuple[str, FleetInputs]
) -> tuple[FleetRow, dict[str, bytes]] | str:
    """Calibrate a robot: its row and the bytes of its files by name, or why there are none."""
    name, (robot, rows, cell) = job
    how = {key: getattr(options, key) for key in ("solver", "robust", "validate")}
    try:
        result = calibrate(robot, rows, cell=cell, **how)
        with tempfile.TemporaryDirectory() as folder:
            there, row = Path(folder), FleetRow.of(name, result, accept=options.accept)
            if row.urdf != WITHHELD:
                target = options.target_link
                result.write_urdf(there / _URDF, target_link=target, accept=True)
            result.write_json(there / "result.json")
            text = f"{result.summary()}\n"
            (there / "summary.txt").write_bytes(text.encode("utf-8", "backslashreplace"))
            if options.reports:
                command = f"{options.command}  # {name}" if options.command else ""
                write_report(result, there / "report.html", command=command)
            return row, {p.name: p.read_bytes() for p in there.iterdir()}
    except Exception as error:  # noqa: BLE001  a fault with one robot must not cost the others
        return _told(error)


def _told(error: Exception) -> str:
    """Why a robot has no result."""
    if isinstance(error, CalibError):
        return str(error)
    return f"internal error: {type(error).__name__}: {error}. Please report it with this robot's files."


def fingerprint(*values: object) -> str:
    """The SHA-256 of some values: of dataclasses by the fields that count in a comparison, of arrays by every bit.

    Example:
        >>> fingerprint("a", 1.0) == fingerprint("a", 1.0), fingerprint("a", 1.0) == fingerprint("a1.0")
        (True, False)
    """

    def parts(value: object) -> object:
        """What JSON has no word for, by its kind and what it consists of."""
        kind = type(value).__name__
        if is_dataclass(value) and not isinstance(value, type):
            return [kind, *((f.name, getattr(value, f.name)) for f in fields(value) if f.compare)]
        if isinstance(value, (np.ndarray, np.generic)):
            return [kind, value.dtype.str, value.shape, value.tobytes().hex()]
        if isinstance(value, Mapping):
            return [kind, *value.items()]
        if isinstance(value, (bytes, Path)):
            return [kind, str(value)]
        raise TypeError(f"a value of type {kind} has no fingerprint")

    return hashlib.sha256(json.dumps(values, default=parts).encode()).hexdigest()


def _finished(folder: Path, fingerprint: str) -> FleetRow | None:
    """The row of a robot whose folder was made of the inputs with this fingerprint, and is finished; else None."""
    try:
        table = json.loads((folder / MADE).read_bytes())
        same = table["schema"] == SCHEMA and table["fingerprint"] == fingerprint
        whole = all((folder / name).is_file() for name in table["files"])
        row: FleetRow = ROWS.read(FleetRow, table["row"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return row if same and whole else None


def _written(folder: Path, fingerprint: str, row: FleetRow, files: dict[str, bytes]) -> FleetRow:
    """Write a robot's files, first that they are a fleet's and not finished, at last that they are.

    Files of an earlier result that this one does not have are removed: a URDF must not pass for this result's.
    """
    make_folder(folder)
    # A URDF that is not written for its verdict must not be somebody's either, beside this result.
    strange = [name for name in (*files, _URDF) if (folder / name).exists()]
    if strange and not (folder / MADE).exists():
        raise CalibError(
            f"{folder / strange[0]} exists already, and no fleet has written it. Move it away."
        )
    earlier = [name for name in _files_made(folder) if name not in files]
    parts = {"files": [*files], "row": ROWS.table(row)}
    table = {"schema": SCHEMA, "fingerprint": fingerprint, **parts}
    begun = table | {"fingerprint": "", "files": [*files, *earlier]}
    write_atomically(folder / MADE, json_bytes(begun), overwrite=True)
    for name in earlier:
        remove(folder / name)
    for name, data in (*files.items(), (MADE, json_bytes(table))):
        write_atomically(folder / name, data, overwrite=True)
    return row


def _files_made(folder: Path) -> list[str]:
    """Names of the files that an earlier fleet has written into a robot's folder, finished or not."""
    try:
        names = json.loads((folder / MADE).read_bytes())["files"]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    # What calib wrote are plain names: a list that somebody changed reaches no other folder.
    return [n for n in names if isinstance(n, str) and Path(n).name == n and n != MADE]
