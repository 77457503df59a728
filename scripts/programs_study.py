"""Robot programs, corrected: the figures of docs/programs.md.

    python scripts/programs_study.py
    python scripts/programs_study.py FOLDER
    python scripts/programs_study.py --rate 10000

All programs of the tests, or of a folder, are corrected for a robot without errors, and for one with errors of 0.5 mm
and 2 mrad in every placement. The first must leave every byte as it is. For the second a controller with the nominal
model, simulated with Pinocchio and inverse kinematics of its own, says how far the true tool ends from where the
nominal one would have gone; not of targets that several motions share and that get the mean of their corrections.

Tools and frames that the files do not define are taken to be at the tip and in the base. With --rate, how long one core
needs for a program of so many lines.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from studies import print_table, study_parser

from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.verbs.compensate.programs.correction import corrected
from calib.verbs.compensate.programs.dialects import find_dialect, read_program_file
from calib.verbs.compensate.programs.program_file import ProgramFile, Stated

sys.path.insert(0, str(Path(__file__).parents[1]))

#: Arms like those of the makers: the module of the tests, its function, and joint values to start at [deg].
_ARMS = {
    ".src": ("kuka_arm", "kuka_arm", (0, -90, 90, 0, 15, 0)),
    ".mod": ("abb_arm", "abb_arm", (0, 0, 0, 0, 30, 0)),
    ".modx": ("abb_arm", "abb_arm", (0, 0, 0, 0, 30, 0)),
    ".prg": ("abb_arm", "abb_arm", (0, 0, 0, 0, 30, 0)),
    ".sys": ("abb_arm", "abb_arm", (0, 0, 0, 0, 30, 0)),
    ".ls": ("industrial_arm", "industrial_arm", (0, 0, 0, 0, -60, 0)),
    ".jbi": ("industrial_arm", "industrial_arm", (0, 0, 0, 0, -60, 0)),
}

#: The arm of all other programs, with joint values to start at [deg].
_OTHER = ("ur5", (0, -90, 90, -90, -90, 0))

_PROGRAMS = (
    Path(__file__).resolve().parents[1] / "tests" / "verbs" / "compensate" / "programs" / "data"
)

#: A motion that ends farther away than this does not arrive [m].
_ARRIVED = 5e-6


def _of_tests(module: str, name: str) -> Any:  # noqa: ANN401  the tests have no types
    """Return a function of the tests of compensation, by its module."""
    return getattr(import_module(f"tests.verbs.compensate.{module}"), name)


def _off(robot: Robot) -> Robot:
    """Return the robot with errors in all its placements."""
    moved: Robot = _of_tests("arms", "off")(robot)
    return moved


def _arm(ending: str, folder: Path) -> tuple[Robot, np.ndarray]:
    """Return the arm for programs of an ending, and joint values to start at (6,) [rad]."""
    if ending not in _ARMS:
        name, degrees = _OTHER
        return Robot.load(name, base="base", tip="tool0"), np.radians(degrees)
    module, function, degrees = _ARMS[ending]
    return _of_tests(f"programs.{module}", function)(folder), np.radians(degrees)


def _misses(robot: Robot, true: Robot, program: ProgramFile, start: np.ndarray) -> Iterator[float]:
    """Yield how far the tool of the true robot ends from where it should, at each motion that is corrected [m]."""
    named = dict(zip(robot.joint_names, start.tolist(), strict=True))
    result = corrected(program, robot, true, start=named)
    known = np.flatnonzero(result.is_corrected & ~(result.shared[:, 0] > _ARRIVED))
    with tempfile.TemporaryDirectory() as name:
        # The new files are read among the others of their folder.
        folder = shutil.copytree(program.texts[0].path.parent, Path(name) / "programs")
        for new in result.texts:
            (folder / new.path.name).write_bytes(new.text.encode("latin-1"))
        again = read_program_file(folder / program.texts[0].path.name, _stated(robot))
    arrival = _of_tests("programs.controller", "arrival")
    yield from arrival(robot, true, program, again, known.tolist(), start).tolist()


def _stated(robot: Robot) -> Stated:
    """Return what is said of programs: nothing of their own."""
    pulses = (1000.0 / np.radians(1.0),) * len(robot.joint_names)
    tip = {"": np.eye(4)}
    return Stated(robot.joint_names, tip, tip, (), pulses, robot=robot)


def _study(folder: Path) -> None:
    """Print a table of all programs in a folder."""
    rows: dict[str, Counter[str]] = {}
    worst: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        for path in sorted(folder.rglob("*")):
            dialect = find_dialect(path)
            if dialect is None or not path.is_file():
                continue
            count = rows.setdefault(dialect.name, Counter())
            count["programs"] += 1
            robot, start = _arm(path.suffix.lower(), Path(name))
            try:
                program = read_program_file(path, _stated(robot))
                count["motions"] += len(program.moves)
                count["left"] += len(program.left)
                named = dict(zip(robot.joint_names, start.tolist(), strict=True))
                same = corrected(program, robot, robot, start=named)
                count["read"] += 1
                count["same"] += all(
                    a.text == b.text for a, b in zip(same.texts, program.texts, strict=True)
                )
                misses = list(_misses(robot, _off(robot), program, start))
                count["corrected"] += len(misses)
                worst[dialect.name] = max([worst.get(dialect.name, 0.0), *misses])
            except CalibError as error:
                count["refused"] += 1
                print(f"{path}: {str(error)[:120]}")
            except AssertionError as error:
                count["no inverse kinematics"] += 1
                print(f"{path}: {error}")
    words = ("programs", "read", "same", "motions", "corrected", "left")
    head = [
        "language",
        "programs",
        "corrected",
        "identical without errors",
        "motions",
        "arrivals tested",
        "left",
    ]
    table = []
    for name, count in rows.items():
        farthest = f"{1e6 * worst[name]:.3f}" if name in worst else "-"
        table.append([name, *(str(count[word]) for word in words), farthest])
    print_table([*head, "worst arrival um"], table)


def _rate(lines: int) -> None:
    """Print how long a program of so many lines takes, of one core."""
    with tempfile.TemporaryDirectory() as name:
        robot, start = _arm(".src", Path(name))
        T = robot.poses(start)[0]
        text = "DEF rate()\n$TOOL=$NULLFRAME\n$BASE=$WORLD\n"
        text += (
            "PTP {" + ",".join(f"A{j + 1} {np.degrees(v):.4f}" for j, v in enumerate(start)) + "}\n"
        )
        for k in range(lines):
            x, y, z = 1e3 * T[:3, 3] + 200.0 * np.array([np.cos(k / 50) - 1, np.sin(k / 50), 0.0])
            text += f"LIN {{X {x:.3f},Y {y:.3f},Z {z:.3f},A 0.000,B 75.000,C 0.000}} C_DIS\n"
        path = Path(name) / "rate.src"
        path.write_text(text + "END\n")
        begin = time.process_time()
        program = read_program_file(path, _stated(robot))
        read = time.process_time()
        corrected(program, robot, _off(robot))
        end = time.process_time()
    print(f"{lines} lines: read in {read - begin:.1f} s, corrected in {end - read:.1f} s")


def main() -> None:
    """Run what the command line asks for."""
    parser = study_parser(__doc__)
    parser.add_argument(
        "folder", nargs="?", type=Path, default=_PROGRAMS, help="folder of programs"
    )
    parser.add_argument("--rate", type=int, metavar="LINES", help="time a program of so many lines")
    arguments = parser.parse_args()
    if arguments.rate:
        _rate(arguments.rate)
    else:
        _study(arguments.folder)


if __name__ == "__main__":
    main()
