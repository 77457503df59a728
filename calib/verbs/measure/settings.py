"""The settings of a session: robot, cell and aim, in its folder.

`robot.urdf` is a copy of the robot as it was; the file that it came from, whose meshes say where it collides, is read
again if it still has the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from calib.basics.dates import date_text, now
from calib.basics.files import write_atomically
from calib.basics.json_files import damage, json_bytes, read_json
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.data.inputs import chain_of, robot_of
from calib.errors import CalibError, FileError
from calib.result.calibration_file import cell_table, read_cell
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf
from calib.verbs.measure.aim import Aim
from calib.verbs.workspace.region_file import region_of_table, region_table
from calib.version import __version__

#: The layout of the file.
SCHEMA = "session 1"

#: Names of the files of a session in its folder.
SETTINGS = "session.json"
ROBOT = "robot.urdf"
JOURNAL = "journal.jsonl"
TABLE = "measurements.csv"
CELL = "cell.toml"
PICTURES = "pictures"


@dataclass(frozen=True, slots=True, eq=False)
class Settings(Value):
    """The settings with which a session was started."""

    #: The nominal robot
    robot: Robot
    #: The cell, with the robot's links
    cell: Cell
    #: How accurate the robot is to be
    aim: Aim
    #: Of the candidates
    seed: int
    #: Whether poses are checked for collisions
    collisions: bool
    #: Shape (m,), joint values before the first pose [rad] or [m]; empty: any pose may be the first
    start: tuple[float, ...] = ()
    #: The robot as it was named, by an absolute path or a name; empty: it was given in memory
    source: str = ""

    def write(self, folder: Path) -> None:
        """Write the settings and a copy of the robot into a folder.

        Args:
            folder: A folder without a session.

        Raises:
            FileError: A file exists, or cannot be written.
        """
        region = self.aim.region
        urdf = self.robot.urdf
        table = {
            "schema": SCHEMA,
            "calib": __version__,
            "time": date_text(now()),
            "robot": self.source,
            "robot_sha256": urdf.sha256,
            "cell": cell_table(self.cell),
            "aim": {
                "error_m": self.aim.error,
                "poses": self.aim.poses,
                "region": None if region is None else region_table(region),
            },
            "seed": self.seed,
            "collisions": self.collisions,
            "start": list(self.start),
        }
        write_atomically(folder / ROBOT, urdf.data, overwrite=False)
        try:
            write_atomically(folder / SETTINGS, json_bytes(table), overwrite=False)
        except BaseException:
            (folder / ROBOT).unlink()
            raise

    @classmethod
    def read(cls, folder: Path) -> Settings:
        """Read the settings of the session in a folder.

        Raises:
            FileError: There is none, or a file is damaged.
            CalibError: The robot or the cell cannot be read.
        """
        path = folder / SETTINGS
        expected = f"a session of calib {__version__} has '{SCHEMA}'. Start another one."
        table = read_json(path, "session", SCHEMA, expected)
        try:
            cell = read_cell(table["cell"])
            region = table["aim"]["region"]
            aim = Aim(
                table["aim"]["error_m"],
                table["aim"]["poses"],
                None if region is None else region_of_table(region),
            )
            urdf = _urdf(folder, str(table["robot"]), table["robot_sha256"])
            return cls(
                robot=robot_of(ROBOT, cell, read=lambda _: urdf),
                cell=cell,
                aim=aim,
                seed=int(table["seed"]),
                collisions=bool(table["collisions"]),
                start=tuple(table["start"]),
                source=str(table["robot"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise FileError(f"{path}: {damage(error)}. Start another session.") from error


def robot_file(settings: Settings, folder: Path) -> str:
    """Return the robot as commands take it: as it was named if that is still the same, else its copy in the folder."""
    named = _named(settings.source, settings.robot.urdf.sha256)
    return str(folder / ROBOT) if named is None else settings.source


def cell_of_robot(cell: Cell, robot: Robot) -> Cell:
    """Return a cell with the links, held joints and couplings of a robot of one chain; of several it has them."""
    if robot.branches or robot.parts:
        return cell
    chain = chain_of(robot)
    return replace(cell, base=chain.base, tip=chain.tip, held=chain.held, coupling=chain.coupling)


def _urdf(folder: Path, source: str, sha256: Any) -> Urdf:  # noqa: ANN401  any JSON
    """Return the robot's URDF: the file that was named if it has the same bytes, else the copy in the folder."""
    return _named(source, sha256) or Urdf.read(folder / ROBOT)


def _named(source: str, sha256: Any) -> Urdf | None:  # noqa: ANN401  any JSON
    """Return the robot that was named; None if there is none, or it has other bytes by now."""
    if not source:
        return None
    try:
        named = read_urdf(source)
    except CalibError:
        return None
    return named if named.sha256 == sha256 else None
