"""Wrong inputs as a user gives them: a folder for each, with the command, and the cause that it has to name.

    python scripts/wrong_inputs.py FOLDER                          write them, and print the commands
    python scripts/wrong_inputs.py FOLDER --run                    run them too: seconds, and what was named
    python scripts/wrong_inputs.py FOLDER --run --only "joint,camera"    those with one of these words in their names

Tables: a UR5 with typical errors at 30 poses, points or poses to 0.05 mm, in a known or an unknown measurement frame.
Pictures: a Panda with a camera on its hand, 24 pictures of a print of 7 x 5 squares (24 corners), to 0.3 px.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import picture_mistakes_study as of_pictures
from arms import load_arm
from camera_study import ARMS, BOARD, SIZE_ALONE, STATED, draw
from mistakes_study import MISTAKES, MORE_MISTAKES, right_table, spoilt_table
from studies import study_parser

from calib.basics.arrays import read_only
from calib.boards.board import Board
from calib.boards.board_file import board_toml
from calib.camera.camera import Camera
from calib.camera.camera_file import camera_toml
from calib.data.measurements import Measurements
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot

#: Pictures of a table.
PICTURES = 24

#: Seed of the cell with a camera, and of what is drawn for a mistake.
SEED = 4

#: Factor of a wrong focal length, and of squares of 25 mm that are stated as 30 mm.
FOCAL = 1.3
SQUARES = 25.0 / 30.0

#: A smaller resolution of the same camera, as a file of another mode of it states.
SMALLER = 0.5


@dataclass(frozen=True, slots=True)
class WrongInput:
    """A wrong input, written into a folder."""

    #: Its name
    name: str
    #: The folder, in which the command runs
    folder: Path
    #: What follows ``calib``; the result is written to ``result.json``
    arguments: tuple[str, ...]
    #: Code of the reason that names the cause; or, if the table is refused, words of the message
    expected: str

    def is_named(self, printed: str) -> bool:
        """Return whether the cause was named: by a reason of the result, or by the message (``printed``)."""
        return self.expected in self.codes() or self.expected in printed

    def codes(self) -> tuple[str, ...]:
        """Return the codes of the verdict's reasons in ``result.json``; none if there is no such file."""
        file = self.folder / "result.json"
        if not file.exists():
            return ()
        verdict = json.loads(file.read_text(encoding="utf-8"))["verdict"] or {"reasons": []}
        return tuple(reason["code"] for reason in verdict["reasons"])


# Tables

#: Tables: a mistake of `mistakes_study.MISTAKES`, the kind of table, and whether the measurement frame is unknown.
OF_TABLES = (
    ("a joint turned", "points", False),
    ("a zero off by 90 deg", "points", True),
    ("joints in rad for deg", "points", True),
    ("joint columns swapped", "points", True),
    ("joint columns reversed", "points", False),
    ("rows shifted", "points", True),
    ("points in mm for m", "points", False),
    ("x and y swapped", "points", False),
    ("y mirrored", "points", True),
    ("another tip", "points", True),
    ("quaternions w first", "poses", True),
    ("poses inverse", "poses", True),
)

#: The link that carries the target of another tip: without one joint alone it would be its unit, too.
EARLIER = "wrist_1_link"

#: Words of the message that refuses a table whose unit is wrong by all its rows.
REFUSED = {"points in mm for m": "If it is in m, say so in the header"}

#: Two mistakes at a time, which is looked for last, in tables of 40 points.
TWO = "sign of one, zero of another"


def _robot_file(robot: Robot, folder: Path) -> str:
    """Write the URDF of a robot, and return its name."""
    robot.urdf.write(folder / "robot.urdf", overwrite=True)
    return "robot.urdf"


def _table_command(robot: Robot, table: Measurements, folder: Path, *, free: bool) -> list[str]:
    """Write robot, table and cell file of a table, and return what follows ``calib``."""
    table.write(folder / "table.csv", overwrite=True)
    known = "estimate" if free else "known"
    cell = f'base = "{robot.base}"\ntip = "{robot.tip}"\nframe = "{known}"\n'
    (folder / "cell.toml").write_text(cell)
    return ["calibrate", _robot_file(robot, folder), "table.csv", "--cell", "cell.toml"]


def _on_earlier_link(robot: Robot, link: str, kind: str, *, free: bool) -> Measurements:
    """Return a table of a target on an earlier link, which has the columns of all joints."""
    table = right_table(robot.rebuilt(tip=link), kind, free=free)
    q = random_joint_values(robot, len(table), SEED)
    q[:, : table.joints.shape[1]] = table.joints
    return replace(table, joint_names=robot.joint_names, joints=q, moves=None)


def _wrong_tables(folder: Path, is_wanted: Callable[[str], bool]) -> Iterator[WrongInput]:
    """Write the tables of points and poses that are wanted, each with its robot and cell file."""
    for name, kind, free in OF_TABLES:
        if not is_wanted(name):
            continue
        mistake = MISTAKES[name]
        place = _new_folder(folder, name)
        robot = load_arm("ur5")
        table = mistake.change(right_table(robot, kind, free=free))
        if mistake.tip:  # the one of the whole arm is given
            table = _on_earlier_link(robot, EARLIER, kind, free=free)
        command = _table_command(robot, table, place, free=free)
        expected = mistake.unknown_code if free and mistake.unknown_code else mistake.code
        yield WrongInput(name, place, (*command, *_OUTPUTS), REFUSED.get(name, expected))
    assert TWO in MORE_MISTAKES
    if not is_wanted(TWO):
        return
    place = _new_folder(folder, TWO)
    robot, _, spoilt = spoilt_table(TWO, "point", 200, free=True)
    command = _table_command(robot, spoilt.table, place, free=True)
    yield WrongInput(TWO, place, (*command, *_OUTPUTS), "two_mistakes")


# Pictures


@dataclass(frozen=True, slots=True)
class _Setup:
    """What the files and options of a cell with a camera say."""

    #: The table of corners
    table: Measurements
    #: The description of the board
    board: Board = BOARD
    #: The file of the camera
    camera: Camera = SIZE_ALONE
    #: Links that carry the camera and the board
    links: tuple[str, str] = ARMS[0][1:]


def _exchanged_links(right: Measurements) -> _Setup:
    """Camera and board are on each other's link."""
    return _Setup(right, links=(ARMS[0][2], ARMS[0][1]))


def _wrong_squares(right: Measurements) -> _Setup:
    """The squares are smaller than described."""
    assert right.board_points is not None
    board = replace(BOARD, square=BOARD.square / SQUARES, marker=BOARD.marker / SQUARES)
    return _Setup(replace(right, board_points=right.board_points / SQUARES), board)


def _wrong_focal(right: Measurements) -> _Setup:
    """The focal lengths are those of another lens."""
    assert STATED.values is not None
    values = STATED.values.copy()
    values[:2] *= FOCAL
    return _Setup(right, camera=replace(STATED, values=read_only(values)))


def _wrong_size(right: Measurements) -> _Setup:
    """The file of the camera is that of a smaller resolution."""
    assert STATED.values is not None
    values = STATED.values.copy()
    values[:4] *= SMALLER
    width, height = round(SMALLER * STATED.width), round(SMALLER * STATED.height)
    return _Setup(right, camera=Camera(width=width, height=height, values=read_only(values)))


#: Pictures with a mistake of `picture_mistakes_study.MISTAKES`, and the code that names it.
OF_PICTURES = {
    "exchanged": "pictures_exchanged",
    "shifted": "rows_moved",
    "bumped": "camera_moved",
    "refocused": "camera_refocused",
    "turned": "pictures_turned",
    "late": "joints_late",
}

#: Set-ups that are wrong for all pictures.
OF_SETUPS: dict[str, tuple[Callable[[Measurements], _Setup], str]] = {
    "links exchanged": (_exchanged_links, "camera_on_other_link"),
    "squares of 25 mm stated as 30": (_wrong_squares, "board_scale_off"),
    "focal lengths of another lens": (_wrong_focal, "focal_length_off"),
    "camera file of another resolution": (_wrong_size, "outside"),
}


def _wrong_pictures(folder: Path, is_wanted: Callable[[str], bool]) -> Iterator[WrongInput]:
    """Write the tables of corners that are wanted, each with its robot, camera and board."""
    prefix = "pictures: "
    of_pictures_wanted = [name for name in OF_PICTURES if is_wanted(prefix + name)]
    of_setups_wanted = [name for name in OF_SETUPS if is_wanted(prefix + name)]
    if not of_pictures_wanted and not of_setups_wanted:
        return
    cell = draw(*ARMS[0], SEED)
    q = cell.poses(PICTURES, SEED)
    right = of_pictures.Drawn(cell, q, SEED, np.random.default_rng(SEED))
    setups = {}
    for name in of_pictures_wanted:
        random = np.random.default_rng([SEED, *name.encode()])
        change, _ = of_pictures.MISTAKES[name]
        setups[prefix + name] = _Setup(change(replace(right, random=random))), OF_PICTURES[name]
    for name in of_setups_wanted:
        setup_of, code = OF_SETUPS[name]
        setups[prefix + name] = setup_of(right.table()), code
    for name, (setup, code) in setups.items():
        place = _new_folder(folder, name)
        setup.table.write(place / "corners.csv", overwrite=True)
        (place / "board.toml").write_text(board_toml(setup.board))
        (place / "camera.toml").write_text(camera_toml(setup.camera))
        robot = _robot_file(cell.truth.nominal, place)
        command = ["calibrate", robot, "corners.csv"]
        command += ["--camera", "camera.toml", "--board", "board.toml"]
        command += ["--camera-on", setup.links[0], "--board-on", setup.links[1]]
        yield WrongInput(name, place, (*command, *_OUTPUTS), code)


#: What each command writes.
_OUTPUTS = ("--json", "result.json", "--force")


def _new_folder(folder: Path, name: str) -> Path:
    """Make the folder of an input."""
    place = folder / name.replace(": ", "_").replace(",", "").replace(" ", "_")
    place.mkdir(parents=True, exist_ok=True)
    return place


def write_wrong_inputs(folder: Path, is_wanted: Callable[[str], bool]) -> Iterator[WrongInput]:
    """Write wrong inputs, each into a folder of its own.

    Args:
        folder: The folder of these folders.
        is_wanted: Function of a name: whether the input of this name is written.

    Yields:
        Each after it was written: its folder, the command, and what names its cause.
    """
    yield from _wrong_tables(folder, is_wanted)
    yield from _wrong_pictures(folder, is_wanted)


def run(wrong: WrongInput) -> tuple[float, str]:
    """Run the command of a wrong input in a process of its own.

    Returns:
        Its time [s], and all that it printed.
    """
    command = [sys.executable, "-m", "calib", *wrong.arguments]
    began = time.perf_counter()
    ran = subprocess.run(command, cwd=wrong.folder, capture_output=True, text=True, check=False)
    return time.perf_counter() - began, ran.stdout + ran.stderr


def main() -> None:
    """Write the inputs, and run them if asked to."""
    parser = study_parser(__doc__)
    parser.add_argument("folder", type=Path, help="where they are written")
    parser.add_argument("--run", action="store_true", help="run the commands")
    parser.add_argument("--only", default="", help="those with one of these words, by commas")
    arguments = parser.parse_args()
    words = arguments.only.split(",")
    wanted = write_wrong_inputs(arguments.folder, lambda name: any(word in name for word in words))
    for wrong in wanted:
        if not arguments.run:
            print(f"cd {shlex.quote(str(wrong.folder))} && calib {shlex.join(wrong.arguments)}")
            continue
        (wrong.folder / "result.json").unlink(missing_ok=True)
        seconds, printed = run(wrong)
        named = "named" if wrong.is_named(printed) else f"NOT NAMED ({wrong.expected})"
        codes = ", ".join(wrong.codes()[:3]) or printed.strip()[:200]
        print(f"{seconds:6.1f} s  {wrong.name}: {named}: {codes}", flush=True)


if __name__ == "__main__":
    main()
